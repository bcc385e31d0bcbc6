/* test_working_files.c - files that a run leaves for itself: what a fault has changed in them is not believed. */
#include "test.h"

/* Changes the byte at a fraction of a file, its last `rest` bytes left out. */
static void working_damage(const char *path, double at, size_t rest)
{
    OWNED_MEMORY char *copy = NULL;
    OWNED_FILE map = test_file(path);
    copy = oxl_alloc(test_ctx, map.size + 1, 1);
    memcpy(copy, map.data, map.size);
    copy[(size_t)(at * (double)(map.size - rest - 1))] ^= 1;
    test_write_bytes(path, copy, map.size);
}

static int working_same(const char *a, const char *b)
{
    uint64_t sum[2];
    CHECK_OK(checksum_of_file(test_ctx, a, 0, &sum[0]));
    CHECK_OK(checksum_of_file(test_ctx, b, 0, &sum[1]));
    return sum[0] == sum[1];
}

static oxl_scene *working_scene(void)
{
    oxl_scene *scene = test_load(job_test_survey(), NULL);
    return scene;
}

/* ---------------- imaging.txt */

TEST(imaging_file_with_a_zero_byte_or_another_checksum_is_refused)
{
    static const char zero[] = "gain 1 1 1 1.png\0AAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA\n";
    OWNED_SCENE *scene = working_scene();
    struct oxl_imaging m = {0};
    const char *path = test_path("imaging.txt");
    test_write_bytes(path, zero, sizeof zero - 1);
    CHECK_ERROR(imaging_read(test_ctx, path, scene, &m), OXL_ERR_INPUT,
                "imaging.txt:1: found a byte of value 0");
    CHECK_OK(imaging_create(test_ctx, oxl_scene_view_count(scene), &m));
    m.known[1] = m.on = 1, m.log_gain[3] = 0.25f;
    CHECK_OK(oxl_imaging_write(test_ctx, path, scene, &m));
    imaging_free(test_ctx, &m);
    CHECK_OK(imaging_read(test_ctx, path, scene, &m));
    CHECK_CLOSE(m.log_gain[3], 0.25, 1e-6);
    imaging_free(test_ctx, &m);
    job_test_replace(path, "gain 1", "gain 2");
    CHECK_ERROR(imaging_read(test_ctx, path, scene, &m), OXL_ERR_INPUT, "checksum");
}

/* So info says which lines the colours of scene.ply hold: gains, if there is nothing else. */
TEST(imaging_file_of_gains_has_them_alone_without_lamp_and_medium)
{
    static const char *const more[] = {"", "lamp all 1 2\n", "bD 1 2 3\nbB 1 2 3\nBinf 0.1 0.2 0.3\n"};
    for (size_t i = 0; i < OXL_COUNT(more); i++) {
        char content[200];
        snprintf(content, sizeof content, "# gains\ngain 1 1 1 1.png\n%s", more[i]);
        test_write("scene_clear.ply", "");
        test_write("imaging.txt", content);
        CHECK(oxl_has_gains_alone(test_ctx, test_path("scene.ply")) == (i == 0));
    }
    remove(test_path("scene_clear.ply"));
    CHECK(!oxl_has_gains_alone(test_ctx, test_path("scene.ply")));
}

/* ---------------- runs of blocks */

static oxl_job_options working_blocks(void)
{
    oxl_job_options options = job_test_options();
    options.partition.block_points = 40;
    options.train.iterations = 120;
    options.renders = 0;
    return options;
}

struct working_stop {
    enum oxl_stage stage;
    int block, iteration;
};

static int working_stop(void *user, const oxl_progress *p)
{
    const struct working_stop *s = user;
    return p->stage == s->stage && p->block == s->block && p->iteration >= s->iteration;
}

