/* loss.c - (1 - w) L1 + w (1 - SSIM) between a drawn image and a photograph, and its gradient in the drawn image.
 *
 * SSIM is Wang et al. 2004: with mu, sigma the moments under an 11 x 11 Gaussian window of sigma 1.5, zero padding,
 *     S = (2 mx my + C1)(2 sxy + C2) / ((mx^2 + my^2 + C1)(sxx + syy + C2)).
 * Only the sum sxx + syy occurs, so four blurred maps serve: x, y, x^2 + y^2, xy. With D the derivatives of S in the blurred x,
 * x^2 + y^2 and xy,
 *     dS/dx = blur(D_x) + 2 x blur(D_xx) + y blur(D_xy).
 *
 * Both blurs are fused in one sweep down a strip of rows: a ring of 11 rows of blurred maps gives a row of derivatives, a second
 * ring of 11 rows of those gives a row of the gradient. Everything stays in the cache, and strips can be cut anywhere.
 *
 * Invariant: each pixel's result and each row's sum is computed alike, wherever the strips are cut.
 */
#include "kernels.h"

#define LOSS_TAPS        11
#define LOSS_HALF        5 /* px: the window reaches this far */
#define LOSS_MAPS        4 /* x, y, x^2 + y^2, xy */
#define LOSS_DERIVATIVES 3 /* of S in the blurred x, x^2 + y^2, xy */
#define LOSS_SUMS        3 /* |x - y|, S, (x - y)^2 */

#define LOSS_C1 ((real)1e-4) /* 0.01^2 */
#define LOSS_C2 ((real)9e-4) /* 0.03^2 */

static const real LOSS_WINDOW[LOSS_TAPS] = {/* exp(-i^2 / (2 x 1.5^2)), normalised */
                                            (real)0.00102838008447911, (real)0.00759875813523919, (real)0.03600077212843083,
                                            (real)0.10936068950970002, (real)0.21300553771125370, (real)0.26601172486179436,
                                            (real)0.21300553771125370, (real)0.10936068950970002, (real)0.03600077212843083,
                                            (real)0.00759875813523919, (real)0.00102838008447911};

struct loss_strip {
    const struct loss_job *job;
    const real            *window_ok;           /* (H,W) 1 where the whole SSIM window counts, or NULL */
    real                   l1_scale;            /* (1 - w) / number of values that count */
    real                   ssim_scale;          /* w / number of windows that count */
    int                    channel, first, end; /* rows */
    real                  *scratch;             /* loss_scratch_size(width) */
    double (*sums)[LOSS_SUMS];                  /* (H) of this channel: |x - y|, SSIM, (x - y)^2 */
};

/* Rows are padded by zeros to both sides and to whole vectors. */
static size_t loss_stride(int width)
{
    return ((size_t)width + 2 * LOSS_HALF + 2 * PACK) / PACK * PACK;
}

static size_t loss_scratch_size(int width)
{
    return loss_stride(width) * (LOSS_MAPS + LOSS_TAPS * LOSS_MAPS + LOSS_DERIVATIVES + LOSS_TAPS * LOSS_DERIVATIVES + 1);
}

struct loss_rows { /* the scratch, cut up */
    size_t stride;
    real  *input;      /* (LOSS_MAPS, stride) the maps of one row, padded */
    real  *blurred;    /* (LOSS_TAPS, LOSS_MAPS, stride) ring */
    real  *derivative; /* (LOSS_DERIVATIVES, stride) of one row, padded */
    real  *returned;   /* (LOSS_TAPS, LOSS_DERIVATIVES, stride) ring */
    real  *counts;     /* (stride) 1 or 0 for each pixel or window of the row, 0 past its end */
};

