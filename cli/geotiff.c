/* geotiff.c - writes a raster of bytes or floats as a GeoTIFF that GIS programs open at its place.
 *
 * The file is baseline TIFF 6.0, little endian, in tiles without compression, with overviews of half the size
 * down to about one tile. It has the place as OGC GeoTIFF 1.1 (ModelPixelScale, ModelTiepoint, GeoKeys), and
 * the value of pixels without data as GDAL's tag 42113.
 *
 * Invariant: the file is whole or absent, and the same bytes on any machine.
 */
#include "cli.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    GEOTIFF_TILE = 256,
    GEOTIFF_LEVELS = 16, /* most levels: the image and its overviews */
    GEOTIFF_TAGS = 20,
    GEOTIFF_KEYS = 16
};
#define GEOTIFF_MOST 4.0e9 /* Limits the bytes of a file: offsets in a TIFF have 32 bits. */

enum { TIFF_ASCII = 2, TIFF_SHORT = 3, TIFF_LONG = 4, TIFF_DOUBLE = 12 };

struct geotiff_level {
    int width, height;
    const unsigned char *data; /* (height,width,4) bytes of RGBA, or of a float in the machine's order */
    unsigned char *own;        /* data if this file frees it, else NULL */
    uint32_t first;            /* offset of the level's first tile */
};

struct geotiff_tag {
    int tag, type;
    uint32_t count, value; /* value: the value itself where it fits 4 bytes, else its offset */
};

struct geotiff_file {
    const struct geotiff *g;
    struct output out;
    uint32_t at; /* number of bytes written */
    struct geotiff_level level[GEOTIFF_LEVELS];
    int levels;
};

/* ---------------- bytes */

static void geotiff_bytes(struct geotiff_file *f, const void *data, size_t size)
{
    output_bytes(&f->out, data, size);
    f->at += (uint32_t)size;
}

static void geotiff_integer(struct geotiff_file *f, uint64_t value, int size)
{
    unsigned char b[8];
    for (int i = 0; i < size; i++) b[i] = (unsigned char)(value >> 8 * i);
    geotiff_bytes(f, b, (size_t)size);
}

static void geotiff_double(struct geotiff_file *f, double value)
{
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    geotiff_integer(f, bits, 8);
}

/* ---------------- levels */

static int geotiff_across(int side)
{
    return (side + GEOTIFF_TILE - 1) / GEOTIFF_TILE;
}

static uint32_t geotiff_tiles(const struct geotiff_level *l)
{
    return (uint32_t)(geotiff_across(l->width) * geotiff_across(l->height));
}

/* Averages those of 2 x 2 pixels that have data; the mean has none where fewer than two have, so
 * that the rim does not grow. */
static void geotiff_halve_pixel(const struct geotiff *g, const unsigned char *const from[4],
                                unsigned char out[4])
{
    unsigned sum[3] = {0, 0, 0}, count = 0;
    float heights = 0, height;
    for (int i = 0; i < 4; i++) {
        memcpy(&height, from[i], 4);
        if (g->is_height ? isnan(height) : from[i][3] == 0) continue;
        heights += g->is_height ? height : 0;
        for (int k = 0; k < 3; k++) sum[k] += from[i][k];
        count++;
    }
    height = count < 2 ? NAN : heights / (float)count;
    if (g->is_height) {
        memcpy(out, &height, 4);
        return;
    }
    for (unsigned k = 0; k < 3; k++) out[k] = (unsigned char)(count < 2 ? 0 : (sum[k] + count / 2) / count);
    out[3] = count < 2 ? 0 : 255;
}

/* Appends the level of half the last one's size. Returns 0 without memory. */
static int geotiff_halve(struct geotiff_file *f)
{
    const struct geotiff_level *a = &f->level[f->levels - 1];
    struct geotiff_level *b = &f->level[f->levels];
    *b = (struct geotiff_level){.width = (a->width + 1) / 2, .height = (a->height + 1) / 2};
    b->data = b->own = malloc(4 * (size_t)b->width * (size_t)b->height);
    if (!b->own) return 0;
    f->levels++;
    for (int y = 0; y < b->height; y++)
        for (int x = 0; x < b->width; x++) {
            const unsigned char *from[4];
            for (int i = 0; i < 4; i++) {
                const int column = 2 * x + i % 2 < a->width ? 2 * x + i % 2 : 2 * x;
                const int row = 2 * y + i / 2 < a->height ? 2 * y + i / 2 : 2 * y;
                from[i] = a->data + 4 * ((size_t)row * (size_t)a->width + (size_t)column);
            }
            geotiff_halve_pixel(f->g, from, b->own + 4 * ((size_t)y * (size_t)b->width + (size_t)x));
        }
    return 1;
}

