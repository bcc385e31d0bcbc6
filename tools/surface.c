/* surface.c - finds the surface that the training views of a survey agree on.
 *
 * The depth of each training view is rendered once, at one resolution, for maps, clouds, meshes and comparisons
 * alike. A place is asked of the views that have it in their image, not farther than SURFACE_FAR times the usual
 * distance. A view does not see a place behind a clear surface of its own, by more than SURFACE_TOLERANCE of the
 * depth: walls hide, low ridges do not. Of those that see it, a view confirms the place where its own depth is the
 * place's to within SURFACE_AGREES, and passes it where its own clear depth is beyond. A pixel does neither where
 * its depth is a guess: where the view has no detail, as the depth of haze and of even ground is whatever fits its
 * colour, and where the survey's points around it lie elsewhere. Every second point is for that; the others
 * measure what is left. docs/log/TRAINING.md has what these rules change.
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
/* least rms of detail, as a fraction of the mean grey; 0.0025 and 0.01 give the same heights */
#define SURFACE_CONTRAST 0.005
/* difference from a point's depth, as a fraction of it, that does not contradict */
#define SURFACE_NEAR 0.03
#define SURFACE_SHARE 0.05 /* least share of the points around a pixel that are near its depth */
enum {
    SURFACE_CONTRADICTED = 2, /* a guess that the survey's points contradict */
    SURFACE_BIN_POINTS = 12,  /* points in a bin of a view, in the mean */
    SURFACE_NEIGHBOURS = 5,   /* least points around a pixel that may contradict its depth */
    SURFACE_REACH = 4,        /* px; detail is what differs from the mean within this reach */
    SURFACE_PIXELS = 1 << 26  /* most pixels of all views: 8 bytes each */
};

/* ---------------- detail */

/* Sets `out` (width,height) to the means over SURFACE_REACH on both sides along the rows of `from`, transposed,
 * so that a second call averages the columns. */
static void surface_mean_rows(const float *from, int width, int height, float *out)
{
    for (int y = 0; y < height; y++)
        for (int x = 0; x < width; x++) {
            const int first = x > SURFACE_REACH ? x - SURFACE_REACH : 0,
                      last = x + SURFACE_REACH < width ? x + SURFACE_REACH : width - 1;
            float sum = 0;
            for (int i = first; i <= last; i++) sum += from[y * width + i];
            out[x * height + y] = sum / (float)(last - first + 1);
        }
}

/* Marks pixels without detail as guesses. Destroys the image, whose planes hold what is on the way. */
static void surface_find_plain(const oxl_image *image, unsigned char *guess)
{
    const int width = image->width, height = image->height, pixels = width * height;
    float *grey = image->rgb, *turned = image->rgb + pixels, *mean = image->rgb + 2 * pixels;
    for (int i = 0; i < pixels; i++) grey[i] = (grey[i] + turned[i] + mean[i]) / 3;
    surface_mean_rows(grey, width, height, turned);
    surface_mean_rows(turned, height, width, mean);
    for (int i = 0; i < pixels; i++) grey[i] = (grey[i] - mean[i]) * (grey[i] - mean[i]);
    surface_mean_rows(grey, width, height, turned);
    surface_mean_rows(turned, height, width, grey);
    for (int i = 0; i < pixels; i++) guess[i] = !(sqrtf(grey[i]) > (float)SURFACE_CONTRAST * mean[i]);
}

/* ---------------- views */

static oxl_camera surface_camera(const oxl_camera *full, int side)
{
    const double by = fmin(1, (double)side / fmax(full->width, full->height));
    oxl_camera c = *full;
    c.width = (int)fmax(1, floor(full->width * by)), c.height = (int)fmax(1, floor(full->height * by));
    c.fx *= by, c.fy *= by, c.cx *= by, c.cy *= by;
    return c;
}

