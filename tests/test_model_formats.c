/* test_model_formats.c - SPZ and glTF: what is written, what comes back, and what is refused. */
#include "test.h"
#include "../src/formats/frame_flip.h"

/* Rows of every kind: far and near, opaque and faint, any rotation; harmonics of all bands. */
static oxl_model formats_test_model(size_t count, int degree)
{
    oxl_model m;
    CHECK_OK(oxl_model_create(test_ctx, count, degree, &m));
    for (int p = 0; p < oxl_model_planes(&m); p++)
        for (size_t i = 0; i < count; i++) {
            const double x = 2 * random_unit(random_bits(7, i, (uint64_t)p)) - 1;
            m.plane[p][i] = (float)(p < OXL_LOG_SCALE  ? 90 * x
                                    : p < OXL_ROTATION ? 5 * x - 4
                                    : p < OXL_OPACITY  ? x
                                    : p == OXL_OPACITY ? 5 * x
                                    : p < OXL_SH + 3   ? 2 * x
                                                       : 0.9 * x);
        }
    m.origin[0] = 500000.125, m.origin[1] = -4200000.25, m.origin[2] = 12.5;
    return m;
}

/* The largest difference of the rendered values: places, log scales, opacities, colours, harmonics; 1 -
 * |q.q'| of rotations. */
static void formats_test_compare(const oxl_model *a, const oxl_model *b, double worst[6])
{
    memset(worst, 0, 6 * sizeof *worst);
    for (size_t i = 0; i < a->count; i++) {
        double dot = 0, na = 0, nb = 0;
        for (int p = 0; p < oxl_model_planes(a); p++) {
            const double x = a->plane[p][i], y = b->plane[p][i];
            const int kind = p < OXL_LOG_SCALE  ? 0
                             : p < OXL_ROTATION ? 1
                             : p < OXL_OPACITY  ? 5
                             : p == OXL_OPACITY ? 2
                             : p < OXL_SH + 3   ? 3
                                                : 4;
            const double off = kind == 2 ? vecmath_sigmoid(x) - vecmath_sigmoid(y) : x - y;
            if (kind == 5) dot += x * y, na += x * x, nb += y * y;
            else worst[kind] = OXL_MAX(worst[kind], fabs(off));
        }
        worst[5] = OXL_MAX(worst[5], 1 - fabs(dot) / sqrt(na * nb));
    }
}

TEST(spz_gives_back_what_was_written_to_its_steps)
{
    for (int degree = 0; degree <= 3; degree++) {
        OWNED_MODEL m = formats_test_model(300, degree), back = {0};
        double worst[6];
        CHECK_OK(oxl_model_write(test_ctx, test_path("m.spz"), &m));
        test_read_model("m.spz", &back);
        CHECK(back.count == m.count && back.sh_degree == degree && back.lobes == 0);
        formats_test_compare(&m, &back, worst);
        CHECK(worst[0] <= 0.5 / (1 << 16)); /* 90 units leave 16 fractional bits */
        CHECK(worst[1] <= 0.5 / 16 + 1e-6 && worst[2] <= 0.6 / 255);
        CHECK(worst[3] <= 0.5 / 255 / 0.15 + 1e-6 && worst[4] <= 2.5 / 128 && worst[5] < 1e-5);
    }
}

TEST(spz_and_ply_give_back_origin_and_scale_and_gltf_holds_them)
{
    static const char *const names[] = {"m.spz", "m.ply"};
    oxl_model m = formats_test_model(20, 0), back;
    struct os_file_map file;
    oxl_model_rescale(&m, 0.4051);
    CHECK(m.scale == 0.4051 && fabs(m.origin[0] - 0.4051 * 500000.125) < 1e-6);
    for (int i = 0; i < 2; i++) {
        CHECK_OK(oxl_model_write(test_ctx, test_path(names[i]), &m));
        test_read_model(names[i], &back);
        CHECK(back.count == 20 && back.scale == m.scale &&
              memcmp(back.origin, m.origin, sizeof m.origin) == 0);
        oxl_model_free(test_ctx, &back);
    }
    CHECK_OK(oxl_model_write(test_ctx, test_path("m.glb"), &m));
    CHECK_OK(os_read_file(test_ctx, test_path("m.glb"), &file));
    CHECK(strstr(file.data + 20, "],\"extras\":{\"scale\":0.4051}}]") != NULL);
    os_release_file(test_ctx, &file);
    oxl_model_rescale(&m, 1 / 0.4051);
    CHECK(m.scale == 0 && fabs(m.origin[0] - 500000.125) < 1e-6);
    oxl_model_free(test_ctx, &m);
}

