/* oceanxl_job.h - trains a survey's folder into an output folder: what the program oceanxl needs beside
 * oceanxl.h.
 *
 * It has the whole job (oxl_job_run), its options by name, predictions, and results as JSON.
 * Conventions are those of oceanxl.h. Link oceanxl.c, or dist/oceanxl_job.c (`make dist`) with -Idist
 * -Idist/single.
 */
#ifndef OCEANXL_JOB_H
#define OCEANXL_JOB_H

#include "oceanxl.h"

#include <stdio.h>

#ifdef __cplusplus
extern "C" {
#endif

/* ---------------- blocks */

/* A survey too large for one model is cut into blocks along its principal axes [OceanXL sec. 3.1, Alg. 1]. */
typedef enum oxl_partition_kind {
    OXL_PARTITION_AUTO = 0, /* 2D when the third principal extent is less than 0.3 of the second, else 3D */
    OXL_PARTITION_2D,       /* no cut along the third principal axis */
    OXL_PARTITION_3D,
    OXL_PARTITION_NONE /* one block of any size */
} oxl_partition_kind;

typedef enum oxl_cut {
    /* at 0.3 to 0.7 of the box, by the number of points on each side */
    OXL_CUT_BALANCED = 0,
    OXL_CUT_MIDPOINT /* at 0.5, as in BlockGaussian: the baseline */
} oxl_cut;

typedef struct oxl_partition_options {
    int block_points; /* blocks with more points are cut; 0: as memory requires */
    /* number of blocks, in place of block_points; 0: by block_points or memory */
    int blocks;
    oxl_partition_kind kind;
    oxl_cut cut;
} oxl_partition_options;

/* ---------------- the whole job */

typedef struct oxl_job_options {
    oxl_scene_options scene;
    oxl_train_options train;
    oxl_partition_options partition;
    const char *preset; /* preset of the defaults, recorded in run.json */
    int renders;        /* 1: write renders of the evaluated views to OUT/renders */
    /* peak memory allowed, bytes; limits blocks, image cache and Gaussians; 0: what is free */
    size_t ram;
    size_t device_ram; /* peak device memory allowed, bytes; 0: no limit */
    /* number of images that train.iterations suffice for (170, 170, 2800): more images raise the iterations
     * in proportion; a run has at most 700 iterations for each image; 0: train.iterations as given */
    int iterations_for;
    int block;        /* train only this block; -1: all, and the merged model */
    int restart;      /* 1: discard the run in OUT, train from the start */
    uint64_t seed;    /* 0: the context's seed */
    const char *from; /* model that training starts from; NULL: the survey's points */
} oxl_job_options;

OXL_API oxl_job_options oxl_job_options_default(oxl_preset preset);

/* ---------------- options by name */

/* One row per option; the tables are in src/core/options.c and src/parts. Defaults, parsing, range checks,
 * run.json, the command line, its help, the manual page and docs/OPTIONS.md are generated from them. A
 * program can have a table of the same type for its own options. */

/* What the field of an option holds, and its text. */
typedef enum oxl_option_kind {
    OXL_OPTION_FLAG,   /* int, 0 or 1: no text, or true | false */
    OXL_OPTION_INT,    /* int */
    OXL_OPTION_SEED,   /* uint64_t below 2^53 */
    OXL_OPTION_FLOAT,  /* float: 0.05 or 1/255 */
    OXL_OPTION_DOUBLE, /* double */
    OXL_OPTION_CHOICE, /* an enum from 0: a word of `value` */
    /* size_t: 1000000, 512M, 4G; K, M, G, T are powers of 1024 */
    OXL_OPTION_BYTES,
    OXL_OPTION_SECONDS, /* double: 90s, 20m, 8h, 1d */
    OXL_OPTION_TEXT,    /* const char *, borrowed; NULL: not set */
    OXL_OPTION_RGB,     /* float[3]: 0,0.1,0.2 */
    OXL_OPTION_POINT,   /* double[3]: X,Y,Z */
    OXL_OPTION_SIZE,    /* int[2]: 400x260 */
    /* const char *; sets all options of the job to the preset's defaults */
    OXL_OPTION_PRESET,
    /* oxl_keep: 0.5, 400000, 80MB (decimal; KiB... are binary), all */
    OXL_OPTION_KEEP,
} oxl_option_kind;

typedef enum oxl_option_tier { OXL_TIER_BASIC = 0, OXL_TIER_ADVANCED, OXL_TIER_EXPERT } oxl_option_tier;

/* Bits of oxl_option.use: what accepts the option, and where it does not apply. */
enum {
    OXL_OPTION_OF_SURVEY = 1,   /* reading a survey */
    OXL_OPTION_OF_TRAINING = 2, /* training, in a run or a study, and its prediction */
    OXL_OPTION_OF_RUN = 4,      /* one run, or its prediction */
    OXL_OPTION_OF_OUT = 8,      /* an existing folder OUT */
    OXL_OPTION_OF_BLOCK = 16,   /* a run or one block of it, not its prediction */
    /* names no command: the bytes of every block depend on the option, so "job" of run.json records it */
    OXL_OPTION_OF_RESULT = 64,
    /* off while a finished model is refined: after merging, for viewers, to continue a run */
    OXL_OPTION_NOT_REFINED = 128,
    OXL_OPTION_ONE_BLOCK = 256 /* refused if the survey is cut into several blocks */
};

typedef struct oxl_option {
    const char *name; /* "sh-degree" */
    /* "auto|0..3"; NULL: a flag. A number with a value WORD|... also takes WORD, stored as -1 */
    const char *value;
    oxl_option_kind kind;
    /* offset of the field in oxl_job_options, or in the struct of the program's table */
    size_t at;
    const char *field;     /* its name, "train.sh_degree" */
    double low, high;      /* inclusive range of a number */
    const char *preset[3]; /* default as text, by oxl_preset; NULL: 0 */
    oxl_option_tier tier;
    unsigned use;
    const char *group, *help; /* help: with the unit, without the default */
} oxl_option;

OXL_API int oxl_option_count(void);
OXL_API const oxl_option *oxl_option_at(int index);          /* 0 .. count - 1; 0 is the preset */
OXL_API const oxl_option *oxl_option_find(const char *name); /* NULL: none */
/* Parses text (NULL: "true") into the option's field; text of paths is borrowed. On OXL_ERR_USAGE the field
 * is unchanged, and error, which may be NULL, names the option, the value, the values allowed and a fix. */
OXL_API oxl_result oxl_option_set(const oxl_option *option, void *options, const char *text, char *error,
                                  size_t error_size);
/* Writes the shortest text that oxl_option_set parses to the same value, or "" for a folder that is not set.
 * Returns out. */
OXL_API const char *oxl_option_get(const oxl_option *option, const void *options, char *out, size_t size);
/* Writes the option's member name in run.json: sh_degree, images_folder. Returns out. */
OXL_API const char *oxl_option_member(const oxl_option *option, char out[40]);
/* OXL_ERR_USAGE: a value is out of its range; the text names the first such option. */
OXL_API oxl_result oxl_job_options_check(oxl_context *ctx, const oxl_job_options *options);

enum { OXL_SURVEY_TEXT = 2560 /* bytes */ };

/* Content of a survey, its lint results and the predicted cost of training. */
typedef struct oxl_survey {
    int images, images_missing; /* images of the model; those missing on disk */
    int images_unregistered;    /* in the image folder, but not in the model */
    int train_views, test_views, masks;
    int cameras, cameras_distorted;
    int width, height; /* size of the largest view as trained, px */
    size_t points, observations;
    /* 1: transparent images outline the scene (oxl_alpha), so a start without points is sound */
    int outlined;
    double mean_track, mean_error;       /* images per point; reprojection error, px */
    double bounds_min[3], bounds_max[3]; /* 1st to 99th percentile of the points, world coordinates */
    double extent;                       /* see oxl_scene_extent */
    double masked;                       /* black fraction of the masks */
    /* fraction of pixels that look the same in all images of a camera, which are ignored */
    double fixed;
    /* images that are not readable, have another aspect ratio or are masked completely */
    int unusable;
    int foreign; /* images that do not fit poses and points */
    /* images that are more blurred, or darker or brighter, than their neighbours; set by oxl_check with
     * quality alone */
    int blurred, badly_exposed;
    double gaussians, memory;       /* predicted: number at the end of the run; peak in bytes */
    double seconds;                 /* predicted by oxl_check: duration with ctx's threads; 0: unknown */
    double memory_free;             /* available now, bytes; 0: unknown */
    char cameras_text[160];         /* "1 camera, OPENCV 1920 x 1080, ..." */
    char text[OXL_SURVEY_TEXT];     /* the lines that `check` prints; each ends in a newline */
    char warnings[OXL_SURVEY_TEXT]; /* warnings; each line ends in a newline */
} oxl_survey;

/* Checks the survey in folder `scene`, and predicts memory and time. quality 1: also decodes every image as
 * training does, compares it with those taken beside it, and logs the blurred and the badly exposed ones.
 * options may be NULL: the draft preset. OXL_ERR_INPUT: the survey cannot be trained; the error text gives
 * the reason. */
OXL_API oxl_result oxl_check(oxl_context *ctx, const char *scene, const oxl_job_options *options, int quality,
                             oxl_survey *out);

/* Logs a warning, in which the model is called `name`, if the model does not seem to cover the survey in the
 * scene's frame: its frame or scale may differ. */
OXL_API oxl_result oxl_model_check_overlap(oxl_context *ctx, const oxl_model *model, const oxl_scene *scene,
                                           const char *name);

/* Trains the survey in folder `scene` and writes to folder `out`: the files of oxl_trained_write;
 * metrics.json, run.json; renders/, training_views/; for each block blocks/KKK/ with its model, log.csv and
 * block.json. A survey that fits in memory (or, with block_points, has no more points than that) is one
 * block, 000. A larger one is cut, and training has three stages: a coarse model of the survey
 * (blocks/coarse/); the blocks, each with the coarse model's other Gaussians as context; the merged model
 * (blocks/whole/). train.iterations is the number of steps of all stages; a step on a window of an image
 * counts as the window's fraction of the pixels. With options->from, training starts
 * from that model instead of the points.
 *
 * During training, a block's folder holds checkpoints. An interrupted run resumes from them when it is called
 * again, and ends with the same bytes as an uninterrupted one; a finished run is not changed. If the callback
 * stops the run (OXL_ERR_INTERRUPTED) or train.max_seconds has passed (OXL_OK), model.ply is the current
 * model, and so is scene.ply if there is one block. A run with other options is not overwritten
 * (OXL_ERR_USAGE) unless options->restart is set. OXL_ERR_BUDGET: ram is too small. options may be NULL: the
 * draft preset. */
OXL_API oxl_result oxl_job_run(oxl_context *ctx, const char *scene, const char *out,
                               const oxl_job_options *options, const oxl_callback *callback);

typedef struct oxl_manifest oxl_manifest;
/* Replaces options by those of an existing run of this survey in folder `out`, which a resumed run keeps;
 * without such a run, options are unchanged. *run holds their strings: free it with oxl_manifest_free after
 * the last use of options. */
OXL_API oxl_result oxl_job_resume(oxl_context *ctx, const char *scene, const char *out,
                                  oxl_job_options *options, oxl_manifest **run);
OXL_API void oxl_manifest_free(oxl_context *ctx, oxl_manifest **run);

typedef struct oxl_render_output {
    oxl_split split; /* the views to render */
    /* 1: also NAME.image.png, the image, and, where a medium is fitted, NAME.clear.png, the render without
     * imaging */
    int images;
    /* 1: also NAME.depth.png (near is bright) and NAME.depth.pfm (float camera z times unit, 0: none, or
     * doubtful) */
    int depth;
    double unit; /* factor of depths: metres per unit of the scene; 0: none (0) */
    int clear;   /* 1: without imaging.txt (0) */
    int replace; /* 1: first removes renders of all views from the folder (0) */
} oxl_render_output;
/* Writes NAME.png of each view, and what else `what` asks for, to a folder, which is created if missing.
 * *count is the number of views written. OXL_ERR_IO: a file cannot be written. */
OXL_API oxl_result oxl_render_views(oxl_context *ctx, const oxl_model *model, const oxl_scene *scene,
                                    const oxl_imaging *imaging, const oxl_render_output *what,
                                    const char *folder, int *count);

/* Gives the path FOLDER/NAME + suffix that oxl_render_views writes for the view named `view`; free with
 * oxl_text_free. In absolute names and names with "..", "/" becomes "_"; a long name is cut. */
OXL_API oxl_result oxl_render_path(oxl_context *ctx, const char *folder, const char *view, const char *suffix,
                                   char **out);

/* Writes a portable float map (Debevec) atomically: (height,width) values, from the top. OXL_ERR_IO: it
 * cannot be written. */
OXL_API oxl_result oxl_write_pfm(oxl_context *ctx, const char *path, const float *value, int width,
                                 int height);

/* Converts metrics to the JSON text of metrics.json; free with oxl_text_free. */
OXL_API oxl_result oxl_metrics_to_json(oxl_context *ctx, const oxl_scene *scene, const oxl_metrics *metrics,
                                       char **out);
/* Converts a survey's check to JSON; free with oxl_text_free. */
OXL_API oxl_result oxl_survey_to_json(oxl_context *ctx, const oxl_survey *survey, char **out);

/* ---------------- JSON: run.json, metrics.json, block.json */

/* JSON is read through a cursor, without building a tree. A value is a pointer to its first byte in the text;
 * NULL is a missing value, without members or number. No function reads past the terminating 0, whatever the
 * text. */

/* Returns the value of an object's member. */
OXL_API const char *oxl_json_member(const char *object, const char *name);
OXL_API double oxl_json_number(const char *object, const char *name); /* NaN: there is none */
OXL_API int oxl_json_is_true(const char *object, const char *name);   /* 0: false, or no such member */
/* Returns the first element of an array or the first key of an object; NULL: there is none. */
OXL_API const char *oxl_json_first(const char *value);
/* Returns the element after an element, or the key after a value; NULL: there is none. */
OXL_API const char *oxl_json_next(const char *value);
OXL_API const char *oxl_json_value(const char *key); /* the value of a key */
/* Returns the first byte after a value, which must not be NULL. */
OXL_API const char *oxl_json_end(const char *value);
/* Reads a number at *cursor, not NULL, whatever the locale, and moves past it; NaN: there is none. */
OXL_API double oxl_json_number_at(const char **cursor);
/* Unescapes a string into `size` bytes, terminated; returns its length, or 0 if the value is not a string or
 * `size` is less than oxl_json_room. */
OXL_API size_t oxl_json_text(const char *value, char *out, size_t size);
/* Returns the size that oxl_json_text needs for a string, else 0. */
OXL_API size_t oxl_json_room(const char *value);
/* Writes the character at s as it is written in a JSON string, and returns the number of its bytes in s. */
OXL_API size_t oxl_json_escape(const char *s, char out[8]);
/* Writes a number as text that parses to the same value, or "null" if it is not finite; returns out. */
OXL_API const char *oxl_json_number_text(char out[48], double value);

/* ---------------- files and terminal */

typedef struct oxl_lock oxl_lock;
/* Locks a folder against writing by other processes until it is unlocked or this process ends; creates the
 * folder if it is missing. OXL_ERR_FAILED: another process holds the lock, and the text names it. oxl_job_run
 * locks its folder itself. */
OXL_API oxl_result oxl_lock_folder(oxl_context *ctx, const char *folder, oxl_lock **out);
OXL_API void oxl_unlock_folder(oxl_context *ctx, oxl_lock **lock); /* *lock may be NULL */

/* Makes a folder and its parents; an existing folder is no error. */
OXL_API oxl_result oxl_make_folder(oxl_context *ctx, const char *path);
OXL_API int oxl_is_folder(const char *path);

/* Writes a path as one word of a POSIX shell, for commands to copy: quoted if necessary, cut at `size`.
 * Returns out. */
OXL_API const char *oxl_shell_word(const char *path, char *out, size_t size);

/* Returns 1 if the model lies beside a scene_clear.ply whose imaging.txt has gains, perhaps poses, and
 * nothing else. Models called scene.* in such a folder were trained without gains. */
OXL_API int oxl_has_gains_alone(oxl_context *ctx, const char *model_path);

/* Opens a file for reading; refuses folders, pipes and devices. NULL: errno has the reason. */
OXL_API FILE *oxl_open(const char *path);
/* Creates NAME.PID.oxl.tmp beside `path` for writing; the caller renames it, `temporary`, to `path`. It
 * neither follows a link of that name nor writes to a file of another process. NULL: errno has the reason. */
OXL_API FILE *oxl_create_beside(const char *path, char *temporary, size_t size);
/* Renames a file, replacing an existing one. Paths are UTF-8 on Windows, too. Not 0: errno has the reason. */
OXL_API int oxl_rename(const char *from, const char *to);
/* Removes a file. Not 0: errno has the reason. */
OXL_API int oxl_remove(const char *path);

/* Returns 1 if standard output (stream 1) or standard error (2) is a terminal, where a progress line can be
 * rewritten. */
OXL_API int oxl_is_terminal(int stream);

#ifdef __cplusplus
}
#endif
#endif
