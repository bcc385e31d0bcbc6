/* train.c - the loop: one photograph a step, drawn, compared, walked back, stepped (Kerbl et al. 2023, Alg. 1).
 *
 * Invariant: the state after step n is a function of the scene, the options, the seed and n alone.
 */
#include "train_state.h"
#include "../core/vecmath.h"

#define TRAIN_WARM_UP              500   /* iterations before the first densification, unless a quarter of the run is less */
#define TRAIN_RESET_LEAST          3000  /* iterations between opacity resets [Kerbl 2023] */
#define TRAIN_RESET_RECOVERY       1000  /* iterations that a model needs after a reset until its loss is what it was, */
#define TRAIN_RESET_RECOVERY_SHARE 0.025 /* and as a share of the run, for long ones */
#define TRAIN_PIXELS_EACH          60 /* training pixels for each Gaussian at least: it has up to 59 numbers, a pixel tells 3 (PAPER.md) */
#define TRAIN_RANDOM_POINTS        10000 /* to start from when the scene has none */
#define TRAIN_COARSE_SIDE          640 /* px: half the sides of smaller photographs cost more than they save (docs/TRADEOFF.md) */
#define TRAIN_COARSE_AUTO          0.25 /* of the run, for larger ones */
#define TRAIN_SHORT_RUN_WIDTH      0.3  /* powers of haste: what the first Gaussians' widths are divided by */
#define TRAIN_SHORT_RUN_OPACITY    0.7  /* and their opacities multiplied, */
#define TRAIN_OPACITY_MOST         0.3  /* up to this */
#define TRAIN_MOMENTUM_ITERATIONS \
    7000 /* iterations from which on Kerbl's momentum is the better one; not tried between 2000 and this */
#define TRAIN_BETA_LEAST           0.5     /* of the mean gradient */
#define TRAIN_BETA_MOST            0.99999 /* of the mean of its square: 1 less it, as floats, keeps three digits */
#define TRAIN_REFERENCE_ITERATIONS 30000   /* iterations that the rates were chosen for [Kerbl 2023] */
#define TRAIN_ORDER                (UINT64_C(0x5649455753) << 24) /* a random stream apart from density control's */
#define TRAIN_ALPHA_MIN_UNTIL      0.8                            /* of the run: until then alpha_min holds */
#define TRAIN_COOLDOWN_END         0.1                            /* times the usual steps at the end of a run */
#define TRAIN_AHEAD                64 /* views of the epoch looked at for photographs to read ahead: many may be in memory already */
#define TRAIN_SAVE_STEPS           500  /* a checkpoint after so many iterations, */
#define TRAIN_SAVE_SECONDS         60.0 /* or so long, whichever comes first */
#define TRAIN_SMOOTHING            0.02 /* of loss and PSNR in progress reports: about the last 50 views */

static double train_seconds(const struct train *t)
{
    return t->seconds + os_seconds() - t->begun;
}

/* ---------------------------------------------------------------- the schedule */

OXL_INTERNAL double train_short_run_factor(const oxl_train_options *o)
{
    return o->iterations < TRAIN_REFERENCE_ITERATIONS
               ? vecmath_exp(o->short_run_exponent * vecmath_log((double)TRAIN_REFERENCE_ITERATIONS / o->iterations))
               : 1;
}

/* The same for what helps runs below TRAIN_MOMENTUM_ITERATIONS alone: Adam's means, and scales once more (docs/TRADEOFF.md). */
static double train_momentum_factor(const oxl_train_options *o)
{
    return o->iterations < TRAIN_MOMENTUM_ITERATIONS
               ? vecmath_exp(o->short_run_exponent * vecmath_log((double)TRAIN_MOMENTUM_ITERATIONS / o->iterations))
               : 1;
}

OXL_INTERNAL float train_scale_rate(const oxl_train_options *o)
{
    return (float)(train_short_run_factor(o) * sqrt(train_momentum_factor(o)) * o->rate_log_scale);
}

/* 0 until the run settles, 1 at its end. */
static double train_cooldown(const struct train *t)
{
    const double left = 1 - (double)(t->step - 1) / OXL_MAX(1, t->options->iterations - 1);
    return left < t->options->cooldown ? 1 - left / t->options->cooldown : 0;
}

/* What viewers leave out in the run's last part, whether it settles or not. */
static float train_alpha_min(const struct train *t)
{
    return t->step <= TRAIN_ALPHA_MIN_UNTIL * t->options->iterations ? t->options->alpha_min : 0;
}

