/* kernels.h - types and functions of the kernels.
 *
 * The kernels (project.c, bin.c, raster.c, loss.c, adam.c) are written over the type `real` (real.h).
 */
#ifndef OXL_KERNELS_H
#define OXL_KERNELS_H

#include "render.h"
#include "real.h"
#include "../survey/imaging.h"

/* ---------------- constants of the forward pass */

#define PACK 16 /* rows per projection step, and pixels of a subtile: one AVX-512 vector */
#define TILE 16 /* px: a tile is TILE x TILE pixels, 16 subtiles of 4 x 4 */
#define TILE_PIXELS 256
#define TILE_SUBTILES 16

#define LOG2_255 ((real)7.9943534368588578) /* a contribution below alpha = 1/255 is skipped [Kerbl 2023] */
#define ALPHA_MAX ((real)0.99)              /* [Kerbl 2023] */
/* a splat that reduces T below it is skipped and ends the pixel [Kerbl 2023] */
#define TRANSMITTANCE_MIN ((real)1e-4)
#define ALPHA_MIN ((real)(1.0 / 255)) /* the same skip for a difference of Gaussians: of |alpha| */
/* negative alpha increases T; skipped from here on, so T < 32 [not in OceanXL] */
#define TRANSMITTANCE_MAX ((real)16)
#define DEPTH_LAYER ((real)0.04)       /* of its depth: the thickness of what counts as one surface */
#define DEPTH_WEIGHT_MIN ((real)1 / 3) /* a surface of less weight is uncertain: its depth is negative */
#define OPAQUE_MIN ((real)0.5) /* a pixel whose splats have less weight, 1 - T at the end, is see-through */
/* px^2 added to the 2D covariance: no splat is narrower than a pixel [Kerbl 2023] */
#define LOW_PASS ((real)0.3)
#define ANTIALIAS_LOW_PASS \
    ((real)0.1) /* the same with anti-aliasing: a pixel's own width [Yu 2024, sec. 5.2] */
/* with anti-aliasing the opacity falls by the root of the determinants without and with low pass; the least
 * ratio [Yu 2024, its code] */
#define ANTIALIAS_MIN ((real)2.5e-5)
/* the Jacobian is evaluated at most this far outside the image [Kerbl 2023] */
#define FRUSTUM_CLAMP 1.3
#define LOG2_E ((real)1.4426950408889634)
#define LN_2 ((real)0.6931471805599453)

/* ---------------- what goes in */

/* an oxl_model for the kernels; planes are readable up to the next multiple of PACK */
struct gaussians {
    size_t count, lobes; /* rows 0..lobes-1 have a second lobe */
    int sh_degree;       /* harmonics of degrees 0..sh_degree are evaluated */
    real *plane[OXL_PLANES];
};

/* The values of a row in three planes, from `plane` on. */
SIMD_INLINE struct vec3 gaussians_vec3(const struct gaussians *g, int plane, size_t row)
{
    return vec3(g->plane[plane][row], g->plane[plane + 1][row], g->plane[plane + 2][row]);
}

struct kernel_camera { /* an oxl_camera in `real` */
    int width, height;
    real half_width, half_height; /* px; of the full image, if this is a window of it: the unit of dmean2d */
    real fx, fy, cx, cy;          /* px */
    struct mat3 rotation;         /* world to camera */
    struct vec3 translation, eye;
    real limit_x, limit_y; /* |x/z|, |y/z| at which the Jacobian is clamped */
    real near_plane;
    real alpha_min;   /* contributions below it are skipped; ALPHA_MIN or more */
    real cutoff_bits; /* -log2(alpha_min) */
    int antialias;    /* the low pass keeps a splat's energy: it lowers the opacity as it widens the splat */
};

/* ---------------- project.c: Gaussians onto the image plane, and back */

/* A Gaussian on the image plane. Its inverse covariance is factored, which is accurate for needles, where
 * A dx^2 + 2 B dx dy + C dy^2 cancels (MATH 4); the exponent is in base 2 and includes the opacity. A pixel
 * at (dx, dy) needs
 *     w = dx + k dy,   alpha = 2^(peak - a w^2 - e dy^2).
 * One cache line in float. */
struct splat {
    real u, v; /* centre, px */
    real a;    /* log2(e)/2 A, 1/px^2; A = 1 / variance of x given y */
    /* -covariance of x and y / variance of y: shift of the ridge in x, px per px of y */
    real k;
    real e;                    /* log2(e)/2 E, 1/px^2; E = 1 / variance of y */
    real peak;                 /* log2 of the opacity */
    real colour[3];            /* after the clamp at 0 */
    real depth;                /* camera z */
    real half_x, half_y;       /* px: half the box around the contour alpha = 1/255 */
    uint16_t tile_x0, tile_x1; /* tiles that the box touches, inclusive */
    uint16_t tile_y0, tile_y1;
    uint32_t first_slot, slots; /* its (tile, splat) pairs in the binning's order */
};

