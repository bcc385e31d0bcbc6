/* test_train.c - density control row by row, and small runs of the whole loop. */
#include "test.h"

/* ---------------- density */

/* Four Gaussians 1 apart; statistics as if each had been seen once with the given gradient. */
struct density_case {
    struct trained_model trained;
    struct density density;
};

static struct density_case density_case(const float gradient[4])
{
    struct density_case c = {.density = {.capacity = 0}};
    c.trained.model = test_model(4, 1);
    CHECK_OK(model_trained_begin(test_ctx, &c.trained));
    CHECK_OK(density_clear(test_ctx, &c.density, 4));
    for (int i = 0; i < 4; i++) {
        for (int k = 0; k < oxl_model_planes(&c.trained.model); k++)
            c.trained.mean.plane[k][i] = c.trained.square.plane[k][i] = 7;
        c.trained.model.plane[OXL_MEAN][i] = (float)i;
        c.density.gradient[i] = gradient[i];
        c.density.views[i] = 1;
        /* odd ones are large */
        for (int a = 0; a < 3; a++) c.trained.model.plane[OXL_LOG_SCALE + a][i] = i % 2 ? -1.0f : -7.0f;
    }
    return c;
}

static void density_case_free(struct density_case *c)
{
    model_trained_free(test_ctx, &c->trained);
    density_free(test_ctx, &c->density);
}
#define DENSITY_CASE __attribute__((cleanup(density_case_free))) struct density_case

static struct density_change density_run(struct density_case *c, struct density_rules rules)
{
    struct density_change change;
    CHECK_OK(test_density(test_ctx, &c->density, &c->trained, &rules, &change));
    return change;
}

TEST(density_splits_rows_of_large_gradient_in_two_beside_each_other_with_new_moments)
{
    DENSITY_CASE c = density_case((float[]){1, 1, 0, 0});
    const struct density_change d = density_run(&c, (struct density_rules){.gradient = 0.5, .extent = 1});
    const float *x = c.trained.model.plane[OXL_MEAN];
    CHECK(d.split == 2 && d.removed == 0 && c.trained.model.count == 6 && c.trained.mean.count == 6);
    for (int i = 0; i < 4; i += 2) {
        CHECK(x[i] != x[i + 1]);
        CHECK_CLOSE(x[i] + x[i + 1], i, 1e-6); /* the mean stays */
    }
    CHECK(x[4] == 2 && x[5] == 3);
    for (int i = 0; i < 6; i++)
        CHECK(c.trained.mean.plane[0][i] == (i < 4 ? 0 : 7) &&
              c.trained.square.plane[5][i] == (i < 4 ? 0 : 7));
}

TEST(density_control_needs_memory_for_the_new_rows_alone)
{
    enum { ROWS = 20000, GROWN = ROWS - ROWS / 40 + ROWS / 10 };
    struct density density = {0};
    struct density_change change;
    struct density_rules rules = {.gradient = 0.5, .extent = 1};
    struct trained_model t;
    size_t before;
    memory_weigh_start(0);
    t.model = test_model(ROWS, 3);
    CHECK_OK(model_trained_begin(test_ctx, &t));
    CHECK_OK(density_clear(test_ctx, &density, ROWS));
    for (int i = 0; i < ROWS; i++) {
        for (int a = 0; a < 3; a++) t.model.plane[OXL_LOG_SCALE + a][i] = -3;
        t.model.plane[OXL_MEAN][i] = (float)i;
        if (i % 10 == 0) density.gradient[i] = density.views[i] = 1;
        if (i % 40 == 1) t.model.plane[OXL_OPACITY][i] = -9;
    }
    before = memory_weighed.most = memory_weighed.held;
    CHECK_OK(test_density(test_ctx, &density, &t, &rules, &change));
    CHECK(t.model.count == GROWN);
    CHECK(memory_weighed.most - before <
          /* a copy of one of the three has 5 times as much */
          (size_t)4 * OXL_PLANES * 2 * 3 * (GROWN - ROWS));
    for (size_t i = 1; i < GROWN; i++) CHECK(t.model.plane[OXL_MEAN][i] > t.model.plane[OXL_MEAN][i - 1]);
    model_trained_free(test_ctx, &t);
    density_free(test_ctx, &density);
    memory_weigh_end();
}

/* A needle of the given opacity across the image, rendered; with_children: after a split. (1,32,48) of
 * red. */
static void density_render_needle(float opacity, int with_children, float red[32 * 48])
{
    const oxl_camera camera = test_camera(48, 32, 40, 0, 0, 0);
    DENSITY_CASE c = density_case((float[]){1, 0, 0, 0});
    static const float row[] = {0, 0, 4, -1, -1.6f, -2.3f, 0.9f, 0.1f, 0.2f, 0.4f};
    for (int i = 0; i < 4; i++)
        for (int k = 0; k < OXL_SH + 3; k++)
            c.trained.model.plane[k][i] = k == OXL_OPACITY  ? (i ? -20 : logf(opacity / (1 - opacity)))
                                          : k < OXL_OPACITY ? row[k]
                                                            : 1;
    if (with_children)
        CHECK(density_run(&c, (struct density_rules){.gradient = 0.5, .extent = 1}).split == 1);
    OWNED_IMAGE image = test_render(&c.trained.model, &camera);
    memcpy(red, image.rgb, 32 * 48 * sizeof *red);
}

/* Sum of alpha, mean, variances, largest difference of a pixel. What is lost: the image below alpha 1/255,
 * and opacity to second order. */
