/* geotiff.c - writes a raster of bytes or floats as a GeoTIFF that GIS programs open at its place.
 *
 * The file is baseline TIFF 6.0, little endian, without compression: header, pixels in one strip, values of the
 * tags, directory. It has the place as OGC GeoTIFF 1.1 (ModelPixelScale, ModelTiepoint, GeoKeys), and the value
 * of pixels without data as GDAL's tag 42113. `gdaladdo` adds overviews, which large maps are browsed by.
 *
 * Invariant: the file is whole or absent, and the same bytes on any machine.
 */
#include "cli.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define GEOTIFF_MOST 4.0e9 /* bytes of a file: offsets in a TIFF have 32 bits */
enum { GEOTIFF_HEAD = 8 };
enum { TIFF_ASCII = 2, TIFF_SHORT = 3, TIFF_LONG = 4, TIFF_DOUBLE = 12 };

struct geotiff_file {
    struct output out, value, directory; /* value: of tags that do not fit their 4 bytes */
    size_t pixels;                       /* bytes */
    int tags;
};

static void geotiff_number(struct output *t, int type, double value)
{
    if (type == TIFF_DOUBLE) output_real(t, value, 8);
    else output_integer(t, (uint64_t)value, type == TIFF_LONG ? 4 : 2);
}

static void geotiff_head(struct geotiff_file *f, int tag, int type, size_t count)
{
    output_integer(&f->directory, (uint64_t)tag, 2);
    output_integer(&f->directory, (uint64_t)type, 2);
    output_integer(&f->directory, count, 4);
    f->tags++;
}

/* Adds a tag of numbers, which stand in its own 4 bytes if they fit, else apart. */
static void geotiff_tag(struct geotiff_file *f, int tag, int type, const double *value, size_t count)
{
    const int is_inside = count <= (type == TIFF_SHORT ? 2 : type == TIFF_LONG);
    geotiff_head(f, tag, type, count);
    if (!is_inside) output_integer(&f->directory, GEOTIFF_HEAD + f->pixels + f->value.used, 4);
    for (size_t i = 0; i < count; i++) geotiff_number(is_inside ? &f->directory : &f->value, type, value[i]);
    if (is_inside && type == TIFF_SHORT && count == 1) output_integer(&f->directory, 0, 2);
}

static void geotiff_tag_one(struct geotiff_file *f, int tag, int type, double value)
{
    geotiff_tag(f, tag, type, &value, 1);
}

static void geotiff_tag_text(struct geotiff_file *f, int tag, const char *text)
{
    const size_t size = strlen(text) + 1;
    geotiff_head(f, tag, TIFF_ASCII, size);
    if (size <= 4) output_bytes(&f->directory, text, 4);
    else output_integer(&f->directory, GEOTIFF_HEAD + f->pixels + f->value.used, 4);
    if (size > 4) output_bytes(&f->value, text, size);
    if (f->value.used % 2) output_integer(&f->value, 0, 1);
}

/* Adds a GeoKey to those in `key`, of id, tag that holds the value (0: the key does), count, and value or index
 * in the tag; key[3] counts them. */
static void geotiff_key(double *key, int id, int tag, size_t count, double value)
{
    double *to = key + 4 + 4 * (int)key[3]++;
    to[0] = id, to[1] = tag, to[2] = (double)count, to[3] = value;
}

/* Keys stand by rising id, as the standard demands: an EPSG code, or a transverse Mercator around a reference, or no
 * CRS but words. */
void geotiff_crs(const struct geotiff *g, struct geotiff_crs *out)
{
    enum { USER_DEFINED = 32767, METRE = 9001, NUMBERS = 34736, WORDS = 34737 };
    double *key = out->key;
    *out = (struct geotiff_crs){.key = {1, 1, 0, 0}, .number = {0, 0, 0, 0, 1}};
    snprintf(out->words, sizeof out->words, "%.250s|", g->citation);
    if (g->epsg || g->reference) geotiff_key(key, 1024, 0, 1, 1); /* GTModelType: projected */
    geotiff_key(key, 1025, 0, 1, 1);                              /* GTRasterType: a pixel is an area */
    geotiff_key(key, 1026, WORDS, strlen(out->words), 0);         /* GTCitation */
    if (g->epsg) geotiff_key(key, 3072, 0, 1, g->epsg);           /* ProjectedCRS */
    else if (g->reference) {
        static const int origin[] = {3080, 3081, 3082, 3083, 3092}; /* long, lat, easting, northing, scale */
        out->number[0] = g->reference[1], out->number[1] = g->reference[0];
        out->numbers = 5;
        geotiff_key(key, 2048, 0, 1, 4326);         /* GeodeticCRS: WGS 84 */
        geotiff_key(key, 3072, 0, 1, USER_DEFINED); /* ProjectedCRS */
        geotiff_key(key, 3074, 0, 1, USER_DEFINED); /* Projection */
        geotiff_key(key, 3075, 0, 1, 1);            /* ProjMethod: transverse Mercator */
        geotiff_key(key, 3076, 0, 1, METRE);        /* ProjLinearUnits */
        for (int i = 0; i < 5; i++) geotiff_key(key, origin[i], NUMBERS, 1, i);
    } else if (g->is_metric) geotiff_key(key, 3076, 0, 1, METRE);
    out->keys = 4 + 4 * (size_t)key[3];
}

