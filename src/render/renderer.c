/* renderer.c - chains the kernels: the forward pass of a view (renderer_loss.c: loss and backward pass;
 * renderer_step.c: optimizer step).
 *
 * The functions run on the CPU, or call those of a device (backends/vulkan/renderer.c).
 *
 * Invariant: parallel loops are over independent packs, strips or tiles, so the result does not depend on the
 * number of threads.
 */
#include "renderer_state.h"

#define RENDER_TILE_COST 16 /* cost of an empty tile, in (tile, splat) pairs */

oxl_render_options oxl_render_options_default(void)
{
    return (oxl_render_options){.sh_degree = -1, .near_plane = 0.2f, .alpha_min = ALPHA_MIN};
}

OXL_INTERNAL oxl_render_options render_options_of(const oxl_scene *scene)
{
    oxl_render_options o = oxl_render_options_default();
    o.near_plane = (float)oxl_scene_near_plane(scene);
    return o;
}

/* Warns once of each kind of failure: a device that is lost, or too small, is so for all images that
 * follow. */
static oxl_result render_say_cpu(oxl_context *ctx, const char *why)
{
    const int kind = 1 << ctx->failed;
    if (!(ctx->backend->fell_back & kind))
        oxl_log(ctx, OXL_LOG_WARNING, "%.*s: continuing on the CPU", (int)strcspn(why, "\n"), why);
    ctx->backend->fell_back |= kind;
    return OXL_OK;
}

/* Returns 1 if a device failed, or had not enough memory, and the CPU may do what it could not, with
 * --backend auto. */
static int render_can_fall_back(const oxl_context *ctx, oxl_result rc)
{
    return (rc == OXL_ERR_MEMORY || rc == OXL_ERR_FAILED) && ctx->options.backend == OXL_BACKEND_AUTO;
}

OXL_INTERNAL oxl_result renderer_create(oxl_context *ctx, struct renderer **out)
{
    oxl_result rc = backend_begin(ctx);
    *out = NULL;
    if (rc != OXL_OK) return rc;
    *out = oxl_calloc(ctx, 1, sizeof **out);
    if (!*out) return OXL_ERR_MEMORY;
    (*out)->backend = ctx->backend->functions;
    if ((*out)->backend) rc = (*out)->backend->create(ctx, &(*out)->device);
    if (render_can_fall_back(ctx, rc)) rc = render_say_cpu(ctx, ctx->error);
    if (rc == OXL_OK) return rc;
    oxl_free(ctx, *out);
    *out = NULL;
    return rc;
}

OXL_INTERNAL void renderer_free(oxl_context *ctx, struct renderer *r)
{
    if (!r) return;
    renderer_use_cpu(r);
    bin_free(ctx, &r->bins);
    loss_free(ctx, &r->loss);
    oxl_model_free(ctx, &r->part);
    OXL_FREE(ctx, r->splat, r->lobe, r->visible, r->dmean2d, r->rgb, r->drgb, r->transmittance, r->target,
             r->exposed, r->lamp_map, r->medium_pack, r->pose_sum, r->weight, r->sums, r->score,
             r->tile_range, r);
}

/* ---------------- into the kernels' terms */

/* Returns the camera of a window: the limits and units of the projection are those of the full image. */
static void render_set_full_size(struct kernel_camera *k, const oxl_camera *c,
                                 const struct renderer_window *w)
{
    if (w->width == 0) return;
    k->half_width = 0.5f * (float)w->width;
    k->half_height = 0.5f * (float)w->height;
    k->limit_x = (float)(FRUSTUM_CLAMP * w->width / (2 * c->fx));
    k->limit_y = (float)(FRUSTUM_CLAMP * w->height / (2 * c->fy));
}

OXL_INTERNAL struct renderer_settings *renderer_settings(struct renderer *r)
{
    return &r->set;
}

OXL_INTERNAL struct gaussians render_gaussians(const oxl_model *m, int sh_degree)
{
    struct gaussians g = {.count = m->count, .lobes = m->lobes};
    g.sh_degree = sh_degree < 0 || sh_degree > m->sh_degree ? m->sh_degree : sh_degree;
    for (int k = 0; k < OXL_PLANES; k++) g.plane[k] = m->plane[k];
    return g;
}

OXL_INTERNAL size_t render_packs(size_t count)
{
    return (count + PACK - 1) / PACK;
}