static struct adam_params train_adam_params(const struct train *t)
{
    const oxl_train_options *o                  = t->options;
    const double             short_run_exponent = train_short_run_factor(o), rush = train_momentum_factor(o);
    const double             progress = (double)(t->step - 1) / OXL_MAX(1, o->iterations - 1);
    const double             first = vecmath_log(o->rate_mean_first), last = vecmath_log(o->rate_mean_last);
    const float mean = (float)(short_run_exponent * vecmath_exp(first + (last - first) * progress) * oxl_scene_extent(t->scene));
    struct adam_params pace = {.beta = RENDERER_BETAS, .step = t->step};
    pace.beta[0]            = OXL_MAX(TRAIN_BETA_LEAST, 1 - (1 - pace.beta[0]) * rush * rush);
    pace.beta[1]            = OXL_MIN(TRAIN_BETA_MOST, 1 - (1 - pace.beta[1]) / (rush * sqrt(rush)));
    for (int k = 0; k < OXL_PLANES; k++)
        pace.rate[k] = k < OXL_LOG_SCALE  ? mean
                       : k < OXL_ROTATION ? train_scale_rate(o)
                       : k < OXL_OPACITY  ? (float)(short_run_exponent * o->rate_rotation)
                       : k < OXL_SH       ? o->rate_opacity
                       : k < OXL_SH + 3   ? o->rate_sh0
                       : k < OXL_LOBE     ? (float)(sqrt(short_run_exponent) * o->rate_sh)
                       : k == OXL_LOBE    ? MODEL_LOBE_RATE_OPACITY
                                          : MODEL_LOBE_RATE_SCALE;
    for (int k = 0; k < OXL_PLANES; k++) pace.rate[k] *= (float)vecmath_exp(train_cooldown(t) * vecmath_log(TRAIN_COOLDOWN_END));
    return pace;
}

/* 3DGS's schedule is one of 30 000 iterations. As shares of the run it shrinks with it, but not what has a time of its own: the first
 * photographs must be learned before gradients say where detail is missing, and a reset must be made up for. */
OXL_INTERNAL int train_densifies_at(const oxl_train_options *o, int step)
{
    const double from = OXL_MAX(o->densify_from * o->iterations, OXL_MIN(TRAIN_WARM_UP, 0.25 * o->iterations));
    return step >= from && step <= o->densify_until * o->iterations && step % o->densify_every == 0;
}

static int train_densifies(const struct train *t)
{
    return train_densifies_at(t->options, t->step);
}

static int train_reset_interval(const oxl_train_options *o)
{
    return (int)OXL_MAX(TRAIN_RESET_LEAST, o->reset_opacity_every * o->iterations);
}

/* None so late that density control ends, and pruning takes its scores, before opacities have recovered. */
OXL_INTERNAL int train_resets_opacity_at(const oxl_train_options *o, int step)
{
    const double recovery = OXL_MAX(TRAIN_RESET_RECOVERY, TRAIN_RESET_RECOVERY_SHARE * o->iterations);
    return o->reset_opacity_every > 0 && step + recovery <= o->densify_until * o->iterations &&
           step % train_reset_interval(o) == 0;
}

/* Fisher & Yates 1938: every epoch sees every view once, in an order of its own. */
static void train_shuffle(struct train *t, int epoch)
{
    for (int i = t->views - 1; i > 0; i--) {
        const int j = (int)(random_bits(t->ctx->options.seed ^ TRAIN_ORDER, (uint64_t)epoch, (uint64_t)i) % (uint64_t)(i + 1));
        OXL_SWAP(int, t->view[i], t->view[j]);
    }
}

/* ---------------------------------------------------------------- one photograph */

OXL_INTERNAL double train_coarse_share(const oxl_train_options *o, int width, int height)
{
    if (o->coarse >= 0) return o->coarse;
    return OXL_MAX(width, height) >= TRAIN_COARSE_SIDE ? TRAIN_COARSE_AUTO : 0;
}

/* Whether the step is one of the run's first share, at half the sides. */
static int train_is_coarse(const struct train *t, const oxl_camera *camera)
{
    const double share = train_coarse_share(t->options, camera->width, camera->height);
    return t->step <= share * t->options->iterations && camera->width > 1 && camera->height > 1;
}

/* Into target and weight: where some of its pixels are put aside, the host looks at them itself. */
static oxl_result train_load_image_on_host(struct train *t, int view)
{
    const struct training_image *photo = image_cache_get(t->ctx, t->scene, view);
    oxl_result                   rc;
    size_t                       pixels;
    if (!photo) return t->ctx->failed;
    pixels    = (size_t)photo->width * (size_t)photo->height;
    rc        = oxl_reserve(t->ctx, (void **)&t->target, &t->target_capacity, 3 * pixels, sizeof *t->target);
    t->masked = photo->mask != NULL;
    if (rc == OXL_OK && t->masked) rc = oxl_reserve(t->ctx, (void **)&t->weight, &t->weight_capacity, pixels, sizeof *t->weight);
    if (rc != OXL_OK) return rc;
    image_from_training(t->ctx, photo, t->target, t->masked ? t->weight : NULL);
    if (t->halved) image_halve(photo->width, photo->height, t->target, t->masked ? t->weight : NULL);
    return OXL_OK;
}

/* The target lies with the host: for what is put aside, and for gains. */
static int train_compares_itself(const struct train *t)
{
    return t->robust.points > 0 || t->exposure.of.on || exposure_watches(&t->exposure);
}

OXL_INTERNAL oxl_result train_load_image(struct train *t, int view)
{
    const struct training_image *photo = NULL;
    t->halved                          = train_is_coarse(t, &oxl_scene_view(t->scene, view)->camera);
    if (train_compares_itself(t)) return train_load_image_on_host(t, view);
    if (!renderer_has_image(t->renderer, view) && !(photo = image_cache_get(t->ctx, t->scene, view))) return t->ctx->failed;
    return renderer_take_image(t->ctx, t->renderer, view, photo, t->halved);
}

