/* chart.c - draws curves as SVG: a report's loss, PSNR and Gaussians over the iterations, a line for each block.
 *
 * Lengths are in the drawing's own units; at a width of 420 px a phone shows it unscaled.
 */
#include "report.h"

#include <math.h>
#include <string.h>

enum {
    CHART_WIDTH = 420,
    CHART_HEIGHT = 210,
    CHART_LEFT = 46,
    CHART_RIGHT = 406,
    CHART_TOP = 12,
    CHART_FOOT = 182,
    CHART_COLOURS = 6,  /* colours of lines, as the style has them */
    CHART_POINTS = 1000 /* most points of a line, about */
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

/* ---------------- axes and lines. First all points are included, then the lines drawn, point by point. */

struct chart {
    int points, lines, in_line;   /* included; drawn; 1: a line has begun */
    double last, low, high, step; /* end of x; ends of y; between two lines of y */
};

static void chart_include(struct chart *c, double x, double y)
{
    if (!isfinite(x) || !isfinite(y)) return;
    if (c->points++ == 0) c->low = c->high = y;
    c->low = fmin(c->low, y), c->high = fmax(c->high, y);
    c->last = fmax(c->last, x);
}

static double chart_x(const struct chart *c, double x)
{
    return CHART_LEFT + (CHART_RIGHT - CHART_LEFT) * x / c->last;
}

static double chart_y(const struct chart *c, double y)
{
    return CHART_FOOT - (CHART_FOOT - CHART_TOP) * (y - c->low) / (c->high - c->low);
}

/* Writes the attributes of an svg element, and the axes. */
static void chart_begin(struct chart *c, struct output *t, const char *title)
{
    c->step = axis_step(fmax(c->high - c->low, fmax(1e-3 * fabs(c->high), 1e-5)));
    c->low = c->step * floor(c->low / c->step), c->high = c->step * (floor(c->high / c->step) + 1);
    output_add(t, "viewBox=\"0 0 %d %d\" width=\"%d\" height=\"%d\" role=\"img\" aria-label=\"%s\">",
               CHART_WIDTH, CHART_HEIGHT, 2 * CHART_WIDTH, 2 * CHART_HEIGHT, title);
    for (double y = c->low; y < c->high + 0.5 * c->step; y += c->step)
        output_add(t,
                   "<path class=\"grid\" d=\"M%d %.1fH%d\"/><text x=\"%d\" y=\"%.1f\" "
                   "text-anchor=\"end\">%s</text>\n",
                   CHART_LEFT, chart_y(c, y), CHART_RIGHT, CHART_LEFT - 6, chart_y(c, y) + 4,
                   OUTPUT_FIXED(y, c->step >= 1 ? 0 : (int)ceil(-log10(c->step) - 1e-9)));
    output_add(t,
               "<text x=\"%d.0\" y=\"202\" text-anchor=\"start\">0</text>\n"
               "<text x=\"%d.0\" y=\"202\" text-anchor=\"end\">%s</text>\n",
               CHART_LEFT, CHART_RIGHT, OUTPUT_COUNT(c->last));
}

static void chart_line(struct chart *c, struct output *t, double x, double y)
{
    output_add(t, c->in_line ? "L" : "<path style=\"stroke:var(--s%d)\" d=\"M", c->lines % CHART_COLOURS);
    output_add(t, "%.1f %.1f", chart_x(c, x), chart_y(c, y));
    c->in_line = 1;
}

static void chart_end_line(struct chart *c, struct output *t, const char *name)
{
    if (c->in_line) output_add(t, "\"><title>%s</title></path>\n", name);
    c->in_line = 0, c->lines++;
}

/* ---------------- the report's section */

/* Includes the values of a column of log.csv, or draws them as a line. */
static void curve_of(struct chart *c, struct output *t, const char *log, const struct curve *of)
{
    const int place = curve_place(log, of->column);
    int rows = 0, i = 0;
    const char *at = log;
    double x, y;
    while (curve_next(&at, place, &x, &y)) rows++;
    for (at = log; curve_next(&at, place, &x, &y); i++)
        if (!t) chart_include(c, x, y / of->scale);
        else if (isfinite(x) && isfinite(y) && (i % (1 + rows / CHART_POINTS) == 0 || i + 1 == rows))
            chart_line(c, t, x, y / of->scale);
}

static void curve_draw(struct report *r, const struct curve *of)
{
    struct output *t = &r->page;
    struct chart c = {0};
    for (int k = 0; k < r->parts; k++)
        if (r->part[k].log) curve_of(&c, NULL, r->part[k].log, of);
    if (c.points == 0 || !(c.last > 0)) return;
    output_add(t, "<figure><figcaption>%s</figcaption>\n<svg class=\"chart%s\" ", of->title,
               r->parts > CHART_COLOURS ? " many" : "");
    chart_begin(&c, t, of->title);
    for (int k = 0; k < r->parts; k++) {
        if (r->part[k].log) curve_of(&c, t, r->part[k].log, of);
        chart_end_line(&c, t, r->part[k].name);
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
