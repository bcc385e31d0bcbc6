/* step.c - the parts of one training step: forward, loss, backward, Adam; then density control and
 * pruning. */
#include "parts_calls.h"
#include "../core/vecmath.h"
#include "../survey/sparse.h"
#include "../survey/scene.h"

#define STEP_ORDER (UINT64_C(0x5649455753) << 24) /* random numbers of the views' order: "VIEWS" in ASCII */
/* views of the epoch looked at for images to read ahead: many may be in memory already */
#define STEP_READ_AHEAD 64
#define STEP_MSE_MIN 1e-10 /* 100 dB: PSNR of equal images in progress reports */
/* of loss and PSNR in progress reports: about the last 50 views */
#define STEP_SMOOTHING 0.02

/* Shuffles the views (Fisher & Yates 1938): every epoch sees each once, in an order of its own. */
static void step_shuffle(struct train *t, int epoch)
{
    for (int i = t->views - 1; i > 0; i--) {
        const int j = (int)(random_bits(t->ctx->options.seed ^ STEP_ORDER, (uint64_t)epoch, (uint64_t)i) %
                            (uint64_t)(i + 1));
        OXL_SWAP(int, t->view[i], t->view[j]);
    }
}

/* Returns 1 if the step is one of the run's first part, which trains at half the sides. */
static int step_is_coarse(const struct train *t, const oxl_camera *camera)
{
    return t->step <=
               schedule_coarse_fraction(t->options, camera->width, camera->height) * t->options->iterations &&
           camera->width > 1 && camera->height > 1;
}

OXL_INTERNAL const struct image_window *step_window(const struct train *t, int view)
{
    return t->task.window ? &t->task.window[view] : NULL;
}

/* Returns the camera of that part at this step's resolution, and tells the renderer the full image's size. */
static oxl_camera step_camera(struct train *t, int view)
{
    const struct image_window *w = step_window(t, view);
    oxl_camera camera = t->scene->view[view].camera;
    const int by = t->halved ? 2 : 1;
    renderer_settings(t->renderer)->window =
        w ? (struct renderer_window){camera.width / by, camera.height / by, (float)w->x / (float)by,
                                     (float)w->y / (float)by}
          : (struct renderer_window){0};
    if (w) {
        camera.width = w->width, camera.height = w->height;
        camera.cx -= w->x, camera.cy -= w->y;
    }
    return t->halved ? camera_halve(&camera) : camera;
}

OXL_INTERNAL oxl_result step_load_image(struct train *t, int view)
{
    const struct image_window *window = step_window(t, view);
    const struct training_image *image;
    oxl_result rc = OXL_ERR_MEMORY;
    t->halved = step_is_coarse(t, &t->scene->view[view].camera);
    if (renderer_has_image(t->renderer, view))
        rc = renderer_set_image(t->ctx, t->renderer, view, NULL, window, t->halved);
    if (rc != OXL_ERR_MEMORY) return rc; /* else the CPU continues, and needs the image */
    image = scene_image(t->ctx, t->scene, view);
    return image ? renderer_set_image(t->ctx, t->renderer, view, image, window, t->halved) : t->ctx->failed;
}

/* Reads ahead the next images of the epoch that a device does not hold. */
static void step_read_ahead(struct train *t, int slot)
{
    int view[STEP_READ_AHEAD], count = 0;
    /* A callback may have read images on another background. */
    scene_set_background(t->ctx, t->scene, t->render.background);
    for (int i = slot; i < t->views && count < STEP_READ_AHEAD; i++)
        if (!renderer_has_image(t->renderer, t->view[i])) view[count++] = t->view[i];
    if (count > 0 && view[0] == t->view[slot]) scene_images_ahead(t->ctx, t->scene, view, count);
}

/* Refuses further training; the last checkpoint stays, so that the run continues when the images are back. */
static oxl_result step_refuse_unreadable(struct train *t, oxl_result why)
{
    char last[400];
    snprintf(last, sizeof last, "%.*s", (int)strcspn(oxl_error_text(t->ctx), "\n"), oxl_error_text(t->ctx));
    return oxl_fail(
        t->ctx, why,
        "%d training images cannot be read, the last: %s\n"
        "fix: look at their folder and the disk, and run the same command again, or allow more by "
        "--missing-images",
        (int)t->nonfinite.images, last);
}

