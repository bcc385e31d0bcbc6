/* scene.h - declares views, points and images of a scene. */
#ifndef OXL_SCENE_H
#define OXL_SCENE_H

#include "image.h"
#include "imaging.h"

enum { SCENE_GREY = 128 }; /* grey of points without colour */

struct scene_stats { /* Holds counts for `check` and the first messages of a run. */
    int images_listed, images_missing, unregistered, views, test_views, masks;
    size_t points, observations; /* points; (point, image) pairs */
    double mean_track, mean_error;
    double fixed;                        /* fraction of all pixels that scene_find_fixed masks */
    double bounds_min[3], bounds_max[3]; /* 1st and 99th percentile of the points, around the origin */
};

struct scene_source { /* Names a view's rows in colmap.image and colmap.camera. */
    size_t image, camera;
};

struct oxl_scene {
    oxl_view *view; /* (view_count) */
    int view_count;
    double origin[3], extent;

    oxl_point *point;
    size_t point_count;
    double *depth; /* (depth_count) sample of the points' depths in the training views, ascending */
    size_t depth_count;

    /* (view_count) images that were read: the one part of a loaded scene that changes */
    struct image_cache *cache;

    struct scene_stats stats;
    int from_files;
    struct colmap colmap;        /* from files: rows of the survey's files; holds the views' names */
    struct scene_source *source; /* from files: (view_count) */
    double max_missing;          /* from files: fraction of the images that may be missing or unreadable */
    double *on_disk;             /* from files: (cameras) px of an image's side per px of its camera */
    char *images, *masks;        /* from files: folders; masks NULL: none */
    int transparent;             /* images with an alpha channel */
    int alpha_masks;             /* 1: transparent pixels are masked; 0: composited over a background */
    struct pixels *fixed;        /* (cameras) what all images of one show alike: masks; data NULL: none */
    int *fixed_of;               /* (cameras) index of the camera's mask */
};

struct scene_order { /* Orders images by name, and equal names by file order. */
    const char *name;
    size_t image;
};
OXL_INTERNAL int scene_compare_order(const void *a, const void *b);
OXL_INTERNAL oxl_result scene_alloc_views(oxl_context *ctx, oxl_scene *scene, size_t count);
/* Derives extent, depths and statistics from views and points, for scenes from files and from arrays. */
OXL_INTERNAL oxl_result scene_measure(oxl_context *ctx, oxl_scene *scene);

/* ---------------- pose.c: a pose beside that of the survey's files */

struct pose {
    double at[POSE_TERMS]; /* turn and move, as in struct oxl_imaging */
    double mean[POSE_TERMS],
        square[POSE_TERMS]; /* Adam's moments, for turns and for moves in units of the depth */
    int visits;             /* steps taken */
};
struct pose_rule {
    double rate, most; /* greatest change by a step, and in all: rad, and fractions of the depth */
    double depth;      /* units of the scene; scale of a move of the centre */
    double prior;      /* pull towards the survey's pose: gradient at 1 rad */
};
OXL_INTERNAL int pose_is_moved(const double at[POSE_TERMS]);
/* Sets rotation and translation of *out to the given camera's, turned and moved by `at`. */
OXL_INTERNAL void pose_apply(const oxl_camera *given, const double at[POSE_TERMS], oxl_camera *out);
/* Makes a scene whose cameras the caller may move; all else is that of `scene`. NULL: no memory. */
OXL_INTERNAL oxl_scene *scene_posed(oxl_context *ctx, const oxl_scene *scene);
OXL_INTERNAL void scene_posed_free(oxl_context *ctx, oxl_scene *posed);
/* Returns the camera of a view, moved by the pose that imaging, which may be NULL, has of it. */
OXL_INTERNAL oxl_camera scene_camera(const oxl_scene *scene, const struct oxl_imaging *imaging, int view);
/* Moves the views of such a scene: their cameras are those of `scene`, moved by pose (views). */
OXL_INTERNAL void scene_move_views(const oxl_scene *scene, double (*pose)[POSE_TERMS], oxl_scene *posed);
/* Takes a step along dL/d(pose), which renderer_pose_gradient gives. */
OXL_INTERNAL void pose_step(struct pose *p, const oxl_camera *given, const double world[POSE_TERMS],
                            const struct pose_rule *rule);

/* ---------------- scene.c, scene_make.c, scene_images.c: views, points, images */

OXL_INTERNAL const struct colmap *scene_colmap(const oxl_scene *scene); /* NULL: a scene from arrays */
/* Projects a point of scene_colmap by camera_project; returns 0 also for a point far outside the image. */
OXL_INTERNAL int scene_project_point(const oxl_scene *scene, int view, size_t point, double x[3],
                                     double pixel[2]);