static struct loss_rows loss_rows(const struct loss_strip *s)
{
    struct loss_rows r = {.stride = loss_stride(s->job->width), .input = s->scratch};
    r.blurred          = r.input + r.stride * LOSS_MAPS;
    r.derivative       = r.blurred + r.stride * LOSS_TAPS * LOSS_MAPS;
    r.returned         = r.derivative + r.stride * LOSS_DERIVATIVES;
    r.counts           = r.returned + r.stride * LOSS_TAPS * LOSS_DERIVATIVES;
    return r;
}

static int loss_ring(int row) /* rows start at -10 */
{
    return (row + 2 * LOSS_TAPS) % LOSS_TAPS;
}

/* ---------------------------------------------------------------- blurs */

/* in is padded: in[j] lies LOSS_HALF left of out[j]; out is written up to a whole pack. Taps outside, pixels inside: the other
 * way round clang carries loads from one pixel to the next and then cannot vectorise. */
SIMD_INLINE void loss_blur_along(const int fused, const real *restrict in, int n, real *restrict out)
{
    for (int j = 0; j < n; j += PACK) {
        real sum[PACK] = {0};
        for (int k = 0; k < LOSS_TAPS; k++) {
#pragma omp simd
            for (int l = 0; l < PACK; l++) sum[l] = muladd(fused, LOSS_WINDOW[k], in[j + k + l], sum[l]);
        }
        memcpy(out + j, sum, sizeof sum);
    }
}

/* One pixel column of a ring: rows[k][j], k from the top row of the window. */
SIMD_INLINE real loss_blur_down(const int fused, const real *const rows[LOSS_TAPS], size_t j)
{
    real sum = LOSS_WINDOW[0] * rows[0][j];
    sum      = muladd(fused, LOSS_WINDOW[1], rows[1][j], sum);
    sum      = muladd(fused, LOSS_WINDOW[2], rows[2][j], sum);
    sum      = muladd(fused, LOSS_WINDOW[3], rows[3][j], sum);
    sum      = muladd(fused, LOSS_WINDOW[4], rows[4][j], sum);
    sum      = muladd(fused, LOSS_WINDOW[5], rows[5][j], sum);
    sum      = muladd(fused, LOSS_WINDOW[6], rows[6][j], sum);
    sum      = muladd(fused, LOSS_WINDOW[7], rows[7][j], sum);
    sum      = muladd(fused, LOSS_WINDOW[8], rows[8][j], sum);
    sum      = muladd(fused, LOSS_WINDOW[9], rows[9][j], sum);
    return muladd(fused, LOSS_WINDOW[10], rows[10][j], sum);
}

/* The window's rows of one map of a ring, centred on `row`. */
static void loss_window(const real *ring, size_t stride, int maps, int map, int row, const real *rows[LOSS_TAPS])
{
    for (int k = 0; k < LOSS_TAPS; k++)
        rows[k] = ring + ((size_t)loss_ring(row - LOSS_HALF + k) * (size_t)maps + (size_t)map) * stride;
}

static real loss_sum_lanes(const real *lane) /* (PACK), pairwise */
{
    real half[PACK];
    memcpy(half, lane, sizeof half);
    for (int n = PACK / 2; n > 0; n /= 2)
        for (int l = 0; l < n; l++) half[l] += half[l + n];
    return half[0];
}

/* ---------------------------------------------------------------- the three stages of the sweep */

/* A row of a weight map, or of ones without a map. */
static void loss_fill_counts(const struct loss_rows *r, const real *map, int row, int w)
{
    if (map) memcpy(r->counts, map + (size_t)row * (size_t)w, (size_t)w * sizeof *map);
    else
        for (int j = 0; j < w; j++) r->counts[j] = 1;
}

