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

/* ---------------- scanning and sorting */

/* Exclusive prefix sums of n numbers, in place; the total goes to counts[slot]: 0, and the steps halt, if it
 * is more than `most`. */
static void vulkan_scan(struct vulkan_renderer *r, const struct vulkan_buffer *data, size_t n,
                        enum vulkan_count slot, uint32_t most)
{
    const uint32_t push[3] = {(uint32_t)n, slot, most}, sums[3] = {(uint32_t)vulkan_chunks(n), slot, most};
    if (n <= VULKAN_SCAN_WHOLE) {
        VULKAN_RUN(r->v, SCAN, 1, 1, push, VULKAN_BUFFERS(data, &r->counts, NULL));
        return;
    }
    VULKAN_RUN(r->v, SCAN, 0, vulkan_chunks(n), push, VULKAN_BUFFERS(data, &r->counts, &r->scan_sums));
    VULKAN_RUN(r->v, SCAN, 1, 1, sums, VULKAN_BUFFERS(&r->scan_sums, &r->counts, NULL));
    VULKAN_RUN(r->v, SCAN, 2, vulkan_chunks(n), push, VULKAN_BUFFERS(data, &r->counts, &r->scan_sums));
}

/* counts[slot] keys, `most` at most, by their lowest `bits`; returns which of the two holds them sorted. */
static int vulkan_sort(struct vulkan_renderer *r, struct vulkan_buffer key[2], struct vulkan_buffer value[2],
                       enum vulkan_count slot, size_t most, uint32_t bits)
{
    const size_t chunks = vulkan_chunks(most);
    int at = 0;
    for (uint32_t shift = 0; shift < bits && chunks > 0; shift += VULKAN_DIGIT, at ^= 1) {
        const uint32_t push[3] = {slot, shift, (uint32_t)chunks};
        VULKAN_RUN(r->v, SORT_COUNT, 0, chunks, push, VULKAN_BUFFERS(&r->counts, &key[at], &r->histogram));
        VULKAN_RUN(r->v, SCAN, 3, VULKAN_DIGITS / 8, VULKAN_PUSH((uint32_t)chunks, 0, 0),
                   VULKAN_BUFFERS(&r->histogram, &r->counts, &r->digits));
        VULKAN_RUN(r->v, SORT_SCATTER, 0, chunks, push,
                   VULKAN_BUFFERS(&r->counts, &key[at], &r->histogram, &r->digits, &key[at ^ 1], &value[at],
                                  &value[at ^ 1]));
    }
    return at;
}

/* ---------------- forward */

static void vulkan_take_view(struct vulkan_renderer *r, const oxl_model *model, const oxl_camera *c,
                             const oxl_render_options *o, const struct renderer_settings *settings)
{
    const uint32_t on = HALT_NONE;
    const struct kernel_camera k = *settings->camera;
    r->view = (struct vulkan_view){.rotation = {k.rotation.x.x, k.rotation.x.y, k.rotation.x.z,
                                                k.rotation.y.x, k.rotation.y.y, k.rotation.y.z,
                                                k.rotation.z.x, k.rotation.z.y, k.rotation.z.z},
                                   .translation = {k.translation.x, k.translation.y, k.translation.z},
                                   .eye = {k.eye.x, k.eye.y, k.eye.z},
                                   .fx = k.fx,
                                   .fy = k.fy,
                                   .cx = k.cx,
                                   .cy = k.cy,
                                   .limit_x = k.limit_x,
                                   .limit_y = k.limit_y,
                                   .near_plane = k.near_plane,
                                   .background = {o->background[0], o->background[1], o->background[2]},
                                   .alpha_min = k.alpha_min,
                                   .cut = k.cutoff_bits,
                                   .width = (uint32_t)c->width,
                                   .height = (uint32_t)c->height,
                                   .tiles_x = (uint32_t)(c->width + TILE - 1) / TILE,
                                   .tiles_y = (uint32_t)(c->height + TILE - 1) / TILE,
                                   .infinity = VULKAN_INFINITY,
                                   .antialias = (uint32_t)model->antialias,
                                   .half_width = k.half_width,
                                   .half_height = k.half_height};
    vulkan_take_settings(r, settings);
    r->window_fraction = (float)((size_t)c->width * (size_t)c->height) / (4 * k.half_width * k.half_height);
    r->tiles = (size_t)r->view.tiles_x * r->view.tiles_y;
    vulkan_reserve(r->v, &r->rgb, (size_t)c->width * (size_t)c->height, 12, "pixels");
    vulkan_reserve(r->v, &r->start, r->tiles + 1, 4, "tiles");
    vulkan_update(r->v, &r->view_buffer, 0, &r->view, sizeof r->view);
    /* of a step that was given up */
    if (!r->deferred) vulkan_update(r->v, &r->counts, COUNT_HALT * sizeof on, &on, sizeof on);
}

