/* ortho.c - renders a map of a model from straight above: the orthomosaic and the height of the ground.
 *
 * Rays are parallel to the frame's above axis, so a place is at one pixel whatever its height. They begin at
 * the highest camera, so that what floats above it is not seen. The map is rendered in patches, each a view
 * of its own. A pixel is empty where the model is see-through, or where fewer than --min-views training views
 * see the place (ground.c). It has a colour but no height where no layer of the model is the surface, or
 * where fewer views confirm it.
 *
 * Map coordinates are the world's x and y, or distances along the frame's axes from its centre, in metres
 * with --scale.
 *
 * Invariant: pixel corners lie at multiples of the pixel size in map coordinates, so that maps of one frame
 * and pixel size fit each other.
 */
#include "cli.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    ORTHO_PATCH = 1024,     /* px; side of a patch */
    ORTHO_SIDE_MAX = 32768, /* px; longest side of a map */
    ORTHO_CHECKED = 100000, /* most points that the heights are compared with */
    ORTHO_UNCLEAR = 1       /* alpha, while a map is drawn, of a colour whose depth is of no clear surface */
};
#define ORTHO_FRAME "# map x, y and height = this matrix times the survey's X, Y, Z, 1\n"
/* rim around an image, as a fraction of its sides: a Gaussian whose centre lies in it may show in the image */
#define ORTHO_RIM 0.1

/* ---------------- what the views see */

static int ortho_is_seen(const oxl_camera *c, const double p[3], double rim)
{
    double at[2];
    return ground_see(c, p, at) > 0 && at[0] >= -rim * c->width && at[0] <= (1 + rim) * c->width &&
           at[1] >= -rim * c->height && at[1] <= (1 + rim) * c->height;
}

/* Makes Gaussians invisible whose centres lie in no training view's image, nor near it. */
static void ortho_hide_unseen(struct map *m, oxl_model *model)
{
    for (size_t i = 0; i < model->count; i++) {
        const double p[3] = {model->plane[OXL_MEAN][i], model->plane[OXL_MEAN + 1][i],
                             model->plane[OXL_MEAN + 2][i]};
        int seen = 0;
        for (int v = 0; v < oxl_scene_view_count(m->scene) && !seen; v++)
            seen = !oxl_scene_view(m->scene, v)->is_test &&
                   ortho_is_seen(&oxl_scene_view(m->scene, v)->camera, p, ORTHO_RIM);
        if (!seen) model->plane[OXL_OPACITY][i] = -100, m->hidden++;
    }
}

/* ---------------- the map's place */

/* Sets the map's size and corner, with pixel corners at multiples of the pixel size. */
static void ortho_lay_out(struct map *m, const double low[2], const double high[2])
{
    const double *origin = oxl_scene_origin(m->scene);
    int size[2];
    for (int d = 0; d < 3; d++) m->shift[d] = m->frame.is_world ? m->frame.centre[d] + origin[d] : 0;
    for (int d = 0; d < 2; d++) {
        const double first = floor((low[d] + m->shift[d]) / m->pixel),
                     last = ceil((high[d] + m->shift[d]) / m->pixel);
        size[d] = (int)(last - first);
        m->corner[d] = (d ? last : first) * m->pixel - m->shift[d];
    }
    m->width = size[0], m->height = size[1];
}

static oxl_camera ortho_camera(const struct map *m, int x, int y)
{
    const int rest_x = m->width - x, rest_y = m->height - y;
    oxl_camera c = {.width = rest_x < ORTHO_PATCH ? rest_x : ORTHO_PATCH,
                    .height = rest_y < ORTHO_PATCH ? rest_y : ORTHO_PATCH,
                    .fx = 1 / m->pixel,
                    .fy = 1 / m->pixel};
    double eye[3];
    c.cx = 0.5 * c.width, c.cy = 0.5 * c.height;
    for (int k = 0; k < 9; k++) c.rotation[k] = (k < 3 ? 1 : -1) * m->frame.axis[k / 3][k % 3];
    ground_place(m, x + c.cx, y + c.cy, m->top, eye);
    frame_place(&c, eye);
    return c;
}

