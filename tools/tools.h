/* tools.h - products of a trained model: maps, clouds, meshes, comparisons. They use the public headers and cli.h.
 *
 *     product.c     what all products share: options, memory, the world of their files
 *     gps.c         the world that the photos' GPS says
 *     surface.c     the surface that the training views agree on: one function and one resolution for all products
 *     map.c         orthomosaic, heights, certainty
 *     cloud.c       points on the surface; PLY, LAS, OBJ
 *     mesh.c        a triangle mesh around it
 *     similarity.c  nearest neighbours, and the similarity between two clouds
 *     compare.c     what changed between two surveys of one place
 */
#ifndef TOOLS_H
#define TOOLS_H

#include "../cli/cli.h"

/* ---------------- similarity.c: similarities */

struct similarity {
    double scale, rotation[9], move[3]; /* to = scale rotation from + move */
};
void similarity_apply(const struct similarity *s, const double p[3], double out[3]);
struct similarity similarity_inverse(const struct similarity *s);
struct similarity similarity_compose(const struct similarity *a, const struct similarity *b); /* a after b */
/* From local coordinates to the survey's world, and along the axes of a frame from its centre, times `scale`. */
struct similarity similarity_of_world(const oxl_scene *scene, double scale);
struct similarity similarity_of_frame(const struct frame *f, double scale);
struct match {
    double from[3], to[3], off, weight; /* off: what is left of it */
};
/* Fits it to weighted pairs by least squares. Returns 0 where it is not defined. */
int similarity_fit(const struct match *match, size_t count, struct similarity *out);
/* Sets Tukey's weights by what is left. Returns its standard deviation, 1.4826 times the median of its sizes. */
double similarity_weigh(struct match *match, size_t count);

/* ---------------- product.c: what all products share */

/* Returns memory of zeros; without any, ends the program with an error. */
void *product_room(size_t count, size_t size);
double product_quantile(double *value, size_t count, double share); /* sorts them; NaN: none */
double vector_dot(const double a[3], const double b[3]);
void vector_add(const double a[3], double by, const double b[3], double out[3]); /* out = a + by b */

struct product {
    oxl_context *ctx;
    const oxl_scene *scene;
    const struct arguments *a;
    FILE *to;
    struct similarity world; /* from local coordinates to those of files */
    const char *words;       /* "metres" or "units" */
    struct geotiff place;    /* the CRS */
};
/* Reads --scale, --epsg and --gps. survey: the folder. */
oxl_result product_open(oxl_context *ctx, const oxl_scene *scene, const char *survey,
                        const struct arguments *a, FILE *to, struct product *out);
/* Gives each Gaussian the hue that the images around it have. Gains drift along a chain of images, and the colours of
 * the model against them, though no image shows it; brightness stays. */
void product_balance(const oxl_scene *scene, const oxl_imaging *imaging, oxl_model *model);
/* Makes the folder -o, and refuses to replace files there that are named as ours and are not. */
oxl_result product_folder(const struct product *p);
oxl_result product_save(const struct product *p, struct output *t, const char *name); /* to -o */

/* ---------------- gps.c: the world that the photos' GPS says */

/* Prints how many photos of the survey's views have GPS, if any. */
void gps_say(const oxl_scene *scene, const char *images, const char *survey, FILE *to);
/* Fits the similarity from local coordinates to UTM, metres, by the places where the photos say that they were taken,
 * and prints the residuals. epsg: the zone's code. */
oxl_result gps_fit(const struct product *p, const char *survey, struct similarity *out, int *epsg);

/* ---------------- surface.c: the surface that the training views agree on */

/* A camera's pixels with depths. */
struct sheet {
    oxl_camera camera;
    double parallel; /* as in oxl_render_options: 0: the rays meet in the camera */
    float *depth;    /* (height,width) as of oxl_render: negative where it is not clear; 0, NaN: none */
};
size_t sheet_pixels(const struct sheet *t);
/* Finds the place that a pixel shows. Returns 0 where it has no depth. */
int sheet_place(const struct sheet *t, size_t at, double out[3]);

