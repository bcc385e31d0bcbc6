/* job_state.c - holds what the files of a job share: names in OUT, the survey, decoded images, progress,
 * records, the blocks' models.
 *
 * Invariant: nothing here trains; job_run.c and blocks.c call these functions, but none of theirs
 * is called here.
 */
#include "job_state.h"
#include "../formats/formats.h"
#include "../survey/scene.h"
#include "os_job.h"

#define JOB_SECONDS_MIN 1e-3 /* Bounds the time left from below, since 0 would be no limit. */
/* Requires free disk for decoded images, in their own size: a full disk must not stop the run. */
#define JOB_DISK 4

/* ---------------- files of OUT */

OXL_INTERNAL const char *job_block_folder(char out[PATH_LENGTH], const struct job *job, int block)
{
    if (block >= 0) return path_in(out, job->out, "blocks/%03d", block);
    return path_in(out, job->out, "blocks/%s", block == JOB_COARSE_MODEL ? "coarse" : "whole");
}

/* ---------------- the survey, and its decoded images in files */

OXL_INTERNAL void job_set_cache(const struct job *job, size_t most)
{
    const size_t part = (size_t)(3 * schedule_pixels(job->scene) / OXL_MAX(job->partition.block_count, 1));
    scene_set_cache(job->scene, job->decoded ? OXL_MIN(most, part) : most);
}

/* Removes a file of decoded images, KEY of scene_images.c. */
static void job_remove_decoded_file(void *folder, const char *name)
{
    const size_t digits = strspn(name, "0123456789abcdef");
    if (digits == IMAGE_FILE_NAME && !name[digits]) os_remove(PATH(folder, "%s", name));
}

OXL_INTERNAL void job_remove_decoded(struct job *job)
{
    const char *folder = PATH(job->out, "blocks/decoded");
    if (!job->decoded || !os_is_folder(folder)) return;
    os_remove_temporaries(job->ctx, folder);
    os_list_folder(job->ctx, folder, job_remove_decoded_file, (void *)folder);
    os_remove_folder(folder);
}

/* Decides whether decoded images are kept in files: if each would be decoded several times, since there are
 * blocks or memory does not hold all images. */
OXL_INTERNAL oxl_result job_plan_decoded(struct job *job)
{
    const double bytes = 3 * schedule_pixels(job->scene);
    const char *folder = PATH(job->out, "blocks/decoded");
    oxl_result rc = OXL_OK;
    /* Leaves the decision to the process that has made the folder. */
    if (!os_is_folder(folder) &&
        (job->partition.block_count > 1 || bytes > (double)cost_cache(&job->options))) {
        rc = oxl_make_folder(job->ctx, folder);
        if (rc == OXL_OK && os_disk_free(folder) < JOB_DISK * bytes) os_remove_folder(folder);
    }
    job->decoded = os_is_folder(folder);
    job_set_cache(job, job->options.scene.image_cache_bytes);
    if (rc == OXL_OK && job->decoded && !(job->scene->cache->decoded = oxl_strdup(job->ctx, folder)))
        rc = OXL_ERR_MEMORY;
    return rc;
}

/* ---------------- progress and records */

/* Reports the run's progress from that of the block in training. */
OXL_INTERNAL int job_progress(void *user, const oxl_progress *progress)
{
    struct job *job = user;
    oxl_progress p = *progress;
    const double here = os_seconds() - job->started, limit = job->options.train.max_seconds;
    /* Counts the steps of a model for viewers, which follow those of the merged model. */
    const int until = job->block == JOB_MERGED_MODEL
                          ? OXL_MAX(job->stage_until + job->stage_viewers, p.iterations)
                          : job->stage_until;
    const double done =
        job->done + job->stage * (p.iteration - job->stage_first) / OXL_MAX(1, until - job->stage_first);
    p.memory = os_peak_rss();
    p.block = OXL_MAX(job->block, 0);
    p.stage = job->block == JOB_COARSE_MODEL   ? OXL_STAGE_COARSE
              : job->block == JOB_MERGED_MODEL ? OXL_STAGE_MERGED
                                               : OXL_STAGE_BLOCK;
    p.blocks = job->partition.block_count;
    /* Extrapolates the time left from what this process has done. */
    if (p.blocks > 1 && done > job->done_before)
        p.seconds_left = here * OXL_MAX(0, 1 - done) / (done - job->done_before);
    if (limit > 0) p.seconds_left = OXL_MIN(p.seconds_left, OXL_MAX(0, limit - here));
    return context_report(job->callback, &p);
}

OXL_INTERNAL oxl_result job_read_record(struct job *job, const char *folder, struct block_record *out)
{
    const oxl_result rc = block_read(job->ctx, folder, job->key.data, out);
    if (rc == OXL_OK && out->finished && out->number[BLOCK_NONFINITE] > 0) /* of an earlier process */
        oxl_log(job->ctx, OXL_LOG_WARNING,
                "%s was trained without %.0f images that could not be read\n"
                "fix: restore them, then train with --restart",
                folder, out->number[BLOCK_NONFINITE]);
    return rc;
}

