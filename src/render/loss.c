/* loss.c - (1 - w) L1 + w (1 - SSIM) between the rendered image x and the image y, and its gradient in x.
 *
 * SSIM is Wang et al. 2004: with mu, sigma the moments under an 11 x 11 Gaussian window of sigma 1.5, zero
 * padding,
 *     S = (2 mx my + C1)(2 sxy + C2) / ((mx^2 + my^2 + C1)(sxx + syy + C2)).
 * Only the sum sxx + syy occurs, so four blurred maps suffice: x, y, x^2 + y^2, xy. With D the derivatives of
 * S in the blurred x, x^2 + y^2 and xy,
 *     dS/dx = blur(D_x) + 2 x blur(D_xx) + y blur(D_xy).
 *
 * Both blurs are fused in one pass over a strip of rows, eight rows at a time. Ring buffers hold the rows in
 * reach: x and y, blurred vertically, then horizontally, into a row of derivatives; and the derivatives,
 * blurred horizontally, then vertically, into the gradient. All data stay in the cache, and strips can start
 * at any row.
 *
 * Invariant: each pixel's result and each row's sum is independent of the strips.
 */
#include "kernels.h"

#define LOSS_HALF 5 /* px: half width of the window */
/* rows blurred vertically together, which share loaded rows */
#define LOSS_BATCH 8
#define LOSS_REACH (LOSS_BATCH + 2 * LOSS_HALF) /* rows in reach of a batch's windows */
#define LOSS_PHASES 4                           /* see loss_columns */
/* zeros read past the end of a phase by the horizontal blur */
#define LOSS_GAP 2
#define LOSS_MAPS 4 /* of x and y: */
#define LOSS_X 0
#define LOSS_Y 1
#define LOSS_SQUARES 2     /* x^2 + y^2 */
#define LOSS_PRODUCT 3     /* xy */
#define LOSS_DERIVATIVES 3 /* of S in the blurred x, x^2 + y^2, xy */

#define LOSS_C1 ((real)1e-4) /* 0.01^2 */
#define LOSS_C2 ((real)9e-4) /* 0.03^2, unless the job has its own */

static const real LOSS_WINDOW[LOSS_HALF + 1] = {/* exp(-i^2 / (2 x 1.5^2)) for i = 5..0, all 11 together 1 */
                                                (real)0.00102838008447911, (real)0.00759875813523919,
                                                (real)0.03600077212843083, (real)0.10936068950970002,
                                                (real)0.21300553771125370, (real)0.26601172486179436};

struct loss_strip {
    const struct loss_job *job;
    const real *window_ok; /* (H,W) 1 where the whole SSIM window counts, or NULL */
    real l1_scale;         /* (1 - w) / number of unmasked values */
    real ssim_scale;       /* w / number of unmasked windows */
    real c2;
    int channel, first, end;   /* rows */
    size_t one;                /* 1, see loss_blur_horizontal */
    real *scratch;             /* loss_scratch_size(width) */
    double (*sums)[LOSS_SUMS]; /* (H) of this channel */
};

/* ---------------- rows in the scratch */

/* Stores a row in LOSS_PHASES phases: pixels 0, 4, 8..., then 1, 5, 9..., and so on. In the horizontal blur
 * each shifted load then serves four pixels; unaligned loads are its bottleneck. Each phase ends in at
 * least LOSS_GAP zeros; a pack of zeros is before and after the row. */
static size_t loss_columns(int width) /* computed columns of a phase: whole packs */
{
    return ((size_t)width + LOSS_PHASES * PACK - 1) / (LOSS_PHASES * PACK) * PACK;
}

static size_t loss_phase(int width) /* distance between phases */
{
    const size_t used = ((size_t)width + LOSS_PHASES - 1) / LOSS_PHASES;
    return (used + LOSS_GAP + PACK - 1) / PACK * PACK;
}

static size_t loss_stride(int width)
{
    return LOSS_PHASES * loss_phase(width) + 2 * PACK;
}

