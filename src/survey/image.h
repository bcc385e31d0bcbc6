/* image.h - declares images: decode, reduce, undistort, mask; decoded images in memory and in files. */
#ifndef OXL_IMAGE_H
#define OXL_IMAGE_H

#include "sparse.h"

/* ---------------- image.c: decode, reduce, undistort, mask */

struct pixels { /* Holds pixels of 8 bits, interleaved. */
    int width, height, channels;
    uint8_t *data;
};
/* Decodes a file. channels 0: 4 if the file has alpha, otherwise 3. */
OXL_INTERNAL oxl_result image_decode(oxl_context *ctx, const char *path, int channels, struct pixels *out);
/* Reads the size from the header alone. */
OXL_INTERNAL oxl_result image_size(oxl_context *ctx, const char *path, int *width, int *height);
/* Fails unless the file has the camera's shape, resized or turned by its EXIF orientation. */
OXL_INTERNAL oxl_result image_check_shape(oxl_context *ctx, const char *path, int width, int height,
                                          const struct colmap_camera *from);
OXL_INTERNAL void image_pixels_free(oxl_context *ctx, struct pixels *p);

/* Holds a training image: planar 8-bit (3,H,W), and its mask (H,W) or NULL (255 used, 0 masked). */
struct training_image {
    int width, height;
    uint8_t *rgb;
    uint8_t *mask;
};
/* Says how transparent pixels are used: masked (alpha below a half), or composited over `background`. */
struct image_alpha {
    int masks;
    uint8_t background[3];
};
/* Decodes an image, undistorts it if `from` is distorted, and reduces it by area averaging to the size of
 * `to`, its mask alike. mask_path may be NULL; so may alpha: colours are then taken as they are. */
OXL_INTERNAL oxl_result image_load_training(oxl_context *ctx, const char *path, const char *mask_path,
                                            const struct image_alpha *alpha, const struct colmap_camera *from,
                                            const oxl_camera *to, struct training_image *out);
/* Masks what is black in the mask, of any size, too. */
OXL_INTERNAL oxl_result image_add_mask(oxl_context *ctx, const struct pixels *mask,
                                       struct training_image *image);
OXL_INTERNAL oxl_result image_training_alloc(oxl_context *ctx, const oxl_camera *to, int with_mask,
                                             struct training_image *out);
OXL_INTERNAL void image_training_free(oxl_context *ctx, struct training_image *image);
struct image_window { /* Names a part of an image (px); width 0: nothing of it. */
    int x, y, width, height;
};
/* Converts the window, or with NULL the whole image, to rgb (3,h,w) and weight (h,w) or NULL. */
OXL_INTERNAL void image_from_training(const oxl_context *ctx, const struct training_image *image,
                                      const struct image_window *window, float *rgb, float *weight);
/* Halves the sides in place: pixels are means of 2 x 2, masked if one of these is; odd edges are
 * dropped. weight may be NULL. */
OXL_INTERNAL void image_halve(int width, int height, float *rgb, float *weight);
/* Converts an image to 8 bits, into allocated planes of `to`; weights up to 0.5 are masked. */
OXL_INTERNAL void image_to_training(const oxl_image *image, struct training_image *to);
/* Rounds 0..1 to 0..255. */
static inline uint8_t image_to_byte(float v)
{
    if (!(v > 0)) return 0; /* Makes 0 of NaN, too. */
    return v < 1 ? (uint8_t)(v * 255.0f + 0.5f) : 255;
}

/* ---------------- scene_images.c: which images are in memory */

enum {
    /* most images that are loaded in parallel; memory is planned for as many on any number of threads */
    SCENE_AHEAD = 4,
    /* bytes per pixel of a file: planes and colours of a JPEG; a progressive one
     * and 16 bits take twice that */
    SCENE_DECODE_BYTES = 6
};

struct image_cache {
    struct training_image *image; /* (views) rgb is NULL if not in memory */
    uint64_t *used;               /* (views) time of the last request */
    uint64_t clock;
    size_t held, limit;    /* bytes in memory; limit of these */
    uint8_t background[3]; /* under transparent pixels */
    char *decoded;         /* folder of decoded images, or NULL */
};

/* ---------------- image_file.c: decoded images in files */

enum { IMAGE_FILE_NAME = 16 /* digits of the key in hexadecimal */ };

OXL_INTERNAL uint64_t image_file_key(const char *path, const char *mask, const struct image_alpha *alpha,
                                     const struct colmap_camera *from, const oxl_camera *to);
OXL_INTERNAL int image_file_read(oxl_context *ctx, const char *path, uint64_t key, const oxl_camera *to,
                                 struct training_image *out); /* 1: the file exists and is complete */
OXL_INTERNAL oxl_result image_file_write(oxl_context *ctx, const char *path, uint64_t key,
                                         const struct training_image *image);

#endif
