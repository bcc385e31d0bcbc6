/* lamp.c - a light that moves with the camera, optimised with the scene.
 *
 * Model: the rendered image times exp(s(x, y)), s a polynomial of degree 4 of zero mean over the image, one
 * for each physical camera (imaging_camera, survey/imaging.c). A survey's light that stands still has s = 0,
 * where it begins. Light also falls with distance: that looks like attenuation, and counts as such in the fit
 * of a medium.
 *
 * s starts from the fit to the tracks (survey/photometry.c), which also shows whether it is needed; Adam
 * (Kingma & Ba 2015) from LAMP_FROM of the run on. Gauge: s has no constant term, so
 * the lamp changes neither the brightness of the scene nor the mean gain.
 *
 * Rendering on a device, a step's lamp does not depend on the gradient of the step before, which is read
 * while the device works on the step; see exposure.c.
 *
 * Invariant: off changes no byte of the result. The state is archived.
 */
#include "lamp.h"
#include "../core/option_rows.h"
#include "../core/vecmath.h"
#include "../survey/scene.h"

#define LAMP_FROM 0.11 /* of the run: Gaussians are rough before */
#define LAMP_RATE 0.01 /* learning rate at the start, in log units */
#define LAMP_LAST 0.05 /* of LAMP_RATE: the rate at the end of the run */

static oxl_result lamp_begin(struct train *t, void *state)
{
    struct lamp_fit *l = state;
    const struct oxl_imaging *continued = t->continues ? t->imaging : NULL;
    if (t->options->lamp == OXL_OFF) return OXL_OK;
    l->frozen = t->task.frozen || t->task.surroundings; /* a block sees a part of each image */
    l->groups = 1, l->group[0].view = -1;
    if (!continued) l->groups = imaging_set_lamps(t->scene, l->group);
    if (!continued || continued->lamps == 0) return OXL_OK;
    l->on = 1, l->groups = continued->lamps;
    memcpy(l->group, continued->lamp, sizeof l->group);
    return OXL_OK;
}

OXL_INTERNAL void lamp_set_from_tracks(struct lamp_fit *l, oxl_switch mode, const struct photometry *p,
                                       char *why, size_t size)
{
    const int fits = (p->parts & PHOTOMETRY_LAMP) != 0;
    l->on = fits || mode == OXL_ON;
    for (int g = 0; g < l->groups && fits; g++) memcpy(l->group[g].shape, p->shape[g], sizeof p->shape[g]);
    snprintf(
        why, size,
        "light is %s across the images; residuals of %zu points in %zu observations are %.2f %% of white, %.2f without a lamp",
        fits ? "uneven (a lamp or vignetting)" : "even", p->points, p->observations, 100 * p->residual,
        100 * p->without[1]);
    if (!p->points) snprintf(why, size, "too few points are seen in several images");
}

/* Takes the step of the pending gradient, unless its step is later than `last`. */
static void lamp_apply_pending(struct lamp_fit *l, int last)
{
    struct lamp_gradient *p = &l->pending;
    const double rate = LAMP_RATE * vecmath_exp(p->progress * vecmath_log(LAMP_LAST));
    const int g = p->group;
    if (p->step == 0 || p->step > last) return;
    p->step = 0;
    if (p->progress < LAMP_FROM || l->frozen) return;
    l->steps++, l->visits[g]++;
    for (int k = 0; k < LAMP_TERMS; k++) {
        double at = l->group[g].shape[k];
        scalar_adam_step(&at, &l->mean[g][k], &l->square[g][k], p->shape[k], rate, l->visits[g]);
        l->group[g].shape[k] = (float)OXL_CLAMP(at, -LAMP_SHAPE_MAX, LAMP_SHAPE_MAX);
    }
}

/* ---------------- the part */

static int lamp_tracks(const struct train *t, const void *state)
{
    (void)state;
    return t->options->lamp != OXL_OFF ? PHOTOMETRY_LAMP : 0;
}

static void lamp_use_tracks(struct train *t, void *state, const struct photometry *p)
{
    struct lamp_fit *l = state;
    char why[400] = "";
    if (t->options->lamp != OXL_OFF) lamp_set_from_tracks(l, t->options->lamp, p, why, sizeof why);
    selection_record_auto(t, "lamp", t->options->lamp, l->on, why);
}

static void lamp_form_image(const void *state, struct oxl_imaging *m)
{
    const struct lamp_fit *l = state;
    m->lamps = l->on ? l->groups : 0;
    if (l->on) memcpy(m->lamp, l->group, sizeof m->lamp);
}

static oxl_result lamp_before_render(struct train *t, void *state, struct part_view *v)
{
    struct lamp_fit *l = state;
    const struct lamp *lamp = imaging_lamp(&v->imaging, t->scene, v->view);
    if (lamp) l->drawn = *lamp;
    renderer_settings(t->renderer)->lamp = lamp ? &l->drawn : NULL;
    return OXL_OK;
}

static void lamp_before_step(struct train *t, void *state, struct train_deferred *step, int learns)
{
    (void)step;
    if (learns) lamp_apply_pending(state, t->step - 2);
}

static void lamp_after_loss(struct train *t, void *state, const struct train_deferred *step,
                            const struct renderer_loss *loss)
{
    struct lamp_fit *l = state;
    const int group = l->on ? imaging_find_lamp(t->scene, l->group, l->groups, step->view) : -1;
    if (group < 0) return;
    lamp_apply_pending(l, INT_MAX);
    l->pending = (struct lamp_gradient){
        .step = step->step, .group = group, .progress = (double)step->step / t->options->iterations};
    memcpy(l->pending.shape, loss->dlamp, sizeof l->pending.shape);
    if (!renderer_has_device(t->renderer)) lamp_apply_pending(l, INT_MAX);
}

/* clang-format off */
static const oxl_option lamp_options[] = {
{"lamp", "off|on|auto", OXL_OPTION_CHOICE, OPTION_AT(train.lamp), 0, 2, EACH("auto"), OXL_TIER_BASIC, TRAINING | RESULT, "Scene content", "fit a light that moves with the camera, or vignetting, as a smooth gain over the image; auto: if the colours of tracks show it"},
{0}};
/* clang-format on */

OXL_INTERNAL const struct part part_lamp = {.name = "lamp",
                                            .size = sizeof(struct lamp_fit),
                                            .option = lamp_options,
                                            .begin = lamp_begin,
                                            .is_plain = 1,
                                            .tracks = lamp_tracks,
                                            .use_tracks = lamp_use_tracks,
                                            .set_gain = lamp_before_step,
                                            .form_image = lamp_form_image,
                                            .before_render = lamp_before_render,
                                            .after_loss = lamp_after_loss};
