/* resident.h - what a renderer keeps on the device. */
#ifndef OXL_VULKAN_RESIDENT_H
#define OXL_VULKAN_RESIDENT_H

#include "state.h"
#include "../../src/survey/imaging.h"

struct vulkan_slab {
    struct vulkan_buffer parameter, gradient, mean, square; /* (planes, stride) */
};

/* As shaders/view.glsl has it. */
struct vulkan_view {
    float rotation[9], translation[3], eye[3], fx, fy, cx, cy, limit_x, limit_y, near_plane, background[3],
        alpha_min, cut;
    uint32_t width, height, tiles_x, tiles_y, infinity, antialias;
    float half_width, half_height, attenuation[3], backscatter[3], veiling_light[3], training_range,
        dropout_gain;
    uint32_t dropout_most, dropout_low, dropout_high, dropout_step, surroundings_shift;
};

/* its bits: what shaders test with must not be known to their compiler (common.glsl) */
#define VULKAN_INFINITY 0x7F800000u

struct vulkan_training_image { /* (3,H,W) bytes, then from a word on the mask's (H,W) */
    struct vulkan_buffer bytes;
    uint32_t width, height, mask_at; /* mask_at: bytes; 0: there is none */
    uint32_t frame;                  /* the last one that names it */
};

/* Words of the buffer of counts, as shaders/common.glsl has them. */
enum vulkan_count {
    COUNT_VISIBLE,
    COUNT_PAIRS,       /* (tile, splat) pairs; 0: more than there is room for */
    COUNT_PAIRS_FOUND, /* with or without room */
    COUNT_HALT,        /* enum renderer_halt */
    COUNT_NONFINITE,
    COUNT_FIRST_NONFINITE,
    COUNT_CLEARED,
    COUNTS
};

/* Sums of the lamp behind the loss' totals, as shaders/imaging_total.comp has them: by powers of y and x. */
enum { VULKAN_POWERS = 15 };

/* What a deferred step leaves for the host: the counts, then the loss' totals. */
struct vulkan_report {
    uint32_t counts[COUNTS];
    float totals[8], imaging[VULKAN_POWERS];
};

enum { VULKAN_REPORTS = VULKAN_FRAMES };

struct vulkan_renderer {
    struct vulkan *v;
    struct vulkan_renderer *next; /* of v->renderers */
    /* whose model this is, and what of it is here */
    const oxl_model *model;        /* the host's */
    struct trained_model *trained; /* its, since a step; or NULL */
    const float *plane;            /* the host's first one: another is another model */
    size_t count, lobes;
    size_t rows; /* of the model, then of the surroundings */
    /* Gaussians that are drawn and not trained: of this renderer, the slabs alone; or NULL */
    struct vulkan_renderer *surroundings;
    int sh_degree, drawn_sh_degree; /* of the model; of its colours in the view */
    int model_here, moments_here, stepped;
    struct renderer_sums sums;
    int observed;           /* there are statistics here that the host has not got */
    int sums_here;          /* those here are what the host has, or newer */
    int deferred;           /* steps report later: renderer_defer */
    size_t steps, reported; /* deferred steps submitted; those reported */
    /* (VULKAN_REPORTS) step n's is n % VULKAN_REPORTS; as the host sees it */
    const struct vulkan_report *report;
    struct vulkan_slab *slab;
    size_t slabs, slab_capacity;
    uint32_t stride;             /* rows of a slab */
    uint32_t planes, lobe_plane; /* of a slab; where the second lobe's begin */
    /* images */
    struct vulkan_training_image *image;        /* (image_capacity) by view, those that are here */
    size_t image_capacity, image_bytes, images; /* images: how many are here */
    size_t target_pixels;                       /* of the image that was taken last */
    /* the view whose image is worked on, and is not evicted; -1: none */
    int pinned_view;
    int masked; /* whether the one that was taken last is */
    /* the last view */
    struct vulkan_view view;
    size_t tiles, pairs; /* pairs: at most, when deferred */
    /* of the pairs' buffers, for deferred steps; 0: not known, the next forward counts */
    size_t room;
    size_t most_pairs; /* of the views so far, as deferred steps reported them */
    /* memory was short for this model: there is room for as many pairs as were found, and no more */
    int low_memory;
    float ssim_weight, gain[3], contrast; /* contrast: SSIM's C2 */
    int exposed;                          /* 1: the loss is that of the rendered image times `gain` */
    int lit;                              /* 1: and times the lamp's */
    struct lamp_area lamp_area;
    float window_fraction;           /* of the full image's pixels */
    int in_medium, drops, is_window; /* of the last view */
    int may_be_lit;                  /* the loss may have a lamp */
    int sort_end;                    /* which of the pairs' key and value buffers holds the sorted ones */
    int keeps;                       /* the pass forward has kept what the way back begins with */
    /* from here on nothing but buffers: vulkan_renderer_free goes through them. By row */
    struct vulkan_buffer splat_a, splat_b, splat_c, lobe_a, lobe_b, seen, rank, row_key[2], row_value[2],
        row_pairs, row_slots, mean2d, statistics, score, moves;
    /* by pair */
    struct vulkan_buffer pair_key[2], pair_value[2], staged, sums_a, sums_b, sums_c, sums_d, sums_e, kept;
    /* by tile or pixel */
    /* passing: an image that is not kept */
    struct vulkan_buffer start, rgb, drgb, target, weight, slope[3], partial, passing, lamp;
    /* shares of the sums over pixels and rows; of a view's lamp and points */
    struct vulkan_buffer pixel_sums, powers, depth_points, depth_first;
    /* small, or of sorting and scanning */
    struct vulkan_buffer view_buffer, counts, rates, totals, histogram, digits, scan_sums, reports;
};

