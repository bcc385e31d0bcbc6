/* scene_file.c - keeps a loaded survey in one file, which is then mapped: points and tracks take memory only
 * while they are used.
 *
 * The file is a head and arrays of rows without addresses, each from a multiple of SCENE_FILE_ALIGN bytes on.
 * Rows are as they are in memory, so only the same build on the same kind of machine reads them: the head has
 * their sizes. The key identifies the run. The last SCENE_FILE_ALIGN bytes begin with the checksum of all
 * others. Invariant: a mapped scene has the same values as the one that was written; scene_rows_are_good has
 * checked all its indices and counts before there is a scene, whatever the file holds.
 */
#include "large.h"
#include "../survey/sparse.h"
#include "../survey/image.h"
#include "../survey/imaging.h"
#include "../survey/scene.h"
#include "../formats/survey_read.h"

enum {
    SCENE_FILE_ALIGN = 64,
    /* bytes that are read and checked at a time, since mapped pages would count as memory */
    SCENE_FILE_CHUNK = 1 << 16
};

enum scene_array {
    SCENE_FACTS, /* struct scene_facts, one row */
    SCENE_VIEWS,
    SCENE_CAMERAS,
    SCENE_DEPTHS,
    SCENE_START, /* oxl_point */
    SCENE_IMAGES,
    SCENE_POINTS,
    SCENE_TRACKS,
    SCENE_NAMES, /* names of images, as bytes, like all that follow */
    SCENE_IMAGE_FOLDER,
    SCENE_MASK_FOLDER, /* 0 rows: there is no folder */
    SCENE_FOLDER,
    SCENE_IMAGES_FILE,
    SCENE_CAMERAS_FILE,
    SCENE_KEY,
    SCENE_ARRAYS
};

struct scene_facts { /* Holds the members that a scene has once. */
    double origin[3], extent, may_miss, reference[2];
    struct scene_stats stats;
    struct image_alpha alpha;
    uint64_t warnings;
    int32_t transparent, is_truncated, images_beside, has_reference, states_split, format;
};
struct scene_view_row {
    oxl_camera camera;
    uint64_t image, source; /* rows in SCENE_IMAGES and SCENE_CAMERAS */
    int32_t is_test;
};
struct scene_camera_row {
    int64_t id;
    double parameter[CAMERA_PARAMETERS], on_disk;
    int32_t model, width, height, parameter_count, line;
};

static const size_t SCENE_ROW[SCENE_ARRAYS] = {sizeof(struct scene_facts),
                                               sizeof(struct scene_view_row),
                                               sizeof(struct scene_camera_row),
                                               sizeof(double),
                                               sizeof(oxl_point),
                                               sizeof(struct colmap_image),
                                               sizeof(struct colmap_point),
                                               sizeof(struct colmap_track),
                                               1,
                                               1,
                                               1,
                                               1,
                                               1,
                                               1,
                                               1};

struct scene_head {
    char magic[32];
    /* bytes of a row, SCENE_ROW of the build that wrote it; number of rows */
    uint64_t row[SCENE_ARRAYS], count[SCENE_ARRAYS];
};
static const char SCENE_FILE_MAGIC[32] = "oceanxl survey " OXL_VERSION;

struct scene_rows { /* Points to the arrays, in a scene or in a file. */
    const void *data[SCENE_ARRAYS];
    size_t count[SCENE_ARRAYS];
};

static size_t scene_file_padded(size_t bytes)
{
    return (bytes + SCENE_FILE_ALIGN - 1) / SCENE_FILE_ALIGN * SCENE_FILE_ALIGN;
}

/* ---------------- from a scene to its file */

struct scene_file_writer {
    struct os_writer w;
    uint64_t sum;
};

static int scene_file_put_all(struct scene_file_writer *out, const void *data, size_t bytes)
{
    if (bytes) out->sum = checksum_add(out->sum, data, bytes);
    return bytes == 0 || fwrite(data, 1, bytes, out->w.file) == bytes;
}

/* Writes data padded with zeros to a multiple of SCENE_FILE_ALIGN, and adds it to the checksum. */
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

