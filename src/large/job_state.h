/* job_state.h - declares what the files of a job share: its state, its files, the training of its blocks. */
#ifndef OXL_JOB_STATE_H
#define OXL_JOB_STATE_H

#include "large.h"
#include "../core/vecmath.h"
#include "../survey/image.h"
#include "../survey/imaging.h"

/* Lists fractions of a run in blocks (docs/SCALE.md). */
#define JOB_COARSE 0.15 /* Gives the coarse model of the survey this fraction of a run in blocks. */
#define JOB_MERGED 0.35 /* Gives the merged model this fraction of a run in blocks. */
/* Gives the merged model this fraction of a run with pruning or second lobes, which must end before it. */
#define JOB_MERGED_LATER 0.2

struct job {
    oxl_context *ctx;
    const char *scene_path, *out;
    oxl_job_options options;
    oxl_job_options asked;        /* options before the iterations were counted for the survey */
    const oxl_callback *callback; /* the caller's, or NULL */
    oxl_callback progress;        /* job_progress of this job */
    oxl_scene *scene;             /* the survey */
    struct oxl_imaging imaging;   /* of the last model that was read or trained */
    oxl_survey survey;
    struct partition partition;
    double origin[3];
    struct text key;           /* "job": {...}, "found": {...} of run.json: all that a block depends on */
    struct text inputs;        /* "inputs": {...} of run.json */
    struct text notes;         /* log lines outside of the blocks' training */
    struct block_record total; /* sum of the records of blocks, coarse and merged model */
    int block;                 /* the block in training, JOB_COARSE_MODEL or JOB_MERGED_MODEL */
    int unfinished;            /* blocks that are not finished, e.g. stopped by --max-time */
    int decoded;               /* 1: OUT/blocks/decoded holds decoded images */
    double started;
    double done_before;           /* fraction of the run that earlier processes did */
    double done, stage;           /* fractions of the run: before this stage; of this stage */
    int stage_first, stage_until; /* first and last step of this stage */
    int stage_viewers;            /* steps of a model for viewers behind those of the merged model */
    uint64_t seed;                /* seed of the context, restored at the end */
    oxl_model start;              /* --from's; count 0: the run starts from the points */
    /* lock of OUT: shared by processes that train single blocks, otherwise exclusive; NULL: OUT cannot be
     * written to */
    oxl_lock *lock;
};

/* ---------------- job_state.c */

/* Stands in the place of a block's number for the two models that are not blocks. */
enum { JOB_COARSE_MODEL = -2, JOB_MERGED_MODEL = -3 };
/* Returns the path OUT/blocks/KKK, OUT/blocks/coarse or OUT/blocks/whole, in a temporary like PATH. */
OXL_INTERNAL const char *job_block_folder(char out[PATH_LENGTH], const struct job *job, int block);
#define JOB_BLOCK(job, block) job_block_folder((char[PATH_LENGTH]){0}, job, block)
/* Reads the record of the one block, the coarse or the merged model; see block_read. */
OXL_INTERNAL oxl_result job_read_record(struct job *job, const char *folder, struct block_record *out);
/* Adds a record to job->total. */
OXL_INTERNAL void job_add_record(struct job *job, const struct block_record *record);
OXL_INTERNAL int job_progress(void *user, const oxl_progress *progress);
/* Returns the training of the whole run in a folder, which each stage changes to its own. */
OXL_INTERNAL struct block_task job_task(struct job *job, const char *folder);
/* Sets what the budget has left of the options. */
OXL_INTERNAL void job_use_budget(const struct job *job, const oxl_job_options *fitted,
                                 struct block_task *task);
/* Trains a block in the time that the whole run has left. */
OXL_INTERNAL oxl_result job_train_task(struct job *job, struct block_task *task);
/* Decides whether decoded images are kept in files. */
OXL_INTERNAL oxl_result job_plan_decoded(struct job *job);
/* Limits decoded images in memory to `most` bytes; if they have files, in blocks also to the average
 * size of a block's images. Limits on Gaussians do not depend on that, since a machine with a full
 * disk has no files. */
OXL_INTERNAL void job_set_cache(const struct job *job, size_t most);
/* Merges the blocks' models and imaging. */
OXL_INTERNAL oxl_result job_merge(struct job *job, oxl_model *out);
/* Adds a block's gains to the mean over blocks, and copies its lamp and medium. count: (views) blocks
 * so far that have the view. */
OXL_INTERNAL void job_add_imaging(struct oxl_imaging *all, int *count, const struct oxl_imaging *block);
/* Reads the model of a block, the coarse or the merged one. */
OXL_INTERNAL oxl_result job_read_model(struct job *job, int block, oxl_model *out);
OXL_INTERNAL void job_remove_decoded(struct job *job);
/* Removes records and checkpoints of all blocks. */
OXL_INTERNAL void job_drop_blocks(const struct job *job);

/* ---------------- block_plan.c: windows, steps and budget of a block */

struct block_plan {
    /* steps of the block's run; the coarse model stands for those up to `first`, the merged
     * model for those after `last` */
    int iterations;
    int first, last;             /* first and last step of the block's own training */
    double gaussians;            /* limit of the number of Gaussians */
    double fraction;             /* fraction of the coarse model's Gaussians */
    struct image_window *window; /* (views) trained part of each view; width 0: none */
    int views;                   /* views with a window */
    double area;                 /* px of all windows */
    oxl_model own, surroundings; /* the coarse model's Gaussians in the block's box; others that it sees */
};
OXL_INTERNAL oxl_result block_plan_make(struct job *job, int block, const oxl_model *coarse,
                                        struct block_plan *out);
/* Returns the merged model's fraction of the run. */
OXL_INTERNAL double block_plan_merged_fraction(const struct job *job);
OXL_INTERNAL void block_plan_free(oxl_context *ctx, struct block_plan *plan);

/* ---------------- blocks.c: several blocks, trained as one model */

/* Trains all stages of the run that are not finished. */
OXL_INTERNAL oxl_result blocks_run(struct job *job);

#endif
