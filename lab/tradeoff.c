/* tradeoff.c - what speed costs on one's own survey: each option by itself and the presets, trained side by side.
 *
 * The rows are told in the order of their use to a reader, and trained in it, until the time allowed is over: what does not fit any
 * more is named, not trained. All rows' first seeds come before all second ones. Every row and seed is a training of its own in
 * OUT/NAME-seedS, so a sweep that was stopped, or given more time, goes on where it was.
 */
#include "tradeoff.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define TRADEOFF_LEAST_SIDE 240 /* px: photographs are not reduced below this to fit the time allowed */

static const struct tradeoff_row TRADEOFF_VARIANTS[] = {
    {"base", "the options given", TRADEOFF_ITERATIONS, 1},
    {"iterations-half", "half the iterations", TRADEOFF_ITERATIONS, 0.5},
    {"coarse-0", "--coarse 0", TRADEOFF_COARSE, 0},
    {"coarse-0.25", "--coarse 0.25", TRADEOFF_COARSE, 0.25},
    {"coarse-0.5", "--coarse 0.5", TRADEOFF_COARSE, 0.5},
    {"ssim-every-2", "--ssim-every 2", TRADEOFF_SSIM_EVERY, 2},
    {"exp-5", "--exp 5", TRADEOFF_EXP, 5},
    {"alpha-min-0.03", "--alpha-min 0.03", TRADEOFF_ALPHA_MIN, 0.03},
    {"tile-share-0.5", "--tile-share 0.5", TRADEOFF_TILE_SHARE, 0.5},
    {"sh-every-0.2", "--sh-degree-interval 0.2", TRADEOFF_BANDS_EVERY, 0.2},
    {"sh-degree-1", "--sh-degree 1", TRADEOFF_SH_DEGREE, 1},
    {"sh-degree-0", "--sh-degree 0", TRADEOFF_SH_DEGREE, 0},
    {"haste-0", "--short-run-exponent 0", TRADEOFF_HASTE, 0},
    {"settle-0", "--cooldown 0", TRADEOFF_SETTLE, 0},
    {"stop-early", "--stop-early", TRADEOFF_STOP_EARLY, 1},
    {"keep-0.5", "--keep 0.5", TRADEOFF_KEEP, 0.5},
    {"iterations-quarter", "a quarter of the iterations", TRADEOFF_ITERATIONS, 0.25},
    {"draft", "--preset draft", TRADEOFF_PRESET, OXL_PRESET_DRAFT},
    {"iterations-double", "twice the iterations", TRADEOFF_ITERATIONS, 2},
    {"standard", "--preset standard", TRADEOFF_PRESET, OXL_PRESET_STANDARD},
    {"paper", "--preset paper", TRADEOFF_PRESET, OXL_PRESET_PAPER},
};
enum { TRADEOFF_KNOWN = sizeof TRADEOFF_VARIANTS / sizeof *TRADEOFF_VARIANTS };

struct tradeoff_run {
    struct study            study;
    const tradeoff_options *options;
    oxl_job_options         base;
    struct tradeoff         found;
    time_t                  begun;
};

/* ---------------------------------------------------------------- rows */

static oxl_job_options tradeoff_job(const oxl_job_options *base, const struct tradeoff_row *row, int seed)
{
    oxl_job_options job = *base;
    job.seed            = (uint64_t)seed;
    job.block           = -1;
    job.renders         = 0;
    switch (row->option) {
    case TRADEOFF_ITERATIONS: job.train.iterations = (int)(row->value * base->train.iterations + 0.5); break;
    case TRADEOFF_PRESET:
        job.train               = oxl_train_options_default((oxl_preset)row->value);
        job.train.max_gaussians = base->train.max_gaussians;
        break;
    case TRADEOFF_COARSE: job.train.coarse = (float)row->value; break;
    case TRADEOFF_SSIM_EVERY: job.train.ssim_every = (int)row->value; break;
    case TRADEOFF_EXP: job.train.exp_degree = (int)row->value; break;
    case TRADEOFF_ALPHA_MIN: job.train.alpha_min = (float)row->value; break;
    case TRADEOFF_TILE_SHARE: job.train.tile_share = (float)row->value; break;
    case TRADEOFF_BANDS_EVERY: job.train.bands_every = (float)row->value; break;
    case TRADEOFF_SH_DEGREE: job.train.sh_degree = (int)row->value; break;
    case TRADEOFF_HASTE: job.train.haste = (float)row->value; break;
    case TRADEOFF_SETTLE: job.train.settle = (float)row->value; break;
    case TRADEOFF_STOP_EARLY: job.train.stop_early = (int)row->value; break;
    case TRADEOFF_KEEP: job.train.keep = (oxl_keep){OXL_KEEP_FRACTION, row->value}; break;
    }
    return job;
}

