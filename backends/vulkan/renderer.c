/* renderer.c - the renderer on a Vulkan device: the functions of struct renderer_device, each as a few passes
 * of the shaders in shaders/.
 *
 * A step (compare src/render/renderer.c; the arrows are where the host waits, but in deferred steps, which
 * report later):
 *     project, sort by depth, count the pairs  ->  emit the pairs, sort by tile, rasterize,
 *     loss  ->  backward, Adam, statistics  ->
 *
 * Invariants: no atomics on floats, and every sum has a written order, so a device repeats its own results.
 * It does not give the CPU's bytes: order of sums and rounding of single operations differ
 * (tests/test_vulkan.c has the bounds).
 */
#include "resident.h"
#include "../../src/render/kernels.h"
#include "../../src/core/vecmath.h"

/* ---------------- loss */

static void vulkan_compare(struct vulkan_renderer *r, float ssim_weight, int masked)
{
    const float *gain = r->exposed ? r->gain : (const float[3]){1, 1, 1};
    const uint32_t push[10] = {r->view.width,
                               r->view.height,
                               (uint32_t)r->tiles,
                               vulkan_bits(ssim_weight),
                               (uint32_t)masked,
                               vulkan_bits(gain[0]),
                               vulkan_bits(gain[1]),
                               vulkan_bits(gain[2]),
                               vulkan_bits(r->contrast),
                               vulkan_bits(r->window_fraction)};
    const uint32_t total[4] = {3 * (uint32_t)r->tiles, vulkan_bits(ssim_weight), (uint32_t)r->deferred,
                               VULKAN_INFINITY};
    VULKAN_RUN(r->v, LOSS_FORWARD, (uint32_t)r->lit, 3 * r->tiles, push,
               VULKAN_BUFFERS(&r->rgb, &r->target, &r->weight, &r->slope[0], &r->slope[1], &r->slope[2],
                              &r->partial, &r->lamp));
    VULKAN_RUN(r->v, LOSS_TOTAL, 0, 1, total, VULKAN_BUFFERS(&r->partial, &r->totals, &r->counts));
    VULKAN_RUN(r->v, LOSS_BACKWARD, vulkan_loss_variant(r, r->lit) + (uint32_t)r->exposed, 3 * r->tiles, push,
               VULKAN_BUFFERS(&r->rgb, &r->target, &r->weight, &r->slope[0], &r->slope[1], &r->slope[2],
                              &r->totals, &r->drgb, &r->partial, &r->lamp));
    if (r->exposed)
        VULKAN_RUN(r->v, LOSS_TOTAL, 1, 1, total, VULKAN_BUFFERS(&r->partial, &r->totals, &r->counts));
}

/* total: of struct vulkan_report. */
static struct renderer_loss vulkan_loss_of(const float total[8], float ssim_weight)
{
    struct renderer_loss out = {.l1 = total[3] > 0 ? (double)total[0] / total[3] : 0,
                                .ssim = total[4] > 0 ? ssim_weight > 0 ? (double)total[1] / total[4] : 0 : 1,
                                .mse = total[3] > 0 ? (double)total[2] / total[3] : 0,
                                .dlog_gain = {total[5], total[6], total[7]}};
    out.total = (1 - (double)ssim_weight) * out.l1 + (double)ssim_weight * (1 - out.ssim);
    return out;
}

static oxl_result vulkan_loss(void *device, const float *rgb, const float *weight,
                              const struct renderer_settings *settings, const struct lamp_area *area,
                              float ssim_weight, struct renderer_loss *out)
{
    struct vulkan_renderer *r = device;
    struct vulkan *v = r->v;
    const size_t pixels = (size_t)r->view.width * r->view.height;
    float total[OXL_COUNT(r->report->totals)];
    r->exposed = settings->gain != NULL;
    if (r->exposed) memcpy(r->gain, settings->gain, sizeof r->gain);
    r->contrast = settings->contrast > 0 ? (float)(settings->contrast * settings->contrast) : 9e-4f;
    vulkan_enter(v);
    vulkan_draw_lamp(r, settings->lamp, area);
    if (rgb) vulkan_reserve(v, &r->target, pixels, 12, "pixels");
    vulkan_reserve(v, &r->drgb, pixels, 12, "pixels");
    vulkan_reserve(v, &r->partial, 15 * r->tiles, 4, "tiles");
    for (int ch = 0; ch < 3 && ssim_weight > 0; ch++) vulkan_reserve(v, &r->slope[ch], pixels, 12, "pixels");
    if (weight) vulkan_reserve(v, &r->weight, pixels, 4, "pixels");
    if (rgb) vulkan_upload(v, &r->target, 0, rgb, 12 * pixels);
    if (weight) vulkan_upload(v, &r->weight, 0, weight, 4 * pixels);
    vulkan_compare(r, ssim_weight, rgb ? weight != NULL : r->masked);
    r->ssim_weight = ssim_weight;
    if (r->deferred) return v->rc;
    vulkan_download(v, &r->totals, 0, total, sizeof total);
    if (v->rc == OXL_OK) *out = vulkan_loss_of(total, ssim_weight);
    return v->rc;
}