/* Rows of the model, or of the context behind them. */
static void vulkan_project_slabs(struct vulkan_renderer *r, const struct vulkan_renderer *of)
{
    const uint32_t variant = (uint32_t)r->in_medium + 2 * (uint32_t)r->drops + (of == r ? 0 : 4);
    uint32_t push[6];
    for (size_t s = 0; s < of->slabs; s++) {
        vulkan_row_push(of, s, push);
        if (of != r) push[0] += (uint32_t)r->count, push[3] = (uint32_t)of->sh_degree;
        VULKAN_RUN(r->v, PROJECT, variant, vulkan_groups(push[1]), push,
                   VULKAN_BUFFERS(&r->view_buffer, &of->slab[s].parameter, &r->splat_a, &r->splat_b,
                                  &r->splat_c, &r->seen, &r->lobe_a, &r->lobe_b, &r->rank, &r->counts));
    }
}

static void vulkan_project(struct vulkan_renderer *r)
{
    vulkan_project_slabs(r, r);
    if (r->rows > r->count) vulkan_project_slabs(r, r->context);
}

static void vulkan_footprint(struct vulkan_renderer *r, uint32_t variant)
{
    VULKAN_RUN(r->v, FOOTPRINT, variant, vulkan_groups(r->rows),
               VULKAN_PUSH((uint32_t)r->lobes, (uint32_t)r->rows),
               VULKAN_BUFFERS(&r->view_buffer, &r->counts, &r->row_value[0], &r->splat_a, &r->splat_b,
                              &r->lobe_a, &r->lobe_b, &r->row_pairs, &r->pair_key[0], &r->pair_value[0],
                              &r->staged, &r->row_slots));
}

/* Up to the number of pairs. The host makes room for them: it waits for the number, or, in a deferred step,
 * keeps to the room there is. */
static void vulkan_order_rows(struct vulkan_renderer *r)
{
    struct vulkan *v = r->v;
    uint32_t pairs = 0;
    const int waits = !r->deferred || r->room == 0;
    vulkan_project(r);
    vulkan_scan(r, &r->rank, r->rows, COUNT_VISIBLE, UINT32_MAX);
    VULKAN_RUN(v, COMPACT, 0, vulkan_groups(r->rows), VULKAN_PUSH((uint32_t)r->rows),
               VULKAN_BUFFERS(&r->seen, &r->rank, &r->splat_c, &r->row_key[0], &r->row_value[0], &r->counts));
    /* 4 digits: it ends where it began */
    vulkan_sort(r, r->row_key, r->row_value, COUNT_VISIBLE, r->rows, 32);
    vulkan_footprint(r, 0);
    vulkan_scan(r, &r->row_pairs, r->rows, COUNT_PAIRS, waits ? UINT32_MAX : (uint32_t)r->room);
    r->pairs = r->room;
    if (!waits) return;
    vulkan_download(v, &r->counts, COUNT_PAIRS * sizeof pairs, &pairs, sizeof pairs);
    r->pairs = pairs;
    if (pairs == UINT32_MAX && v->rc == OXL_OK)
        v->rc =
            oxl_fail(v->ctx, OXL_ERR_MEMORY,
                     "more (tile, splat) pairs in one view than can be numbered\nfix: a smaller --max-side");
}

