/* survey.h - a survey: COLMAP files, cameras, images and their cache, the scene, statistics. */
#ifndef OXL_SURVEY_H
#define OXL_SURVEY_H

#include "../core/core.h"
#include "../../oceanxl_job.h" /* oxl_survey */

/* ---------------------------------------------------------------- colmap.c: the files of a COLMAP model, as they are */

enum { CAMERA_PARAMETERS = 16 }; /* of the camera model with the most */

struct colmap_camera {
    int64_t     id;
    int         model; /* index in camera.c's table */
    int         width, height;
    int         parameter_count;
    double      parameter[CAMERA_PARAMETERS];
    const char *file; /* source for messages: file without folder; line, or record of a binary file */
    int         line;
};

struct colmap_image {
    int64_t  id;
    double   rotation[4]; /* w x y z as read */
    double   translation[3];
    int64_t  camera_id;
    size_t   name;        /* offset in colmap.names */
    uint64_t points_at;   /* offset of its 2D points in the file of images, text or binary; exports copy them */
    size_t   points_size; /* bytes; 0: none */
    int      line;
};

struct colmap_track {   /* one (IMAGE_ID, POINT2D_IDX); compact: a large survey has 10^8 */
    uint32_t image_row; /* in colmap.image */
    uint32_t observation;
};

struct colmap_point {
    int64_t  id;
    double   position[3]; /* world */
    double   error;       /* px; -1: unknown */
    uint8_t  rgb[3];
    uint32_t track_count;
    size_t   first_track; /* in colmap.track */
};

enum colmap_format {
    COLMAP_TEXT,
    COLMAP_BINARY,
    COLMAP_JSON /* transforms.json, reconstruction.json: no 2D points, no tracks */
};

struct colmap {
    struct colmap_camera *camera;
    size_t                camera_count;
    struct colmap_image  *image; /* in the file's order */
    size_t                image_count;
    struct colmap_point  *point; /* by id */
    size_t                point_count;
    struct colmap_track  *track;
    size_t                track_count;
    char                 *folder;
    char                 *names; /* zero-terminated, one after the other */
    size_t                names_size;
    size_t                warnings;      /* deviations that were logged and corrected */
    int                   is_truncated;  /* a file has fewer rows than its header states */
    int                   images_beside; /* names are relative to `folder`, not to the image folder */
    enum colmap_format    format;
    const char           *images_file; /* "images.txt", without the folder: for messages, and for exports */
};

/* Reads a model, .txt or .bin, the newer if both exist; invariants: colmap.c. 2D points are not read. */
OXL_INTERNAL oxl_result colmap_read(oxl_context *ctx, const char *folder, struct colmap *out);
/* The same with another buffer size in bytes, for tests. */
OXL_INTERNAL oxl_result colmap_read_buffered(oxl_context *ctx, const char *folder, size_t buffer, struct colmap *out);
/* colmap_order.c: sorts cameras and images by id; points, which the readers sort. Tracks are not moved.
 * OXL_ERR_INPUT without a message: two points have the id *repeated. */
OXL_INTERNAL oxl_result colmap_order(oxl_context *ctx, struct colmap *c);
OXL_INTERNAL const struct colmap_camera *colmap_find_camera(const struct colmap *c, int64_t id); /* in order; NULL: none */
OXL_INTERNAL oxl_result                  colmap_order_points(oxl_context *ctx, struct colmap *c, int64_t *repeated);
OXL_INTERNAL void                        colmap_free(oxl_context *ctx, struct colmap *c);
/* survey_files.c: a survey of nerfstudio (transforms.json) or OpenSfM (any other name) in a folder. */
OXL_INTERNAL oxl_result json_survey_read(oxl_context *ctx, const char *folder, const char *name, struct colmap *out);

/* ---------------------------------------------------------------- camera.c: camera models, undistortion */

