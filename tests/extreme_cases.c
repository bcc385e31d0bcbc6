/* extreme_cases.c - numbers at the extremes: each case is computed by our float kernels and by the same
 * source in double.
 *
 * For test_extremes.c, which asserts the bounds of the quick ones, and extremes.c, which asserts all and
 * writes docs/STABILITY.md.
 * Errors are relative to the largest magnitude in the image, or in that part of the gradient: max |float -
 * double| / max |double|, and the mean of the one over the mean of the other. The double kernels start from
 * the same float parameters but from the camera in double, so that what its rounding costs is in the figure.
 *
 * A decision (alpha >= 1/255, T >= 1e-4) may fall the other way in float; such a pixel is off by up to 1/255
 * of the light.
 */
#ifndef TEST_EXTREME_CASES_C
#define TEST_EXTREME_CASES_C
#include "wide.h"

enum {
    EXTREME_IMAGE,
    EXTREME_POSITION,
    EXTREME_SCALE,
    EXTREME_ROTATION,
    EXTREME_OPACITY,
    EXTREME_COLOUR,
    EXTREME_LOBE,
    EXTREME_PARTS
};

#define EXTREME_UNDERFLOW 1e-30 /* gradients below mean nothing */

struct extreme_error {
    double most, mean; /* relative */
    int finite;
};

struct extreme_result {
    size_t rendered; /* Gaussians */
    struct extreme_error part[EXTREME_PARTS];
};

struct extreme_scene {
    oxl_camera camera;
    oxl_model model;
    float near_plane;
};

struct extreme {
    const char *what;
    void (*make)(struct extreme_scene *s, double value); /* changes the ordinary scene */
    double value;
    int count, degree, lobes;
    double image, gradient; /* asserted: the largest errors */
    int is_slow;            /* `make extremes` alone */
};

static double extreme_random(size_t i, size_t k)
{
    return 2 * random_unit(random_bits(31, i, k)) - 1;
}

/* ---------------- scenes */

static void extreme_fail(const char *what)
{
    fprintf(stderr, "extremes: %s\n", what);
    abort();
}

/* Gaussians of a tenth of the image's width and all shapes, 3 away. */
static void extreme_ordinary(oxl_context *ctx, const struct extreme *e, struct extreme_scene *s)
{
    *s = (struct extreme_scene){.near_plane = 0.25f};
    s->camera = (oxl_camera){64, 48, 60, 66, 31, 25, {0}, {0.05, -0.1, 3}};
    camera_rotation_from_quaternion((double[4]){0.95, 0.1, -0.15, 0.2}, s->camera.rotation);
    if (oxl_model_create(ctx, (size_t)e->count, e->degree, &s->model) != OXL_OK ||
        model_set_lobes(ctx, &s->model, (size_t)e->lobes) != OXL_OK)
        extreme_fail("no memory for a model");
    for (int k = 0; k < oxl_model_planes(&s->model); k++)
        for (size_t i = 0; i < s->model.count; i++) {
            const double u = extreme_random(i, (size_t)k);
            s->model.plane[k][i] = (float)(k < OXL_LOG_SCALE  ? 1.2 * u
                                           : k < OXL_ROTATION ? -2 + u
                                           : k < OXL_OPACITY  ? u
                                           : k < OXL_SH       ? 0.5 + 1.5 * u
                                           : k < OXL_SH + 3   ? 0.5 + u
                                                              : 0.2 * u);
        }
    for (int k = OXL_LOBE; k < OXL_PLANES; k++)
        for (size_t i = 0; i < s->model.lobes; i++)
            s->model.plane[k][i] = (float)((k == OXL_LOBE ? -2 : 0.4) + 0.3 * extreme_random(i, (size_t)k));
}

static void extreme_nothing(struct extreme_scene *s, double value)
{
    (void)s, (void)value;
}

static void extreme_fill(struct extreme_scene *s, int first, int end, double value)
{
    for (int k = first; k < end; k++)
        for (size_t i = 0; i < s->model.count; i++) s->model.plane[k][i] = (float)value;
}

