/* scene_twins.c - finds images that are copies of others: whole files, or encoded again.
 *
 * The copy of a held-out image must not be trained on, or the metrics are of images that are known. COLMAP
 * registers copies, which have the same pose up to a fraction of a pixel; so only images of nearly
 * one pose are decoded and compared.
 *
 * Invariant: a copy is on the same side of the split as the first image by name that it is a copy of.
 */
#include "survey_read.h"
#include "../survey/scene.h"
#include "../survey/survey.h"

enum { TWINS_GRID = 24, TWINS_DEPTHS = 2000 /* pairs of a view and a point that give the depth */ };
#define TWINS_MOVED 2e-3 /* Limits the move, in depths, and the turn, in radians. */
#define TWINS_LEVELS 1.0 /* Limits the mean difference of parts of two copies, in levels of 255. */

struct twins {
    oxl_context *ctx;
    oxl_scene *scene;
    struct twin { /* by x */
        double at[3];
        int view;
    } * place;
    int *of; /* (views) first image that a view is a copy of; itself: of none */
    double near;
};

static int twins_compare(const void *a, const void *b)
{
    const struct twin *s = a, *t = b;
    return s->at[0] != t->at[0] ? (s->at[0] > t->at[0]) - (s->at[0] < t->at[0])
                                : (s->view > t->view) - (s->view < t->view);
}

/* Returns the median depth of points in the views; 0: without points, only equal places are near. */
static double twins_depth(const oxl_scene *scene, double *depth)
{
    const size_t points = scene->colmap.point_count;
    size_t count = 0;
    for (uint64_t i = 0; i < TWINS_DEPTHS && points; i++) {
        double x[3], pixel[2];
        const int view = (int)(i % (uint64_t)scene->view_count);
        if (scene_project_point(scene, view, (size_t)(i * 2654435761u % points), x, pixel))
            depth[count++] = x[2];
    }
    return count ? stats_select(depth, count, 0.5) : 0;
}

/* Averages the image in parts; 0: it cannot be read, which training reports. */
static int twins_read(const struct twins *t, int view, double part[TWINS_GRID * TWINS_GRID])
{
    struct pixels p = {0};
    if (image_decode(t->ctx, PATH(t->scene->images, "%s", t->scene->view[view].name), 1, &p) != OXL_OK)
        return 0;
    for (int k = 0; k < TWINS_GRID * TWINS_GRID; k++) {
        const int column = k % TWINS_GRID, row = k / TWINS_GRID, x0 = column * p.width / TWINS_GRID,
                  x1 = OXL_MAX((column + 1) * p.width / TWINS_GRID, x0 + 1), y0 = row * p.height / TWINS_GRID,
                  y1 = OXL_MAX((row + 1) * p.height / TWINS_GRID, y0 + 1);
        uint64_t sum = 0;
        for (int y = y0; y < y1; y++)
            for (int x = x0; x < x1; x++) sum += p.data[(size_t)y * (size_t)p.width + (size_t)x];
        part[k] = (double)sum / ((double)(x1 - x0) * (y1 - y0));
    }
    image_pixels_free(t->ctx, &p);
    return 1;
}

static int twins_show_the_same(const struct twins *t, int a, int b)
{
    double part[2][TWINS_GRID * TWINS_GRID], off = 0;
    if (!twins_read(t, a, part[0]) || !twins_read(t, b, part[1])) return 0;
    for (int k = 0; k < TWINS_GRID * TWINS_GRID; k++) off += fabs(part[0][k] - part[1][k]);
    return off <= TWINS_LEVELS * TWINS_GRID * TWINS_GRID;
}

/* Returns how far two views are apart, 1 at the limit. */
static double twins_distance(const struct twins *t, const struct twin *a, const struct twin *b)
{
    const double *r = t->scene->view[a->view].camera.rotation, *s = t->scene->view[b->view].camera.rotation;
    double square = 0, turn = 0;
    for (int i = 0; i < 3; i++) square += (a->at[i] - b->at[i]) * (a->at[i] - b->at[i]);
    for (int i = 0; i < 9; i++) turn += (r[i] - s[i]) * (r[i] - s[i]); /* 2 angle^2 */
    return OXL_MAX(square > 0 ? sqrt(square) / t->near : 0, sqrt(turn / 2) / TWINS_MOVED);
}

/* Compares each image with the one of nearest pose that is before it by name. */
static void twins_find(struct twins *t)
{
    const int count = t->scene->view_count;
    for (int i = 0; i < count; i++) {
        const struct twin *own = &t->place[i], *best = NULL;
        double least = 1;
        for (int step = -1; step <= 1; step += 2)
            for (int k = i + step; k >= 0 && k < count && fabs(t->place[k].at[0] - own->at[0]) <= t->near;
                 k += step) {
                const double d = twins_distance(t, own, &t->place[k]);
                if (t->place[k].view > own->view || d > least ||
                    (best && d == least && best->view < t->place[k].view))
                    continue;
                least = d, best = &t->place[k];
            }
        if (best && twins_show_the_same(t, own->view, best->view)) t->of[own->view] = best->view;
    }
}

OXL_INTERNAL oxl_result scene_find_twins(oxl_context *ctx, oxl_scene *scene, int *of)
{
    const size_t count = (size_t)scene->view_count;
    struct twins t = {.ctx = ctx, .scene = scene, .of = of};
    double *depth = oxl_alloc(ctx, TWINS_DEPTHS, sizeof *depth);
    int copies = 0, first = 0;
    t.place = oxl_alloc(ctx, count, sizeof *t.place);
    for (int i = 0; i < (int)count && depth && t.place; i++) {
        of[i] = i;
        t.place[i].view = i;
        camera_position(&scene->view[i].camera, t.place[i].at);
    }
    if (depth && t.place) {
        t.near = TWINS_MOVED * twins_depth(scene, depth);
        qsort(t.place, count, sizeof *t.place, twins_compare);
        twins_find(&t);
    }
    for (int i = 0; i < (int)count && depth && t.place; i++) {
        while (of[of[i]] != of[i]) of[i] = of[of[i]];
        if (of[i] != i && !copies++) first = i;
    }
    if (copies)
        oxl_log(ctx, OXL_LOG_WARNING,
                "%d images are copies of other images, such as %s of %s: all copies of one image are on "
                "the same side of the split\nfix: take the copies out of the model and of the folder",
                copies, scene->view[first].name, scene->view[of[first]].name);
    OXL_FREE(ctx, depth, t.place);
    return depth && t.place ? OXL_OK : OXL_ERR_MEMORY;
}
