/* oceanxl.h - from a COLMAP text export of an underwater survey to one compact 3D Gaussian Splatting model.
 *
 * This header is the manual. The shortest useful program:
 *
 *     #include "oceanxl.h"
 *     int main(void)
 *     {
 *         oxl_context *ctx = NULL;
 *         oxl_scene   *scene = NULL;
 *         oxl_model    model = {0};
 *         oxl_train_options train = oxl_train_options_default(OXL_PRESET_DRAFT);
 *         oxl_result rc = oxl_context_create(NULL, &ctx);
 *         if (rc == OXL_OK) rc = oxl_scene_load(ctx, "survey", NULL, &scene);
 *         if (rc == OXL_OK) rc = oxl_train(ctx, scene, &train, NULL, &model);
 *         if (rc == OXL_OK) rc = oxl_model_write(ctx, "scene.ply", &model);
 *         if (rc != OXL_OK) fprintf(stderr, "%s\n", oxl_error_text(ctx));
 *         oxl_model_free(ctx, &model);
 *         oxl_scene_free(ctx, scene);
 *         oxl_context_free(ctx);
 *         return rc;
 *     }
 *
 * Conventions
 *   frames      COLMAP's: +x right, +y down, +z forward; world to camera is  x_c = R x_w + t;
 *               quaternions are Hamilton, (w, x, y, z); the centre of the top-left pixel is (0.5, 0.5).
 *   origin      input is read in double, moved to a robust centre of its own, and only then stored as float.
 *               Everything in a scene or model is relative to `origin`:  world = local + origin.
 *   images      float, planar (3,H,W): all of red, then green, then blue; 0 black, 1 white.
 *   errors      every function that can fail returns oxl_result; oxl_error_text(ctx) then says what was seen,
 *               what was wanted and how to mend it. The library never exits and never prints.
 *   ownership   who fills `out` allocates it; the _free of the same name releases it (NULL and zeroed are fine).
 *               On error `*out` is zeroed.
 *   threads     one context may be used by one thread at a time; inside, OpenMP uses `threads` of them.
 *               The result does not depend on how many.
 *
 * Licence: MIT, see LICENSE.
 */
#ifndef OCEANXL_H
#define OCEANXL_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define OXL_VERSION "0.1.0"

#ifndef OXL_API
#define OXL_API extern
#endif

/* ---------------------------------------------------------------- results */

typedef enum oxl_result {
    OXL_OK = 0,
    OXL_ERR_FAILED,     /* something went wrong that no other word fits */
    OXL_ERR_USAGE,      /* the caller's arguments make no sense together */
    OXL_ERR_INPUT,      /* a file is missing, broken or of an unknown kind */
    OXL_ERR_IO,         /* reading or writing failed: disk full, permission */
    OXL_ERR_MEMORY,     /* the allocator said no */
    OXL_ERR_BUDGET,     /* would not fit the memory budget; the text names the option that makes it fit */
    OXL_ERR_INTERRUPTED /* a progress callback asked to stop; the output holds a usable state */
} oxl_result;

/* ---------------------------------------------------------------- context */

typedef struct oxl_context oxl_context;

typedef enum oxl_log_level { OXL_LOG_ERROR = 0, OXL_LOG_WARNING, OXL_LOG_INFO, OXL_LOG_DEBUG } oxl_log_level;

/* Which machine draws and trains. The Vulkan backend is in builds with `make VULKAN=1` alone, and only Mesa's lavapipe, a Vulkan device
 * made of the CPU, was tried so far: so the CPU is the default. */
typedef enum oxl_backend {
    OXL_BACKEND_CPU = 0,
    OXL_BACKEND_AUTO,  /* a Vulkan device, if there is one that is not the CPU in disguise; else the CPU */
    OXL_BACKEND_VULKAN /* a Vulkan device, or nothing: OXL_ERR_FAILED says what is missing */
} oxl_backend;

typedef struct oxl_context_options {
    int      threads; /* 0: as many as OpenMP offers */
    uint64_t seed;    /* of every random choice: view order, split samples (default 1) */
    /* realloc-like: size 0 frees and returns NULL; old may be NULL. Must return 16-byte aligned memory. Called by one
     * thread at a time, not always by the same one. */
    void *(*reallocate)(void *user, void *old, size_t size);
    void (*log)(void *user, oxl_log_level level, const char *text); /* one line without the newline; NULL: silent */
    void       *user;                                               /* handed to both */
    oxl_backend backend;                                            /* (CPU) */
    int         device; /* of the list that oxl_devices makes; -1: a discrete one before others (-1) */
} oxl_context_options;