TEST(density_split_keeps_opacity_place_and_covariance_of_the_rendered_image)
{
    static const float opacities[2] = {0.1f, 0.5f};
    for (int n = 0; n < 2; n++) {
        float image[2][32 * 48];
        double sum[2] = {0}, mean[2] = {0}, across[2] = {0}, down[2] = {0}, most = 0;
        for (int k = 0; k < 2; k++) {
            density_render_needle(opacities[n], k, image[k]);
            for (int i = 0; i < 32 * 48; i++) {
                const double x = i % 48 - 23.5, y = i / 48 - 15.5, v = image[k][i];
                sum[k] += v, mean[k] += v * x, across[k] += v * x * x, down[k] += v * y * y;
                most = OXL_MAX(most, fabs(v - image[0][i]));
            }
        }
        CHECK_CLOSE(sum[1] / sum[0], 1, 0.1);
        CHECK_CLOSE(mean[1] / sum[1], mean[0] / sum[0], 0.2); /* px */
        CHECK_CLOSE(across[1] / sum[1] / (across[0] / sum[0]), 1, 0.1);
        CHECK_CLOSE(down[1] / sum[1] / (down[0] / sum[0]), 1, 0.1);
        CHECK(most < 0.15 * opacities[n]);
    }
}

TEST(density_with_lobes_removes_rows_in_their_order_and_refuses_to_grow)
{
    DENSITY_CASE c = density_case((float[]){0, 0, 0, 0});
    struct density_rules rules = {.gradient = 0.5, .extent = 1};
    for (int k = 0; k < TRAINED_PARTS; k++)
        CHECK_OK(model_set_lobes(test_ctx, model_trained_part(&c.trained, k), 3));
    for (int i = 0; i < 3; i++)
        c.trained.model.plane[OXL_LOBE][i] = c.trained.mean.plane[OXL_LOBE][i] = (float)(10 + i);
    c.trained.model.plane[OXL_OPACITY][0] = -9;
    c.trained.model.plane[OXL_LOBE + 1][2] = NAN;
    struct density_change d = density_run(&c, rules);
    CHECK(d.removed == 2 && c.trained.model.count == 2 && c.trained.model.lobes == 1 &&
          c.trained.mean.lobes == 1 && c.trained.square.lobes == 1);
    CHECK(c.trained.model.plane[OXL_MEAN][0] == 1 && c.trained.model.plane[OXL_MEAN][1] == 3);
    CHECK(c.trained.model.plane[OXL_LOBE][0] == 11 && c.trained.mean.plane[OXL_LOBE][0] == 11);
    c.density.gradient[1] = 1, c.density.views[1] = 1;
    CHECK(test_density(test_ctx, &c.density, &c.trained, &rules, &d) == OXL_ERR_USAGE);
    CHECK(c.trained.model.count == 2);
}

TEST(density_removes_faint_and_nonfinite_rows)
{
    DENSITY_CASE c = density_case((float[]){0, 0, 0, 1});
    c.trained.model.plane[OXL_OPACITY][0] = -6; /* 0.0025 */
    c.trained.model.plane[OXL_MEAN + 1][1] = INFINITY;
    c.trained.model.plane[OXL_SH + 11][3] = NAN; /* although its gradient would have it grow */
    struct density_change d = density_run(&c, (struct density_rules){.gradient = 0.5, .extent = 1});
    CHECK(d.removed == 3 && c.trained.model.count == 1 && c.trained.model.plane[OXL_MEAN][0] == 2);
}

/* Removed, as Kerbl has it, the far water of a turbid survey goes with them, and nothing is left to grow
 * there. */
TEST(density_splits_large_rows_whatever_their_gradient_but_only_after_a_reset)
{
    DENSITY_CASE c = density_case((float[]){0, 0, 0, 0});
    struct density_rules rules = {.gradient = 0.5, .extent = 1};
    struct density_change d = density_run(&c, rules);
    CHECK(d.removed == 0 && d.split == 0);
    rules.split_large = 1;
    d = density_run(&c, rules);
    CHECK(d.removed == 0 && d.split == 2 && c.trained.model.count == 6);
}

TEST(density_cap_splits_the_largest_gradients)
{
    DENSITY_CASE c = density_case((float[]){1, 4, 2, 3});
    const struct density_change d =
        density_run(&c, (struct density_rules){.gradient = 0.5, .extent = 1, .cap = 6});
    CHECK(c.trained.model.count == 6 && d.split == 2);
}

TEST(density_reset_lowers_opacity_to_a_hundredth_and_clears_its_moments)
{
    DENSITY_CASE c = density_case((float[]){0, 0, 0, 0});
    c.trained.model.plane[OXL_OPACITY][1] = -5.5f;
    density_reset_opacity(&c.trained, 0);
    CHECK_CLOSE(1 / (1 + exp(-c.trained.model.plane[OXL_OPACITY][0])), 0.01, 1e-6);
    c.trained.model.plane[OXL_OPACITY][3] = 5;
    density_reset_opacity(&c.trained, 0.04f);
    CHECK_CLOSE(1 / (1 + exp(-c.trained.model.plane[OXL_OPACITY][3])), 0.102, 1e-6); /* still seen */
    CHECK(c.trained.model.plane[OXL_OPACITY][1] == -5.5f && c.trained.mean.plane[OXL_OPACITY][2] == 0 &&
          c.trained.mean.plane[OXL_MEAN][2] == 7);
}

/* Rows 0, 1, 2 seen with the same gradient, from near, from the middle and from afar. */
static struct density_case density_banded_case(void)
{
    struct density_case c = density_case((float[]){0, 0, 0, 0});
    CHECK_OK(density_set_bands(test_ctx, &c.density, 4, 2, 4));
    struct renderer_sums sums = density_sums(&c.density, 4);
    for (int i = 0; i < 3; i++) {
        *(render_depth_sums(&sums, (float[]){1.9f, 2, 4}[i]) + i) += 0.25f;
        c.density.views[i] = 1;
    }
    return c;
}

