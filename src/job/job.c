/* job.c - the whole job: a survey in, a folder with the model, its metrics and its pictures out.
 *
 * OUT/run.json is written first, to say what is under way, and last, when everything else is in place. Invariant: a run.json that
 * says "finished": true describes the scene.ply beside it. The lines "job" and "found" in it are all that a block depends on, and with
 * "refine" all that the result does: a second run that would write the same goes on where the first one stopped, or has nothing to do.
 */
#include "job_state.h"
#include "../core/vecmath.h"

#define JOB_WHOLE    4   /* a merged model of more than --ram over this stays in its file */
#define JOB_EXPOSURE 0.5 /* dB: cc_psnr is told when it is so much above PSNR */

/* ---------------------------------------------------------------- files of OUT */

OXL_INTERNAL oxl_result job_no_memory(struct job *job)
{
    return oxl_fail(job->ctx, OXL_ERR_MEMORY, "no memory for the name of a file in %s", job->out);
}

static oxl_result job_write(struct job *job, const char *name, const struct text *t)
{
    return t->failed ? job_no_memory(job) : os_write_file(job->ctx, PATH(job->out, "%s", name), t->data, t->size);
}

OXL_INTERNAL const char *job_block_folder(char out[PATH_MOST], const struct job *job, int block)
{
    const int blocks = job->partition.block_count;
    if (block < blocks) return path_in(out, job->out, "blocks/%03d", block);
    return path_in(out, job->out, "blocks/%s", block == blocks ? "coarse" : "whole");
}

/* ---------------------------------------------------------------- run.json */

/* What of the survey the result depends on: another export in the same place is another job. */
static void job_describe_found(struct job *job)
{
    text_add(&job->found, "\"found\": {\"images\": %d, \"points\": %zu, \"extent\": %s}",
             job->survey.images - job->survey.images_missing, job->survey.points, NUMBER(job->survey.extent));
}

static oxl_result job_make_key(struct job *job)
{
    text_add(&job->key, "%s, %s", job->line.data, job->found.data);
    return job->found.failed || job->key.failed ? job_no_memory(job) : OXL_OK;
}

static void job_add_partition_decision(const struct job *job, struct text *t)
{
    const struct partition *p     = &job->partition;
    const double            ratio = p->extent[1] > 0 ? p->extent[2] / p->extent[1] : 0;
    text_add(t,
             "\"partition\": {\"chosen\": \"%s\", \"blocks\": %d, \"memory\": %.0f, \"evidence\": \"%zu points; l3/l2 = %s%s\"}",
             p->block_count == 1  ? "none"
             : p->dimensions == 2 ? "2d"
                                  : "3d",
             p->block_count, p->memory, job->survey.points, NUMBER(floor(ratio * 1e3 + 0.5) / 1e3),
             job->options.partition.kind == OXL_PARTITION_AUTO ? "" : "; as set");
}

/* Lamp and water are fitted in one block alone. */
static void job_add_imaging_refusal(const struct job *job, struct text *t, const char *part, oxl_switch mode)
{
    if (mode == OXL_AUTO && job->partition.block_count > 1)
        text_add(t, ", \"%s\": {\"chosen\": \"off\", \"evidence\": \"%d blocks: it is fitted in one block alone\"}", part,
                 job->partition.block_count);
}

/* What was decided, and on what evidence, block by block. */
static oxl_result job_add_decisions(struct job *job, struct text *t)
{
    oxl_result rc = OXL_OK;
    text_add(t, "  \"decisions\": {");
    job_add_partition_decision(job, t);
    job_add_imaging_refusal(job, t, "lamp", job->options.train.lamp);
    job_add_imaging_refusal(job, t, "medium", job->options.train.medium);
    text_add(t, ", \"blocks\": [");
    for (int k = 0; k < job->partition.block_count && rc == OXL_OK; k++) {
        const char *folder = JOB_BLOCK(job, k);
        text_add(t, k > 0 ? ", {" : "{");
        rc = block_read_decisions(job->ctx, folder, t);
        text_add(t, "}");
    }
    text_add(t, "]},\n");
    return rc;
}

static oxl_result job_write_run(struct job *job, int finished)
{
    struct text t  = {.ctx = job->ctx};
    oxl_result  rc = OXL_OK;
    text_add(&t, "{\n  \"oceanxl\": \"%s\",\n  \"finished\": %s,\n  \"threads\": %d,\n  \"instructions\": \"%s\",\n", OXL_VERSION,
             finished ? "true" : "false", job->ctx->threads, oxl_isa_name(job->ctx));
    text_add(&t, "  \"preset\": ");
    text_add_json_string(&t, job->options.preset ? job->options.preset : "");
    text_add(&t, ",\n  \"iterations_done\": %d,\n  \"blocks\": %d,\n  \"origin\": [%s, %s, %s],\n  %s,\n  %s,\n",
             job->total.iterations, job->partition.block_count, NUMBER(job->origin[0]), NUMBER(job->origin[1]),
             NUMBER(job->origin[2]), job->line.data, job->found.data);
    if (finished) rc = job_add_decisions(job, &t);
    text_add(&t, "  \"survey\": ");
    survey_add_json(&t, &job->survey, "  ");
    text_add(&t, ",\n  \"notes\": [%s]\n}\n", job->notes.size ? job->notes.data : "");
    t.failed |= job->notes.failed;
    if (rc == OXL_OK) rc = job_write(job, "run.json", &t);
    text_free(&t);
    return rc;
}