OXL_API oxl_context_options oxl_context_options_default(void);

/* options may be NULL for the defaults. */
OXL_API oxl_result oxl_context_create(const oxl_context_options *options, oxl_context **out);
OXL_API void       oxl_context_free(oxl_context *ctx);

/* Text of the last failure, "" when there was none; lives as long as the context. ctx may be NULL. */
OXL_API const char *oxl_error_text(const oxl_context *ctx);

/* Frees a text that the library returned. NULL is fine. */
OXL_API void oxl_text_free(oxl_context *ctx, char *text);

/* The instruction set that the kernels run on: "avx512", "avx2" or "base". OXL_ISA=... in the environment forces one. */
OXL_API const char *oxl_isa_name(const oxl_context *ctx);

/* Opens the device that options.backend asks for. Whatever draws does so when it is first needed: this is for who wants to know early. */
OXL_API oxl_result  oxl_backend_begin(oxl_context *ctx);
/* "cpu", or the name of the device that draws. */
OXL_API const char *oxl_backend_name(const oxl_context *ctx);
/* The Vulkan devices that --device and options.device count, a line each, with their limits; free it with oxl_text_free. */
OXL_API oxl_result  oxl_devices(oxl_context *ctx, char **out);

/* ---------------------------------------------------------------- images */

typedef struct oxl_image {
    int    width, height;
    float *rgb;    /* (3,H,W) planar, 0..1 */
    float *weight; /* (H,W) 1: counts, 0: masked out; NULL when every pixel counts */
} oxl_image;

OXL_API oxl_result oxl_image_create(oxl_context *ctx, int width, int height, oxl_image *out);
OXL_API void       oxl_image_free(oxl_context *ctx, oxl_image *image);
/* JPG or PNG in, 8-bit PNG out (atomically). Values are clamped to 0..1; not-a-number is written as black. */
OXL_API oxl_result oxl_image_read(oxl_context *ctx, const char *path, oxl_image *out);
OXL_API oxl_result oxl_image_write(oxl_context *ctx, const char *path, const oxl_image *image);

/* A JPEG in memory, quality 1..100; free it with oxl_text_free. */
OXL_API oxl_result oxl_image_to_jpeg(oxl_context *ctx, const oxl_image *image, int quality, char **out, size_t *size);

/* ---------------------------------------------------------------- cameras and scenes */

/* An undistorted pinhole camera and where it stood: x_c = R x + t in the scene's local coordinates. */
typedef struct oxl_camera {
    int    width, height;  /* px */
    double fx, fy, cx, cy; /* px; the top-left pixel's centre is (0.5, 0.5) */
    double rotation[9];    /* R, row-major, world to camera */
    double translation[3]; /* t, in the scene's unit */
} oxl_camera;

typedef struct oxl_view {
    const char *name;    /* as in images.txt, e.g. "dive1/IMG 0001.JPG" */
    oxl_camera  camera;  /* of the undistorted image at the size it is trained at */
    int         is_test; /* held out: every 8th by name */
} oxl_view;

typedef struct oxl_point {
    double  position[3]; /* local coordinates */
    float   error;       /* reprojection error, px */
    uint8_t rgb[3];
} oxl_point;

typedef struct oxl_scene oxl_scene;

/* Defaults and ranges of options: src/job/options.c, docs/OPTIONS.md. */
typedef struct oxl_scene_options {
    const char *images;            /* folder of the images; NULL: SCENE/images */
    const char *sparse;            /* folder of COLMAP's files; NULL: SCENE/sparse/0, SCENE/sparse or SCENE */
    const char *masks;             /* folder of masks; NULL: SCENE/masks when it is there */
    int         max_side;          /* images are reduced until their longer side is at most this, px */
    int         test_every;        /* every n-th view by name is held out; 0: none */
    size_t      image_cache_bytes; /* decoded images kept in memory; the others are decoded again */
    double      missing_share;     /* fail when more than this share of the images is not on disk */
    int         read_images;       /* 0: COLMAP's files alone, for check and partition */
    int         allow_cut; /* 1: a text file of fewer rows than its header announces is read with a warning; 0: an error */
} oxl_scene_options;

OXL_API oxl_scene_options oxl_scene_options_default(void);

