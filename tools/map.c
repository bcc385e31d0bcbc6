/* map.c - renders a map of a model from straight above: the orthomosaic, the heights and their certainty.
 *
 * Rays are parallel to the frame's above axis, so a place is at one pixel whatever its height. They begin at the
 * highest camera, so that what floats above it is not seen. A pixel is empty where the model is see-through, or
 * where fewer than --min-views training views see the place (surface.c). It has a colour but no height where fewer
 * views confirm it, or where twice as many look through it. Where the views confirm it, its depth from above need not
 * be clear: rays from above cross more layers than those of the views that the model was trained on.
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
    MAP_SIDE_MAX = 32768, /* px; longest side of a map */
    MAP_PINHOLE = 3,      /* px; about the widest hole that is filled */
    MAP_KNOWN = 5         /* least neighbours of a pixel that is filled */
};
/* factors of map_sigma */
#define MAP_SIGMA_SPREAD 1.75
#define MAP_SIGMA_OPEN 0.33

static size_t map_pixels(const struct map *m)
{
    return (size_t)m->width * m->height;
}

size_t map_next(const struct map *m, size_t at, int k)
{
    const size_t x = at % (size_t)m->width + (size_t)(k % 3), y = at / (size_t)m->width + (size_t)(k / 3);
    if (x < 1 || y < 1 || x > (size_t)m->width || y > (size_t)m->height) return at;
    return (y - 1) * (size_t)m->width + x - 1;
}

/* ---------------- the map's place */

/* Chooses the axes, the pixel size and the bounds of the map, and refuses what cannot be mapped. Pixel corners lie at
 * multiples of the pixel size. */
static oxl_result map_place(struct map *m)
{
    struct frame f;
    double bound[2][2] = {{0}}, centre[3], longest;
    int *const size[2] = {&m->width, &m->height};
    if (oxl_scene_point_count(m->surface->scene) < 3)
        return oxl_fail(
            m->surface->ctx, OXL_ERR_INPUT,
            "map: the survey has no points, so its vertical axis is unknown\nfix: export points3D as well");
    frame_choose(m->surface->scene, m->kind, &f);
    m->is_world = f.is_world;
    if (!m->is_world) m->to = similarity_of_frame(&f, m->to.scale);
    memcpy(f.axis, m->to.rotation, sizeof f.axis);
    frame_bounds(&f, m->surface->scene, bound[0], bound[1]);
    longest = m->to.scale * fmax(bound[1][0] - bound[0][0], bound[1][1] - bound[0][1]);
    if (!(m->pixel > 0)) m->pixel = m->sampling;
    if (m->side > 0) m->pixel = fmax(m->pixel, longest / m->side);
    if (!(longest / m->pixel <= MAP_SIDE_MAX))
        return oxl_fail(m->surface->ctx, OXL_ERR_USAGE,
                        "map: it would have more than %d px a side\nfix: use a larger --pixel", MAP_SIDE_MAX);
    similarity_apply(&m->to, f.centre, centre);
    for (int d = 0; d < 2; d++) {
        const double first = floor((centre[d] + m->to.scale * bound[0][d]) / m->pixel),
                     last = ceil((centre[d] + m->to.scale * bound[1][d]) / m->pixel);
        *size[d] = (int)(last - first);
        m->corner[d] = (d ? last : first) * m->pixel;
    }
    return OXL_OK;
}

/* Sets the camera that sees the map from its highest camera on, along parallel rays. */
static oxl_result map_open(struct map *m)
{
    const struct surface *s = m->surface;
    struct similarity back;
    oxl_result rc = OXL_OK;
    double eye[3], focal;
    m->sampling = s->sampling * m->to.scale, m->down = 0;
    if (!m->width) rc = map_place(m);
    back = similarity_inverse(&m->to), focal = m->to.scale / m->pixel;
    m->sheet = (struct sheet){
        .camera = {m->width, m->height, focal, focal, 0.5 * m->width, 0.5 * m->height, {0}, {0}},
        .parallel = s->distance};
    for (int k = 0; k < 9; k++) m->sheet.camera.rotation[k] = (k < 3 ? 1 : -1) * m->to.rotation[k];
    m->top = -HUGE_VAL;
    for (int i = 0; i < s->views; i++) {
        similarity_apply(&m->to, s->view[i].eye, eye);
        m->top = fmax(m->top, eye[2]);
        m->down -= vector_dot(s->view[i].sheet.camera.rotation + 6, m->to.rotation + 6) / s->views;
    }
    eye[0] = m->corner[0] + 0.5 * m->width * m->pixel, eye[1] = m->corner[1] - 0.5 * m->height * m->pixel,
    eye[2] = m->top;
    similarity_apply(&back, eye, eye);
    frame_place(&m->sheet.camera, eye);
    return rc;
}

/* ---------------- rendering */

