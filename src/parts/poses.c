/* poses.c - the pose of each training view's camera, refined with the scene.
 *
 * Poses estimated by structure from motion shift images by about a pixel, and by several where a survey has
 * few tracks; such errors blur the model. Each training view has a turn and a move of its own
 * (survey/pose.c), which take a step at each visit by the exact gradient of the loss (render/pose.h).
 *
 * Gradients find a shift of a few pixels. At POSES_SEARCH of the run, a view whose render is displaced
 * farther is turned by the shift that explains its error (survey/misfit.c).
 *
 * Held-out views keep their poses: they are test data, so that PSNR compares runs with and without.
 *
 * Gauge: poses and scene could drift together, away from the poses of held-out views. After each epoch the
 * mean turn and the mean move of all training views, in the axes of the world, are set to zero.
 *
 * auto: begins as on, and returns to the given poses where, at POSES_DECIDE of the run, the images have not
 * shifted by more than the noise of the steps.
 *
 * In a survey of several blocks the coarse model refines them, and all blocks use its poses.
 *
 * Invariant: off changes no byte of the result. The scene keeps the given poses until the run ends or pauses.
 * The state is archived.
 */
#include "poses.h"
#include "../core/option_rows.h"
#include "../core/vecmath.h"
#include "../survey/scene.h"
#include "../survey/survey.h"

#define POSES_FROM 0.05    /* of the run: Gaussians are rough before */
#define POSES_SEARCH 0.2   /* of the run: renders show whose images are displaced */
#define POSES_FAR 2.0      /* px: by more than this */
#define POSES_DECIDE 0.4   /* of the run: auto */
#define POSES_SHIFT 0.2    /* px, root of the mean square: smaller ones are the noise of the steps */
#define POSES_RATE 1.0     /* px by which the first step shifts an image, at most */
#define POSES_LAST 0.02    /* of that at the end of the run */
#define POSES_MOST 0.05    /* rad, of a turn in all; of the depth, of a move */
#define POSES_PRIOR 2.5e-4 /* gradient by a view's shift of one error of the points, times that error; */
#define POSES_ERROR 0.25   /* px: instead of a smaller error, or an unknown one */

static oxl_result poses_allocate(oxl_context *ctx, struct poses *p, const oxl_scene *scene)
{
    const size_t views = (size_t)scene->view_count;
    p->depth = scene_depth_quantile(scene, 0.5);
    if (!(p->depth > 0)) p->depth = scene->extent;
    p->view = oxl_calloc(ctx, views + 1, sizeof *p->view);
    p->pose = oxl_calloc(ctx, views + 1, sizeof *p->pose);
    return p->view && p->pose ? OXL_OK : OXL_ERR_MEMORY;
}

/* Keeps the poses of a continued run, else begins with those of the survey. */
static oxl_result poses_before_points(struct train *t, void *state)
{
    struct poses *p = state;
    double(*kept)[POSE_TERMS] = t->continues ? t->imaging->pose : NULL;
    oxl_result rc = OXL_OK;
    /* of a block, views are seen in part */
    p->asked = t->options->poses != OXL_OFF && !t->continues && !t->task.window && !t->task.surroundings;
    if (p->asked || kept) rc = poses_allocate(t->ctx, p, t->scene);
    if (rc != OXL_OK || !kept) return rc;
    memcpy(p->pose, kept, (size_t)t->scene->view_count * sizeof *kept);
    scene_move_views(t->survey, kept, t->posed);
    return OXL_OK;
}

static oxl_result poses_begin(struct train *t, void *state)
{
    struct poses *p = state;
    p->on = p->asked && !renderer_has_device(t->renderer);
    if (p->on || !p->asked) return OXL_OK;
    selection_record_auto(t, "poses", t->options->poses, 0, "a device does not compute their gradient");
    oxl_log(t->ctx, OXL_LOG_WARNING, "poses are not refined: only the CPU computes their gradient");
    return OXL_OK;
}

static void poses_free(struct train *t, void *state)
{
    struct poses *p = state;
    OXL_FREE(t->ctx, p->view, p->pose);
    *p = (struct poses){0};
}

static void poses_archive(struct archive *a, struct train *t, void *state)
{
    struct poses *p = state;
    if (!p->asked) return;
    ARCHIVE(a, &p->on, 1);
    ARCHIVE(a, &p->steps, 1);
    ARCHIVE(a, p->view, (size_t)t->scene->view_count);
}

static oxl_result poses_before_render(struct train *t, void *state, struct part_view *v)
{
    const struct poses *p = state;
    if (p->on) pose_apply(&t->scene->view[v->view].camera, p->view[v->view].at, &v->camera);
    renderer_settings(t->renderer)->pose = p->on && v->progress >= POSES_FROM;
    return OXL_OK;
}

/* Sets the mean turn and move of the visited views to zero, in the axes of the world. */
static void poses_centre(struct poses *p, const oxl_scene *scene)
{
    double mean[POSE_TERMS] = {0};
    int count = 0;
    for (int pass = 0; pass < 2; pass++)
        for (int v = 0; v < scene->view_count; v++) {
            const double *r = scene->view[v].camera.rotation;
            double *at = p->view[v].at;
            if (p->view[v].visits == 0) continue;
            count += pass == 0;
            for (int k = 0; k < POSE_TERMS; k++)
                for (int i = 0, part = k / 3 * 3; i < 3; i++) {
                    if (pass == 0) mean[k] += r[3 * i + k % 3] * at[part + i];
                    else at[k] -= r[3 * (k % 3) + i] * mean[part + i] / count;
                }
        }
}

