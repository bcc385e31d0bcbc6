/* partition_assign.c - finds the boxes of the blocks, the points in them and in their margins, and the views
 * that each block is trained on (OceanXL Alg. 1; shares of BlockGaussian).
 *
 * Invariant: the boxes of the leaves tile space, also after cuts are undone.
 */
#include "partition_build.h"

enum {
    /* nodes on the stack of a walk; a tree has at most 32 + 4 levels (partition_depth) */
    PARTITION_DEPTH = 96,
    /* views; a block with fewer overfits, and takes more border views (docs/SCALE.md) */
    PARTITION_ENOUGH_VIEWS = 50
};
#define PARTITION_MARGIN 0.05 /* Enlarges the box on each side, in sizes of the box [BlockGaussian]. */

/* ---------------- boxes */

/* Lists the leaves below a node, the low side of each cut first. */
static oxl_result partition_list_leaves(struct partition_build *b, int node)
{
    const struct partition_node *n = &b->node[node];
    oxl_result rc = OXL_OK;
    if (n->child[0]) {
        rc = partition_list_leaves(b, n->child[0]);
        return rc == OXL_OK ? partition_list_leaves(b, n->child[1]) : rc;
    }
    rc = oxl_reserve(b->ctx, &b->leaf, &b->leaf_capacity, (size_t)b->leaf_count + 1, sizeof *b->leaf);
    if (rc != OXL_OK) return rc;
    b->node[node].block = b->leaf_count;
    b->leaf[b->leaf_count++] = node;
    return OXL_OK;
}

static void partition_expand(const struct partition_build *b, struct partition_node *n)
{
    for (int k = 0; k < 3; k++) {
        n->finite.low[k] = OXL_MAX(n->box.low[k], b->finite.low[k]);
        n->finite.high[k] = OXL_MIN(n->box.high[k], b->finite.high[k]);
        n->expanded.low[k] = n->box.low[k] - PARTITION_MARGIN * (n->finite.high[k] - n->finite.low[k]);
        n->expanded.high[k] = n->box.high[k] + PARTITION_MARGIN * (n->finite.high[k] - n->finite.low[k]);
    }
}

static void partition_hull(struct partition_box *hull, const struct partition_box *a,
                           const struct partition_box *b)
{
    for (int k = 0; k < 3; k++) {
        hull->low[k] = OXL_MIN(a->low[k], b->low[k]);
        hull->high[k] = OXL_MAX(a->high[k], b->high[k]);
    }
}

/* Sets the leaves' boxes from the cuts. A child follows its parent in the array, also after undone cuts, so
 * one pass down and one back suffice. */
static oxl_result partition_set_boxes(struct partition_build *b)
{
    for (int k = 0; k < 3; k++) {
        b->node[0].box.low[k] = -INFINITY;
        b->node[0].box.high[k] = INFINITY;
    }
    for (int i = 0; i < b->node_count; i++)
        for (int side = 0; side < 2 && b->node[i].child[0] && !b->node[i].removed; side++) {
            struct partition_box *box = &b->node[b->node[i].child[side]].box;
            *box = b->node[i].box;
            (side ? box->low : box->high)[b->node[i].axis] = b->node[i].cut;
        }
    for (int i = b->node_count - 1; i >= 0; i--) {
        struct partition_node *n = &b->node[i];
        if (n->child[0])
            partition_hull(&n->expanded, &b->node[n->child[0]].expanded, &b->node[n->child[1]].expanded);
        else partition_expand(b, n);
    }
    b->leaf_count = 0;
    return partition_list_leaves(b, 0);
}

/* ---------------- which points lie in a block and in its margin */

/* Lists the blocks whose expanded box contains p, ascending; out NULL: only counts them. */
static uint32_t partition_find_blocks(const struct partition_build *b, const double *p, uint32_t *out)
{
    int stack[PARTITION_DEPTH], height = 0;
    uint32_t count = 0;
    stack[height++] = 0;
    while (height > 0) {
        const struct partition_node *n = &b->node[stack[--height]];
        if (!partition_contains(&n->expanded, p)) continue;
        if (n->child[0]) {
            stack[height++] = n->child[1];
            stack[height++] = n->child[0];
        } else {
            if (out) out[count] = (uint32_t)n->block;
            count++;
        }
    }
    return count;
}

/* Cuts from `deep` what the margins of other blocks below `node` cover of it, each along the axis on
 * which it reaches in least. */
static void partition_shrink_interior(const struct partition_build *b, int node, int leaf,
                                      struct partition_box *deep)
{
    const struct partition_node *n = &b->node[node];
    double least = INFINITY, *face = NULL, at = 0;
    if (node == leaf) return;
    for (int k = 0; k < 3; k++) {
        const double from_low = n->expanded.high[k] - deep->low[k],
                     from_high = deep->high[k] - n->expanded.low[k];
        if (!(from_low > 0 && from_high > 0)) return;
        if (from_low < least) least = from_low, face = &deep->low[k], at = n->expanded.high[k];
        if (from_high < least) least = from_high, face = &deep->high[k], at = n->expanded.low[k];
    }
    if (n->child[0]) {
        partition_shrink_interior(b, n->child[0], leaf, deep);
        partition_shrink_interior(b, n->child[1], leaf, deep);
    } else if (face) {
        *face = at;
    }
}

