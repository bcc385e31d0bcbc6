/* job.h - a whole job: survey in, folder out; blocks, budget, predictions, manifest, metrics. */
#ifndef OXL_JOB_H
#define OXL_JOB_H

#include "../../oceanxl_job.h"
#include "../blocks/blocks.h"
#include "../train/train.h"
#include "../survey/image.h"
#include "../survey/imaging.h"

/* ---------------- manifest.c: run.json, what a result depends on */

/* limit of what is searched for or believed: parameters alone would be 236 GB */
#define JOB_GAUSSIANS_MAX 1e9
enum { MANIFEST_VALUES = 96, MANIFEST_DIFFERENCES = 10 /* options; lines about them */ };

struct oxl_manifest { /* read from run.json */
    int finished;
    char *line, *found; /* "job": {...}, "found": {...}; line NULL: no run */
    /* value: options as text, in the table's order; NULL: absent */
    char *scene, *preset, *value[MANIFEST_VALUES];
    uint64_t seed;
};
OXL_INTERNAL void manifest_describe(struct text *t, const char *scene,
                                    const oxl_job_options *o); /* "job": {...} */
OXL_INTERNAL oxl_result manifest_read(oxl_context *ctx, const char *folder, struct oxl_manifest *out);
OXL_INTERNAL void manifest_free(oxl_context *ctx, struct oxl_manifest *run);
/* o borrows run's strings */
OXL_INTERNAL void manifest_options(const struct oxl_manifest *run, oxl_job_options *o);
/* A line for each member of "job" and "found" that differs between two runs. */
OXL_INTERNAL oxl_result manifest_differences(struct text *t, const char *old, const char *current);
/* a member's value; 0 if absent or not finite */
/* *same: two lines "job": {...} differ in the names of the same folders only, or, where what was `found` is
 * the same, in those of folders that have moved. */
OXL_INTERNAL oxl_result manifest_equivalent(oxl_context *ctx, const char *old, const char *current, int found,
                                            int *same);
/* 1: the survey of the run, by another name or moved since. */
OXL_INTERNAL int manifest_is_of(const struct oxl_manifest *run, const char *scene);
OXL_INTERNAL double manifest_number(const char *text, const char *name);

/* ---------------- block.c: the training of one block in its folder */

/* Files of the folder that are written under a temporary name. */
#define BLOCK_FILES "checkpoint.oxl block.json plan.txt log.csv imaging.txt model.ply model_standard.ply"

struct block_record { /* block.json */
    /* trained: all steps are done, scene_standard.ply may be missing */
    int exists, trained, finished, iterations;
    int idle;                        /* 1: a block with nothing to train: it has no checkpoint */
    int damaged;                     /* 1: block.json is there, but is not as it was written; `exists` is 0 */
    uint64_t model_sum, imaging_sum; /* of model.ply, imaging.txt; 0: none */
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
    const oxl_model *context; /* this and the next three as in struct train_output */
    const struct image_window *window;
    int first, until;
    /* steps that refine model_standard.ply, the model without second lobes; 0: it is not made */
    int standard;
    double predicted_seconds, predicted_peak;
};
/* A run of `steps` further steps from a finished model: the number of Gaussians does not change. */
OXL_INTERNAL oxl_train_options block_refinement(const oxl_train_options *run, int sh_degree, int steps);
/* Equivalent number of steps of model_standard.ply after such a run. */
OXL_INTERNAL int block_standard_steps(const oxl_train_options *run);
OXL_INTERNAL oxl_result block_read(oxl_context *ctx, const char *folder, const char *key,
                                   struct block_record *out);
/* Adds what the training of a block decided, the members of a JSON object; nothing when there is no
 * block.json. */
/* *whole: model.ply and imaging.txt are those that the record was written with. */
OXL_INTERNAL oxl_result block_check(oxl_context *ctx, const char *folder, const struct block_record *record,
                                    int *whole);
OXL_INTERNAL oxl_result block_read_member(oxl_context *ctx, const char *folder, const char *name,
                                          struct text *out);
/* imaging.txt and block.json of a folder whose model.ply is there. */
OXL_INTERNAL oxl_result block_write_finished(oxl_context *ctx, oxl_scene *scene, const char *folder,
                                             const char *key, const struct block_record *record);
/* Continues from the block's checkpoint. OXL_ERR_INTERRUPTED when the callback stopped it: model.ply is as
 * far as it came. */
OXL_INTERNAL oxl_result block_train(oxl_context *ctx, oxl_scene *scene, const struct block_task *task);

/* ---------------- start.c: a model to start from instead of the points */

struct start {
    oxl_model model; /* count 0: the run starts from the points */
    int after;       /* iterations of the finished run that is continued; 0: the model is --from's */
};
/* Finds the model and adds its checksum to `found` of run.json. key: "job" and "found" of the same run from
 * the points. */
