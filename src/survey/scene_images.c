/* scene_images.c - finds and decodes images and masks of a scene, and keeps them in memory or in files
 * (image_file.c): loads them on request or ahead of it, and evicts them when the cache is full.
 *
 * Images take no more memory than the limit, apart from the image requested last. Invariant: the state of the
 * cache does not change results.
 */
#include "sparse.h"
#include "image.h"
#include "scene.h"

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
               ? oxl_strdup(ctx, PATH(scene->colmap.folder, "%s", name))
               : NULL;
    return OXL_OK;
}

/* Loads the whole image of a view for a camera: from the file that an earlier request has left, or decoded,
 * and then left in a file. A file that cannot be written is only decoded again. */
static oxl_result scene_decode(oxl_context *ctx, const oxl_scene *scene, int view, const oxl_camera *to,
                               const char *mask, struct training_image *out)
{
    const char *path = PATH(scene->images, "%s", scene->view[view].name);
    const struct colmap_camera *from = scene_source_camera(scene, view);
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

static oxl_result scene_load_as(oxl_context *ctx, const oxl_scene *scene, int view, const oxl_camera *to,
                                struct training_image *out)
{
    char *mask = NULL;
    oxl_result rc = scene_mask_path(ctx, scene, view, &mask);
    if (rc == OXL_OK) rc = scene_decode(ctx, scene, view, to, mask, out);
    oxl_free(ctx, mask);
    return rc;
}

static oxl_result scene_load_image(oxl_context *ctx, const oxl_scene *scene, int view,
                                   struct training_image *out)
{
    const struct pixels *fixed =
        scene->fixed ? &scene->fixed[scene->fixed_of[scene->source[view].camera]] : NULL;
    oxl_result rc = scene_load_as(ctx, scene, view, &scene->view[view].camera, out);
    if (rc == OXL_OK && fixed && fixed->data) rc = image_add_mask(ctx, fixed, out);
    if (rc != OXL_OK) image_training_free(ctx, out);
    return rc;
}

OXL_INTERNAL oxl_result scene_load_small(oxl_context *ctx, const oxl_scene *scene, int view, int width,
                                         int height, struct training_image *out)
{
    oxl_camera to = scene->view[view].camera;
    const double x = (double)width / to.width, y = (double)height / to.height;
    to.fx *= x, to.cx *= x, to.fy *= y, to.cy *= y;
    to.width = width, to.height = height;
    return scene_load_as(ctx, scene, view, &to, out);
}

OXL_INTERNAL double scene_file_pixels(const oxl_scene *scene, int view)
{
    const struct colmap_camera *camera = scene->from_files ? scene_source_camera(scene, view) : NULL;
    const double side = camera ? scene->on_disk[scene->source[view].camera] : 0;
    return camera ? side * camera->width * side * camera->height : 0;
}

/* ---------------- which images are in memory */

OXL_INTERNAL void scene_set_cache(const oxl_scene *scene, size_t bytes)
{
    if (scene->from_files) scene->cache->limit = bytes;
}

OXL_INTERNAL oxl_result scene_begin_cache(oxl_context *ctx, oxl_scene *scene, size_t count)
{
    struct image_cache *c = scene->cache = oxl_calloc(ctx, 1, sizeof *c);
    if (!c) return OXL_ERR_MEMORY;
    *c = (struct image_cache){.image = oxl_calloc(ctx, count + 1, sizeof *c->image),
                              .used = oxl_calloc(ctx, count + 1, sizeof *c->used),
                              .limit = SIZE_MAX};
    return c->image && c->used ? OXL_OK : OXL_ERR_MEMORY;
}

OXL_INTERNAL void scene_free_cache(oxl_context *ctx, const oxl_scene *scene)
{
    struct image_cache *c = scene->cache;
    if (!c) return;
    for (int i = 0; c->image && i < scene->view_count; i++) image_training_free(ctx, &c->image[i]);
    OXL_FREE(ctx, c->image, c->used, c->decoded);
    oxl_free(ctx, c);
}

static size_t scene_image_bytes(const struct training_image *image)
{
    return (size_t)image->width * image->height * (image->mask ? 4 : 3);
}

/* Evicts the most recently used images until all but `keep` fit into `limit`. Each epoch uses all images in a
 * new order, so the most recent one is needed last: with memory for half of the images 50 % of the requests
 * are hits; with LRU 15 %. */
static void scene_evict(oxl_context *ctx, const oxl_scene *scene, int keep, size_t limit)
{
    struct image_cache *c = scene->cache;
    while (c->held > limit) {
        int latest = -1;
        for (int i = 0; i < scene->view_count; i++)
            if (i != keep && c->image[i].rgb && (latest < 0 || c->used[i] > c->used[latest])) latest = i;
        if (latest < 0) return;
        c->held -= scene_image_bytes(&c->image[latest]);
        image_training_free(ctx, &c->image[latest]);
    }
}

OXL_INTERNAL const struct training_image *scene_image(oxl_context *ctx, const oxl_scene *scene, int view)
{
    struct image_cache *c = scene->cache;
    struct training_image *image = &c->image[view];
    oxl_result rc;
    c->used[view] = ++c->clock;
    if (image->rgb) return image;
    rc = scene_load_image(ctx, scene, view, image);
    if (rc == OXL_ERR_MEMORY && c->held > 0) { /* Makes room for the decoder, and tries again. */
        scene_evict(ctx, scene, view, 0);
        rc = scene_load_image(ctx, scene, view, image);
    }
    if (rc != OXL_OK) return NULL;
    c->held += scene_image_bytes(image);
    scene_evict(ctx, scene, view, c->limit);
    return image;
}

/* Chooses views that are not in memory, at most one per thread, and as many as can be decoded in a quarter of
 * the cache. */
OXL_INTERNAL void scene_images_ahead(oxl_context *ctx, const oxl_scene *scene, const int *view, int count)
{
    struct image_cache *c = scene->cache;
    struct training_image read[SCENE_AHEAD] = {{0}};
    int chosen[SCENE_AHEAD], n = 0;
    size_t bytes = 0;
    /* Drops errors, which are reported when the image is requested. */
    oxl_context own = context_for_thread(ctx);
    if (!scene->from_files || count < 1 || c->image[view[0]].rgb) return;
    for (int i = 0; i < count && n < OXL_MIN(ctx->threads, SCENE_AHEAD); i++) {
        const double more = SCENE_DECODE_BYTES * scene_file_pixels(scene, view[i]);
        if (c->image[view[i]].rgb) continue;
        if ((double)bytes + more > (double)(c->limit / 4)) break;
        bytes += (size_t)more;
        chosen[n++] = view[i];
    }
    if (n < 2) return;
    scene_evict(ctx, scene, -1, c->limit - bytes);
#pragma omp parallel for schedule(dynamic, 1) num_threads(ctx->threads) firstprivate(own)
    for (int i = 0; i < n; i++) scene_load_image(&own, scene, chosen[i], &read[i]);
    for (int i = 0; i < n; i++) {
        if (!read[i].rgb) continue;
        c->image[chosen[i]] = read[i];
        c->used[chosen[i]] = 0; /* evicted last, since it is needed soon */
        c->held += scene_image_bytes(&read[i]);
    }
    scene_evict(ctx, scene, -1, c->limit);
}

/* ---------------- transparent pixels */

OXL_INTERNAL int scene_is_composited(const oxl_scene *scene)
{
    return scene->transparent > 0 && !scene->alpha_masks;
}

OXL_INTERNAL struct image_alpha scene_alpha(const oxl_scene *scene)
{
    struct image_alpha alpha = {.masks = scene->alpha_masks};
    memcpy(alpha.background, scene->cache->background, sizeof alpha.background);
    return alpha;
}

OXL_INTERNAL void scene_background(const oxl_scene *scene, const float wanted[3], float out[3])
{
    for (int c = 0; c < 3; c++) {
        const float v = wanted && wanted[0] >= 0 ? wanted[c] : scene_is_composited(scene);
        /* Rounds to the 8 bits of the images. */
        out[c] = scene_is_composited(scene) ? floorf(v * 255 + 0.5f) / 255 : v;
    }
}

OXL_INTERNAL void scene_set_background(oxl_context *ctx, const oxl_scene *scene, const float rgb[3])
{
    uint8_t now[3];
    if (!scene_is_composited(scene)) return;
    for (int c = 0; c < 3; c++) now[c] = (uint8_t)(rgb[c] * 255 + 0.5f);
    if (!memcmp(scene->cache->background, now, sizeof now)) return;
    memcpy(scene->cache->background, now, sizeof now);
    scene_evict(ctx, scene, -1, 0);
}

/* ---------------- images for others */

OXL_INTERNAL int scene_misses_too_many(const oxl_scene *scene, int more)
{
    return scene->from_files &&
           scene->stats.images_missing + more > scene->max_missing * (double)scene->colmap.image_count;
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
    if (rc == OXL_OK && image->mask &&
        !(out->weight = oxl_alloc(ctx, (size_t)image->width * image->height, sizeof *out->weight)))
        rc = OXL_ERR_MEMORY;
    if (rc == OXL_OK) image_from_training(ctx, image, NULL, out->rgb, out->weight);
    else oxl_image_free(ctx, out);
    return rc;
}

oxl_result oxl_scene_image(oxl_context *ctx, const oxl_scene *scene, int view, const float background[3],
                           oxl_image *out)
{
    float behind[3];
    scene_background(scene, background, behind);
    scene_set_background(ctx, scene, behind);
    return scene_copy_image(ctx, scene, view, out);
}
