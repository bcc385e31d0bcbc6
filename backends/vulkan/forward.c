/* forward.c - the forward pass on a device: projection, order of rows and pairs, rasters.
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
                             const oxl_render_options *o, const struct kernel_camera *kernel_camera,
                             const struct renderer_settings *settings)
{
    const uint32_t on = HALT_NONE;
    const struct kernel_camera k = *kernel_camera;
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
    vulkan_reserve(r->v, &r->start, 2 * r->tiles + 1, 4, "tiles");
    vulkan_update(r->v, &r->view_buffer, 0, &r->view, sizeof r->view);
    /* of a step that was given up */
    if (!r->deferred) vulkan_update(r->v, &r->counts, COUNT_HALT * sizeof on, &on, sizeof on);
}

/* Rows of the model, or of the surroundings behind them. */
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
    if (r->rows > r->count) vulkan_project_slabs(r, r->surroundings);
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

/* Draws `total` workgroups or pairs whole, or as so many parts, each a submission of its own: an operating
 * system resets a GPU that is busy for longer than 2 s with one (Windows' default). docs/log/SPEED.md has the
 * estimates. */
static void vulkan_in_parts(struct vulkan_renderer *r, size_t total,
                            void (*draw)(struct vulkan_renderer *r, uint32_t variant, size_t begin,
                                         size_t end),
                            uint32_t variant)
{
    const size_t most = r->v->part, parts = most ? OXL_MAX((r->pairs + most - 1) / most, (size_t)1) : 1;
    const size_t each = total / parts + 1;
    if (parts > 1) vulkan_flush(r->v);
    for (size_t k = 0; k < parts; k++) {
        draw(r, variant, k * each, k + 1 < parts ? (k + 1) * each : UINT32_MAX);
        if (parts > 1) vulkan_flush(r->v);
    }
}

/* Draws tiles whose first pair is in begin..end: the shader looks, so the host need not know their pairs. */
static void vulkan_draw_part(struct vulkan_renderer *r, uint32_t variant, size_t begin, size_t end)
{
    VULKAN_SAME((int)SPIRV_RASTER_LOBED_BINDINGS, (int)SPIRV_RASTER_BINDINGS);
    vulkan_run(r->v, r->lobes ? PASS_RASTER_LOBED : PASS_RASTER, variant, r->tiles,
               VULKAN_PUSH((uint32_t)r->lobes, (uint32_t)begin, (uint32_t)end),
               VULKAN_BUFFERS(&r->view_buffer, &r->start, &r->pair_value[r->sort_end], &r->staged,
                              &r->splat_a, &r->splat_b, &r->splat_c, r->lobes ? &r->lobe_a : NULL, &r->rgb,
                              &r->kept));
}

/* variant: as in raster.comp */
static void vulkan_draw(struct vulkan_renderer *r, uint32_t variant)
{
    vulkan_in_parts(r, r->pairs, vulkan_draw_part, variant);
    r->keeps = variant == 1;
}

/* By pair, and so many more. */
static void vulkan_reserve_pairs(struct vulkan_renderer *r, struct vulkan_buffer *b, size_t element,
                                 size_t more)
{
    (r->low_memory ? vulkan_reserve_exactly : vulkan_reserve)(r->v, b, r->pairs + more, element,
                                                              "(tile, splat) pairs");
}

/* Room for what the way back reads and writes; score: of the score alone. */
static void vulkan_reserve_backward(struct vulkan_renderer *r, int score)
{
    /* four numbers of 256 pixels a bucket */
    vulkan_reserve_pairs(r, &r->kept, 4096 / VULKAN_BUCKET, r->tiles * VULKAN_BUCKET);
    vulkan_reserve_pairs(r, &r->sums_a, 16, 0);
    if (score) return;
    vulkan_reserve_pairs(r, &r->sums_b, 16, 0);
    vulkan_reserve_pairs(r, &r->sums_c, 4, 0);
    if (r->lobes) vulkan_reserve_pairs(r, &r->sums_d, 16, 0);
    if (r->lobes) vulkan_reserve_pairs(r, &r->sums_e, 8, 0);
}

static enum vulkan_pass vulkan_backward_pass(const struct vulkan_renderer *r)
{
    return r->lobes ? PASS_RASTER_BACKWARD_LOBED : PASS_RASTER_BACKWARD;
}

