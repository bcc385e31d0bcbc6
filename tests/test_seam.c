/* test_seam.c - an error beside a border between blocks is seen there, and only there. */
#include "test.h"

#include "../bench/seam.h"

enum { SEAM_TEST_W = 64, SEAM_TEST_H = 48 };

/* A wall 5 before the camera, upright on the optical axis; a pixel is 5/200 = 0.025 wide on it. The camera is
 * turned and moved: its x is the frame's first axis, whose 0 is at the middle of the image. The wall's two
 * halves are blocks of sizes 5 and 10, so the pixels whose centres lie within 0.1 and 0.2 are near: 4 columns
 * and 8. */
struct seam_test {
    oxl_model model;
    oxl_camera camera;
    struct partition partition;
    struct partition_block block[2];
};
enum { SEAM_TEST_FIRST = SEAM_TEST_W / 2 - 4, SEAM_TEST_END = SEAM_TEST_W / 2 + 8 };

static void seam_test_create(struct seam_test *t)
{
    const oxl_camera camera = {.width = SEAM_TEST_W,
                               .height = SEAM_TEST_H,
                               .fx = 200,
                               .fy = 200,
                               .cx = SEAM_TEST_W / 2,
                               .cy = SEAM_TEST_H / 2,
                               .rotation = {0, 1, 0, -1, 0, 0, 0, 0, 1}, /* camera x = world y */
                               .translation = {0.5, 0.25, 3}};
    t->camera = camera;
    t->model = test_model(1, 0);
    t->model.plane[OXL_MEAN + 2][0] = 2;
    t->model.plane[OXL_LOG_SCALE + 0][0] = t->model.plane[OXL_LOG_SCALE + 1][0] = 5;
    t->model.plane[OXL_LOG_SCALE + 2][0] = -9;
    t->model.plane[OXL_OPACITY][0] = 9;
    t->partition =
        (struct partition){.rotation = {0, 1, 0, 1, 0, 0, 0, 0, 1}, .origin = {0, 99.5, 0}, .block_count = 2};
    for (int b = 0; b < 2; b++) {
        const struct partition_box all = {{-INFINITY, -INFINITY, -INFINITY}, {INFINITY, INFINITY, INFINITY}};
        t->block[b] = (struct partition_block){.box = all, .finite = {{-5, -1, -1}, {10, 1, 1}}};
    }
    t->block[0].box.high[0] = t->block[0].finite.high[0] = 0;
    t->block[1].box.low[0] = t->block[1].finite.low[0] = 0;
    t->partition.block = t->block;
}

/* Measures images that differ from what is rendered by `error` in columns first to end. */
static struct seam seam_test_run(const struct seam_test *t, float error, int first, int end)
{
    oxl_view view[2] = {{"a", t->camera, 1}, {"b", t->camera, 0}};
    oxl_image image[2];
    struct seam seam = {0};
    for (int v = 0; v < 2; v++) image[v] = test_render(&t->model, &t->camera);
    for (int i = 0; i < 3 * SEAM_TEST_W * SEAM_TEST_H; i++)
        if (i % SEAM_TEST_W >= first && i % SEAM_TEST_W < end) image[0].rgb[i] += error;
    OWNED_SCENE *scene = test_scene(view, image, 2, NULL, 0);
    scene->origin[1] = 100; /* the border is at world y = 99.5, and the camera at local y = -0.5 */
    CHECK_OK(seam_measure(test_ctx, &t->partition, &t->model, scene, NULL, OXL_SPLIT_TEST, &seam));
    return seam;
}

TEST(seam_sees_an_error_beside_a_border_there_and_only_there)
{
    const size_t beside = (SEAM_TEST_END - SEAM_TEST_FIRST) * SEAM_TEST_H;
    struct seam_test t;
    seam_test_create(&t);
    struct seam s = seam_test_run(&t, 0.1f, SEAM_TEST_FIRST, SEAM_TEST_END);
    CHECK(s.near_pixels == beside && s.elsewhere_pixels == SEAM_TEST_W * SEAM_TEST_H - beside);
    CHECK_CLOSE(s.near_psnr, 20, 0.2); /* images have 8 bits */
    CHECK(s.elsewhere_psnr > 50);
    s = seam_test_run(&t, 0.1f, 0, SEAM_TEST_FIRST);
    CHECK(s.near_psnr > 50 && s.elsewhere_psnr < 24);
    s = seam_test_run(&t, 0.1f, SEAM_TEST_END, SEAM_TEST_W);
    CHECK(s.near_psnr > 50 && s.elsewhere_psnr < 24);
    oxl_model_free(test_ctx, &t.model);
}

TEST(seam_knows_where_a_pixel_lies_along_each_axis_of_the_camera)
{
    static const double across[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, away[9] = {0, 0, 1, 1, 0, 0, 0, 1, 0};
    struct seam_test t;
    seam_test_create(&t);
    /* the image's rows go from the block above 0 to the one below */
    memcpy(t.partition.rotation, across, sizeof across);
    t.partition.origin[0] = 0.25;
    CHECK(seam_test_run(&t, 0, 0, 0).near_pixels == 12 * SEAM_TEST_W);
    /* the border is 10 rows above that: at the image's edge, and all of one block is below */
    t.camera.cy = 10;
    t.partition.origin[0] = 0.5;
    CHECK(seam_test_run(&t, 0, 0, 0).near_pixels == 4 * SEAM_TEST_W);
    memcpy(t.partition.rotation, away, sizeof away);
    t.partition.origin[2] = 2.09; /* the wall is at 2 */
    CHECK(seam_test_run(&t, 0, 0, 0).near_pixels == SEAM_TEST_W * SEAM_TEST_H);
    t.partition.origin[2] = 2.11;
    CHECK(seam_test_run(&t, 0, 0, 0).near_pixels == 0);
    oxl_model_free(test_ctx, &t.model);
}

TEST(seam_calls_nothing_near_where_nothing_was_drawn_or_there_is_one_block)
{
    struct seam_test t;
    seam_test_create(&t);
    t.model.plane[OXL_OPACITY][0] = -20;
    struct seam s = seam_test_run(&t, 0.1f, 0, SEAM_TEST_W);
    CHECK(s.near_pixels == 0 && isnan(s.near_psnr) && s.elsewhere_pixels == SEAM_TEST_W * SEAM_TEST_H);
    CHECK_CLOSE(s.elsewhere_psnr, 20, 0.2);
    t.model.plane[OXL_OPACITY][0] = 9;
    t.partition.block_count = 1;
    t.block[0].box.high[0] = INFINITY;
    s = seam_test_run(&t, 0.1f, 0, SEAM_TEST_W);
    CHECK(s.near_pixels == 0 && isnan(s.near_psnr) && s.elsewhere_pixels == SEAM_TEST_W * SEAM_TEST_H);
    oxl_model_free(test_ctx, &t.model);
}
