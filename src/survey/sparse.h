/* sparse.h - declares cameras, images, points and tracks of a survey, as its files have
 * them, and camera models. */
#ifndef OXL_SPARSE_H
#define OXL_SPARSE_H

#include "../core/core.h"

/* ---------------- the rows of a COLMAP model, as its files have them */

enum { CAMERA_PARAMETERS = 16 }; /* parameters of the camera model with the most */

struct colmap_camera {
    int64_t id;
    int model; /* index in camera.c's table */
    int width, height;
    int parameter_count;
    double parameter[CAMERA_PARAMETERS];
    const char *file; /* file without folder, for messages; its line, or record of a binary file */
    int line;
};

/* Names the split that the survey's files state. */
enum colmap_split { COLMAP_UNSPLIT, COLMAP_TRAIN, COLMAP_TEST };

struct colmap_image {
    int64_t id;
    double rotation[4]; /* w x y z, not normalised */
    double translation[3];
    int64_t camera_id;
    size_t name; /* offset in colmap.names */
    size_t mask; /* offset of the mask's name, a path from colmap.folder; 0: the files name none */
    int line;
    enum colmap_split split;
    double range[2]; /* nearest and farthest depth of what it shows, where the files state it; 0 0: unknown */
};

struct colmap_track {   /* Holds one (IMAGE_ID, POINT2D_IDX), compact, since a large survey has 10^8. */
    uint32_t image_row; /* row in colmap.image */
    uint32_t observation;
};

struct colmap_point {
    int64_t id;
    double position[3]; /* world coordinates */
    double error;       /* px; -1: unknown */
    uint8_t rgb[3];
    uint32_t track_count;
    size_t first_track; /* row in colmap.track */
};

enum colmap_format {
    COLMAP_TEXT,
    COLMAP_BINARY,
    COLMAP_JSON /* transforms.json, reconstruction.json: no 2D points, no tracks */
};

struct colmap {
    struct colmap_camera *camera;
    size_t camera_count;
    struct colmap_image *image; /* by id */
    size_t image_count;
    struct colmap_point *point; /* by id */
    size_t point_count;
    struct colmap_track *track;
    size_t track_count;
    char *folder;
    char *names; /* zero-terminated, one after the other */
    size_t names_size;
    size_t warnings;  /* number of deviations that were logged and corrected */
    int is_truncated; /* a file has fewer rows than its header states */
    char *images;     /* folder in which names start; NULL: images/ of the survey */
    /* degrees; latitude and longitude of the world's origin, if x is east, y north,
     * z up and the unit metres */
    double reference[2];
    int has_reference;
    int states_split; /* 1: each image's split is COLMAP_TRAIN or COLMAP_TEST */
    enum colmap_format format;
    const char *images_file; /* "images.txt" without the folder, for messages and exports */
};

OXL_INTERNAL void colmap_free(oxl_context *ctx, struct colmap *c); /* in scene_make.c */

/* ---------------- camera.c: camera models, undistortion */

enum camera_kind {
    CAMERA_POLYNOMIAL, /* k1 k2 p1 p2 k3 to k6, of which the last ones may be missing */
    CAMERA_FISHEYE,
    CAMERA_FOV,
    CAMERA_THIN_PRISM,
    CAMERA_RAD_TAN_THIN_PRISM,
    CAMERA_DIVISION,
    CAMERA_EUCM,
    CAMERA_SPHERE /* the whole sphere: no pinhole camera covers it */
};

struct camera_model {
    const char *name;
    int parameter_count; /* focal lengths, cx, cy, then the distortion */
    int focal_count;     /* 0: none; 1: f; 2: fx, fy */
    enum camera_kind kind;
};
OXL_INTERNAL int camera_model_find(const char *name, size_t length); /* COLMAP's MODEL_ID; -1: unknown */
OXL_INTERNAL const struct camera_model *camera_model_at(int index); /* NULL: COLMAP has no model of this id */
OXL_INTERNAL const char *camera_model_list(void); /* "SIMPLE_PINHOLE, PINHOLE, ..." for messages */

/* Returns fx, fy, cx, cy in px, for any model. */
OXL_INTERNAL void camera_intrinsics(const struct colmap_camera *camera, double out[4]);

/* Maps a direction (x/z, y/z) of the ideal camera to a pixel of the real one. */
OXL_INTERNAL void camera_distort(const struct colmap_camera *camera, const double direction[2],
                                 double pixel[2]);
OXL_INTERNAL int camera_is_distorted(const struct colmap_camera *camera);

/* Returns the same camera at half the sides, rounded down. */
OXL_INTERNAL oxl_camera camera_halve(const oxl_camera *camera);

OXL_INTERNAL void camera_rotation_from_quaternion(const double q[4], double r[9]); /* normalises q */
OXL_INTERNAL int camera_is_rotation(const double r[9]); /* 1: finite, orthonormal and right-handed */
OXL_INTERNAL int camera_has_pose(
    const oxl_camera *camera); /* 1: such a rotation, and no place too far away */
OXL_INTERNAL void camera_position(const oxl_camera *camera, double out[3]);    /* -R^T t */
OXL_INTERNAL double camera_apart(const double a[3], const double b[3]);        /* distance of two places */
OXL_INTERNAL double camera_distance(const oxl_camera *a, const oxl_camera *b); /* of their centres */
/* Transforms a point to the camera's axes, x (3). origin: origin of the scene's frame; NULL:
 * the point is in that frame. */
OXL_INTERNAL void camera_transform(const oxl_camera *camera, const double world[3], const double origin[3],
                                   double x[3]);
/* Transforms a point as camera_transform and projects it to px of the image; returns 0 if
 * it is behind the camera. */
OXL_INTERNAL int camera_project(const oxl_camera *camera, const double world[3], const double origin[3],
                                double x[3], double pixel[2]);
/* Projects a place of the scene; returns 1 if it is in the image. */
OXL_INTERNAL int camera_sees(const oxl_camera *camera, const double place[3], double x[3], double pixel[2]);
/* Returns the point of the world that a pixel shows at camera z. */
OXL_INTERNAL void camera_unproject(const oxl_camera *camera, const double pixel[2], double z,
                                   double world[3]);

#endif
