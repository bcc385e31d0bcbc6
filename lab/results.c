/* results.c - the published tables and plot by one command: every study on every survey, on one build.
 *
 * Each survey is trained in a folder of its own for each study, OUT/SURVEY-STUDY, so that the command resumes.
 * The time is divided evenly among what is left. results.md and speed.svg name the commit that wrote them.
 */
#include "study.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#ifndef LAB_COMMIT
#define LAB_COMMIT "(not known)"
#endif

/* ---------------- the plot: PSNR against CPU seconds, one curve per survey */

enum { PLOT_POINTS = 400 /* most points */ };

struct plot {
    int count, curves;
    struct chart chart;
    struct plot_point {
        int curve;
        double seconds, psnr;
        char name[40];
    } point[PLOT_POINTS];
};

static void plot_add(struct plot *p, const char *name, double seconds, double psnr)
{
    struct plot_point *to = &p->point[p->count];
    if (p->count == PLOT_POINTS || !(seconds > 0) || isnan(psnr)) return;
    *to = (struct plot_point){p->curves, seconds, psnr, ""};
    snprintf(to->name, sizeof to->name, "%s", name);
    p->count++;
    chart_include(&p->chart, seconds, psnr);
}

/* Adds the rows of a study that differ in iterations alone. */
static void plot_add_study(struct plot *p, const struct study *s, const char *name)
{
    for (int r = 0; r < s->rows; r++)
        if (s->row[r]->iterations > 0)
            plot_add(p, name, study_mean(s, r, STUDY_CPU).mean, study_mean(s, r, STUDY_PSNR).mean);
    p->curves++;
}

/* Adds points of other programs from lines of NAME,CPU_SECONDS,PSNR, each a curve of its own. */
static void plot_add_others(struct plot *p, const char *folder)
{
    char *text = output_read(folder, "others.csv", NULL), name[40];
    double seconds, psnr;
    for (const char *at = text; at && *at; at += strcspn(at, "\n"), at += *at == '\n') {
        if (sscanf(at, "%39[^,#],%lf,%lf", name, &seconds, &psnr) != 3) continue;
        plot_add(p, name, seconds, psnr);
        p->curves++;
    }
    free(text);
}

static int plot_compare(const void *a, const void *b)
{
    const struct plot_point *x = a, *y = b;
    return x->curve != y->curve ? x->curve - y->curve : (x->seconds > y->seconds) - (x->seconds < y->seconds);
}

static void plot_draw(struct output *t, struct plot *p)
{
    static const char style[] =
        "<style>svg{background:#fff;--s0:#1f6fb4;--s1:#d1495b;--s2:#2e933c;--s3:#8d5a97;--s4:#b8860b;--s5:#444}"
        "text{font:9px sans-serif}path{fill:none;stroke-width:1.5}.grid{stroke:#ddd;stroke-width:.7}</style>\n";
    struct chart *c = &p->chart;
    qsort(p->point, (size_t)p->count, sizeof *p->point, plot_compare);
    output_add(t, "<svg xmlns=\"http://www.w3.org/2000/svg\" ");
    if (!chart_begin(c, t, "Held-out PSNR in dB against CPU seconds, commit " LAB_COMMIT)) output_add(t, ">");
    output_add(
        t, "%s<text x=\"50\" y=\"9\">Held-out PSNR, dB, against CPU seconds (commit " LAB_COMMIT ")</text>\n",
        style);
    for (int i = 0; i < p->count; i++) {
        const struct plot_point *at = &p->point[i];
        const int ends = i + 1 == p->count || at[1].curve != at->curve, of = c->lines % 6;
        const double x = chart_x(c, at->seconds), y = chart_y(c, at->psnr);
        chart_line(c, t, at->seconds, at->psnr);
        if (!ends) continue;
        chart_end_line(c, t, at->name);
        output_add(
            t,
            "<circle cx=\"%.1f\" cy=\"%.1f\" r=\"3\" style=\"fill:var(--s%d)\"/><text x=\"%.1f\" y=\"%.1f\" text-anchor=\"%s\">%s"
            "</text>\n",
            x, y, of, x > 250 ? x - 5 : x + 5, y + 3, x > 250 ? "end" : "start", at->name);
    }
    output_add(t, "</svg>\n");
}

/* ---------------- the page */

static const char *results_name(const char *survey)
{
    const char *slash = strrchr(survey, '/');
    return slash && slash[1] ? slash + 1 : survey;
}

/* Trains a study on a survey, and adds its table to the page. */
static oxl_result results_study(oxl_context *ctx, const struct study_kind *kind, const char *survey,
                                const study_options *all, double budget, struct output *page,
                                struct plot *plot)
{
    char out[1000];
    study_options o = *all;
    struct study *s = malloc(sizeof *s);
    oxl_result rc;
    if (!s) return OXL_ERR_MEMORY;
    snprintf(out, sizeof out, "%s/%s-%s", all->out, results_name(survey), kind->file);
    o.scene = survey, o.out = out, o.budget = budget;
    rc = study_train_all(ctx, kind, &o, s);
    output_add(page, "\n### %s\n", results_name(survey));
    if (rc == OXL_OK) study_table(page, s);
    if (rc == OXL_OK && kind == &STUDY_KINDS[STUDY_TRADEOFF]) plot_add_study(plot, s, results_name(survey));
    free(s);
    return rc;
}

static void results_begin(struct output *page, const study_options *o)
{
    char day[20];
    const time_t now = time(NULL);
    strftime(day, sizeof day, "%Y-%m-%d", gmtime(&now));
    output_add(
        page,
        "# Results\n\nWritten by `oceanxl-lab results` of commit " LAB_COMMIT
        " on %s: preset %s, %d iterations, images of at most %d px a side, seeds 1 to %d (mean +- standard "
        "deviation).\n",
        day, o->job.preset ? o->job.preset : "draft", o->job.train.iterations, o->job.scene.max_side,
        o->seeds);
}

oxl_result results_run(oxl_context *ctx, const char *const *survey, int surveys, const study_options *options,
                       FILE *to)
{
    const time_t started = time(NULL);
    struct output page = {0}, svg = {0};
    struct plot *plot = calloc(1, sizeof *plot);
    int left = STUDY_ALL * surveys;
    oxl_result rc = plot ? oxl_make_folder(ctx, options->out) : OXL_ERR_MEMORY;
    if (rc == OXL_OK) rc = output_check_own(ctx, options->out, "results.md", "`oceanxl-lab results`");
    if (plot) plot->chart.is_log = 1;
    results_begin(&page, options);
    for (int k = 0; k < STUDY_ALL && rc == OXL_OK; k++) {
        output_add(&page, "\n## %s\n", STUDY_KINDS[k].title);
        if (k == 0) output_add(&page, "\n![PSNR against CPU seconds](speed.svg)\n");
        for (int i = 0; i < surveys && rc == OXL_OK; i++, left--)
            rc = results_study(ctx, &STUDY_KINDS[k], survey[i], options,
                               fmax(options->budget - difftime(time(NULL), started), 1) / left, &page, plot);
    }
    if (rc == OXL_OK) {
        plot_add_others(plot, options->out);
        plot_draw(&svg, plot);
        rc = study_write(ctx, options->out, "speed.svg", &svg);
    }
    if (rc == OXL_OK) rc = study_write(ctx, options->out, "results.md", &page);
    else free(page.data);
    if (rc == OXL_OK)
        print_format(to, "page      %s/results.md\nplot      %s/speed.svg\n", options->out, options->out);
    free(plot);
    return rc;
}
