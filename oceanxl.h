/* oceanxl.h - from a COLMAP model of an underwater survey to one compact 3D Gaussian Splatting model.
 *
 * This header is the manual. The shortest useful program:
 *
 *     #include "oceanxl.h"
 *     #include <stdio.h>
 *     int main(void)
 *     {
 *         oxl_context *ctx = NULL;
 *         oxl_scene   *scene = NULL;
 *         oxl_trained  trained = {0};
 *         oxl_train_options train = oxl_train_options_default(OXL_PRESET_DRAFT);
 *         oxl_result rc = oxl_context_create(NULL, &ctx);
 *         if (rc == OXL_OK) rc = oxl_scene_load(ctx, "survey", NULL, &scene);
 *         if (rc == OXL_OK) rc = oxl_train(ctx, scene, &train, NULL, &trained);
 *         if (rc == OXL_OK) rc = oxl_trained_write(ctx, ".", scene, &trained);
 *         if (rc != OXL_OK) fprintf(stderr, "%s\n", oxl_error_text(ctx));
 *         oxl_trained_free(ctx, &trained);
 *         oxl_scene_free(ctx, scene);
 *         oxl_context_free(ctx);
 *         return rc;
 *     }
 *
 * Conventions
 *   frames      COLMAP's: +x right, +y down, +z forward; world to camera is  x_c = R x_w + t;
 *               quaternions are Hamilton, (w, x, y, z); the centre of the top-left pixel is (0.5, 0.5).
 *   origin      the library reads input in double, centres it on a robust local origin, and trains in float.
 *               All positions in a scene or model are relative to `origin`:  world = local + origin.
 *   images      float, planar (3,H,W): all of red, then green, then blue; 0 black, 1 white.
 *   errors      every function that can fail returns oxl_result; oxl_error_text(ctx) then names what was
 *               found, what was expected and a fix. The library never exits and never prints.
 *   ownership   the function that fills `out` allocates it; the _free of its type releases it (NULL and
 *               zeroed structs are allowed). Free scenes, models and images before their context. On error
 *               `*out` is zeroed, unless a function says that a stopped run leaves a usable result.
 *   threads     a context may be used by one thread at a time; OpenMP uses at most `threads` inside.
 *               The result does not depend on their number. Set OMP_WAIT_POLICY=passive before the program
 *               starts: else waiting threads spin, which slows small scenes on a busy machine.
 *   pointers    must not be NULL, except where a function says so.
 *   building    cc -O3 -std=c99 -fopenmp -ffp-contract=off -fno-math-errno -fno-trapping-math program.c
 *               oceanxl.c -lm; dist/single needs no oceanxl.c. Both need stb. Never -ffast-math. C++ may
 *               include this header; the implementation is C99.
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

/* ---------------- results */

typedef enum oxl_result {
    OXL_OK = 0,
    OXL_ERR_FAILED, /* any other failure */
    OXL_ERR_USAGE,  /* invalid arguments, or arguments that contradict each other */
    OXL_ERR_INPUT,  /* a file is missing, malformed or of an unknown format */
    OXL_ERR_IO,     /* reading or writing failed: disk full, permission, an image is missing */
    OXL_ERR_MEMORY, /* allocation failed */
    OXL_ERR_BUDGET, /* the memory budget is too small; the text names the option that helps */
    /* stopped by oxl_context_options.stopped or a callback; after training, out is usable if out->model.count
     * is not 0 */
    OXL_ERR_INTERRUPTED
} oxl_result;

/* ---------------- context */

typedef struct oxl_context oxl_context;

typedef enum oxl_log_level { OXL_LOG_ERROR = 0, OXL_LOG_WARNING, OXL_LOG_INFO, OXL_LOG_DEBUG } oxl_log_level;

/* The device that renders and trains. Only builds with `make VULKAN=1` have the Vulkan backend. It was tested
 * on one NVIDIA H100, lavapipe and SwiftShader, so the CPU is the default. */
typedef enum oxl_backend {
    OXL_BACKEND_CPU = 0,
    OXL_BACKEND_AUTO,  /* a Vulkan device that is not a CPU driver, if present; else the CPU */
    OXL_BACKEND_VULKAN /* a Vulkan device; OXL_ERR_FAILED names what is missing */
} oxl_backend;

typedef struct oxl_context_options {
    int threads; /* 0: OpenMP's default */
    /* seeds all random numbers: view order, dropout, signs of SPSA, random starting points (1) */
    uint64_t seed;
    /* NULL: the C library's realloc. Otherwise a function like it: it keeps contents up to the smaller size,
     * and `old` on failure; size 0 frees and returns NULL; old may be NULL. It returns memory aligned to 16
     * bytes. One thread at a time calls it, not always the same one. */
    void *(*reallocate)(void *user, void *old, size_t size);
    /* one or two lines, no last newline; NULL: no log */
    void (*log)(void *user, oxl_log_level level, const char *text);
    /* nonzero: long operations soon end with OXL_ERR_INTERRUPTED, except training steps, which ask
     * oxl_callback; NULL: never */
    int (*stopped)(void *user);
    void *user;          /* passed to reallocate, log and stopped */
    oxl_backend backend; /* (CPU) */
    int device;          /* index in the list of oxl_devices; -1: discrete devices first (-1) */
    size_t device_ram;   /* bytes of the device's memory that may be used; 0: all (0) */
    int command_line;    /* 1: texts name options as --max-side, 0: as max_side (0) */
} oxl_context_options;

