/* codec.h - declares JPEG, PNG and deflate, by stb. codec.c alone includes stb, so that no other file waits
 * for it. Memory is the context's. */
#ifndef OXL_CODEC_H
#define OXL_CODEC_H

#include "core.h"

/* Decodes to interleaved rows of `channels` (1 to 4); NULL: see codec_failure. Free the result with
 * codec_free. */
OXL_INTERNAL uint8_t *codec_decode(oxl_context *ctx, const void *file, size_t size, int channels, int *width,
                                   int *height);
OXL_INTERNAL uint16_t *codec_decode_16(oxl_context *ctx, const void *file, size_t size, int channels,
                                       int *width, int *height);
/* Returns why the last call of this thread failed; "outofmem": memory was refused. */
OXL_INTERNAL const char *codec_failure(void);
OXL_INTERNAL void codec_free(oxl_context *ctx, void *memory); /* NULL is ignored */

OXL_INTERNAL void codec_begin(void); /* sets stb's PNG parameters, which the other functions only read */
/* Encodes interleaved rows of `channels`; NULL: no memory. Free the result with codec_free. */
OXL_INTERNAL uint8_t *codec_encode_png(oxl_context *ctx, const uint8_t *rows, int width, int height,
                                       int channels, int *size);
OXL_INTERNAL unsigned codec_png_checksum(const uint8_t *data, int size); /* CRC-32 of a chunk */
typedef void codec_sink(void *user, void *part, int size);
/* Encodes interleaved RGB rows as JPEG and passes its parts to `sink`. */
OXL_INTERNAL void codec_encode_jpeg(codec_sink *sink, void *user, const uint8_t *rows, int width, int height,
                                    int quality);

/* Inflates raw deflate data to exactly `size` bytes; returns 0 for damaged data. */
OXL_INTERNAL int codec_inflate(void *out, size_t size, const void *data, size_t data_size);
/* Deflates into a zlib stream of *zlib_size bytes; NULL: no memory. Free the result with codec_free. */
OXL_INTERNAL uint8_t *codec_deflate(oxl_context *ctx, const void *data, size_t size, int *zlib_size);

#endif