/* Not quite round, or there would be no gradient of the rotation to compare. */
static void extreme_size(struct extreme_scene *s, double size)
{
    for (int a = 0; a < 3; a++)
        extreme_fill(s, OXL_LOG_SCALE + a, OXL_LOG_SCALE + a + 1, log(size) + 0.3 * a);
}

/* Needles (long along one axis) or, of a negative value, discs. */
static void extreme_thin(struct extreme_scene *s, double ratio)
{
    extreme_fill(s, OXL_LOG_SCALE, OXL_ROTATION, ratio > 0 ? -log(ratio) : 0);
    extreme_fill(s, OXL_LOG_SCALE, OXL_LOG_SCALE + 1, ratio > 0 ? 0 : log(-ratio) * -1);
}

static void extreme_opacity(struct extreme_scene *s, double logit)
{
    extreme_fill(s, OXL_OPACITY, OXL_OPACITY + 1, logit);
}

/* Wide walls one behind the other, facing the camera. */
static void extreme_layers(struct extreme_scene *s, double logit)
{
    camera_rotation_from_quaternion((double[4]){1, 0, 0, 0}, s->camera.rotation);
    extreme_opacity(s, logit);
    extreme_size(s, 3);
    for (size_t i = 0; i < s->model.count; i++) s->model.plane[OXL_MEAN + 2][i] = (float)(0.002 * (double)i);
}

/* One Gaussian, at this distance past the near plane in units of the last place. */
static void extreme_near(struct extreme_scene *s, double steps)
{
    camera_rotation_from_quaternion((double[4]){1, 0, 0, 0}, s->camera.rotation);
    memset(s->camera.translation, 0, sizeof s->camera.translation);
    for (size_t i = 0; i < s->model.count; i++) {
        s->model.plane[OXL_MEAN][i] *= 0.1f, s->model.plane[OXL_MEAN + 1][i] *= 0.1f;
        s->model.plane[OXL_MEAN + 2][i] = nextafterf(s->near_plane, (float)steps * 100);
        if (steps == 0) s->model.plane[OXL_MEAN + 2][i] = s->near_plane;
    }
    extreme_size(s, 0.02);
}

/* Centres at this x/z, far to the side, so wide that they reach into the image. */
static void extreme_aside(struct extreme_scene *s, double slope)
{
    camera_rotation_from_quaternion((double[4]){1, 0, 0, 0}, s->camera.rotation);
    for (size_t i = 0; i < s->model.count; i++)
        s->model.plane[OXL_MEAN][i] = (float)(3 * slope + s->model.plane[OXL_MEAN][i]);
    extreme_size(s, slope);
}

static void extreme_view_angle(struct extreme_scene *s, double degrees)
{
    const double half = degrees / 360 * 3.141592653589793;
    camera_rotation_from_quaternion((double[4]){1, 0, 0, 0}, s->camera.rotation);
    s->camera.translation[0] = s->camera.translation[1] = 0;
    s->camera.fx = s->camera.fy = 32 / tan(half);
    for (int k = 0; k < 2; k++)
        for (size_t i = 0; i < s->model.count; i++)
            s->model.plane[OXL_MEAN + k][i] *= (float)OXL_MIN(tan(half) * 2, 6);
    if (degrees < 10) extreme_size(s, 0.3 * tan(half));
}

static void extreme_focal(struct extreme_scene *s, double focal)
{
    camera_rotation_from_quaternion((double[4]){1, 0, 0, 0}, s->camera.rotation);
    s->camera.fx = s->camera.fy = focal;
    s->camera.translation[0] = s->camera.translation[1] = 0;
    for (int k = 0; k < 2; k++)
        for (size_t i = 0; i < s->model.count; i++) s->model.plane[OXL_MEAN + k][i] *= (float)(60 / focal);
    extreme_size(s, 12 / focal);
}

static void extreme_picture(struct extreme_scene *s, int width, int height)
{
    const double scale = OXL_MAX(width, height) / 64.0;
    s->camera.width = width, s->camera.height = height;
    s->camera.cx = width / 2.0, s->camera.cy = height / 2.0;
    s->camera.fx *= scale, s->camera.fy *= scale;
}

static void extreme_pixel(struct extreme_scene *s, double value)
{
    extreme_picture(s, 1, (int)value);
}

