/* cli.h - the parts of the command line beyond parsing, calling and printing.
 *
 * They use the public headers alone, and are not in the library. Each file of cli/ has a section; synth_options is here because `struct arguments` holds it.
 */
#ifndef CLI_H
#define CLI_H

#include "../oceanxl_job.h"

#include <stdio.h>

struct arguments;

/* Counts the bytes that the library has allocated; console.c limits them. */
struct cli_memory {
    size_t used, peak, limit; /* limit: --ram; 0: no limit */
    int refused;              /* 1: an allocation would have exceeded the limit */
};

/* ---------------- info.c: statistics of a model */

oxl_result info_print(oxl_context *ctx, FILE *to, const char *path, int json);
/* Before a model is converted, refuses a place where imaging.txt would apply a medium twice, or not at all, and
 * copies the imaging.txt of a model that is not for viewers there, unless one is there. */
oxl_result info_convert_imaging(oxl_context *ctx, const char *from, const char *to);

/* ---------------- output.c: text and files independent of the locale */

/* Holds text in memory; once a file is opened, the text that is not written yet. */
struct output {
    char *data; /* text, terminated; the caller frees it */
    size_t used, capacity;
    int failed; /* 1: an allocation or a write failed */
    FILE *file; /* file under a temporary name, renamed when it is closed: it is whole or not there */
    char path[4096], temporary[4128];
};
/* Adds text. The conversions are printf's %s %d %05d %zu %llu %.2f (rounded half up; nothing if not finite or,
 * with its decimals, of more than 18 digits); %S: a string escaped for XML and HTML, also within quotes; %J: a
 * member of JSON, escaped the same way, or "unknown". %S of NULL is nothing. */
void output_add(struct output *t, const char *format, ...);
void output_bytes(struct output *t, const void *data, size_t size);
/* Adds `size` bytes of an integer, or a float (4) or double (8), little endian. */
void output_integer(struct output *t, uint64_t value, int size);
void output_real(struct output *t, double value, int size);
/* Opens a file for t, whose text becomes the file's beginning. */
void output_open(struct output *t, const char *path);
/* Closes the file and empties t; fails if it was not written whole. */
oxl_result output_close(oxl_context *ctx, struct output *t);
/* Opens a file, writes the text and closes it. */
oxl_result output_save(oxl_context *ctx, struct output *t, const char *path);
/* Copies the folder of a file, "." if the path names none; returns the file's name. */
const char *output_split(const char *path, char folder[4096]);
/* Reads a file into fresh memory, terminated, or returns NULL. */
char *output_read(const char *folder, const char *name);

/* Refuses to replace FOLDER/NAME where it is there without `mark`, which our own files of that name hold.
 * Mark NULL: refuses any file; "": refuses none that can be opened. */
oxl_result output_check_own(oxl_context *ctx, const char *folder, const char *name, const char *mark);

/* Prints text that holds names of files, folders or images. It shows control characters, which a survey from
 * elsewhere may hold, as \xNN, so that they cannot control the terminal. */
void print_text(FILE *to, const char *text);
void print_format(FILE *to, const char *format, ...);
/* Quotes a path for a command to copy, in an array of the enclosing block. */
#define PRINT_WORD(path) oxl_shell_word(path, (char[8192]){0}, 8192)

/* Write a number for people to read, the same in any locale; return out. */
const char *output_fixed(char out[32], double value, int decimals);
const char *output_count(char out[40], double value);   /* e.g. 22 400 */
const char *output_size(char out[40], double value);    /* of bytes, e.g. 5.7 MB */
const char *output_seconds(char out[40], double value); /* e.g. 15 s, 3.2 min, 1.5 h */
#define OUTPUT_FIXED(value, decimals) output_fixed((char[32]){0}, value, decimals)
#define OUTPUT_COUNT(value) output_count((char[40]){0}, value)
#define OUTPUT_SIZE(value) output_size((char[40]){0}, value)
#define OUTPUT_SECONDS(value) output_seconds((char[40]){0}, value)

/* Returns the distance of grid lines: 1, 2 or 5 times a power of ten, at most 5 lines in the span. */
double axis_step(double span);

void json_print(FILE *to, const char *text); /* prints a JSON string, in quotes */
/* Copies a string of JSON into fresh memory, which the caller frees; NULL: it is no
 * string, or there is no memory. */
char *json_string(const char *value);

/* ---------------- frame.c: the axes right, up and above of a survey */

struct frame {
    double centre[3], axis[3][3]; /* in local coordinates; rows of axis: right, up, above, of unit length */
    int is_world;                 /* 1: the axes are the world's x, y and z */
    double spread;                /* standard deviation of the points along the widest axis */
};
enum frame_kind { FRAME_AUTO, FRAME_WORLD_AXES, FRAME_SURVEY_AXES };
void frame_choose(const oxl_scene *scene, enum frame_kind kind, struct frame *out);
double frame_along(const struct frame *f, const double p[3], int axis);    /* from the centre */
double frame_camera_height(const struct frame *f, const oxl_scene *scene); /* mean above the centre, units */
void frame_eye(const oxl_camera *c, double out[3]); /* sets `out` to the camera's centre */
/* Moves the camera to `eye`: sets its translation, and keeps its rotation. */
void frame_place(oxl_camera *c, const double eye[3]);
void frame_to_camera(const double rotation[9], const double p[3], double out[3]); /* rotation times p */
void frame_cross(const double a[3], const double b[3], double out[3]);
double frame_length(const double a[3]);
/* Sets `out` to the unit eigenvector of the largest eigenvalue of a symmetric matrix (n,n), n at most 4, without
 * negative eigenvalues: a column of a high power of it, which repeated squaring gives. Its largest element is
 * positive. */