OXL_API oxl_context_options oxl_context_options_default(void);

/* Creates a context. options NULL: the defaults. */
OXL_API oxl_result oxl_context_create(const oxl_context_options *options, oxl_context **out);
OXL_API void oxl_context_free(oxl_context *ctx);

/* Returns the last error's text, "" without one; valid as long as ctx, which may be NULL. */
OXL_API const char *oxl_error_text(const oxl_context *ctx);
/* Stores an error text and returns rc, for a program's own functions that fail as the library's do. A second
 * line that starts with "fix: " names one action. ctx may be NULL. */
OXL_API oxl_result oxl_fail(oxl_context *ctx, oxl_result rc, const char *format, ...);

/* Frees text returned by the library; text may be NULL. */
OXL_API void oxl_text_free(oxl_context *ctx, char *text);

/* Names the kernels' instruction set: "avx512", "avx2" or "base". The environment variable OXL_ISA can
 * lower it. */
OXL_API const char *oxl_isa_name(const oxl_context *ctx);

/* Opens the device of options.backend, as the first function that needs it does. OXL_ERR_FAILED:
 * OXL_BACKEND_VULKAN finds no device. */
OXL_API oxl_result oxl_backend_begin(oxl_context *ctx);
/* Returns what has rendered so far: the device's name, "cpu", or "NAME and cpu" if the CPU took over. Before
 * the first rendering it returns what will render. */
OXL_API const char *oxl_backend_name(const oxl_context *ctx);
/* Lists the Vulkan devices in the order of oxl_context_options.device, one line each, with their limits; free
 * with oxl_text_free. OXL_ERR_FAILED: the build has no Vulkan backend. */
OXL_API oxl_result oxl_devices(oxl_context *ctx, char **out);

/* ---------------- images */

typedef struct oxl_image {
    int width, height;
    float *rgb;    /* (3,H,W) planar, 0..1 */
    float *weight; /* (H,W) weights of pixels in losses and metrics, 0 (masked) to 1; NULL: all are 1 */
} oxl_image;

/* Creates a black image without weights. OXL_ERR_USAGE: a side is not 1..32768 px. */
OXL_API oxl_result oxl_image_create(oxl_context *ctx, int width, int height, oxl_image *out);
OXL_API void oxl_image_free(oxl_context *ctx, oxl_image *image);
/* Reads a JPG or PNG file. OXL_ERR_IO: the file is missing or cannot be read; OXL_ERR_INPUT: it is neither a
 * JPG nor a PNG, or damaged. */
OXL_API oxl_result oxl_image_read(oxl_context *ctx, const char *path, oxl_image *out);
/* Writes an 8-bit PNG file, whole or not at all. Values are clamped to 0..1; NaN is written as 0.
 * OXL_ERR_IO: it cannot be written. */
OXL_API oxl_result oxl_image_write(oxl_context *ctx, const char *path, const oxl_image *image);
/* Writes a PNG as oxl_image_write does, with image->weight, not NULL, as its alpha channel. */
OXL_API oxl_result oxl_image_write_alpha(oxl_context *ctx, const char *path, const oxl_image *image);

/* Encodes a JPEG in memory, quality 1..100; free with oxl_text_free. */
OXL_API oxl_result oxl_image_to_jpeg(oxl_context *ctx, const oxl_image *image, int quality, char **out,
                                     size_t *size);

/* ---------------- cameras and scenes */

/* An undistorted pinhole camera and its pose: x_c = R x + t in the scene's local coordinates. */
typedef struct oxl_camera {
    int width, height;     /* px */
    double fx, fy, cx, cy; /* px; the top-left pixel's centre is (0.5, 0.5) */
    double rotation[9];    /* R, row-major, world to camera */
    double translation[3]; /* t, in the scene's unit */
} oxl_camera;

typedef struct oxl_view {
    const char *name;  /* as in images.txt, e.g. "dive1/IMG 0001.JPG" */
    oxl_camera camera; /* belongs to the undistorted image at training resolution */
    int is_test;       /* 1: held out from training */
} oxl_view;

typedef struct oxl_point {
    double position[3]; /* local coordinates */
    float error;        /* reprojection error, px */
    uint8_t rgb[3];
} oxl_point;

typedef struct oxl_scene oxl_scene;

/* What is done with transparent pixels of images. */
typedef enum oxl_alpha {
    OXL_ALPHA_AUTO = 0,  /* masked if points of the scene project onto them, else composited */
    OXL_ALPHA_COMPOSITE, /* composited over the background */
    OXL_ALPHA_MASK       /* masked where alpha is below a half */
} oxl_alpha;

