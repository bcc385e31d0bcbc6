/* report_chart.c - draws curves over the iterations as inline SVG: loss, PSNR, Gaussians, depth weights,
 * memory; a line for each block.
 *
 * Lengths are in the drawing's own units; at a width of 420 px a phone shows it unscaled.
 *
 * Invariant: an axis begins and ends on a multiple of its step, and every value lies within.
 */
#include "report_state.h"
#include "../src/formats/svg.h"

#include <math.h>

enum {
    CURVE_WIDTH = 420,
    CURVE_HEIGHT = 210,
    CURVE_LEFT = 46,
    CURVE_RIGHT = 14,
    CURVE_TOP = 12,
    CURVE_FOOT = 28,
    /* most blocks with a colour each, as the style has them; with more, all lines are alike */
    CURVE_NAMED = 6,
    CURVE_POINTS = 4000 /* most points of a chart, about, over all blocks */
};

static const struct curve {
    const char *title, *unit;  /* unit: with the comma before it */
    enum log_column column[2]; /* the second is drawn dashed, if it is another column */
    double scale;              /* divisor of the values that are shown */
    int from_zero;
} CURVES[] = {
    {"Loss, smoothed", "", {LOG_LOSS, LOG_LOSS}, 1, 1},
    {"PSNR of training views, smoothed", ", dB", {LOG_PSNR, LOG_PSNR}, 1, 0},
    {"Gaussians", ", thousand", {LOG_GAUSSIANS, LOG_GAUSSIANS}, 1e3, 1},
    {"Depth weights f_mid and f_far (dashed)", "", {LOG_F_MID, LOG_F_FAR}, 1, 0},
    {"Peak memory of the process", ", MB", {LOG_MEMORY, LOG_MEMORY}, 1e6, 1},
};

struct curve_axis {
    double low, high, step;
};

static struct curve_axis curve_axis_round(double low, double high)
{
    struct curve_axis a;
    if (!(high - low > 1e-6 * fabs(high)) || !(high - low > 1e-5))
        high = low + (fabs(low) > 1 ? fabs(low) : 1);
    a.step = axis_step(high - low);
    a.low = floor(low / a.step + 1e-9) * a.step;
    a.high = ceil(high / a.step - 1e-9) * a.step;
    return a;
}

/* Sets the axes of a chart. Returns 0 if it has no values to show. */
static int curve_axes(const struct report *r, const struct curve *c, struct curve_axis *x,
                      struct curve_axis *y)
{
    double low = INFINITY, high = -INFINITY, last = 0;
    for (int k = 0; k < r->parts; k++)
        for (int i = 0; i < r->block[k].rows; i++) {
            const double *row = r->block[k].log + (size_t)i * LOG_COLUMNS;
            if (row[LOG_ITERATION] > last) last = row[LOG_ITERATION];
            for (int j = 0; j < 2; j++) {
                const double value = row[c->column[j]] / c->scale;
                if (value < low) low = value;
                if (value > high) high = value;
            }
        }
    /* Shows no curve of depth weights that stayed at 1. */
    if (!(low <= high) || (c->column[0] == LOG_F_MID && high <= 1)) return 0;
    *x = curve_axis_round(0, last);
    *y = curve_axis_round(c->from_zero && low > 0 ? 0 : low, high);
    return 1;
}

static double curve_x(const struct curve_axis *a, double value)
{
    return CURVE_LEFT + (CURVE_WIDTH - CURVE_LEFT - CURVE_RIGHT) * (value - a->low) / (a->high - a->low);
}

static double curve_y(const struct curve_axis *a, double value)
{
    return CURVE_HEIGHT - CURVE_FOOT -
           (CURVE_HEIGHT - CURVE_TOP - CURVE_FOOT) * (value - a->low) / (a->high - a->low);
}

