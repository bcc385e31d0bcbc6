/* synth.h - the interface between the files of the synthetic survey.
 *
 *     synth.c         options, images through water, truth: the run
 *     synth_world.c   the geometry: seabed, rocks, corals, starfish, as one distance function
 *     synth_shade.c   rays, light and colour
 *     synth_trajectory.c    where the camera flies
 *     synth_light.c   exposure that drifts, a lamp that moves with the camera
 *     synth_points.c  sparse points with tracks
 *     synth_export.c  the text files
 *
 * Frame: x east, y north, z up, metres, zero in the middle of the survey; options.origin is added at export.
 */
#ifndef SYNTH_H
#define SYNTH_H

#include "synth_math.h"
#include "lab.h"

#include <stddef.h>

#define SYNTH_FAR 40.0 /* metres: beyond this there is only water */

/* ---------------- synth_world.c */

enum synth_material {
    SYNTH_SAND,
    SYNTH_ROCK,
    SYNTH_PEBBLE,
    SYNTH_BRAIN_CORAL,
    SYNTH_BRANCH_CORAL,
    SYNTH_STARFISH
};

struct synth_limb { /* a cone with round ends */
    v3 a, axis;     /* from one end to the other */
    double radius_a, radius_b;
    double per_square; /* 1 / |axis|^2 */
};

struct synth_shape { /* a smooth union of limbs, within the unit sphere */
    int limb_count;
    struct synth_limb limb[26];
    double blend; /* width of the smooth minimum */
};

struct synth_object {
    v3 centre;
    double radius; /* of the sphere that holds it */
    double yaw_cos, yaw_sin;
    v3 axes; /* half axes of stones, metres */
    enum synth_material material;
    int shape; /* index in synth_world.shape, or SYNTH_STONE */
    uint32_t seed;
};
enum { SYNTH_STONE = -1, SYNTH_SHAPES = 6 };

struct synth_near { /* an object's sphere, side by side with its neighbours' in memory */
    float x, y, z, radius;
    uint32_t object;
};

struct synth_world {
    uint32_t seed;
    double sand_contrast; /* of options */
    double top;           /* maximum height, metres */
    v3 sun;               /* unit, towards it */

    double half, step; /* the world is a square, |x|, |y| <= half; spacing of the baked heights; metres */
    int side;          /* samples */
    float *height;     /* (side,side) metres */

    struct synth_shape shape[SYNTH_SHAPES];
    struct synth_object *object;
    size_t object_count;
    int cells;               /* a side, of SYNTH_CELL metres */
    uint32_t *cell_first;    /* (cells cells + 1) into near */
    struct synth_near *near; /* objects that come near each cell */
    float *ceiling;          /* (cells,cells) metres: no object within 1 m of the cell is higher */
};

struct synth_surface { /* what is nearest to a point */
    enum synth_material material;
    const struct synth_object *object; /* NULL: ground */
};

/* Bakes the world for |x|, |y| <= half metres; beyond there is bare ground. 0: out of memory. */
int synth_world_create(uint64_t seed, double half, struct synth_world *out);
void synth_world_free(struct synth_world *world);
/* Returns the ground's height in metres, without objects. */
double synth_ground(const struct synth_world *world, double x, double y);
/* Metres that a ray may safely go from p; negative inside. surface may be NULL. */
double synth_distance(const struct synth_world *world, v3 p, struct synth_surface *surface);
/* Heaps up a mound, a cap of a paraboloid, and takes the boulder in the middle away. */
struct synth_changed {
    v3 place;
    double radius, volume; /* volume: cubic metres that the surface from above rises by; negative: sinks by */
};
void synth_world_change(struct synth_world *world, struct synth_changed out[2]);

/* ---------------- synth_shade.c */

/* Returns the range to the first surface along a unit direction, or -1 when there is none before `far`. */
double synth_cast(const struct synth_world *world, v3 from, v3 direction, double far);
/* Returns the outward normal at a surface point; waves finer than the footprint (metres) are left out. */
v3 synth_normal(const struct synth_world *world, v3 p, double footprint);
/* Returns the display colour 0..1 of a surface point in clear water. */
v3 synth_shade(const struct synth_world *world, v3 p, double footprint);

/* ---------------- synth_trajectory.c */

struct synth_camera { /* x_c = rotation (x_w - centre); COLMAP's axes */
    v3 centre;
    v3 rotation[3];   /* rows: right, down, ahead */
    double f, cx, cy; /* px */
    int width, height;
};

