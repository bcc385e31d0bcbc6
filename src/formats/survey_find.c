/* survey_find.c - the cameras, images and points of a survey's folder, by the reader that knows its files.
 *
 * COLMAP's mapper writes sparse/0, sparse/1, ... for disconnected groups of images; the one with the most
 * images is used.
 *
 * Invariant: the choice depends on names and contents alone, not on the order in which the system lists a
 * folder.
 */
#include "formats.h"
#include "json_survey.h"

/* ---------------- which sub-model */

struct survey_find_folders {
    oxl_context *ctx;
    char **name;
    size_t count, capacity;
    int failed;
};

static void survey_find_visit_folder(void *user, const char *name)
{
    struct survey_find_folders *f = user;
    if (oxl_reserve(f->ctx, &f->name, &f->capacity, f->count + 1, sizeof *f->name) != OXL_OK) f->failed = 1;
    else if ((f->name[f->count] = oxl_strdup(f->ctx, name)) == NULL) f->failed = 1;
    else f->count++;
}

static int survey_find_compare_names(const void *a, const void *b)
{
    return strcmp(*(char *const *)a, *(char *const *)b);
}

/* Reads `folder` and keeps it in *best if it has more images. */
static oxl_result survey_find_try_model(oxl_context *ctx, const char *folder, struct colmap *best,
                                        char **best_folder, int *models)
{
    struct colmap found;
    const oxl_result rc = colmap_read(ctx, folder, &found);
    if (rc != OXL_OK) return rc;
    ++*models;
    if (*best_folder && found.image_count <= best->image_count) {
        colmap_free(ctx, &found);
        return OXL_OK;
    }
    oxl_free(ctx, *best_folder);
    colmap_free(ctx, best);
    *best = found;
    *best_folder = oxl_strdup(ctx, folder);
    return *best_folder ? OXL_OK : oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for a path");
}

/* The folder itself and, when `inside`, each folder in it that holds one of two files. */
static oxl_result survey_find_try_folder(oxl_context *ctx, const char *folder, int inside,
                                         const char *const file[2], struct colmap *best, char **best_folder,
                                         int *models)
{
    struct survey_find_folders in = {.ctx = ctx};
    oxl_result rc = OXL_OK;
    if (os_is_file(PATH(folder, "%s", file[0])) || os_is_file(PATH(folder, "%s", file[1])))
        rc = survey_find_try_model(ctx, folder, best, best_folder, models);
    if (rc == OXL_OK && inside && os_is_folder(folder))
        rc = os_list_folder(ctx, folder, survey_find_visit_folder, &in);
    if (rc == OXL_OK && in.failed) rc = oxl_fail(ctx, OXL_ERR_MEMORY, "no memory to list %s", folder);
    if (in.count) qsort(in.name, in.count, sizeof *in.name, survey_find_compare_names);
    for (size_t i = 0; i < in.count; i++) {
        const char *path = PATH(folder, "%s", in.name[i]);
        if (rc == OXL_OK && (os_is_file(PATH(path, "%s", file[0])) || os_is_file(PATH(path, "%s", file[1]))))
            rc = survey_find_try_model(ctx, path, best, best_folder, models);
        oxl_free(ctx, in.name[i]);
    }
    oxl_free(ctx, in.name);
    return rc;
}

/* Adds the images and points of one file. */
static oxl_result json_survey_add_file(struct colmap_reader *r, const char *path)
{
    struct os_file_map map = {0};
    const size_t before = r->out->image_count;
    oxl_result rc;
    oxl_free(r->ctx, r->path);
    r->line = 0;
    rc = json_survey_open(r, path, &map);
    if (rc == OXL_OK)
        rc = strncmp(path_base_name(path), "transforms", 10) ? opensfm_read(r, map.data)
                                                             : nerfstudio_read(r, map.data);
    if (rc == OXL_OK && r->out->image_count == before)
        rc = json_survey_fail(r, "the images", "none", "one or more");
    os_release_file(r->ctx, &map);
    return rc;
}

