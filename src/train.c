/* train.c - the loop: one photograph a step, drawn, compared, walked back, stepped (Kerbl et al. 2023, Alg. 1).
 *
 * Invariant: the state after step n is a function of the scene, the options, the seed and n alone.
 */
#include "internal.h"
#include "vecmath.h"

#define TRAIN_WARM_UP 500 /* iterations before the first densification, unless a quarter of the run is less */
#define TRAIN_RESET_LEAST \
    3000 /* iterations between opacity resets: a model needs about a thousand to recover from one [Kerbl 2023] */
#define TRAIN_PIXELS_EACH   60 /* training pixels for each Gaussian at least: it has up to 59 numbers, a pixel tells 3 (PAPER.md) */
#define TRAIN_RANDOM_POINTS 10000      /* to start from when the scene has none */
#define TRAIN_WATCH         (1.0 / 40) /* of the run: gradients are averaged so long before lobes are given out [OceanXL] */
#define TRAIN_SAVE_STEPS    500        /* a checkpoint after so many iterations, */
#define TRAIN_SAVE_SECONDS  60.0       /* or so long, whichever comes first */
#define TRAIN_SMOOTHING     0.02       /* of loss and PSNR in progress reports: about the last 50 views */

oxl_train_options oxl_train_options_default(oxl_preset preset)
{
    oxl_train_options o = {.iterations          = 7000,
                           .sh_degree           = 3,
                           .ssim_weight         = 0.2f,
                           .ssim_every          = 1,
                           .bands_every         = 1.0f / 30,
                           .rate_mean_first     = 1.6e-4f,
                           .rate_mean_last      = 1.6e-6f,
                           .rate_log_scale      = 0.005f,
                           .rate_rotation       = 0.001f,
                           .rate_opacity        = 0.025f,
                           .rate_sh0            = 0.0025f,
                           .rate_sh             = 0.0025f / 20,
                           .densify_from        = 0.025f,
                           .densify_until       = 0.5f,
                           .densify_every       = 100,
                           .densify_gradient    = 2e-4f,
                           .reset_opacity_every = 0.1f,
                           .ucd                 = oxl_ucd_default(),
                           .dog_from            = 0.785f,
                           .dog_threshold       = 2e-4f,
                           .dog_opacity_factor  = 0.1f,
                           .dog_scale_factor    = 1.6f};
    if (preset == OXL_PRESET_DRAFT)
        o.iterations = 2000, o.densify_gradient = 4e-4f,
        o.coarse = 0.25f; /* half the growth: 2000 iterations cannot train more */
    if (preset == OXL_PRESET_PAPER) o.iterations = 40000;
    return o;
}

struct train {
    oxl_context              *ctx;
    oxl_scene                *scene;
    const oxl_train_options  *options;
    oxl_render_options        render;
    oxl_model                *model, first, second, gradient; /* the parameters, Adam's moments, dL/d(parameter) */
    struct renderer          *renderer;
    struct density           *density;
    struct ucd                ucd;
    struct prune              prune;
    int                      *view; /* (views) training views in this epoch's order */
    int                       views, step;
    int                      *held; /* (held_views) training views that are not trained on: --keep auto judges by them */
    int                       held_views;
    int                       resets;
    float                    *target, *weight; /* the photograph of this step: (3,H,W), (H,W) */
    int                       masked;          /* whether weight holds its mask */
    int                       halved;          /* whether they are reduced to half the sides */
    size_t                    target_capacity, weight_capacity;
    double                    loss, psnr; /* smoothed */
    oxl_faults                faults;
    int                       first_step; /* after which this process took over: 0, or that of a checkpoint */
    double                    begun;      /* when it did */
    double                    seconds;    /* that others had spent on the run before */
    const struct train_place *place;      /* of its checkpoints, or NULL */
    int                       saved_step; /* of the last checkpoint, */
    double                    saved_at;   /* and when it was */
};

static double train_seconds(const struct train *t)
{
    return t->seconds + os_seconds() - t->begun;
}

/* ---------------------------------------------------------------- the schedule */