/* Renders colours and heights; sigma has the depths yet. */
static oxl_result map_draw(struct map *m, const oxl_model *model)
{
    const size_t pixels = map_pixels(m);
    oxl_image image = {0};
    oxl_result rc;
    m->colour = product_room(6 * pixels, sizeof *m->colour), m->level = m->colour + 3 * pixels;
    m->sigma = m->sheet.depth = m->level + pixels, m->views = m->sigma + pixels;
    m->seen = product_room(pixels, 1);
    rc = sheet_render(m->surface, model, &m->sheet, &image);
    for (size_t i = 0; i < 3 * pixels && rc == OXL_OK; i++) {
        const double z = fabs((double)m->sigma[i % pixels]);
        m->level[i % pixels] = z > 0 ? (float)(m->top - m->to.scale * z) : NAN;
        m->colour[i] = z > 0 ? fminf(fmaxf(image.rgb[i], 0), 1) : NAN;
    }
    oxl_image_free(m->surface->ctx, &image);
    return rc;
}

/* ---------------- what the views confirm */

/* The standard deviation of a confirmed height, units: of what the views' depths differ by, and of what their parallax
 * leaves open, both along the mean ray. map_make adds what all views have in common. The factors are calibrated
 * (docs/log/TRAINING.md). */
static double map_sigma(const struct map *m, const struct surface_vote *v, double distance)
{
    const double n = v->confirms, straight = frame_length(v->ray) / n,
                 parallax = sqrt(fmax(2 * (1 - straight), 1e-4)), spread = sqrt(v->off2 / n) * distance,
                 open = m->to.scale * v->footprint / parallax / sqrt(n),
                 upright = vector_dot(v->ray, m->to.rotation + 6) / (n * straight);
    return sqrt(pow(MAP_SIGMA_SPREAD * upright * spread, 2) + pow(MAP_SIGMA_OPEN * upright * open, 2));
}

static int map_place_of(const void *user, size_t at, double p[3])
{
    return sheet_place(&((const struct map *)user)->sheet, at, p);
}

/* Empties a pixel that too few views see; views stays 0 where it has no height. */
static void map_take_vote(void *user, size_t at, const double p[3], const struct surface_vote *v)
{
    struct map *m = user;
    (void)p;
    m->seen[at] = (v->sees > 0) + (v->sees >= m->enough);
    for (size_t k = 0; k < 3 && v->sees < m->enough; k++) m->colour[k * map_pixels(m) + at] = NAN;
    if (!surface_holds(v, m->enough)) return;
    m->views[at] = v->confirms;
    m->sigma[at] = map_sigma(m, v, m->to.scale * v->footprint * m->surface->view[v->nearest].sheet.camera.fx);
}

/* Keeps the heights that the views confirm, and measures the ground. */
static oxl_result map_confirm(struct map *m)
{
    size_t any = 0, covered = 0, high = 0;
    surface_ask_all(m->surface, map_pixels(m), map_place_of, map_take_vote, m);
    for (size_t at = 0; at < map_pixels(m); at++) {
        if (!m->views[at]) m->level[at] = m->sigma[at] = NAN;
        any += m->seen[at] > 0, covered += m->seen[at] > 1, high += m->views[at] > 0;
    }
    if (any == 0)
        return oxl_fail(
            m->surface->ctx, OXL_ERR_INPUT,
            "map: nothing that a training view sees lies below the cameras, so the map's up axis may point down\n"
            "fix: use --frame survey without --gps; with --gps, check the heights in the photos' EXIF data");
    m->area = (double)covered * m->pixel * m->pixel;
    m->covered = (double)covered / (double)any, m->high = (double)high / (double)any;
    return OXL_OK;
}

/* How far a height is from that of a point. */
static double map_off(const void *user, const double p[3])
{
    const struct map *m = user;
    const double x = floor((p[0] - m->corner[0]) / m->pixel), y = floor((m->corner[1] - p[1]) / m->pixel);
    if (!(x >= 0 && y >= 0 && x < m->width && y < m->height)) return -1;
    return fabs((double)m->level[(size_t)y * m->width + (size_t)x] - p[2]);
}

/* ---------------- pinholes, smoothing */

/* Sets the mean of the pixels around one, with itself, that differ from `value` by `reach` at most. Returns their
 * number. */
static int map_mean(const struct map *m, const float *from, size_t at, float value, float reach, float *mean)
{
    float sum = 0;
    int count = 0;
    for (int k = 0; k < 9; k++) {
        const float near = from[map_next(m, at, k)];
        if (fabsf(near - value) <= reach) sum += near, count++;
    }
    *mean = sum / (float)count;
    return count;
}