OXL_INTERNAL void job_add_record(struct job *job, const struct block_record *r)
{
    struct block_record *total = &job->total;
    total->exists |= r->exists;
    for (int k = 0; k < BLOCK_NUMBERS; k++) {
        const double was = total->number[k], more = r->number[k];
        total->number[k] = k == BLOCK_PEAK ? OXL_MAX(was, more) : was + more;
    }
    job->unfinished += !r->finished;
}

/* ---------------- training */

OXL_INTERNAL struct block_task job_task(struct job *job, const char *folder)
{
    return (struct block_task){.folder = folder,
                               .key = job->key.data,
                               .callback = &job->progress,
                               .run = {.imaging = &job->imaging},
                               .train = job->options.train};
}

OXL_INTERNAL void job_use_budget(const struct job *job, const oxl_job_options *fitted,
                                 struct block_task *task)
{
    job_set_cache(job, fitted->scene.image_cache_bytes);
    task->train = fitted->train;
}

OXL_INTERNAL oxl_result job_train_task(struct job *job, struct block_task *task)
{
    oxl_train_options *o = &task->train;
    job->stage_first = task->run.first;
    job->stage_until = task->run.until ? task->run.until : o->iterations;
    if (o->max_seconds > 0)
        o->max_seconds = OXL_MAX(JOB_SECONDS_MIN, o->max_seconds - (os_seconds() - job->started));
    return block_train(job->ctx, job->scene, task);
}

OXL_INTERNAL void job_drop_blocks(const struct job *job)
{
    for (int k = JOB_MERGED_MODEL; k < 0 || os_is_folder(JOB_BLOCK(job, k)); k++) {
        os_remove(PATH(JOB_BLOCK(job, k), "block.json"));
        checkpoint_remove(JOB_BLOCK(job, k));
    }
}

/* ---------------- models of the blocks */

OXL_INTERNAL oxl_result job_read_model(struct job *job, int block, oxl_model *out)
{
    return oxl_model_read(job->ctx, PATH(JOB_BLOCK(job, block), "model.ply"), out);
}

OXL_INTERNAL void job_add_imaging(struct oxl_imaging *all, int *count, const struct oxl_imaging *block)
{
    for (int i = 0; i < all->views; i++) {
        if (!block->known[i]) continue;
        all->known[i] = 1;
        count[i]++;
        for (int c = 0; c < 3; c++) {
            float *a = &all->log_gain[3 * i + c];
            *a = (float)(*a + (block->log_gain[3 * i + c] - *a) / count[i]);
        }
    }
    all->on |= block->on;
    if (imaging_alters_colours(block)) all->medium = block->medium;
    if (block->lamps > 0) memcpy(all->lamp, block->lamp, sizeof all->lamp), all->lamps = block->lamps;
}

/* Joins the imaging of all blocks: log gains of mean 0, lamp, medium and poses. */
static oxl_result job_join_imaging(struct job *job, struct oxl_imaging *out)
{
    const int views = job->scene->view_count;
    int *count = oxl_calloc(job->ctx, (size_t)views + 1, sizeof *count);
    const double none[] = {0, 0, 0};
    oxl_result rc = imaging_create(job->ctx, views, out);
    if (rc == OXL_OK) rc = imaging_set_cameras(job->ctx, job->scene, out);
    if (rc == OXL_OK && !count) rc = OXL_ERR_MEMORY;
    for (int k = 0; k < job->partition.block_count && rc == OXL_OK; k++) {
        const char *path = PATH(JOB_BLOCK(job, k), "imaging.txt");
        struct oxl_imaging own = {0};
        if (os_is_file(path)) rc = imaging_read(job->ctx, path, job->scene, &own);
        if (rc == OXL_OK && imaging_is_needed(&own)) job_add_imaging(out, count, &own);
        /* Takes the poses, the same in all blocks, from the first. */
        if (rc == OXL_OK && !out->pose) out->pose = own.pose, own.pose = NULL;
        imaging_free(job->ctx, &own);
    }
    if (rc == OXL_OK) imaging_centre(out, none);
    oxl_free(job->ctx, count);
    return rc;
}

/* Merges the blocks' models, and makes their gains, lamp and medium the scene's. */
OXL_INTERNAL oxl_result job_merge(struct job *job, oxl_model *out)
{
    oxl_result rc = oxl_model_create(job->ctx, 0, 0, out);
    memcpy(out->origin, job->origin, sizeof job->origin);
    if (rc == OXL_OK) imaging_free(job->ctx, &job->imaging);
    if (rc == OXL_OK) rc = job_join_imaging(job, &job->imaging);
    for (int k = 0; k < job->partition.block_count && rc == OXL_OK; k++) {
        oxl_model part;
        rc = job_read_model(job, k, &part);
        if (rc == OXL_OK) rc = merge_rows(job->ctx, &part, NULL, out);
        oxl_model_free(job->ctx, &part);
    }
    return rc;
}
