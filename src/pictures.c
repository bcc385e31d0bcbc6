/* pictures.c - what the model draws where the photographs were taken, as files to look at and to measure with.
 *
 * Invariant: no name of a photograph leads out of the folder.
 */
#include "internal.h"

/* FOLDER/NAME + suffix, with the folders that NAME asks for, none of them outside FOLDER; NULL with the error set. */
static char *pictures_path(oxl_context *ctx, const char *folder, const char *name, const char *suffix)
{
    struct text t = {.ctx = ctx};
    char       *path, *slash;
    const int   escapes = name[0] == '/' || strstr(name, "..");
    text_add(&t, "%s/%s%s", folder, name, suffix);
    if (text_take(&t, &path) != OXL_OK) {
        oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for the name of a picture");
        return NULL;
    }
    for (char *c = path + strlen(folder) + 1; escapes && *c; c++)
        if (*c == '/') *c = '_';
    slash  = strrchr(path, '/');
    *slash = 0;
    if (os_make_folder(ctx, path) != OXL_OK) {
        oxl_free(ctx, path);
        return NULL;
    }
    *slash = '/';
    return path;
}

static oxl_result pictures_write_image(oxl_context *ctx, const char *folder, const char *name, const char *suffix,
                                       const oxl_image *image)
{
    char            *path = pictures_path(ctx, folder, name, suffix);
    const oxl_result rc   = path ? oxl_image_write(ctx, path, image) : ctx->failed;
    oxl_free(ctx, path);
    return rc;
}

/* Portable float map: rows from the bottom, the sign of the scale tells the byte order. */
static oxl_result pictures_write_pfm(oxl_context *ctx, const char *folder, const char *name, const float *depth, int width,
                                     int height)
{
    const uint16_t   one    = 1;
    const int        small  = *(const unsigned char *)&one; /* little endian */
    char            *path   = pictures_path(ctx, folder, name, ".depth.pfm");
    struct os_writer writer = {0};
    oxl_result       rc     = path ? os_writer_open(ctx, path, &writer) : ctx->failed;
    if (rc != OXL_OK) goto done;
    fprintf(writer.file, "Pf\n%d %d\n%s\n", width, height, small ? "-1.0" : "1.0");
    for (int y = height - 1; y >= 0; y--) fwrite(depth + (size_t)y * width, sizeof *depth, (size_t)width, writer.file);
    rc = os_writer_close(ctx, &writer, OXL_OK);
done:
    oxl_free(ctx, path);
    return rc;
}

/* Thousandths, so millimetres where depth is in metres; 0: nothing there, 65535: that or more. */
static oxl_result pictures_write_depth16(oxl_context *ctx, const char *folder, const char *name, const float *depth, int width,
                                         int height)
{
    const size_t pixels = (size_t)width * (size_t)height;
    char        *path   = pictures_path(ctx, folder, name, ".depth16.png");
    uint16_t    *value  = oxl_alloc(ctx, pixels, sizeof *value);
    oxl_result   rc     = path ? OXL_OK : ctx->failed;
    if (rc == OXL_OK && !value) rc = oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for a depth map of %d x %d", width, height);
    for (size_t i = 0; rc == OXL_OK && i < pixels; i++)
        value[i] = depth[i] > 0 ? (uint16_t)OXL_CLAMP(1000 * depth[i] + 0.5f, 1, 65535) : 0;
    if (rc == OXL_OK) rc = image_write_png16(ctx, path, value, width, height);
    oxl_free(ctx, value);
    oxl_free(ctx, path);
    return rc;
}

