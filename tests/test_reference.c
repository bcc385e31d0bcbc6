/* test_reference.c - the kernels against reference/splat.c, an independent implementation in double: image,
 * loss, every gradient, the optimizer's step and the decisions of density control.
 *
 * Pixels where a threshold is so near that float may decide the other way (splat_fragile) are not compared,
 * and get no gradient.
 * Errors are shares of the largest value of a plane. Bounds are about four times what was measured.
 */
#include "test.h"
#include "wide.h"

/* ---------------- scenes */

struct reference_scene {
    const char *what;
    void (*make)(struct wide *w, double value); /* changes the mixed scene; NULL: as it is */
    double value;
    int width, height, count, lobes, degree;
};

/* bounds: of images, in full white or the largest value (measured at most 1.8e-6); */
#define REFERENCE_IMAGE 8e-6
#define REFERENCE_GRADIENT 2e-4 /* of gradients, see reference_gradient_error (measured at most 4.3e-5) */

static double reference_random(size_t i, size_t k)
{
    return wide_random(41, i, k);
}

/* Planes first..end-1: value and up to spread more or less. */
static void reference_fill(struct wide *w, int first, int end, double value, double spread)
{
    for (int k = first; k < end; k++)
        for (size_t i = 0; i < w->count; i++)
            w->plane[k][i] = value + spread * reference_random(i, (size_t)k + 100);
}

/* log_scale */
static void reference_size(struct wide *w, double log_scale)
{
    reference_fill(w, OXL_LOG_SCALE, OXL_ROTATION, log_scale, 0.3);
}

/* Needles and plates: one axis, or one of the others, is so much thinner. */
static void reference_thin(struct wide *w, double ratio)
{
    for (size_t i = 0; i < w->count; i++)
        for (int a = 0; a < 3; a++)
            w->plane[OXL_LOG_SCALE + a][i] = (i % 3 == (size_t)a) == i % 2 ? -log(ratio) : -0.5;
}

static void reference_opacity(struct wide *w, double logit)
{
    reference_fill(w, OXL_OPACITY, OXL_SH, logit, 0.2);
}

/* Some behind the camera, some on either side of its near plane; small, or they would fill the image. */
static void reference_near(struct wide *w, double spread)
{
    const double *r = w->camera.rotation, *t = w->camera.translation;
    reference_size(w, -4);
    for (size_t i = 0; i < w->count; i++) {
        const double z = w->near_plane + spread * reference_random(i, 7),
                     q[3] = {0.3 * w->plane[0][i] * z, 0.3 * w->plane[1][i] * z, z};
        for (int a = 0; a < 3; a++)
            w->plane[a][i] = r[a] * (q[0] - t[0]) + r[3 + a] * (q[1] - t[1]) + r[6 + a] * (q[2] - t[2]);
    }
}

/* Centres far to the side, past the clamp of the Jacobian, and so wide that they reach into the image. */
static void reference_aside(struct wide *w, double slope)
{
    wide_look_ahead(w);
    reference_size(w, log(slope) + 0.3);
    for (size_t i = 0; i < w->count; i++)
        w->plane[OXL_MEAN + i % 2][i] += (i % 4 < 2 ? 3.2 : -3.2) * slope * (i % 2 ? 0.7 : 1);
}

/* Second lobes that take away more than is there, around each centre: alpha is negative, T grows past 16. */
static void reference_dark(struct wide *w, double log_factor)
{
    for (size_t i = 0; i < w->lobes; i++) {
        w->plane[OXL_MEAN][i] *= 0.1, w->plane[OXL_MEAN + 1][i] *= 0.1;
    }
    wide_fill(w, OXL_LOBE, OXL_LOBE + 1, 4);
    wide_fill(w, OXL_LOBE + 1, OXL_PLANES, log_factor);
    reference_opacity(w, 1.5);
}

/* Gaussians of less than a pixel in second lobes that reach over much of the image. */
static void reference_dots(struct wide *w, double log_scale)
{
    reference_size(w, log_scale);
    wide_fill(w, OXL_LOBE + 1, OXL_PLANES, -1.5 - log_scale);
}

