/* test_train_time.c - a first look predicts a run's Gaussians and time, and does not change the run; the time
 * left. */
#include "test.h"

TEST(look_leaves_the_run_as_it_would_be)
{
    oxl_scene *scene = train_scene(5);
    oxl_train_options o = train_options(20);
    struct look look, again;
    oxl_model before, after;
    CHECK_OK(test_train(scene, &o, NULL, &before));
    CHECK_OK(look_take(test_ctx, scene, &o, INT_MAX, &look));
    CHECK(look.steps == 32 && look.views == 4 && look.seconds > 0 && look.gaussians == 144);
    CHECK_OK(test_train(scene, &o, NULL, &after));
    CHECK(train_same(&before, &after));
    CHECK_OK(look_take(test_ctx, scene, &o, INT_MAX, &again));
    CHECK(look.share == again.share && look.share > 0 && look.share <= 1);
    oxl_model_free(test_ctx, &before);
    oxl_model_free(test_ctx, &after);
    oxl_scene_free(test_ctx, scene);
}

TEST(look_takes_a_tenth_of_the_run_at_least_30_steps_and_times_12)
{
    static const int runs[][2] = {
        {20, 32}, {500, 62}, {1500, 162}, {7000, 323}, {30000, 612}}; /* iterations, steps */
    oxl_scene *scene = train_scene(5);
    for (size_t i = 0; i < sizeof runs / sizeof runs[0]; i++) {
        oxl_train_options o = train_options(runs[i][0]);
        struct look look;
        o.max_gaussians = 100000;
        CHECK_OK(look_take(test_ctx, scene, &o, INT_MAX, &look));
        CHECK(look.steps == runs[i][1]);
    }
    oxl_scene_free(test_ctx, scene);
}

TEST(look_times_a_few_steps_where_even_slow_growth_ends_at_the_limit)
{
    static const int runs[][2] = {{300, 30}, {1500, 60}}; /* iterations, steps */
    oxl_scene *scene = train_scene(5);
    oxl_train_options o;
    struct look look;
    for (size_t i = 0; i < sizeof runs / sizeof runs[0]; i++) {
        o = train_options(runs[i][0]);
        o.max_gaussians = 200; /* of 144 */
        CHECK_OK(look_take(test_ctx, scene, &o, INT_MAX, &look));
        CHECK(look.steps == runs[i][1] && look.share == 0 && look.seconds > 0);
        CHECK(forecast_gaussians(&o, look.gaussians, look.share, 200) == 200);
    }
    o.densify_gradient = 0.01f; /* nobody has seen how slowly it grows then */
    CHECK_OK(look_take(test_ctx, scene, &o, INT_MAX, &look));
    CHECK(look.steps == 162 && look.share > 0);
    oxl_scene_free(test_ctx, scene);
}

/* The threshold is what a gradient is compared with. */
TEST(look_finds_fewer_to_split_above_a_larger_threshold)
{
    oxl_scene *scene = train_scene(5);
    oxl_train_options o = train_options(20);
    struct look few, many;
    o.densify_gradient = 1e-7f;
    CHECK_OK(look_take(test_ctx, scene, &o, INT_MAX, &many));
    o.densify_gradient = 1e3f;
    CHECK_OK(look_take(test_ctx, scene, &o, INT_MAX, &few));
    CHECK(many.share > 0.5 && few.share < 0.01);
    oxl_scene_free(test_ctx, scene);
}

/* Memory holds no more, also where a look would split more. */
TEST(look_keeps_to_the_gaussians_that_memory_holds)
{
    oxl_scene *scene = train_scene(5);
    oxl_train_options o = train_options(50);
    struct look free_look, held;
    o.densify_every = 50;
    o.densify_gradient = 1e-7f;
    CHECK_OK(look_take(test_ctx, scene, &o, INT_MAX, &free_look));
    CHECK_OK(look_take(test_ctx, scene, &o, 150, &held));
    CHECK(free_look.gaussians == 144 && free_look.timed > 200);
    CHECK(held.gaussians == 144 && held.timed <= 150);
    oxl_scene_free(test_ctx, scene);
}

/* Gains are not in scene.ply, so a model without them is refined behind the run, and takes time. */
TEST(look_says_whether_viewers_get_a_model_of_their_own)
{
    NEEDS_PART(exposure);
    oxl_scene *scene = train_scene(5);
    oxl_train_options o = train_options(20);
    struct look without, with;
    o.exposure = OXL_OFF, o.lamp = OXL_OFF, o.medium = OXL_OFF;
    CHECK_OK(look_take(test_ctx, scene, &o, INT_MAX, &without));
    o.exposure = OXL_ON;
    CHECK_OK(look_take(test_ctx, scene, &o, INT_MAX, &with));
    CHECK(!without.hides && with.hides);
    with.share = 1e-12, with.begin = 0, with.timed = with.gaussians;
    without = with, without.hides = 0;
    CHECK_CLOSE(forecast_seconds(scene, &o, &with, 400, 8, 100) -
                    forecast_seconds(scene, &o, &without, 400, 8, 100),
                100 * with.seconds, 1e-6);
    oxl_scene_free(test_ctx, scene);
}

