/* branch.c - copies of the training state: a trial continues from one state with several settings, and one
 * result is kept. */
#include "train_state.h"

OXL_INTERNAL void branch_free(struct train *t, struct train_branch *b)
{
    model_trained_free(t->ctx, &b->trained);
    density_free(t->ctx, b->density);
    exposure_free(t->ctx, &b->exposure);
    oxl_free(t->ctx, b->view);
    *b = (struct train_branch){0};
}

OXL_INTERNAL oxl_result branch_copy(struct train *t, struct train_branch *out)
{
    oxl_result rc = step_download(t, DOWNLOAD_TO_READ);
    *out = (struct train_branch){.views = t->views, .step = t->step, .loss = t->loss, .psnr = t->psnr};
    out->view = oxl_alloc(t->ctx, (size_t)t->views + (size_t)t->validation_views + 1, sizeof *out->view);
    if (!out->view)
        return oxl_fail(t->ctx, OXL_ERR_MEMORY,
                        "no memory for a trial\nfix: --sh-degree and --dog by name need none");
    memcpy(out->view, t->view, (size_t)t->views * sizeof *out->view);
    if (rc == OXL_OK) rc = density_copy(t->ctx, t->density, t->trained.model.count, &out->density);
    for (int k = 0; rc == OXL_OK && k < TRAINED_PARTS; k++)
        rc = model_copy(t->ctx, model_trained_part(&t->trained, k), model_trained_part(&out->trained, k));
    out->medium_fit = t->medium_fit;
    out->lamp = t->lamp;
    out->ucd = t->ucd;
    if (rc == OXL_OK) rc = exposure_copy(t->ctx, &t->exposure, &out->exposure);
    return rc;
}

OXL_INTERNAL oxl_result branch_swap(struct train *t, struct train_branch *b)
{
    const oxl_result rc = step_download(t, DOWNLOAD_TO_CHANGE);
    if (rc != OXL_OK) return rc;
    OXL_SWAP(struct trained_model, t->trained, b->trained);
    OXL_SWAP(struct density *, t->density, b->density);
    OXL_SWAP(int *, t->view, b->view);
    OXL_SWAP(int, t->views, b->views);
    OXL_SWAP(int, t->step, b->step);
    OXL_SWAP(double, t->loss, b->loss);
    OXL_SWAP(double, t->psnr, b->psnr);
    OXL_SWAP(struct exposure, t->exposure, b->exposure);
    OXL_SWAP(struct medium_fit, t->medium_fit, b->medium_fit);
    OXL_SWAP(struct lamp_fit, t->lamp, b->lamp);
    OXL_SWAP(struct ucd, t->ucd, b->ucd);
    return OXL_OK;
}

/* Copies `start` to t, and the former state of t to `other`. */
OXL_INTERNAL oxl_result branch_restart(struct train *t, struct train_branch *start,
                                       struct train_branch *other)
{
    oxl_result rc;
    branch_free(t, other);
    rc = branch_swap(t, start);
    if (rc != OXL_OK) return rc;
    *other = *start;
    return branch_copy(t, start);
}
