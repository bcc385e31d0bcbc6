/* scene_make.c - makes a scene from arrays, and derives extent, depths and statistics of every scene from its
 * views and points.
 *
 * Steps and sizes are relative to the extent. It is in depths of the points that the views see: the radius of
 * the cameras, as in 3DGS, says nothing of these where a survey has two sites, a camera far away, or cameras
 * in one place. Only without points it is that radius, made robust against an outlier camera.
 */
#include "sparse.h"
#include "image.h"
#include "imaging.h"
#include "photometry.h"
#include "scene.h"
#include "survey.h"

#define SCENE_EXTENT 1.3        /* Sets the extent, in median depths (docs/log/TRAINING.md), or, */
#define SCENE_EXTENT_RADIUS 1.1 /* without points, in radii of the training cameras [Kerbl 2023]. */

/* ---------------- memory */

OXL_INTERNAL void colmap_free(oxl_context *ctx, struct colmap *c)
{
    OXL_FREE(ctx, c->camera, c->image, c->point, c->track, c->names, c->folder, c->images);
    *c = (struct colmap){0};
}

OXL_INTERNAL oxl_result scene_alloc_views(oxl_context *ctx, oxl_scene *scene, size_t count)
{
    scene->view = oxl_calloc(ctx, count + 1, sizeof *scene->view);
    scene->source = oxl_calloc(ctx, count + 1, sizeof *scene->source);
    if (scene->view && scene->source) return scene_begin_cache(ctx, scene, count);
    return OXL_ERR_MEMORY;
}

void oxl_scene_free(oxl_context *ctx, oxl_scene *scene)
{
    if (!scene) return;
    for (int i = 0; i < scene->view_count && !scene->from_files; i++)
        oxl_free(ctx, (char *)scene->view[i].name);
    scene_free_cache(ctx, scene);
    for (size_t i = 0; scene->fixed && i < scene->colmap.camera_count; i++)
        oxl_free(ctx, scene->fixed[i].data);
    OXL_FREE(ctx, scene->view, scene->source, scene->on_disk, scene->fixed, scene->fixed_of);
    OXL_FREE(ctx, scene->point, scene->depth, scene->images, scene->masks);
    colmap_free(ctx, &scene->colmap);
    oxl_free(ctx, scene);
}

/* ---------------- extent, depths, statistics */

static void scene_fill_stats(oxl_scene *scene)
{
    struct scene_stats *s = &scene->stats;
    double errors = 0;
    size_t known = 0;
    /* An error of -1 is not known, nor is 0, which RealityCapture writes for all points. */
    for (size_t i = 0; i < scene->point_count; i++) {
        errors += OXL_MAX(scene->point[i].error, 0);
        known += scene->point[i].error > 0;
    }
    s->views = scene->view_count;
    s->points = scene->point_count;
    s->observations = scene->colmap.track_count;
    s->mean_track = s->points ? (double)s->observations / (double)s->points : 0;
    s->mean_error = known ? errors / (double)known : 0;
}

OXL_INTERNAL oxl_result scene_measure(oxl_context *ctx, oxl_scene *scene)
{
    double middle[3], radius = 0;
    oxl_result rc = stats_camera_radius(ctx, scene, &radius);
    if (rc == OXL_OK) rc = stats_depths(ctx, scene);
    if (rc == OXL_OK && scene->point_count)
        rc = stats_bounds(ctx, scene->point->position, scene->point_count, sizeof *scene->point,
                          scene->stats.bounds_min, middle, scene->stats.bounds_max);
    scene->extent =
        scene->depth_count ? SCENE_EXTENT * scene_depth_quantile(scene, 0.5) : SCENE_EXTENT_RADIUS * radius;
    if (!(scene->extent > 0)) scene->extent = 1;
    scene_fill_stats(scene);
    return rc;
}

/* ---------------- from arrays */

OXL_INTERNAL int scene_compare_order(const void *a, const void *b)
{
    const struct scene_order *x = a, *y = b;
    const int c = strcmp(x->name, y->name);
    return c ? c : (x->image > y->image) - (x->image < y->image);
}

static oxl_result scene_copy_view(oxl_context *ctx, oxl_scene *scene, const oxl_view *view,
                                  const oxl_image *image)
{
    struct training_image *to = &scene->cache->image[scene->view_count];
    char *name = oxl_strdup(ctx, view->name ? view->name : "");
    if (!name) return OXL_ERR_MEMORY;
    scene->view[scene->view_count] = *view;
    scene->view[scene->view_count].name = name;
    scene->stats.test_views += view->is_test != 0;
    scene->view_count++; /* oxl_scene_free releases it from here on */
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
    if (!camera_has_pose(&view->camera))
        return oxl_fail(ctx, OXL_ERR_USAGE,
                        "view %s: its pose is no rotation, or a translation beyond 1e15\n"
                        "fix: give finite numbers, and rows of length 1 at right angles, right-handed",
                        name);
    if (image_training_alloc(ctx, &view->camera, image->weight != NULL, to) != OXL_OK) return OXL_ERR_MEMORY;
    image_to_training(image, to);
    return OXL_OK;
}

static oxl_result scene_take_points(oxl_context *ctx, oxl_scene *scene, const oxl_point *points, size_t count)
{
    scene->point = oxl_alloc(ctx, count + 1, sizeof *scene->point);
    if (!scene->point) return OXL_ERR_MEMORY;
    if (count) memcpy(scene->point, points, count * sizeof *points);
    scene->point_count = count;
    return OXL_OK;
}

oxl_result oxl_scene_from_arrays(oxl_context *ctx, const oxl_view *views, const oxl_image *images,
                                 int view_count, const oxl_point *points, size_t point_count, oxl_scene **out)
{
    oxl_scene *scene = oxl_calloc(ctx, 1, sizeof *scene);
    struct scene_order *order = oxl_alloc(ctx, (size_t)OXL_MAX(view_count, 0) + 1, sizeof *order);
    oxl_result rc = OXL_OK;
    *out = NULL;
    if (!scene || !order) rc = OXL_ERR_MEMORY;
    else if (view_count < 1)
        rc = oxl_fail(ctx, OXL_ERR_USAGE, "a scene of %d views, expected one or more", view_count);
    if (rc == OXL_OK) rc = scene_alloc_views(ctx, scene, (size_t)view_count);
    if (rc == OXL_OK) rc = scene_take_points(ctx, scene, points, point_count);
    for (int i = 0; i < view_count && rc == OXL_OK; i++)
        order[i] = (struct scene_order){views[i].name ? views[i].name : "", (size_t)i};
    if (rc == OXL_OK) qsort(order, (size_t)view_count, sizeof *order, scene_compare_order);
    for (int i = 1; i < view_count && rc == OXL_OK; i++)
        if (!strcmp(order[i - 1].name, order[i].name))
            rc = oxl_fail(ctx, OXL_ERR_USAGE,
                          "two views have the name '%s'\nfix: give each a name of its own", order[i].name);
    for (int i = 0; i < view_count && rc == OXL_OK; i++)
        rc = scene_copy_view(ctx, scene, &views[order[i].image], &images[order[i].image]);
    if (rc == OXL_OK) rc = scene_measure(ctx, scene);
    oxl_free(ctx, order);
    if (rc != OXL_OK) oxl_scene_free(ctx, scene);
    else *out = scene;
    return rc;
}
