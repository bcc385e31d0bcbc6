/* step.c - the parts of one training step: forward, loss, backward, Adam; then density control and
 * pruning. */
#include "train_state.h"
#include "../core/vecmath.h"
#include "../survey/sparse.h"
#include "../survey/scene.h"

#define STEP_ORDER (UINT64_C(0x5649455753) << 24) /* random numbers of the views' order: "VIEWS" in ASCII */
#define STEP_DROPOUT (UINT64_C(0x44524f50) << 24) /* random numbers of dropout: "DROP" in ASCII */
/* views of the epoch looked at for images to read ahead: many may be in memory already */
#define STEP_READ_AHEAD 64
#define STEP_MSE_MIN 1e-10 /* 100 dB: PSNR of equal images in progress reports */
/* intervals: the quotient of a whole number of them may come out a little less */
#define STEP_ROUNDING 1e-6
/* of loss and PSNR in progress reports: about the last 50 views */
#define STEP_SMOOTHING 0.02

/* Fisher & Yates 1938: every epoch sees every view once, in an order of its own. */
static void step_shuffle(struct train *t, int epoch)
{
    for (int i = t->views - 1; i > 0; i--) {
        const int j = (int)(random_bits(t->ctx->options.seed ^ STEP_ORDER, (uint64_t)epoch, (uint64_t)i) %
                            (uint64_t)(i + 1));
        OXL_SWAP(int, t->view[i], t->view[j]);
    }
}

/* Whether the step is one of the run's first part, at half the sides. */
static int step_is_coarse(const struct train *t, const oxl_camera *camera)
{
    const double fraction = schedule_coarse_fraction(t->options, camera->width, camera->height);
    return t->step <= fraction * t->options->iterations && camera->width > 1 && camera->height > 1;
}

/* The part of a view that this step compares; NULL: all of it. */
static const struct image_window *step_window(const struct train *t, int view)
{
    return t->output && t->output->window ? &t->output->window[view] : NULL;
}

/* Of that part, at this step's resolution; the renderer gets the full image's size, too. */
static oxl_camera step_camera(struct train *t, int view)
{
    const struct image_window *w = step_window(t, view);
    oxl_camera camera = oxl_scene_view(t->scene, view)->camera;
    const int by = t->halved ? 2 : 1;
    const float at[2] = {w ? (float)w->x / (float)by : 0, w ? (float)w->y / (float)by : 0};
    renderer_set_window(t->renderer, at, w ? camera.width / by : 0, w ? camera.height / by : 0);
    if (w) {
        camera.width = w->width, camera.height = w->height;
        camera.cx -= w->x, camera.cy -= w->y;
    }
    return t->halved ? camera_halve(&camera) : camera;
}

/* Loads the image into target and weight on the host. */
static oxl_result step_load_image_on_host(struct train *t, int view)
{
    const struct training_image *image = scene_image(t->ctx, t->scene, view);
    const struct image_window *window = step_window(t, view);
    int width, height;
    oxl_result rc;
    size_t pixels;
    if (!image) return t->ctx->failed;
    width = window ? window->width : image->width;
    height = window ? window->height : image->height;
    pixels = (size_t)width * (size_t)height;
    rc = oxl_reserve(t->ctx, &t->target, &t->target_capacity, 3 * pixels, sizeof *t->target);
    t->masked = image->mask != NULL;
    if (rc == OXL_OK && t->masked)
        rc = oxl_reserve(t->ctx, &t->weight, &t->weight_capacity, pixels, sizeof *t->weight);
    if (rc != OXL_OK) return rc;
    image_from_training(t->ctx, image, window, t->target, t->masked ? t->weight : NULL);
    if (t->halved) image_halve(width, height, t->target, t->masked ? t->weight : NULL);
    return OXL_OK;
}

/* 1: the target is on the host, for transients and a lamp. */
static int step_loss_on_host(const struct train *t)
{
    return t->transients.points > 0 || t->lamp.on;
}

