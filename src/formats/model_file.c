/* model_file.c - reads and writes models as PLY: the standard of 3DGS, with an element for second lobes.
 *
 * Sources: the PLY of Kerbl 2023's reference code (62 float columns, raw values).
 *
 *     element dog   byte  0  opacity_factor  float     4  scale_factor  3 float
 *
 * Row i of element dog belongs to vertex i.
 *
 * Invariant: rows with values that are not finite are dropped, and their number is logged; infinities that
 * are the limits of opacity and width are not among them. None is written: training must not produce them.
 */
#include "formats.h"
#include "ply.h"

#include "../core/bytes.h"
#include "../core/vecmath.h"

#define MODEL_FILE_SCALE_MAX 88.7f /* Limits log sizes: a float holds no larger size. */
#define MODEL_FILE_FLAT -87.0f     /* Replaces the log of a width of 0. */
enum { MODEL_FILE_JUDGED = 100 };  /* least number of Gaussians by whose ranges a file is judged */
/* Replaces an infinite logit; its alpha is 0 or 1 to the last bit of a float. */
#define MODEL_FILE_OPAQUE 20.0f

enum {
    MODEL_FILE_COLUMNS = 62, /* columns of the standard layout */
    MODEL_FILE_ROWS = 64     /* rows converted at a time */
};

/* ---------------- the columns of a PLY */

struct model_file_column {
    char name[20];
    int plane; /* plane of the model; -1: written as 0, not needed when read */
};

/* Adds columns NAME0, NAME1, ... of planes from `plane` on. Returns the place behind them. */
static struct model_file_column *model_file_add(struct model_file_column *out, const char *name, int count,
                                                int plane)
{
    for (int i = 0; i < count; i++, out++) {
        snprintf(out->name, sizeof out->name, "%s%d", name, i);
        out->plane = plane < 0 ? -1 : plane + i;
    }
    return out;
}

/* Lists the columns of a PLY of `file_degree` for a model of `sh_degree`, in the standard's order; f_rest is
 * channel-major: all coefficients of red, then of green, then of blue. Returns their number: 62 when
 * file_degree is 3. */
static int model_file_columns(int file_degree, int sh_degree,
                              struct model_file_column out[MODEL_FILE_COLUMNS])
{
    const int rest = (file_degree + 1) * (file_degree + 1) - 1; /* coefficients per channel past degree 0 */
    struct model_file_column *to = out, *first;
    for (int i = 0; i < 3; i++) *to++ = (struct model_file_column){{(char)('x' + i)}, OXL_MEAN + i};
    for (int i = 0; i < 3; i++) *to++ = (struct model_file_column){{'n', (char)('x' + i)}, -1};
    first = model_file_add(to, "f_dc_", 3, OXL_SH);
    to = model_file_add(first, "f_rest_", 3 * rest, -1);
    for (int i = 0; i < 3 * rest; i++)
        if (1 + i % rest < (sh_degree + 1) * (sh_degree + 1))
            first[i].plane = OXL_SH + 3 * (1 + i % rest) + i / rest;
    *to++ = (struct model_file_column){"opacity", OXL_OPACITY};
    to = model_file_add(to, "scale_", 3, OXL_LOG_SCALE);
    return (int)(model_file_add(to, "rot_", 4, OXL_ROTATION) - out);
}

/* Lists the columns of element dog. */
static void model_file_lobe_columns(struct model_file_column out[MODEL_LOBE_PLANES])
{
    *out = (struct model_file_column){"opacity_factor", OXL_LOBE};
    model_file_add(out + 1, "scale_factor_", 3, OXL_LOBE + 1);
}

/* ---------------- rows that are not finite */

/* Replaces infinities that are limits: opacity is a logit and size a logarithm, so alpha 0 and 1 and a width
 * of 0 are infinite there; the finite values give the same image. */
