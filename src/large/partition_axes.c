/* partition_axes.c - finds the frame of the partition: principal axes of the survey and its extents along
 * them.
 *
 * Source: principal components (Pearson 1901). Outliers are trimmed first: the axes are those of the points
 * within 1.5 times the 90 % quantile of the distances. Uniform point clouds are not trimmed, and up to 10 %
 * outliers have no effect.
 *
 * Invariants: the rotation is right-handed with rows in order of falling extent. It depends on the survey
 * alone: a large one is sampled, one point per section of the file.
 */
#include "partition.h"

#include "../core/eigen.h"
#include "../survey/sparse.h"
#include "../survey/scene.h"
#include "../survey/survey.h"
#include "../survey/tracks.h"

enum { AXES_SAMPLE = 1 << 18 };
#define AXES_QUANTILE 0.9
#define AXES_REACH 1.5

/* ---------------- the sample */

/* Copies positions relative to the scene's origin, the median of the points; leaves out
 * points that the scene drops. */
static size_t axes_sample(const struct colmap *c, const double origin[3], double *sample)
{
    const size_t step = c->point_count / AXES_SAMPLE + 1;
    size_t count = 0;
    for (size_t first = 0; first + step <= c->point_count; first += step) {
        /* Takes a random point of the section, against periodic files. */
        const size_t i = first + random_bits(1, first, 0) % step;
        double *p = sample + 3 * count;
        for (int k = 0; k < 3; k++) p[k] = c->point[i].position[k] - origin[k];
        count += (size_t)tracks_accept_point(&c->point[i], origin);
    }
    return count;
}

/* Moves the kept points to the front and returns their number. scratch: (n). */
static size_t axes_trim(double *sample, size_t n, double *scratch)
{
    size_t kept = 0;
    double limit;
    for (size_t i = 0; i < n; i++) {
        const double *p = sample + 3 * i;
        scratch[i] = p[0] * p[0] + p[1] * p[1] + p[2] * p[2];
    }
    limit = AXES_REACH * AXES_REACH * stats_select(scratch, n, AXES_QUANTILE);
    for (size_t i = 0; i < n; i++) {
        const double *p = sample + 3 * i;
        if (p[0] * p[0] + p[1] * p[1] + p[2] * p[2] <= limit) memmove(sample + 3 * kept++, p, 3 * sizeof *p);
    }
    return kept;
}

/* ---------------- principal axes */

static void axes_covariance(const double *p, size_t n, double a[3][3])
{
    double mean[3] = {0, 0, 0};
    memset(a, 0, 9 * sizeof(double));
    for (size_t i = 0; i < n; i++)
        for (int k = 0; k < 3; k++) mean[k] += p[3 * i + k] / (double)n;
    for (size_t i = 0; i < n; i++)
        for (int j = 0; j < 3; j++)
            for (int k = 0; k < 3; k++)
                a[j][k] += (p[3 * i + j] - mean[j]) * (p[3 * i + k] - mean[k]) / (double)n;
}

/* ---------------- extents, order, signs */

static double axes_dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

struct axes_reach {
    double axis[3], low, high;
};

static struct axes_reach axes_measure(const double axis[3], const double *p, size_t n, double *scratch)
{
    struct axes_reach r = {.axis = {axis[0], axis[1], axis[2]}};
    for (size_t i = 0; i < n; i++) scratch[i] = axes_dot(axis, p + 3 * i);
    r.low = stats_select(scratch, n, 0.01);
    r.high = stats_select(scratch, n, 0.99);
    return r;
}

static void axes_flip(struct axes_reach *r)
{
    const double low = r->low;
    for (int k = 0; k < 3; k++) r->axis[k] = -r->axis[k];
    r->low = -r->high;
    r->high = -low;
}

/* Returns the number of cameras on the positive side of an axis less that on the negative side. */
static int axes_side_of_cameras(const oxl_scene *scene, const double axis[3])
{
    int balance = 0;
    for (int i = 0; i < oxl_scene_view_count(scene); i++) {
        double centre[3], height;
        camera_position(&oxl_scene_view(scene, i)->camera, centre);
        height = axes_dot(axis, centre);
        balance += (height > 0) - (height < 0);
    }
    return balance;
}

/* Orients the axes: the third points to the cameras, the first forward (eigen_is_backward), and the second
 * makes the frame right-handed, so that a map of the first two is not mirrored. */
static void axes_orient(const oxl_scene *scene, struct axes_reach r[3])
{
    const double *a = r[0].axis, *b = r[1].axis, *c = r[2].axis;
    if (axes_side_of_cameras(scene, c) < 0) axes_flip(&r[2]);
    if (eigen_is_backward(a)) axes_flip(&r[0]);
    if (a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) +
            a[2] * (b[0] * c[1] - b[1] * c[0]) <
        0)
        axes_flip(&r[1]);
}

static void axes_sort(struct axes_reach r[3])
{
    for (int i = 1; i < 3; i++)
        for (int j = i; j > 0 && r[j].high - r[j].low > r[j - 1].high - r[j - 1].low; j--)
            OXL_SWAP(struct axes_reach, r[j], r[j - 1]);
}

OXL_INTERNAL oxl_result partition_axes(oxl_context *ctx, const oxl_scene *scene, struct partition_axes *out)
{
    const struct colmap *c = scene_colmap(scene);
    const size_t most = OXL_MIN(c->point_count, (size_t)AXES_SAMPLE) + 1;
    double *sample = oxl_alloc(ctx, most, 3 * sizeof *sample);
    double *scratch = oxl_alloc(ctx, most, sizeof *scratch);
    double a[3][3], v[3][3];
    struct axes_reach r[3];
    size_t n, kept;
    oxl_result rc = OXL_OK;
    *out = (struct partition_axes){.rotation = {0}};
    if (!sample || !scratch) rc = OXL_ERR_MEMORY;
    if (rc != OXL_OK) goto done;
    n = axes_sample(c, oxl_scene_origin(scene), sample);
    kept = axes_trim(sample, n, scratch);
    axes_covariance(sample, kept, a);
    eigen_symmetric(a, v);
    for (int i = 0; i < 3; i++) r[i] = axes_measure(v[i], sample, kept, scratch);
    axes_sort(r);
    axes_orient(scene, r);
    for (int i = 0; i < 3; i++) {
        memcpy(out->rotation + 3 * i, r[i].axis, sizeof r[i].axis);
        out->low[i] = r[i].low;
        out->high[i] = r[i].high;
    }
    out->fraction = n ? (double)kept / (double)n : 0;
done:
    OXL_FREE(ctx, sample, scratch);
    return rc;
}
