/* memory.c - errors, the log, memory, growing text, paths, random numbers: what every other file needs. */
#include "core.h"
#include "json.h"

/* ---------------------------------------------------------------- errors and the log */

OXL_INTERNAL oxl_result oxl_fail(oxl_context *ctx, oxl_result rc, const char *format, ...)
{
    va_list args;
    if (!ctx) return rc; /* no context, no text */
    va_start(args, format);
    vsnprintf(ctx->error, sizeof ctx->error, format, args);
    va_end(args);
    ctx->failed = rc;
    return rc;
}

OXL_INTERNAL void oxl_log(oxl_context *ctx, oxl_log_level level, const char *format, ...)
{
    char    line[1024];
    va_list args;
    if (!ctx->options.log && !ctx->notes) return;
    va_start(args, format);
    vsnprintf(line, sizeof line, format, args);
    va_end(args);
    if (ctx->notes && level <= OXL_LOG_INFO) {
        text_add(ctx->notes, "%s\n    {\"level\": \"%s\", \"text\": ", ctx->notes->size ? "," : "",
                 level == OXL_LOG_INFO ? "info" : "warning");
        text_add_json_string(ctx->notes, line);
        text_add(ctx->notes, "}");
    }
    if (ctx->options.log) ctx->options.log(ctx->options.user, level, line);
}

/* ---------------------------------------------------------------- memory */

/* Blocks are aligned to a cache line; the allocator's pointer is stored directly before the block. */
enum { BASE_ALIGN = 64 };

/* The block in `raw`, whose contents move from `offset` to where alignment wants them. */
static void *memory_align(char *raw, size_t offset, size_t bytes)
{
    const uintptr_t aligned = ((uintptr_t)raw + BASE_ALIGN + sizeof(void *)) & ~(uintptr_t)(BASE_ALIGN - 1);
    void           *header  = raw;
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

/* By the caller's reallocate, which moves pages of large blocks instead of copying them, where it is realloc of a usual libc. */
OXL_INTERNAL void *oxl_regrow(oxl_context *ctx, void *old, size_t old_count, size_t new_count, size_t size)
{
    const size_t overhead = BASE_ALIGN + sizeof(void *);
    char        *raw      = NULL;
    size_t       offset   = 0;
    if (size != 0 && new_count > (SIZE_MAX - overhead) / size) return NULL;
    if (old) {
        memcpy(&raw, (char *)old - sizeof raw, sizeof raw);
        offset = (size_t)((char *)old - raw);
    }
    raw = ctx->options.reallocate(ctx->options.user, raw, new_count * size + overhead);
    return raw ? memory_align(raw, offset, OXL_MIN(old_count, new_count) * size) : NULL;
}

OXL_INTERNAL void oxl_free(oxl_context *ctx, void *memory)
{
    void *raw;
    if (!memory) return;
    memcpy(&raw, (char *)memory - sizeof raw, sizeof raw);
    ctx->options.reallocate(ctx->options.user, raw, 0);
}

OXL_INTERNAL oxl_result oxl_reserve(oxl_context *ctx, void **array, size_t *capacity, size_t needed, size_t size)
{
    const size_t wanted = OXL_MAX(OXL_MAX(needed, (size_t)64), *capacity <= SIZE_MAX / 2 ? *capacity + *capacity / 4 : 0);
    void        *grown;
    if (needed <= *capacity) return OXL_OK;
    grown = oxl_regrow(ctx, *array, *capacity, wanted, size);
    if (!grown) return oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for %zu elements of %zu bytes", wanted, size);
    *array    = grown;
    *capacity = wanted;
    return OXL_OK;
}

/* ---------------------------------------------------------------- text */

OXL_INTERNAL void text_add(struct text *t, const char *format, ...)
{
    va_list args;
    int     length;
    if (t->failed) return;
    va_start(args, format);
    length = vsnprintf(NULL, 0, format, args);
    va_end(args);
    if (length < 0 || oxl_reserve(t->ctx, (void **)&t->data, &t->capacity, t->size + (size_t)length + 1, 1) != OXL_OK) {
        t->failed = 1;
        return;
    }
    va_start(args, format);
    vsnprintf(t->data + t->size, (size_t)length + 1, format, args);
    va_end(args);
    t->size += (size_t)length;
}

OXL_INTERNAL void text_add_json_string(struct text *t, const char *s)
{
    char character[8];
    text_add(t, "\"");
    while (*s) {
        s += oxl_json_escape(s, character);
        text_add(t, "%s", character);
    }
    text_add(t, "\"");
}

OXL_INTERNAL void text_add_number(struct text *t, double value)
{
    text_add(t, "%s", NUMBER(value));
}

OXL_INTERNAL void text_free(struct text *t)
{
    oxl_free(t->ctx, t->data);
    *t = (struct text){.ctx = t->ctx};
}

OXL_INTERNAL oxl_result text_take(struct text *t, char **out)
{
    const int failed = t->failed;
    *out             = NULL;
    if (failed) text_free(t);
    else *out = t->data;
    *t = (struct text){.ctx = t->ctx};
    return failed ? OXL_ERR_MEMORY : OXL_OK;
}

void oxl_text_free(oxl_context *ctx, char *text)
{
    oxl_free(ctx, text);
}

OXL_INTERNAL char *oxl_strdup(oxl_context *ctx, const char *s)
{
    const size_t size = strlen(s) + 1;
    char        *copy = oxl_alloc(ctx, size, 1);
    if (copy) memcpy(copy, s, size);
    return copy;
}

OXL_INTERNAL char *oxl_path_join(oxl_context *ctx, const char *a, const char *b)
{
    const size_t na = strlen(a), nb = strlen(b);
    const int    slash = na > 0 && a[na - 1] != '/';
    char        *path  = oxl_alloc(ctx, na + nb + 2, 1);
    if (!path) return NULL;
    memcpy(path, a, na);
    if (slash) path[na] = '/';
    memcpy(path + na + slash, b, nb + 1);
    return path;
}

OXL_INTERNAL const char *path_in(char out[PATH_LENGTH], const char *folder, const char *format, ...)
{
    const size_t size = strlen(folder), slash = size > 0 && folder[size - 1] != '/', at = size + slash;
    int          rest = PATH_LENGTH;
    va_list      args;
    if (at < PATH_LENGTH) {
        memcpy(out, folder, size);
        memcpy(out + size, "/", slash);
        va_start(args, format);
        rest = vsnprintf(out + at, PATH_LENGTH - at, format, args);
        va_end(args);
    }
    return rest >= 0 && at + (size_t)rest < PATH_LENGTH ? out : "/dev/null/a path of more than 4095 bytes";
}

OXL_INTERNAL const char *path_base_name(const char *path)
{
    const char *slash = strrchr(path, '/');
    return slash ? slash + 1 : path;
}

/* ---------------------------------------------------------------- random numbers */

static uint64_t random_mix(uint64_t x) /* splitmix64 (Steele, Lea & Flood 2014) */
{
    x += UINT64_C(0x9E3779B97F4A7C15);
    x = (x ^ (x >> 30)) * UINT64_C(0xBF58476D1CE4E5B9);
    x = (x ^ (x >> 27)) * UINT64_C(0x94D049BB133111EB);
    return x ^ (x >> 31);
}

OXL_INTERNAL uint64_t random_bits(uint64_t seed, uint64_t a, uint64_t b)
{
    return random_mix(random_mix(random_mix(seed) ^ a) ^ b);
}

OXL_INTERNAL double random_unit(uint64_t bits)
{
    return (double)(bits >> 11) * (1.0 / 9007199254740992.0); /* 2^-53 */
}
