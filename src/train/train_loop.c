/* train_loop.c - the loop over steps (Kerbl et al. 2023, Alg. 1), from the first model to the last
 * checkpoint.
 *
 * Invariant: the state after step n is a function of the scene, the options, the seed and n alone.
 */
#include "parts_calls.h"
#include "../core/vecmath.h"
#include "../survey/scene.h"
#include "../survey/survey.h"

#define TRAIN_SHORT_RUN_WIDTH 0.3   /* power of the short-run factor by which the first widths are divided */
#define TRAIN_SHORT_RUN_OPACITY 0.7 /* power of it by which the first opacities are multiplied */
#define TRAIN_OPACITY_MAX 0.3       /* the most that this makes of an opacity */
enum { TRAIN_FIRST_LEAST = 100 };   /* points that are a start, where the survey has none */
enum { TRAIN_SEEN = 64 };           /* views, evenly spaced, in which points are looked for first */
enum { TRAIN_SHARE_PAIRS = 1 << 17 }; /* of a Gaussian and a view, from which a share is taken */

/* ---------------- the run */

/* Lists the points that a training view has in its image. */
static size_t train_seen_points(oxl_context *ctx, const oxl_scene *scene, size_t *row)
{
    const int views = scene->view_count, step = (views - 1) / TRAIN_SEEN + 1;
    size_t seen = 0;
    (void)ctx; /* without OpenMP */
#pragma omp parallel for schedule(dynamic, 1024) num_threads(ctx->threads)
    for (int64_t i = 0; i < (int64_t)scene->point_count; i++) {
        double x[3], at[2];
        row[i] = 0;
        for (int k = 0, v = 0; k < views && !row[i]; k++, v = v + step < views ? v + step : v % step + 1)
            row[i] = !scene->view[v].is_test &&
                     camera_sees(&scene->view[v].camera, scene->point[i].position, x, at);
    }
    for (size_t i = 0; i < scene->point_count; i++)
        if (row[i]) row[seen++] = i;
    return seen;
}

OXL_INTERNAL oxl_result train_some_points(oxl_context *ctx, const oxl_scene *scene, size_t most,
                                          oxl_point **out, size_t *count)
{
    const size_t all = scene->point_count;
    size_t *row, seen;
    if (all == 0) return scene_start_points(ctx, scene, OXL_MIN(scene_start_count(scene), most), out, count);
    row = oxl_alloc(ctx, all, sizeof *row);
    seen = row ? train_seen_points(ctx, scene, row) : 0;
    *count = OXL_MIN(seen, most);
    *out = row ? oxl_alloc(ctx, *count + 1, sizeof **out) : NULL;
    for (size_t i = 0; *out && i < *count; i++)
        (*out)[i] = scene->point[row[(size_t)((double)i * (double)seen / (double)*count)]];
    oxl_free(ctx, row);
    return *out ? OXL_OK : OXL_ERR_MEMORY;
}

/* Starts from `most` points of the survey, which has more, or from random ones. */
static oxl_result train_first_from_some(struct train *t, size_t most)
{
    const size_t all = t->scene->point_count;
    oxl_point *some = NULL;
    size_t count = 0;
    oxl_result rc = train_some_points(t->ctx, t->scene, most, &some, &count);
    if (rc == OXL_OK && all > 0)
        oxl_log(t->ctx, OXL_LOG_WARNING,
                "training starts from %zu of the %zu points, taken at even steps from those in view: %s",
                count, all,
                t->options->max_gaussians > 0 ? "--max-gaussians allows no more"
                                              : "the images have too few pixels to determine more");
    else if (rc == OXL_OK)
        oxl_log(t->ctx, OXL_LOG_WARNING, "the scene has no points; training starts from %zu random ones%s",
                count, scene_is_composited(t->scene) ? " within the outlines of its images" : "");
    if (rc == OXL_OK) rc = oxl_model_from_points(t->ctx, some, count, 0, &t->trained.model);
    oxl_free(t->ctx, some);
    return rc;
}

/* Narrows the first Gaussians of a short run and raises their opacity, against Kerbl's start. */
static void train_sharpen_start(struct train *t)
{
    const double short_run_factor = schedule_short_run_factor(t->options),
                 narrower = TRAIN_SHORT_RUN_WIDTH * vecmath_log(short_run_factor);
    const double opacity =
        OXL_MIN(MODEL_OPACITY * vecmath_exp(TRAIN_SHORT_RUN_OPACITY * vecmath_log(short_run_factor)),
                TRAIN_OPACITY_MAX);
    if (!(short_run_factor > 1)) return;
    for (size_t i = 0; i < t->trained.model.count; i++) {
        for (int a = 0; a < 3; a++) t->trained.model.plane[OXL_LOG_SCALE + a][i] -= (float)narrower;
        t->trained.model.plane[OXL_OPACITY][i] = (float)vecmath_logit(opacity);
    }
}

