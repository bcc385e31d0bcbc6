/* checks.h - checks of a survey: files, images, points and poses that contradict each other. */
#ifndef OXL_CHECKS_H
#define OXL_CHECKS_H

#include "../core/core.h"
#include "../survey/image.h"
#include "../../oceanxl_job.h"

/* ---------------- lint.c: contradictions between readable files */

/* Logs what is wrong with masks and, closely, images, and sets s->unusable and s->masked then.
 * OXL_ERR_INPUT: no image can be used. */
OXL_INTERNAL oxl_result lint_images(oxl_context *ctx, const oxl_scene *scene, int closely, oxl_survey *s);
/* Checks the header and segments of an image, and its shape. */
OXL_INTERNAL oxl_result lint_image(oxl_context *ctx, const oxl_scene *scene, int view);
/* Decodes every image; logs and counts blurred and badly exposed images (quality.c). */
OXL_INTERNAL oxl_result quality_check(oxl_context *ctx, oxl_scene *scene, oxl_survey *s);

/* ---------------- hypotheses.c: images, poses and points that do not belong together */

/* Compares what images show with the points, and logs what does not fit and how it would. Sets *foreign to
 * the number of images that do not fit. damaged 1: logs images that cannot be decoded, as training does. */
OXL_INTERNAL oxl_result hypotheses_check(oxl_context *ctx, oxl_scene *scene, int damaged, int *foreign);

/* ---------------- quality.c: images that differ from those taken next to them */

enum { QUALITY_NEIGHBOURS = 8 };
/* Lists the cameras nearest to `of` that look the same way, nearest first, as indices among `count`
 * views; returns their number. */
OXL_INTERNAL int quality_nearest(const oxl_scene *scene, const int *view, int count, int of,
                                 int out[QUALITY_NEIGHBOURS]);
/* Returns the median of the neighbours' values, which are `stride` apart. */
OXL_INTERNAL double quality_beside(const double *value, size_t stride, const int *near, int neighbours);
/* Estimates the standard deviation from the median absolute deviation, which outliers do
 * not change. work: (count). */
OXL_INTERNAL double quality_spread(const double *value, size_t count, double *work, double *median);

#endif
