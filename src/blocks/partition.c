/* partition.c - split the survey into blocks (OceanXL sec. 3.1, Alg. 1).
 *
 *     a box of k blocks is split across its longest axis at the ratio r of 0.30, 0.32 ... 0.70 whose sides come nearest to
 *     k1/k and k2/k of its load, k1 + k2 = k; the survey has k = ceil(N / N_p) blocks, or the fewest above that of at most
 *     N_p points each. A view belongs to a block that holds more than 0.3 of the points it sees (base), or of whose points
 *     it sees more than 0.1 (border) [BlockGaussian]. A block starts from the points in its box, made 5 % wider on each side,
 *     and from all points that its views see.
 *
 * Deviations from Alg. 1, which halves by points while a box holds more than N_p: halving ends at a power of two of blocks, up to
 * twice as many as N_p requires; and points alone balance memory, not work. The load is half points, half training pixels: each view
 * distributes its pixels evenly over the points it sees. There are never more blocks than splits at the midpoint would give.
 *
 * The paper discards blocks of too few points or views, and leaves holes. Here a split that would make a block of too few points is
 * not made: the box that is searched shrinks to its fuller half instead. Where a block has too few views, the split that made it is
 * undone, and its sibling's blocks extend into its box: they remain boxes, however often they were split themselves.
 *
 * Invariant: every place, and so every point and every Gaussian, belongs to exactly one block.
 */
#include "partition.h"

enum {
    PARTITION_RATIOS       = 21,
    PARTITION_BATCH        = 4096, /* boxes whose cuts are searched in one pass over the points */
    PARTITION_SHRINKS      = 48,   /* of a box, at most: all points in one place would never end */
    PARTITION_DEPTH        = 96,   /* of the tree at most: 32 + 4 levels, see partition_depth */
    PARTITION_LOAD         = 256,  /* mean load of a point */
    PARTITION_LEAST_POINTS = 100,
    PARTITION_LEAST_VIEWS  = 20,
    PARTITION_ENOUGH_VIEWS = 50 /* fewer views overfit: such a block takes more border views (docs/SCALE.md) */
};
#define PARTITION_FLAT   0.3  /* l3 / l2 below it: 2D [OceanXL] */
#define PARTITION_MARGIN 0.05 /* of a box's size, on each side [BlockGaussian] */

OXL_INTERNAL void partition_to_frame(const struct partition *p, const double world[3], double out[3])
{
    for (int i = 0; i < 3; i++) {
        out[i] = 0;
        for (int k = 0; k < 3; k++) out[i] += p->rotation[3 * i + k] * (world[k] - p->origin[k]);
    }
}

OXL_INTERNAL int partition_contains(const struct partition_box *box, const double frame[3])
{
    int inside = 1;
    for (int i = 0; i < 3; i++) inside &= frame[i] >= box->low[i] && frame[i] < box->high[i];
    return inside;
}

/* ---------------------------------------------------------------- the tree of cuts */

struct partition_node {
    struct partition_box box;      /* owner */
    struct partition_box finite;   /* what is searched for a cut */
    struct partition_box expanded; /* of a leaf; of a node: around those of its leaves */
    struct partition_box deep;     /* of a leaf: the part of it that no other block expands into */
    int                  parent;
    int                  child[2]; /* below the cut, and from it on; 0: a leaf, for the root is nobody's child */
    int                  axis;     /* of the cut */
    double               cut;
    int                  depth, shrinks;
    int                  removed; /* its cut was taken back */
    int                  slot;    /* in the batch; -1 */
    int                  block;   /* of a leaf */
    size_t               points;  /* of a leaf, at owner */
    int                  parts;   /* blocks to be made of it; 0: while it holds more than N_p points, two */
};

struct partition_build {
    oxl_context           *ctx;
    oxl_log_level          level; /* of log messages */
    const oxl_scene       *scene;
    oxl_partition_options  options;
    int                    dimensions;
    struct partition_box   finite;   /* trimmed extents of the survey */
    double                *position; /* (count,3) in the frame */
    uint32_t              *load;     /* (count) share of the work, PARTITION_LOAD on average */
    uint32_t              *owner;    /* (count) node; at the end block */
    size_t                 count;    /* points of the COLMAP model */
    size_t                 kept;     /* of them in the scene */
    struct partition_node *node;
    int                    node_count, leaf_count, depth;
    size_t                 node_capacity;
    int                   *leaf; /* (leaf_count) nodes, from the lowest place to the highest */
    size_t                 leaf_capacity;
    size_t                 least_points;
    int                    least_views;

    struct partition_visibility *visibility;
    uint32_t                    *first; /* (count + 1) in `blocks`: the blocks in whose expanded box a point lies */
    uint32_t                    *blocks;
    size_t                      *inside;    /* (blocks) points in the expanded box */
    uint8_t                     *role;      /* (blocks, views) */
    uint8_t                     *few_views; /* (blocks) has few views; NULL: not yet known */
    int                          undone;    /* splits */
};

static size_t partition_task_begin(size_t count, int task)
{
    return count * (size_t)task / PARTITION_TASKS;
}

/* ---------------------------------------------------------------- where a box is cut */

struct partition_search { /* of one box of the batch */
    int    node, axis;
    double cut[PARTITION_RATIOS];
};

static double partition_ratio(const struct partition_build *b, int k)
{
    return b->options.cut == OXL_CUT_MIDPOINT ? 0.5 : (30 + 2 * k) / 100.0;
}

static int partition_ratios(const struct partition_build *b)
{
    return b->options.cut == OXL_CUT_MIDPOINT ? 1 : PARTITION_RATIOS;
}

static int partition_longest_axis(const struct partition_build *b, const struct partition_box *box)
{
    int longest = 0;
    for (int k = 1; k < b->dimensions; k++)
        if (box->high[k] - box->low[k] > box->high[longest] - box->low[longest]) longest = k;
    return longest;
}

