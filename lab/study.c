/* study.c - rows of options x seeds, each a training in OUT/NAME-seedS: a study that was stopped, or given
 * more time, resumes.
 *
 * All rows' first seeds come before all second ones: a slow hour of the machine affects every row. With a
 * time budget, rows that do not fit are named, not trained. Memory is what the library held at its peak: the
 * process's own peak never falls and is useless after a larger training. It and the CPU time are kept in the
 * training's study.json.
 */
#include "study.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define STUDY_DENSER 0.3f /* of the base's densify threshold: enough for a control to reach its limit */

/* ---------------- rows */

static const struct study_row *study_find_row(const struct study_kind *kind, const char *name, size_t length)
{
    for (int i = 0; i < kind->rows; i++)
        if (strlen(kind->row[i].name) == length && strncmp(kind->row[i].name, name, length) == 0)
            return &kind->row[i];
    return NULL;
}

/* Returns the place of the row of that name among those chosen; -1: it is not. */
static int study_row_index(const struct study *s, const char *name)
{
    for (int i = 0; name && i < s->rows; i++)
        if (strcmp(s->row[i]->name, name) == 0) return i;
    return -1;
}

static oxl_result study_choose_row(struct study *s, const char *name, size_t length)
{
    const struct study_row *row = study_find_row(s->kind, name, length);
    char names[500] = "";
    if (row && study_row_index(s, row->name) < 0 && (!row->like || study_row_index(s, row->like) >= 0)) {
        s->row[s->rows++] = row;
        return OXL_OK;
    }
    for (int i = s->kind->has_baseline; i < s->kind->rows; i++)
        snprintf(names + strlen(names), sizeof names - strlen(names), " %s", s->kind->row[i].name);
    return oxl_fail(
        s->ctx, OXL_ERR_USAGE,
        "--rows: found '%.*s', expected each of these at most once, controls after their rows:%s\n"
        "fix: --rows with some of them, joined by commas",
        length > 40 ? 40 : (int)length, name, names);
}

/* Chooses the rows of --rows, or all. */
static oxl_result study_choose_rows(struct study *s)
{
    oxl_result rc = OXL_OK;
    const char *rows = s->options->rows;
    if (s->kind->has_baseline) s->row[s->rows++] = &s->kind->row[0];
    while (!rows && s->rows < s->kind->rows) s->row[s->rows] = &s->kind->row[s->rows], s->rows++;
    for (; rows && rc == OXL_OK; rows = strchr(rows, ',') ? strchr(rows, ',') + 1 : NULL)
        rc = study_choose_row(s, rows, strcspn(rows, ","));
    return rc;
}

/* Sets the options of a row, "cut=midpoint ucd=off". Refuses one of a part that this build does not have. */
static oxl_result study_set_options(oxl_context *ctx, const struct study_row *row, oxl_job_options *job)
{
    char name[40], value[40];
    for (const char *at = row->options; sscanf(at, "%39[^=]=%39s", name, value) == 2; at += *at == ' ') {
        const oxl_option *o = oxl_option_find(name);
        if (!o || oxl_option_set(o, job, value, NULL, 0) != OXL_OK)
            return oxl_fail(ctx, OXL_ERR_USAGE,
                            "row %s sets --%s, which this build does not have\nfix: --rows without %s",
                            row->name, name, row->name);
        at += strcspn(at, " ");
    }
    return OXL_OK;
}

