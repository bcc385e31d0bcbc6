/* structure.c - compares what two images show, whatever their brightness and contrast.
 *
 * PSNR does not see whether a dark image of low contrast is there at all: a featureless glow has 34 dB on a
 * seabed under a vehicle's lamp, and SSIM, whose constants are those of a bright image, 0.92. So the mean of
 * the channels is band-passed (Gaussian of 1 px less Gaussian of 6 px, reflected at the edges), and the
 * normalised correlation of the two bands is taken: 1 the same structure, 0 none.
 *
 * Invariant: pixels are summed in order, so the result does not depend on the number of threads.
 */
#include "evaluate.h"

enum { STRUCTURE_FINE = 1, STRUCTURE_COARSE = 6 }; /* px */
enum { STRUCTURE_REACH = 4 };                      /* reach of a window, in sigma */
/* Counts a band of a smaller mean square as the rounding of images to 8 bits: (1/255)^2 / 12. */
#define STRUCTURE_NOISE 1.2816e-6
#define STRUCTURE_DARK 1e-20 /* Keeps a product of mean squares from 0, against division by it. */

struct structure_work {
    struct planes p; /* bands of a and b; grey; two for scratch; weights */
    double *weight;  /* (H,W) weights; NULL: all pixels count */
};

static void structure_blur(oxl_context *ctx, const struct structure_work *s, int sigma, const double *in,
                           double *out)
{
    planes_blur(ctx, &s->p, &(struct planes_window){sigma, STRUCTURE_REACH * sigma, .reflects = 1}, in, out);
}

/* Computes the mean of the pixels that count in each window; `in` is 0 where none counts.
 * weighted: (H,W) scratch. */
static void structure_mean(oxl_context *ctx, const struct structure_work *s, int sigma, const double *in,
                           double *out, double *weighted)
{
    structure_blur(ctx, s, sigma, in, out);
    if (!s->weight) return;
    structure_blur(ctx, s, sigma, s->weight, weighted);
    for (size_t i = 0; i < s->p.size; i++) out[i] = weighted[i] > 0 ? out[i] / weighted[i] : 0;
}

static void structure_band(oxl_context *ctx, const struct structure_work *s, const oxl_image *of, double *out)
{
    const size_t pixels = s->p.size;
    double *grey = s->p.plane[2], *coarse = s->p.plane[3], *work = s->p.plane[4];
    for (size_t i = 0; i < pixels; i++) {
        const double v = (metrics_clamped(of->rgb[i]) + metrics_clamped(of->rgb[pixels + i]) +
                          metrics_clamped(of->rgb[2 * pixels + i])) /
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
    const oxl_result rc = planes_begin(ctx, a, &s->p);
    if (rc != OXL_OK) return rc;
    s->weight = b->weight ? s->p.plane[5] : NULL;
    for (size_t i = 0; b->weight && i < s->p.size; i++) s->weight[i] = b->weight[i] > 0.5f;
    return OXL_OK;
}

/* Computes mean products of the bands over the pixels that count: aa, bb, ab. Returns their number. */
static double structure_products(const struct structure_work *s, double product[3])
{
    double *const *band = s->p.plane, counted = 0;
    product[0] = product[1] = product[2] = 0;
    for (size_t i = 0; i < s->p.size; i++) {
        product[0] += band[0][i] * band[0][i];
        product[1] += band[1][i] * band[1][i];
        product[2] += band[0][i] * band[1][i];
        counted += s->weight ? s->weight[i] : 1;
    }
    for (int k = 0; k < 3 && counted > 0; k++) product[k] /= counted;
    return counted;
}

oxl_result oxl_structure(oxl_context *ctx, const oxl_image *a, const oxl_image *b, double *out)
{
    struct structure_work s;
    double product[3];
    oxl_result rc;
    *out = NAN;
    rc = metrics_check(ctx, a, b);
    if (rc == OXL_OK) rc = structure_begin(ctx, a, b, &s);
    if (rc != OXL_OK) return rc;
    structure_band(ctx, &s, a, s.p.plane[0]);
    structure_band(ctx, &s, b, s.p.plane[1]);
    if (structure_products(&s, product) > 0 && product[1] > STRUCTURE_NOISE)
        *out = product[2] / sqrt(product[0] * product[1] + STRUCTURE_DARK);
    oxl_free(ctx, s.p.line);
    return OXL_OK;
}
