/* internal.h - what the modules share: the context, errors, memory, and one section for each module's door.
 *
 * Names: oxl_* is public (oceanxl.h); OXL_INTERNAL functions carry their module's name and may be called by other modules;
 * what is plain static stays in its file. In the single translation unit OXL_INTERNAL is static; built module by module
 * (OXL_MODULES) it is extern, which shows that every dependency is declared here.
 */
#ifndef OXL_INTERNAL_H
#define OXL_INTERNAL_H

/* src/os.c needs POSIX by name under -std=c99, and the first system header decides: so internal.h comes before any. */
#if !defined(_WIN32) && !defined(_POSIX_C_SOURCE)
#define _POSIX_C_SOURCE 200809L
#endif
#if !defined(_WIN32) && !defined(_FILE_OFFSET_BITS)
#define _FILE_OFFSET_BITS 64 /* on 32-bit machines too: files past 2 GB, folders of file systems with large offsets */
#endif
#if defined(__MINGW32__) && !defined(__USE_MINGW_ANSI_STDIO)
#define __USE_MINGW_ANSI_STDIO 1 /* printf as C99 has it: %zu */
#endif
#if defined(__APPLE__) && !defined(_DARWIN_C_SOURCE)
#define _DARWIN_C_SOURCE /* ru_maxrss */
#endif

#include "../oceanxl.h"

#include <float.h>
#include <limits.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifdef _OPENMP
#include <omp.h>
#endif

#if defined(OXL_MODULES)
#define OXL_INTERNAL
#elif defined(__GNUC__)
#define OXL_INTERNAL static __attribute__((unused)) /* some doors are used by the tests or the benchmark alone */
#else
#define OXL_INTERNAL static
#endif

#define OXL_COUNT(array) (sizeof(array) / sizeof *(array))
#define OXL_MIN(a, b)    ((a) < (b) ? (a) : (b))
#define OXL_MAX(a, b)    ((a) > (b) ? (a) : (b))
#define OXL_SWAP(type, a, b)          \
    do {                              \
        type const swapped = (a);     \
        (a)                = (b);     \
        (b)                = swapped; \
    } while (0)
#define OXL_CLAMP(x, lo, hi) ((x) < (lo) ? (lo) : (x) > (hi) ? (hi) : (x))

/* ---------------------------------------------------------------- context.c: context, errors, memory, text, random numbers */

struct oxl_context {
    oxl_context_options options;
    int                 threads; /* resolved: at least 1 */
    int                 isa;     /* enum isa of simd.h */
    struct vulkan      *vulkan;  /* the device that draws; NULL: the CPU does */
    char                error[1024];
    struct text        *notes;  /* lines of the log are kept here too, as elements of a JSON array; NULL: they are not */
    oxl_result          failed; /* what `error` is about: for doors that return a pointer or NULL */
};

OXL_INTERNAL int base_thread(void); /* which of a parallel region's threads this is, from 0 */

/* For a thread beside others: a context of its own, with memory from ctx. It logs nothing, and its errors stay with it. */
OXL_INTERNAL oxl_context base_apart(oxl_context *ctx);

/* All memory goes through these; NULL when the allocator refuses or count x size overflows. Aligned to 64 bytes. */
OXL_INTERNAL void *oxl_alloc(oxl_context *ctx, size_t count, size_t size);
OXL_INTERNAL void *oxl_calloc(oxl_context *ctx, size_t count, size_t size);
/* Keeps min(old, new) elements; on failure `old` stays valid. */
OXL_INTERNAL void *oxl_regrow(oxl_context *ctx, void *old, size_t old_count, size_t new_count, size_t size);
OXL_INTERNAL void  oxl_free(oxl_context *ctx, void *memory);

/* Grows *array so that it holds at least `needed` elements; *capacity is doubled. */
OXL_INTERNAL oxl_result oxl_reserve(oxl_context *ctx, void **array, size_t *capacity, size_t needed, size_t size);

#if defined(__MINGW32__)
#define OXL_PRINTF(at, first) __attribute__((format(gnu_printf, at, first)))
#elif defined(__GNUC__)
#define OXL_PRINTF(at, first) __attribute__((format(printf, at, first)))
#else
#define OXL_PRINTF(at, first)
#endif

/* Stores the text and returns rc: `return oxl_fail(ctx, OXL_ERR_INPUT, "%s:%d: ...", path, line);`
 * A second line that starts with "fix: " says what to do. */
OXL_INTERNAL oxl_result oxl_fail(oxl_context *ctx, oxl_result rc, const char *format, ...) OXL_PRINTF(3, 4);
OXL_INTERNAL void       oxl_log(oxl_context *ctx, oxl_log_level level, const char *format, ...) OXL_PRINTF(3, 4);

/* Text that grows. Failure to grow is remembered in `failed` and tested once, at the end. */
struct text {
    oxl_context *ctx;
    char        *data; /* always terminated once something was added; NULL before */
    size_t       size, capacity;
    int          failed;
};
OXL_INTERNAL void       text_add(struct text *t, const char *format, ...) OXL_PRINTF(2, 3);
OXL_INTERNAL void       text_add_json_string(struct text *t, const char *s); /* quoted and escaped */
OXL_INTERNAL void       text_add_number(struct text *t, double value);       /* shortest that reads back; null when not finite */
OXL_INTERNAL void       text_free(struct text *t);
/* Hands the text over as fresh memory and empties t; OXL_ERR_MEMORY when it had failed to grow. */
OXL_INTERNAL oxl_result text_take(struct text *t, char **out);

/* The text of a copy, or NULL. */
OXL_INTERNAL char *oxl_strdup(oxl_context *ctx, const char *s);
/* "a/b" in fresh memory; a may be "" or end in a slash. */
OXL_INTERNAL char *oxl_path_join(oxl_context *ctx, const char *a, const char *b);

/* ---------------------------------------------------------------- backend.c: which machine draws */

/* Opens the device that the context's options ask for, once; NULL, and OXL_OK: the CPU it is. */
OXL_INTERNAL oxl_result backend_begin(oxl_context *ctx);
OXL_INTERNAL void       backend_end(oxl_context *ctx);

/* ---------------------------------------------------------------- number.c: fast, exact, locale-independent number parsing */

/* One decimal number at *cursor, independent of the locale, correct to the last bit as strtod in the C locale; 0 when there is
 * none. Takes signs, exponents, nan and inf in the usual spellings ("-nan(ind)" too). *cursor moves past it. */
OXL_INTERNAL int parse_double(const char **cursor, const char *end, double *out);
OXL_INTERNAL int parse_int64(const char **cursor, const char *end, int64_t *out);

/* The value as %.17g writes it in the "C" locale, which reads back exactly; returns the length. */
enum { NUMBER_TEXT_MAX = 48 };
OXL_INTERNAL size_t format_double(char out[NUMBER_TEXT_MAX], double value);
OXL_INTERNAL size_t format_int64(char out[NUMBER_TEXT_MAX], int64_t value);

/* ---------------------------------------------------------------- context.c again: random numbers */

/* A stateless random number: the same (seed, a, b) gives the same value on every machine (splitmix64's finaliser). */
OXL_INTERNAL uint64_t random_bits(uint64_t seed, uint64_t a, uint64_t b);
OXL_INTERNAL double   random_unit(uint64_t bits); /* [0,1), 53 bits */

/* ---------------------------------------------------------------- os.c: what C99 lacks; the one file to port */

struct os_file_map { /* a whole file in memory, read-only; one zero byte follows */
    const char *data;
    size_t      size;
};
OXL_INTERNAL oxl_result os_read_file(oxl_context *ctx, const char *path, struct os_file_map *out);
/* Of a file that does not begin so, a few bytes alone. */
OXL_INTERNAL oxl_result os_read_file_like(oxl_context *ctx, const char *path, const char *start, struct os_file_map *out);
OXL_INTERNAL void       os_release_file(oxl_context *ctx, struct os_file_map *map);

/* A file piece by piece. `path` is borrowed. */
struct os_reader {
    FILE       *file;
    const char *path;
    uint64_t    size; /* a hint: a pipe has none, and a file may grow */
};
OXL_INTERNAL oxl_result os_reader_open(oxl_context *ctx, const char *path, struct os_reader *out);
OXL_INTERNAL oxl_result os_reader_read(oxl_context *ctx, struct os_reader *r, void *data, size_t size,
                                       size_t *got); /* *got < size: the end */
OXL_INTERNAL oxl_result os_reader_seek(oxl_context *ctx, struct os_reader *r, uint64_t offset);
OXL_INTERNAL void       os_reader_close(struct os_reader *r);

