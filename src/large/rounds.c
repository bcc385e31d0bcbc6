/* rounds.c - trains several blocks as one model (docs/SCALE.md).
 *
 * 1. The coarse model takes the first JOB_COARSE of the run, on the whole survey, in blocks/coarse.
 * 2. Each block continues the run with the coarse model's Gaussians in its box, on the windows of the views
 *    in which they are visible. The context, all other Gaussians, is rendered and not trained. So the merged
 *    model is the blocks' models side by side.
 * 3. The runs of the blocks pause JOB_ROUNDS times. In a round a block sees its neighbours, the blocks with
 *    which it shares a view, as of this round if they precede it, otherwise as of the round before: two
 *    neighbours never correct the same error at the same time. It sees other blocks in the coarse model.
 * 4. The last stage of the run trains the merged model on all views, in blocks/whole, and lets it grow once
 *    to the allowed number.
 *
 * Invariant: the context of a round is a function of survey and options, not of the process or the order of
 * training. A process with --block K trains that block, and others while it waits for them.
 */
#include "job_state.h"
#include "../formats/formats.h"
#include "../render/render.h"
#include "../survey/scene.h"
#include "../model/model.h"
#include "os_job.h"

/* Splits Gaussians of the merged model once more after this fraction of its steps (docs/log/SCALE.md). */
#define ROUNDS_GROWTH 0.25

struct rounds {
    struct job *job;
    struct block_plan *plan; /* (blocks) */
    uint8_t *checked;        /* (blocks) 1: rounds_check_shared has checked the block */
    oxl_model coarse;        /* around the survey's origin */
};

/* ---------------- the coarse model */

/* Warns if a medium is requested and the tracks do not give it: training would fit it from MEDIUM_FIT_FROM of
 * a run on, and the coarse model ends before. */
static void rounds_warn_of_medium(const struct job *job)
{
    if (job->options.train.medium != OXL_ON || job->imaging.medium.on) return;
    oxl_log(
        job->ctx, OXL_LOG_WARNING,
        "--medium on: the tracks do not show a medium, and several blocks do not train it: it stays off\nfix: --partition none");
}

static oxl_result rounds_train_coarse(struct job *job, const char *folder)
{
    const oxl_callback callback = {job_progress, job};
    struct block_task task = {.folder = folder,
                              .imaging = &job->imaging,
                              .key = job->key.data,
                              .callback = &callback,
                              .train = job->options.train,
                              .until = (int)OXL_MAX(1, JOB_COARSE * job->options.train.iterations)};
    oxl_result rc = job->scene ? OXL_OK : job_load(job);
    job->block = JOB_COARSE_MODEL;
    job->stage = JOB_COARSE;
    job->stage_first = 0, job->stage_until = task.until;
    if (rc == OXL_OK) {
        const struct cost_load load = cost_load_of_scene(job->scene);
        oxl_job_options o = job->options;
        if (!budget_limit_gaussians(&load, &o)) rc = budget_refuse(job->ctx, &load, &o, 0);
        job_set_cache(job, o.scene.image_cache_bytes);
        task.train = o.train;
        task.predicted_peak = cost_memory(&o, &load, cost_gaussians(&o, &load));
    }
    task.train.keep.kind = OXL_KEEP_ALL;
    if (task.train.dropout < 0) task.train.dropout = 0; /* In blocks `auto` is off. */
    job_limit_time(job, &task.train);
    if (rc == OXL_OK) oxl_log(job->ctx, OXL_LOG_INFO, "coarse model of the survey: %d steps", task.until);
    if (rc == OXL_OK) rc = block_train(job->ctx, job->scene, &task);
    if (rc == OXL_OK) rounds_warn_of_medium(job);
    return rc;
}

static int rounds_coarse_is_done(const struct job *job, const struct block_record *record)
{
    return record->exists &&
           record->iterations >= (int)OXL_MAX(1, JOB_COARSE * job->options.train.iterations);
}

