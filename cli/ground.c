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
#include <string.h>

/* fraction of its depth by which a place may lie behind what the view sees: on a slope it is not at the middle
 * of its pixel */
#define GROUND_TOLERANCE 0.05
/* difference of the two depths, as a fraction of the depth, or of the ground's usual distance if that is less */
#define GROUND_AGREES 0.04
/* largest distance of a place that is seen, in usual distances: the horizon of oblique views is not mapped */
#define GROUND_FAR 2.0
/* least rms of detail, as a fraction of the mean grey; 0.0025 and 0.01 give the same heights */
#define GROUND_CONTRAST 0.005
enum {
    GROUND_SIDE = 320,         /* px */
    GROUND_REACH = 4,          /* px; detail is what differs from the mean within this reach */
    GROUND_DISTANCE_SIDE = 64, /* px */
    GROUND_DISTANCE_VIEWS = 50 /* about so many views are measured */
};

static oxl_camera ground_camera(const oxl_camera *full, int side)
{
    const double by = fmin(1, (double)side / fmax(full->width, full->height));
    oxl_camera c = *full;
    c.width = (int)fmax(1, floor(full->width * by)), c.height = (int)fmax(1, floor(full->height * by));
    c.fx *= by, c.fy *= by, c.cx *= by, c.cy *= by;
    return c;
}

/* Renders a view at that side, with its depth. */
static oxl_result ground_render(const struct map *m, const oxl_model *model, const oxl_camera *c,
                                oxl_image *image, float *depth)
{
    oxl_render_options render = oxl_render_options_default();
    render.near_plane = (float)oxl_scene_near_plane(m->scene);
    return oxl_render(m->ctx, model, c, &render, image, depth);
}

/* Bounds the pixels of the map that the view may see: those between the places where the rays of its image's
 * corners pass the lowest and the highest ground. Takes the whole map where a ray does not go down, because
 * it passes none. */
static void ground_window(const struct map *m, const oxl_camera *c, const double height[2], int first[2],
                          int last[2])
{
    double low[2] = {HUGE_VAL, HUGE_VAL}, high[2] = {-HUGE_VAL, -HUGE_VAL}, eye[3];
    const int size[2] = {m->width, m->height};
    int level = 0;
    frame_eye(c, eye);
    for (int i = 0; i < 8; i++) {
        const double at[3] = {((i & 1) * c->width - c->cx) / c->fx,
                              ((i >> 1 & 1) * c->height - c->cy) / c->fy, 1};
        double along[3] = {0, 0, 0}, way;
        for (int k = 0; k < 27; k++)
            along[k / 9] += at[k % 9 / 3] * c->rotation[k % 9] * m->frame.axis[k / 9][k % 3];
        way = (height[i >> 2] - frame_along(&m->frame, eye, 2)) / along[2];
        level |= !(along[2] < 0);
        for (int d = 0; d < 2; d++) {
            const double place = frame_along(&m->frame, eye, d) + way * along[d],
                         pixel = (d ? m->corner[1] - place : place - m->corner[0]) / m->pixel;
            low[d] = fmin(low[d], pixel), high[d] = fmax(high[d], pixel);
        }
    }
    for (int d = 0; d < 2; d++) {
        first[d] = level ? 0 : (int)fmin(fmax(floor(low[d]) - 1, 0), size[d]);
        last[d] = level ? size[d] : (int)fmax(fmin(ceil(high[d]) + 1, size[d]), first[d]);
    }
}

/* ---------------- detail */

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
            for (int i = first; i <= last; i++) sum += from[y * width + i];
            out[x * height + y] = sum / (float)(last - first + 1);
        }
}

/* Sets all of a view's buffers but depth: distance to |depth| where the image has detail, else to 0. */
static void ground_find_detail(const oxl_image *image, struct ground_buffers *b)
{
    const int width = image->width, height = image->height, pixels = width * height;
    float *grey = b->grey, *turned = b->turned, *mean = b->mean;
    for (int i = 0; i < pixels; i++)
        grey[i] = (image->rgb[i] + image->rgb[pixels + i] + image->rgb[2 * pixels + i]) / 3;
    ground_mean_rows(grey, width, height, turned);
    ground_mean_rows(turned, height, width, mean);
    for (int i = 0; i < pixels; i++) grey[i] = (grey[i] - mean[i]) * (grey[i] - mean[i]);
    ground_mean_rows(grey, width, height, turned);
    ground_mean_rows(turned, height, width, grey);
    for (int i = 0; i < pixels; i++)
        b->distance[i] = sqrt((double)grey[i]) > GROUND_CONTRAST * (double)mean[i] ? fabsf(b->depth[i]) : 0;
}

/* ---------------- places in views */

double ground_see(const oxl_camera *c, const double p[3], double at[2])
{
    double x[3];
    frame_to_camera(c->rotation, p, x);
    for (int i = 0; i < 3; i++) x[i] += c->translation[i];
    at[0] = c->fx * x[0] / x[2] + c->cx;
    at[1] = c->fy * x[1] / x[2] + c->cy;
    return x[2];
}

void ground_place(const struct map *m, double x, double y, double height, double out[3])
{
    const double along[3] = {m->corner[0] + x * m->pixel, m->corner[1] - y * m->pixel, height};
    for (int k = 0; k < 3; k++) {
        out[k] = m->frame.centre[k];
        for (int d = 0; d < 3; d++) out[k] += along[d] * m->frame.axis[d][k];
    }
}

