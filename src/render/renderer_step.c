/* renderer_step.c - the optimizer step, and what the last view gives for each Gaussian: visibility, depth,
 * gradient. */
#include "renderer_state.h"

/* Describes the step of all planes of this degree and these rows with second lobes. gradient: of all rows, or
 * the renderer's part. */
static struct adam_job render_step_job(const struct trained_model *trained, const oxl_model *gradient,
                                       const oxl_adam *adam, int sh_degree, size_t lobes)
{
    const double step = adam->step, correction = 1 - vecmath_exp(step * vecmath_log(adam->beta[0]));
    struct adam_job job = {.planes = OXL_SH + 3 * (sh_degree + 1) * (sh_degree + 1),
                           .lobe_planes = lobes ? MODEL_LOBE_PLANES : 0,
                           .lobe_packs = render_packs(lobes),
                           .beta1 = (float)adam->beta[0],
                           .beta2 = (float)adam->beta[1],
                           .inverse_correction =
                               (float)(1 / sqrt(1 - vecmath_exp(step * vecmath_log(adam->beta[1]))))};
    for (int at = 0; at < job.planes + job.lobe_planes; at++) {
        const int k = at < job.planes ? at : OXL_LOBE + at - job.planes;
        job.parameter[at] = trained->model.plane[k];
        job.gradient[at] = gradient->plane[k];
        job.mean[at] = trained->mean.plane[k];
        job.square[at] = trained->square.plane[k];
        job.rate[at] = (float)(adam->rate[k] / correction);
    }
    return job;
}

/* Allocates room for the gradients of the packs that the threads step at a time. */
static oxl_result render_reserve_part(oxl_context *ctx, struct renderer *r)
{
    const size_t rows = (size_t)ctx->threads * RENDER_STEP_PART * PACK;
    const int degree = r->in.sh_degree, lobes = r->in.lobes > 0;
    oxl_result rc;
    if (r->part.count == rows && r->part.sh_degree == degree && (!lobes || r->part.lobes == rows))
        return OXL_OK;
    oxl_model_free(ctx, &r->part);
    rc = oxl_model_create(ctx, rows, degree, &r->part);
    return rc == OXL_OK && lobes ? model_set_lobes(ctx, &r->part, rows) : rc;
}

/* Steps the packs of a job, whose gradient is complete or, if its projection is pending, is completed here.
 * Returns the number of rows whose visibility the step cleared: their values were not finite. */
static size_t render_step_packs(const oxl_context *ctx, struct renderer *r, const struct gaussians *part,
                                struct adam_job *job)
{
    uint16_t seen[RENDER_STEP_PART];
    const size_t first = job->first_pack, thread = (size_t)context_thread();
    size_t skipped = 0;
    if (r->projection_pending) {
        job->gradient_row = (first - thread * RENDER_STEP_PART) * PACK;
        render_project_backward(ctx, r, first, job->end_pack, part, job->gradient_row);
    }
    memcpy(seen, r->visible + first, (job->end_pack - first) * sizeof *seen);
    adam_step(ctx->isa, job);
    for (size_t pack = first; pack < job->end_pack; pack++)
        for (unsigned left = seen[pack - first] & ~(unsigned)r->visible[pack]; left; left &= left - 1)
            skipped++;
    return skipped;
}

OXL_INTERNAL oxl_result renderer_step(oxl_context *ctx, struct renderer *r, struct trained_model *trained,
                                      const oxl_model *gradient, const oxl_adam *adam,
                                      struct renderer_nonfinite *out)
{
    const int64_t tasks = render_tasks(r);
    size_t skipped = 0;
    struct adam_job rows;
    struct gaussians part;
    oxl_result rc;
    if (r->device) {
        rc = r->backend->step(r->device, trained, adam, out);
        return rc == OXL_OK ? render_read_imaging_gradient(r) : rc;
    }
    rc = r->projection_pending ? render_reserve_part(ctx, r) : OXL_OK;
    if (rc != OXL_OK) return rc;
    part = render_gaussians(&r->part, r->in.sh_degree);
    rows = render_step_job(trained, r->projection_pending ? &r->part : gradient, adam, r->in.sh_degree,
                           r->in.lobes);
    rows.visible = r->visible;
#pragma omp parallel for schedule(dynamic) num_threads(ctx->threads) reduction(+ : skipped)
    for (int64_t task = 0; task < tasks; task++) {
        const size_t begin = (size_t)task * RENDER_TASK, end = OXL_MIN(begin + RENDER_TASK, r->packs);
        struct adam_job job = rows;
        for (job.first_pack = begin; job.first_pack < end; job.first_pack += RENDER_STEP_PART) {
            job.end_pack = OXL_MIN(job.first_pack + RENDER_STEP_PART, end);
            skipped += render_step_packs(ctx, r, &part, &job);
        }
    }
    if (r->projection_pending) render_add_task_sums(r);
    r->projection_pending = 0;
    *out = (struct renderer_nonfinite){skipped, 0};
    return OXL_OK;
}

/* ---------------- a step without a renderer */

static int render_same_shape(const oxl_model *a, const oxl_model *b)
{
    return a->count == b->count && a->sh_degree == b->sh_degree && a->lobes == b->lobes;
}

