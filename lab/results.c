/* results.c - tables by one command: one study or all, on one survey or several, on one build.
 *
 * The time is divided evenly among what is left. The page names the commit that wrote it.
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

/* ---------------- page and CSV */

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

/* Writes the page, study by study, and the CSV. */
static oxl_result results_write_all(oxl_context *ctx, const study_options *o, const struct study *s,
                                    int count, FILE *to)
{
    struct output page = {0}, csv = {0};
    oxl_result rc = OXL_OK;
    results_begin(&page, &csv, o);
    for (int i = 0, same; i < count; i += same) {
        for (same = 1; i + same < count && s[i + same].kind == s[i].kind;) same++;
        study_section(&page, &s[i], same);
        study_csv(&csv, &s[i], same);
    }
    if (!page.failed) print_format(to, "%s\n", page.data);
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
    oxl_result rc = s ? OXL_OK : OXL_ERR_MEMORY;
    const int count = rc == OXL_OK ? results_plan(ctx, o, s, &rc) : 0;
    if (rc == OXL_OK) rc = results_check(ctx, o);
    for (int i = 0; i < count && rc == OXL_OK; i++)
        rc = study_train_all(
            &s[i], o->budget > 0 ? fmax(o->budget - difftime(time(NULL), started), 1e-3) / (count - i) : 0);
    if (rc == OXL_OK) rc = results_write_all(ctx, o, s, count, to);
    free(s);
    return rc;
}