static oxl_result render_reserve(oxl_context *ctx, struct renderer *r, size_t packs, size_t lobes,
                                 size_t pixels)
{
    const size_t rows = packs * PACK;
    oxl_result rc = OXL_RESERVE(ctx, r->splat, rows);
    if (rc == OXL_OK) rc = OXL_RESERVE(ctx, r->tile_range, (size_t)ctx->threads);
    if (rc == OXL_OK) rc = OXL_RESERVE(ctx, r->lobe, lobes);
    if (rc == OXL_OK) rc = OXL_RESERVE(ctx, r->visible, rows / PACK + 1);
    if (rc == OXL_OK) rc = OXL_RESERVE(ctx, r->rgb, 3 * pixels);
    if (rc == OXL_OK) rc = OXL_RESERVE(ctx, r->transmittance, pixels);
    return rc;
}

/* ---------------- from a device to the CPU */

/* Copies the image of renderer_set_image, since the loss is not computed yet. */
static oxl_result render_download_target(oxl_context *ctx, struct renderer *r)
{
    const size_t pixels = r->backend->target(r->device, NULL, NULL, &r->masked);
    oxl_result rc = OXL_RESERVE(ctx, r->target, 3 * pixels);
    if (rc == OXL_OK && r->masked) rc = OXL_RESERVE(ctx, r->weight, pixels);
    if (rc == OXL_OK && pixels > 0 && r->backend->target(r->device, r->target, r->weight, &r->masked) == 0)
        rc = ctx->failed;
    return rc;
}

/* Replaces a device without enough memory by the CPU, with --backend auto, unless steps are to be reported
 * yet. With anew the CPU begins anew, as all that it needs is the caller's; then a lost device is replaced,
 * too. Returns rc in all other cases. */
OXL_INTERNAL oxl_result render_fall_back_to_cpu(oxl_context *ctx, struct renderer *r, oxl_result rc, int anew)
{
    char why[160];
    if (!r->device || !render_can_fall_back(ctx, rc) || (rc != OXL_ERR_MEMORY && !anew) || r->deferred)
        return rc;
    snprintf(why, sizeof why, "%.159s", ctx->error);
    rc = anew ? OXL_OK : render_download_target(ctx, r);
    if (rc == OXL_OK && !anew) rc = r->backend->download(r->device, DOWNLOAD_TO_CHANGE);
    if (rc != OXL_OK) return rc;
    renderer_use_cpu(r);
    return render_say_cpu(ctx, why);
}

/* ---------------- forward */

static int64_t render_tasks_of(size_t packs)
{
    return (int64_t)((packs + RENDER_TASK - 1) / RENDER_TASK);
}

/* Returns the number of tasks over the model's rows, without the surroundings. */
OXL_INTERNAL int64_t render_tasks(const struct renderer *r)
{
    return render_tasks_of(r->packs);
}

OXL_INTERNAL struct project_job render_project_job(struct renderer *r, int64_t task)
{
    return (struct project_job){.in = r->in,
                                .kernel_camera = &r->kernel_camera,
                                .first_pack = (size_t)task * RENDER_TASK,
                                .end_pack = OXL_MIN((size_t)(task + 1) * RENDER_TASK, r->packs),
                                .splat = r->splat,
                                .lobe = r->lobe,
                                .visible = r->visible,
                                .medium = r->set.medium.on ? &r->set.medium : NULL,
                                .medium_pack = r->medium_pack,
                                .sums = (const float(*)[SPLAT_SUMS])r->sums,
                                .dmean2d = r->dmean2d};
}

/* Returns a task over the rows of the surroundings. */
static struct project_job render_context_job(struct renderer *r, int64_t task)
{
    return (struct project_job){.in = render_gaussians(r->surroundings, r->surroundings->sh_degree),
                                .kernel_camera = &r->kernel_camera,
                                .first_pack = (size_t)task * RENDER_TASK,
                                .end_pack =
                                    OXL_MIN((size_t)(task + 1) * RENDER_TASK, r->bins.packs - r->packs),
                                .splat = r->splat + r->packs * PACK,
                                .lobe = r->lobe ? r->lobe + r->in.lobes : NULL,
                                .visible = r->visible + r->packs,
                                .medium = r->set.medium.on ? &r->context_medium : NULL,
                                .medium_pack = r->medium_pack ? r->medium_pack + r->packs : NULL};
}

/* Drops out a task's rows after their projection [Park 2025]. Box and contour stay those of the undivided
 * opacity: what the division adds beyond them, below alpha_min / (1 - fraction), may be missing. Backward
 * needs nothing: d alpha / d logit = alpha (1 - o), whatever factor alpha has. */
