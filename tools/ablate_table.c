/* ablate_table.c - means and spreads of an ablation; the table for people and the one for programs.
 *
 * A row is compared with another seed by seed: what both share, the seed's luck, is not taken for an effect.
 */
#include "ablate.h"

#include <math.h>
#include <stdarg.h>
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
    {"Gaussians", "Gaussians", "gaussians", "gaussians_over_first", 1, 0, 0, 0},
    {"MB", "size", "bytes", "bytes_over_first", 1e-6, 2, 0, 1},
    {"seconds", "time", "seconds", "seconds_over_first", 1, 1, 0, 1},
    {"memory MB", "memory", "memory_bytes", "memory_over_first", 1e-6, 1, 0, 0},
};

enum { ABLATE_LABEL = 19, ABLATE_CELL = 11, ABLATE_CELL_SPREAD = 17, ABLATE_CELL_PAPER = 19 }; /* letters */

/* ---------------------------------------------------------------- figures */

static struct ablate_figure ablate_summary(const double *x, int count)
{
    double sum = 0, square = 0, mean;
    for (int i = 0; i < count; i++) sum += x[i];
    mean = sum / count;
    for (int i = 0; i < count; i++) square += (x[i] - mean) * (x[i] - mean);
    return (struct ablate_figure){mean, count > 1 ? sqrt(square / (count - 1)) : NAN};
}

struct ablate_figure ablate_mean(const struct ablation *a, int row, enum ablate_measure m)
{
    double x[ABLATE_SEEDS] = {0};
    for (int s = 0; s < a->seeds; s++) x[s] = a->value[row][s][m];
    return ablate_summary(x, a->seeds);
}

static double ablate_compare(enum ablate_measure m, double value, double base)
{
    return ABLATE_COLUMNS[m].difference ? value - base : base > 0 ? value / base : NAN;
}

struct ablate_figure ablate_against(const struct ablation *a, int row, int base, enum ablate_measure m)
{
    double x[ABLATE_SEEDS] = {0};
    for (int s = 0; s < a->seeds; s++) x[s] = ablate_compare(m, a->value[row][s][m], a->value[base][s][m]);
    return ablate_summary(x, a->seeds);
}

double ablate_paper_against(const struct ablation *a, int row, int base, enum ablate_measure m)
{
    const double value = a->row[row]->paper[m], first = a->row[base]->paper[m];
    return value > 0 && first > 0 ? ablate_compare(m, value, first) : NAN;
}

/* ---------------------------------------------------------------- text */

void ablate_add(struct ablate_text *t, const char *format, ...)
{
    va_list list;
    int     size;
    va_start(list, format);
    size = vsnprintf(NULL, 0, format, list);
    va_end(list);
    if (size < 0) t->failed = 1;
    if (!t->failed && t->used + (size_t)size + 1 > t->capacity) {
        const size_t capacity = 2 * t->capacity + (size_t)size + 1024;
        char        *data     = realloc(t->data, capacity);
        if (data) t->data = data, t->capacity = capacity;
        else t->failed = 1;
    }
    if (t->failed) return;
    va_start(list, format);
    vsnprintf(t->data + t->used, t->capacity - t->used, format, list);
    va_end(list);
    t->used += (size_t)size;
}

const char *ablate_fixed(char out[32], double value, int decimals)
{
    char   text[64];
    size_t size = 0;
    out[0]      = 0;
    if (!isfinite(value) || fabs(value) >= 1e18) return out;
    snprintf(text, sizeof text, "%.*f", decimals, value);
    for (const char *p = text; *p; p++) {
        if (strchr("-0123456789", *p)) out[size++] = *p;
        else if (size > 0 && out[size - 1] != '.') out[size++] = '.'; /* the locale's point has one byte or more */
    }
    out[size] = 0;
    if (out[0] == '-' && strspn(out, "-0.") == size) memmove(out, out + 1, size); /* -0.00 */
    return out;
}

