/* look.c - a first look at a survey: some steps on a few views, whose result is forgotten.
 *
 * It begins as the run will: with the points that parts add, and with exposure (without its trial), lamp,
 * medium, depth weights and SSIM's constant as the tracks decide them, since each changes gradients.
 * Gaussians are split LOOK_SPLITS times; what is split then, of those seen, says how fast the model will
 * grow, the time of the steps how long the run takes (forecast.c). Images that the presets begin at half the
 * sides are looked at so. Whole steps with all bands of SH are timed behind it, and alone where even slow
 * growth ends at the limit of Gaussians: the share is left unknown then.
 *
 * Invariant: the run that follows gives the same bytes. The share is a function of survey and options; times
 * are not.
 */
#include "large.h"
#include "../train/train_state.h"
#include "../train/forecast.h"
#include "../survey/scene.h"
#include "../survey/survey.h"

/* Time of a step on one thread, s, a pixel and a Gaussian; of these so many seconds: larger surveys get fewer
 * steps. */
#define LOOK_PIXEL 4e-8
#define LOOK_POINT 1e-7
#define LOOK_SECONDS 4.0
#define LOOK_INTERVAL 1e-6f /* of the run, after which timed steps have one band of SH more */
enum {
    LOOK_VIEWS = 32,
    LOOK_STEPS = 300, /* at most, */
    LOOK_FEWEST = 30, /* and at least; */
    LOOK_MOST = 600,  /* at most with the learning rates of the longest runs, which learn as much in these */
    LOOK_FRACTION = 10, /* a look takes at most one of so many iterations of the run, */
    LOOK_WINDOWS = 5,   /* as many steps each: two before gradients count, one before each split, of which */
    LOOK_SPLITS = 3,
    LOOK_MEASURED = 2, /* the last ones count */
    LOOK_TIMED = 12,   /* steps, behind those for growth, */
    LOOK_ALONE = 60    /* or at most without these: the first steps from points are faster and slower */
};

static int look_is_coarse(const oxl_scene *scene)
{
    const oxl_train_options o = {.coarse = -1};
    const oxl_camera *c = &oxl_scene_view(scene, 0)->camera;
    return schedule_coarse_fraction(&o, c->width, c->height) > 0;
}

/* Leaves evenly spaced ones of the training views. */
static void look_choose_views(struct train *t)
{
    const int views = t->views, few = OXL_MIN(views, LOOK_VIEWS);
    for (int i = 0; i < few; i++) t->view[i] = t->view[i * views / few];
    t->views = few;
}

/* Trains `steps` more; took (steps): their seconds. Downloads what a device has summed up: the views that saw
 * each Gaussian. */
static oxl_result look_train(struct train *t, int steps, double *took)
{
    oxl_result rc = OXL_OK;
    for (int k = 0; k < steps && rc == OXL_OK; k++) {
        const double started = os_seconds();
        rc = context_stopped(t->ctx);
        t->step++;
        if (rc == OXL_OK) rc = train_step_alone(t);
        if (rc == OXL_OK) rc = step_observe(t);
        took[k] = os_seconds() - started;
    }
    return rc == OXL_OK ? step_download(t, DOWNLOAD_SHAPE) : rc;
}

static double look_seen(const struct train *t)
{
    double seen = 0;
    for (size_t i = 0; i < t->trained.model.count; i++) seen += t->density->views[i] > 0;
    return OXL_MAX(seen, 1);
}

/* Splits as training does, but for its limit; adds to *share the growth of the Gaussians seen. */
static oxl_result look_split(struct train *t, double *share)
{
    const double seen = look_seen(t), before = (double)t->trained.model.count;
    const oxl_result rc = step_densify(t);
    *share += OXL_MAX(((double)t->trained.model.count - before) / seen, 1 / seen) / LOOK_MEASURED;
    return rc;
}

/* Measures the share late: the gradients before are of Gaussians that are still at their places of the start,
 * and change again when the first ones are split. */
static oxl_result look_grow(struct train *t, int steps, struct look *out)
{
    double took[LOOK_MOST];
    const int window = OXL_MAX(1, steps / LOOK_WINDOWS);
    oxl_result rc = look_train(t, OXL_MAX(0, steps - LOOK_SPLITS * window), took);
    for (int k = 0; k < LOOK_SPLITS && rc == OXL_OK; k++) {
        if (rc == OXL_OK && k == 0) rc = density_clear(t->ctx, t->density, t->trained.model.count);
        if (rc == OXL_OK) rc = look_train(t, window, took);
        if (k == LOOK_SPLITS - LOOK_MEASURED) out->share = 0;
        if (rc == OXL_OK) rc = look_split(t, &out->share);
    }
    return rc;
}