/* From a place in the epoch on, those that a device does not hold. */
static void train_read_ahead(struct train *t, int slot)
{
    int view[TRAIN_AHEAD], count = 0;
    for (int i = slot; i < t->views && count < TRAIN_AHEAD; i++)
        if (!renderer_has_image(t->renderer, t->view[i])) view[count++] = t->view[i];
    if (count > 0 && view[0] == t->view[slot]) image_cache_ahead(t->ctx, t->scene, view, count);
}

/* The next view whose photograph can be read; one that cannot is named and left out from then on. */
static oxl_result train_next_image(struct train *t, int *view)
{
    while (t->views > 0) {
        const int  slot = (t->step - 1) % t->views;
        oxl_result rc;
        if (slot == 0) train_shuffle(t, (t->step - 1) / t->views);
        *view = t->view[slot];
        train_read_ahead(t, slot);
        rc = train_load_image(t, *view);
        if (rc != OXL_ERR_INPUT) return rc;
        nonfinite_of_photo(t->ctx, &t->faults);
        t->view[slot] = t->view[--t->views];
    }
    return oxl_fail(t->ctx, OXL_ERR_INPUT,
                    "none of the training photographs can be read\nfix: oceanxl check looks at each and says what is wrong");
}

/* What the photograph has and the scene has not. */
static oxl_result train_mask_transients(struct train *t, const oxl_camera *camera)
{
    const size_t pixels = (size_t)camera->width * (size_t)camera->height;
    const float *drawn  = NULL;
    oxl_result   rc     = oxl_reserve(t->ctx, (void **)&t->weight, &t->weight_capacity, pixels, sizeof *t->weight);
    const int    masked = t->masked;
    t->masked           = 1;
    if (rc == OXL_OK) rc = renderer_image(t->ctx, t->renderer, &drawn);
    if (rc != OXL_OK) return rc;
    return transients_weigh(t->ctx, &t->robust, t->scene, camera, t->render.near_plane, drawn, t->target, !t->trial_is_next,
                            masked, t->weight);
}

static void train_set_gain(struct train *t, int view)
{
    float gain[3];
    if (t->exposure.of.on) imaging_gain(&t->exposure.of, view, gain);
    renderer_set_gain(t->renderer, t->exposure.of.on ? gain : NULL);
}

/* Gains that are not decided about yet: what this image would need. */
static oxl_result train_watch(struct train *t, int view, const oxl_camera *camera)
{
    const float     *drawn = NULL;
    const oxl_result rc    = renderer_image(t->ctx, t->renderer, &drawn);
    if (rc == OXL_OK)
        exposure_watch(&t->exposure, view, drawn, t->target, t->masked ? t->weight : NULL,
                       (size_t)camera->width * (size_t)camera->height);
    return rc;
}

/* The model drawn from a view, against its photograph as train_load_image has left it. */
static oxl_result train_compare(struct train *t, int view, int learns, float ssim_weight, struct renderer_loss *loss)
{
    const oxl_camera   *whole  = &oxl_scene_view(t->scene, view)->camera;
    const oxl_camera    camera = t->halved ? camera_halve(whole) : *whole;
    const struct medium medium = water_medium(&t->water);
    oxl_result          rc;
    renderer_set_medium(t->renderer, &medium);
    rc = renderer_forward(t->ctx, t->renderer, t->model, &camera, &t->render);
    train_set_gain(t, view);
    if (rc == OXL_OK && learns && t->robust.points > 0) rc = train_mask_transients(t, &camera);
    if (rc == OXL_OK && learns && exposure_watches(&t->exposure)) rc = train_watch(t, view, &camera);
    if (rc != OXL_OK) return rc;
    if (train_compares_itself(t))
        return renderer_loss(t->ctx, t->renderer, t->target, t->masked ? t->weight : NULL, ssim_weight, loss);
    return renderer_loss(t->ctx, t->renderer, NULL, NULL, ssim_weight, loss);
}

/* With the whole loss, for judgement. */
OXL_INTERNAL oxl_result train_compare_view(struct train *t, int view, struct renderer_loss *loss)
{
    return train_compare(t, view, 0, t->options->ssim_weight, loss);
}

