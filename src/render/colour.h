/* colour.h - a pack's colours from spherical harmonics, and their gradient; part of project.c.
 *
 * Kerbl et al. 2023: colour = max(0, 0.5 + sum of basis_k(direction) sh_k) for each channel; the clamp is in
 * project.c.
 */
#ifndef OXL_COLOUR_H
#define OXL_COLOUR_H
#include "kernels.h"

static const real SH_0 = (real)0.28209479177387814; /* real spherical harmonics, the signs of 3DGS */
static const real SH_1 = (real)0.4886025119029199;
static const real SH_2XY = (real)1.0925484305920792;
static const real SH_2ZZ = (real)0.31539156525252005;
static const real SH_2XX = (real)0.5462742152960396;
static const real SH_3Y = (real)0.5900435899266435;
static const real SH_3XY = (real)2.890611442640554;
static const real SH_3YZ = (real)0.4570457994644658;
static const real SH_3ZZ = (real)0.3731763325901154;
static const real SH_3XX = (real)1.445305721320277;

struct project_colour {
    real x[PACK], y[PACK], z[PACK]; /* unit direction from the eye */
    real inverse[PACK];             /* 1 / distance */
    real basis[16][PACK];
    real value[3][PACK]; /* before the clamp at 0 */
};

SIMD_INLINE void project_basis(int degree, struct project_colour *c)
{
#pragma omp simd
    for (int l = 0; l < PACK; l++) c->basis[0][l] = SH_0;
    if (degree > 0) {
#pragma omp simd
        for (int l = 0; l < PACK; l++) {
            c->basis[1][l] = -SH_1 * c->y[l];
            c->basis[2][l] = SH_1 * c->z[l];
            c->basis[3][l] = -SH_1 * c->x[l];
        }
    }
    if (degree > 1) {
#pragma omp simd
        for (int l = 0; l < PACK; l++) {
            const real x = c->x[l], y = c->y[l], z = c->z[l];
            c->basis[4][l] = SH_2XY * x * y;
            c->basis[5][l] = -SH_2XY * y * z;
            c->basis[6][l] = SH_2ZZ * (2 * z * z - x * x - y * y);
            c->basis[7][l] = -SH_2XY * x * z;
            c->basis[8][l] = SH_2XX * (x * x - y * y);
        }
    }
    if (degree > 2) {
#pragma omp simd
        for (int l = 0; l < PACK; l++) {
            const real x = c->x[l], y = c->y[l], z = c->z[l], xx = x * x, yy = y * y, zz = z * z;
            c->basis[9][l] = -SH_3Y * y * (3 * xx - yy);
            c->basis[10][l] = SH_3XY * x * y * z;
            c->basis[11][l] = -SH_3YZ * y * (4 * zz - xx - yy);
            c->basis[12][l] = SH_3ZZ * z * (2 * zz - 3 * xx - 3 * yy);
            c->basis[13][l] = -SH_3YZ * x * (4 * zz - xx - yy);
            c->basis[14][l] = SH_3XX * z * (xx - yy);
            c->basis[15][l] = -SH_3Y * x * (xx - 3 * yy);
        }
    }
}

/* d(sum of basis_k v_k)/d(direction), without the normalisation: v (16, PACK) -> dx, dy, dz (PACK). */
SIMD_INLINE void project_basis_backward(int degree, const struct project_colour *c, real v[16][PACK],
                                        real *dx, real *dy, real *dz)
{
#pragma omp simd
    for (int l = 0; l < PACK; l++) dx[l] = dy[l] = dz[l] = 0;
    if (degree > 0) {
#pragma omp simd
        for (int l = 0; l < PACK; l++) {
            dx[l] -= SH_1 * v[3][l];
            dy[l] -= SH_1 * v[1][l];
            dz[l] += SH_1 * v[2][l];
        }
    }
    if (degree > 1) {
#pragma omp simd
        for (int l = 0; l < PACK; l++) {
            const real x = c->x[l], y = c->y[l], z = c->z[l];
            dx[l] +=
                SH_2XY * (y * v[4][l] - z * v[7][l]) - 2 * SH_2ZZ * x * v[6][l] + 2 * SH_2XX * x * v[8][l];
            dy[l] +=
                SH_2XY * (x * v[4][l] - z * v[5][l]) - 2 * SH_2ZZ * y * v[6][l] - 2 * SH_2XX * y * v[8][l];
            dz[l] += -SH_2XY * (y * v[5][l] + x * v[7][l]) + 4 * SH_2ZZ * z * v[6][l];
        }
    }
    if (degree > 2) {
#pragma omp simd
        for (int l = 0; l < PACK; l++) {
            const real x = c->x[l], y = c->y[l], z = c->z[l], xx = x * x, yy = y * y, zz = z * z;
            dx[l] += -SH_3Y * (6 * x * y * v[9][l] + 3 * (xx - yy) * v[15][l]) + SH_3XY * y * z * v[10][l] +
                     SH_3YZ * (2 * x * y * v[11][l] - (4 * zz - 3 * xx - yy) * v[13][l]) -
                     6 * SH_3ZZ * x * z * v[12][l] + 2 * SH_3XX * x * z * v[14][l];
            dy[l] += -SH_3Y * (3 * (xx - yy) * v[9][l] - 6 * x * y * v[15][l]) + SH_3XY * x * z * v[10][l] +
                     SH_3YZ * (2 * x * y * v[13][l] - (4 * zz - xx - 3 * yy) * v[11][l]) -
                     6 * SH_3ZZ * y * z * v[12][l] - 2 * SH_3XX * y * z * v[14][l];
            dz[l] += SH_3XY * x * y * v[10][l] - 8 * SH_3YZ * z * (y * v[11][l] + x * v[13][l]) +
                     SH_3ZZ * (6 * zz - 3 * xx - 3 * yy) * v[12][l] + SH_3XX * (xx - yy) * v[14][l];
        }
    }
}

