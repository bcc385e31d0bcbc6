/* tradeoff_text.c - what a sweep says: the Pareto front, each row's price in words, a table for people and one for programs.
 *
 * Rows are compared by processor time, which other work on the machine disturbs less than the clock's; and seed by seed, so that what
 * both share, the seed's luck, is not taken for an effect. A saving is worth its price only if fewer iterations, which any user can
 * have, would cost more: each row is held against that.
 */
#include "tradeoff.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static const struct tradeoff_column {
    const char *title, *csv;
    double      scale; /* of the table's unit */
    int         decimals;
    int         difference; /* compared by subtraction; 0: by division */
    int         csv_decimals;
} TRADEOFF_COLUMNS[TRADEOFF_MEASURES] = {
    {"PSNR dB", "psnr_db", 1, 2, 1, 6},   {"SSIM", "ssim", 1, 4, 1, 8},           {"MS-SSIM", "ms_ssim", 1, 4, 1, 8},
    {"CPU s", "cpu_seconds", 1, 1, 0, 2}, {"clock s", "seconds", 1, 1, 0, 3},     {"memory MB", "memory_bytes", 1e-6, 0, 0, 0},
    {"file MB", "bytes", 1e-6, 2, 0, 0},  {"Gaussians", "gaussians", 1, 0, 0, 0},
};

/* ---------------------------------------------------------------- figures */

struct study_figure tradeoff_mean(const struct tradeoff *t, int row, enum tradeoff_measure m)
{
    double x[STUDY_SEEDS] = {0};
    for (int s = 0; s < t->done[row]; s++) x[s] = t->value[row][s][m];
    return t->done[row] ? study_summary(x, t->done[row]) : (struct study_figure){NAN, NAN};
}

struct study_figure tradeoff_against_base(const struct tradeoff *t, int row, enum tradeoff_measure m)
{
    const int both           = t->done[row] < t->done[0] ? t->done[row] : t->done[0];
    double    x[STUDY_SEEDS] = {0};
    for (int s = 0; s < both; s++) {
        const double value = t->value[row][s][m], base = t->value[0][s][m];
        x[s] = TRADEOFF_COLUMNS[m].difference ? value - base : base > 0 ? value / base : NAN;
    }
    return both ? study_summary(x, both) : (struct study_figure){NAN, NAN};
}

int tradeoff_on_front(const struct tradeoff *t, int row)
{
    const double psnr = tradeoff_mean(t, row, TRADEOFF_PSNR).mean, cpu = tradeoff_mean(t, row, TRADEOFF_CPU).mean;
    if (isnan(psnr) || isnan(cpu)) return 0;
    for (int i = 0; i < t->rows; i++) {
        const double p = tradeoff_mean(t, i, TRADEOFF_PSNR).mean, c = tradeoff_mean(t, i, TRADEOFF_CPU).mean;
        if (i != row && p >= psnr && c <= cpu && (p > psnr || c < cpu || i < row)) return 0;
    }
    return 1;
}

int tradeoff_picture_on_front(const struct tradeoff *t, int picture)
{
    const struct tradeoff_picture *p = t->picture, *own = &t->picture[picture];
    for (int i = 0; i < t->pictures; i++)
        if (i != picture && p[i].psnr >= own->psnr && p[i].fps >= own->fps &&
            (p[i].psnr > own->psnr || p[i].fps > own->fps || i < picture))
            return 0;
    return 1;
}

static int tradeoff_is_of_iterations(const struct tradeoff_row *r)
{
    return r->option == TRADEOFF_ITERATIONS;
}

