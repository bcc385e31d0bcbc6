/* map.c - renders a map of a model from straight above: the orthomosaic, the heights and their certainty.
 *
 * Rays are parallel to the frame's above axis, so a place is at one pixel whatever its height. They begin at the
 * highest camera, so that what floats above it is not seen. The map is rendered in patches, each a view of its
 * own. A pixel is empty where the model is see-through, or where fewer than --min-views training views see the
 * place (surface.c). It has a colour but no height where no layer of the model is the surface, where fewer views
 * confirm it, or where as many views look through it.
 *
 * The standard deviation of a height is calibrated on `synth` (docs/log/TRAINING.md). Pinholes in the colours are
 * filled from around; `views` is 0 there.
 *
 * Map coordinates are the world's x and y, or distances along the frame's axes from its centre, in metres with
 * --scale.
 *
 * Invariant: pixel corners lie at multiples of the pixel size in map coordinates, so that maps of one frame and
 * pixel size fit each other.
 */
#include "tools.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    MAP_PATCH = 1024,     /* px; side of a patch */
    MAP_TILE = 64,        /* px; side of a tile, whose places are asked of the same views */
    MAP_SIDE_MAX = 32768, /* px; longest side of a map */
    MAP_VIEW_SIDE = 320,  /* px; of the views' depths: maps, reports and comparisons have the same */
    MAP_PINHOLE = 16      /* most pixels of a hole that is filled */
};
#define MAP_FRAME "# map x, y and height = this matrix times the survey's X, Y, Z, 1\n"
/* rim around an image, as a fraction of its sides: a Gaussian whose centre lies in it may show in the image */
#define MAP_RIM 0.1
/* factors of map_sigma */
#define MAP_SIGMA_SPREAD 1.75
#define MAP_SIGMA_OPEN 0.33
#define MAP_SIGMA_STEP 0.17
#define MAP_SIGMA_LEAST 0.0022

/* ---------------- what the views see */

static int map_is_seen(const oxl_camera *c, const double p[3], double rim)
{
    double at[2];
    return surface_project(c, p, at) > 0 && at[0] >= -rim * c->width && at[0] <= (1 + rim) * c->width &&
           at[1] >= -rim * c->height && at[1] <= (1 + rim) * c->height;
}

/* Makes Gaussians invisible whose centres lie in no training view's image, nor near it. */
static void map_hide_unseen(struct map *m, const struct surface *s, oxl_model *model)
{
    for (size_t i = 0; i < model->count; i++) {
        const double p[3] = {model->plane[OXL_MEAN][i], model->plane[OXL_MEAN + 1][i],
                             model->plane[OXL_MEAN + 2][i]};
        int seen = 0;
        for (int v = 0; v < s->views && !seen; v++) seen = map_is_seen(&s->view[v].camera, p, MAP_RIM);
        if (!seen) model->plane[OXL_OPACITY][i] = -100, m->hidden++;
    }
}

/* ---------------- the map's place */

void map_place(const struct map *m, double x, double y, double height, double out[3])
{
    const double along[3] = {m->corner[0] + x * m->pixel, m->corner[1] - y * m->pixel, height};
    for (int k = 0; k < 3; k++) {
        out[k] = m->frame.centre[k];
        for (int d = 0; d < 3; d++) out[k] += along[d] * m->frame.axis[d][k];
    }
}

/* Sets the map's size and corner, with pixel corners at multiples of the pixel size. */
static void map_lay_out(struct map *m, const double low[2], const double high[2])
{
    int size[2];
    for (int d = 0; d < 2; d++) {
        const double first = floor((low[d] + m->shift[d]) / m->pixel),
                     last = ceil((high[d] + m->shift[d]) / m->pixel);
        size[d] = (int)(last - first);
        m->corner[d] = (d ? last : first) * m->pixel - m->shift[d];
    }
    m->width = size[0], m->height = size[1];
}

