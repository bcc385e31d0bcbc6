/* start.c - finds a start other than the survey's points: the model of --from, or the finished result in OUT.
 *
 * A larger --iterations on a finished OUT of one block continues it: blocks/000/model.ply and imaging.txt are
 * copied to blocks/start, and the missing steps are those of a refinement (train_refinement): the number of
 * Gaussians does not change, the rates are those before the cool-down, Adam's moments start at zero, and the
 * cool-down comes at the end. The checkpoint of the first run no longer exists, so the result differs from
 * that of one longer run. --from has the schedule of a whole run.
 *
 * Invariant: the line "found" of run.json has the checksum of the model, so the key of the block depends on
 * its bytes.
 */
#include "job.h"
#include "../formats/formats.h"

#include "../formats/json.h"

/* Copies a file completely or not at all; removes the target if the file is missing. */
static oxl_result start_copy(oxl_context *ctx, const char *from, const char *to, const char *name)
{
    struct os_file_map map = {0};
    const char *target = PATH(to, "%s", name);
    oxl_result rc = OXL_OK;
    if (!os_is_file(PATH(from, "%s", name))) os_remove(target);
    else rc = os_read_file(ctx, PATH(from, "%s", name), &map);
    if (rc == OXL_OK && map.data) rc = os_write_file(ctx, target, map.data, map.size);
    os_release_file(ctx, &map);
    return rc;
}

/* Copies blocks/000 to blocks/start. */
static oxl_result start_back_up(oxl_context *ctx, const char *out, const char *start)
{
    oxl_result rc = oxl_make_folder(ctx, start);
    if (rc == OXL_OK) rc = start_copy(ctx, PATH(out, "blocks/000"), start, "imaging.txt");
    return rc == OXL_OK ? start_copy(ctx, PATH(out, "blocks/000"), start, "model.ply") : rc;
}

/* Returns the iterations of the finished run that is continued; 0: the runs differ by more than a larger
 * number of iterations. */
static int start_of_finished(const struct job *job, const struct oxl_manifest *run)
{
    const double was = oxl_json_number(oxl_json_member(run->text, "job"), "iterations");
    return run->finished && was > 0 && was < job->options.train.iterations &&
                   manifest_differences(run, job->line.data, NULL) == 1 &&
                   manifest_differences(run, job->found.data, NULL) == 0
               ? (int)was
               : 0;
}

/* Reads the model to start from; adds its size and checksum to "found". */
static oxl_result start_read(oxl_context *ctx, const char *path, int after, struct text *found,
                             oxl_model *model)
{
    struct os_file_map map = {0};
    oxl_result rc = os_read_file(ctx, path, &map);
    if (rc != OXL_OK) return rc;
    found->data[found->size - 1] = 0; /* Removes the closing brace. */
    found->size--;
    text_add(found, ", \"start\": {\"after\": %d, \"bytes\": %zu, \"checksum\": \"%016llx\"}}", after,
             map.size, (unsigned long long)checksum_add(CHECKSUM_SEED, map.data, map.size));
    os_release_file(ctx, &map);
    rc = oxl_model_read(ctx, path, model);
    if (rc == OXL_OK && model->scale > 0) oxl_model_rescale(model, 1 / model->scale);
    return rc;
}

OXL_INTERNAL oxl_result start_find(struct job *job, const struct oxl_manifest *run)
{
    const char *folder = PATH(job->out, "blocks/start"), *kept = PATH(folder, "model.ply"),
               *path = job->options.from;
    const double was =
        oxl_json_number(oxl_json_member(oxl_json_member(run->text, "found"), "start"), "after");
    const int same = manifest_has(run, &job->line);
    struct start *start = &job->start;
    oxl_result rc = OXL_OK;
    if (!job->options.restart && job->options.block < 0) {
        /* Continues the same run if it was under way or is finished, or else a finished one. */
        if (same && was > 0) start->after = (int)OXL_MIN(was, INT_MAX); /* 0: a start by --from */
        else if (!same) start->after = start_of_finished(job, run);
        if (start->after > 0 && !same && os_is_file(PATH(job->out, "partition.txt")))
            return oxl_fail(
                job->ctx, OXL_ERR_USAGE,
                "%s holds the finished result of %d iterations in several blocks: only one block can "
                "be continued\nfix: --restart trains it anew; or name another folder by -o",
                job->out, start->after);
        if (start->after > 0 && !same) rc = start_back_up(job->ctx, job->out, folder);
        if (start->after > 0) path = kept;
    }
    if (rc == OXL_OK && path) rc = start_read(job->ctx, path, start->after, &job->found, &start->model);
    if (rc == OXL_OK && start->after > 0 && !same)
        oxl_log(job->ctx, OXL_LOG_INFO,
                "the finished run of %d iterations continues for %d more, without density control",
                start->after, job->options.train.iterations - start->after);
    return rc;
}

OXL_INTERNAL oxl_result start_check(oxl_context *ctx, const struct start *start, int blocks)
{
    if (start->model.count == 0 || blocks == 1) return OXL_OK;
    return oxl_fail(ctx, OXL_ERR_USAGE,
                    "--from can start one block only, but the survey is cut into %d\nfix: add "
                    "--partition none",
                    blocks);
}

OXL_INTERNAL oxl_result start_use(oxl_context *ctx, oxl_scene *scene, const char *out, struct start *start,
                                  struct block_task *task)
{
    if (start->model.count == 0) return OXL_OK;
    if (task->train.max_gaussians > 0 && start->model.count > (size_t)task->train.max_gaussians)
        return oxl_fail(
            ctx, OXL_ERR_USAGE,
            "the model to start from has %zu Gaussians, but only %d are allowed\nfix: use a larger "
            "--max-gaussians or --ram",
            start->model.count, task->train.max_gaussians);
    if (start->after == 0) {
        task->run.from = &start->model;
        return OXL_OK;
    }
    task->run.start = &start->model;
    task->train =
        train_refinement(&task->train, start->model.sh_degree, task->train.iterations - start->after);
    return imaging_read_beside(ctx, PATH(out, "blocks/start/model.ply"), scene, task->run.imaging);
}
