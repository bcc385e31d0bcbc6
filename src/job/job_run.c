/* job_run.c - runs the whole job: a survey in, a folder with the model, its metrics and renders out.
 *
 * OUT/run.json is written first, as the key of the run, and last, when everything else is in place.
 * Invariant: a run.json that says "finished": true describes the scene.ply beside it. Its lines "job" and
 * "found" hold all that the result depends on: a second run with the same lines resumes the first, or has
 * nothing to do.
 */
#include "job.h"
#include "../render/render.h"
#include "../formats/json.h"
#include "../checks/checks.h"
#include "../survey/scene.h"
#include "../large/os_job.h"

/* ---------------- run.json */

/* Makes the key of the run: all options that the result depends on, and the properties of a survey that
 * identify it, since another export in the same place is another job. */
static oxl_result job_make_key(struct job *job, int images)
{
    struct text *key = &job->key;
    uint64_t sum = 0;
    oxl_result rc = survey_checksum(job->ctx, job->scene, &sum);
    manifest_describe(key, &job->inputs, job->scene_path, &job->options);
    text_add(
        key,
        ", \"found\": {\"images\": %d, \"points\": %zu, \"extent\": %s, \"checksum_of_files\": \"%016llx\"",
        images, job->scene->point_count, NUMBER(job->scene->extent), (unsigned long long)sum);
    if (rc == OXL_OK && job->options.from) {
        rc = checksum_of_file(job->ctx, job->options.from, 0, &sum);
        text_add(key, ", \"start\": \"%016llx\"", (unsigned long long)sum);
    }
    text_add(key, "}");
    return rc == OXL_OK && (key->failed || job->inputs.failed) ? OXL_ERR_MEMORY : rc;
}

/* ---------------- what is there already */

/* Locks OUT; a finished run in a folder that cannot be written to needs no lock. */
static oxl_result job_lock(struct job *job)
{
    const oxl_result rc = lock_folder(job->ctx, job->out, job->options.block >= 0, &job->lock);
    if (rc == OXL_ERR_IO && os_is_file(PATH(job->out, "scene.ply"))) return OXL_OK;
    return rc;
}

/* Makes the lock exclusive, so that a run of --block K replaces results in OUT, or trains a survey of one
 * block, only while no other process works there. */
static oxl_result job_lock_alone(struct job *job)
{
    if (!job->lock) return lock_folder(job->ctx, job->out, 0, &job->lock);
    return job->options.block >= 0 ? lock_change(job->ctx, job->lock, job->out, 0) : OXL_OK;
}

static int job_has_blocks(const struct job *job)
{
    return os_is_folder(JOB_BLOCK(job, 0)) || os_is_folder(JOB_BLOCK(job, JOB_COARSE_MODEL));
}

/* Refuses OUT; the error names the options, or properties of the survey, that differ. */
static oxl_result job_refuse(struct job *job, const struct oxl_manifest *run)
{
    struct text t = {.ctx = job->ctx};
    oxl_result rc;
    manifest_differences(run, job->key.data, &t);
    if (manifest_differences(run, strstr(job->key.data, "\"found\": {"), &t) > 0)
        manifest_differences(run, job->inputs.data, &t);
    rc = oxl_fail(job->ctx, OXL_ERR_USAGE,
                  "%s holds the %s of a run with other options or of another survey:\n%s"
                  "fix: use the same options%s, --restart to %s it, or another output folder%s",
                  job->out, run->finished ? "finished result" : "unfinished work", t.data ? t.data : "",
                  run->finished ? "" : " to resume it", run->finished ? "replace" : "discard",
                  run->finished ? ", with --from to start from its scene.ply" : "");
    text_free(&t);
    return rc;
}

/* Removes what another run, or one that is trained anew, left in OUT. */
static oxl_result job_replace_run(struct job *job)
{
    static const char *const files[] = {"run.json", "metrics.json"};
    const oxl_result rc = job_lock_alone(job);
    if (rc != OXL_OK) return rc;
    if (job->options.block < 0) job_drop_blocks(job);
    for (size_t i = 0; i < OXL_COUNT(files); i++) os_remove(PATH(job->out, "%s", files[i]));
    return OXL_OK;
}

