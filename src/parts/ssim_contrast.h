/* ssim_contrast.h - the contrast of images that SSIM in the loss is scaled by. */
#ifndef OXL_SSIM_CONTRAST_H
#define OXL_SSIM_CONTRAST_H

#include "../core/core.h"

/* Measures the median standard deviation of small cells of the training images, fraction of white; 0: of no
 * cell. views: the images that it is of. */
OXL_INTERNAL oxl_result ssim_contrast_measure(oxl_context *ctx, const oxl_scene *scene, double *contrast,
                                              int *views);
/* Returns the contrast that SSIM is to have where the images' detail has this standard deviation. */
OXL_INTERNAL double ssim_contrast_of_detail(double measured);

#endif
