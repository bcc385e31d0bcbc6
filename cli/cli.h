/* cli.h - the parts of the command line beyond parsing, calling and printing. They use the public headers and
 * json.h of src/formats, eigen.h, random.h, svg.h of src/core, and are not in the library. One section for each file of
 * cli/; synth_options is here because arguments holds it.
 */
#ifndef CLI_H
#define CLI_H

#include "../oceanxl_job.h"
#include "../src/formats/json.h"

#include <stdio.h>

struct arguments;

struct cli_memory {           /* of the library, in bytes, as main.c counts it */
    size_t used, peak, limit; /* limit: --ram; 0: none */
    int refused;              /* 1: an allocation would have exceeded the limit */
};

/* ---------------- info.c: statistics of a model, tables of a partition */

struct spread { /* 5th, 50th and 95th percentile of the finite values; 0 of none */
    float low, middle, high;
};
/* sorted (count): scratch, may be value itself */
struct spread info_spread(const float *value, size_t count, float *sorted);
oxl_result info_print(oxl_context *ctx, FILE *to, const char *path, int json);
/* Copies imaging.txt from beside one model to beside another, unless one is there; of a model for viewers,
 * the gains alone. */
oxl_result info_copy_imaging(oxl_context *ctx, const char *from, const char *to, int *copied);
/* Returns 1 for a model whose name does not say whether it has learned the medium of the imaging.txt beside it. */
int info_takes_medium(const char *model);
/* Returns 1 beside a scene_clear.ply whose imaging.txt has gains and nothing else: models called scene.* there
 * have learned what the gains are for. */
int info_has_gains_alone(const char *model);
/* Refuses a place where a medium would be applied twice, or not at all; *is_other: gains and lamp there differ. */
oxl_result info_check_imaging(oxl_context *ctx, const char *from, const char *to, int *is_other);
void info_print_blocks(FILE *to, const oxl_partition_report *report);

/* ---------------- output.c: text and files independent of the locale */

struct output { /* text in memory; once it is opened as a file, what is not written yet */
    char *data; /* terminated; free() it */
    size_t used, capacity;
    int failed; /* an allocation or a write */
    FILE *file; /* atomic: renamed to its name on close */
    char path[4096], temporary[4128];
};
/* The conversions are printf's %s %-*s %*s %.*s %d %.5d %zu %llu %.2f %.*f (rounded half up; nothing if not
 * finite or, with its decimals, of more than 18 digits); %S: a string escaped for XML and HTML, also within
 * quotes; %J: likewise the value of a member of JSON, or "unknown". %S of NULL is nothing. */
void output_add(struct output *t, const char *format, ...);
void output_bytes(struct output *t, const void *data, size_t size);
/* t is empty, or its text is the beginning */
void output_open(struct output *t, const char *path);
/* Closes the file and empties t. Returns 1 if it was written whole. */
int output_close(struct output *t);
int output_save(struct output *t, const char *path); /* open and close */
/* Reads a file into fresh memory, or returns NULL; size may be NULL. */
char *output_read(const char *folder, const char *name, size_t *size);

/* Refuses to replace FOLDER/NAME where it is there without `mark`, which our own files of that name hold. Mark
 * NULL: any file, "": none. */
oxl_result output_check_own(oxl_context *ctx, const char *folder, const char *name, const char *mark);

/* Prints text with names, of files, folders and images; all such text goes through these: control
 * characters, which a survey from elsewhere may hold, are shown as \xNN. */
void print_text(FILE *to, const char *text);
void print_format(FILE *to, const char *format, ...);
/* A path in a command to copy, as a temporary of the enclosing block. */
#define PRINT_WORD(path) oxl_shell_word(path, (char[8192]){0}, 8192)

/* Writes one number the same way, and figures for people; returns out. */
const char *output_fixed(char out[32], double value, int decimals);
const char *output_count(char out[40], double value);   /* 22 400 */
const char *output_size(char out[40], double value);    /* bytes: 5.7 MB */
const char *output_seconds(char out[40], double value); /* 15 s, 3.2 min, 1.5 h */
#define OUTPUT_FIXED(value, decimals) output_fixed((char[32]){0}, value, decimals)
#define OUTPUT_COUNT(value) output_count((char[40]){0}, value)
#define OUTPUT_SIZE(value) output_size((char[40]){0}, value)
#define OUTPUT_SECONDS(value) output_seconds((char[40]){0}, value)