/* Reads a COLMAP model, text or binary. OXL_ERR_INPUT names file:line, what was seen, what was wanted and one fix. */
OXL_API oxl_result oxl_scene_load(oxl_context *ctx, const char *path, const oxl_scene_options *options, oxl_scene **out);

/* A scene from arrays: views (name, camera, is_test; images in the same order, copied) and starting points (copied).
 * Points may be none: then training starts from random points in front of the cameras. */
OXL_API oxl_result oxl_scene_from_arrays(oxl_context *ctx, const oxl_view *views, const oxl_image *images, int view_count,
                                         const oxl_point *points, size_t point_count, oxl_scene **out);
OXL_API void       oxl_scene_free(oxl_context *ctx, oxl_scene *scene);

OXL_API int              oxl_scene_view_count(const oxl_scene *scene);
OXL_API const oxl_view  *oxl_scene_view(const oxl_scene *scene, int index); /* ordered by name */
OXL_API size_t           oxl_scene_point_count(const oxl_scene *scene);
OXL_API const oxl_point *oxl_scene_points(const oxl_scene *scene);
OXL_API const double    *oxl_scene_origin(const oxl_scene *scene); /* (3) world = local + origin */
OXL_API double           oxl_scene_extent(const oxl_scene *scene); /* 1.1 x robust radius of the training cameras [3DGS] */

/* The ray along which a pixel of the image, of the size in cameras.txt, was seen, distortion undone: where it starts and a unit vector, local
 * coordinates. OXL_ERR_INPUT: a pixel outside of the image, or one that the lens model does not reach. */
OXL_API oxl_result oxl_scene_ray(oxl_context *ctx, const oxl_scene *scene, int view, double x, double y, double start[3],
                                 double way[3]);

/* The gains of the scene's images from imaging.txt beside a model's file, where train has left one: evaluation and pictures apply
 * them then. No such file: nothing happens. */
OXL_API oxl_result oxl_scene_read_imaging(oxl_context *ctx, oxl_scene *scene, const char *model_path);

/* The image of a view as training sees it: undistorted, reduced, masked. Free it with oxl_image_free. */
OXL_API oxl_result oxl_scene_image(oxl_context *ctx, oxl_scene *scene, int view, oxl_image *out);

/* ---------------------------------------------------------------- models */

/* A model is a set of planes, one float array of `count` for each number that a Gaussian has: plane[OXL_MEAN + 1][i]
 * is the y of Gaussian i. Values are raw, as the standard PLY holds them: log scale, logit opacity, unnormalised
 * quaternion. Spherical harmonics are coefficient-major: plane[OXL_SH + 3 * k + c] is coefficient k of channel c.
 * Gradients and Adam's moments have the same shape, and so the same type.
 *
 * A row with a second lobe is a difference of Gaussians that share centre, rotation and colour [OceanXL eq. 3-4]:
 *     alpha = min(.99, o G) - min(.99, o' G'),   o' = o sigmoid(a),   s' = s exp(b) along each axis. */
enum {
    OXL_MEAN      = 0,  /* x y z, local coordinates */
    OXL_LOG_SCALE = 3,  /* natural log of the standard deviation along each own axis */
    OXL_ROTATION  = 6,  /* w x y z */
    OXL_OPACITY   = 10, /* logit */
    OXL_SH        = 11, /* 3 (degree + 1)^2 planes; colour = max(0, 0.5 + sum of basis x coefficient) */
    OXL_LOBE      = 59, /* the second lobe's factors: logit of the opacity's, then log of the scale's along each own axis */
    OXL_PLANES    = 63
};

typedef struct oxl_model {
    size_t count, capacity;
    size_t lobes;             /* rows 0..lobes-1 carry a second lobe; 0: none does, and the planes from OXL_LOBE on are NULL */
    int    sh_degree;         /* 0..3: bands carried; planes past them are NULL */
    double origin[3];         /* world = local + origin */
    float *plane[OXL_PLANES]; /* (count) each, (lobes) from OXL_LOBE on; 64-byte aligned */
    void  *memory;            /* what the planes lie in */
} oxl_model;

/* All zero but the identity rotation. */
OXL_API oxl_result oxl_model_create(oxl_context *ctx, size_t count, int sh_degree, oxl_model *out);
OXL_API void       oxl_model_free(oxl_context *ctx, oxl_model *model);
OXL_API int        oxl_model_planes(const oxl_model *model); /* 11 + 3 (degree + 1)^2: those that every row has */
/* The same model relative to another origin: what draws it with a scene's cameras expects the scene's. */
OXL_API void       oxl_model_move_origin(oxl_model *model, const double origin[3]);

