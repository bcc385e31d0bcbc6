/* codec.c - wraps stb_image and stb_image_write, the project's decoder and encoder of JPEG, PNG and deflate.
 *
 * stb's SSE2 and NEON paths give the bytes of its C path (integer IDCT, fixed-point colour), which a test
 * checks. Its hooks have no context, so the call's context is kept for its thread; the memory that a call has
 * allocated is in a list, and freed when the call ends. stb does not always look at what its allocator
 * returns: if memory is refused, longjmp leaves the call.
 *
 * With OXL_ZLIB, zlib deflates: a PNG takes a quarter of the time and three quarters of the bytes.
 *
 * Invariant: what is decoded does not depend on the machine or on the number of threads.
 */
#include "codec.h"

#include <setjmp.h>

/* ---------------- memory */

#if defined(_MSC_VER)
#define CODEC_OF_THREAD __declspec(thread)
#elif defined(__GNUC__)
#define CODEC_OF_THREAD __thread
#else
#define CODEC_OF_THREAD /* Is empty for a compiler without threads, such as tcc. */
#endif

struct codec_block { /* Stands before the memory that stb gets. */
    struct codec_block *before, *after;
    size_t size;
    size_t unused; /* aligns the memory to 16 bytes */
};

static CODEC_OF_THREAD struct {
    oxl_context *ctx;
    struct codec_block *newest;
    jmp_buf *refused;  /* place to which a call returns if memory is refused */
    int out_of_memory; /* 1: the last call was refused memory */
} codec_call;

static void codec_link(struct codec_block *block)
{
    if (block->before) block->before->after = block;
    if (block->after) block->after->before = block;
    else codec_call.newest = block;
}

static void codec_unlink(struct codec_block *block)
{
    if (block->before) block->before->after = block->after;
    if (block->after) block->after->before = block->before;
    else codec_call.newest = block->before;
    block->before = block->after = NULL;
}

static void codec_refuse(void)
{
    codec_call.out_of_memory = 1;
    longjmp(*codec_call.refused, 1);
}

/* Allocates zeros, since the decoder reads tables that a damaged file does not define. */
static void *codec_malloc(size_t size)
{
    struct codec_block *block =
        size <= SIZE_MAX - sizeof *block ? oxl_calloc(codec_call.ctx, 1, sizeof *block + size) : NULL;
    if (!block) codec_refuse();
    block->before = codec_call.newest;
    block->size = size;
    codec_link(block);
    return block + 1;
}

static void *codec_realloc(void *old, size_t size)
{
    struct codec_block *block = old ? (struct codec_block *)old - 1 : NULL, *grown = NULL;
    if (!block) return codec_malloc(size);
    if (size <= SIZE_MAX - sizeof *block)
        grown = oxl_regrow(codec_call.ctx, block, sizeof *block + block->size, sizeof *block + size, 1);
    if (!grown) codec_refuse();
    grown->size = size;
    codec_link(grown);
    return grown + 1;
}

static void codec_release(void *memory)
{
    struct codec_block *block = memory ? (struct codec_block *)memory - 1 : NULL;
    if (!block) return;
    codec_unlink(block);
    oxl_free(codec_call.ctx, block);
}

static void codec_enter(oxl_context *ctx, jmp_buf *refused)
{
    codec_call.ctx = ctx;
    codec_call.newest = NULL;
    codec_call.refused = refused;
    codec_call.out_of_memory = 0;
}

/* Ends a call: takes the result out of the list and frees all other memory. */
static void *codec_leave(void *result)
{
    if (result) codec_unlink((struct codec_block *)result - 1);
    while (codec_call.newest) codec_release(codec_call.newest + 1);
    codec_call.ctx = NULL;
    codec_call.refused = NULL;
    return result;
}

/* Begins a call, which returns NULL if memory is refused. */
#define CODEC_ENTER(ctx)        \
    jmp_buf refused;            \
    codec_enter(ctx, &refused); \
    if (setjmp(refused) != 0) return codec_leave(NULL)

/* ---------------- zlib */

enum { CODEC_AVERAGE = 3, CODEC_SEARCH = 5 }; /* a filter of PNG, stb's shortest search */

#ifdef OXL_ZLIB
#include <zlib.h>

static void *codec_zlib_malloc(void *user, unsigned count, unsigned size)
{
    (void)user;
    return codec_malloc((size_t)count * size);
}

static void codec_zlib_release(void *user, void *memory)
{
    (void)user;
    codec_release(memory);
}

static unsigned char *codec_zlib(unsigned char *data, int size, int *out_size, int search)
{
    z_stream z = {.zalloc = codec_zlib_malloc, .zfree = codec_zlib_release, .next_in = data};
    unsigned char *out;
    if (deflateInit(&z, search > CODEC_SEARCH ? Z_DEFAULT_COMPRESSION : Z_BEST_SPEED) != Z_OK) return NULL;
    z.avail_in = (unsigned)size, z.avail_out = (unsigned)deflateBound(&z, (unsigned)size);
    out = z.next_out = codec_malloc(z.avail_out);
    deflate(&z, Z_FINISH);
    *out_size = (int)z.total_out;
    deflateEnd(&z);
    return out;
}
#define STBIW_ZLIB_COMPRESS codec_zlib
#endif

/* ---------------- stb */