/* Stage 1: row -> its four maps, blurred along the row, into the ring. */
SIMD_INLINE void loss_take_row(const int fused, const struct loss_strip *s, const struct loss_rows *r, int row)
{
    const struct loss_job *job  = s->job;
    const int              w    = job->width;
    real                  *ring = r->blurred + (size_t)loss_ring(row) * LOSS_MAPS * r->stride;
    if (row < 0 || row >= job->height) {
        memset(ring, 0, LOSS_MAPS * r->stride * sizeof *ring);
        return;
    }
    {
        const size_t at        = ((size_t)s->channel * (size_t)job->height + (size_t)row) * (size_t)w;
        const real *restrict x = job->x + at, *restrict y = job->y + at;
        real *restrict mx = r->input + LOSS_HALF, *restrict my = mx + r->stride;
        real *restrict mm = my + r->stride, *restrict mxy = mm + r->stride;
#pragma omp simd
        for (int j = 0; j < w; j++) {
            const real a = x[j], b = y[j];
            mx[j]  = a;
            my[j]  = b;
            mm[j]  = muladd(fused, a, a, b * b);
            mxy[j] = a * b;
        }
    }
    for (int map = 0; map < LOSS_MAPS; map++)
        loss_blur_along(fused, r->input + (size_t)map * r->stride, w, ring + (size_t)map * r->stride);
}

/* Stage 2: the windows centred on `row` -> S and its three derivatives, blurred along the row, into the second ring. */
SIMD_INLINE void loss_differentiate_row(const int fused, const struct loss_strip *s, const struct loss_rows *r, int row)
{
    const struct loss_job *job       = s->job;
    const int              w         = job->width;
    real                  *ring      = r->returned + (size_t)loss_ring(row) * LOSS_DERIVATIVES * r->stride;
    real                   sum[PACK] = {0};
    const real            *mx[LOSS_TAPS], *my[LOSS_TAPS], *mm[LOSS_TAPS], *mxy[LOSS_TAPS];
    real *restrict dx = r->derivative + LOSS_HALF, *restrict dm = dx + r->stride, *restrict dxy = dm + r->stride;
    const real *restrict counts = r->counts;
    if (row < 0 || row >= job->height) {
        memset(ring, 0, LOSS_DERIVATIVES * r->stride * sizeof *ring);
        return;
    }
    loss_window(r->blurred, r->stride, LOSS_MAPS, 0, row, mx);
    loss_window(r->blurred, r->stride, LOSS_MAPS, 1, row, my);
    loss_window(r->blurred, r->stride, LOSS_MAPS, 2, row, mm);
    loss_window(r->blurred, r->stride, LOSS_MAPS, 3, row, mxy);
    loss_fill_counts(r, s->window_ok, row, w);
    for (int j0 = 0; j0 < w; j0 += PACK) {
#pragma omp simd
        for (int l = 0; l < PACK; l++) { /* the padding of the rings is readable */
            const size_t j  = (size_t)(j0 + l);
            const real   ux = loss_blur_down(fused, mx, j), uy = loss_blur_down(fused, my, j);
            const real   uu = muladd(fused, ux, ux, uy * uy), uxy = ux * uy;
            const real   a1 = 2 * uxy + LOSS_C1, b1 = uu + LOSS_C1;
            const real a2 = 2 * (loss_blur_down(fused, mxy, j) - uxy) + LOSS_C2, b2 = loss_blur_down(fused, mm, j) - uu + LOSS_C2;
            const real i = 1 / (b1 * b2), ssim = a1 * a2 * i, dvxy = 2 * a1 * i, dvv = -ssim * b1 * i;
            const real scale = -s->ssim_scale * counts[j];
            /* the variances hold -ux^2 and -ux uy */
            dx[j]  = scale * (2 * uy * a2 * i - 2 * ux * ssim * b2 * i - 2 * ux * dvv - uy * dvxy);
            dm[j]  = scale * dvv;
            dxy[j] = scale * dvxy;
            sum[l] += counts[j] * ssim;
        }
    }
    for (int map = 0; map < LOSS_DERIVATIVES; map++)
        loss_blur_along(fused, r->derivative + (size_t)map * r->stride, w, ring + (size_t)map * r->stride);
    if (row >= s->first && row < s->end) s->sums[row][1] = loss_sum_lanes(sum);
}

