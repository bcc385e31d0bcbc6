/* model_file.c - reads models as PLY: the standard of 3DGS, with an element for second lobes.
 *
 * Sources: the PLY of Kerbl 2023's reference code (62 float columns, raw values).
 *
 *     element dog   byte  0  opacity_factor  float     4  scale_factor  3 float
 *
 * Row i of element dog belongs to vertex i, or to the vertex of the property vertex_index (earlier versions).
 *
 * Invariant: rows with values that are not finite are dropped, and their number is logged; infinities that
 * are the limits of opacity and width are not among them.
 */
#include "model_columns.h"
#include "ply.h"

#include "../core/bytes.h"

#define MODEL_FILE_SCALE_MAX 88.7f /* Limits log sizes: a float holds no larger size. */
#define MODEL_FILE_FLAT -87.0f     /* Replaces the log of a width of 0. */
enum { MODEL_FILE_JUDGED = 100 };  /* least number of Gaussians by whose ranges a file is judged */
/* Replaces an infinite logit; its alpha is 0 or 1 to the last bit of a float. */
#define MODEL_FILE_OPAQUE 20.0f

enum {
    MODEL_FILE_ROWS = 256,      /* rows converted at a time */
    MODEL_FILE_HEADER = 1 << 16 /* bytes; a file with a longer header is read as a whole */
};

/* ---------------- the columns of the standard PLY */

static struct model_file_column model_file_column(const char *prefix, int index, int plane)
{
    struct model_file_column c = {.plane = plane};
    snprintf(c.name, sizeof c.name, "%s%d", prefix, index);
    return c;
}

