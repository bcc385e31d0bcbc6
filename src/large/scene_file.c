/* scene_file.c - a loaded survey in one file, which is then mapped: points and tracks take memory only while
 * they are used.
 *
 * The file holds the scene's struct and arrays as they are in memory, so only the same build on the same kind
 * of machine can read it; `key` identifies the run. The last SCENE_FILE_ALIGN bytes begin with the checksum
 * of all others. Invariant: a mapped scene has the same values as the one that was written; all its indices
 * and counts lie within its arrays, whatever the file holds.
 */
#include "large.h"
#include "../survey/sparse.h"
#include "../survey/image.h"
#include "../survey/imaging.h"
#include "../survey/scene.h"

enum {
    SCENE_ARRAYS = 14, /* the key is the last */
    SCENE_FILE_ALIGN = 64,
    SCENE_FILE_CHUNK = 1 << 16, /* bytes that are checked at once: mapped pages would count as memory */
    /* places in scene_file_arrays */
    SCENE_POINTS = 7,
    SCENE_TRACKS = 8,
    SCENE_IMAGES = 10,
    SCENE_MASKS = 11,
    SCENE_FOLDER = 12
};

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

struct scene_file_writer {
    struct os_writer w;
    uint64_t sum;
};

static int scene_file_put_all(struct scene_file_writer *out, const void *data, size_t bytes)
{
    if (bytes) out->sum = checksum_add(out->sum, data, bytes);
    return bytes == 0 || fwrite(data, 1, bytes, out->w.file) == bytes;
}

/* Writes data, and adds it to the checksum; the last bytes are padded with zeros. */
static oxl_result scene_file_put(oxl_context *ctx, struct scene_file_writer *out, const void *data,
                                 size_t bytes)
{
    const size_t whole = bytes / SCENE_FILE_ALIGN * SCENE_FILE_ALIGN, rest = bytes - whole;
    char last[SCENE_FILE_ALIGN] = {0};
    if (rest) memcpy(last, (const char *)data + whole, rest);
    if (scene_file_put_all(out, data, whole) && scene_file_put_all(out, last, rest ? sizeof last : 0))
        return OXL_OK;
    return oxl_fail(ctx, OXL_ERR_IO, "%s: writing failed\nfix: free space on the disk", out->w.path);
}

OXL_INTERNAL oxl_result scene_file_write(oxl_context *ctx, const char *path, const oxl_scene *scene,
                                         const char *key)
{
    struct scene_file *head = oxl_calloc(ctx, 1, sizeof *head);
    struct scene_file_array array[SCENE_ARRAYS - 1];
    struct scene_file_writer w = {.sum = CHECKSUM_SEED};
    uint64_t sum;
    oxl_result rc =
        head ? os_writer_open(ctx, path, &w.w) : oxl_fail(ctx, OXL_ERR_MEMORY, "no memory to write %s", path);
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
    sum = w.sum;
    if (rc == OXL_OK) rc = scene_file_put(ctx, &w, &sum, sizeof sum);
    oxl_free(ctx, head);
    return os_writer_close(ctx, &w.w, rc);
}

/* Returns 1 if the file's bytes are those that the header announces, and it is of this run. */
static int scene_file_is_whole(const struct os_file_map *map, const char *key)
{
    const struct scene_file *head = (const void *)map->data;
    const size_t last = scene_file_padded(strlen(key) + 1);
    double size = (double)scene_file_padded(sizeof *head) + SCENE_FILE_ALIGN;
    if (map->size < sizeof *head + last + SCENE_FILE_ALIGN ||
        memcmp(head->magic, SCENE_FILE_MAGIC, sizeof head->magic))
        return 0;
    for (int k = 0; k < SCENE_ARRAYS; k++) {
        if (head->bytes[k] > map->size) return 0;
        size += (double)scene_file_padded(head->bytes[k]);
    }
    return head->size == sizeof *head && size == (double)map->size &&
           head->bytes[SCENE_ARRAYS - 1] == strlen(key) + 1 &&
           !memcmp(map->data + map->size - SCENE_FILE_ALIGN - last, key, strlen(key) + 1);
}

