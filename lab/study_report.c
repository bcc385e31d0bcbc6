/* study_report.c - results of a study: means, spreads, comparisons, the Pareto front; one page for people,
 * one CSV for programs.
 *
 * Rows are compared seed by seed, which removes what both share. An effect not larger than its spread over
 * the seeds is "none".
 * A saving is useful only if the same time with fewer iterations gives less: each row of a sweep is compared
 * with that, too.
 */
#include "study.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static const struct table_column {
    const char *title, *csv;
    double scale; /* of the page's unit */
    int decimals, csv_decimals;
    int difference; /* compared by subtraction; 0: by division */
} TABLE_COLUMNS[STUDY_MEASURES] = {
    {"PSNR dB", "psnr_db", 1, 2, 6, 1},      {"SSIM", "ssim", 1, 4, 8, 1},
    {"structure", "structure", 1, 3, 6, 1},  {"least", "structure_least", 1, 3, 6, 1},
    {"near dB", "near_psnr_db", 1, 2, 6, 1}, {"middle dB", "mid_psnr_db", 1, 2, 6, 1},
    {"far dB", "far_psnr_db", 1, 2, 6, 1},   {"Gaussians", "gaussians", 1, 0, 0, 0},
    {"MB", "bytes", 1e-6, 2, 0, 0},          {"seconds", "seconds", 1, 1, 3, 0},
    {"CPU s", "cpu_seconds", 1, 1, 2, 0},    {"memory MB", "memory_bytes", 1e-6, 1, 0, 0},
    {"MS-SSIM", "ms_ssim", 1, 4, 8, 1},      {"LPIPS", "lpips", 1, 4, 6, 1},
};

enum { TABLE_LABEL = 37, TABLE_CELL = 9, TABLE_CELL_SPREAD = 15, TABLE_CELL_EFFECT = 22 }; /* letters */

/* ---------------- figures */

static struct study_figure table_summary(const double *x, int count)
{
    double sum = 0, square = 0, mean;
    for (int i = 0; i < count; i++) sum += x[i];
    mean = sum / count;
    for (int i = 0; i < count; i++) square += (x[i] - mean) * (x[i] - mean);
    if (count == 0) return (struct study_figure){NAN, NAN};
    return (struct study_figure){mean, count > 1 ? sqrt(square / (count - 1)) : NAN};
}

struct study_figure study_mean(const struct study *s, int row, enum study_measure m)
{
    double x[STUDY_SEEDS] = {0};
    for (int i = 0; i < s->done[row]; i++) x[i] = s->value[row][i][m];
    return table_summary(x, s->done[row]);
}

static double table_compare(enum study_measure m, double value, double base)
{
    return TABLE_COLUMNS[m].difference ? value - base : base > 0 ? value / base : NAN;
}

struct study_figure study_compare(const struct study *s, int row, int base, enum study_measure m)
{
    const int both = s->done[row] < s->done[base] ? s->done[row] : s->done[base];
    double x[STUDY_SEEDS] = {0};
    for (int i = 0; i < both; i++) x[i] = table_compare(m, s->value[row][i][m], s->value[base][i][m]);
    return table_summary(x, both);
}

static double table_paper_effect(const struct study *s, int row, int base, enum study_measure m)
{
    const double value = s->row[row]->paper[m], first = s->row[base]->paper[m];
    return value > 0 && first > 0 ? table_compare(m, value, first) : NAN;
}

/* Returns 1 for a row that is better in one and no worse in the other; of equals the first. */
static int table_dominates(double psnr, double cost, double other_psnr, double other_cost, int first)
{
    return psnr >= other_psnr && cost <= other_cost && (psnr > other_psnr || cost < other_cost || first);
}

int study_is_pareto_optimal(const struct study *s, int row)
{
    const double psnr = study_mean(s, row, STUDY_PSNR).mean, cpu = study_mean(s, row, STUDY_CPU).mean;
    for (int i = 0; i < s->rows; i++)
        if (i != row && table_dominates(study_mean(s, i, STUDY_PSNR).mean, study_mean(s, i, STUDY_CPU).mean,
                                        psnr, cpu, i < row))
            return 0;
    return !isnan(psnr) && !isnan(cpu);
}

static int table_is_of_iterations(const struct study_row *r)
{
    return r->iterations > 0;
}

/* Estimates the PSNR that the base's options reach in so much processor time with more iterations or fewer:
 * linear in the logarithm of time between the two neighbours among the rows that differ in iterations
 * alone; NaN outside of them. */
static double table_by_iterations(const struct study *s, double cpu)
{
    double below = 0, above = HUGE_VAL, psnr_below = NAN, psnr_above = NAN;
    for (int i = 0; i < s->rows; i++) {
        const double c = study_mean(s, i, STUDY_CPU).mean;
        if (!table_is_of_iterations(s->row[i]) || isnan(c)) continue;
        if (c <= cpu && c > below) below = c, psnr_below = study_mean(s, i, STUDY_PSNR).mean;
        if (c >= cpu && c < above) above = c, psnr_above = study_mean(s, i, STUDY_PSNR).mean;
    }
    if (below == above) return psnr_below;
    return psnr_below + (psnr_above - psnr_below) * log(cpu / below) / log(above / below);
}

