/* partition_cut.c - cuts the boxes of a partition, each at the ratio whose sides come nearest to their
 * fraction of the load (OceanXL sec. 3.1, eq. 1, Alg. 1).
 *
 * Invariant: counts are whole numbers, summed over tasks in order, so the cuts do not depend on the number of
 * threads.
 */
#include "partition_build.h"

enum {
    PARTITION_LOWEST = 30,  /* first ratio, in hundredths */
    PARTITION_STEP = 2,     /* distance between two ratios, in hundredths */
    PARTITION_BATCH = 4096, /* boxes that are searched in one pass over the points */
    PARTITION_SHRINKS = 48, /* most shrinks of a box: with all points in one place they would never end */
    PARTITION_LOAD = 256,   /* mean load of a point */
    PARTITION_DEPTH_MIN = 10,
    PARTITION_SPARE_LEVELS = 4 /* levels for uneven cuts */
};
#define PARTITION_LOAD_MAX 1e9 /* Limits the load of a point, so that it fits 32 bits. */

OXL_INTERNAL size_t partition_task_begin(size_t count, int task)
{
    return count * (size_t)task / PARTITION_TASKS;
}

/* ---------------- the search */

struct partition_search { /* Holds the search of one box of the batch. */
    int node, axis;
    double cut[PARTITION_RATIOS];
};

static double partition_ratio(const struct partition_build *b, int k)
{
    return b->options.cut == OXL_CUT_MIDPOINT ? 0.5 : (PARTITION_LOWEST + PARTITION_STEP * k) / 100.0;
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
    const int open = n->leaves > 0 ? n->leaves > 1 : n->points > (size_t)b->options.block_points;
    return open && !n->child[0] && !n->removed && n->depth < b->depth && n->shrinks < PARTITION_SHRINKS &&
           n->finite.low[axis] < n->finite.high[axis];
}

/* Fills the batch with boxes to cut and returns their number. */
static int partition_gather(struct partition_build *b, struct partition_search *search)
{
    int count = 0;
    for (int i = 0; i < b->node_count; i++) {
        struct partition_node *n = &b->node[i];
        n->in_batch = -1;
        if (count == PARTITION_BATCH || !partition_is_open(b, n)) continue;
        n->in_batch = count;
        search[count] = (struct partition_search){.node = i, .axis = partition_longest_axis(b, &n->finite)};
        for (int k = 0; k < partition_ratios(b); k++) {
            const double low = n->finite.low[search[count].axis], high = n->finite.high[search[count].axis];
            search[count].cut[k] = low + partition_ratio(b, k) * (high - low);
        }
        count++;
    }
    return count;
}

/* Sums points and load between the places of possible cuts. bins: (slots, PARTITION_RATIOS + 1). */
static void partition_count(const struct partition_build *b, const struct partition_search *search, int task,
                            struct partition_bin *bins)
{
    const int ratios = partition_ratios(b);
    const size_t end = partition_task_begin(b->count, task + 1);
    for (size_t i = partition_task_begin(b->count, task); i < end; i++) {
        const int slot = b->owner[i] == PARTITION_NO_BLOCK ? -1 : b->node[b->owner[i]].in_batch;
        if (slot >= 0) {
            const struct partition_search *s = &search[slot];
            const double v = b->position[3 * i + (size_t)s->axis];
            int above = 0;
            for (int k = 0; k < ratios; k++) above += v >= s->cut[k];
            bins[(size_t)slot * (PARTITION_RATIOS + 1) + (size_t)above].points++;
            bins[(size_t)slot * (PARTITION_RATIOS + 1) + (size_t)above].load += b->load[i];
        }
    }
}

/* ---------------- the choice */

/* Rates the ratio with low_leaves leaves on its low side. */
static struct partition_candidate partition_rate(const struct partition_build *b,
                                                 const struct partition_node *n, int ratio,
                                                 const struct partition_bin *low, uint64_t load,
                                                 int low_leaves)
{
    const size_t limit = (size_t)b->options.block_points;
    const int leaves = OXL_MAX(2, n->leaves);
    struct partition_candidate s = {
        ratio, {low->points, n->points - low->points}, {low_leaves, leaves - low_leaves}, 0, 0};
    s.fits = s.points[0] <= (size_t)s.leaves[0] * limit && s.points[1] <= (size_t)s.leaves[1] * limit;
    s.off = fabs((double)low->load / (double)OXL_MAX(load, (uint64_t)1) - (double)low_leaves / leaves);
    if (OXL_MIN(s.points[0], s.points[1]) < b->min_points) s.ratio = -1;
    return s;
}

