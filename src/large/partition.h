/* partition.h - declares what the files of the partition share: points observed by each view,
 * and the plan of the blocks. */
#ifndef OXL_PARTITION_H
#define OXL_PARTITION_H

#include "large.h"

#define PARTITION_NO_BLOCK UINT32_MAX /* Marks a point that the scene drops. */
/* Splits a parallel loop into so many parts, each with its own scratch; results do not depend on it. */
enum { PARTITION_TASKS = 16 };

/* ---------------- partition_axes.c: the frame */

struct partition_axes { /* Holds the frame, relative to the scene's origin. */
    /* (3,3) rows are the axes, right-handed, by falling extent; the third points to the cameras */
    double rotation[9];
    double low[3], high[3]; /* 1st and 99th percentile of the kept points, in the frame */
    double fraction;        /* fraction of points kept by the trim */
};
OXL_INTERNAL oxl_result partition_axes(oxl_context *ctx, const oxl_scene *scene, struct partition_axes *out);

/* ---------------- partition_visibility.c: points that each view observes */

/* Lists the points of each training view, from the tracks; the lists of test views are empty. */
struct partition_visibility {
    size_t views;          /* views of the scene */
    size_t *first;         /* (views + 1) where a view's entries begin in `point` and `observation` */
    uint32_t *point;       /* points, ascending in each view; twice if observed twice */
    uint32_t *observation; /* indices in the view's list of 2D points */
    uint32_t *seen;        /* (views) number of different points */
};
OXL_INTERNAL oxl_result partition_visibility_create(oxl_context *ctx, const oxl_scene *scene,
                                                    struct partition_visibility **out);
OXL_INTERNAL void partition_visibility_free(oxl_context *ctx, struct partition_visibility *visibility);

/* ---------------- partition_make.c: the plan */

enum partition_role { PARTITION_OUT, PARTITION_BASE, PARTITION_BORDER };

struct partition_plan {
    const oxl_scene *scene;
    struct partition_visibility *visibility;
    int owns_visibility;
    struct partition_box finite; /* trimmed extents of the survey */
    uint32_t *owner;             /* (points of the COLMAP model) block, or PARTITION_NO_BLOCK */
    size_t *first_member;        /* (blocks + 1) */
    uint32_t *member;            /* points in each block's expanded box, ascending */
    uint8_t *role;               /* (blocks, views) enum partition_role */
};
/* Cuts the scene of `of` in its frame by other options, without log lines. Shares the visibility of `of`,
 * which must outlive `out`. */
OXL_INTERNAL oxl_result partition_variant(oxl_context *ctx, const struct partition *of,
                                          const oxl_partition_options *options, struct partition *out);
/* Sets the bits of the points that a block starts from, and returns their number. bits: (points) zero,
 * (points + 63) / 64 words. */
OXL_INTERNAL size_t partition_mark(const struct partition *p, int block, uint64_t *bits);

/* ---------------- partition_svg.c: the blocks as an SVG */

OXL_INTERNAL oxl_result partition_draw(oxl_context *ctx, const struct partition *p, const char *path);

#endif
