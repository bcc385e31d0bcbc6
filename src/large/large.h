/* large.h - what one model in memory does not need: predicted memory and time, budget, blocks, rounds. */
#ifndef OXL_LARGE_H
#define OXL_LARGE_H

#include "../core/core.h"
#include "../train/forecast.h"
#include "../train/train.h"
#include "../../oceanxl_job.h"

/* ---------------- partition_make.c: balanced blocks of a survey */

struct partition_box { /* half-open, low <= x < high, in the partition's frame; outer faces are infinite */
    double low[3], high[3];
};
static inline int partition_contains(const struct partition_box *box, const double frame[3])
{
    int inside = 1;
    for (int i = 0; i < 3; i++) inside &= frame[i] >= box->low[i] && frame[i] < box->high[i];
    return inside;
}
struct partition_block {
    struct partition_box box;      /* disjoint boxes that cover all space */
    struct partition_box expanded; /* wider by 5 % of its size on each side: for the export */
    struct partition_box finite;   /* `box` clipped to the trimmed extents of the points */
    size_t points, start_points;   /* inside `box`; initial: in `expanded` or seen by its views */
    int base_views, border_views;  /* training views by overlap [OceanXL sec. 3.1, BlockGaussian] */
};
struct partition {
    double rotation[9]; /* rows: the principal axes, longest first; frame = R (world - origin) */
    double origin[3];   /* world */
    double extent[3];   /* l1 >= l2 >= l3, trimmed */
    int dimensions;     /* 2: the third axis is never cut; 3 */
    double memory;      /* limit of a process, bytes, that determined the number of blocks; 0: no limit */
    int block_count;
    struct partition_block *block;
    /* the block of each point and view, for the export; NULL if read from partition.txt */
    struct partition_plan *plan;
};
OXL_INTERNAL void partition_to_frame(const struct partition *p, const double world[3], double out[3]);

/* Cuts a scene from files into blocks; the scene must outlive the partition. It stays one block if it is
 * small enough, if the options say so, or if it has no tracks, which tell the points of a view. The log
 * states the reason, and the evidence for 2D or 3D. */
OXL_INTERNAL oxl_result partition_make(oxl_context *ctx, const oxl_scene *scene,
                                       const oxl_partition_options *options, struct partition *out);
OXL_INTERNAL void partition_free(oxl_context *ctx, struct partition *p);
/* Frees what refers to the scene: the partition no longer does. */
OXL_INTERNAL void partition_free_plan(oxl_context *ctx, struct partition *p);

/* Write and read partition.txt, which reads back to the same bits (partition_file.c). */
OXL_INTERNAL oxl_result partition_write(oxl_context *ctx, const char *path, const struct partition *p);
OXL_INTERNAL oxl_result partition_read(oxl_context *ctx, const char *path, struct partition *out);

/* Writes partition.svg and, last, partition.txt into folder `out`; partition_export writes blocks/KKK before
 * them, COLMAP text exports for other programs. p is as partition_make left it. (partition_export.c) */
OXL_INTERNAL oxl_result partition_save(oxl_context *ctx, const struct partition *p, const char *out);
OXL_INTERNAL oxl_result partition_export(oxl_context *ctx, const struct partition *p, const char *out);

/* ---------------- checkpoint.c: files of a run's state */

#define CHECKPOINT_VERSION 13
/* Writes FOLDER/checkpoint.oxl and keeps the previous one as checkpoint.prev.oxl. `key`: all inputs of the
 * result. */
OXL_INTERNAL oxl_result checkpoint_write(oxl_context *ctx, const char *folder, const char *key,
                                         archive_state *state, void *user);
/* Reads the newest complete checkpoint with this key. None: *found = 0, and the state is unchanged. */
OXL_INTERNAL oxl_result checkpoint_read(oxl_context *ctx, const char *folder, const char *key,
                                        archive_state *state, void *user, int *found);
/* Keeps a run's state in such files. */
OXL_INTERNAL struct train_store checkpoint_in(const char *folder, const char *key);
OXL_INTERNAL uint64_t checkpoint_sum(const void *bytes, size_t size); /* the checksum of checkpoints */
/* Returns the step of the newest whole checkpoint with this key in a folder; 0: there is none. */
OXL_INTERNAL int checkpoint_step(oxl_context *ctx, const char *folder, const char *key);
OXL_INTERNAL void checkpoint_remove(const char *folder, int others); /* others: also NAME.other */

/* ---------------- merge.c: rows of models */

/* Appends the rows of `from` with keep (count) not 0, or all with keep NULL, relative to into's origin. The
 * SH degree of `into` grows to that of `from`, missing coefficients are 0; rows with a second lobe stay in
 * front. On failure `into` is unchanged. */