/* The second lobe of a row on the image plane; centre and colour are the splat's, whose box contains both
 * contours. Separate from the splat, so that scenes without lobes do not access it. */
struct lobe {
    real a, k, e, peak;  /* as in struct splat */
    real half_x, half_y; /* px: half the box around this lobe's contour o' G' = 1/255 */
    real main_x, main_y; /* px: half the box around the first one's */
};

/* a pair's gradient sums over its pixels: d = alpha dL/dalpha = dL/d(log alpha) (a in MATH 11) times ... */
#define SPLAT_SUMS 9
#define SUM_D 0  /* 1: opacity */
#define SUM_W 1  /* w: centre along x */
#define SUM_Y 2  /* dy: centre along y */
#define SUM_WW 3 /* w^2, w dy, dy^2: shape */
#define SUM_WY 4
#define SUM_YY 5
#define SUM_RED 6 /* alpha T dL/dC, without d: colour, three channels */

struct medium_pack { /* stored by the forward pass for the backward pass, by channel and row */
    real range[PACK], through[3][PACK], rest[3][PACK], clear[3][PACK];
};

struct project_job {
    struct gaussians in;
    const struct kernel_camera *kernel_camera;
    size_t first_pack, end_pack;     /* packs of PACK rows */
    struct splat *splat;             /* (count) written for visible rows */
    struct lobe *lobe;               /* (lobes) written for visible rows */
    uint16_t *visible;               /* (packs) a bit a row */
    const struct medium *medium;     /* NULL: no medium */
    struct medium_pack *medium_pack; /* (packs) of the visible ones */
    /* backward only: */
    double *pose_sum;               /* (6) adds dL/d(pose of the camera), pose.h; NULL: it is not wanted */
    const real (*sums)[SPLAT_SUMS]; /* (slots, SPLAT_SUMS) */
    /* dL/d(parameter), overwritten for visible packs (0 in their invisible rows) */
    struct gaussians out;
    size_t out_row; /* of the model that is the first of `out` */
    real *dmean2d;  /* (count) |dL/d(u,v)| in units of half an image, for visible rows */
};
OXL_INTERNAL void project_forward(int isa, const struct project_job *job);
OXL_INTERNAL void project_backward(int isa, const struct project_job *job);

/* ---------------- bin.c: which tile sees which splat, in depth order */

struct pair {
    uint32_t splat; /* row of the model */
    /* index of its gradient sums; those of a second lobe are at slot + the splat's slots */
    uint32_t slot;
    uint32_t subtiles; /* bit 4 by + bx: the contour touches this 4 x 4 subtile of the tile */
};

struct bins {
    int tiles_x, tiles_y;
    real alpha_min, cutoff_bits; /* of the camera */
    size_t packs;
    /* (count) in: written by project_forward; first_slot and slots are filled in */
    struct splat *splat;
    const uint16_t *visible; /* (packs) in */
    const struct lobe *lobe; /* (lobes) in */
    /* rows 0..lobes-1 have one: footprint of both lobes, twice the slots */
    size_t lobes;
    size_t surroundings_row,
        surroundings_lobes; /* so do rows surroundings_row.. of the surroundings; theirs follow in `lobe` */
    uint32_t *order;        /* (visible_count) rows by depth, ties by row */
    size_t visible_count;
    struct pair *pair; /* (pair_count) tile by tile, each in depth order */
    size_t pair_count;
    size_t slot_count;    /* >= pair_count: slots are laid out before the exact test */
    uint32_t *tile_start; /* (tiles + 1) */
    struct bin_scratch *scratch;
};
/* The second lobe of a row, or NULL. */
SIMD_INLINE const struct lobe *bins_lobe(const struct bins *b, size_t row)
{
    if (row < b->lobes) return &b->lobe[row];
    return row - b->surroundings_row < b->surroundings_lobes ? &b->lobe[b->lobes + row - b->surroundings_row]
                                                             : NULL;
}
OXL_INTERNAL oxl_result bin_splats(oxl_context *ctx, struct bins *bins, int width, int height);
OXL_INTERNAL void bin_free(oxl_context *ctx, struct bins *bins);

/* ---------------- raster.c: splats to pixels, and back */

