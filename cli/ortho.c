/* ortho.c - renders a map of a model from straight above: the orthomosaic and the height of the ground.
 *
 * Rays are parallel to the frame's above axis, so a place is at one pixel whatever its height. They begin at
 * the highest camera, so that what floats above it is not seen. The map is rendered in patches, each a view
 * of its own. A pixel is empty where the model is see-through, or where fewer than --min-views training views
 * see the place (ground.c). It has a colour but no height where no layer of the model is the surface, or
 * where fewer views confirm it.
 *
 * Map coordinates are the world's x and y, or distances along the frame's axes from its centre, in metres
 * with --scale. The world file has ESRI's six lines: pixel size, two turns (0), minus pixel size, and the
 * place of the top-left pixel's centre.
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
    ORTHO_CHECKED = 100000  /* most points that the heights are compared with */
};
#define ORTHO_FRAME "# map x, y and height = this matrix times the survey's X, Y, Z, 1\n"
/* Adds a rim around an image, as a fraction of its sides: a Gaussian whose centre lies in
 * it may show in the image. */
#define ORTHO_RIM 0.1

struct ortho {
    oxl_context *ctx;
    const oxl_scene *scene;
    struct frame frame;
    double unit;     /* metres a unit; 1 without --scale */
    double pixel;    /* units; side of a pixel */
    double sampling; /* units; median ground sampling distance of the training views; 0: not known */
    int fit;         /* px; most that the longer side has; 0: as many as the pixel size requires */
    /* numbers of pixels with ground that any training view sees; that --min-views see; that have a height */
    size_t ground_seen, ground_covered, ground_high;
    double ground; /* units; median distance of the ground from the cameras; 0: not known */
    double top;    /* units; height of the highest camera above the frame's centre */
    double low[2], high[2];
    int width, height;
    /* units; outer corner of the top-left pixel, along right and up from the frame's centre */
    double corner[2];
    double shift[3]; /* units; map coordinates of the frame's centre */
    int *order;      /* indices of the training views */
    int views;
    unsigned char *rgba; /* (height,width,4) */
    /* (height,width) units; height above the frame's centre where there is a colour; NaN: there is none */
    float *ground_level;
    float *level; /* (height,width) map units; height; NaN: none */
};

/* ---------------- what the views see */

static int ortho_is_seen(const oxl_camera *c, const double p[3], double rim)
{
    double at[2];
    return ground_see(c, p, at) > 0 && at[0] >= -rim * c->width && at[0] <= (1 + rim) * c->width &&
           at[1] >= -rim * c->height && at[1] <= (1 + rim) * c->height;
}

