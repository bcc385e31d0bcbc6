/* exposure.c - a gain per channel between the rendered image and the loss.
 *
 * Model (Schonberger 2016, reduced to a gain; LichtFeld Studio PR 1892):  y = exp(a_c) x,  a_c the image's log gain of channel c.
 *
 * Invariant: sums are over blocks of fixed length, in pixel order, so they do not depend on the number of threads.
 */
#include "render.h"

enum { EXPOSURE_BLOCK = 256 };

/* x (3,n) -> y (3,n). */
OXL_INTERNAL void exposure_forward(const float gain[3], const float *x, size_t n, float *y)
{
    for (int c = 0; c < 3; c++) {
        const float *restrict xc = x + (size_t)c * n;
        float *restrict yc       = y + (size_t)c * n;
        const float g            = gain[c];
#pragma omp simd
        for (size_t i = 0; i < n; i++) yc[i] = g * xc[i];
    }
}

/* dy (3,n) -> dx (3,n), may be the same; dlog_gain (3) is overwritten: dL/da = sum dy y, since dy/da = y. */
OXL_INTERNAL void exposure_backward(const float gain[3], const float *y, const float *dy, size_t n, float *dx,
                                    double dlog_gain[3])
{
    for (int c = 0; c < 3; c++) {
        const float *yc = y + (size_t)c * n, *dyc = dy + (size_t)c * n;
        float       *dxc = dx + (size_t)c * n;
        double       sum = 0;
        for (size_t first = 0; first < n; first += EXPOSURE_BLOCK) {
            const size_t end      = OXL_MIN(first + EXPOSURE_BLOCK, n);
            float        lane[16] = {0};
            double       block    = 0;
            for (size_t i = first; i + 16 <= end; i += 16)
#pragma omp simd
                for (int l = 0; l < 16; l++) lane[l] += dyc[i + (size_t)l] * yc[i + (size_t)l];
            for (size_t i = end - (end - first) % 16; i < end; i++) block += (double)dyc[i] * yc[i];
            for (int l = 0; l < 16; l++) block += lane[l];
            sum += block;
        }
#pragma omp simd
        for (size_t i = 0; i < n; i++) dxc[i] = gain[c] * dyc[i];
        dlog_gain[c] = sum;
    }
}