static size_t loss_scratch_size(int width)
{
    return loss_stride(width) *
           ((2 + LOSS_DERIVATIVES) * LOSS_REACH + LOSS_MAPS * LOSS_BATCH + LOSS_MAPS + LOSS_DERIVATIVES + 2);
}

struct loss_rows { /* layout of the scratch memory */
    size_t columns, phase, stride;
    real *x, *y; /* (LOSS_REACH, stride) rings */
    /* (LOSS_MAPS, LOSS_BATCH, stride) maps of a batch, blurred vertically; later its derivatives */
    real *vertical;
    real *blurred;    /* (LOSS_MAPS, stride) maps of one row, blurred horizontally, too */
    real *derivative; /* (LOSS_DERIVATIVES, stride) of one row */
    /* (LOSS_DERIVATIVES, LOSS_REACH, stride) rings of derivatives, blurred horizontally */
    real *derivative_rings;
    real *counts;   /* (stride) 1 or 0 for each pixel or window of a row, 0 past the ends */
    real *gradient; /* (stride) of one row */
};

SIMD_INLINE struct loss_rows loss_rows(const struct loss_strip *s)
{
    struct loss_rows r = {.columns = loss_columns(s->job->width),
                          .phase = loss_phase(s->job->width),
                          .stride = loss_stride(s->job->width),
                          .x = s->scratch + PACK};
    r.y = r.x + r.stride * LOSS_REACH;
    r.vertical = r.y + r.stride * LOSS_REACH;
    r.blurred = r.vertical + r.stride * LOSS_MAPS * LOSS_BATCH;
    r.derivative = r.blurred + r.stride * LOSS_MAPS;
    r.derivative_rings = r.derivative + r.stride * LOSS_DERIVATIVES;
    r.counts = r.derivative_rings + r.stride * LOSS_DERIVATIVES * LOSS_REACH;
    r.gradient = r.counts + r.stride;
    return r;
}

/* A row of a ring; rows start at -2 LOSS_HALF. */
SIMD_INLINE real *loss_ring(const struct loss_rows *r, real *ring, int row)
{
    return ring + (size_t)(row + LOSS_REACH) % LOSS_REACH * r->stride;
}

/* The rows of a ring in reach of the batch's windows. */
SIMD_INLINE void loss_reach(const struct loss_rows *r, real *ring, int batch, const real *rows[LOSS_REACH])
{
    for (int k = 0; k < LOSS_REACH; k++) rows[k] = loss_ring(r, ring, batch - LOSS_HALF + k);
}

SIMD_INLINE void loss_deinterleave(const real *restrict in, int width, size_t phase, real *restrict out)
{
    const size_t whole = (size_t)width / LOSS_PHASES;
#pragma omp simd
    for (size_t j = 0; j < whole; j++) {
        out[j] = in[4 * j];
        out[phase + j] = in[4 * j + 1];
        out[2 * phase + j] = in[4 * j + 2];
        out[3 * phase + j] = in[4 * j + 3];
    }
    for (size_t i = whole * LOSS_PHASES; i < (size_t)width; i++) out[i % LOSS_PHASES * phase + whole] = in[i];
}

SIMD_INLINE void loss_interleave(const real *restrict in, int width, size_t phase, real *restrict out)
{
    const size_t whole = (size_t)width / LOSS_PHASES;
#pragma omp simd
    for (size_t j = 0; j < whole; j++) {
        out[4 * j] = in[j];
        out[4 * j + 1] = in[phase + j];
        out[4 * j + 2] = in[2 * phase + j];
        out[4 * j + 3] = in[3 * phase + j];
    }
    for (size_t i = whole * LOSS_PHASES; i < (size_t)width; i++) out[i] = in[i % LOSS_PHASES * phase + whole];
}

/* A row of an image (3,H,W). */
SIMD_INLINE size_t loss_row_offset(const struct loss_strip *s, int row)
{
    return ((size_t)s->channel * s->job->height + (size_t)row) * (size_t)s->job->width;
}

