/* trained.h - a run, and all that comes of it: the model, its imaging, and a model for viewers. */
#ifndef OXL_TRAINED_H
#define OXL_TRAINED_H

#include "train.h"

/* Trains as oxl_train, and resumes either run. task->imaging is moved into the first run; task->decisions is
 * not used: they are in *out. */
OXL_INTERNAL oxl_result trained_make(oxl_context *ctx, const oxl_scene *scene,
                                     const oxl_train_options *options, const oxl_callback *callback,
                                     struct train_task *task, oxl_trained *out);
/* Returns the options of `steps` further steps from a finished model, in which the
 * number of Gaussians stays. */
OXL_INTERNAL oxl_train_options train_refinement(const oxl_train_options *run, int sh_degree, int steps);
/* Returns the steps of the model for viewers after such a run, before its factors for medium and gains. */
OXL_INTERNAL int viewer_steps(const oxl_train_options *run);
/* Returns 1 if scene.ply is the model for viewers. */
OXL_INTERNAL int trained_hides(const oxl_trained *t);

/* Adds the counts of another run. */
OXL_INTERNAL void nonfinite_add(oxl_nonfinite *to, const oxl_nonfinite *from);

/* ---------------- unseen.c */

/* Removes the Gaussians that change no pixel of any training view; renders each view once. */
OXL_INTERNAL oxl_result unseen_drop(oxl_context *ctx, const oxl_scene *scene, oxl_model *model);

#endif
