/* renderer.c - chains the kernels: forward pass of a view, loss, backward pass, optimizer step.
 *
 * The functions run on the CPU, or call those of a device (backends/vulkan/renderer.c).
 *
 * Invariant: parallel loops are over independent packs, strips or tiles, so the result does not depend on the number of threads.
 */
#include "kernels.h"
#include "../core/vecmath.h"

#define RENDER_TASK      64 /* packs per task: 1024 Gaussians, one page of a plane */
#define RENDER_TILE_COST 16 /* cost of an empty tile, in pairs */

/* Consecutive tiles that a thread starts with. */
struct render_share {
    int  next, end;
    char apart[64 - 2 * sizeof(int)]; /* on a cache line of its own */
};

struct renderer {
    const struct renderer_device *backend; /* of `device` */
    void                         *device;  /* NULL: the CPU renders, with the members below */
    int                           deferred;

    struct kernel_camera kernel_camera;
    float                background[3];
    struct gaussians     in;
    int                  full[2]; /* of renderer_set_window, */
    float                at[2];   /* too */
    const oxl_model     *context; /* rendered behind the model's rows and left alone; or NULL */
    size_t               packs;   /* of the model: those of the context follow */
    struct splat        *splat;   /* (count) */
    struct lobe         *lobe;    /* (lobes) */
    uint16_t            *visible; /* (packs) */
    float               *dmean2d; /* (count) */
    float               *rgb, *drgb, *transmittance;
    struct medium        medium;
    struct medium_pack  *medium_pack;  /* (packs) with a medium */
    double (*medium_sum)[MEDIUM_SUMS]; /* (tasks) */
    double             dmedium[MEDIUM_SUMS];
    size_t             medium_pack_capacity, medium_sum_capacity;
    float              gain[3]; /* of renderer_set_gain */
    int                has_gain;
    const struct lamp *lamp;     /* of renderer_set_lamp, or NULL */
    float             *exposed;  /* (3,H,W) rgb times gain and lamp */
    float             *lamp_map; /* (H,W) the lamp's gain; after the loss: dL/d(its logarithm) */
    double             dlamp[LAMP_TERMS];
    size_t             exposed_capacity, lamp_capacity;
    float             *target, *weight; /* image of renderer_take_image: (3,H,W), and (H,W) if masked */
    int                masked;
    struct depth_point depth_point[DEPTH_POINTS]; /* of renderer_set_depths */
    int                depth_points;
    double             depth_weight;
    int                unprojected; /* 1: the gradient has come as far as `sums`; renderer_step goes on */
    float (*sums)[SPLAT_SUMS];
    float               *score; /* (slots) */
    struct bins          bins;
    struct loss_scratch  loss;
    struct render_share *share; /* (threads) */
    size_t share_capacity, splat_capacity, lobe_capacity, visible_capacity, dmean2d_capacity, rgb_capacity, drgb_capacity,
        transmittance_capacity, sums_capacity, score_capacity, target_capacity, weight_capacity;
};

oxl_render_options oxl_render_options_default(void)
{
    return (oxl_render_options){.sh_degree = -1, .near_plane = 0.2f, .alpha_min = ALPHA_MIN};
}

OXL_INTERNAL oxl_result renderer_create(oxl_context *ctx, struct renderer **out)
{
    oxl_result rc = backend_begin(ctx);
    *out          = NULL;
    if (rc != OXL_OK) return rc;
    *out = oxl_calloc(ctx, 1, sizeof **out);
    if (!*out) return oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for a renderer");
#ifdef OXL_VULKAN
    if (ctx->vulkan) {
        (*out)->backend = vulkan_functions();
        rc              = (*out)->backend->create(ctx, &(*out)->device);
    }
#endif
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
    oxl_free(ctx, r->splat);
    oxl_free(ctx, r->lobe);
    oxl_free(ctx, r->visible);
    oxl_free(ctx, r->dmean2d);
    oxl_free(ctx, r->rgb);
    oxl_free(ctx, r->drgb);
    oxl_free(ctx, r->transmittance);
    oxl_free(ctx, r->target);
    oxl_free(ctx, r->exposed);
    oxl_free(ctx, r->lamp_map);
    oxl_free(ctx, r->medium_pack);
    oxl_free(ctx, r->medium_sum);
    oxl_free(ctx, r->weight);
    oxl_free(ctx, r->sums);
    oxl_free(ctx, r->score);
    oxl_free(ctx, r->share);
    oxl_free(ctx, r);
}

/* ---------------------------------------------------------------- into the kernels' terms */

OXL_INTERNAL struct kernel_camera render_kernel_camera(const oxl_camera *c, float near_plane)
{
    struct kernel_camera l = {.width       = c->width,
                              .height      = c->height,
                              .half_width  = 0.5f * (float)c->width,
                              .half_height = 0.5f * (float)c->height,
                              .fx          = (float)c->fx,
                              .fy          = (float)c->fy,
                              .cx          = (float)c->cx,
                              .cy          = (float)c->cy,
                              .limit_x     = (float)(FRUSTUM_CLAMP * c->width / (2 * c->fx)),
                              .limit_y     = (float)(FRUSTUM_CLAMP * c->height / (2 * c->fy)),
                              .near_plane  = near_plane,
                              .alpha_min   = ALPHA_MIN,
                              .cut         = LOG2_255};
    double               eye[3];
    camera_position(c, eye);
    l.rotation.x  = vec3((float)c->rotation[0], (float)c->rotation[1], (float)c->rotation[2]);
    l.rotation.y  = vec3((float)c->rotation[3], (float)c->rotation[4], (float)c->rotation[5]);
    l.rotation.z  = vec3((float)c->rotation[6], (float)c->rotation[7], (float)c->rotation[8]);
    l.translation = vec3((float)c->translation[0], (float)c->translation[1], (float)c->translation[2]);
    l.eye         = vec3((float)eye[0], (float)eye[1], (float)eye[2]);
    return l;
}

