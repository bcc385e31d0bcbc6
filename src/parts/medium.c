/* medium.c - the nine parameters of the medium, optimised with the scene (render/medium.h has the model).
 *
 * They are fitted to the colours of tracks (survey/photometry.c) before the first step, and not trained: as
 * the Gaussians' colours are free, the images alone do not determine attenuation (docs/IMAGING.md). The
 * medium is removed from the initial Gaussians' colours once.
 *
 * During training J is the colour as seen through the median range. Otherwise Adam's steps of colour, which
 * are absolute, would change the image too little in turbid water.
 *
 * Where the tracks do not support a medium, `on` trains it: each parameter is softplus of a free number
 * (SeaSplat, WaterSplatting); attenuation and backscatter count per median range of the survey's points,
 * so that steps do not depend on COLMAP's scale. Adam (Kingma & Ba 2015), rate MEDIUM_FIT_RATE, from
 * MEDIUM_FIT_FROM of the run on.
 *
 * What it omits: the lamp's own backscatter, which is strongest near the camera; forward scatter, which
 * blurs.
 *
 * Invariant: off changes no byte of the result. The state is archived.
 */
#include "medium.h"
#include "../core/option_rows.h"
#include "../core/vecmath.h"
#include "../survey/scene.h"

#define MEDIUM_FIT_RATE 0.01 /* 2.5e-3 to 1e-2 in the published ones */
#define MEDIUM_FIT_FROM 0.3  /* of the run */
/* of a parameter at the start: that of 0 would be minus infinity before the softplus */
#define MEDIUM_FIT_MIN 1e-6
#define MEDIUM_FIT_MAX 1e6   /* of one before the softplus, in a checkpoint */
#define MEDIUM_FIT_START 0.3 /* attenuation over the median range then */

static double medium_fit_softplus(double x)
{
    return x > 30 ? x : vecmath_log(1 + vecmath_exp(x));
}

static double medium_fit_inverse_softplus(double y)
{
    return y > 30 ? y : vecmath_log(vecmath_exp(y) - 1);
}

static struct medium medium_fit_value(const struct medium_fit *f)
{
    struct medium m = {.on = f->on};
    if (!f->on) return m;
    m.training_range = (float)f->range;
    for (int c = 0; c < 3; c++) {
        m.attenuation[c] = (float)(medium_fit_softplus(f->raw[c]) / f->range);
        m.backscatter[c] = (float)(medium_fit_softplus(f->raw[3 + c]) / f->range);
        m.veiling_light[c] = (float)medium_fit_softplus(f->raw[6 + c]);
    }
    return m;
}

static void medium_fit_set(struct medium_fit *f, const float attenuation[3], const float backscatter[3],
                           const float veiling_light[3])
{
    for (int c = 0; c < 3; c++) {
        f->raw[c] = medium_fit_inverse_softplus(OXL_MAX(attenuation[c] * f->range, MEDIUM_FIT_MIN));
        f->raw[3 + c] = medium_fit_inverse_softplus(OXL_MAX(backscatter[c] * f->range, MEDIUM_FIT_MIN));
        f->raw[6 + c] = medium_fit_inverse_softplus(OXL_MAX((double)veiling_light[c], MEDIUM_FIT_MIN));
    }
}

OXL_INTERNAL void medium_fit_set_from_tracks(struct medium_fit *f, double span, const struct photometry *p,
                                             char *why, size_t size)
{
    float value[3][3];
    f->on = f->fixed = (p->parts & PHOTOMETRY_MEDIUM) != 0;
    for (int c = 0; c < 3; c++)
        value[0][c] = (float)p->attenuation[c], value[1][c] = (float)p->backscatter[c],
        value[2][c] = (float)p->veiling_light[c];
    if (f->on) medium_fit_set(f, value[0], value[1], value[2]);
    if (f->on)
        snprintf(
            why, size,
            "%zu points in %zu observations: residuals %.2f %% of white, %.2f without the medium; red green blue, standard error: bD %.3g %.3g "
            "%.3g (%.0f %.0f %.0f %%), bB %.3g %.3g %.3g (%.0f %.0f %.0f %%), Binf %.3g %.3g %.3g",
            p->points, p->observations, 100 * p->with_medium, 100 * p->without[0], p->attenuation[0],
            p->attenuation[1], p->attenuation[2], 100 * p->error[0], 100 * p->error[1], 100 * p->error[2],
            p->backscatter[0], p->backscatter[1], p->backscatter[2], 100 * p->error[3], 100 * p->error[4],
            100 * p->error[5], p->veiling_light[0], p->veiling_light[1], p->veiling_light[2]);
    else if (!p->points) snprintf(why, size, "too few tracks to compare colours");
    else if (span < SCENE_DEPTH_SPAN_MIN)
        snprintf(
            why, size,
            "the points' depths span a factor of %.1f: less than %d does not identify a medium, and residuals, %.2f %% of white, "
            "are %.2f without one: on from %.2g times as much",
            span, SCENE_DEPTH_SPAN_MIN, 100 * p->with_medium, 100 * p->without[0], 1 + PHOTOMETRY_EVIDENT);
    else
        snprintf(why, size,
                 "%zu points in %zu observations: residuals %.2f %% of white, %.2f without the medium",
                 p->points, p->observations, 100 * p->with_medium, 100 * p->without[0]);
}

