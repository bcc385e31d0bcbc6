/* scene_build.c - builds a scene from the rows of a survey's files: points around a local origin, masks.
 * scene_views.c makes its views.
 *
 * Coordinates are read in double and centred on a local origin before conversion to float, so that UTM
 * coordinates (4 200 000 m) lose no precision: x_local = x_world - origin, t_local = t + R origin.
 */
#include "survey_read.h"
#include "../survey/scene.h"
#include "../survey/survey.h"
#include "../survey/tracks.h"

static oxl_result scene_count_masks(oxl_context *ctx, oxl_scene *scene)
{
    int named = 0, lost = 0;
    for (int i = 0; i < scene->view_count; i++) {
        const int names = scene_source_image(scene, i)->mask != 0;
        char *path;
        const oxl_result rc = scene_mask_path(ctx, scene, i, &path);
        if (rc != OXL_OK) return rc;
        scene->stats.masks += path != NULL;
        named += names;
        lost += names && !path;
        oxl_free(ctx, path);
    }
    if (scene->masks && scene->stats.masks == 0)
        oxl_log(ctx, OXL_LOG_WARNING, "%s holds no mask for a view; expected NAME.png, NAME as in the model",
                scene->masks);
    if (lost)
        oxl_log(
            ctx, OXL_LOG_WARNING,
            "%d of the %d masks that %s names as mask_path are missing, so nothing is ignored in these images",
            lost, named, scene->colmap.images_file);
    return OXL_OK;
}

/* Moves the views to the origin, the median of the points, or of the camera centres if there are no points;
 * points follow in scene_copy_points. */
static oxl_result scene_move_to_origin(oxl_context *ctx, oxl_scene *scene)
{
    const struct colmap *c = &scene->colmap;
    double *centres = oxl_alloc(ctx, (size_t)scene->view_count, 3 * sizeof *centres);
    double low[3], high[3];
    oxl_result rc;
    if (!centres) return OXL_ERR_MEMORY;
    for (int i = 0; i < scene->view_count; i++) camera_position(&scene->view[i].camera, centres + 3 * i);
    if (c->point_count)
        rc =
            stats_bounds(ctx, c->point->position, c->point_count, sizeof *c->point, low, scene->origin, high);
    else
        rc = stats_bounds(ctx, centres, (size_t)scene->view_count, 3 * sizeof *centres, low, scene->origin,
                          high);
    oxl_free(ctx, centres);
    for (int i = 0; i < scene->view_count && rc == OXL_OK; i++) {
        oxl_camera *camera = &scene->view[i].camera;
        for (int j = 0; j < 3; j++)
            for (int k = 0; k < 3; k++)
                camera->translation[j] += camera->rotation[3 * j + k] * scene->origin[k];
    }
    return rc;
}

/* Warns if all points have the same grey, which programs without colours write. Makes black points grey, as
 * GLOMAP writes them: black Gaussians would stay black, since the clamp of colours at 0 has gradient 0. */
static void scene_default_colours(oxl_context *ctx, oxl_scene *scene)
{
    const uint8_t grey = scene->point_count ? scene->point[0].rgb[0] : 0;
    int coloured = 0;
    for (size_t i = 0; i < scene->point_count && !coloured; i++)
        for (int k = 0; k < 3; k++) coloured |= scene->point[i].rgb[k] != grey;
    if (coloured || scene->point_count == 0) return;
    for (size_t i = 0; i < scene->point_count && grey == 0; i++)
        memset(scene->point[i].rgb, SCENE_GREY, sizeof scene->point[i].rgb);
    oxl_log(ctx, OXL_LOG_WARNING,
            "the points have no colours (all are %d %d %d), so they start %s\nfix: run colmap "
            "color_extractor; in a PLY, colours are uchar red, green, blue",
            grey, grey, grey, grey ? "so" : "grey");
}

static oxl_result scene_copy_points(oxl_context *ctx, oxl_scene *scene)
{
    const struct colmap *c = &scene->colmap;
    scene->point = oxl_alloc(ctx, c->point_count + 1, sizeof *scene->point);
    if (!scene->point) return OXL_ERR_MEMORY;
    for (size_t i = 0; i < c->point_count; i++) {
        const struct colmap_point *from = &c->point[i];
        oxl_point point = {.error = (float)from->error};
        for (int k = 0; k < 3; k++) {
            point.position[k] = from->position[k] - scene->origin[k];
            point.rgb[k] = from->rgb[k];
        }
        if (tracks_accept_point(from, scene->origin)) scene->point[scene->point_count++] = point;
    }
    if (scene->point_count < c->point_count)
        oxl_log(ctx, OXL_LOG_WARNING, "%zu of %zu points have no finite position and are left out",
                c->point_count - scene->point_count, c->point_count);
    scene_default_colours(ctx, scene);
    return OXL_OK;
}

OXL_INTERNAL oxl_result scene_build(oxl_context *ctx, oxl_scene *scene, const oxl_scene_options *o)
{
    oxl_result rc = scene_build_views(ctx, scene, o);
    if (rc == OXL_OK) scene_set_cache(scene, o->image_cache_bytes);
    if (rc == OXL_OK) rc = scene_move_to_origin(ctx, scene);
    if (rc == OXL_OK) rc = scene_copy_points(ctx, scene);
    if (rc != OXL_OK) return rc;
    rc = scene_mark_test_views(ctx, scene, o->test_every, o->read_images);
    if (rc == OXL_OK && o->read_images) rc = scene_count_masks(ctx, scene);
    if (rc == OXL_OK) rc = scene_measure(ctx, scene);
    if (rc == OXL_OK && o->read_images) rc = scene_decide_alpha(ctx, scene, o->alpha);
    if (rc == OXL_OK && o->read_images && o->auto_mask && !scene_is_composited(scene))
        rc = scene_find_fixed(ctx, scene);
    return rc;
}
