/* medium.c - water between the camera and the Gaussians: attenuation and backscatter.
 *
 * Per Gaussian, with the range r from the camera to its centre, and for the background (Akkaynak & Treibitz 2018; SeaSplat, arXiv
 * 2409.17345, applies it per pixel):
 *     c' = J exp(-bD r) + Binf (1 - exp(-bB r)),     background = Binf.
 * Forward between project and raster; backward between raster and project: the sums of a splat's pairs hold dL/dc', and become dL/dJ.
 * The range, unlike depth z, does not change when the camera rotates.
 *
 * Invariant: exact gradients of the nine parameters and of the centre through r. Sums have a fixed order: by task of packs, row and
 * pair, and by pixel for the background.
 */
#include "kernels.h"
#include "../core/vecmath.h"

static float medium_range(const struct medium_job *job, size_t i)
{
    const float x = job->in.plane[OXL_MEAN][i] - job->kernel_camera->eye.x,
                y = job->in.plane[OXL_MEAN + 1][i] - job->kernel_camera->eye.y;
    const float z = job->in.plane[OXL_MEAN + 2][i] - job->kernel_camera->eye.z;
    return real_sqrt(x * x + y * y + z * z);
}

OXL_INTERNAL void medium_forward(const struct medium_job *job)
{
    for (size_t pack = job->first_pack; pack < job->end_pack; pack++)
        for (unsigned l = 0; l < PACK; l++) {
            const size_t i = pack * PACK + l;
            float        range;
            if (!(job->visible[pack] >> l & 1)) continue;
            range = medium_range(job, i);
            for (int c = 0; c < 3; c++) {
                const struct medium *m        = job->medium;
                const float          clear    = job->splat[i].colour[c];
                job->clear[3 * i + (size_t)c] = clear;
                job->splat[i].colour[c] =
                    clear * real_exp(0, -m->direct[c] * range) + m->veil[c] * (1 - real_exp(0, -m->scatter[c] * range));
            }
        }
}

/* A visible row: dL/dc' of each channel (3) -> the parameters' sums; returns dL/dr. */
static float medium_row(const struct medium_job *job, size_t i, float range, const float g[3], double sum[9])
{
    const struct medium *m  = job->medium;
    float                dr = 0;
    for (int c = 0; c < 3; c++) {
        const float through = real_exp(0, -m->direct[c] * range), rest = real_exp(0, -m->scatter[c] * range);
        const float direct = job->clear[3 * i + (size_t)c] * through;
        sum[c] += -(double)g[c] * range * direct;
        sum[3 + c] += (double)g[c] * m->veil[c] * range * rest;
        sum[6 + c] += (double)g[c] * (1 - rest);
        dr += g[c] * (m->veil[c] * m->scatter[c] * rest - m->direct[c] * direct);
    }
    return dr;
}

/* Converts sums and the splats' colours to those without the medium. */
OXL_INTERNAL void medium_backward(const struct medium_job *job, double sum[9])
{
    memset(sum, 0, 9 * sizeof *sum);
    for (size_t pack = job->first_pack; pack < job->end_pack; pack++)
        for (unsigned l = 0; l < PACK; l++) {
            const size_t  i    = pack * PACK + l;
            struct splat *s    = &job->splat[i];
            float         g[3] = {0, 0, 0}, range, through[3];
            if (!(job->visible[pack] >> l & 1)) continue;
            range = medium_range(job, i);
            for (int c = 0; c < 3; c++) through[c] = real_exp(0, -job->medium->direct[c] * range);
            for (uint32_t slot = s->first_slot; slot < s->first_slot + s->slots; slot++)
                for (int c = 0; c < 3; c++) {
                    g[c] += job->sums[slot][SUM_RED + c];
                    job->sums[slot][SUM_RED + c] *= through[c];
                }
            job->drange[i] = range > 0 ? medium_row(job, i, range, g, sum) / range : 0;
            for (int c = 0; c < 3; c++) s->colour[c] = job->clear[3 * i + (size_t)c];
        }
}

/* After project_backward: adds the gradient of the range to that of the centre. */
OXL_INTERNAL void medium_backward_centres(const struct medium_job *job, const struct gaussians *out)
{
    const float eye[3] = {job->kernel_camera->eye.x, job->kernel_camera->eye.y, job->kernel_camera->eye.z};
    for (size_t pack = job->first_pack; pack < job->end_pack; pack++)
        for (unsigned l = 0; l < PACK; l++) {
            const size_t i = pack * PACK + l;
            if (!(job->visible[pack] >> l & 1)) continue;
            for (int a = 0; a < 3; a++) out->plane[OXL_MEAN + a][i] += job->drange[i] * (job->in.plane[OXL_MEAN + a][i] - eye[a]);
        }
}

/* dL/dBinf of the light behind the last splat: sum of T dL/dC, row by row. */
OXL_INTERNAL void medium_backward_veil(const float *drgb, const float *transmittance, int width, int height, double sum[9])
{
    const size_t plane = (size_t)width * (size_t)height;
    for (int c = 0; c < 3; c++)
        for (int y = 0; y < height; y++) {
            double row = 0;
            for (size_t i = (size_t)y * (size_t)width; i < (size_t)(y + 1) * (size_t)width; i++)
                row += (double)transmittance[i] * drgb[(size_t)c * plane + i];
            sum[6 + c] += row;
        }
}
