/* survey.h - a survey in memory: cameras, images and their cache, the scene, statistics. */
#ifndef OXL_SURVEY_H
#define OXL_SURVEY_H

#include "image.h"

/* ---------------- robust_stats.c: robust measures of a survey */

/* Returns a quantile of sorted values by the nearest rank; 0 without values. */
OXL_INTERNAL double stats_quantile(const double *ascending, size_t count, double quantile);
/* Returns the quantile of unsorted values, which it reorders. */
OXL_INTERNAL double stats_select(double *value, size_t count, double quantile);
/* Finds the 1st, 50th and 99th percentile of each coordinate of n positions, which
 * are `stride` bytes apart. */
OXL_INTERNAL oxl_result stats_bounds(oxl_context *ctx, const double *position, size_t n, size_t stride,
                                     double low[3], double middle[3], double high[3]);
/* Returns the largest distance of a training camera's centre from their mean, without those beyond 5 median
 * distances; 0 for one camera. */
OXL_INTERNAL oxl_result stats_camera_radius(oxl_context *ctx, const oxl_scene *scene, double *radius);
/* Samples the camera z of points in the training views of their tracks, ascending, into scene->depth; without
 * tracks, in those whose image they project into. */
OXL_INTERNAL oxl_result stats_depths(oxl_context *ctx, oxl_scene *scene);

/* ---------------- misfit.c: how a displaced camera explains a render's error */

struct misfit {
    double explained;   /* fraction of the squared error of detail */
    double least, most; /* px; the shifts of the render over the image */
    double shift[2];    /* px, right and down; in the middle */
};
#define MISFIT_EVIDENT 0.12 /* bounds what a displaced camera explains from below; woods explain less */
/* Measures the misfit. Clamps the render; gives masked pixels of the image NaN. */
OXL_INTERNAL oxl_result misfit_measure(oxl_context *ctx, oxl_image *rendered, oxl_image *image,
                                       struct misfit *out);

/* ---------------- contrast.c: how fast contrast fades with depth */

struct contrast {
    int measured; /* 0: too few points observed from several depths */
    /* contrast is proportional to exp(-beta z), beta per unit of the scene; standard error of beta */
    double beta, error;
    size_t points;
};
OXL_INTERNAL oxl_result contrast_measure(oxl_context *ctx, const oxl_scene *scene, struct contrast *out);

#endif
