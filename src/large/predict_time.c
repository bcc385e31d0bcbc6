/* predict_time.c - time of a run: times some steps on this machine and extrapolates; states the uncertainty.
 *
 * Steps of two models are timed on views across the survey: the starting model, and one with as many
 * Gaussians as the run is expected to end with. The mean step of the run lies between the two, depending on
 * how early the model grows. Gaussians also widen in training, so that more of them cover a pixel; this is
 * not predicted, and the stated range allows for it.
 *
 * Invariant: the state of the run is not changed; the run ends with the same bytes.
 */
#include "large.h"
#include "../render/render.h"
#include "../core/vecmath.h"
#include "../survey/sparse.h"
#include "../survey/scene.h"
#include "../survey/survey.h"
#include "../model/model.h"

/* new Gaussians per Gaussian in a densification; measured: 0.2 to 0.8, until the cap */
#define PREDICT_TIME_GROWTH 0.4
/* mean step of a run over the prediction; measured: 0.95 to 2.07 in seven runs of five surveys */
#define PREDICT_TIME_TRAINED 1.25
#define PREDICT_TIME_WITHIN 1.7  /* factor of uncertainty, which covers these */
#define PREDICT_TIME_SECONDS 1.0 /* limit of the timing of a model */
#define PREDICT_TIME_SPACING 0.7 /* distance of new Gaussians from their parents, in standard deviations */
enum {
    PREDICT_TIME_WARM = 1, /* first steps, which allocate and start threads: not timed */
    /* limit of timed steps; their median is used, since other load comes in bursts */
    PREDICT_TIME_STEPS = 48,
    PREDICT_TIME_MIN = 4,       /* timed steps in short runs, */
    PREDICT_TIME_DIVISOR = 100, /* which time 1/100 of their steps with each model */
    /* limit of points that are timed, and of Gaussians: more of them take time in proportion */
    PREDICT_TIME_MAX = 1000000
};

struct time_probe {
    oxl_context *ctx;
    const oxl_scene *scene;
    oxl_render_options render;
    struct renderer *renderer;
    float *target; /* (3,H,W) of the largest view; grey */
    int steps;     /* timed per model */
};

static oxl_result predict_time_target(struct time_probe *p)
{
    size_t most = 0;
    for (int i = 0; i < oxl_scene_view_count(p->scene); i++) {
        const oxl_camera *c = &oxl_scene_view(p->scene, i)->camera;
        most = OXL_MAX(most, (size_t)c->width * (size_t)c->height);
    }
    p->target = oxl_alloc(p->ctx, 3 * most, sizeof *p->target);
    if (!p->target) return oxl_fail(p->ctx, OXL_ERR_MEMORY, "no memory to time a step");
    for (size_t i = 0; i < 3 * most; i++) p->target[i] = 0.5f;
    return OXL_OK;
}

static oxl_result predict_time_step(struct time_probe *p, struct trained_model *trained,
                                    const oxl_camera *camera)
{
    const struct adam_params still = {.beta = RENDERER_BETAS, .step = 1};
    struct renderer_loss loss;
    struct renderer_nonfinite skipped;
    oxl_result rc = renderer_forward(p->ctx, p->renderer, &trained->model, camera, &p->render);
    if (rc == OXL_OK) rc = renderer_loss(p->ctx, p->renderer, p->target, NULL, 0.2f, &loss);
    if (rc == OXL_OK) rc = renderer_backward(p->ctx, p->renderer, NULL, NULL);
    if (rc == OXL_OK) rc = renderer_step(p->ctx, p->renderer, trained, NULL, &still, &skipped);
    return rc;
}

/* The k-th view of an order in which neighbours are far apart, as in a run: data of one view is not in the
 * cache for the next. */
static const oxl_camera *predict_time_camera(const struct time_probe *p, int k)
{
    const double along = k * 0.6180339887498949; /* the golden ratio's multiples fill a circle evenly */
    return &oxl_scene_view(p->scene, (int)((along - floor(along)) * oxl_scene_view_count(p->scene)))->camera;
}

/* Median seconds of a step of the model, which has no moments; halved: at half the images' sides. */
static oxl_result predict_time_model(struct time_probe *p, struct trained_model *trained, int halved,
                                     double *seconds)
{
    double took[PREDICT_TIME_STEPS], spent = 0;
    int steps = 0;
    oxl_result rc = model_trained_begin(p->ctx, trained);
    for (int k = 0; rc == OXL_OK && steps < p->steps && spent < PREDICT_TIME_SECONDS; k++) {
        const oxl_camera *whole = predict_time_camera(p, k);
        const oxl_camera camera = halved ? camera_halve(whole) : *whole;
        const double started = os_seconds();
        rc = context_stopped(p->ctx);
        if (rc == OXL_OK) rc = predict_time_step(p, trained, &camera);
        if (k < PREDICT_TIME_WARM) continue;
        took[steps] = os_seconds() - started;
        spent += took[steps++];
    }
    if (rc == OXL_OK) rc = renderer_download(p->ctx, p->renderer, DOWNLOAD_TO_CHANGE);
    if (rc == OXL_OK) *seconds = stats_select(took, (size_t)steps, 0.5);
    for (int k = 1; k < TRAINED_PARTS; k++) oxl_model_free(p->ctx, model_trained_part(trained, k));
    return rc;
}

/* A model of `count` Gaussians: copies of the model's centres; copies after the first are displaced a
 * little. */