TEST(density_weights_count_by_the_depth_at_which_a_row_was_seen)
{
    for (int i = 0; i < 3; i++) { /* the threshold is met by nobody; by the far one; by the middle one too */
        DENSITY_CASE c = density_banded_case();
        const struct density_change d = density_run(
            &c, (struct density_rules){
                    .gradient = 0.5, .f_mid = i > 1 ? 2 : 1, .f_far = i > 0 ? 2 : 1.9, .extent = 1});
        CHECK(d.split == (size_t)i); /* rows 1 and 2 */
    }
}

TEST(density_keeps_the_sums_of_the_rows_that_stay)
{
    DENSITY_CASE c = density_banded_case();
    density_keep_rows(&c.density, (const uint8_t[]){0, 1, 1, 0}, 4);
    CHECK(c.density.gradient[0] == 0 && c.density.gradient_mid[0] == 0.25f);
    CHECK(c.density.gradient_far[1] == 0.25f && c.density.views[1] == 1);
}

TEST(density_mean_gradient_is_unweighted)
{
    DENSITY_CASE c = density_banded_case();
    c.density.gradient_far[0] = 0.75f; /* seen once more, from afar */
    c.density.views[0] = 2;
    CHECK(density_mean_gradient(&c.density, 0) == 0.5 && density_mean_gradient(&c.density, 2) == 0.25);
    CHECK(density_mean_gradient(&c.density, 3) == 0);
}

/* Two Gaussians side by side, 1 and 5 away, rendered and compared with nothing. */
static void density_observe_two(struct density *d)
{
    const oxl_camera camera = test_camera(32, 32, 40, 0, 0, 0);
    OWNED_MEMORY float *drgb = oxl_calloc(test_ctx, 3 * 32 * 32, sizeof *drgb);
    OWNED_MODEL model = test_model(2, 0);
    OWNED_MODEL gradient = test_model(2, 0);
    OWNED_RENDERER *r = test_renderer();
    for (int i = 0; i < 2; i++) {
        model.plane[OXL_MEAN][i] = i ? 1.0f : -0.2f;
        model.plane[OXL_MEAN + 2][i] = i ? 5.0f : 1.0f;
        for (int a = 0; a < 3; a++) model.plane[OXL_LOG_SCALE + a][i] = -2;
    }
    for (int i = 0; i < 32 * 32; i++) drgb[i] = (float)(i % 32);
    test_draw(r, &model, &camera);
    CHECK_OK(renderer_backward(test_ctx, r, drgb, &gradient));
    CHECK_OK(density_observe(test_ctx, d, r, 2));
}

static void density_two_state(struct archive *a, void *user)
{
    density_archive(a, user, 2);
}

TEST(density_bands_are_filled_by_camera_depth_and_survive_an_archive)
{
    struct density two[2] = {{0}}, *d = &two[0], *copy = &two[1];
    CHECK_OK(density_set_bands(test_ctx, d, 2, 2, 4));
    CHECK_OK(density_set_bands(test_ctx, copy, 2, 2, 4));
    density_observe_two(d);
    CHECK(d->gradient[0] > 0 && d->gradient_mid[0] == 0 && d->gradient_far[0] == 0 && d->views[0] == 1);
    CHECK(d->gradient[1] == 0 && d->gradient_mid[1] == 0 && d->gradient_far[1] > 0 && d->views[1] == 1);
    test_archive(density_two_state, d, copy);
    CHECK(copy->gradient_far[1] == d->gradient_far[1] && copy->gradient[0] == d->gradient[0] &&
          copy->views[1] == 1);
    CHECK_OK(density_set_bands(test_ctx, d, 2, 0, 0)); /* and without bands all is one sum */
    density_observe_two(d);
    CHECK(d->gradient[0] > 0 && d->gradient[1] == copy->gradient_far[1] &&
          density_mean_gradient(d, 1) == d->gradient[1]);
    density_free(test_ctx, d);
    density_free(test_ctx, copy);
}

/* ---------------- the loop */

/* Views of a coloured plane, rendered by our own renderer from a known model: points near the truth, wrong
 * colours. shine: how much the colours change with the view, in bands of degree 1. */
oxl_scene *train_scene_of(int views, double shine)
{
    enum { SIDE = 48, GRID = 12 };
    oxl_view view[16] = {{0}};
    oxl_image image[16] = {{0}};
    oxl_point point[GRID * GRID];
    OWNED_MODEL truth = test_model(GRID * GRID, 1);
    for (int i = 0; i < GRID * GRID; i++) {
        for (int k = 3; k < 12; k++)
            truth.plane[OXL_SH + k][i] =
                (float)(shine * (random_unit(random_bits(5, (uint64_t)i, (uint64_t)k)) - 0.5));
        const double x = (i % GRID - 5.5) * 0.3, y = (i / GRID - 5.5) * 0.3;
        truth.plane[OXL_MEAN][i] = (float)x;
        truth.plane[OXL_MEAN + 1][i] = (float)y;
        truth.plane[OXL_OPACITY][i] = 4;
        for (int a = 0; a < 3; a++) {
            truth.plane[OXL_LOG_SCALE + a][i] = -1.8f;
            truth.plane[OXL_SH + a][i] =
                (float)(3 * random_unit(random_bits(4, (uint64_t)i, (uint64_t)a)) - 1.5);
        }
        point[i] = (oxl_point){.position = {x + 0.02, y - 0.02, 0.01}, .rgb = {128, 128, 128}};
    }
    for (int v = 0; v < views; v++) {
        static char names[16][16];
        snprintf(names[v], sizeof names[v], "v%02d.png", v);
        view[v] =
            (oxl_view){names[v], test_camera(SIDE, SIDE, 50, -0.2 * (v - 3), -0.1 * (v % 3), -3), v == 3};
        image[v] = test_render(&truth, &view[v].camera);
    }
    return test_scene(view, image, views, point, GRID * GRID);
}

