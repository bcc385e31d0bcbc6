/* render_names.c - makes the names of files that are rendered of views.
 *
 * Invariant: no name leads out of its folder, by ".." or through a link, none is longer than file systems
 * take, and names of two views differ.
 */
#include "job.h"
#include "../survey/scene.h"

enum {
    /* bytes of a name without its suffix; the limit of file systems, 255, leaves room
     * for suffix and ".PID.tmp" */
    RENDER_NAME_LENGTH = 200,
    RENDER_NAME_DIGITS = 16 /* digits of the checksum of the whole name, in a name that is cut */
};

/* ---------------- a view's file */

/* Adds the last part of a name. Cuts a long one at the beginning of a character, and adds a checksum of the
 * whole name, so that names stay different. */
static void render_name_add_last(struct text *t, const char *name, const char *whole)
{
    size_t size = strlen(name);
    if (size <= RENDER_NAME_LENGTH) {
        text_add(t, "%s", name);
        return;
    }
    size = RENDER_NAME_LENGTH - RENDER_NAME_DIGITS - 1;
    while (size > 0 && ((unsigned char)name[size] & 0xC0) == 0x80) size--;
    text_add(t, "%.*s-%016llx", (int)size, name,
             (unsigned long long)checksum_add(CHECKSUM_SEED, whole, strlen(whole)));
}

/* Makes the name of a view's files in their folder, without suffix (oxl_render_path). */
static oxl_result render_name(oxl_context *ctx, const char *view, char **out)
{
    const int escapes = view[0] == '/' || strstr(view, "..");
    char *flat = oxl_strdup(ctx, view), *last;
    struct text t = {.ctx = ctx};
    oxl_result rc = flat ? OXL_OK : OXL_ERR_MEMORY;
    for (char *c = flat; flat && *c; c++)
        if ((*c == '/' && escapes) || (unsigned char)*c < ' ') *c = '_';
    if (flat) {
        last = strrchr(flat, '/');
        text_add(&t, "%.*s", last ? (int)(last + 1 - flat) : 0, flat);
        render_name_add_last(&t, last ? last + 1 : flat, view);
        rc = text_take(&t, out);
    }
    oxl_free(ctx, flat);
    return rc == OXL_OK ? rc : oxl_fail(ctx, rc, "no memory for the name of a render");
}

oxl_result oxl_render_path(oxl_context *ctx, const char *folder, const char *view, const char *suffix,
                           char **out)
{
    char *name = NULL;
    struct text t = {.ctx = ctx};
    oxl_result rc = render_name(ctx, view, &name);
    *out = NULL;
    if (rc == OXL_OK) {
        text_add(&t, "%s/%s%s", folder, name, suffix);
        rc = text_take(&t, out);
        if (rc != OXL_OK) oxl_fail(ctx, rc, "no memory for the name of a render");
    }
    oxl_free(ctx, name);
    return rc;
}

/* ---------------- all names of a folder */

struct render_name_of {
    char *file;
    int view;
};

/* Compares names so that a folder comes directly before its contents. */
static int render_names_order(const void *a, const void *b)
{
    const unsigned char *s = (const void *)((const struct render_name_of *)a)->file,
                        *t = (const void *)((const struct render_name_of *)b)->file;
    while (*s && *s == *t) s++, t++;
    return (*s == '/' ? 1 : *s == 0 ? 0 : *s + 1) - (*t == '/' ? 1 : *t == 0 ? 0 : *t + 1);
}

/* Returns 1 if two sorted names are the same file, or the first is a file where the second needs a folder. */
static int render_names_collide(const char *a, const char *b)
{
    const size_t size = strlen(a);
    return strncmp(a, b, size) == 0 && (!b[size] || b[size] == '/');
}

static oxl_result render_names_compare(oxl_context *ctx, const oxl_scene *scene, struct render_name_of *name,
                                       size_t count)
{
    qsort(name, count, sizeof *name, render_names_order);
    for (size_t i = 1; i < count; i++)
        if (render_names_collide(name[i - 1].file, name[i].file))
            return oxl_fail(
                ctx, OXL_ERR_INPUT,
                "the renders of the images %s and %s would both be %s\n"
                "fix: rename one of the images, there and in the model, or train with --renders off",
                oxl_scene_view(scene, name[i - 1].view)->name, oxl_scene_view(scene, name[i].view)->name,
                name[i - 1].file);
    return OXL_OK;
}

OXL_INTERNAL oxl_result render_names_check(oxl_context *ctx, const oxl_scene *scene)
{
    static const char *const suffix[] = {RENDER_SUFFIXES};
    const size_t views = (size_t)oxl_scene_view_count(scene), count = views * OXL_COUNT(suffix);
    struct render_name_of *name = oxl_calloc(ctx, count + 1, sizeof *name);
    oxl_result rc = name ? OXL_OK : OXL_ERR_MEMORY;
    for (size_t i = 0; i < count && rc == OXL_OK; i++) {
        char *base = NULL;
        struct text t = {.ctx = ctx};
        name[i].view = (int)(i / OXL_COUNT(suffix));
        rc = render_name(ctx, oxl_scene_view(scene, name[i].view)->name, &base);
        if (rc == OXL_OK) text_add(&t, "%s%s", base, suffix[i % OXL_COUNT(suffix)]);
        if (rc == OXL_OK && (rc = text_take(&t, &name[i].file)) != OXL_OK)
            oxl_fail(ctx, rc, "no memory for %zu names", count);
        oxl_free(ctx, base);
    }
    if (rc == OXL_OK) rc = render_names_compare(ctx, scene, name, count);
    for (size_t i = 0; i < count && name; i++) oxl_free(ctx, name[i].file);
    oxl_free(ctx, name);
    return rc;
}
