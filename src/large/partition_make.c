/* partition_make.c - cuts a survey into blocks (OceanXL sec. 3.1, Alg. 1).
 *
 *     a box of k blocks is cut across its longest axis at the ratio r of 0.30, 0.32 ... 0.70 whose sides come
 *     nearest to k1/k and k2/k of its load, k1 + k2 = k; the survey has k = ceil(N / N_p) blocks, or the
 *     fewest above that of at most N_p points each. A view belongs to a block that holds more than 0.3 of the
 *     points it sees (base), or of whose points it sees more than 0.1 (border) [BlockGaussian]. A block
 *     starts from the points in its box, made 5 % wider on each side, and from all points that its views see.
 *
 * Deviations from Alg. 1, which halves by points while a box holds more than N_p: halving ends at a power of
 * two of blocks, up to twice as many as N_p requires; and points alone balance memory, not work. The load is
 * half points, half training pixels: each view distributes its pixels evenly over the points it sees. There
 * are never more blocks than cuts at the midpoint would give.
 *
 * The paper discards blocks of too few points or views, and leaves holes. Here a cut that would make a block
 * of too few points is not made: the box that is searched shrinks to its fuller half instead. If a block has
 * too few views, the cut that made it is undone, and its sibling's blocks extend into its box: they remain
 * boxes, however often they were cut themselves.
 *
 * Invariant: every place, and so every point and every Gaussian, belongs to exactly one block.
 */
#include "partition_build.h"
#include "../survey/sparse.h"
#include "../survey/scene.h"
#include "../survey/tracks.h"

enum { PARTITION_MIN_POINTS = 100, PARTITION_MIN_VIEWS = 20 };
#define PARTITION_FLAT 0.3 /* Bounds l3 / l2 of a survey that is cut in 2D [OceanXL]. */

OXL_INTERNAL void partition_to_frame(const struct partition *p, const double world[3], double out[3])
{
    for (int i = 0; i < 3; i++) {
        out[i] = 0;
        for (int k = 0; k < 3; k++) out[i] += p->rotation[3 * i + k] * (world[k] - p->origin[k]);
    }
}

/* ---------------- so many blocks */

/* Cuts into `leaves` blocks (0: until none has more than N_p points), then undoes cuts that
 * leave a block too small. */
static oxl_result partition_try(struct partition_build *b, oxl_cut cut, int leaves, size_t *largest)
{
    oxl_result rc;
    b->options.cut = cut;
    rc = partition_grow_to(b, leaves);
    return rc == OXL_OK ? partition_assign(b, largest) : rc;
}

/* Finds the fewest blocks of at most N_p points, but never more than cuts at the midpoint give. Where a
 * balanced load does not succeed, points alone are balanced, as in the paper. */
static oxl_result partition_balance(struct partition_build *b)
{
    const size_t limit = (size_t)b->options.block_points;
    const int fewest = (int)OXL_MIN((b->kept + limit - 1) / limit, (size_t)INT_MAX / 2);
    size_t largest;
    oxl_result rc = partition_try(b, OXL_CUT_MIDPOINT, 0, &largest);
    const int most = b->leaf_count;
    for (int leaves = fewest; rc == OXL_OK && leaves <= most; leaves += OXL_MAX(1, leaves / 16))
        for (int by_load = 1; by_load >= 0 && rc == OXL_OK; by_load--) {
            rc = partition_set_loads(b, 0.5 * by_load);
            if (rc == OXL_OK) rc = partition_try(b, OXL_CUT_BALANCED, leaves, &largest);
            if (rc == OXL_OK && largest <= limit) return rc;
        }
    if (rc == OXL_OK) rc = partition_try(b, OXL_CUT_BALANCED, 0, &largest);
    return rc == OXL_OK && b->leaf_count > most ? partition_try(b, OXL_CUT_MIDPOINT, 0, &largest) : rc;
}

/* ---------------- the plan */

/* Lists the points in each block's expanded box, ascending: counts become offsets, which filling moves by one
 * block and the last loop moves back. */
