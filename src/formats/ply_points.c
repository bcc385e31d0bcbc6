/* ply_points.c - reads the points of a PLY file that a transforms.json names, or that stands for a missing
 * points3D.
 *
 * Invariant: colours of any type become 0 to 255, by the white that their values show.
 */
#include "json_survey.h"
#include "ply.h"

enum { PLY_POINTS_PLANES = 6 }; /* x y z, red green blue */
/* Names the largest colour of 8 bits; wider types may hold such colours, too. */
#define PLY_POINTS_NARROW 255.0

/* Returns full white of the colours: floats are 0 to 1 or 0 to 255, integers 0 to 255 or, if
 * one is larger, 0 to 65535. */
static double ply_points_white(enum ply_type type, const double *colour, size_t count)
{
    double most = 0;
    for (size_t i = 0; i < count; i++)
        if (colour[i] <= DBL_MAX) most = OXL_MAX(most, colour[i]);
    if (type == PLY_FLOAT32 || type == PLY_FLOAT64) return most > 1 ? PLY_POINTS_NARROW : 1;
    return most > PLY_POINTS_NARROW ? ply_white(PLY_UINT16) : PLY_POINTS_NARROW;
}

/* Finds the column of a plane by any of its names; -1: there is none. */
static int ply_points_column(const struct ply_element *vertex, int plane)
{
    static const char *const names[PLY_POINTS_PLANES][3] = {{"x"},
                                                            {"y"},
                                                            {"z"},
                                                            {"red", "diffuse_red", "r"},
                                                            {"green", "diffuse_green", "g"},
                                                            {"blue", "diffuse_blue", "b"}};
    int found = -1;
    for (int k = 0; k < 3 && found < 0 && names[plane][k]; k++)
        found = ply_find_property(vertex, names[plane][k]);
    return found;
}

/* Reads the columns of all rows. value: (6,rows), zeros. */
static oxl_result ply_points_columns(oxl_context *ctx, const struct ply *ply, int element, double *value,
                                     double *white)
{
    const struct ply_element *vertex = &ply->element[element];
    const size_t rows = (size_t)vertex->rows;
    struct ply_target *target = oxl_calloc(ctx, (size_t)vertex->properties + 1, sizeof *target);
    enum ply_type type = PLY_UINT8;
    oxl_result rc = target ? OXL_OK : OXL_ERR_MEMORY;
    for (int i = 0; i < PLY_POINTS_PLANES && rc == OXL_OK; i++) {
        const int p = ply_points_column(vertex, i);
        if (p >= 0) target[p].as_double = value + (size_t)i * rows;
        else if (i < 3)
            rc = oxl_fail(ctx, OXL_ERR_INPUT, "%s: no property %c of its points\nfix: export them again",
                          ply->path, 'x' + i);
        if (p >= 0 && i >= 3) type = vertex->property[p].type;
    }
    if (rc == OXL_OK) rc = ply_read(ctx, ply, element, target);
    if (rc == OXL_OK) *white = ply_points_white(type, value + 3 * rows, 3 * rows);
    oxl_free(ctx, target);
    return rc;
}

OXL_INTERNAL oxl_result ply_points_read(struct colmap_reader *r, const char *path)
{
    struct ply ply = {0};
    oxl_result rc = ply_open(r->ctx, path, &ply);
    const int element = rc == OXL_OK ? ply_find_element(&ply, "vertex") : -1;
    const size_t rows = element < 0 ? 0 : (size_t)ply.element[element].rows;
    double *value = oxl_calloc(r->ctx, PLY_POINTS_PLANES * rows + 1, sizeof *value),
           white = PLY_POINTS_NARROW;
    if (rc == OXL_OK && !value) rc = OXL_ERR_MEMORY;
    if (rc == OXL_OK && element >= 0) rc = ply_points_columns(r->ctx, &ply, element, value, &white);
    for (size_t k = 0; k < rows && rc == OXL_OK; k++) {
        const double position[3] = {value[k], value[rows + k], value[2 * rows + k]};
        double rgb[3];
        for (size_t c = 0; c < 3; c++) rgb[c] = PLY_POINTS_NARROW * value[(3 + c) * rows + k] / white;
        if (fabs(position[0]) + fabs(position[1]) + fabs(position[2]) <= DBL_MAX)
            json_survey_add_point(r, position, rgb);
        rc = r->rc;
    }
    oxl_free(r->ctx, value);
    ply_close(r->ctx, &ply);
    return rc;
}
