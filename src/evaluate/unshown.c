/* unshown.c - which pixels of a held-out view no training view shows.
 *
 * The place of a pixel lies at the depth that is rendered there. A training view shows it if the place is in
 * its image and no surface that it renders hides the place. What no training view shows is a guess of the
 * model, so metrics are given without these pixels, too.
 */
#include "evaluate.h"
#include "../survey/scene.h"
#include "../survey/sparse.h"

enum { UNSHOWN_SIDE = 200 };   /* px; longer side to which views are halved */
#define UNSHOWN_TOLERANCE 0.05 /* of a place's depth: a surface nearer by more hides it */

static size_t unshown_pixels(const struct unshown *u)
{
    return (size_t)u->camera.width * u->camera.height;
}

OXL_INTERNAL oxl_result unshown_draw(oxl_context *ctx, const struct drawn *d, int view, struct unshown *u)
{
    oxl_render_options options = render_options_of(d->scene);
    oxl_image image = {0};
    oxl_result rc;
    u->camera = scene_camera(d->scene, d->imaging, view);
    while (OXL_MAX(u->camera.width, u->camera.height) > UNSHOWN_SIDE) u->camera = camera_halve(&u->camera);
    oxl_free(ctx, u->depth);
    u->depth = oxl_alloc(ctx, unshown_pixels(u), sizeof *u->depth);
    rc = u->depth ? renderer_draw(ctx, d->r, d->model, &u->camera, &options, &image, u->depth)
                  : OXL_ERR_MEMORY;
    oxl_image_free(ctx, &image);
    return rc;
}

/* Marks the pixels of u whose place the training view `by` shows. */
static void unshown_ask(const struct unshown *by, struct unshown *u)
{
    const int width = u->camera.width;
    for (size_t i = 0; i < unshown_pixels(u); i++) {
        const double pixel[2] = {(double)(i % (size_t)width) + 0.5, (double)(i / (size_t)width) + 0.5};
        double place[3], x[3], at[2], own;
        if (u->is_shown[i]) continue;
        camera_unproject(&u->camera, pixel, fabs((double)u->depth[i]), place);
        if (!camera_sees(&by->camera, place, x, at)) continue;
        own = fabs((double)by->depth[(size_t)at[1] * (size_t)by->camera.width + (size_t)at[0]]);
        u->is_shown[i] = own == 0 || own >= (1 - UNSHOWN_TOLERANCE) * x[2];
    }
}

OXL_INTERNAL oxl_result unshown_find(oxl_context *ctx, const struct drawn *d, const int *view, int count,
                                     struct unshown *u)
{
    const int is_composited = scene_is_composited(d->scene);
    struct unshown by = {.depth = NULL};
    oxl_result rc = OXL_OK;
    for (int k = 0; k < count && rc == OXL_OK; k++) {
        rc = unshown_draw(ctx, d, view[k], &u[k]);
        if (rc == OXL_OK) u[k].is_shown = oxl_calloc(ctx, unshown_pixels(&u[k]), 1);
        if (rc == OXL_OK && !u[k].is_shown) rc = OXL_ERR_MEMORY;
        /* All views show the background of an object. */
        for (size_t i = 0; rc == OXL_OK && is_composited && i < unshown_pixels(&u[k]); i++)
            u[k].is_shown[i] = u[k].depth[i] == 0;
    }
    for (int v = 0; v < d->scene->view_count && rc == OXL_OK; v++) {
        if (d->scene->view[v].is_test) continue;
        rc = context_stopped(ctx);
        if (rc == OXL_OK) rc = unshown_draw(ctx, d, v, &by);
        if (rc != OXL_OK) break;
#pragma omp parallel for schedule(dynamic) num_threads(ctx->threads)
        for (int k = 0; k < count; k++) unshown_ask(&by, &u[k]);
    }
    oxl_free(ctx, by.depth);
    return rc;
}

OXL_INTERNAL void unshown_free(oxl_context *ctx, struct unshown *u, int count)
{
    for (int k = 0; u && k < count; k++) OXL_FREE(ctx, u[k].depth, u[k].is_shown);
    oxl_free(ctx, u);
}

OXL_INTERNAL oxl_result unshown_measure(oxl_context *ctx, const struct unshown *u, const oxl_image *rendered,
                                        const oxl_image *image, oxl_view_metrics *row)
{
    const int width = image->width, height = image->height;
    oxl_image part = *image;
    double used = 0, shown = 0;
    oxl_result rc = OXL_ERR_MEMORY;
    part.weight = oxl_alloc(ctx, (size_t)width * height, sizeof *part.weight);
    for (int i = 0; part.weight && i < width * height; i++) {
        const int x = i % width, y = i / width, quarter = 2 * (2 * y >= height) + (2 * x >= width),
                  column = (int)((int64_t)x * u->camera.width / width),
                  line = (int)((int64_t)y * u->camera.height / height),
                  is_shown = u->is_shown[line * u->camera.width + column];
        const float weight = image->weight ? image->weight[i] : 1;
        part.weight[i] = is_shown ? weight : 0;
        used += weight, shown += part.weight[i];
        row->unshown[quarter] += is_shown ? 0 : weight;
    }
    for (int k = 0; k < 4; k++) row->unshown[k] /= OXL_MAX(1, used);
    row->shown_psnr = NAN;
    if (part.weight) rc = shown > 0 ? oxl_psnr(ctx, rendered, &part, &row->shown_psnr) : OXL_OK;
    oxl_free(ctx, part.weight);
    return rc;
}
