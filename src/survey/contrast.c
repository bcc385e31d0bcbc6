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
#include "sparse.h"
#include "image.h"
#include "scene.h"
#include "survey.h"
#include "../core/vecmath.h"
#include "tracks.h"

enum {
    CONTRAST_VIEWS = 128,      /* most images */
    CONTRAST_SAMPLE = 1 << 18, /* most observations */
    CONTRAST_CELLS = 7,        /* cells on a side of a patch */
    CONTRAST_MIN = 100         /* least observations */
};
#define CONTRAST_CELL 2.0     /* Sets the width (px) of a cell in the farthest view of a point. */
#define CONTRAST_CELL_MAX 8.0 /* Limits the width (px) of a cell: nearer views are left out. */
/* Adds this (8-bit levels^2) to the variance, so that rounding and sensor noise do not count as contrast. */
#define CONTRAST_FLOOR 1.0

struct contrast_sample { /* Holds one point in one image. */
    size_t point;
    int view, valid;
    double z, value;  /* camera z; log contrast of the patch */
    float x, y, cell; /* px; position, width of a cell */
};
struct contrast_work {
    int *view;   /* (images of the COLMAP model) view of the image; -1: not used */
    int *chosen; /* (chosen_count) the views used */
    int chosen_count;
    struct contrast_sample *sample;
    double *by_view;    /* (views of the scene) sums of contrast_error */
    uint32_t *integral; /* (H+1,W+1) integral image; differences are right even where sums wrap */
    size_t integral_capacity;
    size_t samples;
};

/* ---------------- which points in which images */

static void contrast_choose_views(const oxl_scene *scene, const struct colmap *c, struct contrast_work *w)
{
    const int views = oxl_scene_view_count(scene), step = views / CONTRAST_VIEWS + 1;
    int seen = 0;
    for (size_t i = 0; i < c->image_count; i++) w->view[i] = -1;
    for (int i = 0; i < views; i++) {
        if (oxl_scene_view(scene, i)->is_test || seen++ % step != 0) continue;
        w->view[scene_source_image(scene, i) - c->image] = i;
        w->chosen[w->chosen_count++] = i;
    }
}

/* Takes points with all their chosen views; every k-th point if there are too many. */
static void contrast_choose_samples(const struct colmap *c, struct contrast_work *w)
{
    const size_t step = c->track_count / CONTRAST_SAMPLE + 1;
    for (size_t i = 0; i < c->point_count; i += step) {
        struct tracks_walk own = tracks_of_point(c, w->view, i);
        while (w->samples < CONTRAST_SAMPLE && tracks_next(&own))
            w->sample[w->samples++] = (struct contrast_sample){.point = i, .view = own.view};
    }
}

/* Projects each sample, marks those outside the image, and sets the width of its patch's cells in pixels,
 * such that all views of a point have cells of equal size in the scene. */
static void contrast_size_cells(const oxl_scene *scene, struct contrast_work *w)
{
    for (size_t first = 0, end; first < w->samples; first = end) {
        double size = 0; /* size of a pixel of the farthest view, in the scene's unit */
        for (end = first; end < w->samples && w->sample[end].point == w->sample[first].point; end++) {
            struct contrast_sample *s = &w->sample[end];
            double x[3], pixel[2];
            s->valid = scene_project_point(scene, s->view, s->point, x, pixel);
            if (!s->valid) continue;
            s->z = x[2], s->x = (float)pixel[0], s->y = (float)pixel[1];
            size = OXL_MAX(size, s->z / oxl_scene_view(scene, s->view)->camera.fx);
        }
        for (size_t i = first; i < end; i++) {
            struct contrast_sample *s = &w->sample[i];
            if (s->valid)
                s->cell = (float)(CONTRAST_CELL * size * oxl_scene_view(scene, s->view)->camera.fx / s->z);
            s->valid = s->valid && s->cell <= CONTRAST_CELL_MAX;
        }
    }
}

/* ---------------- the contrast of a patch */