OXL_INTERNAL oxl_result step_load_image(struct train *t, int view)
{
    const struct image_window *window = step_window(t, view);
    const struct training_image *image;
    oxl_result rc = OXL_ERR_MEMORY;
    t->halved = step_is_coarse(t, &oxl_scene_view(t->scene, view)->camera);
    if (step_loss_on_host(t)) return step_load_image_on_host(t, view);
    if (renderer_has_image(t->renderer, view))
        rc = renderer_set_image(t->ctx, t->renderer, view, NULL, window, t->halved);
    if (rc != OXL_ERR_MEMORY) return rc; /* else the CPU continues, and needs the image */
    image = scene_image(t->ctx, t->scene, view);
    return image ? renderer_set_image(t->ctx, t->renderer, view, image, window, t->halved) : t->ctx->failed;
}

/* The next views of the epoch that a device does not hold. */
static void step_read_ahead(struct train *t, int slot)
{
    int view[STEP_READ_AHEAD], count = 0;
    for (int i = slot; i < t->views && count < STEP_READ_AHEAD; i++)
        if (!renderer_has_image(t->renderer, t->view[i])) view[count++] = t->view[i];
    if (count > 0 && view[0] == t->view[slot]) scene_images_ahead(t->ctx, t->scene, view, count);
}

/* The next view whose image can be read; one that cannot is named and left out from then on. */
static oxl_result step_next_image(struct train *t, int *view)
{
    while (t->views > 0) {
        const int step = t->step - 1 - (t->output ? t->output->first : 0), slot = step % t->views;
        oxl_result rc;
        if (slot == 0) step_shuffle(t, (t->step - 1) / t->views);
        *view = t->view[slot];
        step_read_ahead(t, slot);
        rc = step_load_image(t, *view);
        if (rc != OXL_ERR_INPUT) return rc;
        nonfinite_count_unreadable(t->ctx, &t->nonfinite);
        t->view[slot] = t->view[--t->views];
    }
    return oxl_fail(
        t->ctx, OXL_ERR_INPUT,
        "none of the training images can be read\nfix: oceanxl check looks at each and says what is wrong");
}

/* What the image has and the scene has not. */
static oxl_result step_mask_transients(struct train *t, const oxl_camera *camera)
{
    const size_t pixels = (size_t)camera->width * (size_t)camera->height;
    const float *rendered = NULL;
    oxl_result rc = oxl_reserve(t->ctx, &t->weight, &t->weight_capacity, pixels, sizeof *t->weight);
    if (rc == OXL_OK) rc = renderer_image(t->ctx, t->renderer, &rendered);
    if (rc == OXL_OK) {
        const struct transients_view view = {camera,   t->render.near_plane, rendered, t->target, t->weight,
                                             t->masked};
        rc = transients_mask(t->ctx, &t->transients, t->scene, &view, !t->trial_is_next);
    }
    t->masked = 1;
    return rc;
}

static void step_gain(const struct train *t, int view, float gain[3])
{
    if (t->exposure.of.on) imaging_gain(&t->exposure.of, view, gain);
}

/* The step that comes, on a view. */
static struct train_deferred step_begin(struct train *t, int view)
{
    struct train_deferred step = {.step = t->step, .view = view, .is_trial = t->trial_is_next != 0};
    exposure_apply_pending(&t->exposure, t->step - 2);
    step_gain(t, view, step.gain);
    return step;
}

OXL_INTERNAL struct imaging step_imaging(const struct train *t)
{
    struct imaging m = {.medium = medium_fit_value(&t->medium_fit)};
    lamp_store(&t->lamp, &m);
    return m;
}

/* Of the view's camera; NULL: none. */
static const struct lamp *step_lamp(const struct train *t, int view)
{
    const int which = t->lamp.on ? imaging_find_lamp(t->scene, t->lamp.group, t->lamp.groups, view) : -1;
    return which < 0 ? NULL : &t->lamp.group[which];
}