static void vulkan_order_pairs(struct vulkan_renderer *r)
{
    struct vulkan *v = r->v;
    uint32_t bits = 1;
    while (r->tiles >> bits) bits++;
    vulkan_footprint(r, 1);
    r->sort_end = vulkan_sort(r, r->pair_key, r->pair_value, COUNT_PAIRS, r->pairs, bits);
    VULKAN_RUN(v, RANGES, 0, vulkan_groups(r->tiles + 1), VULKAN_PUSH((uint32_t)r->tiles),
               VULKAN_BUFFERS(&r->pair_key[r->sort_end], &r->start, &r->counts));
}

/* Calls draw(r, part, argument) for the whole image, or for the tiles whose first pair is in a part of the
 * pairs, each part a
 * submission of its own: an operating system resets a GPU that is busy for longer than 2 s with one (Windows'
 * default). The shader looks whether a tile is in the part, so the host need not know the tiles' pairs.
 * docs/log/SPEED.md has the estimates. */
static void vulkan_in_parts(struct vulkan_renderer *r,
                            void (*draw)(struct vulkan_renderer *r, const uint32_t part[2],
                                         uint32_t argument),
                            uint32_t argument)
{
    const size_t most = r->v->part, parts = most ? OXL_MAX((r->pairs + most - 1) / most, (size_t)1) : 1;
    const size_t each = r->pairs / parts + 1;
    if (parts > 1) vulkan_flush(r->v);
    for (size_t k = 0; k < parts; k++) {
        const uint32_t part[2] = {(uint32_t)(k * each),
                                  k + 1 < parts ? (uint32_t)((k + 1) * each) : UINT32_MAX};
        draw(r, part, argument);
        if (parts > 1) vulkan_flush(r->v);
    }
}

static void vulkan_draw_part(struct vulkan_renderer *r, const uint32_t part[2], uint32_t depths)
{
    const uint32_t push[4] = {(uint32_t)r->lobes, part[0], part[1], depths};
    const uint32_t variant = r->veil_trains && !depths;
    if (r->lobes)
        VULKAN_RUN(r->v, RASTER_LOBED, variant, r->tiles, push,
                   VULKAN_BUFFERS(&r->view_buffer, &r->start, &r->pair_value[r->sort_end], &r->staged,
                                  &r->splat_a, &r->splat_b, &r->splat_c, &r->lobe_a, &r->rgb, &r->through));
    else
        VULKAN_RUN(r->v, RASTER, variant, r->tiles, push,
                   VULKAN_BUFFERS(&r->view_buffer, &r->start, &r->pair_value[r->sort_end], &r->staged,
                                  &r->splat_a, &r->splat_b, &r->splat_c, NULL, &r->rgb, &r->through));
}

static void vulkan_draw(struct vulkan_renderer *r, int depths)
{
    vulkan_in_parts(r, vulkan_draw_part, (uint32_t)depths);
}

static void vulkan_reserve_pairs(struct vulkan_renderer *r, struct vulkan_buffer *b, size_t element)
{
    if (r->low_memory) vulkan_reserve_exactly(r->v, b, r->pairs, element, "(tile, splat) pairs");
    else vulkan_reserve(r->v, b, r->pairs, element, "(tile, splat) pairs");
}

static void vulkan_reserve_sums(struct vulkan_renderer *r, int score)
{
    vulkan_reserve_pairs(r, &r->sums_a, 16);
    if (score) return;
    vulkan_reserve_pairs(r, &r->sums_b, 16);
    vulkan_reserve_pairs(r, &r->sums_c, 4);
    if (r->lobes) vulkan_reserve_pairs(r, &r->sums_d, 16);
    if (r->lobes) vulkan_reserve_pairs(r, &r->sums_e, 8);
}

/* They bind and are pushed alike, but that those without second lobes leave out the last two bindings. */
static enum vulkan_pass vulkan_backward_pass(const struct vulkan *v, int lobed)
{
    VULKAN_SAME(SPIRV_RASTER_BACKWARD_4_LOBED_BINDINGS, VULKAN_BINDINGS);
    VULKAN_SAME(SPIRV_RASTER_BACKWARD_8_LOBED_BINDINGS, VULKAN_BINDINGS);
    if (lobed) return v->batch >= 8 ? PASS_RASTER_BACKWARD_8_LOBED : PASS_RASTER_BACKWARD_4_LOBED;
    return v->batch == 16  ? PASS_RASTER_BACKWARD_16
           : v->batch == 8 ? PASS_RASTER_BACKWARD_8
                           : PASS_RASTER_BACKWARD_4;
}

