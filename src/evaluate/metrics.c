/* metrics.c - compares two images: PSNR, with and without the image's exposure, SSIM, MS-SSIM.
 *
 * Sources: SSIM of Wang et al. 2004 with the window of 3DGS (11 x 11 Gaussian of sigma 1.5, zero padding);
 * multi-scale SSIM of Wang et al. 2003, which uses only windows inside the image. Both are written plainly
 * and in double, independent of the training loss in loss.c, so that tests can compare the two.
 *
 * Invariant: rows are summed in order, so the result does not depend on the number of threads.
 */
#include "evaluate.h"
#include "../core/vecmath.h"

enum { METRICS_RADIUS = 5, METRICS_WINDOW = 2 * METRICS_RADIUS + 1 };
#define METRICS_SIGMA 1.5
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
    for (int y = 0; y < a->height; y++) {
        double row_error = 0, row_weight = 0;
        for (int x = 0; x < a->width; x++) {
            const size_t i = (size_t)y * a->width + x;
            const double w = b->weight ? b->weight[i] : 1;
            for (int c = 0; c < 3; c++) {
                const double d = OXL_MIN(1, gain[c] * metrics_shown(a->rgb[c * plane + i])) -
                                 metrics_shown(b->rgb[c * plane + i]);
                row_error += w * d * d;
            }
            row_weight += 3 * w;
        }
        error += row_error;
        weight += row_weight;
    }
    return metrics_decibel(error, weight);
}

