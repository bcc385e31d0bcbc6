/* json_file.c - reads a survey of one file, in JSON or LLFF's, by the reader that knows its name; and NeRF
 * synthetic's, which has a file for each split. */
#include "formats.h"
#include "json_survey.h"

/* Lists the readers by the beginning of a file's name. */
static const struct json_file {
    const char *begin;
    int is_json;
    void (*read)(struct colmap_reader *r, const struct os_file_map *file);
} json_files[] = {{"poses_bounds", 0, llff_read}, {"transforms", 1, nerfstudio_read}, {"", 1, opensfm_read}};

/* Refuses a text whose brackets are not closed, after blanking the byte order mark, which programs of Windows
 * write. */
static void json_file_check(struct colmap_reader *r, const struct os_file_map *map)
{
    const char *fault;
    if (map->size >= 3 && !memcmp(map->data, "\xef\xbb\xbf", 3)) memset((char *)map->data, ' ', 3);
    fault = memchr(map->data, 0, map->size) ? map->data + strlen(map->data) : oxl_json_error(map->data);
    if (fault)
        colmap_fail(r, "export the survey again",
                    "byte %zu: the JSON text ends too early, or more text follows its end",
                    (size_t)(fault - map->data));
}

/* Adds the images and points of one file. */
static void json_file_add(struct colmap_reader *r, const char *folder, const char *name)
{
    struct os_file_map map = {0};
    const size_t before = r->out->image_count;
    const struct json_file *file = json_files;
    path_in(r->path, folder, "%s", name);
    while (strncmp(path_base_name(r->path), file->begin, strlen(file->begin)) != 0) file++;
    r->line = 0;
    r->rc = os_read_file(r->ctx, r->path, &map);
    if (r->rc == OXL_OK) r->rc = os_refuse_gzip(r->ctx, r->path, map.data, map.size);
    if (r->rc == OXL_OK && file->is_json) json_file_check(r, &map);
    if (r->rc == OXL_OK) file->read(r, &map);
    if (r->out->image_count == before) json_survey_fail(r, "the images", "none", "one or more");
    os_release_file(r->ctx, &map);
}

/* Adds NeRF synthetic's training images, and holds out those of the test file, or else of the other. */
static void json_file_add_splits(struct colmap_reader *r, const char *folder)
{
    static const char *const splits[] = {"transforms_train.json", "transforms_test.json",
                                         "transforms_val.json"};
    struct colmap *out = r->out;
    for (int i = 0; i < 3 && r->rc == OXL_OK && !out->states_split; i++) {
        const char *path = PATH(folder, "%s", splits[i]);
        size_t k = out->image_count;
        if (!os_is_file(path) && !os_is_compressed(path)) continue;
        if (k == 0) out->images_file = splits[i];
        json_file_add(r, folder, splits[i]);
        out->states_split = i > 0;
        for (; k < out->image_count; k++) out->image[k].split = i ? COLMAP_TEST : COLMAP_TRAIN;
    }
}

OXL_INTERNAL oxl_result json_survey_read(oxl_context *ctx, const char *folder, const char *name,
                                         const struct survey_given *given, struct colmap *out)
{
    struct colmap_reader r = {.ctx = ctx, .out = out, .given = given ? *given : (struct survey_given){0}};
    *out = (struct colmap){.format = COLMAP_JSON, .images_file = path_base_name(name)};
    if (strncmp(name, "transforms_", 11)) json_file_add(&r, folder, name);
    else json_file_add_splits(&r, folder);
    *strrchr(r.path, '/') = 0;
    if (r.rc == OXL_OK && (out->folder = oxl_strdup(ctx, r.path)) == NULL) r.rc = OXL_ERR_MEMORY;
    if (r.rc == OXL_OK && r.beside && (out->images = oxl_strdup(ctx, r.path)) == NULL) r.rc = OXL_ERR_MEMORY;
    if (r.rc == OXL_OK && r.given.points) r.rc = colmap_read_points(ctx, r.given.points, out);
    out->warnings += r.warned[WARN_QUATERNION];
    if (r.rc != OXL_OK) colmap_free(ctx, out);
    else
        oxl_log(ctx, OXL_LOG_INFO, "%s/%s is read: %zu images, %zu points without tracks", folder,
                out->images_file, out->image_count, out->point_count);
    return r.rc;
}
