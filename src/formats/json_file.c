/* json_file.c - reads a survey in JSON, by the reader that knows the name of its file. */
#include "formats.h"
#include "json_survey.h"

/* Adds the images and points of one file, if all its brackets are closed. */
static void json_survey_add_file(struct colmap_reader *r, const char *folder, const char *name)
{
    struct os_file_map map = {0};
    const size_t before = r->out->image_count;
    const char *fault;
    path_in(r->path, folder, "%s", name);
    r->line = 0;
    r->rc = os_read_file(r->ctx, r->path, &map);
    if (r->rc == OXL_OK) r->rc = os_refuse_gzip(r->ctx, r->path, map.data, map.size);
    if (r->rc == OXL_OK) {
        /* Blanks the byte order mark, which programs of Windows write. */
        if (map.size >= 3 && !memcmp(map.data, "\xef\xbb\xbf", 3)) memset((char *)map.data, ' ', 3);
        fault = memchr(map.data, 0, map.size) ? map.data + strlen(map.data) : oxl_json_error(map.data);
        if (fault)
            colmap_fail(r, "export the survey again",
                        "byte %zu: the JSON text ends too early, or something follows it",
                        (size_t)(fault - map.data));
        else if (!strncmp(name, "transforms", 10)) nerfstudio_read(r, map.data);
        else opensfm_read(r, map.data);
        if (r->out->image_count == before) json_survey_fail(r, "the images", "none", "one or more");
    }
    os_release_file(r->ctx, &map);
}

/* Reads the file and, for NeRF synthetic, also the file of the held-out images. */
OXL_INTERNAL oxl_result json_survey_read(oxl_context *ctx, const char *folder, const char *name,
                                         const char *images, struct colmap *out)
{
    static const char *const held_out[] = {"transforms_test.json", "transforms_val.json"};
    struct colmap_reader r = {.ctx = ctx, .out = out, .image_folder = images};
    *out = (struct colmap){.format = COLMAP_JSON, .images_file = path_base_name(name)};
    json_survey_add_file(&r, folder, name);
    for (size_t i = 0; r.rc == OXL_OK && !strcmp(name, JSON_SURVEY_TRAIN) && i < OXL_COUNT(held_out); i++) {
        const size_t trained = out->image_count;
        if (!os_is_file(PATH(folder, "%s", held_out[i]))) continue;
        json_survey_add_file(&r, folder, held_out[i]);
        out->states_split = 1;
        for (size_t k = 0; k < out->image_count; k++)
            out->image[k].split = k < trained ? COLMAP_TRAIN : COLMAP_TEST;
        break;
    }
    *strrchr(r.path, '/') = 0;
    if (r.rc == OXL_OK && (out->folder = oxl_strdup(ctx, r.path)) == NULL) r.rc = OXL_ERR_MEMORY;
    out->warnings += r.warned[WARN_QUATERNION];
    if (r.rc != OXL_OK) colmap_free(ctx, out);
    else
        oxl_log(ctx, OXL_LOG_INFO, "%s/%s is read: %zu images, %zu points without tracks", folder, name,
                out->image_count, out->point_count);
    return r.rc;
}
