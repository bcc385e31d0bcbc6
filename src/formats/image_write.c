/* image_write.c - writes PNG and JPEG, in memory by codec.c, then to a file at once.
 *
 * Invariant: the bytes do not depend on the machine or on the number of threads.
 */
#include "formats.h"
#include "../core/codec.h"
#include "../survey/image.h"

/* Interleaves an image's planes as bytes, its weights as the fourth channel; NULL: there is no memory. */
static uint8_t *image_interleave(oxl_context *ctx, const oxl_image *image, size_t channels)
{
    const size_t count = (size_t)image->width * (size_t)image->height;
    uint8_t *bytes = oxl_alloc(ctx, count, channels);
    for (size_t i = 0; bytes && i < count; i++)
        for (size_t c = 0; c < channels; c++)
            bytes[channels * i + c] = image_to_byte(c < 3 ? image->rgb[c * count + i] : image->weight[i]);
    return bytes;
}

/* Collects the parts of a JPEG in memory. */
struct image_sink {
    oxl_context *ctx;
    void *data;
    size_t size, capacity;
    oxl_result rc;
};

static void image_sink_append(void *user, void *part, int size)
{
    struct image_sink *s = user;
    if (s->rc == OXL_OK) s->rc = oxl_reserve(s->ctx, &s->data, &s->capacity, s->size + (size_t)size, 1);
    if (s->rc != OXL_OK) return;
    memcpy((char *)s->data + s->size, part, (size_t)size);
    s->size += (size_t)size;
}

oxl_result oxl_image_to_jpeg(oxl_context *ctx, const oxl_image *image, int quality, char **out, size_t *size)
{
    struct image_sink sink = {.ctx = ctx};
    uint8_t *bytes;
    *out = NULL;
    *size = 0;
    if (!image->rgb || image->width < 1 || image->height < 1)
        return oxl_fail(ctx, OXL_ERR_USAGE, "the image to encode is empty");
    bytes = image_interleave(ctx, image, 3);
    if (!bytes) return OXL_ERR_MEMORY;
    codec_encode_jpeg(image_sink_append, &sink, bytes, image->width, image->height,
                      OXL_MAX(1, OXL_MIN(quality, 100)));
    oxl_free(ctx, bytes);
    if (sink.rc != OXL_OK) {
        oxl_free(ctx, sink.data);
        return sink.rc;
    }
    *out = sink.data;
    *size = sink.size;
    return OXL_OK;
}

static oxl_result image_write_png(oxl_context *ctx, const char *path, const oxl_image *image, int channels)
{
    uint8_t *bytes, *encoded;
    int size = 0;
    oxl_result rc;
    if (!image->rgb || (channels > 3 && !image->weight) || image->width < 1 || image->height < 1)
        return oxl_fail(ctx, OXL_ERR_USAGE,
                        "%s: the image to write is empty, or has no weights\n"
                        "fix: fill it, as oxl_render and oxl_image_read do",
                        path);
    bytes = image_interleave(ctx, image, (size_t)channels);
    encoded = bytes ? codec_encode_png(ctx, bytes, image->width, image->height, channels, &size) : NULL;
    rc = encoded ? os_write_file(ctx, path, encoded, (size_t)size) : OXL_ERR_MEMORY;
    codec_free(ctx, encoded);
    oxl_free(ctx, bytes);
    return rc;
}

oxl_result oxl_image_write(oxl_context *ctx, const char *path, const oxl_image *image)
{
    return image_write_png(ctx, path, image, 3);
}

oxl_result oxl_image_write_alpha(oxl_context *ctx, const char *path, const oxl_image *image)
{
    return image_write_png(ctx, path, image, 4);
}
