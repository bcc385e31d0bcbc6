/* test_model_formats.c - SPZ, and what model files hold beside Gaussians: what is written, what comes back, and
 * what is refused. */
#include "test.h"

/* Rows of every kind: far and near, opaque and faint, any rotation; harmonics of all bands. */
static oxl_model formats_test_model(size_t count, int degree)
{
    oxl_model m = test_model(count, degree);
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
        OWNED_MODEL m = formats_test_model(300, degree);
        double worst[6];
        test_write_model("m.spz", &m);
        OWNED_MODEL back = test_read_model("m.spz");
        CHECK(back.count == m.count && back.sh_degree == degree && back.lobes == 0);
        CHECK(memcmp(back.origin, m.origin, sizeof m.origin) == 0);
        formats_test_compare(&m, &back, worst);
        CHECK(worst[0] <= 0.5 / (1 << 16)); /* 90 units leave 16 fractional bits */
        CHECK(worst[1] <= 0.5 / 16 + 1e-6 && worst[2] <= 0.6 / 255);
        CHECK(worst[3] <= 0.5 / 255 / 0.15 + 1e-6 && worst[4] <= 2.5 / 128 && worst[5] < 1e-5);
    }
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
    memcpy(all, spz_test_one, sizeof spz_test_one);
    bytes_put(all + sizeof spz_test_one - 4, (uint32_t)3 << 30 | 511, 4); /* x y z w = 0 0 .7 .7 there */
    bytes_put(all + sizeof spz_test_one, codec_png_checksum(all + 15, (int)data), 4);
    bytes_put(all + sizeof spz_test_one + 4, (uint32_t)data, 4);
    FILE *file = fopen(test_path("one.spz"), "wb");
    CHECK(file && fwrite(all, 1, sizeof all, file) == sizeof all && fclose(file) == 0);
    OWNED_MODEL m = test_read_model("one.spz");
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
TEST(spz_signs_are_those_of_a_turned_scene)
{
    OWNED_MODEL m = formats_test_model(40, 3), turned = {0};
    oxl_camera camera = test_camera(32, 32, 40, 0, 0, -6);
    double psnr;
    for (int p = 0; p < 3; p++)
        for (size_t i = 0; i < m.count; i++) m.plane[p][i] *= 0.02f, m.plane[OXL_LOG_SCALE + p][i] *= 0.3f;
    CHECK_OK(model_copy(test_ctx, &m, &turned));
    for (size_t i = 0; i < m.count; i++) {
        for (int k = 1; k < 3; k++)
            turned.plane[OXL_MEAN + k][i] *= -1, turned.plane[OXL_ROTATION + 1 + k][i] *= -1;
        for (int k = 0; k < 15; k++)
            for (int c = 0; c < 3; c++) turned.plane[OXL_SH + 3 * (k + 1) + c][i] *= (float)spz_turn_sh[k];
    }
    OWNED_IMAGE a = test_render(&m, &camera);
    for (int k = 1; k < 3; k++)
        for (int row = 0; row < 3; row++) camera.rotation[3 * row + k] *= -1; /* R diag(1, -1, -1) */
    OWNED_IMAGE b = test_render(&turned, &camera);
    CHECK_OK(oxl_psnr(test_ctx, &a, &b, &psnr));
    CHECK(psnr > 90);
}

/* Origin, unit, background, first view and anti-aliasing, any of them missing. */
TEST(models_files_hold_what_is_rendered_beside_gaussians)
{
    static const char *const files[] = {"m.ply", "m.spz", "m_standard.ply"};
    const oxl_camera camera = test_camera(16, 16, 16, 0, 0, 500);
    for (int i = 0; i < 48; i++) {
        OWNED_MODEL m = formats_test_model(5, 1), copy = {0};
        if (i & 1) memset(m.origin, 0, sizeof m.origin);
        m.antialias = i >> 1 & 1;
        m.has_background = i >> 2 & 1;
        if (m.has_background) memcpy(m.background, (float[3]){1, 0.25f, 0}, sizeof m.background);
        for (int k = 0; k < 13 && i & 8; k++) m.view[k] = k < 10 ? 0.75 - 0.125 * k : 6700000.0625 + k;
        oxl_model_rescale(&m, 0.4051);
        test_write_model(test_path(files[i / 16]), &m);
        OWNED_MODEL back = test_read_model(files[i / 16]);
        CHECK(back.count == 5 && back.scale == 0.4051 && back.antialias == m.antialias);
        CHECK(!memcmp(back.origin, m.origin, sizeof m.origin) && !memcmp(back.view, m.view, sizeof m.view));
        CHECK_OK(model_copy(test_ctx, &back, &copy));
        CHECK_OK(model_set_degree(test_ctx, &copy, 2));
        OWNED_IMAGE image = test_render(&copy, &camera); /* all is behind the camera */
        CHECK(copy.has_background == m.has_background && image.rgb[0] == m.background[0] &&
              image.rgb[256] == m.background[1] && image.rgb[512] == 0);
        oxl_model_rescale(&m, 1 / 0.4051);
        CHECK(m.scale == 0 && fabs(m.origin[0] - (i & 1 ? 0 : 500000.125)) < 1e-6);
    }
}

static void formats_test_refused(const char *name, const void *data, size_t size)
{
    FILE *file = fopen(test_path(name), "wb"); /* without the fsync of os_write_file */
    oxl_model m;
    CHECK(file && fwrite(data, 1, size, file) == size && fclose(file) == 0);
    CHECK(oxl_model_read(test_ctx, test_path(name), &m) == OXL_ERR_INPUT && m.count == 0);
}

TEST(spz_that_is_cut_or_damaged_is_refused_with_a_fix)
{
    OWNED_MODEL m = formats_test_model(30, 1);
    OWNED_MEMORY char *copy = NULL;
    test_write_model("m.spz", &m);
    OWNED_FILE map = test_file("m.spz");
    copy = oxl_alloc(test_ctx, map.size, 1);
    for (size_t size = 0; size < map.size; size += 3) {
        formats_test_refused("cut.spz", map.data, size);
        CHECK_SAYS("fix: copy the file again");
    }
    for (size_t i = 11 + strlen(map.data + 10); i < map.size; i += 7) { /* behind the comment */
        memcpy(copy, map.data, map.size);
        copy[i] ^= 0x55;
        formats_test_refused("bad.spz", copy, map.size);
    }
    formats_test_refused("v4.spz", "NGSP and then some zstd", 23);
    CHECK_SAYS("found SPZ version 4 (zstd), expected an SPZ file, version 2 or 3");
}