/* Finds the next view whose image can be read; one that cannot is named and left out from then on. */
static oxl_result step_next_image(struct train *t, int *view)
{
    while (t->views > 0) {
        const int step = t->step - 1 - t->task.first, slot = step % t->views;
        oxl_result rc;
        if (slot == 0) step_shuffle(t, (t->step - 1) / t->views);
        *view = t->view[slot];
        step_read_ahead(t, slot);
        rc = step_load_image(t, *view);
        if (!scene_lacks_image(rc)) return rc;
        nonfinite_count_unreadable(t->ctx, &t->nonfinite);
        if (rc == OXL_ERR_IO && scene_misses_too_many(t->scene, (int)t->nonfinite.images))
            return step_refuse_unreadable(t, rc);
        t->view[slot] = t->view[--t->views];
    }
    return oxl_fail(
        t->ctx, OXL_ERR_INPUT,
        "none of the training images can be read\nfix: run oceanxl check, which reads each image and reports "
        "errors");
}

OXL_INTERNAL struct oxl_imaging step_imaging(const struct train *t)
{
    struct oxl_imaging m = {0};
    parts_form_image(t, &m);
    return m;
}

/* Begins a step on a view. */
static struct train_deferred step_begin(struct train *t, int view)
{
    struct train_deferred step = {.step = t->step, .view = view};
    parts_set_gain(t, &step, 1);
    step.imaging = step_imaging(t);
    return step;
}

/* Renders the model, times the view's gain, and compares it with its image as step_load_image has left it. */
static oxl_result step_forward_loss(struct train *t, struct part_view *v, struct renderer_loss *loss)
{
    const float ssim_weight = t->options->ssim_weight;
    oxl_result rc = OXL_OK;
    v->camera = step_camera(t, v->view);
    v->imaging = v->step->imaging;
    PARTS_CALL(rc, k, before_render, t, t->part[k], v);
    if (rc != OXL_OK) return rc;
    renderer_settings(t->renderer)->medium = v->imaging.medium;
    rc = renderer_forward(t->ctx, t->renderer, &t->trained.model, &v->camera, &t->render);
    renderer_settings(t->renderer)->gain = v->step->has_gain ? v->step->gain : NULL;
    PARTS_CALL(rc, k, after_render, t, t->part[k], v);
    if (rc != OXL_OK) return rc;
    return renderer_loss(t->ctx, t->renderer, NULL, NULL, ssim_weight, loss);
}

/* Leaves out a step whose loss is not finite. */
static oxl_result step_skip(struct train *t, int step, int view)
{
    struct renderer_nonfinite cleared;
    oxl_result rc = OXL_OK;
    if (renderer_has_device(t->renderer)) rc = renderer_clear_nonfinite(t->renderer, &t->trained, &cleared);
    else cleared = nonfinite_clear(t->renderer, &t->trained);
    if (rc != OXL_OK) return rc;
    nonfinite_of_view(t->ctx, &t->nonfinite, step, t->scene->view[view].name, cleared);
    /* later code must not read gradients of an earlier step */
    return renderer_clear_visible(t->renderer);
}

/* Records what is known of a step when it is done. */
static void step_update_means(struct train *t, const struct train_deferred *of,
                              const struct renderer_loss *loss, struct renderer_nonfinite skipped)
{
    const double psnr =
        -VECMATH_DECIBEL_OF_E * vecmath_log(loss->mse > STEP_MSE_MIN ? loss->mse : STEP_MSE_MIN);
    const double k = OXL_MAX(STEP_SMOOTHING, 1.0 / (of->step - t->task.first));
    PARTS_FOR(i, after_loss) parts_at(i)->after_loss(t, t->part[i], of, loss);
    nonfinite_of_rows(t->ctx, &t->nonfinite, of->step, t->scene->view[of->view].name, skipped,
                      renderer_has_device(t->renderer) ? NULL : &t->trained);
    t->last_loss = loss->total;
    t->loss += k * (loss->total - t->loss);
    t->psnr += k * (psnr - t->psnr);
}

/* Returns 1 if the gradient of the parameters exists as planes between the backward pass and the step. */
static int step_has_planes(const struct train *t)
{
    return t->options->terms && t->options->terms->parameters;
}

