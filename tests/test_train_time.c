/* test_train_time.c - timed steps before a run predict its time with uncertainty, and do not change the
 * run. */
#include "test.h"

TEST(predict_time_leaves_the_run_as_it_would_be)
{
    oxl_scene *scene = train_scene(5);
    oxl_train_options o = train_options(20);
    oxl_model before, after;
    double range[2] = {0};
    CHECK_OK(oxl_train(test_ctx, scene, &o, NULL, &before));
    CHECK(predict_time(test_ctx, scene, &o, 400, range) > 0);
    CHECK_OK(oxl_train(test_ctx, scene, &o, NULL, &after));
    CHECK(train_same(&before, &after));
    oxl_model_free(test_ctx, &before);
    oxl_model_free(test_ctx, &after);
    oxl_scene_free(test_ctx, scene);
}

TEST(predict_time_states_a_range_around_its_value_and_more_for_more_steps)
{
    oxl_scene *scene = train_scene(5);
    oxl_train_options o = train_options(20);
    double few[2], many[2];
    const double seconds = predict_time(test_ctx, scene, &o, 400, few);
    /* a busy machine makes some steps many times as long: more than 1e5 it does not */
    o.iterations = 2000000;
    CHECK(0 < few[0] && few[0] < seconds && seconds < few[1]);
    CHECK(predict_time(test_ctx, scene, &o, 400, many) > seconds && many[0] > few[0]);
    oxl_scene_free(test_ctx, scene);
}

/* Where steps cannot be timed, the result is 0 and the caller keeps its own range. */
TEST(predict_time_of_a_scene_without_points_is_not_stated)
{
    const oxl_view view = {"v.png", {32, 32, 50, 50, 16, 16, {1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 3}}, 0};
    oxl_train_options o = train_options(20);
    double range[2] = {1, 2};
    oxl_scene *scene = NULL;
    oxl_image image;
    CHECK_OK(oxl_image_create(test_ctx, 32, 32, &image));
    CHECK_OK(oxl_scene_from_arrays(test_ctx, &view, &image, 1, NULL, 0, &scene));
    CHECK(predict_time(test_ctx, scene, &o, 400, range) == 0 && range[0] == 1 && range[1] == 2);
    oxl_image_free(test_ctx, &image);
    oxl_scene_free(test_ctx, scene);
}

TEST(predict_time_expects_growth_up_to_the_cap)
{
    oxl_train_options o = oxl_train_options_default(OXL_PRESET_DRAFT), none = o;
    none.densify_until = none.densify_from;
    CHECK(predict_time_expected(&none, 1000, 1000000) < predict_time_expected(&o, 1000, 1000000));
    CHECK(predict_time_expected(&none, 1000, 1000000) >= 1000);
    CHECK(predict_time_expected(&o, 1000, 1100) == 1100 && predict_time_expected(&o, 1000, 10) == 10);
}

/* Each densification adds a share of the Gaussians that there are: twice as many densifications square the
 * factor. */
TEST(predict_time_expects_growth_in_proportion_to_what_has_grown)
{
    oxl_train_options once = oxl_train_options_default(OXL_PRESET_STANDARD), twice = once;
    once.iterations = twice.iterations = 800;
    once.densify_every = 400, twice.densify_every = 200;
    CHECK(schedule_densifications(&once) == 1 && schedule_densifications(&twice) == 2);
    CHECK_CLOSE(predict_time_expected(&twice, 1000, 1000000) * 1000,
                pow(predict_time_expected(&once, 1000, 1000000), 2), 1e-3);
}

/* The share of a run in which it has grown lies between none and all of it, and is more the sooner it is
 * full. */
TEST(predict_time_weighs_the_grown_model_by_when_the_run_has_grown)
{
    const oxl_train_options o = oxl_train_options_default(OXL_PRESET_DRAFT);
    const double early = predict_time_grown(&o, 1000, 1250), late = predict_time_grown(&o, 1000, 8000);
    CHECK(0 < late && late < early && early < 1);
    CHECK(predict_time_grown(&o, 1000, 1000) == 1);
}

TEST(predict_time_grows_a_model_beside_its_own_centres)
{
    static const oxl_point at[3] = {
        {.position = {0, 0, 0}}, {.position = {1, 0, 0}}, {.position = {0, 1, 0}}};
    oxl_model model, grown;
    CHECK_OK(oxl_model_from_points(test_ctx, at, 3, 1, &model));
    CHECK_OK(predict_time_grow(test_ctx, &model, 9, &grown));
    CHECK(grown.count == 9 && grown.sh_degree == 1);
    for (int i = 0; i < 9; i++)
        for (int a = 0; a < 3; a++)
            CHECK(grown.plane[OXL_MEAN + a][i] > -1.5f && grown.plane[OXL_MEAN + a][i] < 2.5f);
    oxl_model_free(test_ctx, &model);
    oxl_model_free(test_ctx, &grown);
}

TEST(survey_text_states_the_time_with_its_uncertainty)
{
    oxl_survey s = {.text = ""};
    survey_write_duration(&s, 240, (double[2]){180, 360});
    CHECK(!strcmp(s.text, "about 4 min (3 to 6)"));
    s.text[0] = 0;
    survey_write_duration(&s, 50, (double[2]){31, 80});
    CHECK(!strcmp(s.text, "about 50 s (31 to 80)"));
    s.text[0] = 0;
    survey_write_duration(&s, 7200, (double[2]){3600, 14400});
    CHECK(!strcmp(s.text, "about 2.0 h (1.0 to 4.0)"));
}