static oxl_camera map_camera(const struct map *m, int x, int y)
{
    const int rest_x = m->width - x, rest_y = m->height - y;
    oxl_camera c = {.width = rest_x < MAP_PATCH ? rest_x : MAP_PATCH,
                    .height = rest_y < MAP_PATCH ? rest_y : MAP_PATCH,
                    .fx = 1 / m->pixel,
                    .fy = 1 / m->pixel};
    double eye[3];
    c.cx = 0.5 * c.width, c.cy = 0.5 * c.height;
    for (int k = 0; k < 9; k++) c.rotation[k] = (k < 3 ? 1 : -1) * m->frame.axis[k / 3][k % 3];
    map_place(m, x + c.cx, y + c.cy, m->top, eye);
    frame_place(&c, eye);
    return c;
}

/* Chooses the pixel size and the bounds of the map, and refuses what cannot be mapped. */
static oxl_result map_open(struct map *m, const struct surface *s, int side)
{
    double low[2], high[2], longest;
    const double *origin = oxl_scene_origin(m->scene);
    m->top = -HUGE_VAL, m->distance = s->distance, m->sampling = s->sampling;
    for (int i = 0; i < s->views; i++) m->top = fmax(m->top, frame_along(&m->frame, s->view[i].eye, 2));
    for (int i = 0; i < 3 * s->views; i++)
        m->down -= s->view[i / 3].camera.rotation[6 + i % 3] * m->frame.axis[2][i % 3] / s->views;
    for (int d = 0; d < 3; d++) m->shift[d] = m->frame.is_world ? m->frame.centre[d] + origin[d] : 0;
    if (m->is_placed) return OXL_OK;
    if (!frame_bounds(&m->frame, m->scene, low, high))
        return oxl_fail(m->ctx, OXL_ERR_MEMORY, "map: no memory");
    longest = fmax(high[0] - low[0], high[1] - low[1]);
    if (!(longest > 0))
        return oxl_fail(m->ctx, OXL_ERR_INPUT,
                        "map: all points lie in one place\nfix: export the survey again");
    if (!(m->pixel > 0)) m->pixel = m->sampling > 0 ? m->sampling : longest / 2048;
    if (side > 0) m->pixel = fmax(m->pixel, longest / side);
    if (longest / m->pixel > MAP_SIDE_MAX)
        return oxl_fail(m->ctx, OXL_ERR_USAGE,
                        "map: it would have more than %d px a side\nfix: use a larger --pixel", MAP_SIDE_MAX);
    map_lay_out(m, low, high);
    return OXL_OK;
}

/* ---------------- rendering */

/* Copies a patch into the map; pixels without depth stay empty, and unclear ones have no height yet: -depth. */
static void map_take(struct map *m, const oxl_image *image, const float *depth, int left, int top)
{
    const size_t plane = (size_t)image->width * (size_t)image->height;
    for (size_t i = 0; i < plane; i++) {
        const size_t x = (size_t)left + i % (size_t)image->width, y = (size_t)top + i / (size_t)image->width,
                     to = y * (size_t)m->width + x;
        m->level[to] = NAN;
        if (!(fabsf(depth[i]) > 0)) continue;
        m->level[to] = (float)(m->top - (double)fabsf(depth[i]));
        m->sigma[to] = depth[i];
        for (size_t k = 0; k < 3; k++)
            m->rgba[4 * to + k] = (unsigned char)(255 * fminf(fmaxf(image->rgb[k * plane + i], 0), 1) + 0.5f);
        m->rgba[4 * to + 3] = 255;
    }
}

static oxl_result map_draw(struct map *m, const oxl_model *model)
{
    float *depth = malloc(sizeof *depth * MAP_PATCH * MAP_PATCH);
    const size_t pixels = (size_t)m->width * (size_t)m->height;
    oxl_render_options render = oxl_render_options_default();
    oxl_result rc = OXL_OK;
    render.near_plane = 0;
    render.parallel = (float)m->distance;
    memcpy(render.background, model->background, sizeof render.background);
    m->rgba = calloc(pixels, 4);
    m->level = malloc(sizeof *m->level * pixels);
    m->sigma = malloc(sizeof *m->sigma * pixels);
    m->views = calloc(pixels, sizeof *m->views);
    if (!depth || !m->rgba || !m->level || !m->sigma || !m->views)
        rc = oxl_fail(m->ctx, OXL_ERR_MEMORY, "map: no memory for %d x %d px\nfix: use a larger --pixel",
                      m->width, m->height);
    for (int y = 0; y < m->height && rc == OXL_OK; y += MAP_PATCH)
        for (int x = 0; x < m->width && rc == OXL_OK; x += MAP_PATCH) {
            const oxl_camera camera = map_camera(m, x, y);
            oxl_image image = {0};
            rc = oxl_render(m->ctx, model, &camera, &render, &image, depth);
            if (rc == OXL_OK) map_take(m, &image, depth, x, y);
            oxl_image_free(m->ctx, &image);
        }
    free(depth);
    return rc;
}

