/* test_codec_memory.c - stb's memory is the context's: counted, limited, and refused without an abort. */
#include "test.h"

static oxl_image codec_test_image(int width, int height)
{
    oxl_image image = test_image(width, height);
    for (int i = 0; i < 3 * width * height; i++) image.rgb[i] = (float)(i * 7919 % 256) / 255;
    return image;
}

/* Images and models of each format, written and read back, and a model from points: each allocation is refused
 * once. */
TEST(images_and_models_without_memory_end_in_an_error_and_leak_nothing)
{
    static const char *const files[] = {"a.png", "a.spz", "a.ply", "a.splat"};
    static oxl_point points[100];
    OWNED_IMAGE image = codec_test_image(40, 24);
    int refused = 0;
    OWNED_MODEL model = test_model(50, 0);
    for (int k = 0; k < oxl_model_planes(&model); k++)
        for (size_t i = 0; i < model.count; i++) model.plane[k][i] = 0.01f * (float)(i + 1);
    for (int i = 0; i < 100; i++) points[i].position[0] = i;
    for (int what = 0; what < 9; what++)
        for (long at = 0;; at += 1 + at / 40) {
            const long before = blocks_held;
            const char *file = test_path(files[what / 2 % 4]);
            oxl_image back = {0};
            oxl_model read = {0};
            oxl_result rc;
            allocations_left = at;
            if (what == 8) rc = oxl_model_from_points(test_ctx, points, 100, 1, &read);
            else if (what % 2)
                rc =
                    what == 1 ? oxl_image_read(test_ctx, file, &back) : oxl_model_read(test_ctx, file, &read);
            else
                rc = what == 0 ? oxl_image_write(test_ctx, file, &image)
                               : oxl_model_write(test_ctx, file, &model);
            allocations_left = LONG_MAX;
            if (rc == OXL_OK) {
                CHECK(what == 8 ? read.count == 100 : !(what % 2) || back.width == 40 || read.count == 50);
                oxl_image_free(test_ctx, &back);
                oxl_model_free(test_ctx, &read);
                break;
            }
            refused++;
            CHECK(rc == OXL_ERR_MEMORY && oxl_error_text(test_ctx)[0] && blocks_held == before);
        }
    CHECK(refused > 20);
}

/* A file of a few kilobytes announces 100 million pixels' worth: the limit holds. */
TEST(decoding_stays_within_the_limit_of_memory)
{
    enum { SIDE = 3000 };
    oxl_image back;
    OWNED_IMAGE image = test_image(SIDE, SIDE);
    test_write_image("black.png", &image);
    test_ctx->threads = 1;
    memory_weigh_start(16 << 20);
    CHECK(oxl_image_read(test_ctx, test_path("black.png"), &back) == OXL_ERR_MEMORY);
    memory_weigh_start(0);
    back = test_read_image("black.png");
    CHECK(memory_weighed.most > 27 << 20); /* stb's memory is counted */
    oxl_image_free(test_ctx, &back);
    memory_weigh_end();
}

/* The shape is compared before the pixels are decoded: damaged ones are not found. */
TEST(an_image_of_another_shape_is_refused_by_its_header)
{
    const struct colmap_camera camera = {.model = 1,
                                         .width = 48,
                                         .height = 32,
                                         .parameter_count = 4,
                                         .parameter = {40, 40, 24, 16},
                                         .file = "cameras.txt"};
    const oxl_camera to = test_camera(48, 32, 40, 0, 0, 0);
    struct training_image out = {0};
    OWNED_IMAGE image = codec_test_image(100, 100);
    test_write_image("square.png", &image);
    OWNED_FILE map = test_file("square.png");
    test_write_bytes("cut.png", map.data, map.size / 2);
    CHECK_ERROR(image_load_training(test_ctx, test_path("cut.png"), NULL, NULL, &camera, &to, &out),
                OXL_ERR_INPUT, "another aspect ratio");
    CHECK(image_load_training(test_ctx, test_path("nowhere.png"), NULL, NULL, &camera, &to, &out) ==
          OXL_ERR_IO);
}
