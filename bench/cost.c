/* cost.c - how the cost of a training step grows: with Gaussians, pixels, views, bands of spherical
 * harmonics, threads.
 *
 *     build/cost SCENE > docs/log/cost.tsv     one line a point: what is varied, its value, milliseconds a
 *     step awk -f bench/cost_plot.awk docs/log/cost.tsv > docs/log/cost.svg
 *
 * Everything but one thing stays as it is in the middle: the survey's points, images of 320 px, degree 3, one
 * thread. Models are fresh ones. Time is the processors', of all threads together, and
 * of several tries of each view's step the shortest:
 * other work on the machine only adds. So two threads without loss take what one does.
 */
#include "../oceanxl.c"

#include <time.h>

enum { COST_SIDE = 320, COST_ROUNDS = 7, COST_VIEWS = 12 };

static void cost_check(oxl_context *ctx, oxl_result rc)
{
    if (rc == OXL_OK) return;
    fprintf(stderr, "cost: %s\n", oxl_error_text(ctx));
    exit(1);
}

static double cost_cpu(void)
{
    return (double)clock() / CLOCKS_PER_SEC;
}

struct cost_probe {
    oxl_context *ctx;
    oxl_render_options render;
    struct renderer *renderer;
    float *target; /* (3,H,W) of the largest view; grey */
};

static void cost_make_target(struct cost_probe *p, const oxl_scene *scene)
{
    size_t most = 0;
    for (int i = 0; i < oxl_scene_view_count(scene); i++) {
        const oxl_camera *c = &oxl_scene_view(scene, i)->camera;
        most = OXL_MAX(most, (size_t)c->width * (size_t)c->height);
    }
    p->target = oxl_alloc(p->ctx, 3 * most, sizeof *p->target);
    if (!p->target) cost_check(p->ctx, oxl_fail(p->ctx, OXL_ERR_MEMORY, "no memory to time a step"));
    for (size_t i = 0; i < 3 * most; i++) p->target[i] = 0.5f;
}

static void cost_step(struct cost_probe *p, struct trained_model *trained, const oxl_camera *camera)
{
    const oxl_adam still = {.beta = RENDERER_BETAS, .step = 1};
    struct renderer_loss loss;
    struct renderer_nonfinite skipped;
    cost_check(p->ctx, renderer_forward(p->ctx, p->renderer, &trained->model, camera, &p->render));
    cost_check(p->ctx, renderer_loss(p->ctx, p->renderer, p->target, NULL, 0.2f, &loss));
    cost_check(p->ctx, renderer_backward(p->ctx, p->renderer, NULL, NULL));
    cost_check(p->ctx, renderer_step(p->ctx, p->renderer, trained, NULL, &still, &skipped));
}

#define COST_SPACING 0.7 /* distance of new Gaussians from their parents, in standard deviations */

/* A model of `count` Gaussians: copies of the model's centres; copies after the first are displaced a
 * little. */
static void cost_grow(oxl_context *ctx, const oxl_model *model, size_t count, oxl_model *out)
{
    oxl_point *point = oxl_calloc(ctx, count + 1, sizeof *point);
    if (!point) cost_check(ctx, oxl_fail(ctx, OXL_ERR_MEMORY, "no memory to time %zu Gaussians", count));
    for (size_t i = 0; i < count; i++) {
        const size_t row = i % model->count;
        const double far =
            i < model->count ? 0 : 2 * COST_SPACING * vecmath_exp(model->plane[OXL_LOG_SCALE][row]);
        for (int a = 0; a < 3; a++)
            point[i].position[a] =
                model->plane[OXL_MEAN + a][row] + far * (random_unit(random_bits(1, i, (uint64_t)a)) - 0.5);
    }
    cost_check(ctx, oxl_model_from_points(ctx, point, count, model->sh_degree, out));
    oxl_free(ctx, point);
}