/* Stopped in the second block: what is damaged is trained again. */
TEST(blocks_with_a_damaged_file_end_in_the_same_bytes)
{
    static const char *const files[] = {"blocks/000/block.json",  "blocks/000/model.ply",
                                        "blocks/001/block.json",  "blocks/001/checkpoint.oxl",
                                        "blocks/001/model.ply",   "blocks/coarse/block.json",
                                        "blocks/coarse/model.ply"};
    const oxl_job_options options = working_blocks();
    char survey[512];
    struct working_stop stop = {OXL_STAGE_BLOCK, 1, 40};
    oxl_callback callback = {working_stop, &stop};
    snprintf(survey, sizeof survey, "%s", job_test_survey());
    CHECK_OK(oxl_job_run(test_ctx, survey, test_path("ref"), &options, NULL));
    for (size_t k = 0; k < OXL_COUNT(files); k++) {
        char out[32], path[128];
        snprintf(out, sizeof out, "out%zu", k);
        oxl_result rc = oxl_job_run(test_ctx, survey, test_path(out), &options, &callback);
        CHECK(rc == OXL_ERR_INTERRUPTED);
        snprintf(path, sizeof path, "out%zu/%s", k, files[k]);
        CHECK(test_has(path));
        working_damage(test_path(path), 0.6, 0);
        CHECK_OK(oxl_job_run(test_ctx, survey, test_path(out), &options, NULL));
        CHECK(working_same(test_path("%s/scene.ply", out), test_path("ref/scene.ply")));
    }
}

TEST(a_model_that_is_lost_or_damaged_before_the_result_is_trained_again)
{
    NEEDS_PART(lobes);
    static const char *const files[] = {"out/blocks/000/model.ply", "out/blocks/000/model_standard.ply"};
    oxl_job_options options = job_test_options();
    options.renders = 0;
    options.train.dog = OXL_DOG_ALL;
    job_test_done("ref", &options);
    job_test_done("out", &options);
    for (int k = 0; k < 3; k++) {
        CHECK(remove(test_path("out/run.json")) == 0 && remove(test_path("out/scene.ply")) == 0);
        if (k < 2) working_damage(test_path("%s", files[k]), 0.9, 0);
        else CHECK(remove(test_path("%s", files[1])) == 0);
        job_test_done("out", &options);
        CHECK(working_same(test_path("out/scene.ply"), test_path("ref/scene.ply")));
        CHECK(working_same(test_path("out/scene_standard.ply"), test_path("ref/scene_standard.ply")));
    }
}

TEST(checksum_of_text_is_its_last_line)
{
    OWNED_TEXT t = test_text();
    text_add(&t, "a\nb\n");
    CHECK(!checksum_is_wrong(t.data, t.size));
    checksum_end_text(&t);
    CHECK(!checksum_is_wrong(t.data, t.size));
    t.data[2] = 'c';
    CHECK(checksum_is_wrong(t.data, t.size) && !checksum_is_wrong(t.data, t.size - 1));
}

/* ---------------- images that vanish */

static int working_vanish(void *user, const oxl_progress *p)
{
    if (p->iteration == 3 && !*(int *)user) {
        *(int *)user = 1;
        CHECK(rename(test_path("survey/images"), test_path("gone")) == 0);
    }
    return 0;
}

TEST(a_run_whose_images_vanish_stops_and_continues_when_they_are_back)
{
    oxl_job_options options = job_test_options();
    int gone = 0;
    oxl_callback callback = {working_vanish, &gone};
    options.scene.image_cache_bytes = 1;
    options.train.iterations = 60;
    CHECK_ERROR(oxl_job_run(test_ctx, job_test_survey(), test_path("out"), &options, &callback), OXL_ERR_IO,
                "training images cannot be read");
    CHECK(!job_test_has("out/run.json", "\"finished\": true"));
    CHECK(rename(test_path("gone"), test_path("survey/images")) == 0);
    job_test_done("out", &options);
    CHECK_IN("out/metrics.json", "\"images_left_out\": 0");
}

/* ---------------- rates, views, cameras, presets */

TEST(rates_of_0_train_without_a_number_that_is_not_finite)
{
    oxl_job_options options = job_test_options();
    options.renders = 0, options.restart = 1;
    for (int k = 1; k < 4; k++) {
        if (k & 1) options.train.lr_position = 0;
        if (k & 2) options.train.lr_position_final = 0;
        job_test_done("out", &options);
        CHECK_IN("out/metrics.json", "\"gaussians_cleared\": 0");
    }
}