/* Writes one tile, without data where it is outside the level. A height goes byte by byte, so that the file
 * is little endian on any machine. */
static void geotiff_write_tile(struct geotiff_file *f, const struct geotiff_level *l, int left, int top)
{
    for (int y = top; y < top + GEOTIFF_TILE; y++)
        for (int x = left; x < left + GEOTIFF_TILE; x++) {
            const int inside = x < l->width && y < l->height;
            const unsigned char *p = inside ? l->data + 4 * ((size_t)y * (size_t)l->width + (size_t)x) : NULL;
            float height = NAN;
            uint32_t bits;
            if (!f->g->is_height) {
                geotiff_bytes(f, p ? p : (const unsigned char[4]){0, 0, 0, 0}, 4);
                continue;
            }
            if (p) memcpy(&height, p, 4);
            memcpy(&bits, &height, 4);
            geotiff_integer(f, bits, 4);
        }
}

static void geotiff_write_level(struct geotiff_file *f, struct geotiff_level *l)
{
    l->first = f->at;
    for (int top = 0; top < l->height; top += GEOTIFF_TILE)
        for (int left = 0; left < l->width; left += GEOTIFF_TILE) geotiff_write_tile(f, l, left, top);
}

/* ---------------- the place: GeoKeys */

struct geotiff_keys {
    /* id, tag that holds the value (0: the key does), count, value or index in the tag */
    uint16_t key[GEOTIFF_KEYS][4];
    int count;
    double number[8];
    int numbers;
    char text[320];
};

static void geotiff_key(struct geotiff_keys *k, int id, int value)
{
    const uint16_t key[4] = {(uint16_t)id, 0, 1, (uint16_t)value};
    memcpy(k->key[k->count++], key, sizeof key);
}

static void geotiff_key_number(struct geotiff_keys *k, int id, double value)
{
    const uint16_t key[4] = {(uint16_t)id, 34736, 1, (uint16_t)k->numbers};
    memcpy(k->key[k->count++], key, sizeof key);
    k->number[k->numbers++] = value;
}

static void geotiff_key_text(struct geotiff_keys *k, int id, const char *text)
{
    const size_t from = strlen(k->text);
    uint16_t key[4] = {(uint16_t)id, 34737, 0, (uint16_t)from};
    snprintf(k->text + from, sizeof k->text - from, "%.250s|", text);
    key[2] = (uint16_t)(strlen(k->text) - from);
    memcpy(k->key[k->count++], key, sizeof key);
}

/* Adds keys by rising id, as the standard demands: an EPSG code, or a transverse Mercator around a
 * reference, or no CRS but words. */
static void geotiff_place(const struct geotiff *g, struct geotiff_keys *k)
{
    *k = (struct geotiff_keys){.count = 0};
    if (g->epsg || g->reference) geotiff_key(k, 1024, 1); /* GTModelType: projected */
    geotiff_key(k, 1025, 1);                              /* GTRasterType: a pixel is an area */
    geotiff_key_text(k, 1026, g->citation);               /* GTCitation */
    if (g->epsg) {
        geotiff_key(k, 3072, g->epsg); /* ProjectedCRS */
        return;
    }
    if (g->is_metric && !g->reference) geotiff_key(k, 3076, 9001); /* ProjLinearUnits: metre */
    if (!g->reference) return;
    geotiff_key(k, 2048, 4326);                   /* GeodeticCRS: WGS 84 */
    geotiff_key(k, 3072, 32767);                  /* ProjectedCRS: user-defined */
    geotiff_key(k, 3074, 32767);                  /* Projection: user-defined */
    geotiff_key(k, 3075, 1);                      /* ProjMethod: transverse Mercator */
    geotiff_key(k, 3076, 9001);                   /* ProjLinearUnits: metre */
    geotiff_key_number(k, 3080, g->reference[1]); /* ProjNatOriginLong, degrees */
    geotiff_key_number(k, 3081, g->reference[0]); /* ProjNatOriginLat */
    geotiff_key_number(k, 3082, 0);               /* ProjFalseEasting */
    geotiff_key_number(k, 3083, 0);               /* ProjFalseNorthing */
    geotiff_key_number(k, 3092, 1);               /* ProjScaleAtNatOrigin */
}

