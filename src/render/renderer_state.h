/* renderer_state.h - shared by the files of the renderer: its state, and what turns it into jobs of the
 * kernels. */
#ifndef OXL_RENDERER_STATE_H
#define OXL_RENDERER_STATE_H
#include "kernels.h"
#include "device.h"
#include "../core/vecmath.h"
#include "../survey/imaging.h"

#define RENDER_TASK 64     /* packs per task: 1024 Gaussians, one page of a plane */
#define RENDER_STEP_PART 8 /* packs whose gradients a thread holds in a step: in its first-level cache */

/* Consecutive tiles that a thread starts with. */
struct render_tile_range {
    int next, end;
    char padding[64 - 2 * sizeof(int)]; /* on a cache line of its own */
};

struct renderer {
    const struct renderer_device *backend; /* of `device` */
    void *device;                          /* NULL: the CPU renders, with the members below */
    int deferred;
    struct renderer_settings set;

    struct kernel_camera kernel_camera;
    float background[3];
    struct gaussians in;
    /* Gaussians that are rendered but not trained, in the rows behind the model's; or NULL */
    const oxl_model *surroundings;
    size_t packs;        /* of the model; those of the surroundings follow */
    struct splat *splat; /* (count) */
    struct lobe *lobe;   /* (lobes) */
    uint16_t *visible;   /* (packs) */
    float *dmean2d;      /* (count) */
    float *rgb, *drgb, *transmittance;
    float *depth;                    /* (H,W) the caller's, while its depths are rendered; else NULL */
    float parallel;                  /* of the options */
    struct medium context_medium;    /* whose colours have no training range */
    struct medium_pack *medium_pack; /* (packs) with a medium */
    double (*pose_sum)[POSE_SUMS];   /* (tasks) */
    double dpose[POSE_SUMS];
    size_t medium_pack_capacity, pose_sum_capacity;
    float *exposed;  /* (3,H,W) rgb times gain and lamp */
    float *lamp_map; /* (H,W) the lamp's gain */
    double dlamp[LAMP_TERMS];
    size_t exposed_capacity, lamp_map_capacity;
    float *target, *weight; /* image of renderer_set_image: (3,H,W), and (H,W) if masked */
    int masked;
    struct depth_point depth_point[DEPTH_POINTS]; /* of renderer_set_depths */
    int depth_points;
    double depth_weight;
    /* 1: the backward pass ended with `sums`; renderer_step computes the gradients of the rows */
    int projection_pending;
    oxl_model part; /* (threads * RENDER_STEP_PART * PACK rows) gradients of the rows that a thread steps */
    float (*sums)[SPLAT_SUMS];
    float *score; /* (slots) */
    struct bins bins;
    struct loss_scratch loss;
    struct render_tile_range *tile_range; /* (threads) */
    size_t tile_range_capacity, splat_capacity, lobe_capacity, visible_capacity, dmean2d_capacity,
        rgb_capacity, drgb_capacity, transmittance_capacity, sums_capacity, score_capacity, target_capacity,
        weight_capacity;
};

typedef void render_tile_fn(int isa, const struct raster_job *job);

/* sh_degree below 0: the model's. */
OXL_INTERNAL struct gaussians render_gaussians(const oxl_model *m, int sh_degree);
OXL_INTERNAL size_t render_packs(size_t count);
OXL_INTERNAL int64_t render_tasks(const struct renderer *r);
OXL_INTERNAL struct project_job render_project_job(struct renderer *r, int64_t task);
/* After the backward pass of all tasks: adds their sums, of the medium and the pose. */
OXL_INTERNAL void render_add_task_sums(struct renderer *r);
OXL_INTERNAL void render_each_tile(oxl_context *ctx, struct renderer *r, const float *drgb,
                                   render_tile_fn *work);
OXL_INTERNAL oxl_result render_read_imaging_gradient(struct renderer *r);
OXL_INTERNAL oxl_result render_fall_back_to_cpu(oxl_context *ctx, struct renderer *r, oxl_result rc,
                                                int anew);
/* Works on packs of the model; out_row: the row that is the first of `out`. */
OXL_INTERNAL void render_project_backward(const oxl_context *ctx, struct renderer *r, size_t first_pack,
                                          size_t end_pack, const struct gaussians *out, size_t out_row);

#endif