/* Returns the step after which a medium is fitted without tracks; 0: never. */
static int medium_fit_start_step(const oxl_train_options *o)
{
    return o->medium == OXL_ON ? OXL_MAX(1, (int)(MEDIUM_FIT_FROM * o->iterations)) : 0;
}

/* Sets first values where the tracks give none: MEDIUM_FIT_START over the median range, and the points' mean
 * colour as veil. */
OXL_INTERNAL void medium_fit_start(struct medium_fit *f, oxl_scene *scene)
{
    const oxl_point *point = oxl_scene_points(scene);
    const size_t count = oxl_scene_point_count(scene);
    const float start = (float)(MEDIUM_FIT_START / f->range), some[3] = {start, start, start};
    float veil[3];
    for (int c = 0; c < 3; c++) {
        double mean = 0;
        for (size_t i = 0; i < count; i++) mean += point[i].rgb[c] / 255.0;
        veil[c] = (float)OXL_CLAMP(count > 0 ? mean / (double)count : 0.3, 0.05, 0.9);
    }
    f->on = 1;
    medium_fit_set(f, some, some, veil);
}

/* Converts the model's colours from those of training to those without the medium, or back. */
static void medium_fit_scale_colours(const struct medium_fit *f, int to_clear, oxl_model *model)
{
    const struct medium m = medium_fit_value(f);
    double factor[3];
    if (!f->on) return;
    for (int c = 0; c < 3; c++)
        factor[c] = vecmath_exp((to_clear ? 1 : -1) * (double)m.attenuation[c] * (double)m.training_range);
    model_scale_colour(model, factor);
}

/* Takes the step of the pending gradient, unless its step is later than `last`. */
static void medium_fit_apply_pending(struct medium_fit *f, int last)
{
    struct medium_gradient *p = &f->pending;
    const double rate = MEDIUM_FIT_RATE * vecmath_exp(OXL_MAX(0, p->progress - 0.5) * 2 * vecmath_log(0.1));
    if (p->step == 0 || p->step > last) return;
    p->step = 0;
    if (f->fixed) return;
    f->steps++;
    for (int k = 0; k < 9; k++) {
        const double slope = 1 / (1 + vecmath_exp(-OXL_CLAMP(f->raw[k], -80, 80)));
        const double g = p->dmedium[k] * slope / (k < 6 ? f->range : 1);
        scalar_adam_step(&f->raw[k], &f->mean[k], &f->square[k], g, rate, f->steps);
    }
}

static void medium_archive(struct archive *a, struct train *t, void *state)
{
    struct medium_fit *f = state;
    if (t->options->medium == OXL_OFF) return;
    archive_int(a, &f->on);
    archive_int(a, &f->fixed);
    archive_int(a, &f->steps);
    archive_doubles(a, f->raw, 9);
    archive_doubles(a, f->mean, 9);
    archive_doubles(a, f->square, 9);
    archive_int(a, &f->pending.step);
    archive_doubles(a, &f->pending.progress, 1);
    archive_doubles(a, f->pending.dmedium, 9);
    archive_expect(a, f->pending.step >= 0 && f->pending.progress >= 0 && f->pending.progress <= 2);
    for (int k = 0; k < 9 && a->rc == OXL_OK; k++)
        archive_expect(a,
                       fabs(f->raw[k]) <= MEDIUM_FIT_MAX && fabs(f->mean[k]) <= DBL_MAX && f->square[k] >= 0);
    archive_expect(a, (f->on == 0 || f->on == 1) && (f->fixed == 0 || f->fixed == 1) && f->steps >= 0);
}

/* ---------------- the part */

#define MEDIUM_FIT_DRIFT 0.8 /* correlation of exposure with range from which a warning is due */

static oxl_result medium_begin(struct train *t, void *state)
{
    struct medium_fit *f = state;
    const struct medium *continued = &t->scene->imaging.medium;
    if (t->options->medium == OXL_OFF) return OXL_OK;
    f->range = scene_depth_quantile(t->scene, 0.5);
    if (!(f->range > 0)) f->range = 1;
    if (!t->continues || !continued->on) return OXL_OK;
    f->on = f->fixed = 1;
    medium_fit_set(f, continued->attenuation, continued->backscatter, continued->veiling_light);
    medium_fit_scale_colours(f, 0, &t->trained.model);
    return OXL_OK;
}

