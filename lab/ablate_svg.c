/* ablate_svg.c - an ablation as a drawing: three panels (quality, size, time), a pair of bars for each row: ours, the paper's.
 *
 * All lengths are in the drawing's own units, px at its natural size. Every row is compared with the first, as the paper's is
 * with the paper's first: absolute figures of other scenes on other machines do not compare.
 */
#include "ablate.h"

#include <math.h>

#define CHART_OURS  "#3589ab"
#define CHART_PAPER "#e09f3e" /* differs from ours in brightness too */
#define CHART_PALE  "#6b7680"

enum {
    CHART_LEFT   = 190, /* of the first panel */
    CHART_PANEL  = 190, /* the bars' room */
    CHART_FIGURE = 62,  /* the digits behind them */
    CHART_GAP    = 16,
    CHART_TOP    = 112, /* of the first row */
    CHART_ROW    = 46,
    CHART_BAR    = 13,
    CHART_FOOT   = 78,
    CHART_STEP   = CHART_PANEL + CHART_FIGURE + CHART_GAP,
    CHART_WIDTH  = CHART_LEFT + 3 * CHART_STEP
};

static const struct chart_panel {
    enum ablate_measure measure;
    const char         *title;
    double              neutral; /* what no change is */
} CHART_PANELS[3] = {{ABLATE_PSNR, "PSNR, difference in dB", 0},
                     {ABLATE_BYTES, "size of scene.ply, ratio", 1},
                     {ABLATE_SECONDS, "training time, ratio", 1}};

struct chart_axis {
    double low, high, step; /* of the measure: multiples of step */
    double left;            /* px, of low */
};

static double chart_x(const struct chart_axis *axis, double value)
{
    return axis->left + CHART_PANEL * (value - axis->low) / (axis->high - axis->low);
}

static void chart_widen(struct chart_axis *axis, double value)
{
    if (value < axis->low) axis->low = value;
    if (value > axis->high) axis->high = value;
}

/* From 0, for bars are read by their length, to the last whisker. */
static struct chart_axis chart_axis_of(const struct ablation *a, int panel)
{
    const enum ablate_measure m    = CHART_PANELS[panel].measure;
    struct chart_axis         axis = {.left = CHART_LEFT + panel * CHART_STEP, .high = CHART_PANELS[panel].neutral};
    for (int r = 0; r < a->rows; r++) {
        const struct study_figure ours   = ablate_against(a, r, 0, m);
        const double              spread = ours.spread > 0 ? ours.spread : 0;
        chart_widen(&axis, ours.mean - spread);
        chart_widen(&axis, ours.mean + spread);
        chart_widen(&axis, ablate_paper_against(a, r, 0, m));
    }
    if (CHART_PANELS[panel].neutral > 0) axis.low = 0; /* no ratio is below, though a whisker may reach there */
    if (axis.high - axis.low < 0.1) axis.high = axis.low + 0.1;
    axis.step = study_step(axis.high - axis.low);
    axis.low  = floor(axis.low / axis.step + 1e-9) * axis.step;
    axis.high = ceil(axis.high / axis.step - 1e-9) * axis.step;
    return axis;
}

/* ---------------------------------------------------------------- parts */

static void chart_grid(struct study_text *t, const struct ablation *a, const struct chart_axis *axis, int panel)
{
    const double bottom   = CHART_TOP + a->rows * CHART_ROW;
    const int    decimals = axis->step >= 1 ? 0 : axis->step >= 0.1 ? 1 : 2;
    study_label(t, axis->left, CHART_TOP - 32, "font-weight:600", CHART_PANELS[panel].title);
    for (int i = 0; i <= (int)((axis->high - axis->low) / axis->step + 0.5); i++) {
        const double value = axis->low + i * axis->step, x = chart_x(axis, value);
        study_line(t, x, CHART_TOP - 6, x, bottom, "stroke:#d9dee2");
        study_label(t, x, CHART_TOP - 12, "font-size:11px;text-anchor:middle;fill:" CHART_PALE, STUDY_FIXED(value, decimals));
    }
    study_line(t, chart_x(axis, CHART_PANELS[panel].neutral), CHART_TOP - 6, chart_x(axis, CHART_PANELS[panel].neutral), bottom,
               "stroke:#37424a;stroke-dasharray:3 3");
}