static oxl_result partition_list_members(const struct partition_build *b, struct partition_plan *plan)
{
    const size_t blocks = (size_t)b->leaf_count, total = b->first[b->count];
    plan->first_member = oxl_calloc(b->ctx, blocks + 1, sizeof *plan->first_member);
    plan->member = oxl_alloc(b->ctx, total + 1, sizeof *plan->member);
    if (!plan->first_member || !plan->member) return OXL_ERR_MEMORY;
    for (size_t i = 0; i < blocks; i++) plan->first_member[i + 1] = plan->first_member[i] + b->inside[i];
    for (size_t i = 0; i < b->count; i++)
        for (uint32_t k = b->first[i]; k < b->first[i + 1]; k++)
            plan->member[plan->first_member[b->blocks[k]]++] = (uint32_t)i;
    for (size_t i = blocks; i > 0; i--) plan->first_member[i] = plan->first_member[i - 1];
    plan->first_member[0] = 0;
    return OXL_OK;
}

static size_t partition_mark_one(uint64_t *bits, uint32_t i)
{
    const uint64_t bit = UINT64_C(1) << (i & 63), had = bits[i >> 6] & bit;
    bits[i >> 6] |= bit;
    return had == 0;
}

OXL_INTERNAL size_t partition_mark(const struct partition *p, int block, uint64_t *bits)
{
    const struct partition_plan *plan = p->plan;
    const struct partition_visibility *vis = plan->visibility;
    size_t count = 0;
    for (size_t k = plan->first_member[block]; k < plan->first_member[block + 1]; k++)
        count += partition_mark_one(bits, plan->member[k]);
    for (size_t v = 0; v < vis->views; v++) {
        if (plan->role[(size_t)block * vis->views + v] == PARTITION_OUT) continue;
        for (size_t k = vis->first[v]; k < vis->first[v + 1]; k++)
            count += partition_mark_one(bits, vis->point[k]);
    }
    return count;
}

static oxl_result partition_count_starts(oxl_context *ctx, struct partition *p, size_t points)
{
    const size_t words = (points + 63) / 64;
    uint64_t *bits = oxl_alloc(ctx, PARTITION_TASKS * words + 1, sizeof *bits);
    if (!bits) return OXL_ERR_MEMORY;
#pragma omp parallel for schedule(dynamic) num_threads(ctx->threads)
    for (int task = 0; task < PARTITION_TASKS; task++)
        for (int i = task; i < p->block_count; i += PARTITION_TASKS) {
            uint64_t *mine = bits + (size_t)task * words;
            memset(mine, 0, words * sizeof *mine);
            p->block[i].start_points = partition_mark(p, i, mine);
        }
    oxl_free(ctx, bits);
    return OXL_OK;
}

static void partition_fill_blocks(const struct partition_build *b, struct partition *p)
{
    for (int i = 0; i < b->leaf_count; i++) {
        const struct partition_node *n = &b->node[b->leaf[i]];
        p->block[i] = (struct partition_block){n->box, n->expanded, n->finite, n->points, 0, 0, 0};
        for (size_t v = 0; v < b->visibility->views; v++) {
            const uint8_t role = p->plan->role[(size_t)i * b->visibility->views + v];
            p->block[i].base_views += role == PARTITION_BASE;
            p->block[i].border_views += role == PARTITION_BORDER;
        }
    }
}

/* Moves the result from the build to the partition. */
static oxl_result partition_finish(struct partition_build *b, struct partition *p)
{
    oxl_result rc = partition_list_members(b, p->plan);
    p->block = oxl_calloc(b->ctx, (size_t)b->leaf_count, sizeof *p->block);
    if (rc == OXL_OK && !p->block) rc = OXL_ERR_MEMORY;
    if (rc != OXL_OK) return rc;
    p->block_count = b->leaf_count;
    for (size_t i = 0; i < b->count; i++)
        if (b->owner[i] != PARTITION_NO_BLOCK) b->owner[i] = (uint32_t)b->node[b->owner[i]].block;
    p->plan->owner = b->owner;
    p->plan->role = b->role;
    b->owner = NULL;
    b->role = NULL;
    partition_fill_blocks(b, p);
    return partition_count_starts(b->ctx, p, b->count);
}

