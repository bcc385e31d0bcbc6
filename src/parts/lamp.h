/* lamp.h - the state of lamp.c, for that file and its tests: a light that moves with the camera. */
#ifndef OXL_PART_LAMP_H
#define OXL_PART_LAMP_H

#include "../train/part.h"

struct lamp_gradient {
    int step, group; /* step 0: none; whose camera's */
    double progress, shape[LAMP_TERMS];
};

struct lamp_fit {
    int on, frozen, steps, groups; /* frozen: it is not trained */
    int visits[LAMP_MAX];          /* steps of a camera */
    /* the first: cameras that have none of their own */
    struct lamp group[LAMP_MAX];
    double mean[LAMP_MAX][LAMP_TERMS], square[LAMP_MAX][LAMP_TERMS]; /* Adam's moments */
    struct lamp_gradient pending; /* gradient of the last step, not yet applied */
    struct lamp drawn;            /* of the view that is rendered */
};
OXL_INTERNAL void lamp_set_from_tracks(struct lamp_fit *l, oxl_switch mode, const struct photometry *p,
                                       char *why, size_t size);

#endif