/* A row of a weight map; without one the counts of loss_begin_counts stay. */
SIMD_INLINE void loss_fill_counts(const struct loss_strip *s, const struct loss_rows *r, const real *map,
                                  int row)
{
    if (map) loss_deinterleave(map + (size_t)row * s->job->width, s->job->width, r->phase, r->counts);
}

SIMD_INLINE void loss_begin_counts(const struct loss_strip *s, const struct loss_rows *r)
{
    for (int j = 0; !s->job->weight && j < s->job->width; j++)
        r->counts[(size_t)j % LOSS_PHASES * r->phase + (size_t)j / LOSS_PHASES] = 1;
}

/* ---------------- blurs */

SIMD_INLINE real loss_map(const int fused, const int map, real x, real y)
{
    return map == LOSS_X ? x : map == LOSS_Y ? y : map == LOSS_SQUARES ? muladd(fused, x, x, y * y) : x * y;
}

/* Two values of a map at equal distances from the centre of a window, which is symmetric. */
SIMD_INLINE real loss_two(const int fused, const int map, const real *const *x, const real *const *y,
                          const int k, size_t j)
{
    return loss_map(fused, map, x[k][j], y[k][j]) +
           loss_map(fused, map, x[2 * LOSS_HALF - k][j], y[2 * LOSS_HALF - k][j]);
}

/* A window of a map: x[k][j], y[k][j] are its k-th values. */
SIMD_INLINE real loss_window(const int fused, const int map, const real *const *x, const real *const *y,
                             size_t j)
{
    real sum = LOSS_WINDOW[0] * loss_two(fused, map, x, y, 0, j);
    sum = muladd(fused, LOSS_WINDOW[1], loss_two(fused, map, x, y, 1, j), sum);
    sum = muladd(fused, LOSS_WINDOW[2], loss_two(fused, map, x, y, 2, j), sum);
    sum = muladd(fused, LOSS_WINDOW[3], loss_two(fused, map, x, y, 3, j), sum);
    sum = muladd(fused, LOSS_WINDOW[4], loss_two(fused, map, x, y, 4, j), sum);
    return muladd(fused, LOSS_WINDOW[5], loss_map(fused, map, x[5][j], y[5][j]), sum);
}

/* Columns of all phases: a column's pixels are 4 j to 4 j + 3, so its windows reach from 4 j - 5 to 4 j + 8.
 * `one` is 1 but not a constant: otherwise clang reuses loads between columns and does not vectorise. */
SIMD_INLINE void loss_blur_horizontal(const int fused, const size_t one, const struct loss_rows *r,
                                      const real *row, real *restrict out)
{
    const real *p[LOSS_PHASES + 2 * LOSS_HALF];
    for (size_t k = 0; k < LOSS_PHASES + 2 * LOSS_HALF; k++)
        p[k] = row + (k + 3) % LOSS_PHASES * r->phase + (k + 3) / LOSS_PHASES * one - 2;
    for (size_t j0 = 0; j0 < r->columns; j0 += PACK) {
#pragma omp simd
        for (size_t j = j0; j < j0 + PACK; j++) {
            out[j] = loss_window(fused, LOSS_X, p, p, j);
            out[r->phase + j] = loss_window(fused, LOSS_X, p + 1, p + 1, j);
            out[2 * r->phase + j] = loss_window(fused, LOSS_X, p + 2, p + 2, j);
            out[3 * r->phase + j] = loss_window(fused, LOSS_X, p + 3, p + 3, j);
        }
    }
}

/* A pack of columns of a map, blurred vertically for the rows of a batch; x[k], y[k]: the k-th row in
 * reach. */
SIMD_INLINE void loss_blur_vertical(const int fused, const int map, const real *const x[LOSS_REACH],
                                    const real *const y[LOSS_REACH], size_t j0, size_t stride,
                                    real *restrict out)
{
#pragma omp simd
    for (size_t l = 0; l < PACK; l++) {
        out[l] = loss_window(fused, map, x, y, j0 + l);
        out[stride + l] = loss_window(fused, map, x + 1, y + 1, j0 + l);
        out[2 * stride + l] = loss_window(fused, map, x + 2, y + 2, j0 + l);
        out[3 * stride + l] = loss_window(fused, map, x + 3, y + 3, j0 + l);
        out[4 * stride + l] = loss_window(fused, map, x + 4, y + 4, j0 + l);
        out[5 * stride + l] = loss_window(fused, map, x + 5, y + 5, j0 + l);
        out[6 * stride + l] = loss_window(fused, map, x + 6, y + 6, j0 + l);
        out[7 * stride + l] = loss_window(fused, map, x + 7, y + 7, j0 + l);
    }
}

