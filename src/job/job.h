/* job.h - a whole job: survey in, folder out; manifest, result, renders, report. */
#ifndef OXL_JOB_H
#define OXL_JOB_H

#include "../../oceanxl_job.h"
#include "../large/job_state.h"

/* ---------------- metrics_json.c */

/* Adds metrics as members of a JSON object, without its braces: the means, the
 * values by depth, and "views". */
OXL_INTERNAL oxl_result metrics_json_add(struct text *t, const oxl_scene *scene, const oxl_metrics *m);

/* ---------------- manifest.c: run.json, what a result depends on */

struct oxl_manifest {
    int finished;
    char *text;   /* run.json; NULL: there is no run */
    char *values; /* strings that options of the run refer to */
    size_t used;  /* bytes of them */
};
/* Adds "job": {...}, options that the result depends on, and "inputs": {...}, paths of survey and model. */
OXL_INTERNAL void manifest_describe(struct text *job, struct text *inputs, const char *scene,
                                    const oxl_job_options *o);
OXL_INTERNAL oxl_result manifest_read(oxl_context *ctx, const char *folder, struct oxl_manifest *out);
OXL_INTERNAL void manifest_free(oxl_context *ctx, struct oxl_manifest *run);
/* Sets the options of the run, once; o borrows its strings. Returns the path of its survey, or NULL. */
OXL_INTERNAL const char *manifest_options(struct oxl_manifest *run, oxl_job_options *o);
/* Counts the values inside of "NAME": {...} that the run does not have, and adds a line for each to t. */
OXL_INTERNAL int manifest_differences(const struct oxl_manifest *run, const char *member, struct text *t);

/* ---------------- out_folder.c */

/* Refuses an OUT that the survey is read from, or that has the survey as one of its blocks. */
OXL_INTERNAL oxl_result out_check_inputs(oxl_context *ctx, const char *out, const char *scene,
                                         const oxl_scene_options *o);
/* Refuses an OUT without a run that holds a file which a run would replace. */
OXL_INTERNAL oxl_result out_check_files(oxl_context *ctx, const char *out);

/* ---------------- render_files.c */

struct render_files {
    const oxl_model *source;
    const oxl_scene *scene;
    const oxl_imaging *imaging; /* NULL: none */
    const oxl_render_output *what;
    const char *folder;
    const int *view; /* (views) */
    int views;
};
/* Renders the given views like oxl_render_views. */
OXL_INTERNAL oxl_result render_files_of(oxl_context *ctx, const struct render_files *f, int *count);

/* ---------------- training_views.c */

/* Evaluates the training views, adds the member "training" of metrics.json with its comma, and renders the
 * worst views beside their images into `folder` (NULL: none). After enough iterations also logs views that
 * fit far worse than their neighbours. measured: metrics of all training views; NULL: evaluates them, or
 * some if the run is short. */
OXL_INTERNAL oxl_result training_views_check(oxl_context *ctx, const oxl_model *model, const oxl_scene *scene,
                                             const oxl_imaging *imaging, int iterations,
                                             const oxl_metrics *measured, struct text *json,
                                             const char *folder);

/* ---------------- survey_report.c: content of a survey, predicted cost */

/* Describes the survey and predicts the memory of its training. closely: also the time, and checks each image
 * and mask, without decoding images. */
OXL_INTERNAL oxl_result survey_describe(oxl_context *ctx, oxl_scene *scene, const oxl_job_options *options,
                                        int closely, oxl_survey *out);
/* Adds a JSON object without a final newline; lines after the first begin with `indent`. */
OXL_INTERNAL void survey_add_json(struct text *t, const oxl_survey *survey, const char *indent);

/* ---------------- survey_checksum.c */

/* Computes a checksum of the survey's files; for scenes from files only. */
OXL_INTERNAL oxl_result survey_checksum(oxl_context *ctx, const oxl_scene *scene, uint64_t *sum);

/* ---------------- job_result.c: everything that belongs to the result */

/* Writes scene.ply and the files beside it; of an unfinished run of one block, the model in its present
 * state. evaluate: with metrics. */
OXL_INTERNAL oxl_result job_finish(struct job *job, int evaluate);
OXL_INTERNAL oxl_result job_write_run(struct job *job, int finished); /* writes run.json */

#endif
