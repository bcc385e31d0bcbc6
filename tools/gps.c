/* gps.c - finds the world that the photos' GPS says: UTM, metres, up.
 *
 * Places are read from the EXIF data of JPEG files (CIPA DC-008, 4.6.6), turned into UTM on WGS 84 by Krueger's series
 * (Karney 2011, Transverse Mercator with an accuracy of a few nanometers, J. Geodesy 85, eq. 7 to 11, 35; a tenth of a
 * millimetre with three terms), and a similarity from the cameras' places to them is fitted with Tukey's weights. The
 * heights are those of the photos: above the ellipsoid or the sea, as the camera has them.
 */
#include "tools.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { GPS_HEAD = 1 << 16, GPS_LEAST = 4, GPS_PASSES = 20 };
#define GPS_TILT 10.0 /* degrees; largest uncertainty of up */
#define GPS_EVEN \
    200.0 /* degrees; 180 / pi times the square root of 12: of places that lie evenly across a width */

/* ---------------- EXIF */

struct gps_exif {
    unsigned char data[GPS_HEAD]; /* of a file, from its TIFF header on */
    size_t size;
    int is_big; /* big endian */
};

/* Returns 0 beyond the end. */
static double gps_number(const struct gps_exif *e, size_t at, int bytes)
{
    double value = 0;
    for (int i = 0; i < bytes && at + (size_t)bytes <= e->size; i++)
        value = 256 * value + e->data[e->is_big ? at + (size_t)i : at + (size_t)(bytes - 1 - i)];
    return value;
}

/* Returns where the entry of a tag has its value in the directory at `at`; 0: there is none. */
static size_t gps_entry(const struct gps_exif *e, size_t at, int tag)
{
    for (int left = (int)gps_number(e, at, 2); at > 0 && left > 0; left--, at += 12)
        if ((int)gps_number(e, at + 2, 2) == tag) return at + 10;
    return 0;
}

/* The value of a tag: degrees, minutes and seconds, or one number; negative for south, west, or below the sea, as the
 * tag before it says. NaN: there is none. */
static double gps_value(const struct gps_exif *e, size_t directory, int tag)
{
    const size_t at = gps_entry(e, directory, tag), sign = gps_entry(e, directory, tag - 1);
    const size_t from = (size_t)gps_number(e, at, 4);
    double value = 0;
    if (!at) return NAN;
    for (size_t i = 0; i < (size_t)gps_number(e, at - 4, 4) && i < 3; i++)
        value += gps_number(e, from + 8 * i, 4) / gps_number(e, from + 8 * i + 4, 4) / pow(60, (double)i);
    return sign && strchr("SW\1", e->data[sign]) && e->data[sign] ? -value : value;
}

/* Reads latitude and longitude, degrees, and height, metres. Returns 0 where the view's photo has none. */
static int gps_of_view(const char *images, const char *survey, const char *name, double out[3])
{
    struct gps_exif e = {.size = 0};
    char path[8400];
    FILE *file;
    size_t tiff = 0, directory;
    snprintf(path, sizeof path, "%s%s/%s", images ? images : survey, images ? "" : "/images", name);
    file = oxl_open(path);
    if (!file) return 0;
    e.size = fread(e.data, 1, GPS_HEAD, file);
    fclose(file);
    while (tiff + 8 < e.size && memcmp(e.data + tiff, "Exif\0\0", 6)) tiff++;
    if (tiff + 8 >= e.size) return 0;
    e.size -= tiff + 6;
    memmove(e.data, e.data + tiff + 6, e.size);
    e.is_big = e.data[0] == 'M';
    directory = (size_t)gps_number(&e, gps_entry(&e, (size_t)gps_number(&e, 4, 4), 0x8825), 4);
    for (int k = 0; k < 3; k++) out[k] = gps_value(&e, directory, 2 * k + 2);
    return out[0] > -80 && out[0] < 84 && fabs(out[1]) <= 180 && !isnan(out[2]);
}

