/* memory.c - sets errors and allocates memory for all other files. */
#include "core.h"

/* ---------------- errors */

oxl_result oxl_fail(oxl_context *ctx, oxl_result rc, const char *format, ...)
{
    va_list args;
    if (!ctx) return rc; /* Sets no text without a context. */
    va_start(args, format);
    vsnprintf(ctx->error, sizeof ctx->error, format, args);
    va_end(args);
    context_name_fields(ctx, ctx->error, sizeof ctx->error);
    ctx->failed = rc;
    return rc;
}

/* ---------------- memory */

/* Aligns blocks to a cache line; the allocator's pointer is stored directly before the block. */
enum { MEMORY_ALIGN = 64 };

/* Returns the aligned block in `raw`, and moves the contents there from `offset`. */
static void *memory_align(char *raw, size_t offset, size_t bytes)
{
    const uintptr_t aligned =
        ((uintptr_t)raw + MEMORY_ALIGN + sizeof(void *)) & ~(uintptr_t)(MEMORY_ALIGN - 1);
    void *header = raw;
    if (bytes > 0 && aligned - (uintptr_t)raw != offset) memmove((void *)aligned, raw + offset, bytes);
    memcpy((char *)aligned - sizeof header, &header, sizeof header);
    return (void *)aligned;
}

OXL_INTERNAL void *oxl_alloc(oxl_context *ctx, size_t count, size_t size)
{
    return oxl_regrow(ctx, NULL, 0, count, size);
}

OXL_INTERNAL void *oxl_calloc(oxl_context *ctx, size_t count, size_t size)
{
    void *memory = oxl_alloc(ctx, count, size);
    if (memory) memset(memory, 0, count * size);
    return memory;
}

/* Changes a block's size by the caller's reallocate, since realloc of a usual libc moves pages of large
 * blocks instead of copying them. */
OXL_INTERNAL void *oxl_regrow(oxl_context *ctx, void *old, size_t old_count, size_t new_count, size_t size)
{
    const size_t overhead = MEMORY_ALIGN + sizeof(void *);
    char *raw = NULL;
    size_t offset = 0;
    const int fits = size == 0 || new_count <= (SIZE_MAX - overhead) / size;
    if (old) {
        memcpy(&raw, (char *)old - sizeof raw, sizeof raw);
        offset = (size_t)((char *)old - raw);
    }
    raw = fits ? ctx->options.reallocate(ctx->options.user, raw, new_count * size + overhead) : NULL;
    if (raw) return memory_align(raw, offset, OXL_MIN(old_count, new_count) * size);
    oxl_fail(
        ctx, OXL_ERR_MEMORY,
        "no memory for %zu x %zu bytes\nfix: end other programs, or limit the run by --ram, --max-side or "
        "--max-gaussians",
        new_count, size);
    return NULL;
}

OXL_INTERNAL void oxl_free(oxl_context *ctx, void *memory)
{
    void *raw;
    if (!memory) return;
    memcpy(&raw, (char *)memory - sizeof raw, sizeof raw);
    ctx->options.reallocate(ctx->options.user, raw, 0);
}

OXL_INTERNAL void oxl_free_all(oxl_context *ctx, void *const *memory, size_t count)
{
    for (size_t i = 0; i < count; i++) oxl_free(ctx, memory[i]);
}

/* Grows by a quarter, or by as much as is needed if memory refuses more. */
OXL_INTERNAL oxl_result oxl_reserve(oxl_context *ctx, void *array, size_t *capacity, size_t needed,
                                    size_t size)
{
    size_t wanted =
        OXL_MAX(OXL_MAX(needed, (size_t)64), *capacity <= SIZE_MAX / 2 ? *capacity + *capacity / 4 : 0);
    void *old, *grown;
    if (needed <= *capacity) return OXL_OK;
    memcpy(&old, array, sizeof old);
    grown = oxl_regrow(ctx, old, *capacity, wanted, size);
    if (!grown && wanted > needed) grown = oxl_regrow(ctx, old, *capacity, wanted = needed, size);
    if (!grown) return OXL_ERR_MEMORY;
    memcpy(array, &grown, sizeof grown);
    *capacity = wanted;
    return OXL_OK;
}