/* Whole or not at all: temporary name in the same folder, write, fsync, rename, fsync of the folder. */
OXL_INTERNAL oxl_result os_write_file(oxl_context *ctx, const char *path, const void *data, size_t size);
/* Removes what a killed process left in a folder of files that it was writing. Nobody else may be writing there. */
OXL_INTERNAL oxl_result os_sweep(oxl_context *ctx, const char *folder);

/* The same for a file that is produced piece by piece. */
struct os_writer {
    FILE *file;
    char *path, *temporary;
    int   error; /* errno of os_writer_sync */
};
OXL_INTERNAL oxl_result os_writer_open(oxl_context *ctx, const char *path, struct os_writer *out);
OXL_INTERNAL void       os_writer_sync(struct os_writer *writer); /* waits for the disk; a failure is told by os_writer_close */
OXL_INTERNAL oxl_result os_writer_close(oxl_context *ctx, struct os_writer *writer, oxl_result rc); /* rc != OXL_OK: discard */

OXL_INTERNAL FILE *os_open(const char *path, const char *mode);
OXL_INTERNAL int   os_rename(const char *from, const char *to); /* over what `to` was; 0: done */
OXL_INTERNAL int   os_remove(const char *path);                 /* 0: done */

#ifdef OXL_VULKAN
/* A library that is loaded at run time; NULL: there is none of that name. */
OXL_INTERNAL void *os_library_open(const char *name);
OXL_INTERNAL void  os_library_symbol(void *library, const char *name, void *out, size_t size); /* out: a function pointer */
OXL_INTERNAL void  os_library_close(void *library);
#endif

OXL_INTERNAL oxl_result os_make_folder(oxl_context *ctx, const char *path); /* with its parents; there already: fine */
/* A symbolic link at `path` to the folder `target`, in place of an older link but of nothing else; 0: none could be made. */
OXL_INTERNAL int        os_link(oxl_context *ctx, const char *target, const char *path);
OXL_INTERNAL int        os_is_file(const char *path);
OXL_INTERNAL int        os_is_folder(const char *path);
OXL_INTERNAL double     os_seconds(void);     /* monotonic clock */
OXL_INTERNAL size_t     os_peak_rss(void);    /* bytes; 0 when unknown */
OXL_INTERNAL size_t     os_memory_free(void); /* bytes that can be taken without swapping; 0 when unknown */
/* Calls `visit` with the name of each entry of a folder, in no order. */
OXL_INTERNAL oxl_result os_list_folder(oxl_context *ctx, const char *path, void (*visit)(void *user, const char *name),
                                       void *user);

/* ---------------------------------------------------------------- colmap.c: the three text files, as they are */

struct colmap_camera {
    int64_t id;
    int     model; /* index in camera.c's table */
    int     width, height;
    int     parameter_count;
    double  parameter[12];
    int     line; /* in cameras.txt, for messages */
};

struct colmap_observation {
    double  x, y;  /* px */
    int64_t point; /* POINT3D_ID, -1: none */
};

struct colmap_image {
    int64_t  id;
    double   rotation[4]; /* w x y z as read */
    double   translation[3];
    int64_t  camera_id;
    size_t   name;              /* offset in colmap.names */
    size_t   first_observation; /* in colmap.observation */
    size_t   observation_count;
    uint64_t points_at;   /* where the text of its 2D points lies in images.txt: exports copy it */
    size_t   points_size; /* bytes; 0: none */
    int      line;
};

struct colmap_track {   /* one (IMAGE_ID, POINT2D_IDX); small: a large survey has a hundred million */
    uint32_t image_row; /* in colmap.image */
    uint32_t observation;
};

struct colmap_point {
    int64_t  id;
    double   position[3]; /* world */
    double   error;       /* px; -1: unknown */
    uint8_t  rgb[3];
    uint32_t track_count;
    size_t   first_track; /* in colmap.track */
};

struct colmap {
    struct colmap_camera      *camera;
    size_t                     camera_count;
    struct colmap_image       *image; /* in the file's order */
    size_t                     image_count;
    struct colmap_observation *observation;
    size_t                     observation_count;
    struct colmap_point       *point; /* in the file's order */
    size_t                     point_count;
    struct colmap_track       *track;
    size_t                     track_count;
    char                      *folder;
    char                      *names; /* zero-terminated, one after the other */
    size_t                     names_size;
    size_t                     warnings; /* oddities that were mended and logged */
};

/* Reads cameras.txt, images.txt and points3D.txt of a folder; colmap.c says what is promised of them. keep_observations = 0
 * skips the 2D points. */
OXL_INTERNAL oxl_result colmap_read(oxl_context *ctx, const char *folder, int keep_observations, struct colmap *out);
/* The same through a window on the files of another size, in bytes: for tests. */
OXL_INTERNAL oxl_result colmap_read_in_windows(oxl_context *ctx, const char *folder, int keep_observations, size_t window,
                                               struct colmap *out);
/* colmap_write.c: numbers as %.17g writes them. */
OXL_INTERNAL oxl_result colmap_write(oxl_context *ctx, const char *folder, const struct colmap *c);
OXL_INTERNAL void       colmap_free(oxl_context *ctx, struct colmap *c);

/* ---------------------------------------------------------------- camera.c: camera models, undistortion */

enum camera_kind { CAMERA_IDEAL, CAMERA_RADIAL, CAMERA_OPENCV, CAMERA_FULL_OPENCV, CAMERA_FISHEYE };

struct camera_model {
    const char      *name;
    int              parameter_count; /* focal lengths, cx, cy, then the distortion */
    int              focal_count;     /* 1: f; 2: fx, fy */
    enum camera_kind kind;
};
OXL_INTERNAL int                        camera_model_find(const char *name, size_t length); /* -1: unknown */
OXL_INTERNAL const struct camera_model *camera_model_at(int index);
OXL_INTERNAL const char                *camera_model_list(void); /* "SIMPLE_PINHOLE, PINHOLE, ..." for messages */

/* fx, fy, cx, cy in px, whatever the model. */
OXL_INTERNAL void camera_intrinsics(const struct colmap_camera *camera, double out[4]);

/* Forward model: a direction (x/z, y/z) of the ideal camera to a pixel of the real one. */
OXL_INTERNAL void camera_distort(const struct colmap_camera *camera, const double direction[2], double pixel[2]);
OXL_INTERNAL int  camera_is_distorted(const struct colmap_camera *camera);

/* The ideal pinhole camera whose every pixel the real one saw (no blank pixels), same focal length, before --max-side. */
OXL_INTERNAL oxl_result camera_undistorted(oxl_context *ctx, const struct colmap_camera *camera, oxl_camera *out);

/* The same view at half the sides, rounded down. */
OXL_INTERNAL oxl_camera camera_halve(const oxl_camera *camera);

OXL_INTERNAL void camera_rotation_from_quaternion(const double q[4], double r[9]); /* normalises */
OXL_INTERNAL void camera_position(const oxl_camera *camera, double out[3]);        /* -R^T t */

/* ---------------------------------------------------------------- image.c: decode, reduce, undistort, mask, cache */

struct pixels { /* 8 bits, interleaved as stb gives them */
    int      width, height, channels;
    uint8_t *data;
};
OXL_INTERNAL oxl_result image_decode(oxl_context *ctx, const char *path, int channels, struct pixels *out);
OXL_INTERNAL oxl_result image_size(oxl_context *ctx, const char *path, int *width, int *height); /* header alone */
/* Fails unless a file of so many pixels may be the camera's, reduced or enlarged: not cropped or turned. */
OXL_INTERNAL oxl_result image_check_shape(oxl_context *ctx, const char *path, int width, int height,
                                          const struct colmap_camera *from);
OXL_INTERNAL void       image_pixels_free(oxl_context *ctx, struct pixels *p);

/* A training photograph: planar 8-bit (3,H,W), and its mask (H,W) or NULL (255 counts, 0 masked). */
struct photo {
    int      width, height;
    uint8_t *rgb;
    uint8_t *mask;
};
/* Decodes, undistorts (when `from` is distorted) and reduces by area averaging to `to`'s size, masks alike. mask_path may be NULL. */
OXL_INTERNAL oxl_result image_load_photo(oxl_context *ctx, const char *path, const char *mask_path,
                                         const struct colmap_camera *from, const oxl_camera *to, struct photo *out);
OXL_INTERNAL void       image_photo_free(oxl_context *ctx, struct photo *photo);
OXL_INTERNAL void       image_from_photo(const oxl_context *ctx, const struct photo *photo, float *rgb,
                                         float *weight); /* weight may be NULL */
/* (3,H,W) and (H,W) or NULL to half the sides, in place: means of 2 x 2 pixels, that count when all four do; an odd last row or column
 * is dropped. */
OXL_INTERNAL void       image_halve(int width, int height, float *rgb, float *weight);
/* The other way, into memory that photo has already; weight of 0.5 and less is masked. */
OXL_INTERNAL void       image_to_photo(const oxl_image *image, struct photo *photo);