static void reference_colour(struct wide *w, double mean)
{
    reference_fill(w, OXL_SH, OXL_SH + 3, mean, 1);
}

static void reference_quaternion(struct wide *w, double length)
{
    wide_multiply(w, OXL_ROTATION, OXL_OPACITY, length);
}

/* One behind the other, most of them never seen: pixels end. */
static void reference_layers(struct wide *w, double logit)
{
    reference_size(w, -0.5);
    reference_opacity(w, logit);
}

static const struct reference_scene REFERENCE_SCENES[] = {
    /* what, make, value, width, height, count, lobes, degree */
    {"mixed, degree 0", NULL, 0, 64, 48, 200, 0, 0},
    {"mixed, degree 1", NULL, 0, 61, 47, 200, 0, 1},
    {"mixed, degree 2", NULL, 0, 64, 48, 200, 0, 2},
    {"mixed, degree 3", NULL, 0, 33, 70, 200, 0, 3},
    {"every second with a second lobe", NULL, 0, 64, 48, 200, 100, 1},
    {"all with a second lobe", NULL, 0, 50, 40, 200, 200, 3},
    {"one pixel", NULL, 0, 1, 1, 100, 50, 1},
    {"a column of pixels", NULL, 0, 1, 90, 100, 50, 1},
    {"a row of pixels", NULL, 0, 90, 1, 100, 50, 1},
    {"tiny", reference_size, -9, 64, 48, 200, 50, 1},
    {"huge", reference_size, 4, 64, 48, 60, 20, 1},
    {"needles and plates", reference_thin, 1e4, 64, 48, 100, 30, 1},
    {"opaque", reference_opacity, 12, 64, 48, 100, 30, 1},
    {"about as faint as can be seen", reference_opacity, -5.5, 64, 48, 200, 30, 1},
    {"at the near plane", reference_near, 0.1, 64, 48, 200, 50, 2},
    {"past the clamp of the Jacobian", reference_aside, 1.5, 64, 48, 60, 20, 1},
    {"alpha is negative", reference_dark, 0.6, 64, 48, 60, 40, 0},
    {"dots in discs", reference_dots, -6, 64, 48, 100, 60, 0},
    {"colours about black", reference_colour, -1.7, 64, 48, 200, 0, 2},
    {"long quaternions", reference_quaternion, 1e6, 64, 48, 100, 0, 0},
    {"short quaternions", reference_quaternion, 1e-6, 64, 48, 100, 30, 0},
    {"pixels that end", reference_layers, 1, 64, 48, 200, 60, 1},
};

/* What the float kernels will read is what the reference reads. */
static void reference_make(const struct reference_scene *e, int antialias, struct wide *w)
{
    wide_mixed(w, e->width, e->height, e->count, e->lobes, e->degree);
    if (e->make) e->make(w, e->value);
    w->antialias = antialias;
    wide_to_float(w);
}

/* ---------------- reference/splat.c itself */

static double reference_weight(size_t i)
{
    return reference_random(i, 1000);
}

static double reference_dot(struct wide *w)
{
    double sum = 0;
    splat_forward(w);
    for (size_t i = 0; i < 3 * (size_t)w->camera.width * w->camera.height; i++)
        sum += reference_weight(i) * w->rgb[i];
    return sum;
}

/* Central differences of fourth order, for every parameter. */
static void reference_check_differences(struct wide *w, double bound)
{
    const size_t values = 3 * (size_t)w->camera.width * w->camera.height;
    double *drgb = wide_array(values);
    for (size_t i = 0; i < values; i++) drgb[i] = reference_weight(i);
    splat_forward(w);
    for (size_t i = 0; i < w->count; i++) CHECK(w->inside[i] > 0);
    splat_backward(w, drgb);
    for (int k = 0; k < OXL_PLANES; k++) {
        double worst = 0, largest = 0;
        for (size_t i = 0; i < wide_rows(w, k); i++) {
            const double h = 1e-3;
            double *x = &w->plane[k][i], was = *x, f[4];
            for (int n = 0; n < 4; n++) *x = was + h * (n < 2 ? n - 2 : n - 1), f[n] = reference_dot(w);
            *x = was;
            worst = OXL_MAX(worst, fabs((f[0] - 8 * f[1] + 8 * f[2] - f[3]) / (12 * h) - w->gradient[k][i]));
            largest = OXL_MAX(largest, fabs(w->gradient[k][i]));
        }
        CHECK_CLOSE(worst, 0, bound * largest);
    }
    free(drgb);
}

