/* job_result.c - writes the result of a job: the model in its files, metrics.json, run.json, renders.
 *
 * Invariant: run.json says "finished": true after everything else is in place.
 */
#include "job.h"
#include "../formats/formats.h"
#include "../evaluate/evaluate.h"
#include "../render/render.h"
#include "../survey/scene.h"
#include "../model/model.h"
#include "../large/os_job.h"

#define JOB_UNSHOWN 0.02 /* Logs shown_psnr from this mean share of unshown pixels on. */

/* ---------------- models */

/* Reads what the training of the one block, or of the merged model, has left. */
static oxl_result job_read_result(struct job *job, oxl_trained *out)
{
    const int one = job->partition.block_count == 1 ? 0 : JOB_MERGED_MODEL;
    const char *folder = JOB_BLOCK(job, one), *viewer = PATH(folder, "model_standard.ply");
    oxl_result rc = job_read_model(job, one, &out->model);
    if (rc == OXL_OK && os_is_file(viewer)) rc = oxl_model_read(job->ctx, viewer, &out->viewer);
    imaging_free(job->ctx, &job->imaging);
    if (rc == OXL_OK)
        rc = imaging_read_beside(job->ctx, PATH(folder, "model.ply"), job->scene, &job->imaging);
    out->imaging = &job->imaging; /* borrowed */
    if (rc == OXL_OK && out->model.count == 0)
        rc = oxl_fail(job->ctx, OXL_ERR_FAILED,
                      "no Gaussian is left in %s\nfix: run oceanxl check, which examines cameras, points "
                      "and images",
                      job->out);
    return rc;
}

static size_t job_bytes_of(const struct job *job, const char *name)
{
    uint64_t size = 0;
    os_kind_of(PATH(job->out, "%s", name), &size);
    return (size_t)size;
}

/* ---------------- metrics */

oxl_result oxl_metrics_to_json(oxl_context *ctx, const oxl_scene *scene, const oxl_metrics *metrics,
                               char **out)
{
    struct text t = {.ctx = ctx};
    oxl_result rc = OXL_OK;
    *out = NULL;
    text_add(&t, "{\n");
    rc = metrics_json_add(&t, scene, metrics);
    text_add(&t, "}\n");
    if (rc == OXL_OK) rc = text_take(&t, out);
    text_free(&t);
    return rc;
}

static oxl_split job_evaluated_split(const struct job *job)
{
    return job->survey.test_views > 0 ? OXL_SPLIT_TEST : OXL_SPLIT_TRAIN;
}

/* Evaluates what viewers without second lobes and imaging show, where training has made a model for them; *m
 * gets its PSNR at mean exposure. */
static oxl_result job_add_viewer(struct job *job, struct text *t, const oxl_trained *trained, oxl_metrics *m)
{
    struct oxl_imaging seen = job->imaging; /* borrows its arrays */
    const int hides = trained_hides(trained);
    const char *name = hides ? "scene.ply" : "scene_standard.ply";
    oxl_metrics plain;
    oxl_result rc;
    if (!trained->viewer.count) return OXL_OK;
    imaging_hide(&seen, hides);
    rc = evaluate_part(job->ctx, &(struct drawn){NULL, &trained->viewer, job->scene, &seen},
                       job_evaluated_split(job), 0, &plain);
    if (rc != OXL_OK) return rc;
    oxl_log(job->ctx, OXL_LOG_INFO,
            "viewers      other viewers show %s without imaging.txt: PSNR %.2f dB (%+.2f dB)", name,
            plain.psnr, plain.psnr - m->psnr);
    for (int i = 0; i < m->count && i < plain.count && hides; i++)
        m->views[i].plain_psnr = plain.views[i].plain_psnr;
    if (hides) m->plain_psnr = plain.plain_psnr;
    text_add(t, "  \"standard\": {\"psnr\": %s, \"ssim\": %s, \"psnr_lost\": %s, \"bytes\": %zu},\n",
             NUMBER(plain.psnr), NUMBER(plain.ssim), NUMBER(m->psnr - plain.psnr), job_bytes_of(job, name));
    oxl_metrics_free(job->ctx, &plain);
    return OXL_OK;
}

