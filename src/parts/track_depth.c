/* track_depth.c - depths from the tracks: for each training view, the pixel and camera z of each point that
 * it observes.
 *
 * While a medium is modelled, each step compares some depths of its view with the rendered ones
 * (render/depth_loss.c). Without a medium, Gaussians near the camera stand in for haze, which the images need
 * (docs/log/TRAINING.md).
 *
 * Invariant: a function of the scene and the step, so there is no state to archive.
 */
#include "track_depth.h"
#include "../survey/sparse.h"
#include "../survey/scene.h"
#include "../survey/tracks.h"

#define TRACK_DEPTH_STREAM 0x4465707468 /* a random stream of its own */
/* of the mean over the points, at the start of the run; 0 at its end */
#define TRACK_DEPTH_WEIGHT 0.02
enum {
    /* views that a point must have been seen from: two rays almost always meet somewhere */
    TRACK_DEPTH_TRACK = 3,
    TRACK_DEPTH_MAX = 1024,   /* of a view, a random choice of more */
    TRACK_DEPTH_STRIDE = 7919 /* a prime above it: neighbours in the list are often neighbours in the image */
};

/* Keeps each of the points seen with equal probability (Vitter 1985, algorithm R). */
static void track_depth_sample(struct track_depth_view *v, int view, struct depth_point p)
{
    const uint64_t seen = (uint64_t)v->seen++;
    const uint64_t place =
        seen < TRACK_DEPTH_MAX ? seen : random_bits(TRACK_DEPTH_STREAM, (uint64_t)view, seen) % (seen + 1);
    if (place < TRACK_DEPTH_MAX) v->point[place] = p;
}

static void track_depth_add_all(struct track_depth *d, const oxl_scene *scene, const int *view_of)
{
    struct tracks_walk w = tracks_of(scene_colmap(scene), view_of);
    w.origin = scene->origin;
    w.shortest = TRACK_DEPTH_TRACK;
    while (tracks_next(&w)) {
        double x[3], pixel[2];
        if (scene_project_point(scene, w.view, w.point, x, pixel))
            track_depth_sample(&d->view[w.view], w.view,
                               (struct depth_point){(float)pixel[0], (float)pixel[1], (float)x[2]});
    }
}

OXL_INTERNAL oxl_result track_depth_begin(oxl_context *ctx, struct track_depth *d, const oxl_scene *scene,
                                          const struct image_window *window)
{
    const struct colmap *c = scene_colmap(scene);
    const int views = scene->view_count;
    int *view_of;
    oxl_result rc = OXL_OK;
    d->started = 1;
    if (!c || c->track_count == 0) return OXL_OK;
    view_of = scene_views_by_image(ctx, scene, OXL_SPLIT_TRAIN);
    d->view = oxl_calloc(ctx, (size_t)views + 1, sizeof *d->view);
    d->all = oxl_alloc(ctx, TRACK_DEPTH_MAX * (size_t)views, sizeof *d->all);
    if (!view_of || !d->view || !d->all) rc = OXL_ERR_MEMORY;
    for (int v = 0; v < views && rc == OXL_OK; v++) {
        d->view[v].point = d->all + TRACK_DEPTH_MAX * (size_t)v;
        if (window && window[v].width <= 0) view_of[scene_source_image(scene, v) - c->image] = -1;
    }
    if (rc == OXL_OK) track_depth_add_all(d, scene, view_of);
    oxl_free(ctx, view_of);
    return rc;
}

static double track_depth_bytes(const oxl_train_options *options, int views)
{
    return options->medium == OXL_OFF
               ? 0
               : views * (TRACK_DEPTH_MAX * sizeof(struct depth_point) + sizeof(struct track_depth_view));
}

OXL_INTERNAL void track_depth_free(struct train *t, void *state)
{
    struct track_depth *d = state;
    OXL_FREE(t->ctx, d->view, d->all);
}

OXL_INTERNAL double track_depth_of_step(const struct track_depth *d, int view, int step, double progress,
                                        int *count, struct depth_point out[DEPTH_POINTS])
{
    const struct track_depth_view *v = d->view ? &d->view[view] : NULL;
    const int n = v ? OXL_MIN(v->seen, TRACK_DEPTH_MAX) : 0;
    const int first = n ? (int)(random_bits(TRACK_DEPTH_STREAM, (uint64_t)step, 0) % (uint64_t)n) : 0;
    *count = OXL_MIN(n, DEPTH_POINTS);
    for (int i = 0; i < *count; i++) out[i] = v->point[(first + i * TRACK_DEPTH_STRIDE) % n];
    return *count ? TRACK_DEPTH_WEIGHT * OXL_MAX(0, 1 - progress) / *count : 0;
}

/* ---------------- the part */

/* Gives the renderer the tracks' depths of a view, at this step's window and resolution. */
OXL_INTERNAL oxl_result track_depth_before_backward(struct train *t, void *state, struct part_view *v)
{
    struct track_depth *d = state;
    const struct image_window *w = step_window(t, v->view);
    const float side = t->halved ? 0.5f : 1;
    struct depth_point point[DEPTH_POINTS];
    int count = 0;
    double weight;
    oxl_result rc = OXL_OK;
    if (!v->imaging.medium.on) return OXL_OK;
    if (!d->started) rc = track_depth_begin(t->ctx, d, t->scene, t->task.window);
    if (rc != OXL_OK) return rc;
    weight = track_depth_of_step(d, v->view, t->step, v->progress, &count, point);
    for (int i = 0; i < count; i++) {
        point[i].x = side * (point[i].x - (float)(w ? w->x : 0));
        point[i].y = side * (point[i].y - (float)(w ? w->y : 0));
    }
    renderer_set_depths(t->renderer, point, count, weight);
    return OXL_OK;
}

OXL_INTERNAL const struct part part_track_depth = {.name = "track_depth",
                                                   .size = sizeof(struct track_depth),
                                                   .free = track_depth_free,
                                                   .before_backward = track_depth_before_backward,
                                                   .bytes = track_depth_bytes};
