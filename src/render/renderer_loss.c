/* renderer_loss.c - compares a view's image with the rendered one: exposure and lamp, loss, backward pass,
 * pruning scores. */
#include "renderer_state.h"

/* ---------------- loss and backward */

OXL_INTERNAL int renderer_has_image(const struct renderer *r, int view)
{
    return r->device && r->backend->has_image(r->device, view);
}

OXL_INTERNAL oxl_result renderer_set_image(oxl_context *ctx, struct renderer *r, int view,
                                           const struct training_image *image,
                                           const struct image_window *window, int halved)
{
    size_t pixels;
    oxl_result rc;
    if (r->device) {
        rc = r->backend->take_image(r->device, view, image, window, halved);
        if (image) rc = render_fall_back_to_cpu(ctx, r, rc, 0);
        if (rc != OXL_OK || r->device) return rc;
    }
    pixels =
        (size_t)(window ? window->width : image->width) * (size_t)(window ? window->height : image->height);
    rc = OXL_RESERVE(ctx, r->target, 3 * pixels);
    r->masked = image->mask != NULL;
    if (rc == OXL_OK && r->masked) rc = OXL_RESERVE(ctx, r->weight, pixels);
    if (rc != OXL_OK) return rc;
    image_from_training(ctx, image, window, r->target, r->masked ? r->weight : NULL);
    if (halved)
        image_halve(window ? window->width : image->width, window ? window->height : image->height, r->target,
                    r->masked ? r->weight : NULL);
    return OXL_OK;
}

OXL_INTERNAL oxl_result renderer_add_term(oxl_context *ctx, struct renderer_loss *loss, const char *name,
                                          double value)
{
    loss->total += value;
    if (fabs(value) <= DBL_MAX) return OXL_OK;
    return oxl_fail(ctx, OXL_ERR_USAGE,
                    "oxl_terms.%s returned %g, expected a finite value\n"
                    "fix: guard divisions, logarithms and roots in it",
                    name, value);
}

/* Computes the loss of the image x that is compared, with the terms on pixels, and its gradient r->drgb. */
static oxl_result render_loss_of(oxl_context *ctx, struct renderer *r, const float *x, const float *rgb,
                                 const float *weight, float ssim_weight, struct renderer_loss *out)
{
    const int width = r->kernel_camera.width, height = r->kernel_camera.height;
    const oxl_terms *terms = r->set.terms;
    const struct loss_job job = {width, height, ssim_weight, x,
                                 rgb,   weight, r->drgb,     (real)(r->set.contrast * r->set.contrast)};
    const oxl_result rc = loss_forward_backward(ctx, &job, &r->loss, out);
    if (rc == OXL_OK && terms && terms->pixels && out->total <= DBL_MAX) {
        const oxl_image rendered = {width, height, (float *)(uintptr_t)x, NULL},
                        image = {width, height, (float *)(uintptr_t)rgb, (float *)(uintptr_t)weight};
        return renderer_add_term(ctx, out, "pixels", terms->pixels(terms->user, &rendered, &image, r->drgb));
    }
    return rc;
}

OXL_INTERNAL void renderer_complete_loss(const struct renderer *r, struct renderer_loss *loss)
{
    memcpy(loss->dlamp, r->dlamp, sizeof loss->dlamp);
}

OXL_INTERNAL const double *renderer_pose_gradient(const struct renderer *r)
{
    return r->dpose;
}

static struct lamp_area render_lamp_area(const struct renderer *r)
{
    const int width = r->kernel_camera.width, height = r->kernel_camera.height;
    const struct renderer_window w = r->set.window;
    if (w.width == 0) return (struct lamp_area){width, height, width, height, 0, 0};
    return (struct lamp_area){width, height, w.width, w.height, w.x, w.y};
}

/* Computes the loss with exposure gains and lamp. */
static oxl_result render_loss_with_gains(oxl_context *ctx, struct renderer *r, const float *rgb,
                                         const float *weight, float ssim_weight, struct renderer_loss *out)
{
    const size_t pixels = (size_t)r->kernel_camera.width * r->kernel_camera.height;
    const float one[3] = {1, 1, 1};
    struct exposure_job exposure = {.area = render_lamp_area(r),
                                    .gain = r->set.gain ? r->set.gain : one,
                                    .shape = r->set.lamp ? r->set.lamp->shape : NULL,
                                    .x = r->rgb,
                                    .dy = r->drgb,
                                    .dx = r->drgb,
                                    .dlog_gain = out->dlog_gain,
                                    .dshape = r->dlamp};
    oxl_result rc = OXL_RESERVE(ctx, r->exposed, 3 * pixels);
    if (rc == OXL_OK) rc = OXL_RESERVE(ctx, r->lamp_map, pixels);
    if (rc != OXL_OK) return rc;
    exposure.y = r->exposed, exposure.lamp_map = r->lamp_map;
    exposure_forward(ctx->isa, &exposure);
    rc = render_loss_of(ctx, r, r->exposed, rgb, weight, ssim_weight, out);
    if (rc == OXL_OK) exposure_backward(ctx->isa, &exposure);
    return rc;
}

/* Scales the loss so that a pixel of a window counts as one of the full image does: the loss is a mean. */
static void render_scale_window_gradient(struct renderer *r, size_t pixels)
{
    const float fraction = (float)pixels / (4 * r->kernel_camera.half_width * r->kernel_camera.half_height);
    if (fraction == 1) return;
#pragma omp simd
    for (size_t i = 0; i < 3 * pixels; i++) r->drgb[i] *= fraction;
}

