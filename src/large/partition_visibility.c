/* partition_visibility.c - lists the points observed by each view, from the tracks of points3D.
 *
 * Invariant: only training views have lists. What a test view observes must not influence the blocks, or it
 * would not be held out.
 */
#include "partition.h"
#include "../survey/sparse.h"
#include "../survey/scene.h"
#include "../survey/tracks.h"

/* ---------------- from lists by point to lists by view */

struct visibility_build {
    const struct colmap *colmap;
    const double *origin;
    int *view; /* (images of the COLMAP model) training view of the image; -1: none */
    struct partition_visibility *visibility;
    size_t *next; /* (PARTITION_TASKS, views) number of a task's entries, then the place of its next entry */
};

/* Goes through a task's points: counts the entries of each view, or with `fill` writes them. */
static void visibility_scan(const struct visibility_build *b, int task, int fill)
{
    const struct colmap *c = b->colmap;
    size_t *next = b->next + (size_t)task * b->visibility->views;
    struct tracks_walk w = tracks_of(c, b->view);
    w.origin = b->origin;
    w.point = c->point_count * (size_t)task / PARTITION_TASKS;
    w.end = c->point_count * ((size_t)task + 1) / PARTITION_TASKS;
    while (tracks_next(&w)) {
        if (fill) {
            b->visibility->point[next[w.view]] = (uint32_t)w.point;
            b->visibility->observation[next[w.view]] = w.observation;
        }
        next[w.view]++;
    }
}

/* Turns counts into places: a view's list holds the points of the first task, then those
 * of the second, and so on. */
static void visibility_offsets(const struct visibility_build *b)
{
    size_t total = 0;
    for (size_t v = 0; v < b->visibility->views; v++) {
        b->visibility->first[v] = total;
        for (int task = 0; task < PARTITION_TASKS; task++) {
            size_t *next = b->next + (size_t)task * b->visibility->views + v;
            const size_t count = *next;
            *next = total;
            total += count;
        }
    }
    b->visibility->first[b->visibility->views] = total;
}

static uint32_t visibility_count_different(const struct partition_visibility *vis, size_t view)
{
    uint32_t count = 0;
    for (size_t k = vis->first[view]; k < vis->first[view + 1]; k++)
        count += k == vis->first[view] || vis->point[k] != vis->point[k - 1];
    return count;
}

static oxl_result visibility_alloc_lists(oxl_context *ctx, struct partition_visibility *vis)
{
    const size_t total = vis->first[vis->views];
    vis->point = oxl_alloc(ctx, total + 1, sizeof *vis->point);
    vis->observation = oxl_alloc(ctx, total + 1, sizeof *vis->observation);
    if (vis->point && vis->observation) return OXL_OK;
    return OXL_ERR_MEMORY;
}

OXL_INTERNAL oxl_result partition_visibility_create(oxl_context *ctx, const oxl_scene *scene,
                                                    struct partition_visibility **out)
{
    const size_t views = (size_t)oxl_scene_view_count(scene);
    struct partition_visibility *vis = oxl_calloc(ctx, 1, sizeof *vis);
    struct visibility_build b = {
        .colmap = scene_colmap(scene), .origin = oxl_scene_origin(scene), .visibility = vis};
    oxl_result rc = OXL_OK;
    *out = NULL;
    if (vis) {
        vis->views = views;
        vis->first = oxl_calloc(ctx, views + 1, sizeof *vis->first);
        vis->seen = oxl_calloc(ctx, views + 1, sizeof *vis->seen);
        b.next = oxl_calloc(ctx, PARTITION_TASKS * views, sizeof *b.next);
    }
    if (!vis || !vis->first || !vis->seen || !b.next) rc = OXL_ERR_MEMORY;
    if (rc == OXL_OK && b.colmap->point_count >= UINT32_MAX)
        rc = oxl_fail(
            ctx, OXL_ERR_INPUT,
            "%zu points are more than a partition can number (2^32 - 1)\nfix: filter points3D to fewer points",
            b.colmap->point_count);
    if (rc == OXL_OK && !(b.view = scene_views_by_image(ctx, scene, OXL_SPLIT_TRAIN))) rc = ctx->failed;
    if (rc != OXL_OK) goto done;
#pragma omp parallel for schedule(dynamic) num_threads(ctx->threads)
    for (int task = 0; task < PARTITION_TASKS; task++) visibility_scan(&b, task, 0);
    visibility_offsets(&b);
    rc = visibility_alloc_lists(ctx, vis);
    if (rc != OXL_OK) goto done;
#pragma omp parallel for schedule(dynamic) num_threads(ctx->threads)
    for (int task = 0; task < PARTITION_TASKS; task++) visibility_scan(&b, task, 1);
#pragma omp parallel for schedule(static) num_threads(ctx->threads)
    for (int v = 0; v < (int)views; v++) vis->seen[v] = visibility_count_different(vis, (size_t)v);
done:
    OXL_FREE(ctx, b.next, b.view);
    if (rc != OXL_OK) partition_visibility_free(ctx, vis);
    else *out = vis;
    return rc;
}

OXL_INTERNAL void partition_visibility_free(oxl_context *ctx, struct partition_visibility *vis)
{
    if (!vis) return;
    OXL_FREE(ctx, vis->first, vis->point, vis->observation, vis->seen, vis);
}
