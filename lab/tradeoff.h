/* tradeoff.h - the doors between the files of the sweep of speed against accuracy.
 *
 *     tradeoff.c         the options one at a time and the presets, each trained on one survey, as far as the time allowed reaches
 *     tradeoff_render.c  cheaper pictures of one model: frames a second against PSNR to the exact ones
 *     tradeoff_text.c    the front, what each row costs in words; the table, tradeoff.csv and tradeoff.md
 *     tradeoff_svg.c     the drawing
 */
#ifndef TRADEOFF_H
#define TRADEOFF_H

#include "study.h"

enum tradeoff_measure {
    TRADEOFF_PSNR, /* dB */
    TRADEOFF_SSIM,
    TRADEOFF_MS_SSIM,
    TRADEOFF_CPU,     /* s of processors, of all threads together */
    TRADEOFF_SECONDS, /* by the clock */
    TRADEOFF_MEMORY,  /* bytes that the library held at its peak */
    TRADEOFF_BYTES,   /* of scene.ply */
    TRADEOFF_GAUSSIANS,
    TRADEOFF_MEASURES
};

enum { TRADEOFF_ROWS = 21, TRADEOFF_PICTURES = 8 };

enum tradeoff_option {                      /* what a row changes of the base's options, to its value */
                       TRADEOFF_ITERATIONS, /* times the base's */
                       TRADEOFF_PRESET,     /* enum oxl_preset: all of them */
                       TRADEOFF_COARSE,
                       TRADEOFF_SSIM_EVERY,
                       TRADEOFF_EXP,
                       TRADEOFF_ALPHA_MIN,
                       TRADEOFF_TILE_SHARE,
                       TRADEOFF_BANDS_EVERY,
                       TRADEOFF_SH_DEGREE,
                       TRADEOFF_HASTE,
                       TRADEOFF_SETTLE,
                       TRADEOFF_STOP_EARLY,
                       TRADEOFF_KEEP
};

struct tradeoff_row {
    const char          *name, *label; /* in --rows and the folders' names; for people */
    enum tradeoff_option option;
    double               value;
};

struct tradeoff_picture { /* one way of drawing */
    const char *name, *label;
    double      fps;   /* of one thread */
    double      psnr;  /* dB, to the exact pictures; 100: they are equal */
    double      bytes; /* of the file that it is drawn from */
};

struct tradeoff {
    const char                *scene, *preset;
    int                        iterations, max_side, threads, held_out, train_views;
    double                     budget; /* s */
    int                        rows, seeds;
    const struct tradeoff_row *row[TRADEOFF_ROWS];    /* the base first */
    int                        done[TRADEOFF_ROWS];   /* seeds 1..done are there */
    double                     wanted[TRADEOFF_ROWS]; /* s that the next seed of the row would take */
    double                     value[TRADEOFF_ROWS][STUDY_SEEDS][TRADEOFF_MEASURES]; /* not a number: not known */
    int                        pictures;
    struct tradeoff_picture    picture[TRADEOFF_PICTURES]; /* the exact one first */
};

/* ---------------------------------------------------------------- tradeoff_render.c */

/* Draws views of the scene with the model in `folder`/scene.ply; folder gets scene.splat. */
oxl_result tradeoff_render(struct study *s, const oxl_scene_options *options, const char *folder, struct tradeoff *t);

/* ---------------------------------------------------------------- tradeoff_text.c */

struct study_figure tradeoff_mean(const struct tradeoff *t, int row, enum tradeoff_measure m);

/* Against the base, over the seeds that both have: SSIM, MS-SSIM and PSNR as a difference, the rest as a ratio. */
struct study_figure tradeoff_against_base(const struct tradeoff *t, int row, enum tradeoff_measure m);

/* 1: no other row is as good in no more processor time. */
int tradeoff_on_front(const struct tradeoff *t, int row);
int tradeoff_picture_on_front(const struct tradeoff *t, int picture);

/* PSNR that the base's options would have reached in so much processor time with more iterations or fewer, between the rows that differ in
 * iterations alone; not a number outside of them. */
double tradeoff_by_iterations(const struct tradeoff *t, double cpu);

void tradeoff_table(struct study_text *out, const struct tradeoff *t); /* with the words below it */
void tradeoff_csv(struct study_text *out, const struct tradeoff *t);
void tradeoff_page(struct study_text *out, const struct tradeoff *t);

/* ---------------------------------------------------------------- tradeoff_svg.c */

void tradeoff_svg(struct study_text *out, const struct tradeoff *t);

#endif
