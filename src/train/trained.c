/* trained.c - trains a scene and returns all that comes of it: the model, its imaging, and a model for
 * viewers that know neither second lobes nor imaging.
 *
 * The model for viewers begins as the trained one without second lobes, with medium, or gains alone, baked
 * into its colours, and is refined for a twentieth of the run, or longer with a medium or gains.
 *
 * Invariant: the second run changes neither the model nor the imaging of the first.
 */
#include "train_state.h"
#include "trained.h"
#include "../formats/formats.h"
#include "../survey/scene.h"

#define VIEWER_STEPS 0.05 /* fraction of the run's steps for which the model for viewers is refined */
#define VIEWER_SH 10      /* factor on the rate of SH where the model learns the colours that a medium gave */
#define VIEWER_GAINS_SH 3 /* factor on the rate of SH where the model learns what gains gave */
#define VIEWER_GAINS_SH0 2 /* factor on the rate of base colours where the model learns what gains gave */
enum { TRAINED_STEPS_A_VIEW = 40 }; /* minimum steps for each view that unseen_drop renders */

OXL_INTERNAL int viewer_steps(const oxl_train_options *run)
{
    return OXL_MAX(1, (int)(VIEWER_STEPS * run->iterations));
}

/* Keeps the learning rates that the whole run has in its second half before its cool-down, not those of a run
 * of `steps`; but opacities and colours lose the factor of runs below SCHEDULE_BRISK_ITERATIONS. Momentum as
 * in Kerbl 2023. */
OXL_INTERNAL oxl_train_options train_refinement(const oxl_train_options *run, int sh_degree, int steps)
{
    const double short_run_factor = schedule_short_run_factor(run);
    oxl_train_options o = *run;
    o.iterations = steps;
    o.sh_degree = sh_degree;
    options_drop(&o, OXL_OPTION_NOT_REFINED);
    o.lr_position_final = (float)(short_run_factor * run->lr_position_final);
    o.lr_position = o.lr_position_final;
    o.lr_scale = schedule_scale_rate(run);
    o.lr_rotation = (float)(short_run_factor * run->lr_rotation);
    o.lr_sh = (float)(sqrt(short_run_factor) * run->lr_sh);
    if (o.medium == OXL_ON) o.medium = OXL_AUTO; /* Keeps the medium that the model has. */
    return o;
}

/* Returns the options of the second run. */
static oxl_train_options viewer_options(const oxl_train_options *run, int sh_degree, int steps,
                                        const struct oxl_imaging *m)
{
    const int drops_gains = imaging_is_gains_alone(m), hides = imaging_hides(m);
    oxl_train_options o = train_refinement(run, sh_degree, hides ? schedule_viewer_steps(steps) : steps);
    o.medium = OXL_OFF;
    if (drops_gains) {
        o.exposure = OXL_OFF;
        o.lr_sh0 *= VIEWER_GAINS_SH0, o.lr_sh *= VIEWER_GAINS_SH;
    } else if (hides) o.lr_sh *= VIEWER_SH;
    return o;
}

/* ---------------- both runs as one, to the caller */

struct trained_run {
    const oxl_callback *callback;
    int before;     /* iterations of the first run, during the second; else 0 */
    double seconds; /* of the first run */
    oxl_progress last;
};

static int trained_progress(void *user, const oxl_progress *progress)
{
    struct trained_run *r = user;
    oxl_progress p = *progress;
    const double left = r->last.seconds_left;
    p.iteration += r->before;
    p.iterations += r->before;
    p.seconds += r->seconds;
    /* The second run does not know the time of its first step: repeats what the first said last. */
    if (r->before && !(p.seconds_left > 0) && p.iteration < p.iterations) p.seconds_left = left;
    r->last = p;
    r->last.model = NULL;
    return context_report(r->callback, &p);
}

OXL_INTERNAL void nonfinite_add(oxl_nonfinite *to, const oxl_nonfinite *from)
{
    to->images += from->images;
    to->steps += from->steps;
    to->rows += from->rows;
    to->cleared += from->cleared;
}

/* ---------------- the model for viewers */

/* Copies the model without second lobes, with the medium, and with_gains the gains, in its colours. */
static oxl_result viewer_begin(oxl_context *ctx, const oxl_scene *scene, const oxl_trained *t, int with_gains,
                               oxl_model *out)
{
    const oxl_result rc = model_copy(ctx, &t->model, out);
    if (rc == OXL_OK) medium_make_standard(scene, t->imaging, with_gains, out);
    return rc;
}

