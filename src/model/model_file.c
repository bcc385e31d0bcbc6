/* model_file.c - model files: the standard 3DGS PLY, with an element for second lobes; selects the format by extension (others: spz.c,
 * gltf.c, splat_file.c).
 *
 * Sources: the PLY of Kerbl 2023's reference code (62 float columns, raw values).
 *
 *     element dog   byte  0  opacity_factor  float     4  scale_factor  3 float
 *
 * Row i of element dog belongs to vertex i, or to the vertex of the property vertex_index (earlier versions).
 *
 * Invariant: values that are not finite are neither read nor written. Reading drops such rows and logs their number; writing fails,
 * since training must not produce them.
 */
#include "model.h"

#include "../core/bytes.h"
#include "../core/vecmath.h"

#define MODEL_FILE_SCALE_MAX 88.7f /* log of the largest size that a float holds */

enum {
    MODEL_FILE_COLUMNS    = 62,  /* of the standard layout */
    MODEL_FILE_ROWS       = 256, /* converted at a time */
    MODEL_FILE_LOBE_BYTES = 16,
    MODEL_FILE_HEADER     = 1 << 16 /* bytes: longer ones are not read some rows at a time */
};

static oxl_result model_file_no_memory(oxl_context *ctx, const char *path)
{
    return oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for the model of %s", path);
}

/* ---------------------------------------------------------------- the columns of the standard PLY */

struct model_file_column {
    char name[20];
    int  plane; /* -1: zero on output, not needed on input */
};

static struct model_file_column model_file_column(const char *prefix, int index, int plane)
{
    struct model_file_column c = {.plane = plane};
    snprintf(c.name, sizeof c.name, "%s%d", prefix, index);
    return c;
}

/* The columns of a PLY of `file_degree` for a model of `sh_degree`, in the standard's order. f_rest is channel-major: all
 * coefficients of red, then of green, then of blue. Returns their number: 62 when file_degree is 3. */
static int model_file_columns(int file_degree, int sh_degree, struct model_file_column out[MODEL_FILE_COLUMNS])
{
    const int rest = (file_degree + 1) * (file_degree + 1) - 1; /* coefficients a channel */
    const int kept = (sh_degree + 1) * (sh_degree + 1);
    int       n    = 0;
    for (int i = 0; i < 3; i++) out[n++] = (struct model_file_column){{(char)('x' + i)}, OXL_MEAN + i};
    for (int i = 0; i < 3; i++) out[n++] = (struct model_file_column){{'n', (char)('x' + i)}, -1};
    for (int i = 0; i < 3; i++) out[n++] = model_file_column("f_dc_", i, OXL_SH + i);
    for (int i = 0; i < 3 * rest; i++) {
        const int channel = i / rest, k = 1 + i % rest;
        out[n++] = model_file_column("f_rest_", i, k < kept ? OXL_SH + 3 * k + channel : -1);
    }
    out[n++] = (struct model_file_column){"opacity", OXL_OPACITY};
    for (int i = 0; i < 3; i++) out[n++] = model_file_column("scale_", i, OXL_LOG_SCALE + i);
    for (int i = 0; i < 4; i++) out[n++] = model_file_column("rot_", i, OXL_ROTATION + i);
    return n;
}

/* The float columns of element dog, one for each plane from OXL_LOBE on. */
static const char *const MODEL_FILE_LOBE[MODEL_LOBE_PLANES] = {"opacity_factor", "scale_factor_0", "scale_factor_1",
                                                               "scale_factor_2"};

/* ---------------------------------------------------------------- rows that are not finite */

static int model_file_finite(float x)
{
    return fabsf(x) <= FLT_MAX;
}

static oxl_result model_file_check_column(oxl_context *ctx, const char *path, const char *name, const float *plane, size_t rows)
{
    for (size_t i = 0; i < rows; i++)
        if (!model_file_finite(plane[i]))
            return oxl_fail(ctx, OXL_ERR_FAILED,
                            "%s: not written: column %s of row %zu is %f, wanted a finite number\n"
                            "fix: remove such rows before writing",
                            path, name, i, (double)plane[i]);
    return OXL_OK;
}

