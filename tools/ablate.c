/* ablate.c - the paper's variants on one survey, with the same seeds and iterations: what each part brings, and costs.
 *
 * Every variant and seed is a job of its own in OUT/NAME-seedS, so an ablation that was stopped goes on where it was, and rows that
 * are finished are not trained again. All seeds' first runs come before all second ones: a slow hour of the machine meets every row.
 *
 * Memory is counted by the allocator that the jobs get, row by row; the process's own peak never falls, and so would say nothing
 * about a row that comes after a larger one. What was counted stands in OUT/NAME-seedS/ablate.json for the runs that resume.
 */
#include "ablate.h"
#include "synth.h" /* synth_file: files appear whole */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define KEEP_ALL 1.0

static const struct ablate_row ABLATE_VARIANTS[ABLATE_ROWS] = {
    /* PSNR, SSIM, Gaussians, bytes, seconds: the paper's ablation table */
    {"3dgs", "3DGS + midpoint", OXL_CUT_MIDPOINT, OXL_UCD_OFF, KEEP_ALL, OXL_DOG_OFF, {22.40, 0.719, 0, 0.670e9, 2587}},
    {"v1", "V1 +BSP", OXL_CUT_BALANCED, OXL_UCD_OFF, KEEP_ALL, OXL_DOG_OFF, {23.05, 0.721, 0, 0.593e9, 1877}},
    {"v2", "V2 +UCD", OXL_CUT_BALANCED, OXL_UCD_ON, KEEP_ALL, OXL_DOG_OFF, {26.36, 0.818, 0, 0.768e9, 2233}},
    {"v3", "V3 +WAP", OXL_CUT_BALANCED, OXL_UCD_ON, 0.5, OXL_DOG_OFF, {26.04, 0.788, 0, 0.242e9, 1530}},
    {"v4", "V4 +DoG on all", OXL_CUT_BALANCED, OXL_UCD_ON, 0.5, OXL_DOG_ALL, {26.26, 0.809, 0, 0.264e9, 2232}},
    {"oceanxl", "OceanXL, selective", OXL_CUT_BALANCED, OXL_UCD_ON, 0.5, OXL_DOG_SELECTIVE, {26.19, 0.797, 0, 0.261e9, 1736}},
    /* beside the paper's: its V3 is 31.5 % of its V2 in size, though it says that half is kept */
    {"v3-315", "V3, keep 0.315", OXL_CUT_BALANCED, OXL_UCD_ON, 0.315, OXL_DOG_OFF, {0}},
    {"auto", "OceanXL, UCD auto", OXL_CUT_BALANCED, OXL_UCD_AUTO, 0.5, OXL_DOG_SELECTIVE, {0}},
};
enum { ABLATE_PAPER_ROWS = 6 };

/* ---------------------------------------------------------------- memory, counted */

struct ablate_meter {
    size_t                     held, peak; /* bytes */
    const oxl_context_options *options;    /* whose log is passed on */
};

struct ablate_head { /* stands before each block, and keeps it aligned to 16 bytes */
    size_t size, unused[16 / sizeof(size_t) - 1];
};

static void *ablate_reallocate(void *user, void *old, size_t size)
{
    struct ablate_meter *meter = user;
    struct ablate_head  *head  = old ? (struct ablate_head *)old - 1 : NULL;
    const size_t         had   = head ? head->size : 0;
    if (size == 0) free(head);
    else head = size > (size_t)-1 - sizeof *head ? NULL : realloc(head, size + sizeof *head);
    if (size > 0 && !head) return NULL;
    meter->held = meter->held - had + size;
    if (meter->held > meter->peak) meter->peak = meter->held;
    if (size == 0) return NULL;
    head->size = size;
    return head + 1;
}

static void ablate_log(void *user, oxl_log_level level, const char *text)
{
    const oxl_context_options *outer = ((struct ablate_meter *)user)->options;
    if (outer->log) outer->log(outer->user, level, text);
}

/* ---------------------------------------------------------------- the run */

struct ablate_run {
    oxl_context          *ctx; /* of its own: its memory is counted */
    const ablate_options *options;
    struct ablate_meter   meter;
    struct ablation       found;
    int                   begun; /* 0: nothing was trained by the job that runs, 1: from its start, 2: from a checkpoint */
    char                 *error;
    size_t                error_size;
};

static oxl_result ablate_fail(struct ablate_run *a, oxl_result rc, const char *what, const char *detail)
{
    snprintf(a->error, a->error_size, "%s%s", what, detail);
    return rc;
}

static const struct ablate_row *ablate_variant(const char *name, size_t length)
{
    for (int i = 0; i < ABLATE_ROWS; i++)
        if (strlen(ABLATE_VARIANTS[i].name) == length && strncmp(ABLATE_VARIANTS[i].name, name, length) == 0)
            return &ABLATE_VARIANTS[i];
    return NULL;
}

