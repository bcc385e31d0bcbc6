/* unseen.c - removes the Gaussians that no training view shows.
 *
 * A Gaussian is shown by a view if its opacity changes a pixel of it: its score there, the sum over pixels of
 * (o dS/dalpha)^2 with S the sum of the image (raster.c), is not 0. The background is white, as a black
 * Gaussian before black changes nothing.
 *
 * Invariant: the image of a training view does not change; rows keep their order.
 */
#include "trained.h"
#include "../render/render.h"
#include "../survey/scene.h"

struct unseen {
    struct renderer *r;
    float *drgb; /* (3,H,W) ones, the gradient of the sum of the image */
    size_t pixels;
    float *score; /* (count) sum of the scores over the views so far */
};

static oxl_result unseen_add_view(oxl_context *ctx, struct unseen *u, const oxl_model *model,
                                  const oxl_scene *scene, int view)
{
    const oxl_camera *camera = &scene->view[view].camera;
    const size_t pixels = 3 * (size_t)camera->width * camera->height, before = u->pixels;
    oxl_render_options options = render_options_of(scene);
    oxl_result rc = oxl_reserve(ctx, &u->drgb, &u->pixels, pixels, sizeof *u->drgb);
    for (size_t i = before; rc == OXL_OK && i < u->pixels; i++) u->drgb[i] = 1;
    for (int c = 0; c < 3; c++) options.background[c] = 1;
    for (int again = 1; again && rc == OXL_OK;) {
        const int on = renderer_has_device(u->r);
        rc = renderer_forward(ctx, u->r, model, camera, &options);
        if (rc == OXL_OK) rc = renderer_score(ctx, u->r, u->drgb, u->score);
        /* Repeats the view if the device was lost, since nothing was added. */
        again = on && !renderer_has_device(u->r);
    }
    return rc;
}

OXL_INTERNAL oxl_result unseen_drop(oxl_context *ctx, const oxl_scene *scene, oxl_model *model)
{
    const size_t count = model->count;
    struct unseen u = {.score = oxl_calloc(ctx, count + 1, sizeof *u.score)};
    uint8_t *keep = oxl_alloc(ctx, count + 1, 1);
    oxl_result rc = u.score && keep ? renderer_create(ctx, &u.r) : OXL_ERR_MEMORY;
    for (int v = 0; v < scene->view_count && rc == OXL_OK; v++)
        if (!scene->view[v].is_test) rc = unseen_add_view(ctx, &u, model, scene, v);
    for (size_t i = 0; i < count && rc == OXL_OK; i++)
        keep[i] = u.score[i] != 0; /* keeps a NaN, which is not known to be unseen */
    if (rc == OXL_OK) model_keep_rows(model, keep);
    renderer_free(ctx, u.r);
    OXL_FREE(ctx, u.score, u.drgb, keep);
    return rc;
}
