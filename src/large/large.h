/* large.h - surveys larger than memory: predicted memory and time, budget, blocks. */
#ifndef OXL_LARGE_H
#define OXL_LARGE_H

#include "../core/core.h"
#include "../train/trained.h"
#include "../../oceanxl_job.h"

/* ---------------- partition_make.c: balanced blocks of a survey */

/* Holds a half-open box, low <= x < high, in the partition's frame; outer faces are infinite. */
struct partition_box {
    double low[3], high[3];
};
static inline int partition_contains(const struct partition_box *box, const double frame[3])
{
    int inside = 1;
    for (int i = 0; i < 3; i++) inside &= frame[i] >= box->low[i] && frame[i] < box->high[i];
    return inside;
}
struct partition_block {
    struct partition_box box;    /* the boxes of all blocks are disjoint and cover all space */
    struct partition_box finite; /* `box` clipped to the trimmed extents of the points */
    /* points inside `box`; these, and others that its views see */
    size_t points, start_points;
};
struct partition {
    double rotation[9]; /* (3,3) rows are the principal axes, longest first; frame = R (world - origin) */
    double origin[3];   /* world coordinates */
    double extent[3];   /* extents along the axes, l1 >= l2 >= l3, trimmed */
    int dimensions;     /* 2: the third axis is never cut; 3 */
    double memory; /* bytes; memory of a process for which the number of blocks was chosen; 0: no limit */
    int block_count;
    struct partition_block *block;
    struct partition_plan *plan; /* block of each point and view; NULL: freed */
};
OXL_INTERNAL void partition_to_frame(const struct partition *p, const double world[3], double out[3]);

/* Cuts a scene from files into blocks; the scene must outlive the partition. It stays one block if it is
 * small enough, if the options say so, or if it has no tracks, without which a view's points are unknown. The
 * log states the evidence for 2D or 3D. */
OXL_INTERNAL oxl_result partition_make(oxl_context *ctx, const oxl_scene *scene,
                                       const oxl_partition_options *options, struct partition *out);
OXL_INTERNAL void partition_free(oxl_context *ctx, struct partition *p);
/* Frees the plan, the part of the partition that refers to the scene. */
OXL_INTERNAL void partition_free_plan(oxl_context *ctx, struct partition *p);

/* ---------------- checkpoint.c: files of a run's state */

#define CHECKPOINT_VERSION 17
/* Writes FOLDER/checkpoint.oxl. `key`: all inputs of the result. */
OXL_INTERNAL oxl_result checkpoint_write(oxl_context *ctx, const char *folder, const char *key,
                                         archive_state *state, void *user);
/* Reads the checkpoint with key `key`. *found 0: there is none, or it is damaged, and the state is
 * unchanged. */
OXL_INTERNAL oxl_result checkpoint_read(oxl_context *ctx, const char *folder, const char *key,
                                        archive_state *state, void *user, int *found);
/* Returns a store that keeps a run's state in checkpoints of a folder. */
OXL_INTERNAL struct train_store checkpoint_in(const char *folder, const char *key);
OXL_INTERNAL void checkpoint_remove(const char *folder);
/* Computes the checksum of a file without its last `end` bytes. */
OXL_INTERNAL oxl_result checksum_of_file(oxl_context *ctx, const char *path, size_t end, uint64_t *sum);

/* ---------------- merge.c: rows of models */

/* Appends the rows of `from` whose keep (count) is not 0, or all if keep is NULL, relative to into's origin.
 * The SH degree of `into` grows to that of `from`, with coefficients of 0; rows with a second lobe stay in
 * front. On failure `into` keeps its rows. */
OXL_INTERNAL oxl_result merge_rows(oxl_context *ctx, const oxl_model *from, const uint8_t *keep,
                                   oxl_model *into);
/* Marks in inside (count) the Gaussians whose centres lie in the block's box; a centre that is
 * not finite lies in no box. */
OXL_INTERNAL void merge_mark(const struct partition *p, int block, const oxl_model *model, uint8_t *inside);

/* Limits numbers of Gaussians that are searched for or read from files: their
 * parameters alone would be 236 GB. */
#define JOB_GAUSSIANS_MAX 1e9

/* ---------------- cost.c: predicted Gaussians, memory and time */

/* Bytes of a Gaussian beside its parameters: projection, tile lists, gradient slots. */
#define COST_SPLAT_BYTES 400.0
struct cost_load {               /* Counts what a survey or a block loads memory and time with. */
    size_t points, observations; /* initial points; (point, view) pairs */
    int views;
    /* px of all views; of the training views; of the largest view */
    double pixels, schedule_pixels, largest;
    double largest_file; /* px of the largest image file */
    double stereo;       /* most points of depth maps */
    /* Gaussians of other blocks in its views, per Gaussian of its own */
    double surroundings;
    double survey; /* bytes of the survey's points outside of a block */
};
/* Returns the steps of a run with `images` images (docs/SCALE.md). */
OXL_INTERNAL int cost_iterations(const oxl_job_options *options, int images);
OXL_INTERNAL struct cost_load cost_load_of_scene(const oxl_scene *scene);
/* Counts the load of a block of p, which partition_make has left with its plan. */
OXL_INTERNAL struct cost_load cost_load_of_block(const struct partition *p, int block);
/* Predicts the Gaussians at the end of a run. */
OXL_INTERNAL double cost_gaussians(const oxl_job_options *options, const struct cost_load *load);
OXL_INTERNAL size_t cost_cache(const oxl_job_options *o); /* bytes of decoded images */
/* Predicts the peak memory in bytes of a run that ends with `gaussians`. */
OXL_INTERNAL double cost_memory(const oxl_job_options *options, const struct cost_load *load,
                                double gaussians);