/* Forward, loss, backward, step. */
static oxl_result train_on_view(struct train *t, int view)
{
    const char               *name = oxl_scene_view(t->scene, view)->name;
    struct adam_params        pace;
    struct renderer_loss      loss;
    struct renderer_nonfinite aside;
    oxl_result                rc;
    t->last_loss        = NAN;
    t->render.alpha_min = train_alpha_min(t);
    rc                  = train_compare(t, view, 1, t->options->ssim_weight, &loss);
    if (rc != OXL_OK) return rc;
    if (!(loss.total <= DBL_MAX)) {
        rc = renderer_download(t->ctx, t->renderer);
        if (rc == OXL_OK) rc = renderer_download_rows(t->ctx, t->renderer);
        if (rc != OXL_OK) return rc;
        nonfinite_of_view(t->ctx, &t->faults, t->step, name, t->renderer, t->model, &t->first, &t->second);
        return renderer_forget(t->ctx, t->renderer); /* what follows a step must not read the gradients of an earlier one */
    }
    if (t->exposure.of.on)
        exposure_step(&t->exposure, view, (double)t->step / t->options->iterations, renderer_gain_gradient(t->renderer));
    rc = renderer_backward(t->ctx, t->renderer, NULL, &t->gradient);
    if (rc != OXL_OK) return rc;
    if (t->water.on) water_step(&t->water, (double)t->step / t->options->iterations, renderer_medium_gradient(t->renderer));
    pace = train_adam_params(t);
    rc   = renderer_step(t->ctx, t->renderer, t->model, &t->gradient, &t->first, &t->second, &pace, &aside);
    if (rc == OXL_OK && aside.rows > 0) rc = renderer_download(t->ctx, t->renderer);
    if (rc != OXL_OK) return rc;
    nonfinite_of_rows(t->ctx, &t->faults, t->step, name, aside, t->model, &t->first, &t->second);
    {
        const double psnr = -4.342944819032518 * vecmath_log(loss.mse > 1e-10 ? loss.mse : 1e-10);
        const double k    = OXL_MAX(TRAIN_SMOOTHING, 1.0 / t->step);
        t->last_loss      = loss.total;
        if (!t->trial_is_next) prune_observe(&t->prune, t->step, loss.l1);
        t->loss += k * (loss.total - t->loss);
        t->psnr += k * (psnr - t->psnr);
    }
    return OXL_OK;
}

/* ---------------------------------------------------------------- how many Gaussians */

OXL_INTERNAL double train_pixels(const oxl_scene *scene)
{
    double pixels = 0;
    for (int i = 0; i < oxl_scene_view_count(scene); i++) {
        const oxl_view *view = oxl_scene_view(scene, i);
        if (!view->is_test) pixels += (double)view->camera.width * view->camera.height;
    }
    return pixels;
}

/* More Gaussians than the photographs can determine learn the photographs by heart. Never below the number of points. */
OXL_INTERNAL size_t train_cap_of(size_t points, double pixels, const oxl_train_options *options)
{
    if (options->max_gaussians > 0) return (size_t)options->max_gaussians;
    return OXL_MAX(points, (size_t)(pixels / TRAIN_PIXELS_EACH));
}

OXL_INTERNAL size_t train_cap(const oxl_scene *scene, const oxl_train_options *options)
{
    return train_cap_of(oxl_scene_point_count(scene), train_pixels(scene), options);
}

OXL_INTERNAL oxl_result train_resize(struct train *t)
{
    oxl_result rc;
    oxl_model_free(t->ctx, &t->gradient);
    rc = oxl_model_create(t->ctx, t->model->count, t->model->sh_degree, &t->gradient);
    return rc == OXL_OK ? model_set_lobes(t->ctx, &t->gradient, t->model->lobes) : rc;
}

OXL_INTERNAL oxl_result train_densify(struct train *t, const double f[2])
{
    const oxl_train_options *o     = t->options;
    struct density_rules     rules = {.gradient    = o->densify_gradient,
                                      .f_mid       = f[0],
                                      .f_far       = f[1],
                                      .extent      = oxl_scene_extent(t->scene),
                                      .split_large = o->reset_opacity_every > 0 && t->step > train_reset_interval(o),
                                      .cap         = train_cap(t->scene, o),
                                      .seed        = t->ctx->options.seed,
                                      .step        = t->step};
    struct density_change    change;
    oxl_result               rc;
    rc = renderer_download(t->ctx, t->renderer);
    if (rc == OXL_OK) rc = density_control(t->ctx, t->density, t->model, &t->first, &t->second, &rules, &change);
    if (rc == OXL_OK) rc = train_resize(t);
    if (rc == OXL_OK && t->model->count == 0) {
        rc = oxl_fail(t->ctx, OXL_ERR_FAILED, "step %d: no Gaussian is left\nfix: look at the cameras and points with: oxl check",
                      t->step);
    }
    if (rc != OXL_OK) return rc;
    oxl_log(t->ctx, OXL_LOG_DEBUG, "step %d: %zu cloned, %zu split, %zu removed, %zu left", t->step, change.cloned, change.split,
            change.removed, t->model->count);
    return OXL_OK;
}

static oxl_result train_density(struct train *t)
{
    oxl_result rc = OXL_OK;
    if (t->step > t->options->densify_until * t->options->iterations) return OXL_OK;
    rc = density_observe(t->ctx, t->density, t->renderer, t->model->count);
    if (rc == OXL_OK && train_densifies(t)) {
        if (!t->trial_is_next && selection_tries_weights(t)) t->trial_is_next = TRAIN_TRIES_WEIGHTS;
        else rc = train_densify(t, t->ucd.f);
        t->ucd.densified++;
    }
    if (rc == OXL_OK && train_resets_opacity_at(t->options, t->step)) rc = renderer_download(t->ctx, t->renderer);
    if (rc == OXL_OK && train_resets_opacity_at(t->options, t->step))
        density_reset_opacity(t->model, &t->first, &t->second, t->render.alpha_min);
    return rc;
}

