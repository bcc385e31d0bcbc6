/* partition_cut.c - cuts a survey into boxes of equally many points (OceanXL sec. 3.1, Alg. 1).
 *
 *     a box of k blocks is cut across its longest axis; its low side, of k/2 blocks, has that share of the
 *     points
 *
 * The paper takes the best of the places 0.30 to 0.70 of a box for two equal halves. Here the place is
 * the quantile of the points, kept within 0.3 to 0.7 of the box. Guard: where this leaves a side too few
 * points
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
    double *value;       /* (points of the box that is cut) coordinates */
};

static double cut_coordinate(const struct cutter *c, uint32_t row, int axis)
{
    double frame[3];
    partition_to_frame(c->p, scene_colmap(c->p->plan->scene)->point[row].position, frame);
    return frame[axis];
}

static int cut_longest_axis(const struct cutter *c, const struct partition_box *box)
{
    int longest = 0;
    for (int k = 1; k < c->p->dimensions; k++)
        if (box->high[k] - box->low[k] > box->high[longest] - box->low[longest]) longest = k;
    return longest;
}

/* Moves the points below a place of an axis to the front and returns their number; 0: a side has too few. */
static size_t cut_sort(const struct cutter *c, uint32_t *row, size_t count, int axis, double place)
{
    size_t below = 0;
    for (size_t i = 0; i < count; i++)
        if (cut_coordinate(c, row[i], axis) < place) {
            OXL_SWAP(uint32_t, row[i], row[below]);
            below++;
        }
    return OXL_MIN(below, count - below) < c->least ? 0 : below;
}

/* Cuts the points of a box in two, and returns the number of those below the place; 0: the box stays whole.
 * row: rows of the points in the COLMAP model. wanted: points below. */
static size_t cut_choose(const struct cutter *c, const struct partition_block *box, uint32_t *row,
                         size_t wanted, int axis, double *place)
{
    const double low = box->finite.low[axis], high = box->finite.high[axis];
    const double margin = (high - low) * (c->cut == OXL_CUT_MIDPOINT ? 0.5 : CUT_MARGIN);
    double quantile;
    size_t below;
    for (size_t i = 0; i < box->points; i++) c->value[i] = cut_coordinate(c, row[i], axis);
    quantile = stats_select(c->value, box->points, (double)wanted / (double)OXL_MAX(box->points - 1, 1));
    *place = OXL_CLAMP(quantile, low + margin, high - margin);
    below = cut_sort(c, row, box->points, axis, *place);
    return below ? below : cut_sort(c, row, box->points, axis, *place = quantile);
}

static oxl_result cut_add_block(struct cutter *c, const struct partition_block *block, const uint32_t *row)
{
    struct partition *p = c->p;
    const oxl_result rc =
        oxl_reserve(c->ctx, &p->block, &c->capacity, (size_t)p->block_count + 1, sizeof *p->block);
    if (rc != OXL_OK) return rc;
    for (size_t i = 0; i < block->points; i++) p->plan->owner[row[i]] = p->block_count;
    p->block[p->block_count++] = *block;
    return OXL_OK;
}

/* Cuts a box into so many blocks, or into more where a side has too many points. */
static oxl_result cut_divide(struct cutter *c, const struct partition_block *box, uint32_t *row, int blocks)
{
    struct partition_block side[2] = {*box, *box};
    const int axis = cut_longest_axis(c, &box->finite);
    const size_t wanted = box->points * (size_t)(blocks / 2) / (size_t)blocks;
    double place = 0;
    oxl_result rc = OXL_OK;
    side[0].points = blocks > 1 ? cut_choose(c, box, row, wanted, axis, &place) : 0;
    if (side[0].points == 0) return cut_add_block(c, box, row);
    side[1].points = box->points - side[0].points;
    side[0].box.high[axis] = side[1].box.low[axis] = place;
    place = OXL_CLAMP(place, box->finite.low[axis], box->finite.high[axis]);
    side[0].finite.high[axis] = side[1].finite.low[axis] = place;
    for (int i = 0; i < 2 && rc == OXL_OK; i++) {
        const int half = c->cut == OXL_CUT_MIDPOINT ? 1 : (blocks + i) / 2,
                  needed = (int)((side[i].points - 1) / c->limit) + 1;
        rc = cut_divide(c, &side[i], row + (i ? side[0].points : 0), OXL_MAX(half, needed));
    }
    return rc;
}

OXL_INTERNAL oxl_result partition_cut(oxl_context *ctx, struct partition *p, oxl_cut cut, int blocks,
                                      size_t limit)
{
    const struct colmap *colmap = scene_colmap(p->plan->scene);
    struct partition_block all = {.finite = p->plan->finite};
    struct cutter c = {.ctx = ctx, .p = p, .cut = cut, .limit = limit};
    uint32_t *row = oxl_alloc(ctx, colmap->point_count + 1, sizeof *row);
    oxl_result rc;
    c.value = oxl_alloc(ctx, colmap->point_count + 1, sizeof *c.value);
    rc = row && c.value ? OXL_OK : OXL_ERR_MEMORY;
    for (int k = 0; k < 3; k++) all.box.low[k] = -INFINITY, all.box.high[k] = INFINITY;
    for (size_t i = 0; i < colmap->point_count && rc == OXL_OK; i++) {
        p->plan->owner[i] = -1;
        if (tracks_accept_point(&colmap->point[i], p->origin)) row[all.points++] = (uint32_t)i;
    }
    c.least = all.points / (size_t)blocks / CUT_LEAST + 1;
    if (rc == OXL_OK) rc = cut_divide(&c, &all, row, blocks);
    OXL_FREE(ctx, row, c.value);
    return rc;
}