oxl_scene *train_scene(int views)
{
    return train_scene_of(views, 0);
}

oxl_scene *train_scene_changed(int views, const char *const *names,
                               void (*change)(const void *how, const oxl_scene *scene, int view,
                                              oxl_image *image),
                               const void *how)
{
    OWNED_SCENE *plain = train_scene(views);
    oxl_view view[16] = {{0}};
    oxl_image image[16] = {{0}};
    for (int v = 0; v < views; v++) {
        view[v] = *oxl_scene_view(plain, v);
        if (names) view[v].name = names[v];
        CHECK_OK(oxl_scene_image(test_ctx, plain, v, NULL, &image[v]));
        if (change) change(how, plain, v, &image[v]);
    }
    return test_scene(view, image, views, oxl_scene_points(plain), oxl_scene_point_count(plain));
}

oxl_scene *train_scene_of_pairs(int views,
                                void (*change)(const void *how, const oxl_scene *scene, int view,
                                               oxl_image *image),
                                const void *how)
{
    static char text[16][16];
    const char *name[16];
    for (int v = 0; v < views; v++) {
        snprintf(text[v], sizeof text[v], "%02d_%s.png", v / 2 + 1, v % 2 ? "right" : "left");
        name[v] = text[v];
    }
    return train_scene_changed(views, name, change, how);
}

oxl_train_options train_options(int iterations)
{
    oxl_train_options o = oxl_train_options_default(OXL_PRESET_DRAFT);
    o.iterations = iterations;
    o.sh_degree = 1;
    o.stereo = 0; /* The points are those of the scene. */
    return o;
}

double train_psnr(oxl_scene *scene, const oxl_model *model)
{
    return test_evaluate(model, scene, &test_imaging, OXL_SPLIT_TEST).psnr;
}

TEST(train_learns_views_that_it_has_not_seen)
{
    OWNED_SCENE *scene = train_scene(7);
    oxl_train_options options = train_options(300);
    OWNED_MODEL start = test_points(scene, 0);
    OWNED_MODEL model = test_trained(scene, &options);
    CHECK(train_psnr(scene, &start) < 15 && train_psnr(scene, &model) > 25);
    CHECK(model.sh_degree == 1 || !test_has_part("sh_degree"));
}

TEST(train_gives_the_same_bytes_with_1_2_and_7_threads)
{
    OWNED_SCENE *scene = train_scene(7);
    oxl_train_options options = train_options(160); /* densifies at 100 */
    oxl_model model[3];
    for (int i = 0; i < 3; i++) {
        test_ctx->threads = i == 0 ? 1 : i == 1 ? 2 : 7;
        options.densify_until = 0.9f;
        model[i] = test_trained(scene, &options);
    }
    CHECK(model[0].count != oxl_scene_point_count(scene));
    CHECK(test_same_model(&model[0], &model[1]) && test_same_model(&model[0], &model[2]));
    for (int i = 0; i < 3; i++) oxl_model_free(test_ctx, &model[i]);
}

TEST(train_depends_on_the_seed)
{
    OWNED_SCENE *scene = train_scene(7);
    oxl_train_options options = train_options(20);
    OWNED_MODEL a = test_trained(scene, &options);
    test_ctx->options.seed = 2;
    OWNED_MODEL b = test_trained(scene, &options);
    CHECK(!test_same_model(&a, &b));
}

static int train_stop_at_7(void *user, const oxl_progress *progress)
{
    *(int *)user = progress->iteration;
    return progress->iteration == 7;
}

TEST(train_stops_when_the_callback_asks_and_leaves_a_usable_model)
{
    OWNED_SCENE *scene = train_scene(7);
    oxl_train_options options = train_options(100);
    int last = 0;
    const oxl_callback stop = {train_stop_at_7, &last};
    OWNED_MODEL model = {0};
    CHECK(test_train(scene, &options, &stop, &model) == OXL_ERR_INTERRUPTED);
    CHECK(last == 7 && model.count == oxl_scene_point_count(scene));
    CHECK_SAYS("interrupted at iteration 7 of 100");
}

static int train_note_calls(void *user, const oxl_progress *progress)
{
    ((int *)user)[progress->iteration] = (int)(LONG_MAX - allocations_left);
    return 0;
}

TEST(train_allocates_no_memory_between_steps_after_the_first)
{
    OWNED_SCENE *scene = train_scene(7);
    oxl_train_options options = train_options(90);
    int calls[91] = {0};
    const oxl_callback note = {train_note_calls, calls};
    OWNED_MODEL model = {0};
    options.densify_until = 0;
    options.alpha_min = 0; /* else more pixels of a Gaussian count in the last fifth */
    CHECK_OK(test_train(scene, &options, &note, &model));
    CHECK(calls[1] > 0);
    for (int i = 41; i <= 80; i++) CHECK(calls[i] == calls[40]);
}

static oxl_scene *train_scene_from(const oxl_point *points, size_t count)
{
    OWNED_SCENE *with = train_scene(4);
    oxl_view view[4];
    oxl_image image[4];
    for (int v = 0; v < 4; v++) {
        view[v] = *oxl_scene_view(with, v);
        CHECK_OK(oxl_scene_image(test_ctx, with, v, NULL, &image[v]));
    }
    return test_scene(view, image, 4, points, count);
}