struct raster_job {
    const struct bins *bins;
    int width, height, tile;
    real background[3];
    real *rgb;           /* (3,H,W) */
    real *transmittance; /* (H,W) T after the last splat; read by raster_depth */
    real *depth;         /* (H,W) camera z of the surface, as oxl_render says; written by raster_depth */
    real depth_scale;    /* the depth that DEPTH_LAYER is of; 0: each pixel's own */
    /* backward and score: */
    const real *drgb; /* (3,H,W) dL/d(rgb) */
    /* backward alone: */
    real (*sums)[SPLAT_SUMS]; /* (slots, SPLAT_SUMS) written for each of the tile's pairs */
    /* score only, with drgb = dS/d(rgb): */
    real *score; /* (slots) sum of (o dS/dalpha)^2, written for each of the tile's pairs */
};
OXL_INTERNAL void raster_forward(int isa, const struct raster_job *job);
OXL_INTERNAL void raster_depth(int isa, const struct raster_job *job); /* after raster_forward */
OXL_INTERNAL void raster_backward(int isa, const struct raster_job *job);
OXL_INTERNAL void raster_score(int isa, const struct raster_job *job);

#ifndef OXL_REFERENCE
/* kernel_camera.c */
OXL_INTERNAL struct kernel_camera render_kernel_camera(const oxl_camera *camera, float near_plane);
/* With options.parallel, the pinhole camera so far behind `camera` that its rays are parallel; else `camera`.
 * */
OXL_INTERNAL oxl_camera render_far_camera(const oxl_camera *camera, const oxl_render_options *options);
/* at least ALPHA_MIN */
OXL_INTERNAL void render_set_alpha_min(struct kernel_camera *kernel_camera, float alpha_min);
#endif

/* ---------------- depth_loss.c: in front of points of known depth */

#ifndef OXL_REFERENCE
/* Adds dL/d(opacity) to the sums (slots, SPLAT_SUMS) of raster_backward. */
OXL_INTERNAL void depth_loss_backward(const struct bins *bins, const struct depth_point *point, int count,
                                      double weight, float (*sums)[SPLAT_SUMS]);
#endif

/* ---------------- exposure.c: gains on pixels */

#ifndef OXL_REFERENCE
struct exposure_job {
    struct lamp_area area;
    const float *gain, *shape; /* (3); (LAMP_TERMS) the lamp's, or NULL */
    const float *x;            /* (3,H,W) rendered */
    /* (3,H,W) times the gains; (H,W) the lamp's: written by forward, read by backward */
    float *y, *lamp_map;
    const float *dy;            /* (3,H,W) dL/dy; backward only */
    float *dx;                  /* (3,H,W) dL/dx: overwritten by backward; may be dy */
    double *dlog_gain, *dshape; /* (3), (LAMP_TERMS) dL/d(log gain), dL/d(shape), overwritten by backward */
};
OXL_INTERNAL void exposure_forward(int isa, const struct exposure_job *job);
OXL_INTERNAL void exposure_backward(int isa, const struct exposure_job *job);
#endif

/* ---------------- loss.c: L1 + SSIM, and back */

struct loss_job {
    int width, height;
    real ssim_weight;   /* loss = (1 - w) L1 + w (1 - SSIM) */
    const real *x, *y;  /* (3,H,W) rendered, image */
    const real *weight; /* (H,W) 1 or 0, or NULL */
    real *dx;           /* (3,H,W) dL/dx, overwritten */
    real c2;            /* SSIM's constant of contrast; 0: Wang's, 0.03^2 */
};
/* of a row: |x - y|, S, (x - y)^2 */
enum loss_sum { LOSS_SUM_L1, LOSS_SUM_SSIM, LOSS_SUM_SQUARE, LOSS_SUMS };
struct loss_scratch { /* kept between steps, to avoid allocations */
    real *rows, *valid;
    double (*sums)[LOSS_SUMS];
    size_t rows_capacity, sums_capacity, valid_capacity;
    size_t cleared; /* number of values cleared */
    int width;      /* the width that they were cleared for */
};
/* out: total, l1, ssim and mse, means over unmasked pixels and three channels. */
OXL_INTERNAL oxl_result loss_forward_backward(oxl_context *ctx, const struct loss_job *job,
                                              struct loss_scratch *scratch, struct renderer_loss *out);
OXL_INTERNAL void loss_free(oxl_context *ctx, struct loss_scratch *scratch);

/* ---------------- adam.c: the step that follows the gradient */

struct adam_job {
    size_t first_pack, end_pack;
    /* (packs) rows to step; the bit of a row with a value that is not finite is cleared */
    uint16_t *visible;
    /* of every row; then those of second lobes, up to the end of the last pack with one */
    int planes, lobe_planes;
    size_t lobe_packs;
    real *parameter[OXL_PLANES], *mean[OXL_PLANES], *square[OXL_PLANES]; /* the planes of a trained_model */
    const real *gradient[OXL_PLANES];
    size_t gradient_row;     /* of the model that is the first of `gradient` */
    real rate[OXL_PLANES];   /* including the bias correction of the first moment */
    real beta1, beta2;       /* decay of the two moments per step */
    real inverse_correction; /* 1 / sqrt(1 - beta2^t) */
};
OXL_INTERNAL void adam_step(int isa, const struct adam_job *job);

#endif