/* ---------------- what the views confirm */

/* The standard deviation of a confirmed height, units: of what the views' depths differ by, of what their parallax
 * leaves open, both along the mean ray, of half a pixel on the ground's slope, and of a share of the distance that
 * is always left. The factors are calibrated (docs/log/TRAINING.md). */
static double map_sigma(const struct map *m, const struct surface_vote *v, double distance, double step)
{
    const double n = v->confirms, straight = frame_length(v->ray) / n,
                 parallax = sqrt(fmax(2 * (1 - straight), 1e-4)), spread = sqrt(v->off2 / n) * distance,
                 open = v->footprint / parallax / sqrt(n);
    double upright = 0;
    for (int k = 0; k < 3; k++) upright += v->ray[k] * m->frame.axis[2][k] / (n * straight);
    return sqrt(pow(MAP_SIGMA_SPREAD * upright * spread, 2) + pow(MAP_SIGMA_OPEN * upright * open, 2) +
                pow(MAP_SIGMA_STEP * step, 2) + pow(MAP_SIGMA_LEAST * distance, 2));
}

/* Largest height difference to a neighbour of the map that has one. */
static double map_step(const struct map *m, int x, int y)
{
    const size_t at = (size_t)y * (size_t)m->width + (size_t)x;
    double most = 0;
    for (int k = 0; k < 4; k++) {
        const int u = x + (k == 0) - (k == 1), w = y + (k == 2) - (k == 3);
        if (u < 0 || w < 0 || u >= m->width || w >= m->height) continue;
        most = fmax(most, fabs((double)(m->level[(size_t)w * (size_t)m->width + (size_t)u] - m->level[at])));
    }
    return most; /* fmax leaves out NaN */
}

struct map_count {
    size_t any, covered;
};

/* Asks the views of a pixel's place. Empties it where too few see it; views stays 0 where it has no height. */
static void map_ask(struct map *m, const struct surface *s, const int *list, int count, int x, int y,
                    struct map_count *sum)
{
    const size_t at = (size_t)y * (size_t)m->width + (size_t)x;
    struct surface_vote vote;
    double p[3];
    if (isnan(m->level[at])) return;
    map_place(m, x + 0.5, y + 0.5, (double)m->level[at], p);
    vote = surface_ask(s, list, count, p);
    sum->any += vote.sees > 0, sum->covered += vote.sees >= m->enough;
    if (vote.sees < m->enough) memset(m->rgba + 4 * at, 0, 4);
    if (m->sigma[at] > 0 && surface_holds(&vote, m->enough)) {
        m->views[at] = (unsigned short)(vote.confirms < 65535 ? vote.confirms : 65535);
        m->sigma[at] =
            (float)map_sigma(m, &vote, vote.footprint * s->view[vote.nearest].camera.fx, map_step(m, x, y));
    }
}

static struct map_count map_ask_tile(struct map *m, const struct surface *s, int *list, int tile)
{
    const int across = (m->width + MAP_TILE - 1) / MAP_TILE, left = tile % across * MAP_TILE,
              top = tile / across * MAP_TILE, right = left + MAP_TILE < m->width ? left + MAP_TILE : m->width,
              bottom = top + MAP_TILE < m->height ? top + MAP_TILE : m->height;
    double low = HUGE_VAL, high = -HUGE_VAL, centre[3];
    struct map_count sum = {0, 0};
    int count;
    for (int y = top; y < bottom; y++)
        for (int x = left; x < right; x++) {
            const double level = m->level[(size_t)y * (size_t)m->width + (size_t)x];
            low = fmin(low, level), high = fmax(high, level); /* NaN is neither */
        }
    if (!(high >= low)) return sum;
    map_place(m, 0.5 * (left + right), 0.5 * (top + bottom), 0.5 * (low + high), centre);
    count = surface_list(s, centre, 0.5 * (high - low) + MAP_TILE * m->pixel, list);
    for (int y = top; y < bottom; y++)
        for (int x = left; x < right; x++) map_ask(m, s, list, count, x, y, &sum);
    return sum;
}