SIMD_INLINE real loss_sum_lanes(const real *lane) /* (PACK), pairwise */
{
    real half[PACK];
    memcpy(half, lane, sizeof half);
    for (int n = PACK / 2; n > 0; n /= 2)
        for (int l = 0; l < n; l++) half[l] += half[l + n];
    return half[0];
}

/* ---------------- the stages of the sweep */

/* Stage 1: a row of x and y into their rings; zeros outside the image. */
SIMD_INLINE void loss_load_row(const struct loss_strip *s, const struct loss_rows *r, int row)
{
    real *x = loss_ring(r, r->x, row), *y = loss_ring(r, r->y, row);
    if (row < 0 || row >= s->job->height) {
        memset(x, 0, LOSS_PHASES * r->phase * sizeof *x);
        memset(y, 0, LOSS_PHASES * r->phase * sizeof *y);
        return;
    }
    loss_deinterleave(s->job->x + loss_row_offset(s, row), s->job->width, r->phase, x);
    loss_deinterleave(s->job->y + loss_row_offset(s, row), s->job->width, r->phase, y);
}

/* Stage 2: the four maps, blurred vertically for the windows centred on the rows of a batch. */
SIMD_INLINE void loss_blur_maps(const int fused, const struct loss_rows *r, int batch)
{
    const real *x[LOSS_REACH], *y[LOSS_REACH];
    const size_t map = LOSS_BATCH * r->stride;
    loss_reach(r, r->x, batch, x);
    loss_reach(r, r->y, batch, y);
    for (size_t p = 0; p < LOSS_PHASES * r->phase; p += r->phase)
        for (size_t j = p; j < p + r->columns; j += PACK) {
            loss_blur_vertical(fused, LOSS_X, x, y, j, r->stride, r->vertical + j);
            loss_blur_vertical(fused, LOSS_Y, x, y, j, r->stride, r->vertical + map + j);
            loss_blur_vertical(fused, LOSS_SQUARES, x, y, j, r->stride, r->vertical + 2 * map + j);
            loss_blur_vertical(fused, LOSS_PRODUCT, x, y, j, r->stride, r->vertical + 3 * map + j);
        }
}

/* S and its derivatives (MATH 8, 9), of the blurred maps of a row: dx, dmsq, dmxy are dL/d(mx), dL/dM, dL/dP.
 * Returns the sum of S. */
SIMD_INLINE real loss_differentiate(const int fused, const struct loss_strip *s, const struct loss_rows *r)
{
    const real *restrict mx = r->blurred, *restrict my = mx + r->stride;
    const real *restrict msq = my + r->stride, *restrict mxy = msq + r->stride; /* M, P */
    const real *restrict counts = r->counts;
    real *restrict dx = r->derivative, *restrict dmsq = dx + r->stride, *restrict dmxy = dmsq + r->stride;
    real sum[PACK] = {0};
    const real c2 = s->c2;
    const real scale = -2 * s->ssim_scale; /* of S in L, times the 2 of dS/dmx and dS/dP */
    for (size_t p = 0; p < LOSS_PHASES * r->phase; p += r->phase)
        for (size_t j0 = p; j0 < p + r->columns; j0 += PACK) {
#pragma omp simd
            for (size_t l = 0; l < PACK; l++) {
                const size_t j = j0 + l;
                const real ux = mx[j], uy = my[j], uu = muladd(fused, ux, ux, uy * uy), uxy = ux * uy;
                /* S = a1 a2 / (b1 b2) = a1 q, the factors as in MATH 8 */
                const real a1 = muladd(fused, 2, uxy, LOSS_C1), a2 = muladd(fused, 2, mxy[j] - uxy, c2);
                const real b1 = uu + LOSS_C1, b2 = msq[j] - uu + c2, inverse = 1 / (b1 * b2);
                /* t = S / (b1 b2) */
                const real p = a1 * inverse, q = a2 * inverse, ssim = a1 * q, t = ssim * inverse;
                const real c = scale * counts[j];
                /* MATH 9: a2 and b2 hold -ux uy and -ux^2, hence the differences */
                dx[j] = c * (uy * (q - p) - ux * t * (b2 - b1));
                dmsq[j] = (real)-0.5 * c * t * b1; /* t b1 = S / b2 */
                dmxy[j] = c * p;
                sum[l] = muladd(fused, counts[j], ssim, sum[l]);
            }
        }
    return loss_sum_lanes(sum);
}