static void render_drop(const struct renderer *r, const struct project_job *job)
{
    const struct renderer_dropout drop = r->set.dropout;
    const uint64_t most = (uint64_t)(drop.fraction * 4294967296.0);
    const float gain = (float)(-vecmath_log(1 - drop.fraction) / VECMATH_LN2);
    const size_t first = (size_t)(job->splat - r->splat); /* row 0 of the job */
    for (size_t pack = job->first_pack; pack < job->end_pack; pack++)
        for (size_t l = 0, row = pack * PACK; l < PACK; l++, row++) {
            if (!(job->visible[pack] >> l & 1)) continue;
            if (random_bits(drop.seed, first + row, (uint64_t)drop.step) >> 32 < most)
                job->visible[pack] &= (uint16_t) ~(1u << l);
            job->splat[row].peak += gain;
            if (row < job->in.lobes) job->lobe[row].peak += gain;
        }
}

static void render_project(oxl_context *ctx, struct renderer *r)
{
    const int64_t own = render_tasks(r), tasks = own + render_tasks_of(r->bins.packs - r->packs);
#pragma omp parallel for schedule(dynamic) num_threads(ctx->threads)
    for (int64_t task = 0; task < tasks; task++) {
        const struct project_job job =
            task < own ? render_project_job(r, task) : render_context_job(r, task - own);
        project_forward(ctx->isa, &job);
        if (r->set.dropout.fraction > 0) render_drop(r, &job);
    }
}

/* Replaces, for parallel rays, the depths of visible splats, rounded far away, by those from the camera,
 * and hides the splats in front of its near plane. */
static void render_measure_depths(oxl_context *ctx, struct renderer *r, const oxl_camera *camera,
                                  float near_plane)
{
    const double *row = camera->rotation + 6;
    const size_t packs = r->packs;
    (void)ctx; /* without OpenMP */
#pragma omp parallel for schedule(static) num_threads(ctx->threads)
    for (int64_t pack = 0; pack < (int64_t)packs; pack++)
        for (size_t l = 0, i = (size_t)pack * PACK; l < PACK; l++, i++) {
            double z = camera->translation[2];
            if (!(r->visible[pack] >> l & 1)) continue;
            for (int k = 0; k < 3; k++) z += row[k] * (double)r->in.plane[OXL_MEAN + k][i];
            r->splat[i].depth = (float)z;
            if (!(r->splat[i].depth > near_plane)) r->visible[pack] &= (uint16_t) ~(1u << l);
        }
}

/* ---------------- the medium */

static oxl_result render_begin_medium(oxl_context *ctx, struct renderer *r)
{
    const oxl_result rc = OXL_RESERVE(ctx, r->medium_pack, r->bins.packs + 1);
    if (rc != OXL_OK) return rc;
    r->context_medium = r->set.medium;
    r->context_medium.training_range = 0;
    memcpy(r->background, r->set.medium.veiling_light, sizeof r->background);
    return OXL_OK;
}

OXL_INTERNAL void render_add_task_sums(struct renderer *r)
{
    memset(r->dpose, 0, sizeof r->dpose);
    for (int64_t task = 0; r->set.pose && task < render_tasks(r); task++)
        for (int k = 0; k < POSE_SUMS; k++) r->dpose[k] += r->pose_sum[task][k];
}

OXL_INTERNAL void renderer_use_cpu(struct renderer *r)
{
    if (r->device) r->backend->free(r->device);
    r->device = NULL;
}

OXL_INTERNAL void renderer_set_surroundings(struct renderer *r, const oxl_model *surroundings)
{
    r->surroundings = surroundings && surroundings->count > 0 ? surroundings : NULL;
    if (r->surroundings && r->surroundings->lobes > 0) renderer_use_cpu(r);
}

OXL_INTERNAL int renderer_has_device(const struct renderer *r)
{
    return r->device != NULL;
}

static struct raster_job render_raster_job(struct renderer *r, int tile, const float *drgb)
{
    return (struct raster_job){.bins = &r->bins,
                               .width = r->kernel_camera.width,
                               .height = r->kernel_camera.height,
                               .tile = tile,
                               .background = {r->background[0], r->background[1], r->background[2]},
                               .rgb = r->rgb,
                               .transmittance = r->transmittance,
                               .depth = r->depth,
                               .depth_scale = r->parallel,
                               .drgb = drgb,
                               .sums = r->sums,
                               .score = r->score};
}

/* Parts of about equal work. A thread keeps the same part of the image in all stages, for its cache, and
 * threads share cache lines only at the borders of parts. */
static void render_divide_tiles(const oxl_context *ctx, struct renderer *r)
{
    const int tiles = r->bins.tiles_x * r->bins.tiles_y;
    const uint64_t whole = r->bins.pair_count + RENDER_TILE_COST * (uint64_t)tiles;
    for (int k = 0, tile = 0; k < ctx->threads; k++) {
        const uint64_t end = whole * (uint64_t)(k + 1) / (uint64_t)ctx->threads;
        r->tile_range[k].next = tile;
        while (tile < tiles && r->bins.tile_start[tile + 1] + RENDER_TILE_COST * (uint64_t)(tile + 1) <= end)
            tile++;
        r->tile_range[k].end = tile;
    }
}

