/* wide_kernels.c - the kernels from their own source in double, as the tests call them: see wide.h. No
 * vectors chosen at run time, libm's exp and log, one thread. What float costs is the difference to this; it
 * does not test the formulas.
 */
/* The library, which is linked too, has functions of these names. */
#define oxl_fail wide_fail
#define oxl_calloc wide_calloc
#define oxl_free wide_free_memory
#define oxl_free_all wide_free_all
#define oxl_reserve wide_reserve
#include "../src/render/render.h"
#undef OXL_INTERNAL
#define OXL_INTERNAL static
#define OXL_REFERENCE
#define real double
#ifndef OXL_NO_SIMD
#define OXL_NO_SIMD
#endif
#include "../src/render/kernels.h"
#include "wide.h"

/* ---------------- what the kernels ask of the context */

static struct oxl_context kernels_context = {.threads = 1, .isa = ISA_BASE};

oxl_result oxl_fail(oxl_context *ctx, oxl_result rc, const char *format, ...)
{
    (void)ctx, (void)rc;
    fprintf(stderr, "wide_kernels: %s\n", format);
    abort();
}

void *oxl_calloc(oxl_context *ctx, size_t count, size_t size)
{
    (void)ctx;
    return calloc(count, size);
}

void oxl_free(oxl_context *ctx, void *memory)
{
    (void)ctx;
    free(memory);
}

void oxl_free_all(oxl_context *ctx, void *const *memory, size_t count)
{
    for (size_t i = 0; i < count; i++) oxl_free(ctx, memory[i]);
}

oxl_result oxl_reserve(oxl_context *ctx, void *array, size_t *capacity, size_t needed, size_t size)
{
    void *grown;
    if (needed <= *capacity) return OXL_OK;
    memcpy(&grown, array, sizeof grown);
    grown = realloc(grown, needed * size);
    if (!grown) return oxl_fail(ctx, OXL_ERR_MEMORY, "no memory");
    memcpy(array, &grown, sizeof grown);
    *capacity = needed;
    return OXL_OK;
}

#include "../src/render/project.c"
#include "../src/render/bin.c"
#include "../src/render/raster.c"
#include "../src/render/loss.c"
#include "../src/render/adam.c"

/* ---------------- one view */

struct view {
    struct kernel_camera kernel_camera;
    struct gaussians in, out;
    struct splat *splat;
    struct lobe *lobe;
    uint16_t *visible;
    struct bins bins;
    real (*sums)[SPLAT_SUMS];
};

static struct kernel_camera view_kernel_camera(const struct wide *w)
{
    const oxl_camera *c = &w->camera;
    const double *r = c->rotation, *t = c->translation;
    struct kernel_camera k = {.width = c->width,
                              .height = c->height,
                              .fx = c->fx,
                              .fy = c->fy,
                              .cx = c->cx,
                              .cy = c->cy,
                              .half_width = 0.5 * c->width,
                              .half_height = 0.5 * c->height,
                              .limit_x = FRUSTUM_CLAMP * c->width / (2 * c->fx),
                              .limit_y = FRUSTUM_CLAMP * c->height / (2 * c->fy),
                              .near_plane = w->near_plane,
                              .alpha_min = w->alpha_min,
                              .antialias = w->antialias,
                              .cutoff_bits = w->alpha_min > ALPHA_MIN ? -log2(w->alpha_min) : LOG2_255};
    k.rotation.x = vec3(r[0], r[1], r[2]);
    k.rotation.y = vec3(r[3], r[4], r[5]);
    k.rotation.z = vec3(r[6], r[7], r[8]);
    k.translation = vec3(t[0], t[1], t[2]);
    k.eye = scale3(-1, mat3_transposed_times(k.rotation, k.translation));
    return k;
}

static struct project_job view_project(const struct view *v)
{
    return (struct project_job){.in = v->in,
                                .kernel_camera = &v->kernel_camera,
                                .end_pack = v->bins.packs,
                                .splat = v->splat,
                                .lobe = v->lobe,
                                .visible = v->visible};
}

static struct raster_job view_raster(const struct view *v, const struct wide *w)
{
    return (struct raster_job){.bins = &v->bins,
                               .width = v->kernel_camera.width,
                               .height = v->kernel_camera.height,
                               .background = {w->background[0], w->background[1], w->background[2]},
                               .rgb = w->rgb,
                               .transmittance = w->transmittance,
                               .depth = w->depth};
}

static int view_tiles(const struct view *v)
{
    return v->bins.tiles_x * v->bins.tiles_y;
}

