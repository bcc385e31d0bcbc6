/* blocks.c - trains several blocks as one model (docs/SCALE.md).
 *
 * 1. The coarse model takes the first JOB_COARSE of the run, on the whole survey, in blocks/coarse.
 * 2. Each block continues the run with the coarse model's Gaussians in its box, on the windows of the views
 *    in which they are visible. The surroundings, all other Gaussians of the coarse model, are rendered and
 *    not trained. So the merged model is the blocks' models side by side.
 * 3. The last stage of the run trains the merged model on all views, in blocks/whole, and lets it grow once
 *    to the allowed number.
 *
 * Invariant: a block is a function of survey, options and coarse model, not of the process or the order of
 * training. A folder's record says that its stage is finished; a damaged one is trained again to the same
 * bytes. A process with --block K trains that block, after the coarse model unless another process does.
 */
#include "job_state.h"
#include "../formats/formats.h"
#include "../render/render.h"
#include "../survey/scene.h"
#include "../model/model.h"

/* Splits Gaussians of the merged model once more after this fraction of its steps (docs/log/SCALE.md). */
#define BLOCKS_GROWTH 0.25

struct blocks {
    struct job *job;
    oxl_model coarse; /* around the survey's origin; count 0: not read yet */
};

static struct block_task blocks_task(struct job *job, const char *folder)
{
    struct block_task task = job_task(job, folder);
    if (task.train.dropout < 0) task.train.dropout = 0; /* In blocks `auto` is off. */
    return task;
}

/* ---------------- the coarse model */

static oxl_result blocks_train_coarse(struct blocks *b, int block, const char *folder)
{
    struct job *job = b->job;
    const struct cost_load load = cost_load_of_scene(job->scene);
    struct block_task task = blocks_task(job, folder);
    oxl_job_options o = job->options;
    (void)block;
    o.train = task.train;
    if (!budget_limit_gaussians(&load, &o)) return budget_refuse(job->ctx, &load, &o);
    job_use_budget(job, &o, &task);
    task.train.keep.kind = OXL_KEEP_ALL;
    task.run.until = (int)OXL_MAX(1, JOB_COARSE * o.train.iterations);
    return job_train_task(job, &task);
}

/* ---------------- a block */

/* Sets the options of the block's part of the run. Divides numbers of Gaussians and bytes by the blocks'
 * fractions. */
static void blocks_set_options(const struct block_plan *plan, oxl_train_options *o)
{
    const double scale = (double)plan->iterations / o->iterations;
    o->survey_iterations = o->iterations;
    o->iterations = plan->iterations;
    if (o->densify_every > 0) o->densify_every = (int)OXL_MAX(1, o->densify_every * scale + 0.5);
    o->max_gaussians = (int)OXL_MIN(plan->gaussians, INT_MAX);
    if (o->keep.kind == OXL_KEEP_COUNT) o->keep.value = OXL_MAX(1, floor(o->keep.value * plan->fraction));
    if (o->keep.kind == OXL_KEEP_BYTES) o->keep.value *= plan->fraction;
    if (o->medium == OXL_ON) o->medium = OXL_AUTO; /* Keeps the medium that the coarse model has. */
}

/* Limits the growth of the block so that it fits --ram, less the bytes of the surroundings, and --device-ram.
 * What the coarse model has fits, since it was trained whole. */
static void blocks_limit(const struct job *job, const struct block_plan *plan, struct block_task *task)
{
    const size_t own = plan->own.count, others = plan->surroundings.count;
    const double beside = (double)others * (4.0 * oxl_model_planes(&plan->surroundings) + COST_SPLAT_BYTES);
    struct cost_load load = cost_load_of_scene(job->scene);
    oxl_job_options o = job->options;
    o.train = task->train;
    load.points = own;
    if (o.ram) o.ram = (double)o.ram > beside ? o.ram - (size_t)beside : 1;
    if (o.device_ram) load.surroundings = (double)others / (double)OXL_MAX(own, (size_t)1);
    budget_limit_gaussians(&load, &o);
    o.train.max_gaussians = OXL_MAX(o.train.max_gaussians, (int)own);
    o.train.max_gaussians = OXL_MIN(o.train.max_gaussians, task->train.max_gaussians);
    job_use_budget(job, &o, task);
}