static uint32_t vulkan_loss_variant(const struct vulkan_renderer *r, int lit)
{
    return 2 * (uint32_t)lit + 4 * (uint32_t)(r->window_fraction != 1);
}

/* All that a step needs, in forward: a step whose memory or shaders cannot be had has changed nothing then,
 * and the CPU can do it. */
static void vulkan_reserve_step(struct vulkan_renderer *r)
{
    const size_t pixels = (size_t)r->view.width * r->view.height;
    const uint32_t lit = (uint32_t)r->may_be_lit;
    for (uint32_t i = 0; i < 2; i++) {
        vulkan_prepare(r->v, PASS_LOSS_TOTAL, i);
        vulkan_prepare(r->v, PASS_LOSS_BACKWARD, vulkan_loss_variant(r, r->may_be_lit) + i);
    }
    vulkan_prepare(r->v, PASS_LOSS_FORWARD, lit);
    vulkan_prepare(r->v, PASS_STEP, 1);
    vulkan_prepare(r->v, PASS_STEP, 2 * (uint32_t)r->in_medium);
    vulkan_prepare(r->v, PASS_OBSERVE, (uint32_t)r->is_window);
    vulkan_prepare(r->v, vulkan_backward_pass(r->v, r->lobes > 0), 0);
    vulkan_reserve_sums(r, 0);
    vulkan_reserve(r->v, &r->target, pixels, 12, "pixels"); /* it may come with the loss */
    vulkan_reserve(r->v, &r->weight, pixels, 4, "pixels");
    vulkan_reserve(r->v, &r->drgb, pixels, 12, "pixels");
    for (int ch = 0; ch < 3; ch++) vulkan_reserve(r->v, &r->slope[ch], pixels, 12, "pixels");
    vulkan_reserve(r->v, &r->partial, 15 * r->tiles, 4, "tiles");
    vulkan_reserve_imaging(r);
    vulkan_reserve(r->v, &r->mean2d, r->count, 4, "Gaussians");
    vulkan_reserve(r->v, &r->statistics, r->count, 16, "Gaussians");
    vulkan_reserve_moments(r);
}

/* For the pairs found, or, where steps are deferred, for what the views behind this one may have. */
static void vulkan_reserve_view(struct vulkan_renderer *r, int steps)
{
    if (r->deferred && r->room == 0) {
        const size_t more = r->low_memory ? 0 : r->pairs / VULKAN_ROOM + VULKAN_CHUNK;
        r->room = OXL_MIN(r->pairs + more, (size_t)UINT32_MAX - 1);
        r->pairs = r->room;
    }
    for (int k = 0; k < 2; k++) {
        vulkan_reserve_pairs(r, &r->pair_key[k], 4);
        vulkan_reserve_pairs(r, &r->pair_value[k], 4);
    }
    vulkan_reserve_pairs(r, &r->staged, 8);
    vulkan_reserve(r->v, &r->histogram, VULKAN_DIGITS * vulkan_chunks(r->pairs), 4, "(tile, splat) pairs");
    if (steps) vulkan_reserve_step(r);
}

static void vulkan_release_pairs(struct vulkan_renderer *r)
{
    struct vulkan_buffer *by_pair[] = {&r->pair_key[0], &r->pair_key[1], &r->pair_value[0], &r->pair_value[1],
                                       &r->staged,      &r->sums_a,      &r->sums_b,        &r->sums_c,
                                       &r->sums_d,      &r->sums_e};
    vulkan_finish(r->v);
    for (size_t i = 0; i < OXL_COUNT(by_pair); i++) vulkan_release(r->v, by_pair[i]);
}

/* Where the memory is too short for that, what there is of room is given up, also that of earlier views, for
 * as much as this view needs;
 * after a failure, for others. */
static void vulkan_make_pair_room(struct vulkan_renderer *r, int steps)
{
    struct vulkan *v = r->v;
    const int counted = !r->deferred || r->room == 0; /* else r->pairs is the room there is */
    const size_t found = r->pairs;
    if (v->rc != OXL_OK) return;
    if (counted && r->deferred) r->pairs = OXL_MAX(r->pairs, r->most_pairs);
    vulkan_reserve_view(r, steps);
    if (v->rc == OXL_OK) return;
    vulkan_release_pairs(r);
    if (!counted || (r->low_memory && r->pairs == found) || !vulkan_may_retry(v)) return;
    r->low_memory = 1;
    r->room = 0;
    r->pairs = found;
    vulkan_reserve_view(r, steps);
    if (v->rc != OXL_OK) vulkan_release_pairs(r);
}

