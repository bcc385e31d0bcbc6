/* test_metrics.c - PSNR and SSIM against values of independent implementations (torch's conv2d;
 * numpy). */
#include "test.h"

enum { METRICS_TEST_W = 37, METRICS_TEST_H = 23, METRICS_TEST_N = 3 * METRICS_TEST_W * METRICS_TEST_H };

static void metrics_noise(uint32_t state, float *out, int count)
{
    for (int i = 0; i < count; i++) {
        state = state * 1664525u + 1013904223u;
        out[i] = (float)(state >> 8) / 16777216.0f;
    }
}

/* Noise, and the same with a quarter of other noise mixed in. */
static void metrics_pair(oxl_image *a, oxl_image *b)
{
    *a = test_image(METRICS_TEST_W, METRICS_TEST_H);
    *b = test_image(METRICS_TEST_W, METRICS_TEST_H);
    metrics_noise(1, a->rgb, METRICS_TEST_N);
    metrics_noise(2, b->rgb, METRICS_TEST_N);
    for (int i = 0; i < METRICS_TEST_N; i++) b->rgb[i] = (float)(0.75 * a->rgb[i] + 0.25 * b->rgb[i]);
}

static void metrics_mask_corner(oxl_image *image)
{
    image->weight = oxl_alloc(test_ctx, METRICS_TEST_W * METRICS_TEST_H, sizeof(float));
    for (int i = 0; i < METRICS_TEST_W * METRICS_TEST_H; i++)
        image->weight[i] = i % METRICS_TEST_W < 9 && i / METRICS_TEST_W < 4 ? 0.0f : 1.0f;
}

typedef oxl_result metrics_function(oxl_context *ctx, const oxl_image *a, const oxl_image *b, double *out);

static double metrics_of(metrics_function *metric, const oxl_image *a, const oxl_image *b)
{
    double value;
    CHECK_OK(metric(test_ctx, a, b, &value));
    return value;
}

/* An image that was exposed otherwise, and in other channels otherwise; one pixel is wrong on top of it. */
TEST(metrics_cc_psnr_leaves_out_exposure_and_nothing_else)
{
    const size_t plane = METRICS_TEST_W * METRICS_TEST_H;
    OWNED_IMAGE a, b;
    metrics_pair(&a, &b);
    for (size_t i = 0; i < 3 * plane; i++) {
        a.rgb[i] = OXL_CLAMP(a.rgb[i], 0.0f, 0.8f);
        b.rgb[i] = a.rgb[i] * (i < plane ? 0.7f : i < 2 * plane ? 0.9f : 1.2f);
    }
    CHECK(metrics_of(oxl_psnr, &a, &b) < 30 && metrics_of(oxl_cc_psnr, &a, &b) == 100);
    b.rgb[7] = 1;
    double cc = metrics_of(oxl_cc_psnr, &a, &b);
    CHECK(cc < 100 && cc > -10 * log10(1.0 / (3.0 * METRICS_TEST_W * METRICS_TEST_H)));
    memset(a.rgb, 0, 3 * plane * sizeof *a.rgb); /* black has no exposure */
    CHECK(metrics_of(oxl_cc_psnr, &a, &b) == metrics_of(oxl_psnr, &a, &b));
}

TEST(metrics_agree_with_an_independent_implementation)
{
    OWNED_IMAGE a, b;
    metrics_pair(&a, &b);
    CHECK_CLOSE(metrics_of(oxl_psnr, &a, &b), 19.821407012856415, 1e-10);
    CHECK_CLOSE(metrics_of(oxl_ssim, &a, &b), 0.9319152063869652, 1e-12);
}

