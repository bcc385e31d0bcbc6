/* image_header.h - reads size, bits and EXIF orientation of an image. */
#ifndef OXL_IMAGE_HEADER_H
#define OXL_IMAGE_HEADER_H

#include "image.h"

/* Holds what an image file states. */
struct image_header {
    int width, height;
    int bits;                     /* bits of a channel */
    int orientation;              /* EXIF: 1 upright, 5 to 8 turned by a quarter */
    int has_alpha;                /* 1: some pixels may be transparent */
    int is_linear;                /* 1: values are proportional to light */
    size_t palette, palette_size; /* place and bytes of a PNG's palette; 0: none */
};
#define IMAGE_SHAPE_ERROR 0.01 /* Limits how far the ratios of sides may differ. */
/* Reads the header in a file's first `size` bytes; returns what is wrong with these: what is damaged, or,
 * with a fix, why the file is not read; NULL: nothing. sums 1: compares checksums, too. */
OXL_INTERNAL const char *image_header_of(const void *file, size_t size, int sums, struct image_header *out);
/* Reads the header; width 0: it is not in the file's first bytes. */
OXL_INTERNAL oxl_result image_read_header(oxl_context *ctx, const char *path, struct image_header *out);
/* Returns 1 if an image has the wanted ratio of sides. */
OXL_INTERNAL int image_has_shape(int width, int height, int wanted_width, int wanted_height);
/* Turns pixels by a quarter for the orientations 5 to 8; other orientations stay. */
OXL_INTERNAL oxl_result image_turn(oxl_context *ctx, struct pixels *p, int channels, int orientation);

#endif