/* The two neighbours in time among the rows of the base's options; PSNR is taken as linear in the logarithm of time. */
double tradeoff_by_iterations(const struct tradeoff *t, double cpu)
{
    double below = 0, above = HUGE_VAL, psnr_below = NAN, psnr_above = NAN;
    for (int i = 0; i < t->rows; i++) {
        const double c = tradeoff_mean(t, i, TRADEOFF_CPU).mean;
        if (!tradeoff_is_of_iterations(t->row[i]) || isnan(c)) continue;
        if (c <= cpu && c > below) below = c, psnr_below = tradeoff_mean(t, i, TRADEOFF_PSNR).mean;
        if (c >= cpu && c < above) above = c, psnr_above = tradeoff_mean(t, i, TRADEOFF_PSNR).mean;
    }
    if (below == above) return psnr_below;
    return psnr_below + (psnr_above - psnr_below) * log(cpu / below) / log(above / below);
}

/* ---------------------------------------------------------------- words */

static const char *tradeoff_signed(char out[32], double value, int decimals)
{
    const char *digits = STUDY_FIXED(value, decimals);
    snprintf(out, 32, "%s%s", digits[0] == '-' ? "" : "+", digits);
    return out;
}
#define TRADEOFF_SIGNED(value, decimals) tradeoff_signed((char[32]){0}, value, decimals)

/* "1.48x faster, +0.39 dB (spread 0.05)" */
static void tradeoff_price(struct study_text *out, const struct tradeoff *t, int row)
{
    const struct study_figure time = tradeoff_against_base(t, row, TRADEOFF_CPU),
                              psnr = tradeoff_against_base(t, row, TRADEOFF_PSNR);
    const double memory            = tradeoff_against_base(t, row, TRADEOFF_MEMORY).mean;
    const double bytes             = tradeoff_against_base(t, row, TRADEOFF_BYTES).mean;
    if (isnan(time.mean)) study_add(out, "time not known");
    else study_add(out, "%sx %s", STUDY_FIXED(time.mean > 1 ? time.mean : 1 / time.mean, 2), time.mean > 1 ? "slower" : "faster");
    study_add(out, ", %s dB", TRADEOFF_SIGNED(psnr.mean, 2));
    if (!isnan(psnr.spread)) study_add(out, " (spread %s)", STUDY_FIXED(psnr.spread, 2));
    study_add(out, ", SSIM %s, MS-SSIM %s", TRADEOFF_SIGNED(tradeoff_against_base(t, row, TRADEOFF_SSIM).mean, 4),
              TRADEOFF_SIGNED(tradeoff_against_base(t, row, TRADEOFF_MS_SSIM).mean, 4));
    if (bytes < 0.98 || bytes > 1.02) study_add(out, ", file x%s", STUDY_FIXED(bytes, 2));
    if (memory < 0.98 || memory > 1.02) study_add(out, ", memory x%s", STUDY_FIXED(memory, 2));
}

/* Whether the same time is had better by training for fewer steps. */
static void tradeoff_verdict(struct study_text *out, const struct tradeoff *t, int row)
{
    const double cpu = tradeoff_mean(t, row, TRADEOFF_CPU).mean, psnr = tradeoff_mean(t, row, TRADEOFF_PSNR).mean;
    const double other = tradeoff_by_iterations(t, cpu);
    if (tradeoff_is_of_iterations(t->row[row]) || isnan(other)) return;
    study_add(out, "; the base for as long reaches %s dB: %s dB", STUDY_FIXED(other, 2), TRADEOFF_SIGNED(psnr - other, 2));
}

static void tradeoff_words(struct study_text *out, const struct tradeoff *t, const char *bullet)
{
    for (int r = 1; r < t->rows; r++) {
        if (t->done[r] == 0) continue;
        study_add(out, "%s%s: ", bullet, t->row[r]->name);
        tradeoff_price(out, t, r);
        tradeoff_verdict(out, t, r);
        study_add(out, tradeoff_on_front(t, r) ? "; on the front\n" : "\n");
    }
    for (int i = 1; i < t->pictures; i++)
        study_add(out, "%spictures, %s: %sx the frames a second, %s dB to the exact pictures, file x%s%s\n", bullet,
                  t->picture[i].label, STUDY_FIXED(t->picture[i].fps / t->picture[0].fps, 2), STUDY_FIXED(t->picture[i].psnr, 1),
                  STUDY_FIXED(t->picture[i].bytes / t->picture[0].bytes, 2),
                  tradeoff_picture_on_front(t, i) ? "; on the front" : "");
}