TEST(metrics_leave_out_masked_pixels_and_the_windows_that_touch_them)
{
    OWNED_IMAGE a, b;
    double psnr, ssim;
    metrics_pair(&a, &b);
    metrics_mask_corner(&b);
    psnr = metrics_of(oxl_psnr, &a, &b), ssim = metrics_of(oxl_ssim, &a, &b);
    CHECK_CLOSE(psnr, 19.809485214640993, 1e-10);
    CHECK_CLOSE(ssim, 0.9313028697397622, 1e-12);
    /* within the mask: no matter */
    for (int c = 0; c < 3; c++) a.rgb[c * METRICS_TEST_W * METRICS_TEST_H + 8] = 1e6f;
    CHECK(metrics_of(oxl_psnr, &a, &b) == psnr && metrics_of(oxl_ssim, &a, &b) == ssim);
    memset(b.weight, 0, METRICS_TEST_W * METRICS_TEST_H * sizeof(float));
    CHECK(oxl_psnr(test_ctx, &a, &b, &psnr) == OXL_ERR_INPUT);
    CHECK_ERROR(oxl_ssim(test_ctx, &a, &b, &ssim), OXL_ERR_INPUT, "masked");
}

TEST(metrics_clamp_and_call_identical_images_100_db)
{
    OWNED_IMAGE a, b;
    double psnr, ssim;
    metrics_pair(&a, &b);
    memcpy(b.rgb, a.rgb, METRICS_TEST_N * sizeof(float));
    a.rgb[0] = 7, b.rgb[0] = 1;
    a.rgb[1] = -7, b.rgb[1] = 0;
    a.rgb[2] = NAN, b.rgb[2] = 0;
    CHECK(metrics_of(oxl_psnr, &a, &b) == 100);
    CHECK_CLOSE(metrics_of(oxl_ssim, &a, &b), 1, 1e-12);
    b.width--;
    CHECK(oxl_psnr(test_ctx, &a, &b, &psnr) == OXL_ERR_USAGE);
    CHECK(oxl_ssim(test_ctx, &a, &b, &ssim) == OXL_ERR_USAGE);
}

TEST(metrics_are_the_same_with_any_number_of_threads)
{
    OWNED_IMAGE a, b;
    metrics_pair(&a, &b);
    metrics_mask_corner(&b);
    test_ctx->threads = 1;
    double one = metrics_of(oxl_ssim, &a, &b);
    test_ctx->threads = 7;
    CHECK(metrics_of(oxl_ssim, &a, &b) == one);
}

/* Two views of one red Gaussian; the images are its own drawings, in 8 bits: at least 20 log10(255 x 2) = 54
 * dB. */
static oxl_scene *metrics_scene(const oxl_model *model, oxl_view view[2])
{
    oxl_image image[2];
    /* z 1, 2, 2.5 */
    oxl_point point[3] = {
        {.position = {-0.4, 0, -2}}, {.position = {0.9, 0, -1}}, {.position = {0, 0, -0.5}}};
    for (int i = 0; i < 2; i++) {
        view[i] = (oxl_view){.name = i ? "a \"quoted\"" : "b", .is_test = i};
        view[i].camera = test_camera(24, 16, 20, -0.1 * i, 0, -3);
        image[i] = test_render(model, &view[i].camera);
    }
    return test_scene(view, image, 2, point, 3);
}