/* Asks the views of all places. */
static oxl_result map_confirm(struct map *m, const struct surface *s, struct map_count *sum)
{
    const int tiles = ((m->width + MAP_TILE - 1) / MAP_TILE) * ((m->height + MAP_TILE - 1) / MAP_TILE);
    int failed = 0;
    size_t any = 0, covered = 0;
#pragma omp parallel reduction(+ : any, covered, failed)
    {
        int *list = malloc(((size_t)s->views + 1) * sizeof *list);
        failed += list == NULL;
#pragma omp for schedule(dynamic)
        for (int i = 0; i < tiles; i++)
            if (list) {
                const struct map_count one = map_ask_tile(m, s, list, i);
                any += one.any, covered += one.covered;
            }
        free(list);
    }
    *sum = (struct map_count){any, covered};
    return failed ? oxl_fail(m->ctx, OXL_ERR_MEMORY, "map: no memory") : OXL_OK;
}

/* Removes the heights that are not confirmed. */
static void map_keep(struct map *m)
{
    for (size_t at = 0; at < (size_t)m->width * (size_t)m->height; at++) {
        if (!m->views[at]) m->level[at] = m->sigma[at] = NAN;
        m->high += m->views[at] > 0;
    }
}

/* ---------------- the survey's points */

/* Compares the heights with every second point: those that did not help to choose them. */
static oxl_result map_compare_points(struct map *m)
{
    const size_t count = oxl_scene_point_count(m->scene);
    double *error = malloc(sizeof *error * (count / 2 + 1));
    size_t n = 0, inside = 0, gross = 0;
    m->error = m->none = NAN;
    if (!error) return oxl_fail(m->ctx, OXL_ERR_MEMORY, "map: no memory for the points");
    for (size_t i = 1; i < count; i += 2) {
        const double *p = oxl_scene_points(m->scene)[i].position;
        const double x = floor((frame_along(&m->frame, p, 0) - m->corner[0]) / m->pixel),
                     y = floor((m->corner[1] - frame_along(&m->frame, p, 1)) / m->pixel);
        float level;
        if (!(x >= 0 && y >= 0 && x < m->width && y < m->height)) continue;
        inside++;
        level = m->level[(size_t)y * (size_t)m->width + (size_t)x];
        if (isnan(level)) continue;
        error[n] = fabs((double)level - frame_along(&m->frame, p, 2));
        gross += error[n++] > MAP_GROSS * m->distance;
    }
    qsort(error, n, sizeof *error, frame_compare);
    if (n > 0) {
        m->error = error[n / 2], m->error_90 = error[n * 9 / 10];
        m->gross = (double)gross / (double)n, m->none = (double)(inside - n) / (double)inside;
    }
    free(error);
    return OXL_OK;
}

/* ---------------- pinholes, smoothing */

/* Collects the empty pixels that hang together with `at`, at most MAP_PINHOLE + 1. */
static int map_hole(const struct map *m, size_t at, size_t hole[MAP_PINHOLE + 1])
{
    int n = 1;
    hole[0] = at;
    for (int i = 0; i < n; i++) {
        const int x = (int)(hole[i] % (size_t)m->width), y = (int)(hole[i] / (size_t)m->width);
        for (int k = 0; k < 4; k++) {
            const int u = x + (k == 0) - (k == 1), w = y + (k == 2) - (k == 3);
            const size_t to = (size_t)w * (size_t)m->width + (size_t)u;
            int known = 0;
            if (u < 0 || w < 0 || u >= m->width || w >= m->height) return MAP_PINHOLE + 1;
            if (m->rgba[4 * to + 3]) continue;
            for (int j = 0; j < n; j++) known |= hole[j] == to;
            if (!known && n > MAP_PINHOLE) return n;
            if (!known) hole[n++] = to;
        }
    }
    return n;
}