/* The model rendered from a view, times its gain, against its image as step_load_image has left it. */
static oxl_result step_forward_loss(struct train *t, int view, const float gain[3], int learns,
                                    struct renderer_loss *loss)
{
    const float ssim_weight = t->options->ssim_weight;
    const oxl_camera camera = step_camera(t, view);
    const struct imaging m = step_imaging(t);
    oxl_result rc;
    renderer_set_medium(t->renderer, &m.medium, learns && !t->medium_fit.fixed);
    renderer_set_lamp(t->renderer, step_lamp(t, view));
    if (learns)
        renderer_set_dropout(t->renderer, t->dropout * t->step / t->options->iterations,
                             STEP_DROPOUT ^ t->ctx->options.seed, t->step);
    rc = renderer_forward(t->ctx, t->renderer, &t->trained.model, &camera, &t->render);
    renderer_set_dropout(t->renderer, 0, 0, 0);
    renderer_set_gain(t->renderer, t->exposure.of.on ? gain : NULL);
    if (rc == OXL_OK && learns && t->transients.points > 0) rc = step_mask_transients(t, &camera);
    if (rc != OXL_OK) return rc;
    if (step_loss_on_host(t))
        return renderer_loss(t->ctx, t->renderer, t->target, t->masked ? t->weight : NULL, ssim_weight, loss);
    return renderer_loss(t->ctx, t->renderer, NULL, NULL, ssim_weight, loss);
}

/* Evaluation with the full loss. */
OXL_INTERNAL oxl_result step_loss_of_view(struct train *t, int view, struct renderer_loss *loss)
{
    float gain[3];
    step_gain(t, view, gain);
    return step_forward_loss(t, view, gain, 0, loss);
}

/* A loss that is not finite: the step is left out. */
static oxl_result step_skip(struct train *t, int step, int view)
{
    struct renderer_nonfinite cleared;
    oxl_result rc = OXL_OK;
    if (renderer_has_device(t->renderer))
        rc = renderer_clear_nonfinite(t->ctx, t->renderer, &t->trained, &cleared);
    else cleared = nonfinite_clear(t->renderer, &t->trained);
    if (rc != OXL_OK) return rc;
    nonfinite_of_view(t->ctx, &t->nonfinite, step, oxl_scene_view(t->scene, view)->name, cleared);
    /* later code must not read gradients of an earlier step */
    return renderer_clear_visible(t->ctx, t->renderer);
}

/* What is known of a step when it is done. */
static void step_update_means(struct train *t, const struct train_deferred *of,
                              const struct renderer_loss *loss, struct renderer_nonfinite skipped)
{
    const double psnr =
        -VECMATH_DECIBEL_OF_E * vecmath_log(loss->mse > STEP_MSE_MIN ? loss->mse : STEP_MSE_MIN);
    const double k = OXL_MAX(STEP_SMOOTHING, 1.0 / (of->step - (t->output ? t->output->first : 0)));
    const struct exposure_gradient gradient = {
        .step = of->step,
        .view = of->view,
        .progress = (double)of->step / t->options->iterations,
        .dlog_gain = {loss->dlog_gain[0], loss->dlog_gain[1], loss->dlog_gain[2]}};
    exposure_set_pending(&t->exposure, &gradient);
    if (!renderer_has_device(t->renderer)) exposure_apply_pending(&t->exposure, of->step);
    nonfinite_of_rows(t->ctx, &t->nonfinite, of->step, oxl_scene_view(t->scene, of->view)->name, skipped,
                      renderer_has_device(t->renderer) ? NULL : &t->trained);
    t->last_loss = loss->total;
    if (!of->is_trial) prune_observe(&t->prune, of->step, loss->l1);
    t->loss += k * (loss->total - t->loss);
    t->psnr += k * (psnr - t->psnr);
}

