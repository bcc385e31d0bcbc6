/* scene_twins.c - finds images that are copies of others: whole files, or encoded again.
 *
 * The copy of a held-out image must not be trained on, or the metrics are of images that are known. COLMAP
 * registers copies, which have the same pose up to a fraction of a pixel; so only images of nearly
 * one pose are decoded and compared.
 *
 * Invariant: all copies of an image are on the same side of the split as the first of them by name.
 */
#include "survey_read.h"
#include "../survey/scene.h"
#include "../survey/survey.h"

enum {
    TWINS_GRID = 96, /* px; sides of the copies that are compared, */
    TWINS_CELL = 8,  /* by the means of cells of so many pixels a side, */
    TWINS_ACROSS = TWINS_GRID / TWINS_CELL,
    TWINS_DEPTHS = 2000, /* pairs of a view and a point that give the depth */
    TWINS_TRIED = 3      /* most images of nearly one pose that one is compared with */
};
#define TWINS_MOVED 2e-3 /* Limits the move, in depths, and the turn, in radians. */
/* Limits the mean difference of two copies, in levels of 255: frames of a camera at rest have 1.1. */
#define TWINS_LEVELS 0.95

struct twin { /* by x */
    double at[3];
    int view;
};

static int twins_compare(const void *a, const void *b)
{
    const struct twin *s = a, *t = b;
    return s->at[0] != t->at[0] ? (s->at[0] > t->at[0]) - (s->at[0] < t->at[0])
                                : (s->view > t->view) - (s->view < t->view);
}

/* Returns the median depth of points in the views; 0: without points, only equal places are near. */
static double twins_depth(const oxl_scene *scene)
{
    const size_t points = scene->colmap.point_count;
    double depth[TWINS_DEPTHS];
    size_t count = 0;
    for (uint64_t i = 0; i < TWINS_DEPTHS && points; i++) {
        double x[3], pixel[2];
        const int view = (int)(i % (uint64_t)scene->view_count);
        if (scene_project_point(scene, view, (size_t)(i * 2654435761u % points), x, pixel))
            depth[count++] = x[2];
    }
    return count ? stats_select(depth, count, 0.5) : 0;
}

/* Compares small copies; images that cannot be read are reported by training. */
static int twins_show_the_same(oxl_context *ctx, const oxl_scene *scene, int a, int b)
{
    struct training_image s = {0}, t = {0};
    int apart[3 * TWINS_ACROSS * TWINS_ACROSS] = {0}, off = 0;
    const int same = scene_load_small(ctx, scene, a, TWINS_GRID, TWINS_GRID, &s) == OXL_OK &&
                     scene_load_small(ctx, scene, b, TWINS_GRID, TWINS_GRID, &t) == OXL_OK;
    for (int k = 0; k < 3 * TWINS_GRID * TWINS_GRID && same; k++)
        apart[k / (TWINS_GRID * TWINS_CELL) * TWINS_ACROSS + k % TWINS_GRID / TWINS_CELL] +=
            s.rgb[k] - t.rgb[k];
    for (int k = 0; k < 3 * TWINS_ACROSS * TWINS_ACROSS; k++) off += abs(apart[k]);
    image_training_free(ctx, &s);
    image_training_free(ctx, &t);
    return same && off <= TWINS_LEVELS * 3 * TWINS_GRID * TWINS_GRID;
}

static int twins_are_near(const oxl_scene *scene, const struct twin *a, const struct twin *b, double near)
{
    const double *r = scene->view[a->view].camera.rotation, *s = scene->view[b->view].camera.rotation;
    double square = 0, turn = 0;
    for (int i = 0; i < 3; i++) square += (a->at[i] - b->at[i]) * (a->at[i] - b->at[i]);
    for (int i = 0; i < 9; i++) turn += (r[i] - s[i]) * (r[i] - s[i]); /* 2 angle^2 */
    return square <= near * near && turn <= 2 * TWINS_MOVED * TWINS_MOVED;
}

/* Compares each image with those of nearly its pose that come before it in the order of places. Joins the
 * groups of two copies: the first image of one becomes that of both. */
static void twins_find(oxl_context *ctx, const oxl_scene *scene, const struct twin *place, int *of)
{
    const double near = TWINS_MOVED * twins_depth(scene);
    for (int i = 1; i < scene->view_count && context_stopped(ctx) == OXL_OK; i++) {
        int tried = 0, is_copy = 0;
        for (int k = i;
             k-- > 0 && place[i].at[0] - place[k].at[0] <= near && tried < TWINS_TRIED && !is_copy;) {
            int a = place[i].view, b = place[k].view;
            if (!twins_are_near(scene, &place[i], &place[k], near)) continue;
            tried++;
            is_copy = twins_show_the_same(ctx, scene, a, b);
            while (of[a] != a) a = of[a];
            while (of[b] != b) b = of[b];
            if (is_copy) of[OXL_MAX(a, b)] = OXL_MIN(a, b);
        }
    }
}

OXL_INTERNAL oxl_result scene_find_twins(oxl_context *ctx, oxl_scene *scene, int *of)
{
    const int count = scene->view_count;
    struct twin *place = oxl_alloc(ctx, (size_t)count, sizeof *place);
    int copies = 0, first = 0;
    if (!place) return OXL_ERR_MEMORY;
    for (int i = 0; i < count; i++) {
        of[i] = place[i].view = i;
        camera_position(&scene->view[i].camera, place[i].at);
    }
    qsort(place, (size_t)count, sizeof *place, twins_compare);
    twins_find(ctx, scene, place, of);
    oxl_free(ctx, place);
    for (int i = 0; i < count; i++) {
        of[i] = of[of[i]]; /* a copy of a copy */
        if (of[i] != i && !copies++) first = i;
    }
    if (copies)
        oxl_log(ctx, OXL_LOG_WARNING,
                "%d images are copies of other images, such as %s of %s: %s\nfix: take the copies out of the "
                "model and of the folder",
                copies, scene->view[first].name, scene->view[of[first]].name,
                scene->colmap.states_split
                    ? "metrics are too good where one is trained on and another held out"
                    : "all copies of one image are on the same side of the split");
    return context_stopped(ctx);
}
