/* ortho.c - an orthomosaic of a model, its world file, and a height model, all from straight above.
 *
 * A pinhole camera 1000 times farther away than the survey is wide, with a focal length to match: a point h
 * above the mean height is displaced by at most h / 2000, at the image's edge. Colours that change with the
 * view are those seen from straight above.
 * World file: ESRI's six lines, pixel size, two turns (0), minus pixel size, and the place of the top-left
 * pixel's centre.
 * Invariant: image to world coordinates is exact at the mean height.
 */

#include "cli.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { ORTHO_SIDE = 2048, ORTHO_SIDE_MAX = 16384 };
#define ORTHO_FAR 1000.0

struct ortho {
    struct frame frame;
    oxl_camera camera;
    double low[2], high[2], pixel, distance; /* scene's units */
    /* of the top-left pixel's centre: world, or along the frame's axes */
    double corner[2];
};

static void ortho_camera(struct ortho *o, const oxl_scene *scene)
{
    const double *origin = oxl_scene_origin(scene);
    double middle[2], eye[3];
    oxl_camera *c = &o->camera;
    for (int d = 0; d < 2; d++) middle[d] = 0.5 * (o->low[d] + o->high[d]);
    o->distance = ORTHO_FAR * fmax(o->high[0] - o->low[0], o->high[1] - o->low[1]);
    c->width = (int)ceil((o->high[0] - o->low[0]) / o->pixel);
    c->height = (int)ceil((o->high[1] - o->low[1]) / o->pixel);
    c->fx = c->fy = o->distance / o->pixel;
    c->cx = 0.5 * c->width, c->cy = 0.5 * c->height;
    for (int k = 0; k < 3; k++) {
        eye[k] = o->frame.centre[k] + middle[0] * o->frame.axis[0][k] + middle[1] * o->frame.axis[1][k] +
                 o->distance * o->frame.axis[2][k];
        c->rotation[k] = o->frame.axis[0][k];
        c->rotation[3 + k] = -o->frame.axis[1][k];
        c->rotation[6 + k] = -o->frame.axis[2][k];
    }
    frame_place(c, eye);
    o->corner[0] = middle[0] - 0.5 * (c->width - 1) * o->pixel;
    o->corner[1] = middle[1] + 0.5 * (c->height - 1) * o->pixel;
    for (int d = 0; d < 2 && o->frame.is_world; d++) o->corner[d] += o->frame.centre[d] + origin[d];
}

static int ortho_world_file(const struct ortho *o, const char *folder, double unit)
{
    const double pixel = o->pixel * unit;
    struct output t = {0};
    char path[4200];
    snprintf(path, sizeof path, "%s/ortho.pgw", folder);
    output_add(&t, "%.9f\n%.9f\n%.9f\n%.9f\n%.9f\n%.9f\n", pixel, 0.0, 0.0, -pixel, o->corner[0] * unit,
               o->corner[1] * unit);
    return output_save(&t, path);
}

/* Camera z to height above the frame's centre, in metres or units; NaN where nothing is rendered. In the
 * world's frame: the world's z. */
static oxl_result ortho_heights(oxl_context *ctx, const struct ortho *o, const oxl_scene *scene,
                                const char *folder, double unit, float *depth)
{
    const size_t pixels = (size_t)o->camera.width * (size_t)o->camera.height;
    const double base = o->frame.is_world ? o->frame.centre[2] + oxl_scene_origin(scene)[2] : 0;
    char path[4200];
    for (size_t i = 0; i < pixels; i++)
        depth[i] = depth[i] > 0 ? (float)((o->distance - (double)depth[i] + base) * unit) : NAN;
    snprintf(path, sizeof path, "%s/ortho.height.pfm", folder);
    return oxl_write_pfm(ctx, path, depth, o->camera.width, o->camera.height);
}

static oxl_result ortho_draw(oxl_context *ctx, const oxl_model *model, const oxl_scene *scene,
                             const struct arguments *a, const struct ortho *o)
{
    oxl_render_options render = oxl_render_options_default();
    oxl_image image = {0};
    const double unit = a->scale > 0 ? a->scale : 1;
    char path[4200];
    float *depth =
        a->depth ? malloc(sizeof *depth * (size_t)o->camera.width * (size_t)o->camera.height) : NULL;
    oxl_result rc = OXL_OK;
    render.near_plane = (float)(0.5 * o->distance);
    memcpy(render.background, model->background, sizeof render.background);
    if (a->depth && !depth)
        rc = oxl_fail(ctx, OXL_ERR_MEMORY, "ortho: no memory for the heights\nfix: a larger --pixel");
    if (rc == OXL_OK) rc = oxl_render(ctx, model, &o->camera, &render, &image, depth);
    snprintf(path, sizeof path, "%s/ortho.png", a->out);
    if (rc == OXL_OK) rc = oxl_image_write(ctx, path, &image);
    if (rc == OXL_OK && !ortho_world_file(o, a->out, unit))
        rc = oxl_fail(ctx, OXL_ERR_IO, "ortho: cannot write ortho.pgw\nfix: free space on the disk");
    if (rc == OXL_OK && depth) rc = ortho_heights(ctx, o, scene, a->out, unit, depth);
    oxl_image_free(ctx, &image);
    free(depth);
    return rc;
}

oxl_result ortho_write(oxl_context *ctx, const oxl_model *model, const oxl_scene *scene,
                       const struct arguments *a, FILE *to)
{
    const double unit = a->scale > 0 ? a->scale : 1;
    struct ortho o = {.pixel = a->pixel / unit};
    double side;
    oxl_result rc = oxl_make_folder(ctx, a->out);
    if (rc != OXL_OK) return rc;
    if (strlen(a->out) > 4000)
        return oxl_fail(ctx, OXL_ERR_USAGE,
                        "ortho: the folder's name is too long\nfix: -o with a shorter one");
    if (oxl_scene_point_count(scene) < 3)
        return oxl_fail(
            ctx, OXL_ERR_INPUT,
            "ortho: the survey has no points, so its vertical axis is unknown\nfix: export points3D, too");
    frame_of(scene, &o.frame);
    if (!frame_bounds(&o.frame, scene, 0, o.low, o.high))
        return oxl_fail(ctx, OXL_ERR_MEMORY, "ortho: no memory");
    side = fmax(o.high[0] - o.low[0], o.high[1] - o.low[1]);
    if (!(side > 0))
        return oxl_fail(ctx, OXL_ERR_INPUT,
                        "ortho: all points lie in one place\nfix: export the survey again");
    if (!(o.pixel > 0)) o.pixel = side / ORTHO_SIDE;
    if (side / o.pixel > ORTHO_SIDE_MAX)
        return oxl_fail(ctx, OXL_ERR_USAGE,
                        "ortho: the image would have more than 16384 px a side\nfix: a larger --pixel");
    ortho_camera(&o, scene);
    rc = ortho_draw(ctx, model, scene, a, &o);
    if (rc != OXL_OK) return rc;
    print_format(to, "%s/ortho.png, %d x %d px of %.6g %s; ortho.pgw places it %s\n", a->out, o.camera.width,
                 o.camera.height, o.pixel * unit, a->scale > 0 ? "metres" : "units",
                 o.frame.is_world ? "in the world's x and y"
                                  : "along the survey's principal axes: its world's z is not up");
    return OXL_OK;
}