OXL_INTERNAL void       image_begin(void); /* with each context: how stb writes PNGs */
/* Encoded in memory by stb, written by os_write_file. rgb (3,H,W). */
OXL_INTERNAL oxl_result image_write_png(oxl_context *ctx, const char *path, const float *rgb, int width, int height);
OXL_INTERNAL oxl_result image_write_png16(oxl_context *ctx, const char *path, const uint16_t *grey, int width, int height);

/* ---------------------------------------------------------------- survey_files.c: where a survey's files are */

/* Reads the sub-model with most images: of `sparse`, or of SCENE/sparse, the folders in it, and SCENE. Observations are not kept. */
OXL_INTERNAL oxl_result  find_model(oxl_context *ctx, const char *path, const char *sparse, struct colmap *out);
/* Path of a file at most 3 folders deep that is called like `name` but for folder, extension and capitals; "" when there is none. */
OXL_INTERNAL void        find_like(oxl_context *ctx, const char *folder, const char *name, char *out, size_t size);
OXL_INTERNAL const char *find_base_name(const char *path); /* what follows the last slash */

/* ---------------------------------------------------------------- robust_stats.c: robust measures of a survey */

struct measure_view {            /* a training view */
    uint32_t          image_row; /* in colmap.image, for tracks */
    const oxl_camera *camera;
};
OXL_INTERNAL double     measure_quantile(const double *ascending, size_t count, double quantile); /* nearest rank; 0 of none */
OXL_INTERNAL double     measure_pick(double *value, size_t count, double quantile); /* the same; they lie in another order then */
/* 1st, 50th and 99th percentile of each coordinate of n positions that lie `stride` bytes apart. */
OXL_INTERNAL oxl_result measure_bounds(oxl_context *ctx, const double *position, size_t n, size_t stride, double low[3],
                                       double middle[3], double high[3]);
/* Largest distance from the mean of the camera centres, those left out that stand farther than 5 median distances from their
 * median place (coordinate by coordinate): exactly 3DGS's when there is no such outlier. 0 for one camera. */
OXL_INTERNAL oxl_result measure_camera_radius(oxl_context *ctx, const struct measure_view *views, size_t count, double *radius);
/* An ascending sample of the depths (camera z) of points in the views that saw them by their tracks, or, when there are no
 * tracks (from arrays: points alone), in the views that have them in their picture. Sorts views by image. */
OXL_INTERNAL oxl_result measure_depths(oxl_context *ctx, struct measure_view *views, size_t count, const oxl_point *points,
                                       size_t n, const struct colmap *c, const double origin[3], double **out, size_t *out_count);

/* ---------------------------------------------------------------- scene.c: from the files to views, points and photographs */

struct scene_stats { /* what check and the first message say */
    int    images_listed, images_missing, views, test_views, distorted_cameras, masks;
    size_t points, observations; /* observations: a point seen in an image */
    double mean_track, mean_error;
    double bounds_min[3], bounds_max[3]; /* local, 1st..99th percentile */
};
OXL_INTERNAL const struct scene_stats   *scene_stats_of(const oxl_scene *scene);
OXL_INTERNAL const struct colmap        *scene_colmap(const oxl_scene *scene); /* NULL for scenes from arrays */
/* Of a scene from files: where a view comes from, and whether a point is one of the scene's or absurdly far from its origin. */
OXL_INTERNAL const struct colmap_camera *scene_source_camera(const oxl_scene *scene, int view);
OXL_INTERNAL const char                 *scene_images_folder(const oxl_scene *scene);
OXL_INTERNAL const char                 *scene_masks_folder(const oxl_scene *scene); /* NULL: there is none */
OXL_INTERNAL const struct colmap_image  *scene_source_image(const oxl_scene *scene, int view);
OXL_INTERNAL oxl_result scene_mask_path(oxl_context *ctx, const oxl_scene *scene, const char *name, char **out); /* NULL: none */
OXL_INTERNAL int        scene_takes_point(const struct colmap_point *point, const double origin[3]);
OXL_INTERNAL int        scene_views_of(const oxl_scene *scene, oxl_split split, int *view); /* (all views at most) -> how many */
OXL_INTERNAL struct photos *scene_photos(oxl_scene *scene);
OXL_INTERNAL void   scene_set_cache(oxl_scene *scene, size_t bytes); /* of decoded photographs; from arrays: nothing is dropped */
OXL_INTERNAL double scene_file_pixels(const oxl_scene *scene, int view); /* of its camera's first photograph; 0: from arrays */
/* From the files, undistorted, reduced and masked as the view is; free it with image_photo_free. */
OXL_INTERNAL oxl_result scene_load_photo(oxl_context *ctx, const oxl_scene *scene, int view, struct photo *out);
/* Depth (camera z) of the scene's points over the training views: the given quantile. */
OXL_INTERNAL double     scene_depth_quantile(const oxl_scene *scene, double quantile);
/* Where cameras start to see, in the scene's unit: COLMAP's scale is arbitrary, so 3DGS's 0.2 cannot be. */
OXL_INTERNAL double     scene_near_plane(const oxl_scene *scene);
/* For a scene that has none: points in front of the cameras, the same for the same seed. Free them with oxl_free. */
OXL_INTERNAL oxl_result scene_random_points(oxl_context *ctx, const oxl_scene *scene, size_t count, oxl_point **out);

/* ---------------------------------------------------------------- imaging.c: what lies between the scene's colours and an image */

#define EXPOSURE_LEAST 0.05               /* gains lie between this and its inverse */
struct medium {                           /* c' = J exp(-direct r) + veil (1 - exp(-scatter r)), r: range */
    int   on;                             /* 0: clear */
    float direct[3], scatter[3], veil[3]; /* per unit of the scene, per unit, 0..1 */
};
struct imaging {
    struct medium medium;
    int           on;       /* 0: gains are 1 */
    int           views;    /* of the scene */
    float        *log_gain; /* (views,3) */
    uint8_t      *known;    /* (views) 1: it was trained on; the others are interpolated */
};
OXL_INTERNAL oxl_result imaging_create(oxl_context *ctx, int views, struct imaging *out); /* off, none known */
OXL_INTERNAL void       imaging_free(oxl_context *ctx, struct imaging *m);
OXL_INTERNAL void       imaging_copy(const struct imaging *from, struct imaging *to);
OXL_INTERNAL void       imaging_clear(struct imaging *m);
OXL_INTERNAL void       imaging_between(const struct imaging *m, int view, float log_gain[3]); /* as if it were not known */
OXL_INTERNAL void       imaging_gain(const struct imaging *m, int view, float gain[3]);
OXL_INTERNAL double     imaging_mean(const struct imaging *m, int channel);           /* log gain, of the known views */
OXL_INTERNAL void imaging_apply(const struct imaging *m, int view, oxl_image *image); /* what is rendered at mean exposure */
OXL_INTERNAL void imaging_centre(struct imaging *m, const double mean[3]);            /* the known views get this mean */
OXL_INTERNAL oxl_result imaging_write(oxl_context *ctx, const char *path, const oxl_scene *scene, const struct imaging *m);
/* Images that the scene has not are passed over. */
OXL_INTERNAL oxl_result imaging_read(oxl_context *ctx, const char *path, const oxl_scene *scene, struct imaging *out);
OXL_INTERNAL void imaging_join(struct imaging *all, int *count, const struct imaging *block, double shift[3]); /* of blocks */
OXL_INTERNAL struct imaging *scene_imaging(oxl_scene *scene); /* of the model that was trained on it, or read for it */

/* ---------------------------------------------------------------- image_cache.c: which photographs are in memory */

struct photos {
    struct photo *photo; /* (count) rgb NULL: not in memory */
    uint64_t     *used;  /* (count) when it was last asked for */
    uint64_t      clock;
    int           count;
    size_t        held, limit; /* bytes in memory; of the cache */
};
OXL_INTERNAL oxl_result          photos_begin(oxl_context *ctx, size_t count, struct photos *out); /* none in memory, no limit */
OXL_INTERNAL void                photos_free(oxl_context *ctx, struct photos *photos);
/* Borrowed until the next call for another view or for photographs ahead; NULL: with the error set. */
OXL_INTERNAL const struct photo *photos_get(oxl_context *ctx, oxl_scene *scene, int view);
/* Reads photographs that will be asked for next, in that order, one on each thread, when the first of them is not in memory. A
 * quarter of the cache may be on its way, and is made free before. Nothing is said of one that cannot be read, until it is asked for. */
OXL_INTERNAL void                photos_ahead(oxl_context *ctx, oxl_scene *scene, const int *view, int count);
/* Photographs of so many pixels in all, without masks, take at most so much, with what decoding files of file_pixels takes, on however many threads. */
OXL_INTERNAL double              photos_bytes(double cache, double pixels, double file_pixels);