static oxl_result ablate_wrong_row(struct ablate_run *a, const char *name, size_t length)
{
    size_t size = (size_t)snprintf(
        a->error, a->error_size, "--rows: '%.*s' seen, each of these at most once wanted:", length > 40 ? 40 : (int)length, name);
    for (int i = 0; i < ABLATE_ROWS && size < a->error_size; i++)
        size += (size_t)snprintf(a->error + size, a->error_size - size, " %s", ABLATE_VARIANTS[i].name);
    return OXL_ERR_USAGE;
}

static oxl_result ablate_choose_rows(struct ablate_run *a)
{
    struct ablation *f = &a->found;
    if (!a->options->rows)
        for (; f->rows < ABLATE_PAPER_ROWS; f->rows++) f->row[f->rows] = &ABLATE_VARIANTS[f->rows];
    for (const char *at = a->options->rows; at; at = strchr(at, ',') ? strchr(at, ',') + 1 : NULL) {
        const size_t             length = strcspn(at, ",");
        const struct ablate_row *row    = ablate_variant(at, length);
        for (int i = 0; i < f->rows; i++)
            if (f->row[i] == row) row = NULL;
        if (!row) return ablate_wrong_row(a, at, length);
        f->row[f->rows++] = row;
    }
    return OXL_OK;
}

static oxl_job_options ablate_job(const ablate_options *options, const struct ablate_row *row, int seed)
{
    oxl_job_options job = options->job;
    job.seed            = (uint64_t)seed;
    job.block           = -1;
    job.partition.cut   = row->cut;
    job.train.ucd.mode  = row->ucd;
    job.train.keep      = (oxl_keep){row->keep < KEEP_ALL ? OXL_KEEP_FRACTION : OXL_KEEP_ALL, row->keep};
    job.train.dog       = row->dog;
    return job;
}

static int ablate_progress(void *user, const oxl_progress *p)
{
    struct ablate_run  *a = user;
    const oxl_callback *c = &a->options->callback;
    if (!a->begun) a->begun = p->iteration <= 1 && p->block == 0 ? 1 : 2;
    return c->progress ? c->progress(c->user, p) : 0;
}

/* ---------------------------------------------------------------- what a job left */

/* In fresh memory; NULL: there is none. */
static char *ablate_read_file(const char *folder, const char *name)
{
    char  path[1024], *text = calloc(1, 65536); /* figures come first, then views in any number */
    FILE *file;
    snprintf(path, sizeof path, "%s/%s", folder, name);
    file = fopen(path, "rb");
    if (file && text) text[fread(text, 1, 65535, file)] = 0;
    if (file) fclose(file);
    else free(text), text = NULL;
    return text;
}

/* The first member of that name; not a number: there is none. In every locale: strtod would follow it. */
static double ablate_number(const char *json, const char *name)
{
    char        quoted[40];
    double      value = 0, unit = 1;
    const char *at;
    int         exponent = 0;
    snprintf(quoted, sizeof quoted, "\"%s\": ", name);
    at = json ? strstr(json, quoted) : NULL;
    if (!at) return NAN;
    at += strlen(quoted);
    if (*at == '-') unit = -1, at++;
    if (*at < '0' || *at > '9') return NAN;
    for (; *at >= '0' && *at <= '9'; at++) value = 10 * value + (*at - '0');
    if (*at == '.')
        for (at++; *at >= '0' && *at <= '9'; at++) value = 10 * value + (*at - '0'), exponent--;
    if (*at == 'e' || *at == 'E') exponent += (int)strtol(at + 1, NULL, 10);
    return unit * (exponent < 0 ? value / pow(10, -exponent) : value * pow(10, exponent));
}

static oxl_result ablate_write(struct ablate_run *a, const char *folder, const char *name, const struct ablate_text *t)
{
    struct synth_file file;
    char              path[1024];
    if (t->failed) return ablate_fail(a, OXL_ERR_MEMORY, "ablate: no memory for ", name);
    snprintf(path, sizeof path, "%s/%s", folder, name);
    synth_file_open(&file, path);
    synth_file_bytes(&file, t->data, t->used);
    return synth_file_close(&file) ? OXL_OK : ablate_fail(a, OXL_ERR_IO, "ablate: cannot write ", path);
}

/* The peak over all the parts in which the job was trained. */
static oxl_result ablate_note_memory(struct ablate_run *a, const char *folder, double *peak)
{
    char              *before = ablate_read_file(folder, "ablate.json");
    struct ablate_text t      = {0};
    oxl_result         rc     = OXL_OK;
    *peak                     = ablate_number(before, "library_peak_bytes");
    free(before);
    if (a->begun == 0) return OXL_OK;
    if (a->begun == 1 || !(*peak > (double)a->meter.peak)) *peak = (double)a->meter.peak;
    ablate_add(&t, "{\n  \"library_peak_bytes\": %s\n}\n", ABLATE_FIXED(*peak, 0));
    rc = ablate_write(a, folder, "ablate.json", &t);
    free(t.data);
    return rc;
}

