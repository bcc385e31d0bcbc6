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
#include "colmap.h"
#include "json_survey.h"
#include "survey_read.h"
#include "../survey/scene.h"

/* Lists the files of surveys: a folder with one of a row holds such a survey, and one with both of COLMAP's
 * rows a whole model of COLMAP's; the first row that does is taken. */
enum { SURVEY_COLMAP = 2 }; /* rows of COLMAP's files; json_survey_read reads the others */
#define SURVEY_LLFF "poses_bounds.npy"
static const char *const SURVEY_FILES[][2] = {
    {"images.txt", "images.bin"},
    {"cameras.txt", "cameras.bin"},
    {"transforms.json", NULL},
    {"transforms_train.json", "transforms_test.json"},
    {"transforms_val.json", NULL},
    {"reconstruction.json", NULL},
    {"opensfm/reconstruction.json", NULL}, /* an OpenDroneMap project */
    {SURVEY_LLFF, NULL},
};

struct survey_search { /* Tries folders, and keeps the model of most images. */
    oxl_context *ctx;
    size_t row;     /* of SURVEY_FILES */
    const char *in; /* folder whose entries are tried */
    struct survey_given given;
    struct colmap *best;
    int models;
    oxl_result rc;
};

static int survey_has(size_t row, const char *folder)
{
    for (int i = 0; i < 2 && SURVEY_FILES[row][i]; i++) {
        const char *path = PATH(folder, "%s", SURVEY_FILES[row][i]);
        /* Accepts compressed files, too: their reader says how to unpack them. */
        if (os_is_file(path) || os_is_compressed(path)) return 1;
    }
    return 0;
}

/* Returns 1 if a folder holds a survey of a row. The second row is of models that lack a file, whose reader
 * says which. */
static int survey_holds(size_t row, const char *folder)
{
    if (row >= SURVEY_COLMAP) return survey_has(row, folder);
    return survey_has(0, folder) + survey_has(1, folder) == (row == 0 ? 2 : 1);
}

/* Returns the name of a file there that describes a survey without COLMAP's; NULL: there is none. */
static const char *survey_has_other(const char *folder)
{
    for (size_t i = SURVEY_COLMAP; i < OXL_COUNT(SURVEY_FILES); i++)
        if (survey_has(i, folder)) return SURVEY_FILES[i][0];
    return NULL;
}

/* Reads the model of a folder, if it holds one; of equally many images, the first by name counts. */
static void survey_try(struct survey_search *s, const char *folder)
{
    struct colmap found;
    if (s->rc != OXL_OK || !survey_holds(s->row, folder)) return;
    s->rc = s->row < SURVEY_COLMAP
                ? colmap_read(s->ctx, folder, COLMAP_BUFFER, &s->given, &found)
                : json_survey_read(s->ctx, folder, SURVEY_FILES[s->row][0], &s->given, &found);
    if (s->rc != OXL_OK) return;
    if (s->models++ == 0 || found.image_count > s->best->image_count ||
        (found.image_count == s->best->image_count && strcmp(found.folder, s->best->folder) < 0))
        OXL_SWAP(struct colmap, found, *s->best);
    colmap_free(s->ctx, &found);
}

static void survey_try_entry(void *user, const char *name)
{
    struct survey_search *s = user;
    survey_try(s, PATH(s->in, "%s", name));
}

/* ---------------- LLFF's poses beside a COLMAP model */

/* Uses the images that belong to LLFF's poses, and the ranges of their depths, for the model that the poses
 * were computed from: it has the distortion, points and tracks. Otherwise the model remains as it is. */
static oxl_result survey_use_llff(oxl_context *ctx, const char *path, const char *images,
                                  struct colmap *model)
{
    struct scene_order *order = oxl_alloc(ctx, model->image_count + 1, sizeof *order);
    struct colmap llff = {0};
    const struct survey_given given = {.images = images};
    oxl_result rc = order ? json_survey_read(ctx, path, SURVEY_LLFF, &given, &llff) : OXL_ERR_MEMORY;
    for (size_t i = 0; order && i < model->image_count; i++)
        order[i] = (struct scene_order){model->names + model->image[i].name, i};
    if (order) qsort(order, model->image_count, sizeof *order, scene_compare_order);
    if (rc == OXL_OK && colmap_has_places(model, order, &llff)) {
        for (size_t i = 0; i < llff.image_count; i++) {
            struct colmap_image *to = &model->image[order[i].image];
            to->name = llff.image[i].name;
            memcpy(to->range, llff.image[i].range, sizeof to->range);
        }
        OXL_SWAP(char *, model->names, llff.names);
        OXL_SWAP(size_t, model->names_size, llff.names_size);
        OXL_SWAP(char *, model->images, llff.images);
        oxl_log(ctx, OXL_LOG_INFO, "%s: poses and points come from %s, images from %s", path, model->folder,
                model->images);
    } else if (rc == OXL_OK || rc == OXL_ERR_INPUT) {
        oxl_log(ctx, OXL_LOG_WARNING, "%s/" SURVEY_LLFF " is not used beside %s: %s", path, model->folder,
                rc == OXL_OK ? "it has other poses" : oxl_error_text(ctx));
        rc = OXL_OK;
    }
    oxl_free(ctx, order);
    colmap_free(ctx, &llff);
    return rc;
}