/* ---------------------------------------------------------------- depth_bands.c: near, mid or far, pixel by pixel, by the survey's points */

struct bands_sight { /* a point in a view */
    int   view, pixel;
    float z; /* camera z */
};
struct bands {
    double              depth[2]; /* a third of the times that a point is seen in training, it lies nearer, and a third beyond */
    struct bands_sight *sight;    /* (count) by view and pixel, the nearer first */
    size_t              count;
};
/* Of `count` views asked for. */
OXL_INTERNAL oxl_result bands_begin(oxl_context *ctx, const oxl_scene *scene, const int *asked, int count, struct bands *out);
OXL_INTERNAL void       bands_free(oxl_context *ctx, struct bands *b);
/* band: (H,W) 1 near, 2 mid, 3 far; 0: no point tells. */
OXL_INTERNAL oxl_result bands_of_view(oxl_context *ctx, const struct bands *b, const oxl_scene *scene, int view, uint8_t *band);

/* ---------------------------------------------------------------- partition.c: balanced blocks of a survey */

struct partition_box { /* half-open, low <= x < high, in the partition's frame; outer faces are infinite */
    double low[3], high[3];
};
struct partition_block {
    struct partition_box box;      /* its home: every place belongs to exactly one block */
    struct partition_box expanded; /* wider by 5 % of its size on each side: what is trained */
    struct partition_box finite;   /* the home cut at the trimmed extents of the points: what is drawn, and its size */
    size_t               points, start_points;     /* at home; to start from: those in `expanded` and what its views see */
    int                  base_views, border_views; /* training views by overlap [OceanXL sec. 3.1, BlockGaussian] */
};
struct partition {
    double                  rotation[9]; /* rows: the principal axes, longest first; frame = R (world - origin) */
    double                  origin[3];   /* world */
    double                  extent[3];   /* l1 >= l2 >= l3, trimmed */
    int                     dimensions;  /* 2: the third axis is never cut; 3 */
    int                     block_count;
    struct partition_block *block;
    struct partition_plan  *plan; /* which point and view is where, for the export; NULL when read from partition.txt */
};
OXL_INTERNAL void partition_to_frame(const struct partition *p, const double world[3], double out[3]);
OXL_INTERNAL int  partition_contains(const struct partition_box *box, const double frame[3]);

/* Cuts a scene from files into blocks; the scene must outlive the partition. One block when it is small enough, when the options ask for
 * it, or when there are no tracks to tell what a view sees; the log says which, and on what evidence 2D or 3D was chosen. */
OXL_INTERNAL oxl_result partition_make(oxl_context *ctx, const oxl_scene *scene, const oxl_partition_options *options,
                                       struct partition *out);
OXL_INTERNAL void       partition_free(oxl_context *ctx, struct partition *p);

/* partition_file.c: partition.txt, which reads back to the same bits. */
OXL_INTERNAL oxl_result partition_write(oxl_context *ctx, const char *path, const struct partition *p);
OXL_INTERNAL oxl_result partition_read(oxl_context *ctx, const char *path, struct partition *out);

/* partition_export.c: blocks/KKK, partition.svg and, last of all, partition.txt into folder `out`. p is as partition_make left it. */
OXL_INTERNAL oxl_result partition_export(oxl_context *ctx, const struct partition *p, const char *out);

/* ---------------------------------------------------------------- ply.c: a small PLY reader */

enum { PLY_NAME = 64 };
enum ply_type { PLY_INT8, PLY_UINT8, PLY_INT16, PLY_UINT16, PLY_INT32, PLY_UINT32, PLY_FLOAT32, PLY_FLOAT64 };
enum ply_format { PLY_NO_FORMAT, PLY_ASCII, PLY_LITTLE, PLY_BIG };

struct ply_property {
    char          name[PLY_NAME];
    enum ply_type type;
    enum ply_type count_type; /* of a list */
    int           is_list;
};
struct ply_element {
    char                 name[PLY_NAME];
    uint64_t             rows; /* the file holds at least the bytes that so many rows need */
    struct ply_property *property;
    int                  properties, has_list;
    size_t               capacity;
    size_t               row_bytes; /* in binary files; with lists: the least */
};
struct ply {
    char               *path;
    struct os_file_map  file;
    enum ply_format     format;
    size_t              data; /* offset of the first byte after the header */
    int                 data_line;
    struct ply_element *element;
    int                 elements;
    size_t              element_capacity;
    char              **comment; /* without the word "comment" */
    int                 comments;
    size_t              comment_capacity;
};
/* Where a property's values (rows) go, converted; both NULL: nowhere. Lists are always skipped. */
struct ply_target {
    float  *as_float;
    double *as_double;
};
OXL_INTERNAL oxl_result ply_open(oxl_context *ctx, const char *path, struct ply *out); /* reads and checks the header */
/* target: one for each of the element's properties. */
OXL_INTERNAL oxl_result ply_read(oxl_context *ctx, const struct ply *ply, int element, const struct ply_target *target);
OXL_INTERNAL void       ply_close(oxl_context *ctx, struct ply *ply);
OXL_INTERNAL int        ply_find_element(const struct ply *ply, const char *name);              /* -1: not there */
OXL_INTERNAL int        ply_find_property(const struct ply_element *element, const char *name); /* -1: not there, or a list */

/* ---------------------------------------------------------------- model.c: planes of Gaussians */

#define MODEL_SH0 0.28209479177387814 /* Y_0^0 = 1 / (2 sqrt(pi)): colour = 0.5 + SH0 f_dc */

/* One allocation; each plane starts on a 64-byte line. Capacity is a multiple of 16 and at least 16, so kernels may read and
 * write whole packs of 16 rows up to it; rows from count to capacity are finite (fresh ones: zero, identity rotation).
 * model_reserve keeps rows and never shrinks; planes move. `to` of model_copy is overwritten, not freed. */
OXL_INTERNAL void       model_clear_rows(oxl_model *model, size_t first, size_t end); /* all zero but rotation w = 1 */
OXL_INTERNAL oxl_result model_reserve(oxl_context *ctx, oxl_model *model, size_t capacity);
/* Grows or shrinks the SH bands; new planes are zero. */
OXL_INTERNAL oxl_result model_set_degree(oxl_context *ctx, oxl_model *model, int sh_degree);
OXL_INTERNAL oxl_result model_copy(oxl_context *ctx, const oxl_model *from, oxl_model *to);
OXL_INTERNAL int        model_row_is_finite(const oxl_model *model, size_t row); /* its lobe too */
/* Keeps the rows whose byte in keep (count) is not 0, in their order, lobes with them; the others are cleared. */
OXL_INTERNAL void       model_keep_rows(oxl_model *model, const uint8_t *keep);

/* The second lobe. Memory for it is held for the first `lobes` rows alone, up to a whole pack. */
enum { MODEL_LOBE_PLANES = OXL_PLANES - OXL_LOBE };
#define MODEL_OPACITY           0.1    /* of a fresh Gaussian; Kerbl 2023 */
#define MODEL_LOBE_RATE_OPACITY 0.025f /* Adam's, of plane OXL_LOBE ["Prune Wisely", code] */
#define MODEL_LOBE_RATE_SCALE   0.005f /* of OXL_LOBE + 1..3 */
/* Rows 0..lobes-1 carry one; fresh ones are zero. */
OXL_INTERNAL oxl_result model_set_lobes(oxl_context *ctx, oxl_model *model, size_t lobes);
OXL_INTERNAL void       model_drop_lobes(oxl_model *model);
/* Brings the rows whose byte in active (count) is not 0 to the front of all three, each part in its order, and gives them lobes of
 * these factors and zero moments. first, second: the moments, or both NULL. Done once: the model must have no lobes yet. */
OXL_INTERNAL oxl_result model_activate_lobes(oxl_context *ctx, oxl_model *model, oxl_model *first, oxl_model *second,
                                             const uint8_t *active, float opacity_factor, float scale_factor);

/* Colours times a factor for each channel: SH bands alike, the 0.5 of band 0 with them. */
OXL_INTERNAL void model_scale_colour(oxl_model *model, const double factor[3]);

/* ---------------------------------------------------------------- merge.c: the models of blocks become one */

/* Appends those Gaussians of a block's model whose centres lie in its home, about into's origin. `into` starts as an empty model
 * that has the origin of the whole; its SH degree grows to the largest that comes, missing bands are zero; rows with a second lobe
 * stay in front. So the blocks' models can be read, merged and freed one after the other, in the order of the blocks. On failure
 * `into` holds what it held. */
OXL_INTERNAL oxl_result merge_block(oxl_context *ctx, const struct partition *p, int block, const oxl_model *from,
                                    oxl_model *into);

