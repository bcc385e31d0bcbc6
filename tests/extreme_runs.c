/* extreme_runs.c - the loss, the optimiser and whole short runs at the extremes; see extreme_cases.c. */
#ifndef TEST_EXTREME_RUNS_C
#define TEST_EXTREME_RUNS_C
#include "extreme_cases.c"

/* ---------------- loss */

struct extreme_loss {
    const char *what;
    int width, height;
    double x, y, ripple;    /* grey values, and what is added to x from pixel to pixel */
    double value, gradient; /* asserted: absolute error of the loss, relative one of its gradient */
};

static const struct extreme_loss EXTREME_LOSSES[] = {
    {"loss: noise against grey", 64, 48, 0.5, 0.5, 0.2, 1e-7, 2e-5},
    {"loss: both grey", 64, 48, 0.5, 0.5, 0, 1e-7, 5e-4},
    {"loss: both black", 64, 48, 0, 0, 0, 1e-7, 5e-4},
    {"loss: both white", 64, 48, 1, 1, 0, 1e-7, 5e-4},
    {"loss: black against white", 64, 48, 0, 1, 0, 1e-7, 5e-6},
    {"loss: 1e4 against white", 64, 48, 1e4, 1, 0, 1e-4, 5e-4},
    {"loss: noise of 1e-4 on white", 64, 48, 1, 1, 1e-4, 2e-6, 5e-4},
    {"loss: 1 x 1 px", 1, 1, 0.3, 0.6, 0, 1e-7, 1e-6},
    {"loss: 1 x 5000 px", 1, 5000, 0.3, 0.6, 0.2, 1e-7, 1e-6},
};

static void extreme_run_loss(oxl_context *ctx, const struct extreme_loss *e, double *value,
                             struct extreme_error *gradient)
{
    const size_t n = 3 * (size_t)e->width * e->height;
    float *x = wide_array(n), *y = wide_array(n), *dx = wide_array(n);
    double *x_f64 = wide_array(n), *y_f64 = wide_array(n), *dx_f64 = wide_array(n);
    const struct loss_job job = {e->width, e->height, 0.2f, x, y, NULL, dx, 0};
    struct loss_scratch scratch = {0};
    struct renderer_loss narrow;
    struct extreme_sums sums = {.finite = 1};
    for (size_t i = 0; i < n; i++) {
        x_f64[i] = x[i] = (float)(e->x + e->ripple * extreme_random(i, 3));
        y_f64[i] = y[i] = (float)e->y;
    }
    extreme_must(ctx, loss_forward_backward(ctx, &job, &scratch, &narrow));
    double exact = kernels_loss(e->width, e->height, 0.2, x_f64, y_f64, NULL, dx_f64).total;
    extreme_compare(&sums, dx, dx_f64, n);
    *gradient = extreme_error(&sums, 0.8 / (double)n); /* no less than the pull of L1 */
    *value = fabs(narrow.total - exact);
    loss_free(ctx, &scratch);
    free(x), free(y), free(dx);
    free(x_f64), free(y_f64), free(dx_f64);
}

/* ---------------- Adam */

struct extreme_adam {
    const char *what;
    double gradient; /* of every step, */
    int swings;      /* or with alternating signs */
    int steps;
    double bound; /* asserted: of |float - double| / the distance that as many full steps would go */
};

static const struct extreme_adam EXTREME_ADAMS[] = {
    {"Adam: 1e6 steps with gradient 0", 0, 0, 1000000, 0},
    {"Adam: 1e6 steps with gradient 1e-30", 1e-30, 0, 1000000, 1e-15},
    {"Adam: 1e6 steps with gradient 1e-10", 1e-10, 0, 1000000, 2e-2},
    {"Adam: 1e6 steps with gradient 1", 1, 0, 1000000, 2e-2},
    {"Adam: 1e6 steps with gradient +-1", 1, 1, 1000000, 1e-8},
    {"Adam: 1e6 steps with gradient 1e20", 1e20, 0, 1000000, 2e-2},
    {"Adam: 1000 steps with gradient -1e38", -1e38, 0, 1000, 1e-5},
};