OXL_INTERNAL oxl_result merge_rows(oxl_context *ctx, const oxl_model *from, const uint8_t *keep,
                                   oxl_model *into);
/* Merges model files into one, page by page; rows with a second lobe come first. */
OXL_INTERNAL oxl_result merge_files(oxl_context *ctx, char *const *path, int count, const double origin[3],
                                    const char *out);
/* Marks in inside (count) the Gaussians whose centres lie in the block's box; a centre that is not finite
 * lies in none. */
OXL_INTERNAL void merge_mark(const struct partition *p, int block, const oxl_model *model, uint8_t *inside);

/* limit of what is searched for or believed: parameters alone would be 236 GB */
#define JOB_GAUSSIANS_MAX 1e9

/* ---------------- cost.c: predicted Gaussians, memory and time */

/* per Gaussian beside its parameters: projection, tile lists, gradient slots */
#define COST_SPLAT_BYTES 300.0
struct cost_load {               /* counts of a survey or of a block */
    size_t points, observations; /* initial points; (point, view) pairs */
    double share;                /* as a look has it (look.c); 0: not known */
    int views;
    /* pixels of all views; of the training views; of the largest view */
    double pixels, schedule_pixels, largest;
    double largest_file; /* pixels of the largest image file */
    /* Gaussians of other blocks in its views, per Gaussian of its own */
    double context;
};
struct cost {
    double gaussians, memory, seconds; /* at the end of the run; peak, bytes; with ctx's threads */
};
/* Returns the steps of a run with so many images (docs/SCALE.md). */
OXL_INTERNAL int cost_iterations(const oxl_job_options *options, int images);
OXL_INTERNAL struct cost_load cost_load_of_scene(const oxl_scene *scene);
/* Counts the load of a block; p by partition_make. */
OXL_INTERNAL struct cost_load cost_load_of_block(const struct partition *p, int block);
OXL_INTERNAL struct cost cost_estimate(const oxl_context *ctx, const oxl_job_options *options,
                                       const struct cost_load *load);
/* Predicts the peak memory, bytes, of a run that ends with so many Gaussians. */
OXL_INTERNAL double cost_memory(const oxl_job_options *options, const struct cost_load *load,
                                double gaussians);
/* Predicts the Gaussians that a run ends with. */
/* Predicts the memory that a device takes for training, by kernels' counts. */
OXL_INTERNAL double cost_device_memory(const oxl_job_options *options, const struct cost_load *load,
                                       double gaussians);
OXL_INTERNAL double cost_gaussians(const oxl_job_options *options, const struct cost_load *load);
/* Predicts the duration for all blocks of the scene, from the steps of a look, or from the cost where there
 * was none. range: lower and upper limit. */
OXL_INTERNAL double cost_seconds(const oxl_scene *scene, const oxl_job_options *options,
                                 const struct cost *cost, const struct look *look, double range[2]);

/* ---------------- budget.c: --ram */

/* Sets image cache and largest number of Gaussians so that the load fits options->ram (0: no limit); returns
 * 0 if it cannot. */
OXL_INTERNAL int budget_fit(const oxl_context *ctx, const struct cost_load *load, oxl_job_options *o);
/* Returns 1 if a run without trials, with so many Gaussians at its end, fits options->ram. */
OXL_INTERNAL int budget_fits(const struct cost_load *load, const oxl_job_options *o, double gaussians);
OXL_INTERNAL size_t budget_cache(const oxl_job_options *o); /* of images, bytes */
/* Returns the most Gaussians of a run without trials that fit options->ram. */
OXL_INTERNAL double budget_max_gaussians(const struct cost_load *load, const oxl_job_options *o);
/* Fits as budget_fit a model that may have fewer Gaussians than the survey has points. */
OXL_INTERNAL int budget_limit_gaussians(const oxl_context *ctx, const struct cost_load *load,
                                        oxl_job_options *o);
OXL_INTERNAL oxl_result budget_refuse(oxl_context *ctx, const struct cost_load *load,
                                      const oxl_job_options *o);
/* Returns --ram; without it, and without a set number of blocks, the available memory if the run may exceed
 * it; 0: no limit. */
OXL_INTERNAL size_t budget_limit(const oxl_scene *scene, const oxl_job_options *o);
/* Makes a partition whose blocks each fit this limit. OXL_ERR_BUDGET: even the smallest blocks do not. */
OXL_INTERNAL oxl_result budget_partition(oxl_context *ctx, const oxl_scene *scene, const oxl_job_options *o,
                                         struct partition *out);

/* ---------------- nonfinite_record.c: counts of values that are not finite, in records */

OXL_INTERNAL void nonfinite_add(oxl_nonfinite *to, const oxl_nonfinite *from);
/* Adds the counts as members of a JSON object, each followed by a comma. */
OXL_INTERNAL void nonfinite_add_json(struct text *t, const oxl_nonfinite *n);
OXL_INTERNAL void nonfinite_read_json(const char *text, oxl_nonfinite *n);

