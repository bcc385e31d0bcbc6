/* masks.c - masks of transients on a device: the counterpart of transients_mask in src/parts/transients.c.
 *
 * The points and their expected errors stay on the device between steps, so the host neither waits for an
 * image nor sends a mask. A step that finds no room, and is repeated, changes no expected error.
 */
#include "resident.h"
#include "../../src/render/kernels.h"

/* Sends positions and expected errors. */
static void vulkan_send_points(struct vulkan_renderer *r, const struct renderer_transients *t)
{
    float *position = oxl_alloc(r->v->ctx, 3 * t->points + 1, sizeof *position);
    if (!position)
        r->v->rc =
            oxl_fail(r->v->ctx, OXL_ERR_MEMORY, "no memory for the positions of %zu points", t->points);
    for (size_t i = 0; position && i < t->points; i++)
        for (size_t a = 0; a < 3; a++) position[3 * i + a] = (float)t->point[i].position[a];
    if (position) vulkan_upload(r->v, &r->position, 0, position, 3 * t->points * sizeof *position);
    vulkan_upload(r->v, &r->expected, 0, t->expected, t->points * sizeof *t->expected);
    oxl_free(r->v->ctx, position);
}

/* Takes memory and shaders for the view's masks. */
OXL_INTERNAL void vulkan_take_transients(struct vulkan_renderer *r, const struct renderer_transients *t)
{
    const int is_known = t && r->transients.expected == t->expected && r->transients.points == t->points;
    r->masks = t != NULL;
    if (!t) return;
    vulkan_reserve(r->v, &r->weight, (size_t)r->view.width * r->view.height, 4, "pixels");
    vulkan_reserve(r->v, &r->position, 3 * t->points, sizeof(float), "points");
    vulkan_reserve(r->v, &r->expected, t->points, sizeof(float), "points");
    vulkan_reserve(r->v, &r->place, t->points, sizeof(uint32_t), "points");
    vulkan_reserve(r->v, &r->square_error, (size_t)t->across * (size_t)t->down, 4, "squares");
    vulkan_reserve(r->v, &r->square_expected, (size_t)t->across * (size_t)t->down, 4, "squares");
    vulkan_reserve(r->v, &r->square_mark, (size_t)t->across * (size_t)t->down, 4, "squares");
    for (uint32_t variant = 0; variant < 2; variant++) {
        vulkan_prepare(r->v, PASS_TRANSIENTS_MEASURE, variant);
        vulkan_prepare(r->v, PASS_TRANSIENTS_APPLY, variant);
    }
    vulkan_prepare(r->v, PASS_TRANSIENTS_MARK, 0);
    if (!is_known) vulkan_send_points(r, t);
    if (r->v->rc == OXL_OK) r->transients = *t;
}

/* Masks the rendered view's transients in the weights of its image. */
OXL_INTERNAL void vulkan_mask_transients(struct vulkan_renderer *r)
{
    const struct renderer_transients *t = &r->transients;
    const uint32_t side = (uint32_t)t->side, across = (uint32_t)t->across, down = (uint32_t)t->down;
    const size_t pixels = (size_t)r->view.width * r->view.height, squares = (size_t)across * down;
    const uint32_t updated = t->update ? (uint32_t)t->points : 0;
    vulkan_fill(r->v, &r->square_expected, 0, VK_WHOLE_SIZE, 0);
    VULKAN_RUN(r->v, TRANSIENTS_MEASURE, (uint32_t)r->masked, vulkan_groups(OXL_MAX(squares, t->points)),
               VULKAN_PUSH(side, across, down, (uint32_t)t->points),
               VULKAN_BUFFERS(&r->view_buffer, &r->rgb, &r->target, &r->weight, &r->position, &r->expected,
                              &r->place, &r->square_error, &r->square_expected, &r->counts));
    VULKAN_RUN(r->v, TRANSIENTS_MARK, 0, vulkan_groups(squares),
               VULKAN_PUSH(r->view.width, r->view.height, side, across, down, (uint32_t)t->votes,
                           (uint32_t)t->near, vulkan_bits(t->error), vulkan_bits(t->times)),
               VULKAN_BUFFERS(&r->square_error, &r->square_expected, &r->square_mark, &r->counts));
    VULKAN_RUN(
        r->v, TRANSIENTS_APPLY, (uint32_t)r->masked, vulkan_groups(OXL_MAX(pixels, t->points)),
        VULKAN_PUSH(r->view.width, r->view.height, side, across, updated, vulkan_bits(t->rate),
                    vulkan_bits(t->most)),
        VULKAN_BUFFERS(&r->square_mark, &r->weight, &r->place, &r->square_error, &r->expected, &r->counts));
    if (updated && r->v->rc == OXL_OK) r->expected_newer = 1;
}

OXL_INTERNAL void vulkan_copy_expected(struct vulkan_renderer *r)
{
    if (r->expected_newer)
        vulkan_download(r->v, &r->expected, 0, r->transients.expected, r->transients.points * sizeof(float));
}