/* Trains the coarse model and makes the plans that follow from it. */
static oxl_result rounds_prepare(struct job *job)
{
    const char *folder = JOB_BLOCK(job, JOB_COARSE_MODEL);
    struct block_record record = {0};
    struct block_plan last = {0};
    oxl_model coarse = {0};
    int missing = 0; /* 1: a plan is missing or damaged; all are made again from the same coarse model */
    oxl_result rc = job_read_record(job, folder, &record);
    if (rc == OXL_OK && rounds_coarse_is_done(job, &record)) job->done_before = JOB_COARSE;
    else if (rc == OXL_OK) {
        rc = rounds_train_coarse(job, folder);
        if (rc == OXL_OK) rc = block_read(job->ctx, folder, job->key.data, &record);
        job->unfinished += rc == OXL_OK && !rounds_coarse_is_done(job, &record);
    }
    job->done = JOB_COARSE;
    for (int k = job->partition.block_count - 1; k >= 0 && rc == OXL_OK && !job->unfinished && !missing;
         k--) {
        block_plan_free(job->ctx, &last);
        rc = block_plan_read(job, k, &last);
        missing = last.views == 0;
    }
    if (rc == OXL_OK && !job->unfinished && missing) {
        rc = job->scene ? OXL_OK : job_load(job);
        if (rc == OXL_OK) rc = job_read_model(job, JOB_COARSE_MODEL, 0, &coarse);
        if (rc == OXL_OK) rc = block_plan_make(job, &coarse);
    }
    block_plan_free(job->ctx, &last);
    oxl_model_free(job->ctx, &coarse);
    return rc;
}

/* Trains the coarse model and makes the plans in one of several processes, while the others wait. */
static oxl_result rounds_prepare_shared(struct job *job)
{
    const char *folder = JOB_BLOCK(job, JOB_COARSE_MODEL);
    oxl_lock *lock = NULL;
    struct block_plan last = {0};
    oxl_result rc = OXL_OK;
    while (rc == OXL_OK && !lock && last.views == 0) {
        rc = block_plan_read(job, job->partition.block_count - 1, &last);
        if (rc == OXL_OK && last.views == 0) rc = lock_folder_if_free(job->ctx, folder, &lock);
        if (rc == OXL_OK && last.views == 0 && !lock) rc = os_wait(job->ctx, JOB_WAIT);
    }
    if (rc == OXL_OK && lock) rc = rounds_prepare(job);
    job->done = JOB_COARSE;
    block_plan_free(job->ctx, &last);
    oxl_unlock_folder(job->ctx, &lock);
    return rc;
}

/* ---------------- what a block sees of the others */

/* Marks in keep (count) the Gaussians that may show in a view of the block. */
static void rounds_mark_visible(const struct rounds *r, const struct block_plan *plan, const oxl_model *model,
                                uint8_t *keep)
{
    const oxl_scene *scene = r->job->scene;
    const double near = oxl_scene_near_plane(scene);
#pragma omp parallel for schedule(dynamic, 1024) num_threads(r->job->ctx->threads)
    for (int64_t i = 0; i < (int64_t)model->count; i++) {
        keep[i] = 0;
        for (int v = 0; v < plan->views && !keep[i]; v++)
            keep[i] =
                plan->shows[v] && block_plan_shows(&oxl_scene_view(scene, v)->camera, near, model, (size_t)i);
    }
}

/* Appends the Gaussians of another block that may be visible: of its model, if it is a neighbour and has
 * begun, otherwise of the coarse model. */
static oxl_result rounds_add_block(struct rounds *r, int block, int of, oxl_model *context)
{
    struct job *job = r->job;
    const struct block_plan *plan = &r->plan[block];
    const char *folder = JOB_BLOCK(job, of);
    uint8_t *keep = NULL;
    struct block_record record = {0};
    oxl_model model = {0}, rest = {0};
    oxl_result rc = OXL_OK;
    if (rc == OXL_OK && plan->neighbour[of]) rc = block_read(job->ctx, folder, job->key.data, &record);
    if (rc == OXL_OK)
        rc = record.exists ? job_read_model(job, of, 0, &model)
                           : block_plan_split(job, of, &r->coarse, &model, &rest);
    if (rc == OXL_OK && !(keep = oxl_alloc(job->ctx, model.count + 1, 1))) rc = OXL_ERR_MEMORY;
    if (rc == OXL_OK) rounds_mark_visible(r, plan, &model, keep);
    if (rc == OXL_OK) rc = merge_rows(job->ctx, &model, keep, context);
    oxl_model_free(job->ctx, &model);
    oxl_model_free(job->ctx, &rest);
    oxl_free(job->ctx, keep);
    return rc;
}