enum camera_kind {
    CAMERA_IDEAL,
    CAMERA_RADIAL,
    CAMERA_OPENCV,
    CAMERA_FULL_OPENCV,
    CAMERA_FISHEYE,
    CAMERA_FOV,
    CAMERA_THIN_PRISM,
    CAMERA_RAD_TAN_THIN_PRISM,
    CAMERA_DIVISION,
    CAMERA_EUCM,
    CAMERA_SPHERE /* the whole sphere: no pinhole camera covers it */
};

struct camera_model {
    const char      *name;
    int              parameter_count; /* focal lengths, cx, cy, then the distortion */
    int              focal_count;     /* 1: f; 2: fx, fy */
    enum camera_kind kind;
};
OXL_INTERNAL int camera_model_find(const char *name, size_t length); /* -1: unknown; else COLMAP's MODEL_ID */
OXL_INTERNAL int camera_model_count(void);
OXL_INTERNAL const struct camera_model *camera_model_at(int index);
OXL_INTERNAL const char                *camera_model_list(void); /* "SIMPLE_PINHOLE, PINHOLE, ..." for messages */

/* fx, fy, cx, cy in px, for any model. */
OXL_INTERNAL void camera_intrinsics(const struct colmap_camera *camera, double out[4]);

/* Forward model: a direction (x/z, y/z) of the ideal camera to a pixel of the real one. */
OXL_INTERNAL void camera_distort(const struct colmap_camera *camera, const double direction[2], double pixel[2]);
OXL_INTERNAL int  camera_is_distorted(const struct colmap_camera *camera);

/* The pinhole camera inside the field of view of the real one (no blank pixels), same focal length, before --max-side. */
OXL_INTERNAL oxl_result camera_undistorted(oxl_context *ctx, const struct colmap_camera *camera, oxl_camera *out);

/* The same view at half the sides, rounded down. */
OXL_INTERNAL oxl_camera camera_halve(const oxl_camera *camera);

OXL_INTERNAL void camera_rotation_from_quaternion(const double q[4], double r[9]); /* normalises */
OXL_INTERNAL void camera_position(const oxl_camera *camera, double out[3]);        /* -R^T t */
/* A point of the world in the camera's axes, x (3). origin: of the scene's frame; NULL: the point is in that frame. */
OXL_INTERNAL void camera_transform(const oxl_camera *camera, const double world[3], const double origin[3], double x[3]);
/* The same, and in px of the image; 0: it is behind the camera. */
OXL_INTERNAL int  camera_project(const oxl_camera *camera, const double world[3], const double origin[3], double x[3],
                                 double pixel[2]);
/* The point of the world that a pixel shows at camera z. */
OXL_INTERNAL void camera_unproject(const oxl_camera *camera, const double pixel[2], double z, const double origin[3],
                                   double world[3]);

/* ---------------------------------------------------------------- image.c: decode, reduce, undistort, mask, cache */

struct pixels { /* 8 bits, interleaved as stb gives them */
    int      width, height;
    uint8_t *data;
};
OXL_INTERNAL oxl_result image_decode(oxl_context *ctx, const char *path, int channels, struct pixels *out);
OXL_INTERNAL oxl_result image_size(oxl_context *ctx, const char *path, int *width, int *height); /* reads the header only */
/* Fails unless the file's size is the camera's, reduced or enlarged: not cropped or rotated. */
OXL_INTERNAL oxl_result image_check_shape(oxl_context *ctx, const char *path, int width, int height,
                                          const struct colmap_camera *from);
OXL_INTERNAL void       image_pixels_free(oxl_context *ctx, struct pixels *p);

/* A training image: planar 8-bit (3,H,W), and its mask (H,W) or NULL (255 used, 0 masked). */
struct training_image {
    int      width, height;
    uint8_t *rgb;
    uint8_t *mask;
};
/* Decodes, undistorts (when `from` is distorted) and reduces by area averaging to `to`'s size, masks alike. mask_path may be NULL. */
OXL_INTERNAL oxl_result image_load_training(oxl_context *ctx, const char *path, const char *mask_path,
                                            const struct colmap_camera *from, const oxl_camera *to, struct training_image *out);
