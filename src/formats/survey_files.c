/* survey_files.c - searches image files of a survey that are missing, and counts those that the model
 * lacks.
 */
#include "survey_read.h"
#include "../survey/scene.h"

/* ---------------- missing images */

struct survey_find_search {
    oxl_context *ctx;
    const char *folder, *wanted; /* wanted: base name */
    int depth;
    char found[256]; /* path of the file found; "": none yet */
};

/* Returns 1 if names are equal except for extension and case. */
static int survey_find_is_like(const char *a, const char *b)
{
    const char *end_a = strrchr(a, '.'), *end_b = strrchr(b, '.');
    size_t n = end_a ? (size_t)(end_a - a) : strlen(a);
    if (n != (end_b ? (size_t)(end_b - b) : strlen(b))) return 0;
    for (size_t i = 0; i < n; i++) {
        const int x = a[i] >= 'A' && a[i] <= 'Z' ? a[i] + 32 : a[i],
                  y = b[i] >= 'A' && b[i] <= 'Z' ? b[i] + 32 : b[i];
        if (x != y) return 0;
    }
    return 1;
}

static void survey_find_visit_entry(void *user, const char *name)
{
    struct survey_find_search *search = user;
    const char *path = PATH(search->folder, "%s", name);
    if (search->found[0]) return;
    if (os_is_folder(path) && search->depth < 3) {
        struct survey_find_search deeper = {
            .ctx = search->ctx, .folder = path, .wanted = search->wanted, .depth = search->depth + 1};
        os_list_folder(search->ctx, path, survey_find_visit_entry, &deeper);
        memcpy(search->found, deeper.found, sizeof search->found);
    } else if (survey_find_is_like(name, search->wanted)) {
        snprintf(search->found, sizeof search->found, "%s", path);
    }
}

OXL_INTERNAL void survey_find_like(oxl_context *ctx, const char *folder, const char *name, char *out,
                                   size_t size)
{
    struct survey_find_search search = {.ctx = ctx, .folder = folder, .wanted = path_base_name(name)};
    os_list_folder(ctx, folder, survey_find_visit_entry, &search);
    snprintf(out, size, "%s", search.found);
}

/* ---------------- images that the model does not have */

struct survey_unregistered {
    oxl_context *ctx;
    const oxl_scene *scene;
    char inside[PATH_LENGTH]; /* folder inside the image folder: "", or "a/b/" */
    int depth, count;
    int has_views; /* 1: an image of the model is in `inside` itself */
};

OXL_INTERNAL int survey_is_image_name(const char *name)
{
    static const char *const known[] = {".jpg", ".jpeg", ".png"};
    const char *dot = strrchr(name, '.');
    for (size_t i = 0; dot && dot > name && i < OXL_COUNT(known); i++) {
        size_t k = 1;
        while (known[i][k] && (dot[k] | 0x20) == known[i][k]) k++;
        if (!known[i][k] && !dot[k]) return 1;
    }
    return 0;
}

static int survey_compare_view(const void *name, const void *view)
{
    return strcmp(name, ((const oxl_view *)view)->name);
}

static int survey_has_views_in(const oxl_scene *scene, const char *inside)
{
    const size_t length = strlen(inside);
    for (int i = 0; i < scene->view_count; i++)
        if (!strncmp(scene->view[i].name, inside, length) && !strchr(scene->view[i].name + length, '/'))
            return 1;
    return 0;
}

/* Counts an image that no view has, or those of a sub-folder. If names start in the survey's folder, only
 * folders with views count, since it may hold any image. */
static void survey_visit_unregistered(void *user, const char *name)
{
    struct survey_unregistered *u = user;
    char inside[PATH_LENGTH];
    const int fits = snprintf(inside, sizeof inside, "%s%s", u->inside, name) < (int)sizeof inside;
    const char *full = PATH(u->scene->images, "%s", inside);
    if (!fits || name[0] == '.' || !strcmp(name, "masks")) return;
    if (os_is_folder(full) && u->depth < 3) {
        struct survey_unregistered deeper = {.ctx = u->ctx, .scene = u->scene, .depth = u->depth + 1};
        if (snprintf(deeper.inside, sizeof deeper.inside, "%s/", inside) >= (int)sizeof deeper.inside) return;
        deeper.has_views = survey_has_views_in(u->scene, deeper.inside);
        os_list_folder(u->ctx, full, survey_visit_unregistered, &deeper);
        u->count += deeper.count;
    } else if (survey_is_image_name(name) && (u->has_views || !u->scene->colmap.images_beside))
        u->count += bsearch(inside, u->scene->view, (size_t)u->scene->view_count, sizeof *u->scene->view,
                            survey_compare_view) == NULL;
}

OXL_INTERNAL int survey_count_unregistered(oxl_context *ctx, const oxl_scene *scene)
{
    struct survey_unregistered u = {.ctx = ctx, .scene = scene, .has_views = survey_has_views_in(scene, "")};
    if (!scene->colmap.states_split) os_list_folder(ctx, scene->images, survey_visit_unregistered, &u);
    return u.count;
}