/* Without second lobes the shader leaves out the last two bindings. */
static void vulkan_backward_part(struct vulkan_renderer *r, uint32_t variant, size_t begin, size_t end)
{
    const size_t last = OXL_MIN(end, r->tiles + r->pairs / (2 * VULKAN_BUCKET));
    VULKAN_SAME(SPIRV_RASTER_BACKWARD_LOBED_BINDINGS, VULKAN_BINDINGS);
    vulkan_run(r->v, vulkan_backward_pass(r), variant, last > begin ? last - begin : 0,
               VULKAN_PUSH((uint32_t)r->lobes, (uint32_t)begin, (uint32_t)last),
               VULKAN_BUFFERS(&r->view_buffer, &r->start, &r->pair_value[r->sort_end], &r->staged,
                              &r->splat_a, &r->splat_b, &r->splat_c, r->lobes ? &r->lobe_a : NULL, &r->rgb,
                              &r->kept, &r->drgb, &r->sums_a, &r->sums_b, &r->sums_c, &r->sums_d,
                              &r->sums_e));
}

OXL_INTERNAL void vulkan_draw_backward(struct vulkan_renderer *r, int score)
{
    vulkan_reserve_backward(r, score);
    if (!r->keeps) vulkan_draw(r, 1); /* it was not known that a step follows */
    vulkan_in_parts(r, r->tiles + r->pairs / (2 * VULKAN_BUCKET), vulkan_backward_part, 2 * (uint32_t)score);
}

OXL_INTERNAL uint32_t vulkan_loss_variant(const struct vulkan_renderer *r, int lit)
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
    vulkan_prepare(r->v, vulkan_backward_pass(r), 0);
    vulkan_reserve_backward(r, 0);
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
        vulkan_reserve_pairs(r, &r->pair_key[k], 4, 0);
        vulkan_reserve_pairs(r, &r->pair_value[k], 4, 0);
    }
    vulkan_reserve_pairs(r, &r->staged, 8, 0);
    vulkan_reserve(r->v, &r->histogram, VULKAN_DIGITS * vulkan_chunks(r->pairs), 4, "(tile, splat) pairs");
    if (steps) vulkan_reserve_step(r);
}

static void vulkan_release_pairs(struct vulkan_renderer *r)
{
    struct vulkan_buffer *by_pair[] = {&r->pair_key[0], &r->pair_key[1], &r->pair_value[0], &r->pair_value[1],
                                       &r->staged,      &r->sums_a,      &r->sums_b,        &r->sums_c,
                                       &r->sums_d,      &r->sums_e,      &r->kept};
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

OXL_INTERNAL oxl_result vulkan_forward(void *device, const oxl_model *model, const oxl_camera *camera,
                                       const oxl_render_options *options,
                                       const struct kernel_camera *kernel_camera,
                                       const oxl_model *surroundings,
                                       const struct renderer_settings *settings)
{
    struct vulkan_renderer *r = device;
    if (r->stepped && (r->model != model || r->plane != model->plane[0])) {
        /* another model is rendered in between */
        const oxl_result rc = vulkan_download_model(device, DOWNLOAD_TO_CHANGE);
        if (rc != OXL_OK) return rc;
    }
    vulkan_enter(r->v);
    vulkan_take_model(r, model);
    vulkan_take_surroundings(r, surroundings);
    r->drawn_sh_degree = options->sh_degree < 0 || options->sh_degree > model->sh_degree ? model->sh_degree
                                                                                         : options->sh_degree;
    vulkan_take_view(r, model, camera, options, kernel_camera, settings);
    vulkan_order_rows(r);
    vulkan_make_pair_room(r, settings->steps);
    vulkan_order_pairs(r);
    vulkan_draw(r, (uint32_t)settings->steps);
    return r->v->rc;
}

OXL_INTERNAL oxl_result vulkan_depth(void *device, float *depth)
{
    struct vulkan_renderer *r = device;
    vulkan_enter(r->v);
    vulkan_draw(r, 2);
    vulkan_download(r->v, &r->rgb, 0, depth, 4 * (size_t)r->view.width * r->view.height);
    return r->v->rc;
}

OXL_INTERNAL oxl_result vulkan_image(void *device, float *rgb)
{
    struct vulkan_renderer *r = device;
    vulkan_enter(r->v);
    vulkan_download(r->v, &r->rgb, 0, rgb, 12 * (size_t)r->view.width * r->view.height);
    return r->v->rc;
}