static oxl_result rounds_context(struct rounds *r, int block, oxl_model *context)
{
    oxl_result rc = oxl_model_create(r->job->ctx, 0, 0, context);
    memcpy(context->origin, r->coarse.origin, sizeof context->origin);
    for (int of = 0; of < r->job->partition.block_count && rc == OXL_OK; of++)
        if (of != block) rc = rounds_add_block(r, block, of, context);
    return rc;
}

/* ---------------- a block's round */

/* Returns the options of the block's part of the run. Divides numbers of Gaussians and bytes by the blocks'
 * fractions of the pixels. */
static oxl_train_options rounds_options(const struct job *job, const struct block_plan *plan)
{
    oxl_train_options o = job->options.train;
    const double scale = (double)plan->iterations / o.iterations;
    o.survey_iterations = o.iterations;
    o.iterations = plan->iterations;
    if (o.densify_every > 0) o.densify_every = (int)OXL_MAX(1, o.densify_every * scale + 0.5);
    o.max_gaussians = (int)OXL_MIN(plan->gaussians, INT_MAX);
    if (o.keep.kind == OXL_KEEP_COUNT) o.keep.value = OXL_MAX(1, floor(o.keep.value * plan->fraction));
    if (o.keep.kind == OXL_KEEP_BYTES) o.keep.value *= plan->fraction;
    if (o.medium == OXL_ON) o.medium = OXL_AUTO; /* Keeps the medium that the coarse model has. */
    if (o.dropout < 0) o.dropout = 0;
    return o;
}

/* Reads the coarse model's gains, with which the block begins, and its lamp and medium, which it keeps. */
static oxl_result rounds_read_imaging(struct job *job)
{
    imaging_free(job->ctx, &job->imaging);
    return imaging_read_beside(job->ctx, PATH(JOB_BLOCK(job, JOB_COARSE_MODEL), "model.ply"), job->scene,
                               &job->imaging);
}

/* Limits the block's Gaussians so that they fit --ram, less the bytes of the context, and --device-ram. Where
 * the context leaves no room for growth, their number stays. Present Gaussians need no safety margin. */
static oxl_result rounds_budget(const struct job *job, const oxl_model *context, const oxl_model *own,
                                struct block_task *task)
{
    const double beside = (double)context->count * (4.0 * oxl_model_planes(context) + COST_SPLAT_BYTES);
    struct cost_load load = cost_load_of_scene(job->scene);
    oxl_job_options o = job->options;
    struct block_record before = {0}; /* of the block's last round, if there was one */
    const oxl_result rc = block_read(job->ctx, task->folder, task->key, &before);
    const size_t has = OXL_MAX(own->count, before.gaussians);
    if (rc != OXL_OK) return rc;
    o.train = task->train;
    load.points = own->count;
    if (o.ram) o.ram = (double)o.ram > beside ? o.ram - (size_t)beside : 1;
    if (o.device_ram) load.context = (double)context->count / (double)OXL_MAX(own->count, (size_t)1);
    if (o.ram || o.device_ram) {
        const int limited = budget_limit_gaussians(&load, &o),
                  holds =
                      (!o.ram || cost_memory(&o, &load, (double)has) <= (double)o.ram) &&
                      (!o.device_ram || cost_device_memory(&o, &load, (double)has) <= (double)o.device_ram);
        if (!limited || ((size_t)o.train.max_gaussians < has && !holds)) {
            o = job->options, o.train = task->train;
            return budget_refuse(job->ctx, &load, &o, beside);
        }
        o.train.max_gaussians = OXL_MAX(o.train.max_gaussians, (int)has);
        o.train.max_gaussians = OXL_MIN(o.train.max_gaussians, task->train.max_gaussians);
    }
    job_set_cache(job, o.scene.image_cache_bytes);
    task->train = o.train;
    task->predicted_peak = cost_memory(&o, &load, cost_gaussians(&o, &load)) + beside;
    return OXL_OK;
}

/* Returns 1 for a block without Gaussians, or without a window in any view, as in a survey that is wholly
 * black: it keeps the coarse model's Gaussians. */
