/* ablate.c - the paper's variants on one survey, with the same seeds and iterations: what each part brings, and costs.
 *
 * Every variant and seed is a job of its own in OUT/NAME-seedS, so an ablation that was stopped goes on where it was, and rows that
 * are finished are not trained again. All seeds' first runs come before all second ones: a slow hour of the machine meets every row.
 */
#include "ablate.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define KEEP_ALL 1.0

static const struct ablate_row ABLATE_VARIANTS[ABLATE_ROWS] = {
    /* PSNR, SSIM, PSNR far, Gaussians, bytes, seconds: the paper's ablation table */
    {"3dgs", "3DGS + midpoint", OXL_CUT_MIDPOINT, OXL_UCD_OFF, KEEP_ALL, OXL_DOG_OFF, {22.40, 0.719, 0, 0, 0.670e9, 2587}},
    {"v1", "V1 +BSP", OXL_CUT_BALANCED, OXL_UCD_OFF, KEEP_ALL, OXL_DOG_OFF, {23.05, 0.721, 0, 0, 0.593e9, 1877}},
    {"v2", "V2 +UCD", OXL_CUT_BALANCED, OXL_UCD_ON, KEEP_ALL, OXL_DOG_OFF, {26.36, 0.818, 0, 0, 0.768e9, 2233}},
    {"v3", "V3 +WAP", OXL_CUT_BALANCED, OXL_UCD_ON, 0.5, OXL_DOG_OFF, {26.04, 0.788, 0, 0, 0.242e9, 1530}},
    {"v4", "V4 +DoG on all", OXL_CUT_BALANCED, OXL_UCD_ON, 0.5, OXL_DOG_ALL, {26.26, 0.809, 0, 0, 0.264e9, 2232}},
    {"oceanxl", "OceanXL, selective", OXL_CUT_BALANCED, OXL_UCD_ON, 0.5, OXL_DOG_SELECTIVE, {26.19, 0.797, 0, 0, 0.261e9, 1736}},
    /* beside the paper's: its V3 is 31.5 % of its V2 in size, though it says that half is kept */
    {"v3-315", "V3, keep 0.315", OXL_CUT_BALANCED, OXL_UCD_ON, 0.315, OXL_DOG_OFF, {0}},
    {"auto", "OceanXL, UCD auto", OXL_CUT_BALANCED, OXL_UCD_AUTO, 0.5, OXL_DOG_SELECTIVE, {0}},
};
enum { ABLATE_PAPER_ROWS = 6 };

/* ---------------------------------------------------------------- the run */

struct ablate_run {
    struct study          study;
    const ablate_options *options;
    struct ablation       found;
};

static const struct ablate_row *ablate_variant(const char *name, size_t length)
{
    for (int i = 0; i < ABLATE_ROWS; i++)
        if (strlen(ABLATE_VARIANTS[i].name) == length && strncmp(ABLATE_VARIANTS[i].name, name, length) == 0)
            return &ABLATE_VARIANTS[i];
    return NULL;
}

static oxl_result ablate_wrong_row(struct ablate_run *a, const char *name, size_t length)
{
    size_t size =
        (size_t)snprintf(a->study.error, a->study.error_size,
                         "--rows: '%.*s' seen, each of these at most once wanted:", length > 40 ? 40 : (int)length, name);
    for (int i = 0; i < ABLATE_ROWS && size < a->study.error_size; i++)
        size += (size_t)snprintf(a->study.error + size, a->study.error_size - size, " %s", ABLATE_VARIANTS[i].name);
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

/* The same for every row, or their bytes would not compare. */
static int ablate_degree(const ablate_options *options)
{
    return options->job.train.sh_degree < 0 ? 3 : options->job.train.sh_degree;
}

static oxl_job_options ablate_job(const ablate_options *options, const struct ablate_row *row, int seed)
{
    oxl_job_options job = options->job;
    job.seed            = (uint64_t)seed;
    job.block           = -1;
    job.partition.cut   = row->cut;
    job.train.sh_degree = ablate_degree(options);
    job.train.ucd.mode  = row->ucd;
    job.train.keep      = (oxl_keep){row->keep < KEEP_ALL ? OXL_KEEP_FRACTION : OXL_KEEP_ALL, row->keep};
    job.train.dog       = row->dog;
    return job;
}

static oxl_result ablate_train(struct ablate_run *a, int row, int seed)
{
    const struct ablate_row *r   = a->found.row[row];
    const oxl_job_options    job = ablate_job(a->options, r, seed);
    struct study_result      got;
    char                     folder[1000], line[160];
    oxl_result               rc;
    snprintf(folder, sizeof folder, "%s/%s-seed%d", a->options->out, r->name, seed);
    snprintf(line, sizeof line, "%s, seed %d (row %d of %d, seed %d of %d)", r->label, seed, row + 1, a->found.rows, seed,
             a->found.seeds);
    study_log(&a->study, line);
    rc = study_train(&a->study, a->options->scene, folder, &job, &got);
    if (rc != OXL_OK) return rc;
    a->found.blocks[row] = (int)got.blocks;
    a->found.held_out    = got.held_out;
    memcpy(a->found.value[row][seed - 1],
           (double[ABLATE_MEASURES]){got.psnr, got.ssim, got.far, got.gaussians, got.bytes, got.seconds, got.memory},
           sizeof a->found.value[row][seed - 1]);
    return OXL_OK;
}

/* ---------------------------------------------------------------- all of it */

static oxl_result ablate_check(struct ablate_run *a)
{
    if (a->found.seeds >= 1 && a->found.seeds <= STUDY_SEEDS) return ablate_choose_rows(a);
    snprintf(a->study.error, a->study.error_size, "--seeds: %d seen, 1 to %d wanted", a->found.seeds, STUDY_SEEDS);
    return OXL_ERR_USAGE;
}

static oxl_result ablate_report(struct ablate_run *a, FILE *to)
{
    struct study_text table = {0}, csv = {0}, svg = {0};
    oxl_result        rc;
    ablate_table(&table, &a->found);
    ablate_csv(&csv, &a->found);
    ablate_svg(&svg, &a->found);
    rc = study_write(&a->study, a->options->out, "ablation.csv", &csv);
    if (rc == OXL_OK) rc = study_write(&a->study, a->options->out, "ablation.svg", &svg);
    if (rc == OXL_OK && table.failed) rc = study_fail(&a->study, OXL_ERR_MEMORY, "ablate: no memory for the table", "");
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
        .options = options,
        .study   = {.options = &options->context, .callback = &options->callback, .error = error, .error_size = error_size}};
    a->found.scene      = options->scene;
    a->found.iterations = options->job.train.iterations;
    a->found.sh_degree  = ablate_degree(options);
    a->found.seeds      = options->seeds;
    rc                  = ablate_check(a);
    if (rc == OXL_OK) rc = study_open(&a->study, options->out);
    for (int seed = 1; seed <= options->seeds && rc == OXL_OK; seed++)
        for (int row = 0; row < a->found.rows && rc == OXL_OK; row++) rc = ablate_train(a, row, seed);
    if (rc == OXL_OK) rc = ablate_report(a, to);
    oxl_context_free(a->study.ctx);
    free(a);
    return rc;
}