static void geotiff_place(struct geotiff_file *f, const struct geotiff *g)
{
    const double scale[3] = {g->pixel, g->pixel, 0}, tie[6] = {0, 0, 0, g->corner[0], g->corner[1], 0};
    struct geotiff_crs crs;
    geotiff_crs(g, &crs);
    geotiff_tag(f, 33550, TIFF_DOUBLE, scale, 3);
    geotiff_tag(f, 33922, TIFF_DOUBLE, tie, 6);
    geotiff_tag(f, 34735, TIFF_SHORT, crs.key, crs.keys);
    if (crs.numbers) geotiff_tag(f, 34736, TIFF_DOUBLE, crs.number, crs.numbers);
    geotiff_tag_text(f, 34737, crs.words);
}

static void geotiff_describe(struct geotiff_file *f, const struct geotiff *g)
{
    static const double bytes[4] = {8, 8, 8, 8}, wide[2] = {32, 32}, floating[2] = {3, 3};
    const int is_colour = g->bands == 3;
    const double extra[1] = {is_colour ? 2 : 0}; /* 2: alpha, not multiplied in */
    const size_t bands = is_colour ? 4 : (size_t)g->bands;
    geotiff_tag_one(f, 256, TIFF_LONG, g->width);
    geotiff_tag_one(f, 257, TIFF_LONG, g->height);
    geotiff_tag(f, 258, TIFF_SHORT, is_colour ? bytes : wide, bands); /* BitsPerSample */
    geotiff_tag_one(f, 259, TIFF_SHORT, 1);                           /* Compression: none */
    geotiff_tag_one(f, 262, TIFF_SHORT, is_colour ? 2 : 1);      /* PhotometricInterpretation: grey, RGB */
    geotiff_tag_one(f, 273, TIFF_LONG, GEOTIFF_HEAD);            /* StripOffsets */
    geotiff_tag_one(f, 277, TIFF_SHORT, (double)bands);          /* SamplesPerPixel */
    geotiff_tag_one(f, 278, TIFF_LONG, g->height);               /* RowsPerStrip */
    geotiff_tag_one(f, 279, TIFF_LONG, f->pixels);               /* StripByteCounts */
    if (g->bands > 1) geotiff_tag(f, 338, TIFF_SHORT, extra, 1); /* ExtraSamples */
    if (!is_colour) geotiff_tag(f, 339, TIFF_SHORT, floating, bands); /* SampleFormat */
    geotiff_place(f, g);
    if (!is_colour) geotiff_tag_text(f, 42113, "nan"); /* GDAL_NODATA */
}

/* Adds a pixel: bytes of RGBA, or its floats. */
static void geotiff_pixel(const struct geotiff *g, const float *value, size_t plane, struct output *t)
{
    for (int k = 0; k < g->bands; k++, value += plane) {
        if (g->bands != 3) output_real(t, (double)*value, 4);
        else output_integer(t, isnan(*value) ? 0 : (uint64_t)(255 * *value + 0.5f), 1);
        if (k == 2) output_integer(t, isnan(*value) ? 0 : 255, 1);
    }
}

oxl_result geotiff_write(oxl_context *ctx, const char *path, const struct geotiff *g, const float *data)
{
    const size_t plane = (size_t)g->width * g->height;
    struct geotiff_file f = {.pixels = 4 * (g->bands == 3 ? 1 : (size_t)g->bands) * plane};
    if ((double)f.pixels > GEOTIFF_MOST)
        return oxl_fail(ctx, OXL_ERR_USAGE,
                        "%s would be larger than 4 GB, the limit of this "
                        "format\nfix: use a larger --pixel",
                        path);
    geotiff_describe(&f, g);
    output_open(&f.out, path);
    output_bytes(&f.out, "II*\0", 4);
    output_integer(&f.out, GEOTIFF_HEAD + f.pixels + f.value.used, 4);
    for (size_t i = 0; i < plane; i++) geotiff_pixel(g, data + i, plane, &f.out);
    output_bytes(&f.out, f.value.data, f.value.used);
    output_integer(&f.out, (uint64_t)f.tags, 2);
    output_bytes(&f.out, f.directory.data, f.directory.used);
    output_integer(&f.out, 0, 4);
    f.out.failed |= f.value.failed | f.directory.failed;
    free(f.value.data);
    free(f.directory.data);
    return output_close(ctx, &f.out);
}