/* ---------------- backward and score */

static void vulkan_take_drgb(struct vulkan_renderer *r, const float *drgb)
{
    const size_t pixels = (size_t)r->view.width * r->view.height;
    vulkan_reserve(r->v, &r->drgb, pixels, 12, "pixels");
    vulkan_upload(r->v, &r->drgb, 0, drgb, 12 * pixels);
}

static oxl_result vulkan_backward(void *device, const float *drgb, const struct depth_point *point,
                                  int points, double weight)
{
    struct vulkan_renderer *r = device;
    vulkan_enter(r->v);
    if (drgb) vulkan_take_drgb(r, drgb);
    vulkan_draw_backward(r, 0);
    vulkan_add_depths(r, point, points, weight);
    vulkan_add_imaging(r);
    return r->v->rc;
}

/* Rows that were not seen have none: the device leaves theirs as they were. */
static void vulkan_download_plane(struct vulkan_renderer *r, size_t slab, uint32_t plane,
                                  const uint32_t *seen, float *out)
{
    const size_t rows = vulkan_slab_rows(r, slab, plane < r->lobe_plane ? r->count : r->lobes),
                 first = slab * r->stride;
    const int past = plane < r->lobe_plane &&
                     plane >= (uint32_t)(OXL_SH + 3 * (r->drawn_sh_degree + 1) * (r->drawn_sh_degree + 1));
    if (rows == 0 || past) return;
    vulkan_download(r->v, &r->slab[slab].gradient, (size_t)plane * r->stride * sizeof(float), out + first,
                    rows * sizeof(float));
    for (size_t i = first; i < first + rows && r->v->rc == OXL_OK; i++)
        if (!seen[i]) out[i] = 0;
}

/* A step has no use for the gradient as such (project_backward.comp). */
static void vulkan_project_backward(struct vulkan_renderer *r)
{
    uint32_t push[6];
    vulkan_reserve(r->v, &r->mean2d, r->count, 4, "Gaussians");
    for (size_t s = 0; s < r->slabs; s++) {
        vulkan_reserve(r->v, &r->slab[s].gradient, (size_t)r->stride * r->planes, sizeof(float),
                       "numbers of Gaussians");
        vulkan_row_push(r, s, push);
        VULKAN_RUN(r->v, PROJECT_BACKWARD, 2 * (uint32_t)r->in_medium, vulkan_groups(push[1]), push,
                   VULKAN_BUFFERS(&r->view_buffer, &r->slab[s].parameter, &r->seen, &r->row_slots, &r->sums_a,
                                  &r->sums_b, &r->sums_c, &r->sums_d, &r->sums_e, &r->mean2d,
                                  &r->slab[s].gradient));
    }
}

static oxl_result vulkan_gradient(void *device, oxl_model *gradient)
{
    struct vulkan_renderer *r = device;
    uint32_t *seen = oxl_alloc(r->v->ctx, r->count + 1, sizeof *seen);
    if (!seen) return oxl_fail(r->v->ctx, OXL_ERR_MEMORY, "no memory for a gradient");
    vulkan_enter(r->v);
    vulkan_project_backward(r);
    vulkan_download(r->v, &r->seen, 0, seen, r->count * sizeof *seen);
    for (size_t s = 0; s < r->slabs; s++)
        for (uint32_t k = 0; k < r->planes; k++)
            vulkan_download_plane(r, s, k, seen, vulkan_host_plane(gradient, r, k));
    oxl_free(r->v->ctx, seen);
    return r->v->rc;
}

static oxl_result vulkan_score(void *device, const float *drgb, float *score)
{
    struct vulkan_renderer *r = device;
    struct vulkan *v = r->v;
    float *one = oxl_alloc(v->ctx, r->count + 1, sizeof *one);
    if (!one) return oxl_fail(v->ctx, OXL_ERR_MEMORY, "no memory for the scores of %zu Gaussians", r->count);
    vulkan_enter(v);
    vulkan_take_drgb(r, drgb);
    vulkan_draw_backward(r, 1);
    vulkan_reserve(v, &r->score, r->count, 4, "Gaussians");
    VULKAN_RUN(v, SCORE, 0, vulkan_groups(r->count), VULKAN_PUSH((uint32_t)r->count),
               VULKAN_BUFFERS(&r->seen, &r->row_slots, &r->sums_a, &r->score));
    vulkan_download(v, &r->score, 0, one, r->count * sizeof *one);
    for (size_t i = 0; v->rc == OXL_OK && i < r->count; i++) score[i] += one[i];
    oxl_free(v->ctx, one);
    return v->rc;
}

