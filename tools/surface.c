/* surface.c - finds the surface that the training views of a survey agree on.
 *
 * The depth of each training view is rendered once, at one resolution, for maps, clouds, meshes and comparisons
 * alike. A place is asked of the views that have it in their image, not farther than SURFACE_FAR times the usual
 * distance. A view does not see a place behind a clear surface of its own, by more than SURFACE_TOLERANCE of the
 * depth: walls hide, low ridges do not. Of those that see it, a view confirms the place where its own depth is the
 * place's to within SURFACE_AGREES, and passes it where its own clear depth is beyond, or is a guess: where the
 * survey's points around it lie elsewhere. Every second point is for that; the others measure what is left.
 * docs/log/TRAINING.md has what these rules change.
 */
#include "tools.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* fraction of its depth by which a place may lie behind what the view sees: on a slope it is not at the middle
 * of its pixel */
#define SURFACE_TOLERANCE 0.05
/* difference of the two depths, as a fraction of the depth, or of the usual distance if that is less */
#define SURFACE_AGREES 0.04
/* largest distance of a place that is seen, in usual distances: the horizon of oblique views is left out */
#define SURFACE_FAR 2.0
/* square of the largest distance of a place that is asked for, in usual distances: what is farther off is in no image
 * of 130 degrees */
#define SURFACE_WIDE 25.0
/* difference from a point's depth, as a fraction of it, that does not contradict */
#define SURFACE_NEAR 0.03f
#define SURFACE_SHARE 0.05 /* least share of the points around a pixel that are near its depth */
enum {
    SURFACE_EACH = 31,
    SURFACE_AROUND = 108,    /* points around a pixel, in the mean */
    SURFACE_NEIGHBOURS = 5,  /* least points around a pixel that may contradict its depth */
    SURFACE_PIXELS = 1 << 26 /* most pixels of all views: 8 bytes each */
};

/* ---------------- views */

size_t sheet_pixels(const struct sheet *t)
{
    return (size_t)t->camera.width * t->camera.height;
}

oxl_result sheet_render(const struct surface *s, const oxl_model *model, const struct sheet *t,
                        oxl_image *out)
{
    oxl_render_options o = oxl_render_options_default();
    o.near_plane = (float)oxl_scene_near_plane(s->scene), o.parallel = (float)t->parallel;
    memcpy(o.background, model->background, sizeof o.background);
    return oxl_render(s->ctx, model, &t->camera, &o, out, t->depth);
}

static oxl_result surface_render(struct surface *s, const oxl_model *model, struct surface_view *v)
{
    const size_t pixels = sheet_pixels(&v->sheet);
    oxl_image image = {0};
    oxl_result rc;
    frame_eye(&v->sheet.camera, v->eye);
    v->sheet.depth = product_room(pixels, sizeof *v->sheet.depth);
    v->rgb = product_room(pixels, 3);
    v->guess = product_room(pixels, 1);
    rc = sheet_render(s, model, &v->sheet, &image);
    for (size_t i = 0; i < 3 * pixels && rc == OXL_OK; i++)
        v->rgb[i] = (unsigned char)(255 * fminf(fmaxf(image.rgb[i % 3 * pixels + i / 3], 0), 1) + 0.5f);
    oxl_image_free(s->ctx, &image);
    return rc;
}

/* Sets the usual distance and the sampling: medians over all views of every SURFACE_EACH-th pixel. */
static void surface_measure(struct surface *s)
{
    const size_t most = SURFACE_PIXELS / SURFACE_EACH + (size_t)s->views;
    double *z = product_room(2 * most, sizeof *z), *side = z + most;
    size_t n = 0;
    for (int i = 0; i < s->views; i++) {
        const struct sheet *t = &s->view[i].sheet;
        for (size_t k = 0; k < sheet_pixels(t); k += SURFACE_EACH)
            if (fabsf(t->depth[k]) > 0) z[n] = fabs((double)t->depth[k]), side[n] = z[n] / t->camera.fx, n++;
    }
    s->distance = product_quantile(z, n, 0.5), s->sampling = product_quantile(side, n, 0.5);
    free(z);
}

/* ---------------- places in views */

/* Projects p into the view, at: px, and finds the pixel's index; returns camera z, 0 for a place that is not in the
 * image. */
static double surface_pixel(const struct surface_view *v, const double p[3], double at[2], size_t *pixel)
{
    const oxl_camera *c = &v->sheet.camera;
    double x[3];
    frame_to_camera(c->rotation, p, x);
    vector_add(x, 1, c->translation, x);
    at[0] = c->fx * x[0] / x[2] + c->cx;
    at[1] = c->fy * x[1] / x[2] + c->cy;
    if (!(x[2] > 0 && at[0] >= 0 && at[0] < c->width && at[1] >= 0 && at[1] < c->height)) return 0;
    *pixel = (size_t)at[1] * (size_t)c->width + (size_t)at[0];
    return x[2];
}

/* ---------------- the survey's points */

/* Marks the depths of a view as guesses that have points of the survey around them, but hardly one at that depth. Half
 * of the points, every second, do this. */