static void extreme_wide_picture(struct extreme_scene *s, double value)
{
    extreme_picture(s, (int)value, 5464);
}

/* Model and camera this far from the origin along each axis: what scene.c's own origin spares us. */
static void extreme_far(struct extreme_scene *s, double offset)
{
    for (int a = 0; a < 3; a++) {
        for (size_t i = 0; i < s->model.count; i++) s->model.plane[OXL_MEAN + a][i] += (float)offset;
        for (int b = 0; b < 3; b++) s->camera.translation[a] -= s->camera.rotation[3 * a + b] * offset;
    }
}

static void extreme_unit(struct extreme_scene *s, double unit)
{
    for (int a = 0; a < 3; a++) {
        for (size_t i = 0; i < s->model.count; i++) {
            s->model.plane[OXL_MEAN + a][i] *= (float)unit;
            s->model.plane[OXL_LOG_SCALE + a][i] += (float)log(unit);
        }
        s->camera.translation[a] *= unit;
    }
    s->near_plane *= (float)unit;
}

static void extreme_quaternion(struct extreme_scene *s, double length)
{
    for (int k = 0; k < 4; k++)
        for (size_t i = 0; i < s->model.count; i++)
            s->model.plane[OXL_ROTATION + k][i] = (float)(length * s->model.plane[OXL_ROTATION + k][i]);
}

static void extreme_in_one_place(struct extreme_scene *s, double x)
{
    extreme_fill(s, OXL_MEAN, OXL_LOG_SCALE, x);
}

static void extreme_in_a_row(struct extreme_scene *s, double step)
{
    for (int a = 0; a < 3; a++)
        for (size_t i = 0; i < s->model.count; i++)
            s->model.plane[OXL_MEAN + a][i] = (float)(step * ((double)i - (double)s->model.count / 2));
}

/* All on one tile, each fainter than a pixel can show twice over. */
static void extreme_crowd(struct extreme_scene *s, double logit)
{
    s->camera.width = s->camera.height = 16;
    s->camera.cx = s->camera.cy = 8;
    s->camera.fx = s->camera.fy = 15;
    extreme_opacity(s, logit);
}

/* Second lobes that take away nearly all, over a wider area: alpha is negative around each centre. */
static void extreme_dark_lobes(struct extreme_scene *s, double scale_factor)
{
    for (size_t i = 0; i < s->model.lobes; i++) {
        s->model.plane[OXL_LOBE][i] = 5;
        for (int a = 1; a < 4; a++) s->model.plane[OXL_LOBE + a][i] = (float)log(scale_factor);
    }
    extreme_opacity(s, -1);
}

/* Bounds are about four times what was measured, so that another instruction set has room. 4e-3: a decision
 * fell the other way. */