/* Returns the pull of a view: what its shift by the mean reprojection error of the survey's points costs. */
static double poses_prior(const oxl_scene *scene, int view)
{
    const oxl_camera *c = &scene->view[view].camera;
    const double file = scene_file_pixels(scene, view), shown = (double)c->width * c->height;
    const double error = scene->stats.mean_error * (file > 0 ? sqrt(shown / file) : 1);
    const double f = c->fx / OXL_MAX(error, POSES_ERROR);
    return POSES_PRIOR * f * f;
}

static void poses_after_loss(struct train *t, void *state, const struct train_deferred *step,
                             const struct renderer_loss *loss)
{
    struct poses *p = state;
    const oxl_camera *given = &t->scene->view[step->view].camera;
    const double progress = ((double)step->step / t->options->iterations - POSES_FROM) / (1 - POSES_FROM);
    const struct pose_rule rule = {.rate = POSES_RATE / given->fx *
                                           vecmath_exp(progress * vecmath_log(POSES_LAST)),
                                   .most = POSES_MOST,
                                   .prior = poses_prior(t->scene, step->view),
                                   .depth = p->depth};
    (void)loss;
    if (!p->on || progress < 0) return;
    pose_step(&p->view[step->view], given, renderer_pose_gradient(t->renderer), &rule);
    if (++p->steps % t->views == 0) poses_centre(p, t->scene);
}

/* Returns how far turns and moves shift the images, px, root of the mean square. */
static double poses_shift(const struct poses *p, const oxl_scene *scene)
{
    double sum = 0;
    int count = 0;
    for (int v = 0; v < scene->view_count; v++) {
        const double f = scene->view[v].camera.fx, *at = p->view[v].at;
        if (p->view[v].visits == 0) continue;
        count++;
        for (int k = 0; k < POSE_TERMS; k++) {
            const double a = f * at[k] / (k < 3 ? 1 : p->depth);
            sum += a * a;
        }
    }
    return sqrt(count ? sum / count : 0);
}

/* Turns the cameras whose renders are displaced too far for gradients to bring them home. */
static oxl_result poses_search(struct train *t, struct poses *p)
{
    oxl_result rc = step_flush(t);
    for (int v = 0; v < t->scene->view_count && rc == OXL_OK; v++) {
        const oxl_camera *given = &t->scene->view[v].camera;
        oxl_camera camera = *given;
        oxl_image image = {0}, rendered = {0};
        struct misfit m = {0};
        double *at = p->view[v].at, x, y;
        if (p->view[v].visits == 0) continue;
        pose_apply(given, at, &camera);
        rc = scene_copy_image(t->ctx, t->scene, v, &image);
        if (rc == OXL_OK) rc = oxl_render(t->ctx, &t->trained.model, &camera, &t->render, &rendered, NULL);
        if (rc == OXL_OK) rc = misfit_measure(t->ctx, &rendered, &image, &m);
        x = m.shift[0] / given->fx, y = m.shift[1] / given->fy;
        if (m.explained > MISFIT_EVIDENT && OXL_MAX(fabs(m.shift[0]), fabs(m.shift[1])) > POSES_FAR) {
            at[0] = OXL_CLAMP(at[0] + y, -POSES_MOST, POSES_MOST);
            at[1] = OXL_CLAMP(at[1] - x, -POSES_MOST, POSES_MOST);
        }
        oxl_image_free(t->ctx, &image);
        oxl_image_free(t->ctx, &rendered);
    }
    return rc;
}

/* auto: returns to the given poses where they were not found to be off. */
static oxl_result poses_after_step(struct train *t, void *state)
{
    struct poses *p = state;
    char why[200];
    double shift;
    if (p->on && t->step == (int)(POSES_SEARCH * t->options->iterations)) {
        const oxl_result rc = poses_search(t, p);
        if (rc != OXL_OK) return rc;
    }
    if (!p->on || t->options->poses != OXL_AUTO || t->step != (int)(POSES_DECIDE * t->options->iterations))
        return OXL_OK;
    shift = poses_shift(p, t->scene);
    snprintf(why, sizeof why, "images shift by %.2f px; rms after %d steps; on from %.2g px", shift, t->step,
             POSES_SHIFT);
    p->on = shift >= POSES_SHIFT;
    selection_record_auto(t, "poses", OXL_AUTO, p->on, why);
    return OXL_OK;
}

static void poses_store(struct train *t, void *state, oxl_model *model)
{
    struct poses *p = state;
    (void)model;
    for (int v = 0; p->on && v < t->scene->view_count; v++)
        memcpy(p->pose[v], p->view[v].at, sizeof p->pose[v]);
    if (!p->asked || p->on) t->imaging->pose = p->pose, p->pose = NULL;
}

/* clang-format off */
static const oxl_option poses_options[] = {
{"poses", "off|on|auto", OXL_OPTION_CHOICE, OPTION_AT(train.poses), 0, 2, EACH("off"), OXL_TIER_ADVANCED, TRAINING | RESULT, "Scene content", "refine the training views' poses with the scene, on the CPU; auto: keep the refined poses if images shift by 0.2 px"},
{0}};
/* clang-format on */

OXL_INTERNAL const struct part part_poses = {.name = "poses",
                                             .size = sizeof(struct poses),
                                             .option = poses_options,
                                             .before_points = poses_before_points,
                                             .begin = poses_begin,
                                             .free = poses_free,
                                             .archive = poses_archive,
                                             .before_render = poses_before_render,
                                             .after_loss = poses_after_loss,
                                             .after_step = poses_after_step,
                                             .store = poses_store};
