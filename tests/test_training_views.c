/* test_training_views.c - images that fit far worse than their neighbours are reported, and no others. */
#include "test.h"

enum { TVIEWS = 24, TVIEWS_W = 96, TVIEWS_H = 64, TVIEWS_GAUSSIANS = 600 };

/* A flat field of blobs seen from a grid of cameras 4 above it. */
static oxl_model tviews_model(void)
{
    oxl_model m;
    CHECK_OK(oxl_model_create(test_ctx, TVIEWS_GAUSSIANS, 0, &m));
    for (size_t i = 0; i < m.count; i++) {
        for (int k = 0; k < 3; k++) {
            m.plane[OXL_MEAN + k][i] =
                (float)((k < 2 ? 8 : 0.4) * (random_unit(random_bits(5, i, (uint64_t)k)) - 0.5));
            m.plane[OXL_LOG_SCALE + k][i] = (float)(-2.6 + random_unit(random_bits(6, i, (uint64_t)k)));
            m.plane[OXL_SH + k][i] = (float)(3 * random_unit(random_bits(7, i, (uint64_t)k)) - 1);
        }
        m.plane[OXL_OPACITY][i] = 2;
    }
    return m;
}

/* A third of the light from the scene is left, and the medium is bright. */
static const struct medium tviews_medium = {.on = 1,
                                            .attenuation = {0.4f, 0.3f, 0.2f},
                                            .backscatter = {0.3f, 0.2f, 0.2f},
                                            .veiling_light = {0.1f, 0.35f, 0.45f}};

static void tviews_draw(const oxl_model *m, const oxl_camera *camera, int in_medium, oxl_image *out)
{
    const oxl_render_options options = oxl_render_options_default();
    struct renderer *r = NULL;
    CHECK_OK(renderer_create(test_ctx, &r));
    renderer_set_medium(r, in_medium ? &tviews_medium : NULL);
    CHECK_OK(renderer_draw(test_ctx, r, m, camera, &options, out, NULL));
    renderer_free(test_ctx, r);
}

/* Adds what one image alone shows: bright spots, or a glow that grows over its left half. */
static void tviews_spoil(oxl_image *image, int glow)
{
    for (int i = 0; i < 3 * TVIEWS_W * TVIEWS_H; i++) {
        const int x = i % TVIEWS_W, y = i / TVIEWS_W % TVIEWS_H;
        if (glow && x < TVIEWS_W / 2) image->rgb[i] += 0.3f * (float)(TVIEWS_W / 2 - x) / (TVIEWS_W / 2);
        if (!glow && x % 16 == 5 && y % 12 == 4) image->rgb[i] = 1;
    }
}

/* The views that `broken` names: two with a displaced pose, one darkened, one out of focus; 2: and one of
 * ground that the model does not have; 3: one with bright spots, one with a glow. */
