/* medium.h - attenuation and backscatter between the camera and the Gaussians of a pack, and their gradients.
 * Part of project.c.
 *
 * Per Gaussian, with the range r from the camera to its centre, and for the background (Akkaynak & Treibitz
 * 2018; SeaSplat, arXiv
 * 2409.17345, applies it per pixel):
 *     c' = J (r0 / max(r, r_min))^p exp(-bD (r - r_t)) + Binf (1 - exp(-bB r)),     background = Binf.
 * In struct medium: bD `attenuation`, bB `backscatter`, Binf `veiling_light`, p `falloff` from 0 to 2: the
 * lamp moves with the camera; r0 `reference`, the median range of the survey; r_t `training_range`, 0 outside
 * training; r_min = LAMP_RANGE_MIN r0.
 * Unlike depth z, the range does not change when the camera rotates.
 *
 * Invariant: exact gradients of the nine parameters, of p, and of the centre through r. Sums have a fixed
 * order: by task of packs and row, and by pixel for the background (medium.c).
 */
#ifndef OXL_MEDIUM_H
#define OXL_MEDIUM_H
#include "kernels.h"
#include "../survey/imaging.h"

/* colour: J -> c'. All lanes; those of rows that are not visible may hold anything. */
SIMD_INLINE void medium_pack_forward(const int fused, const struct project_job *job, size_t pack,
                                     real colour[3][PACK])
{
    const struct medium *m = job->medium;
    struct medium_pack *out = &job->medium_pack[pack];
    const struct vec3 eye = job->kernel_camera->eye;
    const real least = m->has_falloff ? (real)LAMP_RANGE_MIN * m->reference : 0;
#pragma omp simd
    for (int l = 0; l < PACK; l++) {
        const size_t i = pack * PACK + (size_t)l;
        const real x = job->in.plane[OXL_MEAN][i] - eye.x, y = job->in.plane[OXL_MEAN + 1][i] - eye.y;
        const real z = job->in.plane[OXL_MEAN + 2][i] - eye.z;
        out->range[l] = real_sqrt(x * x + y * y + z * z);
        out->log_near[l] =
            m->has_falloff
                ? real_log2(fused, m->reference / (out->range[l] > least ? out->range[l] : least)) * LN_2
                : 0;
    }
    for (int c = 0; c < 3; c++)
#pragma omp simd
        for (int l = 0; l < PACK; l++) {
            const real through = real_exp(fused, m->falloff * out->log_near[l] -
                                                     m->attenuation[c] * (out->range[l] - m->training_range));
            const real rest = real_exp(fused, -m->backscatter[c] * out->range[l]);
            const real clear = colour[c][l] > 0 ? colour[c][l] : 0;
            out->through[c][l] = through, out->rest[c][l] = rest, out->clear[c][l] = clear;
            colour[c][l] = clear * through + m->veiling_light[c] * (1 - rest);
        }
}

/* A visible row: dL/dc' of each channel -> the parameters' sums. */
SIMD_INLINE void medium_row_sums(const struct medium *m, const struct medium_pack *p, int l,
                                 real dcolour[3][PACK], double sum[MEDIUM_SUMS])
{
    double direct_sum = 0;
    for (int c = 0; c < 3; c++) {
        const double dc = (double)dcolour[c][l],
                     direct = dc * (double)p->clear[c][l] * (double)p->through[c][l];
        direct_sum += direct;
        if (!m->on) continue;
        sum[MEDIUM_ATTENUATION + c] += -((double)p->range[l] - (double)m->training_range) * direct;
        sum[MEDIUM_BACKSCATTER + c] +=
            dc * (double)m->veiling_light[c] * (double)p->range[l] * (double)p->rest[c][l];
        sum[MEDIUM_VEILING_LIGHT + c] += dc * (1 - (double)p->rest[c][l]);
    }
    sum[MEDIUM_FALLOFF] += (double)p->log_near[l] * direct_sum;
}

/* dcolour: in dL/dc', out dL/dJ, 0 where the clamp of J holds. drange: dL/dr / r. */
SIMD_INLINE void medium_pack_backward(const struct project_job *job, size_t pack, real dcolour[3][PACK],
                                      real drange[PACK])
{
    const struct medium *m = job->medium;
    const struct medium_pack *p = &job->medium_pack[pack];
    const real least = (real)LAMP_RANGE_MIN * m->reference, falloff = m->has_falloff ? m->falloff : 0;
    for (int l = 0; l < PACK && job->medium_sum; l++)
        if (job->visible[pack] >> l & 1) medium_row_sums(m, p, l, dcolour, job->medium_sum);
#pragma omp simd
    for (int l = 0; l < PACK; l++) {
        const real range = p->range[l], inverse = range > 0 ? 1 / range : 0;
        real dr = 0, direct_sum = 0;
        for (int c = 0; c < 3; c++) {
            const real direct = dcolour[c][l] * p->clear[c][l] * p->through[c][l];
            direct_sum += direct;
            dr += dcolour[c][l] * m->veiling_light[c] * m->backscatter[c] * p->rest[c][l] -
                  m->attenuation[c] * direct;
            dcolour[c][l] = p->clear[c][l] > 0 ? dcolour[c][l] * p->through[c][l] : 0;
        }
        drange[l] = (dr - (range > least ? falloff * inverse * direct_sum : 0)) * inverse;
    }
}

/* After the other gradients of the centre: adds that through the range. */
SIMD_INLINE void medium_pack_centres(const struct project_job *job, size_t pack, const real drange[PACK],
                                     real dmean[3][PACK])
{
    const real eye[3] = {job->kernel_camera->eye.x, job->kernel_camera->eye.y, job->kernel_camera->eye.z};
    for (int axis = 0; axis < 3; axis++)
#pragma omp simd
        for (int l = 0; l < PACK; l++)
            dmean[axis][l] +=
                drange[l] * (job->in.plane[OXL_MEAN + axis][pack * PACK + (size_t)l] - eye[axis]);
}

#endif
