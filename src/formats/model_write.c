/* model_write.c - writes models as PLY: the standard of 3DGS, with an element for second lobes (model_file.c
 * has the layout).
 *
 * Invariant: a model with values that are not finite is not written: training must not produce them.
 */
#include "model_columns.h"

#include "../core/bytes.h"

enum {
    MODEL_WRITE_ROWS = 256 /* rows converted at a time */
};

/* ---------------- values that are not finite */

static oxl_result model_write_check_column(oxl_context *ctx, const char *path, const char *name,
                                           const float *plane, size_t rows)
{
    for (size_t i = 0; i < rows; i++)
        if (!model_file_finite(plane[i]))
            return oxl_fail(ctx, OXL_ERR_FAILED,
                            "%s: not written: column %s of row %zu is %f, expected a finite number\n"
                            "fix: remove such rows before writing",
                            path, name, i, (double)plane[i]);
    return OXL_OK;
}

OXL_INTERNAL oxl_result model_write_check_finite(oxl_context *ctx, const char *path, const oxl_model *model,
                                                 int file_degree)
{
    struct model_file_column column[MODEL_FILE_COLUMNS];
    const int columns = model_file_columns(file_degree, model->sh_degree, column);
    oxl_result rc = OXL_OK;
    for (int i = 0; i < 3; i++)
        if (!(fabs(model->origin[i]) <= DBL_MAX))
            return oxl_fail(
                ctx, OXL_ERR_FAILED,
                "%s: not written: the model's origin is not finite\nfix: correct the line comment origin of the model it was made from",
                path);
    for (int c = 0; rc == OXL_OK && c < columns; c++)
        if (column[c].plane >= 0)
            rc = model_write_check_column(ctx, path, column[c].name, model->plane[column[c].plane],
                                          model->count);
    for (int k = 0; rc == OXL_OK && k < MODEL_LOBE_PLANES; k++)
        rc =
            model_write_check_column(ctx, path, MODEL_FILE_LOBE[k], model->plane[OXL_LOBE + k], model->lobes);
    return rc;
}

/* ---------------- PLY */

static oxl_result model_write_put(oxl_context *ctx, const struct os_writer *w, const void *data, size_t size)
{
    if (fwrite(data, 1, size, w->file) == size) return OXL_OK;
    return oxl_fail(ctx, OXL_ERR_IO, "%s: writing failed\nfix: free space on the disk", w->path);
}

static oxl_result model_write_header(oxl_context *ctx, const struct os_writer *w, const oxl_model *model,
                                     int file_degree)
{
    struct model_file_column column[MODEL_FILE_COLUMNS];
    const int columns = model_file_columns(file_degree, file_degree, column);
    struct text t = {.ctx = ctx};
    oxl_result rc = OXL_ERR_MEMORY;
    text_add(&t, "ply\nformat binary_little_endian 1.0\ncomment origin %s %s %s", NUMBER(model->origin[0]),
             NUMBER(model->origin[1]), NUMBER(model->origin[2]));
    if (model->scale > 0) text_add(&t, "\ncomment scale %s", NUMBER(model->scale));
    model_write_background(&t, "\ncomment ", model);
    model_write_view(&t, "\ncomment ", model);
    if (model->antialias) text_add(&t, "\ncomment %smip", MODEL_RENDER_MODE);
    if (model->lobes)
        text_add(&t, "\ncomment dog: a second lobe, alpha = min(.99, o G) - min(.99, o' G'); raw factors: "
                     "o' = o sigmoid(opacity_factor), s' = s exp(scale_factor)");
    text_add(&t, "\nelement vertex %zu\n", model->count);
    for (int c = 0; c < columns; c++) text_add(&t, "property float %s\n", column[c].name);
    if (model->lobes) text_add(&t, "element dog %zu\n", model->lobes);
    for (int k = 0; model->lobes && k < MODEL_LOBE_PLANES; k++)
        text_add(&t, "property float %s\n", MODEL_FILE_LOBE[k]);
    text_add(&t, "end_header\n");
    rc = t.failed ? OXL_ERR_MEMORY : model_write_put(ctx, w, t.data, t.size);
    text_free(&t);
    return rc;
}

static oxl_result model_write_rows(oxl_context *ctx, const struct os_writer *w, const oxl_model *model,
                                   int file_degree)
{
    struct model_file_column column[MODEL_FILE_COLUMNS];
    const int columns = model_file_columns(file_degree, model->sh_degree, column);
    const size_t row = 4 * (size_t)columns; /* bytes */
    unsigned char *rows = oxl_alloc(ctx, MODEL_WRITE_ROWS, row);
    oxl_result rc = rows ? OXL_OK : OXL_ERR_MEMORY;
    for (size_t first = 0; rc == OXL_OK && first < model->count; first += MODEL_WRITE_ROWS) {
        const size_t n = OXL_MIN(model->count - first, MODEL_WRITE_ROWS);
        for (int c = 0; c < columns; c++)
            for (size_t i = 0; i < n; i++)
                bytes_put_float(rows + i * row + 4 * (size_t)c,
                                column[c].plane < 0 ? 0 : model->plane[column[c].plane][first + i]);
        rc = model_write_put(ctx, w, rows, n * row);
    }
    oxl_free(ctx, rows);
    return rc;
}

static oxl_result model_write_lobes(oxl_context *ctx, const struct os_writer *w, const oxl_model *model)
{
    oxl_result rc = OXL_OK;
    for (size_t i = 0; rc == OXL_OK && i < model->lobes; i++) {
        unsigned char row[MODEL_LOBE_BYTES];
        for (int k = 0; k < MODEL_LOBE_PLANES; k++)
            bytes_put_float(row + 4 * k, model->plane[OXL_LOBE + k][i]);
        rc = model_write_put(ctx, w, row, sizeof row);
    }
    return rc;
}

OXL_INTERNAL oxl_result model_file_write_ply(oxl_context *ctx, const char *path, const oxl_model *model,
                                             int file_degree)
{
    struct os_writer w = {0};
    oxl_result rc = model_write_check_finite(ctx, path, model, file_degree);
    if (rc == OXL_OK) rc = os_writer_open(ctx, path, &w);
    if (rc != OXL_OK) return rc;
    rc = model_write_header(ctx, &w, model, file_degree);
    if (rc == OXL_OK) rc = model_write_rows(ctx, &w, model, file_degree);
    if (rc == OXL_OK) rc = model_write_lobes(ctx, &w, model);
    return os_writer_close(ctx, &w, rc);
}