oxl_result oxl_job_resume(oxl_context *ctx, const char *scene, const char *out, oxl_job_options *options, oxl_manifest **run)
{
    oxl_result rc = OXL_OK;
    *run          = oxl_calloc(ctx, 1, sizeof **run);
    if (!*run) return oxl_fail(ctx, OXL_ERR_MEMORY, "no memory to look into %s", out);
    rc = manifest_read(ctx, out, *run);
    if (rc == OXL_OK && (*run)->line && (*run)->scene && !strcmp((*run)->scene, scene)) manifest_options(*run, options);
    if (rc != OXL_OK) oxl_manifest_free(ctx, run);
    return rc;
}

void oxl_manifest_free(oxl_context *ctx, oxl_manifest **run)
{
    if (!*run) return;
    manifest_free(ctx, *run);
    oxl_free(ctx, *run);
    *run = NULL;
}

/* ---------------------------------------------------------------- what is there already */

static oxl_result job_lock(struct job *job)
{
    return lock_folder(job->ctx, job->out, job->options.block >= 0, &job->lock);
}

/* A run of --block K: it replaces what OUT held, and trains a survey of one block, only when no other process is at work there. */
static oxl_result job_lock_alone(struct job *job, int alone)
{
    return job->options.block >= 0 ? lock_change(job->ctx, job->lock, job->out, !alone) : OXL_OK;
}

static void job_see_block(void *user, const char *name)
{
    *(int *)user += name[0] >= '0' && name[0] <= '9';
}

static int job_has_blocks(struct job *job)
{
    int blocks = 0;
    if (os_is_folder(PATH(job->out, "blocks"))) os_list_folder(job->ctx, PATH(job->out, "blocks"), job_see_block, &blocks);
    return blocks > 0;
}

static void job_drop_checkpoint(void *user, const char *name)
{
    struct job *job = user;
    if (name[0] != '.') checkpoint_remove(PATH(job->out, "blocks/%s", name), 1);
}

/* --restart of a whole run discards what is unfinished. */
static void job_drop_checkpoints(struct job *job)
{
    const char *blocks = PATH(job->out, "blocks");
    if (os_is_folder(blocks)) os_list_folder(job->ctx, blocks, job_drop_checkpoint, job);
}

/* Of another folder and with other contents: a survey that moved, or has grown, is no other. */
static int job_is_of_another_survey(const struct job *job, const struct oxl_manifest *run)
{
    return run->scene && run->found && strcmp(run->scene, job->scene_path) != 0 && strcmp(run->found, job->found.data) != 0;
}

static int job_is_of_another_run(const struct job *job, const struct oxl_manifest *run)
{
    return strcmp(run->line, job->line.data) || !run->found || strcmp(run->found, job->found.data);
}

/* Says which options, or what of the survey, are not the same. */
static oxl_result job_refuse(struct job *job, const struct oxl_manifest *run)
{
    struct text t = {.ctx = job->ctx}, there = t;
    oxl_result  rc;
    text_add(&there, "%s, %s", run->line, run->found ? run->found : "");
    rc = there.failed ? OXL_ERR_MEMORY : manifest_differences(&t, there.data, job->key.data);
    if (rc == OXL_OK)
        rc = oxl_fail(job->ctx, OXL_ERR_USAGE,
                      "%s holds the unfinished work of a run with other options or of another survey:\n%s"
                      "fix: use the same options to resume it, --restart to discard it, or another -o",
                      job->out,
                      !run->line[0] ? "  its run.json is truncated\n"
                      : t.data      ? t.data
                                    : "");
    text_free(&t);
    text_free(&there);
    return rc;
}

/* The work of another run is not thrown away by a slip of the hand; a finished one of this survey has given what it had to give. */
static oxl_result job_make_way(struct job *job, const struct oxl_manifest *run)
{
    oxl_result rc;
    if (run->finished && job_is_of_another_survey(job, run) && !job->options.restart)
        return oxl_fail(job->ctx, OXL_ERR_USAGE,
                        "%s holds the finished result of another survey, %s\n"
                        "fix: name another folder by -o; --restart replaces it",
                        job->out, run->scene);
    if (!run->finished && job_has_blocks(job) && !job->options.restart) return job_refuse(job, run);
    rc = job_lock_alone(job, 1);
    if (rc != OXL_OK) return rc;
    if (!run->finished && job->options.block < 0 && job_is_of_another_run(job, run)) job_drop_checkpoints(job);
    os_remove(PATH(job->out, "run.json"));
    os_remove(PATH(job->out, "metrics.json"));
    os_remove(PATH(job->out, "partition.txt"));
    os_remove(PATH(job->out, "blocks/survey.oxl"));
    return OXL_OK;
}

/* The model that training starts from, if it is not the points. */
static oxl_result job_find_start(struct job *job, const struct oxl_manifest *run)
{
    oxl_result rc = start_find(job->ctx, job->out, run, &job->options, job->key.data, &job->found, &job->start);
    if (rc != OXL_OK || job->start.model.count == 0) return rc;
    oxl_model_move_origin(&job->start.model, job->origin);
    job->total.iterations = job->start.after;
    text_free(&job->key);
    job->key = (struct text){.ctx = job->ctx};
    return job_make_key(job);
}