/* Times whole steps with all bands of SH, as most of a run's are; the first third do not count. */
static oxl_result look_time(struct train *t, oxl_train_options *o, int steps, struct look *out)
{
    double took[LOOK_ALONE];
    oxl_result rc;
    o->coarse = 0, o->sh_degree_interval = LOOK_INTERVAL;
    out->timed = (double)t->trained.model.count;
    rc = look_train(t, steps, took);
    out->seconds = stats_select(took + steps / 3, (size_t)(steps - steps / 3), 0.5);
    return rc;
}

static int look_steps(const oxl_scene *scene, const oxl_train_options *o)
{
    const oxl_camera *c = &oxl_scene_view(scene, 0)->camera;
    const double pixels = (double)c->width * c->height * (o->coarse > 0 ? 0.25 : 1),
                 points = (double)OXL_MAX(oxl_scene_point_count(scene), scene_start_count(scene)),
                 each = LOOK_PIXEL * pixels + LOOK_POINT * points;
    const double slow = OXL_MAX(LOOK_STEPS, LOOK_MOST / schedule_short_run_factor(o)) / LOOK_STEPS;
    const double most = OXL_CLAMP(o->iterations / LOOK_FRACTION, LOOK_FEWEST, slow * LOOK_STEPS);
    return (int)OXL_MIN(OXL_CLAMP(slow * LOOK_SECONDS / each, LOOK_FEWEST, most), OXL_MAX(1, o->iterations));
}

/* Says that the look left the device; the run, which begins there anew, says so itself. */
static void look_tell_fallback(oxl_context *ctx, const oxl_context *quiet, int before)
{
    if (!ctx->backend || ctx->backend->fell_back == before) return;
    oxl_log(ctx, OXL_LOG_WARNING, "%.*s: continuing on the CPU", (int)strcspn(quiet->error, "\n"),
            quiet->error);
    ctx->backend->fell_back = before;
}

OXL_INTERNAL oxl_result look_take(oxl_context *ctx, oxl_scene *scene, const oxl_train_options *options,
                                  size_t most, struct look *out)
{
    oxl_train_options o = *options;
    oxl_context quiet = *ctx;
    struct train t = {.ctx = &quiet, .survey = scene, .options = &o, .started = os_seconds(), .is_look = 1};
    const int fell_back = ctx->backend ? ctx->backend->fell_back : 0;
    const double cap = (double)schedule_gaussian_cap(scene, options);
    oxl_result rc = OXL_OK;
    int reaches;
    *out = (struct look){0};
    if (oxl_scene_view_count(scene) == 0 || schedule_training_views(scene) == 0) return OXL_OK;
    options_drop(&o, OXL_OPTION_NOT_LOOKED);
    quiet.options.log = NULL;
    quiet.notes = NULL;
    o.coarse = look_is_coarse(scene);
    if (most < schedule_gaussian_cap(scene, &o)) o.max_gaussians = (int)most;
    t.decisions.ctx = &quiet;
    rc = train_begin(&t);
    out->begin = os_seconds() - t.started;
    if (rc == OXL_OK) {
        o.max_gaussians = (int)OXL_MIN(most, INT_MAX);
        look_choose_views(&t);
        reaches = forecast_reaches(options, (double)t.trained.model.count, OXL_MIN((double)most, cap));
        out->gaussians = (double)t.trained.model.count;
        if (!reaches) rc = look_grow(&t, look_steps(scene, &o), out);
        if (rc == OXL_OK)
            rc = look_time(
                &t, &o,
                reaches ? OXL_CLAMP(o.iterations / LOOK_FRACTION, LOOK_TIMED, LOOK_ALONE) : LOOK_TIMED, out);
    }
    if (rc == OXL_OK) out->hides = train_imaging_hides(&t);
    train_end(&t);
    ctx->backend = quiet.backend;
    look_tell_fallback(ctx, &quiet, fell_back);
    if (rc == OXL_ERR_INTERRUPTED) oxl_fail(ctx, rc, "interrupted before the first step");
    if (rc == OXL_OK) out->steps = t.step, out->views = t.views;
    else *out = (struct look){0};
    return rc == OXL_ERR_INTERRUPTED ? rc
                                     : OXL_OK; /* whatever hinders a look is said where it hinders the run */
}
