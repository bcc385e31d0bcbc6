/* archive.c - the state of a run, as bytes in a file.
 *
 * A module describes its state once, in one function that goes both ways (struct archive). Numbers are in the
 * machine's byte order.
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
    if (!archive_fits(a, count, size)) return;
    if (a->reading && fread(data, size, count, a->file) != count)
        archive_fail(a, OXL_ERR_IO, "cannot be read");
    if (!a->reading && fwrite(data, size, count, a->file) != count)
        archive_fail(a, OXL_ERR_IO, "cannot write; the disk may be full");
    a->left -= a->reading ? count * size : 0;
}

/* ---------------- what modules call */

static void archive_u64(struct archive *a, uint64_t *value)
{
    archive_numbers(a, value, 1, sizeof *value);
}

OXL_INTERNAL void archive_int(struct archive *a, int *value)
{
    uint64_t bits = (uint64_t)(int64_t)*value;
    archive_u64(a, &bits);
    if (a->reading && a->rc == OXL_OK) *value = (int)(int64_t)bits;
}

OXL_INTERNAL void archive_size(struct archive *a, size_t *value)
{
    uint64_t bits = *value;
    archive_u64(a, &bits);
    if (a->reading && a->rc == OXL_OK) *value = (size_t)bits;
    if (a->rc == OXL_OK && bits > SIZE_MAX)
        archive_fail(a, OXL_ERR_INPUT, "holds more than this machine can address");
}

OXL_INTERNAL void archive_doubles(struct archive *a, double *values, size_t count)
{
    archive_numbers(a, values, count, sizeof *values);
}

OXL_INTERNAL void archive_floats(struct archive *a, float *values, size_t count)
{
    archive_numbers(a, values, count, sizeof *values);
}

OXL_INTERNAL void archive_ints(struct archive *a, int *values, size_t count)
{
    for (size_t i = 0; i < count; i++) archive_int(a, &values[i]);
}

OXL_INTERNAL void archive_expect(struct archive *a, int is_so)
{
    if (a->reading && !is_so)
        archive_fail(a, OXL_ERR_INPUT,
                     "holds invalid numbers\nfix: remove this file and run again; the run starts again");
}

OXL_INTERNAL void archive_text(struct archive *a, struct text *t)
{
    size_t size = t->size;
    char *data = NULL;
    archive_size(a, &size);
    if (!a->reading) {
        archive_numbers(a, t->data, size, 1);
        return;
    }
    if (!archive_fits(a, size, 1)) return;
    data = oxl_calloc(a->ctx, size + 1, 1);
    if (!data) archive_fail(a, OXL_ERR_MEMORY, "no memory for a text in it");
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
    archive_size(a, &count);
    archive_size(a, &lobes);
    archive_int(a, &degree);
    if (a->reading) {
        oxl_model_free(a->ctx, model);
        if (archive_fits(a, count, OXL_SH * sizeof(float)))
            a->rc = oxl_model_create(a->ctx, count, degree, model);
        model->antialias = antialias;
        if (a->rc == OXL_OK) a->rc = model_set_lobes(a->ctx, model, lobes);
    }
    archive_doubles(a, model->origin, 3);
    for (int k = 0; k < oxl_model_planes(model) && a->rc == OXL_OK; k++)
        archive_floats(a, model->plane[k], count);
    for (int k = OXL_LOBE; lobes && k < OXL_PLANES && a->rc == OXL_OK; k++)
        archive_floats(a, model->plane[k], lobes);
    for (size_t i = 0; a->reading && a->rc == OXL_OK && i < count; i++)
        archive_expect(a, model_row_is_finite(model, i));
}