/* Lists the blocks of point i like partition_find_blocks. A point deeper in its owner than any neighbour's
 * margin reaches, as most are, needs no search. */
static uint32_t partition_find_all_blocks(const struct partition_build *b, size_t i, uint32_t *out)
{
    const struct partition_node *owner = &b->node[b->owner[i]];
    if (!partition_contains(&owner->deep, b->position + 3 * i))
        return partition_find_blocks(b, b->position + 3 * i, out);
    if (out) *out = (uint32_t)owner->block;
    return 1;
}

/* Lists the blocks of all points: counts them, turns counts into offsets, and fills the lists. */
static oxl_result partition_find_members(struct partition_build *b)
{
    size_t total = 0;
    for (int i = 0; i < b->leaf_count; i++) {
        struct partition_node *n = &b->node[b->leaf[i]];
        n->deep = n->box;
        partition_shrink_interior(b, 0, b->leaf[i], &n->deep);
    }
    oxl_free(b->ctx, b->blocks);
    b->blocks = NULL;
#pragma omp parallel for schedule(static) num_threads(b->ctx->threads)
    for (int task = 0; task < PARTITION_TASKS; task++)
        for (size_t i = partition_task_begin(b->count, task); i < partition_task_begin(b->count, task + 1);
             i++)
            b->first[i] = b->owner[i] == PARTITION_NO_BLOCK ? 0 : partition_find_all_blocks(b, i, NULL);
    for (size_t i = 0; i < b->count; i++) {
        const uint32_t count = b->first[i];
        b->first[i] = (uint32_t)total;
        total += count;
    }
    if (total >= UINT32_MAX)
        return oxl_fail(b->ctx, OXL_ERR_INPUT,
                        "%zu points are too many to partition\nfix: filter points3D to fewer points",
                        b->count);
    b->first[b->count] = (uint32_t)total;
    b->blocks = oxl_alloc(b->ctx, total + 1, sizeof *b->blocks);
    if (!b->blocks) return OXL_ERR_MEMORY;
#pragma omp parallel for schedule(static) num_threads(b->ctx->threads)
    for (int task = 0; task < PARTITION_TASKS; task++)
        for (size_t i = partition_task_begin(b->count, task); i < partition_task_begin(b->count, task + 1);
             i++)
            if (b->owner[i] != PARTITION_NO_BLOCK) partition_find_all_blocks(b, i, b->blocks + b->first[i]);
    return OXL_OK;
}

static oxl_result partition_count_points(struct partition_build *b)
{
    oxl_free(b->ctx, b->inside);
    b->inside = oxl_calloc(b->ctx, (size_t)b->leaf_count, sizeof *b->inside);
    if (!b->inside) return OXL_ERR_MEMORY;
    for (int i = 0; i < b->leaf_count; i++) b->node[b->leaf[i]].points = 0;
    for (size_t i = 0; i < b->count; i++)
        if (b->owner[i] != PARTITION_NO_BLOCK) b->node[b->owner[i]].points++;
    for (uint32_t k = 0; k < b->first[b->count]; k++) b->inside[b->blocks[k]]++;
    return OXL_OK;
}

/* ---------------- which views a block is trained on */

/* Decides on a view of a block by the paper's two rules, exactly, in integers. all: different points that the
 * view sees; inside: points of the block; both: points of the block that the view sees. few_views: the block
 * has few views, and also takes views with more than a tenth of their points in it. */
static enum partition_role partition_role(size_t both, size_t all, size_t inside, int few_views)
{
    if (10 * both > 3 * all) return PARTITION_BASE;
    return 10 * both > inside || (few_views && 10 * both > all) ? PARTITION_BORDER : PARTITION_OUT;
}

/* Assigns a view to the blocks of its points. seen (blocks): scratch. */
static void partition_assign_view(const struct partition_build *b, size_t view, uint32_t *seen)
{
    const struct partition_visibility *vis = b->visibility;
    memset(seen, 0, (size_t)b->leaf_count * sizeof *seen);
    for (size_t k = vis->first[view]; k < vis->first[view + 1]; k++) {
        const uint32_t i = vis->point[k];
        if (k > vis->first[view] && i == vis->point[k - 1]) continue;
        for (uint32_t j = b->first[i]; j < b->first[i + 1]; j++) seen[b->blocks[j]]++;
    }
    for (int i = 0; i < b->leaf_count; i++)
        b->role[(size_t)i * vis->views + view] =
            (uint8_t)partition_role(seen[i], vis->seen[view], b->inside[i], b->few_views && b->few_views[i]);
}

