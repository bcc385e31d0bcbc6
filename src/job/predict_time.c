/* predict_time.c - some steps before the run, to see how long its steps will take: on this machine, as busy as it is, with these threads.
 *
 * What a step costs depends on how many Gaussians lie over a pixel, which no count in the survey's files tells. So two models stand in
 * for those of the run: the starting one, and one that has as many Gaussians as the run is expected to end with, beside the points
 * that there are. Training changes how many lie over a pixel, from few to more and from many to fewer; the second has its widths made
 * to match. Both have all bands, as a run has after a tenth of it. Steps of both are taken over a few views; the run's are between them.
 *
 * Invariant: nothing of this is left behind. The run that follows ends in the same bytes as without.
 */
#include "../internal.h"
#include "../core/vecmath.h"

#define REHEARSE_SOON    0.25 /* of the way from the first model's cost to the grown one's: widths change in some hundred steps */
#define REHEARSE_GROWTH  0.45 /* new ones in a densification for one at the start: 0.25 to 2.0 were seen, until the cap */
#define REHEARSE_OVERLAP 7.3  /* Gaussians over a pixel of a trained model where one was at the start, */
#define REHEARSE_POWER   0.48 /* the power of more that it goes with, */
#define REHEARSE_DENSER  0.27 /* and that of their growing number: drafts of four surveys, 160 and 320 px (docs/TRADEOFF.md) */
#define REHEARSE_RESET   1.13 /* times as many over the whole run, where opacities are reset: 1.1 to 1.4 after it */
#define REHEARSE_AREA    1.5  /* power of the widths that the overlap goes with: less than 2 for the blur of a pixel */
#define REHEARSE_WIDER   0.7  /* log widths: at most twice as wide in a round, or half */
#define REHEARSE_SECONDS 1.0  /* each model is tried for at most about so long, */
#define REHEARSE_WARM    0.01 /* after so many seconds, and a step, that make room and wake threads */
#define REHEARSE_APART   0.7  /* new Gaussians stand so many standard deviations from those that they grow beside */
enum {
    REHEARSE_LEAST  = 4,   /* views of a walk */
    REHEARSE_VIEWS  = 12,  /* and at most, */
    REHEARSE_RARELY = 300, /* one for each so many steps of the run; */
    REHEARSE_WALKS  = 33,  /* walks at most, of which the middle one counts: what else the machine does comes in bursts */
    REHEARSE_STEPS  = 100, /* of the run, for each that is tried */
    REHEARSE_LOOKS  = 4,   /* views by which widths are found, in so many */
    REHEARSE_ROUNDS = 2,
    REHEARSE_MOST   = 1000000 /* points: of more, the blocks will be tried; Gaussians: more of them cost in proportion */
};

struct rehearsal {
    oxl_context       *ctx;
    const oxl_scene   *scene;
    oxl_render_options render;
    int                iterations;
    struct renderer   *renderer;
    oxl_model          first, second, gradient; /* the shape of the model that is tried */
    float             *target;                  /* (3,H,W) of the largest view: grey */
    double             evaluations, pixels;     /* of alpha in the steps tried, and of their views */
};

/* Evaluations of alpha a pixel; 0: not to be had, as a device keeps its splats. */
static double rehearse_overlap(const struct rehearsal *r)
{
    return r->pixels > 0 ? r->evaluations / r->pixels : 0;
}

static void rehearse_count_evaluations(struct rehearsal *r, const oxl_camera *camera)
{
    r->evaluations += (double)renderer_counts(r->renderer).pixels;
    r->pixels += (double)camera->width * camera->height;
}

static oxl_result rehearse_target(struct rehearsal *r)
{
    size_t most = 0;
    for (int i = 0; i < oxl_scene_view_count(r->scene); i++) {
        const oxl_camera *c = &oxl_scene_view(r->scene, i)->camera;
        most                = OXL_MAX(most, (size_t)c->width * (size_t)c->height);
    }
    r->target = oxl_alloc(r->ctx, 3 * most, sizeof *r->target);
    if (!r->target) return oxl_fail(r->ctx, OXL_ERR_MEMORY, "no memory to try a step");
    for (size_t i = 0; i < 3 * most; i++) r->target[i] = 0.5f;
    return OXL_OK;
}

static oxl_result rehearse_step(struct rehearsal *r, oxl_model *model, const oxl_camera *camera)
{
    const struct renderer_pace still = {.beta = RENDERER_BETAS, .step = 1};
    struct renderer_loss       loss;
    struct renderer_aside      aside;
    oxl_result                 rc = renderer_forward(r->ctx, r->renderer, model, camera, &r->render);
    if (rc == OXL_OK) rc = renderer_loss(r->ctx, r->renderer, r->target, NULL, 0.2f, &loss);
    if (rc == OXL_OK) rc = renderer_backward(r->ctx, r->renderer, NULL, &r->gradient);
    if (rc == OXL_OK) rc = renderer_step(r->ctx, r->renderer, model, &r->gradient, &r->first, &r->second, &still, &aside);
    return rc;
}