OXL_INTERNAL void       image_training_free(oxl_context *ctx, struct training_image *image);
struct image_window { /* a part of an image, px; width 0: nothing of it */
    int x, y, width, height;
};
/* rgb (3,h,w), weight (h,w) or NULL: of the window, or of the whole image with NULL. */
OXL_INTERNAL void image_from_training(const oxl_context *ctx, const struct training_image *image,
                                      const struct image_window *window, float *rgb, float *weight);
/* weight may be NULL, above too. To half the sides in place: means of 2 x 2 pixels, masked if one is; odd edges are dropped. */
OXL_INTERNAL void image_halve(int width, int height, float *rgb, float *weight);
/* The inverse, into allocated memory of `to`; weights up to 0.5 are masked. */
OXL_INTERNAL void image_to_training(const oxl_image *image, struct training_image *to);

OXL_INTERNAL void       image_begin(void); /* sets stb's PNG parameters */
/* stb's codec: inflates raw deflate data to exactly `size` bytes, else 0; deflates with free bytes around (*out by oxl_alloc). */
OXL_INTERNAL int        image_inflate(void *out, size_t size, const void *data, size_t data_size);
OXL_INTERNAL oxl_result image_deflate(oxl_context *ctx, const void *data, size_t size, size_t before, size_t after,
                                      unsigned char **out, size_t *deflated);
OXL_INTERNAL oxl_result image_write_png16(oxl_context *ctx, const char *path, const uint16_t *grey, int width, int height);

/* ---------------------------------------------------------------- survey_files.c: where a survey's files are */

/* Reads the sub-model with most images of `sparse`, or of SCENE/sparse, its folders, and SCENE. Observations are not kept. */
OXL_INTERNAL oxl_result survey_find_model(oxl_context *ctx, const char *path, const char *sparse, struct colmap *out);
/* Path of a file, at most 3 folders deep, whose name equals `name` except for folder, extension and case; "": none. */
OXL_INTERNAL void       survey_find_like(oxl_context *ctx, const char *folder, const char *name, char *out, size_t size);

/* ---------------------------------------------------------------- robust_stats.c: robust measures of a survey */

struct stats_view {              /* a training view */
    uint32_t          image_row; /* in colmap.image, for tracks */
    const oxl_camera *camera;
};
OXL_INTERNAL double stats_quantile(const double *ascending, size_t count, double quantile); /* nearest rank; 0 without values */
OXL_INTERNAL double stats_select(double *value, size_t count, double quantile); /* of unsorted values, which it reorders */
/* Standard deviation without regard to outliers, from the median absolute deviation. work (count). */
OXL_INTERNAL double stats_spread(const double *value, size_t count, double *work, double *median);
/* 1st, 50th and 99th percentile of each coordinate of n positions, `stride` bytes apart. */
OXL_INTERNAL oxl_result stats_bounds(oxl_context *ctx, const double *position, size_t n, size_t stride, double low[3],
                                     double middle[3], double high[3]);
/* Largest distance from the mean of the camera centres, without those beyond 5 median distances; 0 for one camera. */
OXL_INTERNAL oxl_result stats_camera_radius(oxl_context *ctx, const struct stats_view *views, size_t count, double *radius);
struct stats_points {
    const oxl_point     *point; /* (count) local */
    size_t               count;
    const struct colmap *colmap; /* points with their tracks; local = position - origin */
    const double        *origin;
};
/* Ascending sample of the camera z of points in the views of their tracks; without tracks, in all images. Sorts views by image. */
OXL_INTERNAL oxl_result stats_depths(oxl_context *ctx, struct stats_view *views, size_t count, const struct stats_points *points,
                                     double **out, size_t *out_count);

