/* water.c - the nine parameters of the medium, optimised with the scene (render/medium.h has the model).
 *
 * They are those that the colours of tracks give (survey/photometry.c), from the first step on, and are not trained: with the Gaussians'
 * colours free, the images alone do not hold attenuation (docs/WATER.md). The first Gaussians' colours are taken through the water once,
 * backwards.
 *
 * While trained, J counts as it looks through the median range: else Adam's steps of colour, which are absolute, would be small ones of
 * what is seen in turbid water.
 *
 * Without enough tracks `on` trains them: each is softplus of a free number (SeaSplat, WaterSplatting); attenuation and backscatter count
 * per median range of the survey's points, so that steps do not depend on COLMAP's scale. Adam (Kingma & Ba 2015), rate WATER_RATE, from
 * WATER_FROM of the run on.
 *
 * What it omits: the lamp's own backscatter, which is strongest near the camera; forward scatter, which blurs.
 *
 * Invariant: off changes no byte of the result. The state is archived.
 */
#include "train_parts.h"
#include "../core/vecmath.h"

#define WATER_RATE  0.01 /* 2.5e-3 to 1e-2 in the published ones */
#define WATER_FROM  0.3  /* of the run */
#define WATER_START 0.3  /* attenuation over the median range then */

static double water_softplus(double x)
{
    return x > 30 ? x : vecmath_log(1 + vecmath_exp(x));
}

static double water_inverse_softplus(double y)
{
    return y > 30 ? y : vecmath_log(vecmath_exp(y) - 1);
}

static double water_slope(double x)
{
    return 1 / (1 + vecmath_exp(-OXL_CLAMP(x, -80, 80)));
}

OXL_INTERNAL struct medium water_medium(const struct water *w)
{
    struct medium m = {.on = w->on};
    if (!w->on) return m;
    m.training_range = (float)w->range;
    for (int c = 0; c < 3; c++) {
        m.attenuation[c]   = (float)(water_softplus(w->raw[c]) / w->range);
        m.backscatter[c]   = (float)(water_softplus(w->raw[3 + c]) / w->range);
        m.veiling_light[c] = (float)water_softplus(w->raw[6 + c]);
    }
    return m;
}

/* Of the points' depths: 0.9 to 0.1 quantile. */
OXL_INTERNAL double water_span(oxl_scene *scene)
{
    const double near = scene_depth_quantile(scene, 0.1), far_ = scene_depth_quantile(scene, 0.9);
    return near > 0 ? far_ / near : 1;
}

static void water_set(struct water *w, const float attenuation[3], const float backscatter[3], const float veiling_light[3])
{
    for (int c = 0; c < 3; c++) {
        w->raw[c]     = water_inverse_softplus(OXL_MAX(attenuation[c] * w->range, 1e-6));
        w->raw[3 + c] = water_inverse_softplus(OXL_MAX(backscatter[c] * w->range, 1e-6));
        w->raw[6 + c] = water_inverse_softplus(OXL_MAX((double)veiling_light[c], 1e-6));
    }
}

OXL_INTERNAL void water_begin(struct water *w, oxl_scene *scene, const struct medium *continued)
{
    *w = (struct water){.range = scene_depth_quantile(scene, 0.5), .fixed = continued && continued->on};
    if (!(w->range > 0)) w->range = 1;
    if (!continued || !continued->on) return;
    w->on = 1;
    water_set(w, continued->attenuation, continued->backscatter, continued->veiling_light);
}