/* Defaults and ranges of all options: docs/OPTIONS.md. */
typedef struct oxl_scene_options {
    const char *images; /* image folder; NULL: SCENE/images */
    /* folder of the COLMAP model, or a file of points; NULL: the largest in SCENE/sparse, else SCENE */
    const char *sparse;
    const char *masks; /* mask folder; NULL: SCENE/masks if it exists */
    int auto_mask;     /* 1: pixels that look the same in all images of a camera are masked (1) */
    oxl_alpha alpha;   /* what is done with transparent pixels (AUTO) */
    int max_side;      /* larger images are reduced to this longer side, px; 0: full size (1600) */
    /* every n-th view by name is held out; 0: none; -1: 8, or those that the survey names, which takes no
     * other value (-1) */
    int test_every;
    size_t image_cache_bytes; /* memory for decoded images; others are decoded when needed (1 GiB) */
    double missing_images;    /* OXL_ERR_INPUT: more than this fraction of images is missing (0.3) */
    int read_images;          /* 0: loading does not look for image files, and ignores masks (1) */
    /* 1: a text file with fewer rows than its header states is read; 0: OXL_ERR_INPUT (0) */
    int allow_truncated;
} oxl_scene_options;

OXL_API oxl_scene_options oxl_scene_options_default(void);

/* Reads the survey in a folder: a COLMAP model, text or binary, or in its place a transforms.json
 * (nerfstudio, NeRF synthetic), poses_bounds.npy (LLFF) or OpenSfM's reconstruction.json. Errors of
 * OXL_ERR_INPUT name the file, its line, what was found and expected, and a fix. options NULL: the
 * defaults. */
OXL_API oxl_result oxl_scene_load(oxl_context *ctx, const char *path, const oxl_scene_options *options,
                                  oxl_scene **out);

/* Makes a scene of views (view_count) with name, camera and is_test; images (view_count), in the same
 * order; points (point_count), from which training starts. All are copied, colours in 8 bits, weights
 * above a half as 1, others as 0; the origin is 0. Views are sorted by name, so an index of the scene is not
 * one of the arrays. OXL_ERR_USAGE: sizes that differ, equal names, or a pose that is not finite or not
 * a rotation. With point_count 0, training starts from depth maps of the images
 * (oxl_train_options.stereo), or from random points in front of the cameras; points may then be NULL. */
OXL_API oxl_result oxl_scene_from_arrays(oxl_context *ctx, const oxl_view *views, const oxl_image *images,
                                         int view_count, const oxl_point *points, size_t point_count,
                                         oxl_scene **out);
OXL_API void oxl_scene_free(oxl_context *ctx, oxl_scene *scene);

OXL_API int oxl_scene_view_count(const oxl_scene *scene);
/* Views are ordered by name; NULL: there is no such index. */
OXL_API const oxl_view *oxl_scene_view(const oxl_scene *scene, int index);
OXL_API size_t oxl_scene_point_count(const oxl_scene *scene);
OXL_API const oxl_point *oxl_scene_points(const oxl_scene *scene);
OXL_API const double *oxl_scene_origin(const oxl_scene *scene); /* (3) world = local + origin */
/* Returns the near plane with which the scene is trained, for oxl_render_options. It follows from the depths
 * of the points. */
OXL_API double oxl_scene_near_plane(const oxl_scene *scene);
/* (2) latitude and longitude (WGS 84, degrees) of the world's origin, if its axes are metres east, north, up
 * there, as OpenSfM's reference_lla says; NULL: not known. */
OXL_API const double *oxl_scene_reference(const oxl_scene *scene);
/* Returns the unit of lr_position and of the size above which Gaussians are split (densify_gradient): 1.3 x
 * the median depth of the points in the training views; without points 1.1 x the robust radius of the
 * training cameras [Kerbl 2023]. */
OXL_API double oxl_scene_extent(const oxl_scene *scene);

/* Gives the ray of pixel (x, y) of the original image (size as in cameras.txt, before undistortion):
 * `start` and unit `direction`, local coordinates. OXL_ERR_USAGE: no such view; OXL_ERR_INPUT: the pixel is
 * outside the image or the domain of the distortion model. */
OXL_API oxl_result oxl_scene_ray(oxl_context *ctx, const oxl_scene *scene, int view, double x, double y,
                                 double start[3], double direction[3]);

/* Gives the image of a view as training uses it: undistorted, reduced and masked. Where the scene's images
 * are transparent, it is composited over `background`, 0..1 (NULL: white): to compare it with a render, that
 * of the render. Free with oxl_image_free. OXL_ERR_USAGE: no such view; OXL_ERR_IO: its file is missing or
 * cannot be read; OXL_ERR_INPUT: it is damaged, or masked completely. */
OXL_API oxl_result oxl_scene_image(oxl_context *ctx, const oxl_scene *scene, int view,
                                   const float background[3], oxl_image *out);

/* What lies between the colours of a model and the images of its scene: exposure gains of each image, a lamp,
 * a medium, refined poses (docs/UNDERWATER.md). NULL means none, except in
 * oxl_imaging_write. */
typedef struct oxl_imaging oxl_imaging;
/* Reads the imaging that belongs to a model file, from imaging.txt in its folder, without the medium or gains
 * that the file has in its colours; *out NULL: there is none. Lines of other views are skipped.
 * OXL_ERR_INPUT: it is malformed. */
