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

/* 1 when standard output (1) or standard error (2) is a terminal: a progress line can be rewritten there. */
OXL_API int oxl_is_terminal(int stream);

/* For the first lines of main(): threads that wait for others are to sleep, after a short look (GNU's runtime). OpenMP's own way, trying
 * again and again, makes a run take three times as long on a machine that does something else; to sleep at once costs a tenth or more
 * on one that does not (docs/log/SPEED.md). The OpenMP runtime reads its settings before main(): so the program is started again in its own
 * place, with OMP_WAIT_POLICY=passive and GOMP_SPINCOUNT. With the first of them set, without OpenMP or off Linux it just returns. */
OXL_API void oxl_wait_asleep(char **argv);

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

OXL_API oxl_result oxl_make_folder(oxl_context *ctx, const char *path); /* with its parents; there already: fine */
OXL_API int        oxl_is_folder(const char *path);

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
    const char *images;            /* folder of the photographs; NULL: SCENE/images */
    const char *sparse;            /* folder of COLMAP's files; NULL: SCENE/sparse/0, SCENE/sparse or SCENE */
    const char *masks;             /* folder of masks; NULL: SCENE/masks when it is there */
    int         max_side;          /* photographs are reduced until their longer side is at most this, px */
    int         test_every;        /* every n-th view by name is held out; 0: none */
    size_t      image_cache_bytes; /* decoded photographs kept in memory; the others are decoded again */
    double      missing_share;     /* fail when more than this share of the photographs is not on disk */
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

/* The ray along which a pixel of the photograph, of the size in cameras.txt, was seen, distortion undone: where it starts and a unit vector, local
 * coordinates. OXL_ERR_INPUT: a pixel outside of the photograph, or one that the lens model does not reach. */
OXL_API oxl_result oxl_scene_ray(oxl_context *ctx, const oxl_scene *scene, int view, double x, double y, double start[3],
                                 double way[3]);

/* The gains of the scene's images from imaging.txt beside a model's file, where train has left one: evaluation and pictures apply
 * them then. No such file: nothing happens. */
OXL_API oxl_result oxl_scene_read_imaging(oxl_context *ctx, oxl_scene *scene, const char *model_path);

/* The photograph of a view as training sees it: undistorted, reduced, masked. Free it with oxl_image_free. */
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
 * the photograph's own exposure and white balance count as no error.
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

