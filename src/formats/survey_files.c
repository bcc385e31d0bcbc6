/* survey_files.c - lists the image files of a survey, and finds those that its model names.
 *
 * Models come from other computers. Their names begin with other folders or drives, have backslashes, have
 * letters in another form (macOS stores u and U+0308 for the one character U+00FC), or another extension
 * (OpenSfM's a.jpg.jpg). So names are compared in one form, and of the files that end like a name, the one
 * with the longest equal end is taken: whole parts between slashes.
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

/* Lists the canonical decompositions of Latin, Greek, Cyrillic and Japanese characters [Unicode, UAX 15]. */
/* clang-format off */
static const struct name_row {
    uint16_t first, letter, mark;    /* code points: of the row's beginning, and of '0' in its strings */
    const char *letters, *marks, *second; /* by code point; blank: the character is one already */
} NAME_ROWS[] = {
    {0xC0, 0x30, 0x300,
     "AAAAAA CEEEEIIII NOOOOO  UUUUY  aaaaaa ceeeeiiii nooooo  uuuuy yAaAaAaCcCcCcCcDd  EeEeEeEeEe"
     "GgGgGgGgHh  IiIiIiIiI   JjKk LlLlLl    NnNnNn   OoOoOo  RrRrRrSsSsSsSsTtTt  UuUuUuUuUuUuWwYy"
     "YZzZzZz                                 Oo             Uu",
     "01238: W01280128 301238  01281  01238: W01280128 301238  01281 84466XX112277<<<<  446677XX<<"
     "226677WW22  334466XX7   22WW 11WW<<    11WW<<   4466;;  11WW<<1122WW<<WW<<  334466::;;XX2222"
     "81177<<                                 KK             KK",
     NULL},
    {0x1E00, 0x30, 0x300,
     "AaBbBbBbCcDdDdDdDdDdEeEeEeEeEeFfGgHhHhHhHhHhIiIiKkKkKkLlLlLlLlMmMmMmNnNnNnNnOoOoOoOoPpPpRrRr"
     "RrRrSsSsSsSsSsTtTtTtTtUuUuUuUuUuVvVvWwWwWwWwWwXxXxYyZzZzZzhtwy      AaAaAaAaAaAaAaAaAaAaAaAa"
     "EeEeEeEeEeEeEeEeIiIiOoOoOoOoOoOoOoOoOoOoOoOoUuUuUuUuUuUuUuYyYyYyYy",
     "UU77SSaaWW77SSaaWW]]4444]]``WW774477SS88WW^^``8811SSaaSSSSaa]]1177SS77SSaa]]33334444117777SS"
     "SSaa77SS11<<SS77SSaa]]TT``]]334433SS00118877SS77887722SSaaa8::      SS9922222222SS66666666SS"
     "SS993322222222SS99SSSS9922222222SSKKKKKKKKKKSS99KKKKKKKKKK00SS9933",
     "        11          0011    66                11        44                  11880011        "
     "44      777777              1188                                        11009933221100993366"
     "      1100993322        110099332211009933SS    11009933SS"},
    {0x386, 0x391, 0x300,
     "0 468 > DHX                         8DPTVXd                         Xd^dh",
     "1 111 1 118                         8811118                         88111",
     "          1                               1"},
    {0x400, 0x410, 0x300,
     "55 3        :8C          8                               X                      UU S   v    "
     "ZXc",
     "08 1        106          6                               6                      08 1   8    "
     "106",
     NULL},
    {0x304C, 0x3046, 0x3099,
     "5 7 9 ; = ? A C E G I K  N P R      YY \\\\ __ bb ee                      0",
     "0 0 0 0 0 0 0 0 0 0 0 0  0 0 0      01 01 01 01 01                      0",
     NULL},
    {0x30AC, 0x30A6, 0x3099,
     "5 7 9 ; = ? A C E G I K  N P R      YY \\\\ __ bb ee                      0",
     "0 0 0 0 0 0 0 0 0 0 0 0  0 0 0      01 01 01 01 01                      0",
     NULL},
};
/* clang-format on */

enum { NAME_HANGUL = 0xAC00, NAME_SYLLABLES = 11172, NAME_FORM = 3 * PATH_LENGTH };

