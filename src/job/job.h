/* job.h - a whole job: survey in, folder out; manifest, result, renders, report. */
#ifndef OXL_JOB_H
#define OXL_JOB_H

#include "../../oceanxl_job.h"
#include "../large/job_state.h"

/* ---------------- metrics_json.c */

/* Adds members of a JSON object, without its braces: the means, the values by depth, and "views". */
OXL_INTERNAL oxl_result metrics_json_add(struct text *t, const oxl_scene *scene, const oxl_metrics *m);

/* ---------------- lpips.c */

struct lpips; /* the network: one allocation, freed by oxl_free */
OXL_INTERNAL oxl_result lpips_read(oxl_context *ctx, const char *path, struct lpips **out);
/* Measures LPIPS; pixels that b masks count as alike. NaN: a side is below 31 px, so a layer has none. */
OXL_INTERNAL oxl_result lpips_distance(oxl_context *ctx, const struct lpips *net, const oxl_image *a,
                                       const oxl_image *b, double *out);

/* ---------------- manifest.c: run.json, what a result depends on */

enum { MANIFEST_VALUES = 96, MANIFEST_DIFFERENCES = 10 /* options; lines about them */ };

struct oxl_manifest { /* read from run.json */
    int finished;
    int is_mixed;       /* 1: begun on one device and continued on another */
    char *line, *found; /* "job": {...}, "found": {...}; line NULL: no run */
    char *result;       /* checksum of scene.ply, of a finished run; NULL: not stated */
    /* value: options as text, in the table's order; NULL: absent */
    char *scene, *preset, *value[MANIFEST_VALUES];
    uint64_t seed;
};
OXL_INTERNAL void manifest_describe(struct text *t, const char *scene,
                                    const oxl_job_options *o); /* "job": {...} */
OXL_INTERNAL oxl_result manifest_read(oxl_context *ctx, const char *folder, struct oxl_manifest *out);
OXL_INTERNAL void manifest_free(oxl_context *ctx, struct oxl_manifest *run);
/* Sets the options of the run; o borrows its strings. */
OXL_INTERNAL void manifest_options(const struct oxl_manifest *run, oxl_job_options *o);
struct manifest_changes {
    int count;             /* members of "job" and "found" that differ between two runs */
    int iterations, start; /* 1: this one does */
};
/* Lists the differences. t: a line for each of them, or NULL. */
OXL_INTERNAL oxl_result manifest_differences(oxl_context *ctx, const char *old, const char *current,
                                             struct text *t, struct manifest_changes *changes);
/* *same: two lines "job": {...} differ in the names of the same folders only, or, where what was `found` is
 * the same, in those of folders that have moved. */
OXL_INTERNAL oxl_result manifest_equivalent(oxl_context *ctx, const char *old, const char *current, int found,
                                            int *same);
/* Adds a line "job": {...} with the device of another one, or none, as that has it. */
OXL_INTERNAL void manifest_add_with_device(struct text *t, const char *line, const char *of);
/* Returns 1 if two lines have the same device, or none. */
OXL_INTERNAL int manifest_same_device(const char *a, const char *b);
/* Adds the device of a line, or the CPU, as a JSON string. */
OXL_INTERNAL void manifest_add_device(struct text *t, const char *line);
/* Returns 1 if the survey is the run's, by another name or moved since. */
OXL_INTERNAL int manifest_is_of(const struct oxl_manifest *run, const char *scene);

/* ---------------- out_folder.c */

/* Refuses an OUT that the survey is read from, or of which the survey is a block. */
OXL_INTERNAL oxl_result out_check_inputs(oxl_context *ctx, const char *out, const char *scene,
                                         const oxl_scene_options *o);
/* Refuses an OUT in which no run is known and that holds a file, which a run would replace. */
OXL_INTERNAL oxl_result out_check_files(oxl_context *ctx, const char *out);
/* Refuses an OUT with a partition, or a file of its name, that no program of ours wrote. */
OXL_INTERNAL oxl_result out_check_partition(oxl_context *ctx, const char *out);

/* ---------------- start.c: a model to start from instead of the points */

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

/* ---------------- render_names.c, render_files.c, training_views.c */

/* What may be written of a view, and the temporary names of these and of the list. */
#define RENDER_SUFFIXES ".png", ".image.png", ".clear.png", ".depth.png", ".depth.pfm", ".depth16.png"
#define RENDER_FILES "*.png *.pfm .renders"
/* Makes the name of a view's files without their suffix, in their folder (oxl_render_path). */
OXL_INTERNAL oxl_result render_name(oxl_context *ctx, const char *view, char **out);
/* Refuses views whose files would have one name. */
OXL_INTERNAL oxl_result render_names_check(oxl_context *ctx, const oxl_scene *scene);

struct render_source;
struct render_files {
    const struct render_source *source;
    oxl_scene *scene;
    const oxl_render_output *what;
    const char *folder;
    const int *view; /* (views) */
    int views;
};
/* Renders the given views as oxl_render_views. */
OXL_INTERNAL oxl_result render_files_of(oxl_context *ctx, const struct render_files *f, int *count);
/* After enough iterations: logs the training views that fit far worse than their neighbours, renders the
 * worst beside their images into `folder` (NULL: none), and adds the member "training" of metrics.json with
 * its comma. */
OXL_INTERNAL oxl_result training_views_check(oxl_context *ctx, const oxl_large_model *model, oxl_scene *scene,
                                             int iterations, struct text *json, const char *folder);

/* ---------------- survey_report.c: content of a survey, predicted cost */

/* Describes the survey. closely: also checks each image and mask, without decoding images. */
OXL_INTERNAL oxl_result survey_describe(oxl_context *ctx, oxl_scene *scene, const oxl_job_options *options,
                                        int closely, oxl_survey *out);
/* Adds an object without a final newline; lines after the first start with `indent`. */
OXL_INTERNAL void survey_add_json(struct text *t, const oxl_survey *survey, const char *indent);

/* ---------------- survey_checksum.c, unseen.c */

/* Sums up the survey's files; scenes from files only. */
OXL_INTERNAL oxl_result survey_checksum(oxl_context *ctx, const oxl_scene *scene, uint64_t *sum);
/* Removes the Gaussians that change no pixel of any training view; renders each once. */
OXL_INTERNAL oxl_result unseen_drop(oxl_context *ctx, const oxl_scene *scene, oxl_model *model,
                                    size_t *dropped);

/* ---------------- job_result.c: everything that belongs to the result */

/* Writes scene.ply and the files beside it; of an unfinished run of one block, the model as it is. evaluate:
 * with metrics. */
OXL_INTERNAL oxl_result job_finish(struct job *job, int evaluate);
OXL_INTERNAL oxl_result job_write_run(struct job *job, int finished); /* run.json */

#endif
