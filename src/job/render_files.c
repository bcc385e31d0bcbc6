/* render_files.c - writes renders of the views and depth maps as files.
 *
 * Invariant: no name of an image leads out of the folder.
 */
#include "job.h"
#include "../core/codec.h"
#include "../evaluate/evaluate.h"
#include "../render/render.h"
#include "../survey/scene.h"
#include "../large/os_job.h"

/* Finds the path of a view's file, and makes the folders in its name; refuses links among them, which would
 * lead elsewhere. */
OXL_INTERNAL oxl_result render_file_path(oxl_context *ctx, const char *folder, const char *view,
                                         const char *suffix, char **out)
{
    char *file = NULL, *slash;
    oxl_result rc = oxl_render_path(ctx, "", view, suffix, &file);
    *out = NULL;
    if (rc != OXL_OK) return rc;
    slash = strrchr(file, '/');
    *slash = 0;
    if (slash > file) rc = os_make_folder_in(ctx, folder, file + 1);
    *slash = '/';
    if (rc == OXL_OK && !(*out = oxl_path_join(ctx, folder, file + 1))) rc = OXL_ERR_MEMORY;
    oxl_free(ctx, file);
    return rc;
}

static oxl_result render_file_write_image(oxl_context *ctx, const char *folder, const char *name,
                                          const char *suffix, const oxl_image *image)
{
    char *path;
    oxl_result rc = render_file_path(ctx, folder, name, suffix, &path);
    if (rc == OXL_OK) rc = oxl_image_write(ctx, path, image);
    oxl_free(ctx, path);
    return rc;
}

/* Writes a PFM: rows from the bottom; the sign of the scale states the byte order. */
oxl_result oxl_write_pfm(oxl_context *ctx, const char *path, const float *value, int width, int height)
{
    const uint16_t one = 1;
    const int small = *(const unsigned char *)&one; /* 1: the machine is little endian */
    struct os_writer writer = {0};
    const oxl_result rc = os_writer_open(ctx, path, &writer);
    if (rc != OXL_OK) return rc;
    fprintf(writer.file, "Pf\n%d %d\n%s\n", width, height, small ? "-1.0" : "1.0");
    for (int y = height - 1; y >= 0; y--)
        fwrite(value + (size_t)y * width, sizeof *value, (size_t)width, writer.file);
    return os_writer_close(ctx, &writer, OXL_OK);
}

static oxl_result render_file_write_pfm(oxl_context *ctx, const char *folder, const char *name,
                                        const float *depth, int width, int height)
{
    char *path;
    oxl_result rc = render_file_path(ctx, folder, name, ".depth.pfm", &path);
    if (rc == OXL_OK) rc = oxl_write_pfm(ctx, path, depth, width, height);
    oxl_free(ctx, path);
    return rc;
}

/* Encodes 8-bit grey with alpha, which has as many bytes per pixel, and changes the header to 16-bit grey. */
OXL_INTERNAL oxl_result render_write_png16(oxl_context *ctx, const char *path, const uint16_t *grey,
                                           int width, int height)
{
    /* Names byte offsets in a PNG [RFC 2083]. */
    enum { HEADER = 12, HEADER_SIZE = 17, BITS = 24, COLOUR = 25, SUM = 29 };
    const size_t count = (size_t)width * (size_t)height;
    uint8_t *bytes = oxl_alloc(ctx, count, 2);
    unsigned char *encoded = NULL;
    int size = 0;
    oxl_result rc = OXL_ERR_MEMORY;
    for (size_t i = 0; bytes && i < count; i++)
        bytes[2 * i] = (uint8_t)(grey[i] >> 8), bytes[2 * i + 1] = (uint8_t)(grey[i] & 255);
    if (bytes) encoded = codec_encode_png(ctx, bytes, width, height, 2, &size);
    if (encoded) {
        unsigned sum;
        encoded[BITS] = 16, encoded[COLOUR] = 0;
        sum = codec_png_checksum(encoded + HEADER, HEADER_SIZE);
        for (int k = 0; k < 4; k++) encoded[SUM + k] = (unsigned char)(sum >> (24 - 8 * k));
        rc = os_write_file(ctx, path, encoded, (size_t)size);
    }
    codec_free(ctx, encoded);
    oxl_free(ctx, bytes);
    return rc;
}

/* Writes depth in thousandths, which are millimetres if depth is in metres; 0: nothing is
 * there; 65535: at least so far. */