static void tradeoff_left_out(struct study_text *out, const struct tradeoff *t, const char *bullet)
{
    for (int r = 0; r < t->rows; r++)
        if (t->done[r] < t->seeds)
            study_add(
                out,
                "%s%s: %d of %d seeds; the next takes about %s s, more than is left of %s s. The same command with a larger "
                "--budget goes on.\n",
                bullet, t->row[r]->name, t->done[r], t->seeds, STUDY_FIXED(t->wanted[r], 0), STUDY_FIXED(t->budget, 0));
}

static void tradeoff_head(struct study_text *out, const struct tradeoff *t)
{
    study_add(out, "%s: preset %s, %d iterations, photographs of at most %d px a side, %d of them to train with. ", t->scene,
              t->preset ? t->preset : "-", t->iterations, t->max_side, t->train_views);
    if (t->seeds > 1) study_add(out, "Mean +- standard deviation of up to %d seeds. ", t->seeds);
    study_add(out, "%s\n",
              t->held_out ? "PSNR, SSIM and MS-SSIM of views held out."
                          : "No view was held out: PSNR, SSIM and MS-SSIM are of the training views.");
}

static const char TRADEOFF_NOTES[] =
    "CPU s: of all threads together. clock s: as it went by on this machine. memory: what the library held at its peak.\n"
    "*: on the front, no other row is as good in no more CPU time. MS-SSIM is not LPIPS, which needs a trained network.\n";

/* ---------------------------------------------------------------- the table */

static void tradeoff_cell(char out[80], const struct tradeoff *t, int row, enum tradeoff_measure m)
{
    const struct tradeoff_column *c      = &TRADEOFF_COLUMNS[m];
    const struct study_figure     f      = tradeoff_mean(t, row, m);
    const char                   *mean   = STUDY_FIXED(f.mean * c->scale, c->decimals);
    const char                   *spread = STUDY_FIXED(f.spread * c->scale, c->decimals);
    snprintf(out, 80, "%s%s%s", mean[0] ? mean : "-", spread[0] ? " +-" : "", spread);
}

void tradeoff_table(struct study_text *out, const struct tradeoff *t)
{
    const int width = t->seeds > 1 ? 16 : 10;
    char      cell[80];
    tradeoff_head(out, t);
    study_add(out, "\n  %-19s", "");
    for (int m = 0; m < TRADEOFF_MEASURES; m++) study_add(out, "%*s", width, TRADEOFF_COLUMNS[m].title);
    study_add(out, "\n");
    for (int r = 0; r < t->rows; r++) {
        if (t->done[r] == 0) continue;
        study_add(out, "%c %-19s", tradeoff_on_front(t, r) ? '*' : ' ', t->row[r]->name);
        for (enum tradeoff_measure m = 0; m < TRADEOFF_MEASURES; m++) {
            tradeoff_cell(cell, t, r, m);
            study_add(out, "%*s", width, cell);
        }
        study_add(out, "\n");
    }
    study_add(out, "\n  %-26s%10s%10s%10s\n", "pictures of the base", "frames/s", "PSNR dB", "file MB");
    for (int i = 0; i < t->pictures; i++)
        study_add(out, "%c %-26s%10s%10s%10s\n", tradeoff_picture_on_front(t, i) ? '*' : ' ', t->picture[i].label,
                  STUDY_FIXED(t->picture[i].fps, 2), i ? STUDY_FIXED(t->picture[i].psnr, 2) : "-",
                  STUDY_FIXED(t->picture[i].bytes * 1e-6, 2));
    study_add(out, "\n");
    tradeoff_words(out, t, "");
    tradeoff_left_out(out, t, "not trained: ");
    study_add(out, "\n%sframes/s: of one thread. PSNR of pictures: to the exact ones.\n", TRADEOFF_NOTES);
}