static struct extreme_error extreme_run_adam(oxl_context *ctx, const struct extreme_adam *e)
{
    uint16_t all = 0xFFFF;
    const double rate = 1e-3;
    float value[3][PACK] = {{0}}, gradient[PACK], log_scale[PACK] = {0};
    double value_f64[3][PACK] = {{0}}, gradient_f64[PACK];
    struct adam_job job = {.end_pack = 1,
                           .visible = &all,
                           .planes = 1,
                           .beta1 = (float)0.9,
                           .beta2 = (float)0.999,
                           .parameter = {value[0], NULL, NULL, log_scale, log_scale, log_scale},
                           .mean = {value[1]},
                           .square = {value[2]},
                           .gradient = {gradient}};
    struct extreme_error error = {0, 0, 1};
    for (int step = 1; step <= e->steps; step++) {
        const double first = 1 - vecmath_exp(step * vecmath_log(0.9)),
                     second = 1 - vecmath_exp(step * vecmath_log(0.999));
        for (int l = 0; l < PACK; l++)
            gradient_f64[l] = gradient[l] = (float)(e->swings && step % 2 ? -e->gradient : e->gradient);
        job.rate[0] = (float)(rate / first);
        job.inverse_correction = (float)(1 / sqrt(second));
        adam_step(ctx->isa, &job);
        kernels_adam(value_f64[0], gradient_f64, rate, step, value_f64[1], value_f64[2]);
    }
    for (int l = 0; l < PACK; l++) {
        const double off = fabs(value[0][l] - value_f64[0][l]) / (rate * e->steps);
        for (int k = 0; k < 3; k++) error.finite &= fabsf(value[k][l]) <= FLT_MAX;
        error.most = OXL_MAX(error.most, off);
        error.mean += off / PACK;
    }
    return error;
}

/* ---------------- surveys: shifted, scaled, degenerate */

enum { EXTREME_VIEWS = 6, EXTREME_SIDE = 40, EXTREME_GRID = 10, EXTREME_STEPS = 60 };

struct extreme_survey {
    const char *what;
    double shift, unit; /* the world's: unit x (x + shift / unit) */
    int points, twins;  /* 0: all of the grid; 1: all views stand in one place */
    double paint;       /* grey of every image; -1: the image */
    /* asserted: the largest mean difference of a image from that of the plain survey; -1: finite alone */
    double image;
};

/* Another unit rounds logs of scales anew, and training lets that grow: the row of 1.0001 shows how far, and
 * the others are to differ as little. */
static const struct extreme_survey EXTREME_SURVEYS[] = {
    {"survey: unchanged", 0, 1, 0, 0, -1, 0},
    {"survey: 1e6 m from the origin", 1e6, 1, 0, 0, -1, 1e-3},
    {"survey: 1e7 m from the origin", 1e7, 1, 0, 0, -1, 1e-3},
    {"survey: in units of 1.0001, which changes only rounding", 0, 1.0001, 0, 0, -1, 2e-2},
    {"survey: in units of 1e-3", 0, 1e-3, 0, 0, -1, 2e-2},
    {"survey: in units of 1024", 0, 1024, 0, 0, -1, 2e-2},
    {"survey: in units of 1e5", 0, 1e5, 0, 0, -1, 2e-2},
    {"survey: one point", 0, 1, 1, 0, -1, -1},
    {"survey: all views in one place", 0, 1, 0, 1, -1, -1},
    {"survey: all points in one place", 0, 1, -1, 0, -1, -1},
    {"survey: all images black", 0, 1, 0, 0, 0, -1},
    {"survey: all images white", 0, 1, 0, 0, 1, -1},
};

