/* depth_bands.c - assigns pixels of a view to the depth bands near, mid and far, from the survey's points.
 *
 * A pixel has the depth of the nearest point in the image (4-neighbour distance) that the view observes by
 * its track; beyond BANDS_REACH it has no band. Without tracks (scenes from arrays), a view observes all
 * points that project into its image.
 *
 * Invariant: a function of the scene alone, so that metrics by depth use the same pixels for every model.
 */
#include "sparse.h"
#include "scene.h"
#include "survey.h"
#include "tracks.h"

#define BANDS_REACH (1.0 / 16) /* Sets the reach of a point, as a fraction of the image's longer side. */
enum { BANDS_MAX = 1 << 22 };  /* most observations; every k-th is taken if there are more */

static void depth_bands_add(struct depth_bands *b, const oxl_scene *scene, int view, const double world[3])
{
    const oxl_camera *c = &oxl_scene_view(scene, view)->camera;
    double x[3], p[2];
    if (!camera_project(c, world, oxl_scene_origin(scene), x, p)) return;
    if (!(p[0] >= 0 && p[0] < c->width && p[1] >= 0 && p[1] < c->height)) return;
    b->sample[b->count++] = (struct depth_sample){view, (int)p[1] * c->width + (int)p[0], (float)x[2]};
}

/* Adds the entries of tracks. view: (images) view of each image; -1: none. */
static void depth_bands_by_tracks(struct depth_bands *b, const oxl_scene *scene, const struct colmap *c,
                                  const int *view)
{
    struct tracks_walk w = tracks_of(c, view);
    w.step = c->track_count / BANDS_MAX + 1;
    while (tracks_next(&w)) depth_bands_add(b, scene, w.view, c->point[w.point].position);
}

static void depth_bands_by_projection(struct depth_bands *b, const oxl_scene *scene, const int *requested,
                                      int count)
{
    const size_t views = (size_t)oxl_scene_view_count(scene),
                 step = oxl_scene_point_count(scene) * views / BANDS_MAX + 1;
    for (size_t i = 0; i < oxl_scene_point_count(scene); i += step)
        for (int k = 0; k < count; k++) {
            const double *p = oxl_scene_points(scene)[i].position, *origin = oxl_scene_origin(scene);
            depth_bands_add(b, scene, requested[k],
                            (double[]){p[0] + origin[0], p[1] + origin[1], p[2] + origin[2]});
        }
}

static int depth_bands_compare(const void *a, const void *b)
{
    const struct depth_sample *x = a, *y = b;
    const int d = (x->view > y->view) - (x->view < y->view);
    if (d) return d;
    return x->pixel != y->pixel ? (x->pixel > y->pixel) - (x->pixel < y->pixel)
                                : (x->z > y->z) - (x->z < y->z);
}

OXL_INTERNAL oxl_result depth_bands_begin(oxl_context *ctx, const oxl_scene *scene, const int *requested,
                                          int count, struct depth_bands *out)
{
    const struct colmap *c = scene_colmap(scene);
    const int tracked = c && c->track_count > 0;
    const size_t most = tracked ? c->track_count : oxl_scene_point_count(scene) * (size_t)count;
    int *view = oxl_alloc(ctx, (tracked ? c->image_count : 0) + 1, sizeof *view);
    *out = (struct depth_bands){
        .depth = {scene_depth_quantile(scene, 1.0 / 3), scene_depth_quantile(scene, 2.0 / 3)}};
    out->sample = oxl_alloc(ctx, OXL_MIN(most, BANDS_MAX) + 1, sizeof *out->sample);
    if (!view || !out->sample) {
        oxl_free(ctx, view);
        depth_bands_free(ctx, out);
        return OXL_ERR_MEMORY;
    }
    for (size_t i = 0; tracked && i < c->image_count; i++) view[i] = -1;
    for (int k = 0; tracked && k < count; k++)
        view[scene_source_image(scene, requested[k]) - c->image] = requested[k];
    if (tracked) depth_bands_by_tracks(out, scene, c, view);
    else depth_bands_by_projection(out, scene, requested, count);
    qsort(out->sample, out->count, sizeof *out->sample, depth_bands_compare);
    oxl_free(ctx, view);
    return OXL_OK;
}

OXL_INTERNAL void depth_bands_free(oxl_context *ctx, struct depth_bands *b)
{
    oxl_free(ctx, b->sample);
    *b = (struct depth_bands){0};
}

/* Finds the first sample of a view among the samples, which are sorted by view. */
static size_t depth_bands_first(const struct depth_bands *b, int view)
{
    size_t low = 0, high = b->count;
    while (low < high) {
        const size_t middle = low + (high - low) / 2;
        if (b->sample[middle].view < view) low = middle + 1;
        else high = middle;
    }
    return low;
}

/* Spreads bands to free neighbours, breadth first, for as many rounds as a point reaches. */
static void depth_bands_spread(int width, int height, int *queue, size_t waiting, uint8_t *band)
{
    const int reach = (int)(BANDS_REACH * OXL_MAX(width, height));
    size_t next = 0;
    for (int round = 0; round < reach; round++)
        for (const size_t end = waiting; next < end; next++) {
            const int at = queue[next], x = at % width, y = at / width;
            const int to[4] = {y > 0 ? at - width : -1, x > 0 ? at - 1 : -1, x < width - 1 ? at + 1 : -1,
                               y < height - 1 ? at + width : -1};
            for (int k = 0; k < 4; k++)
                if (to[k] >= 0 && !band[to[k]]) {
                    band[to[k]] = band[at];
                    queue[waiting++] = to[k];
                }
        }
}

OXL_INTERNAL oxl_result depth_bands_of_view(oxl_context *ctx, const struct depth_bands *b,
                                            const oxl_scene *scene, int view, uint8_t *band)
{
    const oxl_camera *c = &oxl_scene_view(scene, view)->camera;
    const size_t pixels = (size_t)c->width * (size_t)c->height;
    int *queue = oxl_alloc(ctx, pixels, sizeof *queue);
    size_t waiting = 0;
    if (!queue) return OXL_ERR_MEMORY;
    memset(band, 0, pixels);
    for (size_t i = depth_bands_first(b, view); b->depth[0] > 0 && i < b->count && b->sample[i].view == view;
         i++) {
        const struct depth_sample *s = &b->sample[i];
        if (band[s->pixel]) continue;
        band[s->pixel] = (uint8_t)(1 + (s->z > b->depth[0]) + (s->z > b->depth[1]));
        queue[waiting++] = s->pixel;
    }
    depth_bands_spread(c->width, c->height, queue, waiting, band);
    oxl_free(ctx, queue);
    return OXL_OK;
}