/* Stage 3: the maps of a row of the batch, blurred horizontally -> S and its derivatives there, blurred
 * horizontally, into their rings. */
SIMD_INLINE void loss_derivative_row(const int fused, const struct loss_strip *s, const struct loss_rows *r,
                                     int batch, int row)
{
    real sum;
    for (size_t k = 0; k < LOSS_MAPS; k++)
        loss_blur_horizontal(fused, s->one, r,
                             r->vertical + (k * LOSS_BATCH + (size_t)(row - batch)) * r->stride,
                             r->blurred + k * r->stride);
    loss_fill_counts(s, r, s->window_ok, row);
    sum = loss_differentiate(fused, s, r);
    for (size_t k = 0; k < LOSS_DERIVATIVES; k++)
        loss_blur_horizontal(fused, s->one, r, r->derivative + k * r->stride,
                             loss_ring(r, r->derivative_rings + k * LOSS_REACH * r->stride, row));
    if (row >= s->first && row < s->end) s->sums[row][LOSS_SUM_SSIM] = sum;
}

/* Outside the image: derivatives are 0. */
SIMD_INLINE void loss_clear_derivative_row(const struct loss_rows *r, int row)
{
    for (size_t k = 0; k < LOSS_DERIVATIVES; k++)
        memset(loss_ring(r, r->derivative_rings + k * LOSS_REACH * r->stride, row), 0,
               LOSS_PHASES * r->phase * sizeof *r->derivative_rings);
}

/* Stage 4: the derivatives, blurred vertically for the rows of a batch. */
SIMD_INLINE void loss_blur_derivatives(const int fused, const struct loss_rows *r, int batch)
{
    for (size_t k = 0; k < LOSS_DERIVATIVES; k++) {
        const real *rows[LOSS_REACH];
        loss_reach(r, r->derivative_rings + k * LOSS_REACH * r->stride, batch, rows);
        for (size_t p = 0; p < LOSS_PHASES * r->phase; p += r->phase)
            for (size_t j = p; j < p + r->columns; j += PACK)
                loss_blur_vertical(fused, LOSS_X, rows, rows, j, r->stride,
                                   r->vertical + k * LOSS_BATCH * r->stride + j);
    }
}

/* Stage 5: the gradient of a row of the batch, with the part of L1. */
SIMD_INLINE void loss_gradient_row(const int fused, const struct loss_strip *s, const struct loss_rows *r,
                                   int batch, int row)
{
    const real *restrict x = loss_ring(r, r->x, row), *restrict y = loss_ring(r, r->y, row);
    const real *restrict dx = r->vertical + (size_t)(row - batch) * r->stride;
    const real *restrict dmsq = dx + LOSS_BATCH * r->stride, *restrict dmxy = dmsq + LOSS_BATCH * r->stride;
    const real *restrict counts = r->counts;
    real *restrict out = r->gradient;
    real l1[PACK] = {0}, square[PACK] = {0};
    loss_fill_counts(s, r, s->job->weight, row);
    for (size_t p = 0; p < LOSS_PHASES * r->phase; p += r->phase)
        for (size_t j0 = p; j0 < p + r->columns; j0 += PACK) {
#pragma omp simd
            for (size_t l = 0; l < PACK; l++) {
                const size_t j = j0 + l;
                const real a = x[j], b = y[j], difference = a - b;
                const real sign = difference > 0 ? (real)1 : difference < 0 ? (real)-1 : 0;
                const real through = muladd(fused, 2 * a, dmsq[j], b * dmxy[j]);
                out[j] = dx[j] + through + s->l1_scale * counts[j] * sign;
                l1[l] += counts[j] * (difference < 0 ? -difference : difference);
                square[l] += counts[j] * difference * difference;
            }
        }
    loss_interleave(out, s->job->width, r->phase, s->job->dx + loss_row_offset(s, row));
    s->sums[row][LOSS_SUM_L1] = loss_sum_lanes(l1);
    s->sums[row][LOSS_SUM_SQUARE] = loss_sum_lanes(square);
}