static oxl_result surface_render(struct surface *s, const oxl_model *model, struct surface_view *v)
{
    const size_t pixels = (size_t)v->camera.width * (size_t)v->camera.height;
    oxl_render_options render = oxl_render_options_default();
    oxl_image image = {0};
    oxl_result rc = OXL_OK;
    render.near_plane = (float)oxl_scene_near_plane(s->scene);
    memcpy(render.background, model->background, sizeof render.background);
    v->depth = malloc(pixels * sizeof *v->depth);
    v->rgb = malloc(3 * pixels);
    v->guess = malloc(pixels);
    if (!v->depth || !v->rgb || !v->guess)
        rc = oxl_fail(s->ctx, OXL_ERR_MEMORY,
                      "no memory for the depths of the views\nfix: use a smaller --max-side");
    if (rc == OXL_OK) rc = oxl_render(s->ctx, model, &v->camera, &render, &image, v->depth);
    for (size_t i = 0; i < 3 * pixels && rc == OXL_OK; i++)
        v->rgb[i] = (unsigned char)(255 * fminf(fmaxf(image.rgb[i % 3 * pixels + i / 3], 0), 1) + 0.5f);
    if (rc == OXL_OK) surface_find_plain(&image, v->guess);
    oxl_image_free(s->ctx, &image);
    return rc;
}

/* Returns the median of |depth| where there is one; 0: nowhere. */
static double surface_median(const struct surface_view *v, double *scratch)
{
    const size_t pixels = (size_t)v->camera.width * (size_t)v->camera.height;
    size_t n = 0;
    for (size_t i = 0; i < pixels; i += 7)
        if (fabsf(v->depth[i]) > 0) scratch[n++] = fabs((double)v->depth[i]);
    qsort(scratch, n, sizeof *scratch, frame_compare);
    return n > 0 ? scratch[n / 2] : 0;
}

/* Sets the usual distance and the sampling: medians over the views. */
static oxl_result surface_measure(struct surface *s)
{
    size_t most = 2 * (size_t)s->views + 1, n = 0;
    double *scratch, *of_view;
    for (int i = 0; i < s->views; i++)
        most = (size_t)fmax((double)most, (double)s->view[i].camera.width * s->view[i].camera.height);
    scratch = malloc((most + 2 * (size_t)s->views + 1) * sizeof *scratch);
    if (!scratch) return oxl_fail(s->ctx, OXL_ERR_MEMORY, "no memory for the depths of the views");
    of_view = scratch + most;
    for (int i = 0; i < s->views; i++) {
        const double z = surface_median(&s->view[i], scratch);
        if (z > 0) of_view[n] = z, of_view[(size_t)s->views + n] = z / s->view[i].camera.fx, n++;
    }
    qsort(of_view, n, sizeof *of_view, frame_compare);
    qsort(of_view + s->views, n, sizeof *of_view, frame_compare);
    if (n > 0) s->distance = of_view[n / 2], s->sampling = of_view[(size_t)s->views + n / 2];
    free(scratch);
    return OXL_OK;
}

/* ---------------- the survey's points */

/* Depths of points by bins of a view's image. */
struct surface_bins {
    double side; /* px */
    int width, height;
    size_t *first; /* (width height + 2) */
    float *depth;
};

/* Returns the bin of a point and its depth; -1: outside of the image. */
static int surface_bin(const struct surface_bins *b, const oxl_camera *c, const oxl_point *p, double *z)
{
    double at[2];
    *z = surface_project(c, p->position, at);
    if (!(*z > 0 && at[0] >= 0 && at[1] >= 0 && at[0] < c->width && at[1] < c->height)) return -1;
    return (int)(at[1] / b->side) * b->width + (int)(at[0] / b->side);
}

/* Sorts every second point of the survey into bins. b->first and b->depth have room for any view. */
static void surface_sort_points(const struct surface *s, const oxl_camera *c, struct surface_bins *b)
{
    const size_t count = oxl_scene_point_count(s->scene);
    const oxl_point *point = oxl_scene_points(s->scene);
    size_t inside = 0;
    double z;
    b->side = 1, b->width = c->width;
    for (size_t i = 0; i < count; i += 2) inside += surface_bin(b, c, &point[i], &z) >= 0;
    b->side = fmax(1, sqrt(SURFACE_BIN_POINTS * (double)c->width * c->height / ((double)inside + 1)));
    b->width = (int)(c->width / b->side) + 1, b->height = (int)(c->height / b->side) + 1;
    memset(b->first, 0, ((size_t)b->width * (size_t)b->height + 2) * sizeof *b->first);
    for (size_t i = 0; i < count; i += 2) {
        const int bin = surface_bin(b, c, &point[i], &z);
        if (bin >= 0) b->first[bin + 2]++;
    }
    for (int i = 2; i < b->width * b->height + 2; i++) b->first[i] += b->first[i - 1];
    for (size_t i = 0; i < count; i += 2) {
        const int bin = surface_bin(b, c, &point[i], &z);
        if (bin >= 0) b->depth[b->first[bin + 1]++] = (float)z;
    }
}