/* Makes one Gaussian per point, of the survey and of those that a part adds; without, of random ones. */
static oxl_result train_fresh_model(struct train *t)
{
    const oxl_point *points = t->scene->point;
    const size_t count = t->scene->point_count, cap = schedule_gaussian_cap(t->scene, t->options);
    oxl_point *more = NULL, *all = NULL;
    size_t added = 0;
    oxl_result rc = OXL_OK;
    if (count > cap) return train_first_from_some(t, cap);
    PARTS_CALL(rc, k, first_points, t, &more, &added);
    if (rc == OXL_OK && added > 0 && !(all = oxl_alloc(t->ctx, count + added, sizeof *all)))
        rc = OXL_ERR_MEMORY;
    if (all) memcpy(all, points, count * sizeof *all), memcpy(all + count, more, added * sizeof *all);
    if (rc == OXL_OK && count == 0 && added < TRAIN_FIRST_LEAST)
        rc = train_first_from_some(t, t->options->max_gaussians > 0 ? cap : SIZE_MAX);
    else if (rc == OXL_OK)
        rc = oxl_model_from_points(t->ctx, all ? all : points, count + added, 0, &t->trained.model);
    OXL_FREE(t->ctx, more, all);
    return rc;
}

/* Copies the model to start from, without second lobes: density control cannot split rows that have them. */
static oxl_result train_first_from_model(struct train *t, const oxl_model *from)
{
    oxl_result rc = model_copy(t->ctx, from, &t->trained.model);
    if (rc == OXL_OK && t->trained.model.lobes > 0)
        oxl_log(t->ctx, OXL_LOG_WARNING,
                "the model to start from has second lobes: they are removed, since Gaussians are split");
    if (rc == OXL_OK) model_drop_lobes(&t->trained.model);
    if (rc == OXL_OK) oxl_model_move_origin(&t->trained.model, t->scene->origin);
    return rc;
}

/* Makes the initial model: resumed, given by --from, or from the points. */
static oxl_result train_first_model(struct train *t)
{
    oxl_result rc;
    if (t->task.start) {
        OXL_SWAP(oxl_model, t->trained.model, *t->task.start);
        return OXL_OK;
    }
    if (t->task.from) return train_first_from_model(t, t->task.from);
    rc = train_fresh_model(t);
    if (rc == OXL_OK) train_sharpen_start(t);
    return rc;
}

/* Returns the mean share of the Gaussians that a training view shows, by pairs of both; of a block, those in
 * its window of the view. */
static double train_share_shown(const struct train *t)
{
    float *const *mean = &t->trained.model.plane[OXL_MEAN];
    int shown = 0;
    for (int k = 0; k < TRAIN_SHARE_PAIRS && t->trained.model.count > 0; k++) {
        const struct image_window *w = step_window(t, t->view[k % t->views]);
        const size_t row = (size_t)((double)k / TRAIN_SHARE_PAIRS * (double)t->trained.model.count);
        oxl_camera c = t->scene->view[t->view[k % t->views]].camera;
        double p[] = {mean[0][row], mean[1][row], mean[2][row]}, x[3], at[2];
        if (w) c.width = w->width, c.height = w->height, c.cx -= w->x, c.cy -= w->y;
        shown += camera_sees(&c, p, x, at);
    }
    return (double)shown / TRAIN_SHARE_PAIRS;
}

OXL_INTERNAL oxl_result train_begin(struct train *t)
{
    oxl_context *ctx = t->ctx;
    oxl_result rc;
    t->posed = scene_posed(ctx, t->survey);
    t->scene = t->posed ? t->posed : t->survey;
    t->imaging = t->task.imaging ? t->task.imaging : &t->own_imaging;
    if (!t->posed) return OXL_ERR_MEMORY;
    t->render = render_options_of(t->scene);
    scene_background(t->scene, t->options->background, t->render.background);
    scene_set_background(ctx, t->scene, t->render.background); /* before the first image is read */
    t->continues = t->task.start != NULL;
    rc = parts_create(t);
    PARTS_CALL(rc, k, before_points, t, t->part[k]);
    if (rc == OXL_OK) rc = train_first_model(t);
    if (rc != OXL_OK) return rc;
    memcpy(t->trained.model.origin, t->scene->origin, sizeof t->trained.model.origin);
    rc = model_trained_begin(ctx, &t->trained);
    if (rc == OXL_OK) rc = renderer_create(ctx, &t->renderer);
    if (rc == OXL_OK && t->options->terms && renderer_has_device(t->renderer))
        rc = oxl_fail(ctx, OXL_ERR_USAGE,
                      "oxl_terms are computed on the CPU alone\nfix: set backend to OXL_BACKEND_CPU");
    if (rc == OXL_OK)
        *renderer_settings(t->renderer) = (struct renderer_settings){.steps = 1, .terms = t->options->terms};
    if (rc == OXL_OK) renderer_set_surroundings(t->renderer, t->task.surroundings);
    if (rc == OXL_OK) rc = density_clear(ctx, &t->density, t->trained.model.count);
    PARTS_CALL(rc, k, begin, t, t->part[k]);
    if (rc == OXL_OK && !t->continues) rc = train_imaging_begin(t);
    if (rc == OXL_OK) rc = selection_begin(t);
    if (rc == OXL_OK) t->shown = train_share_shown(t);
    return rc;
}