static oxl_result study_job(const struct study *s, int row, int seed, oxl_job_options *job)
{
    const struct study_row *r = s->row[row];
    const int like = study_row_index(s, r->like);
    oxl_result rc;
    *job = s->base;
    job->seed = (uint64_t)seed;
    job->block = -1;
    job->renders = 0;
    if (r->preset) job->train = oxl_train_options_default((oxl_preset)(r->preset - 1));
    job->train.max_gaussians = s->base.train.max_gaussians;
    if (r->iterations > 0) job->train.iterations = (int)(r->iterations * s->base.train.iterations + 0.5);
    rc = study_set_options(s->ctx, r, job);
    if (!r->preset) job->train.ucd.learn = s->base.train.ucd.learn; /* rows differ by the mode alone */
    if (like < 0) return rc;
    if (r->equal == STUDY_GAUSSIANS) {
        job->train.densify_gradient *= STUDY_DENSER;
        job->train.max_gaussians = (int)s->value[like][seed - 1][STUDY_GAUSSIANS];
    } else job->train.keep = (oxl_keep){OXL_KEEP_BYTES, s->value[like][seed - 1][STUDY_BYTES]};
    return rc;
}

/* ---------------- one training */

static double study_cpu(void)
{
    return (double)clock() / CLOCKS_PER_SEC;
}

static int study_progress(void *user, const oxl_progress *p)
{
    struct study *s = user;
    const oxl_callback *c = &s->options->callback;
    if (s->is_fresh < 0) {
        s->is_fresh = p->iteration <= 1 && p->block == 0 &&
                      p->stage == (p->blocks > 1 ? OXL_STAGE_COARSE : OXL_STAGE_BLOCK);
        s->cpu = study_cpu();
    }
    return c->progress ? c->progress(c->user, p) : 0;
}

oxl_result study_write(oxl_context *ctx, const char *folder, const char *name, struct output *t)
{
    char path[1100];
    snprintf(path, sizeof path, "%s/%s", folder, name);
    return output_save(t, path)
               ? OXL_OK
               : oxl_fail(ctx, OXL_ERR_IO, "%s cannot be written\nfix: free space on the disk", path);
}

/* Records the cost: the memory's peak over all the parts in which it was trained, and their CPU time. */
static oxl_result study_record_cost(const struct study *s, const char *folder)
{
    double cpu = study_cpu() - s->cpu, peak = (double)s->options->memory->peak;
    char *before = output_read(folder, "study.json", NULL);
    struct output t = {0};
    if (!s->is_fresh) {
        cpu += oxl_json_number(before, "cpu_seconds");
        peak = fmax(peak, oxl_json_number(before, "library_peak_bytes"));
    }
    free(before);
    if (s->is_fresh < 0) return OXL_OK;
    output_add(&t, "{\n  \"library_peak_bytes\": %.0f", peak);
    if (!isnan(cpu)) output_add(&t, ",\n  \"cpu_seconds\": %.2f", cpu);
    output_add(&t, "\n}\n");
    return study_write(s->ctx, folder, "study.json", &t);
}

static oxl_result study_read(const struct study *s, const char *folder, double value[STUDY_MEASURES])
{
    char *metrics = output_read(folder, "metrics.json", NULL),
         *cost = output_read(folder, "study.json", NULL);
    for (int m = 0; m < STUDY_MEASURES; m++)
        value[m] = oxl_json_number(m < STUDY_CPU ? metrics : cost, STUDY_COLUMNS[m].member);
    free(metrics);
    free(cost);
    if (!isnan(value[STUDY_PSNR]) && !isnan(value[STUDY_BYTES]) && !isnan(value[STUDY_GAUSSIANS]))
        return OXL_OK;
    return oxl_fail(
        s->ctx, OXL_ERR_INPUT,
        "no whole metrics.json of a training\nfix: remove this folder and run the command again: %s", folder);
}

static oxl_result study_train(struct study *s, int row, int seed)
{
    const oxl_callback callback = {study_progress, s};
    oxl_job_options job;
    char folder[1000];
    oxl_result rc = study_job(s, row, seed, &job), noted;
    snprintf(folder, sizeof folder, "%s/%s-seed%d", s->options->out, s->row[row]->name, seed);
    s->options->memory->peak = s->options->memory->used;
    s->is_fresh = -1;
    if (rc == OXL_OK) rc = oxl_job_run(s->ctx, s->options->scene, folder, &job, &callback);
    if (rc != OXL_OK && rc != OXL_ERR_INTERRUPTED) return rc;
    noted = study_record_cost(s, folder);
    if (rc == OXL_OK) rc = noted;
    if (rc == OXL_OK) rc = study_read(s, folder, s->value[row][seed - 1]);
    if (rc == OXL_OK) s->done[row] = seed;
    return rc;
}