SIMD_BODY void loss_strip_body(const int fused, const struct loss_strip *s)
{
    const struct loss_rows r = loss_rows(s);
    const int start = OXL_MAX(s->first - LOSS_HALF, 0), below = OXL_MIN(s->end + LOSS_HALF, s->job->height);
    loss_begin_counts(s, &r);
    for (int row = start - LOSS_HALF; row < start + LOSS_HALF; row++) loss_load_row(s, &r, row);
    for (int row = start - LOSS_HALF; row < start; row++) loss_clear_derivative_row(&r, row);
    for (int batch = start; batch < s->end + LOSS_HALF; batch += LOSS_BATCH) {
        const int previous = batch - LOSS_HALF; /* whose windows end in this batch */
        for (int row = batch + LOSS_HALF; row < batch + LOSS_HALF + LOSS_BATCH; row++)
            loss_load_row(s, &r, row);
        if (batch < below) loss_blur_maps(fused, &r, batch);
        for (int row = batch; row < batch + LOSS_BATCH; row++) {
            if (row < below) loss_derivative_row(fused, s, &r, batch, row);
            else loss_clear_derivative_row(&r, row);
        }
        if (previous + LOSS_BATCH > s->first) loss_blur_derivatives(fused, &r, previous);
        for (int row = OXL_MAX(previous, s->first); row < OXL_MIN(previous + LOSS_BATCH, s->end); row++)
            loss_gradient_row(fused, s, &r, previous, row);
    }
}

SIMD_DISPATCH(static, loss_strip, struct loss_strip)

/* ---------------- the whole image */

/* Marks pixels where `in` is not 0, too. */
static void loss_and(const real *restrict in, int count, real *restrict out)
{
    for (int x = 0; x < count; x++) out[x] *= (real)(in[x] > 0);
}

static void loss_fill(real *out, int count)
{
    for (int x = 0; x < count; x++) out[x] = 1;
}

/* Returns how many numbers are not 0. */
static int64_t loss_count(const real *in, int64_t count)
{
    int64_t found = 0;
    for (int64_t i = 0; i < count; i++) found += in[i] > 0;
    return found;
}

/* Fills scratch->valid (2,H,W): 1 where the 11 x 11 window inside the image is unmasked; then the same for
 * its row only. */
static oxl_result loss_valid_windows(oxl_context *ctx, const struct loss_job *job,
                                     struct loss_scratch *scratch, double *values, double *windows)
{
    const int width = job->width, height = job->height;
    const size_t w = (size_t)width, image = w * (size_t)height;
    const oxl_result rc = OXL_RESERVE(ctx, scratch->valid, 2 * image);
    real *valid = scratch->valid, *horizontal = valid + image;
    if (rc != OXL_OK) return rc;
#pragma omp parallel for schedule(static) num_threads(ctx->threads)
    for (int y = 0; y < height; y++) {
        const real *in = job->weight + (size_t)y * w;
        real *out = horizontal + (size_t)y * w;
        loss_fill(out, width);
        for (int k = -OXL_MIN(LOSS_HALF, width); k <= OXL_MIN(LOSS_HALF, width); k++)
            loss_and(in + OXL_MAX(k, 0), width - abs(k), out + OXL_MAX(-k, 0));
    }
#pragma omp parallel for schedule(static) num_threads(ctx->threads)
    for (int y = 0; y < height; y++) {
        loss_fill(valid + (size_t)y * w, width);
        for (int v = OXL_MAX(y - LOSS_HALF, 0); v <= OXL_MIN(y + LOSS_HALF, height - 1); v++)
            loss_and(horizontal + (size_t)v * w, width, valid + (size_t)y * w);
    }
    *values = 3 * (double)loss_count(job->weight, (int64_t)image);
    *windows = 3 * (double)loss_count(valid, (int64_t)image);
    return OXL_OK;
}

