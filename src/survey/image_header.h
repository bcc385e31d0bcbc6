/* image_header.h - size, bits and EXIF orientation of an image. */
#ifndef OXL_IMAGE_HEADER_H
#define OXL_IMAGE_HEADER_H

#include "image.h"

/* Holds what the first bytes of a file say. */
struct image_header {
    int width, height;
    int bits;        /* of a channel */
    int orientation; /* EXIF: 1 upright, 5 to 8 turned by a quarter */
};
#define IMAGE_SHAPE_ERROR 0.01 /* by which ratios of sides may differ */
/* Reads what the header says; a size of 0: not found in its first bytes. */
OXL_INTERNAL oxl_result image_read_header(oxl_context *ctx, const char *path, struct image_header *out);
OXL_INTERNAL int image_has_shape(int width, int height, int wanted_width, int wanted_height);
/* Turns pixels by a quarter as the orientation says: 5 to 8; others stay. */
OXL_INTERNAL oxl_result image_turn(oxl_context *ctx, struct pixels *p, int channels, int orientation);

#endif