/* A training view as the model shows it, at the surface's resolution. */
struct surface_view {
    struct sheet sheet;
    double eye[3];        /* the camera's centre */
    unsigned char *rgb;   /* (height,width,3) */
    unsigned char *guess; /* (height,width) 1: points contradict the depth */
};
struct surface {
    oxl_context *ctx;
    const oxl_scene *scene;
    int views;
    struct surface_view *view; /* (views) training views alone, in the scene's order */
    double distance;           /* units; median depth of the views' pixels; NaN: not known */
    double sampling; /* units; median side of what a pixel of the scene's images sees; NaN: not known */
    double reach;    /* units; of what a mesh is made from: surface_vote.ahead; at first 0 */
};
/* Renders the model on its own background: out is created, the sheet's depths are set. */
oxl_result sheet_render(const struct surface *s, const oxl_model *model, const struct sheet *t,
                        oxl_image *out);
/* Renders the depths of all training views at a longer side of at most `side` px. surface_close frees it, also on
 * error. */
oxl_result surface_open(oxl_context *ctx, const oxl_model *model, const oxl_scene *scene, int side,
                        struct surface *out);
void surface_close(struct surface *s);

/* What the views say of a place. */
struct surface_vote {
    int sees;         /* views that have it in their image with nothing before it */
    int confirms;     /* of these, views whose own depth is that of the place */
    int passes;       /* of these, views that clearly see something behind it, or whose depth is a guess */
    double off2;      /* sum over `confirms` of ((own depth - place's depth) / place's depth)^2 */
    double ray[3];    /* sum over `confirms` of the unit vectors towards the cameras */
    double footprint; /* least depth by focal length over `confirms`: units that a pixel sees */
    int nearest;      /* view that has it; -1: none */
    int clear;        /* views with a clear depth there that is not before the place by more than `reach` */
    double ahead;     /* sum over `clear` of how far the place is before that depth, `reach` at most */
};
enum { SURFACE_SIDE = 320 }; /* px; of the views' depths, for maps, reports and comparisons alike */

/* Returns 1 where `enough` views or more confirm the place, and fewer than twice as many pass it. */
int surface_holds(const struct surface_vote *v, int enough);
/* Asks the views of all places that `place` finds, 0: none, and hands their votes to `take`, in any order and on several
 * threads. */
void surface_ask_all(const struct surface *s, size_t count,
                     int (*place)(const void *user, size_t at, double p[3]),
                     void (*take)(void *user, size_t at, const double p[3], const struct surface_vote *v),
                     void *user);

/* How far every second point of the survey, which did not help to find it, is from a product's surface. */
struct deviation {
    double median, most; /* most: 90 % of the points are nearer */
    double gross, none;  /* share of points beyond PRODUCT_GROSS; share of points without a surface */
    double distance;     /* of the cameras */
};
#define PRODUCT_GROSS 0.05 /* of the cameras' distance */
/* Asks `off` how far each of these points, moved by `to`, is from it; NaN: it has nothing there; negative: the point is
 * not counted. */
struct deviation product_deviation(const struct surface *s, const struct similarity *to,
                                   double (*off)(const void *user, const double p[3]), const void *user);
void product_say(const struct product *p, const struct deviation *d);

/* ---------------- map.c: an orthomosaic, heights and their certainty */

