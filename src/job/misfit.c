/* misfit.c - measures how much of a render's error a displaced camera explains.
 *
 * A shift is sought in detail, the difference to the mean of the neighbourhood: light that changes slowly
 * moves with a large shift as well as it brightens. It is found in a small image, refined in larger ones
 * [Lucas & Kanade 1981, Bouguet 2000], and counts by what it explains in the largest. So noise and light,
 * which one small image may explain by a shift, explain nothing.
 *
 * Invariant: masked pixels, NaN in the images here, take no part.
 */
#include "job.h"

enum {
    MISFIT_SMALLEST = 24, /* px; longer side of the smallest image in which a shift is sought */
    MISFIT_LARGEST = 200, /* px; longer side of the largest one */
    MISFIT_RADIUS = 3,    /* px; detail is the difference to the mean of so many to each side */
    MISFIT_STEPS = 6      /* steps of a shift per size */
};
#define MISFIT_FARTHEST 0.25 /* Bounds a shift, as a fraction of the image's sides. */

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

/* Interpolates at the place x, y, which is inside. */
static double misfit_at(const float *from, int w, double x, double y)
{
    const int i = (int)x, j = (int)y;
    const double a = x - i, b = y - j;
    const float *p = from + j * w + i;
    return (1 - b) * ((1 - a) * p[0] + a * p[1]) + b * ((1 - a) * p[w] + a * p[w + 1]);
}

/* Returns 1 if the place's neighbours can be interpolated. */
static int misfit_inside(const struct misfit_pair *p, double x, double y)
{
    return x >= 1 && y >= 1 && x < p->width - 2 && y < p->height - 2;
}

/* Returns the squared error of the shifted render as a fraction of that of the render, and the step by which
 * to change the shift. Interpolation between pixels blurs the render, which helps where the image is blurred:
 * so the fraction is one of the error of a render that is blurred likewise and not shifted, the mean of two
 * opposite shifts by parts of a pixel, if that is less. 1: the shift is too large. */
static double misfit_try(const struct misfit_pair *p, const double shift[2], double step[2])
{
    const int w = p->width, h = p->height;
    const double part[2] = {shift[0] - floor(shift[0] + 0.5), shift[1] - floor(shift[1] + 0.5)};
    double xx = 0, xy = 0, yy = 0, xe = 0, ye = 0, ee = 0, before = 0, even = 0, det;
    step[0] = step[1] = 0;
    if (!(fabs(shift[0]) <= MISFIT_FARTHEST * w && fabs(shift[1]) <= MISFIT_FARTHEST * h)) return 1;
    for (int y = 0; y < h; y++)
        for (int x = 0; x < w; x++) {
            const double at = x + shift[0], to = y + shift[1], image = p->image[y * w + x],
                         was = image - p->rendered[y * w + x];
            double gx, gy, e, both;
            if (isnan(was) || !misfit_inside(p, at, to) || !misfit_inside(p, x, y)) continue;
            gx = 0.5 * (misfit_at(p->rendered, w, at + 1, to) - misfit_at(p->rendered, w, at - 1, to));
            gy = 0.5 * (misfit_at(p->rendered, w, at, to + 1) - misfit_at(p->rendered, w, at, to - 1));
            e = image - misfit_at(p->rendered, w, at, to);
            both = image - 0.5 * (misfit_at(p->rendered, w, x + part[0], y + part[1]) +
                                  misfit_at(p->rendered, w, x - part[0], y - part[1]));
            xx += gx * gx, xy += gx * gy, yy += gy * gy, xe += gx * e, ye += gy * e, ee += e * e;
            before += was * was, even += both * both;
        }
    det = xx * yy - xy * xy;
    if (det > 0) step[0] = (yy * xe - xy * ye) / det, step[1] = (xx * ye - xy * xe) / det;
    before = OXL_MIN(before, even);
    return before > 0 ? ee / before : 1;
}

/* Finds the best of all shifts by whole pixels: from afar, steps may lead elsewhere. */
static void misfit_search(const struct misfit_pair *p, double shift[2])
{
    const int most[2] = {(int)(MISFIT_FARTHEST * p->width), (int)(MISFIT_FARTHEST * p->height)};
    double least = 1, step[2];
    for (int y = -most[1]; y <= most[1]; y++)
        for (int x = -most[0]; x <= most[0]; x++) {
            const double at[2] = {x, y}, left = misfit_try(p, at, step);
            if (left < least) least = left, shift[0] = x, shift[1] = y;
        }
}

/* Improves a shift, from none if that is better, and returns the fraction of the error that it explains. */
static double misfit_shift(const struct misfit_pair *p, double shift[2])
{
    double step[2], left = misfit_try(p, shift, step);
    if (!(left < 1)) shift[0] = shift[1] = 0, left = misfit_try(p, shift, step);
    for (int i = 0; i < MISFIT_STEPS; i++) {
        const double next[2] = {shift[0] + step[0], shift[1] + step[1]};
        const double then = misfit_try(p, next, step);
        if (!(then < left)) break;
        left = then, shift[0] = next[0], shift[1] = next[1];
    }
    return 1 - left;
}

/* Returns the fraction of the error of detail that a shift explains at the largest size; work: (3,pixels). */
static double misfit_shifted(const oxl_image *rendered, const oxl_image *image, float *work)
{
    const int longer = OXL_MAX(image->width, image->height);
    double shift[2] = {0, 0}, explained = 0;
    int largest = 1, n, begun = 0;
    while (longer / largest > MISFIT_LARGEST) largest *= 2;
    for (n = largest; longer / (2 * n) >= MISFIT_SMALLEST; n *= 2) continue;
    for (; n >= largest && longer / n >= MISFIT_SMALLEST; n /= 2) {
        const size_t pixels = (size_t)(image->width / n) * (size_t)(image->height / n);
        const struct misfit_pair pair = {image->width / n, image->height / n, work + pixels,
                                         work + 2 * pixels};
        misfit_reduce(rendered, n, work, pair.rendered);
        misfit_reduce(image, n, work, pair.image);
        shift[0] *= 2, shift[1] *= 2;
        if (!begun++) misfit_search(&pair, shift);
        explained = misfit_shift(&pair, shift);
        if (n == 1) break;
    }
    return explained;
}

OXL_INTERNAL oxl_result misfit_measure(oxl_context *ctx, oxl_image *rendered, oxl_image *image,
                                       double *shifted)
{
    const size_t pixels = (size_t)image->width * (size_t)image->height;
    float *work = oxl_alloc(ctx, 3 * pixels, sizeof *work);
    *shifted = 0;
    if (!work) return OXL_ERR_MEMORY;
    for (size_t i = 0; i < 3 * pixels; i++) rendered->rgb[i] = OXL_MIN(1, OXL_MAX(0, rendered->rgb[i]));
    for (size_t i = 0; image->weight && i < pixels; i++)
        for (size_t c = 0; c < 3 && !(image->weight[i] > 0); c++) image->rgb[c * pixels + i] = NAN;
    *shifted = misfit_shifted(rendered, image, work);
    oxl_free(ctx, work);
    return OXL_OK;
}