/* ---------------------------------------------------------------- scene.c, scene_load.c, scene_images.c: views, points, images */

struct scene_stats { /* for `check` and the first message */
    int    images_listed, images_missing, views, test_views, distorted_cameras, masks;
    size_t points, observations; /* observations: (point, image) pairs */
    double mean_track, mean_error;
    double bounds_min[3], bounds_max[3]; /* local, 1st..99th percentile */
};
OXL_INTERNAL const struct colmap *scene_colmap(const oxl_scene *scene); /* NULL for scenes from arrays */
/* A point of scene_colmap by camera_project; 0 also where it is far outside the image. */
OXL_INTERNAL int scene_project_point(const oxl_scene *scene, int view, size_t point, double x[3], double pixel[2]);
/* The row of `colmap` that a view comes from; scenes from files only. */
OXL_INTERNAL const struct colmap_camera  *scene_source_camera(const oxl_scene *scene, int view);
OXL_INTERNAL const struct colmap_image   *scene_source_image(const oxl_scene *scene, int view);
/* A view's image from the cache, loaded if it is not there: borrowed until the next request of another view; NULL: error set. */
OXL_INTERNAL const struct training_image *scene_image(oxl_context *ctx, oxl_scene *scene, int view);
OXL_INTERNAL void scene_images_ahead(oxl_context *ctx, oxl_scene *scene, const int *view, int count); /* image_cache_ahead */
OXL_INTERNAL oxl_result scene_begin_cache(oxl_context *ctx, oxl_scene *scene, size_t count);
/* The same from its file, undistorted, reduced and masked (image_training_free). */
OXL_INTERNAL oxl_result scene_load_image(oxl_context *ctx, const oxl_scene *scene, int view, struct training_image *out);
OXL_INTERNAL oxl_result scene_mask_path(oxl_context *ctx, const oxl_scene *scene, const char *name, char **out); /* NULL: none */
OXL_INTERNAL int        scene_accepts_point(const struct colmap_point *point, const double origin[3]); /* 0: too far away */
/* For each image of scene_colmap its view, or -1 where that is not in the split. NULL: error set. Free with oxl_free. */
OXL_INTERNAL int       *scene_views_by_image(oxl_context *ctx, const oxl_scene *scene, oxl_split split);
OXL_INTERNAL int  scene_views_of(const oxl_scene *scene, oxl_split split, int *view); /* view (all views); returns their number */
OXL_INTERNAL void scene_set_cache(oxl_scene *scene, size_t bytes);           /* of decoded images; scenes from arrays keep all */
OXL_INTERNAL double     scene_file_pixels(const oxl_scene *scene, int view); /* of its camera's first image; 0: from arrays */
OXL_INTERNAL double     scene_depth_quantile(const oxl_scene *scene, double quantile); /* camera z of points in training views */
OXL_INTERNAL double     scene_near_plane(const oxl_scene *scene); /* from the depths, since COLMAP's scale is arbitrary */
/* Keeps decoded training images in files of this folder, which are then read instead of the originals; NULL: off. */
OXL_INTERNAL oxl_result scene_set_decoded(oxl_context *ctx, oxl_scene *scene, const char *folder);
/* For a scene without points: points in front of the cameras, a function of the seed. Free with oxl_free. */
OXL_INTERNAL oxl_result scene_random_points(oxl_context *ctx, const oxl_scene *scene, size_t count, oxl_point **out);
/* scene_file.c: writes the scene to a file and maps it again; *out is NULL if the file has another key or does not exist. */
OXL_INTERNAL oxl_result scene_file_write(oxl_context *ctx, const char *path, const oxl_scene *scene, const char *key);
OXL_INTERNAL oxl_result scene_file_map(oxl_context *ctx, const char *path, const char *key, oxl_scene **out);

/* ---------------------------------------------------------------- image_cache.c: which images are in memory (image_cache.h) */

