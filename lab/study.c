/* study.c - rows of options x seeds, each a training in OUT/NAME-seedS: a study that was stopped, or given
 * more time, resumes.
 *
 * All rows' first seeds come before all second ones: a slow hour of the machine affects every row. With a
 * time budget, rows that do not fit are named, not trained.
 */
#include "study.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define STUDY_SIDE_MIN 240 /* px: images are not reduced below this to fit the budget */
/* times the base: rows of more steps are not counted when the image size is chosen */
#define STUDY_LONG 3.0
#define STUDY_ALIKE 0.03 /* log of the accepted ratio of counts */
#define STUDY_GUESS 0.75 /* of the base's densify threshold: where the search for an equal count starts */
#define STUDY_SLOPE -0.8 /* of log count over log threshold, until two trials measure it */
enum { STUDY_TRIALS = 4 };

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

static oxl_result study_wrong_row(const struct study *s, const char *name, size_t length)
{
    char names[500] = "";
    size_t used = 0;
    for (int i = s->kind->has_baseline; i < s->kind->rows && used < sizeof names; i++)
        used += (size_t)snprintf(names + used, sizeof names - used, " %s", s->kind->row[i].name);
    return oxl_fail(
        s->meter.ctx, OXL_ERR_USAGE,
        "--rows: found '%.*s', expected each of these at most once:%s\nfix: --rows with some of them, joined by commas",
        length > 40 ? 40 : (int)length, name, names);
}

static oxl_result study_choose_row(struct study *s, const char *name, size_t length)
{
    const struct study_row *row = study_find_row(s->kind, name, length);
    if (!row || study_row_index(s, row->name) >= s->kind->has_baseline)
        return study_wrong_row(s, name, length);
    if (study_row_index(s, row->name) >= 0) return OXL_OK;
    if (row->like && study_row_index(s, row->like) < 0)
        return oxl_fail(s->meter.ctx, OXL_ERR_USAGE,
                        "--rows: found %s without %s before it, which it is compared with\nfix: --rows %s,%s",
                        row->name, row->like, row->like, row->name);
    s->row[s->rows++] = row;
    return OXL_OK;
}

static oxl_result study_choose_rows(struct study *s)
{
    oxl_result rc = OXL_OK;
    const char *rows = s->options->rows;
    if (!rows || s->kind->has_baseline) s->row[s->rows++] = &s->kind->row[0];
    for (; !rows && s->rows < s->kind->by_default; s->rows++) s->row[s->rows] = &s->kind->row[s->rows];
    for (; rows && rc == OXL_OK; rows = strchr(rows, ',') ? strchr(rows, ',') + 1 : NULL)
        rc = study_choose_row(s, rows, strcspn(rows, ","));
    return rc;
}

static oxl_job_options study_job(const struct study *s, int row, int seed)
{
    const struct study_row *r = s->row[row];
    oxl_job_options job = s->base;
    job.seed = (uint64_t)seed;
    job.block = -1;
    job.renders = 0;
    if (r->preset) job.train = oxl_train_options_default((oxl_preset)(r->preset - 1));
    job.train.max_gaussians = s->base.train.max_gaussians;
    if (r->iterations > 0) job.train.iterations = (int)(r->iterations * s->base.train.iterations + 0.5);
    for (int i = 0; i < STUDY_OPTIONS && r->option[i][0]; i++)
        oxl_option_set(oxl_option_find(r->option[i][0]), &job, r->option[i][1], NULL, 0);
    if (!r->preset) job.train.ucd.learn = s->base.train.ucd.learn; /* rows differ by the mode alone */
    if (r->equal == STUDY_GAUSSIANS) job.train.densify_gradient = (float)s->threshold[row];
    if (r->equal == STUDY_BYTES)
        job.train.keep =
            (oxl_keep){OXL_KEEP_BYTES, s->value[study_row_index(s, r->like)][seed - 1][STUDY_BYTES]};
    return job;
}

/* ---------------- time */

/* Returns the steps of the row, in the base's. */
static double study_steps(const struct study *s, int row)
{
    const int trials = s->row[row]->equal == STUDY_GAUSSIANS ? STUDY_TRIALS : 1;
    return (double)trials * study_job(s, row, 1).train.iterations / s->base.train.iterations;
}

/* Reduces images, without a size asked for, until the first seeds of all rows but the longest are likely to
 * fit the budget. The choice is kept in this folder, so a resumed study compares equal sizes. */