static oxl_result scene_file_put_rows(oxl_context *ctx, const char *path, const struct scene_rows *rows)
{
    struct scene_file_writer w = {.sum = CHECKSUM_SEED};
    struct scene_head head = {.magic = {0}};
    uint64_t sum;
    oxl_result rc = os_writer_open(ctx, path, &w.w);
    if (rc != OXL_OK) return rc;
    memcpy(head.magic, SCENE_FILE_MAGIC, sizeof head.magic);
    for (int k = 0; k < SCENE_ARRAYS; k++) head.row[k] = SCENE_ROW[k], head.count[k] = rows->count[k];
    rc = scene_file_put(ctx, &w, &head, sizeof head);
    for (int k = 0; k < SCENE_ARRAYS && rc == OXL_OK; k++)
        rc = scene_file_put(ctx, &w, rows->data[k], rows->count[k] * SCENE_ROW[k]);
    sum = w.sum;
    if (rc == OXL_OK) rc = scene_file_put(ctx, &w, &sum, sizeof sum);
    return os_writer_close(ctx, &w.w, rc);
}

static void scene_rows_set(struct scene_rows *rows, enum scene_array k, const void *data, size_t count)
{
    rows->data[k] = data;
    rows->count[k] = count;
}

static void scene_rows_set_text(struct scene_rows *rows, enum scene_array k, const char *s)
{
    scene_rows_set(rows, k, s, s ? strlen(s) + 1 : 0);
}

/* Lists the arrays of a scene that go to the file as they are. */
static void scene_rows_of(const oxl_scene *s, const char *key, struct scene_rows *rows)
{
    const struct colmap *c = &s->colmap;
    scene_rows_set(rows, SCENE_DEPTHS, s->depth, s->depth_count);
    scene_rows_set(rows, SCENE_START, s->point, s->point_count);
    scene_rows_set(rows, SCENE_IMAGES, c->image, c->image_count);
    scene_rows_set(rows, SCENE_POINTS, c->point, c->point_count);
    scene_rows_set(rows, SCENE_TRACKS, c->track, c->track_count);
    scene_rows_set(rows, SCENE_NAMES, c->names, c->names_size);
    scene_rows_set_text(rows, SCENE_IMAGE_FOLDER, s->images);
    scene_rows_set_text(rows, SCENE_MASK_FOLDER, s->masks);
    scene_rows_set_text(rows, SCENE_FOLDER, c->folder);
    scene_rows_set_text(rows, SCENE_IMAGES_FILE, c->images_file);
    scene_rows_set_text(rows, SCENE_CAMERAS_FILE, c->camera_count ? c->camera->file : "");
    scene_rows_set_text(rows, SCENE_KEY, key);
}

static void scene_facts_of(const oxl_scene *s, struct scene_facts *f)
{
    const struct colmap *c = &s->colmap;
    memcpy(f->origin, s->origin, sizeof f->origin);
    memcpy(f->reference, c->reference, sizeof f->reference);
    f->extent = s->extent, f->may_miss = s->may_miss;
    f->stats = s->stats, f->alpha = s->alpha, f->warnings = c->warnings;
    f->transparent = s->transparent, f->is_truncated = c->is_truncated, f->images_beside = c->images_beside;
    f->has_reference = c->has_reference, f->states_split = c->states_split, f->format = c->format;
}

static void scene_view_rows(const oxl_scene *s, struct scene_view_row *row)
{
    for (int i = 0; i < s->view_count; i++) {
        row[i].camera = s->view[i].camera;
        row[i].image = s->source[i].image;
        row[i].source = s->source[i].camera;
        row[i].is_test = s->view[i].is_test;
    }
}

static void scene_camera_rows(const oxl_scene *s, struct scene_camera_row *row)
{
    for (size_t i = 0; i < s->colmap.camera_count; i++) {
        const struct colmap_camera *c = &s->colmap.camera[i];
        row[i].id = c->id, row[i].line = c->line, row[i].on_disk = s->on_disk[i];
        row[i].model = c->model, row[i].width = c->width, row[i].height = c->height;
        row[i].parameter_count = c->parameter_count;
        memcpy(row[i].parameter, c->parameter, sizeof row[i].parameter);
    }
}