static const struct extreme EXTREMES[] = {
    {"ordinary: 200 Gaussians, 64 x 48 px", extreme_nothing, 0, 200, 2, 60, 5e-6, 2e-5, 0},
    {"scales of 1e-7", extreme_size, 1e-7, 100, 1, 0, 2e-5, 5e-5, 0},
    {"scales of 1e4, the camera inside", extreme_size, 1e4, 20, 1, 0, 5e-6, 1e-4, 0},
    {"scales of e^-80", extreme_size, 1.8e-35, 50, 0, 0, 2e-5, 5e-5, 0},
    {"scales of e^80: wider than 1e30 px, not rendered", extreme_size, 5.5e34, 20, 0, 0, 0, 0, 0},
    {"needles of 1e5 : 1", extreme_thin, 1e5, 60, 0, 0, 2e-5, 5e-5, 0},
    {"discs of 1e5 : 1", extreme_thin, -1e5, 60, 0, 0, 5e-6, 5e-5, 0},
    {"opacity logits of 30", extreme_opacity, 30, 60, 1, 0, 5e-6, 5e-5, 0},
    {"opacity logits of -30: below 1/255, not rendered", extreme_opacity, -30, 60, 1, 0, 0, 0, 0},
    {"1000 opaque layers", extreme_layers, 30, 1000, 0, 0, 5e-6, 1e-4, 0},
    {"1000 layers of alpha 0.005", extreme_layers, -5.3, 1000, 0, 0, 4e-3, 5e-2, 0},
    {"on the near plane: not rendered", extreme_near, 0, 20, 1, 0, 0, 0, 0},
    {"one ulp past the near plane", extreme_near, 1, 20, 1, 0, 5e-6, 2e-5, 0},
    {"one ulp before the near plane: not rendered", extreme_near, -1, 20, 1, 0, 0, 0, 0},
    {"centres 3 image widths to the side", extreme_aside, 3, 20, 1, 0, 5e-6, 5e-5, 0},
    {"centres 100 image widths to the side", extreme_aside, 100, 20, 1, 0, 5e-6, 5e-5, 0},
    {"field of view of 1 degree", extreme_view_angle, 1, 100, 1, 0, 5e-6, 2e-5, 0},
    {"field of view of 170 degrees", extreme_view_angle, 170, 100, 1, 0, 1e-5, 2e-5, 0},
    {"focal length of 1e5 px", extreme_focal, 1e5, 100, 1, 0, 5e-6, 2e-5, 0},
    {"1 x 1 px", extreme_pixel, 1, 50, 1, 0, 5e-6, 2e-5, 0},
    {"1 x 5000 px", extreme_pixel, 5000, 50, 1, 0, 5e-6, 2e-5, 0},
    {"8192 x 5464 px", extreme_wide_picture, 8192, 300, 1, 20, 4e-3, 1e-3, 1},
    {"1e3 units from the model's origin", extreme_far, 1e3, 100, 1, 0, 1e-2, 1e-2, 0},
    {"1e5 units from the model's origin", extreme_far, 1e5, 100, 1, 0, 0.5, 0.5, 0},
    {"a scene of 1e-3 units", extreme_unit, 1e-3, 100, 1, 20, 4e-3, 1e-3, 0},
    {"a scene of 1e5 units", extreme_unit, 1e5, 100, 1, 20, 4e-3, 1e-3, 0},
    {"quaternions of length 0: identity", extreme_quaternion, 0, 60, 0, 0, 5e-6, 2e-5, 0},
    {"quaternions of length 1e-42: identity", extreme_quaternion, 1e-42, 60, 0, 0, 5e-6, 2e-5, 0},
    {"quaternions of length 1e-30", extreme_quaternion, 1e-30, 60, 0, 0, 5e-6, 2e-5, 0},
    {"quaternions of length 1e30", extreme_quaternion, 1e30, 60, 0, 0, 5e-6, 2e-5, 0},
    {"100 Gaussians in one place", extreme_in_one_place, 0.1, 100, 1, 0, 5e-6, 2e-5, 0},
    {"100 Gaussians in a row", extreme_in_a_row, 0.03, 100, 1, 0, 5e-6, 2e-5, 0},
    {"a million Gaussians on one tile", extreme_crowd, -5, 1000000, 0, 0, 4e-3, 5e-2, 1},
    {"DoG: lobes that darken, T grows", extreme_dark_lobes, 2, 60, 0, 60, 5e-6, 2e-5, 0},
};

/* ---------------- the two precisions */

static void extreme_widen(const struct extreme_scene *s, struct wide *w)
{
    wide_create(w, &s->camera, s->model.count, s->model.lobes, s->model.sh_degree);
    w->near_plane = s->near_plane;
    for (int k = 0; k < OXL_PLANES; k++)
        for (size_t i = 0; w->plane[k] && i < (k < OXL_LOBE ? w->count : w->lobes); i++)
            w->plane[k][i] = s->model.plane[k][i];
}

struct extreme_sums {
    double most_off, most, off, all;
    int finite;
};

static void extreme_compare(struct extreme_sums *s, const float *narrow, const double *wide, size_t n)
{
    for (size_t i = 0; narrow && wide && i < n; i++) {
        const double off = fabs((double)narrow[i] - wide[i]);
        s->finite &= fabsf(narrow[i]) <= FLT_MAX && fabs(wide[i]) <= DBL_MAX;
        s->most_off = OXL_MAX(s->most_off, off);
        s->most = OXL_MAX(s->most, fabs(wide[i]));
        s->off += off;
        s->all += fabs(wide[i]);
    }
}