OXL_INTERNAL oxl_result start_find(oxl_context *ctx, const char *out, const struct oxl_manifest *run,
                                   const oxl_job_options *o, const char *key, struct text *found,
                                   struct start *start);
/* Sets the task's start; the scene gets the gains of a continued run. */
OXL_INTERNAL oxl_result start_use(oxl_context *ctx, oxl_scene *scene, const char *out,
                                  const struct start *start, struct block_task *task);
OXL_INTERNAL oxl_result start_check(oxl_context *ctx, const struct start *start,
                                    /* OXL_ERR_USAGE: several blocks can only start from the survey */
                                    int blocks);

/* ---------------- metrics.c */

/* PSNR of weighted squared errors; NaN of none */
OXL_INTERNAL double metrics_decibel(double error, double weight);

struct metrics_sum {
    double error, weight; /* weighted sum of squared differences; sum of the weights */
    size_t pixels;        /* with a weight above 0 */
};
/* Adds pixel i, three channels, with the image's weight. */
OXL_INTERNAL void metrics_add_pixel(const oxl_image *rendered, const oxl_image *image, size_t i,
                                    struct metrics_sum *sum);
/* PSNR of the right half, after a gain per channel that is fitted on the left half. */
OXL_INTERNAL double metrics_half_psnr(const oxl_image *a, const oxl_image *b);

/* ---------------- lpips.c */

struct lpips; /* the network: one allocation, freed by oxl_free */
OXL_INTERNAL oxl_result lpips_read(oxl_context *ctx, const char *path, struct lpips **out);
/* Pixels that b masks count as alike. NaN: a layer would have no pixel (below 31 px a side). */
OXL_INTERNAL oxl_result lpips_distance(oxl_context *ctx, const struct lpips *net, const oxl_image *a,
                                       const oxl_image *b, double *out);
/* ---------------- structure.c */

/* oxl_view_metrics.explained; light (3,H,W): what a white scene looks like, before clamping. */
OXL_INTERNAL double structure_explained(const oxl_image *rendered, const oxl_image *image,
                                        const oxl_image *light);

/* ---------------- evaluate.c */

struct drawn { /* what evaluate_draw renders */
    struct renderer *r;
    const oxl_model *model;
    const oxl_scene *scene;
    /* with its medium, lamp and gains, as the images were taken; NULL: without */
    const struct imaging *imaging;
};
/* Composites the scene's images over the model's background from now on; before the first image is compared.
 * */
OXL_INTERNAL void evaluate_begin(oxl_context *ctx, const oxl_model *model, oxl_scene *scene);
/* depth (H,W), or NULL. */
OXL_INTERNAL oxl_result evaluate_draw(oxl_context *ctx, const struct drawn *d, int view, oxl_image *out,
                                      float *depth);
/* As oxl_evaluate, but without ms_ssim, plain_psnr, half_psnr and depths, in less than half of the time. */
OXL_INTERNAL oxl_result evaluate_quick(oxl_context *ctx, const oxl_model *model, oxl_scene *scene,
                                       oxl_split split, oxl_metrics *out);
/* Adds members of a JSON object, without its braces: the means, the values by depth, and "views". */
OXL_INTERNAL oxl_result evaluate_write_json(oxl_context *ctx, struct text *t, const oxl_scene *scene,
                                            const oxl_metrics *m);

/* ---------------- seam.c: PSNR near the borders between blocks */

struct seam { /* over all unmasked pixels of a split, not the mean over views; NaN without pixels */
    double near_psnr, elsewhere_psnr;
    size_t near_pixels, elsewhere_pixels;
};
OXL_INTERNAL oxl_result seam_measure(oxl_context *ctx, const struct partition *p, const oxl_model *model,
                                     oxl_scene *scene, oxl_split split, struct seam *out);
/* a member of an object and its comma */
OXL_INTERNAL void seam_add_json(struct text *t, const struct seam *seam);

/* ---------------- render_names.c, render_files.c, training_views.c */

/* What may be written of a view, and the temporary names of these and of the list. */
#define RENDER_SUFFIXES ".png", ".image.png", ".clear.png", ".depth.png", ".depth.pfm", ".depth16.png"
#define RENDER_FILES "*.png *.pfm .renders"
/* The name of a view's files without their suffix, in their folder (oxl_render_path). */
OXL_INTERNAL oxl_result render_name(oxl_context *ctx, const char *view, char **out);
/* Refuses views whose files would have one name. */
OXL_INTERNAL oxl_result render_names_check(oxl_context *ctx, const oxl_scene *scene);