static int rounds_has_nothing_to_train(const struct block_plan *plan, const oxl_model *own)
{
    int windows = 0;
    for (int v = 0; v < plan->views; v++) windows += plan->window[v].width > 0;
    return own->count == 0 || windows == 0;
}

/* Writes the files of a block that has nothing to train. */
static oxl_result rounds_write_block(struct job *job, int block, const struct block_task *task,
                                     const oxl_model *own)
{
    const struct block_record record = {.iterations = task->until, .gaussians = own->count, .idle = 1};
    const char *path = PATH(JOB_BLOCK(job, block), "model.ply");
    oxl_result rc = model_file_write_ply(job->ctx, path, own, own->sh_degree);
    if (rc == OXL_OK)
        rc = block_write_finished(job->ctx, job->scene, &job->imaging, task->folder, task->key, &record);
    return rc;
}

static oxl_result rounds_train(struct rounds *r, int block, int round, const char *folder)
{
    struct job *job = r->job;
    const struct block_plan *plan = &r->plan[block];
    const oxl_callback callback = {job_progress, job};
    oxl_model own = {0}, others = {0}, context = {0};
    struct block_task task = {.folder = folder,
                              .imaging = &job->imaging,
                              .key = job->key.data,
                              .callback = &callback,
                              .train = rounds_options(job, plan),
                              .start = &own,
                              .context = &context,
                              .window = plan->window,
                              .first = plan->first,
                              .until = block_plan_until(plan, round)};
    oxl_result rc;
    job->block = block;
    job->stage = plan->work / JOB_ROUNDS;
    job->stage_first = round > 0 ? block_plan_until(plan, round - 1) : plan->first,
    job->stage_until = task.until;
    job_limit_time(job, &task.train);
    rc = rounds_read_imaging(job);
    if (rc == OXL_OK) rc = block_plan_split(job, block, &r->coarse, &own, &others);
    oxl_model_free(job->ctx, &others);
    if (rc == OXL_OK && rounds_has_nothing_to_train(plan, &own))
        rc = rounds_write_block(job, block, &task, &own);
    else {
        if (rc == OXL_OK) rc = rounds_context(r, block, &context);
        if (rc == OXL_OK) rc = rounds_budget(job, &context, &own, &task);
        if (rc == OXL_OK) rc = block_train(job->ctx, job->scene, &task);
    }
    oxl_model_free(job->ctx, &own);
    oxl_model_free(job->ctx, &context);
    return rc;
}

/* Counts the rounds that a block has finished. */
static oxl_result rounds_completed(struct rounds *r, int block, int *done)
{
    const char *folder = JOB_BLOCK(r->job, block);
    struct block_record record = {0};
    const oxl_result rc = block_read(r->job->ctx, folder, r->job->key.data, &record);
    *done = 0;
    while (rc == OXL_OK && *done < JOB_ROUNDS && record.exists &&
           record.iterations >= block_plan_until(&r->plan[block], *done))
        ++*done;
    return rc;
}

static oxl_result rounds_step(struct rounds *r, int block, int round)
{
    struct job *job = r->job;
    const char *folder = JOB_BLOCK(job, block);
    int done = 0;
    oxl_result rc = rounds_train(r, block, round, folder);
    if (rc == OXL_OK) rc = rounds_completed(r, block, &done);
    job->unfinished += rc == OXL_OK && done <= round;
    job->done += job->stage;
    return rc;
}

/* ---------------- what a fault has changed */

/* Sets *good to 1 if the block's files are those of the rounds in its record, and its neighbours have done
 * the rounds that it saw. A model newer than its record is good: it is written again from the checkpoint. */
static oxl_result rounds_check_block(struct rounds *r, int block, int *good)
{
    struct job *job = r->job;
    const char *folder = JOB_BLOCK(job, block);
    struct block_record record = {0};
    int done = 0, step;
    oxl_result rc = block_read(job->ctx, folder, job->key.data, &record);
    *good = !record.damaged;
    if (rc != OXL_OK || !record.exists) return rc;
    step = checkpoint_step(job->ctx, folder, job->key.data);
    if (record.iterations < r->plan[block].last && !record.idle) *good = step >= record.iterations;
    if (*good && step <= record.iterations) rc = block_check(job->ctx, folder, &record, good);
    if (rc == OXL_OK) rc = rounds_completed(r, block, &done);
    for (int j = 0; j < job->partition.block_count && rc == OXL_OK && *good && done > 0; j++) {
        int other = 0;
        if (j == block || !r->plan[block].neighbour[j]) continue;
        rc = rounds_completed(r, j, &other);
        *good = other >= (j < block ? done : done - 1);
    }
    return rc;
}

