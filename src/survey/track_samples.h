/* track_samples.h - samples points in the images that observe them: what is measured before any training. */
#ifndef OXL_TRACK_SAMPLES_H
#define OXL_TRACK_SAMPLES_H

#include "imaging.h"

struct training_image;
enum { TRACK_SAMPLES_VIEWS = 128, TRACK_SAMPLES_LONGEST = 32 }; /* most images; most samples of a point */
struct track_sample {                                           /* Holds a point in an image. */
    size_t point;
    int view, valid;           /* view: index in `chosen` */
    float x, y, near;          /* px; size of the point here over that in its farthest view */
    double z, range;           /* camera z; distance */
    float value[3], weight[3]; /* what is measured */
};
struct track_samples {
    int *view, views; /* (images) index in `chosen`, -1: not used */
    int chosen[TRACK_SAMPLES_VIEWS], lamp_of[TRACK_SAMPLES_VIEWS]; /* (views) view, lamp of its camera */
    struct lamp lamp[LAMP_MAX];
    int lamps;
    struct track_sample *at; /* (count) one point after the other */
    size_t count, fewest;    /* fewest: least samples of a point */
};
/* Takes at most `most` samples of points; free them with track_samples_free even after an error. */
OXL_INTERNAL oxl_result track_samples_take(oxl_context *ctx, const oxl_scene *scene, size_t most,
                                           size_t fewest, struct track_samples *out);
OXL_INTERNAL void track_samples_free(oxl_context *ctx, struct track_samples *s);
/* Returns the end of the samples of the point whose first sample is `first`. */
OXL_INTERNAL size_t track_samples_end(const struct track_samples *s, size_t first);
/* Sums the 8-bit values of the pixels from `from` on to before `to` (x, y); returns 0 if some are masked or
 * outside. */
OXL_INTERNAL int track_sample_sum(const struct training_image *image, const int from[2], const int to[2],
                                  double sum[3]);
typedef int track_sample_measurer(const struct training_image *image,
                                  struct track_sample *s); /* 0: invalid */
/* Measures all samples, view by view, so that each image is loaded once, and keeps the valid ones; leaves out
 * unreadable images. */
OXL_INTERNAL oxl_result track_samples_measure(oxl_context *ctx, const oxl_scene *scene,
                                              track_sample_measurer *measure, struct track_samples *s);

#endif