static void render_draw_tiles(struct renderer *r, struct render_tile_range *range, int isa, const float *drgb,
                              render_tile_fn *work)
{
    for (int tile = 0; tile < range->end;) {
#ifdef _OPENMP
#pragma omp atomic capture
#endif
        tile = range->next++;
        if (tile < range->end) {
            const struct raster_job job = render_raster_job(r, tile, drgb);
            work(isa, &job);
        }
    }
}

/* Composites the tiles: each thread processes its own part, then tiles of other parts. */
OXL_INTERNAL void render_each_tile(oxl_context *ctx, struct renderer *r, const float *drgb,
                                   render_tile_fn *work)
{
    render_divide_tiles(ctx, r);
#pragma omp parallel for schedule(static, 1) num_threads(ctx->threads)
    for (int own = 0; own < ctx->threads; own++)
        for (int k = 0; k < ctx->threads; k++)
            render_draw_tiles(r, &r->tile_range[(own + k) % ctx->threads], ctx->isa, drgb, work);
}

static void render_take_view(struct renderer *r, const oxl_model *model, const oxl_camera *camera,
                             const oxl_render_options *options)
{
    const oxl_camera far = render_far_camera(camera, options);
    r->packs = render_packs(model->count);
    r->in = render_gaussians(model, options->sh_degree);
    r->kernel_camera = render_kernel_camera(&far, options->parallel > 0 ? 0 : options->near_plane);
    render_set_full_size(&r->kernel_camera, camera, &r->set.window);
    render_set_alpha_min(&r->kernel_camera, options->alpha_min);
    r->kernel_camera.antialias = model->antialias;
}

/* Allocates and prepares for the parallel regions of forward, after render_take_view. */
static oxl_result render_begin(oxl_context *ctx, struct renderer *r, const oxl_model *model,
                               const oxl_camera *camera, const oxl_render_options *options)
{
    const size_t packs = r->packs, others = r->surroundings ? render_packs(r->surroundings->count) : 0;
    const size_t lobes = r->surroundings ? r->surroundings->lobes : 0;
    const oxl_result rc =
        render_reserve(ctx, r, packs + others, model->lobes + lobes, (size_t)camera->width * camera->height);
    if (rc != OXL_OK) return rc;
    r->parallel = options->parallel;
    memcpy(r->background, options->background, sizeof r->background);
    r->bins.alpha_min = r->kernel_camera.alpha_min;
    r->bins.cutoff_bits = r->kernel_camera.cutoff_bits;
    r->bins.packs = packs + others;
    r->bins.splat = r->splat;
    r->bins.lobe = r->lobe;
    r->bins.lobes = model->lobes;
    r->bins.visible = r->visible;
    r->bins.surroundings_row = packs * PACK;
    r->bins.surroundings_lobes = lobes;
    return OXL_OK;
}

OXL_INTERNAL oxl_result renderer_forward(oxl_context *ctx, struct renderer *r, const oxl_model *model,
                                         const oxl_camera *camera, const oxl_render_options *options)
{
    oxl_result rc;
    render_take_view(r, model, camera, options);
    if (r->device) {
        r->bins.packs = r->packs;
        rc = OXL_RESERVE(ctx, r->rgb, 3 * (size_t)camera->width * camera->height);
        if (rc == OXL_OK)
            rc = r->backend->forward(r->device, model, camera, options, &r->kernel_camera, r->surroundings,
                                     &r->set);
        rc = render_fall_back_to_cpu(ctx, r, rc, 0);
        if (rc == OXL_OK && r->device) ctx->backend->rendered_on |= RENDERED_ON_DEVICE;
        if (rc != OXL_OK || r->device) return rc;
    }
    rc = render_begin(ctx, r, model, camera, options);
    if (rc == OXL_OK && r->set.medium.on) rc = render_begin_medium(ctx, r);
    if (rc != OXL_OK) return rc;
    render_project(ctx, r);
    if (options->parallel > 0) render_measure_depths(ctx, r, camera, options->near_plane);
    rc = bin_splats(ctx, &r->bins, camera->width, camera->height);
    if (rc == OXL_OK) render_each_tile(ctx, r, NULL, raster_forward);
    if (rc == OXL_OK) ctx->backend->rendered_on |= RENDERED_ON_CPU;
    return rc;
}

OXL_INTERNAL oxl_result renderer_image(struct renderer *r, const float **out)
{
    *out = r->rgb;
    return r->device ? r->backend->image(r->device, r->rgb) : OXL_OK;
}