TEST(reference_gradients_agree_with_finite_differences)
{
    OWNED_WIDE w = {0};
    wide_smooth(&w, 6, 4, 3, 12, 0.3);
    for (w.antialias = 0; w.antialias < 2; w.antialias++) reference_check_differences(&w, 1e-7);
}

/* A field of view so narrow that most centres lie past the clamp of the Jacobian. */
TEST(reference_gradients_are_exact_where_the_jacobian_is_clamped)
{
    OWNED_WIDE w = {0};
    wide_smooth(&w, 5, 2, 1, 150, 1.5);
    reference_check_differences(&w, 1e-6);
}

/* ---------------- images and gradients */

/* A scene, rendered and differentiated by splat.c (w); what the kernels make of it is put into `got`. */
struct reference_case {
    struct wide w, got;
    oxl_model m;
    oxl_render_options options;
    char *fragile; /* (H,W) */
    float *drgb;   /* (3,H,W) dL/d(image): 0 in fragile pixels */
    size_t solid;  /* pixels that are not */
};

static void reference_open(const struct reference_scene *e, int antialias, struct reference_case *c)
{
    const size_t pixels = (size_t)e->width * e->height;
    double *wide = wide_array(3 * pixels);
    c->fragile = wide_array(pixels);
    c->drgb = wide_array(3 * pixels);
    c->options = oxl_render_options_default();
    c->solid = 0;
    reference_make(e, antialias, &c->w);
    reference_make(e, antialias, &c->got);
    CHECK_OK(wide_to_model(test_ctx, &c->w, &c->m));
    for (int ch = 0; ch < 3; ch++) c->options.background[ch] = (float)c->w.background[ch];
    c->options.near_plane = (float)c->w.near_plane;
    splat_fragile(&c->w, c->fragile);
    for (size_t i = 0; i < pixels; i++) c->solid += !c->fragile[i];
    for (size_t i = 0; i < 3 * pixels; i++)
        wide[i] = c->drgb[i] = c->fragile[i % pixels] ? 0 : (float)reference_weight(i);
    splat_forward(&c->w);
    splat_backward(&c->w, wide);
    free(wide);
}

static void reference_close(struct reference_case *c)
{
    wide_free(&c->w), wide_free(&c->got);
    oxl_model_free(test_ctx, &c->m);
    free(c->fragile), free(c->drgb);
}

/* Not a number counts. */
static void reference_raise(double *most, double value)
{
    if (!(value <= *most)) *most = value;
}

/* The largest difference of the images outside of fragile pixels, as a share of the largest value, or of 1. */
static double reference_image_error(const struct reference_case *c)
{
    const int n = c->w.camera.width * c->w.camera.height;
    double worst = 0, largest = 1;
    for (int i = 0; i < 3 * n; i++) {
        if (!c->fragile[i % n]) reference_raise(&worst, fabs(c->got.rgb[i] - c->w.rgb[i]));
        largest = OXL_MAX(largest, fabs(c->w.rgb[i]));
    }
    return worst / largest;
}

/* The largest difference of a plane as a share of its largest value, or of `least` of the largest of all: below
 * a hundredth of that float's noise shows. */
static double reference_gradient_error(const struct reference_case *c, double least)
{
    double worst[OXL_PLANES] = {0}, largest[OXL_PLANES] = {0}, all = 1e-30, error = 0;
    for (int k = 0; k < OXL_PLANES; k++)
        for (size_t i = 0; i < wide_rows(&c->w, k); i++) {
            const double wanted = c->w.gradient[k][i];
            reference_raise(&worst[k], fabs(c->got.gradient[k][i] - wanted));
            largest[k] = OXL_MAX(largest[k], fabs(wanted));
            all = OXL_MAX(all, largest[k]);
        }
    for (int k = 0; k < OXL_PLANES; k++)
        reference_raise(&error, worst[k] / OXL_MAX(largest[k], OXL_MAX(1e-30, least * all)));
    return error;
}