void frame_widest(int n, const double *matrix, double *out);
int frame_compare(const void *a, const void *b); /* of doubles, for qsort */
/* Bounds, along right and up, all points but the outermost 1/200 on each side. Returns 0 without memory. */
int frame_bounds(const struct frame *f, const oxl_scene *scene, double low[2], double high[2]);

/* ---------------- geotiff.c: rasters with a place */

struct geotiff {
    int width, height;
    int bands;               /* 3: red, green, blue, which become bytes with alpha; else floats */
    double pixel, corner[2]; /* size of a pixel; x and y of the top-left pixel's outer corner */
    int epsg;                /* code of a projected CRS; 0: none */
    const double *reference; /* (2) latitude and longitude in degrees of (0, 0); NULL: not known */
    const char *citation;    /* meaning of x and y, in words */
    int is_metric;           /* 1: x and y are metres, even if no CRS says so */
};
/* The GeoKeys of a CRS, for a GeoTIFF or a LAS file: values of the tags 34735, 34736 and 34737. */
struct geotiff_crs {
    double key[72], number[5];
    size_t keys, numbers;
    char words[256];
};
void geotiff_crs(const struct geotiff *g, struct geotiff_crs *out);
/* Writes a raster as a GeoTIFF. data (bands,height,width): colours 0..1; NaN: no data. */
oxl_result geotiff_write(oxl_context *ctx, const char *path, const struct geotiff *g, const float *data);

/* ---------------- flight.c: frames along a path */

enum { FLIGHT_NONE, FLIGHT_ORBIT, FLIGHT_SURVEY };
/* Writes --frames images along --flight to -o. A nonzero result of `stop` ends the flight. */
oxl_result flight_write(oxl_context *ctx, const oxl_model *model, const oxl_scene *scene,
                        const struct arguments *a,
                        int (*stop)(void *user, const char *what, long done, long total), void *user);

/* ---------------- scale_bar.c: metres per unit */

/* Prints the ends and lengths of bars, "ENDS=METRES;ENDS=METRES", the metres per unit that fit the known
 * lengths best, and what is left of each. length: metres of the bars without METRES; 0: not known. */
oxl_result scale_measure(oxl_context *ctx, const oxl_scene *scene, const char *bars, double length, FILE *to);
/* Finds the place of "IMG,X,Y,IMG,X,Y..." or "X,Y,Z", in the scene's coordinates. Sets by how much its rays
 * miss it, and its distance from the nearest of the cameras that mark it; both 0 for "X,Y,Z". */
oxl_result scale_place(oxl_context *ctx, const oxl_scene *scene, const char *text, size_t length,
                       double out[3], double *miss, double *distance);

/* ---------------- control.c: the accuracy of a georeferenced survey */

/* Prints the residuals of the control points in a file. */
oxl_result control_check(oxl_context *ctx, const oxl_scene *scene, const char *path, FILE *to);

/* ---------------- report.c: one page about a run */

/* Writes OUT/report.html, whole or not at all, without the parts that OUT has no data for. scale: metres a
 * unit; 0: lengths are in the survey's unit. */
oxl_result report_write(oxl_context *ctx, const char *out, double scale);

/* ---------------- synth_options.c: options of a procedural survey, which oceanxl-lab makes */

enum synth_path { SYNTH_LAWNMOWER, SYNTH_ORBIT, SYNTH_FORWARD };
/* Names the layouts of the files. */
enum synth_layout { SYNTH_COLMAP, SYNTH_NERF, SYNTH_LLFF };
enum synth_change { SYNTH_SAME, SYNTH_LIGHT, SYNTH_CHANGED };
/* Names Jerlov's types of water. */
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

