/* map.c - renders a map of a model from straight above: the orthomosaic, the heights and their certainty.
 *
 * Rays are parallel to the frame's above axis, so a place is at one pixel whatever its height. They begin at the
 * highest camera, so that what floats above it is not seen. The map is rendered by bands of rows, each a view of its
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
    MAP_ROWS = 512,       /* that are rendered at once */
    MAP_SIDE_MAX = 32768, /* px; longest side of a map */
    MAP_PINHOLE = 3,      /* px; about the widest hole that is filled */
    MAP_KNOWN = 5         /* least neighbours of a pixel that is filled */
};
/* factors of map_sigma */
#define MAP_SIGMA_SPREAD 1.75
#define MAP_SIGMA_OPEN 0.33
#define MAP_SIGMA_STEP 0.17
#define MAP_SIGMA_LEAST 0.0022

static size_t map_pixels(const struct map *m)
{
    return (size_t)m->width * (size_t)m->height;
}

size_t map_next(const struct map *m, size_t at, int k)
{
    const size_t x = at % (size_t)m->width + (size_t)(k % 3), y = at / (size_t)m->width + (size_t)(k / 3);
    if (x < 1 || y < 1 || x > (size_t)m->width || y > (size_t)m->height) return at;
    return (y - 1) * (size_t)m->width + x - 1;
}

/* ---------------- the map's place */

/* The map's heights as a sheet, seen along the frame's above axis. */
static struct sheet map_sheet(const struct map *m)
{
    struct sheet t = {.width = m->width, .height = m->height, .is_parallel = 1, .depth = m->level};
    vector_add(m->frame.centre, m->corner[0], m->frame.axis[0], t.from);
    vector_add(t.from, m->corner[1], m->frame.axis[1], t.from);
    vector_add(t.step[0], m->pixel, m->frame.axis[0], t.step[0]);
    vector_add(t.step[1], -m->pixel, m->frame.axis[1], t.step[1]);
    memcpy(t.step[2], m->frame.axis[2], sizeof t.step[2]);
    return t;
}

/* Chooses the frame, the pixel size and the bounds of the map, and refuses what cannot be mapped. Pixel corners lie at
 * multiples of the pixel size in map coordinates. */
static oxl_result map_open(struct map *m, const struct surface *s, enum frame_kind kind, int side)
{
    struct frame *f = &m->frame;
    double bound[2][2], longest;
    int size[2];
    if (!m->is_placed) frame_choose(m->scene, kind, f);
    if (m->world && !m->is_placed) memcpy(f->axis, m->world->rotation, sizeof f->axis), f->is_world = 1;
    m->top = -HUGE_VAL, m->distance = s->distance, m->sampling = s->sampling;
    for (int i = 0; i < s->views; i++) {
        m->top = fmax(m->top, frame_along(f, s->view[i].sheet.from, 2));
        m->down -= vector_dot(s->view[i].camera.rotation + 6, f->axis[2]) / s->views;
    }
    if (m->is_placed) return OXL_OK;
    if (f->is_world) vector_add(f->centre, 1, oxl_scene_origin(m->scene), m->shift);
    if (m->world) {
        similarity_apply(m->world, f->centre, m->shift);
        for (int d = 0; d < 3; d++) m->shift[d] /= m->world->scale;
    }
    frame_bounds(f, m->scene, bound[0], bound[1]);
    longest = fmax(bound[1][0] - bound[0][0], bound[1][1] - bound[0][1]);
    if (!(longest > 0))
        return oxl_fail(m->ctx, OXL_ERR_INPUT,
                        "map: all points lie in one place\nfix: export the survey again");
    if (!(m->pixel > 0)) m->pixel = m->sampling > 0 ? m->sampling : longest / 2048;
    if (side > 0) m->pixel = fmax(m->pixel, longest / side);
    if (longest / m->pixel > MAP_SIDE_MAX)
        return oxl_fail(m->ctx, OXL_ERR_USAGE,
                        "map: it would have more than %d px a side\nfix: use a larger --pixel", MAP_SIDE_MAX);
    for (int d = 0; d < 2; d++) {
        const double first = floor((bound[0][d] + m->shift[d]) / m->pixel),
                     last = ceil((bound[1][d] + m->shift[d]) / m->pixel);
        size[d] = (int)(last - first);
        m->corner[d] = (d ? last : first) * m->pixel - m->shift[d];
    }
    m->width = size[0], m->height = size[1];
    return OXL_OK;
}

/* ---------------- rendering */