/* Predicts the bytes that training takes on a device, from the numbers of rows, pairs and pixels. */
OXL_INTERNAL double cost_device_memory(const oxl_job_options *options, const struct cost_load *load,
                                       double gaussians);
/* Counts the training views that are judged behind a run, and the steps that take as long as its whole
 * evaluation. */
OXL_INTERNAL int cost_judged_views(const oxl_scene *scene, int iterations);
OXL_INTERNAL int cost_evaluation_steps(const oxl_scene *scene, int iterations);
/* Predicts the seconds of a run with ctx's threads, or on its device, from some steps. */
OXL_INTERNAL oxl_result cost_seconds(oxl_context *ctx, const oxl_scene *scene, const oxl_job_options *options,
                                     double *seconds);

/* ---------------- budget.c: --ram */

/* Sets image cache, SH degree and the limit of Gaussians so that the load fits options->ram and
 * options->device_ram (0: no limit); returns 0 if it cannot. */
OXL_INTERNAL int budget_fit(const struct cost_load *load, oxl_job_options *o);
/* Returns the most Gaussians of a run that fit both limits. */
OXL_INTERNAL double budget_max_gaussians(const struct cost_load *load, const oxl_job_options *o);
/* Fits, as budget_fit, a model that may have fewer Gaussians than the survey has points. */
OXL_INTERNAL int budget_limit_gaussians(const struct cost_load *load, oxl_job_options *o);
/* Fails with the budget that would suffice. */
OXL_INTERNAL oxl_result budget_refuse(oxl_context *ctx, const struct cost_load *load,
                                      const oxl_job_options *o);
/* Returns --ram, or, if neither it nor a number of blocks is set and the run may exceed the free memory, the
 * free memory; 0: no limit. */
OXL_INTERNAL size_t budget_limit(const oxl_scene *scene, const oxl_job_options *o);
/* Makes a partition whose blocks each fit `memory` bytes, those that an earlier process found (0: no limit),
 * or, if it is NaN, budget_limit. OXL_ERR_BUDGET: even the smallest blocks do not. */
OXL_INTERNAL oxl_result budget_partition(oxl_context *ctx, const oxl_scene *scene, const oxl_job_options *o,
                                         double memory, struct partition *out);

/* ---------------- block.c: the training of one block in its folder */

/* Lists the numbers of block.json: s; peaks in bytes; counts of values that are not finite. */
enum {
    BLOCK_ITERATIONS,
    BLOCK_GAUSSIANS,
    BLOCK_SECONDS,
    BLOCK_PEAK,
    BLOCK_NONFINITE,
    BLOCK_NUMBERS = BLOCK_NONFINITE + 4
};
/* Adds a number as a member of a JSON object, on a line of its own. */
OXL_INTERNAL void text_add_member(struct text *t, const char *name, double value);
#define BLOCK_NUMBER_MAX 1e18 /* Limits numbers that are read from files. */
struct block_record {         /* Holds members of block.json. */
    int exists, finished;
    double number[BLOCK_NUMBERS];
};
/* Adds the numbers from `first` on as members of a JSON object. */
OXL_INTERNAL void block_add_numbers(struct text *t, const struct block_record *r, int first);

struct block_task {
    const char *folder, *key; /* key: all that the result depends on */
    oxl_train_options train;
    const oxl_callback *callback;
    struct train_task run; /* without stores, log and notes, which are the folder's; imaging: not NULL */
};
/* Reads block.json; exists 0: there is none, it has another key, or it or files of a finished block are
 * damaged, which is logged: the training is repeated and gives the same bytes. */
OXL_INTERNAL oxl_result block_read(oxl_context *ctx, const char *folder, const char *key,
                                   struct block_record *out);
/* Appends the text inside the brackets of a member of block.json, an object or array;
 * nothing if there is no file. */
OXL_INTERNAL oxl_result block_read_member(oxl_context *ctx, const char *folder, const char *name,
                                          struct text *out);
/* Writes the files of a block that is not trained. */
OXL_INTERNAL oxl_result block_keep(oxl_context *ctx, const oxl_scene *scene, const struct block_task *task,
                                   const oxl_trained *trained);
/* Trains the block, from its checkpoint if there is one. OXL_ERR_INTERRUPTED if the callback stopped it:
 * model.ply has the steps done. */
OXL_INTERNAL oxl_result block_train(oxl_context *ctx, const oxl_scene *scene, const struct block_task *task);

/* ---------------- lock.c: a folder that one process writes to at a time */

/* Locks a folder like oxl_lock_folder; shared: other processes may share the lock. */
OXL_INTERNAL oxl_result lock_folder(oxl_context *ctx, const char *folder, int shared, oxl_lock **out);
/* Waits as long as another process holds the lock, or until `file` exists; NULL: of no file. */
OXL_INTERNAL oxl_result lock_wait(oxl_context *ctx, const char *folder, const char *file, oxl_lock **out);
/* Makes a lock shared or exclusive; fails if other processes do not allow that. */
OXL_INTERNAL oxl_result lock_change(oxl_context *ctx, oxl_lock *lock, const char *folder, int shared);

#endif
