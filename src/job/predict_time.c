/* predict_time.c - how long a run will take: times some steps here and now, and extrapolates. The uncertainty is stated with it.
 *
 * Steps of two models are timed over views all over the survey: of the starting one, and of one with as many Gaussians as the run is
 * expected to end with, beside the points that there are. The run's mean step lies between them, by the share of the run in which it
 * has grown. Not predicted: how wide Gaussians become while they are trained, so how many lie over a pixel: that is in the range.
 *
 * Invariant: the state of the run is not changed: it ends in the same bytes as without.
 */
#include "job.h"
#include "../core/vecmath.h"

#define PREDICT_TIME_GROWTH 0.4 /* new Gaussians in a densification for each that there is: 0.2 to 0.8 were seen, until the cap */
#define PREDICT_TIME_TRAINED \
    1.25 /* steps of a run over those that are timed: seven runs of five surveys took 0.95 to 2.07 times as long */
#define PREDICT_TIME_WITHIN  1.7 /* the factor to either side that holds them */
#define PREDICT_TIME_SECONDS 1.0 /* each model is timed for at most about so long */
#define PREDICT_TIME_SPACING 0.7 /* distance of new Gaussians from their parents, in standard deviations */
enum {
    PREDICT_TIME_WARM  = 1,      /* steps that make room and wake threads, not counted */
    PREDICT_TIME_STEPS = 48,     /* that are timed, at most; the median counts: what else the machine does comes in bursts */
    PREDICT_TIME_MIN   = 4,      /* in short runs, */
    PREDICT_TIME_SHARE = 100,    /* where each model is timed for this part of the run */
    PREDICT_TIME_MAX   = 1000000 /* points: of more, the blocks will be timed; Gaussians: more of them cost in proportion */
};

struct time_probe {
    oxl_context       *ctx;
    const oxl_scene   *scene;
    oxl_render_options render;
    struct renderer   *renderer;
    oxl_model          first, second; /* the shape of the model that is timed */
    float             *target;        /* (3,H,W) of the largest view: grey */
    int                steps;         /* timed of each model */
};

static oxl_result predict_time_target(struct time_probe *r)
{
    size_t most = 0;
    for (int i = 0; i < oxl_scene_view_count(r->scene); i++) {
        const oxl_camera *c = &oxl_scene_view(r->scene, i)->camera;
        most                = OXL_MAX(most, (size_t)c->width * (size_t)c->height);
    }
    r->target = oxl_alloc(r->ctx, 3 * most, sizeof *r->target);
    if (!r->target) return oxl_fail(r->ctx, OXL_ERR_MEMORY, "no memory to time a step");
    for (size_t i = 0; i < 3 * most; i++) r->target[i] = 0.5f;
    return OXL_OK;
}

static oxl_result predict_time_step(struct time_probe *r, oxl_model *model, const oxl_camera *camera)
{
    const struct adam_params  still = {.beta = RENDERER_BETAS, .step = 1};
    struct renderer_loss      loss;
    struct renderer_nonfinite skipped;
    oxl_result                rc = renderer_forward(r->ctx, r->renderer, model, camera, &r->render);
    if (rc == OXL_OK) rc = renderer_loss(r->ctx, r->renderer, r->target, NULL, 0.2f, &loss);
    if (rc == OXL_OK) rc = renderer_backward(r->ctx, r->renderer, NULL, NULL);
    if (rc == OXL_OK) rc = renderer_step(r->ctx, r->renderer, model, NULL, &r->first, &r->second, &still, &skipped);
    return rc;
}

/* The k-th view of an order in which neighbours are far apart, as in a run: data of one view is not in the cache for the next. */
static const oxl_camera *predict_time_camera(const struct time_probe *r, int k)
{
    const double along = k * 0.6180339887498949; /* the golden ratio's multiples fill a circle evenly */
    return &oxl_scene_view(r->scene, (int)((along - floor(along)) * oxl_scene_view_count(r->scene)))->camera;
}

static void predict_time_end_model(struct time_probe *r)
{
    oxl_model_free(r->ctx, &r->first);
    oxl_model_free(r->ctx, &r->second);
}

/* Median seconds of a step of the model; halved: at half the images' sides. */
static oxl_result predict_time_model(struct time_probe *r, oxl_model *model, int halved, double *seconds)
{
    double     took[PREDICT_TIME_STEPS], spent = 0;
    int        steps = 0;
    oxl_result rc    = oxl_model_create(r->ctx, model->count, model->sh_degree, &r->first);
    if (rc == OXL_OK) rc = oxl_model_create(r->ctx, model->count, model->sh_degree, &r->second);
    for (int k = 0; rc == OXL_OK && steps < r->steps && spent < PREDICT_TIME_SECONDS; k++) {
        const oxl_camera *whole   = predict_time_camera(r, k);
        const oxl_camera  camera  = halved ? camera_halve(whole) : *whole;
        const double      started = os_seconds();
        rc                        = context_stopped(r->ctx);
        if (rc == OXL_OK) rc = predict_time_step(r, model, &camera);
        if (k < PREDICT_TIME_WARM) continue;
        took[steps] = os_seconds() - started;
        spent += took[steps++];
    }
    if (rc == OXL_OK) rc = renderer_download(r->ctx, r->renderer, DOWNLOAD_TO_CHANGE);
    if (rc == OXL_OK) *seconds = stats_select(took, (size_t)steps, 0.5);
    predict_time_end_model(r);
    return rc;
}