/* The camera of a window: the limits and units of the projection are those of the full image. */
static void render_set_full_size(struct kernel_camera *l, const oxl_camera *c, const int full[2])
{
    if (full[0] == 0) return;
    l->half_width  = 0.5f * (float)full[0];
    l->half_height = 0.5f * (float)full[1];
    l->limit_x     = (float)(FRUSTUM_CLAMP * full[0] / (2 * c->fx));
    l->limit_y     = (float)(FRUSTUM_CLAMP * full[1] / (2 * c->fy));
}

OXL_INTERNAL void renderer_set_window(struct renderer *r, const float at[2], int full_width, int full_height)
{
    r->full[0] = full_width;
    r->full[1] = full_height;
    memcpy(r->at, at, sizeof r->at);
}

static struct lamp_area render_lamp_area(const struct renderer *r)
{
    const int width = r->kernel_camera.width, height = r->kernel_camera.height;
    if (r->full[0] == 0) return (struct lamp_area){width, height, width, height, 0, 0};
    return (struct lamp_area){width, height, r->full[0], r->full[1], r->at[0], r->at[1]};
}

OXL_INTERNAL void render_set_alpha_min(struct kernel_camera *l, float alpha_min)
{
    if (!(alpha_min > ALPHA_MIN)) return;
    l->alpha_min = OXL_MIN(alpha_min, ALPHA_MAX);
    l->cut       = (float)(-vecmath_log(l->alpha_min) * LOG2_E);
}

static struct gaussians render_gaussians(const oxl_model *m, int sh_degree)
{
    struct gaussians g = {.count = m->count, .lobes = m->lobes};
    g.sh_degree        = sh_degree < 0 || sh_degree > m->sh_degree ? m->sh_degree : sh_degree;
    for (int k = 0; k < OXL_PLANES; k++) g.plane[k] = m->plane[k];
    return g;
}

static size_t render_packs(size_t count)
{
    return (count + PACK - 1) / PACK;
}

static oxl_result render_reserve(oxl_context *ctx, struct renderer *r, size_t packs, size_t lobes, size_t pixels)
{
    const size_t rows = packs * PACK;
    oxl_result   rc   = oxl_reserve(ctx, (void **)&r->splat, &r->splat_capacity, rows, sizeof *r->splat);
    if (rc == OXL_OK) rc = oxl_reserve(ctx, (void **)&r->share, &r->share_capacity, (size_t)ctx->threads, sizeof *r->share);
    if (rc == OXL_OK) rc = oxl_reserve(ctx, (void **)&r->lobe, &r->lobe_capacity, lobes, sizeof *r->lobe);
    if (rc == OXL_OK) rc = oxl_reserve(ctx, (void **)&r->visible, &r->visible_capacity, rows / PACK + 1, sizeof *r->visible);
    if (rc == OXL_OK) rc = oxl_reserve(ctx, (void **)&r->rgb, &r->rgb_capacity, 3 * pixels, sizeof *r->rgb);
    if (rc == OXL_OK)
        rc = oxl_reserve(ctx, (void **)&r->transmittance, &r->transmittance_capacity, pixels, sizeof *r->transmittance);
    return rc;
}

/* ---------------------------------------------------------------- from a device to the CPU */

/* Copies the image of renderer_take_image, since the loss is not computed yet. */
static oxl_result render_download_target(oxl_context *ctx, struct renderer *r)
{
    const size_t pixels = r->backend->target(r->device, NULL, NULL, &r->masked);
    oxl_result   rc     = oxl_reserve(ctx, (void **)&r->target, &r->target_capacity, 3 * pixels, sizeof *r->target);
    if (rc == OXL_OK && r->masked) rc = oxl_reserve(ctx, (void **)&r->weight, &r->weight_capacity, pixels, sizeof *r->weight);
    if (rc == OXL_OK && pixels > 0 && r->backend->target(r->device, r->target, r->weight, &r->masked) == 0) rc = ctx->failed;
    return rc;
}

/* With --backend auto, a device without enough memory is replaced by the CPU, unless steps are to be reported yet. Returns rc in all
 * other cases. */
static oxl_result render_leave_device(oxl_context *ctx, struct renderer *r, oxl_result rc)
{
    char why[160];
    if (rc != OXL_ERR_MEMORY || ctx->options.backend != OXL_BACKEND_AUTO || r->deferred) return rc;
    snprintf(why, sizeof why, "%.*s", (int)strcspn(ctx->error, "\n"), ctx->error);
    rc = render_download_target(ctx, r);
    if (rc == OXL_OK) rc = r->backend->download(r->device, DOWNLOAD_TO_CHANGE);
    if (rc != OXL_OK) return rc;
    renderer_use_cpu(r);
    oxl_log(ctx, OXL_LOG_WARNING, "%s: continuing on the CPU", why);
    return OXL_OK;
}

/* ---------------------------------------------------------------- forward */

static int64_t render_tasks_of(size_t packs)
{
    return (int64_t)((packs + RENDER_TASK - 1) / RENDER_TASK);
}

/* Over the model's rows, without the context. */
static int64_t render_tasks(const struct renderer *r)
{
    return render_tasks_of(r->packs);
}

static struct project_job render_project_job(struct renderer *r, int64_t task)
{
    return (struct project_job){.in            = r->in,
                                .kernel_camera = &r->kernel_camera,
                                .first_pack    = (size_t)task * RENDER_TASK,
                                .end_pack      = OXL_MIN((size_t)(task + 1) * RENDER_TASK, r->packs),
                                .splat         = r->splat,
                                .lobe          = r->lobe,
                                .visible       = r->visible,
                                .sums          = (const float(*)[SPLAT_SUMS])r->sums,
                                .dmean2d       = r->dmean2d};
}