/* ---------------------------------------------------------------- model_file.c: models as PLY and .splat */

/* What oxl_model_write does with file_degree 3, lobes included; with the model's own degree only the bands carried are written. */
OXL_INTERNAL oxl_result modelfile_write_ply(oxl_context *ctx, const char *path, const oxl_model *model, int file_degree);

/* ---------------------------------------------------------------- renderer.c: the kernels behind one door */

struct renderer; /* scratch of one view at a time, kept between views: the steady state allocates nothing */

OXL_INTERNAL oxl_result renderer_create(oxl_context *ctx, struct renderer **out);
OXL_INTERNAL void       renderer_free(oxl_context *ctx, struct renderer *r);

/* Draws; the image stays in the renderer until the next call. sh_degree as in oxl_render_options. */
OXL_INTERNAL oxl_result renderer_forward(oxl_context *ctx, struct renderer *r, const oxl_model *model, const oxl_camera *camera,
                                         const oxl_render_options *options);
OXL_INTERNAL oxl_result renderer_image(oxl_context *ctx, struct renderer *r, const float **out); /* (3,H,W) */

/* oxl_render for many views of a model that nobody changes meanwhile: a device takes it once. options: not NULL. */
OXL_INTERNAL oxl_result renderer_draw(oxl_context *ctx, struct renderer *r, const oxl_model *model, const oxl_camera *camera,
                                      const oxl_render_options *options, oxl_image *out, float *depth);

/* The photograph of a view, at half its sides if `halved`: what renderer_loss compares with where it is given none. A device keeps
 * photographs, as far as a share of its memory goes: `photo` may be NULL where renderer_has_photo says so. */
OXL_INTERNAL int        renderer_has_photo(const struct renderer *r, int view);
OXL_INTERNAL oxl_result renderer_take_photo(oxl_context *ctx, struct renderer *r, int view, const struct photo *photo,
                                            int halved);

/* Loss of the drawn image against rgb (3,H,W) with weight (H,W) or NULL, or against the photograph that was taken last where rgb is
 * NULL; keeps its gradient for renderer_backward. */
struct renderer_loss {
    double total, l1, ssim, mse;
};
OXL_INTERNAL oxl_result renderer_loss(oxl_context *ctx, struct renderer *r, const float *rgb, const float *weight,
                                      float ssim_weight, struct renderer_loss *out);

/* From the next loss on the rendered image is multiplied by a gain per channel before it; NULL: by none. */
OXL_INTERNAL void          renderer_set_gain(struct renderer *r, const float gain[3]);
/* From the next forward on; on a device there is none. */
OXL_INTERNAL void          renderer_set_medium(struct renderer *r, const struct medium *medium);
/* (9) of the last backward: by direct, scatter and veil. */
OXL_INTERNAL const double *renderer_medium_gradient(const struct renderer *r);
/* dL/d(log gain) of the last loss. */
OXL_INTERNAL const double *renderer_gain_gradient(const struct renderer *r);

/* exposure.c: y = gain x, channel by channel; x, y (3,n). */
OXL_INTERNAL void exposure_forward(const float gain[3], const float *x, size_t n, float *y);
OXL_INTERNAL void exposure_backward(const float gain[3], const float *y, const float *dy, size_t n, float *dx,
                                    double dlog_gain[3]);

/* gain: least squares of weight (gain x - y)^2 by channel; weight (n) or NULL. */
OXL_INTERNAL void exposure_fit(const float *x, const float *y, const float *weight, size_t n, double gain[3]);

/* Of the next gradient, on the CPU: the tiles that count, by chance; the others are taken as like them. */
OXL_INTERNAL void renderer_choose_tiles(struct renderer *r, float share, uint64_t choice);

/* The gradient of the model that was drawn last, for drgb (3,H,W), or NULL: that of renderer_loss. `gradient` has the model's shape;
 * rows of packs out of sight are left alone. A device keeps it to itself until renderer_gradient. */
OXL_INTERNAL oxl_result renderer_backward(oxl_context *ctx, struct renderer *r, const float *drgb, oxl_model *gradient);
OXL_INTERNAL oxl_result renderer_gradient(oxl_context *ctx, struct renderer *r, oxl_model *gradient);

/* How much each Gaussian matters to S = the sum over pixels and channels of drgb (3,H,W) x the image drawn last: adds to score[row], for
 * each row seen, the sum over its pixels of (o dS/dalpha)^2. No loss is needed. */
OXL_INTERNAL oxl_result renderer_score(oxl_context *ctx, struct renderer *r, const float *drgb, float *score);

struct renderer_pace {
    float  rate[OXL_PLANES]; /* of each plane at this step */
    double beta[2];          /* what is left after a step of the mean gradient, and of its mean square */
    int    step;             /* of the run, not of the row; from 1: both means begin at 0, which is made up for */
};
#define RENDERER_BETAS \
    {                  \
        0.9, 0.999     \
    } /* [Kerbl 2023] */
struct renderer_aside {
    size_t rows, first; /* how many; the first of them */
};
/* Adam on the rows seen by the last view, but for those of which a number or its gradient is not finite: these count as not
 * seen from then on. */
OXL_INTERNAL oxl_result renderer_step(oxl_context *ctx, struct renderer *r, oxl_model *model, const oxl_model *gradient,
                                      oxl_model *first, oxl_model *second, const struct renderer_pace *pace,
                                      struct renderer_aside *out);

/* Adds to the statistics of density control what the last view, walked back, tells of each row that it saw. */
struct renderer_sums {
    size_t count;
    int    banded;
    float  z_near, z_far;         /* where the bands meet, camera z */
    float *gradient, *mid, *far_; /* (count) of |dL/d(u,v)|, in units of half an image; mid, far_: banded alone */
    float *views;                 /* (count) how many saw it */
};
OXL_INTERNAL oxl_result renderer_observe(oxl_context *ctx, struct renderer *r, const struct renderer_sums *sums);

/* Between steps a device holds the model, its moments and the statistics. This brings home what was stepped and observed since: to
 * be called before the host reads or changes any of them. The next renderer_forward takes the model as the host has it then. */
OXL_INTERNAL oxl_result renderer_fetch(oxl_context *ctx, struct renderer *r);

OXL_INTERNAL oxl_result renderer_forget(oxl_context *ctx, struct renderer *r); /* as if the last view had seen nothing */
/* What the last view saw of row i; on a device, as it was when renderer_fetch_rows was called. */
OXL_INTERNAL oxl_result renderer_fetch_rows(oxl_context *ctx, struct renderer *r);
OXL_INTERNAL int        renderer_drew_finite(const struct renderer *r, size_t row); /* 1 too when it did not see it */
OXL_INTERNAL int        renderer_saw(const struct renderer *r, size_t row);
OXL_INTERNAL float      renderer_mean_gradient(const struct renderer *r, size_t row); /* |dL/d(u,v)| in units of half an image */
OXL_INTERNAL float      renderer_depth(const struct renderer *r, size_t row);         /* camera z of its centre */
OXL_INTERNAL float renderer_radius(const struct renderer *r, size_t row); /* px: of the contour alpha = 1/255, the longer side */

struct renderer_counts {                   /* of the last view */
    size_t visible, pairs, blocks, pixels; /* pixels: alpha evaluations inside the image that the footprints ask for */
};
OXL_INTERNAL struct renderer_counts renderer_counts(const struct renderer *r);

struct splat;
/* What a device does in the place of the CPU's kernels, door by door as above. */
struct renderer_device {
    oxl_result (*create)(oxl_context *ctx, void **out);
    void (*free)(void *device);
    oxl_result (*forward)(void *device, const oxl_model *model, const oxl_camera *camera, const oxl_render_options *options);
    /* (3,H,W) drawn; depths: the sums of alpha T z and of alpha T in its place. */
    oxl_result (*image)(void *device, int depths, float *rgb);
    int (*has_photo)(const void *device, int view);
    oxl_result (*take_photo)(void *device, int view, const struct photo *photo, int halved);
    oxl_result (*loss)(void *device, const float *rgb, const float *weight, float ssim_weight, struct renderer_loss *out);
    oxl_result (*backward)(void *device, const float *drgb);
    oxl_result (*gradient)(void *device, oxl_model *gradient);
    oxl_result (*score)(void *device, const float *drgb, float *score);
    oxl_result (*step)(void *device, oxl_model *model, oxl_model *first, oxl_model *second, const struct renderer_pace *pace,
                       struct renderer_aside *out);
    oxl_result (*observe)(void *device, const struct renderer_sums *sums);
    oxl_result (*fetch)(void *device);
    oxl_result (*forget)(void *device);
    /* What the last view saw: of each row that it saw its splat, a bit, |dL/d(u,v)| as in struct renderer. */
    oxl_result (*rows)(void *device, struct splat *splat, uint16_t *visible, float *dmean2d);
};
#ifdef OXL_VULKAN
OXL_INTERNAL const struct renderer_device *vulkan_doors(void);
#endif