/* Chooses the frame, the pixel size and the bounds of the map, and refuses what cannot be mapped. */
static oxl_result ortho_open(struct map *m, const oxl_model *model, int side)
{
    double low[2], high[2], eye[3], longest;
    oxl_result rc;
    if (oxl_scene_point_count(m->scene) < 3)
        return oxl_fail(
            m->ctx, OXL_ERR_INPUT,
            "ortho: the survey has no points, so its vertical axis is unknown\nfix: export points3D, too");
    if (!frame_bounds(&m->frame, m->scene, low, high))
        return oxl_fail(m->ctx, OXL_ERR_MEMORY, "ortho: no memory");
    m->top = -HUGE_VAL;
    for (int i = 0; i < oxl_scene_view_count(m->scene); i++) {
        frame_eye(&oxl_scene_view(m->scene, i)->camera, eye);
        m->top = fmax(m->top, frame_along(&m->frame, eye, 2));
    }
    rc = ground_measure_distance(m, model);
    if (rc != OXL_OK) return rc;
    longest = fmax(high[0] - low[0], high[1] - low[1]);
    if (!(longest > 0))
        return oxl_fail(m->ctx, OXL_ERR_INPUT,
                        "ortho: all points lie in one place\nfix: export the survey again");
    if (!(m->pixel > 0)) m->pixel = m->sampling > 0 ? m->sampling : longest / 2048;
    if (side > 0) m->pixel = fmax(m->pixel, longest / side);
    if (longest / m->pixel > ORTHO_SIDE_MAX)
        return oxl_fail(m->ctx, OXL_ERR_USAGE,
                        "ortho: the map would have more than %d px a side\nfix: a larger --pixel",
                        ORTHO_SIDE_MAX);
    ortho_lay_out(m, low, high);
    return OXL_OK;
}

/* ---------------- rendering */

/* Copies a patch into the map; pixels without depth stay empty. */
static void ortho_take(struct map *m, const oxl_image *image, const float *depth, int left, int top)
{
    const size_t plane = (size_t)image->width * (size_t)image->height;
    for (size_t i = 0; i < plane; i++) {
        const size_t x = (size_t)left + i % (size_t)image->width, y = (size_t)top + i / (size_t)image->width,
                     to = y * (size_t)m->width + x;
        m->level[to] = NAN;
        if (!(fabsf(depth[i]) > 0)) continue;
        m->level[to] = (float)(m->top - (double)fabsf(depth[i]));
        for (size_t k = 0; k < 3; k++)
            m->rgba[4 * to + k] = (unsigned char)(255 * fminf(fmaxf(image->rgb[k * plane + i], 0), 1) + 0.5f);
        m->rgba[4 * to + 3] = depth[i] > 0 ? 255 : ORTHO_UNCLEAR;
    }
}

/* Empties pixels that fewer views see than are enough, removes the heights that fewer confirm, and counts the
 * others. */
static oxl_result ortho_keep_seen(struct map *m, const oxl_model *model)
{
    const oxl_result rc = ground_count_views(m, model);
    size_t any = 0;
    for (size_t i = 0; rc == OXL_OK && i < (size_t)m->width * (size_t)m->height; i++) {
        unsigned char *p = m->rgba + 4 * i;
        const int is_clear = p[3] != ORTHO_UNCLEAR;
        any += m->seen[i] > 0;
        m->covered += m->seen[i] >= m->enough;
        if (m->seen[i] < m->enough) memset(p, 0, 4);
        else if (p[3]) p[3] = 255;
        if (m->confirmed[i] < m->enough || !is_clear) m->level[i] = NAN;
        m->high += !isnan(m->level[i]);
    }
    if (rc == OXL_OK && any == 0)
        return oxl_fail(
            m->ctx, OXL_ERR_INPUT,
            "ortho: nothing that a training view sees lies below the cameras: the map's up may be down\n"
            "fix: --frame survey");
    m->area = (double)m->covered * m->pixel * m->pixel;
    m->covered /= (double)any, m->high /= (double)any;
    return rc;
}

