/* lab.h - what main.c calls of lab/: synthetic surveys and the studies. They use the public headers and those
 * of cli/. */
#ifndef LAB_H
#define LAB_H

#include "../cli/cli.h"

/* ---------------- synth.c: a procedural underwater survey with known truth */

/* Writes to `out`: images/, sparse/0/ and truth/ (see truth/model.txt). */
oxl_result synth_run(oxl_context *ctx, const synth_options *options);

/* ---------------- studies.c: many trainings of one survey, compared */

typedef struct study_options {
    const char *scene, *out;   /* folders */
    const char *rows;          /* names with commas between; NULL: the study's own */
    int seeds;                 /* each row is trained with 1..seeds */
    double budget;             /* s: rows that do not fit any more are named, not trained; 0: no limit */
    int side_is_given;         /* 0: images may be reduced to fit the budget */
    oxl_job_options job;       /* common to the rows; options that differ are overwritten */
    struct cli_memory *memory; /* of the context: its peak is that of each training */
    oxl_callback callback;     /* progress of each training */
    void (*log)(void *user, oxl_log_level level, const char *text); /* user: of the callback; may be NULL */
} study_options;

/* The paper's variants and their controls; speed against accuracy. Leaves in `out`: ablation (tradeoff) .md,
 * .csv and .svg, and NAME-seedS/ for each training; the page goes to `to`, too. When the callback stops it,
 * or with a larger budget, the next call resumes. */
oxl_result ablate_run(oxl_context *ctx, const study_options *options, FILE *to);
oxl_result tradeoff_run(oxl_context *ctx, const study_options *options, FILE *to);

#endif
