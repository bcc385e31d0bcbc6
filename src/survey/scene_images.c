/* scene_images.c - finds and decodes images and masks of a scene, and keeps them in memory (image_cache.c) or
 * in files (image_file.c). */
#include "sparse.h"
#include "image.h"
#include "scene.h"
#include "scene_alpha.h"

/* Finds masks/NAME.png, with or without the extension in NAME, or else the mask that
 * the survey's files name. */
OXL_INTERNAL oxl_result scene_mask_path(oxl_context *ctx, const oxl_scene *scene, int view, char **out)
{
    const char *name = scene->view[view].name;
    const size_t own = scene->from_files ? scene_source_image(scene, view)->mask : 0;
    const char *base = path_base_name(name), *dot = strrchr(base, '.');
    const int whole = (int)strlen(name), bare = dot ? (int)(dot - name) : whole;
    for (int i = 0; i < 2 && scene->masks; i++) {
        struct text t = {.ctx = ctx};
        text_add(&t, "%s/%.*s.png", scene->masks, i == 0 ? whole : bare, name);
        if (text_take(&t, out) != OXL_OK) return OXL_ERR_MEMORY;
        if (os_is_file(*out)) return OXL_OK;
        oxl_free(ctx, *out);
    }
    name = own ? path_longest_tail(scene->colmap.folder, scene->colmap.names + own) : NULL;
    *out = name && os_is_file(PATH(scene->colmap.folder, "%s", name))
               ? oxl_path_join(ctx, scene->colmap.folder, name)
               : NULL;
    return OXL_OK;
}

OXL_INTERNAL oxl_result scene_set_decoded(oxl_context *ctx, const oxl_scene *scene, const char *folder)
{
    char **decoded = &scene->cache->decoded;
    oxl_free(ctx, *decoded);
    *decoded = folder ? oxl_strdup(ctx, folder) : NULL;
    return *decoded || !folder ? OXL_OK : OXL_ERR_MEMORY;
}

/* Loads the whole image of a view: from the file that an earlier request has left, or decoded, and then left
 * in a file. A file that cannot be written is only decoded again. */
static oxl_result scene_decode(oxl_context *ctx, const oxl_scene *scene, int view, const char *path,
                               const char *mask, struct training_image *out)
{
    const oxl_camera *to = &scene->view[view].camera;
    const struct colmap_camera *from = &scene->colmap.camera[scene->source[view].camera];
    const char *folder = scene->cache->decoded;
    const struct image_alpha alpha = scene_alpha(scene);
    struct text name = {.ctx = ctx};
    uint64_t key;
    oxl_result rc = OXL_OK;
    if (!folder) return image_load_training(ctx, path, mask, &alpha, from, to, out);
    key = image_file_key(path, mask, &alpha, from, to);
    text_add(&name, "%s/%016llx", folder, (unsigned long long)key);
    if (name.failed || !image_file_read(ctx, name.data, key, to, out)) {
        rc = image_load_training(ctx, path, mask, &alpha, from, to, out);
        if (rc == OXL_OK && !name.failed) image_file_write(ctx, name.data, key, out);
    }
    text_free(&name);
    return rc;
}

static oxl_result scene_mask_fixed(oxl_context *ctx, const oxl_scene *scene, int view,
                                   struct training_image *image)
{
    const struct pixels *mask = &scene->fixed[scene->fixed_of[scene->source[view].camera]];
    return mask->data ? image_add_mask(ctx, mask, image) : OXL_OK;
}

OXL_INTERNAL oxl_result scene_load_image(oxl_context *ctx, const oxl_scene *scene, int view,
                                         struct training_image *out)
{
    char *mask = NULL;
    oxl_result rc = scene_mask_path(ctx, scene, view, &mask);
    if (rc == OXL_OK)
        rc = scene_decode(ctx, scene, view, PATH(scene->images, "%s", scene->view[view].name), mask, out);
    oxl_free(ctx, mask);
    return rc == OXL_OK && scene->fixed ? scene_mask_fixed(ctx, scene, view, out) : rc;
}

OXL_INTERNAL double scene_file_pixels(const oxl_scene *scene, int view)
{
    const struct colmap_camera *camera = scene->from_files ? scene_source_camera(scene, view) : NULL;
    const double side = camera ? scene->on_disk[scene->source[view].camera] : 0;
    return camera ? side * camera->width * side * camera->height : 0;
}

OXL_INTERNAL void scene_set_cache(const oxl_scene *scene, size_t bytes)
{
    if (scene->from_files) scene->cache->limit = bytes;
}

OXL_INTERNAL oxl_result scene_begin_cache(oxl_context *ctx, oxl_scene *scene, size_t count)
{
    const struct image_loader loader = {scene_load_image, scene_file_pixels, scene};
    scene->cache = image_cache_begin(ctx, count, &loader);
    return scene->cache ? OXL_OK : OXL_ERR_MEMORY;
}

OXL_INTERNAL const struct training_image *scene_image(oxl_context *ctx, const oxl_scene *scene, int view)
{
    return image_cache_get(ctx, scene->cache, view);
}

OXL_INTERNAL int scene_misses_too_many(const oxl_scene *scene, int more)
{
    return scene->from_files &&
           scene->stats.images_missing + more > scene->may_miss * (double)scene->colmap.image_count;
}

OXL_INTERNAL void scene_images_ahead(oxl_context *ctx, const oxl_scene *scene, const int *view, int count)
{
    if (scene->from_files) image_cache_ahead(ctx, scene->cache, view, count);
}

OXL_INTERNAL oxl_result scene_copy_image(oxl_context *ctx, const oxl_scene *scene, int view, oxl_image *out)
{
    const struct training_image *image;
    oxl_result rc;
    *out = (oxl_image){0};
    if (view < 0 || view >= scene->view_count)
        return oxl_fail(ctx, OXL_ERR_USAGE, "view %d does not exist: the scene has %d views", view,
                        scene->view_count);
    image = scene_image(ctx, scene, view);
    if (!image) return ctx->failed;
    rc = oxl_image_create(ctx, image->width, image->height, out);
    if (rc == OXL_OK && image->mask) {
        out->weight = oxl_alloc(ctx, (size_t)image->width * image->height, sizeof *out->weight);
        if (!out->weight) rc = OXL_ERR_MEMORY;
    }
    if (rc == OXL_OK) image_from_training(ctx, image, NULL, out->rgb, out->weight);
    else oxl_image_free(ctx, out);
    return rc;
}

oxl_result oxl_scene_image(oxl_context *ctx, const oxl_scene *scene, int view, const float background[3],
                           oxl_image *out)
{
    float behind[3];
    scene_background(scene, background ? background : (const float[3]){-1, -1, -1}, behind);
    scene_set_background(ctx, scene, behind);
    return scene_copy_image(ctx, scene, view, out);
}