static void model_file_settle_limits(oxl_model *model, int plane, size_t rows)
{
    const int is_logit = plane == OXL_OPACITY || plane == OXL_LOBE;
    for (size_t i = 0; i < rows; i++) {
        float *x = &model->plane[plane][i];
        if (!isinf(*x)) continue;
        if (is_logit) *x = *x > 0 ? MODEL_FILE_OPAQUE : -MODEL_FILE_OPAQUE;
        else if (*x < 0) *x = MODEL_FILE_FLAT;
    }
}

/* Warns if opacities look like alphas instead of logits, or scales like sizes instead of logarithms, as
 * some programs export them: trained models have logits of both signs, and sizes that differ by more than
 * a factor of e. */
static void model_file_check_units(oxl_context *ctx, const char *path, const oxl_model *m, int plane,
                                   int planes, const char *words)
{
    float low = INFINITY, high = -INFINITY;
    for (int k = plane; k < plane + planes; k++)
        for (size_t i = 0; i < m->count; i++) {
            low = fminf(low, m->plane[k][i]);
            high = fmaxf(high, m->plane[k][i]);
        }
    if (m->count >= MODEL_FILE_JUDGED && low >= 0 && low < high && (planes > 1 ? high - low < 1 : high <= 1))
        oxl_log(ctx, OXL_LOG_WARNING,
                "%s: %s are expected, but all values are from %.3g to %.3g\n"
                "fix: export raw values, as 3DGS writes them",
                path, words, (double)low, (double)high);
}

/* Keeps the rows with finite values and sizes, in their order. */
OXL_INTERNAL oxl_result model_file_drop_rows(oxl_context *ctx, const char *path, oxl_model *model)
{
    const size_t count = model->count;
    uint8_t *keep = oxl_alloc(ctx, count + 1, 1);
    if (!keep) return OXL_ERR_MEMORY;
    model_file_settle_limits(model, OXL_OPACITY, count);
    for (int a = 0; a < 3; a++) model_file_settle_limits(model, OXL_LOG_SCALE + a, count);
    for (int k = 0; k < MODEL_LOBE_PLANES; k++) model_file_settle_limits(model, OXL_LOBE + k, model->lobes);
    for (size_t i = 0; i < count; i++) {
        keep[i] = (uint8_t)model_row_is_finite(model, i);
        for (int a = 0; a < 3; a++) keep[i] &= model->plane[OXL_LOG_SCALE + a][i] < MODEL_FILE_SCALE_MAX;
    }
    model_keep_rows(model, keep);
    oxl_free(ctx, keep);
    model->not_finite = count - model->count;
    if (count > 0 && model->count == 0)
        return oxl_fail(
            ctx, OXL_ERR_INPUT,
            "%s: all %zu Gaussians hold values that are not finite, so nothing is left\n"
            "fix: export the model again; its training has diverged, or its columns are in another order",
            path, count);
    if (model->not_finite)
        oxl_log(ctx, OXL_LOG_WARNING,
                "%s: %zu of %zu Gaussians hold values that are not finite, and are left out", path,
                model->not_finite, count);
    model_file_check_units(ctx, path, model, OXL_OPACITY, 1,
                           "opacities look like alphas; logits, log(alpha / (1 - alpha)),");
    model_file_check_units(ctx, path, model, OXL_LOG_SCALE, 3, "scales look like sizes; their logarithms");
    return OXL_OK;
}

/* ---------------- PLY in */

/* Finds the property of a column. nerfstudio writes colours in the place of f_dc_* in its mode rgb. -1: there
 * is none. */
static int model_file_property(const struct ply_element *element, const struct model_file_column *column)
{
    static const char *const rgb[3] = {"red", "green", "blue"};
    const int found = ply_find_property(element, column->name), c = column->plane - OXL_SH;
    return found < 0 && c >= 0 && c < 3 ? ply_find_property(element, rgb[c]) : found;
}