static const struct tradeoff_row *tradeoff_variant(const char *name, size_t length)
{
    for (int i = 0; i < TRADEOFF_KNOWN; i++)
        if (strlen(TRADEOFF_VARIANTS[i].name) == length && strncmp(TRADEOFF_VARIANTS[i].name, name, length) == 0)
            return &TRADEOFF_VARIANTS[i];
    return NULL;
}

static oxl_result tradeoff_wrong_row(struct study *s, const char *name, size_t length)
{
    size_t size = (size_t)snprintf(
        s->error, s->error_size, "--rows: '%.*s' seen, each of these at most once wanted:", length > 40 ? 40 : (int)length, name);
    for (int i = 1; i < TRADEOFF_KNOWN && size < s->error_size; i++)
        size += (size_t)snprintf(s->error + size, s->error_size - size, " %s", TRADEOFF_VARIANTS[i].name);
    return OXL_ERR_USAGE;
}

/* The base comes first, named or not: all others are compared with it. */
static oxl_result tradeoff_choose_rows(struct tradeoff_run *r)
{
    struct tradeoff *f = &r->found;
    f->row[f->rows++]  = &TRADEOFF_VARIANTS[0];
    if (!r->options->rows)
        for (; f->rows < TRADEOFF_KNOWN; f->rows++) f->row[f->rows] = &TRADEOFF_VARIANTS[f->rows];
    for (const char *at = r->options->rows; at; at = strchr(at, ',') ? strchr(at, ',') + 1 : NULL) {
        const size_t               length = strcspn(at, ",");
        const struct tradeoff_row *row    = tradeoff_variant(at, length);
        if (row == f->row[0]) continue;
        for (int i = 0; i < f->rows; i++)
            if (f->row[i] == row) row = NULL;
        if (!row) return tradeoff_wrong_row(&r->study, at, length);
        f->row[f->rows++] = row;
    }
    return OXL_OK;
}

/* ---------------------------------------------------------------- time */

/* Steps of the row, in the base's. */
static double tradeoff_steps(const struct tradeoff_run *r, int row)
{
    return (double)tradeoff_job(&r->base, r->found.row[row], 1).train.iterations / r->base.train.iterations;
}

/* Without a size asked for, photographs are reduced until the first seeds of all rows but the longest are likely to fit. What was chosen stays
 * chosen in this folder: a sweep that goes on compares like with like. */
static oxl_result tradeoff_choose_side(struct tradeoff_run *r)
{
    char             *before = study_read(r->options->out, "tradeoff.json");
    const double      chosen = json_number(before, "max_side");
    double            steps  = 0;
    oxl_survey        survey;
    struct study_text t  = {0};
    oxl_result        rc = oxl_check(r->study.ctx, r->options->scene, &r->base, &survey);
    free(before);
    if (rc != OXL_OK) return study_fail(&r->study, rc, "", oxl_error_text(r->study.ctx));
    r->found.train_views = survey.train_views;
    for (int i = 0; i < r->found.rows; i++) steps += tradeoff_steps(r, i) < 3 ? tradeoff_steps(r, i) : 0;
    if (!r->options->side_is_given && chosen >= 1) r->base.scene.max_side = (int)chosen;
    else if (!r->options->side_is_given) {
        const int side = survey.width > survey.height ? survey.width : survey.height;
        double    fits = side * sqrt(r->options->budget / (survey.seconds * steps));
        if (fits < TRADEOFF_LEAST_SIDE) fits = TRADEOFF_LEAST_SIDE;
        if (fits < side) r->base.scene.max_side = (int)fits / 16 * 16;
    }
    r->found.max_side = r->base.scene.max_side;
    study_add(&t, "{\n  \"max_side\": %d\n}\n", r->base.scene.max_side);
    rc = study_write(&r->study, r->options->out, "tradeoff.json", &t);
    free(t.data);
    return rc;
}

static double tradeoff_left(const struct tradeoff_run *r)
{
    return r->options->budget - difftime(time(NULL), r->begun);
}

static int tradeoff_is_finished(const char *folder)
{
    char     *run      = study_read(folder, "run.json");
    const int finished = run && strstr(run, "\"finished\": true") != NULL;
    free(run);
    return finished;
}

/* ---------------------------------------------------------------- training */

static void tradeoff_folder(const struct tradeoff_run *r, int row, int seed, char out[1000])
{
    snprintf(out, 1000, "%s/%s-seed%d", r->options->out, r->found.row[row]->name, seed);
}