void gps_say(const oxl_scene *scene, const char *images, const char *survey, FILE *to)
{
    const int views = oxl_scene_view_count(scene);
    int found = 0;
    double place[3];

    for (int i = 0; i < views; i++)
        found += gps_of_view(images, survey, oxl_scene_view(scene, i)->name, place);
    if (found)
        print_format(
            to,
            "gps          %d of %d photos have a GPS position: with --gps, render --ortho, cloud and compare write "
            "UTM coordinates\n",
            found, views);
}

/* ---------------- UTM */

static void gps_utm(const double place[3], int epsg, double out[3])
{
    /* of the ellipsoid, with the scale of UTM: quarter circle by pi / 2 in metres, eccentricity, Krueger's coefficients */
    static const double length = 6364902.166165087, e = 0.08181919084262149, degree = 0.017453292519943295,
                        alpha[] = {8.377318188192541e-4, 7.608496958699166e-7, 1.2034877875966646e-9};
    const double s = sin(place[0] * degree), t = sinh(atanh(s) - e * atanh(e * s)),
                 east = (place[1] - 6 * (epsg % 100) + 183) * degree, xi = atan2(t, cos(east)),
                 eta = atanh(sin(east) / sqrt(1 + t * t));
    double x = eta, y = xi;
    for (int j = 1; j <= 3; j++) {
        x += alpha[j - 1] * cos(2 * j * xi) * sinh(2 * j * eta);
        y += alpha[j - 1] * sin(2 * j * xi) * cosh(2 * j * eta);
    }
    out[0] = 500000 + length * x, out[1] = (epsg > 32700 ? 1e7 : 0) + length * y, out[2] = place[2];
}

/* ---------------- the world */

/* How far the cameras' places reach beside the line from the first to the farthest, units. */
static double gps_width(const struct match *match, int count)
{
    double line[3] = {0}, away[3], across[3], width = 0;
    for (int i = 0; i < 2 * count; i++) { /* the farthest, then the others */
        vector_add(match[i % count].from, -1, match[0].from, away);
        frame_cross(line, away, across);
        if (i >= count) width = fmax(width, frame_length(across) / frame_length(line));
        else if (frame_length(away) > frame_length(line)) memcpy(line, away, sizeof line);
    }
    return width;
}

oxl_result gps_fit(const struct product *p, const char *survey, struct similarity *out, int *epsg)
{
    const int views = oxl_scene_view_count(p->scene);
    struct match *match = product_room((size_t)views, sizeof *match);
    double left = 0, tilt = 90;
    int n = 0, used = 0;
    for (int i = 0; i < views; i++) {
        const oxl_view *v = oxl_scene_view(p->scene, i);
        double place[3];
        if (!gps_of_view(p->a->job.scene.images, survey, v->name, place)) continue;
        if (n == 0) *epsg = (place[0] < 0 ? 32701 : 32601) + (int)floor((place[1] + 180) / 6) % 60;
        gps_utm(place, *epsg, match[n].to);
        frame_eye(&v->camera, match[n].from);
        match[n++].weight = 1;
    }
    for (int pass = 0; pass < GPS_PASSES && n >= GPS_LEAST; pass++) {
        if (!similarity_fit(match, (size_t)n, out)) break;
        used = 0;
        for (int i = 0; i < n; i++) {
            double at[3];
            similarity_apply(out, match[i].from, at);
            vector_add(match[i].to, -1, at, at);
            match[i].off = frame_length(at), used += match[i].weight > 0;
        }
        left = similarity_weigh(match, (size_t)n);
        tilt = GPS_EVEN * left / (out->scale * gps_width(match, n) * sqrt(n));
    }
    free(match);
    if (!(tilt < GPS_TILT))
        return oxl_fail(
            p->ctx, OXL_ERR_INPUT,
            "--gps: %d of %d photos have a GPS position, and the vertical is uncertain by %.0f degrees; expected %d "
            "positions or more that are not on one line\nfix: give measured camera positions to COLMAP's model_aligner instead",
            n, views, fmin(tilt, 90), GPS_LEAST);
    print_format(
        p->to,
        "gps       %d of %d photos, UTM zone %d (EPSG:%d): %.4g metres per unit; %d left out; the others deviate by "
        "%.2g metres (standard deviation); the vertical is uncertain by %.1f degrees\n",
        n, views, *epsg % 100, *epsg, out->scale, n - used, left, tilt);
    return OXL_OK;
}