/* Fits the factors of the channels of `a` by least squares. */
static void metrics_gain(const oxl_image *a, const oxl_image *b, double gain[3])
{
    const size_t plane = (size_t)a->width * a->height;
    double aa[3] = {0}, ab[3] = {0};
    for (int y = 0; y < a->height; y++)
        for (int x = 0; x < a->width; x++) {
            const size_t i = (size_t)y * a->width + x;
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

/* ---------------- windows */

/* Holds sums over the windows that are centred in a row, by channel: over all, and over those that lie
 * wholly in the image. */
struct metrics_row {
    double all[3], ssim[3], contrast[3];
    size_t all_windows, windows; /* numbers of windows of one channel */
};

struct metrics_windows {
    const oxl_image *a, *b;
    int whole; /* 1: leaves out windows that reach over the edge, in `all`, too; 0: outside is black */
    double kernel[METRICS_WINDOW];
    double *scratch;         /* (threads, METRICS_LINES, W + 2 METRICS_RADIUS) lines of each thread */
    struct metrics_row *row; /* (H) sums of each row */
};

static void metrics_kernel(double kernel[METRICS_WINDOW])
{
    double sum = 0;
    for (int i = 0; i < METRICS_WINDOW; i++) {
        const double d = i - METRICS_RADIUS;
        kernel[i] = vecmath_exp(-d * d / (2 * METRICS_SIGMA * METRICS_SIGMA));
        sum += kernel[i];
    }
    for (int i = 0; i < METRICS_WINDOW; i++) kernel[i] /= sum;
}

/* Holds a row of windows and its lines. Lines with METRICS_RADIUS more columns on either side hold 0
 * there: outside is black. */
struct metrics_line {
    const struct metrics_windows *s;
    int y;
    /* (W + 2 METRICS_RADIUS) moments blurred along y; number of masked pixels along y */
    double *column[5], *masked;
    double *ssim, *contrast, *touches; /* (W) values of the window around each pixel */
};
enum { METRICS_LINES = 9, METRICS_RUN = 16 };

/* Computes the five moments of one channel, of a, b, aa, bb and ab, blurred along y around the row;
 * outside of the image is black. */
SIMD_INLINE void metrics_blur_columns(const struct metrics_line *line, int channel)
{
    const struct metrics_windows *s = line->s;
    const int w = s->a->width, h = s->a->height, y = line->y;
    double *m0 = line->column[0] + METRICS_RADIUS, *m1 = line->column[1] + METRICS_RADIUS,
           *m2 = line->column[2] + METRICS_RADIUS;
    double *m3 = line->column[3] + METRICS_RADIUS, *m4 = line->column[4] + METRICS_RADIUS;
    for (int x = 0; x < w; x++) m0[x] = m1[x] = m2[x] = m3[x] = m4[x] = 0;
    for (int j = OXL_MAX(0, y - METRICS_RADIUS); j <= OXL_MIN(h - 1, y + METRICS_RADIUS); j++) {
        const size_t row = ((size_t)channel * h + j) * w;
        const double k = s->kernel[j - y + METRICS_RADIUS];
        const float *of_a = s->a->rgb + row, *of_b = s->b->rgb + row;
#pragma omp simd
        for (int x = 0; x < w; x++) {
            const double a = metrics_shown(of_a[x]), b = metrics_shown(of_b[x]);
            m0[x] += k * a;
            m1[x] += k * b;
            m2[x] += k * a * a;
            m3[x] += k * b * b;
            m4[x] += k * a * b;
        }
    }
}

SIMD_INLINE void metrics_mark_columns(const struct metrics_line *line)
{
    const oxl_image *b = line->s->b;
    double *masked = line->masked + METRICS_RADIUS;
    for (int x = 0; x < b->width; x++) masked[x] = 0;
    if (!b->weight) return;
    for (int j = OXL_MAX(0, line->y - METRICS_RADIUS); j <= OXL_MIN(b->height - 1, line->y + METRICS_RADIUS);
         j++)
        for (int x = 0; x < b->width; x++) masked[x] += b->weight[(size_t)j * b->width + x] <= 0.5f;
}

/* Computes Wang 2004, eq. 13, with its exponents 1. *contrast: the same without luminance,
 * c s of Wang 2003, eq. 7. */
SIMD_INLINE double metrics_similarity(const double m[5], double *contrast)
{
    const double mean_ab = m[0] * m[1], mean_aa = m[0] * m[0], mean_bb = m[1] * m[1];
    const double variance_a = m[2] - mean_aa, variance_b = m[3] - mean_bb, covariance = m[4] - mean_ab;
    *contrast = (2 * covariance + METRICS_C2) / (variance_a + variance_b + METRICS_C2);
    return (2 * mean_ab + METRICS_C1) / (mean_aa + mean_bb + METRICS_C1) * *contrast;
}

/* Blurs along x and compares the windows around METRICS_RUN pixels of the row from x on. */
SIMD_INLINE void metrics_compare_run(const struct metrics_line *line, int x)
{
    double m[5][METRICS_RUN] = {{0}}, touches[METRICS_RUN] = {0};
    for (int j = 0; j < METRICS_WINDOW; j++) {
        const double k = line->s->kernel[j];
        for (int q = 0; q < 5; q++) {
            const double *column = line->column[q] + x + j;
#pragma omp simd
            for (int l = 0; l < METRICS_RUN; l++) m[q][l] += k * column[l];
        }
        for (int l = 0; l < METRICS_RUN; l++) touches[l] += line->masked[x + j + l];
    }
#pragma omp simd
    for (int l = 0; l < METRICS_RUN; l++) {
        const double moments[5] = {m[0][l], m[1][l], m[2][l], m[3][l], m[4][l]};
        line->ssim[x + l] = metrics_similarity(moments, &line->contrast[x + l]);
    }
    memcpy(line->touches + x, touches, sizeof touches);
}

/* Adds the windows of one channel; leaves out those that touch a masked pixel. */
static void metrics_add_windows(const struct metrics_line *line, int channel, struct metrics_row *row)
{
    const int w = line->s->a->width, h = line->s->a->height, r = METRICS_RADIUS;
    const int edge = line->s->whole ? r : 0, first = line->y < r || line->y >= h - r ? w : r;
    row->all_windows = row->windows = 0;
    for (int x = edge; x < w - edge; x++) {
        if (line->touches[x] > 0) continue;
        row->all[channel] += line->ssim[x];
        row->all_windows++;
        if (x < first || x >= w - r) continue;
        row->ssim[channel] += line->ssim[x];
        row->contrast[channel] += line->contrast[x];
        row->windows++;
    }
}

SIMD_BODY void metrics_line_body(const int fused, const struct metrics_line *line)
{
    (void)fused;
    metrics_mark_columns(line);
    for (int c = 0; c < 3; c++) {
        metrics_blur_columns(line, c);
        for (int x = 0; x < line->s->a->width; x += METRICS_RUN) metrics_compare_run(line, x);
        metrics_add_windows(line, c, &line->s->row[line->y]);
    }
}

SIMD_DISPATCH(static, metrics_line, struct metrics_line)

/* Returns the columns of a line: whole runs, and METRICS_RADIUS columns on either side. */
static size_t metrics_room(int width)
{
    return ((size_t)width + METRICS_RUN - 1) / METRICS_RUN * METRICS_RUN + 2 * METRICS_RADIUS;
}

static void metrics_rows(oxl_context *ctx, const struct metrics_windows *s)
{
    const size_t width = metrics_room(s->a->width);
    const int edge = s->whole ? METRICS_RADIUS : 0;
#pragma omp parallel for schedule(static) num_threads(ctx->threads)
    for (int y = edge; y < s->a->height - edge; y++) {
        double *at = s->scratch + METRICS_LINES * (size_t)context_thread() * width;
        struct metrics_line line = {.s = s, .y = y};
        for (int q = 0; q < 5; q++, at += width) line.column[q] = at;
        line.masked = at, line.ssim = at + width, line.contrast = at + 2 * width,
        line.touches = at + 3 * width;
        metrics_line(ctx->isa, &line);
    }
}

/* Sums the windows of the image, row by row. */
static oxl_result metrics_sum_windows(oxl_context *ctx, const oxl_image *a, const oxl_image *b, int whole,
                                      struct metrics_row *out)
{
    struct metrics_windows s = {.a = a, .b = b, .whole = whole};
    oxl_result rc = OXL_OK;
    *out = (struct metrics_row){.windows = 0};
    s.scratch =
        oxl_calloc(ctx, metrics_room(a->width) * (size_t)ctx->threads, METRICS_LINES * sizeof *s.scratch);
    s.row = oxl_calloc(ctx, (size_t)a->height, sizeof *s.row);
    if (!s.scratch || !s.row) rc = OXL_ERR_MEMORY;
    metrics_kernel(s.kernel);
    if (rc == OXL_OK) metrics_rows(ctx, &s);
    for (int y = 0; rc == OXL_OK && y < a->height; y++) {
        for (int c = 0; c < 3; c++) {
            out->all[c] += s.row[y].all[c];
            out->ssim[c] += s.row[y].ssim[c];
            out->contrast[c] += s.row[y].contrast[c];
        }
        out->all_windows += s.row[y].all_windows;
        out->windows += s.row[y].windows;
    }
    OXL_FREE(ctx, s.scratch, s.row);
    return rc;
}

/* ---------------- SSIM and MS-SSIM */

/* Lists the exponents of the scales, the finest first [Wang 2003]. */
static const double METRICS_SCALES[] = {0.0448, 0.2856, 0.3001, 0.2363, 0.1333};

/* Halves an image to means of 2 x 2 pixels; drops a last odd row or column. A pixel
 * counts if its four pixels do. */
static oxl_result metrics_halve(oxl_context *ctx, const oxl_image *in, oxl_image *out)
{
    const int w = in->width / 2, h = in->height / 2;
    const size_t wide = (size_t)in->width, plane = wide * in->height, small = (size_t)w * h;
    oxl_result rc = oxl_image_create(ctx, w, h, out);
    if (rc == OXL_OK && in->weight && !(out->weight = oxl_alloc(ctx, small, sizeof *out->weight)))
        rc = OXL_ERR_MEMORY;
    if (rc != OXL_OK) return rc;
    for (size_t i = 0; i < small; i++) {
        const size_t at = 2 * (i / w) * wide + 2 * (i % w);
        for (int c = 0; c < 3; c++) {
            const float *p = in->rgb + c * plane + at;
            const double four = metrics_shown(p[0]) + metrics_shown(p[1]) + metrics_shown(p[wide]) +
                                metrics_shown(p[wide + 1]);
            out->rgb[c * small + i] = (float)(four / 4);
        }
        if (out->weight) {
            const float *p = in->weight + at;
            out->weight[i] = p[0] > 0.5f && p[1] > 0.5f && p[wide] > 0.5f && p[wide + 1] > 0.5f;
        }
    }
    return OXL_OK;
}

/* Computes the product over scales for each channel, and the mean of these. Divides the exponents by the
 * sum of those that are used. */
static double metrics_over_scales(const struct metrics_row *sum, int scales)
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
                                          struct metrics_row sum[], double ssim, double *out)
{
    enum { MOST = OXL_COUNT(METRICS_SCALES) };
    oxl_image half[MOST][2] = {{{0}}};
    int scales = 0;
    oxl_result rc = OXL_OK;
    while (OXL_MIN(a->width, a->height) >= METRICS_WINDOW) {
        if (scales > 0) rc = metrics_sum_windows(ctx, a, b, 1, &sum[scales]);
        if (rc != OXL_OK || sum[scales].windows == 0 || ++scales == MOST) break;
        rc = metrics_halve(ctx, a, &half[scales][0]);
        if (rc == OXL_OK) rc = metrics_halve(ctx, b, &half[scales][1]);
        if (rc != OXL_OK) break;
        a = &half[scales][0], b = &half[scales][1];
    }
    if (rc == OXL_OK) *out = scales > 0 ? metrics_over_scales(sum, scales) : ssim;
    for (int k = 0; k < MOST; k++)
        for (int i = 0; i < 2; i++) oxl_image_free(ctx, &half[k][i]);
    return rc;
}

OXL_INTERNAL oxl_result metrics_ssim(oxl_context *ctx, const oxl_image *a, const oxl_image *b, double *ssim,
                                     double *ms_ssim)
{
    struct metrics_row sum[OXL_COUNT(METRICS_SCALES)];
    oxl_result rc = metrics_check(ctx, a, b);
    *ssim = 0;
    if (ms_ssim) *ms_ssim = 0;
    if (rc == OXL_OK) rc = metrics_sum_windows(ctx, a, b, 0, sum);
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