TEST(train_without_points_starts_from_random_ones)
{
    OWNED_SCENE *scene = train_scene_from(NULL, 0);
    oxl_train_options options = train_options(3);
    OWNED_MODEL model = test_trained(scene, &options);
    CHECK(model.count > 1000);
}

TEST(train_thins_a_dense_cloud_to_what_pixels_tell_apart_and_takes_points_in_view)
{
    enum { POINTS = 25000 };
    static oxl_point point[POINTS];
    for (int i = 0; i < POINTS; i++)
        point[i] = (oxl_point){.position = {i % 150 * 0.02 - 1.5, i / 150 * 0.02 - 1.5, i % 2 ? 0 : -50}};
    OWNED_SCENE *scene = train_scene_from(point, POINTS);
    oxl_train_options options = train_options(1);
    CHECK(schedule_gaussian_cap_of(20000, 6e5, &options) == 20000);
    CHECK(schedule_gaussian_cap_of(200000, 6e5, &options) == 20000);
    CHECK(schedule_gaussian_cap_of(9000, 6e5, &options) == 10000);
    OWNED_MODEL model = test_trained(scene, &options);
    CHECK(model.count == 10000);
    for (size_t i = 0; i < model.count; i++) CHECK(model.plane[OXL_MEAN + 2][i] > -1);
}

TEST(train_refuses_invalid_options)
{
    OWNED_SCENE *scene = train_scene(2);
    oxl_train_options options = train_options(0);
    oxl_model model;
    CHECK(test_train(scene, &options, NULL, &model) == OXL_ERR_USAGE && model.count == 0);
}

/* ---------------- schedule */

/* ---------------- less work a step */

/* 60 steps: each option leaves a model of its own that has still learned the scene, whatever the number of
 * threads. */
TEST(train_options_that_save_work_change_the_run_and_still_learn)
{
    OWNED_SCENE *scene = train_scene(7);
    oxl_train_options o[6];
    oxl_model model[6];
    const int threads = test_ctx->threads;
    for (int i = 0; i < 6; i++) o[i] = train_options(60), o[i].coarse = 0, o[i].densify_every = 50;
    o[1].coarse = 0.5f, o[2].sh_degree = 0, o[3].short_run_exponent = 0, o[4].cooldown = 0,
    o[5].alpha_min = 0.04f;
    for (int i = 0; i < 6; i++) {
        test_ctx->threads = 1;
        model[i] = test_trained(scene, &o[i]);
        test_ctx->threads = 3;
        OWNED_MODEL again = test_trained(scene, &o[i]);
        CHECK(test_same_model(&model[i], &again));
        CHECK(i == 0 || !test_same_model(&model[i], &model[0]) || (i == 2 && !test_has_part("sh_degree")));
        /* without the larger rates of short runs it learns less */
        CHECK(train_psnr(scene, &model[i]) > train_psnr(scene, &model[0]) - (i == 3 ? 7 : 2));
    }
    test_ctx->threads = threads;
    for (int i = 0; i < 6; i++) oxl_model_free(test_ctx, &model[i]);
}

/* Runs below 700 iterations begin as one of 700. */
TEST(train_of_a_short_run_starts_from_narrower_and_more_opaque_gaussians)
{
    OWNED_SCENE *scene = train_scene(7);
    oxl_train_options o = train_options(1);
    struct train t[2];
    const oxl_model *usual = &t[0].trained.model, *hasty = &t[1].trained.model;
    for (int i = 0; i < 2; i++) {
        t[i] = (struct train){.ctx = test_ctx, .survey = scene, .options = &o};
        o.short_run_exponent = (float)i * 0.1f;
        CHECK_OK(train_begin(&t[i]));
    }
    CHECK(usual->count == hasty->count);
    for (size_t i = 0; i < usual->count; i++) {
        CHECK_CLOSE(usual->plane[OXL_LOG_SCALE + 1][i] - hasty->plane[OXL_LOG_SCALE + 1][i],
                    0.03 * log(30000. / 700), 1e-5);
        CHECK_CLOSE(vecmath_sigmoid(usual->plane[OXL_OPACITY][i]), 0.1, 1e-6);
        CHECK_CLOSE(vecmath_sigmoid(hasty->plane[OXL_OPACITY][i]), 0.1 * pow(30000. / 700, 0.07), 1e-6);
    }
    for (int i = 0; i < 2; i++) train_end(&t[i]);
}

TEST(train_auto_halves_large_images_only)
{
    oxl_train_options o = oxl_train_options_default(OXL_PRESET_DRAFT);
    CHECK(schedule_coarse_fraction(&o, 320, 640) == 0.75 && schedule_coarse_fraction(&o, 639, 400) == 0);
    o.coarse = 0.5f;
    CHECK(schedule_coarse_fraction(&o, 48, 48) == 0.5);
    o = oxl_train_options_default(OXL_PRESET_PAPER);
    CHECK(schedule_coarse_fraction(&o, 8000, 6000) == 0);
}

TEST(train_refuses_second_lobes_while_gaussians_are_still_split)
{
    oxl_train_options o = train_options(5);
    oxl_model model;
    NEEDS_PART(lobes);
    OWNED_SCENE *scene = train_scene(4);
    o.dog = OXL_DOG_ALL, o.densify_until = 0.6f;
    CHECK(test_train(scene, &o, NULL, &model) == OXL_ERR_USAGE);
}

static oxl_adam train_adam_params_at(int step, int iterations, float short_run_exponent, float cooldown)
{
    oxl_train_options o = oxl_train_options_default(OXL_PRESET_STANDARD);
    OWNED_SCENE *scene = train_scene(2);
    const struct train t = {.ctx = test_ctx, .scene = scene, .options = &o, .step = step};
    o.iterations = iterations;
    o.short_run_exponent = short_run_exponent;
    o.cooldown = cooldown;
    return schedule_adam_params(&t);
}

