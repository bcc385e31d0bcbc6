/* medium.c - what a whole model looks like through the medium (medium.h), for viewers that know none. */
#include "kernels.h"
#include "../core/vecmath.h"
#include "../survey/scene.h"

/* of J: what is seen through more of the medium than this lets through is no evidence of it */
#define MEDIUM_MIN 0.02
#define MEDIUM_NEAR 1e-12 /* square of the range to a Gaussian in the camera, at least */
#define MEDIUM_DARK 0.02  /* J at the start, at least */

/* Gives the model what a viewer without imaging.txt is to show: the colours through the medium and, where
 * `imaging` has lamps, by these, or gains alone, by them, as the views see the centre; the mean of both terms
 * over these views, by the centre's size in the image, 1 / r^2; over all views, without the lamp's
 * polynomial, where none sees it. */
OXL_INTERNAL void medium_bake(const oxl_scene *scene, const struct oxl_imaging *imaging, int backwards,
                              oxl_model *model)
{
    enum { VIEWS = 64 };
    const struct medium *m = &imaging->medium;
    const oxl_camera *camera[VIEWS];
    const struct lamp *lamp[VIEWS];
    double eye[VIEWS][3];
    float gain[VIEWS][3];
    const int has_gains = !backwards && imaging_is_gains_alone(imaging);
    int views = 0;
    const int all = scene->view_count, stride = OXL_MAX(1, (all + VIEWS - 1) / VIEWS);
    const int coefficients = (model->sh_degree + 1) * (model->sh_degree + 1);
    if (backwards && !m->on && imaging->lamps == 0) return;
    for (int v = 0; v < all; v += stride, views++) {
        camera[views] = &scene->view[v].camera;
        lamp[views] = imaging_lamp(imaging, scene, v);
        camera_position(camera[views], eye[views]);
        gain[views][0] = gain[views][1] = gain[views][2] = 1;
        if (has_gains) oxl_imaging_gain(imaging, v, gain[views]);
    }
    for (size_t i = 0; i < model->count; i++) {
        /* over all views, over those that see it: both terms by channel, their number */
        double sum[2][7] = {{0}};
        for (int v = 0; v < views; v++) {
            const double p[3] = {model->plane[OXL_MEAN][i], model->plane[OXL_MEAN + 1][i],
                                 model->plane[OXL_MEAN + 2][i]};
            double at[3], pixel[2] = {0, 0};
            const int seen = camera_project(camera[v], p, NULL, at, pixel) && pixel[0] >= 0 &&
                             pixel[1] >= 0 && pixel[0] <= camera[v]->width && pixel[1] <= camera[v]->height;
            const double d[3] = {p[0] - eye[v][0], p[1] - eye[v][1], p[2] - eye[v][2]};
            const float range = (float)sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
            const double weight = 1 / OXL_MAX(range * range, MEDIUM_NEAR); /* its size in the image */
            float through[3] = {1, 1, 1}, veil[3] = {0};
            for (int c = 0; c < 3 && m->on; c++) {
                through[c] = real_exp(0, -m->attenuation[c] * (range - m->training_range));
                veil[c] = 1 - real_exp(0, -m->backscatter[c] * range);
            }
            for (int k = 0; k <= seen; k++) {
                const double light =
                    k && lamp[v] ? vecmath_exp(lamp_log_gain(lamp[v]->shape,
                                                             (float)(2 * pixel[0] / camera[v]->width - 1),
                                                             (float)(2 * pixel[1] / camera[v]->height - 1)))
                                 : 1;
                for (int c = 0; c < 3; c++) {
                    sum[k][c] += weight * light * gain[v][c] * through[c];
                    sum[k][3 + c] += weight * light * m->veiling_light[c] * veil[c];
                }
                sum[k][6] += weight;
            }
        }
        for (int c = 0; c < 3 && views > 0; c++) {
            const double *s = sum[sum[1][6] > 0], factor = s[c] / s[6], more = s[3 + c] / s[6];
            const double by = backwards ? 1 / OXL_MAX(factor, MEDIUM_MIN) : factor,
                         add = backwards ? -more * by : more;
            double colour;
            for (int k = 0; k < coefficients; k++)
                model->plane[OXL_SH + 3 * k + c][i] = (float)(by * model->plane[OXL_SH + 3 * k + c][i]);
            colour = 0.5 * by + add + MODEL_SH0 * model->plane[OXL_SH + c][i];
            /* noise is amplified; a colour below 0 has no gradient */
            if (backwards) colour = OXL_MAX(colour, MEDIUM_DARK);
            model->plane[OXL_SH + c][i] = (float)((colour - 0.5) / MODEL_SH0);
        }
    }
}

OXL_INTERNAL void medium_make_standard(const oxl_scene *scene, const struct oxl_imaging *imaging,
                                       int with_gains, oxl_model *model)
{
    const struct oxl_imaging medium = {.medium = imaging->medium};
    model_drop_lobes(model);
    if (with_gains) medium_bake(scene, imaging, 0, model);
    else if (imaging_alters_colours(&medium)) medium_bake(scene, &medium, 0, model);
}