/* The tracks' depths of a view, at this step's window and resolution, for the backward pass. */
OXL_INTERNAL oxl_result step_set_depths(struct train *t, int view, double progress)
{
    const struct image_window *w = step_window(t, view);
    const float side = t->halved ? 0.5f : 1;
    struct depth_point point[DEPTH_POINTS];
    int count = 0;
    double weight;
    oxl_result rc = OXL_OK;
    if (!t->track_depth.started)
        rc = track_depth_begin(t->ctx, &t->track_depth, t->scene, t->output ? t->output->window : NULL);
    if (rc != OXL_OK) return rc;
    weight = track_depth_of_step(&t->track_depth, view, t->step, progress, &count, point);
    for (int i = 0; i < count; i++) {
        point[i].x = side * (point[i].x - (float)(w ? w->x : 0));
        point[i].y = side * (point[i].y - (float)(w ? w->y : 0));
    }
    renderer_set_depths(t->renderer, point, count, weight);
    return OXL_OK;
}

/* Forward, loss, backward, step. Deferred, they are only recorded: what becomes of them is in the step's
 * report. */
OXL_INTERNAL oxl_result step_on_view(struct train *t, const struct train_deferred *here, int deferred)
{
    const double progress = (double)t->step / t->options->iterations;
    const int view = here->view;
    const struct lamp *lamp = step_lamp(t, view);
    struct adam_params adam;
    struct renderer_loss loss;
    struct renderer_nonfinite skipped;
    oxl_result rc;
    if (!deferred) t->last_loss = NAN;
    t->render.alpha_min = schedule_alpha_min(t);
    rc = step_forward_loss(t, view, here->gain, 1, &loss);
    if (rc != OXL_OK) return rc;
    if (!deferred && !(loss.total <= DBL_MAX)) return step_skip(t, t->step, view);
    if (t->medium_fit.on) rc = step_set_depths(t, view, progress);
    if (rc == OXL_OK) rc = renderer_backward(t->ctx, t->renderer, NULL, NULL);
    if (rc != OXL_OK) return rc;
    adam = schedule_adam_params(t);
    rc = renderer_step(t->ctx, t->renderer, &t->trained, NULL, &adam, &skipped);
    if (rc != OXL_OK || deferred) return rc;
    if (t->medium_fit.on) medium_fit_step(&t->medium_fit, progress, renderer_medium_gradient(t->renderer));
    if (lamp)
        lamp_step(&t->lamp, lamp, progress, renderer_lamp_gradient(t->renderer),
                  renderer_medium_gradient(t->renderer)[MEDIUM_FALLOFF]);
    step_update_means(t, here, &loss, skipped);
    return OXL_OK;
}

/* ---------------- deferred steps: the device works while the host goes on */

/* Nothing between the passes is the host's. */
static int step_can_be_deferred(const struct train *t)
{
    return renderer_has_device(t->renderer) && !step_loss_on_host(t) && !t->medium_fit.on;
}

/* A deferred step that halted, or came behind one. */
static oxl_result step_repeat(struct train *t, const struct train_deferred *which)
{
    const int step = t->step, trial = t->trial_is_next;
    oxl_result rc;
    t->step = which->step;
    t->trial_is_next = which->is_trial ? OXL_MAX(trial, 1) : 0;
    rc = step_load_image(t, which->view);
    if (rc == OXL_OK) rc = step_on_view(t, which, 0);
    if (rc == OXL_OK && which->observed)
        rc = density_observe(t->ctx, t->density, t->renderer, t->trained.model.count);
    t->step = step;
    t->trial_is_next = trial;
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
        rc = renderer_report(t->ctx, t->renderer, wait, &report);
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
    return rc == OXL_OK ? renderer_download(t->ctx, t->renderer, what) : rc;
}

OXL_INTERNAL oxl_result step_observe(struct train *t)
{
    if (t->deferred_steps > 0) t->deferred[t->deferred_steps - 1].observed = 1;
    return density_observe(t->ctx, t->density, t->renderer, t->trained.model.count);
}