static oxl_result contrast_integrate(oxl_context *ctx, const struct training_image *image,
                                     struct contrast_work *w)
{
    const size_t pixels = (size_t)image->width * (size_t)image->height, stride = (size_t)image->width + 1;
    const oxl_result rc = oxl_reserve(ctx, &w->integral, &w->integral_capacity,
                                      stride * ((size_t)image->height + 1), sizeof *w->integral);
    if (rc != OXL_OK) return rc;
    memset(w->integral, 0, stride * sizeof *w->integral);
    for (int y = 0; y < image->height; y++) {
        const uint8_t *rgb = image->rgb + (size_t)y * image->width;
        uint32_t *above = w->integral + (size_t)y * stride, *out = above + stride, sum = 0;
        out[0] = 0;
        for (int x = 0; x < image->width; x++) {
            sum += (uint32_t)rgb[x] + rgb[x + pixels] + rgb[x + 2 * pixels];
            out[x + 1] = above[x + 1] + sum;
        }
    }
    return OXL_OK;
}

/* Computes the logarithm of the standard deviation of the cells' brightness; the sample becomes invalid
 * unless the patch is inside the image and unmasked. */
static void contrast_of_patch(const struct training_image *image, const uint32_t *integral,
                              struct contrast_sample *s)
{
    const size_t stride = (size_t)image->width + 1;
    const float left = s->x - 0.5f * CONTRAST_CELLS * s->cell, top = s->y - 0.5f * CONTRAST_CELLS * s->cell;
    const float side = CONTRAST_CELLS * s->cell;
    const int n = CONTRAST_CELLS * CONTRAST_CELLS;
    double sum = 0, squares = 0;
    int x[CONTRAST_CELLS + 1], y[CONTRAST_CELLS + 1]; /* px; borders of the cells */
    s->valid = left >= 0 && top >= 0 && left + side <= (float)image->width - 1 &&
               top + side <= (float)image->height - 1;
    if (!s->valid) return;
    for (int k = 0; k <= CONTRAST_CELLS; k++)
        x[k] = (int)(left + k * s->cell + 0.5f), y[k] = (int)(top + k * s->cell + 0.5f);
    for (int i = 0; i < n && s->valid; i++) {
        const int *x0 = x + i % CONTRAST_CELLS, *y0 = y + i / CONTRAST_CELLS;
        const uint32_t *above = integral + y0[0] * stride, *below = integral + y0[1] * stride;
        const double v = (double)(below[x0[1]] - below[x0[0]] - above[x0[1]] + above[x0[0]]) /
                         (3.0 * (x0[1] - x0[0]) * (y0[1] - y0[0]));
        s->valid = !image->mask || image->mask[y0[0] * (stride - 1) + x0[0]] >= 128;
        sum += v;
        squares += v * v;
    }
    s->value = 0.5 * vecmath_log(OXL_MAX((squares - sum * sum / n) / n, 0) + CONTRAST_FLOOR);
}

/* Measures all samples of one image. */
static void contrast_of_image(const oxl_context *ctx, const struct training_image *image, int view,
                              struct contrast_work *w)
{
    const int64_t samples = (int64_t)w->samples;
    (void)ctx; /* unused without OpenMP */
#pragma omp parallel for schedule(static) num_threads(ctx->threads)
    for (int64_t i = 0; i < samples; i++) {
        struct contrast_sample *s = &w->sample[i];
        if (s->view != view || !s->valid) continue;
        if (image) contrast_of_patch(image, w->integral, s);
        else s->valid = 0;
    }
}

/* Measures view by view, so that each image is loaded once; leaves out unreadable images. */
static oxl_result contrast_of_images(oxl_context *ctx, const oxl_scene *scene, struct contrast_work *w)
{
    oxl_result rc = OXL_OK;
    for (int k = 0; k < w->chosen_count && rc == OXL_OK; k++) {
        const struct training_image *image;
        if ((rc = context_stopped(ctx)) != OXL_OK) break;
        scene_images_ahead(ctx, scene, w->chosen + k, w->chosen_count - k);
        image = scene_image(ctx, scene, w->chosen[k]);
        if (!image && ctx->failed != OXL_ERR_INPUT) return ctx->failed;
        if (image) rc = contrast_integrate(ctx, image, w);
        if (rc == OXL_OK) contrast_of_image(ctx, image, w->chosen[k], w);
    }
    return rc;
}

