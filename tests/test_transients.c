/* test_transients.c - content of one image alone is masked; content of all images, or not learned yet,
 * is not. */
#include "test.h"
#include "../src/parts/transients.h"

enum {
    TRANSIENTS_TEST_SIDE = 48,
    TRANSIENTS_TEST_PIXELS = TRANSIENTS_TEST_SIDE * TRANSIENTS_TEST_SIDE,
    TRANSIENTS_TEST_PATCH = 12
};

struct transients_case {
    oxl_scene *scene;
    struct transients transients;
    float rendered[3 * TRANSIENTS_TEST_PIXELS], image[3 * TRANSIENTS_TEST_PIXELS],
        weight[TRANSIENTS_TEST_PIXELS];
};

static struct transients_case *transients_case(void)
{
    struct transients_case *c = calloc(1, sizeof *c);
    c->scene = train_scene(7);
    CHECK_OK(transients_begin(test_ctx, &c->transients, c->scene, 1));
    return c;
}

static void transients_case_free(struct transients_case *c)
{
    transients_free(&(struct train){.ctx = test_ctx}, &c->transients);
    oxl_scene_free(test_ctx, c->scene);
    free(c);
}

/* Adds a square with its corner at (x, y). */
static void transients_test_paint(float *rgb, int x, int y, float by)
{
    for (int c = 0; c < 3; c++)
        for (int j = 0; j < TRANSIENTS_TEST_PATCH; j++)
            for (int i = 0; i < TRANSIENTS_TEST_PATCH; i++)
                rgb[c * TRANSIENTS_TEST_PIXELS + (y + j) * TRANSIENTS_TEST_SIDE + x + i] += by;
}

static void transients_test_step(struct transients_case *c, int view, int masked)
{
    const struct transients_view v = {
        &oxl_scene_view(c->scene, view)->camera, 0.2, c->rendered, c->image, c->weight, masked};
    CHECK_OK(transients_mask(test_ctx, &c->transients, c->scene, &v, 1));
}

static int transients_test_masked(const struct transients_case *c)
{
    int count = 0;
    for (int i = 0; i < TRANSIENTS_TEST_PIXELS; i++) count += c->weight[i] == 0;
    return count;
}

TEST(transients_a_square_in_one_image_is_masked_and_nothing_else)
{
    struct transients_case *c = transients_case();
    /* texture that is not learned yet: large errors of zero mean */
    for (int i = 0; i < 3 * TRANSIENTS_TEST_PIXELS; i++)
        c->image[i] = 0.5f + (i % 2 ? 0.2f : -0.2f), c->rendered[i] = 0.5f;
    for (int k = 0; k < 30; k++) transients_test_step(c, k % 7, 0);
    CHECK(transients_test_masked(c) == 0);
    transients_test_paint(c->image, 16, 20, 0.3f);
    transients_test_step(c, 3, 0);
    CHECK(transients_test_masked(c) == TRANSIENTS_TEST_PATCH * TRANSIENTS_TEST_PATCH);
    CHECK(c->weight[20 * TRANSIENTS_TEST_SIDE + 16] == 0 && c->weight[31 * TRANSIENTS_TEST_SIDE + 27] == 0);
    CHECK(c->weight[19 * TRANSIENTS_TEST_SIDE + 16] == 1 && c->weight[31 * TRANSIENTS_TEST_SIDE + 28] == 1);
    /* a fainter neighbour: one square of it, 4 px wide, is masked too */
    transients_test_paint(c->image, 28, 20, 0.04f);
    transients_test_step(c, 3, 0);
    CHECK(transients_test_masked(c) == (TRANSIENTS_TEST_PATCH + 4) * TRANSIENTS_TEST_PATCH);
    CHECK(c->weight[20 * TRANSIENTS_TEST_SIDE + 31] == 0 && c->weight[20 * TRANSIENTS_TEST_SIDE + 32] == 1);
    transients_case_free(c);
}

TEST(transients_errors_common_to_all_views_are_not_masked)
{
    struct transients_case *c = transients_case();
    transients_test_paint(c->image, 16, 20, 0.15f); /* hard to model: in all views, from the first step on */
    for (int k = 0; k < 200; k++) {
        transients_test_step(c, 3, 0);
        CHECK(transients_test_masked(c) == 0);
    }
    memset(c->image, 0, sizeof c->image); /* learned: a fish in front of it is then found */
    for (int k = 0; k < 30; k++) transients_test_step(c, 3, 0);
    transients_test_paint(c->image, 16, 20, 0.15f);
    transients_test_step(c, 3, 0);
    CHECK(transients_test_masked(c) == TRANSIENTS_TEST_PATCH * TRANSIENTS_TEST_PATCH);
    transients_case_free(c);
}

