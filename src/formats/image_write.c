/* image_write.c - writes PNG and JPEG, in memory by codec.c, then to a file at once.
 *
 * Invariant: the bytes do not depend on the machine or on the number of threads.
 */
#include "formats.h"
#include "../core/codec.h"
#include "../survey/image.h"

/* Interleaves planes (3,count) as bytes; NULL: there is no memory. */
static uint8_t *image_interleave(oxl_context *ctx, const float *rgb, size_t count)
{
    uint8_t *bytes = oxl_alloc(ctx, count, 3);
    for (size_t i = 0; bytes && i < count; i++)
        for (int c = 0; c < 3; c++) bytes[3 * i + c] = image_to_byte(rgb[c * count + i]);
    return bytes;
}

/* Writes the encoded file and frees both buffers; encoded NULL: there was no memory. */
static oxl_result image_write_encoded(oxl_context *ctx, const char *path, uint8_t *bytes,
                                      unsigned char *encoded, int size)
{
    const oxl_result rc = encoded ? os_write_file(ctx, path, encoded, (size_t)size)
                                  : oxl_fail(ctx, OXL_ERR_MEMORY, "%s: no memory to encode the image", path);
    codec_free(ctx, encoded);
    oxl_free(ctx, bytes);
    return rc;
}

/* Encodes planes (3,H,W) and writes the file. */
static oxl_result image_write_png(oxl_context *ctx, const char *path, const float *rgb, int width, int height)
{
    uint8_t *bytes = image_interleave(ctx, rgb, (size_t)width * height);
    int size = 0;
    unsigned char *encoded = bytes ? codec_encode_png(ctx, bytes, width, height, 3, &size) : NULL;
    return image_write_encoded(ctx, path, bytes, encoded, size);
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
    const size_t count = (size_t)image->width * image->height;
    struct image_sink sink = {.ctx = ctx};
    uint8_t *bytes;
    *out = NULL;
    *size = 0;
    if (!image->rgb || count == 0) return oxl_fail(ctx, OXL_ERR_USAGE, "the image to encode is empty");
    bytes = image_interleave(ctx, image->rgb, count);
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

oxl_result oxl_image_write(oxl_context *ctx, const char *path, const oxl_image *image)
{
    if (!image->rgb || image->width < 1 || image->height < 1)
        return oxl_fail(ctx, OXL_ERR_USAGE,
                        "%s: the image to write is empty\nfix: fill it, as oxl_render and oxl_image_read do",
                        path);
    return image_write_png(ctx, path, image->rgb, image->width, image->height);
}

oxl_result oxl_image_write_alpha(oxl_context *ctx, const char *path, const oxl_image *image)
{
    const size_t count = (size_t)OXL_MAX(image->width, 0) * (size_t)OXL_MAX(image->height, 0);
    uint8_t *bytes;
    unsigned char *encoded;
    int size = 0;
    if (!image->rgb || !image->weight || count == 0)
        return oxl_fail(ctx, OXL_ERR_USAGE, "%s: the image to write is empty, or without weights", path);
    bytes = oxl_alloc(ctx, count, 4);
    for (size_t i = 0; bytes && i < count; i++)
        for (size_t c = 0; c < 4; c++)
            bytes[4 * i + c] = image_to_byte(c < 3 ? image->rgb[c * count + i] : image->weight[i]);
    encoded = bytes ? codec_encode_png(ctx, bytes, image->width, image->height, 4, &size) : NULL;
    return image_write_encoded(ctx, path, bytes, encoded, size);
}

OXL_INTERNAL oxl_result image_deflate(oxl_context *ctx, const void *data, size_t size, size_t before,
                                      size_t after, unsigned char **out, size_t *deflated)
{
    /* bytes of zlib's header and checksum, which gzip and PNG have otherwise */
    enum { ZLIB_HEAD = 2, ZLIB_TAIL = 4 };
    int length = 0;
    unsigned char *zlib = codec_deflate(ctx, data, size, &length);
    *out = zlib ? oxl_alloc(ctx, before + (size_t)length + after, 1) : NULL;
    if (*out) {
        *deflated = (size_t)length - ZLIB_HEAD - ZLIB_TAIL;
        memcpy(*out + before, zlib + ZLIB_HEAD, *deflated);
    }
    codec_free(ctx, zlib);
    return *out ? OXL_OK : oxl_fail(ctx, OXL_ERR_MEMORY, "no memory to compress %zu bytes", size);
}