/* What the float kernels draw and derive. */
static void reference_run_float(struct reference_case *c, struct renderer *r)
{
    const size_t values = 3 * (size_t)c->w.camera.width * c->w.camera.height;
    const float *rgb;
    OWNED_MODEL gradient;
    wide_fill(&c->got, 0, OXL_PLANES, 0); /* rows out of view are not written */
    CHECK_OK(wide_to_model(test_ctx, &c->got, &gradient));
    CHECK_OK(renderer_forward(test_ctx, r, &c->m, &c->w.camera, &c->options));
    CHECK_OK(renderer_image(r, &rgb));
    for (size_t i = 0; i < values; i++) c->got.rgb[i] = rgb[i];
    CHECK_OK(renderer_backward(test_ctx, r, c->drgb, &gradient));
    for (int k = 0; k < OXL_PLANES; k++)
        for (size_t i = 0; i < wide_rows(&c->w, k); i++) c->got.gradient[k][i] = gradient.plane[k][i];
}

/* What density control and the step of rows in view go by. A row whose box ends within 0.1 px of the
 * outermost pixel centres may be either: the kernels' boxes are a little wider than the contour. */
static void reference_check_rows(const struct reference_case *c, struct renderer *r)
{
    double worst = 0, largest = 1e-30;
    int other = 0;
    for (size_t i = 0; i < c->w.count; i++) {
        const double length = renderer_row_visible(r, i) ? renderer_mean_gradient(r, i) : 0;
        other += fabs(c->w.inside[i]) > 0.1 && renderer_row_visible(r, i) != (c->w.inside[i] > 0);
        worst = OXL_MAX(worst, fabs(length - c->w.dmean2d[i]));
        largest = OXL_MAX(largest, c->w.dmean2d[i]);
    }
    CHECK(other == 0);
    CHECK_CLOSE(worst / largest, 0, REFERENCE_GRADIENT);
}

TEST(reference_image_rows_in_view_and_every_gradient_agree_on_all_kinds_of_scenes)
{
    for (size_t n = 0; n < 2 * OXL_COUNT(REFERENCE_SCENES); n++) {
        const struct reference_scene *e = &REFERENCE_SCENES[n / 2];
        OWNED_RENDERER *r = test_renderer();
        struct reference_case c;
        test_case = e->what;
        reference_open(e, n % 2, &c);
        reference_run_float(&c, r);
        CHECK_CLOSE(reference_image_error(&c), 0, REFERENCE_IMAGE);
        CHECK_CLOSE(reference_gradient_error(&c, 0.01), 0, REFERENCE_GRADIENT);
        CHECK(2 * c.solid > (size_t)(e->width * e->height));
        reference_check_rows(&c, r);
        reference_close(&c);
    }
}

/* The kernels' source in double has the same formulas to the last digits, needles and all. */
TEST(reference_agrees_with_the_kernels_in_double)
{
    for (size_t n = 0; n < 2 * OXL_COUNT(REFERENCE_SCENES); n++) {
        const struct reference_scene *e = &REFERENCE_SCENES[n / 2];
        const size_t values = 3 * (size_t)e->width * e->height;
        double *drgb = wide_array(values);
        struct reference_case c;
        reference_open(e, n % 2, &c);
        for (size_t i = 0; i < values; i++) drgb[i] = c.drgb[i];
        kernels_backward(&c.got, drgb);
        CHECK_CLOSE(reference_image_error(&c), 0, 1e-9);
        CHECK_CLOSE(reference_gradient_error(&c, 0), 0, 1e-7);
        free(drgb);
        reference_close(&c);
    }
}

static void reference_half_unturned(struct wide *w, double w_of_quaternion)
{
    for (int k = OXL_ROTATION; k < OXL_OPACITY; k++)
        for (size_t i = 0; i < w->count; i += 2) w->plane[k][i] = k == OXL_ROTATION ? w_of_quaternion : 0;
}

/* Half of them shorter than a float's inverse can say, which counts as unturned; the other half just long
 * enough. */