/* *done: nothing is left to do. */
static oxl_result job_look(struct job *job, int *done)
{
    struct oxl_manifest run = {0};
    oxl_result          rc  = manifest_read(job->ctx, job->out, &run);
    *done                   = 0;
    if (rc == OXL_OK) rc = job_find_start(job, &run);
    if (rc != OXL_OK || !run.line) goto leave;
    if (job_is_of_another_run(job, &run) || job->options.restart) rc = job_make_way(job, &run);
    else *done = run.finished && os_is_file(PATH(job->out, "scene.ply"));
leave:
    manifest_free(job->ctx, &run);
    return rc;
}

/* ---------------------------------------------------------------- the survey */

static void job_log_survey(struct job *job)
{
    static const char warning[] = "warning: ";
    for (const char *s = job->survey.text; *s; s += strcspn(s, "\n") + 1) {
        const size_t skip = strncmp(s, warning, sizeof warning - 1) == 0 ? sizeof warning - 1 : 0;
        oxl_log(job->ctx, skip ? OXL_LOG_WARNING : OXL_LOG_INFO, "%.*s", (int)(strcspn(s, "\n") - skip), s + skip);
    }
}

OXL_INTERNAL oxl_result job_load(struct job *job)
{
    oxl_result rc = OXL_OK;
    if (job->partition.block_count > 1)
        rc = scene_file_map(job->ctx, PATH(job->out, "blocks/survey.oxl"), job->key.data, &job->scene);
    if (rc == OXL_OK && !job->scene) rc = oxl_scene_load(job->ctx, job->scene_path, &job->options.scene, &job->scene);
    if (rc == OXL_OK) scene_set_cache(job->scene, job->options.scene.image_cache_bytes);
    return rc == OXL_OK ? scene_set_decoded(job->ctx, job->scene, job->decoded) : rc;
}

/* ---------------------------------------------------------------- decoded images in files */

#define JOB_DISK 4 /* times the files' size must be free: a full disk must not stop the run */

static void job_remove_decoded_file(void *user, const char *name)
{
    if (name[0] != '.') os_remove(PATH(((struct job *)user)->decoded, "%s", name));
}

static void job_remove_decoded(struct job *job)
{
    if (!job->decoded || job->options.keep_decoded || !os_is_folder(job->decoded)) return;
    os_list_folder(job->ctx, job->decoded, job_remove_decoded_file, job);
    os_remove_folder(job->decoded);
}

/* Where each image would be decoded several times: in blocks, or when memory does not hold them all. */
OXL_INTERNAL oxl_result job_plan_decoded(struct job *job)
{
    const double bytes  = job->scene ? 3 * schedule_pixels(job->scene) : 0;
    const char  *folder = PATH(job->out, "blocks/decoded");
    oxl_result   rc     = OXL_OK;
    if (!os_is_folder(folder)) { /* else another process has decided */
        const int wanted = job->scene && (job->partition.block_count > 1 || bytes > (double)job->options.scene.image_cache_bytes);
        if (wanted) rc = os_make_folder(job->ctx, folder);
        if (rc == OXL_OK && wanted && os_disk_free(folder) < JOB_DISK * bytes) os_remove_folder(folder);
    }
    oxl_free(job->ctx, job->decoded);
    job->decoded = NULL;
    if (rc == OXL_OK && os_is_folder(folder) && !(job->decoded = oxl_strdup(job->ctx, folder))) rc = job_no_memory(job);
    return rc == OXL_OK && job->scene ? scene_set_decoded(job->ctx, job->scene, job->decoded) : rc;
}

static oxl_result job_open(struct job *job)
{
    oxl_result rc = os_make_folder(job->ctx, job->out);
    if (rc == OXL_OK) rc = job_load(job);
    if (rc != OXL_OK) return rc;
    rc = survey_describe(job->ctx, job->scene, &job->options, 0, &job->survey);
    if (rc != OXL_OK) return rc;
    memcpy(job->origin, oxl_scene_origin(job->scene), sizeof job->origin);
    job_log_survey(job);
    job_describe_found(job);
    return job_make_key(job);
}

/* ---------------------------------------------------------------- blocks */

/* Of several blocks: what was read of the survey goes to a file, which is mapped instead. A full disk must not stop the run. */
static oxl_result job_map_survey(struct job *job)
{
    const char *path   = PATH(job->out, "blocks/survey.oxl");
    oxl_scene  *mapped = NULL;
    oxl_result  rc     = scene_file_map(job->ctx, path, job->key.data, &mapped);
    if (rc == OXL_OK && !mapped && scene_file_write(job->ctx, path, job->scene, job->key.data) == OXL_OK)
        rc = scene_file_map(job->ctx, path, job->key.data, &mapped);
    if (!mapped) return rc;
    partition_drop_plan(job->ctx, &job->partition);
    oxl_scene_free(job->ctx, job->scene);
    job->scene = mapped;
    scene_set_cache(job->scene, job->options.scene.image_cache_bytes);
    return rc;
}

/* The blocks, as partition.txt has them, else made and written: by the first of several processes, as they may find different memory;
 * the others wait. One block that fits in any case: no file. */
