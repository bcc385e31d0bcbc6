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

#define JOB_EXPOSURE 0.5 /* Logs cc_psnr from this difference (dB) to PSNR on. */

/* ---------------- models */

/* Returns the one block, or the merged model. */
static int job_last_block(const struct job *job)
{
    return job->partition.block_count == 1 ? 0 : JOB_MERGED_MODEL;
}

/* Reads the model of the one block, or the merged model, and its imaging. */
static oxl_result job_final_model(struct job *job, int standard, oxl_model *out)
{
    const int one = job_last_block(job);
    oxl_result rc = job_read_model(job, one, standard, out);
    imaging_free(job->ctx, &job->imaging);
    if (rc == OXL_OK)
        rc = imaging_read_beside(job->ctx, PATH(JOB_BLOCK(job, one), "model.ply"), job->scene, &job->imaging);
    if (rc == OXL_OK && out->count == 0)
        rc = oxl_fail(job->ctx, OXL_ERR_FAILED,
                      "no Gaussian is left in %s\nfix: oceanxl check looks at cameras, points and images",
                      job->out);
    return rc;
}

/* Returns 1 if scene.ply is a model for viewers: if a medium lies between the model's colours and the images,
 * or gains do and the training of a model without them was finished. */
static int job_hides(const struct job *job)
{
    if (imaging_alters_colours(&job->imaging)) return 1;
    return imaging_is_gains_alone(&job->imaging) && !job->unfinished &&
           os_is_file(PATH(JOB_BLOCK(job, job_last_block(job)), "model_standard.ply"));
}

/* Sets the view with which viewers begin: that of the training view nearest to the cameras' centre. */
static void job_choose_view(const oxl_scene *scene, oxl_model *model)
{
    const int views = oxl_scene_view_count(scene);
    double centre[3] = {0, 0, 0}, eye[3], nearest = HUGE_VAL;
    int training = 0;
    for (int v = 0; v < views; v++) {
        if (oxl_scene_view(scene, v)->is_test) continue;
        camera_position(&oxl_scene_view(scene, v)->camera, eye);
        training++;
        for (int k = 0; k < 3; k++) centre[k] += (eye[k] - centre[k]) / training;
    }
    for (int v = 0; v < views; v++) {
        const oxl_camera *c = &oxl_scene_view(scene, v)->camera;
        double far = 0;
        if (oxl_scene_view(scene, v)->is_test) continue;
        camera_position(c, eye);
        for (int k = 0; k < 3; k++) far += (eye[k] - centre[k]) * (eye[k] - centre[k]);
        if (!(far < nearest)) continue;
        nearest = far;
        model->view[0] = c->fx / OXL_MAX(c->width, c->height);
        memcpy(model->view + 1, c->rotation, sizeof c->rotation);
        for (int k = 0; k < 3; k++) model->view[10 + k] = eye[k] + oxl_scene_origin(scene)[k];
    }
}

static oxl_result job_write_ply(struct job *job, const char *name, const oxl_model *model, int degree,
                                size_t *bytes)
{
    struct os_reader file = {0};
    const char *path = PATH(job->out, "%s", name);
    oxl_model seen = *model;
    oxl_result rc = OXL_OK;
    job_choose_view(job->scene, &seen);
    rc = model_file_write_ply(job->ctx, path, &seen, degree);
    if (rc == OXL_OK) rc = os_reader_open(job->ctx, path, &file);
    *bytes = (size_t)file.size;
    os_reader_close(&file);
    return rc;
}

/* Makes the model without second lobes and medium; in an unfinished run it is not refined. */
static oxl_result job_make_standard(struct job *job, oxl_model *out)
{
    const int made = !job->unfinished && (job->result.lobes > 0 || job_hides(job));
    oxl_result rc = made ? job_final_model(job, 1, out) : model_copy(job->ctx, &job->result, out);
    if (rc == OXL_OK && !made) medium_make_standard(job->scene, &job->imaging, 0, out);
    else model_drop_lobes(out);
    return rc;
}

/* Writes scene.ply: the model with its SH degree and lobes, or with a medium the standard model;
 * scene_clear.ply then has the former. Writes scene_standard.ply unless scene.ply has the standard columns
 * already. bytes: of the file that the metrics are of, and of the standard model's. */
