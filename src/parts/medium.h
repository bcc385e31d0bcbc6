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
/* Uses the medium fitted to the tracks, if the residuals support it; why: the
 * evidence. Likewise lamp_set_from_tracks and exposure_set_from_tracks. */
OXL_INTERNAL void medium_fit_set_from_tracks(struct medium_fit *f, double span, const struct photometry *p,
                                             char *why, size_t size);
OXL_INTERNAL void medium_fit_start(struct medium_fit *f, oxl_scene *scene);

#endif
