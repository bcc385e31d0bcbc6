/* merge.c - join the models of the blocks into one (OceanXL sec. 3.1; BlockGaussian).
 *
 * Invariant: a Gaussian is kept by the block in whose home its centre lies, and by no other. So what two neighbours both trained,
 * where their expanded boxes overlap, is there once; and as the outer homes have no end, nothing far away is lost.
 */
#include "internal.h"

static int merge_is_at_home(const struct partition *p, int block, const oxl_model *model, size_t row)
{
    double world[3], frame[3];
    for (int a = 0; a < 3; a++) world[a] = (double)model->plane[OXL_MEAN + a][row] + model->origin[a];
    partition_to_frame(p, world, frame);
    return partition_contains(&p->block[block].box, frame);
}

/* row[k] is the k-th that is kept; returns how many are. A centre that is not a number has no home. */
static size_t merge_select(const struct partition *p, int block, const oxl_model *model, size_t *row)
{
    size_t kept = 0;
    for (size_t i = 0; i < model->count; i++) {
        row[kept] = i;
        kept += (size_t)merge_is_at_home(p, block, model, i);
    }
    return kept;
}

/* `into` has room. The origins are subtracted from each other before a coordinate comes in: the same origin changes no bit. */
static void merge_append(const oxl_model *from, const size_t *row, size_t kept, oxl_model *into)
{
    const size_t first  = into->count;
    const int    planes = oxl_model_planes(into), carried = oxl_model_planes(from);
    for (int p = 0; p < planes; p++) {
        float *to = into->plane[p] + first;
        for (size_t k = 0; k < kept; k++) to[k] = p < carried ? from->plane[p][row[k]] : 0;
    }
    for (int a = 0; a < 3; a++) {
        const double shift = from->origin[a] - into->origin[a];
        float       *mean  = into->plane[OXL_MEAN + a] + first;
        for (size_t k = 0; k < kept; k++) mean[k] = (float)(mean[k] + shift);
    }
    into->count += kept;
}

OXL_INTERNAL oxl_result merge_block(oxl_context *ctx, const struct partition *p, int block, const oxl_model *from,
                                    oxl_model *into)
{
    oxl_result rc  = OXL_OK;
    size_t    *row = oxl_alloc(ctx, from->count + 1, sizeof *row), kept;
    if (!row) return oxl_fail(ctx, OXL_ERR_MEMORY, "no memory to merge the %zu Gaussians of block %d", from->count, block);
    kept = merge_select(p, block, from, row);
    if (from->sh_degree > into->sh_degree) rc = model_set_degree(ctx, into, from->sh_degree);
    if (rc == OXL_OK)
        rc = model_reserve(ctx, into, into->count + kept); /* no more than that: the whole may be most of the memory */
    if (rc == OXL_OK) merge_append(from, row, kept, into);
    oxl_free(ctx, row);
    return rc;
}