/* One isotropic Gaussian a point, as wide as the mean distance to its 3 nearest neighbours [Kerbl 2023]. */
OXL_API oxl_result oxl_model_from_points(oxl_context *ctx, const oxl_point *points, size_t count, int sh_degree, oxl_model *out);

/* PLY: any property order and type, ascii and both endians in; the standard 62 float columns, little endian, out. Second lobes
 * follow in an element of their own, `dog`: float opacity_factor, scale_factor_0..2, raw; its row i belongs to vertex i, unless a property vertex_index says otherwise. Reading brings
 * rows with a lobe to the front; both parts keep their order. A file NAME_standard.ply is written without lobes, for any viewer.
 * By its file extension: .splat (32 bytes a Gaussian), both ways, without SH bands past 0; .spz (nianticlabs/spz: versions 2 and 3 are
 * read, 3 is written), about 20 bytes and 1 to 45 for bands, rounded; .glb (glTF with KHR_gaussian_splatting), written alone, with the
 * origin as the node's translation. Those three have no lobes, and all but .glb no origin. */
OXL_API oxl_result oxl_model_read(oxl_context *ctx, const char *path, oxl_model *out);
OXL_API oxl_result oxl_model_write(oxl_context *ctx, const char *path, const oxl_model *model);

/* ---------------------------------------------------------------- rendering */

typedef struct oxl_render_options {
    float background[3]; /* (0,0,0) */
    int   sh_degree;     /* bands evaluated; -1: all that the model carries */
    float near_plane; /* in the scene's unit; Gaussians at or before it are culled (0.2 of 3DGS, made relative: see PAPER.md) */
    float
        alpha_min; /* contributions to a pixel below it are left out on the CPU; less than 1/255 counts as that (1/255) [Kerbl 2023] */
} oxl_render_options;

OXL_API oxl_render_options oxl_render_options_default(void);

/* Draws the model as the camera sees it. out is created; depth, when not NULL, gets (H,W) expected camera z:
 * sum of alpha T z over sum of alpha T, 0 where nothing was met; it must hold H x W floats. */
OXL_API oxl_result oxl_render(oxl_context *ctx, const oxl_model *model, const oxl_camera *camera,
                              const oxl_render_options *options, oxl_image *out, float *depth);

/* The gradient of a scalar loss in every parameter, given drgb = dL/d(image), (3,H,W): exact for the image that
 * oxl_render draws. gradient is created in the shape of model. */
OXL_API oxl_result oxl_render_backward(oxl_context *ctx, const oxl_model *model, const oxl_camera *camera,
                                       const oxl_render_options *options, const float *drgb, oxl_model *gradient);

/* ---------------------------------------------------------------- metrics */

/* All over the pixels that count (weight of b) after clamping to 0..1. PSNR in dB, peak 1; identical images give 100.
 * cc_psnr (colour-corrected): PSNR after each channel of a was multiplied by the one factor that brings it nearest to b: what is left when
 * the image's own exposure and white balance count as no error.
 * SSIM: 11 x 11 Gaussian window of sigma 1.5, zero padding, C1 = 0.01^2, C2 = 0.03^2, mean over the channels (Wang 2004).
 * MS-SSIM: a perceptual measure that needs no trained weights; 5 scales with the exponents of Wang 2003, whole windows alone, channel
 * by channel. Images too small for 5 (176 px on the shorter side) have as many scales as hold a window, and the exponents of those,
 * divided by their sum; below 11 px it is SSIM. Neither is LPIPS, which needs the weights of a network. */
OXL_API oxl_result oxl_psnr(oxl_context *ctx, const oxl_image *a, const oxl_image *b, double *out);
OXL_API oxl_result oxl_cc_psnr(oxl_context *ctx, const oxl_image *a, const oxl_image *b, double *out);
OXL_API oxl_result oxl_ssim(oxl_context *ctx, const oxl_image *a, const oxl_image *b, double *out);
OXL_API oxl_result oxl_ms_ssim(oxl_context *ctx, const oxl_image *a, const oxl_image *b, double *out);

typedef enum oxl_split { OXL_SPLIT_TEST = 0, OXL_SPLIT_TRAIN, OXL_SPLIT_ALL } oxl_split;

typedef struct oxl_view_metrics {
    int    view; /* index in the scene */
    double psnr, cc_psnr, ssim, ms_ssim;
    double plain_psnr, half_psnr; /* at mean exposure; of the right half, with gains fitted on the left half */
} oxl_view_metrics;

