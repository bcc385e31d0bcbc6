/* scene_file.c - a loaded survey in one file, which is then mapped: points and tracks take memory only while
 * they are used.
 *
 * The file holds the scene's struct and arrays as they are in memory, so only the same build on the same kind
 * of machine can read it; `key` identifies the run. Invariant: a mapped scene has the same values as the one
 * that was written.
 */
#include "sparse.h"
#include "image.h"
#include "imaging.h"
#include "scene.h"

enum { SCENE_ARRAYS = 14 /* the key is the last */, SCENE_FILE_ALIGN = 64 };

struct scene_file {
    char magic[32];
    uint64_t size, bytes[SCENE_ARRAYS]; /* of the struct, of the arrays */
    struct oxl_scene scene;
};

static const char SCENE_FILE_MAGIC[32] = "oceanxl survey " OXL_VERSION;

struct scene_file_array {
    void *pointer; /* to the scene's pointer */
    size_t bytes;
};

static void scene_file_arrays(struct oxl_scene *s, struct scene_file_array out[SCENE_ARRAYS - 1])
{
    struct colmap *c = &s->colmap;
    const size_t views = (size_t)s->view_count;
    const struct scene_file_array all[SCENE_ARRAYS - 1] = {
        {&s->view, views * sizeof *s->view},
        {&s->point, s->point_count * sizeof *s->point},
        {&s->depth, s->depth_count * sizeof *s->depth},
        {&s->source, views * sizeof *s->source},
        {&s->on_disk, c->camera_count * sizeof *s->on_disk},
        {&c->camera, c->camera_count * sizeof *c->camera},
        {&c->image, c->image_count * sizeof *c->image},
        {&c->point, c->point_count * sizeof *c->point},
        {&c->track, c->track_count * sizeof *c->track},
        {&c->names, c->names_size},
        {&s->images, s->images ? strlen(s->images) + 1 : 0},
        {&s->masks, s->masks ? strlen(s->masks) + 1 : 0},
        {&c->folder, c->folder ? strlen(c->folder) + 1 : 0}};
    memcpy(out, all, sizeof all);
}

static size_t scene_file_padded(size_t bytes)
{
    return (bytes + SCENE_FILE_ALIGN - 1) / SCENE_FILE_ALIGN * SCENE_FILE_ALIGN;
}

static oxl_result scene_file_put(oxl_context *ctx, struct os_writer *w, const void *data, size_t bytes)
{
    static const char zero[SCENE_FILE_ALIGN];
    const size_t more = scene_file_padded(bytes) - bytes;
    if ((bytes == 0 || fwrite(data, 1, bytes, w->file) == bytes) && fwrite(zero, 1, more, w->file) == more)
        return OXL_OK;
    return oxl_fail(ctx, OXL_ERR_IO, "%s: writing failed\nfix: free space on the disk", w->path);
}

OXL_INTERNAL oxl_result scene_file_write(oxl_context *ctx, const char *path, const oxl_scene *scene,
                                         const char *key)
{
    struct scene_file *head = oxl_calloc(ctx, 1, sizeof *head);
    struct scene_file_array array[SCENE_ARRAYS - 1];
    struct os_writer w = {0};
    oxl_result rc =
        head ? os_writer_open(ctx, path, &w) : oxl_fail(ctx, OXL_ERR_MEMORY, "no memory to write %s", path);
    if (rc != OXL_OK) {
        oxl_free(ctx, head);
        return rc;
    }
    memcpy(head->magic, SCENE_FILE_MAGIC, sizeof head->magic);
    head->size = sizeof *head;
    head->scene = *scene;
    scene_file_arrays(&head->scene, array);
    for (int k = 0; k < SCENE_ARRAYS - 1; k++) head->bytes[k] = array[k].bytes;
    head->bytes[SCENE_ARRAYS - 1] = strlen(key) + 1;
    rc = scene_file_put(ctx, &w, head, sizeof *head);
    for (int k = 0; k < SCENE_ARRAYS - 1 && rc == OXL_OK; k++) {
        const void *data;
        memcpy(&data, array[k].pointer, sizeof data);
        rc = scene_file_put(ctx, &w, data, array[k].bytes);
    }
    if (rc == OXL_OK) rc = scene_file_put(ctx, &w, key, strlen(key) + 1);
    oxl_free(ctx, head);
    return os_writer_close(ctx, &w, rc);
}