/* ---------------- resident.c */

OXL_INTERNAL oxl_result vulkan_renderer_create(oxl_context *ctx, void **out);
OXL_INTERNAL void vulkan_renderer_free(void *device);
/* of `total`, in this slab */
OXL_INTERNAL size_t vulkan_slab_rows(const struct vulkan_renderer *r, size_t slab, size_t total);
OXL_INTERNAL void vulkan_row_push(const struct vulkan_renderer *r, size_t slab, uint32_t push[6]);
OXL_INTERNAL float *vulkan_host_plane(const oxl_model *m, const struct vulkan_renderer *r, uint32_t plane);
/* Sends the model, or its moments, unless they are there already. */
OXL_INTERNAL void vulkan_take_model(struct vulkan_renderer *r, const oxl_model *m);
/* The same of the Gaussians behind the model's; NULL: none. */
OXL_INTERNAL void vulkan_take_surroundings(struct vulkan_renderer *r, const oxl_model *m);
OXL_INTERNAL void vulkan_reserve_moments(struct vulkan_renderer *r);
OXL_INTERNAL void vulkan_take_moments(struct vulkan_renderer *r, struct trained_model *trained);
OXL_INTERNAL void vulkan_copy_sums(struct vulkan_renderer *r, int up);
OXL_INTERNAL oxl_result vulkan_download_model(void *device, enum renderer_download what);
OXL_INTERNAL oxl_result vulkan_move_rows(void *device, const struct renderer_move *move, int *moved);
OXL_INTERNAL oxl_result vulkan_send_shape(void *device, oxl_model *model, int reset_opacity);

/* ---------------- images.c */

/* of every renderer, but the one that is in use: vulkan.evict */
OXL_INTERNAL size_t vulkan_drop_images(struct vulkan *v, uint32_t but);
OXL_INTERNAL int vulkan_has_image(const void *device, int view);
OXL_INTERNAL size_t vulkan_target(void *device, float *rgb, float *weight, int *masked);
OXL_INTERNAL oxl_result vulkan_take_image(void *device, int view, const struct training_image *image,
                                          const struct image_window *window, int halved);

/* ---------------- forward.c */

OXL_INTERNAL oxl_result vulkan_forward(void *device, const oxl_model *model, const oxl_camera *camera,
                                       const oxl_render_options *options,
                                       const struct kernel_camera *kernel_camera,
                                       const oxl_model *surroundings,
                                       const struct renderer_settings *settings);
OXL_INTERNAL oxl_result vulkan_depth(void *device, float *depth);
OXL_INTERNAL oxl_result vulkan_image(void *device, float *rgb);
/* The way back through the rasterizer, to the sums of pairs; score: those of the score alone. */
OXL_INTERNAL void vulkan_draw_backward(struct vulkan_renderer *r, int score);
OXL_INTERNAL uint32_t vulkan_loss_variant(const struct vulkan_renderer *r, int lit);

/* ---------------- imaging.c */

OXL_INTERNAL void vulkan_take_settings(struct vulkan_renderer *r, const struct renderer_settings *s);
OXL_INTERNAL void vulkan_draw_lamp(struct vulkan_renderer *r, const struct lamp *lamp,
                                   const struct lamp_area *area);
/* Memory and shaders for what follows. */
OXL_INTERNAL void vulkan_reserve_imaging(struct vulkan_renderer *r);
OXL_INTERNAL void vulkan_add_imaging(struct vulkan_renderer *r);
OXL_INTERNAL void vulkan_add_depths(struct vulkan_renderer *r, const struct depth_point *point, int points,
                                    double weight);
OXL_INTERNAL void vulkan_imaging_of(const float imaging[VULKAN_POWERS], double dlamp[LAMP_TERMS]);
OXL_INTERNAL oxl_result vulkan_lamp_gradient(void *device, double dlamp[LAMP_TERMS]);

#endif
