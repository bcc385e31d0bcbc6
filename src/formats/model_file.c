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

/* Names the float columns of element dog, one for each plane from OXL_LOBE on. */
static const char *const MODEL_FILE_LOBE[MODEL_LOBE_PLANES] = {"opacity_factor", "scale_factor_0",
                                                               "scale_factor_1", "scale_factor_2"};

/* ---------------- the columns of the standard PLY */

struct model_file_column {
    char name[20];
    int plane; /* plane of the model; -1: written as 0, not needed when read */
};

static struct model_file_column model_file_column(const char *prefix, int index, int plane)
{
    struct model_file_column c = {.plane = plane};
    snprintf(c.name, sizeof c.name, "%s%d", prefix, index);
    return c;
}

/* Lists the columns of a PLY of `file_degree` for a model of `sh_degree`, in the standard's order; f_rest is
 * channel-major: all coefficients of red, then of green, then of blue. Returns their number: 62 when
 * file_degree is 3. */
static int model_file_columns(int file_degree, int sh_degree,
                              struct model_file_column out[MODEL_FILE_COLUMNS])
{
    const int rest = (file_degree + 1) * (file_degree + 1) - 1; /* coefficients per channel past degree 0 */
    const int kept = (sh_degree + 1) * (sh_degree + 1);
    int n = 0;
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

/* ---------------- rows that are not finite */

/* Replaces infinities that are limits: opacity is a logit and size a logarithm, so alpha 0 and 1 and a width
 * of 0 are infinite there; the finite values give the same image. Returns the number of rows changed. */
OXL_INTERNAL size_t model_file_settle_limits(oxl_model *model)
{
    size_t settled = 0;
    for (size_t i = 0; i < model->count; i++) {
        float *opacity = &model->plane[OXL_OPACITY][i];
        int has = isinf(*opacity) != 0; /* Makes 1 of isinf(-INFINITY), which may be -1. */
        if (has) *opacity = *opacity > 0 ? MODEL_FILE_OPAQUE : -MODEL_FILE_OPAQUE;
        for (int a = 0; a < 3; a++) {
            float *scale = &model->plane[OXL_LOG_SCALE + a][i];
            if (!(isinf(*scale) && *scale < 0)) continue;
            *scale = MODEL_FILE_FLAT;
            has = 1;
        }
        for (int k = 0; k < MODEL_LOBE_PLANES && i < model->lobes; k++) {
            float *factor = &model->plane[OXL_LOBE + k][i];
            if (!isinf(*factor) || (k > 0 && *factor > 0)) continue;
            *factor = k > 0 ? MODEL_FILE_FLAT : *factor > 0 ? MODEL_FILE_OPAQUE : -MODEL_FILE_OPAQUE;
            has = 1;
        }
        settled += (size_t)has;
    }
    return settled;
}

static void model_file_find_range(const oxl_model *m, int plane, int planes, float *low, float *high)
{
    *low = INFINITY, *high = -INFINITY;
    for (int k = plane; k < plane + planes; k++)
        for (size_t i = 0; i < m->count; i++) {
            *low = fminf(*low, m->plane[k][i]);
            *high = fmaxf(*high, m->plane[k][i]);
        }
}

/* Warns if opacities look like alphas instead of logits, or scales like sizes instead of logarithms, as
 * some programs export them: trained models have logits of both signs, and sizes that differ by more than
 * a factor of e. */
static void model_file_check_units(oxl_context *ctx, const char *path, const oxl_model *m)
{
    float low, high;
    if (m->count < MODEL_FILE_JUDGED) return;
    model_file_find_range(m, OXL_OPACITY, 1, &low, &high);
    if (low >= 0 && low < high && high <= 1)
        oxl_log(
            ctx, OXL_LOG_WARNING,
            "%s: all opacities are from %.3g to %.3g, as alphas are; read are logits, log(alpha / (1 - alpha))\n"
            "fix: export raw values, as 3DGS writes them",
            path, (double)low, (double)high);
    model_file_find_range(m, OXL_LOG_SCALE, 3, &low, &high);
    if (low >= 0 && low < high && high - low < 1)
        oxl_log(ctx, OXL_LOG_WARNING,
                "%s: all scales are from %.3g to %.3g, as sizes are; read are their logarithms\n"
                "fix: export raw values, as 3DGS writes them",
                path, (double)low, (double)high);
}

/* Keeps the rows with finite values and sizes, in their order. */
OXL_INTERNAL oxl_result model_file_drop_rows(oxl_context *ctx, const char *path, oxl_model *model)
{
    const size_t count = model->count, limits = model_file_settle_limits(model);
    uint8_t *keep = oxl_alloc(ctx, count + 1, 1);
    if (!keep) return OXL_ERR_MEMORY;
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
                "%s: dropped %zu of %zu Gaussians that hold values which are not finite", path,
                model->not_finite, count);
    model_file_check_units(ctx, path, model);
    if (limits)
        oxl_log(ctx, OXL_LOG_INFO,
                "%s: %zu Gaussians are at the limit of opacity or width (infinite), and are kept", path,
                limits);
    return OXL_OK;
}

