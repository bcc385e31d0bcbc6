/* image_header.c - reads size, bits, transparency, gamma and EXIF orientation of an image, and finds what is
 * damaged in its file.
 *
 * Sources: PNG (ISO 15948, 11.2.2), JPEG (ITU T.81 B.1.1, B.2.2), EXIF (CIPA DC-008, 4.5.4, 4.6.4).
 *
 * Invariant: nothing here decodes, so that a survey with one camera per image costs one short read per
 * image.
 */
#include "image_header.h"
#include "../core/codec.h"

enum {
    HEADER_BYTES = 1 << 16, /* bytes that are read of a file: markers and EXIF data are near its start */
    HEADER_ORIENTATION = 0x0112,
    HEADER_SYMBOLS = 256 /* most symbols of a Huffman table */
};
static const char HEADER_EARLY[] = "it ends too early";

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

/* ---------------- JPEG */

/* Returns 1 if Huffman tables (B.2.4.2) fill their segment: each is a class and a number, 16 counts and as
 * many symbols. *tables: gets a bit for each. */
static int header_tables_fit(const unsigned char *p, const unsigned char *end, unsigned *tables)
{
    while (p < end) {
        int symbols = 0;
        *tables |= 1u << ((p[0] >> 4 & 1) << 2 | (p[0] & 3));
        for (int i = 1; i <= 16 && end - p >= 17; i++) symbols += p[i];
        if (symbols > HEADER_SYMBOLS || 17 + symbols > end - p) return 0;
        p += 17 + symbols;
    }
    return 1;
}

/* Returns 1 if a scan's Huffman tables are defined (B.2.3). In a progressive image a scan uses DC or AC
 * tables, or none if it refines DC. */
static int header_scan_fits(const unsigned char *p, const unsigned char *end, unsigned tables,
                            int progressive)
{
    const int count = p < end ? p[0] : 0, begins = end - p >= 4 + 2 * count ? p[1 + 2 * count] : 0;
    if (end - p < 4 + 2 * count) return 0;
    for (int i = 0; i < count; i++) {
        const int table = p[2 + 2 * i], dc = tables >> (table >> 4 & 3) & 1,
                  ac = tables >> (4 + (table & 3)) & 1;
        if (!progressive ? !dc || !ac : begins > 0 ? !ac : !dc && p[3 + 2 * count] >> 4 == 0) return 0;
    }
    return 1;
}

/* Goes from marker to marker; a preview inside a segment is skipped with it. stb 2.27 does not check the
 * counts of a Huffman table (buffer overrun), reads tables that are not defined, accepts a second frame
 * header after allocating for the first, and reports a truncated file as "expected marker". */
static const char *header_of_jpeg(const unsigned char *data, size_t size, struct image_header *out)
{
    const unsigned char *p = data + 2, *end = data + size, *next;
    unsigned tables = 0;
    int frames = 0, progressive = 0;
    for (; end - p >= 2; p = next) {
        const int marker = p[1];
        next = p + 1; /* Skips coded data. */
        if (p[0] != 0xff || marker == 0 || marker == 0xff || (marker >= 0xd0 && marker <= 0xd7)) continue;
        if (marker == 0xd9) return NULL;
        if (end - p < 4 || 2 + (ptrdiff_t)header_number(p + 2, 2, 1) > end - p) break;
        next = p + 2 + header_number(p + 2, 2, 1);
        if (marker == 0xc4 && !header_tables_fit(p + 4, next, &tables)) return "a Huffman table is damaged";
        if (marker == 0xda && !header_scan_fits(p + 4, next, tables, progressive))
            return "a scan has no Huffman table";
        if (marker == 0xe1 && next - p > 10 && !memcmp(p + 4, "Exif\0", 6))
            out->orientation = header_orientation(p + 10, (size_t)(next - p) - 10);
        if (marker < 0xc0 || marker > 0xcf || marker == 0xc4 || marker == 0xc8 || marker == 0xcc) continue;
        if (marker > 0xc8)
            return "a JPEG with arithmetic coding, which is not read\n"
                   "fix: write it as a usual JPEG, under the same name: jpegtran -copy all IN > OUT, without "
                   "-arithmetic";
        if (next - p < 9) break;
        if (marker > 0xc2 || p[4] != 8)
            return "a JPEG with lossless or hierarchical coding or more than 8 bits, which is not read\n"
                   "fix: write it as a usual JPEG, under the same name: mogrify -quality 98 IMAGE";
        if (frames++) return "it has two frame headers";
        progressive = marker == 0xc2;
        out->bits = p[4];
        out->height = (int)header_number(p + 5, 2, 1);
        out->width = (int)header_number(p + 7, 2, 1);
    }
    return HEADER_EARLY;
}

