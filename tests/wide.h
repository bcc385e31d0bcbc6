/* wide.h - a view in double precision: what is drawn, and every gradient, in two ways.
 *
 *     splat_*     reference/splat.c: written from the equations, without tiles; shares nothing with the kernels
 *
 * It is a translation unit of its own, so that its names and those of the library do not meet.
 */
#ifndef TEST_WIDE_H
#define TEST_WIDE_H
#include "../oceanxl.h"

struct wide {
    oxl_camera camera;
    double     near_plane, background[3];
    size_t     count, lobes; /* rows 0..lobes-1 have a second lobe */
    int        sh_degree;
    double    *plane[OXL_PLANES];    /* (count), as in oxl_model; from OXL_LOBE on (lobes), NULL without; past the degree NULL */
    double    *gradient[OXL_PLANES]; /* the same; written by *_backward */
    double    *rgb, *transmittance;  /* (3,H,W), (H,W); written by *_forward */
    double    *dmean2d;              /* (count) |dL/d(u,v)| in units of half an image; written by *_backward */
    double *
        inside; /* (count) px by which the box of the contour alpha = 1/255 reaches past the outermost pixel centres: in view when
                        * above 0; -1e30 for what is not drawn. Written by splat_forward */
};

/* The planes are 0, the rotations w = 1. Memory is malloc's; a test without it aborts. */
void  wide_create(struct wide *w, const oxl_camera *camera, size_t count, size_t lobes, int sh_degree);
void  wide_free(struct wide *w);
void *wide_array(size_t count); /* of doubles, zeros */

void splat_forward(struct wide *w);
void splat_backward(struct wide *w, const double *drgb); /* drgb (3,H,W); forward comes before */

/* fragile (H,W): 1 where a decision hangs by less than 1e-3 of its threshold (|alpha| at 1/255, o G at 0.99, T at 1e-4 or 16, the near
 * plane) or two splats lie at the same depth: float may decide the other way there. */
void splat_fragile(const struct wide *w, char *fragile);

/* (1 - weight) L1 + weight (1 - SSIM); x, y, dx (3,H,W). */
double splat_loss(int width, int height, double weight, const double *x, const double *y, double *dx);

void   splat_adam(double *x, double gradient, double rate, int step, double *first, double *second);
double splat_learning_rate(int plane, double extent, double progress);

enum splat_verdict { SPLAT_REMOVE, SPLAT_KEEP, SPLAT_CLONE, SPLAT_SPLIT };
enum splat_verdict splat_judge(const double log_scale[3], double logit, double gradient, double extent, int was_reset);

/* By how much the log scales of the two halves of a split are smaller. */
double splat_shrink(void);

/* Trains reference/splat.c's trainer on one view of `truth` from `start`, steps times; returns the last loss over the first. */
double splat_train(struct wide *truth, const struct wide *start, int steps);

#endif
