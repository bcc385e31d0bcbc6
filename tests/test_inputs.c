/* test_inputs.c - inputs that are no files, and files that gzip wrote: refused at once, with what to do. */
#include "test.h"

#ifndef _WIN32

#include <sys/stat.h>
#include <unistd.h>

static oxl_result inputs_read(int what, const char *path)
{
    oxl_scene_options options = oxl_scene_options_default();
    OWNED_MODEL model = {0};
    OWNED_SCENE *scene = NULL;
    struct pixels pixels = {0};
    oxl_result rc;
    options.images = path;
    switch (what) {
    case 0: rc = oxl_model_read(test_ctx, path, &model); break;
    case 1: rc = oxl_scene_load(test_ctx, path, NULL, &scene); break;
    case 2: rc = oxl_scene_load(test_ctx, job_test_survey(), &options, &scene); break;
    default: rc = image_decode(test_ctx, path, 3, &pixels);
    }
    image_pixels_free(test_ctx, &pixels);
    return rc;
}

TEST(a_pipe_and_a_device_in_the_place_of_an_input_are_refused_at_once)
{
    char pipe[1024];
    snprintf(pipe, sizeof pipe, "%s", test_path("pipe"));
    CHECK(mkfifo(pipe, 0666) == 0);
    for (int what = 0; what < 4; what++) {
        const oxl_result refused = what < 3 ? OXL_ERR_INPUT : OXL_ERR_IO;
        CHECK_ERROR(inputs_read(what, pipe), refused, "\nfix: ");
        CHECK(inputs_read(what, "/dev/zero") == refused);
    }
    CHECK(!oxl_open(pipe) && !oxl_open("/dev/null") && !oxl_open(test_path("")));
}

static void inputs_compress(const char *path, const char *as)
{
    /* stored, not deflated: a PLY file of three lines */
    static const char packed[] =
        "\037\213\010\000\000\000\000\000\000\003\001 \000\337\377ply\012format ascii 1.0\012end_header\012\246\024\340\020 \000\000\000";
    if (path) CHECK(unlink(path) == 0);
    test_write_bytes(as, packed, sizeof packed - 1);
}

TEST(a_file_that_gzip_wrote_is_refused_with_gunzip_whatever_its_name)
{
    static const char *const files[] = {"sparse/0/cameras.txt", "sparse/0/images.txt",
                                        "sparse/0/points3D.txt"};
    static const char *const names[] = {"model.ply", "model.ply.gz"};
    for (int i = 0; i < 2; i++)
        for (int what = 0; what < 4; what += 3) {
            inputs_compress(NULL, test_path(names[i]));
            CHECK_ERROR(inputs_read(what, test_path(names[i])), OXL_ERR_INPUT, "gunzip");
        }
    for (size_t i = 0; i < 2 * OXL_COUNT(files); i++) {
        const char *survey = job_test_survey();
        char path[1024], as[1030];
        snprintf(path, sizeof path, "%s/%s", survey, files[i / 2]);
        snprintf(as, sizeof as, "%s%s", path, i % 2 ? ".gz" : "");
        inputs_compress(path, as);
        CHECK_ERROR(inputs_read(1, survey), OXL_ERR_INPUT, "gunzip");
        unlink(as);
    }
}

TEST(a_survey_in_json_that_gzip_wrote_is_refused_with_gunzip)
{
    static const char *const names[] = {"transforms.json", "transforms.json.gz", "transforms_train.json.gz",
                                        "reconstruction.json.gz"};
    for (size_t i = 0; i < OXL_COUNT(names); i++) {
        char path[1024];
        snprintf(path, sizeof path, "json%zu/%s", i, names[i]);
        test_write(path, "");
        inputs_compress(NULL, test_path(path));
        CHECK_ERROR(inputs_read(1, test_path("json%zu", i)), OXL_ERR_INPUT, "gunzip");
    }
}

#endif