static int partition_is_open(const struct partition_build *b, const struct partition_node *n)
{
    const int axis = partition_longest_axis(b, &n->finite);
    const int open = n->parts > 0 ? n->parts > 1 : n->points > (size_t)b->options.block_points;
    return open && !n->child[0] && !n->removed && n->depth < b->depth && n->shrinks < PARTITION_SHRINKS &&
           n->finite.low[axis] < n->finite.high[axis];
}

/* Fills the batch with boxes that are to be cut; returns how many. */
static int partition_gather(struct partition_build *b, struct partition_search *search)
{
    int count = 0;
    for (int i = 0; i < b->node_count; i++) {
        struct partition_node *n = &b->node[i];
        n->slot                  = -1;
        if (count == PARTITION_BATCH || !partition_is_open(b, n)) continue;
        n->slot       = count;
        search[count] = (struct partition_search){.node = i, .axis = partition_longest_axis(b, &n->finite)};
        for (int k = 0; k < partition_ratios(b); k++) {
            const double low = n->finite.low[search[count].axis], high = n->finite.high[search[count].axis];
            search[count].cut[k] = low + partition_ratio(b, k) * (high - low);
        }
        count++;
    }
    return count;
}

/* Points and their load between two candidate splits of a box: those at or above k of them are counted at k. */
struct partition_bin {
    uint64_t points, load;
};

/* bins (slots, PARTITION_RATIOS + 1) */
static void partition_count(const struct partition_build *b, const struct partition_search *search, int task,
                            struct partition_bin *bins)
{
    const int    ratios = partition_ratios(b);
    const size_t end    = partition_task_begin(b->count, task + 1);
    for (size_t i = partition_task_begin(b->count, task); i < end; i++) {
        const int slot = b->owner[i] == PARTITION_NOWHERE ? -1 : b->node[b->owner[i]].slot;
        if (slot >= 0) {
            const struct partition_search *s     = &search[slot];
            const double                   v     = b->position[3 * i + (size_t)s->axis];
            int                            above = 0;
            for (int k = 0; k < ratios; k++) above += v >= s->cut[k];
            bins[(size_t)slot * (PARTITION_RATIOS + 1) + (size_t)above].points++;
            bins[(size_t)slot * (PARTITION_RATIOS + 1) + (size_t)above].load += b->load[i];
        }
    }
}

struct partition_split {
    int    ratio;     /* -1: none leaves both sides enough points for a block */
    size_t points[2]; /* of the sides */
    int    parts[2];
    int    fits; /* both sides can be split further into blocks of at most N_p points */
    double off;  /* by how much the load of a side misses its share */
};

/* One ratio with so many parts on its low side. */
static struct partition_split partition_judge_split(const struct partition_build *b, const struct partition_node *n, int ratio,
                                                    const struct partition_bin *low, uint64_t load, int low_parts)
{
    const size_t           limit = (size_t)b->options.block_points;
    const int              parts = OXL_MAX(2, n->parts);
    struct partition_split s     = {ratio, {low->points, n->points - low->points}, {low_parts, parts - low_parts}, 0, 0};
    s.fits                       = s.points[0] <= (size_t)s.parts[0] * limit && s.points[1] <= (size_t)s.parts[1] * limit;
    s.off                        = fabs((double)low->load / (double)OXL_MAX(load, (uint64_t)1) - (double)low_parts / parts);
    if (OXL_MIN(s.points[0], s.points[1]) < b->least_points) s.ratio = -1;
    return s;
}

/* Whether a is the better split: it fits, then its load is nearer to the wanted shares, then its ratio nearer to 0.5. */
static int partition_is_better(const struct partition_build *b, const struct partition_split *a,
                               const struct partition_split *than)
{
    const int ratios = partition_ratios(b);
    if (a->ratio < 0 || than->ratio < 0) return a->ratio >= 0;
    if (a->fits != than->fits) return a->fits;
    if (a->off != than->off) return a->off < than->off;
    return abs(2 * a->ratio - ratios + 1) < abs(2 * than->ratio - ratios + 1);
}

/* bins (ratios + 1) as partition_count leaves them. */
static struct partition_split partition_choose(const struct partition_build *b, const struct partition_node *n,
                                               const struct partition_bin *bins)
{
    const int              ratios = partition_ratios(b), parts = OXL_MAX(2, n->parts);
    struct partition_bin   low  = {0, 0};
    struct partition_split best = {.ratio = -1};
    uint64_t               load = 0;
    for (int k = 0; k <= ratios; k++) load += bins[k].load;
    for (int k = 0; k < ratios; k++) {
        low.points += bins[k].points;
        low.load += bins[k].load;
        for (int low_parts = parts / 2; low_parts <= parts - parts / 2; low_parts++) {
            const struct partition_split s = partition_judge_split(b, n, k, &low, load, low_parts);
            if (partition_is_better(b, &s, &best)) best = s;
        }
    }
    return best;
}

static oxl_result partition_add_children(struct partition_build *b, int parent, int axis, double cut,
                                         const struct partition_split *split)
{
    oxl_result rc = oxl_reserve(b->ctx, (void **)&b->node, &b->node_capacity, (size_t)b->node_count + 2, sizeof *b->node);
    if (rc != OXL_OK) return rc;
    for (int side = 0; side < 2; side++) {
        const struct partition_node *from  = &b->node[parent];
        struct partition_node        child = {.finite = from->finite, .parent = parent, .depth = from->depth + 1, .slot = -1};
        child.points                       = split->points[side];
        child.parts                        = from->parts > 0 ? split->parts[side] : 0;
        (side ? child.finite.low : child.finite.high)[axis] = cut;
        b->node[parent].child[side]                         = b->node_count;
        b->node[b->node_count++]                            = child;
    }
    b->node[parent].axis = axis;
    b->node[parent].cut  = cut;
    return OXL_OK;
}