static oxl_result job_make_partition(struct job *job)
{
    const char *path = PATH(job->out, "partition.txt");
    oxl_lock   *lock = NULL;
    oxl_result  rc   = OXL_OK;
    while (rc == OXL_OK && job->options.block >= 0 && !lock && !os_is_file(path)) {
        rc = lock_folder_if_free(job->ctx, PATH(job->out, "blocks"), &lock);
        if (rc == OXL_OK && !lock) rc = context_wait(job->ctx, JOB_WAIT);
    }
    if (rc == OXL_OK && !os_is_file(path)) {
        rc = budget_partition(job->ctx, job->scene, &job->options, &job->partition);
        if (rc == OXL_OK) rc = start_check(job->ctx, &job->start, job->partition.block_count);
        if (rc == OXL_OK && (job->partition.block_count > 1 || job->partition.memory > (double)job->options.ram || lock))
            rc = partition_save(job->ctx, &job->partition, job->out);
    } else if (rc == OXL_OK) rc = partition_read(job->ctx, path, &job->partition);
    oxl_unlock_folder(job->ctx, &lock);
    return rc;
}

static oxl_result job_cut(struct job *job)
{
    oxl_result rc = job_make_partition(job);
    if (rc == OXL_OK && job->partition.block_count > 1 && job->scene) rc = job_map_survey(job);
    if (rc == OXL_OK && job->partition.memory > 0) job->options.ram = (size_t)job->partition.memory;
    if (rc == OXL_OK && (job->options.train.medium == OXL_ON || job->options.train.lamp == OXL_ON) &&
        job->partition.block_count > 1)
        rc = oxl_fail(
            job->ctx, OXL_ERR_USAGE,
            "--medium and --lamp fit one water and one lamp for one block, and the survey is cut into %d\nfix: --partition none, or a "
            "larger --ram",
            job->partition.block_count);
    if (rc == OXL_OK && job->options.block >= job->partition.block_count)
        rc = oxl_fail(job->ctx, OXL_ERR_USAGE, "block %d is wanted, but there are %d (0 to %d)\nfix: --block with one of them",
                      job->options.block, job->partition.block_count, job->partition.block_count - 1);
    return rc;
}

/* The run's progress from the block's. */
OXL_INTERNAL int job_progress(void *user, const oxl_progress *progress)
{
    struct job  *job  = user;
    oxl_progress p    = *progress;
    const double here = os_seconds() - job->begun, limit = job->options.train.max_seconds;
    const double done = job->done + job->part * (p.iteration - job->part_first) / OXL_MAX(1, job->part_until - job->part_first);
    p.memory          = os_peak_rss();
    p.block           = job->block;
    p.blocks          = job->partition.block_count;
    if (p.blocks > 1 && done > job->done_before)
        p.seconds_left = here * OXL_MAX(0, 1 - done) / (done - job->done_before); /* the rest as what this process has done */
    if (limit > 0) p.seconds_left = OXL_MIN(p.seconds_left, OXL_MAX(0, limit - here));
    return job->callback && job->callback->progress ? job->callback->progress(job->callback->user, &p) : 0;
}

OXL_INTERNAL void job_add_record(struct job *job, const struct block_record *r)
{
    struct block_record *t = &job->total;
    t->there |= r->there;
    t->iterations += r->iterations;
    t->seconds += r->seconds;
    t->peak              = OXL_MAX(t->peak, r->peak);
    t->predicted_peak    = OXL_MAX(t->predicted_peak, r->predicted_peak);
    t->predicted_seconds = t->predicted_seconds + r->predicted_seconds;
    nonfinite_add(&t->nonfinite, &r->nonfinite);
    job->unfinished += !r->finished;
}

/* The time allowed is the run's: what comes later has what is left of it. */
OXL_INTERNAL void job_limit_time(const struct job *job, oxl_train_options *o)
{
    if (o->max_seconds > 0) o->max_seconds = OXL_MAX(1e-3, o->max_seconds - (os_seconds() - job->begun));
}

/* The one block: what it may take, and what it will. */
static oxl_result job_plan_whole(struct job *job, struct block_task *task, oxl_job_options *o)
{
    const struct cost_load load = cost_load_of_scene(job->scene);
    struct cost            cost;
    *o = job->options;
    if (!budget_fit(job->ctx, &load, o)) return budget_refuse(job->ctx, &load, o);
    if (o->train.sh_degree != job->options.train.sh_degree || o->train.dog != job->options.train.dog)
        oxl_log(job->ctx, OXL_LOG_INFO, "--ram %.0f MB has no room for trials: SH degree %d and no second lobes, undecided",
                (double)o->ram / 1e6, o->train.sh_degree);
    cost                    = cost_estimate(job->ctx, o, &load);
    task->train             = o->train;
    task->predicted_peak    = cost.memory;
    task->predicted_seconds = job->survey.seconds; /* what was timed for the survey is not timed again */
    if (!(job->survey.seconds > 0)) task->predicted_seconds = cost_seconds(job->ctx, job->scene, o, &cost, NULL);
    job_limit_time(job, &task->train);
    return OXL_OK;
}

static oxl_result job_train_whole(struct job *job, const char *folder)
{
    const oxl_callback callback = {job_progress, job};
    struct block_task  task     = {
             .folder = folder, .key = job->key.data, .callback = &callback, .standard = block_standard_steps(&job->options.train)};
    oxl_job_options options;
    oxl_result      rc = job_plan_whole(job, &task, &options);
    if (rc == OXL_OK) rc = start_use(job->ctx, job->scene, job->out, &job->start, &task);
    if (rc == OXL_OK) scene_set_cache(job->scene, options.scene.image_cache_bytes);
    return rc == OXL_OK ? block_train(job->ctx, job->scene, &task) : rc;
}

