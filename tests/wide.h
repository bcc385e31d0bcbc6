/* wide.h - a view in double precision: what is rendered, and every gradient, in two ways.
 *
 *     splat_*     reference/splat.c: written from the equations, without tiles; shares nothing with the
 *     kernels
 *     kernels_*   the kernels' own source with real = double: exact where float rounds, wrong where the
 *     source is
 *
 * Each is a translation unit of its own (wide_splat.c, wide_kernels.c), so that their names and those of the
 * library do not meet. wide_scenes.c makes the scenes.
 */
#ifndef TEST_WIDE_H
#define TEST_WIDE_H
#include "../oceanxl.h"

struct wide {
    oxl_camera camera;
    double near_plane, background[3];
    int antialias;       /* as oxl_model.antialias */
    double alpha_min;    /* contributions below are skipped: 1/255, or more for kernels_* */
    size_t count, lobes; /* rows 0..lobes-1 have a second lobe */
    int sh_degree;
    /* (count), as in oxl_model; from OXL_LOBE on (lobes), NULL without; past the degree NULL */
    double *plane[OXL_PLANES];
    double *gradient[OXL_PLANES]; /* the same; written by *_backward */
    double *rgb, *transmittance;  /* (3,H,W), (H,W); written by *_forward */
    double *depth;                /* (H,W) written by kernels_forward */
    double *dmean2d;              /* (count) |dL/d(u,v)| in units of half an image; written by *_backward */
    double dpose[6]; /* written by kernels_backward: of the camera's pose, as renderer_pose_gradient */
    /* (count) px by which the box of the contour alpha = 1/255 reaches past the outermost pixel centres: in
     * view when above 0; -1e30 for what is not rendered. Written by splat_forward */
    double *inside;
};

/* The planes are 0, the rotations w = 1. Memory is malloc's; a test without it aborts. */
void wide_create(struct wide *w, const oxl_camera *camera, size_t count, size_t lobes, int sh_degree);
void wide_resize(struct wide *w, int width, int height); /* of the image */
void wide_free(struct wide *w);
#define OWNED_WIDE __attribute__((cleanup(wide_free))) struct wide
void *wide_array(size_t count); /* of doubles, zeros */

/* ---------------- scenes */

size_t wide_rows(const struct wide *w, int plane); /* 0: w has no such plane */
double wide_random(int seed, size_t i, size_t k);  /* in -1..1 */
/* A value of plane k is mean + spread wide_random(seed, row, k); a range holds the planes from the last one's
 * end on. */
struct wide_range {
    int end;
    double mean, spread;
};
void wide_scatter(struct wide *w, int seed, const struct wide_range *range);
void wide_fill(struct wide *w, int first, int end, double value);
void wide_multiply(struct wide *w, int first, int end, double factor);
void wide_look_ahead(struct wide *w); /* the camera is not turned */
void wide_to_float(struct wide *w);   /* rounds what the float kernels will read */
oxl_result wide_to_model(oxl_context *ctx, const struct wide *w, oxl_model *out);

/* Gaussians of all sizes and shapes, before a camera that is turned and looks past their middle; odd
 * principal point. */
void wide_mixed(struct wide *w, int width, int height, int count, int lobes, int sh_degree);
/* Wide soft Gaussians, so that no decision lies near and the image is smooth in every parameter; spread: of
 * the positions. */
enum { WIDE_SMOOTH_WIDTH = 14, WIDE_SMOOTH_HEIGHT = 11 };
void wide_smooth(struct wide *w, int count, int lobes, int sh_degree, double focal, double spread);

/* ---------------- rendering */

void splat_forward(struct wide *w);
size_t kernels_forward(struct wide *w); /* returns how many Gaussians are in view */
/* drgb (3,H,W) is dL/d(rgb). */
void splat_backward(struct wide *w, const double *drgb);
void kernels_backward(struct wide *w, const double *drgb);

/* Adds to score (count) the sum over the pixels of (o dS/dalpha)^2, drgb being dS/d(rgb). */
void splat_score(struct wide *w, const double *drgb, double *score);
void kernels_score(struct wide *w, const double *drgb, double *score);

/* fragile (H,W): 1 where a decision hangs by less than 1e-3 of its threshold (|alpha| at 1/255, o G at 0.99,
 * T at 1e-4 or 16, the near plane) or two splats lie at the same depth: float may decide the other way
 * there. */
void splat_fragile(const struct wide *w, char *fragile);

/* (1 - weight) L1 + weight (1 - SSIM); x rendered, y wanted, dx (3,H,W); mask (H,W) 1 or 0, or NULL. */
struct wide_loss {
    double total, l1, ssim, mse;
};
double splat_loss(int width, int height, double weight, const double *x, const double *y, double *dx);
struct wide_loss kernels_loss(int width, int height, double weight, const double *x, const double *y,
                              const double *mask, double *dx);

/* Steps count from 1; the kernels take a pack of 16. */
void splat_adam(double *x, double gradient, double rate, int step, double *mean, double *square);
void kernels_adam(double x[16], const double gradient[16], double rate, int step, double mean[16],
                  double square[16]);

double splat_learning_rate(int plane, double extent, double progress);

enum splat_verdict { SPLAT_REMOVE, SPLAT_KEEP, SPLAT_SPLIT };
enum splat_verdict splat_classify(const double log_scale[3], double logit, double gradient, double extent,
                                  int was_reset);
/* its planes up to opacity become those of its child, side -1 or 1 */
void splat_split(double row[OXL_SH], int side);

#endif
