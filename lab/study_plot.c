/* study_plot.c - a study as an SVG: PSNR over processor time and over bytes.
 *
 * All lengths are in the drawing's own units, px at its natural size. Cost axes are logarithmic. Points on
 * the Pareto front are filled.
 */
#include "study.h"
#include "../src/formats/svg.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static const char plot_style[] =
    "text{font:13px system-ui,sans-serif;fill:#1d262c}.title{font-size:18px}.title,.head,.named{font-weight:600}"
    ".named,.small{font-size:11px}.small{fill:#6b7680}.middle{text-anchor:middle}.end{text-anchor:end}"
    "line{stroke:#d9dee2}.fine{stroke:#eceff1}.path{stroke:#3589ab;stroke-width:1.5;stroke-opacity:.6}"
    ".spread{stroke:#1d262c}.link{stroke:#b9c2c8}circle{stroke-width:1.5;fill:#fff;stroke:#9aa5ad}"
    ".front{fill:#3589ab;stroke:#3589ab}";

enum {
    PLOT_WIDTH = 520, /* of a panel's axes */
    PLOT_HEIGHT = 340,
    PLOT_LEFT = 70,
    PLOT_TOP = 92,
    PLOT_STEP = PLOT_WIDTH + 110,
    PLOT_FOOT = 92,
    PLOT_NAME = 13 /* height of a point's name */
};

struct plot_point {
    const char *name;
    double x, y, spread;
    int front;
};

struct plot {
    const char *title, *x_title, *y_title;
    double left, low[2], high[2]; /* px; of log10 x and of y */
    int points;
    struct plot_point point[STUDY_ROWS];
};

/* ---------------- axes */

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
        p->low[0] = fmin(p->low[0], log10(p->point[i].x));
        p->high[0] = fmax(p->high[0], log10(p->point[i].x));
        p->low[1] = fmin(p->low[1], p->point[i].y - s);
        p->high[1] = fmax(p->high[1], p->point[i].y + s);
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
    const double step = axis_step(p->high[1] - p->low[1]), bottom = PLOT_TOP + PLOT_HEIGHT,
                 right = p->left + PLOT_WIDTH;
    const int decimals = step >= 1 ? 0 : step >= 0.1 ? 1 : 2;
    output_add(t, "%s%S</text>\n%s%S</text>\n", SVG_TEXT(p->left, PLOT_TOP - 28, "class='head'"), p->title,
               SVG_TEXT(p->left, PLOT_TOP - 10, "class='small'"), p->y_title);
    for (double y = ceil(p->low[1] / step) * step; y <= p->high[1]; y += step)
        output_add(t, "%s%s%.*f</text>\n", SVG_LINE(p->left, plot_y(p, y), right, plot_y(p, y), ""),
                   SVG_TEXT(p->left - 8, plot_y(p, y) + 4, "class='small end'"), decimals, y);
    for (int power = -3; power < 8; power++)
        for (int k = 0; k < 3; k++) {
            const double x = factor[k] * pow(10, power);
            if (log10(x) < p->low[0] || log10(x) > p->high[0]) continue;
            output_add(t, "%s%s%.*f</text>\n",
                       SVG_LINE(plot_x(p, x), PLOT_TOP, plot_x(p, x), bottom, "class='fine'"),
                       SVG_TEXT(plot_x(p, x), bottom + 18, "class='small middle'"), x < 1 ? 2 : 0, x);
        }
    output_add(t, "%s%S</text>\n", SVG_TEXT(right, bottom + 36, "class='small end'"), p->x_title);
}

/* ---------------- points */

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
            output_add(t, "%s",
                       SVG_LINE(plot_x(p, p->point[before].x), plot_y(p, p->point[before].y),
                                plot_x(p, p->point[next].x), plot_y(p, p->point[next].y), "class='path'"));
    }
}