/* Fills small holes in the colours with the mean of what is around them. */
static void map_fill(struct map *m)
{
    size_t hole[MAP_PINHOLE + 1];
    for (size_t at = 0; at < (size_t)m->width * (size_t)m->height; at++) {
        const int n = m->rgba[4 * at + 3] ? MAP_PINHOLE + 1 : map_hole(m, at, hole);
        unsigned sum[4] = {0, 0, 0, 0};
        if (n > MAP_PINHOLE) continue;
        for (int i = 0; i < n; i++) /* neighbours are inside: no hole touches the border */
            for (int k = 0; k < 4; k++) {
                const size_t to =
                    hole[i] + (k == 0) - (k == 1) + (size_t)m->width * (k == 2) - (size_t)m->width * (k == 3);
                for (int c = 0; c < 4; c++) sum[c] += m->rgba[4 * to + 3] ? m->rgba[4 * to + (size_t)c] : 0;
            }
        for (int i = 0; i < n; i++) {
            for (int c = 0; c < 3; c++)
                m->rgba[4 * hole[i] + (size_t)c] = (unsigned char)(sum[c] / (sum[3] / 255));
            m->rgba[4 * hole[i] + 3] = 255;
        }
        m->filled += (size_t)n;
    }
}

/* Replaces heights by the mean of those around that differ by no more than three standard deviations, so that
 * edges stay. */
static oxl_result map_smooth(struct map *m)
{
    const size_t pixels = (size_t)m->width * (size_t)m->height;
    float *next = malloc(pixels * sizeof *next);
    if (!next) return oxl_fail(m->ctx, OXL_ERR_MEMORY, "map: no memory");
    for (int pass = 0; pass < m->smooth; pass++) {
#pragma omp parallel for schedule(static)
        for (size_t at = 0; at < pixels; at++) {
            const int x = (int)(at % (size_t)m->width), y = (int)(at / (size_t)m->width);
            float sum = 0, weight = 0;
            for (int k = 0; k < 9; k++) {
                const int u = x + k % 3 - 1, w = y + k / 3 - 1;
                size_t to;
                if (u < 0 || w < 0 || u >= m->width || w >= m->height) continue;
                to = (size_t)w * (size_t)m->width + (size_t)u;
                if (fabsf(m->level[to] - m->level[at]) <= 3 * m->sigma[at]) sum += m->level[to], weight += 1;
            }
            next[at] = weight > 0 ? sum / weight : m->level[at];
        }
        memcpy(m->level, next, pixels * sizeof *next);
    }
    free(next);
    return OXL_OK;
}

/* ---------------- the whole */

static oxl_result map_measure(struct map *m, const struct map_count *sum)
{
    if (sum->any == 0)
        return oxl_fail(
            m->ctx, OXL_ERR_INPUT,
            "map: no surface that a training view sees lies below the cameras: the map's vertical axis "
            "may point down\nfix: use --frame survey");
    m->area = (double)sum->covered * m->pixel * m->pixel;
    m->covered = (double)sum->covered / (double)sum->any, m->high /= (double)sum->any;
    return map_compare_points(m);
}

oxl_result map_make(struct map *m, oxl_model *model, enum frame_kind kind, int side)
{
    struct surface own = {0}, *s = m->surface ? m->surface : &own;
    struct map_count sum = {0, 0};
    oxl_result rc = OXL_OK;
    if (oxl_scene_point_count(m->scene) < 3)
        return oxl_fail(
            m->ctx, OXL_ERR_INPUT,
            "map: the survey has no points, so its vertical axis is unknown\nfix: export points3D as well");
    if (!m->is_placed) frame_choose(m->scene, kind, &m->frame);
    if (!m->surface) rc = surface_open(m->ctx, model, m->scene, MAP_VIEW_SIDE, &own);
    if (rc == OXL_OK) rc = map_open(m, s, side);
    if (rc == OXL_OK) map_hide_unseen(m, s, model);
    if (rc == OXL_OK) rc = map_draw(m, model);
    if (rc == OXL_OK) rc = map_confirm(m, s, &sum);
    if (rc == OXL_OK) map_keep(m);
    if (rc == OXL_OK) map_fill(m);
    if (rc == OXL_OK && m->smooth > 0) rc = map_smooth(m);
    if (rc == OXL_OK) rc = map_measure(m, &sum);
    surface_close(&own);
    return rc;
}