/* Returns the distance of grid lines: 1, 2 or 5 times a power of ten, at most 5 lines in the span. */
double axis_step(double span);

void json_print(FILE *to, const char *text); /* as a JSON string, in quotes */
/* Copies a string into fresh memory, free() it; NULL: it is no string, or there is no memory. */
char *json_string(const char *value);

/* ---------------- frame.c: the axes right, up and above of a survey */

struct frame {
    double centre[3], axis[3][3]; /* local coordinates; rows: right, up, above, of unit length */
    int is_world;                 /* they are the world's x, y and z */
    double spread;                /* standard deviation of the points along the widest axis */
};
enum frame_kind { FRAME_AUTO, FRAME_WORLD_AXES, FRAME_SURVEY_AXES };
void frame_of(const oxl_scene *scene, struct frame *out); /* of the kind auto */
/* Chooses a frame. up (3): above, in the world's axes, for any kind; or NULL. */
void frame_choose(const oxl_scene *scene, enum frame_kind kind, const double *up, struct frame *out);
double frame_along(const struct frame *f, const double p[3], int axis); /* from the centre */
double frame_camera_height(const struct frame *f, const oxl_scene *scene);
void frame_eye(const oxl_view *view, double out[3]); /* where the camera stood */
/* Does the inverse: sets the translation, for its rotation. */
void frame_place(oxl_camera *c, const double eye[3]);
void frame_cross(const double a[3], const double b[3], double out[3]);
/* Bounds along right and up all points but the outermost 1/200 on each side, and all cameras if they are
 * wanted. 0: no memory. */
int frame_bounds(const struct frame *f, const oxl_scene *scene, int with_cameras, double low[2],
                 double high[2]);

/* ---------------- geotiff.c: rasters with a place */

struct geotiff {
    int width, height, is_height;
    double pixel, corner[2]; /* size; x and y of the top-left pixel's outer corner */
    int epsg;                /* code of a projected CRS; 0: none */
    const double *reference; /* (2) latitude and longitude in degrees of (0, 0); NULL: not known */
    const char *citation;    /* what x and y are, in words */
    int is_metric;           /* 1: x and y are metres, even if no CRS says so */
};
/* data (height,width,4): bytes of RGBA, alpha 0 or 255; is_height: (height,width) floats, NaN: no data. */
oxl_result geotiff_write(oxl_context *ctx, const char *path, const struct geotiff *g, const void *data);

/* ---------------- ground.c: the places of a map, and which of them the views saw */

struct ground {
    const struct frame *frame;
    double corner[2]; /* of the top-left pixel, outer: along right and up from the frame's centre, units */
    double pixel;     /* units */
    double usual;     /* units: distance of the ground from the cameras, HUGE_VAL: not known */
    int width, height;
    const float *level;   /* (height,width) above the frame's centre, units; NaN: no ground */
    unsigned short *seen; /* (height,width) number of training views */
    /* (height,width) of these, the views whose own depth is the place's; NULL: not wanted */
    unsigned short *confirmed;
};
/* Projects p into the camera, px; returns camera z, at most 0 behind it. */
double ground_see(const oxl_camera *c, const double p[3], double at[2]);
/* Returns the place at x, y px of the map, in the scene's coordinates. */
void ground_place(const struct ground *g, double x, double y, double height, double out[3]);
/* Sets the median distance of what the training views show of the model, in units, and what a pixel of theirs
 * is of it; 0: they show nothing. */
oxl_result ground_measure_distance(oxl_context *ctx, const oxl_large_model *model, const oxl_scene *scene,
                                   double *distance, double *pixel);
/* Sets `seen`: the training views with the place in their image, not too far, and nothing of the model before
 * it; model NULL: whatever is before it. */
oxl_result ground_count_views(oxl_context *ctx, const oxl_large_model *model, const oxl_scene *scene,
                              const struct ground *g);

/* ---------------- ortho.c: an orthomosaic and a height model */

/* Writes ortho.tif, height.tif and frame.txt to -o, with --png ortho.png, ortho.pgw and ortho.height.pfm too,
 * by --pixel (0: the median ground sampling distance), --scale (0: not known) and --min-views. Gaussians that
 * no training view shows are made invisible in the model. */
oxl_result ortho_write(oxl_context *ctx, oxl_large_model *model, const oxl_scene *scene,
                       const struct arguments *a, FILE *to);

