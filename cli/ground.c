/* ground.c - counts the training views that see each place of a map.
 *
 * A view sees a place that lies in its image, no farther than GROUND_FAR times the usual distance, with
 * nothing before it: the depth that the model has there in that view is at least the place's, less
 * GROUND_TOLERANCE of it. Depths are rendered at a side of GROUND_SIDE px at most. Where the model has no
 * depth, or no clear one, nothing is known to be before the place, and it counts as seen. So walls hide what
 * is behind them, low ridges nothing.
 *
 * A view confirms a place that it sees where its own depth, clear or not, is that of the place to within
 * GROUND_AGREES: where images see past a surface, or through it, its height is a guess. Where the view has no
 * detail, it confirms nothing: the depth of haze and of even ground is whatever fits its colour.
 * docs/log/HEIGHTS.md has what this changes.
 */
#include "cli.h"

#include <math.h>
#include <stdlib.h>

/* Tolerates a place behind what the view sees by this fraction of its depth: on a slope it is not at
 * the middle of its pixel. */
#define GROUND_TOLERANCE 0.05
/* Tolerates a difference of the two depths by this fraction of the depth, or of the ground's usual
 * distance where that is less. */
#define GROUND_AGREES 0.04
/* Limits the distance of a place that is seen, in usual distances of the ground: the horizon of
 * oblique views is not mapped. */
#define GROUND_FAR 2.0
/* Bounds the rms of detail from below, as a fraction of the mean grey; 0.0025 and
 * 0.01 give the same heights. */
#define GROUND_CONTRAST 0.005
enum {
    GROUND_SIDE = 320,        /* px */
    GROUND_REACH = 4,         /* px; detail is what differs from the mean within this reach */
    GROUND_DISTANCE_SIDE = 64 /* px */
};

static oxl_camera ground_camera(const oxl_camera *full, int side)
{
    const double by = fmin(1, (double)side / fmax(full->width, full->height));
    oxl_camera c = *full;
    c.width = (int)fmax(1, floor(full->width * by)), c.height = (int)fmax(1, floor(full->height * by));
    c.fx *= by, c.fy *= by, c.cx *= by, c.cy *= by;
    return c;
}

/* Bounds the pixels of the map that the view may see: those between the places where the rays of its image's
 * corners pass the lowest and the highest ground. Takes the whole map where a ray does not go down, because
 * it passes none. */
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

/* Arrays (height,width) of a view, GROUND_SIDE x GROUND_SIDE at most. */
struct ground_buffers {
    float depth[GROUND_SIDE * GROUND_SIDE], distance[GROUND_SIDE * GROUND_SIDE];
    float grey[GROUND_SIDE * GROUND_SIDE], turned[GROUND_SIDE * GROUND_SIDE], mean[GROUND_SIDE * GROUND_SIDE];
};

/* Sets `out` (width,height) to the means over GROUND_REACH on both sides along the rows of `from`,
 * transposed, so that a second call averages the columns. */
static void ground_mean_rows(const float *from, int width, int height, float *out)
{
    for (int y = 0; y < height; y++)
        for (int x = 0; x < width; x++) {
            const int first = x > GROUND_REACH ? x - GROUND_REACH : 0,
                      last = x + GROUND_REACH < width ? x + GROUND_REACH : width - 1;
            float sum = 0;
            for (int i = first; i <= last; i++) sum += from[(size_t)y * (size_t)width + (size_t)i];
            out[(size_t)x * (size_t)height + (size_t)y] = sum / (float)(last - first + 1);
        }
}

