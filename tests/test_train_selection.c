/* test_train_selection.c - SH bands and second lobes are kept only where trials show a gain; the evidence is
 * recorded. */
#include "test.h"

TEST(selection_validates_on_an_eighth_of_the_views_and_eight_at_most)
{
    int held = 0;
    for (int i = 0; i < 300; i++) held += selection_is_validation_view(i, 300);
    CHECK(held == 8 && !selection_is_validation_view(0, 1));
    for (int i = held = 0; i < 20; i++) held += selection_is_validation_view(i, 20);
    CHECK(held == 2);
}

/* Density control, and the trial, at step 1500 of 3000. */
TEST(selection_trains_all_views_but_for_a_tenth_of_the_run_before_a_trial)
{
    NEEDS_PART(sh_degree);
    oxl_train_options o = train_options(3000);
    struct train t = {
        .ctx = test_ctx, .survey = train_scene(14), .options = &o, .decisions = {.ctx = test_ctx}};
    oxl_scene *scene = t.survey;
    const int views = schedule_training_views(scene);
    o.sh_degree = -1;
    CHECK_OK(train_begin(&t));
    while (t.step < 1510) {
        if (t.trial) CHECK_OK(selection_trial(&t));
        t.step++;
        CHECK_OK(train_step(&t));
        CHECK(t.validation_views == (t.step > 1200 && t.step <= 1500) &&
              t.views + t.validation_views == views);
        CHECK((t.trial == NULL) == (t.step != 1500));
    }
    train_end(&t);
    oxl_scene_free(test_ctx, scene);
}

struct selection_test_case {
    oxl_scene *scene;
    oxl_train_options options;
    struct text log, decisions;
    oxl_model model;
};

/* The same cameras and points before a wall without any pattern. */
static oxl_scene *selection_test_grey(oxl_scene *scene)
{
    oxl_view view[14];
    oxl_image image[14];
    oxl_scene *grey = NULL;
    for (int v = 0; v < 14; v++) {
        view[v] = *oxl_scene_view(scene, v);
        CHECK_OK(oxl_scene_image(test_ctx, scene, v, NULL, &image[v]));
        for (int i = 0; i < 3 * image[v].width * image[v].height; i++) image[v].rgb[i] = 0.5f;
    }
    CHECK_OK(oxl_scene_from_arrays(test_ctx, view, image, 14, oxl_scene_points(scene),
                                   oxl_scene_point_count(scene), &grey));
    for (int v = 0; v < 14; v++) oxl_image_free(test_ctx, &image[v]);
    oxl_scene_free(test_ctx, scene);
    return grey;
}

/* Trains; decisions and model are left. */
static struct selection_test_case selection_test_case(oxl_scene *scene, int sh_degree, oxl_dog dog)
{
    struct selection_test_case c = {
        scene, train_options(sh_degree < 0 ? 3000 : 300), {.ctx = test_ctx}, {.ctx = test_ctx}, {0}};
    struct train_task place = {.store = checkpoint_in(test_folder(), "key"),
                               .log = &c.log,
                               .notes = &c.log,
                               .decisions = &c.decisions};
    c.options.sh_degree = sh_degree;
    c.options.dog = dog;
    /* bands take the usual steps: a grey world is rendered to 70 dB by whatever learns fast */
    c.options.short_run_exponent = 0;
    CHECK_OK(train_run(test_ctx, c.scene, &c.options, NULL, &place, &c.model));
    return c;
}

static void selection_test_case_free(struct selection_test_case *c)
{
    oxl_scene_free(test_ctx, c->scene);
    oxl_model_free(test_ctx, &c->model);
    text_free(&c->log);
    text_free(&c->decisions);
}

TEST(selection_keeps_degree_0_where_colours_do_not_depend_on_the_view)
{
    NEEDS_PART(sh_degree);
    struct selection_test_case c = selection_test_case(selection_test_grey(train_scene(14)), -1, OXL_DOG_OFF);
    if (c.model.sh_degree) printf("%s\n", c.decisions.data);
    CHECK(c.model.sh_degree == 0);
    CHECK(strstr(c.decisions.data, "\"sh_degree\": {\"chosen\": \"0\"") != NULL);
    selection_test_case_free(&c);
}

TEST(selection_keeps_sh_bands_where_colours_depend_on_the_view)
{
    NEEDS_PART(sh_degree);
    struct selection_test_case c = selection_test_case(train_scene_of(14, 4), -1, OXL_DOG_OFF);
    CHECK(c.model.sh_degree >= 1);
    selection_test_case_free(&c);
}

TEST(selection_follows_explicit_options)
{
    NEEDS_PART(ucd);
    NEEDS_PART(lobes);
    NEEDS_PART(prune);
    NEEDS_PART(sh_degree);
    struct selection_test_case c = selection_test_case(train_scene(14), 2, OXL_DOG_SELECTIVE);
    CHECK(c.model.sh_degree == 2);
    CHECK(strstr(c.decisions.data, "\"sh_degree\": {\"chosen\": \"2\", \"evidence\": \"as set\"}") != NULL);
    CHECK(strstr(c.decisions.data, "\"dog\": ") && strstr(c.decisions.data, "\"ucd\": ") &&
          strstr(c.decisions.data, "\"keep\": "));
    selection_test_case_free(&c);
}

