/* study.h - the study engine: one survey trained many times, rows of options x seeds, side by side.
 *
 *     studies.c       the studies, as tables of rows
 *     study.c         trains each row of a study on a survey with each seed, and makes controls equal
 *     study_page.c    means, spreads, comparisons, the Pareto front: the page (Markdown) and the CSV
 *     results.c       trains studies on surveys and writes one page and one CSV
 */
#ifndef STUDY_H
#define STUDY_H

#include "lab.h"

enum { STUDY_ROWS = 16, STUDY_AGAINST = 4 };

enum study_measure {
    STUDY_ITERATIONS,
    STUDY_PSNR,  /* dB */
    STUDY_SHOWN, /* oxl_metrics.shown_psnr, dB */
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
    const char *against[STUDY_AGAINST]; /* names of the rows that it is compared with; none: the first row */
    const char *like;                   /* of a control: the row whose `equal` it is given, */
    enum study_measure equal;           /* STUDY_GAUSSIANS as a limit, or STUDY_BYTES by pruning */
};

struct study_kind {
    const char *name, *title;
    const struct study_row *row;
    int rows;
    int has_baseline;  /* 1: the first row is always trained */
    int sh_degree;     /* of all rows, where none is given; 0: as each decides */
    int is_published;  /* 1: of surveys in the layout of NeRF synthetic or LLFF alone; 0: of all others */
    const char *notes; /* below the tables */
};

struct study {
    oxl_context *ctx;
    const struct study_kind *kind;
    const study_options *options;
    const char *survey; /* folder */
    oxl_job_options base;
    int rows;
    const struct study_row *row[STUDY_ROWS];
    int done[STUDY_ROWS];                                /* seeds 1..done are there */
    double value[STUDY_ROWS][CLI_SEEDS][STUDY_MEASURES]; /* NaN: not known */
    double predicted;  /* s that the first row takes, as oxl_check predicts it; 0: not known */
    char folder[4200]; /* of the training in progress */
    int is_fresh; /* of the training in progress: -1: no step yet; 1: from its start; 0: from a checkpoint */
    double cpu;   /* s of processor time at its first step */
};

extern const char STUDY_BUILD[]; /* commit of this build */

/* Chooses the rows of a study and refuses rows that cannot be trained. */
oxl_result study_begin(oxl_context *ctx, const struct study_kind *kind, const char *survey,
                       const study_options *options, struct study *out);
/* Trains what is not there yet and fits into `budget` seconds (0: no limit). */
oxl_result study_train_all(struct study *s, double budget);
const char *study_scene(const struct study *s); /* name of the survey's folder */

/* ---------------- studies.c */

extern const struct study_kind STUDY_KINDS[STUDY_ALL];

/* ---------------- study_page.c */

extern const struct study_column {
    const char *title,
        *member;  /* in the page (NULL: not there); in metrics.json or study.json, and the CSV */
    double scale; /* of the page's unit */
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
/* Writes the tables of one study on `count` surveys. */
void study_section(struct output *t, const struct study *s, int count);
void study_csv(struct output *t, const struct study *s, int count);

#endif
