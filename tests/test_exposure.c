/* test_exposure.c - when the tracks show that images need gains. */
#include "test.h"
#include "../src/parts/exposure.h"

/* Gains of the tracks of 8 views: a slow wave, and what jumps from view to view. */
static int exposure_test_takes(double wave, double jump, double unexplained, int parts, int is_tried)
{
    struct exposure e = {.mode = OXL_AUTO, .is_tried = is_tried, .of = imaging_test_make(8, NULL, 0)};
    struct photometry p = {.points = 100,
                           .observations = 900,
                           .parts = parts,
                           .unexplained = unexplained,
                           .residual = 0.01,
                           .brightness = 0.5};
    float gain[24];
    uint8_t fitted[8] = {7, 7, 7, 7, 7, 7, 7, 7};
    char why[400];
    int on;
    for (int i = 0; i < 24; i++) gain[i] = (float)(wave * cos(0.8 * (i / 3)) + (i / 3 % 2 ? jump : -jump));
    p.log_gain = gain, p.fitted = fitted;
    exposure_set_from_tracks(&e, &p, why, sizeof why);
    on = e.of.on;
    imaging_free(test_ctx, &e.of);
    return on;
}

/* The neighbours of the wave predict it to 0.031; what they explain must be 1.5 times 0.02, what the tracks'
 * colours leave. */
TEST(exposure_auto_is_on_where_neighbours_predict_gains_better_than_other_views_of_a_place_do)
{
    CHECK(exposure_test_takes(0.1, 0, 0.045, PHOTOMETRY_GAINS, 0));
    CHECK(!exposure_test_takes(0.1, 0, 0.045, PHOTOMETRY_LAMP, 0));
    CHECK(!exposure_test_takes(0.1, 0, 0.042, PHOTOMETRY_GAINS, 0));
    CHECK(exposure_test_takes(0.02, 0, 0.032, PHOTOMETRY_GAINS, 0));
    CHECK(!exposure_test_takes(0.02, 0, 0.029, PHOTOMETRY_GAINS, 0));
    CHECK(!exposure_test_takes(0.02, 0.04, 0.07, PHOTOMETRY_GAINS, 0));
}

/* ---------------- the trial */

/* A wave, or what no neighbour tells. */
static double exposure_test_gain(int view, int jumps)
{
    return jumps ? (view % 2 ? -0.3 : 0.3) : 0.3 * cos(0.8 * view);
}

/* A scene whose images are brighter and darker by these gains. */
static oxl_scene *exposure_test_scene(int jumps)
{
    oxl_scene *scene = train_scene(14), *waved = NULL;
    oxl_view view[14];
    oxl_image image[14];
    for (int v = 0; v < 14; v++) {
        view[v] = *oxl_scene_view(scene, v);
        CHECK_OK(oxl_scene_image(test_ctx, scene, v, NULL, &image[v]));
        for (int i = 0; i < 3 * image[v].width * image[v].height; i++)
            image[v].rgb[i] = (float)(0.6 * exp(exposure_test_gain(v, jumps)) * (double)image[v].rgb[i]);
    }
    CHECK_OK(oxl_scene_from_arrays(test_ctx, view, image, 14, oxl_scene_points(scene),
                                   oxl_scene_point_count(scene), &waved));
    for (int v = 0; v < 14; v++) oxl_image_free(test_ctx, &image[v]);
    oxl_scene_free(test_ctx, scene);
    return waved;
}

struct exposure_test_run {
    oxl_train_options options;
    struct train t;
    struct exposure *e;
};

/* Begins a run as if tracks had given these parts of the true gains; the trial is due. */
static void exposure_test_begin(struct exposure_test_run *r, double part, int jumps)
{
    r->options = train_options(1000);
    r->t = (struct train){.ctx = test_ctx,
                          .survey = exposure_test_scene(jumps),
                          .options = &r->options,
                          .decisions = {.ctx = test_ctx}};
    CHECK_OK(train_begin(&r->t));
    for (int k = 0; parts_at(k); k++) {
        if (strcmp(parts_at(k)->name, "exposure") != 0) continue;
        r->e = r->t.part[k];
        r->t.trial = 1;
    }
    r->e->of.on = 1;
    r->e->known_until = 2; /* the tracks' gains stay */
    for (int v = 0; v < 14; v++) {
        r->e->of.known[v] = (uint8_t)!oxl_scene_view(r->t.scene, v)->is_test;
        for (int c = 0; c < 3; c++)
            r->e->of.log_gain[3 * v + c] = (float)(part * exposure_test_gain(v, jumps));
    }
}

static void exposure_test_end(struct exposure_test_run *r)
{
    OWNED_SCENE *scene = (oxl_scene *)r->t.survey;
    train_end(&r->t);
}

/* True gains are kept, with what the run began with; reversed ones, and those of which the others tell
 * nothing, are refused. */
