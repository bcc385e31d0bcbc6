/* render_files.c - writes renders of the views, their images and depth maps as files.
 *
 * Invariant: no name leads out of its folder by "..", and none is longer than file systems take.
 */
#include "job.h"
#include "../evaluate/evaluate.h"
#include "../formats/survey_read.h"
#include "../render/render.h"
#include "../survey/scene.h"

enum {
    /* bytes of a name without its suffix; the limit of file systems, 255, leaves room
     * for suffix and ".PID.tmp" */
    RENDER_NAME_LENGTH = 200,
    RENDER_NAME_DIGITS = 16 /* digits of the checksum of the whole name, in a name that is cut */
};

/* Lists the files of a view; all but the last one are images. */
enum { RENDER_VIEW, RENDER_IMAGE, RENDER_CLEAR, RENDER_GREY, RENDER_DEPTH, RENDER_PARTS };
static const char *const RENDER_SUFFIX[RENDER_PARTS] = {".png", ".image.png", ".clear.png", ".depth.png",
                                                        ".depth.pfm"};

/* Cuts a long name at the beginning of a character, and adds a checksum of the whole one, so that names stay
 * different. */
oxl_result oxl_render_path(oxl_context *ctx, const char *folder, const char *view, const char *suffix,
                           char **out)
{
    const int escapes = view[0] == '/' || strstr(view, "..");
    struct text t = {.ctx = ctx};
    text_add(&t, "%s/%s", folder, view);
    if (!t.failed) {
        size_t last;
        for (char *c = t.data + strlen(folder) + 1; *c; c++)
            if ((*c == '/' && escapes) || (unsigned char)*c < ' ') *c = '_';
        last = (size_t)(strrchr(t.data, '/') + 1 - t.data);
        if (t.size - last > RENDER_NAME_LENGTH) {
            t.size = last + RENDER_NAME_LENGTH - RENDER_NAME_DIGITS - 1;
            while (t.size > last && ((unsigned char)t.data[t.size] & 0xC0) == 0x80) t.size--;
            text_add(&t, "-%016llx", (unsigned long long)checksum_add(CHECKSUM_SEED, view, strlen(view)));
        }
    }
    text_add(&t, "%s", suffix);
    return text_take(&t, out);
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

/* ---------------- a view */

/* Holds what is written of a view; images that are not wanted, or cannot be read, are empty. */
struct rendered {
    oxl_image image[RENDER_DEPTH];
    float *depth; /* (H,W) or NULL */
};

static void rendered_free(oxl_context *ctx, struct rendered *r)
{
    for (int k = 0; k < RENDER_DEPTH; k++) oxl_image_free(ctx, &r->image[k]);
    oxl_free(ctx, r->depth);
}

/* Sets the unit of depth, and shows it as grey for any range: mean / (mean + z), which is 1 at the camera,
 * 1/2 at the mean depth, 0 at infinity or without depth. */
OXL_INTERNAL void render_depth_grey(float *depth, size_t pixels, double unit, float *grey)
{
    double sum = 0;
    size_t met = 0;
    float mean;
    for (size_t i = 0; i < pixels; i++) {
        depth[i] = OXL_MAX(depth[i], 0) * (unit > 0 ? (float)unit : 1);
        if (depth[i] > 0) sum += depth[i], met++;
    }
    mean = (float)(met ? sum / (double)met : 1);
    for (size_t i = 0; i < 3 * pixels; i++) {
        const float z = depth[i % pixels];
        grey[i] = z > 0 ? mean / (mean + z) : 0;
    }
}

/* Renders a view without the medium, too, if there is an image and a medium. */
static oxl_result render_one(oxl_context *ctx, const struct render_files *f, struct renderer *r, int view,
                             struct rendered *out)
{
    const oxl_camera *camera = &f->scene->view[view].camera;
    const size_t pixels = (size_t)camera->width * camera->height;
    const oxl_imaging *imaging = f->what->clear ? NULL : f->imaging;
    oxl_result rc = OXL_OK;
    if (f->what->depth) {
        rc = oxl_image_create(ctx, camera->width, camera->height, &out->image[RENDER_GREY]);
        if (rc == OXL_OK && !(out->depth = oxl_alloc(ctx, pixels, sizeof *out->depth))) rc = OXL_ERR_MEMORY;
    }
    if (rc == OXL_OK)
        rc = evaluate_draw(ctx, &(struct drawn){r, f->source, f->scene, imaging}, view,
                           &out->image[RENDER_VIEW], out->depth);
    if (rc == OXL_OK && out->depth)
        render_depth_grey(out->depth, pixels, f->what->unit, out->image[RENDER_GREY].rgb);
    if (rc == OXL_OK && f->what->images)
        rc = scene_copy_image(ctx, f->scene, view, &out->image[RENDER_IMAGE]);
    if (rc == OXL_ERR_INPUT) rc = OXL_OK; /* Skips an unreadable image, which the evaluation has reported. */
    if (rc == OXL_OK && out->image[RENDER_IMAGE].rgb && imaging && imaging_alters_colours(imaging))
        rc = evaluate_draw(ctx, &(struct drawn){r, f->source, f->scene, NULL}, view,
                           &out->image[RENDER_CLEAR], NULL);
    return rc;
}

/* Writes one of a view's files, and makes the folders in its name. */
static oxl_result render_write_part(oxl_context *ctx, const char *folder, const char *name, int part,
                                    const struct rendered *r)
{
    const oxl_image *image = &r->image[part < RENDER_DEPTH ? part : RENDER_GREY];
    char *path = NULL, *slash;
    oxl_result rc = image->rgb ? oxl_render_path(ctx, folder, name, RENDER_SUFFIX[part], &path) : OXL_OK;
    if (!path) return rc;
    slash = strrchr(path, '/');
    *slash = 0;
    rc = oxl_make_folder(ctx, path);
    *slash = '/';
    if (rc == OXL_OK)
        rc = part < RENDER_DEPTH ? oxl_image_write(ctx, path, image)
                                 : oxl_write_pfm(ctx, path, r->depth, image->width, image->height);
    oxl_free(ctx, path);
    return rc;
}

/* Writes the files of a view side by side. */
static oxl_result render_write_all(oxl_context *ctx, const char *folder, const char *name,
                                   const struct rendered *r)
{
    oxl_context own[RENDER_PARTS];
    oxl_result rc[RENDER_PARTS];
#pragma omp parallel for schedule(dynamic, 1) num_threads(ctx->threads)
    for (int k = 0; k < RENDER_PARTS; k++) {
        own[k] = context_for_thread(ctx);
        rc[k] = render_write_part(&own[k], folder, name, k, r);
    }
    for (int k = 0; k < RENDER_PARTS; k++)
        if (rc[k] != OXL_OK) return oxl_fail(ctx, rc[k], "%s", oxl_error_text(&own[k]));
    return OXL_OK;
}

/* ---------------- a folder */

/* Removes renders of all views, since those of an earlier run may be of other views. */
static oxl_result render_remove(oxl_context *ctx, const oxl_scene *scene, const char *folder)
{
    oxl_result rc = OXL_OK;
    for (int i = 0; i < RENDER_PARTS * scene->view_count && rc == OXL_OK; i++) {
        char *path;
        rc = oxl_render_path(ctx, folder, scene->view[i / RENDER_PARTS].name, RENDER_SUFFIX[i % RENDER_PARTS],
                             &path);
        if (rc == OXL_OK) os_remove(path);
        oxl_free(ctx, path);
    }
    return rc;
}

OXL_INTERNAL oxl_result render_files_of(oxl_context *ctx, const struct render_files *f, int *count)
{
    struct renderer *r = NULL;
    oxl_result rc = oxl_make_folder(ctx, f->folder);
    if (rc == OXL_OK && f->what->replace) rc = render_remove(ctx, f->scene, f->folder);
    if (rc == OXL_OK) rc = renderer_create(ctx, &r);
    evaluate_begin(ctx, f->source, f->scene);
    for (*count = 0; rc == OXL_OK && *count < f->views; *count += rc == OXL_OK) {
        const int view = f->view[*count];
        struct rendered files = {.depth = NULL};
        if (f->what->images) scene_images_ahead(ctx, f->scene, f->view + *count, f->views - *count);
        rc = context_stopped(ctx);
        if (rc == OXL_OK) rc = render_one(ctx, f, r, view, &files);
        if (rc == OXL_OK) rc = render_write_all(ctx, f->folder, f->scene->view[view].name, &files);
        rendered_free(ctx, &files);
    }
    renderer_free(ctx, r);
    return rc;
}

oxl_result oxl_render_views(oxl_context *ctx, const oxl_model *model, const oxl_scene *scene,
                            const oxl_imaging *imaging, const oxl_render_output *what, const char *folder,
                            int *count)
{
    int *view = oxl_alloc(ctx, (size_t)scene->view_count + 1, sizeof *view);
    struct render_files f = {model, scene, imaging, what, folder, view, 0};
    oxl_result rc;
    *count = 0;
    if (!view) return OXL_ERR_MEMORY;
    f.views = scene_views_of(scene, what->split, view);
    rc = render_files_of(ctx, &f, count);
    oxl_free(ctx, view);
    return rc;
}

/* Tells by the words that begin lines, whatever the survey; a damaged file is refused where it is read. */
int oxl_has_gains_alone(oxl_context *ctx, const char *model_path)
{
    const char *path = PATH_BESIDE(model_path, "imaging.txt");
    struct os_file_map map = {0};
    int is_alone;
    if (!os_is_file(PATH_BESIDE(model_path, "scene_clear.ply")) || !os_is_file(path) ||
        os_read_file(ctx, path, &map) != OXL_OK)
        return 0;
    is_alone = strstr(map.data, "\ngain ") && !strstr(map.data, "\nlamp ") && !strstr(map.data, "\nbD ");
    os_release_file(ctx, &map);
    return is_alone;
}