static oxl_scene *tviews_scene(const oxl_model *m, int broken, int in_medium)
{
    oxl_view view[TVIEWS];
    oxl_image image[TVIEWS];
    oxl_point point[TVIEWS];
    char name[TVIEWS][16];
    oxl_scene *scene = NULL;
    const int displaces = broken == 1 || broken == 2;
    for (int v = 0; v < TVIEWS; v++) {
        const double x = 0.7 * (v % 6) - 1.75, y = 0.8 * (v / 6) - 1.2;
        snprintf(name[v], sizeof name[v], "v%02d", v);
        view[v] = (oxl_view){
            name[v], {TVIEWS_W, TVIEWS_H, 90, 90, 48, 32, {1, 0, 0, 0, 1, 0, 0, 0, 1}, {-x, -y, 4}}, 0};
        point[v] = (oxl_point){.position = {x, y, 0}, .rgb = {90, 90, 90}};
        tviews_draw(m, &view[v].camera, in_medium, &image[v]);
        if (broken == 3 && (v == 8 || v == 15)) tviews_spoil(&image[v], v == 15);
        for (size_t i = 0; i < 3 * TVIEWS_W * TVIEWS_H; i++)
            image[v].rgb[i] += 0.02f * (float)(random_unit(random_bits(8, i, (uint64_t)v)) - 0.5);
        if (displaces && v == 8) view[v].camera.translation[0] += 0.2;
        for (size_t i = 0; broken == 2 && v == 10 && i < 3 * TVIEWS_W * TVIEWS_H; i++) /* other ground */
            image[v].rgb[i] =
                0.3f + 0.1f * (float)random_unit(random_bits(9, i % (TVIEWS_W * TVIEWS_H) / 2, 0));
        if (displaces && v == 15) view[v].camera.translation[1] -= 0.25;
        for (size_t i = 0; displaces && v == 20 && i < 3 * TVIEWS_W * TVIEWS_H; i++) image[v].rgb[i] *= 0.6f;
        for (int pass = 0; displaces && v == 3 && pass < 2;
             pass++) /* a running mean of 5 px along the rows */
            for (size_t i = 2; i + 3 < 3 * TVIEWS_W * TVIEWS_H; i++)
                image[v].rgb[i] = (image[v].rgb[i - 2] + image[v].rgb[i - 1] + image[v].rgb[i] +
                                   image[v].rgb[i + 1] + image[v].rgb[i + 2]) /
                                  5;
    }
    CHECK_OK(oxl_scene_from_arrays(test_ctx, view, image, TVIEWS, point, TVIEWS, &scene));
    if (in_medium) test_imaging.medium = tviews_medium;
    for (int v = 0; v < TVIEWS; v++) oxl_image_free(test_ctx, &image[v]);
    return scene;
}

static void tviews_check_flags(int in_medium)
{
    oxl_model m = tviews_model();
    oxl_scene *scene = tviews_scene(&m, 1, in_medium);
    struct text t = {.ctx = test_ctx};
    colmap_listen();
    CHECK_OK(
        training_views_check(test_ctx, &m, scene, &test_imaging, 20 * TVIEWS, NULL, &t, test_path("worst")));
    CHECK(colmap_warned.count == 4);
    CHECK_TEXT(t.data, "\"training\": {\"count\": 24, \"of\": 24, \"flagged\": 4, \"shown\": 4, ");
    for (const char *row = strstr(t.data, "{\"name\""); row; row = strstr(row + 1, "{\"name\"")) {
        char name[16], flag[16];
        const char *wanted;
        oxl_json_text(oxl_json_member(row, "name"), name, sizeof name);
        oxl_json_text(oxl_json_member(row, "flag"), flag, sizeof flag);
        wanted = !strcmp(name, "v08") || !strcmp(name, "v15") ? "pose"
                 : !strcmp(name, "v20")                       ? "exposure"
                 : !strcmp(name, "v03")                       ? "blur"
                                                              : "";
        if (strcmp(flag, wanted)) printf("  %s: '%s', expected '%s'\n", name, flag, wanted);
        CHECK(strcmp(flag, wanted) == 0);
    }
    CHECK(os_is_file(test_path("worst/v20.png")) && os_is_file(test_path("worst/v20.image.png")));
    text_free(&t);
    oxl_scene_free(test_ctx, scene);
    oxl_model_free(test_ctx, &m);
}

TEST(training_views_with_a_wrong_pose_another_exposure_or_blur_are_reported_and_no_others)
{
    tviews_check_flags(0);
}

TEST(training_views_behind_a_medium_are_compared_with_what_the_model_shows_through_it)
{
    tviews_check_flags(1);
}

/* Returns 1 if a view has the flag; "": none. */
static int tviews_has(const char *json, const char *name, const char *flag)
{
    char wanted[40], found[24];
    const char *row;
    snprintf(wanted, sizeof wanted, "{\"name\": \"%s\"", name);
    row = strstr(json, wanted);
    if (!row) return 0;
    oxl_json_text(oxl_json_member(row, "flag"), found, sizeof found);
    if (strcmp(found, flag)) printf("  %s: '%s', expected '%s'\n", name, found, flag);
    return !strcmp(found, flag);
}

/* Keeps the lines of the log, of any level. */
static char tviews_said[2000];

static void tviews_hear(void *user, oxl_log_level level, const char *text)
{
    const size_t length = strlen(tviews_said);
    (void)user;
    snprintf(tviews_said + length, sizeof tviews_said - length, "%s: %s\n",
             level == OXL_LOG_WARNING ? "warning" : "info", text);
}