/* Refuses an element without one of its columns. */
static oxl_result model_file_check(oxl_context *ctx, const struct ply *ply, const struct ply_element *element,
                                   const struct model_file_column *column, int columns)
{
    const int packed = ply_find_property(element, "packed_position") >= 0;
    int points = ply_find_property(element, "x") >= 0, c = 0;
    struct text seen = {.ctx = ctx};
    oxl_result rc;
    while (c < columns && (column[c].plane < 0 || model_file_property(element, &column[c]) >= 0)) c++;
    if (c == columns) return OXL_OK;
    for (int k = 0; k < element->properties; k++) {
        const char *has = element->property[k].name;
        if (seen.size < 400) text_add(&seen, "%s%s", k ? " " : "", has);
        points &= strncmp(has, "scal", 4) && strncmp(has, "rot", 3) && strncmp(has, "f_dc", 4);
    }
    rc = oxl_fail(
        ctx, OXL_ERR_INPUT, "%s: element %s has no property '%s'; it has: %s\nfix: %s", ply->path,
        element->name, column[c].name, seen.data ? seen.data : "none",
        packed ? "this is a compressed PLY; write a plain one: splat-transform IN.compressed.ply OUT.ply"
        : points
            ? "this is a point cloud or a mesh; a model of Gaussians has f_dc_0, opacity, scale_0, rot_0 and more"
            : "rename its columns of Gaussians as 3DGS has them: x y z, f_dc_0 to _2, "
              "f_rest_*, opacity, scale_0 to _2, rot_0 to _3; element dog is OceanXL's own and optional");
    text_free(&seen);
    return rc;
}

/* Finds the SH degree from the number of f_rest columns. */
static oxl_result model_file_read_degree(oxl_context *ctx, const struct ply *ply,
                                         const struct ply_element *vertex, int *degree)
{
    int rest = 0;
    for (int c = 0; c < vertex->properties; c++) rest += !strncmp(vertex->property[c].name, "f_rest_", 7);
    for (*degree = 0; *degree <= 3; ++*degree)
        if (rest == 3 * ((*degree + 1) * (*degree + 1) - 1)) return OXL_OK;
    return oxl_fail(
        ctx, OXL_ERR_INPUT,
        "%s: found %d properties f_rest_*, expected 0, 9, 24 or 45\nfix: export spherical harmonics of degree 0 to 3",
        ply->path, rest);
}

/* Names the columns that nothing reads. target: (properties) those that are read have a place. */
static void model_file_name_unread(oxl_context *ctx, const struct ply *ply, const struct ply_element *vertex,
                                   const struct ply_target *target)
{
    struct text names = {.ctx = ctx};
    for (int c = 0; c < vertex->properties; c++) {
        const char *name = vertex->property[c].name;
        if (!target[c].as_float && !(name[0] == 'n' && name[1] && !name[2])) /* normals are always unread */
            text_add(&names, "%s%s", names.size ? ", " : "", name);
    }
    if (names.data)
        oxl_log(ctx, OXL_LOG_WARNING, "%s: this content of the file is not used: %s", ply->path, names.data);
    text_free(&names);
}

/* Applies the 3D filter of Mip-Splatting, a width for each Gaussian, as its script does before viewers read
 * the model: squares of widths add up, and opacities fall by the root of the volumes' ratio. */
static void model_file_fuse(oxl_model *model, const float *filter)
{
    for (size_t i = 0; i < model->count; i++) {
        float *opacity = &model->plane[OXL_OPACITY][i];
        double ratio = 1;
        for (int a = 0; a < 3; a++) {
            float *scale = &model->plane[OXL_LOG_SCALE + a][i];
            const double own = vecmath_exp(2.0 * *scale), all = own + (double)filter[i] * filter[i];
            ratio *= own / all;
            *scale = (float)(0.5 * vecmath_log(all));
        }
        *opacity = (float)vecmath_logit(sqrt(ratio) * vecmath_sigmoid(*opacity));
    }
}