/* A coloured wall of EXTREME_GRID^2 patches. */
static void extreme_wall(oxl_context *ctx, oxl_model *wall)
{
    extreme_must(ctx, oxl_model_create(ctx, EXTREME_GRID * EXTREME_GRID, 0, wall));
    for (int i = 0; i < EXTREME_GRID * EXTREME_GRID; i++) {
        wall->plane[OXL_MEAN][i] = 0.3f * (float)(i % EXTREME_GRID - EXTREME_GRID / 2);
        wall->plane[OXL_MEAN + 1][i] = 0.3f * (float)(i / EXTREME_GRID - EXTREME_GRID / 2);
        wall->plane[OXL_OPACITY][i] = 4;
        for (int a = 0; a < 3; a++) {
            wall->plane[OXL_LOG_SCALE + a][i] = -1.8f;
            wall->plane[OXL_SH + a][i] = (float)(1.5 * extreme_random((size_t)i, (size_t)a));
        }
    }
}

static oxl_camera extreme_view(int i, int twins)
{
    const int v = twins ? 2 : i;
    return (oxl_camera){EXTREME_SIDE,
                        EXTREME_SIDE,
                        42,
                        42,
                        20,
                        20,
                        {1, 0, 0, 0, 1, 0, 0, 0, 1},
                        /* nearly one place: images with the same pose, in no track, are left out */
                        {0.2 * (v - 3) + twins * 1e-12 * i, 0.1 * (v % 3), 3}};
}

static void extreme_write_images(oxl_context *ctx, const struct extreme_survey *e, const char *folder)
{
    oxl_model wall;
    char path[700];
    extreme_wall(ctx, &wall);
    snprintf(path, sizeof path, "%s/images", folder);
    extreme_must(ctx, oxl_make_folder(ctx, path));
    for (int v = 0; v < EXTREME_VIEWS; v++) {
        const oxl_camera camera = extreme_view(v, e->twins);
        oxl_image image;
        extreme_must(ctx, oxl_render(ctx, &wall, &camera, NULL, &image, NULL));
        for (int i = 0; i < 3 * EXTREME_SIDE * EXTREME_SIDE && e->paint >= 0; i++)
            image.rgb[i] = (float)e->paint;
        snprintf(path, sizeof path, "%s/images/%d.png", folder, v);
        extreme_must(ctx, oxl_image_write(ctx, path, &image));
        oxl_image_free(ctx, &image);
    }
    oxl_model_free(ctx, &wall);
}

static void extreme_write_text(oxl_context *ctx, const char *folder, const char *name, const struct text *t)
{
    char path[700];
    snprintf(path, sizeof path, "%s/%s", folder, name);
    extreme_must(ctx, os_write_file(ctx, path, t->data, t->size));
}

/* The wall and its cameras as a COLMAP text export, in the world of this survey. */
static void extreme_write_survey(oxl_context *ctx, const struct extreme_survey *e, const char *folder)
{
    const int grid = EXTREME_GRID * EXTREME_GRID, points = e->points > 0 ? e->points : grid;
    struct text cameras = {.ctx = ctx}, images = {.ctx = ctx}, cloud = {.ctx = ctx};
    extreme_write_images(ctx, e, folder);
    text_add(&cameras, "1 PINHOLE %d %d 42 42 20 20\n", EXTREME_SIDE, EXTREME_SIDE);
    for (int v = 0; v < EXTREME_VIEWS; v++) {
        const oxl_camera c = extreme_view(v, e->twins);
        text_add(&images, "%d 1 0 0 0 %.17g %.17g %.17g 1 %d.png\n\n", v + 1,
                 e->unit * c.translation[0] - e->shift, e->unit * c.translation[1] - e->shift,
                 e->unit * c.translation[2] - e->shift, v);
    }
    for (int i = 0; i < points; i++) {
        const int at = e->points < 0 ? 44 : i;
        text_add(&cloud, "%d %.17g %.17g %.17g 128 128 128 0.5 1 0 2 0 3 0\n", i + 1,
                 e->unit * 0.3 * (at % EXTREME_GRID - EXTREME_GRID / 2) + e->shift,
                 e->unit * 0.3 * (at / EXTREME_GRID - EXTREME_GRID / 2) + e->shift,
                 e->unit * 0.01 + e->shift);
    }
    extreme_write_text(ctx, folder, "cameras.txt", &cameras);
    extreme_write_text(ctx, folder, "images.txt", &images);
    extreme_write_text(ctx, folder, "points3D.txt", &cloud);
    text_free(&cameras), text_free(&images), text_free(&cloud);
}