static oxl_adam train_adam_params_of(int iterations, float short_run_exponent)
{
    return train_adam_params_at(1, iterations, short_run_exponent, 0.2f);
}

/* Of 10 001 steps, so that shares of the run are round. */
TEST(train_cooldown_reduces_all_rates_to_a_tenth_at_the_end)
{
    const oxl_adam usual = train_adam_params_at(10001, 10001, 0, 0),
                   before = train_adam_params_at(8000, 10001, 0, 0.2f),
                   within = train_adam_params_at(9001, 10001, 0, 0.2f),
                   end = train_adam_params_at(10001, 10001, 0, 0.2f);
    for (int k = 0; k < OXL_PLANES; k++) {
        CHECK_CLOSE(end.rate[k] / usual.rate[k], 0.1, 1e-6);
        if (k < OXL_LOG_SCALE) continue; /* means shrink in the whole run */
        CHECK(before.rate[k] == usual.rate[k]);
        CHECK_CLOSE(within.rate[k] / usual.rate[k], sqrt(0.1), 1e-6);
    }
    CHECK(end.beta[0] == usual.beta[0] && end.beta[1] == usual.beta[1]);
}

/* But for those of positions; h = (30 000 / 10 001)^0.4. */
TEST(train_rates_of_a_short_run_begin_larger_by_the_root_of_its_factor_and_not_from_its_middle_on)
{
    const double h = pow(30000.0 / 10001, 0.4);
    const oxl_adam start = train_adam_params_at(1, 10001, 0.4f, 0),
                   quarter = train_adam_params_at(2501, 10001, 0.4f, 0),
                   middle = train_adam_params_at(5001, 10001, 0.4f, 0),
                   paper = train_adam_params_at(1, 10001, 0, 0);
    CHECK_CLOSE(start.rate[OXL_OPACITY] / middle.rate[OXL_OPACITY], sqrt(h), 1e-5);
    CHECK_CLOSE(quarter.rate[OXL_OPACITY] / middle.rate[OXL_OPACITY], sqrt(sqrt(h)), 1e-5);
    CHECK(middle.rate[OXL_OPACITY] == paper.rate[OXL_OPACITY]);
    CHECK_CLOSE(start.rate[OXL_MEAN] / paper.rate[OXL_MEAN], h, 1e-5);
}

/* (2000 / 1000)^0.5; and (30 000 / 1000)^0.25 for SH, as in runs above 2000 iterations. */
TEST(train_rates_of_opacity_and_colours_are_larger_below_2000_iterations)
{
    static const int plane[] = {OXL_OPACITY, OXL_SH, OXL_SH + 3};
    const oxl_adam at[2] = {train_adam_params_at(999, 1000, 0.5f, 0),
                            train_adam_params_at(1999, 2000, 0.5f, 0)},
                   paper = train_adam_params_at(999, 1000, 0, 0);
    for (size_t k = 0; k < OXL_COUNT(plane); k++)
        for (int i = 0; i < 2; i++)
            CHECK_CLOSE(at[i].rate[plane[k]] / paper.rate[plane[k]],
                        sqrt(i ? 1 : 2) * (k == 2 ? pow(i ? 15 : 30, 0.25) : 1), 1e-5);
}

/* A sixteenth of the rows in each view: the first steps are four times too large; (30 000 / 1875)^0.5 = 4. */
TEST(train_moves_gaussians_ten_rates_at_most_where_views_show_few_of_them)
{
    oxl_train_options o = oxl_train_options_default(OXL_PRESET_STANDARD);
    OWNED_SCENE *scene = train_scene(2);
    struct train t = {.ctx = test_ctx, .scene = scene, .options = &o, .step = 2};
    oxl_adam few, third;
    o.iterations = 1875, o.short_run_exponent = 0.5f;
    oxl_adam usual = schedule_adam_params(&t);
    t.shown = 1.0 / 16, few = schedule_adam_params(&t);
    t.shown = 1.0 / 3, third = schedule_adam_params(&t);
    for (int k = 0; k < OXL_PLANES; k++) {
        CHECK_CLOSE(few.rate[k] / usual.rate[k], k < OXL_OPACITY ? 10.0 / 16 : 1, 1e-3);
        CHECK(third.rate[k] == usual.rate[k]);
    }
    o.short_run_exponent = 1; /* a factor of 16, which was asked for */
    t.shown = 0, usual = schedule_adam_params(&t);
    t.shown = 1, third = schedule_adam_params(&t);
    t.shown = 1.0 / 16, few = schedule_adam_params(&t);
    for (int k = 0; k < OXL_PLANES; k++) {
        CHECK(third.rate[k] == usual.rate[k]);
        CHECK_CLOSE(few.rate[k] / usual.rate[k], k < OXL_OPACITY ? 1.0 / 4 : 1, 1e-3);
    }
    o.iterations = 30000, o.short_run_exponent = 0.5f;
    t.shown = 0, usual = schedule_adam_params(&t);
    t.shown = 1.0 / 16, few = schedule_adam_params(&t);
    for (int k = 0; k < OXL_PLANES; k++) CHECK(few.rate[k] == usual.rate[k]);
    o.iterations = 1875, t.step = 1875, t.shown = 0.99, few = schedule_adam_params(&t);
    t.shown = 0, usual = schedule_adam_params(&t);
    for (int k = 0; k < OXL_PLANES; k++) CHECK(few.rate[k] == usual.rate[k]);
}