/* Sets all of a view's buffers but depth: distance to |depth| where the image has detail, else to 0. */
static void ground_find_detail(const oxl_image *image, struct ground_buffers *b)
{
    const int width = image->width, height = image->height;
    const size_t pixels = (size_t)width * (size_t)height;
    float *grey = b->grey, *turned = b->turned, *mean = b->mean;
    for (size_t i = 0; i < pixels; i++)
        grey[i] = (image->rgb[i] + image->rgb[pixels + i] + image->rgb[2 * pixels + i]) / 3;
    ground_mean_rows(grey, width, height, turned);
    ground_mean_rows(turned, height, width, mean);
    for (size_t i = 0; i < pixels; i++) grey[i] = (grey[i] - mean[i]) * (grey[i] - mean[i]);
    ground_mean_rows(grey, width, height, turned);
    ground_mean_rows(turned, height, width, grey);
    for (size_t i = 0; i < pixels; i++)
        b->distance[i] = sqrt((double)grey[i]) > GROUND_CONTRAST * (double)mean[i] ? fabsf(b->depth[i]) : 0;
}

/* Maps a place to the camera's coordinates: `at[0]` + x `at[1]` + y `at[2]` + height `at[3]`. It is computed
 * once a view, because the map has many places. */
struct ground_sight {
    double at[4][3];
};