/* A picture of depth that needs no limits: mean / (mean + z), so 1 is here, 1/2 the mean depth, 0 far or nothing. */
static oxl_result pictures_write_depth(oxl_context *ctx, const char *folder, const char *name, const float *depth, int width,
                                       int height)
{
    const size_t pixels  = (size_t)width * height;
    oxl_image    picture = {0};
    double       sum     = 0;
    size_t       met     = 0;
    oxl_result   rc      = oxl_image_create(ctx, width, height, &picture);
    if (rc != OXL_OK) return rc;
    for (size_t i = 0; i < pixels; i++)
        if (depth[i] > 0) sum += depth[i], met++;
    for (size_t i = 0; i < pixels; i++) {
        const float mean = (float)(met ? sum / (double)met : 1), v = depth[i] > 0 ? mean / (mean + depth[i]) : 0;
        for (int c = 0; c < 3; c++) picture.rgb[c * pixels + i] = v;
    }
    rc = pictures_write_image(ctx, folder, name, ".depth.png", &picture);
    if (rc == OXL_OK) rc = pictures_write_pfm(ctx, folder, name, depth, width, height);
    if (rc == OXL_OK) rc = pictures_write_depth16(ctx, folder, name, depth, width, height);
    oxl_image_free(ctx, &picture);
    return rc;
}

/* One that cannot be read is not drawn: the evaluation has said so. */
static oxl_result pictures_copy_photograph(oxl_context *ctx, oxl_scene *scene, int index, const char *folder)
{
    oxl_image  photograph = {0};
    oxl_result rc         = oxl_scene_image(ctx, scene, index, &photograph);
    if (rc == OXL_ERR_INPUT) return OXL_OK;
    if (rc == OXL_OK) rc = pictures_write_image(ctx, folder, oxl_scene_view(scene, index)->name, ".photo.png", &photograph);
    oxl_image_free(ctx, &photograph);
    return rc;
}

static oxl_result pictures_draw_view(oxl_context *ctx, struct renderer *r, const oxl_model *model, oxl_scene *scene, int index,
                                     const oxl_pictures *what, const char *folder)
{
    const oxl_view *view  = oxl_scene_view(scene, index);
    const int       width = view->camera.width, height = view->camera.height;
    oxl_image       drawn = {0};
    float          *depth = NULL;
    oxl_result      rc    = OXL_OK;

    oxl_render_options options = oxl_render_options_default();
    options.near_plane         = (float)scene_near_plane(scene);
    if (what->depth) {
        depth = oxl_alloc(ctx, (size_t)width * height, sizeof *depth);
        if (!depth) {
            rc = oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for a depth map of %d x %d", width, height);
            goto done;
        }
    }
    rc = renderer_draw(ctx, r, model, &view->camera, &options, &drawn, depth);
    for (size_t i = 0; rc == OXL_OK && depth && what->unit > 0 && i < (size_t)width * height; i++) depth[i] *= (float)what->unit;
    if (rc == OXL_OK) rc = pictures_write_image(ctx, folder, view->name, ".png", &drawn);
    if (rc == OXL_OK && depth) rc = pictures_write_depth(ctx, folder, view->name, depth, width, height);
    if (rc == OXL_OK && what->photographs) rc = pictures_copy_photograph(ctx, scene, index, folder);
done:
    oxl_image_free(ctx, &drawn);
    oxl_free(ctx, depth);
    return rc;
}

oxl_result oxl_render_views(oxl_context *ctx, const oxl_model *model, oxl_scene *scene, const oxl_pictures *what,
                            const char *folder, int *count)
{
    struct renderer *r     = NULL;
    oxl_result       rc    = os_make_folder(ctx, folder);
    int             *view  = oxl_alloc(ctx, (size_t)oxl_scene_view_count(scene) + 1, sizeof *view);
    const int        asked = view ? scene_views_of(scene, what->split, view) : 0;
    *count                 = 0;
    if (rc == OXL_OK && !view) rc = oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for a list of views");
    if (rc == OXL_OK) rc = renderer_create(ctx, &r);
    while (rc == OXL_OK && *count < asked) {
        rc = pictures_draw_view(ctx, r, model, scene, view[*count], what, folder);
        *count += rc == OXL_OK;
    }
    renderer_free(ctx, r);
    oxl_free(ctx, view);
    return rc;
}