static oxl_result model_file_check_finite(oxl_context *ctx, const char *path, const oxl_model *model, int file_degree)
{
    struct model_file_column column[MODEL_FILE_COLUMNS];
    const int                columns = model_file_columns(file_degree, model->sh_degree, column);
    oxl_result               rc      = OXL_OK;
    for (int i = 0; i < 3; i++)
        if (!(fabs(model->origin[i]) <= DBL_MAX))
            return oxl_fail(
                ctx, OXL_ERR_FAILED,
                "%s: not written: the model's origin is not finite\nfix: correct the line comment origin of the model it was made from",
                path);
    for (int c = 0; rc == OXL_OK && c < columns; c++)
        if (column[c].plane >= 0)
            rc = model_file_check_column(ctx, path, column[c].name, model->plane[column[c].plane], model->count);
    for (int k = 0; rc == OXL_OK && k < MODEL_LOBE_PLANES; k++)
        rc = model_file_check_column(ctx, path, MODEL_FILE_LOBE[k], model->plane[OXL_LOBE + k], model->lobes);
    return rc;
}

/* Keeps the rows of finite values and sizes in their order. */
static oxl_result model_file_drop_rows(oxl_context *ctx, const char *path, oxl_model *model)
{
    const size_t count = model->count;
    uint8_t     *keep  = oxl_alloc(ctx, count + 1, 1);
    if (!keep) return model_file_no_memory(ctx, path);
    memset(keep, 1, count + 1);
    for (int p = 0; p < oxl_model_planes(model); p++)
        for (size_t i = 0; i < count; i++) keep[i] &= model_file_finite(model->plane[p][i]) != 0;
    for (int a = 0; a < 3; a++)
        for (size_t i = 0; i < count; i++) keep[i] &= model->plane[OXL_LOG_SCALE + a][i] < MODEL_FILE_SCALE_MAX;
    for (int k = 0; k < MODEL_LOBE_PLANES; k++)
        for (size_t i = 0; i < model->lobes; i++) keep[i] &= model_file_finite(model->plane[OXL_LOBE + k][i]) != 0;
    model_keep_rows(model, keep);
    model->not_finite = count - model->count;
    if (model->not_finite)
        oxl_log(ctx, OXL_LOG_WARNING, "%s: dropped %zu of %zu Gaussians that hold values which are not finite", path,
                model->not_finite, count);
    oxl_free(ctx, keep);
    return OXL_OK;
}

static oxl_result model_file_put(oxl_context *ctx, const struct os_writer *w, const void *data, size_t size)
{
    if (fwrite(data, 1, size, w->file) == size) return OXL_OK;
    return oxl_fail(ctx, OXL_ERR_IO, "%s: writing failed\nfix: free space on the disk", w->path);
}

/* ---------------------------------------------------------------- PLY out */

static oxl_result model_file_write_header(oxl_context *ctx, const struct os_writer *w, const oxl_model *model,
                                          const struct model_file_column *column, int columns)
{
    struct text t  = {.ctx = ctx};
    oxl_result  rc = OXL_ERR_MEMORY;
    text_add(&t, "ply\nformat binary_little_endian 1.0\ncomment origin %s %s %s", NUMBER(model->origin[0]),
             NUMBER(model->origin[1]), NUMBER(model->origin[2]));
    if (model->scale > 0) text_add(&t, "\ncomment scale %s", NUMBER(model->scale));
    if (model->lobes)
        text_add(&t, "\ncomment dog: a second lobe, alpha = min(.99, o G) - min(.99, o' G'); raw factors: "
                     "o' = o sigmoid(opacity_factor), s' = s exp(scale_factor)");
    text_add(&t, "\nelement vertex %zu\n", model->count);
    for (int c = 0; c < columns; c++) text_add(&t, "property float %s\n", column[c].name);
    if (model->lobes) text_add(&t, "element dog %zu\n", model->lobes);
    for (int k = 0; model->lobes && k < MODEL_LOBE_PLANES; k++) text_add(&t, "property float %s\n", MODEL_FILE_LOBE[k]);
    text_add(&t, "end_header\n");
    rc = t.failed ? model_file_no_memory(ctx, w->path) : model_file_put(ctx, w, t.data, t.size);
    text_free(&t);
    return rc;
}