static struct ground_sight ground_sight_of(const struct ground *g, const oxl_camera *c)
{
    static const double corner[4][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    struct ground_sight s;
    for (int i = 0; i < 4; i++) {
        double place[3];
        ground_place(g, corner[i][0], corner[i][1], corner[i][2], place);
        for (int k = 0; k < 3; k++)
            s.at[i][k] = c->rotation[3 * k] * place[0] + c->rotation[3 * k + 1] * place[1] +
                         c->rotation[3 * k + 2] * place[2] + c->translation[k] - (i > 0 ? s.at[0][k] : 0);
    }
    return s;
}

/* Returns camera z of the map's place x, y, and sets its pixel in the view, px; 0 where the
 * place is not in the image. */
static double ground_sees(const struct ground_sight *s, const oxl_camera *c, double x, double y,
                          double height, double at[2])
{
    double p[3];
    for (int k = 0; k < 3; k++) p[k] = s->at[0][k] + x * s->at[1][k] + y * s->at[2][k] + height * s->at[3][k];
    at[0] = c->fx * p[0] + c->cx * p[2], at[1] = c->fy * p[1] + c->cy * p[2];
    if (!(p[2] > 0 && at[0] >= 0 && at[0] < c->width * p[2] && at[1] >= 0 && at[1] < c->height * p[2]))
        return 0;
    at[0] /= p[2], at[1] /= p[2];
    return p[2];
}

/* Counts a view at the places that it sees or confirms. buffers NULL: nothing hides a place, and all
 * that are seen are confirmed. */
static void ground_add(const struct ground *g, const oxl_camera *c, const struct ground_buffers *buffers,
                       const int first[2], const int last[2])
{
    const struct ground_sight sight = ground_sight_of(g, c);
    const unsigned short enough = g->enough ? g->enough : UINT16_MAX;
    for (int y = first[1]; y < last[1]; y++)
        for (int x = first[0]; x < last[0]; x++) {
            const size_t to = (size_t)y * (size_t)g->width + (size_t)x;
            double at[2], z;
            /* depths of the view at the place, as it is rendered and where it has detail */
            float own = 0, distance = 0;
            if (isnan(g->level[to])) continue;
            if (g->seen[to] >= enough && (!g->confirmed || g->confirmed[to] >= enough)) continue;
            z = ground_sees(&sight, c, x + 0.5, y + 0.5, (double)g->level[to], at);
            if (!(z > 0 && z <= GROUND_FAR * g->usual)) continue;
            if (buffers) {
                const size_t pixel =
                    (size_t)fmin(at[1], c->height - 1) * (size_t)c->width + (size_t)fmin(at[0], c->width - 1);
                own = buffers->depth[pixel], distance = buffers->distance[pixel];
            }
            if (own > 0 && (double)own < (1 - GROUND_TOLERANCE) * z) continue;
            g->seen[to] += g->seen[to] < enough;
            if (g->confirmed && (!buffers || fabs((double)distance - z) <= GROUND_AGREES * fmin(z, g->usual)))
                g->confirmed[to] += g->confirmed[to] < enough;
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

oxl_result ground_count_views(oxl_context *ctx, const oxl_model *model, const oxl_scene *scene,
                              const struct ground *g)
{
    const size_t pixels = (size_t)g->width * (size_t)g->height;
    struct ground_buffers *b = model ? malloc(sizeof *b) : NULL;
    oxl_render_options render = oxl_render_options_default();
    double height[2] = {HUGE_VAL, -HUGE_VAL};
    oxl_result rc = model && !b ? oxl_fail(ctx, OXL_ERR_MEMORY, "ortho: no memory") : OXL_OK;
    render.near_plane = (float)oxl_scene_near_plane(scene);
    for (size_t i = 0; i < pixels; i++) {
        g->seen[i] = 0;
        if (g->confirmed) g->confirmed[i] = 0;
        if (isnan(g->level[i])) continue;
        height[0] = fmin(height[0], (double)g->level[i]), height[1] = fmax(height[1], (double)g->level[i]);
    }
    for (int v = 0; v < oxl_scene_view_count(scene) && rc == OXL_OK; v++) {
        const oxl_view *view = oxl_scene_view(scene, v);
        const oxl_camera c = ground_camera(&view->camera, GROUND_SIDE);
        oxl_image image = {0};
        int first[2], last[2];
        if (view->is_test) continue;
        ground_window(g, &c, height, first, last);
        if (first[0] >= last[0] || first[1] >= last[1]) continue;
        if (b) rc = oxl_render(ctx, model, &c, &render, &image, b->depth);
        if (rc == OXL_OK && b) ground_find_detail(&image, b);
        if (rc == OXL_OK) ground_add(g, &c, b, first, last);
        oxl_image_free(ctx, &image);
    }
    free(b);
    return rc;
}

static int ground_compare(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Returns the median of the |depth| that are not 0; 0: all are 0. */
static double ground_median(float *depth, size_t count)
{
    double z[GROUND_DISTANCE_SIDE * GROUND_DISTANCE_SIDE];
    size_t n = 0;
    for (size_t i = 0; i < count; i++)
        if (fabsf(depth[i]) > 0) z[n++] = fabs((double)depth[i]);
    qsort(z, n, sizeof *z, ground_compare);
    return n ? z[n / 2] : 0;
}

oxl_result ground_measure_distance(oxl_context *ctx, const oxl_model *model, const oxl_scene *scene,
                                   int views, double *distance, double *pixel)
{
    const int count = oxl_scene_view_count(scene), step = 1 + count / views;
    double all[2][GROUND_DISTANCE_VIEWS + 1];
    size_t n = 0;
    int training = 0;
    oxl_result rc = OXL_OK;
    *distance = *pixel = 0;
    for (int v = 0; v < count && rc == OXL_OK; v++) {
        const oxl_view *view = oxl_scene_view(scene, v);
        const oxl_camera c = ground_camera(&view->camera, GROUND_DISTANCE_SIDE);
        float depth[GROUND_DISTANCE_SIDE * GROUND_DISTANCE_SIDE];
        oxl_render_options render = oxl_render_options_default();
        oxl_image image = {0};
        double z;
        if (view->is_test || training++ % step != 0) continue;
        render.near_plane = (float)oxl_scene_near_plane(scene);
        rc = oxl_render(ctx, model, &c, &render, &image, depth);
        oxl_image_free(ctx, &image);
        if (rc != OXL_OK) break;
        z = ground_median(depth, (size_t)c.width * (size_t)c.height);
        if (z > 0) all[0][n] = z, all[1][n++] = z / view->camera.fx;
    }
    if (n > 0) {
        qsort(all[0], n, sizeof **all, ground_compare);
        qsort(all[1], n, sizeof **all, ground_compare);
        *distance = all[0][n / 2];
        *pixel = all[1][n / 2];
    }
    return rc;
}
