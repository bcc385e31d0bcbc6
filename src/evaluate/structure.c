/* structure.c - compares what two images show, whatever their brightness and contrast.
 *
 * PSNR does not see whether a dark image of low contrast is there at all: a featureless glow has 34 dB on a
 * seabed under a vehicle's lamp, and SSIM, whose constants are those of a bright image, 0.92. So the mean of
 * the channels is band-passed (Gaussian of 1 px less Gaussian of 6 px, reflected at the edges), and the
 * normalised correlation of the two bands is taken: 1 the same structure, 0 none.
 *
 * The other measure stays in decibels but takes the image's own contrast as its scale: the variance that is
 * left of the image once the light, a lamp's shape and the gains, is fitted to it, over the squared error.
 * 0 dB: a smooth ground under that light would do as well.
 *
 * Invariant: rows are summed in order, so the result does not depend on the number of threads.
 */
#include "evaluate.h"
#include "../core/vecmath.h"

enum { STRUCTURE_FINE, STRUCTURE_COARSE, STRUCTURE_LOCAL, STRUCTURE_WIDTHS };
static const double STRUCTURE_SIGMA[STRUCTURE_WIDTHS] = {1, 6, 6}; /* px; the third one is of the map */
#define STRUCTURE_REACH 4                                          /* Sets the reach of a window, in sigma. */
enum { STRUCTURE_HALF_MAX = 24 }; /* px; STRUCTURE_REACH of the widest window */
enum { STRUCTURE_TAPS = 8 };      /* divides 2 STRUCTURE_REACH sigma of each width */
/* Counts a band of a smaller mean square as the rounding of images to 8 bits: (1/255)^2 / 12. */
#define STRUCTURE_NOISE 1.2816e-6
#define STRUCTURE_DARK 1e-20 /* Keeps a product of mean squares from 0, against division by it. */

struct structure_work {
    int width, height;
    double *weight;             /* (H,W) weights; NULL: all pixels count */
    double *band[2], *plane[3]; /* (H,W) bands of a and b; (H,W) scratch */
    double *line;               /* (threads, W + 2 STRUCTURE_HALF_MAX) a line of each thread */
    double *memory;             /* the one allocation of all these arrays */
};

struct structure_window {
    int half;
    double tap[2 * STRUCTURE_HALF_MAX + 1]; /* taps from -half to half, whose sum is 1 */
};

static struct structure_window structure_window(int which)
{
    const double sigma = STRUCTURE_SIGMA[which];
    struct structure_window w = {.half = (int)(STRUCTURE_REACH * sigma + 0.5)};
    double *at = w.tap + w.half, sum = 0;
    for (int k = 0; k <= w.half; k++) {
        at[k] = vecmath_exp(-k * k / (2 * sigma * sigma));
        sum += k ? 2 * at[k] : at[k];
    }
    for (int k = 0; k <= w.half; k++) at[k] = at[-k] = at[k] / sum;
    return w;
}

/* Reflects an index outside 0..n-1 at the edge that it passed: -1 becomes 0, n becomes n - 1. */
static int structure_reflect(int i, int n)
{
    const int period = 2 * n, at = ((i % period) + period) % period;
    return at < n ? at : period - 1 - at;
}

/* Holds one row of a blur, along y and then along x. */
struct structure_row {
    int width;
    const struct structure_window *w;
    const double *row[2 * STRUCTURE_HALF_MAX + 1]; /* (W) input row under each tap of the column */
    /* (W + 2 STRUCTURE_HALF_MAX) row blurred along y; its columns 0..W-1 begin at STRUCTURE_HALF_MAX */
    double *line;
    double *out; /* (W) */
};

/* Adds STRUCTURE_TAPS taps to each column in one pass, in which its sum stays in a register. */
SIMD_INLINE void structure_add_taps(const double *const row[STRUCTURE_TAPS], const double *tap, int width,
                                    double *out)
{
#pragma omp simd
    for (int x = 0; x < width; x++) {
        double sum = out[x];
        for (int k = 0; k < STRUCTURE_TAPS; k++) sum += tap[k] * row[k][x];
        out[x] = sum;
    }
}

