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

/* 1, 2 or 5 times a power of ten: at most 5 steps in the span. */
static double chart_step(double span)
{
    static const double factor[] = {1, 2, 5};
    for (double power = 1e-6; power < 1e9; power *= 10)
        for (int i = 0; i < 3; i++)
            if (factor[i] * power * 5 >= span) return factor[i] * power;
    return span;
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
        const struct ablate_figure ours   = ablate_against(a, r, 0, m);
        const double               spread = ours.spread > 0 ? ours.spread : 0;
        chart_widen(&axis, ours.mean - spread);
        chart_widen(&axis, ours.mean + spread);
        chart_widen(&axis, ablate_paper_against(a, r, 0, m));
    }
    if (CHART_PANELS[panel].neutral > 0) axis.low = 0; /* no ratio is below, though a whisker may reach there */
    if (axis.high - axis.low < 0.1) axis.high = axis.low + 0.1;
    axis.step = chart_step(axis.high - axis.low);
    axis.low  = floor(axis.low / axis.step + 1e-9) * axis.step;
    axis.high = ceil(axis.high / axis.step - 1e-9) * axis.step;
    return axis;
}

/* ---------------------------------------------------------------- parts */

static void chart_escape(struct ablate_text *t, const char *text)
{
    for (; *text; text++) {
        if (*text == '<') ablate_add(t, "&lt;");
        else if (*text == '>') ablate_add(t, "&gt;");
        else if (*text == '&') ablate_add(t, "&amp;");
        else if ((unsigned char)*text >= ' ') ablate_add(t, "%c", *text);
    }
}

static void chart_line(struct ablate_text *t, double x0, double y0, double x1, double y1, const char *style)
{
    ablate_add(t, "<line x1=\"%s\" y1=\"%s\" x2=\"%s\" y2=\"%s\" style=\"%s\"/>\n", ABLATE_FIXED(x0, 1), ABLATE_FIXED(y0, 1),
               ABLATE_FIXED(x1, 1), ABLATE_FIXED(y1, 1), style);
}

static void chart_box(struct ablate_text *t, double x, double y, double width, double height, const char *fill)
{
    ablate_add(t, "<rect x=\"%s\" y=\"%s\" width=\"%s\" height=\"%s\" style=\"fill:%s\"/>\n", ABLATE_FIXED(x, 1),
               ABLATE_FIXED(y, 1), ABLATE_FIXED(width, 1), ABLATE_FIXED(height, 1), fill);
}

/* style: of the text; "" is the drawing's own. */
static void chart_text(struct ablate_text *t, double x, double y, const char *style, const char *text)
{
    ablate_add(t, "<text x=\"%s\" y=\"%s\" style=\"%s\">", ABLATE_FIXED(x, 1), ABLATE_FIXED(y, 1), style);
    chart_escape(t, text);
    ablate_add(t, "</text>\n");
}

static void chart_grid(struct ablate_text *t, const struct ablation *a, const struct chart_axis *axis, int panel)
{
    const double bottom   = CHART_TOP + a->rows * CHART_ROW;
    const int    decimals = axis->step >= 1 ? 0 : axis->step >= 0.1 ? 1 : 2;
    chart_text(t, axis->left, CHART_TOP - 32, "font-weight:600", CHART_PANELS[panel].title);
    for (int i = 0; i <= (int)((axis->high - axis->low) / axis->step + 0.5); i++) {
        const double value = axis->low + i * axis->step, x = chart_x(axis, value);
        chart_line(t, x, CHART_TOP - 6, x, bottom, "stroke:#d9dee2");
        chart_text(t, x, CHART_TOP - 12, "font-size:11px;text-anchor:middle;fill:" CHART_PALE, ABLATE_FIXED(value, decimals));
    }
    chart_line(t, chart_x(axis, CHART_PANELS[panel].neutral), CHART_TOP - 6, chart_x(axis, CHART_PANELS[panel].neutral), bottom,
               "stroke:#37424a;stroke-dasharray:3 3");
}