OXL_API oxl_result oxl_imaging_read(oxl_context *ctx, const char *model_path, const oxl_scene *scene,
                                    oxl_imaging **out);
/* Writes an imaging.txt to the file `path`. OXL_ERR_USAGE: the scene has another number of views. */
OXL_API oxl_result oxl_imaging_write(oxl_context *ctx, const char *path, const oxl_scene *scene,
                                     const oxl_imaging *imaging);
/* Writes to gain the factors of red, green and blue by which a view's image differs from the render at mean
 * exposure; those of a held-out view are predicted from its neighbours. They are 1 if the imaging has no
 * gains, or no such view. */
OXL_API void oxl_imaging_gain(const oxl_imaging *imaging, int view, float gain[3]);
OXL_API void oxl_imaging_free(oxl_context *ctx, oxl_imaging *imaging);

/* ---------------- models */

/* A model is a set of planes, one float array of `count` per parameter: plane[OXL_MEAN + 1][i] is the y
 * coordinate of Gaussian i.
 * Values are raw, as in the standard PLY: log scale, logit opacity, unnormalised quaternion. Spherical
 * harmonics are coefficient-major: plane[OXL_SH + 3 * k + c] is coefficient k of channel c. Gradients and
 * Adam's moments have the same shape and type.
 *
 * A Gaussian with a second lobe is a difference of two Gaussians with the same centre, rotation and colour
 * [OceanXL eq. 3-4]:
 *     alpha = min(.99, o G) - min(.99, o' G'),   o' = o sigmoid(a),   s' = s exp(b) along each axis. */
enum {
    OXL_MEAN = 0,      /* x y z, local coordinates */
    OXL_LOG_SCALE = 3, /* natural log of the standard deviation along each principal axis */
    OXL_ROTATION = 6,  /* w x y z */
    OXL_OPACITY = 10,  /* logit */
    OXL_SH = 11,       /* 3 (degree + 1)^2 planes; colour = max(0, 0.5 + sum of basis x coefficient) */
    /* factors of the second lobe: logit of the opacity factor, then log of the scale factor along each
     * axis */
    OXL_LOBE = 59,
    OXL_PLANES = 63
};

typedef struct oxl_model {
    size_t count, capacity; /* Gaussians; rows that the planes have room for */
    /* rows 0..lobes-1 have a second lobe; 0: planes from OXL_LOBE on are NULL */
    size_t lobes;
    int sh_degree;    /* 0..3; planes of higher degrees are NULL */
    double origin[3]; /* world = local + origin */
    /* factor already applied to positions, sizes and origin, metres per unit of the survey; 0: none */
    double scale;
    float *plane[OXL_PLANES]; /* (count) each, (lobes) from OXL_LOBE on; 64-byte aligned */
    void *memory;             /* the allocation that holds the planes */
    /* colour behind the Gaussians, 0..1, of evaluation and renders; has_background 0: not known */
    float background[3];
    int has_background;
    /* 1: trained and rendered with a low pass of 0.1 px^2 that keeps a Gaussian's light [Yu 2024] */
    int antialias;
    /* camera of the survey from which viewers begin: [0] focal length over the longer side of its image (0:
     * no camera), [1..9] rotation from world to camera, row-major, [10..12] position in the world */
    double view[13];
    size_t not_finite; /* rows of the file that oxl_model_read left out */
} oxl_model;

/* Creates a model. All values are 0, except that rotations are the identity. OXL_ERR_USAGE: sh_degree is not
 * 0..3. */
OXL_API oxl_result oxl_model_create(oxl_context *ctx, size_t count, int sh_degree, oxl_model *out);
OXL_API void oxl_model_free(oxl_context *ctx, oxl_model *model);
OXL_API int oxl_model_planes(const oxl_model *model); /* 11 + 3 (degree + 1)^2: planes of `count` values */
/* Changes the model's origin and its positions, so that world positions stay. Rendering with a scene's
 * cameras needs the scene's origin. */
OXL_API void oxl_model_move_origin(oxl_model *model, const double origin[3]);
/* Multiplies positions, sizes, origin and the view's position by a factor above 0; model->scale is the
 * product of all factors. Other factors change nothing. */
OXL_API void oxl_model_rescale(oxl_model *model, double factor);

/* Creates one isotropic Gaussian per position; its scale is the rms distance to the 3 nearest
 * neighbours [Kerbl 2023]. Of points at one position the first is used, so out->count may be less than
 * `count`.
 * OXL_ERR_INPUT: a position is not finite. */
OXL_API oxl_result oxl_model_from_points(oxl_context *ctx, const oxl_point *points, size_t count,
                                         int sh_degree, oxl_model *out);

/* Formats of models. The extension selects the one to write; in reading the content comes first.
 *   .ply    3DGS's columns. Second lobes are in the element `dog`: float opacity_factor, scale_factor_0..2,
 *           raw; row i belongs to vertex i.
 *   .splat  32 bytes per Gaussian, SH degree 0, no lobes
 *   .spz    nianticlabs/spz: quantised, 20 to 65 bytes per Gaussian before compression, no lobes
 * Origin, scale, background, first view and anti-aliasing are comments of a .ply ("origin X Y Z", ...) and
 * lines of the comment in an .spz's gzip header; a .splat has none of them. */

