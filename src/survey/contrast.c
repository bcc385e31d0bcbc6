/* contrast.c - estimates the attenuation of contrast with depth from image patches around SfM points.
 *
 * Water reduces contrast by exp(-beta z) (Akkaynak & Treibitz 2018; backscatter is smooth). Gradients of the
 * loss are proportional to image contrast, so beta predicts, before the first iteration, whether
 * densification needs depth weights. With c the log contrast of a patch around a point, the least-squares fit
 * of
 *     c(point, view) = own(point) - beta z(point, view)
 * compares each point only with itself at several depths, so texture that varies with depth does not bias
 * beta. A patch covers the same part of the scene in all views of a point, in cells of equal size in the
 * scene: 2 px wide in the farthest view. With fixed sizes in pixels, beta would be biased (-0.07 on the
 * synthetic orbit without water).
 *
 * Invariant: the estimate is a function of the scene. Sums follow the file order of points and the name order
 * of views.
 */
#include "survey.h"
#include "scene.h"
#include "track_samples.h"
#include "../core/vecmath.h"

enum {
    CONTRAST_SAMPLE = 1 << 16, /* most observations */
    CONTRAST_CELLS = 7,        /* cells on a side of a patch */
    CONTRAST_MIN = 100         /* least observations */
};
#define CONTRAST_CELL 2.0f     /* Sets the width (px) of a cell in the farthest view of a point. */
#define CONTRAST_CELL_MAX 8.0f /* Limits the width (px) of a cell: nearer views are left out. */
/* Adds this (8-bit levels^2) to the variance, so that rounding and sensor noise do not count as contrast. */
#define CONTRAST_FLOOR 1.0

/* Measures the logarithm of the standard deviation of the cells' brightness; invalid unless the patch is
 * inside the image and unmasked. */
static int contrast_of_patch(const struct training_image *image, struct track_sample *s)
{
    const float cell = CONTRAST_CELL * s->near, half = 0.5f * CONTRAST_CELLS * cell;
    const int n = CONTRAST_CELLS * CONTRAST_CELLS;
    double sum = 0, squares = 0;
    if (cell > CONTRAST_CELL_MAX || s->x < half || s->y < half) return 0;
    for (int i = 0; i < n; i++) {
        int at[2][2]; /* px; first corner of the cell and the one behind it */
        double rgb[3], v;
        for (int k = 0; k < 2; k++) {
            at[k][0] = (int)(s->x - half + (float)(i % CONTRAST_CELLS + k) * cell + 0.5f);
            at[k][1] = (int)(s->y - half + (float)(i / CONTRAST_CELLS + k) * cell + 0.5f);
        }
        if (!track_sample_sum(image, at[0], at[1], rgb)) return 0;
        v = (rgb[0] + rgb[1] + rgb[2]) / (3.0 * (at[1][0] - at[0][0]) * (at[1][1] - at[0][1]));
        sum += v;
        squares += v * v;
    }
    s->value[0] = (float)(0.5 * vecmath_log(OXL_MAX((squares - sum * sum / n) / n, 0) + CONTRAST_FLOOR));
    return 1;
}

/* Subtracts the means of z and value over each point, which removes own(point). */
static void contrast_centre(struct track_samples *s)
{
    for (size_t first = 0, end; first < s->count; first = end) {
        double z = 0, value = 0, n;
        end = track_samples_end(s, first);
        n = (double)(end - first);
        for (size_t i = first; i < end; i++) z += s->at[i].z, value += (double)s->at[i].value[0];
        for (size_t i = first; i < end; i++) {
            s->at[i].z -= z / n;
            s->at[i].value[0] -= (float)(value / n);
        }
    }
}

/* Returns the standard error of beta. Errors are correlated within a point and within an image, so it takes
 * the larger of the two clustered standard errors (Liang & Zeger 1986). */
static double contrast_error(const struct track_samples *s, double beta, double zz)
{
    double points = 0, images = 0, by_view[TRACK_SAMPLES_VIEWS] = {0};
    for (size_t first = 0, end; first < s->count; first = end) {
        double sum = 0;
        end = track_samples_end(s, first);
        for (size_t i = first; i < end; i++) {
            const double z = s->at[i].z, e = z * ((double)s->at[i].value[0] + beta * z);
            sum += e;
            by_view[s->at[i].view] += e;
        }
        points += sum * sum;
    }
    for (int v = 0; v < s->views; v++) images += by_view[v] * by_view[v];
    return sqrt(OXL_MAX(points, images)) / zz;
}

static void contrast_fit(struct track_samples *s, struct contrast *out)
{
    double zz = 0, zc = 0;
    contrast_centre(s);
    for (size_t i = 0; i < s->count; i++) {
        zz += s->at[i].z * s->at[i].z;
        zc += s->at[i].z * (double)s->at[i].value[0];
        out->points += i == 0 || s->at[i].point != s->at[i - 1].point;
    }
    if (s->count < CONTRAST_MIN || !(zz > 0)) return;
    out->beta = -zc / zz;
    out->error = contrast_error(s, out->beta, zz);
    out->measured = 1;
}

OXL_INTERNAL oxl_result contrast_measure(oxl_context *ctx, const oxl_scene *scene, struct contrast *out)
{
    struct track_samples s;
    oxl_result rc;
    *out = (struct contrast){0};
    if (!scene_colmap(scene) || scene_colmap(scene)->track_count == 0) return OXL_OK;
    rc = track_samples_take(ctx, scene, CONTRAST_SAMPLE, 2, &s);
    if (rc == OXL_OK) rc = track_samples_measure(ctx, scene, contrast_of_patch, &s);
    if (rc == OXL_OK) contrast_fit(&s, out);
    track_samples_free(ctx, &s);
    return rc;
}