TEST(exposure_trial_keeps_gains_that_predict_the_other_half_of_the_views)
{
    NEEDS_PART(exposure);
    for (int k = 0; k < 3; k++) {
        struct exposure_test_run r = {0};
        oxl_model first;
        exposure_test_begin(&r, k == 1 ? -1 : 1, k == 2);
        CHECK_OK(model_copy(test_ctx, &r.t.trained.model, &first));
        CHECK_OK(selection_trial(&r.t));
        CHECK(r.e->of.on == !k && r.e->of.known[0] == !k && !r.t.trial && r.t.step == 0);
        CHECK(train_same(&r.t.trained.model, &first));
        CHECK(r.t.views == 13 && r.t.options == &r.options);
        CHECK(strstr(r.t.decisions.data,
                     k ? "\"exposure\": {\"chosen\": \"off\"" : "\"exposure\": {\"chosen\": \"on\"") != NULL);
        CHECK(strstr(r.t.decisions.data, k ? "13 of 13 training views" : "7 of 13 training views") != NULL);
        oxl_model_free(test_ctx, &first);
        exposure_test_end(&r);
    }
}

/* Trials of surveys that gain nothing have 0.26 dB at most, those of others 0.36 or more. */
TEST(exposure_trial_wants_a_gain_beyond_that_of_surveys_without)
{
    CHECK(exposure_is_worth(20, 20.36) && !exposure_is_worth(20, 20.26) && !exposure_is_worth(NAN, NAN));
}

static int exposure_test_stop(void *user, const oxl_progress *progress)
{
    int *left = user;
    CHECK(progress->trial);
    return --*left == 0;
}

/* It is made again from the start. */
TEST(exposure_trial_that_is_stopped_leaves_the_run_as_it_was)
{
    NEEDS_PART(exposure);
    struct exposure_test_run r = {0};
    int left = 500; /* in the second half */
    const oxl_callback stop = {exposure_test_stop, &left};
    oxl_model first;
    exposure_test_begin(&r, 1, 1);
    r.t.callback = &stop;
    CHECK_OK(model_copy(test_ctx, &r.t.trained.model, &first));
    CHECK(selection_trial(&r.t) == OXL_ERR_INTERRUPTED);
    CHECK(r.t.trial && r.t.step == 0 && r.t.views == 13);
    CHECK(r.t.options == &r.options && r.e->of.on && r.e->of.known[1] &&
          train_same(&r.t.trained.model, &first));
    left = 10000;
    CHECK_OK(selection_trial(&r.t));
    CHECK(left == 10000 - 800 && !r.e->of.on);
    oxl_model_free(test_ctx, &first);
    exposure_test_end(&r);
}

/* Surveys whose tracks refuse gains have none; where they do not, a trial decides. */
TEST(exposure_needs_less_of_the_tracks_where_a_trial_follows)
{
    NEEDS_PART(exposure);
    CHECK(!exposure_test_takes(0.1, 0, 0.042, PHOTOMETRY_GAINS, 0));
    CHECK(exposure_test_takes(0.1, 0, 0.042, PHOTOMETRY_GAINS, 1));
    CHECK(!exposure_test_takes(0.1, 0, 0.036, PHOTOMETRY_GAINS, 1));
}

/* Whether the tracks' gains, which neighbours explain 1.2 times the noise of, ask for a trial. */
static int exposure_test_tries(const oxl_train_options *o, const oxl_model *from)
{
    struct exposure_test_run r = {0};
    struct photometry p = {.points = 100,
                           .observations = 900,
                           .parts = PHOTOMETRY_GAINS,
                           .unexplained = 0.16,
                           .residual = 0.06,
                           .brightness = 0.5};
    float gain[42];
    uint8_t fitted[14];
    int tries;
    exposure_test_begin(&r, 1, 0);
    for (int i = 0; i < 42; i++) gain[i] = (float)exposure_test_gain(i / 3, 0);
    memset(fitted, 7, sizeof fitted);
    p.log_gain = gain, p.fitted = fitted;
    r.t.trial = 0;
    r.options = *o, r.t.task.from = from;
    for (int k = 0; parts_at(k); k++)
        if (r.t.part[k] == r.e) parts_at(k)->use_tracks(&r.t, r.e, &p);
    tries = r.t.trial;
    CHECK(r.e->of.on == tries);
    exposure_test_end(&r);
    return tries;
}

TEST(exposure_is_tried_where_the_run_has_time_views_and_memory_for_it)
{
    NEEDS_PART(exposure);
    oxl_train_options o = train_options(1000);
    const oxl_model from = {0};
    CHECK(exposure_test_tries(&o, NULL) && !exposure_test_tries(&o, &from));
    o.iterations = 999;
    CHECK(!exposure_test_tries(&o, NULL));
    o.iterations = 1000, o.max_seconds = 60;
    CHECK(!exposure_test_tries(&o, NULL));
    o.max_seconds = 0, o.sh_degree = 0;
    CHECK(!exposure_test_tries(&o, NULL));
}
