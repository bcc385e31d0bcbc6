/* results.c - tables and a plot by one command: one study or all, on one survey or several, on one build.
 *
 * The time is divided evenly among what is left. The page and the plot name the commit that wrote them.
 */
#include "study.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#ifndef LAB_COMMIT
#define LAB_COMMIT "(not known)"
#endif
const char STUDY_BUILD[] = LAB_COMMIT;

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
    p->chart.is_log = 1;
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
    char *text = output_read(folder, "others.csv"), name[40];
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

/* ---------------- page, CSV and plot */

static void results_begin(struct output *page, struct output *csv, const study_options *o)
{
    char day[20];
    const time_t now = time(NULL);
    strftime(day, sizeof day, "%Y-%m-%d", gmtime(&now));
    output_add(
        page,
        "# Results\n\nWritten by `oceanxl %s`, commit %s, on %s: preset %s, %d iterations, images of at most %d px a "
        "side,\nseeds 1 to %d (mean +- standard deviation).\n\nRows marked \\* are on the front: no other row has as "
        "good a PSNR in no more CPU time. structure: correlation of\ndetail, 0 is a veil. MB: the model's file. CPU "
        "min: all threads together. peak: what the library held. A row against a\nrow: differences, or ratios (x), "
        "seed by seed; none: not larger than the standard deviation over the seeds. The same\ncommand with a larger "
        "--budget trains the rows that are missing.\n",
        o->name, STUDY_BUILD, day, o->job.preset ? o->job.preset : "draft", o->job.train.iterations,
        o->job.scene.max_side, o->seeds);
    output_add(csv, "study,scene,row,seed");
    for (int m = 0; m < STUDY_MEASURES; m++) output_add(csv, ",%s", STUDY_COLUMNS[m].member);
    output_add(csv, "\n");
}

static oxl_result results_write(oxl_context *ctx, const char *out, const char *name, const char *extension,
                                struct output *t, FILE *to)
{
    char path[4200];
    oxl_result rc;
    snprintf(path, sizeof path, "%s/%s.%s", out, name, extension);
    rc = output_save(ctx, t, path);
    if (rc == OXL_OK) print_format(to, "written   %s\n", path);
    return rc;
}

/* ---------------- the run */

/* Refuses a folder that is not to be written to, or holds tables of another program. */
static oxl_result results_check(oxl_context *ctx, const study_options *o)
{
    static const char *const files[][2] = {{"md", "Written by `oceanxl "}, {"csv", "study,scene,row,seed"}};
    oxl_result rc = oxl_make_folder(ctx, o->out);
    for (int i = 0; i < 2 && rc == OXL_OK; i++) {
        char name[40];
        snprintf(name, sizeof name, "%s.%s", o->name, files[i][0]);
        rc = output_check_own(ctx, o->out, name, files[i][1]);
    }
    return rc;
}

/* Returns 1 for a folder in the layout of NeRF synthetic or LLFF. */
static int results_is_published(const char *survey)
{
    static const char *const files[] = {"transforms_train.json", "poses_bounds.npy"};
    for (int i = 0; i < 2; i++) {
        char *text = output_read(survey, files[i]);
        free(text);
        if (text) return 1;
    }
    return 0;
}

/* Chooses the rows of each study on each survey that suits it, study by study. Returns how many. */
static int results_plan(oxl_context *ctx, const study_options *o, struct study *s, oxl_result *rc)
{
    int count = 0;
    for (int k = 0; k < STUDY_ALL; k++)
        for (int i = 0; o->studies >> k & 1 && i < o->surveys; i++)
            if (*rc == OXL_OK && (!(o->studies >> STUDY_PUBLISHED & 1) ||
                                  results_is_published(o->survey[i]) == STUDY_KINDS[k].is_published))
                *rc = study_begin(ctx, &STUDY_KINDS[k], o->survey[i], o, &s[count++]);
    return count;
}

/* Writes the page, study by study, the CSV, and the plot where there are points for it. */
static oxl_result results_write_all(oxl_context *ctx, const study_options *o, const struct study *s,
                                    int count, struct plot *plot, FILE *to)
{
    struct output page = {0}, csv = {0}, svg = {0};
    oxl_result rc = OXL_OK;
    results_begin(&page, &csv, o);
    for (int i = 0, same; i < count; i += same) {
        for (same = 1; i + same < count && s[i + same].kind == s[i].kind;) same++;
        study_section(&page, &s[i], same);
        study_csv(&csv, &s[i], same);
        for (int k = i; k < i + same && s[i].kind == &STUDY_KINDS[STUDY_TRADEOFF]; k++)
            plot_add_study(plot, &s[k], study_scene(&s[k]));
    }
    if (!page.failed) print_format(to, "%s\n", page.data);
    if (plot->count > 0) {
        plot_add_others(plot, o->out);
        plot_draw(&svg, plot);
        rc = results_write(ctx, o->out, "speed", "svg", &svg, to);
    }
    for (int i = 0; i < 2; i++) {
        const oxl_result written =
            results_write(ctx, o->out, o->name, i ? "csv" : "md", i ? &csv : &page, to);
        if (rc == OXL_OK) rc = written;
    }
    return rc;
}

oxl_result study_run(oxl_context *ctx, const study_options *o, FILE *to)
{
    const time_t started = time(NULL);
    struct study *s = calloc((size_t)(STUDY_ALL * o->surveys), sizeof *s);
    struct plot *plot = calloc(1, sizeof *plot);
    oxl_result rc = s && plot ? OXL_OK : OXL_ERR_MEMORY;
    const int count = rc == OXL_OK ? results_plan(ctx, o, s, &rc) : 0;
    if (rc == OXL_OK) rc = results_check(ctx, o);
    for (int i = 0; i < count && rc == OXL_OK; i++)
        rc = study_train_all(
            &s[i], o->budget > 0 ? fmax(o->budget - difftime(time(NULL), started), 1e-3) / (count - i) : 0);
    if (rc == OXL_OK) rc = results_write_all(ctx, o, s, count, plot, to);
    free(plot);
    free(s);
    return rc;
}