/* Renders colours and heights by bands of rows; sigma has the depths yet, which are negative where they are not clear. */
static oxl_result map_draw(struct map *m, const oxl_model *model)
{
    const struct sheet t = map_sheet(m);
    oxl_result rc = OXL_OK;
    m->level = product_room(map_pixels(m), sizeof *m->level);
    m->colour = product_room(3 * map_pixels(m), sizeof *m->colour);
    m->sigma = product_room(map_pixels(m), sizeof *m->sigma);
    m->views = product_room(map_pixels(m), sizeof *m->views);
    m->seen = product_room(map_pixels(m), 1);
    for (int y = 0; y < m->height && rc == OXL_OK; y += MAP_ROWS) {
        const int rows = m->height - y < MAP_ROWS ? m->height - y : MAP_ROWS;
        const size_t first = (size_t)y * (size_t)m->width, plane = (size_t)rows * (size_t)m->width;
        oxl_camera c = {m->width, rows, 1 / m->pixel, 1 / m->pixel, 0.5 * m->width, 0.5 * rows, {0}, {0}};
        oxl_image image = {0};
        double eye[3];
        for (int k = 0; k < 9; k++) c.rotation[k] = (k < 3 ? 1 : -1) * m->frame.axis[k / 3][k % 3];
        sheet_place(&t, c.cx, y + c.cy, m->top, eye);
        frame_place(&c, eye);
        rc = product_render(m->ctx, model, &c, 0, m->distance, &image, m->sigma + first);
        for (size_t i = 0; i < 3 * plane && rc == OXL_OK; i++) {
            const size_t at = first + i % plane;
            const float z = fabsf(m->sigma[at]);
            m->level[at] = z > 0 ? (float)(m->top - (double)z) : NAN;
            m->colour[i / plane * map_pixels(m) + at] = z > 0 ? fminf(fmaxf(image.rgb[i], 0), 1) : NAN;
        }
        oxl_image_free(m->ctx, &image);
    }
    return rc;
}

/* ---------------- what the views confirm */

/* The standard deviation of a confirmed height, units: of what the views' depths differ by, of what their parallax
 * leaves open, both along the mean ray, of half a pixel on the ground's slope, and of a share of the distance that
 * is always left. The factors are calibrated (docs/log/TRAINING.md). */
static double map_sigma(const struct map *m, const struct surface_vote *v, double distance, size_t at)
{
    const double n = v->confirms, straight = frame_length(v->ray) / n,
                 parallax = sqrt(fmax(2 * (1 - straight), 1e-4)), spread = sqrt(v->off2 / n) * distance,
                 open = v->footprint / parallax / sqrt(n),
                 upright = vector_dot(v->ray, m->frame.axis[2]) / (n * straight);
    double step = 0; /* largest to a neighbour; fmax leaves out NaN */
    for (int k = 1; k < 9; k += 2)
        step = fmax(step, fabs((double)(m->level[map_next(m, at, k)] - m->level[at])));
    return sqrt(pow(MAP_SIGMA_SPREAD * upright * spread, 2) + pow(MAP_SIGMA_OPEN * upright * open, 2) +
                pow(MAP_SIGMA_STEP * step, 2) + pow(MAP_SIGMA_LEAST * distance, 2));
}

/* Empties a pixel that too few views see; views stays 0 where it has no height. */
static void map_take_vote(void *user, size_t at, const double p[3], const struct surface_vote *v)
{
    struct map *m = user;
    (void)p;
    m->seen[at] = (unsigned char)((v->sees > 0) + (v->sees >= m->enough));
    for (size_t k = 0; k < 3 && v->sees < m->enough; k++) m->colour[k * map_pixels(m) + at] = NAN;
    if (!(m->sigma[at] > 0 && surface_holds(v, m->enough))) return;
    m->views[at] = (unsigned short)(v->confirms < 65535 ? v->confirms : 65535);
    m->sigma[at] = (float)map_sigma(m, v, v->footprint * m->surface->view[v->nearest].camera.fx, at);
}

/* Keeps the heights that the views confirm, and measures the ground. */
static oxl_result map_confirm(struct map *m)
{
    const struct sheet sheet = map_sheet(m);
    size_t any = 0, covered = 0, high = 0;
    surface_ask_sheet(m->surface, &sheet, NULL, map_take_vote, m);
    for (size_t at = 0; at < map_pixels(m); at++) {
        if (!m->views[at]) m->level[at] = m->sigma[at] = NAN;
        any += m->seen[at] > 0, covered += m->seen[at] > 1, high += m->views[at] > 0;
    }
    if (any == 0)
        return oxl_fail(
            m->ctx, OXL_ERR_INPUT,
            "map: nothing that a training view sees lies below the cameras, so the map's up axis may point down\n"
            "fix: use --frame survey");
    m->area = (double)covered * m->pixel * m->pixel;
    m->covered = (double)covered / (double)any, m->high = (double)high / (double)any;
    return OXL_OK;
}

