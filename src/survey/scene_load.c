/* scene_load.c - a scene from a survey's files or from arrays: points, origin, extent, statistics; its views:
 * scene_views.c.
 *
 * Coordinates are read in double and centred on a local origin before conversion to float, so that UTM
 * coordinates (4 200 000 m)
 * lose no precision:  x_local = x_world - origin,  t_local = t + R origin. The extent is that of 3DGS (Kerbl
 * 2023, reference code), made robust against an outlier camera.
 */
#include "sparse.h"
#include "image.h"
#include "imaging.h"
#include "scene.h"
#include "scene_alpha.h"
#include "survey.h"
#include "tracks.h"

#define SCENE_EXTENT 1.1      /* x the radius of the training cameras [Kerbl 2023] */
#define SCENE_EXTENT_MIN 1e-3 /* x the median depth; a smaller radius counts as one position */

void oxl_scene_free(oxl_context *ctx, oxl_scene *scene)
{
    if (!scene) return;
    for (int i = 0; i < scene->view_count && !scene->from_files; i++)
        oxl_free(ctx, (char *)scene->view[i].name);
    image_cache_free(ctx, &scene->cache);
    imaging_free(ctx, &scene->imaging);
    oxl_free(ctx, scene->lpips);
    OXL_FREE(ctx, scene->view, scene->source, scene->on_disk, scene->decoded);
    if (scene->map.data) { /* the other arrays are there */
        oxl_free(ctx, scene->colmap.camera);
        os_unmap_file(ctx, &scene->map);
        oxl_free(ctx, scene);
        return;
    }
    OXL_FREE(ctx, scene->point, scene->depth, scene->images, scene->masks);
    colmap_free(ctx, &scene->colmap);
    oxl_free(ctx, scene);
}

/* ---------------- points, origin, extent */

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
        oxl_log(ctx, OXL_LOG_WARNING, "%s holds no mask of any view; expected NAME.png, NAME as in the model",
                scene->masks);
    if (lost)
        oxl_log(
            ctx, OXL_LOG_WARNING,
            "%d of the %d masks that %s names by mask_path are not there, so nothing is ignored in these images",
            lost, named, scene->colmap.images_file);
    return OXL_OK;
}

/* Makes all coordinates relative to the origin: the median of the points, or of the camera centres without
 * points. */