/* A run stopped at each of these steps and resumed ends in the bytes of an uninterrupted one. Its decisions
 * are left. */
static void selection_test_check_stops(struct checkpoint_case *c, const int *stops, size_t count)
{
    oxl_model model;
    CHECK_OK(test_train(c->scene, &c->options, NULL, &c->whole));
    for (size_t i = 0; i < count; i++) {
        CHECK(checkpoint_run(c, "key", stops[i], &model) == OXL_ERR_INTERRUPTED);
        oxl_model_free(test_ctx, &model);
    }
    text_free(&c->decisions);
    CHECK_OK(checkpoint_run(c, "key", -1, &model));
    CHECK(train_same(&model, &c->whole) && model.lobes == c->whole.lobes);
    oxl_model_free(test_ctx, &model);
}

/* The trial of second lobes: stopped at any of its steps it is made again, and the decision and the bytes are
 * the same. */
TEST(selection_a_run_stopped_in_a_trial_ends_in_the_same_bytes)
{
    NEEDS_PART(lobes);
    static const int stops[] = {119, 120, 121, 126, 131, 132, 133, 137, 138, 139};
    struct checkpoint_case c = checkpoint_of(train_scene(14), train_options(240));
    c.options.dog = OXL_DOG_AUTO;
    c.options.sh_degree = -1;
    c.options.dog_threshold = -0.5f; /* half of them */
    selection_test_check_stops(&c, stops, OXL_COUNT(stops));
    CHECK(strstr(c.decisions.data, "\"dog\": {\"chosen\": ") && strstr(c.decisions.data, "without; "));
    checkpoint_case_free(&c);
}

TEST(selection_corrects_depth_weights_within_the_run_and_a_stopped_run_ends_in_the_same_bytes)
{
    NEEDS_PART(ucd);
    static const int stops[] = {60, 62, 64, 90, 119, 200};
    struct checkpoint_case c = checkpoint_of(train_scene(14), train_options(240));
    c.options.sh_degree = 0;
    c.options.densify_every = 3; /* 21 densifications from step 60 to 120 */
    c.options.densify_gradient = 8e-3f;
    c.options.ucd.mode = OXL_UCD_ON;
    c.options.ucd.learn = 1;
    selection_test_check_stops(&c, stops, OXL_COUNT(stops));
    CHECK(strstr(c.decisions.data, ", corrected by 2 pairs of costs\"") != NULL);
    CHECK(!strstr(c.decisions.data, "f_mid 1.50") || !strstr(c.decisions.data, "f_far 2.00"));
    checkpoint_case_free(&c);
}

/* Of nine views the fifth is the only one for validation. */
TEST(selection_decides_by_another_view_where_the_validation_view_is_damaged_or_masked)
{
    NEEDS_PART(sh_degree);
    oxl_job_options options = job_test_options();
    options.scene.test_every = 0;
    options.train.iterations = 3000;
    options.train.sh_degree = -1;
    options.train.lamp = options.train.medium = OXL_OFF;
    for (int k = 0; k < 2; k++) {
        const char *survey = job_test_survey(), *out = test_path(k ? "masked" : "damaged");
        struct os_file_map map = {0};
        oxl_image black = {0};
        CHECK(selection_is_validation_view(4, JOB_VIEWS) && !selection_is_validation_view(3, JOB_VIEWS));
        if (k == 0) { /* its header is whole */
            CHECK_OK(os_read_file(test_ctx, test_path("survey/images/4.png"), &map));
            CHECK_OK(os_write_file(test_ctx, test_path("survey/images/4.png"), map.data, map.size / 2));
            os_release_file(test_ctx, &map);
        } else {
            test_write("survey/masks/.keep", "");
            CHECK_OK(oxl_image_create(test_ctx, JOB_WIDTH, JOB_HEIGHT, &black));
            CHECK_OK(oxl_image_write(test_ctx, test_path("survey/masks/4.png"), &black));
            oxl_image_free(test_ctx, &black);
        }
        CHECK_OK(oxl_job_run(test_ctx, survey, out, &options, NULL));
        CHECK(job_test_has(PATH(out, "run.json"),
                           "\"evidence\": \"1 validation views, after 75 steps: degree"));
        CHECK(!job_test_has(PATH(out, "run.json"), "nan dB"));
        CHECK(job_test_has(PATH(out, "metrics.json"), "\"images_left_out\": 1"));
    }
}

/* The test view is in neither half. */
TEST(selection_holds_every_second_view_of_a_half)
{
    oxl_train_options o = train_options(100);
    oxl_scene *scene = train_scene(14);
    struct train t = {.ctx = test_ctx, .survey = scene, .scene = scene, .options = &o};
    CHECK_OK(selection_begin(&t));
    selection_hold(&t, 1);
    CHECK(t.views == 7 && t.validation_views == 6);
    CHECK(t.view[0] == 0 && t.view[1] == 2 && t.validation[0] == 1 && t.validation[1] == 4);
    while (t.validation_views > 0) t.view[t.views++] = t.validation[--t.validation_views];
    selection_hold(&t, 0);
    CHECK(t.views == 6 && t.validation_views == 7 && t.validation[0] == 0 && t.validation[1] == 2);
    train_end(&t);
    oxl_scene_free(test_ctx, scene);
}
