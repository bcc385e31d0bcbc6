/* nonfinite.c - values that are not finite, and images that cannot be read: logged where they appear, skipped
 * or cleared, and counted.
 *
 * An image that cannot be read is left out from then on (counted as images). Where the loss of a view is
 * not finite, Gaussians with such a value, or with one when rendered, are cleared, and the step is skipped
 * (steps, cleared). Where a visible Gaussian or its gradient has such a value, its own update is skipped and
 * other Gaussians are updated; a Gaussian with such a value is cleared (rows, cleared). In the final model
 * the Gaussian is removed (cleared).
 *
 * A cleared Gaussian has size 1 and opacity 1e-13 at the origin; it is never visible and is removed by
 * density control.
 *
 * Invariant: trained models are finite, and all interventions are reported.
 */
#include "train_tools.h"

enum { NONFINITE_NAMED = 10 }; /* messages per kind; the total is logged at the end */

#define NONFINITE_OPACITY -30.0f /* logit: far below 1/255 */

/* ---------------- in a step */

OXL_INTERNAL void nonfinite_count_unreadable(oxl_context *ctx, oxl_nonfinite *n)
{
    if (n->images++ < NONFINITE_NAMED)
        oxl_log(ctx, OXL_LOG_WARNING, "%s; training continues without it", oxl_error_text(ctx));
}

static void nonfinite_clear_row(oxl_model *m, size_t row, float rotation, float opacity)
{
    for (int k = 0; k < oxl_model_planes(m); k++) m->plane[k][row] = 0;
    for (int k = OXL_LOBE; row < m->lobes && k < OXL_PLANES; k++) m->plane[k][row] = 0;
    m->plane[OXL_ROTATION][row] = rotation;
    m->plane[OXL_OPACITY][row] = opacity;
}

OXL_INTERNAL struct renderer_nonfinite nonfinite_clear(const struct renderer *r,
                                                       struct trained_model *trained)
{
    struct renderer_nonfinite out = {0, 0};
    for (size_t i = 0; i < trained->model.count; i++) {
        if (model_row_is_finite(&trained->model, i) && (!r || renderer_row_finite(r, i))) continue;
        out.rows++;
        nonfinite_clear_row(&trained->model, i, 1, NONFINITE_OPACITY);
        nonfinite_clear_row(&trained->mean, i, 0, 0);
        nonfinite_clear_row(&trained->square, i, 0, 0);
    }
    out.cleared = out.rows;
    return out;
}

OXL_INTERNAL void nonfinite_of_view(oxl_context *ctx, oxl_nonfinite *n, int step, const char *view,
                                    struct renderer_nonfinite cleared)
{
    n->cleared += cleared.rows;
    if (n->steps++ < NONFINITE_NAMED)
        oxl_log(ctx, OXL_LOG_WARNING,
                "step %d: the loss of %s is not finite; the step is skipped, %zu Gaussians are cleared", step,
                view, cleared.rows);
}

OXL_INTERNAL void nonfinite_of_rows(oxl_context *ctx, oxl_nonfinite *n, int step, const char *view,
                                    struct renderer_nonfinite skipped, struct trained_model *trained)
{
    size_t cleared;
    if (skipped.rows == 0) return;
    cleared = trained ? nonfinite_clear(NULL, trained).rows : skipped.cleared;
    if (n->rows < NONFINITE_NAMED)
        oxl_log(ctx, OXL_LOG_WARNING,
                "step %d: %s: %zu Gaussians have values that are not finite; their steps are skipped, %zu "
                "cleared",
                step, view, skipped.rows, cleared);
    n->rows += skipped.rows;
    n->cleared += cleared;
}

/* ---------------- at the end */

OXL_INTERNAL oxl_result nonfinite_end(oxl_context *ctx, oxl_nonfinite *n, oxl_model *model)
{
    const size_t count = model->count;
    uint8_t *keep = oxl_alloc(ctx, count + 1, 1);
    if (!keep) return OXL_ERR_MEMORY;
    for (size_t i = 0; i < count; i++) {
        keep[i] = (uint8_t)model_row_is_finite(model, i);
        n->cleared += !keep[i];
    }
    model_keep_rows(model, keep);
    oxl_free(ctx, keep);
    if (n->images > 0)
        oxl_log(ctx, OXL_LOG_WARNING, "%zu images could not be read and were left out", n->images);
    if (n->steps + n->rows + n->cleared > 0)
        oxl_log(
            ctx, OXL_LOG_WARNING,
            "values that are not finite: %zu steps and %zu steps of single Gaussians skipped, %zu Gaussians cleared",
            n->steps, n->rows, n->cleared);
    return OXL_OK;
}
