/* survey_files.c - lists the image files of a survey, and finds those that its model names.
 *
 * Models come from other computers. Their names begin with other folders or drives, have backslashes, have
 * letters in another form (macOS stores u and U+0308 for the one character U+00FC), or another extension
 * (OpenSfM's a.jpg.jpg). So names are compared in one form, in which letters that have two are alike, and of
 * the files that end like a name, the one with the longest equal end is taken: whole parts between slashes.
 *
 * Invariant: a file is the image of one name at most, and a name that is there is never exchanged.
 */
#include "formats.h"
#include "survey_read.h"
#include "../survey/scene.h"

OXL_INTERNAL const char *survey_folder(char out[PATH_LENGTH], const char *survey, const char *option,
                                       const char *otherwise)
{
    if (option && os_is_folder(option)) return option;
    path_in(out, survey, "%s", option ? option : otherwise);
    return !option || os_is_folder(out) ? out : option;
}

/* ---------------- one form of names */

enum { NAME_FORM = PATH_LENGTH };

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

/* Returns 1 for one of the marks that combine with the letter before them, U+0300 to U+036F. */
static int name_is_mark(const unsigned char *s)
{
    return (s[0] == 0xCC && s[1] >= 0x80) || (s[0] == 0xCD && s[1] <= 0xAF);
}

/* Writes a name in the form in which names are compared: in lower case, with slashes, without the extensions
 * of images, and with one byte for letters that are not ASCII or have a mark, whatever their number. */
static void name_form(const char *name, char form[NAME_FORM])
{
    const unsigned char *s = (const unsigned char *)name;
    char *out = form, *dot;
    for (; *s && out < form + NAME_FORM - 1; s++) {
        if (*s >= 0x80 || name_is_mark(s + 1)) {
            if (out == form || out[-1] != '\x80') *out++ = '\x80';
        } else *out++ = (char)(*s == '\\' ? '/' : *s >= 'A' && *s <= 'Z' ? *s + 32 : *s);
    }
    *out = 0;
    while (survey_is_image_name(form)) *strrchr(form, '.') = 0;
    dot = strrchr(form, '.');
    if (dot && (!strcmp(dot, ".tif") || !strcmp(dot, ".tiff"))) *dot = 0;
}

/* Returns the number of parts in which two forms end alike. */
static int name_tail(const char *a, const char *b)
{
    size_t m = strlen(a), n = strlen(b);
    int parts = 0;
    while (m && n && a[m - 1] == b[n - 1]) parts += a[--m] == '/', n--;
    return parts + ((m == 0 || a[m - 1] == '/') && (n == 0 || b[n - 1] == '/'));
}

/* ---------------- the list of files */

struct survey_file {
    const char *base; /* last part of the form */
    char *path, *form;
    int used, claims; /* used 1: by a name that is there */
};
struct survey_files {
    oxl_context *ctx;
    const char *folder;
    struct survey_file *file;
    size_t count, file_capacity;
    oxl_result rc;
};
struct survey_walk { /* Visits a folder. */
    struct survey_files *files;
    const char *inside; /* "", or "a/b/" */
    int depth;
};
enum { SURVEY_DEPTH = 3 };

static void survey_add_file(struct survey_files *f, const char *path)
{
    struct survey_file *file;
    char form[NAME_FORM];
    if (f->rc == OXL_OK) f->rc = OXL_RESERVE(f->ctx, f->file, f->count + 1);
    if (f->rc != OXL_OK) return;
    name_form(path, form);
    file = &f->file[f->count++];
    *file = (struct survey_file){.path = oxl_strdup(f->ctx, path), .form = oxl_strdup(f->ctx, form)};
    if (!file->path || !file->form) f->rc = OXL_ERR_MEMORY;
    else file->base = path_base_name(file->form);
}

/* Adds a file, or those of a folder. Leaves out hidden files, what network drives and systems keep in folders
 * of their own, such as @eaDir, and links to nothing. */
static void survey_visit(void *user, const char *name)
{
    static const char *const others[] = {"mask",   "masks",      "depth",     "__macosx",
                                         "thumbs", "thumbnails", "thumbnail", "_thumbs"};
    char form[NAME_FORM];
    struct survey_walk *w = user;
    const char *inside = PATH("", "%s%s", w->inside, name), *path = PATH(w->files->folder, "%s", inside);
    struct survey_walk deeper = {w->files, PATH("", "%s/", inside), w->depth + 1};
    size_t i = 0;
    if (name[0] == '.') return;
    if (survey_is_image_name(name) && os_is_file(path)) survey_add_file(w->files, inside);
    else if (w->depth < SURVEY_DEPTH && !strchr("@#$", name[0]) && os_is_folder(path)) {
        name_form(name, form);
        while (i < OXL_COUNT(others) && strcmp(form, others[i])) i++;
        if (i == OXL_COUNT(others)) os_list_folder(w->files->ctx, path, survey_visit, &deeper);
    }
}