/* Whether a part of the image formation is modelled (docs/WATER.md). */
typedef enum oxl_switch {
    OXL_OFF = 0,
    OXL_ON,
    OXL_AUTO /* on where validation views gain by it */
} oxl_switch;

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
    OXL_UCD_AUTO /* on when the photographs show contrast fade with depth */
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
    int iterations;    /* one photograph each */
    int sh_degree;     /* 0..3: bands at the end of the run; -1 (auto): as many as training views held out for it ask for */
    int max_gaussians; /* a cap on their number; 0: what the photographs can determine, one for 60 training pixels (PAPER.md) */
    double     max_seconds; /* stop in good order after this long; 0: no limit */
    float      background[3];
    float      ssim_weight; /* loss = (1 - w) L1 + w (1 - SSIM) */
    /* less work a step; docs/TRADEOFF.md has what each saves and costs */
    float      coarse;             /* first share of the run, at half the sides; -1: 0.25 for photographs of 640 px and more */
    float      alpha_min;          /* in the first 0.8 of the run, as in oxl_render_options; at most 0.05 */
    float      sh_degree_interval; /* share of the run after which there is one more band of spherical harmonics */
    /* Adam's step sizes [Kerbl 2023]; the position's is multiplied by the scene's extent and decays exponentially */
    float      rate_mean_first, rate_mean_last, rate_log_scale, rate_rotation, rate_opacity, rate_sh0, rate_sh;
    /* Those are of 30 000 iterations. With h = (30 000 / n)^haste, in a run of n < 30 000, they are h times as large for means, scales
     * and rotations, sqrt(h) times for bands above 0; and the first Gaussians are narrower and more opaque than Kerbl's. In a run
     * of n < 7000, with r = (7000 / n)^haste, scales take sqrt(r) times that again, the mean gradient forgets r^2 times as much in a
     * step (up to a half), and the mean of its square r^-1.5 times as much (docs/TRADEOFF.md). */
    float      short_run_exponent;
    float      cooldown; /* last share of the run, over which all steps shrink to a tenth; 0: none (docs/TRADEOFF.md) */
    /* density control, as fractions of the run and steps */
    float      densify_from, densify_until; /* shares of the run */
    int        densify_every;               /* steps */
    float      densify_gradient;            /* of dL/d(mean) in units of half an image */
    float      reset_opacity_every;         /* share of the run */
    oxl_ucd    ucd;
    oxl_keep   keep;
    oxl_switch exposure; /* a log gain per channel and training image */
    oxl_switch lamp;     /* a light that moves with the camera: a smooth gain over the image, falloff with distance; on the CPU */
    oxl_switch medium;   /* water between camera and Gaussians: nine parameters; on the CPU */
    int        mask_transients; /* 1: what one photograph has and the others of the place have not, as fish, is not learned */
    /* difference-of-Gaussians lobes */
    oxl_dog    dog;
    float      dog_from;      /* share of the run at which they are given out, while pruning goes on [OceanXL sec. 3.2] */
    float      dog_threshold; /* of the mean gradient, in units of half an image; at most 0: minus the share left without */
    float      dog_opacity_factor, dog_scale_factor; /* of a fresh lobe */
} oxl_train_options;

OXL_API oxl_train_options oxl_train_options_default(oxl_preset preset);

/* Numbers that were not finite, or as good as not, and what was done about them: all 0 in a run that went well. */
typedef struct oxl_nonfinite {
    size_t photographs; /* that could not be read: left out */
    size_t steps;       /* whose loss was not finite: skipped */
    size_t rows;        /* steps of single Gaussians whose gradient was not finite: skipped */
    size_t cleared;     /* Gaussians that held such a number: made invisible, or removed at the end */
    size_t degenerate;  /* of the result: without a rotation, or of a scale past e^+-87; drawn all the same */
} oxl_nonfinite;