/* Makes the backward pass, with the terms on parameters. */
static oxl_result step_backward(struct train *t, struct renderer_loss *loss)
{
    const oxl_terms *terms = t->options->terms;
    const oxl_model *model = &t->trained.model;
    oxl_result rc = OXL_OK;
    if (!step_has_planes(t)) return renderer_backward(t->ctx, t->renderer, NULL, NULL);
    if (t->gradient.count != model->count || t->gradient.sh_degree != model->sh_degree) {
        oxl_model_free(t->ctx, &t->gradient);
        rc = oxl_model_create(t->ctx, model->count, model->sh_degree, &t->gradient);
    }
    if (rc == OXL_OK) rc = renderer_backward(t->ctx, t->renderer, NULL, &t->gradient);
    if (rc != OXL_OK) return rc;
    return renderer_add_term(t->ctx, loss, "parameters", terms->parameters(terms->user, model, &t->gradient));
}

/* Makes forward pass, loss, backward pass and step. Deferred, they are only recorded: what becomes of them
 * is in the step's report. */
OXL_INTERNAL oxl_result step_on_view(struct train *t, const struct train_deferred *here, int deferred)
{
    struct train_deferred step = *here;
    struct part_view v = {
        .view = here->view, .progress = (double)t->step / t->options->iterations, .step = &step};
    oxl_adam adam;
    struct renderer_loss loss;
    struct renderer_nonfinite skipped;
    oxl_result rc;
    if (!deferred) t->last_loss = NAN;
    t->render.alpha_min = schedule_alpha_min(t);
    rc = step_forward_loss(t, &v, &loss);
    if (rc != OXL_OK) return rc;
    if (!deferred && !(loss.total <= DBL_MAX)) return step_skip(t, t->step, v.view);
    PARTS_CALL(rc, k, before_backward, t, t->part[k], &v);
    if (rc == OXL_OK) rc = step_backward(t, &loss);
    if (rc != OXL_OK) return rc;
    adam = schedule_adam_params(t);
    rc = renderer_step(t->ctx, t->renderer, &t->trained, step_has_planes(t) ? &t->gradient : NULL, &adam,
                       &skipped);
    if (rc != OXL_OK || deferred) return rc;
    renderer_complete_loss(t->renderer, &loss);
    step_update_means(t, here, &loss, skipped);
    return OXL_OK;
}

/* ---------------- deferred steps: the device works while the host goes on */

/* Repeats a deferred step that halted, or that came behind one. */
static oxl_result step_repeat(struct train *t, const struct train_deferred *which)
{
    const int step = t->step;
    oxl_result rc;
    t->step = which->step;
    rc = step_load_image(t, which->view);
    if (rc == OXL_OK) rc = step_on_view(t, which, 0);
    if (rc == OXL_OK && which->observed)
        rc = density_observe(t->ctx, &t->density, t->renderer, t->trained.model.count);
    t->step = step;
    return rc;
}

static oxl_result step_after_halt(struct train *t, enum renderer_halt halt)
{
    const struct train_deferred first = t->deferred[0], second = t->deferred[1];
    const int steps = t->deferred_steps;
    oxl_result rc;
    renderer_defer(t->renderer, 0);
    t->deferred_steps = 0;
    rc = halt == HALT_LOSS ? step_skip(t, first.step, first.view) : step_repeat(t, &first);
    if (halt == HALT_LOSS) t->last_loss = NAN;
    return rc == OXL_OK && steps > 1 ? step_repeat(t, &second) : rc;
}

/* Reads what deferred steps have left; wait: all of them, not all but the last. */
static oxl_result step_read_reports(struct train *t, int wait)
{
    oxl_result rc = OXL_OK;
    while (rc == OXL_OK && t->deferred_steps > 0) {
        struct renderer_report report;
        rc = renderer_report(t->renderer, wait, &report);
        if (rc != OXL_OK || !report.exists) return rc;
        if (report.halt != HALT_NONE) return step_after_halt(t, report.halt);
        step_update_means(t, &t->deferred[0], &report.loss, report.skipped);
        t->deferred[0] = t->deferred[1];
        t->deferred_steps--;
    }
    return rc;
}

OXL_INTERNAL oxl_result step_flush(struct train *t)
{
    const oxl_result rc = step_read_reports(t, 1);
    renderer_defer(t->renderer, 0);
    return rc;
}

OXL_INTERNAL oxl_result step_download(struct train *t, enum renderer_download what)
{
    const oxl_result rc = step_flush(t);
    return rc == OXL_OK ? renderer_download(t->renderer, what) : rc;
}

OXL_INTERNAL oxl_result step_observe(struct train *t)
{
    if (t->deferred_steps > 0) t->deferred[t->deferred_steps - 1].observed = 1;
    return density_observe(t->ctx, &t->density, t->renderer, t->trained.model.count);
}

/* Repeats a step for which a device had not enough memory: it may have when the others have ended, or the CPU
 * continues. */
