/* exposure.c - gains between the rendered image and the loss: one per channel, and the lamp's over the image.
 *
 * Model (Schonberger 2016, reduced to a gain; LichtFeld Studio PR 1892):  y = exp(a_c + s) x,  a_c the
 * image's log gain of channel c, s the lamp's polynomial at the pixel (survey/imaging.h).
 *
 * Invariant: sums run over the lanes of a row, then over rows, so they do not depend on the vector width.
 */
#include "kernels.h"

enum { EXPOSURE_POWERS = LAMP_DEGREE + 1, EXPOSURE_SUMS = 3 + EXPOSURE_POWERS };

static size_t exposure_row(const struct exposure_job *job, int channel, int y)
{
    return ((size_t)channel * job->area.height + (size_t)y) * (size_t)job->area.width;
}

SIMD_BODY void exposure_forward_body(const int fused, const struct exposure_job *job)
{
    const int width = job->area.width;
    const float left = lamp_coordinate(job->area.x, job->area.full_width),
                step = 2 / (float)job->area.full_width;
    for (int y = 0; y < job->area.height; y++) {
        float *lamp = job->lamp_map + exposure_row(job, 0, y);
        float a[EXPOSURE_POWERS];
        if (job->shape) lamp_row(job->shape, &job->area, y, a);
#pragma omp simd
        for (int i = 0; i < width; i++) {
            const float x = left + step * (float)i;
            lamp[i] =
                job->shape ? real_exp(fused, a[0] + x * (a[1] + x * (a[2] + x * (a[3] + x * a[4])))) : 1;
        }
        for (int c = 0; c < 3; c++) {
            const float *in = job->x + exposure_row(job, c, y);
            float *out = job->y + exposure_row(job, c, y);
            const float gain = job->gain[c];
#pragma omp simd
            for (int i = 0; i < width; i++) out[i] = gain * in[i] * lamp[i];
        }
    }
}

/* `count` pixels of a row: dx; and sums of dL/da: by channel, then over the channels times powers of x. dx
 * may be dy. */
SIMD_INLINE void exposure_lanes(const struct exposure_job *job, int y, int first, const int count,
                                const int has_lamp, float sum[EXPOSURE_SUMS][PACK])
{
    const float *lamp = job->lamp_map + exposure_row(job, 0, y) + first;
    const float left = lamp_coordinate(job->area.x, job->area.full_width),
                step = 2 / (float)job->area.full_width;
    float all[PACK] = {0};
    for (int c = 0; c < 3; c++) {
        const size_t at = exposure_row(job, c, y) + (size_t)first;
        const float *dy = job->dy + at, *exposed = job->y + at, gain = job->gain[c];
        float *dx = job->dx + at;
#pragma omp simd
        for (int l = 0; l < count; l++) {
            const float d = dy[l] * exposed[l];
            sum[c][l] += d, all[l] += d;
            dx[l] = gain * dy[l] * lamp[l];
        }
    }
    for (int k = 0; k < EXPOSURE_POWERS && has_lamp; k++)
#pragma omp simd
        for (int l = 0; l < count; l++) {
            sum[3 + k][l] += all[l];
            all[l] *= left + step * (float)(first + l);
        }
}

SIMD_INLINE void exposure_row_backward(const struct exposure_job *job, int y, const int has_lamp,
                                       double total[EXPOSURE_SUMS])
{
    const int width = job->area.width;
    float sum[EXPOSURE_SUMS][PACK] = {{0}};
    int first = 0;
    for (; first + PACK <= width; first += PACK) exposure_lanes(job, y, first, PACK, has_lamp, sum);
    exposure_lanes(job, y, first, width - first, has_lamp, sum);
    for (int k = 0; k < EXPOSURE_SUMS; k++) {
        total[k] = 0;
        for (int l = 0; l < PACK; l++) total[k] += (double)sum[k][l];
    }
}

SIMD_BODY void exposure_backward_body(const int fused, const struct exposure_job *job)
{
    (void)fused;
    memset(job->dlog_gain, 0, 3 * sizeof *job->dlog_gain);
    memset(job->dshape, 0, LAMP_TERMS * sizeof *job->dshape);
    for (int y = 0; y < job->area.height; y++) {
        double total[EXPOSURE_SUMS];
        if (job->shape) exposure_row_backward(job, y, 1, total);
        else exposure_row_backward(job, y, 0, total);
        for (int c = 0; c < 3; c++) job->dlog_gain[c] += total[c];
        if (job->shape) lamp_add_row(&job->area, y, total + 3, job->dshape);
    }
}

SIMD_DISPATCH(OXL_INTERNAL, exposure_forward, struct exposure_job)
SIMD_DISPATCH(OXL_INTERNAL, exposure_backward, struct exposure_job)
