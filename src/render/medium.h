/* medium.h - attenuation and backscatter between the camera and the Gaussians of a pack.
 * Part of project.c.
 *
 * Per Gaussian, with the range r from the camera to its centre, and for the background (Akkaynak & Treibitz
 * 2018; SeaSplat, arXiv
 * 2409.17345, applies it per pixel):
 *     c' = J exp(-bD (r - r_t)) + Binf (1 - exp(-bB r)),     background = Binf.
 * In struct medium: bD `attenuation`, bB `backscatter`, Binf `veiling_light`, r_t `training_range`, 0 outside
 * training.
 * Unlike depth z, the range does not change when the camera rotates.
 *
 * Invariant: exact gradients of the colours, and of the centre through r.
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
#pragma omp simd
    for (int l = 0; l < PACK; l++) {
        const struct vec3 arm = subtract3(gaussians_vec3(&job->in, OXL_MEAN, pack * PACK + (size_t)l), eye);
        out->range[l] = real_sqrt(dot3(arm, arm));
    }
    for (int c = 0; c < 3; c++)
#pragma omp simd
        for (int l = 0; l < PACK; l++) {
            const real through = real_exp(fused, -m->attenuation[c] * (out->range[l] - m->training_range));
            const real rest = real_exp(fused, -m->backscatter[c] * out->range[l]);
            const real clear = colour[c][l] > 0 ? colour[c][l] : 0;
            out->through[c][l] = through, out->rest[c][l] = rest, out->clear[c][l] = clear;
            colour[c][l] = clear * through + m->veiling_light[c] * (1 - rest);
        }
}

/* dcolour: in dL/dc', out dL/dJ, 0 where the clamp of J holds. drange: dL/dr / r. */
SIMD_INLINE void medium_pack_backward(const struct project_job *job, size_t pack, real dcolour[3][PACK],
                                      real drange[PACK])
{
    const struct medium *m = job->medium;
    const struct medium_pack *p = &job->medium_pack[pack];
#pragma omp simd
    for (int l = 0; l < PACK; l++) {
        const real range = p->range[l], inverse = range > 0 ? 1 / range : 0;
        real dr = 0;
        for (int c = 0; c < 3; c++) {
            const real direct = dcolour[c][l] * p->clear[c][l] * p->through[c][l];
            dr += dcolour[c][l] * m->veiling_light[c] * m->backscatter[c] * p->rest[c][l] -
                  m->attenuation[c] * direct;
            dcolour[c][l] = p->clear[c][l] > 0 ? dcolour[c][l] * p->through[c][l] : 0;
        }
        drange[l] = dr * inverse;
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
