/* scene.h - the struct of a scene, filled by scene.c, scene_views.c and scene_file.c; other modules only read it. */
#ifndef OXL_SCENE_H
#define OXL_SCENE_H

#include "survey.h"

enum { SCENE_GREY = 128 };  /* of points without colour */
#define SCENE_FARTHEST 1e15 /* farther points are dropped, farther cameras an error */

struct scene_source { /* indices in colmap.image, colmap.camera */
    size_t image, camera;
};

struct oxl_scene {
    oxl_view *view; /* (view_count) */
    int       view_count;
    double    origin[3], extent;

    oxl_point *point;
    size_t     point_count;
    double    *depth; /* (depth_count) ascending: a sample of the points' depths in the training views */
    size_t     depth_count;

    struct image_cache cache; /* (view_count) */

    struct imaging imaging; /* of the model trained on this scene or read for it */

    struct scene_stats   stats;
    int                  from_files;
    struct colmap        colmap;         /* from files: for the partition; holds the views' names */
    struct scene_source *source;         /* from files: (view_count) */
    double              *on_disk;        /* from files: (cameras) px of an image's side for one in cameras.txt */
    char                *images, *masks; /* from files: folders; masks NULL: none */
    char                *decoded;        /* folder of decoded images, or NULL */
    struct os_file_map   map;            /* of scene_file_map: it holds all arrays but views and cameras; or no data */
};

struct scene_order { /* images by name; equal names by file order */
    const char *name;
    size_t      image;
};
OXL_INTERNAL int        scene_compare_order(const void *a, const void *b);
OXL_INTERNAL oxl_result scene_alloc_views(oxl_context *ctx, oxl_scene *scene, size_t count);
/* From scene->colmap. */
OXL_INTERNAL oxl_result scene_build_views(oxl_context *ctx, oxl_scene *scene, const oxl_scene_options *options);
OXL_INTERNAL void       scene_mark_test_views(oxl_scene *scene, int test_every);

#endif