static oxl_result study_choose_side(struct study *s)
{
    char *before = output_read(s->options->out, "study.json", NULL);
    const double chosen = oxl_json_number(before, "max_side");
    double steps = 0;
    oxl_survey survey;
    struct output t = {0};
    oxl_result rc = oxl_check(s->meter.ctx, s->options->scene, &s->base, &survey);
    free(before);
    if (rc != OXL_OK) return rc;
    s->train_views = survey.train_views;
    for (int i = 0; i < s->rows; i++) steps += study_steps(s, i) < STUDY_LONG ? study_steps(s, i) : 0;
    if (!(s->options->budget > 0) || s->options->side_is_given) return OXL_OK;
    if (chosen >= 1) s->base.scene.max_side = (int)chosen;
    else {
        const int side = survey.width > survey.height ? survey.width : survey.height;
        const int fits = (int)(side * sqrt(s->options->budget / (survey.seconds * steps))) / 16 * 16;
        if (fits < side) s->base.scene.max_side = fits < STUDY_SIDE_MIN ? STUDY_SIDE_MIN : fits;
    }
    output_add(&t, "{\n  \"max_side\": %d\n}\n", s->base.scene.max_side);
    return study_write(s->meter.ctx, s->options->out, "study.json", &t);
}

static int study_is_finished(const char *folder)
{
    char *run = output_read(folder, "run.json", NULL);
    const int finished = oxl_json_is_true(run, "finished");
    free(run);
    return finished;
}

/* ---------------- training */

/* Trains one row. trial: of a search, from 0; each has its folder. */
static oxl_result study_train_in(struct study *s, int row, int seed, int trial, struct study_result *out)
{
    const oxl_job_options job = study_job(s, row, seed);
    char folder[1000], line[200];
    snprintf(folder, sizeof folder, trial ? "%s/%s-seed%d-%d" : "%s/%s-seed%d", s->options->out,
             s->row[row]->name, seed, trial);
    snprintf(line, sizeof line, "%s, seed %d (row %d of %d, seed %d of %d)", s->row[row]->label, seed,
             row + 1, s->rows, seed, s->options->seeds);
    if (s->options->log) s->options->log(s->options->callback.user, OXL_LOG_INFO, line);
    return study_train(&s->meter, folder, &job, out);
}

/* Takes a secant step in logarithms: the count is near a power of the threshold. off: log of count over the
 * wanted one, of k + 1 trials. */
static double study_next(const double *threshold, const double *off, int k)
{
    double slope = STUDY_SLOPE;
    if (k > 0 && threshold[k] != threshold[k - 1])
        slope = fmin(-0.2, fmax(-3, (off[k] - off[k - 1]) / (threshold[k] - threshold[k - 1])));
    return threshold[k] - off[k] / slope;
}

/* Trains a control: the densify threshold, the same at all depths, is adjusted until the number of
 * Gaussians equals that of the row `like`. The nearest trial is used. */
static oxl_result study_train_equal(struct study *s, int row, int seed, struct study_result *out)
{
    const double wanted = s->value[study_row_index(s, s->row[row]->like)][seed - 1][STUDY_GAUSSIANS];
    /* off: log of count over wanted */
    double least = HUGE_VAL, found = 0, threshold[STUDY_TRIALS], off[STUDY_TRIALS];
    oxl_result rc = OXL_OK;
    if (!(s->threshold[row] > 0)) s->threshold[row] = STUDY_GUESS * s->base.train.densify_gradient;
    for (int k = 0; k < STUDY_TRIALS && least > STUDY_ALIKE && rc == OXL_OK; k++) {
        struct study_result r;
        rc = study_train_in(s, row, seed, k, &r);
        if (rc != OXL_OK) return rc;
        threshold[k] = log(s->threshold[row]);
        off[k] = log(fmax(1, r.value[STUDY_GAUSSIANS]) / fmax(1, wanted));
        if (fabs(off[k]) < least) least = fabs(off[k]), found = s->threshold[row], *out = r;
        s->threshold[row] = exp(study_next(threshold, off, k));
    }
    s->threshold[row] = found;
    return rc;
}