/* ---------------------------------------------------------------- pruning */

/* Gaussians, with their moments and statistics. */
static oxl_result train_drop(struct train *t, size_t drop)
{
    const size_t count = t->model->count;
    uint8_t     *keep  = oxl_alloc(t->ctx, count, sizeof *keep);
    oxl_result   rc    = keep ? OXL_OK : oxl_fail(t->ctx, OXL_ERR_MEMORY, "no memory to choose among %zu Gaussians", count);
    if (rc == OXL_OK) rc = prune_choose(t->ctx, &t->prune, drop, t->renderer, t->scene, &t->render, t->model, keep);
    if (rc == OXL_OK) rc = renderer_download(t->ctx, t->renderer);
    if (rc == OXL_OK) {
        model_keep_rows(t->model, keep);
        model_keep_rows(&t->first, keep);
        model_keep_rows(&t->second, keep);
        density_keep_rows(t->density, keep, count);
        rc = train_resize(t);
    }
    oxl_free(t->ctx, keep);
    return rc;
}

static oxl_result train_prune(struct train *t)
{
    double     held = NAN, psnr;
    size_t     drop;
    oxl_result rc = OXL_OK;
    if (!prune_checks(&t->prune, t->step)) return OXL_OK;
    if (t->options->keep.kind == OXL_KEEP_AUTO && t->held_views > 0) rc = selection_judge(t, &held, &psnr);
    if (rc != OXL_OK) return rc;
    t->prune.row_bytes = prune_row_bytes(t->model->sh_degree, t->options->dog != OXL_DOG_OFF);
    drop               = prune_due(&t->prune, t->step, t->model->count, held);
    if (drop == 0) return OXL_OK;
    rc = train_drop(t, drop);
    if (rc == OXL_OK)
        oxl_log(t->ctx, OXL_LOG_INFO, "step %d: the %zu Gaussians that matter least are dropped, %zu are left", t->step, drop,
                t->model->count);
    return rc;
}

/* ---------------------------------------------------------------- bands of spherical harmonics */

/* One more SH band each such share of the run, up to the degree that it is to have. */
static oxl_result train_raise_sh_degree(struct train *t)
{
    const int  wanted = OXL_MIN(t->sh_degree, (int)(t->step / (t->options->sh_degree_interval * t->options->iterations) + 1e-6));
    oxl_result rc     = OXL_OK;
    if (wanted <= t->model->sh_degree) return OXL_OK;
    rc = renderer_download(t->ctx, t->renderer);
    if (rc == OXL_OK) rc = model_set_degree(t->ctx, t->model, wanted);
    if (rc == OXL_OK) rc = model_set_degree(t->ctx, &t->first, wanted);
    if (rc == OXL_OK) rc = model_set_degree(t->ctx, &t->second, wanted);
    return rc == OXL_OK ? train_resize(t) : rc;
}

/* ---------------------------------------------------------------- the run */

/* From points taken evenly from the file's order, when there may not be one for each. */
static oxl_result train_first_of_some(struct train *t, const oxl_point *points, size_t count)
{
    const size_t most = (size_t)t->options->max_gaussians;
    oxl_point   *some = oxl_alloc(t->ctx, most, sizeof *some);
    oxl_result   rc;
    if (!some) return oxl_fail(t->ctx, OXL_ERR_MEMORY, "no memory for %zu points", most);
    for (size_t i = 0; i < most; i++) some[i] = points[(size_t)((double)i * (double)count / (double)most)];
    oxl_log(t->ctx, OXL_LOG_WARNING, "only %zu Gaussians are allowed, so training starts from that many of the %zu points", most,
            count);
    rc = oxl_model_from_points(t->ctx, some, most, 0, t->model);
    oxl_free(t->ctx, some);
    return rc;
}

/* A run in haste starts with what others take time to learn: Gaussians narrower and more opaque than Kerbl's. */
static void train_sharpen_start(struct train *t)
{
    const double short_run_exponent = train_short_run_factor(t->options),
                 narrower           = TRAIN_SHORT_RUN_WIDTH * vecmath_log(short_run_exponent);
    const double opacity =
        OXL_MIN(MODEL_OPACITY * vecmath_exp(TRAIN_SHORT_RUN_OPACITY * vecmath_log(short_run_exponent)), TRAIN_OPACITY_MOST);
    if (!(short_run_exponent > 1)) return;
    for (size_t i = 0; i < t->model->count; i++) {
        for (int a = 0; a < 3; a++) t->model->plane[OXL_LOG_SCALE + a][i] -= (float)narrower;
        t->model->plane[OXL_OPACITY][i] = (float)vecmath_logit(opacity);
    }
}