/* Its bytes are those that the header announces, and it is of this run. */
static int scene_file_is_whole(const struct os_file_map *map, const char *key)
{
    const struct scene_file *head = (const void *)map->data;
    const size_t last = scene_file_padded(strlen(key) + 1);
    double size = (double)scene_file_padded(sizeof *head);
    if (map->size < sizeof *head + last || memcmp(head->magic, SCENE_FILE_MAGIC, sizeof head->magic))
        return 0;
    for (int k = 0; k < SCENE_ARRAYS; k++) size += (double)scene_file_padded(head->bytes[k]);
    return head->size == sizeof *head && size == (double)map->size &&
           head->bytes[SCENE_ARRAYS - 1] == strlen(key) + 1 &&
           !memcmp(map->data + map->size - last, key, strlen(key) + 1);
}

/* What holds pointers is copied. */
static oxl_result scene_file_own(oxl_context *ctx, oxl_scene *s)
{
    const oxl_view *view = s->view;
    const struct colmap_camera *camera = s->colmap.camera;
    s->view = oxl_alloc(ctx, (size_t)s->view_count + 1, sizeof *s->view);
    s->colmap.camera = oxl_alloc(ctx, s->colmap.camera_count + 1, sizeof *s->colmap.camera);
    if (!s->view || !s->colmap.camera)
        return oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for %d views", s->view_count);
    for (int i = 0; i < s->view_count; i++) {
        s->view[i] = view[i];
        s->view[i].name = s->colmap.names + s->colmap.image[s->source[i].image].name;
    }
    for (size_t i = 0; i < s->colmap.camera_count; i++) {
        s->colmap.camera[i] = camera[i];
        s->colmap.camera[i].file = "cameras.txt";
    }
    s->colmap.images_file = "images.txt";
    return scene_begin_cache(ctx, s, (size_t)s->view_count);
}

OXL_INTERNAL oxl_result scene_file_map(oxl_context *ctx, const char *path, const char *key, oxl_scene **out)
{
    struct os_file_map map = {0};
    const struct scene_file *head;
    struct scene_file_array array[SCENE_ARRAYS - 1];
    size_t offset = scene_file_padded(sizeof *head);
    oxl_scene *s = NULL;
    oxl_result rc = os_is_file(path) ? os_map_file(ctx, path, &map) : OXL_OK;
    *out = NULL;
    if (rc == OXL_OK && map.data && scene_file_is_whole(&map, key) && !(s = oxl_calloc(ctx, 1, sizeof *s)))
        rc = oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for a scene");
    if (!s) {
        os_unmap_file(ctx, &map);
        return rc;
    }
    head = (const void *)map.data;
    *s = head->scene;
    s->map = map;
    s->imaging = (struct imaging){0};
    s->cache = (struct image_cache){0};
    s->lpips = NULL;
    s->decoded = s->images = s->masks = s->colmap.folder = NULL; /* addresses of another process */
    scene_file_arrays(s, array);
    for (int k = 0; k < SCENE_ARRAYS - 1; k++) {
        const char *at = head->bytes[k] ? map.data + offset : NULL;
        memcpy(array[k].pointer, &at, sizeof at);
        offset += scene_file_padded(head->bytes[k]);
    }
    rc = scene_file_own(ctx, s);
    if (rc != OXL_OK) oxl_scene_free(ctx, s);
    else *out = s;
    return rc;
}