/* ---------------- before */

static int partition_train_views(const oxl_scene *scene)
{
    return scene->stats.views - scene->stats.test_views;
}

/* Sets the least points and views of a block: lower in a small survey, and at most a quarter of a block's
 * points and the block's fraction of all images, or small blocks, which are requested on purpose, would
 * all be joined. */
static void partition_set_minimum(struct partition_build *b)
{
    const size_t n = (size_t)b->options.block_points;
    const int views = partition_train_views(b->scene);
    const double fraction = views * (double)n / (double)OXL_MAX(b->kept, (size_t)1);
    b->min_points = OXL_MAX(n / 20, OXL_MIN((size_t)PARTITION_MIN_POINTS, n / 4));
    b->min_points = OXL_MAX(b->min_points, (size_t)1);
    b->min_views = OXL_CLAMP(views / 10, 1, PARTITION_MIN_VIEWS);
    if (fraction < b->min_views) b->min_views = OXL_MAX(1, (int)fraction);
}

static oxl_result partition_load_points(struct partition_build *b, const struct partition *p)
{
    const struct colmap *c = scene_colmap(b->scene);
    b->count = c->point_count;
    b->position = oxl_alloc(b->ctx, b->count + 1, 3 * sizeof *b->position);
    b->owner = oxl_alloc(b->ctx, b->count + 1, sizeof *b->owner);
    b->first = oxl_alloc(b->ctx, b->count + 1, sizeof *b->first);
    if (!b->position || !b->owner || !b->first) return OXL_ERR_MEMORY;
#pragma omp parallel for schedule(static) num_threads(b->ctx->threads)
    for (int task = 0; task < PARTITION_TASKS; task++)
        for (size_t i = partition_task_begin(b->count, task); i < partition_task_begin(b->count, task + 1);
             i++) {
            b->owner[i] = tracks_accept_point(&c->point[i], p->origin) ? 0 : PARTITION_NO_BLOCK;
            partition_to_frame(p, c->point[i].position, b->position + 3 * i);
        }
    for (size_t i = 0; i < b->count; i++) b->kept += b->owner[i] != PARTITION_NO_BLOCK;
    return OXL_OK;
}

static void partition_log_frame(oxl_context *ctx, const oxl_partition_options *o, const struct partition *p,
                                double fraction)
{
    const double ratio = p->extent[1] > 0 ? p->extent[2] / p->extent[1] : 0;
    oxl_log(
        ctx, OXL_LOG_INFO,
        "principal extents %.4g x %.4g x %.4g (1st to 99th percentile; %.1f %% of the points kept by the trim)",
        p->extent[0], p->extent[1], p->extent[2], 100 * fraction);
    if (o->kind == OXL_PARTITION_2D || o->kind == OXL_PARTITION_3D)
        oxl_log(ctx, OXL_LOG_INFO, "partition in %dD, as set (l3/l2 = %.3f suggests %dD)", p->dimensions,
                ratio, ratio < PARTITION_FLAT ? 2 : 3);
    else
        oxl_log(ctx, OXL_LOG_INFO, "partition in %dD: l3/l2 = %.3f is %s %.1f", p->dimensions, ratio,
                ratio < PARTITION_FLAT ? "less than" : "not less than", PARTITION_FLAT);
}

static void partition_set_frame(const oxl_scene *scene, const oxl_partition_options *o,
                                const struct partition_axes *axes, struct partition *p)
{
    memcpy(p->rotation, axes->rotation, sizeof p->rotation);
    memcpy(p->origin, oxl_scene_origin(scene), sizeof p->origin);
    memcpy(p->plan->finite.low, axes->low, sizeof axes->low);
    memcpy(p->plan->finite.high, axes->high, sizeof axes->high);
    for (int k = 0; k < 3; k++) p->extent[k] = axes->high[k] - axes->low[k];
    p->dimensions = o->kind == OXL_PARTITION_2D                                         ? 2
                    : o->kind == OXL_PARTITION_3D                                       ? 3
                    : p->extent[1] > 0 && p->extent[2] / p->extent[1] >= PARTITION_FLAT ? 3
                                                                                        : 2;
}