static int extreme_count_nonfinite(void *user, const oxl_progress *p)
{
    *(oxl_nonfinite *)user = p->nonfinite;
    return 0;
}

/* Trains the survey for a short while and draws its views, (EXTREME_VIEWS,3,SIDE,SIDE). Returns 1 when all of
 * it is finite. */
static int extreme_train(oxl_context *ctx, const struct extreme_survey *e, const char *folder, float *images)
{
    const size_t values = 3 * EXTREME_SIDE * EXTREME_SIDE;
    oxl_train_options train = oxl_train_options_default(OXL_PRESET_DRAFT);
    oxl_scene_options load = oxl_scene_options_default();
    oxl_render_options draw = oxl_render_options_default();
    oxl_nonfinite found = {0};
    const oxl_callback count = {extreme_count_nonfinite, &found};
    oxl_scene *scene;
    oxl_model model;
    int finite = 1;
    train.iterations = EXTREME_STEPS;
    train.sh_degree = 1;
    train.stereo = 0; /* A point that is rounded otherwise may fall into another place. */
    load.test_every = 0;
    extreme_write_survey(ctx, e, folder);
    extreme_must(ctx, oxl_scene_load(ctx, folder, &load, &scene));
    extreme_must(ctx, train_run(ctx, scene, &train, &count, &(struct train_task){.first = 0}, &model));
    draw.near_plane = (float)oxl_scene_near_plane(scene);
    for (int v = 0; v < EXTREME_VIEWS; v++) {
        oxl_image image;
        extreme_must(ctx, oxl_render(ctx, &model, &oxl_scene_view(scene, v)->camera, &draw, &image, NULL));
        memcpy(images + (size_t)v * values, image.rgb, values * sizeof *images);
        oxl_image_free(ctx, &image);
    }
    for (size_t i = 0; i < model.count; i++) finite &= model_row_is_finite(&model, i);
    for (size_t i = 0; i < EXTREME_VIEWS * values; i++) finite &= fabsf(images[i]) <= FLT_MAX;
    finite &= found.steps == 0 && found.rows == 0 && found.cleared == 0 && found.images == 0;
    oxl_model_free(ctx, &model);
    oxl_scene_free(ctx, scene);
    return finite;
}

enum { EXTREME_VALUES = EXTREME_VIEWS * 3 * EXTREME_SIDE * EXTREME_SIDE };

static int extreme_survey_holds(const struct extreme_survey *e, const struct extreme_error *error)
{
    return error->finite && (e->image < 0 || error->mean <= e->image);
}

/* most: largest difference of a value; mean: of the view that differs most. Both in units of full white. */
static struct extreme_error extreme_run_survey(oxl_context *ctx, const struct extreme_survey *e,
                                               const char *folder, const float *plain)
{
    struct extreme_error error = {0};
    float *images = wide_array(EXTREME_VALUES);
    const int values = EXTREME_VALUES / EXTREME_VIEWS;
    error.finite = extreme_train(ctx, e, folder, images);
    for (int v = 0; v < EXTREME_VIEWS; v++) {
        double sum = 0;
        for (int i = v * values; i < (v + 1) * values; i++) {
            const double off = fabs((double)images[i] - plain[i]);
            error.most = OXL_MAX(error.most, off);
            sum += off / values;
        }
        error.mean = OXL_MAX(error.mean, sum);
    }
    free(images);
    return error;
}

#endif