const char *ablate_relative(char out[32], enum ablate_measure m, double value)
{
    const int   difference = ABLATE_COLUMNS[m].difference;
    const char *digits     = ABLATE_FIXED(value, difference ? ABLATE_COLUMNS[m].decimals : 3);
    const char *sign       = !difference ? "x" : digits[0] == '-' ? "" : "+";
    snprintf(out, 32, "%s%s", digits[0] ? sign : "-", digits);
    return out;
}

/* ---------------------------------------------------------------- the table */

static void ablate_cell(struct ablate_text *t, const struct ablation *a, enum ablate_measure m, struct ablate_figure f)
{
    const struct ablate_column *c      = &ABLATE_COLUMNS[m];
    const char                 *mean   = ABLATE_FIXED(f.mean * c->scale, c->decimals);
    const char                 *spread = ABLATE_FIXED(f.spread * c->scale, c->decimals);
    char                        text[80];
    snprintf(text, sizeof text, "%s%s%s", mean[0] ? mean : "-", spread[0] ? " +-" : "", spread);
    ablate_add(t, "%*s", a->seeds > 1 ? ABLATE_CELL_SPREAD : ABLATE_CELL, text);
}

static void ablate_figures(struct ablate_text *t, const struct ablation *a)
{
    ablate_add(t, "%-*s", ABLATE_LABEL, "");
    for (int m = 0; m < ABLATE_MEASURES; m++)
        ablate_add(t, "%*s", a->seeds > 1 ? ABLATE_CELL_SPREAD : ABLATE_CELL, ABLATE_COLUMNS[m].title);
    ablate_add(t, "  blocks\n");
    for (int r = 0; r < a->rows; r++) {
        ablate_add(t, "%-*s", ABLATE_LABEL, a->row[r]->label);
        for (enum ablate_measure m = 0; m < ABLATE_MEASURES; m++) ablate_cell(t, a, m, ablate_mean(a, r, m));
        ablate_add(t, "%8d\n", a->blocks[r]);
    }
}

static int ablate_compared_width(int measure)
{
    return ABLATE_COLUMNS[measure].in_paper ? ABLATE_CELL_PAPER : ABLATE_CELL;
}

/* before: against the row before, else against the first. */
static void ablate_comparison(struct ablate_text *t, const struct ablation *a, const char *title, int before)
{
    ablate_add(t, "\n%s; in brackets the paper's own\n%-*s", title, ABLATE_LABEL, "");
    for (int m = 0; m < ABLATE_MEASURES; m++) ablate_add(t, "%*s", ablate_compared_width(m), ABLATE_COLUMNS[m].compared);
    ablate_add(t, "\n");
    for (int r = 1; r < a->rows; r++) {
        ablate_add(t, "%-*s", ABLATE_LABEL, a->row[r]->label);
        for (enum ablate_measure m = 0; m < ABLATE_MEASURES; m++) {
            const int    base  = before ? r - 1 : 0;
            const double paper = ablate_paper_against(a, r, base, m);
            char         text[80];
            snprintf(text, sizeof text, isnan(paper) ? "%s%s" : "%s (%s)", ABLATE_RELATIVE(m, ablate_against(a, r, base, m).mean),
                     isnan(paper) ? "" : ABLATE_RELATIVE(m, paper));
            ablate_add(t, "%*s", ablate_compared_width(m), text);
        }
        ablate_add(t, "\n");
    }
}

static int ablate_is_one_block(const struct ablation *a)
{
    for (int r = 0; r < a->rows; r++)
        if (a->blocks[r] > 1) return 0;
    return 1;
}