static oxl_result ortho_draw(struct map *m, const oxl_model *model, int is_quick)
{
    float *depth = malloc(sizeof *depth * ORTHO_PATCH * ORTHO_PATCH);
    const size_t pixels = (size_t)m->width * (size_t)m->height;
    oxl_render_options render = oxl_render_options_default();
    oxl_result rc = OXL_OK;
    render.near_plane = 0;
    render.parallel = (float)m->distance;
    memcpy(render.background, model->background, sizeof render.background);
    m->rgba = calloc(pixels, 4);
    m->level = malloc(sizeof *m->level * pixels);
    m->seen = malloc(sizeof *m->seen * pixels);
    m->confirmed = malloc(sizeof *m->confirmed * pixels);
    if (!depth || !m->rgba || !m->level || !m->seen || !m->confirmed)
        rc = oxl_fail(m->ctx, OXL_ERR_MEMORY, "ortho: no memory for %d x %d px\nfix: a larger --pixel",
                      m->width, m->height);
    for (int y = 0; y < m->height && rc == OXL_OK; y += ORTHO_PATCH)
        for (int x = 0; x < m->width && rc == OXL_OK; x += ORTHO_PATCH) {
            const oxl_camera camera = ortho_camera(m, x, y);
            oxl_image image = {0};
            rc = oxl_render(m->ctx, model, &camera, &render, &image, depth);
            if (rc == OXL_OK) ortho_take(m, &image, depth, x, y);
            oxl_image_free(m->ctx, &image);
        }
    free(depth);
    return rc == OXL_OK ? ortho_keep_seen(m, is_quick ? NULL : model) : rc;
}

/* Compares the heights with the survey's points: sets the median difference and the share of the points on the
 * map that have no height. */
static void ortho_compare_points(struct map *m)
{
    const size_t count = oxl_scene_point_count(m->scene), stride = 1 + count / ORTHO_CHECKED;
    double *error = malloc(sizeof *error * (count / stride + 1));
    size_t n = 0, inside = 0;
    m->error = m->none = NAN;
    for (size_t i = 0; error && i < count; i += stride) {
        const double *p = oxl_scene_points(m->scene)[i].position;
        const double x = floor((frame_along(&m->frame, p, 0) - m->corner[0]) / m->pixel),
                     y = floor((m->corner[1] - frame_along(&m->frame, p, 1)) / m->pixel);
        float level;
        if (!(x >= 0 && y >= 0 && x < m->width && y < m->height)) continue;
        inside++;
        level = m->level[(size_t)y * (size_t)m->width + (size_t)x];
        if (!isnan(level)) error[n++] = fabs((double)level - frame_along(&m->frame, p, 2));
    }
    if (n > 0) {
        qsort(error, n, sizeof *error, frame_compare);
        m->error = error[n / 2];
        m->none = (double)(inside - n) / (double)inside;
    }
    free(error);
}

oxl_result ortho_make(struct map *m, oxl_model *model, enum frame_kind kind, int side)
{
    oxl_result rc;
    frame_choose(m->scene, kind, &m->frame);
    rc = ortho_open(m, model, side);
    if (rc == OXL_OK) ortho_hide_unseen(m, model);
    if (rc == OXL_OK) rc = ortho_draw(m, model, side > 0);
    if (rc == OXL_OK) ortho_compare_points(m);
    return rc;
}

void ortho_free(struct map *m)
{
    free(m->rgba);
    free(m->level);
    free(m->seen);
    free(m->confirmed);
}

/* ---------------- files */

static oxl_result ortho_write_tiffs(const struct map *m, const struct arguments *a, double unit)
{
    struct geotiff g = {.width = m->width,
                        .height = m->height,
                        .pixel = m->pixel * unit,
                        .epsg = a->epsg,
                        .citation = "oceanxl: coordinates of the survey's world, height along its z",
                        .is_metric = a->scale > 0};
    char path[4200];
    oxl_result rc;
    if (!m->frame.is_world) g.citation = "oceanxl: along the axes in frame.txt";
    else if (oxl_scene_reference(m->scene) && !(fabs(unit - 1) > 0)) {
        g.reference = oxl_scene_reference(m->scene);
        g.citation = "oceanxl: metres east and north of the survey's reference";
    }
    for (int d = 0; d < 2; d++) g.corner[d] = (m->corner[d] + m->shift[d]) * unit;
    snprintf(path, sizeof path, "%s/ortho.tif", a->out);
    rc = geotiff_write(m->ctx, path, &g, m->rgba);
    for (size_t i = 0; i < (size_t)m->width * (size_t)m->height; i++)
        m->level[i] = (float)(((double)m->level[i] + m->shift[2]) * unit);
    g.is_height = 1;
    snprintf(path, sizeof path, "%s/height.tif", a->out);
    return rc == OXL_OK ? geotiff_write(m->ctx, path, &g, m->level) : rc;
}

