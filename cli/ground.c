/* ground.c - which places of a map the training views saw.
 *
 * A view sees a place that lies in its image, no farther than `far`, with nothing before it: the depth that
 * the model has there in that view is at least the place's, less GROUND_TOLERANCE of it. Depths are rendered
 * at a side of GROUND_SIDE px at most. Where the model has no depth, or no clear one, nothing is known to be
 * before the place, and it counts as seen. So walls hide what is behind them, low ridges nothing.
 *
 * A view confirms a place that it sees where its own depth, clear or not, is that of the place to within
 * GROUND_TOLERANCE: what images see past, or through, is no surface of theirs, and its height is a guess.
 * docs/log/HEIGHTS.md has what this changes.
 */
#include "cli.h"

#include <math.h>
#include <stdlib.h>

#define GROUND_TOLERANCE 0.05 /* of the depth: a place on a slope is not at the middle of its pixel */
enum { GROUND_SIDE = 320 /* px */ };

static oxl_camera ground_camera(const oxl_camera *full)
{
    const double by = fmin(1, (double)GROUND_SIDE / fmax(full->width, full->height));
    oxl_camera c = *full;
    c.width = (int)fmax(1, floor(full->width * by)), c.height = (int)fmax(1, floor(full->height * by));
    c.fx *= by, c.fy *= by, c.cx *= by, c.cy *= by;
    return c;
}

/* Bounds the pixels of the map that the view may see: the places where the rays of its image's corners pass
 * the lowest and the highest ground. A ray that does not go down passes none: the whole map. */
static void ground_window(const struct ground *g, const oxl_camera *c, const double height[2], int first[2],
                          int last[2])
{
    double low[2] = {HUGE_VAL, HUGE_VAL}, high[2] = {-HUGE_VAL, -HUGE_VAL}, eye[3];
    const int size[2] = {g->width, g->height};
    int level = 0;
    oxl_view view = {.camera = *c};
    frame_eye(&view, eye);
    for (int i = 0; i < 8; i++) {
        const double at[3] = {((i & 1) * c->width - c->cx) / c->fx,
                              ((i >> 1 & 1) * c->height - c->cy) / c->fy, 1};
        double along[3] = {0, 0, 0}, way;
        for (int d = 0; d < 3; d++)
            for (int k = 0; k < 9; k++) along[d] += at[k / 3] * c->rotation[k] * g->frame->axis[d][k % 3];
        way = (height[i >> 2] - frame_along(g->frame, eye, 2)) / along[2];
        level |= !(along[2] < 0);
        for (int d = 0; d < 2; d++) {
            const double place = frame_along(g->frame, eye, d) + way * along[d],
                         pixel = (d ? g->corner[1] - place : place - g->corner[0]) / g->pixel;
            low[d] = fmin(low[d], pixel), high[d] = fmax(high[d], pixel);
        }
    }
    for (int d = 0; d < 2; d++) {
        first[d] = level ? 0 : (int)fmin(fmax(floor(low[d]) - 1, 0), size[d]);
        last[d] = level ? size[d] : (int)fmax(fmin(ceil(high[d]) + 1, size[d]), first[d]);
    }
}

/* Adds a view; depth: of the camera's image, NULL: nothing lies before a place. */
static void ground_add(const struct ground *g, const oxl_camera *c, const float *depth, const int first[2],
                       const int last[2])
{
    for (int y = first[1]; y < last[1]; y++)
        for (int x = first[0]; x < last[0]; x++) {
            const size_t to = (size_t)y * (size_t)g->width + (size_t)x;
            double place[3], at[2], z;
            float own = 0; /* the view's depth at the place */
            if (isnan(g->level[to])) continue;
            ground_place(g, x + 0.5, y + 0.5, (double)g->level[to], place);
            z = ground_see(c, place, at);
            if (!(z > 0 && at[0] >= 0 && at[0] < c->width && at[1] >= 0 && at[1] < c->height)) continue;
            if (depth) own = depth[(size_t)at[1] * (size_t)c->width + (size_t)at[0]];
            if (own > 0 && (double)own < (1 - GROUND_TOLERANCE) * z) continue;
            if (z > g->far) continue;
            g->seen[to] += g->seen[to] < UINT16_MAX;
            if (g->confirmed && (!depth || fabs(fabs((double)own) - z) <= GROUND_TOLERANCE * z))
                g->confirmed[to] += g->confirmed[to] < UINT16_MAX;
        }
}

double ground_see(const oxl_camera *c, const double p[3], double at[2])
{
    double x[3];
    for (int i = 0; i < 3; i++)
        x[i] = c->rotation[3 * i] * p[0] + c->rotation[3 * i + 1] * p[1] + c->rotation[3 * i + 2] * p[2] +
               c->translation[i];
    at[0] = c->fx * x[0] / x[2] + c->cx;
    at[1] = c->fy * x[1] / x[2] + c->cy;
    return x[2];
}

void ground_place(const struct ground *g, double x, double y, double height, double out[3])
{
    const double along[3] = {g->corner[0] + x * g->pixel, g->corner[1] - y * g->pixel, height};
    for (int k = 0; k < 3; k++) {
        out[k] = g->frame->centre[k];
        for (int d = 0; d < 3; d++) out[k] += along[d] * g->frame->axis[d][k];
    }
}

oxl_result ground_count_views(oxl_context *ctx, const oxl_large_model *model, const oxl_scene *scene,
                              const struct ground *g)
{
    const size_t pixels = (size_t)g->width * (size_t)g->height;
    float *depth = model ? malloc(sizeof *depth * GROUND_SIDE * GROUND_SIDE) : NULL;
    oxl_render_options render = oxl_render_options_default();
    double height[2] = {HUGE_VAL, -HUGE_VAL};
    oxl_result rc = model && !depth ? oxl_fail(ctx, OXL_ERR_MEMORY, "ortho: no memory") : OXL_OK;
    render.near_plane = (float)oxl_scene_near_plane(scene);
    for (size_t i = 0; i < pixels; i++) {
        g->seen[i] = 0;
        if (g->confirmed) g->confirmed[i] = 0;
        if (isnan(g->level[i])) continue;
        height[0] = fmin(height[0], (double)g->level[i]), height[1] = fmax(height[1], (double)g->level[i]);
    }
    for (int v = 0; v < oxl_scene_view_count(scene) && rc == OXL_OK; v++) {
        const oxl_view *view = oxl_scene_view(scene, v);
        const oxl_camera c = ground_camera(&view->camera);
        oxl_image image = {0};
        int first[2], last[2];
        if (view->is_test) continue;
        ground_window(g, &c, height, first, last);
        if (first[0] >= last[0] || first[1] >= last[1]) continue;
        if (depth) rc = oxl_large_render(ctx, model, &c, &render, &image, depth);
        if (rc == OXL_OK) ground_add(g, &c, depth, first, last);
        oxl_image_free(ctx, &image);
    }
    free(depth);
    return rc;
}
