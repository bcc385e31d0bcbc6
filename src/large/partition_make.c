/* partition_make.c - makes the partition of a survey: its frame, its blocks, and the views of each (OceanXL
 * sec. 3.1, Alg. 1).
 *
 * A view belongs to a block that holds more than 0.3 of the points it sees (base), or of whose points it sees
 * more than 0.1 (border) [BlockGaussian]. A block starts from its own points and all that its views see.
 *
 * The paper discards blocks of too few points or views, and leaves holes; here no block is discarded.
 */
#include "partition.h"
#include "../survey/sparse.h"
#include "../survey/scene.h"
#include "../survey/tracks.h"

#define PARTITION_FLAT 0.3 /* Bounds l3 / l2 of a survey that is cut in 2D [OceanXL]. */

/* ---------------- views of the blocks */

OXL_INTERNAL int partition_has_view(const struct partition *p, int block, int view)
{
    return view >= 0 && p->plan->has[(size_t)block * p->plan->scene->view_count + (size_t)view];
}

/* Returns 1 if the block starts from the point: it is its own, or a view of the block sees it. */
static int partition_starts_from(const struct partition *p, int block, size_t point)
{
    const struct colmap *c = scene_colmap(p->plan->scene);
    const struct colmap_point *from = &c->point[point];
    int found = p->plan->owner[point] == block;
    for (uint32_t k = 0; k < from->track_count && !found; k++)
        found = partition_has_view(p, block, p->plan->view_of[c->track[from->first_track + k].image_row]);
    return found;
}

/* Decides on the views of a block by the paper's two rules, exactly, in integers. seen: (views) points of the
 * block that each sees. */
static void partition_assign_views(const struct partition *p, int block, const size_t *seen)
{
    const struct partition_plan *plan = p->plan;
    const int views = plan->scene->view_count;
    struct partition_block *b = &p->block[block];
    uint8_t *has = plan->has + (size_t)block * views;
    for (int v = 0; v < views; v++) {
        const int is_alone = p->block_count == 1 && !plan->scene->view[v].is_test;
        has[v] = is_alone || 10 * seen[v] > 3 * plan->seen[v] || 10 * seen[v] > b->points;
    }
    for (size_t i = 0; i < scene_colmap(plan->scene)->point_count; i++)
        b->start_points += (size_t)partition_starts_from(p, block, i);
}

static oxl_result partition_find_views(oxl_context *ctx, struct partition *p)
{
    const size_t views = (size_t)p->plan->scene->view_count, size = (size_t)p->block_count * views + 1;
    struct tracks_walk w = tracks_of(scene_colmap(p->plan->scene), p->plan->view_of);
    size_t *seen = oxl_calloc(ctx, size, sizeof *seen);
    p->plan->has = oxl_calloc(ctx, size, 1);
    if (seen && p->plan->has) {
        for (w.origin = p->origin; tracks_next(&w); p->plan->seen[w.view]++)
            seen[(size_t)p->plan->owner[w.point] * views + (size_t)w.view]++;
#pragma omp parallel for schedule(dynamic) num_threads(ctx->threads)
        for (int i = 0; i < p->block_count; i++) partition_assign_views(p, i, seen + (size_t)i * views);
    }
    oxl_free(ctx, seen);
    return seen && p->plan->has ? OXL_OK : OXL_ERR_MEMORY;
}

/* ---------------- a partition */

/* Returns the number of blocks that the options ask for. */
static int partition_wanted(size_t points, const oxl_partition_options *o)
{
    return o->kind == OXL_PARTITION_NONE || points == 0 ? 1
           : o->blocks > 0                              ? o->blocks
           : o->block_points > 0                        ? (int)((points - 1) / (size_t)o->block_points) + 1
                                                        : 1;
}

static oxl_result partition_check(oxl_context *ctx, const oxl_scene *scene, int blocks)
{
    const int views = scene->stats.views - scene->stats.test_views;
    if (!scene_colmap(scene))
        return oxl_fail(ctx, OXL_ERR_USAGE,
                        "a scene from arrays has no tracks, so it cannot be partitioned\n"
                        "fix: load the scene from a COLMAP model");
    if (blocks > OXL_MAX(views, 1))
        return oxl_fail(ctx, OXL_ERR_USAGE,
                        "%d blocks of %zu points are more than the %d training views\nfix: --blocks %d",
                        blocks, scene->stats.points, views, OXL_MAX(1, views / 10));
    return OXL_OK;
}

static oxl_result partition_begin(oxl_context *ctx, const oxl_scene *scene, oxl_partition_kind kind,
                                  struct partition *p)
{
    struct partition_plan *plan = oxl_calloc(ctx, 1, sizeof *plan);
    oxl_result rc = OXL_ERR_MEMORY;
    if (!plan) return rc;
    p->plan = plan;
    memcpy(p->origin, scene->origin, sizeof p->origin);
    plan->scene = scene;
    plan->owner = oxl_alloc(ctx, scene_colmap(scene)->point_count + 1, sizeof *plan->owner);
    plan->seen = oxl_calloc(ctx, (size_t)scene->view_count + 1, sizeof *plan->seen);
    plan->view_of = scene_views_by_image(ctx, scene, OXL_SPLIT_TRAIN);
    if (plan->owner && plan->seen && plan->view_of) rc = partition_axes(ctx, scene, p);
    if (kind != OXL_PARTITION_2D && p->extent[1] > 0 && p->extent[2] / p->extent[1] >= PARTITION_FLAT)
        kind = OXL_PARTITION_3D;
    p->dimensions = kind == OXL_PARTITION_3D ? 3 : 2;
    return rc;
}

OXL_INTERNAL oxl_result partition_make(oxl_context *ctx, const oxl_scene *scene,
                                       const oxl_partition_options *o, struct partition *out)
{
    const size_t points = scene->stats.points;
    int blocks = partition_wanted(points, o);
    size_t limit = points;
    oxl_result rc = partition_check(ctx, scene, blocks);
    *out = (struct partition){.dimensions = 3};
    if (rc == OXL_OK) rc = partition_begin(ctx, scene, o->kind, out);
    if (rc == OXL_OK) {
        if (scene_colmap(scene)->track_count == 0) blocks = 1;
        if (blocks > 1 && o->blocks == 0) limit = (size_t)o->block_points;
        else if (o->cut == OXL_CUT_MIDPOINT) limit = points / (size_t)blocks + 1;
        rc = partition_cut(ctx, out, o->cut, blocks, limit);
    }
    if (rc == OXL_OK) rc = partition_find_views(ctx, out);
    if (rc != OXL_OK) partition_free(ctx, out);
    else if (out->block_count > 1)
        oxl_log(ctx, OXL_LOG_INFO, "blocks       %d, cut in %dD", out->block_count, out->dimensions);
    return rc;
}

OXL_INTERNAL void partition_free_plan(oxl_context *ctx, struct partition *p)
{
    if (!p->plan) return;
    OXL_FREE(ctx, p->plan->owner, p->plan->view_of, p->plan->seen, p->plan->has, p->plan);
    p->plan = NULL;
}

OXL_INTERNAL void partition_free(oxl_context *ctx, struct partition *p)
{
    partition_free_plan(ctx, p);
    oxl_free(ctx, p->block);
    *p = (struct partition){0};
}