/* Removes the progress of all blocks after the coarse model: a block gives the same bytes again
 * only with the same context. */
static void rounds_go_back(struct rounds *r, int block)
{
    struct job *job = r->job;
    oxl_log(
        job->ctx, OXL_LOG_WARNING,
        "%s: the state of this block is damaged or missing, and others have been trained beside it: all blocks "
        "begin again with the coarse model",
        JOB_BLOCK(job, block));
    for (int k = 0; k < job->partition.block_count; k++) {
        os_remove(PATH(JOB_BLOCK(job, k), "block.json"));
        checkpoint_remove(JOB_BLOCK(job, k));
    }
}

static oxl_result rounds_check_all(struct rounds *r)
{
    oxl_result rc = OXL_OK;
    for (int k = 0; k < r->job->partition.block_count && rc == OXL_OK; k++) {
        int good = 1;
        rc = rounds_check_block(r, k, &good);
        if (rc != OXL_OK || good) continue;
        rounds_go_back(r, k);
        break;
    }
    return rc;
}

/* Checks a block in one of several processes, and fails instead of going back: others may be
 * training the other blocks. */
static oxl_result rounds_check_shared(struct rounds *r, int block)
{
    int good = 1;
    const oxl_result rc = r->checked[block] ? OXL_OK : rounds_check_block(r, block, &good);
    r->checked[block] = 1;
    if (rc != OXL_OK || good) return rc;
    return oxl_fail(
        r->job->ctx, OXL_ERR_INPUT,
        "%s: the state of this block is damaged or missing, and others have been trained beside it\n"
        "fix: when no other process trains here: oceanxl train %s -o %s, which begins all blocks again",
        JOB_BLOCK(r->job, block), SHELL_WORD(r->job->scene_path), SHELL_WORD(r->job->out));
}

/* ---------------- all rounds of all blocks */

static oxl_result rounds_run_blocks(struct rounds *r)
{
    oxl_result rc = OXL_OK;
    for (int round = 0; round < JOB_ROUNDS; round++)
        for (int k = 0; k < r->job->partition.block_count && rc == OXL_OK && !r->job->unfinished; k++) {
            int done = 0;
            rc = rounds_completed(r, k, &done);
            if (rc == OXL_OK && done > round)
                r->job->done += r->plan[k].work / JOB_ROUNDS,
                    r->job->done_before += r->plan[k].work / JOB_ROUNDS;
            else if (rc == OXL_OK) rc = rounds_step(r, k, round);
        }
    return rc;
}

/* Sets *ready to 1 if the neighbours have done the rounds that the block's next round sees. */
static oxl_result rounds_is_ready(struct rounds *r, int block, int round, int *ready)
{
    oxl_result rc = OXL_OK;
    *ready = 1;
    for (int j = 0; j < r->job->partition.block_count && rc == OXL_OK && *ready; j++) {
        int done = JOB_ROUNDS;
        if (j != block && r->plan[block].neighbour[j]) rc = rounds_completed(r, j, &done);
        *ready = done >= (j < block ? round + 1 : round);
    }
    return rc;
}

/* Trains the next round of a block, if no other process does and its neighbours are ready.
 * *trained: it was trained. */
static oxl_result rounds_try(struct rounds *r, int block, int *trained)
{
    struct job *job = r->job;
    const char *folder = JOB_BLOCK(job, block);
    oxl_lock *lock = NULL;
    int round = 0, ready = 0;
    oxl_result rc = lock_folder_if_free(job->ctx, folder, &lock);
    *trained = 0;
    if (rc == OXL_OK && lock) rc = rounds_check_shared(r, block);
    if (rc == OXL_OK && lock) rc = rounds_completed(r, block, &round);
    if (rc == OXL_OK && lock && round < JOB_ROUNDS) rc = rounds_is_ready(r, block, round, &ready);
    if (rc == OXL_OK && ready) {
        rc = rounds_step(r, block, round);
        *trained = 1;
    }
    oxl_unlock_folder(job->ctx, &lock);
    return rc;
}