TEST(reference_rotations_of_the_shortest_quaternions_agree)
{
    const struct reference_scene scene = {"", reference_half_unturned, 1, 64, 48, 100, 0, 0};
    OWNED_RENDERER *r = test_renderer();
    struct reference_case c;
    reference_open(&scene, 0, &c);
    for (size_t i = 0; i < c.w.count; i++) {
        double longest = 0;
        for (int k = OXL_ROTATION; k < OXL_OPACITY; k++) longest = OXL_MAX(longest, fabs(c.w.plane[k][i]));
        for (int k = OXL_ROTATION; k < OXL_OPACITY; k++)
            c.m.plane[k][i] = (float)(i % 2 ? 1.3e-38 * c.w.plane[k][i] / longest
                                            : 1.1e-38 * reference_random(i, (size_t)k));
    }
    reference_run_float(&c, r);
    CHECK_CLOSE(reference_image_error(&c), 0, REFERENCE_IMAGE);
    reference_close(&c);
}

/* ---------------- the loss */

static void reference_check_loss(int width, int height, double contrast, float weight)
{
    const size_t n = 3 * (size_t)width * height;
    double *x = wide_array(n), *y = wide_array(n), *dx = wide_array(n), worst = 0, largest = 0;
    float *narrow = calloc(3 * n, sizeof *narrow);
    struct loss_job job = {width, height, weight, narrow, narrow + n, NULL, narrow + 2 * n, 0};
    struct loss_scratch scratch = {0};
    struct renderer_loss out;
    if (!narrow) abort();
    for (size_t i = 0; i < n; i++) {
        x[i] = narrow[i] = (float)(0.3 + 0.3 * contrast * reference_random(i, 50));
        y[i] = narrow[n + i] = (float)(x[i] + 0.2 * contrast * reference_random(i, 51));
    }
    double value = splat_loss(width, height, weight, x, y, dx);
    CHECK_OK(loss_forward_backward(test_ctx, &job, &scratch, &out));
    CHECK_CLOSE(out.total, value, 2e-6);
    for (size_t i = 0; i < n; i++) {
        worst = OXL_MAX(worst, fabs(narrow[2 * n + i] - dx[i]));
        largest = OXL_MAX(largest, fabs(dx[i]));
    }
    CHECK_CLOSE(worst, 0, 1e-4 * largest);
    loss_free(test_ctx, &scratch);
    free(x), free(y), free(dx), free(narrow);
}

TEST(reference_loss_and_its_gradient_agree)
{
    static const int size[][2] = {{64, 48}, {37, 29}, {1, 1}, {1, 40}, {40, 1}, {11, 11}, {130, 9}};
    for (size_t i = 0; i < OXL_COUNT(size); i++) {
        reference_check_loss(size[i][0], size[i][1], 1, 0.2f);
        reference_check_loss(size[i][0], size[i][1], 0.1, 0.2f); /* where the constants of SSIM count */
        reference_check_loss(size[i][0], size[i][1], 1, 0);
        reference_check_loss(size[i][0], size[i][1], 1, 1);
    }
}

/* ---------------- the optimizer */

/* Through the renderer, as in a run: its bias corrections too. Gradients from 1e-16, where Adam's epsilon
 * counts, to 1. */