/* One Gaussian a point; without points, random ones in front of the cameras. */
static oxl_result train_fresh_model(struct train *t)
{
    const oxl_point *points = oxl_scene_points(t->scene);
    const size_t     count  = oxl_scene_point_count(t->scene);
    oxl_point       *random = NULL;
    oxl_result       rc;
    if (count > 0 && t->options->max_gaussians > 0 && count > (size_t)t->options->max_gaussians)
        return train_first_of_some(t, points, count);
    if (count > 0) return oxl_model_from_points(t->ctx, points, count, 0, t->model);
    oxl_log(t->ctx, OXL_LOG_WARNING, "the scene has no points; training starts from %d random ones", TRAIN_RANDOM_POINTS);
    rc = scene_random_points(t->ctx, t->scene, TRAIN_RANDOM_POINTS, &random);
    if (rc == OXL_OK) rc = oxl_model_from_points(t->ctx, random, TRAIN_RANDOM_POINTS, 0, t->model);
    oxl_free(t->ctx, random);
    return rc;
}

/* Or a model that is there already. */
static oxl_result train_first_model(struct train *t)
{
    oxl_result rc;
    if (t->place && t->place->start) return model_copy(t->ctx, t->place->start, t->model);
    rc = train_fresh_model(t);
    if (rc == OXL_OK) train_sharpen_start(t);
    return rc;
}

OXL_INTERNAL int train_densifications(const oxl_train_options *options)
{
    int count = 0;
    for (int step = 1; step <= options->iterations; step++) count += train_densifies_at(options, step);
    return count;
}

OXL_INTERNAL int train_may_try(const oxl_train_options *o)
{
    return o->sh_degree < 0 || o->dog == OXL_DOG_AUTO ||
           (o->ucd.mode != OXL_UCD_OFF && o->ucd.learn && train_densifications(o) >= UCD_DENSIFICATIONS);
}

OXL_INTERNAL int train_training_views(const oxl_scene *scene)
{
    int views = 0;
    for (int i = 0; i < oxl_scene_view_count(scene); i++) views += !oxl_scene_view(scene, i)->is_test;
    return views;
}

/* What decides about the number of Gaussians, and on what evidence. */
static oxl_result train_begin_control(struct train *t)
{
    const oxl_train_options *o     = t->options;
    const int                until = (int)(o->densify_until * o->iterations), views = train_training_views(t->scene);
    char                     words[320];
    oxl_result               rc = ucd_begin(t->ctx, &t->ucd, t->scene, &o->ucd, train_densifications(o));
    if (rc != OXL_OK) return rc;
    ucd_describe(&t->ucd, words, sizeof words);
    if (o->ucd.mode != OXL_UCD_OFF) oxl_log(t->ctx, OXL_LOG_INFO, "%s", words);
    if (t->ucd.on) rc = density_set_bands(t->ctx, t->density, t->model->count, t->ucd.z_near, t->ucd.z_far);
    prune_begin(&t->prune, o->keep, o->iterations, until, views, prune_row_bytes(3, o->dog != OXL_DOG_OFF));
    return rc;
}

static oxl_result train_begin(struct train *t)
{
    oxl_context *ctx = t->ctx;
    oxl_result   rc  = train_first_model(t);
    if (rc != OXL_OK) return rc;
    memcpy(t->model->origin, oxl_scene_origin(t->scene), sizeof t->model->origin);
    t->render            = oxl_render_options_default();
    t->render.near_plane = (float)scene_near_plane(t->scene);
    memcpy(t->render.background, t->options->background, sizeof t->render.background);
    rc = oxl_model_create(ctx, t->model->count, t->model->sh_degree, &t->first);
    if (rc == OXL_OK) rc = oxl_model_create(ctx, t->model->count, t->model->sh_degree, &t->second);
    if (rc == OXL_OK) rc = model_set_lobes(ctx, &t->first, t->model->lobes);
    if (rc == OXL_OK) rc = model_set_lobes(ctx, &t->second, t->model->lobes);
    if (rc == OXL_OK) rc = train_resize(t);
    if (rc == OXL_OK) rc = renderer_create(ctx, &t->renderer);
    if (rc == OXL_OK) rc = density_create(ctx, &t->density);
    if (rc == OXL_OK) rc = density_clear(ctx, t->density, t->model->count);
    if (rc != OXL_OK) return rc;
    memset(t->first.plane[OXL_ROTATION], 0, t->first.capacity * sizeof(float));
    memset(t->second.plane[OXL_ROTATION], 0, t->second.capacity * sizeof(float));
    rc = train_begin_control(t);
    if (rc == OXL_OK) rc = transients_begin(ctx, &t->robust, t->scene, t->options->robust);
    if (rc == OXL_OK) rc = exposure_begin(ctx, &t->exposure, t->scene, t->options->exposure, t->place && t->place->start);
    if (rc == OXL_OK && t->options->medium)
        rc = water_begin(ctx, &t->water, t->scene, t->place && t->place->start ? &scene_imaging(t->scene)->medium : NULL);
    return rc == OXL_OK ? selection_begin(t) : rc;
}

static void train_end(struct train *t)
{
    oxl_context *ctx = t->ctx;
    oxl_model_free(ctx, &t->first);
    oxl_model_free(ctx, &t->second);
    oxl_model_free(ctx, &t->gradient);
    renderer_free(ctx, t->renderer);
    density_free(ctx, t->density);
    transients_free(ctx, &t->robust);
    exposure_free(ctx, &t->exposure);
    oxl_free(ctx, t->target);
    oxl_free(ctx, t->weight);
    oxl_free(ctx, t->view);
    oxl_free(ctx, t->held);
    text_free(&t->decisions);
}