/* As many as `count`: the model's own centres, again and again, from the second time on a little beside. */
static oxl_result predict_time_grow(oxl_context *ctx, const oxl_model *model, size_t count, oxl_model *out)
{
    oxl_point *point = oxl_calloc(ctx, count + 1, sizeof *point);
    oxl_result rc    = point ? OXL_OK : oxl_fail(ctx, OXL_ERR_MEMORY, "no memory to time %zu Gaussians", count);
    for (size_t i = 0; rc == OXL_OK && i < count; i++) {
        const size_t row = i % model->count;
        const double far = i < model->count ? 0 : 2 * PREDICT_TIME_SPACING * vecmath_exp(model->plane[OXL_LOG_SCALE][row]);
        for (int a = 0; a < 3; a++)
            point[i].position[a] = model->plane[OXL_MEAN + a][row] + far * (random_unit(random_bits(1, i, (uint64_t)a)) - 0.5);
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

/* Share of the run, in steps, that its mean number of Gaussians is on the way from `points` to `count`. */
static double predict_time_grown(const oxl_train_options *o, double points, double count)
{
    double now = points, progress = 0;
    for (int step = 1; step <= o->iterations; step++) {
        if (schedule_densifies_at(o, step)) now = OXL_MIN((1 + PREDICT_TIME_GROWTH) * now, count);
        progress += count > points ? (now - points) / (count - points) : 1;
    }
    return progress / o->iterations;
}

/* step[0..2]: seconds of a step of the starting model, of the same at half the sides (when the run has such steps), of the grown one. */
static oxl_result predict_time_all(struct time_probe *r, const oxl_train_options *o, double coarse, size_t count, double step[3])
{
    const int  degree = o->sh_degree < 0 ? 3 : o->sh_degree;
    oxl_model  model = {0}, grown = {0};
    oxl_result rc = predict_time_target(r);
    if (rc == OXL_OK) rc = renderer_create(r->ctx, &r->renderer);
    if (rc == OXL_OK) renderer_expect_steps(r->renderer);
    if (rc == OXL_OK)
        rc = oxl_model_from_points(r->ctx, oxl_scene_points(r->scene), oxl_scene_point_count(r->scene), degree, &model);
    if (rc == OXL_OK) rc = predict_time_model(r, &model, 0, &step[0]);
    if (rc == OXL_OK && coarse > 0) rc = predict_time_model(r, &model, 1, &step[1]);
    if (rc == OXL_OK) rc = predict_time_grow(r->ctx, &model, count, &grown);
    if (rc == OXL_OK) rc = predict_time_model(r, &grown, 0, &step[2]);
    oxl_model_free(r->ctx, &model);
    oxl_model_free(r->ctx, &grown);
    renderer_free(r->ctx, r->renderer);
    oxl_free(r->ctx, r->target);
    return rc;
}

OXL_INTERNAL double predict_time(oxl_context *ctx, const oxl_scene *scene, const oxl_train_options *o, double gaussians,
                                 double range[2])
{
    struct time_probe r      = {.ctx    = ctx,
                                .scene  = scene,
                                .render = oxl_render_options_default(),
                                .steps  = OXL_CLAMP(o->iterations / PREDICT_TIME_SHARE, PREDICT_TIME_MIN, PREDICT_TIME_STEPS)};
    const size_t      points = oxl_scene_point_count(scene), count = OXL_MAX(points, (size_t)gaussians);
    const size_t      timed   = OXL_MIN(count, (size_t)PREDICT_TIME_MAX);
    double            step[3] = {0}, coarse, seconds;
    if (points == 0 || points > PREDICT_TIME_MAX || oxl_scene_view_count(scene) == 0) return 0;
    r.render.near_plane = (float)scene_near_plane(scene);
    coarse = schedule_coarse_share(o, oxl_scene_view(scene, 0)->camera.width, oxl_scene_view(scene, 0)->camera.height);
    if (predict_time_all(&r, o, coarse, timed, step) != OXL_OK) return 0;
    step[2] *= (double)count / (double)timed;
    seconds = step[0] + predict_time_grown(o, (double)points, (double)count) * (step[2] - step[0]);
    seconds *= o->iterations * (step[0] > 0 && coarse > 0 ? 1 - coarse * (1 - step[1] / step[0]) : 1);
    seconds = PREDICT_TIME_TRAINED * (seconds + step[2] * selection_trial_steps(o, schedule_training_views(scene)));
    oxl_log(ctx, OXL_LOG_DEBUG, "timed: %.3f ms a step at the start, %.3f ms with %zu Gaussians: %.1f s", 1e3 * step[0],
            1e3 * step[2], count, seconds);
    range[0] = seconds / PREDICT_TIME_WITHIN;
    range[1] = seconds * PREDICT_TIME_WITHIN;
    return seconds;
}