OXL_INTERNAL oxl_result predict_time_grow(oxl_context *ctx, const oxl_model *model, size_t count,
                                          oxl_model *out)
{
    oxl_point *point = oxl_calloc(ctx, count + 1, sizeof *point);
    oxl_result rc = point ? OXL_OK : oxl_fail(ctx, OXL_ERR_MEMORY, "no memory to time %zu Gaussians", count);
    for (size_t i = 0; rc == OXL_OK && i < count; i++) {
        const size_t row = i % model->count;
        const double far =
            i < model->count ? 0 : 2 * PREDICT_TIME_SPACING * vecmath_exp(model->plane[OXL_LOG_SCALE][row]);
        for (int a = 0; a < 3; a++)
            point[i].position[a] =
                model->plane[OXL_MEAN + a][row] + far * (random_unit(random_bits(1, i, (uint64_t)a)) - 0.5);
    }
    if (rc == OXL_OK) rc = oxl_model_from_points(ctx, point, count, model->sh_degree, out);
    oxl_free(ctx, point);
    return rc;
}

OXL_INTERNAL double predict_time_expected(const oxl_train_options *o, size_t points, size_t cap)
{
    const double grown = vecmath_exp(schedule_densifications(o) * vecmath_log(1 + PREDICT_TIME_GROWTH));
    return OXL_MIN(grown * (double)points, (double)cap);
}

/* Mean over the run of (Gaussians - points) / (count - points): 0 without growth, 1 if all are there from the
 * start. */
OXL_INTERNAL double predict_time_grown(const oxl_train_options *o, double points, double count)
{
    double now = points, progress = 0;
    for (int step = 1; step <= o->iterations; step++) {
        if (schedule_densifies_at(o, step)) now = OXL_MIN((1 + PREDICT_TIME_GROWTH) * now, count);
        progress += count > points ? (now - points) / (count - points) : 1;
    }
    return progress / o->iterations;
}

/* step[0..2]: seconds of a step of the starting model, of the same at half the sides (when the run has such
 * steps), of the grown one. */
static oxl_result predict_time_all(struct time_probe *p, const oxl_train_options *o, double coarse,
                                   size_t count, double step[3])
{
    const int degree = o->sh_degree < 0 ? 3 : o->sh_degree;
    struct trained_model start = {{0}, {0}, {0}}, grown = {{0}, {0}, {0}};
    oxl_result rc = predict_time_target(p);
    if (rc == OXL_OK) rc = renderer_create(p->ctx, &p->renderer);
    if (rc == OXL_OK) renderer_expect_steps(p->renderer);
    if (rc == OXL_OK)
        rc = oxl_model_from_points(p->ctx, oxl_scene_points(p->scene), oxl_scene_point_count(p->scene),
                                   degree, &start.model);
    if (rc == OXL_OK) rc = predict_time_model(p, &start, 0, &step[0]);
    if (rc == OXL_OK && coarse > 0) rc = predict_time_model(p, &start, 1, &step[1]);
    if (rc == OXL_OK) rc = predict_time_grow(p->ctx, &start.model, count, &grown.model);
    if (rc == OXL_OK) rc = predict_time_model(p, &grown, 0, &step[2]);
    model_trained_free(p->ctx, &start);
    model_trained_free(p->ctx, &grown);
    renderer_free(p->ctx, p->renderer);
    oxl_free(p->ctx, p->target);
    return rc;
}

OXL_INTERNAL double predict_time(oxl_context *ctx, const oxl_scene *scene, const oxl_train_options *o,
                                 double gaussians, double range[2])
{
    struct time_probe p = {
        .ctx = ctx,
        .scene = scene,
        .render = oxl_render_options_default(),
        .steps = OXL_CLAMP(o->iterations / PREDICT_TIME_DIVISOR, PREDICT_TIME_MIN, PREDICT_TIME_STEPS)};
    const size_t points = oxl_scene_point_count(scene), count = OXL_MAX(points, (size_t)gaussians);
    const size_t timed = OXL_MIN(count, (size_t)PREDICT_TIME_MAX);
    double step[3] = {0}, coarse, seconds;
    if (points == 0 || points > PREDICT_TIME_MAX || oxl_scene_view_count(scene) == 0) return 0;
    p.render.near_plane = (float)scene_near_plane(scene);
    coarse = schedule_coarse_fraction(o, oxl_scene_view(scene, 0)->camera.width,
                                      oxl_scene_view(scene, 0)->camera.height);
    if (predict_time_all(&p, o, coarse, timed, step) != OXL_OK) return 0;
    step[2] *= (double)count / (double)timed;
    seconds = step[0] + predict_time_grown(o, (double)points, (double)count) * (step[2] - step[0]);
    seconds *= o->iterations * (step[0] > 0 && coarse > 0 ? 1 - coarse * (1 - step[1] / step[0]) : 1);
    seconds =
        PREDICT_TIME_TRAINED * (seconds + step[2] * selection_trial_steps(o, schedule_training_views(scene)));
    oxl_log(ctx, OXL_LOG_DEBUG, "timed: %.3f ms a step at the start, %.3f ms with %zu Gaussians: %.1f s",
            1e3 * step[0], 1e3 * step[2], count, seconds);
    range[0] = seconds / PREDICT_TIME_WITHIN;
    range[1] = seconds * PREDICT_TIME_WITHIN;
    return seconds;
}