/* Adds all taps to `out`: the first, then STRUCTURE_TAPS at a time. */
SIMD_INLINE void structure_add(const struct structure_row *r, const double *const row[], double *out)
{
    for (int x = 0; x < r->width; x++) out[x] = r->w->tap[0] * row[0][x];
    for (int k = 1; k <= 2 * r->w->half; k += STRUCTURE_TAPS)
        structure_add_taps(row + k, r->w->tap + k, r->width, out);
}

SIMD_BODY void structure_blur_row_body(const int fused, const struct structure_row *r)
{
    double *middle = r->line + STRUCTURE_HALF_MAX;
    const double *shifted[2 * STRUCTURE_HALF_MAX + 1];
    (void)fused;
    structure_add(r, r->row, middle);
    for (int k = 1; k <= r->w->half; k++) {
        middle[-k] = middle[structure_reflect(-k, r->width)];
        middle[r->width - 1 + k] = middle[structure_reflect(r->width - 1 + k, r->width)];
    }
    for (int k = 0; k <= 2 * r->w->half; k++) shifted[k] = middle + k - r->w->half;
    structure_add(r, shifted, r->out);
}

SIMD_DISPATCH(static, structure_blur_row, struct structure_row)

static void structure_blur(oxl_context *ctx, const struct structure_work *s, int which, const double *in,
                           double *out)
{
    const struct structure_window w = structure_window(which);
    const size_t line = (size_t)s->width + 2 * STRUCTURE_HALF_MAX, width = (size_t)s->width;
#pragma omp parallel for schedule(static) num_threads(ctx->threads)
    for (int y = 0; y < s->height; y++) {
        struct structure_row r = {.width = s->width, .w = &w, .out = out + (size_t)y * width};
        r.line = s->line + (size_t)context_thread() * line;
        for (int k = 0; k <= 2 * w.half; k++)
            r.row[k] = in + (size_t)structure_reflect(y + k - w.half, s->height) * width;
        structure_blur_row(ctx->isa, &r);
    }
}

/* Computes the mean of the pixels that count in each window; `in` is 0 where none counts.
 * weighted: (H,W) scratch. */
static void structure_mean(oxl_context *ctx, const struct structure_work *s, int which, const double *in,
                           double *out, double *weighted)
{
    const size_t pixels = (size_t)s->width * (size_t)s->height;
    structure_blur(ctx, s, which, in, out);
    if (!s->weight) return;
    structure_blur(ctx, s, which, s->weight, weighted);
    for (size_t i = 0; i < pixels; i++) out[i] = weighted[i] > 0 ? out[i] / weighted[i] : 0;
}

static void structure_band(oxl_context *ctx, const struct structure_work *s, const oxl_image *of, double *out)
{
    const size_t pixels = (size_t)s->width * (size_t)s->height;
    double *grey = s->plane[0], *coarse = s->plane[1], *work = s->plane[2];
    for (size_t i = 0; i < pixels; i++) {
        const double v = (metrics_shown(of->rgb[i]) + metrics_shown(of->rgb[pixels + i]) +
                          metrics_shown(of->rgb[2 * pixels + i])) /
                         3;
        grey[i] = s->weight ? v * s->weight[i] : v;
    }
    structure_mean(ctx, s, STRUCTURE_FINE, grey, out, work);
    structure_mean(ctx, s, STRUCTURE_COARSE, grey, coarse, work);
    for (size_t i = 0; i < pixels; i++) out[i] = (out[i] - coarse[i]) * (s->weight ? s->weight[i] : 1);
}

static oxl_result structure_begin(oxl_context *ctx, const oxl_image *a, const oxl_image *b,
                                  struct structure_work *s)
{
    const size_t pixels = (size_t)a->width * (size_t)a->height, planes = 5 + (b->weight != NULL);
    const size_t line = (size_t)a->width + 2 * STRUCTURE_HALF_MAX;
    *s = (struct structure_work){.width = a->width, .height = a->height};
    s->memory = oxl_alloc(ctx, planes * pixels + line * (size_t)ctx->threads, sizeof *s->memory);
    if (!s->memory) return OXL_ERR_MEMORY;
    for (int k = 0; k < 2; k++) s->band[k] = s->memory + (size_t)k * pixels;
    for (int k = 0; k < 3; k++) s->plane[k] = s->memory + (size_t)(2 + k) * pixels;
    if (b->weight) s->weight = s->memory + 5 * pixels;
    s->line = s->memory + planes * pixels;
    for (size_t i = 0; b->weight && i < pixels; i++) s->weight[i] = b->weight[i] > 0.5f;
    return OXL_OK;
}

