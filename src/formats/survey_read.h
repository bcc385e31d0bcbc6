/* survey_read.h - declares what turns the rows of a survey's files into a scene, whatever their format. */
#ifndef OXL_SURVEY_READ_H
#define OXL_SURVEY_READ_H

#include "../survey/imaging.h"
#include "../survey/sparse.h"

/* Makes the path of a file in the folder of another. */
#define PATH_BESIDE(path, name) PATH("", "%.*s%s", (int)(path_base_name(path) - (path)), path, name)

/* Paths beside a survey's files; NULL: as the files have it. */
struct survey_given {
    const char *images; /* folder in which names start */
    const char *folder; /* the same, or SCENE/images: of two models, its files decide */
    const char *points; /* file of the points */
};

/* ---------------- colmap.c */

/* Finds a camera; NULL: there is none. */
OXL_INTERNAL const struct colmap_camera *colmap_find_camera(const struct colmap *c, int64_t id);
/* Copies a name as a path that stays inside its folder: without drives, "..", leading slashes. Returns its
 * length; 0: nothing is left. out: at least the name's length. */
OXL_INTERNAL size_t colmap_safe_name(const char *name, size_t length, char *out);

struct scene_order;
/* Returns 1 if the images of both, row by row or a's in this order (NULL: as they are), have the same
 * places. */
OXL_INTERNAL int colmap_has_places(const struct colmap *a, const struct scene_order *order,
                                   const struct colmap *b);

/* ---------------- survey_files.c: image files of a survey */

OXL_INTERNAL int survey_is_image_name(const char *name); /* 1: it ends as those of JPEG and PNG files do */
/* Gives images that are not there under their names the names of the files whose paths end alike, and counts
 * the files that the model does not have. */
OXL_INTERNAL oxl_result survey_match_names(oxl_context *ctx, oxl_scene *scene);

/* ---------------- ideal_camera.c */

OXL_INTERNAL double camera_atan(double x); /* of survey/camera.c; for x >= 0, to about 1e-15 */
/* Returns 1 for a focal length, px, of 0.2 to 20 times the longer side: a lens of 136 to 3 degrees. */
OXL_INTERNAL int camera_focal_is_plausible(double focal, double width, double height);
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
 * survey states views and test_every is given. looks 1: copies of an image stay on its side. */
OXL_INTERNAL oxl_result scene_mark_test_views(oxl_context *ctx, oxl_scene *scene, int test_every, int looks);
/* Finds images that are copies of others (scene_twins.c), and says so. of: (views) gets the first image that
 * each shows, in most cases its own index. */
OXL_INTERNAL oxl_result scene_find_twins(oxl_context *ctx, oxl_scene *scene, int *of);
/* Counts images with alpha and sets scene->alpha. */
OXL_INTERNAL oxl_result scene_decide_alpha(oxl_context *ctx, oxl_scene *scene, oxl_alpha option);

#endif
