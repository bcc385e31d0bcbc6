/* imaging.c - what lies between the Gaussians and an image, and what a view says about it: medium, dropout,
 * lamp, the loss in front of points.
 *
 * What a view has none of costs nothing: it is in no variant of a pass that runs, and its passes do not run.
 * The gradient of the lamp is a sum over pixels in a written order, and lies behind the
 * loss' totals, where a deferred step's report finds them.
 */
#include "resident.h"
#include "../../src/render/kernels.h"
#include "../../src/core/random.h"
#include "../../src/core/vecmath.h"

#define VULKAN_PIXELS_EACH 4096 /* of a workgroup of imaging_pixels.comp */

/* Fills in the view's numbers, and which variants the passes need. */
OXL_INTERNAL void vulkan_take_settings(struct vulkan_renderer *r, const struct renderer_settings *s)
{
    const struct medium *m = &s->medium;
    const uint64_t mixed = random_mix(s->dropout.seed);
    r->in_medium = m->on;
    r->drops = s->dropout.fraction > 0;
    r->may_be_lit = s->lamp != NULL;
    r->is_window = s->window.width > 0;
    r->view.surroundings_shift = (uint32_t)((r->count + PACK - 1) / PACK * PACK - r->count);
    if (r->drops) {
        r->view.dropout_gain = (float)(-vecmath_log(1 - s->dropout.fraction) / VECMATH_LN2);
        r->view.dropout_most = (uint32_t)(s->dropout.fraction * 4294967296.0);
        r->view.dropout_low = (uint32_t)mixed;
        r->view.dropout_high = (uint32_t)(mixed >> 32);
        r->view.dropout_step = (uint32_t)s->dropout.step;
    }
    if (!m->on) return;
    memcpy(r->view.attenuation, m->attenuation, sizeof m->attenuation);
    memcpy(r->view.backscatter, m->backscatter, sizeof m->backscatter);
    memcpy(r->view.veiling_light, m->veiling_light, sizeof m->veiling_light);
    r->view.training_range = m->training_range;
    memcpy(r->view.background, m->veiling_light, sizeof m->veiling_light);
}

/* ---------------- the lamp over the image */

/* The polynomial by powers: the coefficients of y^j x^k, j + k <= LAMP_DEGREE, by j, then k. */
static void vulkan_powers_of(const float shape[LAMP_TERMS], float power[VULKAN_POWERS])
{
    for (int j = 0, at = 0; j <= LAMP_DEGREE; j++)
        for (int k = 0; k <= LAMP_DEGREE - j; k++) {
            double sum = 0;
            for (int t = 0; t < LAMP_TERMS; t++) sum += (double)shape[t] * lamp_coefficient(t, j, k);
            power[at++] = (float)sum;
        }
}

/* sum (14): each term times values of an image, by the sums of the values times y^j x^k. */
static void vulkan_terms_of(const double power[VULKAN_POWERS], double sum[LAMP_TERMS])
{
    memset(sum, 0, LAMP_TERMS * sizeof *sum);
    for (int j = 0, at = 0; j <= LAMP_DEGREE; j++)
        for (int k = 0; k <= LAMP_DEGREE - j; k++, at++)
            for (int t = 0; t < LAMP_TERMS; t++) sum[t] += power[at] * lamp_coefficient(t, j, k);
}

/* What lamp.comp and imaging_pixels.comp are pushed: size, and where x and y of the polynomial begin. */
static void vulkan_push_area(const struct vulkan_renderer *r, uint32_t push[6])
{
    const struct lamp_area *a = &r->lamp_area;
    push[0] = r->view.width;
    push[1] = r->view.height;
    push[2] = vulkan_bits(lamp_coordinate(a->x, a->full_width));
    push[3] = vulkan_bits(lamp_coordinate(a->y, a->full_height));
    push[4] = vulkan_bits(2 / (float)a->full_width);
    push[5] = vulkan_bits(2 / (float)a->full_height);
}

OXL_INTERNAL void vulkan_draw_lamp(struct vulkan_renderer *r, const struct lamp *lamp,
                                   const struct lamp_area *area)
{
    const size_t pixels = (size_t)r->view.width * r->view.height;
    float power[VULKAN_POWERS];
    uint32_t push[7];
    r->lit = lamp != NULL;
    r->lamp_area = *area;
    if (!r->lit) return;
    vulkan_powers_of(lamp->shape, power);
    vulkan_reserve_imaging(r);
    vulkan_update(r->v, &r->powers, 0, power, sizeof power);
    vulkan_push_area(r, push);
    push[6] = VULKAN_INFINITY;
    VULKAN_RUN(r->v, LAMP, 0, vulkan_groups(pixels), push, VULKAN_BUFFERS(&r->powers, &r->lamp));
}

/* ---------------- the gradient of the lamp */

static size_t vulkan_pixel_groups(const struct vulkan_renderer *r)
{
    return ((size_t)r->view.width * r->view.height + VULKAN_PIXELS_EACH - 1) / VULKAN_PIXELS_EACH;
}

