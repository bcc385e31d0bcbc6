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
    if (type >= PLY_FLOAT32) return most > 1 ? PLY_POINTS_NARROW : 1;
    return most > PLY_POINTS_NARROW ? ply_white(PLY_UINT16) : PLY_POINTS_NARROW;
}

/* Reads the columns of all rows, each by any of its names. value: (6,rows), zeros. */
static oxl_result ply_points_columns(oxl_context *ctx, const struct ply *ply, int element, double *value,
                                     double *white)
{
    static const char *const names[PLY_POINTS_PLANES][3] = {{"x", "x", "x"},
                                                            {"y", "y", "y"},
                                                            {"z", "z", "z"},
                                                            {"r", "diffuse_red", "red"},
                                                            {"g", "diffuse_green", "green"},
                                                            {"b", "diffuse_blue", "blue"}};
    const struct ply_element *vertex = &ply->element[element];
    const size_t rows = (size_t)vertex->rows;
    struct ply_target *target = oxl_calloc(ctx, (size_t)vertex->properties + 1, sizeof *target);
    enum ply_type type = PLY_UINT8;
    oxl_result rc = target ? OXL_OK : OXL_ERR_MEMORY;
    for (int i = 0; i < PLY_POINTS_PLANES && rc == OXL_OK; i++) {
        int found = -1;
        for (int k = 3; k-- > 0 && found < 0;) found = ply_find_property(vertex, names[i][k]);
        if (found >= 0)
            target[found].as_double = value + (size_t)i * rows, type = vertex->property[found].type;
        else if (i < 3)
            rc = oxl_fail(ctx, OXL_ERR_INPUT, "%s: no property %s of its points\nfix: export them again",
                          ply->path, names[i][0]);
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
    double *value = oxl_calloc(r->ctx, PLY_POINTS_PLANES * rows + 1, sizeof *value), white = 1;
    if (rc == OXL_OK && !value) rc = OXL_ERR_MEMORY;
    if (rc == OXL_OK && element >= 0) rc = ply_points_columns(r->ctx, &ply, element, value, &white);
    if (r->rc == OXL_OK) r->rc = rc;
    for (size_t k = 0; k < rows && r->rc == OXL_OK; k++) {
        double at[PLY_POINTS_PLANES];
        for (size_t i = 0; i < PLY_POINTS_PLANES; i++)
            at[i] = value[i * rows + k] * (i < 3 ? 1 : PLY_POINTS_NARROW / white);
        if (fabs(at[0]) + fabs(at[1]) + fabs(at[2]) <= DBL_MAX) json_survey_add_point(r, at, at + 3);
    }
    oxl_free(r->ctx, value);
    ply_close(r->ctx, &ply);
    return r->rc;
}