static oxl_result render_file_write_depth16(oxl_context *ctx, const char *folder, const char *name,
                                            const float *depth, int width, int height)
{
    const size_t pixels = (size_t)width * (size_t)height;
    char *path;
    uint16_t *value = oxl_alloc(ctx, pixels, sizeof *value);
    oxl_result rc = render_file_path(ctx, folder, name, ".depth16.png", &path);
    if (rc == OXL_OK && !value) rc = OXL_ERR_MEMORY;
    for (size_t i = 0; rc == OXL_OK && i < pixels; i++)
        value[i] = depth[i] > 0 ? (uint16_t)OXL_CLAMP(1000 * depth[i] + 0.5f, 1, 65535) : 0;
    if (rc == OXL_OK) rc = render_write_png16(ctx, path, value, width, height);
    OXL_FREE(ctx, value, path);
    return rc;
}

/* Writes depth as a grey image for any range: mean / (mean + z), which is 1 at the camera, 1/2 at the mean
 * depth, 0 at infinity or without depth; then as PFM and as 16-bit PNG. */
OXL_INTERNAL oxl_result render_file_write_depth(oxl_context *ctx, const char *folder, const char *name,
                                                const float *depth, int width, int height)
{
    const size_t pixels = (size_t)width * height;
    oxl_image grey = {0};
    double sum = 0;
    size_t met = 0;
    oxl_result rc = oxl_image_create(ctx, width, height, &grey);
    if (rc != OXL_OK) return rc;
    for (size_t i = 0; i < pixels; i++)
        if (depth[i] > 0) sum += depth[i], met++;
    for (size_t i = 0; i < pixels; i++) {
        const float mean = (float)(met ? sum / (double)met : 1),
                    v = depth[i] > 0 ? mean / (mean + depth[i]) : 0;
        for (int c = 0; c < 3; c++) grey.rgb[c * pixels + i] = v;
    }
    rc = render_file_write_image(ctx, folder, name, ".depth.png", &grey);
    if (rc == OXL_OK) rc = render_file_write_pfm(ctx, folder, name, depth, width, height);
    if (rc == OXL_OK) rc = render_file_write_depth16(ctx, folder, name, depth, width, height);
    oxl_image_free(ctx, &grey);
    return rc;
}

/* ---------------- rendered one after the other, written side by side */

enum {
    RENDER_FILES_AT_ONCE = 16,
    RENDER_FILES_BYTES = 52 /* bytes per pixel until it is on disk: three images, depth, a PNG under way */
};

/* Holds what is written of a view. */
struct render_file {
    const char *name;
    int width, height;
    oxl_image rendered, image; /* image: empty if it is not requested or not readable */
    /* the model without lamp and medium, if there is an image and a medium; otherwise empty */
    oxl_image clear;
    float *depth;    /* (H,W) or NULL */
    oxl_context own; /* context of the thread that writes it */
};

static void render_file_free(oxl_context *ctx, struct render_file *file)
{
    oxl_image_free(ctx, &file->rendered);
    oxl_image_free(ctx, &file->image);
    oxl_image_free(ctx, &file->clear);
    oxl_free(ctx, file->depth);
}

static oxl_result render_file_render(oxl_context *ctx, const struct render_files *f, struct renderer *r,
                                     int view, struct render_file *out)
{
    const oxl_render_output *what = f->what;
    const oxl_scene *scene = f->scene;
    const oxl_view *of = oxl_scene_view(scene, view);
    const struct oxl_imaging *imaging = what->clear ? NULL : f->imaging;
    oxl_result rc = OXL_OK;
    *out = (struct render_file){.name = of->name, .own = context_for_thread(ctx)};
    out->width = of->camera.width;
    out->height = of->camera.height;
    if (what->depth &&
        !(out->depth = oxl_alloc(ctx, (size_t)out->width * (size_t)out->height, sizeof *out->depth)))
        rc = OXL_ERR_MEMORY;
    if (rc == OXL_OK)
        rc = evaluate_draw(ctx, &(struct drawn){r, f->source, scene, imaging}, view, &out->rendered,
                           out->depth);
    for (size_t i = 0; rc == OXL_OK && out->depth && i < (size_t)out->width * (size_t)out->height; i++)
        out->depth[i] = OXL_MAX(out->depth[i], 0) * (what->unit > 0 ? (float)what->unit : 1);
    if (rc == OXL_OK && what->images) rc = scene_copy_image(ctx, scene, view, &out->image);
    if (rc == OXL_ERR_INPUT) rc = OXL_OK; /* Skips an unreadable image, which the evaluation has reported. */
    if (rc == OXL_OK && out->image.rgb && imaging && imaging_alters_colours(imaging))
        rc = evaluate_draw(ctx, &(struct drawn){r, f->source, scene, NULL}, view, &out->clear, NULL);
    if (rc != OXL_OK) render_file_free(ctx, out);
    return rc;
}

static oxl_result render_file_write(struct render_file *file, const char *folder)
{
    oxl_result rc = render_file_write_image(&file->own, folder, file->name, ".png", &file->rendered);
    if (rc == OXL_OK && file->depth)
        rc = render_file_write_depth(&file->own, folder, file->name, file->depth, file->width, file->height);
    if (rc == OXL_OK && file->image.rgb)
        rc = render_file_write_image(&file->own, folder, file->name, ".image.png", &file->image);
    if (rc == OXL_OK && file->clear.rgb)
        rc = render_file_write_image(&file->own, folder, file->name, ".clear.png", &file->clear);
    return rc;
}