/* The k-th of a walk all over the survey, each far from the one before as in a run: what one view saw is not in the cache for the next. */
static const oxl_camera *rehearse_camera(const struct rehearsal *r, int k)
{
    const double along = k * 0.6180339887498949; /* the golden ratio's multiples fill a circle evenly */
    return &oxl_scene_view(r->scene, (int)((along - floor(along)) * oxl_scene_view_count(r->scene)))->camera;
}

static oxl_result rehearse_steps(struct rehearsal *r, oxl_model *model, int halved, double *seconds)
{
    const int  few    = OXL_CLAMP(r->iterations / REHEARSE_RARELY, REHEARSE_LEAST, REHEARSE_VIEWS);
    const int  views  = OXL_MIN(oxl_scene_view_count(r->scene), few);
    const int  wanted = OXL_CLAMP(r->iterations / (REHEARSE_STEPS * views), 1, REHEARSE_WALKS);
    double     mean[REHEARSE_WALKS], warm = 0, spent = 0, sum = 0;
    int        walks = 0, steps = 0;
    oxl_result rc  = OXL_OK;
    r->evaluations = r->pixels = 0;
    for (int k = 0; rc == OXL_OK && walks < wanted && spent < REHEARSE_SECONDS; k++) {
        const oxl_camera *whole  = rehearse_camera(r, k);
        const oxl_camera  camera = halved ? camera_halve(whole) : *whole;
        const double      begun  = os_seconds();
        double            took;
        rc   = rehearse_step(r, model, &camera);
        took = os_seconds() - begun;
        if (rc == OXL_OK) rehearse_count_evaluations(r, &camera);
        if (warm < REHEARSE_WARM && k < 4 * views) { /* not for ever by a clock that stands still */
            warm += took;
            continue;
        }
        sum += took, spent += took, steps++;
        if (steps == views) mean[walks++] = sum / steps, sum = 0, steps = 0;
    }
    if (walks == 0) mean[walks++] = sum / OXL_MAX(1, steps);
    *seconds = measure_pick(mean, (size_t)walks, 0.5);
    return rc;
}

static void rehearse_end_model(struct rehearsal *r)
{
    oxl_model_free(r->ctx, &r->first);
    oxl_model_free(r->ctx, &r->second);
    oxl_model_free(r->ctx, &r->gradient);
}

static oxl_result rehearse_model(struct rehearsal *r, oxl_model *model, int halved, double *seconds)
{
    oxl_result rc = oxl_model_create(r->ctx, model->count, model->sh_degree, &r->first);
    if (rc == OXL_OK) rc = oxl_model_create(r->ctx, model->count, model->sh_degree, &r->second);
    if (rc == OXL_OK) rc = oxl_model_create(r->ctx, model->count, model->sh_degree, &r->gradient);
    if (rc == OXL_OK) rc = rehearse_steps(r, model, halved, seconds);
    if (rc == OXL_OK) rc = renderer_fetch(r->ctx, r->renderer);
    rehearse_end_model(r);
    return rc;
}

/* As many as `count`: the model's own centres, again and again, from the second time on a little beside. */
static oxl_result rehearse_grow(oxl_context *ctx, const oxl_model *model, size_t count, oxl_model *out)
{
    oxl_point *point = oxl_calloc(ctx, count + 1, sizeof *point);
    oxl_result rc    = point ? OXL_OK : oxl_fail(ctx, OXL_ERR_MEMORY, "no memory to try %zu Gaussians", count);
    for (size_t i = 0; rc == OXL_OK && i < count; i++) {
        const size_t row = i % model->count;
        const double far = i < model->count ? 0 : 2 * REHEARSE_APART * vecmath_exp(model->plane[OXL_LOG_SCALE][row]);
        for (int a = 0; a < 3; a++)
            point[i].position[a] = model->plane[OXL_MEAN + a][row] + far * (random_unit(random_bits(1, i, (uint64_t)a)) - 0.5);
    }
    if (rc == OXL_OK) rc = oxl_model_from_points(ctx, point, count, model->sh_degree, out);
    oxl_free(ctx, point);
    return rc;
}

static oxl_result rehearse_look(struct rehearsal *r, const oxl_model *model)
{
    oxl_result rc  = OXL_OK;
    r->evaluations = r->pixels = 0;
    for (int k = 0; k < REHEARSE_LOOKS && rc == OXL_OK; k++) {
        const oxl_camera *camera = rehearse_camera(r, k);
        rc                       = renderer_forward(r->ctx, r->renderer, model, camera, &r->render);
        if (rc == OXL_OK) rehearse_count_evaluations(r, camera);
    }
    return rc;
}

/* Makes the widths such that about `overlap` Gaussians lie over a pixel; 0: leaves them. */
static oxl_result rehearse_train_widths(struct rehearsal *r, oxl_model *model, double overlap)
{
    oxl_result rc = OXL_OK;
    for (int round = 0; round < REHEARSE_ROUNDS && rc == OXL_OK && overlap > 0; round++) {
        double wider;
        rc = rehearse_look(r, model);
        if (rc != OXL_OK || !(r->evaluations > 0)) return rc;
        wider = vecmath_log(overlap / rehearse_overlap(r)) / REHEARSE_AREA;
        wider = OXL_CLAMP(wider, -REHEARSE_WIDER, REHEARSE_WIDER); /* of few in sight, many more would come into it at once */
        for (int a = 0; a < 3; a++)
            for (size_t i = 0; i < model->count; i++) model->plane[OXL_LOG_SCALE + a][i] += (float)wider;
    }
    return rc;
}

