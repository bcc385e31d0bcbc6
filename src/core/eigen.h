/* eigen.h - computes eigenvectors of a symmetric 3 x 3 matrix, for principal axes. The library and the
 * program use it.
 *
 * Source: Jacobi rotations (1846). They use only + - * / and the square root, so the result has the same bits
 * on all machines.
 */
#ifndef OXL_EIGEN_H
#define OXL_EIGEN_H

#include <math.h>

enum { EIGEN_SWEEPS = 30 }; /* most sweeps; three or four suffice, since convergence is quadratic */
#define EIGEN_ZERO 1e-30    /* Counts an element below this fraction of the trace as 0. */

/* Rotates rows and columns i and j of a, and rows i and j of v, so that a[i][j] becomes 0. */
static inline void eigen_rotate(double a[3][3], double v[3][3], int i, int j)
{
    const double theta = (a[j][j] - a[i][i]) / (2 * a[i][j]);
    const double t = (theta < 0 ? -1 : 1) / (fabs(theta) + sqrt(theta * theta + 1)), c = 1 / sqrt(t * t + 1),
                 s = t * c;
    for (int k = 0; k < 3; k++) {
        const double x = a[k][i], y = a[k][j];
        a[k][i] = c * x - s * y;
        a[k][j] = s * x + c * y;
    }
    for (int k = 0; k < 3; k++) {
        const double x = a[i][k], y = a[j][k], vx = v[i][k], vy = v[j][k];
        a[i][k] = c * x - s * y;
        a[j][k] = s * x + c * y;
        v[i][k] = c * vx - s * vy;
        v[j][k] = s * vx + c * vy;
    }
}

/* Makes the rows of v the unit eigenvectors of the symmetric matrix a, in no order, and the
 * diagonal of a the eigenvalues. */
static inline void eigen_symmetric(double a[3][3], double v[3][3])
{
    const double scale = fabs(a[0][0]) + fabs(a[1][1]) + fabs(a[2][2]);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) v[i][j] = i == j;
    for (int sweep = 0; sweep < EIGEN_SWEEPS; sweep++)
        for (int i = 0; i < 2; i++)
            for (int j = i + 1; j < 3; j++)
                if (fabs(a[i][j]) > EIGEN_ZERO * scale) eigen_rotate(a, v, i, j);
}

/* Returns 1 if the largest element of an axis is negative. An eigenvector has no sign of its own; one rule
 * gives all maps of a survey the same orientation. */
static inline int eigen_is_backward(const double axis[3])
{
    int largest = 0;
    for (int k = 1; k < 3; k++)
        if (fabs(axis[k]) > fabs(axis[largest])) largest = k;
    return axis[largest] < 0;
}

#endif