/* Reads a character of UTF-8, or a byte of what is none. */
static uint32_t name_character(const char **text)
{
    const unsigned char *s = (const unsigned char *)*text;
    const int more = *s >= 0xF0 ? 3 : *s >= 0xE0 ? 2 : *s >= 0xC0 ? 1 : 0;
    uint32_t c = more ? *s & (0x3Fu >> more) : *s;
    ++*text;
    for (int i = 1; i <= more; i++) {
        if ((s[i] & 0xC0) != 0x80) return *s;
        c = c << 6 | (s[i] & 0x3F);
    }
    *text += more;
    return c;
}

/* Adds a character in bytes that are its own: ASCII in lower case, or three bytes above it. */
static char *name_add(char *out, uint32_t c)
{
    if (c >= 'A' && c <= 'Z') c += 32;
    if (c < 0x80) return *out = (char)(c == '\\' ? '/' : c), out + 1;
    for (int shift = 14; shift >= 0; shift -= 7) *out++ = (char)(0x80 | (c >> shift & 0x7F));
    return out;
}

/* Adds a character, decomposed. */
static char *name_decompose(char *out, uint32_t c)
{
    const uint32_t syllable = c - NAME_HANGUL;
    if (syllable < NAME_SYLLABLES) {
        out = name_add(name_add(out, 0x1100 + syllable / 588), 0x1161 + syllable % 588 / 28);
        return syllable % 28 ? name_add(out, 0x11A7 + syllable % 28) : out;
    }
    for (size_t i = 0; i < OXL_COUNT(NAME_ROWS) && c >= 0x80; i++) {
        const struct name_row *row = &NAME_ROWS[i];
        const uint32_t at = c - row->first;
        if (at >= strlen(row->letters) || row->letters[at] == ' ') continue;
        out = name_add(out, row->letter + (uint32_t)row->letters[at] - '0');
        out = name_add(out, row->mark + (uint32_t)row->marks[at] - '0');
        return row->second && at < strlen(row->second) && row->second[at] != ' '
                   ? name_add(out, row->mark + (uint32_t)row->second[at] - '0')
                   : out;
    }
    return name_add(out, c);
}

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

/* Writes a name in the form in which names are compared, without the extensions of images. */
static void name_form(const char *name, char form[NAME_FORM])
{
    char *out = form, *dot;
    while (*name && out < form + NAME_FORM - 10) out = name_decompose(out, name_character(&name));
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
    const oxl_scene *scene;
    struct survey_file *file;
    size_t count, capacity;
    oxl_result rc;
};
struct survey_walk { /* Visits a folder. */
    struct survey_files *files;
    const char *inside; /* "", or "a/b/" */
    int depth;
};
enum { SURVEY_DEPTH = 3 };

static void survey_add_file(struct survey_walk *w, const char *path)
{
    struct survey_files *f = w->files;
    struct survey_file file = {.path = oxl_strdup(f->ctx, path)};
    char form[NAME_FORM], *slash;
    name_form(path, form);
    file.form = oxl_strdup(f->ctx, form);
    if (f->rc == OXL_OK)
        f->rc = file.path && file.form
                    ? oxl_reserve(f->ctx, &f->file, &f->capacity, f->count + 1, sizeof file)
                    : OXL_ERR_MEMORY;
    if (f->rc != OXL_OK) {
        OXL_FREE(f->ctx, file.path, file.form);
        return;
    }
    slash = strrchr(file.form, '/');
    file.base = slash ? slash + 1 : file.form;
    f->file[f->count++] = file;
}

/* Adds a file, or those of a folder. Leaves out hidden files, what network drives and systems keep in folders
 * of their own, such as @eaDir, and links to nothing. */
static void survey_visit(void *user, const char *name)
{
    static const char *const others[] = {"masks", "__MACOSX", "thumbs", "thumbnails"};
    struct survey_walk *w = user, deeper = {.files = w->files, .depth = w->depth + 1};
    const char *folder = w->files->scene->images;
    char inside[PATH_LENGTH];
    const size_t length = (size_t)snprintf(inside, sizeof inside - 1, "%s%s", w->inside, name);
    if (name[0] == '.' || length >= sizeof inside - 1 || w->files->rc != OXL_OK) return;
    if (survey_is_image_name(name) && os_is_file(PATH(folder, "%s", inside))) survey_add_file(w, inside);
    else if (w->depth < SURVEY_DEPTH && !strchr("@#$", name[0]) && os_is_folder(PATH(folder, "%s", inside))) {
        for (size_t i = 0; i < OXL_COUNT(others); i++)
            if (!strcmp(name, others[i])) return;
        memcpy(inside + length, "/", 2);
        deeper.inside = inside;
        os_list_folder(w->files->ctx, PATH(folder, "%s", inside), survey_visit, &deeper);
    }
}