/* Returns why the survey stays one block; NULL: it is cut. */
static const char *partition_reason_for_one(const struct partition_build *b)
{
    if (b->options.kind == OXL_PARTITION_NONE) return "as set";
    if (b->kept <= (size_t)b->options.block_points) return "they are not more than a block may hold";
    if (b->visibility->first[b->visibility->views] == 0)
        return "the points have no tracks, which tell what a view sees";
    return NULL;
}

static void partition_log_blocks(const struct partition_build *b, const struct partition *p)
{
    size_t least = SIZE_MAX, most = 0, idle = 0, views = b->visibility->views;
    for (int i = 0; i < p->block_count; i++) {
        least = OXL_MIN(least, p->block[i].points);
        most = OXL_MAX(most, p->block[i].points);
    }
    for (size_t v = 0; v < views; v++) {
        int used = oxl_scene_view(b->scene, (int)v)->is_test;
        for (int i = 0; i < p->block_count && !used; i++)
            used = p->plan->role[(size_t)i * views + v] != PARTITION_OUT;
        idle += !used;
    }
    if (b->undone > 0)
        oxl_log(b->ctx, b->level, "%d cut%s undone: less than %zu points or %d views on a side", b->undone,
                b->undone == 1 ? "" : "s", b->min_points, b->min_views);
    oxl_log(b->ctx, b->level, "%d block%s of %zu to %zu points", p->block_count,
            p->block_count == 1 ? "" : "s", least, most);
    if (p->block_count > 1 && most > (size_t)b->options.block_points)
        oxl_log(
            b->ctx, b->level == OXL_LOG_INFO ? OXL_LOG_WARNING : b->level,
            "the largest block holds %zu points, more than --block-points %d: no cut leaves enough points and views on both sides",
            most, b->options.block_points);
    if (idle > 0)
        oxl_log(b->ctx, b->level, "%zu training views observe too few points of every block and are not used",
                idle);
}

static oxl_result partition_build(struct partition_build *b, struct partition *p)
{
    const char *reason;
    size_t largest;
    oxl_result rc = partition_load_points(b, p);
    if (rc == OXL_OK) rc = oxl_reserve(b->ctx, &b->node, &b->node_capacity, 1, sizeof *b->node);
    if (rc != OXL_OK) goto done;
    partition_set_minimum(b);
    b->finite = p->plan->finite;
    b->dimensions = p->dimensions;
    b->depth = partition_depth(b->kept, (size_t)b->options.block_points);
    b->node[0] = (struct partition_node){.finite = b->finite, .points = b->kept, .in_batch = -1};
    b->node_count = 1;
    reason = partition_reason_for_one(b);
    rc = partition_set_loads(b, 0);
    if (rc != OXL_OK) goto done;
    if (reason) {
        oxl_log(b->ctx, b->level, "%zu points stay one block: %s", b->kept, reason);
        rc = partition_assign_to_one(b);
    } else
        rc = b->options.cut == OXL_CUT_MIDPOINT ? partition_try(b, OXL_CUT_MIDPOINT, 0, &largest)
                                                : partition_balance(b);
    if (rc == OXL_OK) rc = partition_finish(b, p);
    if (rc == OXL_OK && !reason) partition_log_blocks(b, p);
done:
    OXL_FREE(b->ctx, b->position, b->owner, b->load, b->node, b->leaf, b->first, b->blocks, b->inside,
             b->role, b->few_views);
    return rc;
}

/* ---------------- a partition */

