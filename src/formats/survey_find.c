/* survey_find.c - finds the cameras, images and points of a survey's folder, by the reader that knows its
 * files.
 *
 * COLMAP's mapper writes sparse/0, sparse/1, ... for disconnected groups of images; the one with the most
 * images is used.
 *
 * Invariant: the choice depends on names and contents alone, not on the order in which the system lists a
 * folder.
 */
#include "formats.h"
#include "json_survey.h"

/* Lists the formats of surveys, a row each; the first row whose file exists is taken. */
static const struct survey_format {
    const char *file[2]; /* a folder with one of them holds such a survey */
    /* reads the folder's files; NULL: read_json is set */
    oxl_result (*read)(oxl_context *ctx, const char *folder, struct colmap *out);
    oxl_result (*read_json)(struct colmap_reader *r, const char *json); /* reads the text of file[0] */
} SURVEY_FORMATS[] = {
    {{"images.txt", "images.bin"}, colmap_read, NULL},
    /* an incomplete model, whose reader says what is missing */
    {{"cameras.txt", "cameras.bin"}, colmap_read, NULL},
    {{"transforms.json", NULL}, NULL, nerfstudio_read},
    {{JSON_SURVEY_TRAIN, NULL}, NULL, nerfstudio_read},
    {{"reconstruction.json", NULL}, NULL, opensfm_read},
    {{"opensfm/reconstruction.json", NULL}, NULL, opensfm_read}, /* an OpenDroneMap project */
};

static int survey_holds(const struct survey_format *format, const char *folder)
{
    for (int i = 0; i < 2 && format->file[i]; i++) {
        const char *path = PATH(folder, "%s", format->file[i]);
        /* Accepts compressed files, too: their reader says how to unpack them. */
        if (os_is_file(path) || os_is_compressed(path)) return 1;
    }
    return 0;
}

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
static oxl_result survey_find_try_model(oxl_context *ctx, const struct survey_format *format,
                                        const char *folder, struct colmap *best, char **best_folder,
                                        int *models)
{
    struct colmap found;
    const oxl_result rc = format->read(ctx, folder, &found);
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
    return *best_folder ? OXL_OK : OXL_ERR_MEMORY;
}

/* Reads the folder itself and, if `inside` is 1, each folder in it that holds a survey of this format. */
static oxl_result survey_find_try_folder(oxl_context *ctx, const struct survey_format *format,
                                         const char *folder, int inside, struct colmap *best,
                                         char **best_folder, int *models)
{
    struct survey_find_folders in = {.ctx = ctx};
    oxl_result rc = OXL_OK;
    if (survey_holds(format, folder))
        rc = survey_find_try_model(ctx, format, folder, best, best_folder, models);
    if (rc == OXL_OK && inside && os_is_folder(folder))
        rc = os_list_folder(ctx, folder, survey_find_visit_folder, &in);
    if (rc == OXL_OK && in.failed) rc = OXL_ERR_MEMORY;
    if (in.count) qsort(in.name, in.count, sizeof *in.name, survey_find_compare_names);
    for (size_t i = 0; i < in.count; i++) {
        const char *path = PATH(folder, "%s", in.name[i]);
        if (rc == OXL_OK && survey_holds(format, path))
            rc = survey_find_try_model(ctx, format, path, best, best_folder, models);
        oxl_free(ctx, in.name[i]);
    }
    oxl_free(ctx, in.name);
    return rc;
}

/* Adds the images and points of one file. */
static oxl_result json_survey_add_file(struct colmap_reader *r, const struct survey_format *format,
                                       const char *path)
{
    struct os_file_map map = {0};
    const size_t before = r->out->image_count;
    oxl_result rc;
    r->line = 0;
    rc = json_survey_open(r, path, &map);
    if (rc == OXL_OK) rc = format->read_json(r, map.data);
    if (rc == OXL_OK && r->out->image_count == before)
        rc = json_survey_fail(r, "the images", "none", "one or more");
    os_release_file(r->ctx, &map);
    return rc;
}

