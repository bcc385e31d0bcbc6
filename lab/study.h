/* study.h - the study engine: one survey trained many times, rows of options x seeds, side by side.
 *
 *     study.c          chooses the rows, trains each with each seed, finds the options of the controls,
 *     writes the files
 *     study_train.c    one training in a folder of its own: memory counted, CPU time, figures read back
 *     study_report.c   means, spreads, comparisons, the Pareto front; the page (Markdown) and the CSV
 *     study_plot.c     the drawing: PSNR over cost, twice
 *     studies.c        the two studies, as tables of rows
 */
#ifndef STUDY_H
#define STUDY_H

#include "lab.h"

#include <stddef.h>

enum { STUDY_SEEDS = CLI_SEEDS, STUDY_ROWS = 20, STUDY_OPTIONS = 4, STUDY_AGAINST = 4 };

/* ---------------- what a study is */

enum study_measure {
    STUDY_PSNR, /* dB */
    STUDY_SSIM,
    STUDY_STRUCTURE, /* mean over the evaluated views: oxl_metrics.structure */
    STUDY_LEAST,     /* its least value over evaluated and training views */
    STUDY_NEAR,      /* PSNR of each third of depth, dB: oxl_metrics.by_depth */
    STUDY_MIDDLE,
    STUDY_FAR,
    STUDY_GAUSSIANS,
    STUDY_BYTES,   /* of scene.ply */
    STUDY_SECONDS, /* of training */
    STUDY_CPU,     /* s of processor time, all threads together */
    STUDY_MEMORY,  /* bytes that the library held at its peak */
    STUDY_MS_SSIM, /* in the CSV alone, as the next one */
    STUDY_LPIPS,   /* with --lpips */
    STUDY_MEASURES
};

struct study_row {
    const char *name, *label;             /* in --rows and the folders' names; in the page */
    const char *option[STUDY_OPTIONS][2]; /* name and value of the options that it sets */
    int preset;                           /* 1 + enum oxl_preset: all training options; 0: the base's */
    double iterations;                    /* times the base's; 0: not set */
    const char *against[STUDY_AGAINST];   /* names of the rows that it is compared with */
    const char *like;                     /* of a control: the row whose `equal` it reaches, */
    /* STUDY_GAUSSIANS by the densify threshold, or STUDY_BYTES by pruning */
    enum study_measure equal;
    double paper[STUDY_MEASURES]; /* the paper's own figures; 0: not stated */
};

struct study_kind {
    const char *file, *title; /* "ablation": of FILE.md, FILE.csv, FILE.svg */
    const struct study_row *row;
    int rows, by_default; /* of them by default, the first ones */
    int has_baseline;     /* 1: the first row is always trained, all others are compared with it */
    const char *notes;    /* below the tables */
};

/* ---------------- one training: study_train.c */

struct study_meter { /* of one training */
    oxl_context *ctx;
    const study_options *options;
    int started;        /* by this process: 0 not at all, 1 from its start, 2 from a checkpoint */
    double cpu_at, cpu; /* s of processor time: at its first step, and from there to its last */
};

struct study_result {
    double value[STUDY_MEASURES]; /* NaN: not known */
    int blocks, held_out;
};

/* Trains it, resumes it, or finds it finished; reads what it left. */
oxl_result study_train(struct study_meter *s, const char *folder, const oxl_job_options *job,
                       struct study_result *out);

/* Writes a file of the folder, whole or not at all; empties t. */
oxl_result study_write(oxl_context *ctx, const char *folder, const char *name, struct output *t);

/* ---------------- all trainings: study.c */

struct study {
    const struct study_kind *kind;
    const study_options *options;
    struct study_meter meter;
    oxl_job_options base;
    int train_views, held_out, rows;
    const struct study_row *row[STUDY_ROWS];
    int done[STUDY_ROWS]; /* seeds 1..done are there */
    int blocks[STUDY_ROWS];
    double wanted[STUDY_ROWS];                             /* s that the next seed of the row would take */
    double threshold[STUDY_ROWS];                          /* of density control, found for the last seed */
    double value[STUDY_ROWS][STUDY_SEEDS][STUDY_MEASURES]; /* NaN: not known */
};

/* Trains all rows with all seeds, resuming what is there; leaves kind->file .md, .csv, .svg; the page goes to
 * `to`. */
oxl_result study_run(oxl_context *ctx, const struct study_kind *kind, const study_options *options, FILE *to);

/* ---------------- study_report.c, study_plot.c */

struct study_figure {    /* over the seeds; NaN: not known */
    double mean, spread; /* spread: standard deviation, of two seeds or more */
};
struct study_figure study_mean(const struct study *s, int row, enum study_measure m);
/* Compares seed by seed: PSNR and SSIM as a difference, the rest as a ratio. The effect of the seed, which
 * both share, cancels. */
struct study_figure study_compare(const struct study *s, int row, int base, enum study_measure m);
/* Returns 1 if no row has as good a PSNR in no more CPU time. */
int study_is_pareto_optimal(const struct study *s, int row);
void study_page(struct output *t, const struct study *s);
void study_csv(struct output *t, const struct study *s);
void study_plot(struct output *t, const struct study *s);

#endif
