/* pose.c - applies a camera's pose beside that of the survey's files, six numbers, and takes the steps that
 * fit them.
 *
 * In the axes of the given camera, x_c = C(w) (R x + t - c): the camera is turned about its centre by w, and
 * its centre moves by c. C is Cayley's: the rotation of the quaternion (1, w / 2), by |w| to third order,
 * without sines.
 *
 * Adam (Kingma & Ba 2015) with a memory of few steps, since an image is visited once an epoch. Its step, m /
 * sqrt(v), is multiplied by its own size, and m begins at 0 without correction: gradients that agree over
 * some visits move the camera, those that do not leave it, by a tenth of the rate (docs/log). A move
 * of the centre by `depth` and a turn by 1 rad shift the image by as much, so one rate serves both.
 */
#include "scene.h"
#include "sparse.h"
#include "../core/vecmath.h"

#define POSE_BETA1 0.8
#define POSE_BETA2 0.95
#define POSE_EPSILON 1e-15 /* Keeps Adam from dividing by 0. */
/* Bounds a gradient, so that its square does not overflow; a larger one changes nothing. */
#define POSE_GRADIENT_MAX 1e18

OXL_INTERNAL int pose_is_moved(const double at[POSE_TERMS])
{
    for (int k = 0; k < POSE_TERMS; k++)
        if (at[k] != 0) return 1;
    return 0;
}

OXL_INTERNAL void pose_apply(const oxl_camera *given, const double at[POSE_TERMS], oxl_camera *out)
{
    double turn[9], t[3];
    camera_rotation_from_quaternion((double[4]){1, at[0] / 2, at[1] / 2, at[2] / 2}, turn);
    for (int i = 0; i < 3; i++) t[i] = given->translation[i] - at[3 + i];
    for (int i = 0; i < 3; i++) {
        for (int k = 0; k < 3; k++)
            out->rotation[3 * i + k] = turn[3 * i] * given->rotation[k] +
                                       turn[3 * i + 1] * given->rotation[3 + k] +
                                       turn[3 * i + 2] * given->rotation[6 + k];
        out->translation[i] = turn[3 * i] * t[0] + turn[3 * i + 1] * t[1] + turn[3 * i + 2] * t[2];
    }
}

OXL_INTERNAL void pose_step(struct pose *p, const oxl_camera *given, const double world[POSE_TERMS],
                            const struct pose_rule *rule)
{
    const double correct = 1 - vecmath_exp(++p->visits * vecmath_log(POSE_BETA2));
    oxl_camera now = *given;
    pose_apply(given, p->at, &now);
    for (int k = 0; k < POSE_TERMS; k++) {
        const double *row = k < 3 ? now.rotation + 3 * k : given->rotation + 3 * (k - 3),
                     *d = k < 3 ? world : world + 3, unit = k < 3 ? 1 : rule->depth;
        const double g = (row[0] * d[0] + row[1] * d[1] + row[2] * d[2]) * unit +
                         /* the prior of a turn, and of a move in units of the depth */
                         rule->prior * p->at[k] / unit;
        double agree;
        if (!(fabs(g) <= POSE_GRADIENT_MAX)) continue;
        p->mean[k] = POSE_BETA1 * p->mean[k] + (1 - POSE_BETA1) * g;
        p->square[k] = POSE_BETA2 * p->square[k] + (1 - POSE_BETA2) * g * g;
        agree = p->mean[k] / (sqrt(p->square[k] / correct) + POSE_EPSILON);
        p->at[k] -= rule->rate * unit * agree * fabs(agree);
        p->at[k] = OXL_CLAMP(p->at[k], -rule->most * unit, rule->most * unit);
    }
}

OXL_INTERNAL oxl_camera scene_camera(const oxl_scene *scene, const struct oxl_imaging *imaging, int view)
{
    oxl_camera camera = scene->view[view].camera;
    if (imaging && imaging->pose && pose_is_moved(imaging->pose[view]))
        pose_apply(&scene->view[view].camera, imaging->pose[view], &camera);
    return camera;
}

OXL_INTERNAL void scene_move_views(const oxl_scene *scene, double (*pose)[POSE_TERMS], oxl_scene *posed)
{
    const struct oxl_imaging moved = {.pose = pose};
    for (int v = 0; v < scene->view_count; v++) posed->view[v].camera = scene_camera(scene, &moved, v);
}

OXL_INTERNAL oxl_scene *scene_posed(oxl_context *ctx, const oxl_scene *scene)
{
    oxl_scene *own = oxl_alloc(ctx, 1, sizeof *own);
    oxl_view *view = oxl_alloc(ctx, (size_t)scene->view_count + 1, sizeof *view);
    if (!own || !view) {
        OXL_FREE(ctx, own, view);
        return NULL;
    }
    *own = *scene;
    own->view = view;
    memcpy(view, scene->view, (size_t)scene->view_count * sizeof *view);
    return own;
}

OXL_INTERNAL void scene_posed_free(oxl_context *ctx, oxl_scene *posed)
{
    if (posed) oxl_free(ctx, posed->view);
    oxl_free(ctx, posed);
}
