/* study.c - rows of options x seeds, each a training in OUT/SURVEY/ROW-seedS: a study that was stopped, or given
 * more time, resumes.
 *
 * All rows' first seeds come before all second ones: a slow hour of the machine affects every row. With a time
 * budget, rows that do not fit are named, not trained; rows that are finished or have begun are kept. Memory is
 * what the library held at its peak: the process's own peak never falls and is useless after a larger training.
 * It and the CPU time are kept in the training's study.json, with the build that trained it.
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
    if (r->iterations > 0)
        job->train.iterations = (int)fmax(1, r->iterations * s->base.train.iterations + 0.5);
    rc = study_set_options(s->ctx, r, job);
    /* rows differ by whether depth is weighted, not by how the weights are found */
    if (!r->preset && job->train.ucd == OXL_UCD_ON && s->base.train.ucd == OXL_UCD_SEARCH)
        job->train.ucd = OXL_UCD_SEARCH;
    if (like < 0) return rc;
    if (r->equal == STUDY_GAUSSIANS) {
        job->train.densify_gradient *= STUDY_DENSER;
        job->train.max_gaussians = (int)s->value[like][seed - 1][STUDY_GAUSSIANS];
    } else job->train.keep = (oxl_keep){OXL_KEEP_BYTES, s->value[like][seed - 1][STUDY_BYTES]};
    return rc;
}

/* ---------------- one training */

/* What the study.json of a training holds; NaN: not known. */
struct study_record {
    int is_there, is_ours, is_finished; /* is_ours: of this build */
    double cpu, peak;
};

static double study_cpu(void)
{
    return (double)clock() / CLOCKS_PER_SEC;
}

const char *study_scene(const struct study *s)
{
    const char *slash = strrchr(s->survey, '/');
    return slash && slash[1] ? slash + 1 : s->survey;
}

static void study_folder(const struct study *s, int row, int seed, char out[4200])
{
    snprintf(out, 4200, "%s/%s/%s-seed%d", s->options->out, study_scene(s), s->row[row]->name, seed);
}

static struct study_record study_read_record(const char *folder)
{
    char *text = output_read(folder, "study.json"), *build = json_string(oxl_json_member(text, "build"));
    const struct study_record r = {text != NULL, build && strcmp(build, STUDY_BUILD) == 0,
                                   oxl_json_is_true(text, "finished"), oxl_json_number(text, "cpu_seconds"),
                                   oxl_json_number(text, "library_peak_bytes")};
    free(text);
    free(build);
    return r;
}

static oxl_result study_write_record(oxl_context *ctx, const char *folder, const struct study_record *r)
{
    struct output t = {0};
    char path[4300];
    oxl_result rc = oxl_make_folder(ctx, folder);
    snprintf(path, sizeof path, "%s/study.json", folder);
    output_add(&t, "{\n  \"build\": \"%s\",\n  \"finished\": %s", STUDY_BUILD,
               r->is_finished ? "true" : "false");
    if (!isnan(r->peak)) output_add(&t, ",\n  \"library_peak_bytes\": %.0f", r->peak);
    if (!isnan(r->cpu)) output_add(&t, ",\n  \"cpu_seconds\": %.2f", r->cpu);
    output_add(&t, "\n}\n");
    if (rc != OXL_OK) free(t.data);
    else rc = output_save(ctx, &t, path);
    return rc;
}

/* While a training runs, its study.json states no cost: a killed process leaves none, not one that is too small. */
static int study_progress(void *user, const oxl_progress *p)
{
    struct study *s = user;
    const oxl_callback *c = &s->options->callback;
    const struct study_record begun = {.cpu = NAN, .peak = NAN};
    if (s->is_fresh < 0) {
        s->is_fresh = p->iteration <= 1 && p->block == 0 &&
                      p->stage == (p->blocks > 1 ? OXL_STAGE_COARSE : OXL_STAGE_BLOCK);
        s->cpu = study_cpu();
        if (study_write_record(s->ctx, s->folder, &begun) != OXL_OK) return 1;
    }
    return c->progress ? c->progress(c->user, p) : 0;
}

