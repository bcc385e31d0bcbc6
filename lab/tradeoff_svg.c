/* tradeoff_svg.c - a sweep as a drawing: PSNR over processor time for trainings, over frames a second for pictures, and the fronts.
 *
 * All lengths are in the drawing's own units, px at its natural size. Time runs by its logarithm. A point on the front is filled.
 */
#include "tradeoff.h"

#include <math.h>
#include <string.h>

#define PLOT_FRONT "#3589ab"
#define PLOT_OTHER "#9aa5ad"
#define PLOT_PALE  "#6b7680"

enum {
    PLOT_WIDTH  = 520, /* of a panel's axes */
    PLOT_HEIGHT = 340,
    PLOT_LEFT   = 70,
    PLOT_TOP    = 92,
    PLOT_STEP   = PLOT_WIDTH + 110,
    PLOT_FOOT   = 92,
    PLOT_LABEL  = 13, /* height of a label */
    PLOT_POINTS = 16
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
    struct plot_point point[PLOT_POINTS];
};

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
        p->high[k] += k ? room : 3.5 * room; /* names stand on the right of their points */
    }
}

static void plot_axes(struct study_text *t, const struct plot *p)
{
    static const double factor[] = {1, 2, 5};
    const double        step     = study_step(p->high[1] - p->low[1]);
    const int           decimals = step >= 1 ? 0 : step >= 0.1 ? 1 : 2;
    study_label(t, p->left, PLOT_TOP - 28, "font-weight:600", p->title);
    study_label(t, p->left, PLOT_TOP - 10, "font-size:11px;fill:" PLOT_PALE, p->y_title);
    for (double y = ceil(p->low[1] / step) * step; y <= p->high[1]; y += step) {
        study_line(t, p->left, plot_y(p, y), p->left + PLOT_WIDTH, plot_y(p, y), "stroke:#d9dee2");
        study_label(t, p->left - 8, plot_y(p, y) + 4, "font-size:11px;text-anchor:end;fill:" PLOT_PALE, STUDY_FIXED(y, decimals));
    }
    for (int power = -3; power < 8; power++)
        for (int k = 0; k < 3; k++) {
            const double x = factor[k] * pow(10, power);
            if (log10(x) < p->low[0] || log10(x) > p->high[0]) continue;
            study_line(t, plot_x(p, x), PLOT_TOP, plot_x(p, x), PLOT_TOP + PLOT_HEIGHT, "stroke:#eceff1");
            study_label(t, plot_x(p, x), PLOT_TOP + PLOT_HEIGHT + 18, "font-size:11px;text-anchor:middle;fill:" PLOT_PALE,
                        STUDY_FIXED(x, x < 1 ? 2 : 0));
        }
    study_label(t, p->left + PLOT_WIDTH, PLOT_TOP + PLOT_HEIGHT + 36, "font-size:11px;text-anchor:end;fill:" PLOT_PALE,
                p->x_title);
}

/* From point to point of the front, which rises or falls all along. */
static void plot_front(struct study_text *t, const struct plot *p)
{
    int before = -1;
    for (;;) {
        int next = -1;
        for (int i = 0; i < p->points; i++)
            if (p->point[i].front && (before < 0 || p->point[i].x > p->point[before].x) &&
                (next < 0 || p->point[i].x < p->point[next].x))
                next = i;
        if (next < 0) return;
        if (before >= 0)
            study_line(t, plot_x(p, p->point[before].x), plot_y(p, p->point[before].y), plot_x(p, p->point[next].x),
                       plot_y(p, p->point[next].y), "stroke:" PLOT_FRONT ";stroke-width:1.5;stroke-opacity:0.6");
        before = next;
    }
}

/* Where names stand: beside their points, pushed down by those above when they would meet. */
static void plot_place_names(const struct plot *p, double y[PLOT_POINTS])
{
    int order[PLOT_POINTS];
    for (int i = 0; i < p->points; i++) {
        int at = i;
        for (; at > 0 && p->point[order[at - 1]].y < p->point[i].y; at--) order[at] = order[at - 1];
        order[at] = i;
    }
    for (int n = 0; n < p->points; n++) {
        const int i = order[n];
        y[i]        = plot_y(p, p->point[i].y) + 4;
        for (int m = 0; m < n; m++) {
            const int    j   = order[m];
            const double gap = fabs(plot_x(p, p->point[i].x) - plot_x(p, p->point[j].x));
            if (gap < 115 && y[i] < y[j] + PLOT_LABEL) y[i] = y[j] + PLOT_LABEL;
        }
    }
}

