/* floaters.c - floaters: content of the rendered images that is not in the truth of a synthetic survey.
 *
 *     oceanxl render MODEL SURVEY -o IMAGES;  build/floaters IMAGES SURVEY
 *
 * Of the images that exist, against SURVEY/truth/still/NAME (against images/NAME in a survey without fish),
 * it prints the mean PSNR and the share of squares of 8 x 8 px whose mean colour is more than FLOATERS_OFF
 * off, the mean of the channels: texture that is missing does not count, a floater or a hole does.
 */
#include "../oceanxl.c"

#define FLOATERS_OFF 0.05 /* of white */
enum { FLOATERS_SQUARE = 8, FLOATERS_VIEWS = 100000 };

struct floaters {
    double squares, off, psnr;
    int images;
};

static double floaters_error(const oxl_image *a, const oxl_image *b, int x, int y)
{
    const size_t width = (size_t)a->width, plane = width * (size_t)a->height;
    double error = 0;
    for (size_t c = 0; c < 3; c++) {
        double sum = 0;
        for (int k = 0; k < FLOATERS_SQUARE * FLOATERS_SQUARE; k++) {
            const size_t at =
                c * plane + (size_t)(y + k / FLOATERS_SQUARE) * width + (size_t)(x + k % FLOATERS_SQUARE);
            sum += (double)a->rgb[at] - b->rgb[at];
        }
        error += fabs(sum) / (3 * FLOATERS_SQUARE * FLOATERS_SQUARE);
    }
    return error;
}

static void floaters_compare(oxl_context *ctx, struct floaters *f, const oxl_image *a, const oxl_image *b)
{
    double psnr;
    if (a->width != b->width || a->height != b->height || oxl_psnr(ctx, a, b, &psnr) != OXL_OK) return;
    for (int y = 0; y + FLOATERS_SQUARE <= a->height; y += FLOATERS_SQUARE)
        for (int x = 0; x + FLOATERS_SQUARE <= a->width; x += FLOATERS_SQUARE, f->squares++)
            f->off += floaters_error(a, b, x, y) > FLOATERS_OFF;
    f->psnr += psnr;
    f->images++;
}

int main(int argc, char **argv)
{
    oxl_context_options options = oxl_context_options_default();
    oxl_context *ctx = NULL;
    struct floaters f = {0};
    if (argc != 3 || oxl_context_create(&options, &ctx) != OXL_OK) {
        fputs("usage: floaters IMAGES SURVEY\n", stderr);
        return 2;
    }
    for (int i = 0; i < FLOATERS_VIEWS; i++) {
        char path[1024];
        oxl_image rendered = {0}, truth = {0};
        FILE *file;
        snprintf(path, sizeof path, "%s/IMG_%05d.png.png", argv[1], i);
        file = fopen(path, "rb");
        if (!file) continue;
        fclose(file);
        if (oxl_image_read(ctx, path, &rendered) == OXL_OK) {
            snprintf(path, sizeof path, "%s/truth/still/IMG_%05d.png", argv[2], i);
            if (oxl_image_read(ctx, path, &truth) != OXL_OK) {
                snprintf(path, sizeof path, "%s/images/IMG_%05d.png", argv[2], i);
                if (oxl_image_read(ctx, path, &truth) == OXL_OK) floaters_compare(ctx, &f, &rendered, &truth);
            } else floaters_compare(ctx, &f, &rendered, &truth);
        }
        oxl_image_free(ctx, &rendered);
        oxl_image_free(ctx, &truth);
    }
    if (f.images)
        printf("%d images, %.3f dB, off %.2f %%\n", f.images, f.psnr / f.images, 100 * f.off / f.squares);
    else fputs("floaters: no image has its truth\n", stderr);
    oxl_context_free(ctx);
    return f.images == 0;
}