static oxl_result partition_check(oxl_context *ctx, const oxl_scene *scene, const oxl_partition_options *o)
{
    const struct scene_stats *stats = &scene->stats;
    const size_t points = stats->points, views = (size_t)(stats->views - stats->test_views);
    if (!scene_colmap(scene))
        return oxl_fail(ctx, OXL_ERR_USAGE,
                        "a scene from arrays has no tracks, so it cannot be partitioned\n"
                        "fix: load the scene from a COLMAP model");
    if (o->kind != OXL_PARTITION_NONE && views > 0 && points / (size_t)o->block_points > views)
        return oxl_fail(
            ctx, OXL_ERR_USAGE,
            "blocks of %d points: %zu points make at least %zu blocks, more than the %zu training views\n"
            "fix: --block-points 40000, or at least %zu",
            o->block_points, points, points / (size_t)o->block_points, views, points / views + 1);
    return OXL_OK;
}

/* Turns a number of blocks, or no limit, into the limit of points in a block. */
static oxl_partition_options partition_resolve_options(const oxl_scene *scene,
                                                       const oxl_partition_options *options)
{
    oxl_partition_options o = options ? *options : oxl_partition_options_default();
    if (o.blocks > 0)
        o.block_points = (int)OXL_MAX(1, (scene->stats.points + (size_t)o.blocks - 1) / (size_t)o.blocks);
    if (o.block_points < 1) o.block_points = INT_MAX;
    return o;
}

OXL_INTERNAL oxl_result partition_make(oxl_context *ctx, const oxl_scene *scene,
                                       const oxl_partition_options *options, struct partition *out)
{
    const oxl_partition_options o = partition_resolve_options(scene, options);
    struct partition_build b = {.ctx = ctx, .level = OXL_LOG_INFO, .scene = scene, .options = o};
    struct partition_axes axes;
    oxl_result rc = partition_check(ctx, scene, &o);
    *out = (struct partition){.dimensions = 3};
    if (rc != OXL_OK) return rc;
    out->plan = oxl_calloc(ctx, 1, sizeof *out->plan);
    if (!out->plan) return OXL_ERR_MEMORY;
    *out->plan = (struct partition_plan){.scene = scene, .owns_visibility = 1};
    rc = partition_axes(ctx, scene, &axes);
    if (rc == OXL_OK) rc = partition_visibility_create(ctx, scene, &out->plan->visibility);
    if (rc != OXL_OK) goto done;
    partition_set_frame(scene, &o, &axes, out);
    b.visibility = out->plan->visibility;
    if (!(o.kind == OXL_PARTITION_NONE || scene->stats.points <= (size_t)o.block_points))
        partition_log_frame(ctx, &o, out, axes.fraction);
    rc = partition_build(&b, out);
done:
    if (rc != OXL_OK) partition_free(ctx, out);
    return rc;
}

OXL_INTERNAL oxl_result partition_variant(oxl_context *ctx, const struct partition *of,
                                          const oxl_partition_options *options, struct partition *out)
{
    const struct partition_plan *from = of->plan;
    struct partition_build b = {.ctx = ctx,
                                .level = OXL_LOG_DEBUG,
                                .scene = from->scene,
                                .options = partition_resolve_options(from->scene, options),
                                .visibility = from->visibility};
    oxl_result rc;
    *out = *of;
    out->block = NULL;
    out->block_count = 0;
    out->plan = oxl_calloc(ctx, 1, sizeof *out->plan);
    rc = out->plan ? OXL_OK : OXL_ERR_MEMORY;
    if (rc != OXL_OK) goto done;
    *out->plan =
        (struct partition_plan){.scene = from->scene, .visibility = from->visibility, .finite = from->finite};
    rc = partition_build(&b, out);
done:
    if (rc != OXL_OK) partition_free(ctx, out);
    return rc;
}

OXL_INTERNAL void partition_free_plan(oxl_context *ctx, struct partition *p)
{
    if (!p->plan) return;
    if (p->plan->owns_visibility) partition_visibility_free(ctx, p->plan->visibility);
    OXL_FREE(ctx, p->plan->owner, p->plan->first_member, p->plan->member, p->plan->role, p->plan);
    p->plan = NULL;
}

OXL_INTERNAL void partition_free(oxl_context *ctx, struct partition *p)
{
    partition_free_plan(ctx, p);
    oxl_free(ctx, p->block);
    *p = (struct partition){0};
}