/* Return the camera and the image of `colmap` that a view comes from; for scenes from files. */
OXL_INTERNAL const struct colmap_camera *scene_source_camera(const oxl_scene *scene, int view);
OXL_INTERNAL const struct colmap_image *scene_source_image(const oxl_scene *scene, int view);
/* Returns the nearest and the farthest depth of what a view shows; NULL: the survey does not state them. */
OXL_INTERNAL const double *scene_depth_range(const oxl_scene *scene, int view);
/* Returns a view's image from the cache, after loading it if necessary; it is borrowed until the next request
 * of another view. NULL: the error is set. */
OXL_INTERNAL const struct training_image *scene_image(oxl_context *ctx, const oxl_scene *scene, int view);
/* Returns 1 if an image is missing or damaged: left out, and reported when training comes to it. */
static inline int scene_lacks_image(oxl_result rc)
{
    return rc == OXL_ERR_INPUT || rc == OXL_ERR_IO;
}
/* Copies a view's image, on the background of scene_set_background; errors as of oxl_scene_image. */
OXL_INTERNAL oxl_result scene_copy_image(oxl_context *ctx, const oxl_scene *scene, int view, oxl_image *out);
/* Returns 1 if, with `more` unreadable images, too many of the model's images are missing. */
OXL_INTERNAL int scene_misses_too_many(const oxl_scene *scene, int more);
/* Loads the next images in parallel if the first one is not in memory. Errors are reported when an image is
 * requested. */
OXL_INTERNAL void scene_images_ahead(oxl_context *ctx, const oxl_scene *scene, const int *view, int count);
OXL_INTERNAL oxl_result scene_begin_cache(oxl_context *ctx, oxl_scene *scene, size_t count);
OXL_INTERNAL void scene_free_cache(oxl_context *ctx, const oxl_scene *scene);
/* Loads a view's image from its file at another size, with the mask that files have alone. Free it with
 * image_training_free. */
OXL_INTERNAL oxl_result scene_load_small(oxl_context *ctx, const oxl_scene *scene, int view, int width,
                                         int height, struct training_image *out);
/* Finds the file of a view's mask; *out NULL: there is none. */
OXL_INTERNAL oxl_result scene_mask_path(oxl_context *ctx, const oxl_scene *scene, int view, char **out);
/* Finds what all images of a camera show alike and masks it from now on (scene_fixed.c). */
OXL_INTERNAL oxl_result scene_find_fixed(oxl_context *ctx, oxl_scene *scene);
/* Lists the view of each image of scene_colmap, or -1 if it is not in the split. NULL: the error is
 * set. Free with oxl_free. */
OXL_INTERNAL int *scene_views_by_image(oxl_context *ctx, const oxl_scene *scene, oxl_split split);
/* Lists the views of the split in view (all views) and returns their number. */
OXL_INTERNAL int scene_views_of(const oxl_scene *scene, oxl_split split, int *view);
/* Limits the cache of decoded images; scenes from arrays keep all images. */
OXL_INTERNAL void scene_set_cache(const oxl_scene *scene, size_t bytes);
/* Returns the pixels of a view's image file, by the first image of its camera; 0: a scene from arrays. */
OXL_INTERNAL double scene_file_pixels(const oxl_scene *scene, int view);
/* Returns a quantile of the camera z of points in training views. */
OXL_INTERNAL double scene_depth_quantile(const oxl_scene *scene, double quantile);
/* Returns the ratio of the 0.9 to the 0.1 quantile of the depths; 1 without points. */
OXL_INTERNAL double scene_depth_span(const oxl_scene *scene);
/* Bounds this ratio from below: with less a medium needs more evidence (docs/UNDERWATER.md). */
#define SCENE_DEPTH_SPAN_MIN 2
/* Makes points to start from for a scene without points, at most `count`, as a function of the survey and the
 * seed (scene_start.c). Free with oxl_free. scene_start_count returns how many are useful: more with
 * composited images, which outline the scene. */
enum { SCENE_START_RANDOM = 10000, SCENE_START_HULL = 30000 };
OXL_INTERNAL size_t scene_start_count(const oxl_scene *scene);
/* Returns the most points of depth maps: few where images are composited, since an object that is cut out is
 * on few of the pixels; else SIZE_MAX. */
OXL_INTERNAL size_t scene_stereo_count(const oxl_scene *scene);
OXL_INTERNAL oxl_result scene_start_points(oxl_context *ctx, const oxl_scene *scene, size_t count,
                                           oxl_point **out, size_t *found);

/* ---------------- transparent pixels */

/* Returns 1 if images are composited over a background. scene_background returns the colour behind the scene;
 * wanted (-1,-1,-1) or NULL: white if images are composited, otherwise black. scene_set_background composites
 * images over this colour from now on. */
OXL_INTERNAL int scene_is_composited(const oxl_scene *scene);
OXL_INTERNAL void scene_background(const oxl_scene *scene, const float wanted[3], float out[3]);
OXL_INTERNAL void scene_set_background(oxl_context *ctx, const oxl_scene *scene, const float rgb[3]);
/* Says how transparent pixels of the scene's images are used now. */
OXL_INTERNAL struct image_alpha scene_alpha(const oxl_scene *scene);

#endif