TEST(spz_written_again_is_the_same_bytes)
{
    OWNED_MODEL m = formats_test_model(50, 3), back = {0};
    struct os_file_map a, b;
    CHECK_OK(oxl_model_write(test_ctx, test_path("a.spz"), &m));
    test_read_model("a.spz", &back);
    CHECK_OK(oxl_model_write(test_ctx, test_path("b.spz"), &back));
    oxl_model_free(test_ctx, &m);
    test_read_model("b.spz", &m);
    CHECK_OK(oxl_model_write(test_ctx, test_path("c.spz"), &m));
    CHECK_OK(os_read_file(test_ctx, test_path("b.spz"), &a));
    CHECK_OK(os_read_file(test_ctx, test_path("c.spz"), &b));
    CHECK(a.size == b.size && memcmp(a.data, b.data, a.size) == 0);
    os_release_file(test_ctx, &a);
    os_release_file(test_ctx, &b);
}

/* One Gaussian, by hand: 1/4096 units, an alpha of 128, colours of 0, 127 and 255; turned by a quarter about
 * x. Stored, not deflated. */
static const unsigned char spz_test_one[] = {
    0x1f, 0x8b, 8,  0, 0, 0, 0,  0, 0, 255, 1,   36, 0, 219, 255, 'N', 'G', 'S', 'P', 3,   0,   0, 0, 1, 0, 0,
    0,    0,    12, 0, 0, 0, 16, 0, 0, 240, 255, 1,  0, 0,   128, 0,   127, 255, 160, 144, 176, 0, 0, 0, 0};

TEST(spz_frame_is_turned_by_half_a_turn_about_x)
{
    const double half = sqrt(0.5);
    unsigned char all[sizeof spz_test_one + 8];
    const size_t data = sizeof spz_test_one - 15;
    OWNED_MODEL m = {0};
    FILE *file;
    memcpy(all, spz_test_one, sizeof spz_test_one);
    bytes_put(all + sizeof spz_test_one - 4, (uint32_t)3 << 30 | 511, 4); /* x y z w = 0 0 .7 .7 there */
    bytes_put(all + sizeof spz_test_one, codec_png_checksum(all + 15, (int)data), 4);
    bytes_put(all + sizeof spz_test_one + 4, (uint32_t)data, 4);
    file = fopen(test_path("one.spz"), "wb");
    CHECK(file && fwrite(all, 1, sizeof all, file) == sizeof all && fclose(file) == 0);
    test_read_model("one.spz", &m);
    CHECK(m.count == 1 && m.plane[OXL_MEAN][0] == 1 && m.plane[OXL_MEAN + 1][0] == 1 &&
          m.plane[OXL_MEAN + 2][0] == -1.0f / 4096);
    CHECK_CLOSE(m.plane[OXL_LOG_SCALE][0], 0, 0);
    CHECK_CLOSE(m.plane[OXL_LOG_SCALE + 1][0], -1, 0);
    CHECK_CLOSE(m.plane[OXL_LOG_SCALE + 2][0], 1, 0);
    CHECK_CLOSE(m.plane[OXL_SH][0], -0.5 / 0.15, 1e-6);
    CHECK_CLOSE(m.plane[OXL_ROTATION][0], half, 1e-6);
    CHECK_CLOSE(m.plane[OXL_ROTATION + 3][0], -half, 1e-6);
}

/* A model and its turned copy look the same from turned cameras: so signs of places, rotations and harmonics
 * fit together. */
TEST(spz_and_gltf_signs_are_those_of_a_turned_scene)
{
    OWNED_MODEL m = formats_test_model(40, 3), turned = {0};
    oxl_camera camera = {32, 32, 40, 40, 16, 16, {1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 6}};
    OWNED_IMAGE a = {0}, b = {0};
    double psnr;
    for (int p = 0; p < 3; p++)
        for (size_t i = 0; i < m.count; i++) m.plane[p][i] *= 0.02f, m.plane[OXL_LOG_SCALE + p][i] *= 0.3f;
    CHECK_OK(model_copy(test_ctx, &m, &turned));
    for (size_t i = 0; i < m.count; i++) {
        for (int k = 1; k < 3; k++)
            turned.plane[OXL_MEAN + k][i] *= -1, turned.plane[OXL_ROTATION + 1 + k][i] *= -1;
        for (int k = 0; k < 15; k++)
            for (int c = 0; c < 3; c++) turned.plane[OXL_SH + 3 * (k + 1) + c][i] *= (float)frame_flip_sh[k];
    }
    CHECK_OK(oxl_render(test_ctx, &m, &camera, NULL, &a, NULL));
    for (int k = 1; k < 3; k++)
        for (int row = 0; row < 3; row++) camera.rotation[3 * row + k] *= -1; /* R diag(1, -1, -1) */
    CHECK_OK(oxl_render(test_ctx, &turned, &camera, NULL, &b, NULL));
    CHECK_OK(oxl_psnr(test_ctx, &a, &b, &psnr));
    CHECK(psnr > 90);
}