static void curve_grid(struct output *t, const struct curve_axis *x, const struct curve_axis *y)
{
    const int decimals = y->step >= 1 ? 0 : (int)ceil(-log10(y->step) - 1e-9);
    for (int i = 0; y->low + i * y->step <= y->high * (1 + 1e-9) + 1e-12; i++) {
        const double value = y->low + i * y->step;
        const double at = curve_y(y, value);
        output_add(t, "%s%s%.*f</text>",
                   SVG_LINE(CURVE_LEFT, at, CURVE_WIDTH - CURVE_RIGHT, at, "class='grid'"),
                   SVG_TEXT(CURVE_LEFT - 6, at + 4, "text-anchor='end'"), decimals, value);
    }
    for (int i = 0; x->low + i * x->step <= x->high * (1 + 1e-9); i++)
        output_add(t, "%s%s</text>",
                   SVG_TEXT(curve_x(x, x->low + i * x->step), CURVE_HEIGHT - 8, "text-anchor='middle'"),
                   OUTPUT_COUNT(x->low + i * x->step));
}

/* Draws the curve of a block; leaves out rows, but not the last, so that the chart has about CURVE_POINTS. */
static void curve_line(struct output *t, const struct report *r, int block, const struct curve *c, int second,
                       const struct curve_axis *x, const struct curve_axis *y)
{
    const struct report_block *b = &r->block[block];
    const int every = 1 + b->rows * r->parts / CURVE_POINTS, colour = r->parts <= CURVE_NAMED ? block : 0;
    const char *command = "M";
    output_add(t, "<path style=\"stroke:var(--s%d)\"%s d=\"", colour,
               second ? " stroke-dasharray=\"5 4\"" : "");
    for (int i = 0; i < b->rows; i++) {
        const double *row = b->log + (size_t)i * LOG_COLUMNS, value = row[c->column[second]] / c->scale;
        if (!isfinite(value) || (i % every != 0 && i + 1 < b->rows)) continue;
        output_add(t, "%s%.1f %.1f", command, curve_x(x, row[LOG_ITERATION]), curve_y(y, value));
        command = "L";
    }
    output_add(t, "\"/>\n");
}

static void curve_draw(struct output *t, const struct report *r, const struct curve *c)
{
    struct curve_axis x, y;
    if (!curve_axes(r, c, &x, &y)) return;
    output_add(
        t,
        "<figure><figcaption>%s%s</figcaption>\n<svg class=\"chart%s\" viewBox=\"0 0 %d %d\" width=\"%d\" height=\"%d\" role=\"img\" "
        "aria-label=\"%s over the iterations\">",
        c->title, c->unit, r->parts > CURVE_NAMED ? " many" : "", CURVE_WIDTH, CURVE_HEIGHT, 2 * CURVE_WIDTH,
        2 * CURVE_HEIGHT, c->title);
    curve_grid(t, &x, &y);
    for (int k = 0; k < r->parts; k++)
        for (int j = 0; j < (c->column[0] == c->column[1] ? 1 : 2); j++) curve_line(t, r, k, c, j, &x, &y);
    output_add(t, "</svg></figure>\n");
}

void chart_section(struct report *r)
{
    struct output *t = &r->page;
    int rows = 0;
    for (int k = 0; k < r->parts; k++) rows += r->block[k].rows;
    page_section(r, "Training curves");
    if (rows == 0) output_add(t, "<p>There is no log.csv yet.</p>\n");
    else
        output_add(
            t,
            "<p class=\"pale\">Horizontal axis: iterations, one image each.</p>\n<div class=\"charts\">\n");
    for (size_t i = 0; rows > 0 && i < sizeof CURVES / sizeof *CURVES; i++) curve_draw(t, r, &CURVES[i]);
    if (rows > 0) output_add(t, "</div>\n");
    if (rows > 0 && r->parts > 1 && r->parts <= CURVE_NAMED) {
        output_add(t, "<p><small>");
        for (int k = 0; k < r->parts; k++)
            output_add(t, "<b style=\"color:var(--s%d)\">&#9644; %s</b> &nbsp; ", k, REPORT_PART(r, k));
        output_add(t, "</small></p>\n");
    } else if (rows > 0 && r->parts > CURVE_NAMED)
        output_add(t, "<p><small>One line per block, %d blocks.</small></p>\n", r->blocks);
}