void ablate_table(struct ablate_text *t, const struct ablation *a)
{
    ablate_add(t, "%s: %d iterations, SH degree %d, ", a->scene, a->iterations, a->sh_degree);
    if (a->seeds > 1) ablate_add(t, "seeds 1 to %d (mean +- standard deviation)\n\n", a->seeds);
    else ablate_add(t, "seed 1\n\n");
    ablate_figures(t, a);
    if (a->rows > 1) ablate_comparison(t, a, "against the row before", 1);
    if (a->rows > 2) ablate_comparison(t, a, "against the first row", 0);
    ablate_add(
        t,
        "\nMB: of scene.ply, all rows at SH degree %d. seconds: of training. memory MB: what the library held at its peak, row by row.\n",
        a->sh_degree);
    if (!a->held_out) ablate_add(t, "No view was held out: PSNR and SSIM are of the training views.\n");
    if (ablate_is_one_block(a))
        ablate_add(t, "The survey is one block, so midpoint and balanced cuts cut nothing; a smaller --block-points does.\n");
}

/* ---------------------------------------------------------------- CSV */

static const int ABLATE_CSV_DECIMALS[ABLATE_MEASURES] = {6, 8, 0, 0, 3, 0};

/* figure 0: the means, 1: the spreads. */
static void ablate_csv_summary(struct ablate_text *t, const struct ablation *a, int r, int spread)
{
    ablate_add(t, "%s,%s,%d", a->row[r]->name, spread ? "sd" : "mean", a->blocks[r]);
    for (enum ablate_measure m = 0; m < ABLATE_MEASURES; m++) {
        const struct ablate_figure f = ablate_mean(a, r, m);
        ablate_add(t, ",%s", ABLATE_FIXED(spread ? f.spread : f.mean, ABLATE_CSV_DECIMALS[m] + spread));
    }
    for (enum ablate_measure m = 0; m < ABLATE_MEASURES; m++) {
        const struct ablate_figure f = ablate_against(a, r, 0, m);
        ablate_add(t, ",%s", ABLATE_FIXED(spread ? f.spread : f.mean, 6));
    }
    for (enum ablate_measure m = 0; m < ABLATE_MEASURES; m++)
        if (ABLATE_COLUMNS[m].in_paper) ablate_add(t, ",%s", spread ? "" : ABLATE_FIXED(ablate_paper_against(a, r, 0, m), 6));
    ablate_add(t, "\n");
}

static void ablate_csv_seed(struct ablate_text *t, const struct ablation *a, int r, int s)
{
    ablate_add(t, "%s,%d,%d", a->row[r]->name, s + 1, a->blocks[r]);
    for (int m = 0; m < ABLATE_MEASURES; m++) ablate_add(t, ",%s", ABLATE_FIXED(a->value[r][s][m], ABLATE_CSV_DECIMALS[m]));
    for (enum ablate_measure m = 0; m < ABLATE_MEASURES; m++)
        ablate_add(t, ",%s", ABLATE_FIXED(ablate_compare(m, a->value[r][s][m], a->value[0][s][m]), 6));
    for (int m = 0; m < ABLATE_MEASURES; m++)
        if (ABLATE_COLUMNS[m].in_paper) ablate_add(t, ",");
    ablate_add(t, "\n");
}

void ablate_csv(struct ablate_text *t, const struct ablation *a)
{
    ablate_add(t, "row,seed,blocks");
    for (int m = 0; m < ABLATE_MEASURES; m++) ablate_add(t, ",%s", ABLATE_COLUMNS[m].csv);
    for (int m = 0; m < ABLATE_MEASURES; m++) ablate_add(t, ",%s", ABLATE_COLUMNS[m].csv_compared);
    for (int m = 0; m < ABLATE_MEASURES; m++)
        if (ABLATE_COLUMNS[m].in_paper) ablate_add(t, ",paper_%s", ABLATE_COLUMNS[m].csv_compared);
    ablate_add(t, "\n");
    for (int r = 0; r < a->rows; r++)
        for (int s = 0; s < a->seeds; s++) ablate_csv_seed(t, a, r, s);
    for (int r = 0; r < a->rows; r++)
        for (int spread = 0; spread < (a->seeds > 1 ? 2 : 1); spread++) ablate_csv_summary(t, a, r, spread);
}
