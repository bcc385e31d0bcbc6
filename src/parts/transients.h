/* transients.h - the state of transients.c, for that file and its tests: masks of moving objects. */
#ifndef OXL_PART_TRANSIENTS_H
#define OXL_PART_TRANSIENTS_H

#include "../train/part.h"

/* of white: limit of an error in the mean; above it each fish raises the threshold of the next */
#define TRANSIENTS_MAX 0.05f
struct transients_square { /* of pixels, in the present view */
    /* difference of the mean colours, fraction of white; -1: all its pixels are masked */
    float error;
    float expected; /* largest expected error of the points in it; -1: no point */
    unsigned marks;
};
struct transients {
    size_t points;   /* of the scene; 0: off */
    float *expected; /* (points) running mean of the error at its position, over the views that see it */
    int32_t *place;  /* (points) its square in the present view, or -1 */
    struct transients_square *square;
    size_t square_capacity;
    double masked_fraction;            /* fraction of masked pixels, smoothed over the last images */
    struct renderer_transients device; /* the next view's, where a device renders */
};
OXL_INTERNAL oxl_result transients_begin(oxl_context *ctx, struct transients *t, const oxl_scene *scene,
                                         int on);
OXL_INTERNAL void transients_free(struct train *t, void *state);
struct transients_view {
    const oxl_camera *camera;
    double near_plane;
    const float *rendered, *image; /* (3,H,W) */
    float *weight;                 /* (H,W): set to 0 where masked as transient */
    int has_mask;                  /* weight contains a mask; 0: all weights are 1 */
};
/* Masks a view. update 0: the expected errors do not change, as in the steps of a trial. */
OXL_INTERNAL oxl_result transients_mask(oxl_context *ctx, struct transients *t, const oxl_scene *scene,
                                        const struct transients_view *view, int update);
/* Describes the masked fraction as text. */
OXL_INTERNAL void transients_describe(const struct transients *t, char *out, size_t size);

#endif
