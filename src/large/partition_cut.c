/* partition_cut.c - cuts a survey into boxes of equally many points (OceanXL sec. 3.1, Alg. 1).
 *
 *     a box of k blocks is cut across its longest axis; its low side, of k/2 blocks, has that share of the points
 *
 * The paper takes the best of the places 0.30, 0.32 ... 0.70 of a box for two equal halves. Here the place is the
 * quantile of the points, kept within 0.3 to 0.7 of the box. Guard: where this leaves a side too few points
 * for a block, it is the quantile itself; if that does not help, as for points in one place, the box stays
 * whole.
 *
 * Invariant: every place, and so every point and every Gaussian, belongs to exactly one block.
 */
#include "partition.h"
#include "../survey/sparse.h"
#include "../survey/scene.h"
#include "../survey/survey.h"
#include "../survey/tracks.h"

enum { CUT_LEAST = 20 }; /* divides the mean points of a block: a side has at least so many */
#define CUT_MARGIN 0.3   /* Is the least distance of a cut from the faces, in sizes of the box [OceanXL]. */

struct cutter {
    oxl_context *ctx;
    struct partition *p;
    oxl_cut cut;
    size_t limit, least; /* most points of a block; least points of a side */
    size_t capacity;     /* of p->block */
    double *value;       /* (points of the box that is cut) */
};

static double cut_coordinate(const struct cutter *c, uint32_t point, int axis)
{
    double frame[3];
    partition_to_frame(c->p, scene_colmap(c->p->plan->scene)->point[point].position, frame);
    return frame[axis];
}

static int cut_longest_axis(const struct cutter *c, const struct partition_box *box)
{
    int longest = 0;
    for (int k = 1; k < c->p->dimensions; k++)
        if (box->high[k] - box->low[k] > box->high[longest] - box->low[longest]) longest = k;
    return longest;
}

static size_t cut_count_below(const struct cutter *c, size_t count, double place)
{
    size_t below = 0;
    for (size_t i = 0; i < count; i++) below += c->value[i] < place;
    return below;
}

/* Finds the place of a cut, and returns the number of points below it; 0: the box stays whole. wanted: below. */
static size_t cut_choose(const struct cutter *c, const uint32_t *points, size_t count, size_t wanted,
                         int axis, const struct partition_box *box, double *place)
{
    const double low = box->low[axis], size = box->high[axis] - low;
    const double margin = size * (c->cut == OXL_CUT_MIDPOINT ? 0.5 : CUT_MARGIN);
    double quantile;
    size_t below;
    for (size_t i = 0; i < count; i++) c->value[i] = cut_coordinate(c, points[i], axis);
    quantile = stats_select(c->value, count, (double)wanted / (double)OXL_MAX(count - 1, 1));
    *place = OXL_CLAMP(quantile, low + margin, low + size - margin);
    below = cut_count_below(c, count, *place);
    if (OXL_MIN(below, count - below) < c->least) below = cut_count_below(c, count, *place = quantile);
    return OXL_MIN(below, count - below) < c->least ? 0 : below;
}

static oxl_result cut_add_block(struct cutter *c, const struct partition_block *block)
{
    struct partition *p = c->p;
    const oxl_result rc =
        oxl_reserve(c->ctx, &p->block, &c->capacity, (size_t)p->block_count + 1, sizeof *p->block);
    if (rc == OXL_OK) p->block[p->block_count++] = *block;
    return rc;
}

/* Moves the points below a place of an axis to the front. */
static void cut_sort(const struct cutter *c, uint32_t *points, size_t count, int axis, double place)
{
    size_t below = 0;
    for (size_t i = 0; i < count; i++)
        if (cut_coordinate(c, points[i], axis) < place) {
            OXL_SWAP(uint32_t, points[i], points[below]);
            below++;
        }
}

/* Cuts a box with its points into at least so many blocks. */
static oxl_result cut_divide(struct cutter *c, const struct partition_block *box, uint32_t *points,
                             int blocks)
{
    struct partition_block side[2] = {*box, *box};
    const int axis = cut_longest_axis(c, &box->finite);
    double place = 0;
    oxl_result rc = OXL_OK;
    side[0].points =
        blocks < 2 ? 0
                   : cut_choose(c, points, box->points, box->points * (size_t)(blocks / 2) / (size_t)blocks,
                                axis, &box->finite, &place);
    if (side[0].points == 0) return cut_add_block(c, box);
    cut_sort(c, points, box->points, axis, place);
    side[1].points = box->points - side[0].points;
    side[0].box.high[axis] = side[1].box.low[axis] = place;
    place = OXL_CLAMP(place, box->finite.low[axis], box->finite.high[axis]);
    side[0].finite.high[axis] = side[1].finite.low[axis] = place;
    for (int i = 0; i < 2 && rc == OXL_OK; i++) {
        const int half = c->cut == OXL_CUT_MIDPOINT ? 1 : (blocks + i) / 2,
                  needed = (int)((side[i].points - 1) / c->limit) + 1;
        rc = cut_divide(c, &side[i], points + (i ? side[0].points : 0), OXL_MAX(half, needed));
    }
    return rc;
}

OXL_INTERNAL oxl_result partition_cut(oxl_context *ctx, struct partition *p, oxl_cut cut, int blocks,
                                      size_t limit)
{
    const struct colmap *colmap = scene_colmap(p->plan->scene);
    struct partition_block all = {.finite = p->plan->finite};
    struct cutter c = {.ctx = ctx, .p = p, .cut = cut, .limit = limit};
    oxl_result rc;
    for (int k = 0; k < 3; k++) all.box.low[k] = -INFINITY, all.box.high[k] = INFINITY;
    for (size_t i = 0; i < colmap->point_count; i++)
        if (tracks_accept_point(&colmap->point[i], p->origin)) p->plan->point[all.points++] = (uint32_t)i;
    c.least = all.points / (size_t)blocks / CUT_LEAST + 1;
    c.value = oxl_alloc(ctx, all.points + 1, sizeof *c.value);
    rc = c.value ? cut_divide(&c, &all, p->plan->point, blocks) : OXL_ERR_MEMORY;
    oxl_free(ctx, c.value);
    return rc;
}
