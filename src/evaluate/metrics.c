/* metrics.c - compares two images: PSNR, with and without the image's exposure, SSIM, MS-SSIM.
 *
 * Sources: SSIM of Wang et al. 2004 with the window of 3DGS (11 x 11 Gaussian of sigma 1.5, zero padding);
 * multi-scale SSIM of Wang et al. 2003, which uses only windows inside the image. Both are written plainly
 * and in double, independent of the training loss in loss.c, so that tests can compare the two.
 *
 * Invariant: pixels are summed in order, so the result does not depend on the number of threads.
 */
#include "evaluate.h"
#include "../core/vecmath.h"

enum { METRICS_RADIUS = 5, METRICS_WINDOW = 2 * METRICS_RADIUS + 1 };
static const struct planes_window metrics_window = {1.5, METRICS_RADIUS, .reflects = 0};
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
            const double d = OXL_MIN(1, gain[c] * metrics_shown(a->rgb[c * plane + i])) -
                             metrics_shown(b->rgb[c * plane + i]);
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
            const double v = metrics_shown(a->rgb[c * plane + i]);
            aa[c] += w * v * v;
            ab[c] += w * v * metrics_shown(b->rgb[c * plane + i]);
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

/* ---------------- SSIM and MS-SSIM */

/* Holds sums over windows, by channel: over all, outside of the image black, and over those that lie wholly
 * in the image. */
struct metrics_sums {
    double all[3], ssim[3], contrast[3];
    size_t all_windows, windows; /* numbers of windows of one channel */
};

enum { METRICS_MOMENTS = 5, METRICS_RAW = METRICS_MOMENTS, METRICS_MASKED };

/* Computes Wang 2004, eq. 13, with its exponents 1, from the moments m. *contrast: the same without
 * luminance, c s of Wang 2003, eq. 7. */
static double metrics_similarity(double *const m[METRICS_MOMENTS], size_t i, double *contrast)
{
    const double mean_ab = m[0][i] * m[1][i], mean_aa = m[0][i] * m[0][i], mean_bb = m[1][i] * m[1][i];
    const double variance = m[2][i] - mean_aa + (m[3][i] - mean_bb), covariance = m[4][i] - mean_ab;
    *contrast = (2 * covariance + METRICS_C2) / (variance + METRICS_C2);
    return (2 * mean_ab + METRICS_C1) / (mean_aa + mean_bb + METRICS_C1) * *contrast;
}

/* Blurs the moments of one channel, of a, b, aa, bb and ab. */
static void metrics_blur(oxl_context *ctx, const struct planes *p, const float *a, const float *b)
{
    for (int q = 0; q < METRICS_MOMENTS; q++) {
        for (size_t i = 0; i < p->size; i++) {
            const double x = metrics_shown(a[i]), y = metrics_shown(b[i]);
            p->plane[METRICS_RAW][i] = q == 0 ? x : q == 1 ? y : q == 2 ? x * x : q == 3 ? y * y : x * y;
        }
        planes_blur(ctx, p, &metrics_window, p->plane[METRICS_RAW], p->plane[q]);
    }
}

/* Sums the windows of one channel; leaves out those that touch a masked pixel. */
static void metrics_add_windows(const struct planes *p, int masks, int c, struct metrics_sums *out)
{
    const int r = METRICS_RADIUS;
    for (size_t i = 0; i < p->size; i++) {
        const int x = (int)(i % (size_t)p->width), y = (int)(i / (size_t)p->width);
        double contrast;
        const double ssim = metrics_similarity(p->plane, i, &contrast);
        if (masks && p->plane[METRICS_MASKED][i] > 0) continue;
        out->all[c] += ssim;
        out->all_windows += c == 0;
        if (x < r || y < r || x >= p->width - r || y >= p->height - r) continue;
        out->ssim[c] += ssim;
        out->contrast[c] += contrast;
        out->windows += c == 0;
    }
}

static oxl_result metrics_sum_windows(oxl_context *ctx, const oxl_image *a, const oxl_image *b,
                                      struct metrics_sums *out)
{
    struct planes p;
    const oxl_result rc = planes_begin(ctx, a, &p);
    *out = (struct metrics_sums){.windows = 0};
    if (rc != OXL_OK) return rc;
    for (size_t i = 0; b->weight && i < p.size; i++) p.plane[METRICS_RAW][i] = b->weight[i] <= 0.5f;
    if (b->weight) planes_blur(ctx, &p, &metrics_window, p.plane[METRICS_RAW], p.plane[METRICS_MASKED]);
    for (int c = 0; c < 3; c++) {
        metrics_blur(ctx, &p, a->rgb + c * p.size, b->rgb + c * p.size);
        metrics_add_windows(&p, b->weight != NULL, c, out);
    }
    planes_free(ctx, &p);
    return OXL_OK;
}