/* Seconds of a step: of the starting model, of the same at half the sides, of the grown one. */
struct rehearsed {
    double early, halved, late;
};

/* As for the first view. */
static double rehearse_coarse(const oxl_scene *scene, const oxl_train_options *o)
{
    const oxl_camera *camera = &oxl_scene_view(scene, 0)->camera;
    return train_coarse_share(o, camera->width, camera->height);
}

/* Gaussians over a pixel of a trained model, from those of the starting one, of which it has so many times the number. */
static double rehearse_trained(const oxl_train_options *o, double overlap, double times)
{
    int resets = 0;
    if (!(overlap > 0)) return 0;
    for (int step = 1; step <= o->iterations && !resets; step++) resets = train_resets_opacity_at(o, step);
    return (resets ? REHEARSE_RESET : 1) * REHEARSE_OVERLAP *
           vecmath_exp(REHEARSE_POWER * vecmath_log(overlap) + REHEARSE_DENSER * vecmath_log(times));
}

static oxl_result rehearse_both(struct rehearsal *r, const oxl_train_options *o, size_t count, struct rehearsed *out)
{
    const int  degree  = o->sh_degree < 0 ? 3 : o->sh_degree;
    double     overlap = 0; /* that training leads to; 0: not known */
    oxl_model  model = {0}, grown = {0};
    oxl_result rc = rehearse_target(r);
    if (rc == OXL_OK) rc = renderer_create(r->ctx, &r->renderer);
    if (rc == OXL_OK)
        rc = oxl_model_from_points(r->ctx, oxl_scene_points(r->scene), oxl_scene_point_count(r->scene), degree, &model);
    if (rc == OXL_OK && rehearse_coarse(r->scene, o) > 0) rc = rehearse_model(r, &model, 1, &out->halved);
    if (rc == OXL_OK) rc = rehearse_model(r, &model, 0, &out->early);
    if (rc == OXL_OK) overlap = rehearse_trained(o, rehearse_overlap(r), (double)count / (double)model.count);
    if (rc == OXL_OK) rc = rehearse_grow(r->ctx, &model, count, &grown);
    if (rc == OXL_OK) rc = rehearse_train_widths(r, &grown, overlap);
    if (rc == OXL_OK) rc = rehearse_model(r, &grown, 0, &out->late);
    oxl_model_free(r->ctx, &model);
    oxl_model_free(r->ctx, &grown);
    renderer_free(r->ctx, r->renderer);
    oxl_free(r->ctx, r->target);
    return rc;
}

OXL_INTERNAL double rehearse_expected(const oxl_train_options *o, size_t points, size_t cap)
{
    return OXL_MIN((1 + REHEARSE_GROWTH * train_densifications(o)) * (double)points, (double)cap);
}

/* How far from the first model's cost to the grown one's that of the run's mean step lies. */
static double rehearse_share(const oxl_train_options *o, double points, double count)
{
    double now = points, way = 0;
    for (int step = 1; step <= o->iterations; step++) {
        if (train_densifies_at(o, step)) now = OXL_MIN(now + REHEARSE_GROWTH * points, count);
        way += count > points ? (now - points) / (count - points) : 1;
    }
    return REHEARSE_SOON + (1 - REHEARSE_SOON) * way / o->iterations;
}

OXL_INTERNAL double rehearse(oxl_context *ctx, const oxl_scene *scene, const oxl_train_options *o, double gaussians)
{
    struct rehearsal r      = {.ctx = ctx, .scene = scene, .render = oxl_render_options_default(), .iterations = o->iterations};
    struct rehearsed t      = {0};
    const size_t     points = oxl_scene_point_count(scene), count = OXL_MAX(points, (size_t)gaussians);
    const size_t     tried = OXL_MIN(count, (size_t)REHEARSE_MOST);
    const double     share = rehearse_share(o, (double)points, (double)count);
    double           step;
    if (points == 0 || points > REHEARSE_MOST || oxl_scene_view_count(scene) == 0) return 0;
    r.render.near_plane = (float)scene_near_plane(scene);
    if (rehearse_both(&r, o, tried, &t) != OXL_OK) return 0;
    oxl_log(ctx, OXL_LOG_DEBUG, "tried: %.3f ms a step at the start, %.3f ms with %zu Gaussians", 1e3 * t.early, 1e3 * t.late,
            tried);
    t.late *= (double)count / (double)tried;
    step = t.early + share * (t.late - t.early);
    if (t.early > 0) step *= 1 - rehearse_coarse(scene, o) * (1 - t.halved / t.early);
    return o->iterations * step + t.late * decide_steps_beside(o, train_training_views(scene));
}