static void surface_doubt(const oxl_scene *scene, struct surface_view *v)
{
    const oxl_point *point = oxl_scene_points(scene);
    const size_t points = oxl_scene_point_count(scene), pixels = sheet_pixels(&v->sheet);
    const int width = v->sheet.camera.width;
    unsigned *all = product_room(2 * pixels, sizeof *all), *agree = all + pixels;
    size_t pixel;
    double reach, at[2], n = 1;
    for (size_t i = 0; i < points; i += 2) n += surface_pixel(v, point[i].position, at, &pixel) > 0;
    reach = 0.5 * sqrt(SURFACE_AROUND * (double)pixels / n);
    for (size_t i = 0; i < points; i += 2) {
        const float z = (float)surface_pixel(v, point[i].position, at, &pixel);
        if (!(z > 0)) continue; /* It is not in the image. */
        const int left = (int)fmax(0, at[0] - reach), right = (int)fmin(width, at[0] + reach),
                  bottom = (int)fmin(v->sheet.camera.height, at[1] + reach);
        for (int y = (int)fmax(0, at[1] - reach); y < bottom; y++)
#pragma omp simd
            for (int k = y * width + left; k < y * width + right; k++) {
                const float own = fabsf(v->sheet.depth[k]);
                all[k]++, agree[k] += fabsf(z - own) <= SURFACE_NEAR * own;
            }
    }
    for (size_t k = 0; k < pixels; k++)
        if (all[k] >= SURFACE_NEIGHBOURS && agree[k] < SURFACE_SHARE * all[k]) v->guess[k] = 1;
    free(all);
}

/* ---------------- the whole */

oxl_result surface_open(oxl_context *ctx, const oxl_model *model, const oxl_scene *scene, int side,
                        struct surface *s)
{
    const int count = oxl_scene_view_count(scene);
    double full = 1;
    oxl_result rc = OXL_OK;
    *s = (struct surface){.ctx = ctx, .scene = scene};
    s->view = product_room((size_t)count, sizeof *s->view);
    for (int i = 0; i < count; i++) {
        const oxl_camera *c = &oxl_scene_view(scene, i)->camera;
        full = fmax(full, fmax(c->width, c->height));
    }
    side = (int)fmin(fmin(side, full), sqrt((double)SURFACE_PIXELS / fmax(count, 1)));
    for (int i = 0; i < count && rc == OXL_OK; i++) {
        struct surface_view *v = &s->view[s->views];
        oxl_camera *c = &v->sheet.camera;
        double by;
        if (oxl_scene_view(scene, i)->is_test) continue;
        *c = oxl_scene_view(scene, i)->camera, by = fmin(1, side / fmax(c->width, c->height));
        c->width = fmax(1, floor(c->width * by)), c->height = fmax(1, floor(c->height * by));
        c->fx *= by, c->fy *= by, c->cx *= by, c->cy *= by;
        s->views++;
        rc = surface_render(s, model, v);
    }
    if (rc != OXL_OK) return rc;
    surface_measure(s);
#pragma omp parallel for schedule(dynamic)
    for (int i = 0; i < s->views; i++) surface_doubt(scene, &s->view[i]);
    s->sampling *= side / full;
    return OXL_OK;
}

void surface_close(struct surface *s)
{
    for (int i = 0; i < s->views; i++) {
        free(s->view[i].sheet.depth);
        free(s->view[i].rgb);
        free(s->view[i].guess);
    }
    free(s->view);
}

/* ---------------- votes */

int sheet_place(const struct sheet *t, size_t at, double out[3])
{
    const oxl_camera *c = &t->camera;
    const size_t width = (size_t)c->width;
    const double depth = fabs((double)t->depth[at]), by = t->parallel > 0 ? 1 : depth,
                 from[3] = {by * ((double)(at % width) + 0.5 - c->cx) / c->fx - c->translation[0],
                            by * ((double)(at / width) + 0.5 - c->cy) / c->fy - c->translation[1],
                            depth - c->translation[2]};
    for (int k = 0; k < 3; k++)
        out[k] = c->rotation[k] * from[0] + c->rotation[3 + k] * from[1] + c->rotation[6 + k] * from[2];
    return depth > 0;
}

int surface_holds(const struct surface_vote *v, int enough)
{
    return v->confirms >= enough && 2 * v->confirms > v->passes;
}

static struct surface_vote surface_ask(const struct surface *s, const double p[3])
{
    const double usual = s->distance > 0 ? s->distance : HUGE_VAL;
    struct surface_vote out = {.nearest = -1, .footprint = HUGE_VAL};
    for (int i = 0; i < s->views; i++) {
        const struct surface_view *v = &s->view[i];
        double at[2], away[3], z, own, off, footprint;
        size_t pixel;
        vector_add(v->eye, -1, p, away);
        if (vector_dot(away, away) > SURFACE_WIDE * usual * usual) continue; /* most are, of a large survey */
        z = surface_pixel(v, p, at, &pixel), footprint = z / v->sheet.camera.fx;
        if (!(z > 0 && z <= SURFACE_FAR * usual)) continue;
        own = v->sheet.depth[pixel], off = fabs(own) - z;
        if (own > 0 && !v->guess[pixel] && off >= -s->reach) out.clear++, out.ahead += fmin(off, s->reach);
        if (own > 0 && own < (1 - SURFACE_TOLERANCE) * z) continue;
        out.sees++;
        if (v->guess[pixel] || own > z + SURFACE_TOLERANCE * fmin(z, usual)) out.passes++;
        else if (fabs(off) <= SURFACE_AGREES * fmin(z, usual)) {
            vector_add(out.ray, 1 / frame_length(away), away, out.ray);
            out.confirms++, out.off2 += off / z * (off / z);
            if (footprint < out.footprint) out.footprint = footprint, out.nearest = i;
        }
    }
    return out;
}

void surface_ask_all(const struct surface *s, size_t count,
                     int (*place)(const void *user, size_t at, double p[3]),
                     void (*take)(void *user, size_t at, const double p[3], const struct surface_vote *v),
                     void *user)
{
#pragma omp parallel for schedule(dynamic, 256)
    for (size_t at = 0; at < count; at++) {
        double p[3];
        struct surface_vote vote;
        if (!place(user, at, p)) continue;
        vote = surface_ask(s, p);
        take(user, at, p, &vote);
    }
}