/* Reads the model of --from. */
static oxl_result job_read_start(struct job *job)
{
    oxl_model *start = &job->start;
    oxl_result rc = oxl_model_read(job->ctx, job->options.from, start);
    if (rc != OXL_OK) return rc;
    if (start->scale > 0) oxl_model_rescale(start, 1 / start->scale);
    oxl_model_move_origin(start, job->origin);
    return oxl_model_check_overlap(job->ctx, start, job->scene, job->options.from);
}

/* Compares the run with the run in OUT: resumes it, or replaces it; without --restart only if it has no work
 * done. *done: nothing is left to do. */
static oxl_result job_find_earlier(struct job *job, int *done)
{
    struct oxl_manifest run = {0};
    const int restart = job->options.restart;
    oxl_result rc = manifest_read(job->ctx, job->out, &run);
    const int same = run.text && strstr(run.text, job->key.data) != NULL;
    if (rc == OXL_OK && !run.text && !restart && !job_has_blocks(job))
        rc = out_check_files(job->ctx, job->out);
    *done = rc == OXL_OK && same && !restart && run.finished && os_is_file(PATH(job->out, "scene.ply"));
    if (rc == OXL_OK && run.text && !same && !restart && (run.finished || job_has_blocks(job)))
        rc = job_refuse(job, &run);
    else if (rc == OXL_OK && (restart || (run.text && !same))) rc = job_replace_run(job);
    else if (rc == OXL_OK && !*done && !job->lock) rc = job_lock_alone(job);
    manifest_free(job->ctx, &run);
    return rc;
}

/* ---------------- the survey */

static void job_log_lines(struct job *job, oxl_log_level level, const char *s)
{
    for (; *s; s += strcspn(s, "\n") + 1) oxl_log(job->ctx, level, "%.*s", (int)strcspn(s, "\n"), s);
}

/* Loads the survey and makes the key of the run, with the preset's iterations for this number of images. */
static oxl_result job_open(struct job *job)
{
    oxl_result rc = oxl_make_folder(job->ctx, job->out);
    int images;
    if (rc == OXL_OK) rc = oxl_scene_load(job->ctx, job->scene_path, &job->options.scene, &job->scene);
    if (rc != OXL_OK) return rc;
    memcpy(job->origin, job->scene->origin, sizeof job->origin);
    images = job->scene->stats.images_listed - job->scene->stats.images_missing;
    job->options.train.iterations = cost_iterations(&job->options, images);
    job->options.iterations_for = 0;
    return job_make_key(job, images);
}

static oxl_result job_describe_survey(struct job *job)
{
    const oxl_result rc = survey_describe(job->ctx, job->scene, &job->asked, 0, &job->survey);
    if (rc != OXL_OK) return rc;
    job_log_lines(job, OXL_LOG_INFO, job->survey.text);
    job_log_lines(job, OXL_LOG_WARNING, job->survey.warnings);
    return OXL_OK;
}

/* ---------------- blocks */

/* Cuts the survey into blocks that fit the memory in run.json, since a later machine may have other free
 * memory; without it, the memory that is free, and blocks that are there may be of another cut. */
static oxl_result job_partition(struct job *job)
{
    struct oxl_manifest run = {0};
    oxl_result rc = manifest_read(job->ctx, job->out, &run);
    const double memory = oxl_json_number(run.text, "memory");
    if (rc == OXL_OK) rc = budget_partition(job->ctx, job->scene, &job->options, memory, &job->partition);
    if (rc == OXL_OK && isnan(memory) &&
        (job->partition.block_count > 1 || os_is_folder(JOB_BLOCK(job, JOB_COARSE_MODEL))))
        job_drop_blocks(job);
    manifest_free(job->ctx, &run);
    partition_free_plan(job->ctx, &job->partition);
    if (rc == OXL_OK && job->partition.memory > 0) job->options.ram = (size_t)job->partition.memory;
    if (rc == OXL_OK && job->options.from && job->partition.block_count > 1)
        rc = oxl_fail(
            job->ctx, OXL_ERR_USAGE,
            "--from needs a survey of one block, but this one is cut into %d\nfix: add --partition none",
            job->partition.block_count);
    if (rc == OXL_OK && job->options.block >= job->partition.block_count)
        rc = oxl_fail(
            job->ctx, OXL_ERR_USAGE,
            "there is no block %d: the survey has %d blocks (0 to %d)\nfix: give --block one of these "
            "numbers",
            job->options.block, job->partition.block_count, job->partition.block_count - 1);
    return rc;
}