static oxl_result ablate_read_metrics(struct ablate_run *a, const char *folder, int row, double value[ABLATE_MEASURES])
{
    static const char *const names[ABLATE_MEMORY] = {"psnr", "ssim", "gaussians", "bytes", "seconds"};
    char                    *text                 = ablate_read_file(folder, "metrics.json");
    const double             blocks               = ablate_number(text, "blocks");
    oxl_result               rc                   = OXL_OK;
    for (int m = 0; m < ABLATE_MEMORY; m++) {
        value[m] = ablate_number(text, names[m]);
        if (isnan(value[m]) || isnan(blocks)) rc = OXL_ERR_INPUT;
    }
    if (rc == OXL_OK) {
        a->found.blocks[row] = (int)blocks;
        a->found.held_out    = strstr(text, "\"split\": \"test\"") != NULL;
    } else ablate_fail(a, rc, "ablate: no psnr, ssim, gaussians, bytes, seconds and blocks in metrics.json of ", folder);
    free(text);
    return rc;
}

static oxl_result ablate_train(struct ablate_run *a, int row, int seed)
{
    const struct ablate_row *r        = a->found.row[row];
    const oxl_job_options    job      = ablate_job(a->options, r, seed);
    const oxl_callback       callback = {ablate_progress, a};
    double                  *value    = a->found.value[row][seed - 1];
    char                     folder[1000], line[160];
    oxl_result               rc, noted;
    snprintf(folder, sizeof folder, "%s/%s-seed%d", a->options->out, r->name, seed);
    snprintf(line, sizeof line, "%s, seed %d (row %d of %d, seed %d of %d)", r->label, seed, row + 1, a->found.rows, seed,
             a->found.seeds);
    ablate_log(&a->meter, OXL_LOG_INFO, line);
    a->meter.peak = a->meter.held;
    a->begun      = 0;
    rc            = oxl_job_run(a->ctx, a->options->scene, folder, &job, &callback);
    if (rc != OXL_OK && rc != OXL_ERR_INTERRUPTED) return ablate_fail(a, rc, "", oxl_error_text(a->ctx));
    noted = ablate_note_memory(a, folder, &value[ABLATE_MEMORY]);
    if (rc != OXL_OK || noted != OXL_OK) return rc != OXL_OK ? rc : noted;
    return ablate_read_metrics(a, folder, row, value);
}

/* ---------------------------------------------------------------- all of it */

static oxl_result ablate_check(struct ablate_run *a)
{
    if (strlen(a->options->out) > 900)
        return ablate_fail(a, OXL_ERR_USAGE, "ablate: the name of the folder is too long: ", a->options->out);
    if (a->found.seeds >= 1 && a->found.seeds <= ABLATE_SEEDS) return ablate_choose_rows(a);
    snprintf(a->error, a->error_size, "--seeds: %d seen, 1 to %d wanted", a->found.seeds, ABLATE_SEEDS);
    return OXL_ERR_USAGE;
}

static oxl_result ablate_open(struct ablate_run *a)
{
    oxl_context_options own = a->options->context;
    oxl_result          rc;
    own.reallocate = ablate_reallocate;
    own.log        = ablate_log;
    own.user       = &a->meter;
    rc             = oxl_context_create(&own, &a->ctx);
    if (rc == OXL_OK) rc = oxl_make_folder(a->ctx, a->options->out);
    return rc == OXL_OK ? rc : ablate_fail(a, rc, "ablate: ", oxl_error_text(a->ctx));
}

static oxl_result ablate_report(struct ablate_run *a, FILE *to)
{
    struct ablate_text table = {0}, csv = {0}, svg = {0};
    oxl_result         rc;
    ablate_table(&table, &a->found);
    ablate_csv(&csv, &a->found);
    ablate_svg(&svg, &a->found);
    rc = ablate_write(a, a->options->out, "ablation.csv", &csv);
    if (rc == OXL_OK) rc = ablate_write(a, a->options->out, "ablation.svg", &svg);
    if (rc == OXL_OK && table.failed) rc = ablate_fail(a, OXL_ERR_MEMORY, "ablate: no memory for the table", "");
    if (rc == OXL_OK)
        fprintf(to, "%s\ntable     %s/ablation.csv\ndrawing   %s/ablation.svg\n", table.data, a->options->out, a->options->out);
    free(table.data);
    free(csv.data);
    free(svg.data);
    return rc;
}

oxl_result ablate_run(const ablate_options *options, FILE *to, char *error, size_t error_size)
{
    struct ablate_run *a  = calloc(1, sizeof *a);
    oxl_result         rc = a ? OXL_OK : OXL_ERR_MEMORY;
    if (error_size > 0) error[0] = 0;
    if (!a) return rc;
    *a = (struct ablate_run){
        .options = options, .meter = {.options = &options->context}, .error = error, .error_size = error_size};
    a->found.scene      = options->scene;
    a->found.iterations = options->job.train.iterations;
    a->found.sh_degree  = options->job.train.sh_degree;
    a->found.seeds      = options->seeds;
    rc                  = ablate_check(a);
    if (rc == OXL_OK) rc = ablate_open(a);
    for (int seed = 1; seed <= options->seeds && rc == OXL_OK; seed++)
        for (int row = 0; row < a->found.rows && rc == OXL_OK; row++) rc = ablate_train(a, row, seed);
    if (rc == OXL_OK) rc = ablate_report(a, to);
    oxl_context_free(a->ctx);
    free(a);
    return rc;
}