static void loss_add_up(const struct loss_job *job, double (*sums)[LOSS_SUMS], double values, double windows,
                        struct renderer_loss *out)
{
    double sum[LOSS_SUMS] = {0};
    for (int row = 0; row < 3 * job->height; row++)
        for (int k = 0; k < LOSS_SUMS; k++) sum[k] += sums[row][k];
    out->l1 = values > 0 ? sum[LOSS_SUM_L1] / values : 0;
    out->ssim = windows > 0 ? sum[LOSS_SUM_SSIM] / windows : 1;
    out->mse = values > 0 ? sum[LOSS_SUM_SQUARE] / values : 0;
    out->total = (1 - (double)job->ssim_weight) * out->l1 + (double)job->ssim_weight * (1 - out->ssim);
}

/* Clears the padding around rows, which must be 0. It is not written, so it is cleared once per width and
 * number of strips. */
static void loss_clear(struct loss_scratch *scratch, int width, size_t count)
{
    if (scratch->width != width || scratch->cleared < count) memset(scratch->rows, 0, count * sizeof(real));
    scratch->cleared = scratch->width == width ? OXL_MAX(scratch->cleared, count) : count;
    scratch->width = width;
}

OXL_INTERNAL oxl_result loss_forward_backward(oxl_context *ctx, const struct loss_job *job,
                                              struct loss_scratch *scratch, struct renderer_loss *out)
{
    const size_t pixels = (size_t)job->width * job->height, room = loss_scratch_size(job->width);
    /* pieces of the image, each a span of rows, in all three channels */
    const int pieces = ctx->threads, strips = 3 * pieces;
    double values = 3.0 * (double)pixels, windows = values;
    oxl_result rc = OXL_RESERVE(ctx, scratch->rows, room * (size_t)strips);
    if (rc == OXL_OK) rc = OXL_RESERVE(ctx, scratch->sums, 3 * (size_t)job->height);
    if (rc == OXL_OK && job->weight) rc = loss_valid_windows(ctx, job, scratch, &values, &windows);
    if (rc != OXL_OK) return rc;
    loss_clear(scratch, job->width, room * (size_t)strips);
#pragma omp parallel for schedule(static) num_threads(ctx->threads)
    for (int i = 0; i < strips; i++) { /* close to the thread's tiles (renderer.c), for cache locality */
        const struct loss_strip strip = {.job = job,
                                         .window_ok = job->weight ? scratch->valid : NULL,
                                         .l1_scale = values > 0 ? (1 - job->ssim_weight) / (real)values : 0,
                                         .ssim_scale = windows > 0 ? job->ssim_weight / (real)windows : 0,
                                         .c2 = job->c2 > 0 ? job->c2 : LOSS_C2,
                                         .channel = i % 3,
                                         .first = (int)((int64_t)job->height * (i / 3) / pieces),
                                         .end = (int)((int64_t)job->height * (i / 3 + 1) / pieces),
                                         .one = 1,
                                         .scratch = scratch->rows + room * (size_t)i,
                                         .sums = scratch->sums + (size_t)(i % 3) * (size_t)job->height};
        loss_strip(ctx->isa, &strip);
    }
    loss_add_up(job, scratch->sums, values, windows, out);
    return OXL_OK;
}

OXL_INTERNAL void loss_free(oxl_context *ctx, struct loss_scratch *scratch)
{
    OXL_FREE(ctx, scratch->rows, scratch->sums, scratch->valid);
    *scratch = (struct loss_scratch){0};
}