OXL_INTERNAL oxl_result json_survey_read(oxl_context *ctx, const char *folder, const char *name,
                                         const char *images, struct colmap *out)
{
    static const char *const held_out[] = {"transforms_test.json", "transforms_val.json"};
    struct colmap_reader r = {.ctx = ctx, .out = out, .image_folder = images};
    char *path = oxl_path_join(ctx, folder, name), *slash;
    oxl_result rc = path ? OXL_OK : oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for a path");
    *out = (struct colmap){.format = COLMAP_JSON, .images_file = path_base_name(name)};
    if (rc == OXL_OK) rc = json_survey_add_file(&r, path);
    for (size_t i = 0; rc == OXL_OK && !strcmp(name, JSON_SURVEY_TRAIN) && i < OXL_COUNT(held_out); i++) {
        const size_t trained = out->image_count;
        if (!os_is_file(PATH(folder, "%s", held_out[i]))) continue;
        rc = json_survey_add_file(&r, PATH(folder, "%s", held_out[i]));
        out->states_split = 1;
        for (size_t k = 0; k < out->image_count; k++)
            out->image[k].split = k < trained ? COLMAP_TRAIN : COLMAP_TEST;
        break;
    }
    if (rc == OXL_OK && (slash = strrchr(path, '/')) != NULL) *slash = 0; /* the folder alone */
    out->folder = path;
    out->warnings += r.warned[WARN_QUATERNION];
    oxl_free(ctx, r.path);
    if (rc != OXL_OK) colmap_free(ctx, out);
    return rc;
}

/* Without a COLMAP model: nerfstudio's, NeRF synthetic's or OpenSfM's file, in its folder or in an
 * OpenDroneMap project. */
static oxl_result survey_find_try_json(oxl_context *ctx, const char *path, const char *images,
                                       struct colmap *out, int *models)
{
    static const char *const names[] = {"transforms.json", JSON_SURVEY_TRAIN, "reconstruction.json",
                                        "opensfm/reconstruction.json"};
    for (size_t i = 0; i < OXL_COUNT(names); i++) {
        oxl_result rc;
        if (!os_is_file(PATH(path, "%s", names[i]))) continue;
        rc = json_survey_read(ctx, path, names[i], images, out);
        if (rc != OXL_OK) return rc;
        ++*models;
        oxl_log(ctx, OXL_LOG_INFO, "%s/%s is read: %zu images, %zu points without tracks", path, names[i],
                out->image_count, out->point_count);
        return OXL_OK;
    }
    return OXL_OK;
}

OXL_INTERNAL oxl_result survey_find_model(oxl_context *ctx, const char *path, const char *sparse_option,
                                          const char *images, struct colmap *out)
{
    static const char *const files[][2] = {
        {"images.txt", "images.bin"},
        {"cameras.txt", "cameras.bin"}}; /* the last two: for colmap_read's errors */
    char *sparse = sparse_option ? oxl_strdup(ctx, sparse_option) : oxl_path_join(ctx, path, "sparse");
    const char *requested = sparse_option ? sparse_option : path;
    char *folder = NULL;
    int models = 0;
    oxl_result rc = OXL_OK;
    *out = (struct colmap){0};
    if (!sparse) rc = oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for a path");
    if (rc == OXL_OK && !os_is_folder(requested))
        rc = oxl_fail(
            ctx, OXL_ERR_INPUT, "%s: there is no such folder\nfix: %s%s", requested,
            sparse_option && os_is_folder(PATH(path, "%s", sparse_option)) ? PATH(path, "%s", sparse_option)
                                                                           : "",
            sparse_option && os_is_folder(PATH(path, "%s", sparse_option)) ? " is one: name it by --sparse"
            : sparse_option ? "--sparse names the folder of cameras, images and points3D, .txt or .bin"
                            : "give the folder that holds images/ and sparse/");
    for (size_t i = 0; rc == OXL_OK && models == 0 && i < OXL_COUNT(files); i++) {
        rc = survey_find_try_folder(ctx, sparse, 1, files[i], out, &folder, &models);
        if (rc == OXL_OK && models == 0 && !sparse_option)
            rc = survey_find_try_folder(ctx, path, 0, files[i], out, &folder, &models);
    }
    if (rc == OXL_OK && models == 0 && !sparse_option)
        rc = survey_find_try_json(ctx, path, images, out, &models);
    if (rc == OXL_OK && models == 0)
        rc = oxl_fail(
            ctx, OXL_ERR_INPUT,
            "%s: no COLMAP model (cameras, images and points3D, .txt or .bin) in %s, in a folder there%s\n"
            "fix: copy the model's files to %s, or name their folder by --sparse",
            path, sparse, sparse_option ? "" : ", or beside it", sparse);
    if (rc == OXL_OK && models > 1)
        oxl_log(ctx, OXL_LOG_WARNING,
                "%d sub-models found; %s has most images (%zu) and is used; --sparse names another", models,
                folder, out->image_count);
    OXL_FREE(ctx, sparse, folder);
    if (rc != OXL_OK) colmap_free(ctx, out);
    return rc;
}