static int medium_tracks(const struct train *t, const void *state)
{
    (void)state;
    return t->options->medium != OXL_OFF ? PHOTOMETRY_MEDIUM : 0;
}

static void medium_use_tracks(struct train *t, void *state, const struct photometry *p)
{
    struct medium_fit *f = state;
    char why[400] = "";
    if (t->options->medium != OXL_OFF)
        medium_fit_set_from_tracks(f, scene_depth_span(t->scene), p, why, sizeof why);
    selection_record_auto(t, "medium", t->options->medium, f->on, why);
    if (f->on && fabs(p->drift) > MEDIUM_FIT_DRIFT && !train_imaging_is_open(t))
        oxl_log(
            t->ctx, OXL_LOG_WARNING,
            "the images' exposure is correlated with the range of what they show (%.2f): exposure and attenuation are not "
            "separated, and scene_clear.ply is not measured colour",
            p->drift);
}

/* On a device a step has the gradients of those up to the one before the last, as lamp and exposure do. */
static void medium_before_step(struct train *t, void *state, struct train_deferred *step, int learns)
{
    (void)step;
    if (learns) medium_fit_apply_pending(state, t->step - 2);
}

static void medium_form_image(const void *state, struct imaging *m)
{
    m->medium = medium_fit_value(state);
}

static oxl_result medium_before_render(struct train *t, void *state, struct part_view *v)
{
    (void)t;
    if (((struct medium_fit *)state)->fixed) v->imaging_learns = 0;
    return OXL_OK;
}

static void medium_after_loss(struct train *t, void *state, const struct train_deferred *step,
                              const struct renderer_loss *loss)
{
    struct medium_fit *f = state;
    if (!f->on) return;
    medium_fit_apply_pending(f, INT_MAX);
    f->pending.step = step->step;
    f->pending.progress = (double)step->step / t->options->iterations;
    memcpy(f->pending.dmedium, loss->dmedium, sizeof f->pending.dmedium);
    if (!renderer_has_device(t->renderer)) medium_fit_apply_pending(f, INT_MAX);
}

/* Starts a medium that is asked for by name and not known from tracks. */
static oxl_result medium_after_step(struct train *t, void *state)
{
    struct medium_fit *f = state;
    struct imaging m = {0};
    oxl_result rc;
    if (f->on || medium_fit_start_step(t->options) == 0 || t->step < medium_fit_start_step(t->options))
        return OXL_OK;
    rc = step_download(t, DOWNLOAD_TO_CHANGE);
    if (rc != OXL_OK) return rc;
    medium_fit_start(f, t->scene);
    m.medium = medium_fit_value(f);
    medium_bake(t->scene, &m, 1, &t->trained.model);
    return OXL_OK;
}

static void medium_store(struct train *t, void *state, oxl_model *model)
{
    (void)t;
    if (model) medium_fit_scale_colours(state, 1, model);
}

static void medium_describe(struct train *t, void *state)
{
    const struct medium *m = &t->scene->imaging.medium;
    (void)state;
    if (m->on)
        oxl_log(
            t->ctx, OXL_LOG_INFO,
            "medium on: bD %.3g %.3g %.3g, bB %.3g %.3g %.3g per unit, Binf %.3g %.3g %.3g (red green blue); depths span a "
            "factor of %.1f",
            (double)m->attenuation[0], (double)m->attenuation[1], (double)m->attenuation[2],
            (double)m->backscatter[0], (double)m->backscatter[1], (double)m->backscatter[2],
            (double)m->veiling_light[0], (double)m->veiling_light[1], (double)m->veiling_light[2],
            scene_depth_span(t->scene));
}

/* clang-format off */
static const oxl_option medium_options[] = {
{"medium", "off|on|auto", OXL_OPTION_CHOICE, OPTION_AT(train.medium), 0, 2, EACH("auto"), OXL_TIER_BASIC, TRAINING | RESULT, "Scene content", "fit the water: attenuation and backscatter, nine parameters; auto: if the colours of tracks show it", NULL},
{0}};
/* clang-format on */

OXL_INTERNAL const struct part part_medium = {.name = "medium",
                                              .size = sizeof(struct medium_fit),
                                              .option = medium_options,
                                              .is_branched = 1,
                                              .begin = medium_begin,
                                              .archive = medium_archive,
                                              .tracks = medium_tracks,
                                              .use_tracks = medium_use_tracks,
                                              .set_gain = medium_before_step,
                                              .form_image = medium_form_image,
                                              .before_render = medium_before_render,
                                              .after_loss = medium_after_loss,
                                              .after_step = medium_after_step,
                                              .store = medium_store,
                                              .describe = medium_describe};
