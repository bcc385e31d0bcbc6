/* ucd.h - the state of ucd.c, for that file and its tests: weights by depth for density control, and their
 * search. */
#ifndef OXL_PART_UCD_H
#define OXL_PART_UCD_H

#include "../train/part.h"

/* Cost of a doubling of the Gaussians, in log loss: about what it gains in four densifications
 * (docs/log/TRAINING.md). */
#define UCD_GROWTH 0.02
#define UCD_MID 1.5        /* gradient weight of the middle third of depth [OceanXL sec. 4] */
#define UCD_FAR 2.0        /* gradient weight of the far third */
#define UCD_CAP 5.0        /* bounds a weight while it is searched */
#define UCD_PRECISION 0.2  /* of the prior: half of it in log loss for a weight 1 away */
#define UCD_OFFSET_MAX 1.0 /* limit of a single pair's distance from the prior */
#define UCD_SHIFT 0.5      /* of a point from the estimate: differences over less are lost in noise */
enum { UCD_SPAN = 4 };     /* densifications for a cost: the gain of the first shows after the third alone */

struct ucd {
    int on, learns;
    double z_near, z_far; /* limits of the middle band, camera z */
    double f[2];          /* f_mid, f_far: the estimate, or fixed */
    double prior[2];      /* of the estimate */
    /* sums over the pairs: how far each alone would move f_mid and f_far - f_mid from the prior */
    double offset[2];
    double cost[2];     /* of the two points of the pair in progress */
    double loss, count; /* at the start of the span: mean log loss, Gaussians */
    double loss_sum;    /* of log losses since the last densification: so many */
    int losses, pairs;  /* pairs: finished */
    int costs;          /* known in the pair in progress; -1: the span in progress is not one of a pair */
    int spans;          /* densifications in the span in progress */
    uint64_t seed;
    struct contrast contrast;
    char reason[256];
};
/* Sets whether it is on, and the limits of the bands. Logs nothing; ucd_describe gives the text. */
/* Returns 1 if the log of contrast falls by so much, with that standard error, that depth is weighted. */
OXL_INTERNAL int ucd_fades(double fade, double error);
OXL_INTERNAL oxl_result ucd_begin(oxl_context *ctx, struct ucd *u, const oxl_scene *scene, oxl_ucd mode);
OXL_INTERNAL void ucd_describe(const struct ucd *u, char *out, size_t size);
OXL_INTERNAL void ucd_observe(struct ucd *u, double loss); /* call after each step */
/* Returns f_mid and f_far of this densification. */
OXL_INTERNAL void ucd_weights(struct ucd *u, size_t count, double f[2]);
/* Discards the pair in progress: opacities were reset. */
OXL_INTERNAL void ucd_restart(struct ucd *u);

#endif