/* Reads a .ply with properties of any order and type, ascii or binary, a .splat, or an .spz of version 2 or
 * 3. Rows keep their order.
 * OXL_ERR_INPUT: the file is missing, malformed or of another format. */
OXL_API oxl_result oxl_model_read(oxl_context *ctx, const char *path, oxl_model *out);
/* Writes a little-endian .ply of 62 float columns, a .splat, or an .spz of version 3. A file called
 * NAME_standard.ply is written without lobes. OXL_ERR_USAGE: the extension is none of these; OXL_ERR_FAILED:
 * a value is not finite; OXL_ERR_IO: the file cannot be written. */
OXL_API oxl_result oxl_model_write(oxl_context *ctx, const char *path, const oxl_model *model);

/* ---------------- rendering */

typedef struct oxl_render_options {
    float background[3]; /* red, green, blue, 0..1 (0,0,0) */
    int sh_degree;       /* largest degree evaluated; -1: the model's */
    /* Gaussians whose camera z is smaller are culled; in the scene's unit (0.2). For the views of a scene use
     * oxl_scene_near_plane */
    float near_plane;
    /* alpha values below the larger of this and 1/255 are skipped (1/255) [Kerbl 2023] */
    float alpha_min;
    /* For maps: above 0, all rays are parallel to the camera's z axis, fx and fy are px per unit, and this is
     * the distance from which the survey's cameras saw the ground, in the scene's unit. CPU only (0) */
    float parallel;
} oxl_render_options;

OXL_API oxl_render_options oxl_render_options_default(void);

/* Renders the model; out is created. options may be NULL: the defaults, on the model's background.
 * depth (H,W), or NULL, receives the camera z of the surface, in the scene's unit. It is the mean of the
 * layer, 4 % of the depth thick, whose Gaussians have the most of the pixel's weight, sum(alpha T), which is
 * at most 1. Where that layer has less than 1/3, another layer may be the surface: depth is -z. Where all
 * Gaussians together have less than 1/2, the model is see-through: depth is 0.
 * OXL_ERR_USAGE: the camera has no pixels. */
OXL_API oxl_result oxl_render(oxl_context *ctx, const oxl_model *model, const oxl_camera *camera,
                              const oxl_render_options *options, oxl_image *out, float *depth);

/* Renders a view of the scene as its image was taken: from its camera, on the model's background, or else
 * training's, with the pose, medium, lamp and gains that `imaging` has for it. depth as in oxl_render. */
OXL_API oxl_result oxl_render_view(oxl_context *ctx, const oxl_model *model, const oxl_scene *scene, int view,
                                   const oxl_imaging *imaging, oxl_image *out, float *depth);

/* Computes the gradient of a scalar loss L with respect to all parameters, given drgb = dL/d(image), (3,H,W):
 * the exact derivative of oxl_render. gradient is created with model's shape; options and errors are
 * oxl_render's. */
OXL_API oxl_result oxl_render_backward(oxl_context *ctx, const oxl_model *model, const oxl_camera *camera,
                                       const oxl_render_options *options, const float *drgb,
                                       oxl_model *gradient);

/* ---------------- metrics */

/* All metrics compare a render a with an image b over the pixels that b does not mask, clamped to 0..1.
 * OXL_ERR_USAGE: a and b differ in size; OXL_ERR_INPUT: no pixel counts (oxl_structure: NaN). */

/* PSNR: dB, peak 1; identical images give 100. */
OXL_API oxl_result oxl_psnr(oxl_context *ctx, const oxl_image *a, const oxl_image *b, double *out);
/* Colour-corrected PSNR, dB: each channel of a is first multiplied by its least-squares factor to b, so that
 * exposure and white balance are no error. */
OXL_API oxl_result oxl_cc_psnr(oxl_context *ctx, const oxl_image *a, const oxl_image *b, double *out);
/* SSIM [Wang 2004]: 11 x 11 Gaussian window, sigma 1.5 px, zero padding, C1 = 0.01^2, C2 = 0.03^2, mean over
 * the channels and the windows without a masked pixel. */
OXL_API oxl_result oxl_ssim(oxl_context *ctx, const oxl_image *a, const oxl_image *b, double *out);

/* Normalised correlation of the detail of a and b, whatever their brightness and contrast. Detail is the grey
 * image blurred by a Gaussian of 1 px, less the one blurred by 6 px. 1: the same structure; 0: none, such as
 * a veil; NaN: b has no more detail than the rounding to 8 bits. */
OXL_API oxl_result oxl_structure(oxl_context *ctx, const oxl_image *a, const oxl_image *b, double *out);
/* a view below this counts as one without structure */
#define OXL_STRUCTURE_NONE 0.5

/* A subset of the views. */
typedef enum oxl_split { OXL_SPLIT_TEST = 0, OXL_SPLIT_TRAIN, OXL_SPLIT_ALL } oxl_split;