/* Reads columns of an element, each straight into its plane, and filter_3D, if there is a place for it. */
static oxl_result model_file_read_columns(oxl_context *ctx, const struct ply *ply, int element,
                                          const struct model_file_column *column, int columns,
                                          oxl_model *model, float *filter)
{
    const struct ply_element *e = &ply->element[element];
    struct ply_target *target = oxl_calloc(ctx, (size_t)e->properties + 1, sizeof *target);
    oxl_result rc;
    if (!target) return OXL_ERR_MEMORY;
    if (filter) target[ply_find_property(e, "filter_3D")].as_float = filter;
    for (int c = 0; c < columns; c++)
        if (column[c].plane >= 0)
            target[model_file_property(e, &column[c])].as_float = model->plane[column[c].plane];
    model_file_name_unread(ctx, ply, e, target);
    rc = ply_read(ctx, ply, element, target);
    for (int c = 0; c < columns && rc == OXL_OK; c++) {
        float *const plane = column[c].plane < 0 ? NULL : model->plane[column[c].plane];
        if (!plane || ply_find_property(e, column[c].name) >= 0) continue;
        for (size_t i = 0; i < model->count; i++) /* turns colours into coefficients of degree 0 */
            plane[i] =
                (float)((plane[i] / ply_white(e->property[model_file_property(e, &column[c])].type) - 0.5) /
                        MODEL_SH0);
    }
    oxl_free(ctx, target);
    return rc;
}

static oxl_result model_file_read_vertices(oxl_context *ctx, const struct ply *ply, int element,
                                           oxl_model *out)
{
    const struct ply_element *vertex = &ply->element[element];
    struct model_file_column column[MODEL_FILE_COLUMNS];
    const int has_filter = ply_find_property(vertex, "filter_3D") >= 0;
    float *filter = NULL;
    int degree, columns = 0;
    oxl_result rc = model_file_read_degree(ctx, ply, vertex, &degree);
    if (rc == OXL_OK) columns = model_file_columns(degree, degree, column);
    if (rc == OXL_OK) rc = model_file_check(ctx, ply, vertex, column, columns);
    if (rc == OXL_OK) rc = oxl_model_create(ctx, (size_t)vertex->rows, degree, out);
    if (rc == OXL_OK && has_filter && !(filter = oxl_alloc(ctx, out->count + 1, sizeof *filter)))
        rc = OXL_ERR_MEMORY;
    if (rc == OXL_OK) rc = model_file_read_columns(ctx, ply, element, column, columns, out, filter);
    if (rc == OXL_OK && filter) {
        model_file_fuse(out, filter);
        oxl_log(ctx, OXL_LOG_INFO, "%s: filter_3D of Mip-Splatting is applied to widths and opacities",
                ply->path);
    }
    oxl_free(ctx, filter);
    return rc;
}

/* Reads row i of element dog as the second lobe of vertex i. */
static oxl_result model_file_read_lobes(oxl_context *ctx, const struct ply *ply, int element,
                                        oxl_model *model)
{
    const struct ply_element *dog = &ply->element[element];
    struct model_file_column column[MODEL_LOBE_PLANES];
    oxl_result rc;
    model_file_lobe_columns(column);
    if (dog->rows > model->count || ply_find_property(dog, "vertex_index") >= 0)
        return oxl_fail(
            ctx, OXL_ERR_INPUT,
            "%s: element dog announces %llu rows for %zu vertices, or states their vertices; expected "
            "row i for vertex i\nfix: write the file again with oceanxl, or leave element dog out",
            ply->path, (unsigned long long)dog->rows, model->count);
    rc = model_file_check(ctx, ply, dog, column, MODEL_LOBE_PLANES);
    if (rc == OXL_OK) rc = model_set_lobes(ctx, model, (size_t)dog->rows);
    return rc == OXL_OK ? model_file_read_columns(ctx, ply, element, column, MODEL_LOBE_PLANES, model, NULL)
                        : rc;
}

OXL_INTERNAL oxl_result model_file_read_ply(oxl_context *ctx, const char *path, oxl_model *out)
{
    struct ply ply;
    int vertex, dog;
    oxl_result rc = ply_open(ctx, path, &ply);
    if (rc != OXL_OK) return rc;
    vertex = ply_find_element(&ply, "vertex");
    dog = ply_find_element(&ply, "dog");
    rc = vertex < 0 ? oxl_fail(ctx, OXL_ERR_INPUT,
                               "%s: no element 'vertex' among its %d\nfix: export the model as a 3DGS PLY",
                               path, ply.elements)
                    : model_file_read_vertices(ctx, &ply, vertex, out);
    if (rc == OXL_OK && dog >= 0) rc = model_file_read_lobes(ctx, &ply, dog, out);
    if (rc == OXL_OK) model_read_comments(ctx, path, ply.file.data, ply.data, "comment ", out);
    ply_close(ctx, &ply);
    return rc;
}

