/* survey_read.h - declares what turns the rows of a survey's files into a scene, whatever their format. */
#ifndef OXL_SURVEY_READ_H
#define OXL_SURVEY_READ_H

#include "../survey/sparse.h"

/* ---------------- colmap_order.c: rows by id */

/* Sorts cameras and images by id, and renumbers the images of the tracks. */
OXL_INTERNAL oxl_result colmap_order(oxl_context *ctx, struct colmap *c);
/* Finds a camera after colmap_order; NULL: there is none. */
OXL_INTERNAL const struct colmap_camera *colmap_find_camera(const struct colmap *c, int64_t id);
/* Sorts points by id; OXL_ERR_INPUT without a message: two points have the id *repeated. */
OXL_INTERNAL oxl_result colmap_order_points(oxl_context *ctx, struct colmap *c, int64_t *repeated);
/* Returns 1 for a relative path without "..", up to `end`. */
OXL_INTERNAL int colmap_name_is_safe(const char *name, const char *end);

/* ---------------- survey_files.c: image files of a survey */

/* Finds a file, at most 3 folders deep, whose name equals `name` except for folder, extension and
 * case; out "": there is none. */
OXL_INTERNAL void survey_find_like(oxl_context *ctx, const char *folder, const char *name, char *out,
                                   size_t size);

/* Counts the images in the image folder, and the folders in it, that the model does not have. */
OXL_INTERNAL int survey_count_unregistered(oxl_context *ctx, const oxl_scene *scene);

/* ---------------- ideal_camera.c */

/* Finds the pinhole camera inside the field of view of the real one (no blank pixels), with the same focal
 * length, before --max-side. */
OXL_INTERNAL oxl_result camera_undistorted(oxl_context *ctx, const struct colmap_camera *camera,
                                           oxl_camera *out);

/* ---------------- scene_build.c, scene_views.c, survey_alpha.c: the scene */

/* Makes the views from scene->colmap (scene_views.c). */
OXL_INTERNAL oxl_result scene_build_views(oxl_context *ctx, oxl_scene *scene,
                                          const oxl_scene_options *options);
/* Builds a scene from scene->colmap and its folders: views, points around the origin, statistics. */
OXL_INTERNAL oxl_result scene_build(oxl_context *ctx, oxl_scene *scene, const oxl_scene_options *options);
/* Holds out the views that the survey states, or every test_every-th (-1: every 8th); OXL_ERR_USAGE: the
 * survey states views and test_every is given. */
OXL_INTERNAL oxl_result scene_mark_test_views(oxl_context *ctx, oxl_scene *scene, int test_every);
/* Counts images with alpha and sets scene->alpha. */
OXL_INTERNAL oxl_result scene_decide_alpha(oxl_context *ctx, oxl_scene *scene, oxl_alpha option);

#endif