/* ---------------- PLY in */

static oxl_result model_file_no_property(oxl_context *ctx, const struct ply *ply,
                                         const struct ply_element *vertex, const char *name)
{
    const int packed = ply_find_property(vertex, "packed_position") >= 0;
    int points = ply_find_property(vertex, "x") >= 0;
    struct text seen = {.ctx = ctx};
    oxl_result rc;
    for (int c = 0; c < vertex->properties && seen.size < 400; c++) {
        const char *has = vertex->property[c].name;
        text_add(&seen, "%s%s", c ? " " : "", has);
        points &= strncmp(has, "scal", 4) && strncmp(has, "rot", 3) && strncmp(has, "f_dc", 4);
    }
    rc = oxl_fail(
        ctx, OXL_ERR_INPUT, "%s: element vertex has no property '%s'; it has: %s\nfix: %s", ply->path, name,
        seen.data ? seen.data : "none",
        packed ? "this is a compressed PLY; write a plain one: splat-transform IN.compressed.ply OUT.ply"
        : points
            ? "this is a point cloud or a mesh; a model of Gaussians has f_dc_0, opacity, scale_0, rot_0 and more"
            : "rename its columns of Gaussians as 3DGS has them: x y z, f_dc_0 to _2, "
              "f_rest_*, opacity, scale_0 to _2, rot_0 to _3");
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
        "%s: %d properties f_rest_*, expected 0, 9, 24 or 45\nfix: export spherical harmonics of degree 0 to 3",
        ply->path, rest);
}

/* Names the columns that a model may have in the place of f_dc_*, as nerfstudio writes it in its mode rgb. */
static const char *const MODEL_FILE_RGB[3] = {"red", "green", "blue"};

/* Finds the property of a column; of f_dc_*, it may be a colour. -1: there is none. */
static int model_file_property(const struct ply_element *vertex, const struct model_file_column *column)
{
    const int found = ply_find_property(vertex, column->name), c = column->plane - OXL_SH;
    return found < 0 && c >= 0 && c < 3 ? ply_find_property(vertex, MODEL_FILE_RGB[c]) : found;
}