/* A step for which a device had not enough memory: it may have when the others have ended, or the CPU
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
    const int deferred = step_can_be_deferred(t) && renderer_defer(t->renderer, 1);
    int view = -1;
    struct train_deferred here;
    oxl_result rc = deferred ? OXL_OK : step_flush(t);
    if (rc == OXL_OK) rc = step_next_image(t, &view);
    if (rc != OXL_OK && view < 0) return rc;
    here = step_begin(t, view);
    if (rc == OXL_OK) rc = deferred ? step_deferred(t, &here) : step_on_view(t, &here, 0);
    return rc == OXL_ERR_MEMORY && deferred ? step_retry_after_flush(t, &here) : rc;
}

/* On a device: the rows that density control has decided on, or (change NULL) those that stay (keep NULL:
 * all), to a model of this degree. */
static oxl_result step_move_rows(struct train *t, const struct density_change *change, const uint8_t *keep,
                                 int sh_degree, int *moved)
{
    const size_t count = t->trained.model.count + (change ? change->split - change->removed : 0);
    uint32_t *from = renderer_has_device(t->renderer) ? oxl_alloc(t->ctx, count + 1, sizeof *from) : NULL;
    struct renderer_move move = {.from = from, .sh_degree = sh_degree};
    oxl_result rc;
    if (renderer_has_device(t->renderer) && !from)
        return oxl_fail(t->ctx, OXL_ERR_MEMORY, "no memory to move %zu Gaussians", count);
    if (from && change) move.count = count, move.lobes = density_sources(t->density, &t->trained.model, from);
    for (size_t i = 0; from && !change && i < count; i++)
        if (!keep || keep[i]) from[move.count++] = (uint32_t)i, move.lobes += i < t->trained.model.lobes;
    rc = renderer_move_rows(t->ctx, t->renderer, &move, moved);
    oxl_free(t->ctx, from);
    return rc;
}

OXL_INTERNAL oxl_result step_densify(struct train *t, const double f[2])
{
    const oxl_train_options *o = t->options;
    struct density_rules rules = {.gradient = o->densify_gradient,
                                  .f_mid = f[0],
                                  .f_far = f[1],
                                  .extent = oxl_scene_extent(t->scene),
                                  .split_large =
                                      o->opacity_reset_interval > 0 && t->step > schedule_reset_interval(o),
                                  .cap = schedule_gaussian_cap(t->scene, o)};
    struct density_change change = {0};
    uint8_t *carved = NULL;
    int moved = 0;
    oxl_result rc = step_download(t, DOWNLOAD_SHAPE);
    if (rc == OXL_OK) rc = free_space_carve(t->ctx, &t->free_space, &t->trained.model, &carved);
    rules.carved = carved;
    if (rc == OXL_OK) rc = density_decide(t->ctx, t->density, &t->trained.model, &rules, &change);
    oxl_free(t->ctx, carved);
    if (rc == OXL_OK && change.removed + change.split > 0)
        rc = step_move_rows(t, &change, NULL, t->trained.model.sh_degree, &moved);
    if (rc == OXL_OK) rc = density_apply(t->ctx, t->density, &t->trained, &change, moved);
    if (rc == OXL_OK && moved) rc = renderer_send_shape(t->ctx, t->renderer, &t->trained.model, 0);
    if (rc == OXL_OK && t->trained.model.count == 0) {
        rc =
            oxl_fail(t->ctx, OXL_ERR_FAILED,
                     "step %d: no Gaussian is left\nfix: oceanxl check looks at cameras and points", t->step);
    }
    if (rc != OXL_OK) return rc;
    oxl_log(t->ctx, OXL_LOG_DEBUG, "step %d: %zu split, %zu removed, %zu left", t->step, change.split,
            change.removed, t->trained.model.count);
    return OXL_OK;
}

