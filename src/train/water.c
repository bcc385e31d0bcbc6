/* water.c - the nine parameters of the medium, optimised with the scene (render/medium.c has the model).
 *
 * Each is softplus of a free number (SeaSplat, WaterSplatting); attenuation and backscatter count per median range of the survey's
 * points, so that steps do not depend on COLMAP's scale. Adam (Kingma & Ba 2015), rate WATER_RATE. They start at WATER_FROM of the
 * run from the survey's fit of contrast against depth (survey/contrast.c), and from the mean colour of its points for the veil. What is rendered at the median range stays what it was:
 * the Gaussians' colours are taken through the water once, backwards.
 *
 * What it omits: the lamp's own backscatter, which is strongest near the camera; forward scatter, which blurs.
 *
 * Invariant: off changes no byte of the result. The state is archived.
 */
#include "train.h"
#include "../core/vecmath.h"

#define WATER_RATE  0.01 /* 2.5e-3 to 1e-2 in the published ones */
#define WATER_FROM  0.3  /* of the run */
#define WATER_LEAST 0.1  /* attenuation over the median range at the start, at least */
#define WATER_MOST  1.0  /* and at most: colours are divided by exp of minus it */

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
    for (int c = 0; c < 3; c++) {
        m.direct[c]  = (float)(water_softplus(w->raw[c]) / w->range);
        m.scatter[c] = (float)(water_softplus(w->raw[3 + c]) / w->range);
        m.veil[c]    = (float)water_softplus(w->raw[6 + c]);
    }
    return m;
}

/* Of the points' depths: 0.9 to 0.1 quantile. */
OXL_INTERNAL double water_span(oxl_scene *scene)
{
    const double near = scene_depth_quantile(scene, 0.1), far_ = scene_depth_quantile(scene, 0.9);
    return near > 0 ? far_ / near : 1;
}

OXL_INTERNAL int water_starts_at(const oxl_train_options *o)
{
    return o->medium != OXL_OFF ? OXL_MAX(1, (int)(WATER_FROM * o->iterations)) : 0;
}

OXL_INTERNAL oxl_result water_begin(oxl_context *ctx, struct water *w, oxl_scene *scene, const struct medium *goes_on)
{
    struct contrast  fades;
    const oxl_point *point = oxl_scene_points(scene);
    const size_t     count = oxl_scene_point_count(scene);
    oxl_result       rc    = contrast_measure(ctx, scene, &fades);
    *w                     = (struct water){.range = scene_depth_quantile(scene, 0.5)};
    if (rc != OXL_OK) return rc;
    if (!(w->range > 0)) w->range = 1;
    for (int c = 0; c < 3; c++) {
        const double beta = fades.measured ? fades.beta * w->range : 0;
        double       mean = 0;
        for (size_t i = 0; i < count; i++) mean += point[i].rgb[c] / 255.0;
        w->raw[c] = w->raw[3 + c] = water_inverse_softplus(OXL_CLAMP(beta, WATER_LEAST, WATER_MOST));
        w->raw[6 + c]             = water_inverse_softplus(OXL_CLAMP(count > 0 ? mean / (double)count : 0.3, 0.05, 0.9));
    }
    if (!goes_on) return OXL_OK;
    w->decided = 1;
    w->on      = goes_on->on;
    for (int c = 0; c < 3 && w->on; c++) {
        w->raw[c]     = water_inverse_softplus(goes_on->direct[c] * w->range);
        w->raw[3 + c] = water_inverse_softplus(goes_on->scatter[c] * w->range);
        w->raw[6 + c] = water_inverse_softplus(goes_on->veil[c]);
    }
    return OXL_OK;
}

/* From now on; the colours at the median range are to look as they do. */
OXL_INTERNAL void water_start(struct water *w, oxl_model *model)
{
    struct medium m;
    w->on = 1;
    m     = water_medium(w);
    for (int c = 0; c < 3; c++) {
        const double through = vecmath_exp(-m.direct[c] * w->range),
                     veil    = m.veil[c] * (1 - vecmath_exp(-m.scatter[c] * w->range));
        double factor[3]     = {1, 1, 1};
        factor[c]            = 1 / through;
        model_scale_colour(model, factor);
        for (size_t i = 0; i < model->count; i++) model->plane[OXL_SH + c][i] -= (float)(veil / through / MODEL_SH0);
    }
}

OXL_INTERNAL void water_step(struct water *w, double progress, const double gradient[9])
{
    const double rate = WATER_RATE * vecmath_exp(OXL_MAX(0, progress - 0.5) * 2 * vecmath_log(0.1));
    double       c1, c2;
    w->steps++;
    c1 = 1 - vecmath_exp(w->steps * vecmath_log(0.9)), c2 = 1 - vecmath_exp(w->steps * vecmath_log(0.999));
    for (int k = 0; k < 9; k++) {
        const double g = gradient[k] * water_slope(w->raw[k]) / (k < 6 ? w->range : 1);
        if (!(fabs(g) <= 1e18)) continue;
        w->first[k]  = 0.9 * w->first[k] + 0.1 * g;
        w->second[k] = 0.999 * w->second[k] + 0.001 * g * g;
        w->raw[k] -= rate * (w->first[k] / c1) / (sqrt(w->second[k] / c2) + 1e-15);
    }
}

OXL_INTERNAL void water_archive(struct archive *a, struct water *w, int used)
{
    if (!used) return;
    archive_int(a, &w->on);
    archive_int(a, &w->decided);
    archive_int(a, &w->steps);
    archive_doubles(a, w->raw, 9);
    archive_doubles(a, w->first, 9);
    archive_doubles(a, w->second, 9);
    for (int k = 0; k < 9 && a->rc == OXL_OK; k++)
        archive_expect(a, fabs(w->raw[k]) <= 1e6 && fabs(w->first[k]) <= DBL_MAX && w->second[k] >= 0);
    archive_expect(a, (w->on == 0 || w->on == 1) && (w->decided == 0 || w->decided == 1) && w->steps >= 0);
}
