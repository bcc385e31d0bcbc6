/* medium.c - the nine parameters of the medium, from the tracks (render/medium.h has the model).
 *
 * They are fitted to the colours of tracks (survey/photometry.c) before the first step, and not trained: as
 * the Gaussians' colours are free, the images alone do not determine attenuation (docs/UNDERWATER.md). The
 * medium is removed from the initial Gaussians' colours once.
 *
 * During training J is the colour as seen through the median range. Otherwise Adam's steps of colour, which
 * are absolute, would change the image too little in turbid water.
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

/* optical depth of the median range: from there on a white surface is darker than one step of 8 bits */
#define MEDIUM_THICKEST 6

OXL_INTERNAL void medium_set_from_tracks(struct medium *m, double span, const struct photometry *p, char *why,
                                         size_t size)
{
    double most = 0; /* optical depth of the median range */
    for (int c = 0; c < 3; c++) most = OXL_MAX(most, p->attenuation[c] * (double)m->training_range);
    m->on = (p->parts & PHOTOMETRY_MEDIUM) && most <= MEDIUM_THICKEST;
    for (int c = 0; c < 3 && m->on; c++) {
        m->attenuation[c] = (float)p->attenuation[c];
        m->backscatter[c] = (float)p->backscatter[c];
        m->veiling_light[c] = (float)p->veiling_light[c];
    }
    if (m->on)
        snprintf(
            why, size,
            "haze grows with distance; residuals of %zu points in %zu observations are %.2f %% of white, %.2f "
            "without the medium; for red, green and blue: attenuation bD %.3g %.3g %.3g, backscatter bB %.3g %.3g %.3g, far water Binf %.3g %.3g %.3g",
            p->points, p->observations, 100 * p->with_medium, 100 * p->without[0], p->attenuation[0],
            p->attenuation[1], p->attenuation[2], p->backscatter[0], p->backscatter[1], p->backscatter[2],
            p->veiling_light[0], p->veiling_light[1], p->veiling_light[2]);
    else if (most > MEDIUM_THICKEST)
        snprintf(why, size, "its fit leaves no light of the scene: the images' exposures may differ");
    else if (!p->points) snprintf(why, size, "too few points are seen in several images");
    else
        snprintf(
            why, size,
            "%s; depths differ by a factor of %.1f; residuals of %zu points in %zu observations are %.2f %% of white, %.2f without the medium",
            span < SCENE_DEPTH_SPAN_MIN ? "depths differ too little to show haze"
                                        : "no haze grows with distance",
            span, p->points, p->observations, 100 * p->with_medium, 100 * p->without[0]);
}

/* Converts the model's colours from those of training to those without the medium, or back. */
static void medium_scale_colours(const struct medium *m, int to_clear, oxl_model *model)
{
    double factor[3];
    if (!m->on) return;
    for (int c = 0; c < 3; c++)
        factor[c] = vecmath_exp((to_clear ? 1 : -1) * (double)m->attenuation[c] * (double)m->training_range);
    model_scale_colour(model, factor);
}

/* ---------------- the part */

static oxl_result medium_begin(struct train *t, void *state)
{
    struct medium *m = state;
    const double range = scene_depth_quantile(t->scene, 0.5);
    if (t->options->medium == OXL_OFF) return OXL_OK;
    if (t->continues && t->imaging->medium.on) *m = t->imaging->medium;
    m->training_range = range > 0 ? (float)range : 1;
    medium_scale_colours(m, 0, &t->trained.model);
    return OXL_OK;
}

static int medium_tracks(const struct train *t, const void *state)
{
    (void)state;
    return t->options->medium != OXL_OFF ? PHOTOMETRY_MEDIUM : 0;
}

static void medium_use_tracks(struct train *t, void *state, const struct photometry *p)
{
    struct medium *m = state;
    const oxl_switch mode = t->options->medium;
    char why[400] = "";
    if (mode != OXL_OFF) medium_set_from_tracks(m, scene_depth_span(t->scene), p, why, sizeof why);
    selection_record_auto(t, "medium", mode, m->on, why);
    if (mode == OXL_ON && !m->on) oxl_log(t->ctx, OXL_LOG_WARNING, "no medium is modelled: %s", why);
}

static void medium_form_image(const void *state, struct oxl_imaging *m)
{
    const struct medium *medium = state;
    if (medium->on) m->medium = *medium;
}

static void medium_store(struct train *t, void *state, oxl_model *model)
{
    (void)t;
    if (model) medium_scale_colours(state, 1, model);
}

/* clang-format off */
static const oxl_option medium_options[] = {
{"medium", "off|on|auto", OXL_OPTION_CHOICE, OPTION_AT(train.medium), 0, 2, EACH("auto"), OXL_TIER_BASIC, TRAINING | RESULT, "Scene content", "fit the water: attenuation and backscatter, nine parameters; auto: if the colours of tracks show it; on: as auto, with a warning if they do not"},
{0}};
/* clang-format on */

OXL_INTERNAL const struct part part_medium = {.name = "medium",
                                              .size = sizeof(struct medium),
                                              .option = medium_options,
                                              .begin = medium_begin,
                                              .is_plain = 1,
                                              .tracks = medium_tracks,
                                              .use_tracks = medium_use_tracks,
                                              .form_image = medium_form_image,
                                              .store = medium_store};