OXL_INTERNAL void water_set_from_tracks(struct water *w, double span, const struct photometry *p, char *why, size_t size)
{
    float value[3][3];
    w->on = w->fixed = (p->parts & PHOTOMETRY_WATER) && span >= WATER_SPAN_MIN;
    for (int c = 0; c < 3; c++)
        value[0][c] = (float)p->attenuation[c], value[1][c] = (float)p->backscatter[c], value[2][c] = (float)p->veiling_light[c];
    if (w->on) water_set(w, value[0], value[1], value[2]);
    snprintf(
        why, size,
        "%zu points in %zu observations: residuals %.2f %% of white, %.2f without water; red green blue, standard error: bD %.3g %.3g "
        "%.3g (%.0f %.0f %.0f %%), bB %.3g %.3g %.3g (%.0f %.0f %.0f %%), Binf %.3g %.3g %.3g",
        p->points, p->observations, 100 * p->residual, 100 * p->without[0], p->attenuation[0], p->attenuation[1],
        p->attenuation[2], 100 * p->error[0], 100 * p->error[1], 100 * p->error[2], p->backscatter[0], p->backscatter[1],
        p->backscatter[2], 100 * p->error[3], 100 * p->error[4], 100 * p->error[5], p->veiling_light[0], p->veiling_light[1],
        p->veiling_light[2]);
    if (span < WATER_SPAN_MIN)
        snprintf(why, size, "the points' depths span a factor of %.1f: less than %d does not identify water", span,
                 WATER_SPAN_MIN);
    else if (!p->points) snprintf(why, size, "too few tracks to compare colours");
    else if (!w->on)
        snprintf(why, size, "%zu points in %zu observations: residuals %.2f %% of white, %.2f without water", p->points,
                 p->observations, 100 * p->residual, 100 * p->without[0]);
}

OXL_INTERNAL int water_starts_at(const oxl_train_options *o)
{
    return o->medium == OXL_ON ? OXL_MAX(1, (int)(WATER_FROM * o->iterations)) : 0;
}

/* First values where the tracks give none: WATER_START over the median range, and the points' mean colour as veil. */
OXL_INTERNAL void water_start(struct water *w, oxl_scene *scene)
{
    const oxl_point *point = oxl_scene_points(scene);
    const size_t     count = oxl_scene_point_count(scene);
    const float      start = (float)(WATER_START / w->range), some[3] = {start, start, start};
    float            veil[3];
    for (int c = 0; c < 3; c++) {
        double mean = 0;
        for (size_t i = 0; i < count; i++) mean += point[i].rgb[c] / 255.0;
        veil[c] = (float)OXL_CLAMP(count > 0 ? mean / (double)count : 0.3, 0.05, 0.9);
    }
    w->on = 1;
    water_set(w, some, some, veil);
}

OXL_INTERNAL void water_scale(const struct water *w, int to_clear, oxl_model *model)
{
    const struct medium m = water_medium(w);
    double              factor[3];
    if (!w->on) return;
    for (int c = 0; c < 3; c++)
        factor[c] = vecmath_exp((to_clear ? 1 : -1) * (double)m.attenuation[c] * (double)m.training_range);
    model_scale_colour(model, factor);
}

OXL_INTERNAL void water_step(struct water *w, double progress, const double gradient[9])
{
    const double rate = WATER_RATE * vecmath_exp(OXL_MAX(0, progress - 0.5) * 2 * vecmath_log(0.1));
    if (w->fixed) return;
    w->steps++;
    for (int k = 0; k < 9; k++) {
        const double g = gradient[k] * water_slope(w->raw[k]) / (k < 6 ? w->range : 1);
        scalar_adam_step(&w->raw[k], &w->first[k], &w->second[k], g, rate, w->steps);
    }
}

OXL_INTERNAL void water_archive(struct archive *a, struct water *w, int used)
{
    if (!used) return;
    archive_int(a, &w->on);
    archive_int(a, &w->fixed);
    archive_int(a, &w->steps);
    archive_doubles(a, w->raw, 9);
    archive_doubles(a, w->first, 9);
    archive_doubles(a, w->second, 9);
    for (int k = 0; k < 9 && a->rc == OXL_OK; k++)
        archive_expect(a, fabs(w->raw[k]) <= 1e6 && fabs(w->first[k]) <= DBL_MAX && w->second[k] >= 0);
    archive_expect(a, (w->on == 0 || w->on == 1) && (w->fixed == 0 || w->fixed == 1) && w->steps >= 0);
}