/* Computes mean products of the bands over the pixels that count: aa, bb, ab. Returns their number. */
static double structure_products(const struct structure_work *s, double product[3])
{
    double counted = 0;
    product[0] = product[1] = product[2] = 0;
    for (int y = 0; y < s->height; y++) {
        double row[3] = {0};
        for (size_t i = (size_t)y * (size_t)s->width, end = i + (size_t)s->width; i < end; i++) {
            row[0] += s->band[0][i] * s->band[0][i];
            row[1] += s->band[1][i] * s->band[1][i];
            row[2] += s->band[0][i] * s->band[1][i];
            counted += s->weight ? s->weight[i] : 1;
        }
        for (int k = 0; k < 3; k++) product[k] += row[k];
    }
    for (int k = 0; k < 3 && counted > 0; k++) product[k] /= counted;
    return counted;
}

/* Computes the correlation of the bands around each pixel; NaN: the image has no detail there. */
static void structure_map(oxl_context *ctx, const struct structure_work *s, float *map)
{
    const size_t pixels = (size_t)s->width * (size_t)s->height;
    double *product = s->plane[0], *blurred[3] = {s->plane[1], s->plane[2], NULL};
    for (int k = 0; k < 2; k++) {
        for (size_t i = 0; i < pixels; i++) product[i] = s->band[k][i] * s->band[k][i];
        structure_blur(ctx, s, STRUCTURE_LOCAL, product, blurred[k]);
    }
    for (size_t i = 0; i < pixels; i++) product[i] = s->band[0][i] * s->band[1][i];
    structure_blur(ctx, s, STRUCTURE_LOCAL, product, s->band[0]);
    for (size_t i = 0; i < pixels; i++)
        map[i] = blurred[1][i] > STRUCTURE_NOISE
                     ? (float)(s->band[0][i] / sqrt(blurred[0][i] * blurred[1][i] + STRUCTURE_DARK))
                     : NAN;
}

oxl_result oxl_structure(oxl_context *ctx, const oxl_image *a, const oxl_image *b, double *out, float *map)
{
    struct structure_work s;
    double product[3];
    oxl_result rc;
    *out = NAN;
    rc = metrics_check(ctx, a, b);
    if (rc == OXL_OK) rc = structure_begin(ctx, a, b, &s);
    if (rc != OXL_OK) return rc;
    structure_band(ctx, &s, a, s.band[0]);
    structure_band(ctx, &s, b, s.band[1]);
    if (structure_products(&s, product) > 0 && product[1] > STRUCTURE_NOISE)
        *out = product[2] / sqrt(product[0] * product[1] + STRUCTURE_DARK);
    if (map) structure_map(ctx, &s, map);
    oxl_free(ctx, s.memory);
    return OXL_OK;
}

/* ---------------- decibels of the image's own contrast */

/* Divides the squared error by the image's contrast: the rest of the image after its channels
 * are fitted by the light. */
OXL_INTERNAL double structure_explained(const oxl_image *rendered, const oxl_image *image,
                                        const oxl_image *light)
{
    const size_t pixels = (size_t)image->width * (size_t)image->height;
    double error = 0, contrast = 0;
    for (size_t c = 0; c < 3; c++) {
        const float *x = rendered->rgb + c * pixels, *y = image->rgb + c * pixels,
                    *l = light->rgb + c * pixels;
        double ll = 0, ly = 0;
        for (size_t i = 0; i < pixels; i++) {
            const double w = image->weight ? image->weight[i] : 1;
            ll += w * l[i] * l[i], ly += w * l[i] * metrics_shown(y[i]);
        }
        for (size_t i = 0; i < pixels; i++) {
            const double w = image->weight ? image->weight[i] : 1, v = metrics_shown(y[i]);
            const double e = metrics_shown(x[i]) - v, rest = v - (ll > 0 ? ly / ll : 0) * l[i];
            error += w * e * e, contrast += w * rest * rest;
        }
    }
    return contrast > 0 ? metrics_decibel(error, contrast) : NAN;
}