TEST(api_refuses_views_cameras_focal_lengths_and_presets_that_are_none)
{
    oxl_model gradient = {0};
    oxl_camera camera = {0, 16, 20, 20, 8, 8, {1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 2}};
    oxl_view view = {"v", {8, 8, 0, 20, 4, 4, {1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 2}}, 0};
    double start[3], direction[3];
    float rgb[3 * 256] = {0};
    oxl_scene *scene = working_scene();
    CHECK(oxl_scene_ray(test_ctx, scene, -1, 1, 1, start, direction) == OXL_ERR_USAGE);
    CHECK(oxl_scene_ray(test_ctx, scene, 9, 1, 1, start, direction) == OXL_ERR_USAGE);
    oxl_scene_free(test_ctx, scene);
    OWNED_MODEL model = test_model(4, 0);
    CHECK(oxl_render_backward(test_ctx, &model, &camera, NULL, rgb, &gradient) == OXL_ERR_USAGE);
    OWNED_IMAGE image = test_image(8, 8);
    CHECK_ERROR(oxl_scene_from_arrays(test_ctx, &view, &image, 1, NULL, 0, &scene), OXL_ERR_USAGE,
                "focal lengths");
    oxl_model_rescale(&model, NAN), oxl_model_rescale(&model, 0);
    CHECK(model.scale == 0 && model.plane[OXL_MEAN][0] == 0);
    for (int k = -1; k < 100; k += 4) {
        const oxl_job_options o = oxl_job_options_default((oxl_preset)k);
        CHECK((oxl_job_options_check(test_ctx, &o) == OXL_OK) == (k >= 0 && k <= 2));
    }
}

static int working_note_stage(void *user, const oxl_progress *p)
{
    int *seen = user; /* (3) of each stage: 0 not yet, else its place in their order */
    CHECK(p->blocks > 1 && p->block >= 0 && p->block < p->blocks);
    if (!seen[p->stage]) seen[p->stage] = 1 + (seen[0] > 0) + (seen[1] > 0) + (seen[2] > 0);
    return 0;
}

TEST(progress_of_a_run_in_blocks_names_coarse_model_blocks_and_merged_model_in_this_order)
{
    const oxl_job_options options = working_blocks();
    int seen[3] = {0};
    const oxl_callback callback = {working_note_stage, seen};
    CHECK_OK(oxl_job_run(test_ctx, job_test_survey(), test_path("out"), &options, &callback));
    CHECK(seen[OXL_STAGE_COARSE] == 1 && seen[OXL_STAGE_BLOCK] == 2 && seen[OXL_STAGE_MERGED] == 3);
}

/* ---------------- a finished run whose survey has changed, or that is to be trained anew */

TEST(a_finished_run_is_not_taken_for_that_of_other_images_masks_poses_cameras_or_colours)
{
    static const char *const changed[][3] = {
        {"survey/images/4.png", NULL, NULL},
        {"survey/masks/4.png", NULL, NULL},
        {"survey/sparse/0/images.txt", " 1 0 0 0 -0.100 ", " 1 0 0.0001 0 -0.100 "},
        {"survey/sparse/0/cameras.txt", " 24 16", " 24 16.5"},
        {"survey/sparse/0/points3D.txt", " 120 60 ", " 121 60 "}};
    const oxl_job_options options = job_test_options();
    for (size_t k = 0; k < OXL_COUNT(changed); k++) {
        const char *path = changed[k][0];
        char out[8];
        job_test_survey();
        snprintf(out, sizeof out, "out%d", (int)k);
        job_test_done(out, &options);
        if (k == 1) test_write("survey/masks/.keep", "");
        if (k < 2) CHECK_OK(job_test_image(test_path(path), 7));
        else job_test_replace(path, changed[k][1], changed[k][2]);
        CHECK_ERROR(job_test_run(out, &options), OXL_ERR_USAGE, "  checksum_of_files: ");
        CHECK_SAYS("--restart");
    }
}
