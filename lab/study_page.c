/* study_page.c - results of a study: means, spreads, comparisons, the Pareto front; one page for people, one
 * CSV for programs.
 *
 * Rows are compared seed by seed, which removes what both share. An effect not larger than its spread over
 * the seeds is "none".
 */
#include "study.h"

#include <math.h>
#include <string.h>

const struct study_column STUDY_COLUMNS[STUDY_MEASURES] = {
    {"iterations", "iterations", 1, 0, 0},
    {"PSNR dB", "psnr", 1, 2, 1},
    {"shown dB", "shown_psnr", 1, 2, 1},
    {"SSIM", "ssim", 1, 4, 1},
    {"structure", "structure", 1, 3, 1},
    {"Gaussians", "gaussians", 1, 0, 0},
    {"MB", "bytes", 1e-6, 2, 0},
    {NULL, "seconds", 1, 1, 0},
    {"CPU min", "cpu_seconds", 1. / 60, 2, 0},
    {"peak MB", "library_peak_bytes", 1e-6, 1, 0},
};

/* ---------------- figures */

static struct study_figure page_summary(const double *x, int count)
{
    struct study_figure f = {0, 0};
    for (int i = 0; i < count; i++) f.mean += x[i] / count;
    for (int i = 0; i < count; i++) f.spread += (x[i] - f.mean) * (x[i] - f.mean) / (count - 1);
    return (struct study_figure){count > 0 ? f.mean : NAN, count > 1 ? sqrt(f.spread) : NAN};
}

struct study_figure study_mean(const struct study *s, int row, enum study_measure m)
{
    double x[CLI_SEEDS];
    for (int i = 0; i < s->done[row]; i++) x[i] = s->value[row][i][m];
    return page_summary(x, s->done[row]);
}

struct study_figure study_compare(const struct study *s, int row, int base, enum study_measure m)
{
    const int both = s->done[row] < s->done[base] ? s->done[row] : s->done[base];
    double x[CLI_SEEDS];
    for (int i = 0; i < both; i++) {
        const double value = s->value[row][i][m], other = s->value[base][i][m];
        x[i] = STUDY_COLUMNS[m].difference ? value - other : value / other;
    }
    return page_summary(x, both);
}

int study_is_pareto_optimal(const struct study *s, int row)
{
    const double psnr = study_mean(s, row, STUDY_PSNR).mean, cpu = study_mean(s, row, STUDY_CPU).mean;
    for (int i = 0; i < s->rows; i++) {
        const double other = study_mean(s, i, STUDY_PSNR).mean, cost = study_mean(s, i, STUDY_CPU).mean;
        /* of equals the first is on it */
        if (i != row && other >= psnr && cost <= cpu && (other > psnr || cost < cpu || i < row)) return 0;
    }
    return !isnan(psnr) && !isnan(cpu);
}

/* Returns 1 if a row is compared with another: one of its own, or else the first. */
static int page_is_compared(const struct study *s, int row, int base)
{
    int own = 0;
    for (int k = 0; k < STUDY_AGAINST && s->row[row]->against[k]; k++)
        for (int i = 0; i < s->rows; i++) {
            if (i == row || !s->done[i] || strcmp(s->row[i]->name, s->row[row]->against[k]) != 0) continue;
            if (i == base) return 1;
            own = 1;
        }
    return !own && base == 0 && row > 0 && s->done[0] > 0;
}

/* ---------------- the page */

static void page_header(struct output *t, const char *row)
{
    output_add(t, "\n| scene | %s |", row);
    for (int m = 0; m < STUDY_MEASURES; m++)
        if (STUDY_COLUMNS[m].title) output_add(t, " %s |", STUDY_COLUMNS[m].title);
    output_add(t, "\n|---|---|");
    for (int m = 0; m < STUDY_MEASURES; m++)
        if (STUDY_COLUMNS[m].title) output_add(t, "---:|");
    output_add(t, "\n");
}

/* Writes "+0.75 +-0.25", "x0.885" or "-": what is known of a figure. */
static void page_cell(struct output *t, struct study_figure f, const char *sign, int decimals)
{
    const char *mean = OUTPUT_FIXED(f.mean, decimals), *spread = OUTPUT_FIXED(f.spread, decimals);
    output_add(t, " %s%s%s%s |", mean[0] && mean[0] != '-' ? sign : "", mean[0] ? mean : "-",
               spread[0] ? " +-" : "", spread);
}

static void page_row(struct output *t, const struct study *s, int row)
{
    output_add(t, "| %s | %s%s |", study_scene(s), s->row[row]->label,
               study_is_pareto_optimal(s, row) ? " \\*" : "");
    for (enum study_measure m = 0; m < STUDY_MEASURES; m++) {
        const struct study_figure f = study_mean(s, row, m);
        const struct study_column *c = &STUDY_COLUMNS[m];
        if (c->title)
            page_cell(t, (struct study_figure){f.mean * c->scale, f.spread * c->scale}, "", c->decimals);
    }
    output_add(t, "\n");
}

static void page_effect(struct output *t, const struct study *s, int row, int base)
{
    output_add(t, "| %s | %s against %s |", study_scene(s), s->row[row]->label, s->row[base]->label);
    for (enum study_measure m = 0; m < STUDY_MEASURES; m++) {
        const struct study_column *c = &STUDY_COLUMNS[m];
        const struct study_figure f = study_compare(s, row, base, m);
        if (!c->title) continue;
        if (fabs(f.mean - !c->difference) <= f.spread) output_add(t, " none |"); /* of one seed never */
        else page_cell(t, f, c->difference ? "+" : "x", c->difference ? c->decimals : 3);
    }
    output_add(t, "\n");
}

void study_section(struct output *t, const struct study *s, int count)
{
    output_add(t, "\n## %s\n", s->kind->title);
    page_header(t, "row");
    for (int i = 0; i < count; i++)
        for (int r = 0; r < s[i].rows; r++)
            if (s[i].done[r]) page_row(t, &s[i], r);
    page_header(t, "row against row");
    for (int i = 0; i < count; i++)
        for (int r = 0; r < s[i].rows; r++)
            for (int base = 0; s[i].done[r] && base < s[i].rows; base++)
                if (page_is_compared(&s[i], r, base)) page_effect(t, &s[i], r, base);
    for (int i = 0; i < count; i++)
        for (int r = 0, missing = 0; r < s[i].rows; r++) {
            if (s[i].done[r] == s[i].options->seeds) continue;
            if (!missing++) output_add(t, "\nNot trained within the budget on %s:", study_scene(&s[i]));
            output_add(t, "%s %s (%d of %d seeds)", missing > 1 ? "," : "", s[i].row[r]->name, s[i].done[r],
                       s[i].options->seeds);
        }
    if (s->kind->notes) output_add(t, "\n\n%s", s->kind->notes);
    output_add(t, "\n");
}

/* ---------------- CSV */

void study_csv(struct output *t, const struct study *s, int count)
{
    for (int k = 0; k < count; k++)
        for (int r = 0; r < s[k].rows; r++)
            for (int i = 0; i < s[k].done[r]; i++) {
                output_add(t, "%s,%s,%s,%d", s->kind->name, study_scene(&s[k]), s[k].row[r]->name, i + 1);
                for (int m = 0; m < STUDY_MEASURES; m++) output_add(t, ",%.6f", s[k].value[r][i][m]);
                output_add(t, "\n");
            }
}