/* Returns 1 where there are points around, and hardly one at that depth. */
static int surface_contradicts(const struct surface_bins *b, int bin, double z)
{
    size_t all = 0, agree = 0;
    for (int k = 0; k < 9; k++) {
        const int x = bin % b->width + k % 3 - 1, y = bin / b->width + k / 3 - 1;
        if (x < 0 || y < 0 || x >= b->width || y >= b->height) continue;
        for (size_t i = b->first[y * b->width + x]; i < b->first[y * b->width + x + 1]; i++)
            all++, agree += fabs((double)b->depth[i] - z) <= SURFACE_NEAR * z;
    }
    return all >= SURFACE_NEIGHBOURS && (double)agree < SURFACE_SHARE * (double)all;
}

/* Marks the depths that the points around contradict as guesses. */
static oxl_result surface_doubt(struct surface *s)
{
    struct surface_bins b = {0};
    size_t most = 0;
    for (int i = 0; i < s->views; i++)
        most = (size_t)fmax((double)most, (s->view[i].camera.width + 1.0) * (s->view[i].camera.height + 1));
    b.first = malloc((most + 2) * sizeof *b.first);
    b.depth = malloc((oxl_scene_point_count(s->scene) / 2 + 1) * sizeof *b.depth);
    for (int i = 0; i < s->views && b.first && b.depth; i++) {
        struct surface_view *v = &s->view[i];
        surface_sort_points(s, &v->camera, &b);
#pragma omp parallel for schedule(static)
        for (int y = 0; y < v->camera.height; y++)
            for (int x = 0; x < v->camera.width; x++) {
                const size_t at = (size_t)y * (size_t)v->camera.width + (size_t)x;
                const int bin = (int)((y + 0.5) / b.side) * b.width + (int)((x + 0.5) / b.side);
                if (surface_contradicts(&b, bin, fabs((double)v->depth[at])))
                    v->guess[at] = SURFACE_CONTRADICTED;
            }
    }
    most = b.first && b.depth;
    free(b.first);
    free(b.depth);
    return most ? OXL_OK : oxl_fail(s->ctx, OXL_ERR_MEMORY, "no memory for the survey's points");
}

/* ---------------- the whole */

oxl_result surface_open(oxl_context *ctx, const oxl_model *model, const oxl_scene *scene, int side,
                        struct surface *s)
{
    const int count = oxl_scene_view_count(scene);
    double full = 1;
    oxl_result rc = OXL_OK;
    *s = (struct surface){.ctx = ctx, .scene = scene};
    s->view = calloc((size_t)count + 1, sizeof *s->view);
    if (!s->view) return oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for %d views", count);
    for (int i = 0; i < count; i++)
        full =
            fmax(full, fmax(oxl_scene_view(scene, i)->camera.width, oxl_scene_view(scene, i)->camera.height));
    side = (int)fmin(fmin(side, full), sqrt((double)SURFACE_PIXELS / fmax(count, 1)));
    for (int i = 0; i < count && rc == OXL_OK; i++) {
        struct surface_view *v = &s->view[s->views];
        if (oxl_scene_view(scene, i)->is_test) continue;
        s->views++;
        v->camera = surface_camera(&oxl_scene_view(scene, i)->camera, side);
        frame_eye(&v->camera, v->eye);
        rc = surface_render(s, model, v);
    }
    if (rc == OXL_OK) rc = surface_measure(s);
    if (rc == OXL_OK) rc = surface_doubt(s);
    s->sampling *= side / full;
    return rc;
}

void surface_close(struct surface *s)
{
    for (int i = 0; i < s->views; i++) {
        free(s->view[i].depth);
        free(s->view[i].rgb);
        free(s->view[i].guess);
    }
    free(s->view);
    *s = (struct surface){0};
}

/* ---------------- places in views */

double surface_project(const oxl_camera *c, const double p[3], double at[2])
{
    double x[3];
    frame_to_camera(c->rotation, p, x);
    for (int i = 0; i < 3; i++) x[i] += c->translation[i];
    at[0] = c->fx * x[0] / x[2] + c->cx;
    at[1] = c->fy * x[1] / x[2] + c->cy;
    return x[2];
}

