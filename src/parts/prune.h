/* prune.h - the state of prune.c, for that file and its tests: removes the Gaussians that matter least. */
#ifndef OXL_PART_PRUNE_H
#define OXL_PART_PRUNE_H

#include "../train/part.h"

#define PRUNE_FILE 2048 /* bytes of a PLY that are not rows: its header */
struct prune {
    oxl_keep keep;
    double row_bytes;           /* of the file, for OXL_KEEP_BYTES */
    int views;                  /* views of a score, at most; spread evenly */
    int start, end;             /* the phase: steps */
    int every, patience;        /* steps between checks; steps without a drop after which one is made */
    int drops, last;            /* drops made; step of the last */
    size_t first_count, target; /* at the phase's start (0: not yet), at its end */
    double drop_l1;             /* mean L1 before the last drop */
    double l1_sum;              /* since the last check */
    int l1_count;
};
/* Begins. densified: last step of density control; views: number of training views; row_bytes: of a kept
 * Gaussian in its file. */
OXL_INTERNAL void prune_begin(struct prune *p, oxl_keep keep, int iterations, int densified, int views,
                              double row_bytes);
/* Observes the loss; call it after each step. Steps outside the phase are ignored. */
OXL_INTERNAL void prune_observe(struct prune *p, int step, double l1);
/* Returns 1 if prune_due checks. */
OXL_INTERNAL int prune_is_check_step(const struct prune *p, int step);
/* Returns after a step the number of `count` Gaussians to remove now. */
OXL_INTERNAL size_t prune_due(struct prune *p, int step, size_t count);
struct prune_of { /* what is pruned, and where it is seen */
    struct renderer *r;
    const oxl_scene *scene;
    const oxl_render_options *options;
    const oxl_model *model;
};
/* Chooses keep (count): 0 for the `drop` that matter least, else 1. */
OXL_INTERNAL oxl_result prune_choose(oxl_context *ctx, const struct prune *p, const struct prune_of *of,
                                     size_t drop, uint8_t *keep);
/* Sets keep[i] = 0 for the `drop` lowest scores, by row where equal. */
OXL_INTERNAL void prune_select(const float *score, size_t count, size_t drop, uint8_t *keep);

#endif