struct archive; /* checkpoint.c */

/* ---------------------------------------------------------------- nonfinite.c: numbers that are not finite */

OXL_INTERNAL void       faults_of_photo(oxl_context *ctx, oxl_faults *f); /* why it cannot be read is the context's error */
/* The loss of a view that the renderer drew last is not finite. */
OXL_INTERNAL void       faults_of_view(oxl_context *ctx, oxl_faults *f, int step, const char *view, const struct renderer *r,
                                       oxl_model *model, oxl_model *first, oxl_model *second);
OXL_INTERNAL void       faults_of_rows(oxl_context *ctx, oxl_faults *f, int step, const char *view, struct renderer_aside aside,
                                       oxl_model *model, oxl_model *first, oxl_model *second);
OXL_INTERNAL oxl_result faults_end(oxl_context *ctx, oxl_faults *f, oxl_model *model); /* removes; says what there was */
OXL_INTERNAL void       faults_add(oxl_faults *to, const oxl_faults *from);
OXL_INTERNAL void       faults_archive(struct archive *a, oxl_faults *f);
OXL_INTERNAL void       faults_add_json(struct text *t, const oxl_faults *f); /* members, each with a comma behind it */
OXL_INTERNAL void       faults_read_json(const char *text, oxl_faults *f);

/* ---------------------------------------------------------------- density.c: clone, split, prune, reset */

struct density; /* statistics since the last control */

struct density_rules {
    double   gradient;     /* grow at this mean |dL/d(u,v)|, in units of half an image */
    double   f_mid, f_far; /* weights of what was seen from z_near and from z_far on [paper eq. 2]; read when there are bands */
    double   extent;       /* of the scene */
    int      split_large;  /* after the first opacity reset */
    size_t   cap;          /* on the number of Gaussians; 0: none */
    uint64_t seed;
    int      step;
};
struct density_change {
    size_t removed, cloned, split;
};
OXL_INTERNAL oxl_result density_create(oxl_context *ctx, struct density **out);
OXL_INTERNAL oxl_result density_copy(oxl_context *ctx, const struct density *from, size_t count, struct density **out);
OXL_INTERNAL void       density_free(oxl_context *ctx, struct density *d);
OXL_INTERNAL oxl_result density_clear(oxl_context *ctx, struct density *d, size_t count);
OXL_INTERNAL oxl_result density_observe(oxl_context *ctx, struct density *d, struct renderer *r, size_t count);
/* From now on gradients are kept apart by the depth at which they were seen; z_near 0: they are not. Clears the statistics. */
OXL_INTERNAL oxl_result density_set_bands(oxl_context *ctx, struct density *d, size_t count, double z_near, double z_far);
/* Of a row, over the views that saw it since the statistics were cleared, without weights. */
OXL_INTERNAL double     density_mean_gradient(const struct density *d, size_t row);
/* Judges every row, rebuilds the model and its moments, clears the statistics. */
OXL_INTERNAL oxl_result density_control(oxl_context *ctx, struct density *d, oxl_model *model, oxl_model *first,
                                        oxl_model *second, const struct density_rules *rules, struct density_change *out);
OXL_INTERNAL void       density_reset_opacity(oxl_model *model, oxl_model *first, oxl_model *second, float alpha_min);
OXL_INTERNAL void       density_archive(struct archive *a, struct density *d, size_t count);

/* ---------------------------------------------------------------- checkpoint.c: the state of a run in a file */

/* Goes both ways: a module lists its state once, and the archive writes it or reads it back. After a failure, calls do nothing.
 * Counts are read before what they count, and are checked against what is left of the file. */
struct archive {
    oxl_context *ctx;
    int          reading;
    const char  *path;
    FILE        *file;
    uint64_t     sum, left; /* of the bytes written; bytes still to read */
    oxl_result   rc;
};
OXL_INTERNAL void archive_u64(struct archive *a, uint64_t *value);
OXL_INTERNAL void archive_int(struct archive *a, int *value);
OXL_INTERNAL void archive_size(struct archive *a, size_t *value);
OXL_INTERNAL void archive_ints(struct archive *a, int *values, size_t count);
OXL_INTERNAL void archive_floats(struct archive *a, float *values, size_t count);
OXL_INTERNAL void archive_doubles(struct archive *a, double *values, size_t count);
/* When reading: what was read must be so, or the file is refused. The sum at its end tells of accidents, not of intent. */
OXL_INTERNAL void archive_expect(struct archive *a, int is_so);
OXL_INTERNAL void archive_text(struct archive *a, struct text *t);             /* reading: the text is replaced */
OXL_INTERNAL void archive_model(struct archive *a, oxl_model *model);          /* reading: the model is replaced */
OXL_INTERNAL int  archive_holds(struct archive *a, size_t count, size_t size); /* reading: 0 and a failure when it cannot */

typedef void            checkpoint_state(struct archive *a, void *user);
/* FOLDER/checkpoint.oxl; the one before it becomes checkpoint.prev.oxl. `key` says what the run depends on. */
OXL_INTERNAL oxl_result checkpoint_write(oxl_context *ctx, const char *folder, const char *key, checkpoint_state *state,
                                         void *user);
/* The newest that is whole and of this key; none: *found = 0, and the state is untouched. */
OXL_INTERNAL oxl_result checkpoint_read(oxl_context *ctx, const char *folder, const char *key, checkpoint_state *state,
                                        void *user, int *found);
OXL_INTERNAL void       checkpoint_remove(oxl_context *ctx, const char *folder, int others); /* others: those put aside, too */

/* ---------------------------------------------------------------- spsa.c: the search for the depth weights */

struct spsa {
    double   f[2];           /* f_mid, f_far: the estimate */
    double   home[2], doubt; /* where the estimate is drawn to, and how much: the curvature of a cost around it */
    double   sway[2];        /* how far from home each pair alone would put f_mid and f_far - f_mid: their sums */
    double   point[2][2];    /* the two points of the pair in progress */
    double   cost[2];        /* of them, as told */
    double   cap;            /* the most that f may be */
    uint64_t seed, signs;
    int      pair, told; /* pairs finished; costs told of the one in progress */
    int      first;      /* which of the two points is asked for first */
};
/* doubt: half of it is what a weight must gain to be believed 1 away from home, in the costs' unit. */
OXL_INTERNAL void spsa_begin(struct spsa *s, const double start[2], const double home[2], double doubt, double cap,
                             uint64_t seed);
/* The point to evaluate now; the same until it is told or skipped. */
OXL_INTERNAL void spsa_ask(const struct spsa *s, double f[2]);
OXL_INTERNAL int  spsa_tell(struct spsa *s, double cost); /* its cost, less is better; 1: that was a pair, the estimate moved */
OXL_INTERNAL void spsa_skip(struct spsa *s);              /* the pair starts again */
OXL_INTERNAL void spsa_archive(struct archive *a, struct spsa *s);

/* ---------------------------------------------------------------- contrast.c: how fast contrast fades with depth */

struct contrast {
    int    measured;    /* 0: there were too few points that are seen from several depths */
    double beta, error; /* contrast goes as exp(-beta z), 1/unit of the scene; its standard error */
    size_t points, observations;
};
OXL_INTERNAL oxl_result contrast_measure(oxl_context *ctx, oxl_scene *scene, struct contrast *out);

/* ---------------------------------------------------------------- ucd.c: weights by depth for density control, and their search */

enum {
    UCD_SPANS          = 4, /* densifications that a trial of weights spans: the gain of the first shows after the third alone */
    UCD_DENSIFICATIONS = 20 /* fewer teach too little: three pairs */
};

struct ucd {
    int             on, learns, too_short; /* too short a run to learn */
    double          z_near, z_far;         /* where the bands meet, camera z */
    double          f[2];                  /* f_mid, f_far: learned so far; of the run, when they are not learned */
    struct spsa     spsa;
    int             densified, stride; /* densifications that were; every so many of them is one to learn from */
    struct contrast contrast;
    char            reason[256];
};
/* What is `on` and between which depths; densifications: how many there will be. Logs nothing: ucd_describe has the words. */
OXL_INTERNAL oxl_result ucd_begin(oxl_context *ctx, struct ucd *u, oxl_scene *scene, const oxl_ucd *options, int densifications);
/* Of weights that are learned, if so many densifications are enough; ucd_begin does it, too. */
OXL_INTERNAL void       ucd_begin_search(struct ucd *u, int densifications, uint64_t seed);
OXL_INTERNAL void       ucd_describe(const struct ucd *u, char *out, size_t size);
OXL_INTERNAL int        ucd_tries(const struct ucd *u);            /* whether the next densification is one to learn from */
OXL_INTERNAL void       ucd_ask(const struct ucd *u, double f[2]); /* the point to try; told of twice, the next pair begins */
/* Of the point asked for: the mean log loss at the end of its trial, and dN/N over it. Returns its cost; what is not finite drops the pair. */
OXL_INTERNAL double     ucd_tell(struct ucd *u, double log_loss, double growth);
OXL_INTERNAL void       ucd_archive(struct archive *a, struct ucd *u);

