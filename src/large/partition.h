/* partition.h - declares what the files of the partition share: the frame, the cuts, and the plan of the
 * blocks. */
#ifndef OXL_PARTITION_H
#define OXL_PARTITION_H

#include "large.h"

struct partition_plan {
    const oxl_scene *scene;
    struct partition_box finite; /* trimmed extents of the survey */
    int *owner;                  /* (points of the COLMAP model) block; -1: the scene drops the point */
    int *view_of;                /* (images of the COLMAP model) training view; -1: none */
    size_t *seen;                /* (views) number of points that each training view sees */
    uint8_t *has;                /* (blocks, views) 1: the block has the view */
};

/* Finds the frame, the principal axes of the survey, and its extents along them (partition_axes.c). */
OXL_INTERNAL oxl_result partition_axes(oxl_context *ctx, const oxl_scene *scene, struct partition *p);
/* Cuts the survey into `blocks` blocks, and into more until none has more than `limit` points
 * (partition_cut.c). */
OXL_INTERNAL oxl_result partition_cut(oxl_context *ctx, struct partition *p, oxl_cut cut, int blocks,
                                      size_t limit);
/* Returns 1 if the block has the view; 0 for view -1. */
OXL_INTERNAL int partition_has_view(const struct partition *p, int block, int view);

#endif