typedef struct oxl_view_metrics {
    int view; /* index in the scene */
    double psnr, cc_psnr, ssim;
    double plain_psnr; /* PSNR of the render at mean exposure: without the image's exposure gains and lamp */
    /* of a held-out view, rendered from the pose at which its image fits best, where training refined poses;
     * else NaN */
    double aligned_psnr, aligned_ssim;
    double structure; /* of oxl_structure; NaN: the image has no detail */
    /* of a held-out view: share of its pixels whose place no training view shows, in the upper left, upper
     * right, lower left and lower right quarter; PSNR over the other pixels. 0, NaN: not measured */
    double unshown[4], shown_psnr;
} oxl_view_metrics;

typedef struct oxl_metrics {
    double psnr, cc_psnr, ssim, plain_psnr; /* means over the views; 0 without views */
    double aligned_psnr, aligned_ssim;      /* NaN: not measured */
    /* mean and minimum over the views whose images have detail; NaN: there is none */
    double structure, structure_least;
    /* mean of the sum over the quarters; mean of shown_psnr over the views that have it */
    double unshown, shown_psnr;
    int no_structure; /* views below OXL_STRUCTURE_NONE */
    int count;
    oxl_view_metrics *views; /* (count) */
} oxl_metrics;

/* Renders the views of the split as oxl_render_view does, and compares them with their images, on the model's
 * background; views whose image is not readable are logged and left out. imaging: that of the model.
 * OXL_ERR_USAGE: it belongs to a scene with another number of views; OXL_ERR_IO: too many images are
 * missing. */
OXL_API oxl_result oxl_evaluate(oxl_context *ctx, const oxl_model *model, const oxl_scene *scene,
                                const oxl_imaging *imaging, oxl_split split, oxl_metrics *out);
OXL_API void oxl_metrics_free(oxl_context *ctx, oxl_metrics *metrics);

/* ---------------- training */

/* Which Gaussians get a second, negative lobe, and so are differences of Gaussians [OceanXL eq. 3-4]. */
typedef enum oxl_dog {
    OXL_DOG_OFF = 0,
    /* those whose mean |dL/d(u, v)|, in half images, is above 0.0002 at 0.55 of the run */
    OXL_DOG_SELECTIVE,
    OXL_DOG_ALL
} oxl_dog;

/* Whether exposure, lamp, medium or poses are fitted (docs/UNDERWATER.md). */
typedef enum oxl_switch {
    OXL_OFF = 0,
    OXL_ON,
    /* on where the colours of tracks (points with the images that see them) show it. A scene from arrays has
     * no tracks: off. For poses see oxl_train_options */
    OXL_AUTO
} oxl_switch;

/* Sets of defaults: fast; longer; the paper's method. */
typedef enum oxl_preset { OXL_PRESET_DRAFT = 0, OXL_PRESET_STANDARD, OXL_PRESET_PAPER } oxl_preset;

/* How many Gaussians Wise Adaptive Pruning keeps [OceanXL sec. 3.2]. */
typedef enum oxl_keep_kind {
    OXL_KEEP_ALL = 0,
    OXL_KEEP_FRACTION, /* this fraction, 0..1 */
    OXL_KEEP_COUNT,    /* at most this number */
    OXL_KEEP_BYTES     /* as many as fit into a file of this size */
} oxl_keep_kind;
typedef struct oxl_keep {
    oxl_keep_kind kind;
    double value;
} oxl_keep;

/* Underwater-Compensated Densification: more Gaussians where water reduces contrast [OceanXL eq. 2]. */
typedef enum oxl_ucd {
    OXL_UCD_OFF = 0,
    OXL_UCD_ON,    /* gradient weights 1.5 and 2 of the mid and far third of depth */
    OXL_UCD_AUTO,  /* the same if the images' contrast falls with depth */
    OXL_UCD_SEARCH /* on, and corrected during training by SPSA */
} oxl_ucd;

/* What densification does with a Gaussian; OXL_KEEP_... are oxl_keep's, OXL_SPLIT_... oxl_split's. */
typedef enum oxl_change { OXL_REMOVE = 0, OXL_KEEP, OXL_SPLIT /* into two */ } oxl_change;

/* Terms of one's own in the loss, and a rule of density control. They run on the CPU only: with a device,
 * training fails with OXL_ERR_USAGE. A term returns its value, which is added to the loss, and adds its
 * gradient to the one that it is given; examples/ has one of each. A value that is not finite ends the run
 * with OXL_ERR_USAGE. Where a model for viewers is trained (oxl_trained), terms run there, too; the rule does
 * not. */
typedef struct oxl_terms {
    /* rendered: the step's view with its gains and lamp, not clamped; image: the one that it is compared
     * with. Their size changes from call to call: half the sides while the run is coarse, a part of the view
     * in blocks. drgb: (3,H,W) gradient with respect to rendered. NULL: no such term */
    double (*pixels)(void *user, const oxl_image *rendered, const oxl_image *image, float *drgb);
    /* gradient: planes of the model's shape. Gaussians that the view does not show take no step. NULL: no
     * such term. A row whose gradient is not finite is skipped (oxl_nonfinite.rows) */
    double (*parameters)(void *user, const oxl_model *model, oxl_model *gradient);
    /* Is called at each densification (densify_every), and rewrites the library's choice, change (count) of
     * oxl_change; other values keep the Gaussian. If max_gaussians limits splits, those with the largest
     * gradient / views are made, none with 0 views. gradient (count) sums |dL/d(u, v)| of the Gaussian's
     * centre, in half images, over the steps since the last densification that show the Gaussian; views
     * (count) is their number. ucd weights gradient by depth. NULL: no rule */
    void (*density)(void *user, const oxl_model *model, const float *gradient, const float *views,
                    uint8_t *change);
    void *user;
} oxl_terms;