void map_free(struct map *m)
{
    free(m->rgba);
    free(m->level);
    free(m->sigma);
    free(m->views);
}

/* ---------------- files */

struct geotiff map_georeference(const struct map *m, const struct arguments *a, double unit)
{
    struct geotiff g = {.width = m->width,
                        .height = m->height,
                        .pixel = m->pixel * unit,
                        .epsg = a->epsg,
                        .citation = "oceanxl: coordinates of the survey's world, height along its z",
                        .is_metric = a->scale > 0};
    if (!m->frame.is_world) g.citation = "oceanxl: along the axes in frame.txt";
    else if (oxl_scene_reference(m->scene) && !(fabs(unit - 1) > 0)) {
        g.reference = oxl_scene_reference(m->scene);
        g.citation = "oceanxl: metres east and north of the survey's reference";
    }
    for (int d = 0; d < 2; d++) g.corner[d] = (m->corner[d] + m->shift[d]) * unit;
    return g;
}

/* Writes standard deviation and number of views as the two bands of certainty.tif. */
static oxl_result map_write_certainty(const struct map *m, const char *path, struct geotiff *g, double unit)
{
    const size_t pixels = (size_t)m->width * (size_t)m->height;
    float *band = malloc(2 * pixels * sizeof *band);
    oxl_result rc;
    if (!band) return oxl_fail(m->ctx, OXL_ERR_MEMORY, "map: no memory");
    for (size_t i = 0; i < pixels; i++)
        band[2 * i] = (float)(m->sigma[i] * unit), band[2 * i + 1] = m->views[i];
    g->floats = 2;
    rc = geotiff_write(m->ctx, path, g, band);
    free(band);
    return rc;
}

static oxl_result map_write_tiffs(const struct map *m, const struct arguments *a, double unit)
{
    struct geotiff g = map_georeference(m, a, unit);
    char path[4200];
    oxl_result rc;
    snprintf(path, sizeof path, "%s/ortho.tif", a->out);
    rc = geotiff_write(m->ctx, path, &g, m->rgba);
    for (size_t i = 0; i < (size_t)m->width * (size_t)m->height; i++)
        m->level[i] = (float)(((double)m->level[i] + m->shift[2]) * unit);
    g.floats = 1;
    snprintf(path, sizeof path, "%s/height.tif", a->out);
    if (rc == OXL_OK) rc = geotiff_write(m->ctx, path, &g, m->level);
    snprintf(path, sizeof path, "%s/certainty.tif", a->out);
    return rc == OXL_OK ? map_write_certainty(m, path, &g, unit) : rc;
}

/* Writes the 3 x 4 matrix from the world's coordinates to the map's x, y and height. */
static oxl_result map_write_frame(const struct map *m, const char *folder, double unit)
{
    const double *origin = oxl_scene_origin(m->scene);
    struct output t = {0};
    char path[4200];
    snprintf(path, sizeof path, "%s/frame.txt", folder);
    output_add(&t, "%s", MAP_FRAME);
    for (int d = 0; d < 3; d++) {
        double offset = m->shift[d];
        for (int k = 0; k < 3; k++) {
            offset -= m->frame.axis[d][k] * (m->frame.centre[k] + origin[k]);
            output_add(&t, "%s ", oxl_json_number_text((char[48]){0}, m->frame.axis[d][k] * unit));
        }
        output_add(&t, "%s\n", oxl_json_number_text((char[48]){0}, m->frame.is_world ? 0 : offset * unit));
    }
    return output_save(&t, path)
               ? OXL_OK
               : oxl_fail(m->ctx, OXL_ERR_IO, "%s cannot be written\nfix: free space on the disk", path);
}

