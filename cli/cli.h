/* tools.h - the parts of the command line that are more than parse, call and print. They speak to oceanxl.h alone, and so
 * prove that it suffices; they are not in the library. One section for each file of cli/ and lab/.
 */
#ifndef TOOLS_H
#define TOOLS_H

#include "../oceanxl.h"

#include <stdio.h>

/* ---------------------------------------------------------------- info.c: a model in numbers */

oxl_result info_print(oxl_context *ctx, FILE *to, const char *path, int json);

/* ---------------------------------------------------------------- blocks.c: a partition in tables */

void blocks_print(FILE *to, const oxl_partition_report *report);

/* ---------------------------------------------------------------- json.c: a cursor over what the library writes as JSON */

const char *json_member(const char *object, const char *name); /* its value, or NULL */
const char *json_first(const char *array);                     /* its first element, or NULL */
const char *json_next(const char *element);                    /* the one after it, or NULL */
double      json_number(const char *object, const char *name); /* of a member; not a number: there is none */
double      json_number_at(const char **cursor);               /* and moves past it; the point is a point in every locale */
int         json_is_true(const char *object, const char *name);
char       *json_string(const char *value); /* in fresh memory, free() it; NULL: it is no string, or there is no memory */

/* ---------------------------------------------------------------- frame.c: which way is right, up and above in a survey */

struct frame {
    double centre[3], axis[3][3]; /* local coordinates; rows: right, up, above, of unit length */
    int    is_world;              /* they are the world's x, y and z */
};
void   frame_of(const oxl_scene *scene, struct frame *out);
double frame_along(const struct frame *f, const double p[3], int axis); /* from the centre */
double frame_camera_height(const struct frame *f, const oxl_scene *scene);
void   frame_eye(const oxl_view *view, double out[3]); /* where the camera stood */
void   frame_cross(const double a[3], const double b[3], double out[3]);
/* Along right and up: all points but the outermost 1/200 on each side, and all cameras if they are wanted. 0: no memory. */
int    frame_bounds(const struct frame *f, const oxl_scene *scene, int with_cameras, double low[2], double high[2]);

/* ---------------------------------------------------------------- ortho.c: an orthomosaic */

typedef struct ortho_options {
    const char *folder; /* gets ortho.png, ortho.pgw and ortho.height.pfm */
    double      pixel;  /* its size, in units, or metres when `unit` is given; 0: the longer side has 2048 of them */
    double      unit;   /* metres a unit of the survey; 0: not known */
    int         heights;
} ortho_options;
oxl_result ortho_write(oxl_context *ctx, const oxl_model *model, const oxl_scene *scene, const ortho_options *options, FILE *to,
                       char *error, size_t error_size);

/* ---------------------------------------------------------------- flight.c: frames along a path */

typedef struct flight_options {
    const char *folder, *kind; /* orbit | survey */
    int         frames;
    int (*stop)(void *user, const char *what, long done, long total); /* nonzero stops it; may be NULL */
    void *user;
} flight_options;
oxl_result flight_write(oxl_context *ctx, const oxl_model *model, const oxl_scene *scene, const flight_options *options,
                        char *error, size_t error_size);

/* ---------------------------------------------------------------- scale_bar.c: how long a unit is */

/* Prints the bar's ends and length, and metres a unit when its length in metres is known (else 0). */
oxl_result scale_measure(oxl_context *ctx, const oxl_scene *scene, const char *bar, double length, FILE *to, char *error,
                         size_t error_size);
void       scale_model(oxl_model *model, double scale);

/* ---------------------------------------------------------------- report.c: what a run left, as one page */

/* Writes OUT/report.html, whole or not at all. What is not there yet is left out. On failure the text says why. */
oxl_result report_write(oxl_context *ctx, const char *out, char *error, size_t error_size);

/* ---------------------------------------------------------------- synth.c: a procedural underwater survey with known truth */

typedef struct synth_options {
    const char *out;             /* folder */
    int         views;           /* photographs (40) */
    int         width, height;   /* px (400 x 260) */
    double      extent;          /* side of the area flown over, metres; orbit: its diameter. 0: as the overlap wants (0) */
    const char *water;           /* none I IA IB II III 1C 3C 5C 7C 9C (1C) */
    const char *path;            /* lawnmower | orbit | forward (lawnmower) */
    long        points;          /* sparse points; 0: 400 a view (0) */
    double      noise;           /* sigma of the sensor's noise in 8-bit levels (1.5) */
    int         fish;            /* that swim into each photograph (0) */
    double      exposure_jitter; /* stops by which photographs are brighter or darker, at most (0) */
    double      lamp;            /* light that moves with the camera: the power by which it falls off with range; -1: none (-1) */
    double      origin[3];       /* where the survey's middle lies in the export's world, metres (0 0 0) */
    uint64_t    seed;            /* (1) */
    int         write_images;    /* 0: the three text files alone, for load tests (1) */
    int         threads;         /* 0: as many as OpenMP offers; the files do not depend on it */
    int (*progress)(void *user, const char *what, long done, long total); /* nonzero stops the run; may be NULL */
    void *user;
} synth_options;