static oxl_result scene_move_to_origin(oxl_context *ctx, oxl_scene *scene)
{
    const struct colmap *c = &scene->colmap;
    double *centres = oxl_alloc(ctx, (size_t)scene->view_count, 3 * sizeof *centres);
    double low[3], high[3];
    oxl_result rc;
    if (!centres) return oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for %d camera centres", scene->view_count);
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

/* Makes points grey where all are black, as GLOMAP and others write 0 0 0 for all. Black Gaussians would
 * stay black, since the clamp of colours at 0 has gradient 0. */
static void scene_default_colours(oxl_context *ctx, oxl_scene *scene)
{
    int coloured = 0;
    for (size_t i = 0; i < scene->point_count && !coloured; i++)
        for (int k = 0; k < 3; k++) coloured |= scene->point[i].rgb[k] != 0;
    if (coloured || scene->point_count == 0) return;
    for (size_t i = 0; i < scene->point_count; i++)
        memset(scene->point[i].rgb, SCENE_GREY, sizeof scene->point[i].rgb);
    oxl_log(
        ctx, OXL_LOG_WARNING,
        "the points have no colours (all are 0 0 0), so they start grey; colmap color_extractor gives them theirs");
}

static oxl_result scene_copy_points(oxl_context *ctx, oxl_scene *scene)
{
    const struct colmap *c = &scene->colmap;
    scene->point = oxl_alloc(ctx, c->point_count + 1, sizeof *scene->point);
    if (!scene->point) return oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for %zu points", c->point_count);
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
    if (scene->point_count == 0) oxl_log(ctx, OXL_LOG_WARNING, "the survey holds no points");
    scene_default_colours(ctx, scene);
    return OXL_OK;
}

static void scene_fill_stats(oxl_scene *scene)
{
    struct scene_stats *s = &scene->stats;
    double errors = 0;
    /* -1: not known */
    for (size_t i = 0; i < scene->point_count; i++) errors += OXL_MAX(scene->point[i].error, 0);
    s->views = scene->view_count;
    s->points = scene->point_count;
    s->observations = scene->colmap.track_count;
    s->mean_track = s->points ? (double)s->observations / (double)s->points : 0;
    s->mean_error = s->points ? errors / (double)s->points : 0;
}

/* Values derived from views and points, for scenes from files and from arrays. */
static oxl_result scene_measure(oxl_context *ctx, oxl_scene *scene)
{
    struct stats_view *views = oxl_alloc(ctx, (size_t)scene->view_count + 1, sizeof *views);
    double middle[3], radius = 0;
    size_t count = 0;
    oxl_result rc =
        views ? OXL_OK : oxl_fail(ctx, OXL_ERR_MEMORY, "no memory to measure %d views", scene->view_count);
    if (rc != OXL_OK) goto done;
    for (int i = 0; i < scene->view_count; i++) {
        const uint32_t image_row = scene->from_files ? (uint32_t)scene->source[i].image : (uint32_t)i;
        if (!scene->view[i].is_test) views[count++] = (struct stats_view){image_row, &scene->view[i].camera};
    }
    rc = stats_camera_radius(ctx, views, count, &radius);
    if (rc == OXL_OK) {
        const struct stats_points points = {scene->point, scene->point_count, &scene->colmap, scene->origin};
        rc = stats_depths(ctx, views, count, &points, &scene->depth, &scene->depth_count);
    }
    if (rc == OXL_OK && scene->point_count)
        rc = stats_bounds(ctx, scene->point->position, scene->point_count, sizeof *scene->point,
                          scene->stats.bounds_min, middle, scene->stats.bounds_max);
    scene->extent = SCENE_EXTENT * radius;
    if (!(scene->extent > SCENE_EXTENT_MIN * scene_depth_quantile(scene, 0.5)))
        scene->extent = scene_depth_quantile(scene, 0.5);
    if (!(scene->extent > 0)) scene->extent = 1;
    scene_fill_stats(scene);
done:
    oxl_free(ctx, views);
    return rc;
}

/* ---------------- from files */

OXL_INTERNAL oxl_result scene_build(oxl_context *ctx, oxl_scene *scene, const oxl_scene_options *o)
{
    oxl_result rc = scene_build_views(ctx, scene, o);
    scene_set_cache(scene, o->image_cache_bytes);
    if (rc == OXL_OK) rc = scene_move_to_origin(ctx, scene);
    if (rc == OXL_OK) rc = scene_copy_points(ctx, scene);
    if (rc != OXL_OK) return rc;
    rc = scene_mark_test_views(ctx, scene, o->test_every);
    if (rc == OXL_OK && o->read_images) rc = scene_count_masks(ctx, scene);
    if (rc == OXL_OK) rc = scene_measure(ctx, scene);
    if (rc == OXL_OK && o->read_images) scene->stats.unregistered = survey_count_unregistered(ctx, scene);
    if (rc == OXL_OK && o->read_images) rc = scene_decide_alpha(ctx, scene, o->alpha);
    return rc;
}

/* ---------------- from arrays */

static oxl_result scene_copy_view(oxl_context *ctx, oxl_scene *scene, const oxl_view *view,
                                  const oxl_image *image)
{
    const size_t pixels = (size_t)image->width * image->height;
    struct training_image *to = &scene->cache.image[scene->view_count];
    char *name = oxl_strdup(ctx, view->name ? view->name : "");
    if (!name) return oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for a name");
    scene->view[scene->view_count] = *view;
    scene->view[scene->view_count].name = name;
    scene->stats.test_views += view->is_test != 0;
    scene->view_count++; /* from here on, oxl_scene_free releases it */
    if (!image->rgb || image->width < 1 || image->height < 1 || image->width != view->camera.width ||
        image->height != view->camera.height)
        return oxl_fail(
            ctx, OXL_ERR_USAGE,
            "view %s: an image of %d x %d px for a camera of %d x %d\nfix: give each view its own image",
            name, image->rgb ? image->width : 0, image->rgb ? image->height : 0, view->camera.width,
            view->camera.height);
    if (!(view->camera.fx > 0 && view->camera.fx <= FLT_MAX && view->camera.fy > 0 &&
          view->camera.fy <= FLT_MAX))
        return oxl_fail(ctx, OXL_ERR_USAGE,
                        "view %s: focal lengths of %g and %g px, expected positive ones\n"
                        "fix: give each camera its fx and fy",
                        name, (double)view->camera.fx, (double)view->camera.fy);
    *to = (struct training_image){.width = image->width, .height = image->height};
    to->rgb = oxl_alloc(ctx, pixels, 3);
    to->mask = image->weight ? oxl_alloc(ctx, pixels, 1) : NULL;
    if (!to->rgb || (image->weight && !to->mask))
        return oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for the image of view %s", name);
    image_to_training(image, to);
    return OXL_OK;
}

oxl_result oxl_scene_from_arrays(oxl_context *ctx, const oxl_view *views, const oxl_image *images,
                                 int view_count, const oxl_point *points, size_t point_count, oxl_scene **out)
{
    oxl_scene *scene = oxl_calloc(ctx, 1, sizeof *scene);
    struct scene_order *order = oxl_alloc(ctx, (size_t)OXL_MAX(view_count, 0) + 1, sizeof *order);
    oxl_result rc = OXL_OK;
    *out = NULL;
    if (!scene || !order) rc = oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for a scene");
    else if (view_count < 1)
        rc = oxl_fail(ctx, OXL_ERR_USAGE, "a scene of %d views, expected one or more", view_count);
    if (rc == OXL_OK) rc = scene_alloc_views(ctx, scene, (size_t)view_count);
    if (rc != OXL_OK) goto done;
    scene->point = oxl_alloc(ctx, point_count + 1, sizeof *scene->point);
    if (!scene->point) {
        rc = oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for %zu points", point_count);
        goto done;
    }
    if (point_count) memcpy(scene->point, points, point_count * sizeof *points);
    scene->point_count = point_count;
    for (int i = 0; i < view_count; i++)
        order[i] = (struct scene_order){views[i].name ? views[i].name : "", (size_t)i};
    qsort(order, (size_t)view_count, sizeof *order, scene_compare_order);
    for (int i = 0; i < view_count && rc == OXL_OK; i++)
        rc = scene_copy_view(ctx, scene, &views[order[i].image], &images[order[i].image]);
    if (rc == OXL_OK) rc = scene_measure(ctx, scene);
done:
    oxl_free(ctx, order);
    if (rc != OXL_OK) oxl_scene_free(ctx, scene);
    else *out = scene;
    return rc;
}