/* ---------------- the fit */

/* Subtracts the means of z and value over each point, which removes own(point);
 * drops points with one view. */
static void contrast_centre(struct contrast_work *w, struct contrast *out)
{
    for (size_t first = 0, end; first < w->samples; first = end) {
        double z = 0, value = 0, n = 0;
        for (end = first; end < w->samples && w->sample[end].point == w->sample[first].point; end++)
            if (w->sample[end].valid) z += w->sample[end].z, value += w->sample[end].value, n += 1;
        for (size_t i = first; i < end; i++) {
            w->sample[i].valid = w->sample[i].valid && n > 1;
            w->sample[i].z -= n > 0 ? z / n : 0;
            w->sample[i].value -= n > 0 ? value / n : 0;
            out->observations += (size_t)w->sample[i].valid;
        }
        out->points += n > 1;
    }
}

/* Returns the standard error of beta. Errors are correlated within a point and within an image, so it takes
 * the larger of the two clustered standard errors (Liang & Zeger 1986). by_view: (views) zeros. */
static double contrast_error(const struct contrast_work *w, int views, double beta, double zz)
{
    double points = 0, images = 0;
    for (size_t first = 0, end; first < w->samples; first = end) {
        double sum = 0;
        for (end = first; end < w->samples && w->sample[end].point == w->sample[first].point; end++) {
            const struct contrast_sample *s = &w->sample[end];
            const double e = s->valid ? s->z * (s->value + beta * s->z) : 0;
            sum += e;
            w->by_view[s->view] += e;
        }
        points += sum * sum;
    }
    for (int i = 0; i < views; i++) images += w->by_view[i] * w->by_view[i];
    return sqrt(OXL_MAX(points, images)) / zz;
}

static void contrast_fit(struct contrast_work *w, int views, struct contrast *out)
{
    double zz = 0, zc = 0;
    contrast_centre(w, out);
    for (size_t i = 0; i < w->samples; i++) {
        if (!w->sample[i].valid) continue;
        zz += w->sample[i].z * w->sample[i].z;
        zc += w->sample[i].z * w->sample[i].value;
    }
    if (out->observations < CONTRAST_MIN || !(zz > 0)) return;
    out->beta = -zc / zz;
    out->error = contrast_error(w, views, out->beta, zz);
    out->measured = 1;
}

OXL_INTERNAL oxl_result contrast_measure(oxl_context *ctx, const oxl_scene *scene, struct contrast *out)
{
    const struct colmap *c = scene_colmap(scene);
    const int views = oxl_scene_view_count(scene);
    struct contrast_work w = {0};
    oxl_result rc = OXL_OK;
    *out = (struct contrast){0};
    if (!c || c->track_count == 0) return OXL_OK;
    w.view = oxl_alloc(ctx, c->image_count + 1, sizeof *w.view);
    w.chosen = oxl_alloc(ctx, (size_t)views + 1, sizeof *w.chosen);
    w.sample = oxl_alloc(ctx, OXL_MIN(c->track_count, (size_t)CONTRAST_SAMPLE) + 1, sizeof *w.sample);
    w.by_view = oxl_calloc(ctx, (size_t)views + 1, sizeof *w.by_view);
    if (!w.view || !w.chosen || !w.sample || !w.by_view) rc = OXL_ERR_MEMORY;
    if (rc != OXL_OK) goto done;
    contrast_choose_views(scene, c, &w);
    contrast_choose_samples(c, &w);
    contrast_size_cells(scene, &w);
    rc = contrast_of_images(ctx, scene, &w);
    if (rc == OXL_OK) contrast_fit(&w, views, out);
done:
    OXL_FREE(ctx, w.view, w.chosen, w.sample, w.by_view, w.integral);
    return rc;
}
