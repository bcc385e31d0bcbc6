/* test_free_space.c - which space is free, and what is removed from it. */
#include "test.h"
#include "../src/parts/free_space.h"

/* Points 10 in front of the cameras of scene_survey, all over their images, seen from `track` images; and one
 * at depth 3 that two saw. */
static oxl_scene *carve_scene(int track)
{
    const char *path = scene_survey("carve", 4, 0, 1);
    struct text points = {.ctx = test_ctx};
    oxl_scene_options options = oxl_scene_options_default();
    oxl_scene *scene;
    for (int i = 0; i < 23 * 13; i++) {
        text_add(&points, "%d %g %g 10 10 20 30 0.5", 2 + i, i % 23 * 0.5 - 4, i / 23 * 0.5 - 3);
        for (int k = 0; k < track; k++) text_add(&points, " %d 0", 10 + k);
        text_add(&points, "\n");
    }
    text_add(&points, "1 1.5 0 3 10 20 30 0.5 11 0 12 0\n");
    test_write("carve/sparse/0/points3D.txt", points.data);
    text_free(&points);
    CHECK_OK(oxl_scene_load(test_ctx, path, &options, &scene));
    return scene;
}

static int carve_free(const struct free_space *f, const oxl_scene *scene, double x, double y, double z)
{
    const double *o = oxl_scene_origin(scene);
    const double p[3] = {x - o[0], y - o[1], z - o[2]};
    return free_space_contains(f, p);
}

TEST(carve_free_space_lies_between_training_cameras_and_the_points_of_their_tracks)
{
    oxl_scene *scene = carve_scene(3);
    struct free_space f = {0};
    char words[160];
    CHECK_OK(free_space_begin(test_ctx, &f, scene));
    CHECK(f.views == 3);
    free_space_describe(&f, words, sizeof words);
    CHECK_TEXT(
        words,
        "65 % of the cells of 3 training views"); /* the third saw no point, and rims have few neighbours */
    CHECK(carve_free(&f, scene, 1.5, 0, 3) && carve_free(&f, scene, 1.5, 0, 6.9));
    CHECK(!carve_free(&f, scene, 1.5, 0, 7.1) && !carve_free(&f, scene, 1.5, 0, 11) &&
          !carve_free(&f, scene, 1.5, 0, -3));
    CHECK(!carve_free(&f, scene, -0.8, 0, 3)); /* seen by the held-out view alone */
    CHECK(!carve_free(&f, scene, 3.8, 0, 3));  /* and by one that is in no track */
    free_space_free(&(struct train){.ctx = test_ctx}, &f);
    oxl_scene_free(test_ctx, scene);
    f = (struct free_space){0};
    scene = carve_scene(2);
    CHECK_OK(free_space_begin(test_ctx, &f, scene));
    CHECK(!carve_free(&f, scene, 1.5, 0, 3));
    free_space_free(&(struct train){.ctx = test_ctx}, &f);
    oxl_scene_free(test_ctx, scene);
}

TEST(carve_removes_gaussians_in_free_space_and_nothing_where_there_are_no_tracks)
{
    oxl_scene *scene = carve_scene(3), *plain;
    oxl_train_options options = train_options(200);
    struct free_space f = {0};
    oxl_model model, same;
    CHECK_OK(free_space_begin(test_ctx, &f, scene));
    for (int carve = 0; carve < 2; carve++) {
        uint8_t *carved;
        size_t count = 0;
        options.carve = carve;
        CHECK_OK(oxl_train(test_ctx, scene, &options, NULL, &model));
        CHECK_OK(free_space_carve(test_ctx, &f, &model, &carved));
        for (size_t i = 0; i < model.count; i++) count += carved[i];
        CHECK((count > 0) == !carve);
        oxl_free(test_ctx, carved);
        oxl_model_free(test_ctx, &model);
    }
    free_space_free(&(struct train){.ctx = test_ctx}, &f);
    oxl_scene_free(test_ctx, scene);
    plain = train_scene(5);
    CHECK_OK(oxl_train(test_ctx, plain, &options, NULL, &model));
    options.carve = 0;
    CHECK_OK(oxl_train(test_ctx, plain, &options, NULL, &same));
    CHECK(train_same(&model, &same));
    oxl_model_free(test_ctx, &model);
    oxl_model_free(test_ctx, &same);
    oxl_scene_free(test_ctx, plain);
}
