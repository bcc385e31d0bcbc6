/* tools.h - products of a trained model: maps, clouds, meshes, comparisons. They use the public headers and cli.h.
 *
 *     surface.c     the surface that the training views agree on: one function and one resolution for all products
 *     map.c         orthomosaic, heights, certainty
 *     cloud.c       points on the surface; PLY, LAS
 *     mesh.c        a triangle mesh around it
 *     similarity.c  nearest neighbours, and the similarity between two clouds
 *     compare.c     what changed between two surveys of one place
 */
#ifndef TOOLS_H
#define TOOLS_H

#include "../cli/cli.h"

/* ---------------- surface.c: the surface that the training views agree on */

/* A training view as the model shows it, at the surface's resolution. */
struct surface_view {
    oxl_camera camera;
    double eye[3];
    float *depth; /* (height,width) camera z as of oxl_render: negative where it is not clear; 0: none */
    unsigned char *rgb;   /* (height,width,3) */
    unsigned char *guess; /* (height,width) 1: the depth is a guess */
};
struct surface {
    oxl_context *ctx;
    const oxl_scene *scene;
    int views;
    struct surface_view *view; /* (views) training views alone, in the scene's order */
    double distance;           /* units; median depth of the views' pixels; 0: not known */
    double sampling; /* units; median side of what a pixel of the scene's images sees; 0: not known */
};
/* Renders the depths of all training views at a longer side of at most `side` px. surface_close frees it, also on
 * error. */
oxl_result surface_open(oxl_context *ctx, const oxl_model *model, const oxl_scene *scene, int side,
                        struct surface *out);
void surface_close(struct surface *s);

/* What the views say of a place. */
struct surface_vote {
    int sees;         /* views that have it in their image with nothing before it */
    int confirms;     /* of these, views whose own depth, with detail, is that of the place */
    int passes;       /* of these, views that clearly see something behind it */
    double off, off2; /* sums over `confirms` of (own depth - place's depth) / place's depth; of its square */
    double ray[3];    /* sum over `confirms` of the unit vectors towards the cameras */
    double footprint; /* least depth by focal length over `confirms`: units that a pixel sees */
    int nearest;      /* view that has it; -1: none */
};
/* Projects p into the camera, at: px; returns camera z, which is 0 or less behind the camera. */
double surface_project(const oxl_camera *c, const double p[3], double at[2]);
/* Lists the views that may have places of a sphere in their image. Returns their number. */
int surface_list(const struct surface *s, const double centre[3], double radius, int *list);
struct surface_vote surface_ask(const struct surface *s, const int *list, int count, const double p[3]);
/* Returns 1 where `enough` views or more confirm the place, and fewer pass it. */
int surface_holds(const struct surface_vote *v, int enough);
/* The place of a view's pixel at that depth. */
void surface_place(const struct surface_view *v, double x, double y, double depth, double out[3]);

/* ---------------- map.c: an orthomosaic, heights and their certainty */

struct map {
    oxl_context *ctx;
    const oxl_scene *scene;
    struct surface *surface; /* NULL: map_make opens one */
    double pixel;            /* units; side of a pixel; 0: the median ground sampling distance */
    int enough;              /* training views that must see a place */
    int smooth;              /* passes that smooth heights and keep edges */
    int is_placed; /* 1: frame, corner, width and height are given: another survey's map, turned into this one */
    struct frame frame;
    double corner[2]; /* units; outer corner of the top-left pixel, along right and up from the centre */
    double shift[3];  /* units; map coordinates of the frame's centre */
    double top;       /* units; height of the highest camera above the frame's centre */
    double distance, sampling; /* of the surface */
    double down;               /* mean over the views of the cosine between their axis and straight down */
    int width, height;
    unsigned char *rgba;   /* (height,width,4) */
    float *level;          /* (height,width) units; height above the centre; NaN: none */
    float *sigma;          /* (height,width) units; standard deviation of level; NaN: none */
    unsigned short *views; /* (height,width) views that confirm the height */
    size_t hidden,
        filled; /* Gaussians that no training view shows; pixels whose colour is their neighbours' */
    /* square units; shares of the ground that any training view sees: seen by enough; with a height */
    double area, covered, high;
    /* units; differences of heights from the points that did not help to find them: median, 90 %; shares: beyond
     * MAP_GROSS of the distance, of points without a height */
    double error, error_90, gross, none;
};
#define MAP_GROSS 0.05
#define MAP_DOWN 0.5 /* cosine of 60 degrees: below it, the views do not show the ground from above */
/* Makes the map, and Gaussians that no training view shows invisible in the model. side: px, at most; 0: as many
 * as the pixel size requires. map_free frees it, also on error. */