static int train_test_shows(const oxl_camera *c, const oxl_model *m, size_t row)
{
    double x[3];
    for (int i = 0; i < 3; i++) {
        x[i] = c->translation[i];
        for (int k = 0; k < 3; k++) x[i] += c->rotation[3 * i + k] * m->plane[OXL_MEAN + k][row];
    }
    return x[2] > 0 && fabs(c->fx * x[0] / x[2] + c->cx - c->width / 2.0) < c->width / 2.0 &&
           fabs(c->fy * x[1] / x[2] + c->cy - c->height / 2.0) < c->height / 2.0;
}

/* Every second camera is moved to where it sees nothing. Of a block, windows count: a third and the rest. */
TEST(train_knows_which_share_of_the_gaussians_a_view_shows)
{
    struct image_window window[14];
    double all = 0;
    oxl_train_options o = train_options(10);
    struct train t = {.ctx = test_ctx, .survey = train_scene(14), .options = &o};
    OWNED_SCENE *scene = (oxl_scene *)t.survey;
    size_t shown = 0;
    for (int i = 0; i < 14; i += 2) scene->view[i].camera.translation[0] += 1000;
    CHECK_OK(train_begin(&t));
    for (int i = 0; i < t.views; i++)
        for (size_t row = 0; row < t.trained.model.count; row++)
            shown += train_test_shows(&oxl_scene_view(scene, t.view[i])->camera, &t.trained.model, row);
    CHECK(shown > 0);
    CHECK_CLOSE(t.shown, (double)shown / t.views / (double)t.trained.model.count, 1e-2);
    train_end(&t);
    for (int right = 0; right < 2; right++) {
        struct train part = {.ctx = test_ctx, .survey = scene, .options = &o};
        for (int i = 0; i < 14; i++) {
            const oxl_camera *c = &oxl_scene_view(scene, i)->camera;
            window[i] = (struct image_window){right * (c->width / 3), 0, c->width / 3, c->height};
            if (right) window[i].width = c->width - window[i].x;
        }
        part.task.window = window;
        CHECK_OK(train_begin(&part));
        CHECK(part.shown > 0.05 * t.shown && part.shown < 0.95 * t.shown);
        all += part.shown;
        train_end(&part);
    }
    CHECK_CLOSE(all, t.shown, 1e-12);
}

TEST(train_counts_every_contribution_from_four_fifths_of_the_run_on_with_or_without_cooldown)
{
    const oxl_train_options o = {.iterations = 1000, .alpha_min = 0.03f};
    struct train t = {.options = &o, .step = 800};
    CHECK(schedule_alpha_min(&t) == 0.03f);
    t.step++;
    CHECK(schedule_alpha_min(&t) == 0);
}

TEST(train_keeps_less_momentum_the_shorter_the_run_and_kerbls_from_7000_iterations_on)
{
    const oxl_adam full = train_adam_params_of(7000, 0.35f), shortened = train_adam_params_of(1400, 0.35f),
                   least = train_adam_params_of(10, 0.45f), usual = train_adam_params_of(700, 0);
    CHECK(full.beta[0] == 0.9 && full.beta[1] == 0.999);
    CHECK(usual.beta[0] == 0.9 && usual.beta[1] == 0.999 && usual.rate[OXL_LOG_SCALE] == 0.005f);
    CHECK_CLOSE(shortened.beta[0], 1 - 0.1 * pow(5, 0.7), 1e-6);
    CHECK_CLOSE(shortened.beta[1], 1 - 0.001 * pow(5, -0.525), 1e-6);
    CHECK_CLOSE(shortened.rate[OXL_LOG_SCALE], 0.005 * pow(300.0 / 14, 0.35 + 0.175) * pow(5, 0.175), 1e-4);
    CHECK(least.beta[0] == 0.5 && least.beta[1] > shortened.beta[1] && least.beta[1] < 1);
}

TEST(train_grows_sooner_where_a_scene_has_no_points)
{
    oxl_train_options o = oxl_train_options_default(OXL_PRESET_DRAFT);
    OWNED_PRUNE_CASE none = prune_two_patches(4, 3, 0.5f);
    OWNED_SCENE *some = train_scene(4);
    CHECK(oxl_scene_point_count(none.scene) == 0 && o.densify_gradient == 5.5e-4f);
    CHECK(schedule_densify_gradient(some, &o) == 5.5e-4f);
    CHECK(schedule_densify_gradient(none.scene, &o) == 5.5e-4f); /* Stereo finds points. */
    ((oxl_scene *)none.scene)->transparent = 1;
    CHECK(schedule_densify_gradient(none.scene, &o) == 2e-4f);
    o.densify_gradient = 1e-4f;
    CHECK(schedule_densify_gradient(none.scene, &o) == 1e-4f);
}

/* ---------------- terms of one's own */

static double train_no_pixels(void *user, const oxl_image *rendered, const oxl_image *image, float *drgb)
{
    (void)user, (void)drgb;
    CHECK(rendered->width == image->width && rendered->height == image->height &&
          rendered->rgb != image->rgb);
    return 0;
}

static double train_no_parameters(void *user, const oxl_model *model, oxl_model *gradient)
{
    (void)user;
    CHECK(gradient->count == model->count && gradient->sh_degree == model->sh_degree);
    return 0;
}

/* The gradient exists as planes for the second, and stays in the cache for the others. */
TEST(train_with_terms_that_add_nothing_gives_the_same_bytes)
{
    OWNED_SCENE *scene = train_scene(7);
    oxl_train_options o = train_options(60);
    const oxl_terms terms[] = {{.pixels = train_no_pixels}, {.parameters = train_no_parameters}};
    o.dog = OXL_DOG_ALL;
    OWNED_MODEL plain = test_trained(scene, &o);
    for (int k = 0; k < 2; k++) {
        o.terms = &terms[k];
        OWNED_MODEL with = test_trained(scene, &o);
        CHECK(test_same_model(&plain, &with));
    }
}