OXL_INTERNAL int model_file_columns(int file_degree, int sh_degree,
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

static size_t model_file_count_unturned(const oxl_model *m)
{
    size_t count = 0;
    for (size_t i = 0; i < m->count; i++)
        count += m->plane[OXL_ROTATION][i] == 0 && m->plane[OXL_ROTATION + 1][i] == 0 &&
                 m->plane[OXL_ROTATION + 2][i] == 0 && m->plane[OXL_ROTATION + 3][i] == 0;
    return count;
}

/* Keeps the rows with finite values and sizes, in their order. */
OXL_INTERNAL oxl_result model_file_drop_rows(oxl_context *ctx, const char *path, oxl_model *model)
{
    const size_t count = model->count, limits = model_file_settle_limits(model);
    size_t unturned;
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
    unturned = model_file_count_unturned(model);
    model_file_check_units(ctx, path, model);
    if (limits)
        oxl_log(ctx, OXL_LOG_INFO,
                "%s: %zu Gaussians are at the limit of opacity or width (infinite), and are kept", path,
                limits);
    if (unturned)
        oxl_log(ctx, OXL_LOG_WARNING,
                "%s: %zu of %zu Gaussians have the rotation 0 0 0 0, and are taken as not turned", path,
                unturned, model->count);
    return OXL_OK;
}

/* ---------------- PLY in */

static oxl_result model_file_no_property(oxl_context *ctx, const struct ply *ply,
                                         const struct ply_element *vertex, const char *name)
{
    const int packed = ply_find_property(vertex, "packed_position") >= 0;
    const int points = ply_find_property(vertex, "x") >= 0 && ply_find_property(vertex, "f_dc_0") < 0;
    struct text seen = {.ctx = ctx};
    oxl_result rc;
    for (int c = 0; c < vertex->properties && seen.size < 400; c++)
        text_add(&seen, "%s%s", c ? " " : "", vertex->property[c].name);
    rc = oxl_fail(
        ctx, OXL_ERR_INPUT, "%s: element vertex has no property '%s'; it has: %s\nfix: %s", ply->path, name,
        seen.data ? seen.data : "none",
        packed ? "this is a compressed PLY; write a plain one: splat-transform IN.compressed.ply OUT.ply"
        : points
            ? "this is a point cloud or a mesh; a model of Gaussians has f_dc_0, opacity, scale_0, rot_0 and more"
            : "convert the file to the standard 3DGS layout");
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

static int model_file_has_rgb(const struct ply_element *vertex)
{
    int has = ply_find_property(vertex, "f_dc_0") < 0;
    for (int i = 0; i < 3; i++) has &= ply_find_property(vertex, MODEL_FILE_RGB[i]) >= 0;
    return has;
}

static const char *model_file_name(const struct model_file_column *column, int rgb)
{
    return rgb && column->plane >= OXL_SH && column->plane < OXL_SH + 3
               ? MODEL_FILE_RGB[column->plane - OXL_SH]
               : column->name;
}

static void model_file_from_rgb(const struct ply_element *vertex, oxl_model *model)
{
    for (int c = 0; c < 3; c++) {
        const double white = ply_white(vertex->property[ply_find_property(vertex, MODEL_FILE_RGB[c])].type);
        float *plane = model->plane[OXL_SH + c];
        for (size_t i = 0; i < model->count; i++) plane[i] = (float)((plane[i] / white - 0.5) / MODEL_SH0);
    }
}

/* Reads the planes of element vertex, each straight from its column. */
static oxl_result model_file_read_vertices(oxl_context *ctx, const struct ply *ply, int element,
                                           oxl_model *out)
{
    const struct ply_element *vertex = &ply->element[element];
    struct model_file_column column[MODEL_FILE_COLUMNS];
    struct ply_target *target = NULL;
    const int rgb = model_file_has_rgb(vertex);
    int degree, columns;
    oxl_result rc = model_file_read_degree(ctx, ply, vertex, &degree);
    if (rc != OXL_OK) return rc;
    columns = model_file_columns(degree, degree, column);
    for (int c = 0; c < columns; c++)
        if (column[c].plane >= 0 && ply_find_property(vertex, model_file_name(&column[c], rgb)) < 0)
            return model_file_no_property(ctx, ply, vertex, column[c].name);
    rc = oxl_model_create(ctx, (size_t)vertex->rows, degree, out);
    if (rc != OXL_OK) return rc;
    target = oxl_calloc(ctx, (size_t)vertex->properties, sizeof *target);
    if (!target) return OXL_ERR_MEMORY;
    for (int c = 0; c < columns; c++)
        if (column[c].plane >= 0)
            target[ply_find_property(vertex, model_file_name(&column[c], rgb))].as_float =
                out->plane[column[c].plane];
    rc = ply_read(ctx, ply, element, target);
    if (rc == OXL_OK && rgb) model_file_from_rgb(vertex, out);
    oxl_free(ctx, target);
    return rc;
}

/* ---------------- second lobes in */

/* Reads the rows of element dog. index: (rows) vertex of each row, as double; the row number without
 * vertex_index. factor: (4,rows). */
static oxl_result model_file_read_factors(oxl_context *ctx, const struct ply *ply, int element, double *index,
                                          float *factor)
{
    const struct ply_element *dog = &ply->element[element];
    struct ply_target *target = oxl_calloc(ctx, (size_t)dog->properties + 1, sizeof *target);
    oxl_result rc;
    if (!target) return OXL_ERR_MEMORY;
    for (int k = -1; k < MODEL_LOBE_PLANES; k++) {
        const char *name = k < 0 ? "vertex_index" : MODEL_FILE_LOBE[k];
        const int at = ply_find_property(dog, name);
        if (k < 0 && at < 0) {
            for (size_t i = 0; i < (size_t)dog->rows; i++) index[i] = (double)i;
            continue;
        }
        if (at < 0) {
            rc = oxl_fail(
                ctx, OXL_ERR_INPUT,
                "%s: element dog has no property '%s', expected opacity_factor and scale_factor_0 to _2\n"
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

/* Marks the vertices that rows of element dog name, each at most once. */
static oxl_result model_file_mark_lobes(oxl_context *ctx, const struct ply *ply, const double *index,
                                        size_t rows, size_t vertices, uint8_t *active)
{
    for (size_t i = 0; i < rows; i++) {
        if (!(index[i] >= 0 && index[i] < (double)vertices && index[i] == floor(index[i])))
            return oxl_fail(
                ctx, OXL_ERR_INPUT,
                "%s: element dog, row %zu: vertex_index is %.10g, expected a whole number below %zu\n"
                "fix: the lobes belong to another set of vertices; write the file again with oceanxl",
                ply->path, i, index[i], vertices);
        if (active[(size_t)index[i]]++)
            return oxl_fail(
                ctx, OXL_ERR_INPUT,
                "%s: element dog, row %zu: vertex_index %.0f was there before, expected one lobe a vertex\n"
                "fix: remove the repeated row",
                ply->path, i, index[i]);
    }
    return OXL_OK;
}

static oxl_result model_file_read_lobes(oxl_context *ctx, const struct ply *ply, int element,
                                        oxl_model *model)
{
    /* Limits the rows by the vertices: rows without properties need no bytes, so the
     * header can state any number. */
    const uint64_t declared = ply->element[element].rows;
    const size_t vertices = model->count, rows = (size_t)OXL_MIN(declared, vertices);
    double *index = oxl_alloc(ctx, rows + 1, sizeof *index);
    float *factor = oxl_alloc(ctx, rows + 1, MODEL_LOBE_PLANES * sizeof *factor);
    uint8_t *active = oxl_calloc(ctx, vertices + 1, 1);
    /* (vertices) row in dog of a vertex with a second lobe */
    size_t *row = oxl_alloc(ctx, vertices + 1, sizeof *row);
    oxl_result rc = index && factor && active && row ? OXL_OK : OXL_ERR_MEMORY;
    if (rc == OXL_OK && declared > vertices)
        rc = oxl_fail(ctx, OXL_ERR_INPUT,
                      "%s: element dog announces %llu rows for %zu vertices, expected at most one each\n"
                      "fix: write the file again with oceanxl, or leave element dog out",
                      ply->path, (unsigned long long)declared, vertices);
    if (rc == OXL_OK) rc = model_file_read_factors(ctx, ply, element, index, factor);
    if (rc == OXL_OK) rc = model_file_mark_lobes(ctx, ply, index, rows, vertices, active);
    if (rc == OXL_OK) rc = model_make_lobes(ctx, model, active);
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
