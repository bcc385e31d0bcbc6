/* test_stereo.c - points to start from, made from the images. */
#include "test.h"
#include "../src/parts/stereo.h"
#include "../src/survey/scene.h"

enum { STEREO_TEST_WIDTH = 320, STEREO_TEST_HEIGHT = 240, STEREO_TEST_VIEWS = 4 };

static double stereo_test_random(int x, int y, int seed)
{
    const int key[3] = {x, y, seed};
    return (double)(checksum_add(CHECKSUM_SEED, key, sizeof key) % 1024) / 1024;
}

/* A texture with detail of 0.03 of the world's unit. */
static double stereo_test_texture(double x, double y, int seed)
{
    const double u = x / 0.03 + 1000, v = y / 0.03 + 1000;
    const int i = (int)u, j = (int)v;
    const double a = u - i, b = v - j;
    return (1 - b) * ((1 - a) * stereo_test_random(i, j, seed) + a * stereo_test_random(i + 1, j, seed)) +
           b * ((1 - a) * stereo_test_random(i, j + 1, seed) + a * stereo_test_random(i + 1, j + 1, seed));
}

/* What the view at (view, 0, 0) sees of a wall 10 in front of it, transparent in columns below `clear`. */
static void stereo_test_write_image(int view, int seed, int clear)
{
    OWNED_IMAGE image = test_image(STEREO_TEST_WIDTH, STEREO_TEST_HEIGHT);
    for (int i = 0; i < STEREO_TEST_WIDTH * STEREO_TEST_HEIGHT; i++)
        for (int c = 0; c < 3; c++)
            image.rgb[c * STEREO_TEST_WIDTH * STEREO_TEST_HEIGHT + i] =
                (float)stereo_test_texture(view + (i % STEREO_TEST_WIDTH + 0.5 - 160) / 40,
                                           (i / STEREO_TEST_WIDTH + 0.5 - 120) / 40, seed);
    if (clear)
        image.weight = oxl_calloc(test_ctx, STEREO_TEST_WIDTH * STEREO_TEST_HEIGHT, sizeof *image.weight);
    for (int i = 0; i < STEREO_TEST_WIDTH * STEREO_TEST_HEIGHT && clear; i++)
        image.weight[i] = i % STEREO_TEST_WIDTH >= clear;
    CHECK_OK((clear ? oxl_image_write_alpha
                    : oxl_image_write)(test_ctx, test_path("stereo/images/img%02d.png", view), &image));
}

/* Points of the wall, but for those nearer than `hole` to (1.5, 0); `same`: all images show one texture. */
static oxl_scene *stereo_test_scene(double hole, int same, int clear)
{
    const char *path = scene_survey("stereo", STEREO_TEST_VIEWS, 0, 0);
    OWNED_TEXT points = test_text();
    oxl_scene_options options = oxl_scene_options_default();
    for (int i = 0; i < 230 * 130; i++) {
        const double x = i % 230 * 0.05 - 4, y = i / 230 * 0.05 - 3.2;
        if (hypot(x - 1.5, y) >= hole)
            text_add(&points, "%d %g %g 10 10 20 30 0.5 10 0 11 0 12 0 13 0\n", 1 + i, x, y);
    }
    test_write("stereo/sparse/0/points3D.txt", points.data ? points.data : "# none\n");
    test_write("stereo/sparse/0/cameras.txt", "1 PINHOLE 320 240 400 400 160 120\n");
    for (int i = 0; i < STEREO_TEST_VIEWS; i++) stereo_test_write_image(i, same ? 0 : i, clear);
    oxl_scene *scene = test_load(path, &options);
    return scene;
}

/* In the hole too, which is as wide as the scene where `hole` is large: a survey of poses alone. */
TEST(stereo_points_are_on_the_surface_that_views_agree_on)
{
    for (int k = 0; k < 2; k++) {
        OWNED_SCENE *scene = stereo_test_scene(k ? 100 : 0.8, 1, 0);
        const double *origin = oxl_scene_origin(scene);
        oxl_point *point;
        size_t count, inside = 0, wrong = 0;
        CHECK(oxl_scene_point_count(scene) == 0 || k == 0);
        CHECK_OK(stereo_points(test_ctx, scene, 10000, &point, &count));
        CHECK(count > 1000);
        for (size_t i = 0; i < count; i++) {
            const double x = point[i].position[0] + origin[0], y = point[i].position[1] + origin[1];
            double level = 0; /* mean of the four pixels around it */
            wrong += !(fabs(point[i].position[2] + origin[2] - 10) < 0.15); /* 0.6 px of disparity */
            for (int j = 0; j < 4; j++)
                level += 64 * stereo_test_texture(x + (j % 2 - 0.5) / 40, y + (j / 2 - 0.5) / 40, 0);
            wrong += !(fabs(point[i].rgb[0] - level) < 40);
            inside += hypot(x - 1.5, y) < 0.8;
        }
        CHECK(inside > 50 && wrong <= count / 100);
        oxl_free(test_ctx, point);
    }
}

TEST(stereo_makes_no_points_where_views_do_not_agree)
{
    OWNED_SCENE *scene = stereo_test_scene(0.8, 0, 0);
    oxl_point *point;
    size_t count;
    CHECK_OK(stereo_points(test_ctx, scene, 10000, &point, &count));
    CHECK(count <= 10);
    oxl_free(test_ctx, point);
}

/* A point for 100 pixels at most; the hull of outlines gets ten times as many. */
TEST(stereo_starts_scenes_whose_transparent_pixels_are_composited)
{
    oxl_train_options o = oxl_train_options_default(OXL_PRESET_DRAFT);
    OWNED_SCENE *scene = stereo_test_scene(100, 1, 160);
    oxl_trained t;
    o.iterations = 1;
    CHECK_OK(oxl_train(test_ctx, scene, &o, NULL, &t));
    CHECK(t.model.count > 500 && t.model.count <= 3072);
    oxl_trained_free(test_ctx, &t);
}

TEST(stereo_makes_at_most_so_many_points_the_same_on_any_threads)
{
    static const size_t most[] = {500, 7, 1, 0};
    OWNED_SCENE *scene = stereo_test_scene(0.8, 1, 0);
    oxl_point *point, *other;
    size_t count, others;
    for (size_t k = 0; k < OXL_COUNT(most); k++) {
        CHECK_OK(stereo_points(test_ctx, scene, most[k], &point, &count));
        CHECK(count <= most[k] && count >= most[k] / 2);
        test_ctx->threads = test_ctx->threads == 1 ? 3 : 1;
        CHECK_OK(stereo_points(test_ctx, scene, most[k], &other, &others));
        CHECK(others == count && memcmp(point, other, count * sizeof *point) == 0);
        OXL_FREE(test_ctx, point, other);
    }
}

/* An image that cannot be read is left out when its turn comes in training: it must not end the run before. */
TEST(stereo_leaves_out_images_that_cannot_be_read)
{
    for (int removed = 0; removed < 2; removed++) {
        OWNED_SCENE *scene = stereo_test_scene(0.8, 1, 0);
        oxl_point *point;
        size_t count;
        if (removed) CHECK(remove(test_path("stereo/images/img02.png")) == 0);
        else test_write("stereo/images/img02.png", "no picture");
        CHECK_OK(stereo_points(test_ctx, scene, 10000, &point, &count));
        CHECK(count > 0);
        oxl_free(test_ctx, point);
    }
}
