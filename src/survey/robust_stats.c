/* robust_stats.c - computes robust statistics of a survey: bounds, radius of the cameras, depths.
 *
 * Sources: the radius is 3DGS's (Kerbl 2023, reference code), made robust. Depths are used for the near plane
 * and the depth bands of UCD (paper eq. 2), which is defined on SfM points in the views that observe them: on
 * the pool survey the median depth by tracks is 6.1, and 10.7 over all points in front of a camera.
 *
 * Invariant: large surveys are sampled at a fixed stride, so the statistics depend on the survey alone.
 */
#include "scene.h"
#include "sparse.h"
#include "survey.h"
#include "tracks.h"

enum {
    STATS_SAMPLE = 1 << 16, /* most values for a quantile */
    /* views, and points in each, from which depths are sampled if there are no tracks */
    STATS_VIEWS = 64,
    STATS_POINTS = STATS_SAMPLE / STATS_VIEWS
};
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

/* Returns the largest distance from the mean of the centres, as in 3DGS. */
static double stats_radius(const double *centre, size_t n)
{
    double mean[3] = {0, 0, 0}, radius = 0;
    for (size_t i = 0; i < n; i++)
        for (int k = 0; k < 3; k++) mean[k] += centre[3 * i + k] / (double)n;
    for (size_t i = 0; i < n; i++) radius = OXL_MAX(radius, camera_apart(centre + 3 * i, mean));
    return radius;
}

OXL_INTERNAL oxl_result stats_camera_radius(oxl_context *ctx, const oxl_scene *scene, double *radius)
{
    double *centre = oxl_alloc(ctx, (size_t)scene->view_count + 1, 3 * sizeof *centre);
    double *distance = oxl_alloc(ctx, (size_t)scene->view_count + 1, sizeof *distance);
    double low[3], middle[3], high[3], limit;
    size_t count = 0, kept = 0;
    const char *far = NULL;
    oxl_result rc = centre && distance ? OXL_OK : OXL_ERR_MEMORY;
    *radius = 0;
    for (int v = 0; v < scene->view_count && rc == OXL_OK; v++)
        if (!scene->view[v].is_test) camera_position(&scene->view[v].camera, centre + 3 * count++);
    if (rc == OXL_OK && count) rc = stats_bounds(ctx, centre, count, 3 * sizeof *centre, low, middle, high);
    if (rc != OXL_OK) count = 0;
    for (size_t i = 0; i < count; i++) distance[i] = camera_apart(centre + 3 * i, middle);
    limit = STATS_OUTLIER * stats_select(distance, count, 0.5);
    for (int v = 0; v < scene->view_count && count; v++) {
        double at[3];
        camera_position(&scene->view[v].camera, at);
        if (scene->view[v].is_test) continue;
        if (camera_apart(at, middle) <= limit) memcpy(centre + 3 * kept++, at, sizeof at);
        else far = scene->view[v].name;
    }
    *radius = stats_radius(centre, kept);
    if (kept < count)
        oxl_log(ctx, OXL_LOG_WARNING,
                "%zu cameras, such as that of %s, are far from all others, and are excluded from the extent\n"
                "fix: leave them out of the model if their poses are wrong",
                count - kept, far);
    OXL_FREE(ctx, centre, distance);
    return rc;
}

/* ---------------- depths */

static void stats_add_depth(oxl_scene *scene, int view, const double world[3], const double *origin)
{
    double x[3];
    camera_transform(&scene->view[view].camera, world, origin, x);
    if (x[2] > 0 && x[2] <= DBL_MAX && scene->depth_count < STATS_SAMPLE)
        scene->depth[scene->depth_count++] = x[2];
}

/* Adds points that project into an image, which may be hidden there; only scenes without tracks need it. */
static void stats_by_image(oxl_scene *scene)
{
    size_t train = 0, step = scene->point_count / STATS_POINTS + 1, seen = 0;
    for (int v = 0; v < scene->view_count; v++) train += !scene->view[v].is_test;
    for (int v = 0; v < scene->view_count; v++) {
        if (scene->view[v].is_test || seen++ % (train / STATS_VIEWS + 1) != 0) continue;
        for (size_t i = 0; i < scene->point_count; i += step) {
            double x[3], pixel[2];
            if (camera_sees(&scene->view[v].camera, scene->point[i].position, x, pixel))
                stats_add_depth(scene, v, scene->point[i].position, NULL);
        }
    }
}

OXL_INTERNAL oxl_result stats_depths(oxl_context *ctx, oxl_scene *scene)
{
    const struct colmap *c = &scene->colmap;
    int *view_of = oxl_alloc(ctx, c->image_count + 1, sizeof *view_of);
    struct tracks_walk w = tracks_of(c, view_of);
    scene->depth = oxl_alloc(ctx, STATS_SAMPLE, sizeof *scene->depth);
    for (size_t i = 0; view_of && i < c->image_count; i++) view_of[i] = -1;
    for (int v = 0; view_of && v < scene->view_count; v++)
        if (!scene->view[v].is_test) view_of[scene->source[v].image] = v;
    w.step = c->track_count / STATS_SAMPLE + 1;
    while (scene->depth && view_of && tracks_next(&w))
        stats_add_depth(scene, w.view, c->point[w.point].position, scene->origin);
    if (scene->depth && scene->depth_count == 0) stats_by_image(scene);
    if (scene->depth) qsort(scene->depth, scene->depth_count, sizeof *scene->depth, stats_compare);
    oxl_free(ctx, view_of);
    return scene->depth && view_of ? OXL_OK : OXL_ERR_MEMORY;
}