/* Adds the memory's peak and the CPU time of this part of a training to those of the parts before. */
static void study_add_cost(const struct study *s, struct study_record *r)
{
    const double cpu = study_cpu() - s->cpu, peak = (double)s->options->memory->peak;
    if (s->is_fresh < 0) return;
    r->cpu = s->is_fresh ? cpu : r->cpu + cpu;
    r->peak = s->is_fresh ? peak : fmax(peak, r->peak);
}

static oxl_result study_read(const struct study *s, const char *folder, double value[STUDY_MEASURES])
{
    char *metrics = output_read(folder, "metrics.json"), *cost = output_read(folder, "study.json");
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
    struct study_record record;
    oxl_result rc = study_job(s, row, seed, &job), trained;
    if (rc != OXL_OK) return rc;
    study_folder(s, row, seed, s->folder);
    record = study_read_record(s->folder);
    job.restart = record.is_there && !record.is_ours;
    s->options->memory->peak = s->options->memory->used;
    s->is_fresh = -1;
    trained = oxl_job_run(s->ctx, s->survey, s->folder, &job, &callback);
    record.is_finished = trained == OXL_OK;
    study_add_cost(s, &record);
    if (record.is_finished || (trained == OXL_ERR_INTERRUPTED && s->is_fresh >= 0))
        rc = study_write_record(s->ctx, s->folder, &record);
    if (trained != OXL_OK) return trained;
    if (rc == OXL_OK) rc = study_read(s, s->folder, s->value[row][seed - 1]);
    if (rc == OXL_OK) s->done[row] = seed;
    return rc;
}

/* ---------------- all of it */

/* Returns the seconds of a row, by those of the first and the iterations of both. */
static double study_seconds(const struct study *s, int row)
{
    oxl_job_options first, job;
    study_job(s, 0, 1, &first), study_job(s, row, 1, &job);
    return (s->done[0] ? study_mean(s, 0, STUDY_SECONDS).mean : s->predicted) * job.train.iterations /
           first.train.iterations;
}

/* Returns 1 where the row that this one is made equal to has that seed, and this build has trained it or begun to,
 * or what it would take is left of the budget. */
static int study_is_due(const struct study *s, int row, int seed, double left)
{
    const int like = study_row_index(s, s->row[row]->like);
    char folder[4200];
    if ((like >= 0 && s->done[like] < seed) || s->done[row] < seed - 1) return 0;
    study_folder(s, row, seed, folder);
    return study_read_record(folder).is_ours || study_seconds(s, row) <= left;
}

/* Predicts how long the first row takes, if it is not there. */
static oxl_result study_predict(struct study *s)
{
    oxl_survey survey;
    oxl_job_options job;
    char folder[4200];
    oxl_result rc = study_job(s, 0, 1, &job);
    study_folder(s, 0, 1, folder);
    if (rc != OXL_OK || study_read_record(folder).is_ours) return rc;
    rc = oxl_check(s->ctx, s->survey, &job, 0, &survey);
    if (rc == OXL_OK) s->predicted = survey.seconds;
    return rc;
}

oxl_result study_begin(oxl_context *ctx, const struct study_kind *kind, const char *survey,
                       const study_options *options, struct study *s)
{
    oxl_job_options job;
    oxl_result rc;
    *s = (struct study){.ctx = ctx, .kind = kind, .options = options, .survey = survey, .base = options->job};
    if (kind->sh_degree && s->base.train.sh_degree < 0) s->base.train.sh_degree = kind->sh_degree;
    rc = study_choose_rows(s);
    for (int r = 0; r < s->rows && rc == OXL_OK; r++) rc = study_job(s, r, 1, &job);
    return rc;
}

oxl_result study_train_all(struct study *s, double budget)
{
    const time_t started = time(NULL);
    oxl_result rc = budget > 0 ? study_predict(s) : OXL_OK;
    for (int seed = 1; seed <= s->options->seeds && rc == OXL_OK; seed++)
        for (int row = 0; row < s->rows && rc == OXL_OK; row++)
            if (study_is_due(s, row, seed, budget > 0 ? budget - difftime(time(NULL), started) : HUGE_VAL))
                rc = study_train(s, row, seed);
    return rc;
}