static void tviews_listen(void)
{
    tviews_said[0] = '\0';
    test_ctx->options.log = tviews_hear;
}

/* Neither is a wrong pose, though a shift of a small image explains some of a glow. */
TEST(training_views_with_reflections_or_a_glow_of_their_own_are_said_to_have_these)
{
    oxl_model m = tviews_model();
    oxl_scene *scene = tviews_scene(&m, 3, 0);
    struct text t = {.ctx = test_ctx};
    tviews_listen();
    CHECK_OK(training_views_check(test_ctx, &m, scene, &test_imaging, 20 * TVIEWS, NULL, &t, NULL));
    CHECK_TEXT(t.data, "\"flagged\": 2, ");
    CHECK(tviews_has(t.data, "v08", "reflections") && tviews_has(t.data, "v15", "colour"));
    CHECK_TEXT(tviews_said, "info: training image v08 fits ");
    CHECK_TEXT(tviews_said,
               "bright spots that other views do not show: reflections, which the model cannot follow");
    CHECK_TEXT(tviews_said, "warning: training image v15 fits ");
    CHECK_TEXT(tviews_said, "it differs in colour or light over part of the image");
    text_free(&t);
    oxl_scene_free(test_ctx, scene);
    oxl_model_free(test_ctx, &m);
}

/* Fills an image with the test's blobs, seen from `x`; blur: mean over 3 px along the rows, so many times. */
static void tviews_blobs(double x, int blur, oxl_image *out)
{
    oxl_model m = tviews_model();
    const oxl_camera camera = {TVIEWS_W, TVIEWS_H, 90, 90, 48, 32, {1, 0, 0, 0, 1, 0, 0, 0, 1}, {-x, 0, 4}};
    const size_t end = 3 * TVIEWS_W * TVIEWS_H - 1;
    tviews_draw(&m, &camera, 0, out);
    for (int pass = 0; pass < blur; pass++)
        for (size_t i = 1, k = 0; i < end; i++, k = !k) {
            static float before[2];
            before[k] = out->rgb[i];
            out->rgb[i] = ((i > 1 ? before[!k] : out->rgb[0]) + out->rgb[i] + out->rgb[i + 1]) / 3;
        }
    oxl_model_free(test_ctx, &m);
}

/* 3 px of 96; half a pixel, whose interpolation blurs; then no shift, but blur. */
TEST(misfit_finds_a_shift_of_the_image_and_not_its_blur)
{
    static const double moved[] = {3 * 4 / 90.0, 0.5 * 4 / 90.0, 0};
    for (int i = 0; i < 3; i++) {
        oxl_image image = {0}, rendered = {0};
        struct misfit error;
        tviews_blobs(0, i == 2 ? 5 : 0, &image);
        tviews_blobs(moved[i], 0, &rendered);
        CHECK_OK(misfit_measure(test_ctx, &rendered, &image, &error));
        if (i < 2) CHECK(error.shifted > 0.6);
        else CHECK(error.shifted < 0.05);
        oxl_image_free(test_ctx, &image);
        oxl_image_free(test_ctx, &rendered);
    }
}

/* The light of a lamp moves by 6 px, as one shift of a small image would explain; the ground is in its place. */
TEST(misfit_of_light_that_moves_over_ground_in_its_place_is_no_shift)
{
    oxl_image image[2] = {{0}};
    struct misfit error;
    for (int k = 0; k < 2; k++) {
        CHECK_OK(oxl_image_create(test_ctx, 192, 144, &image[k]));
        for (int i = 0; i < 3 * 192 * 144; i++) {
            const int x = i % 192, y = i / 192 % 144;
            const double px = x - 96 - 6 * k, py = y - 72;
            image[k].rgb[i] = (float)(0.7 * exp(-(px * px + py * py) / 3200) +
                                      0.05 * random_unit(random_bits(9, (uint64_t)x, (uint64_t)y)));
        }
    }
    CHECK_OK(misfit_measure(test_ctx, &image[0], &image[1], &error));
    CHECK(error.shifted < 0.05 && error.smooth > 0.8);
    for (int k = 0; k < 2; k++) oxl_image_free(test_ctx, &image[k]);
}

