/* test_gradient.c - a step after the backward pass, or one that ends it. The gradient itself: test_reference.c. */
#include "test.h"
#include "wide.h"

enum { GRADIENT_WIDTH = 14, GRADIENT_HEIGHT = 11 };

static double gradient_random(uint64_t seed, uint64_t i, double low, double high)
{
    return low + (high - low) * random_unit(random_bits(seed, i, 0));
}

static oxl_camera gradient_camera(int width, int height, double focal)
{
    oxl_camera c = {.width = width,
                    .height = height,
                    .fx = focal,
                    .fy = focal * 1.1,
                    .cx = width * 0.45,
                    .cy = height * 0.52};
    camera_rotation_from_quaternion((double[4]){0.95, 0.1, -0.15, 0.2}, c.rotation);
    c.translation[0] = 0.1, c.translation[1] = -0.05, c.translation[2] = 3;
    return c;
}

/* Wide soft Gaussians: every pixel lies well inside every contour, below the clamp and far from the end of
 * its light, so the image is smooth in every parameter. Colours stay above 0. */
static void gradient_smooth_scene(struct wide *r, int count, int lobes, int degree)
{
    const oxl_camera camera = gradient_camera(GRADIENT_WIDTH, GRADIENT_HEIGHT, 12);
    wide_create(r, &camera, (size_t)count, (size_t)lobes, degree);
    for (int c = 0; c < 3; c++) r->background[c] = 0.2 + 0.2 * c;
    for (int i = 0; i < count; i++)
        for (int k = 0; k < OXL_SH + 3 * (degree + 1) * (degree + 1); k++) {
            const double u = gradient_random(5, (uint64_t)(i * OXL_LOBE + k), -1, 1);
            r->plane[k][i] = k < OXL_LOG_SCALE  ? 0.3 * u
                             : k < OXL_ROTATION ? 0.5 + 0.3 * u
                             : k < OXL_OPACITY  ? u + (k == OXL_ROTATION)
                             : k < OXL_SH       ? -1 + 0.5 * u
                             : k < OXL_SH + 3   ? 0.5 + 0.5 * u
                                                : 0.1 * u;
        }
}

static double gradient_weight(size_t i)
{
    return gradient_random(6, i, -1, 1);
}

/* The smooth scene with second lobes of about a third of the opacity, wider or narrower along each axis;
 * alpha stays positive. */
static void gradient_lobed_scene(struct wide *r, int count, int lobes, int degree)
{
    gradient_smooth_scene(r, count, lobes, degree);
    for (int i = 0; i < lobes; i++)
        for (int k = OXL_LOBE; k < OXL_PLANES; k++)
            r->plane[k][i] = (k == OXL_LOBE ? -1 : 0) + gradient_random(7, (uint64_t)(i * 4 + k), -0.3, 0.3);
}

static void gradient_to_model(const struct wide *r, oxl_model *m)
{
    *m = test_model(r->count, r->sh_degree);
    for (int k = 0; k < oxl_model_planes(m); k++)
        for (size_t i = 0; i < m->count; i++) m->plane[k][i] = (float)r->plane[k][i];
    CHECK_OK(model_set_lobes(test_ctx, m, r->lobes));
    for (int k = OXL_LOBE; k < OXL_PLANES; k++)
        for (size_t i = 0; i < m->lobes; i++) m->plane[k][i] = (float)r->plane[k][i];
}