/* Reads the format's file and, for NeRF synthetic, also the file of the held-out images. */
static oxl_result survey_read_json(oxl_context *ctx, const struct survey_format *format, const char *folder,
                                   const char *images, struct colmap *out)
{
    static const char *const held_out[] = {"transforms_test.json", "transforms_val.json"};
    struct colmap_reader r = {.ctx = ctx, .out = out, .image_folder = images};
    const char *name = format->file[0];
    char *path = oxl_path_join(ctx, folder, name), *slash;
    oxl_result rc = path ? OXL_OK : OXL_ERR_MEMORY;
    *out = (struct colmap){.format = COLMAP_JSON, .images_file = path_base_name(name)};
    if (rc == OXL_OK) rc = json_survey_add_file(&r, format, path);
    for (size_t i = 0; rc == OXL_OK && !strcmp(name, JSON_SURVEY_TRAIN) && i < OXL_COUNT(held_out); i++) {
        const size_t trained = out->image_count;
        if (!os_is_file(PATH(folder, "%s", held_out[i]))) continue;
        rc = json_survey_add_file(&r, format, PATH(folder, "%s", held_out[i]));
        out->states_split = 1;
        for (size_t k = 0; k < out->image_count; k++)
            out->image[k].split = k < trained ? COLMAP_TRAIN : COLMAP_TEST;
        break;
    }
    /* Cuts the file's name off the path, which leaves the folder. */
    if (rc == OXL_OK && (slash = strrchr(path, '/')) != NULL) *slash = 0;
    out->folder = path;
    out->warnings += r.warned[WARN_QUATERNION];
    if (rc != OXL_OK) colmap_free(ctx, out);
    return rc;
}

OXL_INTERNAL oxl_result json_survey_read(oxl_context *ctx, const char *folder, const char *name,
                                         const char *images, struct colmap *out)
{
    size_t i = 0;
    while (i + 1 < OXL_COUNT(SURVEY_FORMATS) && strcmp(SURVEY_FORMATS[i].file[0], name) != 0) i++;
    return survey_read_json(ctx, &SURVEY_FORMATS[i], folder, images, out);
}

/* Reads a survey of a single file, if the folder holds it. */
static oxl_result survey_find_try_json(oxl_context *ctx, const struct survey_format *format, const char *path,
                                       const char *images, struct colmap *out, int *models)
{
    oxl_result rc;
    if (!survey_holds(format, path)) return OXL_OK;
    rc = survey_read_json(ctx, format, path, images, out);
    if (rc != OXL_OK) return rc;
    ++*models;
    oxl_log(ctx, OXL_LOG_INFO, "%s/%s is read: %zu images, %zu points without tracks", path, format->file[0],
            out->image_count, out->point_count);
    return OXL_OK;
}

/* ---------------- files of programs that are not read */

static const struct survey_foreign {
    const char *ending,
        /* ending of a file's name in the survey's folder; the program that writes it, and how
         * it exports a COLMAP model */
        *what;
} survey_foreign[] = {
    {"database.db", "COLMAP's matches, without cameras: colmap mapper finds them"},
    {"sfm_data.json", "OpenMVG's: openMVG_main_openMVG2Colmap writes a COLMAP model"},
    {".sfm", "Meshroom's: aliceVision_exportColmap writes a COLMAP model"},
    {"bundle.out", "Bundler's: export as COLMAP from the program that wrote it"},
    {".xmp", "RealityCapture's: export the registration as COLMAP"},
    {".csv", "a table of cameras: export the registration as COLMAP from the program that wrote it"},
    {".xml", "of Metashape or ContextCapture: in Metashape, File, Export, Export Cameras, COLMAP"},
};

struct survey_foreign_search {
    const struct survey_foreign *found;
    char name[80];
};