TEST(reference_steps_of_adam_agree)
{
    enum { STEPS = 60 };
    const struct reference_scene scene = {"", NULL, 0, 64, 48, 60, 20, 0};
    oxl_adam adam = {.beta = RENDERER_BETAS};
    struct renderer_nonfinite aside;
    OWNED_RENDERER *r = test_renderer();
    struct reference_case c;
    OWNED_MODEL gradient;
    struct trained_model t;
    double **x = c.w.plane, **mean = c.got.plane, **square = c.got.gradient;
    reference_open(&scene, 0, &c);
    wide_fill(&c.got, 0, OXL_PLANES, 0);
    CHECK_OK(wide_to_model(test_ctx, &c.w, &gradient));
    CHECK_OK(wide_to_model(test_ctx, &c.w, &t.model));
    CHECK_OK(model_trained_begin(test_ctx, &t));
    CHECK_OK(renderer_forward(test_ctx, r, &t.model, &c.w.camera, &c.options));
    for (int k = 0; k < OXL_PLANES; k++) adam.rate[k] = (float)splat_learning_rate(k, 3, 0.5);
    for (adam.step = 1; adam.step <= STEPS; adam.step++) {
        for (int k = 0; k < OXL_PLANES; k++)
            for (size_t i = 0; i < wide_rows(&c.w, k); i++) {
                const double g = 0.3 + reference_random(i, (size_t)(k + 100 * adam.step));
                gradient.plane[k][i] = (float)(i % 2 ? g : g * exp(-(double)(i % 37)));
                if (renderer_row_visible(r, i))
                    splat_adam(&x[k][i], gradient.plane[k][i], adam.rate[k], adam.step, &mean[k][i],
                               &square[k][i]);
            }
        CHECK_OK(renderer_step(test_ctx, r, &t, &gradient, &adam, &aside));
    }
    for (int k = 0; k < OXL_PLANES; k++)
        for (size_t i = 0; i < wide_rows(&c.w, k); i++)
            CHECK_CLOSE(t.model.plane[k][i], x[k][i], 1e-4 * STEPS * adam.rate[k] + 1e-5 * fabs(x[k][i]));
    model_trained_free(test_ctx, &t);
    reference_close(&c);
}

/* ---------------- a step after the backward pass, or one that ends it */

enum { STEP_ROWS = 40, STEP_LOBES = 19, STEP_UNSEEN = 3, STEP_EARLY = 0, STEP_LATE, STEP_PUBLIC, STEP_WAYS };

/* The model, and what it is after a step whose gradient comes from the backward pass or from the step itself, or
 * by oxl_adam_step. */
static void reference_step(int way, oxl_model *before, struct trained_model *after)
{
    const oxl_render_options options = oxl_render_options_default();
    const struct medium murky = {.on = 1,
                                 .attenuation = {0.1f, 0.2f, 0.3f},
                                 .backscatter = {0.1f, 0.1f, 0.1f},
                                 .veiling_light = {0.2f, 0.3f, 0.4f}};
    float drgb[3 * WIDE_SMOOTH_WIDTH * WIDE_SMOOTH_HEIGHT];
    oxl_adam adam = {.beta = RENDERER_BETAS, .step = 1};
    OWNED_WIDE w = {0};
    oxl_model moments[2] = {{0}, {0}};
    struct renderer_nonfinite aside;
    wide_smooth(&w, STEP_ROWS, STEP_LOBES, 0, 12, 0.3);
    w.plane[OXL_MEAN + 2][STEP_UNSEEN] = -50;
    CHECK_OK(wide_to_model(test_ctx, &w, before));
    CHECK_OK(wide_to_model(test_ctx, &w, &after->model));
    for (size_t i = 0; i < OXL_COUNT(drgb); i++) drgb[i] = (float)reference_weight(i);
    for (int k = 0; k < OXL_PLANES; k++) adam.rate[k] = k == OXL_LOBE ? 0.025f : 0.005f;
    CHECK_OK(model_trained_begin(test_ctx, after));
    OWNED_MODEL gradient = test_model(STEP_ROWS, 0);
    OWNED_RENDERER *r = test_renderer();
    renderer_settings(r)->medium = murky;
    CHECK_OK(renderer_forward(test_ctx, r, &after->model, &w.camera, &options));
    memset(gradient.plane[OXL_ROTATION], 0, STEP_ROWS * sizeof(float));
    CHECK_OK(renderer_backward(test_ctx, r, drgb, way == STEP_LATE ? NULL : &gradient));
    CHECK(gradient.lobes == (way == STEP_LATE ? 0 : STEP_LOBES));
    if (way == STEP_PUBLIC) CHECK_OK(oxl_adam_step(test_ctx, &after->model, &gradient, moments, &adam));
    else CHECK_OK(renderer_step(test_ctx, r, after, way ? NULL : &gradient, &adam, &aside));
    for (int k = 0; k < 2; k++) oxl_model_free(test_ctx, &moments[k]);
}

