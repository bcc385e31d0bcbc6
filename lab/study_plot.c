/* study_plot.c - a study as an SVG: PSNR over processor time and over bytes.
 *
 * All lengths are in the drawing's own units, px at its natural size. Cost axes are logarithmic. Points on the Pareto front are
 * filled.
 */
#include "study.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define PLOT_FRONT "#3589ab"
#define PLOT_OTHER "#9aa5ad"
#define PLOT_PALE  "#6b7680"
#define PLOT_SMALL "font-size:11px;fill:" PLOT_PALE

enum {
    PLOT_WIDTH  = 520, /* of a panel's axes */
    PLOT_HEIGHT = 340,
    PLOT_LEFT   = 70,
    PLOT_TOP    = 92,
    PLOT_STEP   = PLOT_WIDTH + 110,
    PLOT_FOOT   = 92,
    PLOT_NAME   = 13 /* height of a point's name */
};

struct plot_point {
    const char *name;
    double      x, y, spread;
    int         front;
};

struct plot {
    const char       *title, *x_title, *y_title;
    double            left, low[2], high[2]; /* px; of log10 x and of y */
    int               points;
    struct plot_point point[STUDY_ROWS];
};

/* ---------------------------------------------------------------- parts of an SVG; style: of CSS */

static void plot_line(struct output *t, double x0, double y0, double x1, double y1, const char *style)
{
    output_add(t, "<line x1=\"%.1f\" y1=\"%.1f\" x2=\"%.1f\" y2=\"%.1f\" style=\"%s\"/>\n", x0, y0, x1, y1, style);
}

static void plot_label(struct output *t, double x, double y, const char *style, const char *text)
{
    output_add(t, "<text x=\"%.1f\" y=\"%.1f\" style=\"%s\">%S</text>\n", x, y, style, text);
}

/* ---------------------------------------------------------------- axes */

static double plot_x(const struct plot *p, double x)
{
    return p->left + PLOT_WIDTH * (log10(x) - p->low[0]) / (p->high[0] - p->low[0]);
}

static double plot_y(const struct plot *p, double y)
{
    return PLOT_TOP + PLOT_HEIGHT * (1 - (y - p->low[1]) / (p->high[1] - p->low[1]));
}

static void plot_fit(struct plot *p)
{
    p->low[0] = p->low[1] = HUGE_VAL;
    p->high[0] = p->high[1] = -HUGE_VAL;
    for (int i = 0; i < p->points; i++) {
        const double s = p->point[i].spread > 0 ? p->point[i].spread : 0;
        p->low[0]      = fmin(p->low[0], log10(p->point[i].x));
        p->high[0]     = fmax(p->high[0], log10(p->point[i].x));
        p->low[1]      = fmin(p->low[1], p->point[i].y - s);
        p->high[1]     = fmax(p->high[1], p->point[i].y + s);
    }
    for (int k = 0; k < 2; k++) {
        const double room = fmax(0.08 * (p->high[k] - p->low[k]), k ? 0.1 : 0.05);
        p->low[k] -= room;
        p->high[k] += k ? room : 3.5 * room; /* names are to the right of their points */
    }
}

static void plot_axes(struct output *t, const struct plot *p)
{
    static const double factor[] = {1, 2, 5};
    const double        step = axis_step(p->high[1] - p->low[1]), bottom = PLOT_TOP + PLOT_HEIGHT, right = p->left + PLOT_WIDTH;
    const int           decimals = step >= 1 ? 0 : step >= 0.1 ? 1 : 2;
    plot_label(t, p->left, PLOT_TOP - 28, "font-weight:600", p->title);
    plot_label(t, p->left, PLOT_TOP - 10, PLOT_SMALL, p->y_title);
    for (double y = ceil(p->low[1] / step) * step; y <= p->high[1]; y += step) {
        plot_line(t, p->left, plot_y(p, y), right, plot_y(p, y), "stroke:#d9dee2");
        plot_label(t, p->left - 8, plot_y(p, y) + 4, PLOT_SMALL ";text-anchor:end", OUTPUT_FIXED(y, decimals));
    }
    for (int power = -3; power < 8; power++)
        for (int k = 0; k < 3; k++) {
            const double x = factor[k] * pow(10, power);
            if (log10(x) < p->low[0] || log10(x) > p->high[0]) continue;
            plot_line(t, plot_x(p, x), PLOT_TOP, plot_x(p, x), bottom, "stroke:#eceff1");
            plot_label(t, plot_x(p, x), bottom + 18, PLOT_SMALL ";text-anchor:middle", OUTPUT_FIXED(x, x < 1 ? 2 : 0));
        }
    plot_label(t, right, bottom + 36, PLOT_SMALL ";text-anchor:end", p->x_title);
}

/* ---------------------------------------------------------------- points */