/* A survey in one block. */
static oxl_result job_whole(struct job *job)
{
    const char         *folder = JOB_BLOCK(job, 0);
    struct block_record record;
    oxl_result          rc = job_lock_alone(job, 1), trained = OXL_OK;
    if (rc == OXL_OK) rc = block_read(job->ctx, folder, job->key.data, &record);
    if (rc == OXL_OK && !record.finished && !job->scene) rc = job_load(job); /* --block 0, resumed */
    if (rc == OXL_OK && !record.finished) {
        trained = job_train_whole(job, folder);
        rc      = trained == OXL_ERR_INTERRUPTED ? OXL_OK : trained;
        if (rc == OXL_OK) rc = block_read(job->ctx, folder, job->key.data, &record);
    }
    if (rc == OXL_OK) job_add_record(job, &record);
    return rc == OXL_OK ? trained : rc;
}

/* ---------------------------------------------------------------- blocks, merged */

/* A block's model, or the merged one; its standard one when that is wanted and it has second lobes. */
OXL_INTERNAL oxl_result job_read_model(struct job *job, int block, int standard, oxl_model *out)
{
    const char *folder = JOB_BLOCK(job, block);
    const int refined = standard && os_is_file(PATH(folder, "model_standard.ply")); /* else it has no lobes, or was not refined */
    const int whole   = block > job->partition.block_count;
    const size_t most = whole && job->options.ram ? job->options.ram / JOB_WHOLE : SIZE_MAX;
    return oxl_model_open(job->ctx, PATH(folder, refined ? "model_standard.ply" : "model.ply"), most, out);
}

OXL_INTERNAL oxl_result job_join_gains(struct job *job, struct imaging *out)
{
    const int    views  = oxl_scene_view_count(job->scene);
    int         *count  = oxl_calloc(job->ctx, (size_t)views + 1, sizeof *count);
    const double none[] = {0, 0, 0};
    oxl_result   rc     = imaging_create(job->ctx, views, out);
    if (rc == OXL_OK) rc = imaging_set_cameras(job->ctx, job->scene, out);
    if (rc == OXL_OK && !count) rc = job_no_memory(job);
    for (int k = 0; k < job->partition.block_count && rc == OXL_OK; k++) {
        const char    *path = PATH(JOB_BLOCK(job, k), "imaging.txt");
        struct imaging own  = {0};
        rc                  = OXL_OK;
        if (rc == OXL_OK && os_is_file(path)) rc = imaging_read(job->ctx, path, job->scene, &own);
        if (rc == OXL_OK && own.on) imaging_join(out, count, &own);
        imaging_free(job->ctx, &own);
    }
    if (rc == OXL_OK) imaging_centre(out, none);
    oxl_free(job->ctx, count);
    return rc;
}

/* The gains become the scene's. */
OXL_INTERNAL oxl_result job_merge(struct job *job, int standard, oxl_model *out)
{
    oxl_result rc = oxl_model_create(job->ctx, 0, 0, out);
    memcpy(out->origin, job->origin, sizeof job->origin);
    if (rc == OXL_OK && !job->scene) rc = job_load(job);
    if (rc == OXL_OK) imaging_free(job->ctx, scene_imaging(job->scene));
    if (rc == OXL_OK) rc = job_join_gains(job, scene_imaging(job->scene));
    for (int k = 0; k < job->partition.block_count && rc == OXL_OK; k++) {
        oxl_model part;
        rc = job_read_model(job, k, standard, &part);
        if (rc == OXL_OK) rc = merge_rows(job->ctx, &part, NULL, out);
        oxl_model_free(job->ctx, &part);
    }
    return rc;
}

/* The model of the one block, or of all: trained after merging, or merged now. */
static oxl_result job_join(struct job *job, int standard, oxl_model *out)
{
    const int  blocks = job->partition.block_count, one = blocks == 1 ? 0 : blocks + 1;
    oxl_result rc = job_read_model(job, one, standard, out);
    if (rc == OXL_OK && job->scene) rc = oxl_scene_read_imaging(job->ctx, job->scene, PATH(JOB_BLOCK(job, one), "model.ply"));
    if (rc == OXL_OK && out->count == 0)
        rc = oxl_fail(job->ctx, OXL_ERR_FAILED,
                      "no Gaussian is left in %s\nfix: oceanxl check looks at cameras, points and images", job->out);
    return rc;
}

/* ---------------------------------------------------------------- at the end */

/* Water lies between the model's colours and the images: scene.ply is a model for viewers that know none. */
static int job_hides_colours(const struct job *job)
{
    return job->scene && imaging_hides_colours(scene_imaging(job->scene));
}

static oxl_result job_write_ply(struct job *job, const char *name, const oxl_model *model, int degree, size_t *bytes)
{
    struct os_reader file = {0};
    const char      *path = PATH(job->out, "%s", name);
    oxl_result       rc   = model_file_write_ply(job->ctx, path, model, degree);
    if (rc == OXL_OK) rc = os_reader_open(job->ctx, path, &file);
    *bytes = (size_t)file.size;
    os_reader_close(&file);
    return rc;
}