typedef struct oxl_metrics {
    double            psnr, cc_psnr, ssim, ms_ssim; /* means over the views; 0 when there are none */
    double            plain_psnr, half_psnr;        /* so are these */
    int               count;
    oxl_view_metrics *views;       /* (count) */
    double            depth[2];    /* a third of the times that a point is seen, it lies nearer, and a third beyond */
    double            by_depth[3]; /* PSNR of the pixels around points seen nearer, in between, farther; NaN: there are none */
} oxl_metrics;

OXL_API oxl_result oxl_evaluate(oxl_context *ctx, const oxl_model *model, oxl_scene *scene, oxl_split split, oxl_metrics *out);
OXL_API void       oxl_metrics_free(oxl_context *ctx, oxl_metrics *metrics);

/* ---------------------------------------------------------------- training */

typedef enum oxl_dog { /* which Gaussians get a second, negative lobe [OceanXL eq. 3-4] */
                       OXL_DOG_OFF = 0,
                       OXL_DOG_SELECTIVE, /* those whose mean |dL/d(mean)| is above dog_threshold late in the run */
                       OXL_DOG_ALL,
                       OXL_DOG_AUTO /* selective, where a trial on views held out for it says that they pay */
} oxl_dog;

/* A gain per channel and training image, optimised with the scene: cameras that adapt exposure and white balance (docs/WATER.md). */
typedef enum oxl_exposure {
    OXL_EXPOSURE_OFF = 0,
    OXL_EXPOSURE_ON,
    OXL_EXPOSURE_AUTO /* on where validation views say that the gains of their neighbours help */
} oxl_exposure;

typedef enum oxl_preset { OXL_PRESET_DRAFT = 0, OXL_PRESET_STANDARD, OXL_PRESET_PAPER } oxl_preset;

/* What Wise Adaptive Pruning keeps of the Gaussians that density control leaves [OceanXL sec. 3.2]. */
typedef enum oxl_keep_kind {
    OXL_KEEP_ALL = 0,
    OXL_KEEP_FRACTION, /* a share of them, 0..1 */
    OXL_KEEP_COUNT,    /* at most so many */
    OXL_KEEP_BYTES,    /* as many as go into a file of this size */
    OXL_KEEP_AUTO      /* as few as leave training views that are held out for it as good as they were */
} oxl_keep_kind;
typedef struct oxl_keep {
    oxl_keep_kind kind;
    double        value;
} oxl_keep;

/* "0.5", "400000", "80MB" (B, KB, MB, GB, TB; KiB...), "auto", "all". */
OXL_API oxl_result oxl_keep_parse(oxl_context *ctx, const char *text, oxl_keep *out);

/* Underwater-Compensated Densification: more Gaussians where water takes contrast [OceanXL eq. 2]. */
typedef enum oxl_ucd_mode {
    OXL_UCD_OFF = 0,
    OXL_UCD_ON,
    OXL_UCD_AUTO /* on when the images show contrast fade with depth */
} oxl_ucd_mode;
typedef enum oxl_ucd_bands {
    OXL_UCD_THIRDS = 0, /* of the largest depth, as the paper has it */
    OXL_UCD_QUANTILES,  /* a third of the points' depths in each */
    OXL_UCD_FADING      /* where contrast has come down to 4/5 and to 1/2 */
} oxl_ucd_bands;
typedef struct oxl_ucd {
    oxl_ucd_mode  mode;
    oxl_ucd_bands bands;
    float         f_mid,
        f_far; /* weights of the gradients in the middle and the far band: where the search starts; 1 <= mid <= far <= 5 */
    int learn; /* 0: they stay there */
} oxl_ucd;

OXL_API oxl_ucd    oxl_ucd_default(void);
/* "on", "off", "auto", "1.5,2" (on, and the search starts there), "1.5,2,fixed", "auto,1.5,2". */
OXL_API oxl_result oxl_ucd_parse(oxl_context *ctx, const char *text, oxl_ucd *out);