static void job_add_figures(struct job *job, struct text *t, const oxl_model *model, size_t bytes)
{
    double *number = job->total.number;
    text_add(t, "{\n  \"split\": \"%s\",\n", job_evaluated_split(job) == OXL_SPLIT_TEST ? "test" : "train");
    text_add_member(t, "gaussians", (double)model->count);
    text_add_member(t, "lobes", (double)model->lobes);
    text_add_member(t, "sh_degree", model->sh_degree);
    text_add_member(t, "bytes", (double)bytes);
    text_add_member(t, "blocks", job->partition.block_count);
    text_add_member(t, "iterations", number[BLOCK_ITERATIONS]);
    number[BLOCK_PEAK] = OXL_MAX(number[BLOCK_PEAK], (double)os_peak_rss());
    block_add_numbers(t, &job->total, BLOCK_SECONDS);
}

static void job_log_metrics(struct job *job, const oxl_metrics *m, size_t gaussians, size_t bytes)
{
    if (m->count == 0)
        oxl_log(job->ctx, OXL_LOG_WARNING, "no view could be evaluated, so there are no metrics");
    else
        oxl_log(
            job->ctx, OXL_LOG_INFO,
            "metrics      %s views: PSNR %.2f dB, SSIM %.3f, structure %.3f, means over %d views; %zu Gaussians, %.1f MB",
            job_evaluated_split(job) == OXL_SPLIT_TEST ? "held-out test" : "training", m->psnr, m->ssim,
            m->structure, m->count, gaussians, (double)bytes / 1e6);
    if (m->unshown >= JOB_UNSHOWN)
        oxl_log(
            job->ctx, OXL_LOG_INFO,
            "shown        PSNR %.2f dB without the %.0f %% of the pixels whose place no training view shows",
            m->shown_psnr, 100 * m->unshown);
    if (!isnan(m->aligned_psnr))
        oxl_log(job->ctx, OXL_LOG_INFO,
                "refined      PSNR %.2f dB, SSIM %.3f if the poses of held-out views are refined, too",
                m->aligned_psnr, m->aligned_ssim);
}

static oxl_result job_write_metrics(struct job *job, const oxl_trained *trained)
{
    const oxl_model *model = &trained->model;
    const oxl_split split = job_evaluated_split(job);
    const size_t bytes = job_bytes_of(job, trained_hides(trained) ? "scene_clear.ply" : "scene.ply");
    oxl_metrics m = {0};
    struct text t = {.ctx = job->ctx};
    oxl_result rc = oxl_evaluate(job->ctx, model, job->scene, &job->imaging, split, &m);
    if (rc == OXL_OK) job_log_metrics(job, &m, model->count, bytes);
    job_add_figures(job, &t, model, bytes);
    if (rc == OXL_OK) rc = job_add_viewer(job, &t, trained, &m);
    if (rc == OXL_OK)
        rc = training_views_check(job->ctx, model, job->scene, &job->imaging,
                                  (int)job->total.number[BLOCK_ITERATIONS],
                                  split == OXL_SPLIT_TRAIN ? &m : NULL, &t,
                                  job->options.renders ? PATH(job->out, "training_views") : NULL);
    if (rc == OXL_OK) rc = metrics_json_add(&t, job->scene, &m);
    text_add(&t, "}\n");
    if (rc == OXL_OK) rc = os_write_text(job->ctx, PATH(job->out, "metrics.json"), &t);
    oxl_metrics_free(job->ctx, &m);
    text_free(&t);
    return rc;
}

/* ---------------- run.json */

static void job_add_partition_decision(const struct job *job, struct text *t)
{
    const struct partition *p = &job->partition;
    const double ratio = p->extent[1] > 0 ? p->extent[2] / p->extent[1] : 0;
    text_add(
        t,
        "\"partition\": {\"chosen\": \"%s\", \"blocks\": %d, \"evidence\": \"%zu points; their smallest extent is %s of the second%s\"}",
        p->block_count == 1  ? "none"
        : p->dimensions == 2 ? "2d"
                             : "3d",
        p->block_count, job->survey.points, NUMBER(floor(ratio * 1e3 + 0.5) / 1e3),
        job->options.partition.kind == OXL_PARTITION_AUTO ? "" : "; as set");
}