static oxl_result job_write_models(struct job *job, oxl_model *standard, size_t bytes[2])
{
    const int hides = job_hides(job),
              is_standard = job->result.sh_degree == 3 && (hides || job->result.lobes == 0);
    const oxl_model *shown = hides ? standard : &job->result;
    oxl_result rc = hides || !is_standard ? job_make_standard(job, standard) : OXL_OK;
    size_t full = 0;
    bytes[0] = bytes[1] = 0;
    if (rc == OXL_OK) rc = job_write_ply(job, "scene.ply", shown, shown->sh_degree, &bytes[hides]);
    if (rc == OXL_OK && hides)
        rc = job_write_ply(job, "scene_clear.ply", &job->result, job->result.sh_degree, &bytes[0]);
    else os_remove(PATH(job->out, "scene_clear.ply"));
    if (is_standard) os_remove(PATH(job->out, "scene_standard.ply"));
    if (rc == OXL_OK && !is_standard) rc = job_write_ply(job, "scene_standard.ply", standard, 3, &full);
    if (!hides) bytes[1] = is_standard ? bytes[0] : full;
    return rc;
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

/* Evaluates the image of a viewer without second lobes and medium; *m gets its PSNR at mean exposure. */
static oxl_result job_add_standard(struct job *job, struct text *t, const oxl_model *standard, size_t bytes,
                                   oxl_metrics *m)
{
    struct oxl_imaging seen = job->imaging; /* borrows its arrays */
    const int hides = job_hides(job);
    oxl_metrics plain;
    oxl_result rc;
    if (job->result.lobes == 0 && !hides) return OXL_OK;
    imaging_hide(&seen, hides);
    rc = evaluate_shown(job->ctx, standard, job->scene, &seen, job_evaluated_split(job), &plain);
    if (rc != OXL_OK) return rc;
    oxl_log(job->ctx, OXL_LOG_INFO,
            "%s in any viewer: PSNR %.2f dB (%+.2f against this model), %.2f at mean exposure",
            hides ? "scene.ply" : "scene_standard.ply", plain.psnr, plain.psnr - m->psnr, plain.plain_psnr);
    for (int i = 0; i < m->count && i < plain.count && hides; i++)
        m->views[i].plain_psnr = plain.views[i].plain_psnr;
    if (hides) m->plain_psnr = plain.plain_psnr;
    text_add(t, "  \"standard\": {\"psnr\": %s, \"ssim\": %s, \"psnr_lost\": %s, \"bytes\": %zu},\n",
             NUMBER(plain.psnr), NUMBER(plain.ssim), NUMBER(m->psnr - plain.psnr), bytes);
    oxl_metrics_free(job->ctx, &plain);
    return OXL_OK;
}

static void job_add_figures(struct job *job, struct text *t, size_t bytes)
{
    text_add(t, "{\n  \"split\": \"%s\",\n", job_evaluated_split(job) == OXL_SPLIT_TEST ? "test" : "train");
    text_add_member(t, "gaussians", (double)job->result.count);
    text_add_member(t, "lobes", (double)job->result.lobes);
    text_add_member(t, "sh_degree", job->result.sh_degree);
    text_add_member(t, "bytes", (double)bytes);
    text_add_member(t, "blocks", job->partition.block_count);
    text_add_member(t, "iterations", job->total.iterations);
    text_add_member(t, "seconds", job->total.seconds);
    text_add_member(t, "peak_rss_bytes", OXL_MAX(job->total.peak, (double)os_peak_rss()));
    text_add_member(t, "predicted_memory_bytes", job->total.predicted_peak);
    nonfinite_add_json(t, &job->total.nonfinite);
}

static oxl_result job_write_metrics(struct job *job, const oxl_model *standard, const size_t bytes[2])
{
    oxl_metrics m = {0};
    struct text t = {.ctx = job->ctx};
    oxl_result rc =
        oxl_evaluate(job->ctx, &job->result, job->scene, &job->imaging, job_evaluated_split(job), &m);
    if (rc != OXL_OK) goto done;
    if (m.count == 0)
        oxl_log(job->ctx, OXL_LOG_WARNING, "no view could be evaluated, so there are no metrics");
    else
        oxl_log(
            job->ctx, OXL_LOG_INFO,
            "%s views: PSNR %.2f dB, SSIM %.4f, structure %.3f, at least %.3f, over %d; %zu Gaussians, %.1f MB",
            job_evaluated_split(job) == OXL_SPLIT_TEST ? "test" : "training", m.psnr, m.ssim, m.structure,
            m.structure_least, m.count, job->result.count, (double)bytes[0] / 1e6);
    if (!isnan(m.aligned_psnr))
        oxl_log(job->ctx, OXL_LOG_INFO,
                "test views moved onto their images, as poses were refined: PSNR %.2f dB, SSIM %.4f",
                m.aligned_psnr, m.aligned_ssim);
    if (m.cc_psnr > m.psnr + JOB_EXPOSURE)
        oxl_log(
            job->ctx, OXL_LOG_INFO,
            "PSNR is %.2f dB after a factor per channel and view (cc_psnr): exposure may differ between views",
            m.cc_psnr);
    job_add_figures(job, &t, bytes[0]);
    rc = job_add_standard(job, &t, standard, bytes[1], &m);
    if (rc != OXL_OK) goto done;
    rc = training_views_check(job->ctx, &job->result, job->scene, &job->imaging, job->total.iterations,
                              job_evaluated_split(job) == OXL_SPLIT_TRAIN ? &m : NULL, &t,
                              job->options.renders ? PATH(job->out, "training_views") : NULL);
    if (rc != OXL_OK) goto done;
    rc = metrics_json_add(&t, job->scene, &m);
    text_add(&t, "}\n");
    if (rc == OXL_OK) rc = job_write(job, "metrics.json", &t);
done:
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
        "\"partition\": {\"chosen\": \"%s\", \"blocks\": %d, \"memory\": %.0f, \"evidence\": \"%zu points; l3/l2 = %s%s\"}",
        p->block_count == 1  ? "none"
        : p->dimensions == 2 ? "2d"
                             : "3d",
        p->block_count, p->memory, job->survey.points, NUMBER(floor(ratio * 1e3 + 0.5) / 1e3),
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
        const char *folder = JOB_BLOCK(job, k);
        text_add(t, k > 0 ? ", {" : "{");
        rc = block_read_member(job->ctx, folder, "decisions", t);
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
        ",\n  \"iterations_done\": %d,\n  \"blocks\": %d,\n  \"origin\": [%s, %s, %s],\n  %s,\n  %s,\n  %s,\n",
        job->total.iterations, job->partition.block_count, NUMBER(job->origin[0]), NUMBER(job->origin[1]),
        NUMBER(job->origin[2]), job->inputs.data, job->line.data, job->found.data);
    if (finished) rc = job_add_decisions(job, &t);
    text_add(&t, "  \"survey\": ");
    survey_add_json(&t, &job->survey, "  ");
    text_add(&t, ",\n  \"notes\": [%s]\n}\n", job->notes.size ? job->notes.data : "");
    t.failed |= job->notes.failed;
    if (rc == OXL_OK) rc = job_write(job, "run.json", &t);
    text_free(&t);
    return rc;
}

