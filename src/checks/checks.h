/* checks.h - checks of a survey: files, images, points and poses that contradict each other. */
#ifndef OXL_CHECKS_H
#define OXL_CHECKS_H

#include "../core/core.h"
#include "../survey/image.h"
#include "../../oceanxl_job.h"

/* ---------------- lint.c: contradictions between readable files */

/* Reports the whole survey from this fraction of observations outside their image on. */
#define LINT_MISSED_SURVEY 0.1
/* Sets s->missed, the fraction of observations outside their image, and logs wrong poses. */
OXL_INTERNAL oxl_result lint_observations(oxl_context *ctx, const oxl_scene *scene, oxl_survey *s);
/* Sets s->unusable and s->masked, and logs what is wrong with images and masks.
 * OXL_ERR_INPUT: no image can be used. */
OXL_INTERNAL oxl_result lint_images(oxl_context *ctx, const oxl_scene *scene, oxl_survey *s);
/* Compares the shapes of masks and images by the files' headers. */
OXL_INTERNAL oxl_result lint_masks(oxl_context *ctx, const oxl_scene *scene);
/* Checks the header and segments of an image, and its shape. */
OXL_INTERNAL oxl_result lint_image(oxl_context *ctx, const oxl_scene *scene, int view);
/* Compares the pixels that points project to with those where images saw them, and logs what does
 * not fit (reprojection.c). */
OXL_INTERNAL oxl_result reprojection_check(oxl_context *ctx, const oxl_scene *scene);
/* Compares images with the points and, if s->missed says so or there are no tracks, poses; logs what does not
 * fit and sets s->foreign (belongs.c). damaged 1: logs images that cannot be decoded, as training does. */
OXL_INTERNAL oxl_result match_check(oxl_context *ctx, oxl_scene *scene, int damaged, oxl_survey *s);
/* Finds principal points far from the middle, 16-bit images of fewer bits, and masks without
 * a black pixel (values.c). */
OXL_INTERNAL oxl_result values_check(oxl_context *ctx, oxl_scene *scene);
/* Decodes every image; logs and counts blurred and badly exposed images (quality.c). */
OXL_INTERNAL oxl_result quality_check(oxl_context *ctx, oxl_scene *scene, oxl_survey *s);

/* ---------------- quality.c: images that differ from those taken next to them */

enum { QUALITY_NEIGHBOURS = 8 };
#define QUALITY_BLUR 0.6 /* Counts an image as blurred below this fraction of its neighbours' sharpness. */
/* Lists the cameras nearest to `of` that look the same way, nearest first, as indices among `count`
 * views; returns their number. */
OXL_INTERNAL int quality_nearest(const oxl_scene *scene, const int *view, int count, int of,
                                 int out[QUALITY_NEIGHBOURS]);
/* Returns the sharpness, independent of exposure: the mean absolute second difference of the green channel
 * over the channel's mean, along the axis where it is less, since motion blurs one axis. fine: this
 * difference over that of pixels 2 px apart, which blur lowers and a plain surface does not; or NULL. */
OXL_INTERNAL double quality_sharpness(const struct training_image *image, double *fine);

#endif