struct map {
    const struct surface *surface;
    enum frame_kind kind;
    /* from local coordinates to the map's x, y and height, whose unit all lengths here have; at first the world's, which
     * map_make replaces by the survey's own axes if it chooses these */
    struct similarity to;
    int side;            /* px, at most; 0: as many as the pixel size requires */
    double pixel;        /* side of a pixel; 0: the median ground sampling distance */
    int enough;          /* training views that must see a place */
    int smooth;          /* passes that smooth heights and keep edges */
    int width, height;   /* 0: they and the corner are chosen */
    double corner[2];    /* outer corner of the top-left pixel */
    int is_world;        /* 1: the map is along the axes that `to` had at first */
    double top;          /* height of the highest camera */
    struct sheet sheet;  /* the map's camera */
    double sampling;     /* of the surface */
    double down;         /* mean over the views of the cosine between their axis and straight down */
    float *colour;       /* (3,height,width) 0..1; NaN: none; the planes below lie behind it */
    float *level;        /* (height,width) height; NaN: none */
    float *sigma;        /* (height,width) standard deviation of level; NaN: none */
    float *views;        /* (height,width) views that confirm the height; behind sigma */
    unsigned char *seen; /* (height,width) 1: any view sees the place; 2: enough do */
    size_t filled;       /* pixels whose colour is their neighbours' */
    /* of the ground that two views share; shares of the ground that any training view sees: seen by enough; with a height */
    double area, covered, high;
    struct deviation off; /* of the heights */
};
#define MAP_DOWN 0.5 /* cosine of 60 degrees: below it, the views do not show the ground from above */
/* A map as the options want it; its surface is opened before it is made. */
struct map map_of(const struct product *p, const struct surface *s);
/* map_free frees it, also on error. */
oxl_result map_make(struct map *m, const oxl_model *model);
void map_free(struct map *m);
/* The map's neighbour k of a pixel, row by row, of 0 to 8; the pixel itself where there is none. */
size_t map_next(const struct map *m, size_t at, int k);
/* Fills NaN of planes (bands,height,width) that have 5 known neighbours with their mean. Returns their number. */
size_t map_fill(const struct map *m, float *plane, int bands, int passes);
/* Writes planes, or where there are three colours, to the file `name` in -o. */
oxl_result map_raster(const struct map *m, const struct product *p, const char *name, const float *plane,
                      int bands);
/* Writes ortho.tif, height.tif, certainty.tif and frame.txt to -o. */
oxl_result map_write(const struct product *p, const oxl_model *model);

/* ---------------- cloud.c: points on the surface */

struct cloud_point {
    double place[3];             /* local coordinates */
    double normal[3];            /* unit, on the cameras' side */
    unsigned char rgb[3], views; /* views that confirm it, 255 at most */
};
struct cloud {
    const struct geotiff *place; /* the CRS, of LAS */
    struct cloud_point *point;
    size_t count;
    uint32_t *index; /* (3 triangles); NULL: there are none */
    size_t triangles;
};
/* Makes the points that `enough` views confirm. cloud_free frees them, also on error. */
oxl_result cloud_make(const struct surface *s, int enough, struct cloud *out);
void cloud_free(struct cloud *c);
/* Writes the cloud, or with --mesh the mesh, to the file -o. */
oxl_result cloud_write(const struct product *p, const oxl_model *model);

/* ---------------- mesh.c: triangles */

/* Replaces the points by the vertices of a mesh around them, of cells of that side. */
oxl_result mesh_make(struct surface *s, int enough, double cell, struct cloud *c);

/* ---------------- similarity.c: nearest points */

struct near {
    const struct cloud_point *point;
    double reach;
    size_t cells;
    uint32_t *first,
        *next; /* (cells) (points) a point's number from 1, of a cell and behind a point; 0: none */
};
/* Lists the points, which must outlive it, for near_find; n->first is to be freed. */
void near_open(struct near *n, const struct cloud *c, double reach);
/* Returns the nearest point that is nearer than `reach`, and sets how far p is before the surface through it; NULL:
 * there is none. */
const struct cloud_point *near_find(const struct near *n, const double p[3], double *off);

/* ---------------- compare.c: what changed between two surveys of one place */

/* Registers the second survey to the first, p's, and writes difference.tif, significant.tif, change.png, compare.csv
 * and compare.html to -o. */
oxl_result compare_run(const struct product *p, oxl_model *model[2], const oxl_scene *second);

#endif