/* Over the context's rows. */
static struct project_job render_context_job(struct renderer *r, int64_t task)
{
    return (struct project_job){.in            = render_gaussians(r->context, r->context->sh_degree),
                                .kernel_camera = &r->kernel_camera,
                                .first_pack    = (size_t)task * RENDER_TASK,
                                .end_pack      = OXL_MIN((size_t)(task + 1) * RENDER_TASK, r->bins.packs - r->packs),
                                .splat         = r->splat + r->packs * PACK,
                                .lobe          = r->lobe + r->in.lobes,
                                .visible       = r->visible + r->packs};
}

static void render_project(oxl_context *ctx, struct renderer *r)
{
    const int64_t own = render_tasks(r), tasks = own + render_tasks_of(r->bins.packs - r->packs);
#pragma omp parallel for schedule(dynamic) num_threads(ctx->threads)
    for (int64_t task = 0; task < tasks; task++) {
        const struct project_job job = task < own ? render_project_job(r, task) : render_context_job(r, task - own);
        project_forward(ctx->isa, &job);
    }
}

/* ---------------------------------------------------------------- the medium, between the stages */

static int render_has_medium(const struct renderer *r)
{
    return r->medium.on || r->medium.lit;
}

static struct medium_job render_medium_job(struct renderer *r, int64_t task)
{
    return (struct medium_job){.medium        = &r->medium,
                               .in            = r->in,
                               .kernel_camera = &r->kernel_camera,
                               .first_pack    = (size_t)task * RENDER_TASK,
                               .end_pack      = OXL_MIN((size_t)(task + 1) * RENDER_TASK, r->packs),
                               .visible       = r->visible,
                               .splat         = r->splat,
                               .pack          = r->medium_pack,
                               .sums          = r->sums};
}

/* The context's colours are as files have them: without a shift. */
static struct medium_job render_context_medium_job(struct renderer *r, const struct medium *medium, int64_t task)
{
    const struct project_job job = render_context_job(r, task);
    return (struct medium_job){.medium        = medium,
                               .in            = job.in,
                               .kernel_camera = &r->kernel_camera,
                               .first_pack    = job.first_pack,
                               .end_pack      = job.end_pack,
                               .visible       = job.visible,
                               .splat         = job.splat,
                               .pack          = r->medium_pack + r->packs};
}

static oxl_result render_medium(oxl_context *ctx, struct renderer *r)
{
    const int64_t own = render_tasks(r), tasks = own + render_tasks_of(r->bins.packs - r->packs);
    struct medium unshifted = r->medium;
    oxl_result    rc =
        oxl_reserve(ctx, (void **)&r->medium_pack, &r->medium_pack_capacity, r->bins.packs + 1, sizeof *r->medium_pack);
    if (rc == OXL_OK)
        rc = oxl_reserve(ctx, (void **)&r->medium_sum, &r->medium_sum_capacity, (size_t)own + 1, sizeof *r->medium_sum);
    if (rc != OXL_OK) return rc;
    unshifted.shift = 0;
#pragma omp parallel for schedule(dynamic) num_threads(ctx->threads)
    for (int64_t task = 0; task < tasks; task++) {
        const struct medium_job job =
            task < own ? render_medium_job(r, task) : render_context_medium_job(r, &unshifted, task - own);
        medium_forward(ctx->isa, &job);
    }
    if (r->medium.on) memcpy(r->background, r->medium.veil, sizeof r->background);
    return OXL_OK;
}

static void render_medium_backward(oxl_context *ctx, struct renderer *r, const float *drgb)
{
    const int64_t tasks = render_tasks(r);
    (void)ctx; /* without OpenMP */
#pragma omp parallel for schedule(dynamic) num_threads(ctx->threads)
    for (int64_t task = 0; task < tasks; task++) {
        const struct medium_job job = render_medium_job(r, task);
        medium_backward(&job, r->medium_sum[task]);
    }
    memset(r->dmedium, 0, sizeof r->dmedium);
    for (int64_t task = 0; task < tasks; task++)
        for (int k = 0; k < MEDIUM_SUMS; k++) r->dmedium[k] += r->medium_sum[task][k];
    if (r->medium.on) medium_backward_veil(drgb, r->transmittance, r->kernel_camera.width, r->kernel_camera.height, r->dmedium);
}

OXL_INTERNAL void renderer_use_cpu(struct renderer *r)
{
    if (r->device) r->backend->free(r->device);
    r->device = NULL;
}

OXL_INTERNAL void renderer_set_context(struct renderer *r, const oxl_model *context)
{
    r->context = context && context->count > 0 ? context : NULL;
    if (r->context) renderer_use_cpu(r);
}

OXL_INTERNAL int renderer_has_device(const struct renderer *r)
{
    return r->device != NULL;
}

OXL_INTERNAL void renderer_set_medium(struct renderer *r, const struct medium *medium)
{
    r->medium = medium ? *medium : (struct medium){0};
}

OXL_INTERNAL const double *renderer_medium_gradient(const struct renderer *r)
{
    return r->dmedium;
}

typedef void render_tile_fn(int isa, const struct raster_job *job);

static struct raster_job render_raster_job(struct renderer *r, int tile, const float *drgb)
{
    return (struct raster_job){.bins          = &r->bins,
                               .width         = r->kernel_camera.width,
                               .height        = r->kernel_camera.height,
                               .tile          = tile,
                               .background    = {r->background[0], r->background[1], r->background[2]},
                               .rgb           = r->rgb,
                               .transmittance = r->transmittance,
                               .drgb          = drgb,
                               .sums          = r->sums,
                               .score         = r->score};
}

/* Shares of about equal work. A thread keeps the same part of the image in all stages, for its cache, and threads share cache lines
 * only at the borders of shares. */