/* Compares the heights with every second point: those that did not help to choose them. */
static void map_compare_points(struct map *m)
{
    const size_t count = oxl_scene_point_count(m->scene);
    double *off = product_room(count, sizeof *off);
    size_t n = 0, inside = 0;
    for (size_t i = 1; i < count; i += 2) {
        const double *p = oxl_scene_points(m->scene)[i].position;
        const double x = floor((frame_along(&m->frame, p, 0) - m->corner[0]) / m->pixel),
                     y = floor((m->corner[1] - frame_along(&m->frame, p, 1)) / m->pixel);
        if (!(x >= 0 && y >= 0 && x < m->width && y < m->height)) continue;
        off[n] =
            fabs((double)m->level[(size_t)y * (size_t)m->width + (size_t)x] - frame_along(&m->frame, p, 2));
        inside++, n += !isnan(off[n]);
    }
    m->off = product_deviation(off, n, inside, m->distance);
    free(off);
}

/* ---------------- pinholes, smoothing */

size_t map_fill(const struct map *m, float *plane, int bands, int passes)
{
    const size_t pixels = map_pixels(m), all = pixels * (size_t)bands;
    float *from = product_room(all, sizeof *from);
    size_t filled = 0;
    for (int pass = 0; pass < passes; pass++) {
        memcpy(from, plane, all * sizeof *from);
        for (size_t at = 0; at < pixels; at++) {
            int known = 0;
            for (int k = 0; k < 9 && isnan(from[at]); k++) known += !isnan(from[map_next(m, at, k)]);
            if (known < MAP_KNOWN) continue;
            filled++;
            for (size_t b = 0; b < all; b += pixels) {
                float sum = 0;
                for (int k = 0; k < 9; k++) {
                    const float value = from[b + map_next(m, at, k)];
                    sum += isnan(value) ? 0 : value;
                }
                plane[b + at] = sum / (float)known;
            }
        }
    }
    free(from);
    return filled;
}

/* Replaces heights by the mean of those around that differ by no more than three standard deviations, so that
 * edges stay. */
static void map_smooth(struct map *m)
{
    float *from = product_room(map_pixels(m), sizeof *from);
    for (int pass = 0; pass < m->smooth; pass++) {
        memcpy(from, m->level, map_pixels(m) * sizeof *from);
#pragma omp parallel for schedule(static)
        for (size_t at = 0; at < map_pixels(m); at++) {
            float sum = 0, weight = 0;
            for (int k = 0; k < 9; k++) {
                const float level = from[map_next(m, at, k)];
                if (fabsf(level - from[at]) <= 3 * m->sigma[at]) sum += level, weight += 1;
            }
            if (weight > 0) m->level[at] = sum / weight;
        }
    }
    free(from);
}

/* ---------------- the whole */

oxl_result map_make(struct map *m, const oxl_model *model, enum frame_kind kind, int side)
{
    struct surface own = {0};
    const int is_own = !m->surface;
    oxl_result rc = OXL_OK;
    if (oxl_scene_point_count(m->scene) < 3)
        return oxl_fail(
            m->ctx, OXL_ERR_INPUT,
            "map: the survey has no points, so its vertical axis is unknown\nfix: export points3D as well");
    if (is_own) rc = surface_open(m->ctx, model, m->scene, SURFACE_SIDE, m->surface = &own);
    if (rc == OXL_OK) rc = map_open(m, m->surface, kind, side);
    if (rc == OXL_OK) rc = map_draw(m, model);
    if (rc == OXL_OK) rc = map_confirm(m);
    if (rc == OXL_OK) {
        m->filled = map_fill(m, m->colour, 3, MAP_PINHOLE);
        map_smooth(m);
        map_compare_points(m);
    }
    surface_close(&own);
    if (is_own) m->surface = NULL;
    return rc;
}

void map_free(struct map *m)
{
    free(m->colour);
    free(m->level);
    free(m->sigma);
    free(m->views);
    free(m->seen);
}

/* ---------------- files */

oxl_result map_raster(const struct map *m, const struct product *p, const char *name, const float *plane,
                      int bands)
{
    const size_t pixels = map_pixels(m), wide = (size_t)bands;
    struct geotiff g = p->place;
    float *out = product_room(pixels * wide, sizeof *out);
    unsigned char *byte = (unsigned char *)out;
    char path[4200];
    oxl_result rc;
    g.width = m->width, g.height = m->height, g.pixel = m->pixel * p->world.scale;
    g.floats = bands == 3 ? 0 : bands;
    for (int d = 0; d < 2; d++) g.corner[d] = (m->corner[d] + m->shift[d]) * p->world.scale;
    if (!m->frame.is_world) g.citation = "oceanxl: along the axes in frame.txt", g.reference = NULL;
    for (size_t i = 0; i < pixels * wide; i++) {
        const float value = plane[i % wide * pixels + i / wide];
        if (bands != 3) out[i] = value;
        else if (!isnan(value)) byte[4 * (i / 3) + i % 3] = (unsigned char)(255 * value + 0.5f);
        if (bands == 3) byte[4 * (i / 3) + 3] = isnan(value) ? 0 : 255;
    }
    snprintf(path, sizeof path, "%s/%s", p->a->out, name);
    rc = geotiff_write(m->ctx, path, &g, out);
    free(out);
    return rc;
}