OXL_INTERNAL void train_end(struct train *t)
{
    oxl_context *ctx = t->ctx;
    photometry_free(ctx, &t->tracks);
    parts_free(t);
    model_trained_free(ctx, &t->trained);
    renderer_free(ctx, t->renderer);
    oxl_model_free(ctx, &t->gradient);
    density_free(ctx, &t->density);
    oxl_free(ctx, t->view);
    imaging_free(ctx, &t->own_imaging);
    scene_posed_free(ctx, t->posed);
}

/* ---------------- checkpoints */

/* Lists all state that later steps depend on. */
OXL_INTERNAL void train_archive(struct archive *a, void *user)
{
    struct train *t = user;
    double spent = step_seconds(t);
    ARCHIVE(a, &t->step, 1);
    ARCHIVE(a, &t->loss, 1);
    ARCHIVE(a, &t->psnr, 1);
    ARCHIVE(a, &t->views, 1);
    ARCHIVE(a, t->view, (size_t)t->views);
    for (int k = 0; k < TRAINED_PARTS; k++) archive_model(a, model_trained_part(&t->trained, k));
    density_archive(a, &t->density, t->trained.model.count);
    PARTS_FOR(k, is_plain) archive_numbers(a, t->part[k], 1, parts_at(k)->size);
    PARTS_FOR(k, archive) parts_at(k)->archive(a, t, t->part[k]);
    ARCHIVE(a, &spent, 1);
    ARCHIVE(a, &t->nonfinite, 1);
    if (t->task.decisions) archive_text(a, t->task.decisions);
    archive_text(a, t->task.log);
    archive_text(a, t->task.notes);
    if (a->reading && a->rc == OXL_OK) t->seconds = spent;
}

static oxl_result train_save(struct train *t)
{
    const struct train_store *s = &t->task.store;
    oxl_result rc = step_download(t, DOWNLOAD_TO_READ);
    if (rc == OXL_OK && s->write) rc = s->write(t->ctx, s->folder, s->key, train_archive, t);
    t->saved_step = t->step;
    t->saved_at = os_seconds();
    return rc;
}

static int train_save_is_due(const struct train *t)
{
    return t->task.store.write && t->step < t->options->iterations &&
           (t->step - t->saved_step >= TRAIN_SAVE_STEPS || os_seconds() - t->saved_at >= TRAIN_SAVE_SECONDS);
}

OXL_INTERNAL oxl_result train_resume(struct train *t)
{
    const struct train_store *s = &t->task.store;
    int found = 0;
    oxl_result rc = OXL_OK;
    t->saved_at = t->started;
    if (s->read) rc = s->read(t->ctx, s->folder, s->key, train_archive, t, &found);
    if (rc == OXL_OK && found) oxl_log(t->ctx, OXL_LOG_INFO, "resumed after iteration %d", t->step);
    t->saved_step = t->step;
    return rc;
}

/* ---------------- one step with the decisions after it */

OXL_INTERNAL oxl_result train_density(struct train *t)
{
    const oxl_train_options *o = t->options;
    oxl_result rc = OXL_OK;
    if (t->step > o->densify_until * o->iterations) return OXL_OK;
    PARTS_CALL(rc, k, before_observe, t, t->part[k]);
    if (rc == OXL_OK) rc = step_observe(t);
    if (rc == OXL_OK && schedule_densifies_at(o, t->step)) rc = step_densify(t);
    if (rc != OXL_OK || !schedule_resets_opacity_at(o, t->step)) return rc;
    rc = step_download(t, DOWNLOAD_SHAPE);
    if (rc != OXL_OK) return rc;
    density_reset_opacity(&t->trained, t->render.alpha_min);
    return renderer_send_shape(t->renderer, &t->trained.model, 1);
}