/* Without lobes and water; of an unfinished run, not refined. */
static oxl_result job_make_standard(struct job *job, oxl_model *out)
{
    const int  made = !job->unfinished && (job->model.lobes > 0 || job_hides_colours(job));
    oxl_result rc   = made || job->model.pages ? job_join(job, made, out) : model_copy(job->ctx, &job->model, out);
    model_drop_lobes(out);
    if (rc == OXL_OK && !made && job_hides_colours(job))
        medium_bake(job->scene, &(struct imaging){.medium = scene_imaging(job->scene)->medium}, 0, out);
    return rc;
}

/* scene.ply holds the bands that are carried, and the lobes, or with water the standard model; scene_clear.ply then has the
 * former. Unless scene.ply has the standard columns already, scene_standard.ply has. */
static oxl_result job_write_models(struct job *job, oxl_model *standard, size_t bytes[2])
{
    const int        hides = job_hides_colours(job), is_standard = job->model.sh_degree == 3 && (hides || job->model.lobes == 0);
    const oxl_model *shown = hides ? standard : &job->model;
    oxl_result       rc    = hides || !is_standard ? job_make_standard(job, standard) : OXL_OK;
    bytes[0]               = 0;
    if (rc == OXL_OK) rc = job_write_ply(job, "scene.ply", shown, shown->sh_degree, &bytes[0]);
    bytes[1] = bytes[0];
    if (rc == OXL_OK && hides) rc = job_write_ply(job, "scene_clear.ply", &job->model, job->model.sh_degree, &bytes[1]);
    else os_remove(PATH(job->out, "scene_clear.ply"));
    if (is_standard) os_remove(PATH(job->out, "scene_standard.ply"));
    return rc == OXL_OK && !is_standard ? job_write_ply(job, "scene_standard.ply", standard, 3, &bytes[1]) : rc;
}

static void job_add(struct text *t, const char *name, double value)
{
    text_add(t, "  \"%s\": %s,\n", name, NUMBER(value));
}

oxl_result oxl_metrics_to_json(oxl_context *ctx, const oxl_scene *scene, const oxl_metrics *metrics, char **out)
{
    struct text t  = {.ctx = ctx};
    oxl_result  rc = OXL_OK;
    *out           = NULL;
    text_add(&t, "{\n");
    rc = metrics_write_json(ctx, &t, scene, metrics);
    text_add(&t, "}\n");
    if (rc == OXL_OK) rc = text_take(&t, out);
    text_free(&t);
    return rc;
}

static oxl_split job_split(const struct job *job)
{
    return job->survey.test_views > 0 ? OXL_SPLIT_TEST : OXL_SPLIT_TRAIN;
}

/* What a viewer that knows no second lobes and no water will show: *m gets its PSNR at mean exposure. */
static oxl_result job_add_standard(struct job *job, struct text *t, const oxl_model *standard, size_t bytes, oxl_metrics *m)
{
    struct imaging *imaging = scene_imaging(job->scene), whole = *imaging;
    const int       hides = job_hides_colours(job);
    oxl_metrics     plain;
    oxl_result      rc;
    if (job->model.lobes == 0 && !hides) return OXL_OK;
    imaging->medium = (struct medium){0};
    rc              = oxl_evaluate(job->ctx, standard, job->scene, job_split(job), &plain);
    *imaging        = whole;
    if (rc != OXL_OK) return rc;
    oxl_log(job->ctx, OXL_LOG_INFO, "%s in any viewer: PSNR %.2f dB (%.2f less), %.2f at mean exposure",
            hides ? "scene.ply" : "scene_standard.ply", plain.psnr, m->psnr - plain.psnr, plain.plain_psnr);
    for (int i = 0; i < m->count && i < plain.count && hides; i++) m->views[i].plain_psnr = plain.views[i].plain_psnr;
    if (hides) m->plain_psnr = plain.plain_psnr;
    text_add(t, "  \"standard\": {\"psnr\": %s, \"ssim\": %s, \"psnr_lost\": %s, \"bytes\": %zu},\n", NUMBER(plain.psnr),
             NUMBER(plain.ssim), NUMBER(m->psnr - plain.psnr), bytes);
    oxl_metrics_free(job->ctx, &plain);
    return OXL_OK;
}

static void job_add_figures(struct job *job, struct text *t, size_t bytes)
{
    text_add(t, "{\n  \"split\": \"%s\",\n", job_split(job) == OXL_SPLIT_TEST ? "test" : "train");
    job_add(t, "gaussians", (double)job->model.count);
    job_add(t, "lobes", (double)job->model.lobes);
    job_add(t, "sh_degree", job->model.sh_degree);
    job_add(t, "bytes", (double)bytes);
    job_add(t, "blocks", job->partition.block_count);
    job_add(t, "iterations", job->total.iterations);
    job_add(t, "seconds", job->total.seconds);
    job_add(t, "predicted_seconds", job->total.predicted_seconds);
    job_add(t, "peak_rss_bytes", OXL_MAX(job->total.peak, (double)os_peak_rss()));
    job_add(t, "predicted_memory_bytes", job->total.predicted_peak);
    nonfinite_add_json(t, &job->total.nonfinite);
}