/* Trains one block to its end; while it waits for other blocks, it trains them
 * unless another process does. */
static oxl_result rounds_run_block(struct rounds *r, int block)
{
    const int blocks = r->job->partition.block_count;
    int done = 0, trained = 0;
    oxl_result rc = rounds_completed(r, block, &done);
    while (rc == OXL_OK && done < JOB_ROUNDS && !r->job->unfinished) {
        trained = 0;
        for (int k = 0; k < blocks && rc == OXL_OK && !trained && !r->job->unfinished; k++)
            rc = rounds_try(r, (block + k) % blocks, &trained);
        if (rc == OXL_OK && !trained) rc = os_wait(r->job->ctx, JOB_WAIT);
        if (rc == OXL_OK) rc = rounds_completed(r, block, &done);
    }
    return rc;
}

static oxl_result rounds_begin(struct rounds *r)
{
    struct job *job = r->job;
    const int blocks = job->partition.block_count;
    oxl_result rc = job_read_model(job, JOB_COARSE_MODEL, 0, &r->coarse);
    r->plan = oxl_calloc(job->ctx, (size_t)blocks, sizeof *r->plan);
    r->checked = oxl_calloc(job->ctx, (size_t)blocks, 1);
    if (rc == OXL_OK && (!r->plan || !r->checked)) rc = OXL_ERR_MEMORY;
    for (int k = 0; k < blocks && rc == OXL_OK; k++) {
        rc = block_plan_read(job, k, &r->plan[k]);
        if (rc == OXL_OK && r->plan[k].views == 0)
            rc = oxl_fail(
                job->ctx, OXL_ERR_INPUT,
                "%s/blocks/%03d/plan.txt is missing or damaged\nfix: delete %s/blocks, and train again",
                job->out, k, SHELL_WORD(job->out));
    }
    if (rc == OXL_OK && !job->scene) rc = job_load(job);
    for (int k = 0; k < blocks && rc == OXL_OK; k++)
        if (!block_plan_fits(&r->plan[k], job->scene))
            rc = oxl_fail(job->ctx, OXL_ERR_INPUT,
                          "%s/blocks/%03d/plan.txt is of other views\nfix: delete %s/blocks, and train again",
                          job->out, k, SHELL_WORD(job->out));
    return rc;
}

static void rounds_end(struct rounds *r)
{
    for (int k = 0; k < r->job->partition.block_count && r->plan; k++)
        block_plan_free(r->job->ctx, &r->plan[k]);
    OXL_FREE(r->job->ctx, r->plan, r->checked);
    oxl_model_free(r->job->ctx, &r->coarse);
}

/* ---------------- the merged model */

/* Returns the options of the merged model, which grows once by the Gaussians that the blocks have left of the
 * allowed number and memory holds. */
static oxl_train_options rounds_merged_options(const struct job *job, int sh_degree)
{
    const struct cost_load load = cost_load_of_scene(job->scene);
    const int step = (int)ceil(ROUNDS_GROWTH * job->stage_until);
    oxl_job_options o = job->options;
    o.train = train_refinement(&job->options.train, sh_degree, job->stage_until);
    if (block_plan_merged_fraction(job) == JOB_MERGED && job->options.train.densify_until > 0 &&
        budget_limit_gaussians(&load, &o)) {
        /* Sets the image cache, which the Gaussians have to fit beside. */
        job_set_cache(job, o.scene.image_cache_bytes);
        o.train.densify_every = step;
        o.train.densify_until = (float)((step + 0.5) / job->stage_until);
    }
    return o.train;
}

static oxl_result rounds_refine_merged(struct job *job, const char *folder, oxl_model *merged)
{
    const oxl_callback callback = {job_progress, job};
    struct block_task task = {.folder = folder,
                              .imaging = &job->imaging,
                              .key = job->key.data,
                              .callback = &callback,
                              .start = merged,
                              .train = rounds_merged_options(job, merged->sh_degree),
                              .viewer_steps = viewer_steps(&job->options.train)};
    if (viewer_hides(&job->imaging)) job->stage_viewers = viewer_hiding_steps(task.viewer_steps);
    job_limit_time(job, &task.train);
    oxl_log(job->ctx, OXL_LOG_INFO, "merged model: %d steps", job->stage_until);
    return block_train(job->ctx, job->scene, &task);
}

