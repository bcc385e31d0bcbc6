/* test_train_time.c - a run's Gaussians and time, before it begins and while it lasts. */
#include "test.h"

/* As many as in a run of 500 iterations, every 50; an interval that is given stays. */
TEST(schedule_densifies_three_times_in_short_runs)
{
    static const int runs[][3] = {
        /* iterations, interval, times */
        {150, -1, 3}, {200, -1, 3},   {250, -1, 3}, {300, -1, 3}, {400, -1, 3},
        {500, -1, 3}, {2000, -1, 11}, {300, 50, 2}, {60, -1, 2}}; /* the last: too few steps to tell more often than every 15 */
    oxl_train_options o = oxl_train_options_default(OXL_PRESET_DRAFT);
    CHECK(o.densify_every == -1);
    for (size_t i = 0; i < OXL_COUNT(runs); i++) {
        int times = 0;
        o.iterations = runs[i][0], o.densify_every = runs[i][1];
        for (int step = 1; step <= o.iterations; step++) times += schedule_densifies_at(&o, step);
        CHECK(times == runs[i][2]);
    }
    CHECK(oxl_train_options_default(OXL_PRESET_STANDARD).densify_every == 100);
    o.iterations = 9, o.survey_iterations = 40000; /* a block of few points */
    CHECK(!schedule_resets_opacity_at(&o, 3));
}

/* A strip, of which each view sees one point; every eighth view is held out. */
TEST(train_starts_from_all_points_that_training_views_see)
{
    enum { VIEWS = 512 };
    static oxl_view view[VIEWS];
    static oxl_point point[VIEWS];
    const oxl_scene scene = {.view = view, .view_count = VIEWS, .point = point, .point_count = VIEWS};
    OWNED_MEMORY oxl_point *some = NULL;
    size_t count;
    for (int v = 0; v < VIEWS; v++) {
        view[v] = (oxl_view){.camera = test_camera(8, 8, 8, 4 * v, 0, -2), .is_test = v % 8 == 0};
        point[v].position[0] = 4 * v;
    }
    CHECK_OK(train_some_points(test_ctx, &scene, VIEWS, &some, &count));
    CHECK(count == VIEWS / 8 * 7);
}

/* Drafts of caliterra at 640 px, subvo_pool at 1028 px and brighton_beach at 964 px; caliterra at 960 px and
 * lego at 800 px with `standard`, lego with 30 000 iterations (docs/log/SCALE.md). */
TEST(forecast_expects_what_was_measured_within_a_factor_of_2)
{
    static const struct {
        oxl_preset preset;
        int iterations;
        double start, cap, end;
    } runs[] = {{OXL_PRESET_DRAFT, 2000, 33911, 332106, 105828},
                {OXL_PRESET_DRAFT, 2000, 26658, 472194, 392596},
                {OXL_PRESET_DRAFT, 2000, 6444, 129899, 92592},
                {OXL_PRESET_STANDARD, 7000, 33882, 747760, 343495},
                {OXL_PRESET_STANDARD, 7000, 30000, 1066666, 171637},
                {OXL_PRESET_STANDARD, 30000, 30000, 1066666, 219728},
                {OXL_PRESET_DRAFT, 2000, 6444, 14320, 14313}};
    const oxl_camera camera = {.width = 320, .height = 200};
    for (size_t i = 0; i < OXL_COUNT(runs); i++) {
        oxl_train_options o = oxl_train_options_default(runs[i].preset);
        double gaussians = runs[i].start;
        o.iterations = runs[i].iterations;
        forecast_ahead(&o, 0, &camera, runs[i].cap, &gaussians);
        CHECK_CLOSE(log(gaussians / runs[i].end), 0, log(2.25));
    }
}