static oxl_result model_file_write_rows(oxl_context *ctx, const struct os_writer *w, const oxl_model *model, size_t from,
                                        size_t end, int file_degree)
{
    struct model_file_column column[MODEL_FILE_COLUMNS];
    const int                columns = model_file_columns(file_degree, model->sh_degree, column);
    const size_t             row     = 4 * (size_t)columns; /* bytes */
    unsigned char           *rows    = oxl_alloc(ctx, MODEL_FILE_ROWS, row);
    oxl_result               rc      = rows ? OXL_OK : model_file_no_memory(ctx, w->path);
    for (size_t first = from; rc == OXL_OK && first < end; first += MODEL_FILE_ROWS) {
        const size_t n = OXL_MIN(end - first, MODEL_FILE_ROWS);
        for (int c = 0; c < columns; c++)
            for (size_t i = 0; i < n; i++)
                bytes_put_float(rows + i * row + 4 * (size_t)c,
                                column[c].plane < 0 ? 0 : model->plane[column[c].plane][first + i]);
        rc = model_file_put(ctx, w, rows, n * row);
    }
    oxl_free(ctx, rows);
    return rc;
}

static oxl_result model_file_write_lobes(oxl_context *ctx, const struct os_writer *w, const oxl_model *model)
{
    oxl_result rc = OXL_OK;
    for (size_t i = 0; rc == OXL_OK && i < model->lobes; i++) {
        unsigned char row[MODEL_FILE_LOBE_BYTES];
        for (int k = 0; k < MODEL_LOBE_PLANES; k++) bytes_put_float(row + 4 * k, model->plane[OXL_LOBE + k][i]);
        rc = model_file_put(ctx, w, row, sizeof row);
    }
    return rc;
}

enum model_file_rows { ROWS_WITH_LOBES, ROWS_WITHOUT, ROWS_LOBES };

/* Some rows of a model, page by page if they are in a file. */
static oxl_result model_file_write_part(oxl_context *ctx, const struct os_writer *w, const oxl_model *model,
                                        enum model_file_rows which, int file_degree)
{
    const size_t pages = model->pages ? model_pages_count(model) : 1;
    oxl_result   rc    = OXL_OK;
    for (size_t k = 0; k < pages && rc == OXL_OK; k++) {
        oxl_model page = *model;
        if (model->pages) rc = model_pages_get(ctx, model, k, &page);
        if (rc == OXL_OK && which == ROWS_LOBES) rc = model_file_write_lobes(ctx, w, &page);
        else if (rc == OXL_OK)
            rc = model_file_write_rows(ctx, w, &page, which == ROWS_WITHOUT ? page.lobes : 0,
                                       which == ROWS_WITHOUT ? page.count : page.lobes, file_degree);
        if (model->pages) oxl_model_free(ctx, &page);
    }
    return rc;
}

OXL_INTERNAL oxl_result model_file_write_models(oxl_context *ctx, const char *path, const oxl_model *model, int count,
                                                int file_degree)
{
    struct model_file_column column[MODEL_FILE_COLUMNS];
    const int                columns = model_file_columns(file_degree, file_degree, column);
    oxl_model                all     = {.scale = model[0].scale};
    struct os_writer         w       = {0};
    oxl_result               rc      = OXL_OK;
    memcpy(all.origin, model[0].origin, sizeof all.origin);
    for (int m = 0; m < count && rc == OXL_OK; m++) {
        all.count += model[m].count, all.lobes += model[m].lobes;
        if (!model[m].pages) rc = model_file_check_finite(ctx, path, &model[m], file_degree); /* pages leave such rows out */
    }
    if (rc == OXL_OK) rc = os_writer_open(ctx, path, &w);
    if (rc != OXL_OK) return rc;
    rc = model_file_write_header(ctx, &w, &all, column, columns);
    for (int which = ROWS_WITH_LOBES; which <= ROWS_LOBES; which++)
        for (int m = 0; m < count && rc == OXL_OK; m++) rc = model_file_write_part(ctx, &w, &model[m], which, file_degree);
    return os_writer_close(ctx, &w, rc);
}