OXL_INTERNAL oxl_result scene_file_write(oxl_context *ctx, const char *path, const oxl_scene *scene,
                                         const char *key)
{
    const size_t views = (size_t)scene->view_count, cameras = scene->colmap.camera_count;
    /* zeros between the members, too, for the same bytes */
    struct scene_facts *facts = oxl_calloc(ctx, 1, sizeof *facts);
    struct scene_view_row *view = oxl_calloc(ctx, views + 1, sizeof *view);
    struct scene_camera_row *camera = oxl_calloc(ctx, cameras + 1, sizeof *camera);
    struct scene_rows rows = {{0}, {0}};
    oxl_result rc = OXL_OK;
    if (!facts || !view || !camera) rc = OXL_ERR_MEMORY;
    if (rc != OXL_OK) goto done;
    scene_facts_of(scene, facts);
    scene_view_rows(scene, view);
    scene_camera_rows(scene, camera);
    scene_rows_of(scene, key, &rows);
    scene_rows_set(&rows, SCENE_FACTS, facts, 1);
    scene_rows_set(&rows, SCENE_VIEWS, view, views);
    scene_rows_set(&rows, SCENE_CAMERAS, camera, cameras);
    rc = scene_file_put_rows(ctx, path, &rows);
done:
    OXL_FREE(ctx, facts, view, camera);
    return rc;
}

/* ---------------- the rows of a file, and what is checked of them */

/* Finds the rows of the file; returns 0 if the file is of another build, or not of the
 * size that its head states. */
static int scene_rows_find(const struct os_file_map *map, struct scene_rows *rows)
{
    const struct scene_head *head = (const void *)map->data;
    size_t at = scene_file_padded(sizeof *head);
    if (map->size < at || memcmp(head->magic, SCENE_FILE_MAGIC, sizeof head->magic)) return 0;
    for (int k = 0; k < SCENE_ARRAYS; k++) {
        if (head->row[k] != SCENE_ROW[k] || head->count[k] > (map->size - at) / SCENE_ROW[k]) return 0;
        scene_rows_set(rows, (enum scene_array)k, head->count[k] ? map->data + at : NULL,
                       (size_t)head->count[k]);
        at += scene_file_padded(rows->count[k] * SCENE_ROW[k]);
        if (at > map->size) return 0;
    }
    return map->size - at == SCENE_FILE_ALIGN;
}

/* Calls `check` with the bytes from `offset` on, in pieces; returns 1 if all were read and right. */
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

static int scene_rows_point_is_good(void *user, const void *data, size_t size)
{
    const size_t tracks = ((const struct scene_rows *)user)->count[SCENE_TRACKS];
    const struct colmap_point *point = data;
    for (size_t i = 0; i < size / sizeof *point; i++)
        if (point[i].track_count > tracks || point[i].first_track > tracks - point[i].track_count) return 0;
    return 1;
}

static int scene_rows_track_is_good(void *user, const void *data, size_t size)
{
    const size_t images = ((const struct scene_rows *)user)->count[SCENE_IMAGES];
    const struct colmap_track *track = data;
    for (size_t i = 0; i < size / sizeof *track; i++)
        if (track[i].image_row >= images) return 0;
    return 1;
}

/* Returns 1 if the bytes are one text and its terminating 0. */
static int scene_rows_have_text(const struct scene_rows *rows, enum scene_array k)
{
    const char *s = rows->data[k];
    const size_t size = rows->count[k];
    return size > 0 && !s[size - 1] && !memchr(s, 0, size - 1);
}

static int scene_rows_have_names(const struct scene_rows *rows)
{
    const struct colmap_image *image = rows->data[SCENE_IMAGES];
    const char *names = rows->data[SCENE_NAMES];
    const size_t size = rows->count[SCENE_NAMES];
    if (size == 0 || names[size - 1]) return 0;
    for (size_t i = 0; i < rows->count[SCENE_IMAGES]; i++) {
        const char *name;
        if (image[i].name >= size || image[i].mask >= size) return 0;
        name = names + image[i].name;
        if (!colmap_name_is_safe(name, name + strlen(name))) return 0;
    }
    return 1;
}