static int survey_compare_base(const void *a, const void *b)
{
    return strcmp(((const struct survey_file *)a)->base, ((const struct survey_file *)b)->base);
}

static int survey_compare_files(const void *a, const void *b)
{
    const int order = survey_compare_base(a, b);
    return order ? order
                 : strcmp(((const struct survey_file *)a)->path, ((const struct survey_file *)b)->path);
}

static oxl_result survey_files_list(oxl_context *ctx, const char *folder, struct survey_files *out)
{
    struct survey_walk w = {.files = out, .inside = ""};
    *out = (struct survey_files){.ctx = ctx, .folder = folder};
    os_list_folder(ctx, folder, survey_visit, &w);
    if (out->count && out->rc == OXL_OK)
        qsort(out->file, out->count, sizeof *out->file, survey_compare_files);
    return out->rc;
}

static void survey_files_free(struct survey_files *f)
{
    for (size_t i = 0; i < f->count; i++) OXL_FREE(f->ctx, f->file[i].path, f->file[i].form);
    oxl_free(f->ctx, f->file);
}

/* Finds the file of a name: by the whole name, or, exact 0, among files that are not used the one that ends
 * most like it. NULL: there is none, or more than one. */
static struct survey_file *survey_files_find(const struct survey_files *f, const char *name, int exact)
{
    char form[NAME_FORM];
    struct survey_file wanted, *at, *best = NULL;
    int most = 0;
    name_form(name, form);
    wanted.base = path_base_name(form);
    at = f->count ? bsearch(&wanted, f->file, f->count, sizeof wanted, survey_compare_base) : NULL;
    while (at && at > f->file && !survey_compare_base(at - 1, &wanted)) at--;
    for (; at && at < f->file + f->count && !survey_compare_base(at, &wanted); at++) {
        const int parts = at->used && !exact ? 0
                          : exact            ? !strcmp(at->path, name)
                                             : name_tail(at->form, form);
        if (parts > most) best = at, most = parts;
        else if (parts == most) best = NULL;
    }
    return most ? best : NULL;
}

/* ---------------- the names of the model */

/* Gives an image the name of a file. */
static oxl_result survey_rename(oxl_context *ctx, struct colmap *c, struct colmap_image *image,
                                const char *name)
{
    const size_t length = strlen(name) + 1;
    char *names = oxl_regrow(ctx, c->names, c->names_size, c->names_size + length, 1);
    if (!names) return OXL_ERR_MEMORY;
    c->names = names;
    memcpy(names + c->names_size, name, length);
    image->name = c->names_size;
    c->names_size += length;
    return OXL_OK;
}

/* Gives images the names of the files that are theirs alone. claim: (images) NULL: keep the name. */
static oxl_result survey_take_claims(oxl_context *ctx, oxl_scene *scene, struct survey_file *const *claim)
{
    struct colmap *c = &scene->colmap;
    char example[2 * 200] = "";
    size_t count = 0;
    oxl_result rc = OXL_OK;
    for (size_t i = 0; i < c->image_count && rc == OXL_OK; i++) {
        if (!claim[i] || claim[i]->claims != 1) continue;
        if (!count++)
            snprintf(example, sizeof example, "%.190s for %.190s", claim[i]->path,
                     c->names + c->image[i].name);
        rc = survey_rename(ctx, c, &c->image[i], claim[i]->path);
        claim[i]->used = 1;
    }
    if (count)
        oxl_log(ctx, OXL_LOG_INFO,
                "%zu of %zu images have other names in the model than in %s; files whose paths end in the "
                "same way are used: %s",
                count, c->image_count, scene->images, example);
    return rc;
}

OXL_INTERNAL oxl_result survey_match_names(oxl_context *ctx, oxl_scene *scene)
{
    const struct colmap *c = &scene->colmap;
    struct survey_file **claim = oxl_calloc(ctx, c->image_count + 1, sizeof *claim);
    struct survey_files files;
    oxl_result rc = survey_files_list(ctx, scene->images, &files);
    if (!claim) rc = OXL_ERR_MEMORY;
    /* Names that are there, then the others, among the files that are left. */
    for (int exact = 1; exact >= 0; exact--)
        for (size_t i = 0; i < c->image_count && rc == OXL_OK; i++) {
            const char *name = c->names + c->image[i].name;
            if (!exact && (claim[i] || os_is_file(PATH(scene->images, "%s", name)))) claim[i] = NULL;
            else if ((claim[i] = survey_files_find(&files, name, exact)) == NULL) continue;
            else if (exact) claim[i]->used = 1;
            else claim[i]->claims++;
        }
    if (rc == OXL_OK) rc = survey_take_claims(ctx, scene, claim);
    /* A folder in which names start beside other files may hold any image. */
    for (size_t i = 0; i < files.count && !c->states_split && !c->images; i++)
        scene->stats.unregistered += !files.file[i].used;
    oxl_free(ctx, claim);
    survey_files_free(&files);
    return rc;
}