/* ---------------------------------------------------------------- prune.c: fewer Gaussians, those that matter most */

struct prune {
    oxl_keep keep;
    double   row_bytes;           /* of the file, for OXL_KEEP_BYTES */
    float    detail;              /* what fine detail adds to a pixel's weight; 0: photographs are not looked at */
    int      guard;               /* what few views see is judged by those alone */
    int      views;               /* a score is taken of at most so many, spread evenly */
    int      start, end;          /* the window: steps */
    int      every, patience;     /* steps between checks; without a drop */
    int      drops, last;         /* done; step of the last */
    size_t   first_count, target; /* at the window's start (0: not yet), at its end */
    double   stamp;               /* mean L1 before the last drop */
    double   l1_sum;              /* since the last check */
    int      l1_count;
    double   held; /* auto: loss of the held-out views at the window's start */
};
/* densified: the step after which density is left alone; views: for training; row_bytes: prune_row_bytes. */
OXL_INTERNAL void   prune_begin(struct prune *p, oxl_keep keep, int iterations, int densified, int views, double row_bytes);
OXL_INTERNAL double prune_row_bytes(int sh_degree, int lobes);                     /* lobes: every row may have a second one */
OXL_INTERNAL void   prune_describe(const struct prune *p, char *out, size_t size); /* what was kept, in words */
OXL_INTERNAL void   prune_observe(struct prune *p, int step, double l1); /* of every step; steps out of the window are ignored */
OXL_INTERNAL int    prune_checks(const struct prune *p, int step); /* whether prune_due would look: then `auto` needs `held` */
/* After the step: how many of `count` Gaussians are to go now. held: mean loss of the training views that stand aside; auto alone reads it. */
OXL_INTERNAL size_t prune_due(struct prune *p, int step, size_t count, double held);
/* Removes the `drop` that matter least, from the moments too. */
OXL_INTERNAL oxl_result prune_apply(oxl_context *ctx, const struct prune *p, size_t drop, struct renderer *r, oxl_scene *scene,
                                    const oxl_render_options *options, oxl_model *model, oxl_model *first, oxl_model *second);
OXL_INTERNAL void       prune_archive(struct archive *a, struct prune *p);
/* Parts of prune_apply: the score of each row over the training views; keep[i] = 0 for the `drop` lowest, by row where equal. */
OXL_INTERNAL oxl_result prune_score(oxl_context *ctx, const struct prune *p, struct renderer *r, oxl_scene *scene,
                                    const oxl_model *model, const oxl_render_options *options, float *score);
OXL_INTERNAL void       prune_select(const float *score, size_t count, size_t drop, uint8_t *keep);
OXL_INTERNAL oxl_result prune_detail(oxl_context *ctx, const struct photo *p, float *out); /* (H,W) 0..3 */

/* ---------------------------------------------------------------- transients.c: what swims through one photograph */

struct robust_square { /* of pixels, in the present view */
    float    error;    /* how far off its mean colour is, of white; -1: none of its pixels counts */
    float    usual;    /* the largest usual error of the points in it; -1: there are none */
    unsigned marks;
};
struct robust {
    size_t                points; /* of the scene; 0: off */
    float                *usual;  /* (points) error where it lies, over the views that see it, of late */
    int32_t              *place;  /* (points) its square in the present view, or -1 */
    struct robust_square *square;
    size_t                square_capacity;
    double                aside; /* share of the pixels put aside, smoothed over the last photographs */
};
OXL_INTERNAL oxl_result robust_begin(oxl_context *ctx, struct robust *r, const oxl_scene *scene, int on);
OXL_INTERNAL void       robust_free(oxl_context *ctx, struct robust *r);
/* weight (H,W): its pixels that are put aside become 0. masked: it holds a mask; else all of it is set. drawn, photo (3,H,W).
 * remember 0: what is usual stays as it is, as in the steps of a trial. */
OXL_INTERNAL oxl_result robust_weigh(oxl_context *ctx, struct robust *r, const oxl_scene *scene, const oxl_camera *camera,
                                     double near_plane, const float *drawn, const float *photo, int remember, int masked,
                                     float *weight);
OXL_INTERNAL void       robust_describe(const struct robust *r, char *out, size_t size); /* what was put aside, in words */
OXL_INTERNAL void       robust_archive(struct archive *a, struct robust *r);

/* ---------------------------------------------------------------- water.c: the nine parameters of the medium */

struct water {
    int    on, steps;
    double range;                       /* the survey's median, that attenuation counts by */
    double raw[9], first[9], second[9]; /* before softplus: bD, bB, Binf by channel; Adam's moments */
};
OXL_INTERNAL oxl_result    water_begin(oxl_context *ctx, struct water *w, oxl_scene *scene, const struct medium *goes_on);
OXL_INTERNAL int           water_starts_at(const oxl_train_options *options); /* after this step; 0: never */
OXL_INTERNAL struct medium water_medium(const struct water *w);
OXL_INTERNAL void          water_start(struct water *w, oxl_model *model);
OXL_INTERNAL void          water_step(struct water *w, double progress, const double gradient[9]);
OXL_INTERNAL void          water_archive(struct archive *a, struct water *w, int used);

/* ---------------------------------------------------------------- train/exposure.c: log gains of training images */

struct exposure {
    oxl_exposure   mode;
    int            decided;        /* auto: it is decided */
    struct imaging of;             /* the gains; on: they are applied */
    float         *first, *second; /* (views,3) Adam's moments */
    int           *visits;         /* (views) steps of a view's gains */
    double         mean[3];        /* of the log gains after each step: 0, or that of the run which this one goes on from */
};
OXL_INTERNAL oxl_result exposure_begin(oxl_context *ctx, struct exposure *e, oxl_scene *scene, oxl_exposure mode, int goes_on);
OXL_INTERNAL void       exposure_free(oxl_context *ctx, struct exposure *e);
OXL_INTERNAL oxl_result exposure_copy(oxl_context *ctx, const struct exposure *from, struct exposure *to);
OXL_INTERNAL int        exposure_watches(const struct exposure *e);
OXL_INTERNAL int        exposure_decides_at(const oxl_train_options *options); /* after this step; 0: never */
OXL_INTERNAL void       exposure_watch(struct exposure *e, int view, const float *drawn, const float *target, const float *weight,
                                       size_t n);
OXL_INTERNAL void       exposure_step(struct exposure *e, int view, double progress, const double dlog_gain[3]);
OXL_INTERNAL void       exposure_decide(struct exposure *e, double plain, double gained, int views, char *why, size_t size);
OXL_INTERNAL void       exposure_archive(struct archive *a, struct exposure *e);

/* ---------------------------------------------------------------- train.c */

/* Where a run keeps its state. */
struct train_place {
    const char      *folder;    /* of the checkpoints */
    const char      *key;       /* what the result depends on */
    struct text     *log;       /* the caller's, kept with the state */
    struct text     *notes;     /* so are these */
    const oxl_model *start;     /* what training starts from; NULL: the scene's points */
    struct text     *decisions; /* gets members of a JSON object: what was decided, and on what evidence; or NULL */
    oxl_faults      *faults;    /* out: of the whole run; or NULL */
    int             *trained;   /* out: 1: nothing of the run is left to be done; or NULL */
};
/* oxl_train with checkpoints: goes on from the last one when there is one. place may be NULL. */
OXL_INTERNAL oxl_result train_run(oxl_context *ctx, oxl_scene *scene, const oxl_train_options *options,
                                  const oxl_callback *callback, const struct train_place *place, oxl_model *out);

/* The most Gaussians that training may make of a scene. */
OXL_INTERNAL size_t     train_cap(const oxl_scene *scene, const oxl_train_options *options);
/* By how much a run too short for the usual steps of geometry takes larger ones (docs/TRADEOFF.md). */
OXL_INTERNAL double     train_haste(const oxl_train_options *options);
OXL_INTERNAL oxl_result train_check(oxl_context *ctx, const oxl_train_options *options);
OXL_INTERNAL float      train_scale_rate(const oxl_train_options *options);
OXL_INTERNAL size_t     train_cap_of(size_t points, double pixels, const oxl_train_options *options);
OXL_INTERNAL double     train_pixels(const oxl_scene *scene); /* of all training views */
/* Share of the run in which a photograph of this size is halved. */
OXL_INTERNAL double     train_coarse_share(const oxl_train_options *options, int width, int height);
OXL_INTERNAL int        train_densifies_at(const oxl_train_options *options, int step);
OXL_INTERNAL int        train_resets_opacity_at(const oxl_train_options *options, int step);
OXL_INTERNAL int        train_densifications(const oxl_train_options *options); /* in a whole run */
OXL_INTERNAL int        train_may_try(const oxl_train_options *options); /* whether trials, which copy the model, may come */
OXL_INTERNAL int        train_training_views(const oxl_scene *scene);
/* Steps of a whole run's trials that are none of its iterations, at most; views: that train. */
OXL_INTERNAL int        decide_steps_beside(const oxl_train_options *options, int views);