/* ---------------- PLY out */

OXL_INTERNAL oxl_result model_write_check_finite(oxl_context *ctx, const char *path, const oxl_model *model)
{
    size_t row = 0;
    if (!(fabs(model->origin[0]) + fabs(model->origin[1]) + fabs(model->origin[2]) <= DBL_MAX))
        return oxl_fail(
            ctx, OXL_ERR_FAILED,
            "%s is not written: the model's origin is not finite\nfix: correct the line 'comment origin' "
            "of the model that it was made from",
            path);
    while (row < model->count && model_row_is_finite(model, row)) row++;
    return row == model->count
               ? OXL_OK
               : oxl_fail(
                     ctx, OXL_ERR_FAILED,
                     "%s is not written: row %zu holds a value that is not finite\nfix: remove such rows "
                     "before writing",
                     path, row);
}

static void model_write_element(struct text *t, const char *name, size_t rows,
                                const struct model_file_column *column, int columns)
{
    text_add(t, "element %s %zu\n", name, rows);
    for (int c = 0; c < columns; c++) text_add(t, "property float %s\n", column[c].name);
}

/* Writes rows of the planes of columns. Leaves errors to os_writer_close. */
static void model_write_rows(FILE *file, const oxl_model *model, const struct model_file_column *column,
                             int columns, size_t count)
{
    unsigned char rows[MODEL_FILE_ROWS * 4 * MODEL_FILE_COLUMNS];
    const size_t row = 4 * (size_t)columns; /* bytes */
    for (size_t first = 0; first < count; first += MODEL_FILE_ROWS) {
        const size_t n = OXL_MIN(count - first, MODEL_FILE_ROWS);
        for (int c = 0; c < columns; c++)
            for (size_t i = 0; i < n; i++)
                bytes_put_float(rows + i * row + 4 * (size_t)c,
                                column[c].plane < 0 ? 0 : model->plane[column[c].plane][first + i]);
        fwrite(rows, row, n, file);
    }
}

OXL_INTERNAL oxl_result model_file_write_ply(oxl_context *ctx, const char *path, const oxl_model *model,
                                             int file_degree)
{
    struct os_writer w = {0};
    struct model_file_column column[MODEL_FILE_COLUMNS], lobe[MODEL_LOBE_PLANES];
    const int columns = model_file_columns(file_degree, model->sh_degree, column);
    struct text t = {.ctx = ctx};
    oxl_result rc = model_write_check_finite(ctx, path, model);
    model_file_lobe_columns(lobe);
    text_add(&t, "ply\nformat binary_little_endian 1.0\n");
    model_write_comments(&t, "comment ", model);
    if (model->lobes)
        text_add(&t, "comment dog: a second lobe, alpha = min(.99, o G) - min(.99, o' G'); raw factors: "
                     "o' = o sigmoid(opacity_factor), s' = s exp(scale_factor)\n");
    model_write_element(&t, "vertex", model->count, column, columns);
    if (model->lobes) model_write_element(&t, "dog", model->lobes, lobe, MODEL_LOBE_PLANES);
    text_add(&t, "end_header\n");
    if (rc == OXL_OK && t.failed) rc = OXL_ERR_MEMORY;
    if (rc == OXL_OK) rc = os_writer_open(ctx, path, &w);
    if (rc == OXL_OK) {
        fwrite(t.data, 1, t.size, w.file);
        model_write_rows(w.file, model, column, columns, model->count);
        model_write_rows(w.file, model, lobe, MODEL_LOBE_PLANES, model->lobes);
        rc = os_writer_close(ctx, &w, OXL_OK);
    }
    text_free(&t);
    return rc;
}