/* Half of the image is masked, and white: its error is that of the other half, which has one spot in 1536
 * pixels that is brighter. A darker spot is as large a part, but none that is brighter. */
TEST(misfit_leaves_out_masked_pixels)
{
    for (int darker = 0; darker < 2; darker++) {
        oxl_image image = {0}, rendered = {0};
        struct misfit error;
        CHECK_OK(oxl_image_create(test_ctx, 64, 48, &image));
        CHECK_OK(oxl_image_create(test_ctx, 64, 48, &rendered));
        image.weight = oxl_alloc(test_ctx, 64 * 48, sizeof *image.weight);
        for (int i = 0; i < 64 * 48; i++) {
            image.weight[i] = (float)(i % 64 < 32);
            for (int c = 0; c < 3; c++) {
                rendered.rgb[c * 64 * 48 + i] = 0.5f;
                image.rgb[c * 64 * 48 + i] = i % 64 >= 32 ? 1.0f : i == 20 * 64 + 9 ? (float)!darker : 0.5f;
            }
        }
        CHECK_OK(misfit_measure(test_ctx, &rendered, &image, &error));
        CHECK_CLOSE(error.brighter, !darker, 0.01);
        CHECK(error.spots > 0.95 && error.smooth < 0.05);
        oxl_image_free(test_ctx, &image);
        oxl_image_free(test_ctx, &rendered);
    }
}

TEST(training_views_without_the_structure_of_their_images_are_reported_once_and_shown)
{
    oxl_model m = tviews_model();
    oxl_scene *scene = tviews_scene(&m, 2, 0);
    struct text t = {.ctx = test_ctx};
    const char *row;
    colmap_listen();
    CHECK_OK(
        training_views_check(test_ctx, &m, scene, &test_imaging, 20 * TVIEWS, NULL, &t, test_path("fog")));
    CHECK(colmap_warned.count == 5);
    CHECK_TEXT(t.data, "\"flagged\": 5, \"shown\": 4, \"structure\": 0.");
    CHECK_TEXT(t.data, "\"no_structure\": ");
    row = strstr(t.data, "{\"name\": \"v10\"");
    CHECK(row && oxl_json_number(row, "structure") < 0.3);
    CHECK(row && strstr(row, "\"flag\": \"no structure\"}"));
    row = strstr(t.data, "{\"name\": \"v11\"");
    CHECK(row && oxl_json_number(row, "structure") > 0.9);
    CHECK(os_is_file(test_path("fog/v10.png")) && !os_is_file(test_path("fog/v11.png")));
    text_free(&t);
    oxl_scene_free(test_ctx, scene);
    oxl_model_free(test_ctx, &m);
}

/* Checks that a figure of all training views is the mean of theirs. */
static void tviews_check_mean(const char *json, const char *figure)
{
    const char *of = strstr(json, "\"training\": ");
    const double whole = of ? oxl_json_number(of + strlen("\"training\": "), figure) : NAN;
    double sum = 0;
    for (const char *row = strstr(json, "{\"name\""); row; row = strstr(row + 1, "{\"name\""))
        sum += oxl_json_number(row, figure) / TVIEWS;
    CHECK(whole > 0);
    CHECK_CLOSE(whole, sum, 1e-9 * sum);
}

TEST(training_views_have_the_mean_of_their_figures)
{
    oxl_model m = tviews_model();
    oxl_scene *scene = tviews_scene(&m, 1, 0);
    struct text t = {.ctx = test_ctx};
    CHECK_OK(training_views_check(test_ctx, &m, scene, &test_imaging, 20 * TVIEWS, NULL, &t, NULL));
    tviews_check_mean(t.data, "psnr");
    tviews_check_mean(t.data, "cc_psnr");
    tviews_check_mean(t.data, "structure");
    text_free(&t);
    oxl_scene_free(test_ctx, scene);
    oxl_model_free(test_ctx, &m);
}

