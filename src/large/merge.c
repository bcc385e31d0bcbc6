/* merge.c - merges rows of one model into another, and tells which block owns a Gaussian (OceanXL sec. 3.1).
 *
 * Invariant: the boxes are disjoint and cover all space, so each Gaussian with a finite centre belongs to
 * exactly one block.
 */
#include "large.h"
#include "../formats/formats.h"
#include "../model/model.h"

/* Lists the rows of a block's model that are merged. Rows with a second lobe come first in a model, so the
 * block's are inserted behind those of `into`, and its other rows are appended. */
struct merge_rows {
    size_t *row;                 /* (kept) rows of the block's model, ascending */
    size_t kept, lobes;          /* number of rows; the first `lobes` have a second lobe */
    size_t old_count, old_lobes; /* counts of `into` before the merge */
};

/* Writes each row at the end of the list and moves the end only if it is kept; `row` has room for all. */
static void merge_select(const oxl_model *from, const uint8_t *keep, struct merge_rows *m)
{
    for (size_t i = 0; i < from->count; i++) {
        const size_t kept = !keep || keep[i];
        m->row[m->kept] = i;
        m->kept += kept;
        if (i < from->lobes) m->lobes += kept;
    }
}

/* Returns the row of `into` at which the k-th row is stored. */
static size_t merge_slot(const struct merge_rows *m, size_t k)
{
    return k < m->lobes ? m->old_lobes + k : m->old_count + k;
}

/* Reserves the rows and lobes of `into`; its rows keep their indices, and on failure their values. */
static oxl_result merge_make_room(oxl_context *ctx, const struct merge_rows *m, int sh_degree,
                                  oxl_model *into)
{
    oxl_result rc = OXL_OK;
    if (sh_degree > into->sh_degree) rc = model_set_degree(ctx, into, sh_degree);
    /* Reserves no spare capacity, since the model may fill most of the memory. */
    if (rc == OXL_OK) rc = model_reserve(ctx, into, m->old_count + m->kept);
    if (rc != OXL_OK) return rc;
    into->count = m->old_count + m->kept;
    rc = model_set_lobes(ctx, into, m->old_lobes + m->lobes);
    if (rc != OXL_OK) into->count = m->old_count;
    return rc;
}

/* Inserts the rows, and moves positions to into's origin. Computes the difference of the origins first, so
 * that equal origins change no bit. */
static void merge_insert(const struct merge_rows *m, const oxl_model *from, oxl_model *into)
{
    const int planes = oxl_model_planes(into), carried = oxl_model_planes(from);
    for (int p = 0; p < planes; p++) {
        float *to = into->plane[p];
        const double shift = p < OXL_LOG_SCALE ? from->origin[p] - into->origin[p] : 0;
        memmove(to + m->old_lobes + m->lobes, to + m->old_lobes, (m->old_count - m->old_lobes) * sizeof *to);
        for (size_t k = 0; k < m->kept; k++)
            to[merge_slot(m, k)] = p < carried ? from->plane[p][m->row[k]] : 0;
        for (size_t k = 0; k < m->kept && shift != 0; k++)
            to[merge_slot(m, k)] = (float)(to[merge_slot(m, k)] + shift);
    }
    for (int p = OXL_LOBE; p < OXL_PLANES; p++)
        for (size_t k = 0; k < m->lobes; k++) into->plane[p][m->old_lobes + k] = from->plane[p][m->row[k]];
}

OXL_INTERNAL oxl_result merge_rows(oxl_context *ctx, const oxl_model *from, const uint8_t *keep,
                                   oxl_model *into)
{
    struct merge_rows m = {.old_count = into->count, .old_lobes = into->lobes};
    oxl_result rc = OXL_OK;
    if (from->has_background || from->antialias) model_copy_rendering(from, into);
    m.row = oxl_alloc(ctx, from->count + 1, sizeof *m.row);
    if (!m.row) return OXL_ERR_MEMORY;
    merge_select(from, keep, &m);
    rc = merge_make_room(ctx, &m, from->sh_degree, into);
    if (rc == OXL_OK) merge_insert(&m, from, into);
    oxl_free(ctx, m.row);
    return rc;
}

OXL_INTERNAL void merge_mark(const struct partition *p, int block, const oxl_model *model, uint8_t *inside)
{
    for (size_t i = 0; i < model->count; i++) {
        double world[3], frame[3];
        for (int a = 0; a < 3; a++) world[a] = (double)model->plane[OXL_MEAN + a][i] + model->origin[a];
        partition_to_frame(p, world, frame);
        inside[i] = (uint8_t)partition_contains(&p->block[block].box, frame);
    }
}
