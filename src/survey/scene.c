/* scene.c - answers what other modules ask of a scene: views, points, depths, rays. */
#include "sparse.h"
#include "scene.h"
#include "survey.h"

#define SCENE_STEPS 1000          /* Limits the steps from a pixel to its direction. */
#define SCENE_PIXEL_ERROR 1e-3    /* Limits the distance (px) of the direction's pixel from the given one. */
#define SCENE_NEAR 0.2            /* Sets the near plane, in 1 % quantiles of the depths. */
#define SCENE_NEAR_POINTLESS 0.01 /* Sets the near plane, in extents, of a scene without points. */

OXL_INTERNAL int scene_project_point(const oxl_scene *scene, int view, size_t point, double x[3],
                                     double pixel[2])
{
    return camera_project(&scene->view[view].camera, scene->colmap.point[point].position, scene->origin, x,
                          pixel) &&
           fabs(x[0]) <= 10 * x[2] && fabs(x[1]) <= 10 * x[2];
}

OXL_INTERNAL double scene_depth_quantile(const oxl_scene *scene, double quantile)
{
    return stats_quantile(scene->depth, scene->depth_count, quantile);
}

OXL_INTERNAL double scene_depth_span(const oxl_scene *scene)
{
    const double nearest = scene_depth_quantile(scene, 0.1), farthest = scene_depth_quantile(scene, 0.9);
    return nearest > 0 ? farthest / nearest : 1;
}

double oxl_scene_near_plane(const oxl_scene *scene)
{
    return scene->depth_count ? SCENE_NEAR * scene_depth_quantile(scene, 0.01)
                              : SCENE_NEAR_POINTLESS * scene->extent;
}

int oxl_scene_view_count(const oxl_scene *scene)
{
    return scene->view_count;
}

OXL_INTERNAL int scene_views_of(const oxl_scene *scene, oxl_split split, int *view)
{
    int count = 0;
    for (int i = 0; i < scene->view_count; i++)
        if (split == OXL_SPLIT_ALL || (scene->view[i].is_test != 0) == (split == OXL_SPLIT_TEST))
            view[count++] = i;
    return count;
}

OXL_INTERNAL int *scene_views_by_image(oxl_context *ctx, const oxl_scene *scene, oxl_split split)
{
    const struct colmap *c = &scene->colmap;
    int *view = oxl_alloc(ctx, c->image_count + 1, sizeof *view);
    for (size_t i = 0; view && i < c->image_count; i++) view[i] = -1;
    for (int i = 0; view && i < scene->view_count; i++)
        if (split == OXL_SPLIT_ALL || !scene->view[i].is_test) view[scene->source[i].image] = i;
    return view;
}

const oxl_view *oxl_scene_view(const oxl_scene *scene, int index)
{
    return index >= 0 && index < scene->view_count ? &scene->view[index] : NULL;
}

size_t oxl_scene_point_count(const oxl_scene *scene)
{
    return scene->point_count;
}

const oxl_point *oxl_scene_points(const oxl_scene *scene)
{
    return scene->point;
}

const double *oxl_scene_origin(const oxl_scene *scene)
{
    return scene->origin;
}

const double *oxl_scene_reference(const oxl_scene *scene)
{
    return scene->colmap.has_reference ? scene->colmap.reference : NULL;
}

double oxl_scene_extent(const oxl_scene *scene)
{
    return scene->extent;
}

OXL_INTERNAL const struct colmap *scene_colmap(const oxl_scene *scene)
{
    return scene->from_files ? &scene->colmap : NULL;
}

OXL_INTERNAL const struct colmap_image *scene_source_image(const oxl_scene *scene, int view)
{
    return &scene->colmap.image[scene->source[view].image];
}

OXL_INTERNAL const double *scene_depth_range(const oxl_scene *scene, int view)
{
    const double *range = scene->from_files ? scene_source_image(scene, view)->range : NULL;
    return range && range[1] > 0 ? range : NULL;
}

OXL_INTERNAL const struct colmap_camera *scene_source_camera(const oxl_scene *scene, int view)
{
    return &scene->colmap.camera[scene->source[view].camera];
}

/* Returns the ray of a pixel of the real camera. Inverts the distortion by fixed-point iteration, which
 * converges because distortion is smaller than the distance from the axis. */
oxl_result oxl_scene_ray(oxl_context *ctx, const oxl_scene *scene, int view, double x, double y,
                         double start[3], double direction[3])
{
    const int is_view = view >= 0 && view < scene->view_count;
    const struct colmap_camera *camera =
        is_view && scene->from_files ? scene_source_camera(scene, view) : NULL;
    const oxl_camera *c = is_view ? &scene->view[view].camera : &(oxl_camera){0};
    double k[4] = {c->fx, c->fy, c->cx, c->cy}, d[2], pixel[2], length;
    const double width = camera ? camera->width : c->width, height = camera ? camera->height : c->height;
    if (!is_view)
        return oxl_fail(ctx, OXL_ERR_USAGE, "view %d does not exist: the scene has %d views", view,
                        scene->view_count);
    if (!(x >= 0 && x <= width && y >= 0 && y <= height))
        return oxl_fail(
            ctx, OXL_ERR_INPUT,
            "%s: pixel %g, %g lies outside of its %g x %g px\nfix: check the coordinates of the pixel",
            scene->view[view].name, x, y, width, height);
    if (camera) camera_intrinsics(camera, k);
    d[0] = (x - k[2]) / k[0], d[1] = (y - k[3]) / k[1];
    for (int i = 0; i < SCENE_STEPS && camera; i++) {
        camera_distort(camera, d, pixel);
        d[0] += (x - pixel[0]) / k[0], d[1] += (y - pixel[1]) / k[1];
    }
    if (camera && !(fabs(pixel[0] - x) < SCENE_PIXEL_ERROR && fabs(pixel[1] - y) < SCENE_PIXEL_ERROR))
        return oxl_fail(
            ctx, OXL_ERR_INPUT,
            "%s: pixel %g, %g is outside the range of the camera model\nfix: choose a pixel nearer to the image centre",
            scene->view[view].name, x, y);
    camera_position(c, start);
    length = sqrt(d[0] * d[0] + d[1] * d[1] + 1);
    for (int i = 0; i < 3; i++)
        direction[i] = (c->rotation[i] * d[0] + c->rotation[3 + i] * d[1] + c->rotation[6 + i]) / length;
    return OXL_OK;
}