static oxl_result viewer_refine(oxl_context *ctx, const oxl_scene *scene, const oxl_train_options *run,
                                const struct train_task *of, struct trained_run *progress, oxl_trained *t)
{
    struct text log = {.ctx = ctx}, notes = {.ctx = ctx};
    struct oxl_imaging seen = {0};
    struct train_task task = {.store = of->viewer_store,
                              .log = &log,
                              .notes = &notes,
                              .start = &t->viewer,
                              .imaging = &seen,
                              .surroundings = of->surroundings,
                              .window = of->window,
                              .viewed = of->viewed,
                              .frozen = 1};
    const oxl_train_options o = viewer_options(run, t->model.sh_degree, of->viewer_steps, t->imaging);
    oxl_model refined = {0};
    oxl_result rc = imaging_clone(ctx, t->imaging, (size_t)scene->view_count, &seen);
    if (rc == OXL_OK) rc = viewer_begin(ctx, scene, t, imaging_is_gains_alone(t->imaging), &t->viewer);
    imaging_hide(&seen, 1);
    if (rc == OXL_OK)
        rc = train_run(ctx, scene, &o, &(oxl_callback){trained_progress, progress}, &task, &refined);
    task.nonfinite.images -= OXL_MIN(task.nonfinite.images, t->nonfinite.images); /* out of both runs */
    nonfinite_add(&t->nonfinite, &task.nonfinite);
    t->finished = rc == OXL_OK && task.finished;
    oxl_model_free(ctx, &t->viewer);
    if (t->finished) OXL_SWAP(oxl_model, t->viewer, refined);
    oxl_model_free(ctx, &refined);
    imaging_free(ctx, &seen);
    text_free(&log);
    text_free(&notes);
    return rc;
}

/* ---------------- all of it */

/* Removes Gaussians that no training view shows, where a run is long enough for the time that this takes:
 * nothing trained them, and they float before other cameras. */
static oxl_result trained_trim(oxl_context *ctx, const oxl_scene *scene, const oxl_train_options *options,
                               oxl_trained *t)
{
    oxl_result rc = OXL_OK;
    if (schedule_training_views(scene) > options->iterations / TRAINED_STEPS_A_VIEW) return OXL_OK;
    rc = unseen_drop(ctx, scene, &t->model);
    if (rc == OXL_OK && t->viewer.count) rc = unseen_drop(ctx, scene, &t->viewer);
    if (rc == OXL_OK && t->model.count == 0)
        rc = oxl_fail(ctx, OXL_ERR_FAILED,
                      "no Gaussian is left\nfix: run oceanxl check, which examines cameras, points and "
                      "images");
    return rc;
}

/* Makes what the first run does not give. */
static oxl_result trained_complete(oxl_context *ctx, const oxl_scene *scene, const oxl_train_options *options,
                                   const struct train_task *task, struct trained_run *progress,
                                   oxl_trained *t)
{
    oxl_result rc = OXL_OK;
    if (t->finished && task->viewer_steps > 0 && (t->model.lobes > 0 || imaging_hides(t->imaging)))
        rc = viewer_refine(ctx, scene, options, task, progress, t);
    if (rc == OXL_OK && t->finished && task->trims) rc = trained_trim(ctx, scene, options, t);
    return rc;
}

OXL_INTERNAL oxl_result trained_make(oxl_context *ctx, const oxl_scene *scene,
                                     const oxl_train_options *options, const oxl_callback *callback,
                                     struct train_task *task, oxl_trained *out)
{
    const double started = os_seconds();
    oxl_train_options rest = *options;
    struct trained_run progress = {.callback = callback};
    struct text decisions = {.ctx = ctx};
    oxl_result rc;
    *out = (oxl_trained){.imaging = oxl_calloc(ctx, 1, sizeof *out->imaging)};
    if (!out->imaging) return OXL_ERR_MEMORY;
    if (task->imaging) OXL_SWAP(struct oxl_imaging, *task->imaging, *out->imaging);
    task->imaging = out->imaging;
    task->decisions = &decisions;
    rc = train_run(ctx, scene, options, &(oxl_callback){trained_progress, &progress}, task, &out->model);
    out->nonfinite = task->nonfinite;
    out->finished = task->finished;
    out->iterations = progress.last.iteration;
    progress.before = options->iterations, progress.seconds = progress.last.seconds;
    /* At least a moment, since 0 would be no limit. */
    if (rest.max_seconds > 0) rest.max_seconds = OXL_MAX(1e-3, rest.max_seconds - (os_seconds() - started));
    if (rc == OXL_OK) rc = trained_complete(ctx, scene, &rest, task, &progress, out);
    out->seconds = progress.last.seconds;
    if (rc == OXL_OK || (rc == OXL_ERR_INTERRUPTED && out->model.count > 0)) {
        const oxl_result taken = text_take(&decisions, &out->decisions);
        if (taken != OXL_OK) rc = taken;
    }
    text_free(&decisions);
    task->imaging = NULL, task->decisions = NULL;
    if (rc != OXL_OK && (rc != OXL_ERR_INTERRUPTED || out->model.count == 0)) oxl_trained_free(ctx, out);
    return rc;
}