/* ---------------------------------------------------------------- checkpoints */

static int train_alike(const oxl_model *a, const oxl_model *b)
{
    return a->count == b->count && a->sh_degree == b->sh_degree && a->lobes == b->lobes;
}

/* Means of squares are not negative. */
static int train_are_squares(const oxl_model *second)
{
    for (int k = 0; k < OXL_PLANES; k++)
        for (size_t i = 0; second->plane[k] && i < (k < OXL_LOBE ? second->count : second->lobes); i++)
            if (!(second->plane[k][i] >= 0)) return 0;
    return 1;
}

/* All that the steps to come depend on; the gradient is made anew in each. */
static void train_archive(struct archive *a, void *user)
{
    struct train *t     = user;
    size_t        views = (size_t)t->views;
    double        spent = train_seconds(t);
    archive_int(a, &t->step);
    archive_doubles(a, &t->loss, 1);
    archive_doubles(a, &t->psnr, 1);
    archive_doubles(a, &spent, 1);
    nonfinite_archive(a, &t->faults);
    archive_size(a, &views);
    archive_expect(a, t->step >= 0 && t->step <= t->options->iterations);
    archive_expect(a, views <= (size_t)train_training_views(t->scene));
    if (a->rc == OXL_OK) archive_ints(a, t->view, views);
    for (size_t i = 0; i < views && a->rc == OXL_OK; i++)
        archive_expect(a, t->view[i] >= 0 && t->view[i] < oxl_scene_view_count(t->scene));
    archive_model(a, t->model);
    archive_model(a, &t->first);
    archive_model(a, &t->second);
    archive_expect(a, t->model->count > 0 && train_alike(t->model, &t->first) && train_alike(t->model, &t->second));
    if (a->reading && a->rc == OXL_OK) archive_expect(a, train_are_squares(&t->second));
    density_archive(a, t->density, t->model->count);
    ucd_archive(a, &t->ucd);
    prune_archive(a, &t->prune);
    transients_archive(a, &t->robust);
    exposure_archive(a, &t->exposure);
    water_archive(a, &t->water, t->options->medium);
    selection_archive(a, t);
    archive_expect(a,
                   views + (size_t)t->held_views <= (size_t)train_training_views(t->scene)); /* those held come back to `view` */
    archive_text(a, t->place->log);
    archive_text(a, t->place->notes);
    if (!a->reading || a->rc != OXL_OK) return;
    t->views   = (int)views;
    t->seconds = spent;
    a->rc      = train_resize(t);
}

static oxl_result train_save(struct train *t)
{
    const oxl_result rc = renderer_download(t->ctx, t->renderer);
    t->saved_step       = t->step;
    t->saved_at         = os_seconds();
    if (rc != OXL_OK || !t->place) return rc;
    return checkpoint_write(t->ctx, t->place->folder, t->place->key, train_archive, t);
}

static int train_save_is_due(const struct train *t)
{
    return t->place && t->step < t->options->iterations &&
           (t->step - t->saved_step >= TRAIN_SAVE_STEPS || os_seconds() - t->saved_at >= TRAIN_SAVE_SECONDS);
}

static oxl_result train_resume(struct train *t)
{
    int        found = 0;
    oxl_result rc    = OXL_OK;
    t->saved_at      = t->begun;
    if (t->place) rc = checkpoint_read(t->ctx, t->place->folder, t->place->key, train_archive, t, &found);
    if (rc == OXL_OK && found) oxl_log(t->ctx, OXL_LOG_INFO, "going on after iteration %d", t->step);
    t->saved_step = t->step;
    return rc;
}

/* ---------------------------------------------------------------- the loop */

OXL_INTERNAL int train_report(const struct train *t, int trial)
{
    const oxl_callback *callback = t->callback;
    const double        seconds = train_seconds(t), here = os_seconds() - t->begun;
    oxl_progress        progress = {.iteration    = t->step,
                                    .iterations   = t->options->iterations,
                                    .gaussians    = t->model->count,
                                    .loss         = t->loss,
                                    .psnr         = t->psnr,
                                    .f_mid        = t->ucd.on ? t->ucd.f[0] : 1,
                                    .f_far        = t->ucd.on ? t->ucd.f[1] : 1,
                                    .seconds      = seconds,
                                    .seconds_left = here / OXL_MAX(1, t->step - t->first_step) * (t->options->iterations - t->step),
                                    .model        = t->model,
                                    .faults       = t->faults,
                                    .trial        = trial};
    return callback && callback->progress && callback->progress(callback->user, &progress);
}

OXL_INTERNAL oxl_result train_on_next_view(struct train *t)
{
    int        view = -1;
    oxl_result rc   = train_next_image(t, &view);
    return rc == OXL_OK ? train_on_view(t, view) : rc;
}