OXL_INTERNAL oxl_result model_file_write_ply(oxl_context *ctx, const char *path, const oxl_model *model, int file_degree)
{
    return model_file_write_models(ctx, path, model, 1, file_degree);
}

/* ---------------------------------------------------------------- PLY in */

static oxl_result model_file_no_property(oxl_context *ctx, const struct ply *ply, const struct ply_element *vertex,
                                         const char *name)
{
    const int   points = ply_find_property(vertex, "x") >= 0 && ply_find_property(vertex, "f_dc_0") < 0;
    struct text seen   = {.ctx = ctx};
    oxl_result  rc;
    for (int c = 0; c < vertex->properties && seen.size < 400; c++)
        text_add(&seen, "%s%s", c ? " " : "", vertex->property[c].name);
    rc = oxl_fail(ctx, OXL_ERR_INPUT, "%s: element vertex has no property '%s'; it has: %s\nfix: %s", ply->path, name,
                  seen.data ? seen.data : "none",
                  points ? "this is a point cloud or a mesh; a model of Gaussians has f_dc_0, opacity, scale_0, rot_0 and more"
                         : "convert the file to the standard 3DGS layout");
    text_free(&seen);
    return rc;
}

/* The SH degree for a number of f_rest columns. */
static oxl_result model_file_read_degree(oxl_context *ctx, const struct ply *ply, const struct ply_element *vertex, int *degree)
{
    int rest = 0;
    for (int c = 0; c < vertex->properties; c++) rest += !strncmp(vertex->property[c].name, "f_rest_", 7);
    for (*degree = 0; *degree <= 3; ++*degree)
        if (rest == 3 * ((*degree + 1) * (*degree + 1) - 1)) return OXL_OK;
    return oxl_fail(ctx, OXL_ERR_INPUT,
                    "%s: %d properties f_rest_*, wanted 0, 9, 24 or 45\nfix: export spherical harmonics of degree 0 to 3",
                    ply->path, rest);
}

static oxl_result model_file_read_vertices(oxl_context *ctx, const struct ply *ply, int element, oxl_model *out)
{
    const struct ply_element *vertex = &ply->element[element];
    struct model_file_column  column[MODEL_FILE_COLUMNS];
    struct ply_target        *target = NULL;
    int                       degree, columns;
    oxl_result                rc = model_file_read_degree(ctx, ply, vertex, &degree);
    if (rc != OXL_OK) return rc;
    columns = model_file_columns(degree, degree, column);
    for (int c = 0; c < columns; c++)
        if (column[c].plane >= 0 && ply_find_property(vertex, column[c].name) < 0)
            return model_file_no_property(ctx, ply, vertex, column[c].name);
    rc = oxl_model_create(ctx, (size_t)vertex->rows, degree, out);
    if (rc != OXL_OK) return rc;
    target = oxl_calloc(ctx, (size_t)vertex->properties, sizeof *target);
    if (!target) return model_file_no_memory(ctx, ply->path);
    for (int c = 0; c < columns; c++)
        if (column[c].plane >= 0) target[ply_find_property(vertex, column[c].name)].as_float = out->plane[column[c].plane];
    rc = ply_read(ctx, ply, element, target);
    oxl_free(ctx, target);
    return rc;
}

/* ---------------------------------------------------------------- PLY in, some rows at a time */

/* The bytes before each plane's value; 0: a property is missing, or not a float. */
static int model_file_offsets(const struct ply_element *vertex, const struct ply_element *dog, struct model_file_layout *out)
{
    struct model_file_column column[MODEL_FILE_COLUMNS];
    const int                columns = model_file_columns(out->degree, out->degree, column);
    int                      plain   = vertex->row_bytes == 4 * (size_t)vertex->properties;
    for (int c = 0; c < vertex->properties; c++) plain &= vertex->property[c].type == PLY_FLOAT32;
    for (int c = 0; c < columns; c++) {
        const int at = ply_find_property(vertex, column[c].name);
        plain &= column[c].plane < 0 || at >= 0;
        if (column[c].plane >= 0) out->offset[column[c].plane] = 4 * at;
    }
    for (int k = 0; k < MODEL_LOBE_PLANES && dog; k++) {
        plain &= dog->properties == MODEL_LOBE_PLANES && ply_find_property(dog, MODEL_FILE_LOBE[k]) == k &&
                 dog->property[k].type == PLY_FLOAT32;
        out->offset[OXL_LOBE + k] = 4 * k;
    }
    return plain && !vertex->has_list;
}

