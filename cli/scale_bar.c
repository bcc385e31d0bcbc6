/* scale_bar.c - measures the scale of a survey in metres per unit, from scale bars in two images or more, or
 * from known distances.
 *
 * Each end of a bar is seen along a ray in each image; the end is the point nearest to the rays in the
 * least-squares sense. The scale is the one by which the lengths in units fit those in metres best; what is
 * left of each bar tells a wrong click, or a bent model.
 */
#include "cli.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Limits by how much a ray may miss its end, as a fraction of the bar's length, and
 * of the camera's distance. */
#define SCALE_MISS 0.03
#define SCALE_LEFT 0.03 /* Warns from a residual of this fraction of a bar's length on. */

enum { SCALE_BARS = 100, SCALE_RAYS = 64 };

struct scale_bar {
    double end[2][3], miss[2];
    double distance[2];   /* distance of each end from the nearest camera that marks it; 0: none does */
    double units, metres; /* length; metres 0: not known */
};

struct scale_end {
    /* normal equations: the sum of (I - d d^T), and the sum of that times the ray's origin */
    double sum[3][3], right[3];
    int rays;
};

static void scale_add_ray(struct scale_end *e, const double origin[3], const double direction[3])
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            const double across = (i == j) - direction[i] * direction[j];
            e->sum[i][j] += across;
            e->right[i] += across * origin[j];
        }
    e->rays++;
}

/* Solves the normal equations by Cramer's rule. Returns 0 if the rays are parallel. */
static int scale_solve(const struct scale_end *e, double out[3])
{
    double c[3][3], det;
    for (int i = 0; i < 3; i++) frame_cross(e->sum[(i + 1) % 3], e->sum[(i + 2) % 3], c[i]);
    det = e->sum[0][0] * c[0][0] + e->sum[0][1] * c[0][1] + e->sum[0][2] * c[0][2];
    for (int k = 0; k < 3; k++)
        out[k] = (e->right[0] * c[0][k] + e->right[1] * c[1][k] + e->right[2] * c[2][k]) / det;
    return det > 1e-9 * e->rays * e->rays * e->rays;
}

static int scale_view(const oxl_scene *scene, const char *name, size_t length)
{
    for (int i = 0; i < oxl_scene_view_count(scene); i++) {
        const char *its = oxl_scene_view(scene, i)->name;
        if (strlen(its) == length && memcmp(its, name, length) == 0) return i;
    }
    return -1;
}

static oxl_result scale_fail(oxl_context *ctx, const char *what, const char *text, size_t length)
{
    return oxl_fail(
        ctx, OXL_ERR_USAGE,
        "--scale-bar: %s '%.*s'\nfix: as IMG1,X,Y,IMG2,X,Y:IMG1,X,Y,IMG2,X,Y, the pixels of both ends, or "
        "X,Y,Z:X,Y,Z in the survey's units",
        what, (int)(length < 200 ? length : 200), text);
}

/* Takes three numbers alone as X,Y,Z, even if an image has a number for a name: a place in
 * images needs two of them. */
oxl_result scale_place(oxl_context *ctx, const oxl_scene *scene, const char *text, size_t length,
                       double out[3], double *miss, double *distance)
{
    struct scale_end e = {{{0}}, {0}, 0};
    double ray[SCALE_RAYS][6], pixel[2];
    int used = 0;
    if (sscanf(text, "%lf,%lf,%lf%n", &out[0], &out[1], &out[2], &used) == 3 && (size_t)used == length) {
        for (int i = 0; i < 3; i++) out[i] -= oxl_scene_origin(scene)[i];
        *miss = *distance = 0;
        return OXL_OK;
    }
    for (const char *at = text; at < text + length && e.rays < SCALE_RAYS; at += used) {
        const size_t name = strcspn(at, ",:");
        const int view = scale_view(scene, at, name);
        double *r = ray[e.rays];
        oxl_result rc;
        if (view < 0) return scale_fail(ctx, "no image is called", at, name);
        at += name;
        if (sscanf(at, ",%lf,%lf%n", &pixel[0], &pixel[1], &used) != 2)
            return scale_fail(ctx, "a pixel is expected in", text, length);
        rc = oxl_scene_ray(ctx, scene, view, pixel[0], pixel[1], r, r + 3);
        if (rc != OXL_OK) return rc;
        scale_add_ray(&e, r, r + 3);
        if (at + used < text + length && at[used++] != ',')
            return scale_fail(ctx, "a comma is expected in", text, length);
    }
    if (e.rays < 2 || !scale_solve(&e, out))
        return scale_fail(ctx, "an end must be visible in two images from different positions in", text,
                          length);
    *miss = 0;
    *distance = HUGE_VAL;
    for (int i = 0; i < e.rays; i++) {
        double from[3], across[3];
        for (int k = 0; k < 3; k++) from[k] = out[k] - ray[i][k];
        *distance = fmin(*distance, frame_length(from));
        frame_cross(from, ray[i] + 3, across);
        *miss = fmax(*miss, frame_length(across));
    }
    return OXL_OK;
}