OXL_INTERNAL oxl_result train_step(struct train *t)
{
    oxl_result rc = train_raise_sh_degree(t);
    if (rc == OXL_OK) rc = train_on_next_view(t);
    if (rc == OXL_OK) rc = train_density(t);
    if (rc == OXL_OK) rc = selection_lobes(t); /* it reads the step's statistics, a row each: before rows go */
    if (rc == OXL_OK) rc = train_prune(t);
    if (rc == OXL_OK) rc = selection_exposure(t);
    if (rc == OXL_OK && t->step == water_starts_at(t->options) && !t->water.on && !(t->place && t->place->start)) {
        rc = renderer_download(t->ctx, t->renderer);
        if (rc == OXL_OK) water_start(&t->water, t->model);
    }
    if (rc == OXL_OK) selection_sh_degree(t);
    return rc;
}

OXL_INTERNAL oxl_result train_check(oxl_context *ctx, const oxl_train_options *o)
{
    if (o->dog != OXL_DOG_OFF && !(o->dog_from > o->densify_until && o->dog_from <= 1))
        return oxl_fail(ctx, OXL_ERR_USAGE,
                        "second lobes from %g of the run: wanted more than %g, the end of density control, and at most 1\n"
                        "fix: rows with a second lobe cannot be cloned or split; give lobes later or end density control earlier",
                        o->dog_from, o->densify_until);
    return oxl_train_options_check(ctx, o);
}

/* Whatever ends the loop early, the state is saved: an order to stop, the time allowed. */
static oxl_result train_stop(struct train *t)
{
    const oxl_result rc = train_save(t);
    return rc == OXL_OK ? OXL_ERR_INTERRUPTED : rc;
}

static oxl_result train_loop(struct train *t)
{
    const oxl_train_options *o  = t->options;
    oxl_result               rc = OXL_OK;
    t->first_step               = t->step;
    if (t->step > 0 && train_report(t, 0)) return OXL_ERR_INTERRUPTED;
    while (rc == OXL_OK && t->step < o->iterations) {
        if (t->trial_is_next) {
            rc = selection_trial(t);
            if (rc == OXL_ERR_INTERRUPTED || (rc == OXL_OK && train_report(t, 0))) return train_stop(t);
            continue;
        }
        t->step++;
        rc = train_step(t);
        if (rc != OXL_OK) break;
        if (train_report(t, 0)) return train_stop(t);
        if (o->max_seconds > 0 && os_seconds() - t->begun > o->max_seconds && t->step < o->iterations) {
            oxl_log(t->ctx, OXL_LOG_INFO, "stopped after %d of %d iterations: the time allowed is over", t->step, o->iterations);
            return train_save(t);
        }
        if (train_save_is_due(t)) rc = train_save(t);
    }
    if (rc == OXL_OK) rc = renderer_download(t->ctx, t->renderer);
    if (rc == OXL_OK) selection_end(t);
    if (rc == OXL_OK && t->robust.points > 0) {
        char words[160];
        transients_describe(&t->robust, words, sizeof words);
        oxl_log(t->ctx, OXL_LOG_INFO, "%s", words);
    }
    return rc;
}

/* The gains belong to the scene's images: who evaluates or renders finds them there. */
static void train_leave_gains(struct train *t)
{
    struct imaging *to = scene_imaging(t->scene);
    imaging_free(t->ctx, to);
    *to            = t->exposure.of;
    to->medium     = water_medium(&t->water);
    t->exposure.of = (struct imaging){0};
}

/* What was decided, for the one who asked where the run has its place. */
static void train_return_decisions(struct train *t)
{
    struct text *out = t->place ? t->place->decisions : NULL;
    if (out && t->decisions.data) text_add(out, "%s", t->decisions.data);
    if (out) out->failed |= t->decisions.failed;
}

OXL_INTERNAL oxl_result train_run(oxl_context *ctx, oxl_scene *scene, const oxl_train_options *options,
                                  const oxl_callback *callback, const struct train_place *place, oxl_model *out)
{
    struct train t  = {.ctx       = ctx,
                       .scene     = scene,
                       .options   = options,
                       .model     = out,
                       .begun     = os_seconds(),
                       .place     = place,
                       .callback  = callback,
                       .decisions = {.ctx = ctx}};
    oxl_result   rc = train_check(ctx, options), ended = OXL_OK;
    *out = (oxl_model){0};
    if (rc == OXL_OK) rc = train_begin(&t);
    if (rc == OXL_OK) rc = train_resume(&t);
    if (rc == OXL_OK) rc = train_loop(&t);
    if (rc == OXL_OK || rc == OXL_ERR_INTERRUPTED) ended = nonfinite_end(ctx, &t.faults, out);
    if (ended != OXL_OK) rc = ended;
    if (place && place->faults) *place->faults = t.faults;
    if (place && place->trained) *place->trained = rc == OXL_OK && t.step == options->iterations;
    if (rc == OXL_ERR_INTERRUPTED) oxl_fail(ctx, rc, "interrupted at iteration %d of %d", t.step, options->iterations);
    else if (rc != OXL_OK) oxl_model_free(ctx, out);
    train_return_decisions(&t);
    train_leave_gains(&t);
    train_end(&t);
    return rc;
}

oxl_result oxl_train(oxl_context *ctx, oxl_scene *scene, const oxl_train_options *options, const oxl_callback *callback,
                     oxl_model *out)
{
    return train_run(ctx, scene, options, callback, NULL, out);
}
