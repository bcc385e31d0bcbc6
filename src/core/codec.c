/* codec.c - wraps stb_image and stb_image_write, the project's decoder and encoder of JPEG, PNG and deflate.
 *
 * stb's SSE2 and NEON paths give the bytes of its C path (integer IDCT, fixed-point colour), which a test
 * checks. stb allocates with malloc, since its hooks have no context.
 *
 * Invariant: the bytes do not depend on the machine or on the number of threads.
 */
#include "codec.h"

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
/* gcc warns about declared and undefined functions in spite of these pragmas; hence NO_GIF beside ONLY_JPEG
 * and ONLY_PNG, and a macro for a function misspelt in stb_image 2.27. */
#define STB_IMAGE_STATIC
#define STB_IMAGE_IMPLEMENTATION
#define STBI_NO_STDIO
#define STBI_NO_GIF
#define STBI_ONLY_JPEG
#define STBI_ONLY_PNG
#define STBI_MALLOC(size) calloc(1, size) /* its decoder reads tables that a damaged file does not define */
#define STBI_REALLOC(old, size) realloc(old, size)
#define STBI_FREE(old) free(old)
#ifdef __TINYC__ /* defines x86-64 without intrinsics */
#define STBI_NO_SIMD
#endif
#define stbi_set_unpremultiply_on_load_thread stbi__unpremultiply_on_load_thread
#include <stb/stb_image.h>
#define STB_IMAGE_WRITE_STATIC
#define STB_IMAGE_WRITE_IMPLEMENTATION
/* Its JPEG encoder shifts bits out of a signed number on purpose: sanitizers must not stop there. */
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

OXL_INTERNAL int codec_read_header(const void *file, size_t size, int *width, int *height, int *channels)
{
    return stbi_info_from_memory(file, (int)size, width, height, channels);
}

OXL_INTERNAL int codec_is_16_bit(const void *file, size_t size)
{
    return stbi_is_16_bit_from_memory(file, (int)size);
}

OXL_INTERNAL uint8_t *codec_decode(const void *file, size_t size, int channels, int *width, int *height)
{
    int in_file;
    return stbi_load_from_memory(file, (int)size, width, height, &in_file, channels);
}

OXL_INTERNAL uint16_t *codec_decode_16(const void *file, size_t size, int channels, int *width, int *height)
{
    int in_file;
    return stbi_load_16_from_memory(file, (int)size, width, height, &in_file, channels);
}

OXL_INTERNAL const char *codec_failure(void)
{
    return stbi_failure_reason();
}

OXL_INTERNAL void codec_free(void *memory)
{
    free(memory);
}

/* Sets one filter for all rows and a short search: all five filters and a longer search take 1.6 times as
 * long for the same size (docs/log/SPEED.md). */
OXL_INTERNAL void codec_begin(void)
{
    enum { AVERAGE = 3, SEARCH = 5 };
#ifdef _OPENMP
#pragma omp critical(codec_begin)
#endif
    if (stbi_write_force_png_filter != AVERAGE || stbi_write_png_compression_level != SEARCH) {
        stbi_write_force_png_filter = AVERAGE;
        stbi_write_png_compression_level = SEARCH;
    }
}

OXL_INTERNAL uint8_t *codec_encode_png(const uint8_t *rows, int width, int height, int channels, int *size)
{
    return stbi_write_png_to_mem(rows, channels * width, width, height, channels, size);
}

OXL_INTERNAL unsigned codec_png_checksum(const uint8_t *data, int size)
{
    return stbiw__crc32((unsigned char *)data, size);
}

OXL_INTERNAL void codec_encode_jpeg(codec_sink *sink, void *user, const uint8_t *rows, int width, int height,
                                    int quality)
{
    stbi_write_jpg_to_func(sink, user, width, height, 3, rows, quality);
}

OXL_INTERNAL int codec_inflate(void *out, size_t size, const void *data, size_t data_size)
{
    if (size > INT_MAX || data_size > INT_MAX) return 0;
    return stbi_zlib_decode_noheader_buffer(out, (int)size, data, (int)data_size) == (int)size;
}

OXL_INTERNAL uint8_t *codec_deflate(const void *data, size_t size, int *zlib_size)
{
    enum { LEVEL = 8 };
    return size <= INT_MAX ? stbi_zlib_compress((unsigned char *)data, (int)size, zlib_size, LEVEL) : NULL;
}