struct synth_trajectory {
    struct synth_camera *camera; /* (count) */
    int count;
    double half;  /* the ground in view lies within |x|, |y| <= half, metres */
    double reach; /* farthest ground point in view, horizontally from its camera, metres */
};

/* Places the cameras. Standing heights are above z = 0 until synth_trajectory_set_heights knows the ground.
 * 0: out of memory. */
int synth_trajectory_create(const synth_options *options, struct synth_trajectory *out);
void synth_trajectory_set_heights(struct synth_trajectory *trajectory, const struct synth_world *world);
void synth_trajectory_free(struct synth_trajectory *trajectory);
void synth_image_name(const synth_options *options, int view, char name[32]);
enum { SYNTH_TEST_EVERY = 8 }; /* NeRF's layout holds out views 0, 8, 16... as others do by themselves */
const char *synth_image_folder(const synth_options *options, int view);
v3 synth_pixel_ray(const struct synth_camera *camera, double x, double y); /* unit, in the world */
/* Returns pixel and camera z of a world point; 0 when it lies behind. */
int synth_project(const struct synth_camera *camera, v3 p, double *x, double *y, double *z);

/* ---------------- synth_light.c: water, exposure, lamp */

#define SYNTH_SCATTER 1.2 /* the veil builds up so many times as fast as the direct light fades */
/* I = J exp(-direct z) + veil (1 - exp(-SYNTH_SCATTER direct z)), z: range in metres; display values */
struct synth_water {
    const char *name;
    v3 direct, veil; /* per metre, 0..1 */
};
v3 synth_through_water(const struct synth_water *water, v3 colour, double range);

/* Returns the factor on an image. */
v3 synth_gain(const synth_options *options, int view);
/* Returns the factor on J; range in metres. */
double synth_lamp_falloff(const synth_options *options, double range);
/* Returns the factor on a pixel. */
double synth_lamp_radial(const synth_options *options, double x, double y);
/* Returns what the water between camera and surface throws back of the lamp's light, before that gain; range
 * in metres. */
double synth_lamp_backscatter(const synth_options *options, double attenuation, double x, double y,
                              double range);

/* ---------------- synth_points.c */

struct synth_observation {
    uint32_t view;
    float x, y;     /* px, multiples of 1/1000 as far as float goes */
    uint32_t index; /* POINT2D_IDX */
};

struct synth_point {
    v3 position;
    uint64_t first; /* observation */
    float error;    /* mean reprojection error, px */
    uint16_t count;
    uint16_t sum[3]; /* of colours, one from each observation */
    uint8_t is_outlier;
};

struct synth_points {
    struct synth_point *point;
    size_t count;
    struct synth_observation *observation; /* by point, then by view */
    size_t observation_count;
    size_t *view_first; /* (views + 1) into by_view */
    uint32_t *by_view;  /* points, by view; observation i of a view is followed by stray keypoints */
    int views;
};

struct synth_run;
/* OXL_ERR_INTERRUPTED, OXL_ERR_MEMORY or OXL_OK. With images (options.write_images) colours stay 0 until
 * synth_points_collect has seen each of them. */
oxl_result synth_points_create(const struct synth_run *run, struct synth_points *out);
void synth_points_collect(struct synth_points *points, int view, const oxl_image *image);
void synth_points_free(struct synth_points *points);
/* Returns the observation of a point in a view that sees it. */
const struct synth_observation *synth_observation_in(const struct synth_points *points, size_t point,
                                                     int view);
/* Keypoints without a point after the k-th observation of a view: 0 or 1. */
int synth_has_stray(uint64_t seed, int view, size_t k);

/* ---------------- the run */

struct synth_run {
    oxl_context *ctx;
    const synth_options *options;
    struct synth_water water;
    struct synth_trajectory trajectory;
    struct synth_world world;
    synth_options again;            /* of a second dive */
    struct synth_changed change[2]; /* mound, stone */
    struct synth_points points;
    oxl_image clean, image;
    float *depth; /* (H,W) camera z, metres; 0: nothing there */
};

/* ---------------- what is written: synth_export.c, synth_light.c */

/* Writes truth/model.txt, which marks OUT as a survey of synth. */
oxl_result synth_write_model(const struct synth_run *s);
/* Writes the rest of the truth, and last what makes a survey: one that can be read is whole. */
void synth_remove_files(const synth_options *options); /* removes those of an earlier run */
oxl_result synth_write_files(const struct synth_run *s);
void synth_write_exposure(const struct synth_run *s, struct output *t);
void synth_write_lamp(const struct synth_run *s, struct output *t);

#endif
