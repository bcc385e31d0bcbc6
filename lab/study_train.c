/* study_train.c - one training of a study, in a folder of its own, so that a stopped study resumes.
 *
 * Memory is what the library held at its peak: the process's own peak never falls and is useless after a
 * larger training.
 * Counts are kept in the folder's study.json for resumed runs.
 */
#include "study.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

oxl_result study_write(oxl_context *ctx, const char *folder, const char *name, struct output *t)
{
    const int no_memory = t->failed;
    char path[1024];
    snprintf(path, sizeof path, "%s/%s", folder, name);
    if (output_save(t, path)) return OXL_OK;
    if (no_memory) return oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for %s", name);
    return oxl_fail(
        ctx, OXL_ERR_IO,
        "a file cannot be written\nfix: free space on the disk or choose a place that you may use: %s", path);
}

/* ---------------- one training */

static double study_cpu(void)
{
    return (double)clock() / CLOCKS_PER_SEC;
}

static int study_progress(void *user, const oxl_progress *p)
{
    struct study_meter *s = user;
    const oxl_callback *c = &s->options->callback;
    if (!s->started) {
        const enum oxl_stage first = p->blocks > 1 ? OXL_STAGE_COARSE : OXL_STAGE_BLOCK;
        s->started = p->iteration <= 1 && p->stage == first && p->block == 0 ? 1 : 2;
        s->cpu_at = study_cpu();
    }
    s->cpu = study_cpu() - s->cpu_at;
    return c->progress ? c->progress(c->user, p) : 0;
}

/* Memory: the peak over all the parts in which it was trained; CPU time: their sum. */
static oxl_result study_record_cost(struct study_meter *s, const char *folder, double value[STUDY_MEASURES])
{
    const double peak = (double)s->options->memory->peak;
    char *before = output_read(folder, "study.json", NULL);
    struct output t = {0};
    value[STUDY_MEMORY] = oxl_json_number(before, "library_peak_bytes");
    value[STUDY_CPU] = oxl_json_number(before, "cpu_seconds");
    free(before);
    if (s->started == 0) return OXL_OK;
    if (s->started == 1 || !(value[STUDY_MEMORY] > peak)) value[STUDY_MEMORY] = peak;
    value[STUDY_CPU] = s->started == 1 ? s->cpu : value[STUDY_CPU] + s->cpu;
    output_add(&t, "{\n  \"library_peak_bytes\": %.0f", value[STUDY_MEMORY]);
    if (!isnan(value[STUDY_CPU])) output_add(&t, ",\n  \"cpu_seconds\": %.2f", value[STUDY_CPU]);
    output_add(&t, "\n}\n");
    return study_write(s->ctx, folder, "study.json", &t);
}

static oxl_result study_read_metrics(struct study_meter *s, const char *folder, struct study_result *r)
{
    static const struct {
        enum study_measure measure;
        const char *name;
        int missing; /* it may be: no point lies in that third of depth (1), no --lpips or images without detail (2) */
    } fields[] = {
        {STUDY_PSNR, "psnr", 0},      {STUDY_SSIM, "ssim", 0},           {STUDY_MS_SSIM, "ms_ssim", 0},
        {STUDY_NEAR, "near_psnr", 1}, {STUDY_MIDDLE, "mid_psnr", 1},     {STUDY_FAR, "far_psnr", 1},
        {STUDY_BYTES, "bytes", 0},    {STUDY_GAUSSIANS, "gaussians", 0}, {STUDY_SECONDS, "seconds", 0},
        {STUDY_LPIPS, "lpips", 2},    {STUDY_STRUCTURE, "structure", 2}};
    char *text = output_read(folder, "metrics.json", NULL);
    const double blocks = oxl_json_number(text, "blocks");
    int whole = !isnan(blocks);
    for (size_t i = 0; i < sizeof fields / sizeof *fields; i++) {
        const double value = oxl_json_number(
            fields[i].missing == 1 ? oxl_json_member(text, "by_depth") : text, fields[i].name);
        r->value[fields[i].measure] = value;
        whole = whole && (fields[i].missing || !isnan(value));
    }
    r->value[STUDY_LEAST] = fmin(oxl_json_number(text, "structure_least"),
                                 oxl_json_number(oxl_json_member(text, "training"), "structure_least"));
    r->blocks = whole ? (int)blocks : 0;
    r->held_out = text && strstr(text, "\"split\": \"test\"") != NULL;
    free(text);
    if (whole) return OXL_OK;
    return oxl_fail(
        s->ctx, OXL_ERR_INPUT,
        "no whole metrics.json of a training\nfix: remove this folder and run the command again: %s", folder);
}

oxl_result study_train(struct study_meter *s, const char *folder, const oxl_job_options *job,
                       struct study_result *out)
{
    const oxl_callback callback = {study_progress, s};
    oxl_result rc, noted;
    *out = (struct study_result){.blocks = 0};
    s->options->memory->peak = s->options->memory->used;
    s->started = 0;
    rc = oxl_job_run(s->ctx, s->options->scene, folder, job, &callback);
    if (rc != OXL_OK && rc != OXL_ERR_INTERRUPTED) return rc;
    noted = study_record_cost(s, folder, out->value);
    if (rc != OXL_OK || noted != OXL_OK) return rc != OXL_OK ? rc : noted;
    return study_read_metrics(s, folder, out);
}
