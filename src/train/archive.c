/* archive.c - the state of a run, as bytes in a file.
 *
 * A module describes its state once, in one function that goes both ways (struct archive). Numbers are
 * little endian.
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

/* Converts a number to the disk's order, low byte first, or back. */
static void archive_swap(unsigned char *bytes, size_t size)
{
    const uint16_t one = 1;
    if (*(const unsigned char *)&one == 1) return;
    for (size_t i = 0; i < size / 2; i++) OXL_SWAP(unsigned char, bytes[i], bytes[size - 1 - i]);
}

static void archive_write(struct archive *a, const unsigned char *data, size_t count, size_t size)
{
    unsigned char chunk[4096];
    const size_t room = sizeof chunk / size;
    for (size_t at = 0; at < count && a->rc == OXL_OK; at += room) {
        const size_t n = OXL_MIN(room, count - at);
        memcpy(chunk, data + at * size, n * size);
        for (size_t i = 0; i < n; i++) archive_swap(chunk + i * size, size);
        if (fwrite(chunk, size, n, a->file) != n)
            archive_fail(a, OXL_ERR_IO, "cannot write; the disk may be full");
    }
}

OXL_INTERNAL int archive_fits(struct archive *a, size_t count, size_t size)
{
    if (a->reading && a->rc == OXL_OK && count > a->left / size)
        archive_fail(a, OXL_ERR_INPUT, "ends too early");
    return a->rc == OXL_OK;
}

static void archive_read(struct archive *a, unsigned char *data, size_t count, size_t size)
{
    if (!archive_fits(a, count, size)) return;
    if (fread(data, size, count, a->file) != count) archive_fail(a, OXL_ERR_IO, "cannot be read");
    for (size_t i = 0; i < count; i++) archive_swap(data + i * size, size);
    a->left -= count * size;
}

OXL_INTERNAL void archive_numbers(struct archive *a, void *data, size_t count, size_t size)
{
    if (a->rc != OXL_OK) return;
    if (a->reading) archive_read(a, data, count, size);
    else archive_write(a, data, count, size);
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
