/* test_gradient.c - the kernels' gradient against finite differences, from their source in double, and float
 * against double. */
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

static double gradient_loss(struct wide *r)
{
    double sum = 0;
    kernels_forward(r);
    for (size_t i = 0; i < 3 * (size_t)r->camera.width * (size_t)r->camera.height; i++)
        sum += gradient_weight(i) * r->rgb[i];
    return sum;
}

static void gradient_analytic(struct wide *r)
{
    const size_t values = 3 * (size_t)r->camera.width * (size_t)r->camera.height;
    double *drgb = wide_array(values);
    for (size_t i = 0; i < values; i++) drgb[i] = gradient_weight(i);
    gradient_loss(r);
    kernels_backward(r, drgb);
    free(drgb);
}

/* Worst |finite - analytic| / largest |analytic| of the planes first..end-1, central differences of fourth
 * order. */
static double gradient_worst(struct wide *r, int first, int end)
{
    const double h = 1e-3;
    double worst = 0, scale = 0;
    for (int k = first; k < end; k++)
        for (size_t i = 0; i < r->count; i++) {
            double *x = &r->plane[k][i], was = *x, f[4];
            for (int n = 0; n < 4; n++) {
                *x = was + h * (n < 2 ? n - 2 : n - 1);
                f[n] = gradient_loss(r);
            }
            *x = was;
            worst = OXL_MAX(worst, fabs((f[0] - 8 * f[1] + 8 * f[2] - f[3]) / (12 * h) - r->gradient[k][i]));
            scale = OXL_MAX(scale, fabs(r->gradient[k][i]));
        }
    return worst / scale;
}

TEST(gradient_agrees_with_finite_differences_for_every_parameter_type)
{
    OWNED_WIDE r = {0};
    gradient_smooth_scene(&r, 6, 0, 3);
    gradient_analytic(&r);
    CHECK(kernels_forward(&r) == 6);
    CHECK(gradient_worst(&r, OXL_MEAN, OXL_LOG_SCALE) < 1e-8);
    CHECK(gradient_worst(&r, OXL_LOG_SCALE, OXL_ROTATION) < 1e-8);
    CHECK(gradient_worst(&r, OXL_ROTATION, OXL_OPACITY) < 1e-8);
    CHECK(gradient_worst(&r, OXL_OPACITY, OXL_SH) < 1e-8);
    CHECK(gradient_worst(&r, OXL_SH, OXL_SH + 3) < 1e-8);
    CHECK(gradient_worst(&r, OXL_SH + 3, OXL_LOBE) < 1e-8);
}

TEST(gradient_is_exact_where_the_frustum_clamp_holds)
{
    OWNED_WIDE r = {0};
    gradient_smooth_scene(&r, 4, 0, 1);
    r.camera.fx = r.camera.fy = 600; /* all of them lie outside */
    gradient_analytic(&r);
    CHECK(gradient_worst(&r, OXL_MEAN, OXL_SH) < 1e-8);
}