static oxl_result job_write_metrics(struct job *job, const oxl_model *standard, const size_t bytes[2])
{
    oxl_metrics m = {0};
    struct text t = {.ctx = job->ctx};
    struct seam seam;
    oxl_result  rc = oxl_evaluate(job->ctx, &job->model, job->scene, job_split(job), &m);
    if (rc != OXL_OK) goto done;
    if (m.count == 0) oxl_log(job->ctx, OXL_LOG_WARNING, "no view could be evaluated, so there are no metrics");
    else
        oxl_log(job->ctx, OXL_LOG_INFO, "%s views: PSNR %.2f dB, SSIM %.4f, MS-SSIM %.4f over %d; %zu Gaussians, %.1f MB",
                job_split(job) == OXL_SPLIT_TEST ? "test" : "training", m.psnr, m.ssim, m.ms_ssim, m.count, job->model.count,
                (double)bytes[0] / 1e6);
    if (m.cc_psnr > m.psnr + JOB_EXPOSURE)
        oxl_log(job->ctx, OXL_LOG_INFO,
                "PSNR is %.2f dB with one factor for each channel of each view (cc_psnr): exposure may differ from view to view",
                m.cc_psnr);
    job_add_figures(job, &t, bytes[0]);
    rc = job_add_standard(job, &t, standard, bytes[1], &m);
    if (rc == OXL_OK && job->partition.block_count > 1)
        rc = seam_measure(job->ctx, &job->partition, &job->model, job->scene, job_split(job), &seam);
    if (rc != OXL_OK) goto done;
    if (job->partition.block_count > 1) seam_add_json(&t, &seam);
    rc = training_views_check(job->ctx, &job->model, job->scene, job->total.iterations, &t,
                              job->options.renders ? PATH(job->out, "training_views") : NULL);
    if (rc != OXL_OK) goto done;
    rc = metrics_write_json(job->ctx, &t, job->scene, &m);
    text_add(&t, "}\n");
    if (rc == OXL_OK) rc = job_write(job, "metrics.json", &t);
done:
    oxl_metrics_free(job->ctx, &m);
    text_free(&t);
    return rc;
}

static oxl_result job_draw(struct job *job)
{
    const oxl_render_output what = {job_split(job), 1, 0, 0, 0};
    int                     rendered;
    return oxl_render_views(job->ctx, &job->model, job->scene, &what, PATH(job->out, "renders"), &rendered);
}

/* imaging.txt beside scene.ply, where the run has gains. */
static oxl_result job_write_gains(struct job *job)
{
    const char *path = PATH(job->out, "imaging.txt");
    if (job->scene && imaging_is_needed(scene_imaging(job->scene)))
        return imaging_write(job->ctx, path, job->scene, scene_imaging(job->scene));
    os_remove(path);
    return OXL_OK;
}

/* Everything that belongs to the result; of an unfinished run of one block, the model as far as it is. */
static oxl_result job_finish(struct job *job, int judge)
{
    oxl_model  standard = {0};
    size_t     bytes[2];
    oxl_result rc = job->scene || !judge ? OXL_OK : job_load(job);
    if (rc == OXL_OK) rc = job_join(job, 0, &job->model);
    if (rc == OXL_OK) rc = job_write_models(job, &standard, bytes);
    if (rc == OXL_OK) rc = job_write_gains(job);
    if (rc == OXL_OK && judge) rc = job_write_metrics(job, &standard, bytes);
    if (rc == OXL_OK && judge && job->options.renders) rc = job_draw(job);
    if (rc == OXL_OK) rc = job_write_run(job, !job->unfinished);
    if (rc == OXL_OK && !job->unfinished) {
        if (job->partition.block_count > 1) job_drop_checkpoints(job); /* of paused blocks */
        os_remove(PATH(job->out, "blocks/survey.oxl"));
        job_remove_decoded(job);
    }
    oxl_model_free(job->ctx, &standard);
    return rc;
}

/* What can be had of the blocks that are there. rc is how their training ended. */
static oxl_result job_conclude(struct job *job, oxl_result rc)
{
    const int  one    = job->partition.block_count == 1;
    oxl_result joined = OXL_OK;
    if (rc != OXL_OK && (rc != OXL_ERR_INTERRUPTED || !job->total.there)) return rc;
    if (job->options.block >= 0 && !one) return rc;
    if (one || (rc == OXL_OK && !job->unfinished)) joined = job_finish(job, rc == OXL_OK);
    else oxl_log(job->ctx, OXL_LOG_INFO, "%s is not finished; run again to resume", job->out);
    return joined == OXL_OK ? rc : joined;
}

/* ---------------------------------------------------------------- doors */

static void job_begin(struct job *job, oxl_context *ctx, const char *scene, const char *out, const oxl_job_options *options,
                      const oxl_callback *callback)
{
    *job = (struct job){.ctx        = ctx,
                        .scene_path = scene,
                        .out        = out,
                        .options    = options ? *options : oxl_job_options_default(OXL_PRESET_DRAFT),
                        .callback   = callback,
                        .line       = {.ctx = ctx},
                        .found      = {.ctx = ctx},
                        .key        = {.ctx = ctx},
                        .notes      = {.ctx = ctx},
                        .begun      = os_seconds(),
                        .seed       = ctx->options.seed};
    if (job->options.seed) ctx->options.seed = job->options.seed;
    ctx->notes = &job->notes;
    manifest_describe(&job->line, scene, &job->options);
}