/* ---------------- PNG */

/* sums: compares the checksums of critical chunks, too, since the decoder does not and damaged data may
 * decode to wrong pixels. IEND may be missing. */
static const char *header_of_png(const unsigned char *data, size_t size, int sums, struct image_header *out)
{
    enum { COLOURS = 25, PALETTE = 3, GREY_ALPHA = 4, RGB_ALPHA = 6 }; /* COLOURS: place of the type */
    enum { LINEAR = 90000 }; /* 1e5 times the exponent of the values of linear light, or nearly */
    const unsigned char *p = data + 8, *end = data + size;
    int states = 0; /* 1: sRGB states the curve, and gAMA does not count */
    if (size <= 32 || memcmp(p + 4, "IHDR", 4)) return HEADER_EARLY;
    out->width = (int)header_number(data + 16, 4, 1);
    out->height = (int)header_number(data + 20, 4, 1);
    out->bits = data[24];
    out->has_alpha = data[COLOURS] == GREY_ALPHA || data[COLOURS] == RGB_ALPHA;
    while (end - p >= 12) {
        const size_t length = header_number(p, 4, 1);
        if (length > (size_t)(end - p) - 12) return HEADER_EARLY;
        if (sums && !(p[4] & 0x20) &&
            codec_png_checksum(p + 4, (int)length + 4) != header_number(p + 8 + length, 4, 1))
            return "its checksum does not match";
        if (!memcmp(p + 4, "IEND", 4)) return NULL;
        if (!memcmp(p + 4, "eXIf", 4)) out->orientation = header_orientation(p + 8, length);
        out->has_alpha |= !memcmp(p + 4, "tRNS", 4);
        states |= !memcmp(p + 4, "sRGB", 4) || !memcmp(p + 4, "cICP", 4);
        out->is_linear |= !memcmp(p + 4, "gAMA", 4) && length == 4 && header_number(p + 8, 4, 1) > LINEAR;
        out->is_linear &= !states;
        if (!memcmp(p + 4, "PLTE", 4) && data[COLOURS] == PALETTE)
            out->palette = (size_t)(p + 8 - data), out->palette_size = length;
        p += 12 + length;
    }
    return p == end ? NULL : HEADER_EARLY;
}

OXL_INTERNAL const char *image_header_of(const void *file, size_t size, int sums, struct image_header *out)
{
    const unsigned char *data = file;
    *out = (struct image_header){.orientation = 1};
    if (size > 8 && !memcmp(data, "\x89PNG\r\n\x1a\n", 8)) return header_of_png(data, size, sums, out);
    if (size > 4 && !memcmp(data, "\xff\xd8\xff", 3)) return header_of_jpeg(data, size, out);
    return "neither a JPEG nor a PNG file\n"
           "fix: convert it to one of these, under the same name in the model";
}

OXL_INTERNAL oxl_result image_read_header(oxl_context *ctx, const char *path, struct image_header *out)
{
    unsigned char *data = oxl_alloc(ctx, HEADER_BYTES, 1);
    FILE *file = data ? os_open(path) : NULL;
    /* Takes what there is: the file goes on. */
    image_header_of(data, file ? fread(data, 1, HEADER_BYTES, file) : 0, 0, out);
    if (file) fclose(file);
    oxl_free(ctx, data);
    return data ? OXL_OK : OXL_ERR_MEMORY;
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