/* Returns the n-th row that `row` is compared with; -1: there are no more. Without any of its own among the
 * rows it is the first row. */
static int table_baseline(const struct study *s, int row, int n)
{
    int found = 0;
    for (int k = 0; k < STUDY_AGAINST; k++)
        for (int i = 0; s->row[row]->against[k] && i < s->rows; i++)
            if (i != row && s->done[i] > 0 && strcmp(s->row[i]->name, s->row[row]->against[k]) == 0 &&
                found++ == n)
                return i;
    return found == 0 && n == 0 && row > 0 && s->done[0] > 0 ? 0 : -1;
}

/* ---------------- the page */

static void table_cell(struct output *t, int width, const char *text)
{
    output_add(t, " %*s |", width, text[0] ? text : "-");
}

static void table_header(struct output *t, const char *first, int width, const char *last)
{
    output_add(t, "\n| %-*s |", TABLE_LABEL, first);
    for (int m = 0; m < STUDY_MS_SSIM; m++) table_cell(t, width, TABLE_COLUMNS[m].title);
    if (last[0]) table_cell(t, 0, last);
    output_add(t, "\n|---|");
    for (int m = 0; m < STUDY_MS_SSIM + !!last[0]; m++) output_add(t, "---:|");
    output_add(t, "\n");
}

static void table_label(struct output *t, const char *mark, const char *name, const char *base)
{
    char text[120];
    snprintf(text, sizeof text, "%s%s%s%s", name, base[0] ? " against " : "", base, mark);
    output_add(t, "| %-*s |", TABLE_LABEL, text);
}

static void table_rows(struct output *t, const struct study *s)
{
    const int width = s->options->seeds > 1 ? TABLE_CELL_SPREAD : TABLE_CELL;
    table_header(t, "row", width, "blocks");
    for (int r = 0; r < s->rows; r++) {
        if (s->done[r] == 0) continue;
        table_label(t, study_is_pareto_optimal(s, r) ? " \\*" : "", s->row[r]->label, "");
        for (enum study_measure m = 0; m < STUDY_MS_SSIM; m++) {
            const struct table_column *c = &TABLE_COLUMNS[m];
            const struct study_figure f = study_mean(s, r, m);
            const char *spread = OUTPUT_FIXED(f.spread * c->scale, c->decimals);
            char text[80];
            snprintf(text, sizeof text, "%s%s%s", OUTPUT_FIXED(f.mean * c->scale, c->decimals),
                     spread[0] ? " +-" : "", spread);
            table_cell(t, width, text);
        }
        output_add(t, " %d |\n", s->blocks[r]);
    }
}

/* Writes "+0.65" or "x0.885"; "" when it is not known. */
static const char *table_relative(char out[32], enum study_measure m, double value)
{
    const int difference = TABLE_COLUMNS[m].difference;
    const char *digits = OUTPUT_FIXED(value, difference ? TABLE_COLUMNS[m].decimals : 3);
    snprintf(out, 32, "%s%s", !digits[0] ? "" : !difference ? "x" : digits[0] == '-' ? "" : "+", digits);
    return out;
}
#define TABLE_RELATIVE(m, value) table_relative((char[32]){0}, m, value)

/* Writes "+0.75 +-0.25 (+0.65)": ours, its spread, the paper's. */
static void table_effect(struct output *t, const struct study *s, int row, int base, enum study_measure m)
{
    const struct study_figure f = study_compare(s, row, base, m);
    const int none = fabs(f.mean - !TABLE_COLUMNS[m].difference) <= f.spread; /* of one seed never */
    const char *paper = TABLE_RELATIVE(m, table_paper_effect(s, row, base, m));
    const char *spread =
        OUTPUT_FIXED(none ? NAN : f.spread, TABLE_COLUMNS[m].difference ? TABLE_COLUMNS[m].decimals : 3);
    char text[120];
    snprintf(text, sizeof text, "%s%s%s%s%s%s", none ? "none" : TABLE_RELATIVE(m, f.mean),
             spread[0] ? " +-" : "", spread, paper[0] ? " (" : "", paper, paper[0] ? ")" : "");
    table_cell(t, TABLE_CELL_EFFECT, text);
}

static void table_effects(struct output *t, const struct study *s)
{
    table_header(t, "row against row", TABLE_CELL_EFFECT,
                 s->kind->has_baseline ? "dB over other iterations" : "");
    for (int r = 0; r < s->rows; r++)
        for (int n = 0, base; s->done[r] && (base = table_baseline(s, r, n)) >= 0; n++) {
            const double cpu = study_mean(s, r, STUDY_CPU).mean;
            const double other = table_is_of_iterations(s->row[r]) ? NAN : table_by_iterations(s, cpu);
            table_label(t, "", s->row[r]->label, s->row[base]->label);
            for (enum study_measure m = 0; m < STUDY_MS_SSIM; m++) table_effect(t, s, r, base, m);
            if (s->kind->has_baseline)
                table_cell(t, 0, TABLE_RELATIVE(STUDY_PSNR, study_mean(s, r, STUDY_PSNR).mean - other));
            output_add(t, "\n");
        }
}

