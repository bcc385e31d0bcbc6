/* job.h - a whole job: survey in, folder out; options, predictions, manifest, metrics. */
#ifndef OXL_JOB_H
#define OXL_JOB_H

#include "../blocks/blocks.h"
#include "../train/train.h"

/* ---------------------------------------------------------------- manifest.c: run.json, what a result depends on */

enum { MANIFEST_VALUES = 96, MANIFEST_DIFFERENCES = 10 /* options; lines about them */ };

struct oxl_manifest { /* read back from run.json */
    int      finished;
    float    refine;                                  /* not in the line: blocks do not depend on it */
    char    *line, *found;                            /* "job": {...}, "found": {...}; line NULL: there was no run */
    char    *scene, *preset, *value[MANIFEST_VALUES]; /* value: of the options as text, in the table's order; NULL: not there */
    uint64_t seed;
};
OXL_INTERNAL void       manifest_describe(struct text *t, const char *scene, const oxl_job_options *o); /* "job": {...} */
OXL_INTERNAL oxl_result manifest_read(oxl_context *ctx, const char *folder, struct oxl_manifest *out);
OXL_INTERNAL void       manifest_free(oxl_context *ctx, struct oxl_manifest *run);
OXL_INTERNAL void       manifest_options(const struct oxl_manifest *run, oxl_job_options *o); /* o borrows run's strings */
/* A line for each member of "job" and "found" that differs between two runs. */
OXL_INTERNAL oxl_result manifest_differences(struct text *t, const char *there, const char *here);
OXL_INTERNAL double     manifest_number(const char *text, const char *name); /* what follows "name": , or 0 */

/* ---------------------------------------------------------------- block.c: the training of one block in its folder */

struct block_record {                                   /* block.json */
    int           there, trained, finished, iterations; /* trained: to its end, but for a standard model */
    size_t        gaussians;
    double        seconds, peak, predicted_seconds, predicted_peak; /* peaks in bytes */
    oxl_nonfinite nonfinite;
};
struct block_task {
    const char         *folder, *key; /* key: what the result depends on */
    oxl_train_options   train;
    const oxl_callback *callback;
    const oxl_model    *start; /* what training starts from; NULL: the scene's points */
    int    standard; /* steps that a model with second lobes gets without them, for model_standard.ply; 0: none is made */
    double predicted_seconds, predicted_peak;
};
/* A run that goes on for `steps` steps from a model that another has ended with: no Gaussian comes or goes. */
OXL_INTERNAL oxl_train_options block_refinement(const oxl_train_options *run, int sh_degree, int steps);
/* How many steps model_standard.ply is worth after such a run. */
OXL_INTERNAL int               block_standard_steps(const oxl_train_options *run);
OXL_INTERNAL oxl_result        block_read(oxl_context *ctx, const char *folder, const char *key, struct block_record *out);
/* Adds what the training of a block decided, the members of a JSON object; nothing when there is no block.json. */
OXL_INTERNAL oxl_result        block_read_decisions(oxl_context *ctx, const char *folder, struct text *out);
/* Goes on from the block's checkpoint. OXL_ERR_INTERRUPTED when the callback stopped it: model.ply is as far as it came. */
OXL_INTERNAL oxl_result        block_train(oxl_context *ctx, oxl_scene *scene, const struct block_task *task);

/* ---------------------------------------------------------------- metrics.c */

OXL_INTERNAL double metrics_decibel(double error, double weight); /* PSNR of weighted squared errors; NaN of none */

struct metrics_sum {
    double error, weight; /* sum of squared differences, and of what they are divided by */
    size_t pixels;        /* that count */
};
/* The i-th pixel of both, three channels, by the image's weight. */
OXL_INTERNAL void       metrics_add_pixel(const oxl_image *rendered, const oxl_image *image, size_t i, struct metrics_sum *sum);
/* Adds the members "psnr", "cc_psnr", "ssim", "ms_ssim", "count" and "views" (name and the four each) of a JSON object, without its braces. */
OXL_INTERNAL oxl_result metrics_write_json(oxl_context *ctx, struct text *t, const oxl_scene *scene, const oxl_metrics *m);

/* ---------------------------------------------------------------- seam.c: do the borders between blocks show? */

#define SEAM_WIDTH 0.02 /* near: this share of the block's size along the axis that the border cuts */

struct seam { /* of all pixels of a split that count: by squared error, not the mean of views; NaN of no pixels */
    double near_psnr, elsewhere_psnr;
    size_t near_pixels, elsewhere_pixels;
};
OXL_INTERNAL oxl_result seam_measure(oxl_context *ctx, const struct partition *p, const oxl_model *model, oxl_scene *scene,
                                     oxl_split split, struct seam *out);