/* Stage 3: the second ring -> the gradient of `row`, with the part of L1. */
SIMD_INLINE void loss_give_row(const int fused, const struct loss_strip *s, const struct loss_rows *r, int row)
{
    const struct loss_job *job = s->job;
    const int              w   = job->width;
    const size_t           at  = ((size_t)s->channel * (size_t)job->height + (size_t)row) * (size_t)w;
    const real *restrict x = job->x + at, *restrict y = job->y + at;
    const real *restrict counts = r->counts;
    real *restrict out          = job->dx + at;
    const real *dx[LOSS_TAPS], *dm[LOSS_TAPS], *dxy[LOSS_TAPS];
    real        l1[PACK] = {0}, square[PACK] = {0};
    loss_fill_counts(r, job->weight, row, w);
    loss_window(r->returned, r->stride, LOSS_DERIVATIVES, 0, row, dx);
    loss_window(r->returned, r->stride, LOSS_DERIVATIVES, 1, row, dm);
    loss_window(r->returned, r->stride, LOSS_DERIVATIVES, 2, row, dxy);
    for (int j0 = 0; j0 < w; j0 += PACK) {
        const int n = OXL_MIN(PACK, w - j0);
#pragma omp simd
        for (int l = 0; l < n; l++) {
            const size_t j = (size_t)(j0 + l);
            const real   a = x[j], b = y[j], difference = a - b;
            const real   sign    = difference > 0 ? (real)1 : difference < 0 ? (real)-1 : 0;
            const real   through = muladd(fused, 2 * a, loss_blur_down(fused, dm, j), b * loss_blur_down(fused, dxy, j));
            out[j]               = loss_blur_down(fused, dx, j) + through + s->l1_scale * counts[j] * sign;
            l1[l] += counts[j] * (difference < 0 ? -difference : difference);
            square[l] += counts[j] * difference * difference;
        }
    }
    s->sums[row][0] = loss_sum_lanes(l1);
    s->sums[row][2] = loss_sum_lanes(square);
}

SIMD_BODY void loss_strip_body(const int fused, const struct loss_strip *s)
{
    const struct loss_rows r = loss_rows(s);
    memset(s->scratch, 0, loss_scratch_size(s->job->width) * sizeof *s->scratch);
    for (int row = s->first - 2 * LOSS_HALF; row < s->end + 2 * LOSS_HALF; row++) {
        loss_take_row(fused, s, &r, row);
        if (row >= s->first) loss_differentiate_row(fused, s, &r, row - LOSS_HALF);
        if (row >= s->first + 2 * LOSS_HALF) loss_give_row(fused, s, &r, row - 2 * LOSS_HALF);
    }
}

SIMD_DISPATCH(static, loss_strip, struct loss_strip)

/* ---------------------------------------------------------------- the whole image */

/* 1 where all of the 11 x 11 window inside the image counts. Returns how many. */
static size_t loss_whole_windows(const struct loss_job *job, real *out)
{
    size_t count = 0;
    for (int y = 0; y < job->height; y++)
        for (int x = 0; x < job->width; x++) {
            int whole = 1;
            for (int v = OXL_MAX(y - LOSS_HALF, 0); whole && v <= OXL_MIN(y + LOSS_HALF, job->height - 1); v++)
                for (int u = OXL_MAX(x - LOSS_HALF, 0); whole && u <= OXL_MIN(x + LOSS_HALF, job->width - 1); u++)
                    whole = job->weight[(size_t)v * (size_t)job->width + (size_t)u] > 0;
            out[(size_t)y * (size_t)job->width + (size_t)x] = (real)whole;
            count += (size_t)whole;
        }
    return count;
}