static void render_share_tiles(const oxl_context *ctx, struct renderer *r)
{
    const int      tiles = r->bins.tiles_x * r->bins.tiles_y;
    const uint64_t whole = r->bins.pair_count + RENDER_TILE_COST * (uint64_t)tiles;
    for (int k = 0, tile = 0; k < ctx->threads; k++) {
        const uint64_t end = whole * (uint64_t)(k + 1) / (uint64_t)ctx->threads;
        r->share[k].next   = tile;
        while (tile < tiles && r->bins.tile_start[tile + 1] + RENDER_TILE_COST * (uint64_t)(tile + 1) <= end) tile++;
        r->share[k].end = tile;
    }
}

static void render_work_off(struct renderer *r, struct render_share *share, int isa, const float *drgb, render_tile_fn *work)
{
    for (int tile = 0; tile < share->end;) {
#ifdef _OPENMP
#pragma omp atomic capture
#endif
        tile = share->next++;
        if (tile < share->end) {
            const struct raster_job job = render_raster_job(r, tile, drgb);
            work(isa, &job);
        }
    }
}

/* Each thread processes its own share, then tiles of other shares. */
static void render_each_tile(oxl_context *ctx, struct renderer *r, const float *drgb, render_tile_fn *work)
{
    render_share_tiles(ctx, r);
#pragma omp parallel for schedule(static, 1) num_threads(ctx->threads)
    for (int own = 0; own < ctx->threads; own++)
        for (int k = 0; k < ctx->threads; k++) render_work_off(r, &r->share[(own + k) % ctx->threads], ctx->isa, drgb, work);
}

/* Allocates and prepares for the parallel regions of forward. */
static oxl_result render_begin(oxl_context *ctx, struct renderer *r, const oxl_model *model, const oxl_camera *camera,
                               const oxl_render_options *options)
{
    const size_t     packs = render_packs(model->count), others = r->context ? render_packs(r->context->count) : 0;
    const size_t     lobes = r->context ? r->context->lobes : 0;
    const oxl_result rc =
        render_reserve(ctx, r, packs + others, model->lobes + lobes, (size_t)camera->width * (size_t)camera->height);
    if (rc != OXL_OK) return rc;
    r->packs         = packs;
    r->kernel_camera = render_kernel_camera(camera, options->near_plane);
    render_set_full_size(&r->kernel_camera, camera, r->full);
    r->in = render_gaussians(model, options->sh_degree);
    memcpy(r->background, options->background, sizeof r->background);
    render_set_alpha_min(&r->kernel_camera, options->alpha_min);
    r->bins.alpha_min     = r->kernel_camera.alpha_min;
    r->bins.cut           = r->kernel_camera.cut;
    r->bins.packs         = packs + others;
    r->bins.splat         = r->splat;
    r->bins.lobe          = r->lobe;
    r->bins.lobes         = model->lobes;
    r->bins.visible       = r->visible;
    r->bins.context_row   = packs * PACK;
    r->bins.context_lobes = lobes;
    return OXL_OK;
}

static oxl_result render_forward_on_device(oxl_context *ctx, struct renderer *r, const oxl_model *model, const oxl_camera *camera,
                                           const oxl_render_options *options)
{
    const size_t     pixels = (size_t)camera->width * (size_t)camera->height;
    const oxl_result rc     = oxl_reserve(ctx, (void **)&r->rgb, &r->rgb_capacity, 3 * pixels, sizeof *r->rgb);
    if (rc != OXL_OK) return rc;
    r->kernel_camera = render_kernel_camera(camera, options->near_plane);
    r->in            = render_gaussians(model, options->sh_degree);
    r->packs         = render_packs(model->count);
    r->bins.packs    = r->packs;
    return r->backend->forward(r->device, model, camera, options);
}

OXL_INTERNAL oxl_result renderer_forward(oxl_context *ctx, struct renderer *r, const oxl_model *model, const oxl_camera *camera,
                                         const oxl_render_options *options)
{
    oxl_result rc;
    if (model->pages) return oxl_fail(ctx, OXL_ERR_USAGE, "a model that stays in its file can only be rendered");
    if (r->device && render_has_medium(r))
        return oxl_fail(ctx, OXL_ERR_USAGE, "water and a lamp's falloff are not rendered on a device\nfix: --backend cpu");
    if (r->device) {
        rc = render_leave_device(ctx, r, render_forward_on_device(ctx, r, model, camera, options));
        if (rc != OXL_OK || r->device) return rc;
    }
    rc = render_begin(ctx, r, model, camera, options);
    if (rc != OXL_OK) return rc;
    render_project(ctx, r);
    if (render_has_medium(r)) rc = render_medium(ctx, r);
    if (rc == OXL_OK) rc = bin_splats(ctx, &r->bins, camera->width, camera->height);
    if (rc == OXL_OK) render_each_tile(ctx, r, NULL, raster_forward);
    return rc;
}

OXL_INTERNAL oxl_result renderer_image(oxl_context *ctx, struct renderer *r, const float **out)
{
    (void)ctx;
    *out = r->rgb;
    return r->device ? r->backend->image(r->device, 0, r->rgb) : OXL_OK;
}

/* ---------------------------------------------------------------- loss and backward */

OXL_INTERNAL int renderer_has_image(const struct renderer *r, int view)
{
    return r->device && r->backend->has_image(r->device, view);
}

OXL_INTERNAL oxl_result renderer_take_image(oxl_context *ctx, struct renderer *r, int view, const struct training_image *image,
                                            const struct image_window *window, int halved)
{
    size_t     pixels;
    oxl_result rc;
    if (r->device) {
        rc = r->backend->take_image(r->device, view, image, halved);
        if (image) rc = render_leave_device(ctx, r, rc);
        if (rc != OXL_OK || r->device) return rc;
    }
    pixels    = (size_t)(window ? window->width : image->width) * (size_t)(window ? window->height : image->height);
    rc        = oxl_reserve(ctx, (void **)&r->target, &r->target_capacity, 3 * pixels, sizeof *r->target);
    r->masked = image->mask != NULL;
    if (rc == OXL_OK && r->masked) rc = oxl_reserve(ctx, (void **)&r->weight, &r->weight_capacity, pixels, sizeof *r->weight);
    if (rc != OXL_OK) return rc;
    image_from_training(ctx, image, window, r->target, r->masked ? r->weight : NULL);
    if (halved)
        image_halve(window ? window->width : image->width, window ? window->height : image->height, r->target,
                    r->masked ? r->weight : NULL);
    return OXL_OK;
}