static void map_say(const struct map *m, const struct arguments *a, double unit, FILE *to)
{
    const char *words = a->scale > 0 ? "metres" : "units";
    print_format(to, "map       %s/ortho.tif, height.tif and certainty.tif, %d x %d px of %.6g %s, %s\n",
                 a->out, m->width, m->height, m->pixel * unit, words,
                 m->frame.is_world ? "in the world's x and y"
                                   : "along the survey's principal axes, which frame.txt has (--frame world: "
                                     "the world's)");
    print_format(
        to, "ground    %.4g square %s; of what any view sees %d or more see %.1f %%, %.1f %% have a height\n",
        m->area * unit * unit, words, a->min_views, 100 * m->covered, 100 * m->high);
    if (m->hidden) print_format(to, "hidden    %zu Gaussians that no training view shows\n", m->hidden);
    if (m->filled)
        print_format(to, "filled    %zu pixels in holes of up to %d, whose views are 0 in certainty.tif\n",
                     m->filled, MAP_PINHOLE);
    if (m->down < MAP_DOWN)
        print_format(
            to, "warning   the cameras look along this map more than down on it, as on a wall or in a room, "
                "so few places have a height; --frame survey maps the plane of the points\n");
    if (isnan(m->error)) return;
    print_format(
        to,
        "heights   differ from every second point of the survey by %.3g %s in the median, 90 %% by less than %.3g",
        m->error * unit, words, m->error_90 * unit);
    if (m->distance > 0)
        print_format(to, ": %.2f and %.2f %% of the cameras' distance; %.2f %% by more than %.0f %%",
                     100 * m->error / m->distance, 100 * m->error_90 / m->distance, 100 * m->gross,
                     100 * MAP_GROSS);
    print_format(to, "; none at %.1f %% of them\n", 100 * m->none);
}

/* Refuses to replace a map of another program, and a CRS that is not the map's. */
static oxl_result map_check(const struct map *m, const struct arguments *a, const double *reference)
{
    static const char *const own[][2] = {{"ortho.tif", "oceanxl: "},
                                         {"height.tif", "oceanxl: "},
                                         {"certainty.tif", "oceanxl: "},
                                         {"frame.txt", MAP_FRAME}};
    struct frame frame;
    oxl_result rc = oxl_make_folder(m->ctx, a->out);
    for (int i = 0; i < 4 && rc == OXL_OK; i++) rc = output_check_own(m->ctx, a->out, own[i][0], own[i][1]);
    if (rc != OXL_OK || !a->epsg) return rc;
    if (reference)
        return oxl_fail(
            m->ctx, OXL_ERR_USAGE,
            "map: the survey's coordinates are metres around a reference (%.6f, %.6f), not of EPSG:%d\n"
            "fix: leave --epsg out, then gdalwarp -t_srs EPSG:%d map/ortho.tif warped.tif",
            reference[0], reference[1], a->epsg, a->epsg);
    frame_choose(m->scene, (enum frame_kind)a->frame, &frame);
    if (frame.is_world) return OXL_OK;
    return oxl_fail(m->ctx, OXL_ERR_USAGE,
                    "map: --epsg names the system of the world's coordinates, but the map is along the "
                    "survey's own axes\nfix: --frame world if the survey is georeferenced, else "
                    "georeference it first (docs/GUIDE.md, 6)");
}

oxl_result map_write(oxl_context *ctx, oxl_model *model, const oxl_scene *scene, const struct arguments *a,
                     FILE *to)
{
    const double unit = a->scale > 0 ? a->scale : 1;
    struct map m = {
        .ctx = ctx, .scene = scene, .pixel = a->pixel / unit, .enough = a->min_views, .smooth = a->smooth};
    oxl_result rc = map_check(&m, a, oxl_scene_reference(scene));
    if (rc == OXL_OK) rc = map_make(&m, model, (enum frame_kind)a->frame, 0);
    if (rc == OXL_OK) map_say(&m, a, unit, to);
    if (rc == OXL_OK) rc = map_write_frame(&m, a->out, unit);
    if (rc == OXL_OK) rc = map_write_tiffs(&m, a, unit);
    map_free(&m);
    return rc;
}