/* ---------------- step and statistics */

/* counts: from COUNT_NONFINITE on. */
static struct renderer_nonfinite vulkan_nonfinite_of(const uint32_t counts[3])
{
    return (struct renderer_nonfinite){counts[0], counts[2]};
}

static oxl_result vulkan_read_nonfinite(struct vulkan_renderer *r, struct renderer_nonfinite *out)
{
    uint32_t counts[3] = {0, 0, 0};
    vulkan_download(r->v, &r->counts, COUNT_NONFINITE * sizeof *counts, counts, sizeof counts);
    *out = vulkan_nonfinite_of(counts);
    return r->v->rc;
}

/* Variant 0: a step, 2: in a medium, numbers: as pushed; 1: rows that are not finite are cleared, and the
 * splats are bound in place of sums. Where a slab was stepped and the next one cannot be, the device is given
 * up: who repeated the step would step the first one twice. */
static void vulkan_run_step(struct vulkan_renderer *r, uint32_t variant, const uint32_t numbers[3])
{
    const uint32_t none[3] = {0, UINT32_MAX, 0};
    const int clears = variant == 1;
    const size_t before = r->v->dispatches;
    uint32_t push[6];
    vulkan_update(r->v, &r->counts, COUNT_NONFINITE * sizeof *none, none, sizeof none);
    for (size_t s = 0; s < r->slabs; s++) {
        vulkan_row_push(r, s, push);
        VULKAN_RUN(r->v, STEP, variant, vulkan_groups(push[1]),
                   VULKAN_PUSH(push[0], push[1], push[2], push[3], push[4], push[5], numbers[0], numbers[1],
                               numbers[2]),
                   VULKAN_BUFFERS(&r->view_buffer, &r->slab[s].parameter, &r->seen, &r->row_slots,
                                  clears ? &r->splat_a : &r->sums_a, clears ? &r->splat_b : &r->sums_b,
                                  &r->sums_c, clears ? &r->splat_c : &r->sums_d, &r->sums_e, &r->mean2d,
                                  &r->slab[s].mean, &r->slab[s].square, &r->counts, &r->rates));
    }
    if (r->v->rc != OXL_OK && !r->v->lost && r->v->dispatches > before)
        vulkan_give_up(r->v, VK_ERROR_OUT_OF_HOST_MEMORY);
}

/* Of a deferred one: its report is on the way when the host goes on to the next. */
static oxl_result vulkan_end_step(struct vulkan_renderer *r)
{
    struct vulkan *v = r->v;
    const size_t at = r->steps % VULKAN_REPORTS * sizeof *r->report;
    vulkan_copy(v, &r->counts, &r->reports, at + offsetof(struct vulkan_report, counts),
                sizeof r->report->counts);
    vulkan_copy(v, &r->totals, &r->reports, at + offsetof(struct vulkan_report, totals),
                sizeof r->report->totals + sizeof r->report->imaging);
    r->steps += vulkan_next_frame(v) == OXL_OK;
    return v->rc;
}

static oxl_result vulkan_step(void *device, struct trained_model *trained, const oxl_adam *adam,
                              struct renderer_nonfinite *out)
{
    struct vulkan_renderer *r = device;
    struct vulkan *v = r->v;
    const double correction = 1 - vecmath_exp(adam->step * vecmath_log(adam->beta[0]));
    const float inverse = (float)(1 / sqrt(1 - vecmath_exp(adam->step * vecmath_log(adam->beta[1]))));
    float rate[OXL_PLANES];
    const uint32_t numbers[3] = {vulkan_bits((float)adam->beta[0]), vulkan_bits((float)adam->beta[1]),
                                 vulkan_bits(inverse)};
    vulkan_enter(v);
    for (uint32_t k = 0; k < r->planes; k++)
        rate[k] = (float)(adam->rate[k < r->lobe_plane ? k : OXL_LOBE + k - r->lobe_plane] / correction);
    vulkan_take_moments(r, trained);
    vulkan_reserve(v, &r->mean2d, r->count, 4, "Gaussians");
    vulkan_update(v, &r->rates, 0, rate, r->planes * sizeof *rate);
    vulkan_run_step(r, 2 * (uint32_t)r->in_medium, numbers);
    if (r->v->rc == OXL_OK) r->stepped = 1;
    if (r->deferred) return vulkan_end_step(r);
    return vulkan_read_nonfinite(r, out);
}

