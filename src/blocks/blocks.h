/* blocks.h - partition of a survey into blocks, and merging of their models. */
#ifndef OXL_BLOCKS_H
#define OXL_BLOCKS_H

#include "../core/core.h"
#include "../../oceanxl_job.h" /* oxl_partition_options */

/* ---------------- partition_make.c: balanced blocks of a survey */

struct partition_box { /* half-open, low <= x < high, in the partition's frame; outer faces are infinite */
    double low[3], high[3];
};
static inline int partition_contains(const struct partition_box *box, const double frame[3])
{
    int inside = 1;
    for (int i = 0; i < 3; i++) inside &= frame[i] >= box->low[i] && frame[i] < box->high[i];
    return inside;
}
struct partition_block {
    struct partition_box box;      /* disjoint boxes that cover all space */
    struct partition_box expanded; /* wider by 5 % of its size on each side: for the export */
    struct partition_box finite;   /* `box` clipped to the trimmed extents of the points */
    size_t points, start_points;   /* inside `box`; initial: in `expanded` or seen by its views */
    int base_views, border_views;  /* training views by overlap [OceanXL sec. 3.1, BlockGaussian] */
};
struct partition {
    double rotation[9]; /* rows: the principal axes, longest first; frame = R (world - origin) */
    double origin[3];   /* world */
    double extent[3];   /* l1 >= l2 >= l3, trimmed */
    int dimensions;     /* 2: the third axis is never cut; 3 */
    double memory;      /* limit of a process, bytes, that determined the number of blocks; 0: no limit */
    int block_count;
    struct partition_block *block;
    /* the block of each point and view, for the export; NULL if read from partition.txt */
    struct partition_plan *plan;
};
OXL_INTERNAL void partition_to_frame(const struct partition *p, const double world[3], double out[3]);

/* Cuts a scene from files into blocks; the scene must outlive the partition. It stays one block if it is
 * small enough, if the options say so, or if it has no tracks, which tell the points of a view. The log
 * states the reason, and the evidence for 2D or 3D. */
OXL_INTERNAL oxl_result partition_make(oxl_context *ctx, const oxl_scene *scene,
                                       const oxl_partition_options *options, struct partition *out);
OXL_INTERNAL void partition_free(oxl_context *ctx, struct partition *p);
/* the partition no longer refers to the scene */
OXL_INTERNAL void partition_free_plan(oxl_context *ctx, struct partition *p);

/* partition_file.c: partition.txt, which reads back to the same bits. */
OXL_INTERNAL oxl_result partition_write(oxl_context *ctx, const char *path, const struct partition *p);
OXL_INTERNAL oxl_result partition_read(oxl_context *ctx, const char *path, struct partition *out);

/* partition_export.c: partition.svg and, last, partition.txt into folder `out`; partition_export: before them
 * blocks/KKK, COLMAP text exports for other programs. p is as partition_make left it. */
OXL_INTERNAL oxl_result partition_save(oxl_context *ctx, const struct partition *p, const char *out);
OXL_INTERNAL oxl_result partition_export(oxl_context *ctx, const struct partition *p, const char *out);

/* ---------------- merge.c: rows of models */

/* Appends the rows of `from` with keep (count) not 0, or all with keep NULL, relative to into's origin. The
 * SH degree of `into` grows to that of `from`, missing coefficients are 0; rows with a second lobe stay in
 * front. On failure `into` is unchanged. */
OXL_INTERNAL oxl_result merge_rows(oxl_context *ctx, const oxl_model *from, const uint8_t *keep,
                                   oxl_model *into);
/* Merges model files into one, page by page; rows with a second lobe come first. */
OXL_INTERNAL oxl_result merge_files(oxl_context *ctx, char *const *path, int count, const double origin[3],
                                    const char *out);
/* inside (count): 1 for the Gaussians whose centres lie in the block's box; a centre that is not finite lies
 * in none. */
OXL_INTERNAL void merge_mark(const struct partition *p, int block, const oxl_model *model, uint8_t *inside);

#endif