/* A bar from 0, its whisker, its figure behind the panel. */
static void chart_bar(struct study_text *t, const struct chart_axis *axis, double y, struct study_figure f, enum ablate_measure m,
                      const char *fill)
{
    const double x = chart_x(axis, f.mean), zero = chart_x(axis, 0), middle = y + CHART_BAR / 2.;
    if (isnan(f.mean)) return;
    study_box(t, x < zero ? x : zero, y, fabs(x - zero), CHART_BAR, fill);
    if (f.spread > 0) {
        const double low = f.mean - f.spread < axis->low ? axis->low : f.mean - f.spread;
        study_line(t, chart_x(axis, low), middle, chart_x(axis, f.mean + f.spread), middle, "stroke:#1d262c;stroke-width:1.5");
    }
    study_label(t, axis->left + CHART_PANEL + CHART_FIGURE - 6, middle + 4, "font-size:11.5px;text-anchor:end",
                ABLATE_RELATIVE(m, f.mean));
}

static void chart_row_title(struct study_text *t, const struct ablation *a, int r, double y)
{
    char text[120];
    snprintf(text, sizeof text, "%s dB, %s MB, %s s", STUDY_FIXED(ablate_mean(a, r, ABLATE_PSNR).mean, 2),
             STUDY_FIXED(1e-6 * ablate_mean(a, r, ABLATE_BYTES).mean, 2), STUDY_FIXED(ablate_mean(a, r, ABLATE_SECONDS).mean, 0));
    study_label(t, 16, y + 19, "font-weight:600", a->row[r]->label);
    study_label(t, 16, y + 35, "font-size:11px;fill:" CHART_PALE, text);
}

static void chart_row(struct study_text *t, const struct ablation *a, const struct chart_axis axis[3], int r)
{
    const double y = CHART_TOP + r * CHART_ROW;
    chart_row_title(t, a, r, y);
    for (int p = 0; p < 3; p++) {
        const enum ablate_measure m = CHART_PANELS[p].measure;
        chart_bar(t, &axis[p], y + 9, ablate_against(a, r, 0, m), m, CHART_OURS);
        chart_bar(t, &axis[p], y + 10 + CHART_BAR, (struct study_figure){ablate_paper_against(a, r, 0, m), NAN}, m, CHART_PAPER);
    }
}

static void chart_head(struct study_text *t, const struct ablation *a, int height)
{
    study_drawing(t, CHART_WIDTH, height, "Ablation: every row against the first");
    study_box(t, 16, 48, 12, 12, CHART_OURS);
    study_label(t, 34, 59, "", a->seeds > 1 ? "here; whisker: standard deviation over the seeds" : "here");
    study_box(t, a->seeds > 1 ? 400 : 90, 48, 12, 12, CHART_PAPER);
    study_label(t, a->seeds > 1 ? 418 : 108, 59, "", "the paper, on its Abyssal dataset");
}

static void chart_foot(struct study_text *t, const struct ablation *a, double y)
{
    char text[200];
    study_label(t, 16, y + 26, "font-size:11.5px;fill:" CHART_PALE, a->scene);
    snprintf(text, sizeof text, "%d iterations and SH degree %d in every row; mean of %d seed%s; PSNR of %s views.",
             a->iterations, a->sh_degree, a->seeds, a->seeds > 1 ? "s" : "", a->held_out ? "held-out" : "the training");
    study_label(t, 16, y + 44, "font-size:11.5px;fill:" CHART_PALE, text);
    study_label(
        t, 16, y + 62, "font-size:11.5px;fill:" CHART_PALE,
        "Dashed: no change. The paper's rows are compared with the paper's first. Under a name: PSNR, size and training time here.");
}

void ablate_svg(struct study_text *t, const struct ablation *a)
{
    struct chart_axis axis[3];
    chart_head(t, a, CHART_TOP + a->rows * CHART_ROW + CHART_FOOT);
    for (int r = 0; r < a->rows; r += 2) study_box(t, 8, CHART_TOP + r * CHART_ROW, CHART_WIDTH - 16, CHART_ROW, "#f3f6f8");
    for (int p = 0; p < 3; p++) {
        axis[p] = chart_axis_of(a, p);
        chart_grid(t, a, &axis[p], p);
    }
    for (int r = 0; r < a->rows; r++) chart_row(t, a, axis, r);
    chart_foot(t, a, CHART_TOP + a->rows * CHART_ROW);
    study_add(t, "</svg>\n");
}