/* ---------------- all of it */

/* Returns 1 where the row that this one is made equal to has that seed, and what the training would take, by
 * the first row's, is left of the budget. */
static int study_is_due(const struct study *s, int row, int seed, double left)
{
    const int like = study_row_index(s, s->row[row]->like);
    oxl_job_options job;
    if ((like >= 0 && s->done[like] < seed) || s->done[row] < seed - 1) return 0;
    return row == 0 || !(s->options->budget > 0) || study_job(s, row, 1, &job) != OXL_OK ||
           study_mean(s, 0, STUDY_SECONDS).mean * job.train.iterations / s->base.train.iterations <= left;
}

static oxl_result study_write_all(const struct study *s, FILE *to)
{
    struct output page = {0}, csv = {0};
    char name[40];
    oxl_result rc;
    study_page(&page, s);
    study_csv(&csv, s);
    if (!page.failed) print_format(to, "%s\n", page.data);
    snprintf(name, sizeof name, "%s.md", s->kind->file);
    rc = study_write(s->ctx, s->options->out, name, &page);
    snprintf(name, sizeof name, "%s.csv", s->kind->file);
    if (rc == OXL_OK) rc = study_write(s->ctx, s->options->out, name, &csv);
    else free(csv.data);
    if (rc == OXL_OK)
        print_format(to, "page      %s/%s.md\ntable     %s/%s.csv\n", s->options->out, s->kind->file,
                     s->options->out, s->kind->file);
    return rc;
}

/* Refuses rows and options that cannot be trained, and to replace tables of another program. */
static oxl_result study_begin(struct study *s)
{
    char name[40];
    oxl_job_options job;
    oxl_result rc = study_choose_rows(s);
    for (int r = 0; r < s->rows && rc == OXL_OK; r++) rc = study_job(s, r, 1, &job);
    if (rc == OXL_OK && strlen(s->options->out) > 900)
        rc = oxl_fail(s->ctx, OXL_ERR_USAGE,
                      "the name of the folder is too long\nfix: a shorter one than -o %s", s->options->out);
    if (rc == OXL_OK) rc = oxl_make_folder(s->ctx, s->options->out);
    snprintf(name, sizeof name, "%s.md", s->kind->file);
    if (rc == OXL_OK) rc = output_check_own(s->ctx, s->options->out, name, "## Effects");
    snprintf(name, sizeof name, "%s.csv", s->kind->file);
    return rc == OXL_OK ? output_check_own(s->ctx, s->options->out, name, "row,seed,psnr") : rc;
}

oxl_result study_train_all(oxl_context *ctx, const struct study_kind *kind, const study_options *options,
                           struct study *s)
{
    const time_t started = time(NULL);
    oxl_result rc;
    *s = (struct study){.ctx = ctx, .kind = kind, .options = options, .base = options->job};
    if (kind->sh_degree && s->base.train.sh_degree < 0) s->base.train.sh_degree = kind->sh_degree;
    rc = study_begin(s);
    for (int seed = 1; seed <= options->seeds && rc == OXL_OK; seed++)
        for (int row = 0; row < s->rows && rc == OXL_OK; row++)
            if (study_is_due(s, row, seed, options->budget - difftime(time(NULL), started)))
                rc = study_train(s, row, seed);
    return rc;
}

oxl_result study_run(oxl_context *ctx, enum study_name name, const study_options *options, FILE *to)
{
    struct study *s = malloc(sizeof *s);
    oxl_result rc = s ? study_train_all(ctx, &STUDY_KINDS[name], options, s) : OXL_ERR_MEMORY;
    if (rc == OXL_OK) rc = study_write_all(s, to);
    free(s);
    return rc;
}
