/* modelfile.c - models as files: the standard 3DGS PLY and the 32-byte .splat.
 *
 * Sources: the PLY of Kerbl 2023's reference code (62 float columns, raw values); antimatter15's .splat.
 * Invariant: a number that is not finite goes neither in nor out. Reading drops such rows and says how many; writing refuses
 * them, since they are the trainer's fault, to be mended there.
 */
#include "internal.h"
#include "vecmath.h"

enum {
    MODELFILE_COLUMNS     = 62,  /* of the standard layout */
    MODELFILE_ROWS        = 256, /* converted at a time */
    MODELFILE_SPLAT_BYTES = 32
};

static oxl_result modelfile_no_memory(oxl_context *ctx, const char *path)
{
    return oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for the model of %s", path);
}

/* ---------------------------------------------------------------- the columns of the standard PLY */

struct modelfile_column {
    char name[20];
    int  plane; /* -1: zero on output, not needed on input */
};

static struct modelfile_column modelfile_column(const char *prefix, int index, int plane)
{
    struct modelfile_column c = {.plane = plane};
    snprintf(c.name, sizeof c.name, "%s%d", prefix, index);
    return c;
}

/* The columns of a PLY of `file_degree` for a model of `sh_degree`, in the standard's order. f_rest is channel-major: all
 * coefficients of red, then of green, then of blue. Returns their number: 62 when file_degree is 3. */
static int modelfile_columns(int file_degree, int sh_degree, struct modelfile_column out[MODELFILE_COLUMNS])
{
    const int rest = (file_degree + 1) * (file_degree + 1) - 1; /* coefficients a channel */
    const int kept = (sh_degree + 1) * (sh_degree + 1);
    int       n    = 0;
    for (int i = 0; i < 3; i++) out[n++] = (struct modelfile_column){{(char)('x' + i)}, OXL_MEAN + i};
    for (int i = 0; i < 3; i++) out[n++] = (struct modelfile_column){{'n', (char)('x' + i)}, -1};
    for (int i = 0; i < 3; i++) out[n++] = modelfile_column("f_dc_", i, OXL_SH + i);
    for (int i = 0; i < 3 * rest; i++) {
        const int channel = i / rest, k = 1 + i % rest;
        out[n++] = modelfile_column("f_rest_", i, k < kept ? OXL_SH + 3 * k + channel : -1);
    }
    out[n++] = (struct modelfile_column){"opacity", OXL_OPACITY};
    for (int i = 0; i < 3; i++) out[n++] = modelfile_column("scale_", i, OXL_LOG_SCALE + i);
    for (int i = 0; i < 4; i++) out[n++] = modelfile_column("rot_", i, OXL_ROTATION + i);
    return n;
}

/* ---------------------------------------------------------------- rows that are not finite */

static int modelfile_finite(float x)
{
    return fabsf(x) <= FLT_MAX;
}

static oxl_result modelfile_check_finite(oxl_context *ctx, const char *path, const oxl_model *model, int file_degree)
{
    struct modelfile_column column[MODELFILE_COLUMNS];
    const int               columns = modelfile_columns(file_degree, model->sh_degree, column);
    for (int i = 0; i < 3; i++)
        if (!(fabs(model->origin[i]) <= DBL_MAX))
            return oxl_fail(ctx, OXL_ERR_FAILED, "%s: not written: the model's origin is not finite", path);
    for (int c = 0; c < columns; c++)
        for (size_t i = 0; column[c].plane >= 0 && i < model->count; i++)
            if (!modelfile_finite(model->plane[column[c].plane][i]))
                return oxl_fail(ctx, OXL_ERR_FAILED,
                                "%s: not written: column %s of row %zu is %f, wanted a finite number\n"
                                "fix: remove such rows before writing",
                                path, column[c].name, i, (double)model->plane[column[c].plane][i]);
    return OXL_OK;
}

/* Keeps the finite rows in their order. */
static void modelfile_drop_rows(oxl_context *ctx, const char *path, oxl_model *model)
{
    const int    planes = oxl_model_planes(model);
    const size_t count  = model->count;
    size_t       kept   = 0;
    for (size_t i = 0; i < count; i++) {
        int finite = 1;
        for (int p = 0; p < planes; p++) finite &= modelfile_finite(model->plane[p][i]);
        if (!finite) continue;
        for (int p = 0; kept < i && p < planes; p++) model->plane[p][kept] = model->plane[p][i];
        kept++;
    }
    model->count = kept;
    model_clear_rows(model, kept, count);
    if (kept < count)
        oxl_log(ctx, OXL_LOG_WARNING, "%s: dropped %zu of %zu Gaussians that hold values which are not finite", path,
                count - kept, count);
}

