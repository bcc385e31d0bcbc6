/* contrast.c - how fast contrast fades with depth: the water's attenuation, measured where photographs show SfM points.
 *
 * Water takes contrast as exp(-beta z) (Akkaynak & Treibitz 2018; the light it adds in return is even). A gradient of the loss is
 * proportional to the picture's contrast and fades alike; so beta says, before the first iteration, whether densification needs
 * help with what is far. With c the log contrast of a patch of pixels around a point, least squares of
 *     c(point, view) = own(point) - beta z(point, view)
 * compares each point with itself alone, seen from several depths: a dull bottom under a bright reef is not taken for water.
 * A patch has a fixed size in pixels: from farther away it shows more of the scene, less finely. On textures without a scale of
 * their own, as most are, that leaves the contrast as it is.
 *
 * Invariant: a measure is a function of the scene. Sums go by point in the file's order, and by view by name.
 */
#include "internal.h"
#include "vecmath.h"

enum {
    CONTRAST_VIEWS  = 128,     /* photographs that are looked at, at most */
    CONTRAST_SAMPLE = 1 << 18, /* observations, at most */
    CONTRAST_RADIUS = 4,       /* px: the patch is 9 x 9 */
    CONTRAST_LEAST  = 100      /* observations that a measure takes */
};
#define CONTRAST_FLOOR 1.0 /* 8-bit levels^2 added to a patch's variance: rounding and the sensor's noise are no contrast */

struct contrast_sample { /* one point in one photograph */
    size_t point;
    int    view, valid;
    double z, value; /* camera z; log contrast */
};
struct contrast_work {
    int                    *view; /* (images of the COLMAP model) the view that is looked at, or -1 */
    struct contrast_sample *sample;
    double                 *by_view; /* (views of the scene) */
    size_t                  samples;
};

/* ---------------------------------------------------------------- which points in which photographs */

static void contrast_choose_views(const oxl_scene *scene, const struct colmap *c, struct contrast_work *w)
{
    const int views = oxl_scene_view_count(scene), step = views / CONTRAST_VIEWS + 1;
    int       seen = 0;
    for (size_t i = 0; i < c->image_count; i++) w->view[i] = -1;
    for (int i = 0; i < views; i++)
        if (!oxl_scene_view(scene, i)->is_test && seen++ % step == 0) w->view[scene_source_image(scene, i) - c->image] = i;
}

/* Whole points, each with all its chosen views; with many, every k-th point. */
static void contrast_choose_samples(const struct colmap *c, struct contrast_work *w)
{
    const size_t step = c->track_count / CONTRAST_SAMPLE + 1;
    for (size_t i = 0; i < c->point_count; i += step)
        for (uint32_t k = 0; k < c->point[i].track_count && w->samples < CONTRAST_SAMPLE; k++) {
            const int view = w->view[c->track[c->point[i].first_track + k].image_row];
            if (view >= 0) w->sample[w->samples++] = (struct contrast_sample){.point = i, .view = view};
        }
}

/* ---------------------------------------------------------------- the contrast of a patch */

/* Log of the standard deviation of the brightness around (x, y); 0 when the patch is not wholly inside and unmasked. */
static int contrast_of_patch(const struct photo *p, int x, int y, double *out)
{
    const size_t pixels = (size_t)p->width * (size_t)p->height;
    const int    side = 2 * CONTRAST_RADIUS + 1, n = side * side;
    double       sum = 0, squares = 0;
    if (x < CONTRAST_RADIUS || y < CONTRAST_RADIUS || x >= p->width - CONTRAST_RADIUS || y >= p->height - CONTRAST_RADIUS)
        return 0;
    for (int i = 0; i < n; i++) {
        const size_t at = (size_t)(y + i / side - CONTRAST_RADIUS) * p->width + (size_t)(x + i % side - CONTRAST_RADIUS);
        const double v  = (p->rgb[at] + p->rgb[at + pixels] + p->rgb[at + 2 * pixels]) / 3.0;
        if (p->mask && p->mask[at] < 128) return 0;
        sum += v;
        squares += v * v;
    }
    *out = 0.5 * vecmath_log((squares - sum * sum / n) / n + CONTRAST_FLOOR);
    return 1;
}

