/* partition_job.c - the command `partition`: cuts a survey, predicts what each block costs, and exports the
 * blocks. */
#include "../large/partition.h"
#include "job.h"
#include "../formats/formats.h"
#include "../survey/scene.h"

static oxl_block partition_predict(const struct partition *p, int block, const oxl_job_options *o)
{
    const struct partition_block *b = &p->block[block];
    const struct cost_load load = cost_load_of_block(p, block);
    oxl_job_options fitted = *o;
    budget_fit(&load, &fitted);
    return (oxl_block){b->points, b->start_points, b->base_views, b->border_views,
                       cost_memory(&fitted, &load, cost_gaussians(&fitted, &load))};
}

static oxl_result partition_report(oxl_context *ctx, const struct partition *p, const oxl_job_options *o,
                                   oxl_partition_report *out)
{
    out->block = oxl_alloc(ctx, (size_t)p->block_count, sizeof *out->block);
    if (!out->block) return OXL_ERR_MEMORY;
    out->block_count = p->block_count;
    for (int i = 0; i < p->block_count; i++) out->block[i] = partition_predict(p, i, o);
    return OXL_OK;
}

void oxl_partition_report_free(oxl_context *ctx, oxl_partition_report *report)
{
    oxl_free(ctx, report->block);
    *report = (oxl_partition_report){0};
}

oxl_result oxl_partition(oxl_context *ctx, const char *scene_path, const char *out,
                         const oxl_job_options *options, oxl_partition_report *report)
{
    oxl_job_options o = options ? *options : oxl_job_options_default(OXL_PRESET_DRAFT);
    const char *images = survey_folder((char[PATH_LENGTH]){0}, scene_path, o.scene.images, "images");
    oxl_scene *scene = NULL;
    struct partition p = {0};
    oxl_lock *lock = NULL;
    oxl_result rc = out_check_inputs(ctx, out, scene_path, &o.scene);
    if (report) *report = (oxl_partition_report){0};
    if (rc == OXL_OK && o.scene.read_images && !os_is_folder(images)) {
        oxl_log(ctx, OXL_LOG_INFO, "%s does not exist: blocks are cut from the model alone", images);
        o.scene.read_images = 0;
    }
    if (rc == OXL_OK) rc = oxl_scene_load(ctx, scene_path, &o.scene, &scene);
    if (rc == OXL_OK) rc = oxl_lock_folder(ctx, out, &lock);
    if (rc == OXL_OK)
        o.train.iterations = cost_iterations(&o, scene->stats.images_listed - scene->stats.images_missing);
    if (rc == OXL_OK) rc = budget_partition(ctx, scene, &o, &p);
    if (rc == OXL_OK) o.ram = (size_t)p.memory;
    if (rc == OXL_OK && report) rc = partition_report(ctx, &p, &o, report);
    if (rc == OXL_OK) rc = partition_export(ctx, &p, out);
    if (rc != OXL_OK && report) oxl_partition_report_free(ctx, report);
    oxl_unlock_folder(ctx, &lock);
    partition_free(ctx, &p);
    oxl_scene_free(ctx, scene);
    return rc;
}
