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

struct extreme {
    const char *what;
    void (*make)(struct wide *w, double value); /* changes the ordinary scene; NULL: as it is */
    double value;
    int count, degree, lobes;
    double image, gradient; /* asserted: the largest errors */
    int is_slow;            /* `make extremes` alone */
};

static double extreme_random(size_t i, size_t k)
{
    return wide_random(31, i, k);
}

/* ---------------- scenes */

static void extreme_fail(const char *what)
{
    fprintf(stderr, "extremes: %s\n", what);
    abort();
}

static void extreme_must(oxl_context *ctx, oxl_result rc)
{
    if (rc != OXL_OK) extreme_fail(oxl_error_text(ctx));
}

/* Gaussians of a tenth of the image's width and all shapes, 3 away. */
static void extreme_ordinary(const struct extreme *e, struct wide *w)
{
    static const struct wide_range ordinary[] = {
        {OXL_LOG_SCALE, 0, 1.2}, {OXL_ROTATION, -2, 1}, {OXL_OPACITY, 0, 1},     {OXL_SH, 0.5, 1.5},
        {OXL_SH + 3, 0.5, 1},    {OXL_LOBE, 0, 0.2},    {OXL_LOBE + 1, -2, 0.3}, {OXL_PLANES, 0.4, 0.3}};
    oxl_camera camera = {64, 48, 60, 66, 31, 25, {0}, {0.05, -0.1, 3}};
    camera_rotation_from_quaternion((double[4]){0.95, 0.1, -0.15, 0.2}, camera.rotation);
    wide_create(w, &camera, (size_t)e->count, (size_t)e->lobes, e->degree);
    w->near_plane = 0.25;
    wide_scatter(w, 31, ordinary);
    wide_to_float(w);
}

/* Not quite round, or there would be no gradient of the rotation to compare. */
static void extreme_size(struct wide *w, double size)
{
    for (int a = 0; a < 3; a++) wide_fill(w, OXL_LOG_SCALE + a, OXL_LOG_SCALE + a + 1, log(size) + 0.3 * a);
}

/* Needles (long along one axis) or, of a negative value, discs. */
static void extreme_thin(struct wide *w, double ratio)
{
    wide_fill(w, OXL_LOG_SCALE, OXL_ROTATION, ratio > 0 ? -log(ratio) : 0);
    wide_fill(w, OXL_LOG_SCALE, OXL_LOG_SCALE + 1, ratio > 0 ? 0 : -log(-ratio));
}

static void extreme_opacity(struct wide *w, double logit)
{
    wide_fill(w, OXL_OPACITY, OXL_OPACITY + 1, logit);
}

/* Wide walls one behind the other, facing the camera. */
static void extreme_layers(struct wide *w, double logit)
{
    wide_look_ahead(w);
    extreme_opacity(w, logit);
    extreme_size(w, 3);
    for (size_t i = 0; i < w->count; i++) w->plane[OXL_MEAN + 2][i] = 0.002 * (double)i;
}

/* One Gaussian, at this distance past the near plane in units of the last place. */
static void extreme_near(struct wide *w, double steps)
{
    const float at = steps == 0 ? (float)w->near_plane : nextafterf((float)w->near_plane, (float)steps * 100);
    wide_look_ahead(w);
    memset(w->camera.translation, 0, sizeof w->camera.translation);
    wide_multiply(w, OXL_MEAN, OXL_MEAN + 2, 0.1);
    wide_fill(w, OXL_MEAN + 2, OXL_MEAN + 3, at);
    extreme_size(w, 0.02);
}

/* Centres at this x/z, far to the side, so wide that they reach into the image. */
static void extreme_aside(struct wide *w, double slope)
{
    wide_look_ahead(w);
    for (size_t i = 0; i < w->count; i++) w->plane[OXL_MEAN][i] += 3 * slope;
    extreme_size(w, slope);
}

/* Straight ahead with this focal length; the positions grow or shrink with what is in view. */
static void extreme_ahead(struct wide *w, double focal, double spread)
{
    wide_look_ahead(w);
    w->camera.fx = w->camera.fy = focal;
    w->camera.translation[0] = w->camera.translation[1] = 0;
    wide_multiply(w, OXL_MEAN, OXL_MEAN + 2, spread);
}

static void extreme_view_angle(struct wide *w, double degrees)
{
    const double slope = tan(degrees / 360 * 3.141592653589793);
    extreme_ahead(w, 32 / slope, OXL_MIN(slope * 2, 6));
    if (degrees < 10) extreme_size(w, 0.3 * slope);
}

static void extreme_focal(struct wide *w, double focal)
{
    extreme_ahead(w, focal, 60 / focal);
    extreme_size(w, 12 / focal);
}

static void extreme_picture(struct wide *w, int width, int height)
{
    const double scale = OXL_MAX(width, height) / 64.0;
    wide_resize(w, width, height);
    w->camera.cx = width / 2.0, w->camera.cy = height / 2.0;
    w->camera.fx *= scale, w->camera.fy *= scale;
}

static void extreme_pixel(struct wide *w, double value)
{
    extreme_picture(w, 1, (int)value);
}

