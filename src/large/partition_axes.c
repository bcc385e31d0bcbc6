/* partition_axes.c - finds the frame of the partition: the principal axes of the survey (Pearson 1901) and
 * its extents along them.
 *
 * Outliers are trimmed first: the axes are those of the points within 1.5 times the 90 % quantile of the
 * distances from the scene's origin, which is the median of the points.
 */
#include "partition.h"

#include "../core/eigen.h"
#include "../survey/sparse.h"
#include "../survey/scene.h"
#include "../survey/survey.h"

enum { AXES_SAMPLE = 1 << 18 };
#define AXES_QUANTILE 0.9
#define AXES_REACH 1.5

static double axes_dot(const double *a, const double *b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* Copies every step-th point, moves those that are not outliers to the front, and returns their number.
 * scratch: as many. */
static size_t axes_sample(const oxl_scene *scene, size_t step, double *sample, double *scratch)
{
    size_t n = 0, kept = 0;
    double limit;
    for (size_t i = 0; i < scene->point_count; i += step, n++)
        for (int k = 0; k < 3; k++) sample[3 * n + (size_t)k] = scene->point[i].position[k];
    for (size_t i = 0; i < n; i++) scratch[i] = axes_dot(sample + 3 * i, sample + 3 * i);
    limit = AXES_REACH * AXES_REACH * stats_select(scratch, n, AXES_QUANTILE);
    for (size_t i = 0; i < n; i++)
        if (axes_dot(sample + 3 * i, sample + 3 * i) <= limit)
            memmove(sample + 3 * kept++, sample + 3 * i, 3 * sizeof *sample);
    return kept;
}

static void axes_covariance(const double *p, size_t n, double a[3][3])
{
    double mean[3] = {0};
    memset(a, 0, 9 * sizeof(double));
    for (size_t i = 0; i < 3 * n; i++) mean[i % 3] += p[i] / (double)n;
    for (size_t i = 0; i < n; i++)
        for (int k = 0; k < 9; k++)
            a[k / 3][k % 3] +=
                (p[3 * i + (size_t)(k / 3)] - mean[k / 3]) * (p[3 * i + (size_t)(k % 3)] - mean[k % 3]);
}

/* Returns 1 if more cameras lie on the negative side of an axis than on the other. */
static int axes_is_below(const oxl_scene *scene, const double axis[3])
{
    int balance = 0;
    for (int i = 0; i < scene->view_count; i++) {
        double centre[3], height;
        camera_position(&scene->view[i].camera, centre);
        height = axes_dot(axis, centre);
        balance += (height > 0) - (height < 0);
    }
    return balance < 0;
}

/* Makes the rows of r the eigenvectors by falling eigenvalue. The third points to the cameras, the first
 * forward (eigen_is_backward), and the second makes the frame right-handed, so that a map is not mirrored. */
static void axes_orient(const oxl_scene *scene, double a[3][3], double r[3][3])
{
    double v[3][3];
    eigen_symmetric(a, v);
    for (int i = 0; i < 3; i++) {
        int next = 0, turn;
        for (int k = 1; k < 3; k++)
            if (a[k][k] > a[next][next]) next = k;
        a[next][next] = -1;
        turn = i ? axes_is_below(scene, v[next]) : eigen_is_backward(v[next]);
        for (int k = 0; k < 3; k++) r[i][k] = turn ? -v[next][k] : v[next][k];
    }
    for (int k = 0; k < 3; k++)
        r[1][k] = r[2][(k + 1) % 3] * r[0][(k + 2) % 3] - r[2][(k + 2) % 3] * r[0][(k + 1) % 3];
}

OXL_INTERNAL oxl_result partition_axes(oxl_context *ctx, const oxl_scene *scene, struct partition *p)
{
    const size_t count = scene->point_count, step = count / AXES_SAMPLE + 1, most = count / step + 2;
    double *sample = oxl_alloc(ctx, most, 3 * sizeof *sample);
    double *scratch = oxl_alloc(ctx, most, sizeof *scratch);
    double a[3][3], r[3][3];
    size_t n;
    if (sample && scratch) {
        n = axes_sample(scene, step, sample, scratch);
        axes_covariance(sample, n, a);
        axes_orient(scene, a, r);
        memcpy(p->rotation, r, sizeof r);
        for (int k = 0; k < 3; k++) {
            for (size_t i = 0; i < n; i++) scratch[i] = axes_dot(r[k], sample + 3 * i);
            p->plan->finite.low[k] = stats_select(scratch, n, 0.01);
            p->plan->finite.high[k] = stats_select(scratch, n, 0.99);
            p->extent[k] = p->plan->finite.high[k] - p->plan->finite.low[k];
        }
    }
    OXL_FREE(ctx, sample, scratch);
    return sample && scratch ? OXL_OK : OXL_ERR_MEMORY;
}

OXL_INTERNAL void partition_to_frame(const struct partition *p, const double world[3], double out[3])
{
    for (int i = 0; i < 3; i++) {
        out[i] = 0;
        for (int k = 0; k < 3; k++) out[i] += p->rotation[3 * i + k] * (world[k] - p->origin[k]);
    }
}