OXL_INTERNAL oxl_result model_file_layout(oxl_context *ctx, const char *path, struct model_file_layout *out, oxl_model *model,
                                          int *has)
{
    struct ply                ply = {0};
    const struct ply_element *e;
    struct os_reader          file = {0};
    *out                           = (struct model_file_layout){0};
    *has                           = 0;
    if (ply_open_header(ctx, path, MODEL_FILE_HEADER, &ply) != OXL_OK) return OXL_OK; /* its reader reports the error */
    if (os_reader_open(ctx, path, &file) != OXL_OK) goto done;
    e = ply.element;
    if (ply.format == PLY_LITTLE && ply.elements >= 1 && ply.elements <= 2 && !strcmp(e[0].name, "vertex") &&
        (ply.elements == 1 || !strcmp(e[1].name, "dog")) && model_file_read_degree(ctx, &ply, e, &out->degree) == OXL_OK) {
        *has           = model_file_offsets(e, ply.elements > 1 ? e + 1 : NULL, out);
        out->rows      = (size_t)e->rows;
        out->row_bytes = e->row_bytes;
        out->lobes     = ply.elements > 1 ? (size_t)e[1].rows : 0;
        out->data      = ply.data;
        out->lobe_data = ply.data + e->rows * e->row_bytes;
        *has &= out->lobes <= out->rows && out->lobe_data + out->lobes * MODEL_FILE_LOBE_BYTES <= file.size;
    }
    for (int c = 0; c < ply.comments && *has; c++) model_read_comment(ctx, path, ply.comment[c], model);
done:
    os_reader_close(&file);
    ply_close(ctx, &ply);
    return OXL_OK;
}

OXL_INTERNAL oxl_result model_file_read_rows(oxl_context *ctx, const struct model_file_layout *l, struct os_reader *file,
                                             size_t first, oxl_model *model)
{
    unsigned char *rows = oxl_alloc(ctx, model->count + 1, l->row_bytes);
    size_t         got  = 0;
    oxl_result     rc   = rows ? OXL_OK : model_file_no_memory(ctx, file->path);
    if (rc == OXL_OK) rc = os_reader_seek(ctx, file, l->data + (uint64_t)first * l->row_bytes);
    if (rc == OXL_OK) rc = os_reader_read(ctx, file, rows, model->count * l->row_bytes, &got);
    for (int k = 0; k < oxl_model_planes(model) && rc == OXL_OK; k++)
        for (size_t i = 0; i < got / l->row_bytes; i++) model->plane[k][i] = bytes_float(rows + i * l->row_bytes + l->offset[k]);
    if (rc == OXL_OK && got < model->count * l->row_bytes) rc = oxl_fail(ctx, OXL_ERR_IO, "%s: it was cut short", file->path);
    if (rc == OXL_OK && model->lobes) rc = os_reader_seek(ctx, file, l->lobe_data + (uint64_t)first * MODEL_FILE_LOBE_BYTES);
    if (rc == OXL_OK && model->lobes) rc = os_reader_read(ctx, file, rows, model->lobes * MODEL_FILE_LOBE_BYTES, &got);
    for (int k = 0; k < MODEL_LOBE_PLANES && rc == OXL_OK; k++)
        for (size_t i = 0; i < model->lobes; i++)
            model->plane[OXL_LOBE + k][i] = bytes_float(rows + i * MODEL_FILE_LOBE_BYTES + l->offset[OXL_LOBE + k]);
    oxl_free(ctx, rows);
    return rc;
}

/* ---------------------------------------------------------------- second lobes in */

