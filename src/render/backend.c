/* backend.c - selects the CPU, or a Vulkan device in builds with that backend.
 *
 * Invariant: a build without the backend, a missing loader and a missing device are reported in one line
 * each; with --backend auto the CPU is used.
 */
#include "render.h"
#include "../core/codec.h"
#ifdef OXL_VULKAN
#include "../../backends/vulkan/vulkan.h"
#else /* stands in for it */

static oxl_result vulkan_open(oxl_context *ctx, int device, int wants, struct vulkan **out)
{
    (void)device, (void)out;
    return wants ? oxl_fail(ctx, OXL_ERR_FAILED,
                            "this program was built without the Vulkan backend\nfix: make VULKAN=1, or use "
                            "the CPU backend")
                 : OXL_OK;
}

static void vulkan_close(struct vulkan *v)
{
    (void)v;
}

static const char *vulkan_name(const struct vulkan *v, int and_cpu)
{
    (void)v, (void)and_cpu;
    return NULL;
}

static const struct renderer_device *vulkan_functions(void)
{
    return NULL;
}

static oxl_result vulkan_list(oxl_context *ctx, struct text *out)
{
    (void)out;
    return vulkan_open(ctx, 0, 1, NULL);
}

#endif

OXL_INTERNAL void backend_begin_run(oxl_context *ctx)
{
    if (ctx->backend) ctx->backend->fell_back = 0;
}

OXL_INTERNAL oxl_result backend_begin(oxl_context *ctx)
{
    const int wants = ctx->options.backend == OXL_BACKEND_VULKAN;
    if (!ctx->backend) ctx->backend = oxl_calloc(ctx, 1, sizeof *ctx->backend);
    if (!ctx->backend) return OXL_ERR_MEMORY;
    if (ctx->backend->vulkan || ctx->options.backend == OXL_BACKEND_CPU) return OXL_OK;
    if (vulkan_open(ctx, ctx->options.device, wants, &ctx->backend->vulkan) == OXL_OK) {
        ctx->backend->functions = vulkan_functions();
        return OXL_OK;
    }
    if (wants) return ctx->failed;
    ctx->options.backend = OXL_BACKEND_CPU; /* search once */
    oxl_log(ctx, OXL_LOG_INFO, "rendering on the CPU: %s", ctx->error);
    return OXL_OK;
}

OXL_INTERNAL const char *backend_device(const oxl_context *ctx)
{
    return ctx->backend && ctx->backend->vulkan ? vulkan_name(ctx->backend->vulkan, 0) : NULL;
}

const char *oxl_backend_name(const oxl_context *ctx)
{
    const struct backend *b = ctx->backend;
    return b && b->vulkan && b->rendered_on != RENDERED_ON_CPU
               ? vulkan_name(b->vulkan, b->rendered_on & RENDERED_ON_CPU)
               : "cpu";
}

oxl_result oxl_devices(oxl_context *ctx, char **out)
{
    struct text t = {.ctx = ctx};
    const oxl_result rc = vulkan_list(ctx, &t);
    *out = NULL;
    if (rc == OXL_OK) return text_take(&t, out);
    text_free(&t);
    return rc;
}

oxl_result oxl_backend_begin(oxl_context *ctx)
{
    return backend_begin(ctx);
}

/* ---------------- the context, with what lies on top of it */

oxl_result oxl_context_create(const oxl_context_options *options, oxl_context **out)
{
    const oxl_result rc = context_open(options, out);
    if (rc == OXL_OK) codec_begin();
    return rc;
}

void oxl_context_free(oxl_context *ctx)
{
    if (!ctx) return;
    if (ctx->backend) vulkan_close(ctx->backend->vulkan);
    oxl_free(ctx, ctx->backend);
    context_close(ctx);
}