static void table_untrained(struct output *t, const struct study *s)
{
    for (int r = 0; r < s->rows; r++)
        if (s->done[r] < s->options->seeds)
            output_add(
                t,
                "\nNot trained: %s, %d of %d seeds done; the next takes about %.0f s, more than is left of %.0f s. The same command"
                " with a larger --budget resumes.\n",
                s->row[r]->name, s->done[r], s->options->seeds, s->wanted[r], s->options->budget);
}

static int table_is_one_block(const struct study *s)
{
    for (int r = 0; r < s->rows; r++)
        if (s->blocks[r] > 1) return 0;
    return 1;
}

void study_page(struct output *t, const struct study *s)
{
    output_add(
        t,
        "# %s\n\n%s: preset %s, %d iterations, images of at most %d px a side, %d training views, seed%s 1",
        s->kind->title, s->options->scene, s->base.preset ? s->base.preset : "-", s->base.train.iterations,
        s->base.scene.max_side, s->train_views, s->options->seeds > 1 ? "s" : "");
    if (s->options->seeds > 1) output_add(t, " to %d (mean +- standard deviation)", s->options->seeds);
    output_add(t, ".\nPSNR and SSIM are of the %s views.\n\n![PSNR over cost](%s.svg)\n\n## Rows\n",
               s->held_out ? "held-out" : "training", s->kind->file);
    table_rows(t, s);
    output_add(
        t,
        "\n## Effects\n\nDifferences, or ratios (x), seed by seed. none: not larger than the standard deviation over the"
        " seeds. In brackets: the paper's own.\n");
    table_effects(t, s);
    table_untrained(t, s);
    output_add(
        t,
        "\n\\*: on the front, no other row has as good a PSNR in no more CPU time. structure: correlation of detail, 0 is a veil; least: over\n"
        "the training views, too. near, middle, far: PSNR of the thirds of\n"
        "depth, over the pixels around points that the survey has there. MB: the model's file. seconds: training. CPU s: all threads\n"
        "together. memory: what the library held at its peak.\n%s",
        s->kind->notes);
    if (!s->kind->has_baseline && table_is_one_block(s))
        output_add(
            t,
            "The survey is one block: midpoint and balanced cuts cut nothing; a smaller --block-points does.\n");
}

/* ---------------- CSV */

/* Writes a line of the rows' table; base: "" or the row that it is compared with. */
static void table_line(struct output *t, const struct study *s, int r, const char *base, const char *seed,
                       const double *value)
{
    output_add(t, "%s,%s,%s,%d", s->row[r]->name, base, seed, s->blocks[r]);
    for (int m = 0; m < STUDY_MEASURES; m++)
        output_add(t, ",%.*f", base[0] ? 6 : TABLE_COLUMNS[m].csv_decimals, value[m]);
    output_add(t, ",%s\n", base[0] ? "" : study_is_pareto_optimal(s, r) ? "1" : "0");
}

/* Writes the means of a row. base: -1: of the row itself; else differences from that row. */
static void table_summaries(struct output *t, const struct study *s, int r, int base)
{
    const char *name = base < 0 ? "" : s->row[base]->name;
    double mean[STUDY_MEASURES], spread[STUDY_MEASURES], paper[STUDY_MEASURES];
    for (enum study_measure m = 0; m < STUDY_MEASURES; m++) {
        const struct study_figure f = base < 0 ? study_mean(s, r, m) : study_compare(s, r, base, m);
        mean[m] = f.mean, spread[m] = f.spread;
        paper[m] = base < 0 ? NAN : table_paper_effect(s, r, base, m);
    }
    table_line(t, s, r, name, "mean", mean);
    if (s->done[r] > 1) table_line(t, s, r, name, "sd", spread);
    if (!isnan(paper[STUDY_PSNR])) table_line(t, s, r, name, "paper", paper);
}

void study_csv(struct output *t, const struct study *s)
{
    output_add(t, "row,against,seed,blocks");
    for (int m = 0; m < STUDY_MEASURES; m++) output_add(t, ",%s", TABLE_COLUMNS[m].csv);
    output_add(t, ",front\n");
    for (int r = 0; r < s->rows; r++) {
        for (int i = 0; i < s->done[r]; i++) table_line(t, s, r, "", OUTPUT_FIXED(i + 1, 0), s->value[r][i]);
        if (s->done[r] > 0) table_summaries(t, s, r, -1);
        for (int n = 0, base; s->done[r] && (base = table_baseline(s, r, n)) >= 0; n++)
            table_summaries(t, s, r, base);
    }
}