synth_options synth_options_default(void); /* everything but out */

/* Leaves in `out`: images/, sparse/0/ and truth/ (see truth/model.txt). On failure the text says why. */
oxl_result synth_run(oxl_context *ctx, const synth_options *options, char *error, size_t error_size);

/* ---------------------------------------------------------------- ablate.c: the paper's variants side by side */

typedef struct ablate_options {
    const char         *scene, *out; /* folders */
    const char         *rows;  /* names with commas between; the first is what the others are compared with. NULL: the paper's */
    int                 seeds; /* each row is trained with 1..seeds */
    oxl_job_options     job;   /* what the rows share; what tells them apart is overwritten */
    oxl_context_options context;  /* threads and log of the context that is made here */
    oxl_callback        callback; /* progress of each job */
} ablate_options;

/* Leaves in `out`: ablation.csv, ablation.svg and NAME-seedS/ for each job; the table goes to `to`. When the callback stops it,
 * the next call goes on from there. On failure the text says why. */
oxl_result ablate_run(const ablate_options *options, FILE *to, char *error, size_t error_size);

/* ---------------------------------------------------------------- tradeoff.c: speed against accuracy, on one's own survey */

typedef struct tradeoff_options {
    const char         *scene, *out;   /* folders */
    const char         *rows;          /* names with commas between; NULL: all */
    int                 seeds;         /* each row is trained with 1..seeds */
    double              budget;        /* s: rows that do not fit any more are named, not trained */
    int                 side_is_given; /* 0: photographs may be reduced to fit the budget */
    oxl_job_options     job;           /* the base, and what the rows share */
    oxl_context_options context;       /* threads and log of the context that is made here */
    oxl_callback        callback;      /* progress of each job */
} tradeoff_options;

/* Leaves in `out`: tradeoff.csv, tradeoff.svg, tradeoff.md and NAME-seedS/ for each job; table and words go to `to`. When the callback
 * stops it, or with a larger budget, the next call goes on from there. On failure the text says why. */
oxl_result tradeoff_run(const tradeoff_options *options, FILE *to, char *error, size_t error_size);

/* ---------------------------------------------------------------- arguments.c: the command line's words */

enum exit_code { EXIT_DONE = 0, EXIT_FAILED = 1, EXIT_USAGE = 2, EXIT_INPUT = 3, EXIT_BUDGET = 4, EXIT_STOPPED = 130 };

enum command {
    COMMAND_NONE,
    COMMAND_TRAIN,
    COMMAND_CHECK,
    COMMAND_RENDER,
    COMMAND_EVAL,
    COMMAND_INFO,
    COMMAND_CONVERT,
    COMMAND_MERGE,
    COMMAND_PARTITION,
    COMMAND_SYNTH,
    COMMAND_ABLATE,
    COMMAND_TRADEOFF,
    COMMAND_REPORT,
    COMMAND_MEASURE
};

struct arguments { /* negative numbers and NULL: not given */
    enum command command;
    const char  *path[2]; /* SCENE, MODEL SCENE, IN OUT or FILE */
    int          path_count;
    int          help, version, quiet, json, depth, no_images, restart, robust, stop_early, manual, clear, medium;
    int          preset, split; /* enum oxl_preset, enum oxl_split */
    int          axes, cut;     /* enum oxl_partition_kind, enum oxl_cut */
    int          block_points;
    int          backend, device, devices; /* enum oxl_backend, from 0 */
    int          iterations, max_gaussians, sh_degree, max_side, test_every, threads, block, seeds;
    double       max_time, budget; /* s */
    double       image_cache, ram; /* bytes */
    double       seed;
    int          dog;           /* enum oxl_dog */
    int          exposure;      /* enum oxl_exposure */
    double       dog_threshold; /* -2: not given */
    int          ssim_every, exp_degree;
    double       alpha_min, tile_share;
    double       coarse, bands_every; /* shares of the run */
    double       haste, settle, refine;
    const char  *ucd, *keep; /* as oxl_ucd_parse and oxl_keep_parse take them */
    int          ortho, frames;
    double       pixel, scale, length; /* of --ortho; metres a unit; metres */
    const char  *flight, *bar;         /* --path of render, --scale-bar */
    const char  *out, *images, *sparse, *masks, *rows;

    synth_options synth; /* holds its defaults where nothing was given */
};

/* 0, or 1 with a text that says what is wrong. */
int  arguments_parse(int argc, char **argv, struct arguments *out, char *error, size_t error_size);
void arguments_help(FILE *to, enum command command); /* COMMAND_NONE: the overview */
void arguments_manual(FILE *to);                     /* docs/oceanxl.1: roff, man(7) */

#endif