/* Adds the decisions and their evidence, block by block. */
static oxl_result job_add_decisions(struct job *job, struct text *t)
{
    oxl_result rc = OXL_OK;
    text_add(t, "  \"decisions\": {");
    job_add_partition_decision(job, t);
    for (int k = 0; k < 2 && job->partition.block_count > 1 && rc == OXL_OK; k++) {
        text_add(t, k ? ", \"merged\": {" : ", \"coarse\": {");
        rc = block_read_member(job->ctx, JOB_BLOCK(job, k ? JOB_MERGED_MODEL : JOB_COARSE_MODEL), "decisions",
                               t);
        text_add(t, "}");
    }
    text_add(t, ", \"blocks\": [");
    for (int k = 0; k < job->partition.block_count && rc == OXL_OK; k++) {
        text_add(t, k > 0 ? ", {" : "{");
        rc = block_read_member(job->ctx, JOB_BLOCK(job, k), "decisions", t);
        text_add(t, "}");
    }
    text_add(t, "]},\n");
    return rc;
}

OXL_INTERNAL oxl_result job_write_run(struct job *job, int finished)
{
    struct text t = {.ctx = job->ctx};
    oxl_result rc = OXL_OK;
    text_add(
        &t,
        "{\n  \"oceanxl\": \"%s\",\n  \"finished\": %s,\n  \"threads\": %d,\n  \"instructions\": \"%s\",\n",
        OXL_VERSION, finished ? "true" : "false", job->ctx->threads, oxl_isa_name(job->ctx));
    text_add(&t, "  \"backend\": ");
    text_add_json_string(&t, oxl_backend_name(job->ctx));
    text_add(&t, ",\n  \"preset\": ");
    text_add_json_string(&t, job->options.preset ? job->options.preset : "");
    text_add(
        &t,
        ",\n  \"iterations_done\": %.0f,\n  \"blocks\": %d,\n  \"memory\": %.0f,\n  \"origin\": [%s, %s, %s],\n  %s,\n  %s,\n",
        job->total.number[BLOCK_ITERATIONS], job->partition.block_count, job->partition.memory,
        NUMBER(job->origin[0]), NUMBER(job->origin[1]), NUMBER(job->origin[2]), job->inputs.data,
        job->key.data);
    if (finished) rc = job_add_decisions(job, &t);
    text_add(&t, "  \"survey\": ");
    survey_add_json(&t, &job->survey, "  ");
    text_add(&t, ",\n  \"notes\": [%s]\n}\n", job->notes.size ? job->notes.data : "");
    t.failed |= job->notes.failed;
    if (rc == OXL_OK) rc = os_write_text(job->ctx, PATH(job->out, "run.json"), &t);
    text_free(&t);
    return rc;
}

/* ---------------- files */

static oxl_result job_render_views(struct job *job, const oxl_model *model)
{
    const oxl_render_output what = {.split = job_evaluated_split(job), .images = 1, .replace = 1};
    int rendered;
    return oxl_render_views(job->ctx, model, job->scene, &job->imaging, &what, PATH(job->out, "renders"),
                            &rendered);
}

/* Writes the result; see job.h. run.json comes last, so that it never says "finished" before
 * the other files are there. */
OXL_INTERNAL oxl_result job_finish(struct job *job, int evaluate)
{
    oxl_trained t = {.finished = 0};
    oxl_result rc = job_read_result(job, &t);
    if (rc == OXL_OK) rc = oxl_trained_write(job->ctx, job->out, job->scene, &t);
    if (rc == OXL_OK && evaluate) rc = job_write_metrics(job, &t);
    if (rc == OXL_OK && evaluate && job->options.renders) rc = job_render_views(job, &t.model);
    if (rc == OXL_OK) rc = job_write_run(job, !job->unfinished);
    if (rc == OXL_OK && !job->unfinished) job_remove_decoded(job);
    oxl_model_free(job->ctx, &t.model);
    oxl_model_free(job->ctx, &t.viewer);
    return rc;
}
