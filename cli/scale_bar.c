/* scale_bar.c - the scale of a survey in metres per unit: from a scale bar in two images or more, or from a
 * known distance.
 *
 * Each end of the bar is seen along a ray in each image; the point nearest to the rays in the least-squares
 * sense is the end. The length in metres over the length in units is the scale.
 */
#include "cli.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define SCALE_MISS 0.03 /* of the bar's length, by which a ray may miss its end */

struct scale_end {
    /* of the normal equations: sum of (I - d d^T), and of it times the ray's origin */
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

/* By Cramer's rule; 0: the rays are parallel. */
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

static int scale_comma(const char **at, const char *end)
{
    if (*at >= end || **at != ',') return 0;
    ++*at;
    return 1;
}

/* One end: "IMG,X,Y,IMG,X,Y..." or "X,Y,Z". */
static oxl_result scale_read_end(oxl_context *ctx, const oxl_scene *scene, const char *text, size_t length,
                                 double out[3], double *miss)
{
    struct scale_end e = {{{0}}, {0}, 0};
    const char *end = text + length, *at = text;
    double ray[64][6];
    for (int k = 0; k < 3; k++) {
        out[k] = oxl_json_number_at(&at);
        if (isnan(out[k]) || (k < 2 && !scale_comma(&at, end))) break;
        if (k == 2 && at == end) {
            for (int i = 0; i < 3; i++) out[i] -= oxl_scene_origin(scene)[i];
            *miss = 0;
            return OXL_OK;
        }
    }
    for (at = text; at < end && e.rays < 64;) {
        const size_t name = strcspn(at, ",:");
        const int view = scale_view(scene, at, name);
        double pixel[2], *r = ray[e.rays];
        oxl_result rc;
        if (view < 0) return scale_fail(ctx, "no image is called", at, name);
        at += name;
        for (int k = 0; k < 2; k++) {
            pixel[k] = scale_comma(&at, end) ? oxl_json_number_at(&at) : NAN;
            if (isnan(pixel[k])) return scale_fail(ctx, "a pixel is expected in", text, length);
        }
        rc = oxl_scene_ray(ctx, scene, view, pixel[0], pixel[1], r, r + 3);
        if (rc != OXL_OK) return rc;
        scale_add_ray(&e, r, r + 3);
        if (at < end && !scale_comma(&at, end))
            return scale_fail(ctx, "a comma is expected in", text, length);
    }
    if (e.rays < 2 || !scale_solve(&e, out))
        return scale_fail(ctx, "an end must be visible in two images from different positions in", text,
                          length);
    *miss = 0;
    for (int i = 0; i < e.rays; i++) {
        double from[3], across[3];
        for (int k = 0; k < 3; k++) from[k] = out[k] - ray[i][k];
        frame_cross(from, ray[i] + 3, across);
        *miss = fmax(*miss, sqrt(across[0] * across[0] + across[1] * across[1] + across[2] * across[2]));
    }
    return OXL_OK;
}

oxl_result scale_measure(oxl_context *ctx, const oxl_scene *scene, const char *bar, double length, FILE *to)
{
    const char *colon = strchr(bar, ':');
    const double *origin = oxl_scene_origin(scene);
    double end[2][3], miss[2], units = 0;
    oxl_result rc;
    if (!colon) return scale_fail(ctx, "expected two ends with a colon between, found", bar, strlen(bar));
    rc = scale_read_end(ctx, scene, bar, (size_t)(colon - bar), end[0], &miss[0]);
    if (rc == OXL_OK) rc = scale_read_end(ctx, scene, colon + 1, strlen(colon + 1), end[1], &miss[1]);
    if (rc != OXL_OK) return rc;
    for (int k = 0; k < 3; k++) units += (end[1][k] - end[0][k]) * (end[1][k] - end[0][k]);
    units = sqrt(units);
    if (length > 0 && !(units > 0))
        return oxl_fail(
            ctx, OXL_ERR_INPUT,
            "--scale-bar: both ends are at the same place, so --length %g has no scale\nfix: give two different ends",
            length);
    for (int i = 0; i < 2; i++)
        if (miss[i] > SCALE_MISS * units)
            return oxl_fail(
                ctx, OXL_ERR_INPUT,
                "--scale-bar: the rays of end %d miss each other by %.3g units, %.0f %% of the bar's %.3g; at most "
                "%.0f %% are expected\nfix: mark the same point in all of its images, and check their poses",
                i + 1, miss[i], units > 0 ? 100 * miss[i] / units : 100.0, units, 100 * SCALE_MISS);
    for (int i = 0; i < 2; i++)
        fprintf(to, "end %d     %.6f %.6f %.6f, its rays miss it by at most %.3g units\n", i + 1,
                end[i][0] + origin[0], end[i][1] + origin[1], end[i][2] + origin[2], miss[i]);
    fprintf(to, "distance  %.9g units\n", units);
    if (length > 0 && units > 0) fprintf(to, "scale     %.9g metres a unit\n", length / units);
    return OXL_OK;
}