static oxl_result partition_assign_views(struct partition_build *b)
{
    const size_t blocks = (size_t)b->leaf_count, views = b->visibility->views;
    uint32_t *seen = oxl_alloc(b->ctx, blocks * PARTITION_TASKS, sizeof *seen);
    oxl_free(b->ctx, b->role);
    b->role = oxl_calloc(b->ctx, blocks, views);
    if (!seen || !b->role) {
        oxl_free(b->ctx, seen);
        return OXL_ERR_MEMORY;
    }
#pragma omp parallel for schedule(dynamic) num_threads(b->ctx->threads)
    /* Strides, since views with neighbouring names observe the same points. */
    for (int task = 0; task < PARTITION_TASKS; task++)
        for (size_t v = (size_t)task; v < views; v += PARTITION_TASKS)
            partition_assign_view(b, v, seen + (size_t)task * blocks);
    oxl_free(b->ctx, seen);
    return OXL_OK;
}

static int partition_count_views(const struct partition_build *b, int block)
{
    int count = 0;
    for (size_t v = 0; v < b->visibility->views; v++)
        count += b->role[(size_t)block * b->visibility->views + v] != PARTITION_OUT;
    return count;
}

/* Assigns all views again, now that blocks with few views are known, and take more. */
static oxl_result partition_assign_more_views(struct partition_build *b)
{
    b->few_views = oxl_alloc(b->ctx, (size_t)b->leaf_count, sizeof *b->few_views);
    if (!b->few_views) return OXL_ERR_MEMORY;
    for (int i = 0; i < b->leaf_count; i++)
        b->few_views[i] = partition_count_views(b, i) < PARTITION_ENOUGH_VIEWS;
    return partition_assign_views(b);
}

/* ---------------- cuts that are undone */

/* Undoes the cut above `leaf`: its sibling replaces the parent, and the sibling's blocks
 * divide the leaf's region. */
static void partition_undo_split(struct partition_build *b, int leaf)
{
    const int parent = b->node[leaf].parent;
    struct partition_node *p = &b->node[parent];
    const int sibling = p->child[p->child[0] == leaf];
    const struct partition_node *other = &b->node[sibling];
    p->axis = other->axis;
    p->cut = other->cut;
    for (int side = 0; side < 2; side++) {
        p->child[side] = other->child[side];
        if (p->child[side]) b->node[p->child[side]].parent = parent;
    }
    b->node[leaf].removed = b->node[sibling].removed = 1;
}

/* Undoes cuts that made blocks of too few points or views; returns the number of blocks removed. */
static int partition_undo_small(struct partition_build *b)
{
    int taken = 0;
    for (int i = 0; i < b->leaf_count; i++) {
        const int leaf = b->leaf[i];
        const struct partition_node *n = &b->node[leaf];
        /* Skips a leaf that an undone cut has removed or cut anew. */
        if (n->removed || leaf == 0 || n->child[0]) continue;
        if (n->points >= b->min_points && partition_count_views(b, i) >= b->min_views) continue;
        partition_undo_split(b, leaf);
        taken++;
    }
    return taken;
}

/* Assigns points and views to the leaves, and undoes cuts that leave a block too small, until none is.
 * largest: points of the largest block. */
OXL_INTERNAL oxl_result partition_assign(struct partition_build *b, size_t *largest)
{
    oxl_result rc = OXL_OK;
    int taken = 1;
    b->undone = 0;
    *largest = 0;
    oxl_free(b->ctx, b->few_views);
    b->few_views = NULL;
    while (rc == OXL_OK && taken > 0) {
        partition_update_leaves(b);
        rc = partition_set_boxes(b);
        if (rc == OXL_OK) rc = partition_find_members(b);
        if (rc == OXL_OK) rc = partition_count_points(b);
        if (rc == OXL_OK) rc = partition_assign_views(b);
        taken = rc == OXL_OK ? partition_undo_small(b) : 0;
        b->undone += taken;
    }
    if (rc == OXL_OK) rc = partition_assign_more_views(b);
    for (int i = 0; i < b->leaf_count && rc == OXL_OK; i++)
        *largest = OXL_MAX(*largest, b->node[b->leaf[i]].points);
    return rc;
}

/* Makes one block of all points and every training view, whatever the view sees. */
OXL_INTERNAL oxl_result partition_assign_to_one(struct partition_build *b)
{
    oxl_result rc = partition_set_boxes(b);
    if (rc == OXL_OK) rc = partition_find_members(b);
    if (rc == OXL_OK) rc = partition_count_points(b);
    if (rc == OXL_OK) rc = partition_assign_views(b);
    for (size_t v = 0; v < b->visibility->views && rc == OXL_OK; v++)
        b->role[v] = oxl_scene_view(b->scene, (int)v)->is_test ? PARTITION_OUT : PARTITION_BASE;
    return rc;
}
