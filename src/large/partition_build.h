/* partition_build.h - declares what the files that make a partition share: the tree of cuts, and what is
 * known of points, blocks and views. */
#ifndef OXL_PARTITION_BUILD_H
#define OXL_PARTITION_BUILD_H

#include "partition.h"

struct partition_node {
    struct partition_box box;      /* region that the node owns */
    struct partition_box finite;   /* part of the box that is searched for a cut */
    struct partition_box expanded; /* a leaf's box with its margin; a node's: around those of its leaves */
    struct partition_box deep;     /* part of a leaf that no other block expands into */
    int parent;
    /* children below the cut and from it on; 0: the node is a leaf, since the root is no child */
    int child[2];
    int axis; /* axis of the cut */
    double cut;
    int depth, shrinks;
    int removed;   /* 1: the node is gone, since a cut was undone */
    int in_batch;  /* place in the batch of boxes that are searched; -1: not in it */
    int block;     /* block of a leaf */
    size_t points; /* points inside the `box` of a leaf */
    int leaves;    /* leaves that the node is to have; 0: it is cut while it has more than N_p points */
};

struct partition_build {
    oxl_context *ctx;
    oxl_log_level level; /* level of log messages */
    const oxl_scene *scene;
    oxl_partition_options options;
    int dimensions;
    struct partition_box finite; /* trimmed extents of the survey */
    double *position;            /* (count,3) positions in the frame */
    uint32_t *load;              /* (count) fraction of the work, PARTITION_LOAD on average */
    uint32_t *owner;             /* (count) node of each point; at the end its block */
    size_t count;                /* points of the COLMAP model */
    size_t kept;                 /* points of these that the scene keeps */
    struct partition_node *node;
    int node_count, leaf_count, depth;
    size_t node_capacity;
    int *leaf; /* (leaf_count) nodes, in the order of partition_list_leaves */
    size_t leaf_capacity;
    size_t min_points;
    int min_views;

    struct partition_visibility *visibility;
    /* (count + 1) where a point's entries begin in `blocks`, the blocks whose expanded box contains it */
    uint32_t *first;
    uint32_t *blocks;
    size_t *inside;     /* (blocks) number of points in the expanded box */
    uint8_t *role;      /* (blocks,views) enum partition_role */
    uint8_t *few_views; /* (blocks) 1: the block has few views; NULL: not yet known */
    int undone;         /* number of cuts undone */
};

/* Returns the first of `count` points that a task of PARTITION_TASKS handles. */
OXL_INTERNAL size_t partition_task_begin(size_t count, int task);
/* Grows a tree of `leaves` leaves; 0: cuts until no leaf has more than N_p points (partition_cut.c). */
OXL_INTERNAL oxl_result partition_grow_to(struct partition_build *b, int leaves);
OXL_INTERNAL oxl_result partition_set_loads(struct partition_build *b, double by_pixels);
OXL_INTERNAL int partition_depth(size_t count, size_t block_points);
/* Moves points whose node was cut into its children; points whose node is gone start again from the root. */
OXL_INTERNAL void partition_update_leaves(const struct partition_build *b);
/* Assigns points and views to the leaves, and undoes cuts that leave a block too small (partition_assign.c).
 * largest: points of the largest block. */
OXL_INTERNAL oxl_result partition_assign(struct partition_build *b, size_t *largest);
OXL_INTERNAL oxl_result partition_assign_to_one(struct partition_build *b);

enum { PARTITION_RATIOS = 21 }; /* Number of places for a cut: 0.30, 0.32, ... 0.70 of a box [OceanXL]. */
struct partition_bin {
    uint64_t points, load;
};
struct partition_candidate { /* Rates a cut: its ratio, and the leaves on each side. */
    int ratio;               /* index of the ratio; -1: none leaves enough points for a block on both sides */
    size_t points[2];        /* points of the low and the high side */
    int leaves[2];
    int fits;   /* 1: both sides can be cut into blocks of at most N_p points */
    double off; /* difference between the fractions of the low side's load and of its leaves */
};

#endif