/* ---------------- files */

static oxl_result job_render_views(struct job *job)
{
    const oxl_render_output what = {.split = job_evaluated_split(job), .images = 1, .replace = 1};
    int rendered;
    return oxl_render_views(job->ctx, &job->result, job->scene, &job->imaging, &what,
                            PATH(job->out, "renders"), &rendered);
}

/* Writes imaging.txt beside scene.ply, or removes it if the run has no imaging. */
static oxl_result job_write_gains(struct job *job)
{
    const char *path = PATH(job->out, "imaging.txt");
    if (imaging_is_needed(&job->imaging)) return oxl_imaging_write(job->ctx, path, job->scene, &job->imaging);
    os_remove(path);
    return OXL_OK;
}

/* Writes the result; see job.h. run.json comes last, so that it never says "finished" before
 * the other files are there. */
OXL_INTERNAL oxl_result job_finish(struct job *job, int evaluate)
{
    oxl_model standard = {0};
    size_t bytes[2];
    oxl_result rc = job_final_model(job, 0, &job->result);
    if (rc == OXL_OK) rc = job_write_models(job, &standard, bytes);
    if (rc == OXL_OK) rc = job_write_gains(job);
    if (rc == OXL_OK && evaluate) rc = job_write_metrics(job, &standard, bytes);
    if (rc == OXL_OK && evaluate && job->options.renders) rc = job_render_views(job);
    if (rc == OXL_OK) rc = job_write_run(job, !job->unfinished);
    if (rc == OXL_OK && !job->unfinished) {
        job_remove_decoded(job);
    }
    oxl_model_free(job->ctx, &standard);
    return rc;
}