static int survey_compare_files(const void *a, const void *b)
{
    const struct survey_file *s = a, *t = b;
    const int order = strcmp(s->base, t->base);
    return order ? order : strcmp(s->path, t->path);
}

static int survey_compare_base(const void *a, const void *b)
{
    return strcmp(((const struct survey_file *)a)->base, ((const struct survey_file *)b)->base);
}

static oxl_result survey_files_list(oxl_context *ctx, const oxl_scene *scene, struct survey_files *out)
{
    struct survey_walk w = {.files = out, .inside = ""};
    *out = (struct survey_files){.ctx = ctx, .scene = scene};
    os_list_folder(ctx, scene->images, survey_visit, &w);
    if (out->count) qsort(out->file, out->count, sizeof *out->file, survey_compare_files);
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
    struct survey_file wanted = {.base = form}, *at, *best = NULL;
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

OXL_INTERNAL void survey_find_like(oxl_context *ctx, const char *folder, const char *name, char *out,
                                   size_t size)
{
    struct oxl_scene scene = {.images = (char *)(uintptr_t)folder};
    struct survey_files files;
    const struct survey_file *found =
        survey_files_list(ctx, &scene, &files) == OXL_OK ? survey_files_find(&files, name, 0) : NULL;
    snprintf(out, size, "%s", found ? PATH(folder, "%s", found->path) : "");
    survey_files_free(&files);
}

/* ---------------- the names of the model */

/* Gives images the names of the files that are theirs alone. claim: (images) NULL: keep the name. */
static oxl_result survey_rename(oxl_context *ctx, oxl_scene *scene, struct survey_file *const *claim)
{
    struct colmap *c = &scene->colmap;
    const char *from = NULL, *to = NULL;
    size_t size = c->names_size, count = 0;
    char *names;
    for (size_t i = 0; i < c->image_count; i++)
        if (claim[i] && claim[i]->claims == 1) size += strlen(claim[i]->path) + 1, count++;
    if (count == 0) return OXL_OK;
    names = oxl_regrow(ctx, c->names, c->names_size, size, 1);
    if (!names) return OXL_ERR_MEMORY;
    c->names = names;
    for (size_t i = 0; i < c->image_count; i++) {
        if (!claim[i] || claim[i]->claims != 1) continue;
        if (!from) from = c->names + c->image[i].name, to = claim[i]->path;
        c->image[i].name = c->names_size;
        c->names_size += (size_t)sprintf(c->names + c->names_size, "%s", claim[i]->path) + 1;
        claim[i]->used = 1;
    }
    oxl_log(ctx, OXL_LOG_INFO,
            "%zu of %zu images have other names in the model than in %s; files whose paths end in the "
            "same way are used: %s for %s",
            count, c->image_count, scene->images, to, from);
    return OXL_OK;
}

OXL_INTERNAL oxl_result survey_match_names(oxl_context *ctx, oxl_scene *scene)
{
    const struct colmap *c = &scene->colmap;
    struct survey_file **claim = oxl_calloc(ctx, c->image_count + 1, sizeof *claim);
    struct survey_files files;
    oxl_result rc = survey_files_list(ctx, scene, &files);
    if (!claim) rc = OXL_ERR_MEMORY;
    for (size_t i = 0; i < c->image_count && rc == OXL_OK; i++)
        if ((claim[i] = survey_files_find(&files, c->names + c->image[i].name, 1)) != NULL)
            claim[i]->used = 1;
    for (size_t i = 0; i < c->image_count && rc == OXL_OK; i++) {
        const char *name = c->names + c->image[i].name;
        const int is_there = claim[i] || os_is_file(PATH(scene->images, "%s", name));
        claim[i] = is_there ? NULL : survey_files_find(&files, name, 0);
        if (claim[i]) claim[i]->claims++;
    }
    if (rc == OXL_OK) rc = survey_rename(ctx, scene, claim);
    /* A folder in which names start beside other files may hold any image. */
    for (size_t i = 0; i < files.count && !c->states_split && !c->images; i++)
        scene->stats.unregistered += !files.file[i].used;
    oxl_free(ctx, claim);
    survey_files_free(&files);
    return rc;
}