static int ortho_compare(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Lists the training views, and finds the height of the highest of all cameras. Returns 0 without memory. */
static int ortho_list_views(struct ortho *o)
{
    const int all = oxl_scene_view_count(o->scene);
    o->order = malloc(sizeof *o->order * ((size_t)all + 1));
    o->top = -HUGE_VAL;
    for (int i = 0; o->order && i < all; i++) {
        double eye[3];
        frame_eye(oxl_scene_view(o->scene, i), eye);
        o->top = fmax(o->top, frame_along(&o->frame, eye, 2));
        if (!oxl_scene_view(o->scene, i)->is_test) o->order[o->views++] = i;
    }
    return o->order != NULL;
}

/* Makes Gaussians invisible whose centres lie in no training view's image, nor near it. Returns their number. */
static size_t ortho_hide_unseen(const struct ortho *o, oxl_model *model)
{
    size_t hidden = 0;
    for (size_t i = 0; i < model->count; i++) {
        const double p[3] = {model->plane[OXL_MEAN][i], model->plane[OXL_MEAN + 1][i],
                             model->plane[OXL_MEAN + 2][i]};
        int seen = 0;
        for (int v = 0; v < o->views && !seen; v++)
            seen = ortho_is_seen(&oxl_scene_view(o->scene, o->order[v])->camera, p, ORTHO_RIM);
        if (!seen) model->plane[OXL_OPACITY][i] = -100, hidden++;
    }
    return hidden;
}

/* ---------------- the map's place */

/* Sets the map's size and corner, with pixel corners at multiples of the pixel size. */
static void ortho_lay_out(struct ortho *o)
{
    const double *origin = oxl_scene_origin(o->scene);
    long long first[2], last[2];
    for (int d = 0; d < 3; d++) o->shift[d] = o->frame.is_world ? o->frame.centre[d] + origin[d] : 0;
    for (int d = 0; d < 2; d++) {
        first[d] = (long long)floor((o->low[d] + o->shift[d]) / o->pixel);
        last[d] = (long long)ceil((o->high[d] + o->shift[d]) / o->pixel);
    }
    o->width = (int)(last[0] - first[0]);
    o->height = (int)(last[1] - first[1]);
    o->corner[0] = (double)first[0] * o->pixel - o->shift[0];
    o->corner[1] = (double)last[1] * o->pixel - o->shift[1];
}

/* Describes the map to ground.c. level (height,width); seen (2,height,width), the views that see a place and
 * then those that confirm it, up to `enough`; both NULL where only places are wanted. */
static struct ground ortho_ground(const struct ortho *o, float *level, unsigned short *seen, int enough)
{
    return (struct ground){&o->frame,
                           {o->corner[0], o->corner[1]},
                           o->pixel,
                           o->ground > 0 ? o->ground : HUGE_VAL,
                           o->width,
                           o->height,
                           level,
                           seen,
                           seen ? seen + (size_t)o->width * (size_t)o->height : NULL,
                           (unsigned short)enough};
}

static oxl_camera ortho_camera(const struct ortho *o, int x, int y)
{
    const int rest_x = o->width - x, rest_y = o->height - y;
    oxl_camera c = {.width = rest_x < ORTHO_PATCH ? rest_x : ORTHO_PATCH,
                    .height = rest_y < ORTHO_PATCH ? rest_y : ORTHO_PATCH,
                    .fx = 1 / o->pixel,
                    .fy = 1 / o->pixel};
    const struct ground g = ortho_ground(o, NULL, NULL, 0);
    double eye[3];
    c.cx = 0.5 * c.width, c.cy = 0.5 * c.height;
    for (int k = 0; k < 3; k++) {
        c.rotation[k] = o->frame.axis[0][k];
        c.rotation[3 + k] = -o->frame.axis[1][k];
        c.rotation[6 + k] = -o->frame.axis[2][k];
    }
    ground_place(&g, x + c.cx, y + c.cy, o->top, eye);
    frame_place(&c, eye);
    return c;
}

/* ---------------- rendering */

static unsigned char ortho_byte(float value)
{
    return (unsigned char)(255 * fminf(fmaxf(value, 0), 1) + 0.5f);
}

/* Copies a patch into the map; pixels without depth stay empty. */
static void ortho_take(struct ortho *o, const oxl_image *image, const float *depth, int left, int top)
{
    const size_t plane = (size_t)image->width * (size_t)image->height;
    for (size_t i = 0; i < plane; i++) {
        const size_t x = (size_t)left + i % (size_t)image->width, y = (size_t)top + i / (size_t)image->width,
                     to = y * (size_t)o->width + x;
        const double height = o->top - (double)fabsf(depth[i]);
        o->level[to] = o->ground_level[to] = NAN;
        memset(o->rgba + 4 * to, 0, 4);
        if (!(fabsf(depth[i]) > 0)) continue;
        o->ground_level[to] = (float)height;
        if (depth[i] > 0) o->level[to] = (float)((height + o->shift[2]) * o->unit);
        for (size_t k = 0; k < 3; k++) o->rgba[4 * to + k] = ortho_byte(image->rgb[k * plane + i]);
        o->rgba[4 * to + 3] = 255;
    }
}

/* Empties pixels that fewer than min_views see, removes the heights that fewer
 * confirm, and counts the others. */
static oxl_result ortho_keep_seen(struct ortho *o, const oxl_model *model, int min_views)
{
    const size_t pixels = (size_t)o->width * (size_t)o->height;
    unsigned short *seen = malloc(2 * sizeof *seen * pixels);
    const struct ground g = ortho_ground(o, o->ground_level, seen, min_views);
    /* Takes hidden places as seen in an overview (o->fit), so that it is quick. */
    oxl_result rc =
        seen ? ground_count_views(o->ctx, o->fit ? NULL : model, o->scene, &g)
             : oxl_fail(o->ctx, OXL_ERR_MEMORY, "ortho: no memory for %d x %d px", o->width, o->height);
    for (size_t i = 0; rc == OXL_OK && i < pixels; i++) {
        o->ground_seen += seen[i] > 0;
        o->ground_covered += seen[i] >= min_views;
        if (seen[i] < min_views) memset(o->rgba + 4 * i, 0, 4);
        if (seen[pixels + i] < min_views) o->level[i] = NAN;
        o->ground_high += !isnan(o->level[i]);
    }
    free(seen);
    if (rc == OXL_OK && o->ground_seen == 0)
        rc = oxl_fail(
            o->ctx, OXL_ERR_INPUT,
            "ortho: nothing that a training view sees lies below the cameras: the map's up may be down\n"
            "fix: --up X,Y,Z, the direction that is up, or --frame survey");
    return rc;
}

static oxl_result ortho_draw(struct ortho *o, const oxl_model *model, int min_views)
{
    float *depth = malloc(sizeof *depth * ORTHO_PATCH * ORTHO_PATCH);
    const size_t pixels = (size_t)o->width * (size_t)o->height;
    oxl_render_options render = oxl_render_options_default();
    oxl_result rc = OXL_OK;
    render.near_plane = 0;
    render.parallel = (float)o->ground;
    memcpy(render.background, model->background, sizeof render.background);
    o->rgba = malloc(4 * pixels);
    o->level = malloc(sizeof *o->level * pixels);
    o->ground_level = malloc(sizeof *o->ground_level * pixels);
    if (!depth || !o->rgba || !o->level || !o->ground_level)
        rc = oxl_fail(o->ctx, OXL_ERR_MEMORY, "ortho: no memory for %d x %d px\nfix: a larger --pixel",
                      o->width, o->height);
    for (int y = 0; y < o->height && rc == OXL_OK; y += ORTHO_PATCH)
        for (int x = 0; x < o->width && rc == OXL_OK; x += ORTHO_PATCH) {
            const oxl_camera camera = ortho_camera(o, x, y);
            oxl_image image = {0};
            rc = oxl_render(o->ctx, model, &camera, &render, &image, depth);
            if (rc == OXL_OK) ortho_take(o, &image, depth, x, y);
            oxl_image_free(o->ctx, &image);
        }
    free(depth);
    return rc == OXL_OK ? ortho_keep_seen(o, model, min_views) : rc;
}

/* ---------------- files */

/* Returns 1 if map coordinates are metres east and north of a known place. */
static int ortho_reference(const struct ortho *o)
{
    return oxl_scene_reference(o->scene) && o->frame.is_world && !(fabs(o->unit - 1) > 0);
}

static oxl_result ortho_write_tiffs(const struct ortho *o, const struct arguments *a)
{
    const char *words = a->scale > 0 || a->epsg || o->frame.is_world
                            ? "oceanxl: coordinates of the survey's world, height along its z"
                            : "oceanxl: along the axes in frame.txt, in the survey's unit";
    struct geotiff g = {.width = o->width,
                        .height = o->height,
                        .pixel = o->pixel * o->unit,
                        .epsg = a->epsg,
                        .citation = words,
                        .is_metric = a->scale > 0};
    char path[4200];
    oxl_result rc;
    if (!o->frame.is_world) g.citation = "oceanxl: along the axes in frame.txt";
    else if (ortho_reference(o)) {
        g.reference = oxl_scene_reference(o->scene);
        g.citation = "oceanxl: metres east and north of the survey's reference";
    }
    for (int d = 0; d < 2; d++) g.corner[d] = (o->corner[d] + o->shift[d]) * o->unit;
    snprintf(path, sizeof path, "%s/ortho.tif", a->out);
    rc = geotiff_write(o->ctx, path, &g, o->rgba);
    g.is_height = 1;
    snprintf(path, sizeof path, "%s/height.tif", a->out);
    return rc == OXL_OK ? geotiff_write(o->ctx, path, &g, o->level) : rc;
}

/* Writes the 3 x 4 matrix from the world's coordinates to the map's x, y and height. */
static oxl_result ortho_write_frame(const struct ortho *o, const char *folder)
{
    const double *origin = oxl_scene_origin(o->scene);
    struct output t = {0};
    char path[4200];
    snprintf(path, sizeof path, "%s/frame.txt", folder);
    output_add(&t, "%s", ORTHO_FRAME);
    for (int d = 0; d < 3; d++) {
        double offset = o->shift[d];
        for (int k = 0; k < 3; k++) {
            offset -= o->frame.axis[d][k] * (o->frame.centre[k] + origin[k]);
            output_add(&t, "%s ", oxl_json_number_text((char[48]){0}, o->frame.axis[d][k] * o->unit));
        }
        output_add(&t, "%s\n", oxl_json_number_text((char[48]){0}, o->frame.is_world ? 0 : offset * o->unit));
    }
    return output_save(&t, path)
               ? OXL_OK
               : oxl_fail(o->ctx, OXL_ERR_IO, "%s cannot be written\nfix: free space on the disk", path);
}

static int ortho_write_world_file(const struct ortho *o, const char *folder)
{
    const double pixel = o->pixel * o->unit;
    struct output t = {0};
    char path[4200];
    snprintf(path, sizeof path, "%s/ortho.pgw", folder);
    output_add(&t, "%.9f\n%.9f\n%.9f\n%.9f\n%.9f\n%.9f\n", pixel, 0.0, 0.0, -pixel,
               (o->corner[0] + 0.5 * o->pixel + o->shift[0]) * o->unit,
               (o->corner[1] - 0.5 * o->pixel + o->shift[1]) * o->unit);
    return output_save(&t, path);
}

/* Writes the map as ortho.png, ortho.pgw and ortho.height.pfm. Empty pixels are black in the
 * PNG, NaN in the float map. */
static oxl_result ortho_write_png(const struct ortho *o, const char *folder)
{
    const size_t plane = (size_t)o->width * (size_t)o->height;
    oxl_image image = {0};
    char path[4200];
    oxl_result rc = oxl_image_create(o->ctx, o->width, o->height, &image);
    for (size_t i = 0; i < 3 * plane && rc == OXL_OK; i++)
        image.rgb[i] = (float)o->rgba[4 * (i % plane) + i / plane] / 255;
    snprintf(path, sizeof path, "%s/ortho.png", folder);
    if (rc == OXL_OK) rc = oxl_image_write(o->ctx, path, &image);
    oxl_image_free(o->ctx, &image);
    if (rc == OXL_OK && !ortho_write_world_file(o, folder))
        rc = oxl_fail(o->ctx, OXL_ERR_IO, "ortho: cannot write ortho.pgw\nfix: free space on the disk");
    snprintf(path, sizeof path, "%s/ortho.height.pfm", folder);
    return rc == OXL_OK ? oxl_write_pfm(o->ctx, path, o->level, o->width, o->height) : rc;
}

/* ---------------- what it says */

/* Compares the heights with the survey's points. Returns the median difference in units, NaN: none has a
 * height. Sets the number compared, and *none to the share without a height of the points on the map. */
static double ortho_compare_points(const struct ortho *o, size_t *compared, double *none)
{
    const size_t count = oxl_scene_point_count(o->scene), stride = 1 + count / ORTHO_CHECKED;
    double *error = malloc(sizeof *error * (count / stride + 1)), median = NAN;
    size_t n = 0, inside = 0;
    for (size_t i = 0; error && i < count; i += stride) {
        const double *p = oxl_scene_points(o->scene)[i].position;
        const double x = floor((frame_along(&o->frame, p, 0) - o->corner[0]) / o->pixel),
                     y = floor((o->corner[1] - frame_along(&o->frame, p, 1)) / o->pixel);
        float level;
        if (!(x >= 0 && y >= 0 && x < o->width && y < o->height)) continue;
        inside++;
        level = o->level[(size_t)y * (size_t)o->width + (size_t)x];
        if (!isnan(level))
            error[n++] = fabs((double)level / o->unit - o->shift[2] - frame_along(&o->frame, p, 2));
    }
    if (n > 0) {
        qsort(error, n, sizeof *error, ortho_compare);
        median = error[n / 2];
    }
    free(error);
    *compared = n;
    *none = inside ? (double)(inside - n) / (double)inside : NAN;
    return median;
}

static void ortho_say_heights(const struct ortho *o, FILE *to)
{
    size_t compared;
    double none;
    const double median = ortho_compare_points(o, &compared, &none);
    if (isnan(median)) return;
    print_format(to, "heights   median difference from %zu of the survey's points %.3g %s", compared,
                 median * o->unit, o->unit > 0 && fabs(o->unit - 1) > 0 ? "m" : "units");
    if (o->ground > 0) print_format(to, ", %.2f %% of the cameras' distance", 100 * median / o->ground);
    print_format(to, "; none at %.1f %% of them\n", 100 * none);
}

static void ortho_say(const struct ortho *o, const struct arguments *a, size_t hidden, FILE *to)
{
    const char *axes =
        o->frame.is_world ? "in the world's x and y"
        : a->up[0] * a->up[0] + a->up[1] * a->up[1] + a->up[2] * a->up[2] > 0
            ? "seen along --up, by the axes in frame.txt"
            : "along the survey's principal axes, which frame.txt has (--frame world: the world's)";
    print_format(to, "map       %s/ortho.tif and height.tif, %d x %d px of %.6g %s, %s\n", a->out, o->width,
                 o->height, o->pixel * o->unit, a->scale > 0 ? "metres" : "units", axes);
    if (o->ground_seen > 0)
        print_format(
            to,
            "ground    %.4g square %s; of what any view sees %d or more see %.1f %%, %.1f %% have a height\n",
            (double)o->ground_covered * o->pixel * o->pixel * o->unit * o->unit,
            a->scale > 0 ? "metres" : "units", a->min_views,
            100 * (double)o->ground_covered / (double)o->ground_seen,
            100 * (double)o->ground_high / (double)o->ground_seen);
    if (hidden) print_format(to, "hidden    %zu Gaussians that no training view shows\n", hidden);
    ortho_say_heights(o, to);
}

/* ---------------- the whole map */

/* Chooses the frame, the pixel size and the bounds of the map, and refuses what cannot be mapped. */
static oxl_result ortho_open(struct ortho *o, const oxl_model *model, const struct arguments *a)
{
    oxl_result rc;
    double side;
    if (strlen(a->out) > 4000)
        return oxl_fail(o->ctx, OXL_ERR_USAGE,
                        "ortho: the folder's name is too long\nfix: -o with a shorter one");
    if (oxl_scene_point_count(o->scene) < 3)
        return oxl_fail(
            o->ctx, OXL_ERR_INPUT,
            "ortho: the survey has no points, so its vertical axis is unknown\nfix: export points3D, too");
    frame_choose(o->scene,
                 a->frame == FRAME_AUTO && oxl_scene_reference(o->scene) ? FRAME_WORLD_AXES
                                                                         : (enum frame_kind)a->frame,
                 fabs(a->up[0]) + fabs(a->up[1]) + fabs(a->up[2]) > 0 ? a->up : NULL, &o->frame);
    if (a->epsg && oxl_scene_reference(o->scene))
        return oxl_fail(
            o->ctx, OXL_ERR_USAGE,
            "ortho: the survey's coordinates are metres around a reference (%.6f, %.6f), not of EPSG:%d\n"
            "fix: leave --epsg out, then gdalwarp -t_srs EPSG:%d map/ortho.tif warped.tif",
            oxl_scene_reference(o->scene)[0], oxl_scene_reference(o->scene)[1], a->epsg, a->epsg);
    if (a->epsg && !o->frame.is_world)
        return oxl_fail(o->ctx, OXL_ERR_USAGE,
                        "ortho: --epsg names the system of the world's coordinates, but the map is along the "
                        "survey's own axes\nfix: --frame world if the survey is georeferenced, else "
                        "georeference it first (docs/TUTORIAL.md, 5)");
    if (!frame_bounds(&o->frame, o->scene, 0, o->low, o->high) || !ortho_list_views(o))
        return oxl_fail(o->ctx, OXL_ERR_MEMORY, "ortho: no memory");
    rc =
        ground_measure_distance(o->ctx, model, o->scene, o->fit ? GROUND_DISTANCE_FEW : GROUND_DISTANCE_VIEWS,
                                &o->ground, &o->sampling);
    if (rc != OXL_OK) return rc;
    side = fmax(o->high[0] - o->low[0], o->high[1] - o->low[1]);
    if (!(side > 0))
        return oxl_fail(o->ctx, OXL_ERR_INPUT,
                        "ortho: all points lie in one place\nfix: export the survey again");
    if (!(o->pixel > 0)) o->pixel = o->sampling > 0 ? o->sampling : side / 2048;
    if (o->fit > 0) o->pixel = fmax(o->pixel, side / o->fit);
    if (side / o->pixel > ORTHO_SIDE_MAX)
        return oxl_fail(o->ctx, OXL_ERR_USAGE,
                        "ortho: the map would have more than %d px a side\nfix: a larger --pixel",
                        ORTHO_SIDE_MAX);
    ortho_lay_out(o);
    return OXL_OK;
}

static int ortho_has(const char *folder, const char *name)
{
    char path[4200];
    FILE *file;
    snprintf(path, sizeof path, "%s/%s", folder, name);
    if ((file = oxl_open(path))) fclose(file);
    return file != NULL;
}

/* Refuses to replace a map of another program. One of ours has our words in its GeoKeys; the files of --png
 * hold no words, so they are ours where ortho.tif and ortho.height.pfm are there. */
static oxl_result ortho_check_files(const struct ortho *o, const struct arguments *a)
{
    static const char *const with_png[] = {"ortho.png", "ortho.pgw", "ortho.height.pfm"};
    static const char tag[] = "oceanxl: ";
    oxl_result rc = output_check_own(o->ctx, a->out, "ortho.tif", tag);
    if (rc == OXL_OK) rc = output_check_own(o->ctx, a->out, "height.tif", tag);
    if (rc == OXL_OK) rc = output_check_own(o->ctx, a->out, "frame.txt", ORTHO_FRAME);
    if (ortho_has(a->out, "ortho.tif") && ortho_has(a->out, with_png[2])) return rc;
    for (int i = 0; i < 3 && rc == OXL_OK && a->png; i++)
        rc = output_check_own(o->ctx, a->out, with_png[i], NULL);
    return rc;
}

oxl_result ortho_write(oxl_context *ctx, oxl_model *model, const oxl_scene *scene, const struct arguments *a,
                       FILE *to)
{
    struct ortho o = {.ctx = ctx, .scene = scene, .unit = a->scale > 0 ? a->scale : 1};
    size_t hidden = 0;
    oxl_result rc = oxl_make_folder(ctx, a->out);
    o.pixel = a->pixel / o.unit;
    if (rc == OXL_OK) rc = ortho_check_files(&o, a);
    if (rc == OXL_OK) rc = ortho_open(&o, model, a);
    if (rc == OXL_OK) {
        hidden = ortho_hide_unseen(&o, model);
        rc = ortho_draw(&o, model, a->min_views);
    }
    if (rc == OXL_OK) rc = ortho_write_tiffs(&o, a);
    if (rc == OXL_OK) rc = ortho_write_frame(&o, a->out);
    if (rc == OXL_OK && a->png) rc = ortho_write_png(&o, a->out);
    if (rc == OXL_OK) ortho_say(&o, a, hidden, to);
    free(o.order);
    free(o.rgba);
    free(o.level);
    free(o.ground_level);
    return rc;
}

oxl_result ortho_overview(oxl_context *ctx, oxl_model *model, const oxl_scene *scene, int side,
                          struct overview *out)
{
    const struct arguments a = {.out = ""};
    static const float empty[3] = {0.035f, 0.10f, 0.14f}; /* the colour of the report's map */
    struct ortho o = {.ctx = ctx, .scene = scene, .unit = 1, .fit = side};
    size_t compared;
    double none;
    oxl_result rc = ortho_open(&o, model, &a);
    memset(out, 0, sizeof *out);
    if (rc == OXL_OK) {
        ortho_hide_unseen(&o, model);
        rc = ortho_draw(&o, model, OVERVIEW_VIEWS);
    }
    if (rc == OXL_OK) rc = oxl_image_create(ctx, o.width, o.height, &out->image);
    if (rc == OXL_OK) {
        const size_t plane = (size_t)o.width * (size_t)o.height;
        for (size_t c = 0; c < 3; c++)
            for (size_t i = 0; i < plane; i++)
                out->image.rgb[c * plane + i] = o.rgba[4 * i + 3] ? (float)o.rgba[4 * i + c] / 255 : empty[c];
        out->sampling = o.sampling;
        out->area = (double)o.ground_covered * o.pixel * o.pixel;
        out->covered = o.ground_seen ? (double)o.ground_covered / (double)o.ground_seen : 0;
        out->high = o.ground_seen ? (double)o.ground_high / (double)o.ground_seen : 0;
        out->height_error = ortho_compare_points(&o, &compared, &none);
        out->distance = o.ground;
    }
    free(o.order);
    free(o.rgba);
    free(o.level);
    free(o.ground_level);
    return rc;
}