/* The rows of element dog: index (rows) as double, the row number without vertex_index; factor (4, rows). */
static oxl_result model_file_read_factors(oxl_context *ctx, const struct ply *ply, int element, double *index, float *factor)
{
    const struct ply_element *dog    = &ply->element[element];
    struct ply_target        *target = oxl_calloc(ctx, (size_t)dog->properties + 1, sizeof *target);
    oxl_result                rc;
    if (!target) return model_file_no_memory(ctx, ply->path);
    for (int k = -1; k < MODEL_LOBE_PLANES; k++) {
        const char *name = k < 0 ? "vertex_index" : MODEL_FILE_LOBE[k];
        const int   at   = ply_find_property(dog, name);
        if (k < 0 && at < 0) {
            for (size_t i = 0; i < (size_t)dog->rows; i++) index[i] = (double)i;
            continue;
        }
        if (at < 0) {
            rc = oxl_fail(ctx, OXL_ERR_INPUT,
                          "%s: element dog has no property '%s', wanted opacity_factor and scale_factor_0 to _2\n"
                          "fix: write the file again with oceanxl, or leave element dog out",
                          ply->path, name);
            goto done;
        }
        if (k < 0) target[at].as_double = index;
        else target[at].as_float = factor + (size_t)k * (size_t)dog->rows;
    }
    rc = ply_read(ctx, ply, element, target);
done:
    oxl_free(ctx, target);
    return rc;
}

/* Marks the vertices of element dog; each at most once. */
static oxl_result model_file_mark_lobes(oxl_context *ctx, const struct ply *ply, const double *index, size_t rows,
                                        size_t vertices, uint8_t *active)
{
    for (size_t i = 0; i < rows; i++) {
        if (!(index[i] >= 0 && index[i] < (double)vertices && index[i] == floor(index[i])))
            return oxl_fail(ctx, OXL_ERR_INPUT,
                            "%s: element dog, row %zu: vertex_index is %.10g, wanted a whole number below %zu\n"
                            "fix: the lobes belong to another set of vertices; write the file again with oceanxl",
                            ply->path, i, index[i], vertices);
        if (active[(size_t)index[i]]++)
            return oxl_fail(ctx, OXL_ERR_INPUT,
                            "%s: element dog, row %zu: vertex_index %.0f was there before, wanted one lobe a vertex\n"
                            "fix: remove the repeated row",
                            ply->path, i, index[i]);
    }
    return OXL_OK;
}

static oxl_result model_file_read_lobes(oxl_context *ctx, const struct ply *ply, int element, oxl_model *model)
{
    const uint64_t declared =
        ply->element[element].rows; /* rows without properties need no bytes, so the header can state any number */
    const size_t vertices = model->count, rows = (size_t)OXL_MIN(declared, vertices);
    double      *index  = oxl_alloc(ctx, rows + 1, sizeof *index);
    float       *factor = oxl_alloc(ctx, rows + 1, MODEL_LOBE_PLANES * sizeof *factor);
    uint8_t     *active = oxl_calloc(ctx, vertices + 1, 1);
    size_t      *row    = oxl_alloc(ctx, vertices + 1, sizeof *row); /* (vertices) row in dog, for vertices with a lobe */
    oxl_result   rc     = index && factor && active && row ? OXL_OK : model_file_no_memory(ctx, ply->path);
    if (rc == OXL_OK && declared > vertices)
        rc = oxl_fail(ctx, OXL_ERR_INPUT,
                      "%s: element dog announces %llu rows for %zu vertices, wanted at most one each\n"
                      "fix: write the file again with oceanxl, or leave element dog out",
                      ply->path, (unsigned long long)declared, vertices);
    if (rc == OXL_OK) rc = model_file_read_factors(ctx, ply, element, index, factor);
    if (rc == OXL_OK) rc = model_file_mark_lobes(ctx, ply, index, rows, vertices, active);
    if (rc == OXL_OK) rc = model_activate_lobes(ctx, model, NULL, NULL, active, 0.5f, 1);
    for (size_t i = 0, lobe = 0; rc == OXL_OK && i < vertices; i++) {
        row[i] = lobe;
        lobe += active[i];
    }
    for (int k = 0; k < MODEL_LOBE_PLANES; k++)
        for (size_t i = 0; rc == OXL_OK && i < rows; i++)
            model->plane[OXL_LOBE + k][row[(size_t)index[i]]] = factor[(size_t)k * rows + i];
    OXL_FREE(ctx, row, active, factor, index);
    return rc;
}