/* Options of a synthetic survey, with defaults in parentheses; the table of options checks their ranges. */
typedef struct synth_options {
    const char *out;   /* folder */
    int views;         /* images (40) */
    int width, height; /* px (400 x 260) */
    /* metres; side of the area flown over; orbit: its diameter; 0: as the overlap requires (0) */
    double extent;
    int water;              /* enum synth_type (1C) */
    int path;               /* enum synth_path (lawnmower) */
    int layout;             /* enum synth_layout (COLMAP) */
    double exposure_jitter; /* stops; most by which an image is brighter or darker (0) */
    /* power by which the light of a lamp on the camera falls off with range; -1: no lamp (-1) */
    double lamp;
    /* fraction of full white; most that water near the camera adds, lit by the lamp (0) */
    double backscatter;
    /* fraction of its own contrast that bare sand has; below 1 it is dark and has few points (1) */
    double sand_contrast;
    int change;    /* enum synth_change: a second dive to the same place (none) */
    double stereo; /* metres; distance between the two cameras of a rig; 0: one camera (0) */
    int points;    /* sparse points; 0: 400 a view (0) */
    double noise;  /* 8-bit levels; sigma of the sensor's noise (1.5) */
    /* degrees, and % of the distance; root of the mean square of the exported poses' turns and moves (0) */
    double pose_noise;
    /* metres; images are transparent farther than this from the vertical axis through
     * the centre; 0: nowhere (0) */
    double alpha;
    double origin[3]; /* metres; place of the survey's middle in the export's world (0 0 0) */
    uint64_t seed;    /* seed of all random choices (1) */
    int write_images; /* 0: writes the COLMAP model alone, for load tests (1) */
    int threads;      /* 0: as many as OpenMP offers; the files do not depend on their number */
    /* called with the progress; a nonzero result stops the run; may be NULL */
    int (*progress)(void *user, const char *what, long done, long total);
    void *user;
} synth_options;

synth_options synth_options_default(void); /* sets all but `out` */

/* ---------------- options.c: commands and options */

enum exit_code {
    EXIT_DONE = 0,
    EXIT_FAILED = 1,
    EXIT_USAGE = 2,
    EXIT_INPUT = 3,
    EXIT_BUDGET = 4,
    EXIT_STOPPED = 130
};

enum {
    CLI_JOB_OPTIONS = 96,
    CLI_SEEDS = 99, /* most seeds of a study */
    CLI_PATHS = 16  /* most surveys of results */
};

/* Commands, in the order of the help. */
enum command {
    COMMAND_NONE,
    COMMAND_TRAIN,
    COMMAND_CHECK,
    COMMAND_RENDER,
    COMMAND_CLOUD,
    COMMAND_COMPARE,
    COMMAND_MEASURE,
    COMMAND_EVAL,
    COMMAND_INFO,
    COMMAND_CONVERT,
    COMMAND_REPORT,
    COMMAND_SYNTH, /* this and the following: commands of oceanxl-lab */
    COMMAND_ABLATE,
    COMMAND_TRADEOFF,
    COMMAND_RESULTS,
    COMMANDS
};

/* Holds the command line: each field is as given, or the default; NULL: not given. */
struct arguments {
    enum command command;
    const char *path[CLI_PATHS]; /* SCENE, MODEL SCENE, IN OUT, FILE, or SURVEY... */
    int path_count;
    const char *help; /* "", or "all" */
    int version, manual, page, quiet, verbose, json, depth, no_images, devices, clear;
    int dry_run, quality, progress_json, mesh, gps;
    int split, backend;                                 /* enum oxl_split, enum oxl_backend */
    int device, threads, seeds;                         /* -1: the best, all */
    double budget;                                      /* s; time for all rows of a study */
    int ortho, flight, frames, min_views, smooth, epsg; /* flight: FLIGHT_ORBIT... */
    int frame;                                          /* enum frame_kind */
    double pixel, scale, length; /* units of the map; metres per unit; metres; 0: not given */
    const char *bar;             /* --scale-bar of measure */
    const char *control;         /* file of --control of check */
    const char *out, *rows, *polygon;
    synth_options synth;
    oxl_job_options job; /* defaults of the preset, replaced by what was given */
    /* text of each option of the job, in the order of the library's table; NULL: not given */
    const char *given[CLI_JOB_OPTIONS];
    char error[512]; /* what is wrong; "": nothing */
};
struct arguments arguments_default(void);

struct cli_command {
    const char *name;
    int paths, needs_out; /* number of paths, of results at least; needs_out 1: -o is required */
    const char *usage, *purpose, *example, *more;
};
extern const struct cli_command CLI_COMMANDS[COMMANDS]; /* the row of COMMAND_NONE is empty */

/* List the program's options and the job's as one table. */
int cli_option_count(void);
const oxl_option *cli_option_at(int index);
/* Returns its index in the library's table; -1: the field is in struct arguments. */
int cli_option_of_job(int index);
int cli_option_is_of(int index, enum command command);
/* Returns 1 for an option that ablate sets itself: its rows differ by it. */
int cli_is_study_variable(const char *name);
const char *cli_option_word(const oxl_option *o, char out[40]); /* writes "--name" or "-o"; returns out */

/* ---------------- arguments.c: parsing of the command line */

/* Parses the command line. Returns 0, or 1 where out->error says what is wrong. */
int arguments_parse(int argc, char **argv, struct arguments *out);
/* Replaces in `o` each option of the job that was given. */
void arguments_apply(const struct arguments *a, oxl_job_options *o);

/* ---------------- help.c: text generated from the tables */

void help_print(FILE *to, enum command command, int all); /* prints the overview for COMMAND_NONE */
void help_manual(FILE *to);                               /* prints docs/oceanxl.1: roff, man(7) */
void help_page(FILE *to);                                 /* prints docs/OPTIONS.md */

#endif