static oxl_result job_train_single(struct job *job, const char *folder)
{
    const struct cost_load load = cost_load_of_scene(job->scene);
    struct block_task task = job_task(job, folder);
    oxl_job_options o = job->options;
    if (!budget_fit(&load, &o)) return budget_refuse(job->ctx, &load, &o);
    if (o.train.sh_degree != job->options.train.sh_degree)
        oxl_log(job->ctx, OXL_LOG_INFO, "SH degree    %d, since --ram %.0f MB has no room for more",
                o.train.sh_degree, (double)o.ram / 1e6);
    job_use_budget(job, &o, &task);
    task.run.viewed = cost_evaluation_steps(job->scene, job->options.train.iterations);
    task.run.viewer_steps = viewer_steps(&job->options.train), task.run.trims = 1;
    if (job->start.count > 0) task.run.from = &job->start;
    if (o.train.max_gaussians > 0 && job->start.count > (size_t)o.train.max_gaussians)
        return oxl_fail(
            job->ctx, OXL_ERR_USAGE,
            "the model to start from has %zu Gaussians, but only %d are allowed\nfix: use a larger "
            "--max-gaussians or --ram",
            job->start.count, o.train.max_gaussians);
    return job_train_task(job, &task);
}

/* Trains a survey in one block. */
static oxl_result job_run_single(struct job *job)
{
    const char *folder = JOB_BLOCK(job, 0);
    struct block_record record;
    oxl_result rc = job_lock_alone(job), trained = OXL_OK;
    if (rc == OXL_OK) rc = job_read_record(job, folder, &record);
    if (rc == OXL_OK && !record.finished) {
        trained = job_train_single(job, folder);
        rc = trained == OXL_ERR_INTERRUPTED ? OXL_OK : trained;
        if (rc == OXL_OK) rc = block_read(job->ctx, folder, job->key.data, &record);
    }
    if (rc == OXL_OK) job_add_record(job, &record);
    return rc == OXL_OK ? trained : rc;
}

/* Writes the result if all blocks have finished, or the partial result of one block. rc:
 * the end of their training. */
static oxl_result job_finish_if_complete(struct job *job, oxl_result rc)
{
    const int one = job->partition.block_count == 1;
    oxl_result joined = OXL_OK;
    if (rc != OXL_OK && (rc != OXL_ERR_INTERRUPTED || !job->total.exists)) return rc;
    if (job->options.block >= 0 && !one) return rc;
    if (one || (rc == OXL_OK && !job->unfinished)) joined = job_finish(job, rc == OXL_OK);
    else oxl_log(job->ctx, OXL_LOG_INFO, "%s is not finished: the same command resumes it", job->out);
    return joined == OXL_OK ? rc : joined;
}

/* ---------------- the run */

static void job_begin(struct job *job, oxl_context *ctx, const char *scene, const char *out,
                      const oxl_job_options *options, const oxl_callback *callback)
{
    *job = (struct job){.ctx = ctx,
                        .scene_path = scene,
                        .out = out,
                        .options = options ? *options : oxl_job_options_default(OXL_PRESET_DRAFT),
                        .callback = callback,
                        .progress = {job_progress, job},
                        .inputs = {.ctx = ctx},
                        .key = {.ctx = ctx},
                        .notes = {.ctx = ctx},
                        .started = os_seconds(),
                        .seed = ctx->options.seed};
    job->asked = job->options;
    if (job->options.seed) ctx->options.seed = job->options.seed;
    ctx->notes = &job->notes;
    backend_begin_run(ctx);
}

