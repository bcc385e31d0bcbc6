/* context.c - opens the context: options, threads, interruption.
 *
 * Invariant: all memory of the library comes from ctx->options.reallocate, so that a caller can count it,
 * limit it or make it fail.
 */
#include "core.h"
#include "simd.h"

static void *context_reallocate(void *user, void *old, size_t size)
{
    (void)user;
    if (size == 0) {
        free(old);
        return NULL;
    }
    return realloc(old, size);
}

oxl_context_options oxl_context_options_default(void)
{
    return (oxl_context_options){.seed = 1, .reallocate = context_reallocate, .device = -1};
}

/* Limits the number of threads, since the OpenMP runtime crashes with 100 000;
 * results do not depend on it. */
enum { BASE_THREADS_MAX = 1024 };

static int context_threads(int wanted, int *available)
{
#ifdef _OPENMP
    const int requested = wanted > 0 ? wanted : omp_get_max_threads(), quota = os_processor_quota(),
              there = omp_get_num_procs();
    *available = OXL_MIN(quota > 0 ? OXL_MIN(quota, there) : there, BASE_THREADS_MAX);
    return requested;
#else
    (void)wanted;
    return *available = 1;
#endif
}

OXL_INTERNAL int context_thread(void)
{
#ifdef _OPENMP
    return omp_get_thread_num();
#else
    return 0;
#endif
}

OXL_INTERNAL oxl_result context_open(const oxl_context_options *options, oxl_context **out)
{
    oxl_context_options o = options ? *options : oxl_context_options_default();
    oxl_context *ctx = NULL;
    int available, requested = context_threads(o.threads, &available);
    *out = NULL;
    if (!o.reallocate) o.reallocate = context_reallocate;
    ctx = o.reallocate(o.user, NULL, sizeof *ctx);
    if (!ctx) return OXL_ERR_MEMORY;
    *ctx = (oxl_context){.options = o,
                         .threads = OXL_MIN(requested, available),
                         .isa = simd_detect(),
                         .name_fields = option_name_fields};
    if (requested > available)
        oxl_log(ctx, OXL_LOG_INFO,
                "%d threads requested, but only %d processor%s available; %d threads are used", requested,
                available, available == 1 ? " is" : "s are", available);
    *out = ctx;
    return OXL_OK;
}

OXL_INTERNAL void context_close(oxl_context *ctx)
{
    ctx->options.reallocate(ctx->options.user, ctx, 0);
}

OXL_INTERNAL oxl_result context_stopped(oxl_context *ctx)
{
    if (!ctx->options.stopped || !ctx->options.stopped(ctx->options.user)) return OXL_OK;
    return oxl_fail(ctx, OXL_ERR_INTERRUPTED, "interrupted");
}

OXL_INTERNAL int context_report(const oxl_callback *callback, const oxl_progress *progress)
{
    return callback && callback->progress ? callback->progress(callback->user, progress) : 0;
}

const char *oxl_error_text(const oxl_context *ctx)
{
    return ctx ? ctx->error : "";
}

const char *oxl_isa_name(const oxl_context *ctx)
{
    return simd_name(ctx->isa);
}

/* Calls the caller's allocator from one thread at a time: it need not be thread-safe. */
static void *context_reallocate_in_turn(void *user, void *old, size_t size)
{
    const oxl_context_options *caller = user;
    void *memory;
#ifdef _OPENMP
#pragma omp critical(base_memory)
#endif
    memory = caller->reallocate(caller->user, old, size);
    return memory;
}

OXL_INTERNAL oxl_context context_for_thread(oxl_context *ctx)
{
    return (oxl_context){.options = {.reallocate = context_reallocate_in_turn, .user = &ctx->options},
                         .threads = 1,
                         .isa = ctx->isa};
}