OXL_INTERNAL oxl_result renderer_loss(oxl_context *ctx, struct renderer *r, const float *rgb,
                                      const float *weight, float ssim_weight, struct renderer_loss *out)
{
    const size_t pixels = (size_t)r->kernel_camera.width * r->kernel_camera.height;
    oxl_result rc;
    *out = (struct renderer_loss){0};
    if (r->device) {
        const struct lamp_area area = render_lamp_area(r);
        return r->backend->loss(r->device, rgb, weight, &r->set, &area, ssim_weight, out);
    }
    if (!rgb) rgb = r->target, weight = r->masked ? r->weight : NULL;
    rc = OXL_RESERVE(ctx, r->drgb, 3 * pixels);
    if (rc == OXL_OK && (r->set.gain || r->set.lamp))
        rc = render_loss_with_gains(ctx, r, rgb, weight, ssim_weight, out);
    else if (rc == OXL_OK) rc = render_loss_of(ctx, r, r->rgb, rgb, weight, ssim_weight, out);
    if (rc == OXL_OK) render_scale_window_gradient(r, pixels);
    return rc;
}

OXL_INTERNAL void renderer_set_depths(struct renderer *r, const struct depth_point *point, int count,
                                      double weight)
{
    memcpy(r->depth_point, point, (size_t)count * sizeof *point);
    r->depth_points = count;
    r->depth_weight = weight;
}

OXL_INTERNAL void render_project_backward(const oxl_context *ctx, struct renderer *r, size_t first_pack,
                                          size_t end_pack, const struct gaussians *out, size_t out_row)
{
    struct project_job job = render_project_job(r, 0);
    const size_t task = first_pack / RENDER_TASK;
    job.first_pack = first_pack, job.end_pack = end_pack;
    job.out = *out;
    job.out_row = out_row;
    if (r->set.pose) {
        job.pose_sum = r->pose_sum[task];
        if (first_pack % RENDER_TASK == 0) memset(job.pose_sum, 0, sizeof r->pose_sum[task]);
    }
    project_backward(ctx->isa, &job);
}

static oxl_result render_begin_backward(oxl_context *ctx, struct renderer *r)
{
    oxl_result rc = OXL_RESERVE(ctx, r->sums, r->bins.slot_count + 1);
    if (rc == OXL_OK) rc = OXL_RESERVE(ctx, r->dmean2d, r->bins.packs * PACK);
    if (rc == OXL_OK && r->set.pose) rc = OXL_RESERVE(ctx, r->pose_sum, (size_t)render_tasks(r) + 1);
    return rc;
}

OXL_INTERNAL oxl_result renderer_backward(oxl_context *ctx, struct renderer *r, const float *drgb,
                                          oxl_model *gradient)
{
    const int64_t tasks = render_tasks(r);
    struct gaussians out;
    oxl_result rc = gradient ? model_set_lobes(ctx, gradient, r->in.lobes) : OXL_OK;
    if (rc == OXL_OK && r->device) {
        rc = r->backend->backward(r->device, drgb, r->depth_point, r->depth_points, r->depth_weight);
        r->depth_points = 0;
        return rc;
    }
    if (rc == OXL_OK) rc = render_begin_backward(ctx, r);
    if (rc != OXL_OK) return rc;
    render_each_tile(ctx, r, drgb ? drgb : r->drgb, raster_backward);
    depth_loss_backward(&r->bins, r->depth_point, r->depth_points, r->depth_weight, r->sums);
    r->depth_points = 0;
    r->projection_pending = !gradient;
    if (!gradient) return OXL_OK;
    out = render_gaussians(gradient, r->in.sh_degree);
#pragma omp parallel for schedule(dynamic) num_threads(ctx->threads)
    for (int64_t task = 0; task < tasks; task++) {
        const size_t first = (size_t)task * RENDER_TASK;
        render_project_backward(ctx, r, first, OXL_MIN(first + RENDER_TASK, r->packs), &out, 0);
    }
    render_add_task_sums(r);
    return OXL_OK;
}

/* Reads the gradients of lamp and medium from a device, where there are any. */
OXL_INTERNAL oxl_result render_read_imaging_gradient(struct renderer *r)
{
    if (!r->device || r->deferred || !r->set.lamp) return OXL_OK;
    return r->backend->lamp_gradient(r->device, r->dlamp);
}

OXL_INTERNAL oxl_result renderer_gradient(struct renderer *r, oxl_model *gradient)
{
    oxl_result rc = OXL_OK;
    if (r->device) rc = r->backend->gradient(r->device, gradient);
    return rc == OXL_OK ? render_read_imaging_gradient(r) : rc;
}

/* ---------------- score */

OXL_INTERNAL oxl_result renderer_score(oxl_context *ctx, struct renderer *r, const float *drgb, float *score)
{
    oxl_result rc;
    if (r->device) return render_fall_back_to_cpu(ctx, r, r->backend->score(r->device, drgb, score), 0);
    rc = OXL_RESERVE(ctx, r->score, r->bins.slot_count + 1);
    if (rc != OXL_OK) return rc;
    render_each_tile(ctx, r, drgb, raster_score);
#pragma omp parallel for schedule(static) num_threads(ctx->threads)
    /* in slot order, which fixes the rounding */
    for (int64_t i = 0; i < (int64_t)r->bins.visible_count; i++) {
        const struct splat *s = &r->splat[r->bins.order[i]];
        float sum = 0;
        if (r->bins.order[i] >= r->packs * PACK) continue; /* of the surroundings */
        for (uint32_t slot = s->first_slot; slot < s->first_slot + s->slots; slot++) sum += r->score[slot];
        score[r->bins.order[i]] += sum;
    }
    return OXL_OK;
}