static void extreme_wide_picture(struct wide *w, double value)
{
    extreme_picture(w, (int)value, 5464);
}

/* Model and camera this far from the origin along each axis: what scene.c's own origin spares us. */
static void extreme_far(struct wide *w, double offset)
{
    for (int a = 0; a < 3; a++) {
        for (size_t i = 0; i < w->count; i++) w->plane[OXL_MEAN + a][i] += offset;
        for (int b = 0; b < 3; b++) w->camera.translation[a] -= w->camera.rotation[3 * a + b] * offset;
    }
}

static void extreme_unit(struct wide *w, double unit)
{
    wide_multiply(w, OXL_MEAN, OXL_LOG_SCALE, unit);
    for (int a = 0; a < 3; a++) {
        for (size_t i = 0; i < w->count; i++) w->plane[OXL_LOG_SCALE + a][i] += log(unit);
        w->camera.translation[a] *= unit;
    }
    w->near_plane *= unit;
}

static void extreme_quaternion(struct wide *w, double length)
{
    wide_multiply(w, OXL_ROTATION, OXL_OPACITY, length);
}

static void extreme_in_one_place(struct wide *w, double x)
{
    wide_fill(w, OXL_MEAN, OXL_LOG_SCALE, x);
}

static void extreme_in_a_row(struct wide *w, double step)
{
    for (int a = 0; a < 3; a++)
        for (size_t i = 0; i < w->count; i++)
            w->plane[OXL_MEAN + a][i] = step * ((double)i - (double)w->count / 2);
}

/* All on one tile, each fainter than a pixel can show twice over. */
static void extreme_crowd(struct wide *w, double logit)
{
    extreme_picture(w, 16, 16);
    w->camera.fx = w->camera.fy = 15;
    extreme_opacity(w, logit);
}

/* Second lobes that take away nearly all, over a wider area: alpha is negative around each centre. */
static void extreme_dark_lobes(struct wide *w, double scale_factor)
{
    wide_fill(w, OXL_LOBE, OXL_LOBE + 1, 5);
    wide_fill(w, OXL_LOBE + 1, OXL_PLANES, log(scale_factor));
    extreme_opacity(w, -1);
}

/* Bounds are about four times what was measured, so that another instruction set has room. 4e-3: a decision
 * fell the other way. */
static const struct extreme EXTREMES[] = {
    {"ordinary: 200 Gaussians, 64 x 48 px", NULL, 0, 200, 2, 60, 5e-6, 2e-5, 0},
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

struct extreme_sums {
    double most_off, most, off, all;
    int finite;
};

static void extreme_compare(struct extreme_sums *s, const float *narrow, const double *wide, size_t n)
{
    for (size_t i = 0; i < n; i++) {
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
        extreme_compare(&sums, narrow->plane[k], wide->gradient[k], wide_rows(wide, k));
    return extreme_error(&sums, EXTREME_UNDERFLOW);
}

static void extreme_run(oxl_context *ctx, const struct extreme *e, struct extreme_result *out)
{
    static const int first[EXTREME_PARTS + 1] = {0,           OXL_MEAN, OXL_LOG_SCALE, OXL_ROTATION,
                                                 OXL_OPACITY, OXL_SH,   OXL_LOBE,      OXL_PLANES};
    OWNED_WIDE w = {0};
    struct extreme_sums image = {.finite = 1};
    struct renderer *narrow = NULL;
    oxl_render_options options = oxl_render_options_default();
    oxl_model model, gradient;
    float *drgb;
    double *drgb_f64;
    extreme_ordinary(e, &w);
    if (e->make) e->make(&w, e->value);
    wide_to_float(&w);
    size_t values = 3 * (size_t)w.camera.width * w.camera.height;
    drgb = wide_array(values), drgb_f64 = wide_array(values);
    for (size_t i = 0; i < values; i++) drgb_f64[i] = drgb[i] = (float)extreme_random(i, 99);
    options.near_plane = (float)w.near_plane;
    extreme_must(ctx, wide_to_model(ctx, &w, &model));
    extreme_must(ctx, renderer_create(ctx, &narrow));
    extreme_must(ctx, renderer_forward(ctx, narrow, &model, &w.camera, &options));
    kernels_backward(&w, drgb_f64);
    wide_fill(&w, 0, OXL_PLANES, 0); /* rows out of view get no gradient */
    extreme_must(ctx, wide_to_model(ctx, &w, &gradient));
    extreme_must(ctx, renderer_backward(ctx, narrow, drgb, &gradient));
    extreme_compare(&image, narrow->rgb, w.rgb, values);
    out->rendered = narrow->bins.visible_count;
    out->part[EXTREME_IMAGE] = extreme_error(&image, EXTREME_UNDERFLOW);
    for (int k = EXTREME_IMAGE + 1; k < EXTREME_PARTS; k++)
        out->part[k] = extreme_planes(&gradient, &w, first[k], first[k + 1]);
    renderer_free(ctx, narrow);
    oxl_model_free(ctx, &model), oxl_model_free(ctx, &gradient);
    free(drgb), free(drgb_f64);
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
