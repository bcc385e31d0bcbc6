/* lab.h - what main.c calls of lab/: synthetic surveys and the studies. They use the public headers and cli.h. */
#ifndef LAB_H
#define LAB_H

#include "../cli/cli.h"

/* ---------------- synth.c: a procedural underwater survey with known truth */

/* Writes to `out`: images/, sparse/0/ and truth/ (see truth/model.txt). */
oxl_result synth_run(oxl_context *ctx, const synth_options *options);

/* ---------------- results.c: many trainings of surveys, compared */

enum study_name {
    STUDY_TRADEOFF,
    STUDY_ABLATION,
    STUDY_LIGHT,
    STUDY_BLOCKS,
    STUDY_EXTREMES,
    STUDY_PUBLISHED,
    STUDY_ALL
};

typedef struct study_options {
    const char *const *survey; /* (surveys) folders */
    int surveys;
    const char *out, *name;    /* folder; name of the page and the CSV in it */
    unsigned studies;          /* a bit for each enum study_name */
    const char *rows;          /* names with commas between; NULL: each study's own */
    int seeds;                 /* each row is trained with 1..seeds */
    double budget;             /* s: rows that do not fit any more are named, not trained; 0: no limit */
    oxl_job_options job;       /* common to the rows; options that differ are overwritten */
    struct cli_memory *memory; /* of the context: its peak is that of each training */
    oxl_callback callback;     /* progress of each training */
} study_options;

/* Trains all rows of the studies on the surveys with all seeds. Leaves in `out`: NAME.md, NAME.csv
 * and SURVEY/ROW-seedS/ of each training. Prints the page to `to`. When the callback stops it,
 * or with a larger budget, the next call resumes; what another build trained is trained anew. */
oxl_result study_run(oxl_context *ctx, const study_options *options, FILE *to);

#endif
