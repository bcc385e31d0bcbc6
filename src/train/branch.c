/* branch.c - keeps the training state in memory, so that a trial continues from one state with several
 * settings, and one result is kept. */
#include "parts_calls.h"

/* Lists the state that a step changes, for trials and, with what else is saved, for checkpoints. */
OXL_INTERNAL void branch_archive(struct archive *a, void *user)
{
    struct train *t = user;
    size_t views = (size_t)t->views;
    archive_int(a, &t->step);
    archive_doubles(a, &t->loss, 1);
    archive_doubles(a, &t->psnr, 1);
    archive_size(a, &views);
    archive_expect(a, t->step >= 0 && t->step <= t->options->iterations);
    archive_expect(a, views <= (size_t)schedule_training_views(t->scene));
    if (a->rc == OXL_OK) archive_ints(a, t->view, views);
    for (size_t i = 0; i < views && a->rc == OXL_OK; i++)
        archive_expect(a, t->view[i] >= 0 && t->view[i] < oxl_scene_view_count(t->scene));
    for (int k = 0; k < TRAINED_PARTS; k++) archive_model(a, model_trained_part(&t->trained, k));
    density_archive(a, t->density, t->trained.model.count);
    parts_archive(a, t, 1);
    if (a->reading && a->rc == OXL_OK) t->views = (int)views;
}

OXL_INTERNAL void branch_free(struct train *t, struct train_branch *b)
{
    oxl_free(t->ctx, b->memory.data);
    *b = (struct train_branch){0};
}

OXL_INTERNAL oxl_result branch_save(struct train *t, struct train_branch *out)
{
    const oxl_result rc = step_download(t, DOWNLOAD_TO_READ);
    return rc == OXL_OK ? archive_to_memory(t->ctx, &out->memory, branch_archive, t) : rc;
}

OXL_INTERNAL oxl_result branch_load(struct train *t, struct train_branch *b)
{
    const oxl_result rc = step_download(t, DOWNLOAD_TO_CHANGE);
    return rc == OXL_OK ? archive_from_memory(t->ctx, &b->memory, branch_archive, t) : rc;
}