/* No cut of this box leaves enough on both sides: most points lie near one end, and the search goes on in that half. */
static void partition_shrink(const struct partition_build *b, const struct partition_search *s, const struct partition_bin *bins)
{
    struct partition_node *n     = &b->node[s->node];
    const int              half  = partition_ratios(b) / 2;
    size_t                 below = 0;
    for (int k = 0; k <= half; k++) below += bins[k].points;
    (2 * below >= n->points ? n->finite.high : n->finite.low)[s->axis] = s->cut[half];
    n->shrinks++;
}

/* bins (PARTITION_TASKS, count, PARTITION_RATIOS + 1): scratch. */
static oxl_result partition_cut_batch(struct partition_build *b, const struct partition_search *search, int count,
                                      struct partition_bin *bins)
{
    const size_t stride = PARTITION_RATIOS + 1, part = (size_t)count * stride;
    oxl_result   rc = OXL_OK;
    memset(bins, 0, PARTITION_TASKS * part * sizeof *bins);
#pragma omp parallel for schedule(dynamic) num_threads(b->ctx->threads)
    for (int task = 0; task < PARTITION_TASKS; task++) partition_count(b, search, task, bins + (size_t)task * part);
    for (int task = 1; task < PARTITION_TASKS; task++)
        for (size_t k = 0; k < part; k++) {
            bins[k].points += bins[(size_t)task * part + k].points;
            bins[k].load += bins[(size_t)task * part + k].load;
        }
    for (int i = 0; i < count && rc == OXL_OK; i++) {
        const struct partition_bin  *mine  = bins + (size_t)i * stride;
        const struct partition_split split = partition_choose(b, &b->node[search[i].node], mine);
        if (split.ratio < 0) partition_shrink(b, &search[i], mine);
        else rc = partition_add_children(b, search[i].node, search[i].axis, search[i].cut[split.ratio], &split);
    }
    return rc;
}

static uint32_t partition_descend(const struct partition_build *b, uint32_t from, const double *p)
{
    while (b->node[from].child[0]) from = (uint32_t)b->node[from].child[p[b->node[from].axis] >= b->node[from].cut];
    return from;
}

/* Points whose node was cut move into its children; those whose node is gone start again from the root. */
static void partition_update_leaves(const struct partition_build *b)
{
#pragma omp parallel for schedule(static) num_threads(b->ctx->threads)
    for (int task = 0; task < PARTITION_TASKS; task++) {
        const size_t end = partition_task_begin(b->count, task + 1);
        for (size_t i = partition_task_begin(b->count, task); i < end; i++)
            if (b->owner[i] != PARTITION_NOWHERE)
                b->owner[i] = partition_descend(b, b->node[b->owner[i]].removed ? 0 : b->owner[i], b->position + 3 * i);
    }
}

/* D of Alg. 1: four more levels than perfect halves would take. */
static int partition_depth(size_t count, size_t block_points)
{
    int halves = 0;
    while (halves < 32 && block_points << halves < count) halves++;
    return OXL_MAX(10, halves + 4);
}

static oxl_result partition_grow(struct partition_build *b)
{
    struct partition_search *search = oxl_alloc(b->ctx, PARTITION_BATCH, sizeof *search);
    struct partition_bin    *bins   = oxl_alloc(b->ctx, PARTITION_BATCH * (PARTITION_RATIOS + 1) * PARTITION_TASKS, sizeof *bins);
    oxl_result               rc = search && bins ? OXL_OK : oxl_fail(b->ctx, OXL_ERR_MEMORY, "no memory to search for splits");
    int                      count;
    while (rc == OXL_OK && (count = partition_gather(b, search)) > 0) {
        rc = partition_cut_batch(b, search, count, bins);
        partition_update_leaves(b);
    }
    oxl_free(b->ctx, search);
    oxl_free(b->ctx, bins);
    return rc;
}

/* A tree of so many leaves from the root on; parts 0: as many as leave none with more than N_p points. */
static oxl_result partition_grow_to(struct partition_build *b, int parts)
{
    b->node[0]    = (struct partition_node){.finite = b->finite, .points = b->kept, .parts = parts, .slot = -1};
    b->node_count = 1;
    for (size_t i = 0; i < b->count; i++)
        if (b->owner[i] != PARTITION_NOWHERE) b->owner[i] = 0;
    return partition_grow(b);
}

/* by_pixels: share of the load that is pixels, which each view distributes evenly over the points it sees; the rest is the point itself. */
static oxl_result partition_set_loads(struct partition_build *b, double by_pixels)
{
    const struct partition_visibility *s     = b->visibility;
    double                            *pixel = oxl_calloc(b->ctx, b->count + 1, sizeof *pixel), sum = 0;
    if (!b->load) b->load = oxl_alloc(b->ctx, b->count + 1, sizeof *b->load);
    if (!pixel || !b->load) {
        oxl_free(b->ctx, pixel);
        return oxl_fail(b->ctx, OXL_ERR_MEMORY, "no memory to partition %zu points", b->count);
    }
    for (size_t v = 0; v < s->views; v++) {
        const oxl_camera *c    = &oxl_scene_view(b->scene, (int)v)->camera;
        const size_t      seen = s->first[v + 1] - s->first[v];
        for (size_t k = s->first[v]; k < s->first[v + 1]; k++)
            if (b->owner[s->point[k]] != PARTITION_NOWHERE) pixel[s->point[k]] += (double)c->width * c->height / (double)seen;
    }
    for (size_t i = 0; i < b->count; i++) sum += pixel[i];
    for (size_t i = 0; i < b->count; i++) {
        const double share = sum > 0 ? pixel[i] * (double)b->kept / sum : 1;
        b->load[i]         = (uint32_t)OXL_MIN(PARTITION_LOAD * (1 - by_pixels + by_pixels * share), 1e9);
    }
    oxl_free(b->ctx, pixel);
    return OXL_OK;
}

/* ---------------------------------------------------------------- boxes */

