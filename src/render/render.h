/* render.h - the renderer: from a model and a camera to an image, and the gradient back. The CPU or a device
 * renders. */
#ifndef OXL_RENDER_H
#define OXL_RENDER_H

#include "../survey/image.h"
#include "../survey/imaging.h"
#include "../model/model.h"

/* ---------------- backend.c: the device that renders */

enum { RENDERED_ON_CPU = 1, RENDERED_ON_DEVICE = 2 };

struct backend {                             /* of a context */
    struct vulkan *vulkan;                   /* device that renders; NULL: the CPU */
    const struct renderer_device *functions; /* of that device, or NULL */
    /* what has rendered so far: RENDERED_ON_CPU, RENDERED_ON_DEVICE or both */
    int rendered_on;
    /* bit set of oxl_result: device failures already logged, with the CPU as replacement */
    int fell_back;
};
/* Opens the device of the context's options, once. OXL_OK with backend->vulkan NULL: the CPU renders. */
OXL_INTERNAL oxl_result backend_begin(oxl_context *ctx);
OXL_INTERNAL void backend_begin_run(oxl_context *ctx); /* logs failures of a device again, once a run */
/* Name of the device, whether or not it has rendered; NULL: none. */
OXL_INTERNAL const char *backend_device(const oxl_context *ctx);

/* ---------------- renderer.c: the kernels behind one interface */

struct renderer; /* state of one view, kept between views to avoid allocations */

OXL_INTERNAL oxl_result renderer_create(oxl_context *ctx, struct renderer **out);
OXL_INTERNAL void renderer_free(oxl_context *ctx, struct renderer *r);

/* Returns the default options with the scene's near plane. */
OXL_INTERNAL oxl_render_options render_options_of(const oxl_scene *scene);
/* Renders; the image stays in the renderer until the next call. sh_degree as in oxl_render_options. */
OXL_INTERNAL oxl_result renderer_forward(oxl_context *ctx, struct renderer *r, const oxl_model *model,
                                         const oxl_camera *camera, const oxl_render_options *options);
OXL_INTERNAL oxl_result renderer_image(struct renderer *r, const float **out); /* (3,H,W) */

/* oxl_render for many views of an unchanged model, which is uploaded once to a device. options: not NULL. */
OXL_INTERNAL oxl_result renderer_draw(oxl_context *ctx, struct renderer *r, const oxl_model *model,
                                      const oxl_camera *camera, const oxl_render_options *options,
                                      oxl_image *out, float *depth);

/* Sets the image of a view, or its window (NULL: all), at half resolution if `halved`, for
 * renderer_loss with rgb NULL. A device caches images in a part of its memory: `image` may be NULL if
 * renderer_has_image returns 1. */
OXL_INTERNAL int renderer_has_image(const struct renderer *r, int view);
OXL_INTERNAL oxl_result renderer_set_image(oxl_context *ctx, struct renderer *r, int view,
                                           const struct training_image *image,
                                           const struct image_window *window, int halved);

/* Loss of the rendered image against rgb (3,H,W) with weight (H,W) or NULL, or, with rgb NULL, against the
 * image of renderer_set_image; keeps its gradient for renderer_backward. */
struct renderer_loss {
    double total, l1, ssim, mse;
    double dlog_gain[3];      /* dL/d(log gain), with renderer_set_gain */
    double dlamp[LAMP_TERMS]; /* dL/d(shape), with renderer_set_lamp; here after the step */
};
OXL_INTERNAL oxl_result renderer_loss(oxl_context *ctx, struct renderer *r, const float *rgb,
                                      const float *weight, float ssim_weight, struct renderer_loss *out);

/* The gradient of the model rendered last, for drgb (3,H,W), or NULL: that of renderer_loss. `gradient` has
 * the model's shape;
 * rows of invisible packs are not written. On a device it is downloaded by renderer_gradient. NULL:
 * renderer_step ends this pass, a few rows at a time, so that their gradients stay in the cache and need no
 * memory. */
OXL_INTERNAL oxl_result renderer_backward(oxl_context *ctx, struct renderer *r, const float *drgb,
                                          oxl_model *gradient);
OXL_INTERNAL oxl_result renderer_gradient(struct renderer *r, oxl_model *gradient);