/* Milliseconds of a step, the mean over some views. */
static double cost_of_step(oxl_context *ctx, const oxl_scene *scene, struct trained_model *trained, int views)
{
    struct cost_probe r = {.ctx = ctx, .render = oxl_render_options_default()};
    const int count = oxl_scene_view_count(scene);
    double sum = 0;
    r.render.near_plane = (float)oxl_scene_near_plane(scene);
    cost_make_target(&r, scene);
    cost_check(ctx, renderer_create(ctx, &r.renderer));
    cost_check(ctx, model_trained_begin(ctx, trained));
    views = OXL_MIN(views, count);
    for (int k = 0; k < views; k++) {
        double least = HUGE_VAL;
        for (int round = 0; round <= COST_ROUNDS; round++) { /* the first makes room */
            const double begun = cost_cpu();
            cost_step(&r, trained, &oxl_scene_view(scene, k * (count - 1) / OXL_MAX(1, views - 1))->camera);
            if (round > 0) least = OXL_MIN(least, cost_cpu() - begun);
        }
        sum += least;
    }
    renderer_free(ctx, r.renderer);
    oxl_free(ctx, r.target);
    return 1e3 * sum / views;
}

static oxl_scene *cost_scene(oxl_context *ctx, const char *path, int side)
{
    oxl_scene_options options = oxl_scene_options_default();
    oxl_scene *scene = NULL;
    options.max_side = side;
    cost_check(ctx, oxl_scene_load(ctx, path, &options, &scene));
    return scene;
}

/* times < 1: of the survey's points, evenly spread over their list; > 1: grown. */
static oxl_model cost_model(oxl_context *ctx, const oxl_scene *scene, double times, int degree)
{
    const size_t points = oxl_scene_point_count(scene), count = (size_t)(times * (double)points);
    oxl_point *some = oxl_calloc(ctx, points + 1, sizeof *some);
    oxl_model model, grown;
    if (!some) cost_check(ctx, oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for %zu points", points));
    for (size_t i = 0; i < OXL_MIN(count, points); i++)
        some[i] = oxl_scene_points(scene)[times < 1 ? (size_t)((double)i / times) : i];
    cost_check(ctx, oxl_model_from_points(ctx, some, OXL_MIN(count, points), degree, &model));
    oxl_free(ctx, some);
    if (count <= points) return model;
    cost_grow(ctx, &model, count, &grown);
    oxl_model_free(ctx, &model);
    return grown;
}

static void cost_line(oxl_context *ctx, const char *path, const char *what, int side, double times,
                      int degree, int views)
{
    oxl_scene *scene = cost_scene(ctx, path, side);
    struct trained_model t = {.model = cost_model(ctx, scene, times, degree)};
    double value = (double)t.model.count;
    const oxl_camera *camera = &oxl_scene_view(scene, 0)->camera;
    if (!strcmp(what, "pixels")) value = (double)camera->width * camera->height;
    if (!strcmp(what, "views")) value = OXL_MIN(views, oxl_scene_view_count(scene));
    if (!strcmp(what, "planes")) value = oxl_model_planes(&t.model);
    if (!strcmp(what, "threads")) value = ctx->threads;
    printf("%s\t%.0f\t%.3f\n", what, value, cost_of_step(ctx, scene, &t, views));
    fflush(stdout);
    model_trained_free(ctx, &t);
    oxl_scene_free(ctx, scene);
}

int main(int argc, char **argv)
{
    static const double times[] = {0.25, 0.5, 1, 2, 4};
    static const int sides[] = {160, 226, 320, 453, 640}, views[] = {3, 6, 12, 24, 48};
    oxl_context_options options = oxl_context_options_default();
    oxl_context *ctx = NULL;
    options.threads = 1;
    if (argc != 2 || oxl_context_create(&options, &ctx) != OXL_OK) return 2;
    printf("#what\tvalue\tms a step\t%s, %s\n", argv[1], oxl_isa_name(ctx));
    for (int i = 0; i < 5; i++) cost_line(ctx, argv[1], "Gaussians", COST_SIDE, times[i], 3, COST_VIEWS);
    for (int i = 0; i < 5; i++) cost_line(ctx, argv[1], "pixels", sides[i], 1, 3, COST_VIEWS);
    for (int i = 0; i < 5; i++) cost_line(ctx, argv[1], "views", COST_SIDE, 1, 3, views[i]);
    for (int degree = 0; degree < 4; degree++)
        cost_line(ctx, argv[1], "planes", COST_SIDE, 1, degree, COST_VIEWS);
    for (ctx->threads = 1; ctx->threads <= 2; ctx->threads++)
        cost_line(ctx, argv[1], "threads", COST_SIDE, 1, 3, COST_VIEWS);
    oxl_context_free(ctx);
    return 0;
}