/* A run that no look was taken of tells how it ends, after the first densification or half of the run; one
 * that is resumed does so, too. */
TEST(run_without_a_look_tells_its_own_growth)
{
    oxl_scene *scene = train_scene(5);
    for (int grows = 0; grows < 2; grows++) {
        oxl_train_options o = train_options(40);
        struct look grown = {0}, resumed = {0};
        struct train_task task = {.grown = &grown}, rest = {.grown = &resumed, .first = 20};
        oxl_model model, end;
        o.densify_gradient = 1e-7f, o.densify_from = 0.25f, o.densify_until = 0.25f; /* once, at step 10 */
        o.densify_every = grows ? 10 : 1000;
        CHECK_OK(train_run(test_ctx, scene, &o, NULL, &task, &model));
        CHECK(grown.steps == (grows ? 10 : 20) && (model.count > 144) == grows);
        CHECK(grown.gaussians == (double)model.count && !grown.hides);
        rest.start = &model;
        CHECK_OK(train_run(test_ctx, scene, &o, NULL, &rest, &end));
        CHECK(resumed.steps == 10 && resumed.gaussians == (double)end.count);
        oxl_model_free(test_ctx, &model);
        oxl_model_free(test_ctx, &end);
    }
    oxl_scene_free(test_ctx, scene);
}

/* As many as in a run of 500 iterations, every 50; an interval that is given stays. */
TEST(schedule_densifies_three_times_in_short_runs)
{
    static const int runs[][2] = {{150, 3}, {200, 3}, {250, 3}, {300, 3}, {400, 3}, {500, 3}, {2000, 11}};
    oxl_train_options o = oxl_train_options_default(OXL_PRESET_DRAFT);
    CHECK(o.densify_every == -1);
    for (size_t i = 0; i < OXL_COUNT(runs); i++) {
        o.iterations = runs[i][0];
        CHECK(schedule_densifications(&o) == runs[i][1]);
    }
    o.iterations = 300, o.densify_every = 50;
    CHECK(schedule_densifications(&o) == 2);
    o.iterations = 60, o.densify_every = -1; /* too few steps to tell more often than every 15 */
    CHECK(schedule_densifications(&o) == 2);
    o = oxl_train_options_default(OXL_PRESET_STANDARD);
    CHECK(o.densify_every == 100);
}

/* What hinders a look is said where it hinders the run. */
TEST(look_at_a_scene_without_training_views_is_none)
{
    const oxl_view view = {"v.png", {32, 32, 50, 50, 16, 16, {1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 3}}, 1};
    oxl_train_options o = train_options(20);
    oxl_scene *scene = NULL;
    struct look look = {.steps = 1};
    oxl_image image;
    CHECK_OK(oxl_image_create(test_ctx, 32, 32, &image));
    CHECK_OK(oxl_scene_from_arrays(test_ctx, &view, &image, 1, NULL, 0, &scene));
    CHECK_OK(look_take(test_ctx, scene, &o, INT_MAX, &look));
    CHECK(look.steps == 0 && look.share == 0 && look.seconds == 0);
    oxl_image_free(test_ctx, &image);
    oxl_scene_free(test_ctx, scene);
}

TEST(forecast_expects_more_of_a_larger_share_up_to_the_cap)
{
    oxl_train_options o = oxl_train_options_default(OXL_PRESET_DRAFT), none = o;
    none.densify_until = none.densify_from;
    CHECK_CLOSE(forecast_gaussians(&none, 1000, 0.3, 1e6), 1000, 1e-6);
    CHECK(forecast_gaussians(&o, 1000, 0.3, 1e6) > 2 * forecast_gaussians(&o, 1000, 0.05, 1e6));
    CHECK(forecast_gaussians(&o, 1000, 0, 1e6) > 1000);
    CHECK(forecast_gaussians(&o, 1000, 0.3, 1100) == 1100 && forecast_gaussians(&o, 1000, 0.3, 10) == 1000);
    CHECK_CLOSE(forecast_gaussians(&o, 2000, 0.3, 1e6), 2 * forecast_gaussians(&o, 1000, 0.3, 1e6), 1e-6);
}

