/* robust_stats.c - computes robust statistics of a survey: bounds, radius of the cameras, depths.
 *
 * Sources: the radius is 3DGS's (Kerbl 2023, reference code), made robust. Depths are used for the near plane
 * and the depth bands of UCD (paper eq. 2), which is defined on SfM points in the views that observe them: on
 * the pool survey the median depth by tracks is 6.1, and 10.7 over all points in front of a camera.
 *
 * Invariant: large surveys are sampled at a fixed stride, so the statistics depend on the survey alone.
 */
#include "sparse.h"
#include "survey.h"
#include "tracks.h"

enum {
    STATS_SAMPLE = 1 << 16, /* most values for a quantile */
    /* views, and points in each, from which depths are sampled if there are no tracks */
    STATS_VIEWS = 64,
    STATS_POINTS = STATS_SAMPLE / STATS_VIEWS
};
/* Makes the median absolute deviation the standard deviation of a normal distribution. */
#define STATS_NORMAL 1.4826
#define STATS_OUTLIER 5.0 /* Leaves out cameras beyond this multiple of the median distance. */

/* ---------------- quantiles */

OXL_INTERNAL int stats_compare(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static size_t stats_rank(size_t count, double quantile)
{
    return (size_t)(OXL_CLAMP(quantile, 0.0, 1.0) * (double)(count - 1) + 0.5);
}

OXL_INTERNAL double stats_quantile(const double *ascending, size_t count, double quantile)
{
    return count ? ascending[stats_rank(count, quantile)] : 0;
}

/* Selects a quantile [Hoare 1961]. Equal values stop both scans, so that many
 * duplicates do not slow it down. */
OXL_INTERNAL double stats_select(double *value, size_t count, double quantile)
{
    const size_t nth = count ? stats_rank(count, quantile) : 0;
    size_t first = 0, end = count;
    while (end - first > 1) {
        /* Avoids the last value as pivot, so that both parts are smaller. */
        const double pivot = value[first + (end - first - 1) / 2];
        size_t i = first, j = end - 1;
        for (;;) {
            while (value[i] < pivot) i++;
            while (value[j] > pivot) j--;
            if (i >= j) break;
            OXL_SWAP(double, value[i], value[j]);
            i++, j--;
        }
        if (nth <= j) end = j + 1;
        else first = j + 1;
    }
    return count ? value[nth] : 0;
}

OXL_INTERNAL double stats_spread(const double *value, size_t count, double *work, double *median)
{
    for (size_t i = 0; i < count; i++) work[i] = value[i];
    *median = stats_select(work, count, 0.5);
    for (size_t i = 0; i < count; i++) work[i] = fabs(value[i] - *median);
    return STATS_NORMAL * stats_select(work, count, 0.5);
}

OXL_INTERNAL oxl_result stats_bounds(oxl_context *ctx, const double *position, size_t n, size_t stride,
                                     double low[3], double middle[3], double high[3])
{
    const size_t step = n / STATS_SAMPLE + 1;
    double *values = oxl_alloc(ctx, n / step + 1, sizeof *values);
    if (!values) return OXL_ERR_MEMORY;
    for (int axis = 0; axis < 3; axis++) {
        size_t count = 0;
        for (size_t i = 0; i < n; i += step) {
            const double value = ((const double *)((const char *)position + i * stride))[axis];
            if (fabs(value) <= DBL_MAX) values[count++] = value;
        }
        low[axis] = stats_select(values, count, 0.01);
        middle[axis] = stats_select(values, count, 0.5);
        high[axis] = stats_select(values, count, 0.99);
    }
    oxl_free(ctx, values);
    return OXL_OK;
}

/* ---------------- cameras */

static double stats_distance(const double a[3], const double b[3])
{
    return sqrt((a[0] - b[0]) * (a[0] - b[0]) + (a[1] - b[1]) * (a[1] - b[1]) +
                (a[2] - b[2]) * (a[2] - b[2]));
}

/* Moves the centres within the limit to the front and returns their number. */
static size_t stats_drop_outliers(double *centre, size_t n, const double middle[3], double limit)
{
    size_t kept = 0;
    for (size_t i = 0; i < n; i++)
        if (stats_distance(centre + 3 * i, middle) <= limit)
            memmove(centre + 3 * kept++, centre + 3 * i, 3 * sizeof *centre);
    return kept;
}

/* Returns the largest distance from the mean of the centres, as in 3DGS. */
static double stats_radius(const double *centre, size_t n)
{
    double mean[3] = {0, 0, 0}, radius = 0;
    for (size_t i = 0; i < n; i++)
        for (int k = 0; k < 3; k++) mean[k] += centre[3 * i + k] / (double)n;
    for (size_t i = 0; i < n; i++) radius = OXL_MAX(radius, stats_distance(centre + 3 * i, mean));
    return radius;
}

OXL_INTERNAL oxl_result stats_camera_radius(oxl_context *ctx, const struct stats_view *views, size_t count,
                                            double *radius)
{
    double *centre = oxl_alloc(ctx, count + 1, 3 * sizeof *centre);
    double *distance = oxl_alloc(ctx, count + 1, sizeof *distance);
    double low[3], middle[3], high[3];
    size_t kept;
    oxl_result rc = OXL_OK;
    *radius = 0;
    if (!centre || !distance) rc = OXL_ERR_MEMORY;
    if (rc != OXL_OK || count == 0) goto done;
    for (size_t i = 0; i < count; i++) camera_position(views[i].camera, centre + 3 * i);
    rc = stats_bounds(ctx, centre, count, 3 * sizeof *centre, low, middle, high);
    if (rc != OXL_OK) goto done;
    for (size_t i = 0; i < count; i++) distance[i] = stats_distance(centre + 3 * i, middle);
    kept = stats_drop_outliers(centre, count, middle, STATS_OUTLIER * stats_select(distance, count, 0.5));
    *radius = stats_radius(centre, kept);
    if (kept < count)
        oxl_log(ctx, OXL_LOG_WARNING, "%zu cameras are far from all others and are excluded from the extent",
                count - kept);
done:
    OXL_FREE(ctx, centre, distance);
    return rc;
}

/* ---------------- depths */

struct stats_depths {
    double *z; /* (STATS_SAMPLE) */
    size_t count;
};

static void stats_add_depth(struct stats_depths *d, const oxl_camera *c, const double p[3])
{
    double x[3];
    camera_transform(c, p, NULL, x);
    if (x[2] > 0 && x[2] <= DBL_MAX && d->count < STATS_SAMPLE) d->z[d->count++] = x[2];
}

/* Adds every k-th entry of all tracks. view_of: (images) scratch, set to each image's index in `views`; -1: a
 * test view or a missing image. */
static void stats_by_tracks(const struct stats_view *views, size_t count, const struct stats_points *points,
                            int *view_of, struct stats_depths *d)
{
    const struct colmap *c = points->colmap;
    struct tracks_walk w = tracks_of(c, view_of);
    w.step = c->track_count / STATS_SAMPLE + 1;
    for (size_t i = 0; i < c->image_count; i++) view_of[i] = -1;
    for (size_t v = 0; v < count && c->image_count; v++) view_of[views[v].image_row] = (int)v;
    while (tracks_next(&w)) {
        const double *p = c->point[w.point].position, *origin = points->origin;
        stats_add_depth(d, views[w.view].camera,
                        (double[]){p[0] - origin[0], p[1] - origin[1], p[2] - origin[2]});
    }
}

OXL_INTERNAL int stats_is_in_image(const oxl_camera *c, const double p[3])
{
    double x[3], pixel[2];
    return camera_project(c, p, NULL, x, pixel) && fabs(pixel[0] - 0.5 * c->width) <= 0.5 * c->width &&
           fabs(pixel[1] - 0.5 * c->height) <= 0.5 * c->height;
}

/* Adds points that project into an image, which may be hidden there; only scenes without tracks need it. */
static void stats_by_image(const struct stats_view *views, size_t count, const struct stats_points *points,
                           struct stats_depths *d)
{
    const size_t view_step = count / STATS_VIEWS + 1, step = points->count / STATS_POINTS + 1;
    for (size_t v = 0; v < count; v += view_step)
        for (size_t i = 0; i < points->count; i += step) {
            const double *position = points->point[i].position;
            if (stats_is_in_image(views[v].camera, position)) stats_add_depth(d, views[v].camera, position);
        }
}

OXL_INTERNAL oxl_result stats_depths(oxl_context *ctx, const struct stats_view *views, size_t count,
                                     const struct stats_points *points, double **out, size_t *out_count)
{
    struct stats_depths d = {.z = oxl_alloc(ctx, STATS_SAMPLE, sizeof *d.z)};
    int *view_of = oxl_alloc(ctx, points->colmap->image_count + 1, sizeof *view_of);
    *out = d.z;
    *out_count = 0;
    if (!d.z || !view_of) {
        oxl_free(ctx, view_of);
        return OXL_ERR_MEMORY;
    }
    stats_by_tracks(views, count, points, view_of, &d);
    oxl_free(ctx, view_of);
    if (d.count == 0) stats_by_image(views, count, points, &d);
    qsort(d.z, d.count, sizeof *d.z, stats_compare);
    *out_count = d.count;
    return OXL_OK;
}