static void plot_front(struct output *t, const struct plot *p)
{
    for (int before = -1, next;; before = next) {
        next = -1;
        for (int i = 0; i < p->points; i++)
            if (p->point[i].front && (before < 0 || p->point[i].x > p->point[before].x) &&
                (next < 0 || p->point[i].x < p->point[next].x))
                next = i;
        if (next < 0) return;
        if (before >= 0)
            plot_line(t, plot_x(p, p->point[before].x), plot_y(p, p->point[before].y), plot_x(p, p->point[next].x),
                      plot_y(p, p->point[next].y), "stroke:" PLOT_FRONT ";stroke-width:1.5;stroke-opacity:0.6");
    }
}

static int plot_higher(const void *a, const void *b)
{
    const struct plot_point *p = a, *q = b;
    return p->y != q->y ? (p->y > q->y ? -1 : 1) : strcmp(p->name, q->name);
}

/* Names beside their points, from the highest down; moved down where they would overlap. */
static void plot_points(struct output *t, struct plot *p)
{
    double name_y[STUDY_ROWS];
    qsort(p->point, (size_t)p->points, sizeof *p->point, plot_higher);
    for (int i = 0; i < p->points; i++) {
        const struct plot_point *q = &p->point[i];
        const double             x = plot_x(p, q->x), y = plot_y(p, q->y);
        name_y[i] = y + 4;
        for (int j = 0; j < i; j++)
            if (fabs(x - plot_x(p, p->point[j].x)) < 125 && name_y[i] < name_y[j] + PLOT_NAME) name_y[i] = name_y[j] + PLOT_NAME;
        if (q->spread > 0) plot_line(t, x, plot_y(p, q->y - q->spread), x, plot_y(p, q->y + q->spread), "stroke:#1d262c");
        if (fabs(name_y[i] - 4 - y) > 6) plot_line(t, x, y, x + 9, name_y[i] - 4, "stroke:#b9c2c8");
        output_add(t, "<circle cx=\"%.1f\" cy=\"%.1f\" r=\"4.5\" style=\"fill:%s;stroke:%s;stroke-width:1.5\"/>\n", x, y,
                   q->front ? PLOT_FRONT : "#ffffff", q->front ? PLOT_FRONT : PLOT_OTHER);
        plot_label(t, x + 10, name_y[i], q->front ? "font-size:11px;font-weight:600" : PLOT_SMALL, q->name);
    }
}

static void plot_draw(struct output *t, struct plot *p)
{
    if (p->points == 0) return;
    plot_fit(p);
    plot_axes(t, p);
    plot_front(t, p);
    plot_points(t, p);
}

/* ---------------------------------------------------------------- the two panels */

static struct plot plot_of_rows(const struct study *s, enum study_measure cost, double scale, const char *x_title, double left)
{
    struct plot p = {.title   = cost == STUDY_CPU ? "Time" : "Size",
                     .x_title = x_title,
                     .y_title = s->held_out ? "PSNR of held-out views, dB" : "PSNR of training views, dB",
                     .left    = left};
    for (int r = 0; r < s->rows; r++) {
        const struct study_figure psnr = study_mean(s, r, STUDY_PSNR);
        const double              x    = scale * study_mean(s, r, cost).mean;
        if (s->done[r] && x > 0)
            p.point[p.points++] = (struct plot_point){s->row[r]->name, x, psnr.mean, psnr.spread,
                                                      cost == STUDY_CPU && study_is_pareto_optimal(s, r)};
    }
    return p;
}

void study_plot(struct output *t, const struct study *s)
{
    const int   width = PLOT_LEFT + 2 * PLOT_STEP, height = PLOT_TOP + PLOT_HEIGHT + PLOT_FOOT;
    struct plot first  = plot_of_rows(s, STUDY_CPU, 1, "processor seconds (logarithmic)", PLOT_LEFT);
    struct plot second = plot_of_rows(s, STUDY_BYTES, 1e-6, "MB of the model (logarithmic)", PLOT_LEFT + PLOT_STEP);
    char        line[300];
    output_add(t,
               "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"%d\" height=\"%d\" viewBox=\"0 0 %d %d\" "
               "style=\"font-family:system-ui,sans-serif;font-size:13px;fill:#1d262c\">\n"
               "<rect width=\"%d\" height=\"%d\" style=\"fill:#ffffff\"/>\n",
               width, height, width, height, width, height);
    plot_label(t, 16, 30, "font-size:18px;font-weight:600", s->kind->title);
    plot_draw(t, &first);
    plot_draw(t, &second);
    snprintf(line, sizeof line,
             "Filled: on the front, no row is as good at no more cost.%s Preset %s, %d iterations, at most %d px a side.",
             s->options->seeds > 1 ? " Bars: standard deviation over the seeds." : "", s->base.preset ? s->base.preset : "-",
             s->base.train.iterations, s->base.scene.max_side);
    plot_label(t, 16, height - 34, PLOT_SMALL, line);
    plot_label(t, 16, height - 16, PLOT_SMALL, s->options->scene);
    output_add(t, "</svg>\n");
}
