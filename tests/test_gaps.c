/* test_gaps.c - points to start from where a survey has none. */
#include "test.h"
#include "../src/parts/gaps.h"
#include "../src/survey/scene.h"

enum { GAPS_TEST_WIDTH = 320, GAPS_TEST_HEIGHT = 240, GAPS_TEST_VIEWS = 4 };

static double gaps_test_random(int x, int y, int seed)
{
    const int key[3] = {x, y, seed};
    return (double)(checksum_add(CHECKSUM_SEED, key, sizeof key) % 1024) / 1024;
}

/* A texture with detail of 0.03 of the world's unit. */
static double gaps_test_texture(double x, double y, int seed)
{
    const double u = x / 0.03 + 1000, v = y / 0.03 + 1000;
    const int i = (int)u, j = (int)v;
    const double a = u - i, b = v - j;
    return (1 - b) * ((1 - a) * gaps_test_random(i, j, seed) + a * gaps_test_random(i + 1, j, seed)) +
           b * ((1 - a) * gaps_test_random(i, j + 1, seed) + a * gaps_test_random(i + 1, j + 1, seed));
}

/* What the view at (view, 0, 0) sees of a wall 10 in front of it. */
static void gaps_test_write_image(int view, int seed)
{
    OWNED_IMAGE image = {0};
    CHECK_OK(oxl_image_create(test_ctx, GAPS_TEST_WIDTH, GAPS_TEST_HEIGHT, &image));
    for (int i = 0; i < GAPS_TEST_WIDTH * GAPS_TEST_HEIGHT; i++)
        for (int c = 0; c < 3; c++)
            image.rgb[c * GAPS_TEST_WIDTH * GAPS_TEST_HEIGHT + i] = (float)gaps_test_texture(
                view + (i % GAPS_TEST_WIDTH + 0.5 - 160) / 40, (i / GAPS_TEST_WIDTH + 0.5 - 120) / 40, seed);
    CHECK_OK(oxl_image_write(test_ctx, test_path("gaps/images/img%02d.png", view), &image));
}

/* Points of the wall, but for those nearer than `hole` to (1.5, 0); `same`: all images show one texture. */
static oxl_scene *gaps_test_scene(double hole, int same)
{
    const char *path = scene_survey("gaps", GAPS_TEST_VIEWS, 0, 0);
    struct text points = {.ctx = test_ctx};
    oxl_scene_options options = oxl_scene_options_default();
    oxl_scene *scene;
    for (int i = 0; i < 230 * 130; i++) {
        const double x = i % 230 * 0.05 - 4, y = i / 230 * 0.05 - 3.2;
        if (hypot(x - 1.5, y) >= hole)
            text_add(&points, "%d %g %g 10 10 20 30 0.5 10 0 11 0 12 0 13 0\n", 1 + i, x, y);
    }
    test_write("gaps/sparse/0/points3D.txt", points.data);
    test_write("gaps/sparse/0/cameras.txt", "1 PINHOLE 320 240 400 400 160 120\n");
    text_free(&points);
    for (int i = 0; i < GAPS_TEST_VIEWS; i++) gaps_test_write_image(i, same ? 0 : i);
    CHECK_OK(oxl_scene_load(test_ctx, path, &options, &scene));
    return scene;
}

TEST(gaps_get_points_on_the_surface_where_views_agree_on_it)
{
    OWNED_SCENE *scene = gaps_test_scene(0.8, 1);
    const double *origin = oxl_scene_origin(scene);
    OWNED_MEMORY oxl_point *point = NULL;
    size_t count, inside = 0;
    CHECK_OK(gaps_points(test_ctx, scene, 10000, &point, &count));
    CHECK(count > 0);
    for (size_t i = 0; i < count; i++) {
        const double x = point[i].position[0] + origin[0], y = point[i].position[1] + origin[1];
        const double level = 255 * gaps_test_texture(x, y, 0);
        CHECK_CLOSE(point[i].position[2] + origin[2], 10, 0.02);
        CHECK_CLOSE(point[i].rgb[0], level, 90);
        inside += hypot(x - 1.5, y) < 0.8;
    }
    CHECK(inside > 50);
}

TEST(gaps_get_no_points_where_views_do_not_agree)
{
    OWNED_SCENE *scene = gaps_test_scene(0.8, 0);
    OWNED_MEMORY oxl_point *point = NULL;
    size_t count;
    CHECK_OK(gaps_points(test_ctx, scene, 10000, &point, &count));
    CHECK(count <= 2);
}

TEST(gaps_get_at_most_so_many_points)
{
    OWNED_SCENE *scene = gaps_test_scene(0.8, 1);
    oxl_point *point;
    size_t count;
    CHECK_OK(gaps_points(test_ctx, scene, 7, &point, &count));
    CHECK(count == 7);
    oxl_free(test_ctx, point);
    CHECK_OK(gaps_points(test_ctx, scene, 0, &point, &count));
    CHECK(count == 0 && !point);
}

/* An image that cannot be read is left out when its turn comes in training: it must not end the run before. */
TEST(gaps_are_looked_for_without_images_that_cannot_be_read)
{
    for (int removed = 0; removed < 2; removed++) {
        OWNED_SCENE *scene = gaps_test_scene(0.8, 1);
        OWNED_MEMORY oxl_point *point = NULL;
        size_t count;
        if (removed) CHECK(remove(test_path("gaps/images/img02.png")) == 0);
        else test_write("gaps/images/img02.png", "no picture");
        CHECK_OK(gaps_points(test_ctx, scene, 10000, &point, &count));
        CHECK(count > 0);
    }
}