/* Gaussians, with their moments and statistics. */
static oxl_result step_remove_rows(struct train *t, size_t drop)
{
    const struct prune_of of = {t->renderer, t->scene, &t->render, &t->trained.model};
    const size_t count = t->trained.model.count;
    uint8_t *keep = oxl_alloc(t->ctx, count, sizeof *keep);
    int moved = 0;
    oxl_result rc =
        keep ? OXL_OK : oxl_fail(t->ctx, OXL_ERR_MEMORY, "no memory to choose among %zu Gaussians", count);
    if (rc == OXL_OK) rc = step_flush(t);
    if (rc == OXL_OK) rc = prune_choose(t->ctx, &t->prune, &of, drop, keep);
    if (rc == OXL_OK) rc = step_download(t, DOWNLOAD_SHAPE);
    if (rc == OXL_OK) rc = step_move_rows(t, NULL, keep, t->trained.model.sh_degree, &moved);
    if (rc == OXL_OK) {
        for (int k = 0; k < TRAINED_PARTS; k++) model_keep_rows(model_trained_part(&t->trained, k), keep);
        density_keep_rows(t->density, keep, count);
    }
    if (rc == OXL_OK && moved) rc = renderer_send_shape(t->ctx, t->renderer, &t->trained.model, 0);
    oxl_free(t->ctx, keep);
    return rc;
}

/* Pruning, when it is due. validation_loss: mean loss of the validation views; only --keep auto reads it. */
OXL_INTERNAL oxl_result step_prune(struct train *t, double validation_loss)
{
    size_t drop;
    oxl_result rc;
    t->prune.row_bytes = prune_row_bytes(t->trained.model.sh_degree, t->options->dog != OXL_DOG_OFF);
    drop = prune_due(&t->prune, t->step, t->trained.model.count, validation_loss);
    if (drop == 0) return OXL_OK;
    rc = step_remove_rows(t, drop);
    if (rc == OXL_OK)
        oxl_log(t->ctx, OXL_LOG_INFO, "step %d: %zu Gaussians of the lowest score removed, %zu left", t->step,
                drop, t->trained.model.count);
    return rc;
}

/* Raises the SH degree by one after each sh_degree_interval of the run, up to t->sh_degree. */
OXL_INTERNAL oxl_result step_raise_sh_degree(struct train *t)
{
    const int wanted =
        OXL_MIN(t->sh_degree,
                (int)(t->step / (t->options->sh_degree_interval * t->options->iterations) + STEP_ROUNDING));
    int moved = 0;
    oxl_result rc = OXL_OK;
    if (wanted <= t->trained.model.sh_degree) return OXL_OK;
    rc = step_download(t, DOWNLOAD_SHAPE);
    if (rc == OXL_OK) rc = step_move_rows(t, NULL, NULL, wanted, &moved);
    if (rc == OXL_OK) rc = model_trained_set_degree(t->ctx, &t->trained, wanted);
    if (rc == OXL_OK && moved) rc = renderer_send_shape(t->ctx, t->renderer, &t->trained.model, 0);
    return rc;
}

OXL_INTERNAL double step_seconds(const struct train *t)
{
    return t->seconds + os_seconds() - t->started;
}

OXL_INTERNAL int step_report(const struct train *t, int trial)
{
    const oxl_callback *callback = t->callback;
    const double seconds = step_seconds(t), here = os_seconds() - t->started;
    oxl_progress progress = {.iteration = t->step,
                             .iterations = t->options->iterations,
                             .gaussians = t->trained.model.count,
                             .loss = t->loss,
                             .psnr = t->psnr,
                             .f_mid = t->ucd.on ? t->ucd.f[0] : 1,
                             .f_far = t->ucd.on ? t->ucd.f[1] : 1,
                             .seconds = seconds,
                             .seconds_left = here / OXL_MAX(1, t->step - t->first_step) *
                                             (t->options->iterations - t->step),
                             .model = &t->trained.model,
                             .nonfinite = t->nonfinite,
                             .trial = trial};
    return context_report(callback, &progress);
}