static void plot_draw(struct study_text *t, struct plot *p)
{
    double name_y[PLOT_POINTS];
    plot_fit(p);
    plot_axes(t, p);
    plot_front(t, p);
    plot_place_names(p, name_y);
    for (int i = 0; i < p->points; i++) {
        const struct plot_point *q = &p->point[i];
        const double             x = plot_x(p, q->x), y = plot_y(p, q->y);
        if (q->spread > 0) study_line(t, x, plot_y(p, q->y - q->spread), x, plot_y(p, q->y + q->spread), "stroke:#1d262c");
        if (fabs(name_y[i] - 4 - y) > 6) study_line(t, x, y, x + 9, name_y[i] - 4, "stroke:#b9c2c8");
        study_add(t, "<circle cx=\"%s\" cy=\"%s\" r=\"4.5\" style=\"fill:%s;stroke:%s;stroke-width:1.5\"/>\n", STUDY_FIXED(x, 1),
                  STUDY_FIXED(y, 1), q->front ? PLOT_FRONT : "#ffffff", q->front ? PLOT_FRONT : PLOT_OTHER);
        study_label(t, x + 10, name_y[i], q->front ? "font-size:11px;font-weight:600" : "font-size:11px;fill:" PLOT_PALE,
                    q->name);
    }
}

static struct plot plot_of_rows(const struct tradeoff *a)
{
    struct plot p = {.title   = "Training",
                     .x_title = "processor seconds, by their logarithm",
                     .y_title = a->held_out ? "PSNR of views held out, dB" : "PSNR of training views, dB",
                     .left    = PLOT_LEFT};
    for (int r = 0; r < a->rows; r++) {
        const struct study_figure psnr = tradeoff_mean(a, r, TRADEOFF_PSNR);
        const double              cpu  = tradeoff_mean(a, r, TRADEOFF_CPU).mean;
        if (a->done[r] && cpu > 0)
            p.point[p.points++] = (struct plot_point){a->row[r]->name, cpu, psnr.mean, psnr.spread, tradeoff_on_front(a, r)};
    }
    return p;
}

/* The exact pictures have no PSNR to themselves; their speed is a line. */
static struct plot plot_of_pictures(const struct tradeoff *a)
{
    struct plot p = {.title   = "Pictures of the base's model",
                     .x_title = "frames a second of one thread, by their logarithm",
                     .y_title = "PSNR to the exact pictures, dB; dashed: their speed",
                     .left    = PLOT_LEFT + PLOT_STEP};
    for (int i = 1; i < a->pictures; i++)
        if (a->picture[i].fps > 0)
            p.point[p.points++] = (struct plot_point){a->picture[i].label, a->picture[i].fps, a->picture[i].psnr, 0,
                                                      tradeoff_picture_on_front(a, i)};
    return p;
}

static void plot_exact(struct study_text *t, const struct plot *p, double fps)
{
    const double x = log10(fps);
    if (x < p->low[0] || x > p->high[0]) return;
    study_line(t, plot_x(p, fps), PLOT_TOP, plot_x(p, fps), PLOT_TOP + PLOT_HEIGHT, "stroke:#37424a;stroke-dasharray:3 3");
}

void tradeoff_svg(struct study_text *out, const struct tradeoff *a)
{
    struct plot rows = plot_of_rows(a), pictures = plot_of_pictures(a);
    const int   width = PLOT_LEFT + 2 * PLOT_STEP, height = PLOT_TOP + PLOT_HEIGHT + PLOT_FOOT;
    char        line[300];
    study_drawing(out, width, height, "Speed against accuracy");
    if (rows.points > 0) plot_draw(out, &rows);
    if (pictures.points > 0) {
        plot_draw(out, &pictures);
        plot_exact(out, &pictures, a->picture[0].fps);
    }
    snprintf(line, sizeof line,
             "Filled: on the front, nothing is better at no more cost.%s Base: preset %s, %d iterations, at most %d px a side.",
             a->seeds > 1 ? " Whiskers: standard deviation over the seeds." : "", a->preset ? a->preset : "-", a->iterations,
             a->max_side);
    study_label(out, 16, height - 34, "font-size:11.5px;fill:" PLOT_PALE, line);
    study_label(out, 16, height - 16, "font-size:11.5px;fill:" PLOT_PALE, a->scene);
    study_add(out, "</svg>\n");
}