/* Keeps the file that the first row of the table fits: names come in no particular order. */
static void survey_find_visit_file(void *user, const char *name)
{
    struct survey_foreign_search *s = user;
    for (size_t i = 0; i < OXL_COUNT(survey_foreign); i++) {
        const size_t size = strlen(survey_foreign[i].ending), has = strlen(name);
        if (has < size || strcmp(name + has - size, survey_foreign[i].ending) != 0) continue;
        if (s->found && s->found <= &survey_foreign[i]) return;
        s->found = &survey_foreign[i];
        snprintf(s->name, sizeof s->name, "%.*s", (int)sizeof s->name - 1, name);
        return;
    }
}

/* Fails because there is no model, and names what is there instead. */
static oxl_result survey_find_fail(oxl_context *ctx, const char *path, const char *sparse, int is_given)
{
    static const char *const below[] = {"dense", "colmap", "undistorted", "distorted", ".."};
    struct survey_foreign_search s = {.found = NULL};
    struct text there = {.ctx = ctx};
    oxl_result rc;
    if (os_is_folder(path)) os_list_folder(ctx, path, survey_find_visit_file, &s);
    if (s.found) text_add(&there, "; %s there is %s", s.name, s.found->what);
    for (size_t i = 0; !is_given && i < OXL_COUNT(below) && !there.data; i++)
        if (os_is_folder(PATH(path, "%s/sparse", below[i])))
            text_add(&there, "; %s/%s is a survey: name that", path, below[i]);
    rc = oxl_fail(
        ctx, OXL_ERR_INPUT,
        "%s: no COLMAP model (cameras, images and points3D, .txt or .bin) in %s, in a folder there%s\n"
        "fix: copy the model's files to %s, or name their folder by --sparse%s; photos without cameras: "
        "examples/from_images.sh PHOTOS SURVEY finds them by COLMAP, then trains",
        path, sparse, is_given ? "" : ", or beside it", sparse, there.data ? there.data : "");
    text_free(&there);
    return rc;
}

OXL_INTERNAL oxl_result survey_find_model(oxl_context *ctx, const char *path, const char *sparse_option,
                                          const char *images, struct colmap *out)
{
    char *sparse = sparse_option ? oxl_strdup(ctx, sparse_option) : oxl_path_join(ctx, path, "sparse");
    const char *requested = sparse_option ? sparse_option : path;
    char *folder = NULL;
    int models = 0;
    oxl_result rc = OXL_OK;
    *out = (struct colmap){0};
    if (!sparse) rc = OXL_ERR_MEMORY;
    if (rc == OXL_OK && !os_is_folder(requested))
        rc = oxl_fail(
            ctx, OXL_ERR_INPUT, "%s: there is no such folder\nfix: %s%s", requested,
            sparse_option && os_is_folder(PATH(path, "%s", sparse_option)) ? PATH(path, "%s", sparse_option)
                                                                           : "",
            sparse_option && os_is_folder(PATH(path, "%s", sparse_option)) ? " is one: name it by --sparse"
            : sparse_option ? "--sparse names the folder of cameras, images and points3D, .txt or .bin"
                            : "give the folder that holds images/ and sparse/");
    for (size_t i = 0; rc == OXL_OK && models == 0 && i < OXL_COUNT(SURVEY_FORMATS); i++) {
        const struct survey_format *format = &SURVEY_FORMATS[i];
        if (format->read) rc = survey_find_try_folder(ctx, format, sparse, 1, out, &folder, &models);
        if (rc != OXL_OK || models > 0 || sparse_option) continue;
        if (format->read) rc = survey_find_try_folder(ctx, format, path, 0, out, &folder, &models);
        else rc = survey_find_try_json(ctx, format, path, images, out, &models);
    }
    if (rc == OXL_OK && models == 0) rc = survey_find_fail(ctx, path, sparse, sparse_option != NULL);
    if (rc == OXL_OK && models > 1)
        oxl_log(ctx, OXL_LOG_WARNING,
                "%d sub-models found; %s has most images (%zu) and is used; --sparse names another", models,
                folder, out->image_count);
    OXL_FREE(ctx, sparse, folder);
    if (rc != OXL_OK) colmap_free(ctx, out);
    return rc;
}
