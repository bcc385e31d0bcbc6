/* exposure.h - the state of exposure.c, for that file and its tests: log gains of training images. */
#ifndef OXL_PART_EXPOSURE_FIT_H
#define OXL_PART_EXPOSURE_FIT_H

#include "../train/part.h"

struct exposure_gradient {
    int step, view;                /* step 0: none */
    double progress, dlog_gain[3]; /* fraction of the run; dL/da */
};

struct exposure {
    oxl_switch mode;
    double known_until;    /* fraction of the run up to which known gains stay */
    struct oxl_imaging of; /* the gains; on: they are applied */
    float *mean, *square;  /* (views,3) Adam's moments */
    int *visits;           /* (views) steps of a view's gains */
    /* mean that the log gains are given after each step: 0, or the mean of the continued run */
    double level[3];
    struct exposure_gradient pending; /* gradient of the last step, not yet applied */
    int is_decided;                   /* 1: the tracks have told whether gains are on */
};
OXL_INTERNAL void exposure_set_from_tracks(struct exposure *e, const struct photometry *p, char *why,
                                           size_t size);

#endif
