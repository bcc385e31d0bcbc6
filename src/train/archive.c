/* archive.c - the state of a run, as bytes in a file.
 *
 * A module describes its state once, in one function that goes both ways (struct archive). Values are as in
 * memory; the file's head (large/checkpoint.c) tells machines and versions apart, and its checksum finds
 * damage.
 */
#include "train_tools.h"

/* ---------------- bytes, both ways */

OXL_INTERNAL void archive_fail(struct archive *a, oxl_result rc, const char *what)
{
    if (a->rc == OXL_OK)
        a->rc = oxl_fail(a->ctx, rc, "%s: %s\nfix: %s", a->path, what,
                         rc == OXL_ERR_IO ? "check the disk and its free space"
                                          : "remove this file, or train with --restart");
}

OXL_INTERNAL int archive_fits(struct archive *a, size_t count, size_t size)
{
    if (a->reading && a->rc == OXL_OK && count > a->left / size)
        archive_fail(a, OXL_ERR_INPUT, "ends too early");
    return a->rc == OXL_OK;
}

OXL_INTERNAL void archive_numbers(struct archive *a, void *data, size_t count, size_t size)
{
    if (!archive_fits(a, count, size) || count == 0) return;
    if (a->reading && fread(data, size, count, a->file) != count)
        archive_fail(a, OXL_ERR_IO, "cannot be read");
    if (!a->reading && fwrite(data, size, count, a->file) != count)
        archive_fail(a, OXL_ERR_IO, "cannot write; the disk may be full");
    a->left -= a->reading ? count * size : 0;
}

/* ---------------- what modules call */

OXL_INTERNAL void archive_text(struct archive *a, struct text *t)
{
    size_t size = t->size;
    char *data = NULL;
    ARCHIVE(a, &size, 1);
    if (!a->reading) {
        archive_numbers(a, t->data, size, 1);
        return;
    }
    if (!archive_fits(a, size, 1)) return;
    data = oxl_calloc(a->ctx, size + 1, 1);
    if (!data) a->rc = OXL_ERR_MEMORY;
    else archive_numbers(a, data, size, 1);
    text_free(t);
    if (data) text_add(t, "%s", data);
    oxl_free(a->ctx, data);
}

OXL_INTERNAL void archive_model(struct archive *a, oxl_model *model)
{
    size_t count = model->count, lobes = model->lobes;
    int degree = model->sh_degree;
    const int antialias = model->antialias; /* the run's, which no step changes */
    ARCHIVE(a, &count, 1);
    ARCHIVE(a, &lobes, 1);
    ARCHIVE(a, &degree, 1);
    if (a->reading) {
        oxl_model_free(a->ctx, model);
        if (archive_fits(a, count, OXL_SH * sizeof(float)))
            a->rc = oxl_model_create(a->ctx, count, degree, model);
        model->antialias = antialias;
        if (a->rc == OXL_OK) a->rc = model_set_lobes(a->ctx, model, lobes);
    }
    ARCHIVE(a, model->origin, 3);
    for (int k = 0; k < oxl_model_planes(model) && a->rc == OXL_OK; k++) ARCHIVE(a, model->plane[k], count);
    for (int k = OXL_LOBE; lobes && k < OXL_PLANES && a->rc == OXL_OK; k++)
        ARCHIVE(a, model->plane[k], lobes);
}