/* ---------------- directories */

struct geotiff_directory {
    struct geotiff_tag tag[GEOTIFF_TAGS];
    int count;
};

static void geotiff_tag(struct geotiff_directory *d, int tag, int type, uint32_t count, uint32_t value)
{
    d->tag[d->count++] = (struct geotiff_tag){tag, type, count, value};
}

static uint32_t geotiff_write_doubles(struct geotiff_file *f, const double *value, int count)
{
    const uint32_t at = f->at;
    for (int i = 0; i < count; i++) geotiff_double(f, value[i]);
    return at;
}

/* Adds the tags of the place. Writes their values first: they do not fit a tag, and the
 * directory has their offsets. */
static void geotiff_place_tags(struct geotiff_file *f, struct geotiff_directory *d)
{
    const struct geotiff *g = f->g;
    const double scale[3] = {g->pixel, g->pixel, 0}, tie[6] = {0, 0, 0, g->corner[0], g->corner[1], 0};
    struct geotiff_keys keys;
    uint32_t at;
    geotiff_place(g, &keys);
    geotiff_tag(d, 33550, TIFF_DOUBLE, 3, geotiff_write_doubles(f, scale, 3));
    geotiff_tag(d, 33922, TIFF_DOUBLE, 6, geotiff_write_doubles(f, tie, 6));
    at = f->at;
    geotiff_integer(f, 1, 2), geotiff_integer(f, 1, 2), geotiff_integer(f, 0, 2);
    geotiff_integer(f, (uint64_t)keys.count, 2);
    for (int i = 0; i < 4 * keys.count; i++) geotiff_integer(f, keys.key[i / 4][i % 4], 2);
    geotiff_tag(d, 34735, TIFF_SHORT, 4 + 4 * (uint32_t)keys.count, at);
    if (keys.numbers)
        geotiff_tag(d, 34736, TIFF_DOUBLE, (uint32_t)keys.numbers,
                    geotiff_write_doubles(f, keys.number, keys.numbers));
    at = f->at;
    geotiff_bytes(f, keys.text, strlen(keys.text) + 1);
    geotiff_tag(d, 34737, TIFF_ASCII, (uint32_t)(f->at - at), at);
    if (f->at % 2) geotiff_integer(f, 0, 1);
}

/* Writes an array of first + i step for the level's tiles, and returns its offset; for one tile returns
 * `first`, which fits the tag. */
static uint32_t geotiff_write_tiles(struct geotiff_file *f, uint32_t first, uint32_t step, uint32_t tiles)
{
    const uint32_t at = f->at;
    if (tiles == 1) return first;
    for (uint32_t i = 0; i < tiles; i++) geotiff_integer(f, first + i * step, 4);
    return at;
}

/* Lists the tags of a level's directory, and writes the values that do not fit a tag. */
static void geotiff_describe(struct geotiff_file *f, int level, struct geotiff_directory *d)
{
    const struct geotiff_level *l = &f->level[level];
    const uint32_t bytes = 4 * GEOTIFF_TILE * GEOTIFF_TILE, tiles = geotiff_tiles(l), bits = f->at;
    const int is_height = f->g->is_height;
    *d = (struct geotiff_directory){.count = 0};
    for (int i = 0; i < 4; i++) geotiff_integer(f, 8, 2);
    geotiff_tag(d, 254, TIFF_LONG, 1, level > 0); /* NewSubfileType: of reduced resolution */
    geotiff_tag(d, 256, TIFF_LONG, 1, (uint32_t)l->width);
    geotiff_tag(d, 257, TIFF_LONG, 1, (uint32_t)l->height);
    geotiff_tag(d, 258, TIFF_SHORT, is_height ? 1 : 4, is_height ? 32 : bits); /* BitsPerSample */
    geotiff_tag(d, 259, TIFF_SHORT, 1, 1);                                     /* Compression: none */
    geotiff_tag(d, 262, TIFF_SHORT, 1, is_height ? 1 : 2); /* PhotometricInterpretation: grey, RGB */
    geotiff_tag(d, 277, TIFF_SHORT, 1, is_height ? 1 : 4); /* SamplesPerPixel */
    geotiff_tag(d, 284, TIFF_SHORT, 1, 1);                 /* PlanarConfiguration: interleaved */
    geotiff_tag(d, 322, TIFF_LONG, 1, GEOTIFF_TILE);       /* TileWidth, TileLength */
    geotiff_tag(d, 323, TIFF_LONG, 1, GEOTIFF_TILE);
    geotiff_tag(d, 324, TIFF_LONG, tiles, geotiff_write_tiles(f, l->first, bytes, tiles));
    geotiff_tag(d, 325, TIFF_LONG, tiles, geotiff_write_tiles(f, bytes, 0, tiles));
    if (is_height) geotiff_tag(d, 339, TIFF_SHORT, 1, 3); /* SampleFormat: floating point */
    else geotiff_tag(d, 338, TIFF_SHORT, 1, 2);           /* ExtraSamples: alpha, not multiplied in */
    if (level == 0) geotiff_place_tags(f, d);
    /* GDAL_NODATA: "nan" */
    if (is_height) geotiff_tag(d, 42113, TIFF_ASCII, 4, 'n' | 'a' << 8 | 'n' << 16);
}