/* The rows of the three channels, end to end, are cut into equal lengths; a piece that crosses a channel becomes two strips. */
static int loss_cut(int height, int pieces, struct loss_strip *strip)
{
    const int64_t rows  = 3 * (int64_t)height;
    int           count = 0;
    for (int piece = 0; piece < pieces; piece++) {
        int64_t       at  = rows * piece / pieces;
        const int64_t end = rows * (piece + 1) / pieces;
        while (at < end) {
            const int channel = (int)(at / height), first = (int)(at % height);
            const int last       = (int)OXL_MIN((int64_t)height, first + (end - at));
            strip[count].channel = channel;
            strip[count].first   = first;
            strip[count].end     = last;
            at += last - first;
            count++;
        }
    }
    return count;
}

static void loss_add_up(const struct loss_job *job, const double (*sums)[LOSS_SUMS], double values, double windows,
                        struct loss_value *out)
{
    double sum[LOSS_SUMS] = {0};
    for (int row = 0; row < 3 * job->height; row++)
        for (int k = 0; k < LOSS_SUMS; k++) sum[k] += sums[row][k];
    out->l1    = values > 0 ? sum[0] / values : 0;
    out->ssim  = windows > 0 ? sum[1] / windows : 1;
    out->mse   = values > 0 ? sum[2] / values : 0;
    out->total = (1 - (double)job->ssim_weight) * out->l1 + (double)job->ssim_weight * (1 - out->ssim);
}

OXL_INTERNAL oxl_result loss_forward_backward(oxl_context *ctx, const struct loss_job *job, struct loss_scratch *scratch,
                                              struct loss_value *out)
{
    const size_t       pixels = (size_t)job->width * (size_t)job->height, room = loss_scratch_size(job->width);
    const int          pieces = ctx->threads;
    double             values = 3.0 * (double)pixels, windows = values;
    struct loss_strip *strip;
    int                strips;
    oxl_result         rc = oxl_reserve(ctx, &scratch->strip, &scratch->strip_capacity, (size_t)pieces + 3, sizeof *strip);
    if (rc == OXL_OK) rc = oxl_reserve(ctx, &scratch->rows, &scratch->rows_capacity, room * ((size_t)pieces + 3), sizeof(real));
    if (rc == OXL_OK)
        rc = oxl_reserve(ctx, &scratch->sums, &scratch->sums_capacity, 3 * (size_t)job->height, LOSS_SUMS * sizeof(double));
    if (rc == OXL_OK && job->weight) rc = oxl_reserve(ctx, &scratch->whole, &scratch->whole_capacity, pixels, sizeof(real));
    if (rc != OXL_OK) return rc;
    if (job->weight) {
        double counted = 0;
        for (size_t i = 0; i < pixels; i++) counted += job->weight[i];
        values  = 3 * counted;
        windows = 3 * (double)loss_whole_windows(job, scratch->whole);
    }
    strip  = scratch->strip;
    strips = loss_cut(job->height, pieces, strip);
    for (int i = 0; i < strips; i++) {
        strip[i].job        = job;
        strip[i].window_ok  = job->weight ? scratch->whole : NULL;
        strip[i].l1_scale   = values > 0 ? (1 - job->ssim_weight) / (real)values : 0;
        strip[i].ssim_scale = windows > 0 ? job->ssim_weight / (real)windows : 0;
        strip[i].scratch    = (real *)scratch->rows + room * (size_t)i;
        strip[i].sums       = (double(*)[LOSS_SUMS])scratch->sums + (size_t)strip[i].channel * (size_t)job->height;
    }
#pragma omp parallel for schedule(dynamic) num_threads(ctx->threads)
    for (int i = 0; i < strips; i++) loss_strip(ctx->isa, &strip[i]);
    loss_add_up(job, scratch->sums, values, windows, out);
    return OXL_OK;
}

OXL_INTERNAL void loss_free(oxl_context *ctx, struct loss_scratch *scratch)
{
    oxl_free(ctx, scratch->strip);
    oxl_free(ctx, scratch->rows);
    oxl_free(ctx, scratch->sums);
    oxl_free(ctx, scratch->whole);
    *scratch = (struct loss_scratch){0};
}