typedef struct oxl_progress {
    int              iteration, iterations;
    int              block, blocks; /* of a job that trains several, from 0; else 0, 0 */
    size_t           gaussians;
    double           loss, psnr;   /* smoothed over the last views, on training photographs */
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

/* ---------------------------------------------------------------- blocks */

/* A survey too large for one model is cut into blocks along its principal axes [OceanXL sec. 3.1, Alg. 1]. */
typedef enum oxl_partition_kind {
    OXL_PARTITION_AUTO = 0, /* 2D when the third principal extent is less than 0.3 of the second, else 3D */
    OXL_PARTITION_2D,       /* never cut across the third principal axis */
    OXL_PARTITION_3D,
    OXL_PARTITION_NONE /* one block, whatever its size */
} oxl_partition_kind;

typedef enum oxl_cut {
    OXL_CUT_BALANCED = 0, /* where both sides hold as equal numbers of points as a cut at 0.3 to 0.7 of the box can make them */
    OXL_CUT_MIDPOINT      /* at 0.5, as BlockGaussian does: the baseline */
} oxl_cut;

typedef struct oxl_partition_options {
    int                block_points; /* a block of more points than this is cut */
    oxl_partition_kind kind;
    oxl_cut            cut;
} oxl_partition_options;

OXL_API oxl_partition_options oxl_partition_options_default(void);

/* ---------------------------------------------------------------- the whole job */

typedef struct oxl_job_options {
    oxl_scene_options     scene;
    oxl_train_options     train;
    oxl_partition_options partition;
    const char           *preset;  /* where they came from; run.json repeats it */
    int                   renders; /* 1: pictures of the held-out views go to OUT/renders */
    size_t                ram;     /* bytes that the run may take at its peak; blocks, cache and Gaussians follow; 0: any */
    int                   block;   /* train this block alone and do not merge; -1: all */
    float                 refine;  /* merged blocks are refined together for this share of their steps; 0: not */
    int                   restart; /* 1: give up unfinished work of other options in OUT */
    uint64_t              seed;    /* 0: the context's */
} oxl_job_options;

OXL_API oxl_job_options oxl_job_options_default(oxl_preset preset);

/* ---------------------------------------------------------------- options by name */

/* One row for each option of the training job: src/job/options.c holds the table. Defaults, parsing, range checks, run.json, the command
 * line, its help, the manual page and docs/OPTIONS.md are made from it. A program may keep a table of the same type for options of its own. */
typedef enum oxl_option_kind {                     /* what the field holds, and its text */
                               OXL_OPTION_FLAG,    /* int, 0 or 1: no text, or true | false */
                               OXL_OPTION_INT,     /* int */
                               OXL_OPTION_LONG,    /* long */
                               OXL_OPTION_SEED,    /* uint64_t */
                               OXL_OPTION_FLOAT,   /* float: 0.05 or 1/255 */
                               OXL_OPTION_DOUBLE,  /* double */
                               OXL_OPTION_CHOICE,  /* an enum that counts from 0: a word of `value` */
                               OXL_OPTION_BYTES,   /* size_t: 1000000, 512M, 4G; K, M, G, T are powers of 1024 */
                               OXL_OPTION_SECONDS, /* double: 90s, 20m, 8h, 1d */
                               OXL_OPTION_TEXT,    /* const char *, borrowed; NULL: not given */
                               OXL_OPTION_RGB,     /* float[3]: 0,0.1,0.2 */
                               OXL_OPTION_PLACE,   /* double[3]: X,Y,Z */
                               OXL_OPTION_SIZE,    /* int[2]: 400x260 */
                               OXL_OPTION_PRESET, /* const char *; setting it sets all options of the job to the preset's defaults */
                               OXL_OPTION_UCD,    /* oxl_ucd, but for its bands, as oxl_ucd_parse reads it */
                               OXL_OPTION_KEEP, /* oxl_keep, as oxl_keep_parse reads it */
                               OXL_OPTION_LIMIT /* float: 0.0002; or 90%, held as -0.9 */
} oxl_option_kind;

typedef enum oxl_option_tier { OXL_TIER_BASIC = 0, OXL_TIER_ADVANCED, OXL_TIER_EXPERT } oxl_option_tier;

enum {                             /* what an option of the job is for: bits of oxl_option.use */
       OXL_OPTION_OF_SURVEY   = 1, /* reading a survey */
       OXL_OPTION_OF_TRAINING = 2, /* training, in a run or in a study */
       OXL_OPTION_OF_RUN      = 4, /* one run, or what predicts it */
       OXL_OPTION_OF_OUT      = 8, /* what is in OUT already */
       OXL_OPTION_OF_BLOCK    = 16,
       OXL_OPTION_OF_MERGE    = 32,
       OXL_OPTION_OF_RESULT =
           64 /* the bytes of every block depend on it: it stands in run.json's "job", named as here with _ for - */
};

typedef struct oxl_option {
    const char     *name;  /* "sh-degree" */
    const char     *value; /* "auto|0..3"; NULL: a flag. A number whose value begins with WORD| takes that word too, held as -1 */
    oxl_option_kind kind;
    size_t          at;        /* offset of the field: in oxl_job_options; in what the program's own table is about */
    double          low, high; /* of numbers, both allowed */
    const char     *preset[3]; /* default as text, by oxl_preset; NULL: 0 */
    oxl_option_tier tier;
    unsigned        use;
    const char     *group, *help; /* help with the unit, without the default */
    const char     *alias;        /* former name, still read; NULL: none */
} oxl_option;

OXL_API int               oxl_option_count(void);
OXL_API const oxl_option *oxl_option_at(int index);          /* 0 .. count - 1; 0 is the preset */
OXL_API const oxl_option *oxl_option_find(const char *name); /* by its name or former name; NULL: there is none */
/* Reads text into the option's field; the text is kept (borrowed) for folders. OXL_ERR_USAGE: the field is as it was, and error, which may
 * be NULL, names the option, what was seen, what is wanted and a fix. */
OXL_API oxl_result  oxl_option_set(const oxl_option *option, void *options, const char *text, char *error, size_t error_size);
/* The shortest text that oxl_option_set reads back to the same value; "" for a folder that was not given. Returns out. */
OXL_API const char *oxl_option_get(const oxl_option *option, const void *options, char *out, size_t size);
/* Its member in run.json: sh_degree, images_folder. Returns out. */
OXL_API const char *oxl_option_member(const oxl_option *option, char out[40]);
/* OXL_ERR_USAGE when a value is out of its range; names the first such option. */
OXL_API oxl_result  oxl_job_options_check(oxl_context *ctx, const oxl_job_options *options);
OXL_API oxl_result  oxl_train_options_check(oxl_context *ctx, const oxl_train_options *options);

/* What a survey holds and what training it would take: a lint report. */
typedef struct oxl_survey {
    int    images, images_missing; /* listed in images.txt; of them not on disk */
    int    train_views, test_views, masks;
    int    cameras, cameras_distorted;
    int    width, height; /* of the largest view as trained, px */
    size_t points, observations;
    double mean_track, mean_error;       /* images a point, reprojection error in px */
    double bounds_min[3], bounds_max[3]; /* 1st to 99th percentile of the points, world coordinates */
    double extent;                       /* see oxl_scene_extent */
    double missed;           /* of a point in a track: the share not in their photographs, those with a wrong pose left out */
    double masked;           /* share of the masks that is black; oxl_check alone fills this and the next */
    int    unusable;         /* photographs that cannot be read, are of another shape or masked all over */
    double gaussians;        /* predicted at the end of the run */
    double memory, seconds;  /* predicted: peak in bytes, duration on ctx's threads */
    double seconds_range[2]; /* the least and the most that the duration may be */
    double memory_free;      /* now; 0: unknown */
    char   cameras_text[160], text[2048]; /* "1 x OPENCV 1920 x 1080, distorted"; the report in lines for people */
} oxl_survey;

/* OXL_ERR_INPUT when the survey cannot be trained; the error says why. out->text ends in a newline. */
OXL_API oxl_result oxl_check(oxl_context *ctx, const char *scene, const oxl_job_options *options, oxl_survey *out);

/* Trains the survey in folder `scene` and leaves in folder `out`: scene.ply, scene_standard.ply when that is not the
 * standard's 62 columns, metrics.json, run.json and renders/; and for each block
 * blocks/KKK/ with model.ply, log.csv and block.json. A survey of at most block_points points is one block, 000, trained as it is;
 * a larger one is cut first (partition.txt, partition.svg, and a COLMAP text export in each blocks/KKK/), merged, and refined on all
 * photographs in blocks/together/ (see `refine`).
 *
 * While a block is trained, its folder holds checkpoints. A run that was stopped, by whatever, goes on from there when it is
 * called again, to the same bytes as if nothing had been; a finished one is left as it is. When the callback stops the run, or
 * train.max_seconds is over, model.ply is the model so far (scene.ply too, of one block); OXL_ERR_INTERRUPTED or OXL_OK is returned.
 * An unfinished run of other options is not overwritten (OXL_ERR_USAGE) unless options->restart says so; when nobody can tell
 * whose work it is (run.json is lost), its checkpoints are kept as NAME.other.
 * options may be NULL: the draft preset. */
OXL_API oxl_result oxl_job_run(oxl_context *ctx, const char *scene, const char *out, const oxl_job_options *options,
                               const oxl_callback *callback);

/* ---------------------------------------------------------------- the survey in blocks */

typedef struct oxl_block {
    size_t points, start_points;       /* at home in it; that its training starts from */
    int    base_views, border_views;   /* views that see much of what they see in it; views that see much of it */
    double gaussians, memory, seconds; /* predicted, as in oxl_survey */
} oxl_block;

typedef struct oxl_balance { /* peak: the largest over the mean; spread: standard deviation over the mean; 1 and 0 are perfect */
    int    blocks;
    double points_peak, points_spread, views_peak, views_spread;
    double memory, seconds, longest; /* predicted: of the block that takes most; of all, one after the other; of the longest */
} oxl_balance;

typedef struct oxl_partition_report {
    int         dimensions; /* 2 or 3 */
    double      extent[3];  /* along the principal axes, in the survey's unit */
    oxl_cut     cut;        /* that was used */
    oxl_balance balance[2]; /* by oxl_cut: as it is, and as it would be */
    int         block_count;
    oxl_block  *block;
} oxl_partition_report;

/* Cuts the survey in folder `scene` into blocks and leaves in folder `out`: blocks/000/... as COLMAP text exports, partition.txt and
 * partition.svg. report may be NULL; options may be NULL: the draft preset. Photographs need not be there, but when their folder is,
 * views whose photograph is missing are left out as in training. */
OXL_API oxl_result oxl_partition(oxl_context *ctx, const char *scene, const char *out, const oxl_job_options *options,
                                 oxl_partition_report *report);
OXL_API void       oxl_partition_report_free(oxl_context *ctx, oxl_partition_report *report);
OXL_API oxl_result oxl_partition_to_json(oxl_context *ctx, const oxl_partition_report *report, char **out);
/* Merges the finished blocks of the run in folder `out` into scene.ply, refines them together and judges the whole: what oxl_job_run does
 * at its end. refine: as in oxl_job_options, in the place of the run's; -1: the run's. callback may be NULL. */
OXL_API oxl_result oxl_merge(oxl_context *ctx, const char *out, float refine, const oxl_callback *callback);

/* The options of the run in folder `out`, if there is one of this survey: a run that is resumed keeps what it was given. Otherwise
 * options stay as they are. Their strings lie in *run: free it, by oxl_manifest_free, when the options are no longer used. */
typedef struct oxl_manifest oxl_manifest;
OXL_API oxl_result          oxl_job_resume(oxl_context *ctx, const char *scene, const char *out, oxl_job_options *options,
                                           oxl_manifest **run);
OXL_API void                oxl_manifest_free(oxl_context *ctx, oxl_manifest **run);

/* Pictures of a split into a folder: NAME.png for each view; with photographs NAME.photo.png; with depth NAME.depth.png
 * (near is bright), NAME.depth.pfm (float camera z, 0: nothing there) and NAME.depth16.png (16-bit grey: camera z in thousandths of
 * a unit, of a metre with `unit`; 0: nothing there, 65535: that or more). */
typedef struct oxl_pictures {
    oxl_split split;
    int       photographs, depth;
    double    unit;  /* depths are multiplied by it: metres a unit of the scene (0: they stay) */
    int       clear; /* 1: the scene itself, without what imaging.txt says of the image (0) */
} oxl_pictures;
OXL_API oxl_result oxl_render_views(oxl_context *ctx, const oxl_model *model, oxl_scene *scene, const oxl_pictures *what,
                                    const char *folder, int *count);

/* JSON as metrics.json holds it; free it with oxl_text_free. */
OXL_API oxl_result oxl_metrics_to_json(oxl_context *ctx, const oxl_scene *scene, const oxl_metrics *metrics, char **out);
OXL_API oxl_result oxl_survey_to_json(oxl_context *ctx, const oxl_survey *survey, char **out);
OXL_API void       oxl_text_free(oxl_context *ctx, char *text);

#ifdef __cplusplus
}
#endif
#endif
