/* scene.h - views, points and images of a scene: filled by scene_make.c, scene_images.c, imaging.c;
 * formats/scene_build.c, formats/scene_views.c; large/scene_file.c. */
#ifndef OXL_SCENE_H
#define OXL_SCENE_H

#include "image.h"
#include "imaging.h"

enum { SCENE_GREY = 128 }; /* of points without colour */

struct scene_stats { /* for `check` and the first message */
    int images_listed, images_missing, unregistered, views, test_views, masks;
    size_t points, observations; /* observations: (point, image) pairs */
    double mean_track, mean_error;
    /* Gaussians that training begins with, for each point, and the share of them that it splits at once; 0:
     * not known (src/train/forecast.c) */
    double begun, splitting;
    double bounds_min[3], bounds_max[3]; /* local, 1st..99th percentile */
};

struct scene_source { /* indices in colmap.image, colmap.camera */
    size_t image, camera;
};

struct oxl_scene {
    oxl_view *view; /* (view_count) */
    int view_count;
    double origin[3], extent;

    oxl_point *point;
    size_t point_count;
    double *depth; /* (depth_count) ascending: a sample of the points' depths in the training views */
    size_t depth_count;

    struct image_cache cache; /* (view_count) */

    struct imaging imaging; /* of the model trained on this scene or read for it */
    /* (view_count) cameras as the survey has them, while imaging.pose moves those of the views; else NULL */
    oxl_camera *given;
    struct lpips *lpips; /* network of evaluations, one allocation (src/job/lpips.c), or NULL */
    oxl_result (*lpips_distance)(oxl_context *ctx, const struct lpips *net, const oxl_image *a,
                                 const oxl_image *b, double *out); /* its function */

    struct scene_stats stats;
    int from_files;
    struct colmap colmap;        /* from files: for the partition; holds the views' names */
    struct scene_source *source; /* from files: (view_count) */
    double may_miss;             /* from files: fraction of the images that may be missing or unreadable */
    double *on_disk;             /* from files: (cameras) px of an image's side for one in cameras.txt */
    char *images, *masks;        /* from files: folders; masks NULL: none */
    char *decoded;               /* folder of decoded images, or NULL */
    int transparent;             /* images with an alpha channel */
    struct image_alpha alpha;    /* what it means */
    /* of scene_file_map: it holds all arrays but those by view and by camera; or no data */
    struct os_file_map map;
};

struct scene_order { /* images by name; equal names by file order */
    const char *name;
    size_t image;
};
OXL_INTERNAL int scene_compare_order(const void *a, const void *b);
OXL_INTERNAL oxl_result scene_alloc_views(oxl_context *ctx, oxl_scene *scene, size_t count);
/* Derives extent, depths and statistics from views and points, for scenes from files and from arrays. */
OXL_INTERNAL oxl_result scene_measure(oxl_context *ctx, oxl_scene *scene);

/* ---------------- pose.c: a pose beside that of the survey's files */

struct pose {
    double at[POSE_TERMS]; /* as in struct imaging */
    double mean[POSE_TERMS],
        square[POSE_TERMS]; /* Adam's moments, for turns and moves in units of the depth */
    int visits;             /* steps */
};
struct pose_rule {
    double rate, most; /* of a step, and in all: rad, and as a fraction of the depth */
    double depth;      /* units: what a move of the centre is measured by */
    double prior;      /* pull towards the given pose: gradient for 1 rad */
};
OXL_INTERNAL int pose_is_moved(const double at[POSE_TERMS]);
/* Sets rotation and translation of *out. */
OXL_INTERNAL void pose_apply(const oxl_camera *given, const double at[POSE_TERMS], oxl_camera *out);
/* Gives the views the poses of scene->imaging, or without any those of the survey. */
OXL_INTERNAL oxl_result scene_set_poses(oxl_context *ctx, oxl_scene *scene);
/* Steps along dL/d(pose) as renderer_pose_gradient gives it. */
OXL_INTERNAL void pose_step(struct pose *p, const oxl_camera *given, const double world[POSE_TERMS],
                            const struct pose_rule *rule);

