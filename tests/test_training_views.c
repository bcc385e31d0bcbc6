/* test_training_views.c - images that fit far worse than their neighbours are reported, and no others. */
#include "test.h"

enum { TVIEWS = 24, TVIEWS_W = 96, TVIEWS_H = 64, TVIEWS_GAUSSIANS = 600 };

/* A flat field of blobs seen from a grid of cameras 4 above it. */
static oxl_model tviews_model(void)
{
    oxl_model m = test_model(TVIEWS_GAUSSIANS, 0);
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
    OWNED_RENDERER *r = test_renderer();
    renderer_settings(r)->medium = in_medium ? tviews_medium : (struct medium){0};
    CHECK_OK(renderer_draw(test_ctx, r, m, camera, &options, out, NULL));
}

/* The views that `broken` names: two with a displaced pose, one darkened, one out of focus; 2: and one of
 * ground that the model does not have. 3: one turned. 4: one with a fish. */
static oxl_scene *tviews_scene(const oxl_model *m, int broken, int in_medium)
{
    oxl_view view[TVIEWS];
    oxl_image image[TVIEWS];
    oxl_point point[TVIEWS];
    char name[TVIEWS][16];
    const int displaces = broken == 1 || broken == 2;
    for (int v = 0; v < TVIEWS; v++) {
        const double x = 0.7 * (v % 6) - 1.75, y = 0.8 * (v / 6) - 1.2;
        snprintf(name[v], sizeof name[v], "v%02d", v);
        const oxl_camera camera = test_camera(TVIEWS_W, TVIEWS_H, 90, x, y, -4);
        view[v] = (oxl_view){name[v], camera, 0};
        point[v] = (oxl_point){.position = {x, y, 0}, .rgb = {90, 90, 90}};
        tviews_draw(m, &view[v].camera, in_medium, &image[v]);
        for (size_t i = 0; i < 3 * TVIEWS_W * TVIEWS_H; i++)
            image[v].rgb[i] += 0.02f * (float)(random_unit(random_bits(8, i, (uint64_t)v)) - 0.5);
        if (displaces && v == 8) view[v].camera.translation[0] += 0.2;
        if (broken == 3 && v == 8) /* turned by 0.1 rad about the axis, by which the centre does not move */
            pose_apply(&camera, (double[POSE_TERMS]){0, 0, 0.1}, &view[v].camera);
        for (size_t i = 0; broken == 2 && v == 10 && i < 3 * TVIEWS_W * TVIEWS_H; i++) /* other ground */
            image[v].rgb[i] =
                0.3f + 0.1f * (float)random_unit(random_bits(9, i % (TVIEWS_W * TVIEWS_H) / 2, 0));
        if (displaces && v == 15) view[v].camera.translation[1] -= 0.25;
        for (size_t i = 0; displaces && v == 20 && i < 3 * TVIEWS_W * TVIEWS_H; i++) image[v].rgb[i] *= 0.6f;
        for (int i = 0; broken == 4 && v == 9 && i < 3 * TVIEWS_W * TVIEWS_H; i++) /* a fish */
            if (abs(i % TVIEWS_W - 30) < 12 && abs(i / TVIEWS_W % TVIEWS_H - 30) < 5) image[v].rgb[i] = 1;
        for (int pass = 0; displaces && v == 3 && pass < 2;
             pass++) /* a running mean of 5 px along the rows */
            for (size_t i = 2; i + 3 < 3 * TVIEWS_W * TVIEWS_H; i++)
                image[v].rgb[i] = (image[v].rgb[i - 2] + image[v].rgb[i - 1] + image[v].rgb[i] +
                                   image[v].rgb[i + 1] + image[v].rgb[i + 2]) /
                                  5;
    }
    if (in_medium) test_imaging.medium = tviews_medium;
    return test_scene(view, image, TVIEWS, point, TVIEWS);
}

/* What is written of that scene after a run of so many iterations; what is said is in test_said. */
static struct text tviews_judge(int broken, int in_medium, int iterations, const char *worst)
{
    struct text t = test_text();
    OWNED_MODEL m = tviews_model();
    OWNED_SCENE *scene = tviews_scene(&m, broken, in_medium);
    test_listen();
    CHECK_OK(training_views_check(test_ctx, &m, scene, &test_imaging, iterations, NULL, &t, worst));
    return t;
}

