/* images.c - training images that stay on the device.
 */
#include "resident.h"

OXL_INTERNAL int vulkan_has_image(const void *device, int view)
{
    const struct vulkan_renderer *r = device;
    return (size_t)view < r->image_capacity && r->image[view].bytes.handle;
}

/* In words as the shader reads them; the mask is behind the rest. */
static size_t vulkan_image_bytes(const struct training_image *image, int masked)
{
    const size_t pixels = (size_t)image->width * (size_t)image->height;
    return (3 * pixels + 3) / 4 * 4 + (masked ? (pixels + 3) / 4 * 4 : 0);
}

/* Each is an allocation, and a device may allow but 4096. */
static void vulkan_upload_image(struct vulkan *v, const struct training_image *image,
                                struct vulkan_training_image *to)
{
    const size_t pixels = (size_t)image->width * (size_t)image->height;
    to->width = (uint32_t)image->width;
    to->height = (uint32_t)image->height;
    to->mask_at = image->mask ? (uint32_t)vulkan_image_bytes(image, 0) : 0;
    vulkan_reserve_exactly(v, &to->bytes, vulkan_image_bytes(image, image->mask != NULL), 1,
                           "bytes of an image");
    vulkan_upload(v, &to->bytes, 0, image->rgb, 3 * pixels);
    if (image->mask) vulkan_upload(v, &to->bytes, to->mask_at, image->mask, pixels);
}

OXL_INTERNAL size_t vulkan_drop_images(struct vulkan *v, uint32_t but)
{
    size_t dropped = 0, bytes = 0, images = 0;
    for (const struct vulkan_renderer *r = v->renderers; r; r = r->next) images += r->images;
    if (images == 0 || (!but && vulkan_finish(v) != OXL_OK)) return 0; /* commands under way may name them */
    for (struct vulkan_renderer *r = v->renderers; r; r = r->next)
        for (size_t i = 0; i < r->image_capacity; i++) {
            const size_t size = r->image[i].bytes.size;
            if (!r->image[i].bytes.handle || (int)i == r->pinned_view || (but && r->image[i].frame == but))
                continue;
            vulkan_release(v, &r->image[i].bytes);
            r->image_bytes -= OXL_MIN(r->image_bytes, size);
            r->images--;
            dropped++, bytes += size;
        }
    if (dropped == 0) return 0;
    /* they are not to take what was just freed */
    v->image_bytes_max = OXL_MIN(v->image_bytes_max, bytes / 2);
    oxl_log(v->ctx, OXL_LOG_WARNING,
            "%s: no memory is left: %zu training images (%zu MiB) leave the device, %zu MiB may stay there",
            v->properties.deviceName, dropped, bytes >> 20, v->image_bytes_max >> 20);
    return dropped;
}

/* A place to keep an image of so many bytes, or NULL: the first ones are kept, the others are uploaded at
 * each use. */
static struct vulkan_training_image *vulkan_image_slot(struct vulkan_renderer *r, int view, size_t bytes)
{
    const size_t wanted = (size_t)view + 1, more = wanted + wanted / 2;
    if (r->v->budgets && vulkan_memory_left(r->v, r->v->kind) / 2 < bytes) return NULL;
    if (r->image_bytes + bytes > r->v->image_bytes_max ||
        r->images >= r->v->properties.limits.maxMemoryAllocationCount / 2)
        return NULL;
    if (wanted > r->image_capacity) {
        struct vulkan_training_image *grown =
            oxl_regrow(r->v->ctx, r->image, r->image_capacity, more, sizeof *grown);
        if (!grown) return NULL;
        memset(grown + r->image_capacity, 0, (more - r->image_capacity) * sizeof *grown);
        r->image = grown;
        r->image_capacity = more;
    }
    return &r->image[view];
}

/* Room for the image comes first: after it nothing is allocated, so nothing is dropped. */
static void vulkan_reserve_target(struct vulkan_renderer *r, size_t pixels)
{
    vulkan_reserve(r->v, &r->target, pixels, 12, "pixels");
    if (r->masked) vulkan_reserve(r->v, &r->weight, pixels, 4, "pixels");
}

static struct vulkan_training_image *vulkan_add_image(struct vulkan_renderer *r, int view,
                                                      const struct training_image *image,
                                                      struct vulkan_training_image *passing)
{
    struct vulkan_training_image *p =
        vulkan_image_slot(r, view, vulkan_image_bytes(image, image->mask != NULL));
    if (p) {
        vulkan_upload_image(r->v, image, p);
        if (r->v->rc != OXL_OK) { /* it is not here, nor half of it */
            vulkan_finish(r->v);
            vulkan_release(r->v, &p->bytes);
        }
        r->image_bytes += p->bytes.size;
        r->images += p->bytes.handle != VK_NULL_HANDLE;
        return p;
    }
    passing->bytes = r->passing;
    vulkan_upload_image(r->v, image, passing);
    r->passing = passing->bytes;
    return passing;
}

OXL_INTERNAL oxl_result vulkan_take_image(void *device, int view, const struct training_image *image,
                                          const struct image_window *window, int halved)
{
    struct vulkan_renderer *r = device;
    struct vulkan *v = r->v;
    struct vulkan_training_image passing = {0}, *p = vulkan_has_image(r, view) ? &r->image[view] : NULL;
    const uint32_t width = p ? p->width : (uint32_t)image->width,
                   height = p ? p->height : (uint32_t)image->height;
    const struct image_window all = {.width = (int)width, .height = (int)height}, *w = window ? window : &all;
    r->target_pixels = (size_t)(w->width >> halved) * (size_t)(w->height >> halved);
    r->masked = p ? p->mask_at > 0 : image->mask != NULL;
    r->pinned_view = view;
    vulkan_enter(v);
    vulkan_reserve_target(r, r->target_pixels);
    if (!p) p = vulkan_add_image(r, view, image, &passing);
    VULKAN_RUN(v, UNPACK, window != NULL, vulkan_groups(r->target_pixels),
               VULKAN_PUSH(width, height, (uint32_t)halved, (uint32_t)r->masked, p->mask_at, (uint32_t)w->x,
                           (uint32_t)w->y, (uint32_t)w->width, (uint32_t)w->height),
               VULKAN_BUFFERS(&p->bytes, &r->target, &r->weight));
    p->frame = vulkan_frame_number(v);
    r->pinned_view = -1;
    return v->rc;
}

/* The image that was taken last, for the CPU that takes over. NULL: how many pixels alone. */
OXL_INTERNAL size_t vulkan_target(void *device, float *rgb, float *weight, int *masked)
{
    struct vulkan_renderer *r = device;
    *masked = r->masked;
    if (r->target.size < 12 * r->target_pixels || (r->masked && r->weight.size < 4 * r->target_pixels))
        return 0;
    if (!rgb) return r->target_pixels;
    vulkan_enter(r->v);
    vulkan_download(r->v, &r->target, 0, rgb, 12 * r->target_pixels);
    if (r->masked) vulkan_download(r->v, &r->weight, 0, weight, 4 * r->target_pixels);
    return r->v->rc == OXL_OK ? r->target_pixels : 0;
}