/* ---------------------------------------------------------------- manifest.c: run.json, what a result depends on */

#define RUN_REFINE_MOST 1000.0 /* x the blocks' steps */

struct oxl_run { /* read back from run.json */
    int      finished;
    float    refine;       /* not in the line: blocks do not depend on it */
    char    *line, *found; /* "job": {...}, "found": {...}; line NULL: there was no run */
    char    *scene, *preset, *path[3];
    uint64_t seed;
};
OXL_INTERNAL void       run_describe(struct text *t, const char *scene, const oxl_job_options *o); /* "job": {...} */
OXL_INTERNAL oxl_result run_read(oxl_context *ctx, const char *folder, struct oxl_run *out);
OXL_INTERNAL void       run_free(oxl_context *ctx, struct oxl_run *run);
OXL_INTERNAL void       run_options(const struct oxl_run *run, oxl_job_options *o); /* o borrows run's strings */
OXL_INTERNAL double     run_number(const char *text, const char *name);             /* what follows "name": , or 0 */

/* ---------------------------------------------------------------- block.c: the training of one block in its folder */

struct block_record {                                /* block.json */
    int        there, trained, finished, iterations; /* trained: to its end, but for a standard model */
    size_t     gaussians;
    double     seconds, peak, predicted_seconds, predicted_peak; /* peaks in bytes */
    oxl_faults faults;
};
struct block_task {
    const char         *folder, *key; /* key: what the result depends on */
    oxl_train_options   train;
    const oxl_callback *callback;
    const oxl_model    *start; /* what training starts from; NULL: the scene's points */
    int    standard; /* steps that a model with second lobes gets without them, for model_standard.ply; 0: none is made */
    double predicted_seconds, predicted_peak;
};
/* A run that goes on for `steps` steps from a model that another has ended with: no Gaussian comes or goes. */
OXL_INTERNAL oxl_train_options block_refinement(const oxl_train_options *run, int sh_degree, int steps);
/* How many steps model_standard.ply is worth after such a run. */
OXL_INTERNAL int               block_standard_steps(const oxl_train_options *run);
OXL_INTERNAL oxl_result        block_read(oxl_context *ctx, const char *folder, const char *key, struct block_record *out);
/* Adds what the training of a block decided, the members of a JSON object; nothing when there is no block.json. */
OXL_INTERNAL oxl_result        block_read_decisions(oxl_context *ctx, const char *folder, struct text *out);
/* Goes on from the block's checkpoint. OXL_ERR_INTERRUPTED when the callback stopped it: model.ply is as far as it came. */
OXL_INTERNAL oxl_result        block_train(oxl_context *ctx, oxl_scene *scene, const struct block_task *task);

/* ---------------------------------------------------------------- metrics.c */

OXL_INTERNAL double metrics_decibel(double error, double weight); /* PSNR of weighted squared errors; NaN of none */

struct metrics_sum {
    double error, weight; /* sum of squared differences, and of what they are divided by */
    size_t pixels;        /* that count */
};
/* The i-th pixel of both, three channels, by the photograph's weight. */
OXL_INTERNAL void       metrics_add_pixel(const oxl_image *drawn, const oxl_image *photograph, size_t i, struct metrics_sum *sum);
/* Adds the members "psnr", "cc_psnr", "ssim", "ms_ssim", "count" and "views" (name and the four each) of a JSON object, without its braces. */
OXL_INTERNAL oxl_result metrics_write_json(oxl_context *ctx, struct text *t, const oxl_scene *scene, const oxl_metrics *m);

/* ---------------------------------------------------------------- seam.c: do the borders between blocks show? */

#define SEAM_WIDTH 0.02 /* near: this share of the block's size along the axis that the border cuts */

struct seam { /* of all pixels of a split that count: by squared error, not the mean of views; NaN of no pixels */
    double near_psnr, elsewhere_psnr;
    size_t near_pixels, elsewhere_pixels;
};
OXL_INTERNAL oxl_result seam_measure(oxl_context *ctx, const struct partition *p, const oxl_model *model, oxl_scene *scene,
                                     oxl_split split, struct seam *out);
OXL_INTERNAL void seam_add_json(struct text *t, const struct seam *seam); /* a member and its comma: one line of an object */

/* ---------------------------------------------------------------- lint.c: what is wrong though each file can be read */

#define LINT_DOUBT 0.1 /* share of sightings that are none, from which on the survey as a whole is doubted */
/* Fills s->missed; s->unusable and s->masked. What is wrong is logged. OXL_ERR_INPUT: no photograph can be trained with. */
OXL_INTERNAL oxl_result lint_sightings(oxl_context *ctx, const oxl_scene *scene, oxl_survey *s);
OXL_INTERNAL oxl_result lint_photographs(oxl_context *ctx, const oxl_scene *scene, oxl_survey *s);

/* ---------------------------------------------------------------- survey_report.c: what a survey holds, what training it would take */

/* What a training run takes, of a survey or of a block, as arithmetic on counts. */
struct survey_load {
    size_t points, observations; /* to start from; of a point in a view */
    int    views;
    double pixels, train_pixels, largest; /* of all views; of the training views; of one */
    double largest_file;                  /* pixels of a photograph as the file has it */
};
struct survey_cost {
    double gaussians, memory, seconds; /* at the end; peak in bytes; on ctx's threads */
};
/* Of a block that partition_make has made. */
OXL_INTERNAL struct survey_load partition_load(const struct partition *p, int block);
OXL_INTERNAL struct survey_load survey_load(const oxl_scene *scene);
OXL_INTERNAL struct survey_cost survey_cost(const oxl_context *ctx, const oxl_job_options *options,
                                            const struct survey_load *load);
/* Peak in bytes, of a run that ends with so many Gaussians. */
OXL_INTERNAL double             survey_memory(const oxl_job_options *options, const struct survey_load *load, double gaussians);
/* closely: each photograph and mask is looked at, too, as far as that goes without decoding it. */
OXL_INTERNAL oxl_result survey_describe(oxl_context *ctx, const oxl_scene *scene, const oxl_job_options *options, int closely,
                                        oxl_survey *out);
/* An object without a newline at its end; its lines after the first start with `indent`. */
OXL_INTERNAL void       survey_add_json(struct text *t, const oxl_survey *survey, const char *indent);

/* Of the scene that the cost is of, in all its blocks: from steps that are tried, or, where that would take too long, by the cost. */
OXL_INTERNAL double survey_seconds(oxl_context *ctx, const oxl_scene *scene, const oxl_job_options *options,
                                   const struct survey_cost *cost);

/* ---------------------------------------------------------------- predict_time.c: how long steps will take */

/* Gaussians at the end of a run that may not have more than `cap`. */
OXL_INTERNAL double rehearse_expected(const oxl_train_options *options, size_t points, size_t cap);

/* Seconds of a run that is to end with so many Gaussians, from steps that are tried here and now; 0: it cannot be told so, be it that trying
 * would take too long, or for want of memory. */
OXL_INTERNAL double rehearse(oxl_context *ctx, const oxl_scene *scene, const oxl_train_options *options, double gaussians);

/* ---------------------------------------------------------------- budget.c: --ram */

/* Image cache and most Gaussians such that the load fits options->ram (0: they stay); 0 when it cannot. */
OXL_INTERNAL int        budget_fit(const oxl_context *ctx, const struct survey_load *load, oxl_job_options *o);
/* A run that makes no Gaussians, beside `more` bytes: whether it fits, without a cache if need be. *memory: what it takes; the budget that
 * would do when it does not fit. */
OXL_INTERNAL int        budget_holds(const oxl_context *ctx, const struct survey_load *load, double more, oxl_job_options *o,
                                     double *memory);
OXL_INTERNAL oxl_result budget_refuse(oxl_context *ctx, const struct survey_load *load, const oxl_job_options *o);
/* partition_make with blocks small enough that each fits. OXL_ERR_BUDGET: not even small ones do. */
OXL_INTERNAL oxl_result budget_partition(oxl_context *ctx, const oxl_scene *scene, const oxl_job_options *o,
                                         struct partition *out);

#endif