static void geotiff_write_directory(struct geotiff_file *f, int level)
{
    struct geotiff_directory d;
    geotiff_describe(f, level, &d);
    if (f->at % 2) geotiff_integer(f, 0, 1);
    geotiff_integer(f, (uint64_t)d.count, 2);
    for (int i = 0; i < d.count; i++) {
        geotiff_integer(f, (uint64_t)d.tag[i].tag, 2);
        geotiff_integer(f, (uint64_t)d.tag[i].type, 2);
        geotiff_integer(f, d.tag[i].count, 4);
        geotiff_integer(f, d.tag[i].value, 4);
    }
}

/* Returns the offset that the level's directory has if its values are written from `from` on. Writes them
 * to memory to count them. */
static uint32_t geotiff_directory_at(const struct geotiff_file *f, int level, uint32_t from)
{
    struct geotiff_file dry = {.g = f->g, .at = from, .levels = f->levels};
    struct geotiff_directory d;
    memcpy(dry.level, f->level, sizeof dry.level);
    geotiff_describe(&dry, level, &d);
    free(dry.out.data);
    return dry.at + dry.at % 2;
}

/* Writes the header, the tiles of all levels and then the directories. Computes the offset of each directory
 * before it writes the link to it, so that the file is written from front to back. */
static void geotiff_write_all(struct geotiff_file *f)
{
    uint32_t at = 8, directory;
    for (int i = 0; i < f->levels; i++) at += geotiff_tiles(&f->level[i]) * 4 * GEOTIFF_TILE * GEOTIFF_TILE;
    directory = geotiff_directory_at(f, 0, at);
    geotiff_bytes(f, "II*\0", 4);
    geotiff_integer(f, directory, 4);
    for (int i = 0; i < f->levels; i++) geotiff_write_level(f, &f->level[i]);
    for (int i = 0; i < f->levels; i++) {
        geotiff_write_directory(f, i);
        geotiff_integer(f, i + 1 < f->levels ? geotiff_directory_at(f, i + 1, f->at + 4) : 0, 4);
    }
}

oxl_result geotiff_write(oxl_context *ctx, const char *path, const struct geotiff *g, const void *data)
{
    struct geotiff_file f = {.g = g, .level = {{.width = g->width, .height = g->height, .data = data}}};
    oxl_result rc = OXL_OK;
    int has_memory = 1;
    f.levels = 1;
    if (4.0 / 3 * 4 * (g->width + GEOTIFF_TILE) * (double)(g->height + GEOTIFF_TILE) > GEOTIFF_MOST)
        return oxl_fail(ctx, OXL_ERR_USAGE, "%s would have more than 4 GB\nfix: a larger --pixel", path);
    while (has_memory && f.levels < GEOTIFF_LEVELS &&
           (f.level[f.levels - 1].width > GEOTIFF_TILE || f.level[f.levels - 1].height > GEOTIFF_TILE))
        has_memory = geotiff_halve(&f);
    if (!has_memory) rc = oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for %s\nfix: a larger --pixel", path);
    if (rc == OXL_OK) output_open(&f.out, path);
    if (rc == OXL_OK) geotiff_write_all(&f);
    if (rc == OXL_OK && !output_close(&f.out))
        rc = oxl_fail(ctx, OXL_ERR_IO, "%s cannot be written\nfix: free space on the disk", path);
    for (int i = 0; i < f.levels; i++) free(f.level[i].own);
    return rc;
}