static int scene_rows_have_cameras(const struct scene_rows *rows)
{
    const struct scene_camera_row *c = rows->data[SCENE_CAMERAS];
    for (size_t i = 0; i < rows->count[SCENE_CAMERAS]; i++)
        if (!camera_model_at(c[i].model) || c[i].width < 1 || c[i].height < 1 ||
            c[i].parameter_count != camera_model_at(c[i].model)->parameter_count)
            return 0;
    return 1;
}

static int scene_rows_have_views(const struct scene_rows *rows)
{
    const struct scene_view_row *v = rows->data[SCENE_VIEWS];
    for (size_t i = 0; i < rows->count[SCENE_VIEWS]; i++)
        if (v[i].image >= rows->count[SCENE_IMAGES] || v[i].source >= rows->count[SCENE_CAMERAS] ||
            v[i].camera.width < 1 || v[i].camera.height < 1 || !(v[i].camera.fx > 0) || !(v[i].camera.fy > 0))
            return 0;
    return rows->count[SCENE_VIEWS] >= 1 && rows->count[SCENE_VIEWS] < INT_MAX;
}

/* Returns 1 if the rows have the key of this run, and all indices, counts and texts in them are valid. */
static int scene_rows_are_good(oxl_context *ctx, const char *path, const char *key, const char *start,
                               struct scene_rows *rows)
{
    static const struct {
        enum scene_array array;
        int (*is_good)(void *user, const void *data, size_t size);
        size_t piece;
    } read[] = {{SCENE_POINTS, scene_rows_point_is_good, 1024 * sizeof(struct colmap_point)},
                {SCENE_TRACKS, scene_rows_track_is_good, SCENE_FILE_CHUNK}};
    const struct scene_facts *facts = rows->data[SCENE_FACTS];
    if (rows->count[SCENE_FACTS] != 1 || facts->format < COLMAP_TEXT || facts->format > COLMAP_JSON) return 0;
    for (int k = SCENE_IMAGE_FOLDER; k <= SCENE_KEY; k++)
        if (!scene_rows_have_text(rows, (enum scene_array)k) && !(k == SCENE_MASK_FOLDER && !rows->count[k]))
            return 0;
    if (strcmp(rows->data[SCENE_KEY], key) || !scene_rows_have_names(rows) ||
        !scene_rows_have_cameras(rows) || !scene_rows_have_views(rows))
        return 0;
    for (size_t k = 0; k < OXL_COUNT(read); k++) {
        const enum scene_array a = read[k].array;
        if (rows->count[a] &&
            !scene_file_pieces(ctx, path, (uint64_t)((const char *)rows->data[a] - start),
                               rows->count[a] * SCENE_ROW[a], read[k].piece, read[k].is_good, rows))
            return 0;
    }
    return 1;
}

/* ---------------- from the rows to a scene */

static void scene_use_facts(const struct scene_facts *f, oxl_scene *s)
{
    struct colmap *c = &s->colmap;
    memcpy(s->origin, f->origin, sizeof s->origin);
    memcpy(c->reference, f->reference, sizeof c->reference);
    s->extent = f->extent, s->may_miss = f->may_miss;
    s->stats = f->stats, s->alpha = f->alpha, c->warnings = (size_t)f->warnings;
    s->transparent = f->transparent, c->is_truncated = f->is_truncated, c->images_beside = f->images_beside;
    c->has_reference = f->has_reference, c->states_split = f->states_split;
    c->format = (enum colmap_format)f->format;
    s->from_files = 1;
}