/* Returns 1 if `a` is the better cut: one that fits, then one whose load is nearer to the wanted fractions,
 * then one whose ratio is nearer to 0.5. */
static int partition_is_better(const struct partition_build *b, const struct partition_candidate *a,
                               const struct partition_candidate *than)
{
    const int ratios = partition_ratios(b);
    if (a->ratio < 0 || than->ratio < 0) return a->ratio >= 0;
    if (a->fits != than->fits) return a->fits;
    if (a->off != than->off) return a->off < than->off;
    return abs(2 * a->ratio - ratios + 1) < abs(2 * than->ratio - ratios + 1);
}

/* Chooses the best cut of a box; ratio -1: no cut is allowed. bins: (ratios + 1) from partition_count. */
OXL_INTERNAL struct partition_candidate partition_choose(const struct partition_build *b,
                                                         const struct partition_node *n,
                                                         const struct partition_bin *bins)
{
    const int ratios = partition_ratios(b), leaves = OXL_MAX(2, n->leaves);
    struct partition_bin low = {0, 0};
    struct partition_candidate best = {.ratio = -1};
    uint64_t load = 0;
    for (int k = 0; k <= ratios; k++) load += bins[k].load;
    for (int k = 0; k < ratios; k++) {
        low.points += bins[k].points;
        low.load += bins[k].load;
        for (int low_leaves = leaves / 2; low_leaves <= leaves - leaves / 2; low_leaves++) {
            const struct partition_candidate s = partition_rate(b, n, k, &low, load, low_leaves);
            if (partition_is_better(b, &s, &best)) best = s;
        }
    }
    return best;
}

static oxl_result partition_add_children(struct partition_build *b, int parent, int axis, double cut,
                                         const struct partition_candidate *chosen)
{
    oxl_result rc =
        oxl_reserve(b->ctx, &b->node, &b->node_capacity, (size_t)b->node_count + 2, sizeof *b->node);
    if (rc != OXL_OK) return rc;
    for (int side = 0; side < 2; side++) {
        const struct partition_node *from = &b->node[parent];
        struct partition_node child = {
            .finite = from->finite, .parent = parent, .depth = from->depth + 1, .in_batch = -1};
        child.points = chosen->points[side];
        child.leaves = from->leaves > 0 ? chosen->leaves[side] : 0;
        (side ? child.finite.low : child.finite.high)[axis] = cut;
        b->node[parent].child[side] = b->node_count;
        b->node[b->node_count++] = child;
    }
    b->node[parent].axis = axis;
    b->node[parent].cut = cut;
    return OXL_OK;
}

/* Shrinks a box that no cut leaves enough points on both sides of: most points lie near one end, and the
 * search goes on in that half. */
static void partition_shrink(const struct partition_build *b, const struct partition_search *s,
                             const struct partition_bin *bins)
{
    struct partition_node *n = &b->node[s->node];
    const int half = partition_ratios(b) / 2;
    size_t below = 0;
    for (int k = 0; k <= half; k++) below += bins[k].points;
    (2 * below >= n->points ? n->finite.high : n->finite.low)[s->axis] = s->cut[half];
    n->shrinks++;
}

/* Cuts each box of the batch in two: counts points and load between its candidate cuts, and takes the best
 * cut (partition_choose); shrinks a box without an allowed cut. bins: (PARTITION_TASKS, count,
 * PARTITION_RATIOS + 1) scratch. */
static oxl_result partition_cut_batch(struct partition_build *b, const struct partition_search *search,
                                      int count, struct partition_bin *bins)
{
    const size_t stride = PARTITION_RATIOS + 1, part = (size_t)count * stride;
    oxl_result rc = OXL_OK;
    memset(bins, 0, PARTITION_TASKS * part * sizeof *bins);
#pragma omp parallel for schedule(dynamic) num_threads(b->ctx->threads)
    for (int task = 0; task < PARTITION_TASKS; task++)
        partition_count(b, search, task, bins + (size_t)task * part);
    for (int task = 1; task < PARTITION_TASKS; task++)
        for (size_t k = 0; k < part; k++) {
            bins[k].points += bins[(size_t)task * part + k].points;
            bins[k].load += bins[(size_t)task * part + k].load;
        }
    for (int i = 0; i < count && rc == OXL_OK; i++) {
        const struct partition_bin *its = bins + (size_t)i * stride;
        const struct partition_candidate chosen = partition_choose(b, &b->node[search[i].node], its);
        if (chosen.ratio < 0) partition_shrink(b, &search[i], its);
        else
            rc = partition_add_children(b, search[i].node, search[i].axis, search[i].cut[chosen.ratio],
                                        &chosen);
    }
    return rc;
}