/* Marks the rows that have a gradient. */
static void render_mark_rows(const oxl_model *gradient, const struct adam_job *job)
{
    for (int k = 0; k < job->planes + job->lobe_planes; k++)
        for (size_t i = 0; i < (k < job->planes ? gradient->count : gradient->lobes); i++)
            if (job->gradient[k][i] != 0) job->visible[i / PACK] |= (uint16_t)(1u << i % PACK);
}

oxl_result oxl_adam_step(oxl_context *ctx, oxl_model *model, const oxl_model *gradient, oxl_model moments[2],
                         const oxl_adam *adam)
{
    struct trained_model t = {*model, moments[0], moments[1]};
    struct adam_job job;
    uint16_t *visible;
    oxl_result rc = moments[0].count ? OXL_OK : model_trained_begin(ctx, &t);
    if (rc != OXL_OK) return rc;
    moments[0] = t.mean, moments[1] = t.square;
    if (!render_same_shape(model, gradient) || !render_same_shape(model, &t.mean))
        return oxl_fail(ctx, OXL_ERR_USAGE,
                        "a model of %zu Gaussians, a gradient of %zu and moments of %zu differ in shape\n"
                        "fix: begin with new moments where the Gaussians are others",
                        model->count, gradient->count, t.mean.count);
    visible = oxl_calloc(ctx, render_packs(model->count) + 1, sizeof *visible);
    if (!visible) return OXL_ERR_MEMORY;
    job = render_step_job(&t, gradient, adam, model->sh_degree, model->lobes);
    job.visible = visible;
    job.end_pack = render_packs(model->count);
    render_mark_rows(gradient, &job);
    adam_step(ctx->isa, &job);
    oxl_free(ctx, visible);
    return OXL_OK;
}

/* ---------------- what the last view gives */

/* Returns 1 if the centre is inside the window, or there is none. Of a Gaussian that is cut, the gradient
 * is a part of what the image gives. */
static int render_shows_centre(const struct renderer *r, size_t row)
{
    const struct splat *s = &r->splat[row];
    return r->set.window.width == 0 || (s->u >= 0 && s->v >= 0 && s->u < (float)r->kernel_camera.width &&
                                        s->v < (float)r->kernel_camera.height);
}

/* Statistics for gradients at this depth. */
OXL_INTERNAL float *render_depth_sums(const struct renderer_sums *s, float depth)
{
    return !s->banded || depth < s->z_near ? s->gradient
           : depth < s->z_far              ? s->gradient_mid
                                           : s->gradient_far;
}

OXL_INTERNAL oxl_result renderer_observe(oxl_context *ctx, struct renderer *r, const struct renderer_sums *s)
{
    (void)ctx; /* without OpenMP */
    if (r->device) return r->backend->observe(r->device, s);
#pragma omp parallel for schedule(static) num_threads(ctx->threads)
    for (int64_t i = 0; i < (int64_t)s->count; i++)
        if (renderer_row_visible(r, (size_t)i) && render_shows_centre(r, (size_t)i)) {
            render_depth_sums(s, r->splat[i].depth)[i] += renderer_mean_gradient(r, (size_t)i);
            s->views[i] += 1;
        }
    return OXL_OK;
}

OXL_INTERNAL oxl_result renderer_download(struct renderer *r, enum renderer_download what)
{
    return r->device ? r->backend->download(r->device, what) : OXL_OK;
}

OXL_INTERNAL oxl_result renderer_move_rows(struct renderer *r, const struct renderer_move *move, int *moved)
{
    oxl_result rc = OXL_OK;
    *moved = 0;
    if (r->device) rc = r->backend->move_rows(r->device, move, moved);
    if (rc == OXL_OK && r->device && !*moved) rc = r->backend->download(r->device, DOWNLOAD_TO_CHANGE);
    return rc;
}

OXL_INTERNAL oxl_result renderer_send_shape(struct renderer *r, oxl_model *model, int reset_opacity)
{
    return r->device ? r->backend->send_shape(r->device, model, reset_opacity) : OXL_OK;
}

OXL_INTERNAL int renderer_defer(struct renderer *r, int on)
{
    r->deferred = r->device && r->backend->defer(r->device, on);
    return r->deferred;
}

OXL_INTERNAL oxl_result renderer_report(struct renderer *r, int wait, struct renderer_report *out)
{
    *out = (struct renderer_report){0};
    return r->device ? r->backend->report(r->device, wait, out) : OXL_OK;
}

OXL_INTERNAL int renderer_row_visible(const struct renderer *r, size_t row)
{
    return r->visible[row / PACK] >> (row % PACK) & 1;
}

OXL_INTERNAL oxl_result renderer_clear_visible(struct renderer *r)
{
    if (r->device) return r->backend->clear_visible(r->device);
    memset(r->visible, 0, r->packs * sizeof *r->visible);
    return OXL_OK;
}

OXL_INTERNAL oxl_result renderer_clear_nonfinite(struct renderer *r, struct trained_model *trained,
                                                 struct renderer_nonfinite *out)
{
    return r->backend->clear_nonfinite(r->device, trained, out);
}

OXL_INTERNAL int renderer_row_finite(const struct renderer *r, size_t row)
{
    const struct splat *s = &r->splat[row];
    if (!renderer_row_visible(r, row)) return 1;
    return 0 * (s->u + s->v + s->a + s->k + s->e + s->peak + s->colour[0] + s->colour[1] + s->colour[2]) == 0;
}

OXL_INTERNAL float renderer_mean_gradient(const struct renderer *r, size_t row)
{
    return r->dmean2d[row];
}
