/* metrics.c - compares two images: PSNR, with and without the image's exposure, and SSIM.
 *
 * Source: SSIM of Wang et al. 2004 with the window of 3DGS (11 x 11 Gaussian of sigma 1.5, zero padding).
 * It is written plainly and in double, independent of the training loss in loss.c, so that tests can compare
 * the two.
 *
 * Invariant: pixels are summed in order, so the result does not depend on the number of threads.
 */
#include "evaluate.h"
#include "../core/vecmath.h"

static const struct planes_window metrics_window = {1.5, 5, .reflects = 0};
#define METRICS_C1 (0.01 * 0.01) /* Is (k1 L)^2 with L = 1 [Wang 2004]. */
#define METRICS_C2 (0.03 * 0.03)
#define METRICS_BEST_PSNR 100.0 /* Limits PSNR (dB), which is infinite for identical images. */

OXL_INTERNAL double metrics_decibel(double error, double weight)
{
    if (!(weight > 0)) return NAN;
    return error > 0 ? OXL_MIN(METRICS_BEST_PSNR, -VECMATH_DECIBEL_OF_E * vecmath_log(error / weight))
                     : METRICS_BEST_PSNR;
}

OXL_INTERNAL oxl_result metrics_check(oxl_context *ctx, const oxl_image *a, const oxl_image *b)
{
    if (a->rgb && b->rgb && a->width == b->width && a->height == b->height && a->width > 0 && a->height > 0)
        return OXL_OK;
    return oxl_fail(ctx, OXL_ERR_USAGE,
                    "images of %d x %d and %d x %d px cannot be compared\nfix: render at the image's size",
                    a->width, a->height, b->width, b->height);
}

static oxl_result metrics_fail_masked(oxl_context *ctx, const char *what)
{
    return oxl_fail(ctx, OXL_ERR_INPUT, "%s\nfix: use white (255) for the pixels that count", what);
}

/* ---------------- PSNR */

/* Returns the PSNR of `a` times gain, channel by channel, against b; NaN: every pixel
 * is masked. It is serial, since it takes a hundredth of the rendering. */
static double metrics_psnr(const oxl_image *a, const oxl_image *b, const double gain[3])
{
    const size_t plane = (size_t)a->width * a->height;
    double error = 0, weight = 0;
    for (size_t i = 0; i < plane; i++) {
        const double w = b->weight ? b->weight[i] : 1;
        for (int c = 0; c < 3; c++) {
            const double d = OXL_MIN(1, gain[c] * metrics_clamped(a->rgb[c * plane + i])) -
                             metrics_clamped(b->rgb[c * plane + i]);
            error += w * d * d;
        }
        weight += 3 * w;
    }
    return metrics_decibel(error, weight);
}

/* Fits the factors of the channels of `a` by least squares. */
static void metrics_gain(const oxl_image *a, const oxl_image *b, double gain[3])
{
    const size_t plane = (size_t)a->width * a->height;
    double aa[3] = {0}, ab[3] = {0};
    for (size_t i = 0; i < plane; i++) {
        const double w = b->weight ? b->weight[i] : 1;
        for (int c = 0; c < 3; c++) {
            const double v = metrics_clamped(a->rgb[c * plane + i]);
            aa[c] += w * v * v;
            ab[c] += w * v * metrics_clamped(b->rgb[c * plane + i]);
        }
    }
    for (int c = 0; c < 3; c++) gain[c] = aa[c] > 0 ? ab[c] / aa[c] : 1;
}

static oxl_result metrics_compare(oxl_context *ctx, const oxl_image *a, const oxl_image *b, int corrected,
                                  double *out)
{
    double gain[3] = {1, 1, 1}, decibel;
    *out = 0;
    if (metrics_check(ctx, a, b) != OXL_OK) return ctx->failed;
    if (corrected) metrics_gain(a, b, gain);
    decibel = metrics_psnr(a, b, gain);
    if (isnan(decibel)) return metrics_fail_masked(ctx, "every pixel is masked, so there is no PSNR");
    *out = decibel;
    return OXL_OK;
}

oxl_result oxl_psnr(oxl_context *ctx, const oxl_image *a, const oxl_image *b, double *out)
{
    return metrics_compare(ctx, a, b, 0, out);
}

oxl_result oxl_cc_psnr(oxl_context *ctx, const oxl_image *a, const oxl_image *b, double *out)
{
    return metrics_compare(ctx, a, b, 1, out);
}

/* ---------------- SSIM */

enum { METRICS_MOMENTS = 5, METRICS_RAW = METRICS_MOMENTS, METRICS_MASKED };

/* Computes Wang 2004, eq. 13, with its exponents 1, from the moments m. */
static double metrics_similarity(double *const m[METRICS_MOMENTS], size_t i)
{
    const double mean_ab = m[0][i] * m[1][i], mean_aa = m[0][i] * m[0][i], mean_bb = m[1][i] * m[1][i];
    const double variance = m[2][i] - mean_aa + (m[3][i] - mean_bb), covariance = m[4][i] - mean_ab;
    const double contrast = (2 * covariance + METRICS_C2) / (variance + METRICS_C2);
    return (2 * mean_ab + METRICS_C1) / (mean_aa + mean_bb + METRICS_C1) * contrast;
}

/* Blurs the moments of one channel, of a, b, aa, bb and ab. */
static void metrics_blur(oxl_context *ctx, const struct planes *p, const float *a, const float *b)
{
    for (int q = 0; q < METRICS_MOMENTS; q++) {
        for (size_t i = 0; i < p->size; i++) {
            const double x = metrics_clamped(a[i]), y = metrics_clamped(b[i]);
            p->plane[METRICS_RAW][i] = q == 0 ? x : q == 1 ? y : q == 2 ? x * x : q == 3 ? y * y : x * y;
        }
        planes_blur(ctx, p, &metrics_window, p->plane[METRICS_RAW], p->plane[q]);
    }
}

oxl_result oxl_ssim(oxl_context *ctx, const oxl_image *a, const oxl_image *b, double *out)
{
    struct planes p;
    double sum[3] = {0};
    size_t windows = 0; /* of all channels; those that touch a masked pixel are left out */
    oxl_result rc = metrics_check(ctx, a, b);
    *out = 0;
    if (rc == OXL_OK) rc = planes_begin(ctx, a, &p);
    if (rc != OXL_OK) return rc;
    for (size_t i = 0; i < p.size; i++) p.plane[METRICS_RAW][i] = b->weight && b->weight[i] <= 0.5f;
    planes_blur(ctx, &p, &metrics_window, p.plane[METRICS_RAW], p.plane[METRICS_MASKED]);
    for (int c = 0; c < 3; c++) {
        metrics_blur(ctx, &p, a->rgb + c * p.size, b->rgb + c * p.size);
        for (size_t i = 0; i < p.size; i++)
            if (p.plane[METRICS_MASKED][i] <= 0) sum[c] += metrics_similarity(p.plane, i), windows++;
    }
    oxl_free(ctx, p.line);
    if (windows == 0)
        return metrics_fail_masked(ctx, "every window touches a masked pixel, so there is no SSIM");
    *out = (sum[0] + sum[1] + sum[2]) / (double)windows;
    return OXL_OK;
}