/* Lists the leaves below a node in order. */
static oxl_result partition_list_leaves(struct partition_build *b, int node)
{
    const struct partition_node *n  = &b->node[node];
    oxl_result                   rc = OXL_OK;
    if (n->child[0]) {
        rc = partition_list_leaves(b, n->child[0]);
        return rc == OXL_OK ? partition_list_leaves(b, n->child[1]) : rc;
    }
    rc = oxl_reserve(b->ctx, (void **)&b->leaf, &b->leaf_capacity, (size_t)b->leaf_count + 1, sizeof *b->leaf);
    if (rc != OXL_OK) return rc;
    b->node[node].block      = b->leaf_count;
    b->leaf[b->leaf_count++] = node;
    return OXL_OK;
}

static void partition_expand(const struct partition_build *b, struct partition_node *n)
{
    for (int k = 0; k < 3; k++) {
        n->finite.low[k]    = OXL_MAX(n->box.low[k], b->finite.low[k]);
        n->finite.high[k]   = OXL_MIN(n->box.high[k], b->finite.high[k]);
        n->expanded.low[k]  = n->box.low[k] - PARTITION_MARGIN * (n->finite.high[k] - n->finite.low[k]);
        n->expanded.high[k] = n->box.high[k] + PARTITION_MARGIN * (n->finite.high[k] - n->finite.low[k]);
    }
}

static void partition_hull(struct partition_box *hull, const struct partition_box *a, const struct partition_box *b)
{
    for (int k = 0; k < 3; k++) {
        hull->low[k]  = OXL_MIN(a->low[k], b->low[k]);
        hull->high[k] = OXL_MAX(a->high[k], b->high[k]);
    }
}

/* Boxes of the leaves from the splits. A child follows its parent in the array, also after undone splits. */
static oxl_result partition_set_boxes(struct partition_build *b)
{
    for (int k = 0; k < 3; k++) {
        b->node[0].box.low[k]  = -INFINITY;
        b->node[0].box.high[k] = INFINITY;
    }
    for (int i = 0; i < b->node_count; i++)
        for (int side = 0; side < 2 && b->node[i].child[0] && !b->node[i].removed; side++) {
            struct partition_box *box                      = &b->node[b->node[i].child[side]].box;
            *box                                           = b->node[i].box;
            (side ? box->low : box->high)[b->node[i].axis] = b->node[i].cut;
        }
    for (int i = b->node_count - 1; i >= 0; i--) {
        struct partition_node *n = &b->node[i];
        if (n->child[0]) partition_hull(&n->expanded, &b->node[n->child[0]].expanded, &b->node[n->child[1]].expanded);
        else partition_expand(b, n);
    }
    b->leaf_count = 0;
    return partition_list_leaves(b, 0);
}

/* ---------------------------------------------------------------- which points lie in a block and in its margin */