/* Maps a place to the camera's coordinates: `at[0]` + x `at[1]` + y `at[2]` + height `at[3]`. It is computed
 * once a view, because the map has many places. */
struct ground_sight {
    double at[4][3];
};

static struct ground_sight ground_sight_of(const struct map *m, const oxl_camera *c)
{
    struct ground_sight s;
    for (int i = 0; i < 4; i++) {
        double place[3];
        ground_place(m, i == 1, i == 2, i == 3, place);
        frame_to_camera(c->rotation, place, s.at[i]);
        for (int k = 0; k < 3; k++) s.at[i][k] += c->translation[k] - (i > 0 ? s.at[0][k] : 0);
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
static void ground_add(const struct map *m, const oxl_camera *c, const struct ground_buffers *buffers,
                       const int first[2], const int last[2])
{
    const struct ground_sight sight = ground_sight_of(m, c);
    const double usual = m->distance > 0 ? m->distance : HUGE_VAL;
    for (int y = first[1]; y < last[1]; y++)
        for (int x = first[0]; x < last[0]; x++) {
            const size_t to = (size_t)y * (size_t)m->width + (size_t)x;
            double at[2], z;
            /* depths of the view at the place, as it is rendered and where it has detail */
            float own = 0, distance = 0;
            if (isnan(m->level[to]) || (m->seen[to] >= m->enough && m->confirmed[to] >= m->enough)) continue;
            z = ground_sees(&sight, c, x + 0.5, y + 0.5, (double)m->level[to], at);
            if (!(z > 0 && z <= GROUND_FAR * usual)) continue;
            if (buffers) {
                const size_t pixel =
                    (size_t)fmin(at[1], c->height - 1) * (size_t)c->width + (size_t)fmin(at[0], c->width - 1);
                own = buffers->depth[pixel], distance = buffers->distance[pixel];
            }
            if (own > 0 && (double)own < (1 - GROUND_TOLERANCE) * z) continue;
            m->seen[to] += m->seen[to] < m->enough;
            if (!buffers || fabs((double)distance - z) <= GROUND_AGREES * fmin(z, usual))
                m->confirmed[to] += m->confirmed[to] < m->enough;
        }
}

oxl_result ground_count_views(const struct map *m, const oxl_model *model)
{
    const size_t pixels = (size_t)m->width * (size_t)m->height;
    struct ground_buffers *b = model ? malloc(sizeof *b) : NULL;
    double height[2] = {HUGE_VAL, -HUGE_VAL};
    oxl_result rc = model && !b ? oxl_fail(m->ctx, OXL_ERR_MEMORY, "ortho: no memory") : OXL_OK;
    memset(m->seen, 0, pixels * sizeof *m->seen);
    memset(m->confirmed, 0, pixels * sizeof *m->confirmed);
    for (size_t i = 0; i < pixels; i++) /* NaN is neither the least nor the most */
        height[0] = fmin(height[0], (double)m->level[i]), height[1] = fmax(height[1], (double)m->level[i]);
    for (int v = 0; v < oxl_scene_view_count(m->scene) && rc == OXL_OK; v++) {
        const oxl_view *view = oxl_scene_view(m->scene, v);
        const oxl_camera c = ground_camera(&view->camera, GROUND_SIDE);
        oxl_image image = {0};
        int first[2], last[2];
        if (view->is_test) continue;
        ground_window(m, &c, height, first, last);
        if (first[0] >= last[0] || first[1] >= last[1]) continue;
        if (b) rc = ground_render(m, model, &c, &image, b->depth);
        if (rc == OXL_OK && b) ground_find_detail(&image, b);
        if (rc == OXL_OK) ground_add(m, &c, b, first, last);
        oxl_image_free(m->ctx, &image);
    }
    free(b);
    return rc;
}

/* ---------------- the usual distance */

/* Returns the median of the values above 0, which it sorts; 0: none is. */
static double ground_median(double *value, size_t count)
{
    size_t zeros = 0;
    qsort(value, count, sizeof *value, frame_compare);
    while (zeros < count && !(value[zeros] > 0)) zeros++;
    return zeros < count ? value[zeros + (count - zeros) / 2] : 0;
}

oxl_result ground_measure_distance(struct map *m, const oxl_model *model)
{
    const int count = oxl_scene_view_count(m->scene), step = 1 + count / GROUND_DISTANCE_VIEWS;
    double all[2][GROUND_DISTANCE_VIEWS + 1];
    size_t n = 0;
    int training = 0;
    oxl_result rc = OXL_OK;
    for (int v = 0; v < count && rc == OXL_OK; v++) {
        const oxl_view *view = oxl_scene_view(m->scene, v);
        const oxl_camera c = ground_camera(&view->camera, GROUND_DISTANCE_SIDE);
        float depth[GROUND_DISTANCE_SIDE * GROUND_DISTANCE_SIDE];
        double z[GROUND_DISTANCE_SIDE * GROUND_DISTANCE_SIDE];
        oxl_image image = {0};
        if (view->is_test || training++ % step != 0) continue;
        rc = ground_render(m, model, &c, &image, depth);
        oxl_image_free(m->ctx, &image);
        for (int i = 0; rc == OXL_OK && i < c.width * c.height; i++) z[i] = fabs((double)depth[i]);
        if (rc != OXL_OK) break;
        all[0][n] = ground_median(z, (size_t)c.width * (size_t)c.height);
        all[1][n] = all[0][n] / view->camera.fx, n++;
    }
    m->distance = ground_median(all[0], n);
    m->sampling = ground_median(all[1], n);
    return rc;
}