static void tviews_check_flags(int in_medium)
{
    OWNED_TEXT t = tviews_judge(1, in_medium, 20 * TVIEWS, test_path("worst"));
    CHECK(test_said.warnings == 3); /* a shift explains no part of what is out of focus */
    CHECK_TEXT(t.data, "\"training\": {\"count\": 24, \"of\": 24, \"flagged\": 4, \"shown\": 4, ");
    for (const char *row = strstr(t.data, "{\"name\""); row; row = strstr(row + 1, "{\"name\"")) {
        char name[16], flag[16];
        oxl_json_text(oxl_json_member(row, "name"), name, sizeof name);
        oxl_json_text(oxl_json_member(row, "flag"), flag, sizeof flag);
        const char *wanted = !strcmp(name, "v08") || !strcmp(name, "v15") || !strcmp(name, "v03") ? "misfit"
                             : !strcmp(name, "v20")                                               ? "exposure"
                                                                                                  : "";
        test_case = name;
        CHECK(strcmp(flag, wanted) == 0);
    }
    test_case = NULL;
    CHECK(test_has("worst/v20.png") && test_has("worst/v20.image.png"));
}

TEST(training_views_with_a_wrong_pose_another_exposure_or_blur_are_flagged_and_the_first_two_reported)
{
    tviews_check_flags(0);
}

TEST(training_views_behind_a_medium_are_compared_with_what_the_model_shows_through_it)
{
    tviews_check_flags(1);
}

TEST(training_views_without_the_structure_of_their_images_are_counted_and_shown)
{
    OWNED_TEXT t = tviews_judge(2, 0, 20 * TVIEWS, test_path("fog"));
    CHECK(test_said.warnings == 3);
    CHECK_TEXT(t.data, "\"flagged\": 5, \"shown\": 4, ");
    const char *row = strstr(t.data, "{\"name\": \"v10\"");
    CHECK(row && oxl_json_number(row, "structure") < 0.3 && strstr(row, "\"flag\": \"misfit\"}"));
    row = strstr(t.data, "{\"name\": \"v11\"");
    CHECK(row && oxl_json_number(row, "structure") > 0.9);
    CHECK(test_has("fog/v10.png") && !test_has("fog/v11.png"));
}

TEST(training_views_displaced_by_an_amount_that_changes_over_the_image_are_named_with_it)
{
    OWNED_TEXT t = tviews_judge(3, 0, 20 * TVIEWS, NULL);
    double least = 0, most = 0;
    CHECK_LOGGED("training image v08 is rendered displaced by ");
    CHECK(sscanf(test_said.all, "warning: training image v08 is rendered displaced by %lf to %lf", &least,
                 &most) == 2);
    CHECK(least < 0.5 && most > 5 && most < 6.5); /* 0.1 rad of the half diagonal of 58 px */
}

TEST(training_views_with_a_thing_that_no_other_has_are_named_with_masks)
{
    OWNED_TEXT t = tviews_judge(4, 0, 20 * TVIEWS, NULL);
    CHECK(test_said.warnings == 1);
    CHECK_LOGGED("training image v09 differs from the others in a small part");
    CHECK_LOGGED("(--masks)");
}

TEST(training_views_of_a_valid_survey_are_not_flagged)
{
    OWNED_TEXT t = tviews_judge(0, 0, 20 * TVIEWS, NULL);
    CHECK(test_said.warnings == 0);
    CHECK_TEXT(t.data, "\"flagged\": 0, \"shown\": 4, ");
}

/* 6 views are judged: no run of fewer steps than 5 for each of all 24 is evidence against a view. */
TEST(training_views_of_a_run_too_short_for_all_views_are_not_flagged)
{
    for (int i = 0; i < 2; i++) {
        OWNED_TEXT t = tviews_judge(1, 0, 5 * TVIEWS - 1 + i, NULL);
        CHECK((test_said.warnings == 0) == (i == 0) && strstr(t.data, "\"count\": 6, \"of\": 24, "));
        CHECK((strstr(t.data, "\"flagged\": 0, ") == NULL) == i);
    }
}

/* Half as many iterations as all 24 views ask for. */
TEST(training_views_of_a_short_run_are_judged_by_evenly_spaced_ones)
{
    OWNED_TEXT t = tviews_judge(0, 0, 10 * TVIEWS, NULL), least = {0};
    CHECK_TEXT(t.data, "\"training\": {\"count\": 12, \"of\": 24, \"flagged\": 0, ");
    for (int v = 0; v < TVIEWS; v++) {
        char name[24];
        snprintf(name, sizeof name, "\"name\": \"v%02d\"", v);
        CHECK((strstr(t.data, name) != NULL) == (v % 2 == 0));
    }
    least = tviews_judge(0, 0, 1, NULL);
    CHECK_TEXT(least.data, "\"training\": {\"count\": 6, \"of\": 24, ");
}