/* Turns colours of white `white` into coefficients of degree 0. */
static void model_file_from_rgb(oxl_model *model, int plane, double white)
{
    for (size_t i = 0; i < model->count; i++)
        model->plane[plane][i] = (float)((model->plane[plane][i] / white - 0.5) / MODEL_SH0);
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
        oxl_log(ctx, OXL_LOG_WARNING, "%s: not used, though it is there: %s", ply->path, names.data);
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

/* Reads the planes of element vertex, each straight from its column. */
static oxl_result model_file_read_vertices(oxl_context *ctx, const struct ply *ply, int element,
                                           oxl_model *out)
{
    const struct ply_element *vertex = &ply->element[element];
    struct model_file_column column[MODEL_FILE_COLUMNS];
    struct ply_target *target;
    float *filter = NULL;
    const int filter_at = ply_find_property(vertex, "filter_3D");
    int degree, columns;
    oxl_result rc = model_file_read_degree(ctx, ply, vertex, &degree);
    if (rc != OXL_OK) return rc;
    columns = model_file_columns(degree, degree, column);
    for (int c = 0; c < columns; c++)
        if (column[c].plane >= 0 && model_file_property(vertex, &column[c]) < 0)
            return model_file_no_property(ctx, ply, vertex, column[c].name);
    rc = oxl_model_create(ctx, (size_t)vertex->rows, degree, out);
    if (rc != OXL_OK) return rc;
    target = oxl_calloc(ctx, (size_t)vertex->properties, sizeof *target);
    if (target && filter_at >= 0)
        target[filter_at].as_float = filter = oxl_alloc(ctx, (size_t)vertex->rows + 1, sizeof *filter);
    if (!target || (filter_at >= 0 && !filter)) rc = OXL_ERR_MEMORY;
    for (int c = 0; c < columns && rc == OXL_OK; c++)
        if (column[c].plane >= 0)
            target[model_file_property(vertex, &column[c])].as_float = out->plane[column[c].plane];
    if (rc == OXL_OK) model_file_name_unread(ctx, ply, vertex, target);
    if (rc == OXL_OK) rc = ply_read(ctx, ply, element, target);
    for (int c = 0; c < columns && rc == OXL_OK; c++)
        if (column[c].plane >= 0 && ply_find_property(vertex, column[c].name) < 0)
            model_file_from_rgb(out, column[c].plane,
                                ply_white(vertex->property[model_file_property(vertex, &column[c])].type));
    if (rc == OXL_OK && filter) {
        model_file_fuse(out, filter);
        oxl_log(ctx, OXL_LOG_INFO, "%s: filter_3D of Mip-Splatting is applied to widths and opacities",
                ply->path);
    }
    OXL_FREE(ctx, target, filter);
    return rc;
}

/* Reads row i of element dog as the second lobe of vertex i. */
static oxl_result model_file_read_lobes(oxl_context *ctx, const struct ply *ply, int element,
                                        oxl_model *model)
{
    const struct ply_element *dog = &ply->element[element];
    struct ply_target *target = oxl_calloc(ctx, (size_t)dog->properties + 1, sizeof *target);
    oxl_result rc = target ? OXL_OK : OXL_ERR_MEMORY;
    if (rc == OXL_OK && (dog->rows > model->count || ply_find_property(dog, "vertex_index") >= 0))
        rc = oxl_fail(
            ctx, OXL_ERR_INPUT,
            "%s: element dog announces %llu rows for %zu vertices, or states their vertices; expected "
            "row i for vertex i\nfix: write the file again with oceanxl, or leave element dog out",
            ply->path, (unsigned long long)dog->rows, model->count);
    if (rc == OXL_OK) rc = model_set_lobes(ctx, model, (size_t)dog->rows);
    for (int k = 0; k < MODEL_LOBE_PLANES && rc == OXL_OK; k++) {
        const int at = ply_find_property(dog, MODEL_FILE_LOBE[k]);
        if (at >= 0) target[at].as_float = model->plane[OXL_LOBE + k];
        else
            rc = oxl_fail(
                ctx, OXL_ERR_INPUT,
                "%s: element dog has no property '%s', expected opacity_factor and scale_factor_0 to _2\n"
                "fix: write the file again with oceanxl, or leave element dog out",
                ply->path, MODEL_FILE_LOBE[k]);
    }
    if (rc == OXL_OK) rc = ply_read(ctx, ply, element, target);
    oxl_free(ctx, target);
    return rc;
}

OXL_INTERNAL oxl_result model_file_read_ply(oxl_context *ctx, const char *path, oxl_model *out)
{
    struct ply ply;
    int vertex, dog;
    oxl_result rc = ply_open(ctx, path, &ply);
    if (rc != OXL_OK) return rc;
    vertex = ply_find_element(&ply, "vertex");
    dog = ply_find_element(&ply, "dog");
    if (vertex >= 0) rc = model_file_read_vertices(ctx, &ply, vertex, out);
    else
        rc = oxl_fail(ctx, OXL_ERR_INPUT,
                      "%s: no element 'vertex' among its %d\nfix: export the model as a 3DGS PLY", path,
                      ply.elements);
    if (rc == OXL_OK && dog >= 0) rc = model_file_read_lobes(ctx, &ply, dog, out);
    for (int i = 0; rc == OXL_OK && i < ply.comments; i++) model_read_comment(ctx, path, ply.comment[i], out);
    ply_close(ctx, &ply);
    return rc;
}

/* ---------------- PLY out */

static oxl_result model_write_check_column(oxl_context *ctx, const char *path, const char *name,
                                           const float *plane, size_t rows)
{
    for (size_t i = 0; i < rows; i++)
        if (!(fabsf(plane[i]) <= FLT_MAX))
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

/* Writes the header; the context's error is that of os_writer_close if the disk is full. */
static oxl_result model_write_header(oxl_context *ctx, FILE *file, const oxl_model *model, int file_degree)
{
    struct model_file_column column[MODEL_FILE_COLUMNS];
    const int columns = model_file_columns(file_degree, file_degree, column);
    struct text t = {.ctx = ctx};
    oxl_result rc = OXL_OK;
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
    if (t.failed) rc = OXL_ERR_MEMORY;
    else fwrite(t.data, 1, t.size, file);
    text_free(&t);
    return rc;
}

/* Writes rows of the planes (columns); -1: zeros. Leaves errors to os_writer_close. */
static void model_write_rows(FILE *file, const oxl_model *model, const int *plane, int columns, size_t count)
{
    unsigned char rows[MODEL_FILE_ROWS * 4 * MODEL_FILE_COLUMNS];
    const size_t row = 4 * (size_t)columns; /* bytes */
    for (size_t first = 0; first < count; first += MODEL_FILE_ROWS) {
        const size_t n = OXL_MIN(count - first, MODEL_FILE_ROWS);
        for (int c = 0; c < columns; c++)
            for (size_t i = 0; i < n; i++)
                bytes_put_float(rows + i * row + 4 * (size_t)c,
                                plane[c] < 0 ? 0 : model->plane[plane[c]][first + i]);
        fwrite(rows, row, n, file);
    }
}

OXL_INTERNAL oxl_result model_file_write_ply(oxl_context *ctx, const char *path, const oxl_model *model,
                                             int file_degree)
{
    struct os_writer w = {0};
    struct model_file_column column[MODEL_FILE_COLUMNS];
    const int columns = model_file_columns(file_degree, model->sh_degree, column);
    int plane[MODEL_FILE_COLUMNS], lobe[MODEL_LOBE_PLANES];
    oxl_result rc = model_write_check_finite(ctx, path, model, file_degree);
    if (rc == OXL_OK) rc = os_writer_open(ctx, path, &w);
    if (rc != OXL_OK) return rc;
    for (int c = 0; c < columns; c++) plane[c] = column[c].plane;
    for (int k = 0; k < MODEL_LOBE_PLANES; k++) lobe[k] = OXL_LOBE + k;
    rc = model_write_header(ctx, w.file, model, file_degree);
    model_write_rows(w.file, model, plane, columns, model->count);
    model_write_rows(w.file, model, lobe, MODEL_LOBE_PLANES, model->lobes);
    return os_writer_close(ctx, &w, rc);
}