/* Calls `check` with the bytes from `offset` on, in pieces. 1: read, and each was right. */
static int scene_file_pieces(oxl_context *ctx, const char *path, uint64_t offset, uint64_t bytes,
                             size_t piece, int (*check)(void *user, const void *data, size_t size),
                             void *user)
{
    struct os_reader file;
    char *data = oxl_alloc(ctx, piece, 1);
    int good = data && os_reader_open(ctx, path, &file) == OXL_OK;
    if (good) {
        good = os_reader_seek(ctx, &file, offset) == OXL_OK;
        for (size_t got; good && bytes > 0; bytes -= got) {
            const size_t want = (size_t)OXL_MIN(bytes, (uint64_t)piece);
            good = os_reader_read(ctx, &file, data, want, &got) == OXL_OK && got == want &&
                   check(user, data, got);
        }
        os_reader_close(&file);
    }
    oxl_free(ctx, data);
    return good;
}

static int scene_file_add_sum(void *user, const void *data, size_t size)
{
    *(uint64_t *)user = checksum_add(*(uint64_t *)user, data, size);
    return 1;
}

static int scene_file_has_sum(oxl_context *ctx, const char *path, const struct os_file_map *map)
{
    uint64_t sum = CHECKSUM_SEED, stored;
    memcpy(&stored, map->data + map->size - SCENE_FILE_ALIGN, sizeof stored);
    return scene_file_pieces(ctx, path, 0, map->size - SCENE_FILE_ALIGN, SCENE_FILE_CHUNK, scene_file_add_sum,
                             &sum) &&
           sum == stored;
}

/* ---------------- ranges */

static int scene_file_point_is_good(void *user, const void *data, size_t size)
{
    const struct colmap *c = user;
    const struct colmap_point *point = data;
    for (size_t i = 0; i < size / sizeof *point; i++)
        if (point[i].track_count > c->track_count ||
            point[i].first_track > c->track_count - point[i].track_count)
            return 0;
    return 1;
}

static int scene_file_track_is_good(void *user, const void *data, size_t size)
{
    const struct colmap *c = user;
    const struct colmap_track *track = data;
    for (size_t i = 0; i < size / sizeof *track; i++)
        if (track[i].image_row >= c->image_count) return 0;
    return 1;
}

static int scene_file_has_string(const char *s, size_t bytes)
{
    return bytes > 0 && !memchr(s, 0, bytes - 1) && !s[bytes - 1];
}

static int scene_file_names_are_good(const oxl_scene *s)
{
    const struct colmap *c = &s->colmap;
    if (c->names_size == 0 || c->names[c->names_size - 1]) return 0;
    for (size_t i = 0; i < c->image_count; i++) {
        const char *name;
        if (c->image[i].name >= c->names_size) return 0;
        name = c->names + c->image[i].name;
        if (!colmap_name_is_safe(name, name + strlen(name))) return 0;
    }
    return 1;
}

static int scene_file_views_are_good(const oxl_scene *s)
{
    const struct colmap *c = &s->colmap;
    for (size_t i = 0; i < c->camera_count; i++)
        if (c->camera[i].model < 0 || c->camera[i].model >= camera_model_count() || c->camera[i].width < 1 ||
            c->camera[i].height < 1)
            return 0;
    for (int i = 0; i < s->view_count; i++) {
        const oxl_camera *camera = &s->view[i].camera;
        if (s->source[i].image >= c->image_count || s->source[i].camera >= c->camera_count ||
            camera->width < 1 || camera->height < 1 || !(camera->fx > 0) || !(camera->fy > 0))
            return 0;
    }
    return 1;
}

