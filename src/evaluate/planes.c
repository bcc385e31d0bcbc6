/* planes.c - blurs planes of numbers by a Gaussian: for the windows of SSIM and the bands of structure.
 *
 * Plain and in double, along y and then along x; the taps of a window sum to 1.
 *
 * Invariant: each row is computed by one thread, so the result does not depend on the number of threads.
 */
#include "evaluate.h"
#include "../core/vecmath.h"

OXL_INTERNAL oxl_result planes_begin(oxl_context *ctx, const oxl_image *of, struct planes *p)
{
    const size_t size = (size_t)of->width * of->height, line = (size_t)of->width + 2 * PLANES_HALF_MAX;
    *p = (struct planes){.width = of->width, .height = of->height, .size = size};
    p->line = oxl_alloc(ctx, PLANES * size + line * (size_t)ctx->threads, sizeof *p->line);
    if (!p->line) return OXL_ERR_MEMORY;
    for (int k = 0; k < PLANES; k++) p->plane[k] = p->line + line * (size_t)ctx->threads + (size_t)k * size;
    return OXL_OK;
}

/* Returns an index; outside 0..n-1 one that is reflected at the edge that it passed, -1 as 0, or else -1. */
static int planes_index(int i, int n, int reflects)
{
    const int period = 2 * n, at = ((i % period) + period) % period;
    if (i >= 0 && i < n) return i;
    return !reflects ? -1 : at < n ? at : period - 1 - at;
}

/* Holds one row of a blur, along y and then along x. */
struct planes_row {
    const struct planes *p;
    const struct planes_window *window;
    double tap[2 * PLANES_HALF_MAX + 1]; /* taps from -half to half, whose sum is 1 */
    int y;
    const double *in;
    double *line, *out; /* (W + 2 half) row blurred along y; (W) */
};

SIMD_INLINE void planes_add(double tap, const double *restrict in, int width, double *restrict out)
{
#pragma omp simd
    for (int x = 0; x < width; x++) out[x] += tap * in[x];
}

SIMD_BODY void planes_blur_row_body(const int fused, const struct planes_row *r)
{
    const int width = r->p->width, half = r->window->half, reflects = r->window->reflects;
    double *middle = r->line + half;
    (void)fused;
    memset(r->line, 0, ((size_t)width + 2 * (size_t)half) * sizeof *r->line);
    memset(r->out, 0, (size_t)width * sizeof *r->out);
    for (int k = -half; k <= half; k++) {
        const int row = planes_index(r->y + k, r->p->height, reflects);
        if (row >= 0) planes_add(r->tap[half + k], r->in + (size_t)row * width, width, middle);
    }
    for (int k = 1; k <= half && reflects; k++) {
        middle[-k] = middle[planes_index(-k, width, 1)];
        middle[width - 1 + k] = middle[planes_index(width - 1 + k, width, 1)];
    }
    for (int k = -half; k <= half; k++) planes_add(r->tap[half + k], middle + k, width, r->out);
}

SIMD_DISPATCH(static, planes_blur_row, struct planes_row)

OXL_INTERNAL void planes_blur(oxl_context *ctx, const struct planes *p, const struct planes_window *window,
                              const double *in, double *out)
{
    struct planes_row all = {.p = p, .window = window, .in = in};
    const int half = window->half;
    double sum = 0;
    for (int k = -half; k <= half; k++) {
        all.tap[half + k] = vecmath_exp(-k * k / (2 * window->sigma * window->sigma));
        sum += all.tap[half + k];
    }
    for (int k = 0; k <= 2 * half; k++) all.tap[k] /= sum;
#pragma omp parallel for schedule(static) num_threads(ctx->threads)
    for (int y = 0; y < p->height; y++) {
        struct planes_row r = all;
        r.y = y, r.out = out + (size_t)y * p->width;
        r.line = p->line + (size_t)context_thread() * ((size_t)p->width + 2 * PLANES_HALF_MAX);
        planes_blur_row(ctx->isa, &r);
    }
}