/* ---------------------------------------------------------------- CSV */

static void tradeoff_csv_row(struct study_text *out, const struct tradeoff *t, int r, const char *which, const double *value)
{
    study_add(out, "train,%s,%s", t->row[r]->name, which);
    for (int m = 0; m < TRADEOFF_MEASURES; m++) study_add(out, ",%s", STUDY_FIXED(value[m], TRADEOFF_COLUMNS[m].csv_decimals));
    study_add(out, ",,%d\n", tradeoff_on_front(t, r));
}

void tradeoff_csv(struct study_text *out, const struct tradeoff *t)
{
    study_add(out, "kind,row,seed");
    for (int m = 0; m < TRADEOFF_MEASURES; m++) study_add(out, ",%s", TRADEOFF_COLUMNS[m].csv);
    study_add(out, ",frames_per_second,front\n");
    for (int r = 0; r < t->rows; r++) {
        double mean[TRADEOFF_MEASURES], spread[TRADEOFF_MEASURES];
        for (int s = 0; s < t->done[r]; s++) tradeoff_csv_row(out, t, r, STUDY_FIXED(s + 1, 0), t->value[r][s]);
        for (enum tradeoff_measure m = 0; m < TRADEOFF_MEASURES; m++) {
            mean[m]   = tradeoff_mean(t, r, m).mean;
            spread[m] = tradeoff_mean(t, r, m).spread;
        }
        if (t->done[r] > 0) tradeoff_csv_row(out, t, r, "mean", mean);
        if (t->done[r] > 1) tradeoff_csv_row(out, t, r, "sd", spread);
    }
    for (int i = 0; i < t->pictures; i++)
        study_add(out, "render,%s,1,%s,,,,,,%s,,%s,%d\n", t->picture[i].name, i ? STUDY_FIXED(t->picture[i].psnr, 4) : "",
                  STUDY_FIXED(t->picture[i].bytes, 0), STUDY_FIXED(t->picture[i].fps, 4), tradeoff_picture_on_front(t, i));
}

/* ---------------------------------------------------------------- the page */

void tradeoff_page(struct study_text *out, const struct tradeoff *t)
{
    char cell[80];
    study_add(out, "# Speed against accuracy\n\n");
    tradeoff_head(out, t);
    study_add(out, "\n![the rows and the front](tradeoff.svg)\n\n## Training\n\n| |");
    for (int m = 0; m < TRADEOFF_MEASURES; m++) study_add(out, " %s |", TRADEOFF_COLUMNS[m].title);
    study_add(out, "\n|---|");
    for (int m = 0; m < TRADEOFF_MEASURES; m++) study_add(out, "---:|");
    study_add(out, "\n");
    for (int r = 0; r < t->rows; r++) {
        if (t->done[r] == 0) continue;
        study_add(out, "| %s%s |", t->row[r]->name, tradeoff_on_front(t, r) ? " \\*" : "");
        for (enum tradeoff_measure m = 0; m < TRADEOFF_MEASURES; m++) {
            tradeoff_cell(cell, t, r, m);
            study_add(out, " %s |", cell);
        }
        study_add(out, "\n");
    }
    study_add(out, "\n## Pictures of the base's model\n\n| | frames a second, one thread | PSNR dB to the exact | file MB |\n"
                   "|---|---:|---:|---:|\n");
    for (int i = 0; i < t->pictures; i++)
        study_add(out, "| %s%s | %s | %s | %s |\n", t->picture[i].label, tradeoff_picture_on_front(t, i) ? " \\*" : "",
                  STUDY_FIXED(t->picture[i].fps, 2), i ? STUDY_FIXED(t->picture[i].psnr, 2) : "-",
                  STUDY_FIXED(t->picture[i].bytes * 1e-6, 2));
    study_add(out, "\n## In words, against the base\n\n");
    tradeoff_words(out, t, "- ");
    tradeoff_left_out(out, t, "- not trained: ");
    study_add(out, "\n%s", TRADEOFF_NOTES);
}