#ifdef __GNUC__
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wpragmas"
#pragma GCC diagnostic ignored "-Wpedantic"
#pragma GCC diagnostic ignored "-Wunused-function"
#pragma GCC diagnostic ignored "-Wunused-parameter"
#pragma GCC diagnostic ignored "-Wunused-but-set-variable"
#pragma GCC diagnostic ignored "-Wsign-compare"
#pragma GCC diagnostic ignored "-Wmissing-field-initializers"
#endif
/* Avoids warnings of gcc about declared and undefined functions, which these pragmas do not stop: hence
 * NO_GIF beside ONLY_JPEG and ONLY_PNG, and a macro for a function misspelt in stb_image 2.27. */
#define STB_IMAGE_STATIC
#define STB_IMAGE_IMPLEMENTATION
#define STBI_NO_STDIO
#define STBI_NO_GIF
#define STBI_ONLY_JPEG
#define STBI_ONLY_PNG
#define STBI_MALLOC(size) codec_malloc(size)
#define STBI_REALLOC(old, size) codec_realloc(old, size)
#define STBI_FREE(old) codec_release(old)
#define STBIW_MALLOC(size) codec_malloc(size)
#define STBIW_REALLOC(old, size) codec_realloc(old, size)
#define STBIW_FREE(old) codec_release(old)
#ifdef __TINYC__ /* tcc defines x86-64 and has no intrinsics */
#define STBI_NO_SIMD
#endif
#define stbi_set_unpremultiply_on_load_thread stbi__unpremultiply_on_load_thread
#include <stb/stb_image.h>
#define STB_IMAGE_WRITE_STATIC
#define STB_IMAGE_WRITE_IMPLEMENTATION
/* Keeps sanitizers from stopping at stb's JPEG encoder, which shifts bits out of a
 * signed number on purpose. */
#ifdef __clang__
#pragma clang attribute push(__attribute__((no_sanitize("shift"))), apply_to = function)
#elif defined(__GNUC__)
#pragma GCC push_options
#pragma GCC optimize("wrapv")
#endif
#include <stb/stb_image_write.h>
#ifdef __clang__
#pragma clang attribute pop
#elif defined(__GNUC__)
#pragma GCC pop_options
#endif
#ifdef __GNUC__
#pragma GCC diagnostic pop
#endif

OXL_INTERNAL uint8_t *codec_decode(oxl_context *ctx, const void *file, size_t size, int channels, int *width,
                                   int *height)
{
    int in_file;
    CODEC_ENTER(ctx);
    return codec_leave(stbi_load_from_memory(file, (int)size, width, height, &in_file, channels));
}

OXL_INTERNAL uint16_t *codec_decode_16(oxl_context *ctx, const void *file, size_t size, int channels,
                                       int *width, int *height)
{
    int in_file;
    CODEC_ENTER(ctx);
    return codec_leave(stbi_load_16_from_memory(file, (int)size, width, height, &in_file, channels));
}

OXL_INTERNAL const char *codec_failure(void)
{
    const char *reason = stbi_failure_reason(); /* NULL: stb names none, as for data that end too early */
    return codec_call.out_of_memory ? "outofmem" : reason ? reason : "damaged";
}

OXL_INTERNAL void codec_free(oxl_context *ctx, void *memory)
{
    if (memory) oxl_free(ctx, (struct codec_block *)memory - 1);
}

/* Sets one filter for all rows and a short search: all five filters and a longer search take 1.6 times as
 * long and give the same size (docs/log/SPEED.md). */
OXL_INTERNAL void codec_begin(void)
{
#ifdef _OPENMP
#pragma omp critical(codec_begin)
#endif
    if (stbi_write_force_png_filter != CODEC_AVERAGE || stbi_write_png_compression_level != CODEC_SEARCH) {
        stbi_write_force_png_filter = CODEC_AVERAGE;
        stbi_write_png_compression_level = CODEC_SEARCH;
    }
}

OXL_INTERNAL uint8_t *codec_encode_png(oxl_context *ctx, const uint8_t *rows, int width, int height,
                                       int channels, int *size)
{
    CODEC_ENTER(ctx);
    return codec_leave(stbi_write_png_to_mem(rows, channels * width, width, height, channels, size));
}

OXL_INTERNAL unsigned codec_png_checksum(const uint8_t *data, int size)
{
    return stbiw__crc32((unsigned char *)data, size);
}

OXL_INTERNAL void codec_encode_jpeg(codec_sink *sink, void *user, const uint8_t *rows, int width, int height,
                                    int quality)
{
    /* Needs no CODEC_ENTER: the encoder allocates nothing. */
    stbi_write_jpg_to_func(sink, user, width, height, 3, rows, quality);
}

/* Needs no CODEC_ENTER: the decoder allocates nothing for a result of known size. */
OXL_INTERNAL int codec_inflate(void *out, size_t size, const void *data, size_t data_size)
{
    codec_call.out_of_memory = 0;
    return size <= INT_MAX && data_size <= INT_MAX &&
           stbi_zlib_decode_noheader_buffer(out, (int)size, data, (int)data_size) == (int)size;
}

OXL_INTERNAL uint8_t *codec_deflate(oxl_context *ctx, const void *data, size_t size, int *zlib_size)
{
    enum { LEVEL = 8 };
    CODEC_ENTER(ctx);
    if (size > INT_MAX) return codec_leave(NULL);
    return codec_leave(stbi_zlib_compress((unsigned char *)data, (int)size, zlib_size, LEVEL));
}