static void train_rates(const struct train *t, float rate[OXL_PLANES])
{
    const oxl_train_options *o        = t->options;
    const double             progress = (double)(t->step - 1) / OXL_MAX(1, o->iterations - 1);
    const double             first = vecmath_log(o->rate_mean_first), last = vecmath_log(o->rate_mean_last);
    const float              mean = (float)(vecmath_exp(first + (last - first) * progress) * oxl_scene_extent(t->scene));
    for (int k = 0; k < OXL_PLANES; k++)
        rate[k] = k < OXL_LOG_SCALE  ? mean
                  : k < OXL_ROTATION ? o->rate_log_scale
                  : k < OXL_OPACITY  ? o->rate_rotation
                  : k < OXL_SH       ? o->rate_opacity
                  : k < OXL_SH + 3   ? o->rate_sh0
                  : k < OXL_LOBE     ? o->rate_sh
                  : k == OXL_LOBE    ? MODEL_LOBE_RATE_OPACITY
                                     : MODEL_LOBE_RATE_SCALE;
}

/* 3DGS's schedule is one of 30 000 iterations. As shares of the run it shrinks with it, but not what has a time of its own: the first
 * photographs must be learned before gradients say where detail is missing, and a reset must be made up for. */
static int train_densifies_at(const oxl_train_options *o, int step)
{
    const double from = OXL_MAX(o->densify_from * o->iterations, OXL_MIN(TRAIN_WARM_UP, 0.25 * o->iterations));
    return step >= from && step <= o->densify_until * o->iterations && step % o->densify_every == 0;
}

static int train_densifies(const struct train *t)
{
    return train_densifies_at(t->options, t->step);
}

static int train_resets_opacity(const struct train *t)
{
    const oxl_train_options *o     = t->options;
    const int                every = (int)OXL_MAX(TRAIN_RESET_LEAST, o->reset_opacity_every * o->iterations);
    return o->reset_opacity_every > 0 && t->step <= o->densify_until * o->iterations && t->step % every == 0;
}

/* Fisher & Yates 1938: every epoch sees every view once, in an order of its own. */
static void train_shuffle(struct train *t, int epoch)
{
    for (int i = t->views - 1; i > 0; i--) {
        const int j = (int)(random_bits(t->ctx->options.seed, (uint64_t)epoch, (uint64_t)i) % (uint64_t)(i + 1));
        OXL_SWAP(int, t->view[i], t->view[j]);
    }
}

/* ---------------------------------------------------------------- one photograph */

/* In a step of the run's first share, at half the sides. */
static int train_is_coarse(const struct train *t)
{
    return t->step <= t->options->coarse * t->options->iterations;
}

/* A view's photograph and mask into target and weight. OXL_ERR_INPUT: it cannot be read. */
static oxl_result train_photo(struct train *t, int view)
{
    const struct photo *photo = scene_photo(t->ctx, t->scene, view);
    oxl_result          rc;
    size_t              pixels;
    if (!photo) return t->ctx->failed;
    pixels    = (size_t)photo->width * (size_t)photo->height;
    rc        = oxl_reserve(t->ctx, (void **)&t->target, &t->target_capacity, 3 * pixels, sizeof *t->target);
    t->masked = photo->mask != NULL;
    if (rc == OXL_OK && t->masked) rc = oxl_reserve(t->ctx, (void **)&t->weight, &t->weight_capacity, pixels, sizeof *t->weight);
    if (rc != OXL_OK) return rc;
    image_from_photo(photo, t->target, t->masked ? t->weight : NULL);
    t->halved = train_is_coarse(t) && photo->width > 1 && photo->height > 1;
    if (t->halved) image_halve(photo->width, photo->height, t->target, t->masked ? t->weight : NULL);
    return OXL_OK;
}

/* The next view whose photograph can be read; one that cannot is named and left out from then on. */
static oxl_result train_next_photo(struct train *t, int *view)
{
    while (t->views > 0) {
        const int  slot = (t->step - 1) % t->views;
        oxl_result rc;
        if (slot == 0) train_shuffle(t, (t->step - 1) / t->views);
        *view = t->view[slot];
        rc    = train_photo(t, *view);
        if (rc != OXL_ERR_INPUT) return rc;
        faults_of_photo(t->ctx, &t->faults);
        t->view[slot] = t->view[--t->views];
    }
    return oxl_fail(t->ctx, OXL_ERR_INPUT, "none of the training photographs can be read");
}