TEST(gradient_stops_at_the_opacity_clamp_and_at_black)
{
    OWNED_WIDE r = {0};
    gradient_smooth_scene(&r, 1, 0, 0);
    r.plane[OXL_OPACITY][0] = 12; /* alpha is 0.99 near the centre */
    for (int a = 0; a < 3; a++) r.plane[OXL_LOG_SCALE + a][0] = 5, r.plane[OXL_SH + a][0] = a == 1 ? -9 : 1;
    gradient_analytic(&r);
    CHECK(r.gradient[OXL_OPACITY][0] == 0);
    CHECK(r.gradient[OXL_MEAN][0] == 0);
    CHECK(r.gradient[OXL_SH + 1][0] == 0);
    CHECK(r.gradient[OXL_SH][0] != 0);
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

TEST(gradient_of_lobes_agrees_with_finite_differences_for_every_parameter_type)
{
    OWNED_WIDE r = {0};
    gradient_lobed_scene(&r, 6, 4, 1);
    gradient_analytic(&r);
    CHECK(kernels_forward(&r) == 6);
    CHECK(gradient_worst(&r, OXL_MEAN, OXL_LOG_SCALE) < 1e-8);
    CHECK(gradient_worst(&r, OXL_LOG_SCALE, OXL_ROTATION) < 1e-8);
    CHECK(gradient_worst(&r, OXL_ROTATION, OXL_OPACITY) < 1e-8);
    CHECK(gradient_worst(&r, OXL_OPACITY, OXL_SH) < 1e-8);
    CHECK(gradient_worst(&r, OXL_SH, OXL_SH + 12) < 1e-8);
    CHECK(gradient_worst(&r, OXL_LOBE, OXL_LOBE + 1) < 1e-8);
    CHECK(gradient_worst(&r, OXL_LOBE + 1, OXL_PLANES) < 1e-8);
    for (int k = OXL_LOBE; k < OXL_PLANES; k++) CHECK(r.gradient[k][4] == 0 && r.gradient[k][5] == 0);
}

/* Narrow Gaussians beside the image, with second lobes that reach over all of it: alpha is negative in every
 * pixel, T grows. */
TEST(gradient_is_exact_where_alpha_is_negative)
{
    OWNED_WIDE r = {0};
    double least = 1e9;
    gradient_lobed_scene(&r, 5, 3, 0);
    for (int i = 0; i < 3; i++) {
        r.plane[OXL_MEAN][i] = 4 + 0.1 * i;
        r.plane[OXL_OPACITY][i] = 1;
        r.plane[OXL_LOBE][i] = 2;
        for (int a = 0; a < 3; a++)
            r.plane[OXL_LOG_SCALE + a][i] = -2, r.plane[OXL_LOBE + 1 + a][i] = 3.3 + 0.1 * a;
    }
    for (int i = 3; i < 5; i++) r.plane[OXL_OPACITY][i] = -3; /* so that the negative ones show */
    gradient_analytic(&r);
    for (int i = 0; i < GRADIENT_WIDTH * GRADIENT_HEIGHT; i++) least = OXL_MIN(least, r.transmittance[i]);
    CHECK(kernels_forward(&r) == 5 && least > 1);
    CHECK(gradient_worst(&r, OXL_MEAN, OXL_LOG_SCALE) < 1e-6);
    CHECK(gradient_worst(&r, OXL_LOG_SCALE, OXL_ROTATION) < 1e-6);
    CHECK(gradient_worst(&r, OXL_OPACITY, OXL_SH) < 1e-6);
    CHECK(gradient_worst(&r, OXL_SH, OXL_SH + 3) < 1e-6);
    CHECK(gradient_worst(&r, OXL_LOBE, OXL_LOBE + 1) < 1e-6);
    CHECK(gradient_worst(&r, OXL_LOBE + 1, OXL_PLANES) < 1e-6);
}

/* ---------------- float against double */

/* 300 ordinary Gaussians of all shapes on 70 x 50 pixels: many contours cut through many pixels. */
static void gradient_ordinary_scene(struct wide *r, int count, int degree)
{
    const oxl_camera camera = gradient_camera(70, 50, 60);
    wide_create(r, &camera, (size_t)count, 0, degree);
    for (int i = 0; i < count; i++)
        for (int k = 0; k < OXL_SH + 3 * (degree + 1) * (degree + 1); k++) {
            const double u = gradient_random(15, (uint64_t)(i * OXL_LOBE + k), -1, 1);
            r->plane[k][i] = (float)(k < OXL_LOG_SCALE  ? 1.5 * u
                                     : k < OXL_ROTATION ? -2.5 + u
                                     : k < OXL_OPACITY  ? u
                                     : k < OXL_SH       ? 2 * u
                                     : k < OXL_SH + 3   ? u
                                                        : 0.3 * u);
        }
}

static void gradient_to_model(const struct wide *r, oxl_model *m)
{
    CHECK_OK(oxl_model_create(test_ctx, r->count, r->sh_degree, m));
    for (int k = 0; k < oxl_model_planes(m); k++)
        for (size_t i = 0; i < m->count; i++) m->plane[k][i] = (float)r->plane[k][i];
    CHECK_OK(model_set_lobes(test_ctx, m, r->lobes));
    for (int k = OXL_LOBE; k < OXL_PLANES; k++)
        for (size_t i = 0; i < m->lobes; i++) m->plane[k][i] = (float)r->plane[k][i];
}

/* A decision (alpha >= 1/255, T >= 1e-4) that falls the other way in float changes a pixel by up to 1/255;
 * everything else differs by rounding alone, a few 1e-7 a splat. So at most one pixel in 500 may differ by
 * more than 1e-5, none by more than 1/255. */
TEST(float_image_agrees_with_double_but_for_rounding)
{
    const oxl_camera camera = gradient_camera(70, 50, 60);
    OWNED_WIDE r = {0};
    OWNED_MODEL m = {0};
    OWNED_IMAGE image = {0};
    int off = 0;
    gradient_ordinary_scene(&r, 300, 2);
    kernels_forward(&r);
    gradient_to_model(&r, &m);
    CHECK_OK(oxl_render(test_ctx, &m, &camera, NULL, &image, NULL));
    for (int i = 0; i < 3 * 70 * 50; i++) {
        const double difference = fabs(image.rgb[i] - r.rgb[i]);
        off += difference > 1e-5;
        CHECK(difference <= 1.0 / 255);
    }
    CHECK(off <= 3 * 70 * 50 / 500);
}

TEST(float_gradient_agrees_with_double_within_1e_4_of_the_largest)
{
    const oxl_camera camera = gradient_camera(GRADIENT_WIDTH, GRADIENT_HEIGHT, 12);
    oxl_render_options options = oxl_render_options_default();
    OWNED_WIDE r = {0};
    OWNED_MODEL m = {0}, gradient = {0};
    float drgb[3 * GRADIENT_WIDTH * GRADIENT_HEIGHT];
    gradient_lobed_scene(&r, 40, 19, 3);
    gradient_analytic(&r);
    gradient_to_model(&r, &m);
    for (size_t i = 0; i < OXL_COUNT(drgb); i++) drgb[i] = (float)gradient_weight(i);
    for (int c = 0; c < 3; c++) options.background[c] = (float)r.background[c];
    CHECK_OK(oxl_render_backward(test_ctx, &m, &camera, &options, drgb, &gradient));
    for (int k = 0; k < OXL_PLANES; k++) {
        double worst = 0, scale = 1e-30;
        for (size_t i = 0; i < (k < OXL_LOBE ? m.count : m.lobes); i++) {
            worst = OXL_MAX(worst, fabs(gradient.plane[k][i] - r.gradient[k][i]));
            scale = OXL_MAX(scale, fabs(r.gradient[k][i]));
        }
        CHECK_CLOSE(worst / scale, 0, 1e-4);
    }
}

TEST(a_step_moves_the_lobes_that_were_seen_and_nothing_past_them)
{
    const oxl_camera camera = gradient_camera(GRADIENT_WIDTH, GRADIENT_HEIGHT, 12);
    oxl_render_options options = oxl_render_options_default();
    float drgb[3 * GRADIENT_WIDTH * GRADIENT_HEIGHT];
    oxl_adam adam = {.beta = RENDERER_BETAS, .step = 1};
    OWNED_WIDE r = {0};
    OWNED_MODEL gradient = {0}, old = {0};
    struct trained_model m;
    struct renderer_nonfinite aside;
    gradient_lobed_scene(&r, 40, 19, 0);
    r.plane[OXL_MEAN + 2][3] = -50; /* out of view */
    gradient_to_model(&r, &m.model);
    gradient_to_model(&r, &old);
    for (size_t i = 0; i < OXL_COUNT(drgb); i++) drgb[i] = (float)gradient_weight(i);
    for (int k = 0; k < OXL_PLANES; k++) adam.rate[k] = k == OXL_LOBE ? 0.025f : 0.005f;
    CHECK_OK(model_trained_begin(test_ctx, &m));
    CHECK_OK(oxl_model_create(test_ctx, 40, 0, &gradient));
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
    OWNED_MODEL gradient = {0};
    oxl_model moments[2] = {{0}, {0}};
    struct renderer_nonfinite aside;
    gradient_to_model(r, &m->model);
    for (size_t i = 0; i < OXL_COUNT(drgb); i++) drgb[i] = (float)gradient_weight(i);
    for (int k = 0; k < OXL_PLANES; k++) adam.rate[k] = 0.005f;
    CHECK_OK(model_trained_begin(test_ctx, m));
    CHECK_OK(oxl_model_create(test_ctx, 40, 0, &gradient));
    OWNED_RENDERER *renderer = test_renderer();
    renderer_set_medium(renderer, &murky);
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
