/* adam.c - Adam step (Kingma & Ba 2015, Alg. 1) for the rows visible in the view.
 *
 * With the gradient g of a parameter p at step n (1 at the first), its mean m and mean square v:
 *     m <- b1 m + (1 - b1) g
 *     v <- b2 v + (1 - b2) g^2
 *     p <- p - rate / (1 - b1^n) m / (sqrt(v / (1 - b2^n)) + 1e-15).
 * The job's `rate` is divided by 1 - b1^n already, `inverse_correction` is 1 / sqrt(1 - b2^n).
 *
 * Invisible rows have no gradient and are not updated, as in Taming 3DGS (Mallick et al. 2024); classical
 * Adam would move them by their momentum. This saves memory traffic; METHOD.md lists it as a deviation.
 *
 * Invariants: a row with bit 0 in `visible` is not written; the bit of a row with a value or gradient that is
 * not finite is cleared.
 */
#include "kernels.h"

#define ADAM_EPSILON ((real)1e-15)
#define ADAM_GRADIENT_MAX ((real)1e18) /* its square is a finite float */

struct adam_rows { /* a pack of one plane; without restrict the loop is not vectorized */
    real *restrict parameter, *restrict mean, *restrict square;
    const real *restrict gradient;
};

/* (MATH 19). The square is clamped against float overflow: a gradient of 1e20 gives a step of `rate`, not a
 * NaN. */
SIMD_INLINE void adam_pack(const int fused, const struct adam_job *job, unsigned seen, real rate,
                           const struct adam_rows rows)
{
    real *restrict parameter = rows.parameter, *restrict mean = rows.mean, *restrict square = rows.square;
    const real *restrict gradient = rows.gradient;
#pragma omp simd
    for (int l = 0; l < PACK; l++) {
        const int on = seen >> l & 1;
        const real g = gradient[l], limited = OXL_CLAMP(g, -ADAM_GRADIENT_MAX, ADAM_GRADIENT_MAX);
        const real m = muladd(fused, job->beta1, mean[l], (1 - job->beta1) * limited);
        const real v = muladd(fused, job->beta2, square[l], (1 - job->beta2) * limited * limited);
        const real p =
            parameter[l] - rate * (m / muladd(fused, real_sqrt(v), job->inverse_correction, ADAM_EPSILON));
        mean[l] = on ? m : mean[l];
        square[l] = on ? v : square[l];
        parameter[l] = on ? p : parameter[l];
    }
}

/* The rows of a pack whose gradients and values are all finite: 0 x finite is 0, 0 x inf and 0 x nan are NaN,
 * which a sum preserves. */
SIMD_INLINE unsigned adam_finite(const struct adam_job *job, int planes, size_t at)
{
    real sum[PACK] = {0};
    unsigned finite = 0;
    for (int k = 0; k < planes; k++) {
        const real *g = job->gradient[k] + (at - job->gradient_row), *p = job->parameter[k] + at;
#pragma omp simd
        for (int l = 0; l < PACK; l++) sum[l] += 0 * g[l] + 0 * p[l];
    }
    for (int l = 0; l < PACK; l++) finite |= (unsigned)(sum[l] == 0) << l;
    return finite;
}

/* At degree 3 a pack has 236 cache lines, each in its own page: more streams than the hardware prefetcher
 * tracks. */
SIMD_INLINE void adam_prefetch(const struct adam_job *job, int planes, size_t at)
{
    for (int k = 0; k < planes; k++) {
        simd_prefetch(job->parameter[k] + at);
        simd_prefetch(job->gradient[k] + (at - job->gradient_row));
        simd_prefetch(job->mean[k] + at);
        simd_prefetch(job->square[k] + at);
    }
}

SIMD_BODY void adam_step_body(const int fused, const struct adam_job *job)
{
    for (size_t pack = job->first_pack; pack < job->end_pack; pack++) {
        const size_t at = pack * PACK;
        const int planes = job->planes + (pack < job->lobe_packs ? job->lobe_planes : 0);
        unsigned seen = job->visible[pack];
        if (!seen) continue;
        if (pack + 1 < job->end_pack && job->visible[pack + 1]) adam_prefetch(job, job->planes, at + PACK);
        seen &= adam_finite(job, planes, at);
        job->visible[pack] = (uint16_t)seen;
        for (int k = 0; k < planes; k++)
            adam_pack(fused, job, seen, job->rate[k],
                      (struct adam_rows){job->parameter[k] + at, job->mean[k] + at, job->square[k] + at,
                                         job->gradient[k] + (at - job->gradient_row)});
    }
}

SIMD_DISPATCH(OXL_INTERNAL, adam_step, struct adam_job)
