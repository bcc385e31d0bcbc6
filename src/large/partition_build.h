/* partition_build.h - shared by the files that make a partition: the tree of cuts, and what is known of
 * points, blocks and views. */
#ifndef OXL_PARTITION_BUILD_H
#define OXL_PARTITION_BUILD_H

#include "partition.h"

struct partition_node {
    struct partition_box box;      /* region that the node owns */
    struct partition_box finite;   /* the part searched for a cut */
    struct partition_box expanded; /* of a leaf; of a node: around those of its leaves */
    struct partition_box deep;     /* of a leaf: the part of it that no other block expands into */
    int parent;
    int child[2]; /* below the cut, and from it on; 0: a leaf, since the root has no parent */
    int axis;     /* of the cut */
    double cut;
    int depth, shrinks;
    int removed;   /* its cut was undone */
    int in_batch;  /* its place in the batch of boxes that are searched; -1: not in it */
    int block;     /* of a leaf */
    size_t points; /* inside `box`, of a leaf */
    int leaves;    /* leaves that it is to have; 0: it is cut while it has more than N_p points */
};

struct partition_build {
    oxl_context *ctx;
    oxl_log_level level; /* of log messages */
    const oxl_scene *scene;
    oxl_partition_options options;
    int dimensions;
    struct partition_box finite; /* trimmed extents of the survey */
    double *position;            /* (count,3) in the frame */
    uint32_t *load;              /* (count) fraction of the work, PARTITION_LOAD on average */
    uint32_t *owner;             /* (count) node; at the end block */
    size_t count;                /* points of the COLMAP model */
    size_t kept;                 /* of them in the scene */
    struct partition_node *node;
    int node_count, leaf_count, depth;
    size_t node_capacity;
    int *leaf; /* (leaf_count) nodes, from the lowest place to the highest */
    size_t leaf_capacity;
    size_t min_points;
    int min_views;

    struct partition_visibility *visibility;
    uint32_t *first; /* (count + 1) in `blocks`: the blocks in whose expanded box a point lies */
    uint32_t *blocks;
    size_t *inside;     /* (blocks) points in the expanded box */
    uint8_t *role;      /* (blocks, views) */
    uint8_t *few_views; /* (blocks) has few views; NULL: not yet known */
    int undone;         /* cuts */
};

/* Returns the first point of a task of PARTITION_TASKS. */
OXL_INTERNAL size_t partition_task_begin(size_t count, int task);
/* Grows a tree of `leaves` leaves; 0: until no leaf has more than N_p points (partition_cut.c). */
OXL_INTERNAL oxl_result partition_grow_to(struct partition_build *b, int leaves);
OXL_INTERNAL oxl_result partition_set_loads(struct partition_build *b, double by_pixels);
OXL_INTERNAL int partition_depth(size_t count, size_t block_points);
/* Moves points whose node was cut into its children; those whose node is gone start again from the root. */
OXL_INTERNAL void partition_update_leaves(const struct partition_build *b);
/* Assigns points and views to the leaves, and undoes cuts that leave a block too small (partition_assign.c).
 * largest: points of the largest block. */
OXL_INTERNAL oxl_result partition_assign(struct partition_build *b, size_t *largest);
OXL_INTERNAL oxl_result partition_assign_to_one(struct partition_build *b);

enum { PARTITION_RATIOS = 21 }; /* places of a cut: 0.30, 0.32, ... 0.70 of a box [OceanXL] */
struct partition_bin {
    uint64_t points, load;
};
struct partition_candidate { /* a ratio, and the leaves on each side */
    int ratio;               /* -1: none leaves both sides enough points for a block */
    size_t points[2];        /* of the sides */
    int leaves[2];
    int fits;   /* both sides can be cut further into blocks of at most N_p points */
    double off; /* by how much the load of a side misses its fraction */
};

#endif
