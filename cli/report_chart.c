/* report_chart.c - draws curves over the iterations as inline SVG: loss, PSNR, Gaussians; a line for each
 * block.
 *
 * Lengths are in the drawing's own units; at a width of 420 px a phone shows it unscaled.
 */
#include "report.h"

#include <math.h>
#include <string.h>

enum {
    CURVE_WIDTH = 420,
    CURVE_HEIGHT = 210,
    CURVE_LEFT = 46,
    CURVE_RIGHT = 406,
    CURVE_TOP = 12,
    CURVE_FOOT = 182,
    CURVE_COLOURS = 6,  /* colours of lines, as the style has them */
    CURVE_POINTS = 1000 /* most points of a line, about */
};

static const struct curve {
    const char *title, *column; /* column: of log.csv */
    double scale;               /* divisor of the values that are shown */
} CURVES[] = {{"Loss, smoothed", "loss", 1},
              {"PSNR of training views, smoothed, dB", "psnr", 1},
              {"Gaussians, thousand", "gaussians", 1e3}};

/* Returns the place of a column in a line of names; -1: there is no such column. */
static int curve_place(const char *line, const char *name)
{
    for (int i = 0;; i++, line++) {
        const size_t length = strcspn(line, ",\r\n");
        if (strlen(name) == length && strncmp(line, name, length) == 0) return i;
        line += length;
        if (*line != ',') return -1;
    }
}

/* Reads iteration and value of the next line, and moves the cursor to it. Returns 0 at the end. */
static int curve_next(const char **at, int place, double *x, double *y)
{
    const char *line = strchr(*at, '\n');
    if (place < 0 || !line || !line[1]) return 0;
    *at = ++line;
    *x = oxl_json_number_at(&line);
    for (line = *at; place > 0 && *line && *line != '\n'; line++) place -= *line == ',';
    *y = place == 0 ? oxl_json_number_at(&line) : NAN;
    return 1;
}

struct curve_axes {
    double end, low, high, step; /* end: last iteration; of y */
};

/* Finds the axes of a chart. Returns 0 if it has no values to show. */
static int curve_axes(const struct report *r, const struct curve *c, struct curve_axes *a)
{
    double x, y;
    *a = (struct curve_axes){0, HUGE_VAL, -HUGE_VAL, 0};
    for (int k = 0; k < r->parts; k++) {
        const char *at = r->part[k].log;
        const int place = at ? curve_place(at, c->column) : -1;
        while (at && curve_next(&at, place, &x, &y)) {
            a->end = fmax(a->end, x); /* NaN counts for none of these */
            a->low = fmin(a->low, y / c->scale), a->high = fmax(a->high, y / c->scale);
        }
    }
    if (!(a->low <= a->high) || !(a->end > 0)) return 0;
    a->step = axis_step(fmax(a->high - a->low, fmax(1e-3 * fabs(a->high), 1e-5)));
    a->low = a->step * floor(a->low / a->step), a->high = a->step * (floor(a->high / a->step) + 1);
    return 1;
}

static double curve_y(const struct curve_axes *a, double value)
{
    return CURVE_FOOT - (CURVE_FOOT - CURVE_TOP) * (value - a->low) / (a->high - a->low);
}

static void curve_line(struct output *t, const char *log, int place, const struct curve *c,
                       const struct curve_axes *a)
{
    int rows = 0, every, i = 0;
    const char *at = log, *command = "M";
    double x, y;
    while (curve_next(&at, place, &x, &y)) rows++;
    every = 1 + rows / CURVE_POINTS;
    for (at = log; curve_next(&at, place, &x, &y); i++) {
        if (!isfinite(x) || !isfinite(y) || (i % every != 0 && i + 1 < rows)) continue;
        output_add(t, "%s%.1f %.1f", command, CURVE_LEFT + (CURVE_RIGHT - CURVE_LEFT) * x / a->end,
                   curve_y(a, y / c->scale));
        command = "L";
    }
}

static void curve_draw(struct report *r, const struct curve *c)
{
    struct output *t = &r->page;
    struct curve_axes a;
    if (!curve_axes(r, c, &a)) return;
    output_add(
        t,
        "<figure><figcaption>%s</figcaption>\n<svg class=\"chart%s\" viewBox=\"0 0 %d %d\" width=\"%d\" "
        "height=\"%d\" role=\"img\" aria-label=\"%s over the iterations\">",
        c->title, r->parts > CURVE_COLOURS ? " many" : "", CURVE_WIDTH, CURVE_HEIGHT, 2 * CURVE_WIDTH,
        2 * CURVE_HEIGHT, c->title);
    for (double y = a.low; y < a.high + 0.5 * a.step; y += a.step)
        output_add(t,
                   "<path class=\"grid\" d=\"M%d %.1fH%d\"/><text x=\"%d\" y=\"%.1f\" "
                   "text-anchor=\"end\">%s</text>\n",
                   CURVE_LEFT, curve_y(&a, y), CURVE_RIGHT, CURVE_LEFT - 6, curve_y(&a, y) + 4,
                   OUTPUT_FIXED(y, a.step >= 1 ? 0 : (int)ceil(-log10(a.step) - 1e-9)));
    output_add(t, "<text x=\"%d\" y=\"202\">0</text><text x=\"%d\" y=\"202\" text-anchor=\"end\">%s</text>\n",
               CURVE_LEFT, CURVE_RIGHT, OUTPUT_COUNT(a.end));
    for (int k = 0; k < r->parts; k++) {
        if (!r->part[k].log) continue;
        output_add(t, "<path style=\"stroke:var(--s%d)\" d=\"", k % CURVE_COLOURS);
        curve_line(t, r->part[k].log, curve_place(r->part[k].log, c->column), c, &a);
        output_add(t, "\"><title>%s</title></path>\n", r->part[k].name);
    }
    output_add(t, "</svg></figure>\n");
}

void chart_section(struct report *r)
{
    output_add(&r->page,
               "<section>\n<h2>Training curves</h2>\n<p class=\"pale\">Horizontal axis: iterations, one "
               "image each.</p>\n<div class=\"charts\">\n");
    for (size_t i = 0; i < sizeof CURVES / sizeof *CURVES; i++) curve_draw(r, &CURVES[i]);
    output_add(&r->page, "</div>\n</section>\n");
}