OXL_INTERNAL void renderer_set_gain(struct renderer *r, const float gain[3])
{
    r->has_gain = gain != NULL;
    if (gain) memcpy(r->gain, gain, sizeof r->gain);
}

/* Something lies between the rendered image and the loss. */
static int render_exposes(const struct renderer *r)
{
    return r->has_gain || r->lamp;
}

OXL_INTERNAL void renderer_set_lamp(struct renderer *r, const struct lamp *lamp)
{
    r->lamp = lamp;
}

OXL_INTERNAL const double *renderer_lamp_gradient(const struct renderer *r)
{
    return r->dlamp;
}

/* y (3,n) times the lamp's gain, which lamp_map keeps. */
static void render_lamp_forward(struct renderer *r, size_t pixels, float *y)
{
    const struct lamp_area area = render_lamp_area(r);
    lamp_gain(r->lamp->shape, &area, r->lamp_map);
    for (size_t c = 0; c < 3; c++)
#pragma omp simd
        for (size_t i = 0; i < pixels; i++) y[c * pixels + i] *= r->lamp_map[i];
}

/* dx (3,n): gain (3) times dL/dy -> dL/d(rendered image); y is after the lamp. */
static void render_lamp_backward(struct renderer *r, const float gain[3], size_t pixels, const float *y, float *dx)
{
    const float            red = 1 / gain[0], green = 1 / gain[1], blue = 1 / gain[2];
    const struct lamp_area area = render_lamp_area(r);
#pragma omp simd
    for (size_t i = 0; i < pixels; i++) {
        const size_t g = i + pixels, b = i + 2 * pixels;
        const float  slope = red * (dx[i] * y[i]) + green * (dx[g] * y[g]) + blue * (dx[b] * y[b]);
        dx[i] *= r->lamp_map[i], dx[g] *= r->lamp_map[i], dx[b] *= r->lamp_map[i];
        r->lamp_map[i] = slope;
    }
    lamp_project(r->lamp_map, &area, r->dlamp);
}

/* The loss with exposure gains and lamp, on the CPU: with a lamp a device's image is downloaded and the gradient uploaded. */
static oxl_result render_exposed_loss(oxl_context *ctx, struct renderer *r, const float *rgb, const float *weight,
                                      float ssim_weight, double dlog_gain[3], struct loss_value *out)
{
    const size_t pixels = (size_t)r->kernel_camera.width * (size_t)r->kernel_camera.height;
    const float  one[3] = {1, 1, 1}, *gain = r->has_gain ? r->gain : one, *rendered = NULL;
    oxl_result   rc = renderer_image(ctx, r, &rendered);
    if (rc == OXL_OK) rc = oxl_reserve(ctx, (void **)&r->exposed, &r->exposed_capacity, 3 * pixels, sizeof *r->exposed);
    if (rc == OXL_OK && r->lamp) rc = oxl_reserve(ctx, (void **)&r->lamp_map, &r->lamp_capacity, pixels, sizeof *r->lamp_map);
    if (rc != OXL_OK) return rc;
    exposure_forward(gain, rendered, pixels, r->exposed);
    if (r->lamp) render_lamp_forward(r, pixels, r->exposed);
    rc = loss_forward_backward(
        ctx, &(struct loss_job){r->kernel_camera.width, r->kernel_camera.height, ssim_weight, r->exposed, rgb, weight, r->drgb},
        &r->loss, out);
    if (rc == OXL_OK) exposure_backward(gain, r->exposed, r->drgb, pixels, r->drgb, dlog_gain);
    if (rc == OXL_OK && r->lamp) render_lamp_backward(r, gain, pixels, r->exposed, r->drgb);
    return rc;
}

/* A pixel of a window counts as one of the full image does: the loss is a mean. */
static void render_weigh_window(struct renderer *r, size_t pixels)
{
    const float share = (float)pixels / (4 * r->kernel_camera.half_width * r->kernel_camera.half_height);
    if (share == 1) return;
#pragma omp simd
    for (size_t i = 0; i < 3 * pixels; i++) r->drgb[i] *= share;
}

OXL_INTERNAL oxl_result renderer_loss(oxl_context *ctx, struct renderer *r, const float *rgb, const float *weight,
                                      float ssim_weight, struct renderer_loss *out)
{
    const size_t      pixels = (size_t)r->kernel_camera.width * (size_t)r->kernel_camera.height;
    struct loss_value value;
    oxl_result        rc;
    *out = (struct renderer_loss){0};
    if (r->device && !r->lamp) return r->backend->loss(r->device, rgb, weight, r->has_gain ? r->gain : NULL, ssim_weight, out);
    if (!rgb) rgb = r->target, weight = r->masked ? r->weight : NULL;
    rc = oxl_reserve(ctx, (void **)&r->drgb, &r->drgb_capacity, 3 * pixels, sizeof *r->drgb);
    if (rc == OXL_OK && render_exposes(r)) rc = render_exposed_loss(ctx, r, rgb, weight, ssim_weight, out->dlog_gain, &value);
    else if (rc == OXL_OK) {
        const struct loss_job job = {r->kernel_camera.width, r->kernel_camera.height, ssim_weight, r->rgb, rgb, weight, r->drgb};
        rc                        = loss_forward_backward(ctx, &job, &r->loss, &value);
    }
    if (rc == OXL_OK) out->total = value.total, out->l1 = value.l1, out->ssim = value.ssim, out->mse = value.mse;
    if (rc == OXL_OK) render_weigh_window(r, pixels);
    return rc;
}