/* The blocks in whose expanded box p lies, ascending; out NULL: counts alone. */
static uint32_t partition_find_blocks(const struct partition_build *b, const double *p, uint32_t *out)
{
    int      stack[PARTITION_DEPTH], height = 0;
    uint32_t count  = 0;
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

/* Cuts from `deep` what the margins of other blocks below `node` cover of it: along the axis on which each reaches in least. */
static void partition_carve(const struct partition_build *b, int node, int leaf, struct partition_box *deep)
{
    const struct partition_node *n     = &b->node[node];
    double                       least = INFINITY, *face = NULL, at = 0;
    if (node == leaf) return;
    for (int k = 0; k < 3; k++) {
        const double from_low = n->expanded.high[k] - deep->low[k], from_high = deep->high[k] - n->expanded.low[k];
        if (!(from_low > 0 && from_high > 0)) return;
        if (from_low < least) least = from_low, face = &deep->low[k], at = n->expanded.high[k];
        if (from_high < least) least = from_high, face = &deep->high[k], at = n->expanded.low[k];
    }
    if (n->child[0]) {
        partition_carve(b, n->child[0], leaf, deep);
        partition_carve(b, n->child[1], leaf, deep);
    } else if (face) {
        *face = at;
    }
}

/* Most points lie deeper in their owner than any neighbour's margin reaches. */
static uint32_t partition_find_all_blocks(const struct partition_build *b, size_t i, uint32_t *out)
{
    const struct partition_node *owner = &b->node[b->owner[i]];
    if (!partition_contains(&owner->deep, b->position + 3 * i)) return partition_find_blocks(b, b->position + 3 * i, out);
    if (out) *out = (uint32_t)owner->block;
    return 1;
}

static oxl_result partition_find_members(struct partition_build *b)
{
    size_t total = 0;
    for (int i = 0; i < b->leaf_count; i++) {
        struct partition_node *n = &b->node[b->leaf[i]];
        n->deep                  = n->box;
        partition_carve(b, 0, b->leaf[i], &n->deep);
    }
    oxl_free(b->ctx, b->blocks);
    b->blocks = NULL;
#pragma omp parallel for schedule(static) num_threads(b->ctx->threads)
    for (int task = 0; task < PARTITION_TASKS; task++)
        for (size_t i = partition_task_begin(b->count, task); i < partition_task_begin(b->count, task + 1); i++)
            b->first[i] = b->owner[i] == PARTITION_NOWHERE ? 0 : partition_find_all_blocks(b, i, NULL);
    for (size_t i = 0; i < b->count; i++) {
        const uint32_t count = b->first[i];
        b->first[i]          = (uint32_t)total;
        total += count;
    }
    if (total >= UINT32_MAX)
        return oxl_fail(b->ctx, OXL_ERR_INPUT, "%zu points are too many to partition\nfix: filter points3D to fewer points",
                        b->count);
    b->first[b->count] = (uint32_t)total;
    b->blocks          = oxl_alloc(b->ctx, total + 1, sizeof *b->blocks);
    if (!b->blocks) return oxl_fail(b->ctx, OXL_ERR_MEMORY, "no memory for the blocks of %zu points", b->count);
#pragma omp parallel for schedule(static) num_threads(b->ctx->threads)
    for (int task = 0; task < PARTITION_TASKS; task++)
        for (size_t i = partition_task_begin(b->count, task); i < partition_task_begin(b->count, task + 1); i++)
            if (b->owner[i] != PARTITION_NOWHERE) partition_find_all_blocks(b, i, b->blocks + b->first[i]);
    return OXL_OK;
}

static oxl_result partition_count_points(struct partition_build *b)
{
    oxl_free(b->ctx, b->inside);
    b->inside = oxl_calloc(b->ctx, (size_t)b->leaf_count, sizeof *b->inside);
    if (!b->inside) return oxl_fail(b->ctx, OXL_ERR_MEMORY, "no memory for %d blocks", b->leaf_count);
    for (int i = 0; i < b->leaf_count; i++) b->node[b->leaf[i]].points = 0;
    for (size_t i = 0; i < b->count; i++)
        if (b->owner[i] != PARTITION_NOWHERE) b->node[b->owner[i]].points++;
    for (uint32_t k = 0; k < b->first[b->count]; k++) b->inside[b->blocks[k]]++;
    return OXL_OK;
}

/* ---------------------------------------------------------------- which views a block is trained on */

/* Exact, in integers. all: different points that the view sees; inside: points of the block; both: of those the view sees. few_views: the
 * block has few views, and takes also those that see a tenth of what they see in it. */
static enum partition_role partition_role(size_t both, size_t all, size_t inside, int few_views)
{
    if (10 * both > 3 * all) return PARTITION_BASE;
    return 10 * both > inside || (few_views && 10 * both > all) ? PARTITION_BORDER : PARTITION_OUT;
}

/* seen (blocks): scratch. */
static void partition_assign_view(const struct partition_build *b, size_t view, uint32_t *seen)
{
    const struct partition_visibility *s = b->visibility;
    memset(seen, 0, (size_t)b->leaf_count * sizeof *seen);
    for (size_t k = s->first[view]; k < s->first[view + 1]; k++) {
        const uint32_t i = s->point[k];
        if (k > s->first[view] && i == s->point[k - 1]) continue;
        for (uint32_t j = b->first[i]; j < b->first[i + 1]; j++) seen[b->blocks[j]]++;
    }
    for (int i = 0; i < b->leaf_count; i++)
        b->role[(size_t)i * s->views + view] =
            (uint8_t)partition_role(seen[i], s->seen[view], b->inside[i], b->few_views && b->few_views[i]);
}

static oxl_result partition_assign_views(struct partition_build *b)
{
    const size_t blocks = (size_t)b->leaf_count, views = b->visibility->views;
    uint32_t    *seen = oxl_alloc(b->ctx, blocks * PARTITION_TASKS, sizeof *seen);
    oxl_free(b->ctx, b->role);
    b->role = oxl_calloc(b->ctx, blocks, views);
    if (!seen || !b->role) {
        oxl_free(b->ctx, seen);
        return oxl_fail(b->ctx, OXL_ERR_MEMORY, "no memory for %zu views of %zu blocks", views, blocks);
    }
#pragma omp parallel for schedule(dynamic) num_threads(b->ctx->threads)
    for (int task = 0; task < PARTITION_TASKS; task++) /* strided: neighbours in name see alike */
        for (size_t v = (size_t)task; v < views; v += PARTITION_TASKS) partition_assign_view(b, v, seen + (size_t)task * blocks);
    oxl_free(b->ctx, seen);
    return OXL_OK;
}

static int partition_count_views(const struct partition_build *b, int block)
{
    int count = 0;
    for (size_t v = 0; v < b->visibility->views; v++) count += b->role[(size_t)block * b->visibility->views + v] != PARTITION_OUT;
    return count;
}

/* Once it is settled which blocks there are. */
static oxl_result partition_call_for_views(struct partition_build *b)
{
    b->few_views = oxl_alloc(b->ctx, (size_t)b->leaf_count, sizeof *b->few_views);
    if (!b->few_views) return oxl_fail(b->ctx, OXL_ERR_MEMORY, "no memory for %d blocks", b->leaf_count);
    for (int i = 0; i < b->leaf_count; i++) b->few_views[i] = partition_count_views(b, i) < PARTITION_ENOUGH_VIEWS;
    return partition_assign_views(b);
}

/* ---------------------------------------------------------------- guards */

/* The leaf's place is divided among the blocks of its sibling, which moves up into the parent. */
static void partition_take_back(struct partition_build *b, int leaf)
{
    const int                    parent  = b->node[leaf].parent;
    struct partition_node       *p       = &b->node[parent];
    const int                    sibling = p->child[p->child[0] == leaf];
    const struct partition_node *s       = &b->node[sibling];
    p->axis                              = s->axis;
    p->cut                               = s->cut;
    for (int side = 0; side < 2; side++) {
        p->child[side] = s->child[side];
        if (p->child[side]) b->node[p->child[side]].parent = parent;
    }
    b->node[leaf].removed = b->node[sibling].removed = 1;
}

/* Returns the number of blocks removed for too few views. */
static int partition_guard(struct partition_build *b)
{
    int taken = 0;
    for (int i = 0; i < b->leaf_count; i++) {
        const int                    leaf = b->leaf[i];
        const struct partition_node *n    = &b->node[leaf];
        if (n->removed || leaf == 0 || n->child[0]) continue; /* went with its sibling */
        if (n->points >= b->least_points && partition_count_views(b, i) >= b->least_views) continue;
        partition_take_back(b, leaf);
        taken++;
    }
    return taken;
}

/* Points and views to the leaves; those too few_views are undone. largest: points of the largest block. */
static oxl_result partition_assign(struct partition_build *b, size_t *largest)
{
    oxl_result rc    = OXL_OK;
    int        taken = 1;
    b->undone        = 0;
    *largest         = 0;
    oxl_free(b->ctx, b->few_views);
    b->few_views = NULL;
    while (rc == OXL_OK && taken > 0) {
        partition_update_leaves(b);
        rc = partition_set_boxes(b);
        if (rc == OXL_OK) rc = partition_find_members(b);
        if (rc == OXL_OK) rc = partition_count_points(b);
        if (rc == OXL_OK) rc = partition_assign_views(b);
        taken = rc == OXL_OK ? partition_guard(b) : 0;
        b->undone += taken;
    }
    if (rc == OXL_OK) rc = partition_call_for_views(b);
    for (int i = 0; i < b->leaf_count && rc == OXL_OK; i++) *largest = OXL_MAX(*largest, b->node[b->leaf[i]].points);
    return rc;
}

/* So many blocks, before those too few_views are undone; parts 0: as many as leave none with more than N_p points. */
static oxl_result partition_try(struct partition_build *b, oxl_cut cut, int parts, size_t *largest)
{
    oxl_result rc;
    b->options.cut = cut;
    rc             = partition_grow_to(b, parts);
    return rc == OXL_OK ? partition_assign(b, largest) : rc;
}

/* The fewest blocks of at most N_p points, but never more than splits at the midpoint give. Where guards undo what balances the load,
 * points alone are balanced, as in the paper. */
static oxl_result partition_balance(struct partition_build *b)
{
    const size_t limit  = (size_t)b->options.block_points;
    const int    fewest = (int)OXL_MIN((b->kept + limit - 1) / limit, (size_t)INT_MAX / 2);
    size_t       largest;
    oxl_result   rc   = partition_try(b, OXL_CUT_MIDPOINT, 0, &largest);
    const int    most = b->leaf_count;
    for (int parts = fewest; rc == OXL_OK && parts <= most; parts += OXL_MAX(1, parts / 16))
        for (int by_load = 1; by_load >= 0 && rc == OXL_OK; by_load--) {
            rc = partition_set_loads(b, 0.5 * by_load);
            if (rc == OXL_OK) rc = partition_try(b, OXL_CUT_BALANCED, parts, &largest);
            if (rc == OXL_OK && largest <= limit) return rc;
        }
    if (rc == OXL_OK) rc = partition_try(b, OXL_CUT_BALANCED, 0, &largest);
    return rc == OXL_OK && b->leaf_count > most ? partition_try(b, OXL_CUT_MIDPOINT, 0, &largest) : rc;
}

/* ---------------------------------------------------------------- the plan */

/* By block: the points in its expanded box, ascending. */
static oxl_result partition_list_members(const struct partition_build *b, struct partition_plan *plan)
{
    const size_t blocks = (size_t)b->leaf_count, total = b->first[b->count];
    plan->first_member = oxl_calloc(b->ctx, blocks + 1, sizeof *plan->first_member);
    plan->member       = oxl_alloc(b->ctx, total + 1, sizeof *plan->member);
    if (!plan->first_member || !plan->member) return oxl_fail(b->ctx, OXL_ERR_MEMORY, "no memory for the blocks' points");
    for (size_t i = 0; i < blocks; i++) plan->first_member[i + 1] = plan->first_member[i] + b->inside[i];
    for (size_t i = 0; i < b->count; i++)
        for (uint32_t k = b->first[i]; k < b->first[i + 1]; k++) plan->member[plan->first_member[b->blocks[k]]++] = (uint32_t)i;
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
    const struct partition_plan       *plan  = p->plan;
    const struct partition_visibility *s     = plan->visibility;
    size_t                             count = 0;
    for (size_t k = plan->first_member[block]; k < plan->first_member[block + 1]; k++)
        count += partition_mark_one(bits, plan->member[k]);
    for (size_t v = 0; v < s->views; v++) {
        if (plan->role[(size_t)block * s->views + v] == PARTITION_OUT) continue;
        for (size_t k = s->first[v]; k < s->first[v + 1]; k++) count += partition_mark_one(bits, s->point[k]);
    }
    return count;
}

static oxl_result partition_count_starts(oxl_context *ctx, struct partition *p, size_t points)
{
    const size_t words = (points + 63) / 64;
    uint64_t    *bits  = oxl_alloc(ctx, PARTITION_TASKS * words + 1, sizeof *bits);
    if (!bits) return oxl_fail(ctx, OXL_ERR_MEMORY, "no memory to count the points that blocks start from");
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
        p->block[i]                    = (struct partition_block){n->box, n->expanded, n->finite, n->points, 0, 0, 0};
        for (size_t v = 0; v < b->visibility->views; v++) {
            const uint8_t role = p->plan->role[(size_t)i * b->visibility->views + v];
            p->block[i].base_views += role == PARTITION_BASE;
            p->block[i].border_views += role == PARTITION_BORDER;
        }
    }
}