size_t map_fill(const struct map *m, float *plane, int bands, int passes)
{
    const size_t pixels = map_pixels(m), all = pixels * (size_t)bands;
    float *from = product_room(all, sizeof *from), mean;
    size_t filled = 0;
    for (int pass = 0; pass < passes; pass++) {
        memcpy(from, plane, all * sizeof *from);
        for (size_t at = 0; at < pixels; at++) {
            if (!isnan(from[at]) || map_mean(m, from, at, 0, HUGE_VALF, &mean) < MAP_KNOWN) continue;
            filled++;
            for (size_t b = at; b < all; b += pixels) map_mean(m, from + b - at, at, 0, HUGE_VALF, &plane[b]);
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
        for (size_t at = 0; at < map_pixels(m); at++)
            if (!isnan(from[at])) map_mean(m, from, at, from[at], 3 * m->sigma[at], &m->level[at]);
    }
    free(from);
}

/* ---------------- the whole */

struct map map_of(const struct product *p, const struct surface *s)
{
    return (struct map){.surface = s,
                        .kind = p->a->gps ? FRAME_WORLD_AXES : p->a->frame,
                        .to = p->world,
                        .pixel = p->a->pixel,
                        .enough = p->a->min_views,
                        .smooth = p->a->smooth};
}

oxl_result map_make(struct map *m, const oxl_model *model)
{
    oxl_result rc = map_open(m);
    if (rc == OXL_OK) rc = map_draw(m, model);
    if (rc == OXL_OK) rc = map_confirm(m);
    if (rc != OXL_OK) return rc;
    m->filled = map_fill(m, m->colour, 3, MAP_PINHOLE);
    m->off = product_deviation(m->surface, &m->to, map_off, m);
    /* where all views are off, none disagrees: the survey's points tell */
    for (size_t i = 0; i < map_pixels(m); i++) m->sigma[i] = hypot(m->sigma[i], fmax(m->off.median, 0));
    map_smooth(m);
    return OXL_OK;
}

void map_free(struct map *m)
{
    free(m->colour);
    free(m->seen);
}

/* ---------------- files */

oxl_result map_raster(const struct map *m, const struct product *p, const char *name, const float *plane,
                      int bands)
{
    struct geotiff g = p->place;
    char path[4200];
    g.width = m->width, g.height = m->height, g.pixel = m->pixel, g.bands = bands;
    memcpy(g.corner, m->corner, sizeof g.corner);
    if (!m->is_world) g.citation = "oceanxl: along the axes in frame.txt", g.reference = NULL;
    snprintf(path, sizeof path, "%s/%s", p->a->out, name);
    return geotiff_write(p->ctx, path, &g, plane);
}

/* Writes the 3 x 4 matrix from the survey's coordinates to the map's x, y and height. */
static oxl_result map_write_frame(const struct map *m, const struct product *p)
{
    const struct similarity world = similarity_of_world(p->scene, 1), back = similarity_inverse(&world),
                            to = similarity_compose(&m->to, &back);
    struct output t = {0};
    output_add(&t, "# oceanxl map: x, y and height = this matrix times the survey's X, Y, Z, 1\n");
    for (int k = 0; k < 12; k++)
        output_add(&t, k % 4 < 3 ? "%s " : "%s\n",
                   oxl_json_number_text((char[48]){0}, k % 4 < 3 ? to.scale * to.rotation[k / 4 * 3 + k % 4]
                                                                 : to.move[k / 4]));
    return product_save(p, &t, "frame.txt");
}

static void map_say(const struct map *m, const struct product *p)
{
    print_format(
        p->to,
        "map       %s/ortho.tif, height.tif and certainty.tif, %d x %d px of %.4g %s, %s\n"
        "ground    %.4g square %s are seen by %d views or more; of what any view sees, these are %.0f %%, and %.0f %% has a height\n"
        "filled    %zu pixels in holes of up to about %d px were filled from their neighbours; certainty.tif has 0 views there\n",
        p->a->out, m->width, m->height, m->pixel, p->words,
        p->a->gps     ? "in UTM"
        : m->is_world ? "in the world's x and y"
                      : "along the survey's principal axes, which are in frame.txt (--frame world takes "
                        "the world's)",
        m->area, p->words, m->enough, 100 * m->covered, 100 * m->high, m->filled, MAP_PINHOLE);
    if (m->down < MAP_DOWN)
        print_format(
            p->to,
            "warning   the cameras look along this map more than down on it, as at a wall or in a room, so little of it "
            "has a height; --frame survey maps the plane of the points\n");
    product_say(p, &m->off);
}

oxl_result map_write(const struct product *p, const oxl_model *model)
{
    struct surface s = {0};
    struct map m = map_of(p, &s);
    struct frame f;
    oxl_result rc = product_folder(p);
    frame_choose(p->scene, m.kind, &f);
    if (rc == OXL_OK && p->a->epsg && !f.is_world)
        rc = oxl_fail(
            p->ctx, OXL_ERR_USAGE,
            "map: --epsg names the world's coordinate system, but the map is along the "
            "survey's principal axes\nfix: use --frame world if the survey is georeferenced, else --gps "
            "without --epsg, or georeference it first (docs/GUIDE.md, section 6)");
    if (rc == OXL_OK) rc = surface_open(p->ctx, model, p->scene, SURFACE_SIDE, &s);
    if (rc == OXL_OK) rc = map_make(&m, model);
    if (rc == OXL_OK) {
        map_say(&m, p);
        rc = map_write_frame(&m, p);
    }
    if (rc == OXL_OK) rc = map_raster(&m, p, "ortho.tif", m.colour, 3);
    if (rc == OXL_OK) rc = map_raster(&m, p, "height.tif", m.level, 1);
    if (rc == OXL_OK) rc = map_raster(&m, p, "certainty.tif", m.sigma, 2);
    map_free(&m);
    surface_close(&s);
    return rc;
}