TEST(forecast_of_a_run_adds_up_its_steps_and_grows_to_the_limit)
{
    const oxl_camera camera = {.width = 100, .height = 60};
    oxl_train_options o = train_options(1000);
    double gaussians = 400, half = 1000 * forecast_step(&camera, 400, 1), grown = 400, rest = 400;
    o.densify_until = 0;
    CHECK_CLOSE(forecast_step(&camera, 400, 0), 400 + 0.2 * 6000, 1e-9);
    CHECK_CLOSE(forecast_ahead(&o, 0, &camera, 1e6, &gaussians), 1000 * 1600.0, 1e-3);
    CHECK_CLOSE(forecast_ahead(&o, 900, &camera, 1e6, &gaussians), 100 * 1600.0, 1e-3);
    CHECK(gaussians == 400);
    o.coarse = 1;
    CHECK_CLOSE(forecast_ahead(&o, 0, &camera, 1e6, &gaussians), half, 1e-3);
    o = train_options(1000);
    o.densify_until = 0.5f, o.densify_every = 50;
    CHECK(forecast_ahead(&o, 0, &camera, 1e6, &grown) > 1.2 * 1600e3 && grown > 800);
    forecast_ahead(&o, 300, &camera, 1e6, &rest); /* the first densifications, which add the most, are done */
    CHECK(rest > 400 && rest < grown / 1.5);
    forecast_ahead(&o, 0, &camera, 1000, &gaussians);
    CHECK(gaussians == 1000);
    forecast_ahead(&o, 0, &camera, 10, &gaussians); /* it does not shrink */
    CHECK(gaussians == 1000);
}

/* Steps that are timed are of the survey's points, or of random ones; ten times the steps take ten times as
 * long, but for what the machine does beside. */
TEST(cost_of_time_follows_the_steps_up_to_the_time_limit)
{
    OWNED_SCENE *scene = train_scene(5);
    oxl_job_options o = oxl_job_options_default(OXL_PRESET_DRAFT);
    double few, many;
    o.train = train_options(100);
    CHECK_OK(cost_seconds(test_ctx, scene, &o, &few));
    o.train.iterations = 100000;
    CHECK_OK(cost_seconds(test_ctx, scene, &o, &many));
    CHECK(few > 0 && many > 10 * few);
    o.train.max_seconds = 1e-9;
    CHECK_OK(cost_seconds(test_ctx, scene, &o, &many));
    CHECK(many == 1e-9);
}

struct time_left {
    double first, last;
    int calls;
};

static int time_left_note(void *user, const oxl_progress *p)
{
    struct time_left *l = user;
    if (p->iteration == p->iterations / 5) l->first = p->seconds_left;
    l->last = p->seconds_left;
    l->calls++;
    return 0;
}

/* Without views to evaluate nothing is left after the last step; a fifth into the run something is. */
TEST(time_left_falls_to_zero_at_the_last_step)
{
    OWNED_SCENE *scene = train_scene(5);
    const oxl_train_options o = train_options(60);
    struct time_left l = {0};
    const oxl_callback callback = {time_left_note, &l};
    OWNED_MODEL model = {0};
    CHECK_OK(test_train(scene, &o, &callback, &model));
    CHECK(l.calls == 60 && l.first > 0 && l.last == 0);
}

/* Judging a training view takes about as long as a step, so a short run judges a few. */
TEST(cost_judges_a_training_view_for_twenty_iterations)
{
    OWNED_SCENE *scene = train_scene(14);
    const int training = schedule_training_views(scene), held = oxl_scene_view_count(scene) - training;
    CHECK(training > 8 && cost_judged_views(scene, 1) == 6 && cost_judged_views(scene, 160) == 8);
    CHECK(cost_judged_views(scene, 20 * training) == training);
    CHECK(cost_judged_views(scene, 30000) == training && cost_evaluation_steps(scene, 160) == 3 * held + 8);
    for (int i = 0; i < training + held; i++) scene->view[i].is_test = 0;
    CHECK(cost_evaluation_steps(scene, 160) == 3 * (training + held)); /* which the metrics are of then */
}