/* ---------------- files of programs that are not read */

/* Lists endings of files' names in a survey's folder, and what they are. */
static const char *const survey_foreign[][2] = {
    {"database.db", "COLMAP's matches, without cameras: colmap mapper finds them"},
    {"sfm_data.json", "OpenMVG's: openMVG_main_openMVG2Colmap writes a COLMAP model"},
    {".sfm", "Meshroom's: aliceVision_exportColmap writes a COLMAP model"},
    {"bundle.out", "Bundler's: export as COLMAP from the program that wrote it"},
    {".xmp", "RealityCapture's: export the registration as COLMAP"},
    {".csv", "a table of cameras: export the registration as COLMAP from the program that wrote it"},
    {".xml", "of Metashape or ContextCapture: in Metashape, File, Export, Export Cameras, COLMAP"},
};

struct survey_foreign_search {
    size_t found; /* row of the table */
    char name[80];
};

/* Keeps the file that the first row of the table fits: names come in no particular order. */
static void survey_find_visit_file(void *user, const char *name)
{
    struct survey_foreign_search *s = user;
    for (size_t i = 0; i < s->found; i++) {
        const size_t size = strlen(survey_foreign[i][0]), has = strlen(name);
        if (has < size || strcmp(name + has - size, survey_foreign[i][0]) != 0) continue;
        s->found = i;
        snprintf(s->name, sizeof s->name, "%.*s", (int)sizeof s->name - 1, name);
    }
}

/* Fails because there is no model, and names what is there instead. */
static oxl_result survey_find_fail(oxl_context *ctx, const char *path, const char *sparse, int is_given)
{
    static const char *const below[] = {"dense", "colmap", "undistorted", "distorted", ".."};
    struct survey_foreign_search s = {.found = OXL_COUNT(survey_foreign)};
    struct text there = {.ctx = ctx};
    oxl_result rc;
    if (os_is_folder(path)) os_list_folder(ctx, path, survey_find_visit_file, &s);
    if (s.name[0]) text_add(&there, "; %s there is %s", s.name, survey_foreign[s.found][1]);
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

OXL_INTERNAL oxl_result survey_find_model(oxl_context *ctx, const char *path, const char *option,
                                          const char *images, const char *file, struct colmap *out)
{
    const int is_file = option && os_is_file(option);
    const char *folder = is_file ? PATH_BESIDE(option, "") : option;
    const char *sparse_option = is_file && !survey_has(0, folder) ? NULL : folder;
    const char *sparse = survey_folder((char[PATH_LENGTH]){0}, path, sparse_option, "sparse");
    const char *requested = sparse_option ? sparse : path;
    struct survey_search s = {.ctx = ctx, .in = sparse, .best = out};
    s.given = (struct survey_given){images, images ? images : PATH(path, "images"), is_file ? option : NULL};
    *out = (struct colmap){0};
    if (!os_is_folder(requested))
        return oxl_fail(ctx, OXL_ERR_INPUT, "%s: there is no such folder\nfix: %s", requested,
                        sparse_option
                            ? "--sparse names a file of points, or the folder of cameras, images and points3D"
                            : "give the folder that holds images/ and sparse/");
    for (size_t i = SURVEY_COLMAP; file && i < OXL_COUNT(SURVEY_FILES); i++)
        if (!strcmp(file, SURVEY_FILES[i][0])) s.row = i;
    for (; s.row < OXL_COUNT(SURVEY_FILES) && s.rc == OXL_OK && s.models == 0; s.row++) {
        if (s.row < SURVEY_COLMAP) {
            survey_try(&s, sparse);
            if (s.rc == OXL_OK && os_is_folder(sparse)) {
                const oxl_result listed = os_list_folder(ctx, sparse, survey_try_entry, &s);
                if (s.rc == OXL_OK) s.rc = listed;
            }
        }
        if (s.models == 0 && !sparse_option) survey_try(&s, path);
        if (s.row == 1 && s.rc == OXL_ERR_INPUT && !sparse_option && survey_has_other(path)) {
            oxl_log(ctx, OXL_LOG_WARNING, "%s describes the survey, since COLMAP's model lacks a file: %s",
                    survey_has_other(path), oxl_error_text(ctx));
            s.rc = OXL_OK;
        }
    }
    if (s.rc == OXL_OK && s.models == 0) s.rc = survey_find_fail(ctx, path, sparse, sparse_option != NULL);
    if (s.rc == OXL_OK && s.models > 1)
        oxl_log(ctx, OXL_LOG_WARNING,
                "%d sub-models found; %s has most images (%zu) and is used; --sparse names another", s.models,
                out->folder, out->image_count);
    if (s.rc == OXL_OK && !sparse_option && out->format != COLMAP_JSON && os_is_file(PATH(path, SURVEY_LLFF)))
        s.rc = survey_use_llff(ctx, path, images, out);
    if (s.rc != OXL_OK) colmap_free(ctx, out);
    return s.rc;
}