OXL_INTERNAL void renderer_set_depths(struct renderer *r, const struct depth_point *point, int count, double weight)
{
    memcpy(r->depth_point, point, (size_t)count * sizeof *point);
    r->depth_points = count;
    r->depth_weight = weight;
}

static void render_project_backward(const oxl_context *ctx, struct renderer *r, int64_t task, const struct gaussians *out)
{
    struct project_job job = render_project_job(r, task);
    job.out                = *out;
    project_backward(ctx->isa, &job);
    if (render_has_medium(r)) {
        const struct medium_job medium = render_medium_job(r, task);
        medium_backward_centres(&medium, out);
    }
}

static oxl_result render_begin_backward(oxl_context *ctx, struct renderer *r)
{
    oxl_result rc = oxl_reserve(ctx, (void **)&r->sums, &r->sums_capacity, r->bins.slot_count + 1, sizeof *r->sums);
    if (rc == OXL_OK) rc = oxl_reserve(ctx, (void **)&r->dmean2d, &r->dmean2d_capacity, r->bins.packs * PACK, sizeof *r->dmean2d);
    return rc;
}

OXL_INTERNAL oxl_result renderer_backward(oxl_context *ctx, struct renderer *r, const float *drgb, oxl_model *gradient)
{
    const int64_t    tasks = render_tasks(r);
    struct gaussians out;
    oxl_result       rc = gradient ? model_set_lobes(ctx, gradient, r->in.lobes) : OXL_OK;
    if (rc == OXL_OK && r->device) return r->backend->backward(r->device, drgb || !r->lamp ? drgb : r->drgb);
    if (rc == OXL_OK) rc = render_begin_backward(ctx, r);
    if (rc != OXL_OK) return rc;
    render_each_tile(ctx, r, drgb ? drgb : r->drgb, raster_backward);
    depth_loss_backward(&r->bins, r->depth_point, r->depth_points, r->depth_weight, r->sums);
    r->depth_points = 0;
    if (render_has_medium(r)) render_medium_backward(ctx, r, drgb ? drgb : r->drgb);
    r->unprojected = !gradient;
    if (!gradient) return OXL_OK;
    out = render_gaussians(gradient, r->in.sh_degree);
#pragma omp parallel for schedule(dynamic) num_threads(ctx->threads)
    for (int64_t task = 0; task < tasks; task++) render_project_backward(ctx, r, task, &out);
    return OXL_OK;
}

OXL_INTERNAL oxl_result renderer_gradient(oxl_context *ctx, struct renderer *r, oxl_model *gradient)
{
    (void)ctx;
    return r->device ? r->backend->gradient(r->device, gradient) : OXL_OK;
}

/* ---------------------------------------------------------------- score */

OXL_INTERNAL oxl_result renderer_score(oxl_context *ctx, struct renderer *r, const float *drgb, float *score)
{
    oxl_result rc;
    if (r->device) return r->backend->score(r->device, drgb, score);
    rc = oxl_reserve(ctx, (void **)&r->score, &r->score_capacity, r->bins.slot_count + 1, sizeof *r->score);
    if (rc != OXL_OK) return rc;
    render_each_tile(ctx, r, drgb, raster_score);
#pragma omp parallel for schedule(static) num_threads(ctx->threads)
    for (int64_t i = 0; i < (int64_t)r->bins.visible_count; i++) { /* in slot order, which fixes the rounding */
        const struct splat *s   = &r->splat[r->bins.order[i]];
        float               sum = 0;
        if (r->bins.order[i] >= r->packs * PACK) continue; /* of the context */
        for (uint32_t slot = s->first_slot; slot < s->first_slot + s->slots; slot++) sum += r->score[slot];
        score[r->bins.order[i]] += sum;
    }
    return OXL_OK;
}

/* ---------------------------------------------------------------- step and statistics */

struct render_step {
    oxl_model   *model, *first, *second, *gradient;
    const float *rates;
    double       correction; /* of the first moment's bias */
};

/* Assigns the model's planes from first_plane on to those of the job from `at` on. */
static void render_step_planes(const struct render_step *s, int first_plane, int planes, int at, struct adam_job *out)
{
    for (int k = first_plane; k < first_plane + planes; k++, at++) {
        out->parameter[at] = s->model->plane[k];
        out->gradient[at]  = s->gradient->plane[k];
        out->first[at]     = s->first->plane[k];
        out->second[at]    = s->second->plane[k];
        out->rate[at]      = (float)(s->rates[k] / s->correction);
    }
}

/* Rows of a pack whose visibility bit the step cleared: values that were not finite. */
static void render_count_aside(unsigned before, unsigned after, size_t pack, struct renderer_nonfinite *out)
{
    for (unsigned l = 0; before != after && l < PACK; l++)
        if ((before & ~after) >> l & 1) {
            out->first = OXL_MIN(out->first, pack * PACK + l);
            out->rows++;
        }
}