/* floor: magnitudes below count as it. */
static struct extreme_error extreme_error(const struct extreme_sums *s, double floor)
{
    return (struct extreme_error){s->most_off / OXL_MAX(s->most, floor), s->off / OXL_MAX(s->all, floor),
                                  s->finite};
}

static struct extreme_error extreme_planes(const oxl_model *narrow, const struct wide *wide, int first,
                                           int end)
{
    struct extreme_sums sums = {.finite = 1};
    for (int k = first; k < end; k++)
        extreme_compare(&sums, narrow->plane[k], wide->gradient[k],
                        k < OXL_LOBE ? narrow->count : narrow->lobes);
    return extreme_error(&sums, EXTREME_UNDERFLOW);
}

static void extreme_measure(oxl_context *ctx, const struct extreme_scene *s, struct extreme_result *out)
{
    const size_t values = 3 * (size_t)s->camera.width * (size_t)s->camera.height;
    struct extreme_sums image = {.finite = 1};
    struct wide wide;
    struct renderer *narrow = NULL;
    oxl_render_options options = oxl_render_options_default();
    oxl_model gradient = {0};
    float *drgb = oxl_alloc(ctx, values, sizeof *drgb);
    double *drgb_f64 = wide_array(values);
    options.near_plane = s->near_plane;
    if (!drgb || renderer_create(ctx, &narrow) != OXL_OK || model_copy(ctx, &s->model, &gradient) != OXL_OK ||
        renderer_forward(ctx, narrow, &s->model, &s->camera, &options) != OXL_OK)
        extreme_fail(oxl_error_text(ctx));
    for (size_t i = 0; i < values; i++) drgb_f64[i] = drgb[i] = (float)extreme_random(i, 99);
    for (int k = 0; k < OXL_PLANES; k++)
        if (gradient.plane[k])
            memset(gradient.plane[k], 0, (k < OXL_LOBE ? gradient.count : gradient.lobes) * sizeof(float));
    if (renderer_backward(ctx, narrow, drgb, &gradient) != OXL_OK) extreme_fail(oxl_error_text(ctx));
    extreme_widen(s, &wide);
    kernels_backward(&wide, drgb_f64);
    extreme_compare(&image, narrow->rgb, wide.rgb, values);
    out->rendered = narrow->bins.visible_count;
    out->part[EXTREME_IMAGE] = extreme_error(&image, EXTREME_UNDERFLOW);
    out->part[EXTREME_POSITION] = extreme_planes(&gradient, &wide, OXL_MEAN, OXL_LOG_SCALE);
    out->part[EXTREME_SCALE] = extreme_planes(&gradient, &wide, OXL_LOG_SCALE, OXL_ROTATION);
    out->part[EXTREME_ROTATION] = extreme_planes(&gradient, &wide, OXL_ROTATION, OXL_OPACITY);
    out->part[EXTREME_OPACITY] = extreme_planes(&gradient, &wide, OXL_OPACITY, OXL_SH);
    out->part[EXTREME_COLOUR] = extreme_planes(&gradient, &wide, OXL_SH, oxl_model_planes(&s->model));
    out->part[EXTREME_LOBE] = extreme_planes(&gradient, &wide, OXL_LOBE, OXL_PLANES);
    wide_free(&wide);
    renderer_free(ctx, narrow);
    oxl_model_free(ctx, &gradient);
    oxl_free(ctx, drgb);
    free(drgb_f64);
}

static void extreme_run(oxl_context *ctx, const struct extreme *e, struct extreme_result *out)
{
    struct extreme_scene s;
    extreme_ordinary(ctx, e, &s);
    e->make(&s, e->value);
    extreme_measure(ctx, &s, out);
    oxl_model_free(ctx, &s.model);
}

/* 1: within the bounds and finite. */
static int extreme_holds(const struct extreme *e, const struct extreme_result *r)
{
    int holds = 1;
    for (int k = 0; k < EXTREME_PARTS; k++)
        holds &= r->part[k].finite && r->part[k].most <= (k == EXTREME_IMAGE ? e->image : e->gradient);
    return holds;
}

#endif