/* Lists the exponents of the scales, the finest first [Wang 2003]. */
static const double METRICS_SCALES[] = {0.0448, 0.2856, 0.3001, 0.2363, 0.1333};

/* Copies an image, to be halved, as it is shown. */
static oxl_result metrics_copy(oxl_context *ctx, const oxl_image *in, oxl_image *out)
{
    const size_t pixels = (size_t)in->width * (size_t)in->height;
    oxl_result rc = oxl_image_create(ctx, in->width, in->height, out);
    if (rc == OXL_OK && in->weight && !(out->weight = oxl_alloc(ctx, pixels, sizeof *out->weight)))
        rc = OXL_ERR_MEMORY;
    for (size_t i = 0; rc == OXL_OK && i < 3 * pixels; i++) out->rgb[i] = (float)metrics_shown(in->rgb[i]);
    for (size_t i = 0; rc == OXL_OK && in->weight && i < pixels; i++) out->weight[i] = in->weight[i] > 0.5f;
    return rc;
}

/* Computes the product over scales for each channel, and the mean of these. Divides the exponents by the
 * sum of those that are used. */
static double metrics_over_scales(const struct metrics_sums *sum, int scales)
{
    double used = 0, mean = 0;
    for (int k = 0; k < scales; k++) used += METRICS_SCALES[k];
    for (int c = 0; c < 3; c++) {
        double log_product = 0;
        for (int k = 0; k < scales; k++) {
            /* Takes luminance at the coarsest scale only. */
            const double of = k < scales - 1 ? sum[k].contrast[c] : sum[k].ssim[c];
            log_product +=
                of > 0 ? METRICS_SCALES[k] / used * vecmath_log(of / (double)sum[k].windows) : -HUGE_VAL;
        }
        mean += vecmath_exp(log_product) / 3;
    }
    return mean;
}

/* Computes MS-SSIM from the windows of the image itself, `sum`, on. The scales end when no whole window is
 * left; without any it is SSIM. */
static oxl_result metrics_multiply_scales(oxl_context *ctx, const oxl_image *a, const oxl_image *b,
                                          struct metrics_sums sum[], double ssim, double *out)
{
    enum { MOST = OXL_COUNT(METRICS_SCALES) };
    oxl_image half[2] = {{0}};
    int scales = 0;
    oxl_result rc = metrics_copy(ctx, a, &half[0]);
    if (rc == OXL_OK) rc = metrics_copy(ctx, b, &half[1]);
    while (rc == OXL_OK && OXL_MIN(half->width, half->height) >= METRICS_WINDOW) {
        if (scales > 0) rc = metrics_sum_windows(ctx, &half[0], &half[1], &sum[scales]);
        if (rc != OXL_OK || sum[scales].windows == 0 || ++scales == MOST) break;
        for (oxl_image *image = half; image < half + 2; image++) {
            image_halve(image->width, image->height, image->rgb, image->weight);
            image->width /= 2, image->height /= 2;
        }
    }
    if (rc == OXL_OK) *out = scales > 0 ? metrics_over_scales(sum, scales) : ssim;
    for (int i = 0; i < 2; i++) oxl_image_free(ctx, &half[i]);
    return rc;
}

OXL_INTERNAL oxl_result metrics_ssim(oxl_context *ctx, const oxl_image *a, const oxl_image *b, double *ssim,
                                     double *ms_ssim)
{
    struct metrics_sums sum[OXL_COUNT(METRICS_SCALES)];
    oxl_result rc = metrics_check(ctx, a, b);
    *ssim = 0;
    if (ms_ssim) *ms_ssim = 0;
    if (rc == OXL_OK) rc = metrics_sum_windows(ctx, a, b, sum);
    if (rc != OXL_OK) return rc;
    if (sum->all_windows == 0)
        return metrics_fail_masked(ctx, "every window touches a masked pixel, so there is no SSIM");
    *ssim = (sum->all[0] + sum->all[1] + sum->all[2]) / (3 * (double)sum->all_windows);
    return ms_ssim ? metrics_multiply_scales(ctx, a, b, sum, *ssim, ms_ssim) : OXL_OK;
}

oxl_result oxl_ssim(oxl_context *ctx, const oxl_image *a, const oxl_image *b, double *out)
{
    return metrics_ssim(ctx, a, b, out, NULL);
}

oxl_result oxl_ms_ssim(oxl_context *ctx, const oxl_image *a, const oxl_image *b, double *out)
{
    double ssim;
    return metrics_ssim(ctx, a, b, &ssim, out);
}