/* ---------------- block.c: the training of one block in its folder */

/* Files of the folder that are written under a temporary name. */
#define BLOCK_FILES "checkpoint.oxl block.json plan.txt log.csv imaging.txt model.ply model_standard.ply"

enum { BLOCK_SUMS = 3 };
struct block_record { /* block.json */
    /* trained: all steps are done, scene_standard.ply may be missing */
    int exists, trained, finished, iterations;
    int idle;                 /* 1: a block with nothing to train: it has no checkpoint */
    int damaged;              /* 1: block.json is there, but is not as it was written; `exists` is 0 */
    uint64_t sum[BLOCK_SUMS]; /* of model.ply, imaging.txt, model_standard.ply; 0: none */
    size_t gaussians;
    double seconds, peak, predicted_seconds, predicted_peak; /* peaks in bytes */
    oxl_nonfinite nonfinite;
};
struct block_task {
    const char *folder, *key; /* key: what the result depends on */
    oxl_train_options train;
    const oxl_callback *callback;
    const oxl_model *start;   /* a trained model that is refined; NULL: the scene's points */
    const oxl_model *from;    /* starts instead of the points; NULL: the points do */
    const oxl_model *context; /* this and the next three as in struct train_task */
    const struct image_window *window;
    int first, until;
    int viewed; /* views that are rendered after the run; for the time left */
    /* steps that refine model_standard.ply, the model without second lobes; 0: it is not made */
    int standard;
    double predicted_seconds, predicted_peak;
};
/* Returns the options of a run of `steps` further steps from a finished model: the number of Gaussians does
 * not change. */
OXL_INTERNAL oxl_train_options block_refinement(const oxl_train_options *run, int sh_degree, int steps);
/* Returns the equivalent number of steps of model_standard.ply after such a run. */
OXL_INTERNAL int block_standard_steps(const oxl_train_options *run);
OXL_INTERNAL oxl_result block_read(oxl_context *ctx, const char *folder, const char *key,
                                   struct block_record *out);
/* Checks the files of BLOCK_SUMS. *whole: they are those that the record was written with. */
OXL_INTERNAL oxl_result block_check(oxl_context *ctx, const char *folder, const struct block_record *record,
                                    int *whole);
/* Adds what the training of a block decided, the members of a JSON object; nothing when there is no
 * block.json. */
OXL_INTERNAL oxl_result block_read_member(oxl_context *ctx, const char *folder, const char *name,
                                          struct text *out);
/* Writes imaging.txt and block.json of a folder whose model.ply is there. */
OXL_INTERNAL oxl_result block_write_finished(oxl_context *ctx, oxl_scene *scene, const char *folder,
                                             const char *key, const struct block_record *record);
/* Continues from the block's checkpoint. OXL_ERR_INTERRUPTED when the callback stopped it: model.ply is as
 * far as it came. */
OXL_INTERNAL oxl_result block_train(oxl_context *ctx, oxl_scene *scene, const struct block_task *task);

/* ---------------- look.c: a first look at a survey */

/* Looks at a survey. What hinders a look is no error, but an interruption is. */
OXL_INTERNAL oxl_result look_take(oxl_context *ctx, oxl_scene *scene, const oxl_train_options *options,
                                  struct look *out);

/* ---------------- large_model.c: a model that may stay in its file */

struct render_source;
OXL_INTERNAL struct render_source large_source(const oxl_large_model *large);

/* ---------------- lock.c: a folder that one process writes to at a time */

/* Locks as oxl_lock_folder; shared: other processes may share it, too. */
OXL_INTERNAL oxl_result lock_folder(oxl_context *ctx, const char *folder, int shared, oxl_lock **out);
/* Returns OXL_ERR_FAILED if the folder is inside OUT of a run that another process holds. */
OXL_INTERNAL oxl_result lock_check_parents(oxl_context *ctx, const char *folder);
/* Locks the folder; *out NULL with OXL_OK: another process holds it. */
OXL_INTERNAL oxl_result lock_folder_if_free(oxl_context *ctx, const char *folder, oxl_lock **out);
OXL_INTERNAL oxl_result lock_change(oxl_context *ctx, oxl_lock *lock, const char *folder, int shared);

/* ---------------- scene_file.c: a survey in one file that processes share */

/* Writes the scene to a file and maps it again; *out is NULL if the file has another key or
 * does not exist. */
OXL_INTERNAL oxl_result scene_file_write(oxl_context *ctx, const char *path, const oxl_scene *scene,
                                         const char *key);
OXL_INTERNAL oxl_result scene_file_map(oxl_context *ctx, const char *path, const char *key, oxl_scene **out);

#endif