/* Upper bound of the memory for images of `pixels` in total, without masks, with decoding of files of file_pixels. */
OXL_INTERNAL double image_cache_bytes(double cache, double pixels, double file_pixels);

/* ---------------------------------------------------------------- image_file.c: decoded images in files */

OXL_INTERNAL uint64_t image_file_key(const char *path, const char *mask, const struct colmap_camera *from, const oxl_camera *to);
OXL_INTERNAL int      image_file_read(oxl_context *ctx, const char *path, uint64_t key, const oxl_camera *to,
                                      struct training_image *out); /* 1: it exists and is complete */
OXL_INTERNAL oxl_result image_file_write(oxl_context *ctx, const char *path, uint64_t key, const struct training_image *image);

/* ---------------------------------------------------------------- depth_bands.c: near, mid or far, pixel by pixel */

struct depth_sample { /* an observation */
    int   view, pixel;
    float z; /* camera z */
};
struct depth_bands {
    double               depth[2]; /* terciles of the depths of all training observations */
    struct depth_sample *sample;   /* (count) by view and pixel, the nearer first */
    size_t               count;
};
/* Samples the observations of the `count` requested views. */
OXL_INTERNAL oxl_result depth_bands_begin(oxl_context *ctx, const oxl_scene *scene, const int *requested, int count,
                                          struct depth_bands *out);
OXL_INTERNAL void       depth_bands_free(oxl_context *ctx, struct depth_bands *b);
/* band: (H,W) 1 near, 2 mid, 3 far; 0: no point nearby. */
OXL_INTERNAL oxl_result depth_bands_of_view(oxl_context *ctx, const struct depth_bands *b, const oxl_scene *scene, int view,
                                            uint8_t *band);

/* ---------------------------------------------------------------- contrast.c: how fast contrast fades with depth */

struct contrast {
    int    measured;    /* 0: too few points observed from several depths */
    double beta, error; /* contrast is proportional to exp(-beta z), per unit of the scene; the standard error of beta */
    size_t points, observations;
};
OXL_INTERNAL oxl_result contrast_measure(oxl_context *ctx, oxl_scene *scene, struct contrast *out);

/* ---------------------------------------------------------------- lint.c: contradictions between readable files */

#define LINT_MISSED_SURVEY 0.1 /* fraction of observations outside their image from which the whole survey is reported */
/* Sets s->missed; s->unusable and s->masked. Findings are logged. OXL_ERR_INPUT: no image can be used. */
OXL_INTERNAL oxl_result lint_observations(oxl_context *ctx, const oxl_scene *scene, oxl_survey *s);
OXL_INTERNAL oxl_result lint_images(oxl_context *ctx, const oxl_scene *scene, oxl_survey *s);
OXL_INTERNAL oxl_result lint_masks(oxl_context *ctx, const oxl_scene *scene); /* compares sizes, from the files' headers */

/* ---------------------------------------------------------------- quality.c: images that differ from those taken next to them */

enum { QUALITY_NEIGHBOURS = 8 };
#define QUALITY_BLUR 0.6 /* an image below this fraction of its neighbours' sharpness is blurred */
/* The indices, among `count` views, of the cameras nearest to `of` that look the same way, nearest first; returns their number. */
OXL_INTERNAL int        quality_nearest(const oxl_scene *scene, const int *view, int count, int of, int out[QUALITY_NEIGHBOURS]);
/* Mean absolute second difference of the green channel along the axis where it is less (motion blurs one), over the mean:
 * sharpness, whatever the exposure. fine: the same over that of differences over 2 px, which blur lowers and a plain surface does
 * not; or NULL. */
OXL_INTERNAL double     quality_sharpness(const struct training_image *image, double *fine);
/* Decodes every image; logs and counts blurred and badly exposed ones. */
OXL_INTERNAL oxl_result quality_check(oxl_context *ctx, oxl_scene *scene, oxl_survey *s);

#include "image_cache.h"
#include "imaging.h"
#include "scene.h"

#endif