/* Turns heights into those of files, and writes them with their certainty. */
static oxl_result map_write_heights(struct map *m, const struct product *p)
{
    float *certainty = product_room(2 * map_pixels(m), sizeof *certainty);
    oxl_result rc;
    for (size_t i = 0; i < map_pixels(m); i++) {
        m->level[i] = (float)(((double)m->level[i] + m->shift[2]) * p->world.scale);
        certainty[i] = (float)(m->sigma[i] * p->world.scale), certainty[map_pixels(m) + i] = m->views[i];
    }
    rc = map_raster(m, p, "height.tif", m->level, 1);
    if (rc == OXL_OK) rc = map_raster(m, p, "certainty.tif", certainty, 2);
    free(certainty);
    return rc;
}

/* Writes the 3 x 4 matrix from the survey's coordinates to the map's x, y and height. */
static oxl_result map_write_frame(const struct map *m, const struct product *p)
{
    struct output t = {0};
    double centre[3];
    vector_add(m->frame.centre, 1, oxl_scene_origin(m->scene), centre);
    output_add(&t, "# oceanxl map: x, y and height = this matrix times the survey's X, Y, Z, 1\n");
    for (int d = 0; d < 3; d++) {
        const double *axis = m->frame.axis[d],
                     row[4] = {axis[0], axis[1], axis[2], m->shift[d] - vector_dot(axis, centre)};
        for (int k = 0; k < 4; k++)
            output_add(&t, k < 3 ? "%s " : "%s\n",
                       oxl_json_number_text((char[48]){0}, row[k] * p->world.scale));
    }
    return product_save(p, &t, "frame.txt");
}

static void map_say(const struct map *m, const struct product *p)
{
    const double unit = p->world.scale;
    print_format(p->to, "map       %s/ortho.tif, height.tif and certainty.tif, %d x %d px of %.6g %s, %s\n",
                 p->a->out, m->width, m->height, m->pixel * unit, p->words,
                 m->world ? "in UTM"
                 : m->frame.is_world
                     ? "in the world's x and y"
                     : "along the survey's principal axes, which frame.txt has (--frame world: "
                       "the world's)");
    print_format(
        p->to,
        "ground    %.4g square %s; of what any view sees %d or more see %.1f %%, %.1f %% have a height\n",
        m->area * unit * unit, p->words, m->enough, 100 * m->covered, 100 * m->high);
    if (m->filled)
        print_format(p->to,
                     "filled    %zu pixels in holes of about %d px, whose views are 0 in certainty.tif\n",
                     m->filled, MAP_PINHOLE);
    if (m->down < MAP_DOWN)
        print_format(
            p->to,
            "warning   the cameras look along this map more than down on it, as on a wall or in a room, so that little "
            "has a height; --frame survey maps the plane of the points\n");
    product_say(p, &m->off, m->distance);
}

oxl_result map_write(const struct product *p, const oxl_model *model)
{
    static const char *const files[] = {"ortho.tif", "height.tif", "certainty.tif", "frame.txt"};
    struct map m = {.ctx = p->ctx,
                    .scene = p->scene,
                    .world = p->has_gps ? &p->world : NULL,
                    .pixel = p->a->pixel / p->world.scale,
                    .enough = p->a->min_views,
                    .smooth = p->a->smooth};
    oxl_result rc = product_folder(p, files, 4);
    frame_choose(p->scene, (enum frame_kind)p->a->frame, &m.frame);
    if (rc == OXL_OK && p->a->epsg && !m.frame.is_world)
        rc = oxl_fail(m.ctx, OXL_ERR_USAGE,
                      "map: --epsg names the system of the world's coordinates, but the map is along the "
                      "survey's own axes\nfix: use --frame world if the survey is georeferenced, else "
                      "georeference it first (docs/GUIDE.md, 5)");
    if (rc == OXL_OK) rc = map_make(&m, model, (enum frame_kind)p->a->frame, 0);
    if (rc == OXL_OK) map_say(&m, p);
    if (rc == OXL_OK) rc = map_write_frame(&m, p);
    if (rc == OXL_OK) rc = map_raster(&m, p, "ortho.tif", m.colour, 3);
    if (rc == OXL_OK) rc = map_write_heights(&m, p);
    map_free(&m);
    return rc;
}
