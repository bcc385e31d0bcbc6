/* dropout.h - for dropout.c and its test. */
#ifndef OXL_PART_DROPOUT_H
#define OXL_PART_DROPOUT_H

#include "../train/part.h"

/* Returns the fraction of the Gaussians that the last step of the run leaves out. */
OXL_INTERNAL double dropout_rate(const oxl_train_options *options, const oxl_scene *scene);

#endif
