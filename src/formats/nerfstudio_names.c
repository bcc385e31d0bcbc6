/* nerfstudio_names.c - finds names of images in a transforms.json: their extension, the size of the first
 * image, and the images that the file holds out.
 *
 * Source: docs.nerf.studio, "Data conventions": train_filenames, val_filenames and test_filenames repeat the
 * file_path of frames.
 *
 * Invariant: an image is trained on only if the file does not hold it out.
 */
#include "../survey/image.h"
#include "json_survey.h"

OXL_INTERNAL const char *nerfstudio_folder(const struct colmap_reader *r, char *out)
{
    const char *slash = strrchr(r->path, '/');
    if (r->image_folder) snprintf(out, PATH_LENGTH, "%s", r->image_folder);
    else
        snprintf(out, PATH_LENGTH, "%.*s%s", slash ? (int)(slash - r->path) : 1, slash ? r->path : ".",
                 r->out->images_beside ? "" : "/images");
    return out;
}

/* Counts the letters of an image's extension, with the dot; 0: the name has none. */
static size_t nerfstudio_extension(const char *name)
{
    static const char *const known[] = {".png", ".jpg", ".jpeg"};
    const char *dot = strrchr(path_base_name(name), '.');
    for (size_t i = 0; dot && i < OXL_COUNT(known); i++) {
        size_t same = 0;
        while (known[i][same] && (dot[same] | 0x20) == (known[i][same] | 0x20)) same++;
        if (!known[i][same] && !dot[same]) return same;
    }
    return 0;
}

/* Adds the extension that Blender's files leave out: that of a file that exists, else
 * .png. room: bytes at `at`. */
static size_t nerfstudio_add_extension(const struct colmap_reader *r, const char *name, char *at, size_t room)
{
    static const char *const tried[] = {"", ".png", ".jpg", ".jpeg", ".PNG", ".JPG", ".JPEG"};
    const int dotted = strchr(path_base_name(name), '.') != NULL;
    char folder[PATH_LENGTH];
    nerfstudio_folder(r, folder);
    for (size_t i = 0; i < OXL_COUNT(tried); i++)
        if (os_is_file(PATH(folder, "%s%s", name, tried[i])))
            return (size_t)snprintf(at, room, "%s", tried[i]);
    return (size_t)snprintf(at, room, "%s", dotted ? "" : ".png");
}

OXL_INTERNAL const char *nerfstudio_name(const struct colmap_reader *r, const char *value, char *path,
                                         const char **end)
{
    enum { ROOM = 8 };
    size_t length = oxl_json_text(value, path, NERFSTUDIO_PATH - ROOM);
    const char *name = path;
    if (length == 0) return NULL;
    if (!strncmp(name, "./", 2)) name += 2;
    if (!r->out->images_beside && !strncmp(name, "images/", 7)) name += 7;
    if (!nerfstudio_extension(name)) length += nerfstudio_add_extension(r, name, path + length, ROOM);
    *end = path + length;
    return name;
}

OXL_INTERNAL void nerfstudio_measure_image(struct colmap_reader *r, const char *json)
{
    char path[NERFSTUDIO_PATH], folder[PATH_LENGTH];
    const char *frame = oxl_json_first(oxl_json_member(json, "frames")), *end;
    nerfstudio_folder(r, folder);
    for (; frame && r->width == 0; frame = oxl_json_next(frame)) {
        const char *name = nerfstudio_name(r, oxl_json_member(frame, "file_path"), path, &end);
        const char *file = name ? PATH(folder, "%s", name) : NULL;
        if (file && os_is_file(file)) image_size(r->ctx, file, &r->width, &r->height);
    }
}

/* ---------------- images that the file holds out */

struct nerfstudio_list {
    oxl_context *ctx;
    struct nerfstudio_entry {
        size_t name;      /* offset in `names` */
        const char *text; /* the name; set when `names` grows no more */
        int of;           /* list that names it, an index in NERFSTUDIO_LISTS */
    } * entry;
    size_t count, capacity;
    struct text names; /* zero-terminated, one after the other */
};

static const char *const NERFSTUDIO_LISTS[] = {"train_filenames", "test_filenames", "val_filenames"};
enum { NERFSTUDIO_TRAIN, NERFSTUDIO_TEST, NERFSTUDIO_VAL };

static int nerfstudio_compare_entries(const void *a, const void *b)
{
    return strcmp(((const struct nerfstudio_entry *)a)->text, ((const struct nerfstudio_entry *)b)->text);
}

