/* ablate_table.c - means and spreads of an ablation; the table for people and the one for programs.
 *
 * A row is compared with another seed by seed: what both share, the seed's luck, is not taken for an effect.
 */
#include "ablate.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static const struct ablate_column {
    const char *title, *compared, *csv, *csv_compared;
    double      scale; /* of the table's unit */
    int         decimals;
    int         difference; /* compared by subtraction; 0: by division */
    int         in_paper;
} ABLATE_COLUMNS[ABLATE_MEASURES] = {
    {"PSNR dB", "PSNR dB", "psnr_db", "psnr_minus_first_db", 1, 2, 1, 1},
    {"SSIM", "SSIM", "ssim", "ssim_minus_first", 1, 4, 1, 1},
    {"far dB", "far dB", "far_psnr_db", "far_psnr_minus_first_db", 1, 2, 1, 0},
    {"Gaussians", "Gaussians", "gaussians", "gaussians_over_first", 1, 0, 0, 0},
    {"MB", "size", "bytes", "bytes_over_first", 1e-6, 2, 0, 1},
    {"seconds", "time", "seconds", "seconds_over_first", 1, 1, 0, 1},
    {"memory MB", "memory", "memory_bytes", "memory_over_first", 1e-6, 1, 0, 0},
};

enum { ABLATE_LABEL = 19, ABLATE_CELL = 11, ABLATE_CELL_SPREAD = 17, ABLATE_CELL_PAPER = 19 }; /* letters */

/* ---------------------------------------------------------------- figures */

struct study_figure ablate_mean(const struct ablation *a, int row, enum ablate_measure m)
{
    double x[STUDY_SEEDS] = {0};
    for (int s = 0; s < a->seeds; s++) x[s] = a->value[row][s][m];
    return study_summary(x, a->seeds);
}

static double ablate_compare(enum ablate_measure m, double value, double base)
{
    return ABLATE_COLUMNS[m].difference ? value - base : base > 0 ? value / base : NAN;
}

struct study_figure ablate_against(const struct ablation *a, int row, int base, enum ablate_measure m)
{
    double x[STUDY_SEEDS] = {0};
    for (int s = 0; s < a->seeds; s++) x[s] = ablate_compare(m, a->value[row][s][m], a->value[base][s][m]);
    return study_summary(x, a->seeds);
}

double ablate_paper_against(const struct ablation *a, int row, int base, enum ablate_measure m)
{
    const double value = a->row[row]->paper[m], first = a->row[base]->paper[m];
    return value > 0 && first > 0 ? ablate_compare(m, value, first) : NAN;
}

const char *ablate_relative(char out[32], enum ablate_measure m, double value)
{
    const int   difference = ABLATE_COLUMNS[m].difference;
    const char *digits     = STUDY_FIXED(value, difference ? ABLATE_COLUMNS[m].decimals : 3);
    const char *sign       = !difference ? "x" : digits[0] == '-' ? "" : "+";
    snprintf(out, 32, "%s%s", digits[0] ? sign : "-", digits);
    return out;
}

/* ---------------------------------------------------------------- the table */

static void ablate_cell(struct study_text *t, const struct ablation *a, enum ablate_measure m, struct study_figure f)
{
    const struct ablate_column *c      = &ABLATE_COLUMNS[m];
    const char                 *mean   = STUDY_FIXED(f.mean * c->scale, c->decimals);
    const char                 *spread = STUDY_FIXED(f.spread * c->scale, c->decimals);
    char                        text[80];
    snprintf(text, sizeof text, "%s%s%s", mean[0] ? mean : "-", spread[0] ? " +-" : "", spread);
    study_add(t, "%*s", a->seeds > 1 ? ABLATE_CELL_SPREAD : ABLATE_CELL, text);
}

static void ablate_figures(struct study_text *t, const struct ablation *a)
{
    study_add(t, "%-*s", ABLATE_LABEL, "");
    for (int m = 0; m < ABLATE_MEASURES; m++)
        study_add(t, "%*s", a->seeds > 1 ? ABLATE_CELL_SPREAD : ABLATE_CELL, ABLATE_COLUMNS[m].title);
    study_add(t, "  blocks\n");
    for (int r = 0; r < a->rows; r++) {
        study_add(t, "%-*s", ABLATE_LABEL, a->row[r]->label);
        for (enum ablate_measure m = 0; m < ABLATE_MEASURES; m++) ablate_cell(t, a, m, ablate_mean(a, r, m));
        study_add(t, "%8d\n", a->blocks[r]);
    }
}

static int ablate_compared_width(int measure)
{
    return ABLATE_COLUMNS[measure].in_paper ? ABLATE_CELL_PAPER : ABLATE_CELL;
}