TEST(training_views_of_a_valid_survey_are_not_flagged)
{
    oxl_model m = tviews_model();
    oxl_scene *scene = tviews_scene(&m, 0, 0);
    struct text t = {.ctx = test_ctx};
    colmap_listen();
    CHECK_OK(training_views_check(test_ctx, &m, scene, &test_imaging, 20 * TVIEWS, NULL, &t, NULL));
    CHECK(colmap_warned.count == 0);
    CHECK_TEXT(t.data, "\"flagged\": 0, \"shown\": 2, ");
    text_free(&t);
    CHECK_OK(training_views_check(test_ctx, &m, scene, &test_imaging, 1000, NULL, &t, NULL));
    CHECK_TEXT(t.data, "\"flagged\": 0, \"shown\": 4, "); /* not a short run */
    text_free(&t);
    oxl_scene_free(test_ctx, scene);
    oxl_model_free(test_ctx, &m);
}

/* 6 views are judged: no run of fewer steps than 5 for each of all 24 is evidence against a view. */
TEST(training_views_of_a_run_too_short_for_all_views_are_not_flagged)
{
    oxl_model m = tviews_model();
    oxl_scene *scene = tviews_scene(&m, 1, 0);
    for (int i = 0; i < 2; i++) {
        struct text t = {.ctx = test_ctx};
        colmap_listen();
        CHECK_OK(
            training_views_check(test_ctx, &m, scene, &test_imaging, 5 * TVIEWS - 1 + i, NULL, &t, NULL));
        CHECK((colmap_warned.count == 0) == (i == 0));
        CHECK(strstr(t.data, "\"count\": 6, \"of\": 24, "));
        CHECK((strstr(t.data, "\"flagged\": 0, ") == NULL) == i);
        text_free(&t);
    }
    oxl_scene_free(test_ctx, scene);
    oxl_model_free(test_ctx, &m);
}

/* A short run, as one without held-out views. */
TEST(training_views_that_are_measured_are_all_judged)
{
    oxl_model m = tviews_model();
    oxl_scene *scene = tviews_scene(&m, 1, 0);
    struct text t = {.ctx = test_ctx};
    oxl_metrics all = {0};
    CHECK_OK(oxl_evaluate(test_ctx, &m, scene, &test_imaging, OXL_SPLIT_TRAIN, &all));
    tviews_listen();
    CHECK_OK(training_views_check(test_ctx, &m, scene, &test_imaging, 5 * TVIEWS, &all, &t, NULL));
    CHECK_TEXT(t.data, "\"training\": {\"count\": 24, \"of\": 24, \"flagged\": 4, ");
    CHECK(!strstr(tviews_said, "are judged"));
    CHECK(all.count == TVIEWS);
    text_free(&t);
    oxl_metrics_free(test_ctx, &all);
    oxl_scene_free(test_ctx, scene);
    oxl_model_free(test_ctx, &m);
}

/* Half as many iterations as all 24 views ask for. */
TEST(training_views_of_a_short_run_are_judged_by_evenly_spaced_ones)
{
    oxl_model m = tviews_model();
    oxl_scene *scene = tviews_scene(&m, 0, 0);
    struct text t = {.ctx = test_ctx};
    tviews_listen();
    CHECK_OK(training_views_check(test_ctx, &m, scene, &test_imaging, 10 * TVIEWS, NULL, &t, NULL));
    CHECK_TEXT(t.data, "\"training\": {\"count\": 12, \"of\": 24, \"flagged\": 0, ");
    CHECK_TEXT(tviews_said, "12 of 24 training views are judged, evenly spaced: one for each 20 iterations");
    for (int v = 0; v < TVIEWS; v++) {
        char name[24];
        snprintf(name, sizeof name, "\"name\": \"v%02d\"", v);
        CHECK((strstr(t.data, name) != NULL) == (v % 2 == 0));
    }
    text_free(&t);
    tviews_listen();
    CHECK_OK(training_views_check(test_ctx, &m, scene, &test_imaging, 1, NULL, &t, NULL));
    CHECK_TEXT(t.data, "\"training\": {\"count\": 6, \"of\": 24, ");
    text_free(&t);
    oxl_scene_free(test_ctx, scene);
    oxl_model_free(test_ctx, &m);
}