TEST(a_step_moves_the_lobes_that_were_seen_and_nothing_past_them)
{
    OWNED_MODEL old;
    struct trained_model m;
    reference_step(STEP_EARLY, &old, &m);
    for (int k = OXL_LOBE; k < OXL_PLANES; k++) {
        const double rate = k == OXL_LOBE ? 0.025 : 0.005;
        for (int i = 0; i < STEP_LOBES; i++)
            CHECK_CLOSE(fabs(m.model.plane[k][i] - old.plane[k][i]), i == STEP_UNSEEN ? 0 : rate,
                        1e-4 * rate);
        for (int i = STEP_LOBES; i < 32; i++) CHECK(m.model.plane[k][i] == 0);
    }
    CHECK(m.model.plane[OXL_OPACITY][25] != old.plane[OXL_OPACITY][25]);
    model_trained_free(test_ctx, &m);
}

TEST(a_step_gives_the_same_bytes_whether_it_ends_the_backward_pass_or_a_loop_of_ones_own_makes_it)
{
    struct trained_model m[STEP_WAYS];
    for (int way = 0; way < STEP_WAYS; way++) {
        OWNED_MODEL old;
        reference_step(way, &old, &m[way]);
        CHECK(test_same_model(&m[0].model, &m[way].model) && !test_same_model(&m[way].model, &old));
    }
    for (int way = 0; way < STEP_WAYS; way++) model_trained_free(test_ctx, &m[way]);
}

TEST(reference_learning_rates_are_the_papers)
{
    const oxl_train_options o = oxl_train_options_default(OXL_PRESET_PAPER);
    CHECK_CLOSE(o.lr_position / splat_learning_rate(OXL_MEAN, 1, 0), 1, 1e-6);
    CHECK_CLOSE(o.lr_position_final / splat_learning_rate(OXL_MEAN, 1, 1), 1, 1e-6);
    CHECK_CLOSE(o.lr_scale / splat_learning_rate(OXL_LOG_SCALE, 1, 0), 1, 1e-6);
    CHECK_CLOSE(o.lr_rotation / splat_learning_rate(OXL_ROTATION, 1, 0), 1, 1e-6);
    CHECK_CLOSE(o.lr_sh0 / splat_learning_rate(OXL_SH, 1, 0), 1, 1e-6);
    CHECK_CLOSE(o.lr_sh / splat_learning_rate(OXL_SH + 3, 1, 0), 1, 1e-6);
    CHECK_CLOSE(MODEL_LOBE_RATE_OPACITY / splat_learning_rate(OXL_LOBE, 1, 0), 1, 1e-6);
    CHECK_CLOSE(MODEL_LOBE_RATE_SCALE / splat_learning_rate(OXL_LOBE + 1, 1, 0), 1, 1e-6);
    CHECK_CLOSE(o.ssim_weight, 0.2, 1e-7); /* Kerbl 2023 */
}

/* ---------------- density control */

enum { REFERENCE_ROWS = 60 };

/* All combinations of opacity, scale and gradient: 1 % below and above each threshold, and away from it.
 * Scales about 0.01, where Kerbl's code changes from clone to split, must make no difference. */
static void reference_density_rows(oxl_model *m, double extent, double *gradient)
{
    static const double opacities[3] = {0.99 * 0.005, 1.01 * 0.005, 0.5},
                        gradients[4] = {1e-5, 0.99 * 2e-4, 1.01 * 2e-4, 1e-3};
    static const double scales[5] = {0.99 * 0.01, 1.01 * 0.01, 0.03, 0.99 * 0.1, 1.01 * 0.1};
    *m = test_model(REFERENCE_ROWS, 0);
    for (int i = 0; i < REFERENCE_ROWS; i++) {
        const double o = opacities[i % 3], scale = scales[i / 3 % 5] * extent;
        gradient[i] = gradients[i / 15];
        m->plane[OXL_OPACITY][i] = (float)log(o / (1 - o));
        for (int a = 0; a < 3; a++) {
            m->plane[OXL_MEAN + a][i] = (float)reference_random((size_t)i, (size_t)a);
            m->plane[OXL_ROTATION + a][i] = (float)reference_random((size_t)i, (size_t)a + 3);
            m->plane[OXL_LOG_SCALE + a][i] = (float)log(a == i % 3 ? scale : 0.3 * scale);
        }
    }
}

