/* ablate.h - the doors between the files of the ablation.
 *
 *     ablate.c        the paper's variants, each trained on one survey with several seeds
 *     ablate_table.c  means and spreads; the table and ablation.csv
 *     ablate_svg.c    the drawing: our ratios beside the paper's
 */
#ifndef ABLATE_H
#define ABLATE_H

#include "study.h"

enum ablate_measure {
    ABLATE_PSNR, /* dB */
    ABLATE_SSIM,
    ABLATE_FAR, /* PSNR of the far third of depth, dB */
    ABLATE_GAUSSIANS,
    ABLATE_BYTES,   /* of scene.ply */
    ABLATE_SECONDS, /* of training */
    ABLATE_MEMORY,  /* bytes that the library held at its peak */
    ABLATE_MEASURES
};

enum { ABLATE_ROWS = 8 };

struct ablate_row {
    const char  *name, *label; /* in --rows and the folders' names; in the table */
    oxl_cut      cut;
    oxl_ucd_mode ucd;
    double       keep; /* fraction; 1: all */
    oxl_dog      dog;
    double       paper[ABLATE_MEASURES]; /* OceanXL, ablation on Abyssal; 0: the paper does not say */
};

struct ablation {
    const char              *scene;
    int                      iterations, sh_degree; /* the same for every row */
    int                      rows, seeds;
    int                      held_out; /* 1: judged by views that training never saw */
    const struct ablate_row *row[ABLATE_ROWS];
    int                      blocks[ABLATE_ROWS];
    double                   value[ABLATE_ROWS][STUDY_SEEDS][ABLATE_MEASURES]; /* not a number: not known */
};

/* ---------------------------------------------------------------- ablate_table.c */

struct study_figure ablate_mean(const struct ablation *a, int row, enum ablate_measure m);

/* Seed by seed against another row: PSNR and SSIM as a difference, the rest as a ratio. */
struct study_figure ablate_against(const struct ablation *a, int row, int base, enum ablate_measure m);
double              ablate_paper_against(const struct ablation *a, int row, int base, enum ablate_measure m);

/* "+0.65" or "x0.885"; "-" when it is not known. */
const char *ablate_relative(char out[32], enum ablate_measure m, double value);
#define ABLATE_RELATIVE(m, value) ablate_relative((char[32]){0}, m, value)

void ablate_table(struct study_text *t, const struct ablation *a);
void ablate_csv(struct study_text *t, const struct ablation *a);

/* ---------------------------------------------------------------- ablate_svg.c */

void ablate_svg(struct study_text *t, const struct ablation *a);

#endif