/* Returns 1 if the arrays have the sizes of their counts, and names, indices and strings are whole. */
static int scene_file_is_good(oxl_context *ctx, const char *path, const struct scene_file *head, oxl_scene *s)
{
    struct scene_file_array array[SCENE_ARRAYS - 1];
    uint64_t offset[SCENE_ARRAYS] = {scene_file_padded(sizeof *head)};
    const size_t most = SIZE_MAX / 4096; /* of any count: no product of one overflows */
    if (s->view_count < 1 || s->point_count > most || s->depth_count > most ||
        s->colmap.camera_count > most || s->colmap.image_count > most || s->colmap.point_count > most ||
        s->colmap.track_count > most || !s->from_files || s->colmap.format < COLMAP_TEXT ||
        s->colmap.format > COLMAP_JSON)
        return 0;
    for (int k = 0; k < SCENE_ARRAYS - 1; k++) offset[k + 1] = offset[k] + scene_file_padded(head->bytes[k]);
    if (!scene_file_has_string(s->images, head->bytes[SCENE_IMAGES]) ||
        (s->masks && !scene_file_has_string(s->masks, head->bytes[SCENE_MASKS])) ||
        !scene_file_has_string(s->colmap.folder, head->bytes[SCENE_FOLDER]))
        return 0;
    scene_file_arrays(s, array);
    for (int k = 0; k < SCENE_ARRAYS - 1; k++)
        if (array[k].bytes != head->bytes[k]) return 0;
    return scene_file_names_are_good(s) && scene_file_views_are_good(s) &&
           scene_file_pieces(ctx, path, offset[SCENE_POINTS], head->bytes[SCENE_POINTS],
                             1024 * sizeof *s->colmap.point, scene_file_point_is_good, &s->colmap) &&
           scene_file_pieces(ctx, path, offset[SCENE_TRACKS], head->bytes[SCENE_TRACKS], SCENE_FILE_CHUNK,
                             scene_file_track_is_good, &s->colmap);
}

/* Copies what holds pointers. */
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

/* Makes the arrays in the map the scene's. */
static void scene_file_point_into(oxl_scene *s, const struct scene_file *head, const char *data)
{
    struct scene_file_array array[SCENE_ARRAYS - 1];
    size_t offset = scene_file_padded(sizeof *head);
    s->imaging = (struct imaging){0};
    s->cache = (struct image_cache){0};
    s->lpips = NULL;
    s->decoded = s->images = s->masks = s->colmap.folder = NULL; /* addresses of another process */
    scene_file_arrays(s, array);
    for (int k = 0; k < SCENE_ARRAYS - 1; k++) {
        const char *at = head->bytes[k] ? data + offset : NULL;
        memcpy(array[k].pointer, &at, sizeof at);
        offset += scene_file_padded(head->bytes[k]);
    }
}

OXL_INTERNAL oxl_result scene_file_map(oxl_context *ctx, const char *path, const char *key, oxl_scene **out)
{
    struct os_file_map map = {0};
    oxl_scene *s = NULL;
    oxl_result rc = os_is_file(path) ? os_map_file(ctx, path, &map) : OXL_OK;
    *out = NULL;
    if (rc == OXL_OK && map.data && scene_file_is_whole(&map, key) && scene_file_has_sum(ctx, path, &map) &&
        !(s = oxl_calloc(ctx, 1, sizeof *s)))
        rc = oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for a scene");
    if (s) {
        const struct scene_file *head = (const void *)map.data;
        *s = head->scene;
        scene_file_point_into(s, head, map.data);
        if (!scene_file_is_good(ctx, path, head, s)) {
            oxl_free(ctx, s);
            s = NULL;
        }
    }
    if (!s) {
        os_unmap_file(ctx, &map);
        return rc;
    }
    s->map = map;
    rc = scene_file_own(ctx, s);
    if (rc != OXL_OK) oxl_scene_free(ctx, s);
    else *out = s;
    return rc;
}