oxl_result map_make(struct map *m, oxl_model *model, enum frame_kind kind, int side);
void map_free(struct map *m);
/* The georeference of rasters on the map's grid, in units of `unit` units. */
struct geotiff map_georeference(const struct map *m, const struct arguments *a, double unit);
/* Sets `out` to the place at x, y px of the map, in the scene's coordinates. */
void map_place(const struct map *m, double x, double y, double height, double out[3]);
/* Writes ortho.tif, height.tif, certainty.tif and frame.txt to -o, by --pixel, --scale and --min-views. */
oxl_result map_write(oxl_context *ctx, oxl_model *model, const oxl_scene *scene, const struct arguments *a,
                     FILE *to);
/* ---------------- cloud.c: points on the surface */

struct cloud_point {
    double place[3];             /* local coordinates */
    float normal[3];             /* unit, on the cameras' side */
    unsigned char rgb[3], views; /* views that confirm it, 255 at most */
};
struct cloud {
    struct cloud_point *point;
    size_t count;
};
/* Makes the points that `enough` views confirm. cloud_free frees them, also on error. */
oxl_result cloud_make(const struct surface *s, int enough, struct cloud *out);
void cloud_free(struct cloud *c);

/* How far every second point of the survey is from the surface through its nearest point of the cloud, units. */
struct deviation {
    double median, most,
        none; /* most: of 90 %; none: share without a point near them; NaN: nothing to compare */
};
oxl_result cloud_deviation(const struct surface *s, const struct cloud *c, struct deviation *out);

/* How places are written. */
struct cloud_file {
    oxl_context *ctx;
    const double *origin; /* (3) world = (local + origin) unit */
    double unit, step;    /* step: about the distance of points, in the file's unit */
    const char *words;    /* "metres" or "units" */
    struct geotiff place; /* its CRS */
};
/* Writes the cloud, or with --mesh the mesh, to the file -o. */
oxl_result cloud_write(oxl_context *ctx, const oxl_model *model, const oxl_scene *scene,
                       const struct arguments *a, FILE *to);

/* ---------------- mesh.c: triangles */

/* Makes a mesh around the cloud, writes it to the file -o and says so; d: its vertices' deviation. */
oxl_result mesh_save(const struct surface *s, const struct cloud *c, const struct cloud_file *f,
                     const struct arguments *a, struct deviation *d, FILE *to);

/* ---------------- similarity.c: nearest points, similarities */

struct near {
    const struct cloud_point *point;
    size_t count;
    double reach, low[3];
    struct near_key *key; /* (count) */
};
/* Sorts the points, which must outlive it, for near_find. Returns 0 without memory. */
int near_open(struct near *n, const struct cloud_point *point, size_t count, double reach);
void near_close(struct near *n);
/* Returns the nearest point that is nearer than `reach`, and its distance; NULL: there is none. */
const struct cloud_point *near_find(const struct near *n, const double p[3], double *distance);

struct similarity {
    double scale, rotation[9], move[3]; /* to = scale rotation from + move */
};
void similarity_apply(const struct similarity *s, const double p[3], double out[3]);
/* Fits it to weighted pairs by least squares; scale 1 unless with_scale. Returns 0 where it is not defined. */
int similarity_fit(const double (*from)[3], const double (*to)[3], const double *weight, size_t count,
                   int with_scale, struct similarity *out);

/* ---------------- compare.c: what changed between two surveys of one place */

/* Registers the second survey to the first and writes difference.tif, significant.tif, change.png, compare.csv and
 * compare.html to -o. Gaussians that no training view shows become invisible in the models. */
oxl_result compare_run(oxl_context *ctx, oxl_model *model[2], const oxl_scene *const scene[2],
                       const struct arguments *a, FILE *to);

#endif