/* Moves the result to p. */
static oxl_result partition_finish(struct partition_build *b, struct partition *p)
{
    oxl_result rc = partition_list_members(b, p->plan);
    p->block      = oxl_calloc(b->ctx, (size_t)b->leaf_count, sizeof *p->block);
    if (rc == OXL_OK && !p->block) rc = oxl_fail(b->ctx, OXL_ERR_MEMORY, "no memory for %d blocks", b->leaf_count);
    if (rc != OXL_OK) return rc;
    p->block_count = b->leaf_count;
    for (size_t i = 0; i < b->count; i++)
        if (b->owner[i] != PARTITION_NOWHERE) b->owner[i] = (uint32_t)b->node[b->owner[i]].block;
    p->plan->owner = b->owner;
    p->plan->role  = b->role;
    b->owner       = NULL;
    b->role        = NULL;
    partition_fill_blocks(b, p);
    return partition_count_starts(b->ctx, p, b->count);
}

/* ---------------------------------------------------------------- beginning */

static int partition_train_views(const oxl_scene *scene)
{
    return scene_stats_of(scene)->views - scene_stats_of(scene)->test_views;
}

/* Less is asked of a small survey: a quarter of a small block's points; one image in ten, and no more than the block's share of all
 * images, or small blocks, asked for on purpose, would all be joined. */