TEST(a_step_moves_the_lobes_that_were_seen_and_nothing_past_them)
{
    const oxl_camera camera = gradient_camera(GRADIENT_WIDTH, GRADIENT_HEIGHT, 12);
    oxl_render_options options = oxl_render_options_default();
    float drgb[3 * GRADIENT_WIDTH * GRADIENT_HEIGHT];
    oxl_adam adam = {.beta = RENDERER_BETAS, .step = 1};
    OWNED_WIDE r = {0};
    OWNED_MODEL old = {0};
    struct trained_model m;
    struct renderer_nonfinite aside;
    gradient_lobed_scene(&r, 40, 19, 0);
    r.plane[OXL_MEAN + 2][3] = -50; /* out of view */
    gradient_to_model(&r, &m.model);
    gradient_to_model(&r, &old);
    for (size_t i = 0; i < OXL_COUNT(drgb); i++) drgb[i] = (float)gradient_weight(i);
    for (int k = 0; k < OXL_PLANES; k++) adam.rate[k] = k == OXL_LOBE ? 0.025f : 0.005f;
    CHECK_OK(model_trained_begin(test_ctx, &m));
    OWNED_MODEL gradient = test_model(40, 0);
    OWNED_RENDERER *renderer = test_renderer();
    CHECK_OK(renderer_forward(test_ctx, renderer, &m.model, &camera, &options));
    CHECK_OK(renderer_backward(test_ctx, renderer, drgb, &gradient));
    CHECK(gradient.lobes == 19);
    CHECK_OK(renderer_step(test_ctx, renderer, &m, &gradient, &adam, &aside));
    for (int k = OXL_LOBE; k < OXL_PLANES; k++) {
        for (int i = 0; i < 19; i++)
            CHECK_CLOSE(fabs(m.model.plane[k][i] - old.plane[k][i]), i == 3 ? 0 : adam.rate[k],
                        1e-4 * adam.rate[k]);
        for (int i = 19; i < 32; i++) CHECK(m.model.plane[k][i] == 0);
    }
    CHECK(m.model.plane[OXL_OPACITY][25] != old.plane[OXL_OPACITY][25]);
    model_trained_free(test_ctx, &m);
}

enum { GRADIENT_EARLY, GRADIENT_LATE, GRADIENT_PUBLIC, GRADIENT_WAYS };

/* The model after a step, whose gradient comes from the backward pass or from the step itself; or by
 * oxl_adam_step. */
static void gradient_stepped(const struct wide *r, int way, struct trained_model *m)
{
    const oxl_camera camera = gradient_camera(GRADIENT_WIDTH, GRADIENT_HEIGHT, 12);
    const oxl_render_options options = oxl_render_options_default();
    const struct medium murky = {.on = 1,
                                 .attenuation = {0.1f, 0.2f, 0.3f},
                                 .backscatter = {0.1f, 0.1f, 0.1f},
                                 .veiling_light = {0.2f, 0.3f, 0.4f}};
    float drgb[3 * GRADIENT_WIDTH * GRADIENT_HEIGHT];
    oxl_adam adam = {.beta = RENDERER_BETAS, .step = 1};
    oxl_model moments[2] = {{0}, {0}};
    struct renderer_nonfinite aside;
    gradient_to_model(r, &m->model);
    for (size_t i = 0; i < OXL_COUNT(drgb); i++) drgb[i] = (float)gradient_weight(i);
    for (int k = 0; k < OXL_PLANES; k++) adam.rate[k] = 0.005f;
    CHECK_OK(model_trained_begin(test_ctx, m));
    OWNED_MODEL gradient = test_model(40, 0);
    OWNED_RENDERER *renderer = test_renderer();
    renderer_settings(renderer)->medium = murky;
    CHECK_OK(renderer_forward(test_ctx, renderer, &m->model, &camera, &options));
    memset(gradient.plane[OXL_ROTATION], 0, 40 * sizeof(float));
    CHECK_OK(renderer_backward(test_ctx, renderer, drgb, way == GRADIENT_LATE ? NULL : &gradient));
    if (way == GRADIENT_PUBLIC) CHECK_OK(oxl_adam_step(test_ctx, &m->model, &gradient, moments, &adam));
    else CHECK_OK(renderer_step(test_ctx, renderer, m, way ? NULL : &gradient, &adam, &aside));
    oxl_model_free(test_ctx, &moments[0]);
    oxl_model_free(test_ctx, &moments[1]);
}

TEST(a_step_gives_the_same_bytes_whether_it_ends_the_backward_pass_or_a_loop_of_ones_own_makes_it)
{
    OWNED_WIDE r = {0};
    struct trained_model m[GRADIENT_WAYS];
    gradient_lobed_scene(&r, 40, 19, 0);
    for (int way = 0; way < GRADIENT_WAYS; way++) gradient_stepped(&r, way, &m[way]);
    for (int way = 1; way < GRADIENT_WAYS; way++)
        for (int k = 0; k < OXL_PLANES; k++)
            if (m[0].model.plane[k])
                CHECK(memcmp(m[0].model.plane[k], m[way].model.plane[k],
                             (k < OXL_LOBE ? 40 : 19) * sizeof(float)) == 0);
    CHECK(m[0].model.plane[OXL_MEAN][0] != (float)r.plane[OXL_MEAN][0]);
    for (int way = 0; way < GRADIENT_WAYS; way++) model_trained_free(test_ctx, &m[way]);
}