enum { OVERVIEW_VIEWS = 2 /* training views that a place of the overview is in, at least */ };
struct overview {
    oxl_image image; /* the map; dark where it has no ground */
    double sampling; /* median ground sampling distance of the training views, units a pixel; 0: not known */
    double area;     /* of the ground in it, square units */
    double covered, high; /* shares of the ground in any training view: in two or more; with a height too */
    double height_error;  /* units: median difference of heights from the survey's points; NaN: none */
    double distance;      /* units: median distance of the ground from the cameras; 0: not known */
};
/* Renders the map at a side of at most so many px, along the frame of the kind auto. Gaussians that no
 * training view shows are made invisible in the model. The caller frees the image, also on error. */
oxl_result ortho_overview(oxl_context *ctx, oxl_large_model *model, const oxl_scene *scene, int side,
                          struct overview *out);

/* ---------------- flight.c: frames along a path */

/* Writes --frames of --flight to -o. A nonzero result of stop stops it. */
oxl_result flight_write(oxl_context *ctx, const oxl_large_model *model, const oxl_scene *scene,
                        const struct arguments *a,
                        int (*stop)(void *user, const char *what, long done, long total), void *user);

/* ---------------- scale_bar.c: metres per unit */

/* Prints ends and lengths of bars, "ENDS=METRES;ENDS=METRES", metres a unit by those of known length, and what
 * that leaves of each. length: of bars without METRES; 0: not known. */
oxl_result scale_measure(oxl_context *ctx, const oxl_scene *scene, const char *bars, double length, FILE *to);
/* Finds the place of "IMG,X,Y,IMG,X,Y..." or "X,Y,Z", in the scene's coordinates; by how much its rays miss
 * it, and its distance from the nearest of the cameras, 0 without. */
oxl_result scale_place(oxl_context *ctx, const oxl_scene *scene, const char *text, size_t length,
                       double out[3], double *miss, double *distance);

/* ---------------- control.c: the accuracy of a georeferenced survey */

/* Prints the residuals of the control points in a file. */
oxl_result control_check(oxl_context *ctx, const oxl_scene *scene, const char *path, FILE *to);

/* ---------------- report.c: one page about a run */

/* Writes OUT/report.html, whole or not at all. Absent parts are left out. scale: metres a unit; 0: lengths are in
 * the survey's unit. */
oxl_result report_write(oxl_context *ctx, const char *out, double scale);

/* ---------------- synth_options.c: options of a procedural survey, which oceanxl-lab makes */

enum synth_path { SYNTH_LAWNMOWER, SYNTH_ORBIT, SYNTH_FORWARD, SYNTH_ROV };
enum synth_scene {
    SYNTH_ANY_SCENE, /* reef; of the path rov ridge */
    SYNTH_REEF,      /* reef patches, boulders, corals and a wreck */
    SYNTH_WRECK,     /* the wreck, overgrown, on a plain of bare sand: the points are uneven */
    SYNTH_RIDGE      /* a ridge: a wall of 60 degrees on one side, a slope on the other, sand at their feet */
};
/* Jerlov's, of water. */
enum synth_type {
    SYNTH_AIR,
    SYNTH_I,
    SYNTH_IA,
    SYNTH_IB,
    SYNTH_II,
    SYNTH_III,
    SYNTH_1C,
    SYNTH_3C,
    SYNTH_5C,
    SYNTH_7C,
    SYNTH_9C
};

/* Ranges are checked by the table of options. */
typedef struct synth_options {
    const char *out;   /* folder */
    int views;         /* images (40) */
    int width, height; /* px (400 x 260) */
    /* side of the area flown over, metres; orbit: its diameter. 0: as the overlap requires (0) */
    double extent;
    int water;              /* enum synth_type (1C) */
    int path;               /* enum synth_path (lawnmower) */
    double exposure_jitter; /* stops by which images are brighter or darker, at most (0) */
    /* light that moves with the camera: the power by which it falls off with range; -1: none (-1) */
    double lamp;
    /* of that lamp: what the water near the camera adds, of full white, at most (0) */
    double backscatter;
    double sand_contrast; /* of bare sand, a fraction of its own; below 1 it is dark and has few points (1) */
    double stereo;        /* metres between the two cameras of a rig; 0: one camera (0) */
    int scene;            /* enum synth_scene (any) */
    long points;          /* sparse points; 0: 400 a view (0) */
    double noise;         /* sigma of the sensor's noise in 8-bit levels (1.5) */
    /* of the exported poses: turns, degrees, and moves, % of the distance, root of the mean square (0) */
    double pose_noise;
    int fish; /* fish in each image (0) */
    /* images are transparent beyond so many metres from the vertical axis through the centre; 0: nowhere (0) */
    double alpha;
    double origin[3]; /* where the survey's middle lies in the export's world, metres (0 0 0) */
    uint64_t seed;    /* (1) */
    int write_images; /* 0: the COLMAP model alone, for load tests (1) */
    int threads;      /* 0: as many as OpenMP offers; the files do not depend on it */
    /* nonzero stops the run; may be NULL */
    int (*progress)(void *user, const char *what, long done, long total);
    void *user;
} synth_options;