/* Rows after density control, as the reference has it: children stand next to each other. */
static void reference_check_children(const oxl_model *was, const oxl_model *is, const oxl_model *mean,
                                     const double *gradient, double extent, int was_reset)
{
    size_t at = 0;
    for (size_t i = 0; i < REFERENCE_ROWS; i++) {
        const double log_scale[3] = {was->plane[OXL_LOG_SCALE][i], was->plane[OXL_LOG_SCALE + 1][i],
                                     was->plane[OXL_LOG_SCALE + 2][i]};
        const enum splat_verdict verdict =
            splat_classify(log_scale, was->plane[OXL_OPACITY][i], gradient[i], extent, was_reset);
        const int rows = verdict == SPLAT_REMOVE ? 0 : verdict == SPLAT_KEEP ? 1 : 2;
        for (int child = 0; child < rows && at < is->count; child++, at++) {
            double row[OXL_SH];
            for (int k = 0; k < OXL_SH; k++) row[k] = was->plane[k][i];
            if (verdict == SPLAT_SPLIT) splat_split(row, child ? 1 : -1);
            for (int k = 0; k < OXL_SH; k++) CHECK_CLOSE(is->plane[k][at], row[k], 2e-5 * (1 + fabs(row[k])));
            CHECK(mean->plane[OXL_OPACITY][at] == (verdict == SPLAT_KEEP));
        }
    }
    CHECK(at == is->count);
}

TEST(reference_density_control_removes_keeps_and_splits_the_same_rows)
{
    const double extent = 2.5;
    for (int was_reset = 0; was_reset < 2; was_reset++) {
        const struct density_rules rules = {.gradient =
                                                oxl_train_options_default(OXL_PRESET_PAPER).densify_gradient,
                                            .extent = extent,
                                            .split_large = was_reset};
        double gradient[REFERENCE_ROWS];
        OWNED_MODEL was = {0};
        struct trained_model is;
        struct density own = {0}, *d = &own;
        struct density_change change;
        reference_density_rows(&was, extent, gradient);
        reference_density_rows(&is.model, extent, gradient);
        CHECK_OK(model_trained_begin(test_ctx, &is));
        for (int i = 0; i < REFERENCE_ROWS; i++) is.mean.plane[OXL_OPACITY][i] = 1;
        CHECK_OK(density_clear(test_ctx, d, REFERENCE_ROWS));
        for (int i = 0; i < REFERENCE_ROWS; i++) d->gradient[i] = (float)(3 * gradient[i]), d->views[i] = 3;
        CHECK_OK(test_density(test_ctx, d, &is, &rules, &change));
        CHECK(change.removed == 20 && change.split == (was_reset ? 24 : 20));
        reference_check_children(&was, &is.model, &is.mean, gradient, extent, was_reset);
        density_free(test_ctx, d);
        model_trained_free(test_ctx, &is);
    }
}

/* Where 1 - opacity rounds to 0, splat.c gives children an infinite logit; the kernel limits their opacity to
 * 1 - 1e-6. */
TEST(reference_children_of_opaque_gaussians_have_a_finite_logit)
{
    const struct density_rules rules = {.gradient = 1e-9f, .extent = 1};
    struct trained_model m;
    struct density own = {0}, *d = &own;
    struct density_change change;
    m.model = test_model(1, 0);
    CHECK_OK(model_trained_begin(test_ctx, &m));
    m.model.plane[OXL_OPACITY][0] = 60;
    CHECK_OK(density_clear(test_ctx, d, 1));
    d->gradient[0] = 1, d->views[0] = 1;
    CHECK_OK(test_density(test_ctx, d, &m, &rules, &change));
    CHECK(m.model.count == 2);
    for (size_t i = 0; i < m.model.count; i++)
        CHECK_CLOSE(m.model.plane[OXL_OPACITY][i], log((1 - 1e-6) / 1e-6), 1e-4);
    density_free(test_ctx, d);
    model_trained_free(test_ctx, &m);
}