static void contrast_look(const oxl_camera *c, const struct photo *photo, const double p[3], struct contrast_sample *s)
{
    double x[3];
    for (int i = 0; i < 3; i++) {
        const double *r = c->rotation + 3 * i;
        x[i]            = r[0] * p[0] + r[1] * p[1] + r[2] * p[2] + c->translation[i];
    }
    if (!(x[2] > 0 && fabs(x[0]) <= 10 * x[2] && fabs(x[1]) <= 10 * x[2])) return;
    s->z = x[2];
    s->valid =
        contrast_of_patch(photo, (int)floor(c->fx * x[0] / x[2] + c->cx), (int)floor(c->fy * x[1] / x[2] + c->cy), &s->value);
}

/* View by view, so that each photograph is decoded once; one that cannot be read is left out, as training will say. */
static void contrast_look_at_all(oxl_context *ctx, oxl_scene *scene, struct contrast_work *w)
{
    const struct colmap *c      = scene_colmap(scene);
    const double        *origin = oxl_scene_origin(scene);
    for (int view = 0; view < oxl_scene_view_count(scene); view++) {
        const struct photo *photo = NULL;
        for (size_t i = 0; i < w->samples; i++) {
            const double *p = c->point[w->sample[i].point].position;
            if (w->sample[i].view != view) continue;
            if (!photo) photo = scene_photo(ctx, scene, view);
            if (!photo) break;
            contrast_look(&oxl_scene_view(scene, view)->camera, photo,
                          (double[]){p[0] - origin[0], p[1] - origin[1], p[2] - origin[2]}, &w->sample[i]);
        }
    }
}

/* ---------------------------------------------------------------- the fit */

/* z and value become differences from their means over the point; points that are seen once tell nothing. */
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

/* Neither the errors of one point nor those of one photograph are independent: the larger of the two clustered errors
 * (Liang & Zeger 1986). by_view: zeros, one for each view. */
static double contrast_error(const struct contrast_work *w, int views, double beta, double zz)
{
    double points = 0, photographs = 0;
    for (size_t first = 0, end; first < w->samples; first = end) {
        double sum = 0;
        for (end = first; end < w->samples && w->sample[end].point == w->sample[first].point; end++) {
            const struct contrast_sample *s = &w->sample[end];
            const double                  e = s->valid ? s->z * (s->value + beta * s->z) : 0;
            sum += e;
            w->by_view[s->view] += e;
        }
        points += sum * sum;
    }
    for (int i = 0; i < views; i++) photographs += w->by_view[i] * w->by_view[i];
    return sqrt(OXL_MAX(points, photographs)) / zz;
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
    if (out->observations < CONTRAST_LEAST || !(zz > 0)) return;
    out->beta     = -zc / zz;
    out->error    = contrast_error(w, views, out->beta, zz);
    out->measured = 1;
}

OXL_INTERNAL oxl_result contrast_measure(oxl_context *ctx, oxl_scene *scene, struct contrast *out)
{
    const struct colmap *c     = scene_colmap(scene);
    const int            views = oxl_scene_view_count(scene);
    struct contrast_work w     = {0};
    oxl_result           rc    = OXL_OK;
    *out                       = (struct contrast){0};
    if (!c || c->track_count == 0) return OXL_OK;
    w.view    = oxl_alloc(ctx, c->image_count + 1, sizeof *w.view);
    w.sample  = oxl_alloc(ctx, OXL_MIN(c->track_count, (size_t)CONTRAST_SAMPLE) + 1, sizeof *w.sample);
    w.by_view = oxl_calloc(ctx, (size_t)views + 1, sizeof *w.by_view);
    if (!w.view || !w.sample || !w.by_view) {
        rc = oxl_fail(ctx, OXL_ERR_MEMORY, "no memory to measure the contrast of %d photographs", views);
        goto done;
    }
    contrast_choose_views(scene, c, &w);
    contrast_choose_samples(c, &w);
    contrast_look_at_all(ctx, scene, &w);
    contrast_fit(&w, views, out);
done:
    oxl_free(ctx, w.view);
    oxl_free(ctx, w.sample);
    oxl_free(ctx, w.by_view);
    return rc;
}