static oxl_result vulkan_clear_nonfinite(void *device, struct trained_model *trained,
                                         struct renderer_nonfinite *out)
{
    struct vulkan_renderer *r = device;
    vulkan_enter(r->v);
    vulkan_take_moments(r, trained);
    vulkan_run_step(r, 1, (const uint32_t[3]){0, 0, 0});
    if (r->v->rc == OXL_OK) r->stepped = 1;
    return vulkan_read_nonfinite(r, out);
}

static int vulkan_defer(void *device, int on)
{
    struct vulkan_renderer *r = device;
    r->deferred = on;
    return on;
}

static oxl_result vulkan_report(void *device, int wait, struct renderer_report *out)
{
    struct vulkan_renderer *r = device;
    const struct vulkan_report *here = &r->report[r->reported % VULKAN_REPORTS];
    const uint32_t on = HALT_NONE;
    vulkan_enter(r->v);
    *out = (struct renderer_report){0};
    if (wait ? vulkan_finish(r->v) != OXL_OK || r->reported == r->steps
             : r->steps - r->reported < VULKAN_REPORTS)
        return r->v->rc;
    r->reported++;
    r->most_pairs = OXL_MAX(r->most_pairs, (size_t)here->counts[COUNT_PAIRS_FOUND]);
    *out = (struct renderer_report){1, here->counts[COUNT_HALT], vulkan_loss_of(here->totals, r->ssim_weight),
                                    vulkan_nonfinite_of(here->counts + COUNT_NONFINITE)};
    vulkan_imaging_of(here->imaging, out->loss.dlamp);
    if (out->halt == HALT_NONE) return OXL_OK;
    r->reported = r->steps; /* those behind it did nothing */
    r->room = 0;            /* to be found anew */
    vulkan_update(r->v, &r->counts, COUNT_HALT * sizeof on, &on, sizeof on);
    r->v->relied_on = 1;
    return vulkan_finish(r->v);
}

static oxl_result vulkan_observe(void *device, const struct renderer_sums *sums)
{
    struct vulkan_renderer *r = device;
    struct vulkan *v = r->v;
    const float z_near = sums->banded ? sums->z_near : FLT_MAX, z_far = sums->banded ? sums->z_far : FLT_MAX;
    vulkan_enter(v);
    r->sums = *sums;
    vulkan_reserve(v, &r->statistics, r->count, 16, "Gaussians");
    if (!r->sums_here) vulkan_copy_sums(r, 1);
    r->observed = r->sums_here = v->rc == OXL_OK;
    VULKAN_RUN(v, OBSERVE, (uint32_t)r->is_window, vulkan_groups(r->count),
               VULKAN_PUSH((uint32_t)r->count, vulkan_bits(z_near), vulkan_bits(z_far),
                           vulkan_bits((float)r->view.width), vulkan_bits((float)r->view.height)),
               VULKAN_BUFFERS(&r->seen, &r->mean2d, &r->splat_c, &r->statistics, &r->counts, &r->splat_a));
    return v->rc;
}

static oxl_result vulkan_clear_visible(void *device)
{
    struct vulkan_renderer *r = device;
    vulkan_enter(r->v);
    vulkan_fill(r->v, &r->seen, 0, VK_WHOLE_SIZE, 0);
    return r->v->rc;
}

OXL_INTERNAL const struct renderer_device *vulkan_functions(void)
{
    static const struct renderer_device interface = {.create = vulkan_renderer_create,
                                                     .free = vulkan_renderer_free,
                                                     .forward = vulkan_forward,
                                                     .image = vulkan_image,
                                                     .depth = vulkan_depth,
                                                     .has_image = vulkan_has_image,
                                                     .take_image = vulkan_take_image,
                                                     .target = vulkan_target,
                                                     .loss = vulkan_loss,
                                                     .backward = vulkan_backward,
                                                     .gradient = vulkan_gradient,
                                                     .lamp_gradient = vulkan_lamp_gradient,
                                                     .score = vulkan_score,
                                                     .step = vulkan_step,
                                                     .defer = vulkan_defer,
                                                     .report = vulkan_report,
                                                     .observe = vulkan_observe,
                                                     .download = vulkan_download_model,
                                                     .move_rows = vulkan_move_rows,
                                                     .send_shape = vulkan_send_shape,
                                                     .clear_visible = vulkan_clear_visible,
                                                     .clear_nonfinite = vulkan_clear_nonfinite};
    return &interface;
}
