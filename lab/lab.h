/* lab.h - what main.c calls of lab/: synthetic surveys and the studies. They use the public headers and cli.h. */
#ifndef LAB_H
#define LAB_H

#include "../cli/cli.h"

/* ---------------- synth.c: a procedural underwater survey with known truth */

/* Writes to `out`: images/, sparse/0/ and truth/ (see truth/model.txt). */
oxl_result synth_run(oxl_context *ctx, const synth_options *options);

/* ---------------- study.c: many trainings of one survey, compared */

typedef struct study_options {
    const char *scene, *out;   /* folders */
    const char *rows;          /* names with commas between; NULL: the study's own */
    int seeds;                 /* each row is trained with 1..seeds */
    double budget;             /* s: rows that do not fit any more are named, not trained; 0: no limit */
    oxl_job_options job;       /* common to the rows; options that differ are overwritten */
    struct cli_memory *memory; /* of the context: its peak is that of each training */
    oxl_callback callback;     /* progress of each training */
} study_options;

enum study_name { STUDY_TRADEOFF, STUDY_LIGHT, STUDY_BLOCKS, STUDY_ABLATION, STUDY_ALL };

/* Trains all rows with all seeds. Leaves in `out`: NAME.md and .csv of the study, and ROW-seedS/ for each training; the
 * page goes to `to`, too. When the callback stops it, or with a larger budget, the next call resumes. */
oxl_result study_run(oxl_context *ctx, enum study_name name, const study_options *options, FILE *to);
/* All studies on all surveys: leaves results.md and speed.svg in `out`, and the runs. */
oxl_result results_run(oxl_context *ctx, const char *const *survey, int surveys, const study_options *options,
                       FILE *to);

#endif