typedef struct oxl_train_options {
    int      iterations;    /* one image each */
    int      sh_degree;     /* 0..3: bands at the end of the run; -1 (auto): as many as training views held out for it ask for */
    int      max_gaussians; /* a cap on their number; 0: what the images can determine, one for 60 training pixels (PAPER.md) */
    double   max_seconds;   /* stop in good order after this long; 0: no limit */
    float    background[3];
    float    ssim_weight; /* loss = (1 - w) L1 + w (1 - SSIM) */
    /* less work a step; docs/TRADEOFF.md has what each saves and costs */
    float    coarse;             /* first share of the run, at half the sides; -1: 0.25 for images of 640 px and more */
    float    alpha_min;          /* in the first 0.8 of the run, as in oxl_render_options; at most 0.05 */
    float    sh_degree_interval; /* share of the run after which there is one more band of spherical harmonics */
    /* Adam's step sizes [Kerbl 2023]; the position's is multiplied by the scene's extent and decays exponentially */
    float    rate_mean_first, rate_mean_last, rate_log_scale, rate_rotation, rate_opacity, rate_sh0, rate_sh;
    /* Those are of 30 000 iterations. With h = (30 000 / n)^haste, in a run of n < 30 000, they are h times as large for means, scales
     * and rotations, sqrt(h) times for bands above 0; and the first Gaussians are narrower and more opaque than Kerbl's. In a run
     * of n < 7000, with r = (7000 / n)^haste, scales take sqrt(r) times that again, the mean gradient forgets r^2 times as much in a
     * step (up to a half), and the mean of its square r^-1.5 times as much (docs/TRADEOFF.md). */
    float    short_run_exponent;
    float    cooldown; /* last share of the run, over which all steps shrink to a tenth; 0: none (docs/TRADEOFF.md) */
    /* density control, as fractions of the run and steps */
    float    densify_from, densify_until; /* shares of the run */
    int      densify_every;               /* steps */
    float    densify_gradient;            /* of dL/d(mean) in units of half an image */
    float    reset_opacity_every;         /* share of the run */
    oxl_ucd  ucd;
    oxl_keep keep;
    oxl_exposure exposure;
    int          medium; /* 1: water between camera and Gaussians is modelled, nine parameters, on the CPU (docs/WATER.md) */
    int          mask_transients; /* 1: what one image has and the others of the place have not, as fish, is not learned */
    /* difference-of-Gaussians lobes */
    oxl_dog      dog;
    float        dog_from;      /* share of the run at which they are given out, while pruning goes on [OceanXL sec. 3.2] */
    float        dog_threshold; /* of the mean gradient, in units of half an image; at most 0: minus the share left without */
    float        dog_opacity_factor, dog_scale_factor; /* of a fresh lobe */
} oxl_train_options;

OXL_API oxl_train_options oxl_train_options_default(oxl_preset preset);
/* OXL_ERR_USAGE when a value is out of its range; names the first such option. */
OXL_API oxl_result        oxl_train_options_check(oxl_context *ctx, const oxl_train_options *options);

/* Numbers that were not finite, or as good as not, and what was done about them: all 0 in a run that went well. */
typedef struct oxl_nonfinite {
    size_t images;     /* that could not be read: left out */
    size_t steps;      /* whose loss was not finite: skipped */
    size_t rows;       /* steps of single Gaussians whose gradient was not finite: skipped */
    size_t cleared;    /* Gaussians that held such a number: made invisible, or removed at the end */
    size_t degenerate; /* of the result: without a rotation, or of a scale past e^+-87; drawn all the same */
} oxl_nonfinite;

typedef struct oxl_progress {
    int              iteration, iterations;
    int              block, blocks; /* of a job that trains several, from 0; else 0, 0 */
    size_t           gaussians;
    double           loss, psnr;   /* smoothed over the last views, on training images */
    double           f_mid, f_far; /* weights of the depth bands in density control; 1, 1 without */
    double           seconds;      /* since the start */
    double           seconds_left; /* predicted */
    size_t           memory;       /* bytes at the peak so far; only in a job, else 0 */
    const oxl_model *model;        /* as it stands, on a device as it was brought home last; valid during the call */
    oxl_nonfinite    nonfinite;    /* so far */
    int              trial;        /* 1: a step of a way that is tried out, for a decision; it may be taken back */
} oxl_progress;

/* Called after every iteration; nonzero stops the run, which then returns OXL_ERR_INTERRUPTED and a usable model. */
typedef struct oxl_callback {
    int (*progress)(void *user, const oxl_progress *progress);
    void *user;
} oxl_callback;

/* Trains a model on the scene's training views. The same scene, options and seed give the same bytes. */
OXL_API oxl_result oxl_train(oxl_context *ctx, oxl_scene *scene, const oxl_train_options *options, const oxl_callback *callback,
                             oxl_model *out);

#ifdef __cplusplus
}
#endif
#endif