static oxl_result nerfstudio_list_add(const struct colmap_reader *r, const char *array, int of,
                                      struct nerfstudio_list *list)
{
    char path[NERFSTUDIO_PATH];
    oxl_result rc = OXL_OK;
    for (const char *value = oxl_json_first(array); value && rc == OXL_OK; value = oxl_json_next(value)) {
        const char *end, *name = nerfstudio_name(r, value, path, &end);
        if (!name) continue;
        rc = oxl_reserve(r->ctx, &list->entry, &list->capacity, list->count + 1, sizeof *list->entry);
        if (rc != OXL_OK) break;
        list->entry[list->count++] = (struct nerfstudio_entry){.name = list->names.size, .of = of};
        text_add(&list->names, "%s%c", name, 0);
    }
    return rc == OXL_OK && list->names.failed ? OXL_ERR_MEMORY : rc;
}

/* Returns the split of a list: val_filenames are held out if there are no test_filenames. */
static enum colmap_split nerfstudio_split_of(int of, const size_t listed[3])
{
    if (of == NERFSTUDIO_TRAIN) return COLMAP_TRAIN;
    return of == NERFSTUDIO_TEST || listed[NERFSTUDIO_TEST] == 0 ? COLMAP_TEST : COLMAP_UNSPLIT;
}

/* Leaves one entry for each image; an image in several lists is held out if one of them holds it out. */
static void nerfstudio_list_unite(struct nerfstudio_list *list)
{
    const size_t all = list->count;
    qsort(list->entry, all, sizeof *list->entry, nerfstudio_compare_entries);
    list->count = 0;
    for (size_t i = 0; i < all; i++) {
        struct nerfstudio_entry *last = list->count ? &list->entry[list->count - 1] : NULL;
        const int of = list->entry[i].of;
        if (!last || strcmp(last->text, list->entry[i].text)) list->entry[list->count++] = list->entry[i];
        else if (of == NERFSTUDIO_TEST || last->of == NERFSTUDIO_TRAIN) last->of = of;
    }
}

/* Keeps the images that are trained on or held out; without train_filenames, images
 * in no list are trained on. */
static void nerfstudio_keep_listed(struct colmap_reader *r, const struct nerfstudio_list *list,
                                   const size_t listed[3])
{
    struct colmap *c = r->out;
    const size_t all = c->image_count;
    size_t held_out = 0;
    c->image_count = 0;
    for (size_t i = 0; i < all; i++) {
        const struct nerfstudio_entry key = {.text = c->names + c->image[i].name},
                                      *found = bsearch(&key, list->entry, list->count, sizeof key,
                                                       nerfstudio_compare_entries);
        c->image[i].split = found                           ? nerfstudio_split_of(found->of, listed)
                            : listed[NERFSTUDIO_TRAIN] == 0 ? COLMAP_TRAIN
                                                            : COLMAP_UNSPLIT;
        held_out += c->image[i].split == COLMAP_TEST;
        if (c->image[i].split != COLMAP_UNSPLIT) c->image[c->image_count++] = c->image[i];
    }
    c->states_split = 1;
    oxl_log(r->ctx, c->image_count < all ? OXL_LOG_WARNING : OXL_LOG_INFO,
            "%s states the split: %zu images are trained on, %zu held out, %zu neither and left out", r->path,
            c->image_count - held_out, held_out, all - c->image_count);
}

OXL_INTERNAL oxl_result nerfstudio_split(struct colmap_reader *r, const char *json)
{
    struct nerfstudio_list list = {.ctx = r->ctx, .names = {.ctx = r->ctx}};
    size_t listed[3];
    oxl_result rc = OXL_OK;
    for (int k = 0; k < 3 && rc == OXL_OK; k++) {
        const size_t before = list.count;
        rc = nerfstudio_list_add(r, oxl_json_member(json, NERFSTUDIO_LISTS[k]), k, &list);
        listed[k] = list.count - before;
    }
    for (size_t i = 0; i < list.count && rc == OXL_OK; i++)
        list.entry[i].text = list.names.data + list.entry[i].name;
    if (rc == OXL_OK && list.count) {
        nerfstudio_list_unite(&list);
        nerfstudio_keep_listed(r, &list, listed);
    }
    text_free(&list.names);
    oxl_free(r->ctx, list.entry);
    return rc;
}