/* caliterra at 640 px, subvo_pool at 1028 px and brighton_beach at 964 px as drafts, caliterra at 960 px and
 * lego at 800 px with `standard`, lego with 30 000 iterations: share and Gaussians as measured
 * (docs/log/FORECAST.md). */
TEST(forecast_expects_what_was_measured)
{
    const oxl_train_options draft = oxl_train_options_default(OXL_PRESET_DRAFT),
                            standard = oxl_train_options_default(OXL_PRESET_STANDARD);
    oxl_train_options longer = standard;
    longer.iterations = 30000;
    CHECK_CLOSE(log(forecast_gaussians(&standard, 33882, 0.253, 747760) / 343495), 0, log(1.5));
    CHECK_CLOSE(log(forecast_gaussians(&standard, 30000, 0.140, 1066666) / 171637), 0, log(1.5));
    CHECK_CLOSE(log(forecast_gaussians(&longer, 30000, 0.139, 1066666) / 219728), 0, log(1.5));
    CHECK_CLOSE(log(forecast_gaussians(&draft, 33911, 0.228, 332106) / 105828), 0, log(1.5));
    CHECK_CLOSE(log(forecast_gaussians(&draft, 26658, 0.465, 472194) / 392596), 0, log(1.5));
    CHECK_CLOSE(log(forecast_gaussians(&draft, 6444, 0.402, 129899) / 92592), 0, log(1.5));
}

/* A second of each step: a run of twice the steps takes twice as long, one that grows more takes longer. */
TEST(forecast_of_time_counts_steps_growth_and_what_follows_them)
{
    oxl_scene *scene = train_scene(5);
    oxl_train_options o = train_options(1000);
    struct look look = {.gaussians = 400, .seconds = 1, .timed = 400, .steps = 100, .views = 4};
    double plain, grown;
    look.share = 1e-12;
    o.densify_until = o.densify_from = 0;
    plain = forecast_seconds(scene, &o, &look, 400, 8, 100);
    CHECK_CLOSE(plain, 1000 + 8 + 1.3 * forecast_trial_steps(&o, schedule_training_views(scene)), 1);
    o.iterations = 2000;
    CHECK(forecast_seconds(scene, &o, &look, 400, 8, 100) > 1.9 * plain);
    o = train_options(1000);
    o.densify_until = 0.5f, o.densify_every = 50;
    look.share = 0.5;
    grown = forecast_seconds(scene, &o, &look, 1e6, 8, 100);
    CHECK(grown > 1.5 * plain);
    oxl_scene_free(test_ctx, scene);
}

/* Half into a run steps still are those of half the sides, also where trials take them. */
TEST(forecast_of_time_has_trials_at_half_the_sides)
{
    NEEDS_PART(sh_degree);
    oxl_scene *scene = train_scene(12);
    oxl_train_options o = train_options(3000);
    struct look look = {.gaussians = 400, .seconds = 1, .timed = 400, .share = 1e-12};
    const oxl_camera *c = &oxl_scene_view(scene, 0)->camera;
    const double pixels = 0.2 * c->width * c->height, half = 0.64 * (pixels / 4 + 400) / (pixels + 400);
    double trials;
    o.coarse = 0.75f;
    o.sh_degree = -1;
    trials = 1.3 * forecast_trial_steps(&o, schedule_training_views(scene));
    CHECK(trials > 90);
    CHECK_CLOSE(forecast_seconds(scene, &o, &look, 400, 8, 0), 750 + half * (2250 + trials) + 8, 1);
    oxl_scene_free(test_ctx, scene);
}

/* Rendering a view takes as long as a step, which a device shortens; metrics and files take what they take. */
TEST(forecast_of_time_has_the_seconds_of_evaluation_that_no_step_shortens)
{
    oxl_scene *scene = train_scene(5);
    oxl_train_options o = train_options(100);
    oxl_job_options job = oxl_job_options_default(OXL_PRESET_DRAFT);
    struct look look = {.gaussians = 400, .seconds = 1, .timed = 400, .share = 1e-12}, after = look;
    const double a_view = cost_evaluation(scene, &job);
    after.after = 10;
    CHECK_CLOSE(forecast_seconds(scene, &o, &after, 400, 8, 0),
                10 + 8 + forecast_seconds(scene, &o, &look, 400, 0, 0), 1e-6);
    CHECK(a_view > 0.03);
    oxl_scene_free(test_ctx, scene);
}

/* Before one was timed, a densification is told to take 1.7 us of each Gaussian. */
TEST(forecast_counts_densifications_before_one_was_timed)
{
    const oxl_train_options o = train_options(2000);
    oxl_scene *scene = train_scene(5);
    const struct look look = {.gaussians = 400, .timed = 400, .share = 1e-12};
    CHECK(schedule_densifications(&o) > 5);
    CHECK_CLOSE(forecast_seconds(scene, &o, &look, 400, 0, 0), 1.7e-6 * 400 * schedule_densifications(&o),
                1e-6);
    oxl_scene_free(test_ctx, scene);
}

