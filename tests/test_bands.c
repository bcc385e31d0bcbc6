/* test_bands.c - assignment of pixels to the depth bands near, mid and far by the points. */
#include "test.h"

enum { BANDS_W = 64, BANDS_H = 48 }; /* a reach of 4 px */

/* Points seen straight ahead from the origin at (8, 8), depth 1; (40, 8), depth 2; (44, 8), depth 3; one
 * behind the camera. */
static oxl_scene *bands_scene(void)
{
    static float pixels[3 * BANDS_W * BANDS_H];
    oxl_scene *scene = NULL;
    oxl_image image = {.width = BANDS_W, .height = BANDS_H, .rgb = pixels};
    oxl_point point[4] = {{.position = {-23.5, -15.5, 1}},
                          {.position = {2 * 8.5, 2 * -15.5, 2}},
                          {.position = {3 * 12.5, 3 * -15.5, 3}},
                          {.position = {-23.5, -15.5, -1}}};
    oxl_view view = {.name = "a"};
    for (int i = 0; i < 4; i++)
        for (int k = 0; k < 2; k++) point[i].position[k] /= 40;
    view.camera = (oxl_camera){.width = BANDS_W,
                               .height = BANDS_H,
                               .fx = 40,
                               .fy = 40,
                               .cx = 32,
                               .cy = 24,
                               .rotation = {1, 0, 0, 0, 1, 0, 0, 0, 1}};
    CHECK_OK(oxl_scene_from_arrays(test_ctx, &view, &image, 1, point, 4, &scene));
    return scene;
}

TEST(bands_of_pixels_are_those_of_the_nearest_point_and_none_far_from_all)
{
    static uint8_t band[BANDS_W * BANDS_H];
    oxl_scene *scene = bands_scene();
    struct depth_bands b;
    size_t counted = 0;
    CHECK_OK(depth_bands_begin(test_ctx, scene, (int[]){0}, 1, &b));
    CHECK(b.count == 3 && b.depth[0] > 1 && b.depth[0] <= 2 && b.depth[1] >= 2 && b.depth[1] < 3);
    b.depth[0] = 1.5, b.depth[1] = 2.5;
    CHECK_OK(depth_bands_of_view(test_ctx, &b, scene, 0, band));
    for (size_t i = 0; i < sizeof band; i++) counted += band[i] == 1;
    CHECK(counted == 41); /* all within 4 steps */
    CHECK(band[8 * BANDS_W + 8] == 1 && band[8 * BANDS_W + 12] == 1 && band[8 * BANDS_W + 13] == 0 &&
          band[10 * BANDS_W + 11] == 0);
    CHECK(band[8 * BANDS_W + 41] == 2 && band[8 * BANDS_W + 43] == 3 && band[8 * BANDS_W + 48] == 3 &&
          band[12 * BANDS_W + 40] == 2);
    depth_bands_free(test_ctx, &b);
    oxl_scene_free(test_ctx, scene);
}

/* Both views stand at the origin and have both points in their image; each saw one of them. */
TEST(bands_go_by_tracks_where_there_are_some)
{
    oxl_scene *scene = NULL;
    struct depth_bands b;
    oxl_image image;
    CHECK_OK(oxl_image_create(test_ctx, BANDS_W, BANDS_H, &image));
    test_write("survey/images/.keep", "");
    test_write("survey/sparse/0/cameras.txt", "1 PINHOLE 64 48 40 40 32 24\n");
    test_write("survey/sparse/0/images.txt", "7 1 0 0 0 0 0 0 1 a.png\n\n3 1 0 0 0 0 0 0 1 b.png\n\n");
    test_write("survey/sparse/0/points3D.txt", "1 0 0 1 9 9 9 0.5 3 0\n2 0.0625 0 4 9 9 9 0.5 7 0\n");
    CHECK_OK(oxl_image_write(test_ctx, test_path("survey/images/a.png"), &image));
    CHECK_OK(oxl_image_write(test_ctx, test_path("survey/images/b.png"), &image));
    CHECK_OK(oxl_scene_load(test_ctx, test_path("survey"), NULL, &scene));
    CHECK_OK(depth_bands_begin(test_ctx, scene, (int[]){0, 1}, 2, &b));
    CHECK(b.count == 2 && b.sample[0].view == 0 && b.sample[1].view == 1);
    CHECK(b.sample[0].z == 4 && b.sample[0].pixel == 24 * BANDS_W + 32 && b.sample[1].z == 1);
    depth_bands_free(test_ctx, &b);
    CHECK_OK(depth_bands_begin(test_ctx, scene, (int[]){1}, 1, &b)); /* of the second alone, the same */
    CHECK(b.count == 1 && b.sample[0].view == 1 && b.sample[0].z == 1);
    depth_bands_free(test_ctx, &b);
    oxl_image_free(test_ctx, &image);
    oxl_scene_free(test_ctx, scene);
}