static oxl_result model_file_read_ply(oxl_context *ctx, const char *path, oxl_model *out)
{
    struct ply ply;
    int        vertex, dog;
    oxl_result rc = ply_open(ctx, path, &ply);
    if (rc != OXL_OK) return rc;
    vertex = ply_find_element(&ply, "vertex");
    dog    = ply_find_element(&ply, "dog");
    if (vertex >= 0) rc = model_file_read_vertices(ctx, &ply, vertex, out);
    else
        rc = oxl_fail(ctx, OXL_ERR_INPUT, "%s: no element 'vertex' among its %d\nfix: export the model as a 3DGS PLY", path,
                      ply.elements);
    if (rc == OXL_OK && dog >= 0) rc = model_file_read_lobes(ctx, &ply, dog, out);
    for (int i = 0; rc == OXL_OK && i < ply.comments; i++) model_read_comment(ctx, path, ply.comment[i], out);
    ply_close(ctx, &ply);
    return rc;
}

/* ---------------------------------------------------------------- public functions */

static int model_file_ends_in(const char *path, const char *extension)
{
    const size_t n = strlen(path), m = strlen(extension);
    return n >= m && !strcmp(path + n - m, extension);
}

oxl_result oxl_model_read(oxl_context *ctx, const char *path, oxl_model *out)
{
    oxl_result rc;
    *out = (oxl_model){0};
    rc   = model_file_ends_in(path, ".splat") ? splat_file_read(ctx, path, out)
           : model_file_ends_in(path, ".spz") ? spz_read(ctx, path, out)
           : model_file_ends_in(path, ".glb") ? oxl_fail(ctx, OXL_ERR_INPUT,
                                                         "%s: .glb files are written, not read\n"
                                                           "fix: use the .ply or .spz that it was made from",
                                                         path)
                                              : model_file_read_ply(ctx, path, out);
    if (rc == OXL_OK) rc = model_file_drop_rows(ctx, path, out);
    if (rc == OXL_OK && out->count == 0) oxl_log(ctx, OXL_LOG_WARNING, "%s holds no Gaussians: there is nothing to draw", path);
    if (rc != OXL_OK) oxl_model_free(ctx, out);
    return rc;
}

/* The model without its lobes, with borrowed planes. */
static oxl_model model_file_standard(oxl_context *ctx, const char *path, const oxl_model *model)
{
    oxl_model plain = *model;
    if (model->lobes)
        oxl_log(ctx, OXL_LOG_WARNING, "%s: this format cannot store the second lobes of %zu of %zu Gaussians", path, model->lobes,
                model->count);
    model_drop_lobes(&plain);
    return plain;
}

oxl_result oxl_model_write(oxl_context *ctx, const char *path, const oxl_model *model)
{
    const int splat = model_file_ends_in(path, ".splat"), spz = model_file_ends_in(path, ".spz");
    if (model->pages) return oxl_fail(ctx, OXL_ERR_USAGE, "%s: not written: the model's rows are in its file", path);
    if (splat || spz || model_file_ends_in(path, ".glb")) {
        const oxl_model  plain = model_file_standard(ctx, path, model);
        const oxl_result rc    = model_file_check_finite(ctx, path, &plain, splat ? 0 : plain.sh_degree);
        return rc != OXL_OK ? rc
               : splat      ? splat_file_write(ctx, path, &plain)
               : spz        ? spz_write(ctx, path, &plain)
                            : gltf_write(ctx, path, &plain);
    }
    if (model_file_ends_in(path, "_standard.ply")) {
        const oxl_model plain = model_file_standard(ctx, path, model);
        return model_file_write_ply(ctx, path, &plain, 3);
    }
    if (model_file_ends_in(path, ".ply")) return model_file_write_ply(ctx, path, model, 3);
    return oxl_fail(ctx, OXL_ERR_USAGE, "%s: the format is not known\nfix: a name that ends in .ply, .spz, .glb or .splat", path);
}