/* In the comments of .ply and .spz, also without a background, and in the unit that the model is changed to. */
TEST(view_of_a_model_survives_its_files_and_a_change_of_unit)
{
    static const char *const files[] = {"v.ply", "v.spz"};
    for (int i = 0; i < 4; i++) {
        OWNED_MODEL m = formats_test_model(5, 1), back = {0};
        m.has_background = i / 2;
        if (i == 1) memset(m.origin, 0, sizeof m.origin);
        for (int k = 0; k < 13; k++) m.view[k] = k < 10 ? 0.75 - 0.125 * k : 6700000.0625 + k;
        oxl_model_rescale(&m, 2);
        CHECK_OK(oxl_model_write(test_ctx, test_path(files[i % 2]), &m));
        CHECK_OK(oxl_model_read(test_ctx, test_path(files[i % 2]), &back));
        for (int k = 0; k < 13; k++)
            CHECK_CLOSE(back.view[k], k < 10 ? 0.75 - 0.125 * k : 2 * (6700000.0625 + k), 0);
        CHECK(back.scale > 1.99 && back.has_background == i / 2);
    }
}

TEST(spz_that_is_cut_or_damaged_is_refused_with_a_fix)
{
    oxl_model m = formats_test_model(30, 1), back;
    struct os_file_map map;
    OWNED_MEMORY unsigned char *copy = NULL;
    memset(m.origin, 0, sizeof m.origin); /* no comment: the checksum is of the data alone */
    CHECK_OK(oxl_model_write(test_ctx, test_path("m.spz"), &m));
    CHECK_OK(os_read_file(test_ctx, test_path("m.spz"), &map));
    copy = oxl_alloc(test_ctx, map.size, 1);
    for (size_t size = 0; size < map.size; size += 3) {
        FILE *file = fopen(test_path("cut.spz"), "wb");
        CHECK(file && fwrite(map.data, 1, size, file) == size && fclose(file) == 0);
        CHECK(oxl_model_read(test_ctx, test_path("cut.spz"), &back) == OXL_ERR_INPUT && back.count == 0);
        CHECK_SAYS("fix: copy the file again");
    }
    for (size_t i = 10; i < map.size; i += 7) {
        FILE *file = fopen(test_path("bad.spz"), "wb");
        memcpy(copy, map.data, map.size);
        copy[i] ^= 0x55;
        CHECK(file && fwrite(copy, 1, map.size, file) == map.size && fclose(file) == 0);
        CHECK(oxl_model_read(test_ctx, test_path("bad.spz"), &back) == OXL_ERR_INPUT);
    }
    test_write("v4.spz", "NGSP and then some zstd");
    CHECK_ERROR(oxl_model_read(test_ctx, test_path("v4.spz"), &back), OXL_ERR_INPUT,
                "found SPZ version 4 (zstd), expected version 2 or 3");
    os_release_file(test_ctx, &map);
    oxl_model_free(test_ctx, &m);
}

TEST(gltf_holds_the_arrays_it_announces_and_the_origin_in_full)
{
    OWNED_MODEL m = formats_test_model(33, 2);
    struct os_file_map map;
    const unsigned char *p;
    uint32_t text;
    float y;
    CHECK_OK(oxl_model_write(test_ctx, test_path("m.glb"), &m));
    CHECK_OK(os_read_file(test_ctx, test_path("m.glb"), &map));
    p = (const unsigned char *)map.data;
    text = bytes_u32(p + 12);
    CHECK(memcmp(p, "glTF", 4) == 0 && bytes_u32(p + 4) == 2 && bytes_u32(p + 8) == map.size &&
          memcmp(p + 16, "JSON", 4) == 0);
    CHECK(text % 4 == 0 && memcmp(p + 20 + text + 4, "BIN\0", 4) == 0 &&
          bytes_u32(p + 20 + text) == 33 * 4 * (3 + 4 + 3 + 1 + 27));
    CHECK(map.size == 28 + text + bytes_u32(p + 20 + text));
    CHECK_TEXT(map.data + 20, "\"translation\":[500000.125,4200000.25,-12.5]");
    CHECK_TEXT(map.data + 20, "\"KHR_gaussian_splatting:SH_DEGREE_2_COEF_4\":12}");
    CHECK_TEXT(map.data + 20, "\"colorSpace\":\"srgb_rec709_display\"");
    memcpy(&y, p + 28 + text + 12 + 4, 4); /* of the second Gaussian */
    CHECK(y == -m.plane[OXL_MEAN + 1][1]);
    os_release_file(test_ctx, &map);
}

TEST(gltf_of_nothing_is_refused)
{
    OWNED_MODEL m = {0};
    CHECK_OK(oxl_model_create(test_ctx, 0, 0, &m));
    CHECK_ERROR(oxl_model_write(test_ctx, test_path("m.glb"), &m), OXL_ERR_FAILED,
                "glTF has no empty arrays");
    CHECK(!test_has("m.glb"));
}