/* before: against the row before, else against the first. */
static void ablate_comparison(struct study_text *t, const struct ablation *a, const char *title, int before)
{
    study_add(t, "\n%s; in brackets the paper's own\n%-*s", title, ABLATE_LABEL, "");
    for (int m = 0; m < ABLATE_MEASURES; m++) study_add(t, "%*s", ablate_compared_width(m), ABLATE_COLUMNS[m].compared);
    study_add(t, "\n");
    for (int r = 1; r < a->rows; r++) {
        study_add(t, "%-*s", ABLATE_LABEL, a->row[r]->label);
        for (enum ablate_measure m = 0; m < ABLATE_MEASURES; m++) {
            const int    base  = before ? r - 1 : 0;
            const double paper = ablate_paper_against(a, r, base, m);
            char         text[80];
            snprintf(text, sizeof text, isnan(paper) ? "%s%s" : "%s (%s)", ABLATE_RELATIVE(m, ablate_against(a, r, base, m).mean),
                     isnan(paper) ? "" : ABLATE_RELATIVE(m, paper));
            study_add(t, "%*s", ablate_compared_width(m), text);
        }
        study_add(t, "\n");
    }
}

static int ablate_is_one_block(const struct ablation *a)
{
    for (int r = 0; r < a->rows; r++)
        if (a->blocks[r] > 1) return 0;
    return 1;
}

void ablate_table(struct study_text *t, const struct ablation *a)
{
    study_add(t, "%s: %d iterations, SH degree %d, ", a->scene, a->iterations, a->sh_degree);
    if (a->seeds > 1) study_add(t, "seeds 1 to %d (mean +- standard deviation)\n\n", a->seeds);
    else study_add(t, "seed 1\n\n");
    ablate_figures(t, a);
    if (a->rows > 1) ablate_comparison(t, a, "against the row before", 1);
    if (a->rows > 2) ablate_comparison(t, a, "against the first row", 0);
    study_add(
        t,
        "\nfar dB: PSNR of what lies in the farther third of depth, the pixels around points that the survey has there: the same in every row. MB: of scene.ply, all rows at SH degree %d. seconds: of training. memory MB: what the library held at its peak, row by row.\n",
        a->sh_degree);
    if (!a->held_out) study_add(t, "No view was held out: PSNR and SSIM are of the training views.\n");
    if (ablate_is_one_block(a))
        study_add(t, "The survey is one block, so midpoint and balanced cuts cut nothing; a smaller --block-points does.\n");
}

/* ---------------------------------------------------------------- CSV */

static const int ABLATE_CSV_DECIMALS[ABLATE_MEASURES] = {6, 8, 6, 0, 0, 3, 0};

/* figure 0: the means, 1: the spreads. */
static void ablate_csv_summary(struct study_text *t, const struct ablation *a, int r, int spread)
{
    study_add(t, "%s,%s,%d", a->row[r]->name, spread ? "sd" : "mean", a->blocks[r]);
    for (enum ablate_measure m = 0; m < ABLATE_MEASURES; m++) {
        const struct study_figure f = ablate_mean(a, r, m);
        study_add(t, ",%s", STUDY_FIXED(spread ? f.spread : f.mean, ABLATE_CSV_DECIMALS[m] + spread));
    }
    for (enum ablate_measure m = 0; m < ABLATE_MEASURES; m++) {
        const struct study_figure f = ablate_against(a, r, 0, m);
        study_add(t, ",%s", STUDY_FIXED(spread ? f.spread : f.mean, 6));
    }
    for (enum ablate_measure m = 0; m < ABLATE_MEASURES; m++)
        if (ABLATE_COLUMNS[m].in_paper) study_add(t, ",%s", spread ? "" : STUDY_FIXED(ablate_paper_against(a, r, 0, m), 6));
    study_add(t, "\n");
}

static void ablate_csv_seed(struct study_text *t, const struct ablation *a, int r, int s)
{
    study_add(t, "%s,%d,%d", a->row[r]->name, s + 1, a->blocks[r]);
    for (int m = 0; m < ABLATE_MEASURES; m++) study_add(t, ",%s", STUDY_FIXED(a->value[r][s][m], ABLATE_CSV_DECIMALS[m]));
    for (enum ablate_measure m = 0; m < ABLATE_MEASURES; m++)
        study_add(t, ",%s", STUDY_FIXED(ablate_compare(m, a->value[r][s][m], a->value[0][s][m]), 6));
    for (int m = 0; m < ABLATE_MEASURES; m++)
        if (ABLATE_COLUMNS[m].in_paper) study_add(t, ",");
    study_add(t, "\n");
}

void ablate_csv(struct study_text *t, const struct ablation *a)
{
    study_add(t, "row,seed,blocks");
    for (int m = 0; m < ABLATE_MEASURES; m++) study_add(t, ",%s", ABLATE_COLUMNS[m].csv);
    for (int m = 0; m < ABLATE_MEASURES; m++) study_add(t, ",%s", ABLATE_COLUMNS[m].csv_compared);
    for (int m = 0; m < ABLATE_MEASURES; m++)
        if (ABLATE_COLUMNS[m].in_paper) study_add(t, ",paper_%s", ABLATE_COLUMNS[m].csv_compared);
    study_add(t, "\n");
    for (int r = 0; r < a->rows; r++)
        for (int s = 0; s < a->seeds; s++) ablate_csv_seed(t, a, r, s);
    for (int r = 0; r < a->rows; r++)
        for (int spread = 0; spread < (a->seeds > 1 ? 2 : 1); spread++) ablate_csv_summary(t, a, r, spread);
}