/* A bar from 0, its whisker, its figure behind the panel. */
static void chart_bar(struct ablate_text *t, const struct chart_axis *axis, double y, struct ablate_figure f,
                      enum ablate_measure m, const char *fill)
{
    const double x = chart_x(axis, f.mean), zero = chart_x(axis, 0), middle = y + CHART_BAR / 2.;
    if (isnan(f.mean)) return;
    chart_box(t, x < zero ? x : zero, y, fabs(x - zero), CHART_BAR, fill);
    if (f.spread > 0) {
        const double low = f.mean - f.spread < axis->low ? axis->low : f.mean - f.spread;
        chart_line(t, chart_x(axis, low), middle, chart_x(axis, f.mean + f.spread), middle, "stroke:#1d262c;stroke-width:1.5");
    }
    chart_text(t, axis->left + CHART_PANEL + CHART_FIGURE - 6, middle + 4, "font-size:11.5px;text-anchor:end",
               ABLATE_RELATIVE(m, f.mean));
}

static void chart_row_title(struct ablate_text *t, const struct ablation *a, int r, double y)
{
    char text[120];
    snprintf(text, sizeof text, "%s dB, %s MB, %s s", ABLATE_FIXED(ablate_mean(a, r, ABLATE_PSNR).mean, 2),
             ABLATE_FIXED(1e-6 * ablate_mean(a, r, ABLATE_BYTES).mean, 2),
             ABLATE_FIXED(ablate_mean(a, r, ABLATE_SECONDS).mean, 0));
    chart_text(t, 16, y + 19, "font-weight:600", a->row[r]->label);
    chart_text(t, 16, y + 35, "font-size:11px;fill:" CHART_PALE, text);
}

static void chart_row(struct ablate_text *t, const struct ablation *a, const struct chart_axis axis[3], int r)
{
    const double y = CHART_TOP + r * CHART_ROW;
    chart_row_title(t, a, r, y);
    for (int p = 0; p < 3; p++) {
        const enum ablate_measure m = CHART_PANELS[p].measure;
        chart_bar(t, &axis[p], y + 9, ablate_against(a, r, 0, m), m, CHART_OURS);
        chart_bar(t, &axis[p], y + 10 + CHART_BAR, (struct ablate_figure){ablate_paper_against(a, r, 0, m), NAN}, m, CHART_PAPER);
    }
}

static void chart_head(struct ablate_text *t, const struct ablation *a, int height)
{
    ablate_add(t,
               "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"%d\" height=\"%d\" viewBox=\"0 0 %d %d\" "
               "style=\"font-family:system-ui,sans-serif;font-size:13px;fill:#1d262c\">\n",
               CHART_WIDTH, height, CHART_WIDTH, height);
    chart_box(t, 0, 0, CHART_WIDTH, height, "#ffffff");
    chart_text(t, 16, 30, "font-size:18px;font-weight:600", "Ablation: every row against the first");
    chart_box(t, 16, 48, 12, 12, CHART_OURS);
    chart_text(t, 34, 59, "", a->seeds > 1 ? "here; whisker: standard deviation over the seeds" : "here");
    chart_box(t, a->seeds > 1 ? 400 : 90, 48, 12, 12, CHART_PAPER);
    chart_text(t, a->seeds > 1 ? 418 : 108, 59, "", "the paper, on its Abyssal dataset");
}

static void chart_foot(struct ablate_text *t, const struct ablation *a, double y)
{
    char text[200];
    chart_text(t, 16, y + 26, "font-size:11.5px;fill:" CHART_PALE, a->scene);
    snprintf(text, sizeof text, "%d iterations and SH degree %d in every row; mean of %d seed%s; PSNR of %s views.",
             a->iterations, a->sh_degree, a->seeds, a->seeds > 1 ? "s" : "", a->held_out ? "held-out" : "the training");
    chart_text(t, 16, y + 44, "font-size:11.5px;fill:" CHART_PALE, text);
    chart_text(
        t, 16, y + 62, "font-size:11.5px;fill:" CHART_PALE,
        "Dashed: no change. The paper's rows are compared with the paper's first. Under a name: PSNR, size and training time here.");
}

void ablate_svg(struct ablate_text *t, const struct ablation *a)
{
    struct chart_axis axis[3];
    chart_head(t, a, CHART_TOP + a->rows * CHART_ROW + CHART_FOOT);
    for (int r = 0; r < a->rows; r += 2) chart_box(t, 8, CHART_TOP + r * CHART_ROW, CHART_WIDTH - 16, CHART_ROW, "#f3f6f8");
    for (int p = 0; p < 3; p++) {
        axis[p] = chart_axis_of(a, p);
        chart_grid(t, a, &axis[p], p);
    }
    for (int r = 0; r < a->rows; r++) chart_row(t, a, axis, r);
    chart_foot(t, a, CHART_TOP + a->rows * CHART_ROW);
    ablate_add(t, "</svg>\n");
}