TEST(transients_masks_are_kept_and_masked_points_are_not_updated)
{
    struct transients_case *c = transients_case();
    float before, after;
    size_t hidden = 0;
    for (int i = 0; i < TRANSIENTS_TEST_PIXELS; i++) c->weight[i] = i / TRANSIENTS_TEST_SIDE < 24 ? 0 : 1;
    transients_test_step(c, 3, 1);
    CHECK(transients_test_masked(c) == TRANSIENTS_TEST_PIXELS / 2);
    while (hidden < c->transients.points &&
           (c->transients.place[hidden] < 0 || c->transients.place[hidden] >= 60))
        hidden++;
    CHECK(hidden < c->transients.points); /* 5 of 12 rows of squares: inside the mask */
    before = c->transients.expected[hidden];
    transients_test_step(c, 3, 1);
    after = c->transients.expected[hidden];
    CHECK(before == after && before == TRANSIENTS_MAX);
    for (int i = 0; i < TRANSIENTS_TEST_PIXELS; i++) c->weight[i] = 0;
    transients_test_step(c, 3, 0); /* without a mask all weights are set */
    CHECK(transients_test_masked(c) == 0 && c->transients.expected[hidden] < before);
    transients_case_free(c);
}

TEST(transients_without_points_are_off_with_a_warning)
{
    oxl_view view = {"a.png", {8, 8, 9, 9, 4, 4, {1, 0, 0, 0, 1, 0, 0, 0, 1}, {0}}, 0};
    oxl_image image = {0};
    oxl_scene *scene = NULL;
    struct transients r;
    CHECK_OK(oxl_image_create(test_ctx, 8, 8, &image));
    CHECK_OK(oxl_scene_from_arrays(test_ctx, &view, &image, 1, NULL, 0, &scene));
    nonfinite_log[0] = 0;
    test_ctx->options.log = nonfinite_listen;
    CHECK_OK(transients_begin(test_ctx, &r, scene, 1));
    CHECK(r.points == 0 && !r.expected);
    CHECK_TEXT(nonfinite_log, "the scene has no points");
    transients_free(&(struct train){.ctx = test_ctx}, &r);
    oxl_image_free(test_ctx, &image);
    oxl_scene_free(test_ctx, scene);
}

/* The scene of train_scene at a tenth of its brightness, which is learned soon, with a square in the image of
 * view 5, fainter than the initial expected error. */
oxl_scene *transients_test_scene(int views)
{
    oxl_scene *scene = train_scene(views), *patched = NULL;
    oxl_view view[16];
    oxl_image image[16];
    oxl_point point[144];
    CHECK(oxl_scene_point_count(scene) == OXL_COUNT(point));
    for (size_t i = 0; i < OXL_COUNT(point); i++) {
        point[i] = oxl_scene_points(scene)[i];
        memset(point[i].rgb, 13, sizeof point[i].rgb);
    }
    for (int v = 0; v < views; v++) {
        view[v] = *oxl_scene_view(scene, v);
        CHECK_OK(oxl_scene_image(test_ctx, scene, v, &image[v]));
        for (int i = 0; i < 3 * TRANSIENTS_TEST_PIXELS; i++) image[v].rgb[i] *= 0.1f;
    }
    transients_test_paint(image[5].rgb, 16, 20, 0.19f);
    CHECK_OK(oxl_scene_from_arrays(test_ctx, view, image, views, point, OXL_COUNT(point), &patched));
    for (int v = 0; v < views; v++) oxl_image_free(test_ctx, &image[v]);
    oxl_scene_free(test_ctx, scene);
    return patched;
}

/* Stopped before and after masking begins, and in the trial of SH bands. */
TEST(transients_a_run_stopped_at_any_step_ends_in_the_same_bytes)
{
    static const int stops[] = {250, 762, 1237, 1525, 1562, 1587, 1875};
    struct checkpoint_case c = checkpoint_of(transients_test_scene(14), train_options(3000));
    oxl_model model, plain;
    c.options.sh_degree = -1;
    CHECK_OK(oxl_train(test_ctx, c.scene, &c.options, NULL, &plain));
    c.options.mask_transients = 1;
    CHECK_OK(oxl_train(test_ctx, c.scene, &c.options, NULL, &c.whole));
    CHECK(!train_same(&plain, &c.whole));
    for (size_t i = 0; i < OXL_COUNT(stops); i++) {
        CHECK(checkpoint_run(&c, "key", stops[i], &model) == OXL_ERR_INTERRUPTED);
        oxl_model_free(test_ctx, &model);
    }
    CHECK_OK(checkpoint_run(&c, "key", -1, &model));
    CHECK(train_same(&model, &c.whole));
    oxl_model_free(test_ctx, &model);
    oxl_model_free(test_ctx, &plain);
    checkpoint_case_free(&c);
}

TEST(transients_give_the_same_bytes_with_one_and_three_threads)
{
    oxl_scene *scene = transients_test_scene(9);
    oxl_train_options options = train_options(100);
    oxl_model one, three;
    const int threads = test_ctx->threads;
    options.mask_transients = 1;
    test_ctx->threads = 1;
    CHECK_OK(oxl_train(test_ctx, scene, &options, NULL, &one));
    test_ctx->threads = 3;
    CHECK_OK(oxl_train(test_ctx, scene, &options, NULL, &three));
    test_ctx->threads = threads;
    CHECK(train_same(&one, &three));
    oxl_model_free(test_ctx, &one);
    oxl_model_free(test_ctx, &three);
    oxl_scene_free(test_ctx, scene);
}

/* ---------------- free space */