/* Direction from the camera to each row, and the SH basis. */
SIMD_INLINE void project_view_direction(const struct gaussians *in, const struct kernel_camera *kernel_camera,
                                        size_t first, struct project_colour *c)
{
#pragma omp simd
    for (int l = 0; l < PACK; l++) {
        const struct vec3 arm =
            subtract3(gaussians_vec3(in, OXL_MEAN, first + (size_t)l), kernel_camera->eye);
        const real length = real_sqrt(dot3(arm, arm)), inverse = length > 0 ? 1 / length : 0;
        c->x[l] = arm.x * inverse, c->y[l] = arm.y * inverse, c->z[l] = arm.z * inverse;
        c->inverse[l] = inverse;
    }
    project_basis(in->sh_degree, c);
}

SIMD_INLINE void project_colour(const struct gaussians *in, const struct kernel_camera *kernel_camera,
                                size_t first, struct project_colour *c)
{
    const int coefficients = (in->sh_degree + 1) * (in->sh_degree + 1);
    real red[PACK], green[PACK], blue[PACK];
    project_view_direction(in, kernel_camera, first, c);
    for (int l = 0; l < PACK; l++) red[l] = green[l] = blue[l] = (real)0.5;
    for (int k = 0; k < 16; k++) {
        const real *r, *g, *b, *basis = c->basis[k];
        /* a second loop exit prevents gcc's unroll-and-jam, which uses gathers */
        if (k == coefficients) break;
        r = in->plane[OXL_SH + 3 * k] + first, g = in->plane[OXL_SH + 3 * k + 1] + first,
        b = in->plane[OXL_SH + 3 * k + 2] + first;
#pragma omp simd
        for (int l = 0; l < PACK; l++) {
            red[l] += basis[l] * r[l];
            green[l] += basis[l] * g[l];
            blue[l] += basis[l] * b[l];
        }
    }
    for (int l = 0; l < PACK; l++)
        c->value[0][l] = red[l], c->value[1][l] = green[l], c->value[2][l] = blue[l];
}

/* dcolour (3, PACK) -> the SH planes of `out`, and dL/d(mean) through the viewing direction, added to dmean
 * (3, PACK). MATH 15 */
SIMD_INLINE void project_colour_backward(const struct project_job *job, size_t first,
                                         const struct project_colour *c, real dcolour[3][PACK],
                                         real dmean[3][PACK])
{
    const int degree = job->in.sh_degree, coefficients = (degree + 1) * (degree + 1);
    const size_t to = first - job->out_row;
    real v[16][PACK], dx[PACK], dy[PACK], dz[PACK];
    for (int k = 0; k < coefficients; k++) {
        const real *sh[3] = {job->in.plane[OXL_SH + 3 * k] + first, job->in.plane[OXL_SH + 3 * k + 1] + first,
                             job->in.plane[OXL_SH + 3 * k + 2] + first};
        real *out[3] = {job->out.plane[OXL_SH + 3 * k] + to, job->out.plane[OXL_SH + 3 * k + 1] + to,
                        job->out.plane[OXL_SH + 3 * k + 2] + to};
        const real *basis = c->basis[k];
#pragma omp simd
        for (int l = 0; l < PACK; l++) {
            v[k][l] = sh[0][l] * dcolour[0][l] + sh[1][l] * dcolour[1][l] + sh[2][l] * dcolour[2][l];
            out[0][l] = basis[l] * dcolour[0][l];
            out[1][l] = basis[l] * dcolour[1][l];
            out[2][l] = basis[l] * dcolour[2][l];
        }
    }
    if (degree == 0) return;
    project_basis_backward(degree, c, v, dx, dy, dz);
#pragma omp simd
    for (int l = 0; l < PACK; l++) { /* through direction = offset / |offset|: the component along it is 0 */
        const real along = dx[l] * c->x[l] + dy[l] * c->y[l] + dz[l] * c->z[l];
        dmean[0][l] += (dx[l] - along * c->x[l]) * c->inverse[l];
        dmean[1][l] += (dy[l] - along * c->y[l]) * c->inverse[l];
        dmean[2][l] += (dz[l] - along * c->z[l]) * c->inverse[l];
    }
}

#endif