OXL_INTERNAL oxl_result renderer_step(oxl_context *ctx, struct renderer *r, oxl_model *model, oxl_model *gradient,
                                      oxl_model *first, oxl_model *second, const struct adam_params *adam,
                                      struct renderer_nonfinite *out)
{
    const struct render_step s       = {model,    first,      second,
                                        gradient, adam->rate, 1 - vecmath_exp(adam->step * vecmath_log(adam->beta[0]))};
    const int64_t            tasks   = render_tasks(r);
    size_t                   skipped = 0, first_skipped = SIZE_MAX;
    struct adam_job          rows = {.visible            = r->visible,
                                     .beta1              = (float)adam->beta[0],
                                     .beta2              = (float)adam->beta[1],
                                     .lobe_packs         = render_packs(r->in.lobes),
                                     .inverse_correction = (float)(1 / sqrt(1 - vecmath_exp(adam->step * vecmath_log(adam->beta[1]))))};
    struct gaussians         pulled;
    oxl_result               rc;
    if (r->device) return r->backend->step(r->device, model, first, second, adam, out);
    rc = r->unprojected ? model_set_lobes(ctx, gradient, r->in.lobes) : OXL_OK;
    if (rc != OXL_OK) return rc;
    pulled           = render_gaussians(gradient, r->in.sh_degree);
    rows.planes      = OXL_SH + 3 * (r->in.sh_degree + 1) * (r->in.sh_degree + 1);
    rows.lobe_planes = r->in.lobes ? MODEL_LOBE_PLANES : 0;
    render_step_planes(&s, 0, rows.planes, 0, &rows);
    render_step_planes(&s, OXL_LOBE, rows.lobe_planes, rows.planes, &rows);
#pragma omp parallel for schedule(dynamic) num_threads(ctx->threads) reduction(+ : skipped) reduction(min : first_skipped)
    for (int64_t task = 0; task < tasks; task++) {
        struct adam_job           job  = rows;
        struct renderer_nonfinite here = {0, SIZE_MAX, 0};
        uint16_t                  seen[RENDER_TASK];
        job.first_pack = (size_t)task * RENDER_TASK, job.end_pack = OXL_MIN(job.first_pack + RENDER_TASK, r->packs);
        if (r->unprojected) render_project_backward(ctx, r, task, &pulled);
        memcpy(seen, r->visible + job.first_pack, (job.end_pack - job.first_pack) * sizeof *seen);
        adam_step(ctx->isa, &job);
        for (size_t pack = job.first_pack; pack < job.end_pack; pack++)
            render_count_aside(seen[pack - job.first_pack], r->visible[pack], pack, &here);
        skipped += here.rows;
        first_skipped = OXL_MIN(first_skipped, here.first);
    }
    r->unprojected = 0;
    *out           = (struct renderer_nonfinite){skipped, first_skipped, 0};
    return OXL_OK;
}

/* 1: the centre is inside the window, or there is none. Of a Gaussian that is cut, the gradient is a part of what the image gives. */
static int render_shows_centre(const struct renderer *r, size_t row)
{
    const struct splat *s = &r->splat[row];
    return r->full[0] == 0 ||
           (s->u >= 0 && s->v >= 0 && s->u < (float)r->kernel_camera.width && s->v < (float)r->kernel_camera.height);
}

/* Statistics for gradients at this depth. */
static float *render_band(const struct renderer_sums *s, float depth)
{
    return !s->banded || depth < s->z_near ? s->gradient : depth < s->z_far ? s->mid : s->far_;
}

OXL_INTERNAL oxl_result renderer_observe(oxl_context *ctx, struct renderer *r, const struct renderer_sums *s)
{
    (void)ctx; /* without OpenMP */
    if (r->device) return r->backend->observe(r->device, s);
#pragma omp parallel for schedule(static) num_threads(ctx->threads)
    for (int64_t i = 0; i < (int64_t)s->count; i++)
        if (renderer_row_visible(r, (size_t)i) && render_shows_centre(r, (size_t)i)) {
            render_band(s, renderer_depth(r, (size_t)i))[i] += renderer_mean_gradient(r, (size_t)i);
            s->views[i] += 1;
        }
    return OXL_OK;
}

OXL_INTERNAL oxl_result renderer_download(oxl_context *ctx, struct renderer *r, enum renderer_download what)
{
    (void)ctx;
    return r->device ? r->backend->download(r->device, what) : OXL_OK;
}

OXL_INTERNAL oxl_result renderer_move_rows(oxl_context *ctx, struct renderer *r, const struct renderer_move *move, int *moved)
{
    oxl_result rc = OXL_OK;
    (void)ctx;
    *moved = 0;
    if (r->device) rc = r->backend->move_rows(r->device, move, moved);
    if (rc == OXL_OK && r->device && !*moved) rc = r->backend->download(r->device, DOWNLOAD_TO_CHANGE);
    return rc;
}

OXL_INTERNAL oxl_result renderer_send_shape(oxl_context *ctx, struct renderer *r, oxl_model *model, int reset_opacity)
{
    (void)ctx;
    return r->device ? r->backend->send_shape(r->device, model, reset_opacity) : OXL_OK;
}

OXL_INTERNAL int renderer_defer(struct renderer *r, int on)
{
    r->deferred = r->device && r->backend->defer(r->device, on);
    return r->deferred;
}

OXL_INTERNAL oxl_result renderer_report(oxl_context *ctx, struct renderer *r, int wait, struct renderer_report *out)
{
    (void)ctx;
    *out = (struct renderer_report){0};
    return r->device ? r->backend->report(r->device, wait, out) : OXL_OK;
}

OXL_INTERNAL int renderer_row_visible(const struct renderer *r, size_t row)
{
    return r->visible[row / PACK] >> (row % PACK) & 1;
}

OXL_INTERNAL oxl_result renderer_clear_visible(oxl_context *ctx, struct renderer *r)
{
    (void)ctx;
    if (r->device) return r->backend->clear_visible(r->device);
    memset(r->visible, 0, r->packs * sizeof *r->visible);
    return OXL_OK;
}

OXL_INTERNAL oxl_result renderer_download_rows(oxl_context *ctx, struct renderer *r)
{
    const size_t rows = r->bins.packs * PACK;
    oxl_result   rc;
    if (!r->device) return OXL_OK;
    rc = oxl_reserve(ctx, (void **)&r->splat, &r->splat_capacity, rows, sizeof *r->splat);
    if (rc == OXL_OK) rc = oxl_reserve(ctx, (void **)&r->visible, &r->visible_capacity, rows / PACK + 1, sizeof *r->visible);
    if (rc == OXL_OK) rc = oxl_reserve(ctx, (void **)&r->dmean2d, &r->dmean2d_capacity, rows, sizeof *r->dmean2d);
    return rc == OXL_OK ? r->backend->rows(r->device, r->splat, r->visible, r->dmean2d) : rc;
}