/* Between the steps of two trials views are validated, which takes far longer than a step. */
TEST(time_left_does_not_count_what_lies_between_trials_as_a_step)
{
    const oxl_train_options o = train_options(1000);
    oxl_scene *scene = train_scene(5);
    struct train t = {
        .ctx = test_ctx, .scene = scene, .options = &o, .trained.model.count = 100, .forecast.at = -1};
    static const int steps[][3] = {{500, 0, 0}, {501, 0, 1}, {501, 1, 0}, {502, 1, 1}, {501, 1, 0},
                                   {502, 1, 1}, {503, 0, 0}, {504, 0, 1}}; /* step, of a trial, counted */
    for (size_t i = 0; i < sizeof steps / sizeof steps[0]; i++) {
        const double before = t.forecast.seconds;
        t.step = steps[i][0], t.is_trial = steps[i][1];
        if (i > 0) t.forecast.at = os_seconds() - 1;
        forecast_note_step(&t);
        CHECK((t.forecast.seconds > 0.9 * before + 0.9) == steps[i][2]);
    }
    oxl_scene_free(test_ctx, scene);
}

/* A checkpoint and a densification take as long as many steps on a device: neither is one. */
TEST(time_left_counts_checkpoints_and_densifications_apart_from_steps)
{
    oxl_train_options o = train_options(2000);
    oxl_scene *scene = train_scene(5);
    const oxl_camera *c = &oxl_scene_view(scene, 0)->camera;
    const double pixels = 0.2 * c->width * c->height;
    struct train t = {
        .ctx = test_ctx, .scene = scene, .options = &o, .trained.model.count = 100, .step = 600};
    CHECK(!schedule_densifies_at(&o, 601) && schedule_densifies_at(&o, 650));
    t.forecast.mark = 2 * 600;
    for (t.step = 601; t.step <= 650; t.step++) {
        t.forecast.at = os_seconds() - (t.step == 650 ? 8 : 1);
        if (t.step == 620) t.forecast.at -= 100, forecast_note_save(&t, 100);
        if (t.step == 650) t.trained.model.count = 150;
        forecast_note_step(&t);
    }
    CHECK_CLOSE(t.forecast.seconds / t.forecast.work, 1 / (pixels + 100), 1e-6);
    CHECK(t.forecast.save_seconds == 100 && t.forecast.densified == 1);
    CHECK_CLOSE(100 * t.forecast.density_seconds, 8 - (pixels + 150) / (pixels + 100), 0.01);
    CHECK_CLOSE(t.forecast.growth, log(1.5), 1e-6);
    oxl_scene_free(test_ctx, scene);
}

struct time_left {
    double first, last;
    int calls, trials;
};

static int time_left_note(void *user, const oxl_progress *p)
{
    struct time_left *l = user;
    if (p->iteration == p->iterations / 5) l->first = p->seconds_left;
    l->last = p->seconds_left;
    l->calls++;
    l->trials += p->trial;
    return 0;
}

/* Without views to evaluate nothing is left after the last step; a fifth into the run something is. */
TEST(time_left_falls_to_zero_at_the_last_step)
{
    oxl_scene *scene = train_scene(5);
    const oxl_train_options o = train_options(60);
    struct time_left l = {0};
    const oxl_callback callback = {time_left_note, &l};
    oxl_model model;
    CHECK_OK(test_train(scene, &o, &callback, &model));
    CHECK(l.calls == 60 && l.first > 0 && l.last == 0);
    oxl_model_free(test_ctx, &model);
    oxl_scene_free(test_ctx, scene);
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
/* Judging a training view takes about as long as a step, so a short run judges a few. */
TEST(cost_judges_a_training_view_for_twenty_iterations)
{
    oxl_scene *scene = train_scene(14);
    const int training = schedule_training_views(scene), held = oxl_scene_view_count(scene) - training;
    CHECK(training > 8);
    CHECK(cost_judged_views(scene, 1) == 6 && cost_judged_views(scene, 160) == 8);
    CHECK(cost_judged_views(scene, 20 * training) == training);
    CHECK(cost_judged_views(scene, 30000) == training);
    CHECK(cost_evaluated_views(scene, 160) == held + 8);
    for (int i = 0; i < training + held; i++) scene->view[i].is_test = 0;
    CHECK(cost_evaluated_views(scene, 160) == training + held); /* which the metrics are of then */
    oxl_scene_free(test_ctx, scene);
}