/* ---------------- files */

/* Sets the view with which viewers begin: that of the training view nearest to the cameras' centre. */
static void trained_choose_view(const oxl_scene *scene, oxl_model *model)
{
    const int views = scene->view_count;
    double centre[3] = {0, 0, 0}, eye[3], nearest = HUGE_VAL;
    int training = 0;
    for (int v = 0; v < views; v++) {
        if (scene->view[v].is_test) continue;
        camera_position(&scene->view[v].camera, eye);
        training++;
        for (int k = 0; k < 3; k++) centre[k] += (eye[k] - centre[k]) / training;
    }
    for (int v = 0; v < views; v++) {
        const oxl_camera *c = &scene->view[v].camera;
        double far = 0;
        if (scene->view[v].is_test) continue;
        camera_position(c, eye);
        for (int k = 0; k < 3; k++) far += (eye[k] - centre[k]) * (eye[k] - centre[k]);
        if (!(far < nearest)) continue;
        nearest = far;
        model->view[0] = c->fx / OXL_MAX(c->width, c->height);
        memcpy(model->view + 1, c->rotation, sizeof c->rotation);
        for (int k = 0; k < 3; k++) model->view[10 + k] = eye[k] + scene->origin[k];
    }
}

static oxl_result trained_write_ply(oxl_context *ctx, const char *path, const oxl_scene *scene,
                                    const oxl_model *model, int degree)
{
    oxl_model seen = *model;
    trained_choose_view(scene, &seen);
    return model_file_write_ply(ctx, path, &seen, degree);
}

OXL_INTERNAL int trained_hides(const oxl_trained *t)
{
    return imaging_alters_colours(t->imaging) || (imaging_is_gains_alone(t->imaging) && t->viewer.count > 0);
}

oxl_result oxl_trained_write(oxl_context *ctx, const char *folder, const oxl_scene *scene,
                             const oxl_trained *t)
{
    oxl_imaging none = {0};
    oxl_trained plain = *t;
    if (!t->imaging) plain.imaging = &none, t = &plain;
    const int hides = trained_hides(t),
              is_standard = t->model.sh_degree == 3 && (hides || t->model.lobes == 0),
              makes = !t->viewer.count && (hides || t->model.lobes > 0);
    oxl_model made = {0};
    const oxl_model *viewer = makes             ? &made
                              : t->viewer.count ? &t->viewer
                                                : &t->model,
                    *shown = hides ? viewer : &t->model;
    const char *clear = PATH(folder, "scene_clear.ply"), *standard = PATH(folder, "scene_standard.ply"),
               *imaging = PATH(folder, "imaging.txt");
    oxl_result rc = imaging_check_scene(ctx, scene, t->imaging);
    if (rc == OXL_OK && t->model.count == 0)
        rc = oxl_fail(ctx, OXL_ERR_USAGE, "the result has no Gaussian; files are kept");
    if (rc == OXL_OK && makes) rc = viewer_begin(ctx, scene, t, 0, &made);
    if (rc == OXL_OK) rc = trained_write_ply(ctx, PATH(folder, "scene.ply"), scene, shown, shown->sh_degree);
    if (rc == OXL_OK && hides) rc = trained_write_ply(ctx, clear, scene, &t->model, t->model.sh_degree);
    if (rc == OXL_OK && !is_standard) rc = trained_write_ply(ctx, standard, scene, viewer, 3);
    if (rc == OXL_OK && imaging_is_needed(t->imaging))
        rc = oxl_imaging_write(ctx, imaging, scene, t->imaging);
    oxl_model_free(ctx, &made);
    if (rc != OXL_OK) return rc;
    if (!hides) os_remove(clear);
    if (is_standard) os_remove(standard);
    if (!imaging_is_needed(t->imaging)) os_remove(imaging);
    return OXL_OK;
}

oxl_result oxl_train(oxl_context *ctx, const oxl_scene *scene, const oxl_train_options *options,
                     const oxl_callback *callback, oxl_trained *out)
{
    struct train_task task = {.from = options->from, .viewer_steps = viewer_steps(options), .trims = 1};
    if (task.from && task.from->count == 0)
        return *out = (oxl_trained){0},
               oxl_fail(ctx, OXL_ERR_USAGE, "the model to start from has no Gaussian");
    return trained_make(ctx, scene, options, callback, &task, out);
}

void oxl_trained_free(oxl_context *ctx, oxl_trained *trained)
{
    if (!trained) return;
    oxl_model_free(ctx, &trained->model);
    oxl_model_free(ctx, &trained->viewer);
    oxl_imaging_free(ctx, trained->imaging);
    oxl_text_free(ctx, trained->decisions);
    *trained = (oxl_trained){.finished = 0};
}