/* Makes one step, with the decisions after it; the passes over the image are in step_on_view (step.c). */
OXL_INTERNAL oxl_result train_step(struct train *t)
{
    oxl_result rc = OXL_OK;
    PARTS_CALL(rc, k, before_step, t, t->part[k]);
    if (rc == OXL_OK) rc = step_on_next_view(t);
    if (rc == OXL_OK) rc = train_density(t);
    PARTS_CALL(rc, k, after_step, t, t->part[k]);
    return rc;
}

/* ---------------- the loop */

OXL_INTERNAL oxl_result train_check(oxl_context *ctx, const oxl_train_options *o)
{
    oxl_result rc = OXL_OK;
    PARTS_CALL(rc, k, check, ctx, o);
    return rc == OXL_OK ? oxl_train_options_check(ctx, o) : rc;
}

/* Saves a checkpoint and stops: the caller asks for it, or the time is over. */
static oxl_result train_stop(struct train *t)
{
    const oxl_result rc = train_save(t);
    return rc == OXL_OK ? OXL_ERR_INTERRUPTED : rc;
}

static oxl_result train_loop(struct train *t)
{
    const oxl_train_options *o = t->options;
    const int end = t->task.until > 0 ? OXL_MIN(t->task.until, o->iterations) : o->iterations;
    oxl_result rc = OXL_OK;
    if (t->step > 0 && step_report(t)) return OXL_ERR_INTERRUPTED;
    while (rc == OXL_OK && t->step < end) {
        t->step++;
        rc = train_step(t);
        if (rc != OXL_OK) break;
        if (step_report(t)) return train_stop(t);
        if (o->max_seconds > 0 && os_seconds() - t->started > o->max_seconds && t->step < o->iterations) {
            oxl_log(t->ctx, OXL_LOG_INFO, "stopped by the time limit after %d of %d iterations", t->step,
                    o->iterations);
            return train_save(t);
        }
        if (train_save_is_due(t)) rc = train_save(t);
    }
    if (rc == OXL_OK && t->step < o->iterations) return train_save(t);
    if (rc == OXL_OK && t->task.viewer_steps > 0 && t->saved_step < t->step &&
        (t->trained.model.lobes > 0 || parts_hide(t)))
        rc = train_save(t);
    if (rc == OXL_OK) rc = step_download(t, DOWNLOAD_TO_CHANGE);
    PARTS_FOR(k, record)
    if (rc == OXL_OK) parts_at(k)->record(t, t->part[k]);
    return rc;
}

/* Gives the model the background, for renders and viewers; nothing where it is black, as it mostly is. */
static void train_return_background(const struct train *t, oxl_model *out)
{
    const float *rgb = t->render.background;
    out->has_background = scene_is_composited(t->scene) || rgb[0] != 0 || rgb[1] != 0 || rgb[2] != 0;
    memcpy(out->background, rgb, sizeof out->background);
}

OXL_INTERNAL oxl_result train_run(oxl_context *ctx, const oxl_scene *scene, const oxl_train_options *options,
                                  const oxl_callback *callback, struct train_task *task, oxl_model *out)
{
    struct train t = {.ctx = ctx,
                      .survey = scene,
                      .options = options,
                      .started = os_seconds(),
                      .task = *task,
                      .step = task->first,
                      .callback = callback};
    oxl_result rc = train_check(ctx, options), ended = OXL_OK;
    int started; /* 1: training has started, and *out is usable */
    *out = (oxl_model){0};
    if (rc != OXL_OK) return rc;
    rc = train_begin(&t);
    if (rc == OXL_OK) rc = train_resume(&t);
    started = rc == OXL_OK;
    if (rc == OXL_OK) rc = train_loop(&t);
    OXL_SWAP(oxl_model, *out, t.trained.model);
    train_return_background(&t, out);
    if (rc == OXL_OK || rc == OXL_ERR_INTERRUPTED) ended = nonfinite_end(ctx, &t.nonfinite, out);
    if (ended != OXL_OK) rc = ended;
    task->nonfinite = t.nonfinite;
    task->finished = rc == OXL_OK && t.step == options->iterations;
    if (rc == OXL_ERR_INTERRUPTED)
        oxl_fail(ctx, rc, "interrupted at iteration %d of %d", t.step, options->iterations);
    if (rc != OXL_OK && (rc != OXL_ERR_INTERRUPTED || !started)) oxl_model_free(ctx, out);
    train_imaging_store(&t, started ? out : NULL);
    train_end(&t);
    return rc;
}