OXL_INTERNAL void seam_add_json(struct text *t, const struct seam *seam); /* a member and its comma: one line of an object */

/* ---------------------------------------------------------------- render_files.c, training_views.c */

/* oxl_render_views of these views. */
OXL_INTERNAL oxl_result render_files_of(oxl_context *ctx, const oxl_model *model, oxl_scene *scene, const oxl_render_output *what,
                                        const char *folder, const int *view, int asked, int *count);
/* Adds a member of metrics.json, "training", and its comma; logs the views that fit far worse than their neighbours, after
 * enough iterations. The worst are rendered
 * beside their images into `folder`; NULL: none. */
OXL_INTERNAL oxl_result training_views_check(oxl_context *ctx, const oxl_model *model, oxl_scene *scene, int iterations,
                                             struct text *json, const char *folder);

/* ---------------------------------------------------------------- survey_report.c: what a survey holds, what training it would take */

/* What a training run takes, of a survey or of a block, as arithmetic on counts. */
struct survey_load {
    size_t points, observations; /* to start from; of a point in a view */
    int    views;
    double pixels, schedule_pixels, largest; /* of all views; of the training views; of one */
    double largest_file;                     /* pixels of an image as the file has it */
};
struct survey_cost {
    double gaussians, memory, seconds; /* at the end; peak in bytes; on ctx's threads */
};
/* Of a block that partition_make has made. */
OXL_INTERNAL struct survey_load partition_load(const struct partition *p, int block);
OXL_INTERNAL struct survey_load survey_load(const oxl_scene *scene);
OXL_INTERNAL struct survey_cost survey_cost(const oxl_context *ctx, const oxl_job_options *options,
                                            const struct survey_load *load);
/* Peak in bytes, of a run that ends with so many Gaussians. */
OXL_INTERNAL double             survey_memory(const oxl_job_options *options, const struct survey_load *load, double gaussians);
/* closely: each image and mask is looked at, too, as far as that goes without decoding it. */
OXL_INTERNAL oxl_result survey_describe(oxl_context *ctx, const oxl_scene *scene, const oxl_job_options *options, int closely,
                                        oxl_survey *out);
/* An object without a newline at its end; its lines after the first start with `indent`. */
OXL_INTERNAL void       survey_add_json(struct text *t, const oxl_survey *survey, const char *indent);

/* Of the scene that the cost is of, in all its blocks: from steps that are timed, or, where that would take too long, by the cost. */
/* range: the least and the most that it may be; NULL when nobody asks. */
OXL_INTERNAL double survey_seconds(oxl_context *ctx, const oxl_scene *scene, const oxl_job_options *options,
                                   const struct survey_cost *cost, double range[2]);

/* ---------------------------------------------------------------- predict_time.c: how long steps will take */

/* Gaussians at the end of a run that may not have more than `cap`. */
OXL_INTERNAL double predict_time_expected(const oxl_train_options *options, size_t points, size_t cap);

/* Seconds of a run that is to end with so many Gaussians, extrapolated from steps that are timed here and now; range: the least and the
 * most that it may be. 0: it cannot be told so, be it that timing would take too long, or for want of memory. */
OXL_INTERNAL double predict_time(oxl_context *ctx, const oxl_scene *scene, const oxl_train_options *options, double gaussians,
                                 double range[2]);

/* ---------------------------------------------------------------- budget.c: --ram */

/* Image cache and most Gaussians such that the load fits options->ram (0: they stay); 0 when it cannot. */
OXL_INTERNAL int        budget_fit(const oxl_context *ctx, const struct survey_load *load, oxl_job_options *o);
/* A run that makes no Gaussians, beside `more` bytes: whether it fits, without a cache if need be. *memory: what it takes; the budget that
 * would do when it does not fit. */
OXL_INTERNAL int        budget_holds(const oxl_context *ctx, const struct survey_load *load, double more, oxl_job_options *o,
                                     double *memory);
OXL_INTERNAL oxl_result budget_refuse(oxl_context *ctx, const struct survey_load *load, const oxl_job_options *o);
/* partition_make with blocks small enough that each fits. OXL_ERR_BUDGET: not even small ones do. */
OXL_INTERNAL oxl_result budget_partition(oxl_context *ctx, const oxl_scene *scene, const oxl_job_options *o,
                                         struct partition *out);

#endif