/* Makes the arrays of the map the scene's own, which only reads them. */
static void scene_use_rows(const struct scene_rows *rows, oxl_scene *s)
{
    struct colmap *c = &s->colmap;
    s->depth = (void *)rows->data[SCENE_DEPTHS], s->depth_count = rows->count[SCENE_DEPTHS];
    s->point = (void *)rows->data[SCENE_START], s->point_count = rows->count[SCENE_START];
    c->image = (void *)rows->data[SCENE_IMAGES], c->image_count = rows->count[SCENE_IMAGES];
    c->point = (void *)rows->data[SCENE_POINTS], c->point_count = rows->count[SCENE_POINTS];
    c->track = (void *)rows->data[SCENE_TRACKS], c->track_count = rows->count[SCENE_TRACKS];
    c->names = (void *)rows->data[SCENE_NAMES], c->names_size = rows->count[SCENE_NAMES];
    s->images = (void *)rows->data[SCENE_IMAGE_FOLDER];
    s->masks = (void *)rows->data[SCENE_MASK_FOLDER];
    c->folder = (void *)rows->data[SCENE_FOLDER];
    c->images_file = rows->data[SCENE_IMAGES_FILE];
}

static void scene_use_views(const struct scene_view_row *row, oxl_scene *s)
{
    for (int i = 0; i < s->view_count; i++) {
        s->source[i] = (struct scene_source){(size_t)row[i].image, (size_t)row[i].source};
        s->view[i] =
            (oxl_view){s->colmap.names + s->colmap.image[row[i].image].name, row[i].camera, row[i].is_test};
    }
}

static void scene_use_cameras(const struct scene_camera_row *row, const char *file, oxl_scene *s)
{
    for (size_t i = 0; i < s->colmap.camera_count; i++) {
        s->on_disk[i] = row[i].on_disk;
        s->colmap.camera[i] = (struct colmap_camera){.id = row[i].id,
                                                     .model = row[i].model,
                                                     .width = row[i].width,
                                                     .height = row[i].height,
                                                     .parameter_count = row[i].parameter_count,
                                                     .file = file,
                                                     .line = row[i].line};
        memcpy(s->colmap.camera[i].parameter, row[i].parameter, sizeof row[i].parameter);
    }
}

/* Makes a scene of the file's rows; the map becomes the scene's own, on error too. */
static oxl_result scene_of_rows(oxl_context *ctx, const struct scene_rows *rows, struct os_file_map *map,
                                oxl_scene **out)
{
    const size_t views = rows->count[SCENE_VIEWS], cameras = rows->count[SCENE_CAMERAS];
    oxl_scene *s = oxl_calloc(ctx, 1, sizeof *s);
    oxl_result rc;
    if (!s) {
        os_unmap_file(ctx, map);
        return OXL_ERR_MEMORY;
    }
    s->map = *map;
    scene_use_facts(rows->data[SCENE_FACTS], s);
    scene_use_rows(rows, s);
    s->view = oxl_calloc(ctx, views + 1, sizeof *s->view);
    s->source = oxl_calloc(ctx, views + 1, sizeof *s->source);
    s->on_disk = oxl_calloc(ctx, cameras + 1, sizeof *s->on_disk);
    s->colmap.camera = oxl_calloc(ctx, cameras + 1, sizeof *s->colmap.camera);
    if (!s->view || !s->source || !s->on_disk || !s->colmap.camera) rc = OXL_ERR_MEMORY;
    else {
        s->view_count = (int)views;
        s->colmap.camera_count = cameras;
        scene_use_views(rows->data[SCENE_VIEWS], s);
        scene_use_cameras(rows->data[SCENE_CAMERAS], rows->data[SCENE_CAMERAS_FILE], s);
        rc = scene_begin_cache(ctx, s, views);
    }
    if (rc == OXL_OK) *out = s;
    else oxl_scene_free(ctx, s);
    return rc;
}

OXL_INTERNAL oxl_result scene_file_map(oxl_context *ctx, const char *path, const char *key, oxl_scene **out)
{
    struct os_file_map map = {0};
    struct scene_rows rows;
    oxl_result rc = os_is_file(path) ? os_map_file(ctx, path, &map) : OXL_OK;
    *out = NULL;
    if (rc == OXL_OK && map.data && scene_rows_find(&map, &rows) && scene_file_has_sum(ctx, path, &map) &&
        scene_rows_are_good(ctx, path, key, map.data, &rows))
        return scene_of_rows(ctx, &rows, &map, out);
    os_unmap_file(ctx, &map);
    return rc;
}