OXL_INTERNAL void vulkan_reserve_imaging(struct vulkan_renderer *r)
{
    const int lit = r->lit || r->may_be_lit;
    if (r->in_medium) {
        vulkan_reserve(r->v, &r->depth_points, DEPTH_POINTS, 4 * sizeof(float), "points");
        vulkan_reserve(r->v, &r->depth_first, DEPTH_POINTS + 1, sizeof(uint32_t), "points");
        vulkan_prepare(r->v, PASS_DEPTH_LOSS, 0);
    }
    if (lit) {
        vulkan_reserve(r->v, &r->lamp, (size_t)r->view.width * r->view.height, sizeof(float), "pixels");
        vulkan_reserve(r->v, &r->powers, VULKAN_POWERS, sizeof(float), "numbers");
        vulkan_reserve(r->v, &r->pixel_sums, vulkan_pixel_groups(r), VULKAN_POWERS * sizeof(float), "pixels");
        vulkan_prepare(r->v, PASS_LAMP, 0);
        vulkan_prepare(r->v, PASS_IMAGING_PIXELS, 0);
        vulkan_prepare(r->v, PASS_IMAGING_TOTAL, 0);
    }
}

/* After the backward pass of the pairs, before the step. */
OXL_INTERNAL void vulkan_add_imaging(struct vulkan_renderer *r)
{
    uint32_t push[7];
    if (!r->lit) return;
    vulkan_reserve_imaging(r);
    vulkan_push_area(r, push);
    push[6] = vulkan_bits(1 / r->window_fraction);
    VULKAN_RUN(r->v, IMAGING_PIXELS, 0, vulkan_pixel_groups(r), push,
               VULKAN_BUFFERS(&r->rgb, &r->drgb, &r->pixel_sums));
    VULKAN_RUN(r->v, IMAGING_TOTAL, 0, 1, VULKAN_PUSH((uint32_t)vulkan_pixel_groups(r)),
               VULKAN_BUFFERS(&r->pixel_sums, &r->totals));
}

/* imaging: of struct vulkan_report. */
OXL_INTERNAL void vulkan_imaging_of(const float imaging[VULKAN_POWERS], double dlamp[LAMP_TERMS])
{
    double power[VULKAN_POWERS];
    for (int k = 0; k < VULKAN_POWERS; k++) power[k] = (double)imaging[k];
    vulkan_terms_of(power, dlamp);
}

OXL_INTERNAL oxl_result vulkan_lamp_gradient(void *device, double dlamp[LAMP_TERMS])
{
    struct vulkan_renderer *r = device;
    float imaging[VULKAN_POWERS];
    vulkan_enter(r->v);
    vulkan_download(r->v, &r->totals,
                    offsetof(struct vulkan_report, imaging) - offsetof(struct vulkan_report, totals), imaging,
                    sizeof imaging);
    if (r->v->rc == OXL_OK) vulkan_imaging_of(imaging, dlamp);
    return r->v->rc;
}

/* ---------------- the loss in front of points */

struct vulkan_depths {               /* sorted by tile, in the given order in each */
    uint32_t point[DEPTH_POINTS][4]; /* bits of x, y, z; the tile's number */
    uint32_t first[DEPTH_POINTS + 1];
    uint32_t groups;
};

/* Returns the tile of a point; UINT32_MAX: outside of the image. */
static uint32_t vulkan_tile_of(const struct vulkan_renderer *r, const struct depth_point *p)
{
    if (!(p->x >= 0 && p->y >= 0 && p->x < (float)(r->view.tiles_x * TILE) &&
          p->y < (float)(r->view.tiles_y * TILE)))
        return UINT32_MAX;
    return (uint32_t)(p->y / TILE) * r->view.tiles_x + (uint32_t)(p->x / TILE);
}

static struct vulkan_depths vulkan_group_depths(const struct vulkan_renderer *r,
                                                const struct depth_point *point, int points)
{
    struct vulkan_depths d;
    uint32_t tile[DEPTH_POINTS], at = 0;
    memset(&d, 0, sizeof d);
    for (int i = 0; i < points; i++) tile[i] = vulkan_tile_of(r, &point[i]);
    for (int i = 0; i < points; i++) {
        const uint32_t here = tile[i];
        if (here == UINT32_MAX) continue;
        d.first[d.groups++] = at;
        for (int k = i; k < points; k++) {
            if (tile[k] != here) continue;
            d.point[at][0] = vulkan_bits(point[k].x);
            d.point[at][1] = vulkan_bits(point[k].y);
            d.point[at][2] = vulkan_bits(point[k].z);
            d.point[at++][3] = here;
            tile[k] = UINT32_MAX;
        }
    }
    d.first[d.groups] = at;
    return d;
}

OXL_INTERNAL void vulkan_add_depths(struct vulkan_renderer *r, const struct depth_point *point, int points,
                                    double weight)
{
    struct vulkan_depths d;
    if (points == 0) return;
    d = vulkan_group_depths(r, point, points);
    if (d.groups == 0) return;
    vulkan_reserve(r->v, &r->depth_points, DEPTH_POINTS, sizeof d.point[0], "points");
    vulkan_reserve(r->v, &r->depth_first, DEPTH_POINTS + 1, sizeof d.first[0], "points");
    vulkan_update(r->v, &r->depth_points, 0, d.point, sizeof d.point);
    vulkan_update(r->v, &r->depth_first, 0, d.first, sizeof d.first);
    VULKAN_RUN(r->v, DEPTH_LOSS, 0, d.groups,
               VULKAN_PUSH(vulkan_bits((float)weight), (uint32_t)r->lobes, d.groups, (uint32_t)r->count),
               VULKAN_BUFFERS(&r->view_buffer, &r->depth_points, &r->depth_first, &r->start,
                              &r->pair_value[r->sort_end], &r->staged, &r->splat_a, &r->splat_b, &r->splat_c,
                              &r->sums_a, &r->counts));
}
