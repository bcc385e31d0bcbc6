/* misfit.c - measures how much of a render's error a displaced camera explains.
 *
 * A displaced camera shifts the image by an amount that changes smoothly over it: an affine field of six
 * numbers. It is sought in detail, the difference to the mean of the neighbourhood: light that changes slowly
 * moves with a large shift as well as it brightens. It is found as one shift in a small image, refined in
 * larger ones [Lucas & Kanade 1981, Bouguet 2000], and counts by what it explains in the largest. So noise
 * and light, which one small image may explain by a shift, explain nothing.
 *
 * Invariant: masked pixels, NaN in the images here, take no part.
 */
#include "survey.h"

enum {
    MISFIT_SMALLEST = 24, /* px; longer side of the smallest image in which a shift is sought */
    MISFIT_LARGEST = 200, /* px; longer side of the largest one */
    MISFIT_RADIUS = 3,    /* px; detail is the difference to the mean of so many to each side */
    MISFIT_STEPS = 6,     /* steps of a field per size */
    MISFIT_TERMS = 6 /* numbers of a field: of 1, u, v along x, then along y; u, v: -1 to 1 over the image */
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

/* Evaluates a field where the image's coordinates are u, v. */
static void misfit_field(const double field[MISFIT_TERMS], double u, double v, double shift[2])
{
    for (int k = 0; k < 2; k++) shift[k] = field[3 * k] + field[3 * k + 1] * u + field[3 * k + 2] * v;
}

/* Solves the symmetric equations by elimination; leaves 0 for what they do not determine. */
static void misfit_solve(double m[MISFIT_TERMS][MISFIT_TERMS], double x[MISFIT_TERMS])
{
    double scale[MISFIT_TERMS];
    for (int i = 0; i < MISFIT_TERMS; i++) scale[i] = 1e-9 * m[i][i];
    for (int i = 0; i < MISFIT_TERMS; i++)
        for (int j = i + 1; j < MISFIT_TERMS && m[i][i] > scale[i]; j++) {
            const double by = m[j][i] / m[i][i];
            for (int k = i; k < MISFIT_TERMS; k++) m[j][k] -= by * m[i][k];
            x[j] -= by * x[i];
        }
    for (int i = MISFIT_TERMS; i-- > 0;) {
        for (int k = i + 1; k < MISFIT_TERMS; k++) x[i] -= m[i][k] * x[k];
        x[i] = m[i][i] > scale[i] ? x[i] / m[i][i] : 0;
    }
}

/* Returns the squared error of the shifted render as a fraction of that of the render, and the step by which
 * to change the field. Interpolation between pixels blurs the render, which helps where the image is blurred:
 * so the fraction is one of the error of a render that is blurred likewise and not shifted, the mean of two
 * opposite shifts by parts of a pixel, if that is less. 1: the shift is too large. */
static double misfit_try(const struct misfit_pair *p, const double field[MISFIT_TERMS],
                         double step[MISFIT_TERMS])
{
    const int w = p->width, h = p->height;
    double normal[MISFIT_TERMS][MISFIT_TERMS] = {{0}}, ee = 0, before = 0, even = 0, shift[2];
    memset(step, 0, MISFIT_TERMS * sizeof *step);
    for (int k = 0; k < 4; k++) {
        misfit_field(field, k % 2 ? 1 : -1, k / 2 ? 1 : -1, shift);
        if (!(fabs(shift[0]) <= MISFIT_FARTHEST * w && fabs(shift[1]) <= MISFIT_FARTHEST * h)) return 1;
    }
    for (int y = 0; y < h; y++)
        for (int x = 0; x < w; x++) {
            const double u = 2.0 * x / w - 1, v = 2.0 * y / h - 1, image = p->image[y * w + x],
                         was = image - p->rendered[y * w + x];
            double at, to, e, both, part[2], slope[MISFIT_TERMS];
            misfit_field(field, u, v, shift);
            at = x + shift[0], to = y + shift[1];
            if (isnan(was) || !misfit_inside(p, at, to) || !misfit_inside(p, x, y)) continue;
            for (int k = 0; k < 2; k++) part[k] = shift[k] - floor(shift[k] + 0.5);
            slope[0] = 0.5 * (misfit_at(p->rendered, w, at + 1, to) - misfit_at(p->rendered, w, at - 1, to));
            slope[3] = 0.5 * (misfit_at(p->rendered, w, at, to + 1) - misfit_at(p->rendered, w, at, to - 1));
            for (int k = 0; k < 6; k += 3) slope[k + 1] = slope[k] * u, slope[k + 2] = slope[k] * v;
            e = image - misfit_at(p->rendered, w, at, to);
            both = image - 0.5 * (misfit_at(p->rendered, w, x + part[0], y + part[1]) +
                                  misfit_at(p->rendered, w, x - part[0], y - part[1]));
            for (int i = 0; i < MISFIT_TERMS; i++) {
                for (int k = 0; k < MISFIT_TERMS; k++) normal[i][k] += slope[i] * slope[k];
                step[i] += slope[i] * e;
            }
            ee += e * e, before += was * was, even += both * both;
        }
    misfit_solve(normal, step);
    before = OXL_MIN(before, even);
    return before > 0 ? ee / before : 1;
}

/* Finds the best of all shifts by whole pixels: from afar, steps may lead elsewhere. */
static void misfit_search(const struct misfit_pair *p, double field[MISFIT_TERMS])
{
    const int most[2] = {(int)(MISFIT_FARTHEST * p->width), (int)(MISFIT_FARTHEST * p->height)};
    double least = 1, step[MISFIT_TERMS];
    for (int y = -most[1]; y <= most[1]; y++)
        for (int x = -most[0]; x <= most[0]; x++) {
            const double at[MISFIT_TERMS] = {x, 0, 0, y}, left = misfit_try(p, at, step);
            if (left < least) least = left, field[0] = x, field[3] = y;
        }
}

/* Improves a field, from none if that is better, and returns the fraction of the error that it explains. */
static double misfit_improve(const struct misfit_pair *p, double field[MISFIT_TERMS])
{
    double step[MISFIT_TERMS], left = misfit_try(p, field, step);
    if (!(left < 1)) memset(field, 0, sizeof step), left = misfit_try(p, field, step);
    for (int i = 0; i < MISFIT_STEPS; i++) {
        double next[MISFIT_TERMS], then;
        for (int k = 0; k < MISFIT_TERMS; k++) next[k] = field[k] + step[k];
        then = misfit_try(p, next, step);
        if (!(then < left)) break;
        left = then;
        memcpy(field, next, sizeof next);
    }
    return 1 - left;
}

/* Sets what a field explains of the error of detail at the largest size, and its shifts, px of the images;
 * work: (3,pixels). */
static void misfit_find(const oxl_image *rendered, const oxl_image *image, float *work, struct misfit *out)
{
    const int longer = OXL_MAX(image->width, image->height);
    double field[MISFIT_TERMS] = {0};
    int largest = 1, n, searched = 0;
    while (longer / largest > MISFIT_LARGEST) largest *= 2;
    for (n = largest; longer / (2 * n) >= MISFIT_SMALLEST; n *= 2) continue;
    for (; n >= largest && longer / n >= MISFIT_SMALLEST; n /= 2) {
        const size_t pixels = (size_t)(image->width / n) * (size_t)(image->height / n);
        const struct misfit_pair pair = {image->width / n, image->height / n, work + pixels,
                                         work + 2 * pixels};
        misfit_reduce(rendered, n, work, pair.rendered);
        misfit_reduce(image, n, work, pair.image);
        for (int k = 0; k < MISFIT_TERMS; k++) field[k] *= 2;
        if (!searched++) misfit_search(&pair, field);
        out->explained = misfit_improve(&pair, field);
    }
    for (int k = 0; k < 2; k++) out->shift[k] = largest * field[3 * k];
    out->least = HUGE_VAL;
    for (int k = 0; k < 9; k++) {
        double shift[2], size;
        misfit_field(field, k % 3 - 1, k / 3 - 1, shift);
        size = largest * hypot(shift[0], shift[1]);
        out->least = OXL_MIN(out->least, size), out->most = OXL_MAX(out->most, size);
    }
}

OXL_INTERNAL oxl_result misfit_measure(oxl_context *ctx, oxl_image *rendered, oxl_image *image,
                                       struct misfit *out)
{
    const size_t pixels = (size_t)image->width * image->height;
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