struct render_files {
    const oxl_model *model;
    oxl_scene *scene;
    const oxl_render_output *what;
    const char *folder;
    const int *view; /* (views) */
    int views;
};
/* oxl_render_views for the given views. */
OXL_INTERNAL oxl_result render_files_of(oxl_context *ctx, const struct render_files *f, int *count);
/* After enough iterations: logs the training views that fit far worse than their neighbours, renders the
 * worst beside their images into `folder` (NULL: none), and adds the member "training" of metrics.json with
 * its comma. */
OXL_INTERNAL oxl_result training_views_check(oxl_context *ctx, const oxl_model *model, oxl_scene *scene,
                                             int iterations, struct text *json, const char *folder);

/* ---------------- predict_time.c: time of a run, from some timed steps */

/* Expected Gaussians at the end of a run with at most `cap`. */
OXL_INTERNAL double predict_time_expected(const oxl_train_options *options, size_t points, size_t cap);

/* Seconds of a run that ends with so many Gaussians, extrapolated from steps timed here; range: lower and
 * upper limit. 0: no prediction, since timing would take too long or there is no memory. */
OXL_INTERNAL double predict_time(oxl_context *ctx, const oxl_scene *scene, const oxl_train_options *options,
                                 double gaussians, double range[2]);

/* ---------------- cost.c: predicted Gaussians, memory and time */

/* per Gaussian beside its parameters: projection, tile lists, gradient slots */
#define COST_SPLAT_BYTES 300.0
struct cost_load {               /* counts of a survey or of a block */
    size_t points, observations; /* initial points; (point, view) pairs */
    int random;                  /* 1: the survey has no points, those are scene_start_points */
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
/* Steps of a run with so many images (docs/SCALE.md). */
OXL_INTERNAL int cost_iterations(const oxl_job_options *options, int images);
OXL_INTERNAL struct cost_load cost_load_of_scene(const oxl_scene *scene);
/* p by partition_make */
OXL_INTERNAL struct cost_load cost_load_of_block(const struct partition *p, int block);
OXL_INTERNAL struct cost cost_estimate(const oxl_context *ctx, const oxl_job_options *options,
                                       const struct cost_load *load);
/* Peak memory, bytes, of a run that ends with so many Gaussians. */
OXL_INTERNAL double cost_memory(const oxl_job_options *options, const struct cost_load *load,
                                double gaussians);
/* Duration for all blocks of the scene, from timed steps, or from the cost where timing takes too long.
 * range: lower and upper limit, or NULL. */
OXL_INTERNAL double cost_seconds(oxl_context *ctx, const oxl_scene *scene, const oxl_job_options *options,
                                 const struct cost *cost, double range[2]);

/* ---------------- budget.c: --ram */

/* Sets image cache and largest number of Gaussians so that the load fits options->ram (0: no limit); returns
 * 0 if it cannot. */
OXL_INTERNAL int budget_fit(const oxl_context *ctx, const struct cost_load *load, oxl_job_options *o);
/* 1: a run without trials, with so many Gaussians at its end, fits options->ram. */
OXL_INTERNAL int budget_fits(const struct cost_load *load, const oxl_job_options *o, double gaussians);
OXL_INTERNAL size_t budget_cache(const oxl_job_options *o); /* of images, bytes */
/* The most Gaussians of a run without trials that fit options->ram. */
OXL_INTERNAL double budget_max_gaussians(const struct cost_load *load, const oxl_job_options *o);
/* As budget_fit for a model that may have fewer Gaussians than the survey has points. */
OXL_INTERNAL int budget_limit_gaussians(const oxl_context *ctx, const struct cost_load *load,
                                        oxl_job_options *o);
OXL_INTERNAL oxl_result budget_refuse(oxl_context *ctx, const struct cost_load *load,
                                      const oxl_job_options *o);
/* --ram; without it, and without a set number of blocks, the available memory if the run may exceed it; 0: no
 * limit. */
OXL_INTERNAL size_t budget_limit(const oxl_scene *scene, const oxl_job_options *o);
/* partition_make with blocks that each fit this limit. OXL_ERR_BUDGET: even the smallest blocks do not. */
OXL_INTERNAL oxl_result budget_partition(oxl_context *ctx, const oxl_scene *scene, const oxl_job_options *o,
                                         struct partition *out);

/* ---------------- survey_report.c: content of a survey, predicted cost */

/* closely: also checks each image and mask, without decoding images. */
OXL_INTERNAL oxl_result survey_describe(oxl_context *ctx, const oxl_scene *scene,
                                        const oxl_job_options *options, int closely, oxl_survey *out);
/* Adds an object without a final newline; lines after the first start with `indent`. */
OXL_INTERNAL void survey_add_json(struct text *t, const oxl_survey *survey, const char *indent);

#endif