static int plot_higher(const void *a, const void *b)
{
    const struct plot_point *p = a, *q = b;
    return p->y != q->y ? (p->y > q->y ? -1 : 1) : strcmp(p->name, q->name);
}

/* Writes names beside their points, from the highest down; moved down where they would overlap. */
static void plot_points(struct output *t, struct plot *p)
{
    double name_y[STUDY_ROWS];
    qsort(p->point, (size_t)p->points, sizeof *p->point, plot_higher);
    for (int i = 0; i < p->points; i++) {
        const struct plot_point *q = &p->point[i];
        const double x = plot_x(p, q->x), y = plot_y(p, q->y);
        name_y[i] = y + 4;
        for (int j = 0; j < i; j++)
            if (fabs(x - plot_x(p, p->point[j].x)) < 125 && name_y[i] < name_y[j] + PLOT_NAME)
                name_y[i] = name_y[j] + PLOT_NAME;
        if (q->spread > 0)
            output_add(
                t, "%s",
                SVG_LINE(x, plot_y(p, q->y - q->spread), x, plot_y(p, q->y + q->spread), "class='spread'"));
        if (fabs(name_y[i] - 4 - y) > 6)
            output_add(t, "%s", SVG_LINE(x, y, x + 9, name_y[i] - 4, "class='link'"));
        output_add(t, "%s</circle>\n%s%S</text>\n", SVG_CIRCLE(x, y, 4.5, q->front ? "class='front'" : ""),
                   SVG_TEXT(x + 10, name_y[i], q->front ? "class='named'" : "class='small'"), q->name);
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

/* ---------------- the two panels */

static struct plot plot_of_rows(const struct study *s, enum study_measure cost, double scale,
                                const char *x_title, double left)
{
    struct plot p = {.title = cost == STUDY_CPU ? "Time" : "Size",
                     .x_title = x_title,
                     .y_title = s->held_out ? "PSNR of held-out views, dB" : "PSNR of training views, dB",
                     .left = left};
    for (int r = 0; r < s->rows; r++) {
        const struct study_figure psnr = study_mean(s, r, STUDY_PSNR);
        const double x = scale * study_mean(s, r, cost).mean;
        if (s->done[r] && x > 0)
            p.point[p.points++] = (struct plot_point){s->row[r]->name, x, psnr.mean, psnr.spread,
                                                      cost == STUDY_CPU && study_is_pareto_optimal(s, r)};
    }
    return p;
}

void study_plot(struct output *t, const struct study *s)
{
    const int width = PLOT_LEFT + 2 * PLOT_STEP, height = PLOT_TOP + PLOT_HEIGHT + PLOT_FOOT;
    struct plot first = plot_of_rows(s, STUDY_CPU, 1, "processor seconds (logarithmic)", PLOT_LEFT);
    struct plot second =
        plot_of_rows(s, STUDY_BYTES, 1e-6, "MB of the model (logarithmic)", PLOT_LEFT + PLOT_STEP);
    char line[300];
    output_add(t, "%s<style>%s</style>\n%s", SVG_OPEN(width, height, ""), plot_style,
               SVG_RECTANGLE(0, 0, width, height, "fill='#fff'"));
    output_add(t, "%s%S</text>\n", SVG_TEXT(16, 30, "class='title'"), s->kind->title);
    plot_draw(t, &first);
    plot_draw(t, &second);
    snprintf(
        line, sizeof line,
        "Filled: on the front, no row is as good at no more cost.%s Preset %s, %d iterations, at most %d px a side.",
        s->options->seeds > 1 ? " Bars: standard deviation over the seeds." : "",
        s->base.preset ? s->base.preset : "-", s->base.train.iterations, s->base.scene.max_side);
    output_add(t, "%s%S</text>\n%s%S</text>\n", SVG_TEXT(16, height - 34, "class='small'"), line,
               SVG_TEXT(16, height - 16, "class='small'"), s->options->scene);
    output_add(t, "</svg>\n");
}