/* Defaults are in parentheses: of all presets, or of draft, standard and paper. */
typedef struct oxl_train_options {
    int iterations; /* steps, one image each (1200, 3000, 40 000) */
    int sh_degree;  /* 0..3: final SH degree; -1: 3, in a job 1 where ram is short (-1, -1, 3) */
    /* most Gaussians; 0: one per point, but 1 to 2 per 60 training pixels, or up to 10 000 if that is more
     * (0) */
    int max_gaussians;
    double max_seconds; /* stop after this time, with the model so far; 0: no limit (0) */
    /* red, green, blue, 0..1; -1,-1,-1: white where transparent images are composited over it, else black
     * (-1,-1,-1) */
    float background[3];
    /* w in the loss (1 - w) L1 + w (1 - SSIM), means over the unmasked pixels [Kerbl 2023] (0.3, 0.2, 0.2) */
    float ssim_weight;
    /* first fraction of the run, which trains at half resolution; -1: 0.75 from 640 px on the longer side
     * (-1, 0, 0) */
    float coarse;
    /* Fraction of the Gaussians that a step leaves out [Park 2025], rising from 0 to this during the run. -1:
     * 0, except below 30 training views and 4.6 images per point: there 0 up to 30 steps per view, and from
     * there to 60 rising to 0.4 (-1) */
    float dropout;
    /* as in oxl_render_options, in the first 0.8 of the run; at most 0.05 (1/128, 1/128, 1/255) */
    float alpha_min;
    /* Learning rates are those of [Kerbl 2023]. This one is for positions at the first step, in extents
     * (oxl_scene_extent), and decays exponentially (0.00016) */
    float lr_position;
    float lr_position_final; /* learning rate of positions at the last step, in extents (0.0000016) */
    float lr_scale;          /* learning rate of log scales (0.005) */
    float lr_rotation;       /* learning rate of quaternions (0.001) */
    float lr_sh0;            /* learning rate of SH degree 0 (0.0025) */
    float lr_sh;             /* learning rate of higher SH degrees (0.0025 / 20) */
    /* An exponent e: runs of n < 30 000 steps multiply the rates of positions, scales and rotations by
     * (30 000 / n)^e. docs/METHOD.md ("Short runs") has what else it changes. 0: nothing (0.45, 0.45, 0) */
    float short_run_exponent;
    /* last fraction of the run, in which all learning rates fall to a tenth; 0: none (0.2) */
    float cooldown;
    float densify_until; /* fraction of the run that densifies; with dog, below 0.55 (0.5) */
    /* steps between densifications; -1: a tenth of the run, 15 to 50 (-1, 100, 100). docs/METHOD.md has the
     * first one */
    int densify_every;
    /* Gaussians are split whose mean |dL/d(u, v)|, in half images, is at least this (transparent images
     * without points: 0.0002 at most); after 3000 steps or a tenth of the run, whichever is more, those above
     * 0.1 extents, too (0.00055, 0.0002, 0.0002) */
    float densify_gradient;
    oxl_ucd ucd;         /* depth weights of densify_gradient's mean (AUTO, AUTO, SEARCH) */
    oxl_keep keep;       /* Gaussians that pruning keeps (ALL, ALL, FRACTION 0.5) */
    oxl_switch exposure; /* a log gain per channel and training image (AUTO) */
    /* a light that moves with the camera, or vignetting: a smooth gain over the image (AUTO) */
    oxl_switch lamp;
    /* a medium of nine parameters between camera and Gaussians; ON: as AUTO, with a warning if off (AUTO) */
    oxl_switch medium;
    /* training views' poses are refined with the scene, on the CPU alone; AUTO: they are kept if
     * images shift by 0.2 px (OFF) */
    oxl_switch poses;
    /* 1: the model is trained with oxl_model.antialias (1, 1, 0) */
    int antialias;
    /* 1: starts also from points of depth maps, which are computed from the training images (1, 1, 0) */
    int stereo;
    oxl_dog dog;            /* second lobes (OFF, OFF, SELECTIVE) */
    const oxl_terms *terms; /* NULL: none. A resumed job does not notice changed ones */
    /* for oxl_train: Gaussians to start from, copied without second lobes; NULL: the scene's points. Their
     * colours are taken as those of a scene.ply (oxl_trained_write), since imaging is measured anew. Rates
     * and schedule are those of a fresh run */
    const oxl_model *from;
    /* for a block: steps of the whole run, from which rates and intervals follow; 0: `iterations` */
    int survey_iterations;
    float experimental[4]; /* values of options that are tried out: CONTRIBUTING, "An idea of your own" */
} oxl_train_options;

OXL_API oxl_train_options oxl_train_options_default(oxl_preset preset);
/* OXL_ERR_USAGE: a value is out of its range; the text names the first such option. */
OXL_API oxl_result oxl_train_options_check(oxl_context *ctx, const oxl_train_options *options);