TEST(metrics_evaluate_each_view_of_a_split_and_write_json)
{
    oxl_view view[2];
    oxl_metrics m;
    OWNED_TEXT json = test_text();
    OWNED_MODEL model = test_model(1, 0);
    for (int k = 0; k < 3; k++) model.plane[OXL_LOG_SCALE + k][0] = -1;
    model.plane[OXL_SH][0] = 1;
    OWNED_SCENE *scene = metrics_scene(&model, view);
    CHECK_OK(oxl_evaluate(test_ctx, &model, scene, &test_imaging, OXL_SPLIT_TEST, &m));
    CHECK(m.count == 1 && strcmp(oxl_scene_view(scene, m.views[0].view)->name, "a \"quoted\"") == 0);
    oxl_metrics_free(test_ctx, &m);
    CHECK_OK(oxl_evaluate(test_ctx, &model, scene, &test_imaging, OXL_SPLIT_ALL, &m));
    CHECK(m.count == 2 && m.views[0].view == 0 && m.views[1].view == 1);
    CHECK(m.psnr > 54 && m.psnr < 100 && m.ssim > 0.99);
    CHECK_CLOSE(m.psnr, (m.views[0].psnr + m.views[1].psnr) / 2, 1e-12);
    CHECK_OK(metrics_json_add(&json, scene, &m));
    CHECK_CLOSE(m.cc_psnr, (m.views[0].cc_psnr + m.views[1].cc_psnr) / 2, 1e-12);
    CHECK_TEXT(json.data, ",\n  \"cc_psnr\": ");
    CHECK_TEXT(json.data, "\"count\": 2,\n  \"views\": [\n    {\"name\": \"a \\\"quoted\\\"\", \"psnr\": ");
    oxl_metrics_free(test_ctx, &m);
}

/* Values of tests/structure.py. */
TEST(structure_agrees_with_an_independent_implementation)
{
    OWNED_IMAGE a, b;
    metrics_pair(&a, &b);
    CHECK_CLOSE(metrics_of(oxl_structure, &a, &b), 0.940001026129779, 1e-9);
    metrics_mask_corner(&b);
    CHECK_CLOSE(metrics_of(oxl_structure, &a, &b), 0.936837425080829, 1e-9);
    a.rgb[2] = b.rgb[3] = 0.5f; /* both are masked */
    CHECK_CLOSE(metrics_of(oxl_structure, &a, &b), 0.936837425080829, 1e-9);
}

/* Rows of 150 columns are blurred in runs, of which the last overlaps the one before; rows of 37 column by
 * column. */
TEST(structure_of_transposed_images_is_the_same)
{
    enum { W = 150, H = 37 };
    oxl_image wide[2], tall[2];
    for (int k = 0; k < 2; k++) {
        wide[k] = test_image(W, H);
        tall[k] = test_image(H, W);
        for (int i = 0; i < 3 * W * H; i++) {
            const int c = i / (W * H), y = i % (W * H) / W, x = i % W;
            wide[k].rgb[i] = 0.5f + 0.4f * (float)sin(0.3 * x + 0.07 * x * y + k * (0.2 + 0.001 * x * x) + c);
            tall[k].rgb[c * W * H + x * H + y] = wide[k].rgb[i];
        }
    }
    double of_wide = metrics_of(oxl_structure, &wide[0], &wide[1]);
    CHECK(fabs(of_wide) > 1e-3 && of_wide < 0.999);
    CHECK_CLOSE(metrics_of(oxl_structure, &tall[0], &tall[1]), of_wide, 1e-12);
    for (int k = 0; k < 2; k++) {
        oxl_image_free(test_ctx, &wide[k]);
        oxl_image_free(test_ctx, &tall[k]);
    }
}

/* What PSNR takes for 34 dB: the light of a lamp, and no ground in it. */
TEST(structure_does_not_depend_on_brightness_and_is_none_of_a_glow)
{
    OWNED_IMAGE a, b;
    double value;
    metrics_pair(&a, &b);
    for (int i = 0; i < METRICS_TEST_N; i++) b.rgb[i] = 0.1f + 0.06f * a.rgb[i];
    CHECK_CLOSE(metrics_of(oxl_structure, &a, &b), 1, 1e-6);
    for (int i = 0; i < METRICS_TEST_N; i++) a.rgb[i] = 0.13f;
    CHECK(metrics_of(oxl_psnr, &a, &b) > 34 && fabs(metrics_of(oxl_structure, &a, &b)) < 1e-3);
    CHECK(isnan(metrics_of(oxl_structure, &b, &a))); /* an image without detail */
    a.width--;
    CHECK(oxl_structure(test_ctx, &b, &a, &value) == OXL_ERR_USAGE);
    a.width++;
}