/* Pruning score, with S = sum over pixels and channels of drgb (3,H,W) x the rendered image: adds to
 * score[row] of each visible row the sum over its pixels of (o dS/dalpha)^2. No loss is needed. A renderer
 * that falls back to the CPU here (renderer_has_device) adds
 * nothing: the view must be rendered again. */
OXL_INTERNAL oxl_result renderer_score(oxl_context *ctx, struct renderer *r, const float *drgb, float *score);

#define RENDERER_BETAS \
    {                  \
        0.9, 0.999     \
    } /* [Kerbl 2023] */
struct renderer_nonfinite {
    size_t rows;
    /* on a device: those of them that held such a value and were cleared, as in nonfinite.c */
    size_t cleared;
};
/* Adam on the rows visible in the last view. Rows with a value or gradient that is not finite are not updated
 * and count as invisible from then on. gradient: as renderer_backward gave it; NULL if it gave none. */
OXL_INTERNAL oxl_result renderer_step(oxl_context *ctx, struct renderer *r, struct trained_model *trained,
                                      const oxl_model *gradient, const oxl_adam *adam,
                                      struct renderer_nonfinite *out);

/* Deferred steps, on a device: after renderer_defer(1), forward, loss, backward and step return before the
 * device is done, without loss and rows. renderer_report returns them for the oldest step not yet reported:
 * for the latest step only with `wait`, otherwise for the one before it. A step that cannot be executed
 * halts: it and the steps behind it change nothing and have no reports; the caller repeats them without
 * deferring. Call renderer_defer(0) and fetch all reports before anything but steps. Returns 1: the device
 * defers. */
/* more pairs than the device had room for; the loss is not finite */
enum renderer_halt { HALT_NONE, HALT_PAIRS, HALT_LOSS };
struct renderer_report {
    int exists; /* 0: no step to report */
    enum renderer_halt halt;
    struct renderer_loss loss;
    struct renderer_nonfinite skipped;
};
OXL_INTERNAL int renderer_defer(struct renderer *r, int on);
OXL_INTERNAL oxl_result renderer_report(struct renderer *r, int wait, struct renderer_report *out);

/* After the backward pass: adds the last view's gradients of visible rows to the statistics of density
 * control. */
struct renderer_sums {
    size_t count;
    int banded;
    float z_near, z_far;                /* limits of the bands, camera z */
    float *gradient;                    /* (count) sums of |dL/d(u,v)|, in units of half an image */
    float *gradient_mid, *gradient_far; /* the same in that band only */
    float *views;                       /* (count) number of views that see the row */
};
OXL_INTERNAL oxl_result renderer_observe(oxl_context *ctx, struct renderer *r,
                                         const struct renderer_sums *sums);

/* Between steps the model, its moments and the statistics are on the device. Downloads them; call it before
 * the host reads any of them. */
enum renderer_download {
    DOWNLOAD_TO_READ,
    DOWNLOAD_TO_CHANGE, /* the next renderer_forward uploads them */
    /* only the statistics and the planes before OXL_SH, which the host may change and renderer_send_shape
     * uploads */
    DOWNLOAD_SHAPE
};
OXL_INTERNAL oxl_result renderer_download(struct renderer *r, enum renderer_download what);

/* After DOWNLOAD_SHAPE, on a device: new row i of the model, its moments and lobes is the old row `from[i]`,
 * with moments of 0 if RENDERER_FRESH is set; the order stays. SH planes that the model did not have are 0.
 * The host does the same with the model and calls renderer_send_shape. *moved 0: the CPU renders, or the
 * device has no room; then everything is on the host, as after DOWNLOAD_TO_CHANGE. */
#define RENDERER_FRESH 0x80000000u
struct renderer_move {
    const uint32_t *from; /* (count) */
    size_t count, lobes;
    int sh_degree; /* not below the model's */
};
OXL_INTERNAL oxl_result renderer_move_rows(struct renderer *r, const struct renderer_move *move, int *moved);
/* Uploads the planes before OXL_SH; the device holds the others. reset_opacity: sets the moments of the
 * opacity to 0. */
OXL_INTERNAL oxl_result renderer_send_shape(struct renderer *r, oxl_model *model, int reset_opacity);

/* marks all rows invisible in the last view */
OXL_INTERNAL oxl_result renderer_clear_visible(struct renderer *r);
/* On a device: clears rows with a value that is not finite, stored or computed in the last view, as
 * nonfinite.c does on the CPU. */
