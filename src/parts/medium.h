/* medium.h - the state of medium.c, for that file and its tests: the nine parameters of the medium. */
#ifndef OXL_PART_MEDIUM_FIT_H
#define OXL_PART_MEDIUM_FIT_H

#include "../train/part.h"

struct medium_gradient { /* of a step that is done */
    int step;            /* 0: none */
    double progress, dmedium[9];
};

struct medium_fit {
    int on, fixed, steps;              /* fixed: the tracks' values */
    double range;                      /* the survey's median; attenuation is per this range */
    double raw[9], mean[9], square[9]; /* before softplus: bD, bB, Binf by channel; Adam's moments */
    struct medium_gradient pending;    /* not yet applied, where a device renders */
};
OXL_INTERNAL void medium_fit_begin(struct medium_fit *f, oxl_scene *scene, const struct medium *continued);
/* Uses the medium fitted to the tracks, if the residuals support it and the depths span enough; why: the
 * evidence. Likewise lamp_set_from_tracks and exposure_set_from_tracks. */
OXL_INTERNAL void medium_fit_set_from_tracks(struct medium_fit *f, double span, const struct photometry *p,
                                             char *why, size_t size);
/* Returns the step after which a medium is fitted without tracks; 0: never. */
OXL_INTERNAL int medium_fit_start_step(const oxl_train_options *options);
OXL_INTERNAL struct medium medium_fit_value(const struct medium_fit *f);
OXL_INTERNAL void medium_fit_start(struct medium_fit *f, oxl_scene *scene);
/* Converts the model's colours from those of training to those without the medium, or back. */
OXL_INTERNAL void medium_fit_scale_colours(const struct medium_fit *f, int to_clear, oxl_model *model);
OXL_INTERNAL void medium_fit_step(struct medium_fit *f, double progress, const double gradient[9]);
OXL_INTERNAL void medium_fit_archive(struct archive *a, struct medium_fit *f, int used);

#endif
