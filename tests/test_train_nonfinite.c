/* test_train_nonfinite.c - nonfinite numbers planted in images, models and gradients do not spread. */
#include "test.h"

struct nonfinite_test_case {
    oxl_train_options options;
    oxl_model before;
    struct train t;
};

/* A run of which `steps` steps are done. */
static void nonfinite_test_begin(struct nonfinite_test_case *c, int steps)
{
    memset(c, 0, sizeof *c);
    test_listen();
    c->options = train_options(200);
    c->options.exposure = OXL_OFF; /* else the target is on the host, not in the renderer */
    c->t = (struct train){.ctx = test_ctx, .survey = train_scene(7), .options = &c->options};
    CHECK_OK(train_begin(&c->t));
    while (c->t.step < steps) {
        c->t.step++;
        CHECK_OK(train_step(&c->t));
    }
    CHECK_OK(model_copy(test_ctx, &c->t.trained.model, &c->before));
}

static void nonfinite_test_free(struct nonfinite_test_case *c)
{
    OWNED_SCENE *scene = (oxl_scene *)c->t.survey;
    (void)scene;
    train_end(&c->t);
    oxl_model_free(test_ctx, &c->before);
}

/* One step on view 2, whose image gets this value in one pixel. */
static void nonfinite_test_step_with_pixel(struct nonfinite_test_case *c, float value)
{
    c->t.step++;
    CHECK_OK(step_load_image(&c->t, 2));
    c->t.renderer->target[100] = value;
    CHECK_OK(step_on_view(&c->t, &(struct train_deferred){.step = c->t.step, .view = 2}, 0));
    CHECK_OK(train_density(&c->t));
}

static int nonfinite_test_model_is_finite(const oxl_model *m)
{
    int finite = 1;
    for (size_t i = 0; i < m->count; i++) finite &= model_row_is_finite(m, i);
    return finite;
}

TEST(nonfinite_pixel_skips_one_step_only)
{
    struct nonfinite_test_case c;
    /* the first step has nothing of an earlier one to fall back on */
    for (int steps = 0; steps < 2; steps++) {
        nonfinite_test_begin(&c, steps);
        nonfinite_test_step_with_pixel(&c, steps ? INFINITY : NAN);
        CHECK(test_same_model(&c.t.trained.model, &c.before));
        CHECK(c.t.nonfinite.steps == 1 && c.t.nonfinite.cleared == 0 && c.t.nonfinite.rows == 0);
        CHECK_WARNED(steps ? "step 2: the loss of v02.png is not finite" : "step 1: the loss of v02.png");
        c.t.step++;
        CHECK_OK(train_step(&c.t));
        CHECK(c.t.nonfinite.steps == 1 && nonfinite_test_model_is_finite(&c.t.trained.model) &&
              !test_same_model(&c.t.trained.model, &c.before));
        nonfinite_test_free(&c);
    }
}

TEST(nonfinite_gaussian_is_removed_and_the_others_are_trained)
{
    static const int planes[] = {OXL_SH + 1, OXL_OPACITY, OXL_MEAN, OXL_LOG_SCALE + 2, OXL_ROTATION + 3};
    for (size_t k = 0; k < OXL_COUNT(planes); k++) {
        struct nonfinite_test_case c;
        size_t bad = 0;
        nonfinite_test_begin(&c, 10);
        c.t.trained.model.plane[planes[k]][77] = k % 2 ? INFINITY : NAN;
        while (c.t.step < 25) {
            c.t.step++;
            CHECK_OK(train_step(&c.t));
        }
        CHECK(c.t.nonfinite.steps <= 1 && c.t.nonfinite.rows <= 15);
        if (k == 0)
            CHECK_WARNED("1 Gaussians have values that are not finite; their steps are skipped, 1 cleared");
        for (size_t i = 0; i < c.t.trained.model.count; i++)
            bad += !model_row_is_finite(&c.t.trained.model, i);
        /* one that no view can see harms none, and goes at the end */
        CHECK(bad == (c.t.nonfinite.cleared == 0));
        CHECK(c.t.trained.model.plane[OXL_MEAN][5] != c.before.plane[OXL_MEAN][5]);
        CHECK_OK(nonfinite_end(test_ctx, &c.t.nonfinite, &c.t.trained.model));
        CHECK(nonfinite_test_model_is_finite(&c.t.trained.model) && c.t.nonfinite.cleared == 1);
        nonfinite_test_free(&c);
    }
}

TEST(nonfinite_gradient_skips_the_step_of_that_gaussian_only)
{
    struct nonfinite_test_case c;
    struct renderer_nonfinite aside;
    struct renderer_loss loss;
    oxl_adam adam = {.beta = RENDERER_BETAS};
    nonfinite_test_begin(&c, 3);
    OWNED_MODEL gradient = test_model(c.t.trained.model.count, c.t.trained.model.sh_degree);
    for (int k = 0; k < OXL_PLANES; k++) adam.rate[k] = 0.01f;
    adam.step = ++c.t.step;
    CHECK_OK(step_load_image(&c.t, 2));
    CHECK_OK(renderer_forward(test_ctx, c.t.renderer, &c.t.trained.model,
                              &oxl_scene_view(c.t.scene, 2)->camera, &c.t.render));
    CHECK_OK(renderer_loss(test_ctx, c.t.renderer, NULL, NULL, 0.2f, &loss));
    CHECK_OK(renderer_backward(test_ctx, c.t.renderer, NULL, &gradient));
    gradient.plane[OXL_ROTATION + 1][40] = NAN;
    gradient.plane[OXL_SH + 2][41] = -INFINITY;
    CHECK_OK(renderer_step(test_ctx, c.t.renderer, &c.t.trained, &gradient, &adam, &aside));
    CHECK(aside.rows == 2 && !renderer_row_visible(c.t.renderer, 40) &&
          renderer_row_visible(c.t.renderer, 42));
    for (int k = 0; k < oxl_model_planes(&c.t.trained.model); k++)
        for (int i = 40; i < 42; i++) CHECK(c.t.trained.model.plane[k][i] == c.before.plane[k][i]);
    CHECK(c.t.trained.model.plane[OXL_SH][39] != c.before.plane[OXL_SH][39] &&
          c.t.trained.model.plane[OXL_SH][42] != c.before.plane[OXL_SH][42]);
    nonfinite_of_rows(test_ctx, &c.t.nonfinite, c.t.step, "v02.png", aside, &c.t.trained);
    CHECK_WARNED("step 4: v02.png: 2 Gaussians have values that are not finite; their steps are skipped, 0");
    CHECK(c.t.nonfinite.rows == 2 && c.t.nonfinite.cleared == 0 &&
          nonfinite_test_model_is_finite(&c.t.trained.model) &&
          nonfinite_test_model_is_finite(&c.t.trained.mean) &&
          nonfinite_test_model_is_finite(&c.t.trained.square));
    nonfinite_test_free(&c);
}

TEST(nonfinite_counts_are_logged_at_the_end_and_recorded)
{
    const oxl_nonfinite f = {1, 2, 3, 4};
    oxl_nonfinite back = f, end = f;
    test_listen();
    nonfinite_add(&back, &f);
    CHECK(back.images == 2 && back.cleared == 8);
    OWNED_MODEL m = test_model(3, 0);
    m.plane[OXL_SH][2] = NAN;
    CHECK_OK(nonfinite_end(test_ctx, &end, &m));
    CHECK(m.count == 2 && end.cleared == 5);
    CHECK_WARNED("not finite: 2 steps and 3 steps of single Gaussians skipped, 5 Gaussians cleared");
    CHECK_WARNED("1 images could not be read and were left out");
}