static oxl_result step_retry_after_flush(struct train *t, const struct train_deferred *here)
{
    oxl_result rc = step_flush(t);
    if (rc == OXL_OK) rc = step_load_image(t, here->view);
    return rc == OXL_OK ? step_on_view(t, here, 0) : rc;
}

static oxl_result step_deferred(struct train *t, const struct train_deferred *here)
{
    const oxl_result rc = step_on_view(t, here, 1);
    if (rc != OXL_OK) return rc;
    t->deferred[t->deferred_steps++] = *here;
    return step_read_reports(t, 0);
}

OXL_INTERNAL oxl_result step_on_next_view(struct train *t)
{
    const int deferred = renderer_defer(t->renderer, 1);
    int view = -1;
    struct train_deferred here;
    oxl_result rc = deferred ? OXL_OK : step_flush(t);
    if (rc == OXL_OK) rc = step_next_image(t, &view);
    if (rc != OXL_OK && view < 0) return rc;
    here = step_begin(t, view);
    if (rc == OXL_OK) rc = deferred ? step_deferred(t, &here) : step_on_view(t, &here, 0);
    return rc == OXL_ERR_MEMORY && deferred ? step_retry_after_flush(t, &here) : rc;
}

OXL_INTERNAL oxl_result step_move_rows(struct train *t, const struct density_change *change,
                                       const uint8_t *keep, int sh_degree, int *moved)
{
    const size_t count = t->trained.model.count + (change ? change->split - change->removed : 0);
    uint32_t *from = renderer_has_device(t->renderer) ? oxl_alloc(t->ctx, count + 1, sizeof *from) : NULL;
    struct renderer_move move = {.from = from, .sh_degree = sh_degree};
    oxl_result rc;
    if (renderer_has_device(t->renderer) && !from) return OXL_ERR_MEMORY;
    if (from && change)
        move.count = count, move.lobes = density_sources(&t->density, &t->trained.model, from);
    for (size_t i = 0; from && !change && i < count; i++)
        if (!keep || keep[i]) from[move.count++] = (uint32_t)i, move.lobes += i < t->trained.model.lobes;
    rc = renderer_move_rows(t->renderer, &move, moved);
    oxl_free(t->ctx, from);
    return rc;
}

OXL_INTERNAL oxl_result step_densify(struct train *t)
{
    const oxl_train_options *o = t->options;
    struct density_rules rules = {.gradient = schedule_densify_gradient(t->scene, o),
                                  .f_mid = 1,
                                  .f_far = 1,
                                  .extent = t->scene->extent,
                                  .split_large = t->step > schedule_reset_interval(o),
                                  .cap = schedule_gaussian_cap(t->scene, o),
                                  .terms = o->terms};
    struct density_change change = {0};
    int moved = 0;
    oxl_result rc = step_download(t, DOWNLOAD_SHAPE);
    PARTS_CALL(rc, k, before_density, t, t->part[k], &rules);
    if (rc == OXL_OK) rc = density_decide(t->ctx, &t->density, &t->trained.model, &rules, &change);
    if (rc == OXL_OK && change.removed + change.split > 0)
        rc = step_move_rows(t, &change, NULL, t->trained.model.sh_degree, &moved);
    if (rc == OXL_OK) rc = density_apply(t->ctx, &t->density, &t->trained, &change, moved);
    if (rc == OXL_OK && moved) rc = renderer_send_shape(t->renderer, &t->trained.model, 0);
    if (rc != OXL_OK) return rc;
    if (t->trained.model.count == 0)
        return oxl_fail(t->ctx, OXL_ERR_FAILED,
                        "step %d: no Gaussian is left\nfix: run oceanxl check, which examines cameras "
                        "and points%s",
                        t->step, o->terms ? ", or change oxl_terms.density" : "");
    return OXL_OK;
}

OXL_INTERNAL double step_seconds(const struct train *t)
{
    return t->seconds + os_seconds() - t->started;
}

OXL_INTERNAL int step_report(struct train *t)
{
    forecast_note_step(t);
    return context_report(t->callback, &(oxl_progress){.iteration = t->step,
                                                       .iterations = t->options->iterations,
                                                       .gaussians = t->trained.model.count,
                                                       .loss = t->loss,
                                                       .psnr = t->psnr,
                                                       .seconds = step_seconds(t),
                                                       .seconds_left = forecast_left(t),
                                                       .model = &t->trained.model,
                                                       .nonfinite = t->nonfinite});
}
