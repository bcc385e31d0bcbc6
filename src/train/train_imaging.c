/* train_imaging.c - exposure, lamp and medium of a run: decides from the tracks (survey/photometry.c), before
 * the first step, whether each is fitted, and sets its initial values; stores them in the scene after the
 * last step.
 *
 * The fits are exposure_fit.c, lamp.c and medium_fit.c. Invariant: what is off changes no byte of the result.
 */
#include "train_state.h"
#include "../survey/scene.h"

#define TRAIN_IMAGING_DRIFT 0.8 /* correlation of exposure with range from which a warning is due */
/* images and points differ by so much in a channel: first colours follow the images */
#define TRAIN_IMAGING_COLOUR 0.1

static void train_imaging_record(struct train *t, const char *what, oxl_switch mode, int on, const char *why)
{
    if (mode != OXL_AUTO) return;
    selection_record(t, what, on ? "on" : "off", why);
    oxl_log(t->ctx, OXL_LOG_INFO, "%s %s: %s", what, on ? "on" : "off", why);
}

/* Lamp and medium are rendered on the CPU. */
static int train_imaging_parts(const struct train *t)
{
    const oxl_train_options *o = t->options;
    const int cpu = !renderer_has_device(t->renderer);
    return (o->exposure != OXL_OFF ? PHOTOMETRY_GAINS : 0) |
           (o->lamp == OXL_ON || (o->lamp && cpu) ? PHOTOMETRY_LAMP : 0) |
           (o->medium == OXL_ON || (o->medium && cpu) ? PHOTOMETRY_MEDIUM : 0);
}

/* The first colours are those of the images, also where the survey's points have others: images that were
 * corrected after COLMAP. */
static void train_imaging_match_colours(struct train *t, const double colour[3])
{
    double most = 0;
    for (int c = 0; c < 3; c++) {
        if (!(colour[c] > 0)) return;
        most = OXL_MAX(most, fabs(colour[c] - 1));
    }
    if (most < TRAIN_IMAGING_COLOUR) return;
    model_scale_colour(&t->trained.model, colour);
    oxl_log(
        t->ctx, OXL_LOG_INFO,
        "the images' colours are %.2f, %.2f, %.2f (red green blue) times those of the survey's points: Gaussians begin with "
        "the images'",
        colour[0], colour[1], colour[2]);
}

OXL_INTERNAL oxl_result train_imaging_begin(struct train *t)
{
    const oxl_train_options *o = t->options;
    const int parts = train_imaging_parts(t);
    struct photometry p;
    char why[400];
    oxl_result rc = photometry_measure(t->ctx, t->scene, parts, &p);
    if (rc != OXL_OK) return rc;
    train_imaging_match_colours(t, p.colour);
    if (o->exposure != OXL_OFF) {
        exposure_set_from_tracks(&t->exposure, &p, why, sizeof why);
        train_imaging_record(t, "exposure", o->exposure, t->exposure.of.on, why);
    }
    if (parts & PHOTOMETRY_LAMP) lamp_set_from_tracks(&t->lamp, o->lamp, &p, why, sizeof why);
    train_imaging_record(t, "lamp", o->lamp, t->lamp.on, parts & PHOTOMETRY_LAMP ? why : TRAIN_ON_DEVICE);
    if (parts & PHOTOMETRY_MEDIUM)
        medium_fit_set_from_tracks(&t->medium_fit, medium_fit_span(t->scene), &p, why, sizeof why);
    train_imaging_record(t, "medium", o->medium, t->medium_fit.on,
                         parts & PHOTOMETRY_MEDIUM ? why : TRAIN_ON_DEVICE);
    if (t->medium_fit.on && fabs(p.drift) > TRAIN_IMAGING_DRIFT)
        oxl_log(
            t->ctx, OXL_LOG_WARNING,
            "the images' exposure is correlated with the range of what they show (%.2f): exposure and attenuation are not "
            "separated, and scene_clear.ply is not measured colour",
            p.drift);
    photometry_free(t->ctx, &p);
    if (t->medium_fit.on || t->lamp.on) {
        struct imaging m = step_imaging(t);
        medium_bake(t->scene, &m, 1, &t->trained.model);
    }
    return OXL_OK;
}

/* A medium that is asked for by name, and not known from tracks. */
OXL_INTERNAL oxl_result train_imaging_start_medium(struct train *t)
{
    struct imaging m;
    oxl_result rc;
    if (t->medium_fit.on || medium_fit_start_step(t->options) == 0 ||
        t->step < medium_fit_start_step(t->options))
        return OXL_OK;
    rc = step_download(t, DOWNLOAD_TO_CHANGE);
    if (rc != OXL_OK) return rc;
    medium_fit_start(&t->medium_fit, t->scene);
    m = (struct imaging){.medium = medium_fit_value(&t->medium_fit)};
    medium_bake(t->scene, &m, 1, &t->trained.model);
    return OXL_OK;
}

OXL_INTERNAL void train_imaging_describe(struct train *t)
{
    const struct imaging *m = &t->scene->imaging;
    const double span = medium_fit_span(t->scene);
    if (m->medium.has_falloff)
        oxl_log(t->ctx, OXL_LOG_INFO, "lamp on: light falls with range to the power of %.2f",
                (double)m->medium.falloff);
    if (m->medium.on)
        oxl_log(
            t->ctx, OXL_LOG_INFO,
            "medium on: bD %.3g %.3g %.3g, bB %.3g %.3g %.3g per unit, Binf %.3g %.3g %.3g (red green blue); depths span a "
            "factor of %.1f",
            (double)m->medium.attenuation[0], (double)m->medium.attenuation[1],
            (double)m->medium.attenuation[2], (double)m->medium.backscatter[0],
            (double)m->medium.backscatter[1], (double)m->medium.backscatter[2],
            (double)m->medium.veiling_light[0], (double)m->medium.veiling_light[1],
            (double)m->medium.veiling_light[2], span);
    if ((m->medium.on || m->medium.has_falloff) && span < MEDIUM_FIT_SPAN_MIN)
        oxl_log(
            t->ctx, m->medium.on ? OXL_LOG_WARNING : OXL_LOG_INFO,
            "the points' depths, without the nearest and the farthest tenth, span a factor of %.1f: medium and falloff are not identified, "
            "and scene_clear.ply is not measured colour",
            span);
}

OXL_INTERNAL void train_imaging_store(struct train *t)
{
    struct imaging *to = &t->scene->imaging;
    imaging_free(t->ctx, to);
    *to = t->exposure.of;
    to->medium = medium_fit_value(&t->medium_fit);
    to->medium.training_range = 0;
    lamp_store(&t->lamp, to);
    t->exposure.of = (struct imaging){0};
}