static oxl_result blocks_train_block(struct blocks *b, int block, const char *folder)
{
    struct job *job = b->job;
    struct block_task task = blocks_task(job, folder);
    struct block_plan plan = {0};
    oxl_result rc = OXL_OK;
    if (b->coarse.count == 0) rc = job_read_model(job, JOB_COARSE_MODEL, &b->coarse);
    if (rc == OXL_OK) rc = block_plan_make(job, block, &b->coarse, &plan);
    /* The block begins with the coarse model's gains, and keeps its lamp and medium. */
    imaging_free(job->ctx, &job->imaging);
    if (rc == OXL_OK)
        rc = imaging_read_beside(job->ctx, PATH(JOB_BLOCK(job, JOB_COARSE_MODEL), "model.ply"), job->scene,
                                 &job->imaging);
    /* A block without Gaussians, or without a window in any view, as in a survey that is wholly black, keeps
     * the coarse model's Gaussians. */
    if (rc == OXL_OK && (plan.own.count == 0 || plan.views == 0))
        rc = block_keep(job->ctx, job->scene, &task,
                        &(oxl_trained){.model = plan.own, .imaging = &job->imaging, .finished = 1});
    else if (rc == OXL_OK) {
        blocks_set_options(&plan, &task.train);
        blocks_limit(job, &plan, &task);
        task.run.start = &plan.own, task.run.surroundings = &plan.surroundings, task.run.window = plan.window;
        task.run.first = plan.first, task.run.until = plan.last;
        rc = job_train_task(job, &task);
    }
    block_plan_free(job->ctx, &plan);
    return rc;
}

/* ---------------- the merged model */

/* Sets the options of the merged model, which grows once by the Gaussians that the blocks have left of the
 * allowed number and memory holds. */
static void blocks_set_merged(const struct job *job, int sh_degree, int steps, oxl_train_options *out)
{
    const struct cost_load load = cost_load_of_scene(job->scene);
    const int step = (int)ceil(BLOCKS_GROWTH * steps);
    oxl_job_options o = job->options;
    *out = train_refinement(&job->options.train, sh_degree, steps);
    o.train = *out;
    if (job->stage != JOB_MERGED || job->options.train.densify_until <= 0 ||
        !budget_limit_gaussians(&load, &o))
        return;
    job_set_cache(job, o.scene.image_cache_bytes);
    *out = o.train;
    out->densify_every = step;
    out->densify_until = (float)((step + 0.5) / steps);
}

static oxl_result blocks_train_merged(struct blocks *b, int block, const char *folder)
{
    struct job *job = b->job;
    const int steps = (int)OXL_MAX(1, job->stage * job->options.train.iterations);
    struct block_task task = blocks_task(job, folder);
    oxl_model merged = {0};
    oxl_result rc = job_merge(job, &merged);
    (void)block;
    task.run.start = &merged;
    task.run.viewer_steps = viewer_steps(&job->options.train);
    if (rc == OXL_OK && imaging_hides(&job->imaging))
        job->stage_viewers = schedule_viewer_steps(task.run.viewer_steps);
    if (rc == OXL_OK) blocks_set_merged(job, merged.sh_degree, steps, &task.train);
    if (rc == OXL_OK) rc = job_train_task(job, &task);
    oxl_model_free(job->ctx, &merged);
    return rc;
}

/* ---------------- all stages */

/* Trains one stage unless its folder's record says that it is finished; waits as long as another process
 * trains there. stage: its fraction of the run. */
static oxl_result blocks_make(struct blocks *b, int block, double stage,
                              oxl_result (*train)(struct blocks *b, int block, const char *folder))
{
    struct job *job = b->job;
    const char *folder = JOB_BLOCK(job, block);
    struct block_record record = {0};
    oxl_lock *lock;
    oxl_result rc = lock_wait(job->ctx, folder, NULL, &lock);
    job->block = block, job->stage = stage;
    if (rc == OXL_OK) rc = job_read_record(job, folder, &record);
    if (rc == OXL_OK && record.finished) job->done_before += stage;
    else if (rc == OXL_OK) {
        rc = train(b, block, folder);
        if (rc == OXL_OK) rc = block_read(job->ctx, folder, job->key.data, &record);
    }
    oxl_unlock_folder(job->ctx, &lock);
    job->done += stage;
    if (rc == OXL_OK) job_add_record(job, &record);
    return rc;
}

OXL_INTERNAL oxl_result blocks_run(struct job *job)
{
    struct blocks b = {.job = job};
    const int blocks = job->partition.block_count, only = job->options.block;
    const double merged = block_plan_merged_fraction(job), part = 1 - JOB_COARSE - merged;
    oxl_result rc = blocks_make(&b, JOB_COARSE_MODEL, JOB_COARSE, blocks_train_coarse);
    for (int k = 0; k < blocks && rc == OXL_OK && !job->unfinished; k++)
        if (only < 0 || only == k) rc = blocks_make(&b, k, part / blocks, blocks_train_block);
    oxl_model_free(job->ctx, &b.coarse);
    if (rc == OXL_OK && !job->unfinished && only < 0)
        rc = blocks_make(&b, JOB_MERGED_MODEL, merged, blocks_train_merged);
    /* Counts a step on a window as its fraction of the image. */
    job->total.number[BLOCK_ITERATIONS] = job->options.train.iterations;
    return rc;
}
