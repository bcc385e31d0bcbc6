/* evaluate.h - a model's images compared with a survey's: metrics. */
#ifndef OXL_EVALUATE_H
#define OXL_EVALUATE_H

#include "../core/core.h"
#include "../core/simd.h"
#include "../survey/image.h"
#include "../survey/imaging.h"
#include "../render/render.h"

/* ---------------- metrics.c */

OXL_INTERNAL oxl_result metrics_check(oxl_context *ctx, const oxl_image *a, const oxl_image *b);
/* Clamps a value to 0..1; NaN is 0, as in written images. */
SIMD_INLINE double metrics_clamped(float v)
{
    return v > 0 ? OXL_MIN((double)v, 1.0) : 0;
}
/* Returns the PSNR of weighted squared errors; NaN without weight. */
OXL_INTERNAL double metrics_decibel(double error, double weight);
/* ---------------- planes.c */

enum { PLANES = 7, PLANES_HALF_MAX = 24 /* px; of a window */ };
struct planes { /* Holds the work of one comparison of images. */
    int width, height;
    size_t size;           /* pixels */
    double *plane[PLANES]; /* (H,W) */
    double *line;          /* (threads, W + 2 PLANES_HALF_MAX) a line of each thread; the planes follow */
};
struct planes_window { /* A Gaussian of 2 half + 1 px; outside of the image is black, or its reflection. */
    double sigma;
    int half, reflects;
};
/* Allocates planes of the size of an image, not cleared; free them with p->line. */
OXL_INTERNAL oxl_result planes_begin(oxl_context *ctx, const oxl_image *of, struct planes *p);
/* Blurs a plane, along y and then along x. */
OXL_INTERNAL void planes_blur(oxl_context *ctx, const struct planes *p, const struct planes_window *window,
                              const double *in, double *out);

struct drawn;

/* ---------------- unshown.c */

struct unshown {       /* A held-out view, and which of its pixels a training view shows. */
    oxl_camera camera; /* of reduced size */
    float *depth;      /* (H,W) as of oxl_render */
    uint8_t *is_shown; /* (H,W) */
};
/* Renders the depths of a view at a reduced size: sets u->camera, and u->depth anew. */
OXL_INTERNAL oxl_result unshown_draw(oxl_context *ctx, const struct drawn *d, int view, struct unshown *u);
/* Finds the pixels of `count` views; u: (count) zeroed; unshown_free frees it, also on error. */
OXL_INTERNAL oxl_result unshown_find(oxl_context *ctx, const struct drawn *d, const int *view, int count,
                                     struct unshown *u);
OXL_INTERNAL void unshown_free(oxl_context *ctx, struct unshown *u, int count);
/* Sets row->unshown and row->shown_psnr. */
OXL_INTERNAL oxl_result unshown_measure(oxl_context *ctx, const struct unshown *u, const oxl_image *rendered,
                                        const oxl_image *image, oxl_view_metrics *row);

/* ---------------- align.c */

/* Finds the camera of a view that fits its image best, from its pose on. d->imaging: not NULL; d->r: on the
 * CPU; gradient: of the shape of d->model, overwritten. */
OXL_INTERNAL oxl_result align_view(oxl_context *ctx, const struct drawn *d, int view, const oxl_image *image,
                                   const oxl_render_options *options, oxl_model *gradient, oxl_camera *out);

/* ---------------- evaluate.c */

struct drawn { /* Names what evaluate_draw renders. */
    struct renderer *r;
    const oxl_model *model;
    const oxl_scene *scene;
    /* poses, medium, lamp and gains with which the images were taken; NULL: none */
    const struct oxl_imaging *imaging;
};
/* Composites the scene's images over the model's background from now on; called before the
 * first image is compared. */
OXL_INTERNAL void evaluate_begin(oxl_context *ctx, const oxl_model *model, const oxl_scene *scene);
/* Renders a view; depth (H,W), or NULL. */
OXL_INTERNAL oxl_result evaluate_draw(oxl_context *ctx, const struct drawn *d, int view, oxl_image *out,
                                      float *depth);
/* Evaluates `most` views of a split at most, evenly spaced, without ssim (NaN), plain_psnr and alignment, in
 * a third of the time; 0: all views, plain_psnr, psnr and ssim alone; other values are not set. d->r is not
 * used. */
OXL_INTERNAL oxl_result evaluate_part(oxl_context *ctx, const struct drawn *d, oxl_split split, int most,
                                      oxl_metrics *out);

#endif