void surface_place(const struct surface_view *v, double x, double y, double depth, double out[3])
{
    const oxl_camera *c = &v->camera;
    const double along[3] = {(x - c->cx) / c->fx * depth, (y - c->cy) / c->fy * depth, depth};
    for (int k = 0; k < 3; k++)
        out[k] = v->eye[k] + c->rotation[k] * along[0] + c->rotation[3 + k] * along[1] +
                 c->rotation[6 + k] * along[2];
}

int surface_list(const struct surface *s, const double centre[3], double radius, int *list)
{
    int n = 0;
    for (int i = 0; i < s->views; i++) {
        const oxl_camera *c = &s->view[i].camera;
        const double half[2] = {fmax(c->cx, c->width - c->cx) / c->fx,
                                fmax(c->cy, c->height - c->cy) / c->fy};
        double x[3];
        frame_to_camera(c->rotation, centre, x);
        for (int k = 0; k < 3; k++) x[k] += c->translation[k];
        /* outside of a plane through the eye: its normal is (1, -half) over its length */
        if (x[2] > -radius && (fabs(x[0]) - half[0] * x[2]) / sqrt(1 + half[0] * half[0]) < radius &&
            (fabs(x[1]) - half[1] * x[2]) / sqrt(1 + half[1] * half[1]) < radius)
            list[n++] = i;
    }
    return n;
}

/* The view's |depth| at a place of its image: between pixels where the four around agree, else the nearest. */
static double surface_depth(const struct surface_view *v, const double at[2], size_t nearest)
{
    const int width = v->camera.width, height = v->camera.height;
    const int x = (int)floor(at[0] - 0.5), y = (int)floor(at[1] - 0.5);
    const double own = fabs((double)v->depth[nearest]), u = at[0] - 0.5 - x, w = at[1] - 0.5 - y;
    double sum = 0;
    if (x < 0 || y < 0 || x + 1 >= width || y + 1 >= height) return own;
    for (int k = 0; k < 4; k++) {
        const double z = fabs((double)v->depth[(size_t)(y + k / 2) * (size_t)width + (size_t)(x + k % 2)]);
        if (fabs(z - own) > SURFACE_AGREES * own) return own;
        sum += z * (k % 2 ? u : 1 - u) * (k / 2 ? w : 1 - w);
    }
    return sum;
}

static void surface_confirm(const struct surface_view *v, int view, const double p[3], double z, double own,
                            struct surface_vote *out)
{
    const double away[3] = {v->eye[0] - p[0], v->eye[1] - p[1], v->eye[2] - p[2]},
                 length = frame_length(away), off = (own - z) / z, footprint = z / v->camera.fx;
    out->confirms++;
    out->off += off, out->off2 += off * off;
    for (int k = 0; k < 3; k++) out->ray[k] += away[k] / length;
    if (out->nearest < 0 || footprint < out->footprint) out->footprint = footprint, out->nearest = view;
}

int surface_holds(const struct surface_vote *v, int enough)
{
    return v->confirms >= enough && v->confirms > v->passes;
}

struct surface_vote surface_ask(const struct surface *s, const int *list, int count, const double p[3])
{
    const double usual = s->distance > 0 ? s->distance : HUGE_VAL;
    struct surface_vote out = {.nearest = -1};
    for (int i = 0; i < count; i++) {
        const struct surface_view *v = &s->view[list[i]];
        double at[2];
        const double z = surface_project(&v->camera, p, at);
        size_t pixel;
        double own;
        if (!(z > 0 && z <= SURFACE_FAR * usual && at[0] >= 0 && at[0] < v->camera.width && at[1] >= 0 &&
              at[1] < v->camera.height))
            continue;
        pixel = (size_t)at[1] * (size_t)v->camera.width + (size_t)at[0];
        own = v->depth[pixel];
        if (own > 0 && own < (1 - SURFACE_TOLERANCE) * z) continue;
        out.sees++;
        out.passes += v->guess[pixel] == SURFACE_CONTRADICTED;
        if (v->guess[pixel]) continue;
        if (own > z + SURFACE_TOLERANCE * fmin(z, usual)) out.passes++;
        own = surface_depth(v, at, pixel);
        if (fabs(own - z) <= SURFACE_AGREES * fmin(z, usual)) surface_confirm(v, list[i], p, z, own, &out);
    }
    return out;
}
