/* misfit.c - measures how much of a render's error a displaced camera explains.
 *
 * A displaced camera shifts the image. One shift is sought in detail, the difference to the mean of the
 * neighbourhood: light that changes slowly moves with a large shift as well as it brightens. It is the best
 * of all in a small image, the best beside it in each larger one, and counts by what it explains in the last.
 * So noise and light, which one small image may explain by a shift, explain nothing. A shift by whole pixels
 * blurs nothing: an image out of focus is explained by none.
 *
 * Invariant: masked pixels, NaN in the images here, take no part.
 */
#include "job.h"

enum {
    MISFIT_SMALLEST = 24, /* px; longer side of the smallest image in which a shift is sought */
    MISFIT_LARGEST = 200, /* px; longer side of the largest one */
    MISFIT_RADIUS = 3,    /* px; detail is the difference to the mean of so many to each side */
    MISFIT_FARTHEST = 4,  /* bounds a shift: a fourth of the image's sides */
    MISFIT_BESIDE = 2     /* px; change of a shift from one image to the next larger one */
};

struct misfit_pair {
    int width, height;
    float *rendered, *image; /* (height,width) */
};

/* Averages the green channel over n x n pixels, and leaves its detail. work: (height,width). */
static void misfit_reduce(const oxl_image *from, int n, float *work, float *out)
{
    const int w = from->width / n, h = from->height / n, r = MISFIT_RADIUS;
    for (int y = 0; y < h; y++)
        for (int x = 0; x < w; x++) {
            float sum = 0;
            for (int k = 0; k < n * n; k++)
                sum += from->rgb[((size_t)from->height + (size_t)(y * n + k / n)) * (size_t)from->width +
                                 (size_t)(x * n + k % n)];
            work[y * w + x] = sum / (float)(n * n);
        }
    for (int y = 0; y < h; y++)
        for (int x = 0; x < w; x++) {
            const int top = OXL_MAX(0, y - r), end = OXL_MIN(h, y + r + 1), left = OXL_MAX(0, x - r),
                      right = OXL_MIN(w, x + r + 1);
            float sum = 0;
            for (int j = top; j < end; j++)
                for (int i = left; i < right; i++) sum += work[j * w + i];
            out[y * w + x] = work[y * w + x] - sum / (float)((end - top) * (right - left));
        }
}

/* Returns the squared error of the render shifted by whole pixels, as a fraction of that of the render. */
static double misfit_left(const struct misfit_pair *p, int right, int down)
{
    const int w = p->width, h = p->height;
    double shifted = 0, still = 0;
    for (int y = OXL_MAX(0, -down); y < OXL_MIN(h, h - down); y++)
        for (int x = OXL_MAX(0, -right); x < OXL_MIN(w, w - right); x++) {
            const double image = p->image[y * w + x], was = image - p->rendered[y * w + x],
                         is = image - p->rendered[(y + down) * w + x + right];
            if (isnan(was)) continue;
            still += was * was, shifted += is * is;
        }
    return still > 0 ? shifted / still : 1;
}

/* Sets the best shift within `reach` of a shift, or none if that is better; returns misfit_left of it. */
static double misfit_search(const struct misfit_pair *p, const int reach[2], int shift[2])
{
    const int from[2] = {shift[0], shift[1]};
    double least = 1;
    shift[0] = shift[1] = 0;
    for (int y = from[1] - reach[1]; y <= from[1] + reach[1]; y++)
        for (int x = from[0] - reach[0]; x <= from[0] + reach[0]; x++) {
            const double left = misfit_left(p, x, y);
            if (left < least) least = left, shift[0] = x, shift[1] = y;
        }
    return least;
}

/* Finds the shift from the smallest size to the largest; work: (3,pixels). */
static void misfit_find(const oxl_image *rendered, const oxl_image *image, float *work, struct misfit *out)
{
    const int longer = OXL_MAX(image->width, image->height);
    int largest = 1, n, shift[2] = {0, 0}, reach[2] = {0, 0};
    while (longer / largest > MISFIT_LARGEST) largest *= 2;
    for (n = largest; longer / (2 * n) >= MISFIT_SMALLEST; n *= 2) continue;
    reach[0] = image->width / n / MISFIT_FARTHEST, reach[1] = image->height / n / MISFIT_FARTHEST;
    for (; n >= largest && longer / n >= MISFIT_SMALLEST; n /= 2) {
        const size_t pixels = (size_t)(image->width / n) * (size_t)(image->height / n);
        const struct misfit_pair pair = {image->width / n, image->height / n, work + pixels,
                                         work + 2 * pixels};
        misfit_reduce(rendered, n, work, pair.rendered);
        misfit_reduce(image, n, work, pair.image);
        out->explained = 1 - misfit_search(&pair, reach, shift);
        out->pixels = n * hypot(shift[0], shift[1]);
        for (int k = 0; k < 2; k++) shift[k] *= 2, reach[k] = MISFIT_BESIDE;
    }
}

OXL_INTERNAL oxl_result misfit_measure(oxl_context *ctx, oxl_image *rendered, oxl_image *image,
                                       struct misfit *out)
{
    const size_t pixels = (size_t)image->width * (size_t)image->height;
    float *work = oxl_alloc(ctx, 3 * pixels, sizeof *work);
    *out = (struct misfit){0};
    if (!work) return OXL_ERR_MEMORY;
    for (size_t i = 0; i < 3 * pixels; i++) rendered->rgb[i] = OXL_MIN(1, OXL_MAX(0, rendered->rgb[i]));
    for (size_t i = 0; image->weight && i < pixels; i++)
        for (size_t c = 0; c < 3 && !(image->weight[i] > 0); c++) image->rgb[c * pixels + i] = NAN;
    misfit_find(rendered, image, work, out);
    oxl_free(ctx, work);
    return OXL_OK;
}