/* What a run skipped or cleared because a value was not finite, and images that could not be read. All 0 in
 * a normal run. */
typedef struct oxl_nonfinite {
    size_t images;  /* could not be read: left out */
    size_t steps;   /* loss not finite: skipped */
    size_t rows;    /* updates of single Gaussians with a gradient that was not finite: skipped */
    size_t cleared; /* Gaussians with a value that was not finite: hidden, removed at the end */
} oxl_nonfinite;

/* A job in blocks trains a coarse model of the survey, its blocks, and the model merged from them. */
enum oxl_stage { OXL_STAGE_BLOCK, OXL_STAGE_COARSE, OXL_STAGE_MERGED };

typedef struct oxl_progress {
    /* iterations done, and the total, which grows when the training of oxl_trained.viewer begins */
    int iteration, iterations;
    int block, blocks;    /* index and number of blocks in a job; else 0, 0 */
    enum oxl_stage stage; /* what is trained; with OXL_STAGE_BLOCK, block number `block` */
    size_t gaussians;
    double loss, psnr;   /* running means over training images */
    double seconds;      /* since the start */
    double seconds_left; /* predicted; 0: the run ends, or not known yet */
    size_t memory;       /* peak so far, bytes; only in a job, else 0 */
    /* valid during the call; that of a device may be some steps old */
    const oxl_model *model;
    oxl_nonfinite nonfinite; /* so far */
} oxl_progress;

typedef struct oxl_callback {
    /* Called after every iteration; a nonzero result stops the run (OXL_ERR_INTERRUPTED) */
    int (*progress)(void *user, const oxl_progress *progress);
    void *user; /* passed to progress */
} oxl_callback;

/* Result of a training. */
typedef struct oxl_trained {
    oxl_model model;      /* with `imaging` it gives the scene's images */
    oxl_imaging *imaging; /* not NULL in a result */
    /* for viewers that know neither second lobes nor imaging; count 0: they show `model` */
    oxl_model viewer;
    char *decisions; /* members of a JSON object: what was decided by measurement, and the evidence */
    int iterations;  /* iterations that `model` was trained for */
    int finished;    /* 0: stopped by max_seconds or the callback */
    double seconds;
    oxl_nonfinite nonfinite;
} oxl_trained;

/* Trains a model on the scene's training views, as the command `oceanxl train` does with a survey of one
 * block, except that the command fits the iterations to the number of images
 * (oxl_job_options.iterations_for). The same scene, options and seed give the same bytes. callback may be
 * NULL.
 * OXL_ERR_USAGE: an option is out of its range; OXL_ERR_INPUT: no training image can be read;
 * OXL_ERR_FAILED: no Gaussian is left; OXL_ERR_INTERRUPTED: stopped; out is usable if out->model.count is
 * not 0. */
OXL_API oxl_result oxl_train(oxl_context *ctx, const oxl_scene *scene, const oxl_train_options *options,
                             const oxl_callback *callback, oxl_trained *out);
OXL_API void oxl_trained_free(oxl_context *ctx, oxl_trained *trained);
/* Writes the result to a folder, which must exist, as `oceanxl train` does. It deletes any of these files
 * in the folder that the result does not have:
 *   scene.ply           the model, for most viewers
 *   scene_clear.ply     the model without the medium or gains that scene.ply has in its colours
 *   scene_standard.ply  for any viewer, where scene.ply has second lobes or an SH degree below 3
 *   imaging.txt         exposure, lamp, medium and poses
 * To read the result back for a scene, read scene_clear.ply if it is there, else scene.ply, and
 * oxl_imaging_read of that path.
 * OXL_ERR_USAGE: the result has no Gaussian, or its imaging is of a scene with another number of views;
 * OXL_ERR_IO: a file cannot be written. */
OXL_API oxl_result oxl_trained_write(oxl_context *ctx, const char *folder, const oxl_scene *scene,
                                     const oxl_trained *trained);

/* ---------------- a loop of one's own */

/* For each step: oxl_render, a loss and its gradient, oxl_render_backward, oxl_adam_step. */
typedef struct oxl_adam {
    float rate[OXL_PLANES]; /* learning rate of each plane at this step */
    double beta[2];         /* decay of the first and second moment */
    int step;               /* from 1, for bias correction */
} oxl_adam;
/* Returns the rates that oxl_train has at a step of a run with these options, as if each view showed each
 * Gaussian. */
OXL_API oxl_adam oxl_adam_at(const oxl_scene *scene, const oxl_train_options *options, int step);
/* Moves the Gaussians that have a gradient by a step of Adam (Kingma & Ba 2015), as oxl_train does. moments:
 * two zeroed structs before the first step, which allocates them; free both with oxl_model_free. A row with a
 * value or gradient that is not finite stays. OXL_ERR_USAGE: the shapes differ. */
OXL_API oxl_result oxl_adam_step(oxl_context *ctx, oxl_model *model, const oxl_model *gradient,
                                 oxl_model moments[2], const oxl_adam *adam);

#ifdef __cplusplus
}
#endif
#endif