static oxl_result vulkan_forward(void *device, const oxl_model *model, const oxl_camera *camera,
                                 const oxl_render_options *options, const struct renderer_settings *settings,
                                 int steps)
{
    struct vulkan_renderer *r = device;
    if (r->stepped && (r->model != model || r->plane != model->plane[0])) {
        /* another model is rendered in between */
        const oxl_result rc = vulkan_download_model(device, DOWNLOAD_TO_CHANGE);
        if (rc != OXL_OK) return rc;
    }
    vulkan_enter(r->v);
    vulkan_take_model(r, model);
    vulkan_take_context(r, settings->context);
    r->drawn_sh_degree = options->sh_degree < 0 || options->sh_degree > model->sh_degree ? model->sh_degree
                                                                                         : options->sh_degree;
    vulkan_take_view(r, model, camera, options, settings);
    if (r->veil_trains)
        vulkan_reserve(r->v, &r->through, (size_t)camera->width * (size_t)camera->height, 4, "pixels");
    vulkan_order_rows(r);
    vulkan_make_pair_room(r, steps);
    vulkan_order_pairs(r);
    vulkan_draw(r, 0);
    return r->v->rc;
}

static oxl_result vulkan_depth(void *device, float *depth)
{
    struct vulkan_renderer *r = device;
    vulkan_enter(r->v);
    vulkan_draw(r, 1);
    vulkan_download(r->v, &r->rgb, 0, depth, 4 * (size_t)r->view.width * r->view.height);
    return r->v->rc;
}

static oxl_result vulkan_image(void *device, float *rgb)
{
    struct vulkan_renderer *r = device;
    vulkan_enter(r->v);
    vulkan_download(r->v, &r->rgb, 0, rgb, 12 * (size_t)r->view.width * r->view.height);
    return r->v->rc;
}

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
                              const struct renderer_gains *gains, float ssim_weight,
                              struct renderer_loss *out)
{
    struct vulkan_renderer *r = device;
    struct vulkan *v = r->v;
    const size_t pixels = (size_t)r->view.width * r->view.height;
    float total[OXL_COUNT(r->report->totals)];
    r->exposed = gains->gain != NULL;
    if (gains->gain) memcpy(r->gain, gains->gain, sizeof r->gain);
    r->contrast = gains->contrast > 0 ? (float)(gains->contrast * gains->contrast) : 9e-4f;
    vulkan_enter(v);
    vulkan_draw_lamp(r, gains);
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

static void vulkan_draw_backward_part(struct vulkan_renderer *r, const uint32_t part[2], uint32_t score)
{
    vulkan_run(r->v, vulkan_backward_pass(r->v, r->lobes > 0), 2 * score, r->tiles,
               VULKAN_PUSH((uint32_t)r->lobes, part[0], part[1], 0),
               VULKAN_BUFFERS(&r->view_buffer, &r->start, &r->pair_value[r->sort_end], &r->staged,
                              &r->splat_a, &r->splat_b, &r->splat_c, r->lobes ? &r->lobe_a : NULL, &r->rgb,
                              &r->drgb, &r->sums_a, &r->sums_b, &r->sums_c, &r->sums_d, &r->sums_e));
}

static void vulkan_draw_backward(struct vulkan_renderer *r, uint32_t score)
{
    vulkan_reserve_sums(r, (int)score);
    vulkan_in_parts(r, vulkan_draw_backward_part, score);
}

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
    return (struct renderer_nonfinite){counts[0], counts[0] ? counts[1] : SIZE_MAX, counts[2]};
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

static oxl_result vulkan_step(void *device, struct trained_model *trained, const struct adam_params *adam,
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
    vulkan_imaging_of(here->imaging, out->loss.dlamp, out->loss.dmedium);
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
                                                     .imaging_gradient = vulkan_imaging_gradient,
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