static oxl_result job_check(struct job *job)
{
    oxl_result rc = oxl_job_options_check(job->ctx, &job->options);
    if (rc == OXL_OK) rc = train_check(job->ctx, &job->options.train);
    return rc == OXL_OK ? out_check_inputs(job->ctx, job->out, job->scene_path, &job->options.scene) : rc;
}

static void job_end(struct job *job)
{
    job->ctx->options.seed = job->seed;
    job->ctx->notes = NULL;
    oxl_unlock_folder(job->ctx, &job->lock);
    partition_free(job->ctx, &job->partition);
    oxl_model_free(job->ctx, &job->start);
    imaging_free(job->ctx, &job->imaging);
    oxl_scene_free(job->ctx, job->scene);
    text_free(&job->inputs);
    text_free(&job->key);
    text_free(&job->notes);
}

/* Removes temporary files of killed processes. A run of all blocks is alone in OUT; beside one of a single
 * block, others may be writing. */
static oxl_result job_remove_temporaries(struct job *job)
{
    oxl_result rc = OXL_OK;
    if (job->options.block >= 0 || !job->lock) return rc;
    rc = os_remove_temporaries(job->ctx, job->out);
    return rc == OXL_OK ? os_remove_temporaries(job->ctx, PATH(job->out, "renders")) : rc;
}

/* Describes the survey, cuts it and writes run.json. One block of a run that others began needs no
 * description; of several processes that begin, the others wait for the memory that the first one finds. */
static oxl_result job_plan(struct job *job)
{
    const char *path = PATH(job->out, "run.json");
    const int begins = job->options.block < 0 || !os_is_file(path);
    oxl_lock *lock = NULL;
    oxl_result rc = begins ? job_describe_survey(job) : OXL_OK;
    if (rc == OXL_OK) rc = context_stopped(job->ctx);
    if (rc == OXL_OK && job->options.block >= 0)
        rc = lock_wait(job->ctx, PATH(job->out, "blocks"), path, &lock);
    if (rc == OXL_OK) rc = job_partition(job);
    if (rc == OXL_OK && !begins && job->partition.block_count == 1) rc = job_describe_survey(job);
    if (rc == OXL_OK && begins) rc = job_write_run(job, 0);
    oxl_unlock_folder(job->ctx, &lock);
    if (rc == OXL_OK && job->options.block >= 0) rc = lock_change(job->ctx, job->lock, job->out, 1);
    return rc;
}

/* Prepares a run, from the survey to the partition; *done: nothing is left to do. */
static oxl_result job_prepare(struct job *job, int *done)
{
    oxl_result rc = job_open(job);
    if (rc == OXL_OK) rc = job_remove_temporaries(job);
    if (rc == OXL_OK) rc = job_find_earlier(job, done);
    if (rc == OXL_OK && *done)
        oxl_log(job->ctx, OXL_LOG_INFO, "%s already holds the finished result of this command", job->out);
    if (rc != OXL_OK || *done) return rc;
    if (job->options.from) rc = job_read_start(job);
    if (rc == OXL_OK) rc = job_plan(job);
    return rc == OXL_OK ? job_plan_decoded(job) : rc;
}

static oxl_result job_train(struct job *job)
{
    oxl_result rc = hypotheses_check(job->ctx, job->scene, 0, &job->survey.foreign);
    if (rc == OXL_OK) rc = job->partition.block_count > 1 ? blocks_run(job) : job_run_single(job);
    return rc;
}

oxl_result oxl_job_run(oxl_context *ctx, const char *scene, const char *out, const oxl_job_options *options,
                       const oxl_callback *callback)
{
    struct job job;
    int done = 0;
    /* Opens the device first, since the result depends on it. */
    oxl_result rc = oxl_backend_begin(ctx);
    if (rc != OXL_OK) return rc;
    job_begin(&job, ctx, scene, out, options, callback);
    rc = job_check(&job);
    if (rc == OXL_OK) rc = job_lock(&job);
    if (rc == OXL_OK) rc = job_prepare(&job, &done);
    if (rc == OXL_OK && !done) rc = job_finish_if_complete(&job, job_train(&job));
    job_end(&job);
    return rc;
}