static oxl_result tradeoff_train(struct tradeoff_run *r, int row, int seed)
{
    struct tradeoff      *f   = &r->found;
    const oxl_job_options job = tradeoff_job(&r->base, f->row[row], seed);
    struct study_result   got;
    char                  folder[1000], line[160];
    oxl_result            rc;
    tradeoff_folder(r, row, seed, folder);
    f->wanted[row] = row == 0 ? 0 : tradeoff_steps(r, row) * tradeoff_mean(f, 0, TRADEOFF_SECONDS).mean;
    if (f->done[row] < seed - 1) return OXL_OK;
    if (!tradeoff_is_finished(folder) && f->wanted[row] > tradeoff_left(r)) return OXL_OK;
    snprintf(line, sizeof line, "%s, seed %d (row %d of %d, seed %d of %d)", f->row[row]->label, seed, row + 1, f->rows, seed,
             f->seeds);
    study_log(&r->study, line);
    rc = study_train(&r->study, r->options->scene, folder, &job, &got);
    if (rc != OXL_OK) return rc;
    f->held_out  = got.held_out;
    f->done[row] = seed;
    memcpy(
        f->value[row][seed - 1],
        (double[TRADEOFF_MEASURES]){got.psnr, got.ssim, got.ms_ssim, got.cpu, got.seconds, got.memory, got.bytes, got.gaussians},
        sizeof f->value[row][seed - 1]);
    return OXL_OK;
}

/* ---------------------------------------------------------------- all of it */

static oxl_result tradeoff_report(struct tradeoff_run *r, FILE *to)
{
    struct study_text table = {0}, csv = {0}, svg = {0}, page = {0};
    const char       *out = r->options->out;
    oxl_result        rc;
    tradeoff_table(&table, &r->found);
    tradeoff_csv(&csv, &r->found);
    tradeoff_svg(&svg, &r->found);
    tradeoff_page(&page, &r->found);
    rc = study_write(&r->study, out, "tradeoff.csv", &csv);
    if (rc == OXL_OK) rc = study_write(&r->study, out, "tradeoff.svg", &svg);
    if (rc == OXL_OK) rc = study_write(&r->study, out, "tradeoff.md", &page);
    if (rc == OXL_OK && table.failed) rc = study_fail(&r->study, OXL_ERR_MEMORY, "no memory for the table", "");
    if (rc == OXL_OK)
        fprintf(to, "%s\ntable     %s/tradeoff.csv\ndrawing   %s/tradeoff.svg\npage      %s/tradeoff.md\n", table.data, out, out,
                out);
    free(table.data);
    free(csv.data);
    free(svg.data);
    free(page.data);
    return rc;
}

static oxl_result tradeoff_check(struct tradeoff_run *r)
{
    if (r->found.seeds >= 1 && r->found.seeds <= STUDY_SEEDS) return tradeoff_choose_rows(r);
    snprintf(r->study.error, r->study.error_size, "--seeds: %d seen, 1 to %d wanted", r->found.seeds, STUDY_SEEDS);
    return OXL_ERR_USAGE;
}

static oxl_result tradeoff_sweep(struct tradeoff_run *r, FILE *to)
{
    char       folder[1000];
    oxl_result rc = tradeoff_check(r);
    if (rc == OXL_OK) rc = study_open(&r->study, r->options->out);
    if (rc == OXL_OK) rc = tradeoff_choose_side(r);
    for (int seed = 1; seed <= r->found.seeds && rc == OXL_OK; seed++)
        for (int row = 0; row < r->found.rows && rc == OXL_OK; row++) rc = tradeoff_train(r, row, seed);
    if (rc != OXL_OK) return rc;
    tradeoff_folder(r, 0, 1, folder);
    rc = tradeoff_render(&r->study, &r->base.scene, folder, &r->found);
    return rc == OXL_OK ? tradeoff_report(r, to) : rc;
}

oxl_result tradeoff_run(const tradeoff_options *options, FILE *to, char *error, size_t error_size)
{
    struct tradeoff_run *r = calloc(1, sizeof *r);
    oxl_result           rc;
    if (error_size > 0) error[0] = 0;
    if (!r) return OXL_ERR_MEMORY;
    r->options          = options;
    r->base             = options->job;
    r->begun            = time(NULL);
    r->study.options    = &options->context;
    r->study.callback   = &options->callback;
    r->study.error      = error;
    r->study.error_size = error_size;
    r->found.scene      = options->scene;
    r->found.preset     = options->job.preset;
    r->found.iterations = options->job.train.iterations;
    r->found.threads    = options->context.threads;
    r->found.budget     = options->budget;
    r->found.seeds      = options->seeds;
    rc                  = tradeoff_sweep(r, to);
    oxl_context_free(r->study.ctx);
    free(r);
    return rc;
}
