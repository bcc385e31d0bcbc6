/* study.h - the study engine: one survey trained many times, rows of options x seeds, side by side.
 *
 *     study.c         trains each row with each seed, makes controls equal, writes the files
 *     study_page.c    means, spreads, comparisons, the Pareto front: the page (Markdown) and the CSV
 *     studies.c       the studies, as tables of rows
 *     results.c       all of them on several surveys, one page and a plot
 */
#ifndef STUDY_H
#define STUDY_H

#include "lab.h"

enum { STUDY_ROWS = 16, STUDY_AGAINST = 4 };

enum study_measure {
    STUDY_PSNR, /* dB */
    STUDY_SSIM,
    STUDY_STRUCTURE, /* oxl_metrics.structure */
    STUDY_GAUSSIANS,
    STUDY_BYTES,   /* of scene.ply */
    STUDY_SECONDS, /* of training */
    STUDY_CPU,     /* s of processor time, all threads together */
    STUDY_MEMORY,  /* bytes that the library held at its peak */
    STUDY_MEASURES
};

struct study_row {
    const char *name, *label;           /* in --rows and the folders' names; in the page */
    const char *options;                /* what it sets: "cut=midpoint ucd=off" */
    int preset;                         /* 1 + enum oxl_preset: all training options; 0: the base's */
    double iterations;                  /* times the base's; 0: not set */
    const char *against[STUDY_AGAINST]; /* names of the rows that it is compared with */
    const char *like;                   /* of a control: the row whose `equal` it is given, */
    enum study_measure equal;           /* STUDY_GAUSSIANS as a limit, or STUDY_BYTES by pruning */
};

struct study_kind {
    const char *file, *title; /* "ablation": of FILE.md and FILE.csv */
    const struct study_row *row;
    int rows;
    int has_baseline;  /* 1: the first row is always trained, all others are compared with it */
    int sh_degree;     /* of all rows, where none is given; 0: as each decides */
    const char *notes; /* below the tables */
};

struct study {
    oxl_context *ctx;
    const struct study_kind *kind;
    const study_options *options;
    oxl_job_options base;
    int rows;
    const struct study_row *row[STUDY_ROWS];
    int done[STUDY_ROWS];                                /* seeds 1..done are there */
    double value[STUDY_ROWS][CLI_SEEDS][STUDY_MEASURES]; /* NaN: not known */
    int is_fresh; /* of the training in progress: -1: no step yet; 1: from its start; 0: from a checkpoint */
    double cpu;   /* s of processor time at its first step */
};

/* Trains without writing a page; *s is what was trained. */
oxl_result study_train_all(oxl_context *ctx, const struct study_kind *kind, const study_options *options,
                           struct study *s);
oxl_result study_write(oxl_context *ctx, const char *folder, const char *name, struct output *t);

/* ---------------- studies.c */

extern const struct study_kind STUDY_KINDS[STUDY_ALL];

/* ---------------- study_page.c */

extern const struct study_column {
    const char *title, *member; /* in the page; in metrics.json or study.json, and the CSV */
    double scale;               /* of the page's unit */
    int decimals;
    int difference; /* compared by subtraction; 0: by division */
} STUDY_COLUMNS[STUDY_MEASURES];

struct study_figure {    /* over the seeds; NaN: not known */
    double mean, spread; /* spread: standard deviation, of two seeds or more */
};
struct study_figure study_mean(const struct study *s, int row, enum study_measure m);
/* Compares seed by seed: the effect of the seed, which both share, cancels. */
struct study_figure study_compare(const struct study *s, int row, int base, enum study_measure m);
/* Returns 1 if no row has as good a PSNR in no more CPU time. */
int study_is_pareto_optimal(const struct study *s, int row);
void study_table(struct output *t, const struct study *s); /* the rows alone */
void study_page(struct output *t, const struct study *s);
void study_csv(struct output *t, const struct study *s);

#endif