static oxl_result study_train_row(struct study *s, int row, int seed, time_t started)
{
    const double left =
        s->options->budget > 0 ? s->options->budget - difftime(time(NULL), started) : HUGE_VAL;
    struct study_result got;
    char folder[1000];
    oxl_result rc;
    snprintf(folder, sizeof folder, "%s/%s-seed%d", s->options->out, s->row[row]->name, seed);
    s->wanted[row] = row == 0 ? 0 : study_steps(s, row) * study_mean(s, 0, STUDY_SECONDS).mean;
    if (s->row[row]->like && s->done[study_row_index(s, s->row[row]->like)] < seed) return OXL_OK;
    if (s->done[row] < seed - 1 || (s->wanted[row] > left && !study_is_finished(folder))) return OXL_OK;
    if (s->row[row]->equal == STUDY_GAUSSIANS) rc = study_train_equal(s, row, seed, &got);
    else rc = study_train_in(s, row, seed, 0, &got);
    if (rc != OXL_OK) return rc;
    s->done[row] = seed;
    s->blocks[row] = got.blocks;
    s->held_out = got.held_out;
    memcpy(s->value[row][seed - 1], got.value, sizeof got.value);
    return OXL_OK;
}

/* ---------------- all of it */

static oxl_result study_write_all(struct study *s, FILE *to)
{
    static void (*const make[])(struct output * t, const struct study *s) = {study_page, study_csv,
                                                                             study_plot};
    static const char *const ends[] = {"md", "csv", "svg"};
    oxl_result rc = OXL_OK;
    for (int i = 0; i < 3 && rc == OXL_OK; i++) {
        struct output t = {0};
        char name[40];
        snprintf(name, sizeof name, "%s.%s", s->kind->file, ends[i]);
        make[i](&t, s);
        if (i == 0 && !t.failed) print_format(to, "%s\n", t.data);
        rc = study_write(s->meter.ctx, s->options->out, name, &t);
        if (rc == OXL_OK) print_format(to, "%-5s %s/%s\n", ends[i], s->options->out, name);
    }
    return rc;
}

/* Refuses rows that set an option of a part of training which this build does not have. */
static oxl_result study_check_options(const struct study *s)
{
    for (int r = 0; r < s->rows; r++)
        for (int i = 0; i < STUDY_OPTIONS && s->row[r]->option[i][0]; i++)
            if (!oxl_option_find(s->row[r]->option[i][0]))
                return oxl_fail(
                    s->meter.ctx, OXL_ERR_USAGE,
                    "row %s sets --%s, which this build does not have\nfix: --rows without %s, or a build with the "
                    "part of training that the option belongs to",
                    s->row[r]->name, s->row[r]->option[i][0], s->row[r]->name);
    return OXL_OK;
}

/* Refuses to replace tables of another program, and a study.json that is not of a study. */
static oxl_result study_check_files(const struct study *s)
{
    static const char *const own[][2] = {
        {"md", "![PSNR over cost]("}, {"csv", "row,against,seed,blocks"}, {"svg", "class='title'>"}};
    oxl_result rc = output_check_own(s->meter.ctx, s->options->out, "study.json", "\"max_side\"");
    for (size_t i = 0; i < sizeof own / sizeof *own && rc == OXL_OK; i++) {
        char name[40];
        snprintf(name, sizeof name, "%s.%s", s->kind->file, own[i][0]);
        rc = output_check_own(s->meter.ctx, s->options->out, name, own[i][1]);
    }
    return rc;
}

static oxl_result study_train_rows(struct study *s, FILE *to)
{
    const time_t started = time(NULL);
    oxl_result rc = study_choose_rows(s);
    if (rc == OXL_OK) rc = study_check_options(s);
    if (rc == OXL_OK && strlen(s->options->out) > 900)
        rc = oxl_fail(s->meter.ctx, OXL_ERR_USAGE,
                      "the name of the folder is too long\nfix: a shorter one than -o %s", s->options->out);
    if (rc == OXL_OK) rc = oxl_make_folder(s->meter.ctx, s->options->out);
    if (rc == OXL_OK) rc = study_check_files(s);
    if (rc == OXL_OK) rc = study_choose_side(s);
    for (int seed = 1; seed <= s->options->seeds && rc == OXL_OK; seed++)
        for (int row = 0; row < s->rows && rc == OXL_OK; row++) rc = study_train_row(s, row, seed, started);
    return rc == OXL_OK ? study_write_all(s, to) : rc;
}

oxl_result study_run(oxl_context *ctx, const struct study_kind *kind, const study_options *options, FILE *to)
{
    struct study *s = calloc(1, sizeof *s);
    oxl_result rc;
    if (!s) return OXL_ERR_MEMORY;
    s->kind = kind;
    s->options = options;
    s->base = options->job;
    s->meter = (struct study_meter){.ctx = ctx, .options = options};
    rc = study_train_rows(s, to);
    free(s);
    return rc;
}
