/* oceanxl_job.h - survey folder in, output folder out: what the program oceanxl needs beside the library in oceanxl.h.
 *
 * The whole job (oxl_job_run), its options by name, the partition into blocks, predictions, and results as JSON.
 * The conventions are those of oceanxl.h.
 */
#ifndef OCEANXL_JOB_H
#define OCEANXL_JOB_H

#include "oceanxl.h"

#ifdef __cplusplus
extern "C" {
#endif

/* ---------------------------------------------------------------- blocks */

/* A survey too large for one model is cut into blocks along its principal axes [OceanXL sec. 3.1, Alg. 1]. */
typedef enum oxl_partition_kind {
    OXL_PARTITION_AUTO = 0, /* 2D when the third principal extent is less than 0.3 of the second, else 3D */
    OXL_PARTITION_2D,       /* never cut across the third principal axis */
    OXL_PARTITION_3D,
    OXL_PARTITION_NONE /* one block, whatever its size */
} oxl_partition_kind;

typedef enum oxl_cut {
    OXL_CUT_BALANCED = 0, /* where both sides hold as equal numbers of points as a cut at 0.3 to 0.7 of the box can make them */
    OXL_CUT_MIDPOINT      /* at 0.5, as BlockGaussian does: the baseline */
} oxl_cut;

typedef struct oxl_partition_options {
    int                block_points; /* a block of more points than this is cut */
    oxl_partition_kind kind;
    oxl_cut            cut;
} oxl_partition_options;

OXL_API oxl_partition_options oxl_partition_options_default(void);

/* ---------------------------------------------------------------- the whole job */

typedef struct oxl_job_options {
    oxl_scene_options     scene;
    oxl_train_options     train;
    oxl_partition_options partition;
    const char           *preset;  /* where they came from; run.json repeats it */
    int                   renders; /* 1: pictures of the held-out views go to OUT/renders */
    size_t                ram;     /* bytes that the run may take at its peak; blocks, cache and Gaussians follow; 0: any */
    int                   block;   /* train this block alone and do not merge; -1: all */
    float                 refine;  /* merged blocks are refined together for this share of their steps; 0: not */
    int                   restart; /* 1: give up unfinished work of other options in OUT */
    uint64_t              seed;    /* 0: the context's */
} oxl_job_options;

OXL_API oxl_job_options oxl_job_options_default(oxl_preset preset);

/* ---------------------------------------------------------------- options by name */

/* One row for each option of the training job: src/job/options.c holds the table. Defaults, parsing, range checks, run.json, the command
 * line, its help, the manual page and docs/OPTIONS.md are made from it. A program may keep a table of the same type for options of its own. */
typedef enum oxl_option_kind {                     /* what the field holds, and its text */
                               OXL_OPTION_FLAG,    /* int, 0 or 1: no text, or true | false */
                               OXL_OPTION_INT,     /* int */
                               OXL_OPTION_LONG,    /* long */
                               OXL_OPTION_SEED,    /* uint64_t */
                               OXL_OPTION_FLOAT,   /* float: 0.05 or 1/255 */
                               OXL_OPTION_DOUBLE,  /* double */
                               OXL_OPTION_CHOICE,  /* an enum that counts from 0: a word of `value` */
                               OXL_OPTION_BYTES,   /* size_t: 1000000, 512M, 4G; K, M, G, T are powers of 1024 */
                               OXL_OPTION_SECONDS, /* double: 90s, 20m, 8h, 1d */
                               OXL_OPTION_TEXT,    /* const char *, borrowed; NULL: not given */
                               OXL_OPTION_RGB,     /* float[3]: 0,0.1,0.2 */
                               OXL_OPTION_PLACE,   /* double[3]: X,Y,Z */
                               OXL_OPTION_SIZE,    /* int[2]: 400x260 */
                               OXL_OPTION_PRESET, /* const char *; setting it sets all options of the job to the preset's defaults */
                               OXL_OPTION_UCD,    /* oxl_ucd, but for its bands, as oxl_ucd_parse reads it */
                               OXL_OPTION_KEEP, /* oxl_keep, as oxl_keep_parse reads it */
                               OXL_OPTION_LIMIT /* float: 0.0002; or 90%, held as -0.9 */
} oxl_option_kind;

typedef enum oxl_option_tier { OXL_TIER_BASIC = 0, OXL_TIER_ADVANCED, OXL_TIER_EXPERT } oxl_option_tier;

enum {                             /* what an option of the job is for: bits of oxl_option.use */
       OXL_OPTION_OF_SURVEY   = 1, /* reading a survey */
       OXL_OPTION_OF_TRAINING = 2, /* training, in a run or in a study */
       OXL_OPTION_OF_RUN      = 4, /* one run, or what predicts it */
       OXL_OPTION_OF_OUT      = 8, /* what is in OUT already */
       OXL_OPTION_OF_BLOCK    = 16,
       OXL_OPTION_OF_MERGE    = 32,
       OXL_OPTION_OF_RESULT =
           64 /* the bytes of every block depend on it: it stands in run.json's "job", named as here with _ for - */
};

typedef struct oxl_option {
    const char     *name;  /* "sh-degree" */
    const char     *value; /* "auto|0..3"; NULL: a flag. A number whose value begins with WORD| takes that word too, held as -1 */
    oxl_option_kind kind;
    size_t          at;        /* offset of the field: in oxl_job_options; in what the program's own table is about */
    double          low, high; /* of numbers, both allowed */
    const char     *preset[3]; /* default as text, by oxl_preset; NULL: 0 */
    oxl_option_tier tier;
    unsigned        use;
    const char     *group, *help; /* help with the unit, without the default */
    const char     *alias;        /* former name, still read; NULL: none */
} oxl_option;

OXL_API int               oxl_option_count(void);
OXL_API const oxl_option *oxl_option_at(int index);          /* 0 .. count - 1; 0 is the preset */
OXL_API const oxl_option *oxl_option_find(const char *name); /* by its name or former name; NULL: there is none */
/* Reads text into the option's field; the text is kept (borrowed) for folders. OXL_ERR_USAGE: the field is as it was, and error, which may
 * be NULL, names the option, what was seen, what is wanted and a fix. */
OXL_API oxl_result  oxl_option_set(const oxl_option *option, void *options, const char *text, char *error, size_t error_size);
/* The shortest text that oxl_option_set reads back to the same value; "" for a folder that was not given. Returns out. */
OXL_API const char *oxl_option_get(const oxl_option *option, const void *options, char *out, size_t size);
/* Its member in run.json: sh_degree, images_folder. Returns out. */
OXL_API const char *oxl_option_member(const oxl_option *option, char out[40]);
/* OXL_ERR_USAGE when a value is out of its range; names the first such option. */
OXL_API oxl_result  oxl_job_options_check(oxl_context *ctx, const oxl_job_options *options);

/* What a survey holds and what training it would take: a lint report. */
typedef struct oxl_survey {
    int    images, images_missing; /* listed in images.txt; of them not on disk */
    int    train_views, test_views, masks;
    int    cameras, cameras_distorted;
    int    width, height; /* of the largest view as trained, px */
    size_t points, observations;
    double mean_track, mean_error;       /* images a point, reprojection error in px */
    double bounds_min[3], bounds_max[3]; /* 1st to 99th percentile of the points, world coordinates */
    double extent;                       /* see oxl_scene_extent */
    double missed;           /* of a point in a track: the share not in their images, those with a wrong pose left out */
    double masked;           /* share of the masks that is black; oxl_check alone fills this and the next */
    int    unusable;         /* images that cannot be read, are of another shape or masked all over */
    double gaussians;        /* predicted at the end of the run */
    double memory, seconds;  /* predicted: peak in bytes, duration on ctx's threads */
    double seconds_range[2]; /* the least and the most that the duration may be */
    double memory_free;      /* now; 0: unknown */
    char   cameras_text[160], text[2048]; /* "1 x OPENCV 1920 x 1080, distorted"; the report in lines for people */
} oxl_survey;

/* OXL_ERR_INPUT when the survey cannot be trained; the error says why. out->text ends in a newline. */
OXL_API oxl_result oxl_check(oxl_context *ctx, const char *scene, const oxl_job_options *options, oxl_survey *out);

/* Trains the survey in folder `scene` and leaves in folder `out`: scene.ply, scene_standard.ply when that is not the
 * standard's 62 columns, metrics.json, run.json and renders/; and for each block
 * blocks/KKK/ with model.ply, log.csv and block.json. A survey of at most block_points points is one block, 000, trained as it is;
 * a larger one is cut first (partition.txt, partition.svg, and a COLMAP text export in each blocks/KKK/), merged, and refined on all
 * images in blocks/together/ (see `refine`).
 *
 * While a block is trained, its folder holds checkpoints. A run that was stopped, by whatever, goes on from there when it is
 * called again, to the same bytes as if nothing had been; a finished one is left as it is. When the callback stops the run, or
 * train.max_seconds is over, model.ply is the model so far (scene.ply too, of one block); OXL_ERR_INTERRUPTED or OXL_OK is returned.
 * An unfinished run of other options is not overwritten (OXL_ERR_USAGE) unless options->restart says so; when nobody can tell
 * whose work it is (run.json is lost), its checkpoints are kept as NAME.other.
 * options may be NULL: the draft preset. */
OXL_API oxl_result oxl_job_run(oxl_context *ctx, const char *scene, const char *out, const oxl_job_options *options,
                               const oxl_callback *callback);

/* ---------------------------------------------------------------- the survey in blocks */

typedef struct oxl_block {
    size_t points, start_points;       /* at home in it; that its training starts from */
    int    base_views, border_views;   /* views that see much of what they see in it; views that see much of it */
    double gaussians, memory, seconds; /* predicted, as in oxl_survey */
} oxl_block;

typedef struct oxl_balance { /* peak: the largest over the mean; spread: standard deviation over the mean; 1 and 0 are perfect */
    int    blocks;
    double points_peak, points_spread, views_peak, views_spread;
    double memory, seconds, longest; /* predicted: of the block that takes most; of all, one after the other; of the longest */
} oxl_balance;

typedef struct oxl_partition_report {
    int         dimensions; /* 2 or 3 */
    double      extent[3];  /* along the principal axes, in the survey's unit */
    oxl_cut     cut;        /* that was used */
    oxl_balance balance[2]; /* by oxl_cut: as it is, and as it would be */
    int         block_count;
    oxl_block  *block;
} oxl_partition_report;

/* Cuts the survey in folder `scene` into blocks and leaves in folder `out`: blocks/000/... as COLMAP text exports, partition.txt and
 * partition.svg. report may be NULL; options may be NULL: the draft preset. Images need not be there, but when their folder is,
 * views whose image is missing are left out as in training. */
OXL_API oxl_result oxl_partition(oxl_context *ctx, const char *scene, const char *out, const oxl_job_options *options,
                                 oxl_partition_report *report);
OXL_API void       oxl_partition_report_free(oxl_context *ctx, oxl_partition_report *report);
OXL_API oxl_result oxl_partition_to_json(oxl_context *ctx, const oxl_partition_report *report, char **out);
/* Merges the finished blocks of the run in folder `out` into scene.ply, refines them together and judges the whole: what oxl_job_run does
 * at its end. refine: as in oxl_job_options, in the place of the run's; -1: the run's. callback may be NULL. */
OXL_API oxl_result oxl_merge(oxl_context *ctx, const char *out, float refine, const oxl_callback *callback);

/* The options of the run in folder `out`, if there is one of this survey: a run that is resumed keeps what it was given. Otherwise
 * options stay as they are. Their strings lie in *run: free it, by oxl_manifest_free, when the options are no longer used. */
typedef struct oxl_manifest oxl_manifest;
OXL_API oxl_result          oxl_job_resume(oxl_context *ctx, const char *scene, const char *out, oxl_job_options *options,
                                           oxl_manifest **run);
OXL_API void                oxl_manifest_free(oxl_context *ctx, oxl_manifest **run);

/* Pictures of a split into a folder: NAME.png for each view; with images NAME.photo.png; with depth NAME.depth.png
 * (near is bright), NAME.depth.pfm (float camera z, 0: nothing there) and NAME.depth16.png (16-bit grey: camera z in thousandths of
 * a unit, of a metre with `unit`; 0: nothing there, 65535: that or more). */
typedef struct oxl_pictures {
    oxl_split split;
    int       images, depth;
    double    unit;  /* depths are multiplied by it: metres a unit of the scene (0: they stay) */
    int       clear; /* 1: the scene itself, without what imaging.txt says of the image (0) */
} oxl_pictures;
OXL_API oxl_result oxl_render_views(oxl_context *ctx, const oxl_model *model, oxl_scene *scene, const oxl_pictures *what,
                                    const char *folder, int *count);

/* JSON as metrics.json holds it; free it with oxl_text_free. */
OXL_API oxl_result oxl_metrics_to_json(oxl_context *ctx, const oxl_scene *scene, const oxl_metrics *metrics, char **out);
OXL_API oxl_result oxl_survey_to_json(oxl_context *ctx, const oxl_survey *survey, char **out);

/* ---------------------------------------------------------------- files and terminal */

OXL_API oxl_result oxl_make_folder(oxl_context *ctx, const char *path); /* with its parents; an existing folder is no error */
OXL_API int        oxl_is_folder(const char *path);

/* 1: standard output (stream 1) or standard error (2) is a terminal, where a progress line can be rewritten. */
OXL_API int oxl_is_terminal(int stream);

#ifdef __cplusplus
}
#endif
#endif
