/* study.h - what ablate and tradeoff share: one survey trained many times, side by side, and what came of it as text and drawings.
 *
 *     study.c         one training in a folder of its own: memory counted, CPU time, figures read back
 *     study_text.c    means, digits in every locale, the parts of a drawing
 */
#ifndef STUDY_H
#define STUDY_H

#include "../cli/cli.h"

#include <stddef.h>

enum { STUDY_SEEDS = 99 };

/* ---------------------------------------------------------------- study_text.c */

struct study_figure {    /* over the seeds; not a number: not known */
    double mean, spread; /* spread: standard deviation, of at least two */
};
struct study_figure study_summary(const double *x, int count);

struct study_text {
    char  *data; /* ends in 0; free() it */
    size_t used, capacity;
    int    failed; /* no memory */
};
void study_add(struct study_text *t, const char *format, ...); /* no %f in it: its point follows the locale */

/* Digits the same in every locale; "" when value is not a number. Returns out. */
const char *study_fixed(char out[32], double value, int decimals);
#define STUDY_FIXED(value, decimals) study_fixed((char[32]){0}, value, decimals)

/* The parts of an SVG drawing, px; style: of CSS, "" is the drawing's own. Begins a white page with a title; "</svg>" ends it. */
void   study_drawing(struct study_text *t, int width, int height, const char *title);
void   study_line(struct study_text *t, double x0, double y0, double x1, double y1, const char *style);
void   study_box(struct study_text *t, double x, double y, double width, double height, const char *fill);
void   study_label(struct study_text *t, double x, double y, const char *style, const char *text);
double study_step(double span); /* between grid lines: 1, 2 or 5 times a power of ten, at most 5 of them in the span */

/* ---------------------------------------------------------------- study.c */

struct study {
    oxl_context               *ctx;     /* of its own: its memory is counted */
    const oxl_context_options *options; /* of the caller, whose log is passed on */
    const oxl_callback        *callback;
    size_t                     held, peak; /* bytes that the library holds, and held at its peak in the training that runs */
    int                        begun; /* that training, by this process: 0 not at all, 1 from its start, 2 from a checkpoint */
    double                     cpu_at, cpu; /* s of the process's processors: at its first step, and until its last */
    char                      *error;
    size_t                     error_size;
};

oxl_result study_open(struct study *s, const char *out); /* ctx, and the folder */
oxl_result study_fail(struct study *s, oxl_result rc, const char *what, const char *detail);
void       study_log(struct study *s, const char *text);

struct study_result { /* not a number: not known */
    double psnr, ssim, ms_ssim, gaussians, bytes, seconds, blocks;
    double memory; /* bytes that the library held at its peak, over all the parts in which it was trained */
    double cpu;    /* s, likewise */
    double far;    /* PSNR of what lies in the far third of depth; not a number too when nothing does */
    int    held_out;
};

/* Trains it, goes on with it, or finds it done; reads what it left. */
oxl_result study_train(struct study *s, const char *scene, const char *folder, const oxl_job_options *job,
                       struct study_result *out);

/* A file of the folder: written whole or not at all; read into fresh memory, NULL when it is not there. */
oxl_result study_write(struct study *s, const char *folder, const char *name, const struct study_text *t);
char      *study_read(const char *folder, const char *name);

#endif
