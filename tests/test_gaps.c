/* test_gaps.c - points to start from where a survey has none. */
#include "test.h"
#include "../src/parts/gaps.h"
#include "../src/survey/scene.h"

/* Points 10 in front of the cameras of scene_survey, but for those nearer than `hole` to (1.5, 0). */
static oxl_scene *gaps_test_scene(double hole)
{
    const char *path = scene_survey("gaps", 4, 0, 1);
    struct text points = {.ctx = test_ctx};
    oxl_scene_options options = oxl_scene_options_default();
    oxl_scene *scene;
    for (int i = 0; i < 230 * 130; i++) {
        const double x = i % 230 * 0.05 - 4, y = i / 230 * 0.05 - 3.2;
        if (hypot(x - 1.5, y) >= hole)
            text_add(&points, "%d %g %g 10 10 20 30 0.5 10 0 11 0 12 0\n", 1 + i, x, y);
    }
    test_write("gaps/sparse/0/points3D.txt", points.data);
    text_free(&points);
    CHECK_OK(oxl_scene_load(test_ctx, path, &options, &scene));
    return scene;
}

TEST(gaps_get_points_on_the_surface_around_them)
{
    oxl_scene *scene = gaps_test_scene(1);
    const double *origin = oxl_scene_origin(scene);
    oxl_point *point;
    size_t count, inside = 0;
    CHECK_OK(gaps_points(test_ctx, scene, 10000, &point, &count));
    CHECK(count > 0);
    for (size_t i = 0; i < count; i++) {
        const double x = point[i].position[0] + origin[0] - 1.5, y = point[i].position[1] + origin[1];
        CHECK_CLOSE(point[i].position[2] + origin[2], 10, 1e-6);
        CHECK(point[i].rgb[0] == 10 && point[i].rgb[1] == 20 && point[i].rgb[2] == 30);
        inside += hypot(x, y) < 1;
        CHECK(hypot(x, y) > 0.3); /* too far from any point to be known */
    }
    CHECK(inside > 10);
    oxl_free(test_ctx, point);
    oxl_scene_free(test_ctx, scene);
}

TEST(gaps_are_none_where_points_are_dense_and_at_most_so_many)
{
    oxl_scene *scene = gaps_test_scene(1);
    oxl_point *point;
    size_t count;
    CHECK_OK(gaps_points(test_ctx, scene, 7, &point, &count));
    CHECK(count == 7);
    oxl_free(test_ctx, point);
    CHECK_OK(gaps_points(test_ctx, scene, 0, &point, &count));
    CHECK(count == 0 && !point);
    oxl_scene_free(test_ctx, scene);
}