/* Drives red down: d/dx of the mean of red is 1 / pixels. */
static double train_red(void *user, const oxl_image *rendered, const oxl_image *image, float *drgb)
{
    const int pixels = image->width * image->height;
    double sum = 0;
    (void)user;
    for (int i = 0; i < pixels; i++) sum += rendered->rgb[i], drgb[i] += 10.0f / (float)pixels;
    return 10 * sum / pixels;
}

/* Drives Gaussians to transparency. */
static double train_opacity(void *user, const oxl_model *model, oxl_model *gradient)
{
    (void)user;
    for (size_t i = 0; i < model->count; i++) gradient->plane[OXL_OPACITY][i] += 1;
    return 0;
}

static double train_mean_of(const oxl_model *m, int plane)
{
    double sum = 0;
    for (size_t i = 0; i < m->count; i++) sum += m->plane[plane][i];
    return sum / (double)m->count;
}

TEST(train_follows_terms_on_pixels_and_on_parameters)
{
    OWNED_SCENE *scene = train_scene(7);
    oxl_train_options o = train_options(60);
    const oxl_terms red = {.pixels = train_red}, opacity = {.parameters = train_opacity};
    o.densify_until = 0;
    OWNED_MODEL plain = test_trained(scene, &o);
    o.terms = &red;
    OWNED_MODEL less_red = test_trained(scene, &o);
    o.terms = &opacity;
    OWNED_MODEL clear = test_trained(scene, &o);
    CHECK(train_mean_of(&less_red, OXL_SH) < train_mean_of(&plain, OXL_SH) - 0.1);
    CHECK_CLOSE(train_mean_of(&less_red, OXL_SH + 1), train_mean_of(&plain, OXL_SH + 1), 0.05);
    CHECK(train_mean_of(&clear, OXL_OPACITY) < train_mean_of(&plain, OXL_OPACITY) - 0.5);
}

static double train_nan_pixels(void *user, const oxl_image *rendered, const oxl_image *image, float *drgb)
{
    (void)user, (void)rendered, (void)image, (void)drgb;
    return NAN;
}

static double train_nan_parameters(void *user, const oxl_model *model, oxl_model *gradient)
{
    (void)user, (void)model, (void)gradient;
    return NAN;
}

TEST(train_ends_with_the_name_of_a_term_that_is_not_finite)
{
    OWNED_SCENE *scene = train_scene(7);
    oxl_train_options o = train_options(20);
    oxl_trained t;
    o.terms = &(const oxl_terms){.pixels = train_nan_pixels};
    CHECK_ERROR(oxl_train(test_ctx, scene, &o, NULL, &t), OXL_ERR_USAGE, "oxl_terms.pixels returned");
    o.terms = &(const oxl_terms){.parameters = train_nan_parameters};
    CHECK_ERROR(oxl_train(test_ctx, scene, &o, NULL, &t), OXL_ERR_USAGE, "oxl_terms.parameters returned");
}

/* Removes the Gaussians whose number is odd at first, and splits none. */
static void train_halve(void *user, const oxl_model *model, const float *gradient, const float *views,
                        uint8_t *change)
{
    int *times = user, split = 0, grows = 0;
    for (size_t i = 0; i < model->count; i++) {
        split += change[i] == OXL_SPLIT, grows += views[i] > 0 && gradient[i] / views[i] > 0;
        change[i] = *times == 0 && i % 2 ? OXL_REMOVE : OXL_KEEP;
    }
    CHECK(grows > 0 && split <= grows);
    ++*times;
}

TEST(train_follows_a_density_rule)
{
    OWNED_SCENE *scene = train_scene(7);
    oxl_train_options o = train_options(60);
    int times = 0;
    const oxl_terms terms = {.density = train_halve, .user = &times};
    const size_t points = oxl_scene_point_count(scene);
    o.densify_until = 0.8f, o.densify_every = 15, o.densify_gradient = 1e-5f;
    OWNED_MODEL plain = test_trained(scene, &o);
    o.terms = &terms;
    OWNED_MODEL halved = test_trained(scene, &o);
    CHECK(times > 1 && plain.count > points && halved.count == (points + 1) / 2);
}

TEST(train_starts_from_a_model_in_its_own_origin)
{
    OWNED_SCENE *scene = train_scene(7);
    oxl_train_options o = train_options(1);
    const double away[3] = {100, -50, 7};
    oxl_trained t;
    oxl_model from = test_model(0, 0);
    o.from = &from;
    CHECK(oxl_train(test_ctx, scene, &o, NULL, &t) == OXL_ERR_USAGE);
    oxl_model_free(test_ctx, &from);
    from = test_model_of(oxl_scene_points(scene), 9, 0);
    memcpy(from.origin, oxl_scene_origin(scene), sizeof from.origin);
    oxl_model_move_origin(&from, away);
    CHECK_OK(oxl_train(test_ctx, scene, &o, NULL, &t));
    CHECK(t.model.count > 0 && t.model.count <= 9);
    for (size_t i = 0; i < t.model.count; i++) {
        double nearest = HUGE_VAL;
        for (size_t k = 0; k < 9; k++)
            nearest =
                OXL_MIN(nearest, fabs(oxl_scene_points(scene)[k].position[0] - t.model.plane[OXL_MEAN][i]));
        CHECK_CLOSE(nearest, 0, 0.2);
    }
    oxl_trained_free(test_ctx, &t);
    oxl_model_free(test_ctx, &from);
}
