/* image_header.c - reads size, bits and EXIF orientation of an image from the first bytes of its file.
 *
 * Sources: PNG (ISO 15948, 11.2.2), JPEG (ITU T.81 B.1.1, B.2.2), EXIF (CIPA DC-008, 4.5.4, 4.6.4).
 *
 * Invariant: nothing here decodes, so that a survey with one camera per image costs one short read per
 * image.
 */
#include "image_header.h"

enum {
    HEADER_BYTES = 1 << 16, /* bytes that are read of a file: markers and EXIF data are near its start */
    HEADER_ORIENTATION = 0x0112
};

static unsigned header_number(const unsigned char *p, int bytes, int big_endian)
{
    unsigned value = 0;
    for (int i = 0; i < bytes; i++) value |= (unsigned)p[i] << 8 * (big_endian ? bytes - 1 - i : i);
    return value;
}

/* Finds the orientation in the first directory of TIFF data; 1: upright, or not stated. */
static int header_orientation(const unsigned char *tiff, size_t size)
{
    const int big = size >= 8 && tiff[0] == 'M';
    const size_t at = size >= 8 ? header_number(tiff + 4, 4, big) : size;
    unsigned entries;
    if (size < 8 || at > size - 2) return 1;
    entries = header_number(tiff + at, 2, big);
    for (unsigned i = 0; i < entries && at + 2 + 12 * (size_t)(i + 1) <= size; i++) {
        const unsigned char *entry = tiff + at + 2 + 12 * (size_t)i;
        const unsigned value = header_number(entry + 8, 2, big);
        if (header_number(entry, 2, big) == HEADER_ORIENTATION)
            return value >= 1 && value <= 8 ? (int)value : 1;
    }
    return 1;
}

/* Goes through the segments up to the frame header. */
static void header_of_jpeg(const unsigned char *data, size_t size, struct image_header *out)
{
    size_t at = 2;
    while (at + 9 < size && data[at] == 0xff) {
        const int marker = data[at + 1];
        const size_t length = header_number(data + at + 2, 2, 1);
        if (marker == 0xff) {
            at++;
            continue;
        }
        if (marker >= 0xc0 && marker <= 0xcf && marker != 0xc4 && marker != 0xc8 && marker != 0xcc) {
            out->bits = data[at + 4];
            out->height = (int)header_number(data + at + 5, 2, 1);
            out->width = (int)header_number(data + at + 7, 2, 1);
            return;
        }
        if (marker == 0xe1 && length > 8 && at + 2 + length <= size && !memcmp(data + at + 4, "Exif\0", 6))
            out->orientation = header_orientation(data + at + 10, length - 8);
        at += 2 + length;
    }
}

static void header_of_png(const unsigned char *data, size_t size, struct image_header *out)
{
    size_t at = 8;
    out->width = (int)header_number(data + 16, 4, 1);
    out->height = (int)header_number(data + 20, 4, 1);
    out->bits = data[24];
    while (at + 12 < size && memcmp(data + at + 4, "IDAT", 4)) {
        const size_t length = header_number(data + at, 4, 1);
        if (length > size - at - 12) return;
        if (!memcmp(data + at + 4, "eXIf", 4)) out->orientation = header_orientation(data + at + 8, length);
        at += 12 + length;
    }
}

OXL_INTERNAL oxl_result image_read_header(oxl_context *ctx, const char *path, struct image_header *out)
{
    unsigned char *data = oxl_alloc(ctx, HEADER_BYTES, 1);
    FILE *file = data ? os_open(path) : NULL;
    const size_t size = file ? fread(data, 1, HEADER_BYTES, file) : 0;
    oxl_result rc = data ? OXL_OK : oxl_fail(ctx, OXL_ERR_MEMORY, "%s: no memory to read its header", path);
    *out = (struct image_header){.orientation = 1};
    if (file) fclose(file);
    if (size > 32 && !memcmp(data, "\x89PNG\r\n\x1a\n", 8)) header_of_png(data, size, out);
    else if (size > 32 && !memcmp(data, "\xff\xd8\xff", 3)) header_of_jpeg(data, size, out);
    oxl_free(ctx, data);
    return rc;
}

/* ---------------- an image turned as its EXIF orientation says */

OXL_INTERNAL int image_has_shape(int width, int height, int wanted_width, int wanted_height)
{
    return fabs((double)width / wanted_width / ((double)height / wanted_height) - 1) <= IMAGE_SHAPE_ERROR;
}

OXL_INTERNAL oxl_result image_turn(oxl_context *ctx, struct pixels *p, int channels, int orientation)
{
    const size_t n = (size_t)channels, w = (size_t)p->width, h = (size_t)p->height;
    uint8_t *turned;
    if (orientation < 5) return OXL_OK;
    turned = oxl_alloc(ctx, w * h, n);
    if (!turned) return OXL_ERR_MEMORY;
    for (size_t y = 0; y < w; y++) /* rows and columns of the turned image, h x w px */
        for (size_t x = 0; x < h; x++) {
            const size_t from_x = orientation == 5 || orientation == 6 ? y : w - 1 - y,
                         from_y = orientation == 5 || orientation == 8 ? x : h - 1 - x;
            memcpy(turned + n * (y * h + x), p->data + n * (from_y * w + from_x), n);
        }
    memcpy(p->data, turned, n * w * h);
    p->width = (int)h, p->height = (int)w;
    oxl_free(ctx, turned);
    return OXL_OK;
}