/* The model drawn from a view, against its photograph as train_photo has left it. */
static oxl_result train_compare(struct train *t, int view, float ssim_weight, struct renderer_loss *loss)
{
    const oxl_camera *whole  = &oxl_scene_view(t->scene, view)->camera;
    const oxl_camera  camera = t->halved ? camera_halve(whole) : *whole;
    oxl_result        rc     = renderer_forward(t->ctx, t->renderer, t->model, &camera, &t->render);
    if (rc != OXL_OK) return rc;
    return renderer_loss(t->ctx, t->renderer, t->target, t->masked ? t->weight : NULL, ssim_weight, loss);
}

/* With the whole loss, for judgement. */
static oxl_result train_compare_view(struct train *t, int view, struct renderer_loss *loss)
{
    return train_compare(t, view, t->options->ssim_weight, loss);
}

/* Forward, loss, backward, step. */
static oxl_result train_on_view(struct train *t, int view)
{
    const char           *name = oxl_scene_view(t->scene, view)->name;
    float                 rate[OXL_PLANES];
    struct renderer_loss  loss;
    struct renderer_aside aside;
    oxl_result            rc = train_compare(t, view, t->step % t->options->ssim_every ? 0 : t->options->ssim_weight, &loss);
    if (rc != OXL_OK) return rc;
    if (!(loss.total <= DBL_MAX)) {
        faults_of_view(t->ctx, &t->faults, t->step, name, t->renderer, t->model, &t->first, &t->second);
        renderer_forget(t->renderer); /* what follows a step must not read the gradients of an earlier one */
        return OXL_OK;
    }
    rc = renderer_backward(t->ctx, t->renderer, NULL, &t->gradient);
    if (rc != OXL_OK) return rc;
    train_rates(t, rate);
    aside = renderer_step(t->ctx, t->renderer, t->model, &t->gradient, &t->first, &t->second, rate, t->step);
    faults_of_rows(t->ctx, &t->faults, t->step, name, aside, t->model, &t->first, &t->second);
    {
        const double psnr = -4.342944819032518 * vecmath_log(loss.mse > 1e-10 ? loss.mse : 1e-10);
        const double k    = OXL_MAX(TRAIN_SMOOTHING, 1.0 / t->step);
        ucd_observe(&t->ucd, t->step, view, t->options->ssim_every > 1 ? loss.l1 : loss.total); /* alike from step to step */
        prune_observe(&t->prune, t->step, loss.l1);
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

static oxl_result train_resize(struct train *t)
{
    oxl_result rc;
    oxl_model_free(t->ctx, &t->gradient);
    rc = oxl_model_create(t->ctx, t->model->count, t->model->sh_degree, &t->gradient);
    return rc == OXL_OK ? model_set_lobes(t->ctx, &t->gradient, t->model->lobes) : rc;
}

static oxl_result train_densify(struct train *t)
{
    const oxl_train_options *o      = t->options;
    const size_t             before = t->model->count;
    struct density_rules     rules  = {.gradient     = o->densify_gradient,
                                       .extent       = oxl_scene_extent(t->scene),
                                       .remove_large = t->resets > 0,
                                       .cap          = train_cap(t->scene, o),
                                       .seed         = t->ctx->options.seed,
                                       .step         = t->step};
    struct density_change    change;
    double                   f[2];
    oxl_result               rc;
    ucd_before_control(&t->ucd, t->step, f);
    rules.f_mid = f[0], rules.f_far = f[1];
    rc = density_control(t->ctx, t->density, t->model, &t->first, &t->second, &rules, &change);
    if (rc == OXL_OK) rc = train_resize(t);
    if (rc == OXL_OK && t->model->count == 0) {
        rc = oxl_fail(t->ctx, OXL_ERR_FAILED, "step %d: no Gaussian is left\nfix: look at the cameras and points with: oxl check",
                      t->step);
    }
    if (rc != OXL_OK) return rc;
    ucd_after_control(&t->ucd, t->step, before, t->model->count);
    oxl_log(t->ctx, OXL_LOG_DEBUG, "step %d: %zu cloned, %zu split, %zu removed, %zu left", t->step, change.cloned, change.split,
            change.removed, t->model->count);
    return OXL_OK;
}

static oxl_result train_density(struct train *t)
{
    oxl_result rc = OXL_OK;
    if (t->step > t->options->densify_until * t->options->iterations) return OXL_OK;
    density_observe(t->ctx, t->density, t->renderer, t->model->count);
    if (train_densifies(t)) rc = train_densify(t);
    if (rc == OXL_OK && train_resets_opacity(t)) {
        density_reset_opacity(t->model, &t->first, &t->second);
        ucd_disturb(&t->ucd, t->step, 1);
        t->resets++;
    }
    return rc;
}

/* ---------------------------------------------------------------- pruning */

/* Mean loss over the training views that `--keep auto` set apart; one whose photograph cannot be read is left out from then on. */
static oxl_result train_held_loss(struct train *t, double *out)
{
    struct renderer_loss loss;
    double               sum = 0;
    for (int i = 0; i < t->held_views;) {
        oxl_result rc = train_photo(t, t->held[i]);
        if (rc == OXL_ERR_INPUT) {
            faults_of_photo(t->ctx, &t->faults);
            t->held[i] = t->held[--t->held_views];
            continue;
        }
        if (rc == OXL_OK) rc = train_compare_view(t, t->held[i], &loss);
        if (rc != OXL_OK) return rc;
        sum += loss.total;
        i++;
    }
    *out = sum / OXL_MAX(1, t->held_views);
    return OXL_OK;
}

static oxl_result train_prune(struct train *t)
{
    double     held = 0;
    size_t     drop;
    oxl_result rc = OXL_OK;
    if (!prune_checks(&t->prune, t->step)) return OXL_OK;
    if (t->held_views > 0) rc = train_held_loss(t, &held);
    if (rc != OXL_OK) return rc;
    drop = prune_due(&t->prune, t->step, t->model->count, held);
    if (drop == 0) return OXL_OK;
    rc = prune_apply(t->ctx, &t->prune, drop, t->renderer, t->scene, &t->render, t->model, &t->first, &t->second);
    if (rc == OXL_OK) rc = train_resize(t);
    if (rc == OXL_OK)
        oxl_log(t->ctx, OXL_LOG_INFO, "step %d: the %zu Gaussians that matter least are dropped, %zu are left", t->step, drop,
                t->model->count);
    return rc;
}

/* ---------------------------------------------------------------- second lobes */

static int train_gives_lobes_at(const struct train *t)
{
    return (int)(t->options->dog_from * t->options->iterations);
}

/* Steps over which gradients are watched before lobes are given out: 1000 of 40 000 [OceanXL]. */
static int train_watch(const struct train *t)
{
    return OXL_MAX(1, (int)(TRAIN_WATCH * t->options->iterations));
}

static int train_by_size(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* A threshold at or below 0 is a quantile: -0.9 lets the upper tenth have lobes. */
static oxl_result train_lobe_threshold(const struct train *t, double *out)
{
    const float  threshold = t->options->dog_threshold;
    const size_t count     = t->model->count;
    double      *gradient;
    *out = threshold;
    if (t->options->dog == OXL_DOG_ALL) *out = -1;
    if (threshold > 0 || t->options->dog == OXL_DOG_ALL) return OXL_OK;
    gradient = oxl_alloc(t->ctx, count + 1, sizeof *gradient);
    if (!gradient) return oxl_fail(t->ctx, OXL_ERR_MEMORY, "no memory to rank the gradients of %zu Gaussians", count);
    for (size_t i = 0; i < count; i++) gradient[i] = density_mean_gradient(t->density, i);
    qsort(gradient, count, sizeof *gradient, train_by_size);
    *out = measure_quantile(gradient, count, -threshold);
    oxl_free(t->ctx, gradient);
    return OXL_OK;
}

/* Those that the loss still pulls about get a second lobe: decided once [OceanXL sec. 3.2]. */
static oxl_result train_give_lobes(struct train *t)
{
    const oxl_train_options *o         = t->options;
    uint8_t                 *active    = oxl_alloc(t->ctx, t->model->count + 1, 1);
    size_t                   given     = 0;
    double                   threshold = 0;
    oxl_result rc = active ? train_lobe_threshold(t, &threshold) : oxl_fail(t->ctx, OXL_ERR_MEMORY, "no memory to give lobes");
    if (rc != OXL_OK) goto done;
    for (size_t i = 0; i < t->model->count; i++) {
        active[i] = density_mean_gradient(t->density, i) > threshold;
        given += active[i];
    }
    oxl_log(t->ctx, OXL_LOG_INFO, "step %d: %zu of %zu Gaussians get a second lobe", t->step, given, t->model->count);
    if (given > 0)
        rc = model_activate_lobes(t->ctx, t->model, &t->first, &t->second, active, o->dog_opacity_factor, o->dog_scale_factor);
    if (rc == OXL_OK && given > 0) rc = train_resize(t);
done:
    oxl_free(t->ctx, active);
    return rc;
}

static oxl_result train_lobes(struct train *t)
{
    const int last = train_gives_lobes_at(t);
    if (t->options->dog == OXL_DOG_OFF || t->step <= last - train_watch(t) || t->step > last) return OXL_OK;
    if (t->step == last - train_watch(t) + 1) {
        const oxl_result rc = density_clear(t->ctx, t->density, t->model->count);
        if (rc != OXL_OK) return rc;
    }
    density_observe(t->ctx, t->density, t->renderer, t->model->count);
    return t->step == last ? train_give_lobes(t) : OXL_OK;
}

/* One more SH band each such share of the run, up to the degree asked for. */
static oxl_result train_bands(struct train *t)
{
    const int wanted = OXL_MIN(t->options->sh_degree, (int)(t->step / (t->options->bands_every * t->options->iterations) + 1e-6));
    oxl_result rc    = OXL_OK;
    if (wanted <= t->model->sh_degree) return OXL_OK;
    ucd_disturb(&t->ucd, t->step, 0);
    rc = model_set_degree(t->ctx, t->model, wanted);
    if (rc == OXL_OK) rc = model_set_degree(t->ctx, &t->first, wanted);
    if (rc == OXL_OK) rc = model_set_degree(t->ctx, &t->second, wanted);
    return rc == OXL_OK ? train_resize(t) : rc;
}

/* ---------------------------------------------------------------- the run */

/* One Gaussian a point; without points, random ones in front of the cameras. */
static oxl_result train_first_model(struct train *t)
{
    oxl_point *random = NULL;
    oxl_result rc;
    if (oxl_scene_point_count(t->scene) > 0)
        return oxl_model_from_points(t->ctx, oxl_scene_points(t->scene), oxl_scene_point_count(t->scene), 0, t->model);
    oxl_log(t->ctx, OXL_LOG_WARNING, "the scene has no points; training starts from %d random ones", TRAIN_RANDOM_POINTS);
    rc = scene_random_points(t->ctx, t->scene, TRAIN_RANDOM_POINTS, &random);
    if (rc == OXL_OK) rc = oxl_model_from_points(t->ctx, random, TRAIN_RANDOM_POINTS, 0, t->model);
    oxl_free(t->ctx, random);
    return rc;
}

OXL_INTERNAL int train_densifications(const oxl_train_options *options)
{
    int count = 0;
    for (int step = 1; step <= options->iterations; step++) count += train_densifies_at(options, step);
    return count;
}

static int train_training_views(const oxl_scene *scene)
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
    prune_begin(&t->prune, o->keep, o->iterations, until, views, prune_row_bytes(o->sh_degree, o->dog != OXL_DOG_OFF));
    return rc;
}

/* Training views in the order of their names; those that pruning judges by stand aside. */
static oxl_result train_begin_views(struct train *t)
{
    const int views = train_training_views(t->scene);
    int       index = 0;
    t->view         = oxl_alloc(t->ctx, (size_t)views + 1, sizeof *t->view);
    t->held         = oxl_alloc(t->ctx, (size_t)views + 1, sizeof *t->held);
    if (!t->view || !t->held) return oxl_fail(t->ctx, OXL_ERR_MEMORY, "no memory for the order of the views");
    for (int i = 0; i < oxl_scene_view_count(t->scene); i++) {
        if (oxl_scene_view(t->scene, i)->is_test) continue;
        if (prune_holds(&t->prune, index++, views)) t->held[t->held_views++] = i;
        else t->view[t->views++] = i;
    }
    if (t->views == 0) return oxl_fail(t->ctx, OXL_ERR_INPUT, "there is no training view\nfix: --test-every 0 holds none out");
    return OXL_OK;
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
    rc = oxl_model_create(ctx, t->model->count, 0, &t->first);
    if (rc == OXL_OK) rc = oxl_model_create(ctx, t->model->count, 0, &t->second);
    if (rc == OXL_OK) rc = train_resize(t);
    if (rc == OXL_OK) rc = renderer_create(ctx, &t->renderer);
    if (rc == OXL_OK) rc = density_create(ctx, &t->density);
    if (rc == OXL_OK) rc = density_clear(ctx, t->density, t->model->count);
    if (rc != OXL_OK) return rc;
    memset(t->first.plane[OXL_ROTATION], 0, t->first.capacity * sizeof(float));
    memset(t->second.plane[OXL_ROTATION], 0, t->second.capacity * sizeof(float));
    rc = train_begin_control(t);
    return rc == OXL_OK ? train_begin_views(t) : rc;
}

static void train_end(struct train *t)
{
    oxl_context *ctx = t->ctx;
    oxl_model_free(ctx, &t->first);
    oxl_model_free(ctx, &t->second);
    oxl_model_free(ctx, &t->gradient);
    renderer_free(ctx, t->renderer);
    density_free(ctx, t->density);
    ucd_free(ctx, &t->ucd);
    oxl_free(ctx, t->view);
    oxl_free(ctx, t->held);
    oxl_free(ctx, t->target);
    oxl_free(ctx, t->weight);
}

/* ---------------------------------------------------------------- checkpoints */

static int train_alike(const oxl_model *a, const oxl_model *b)
{
    return a->count == b->count && a->sh_degree == b->sh_degree && a->lobes == b->lobes;
}

/* All that the steps to come depend on; the gradient is made anew in each. */
static void train_archive(struct archive *a, void *user)
{
    struct train *t     = user;
    size_t        views = (size_t)t->views;
    double        spent = train_seconds(t);
    archive_int(a, &t->step);
    archive_int(a, &t->resets);
    archive_doubles(a, &t->loss, 1);
    archive_doubles(a, &t->psnr, 1);
    archive_doubles(a, &spent, 1);
    faults_archive(a, &t->faults);
    archive_size(a, &views);
    archive_expect(a, t->step >= 0 && t->step <= t->options->iterations && t->resets >= 0);
    archive_expect(a, views <= (size_t)t->views); /* those that began; some may have been left out since */
    if (a->rc == OXL_OK) archive_ints(a, t->view, views);
    for (size_t i = 0; i < views && a->rc == OXL_OK; i++)
        archive_expect(a, t->view[i] >= 0 && t->view[i] < oxl_scene_view_count(t->scene));
    archive_model(a, t->model);
    archive_model(a, &t->first);
    archive_model(a, &t->second);
    archive_expect(a, t->model->count > 0 && train_alike(t->model, &t->first) && train_alike(t->model, &t->second));
    density_archive(a, t->density, t->model->count);
    ucd_archive(a, &t->ucd);
    prune_archive(a, &t->prune);
    archive_text(a, t->place->log);
    archive_text(a, t->place->notes);
    if (!a->reading || a->rc != OXL_OK) return;
    t->views   = (int)views;
    t->seconds = spent;
    a->rc      = train_resize(t);
}

static oxl_result train_save(struct train *t)
{
    t->saved_step = t->step;
    t->saved_at   = os_seconds();
    return t->place ? checkpoint_write(t->ctx, t->place->folder, t->place->key, train_archive, t) : OXL_OK;
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

static int train_report(const struct train *t, const oxl_callback *callback)
{
    const double seconds = train_seconds(t), here = os_seconds() - t->begun;
    oxl_progress progress = {.iteration    = t->step,
                             .iterations   = t->options->iterations,
                             .gaussians    = t->model->count,
                             .loss         = t->loss,
                             .psnr         = t->psnr,
                             .f_mid        = t->ucd.on ? t->ucd.f[0] : 1,
                             .f_far        = t->ucd.on ? t->ucd.f[1] : 1,
                             .seconds      = seconds,
                             .seconds_left = here / OXL_MAX(1, t->step - t->first_step) * (t->options->iterations - t->step),
                             .model        = t->model,
                             .faults       = t->faults};
    return callback && callback->progress && callback->progress(callback->user, &progress);
}

static oxl_result train_step(struct train *t)
{
    int        view = -1;
    oxl_result rc   = train_next_photo(t, &view);
    if (rc == OXL_OK) rc = train_bands(t);
    if (rc == OXL_OK) rc = train_on_view(t, view);
    if (rc == OXL_OK) rc = train_density(t);
    if (rc == OXL_OK) rc = train_prune(t);
    if (rc == OXL_OK) rc = train_lobes(t);
    return rc;
}

static oxl_result train_check(oxl_context *ctx, const oxl_train_options *o)
{
    if (!(o->ssim_every >= 1 && o->coarse >= 0 && o->coarse <= 1 && o->bands_every > 0))
        return oxl_fail(ctx, OXL_ERR_USAGE,
                        "SSIM every %d steps, coarse for %g of the run, bands every %g of it: wanted at least 1, "
                        "0 to 1, more than 0",
                        o->ssim_every, o->coarse, o->bands_every);
    if (o->iterations >= 1 && o->sh_degree >= 0 && o->sh_degree <= 3 && o->densify_every >= 1) return OXL_OK;
    return oxl_fail(ctx, OXL_ERR_USAGE, "iterations %d, SH degree %d, densify every %d: wanted at least 1, 0 to 3, at least 1",
                    o->iterations, o->sh_degree, o->densify_every);
}

/* Whatever ends the loop early, the state is saved: an order to stop, the time allowed. */
static oxl_result train_loop(struct train *t, const oxl_callback *callback)
{
    const oxl_train_options *o  = t->options;
    oxl_result               rc = OXL_OK;
    t->first_step               = t->step;
    if (t->step > 0 && train_report(t, callback)) return OXL_ERR_INTERRUPTED;
    while (rc == OXL_OK && t->step < o->iterations) {
        t->step++;
        rc = train_step(t);
        if (rc != OXL_OK) break;
        if (train_report(t, callback)) {
            rc = train_save(t);
            return rc == OXL_OK ? OXL_ERR_INTERRUPTED : rc;
        }
        if (o->max_seconds > 0 && os_seconds() - t->begun > o->max_seconds && t->step < o->iterations) {
            oxl_log(t->ctx, OXL_LOG_INFO, "stopped after %d of %d iterations: the time allowed is over", t->step, o->iterations);
            return train_save(t);
        }
        if (train_save_is_due(t)) rc = train_save(t);
    }
    return rc;
}

OXL_INTERNAL oxl_result train_run(oxl_context *ctx, oxl_scene *scene, const oxl_train_options *options,
                                  const oxl_callback *callback, const struct train_place *place, oxl_model *out)
{
    struct train t  = {.ctx = ctx, .scene = scene, .options = options, .model = out, .begun = os_seconds(), .place = place};
    oxl_result   rc = train_check(ctx, options), ended = OXL_OK;
    *out = (oxl_model){0};
    if (rc == OXL_OK) rc = train_begin(&t);
    if (rc == OXL_OK) rc = train_resume(&t);
    if (rc == OXL_OK) rc = train_loop(&t, callback);
    if (rc == OXL_OK || rc == OXL_ERR_INTERRUPTED) ended = faults_end(ctx, &t.faults, out);
    if (ended != OXL_OK) rc = ended;
    if (place && place->faults) *place->faults = t.faults;
    if (rc == OXL_ERR_INTERRUPTED) oxl_fail(ctx, rc, "interrupted at iteration %d of %d", t.step, options->iterations);
    else if (rc != OXL_OK) oxl_model_free(ctx, out);
    train_end(&t);
    return rc;
}

oxl_result oxl_train(oxl_context *ctx, oxl_scene *scene, const oxl_train_options *options, const oxl_callback *callback,
                     oxl_model *out)
{
    return train_run(ctx, scene, options, callback, NULL, out);
}