OXL_INTERNAL int renderer_row_finite(const struct renderer *r, size_t row)
{
    const struct splat *s = &r->splat[row];
    if (!renderer_row_visible(r, row)) return 1;
    return 0 * (s->u + s->v + s->a + s->k + s->e + s->peak + s->colour[0] + s->colour[1] + s->colour[2]) == 0;
}

OXL_INTERNAL float renderer_mean_gradient(const struct renderer *r, size_t row)
{
    return r->dmean2d[row];
}

OXL_INTERNAL float renderer_depth(const struct renderer *r, size_t row)
{
    return r->splat[row].depth;
}

OXL_INTERNAL struct renderer_counts renderer_counts(const struct renderer *r)
{
    struct renderer_counts c = {.visible = r->bins.visible_count, .pairs = r->bins.pair_count};
    for (int tile = 0; tile < r->bins.tiles_x * r->bins.tiles_y; tile++) {
        const int left  = r->kernel_camera.width - tile % r->bins.tiles_x * TILE,
                  below = r->kernel_camera.height - tile / r->bins.tiles_x * TILE;
        for (uint32_t i = r->bins.tile_start[tile]; i < r->bins.tile_start[tile + 1]; i++)
            for (uint32_t blocks = r->bins.pair[i].blocks; blocks; blocks &= blocks - 1) {
                const int block = simd_lowest_bit(blocks);
                const int w = OXL_CLAMP(left - block % 4 * 4, 0, 4), h = OXL_CLAMP(below - block / 4 * 4, 0, 4);
                c.blocks++;
                c.pixels += (size_t)(w * h);
            }
    }
    return c;
}

/* ---------------------------------------------------------------- the public functions */

/* Renders the splats with (depth, 1, 0) as colour: the same kernel gives the sums of alpha T z and of alpha T. */
static void render_depth_tiles(oxl_context *ctx, struct renderer *r)
{
    for (size_t i = 0; i < r->bins.visible_count; i++) {
        struct splat *s = &r->splat[r->bins.order[i]];
        s->colour[0]    = s->depth;
        s->colour[1]    = 1;
        s->colour[2]    = 0;
    }
    memset(r->background, 0, sizeof r->background);
    render_each_tile(ctx, r, NULL, raster_forward);
}

static oxl_result render_depth(oxl_context *ctx, struct renderer *r, float *depth)
{
    const size_t pixels = (size_t)r->kernel_camera.width * (size_t)r->kernel_camera.height;
    oxl_result   rc     = OXL_OK;
    if (r->device) rc = r->backend->image(r->device, 1, r->rgb);
    else render_depth_tiles(ctx, r);
    for (size_t i = 0; i < pixels && rc == OXL_OK; i++) depth[i] = r->rgb[pixels + i] > 0 ? r->rgb[i] / r->rgb[pixels + i] : 0;
    return rc;
}

OXL_INTERNAL oxl_result renderer_draw(oxl_context *ctx, struct renderer *r, const oxl_model *model, const oxl_camera *camera,
                                      const oxl_render_options *options, oxl_image *out, float *depth)
{
    const float *rgb = NULL;
    oxl_result   rc;
    *out = (oxl_image){0};
    if (camera->width < 1 || camera->height < 1) {
        return oxl_fail(ctx, OXL_ERR_USAGE, "a camera of %d x %d px has no image", camera->width, camera->height);
    }
    if (model->pages) {
        oxl_model shown;
        rc = model_pages_view(ctx, model, camera, options->near_plane, &shown);
        if (rc == OXL_OK) rc = renderer_draw(ctx, r, &shown, camera, options, out, depth);
        oxl_model_free(ctx, &shown);
        return rc;
    }
    rc = renderer_forward(ctx, r, model, camera, options);
    if (rc == OXL_OK) rc = renderer_image(ctx, r, &rgb);
    if (rc == OXL_OK) rc = oxl_image_create(ctx, camera->width, camera->height, out);
    if (rc == OXL_OK) {
        memcpy(out->rgb, rgb, 3 * (size_t)camera->width * (size_t)camera->height * sizeof *out->rgb);
        if (depth) rc = render_depth(ctx, r, depth);
    }
    if (rc != OXL_OK) oxl_image_free(ctx, out);
    return rc;
}

oxl_result oxl_render(oxl_context *ctx, const oxl_model *model, const oxl_camera *camera, const oxl_render_options *options,
                      oxl_image *out, float *depth)
{
    const oxl_render_options o  = options ? *options : oxl_render_options_default();
    struct renderer         *r  = NULL;
    oxl_result               rc = renderer_create(ctx, &r);
    *out                        = (oxl_image){0};
    if (rc == OXL_OK) rc = renderer_draw(ctx, r, model, camera, &o, out, depth);
    renderer_free(ctx, r);
    return rc;
}

oxl_result oxl_render_backward(oxl_context *ctx, const oxl_model *model, const oxl_camera *camera,
                               const oxl_render_options *options, const float *drgb, oxl_model *gradient)
{
    const oxl_render_options o = options ? *options : oxl_render_options_default();
    struct renderer         *r = NULL;
    oxl_result               rc;
    *gradient = (oxl_model){0};
    rc        = renderer_create(ctx, &r);
    if (rc == OXL_OK) rc = renderer_forward(ctx, r, model, camera, &o);
    if (rc == OXL_OK) rc = oxl_model_create(ctx, model->count, model->sh_degree, gradient);
    if (rc == OXL_OK) {
        memset(gradient->plane[OXL_ROTATION], 0, gradient->capacity * sizeof *gradient->plane[0]);
        rc = renderer_backward(ctx, r, drgb, gradient);
        if (rc == OXL_OK) rc = renderer_gradient(ctx, r, gradient);
    }
    if (rc != OXL_OK) oxl_model_free(ctx, gradient);
    renderer_free(ctx, r);
    return rc;
}