/* Renders views from `first` on: one for each thread, as many as a quarter of the cache holds. *rendered:
 * number of views, without one that failed. */
static oxl_result render_files_render(oxl_context *ctx, const struct render_files *f, struct renderer *r,
                                      int first, struct render_file *out, int *rendered)
{
    const int *view = f->view + first;
    const int count = f->views - first;
    size_t bytes = 0;
    oxl_result rc = OXL_OK;
    *rendered = 0;
    if (f->what->images) scene_images_ahead(ctx, f->scene, view, count);
    while (*rendered < OXL_MIN(count, OXL_MIN(ctx->threads, RENDER_FILES_AT_ONCE))) {
        const oxl_camera *camera = &oxl_scene_view(f->scene, view[*rendered])->camera;
        bytes += (size_t)RENDER_FILES_BYTES * (size_t)camera->width * (size_t)camera->height;
        if (*rendered > 0 && bytes > f->scene->cache->limit / 4) break;
        rc = render_file_render(ctx, f, r, view[*rendered], &out[*rendered]);
        if (rc != OXL_OK) break;
        ++*rendered;
    }
    return rc;
}

/* Writes the rendered views. *written: number of views before the first failure. */
static oxl_result render_files_write(oxl_context *ctx, struct render_file *file, int count,
                                     const char *folder, int *written)
{
    oxl_result rc[RENDER_FILES_AT_ONCE];
    oxl_result first = OXL_OK;
    *written = 0;
#pragma omp parallel for schedule(dynamic, 1) num_threads(ctx->threads)
    for (int i = 0; i < count; i++) rc[i] = render_file_write(&file[i], folder);
    while (*written < count && rc[*written] == OXL_OK) ++*written;
    if (*written < count) first = oxl_fail(ctx, rc[*written], "%s", oxl_error_text(&file[*written].own));
    for (int i = 0; i < count; i++) render_file_free(ctx, &file[i]);
    return first;
}

/* Removes renders of all views, since those of an earlier run may be of other views. */
static oxl_result render_files_remove(oxl_context *ctx, const struct render_files *f)
{
    static const char *const suffix[] = {RENDER_SUFFIXES};
    oxl_result rc = OXL_OK;
    for (int v = 0; v < oxl_scene_view_count(f->scene); v++)
        for (size_t i = 0; i < OXL_COUNT(suffix) && rc == OXL_OK; i++) {
            char *path;
            rc = render_file_path(ctx, f->folder, oxl_scene_view(f->scene, v)->name, suffix[i], &path);
            if (rc == OXL_OK) os_remove(path);
            oxl_free(ctx, path);
        }
    return rc;
}

OXL_INTERNAL oxl_result render_files_of(oxl_context *ctx, const struct render_files *f, int *count)
{
    struct renderer *r = NULL;
    struct render_file *file = oxl_alloc(ctx, RENDER_FILES_AT_ONCE, sizeof *file);
    oxl_result rc = oxl_make_folder(ctx, f->folder);
    *count = 0;
    if (rc == OXL_OK && !file) rc = OXL_ERR_MEMORY;
    if (rc == OXL_OK && f->what->replace) rc = render_files_remove(ctx, f);
    if (rc == OXL_OK) rc = renderer_create(ctx, &r);
    evaluate_begin(ctx, f->source, f->scene);
    while (rc == OXL_OK && *count < f->views) {
        int rendered, written;
        oxl_result wrote;
        rc = render_files_render(ctx, f, r, *count, file, &rendered);
        wrote = render_files_write(ctx, file, rendered, f->folder, &written);
        *count += written;
        if (wrote != OXL_OK) rc = wrote;
        if (rc == OXL_OK) rc = context_stopped(ctx);
    }
    renderer_free(ctx, r);
    oxl_free(ctx, file);
    return rc;
}

oxl_result oxl_render_views(oxl_context *ctx, const oxl_model *model, const oxl_scene *scene,
                            const oxl_imaging *imaging, const oxl_render_output *what, const char *folder,
                            int *count)
{
    int *view = oxl_alloc(ctx, (size_t)oxl_scene_view_count(scene) + 1, sizeof *view);
    struct render_files f = {model, scene, imaging, what, folder, view, 0};
    oxl_result rc;
    *count = 0;
    if (!view) return OXL_ERR_MEMORY;
    f.views = scene_views_of(scene, what->split, view);
    rc = render_names_check(ctx, scene);
    if (rc == OXL_OK) rc = render_files_of(ctx, &f, count);
    oxl_free(ctx, view);
    return rc;
}