static void view_open(struct view *v, struct wide *w)
{
    const size_t packs = (w->count + PACK - 1) / PACK;
    *v = (struct view){.kernel_camera = view_kernel_camera(w),
                       .in = {.count = w->count, .lobes = w->lobes, .sh_degree = w->sh_degree}};
    memcpy(v->in.plane, w->plane, sizeof v->in.plane);
    v->out = v->in;
    memcpy(v->out.plane, w->gradient, sizeof v->out.plane);
    v->splat = wide_array(packs * PACK * sizeof *v->splat / sizeof(double));
    v->lobe = wide_array((w->lobes + 1) * sizeof *v->lobe / sizeof(double));
    v->visible = wide_array(packs);
    v->bins = (struct bins){.alpha_min = v->kernel_camera.alpha_min,
                            .cutoff_bits = v->kernel_camera.cutoff_bits,
                            .packs = packs,
                            .splat = v->splat,
                            .visible = v->visible,
                            .lobe = v->lobe,
                            .lobes = w->lobes};
    {
        const struct project_job project = view_project(v);
        project_forward(ISA_BASE, &project);
    }
    bin_splats(&kernels_context, &v->bins, v->kernel_camera.width, v->kernel_camera.height);
    struct raster_job raster = view_raster(v, w);
    for (raster.tile = 0; raster.tile < view_tiles(v); raster.tile++) raster_forward(ISA_BASE, &raster);
    for (raster.tile = 0; raster.tile < view_tiles(v); raster.tile++) raster_depth(ISA_BASE, &raster);
}

static void view_close(struct view *v)
{
    bin_free(&kernels_context, &v->bins);
    free(v->splat), free(v->lobe), free(v->visible), free(v->sums);
}

size_t kernels_forward(struct wide *w)
{
    struct view v;
    view_open(&v, w);
    size_t rendered = v.bins.visible_count;
    view_close(&v);
    return rendered;
}

void kernels_backward(struct wide *w, const double *drgb)
{
    struct view v;
    view_open(&v, w);
    v.sums = wide_array((v.bins.slot_count + 1) * SPLAT_SUMS);
    struct raster_job raster = view_raster(&v, w);
    raster.drgb = drgb, raster.sums = v.sums;
    for (raster.tile = 0; raster.tile < view_tiles(&v); raster.tile++) raster_backward(ISA_BASE, &raster);
    struct project_job project = view_project(&v);
    project.sums = (const double(*)[SPLAT_SUMS])v.sums;
    project.out = v.out, project.dmean2d = w->dmean2d;
    memset(w->dpose, 0, sizeof w->dpose);
    project.pose_sum = w->dpose;
    project_backward(ISA_BASE, &project);
    view_close(&v);
}

void kernels_score(struct wide *w, const double *drgb, double *score)
{
    struct view v;
    view_open(&v, w);
    struct raster_job raster = view_raster(&v, w);
    raster.drgb = drgb, raster.score = wide_array(v.bins.slot_count);
    for (raster.tile = 0; raster.tile < view_tiles(&v); raster.tile++) raster_score(ISA_BASE, &raster);
    for (size_t i = 0; i < v.bins.visible_count; i++) {
        const struct splat *s = &v.splat[v.bins.order[i]];
        for (uint32_t slot = s->first_slot; slot < s->first_slot + s->slots; slot++)
            score[v.bins.order[i]] += raster.score[slot];
    }
    free(raster.score);
    view_close(&v);
}

/* ---------------- loss, Adam */

struct wide_loss kernels_loss(int width, int height, double weight, const double *x, const double *y,
                              const double *mask, double *dx)
{
    const struct loss_job job = {width, height, weight, x, y, mask, dx, 0};
    struct loss_scratch scratch = {0};
    struct renderer_loss value = {0};
    loss_forward_backward(&kernels_context, &job, &scratch, &value);
    loss_free(&kernels_context, &scratch);
    return (struct wide_loss){value.total, value.l1, value.ssim, value.mse};
}

void kernels_adam(double x[16], const double gradient[16], double rate, int step, double mean[16],
                  double square[16])
{
    uint16_t all = 0xFFFF;
    struct adam_job job = {.end_pack = 1,
                           .visible = &all,
                           .planes = 1,
                           .parameter = {x},
                           .mean = {mean},
                           .square = {square},
                           .gradient = {gradient},
                           .rate = {rate / (1 - pow(0.9, step))},
                           .beta1 = 0.9,
                           .beta2 = 0.999,
                           .inverse_correction = 1 / sqrt(1 - pow(0.999, step))};
    adam_step(ISA_BASE, &job);
}