/* ---------------------------------------------------------------- bytes, whatever the machine's own order */

static void modelfile_put_float(unsigned char *p, float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    for (int i = 0; i < 4; i++) p[i] = (unsigned char)(bits >> 8 * i);
}

static float modelfile_get_float(const unsigned char *p)
{
    const uint32_t bits = (uint32_t)p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
    float          value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static oxl_result modelfile_put(oxl_context *ctx, const struct os_writer *w, const void *data, size_t size)
{
    if (fwrite(data, 1, size, w->file) == size) return OXL_OK;
    return oxl_fail(ctx, OXL_ERR_IO, "%s: writing failed\nfix: look for room on the disk", w->path);
}

/* ---------------------------------------------------------------- PLY out */

static oxl_result modelfile_write_header(oxl_context *ctx, const struct os_writer *w, const oxl_model *model,
                                         const struct modelfile_column *column, int columns)
{
    struct text t  = {.ctx = ctx};
    oxl_result  rc = OXL_ERR_MEMORY;
    text_add(&t, "ply\nformat binary_little_endian 1.0\ncomment origin");
    for (int i = 0; i < 3; i++) {
        text_add(&t, " ");
        text_add_number(&t, model->origin[i]);
    }
    text_add(&t, "\nelement vertex %zu\n", model->count);
    for (int c = 0; c < columns; c++) text_add(&t, "property float %s\n", column[c].name);
    text_add(&t, "end_header\n");
    rc = t.failed ? modelfile_no_memory(ctx, w->path) : modelfile_put(ctx, w, t.data, t.size);
    text_free(&t);
    return rc;
}

static oxl_result modelfile_write_rows(oxl_context *ctx, const struct os_writer *w, const oxl_model *model,
                                       const struct modelfile_column *column, int columns)
{
    const size_t   row  = 4 * (size_t)columns; /* bytes */
    unsigned char *rows = oxl_alloc(ctx, MODELFILE_ROWS, row);
    oxl_result     rc   = rows ? OXL_OK : modelfile_no_memory(ctx, w->path);
    for (size_t first = 0; rc == OXL_OK && first < model->count; first += MODELFILE_ROWS) {
        const size_t n = OXL_MIN(model->count - first, MODELFILE_ROWS);
        for (int c = 0; c < columns; c++)
            for (size_t i = 0; i < n; i++)
                modelfile_put_float(rows + i * row + 4 * (size_t)c,
                                    column[c].plane < 0 ? 0 : model->plane[column[c].plane][first + i]);
        rc = modelfile_put(ctx, w, rows, n * row);
    }
    oxl_free(ctx, rows);
    return rc;
}

OXL_INTERNAL oxl_result modelfile_write_ply(oxl_context *ctx, const char *path, const oxl_model *model, int file_degree)
{
    struct modelfile_column column[MODELFILE_COLUMNS];
    const int               columns = modelfile_columns(file_degree, model->sh_degree, column);
    struct os_writer        w       = {0};
    oxl_result              rc      = modelfile_check_finite(ctx, path, model, file_degree);
    if (rc == OXL_OK) rc = os_writer_open(ctx, path, &w);
    if (rc != OXL_OK) return rc;
    rc = modelfile_write_header(ctx, &w, model, column, columns);
    if (rc == OXL_OK) rc = modelfile_write_rows(ctx, &w, model, column, columns);
    return os_writer_close(ctx, &w, rc);
}

/* ---------------------------------------------------------------- PLY in */

/* "origin X Y Z" among the comments. */
static void modelfile_read_origin(oxl_context *ctx, const struct ply *ply, double origin[3])
{
    for (int i = 0; i < ply->comments; i++) {
        const char *c = ply->comment[i], *end = c + strlen(c);
        double      value[3];
        int         n = 0;
        if (strncmp(c, "origin ", 7)) continue;
        c += 7;
        for (; n < 3; n++) {
            while (*c == ' ') c++;
            if (!parse_double(&c, end, &value[n]) || !(fabs(value[n]) <= DBL_MAX)) break;
        }
        if (n == 3) memcpy(origin, value, sizeof value);
        else oxl_log(ctx, OXL_LOG_WARNING, "%s: comment '%s' ignored: wanted origin X Y Z", ply->path, ply->comment[i]);
    }
}

static oxl_result modelfile_no_property(oxl_context *ctx, const struct ply *ply, const struct ply_element *vertex,
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

/* The degree that the number of f_rest columns speaks of. */
static oxl_result modelfile_read_degree(oxl_context *ctx, const struct ply *ply, const struct ply_element *vertex, int *degree)
{
    int rest = 0;
    for (int c = 0; c < vertex->properties; c++) rest += !strncmp(vertex->property[c].name, "f_rest_", 7);
    for (*degree = 0; *degree <= 3; ++*degree)
        if (rest == 3 * ((*degree + 1) * (*degree + 1) - 1)) return OXL_OK;
    return oxl_fail(ctx, OXL_ERR_INPUT,
                    "%s: %d properties f_rest_*, wanted 0, 9, 24 or 45\nfix: export spherical harmonics of degree 0 to 3",
                    ply->path, rest);
}

static oxl_result modelfile_read_vertices(oxl_context *ctx, const struct ply *ply, int element, oxl_model *out)
{
    const struct ply_element *vertex = &ply->element[element];
    struct modelfile_column   column[MODELFILE_COLUMNS];
    struct ply_target        *target = NULL;
    int                       degree, columns;
    oxl_result                rc = modelfile_read_degree(ctx, ply, vertex, &degree);
    if (rc != OXL_OK) return rc;
    columns = modelfile_columns(degree, degree, column);
    for (int c = 0; c < columns; c++)
        if (column[c].plane >= 0 && ply_find_property(vertex, column[c].name) < 0)
            return modelfile_no_property(ctx, ply, vertex, column[c].name);
    rc = oxl_model_create(ctx, (size_t)vertex->rows, degree, out);
    if (rc != OXL_OK) return rc;
    target = oxl_calloc(ctx, (size_t)vertex->properties, sizeof *target);
    if (!target) return modelfile_no_memory(ctx, ply->path);
    for (int c = 0; c < columns; c++)
        if (column[c].plane >= 0) target[ply_find_property(vertex, column[c].name)].as_float = out->plane[column[c].plane];
    rc = ply_read(ctx, ply, element, target);
    oxl_free(ctx, target);
    return rc;
}

static oxl_result modelfile_read_ply(oxl_context *ctx, const char *path, oxl_model *out)
{
    struct ply ply;
    int        vertex;
    oxl_result rc = ply_open(ctx, path, &ply);
    if (rc != OXL_OK) return rc;
    vertex = ply_find_element(&ply, "vertex");
    if (vertex >= 0) rc = modelfile_read_vertices(ctx, &ply, vertex, out);
    else
        rc = oxl_fail(ctx, OXL_ERR_INPUT, "%s: no element 'vertex' among its %d\nfix: export the model as a 3DGS PLY", path,
                      ply.elements);
    if (rc == OXL_OK) modelfile_read_origin(ctx, &ply, out->origin);
    ply_close(ctx, &ply);
    return rc;
}

/* ---------------------------------------------------------------- .splat
 *
 *     byte  0  position  3 float        24  colour   R G B A, 8 bits each
 *          12  scale     3 float        28  rotation w x y z, q * 128 + 128
 */

static unsigned char modelfile_byte(double x)
{
    return (unsigned char)(OXL_CLAMP(x, 0, 255) + 0.5);
}

static void modelfile_put_splat(const oxl_model *model, size_t row, unsigned char *p)
{
    double norm = 0;
    for (int i = 0; i < 4; i++) {
        const double q = model->plane[OXL_ROTATION + i][row];
        norm += q * q;
    }
    norm = sqrt(norm);
    for (int i = 0; i < 3; i++) {
        const double scale = vecmath_exp(model->plane[OXL_LOG_SCALE + i][row]);
        modelfile_put_float(p + 4 * i, model->plane[OXL_MEAN + i][row]);
        modelfile_put_float(p + 12 + 4 * i, (float)OXL_MIN(scale, FLT_MAX));
        p[24 + i] = modelfile_byte(255 * (0.5 + MODEL_SH0 * model->plane[OXL_SH + i][row]));
    }
    p[27] = modelfile_byte(255 * vecmath_sigmoid(model->plane[OXL_OPACITY][row]));
    for (int i = 0; i < 4; i++) {
        const double q = norm > 0 ? model->plane[OXL_ROTATION + i][row] / norm : i == 0;
        p[28 + i]      = modelfile_byte(128 * q + 128);
    }
}

/* Bytes at the ends stand for values that the raw form cannot hold: alpha 0 and 255 become a quarter of a step inside, a scale
 * of 0 the least normal float, so that both come back as the same byte. */
static void modelfile_get_splat(const unsigned char *p, oxl_model *model, size_t row)
{
    const double alpha = OXL_CLAMP(p[27], 0.25, 254.75) / 255;
    int          zero  = 1;
    for (int i = 0; i < 3; i++) {
        const float scale                    = modelfile_get_float(p + 12 + 4 * i);
        model->plane[OXL_MEAN + i][row]      = modelfile_get_float(p + 4 * i);
        model->plane[OXL_LOG_SCALE + i][row] = (float)vecmath_log(scale >= 0 && scale < FLT_MIN ? FLT_MIN : scale);
        model->plane[OXL_SH + i][row]        = (float)((p[24 + i] / 255.0 - 0.5) / MODEL_SH0);
    }
    model->plane[OXL_OPACITY][row] = (float)vecmath_logit(alpha);
    for (int i = 0; i < 4; i++) zero &= p[28 + i] == 128;
    for (int i = 0; i < 4; i++) model->plane[OXL_ROTATION + i][row] = zero ? i == 0 : (float)((p[28 + i] - 128) / 128.0);
}

struct modelfile_rank {
    double weight; /* opacity x volume */
    size_t row;
};

static int modelfile_by_weight(const void *a, const void *b)
{
    const struct modelfile_rank *x = a, *y = b;
    if (x->weight != y->weight) return x->weight > y->weight ? -1 : 1;
    return x->row < y->row ? -1 : x->row > y->row;
}

/* The most visible first, as viewers that load a .splat piece by piece expect. */
static oxl_result modelfile_write_splat(oxl_context *ctx, const char *path, const oxl_model *model)
{
    struct modelfile_rank *rank = NULL;
    struct os_writer       w    = {0};
    oxl_result             rc   = modelfile_check_finite(ctx, path, model, 0);
    if (rc != OXL_OK) return rc;
    rank = oxl_alloc(ctx, model->count, sizeof *rank);
    if (!rank) return modelfile_no_memory(ctx, path);
    for (size_t i = 0; i < model->count; i++) {
        const double sum =
            (double)model->plane[OXL_LOG_SCALE][i] + model->plane[OXL_LOG_SCALE + 1][i] + model->plane[OXL_LOG_SCALE + 2][i];
        rank[i] = (struct modelfile_rank){vecmath_exp(sum) * vecmath_sigmoid(model->plane[OXL_OPACITY][i]), i};
    }
    qsort(rank, model->count, sizeof *rank, modelfile_by_weight);
    if (model->sh_degree > 0 || model->origin[0] != 0 || model->origin[1] != 0 || model->origin[2] != 0)
        oxl_log(ctx, OXL_LOG_INFO, "%s: a .splat has no place for the origin and for harmonics past degree 0", path);
    rc = os_writer_open(ctx, path, &w);
    if (rc == OXL_OK) {
        for (size_t i = 0; rc == OXL_OK && i < model->count; i++) {
            unsigned char splat[MODELFILE_SPLAT_BYTES];
            modelfile_put_splat(model, rank[i].row, splat);
            rc = modelfile_put(ctx, &w, splat, sizeof splat);
        }
        rc = os_writer_close(ctx, &w, rc);
    }
    oxl_free(ctx, rank);
    return rc;
}

static oxl_result modelfile_read_splat(oxl_context *ctx, const char *path, oxl_model *out)
{
    struct os_file_map file = {0};
    oxl_result         rc   = os_read_file(ctx, path, &file);
    if (rc != OXL_OK) return rc;
    if (file.size % MODELFILE_SPLAT_BYTES)
        rc = oxl_fail(ctx, OXL_ERR_INPUT,
                      "%s: %zu bytes, wanted a multiple of 32\nfix: the file was cut short or is no .splat; copy it again", path,
                      file.size);
    if (rc == OXL_OK) rc = oxl_model_create(ctx, file.size / MODELFILE_SPLAT_BYTES, 0, out);
    for (size_t i = 0; rc == OXL_OK && i < out->count; i++)
        modelfile_get_splat((const unsigned char *)file.data + MODELFILE_SPLAT_BYTES * i, out, i);
    os_release_file(ctx, &file);
    return rc;
}

/* ---------------------------------------------------------------- the door */

static int modelfile_ends_in(const char *path, const char *extension)
{
    const size_t n = strlen(path), m = strlen(extension);
    return n >= m && !strcmp(path + n - m, extension);
}

oxl_result oxl_model_read(oxl_context *ctx, const char *path, oxl_model *out)
{
    oxl_result rc;
    *out = (oxl_model){0};
    rc   = modelfile_ends_in(path, ".splat") ? modelfile_read_splat(ctx, path, out) : modelfile_read_ply(ctx, path, out);
    if (rc == OXL_OK) modelfile_drop_rows(ctx, path, out);
    else oxl_model_free(ctx, out);
    return rc;
}

oxl_result oxl_model_write(oxl_context *ctx, const char *path, const oxl_model *model)
{
    if (modelfile_ends_in(path, ".ply")) return modelfile_write_ply(ctx, path, model, 3);
    if (modelfile_ends_in(path, ".splat")) return modelfile_write_splat(ctx, path, model);
    return oxl_fail(ctx, OXL_ERR_USAGE, "%s: wanted a name that ends in .ply or .splat", path);
}