/* Reads the bar in `size` bytes, with its length in metres behind '='. */
static oxl_result scale_read_bar(oxl_context *ctx, const oxl_scene *scene, const char *text, size_t size,
                                 struct scale_bar *out)
{
    const char *colon = memchr(text, ':', size), *equals = memchr(text, '=', size), *end = text + size;
    oxl_result rc;
    if (!colon) return scale_fail(ctx, "expected two ends with a colon between, found", text, size);
    if (equals && equals > colon) {
        const char *at = equals + 1;
        out->metres = oxl_json_number_at(&at);
        if (!(out->metres > 0) || at != end)
            return scale_fail(ctx, "expected metres behind '=' in", text, size);
        end = equals;
    }
    rc = scale_place(ctx, scene, text, (size_t)(colon - text), out->end[0], &out->miss[0], &out->distance[0]);
    if (rc == OXL_OK)
        rc = scale_place(ctx, scene, colon + 1, (size_t)(end - colon - 1), out->end[1], &out->miss[1],
                         &out->distance[1]);
    for (int k = 0; k < 3 && rc == OXL_OK; k++)
        out->units += (out->end[1][k] - out->end[0][k]) * (out->end[1][k] - out->end[0][k]);
    out->units = sqrt(out->units);
    return rc;
}

/* Refuses rays that miss each other by too much of the bar, or of the distance from which they were seen: a
 * wrong click far away makes a long bar, of which the miss is a small part. */
static oxl_result scale_check(oxl_context *ctx, const struct scale_bar *b)
{
    if (b->metres > 0 && !(b->units > 0))
        return oxl_fail(
            ctx, OXL_ERR_INPUT,
            "--scale-bar: both ends are at the same place, so --length %g has no scale\nfix: give two different ends",
            b->metres);
    for (int i = 0; i < 2; i++) {
        const int by_bar = b->miss[i] > SCALE_MISS * b->units;
        const double of = by_bar ? b->units : b->distance[i];
        if (b->miss[i] > SCALE_MISS * of)
            return oxl_fail(
                ctx, OXL_ERR_INPUT,
                "--scale-bar: the rays of end %d miss each other by %.3g units, %.0f %% of the %s %.3g; at most "
                "%.0f %% are expected\nfix: mark the same point in all of its images, and check their poses",
                i + 1, b->miss[i], of > 0 ? 100 * b->miss[i] / of : 100.0,
                by_bar ? "bar's" : "camera's distance of", of, 100 * SCALE_MISS);
    }
    return OXL_OK;
}

static void scale_print(const oxl_scene *scene, const struct scale_bar *b, FILE *to)
{
    const double *origin = oxl_scene_origin(scene);
    for (int i = 0; i < 2; i++)
        fprintf(to, "end %d     %.6f %.6f %.6f, its rays miss it by at most %.3g units\n", i + 1,
                b->end[i][0] + origin[0], b->end[i][1] + origin[1], b->end[i][2] + origin[2], b->miss[i]);
    fprintf(to, "distance  %.6g units\n", b->units);
}

/* Fits the scale to all bars of known length by least squares, and prints it, and what it leaves of each
 * bar if there are several. */
static void scale_print_fit(const struct scale_bar *bar, int count, FILE *to)
{
    double products = 0, squares = 0, scale;
    int known = 0;
    for (int i = 0; i < count; i++)
        if (bar[i].metres > 0) {
            products += bar[i].metres * bar[i].units, squares += bar[i].units * bar[i].units;
            known++;
        }
    if (!(squares > 0)) return;
    scale = products / squares;
    for (int i = 0; i < count && known > 1; i++) {
        const double left = bar[i].metres - scale * bar[i].units;
        if (!(bar[i].metres > 0)) continue;
        fprintf(to, "bar %-5d %.6g m, measured %.6g m, residual %.3g m%s\n", i + 1, bar[i].metres,
                scale * bar[i].units, left,
                fabs(left) > SCALE_LEFT * bar[i].metres ? ": warning, more than 3 %" : "");
    }
    fprintf(to, "scale     %.6g metres per unit\n", scale);
}

oxl_result scale_measure(oxl_context *ctx, const oxl_scene *scene, const char *bars, double length, FILE *to)
{
    struct scale_bar bar[SCALE_BARS];
    oxl_result rc = OXL_OK;
    int count = 0;
    for (const char *at = bars; rc == OXL_OK && *at; at += *at == ';') {
        const size_t size = strcspn(at, ";");
        if (count == SCALE_BARS) return scale_fail(ctx, "more than 100 bars:", at, size);
        bar[count] = (struct scale_bar){.metres = length};
        rc = scale_read_bar(ctx, scene, at, size, &bar[count]);
        if (rc == OXL_OK) rc = scale_check(ctx, &bar[count++]);
        at += size;
    }
    if (rc != OXL_OK) return rc;
    for (int i = 0; i < count; i++) scale_print(scene, &bar[i], to);
    scale_print_fit(bar, count, to);
    return OXL_OK;
}