synth_options synth_options_default(void); /* everything but out */

/* ---------------- options.c: commands and options */

enum exit_code {
    EXIT_DONE = 0,
    EXIT_FAILED = 1,
    EXIT_USAGE = 2,
    EXIT_INPUT = 3,
    EXIT_BUDGET = 4,
    EXIT_STOPPED = 130
};

enum { CLI_JOB_OPTIONS = 96, CLI_SEEDS = 99 /* of a study, at most */ };

enum command { /* in the order of the help */
               COMMAND_NONE,
               COMMAND_TRAIN,
               COMMAND_MERGE,
               COMMAND_CHECK,
               COMMAND_PARTITION,
               COMMAND_RENDER,
               COMMAND_MEASURE,
               COMMAND_EVAL,
               COMMAND_INFO,
               COMMAND_CONVERT,
               COMMAND_REPORT,
               COMMAND_SYNTH,
               COMMAND_ABLATE,
               COMMAND_TRADEOFF,
               COMMANDS
};

struct arguments { /* as given, or the default; NULL: not given */
    enum command command;
    const char *path[2]; /* SCENE, MODEL SCENE, IN OUT or FILE */
    int path_count;
    const char *help; /* "", or "all" */
    int completion, version, manual, page, quiet, json, depth, no_images, devices, clear;
    int dry_run, quality, progress_json;
    int split, backend;         /* enum oxl_split, enum oxl_backend */
    int device, threads, seeds; /* -1: the best, all */
    double budget;              /* s */
    int ortho, frames, png, min_views, epsg;
    int frame;                   /* enum frame_kind */
    double up[3];                /* 0 0 0: not given */
    double pixel, scale, length; /* of --ortho; metres a unit; metres. 0: not given */
    const char *flight, *bar;    /* --flight of render, --scale-bar */
    const char *control;         /* file of check */
    const char *out, *rows;
    synth_options synth;
    oxl_job_options job;                /* the preset's defaults, and what was given */
    const char *given[CLI_JOB_OPTIONS]; /* text of each option of the job, in the library's order */
    char note[160], error[512];         /* a former name was used; what is wrong. "" */
};
struct arguments arguments_default(void);

struct cli_command {
    const char *name;
    int paths, needs_out; /* words that are paths; 1: -o is not optional */
    const char *usage, *purpose, *example, *more;
};
extern const struct cli_command CLI_COMMANDS[COMMANDS]; /* of COMMAND_NONE: empty */

/* Lists the program's options and the job's as one. */
int cli_option_count(void);
const oxl_option *cli_option_at(int index);
int cli_option_of_job(int index); /* its place in the library's table; -1: the field is in struct arguments */
int cli_option_is_of(int index, enum command command);
/* Returns 1 for options that differ between the rows of ablate. */
int cli_is_study_variable(const char *name);
const char *cli_option_word(const oxl_option *o, char out[40]); /* "--name", "-o"; returns out */

/* ---------------- arguments.c: parsing of the command line */

/* Parses the command line. 0, or 1: out->error says what is wrong. */
int arguments_parse(int argc, char **argv, struct arguments *out);
/* Overrides what is there by what was given. */
void arguments_apply(const struct arguments *a, oxl_job_options *o);
/* Returns the text of an option of the job; NULL: not given. */
const char *arguments_given(const struct arguments *a, const char *name);

/* ---------------- help.c: text generated from the tables */

void complete_print(FILE *to);
void help_print(FILE *to, enum command command, int all); /* COMMAND_NONE: the overview */
void help_manual(FILE *to);                               /* docs/oceanxl.1: roff, man(7) */
void help_page(FILE *to);                                 /* docs/OPTIONS.md */

#endif