OXL_INTERNAL oxl_result renderer_clear_nonfinite(struct renderer *r, struct trained_model *trained,
                                                 struct renderer_nonfinite *out);
/* Results of the last view for row i, on the CPU. */
OXL_INTERNAL int renderer_row_finite(const struct renderer *r, size_t row); /* 1 also for invisible rows */
OXL_INTERNAL int renderer_row_visible(const struct renderer *r, size_t row);
/* |dL/d(u,v)| in units of half an image */
OXL_INTERNAL float renderer_mean_gradient(const struct renderer *r, size_t row);

/* ---------------- renderer.c: settings of the next view */

OXL_INTERNAL int renderer_has_device(const struct renderer *r);
OXL_INTERNAL void renderer_use_cpu(struct renderer *r); /* before the first forward */

/* What the next views are rendered and compared with; the caller writes it, and it stays. Pointers are
 * borrowed. */
struct renderer_settings {
    /* forward: */
    /* 1: loss, backward and step may follow: a device allocates memory for all of them in forward, where the
     * CPU can still take over */
    int steps;
    struct renderer_window { /* the camera is a part of a full image of this size, px; 0, 0: it is whole */
        int width, height;
        float x, y; /* px: the part's top left corner */
    } window;
    struct medium medium;
    /* This fraction of the Gaussians, chosen by seed and step, is not rendered, and the opacities of the
     * others are divided by 1 - fraction. */
    struct renderer_dropout {
        double fraction;
        uint64_t seed;
        int step;
    } dropout;
    /* loss: */
    const float *gain;       /* (3) of the rendered image, or NULL */
    const struct lamp *lamp; /* its gain at each pixel, or NULL */
    double contrast;         /* SSIM's C2 is the square of this standard deviation; 0: of 0.03 */
    const oxl_terms *terms;  /* on pixels, on the CPU alone, or NULL */
    /* backward: */
    int pose; /* 1: the gradient of the camera's pose, too; on the CPU alone */
};
OXL_INTERNAL struct renderer_settings *renderer_settings(struct renderer *r);
/* From the next forward on, these Gaussians are rendered as well, without gradients. Borrowed. Call it before
 * the first forward: where they have second lobes, the CPU renders from then on. */
OXL_INTERNAL void renderer_set_surroundings(struct renderer *r, const oxl_model *surroundings);
/* The next backward adds weight x sum of (1 - T) in front of these points to the loss (depth_loss.c).
 * The points are copied. */
struct depth_point {
    float x, y, z; /* px of the rendered image, camera z */
};
enum { DEPTH_POINTS = 128 }; /* most */
OXL_INTERNAL void renderer_set_depths(struct renderer *r, const struct depth_point *point, int count,
                                      double weight);
/* (POSE_SUMS) of the last backward, complete after the step: dL/d(w), dL/d(centre), both in the axes of the
 * world, where w turns all Gaussians about the camera's centre; of the model, without the surroundings. */
enum { POSE_SUMS = 6 };
OXL_INTERNAL const double *renderer_pose_gradient(const struct renderer *r);

/* ---------------- medium.c, exposure.c: medium and lamp */

/* Adds the value of a user's term to a loss; OXL_ERR_USAGE: it is not finite. name: of oxl_terms. */
OXL_INTERNAL oxl_result renderer_add_term(oxl_context *ctx, struct renderer_loss *loss, const char *name,
                                          double value);
/* Fills the gradient by the lamp, which is known after the step. */
OXL_INTERNAL void renderer_complete_loss(const struct renderer *r, struct renderer_loss *loss);
/* Bakes medium and lamp into the colours, as the views see them, for viewers that ignore imaging.txt;
 * backwards: recovers the colours behind medium and lamp, if there is either. */
OXL_INTERNAL void medium_bake(const oxl_scene *scene, const struct oxl_imaging *imaging, int backwards,
                              oxl_model *model);
/* Makes the model one for viewers that know neither: drops second lobes, bakes the medium and, where
 * `with_gains`, the gains of the images. */
OXL_INTERNAL void medium_make_standard(const oxl_scene *scene, const struct oxl_imaging *imaging,
                                       int with_gains, oxl_model *model);

#endif