static void partition_set_guards(struct partition_build *b)
{
    const size_t n     = (size_t)b->options.block_points;
    const int    views = partition_train_views(b->scene);
    const double share = views * (double)n / (double)OXL_MAX(b->kept, (size_t)1);
    b->least_points    = OXL_MAX(n / 20, OXL_MIN((size_t)PARTITION_LEAST_POINTS, n / 4));
    b->least_points    = OXL_MAX(b->least_points, (size_t)1);
    b->least_views     = OXL_CLAMP(views / 10, 1, PARTITION_LEAST_VIEWS);
    if (share < b->least_views) b->least_views = OXL_MAX(1, (int)share);
}

static oxl_result partition_load_points(struct partition_build *b, const struct partition *p)
{
    const struct colmap *c = scene_colmap(b->scene);
    b->count               = c->point_count;
    b->position            = oxl_alloc(b->ctx, b->count + 1, 3 * sizeof *b->position);
    b->owner               = oxl_alloc(b->ctx, b->count + 1, sizeof *b->owner);
    b->first               = oxl_alloc(b->ctx, b->count + 1, sizeof *b->first);
    if (!b->position || !b->owner || !b->first)
        return oxl_fail(b->ctx, OXL_ERR_MEMORY, "no memory to partition %zu points", b->count);
#pragma omp parallel for schedule(static) num_threads(b->ctx->threads)
    for (int task = 0; task < PARTITION_TASKS; task++)
        for (size_t i = partition_task_begin(b->count, task); i < partition_task_begin(b->count, task + 1); i++) {
            b->owner[i] = scene_takes_point(&c->point[i], p->origin) ? 0 : PARTITION_NOWHERE;
            partition_to_frame(p, c->point[i].position, b->position + 3 * i);
        }
    for (size_t i = 0; i < b->count; i++) b->kept += b->owner[i] != PARTITION_NOWHERE;
    return OXL_OK;
}

static void partition_log_frame(oxl_context *ctx, const oxl_partition_options *o, const struct partition *p, double share)
{
    const double ratio = p->extent[1] > 0 ? p->extent[2] / p->extent[1] : 0;
    oxl_log(ctx, OXL_LOG_INFO,
            "principal extents %.4g x %.4g x %.4g (1st to 99th percentile; %.1f %% of the points kept by the trim)", p->extent[0],
            p->extent[1], p->extent[2], 100 * share);
    if (o->kind == OXL_PARTITION_2D || o->kind == OXL_PARTITION_3D)
        oxl_log(ctx, OXL_LOG_INFO, "partition in %dD, as set (l3/l2 = %.3f speaks for %dD)", p->dimensions, ratio,
                ratio < PARTITION_FLAT ? 2 : 3);
    else
        oxl_log(ctx, OXL_LOG_INFO, "partition in %dD: l3/l2 = %.3f is %s %.1f", p->dimensions, ratio,
                ratio < PARTITION_FLAT ? "less than" : "not less than", PARTITION_FLAT);
}

static void partition_set_frame(const oxl_scene *scene, const oxl_partition_options *o, const struct partition_axes *axes,
                                struct partition *p)
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

/* Why the survey stays whole; NULL when it is cut. */
static const char *partition_reason_for_one(const struct partition_build *b)
{
    if (b->options.kind == OXL_PARTITION_NONE) return "as set";
    if (b->kept <= (size_t)b->options.block_points) return "they are not more than a block may hold";
    if (b->visibility->first[b->visibility->views] == 0) return "the points have no tracks, which tell what a view sees";
    return NULL;
}

/* All of it, and every training view, whatever it sees. */
static oxl_result partition_make_one(struct partition_build *b, const char *reason)
{
    oxl_result rc;
    oxl_log(b->ctx, b->level, "%zu points stay one block: %s", b->kept, reason);
    rc = partition_set_boxes(b);
    if (rc == OXL_OK) rc = partition_find_members(b);
    if (rc == OXL_OK) rc = partition_count_points(b);
    if (rc == OXL_OK) rc = partition_assign_views(b);
    for (size_t v = 0; v < b->visibility->views && rc == OXL_OK; v++)
        b->role[v] = oxl_scene_view(b->scene, (int)v)->is_test ? PARTITION_OUT : PARTITION_BASE;
    return rc;
}

static void partition_log_blocks(const struct partition_build *b, const struct partition *p)
{
    size_t least = SIZE_MAX, most = 0, idle = 0, views = b->visibility->views;
    for (int i = 0; i < p->block_count; i++) {
        least = OXL_MIN(least, p->block[i].points);
        most  = OXL_MAX(most, p->block[i].points);
    }
    for (size_t v = 0; v < views; v++) {
        int used = oxl_scene_view(b->scene, (int)v)->is_test;
        for (int i = 0; i < p->block_count && !used; i++) used = p->plan->role[(size_t)i * views + v] != PARTITION_OUT;
        idle += !used;
    }
    if (b->undone > 0)
        oxl_log(b->ctx, b->level, "%d split%s undone: less than %zu points or %d views on a side", b->undone,
                b->undone == 1 ? "" : "s", b->least_points, b->least_views);
    oxl_log(b->ctx, b->level, "%d block%s of %zu to %zu points", p->block_count, p->block_count == 1 ? "" : "s", least, most);
    if (p->block_count > 1 && most > (size_t)b->options.block_points)
        oxl_log(
            b->ctx, b->level == OXL_LOG_INFO ? OXL_LOG_WARNING : b->level,
            "the largest block holds %zu points, more than --block-points %d: no cut would leave both its sides enough points and views",
            most, b->options.block_points);
    if (idle > 0) oxl_log(b->ctx, b->level, "%zu training views see too little of every block, and take no part", idle);
}

