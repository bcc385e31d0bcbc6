/* job_state.h - shared by the files of a job: its state, its files, the training of its blocks. */
#ifndef OXL_JOB_STATE_H
#define OXL_JOB_STATE_H

#include "large.h"
#include "../core/vecmath.h"
#include "../survey/image.h"
#include "../survey/imaging.h"

/* Fractions of a run in blocks (docs/SCALE.md). */
#define JOB_COARSE 0.15      /* the coarse model of the survey */
#define JOB_MERGED 0.35      /* the merged model */
#define JOB_MERGED_LATER 0.2 /* with pruning or second lobes, which must end before */
#define JOB_ROUNDS 4         /* rounds of each block between the two */
#define JOB_WAIT 0.5         /* s between checks of what other processes have done */

/* Files of OUT that are written under a temporary name; renders/ has RENDER_FILES. */
#define JOB_FILES                                                                              \
    "run.json metrics.json partition.txt partition.svg imaging.txt scene.ply scene_clear.ply " \
    "scene_standard.ply report.html"

struct start {
    oxl_model model; /* count 0: the run starts from the points */
    int after;       /* iterations of the finished run that is continued; 0: the model is --from's */
};

struct job {
    oxl_context *ctx;
    const char *scene_path, *out;
    oxl_job_options options;
    const oxl_callback *callback; /* the caller's, or NULL */
    oxl_scene *scene;             /* the survey; NULL: not loaded */
    oxl_survey survey;
    struct partition partition;
    double origin[3];
    oxl_large_model result;
    struct text line, found;   /* "job": {...} and "found": {...} of run.json */
    struct text key;           /* both: what a block depends on */
    struct text device;        /* line of the run that another device began; or empty */
    int is_mixed;              /* 1: the run was begun on one device and continued on another */
    struct text notes;         /* log lines outside of the blocks' training */
    struct block_record total; /* over the blocks */
    int block;                 /* now in training; or JOB_COARSE_MODEL, JOB_MERGED_MODEL */
    int unfinished;            /* blocks that were stopped by --max-time */
    char *decoded;             /* OUT/blocks/decoded, for decoded images; or NULL */
    double started;
    double done_before;           /* fraction of the run that earlier processes did */
    double done, stage;           /* fractions of the run: before the present stage; of the stage */
    int stage_first, stage_until; /* steps of the present stage */
    uint64_t seed;                /* of the context, restored at the end */
    struct start start;
    oxl_lock *lock;   /* on OUT: shared by processes that train single blocks, else exclusive */
    int is_read_only; /* OUT holds a finished run and cannot be written to: lock is NULL */
};

/* ---------------- job_state.c */

/* Refuses folders of the run that are links: OUT itself may be one, as its user has chosen it. */
OXL_INTERNAL oxl_result job_refuse_links(struct job *job);
/* Names what is trained in a folder beside blocks 0 .. block_count - 1; takes the place of a block's number.
 */
enum { JOB_COARSE_MODEL = -2, JOB_MERGED_MODEL = -3 };
/* Makes OUT/blocks/KKK, OUT/blocks/coarse or OUT/blocks/whole, a temporary like PATH. */
OXL_INTERNAL const char *job_block_folder(char out[PATH_LENGTH], const struct job *job, int block);
#define JOB_BLOCK(job, block) job_block_folder((char[PATH_LENGTH]){0}, job, block)
OXL_INTERNAL oxl_result job_load(struct job *job); /* the survey */
/* Reads the record of the one block, the coarse or the merged model: none, with a warning, if the record or
 * a model that is used as it is was damaged. It is trained again, and becomes the same. */
OXL_INTERNAL oxl_result job_read_record(struct job *job, const char *folder, struct block_record *out);
OXL_INTERNAL void job_add_record(struct job *job, const struct block_record *record);
OXL_INTERNAL int job_progress(void *user, const oxl_progress *progress);
OXL_INTERNAL void job_limit_time(const struct job *job, oxl_train_options *options);
/* Decides whether decoded images are kept in files. */
OXL_INTERNAL oxl_result job_plan_decoded(struct job *job);
/* Limits the images in memory to `most` bytes, and in blocks to a block's part of the images that have a
 * file. Limits on Gaussians do
 * not depend on that: a machine with a full disk has no files. */
OXL_INTERNAL void job_set_cache(const struct job *job, size_t most);
/* Merges the blocks' models and imaging. */
OXL_INTERNAL oxl_result job_merge(struct job *job, int standard, oxl_model *out);
/* Adds a block's gains to the mean over blocks, and copies its lamp and medium; count (views): blocks that
 * contained the view so far. */
OXL_INTERNAL void job_add_imaging(struct imaging *all, int *count, const struct imaging *block);
/* Joins the imaging of several blocks: log gains of mean 0, lamp and medium. */
OXL_INTERNAL oxl_result job_join_imaging(struct job *job, struct imaging *out);
/* Reads a block's model, the coarse or the merged one; its standard model, where there is one. */
OXL_INTERNAL oxl_result job_read_model(struct job *job, int block, int standard, oxl_model *out);
OXL_INTERNAL oxl_result job_open_model(struct job *job, int block, int standard, oxl_large_model *out);
/* Writes a file of OUT. */
OXL_INTERNAL oxl_result job_write(struct job *job, const char *name, const struct text *t);
OXL_INTERNAL void job_remove_decoded(struct job *job);
OXL_INTERNAL void job_drop_checkpoints(struct job *job);
/* Forgets that models are trained, at --restart of a finished run. */
OXL_INTERNAL void job_drop_records(struct job *job);

/* ---------------- block_plan.c: windows, steps and budget of each block */

struct block_plan {
    /* of the block's run; the coarse model stands for its steps up to `first`, */
    int iterations;
    int first, last;             /* the merged model for those after `last` */
    int views;                   /* of the survey */
    double gaussians;            /* limit of their number */
    double fraction;             /* of the survey's pixels, by blend weight */
    double work;                 /* fraction of all blocks' pixels */
    struct image_window *window; /* (views) trained part of each view; width 0: none */
    uint8_t *shows;              /* (views) 1: the block's Gaussians may be visible in it */
    uint8_t *neighbour;          /* (blocks) 1: shares a view */
};
/* Plans all blocks; writes plan.txt of each. */
OXL_INTERNAL oxl_result block_plan_make(struct job *job, const oxl_model *coarse);
/* Reads a block's plan; views 0: there is none. */
OXL_INTERNAL oxl_result block_plan_read(struct job *job, int block, struct block_plan *out);
/* Returns 0 if the plan is not of these views. */
OXL_INTERNAL int block_plan_fits(const struct block_plan *plan, const oxl_scene *scene);
/* Returns the merged model's fraction of the run. */
OXL_INTERNAL double block_plan_merged_fraction(const struct job *job);
OXL_INTERNAL void block_plan_free(oxl_context *ctx, struct block_plan *plan);
OXL_INTERNAL int block_plan_until(const struct block_plan *plan, int round); /* the last step of a round */
/* Splits the coarse model into the Gaussians in a block's box, and all others. */
OXL_INTERNAL oxl_result block_plan_split(struct job *job, int block, const oxl_model *coarse, oxl_model *own,
                                         oxl_model *others);

/* ---------------- rounds.c: several blocks, trained as one model */

OXL_INTERNAL oxl_result rounds_run(struct job *job);
/* groups.c: the merged model, where it does not fit into memory */
OXL_INTERNAL oxl_result groups_run(struct job *job, const char *folder);
OXL_INTERNAL oxl_result
/* Trains the merged model after all blocks of `--block`; an error if a block is not finished. */
rounds_collect(struct job *job);

#endif