static oxl_result job_check(struct job *job)
{
    const oxl_result rc = job->line.failed ? job_no_memory(job) : oxl_job_options_check(job->ctx, &job->options);
    return rc == OXL_OK ? train_check(job->ctx, &job->options.train) : rc;
}

static void job_end(struct job *job)
{
    job->ctx->options.seed = job->seed;
    job->ctx->notes        = NULL;
    oxl_unlock_folder(job->ctx, &job->lock);
    partition_free(job->ctx, &job->partition);
    oxl_model_free(job->ctx, &job->model);
    oxl_model_free(job->ctx, &job->start.model);
    oxl_scene_free(job->ctx, job->scene);
    oxl_free(job->ctx, job->decoded);
    text_free(&job->line);
    text_free(&job->found);
    text_free(&job->key);
    text_free(&job->notes);
}

/* A run of all blocks is alone in OUT; one of a single block may have neighbours that are just writing there. */
static oxl_result job_sweep(struct job *job)
{
    oxl_result rc = job->options.block < 0 ? os_sweep(job->ctx, job->out) : OXL_OK;
    return rc == OXL_OK && job->options.block < 0 ? os_sweep(job->ctx, PATH(job->out, "renders")) : rc;
}

/* From the survey to the blocks; *done: nothing is left to do. */
static oxl_result job_prepare(struct job *job, int *done)
{
    oxl_result rc = job_open(job);
    if (rc == OXL_OK) rc = job_sweep(job);
    if (rc == OXL_OK) rc = job_look(job, done);
    if (rc == OXL_OK && *done)
        oxl_log(job->ctx, OXL_LOG_INFO, "%s already holds the finished result of this survey, these options and this seed",
                job->out);
    if (rc != OXL_OK || *done) return rc;
    rc = context_stopped(job->ctx);
    if (rc == OXL_OK) rc = job_cut(job);
    if (rc == OXL_OK) rc = job_write_run(job, 0);
    return rc == OXL_OK ? job_lock_alone(job, 0) : rc;
}

/* One block of a run whose partition is there: what is in its folder suffices, the whole survey is not read again. */
static oxl_result job_prepare_block(struct job *job, int *ready)
{
    struct oxl_manifest run = {0};
    oxl_result          rc  = manifest_read(job->ctx, job->out, &run);
    *ready = rc == OXL_OK && job->options.block >= 0 && !job->options.restart && run.line && !strcmp(run.line, job->line.data) &&
             os_is_file(PATH(job->out, "partition.txt"));
    *ready = *ready && run.found;
    if (*ready) {
        text_add(&job->found, "%s", run.found);
        rc = job_make_key(job);
    }
    manifest_free(job->ctx, &run);
    return rc == OXL_OK && *ready ? job_cut(job) : rc;
}

oxl_result oxl_job_run(oxl_context *ctx, const char *scene, const char *out, const oxl_job_options *options,
                       const oxl_callback *callback)
{
    struct job job;
    oxl_result rc    = backend_begin(ctx); /* the device is part of what the result depends on */
    int        ready = 0, done = 0;
    if (rc != OXL_OK) return rc;
    job_begin(&job, ctx, scene, out, options, callback);
    rc = job_check(&job);
    if (rc == OXL_OK) rc = job_lock(&job);
    if (rc == OXL_OK) rc = job_prepare_block(&job, &ready);
    if (rc == OXL_OK && !ready) rc = job_prepare(&job, &done);
    if (rc == OXL_OK && !done) {
        rc = job_plan_decoded(&job);
        if (rc == OXL_OK) rc = job.partition.block_count > 1 ? rounds_run(&job) : job_whole(&job);
        rc = job_conclude(&job, rc);
    }
    job_end(&job);
    return rc;
}

/* ---------------------------------------------------------------- merge */

oxl_result oxl_merge(oxl_context *ctx, const char *out, const oxl_callback *callback)
{
    oxl_job_options     options = oxl_job_options_default(OXL_PRESET_DRAFT);
    struct oxl_manifest run     = {0};
    oxl_lock           *lock    = NULL;
    struct job          job;
    int                 done = 0;
    oxl_result          rc   = backend_begin(ctx);
    if (rc == OXL_OK && os_is_folder(out)) rc = oxl_lock_folder(ctx, out, &lock);
    if (rc == OXL_OK) rc = manifest_read(ctx, out, &run);
    if (rc == OXL_OK && (!run.line || !run.scene))
        rc = oxl_fail(ctx, OXL_ERR_INPUT, "%s holds no run.json of a run\nfix: oceanxl train SCENE -o %s --block K comes first",
                      out, out);
    if (rc != OXL_OK) {
        oxl_unlock_folder(ctx, &lock);
        manifest_free(ctx, &run);
        return rc;
    }
    manifest_options(&run, &options);
    options.scene.allow_cut = 1; /* as its training was allowed to */
    job_begin(&job, ctx, run.scene, out, &options, callback);
    job.lock = lock;
    rc       = job_check(&job);
    if (rc == OXL_OK) rc = job_prepare(&job, &done);
    if (rc == OXL_OK && !done) rc = job_plan_decoded(&job);
    if (rc == OXL_OK && !done) rc = rounds_collect(&job);
    if (rc == OXL_OK && !done) rc = job_finish(&job, 1);
    job_end(&job);
    manifest_free(ctx, &run);
    return rc;
}