static oxl_result partition_build(struct partition_build *b, struct partition *p)
{
    const char *reason;
    size_t      largest;
    oxl_result  rc = partition_load_points(b, p);
    if (rc == OXL_OK) rc = oxl_reserve(b->ctx, (void **)&b->node, &b->node_capacity, 1, sizeof *b->node);
    if (rc != OXL_OK) goto done;
    partition_set_guards(b);
    b->finite     = p->plan->finite;
    b->dimensions = p->dimensions;
    b->depth      = partition_depth(b->kept, (size_t)b->options.block_points);
    b->node[0]    = (struct partition_node){.finite = b->finite, .points = b->kept, .slot = -1};
    b->node_count = 1;
    reason        = partition_reason_for_one(b);
    rc            = partition_set_loads(b, 0);
    if (rc != OXL_OK) goto done;
    if (reason) rc = partition_make_one(b, reason);
    else rc = b->options.cut == OXL_CUT_MIDPOINT ? partition_try(b, OXL_CUT_MIDPOINT, 0, &largest) : partition_balance(b);
    if (rc == OXL_OK) rc = partition_finish(b, p);
    if (rc == OXL_OK && !reason) partition_log_blocks(b, p);
done:
    oxl_free(b->ctx, b->position);
    oxl_free(b->ctx, b->owner);
    oxl_free(b->ctx, b->load);
    oxl_free(b->ctx, b->node);
    oxl_free(b->ctx, b->leaf);
    oxl_free(b->ctx, b->first);
    oxl_free(b->ctx, b->blocks);
    oxl_free(b->ctx, b->inside);
    oxl_free(b->ctx, b->role);
    oxl_free(b->ctx, b->few_views);
    return rc;
}

/* ---------------------------------------------------------------- doors */

static oxl_result partition_check(oxl_context *ctx, const oxl_scene *scene, const oxl_partition_options *o)
{
    const struct scene_stats *stats  = scene_stats_of(scene);
    const size_t              points = stats->points, views = (size_t)(stats->views - stats->test_views);
    if (!scene_colmap(scene))
        return oxl_fail(ctx, OXL_ERR_USAGE,
                        "a scene from arrays has no tracks, which a partition is made of\n"
                        "fix: load the scene from a COLMAP model");
    if (o->kind != OXL_PARTITION_NONE && views > 0 && points / (size_t)o->block_points > views)
        return oxl_fail(ctx, OXL_ERR_USAGE,
                        "blocks of %d points: %zu points make at least %zu blocks, more than the %zu training views\n"
                        "fix: --block-points 40000, or at least %zu",
                        o->block_points, points, points / (size_t)o->block_points, views, points / views + 1);
    return OXL_OK;
}

/* A number of blocks, or no limit, as the most points of one. */
static oxl_partition_options partition_resolve(const oxl_scene *scene, const oxl_partition_options *options)
{
    oxl_partition_options o = options ? *options : oxl_partition_options_default();
    if (o.blocks > 0) o.block_points = (int)OXL_MAX(1, (scene_stats_of(scene)->points + (size_t)o.blocks - 1) / (size_t)o.blocks);
    if (o.block_points < 1) o.block_points = INT_MAX;
    return o;
}

OXL_INTERNAL oxl_result partition_make(oxl_context *ctx, const oxl_scene *scene, const oxl_partition_options *options,
                                       struct partition *out)
{
    const oxl_partition_options o = partition_resolve(scene, options);
    struct partition_build      b = {.ctx = ctx, .level = OXL_LOG_INFO, .scene = scene, .options = o};
    struct partition_axes       axes;
    oxl_result                  rc = partition_check(ctx, scene, &o);
    *out                           = (struct partition){.dimensions = 3};
    if (rc != OXL_OK) return rc;
    out->plan = oxl_calloc(ctx, 1, sizeof *out->plan);
    if (!out->plan) return oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for a partition");
    *out->plan = (struct partition_plan){.scene = scene, .owns_visibility = 1};
    rc         = partition_axes(ctx, scene, &axes);
    if (rc == OXL_OK) rc = partition_visibility_create(ctx, scene, &out->plan->visibility);
    if (rc != OXL_OK) goto done;
    partition_set_frame(scene, &o, &axes, out);
    b.visibility = out->plan->visibility;
    if (!(o.kind == OXL_PARTITION_NONE || scene_stats_of(scene)->points <= (size_t)o.block_points))
        partition_log_frame(ctx, &o, out, axes.share);
    rc = partition_build(&b, out);
done:
    if (rc != OXL_OK) partition_free(ctx, out);
    return rc;
}

OXL_INTERNAL oxl_result partition_again(oxl_context *ctx, const struct partition *of, const oxl_partition_options *options,
                                        struct partition *out)
{
    const struct partition_plan *from = of->plan;
    struct partition_build       b    = {.ctx        = ctx,
                                         .level      = OXL_LOG_DEBUG,
                                         .scene      = from->scene,
                                         .options    = partition_resolve(from->scene, options),
                                         .visibility = from->visibility};
    oxl_result                   rc;
    *out             = *of;
    out->block       = NULL;
    out->block_count = 0;
    out->plan        = oxl_calloc(ctx, 1, sizeof *out->plan);
    rc               = out->plan ? OXL_OK : oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for a partition");
    if (rc != OXL_OK) goto done;
    *out->plan = (struct partition_plan){.scene = from->scene, .visibility = from->visibility, .finite = from->finite};
    rc         = partition_build(&b, out);
done:
    if (rc != OXL_OK) partition_free(ctx, out);
    return rc;
}

OXL_INTERNAL void partition_drop_plan(oxl_context *ctx, struct partition *p)
{
    if (!p->plan) return;
    if (p->plan->owns_visibility) partition_visibility_free(ctx, p->plan->visibility);
    oxl_free(ctx, p->plan->owner);
    oxl_free(ctx, p->plan->first_member);
    oxl_free(ctx, p->plan->member);
    oxl_free(ctx, p->plan->role);
    oxl_free(ctx, p->plan);
    p->plan = NULL;
}

OXL_INTERNAL void partition_free(oxl_context *ctx, struct partition *p)
{
    partition_drop_plan(ctx, p);
    oxl_free(ctx, p->block);
    *p = (struct partition){0};
}