/* Merges the blocks' models, and trains the merged one. */
static oxl_result rounds_make_merged(struct job *job)
{
    const char *folder = JOB_BLOCK(job, JOB_MERGED_MODEL);
    struct block_record record = {0};
    oxl_model merged = {0};
    oxl_result rc = job_read_record(job, folder, &record);
    job->block = JOB_MERGED_MODEL;
    job->stage = block_plan_merged_fraction(job);
    job->stage_first = 0;
    job->stage_until = (int)OXL_MAX(1, job->stage * job->options.train.iterations);
    if (rc == OXL_OK && !record.finished) {
        rc = job_merge(job, 0, &merged);
        if (rc == OXL_OK) rc = rounds_refine_merged(job, folder, &merged);
        if (rc == OXL_OK) rc = block_read(job->ctx, folder, job->key.data, &record);
        job->unfinished += rc == OXL_OK && !record.finished;
    }
    if (rc == OXL_OK && record.exists) {
        job_add_record(job, &record);
        job->total.iterations = job->options.train.iterations;
    }
    oxl_model_free(job->ctx, &merged);
    return rc;
}

/* ---------------- records */

static oxl_result rounds_block_is_missing(struct job *job, int block, const struct block_record *record,
                                          int *missing)
{
    struct block_plan plan = {0};
    const oxl_result rc = block_plan_read(job, block, &plan);
    const int done = plan.views > 0 && record->exists && record->iterations >= plan.last;
    if (rc == OXL_OK && !done && *missing < 0) *missing = block;
    block_plan_free(job->ctx, &plan);
    return rc;
}

/* Adds the records of the coarse model and the blocks; *missing: the first block
 * that is not finished, or -1. */
static oxl_result rounds_add_records(struct job *job, int *missing)
{
    oxl_result rc = OXL_OK;
    *missing = -1;
    for (int k = 0; k <= job->partition.block_count && rc == OXL_OK; k++) {
        const int block = k < job->partition.block_count ? k : JOB_COARSE_MODEL;
        struct block_record record = {0};
        rc = block_read(job->ctx, JOB_BLOCK(job, block), job->key.data, &record);
        if (block == JOB_COARSE_MODEL) record.gaussians = 0;
        else if (rc == OXL_OK) rc = rounds_block_is_missing(job, block, &record, missing);
        record.finished = 1; /* Counts the record as finished; *missing says if it is not. */
        if (rc == OXL_OK) job_add_record(job, &record);
    }
    /* Counts a step on a window as its fraction of the image. */
    job->total.iterations = job->options.train.iterations;
    return rc;
}

OXL_INTERNAL oxl_result rounds_run(struct job *job)
{
    struct rounds r = {.job = job};
    int missing;
    oxl_result rc = job->options.block >= 0 ? rounds_prepare_shared(job) : rounds_prepare(job);
    if (job->options.block >= 0) job->done_before = job->done;
    if (rc != OXL_OK || job->unfinished) return rc;
    rc = rounds_begin(&r);
    if (rc == OXL_OK && job->options.block < 0) rc = rounds_check_all(&r);
    if (rc == OXL_OK)
        rc = job->options.block >= 0 ? rounds_run_block(&r, job->options.block) : rounds_run_blocks(&r);
    rounds_end(&r);
    if (rc == OXL_OK && !job->unfinished && job->options.block < 0) rc = rounds_add_records(job, &missing);
    if (rc == OXL_OK && !job->unfinished && job->options.block < 0) rc = rounds_make_merged(job);
    return rc;
}

OXL_INTERNAL oxl_result rounds_collect(struct job *job)
{
    int missing = -1;
    oxl_result rc = rounds_add_records(job, &missing);
    if (rc != OXL_OK) return rc;
    if (missing < 0) return rounds_make_merged(job);
    return oxl_fail(job->ctx, OXL_ERR_INPUT,
                    "%s/blocks/%03d: this block is not finished\nfix: oceanxl train %s -o %s --block %d",
                    job->out, missing, SHELL_WORD(job->scene_path), SHELL_WORD(job->out), missing);
}