/* ---------------- the tree */

static uint32_t partition_leaf_of(const struct partition_build *b, uint32_t from, const double *p)
{
    while (b->node[from].child[0])
        from = (uint32_t)b->node[from].child[p[b->node[from].axis] >= b->node[from].cut];
    return from;
}

/* Moves points whose node was cut into its children; points whose node is gone start again from the root. */
OXL_INTERNAL void partition_update_leaves(const struct partition_build *b)
{
#pragma omp parallel for schedule(static) num_threads(b->ctx->threads)
    for (int task = 0; task < PARTITION_TASKS; task++) {
        const size_t end = partition_task_begin(b->count, task + 1);
        for (size_t i = partition_task_begin(b->count, task); i < end; i++)
            if (b->owner[i] != PARTITION_NO_BLOCK)
                b->owner[i] =
                    partition_leaf_of(b, b->node[b->owner[i]].removed ? 0 : b->owner[i], b->position + 3 * i);
    }
}

/* Computes D of Alg. 1: PARTITION_SPARE_LEVELS more than perfect halves would take, and not below
 * PARTITION_DEPTH_MIN. */
OXL_INTERNAL int partition_depth(size_t count, size_t block_points)
{
    int halves = 0;
    /* Stops at 32, before the shift could overflow. */
    while (halves < 32 && block_points << halves < count) halves++;
    return OXL_MAX((int)PARTITION_DEPTH_MIN, halves + PARTITION_SPARE_LEVELS);
}

static oxl_result partition_grow(struct partition_build *b)
{
    struct partition_search *search = oxl_alloc(b->ctx, PARTITION_BATCH, sizeof *search);
    struct partition_bin *bins =
        oxl_alloc(b->ctx, PARTITION_BATCH * (PARTITION_RATIOS + 1) * PARTITION_TASKS, sizeof *bins);
    oxl_result rc = search && bins ? OXL_OK : OXL_ERR_MEMORY;
    int count;
    while (rc == OXL_OK && (count = partition_gather(b, search)) > 0) {
        rc = partition_cut_batch(b, search, count, bins);
        partition_update_leaves(b);
    }
    OXL_FREE(b->ctx, search, bins);
    return rc;
}

/* Grows a tree from the root; leaves 0: cuts until no leaf has more than N_p points. */
OXL_INTERNAL oxl_result partition_grow_to(struct partition_build *b, int leaves)
{
    b->node[0] =
        (struct partition_node){.finite = b->finite, .points = b->kept, .leaves = leaves, .in_batch = -1};
    b->node_count = 1;
    for (size_t i = 0; i < b->count; i++)
        if (b->owner[i] != PARTITION_NO_BLOCK) b->owner[i] = 0;
    return partition_grow(b);
}

/* Sets the load of each point. by_pixels: fraction of the load that stands for pixels, which each view
 * distributes evenly over the points that it sees; the rest is equal for all points. */
OXL_INTERNAL oxl_result partition_set_loads(struct partition_build *b, double by_pixels)
{
    const struct partition_visibility *vis = b->visibility;
    double *pixel = oxl_calloc(b->ctx, b->count + 1, sizeof *pixel), sum = 0;
    if (!b->load) b->load = oxl_alloc(b->ctx, b->count + 1, sizeof *b->load);
    if (!pixel || !b->load) {
        oxl_free(b->ctx, pixel);
        return OXL_ERR_MEMORY;
    }
    for (size_t v = 0; v < vis->views; v++) {
        const oxl_camera *c = &oxl_scene_view(b->scene, (int)v)->camera;
        const size_t seen = vis->first[v + 1] - vis->first[v];
        for (size_t k = vis->first[v]; k < vis->first[v + 1]; k++)
            if (b->owner[vis->point[k]] != PARTITION_NO_BLOCK)
                pixel[vis->point[k]] += (double)c->width * c->height / (double)seen;
    }
    for (size_t i = 0; i < b->count; i++) sum += pixel[i];
    for (size_t i = 0; i < b->count; i++) {
        const double fraction = sum > 0 ? pixel[i] * (double)b->kept / sum : 1;
        b->load[i] =
            (uint32_t)OXL_MIN(PARTITION_LOAD * (1 - by_pixels + by_pixels * fraction), PARTITION_LOAD_MAX);
    }
    oxl_free(b->ctx, pixel);
    return OXL_OK;
}