/* ---------------- scene.c, scene_make.c, scene_images.c: views, points, images */

OXL_INTERNAL const struct colmap *scene_colmap(const oxl_scene *scene); /* NULL for scenes from arrays */
/* Projects a point of scene_colmap by camera_project; 0 also where it is far outside the image. */
OXL_INTERNAL int scene_project_point(const oxl_scene *scene, int view, size_t point, double x[3],
                                     double pixel[2]);
/* Returns the row of `colmap` that a view comes from; scenes from files only. */
OXL_INTERNAL const struct colmap_camera *scene_source_camera(const oxl_scene *scene, int view);
OXL_INTERNAL const struct colmap_image *scene_source_image(const oxl_scene *scene, int view);
/* Returns a view's image from the cache, loaded if it is not there: borrowed until the next request of
 * another view; NULL: error set. */
OXL_INTERNAL const struct training_image *scene_image(oxl_context *ctx, oxl_scene *scene, int view);
/* Returns 1 if with `more` images that cannot be read, too large a fraction of those in the model is
 * missing. */
OXL_INTERNAL int scene_misses_too_many(const oxl_scene *scene, int more);
/* Loads the next images, as image_cache_ahead. */
OXL_INTERNAL void scene_images_ahead(oxl_context *ctx, oxl_scene *scene, const int *view, int count);
OXL_INTERNAL oxl_result scene_begin_cache(oxl_context *ctx, oxl_scene *scene, size_t count);
/* Loads the same from its file, undistorted, reduced and masked (image_training_free). */
OXL_INTERNAL oxl_result scene_load_image(oxl_context *ctx, const oxl_scene *scene, int view,
                                         struct training_image *out);
/* Finds the mask of a view; NULL: none. */
OXL_INTERNAL oxl_result scene_mask_path(oxl_context *ctx, const oxl_scene *scene, int view, char **out);
/* Lists for each image of scene_colmap its view, or -1 where that is not in the split. NULL: error set. Free
 * with oxl_free. */
OXL_INTERNAL int *scene_views_by_image(oxl_context *ctx, const oxl_scene *scene, oxl_split split);
/* Lists the views of the split in view (all views); returns their number. */
OXL_INTERNAL int scene_views_of(const oxl_scene *scene, oxl_split split, int *view);
/* Limits the cache of decoded images; scenes from arrays keep all. */
OXL_INTERNAL void scene_set_cache(oxl_scene *scene, size_t bytes);
/* Counts the pixels of its camera's first image; 0: from arrays. */
OXL_INTERNAL double scene_file_pixels(const oxl_scene *scene, int view);
/* Returns a quantile of the camera z of points in training views. */
OXL_INTERNAL double scene_depth_quantile(const oxl_scene *scene, double quantile);
/* Returns the ratio of the depths' 0.9 to their 0.1 quantile; 1 without points. */
OXL_INTERNAL double scene_depth_span(const oxl_scene *scene);
/* Below this ratio a medium is not identifiable, and `auto` is off (docs/IMAGING.md). */
#define SCENE_DEPTH_SPAN_MIN 2
/* Keeps decoded training images in files of this folder, which are then read instead of the originals; NULL:
 * off. */
OXL_INTERNAL oxl_result scene_set_decoded(oxl_context *ctx, oxl_scene *scene, const char *folder);
/* scene_start.c: for a scene without points, those to start from, at most `count`, a function of the survey
 * and the seed. Free with oxl_free. scene_start_count: how many are useful; composited images outline the
 * scene. */
enum { SCENE_START_RANDOM = 10000, SCENE_START_HULL = 30000 };
OXL_INTERNAL size_t scene_start_count(const oxl_scene *scene);
OXL_INTERNAL oxl_result scene_start_points(oxl_context *ctx, oxl_scene *scene, size_t count, oxl_point **out,
                                           size_t *found);
#endif
