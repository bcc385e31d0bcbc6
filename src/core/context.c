/* context.c - context, errors, memory, growing text, random numbers.
 *
 * Invariant: all memory of the library comes from ctx->options.reallocate, so that a caller can count it, limit it or make it fail.
 */
#include "core.h"
#include "json.h"
#include "simd.h"

/* ---------------------------------------------------------------- context */

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

/* The result does not depend on the number of threads; the OpenMP runtime crashes with 100 000. */
enum { BASE_THREADS_MAX = 1024 };

static int context_threads(int wanted, int *available)
{
#ifdef _OPENMP
    const int asked = wanted > 0 ? wanted : omp_get_max_threads(), quota = os_processor_quota(), there = omp_get_num_procs();
    *available = OXL_MIN(quota > 0 ? OXL_MIN(quota, there) : there, BASE_THREADS_MAX);
    return asked;
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
    oxl_context_options o   = options ? *options : oxl_context_options_default();
    oxl_context        *ctx = NULL;
    int                 available, asked = context_threads(o.threads, &available);
    *out = NULL;
    if (!o.reallocate) o.reallocate = context_reallocate;
    ctx = o.reallocate(o.user, NULL, sizeof *ctx);
    if (!ctx) return OXL_ERR_MEMORY;
    *ctx = (oxl_context){.options = o, .threads = OXL_MIN(asked, available), .isa = simd_detect()};
    if (asked > available)
        oxl_log(ctx, OXL_LOG_INFO, "%d threads are asked for and %d processor%s available: as many threads are used", asked,
                available, available == 1 ? " is" : "s are");
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

OXL_INTERNAL oxl_result context_wait(oxl_context *ctx, double seconds)
{
    os_sleep(seconds);
    return context_stopped(ctx);
}

const char *oxl_error_text(const oxl_context *ctx)
{
    return ctx ? ctx->error : "";
}

int oxl_is_folder(const char *path)
{
    return os_is_folder(path);
}

oxl_result oxl_make_folder(oxl_context *ctx, const char *path)
{
    return os_make_folder(ctx, path);
}

const char *oxl_isa_name(const oxl_context *ctx)
{
    return simd_name(ctx->isa);
}

/* The caller's allocator, one thread at a time. */
static void *context_reallocate_in_turn(void *user, void *old, size_t size)
{
    const oxl_context_options *caller = user;
    void                      *memory;
#ifdef _OPENMP
#pragma omp critical(base_memory)
#endif
    memory = caller->reallocate(caller->user, old, size);
    return memory;
}

OXL_INTERNAL oxl_context context_for_thread(oxl_context *ctx)
{
    return (oxl_context){
        .options = {.reallocate = context_reallocate_in_turn, .user = &ctx->options}, .threads = 1, .isa = ctx->isa};
}

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

OXL_INTERNAL void *oxl_alloc(oxl_context *ctx, size_t count, size_t size)
{
    const size_t overhead = BASE_ALIGN + sizeof(void *);
    char        *raw;
    uintptr_t    aligned;
    void        *header;
    if (size != 0 && count > (SIZE_MAX - overhead) / size) return NULL;
    raw = ctx->options.reallocate(ctx->options.user, NULL, count * size + overhead);
    if (!raw) return NULL;
    aligned = ((uintptr_t)raw + overhead) & ~(uintptr_t)(BASE_ALIGN - 1);
    header  = raw;
    memcpy((char *)aligned - sizeof header, &header, sizeof header);
    return (void *)aligned;
}

OXL_INTERNAL void *oxl_calloc(oxl_context *ctx, size_t count, size_t size)
{
    void *memory = oxl_alloc(ctx, count, size);
    if (memory) memset(memory, 0, count * size);
    return memory;
}

OXL_INTERNAL void *oxl_regrow(oxl_context *ctx, void *old, size_t old_count, size_t new_count, size_t size)
{
    void *memory = oxl_alloc(ctx, new_count, size);
    if (!memory) return NULL;
    if (old) memcpy(memory, old, OXL_MIN(old_count, new_count) * size);
    oxl_free(ctx, old);
    return memory;
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
    size_t wanted = *capacity ? *capacity : 64;
    void  *grown;
    if (needed <= *capacity) return OXL_OK;
    while (wanted < needed) {
        if (wanted > SIZE_MAX / 2) return oxl_fail(ctx, OXL_ERR_MEMORY, "an array of %zu elements cannot exist", needed);
        wanted *= 2;
    }
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

/* printf follows the caller's locale, JSON does not: a decimal comma becomes a point. */
OXL_INTERNAL void text_add_number(struct text *t, double value)
{
    char digits[40];
    if (!(fabs(value) <= DBL_MAX)) {
        text_add(t, "null");
        return;
    }
    for (int precision = 6; precision <= 17; precision++) {
        snprintf(digits, sizeof digits, "%.*g", precision, value);
        if (strtod(digits, NULL) == value) break;
    }
    for (char *c = digits; *c; c++)
        if (*c == ',') *c = '.';
    text_add(t, "%s", digits);
}

OXL_INTERNAL void text_add_float(struct text *t, float value)
{
    char digits[NUMBER_TEXT_MAX];
    format_float(digits, value);
    text_add(t, "%s", fabsf(value) <= FLT_MAX ? digits : "null");
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

/* ---------------------------------------------------------------- random numbers */

static uint64_t context_mix(uint64_t x) /* splitmix64 (Steele, Lea & Flood 2014) */
{
    x += UINT64_C(0x9E3779B97F4A7C15);
    x = (x ^ (x >> 30)) * UINT64_C(0xBF58476D1CE4E5B9);
    x = (x ^ (x >> 27)) * UINT64_C(0x94D049BB133111EB);
    return x ^ (x >> 31);
}

OXL_INTERNAL uint64_t random_bits(uint64_t seed, uint64_t a, uint64_t b)
{
    return context_mix(context_mix(context_mix(seed) ^ a) ^ b);
}

OXL_INTERNAL double random_unit(uint64_t bits)
{
    return (double)(bits >> 11) * (1.0 / 9007199254740992.0); /* 2^-53 */
}