/* Writes the 3 x 4 matrix from the world's coordinates to the map's x, y and height. */
static oxl_result ortho_write_frame(const struct map *m, const char *folder, double unit)
{
    const double *origin = oxl_scene_origin(m->scene);
    struct output t = {0};
    char path[4200];
    snprintf(path, sizeof path, "%s/frame.txt", folder);
    output_add(&t, "%s", ORTHO_FRAME);
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

static void ortho_say(const struct map *m, const struct arguments *a, double unit, FILE *to)
{
    const char *words = a->scale > 0 ? "metres" : "units";
    print_format(to, "map       %s/ortho.tif and height.tif, %d x %d px of %.6g %s, %s\n", a->out, m->width,
                 m->height, m->pixel * unit, words,
                 m->frame.is_world ? "in the world's x and y"
                                   : "along the survey's principal axes, which frame.txt has (--frame world: "
                                     "the world's)");
    print_format(
        to, "ground    %.4g square %s; of what any view sees %d or more see %.1f %%, %.1f %% have a height\n",
        m->area * unit * unit, words, a->min_views, 100 * m->covered, 100 * m->high);
    if (m->hidden) print_format(to, "hidden    %zu Gaussians that no training view shows\n", m->hidden);
    if (isnan(m->error)) return;
    print_format(to, "heights   median difference from the survey's points %.3g %s", m->error * unit, words);
    if (m->distance > 0) print_format(to, ", %.2f %% of the cameras' distance", 100 * m->error / m->distance);
    print_format(to, "; none at %.1f %% of them\n", 100 * m->none);
}

/* Refuses to replace a map of another program, and a CRS that is not the map's. */
static oxl_result ortho_check(const struct map *m, const struct arguments *a, const double *reference)
{
    static const char *const own[][2] = {
        {"ortho.tif", "oceanxl: "}, {"height.tif", "oceanxl: "}, {"frame.txt", ORTHO_FRAME}};
    struct frame frame;
    oxl_result rc = oxl_make_folder(m->ctx, a->out);
    for (int i = 0; i < 3 && rc == OXL_OK; i++) rc = output_check_own(m->ctx, a->out, own[i][0], own[i][1]);
    if (rc != OXL_OK || !a->epsg) return rc;
    if (reference)
        return oxl_fail(
            m->ctx, OXL_ERR_USAGE,
            "ortho: the survey's coordinates are metres around a reference (%.6f, %.6f), not of EPSG:%d\n"
            "fix: leave --epsg out, then gdalwarp -t_srs EPSG:%d map/ortho.tif warped.tif",
            reference[0], reference[1], a->epsg, a->epsg);
    frame_choose(m->scene, (enum frame_kind)a->frame, &frame);
    if (frame.is_world) return OXL_OK;
    return oxl_fail(m->ctx, OXL_ERR_USAGE,
                    "ortho: --epsg names the system of the world's coordinates, but the map is along the "
                    "survey's own axes\nfix: --frame world if the survey is georeferenced, else "
                    "georeference it first (docs/TUTORIAL.md, 5)");
}

oxl_result ortho_write(oxl_context *ctx, oxl_model *model, const oxl_scene *scene, const struct arguments *a,
                       FILE *to)
{
    const double unit = a->scale > 0 ? a->scale : 1;
    struct map m = {
        .ctx = ctx, .scene = scene, .pixel = a->pixel / unit, .enough = (unsigned short)a->min_views};
    oxl_result rc = ortho_check(&m, a, oxl_scene_reference(scene));
    if (rc == OXL_OK) rc = ortho_make(&m, model, (enum frame_kind)a->frame, 0);
    if (rc == OXL_OK) ortho_say(&m, a, unit, to);
    if (rc == OXL_OK) rc = ortho_write_frame(&m, a->out, unit);
    if (rc == OXL_OK) rc = ortho_write_tiffs(&m, a, unit);
    ortho_free(&m);
    return rc;
}
