/* model_pages.c - a model that stays in its PLY file: rendering a view reads only the rows that may be
 * visible in it.
 *
 * Rows are read in pages. Memory holds, for each page, a sphere around the means of its rows and their
 * largest standard deviation.
 *
 * Invariant: the image is that of the whole model: rows left out touch no pixel, and the rows that are read
 * keep their order.
 */
#include "../survey/sparse.h"
#include "formats.h"

#include "../core/vecmath.h"

/* Reaches, in standard deviations, where alpha at opacity 1 is below 1/255 (3.33). */
#define PAGES_REACH 3.34
#define PAGES_BLUR 2.0 /* Widens the view (px) by the reach of the renderer's low pass. */
/* Bounds the slope at which a Gaussian is projected, in half images: the renderer evaluates its Jacobian at
 * most 1.3 of them from the centre. */
#define PAGES_SLOPE 1.5

enum { PAGES_ROWS = 1024 };

/* ---------------- what a view may show */

/* Returns 1 if a Gaussian with its centre within `radius` of a point and standard deviations up to sigma
 * may show in a view. */
static int pages_sphere_shows(const oxl_camera *c, double near_plane, const double centre[3], double radius,
                              double sigma)
{
    const double focal[2] = {c->fx, c->fy}, middle[2] = {c->cx, c->cy}, size[2] = {c->width, c->height};
    double p[3], z[2];
    camera_transform(c, centre, NULL, p);
    z[0] = OXL_MAX(p[2] - radius, 0), z[1] = p[2] + radius;
    if (!(z[1] > near_plane * (1 - 1e-6))) return 0;
    for (int a = 0; a < 2; a++) {
        const double slope = PAGES_SLOPE * OXL_MAX(middle[a], size[a] - middle[a]) / focal[a];
        const double reach = focal[a] * (radius + PAGES_REACH * sigma * sqrt(1 + slope * slope));
        const double high = size[a] - middle[a] + PAGES_BLUR, low = -middle[a] - PAGES_BLUR;
        if (focal[a] * p[a] - reach > high * z[high > 0] || focal[a] * p[a] + reach < low * z[low < 0])
            return 0;
    }
    return 1;
}

/* Returns the largest standard deviation over a row's lobes and axes. */
static double pages_sigma(const float *log_scale[3], size_t row, const float *factor[3], size_t lobes)
{
    double most = -HUGE_VAL;
    for (int a = 0; a < 3; a++)
        most = OXL_MAX(most, log_scale[a][row] + (row < lobes ? OXL_MAX((double)factor[a][row], 0) : 0));
    return vecmath_exp(most);
}

OXL_INTERNAL int model_row_shows(const oxl_camera *camera, double near_plane, const oxl_model *m, size_t row)
{
    const float *scale[] = {m->plane[OXL_LOG_SCALE], m->plane[OXL_LOG_SCALE + 1],
                            m->plane[OXL_LOG_SCALE + 2]};
    const float *factor[] = {m->plane[OXL_LOBE + 1], m->plane[OXL_LOBE + 2], m->plane[OXL_LOBE + 3]};
    const double p[] = {m->plane[OXL_MEAN][row], m->plane[OXL_MEAN + 1][row], m->plane[OXL_MEAN + 2][row]};
    return pages_sphere_shows(camera, near_plane, p, 0, pages_sigma(scale, row, factor, m->lobes));
}

/* ---------------- pages */

static size_t pages_rows(const struct oxl_model_pages *p, size_t page)
{
    return OXL_MIN(p->layout.rows - page * PAGES_ROWS, PAGES_ROWS);
}

/* Reads the finite rows of a page, as a model relative to the file's origin. lobed: rows with second lobes in
 * the whole file, which come first in it. */
static oxl_result pages_read(oxl_context *ctx, const struct oxl_model_pages *p, struct os_reader *file,
                             size_t page, size_t lobed, oxl_model *out)
{
    const size_t first = page * PAGES_ROWS, rows = pages_rows(p, page);
    const size_t lobes = lobed > first ? OXL_MIN(lobed - first, rows) : 0;
    uint8_t keep[PAGES_ROWS];
    oxl_result rc = oxl_model_create(ctx, rows, p->layout.degree, out);
    memcpy(out->origin, p->origin, sizeof out->origin);
    if (rc == OXL_OK) rc = model_set_lobes(ctx, out, lobes);
    if (rc == OXL_OK) rc = model_file_read_rows(ctx, &p->layout, file, first, out);
    if (rc == OXL_OK) model_file_settle_limits(out);
    for (size_t i = 0; i < rows && rc == OXL_OK; i++) keep[i] = (uint8_t)model_row_is_finite(out, i);
    if (rc == OXL_OK) model_keep_rows(out, keep);
    else oxl_model_free(ctx, out);
    return rc;
}

/* Measures the sphere around the means of a page, slightly widened against rounding, and its
 * largest standard deviation. */
static void pages_measure(const oxl_model *m, struct model_page *page)
{
    const float *scale[] = {m->plane[OXL_LOG_SCALE], m->plane[OXL_LOG_SCALE + 1],
                            m->plane[OXL_LOG_SCALE + 2]};
    const float *factor[] = {m->plane[OXL_LOBE + 1], m->plane[OXL_LOBE + 2], m->plane[OXL_LOBE + 3]};
    *page = (struct model_page){.radius = -1};
    for (int a = 0; a < 3; a++) {
        double low = HUGE_VAL, high = -HUGE_VAL;
        for (size_t i = 0; i < m->count; i++)
            low = OXL_MIN(low, m->plane[OXL_MEAN + a][i]), high = OXL_MAX(high, m->plane[OXL_MEAN + a][i]);
        page->centre[a] = (low + high) / 2;
    }
    for (size_t i = 0; i < m->count; i++) {
        double square = 0;
        for (int a = 0; a < 3; a++) square += pow(m->plane[OXL_MEAN + a][i] - page->centre[a], 2);
        page->radius = OXL_MAX(page->radius, sqrt(square) * (1 + 1e-6));
        page->sigma = OXL_MAX(page->sigma, pages_sigma(scale, i, factor, m->lobes));
    }
}

/* Allocates the pages of a file, without their spheres, and its path in one block, which
 * oxl_large_free releases. */
static struct oxl_model_pages *pages_create(oxl_context *ctx, const char *path,
                                            const struct model_file_layout *layout, const double origin[3])
{
    const size_t pages = (layout->rows + PAGES_ROWS - 1) / PAGES_ROWS, length = strlen(path) + 1;
    struct oxl_model_pages *p = oxl_calloc(ctx, 1, sizeof *p + pages * sizeof *p->page + length);
    if (!p) return NULL;
    p->layout = *layout;
    p->pages = pages;
    p->page = (struct model_page *)(p + 1);
    p->path = memcpy(p->page + pages, path, length);
    memcpy(p->origin, origin, sizeof p->origin);
    return p;
}

OXL_INTERNAL oxl_result model_pages_open(oxl_context *ctx, const char *path,
                                         const struct model_file_layout *of, oxl_large_model *out)
{
    oxl_model *head = &out->model;
    struct oxl_model_pages *p;
    struct os_reader file = {0};
    oxl_result rc = OXL_OK;
    out->pages = p = pages_create(ctx, path, of, head->origin);
    if (!p) rc = OXL_ERR_MEMORY;
    if (rc == OXL_OK) rc = os_reader_open(ctx, path, &file);
    for (size_t k = 0; rc == OXL_OK && k < p->pages; k++) {
        oxl_model rows = {0};
        rc = pages_read(ctx, p, &file, k, of->lobes, &rows);
        if (rc == OXL_OK) pages_measure(&rows, &p->page[k]);
        head->count += rows.count, head->lobes += rows.lobes;
        oxl_model_free(ctx, &rows);
    }
    os_reader_close(&file);
    head->sh_degree = of->degree;
    head->not_finite = rc == OXL_OK ? of->rows - head->count : 0;
    model_file_report_dropped(ctx, path, head->not_finite, of->rows);
    if (rc == OXL_OK && head->not_finite && head->count == 0)
        rc = oxl_fail(
            ctx, OXL_ERR_INPUT,
            "%s: all %zu Gaussians hold values that are not finite, so nothing is left\nfix: export the model again",
            path, of->rows);
    if (rc != OXL_OK) oxl_large_free(ctx, out);
    return rc;
}

void oxl_large_free(oxl_context *ctx, oxl_large_model *large)
{
    oxl_model_free(ctx, &large->model);
    oxl_free(ctx, large->pages);
    *large = (oxl_large_model){.pages = NULL};
}

void oxl_large_move_origin(oxl_large_model *large, const double origin[3])
{
    if (!large->pages) oxl_model_move_origin(&large->model, origin);
    else memcpy(large->model.origin, origin, sizeof large->model.origin);
}

OXL_INTERNAL oxl_result model_pages_get(oxl_context *ctx, const oxl_large_model *large, size_t page,
                                        oxl_model *out)
{
    const oxl_model *model = &large->model;
    const struct oxl_model_pages *p = large->pages;
    struct os_reader file = {0};
    oxl_result rc = os_reader_open(ctx, p->path, &file);
    *out = (oxl_model){0};
    if (rc == OXL_OK) rc = pages_read(ctx, p, &file, page, model->lobes ? p->layout.lobes : 0, out);
    os_reader_close(&file);
    if (rc == OXL_OK) oxl_model_move_origin(out, model->origin);
    return rc;
}

/* Appends the `kept` rows of a page that may show; rows with second lobes stay first, as
 * they are first in the file. */
static oxl_result pages_append(oxl_context *ctx, const oxl_model *page, const uint8_t *keep, size_t kept,
                               oxl_model *out)
{
    size_t lobes = out->lobes, to = out->count;
    oxl_result rc =
        to + kept > out->capacity ? model_reserve(ctx, out, to + kept + out->capacity / 2) : OXL_OK;
    if (rc != OXL_OK) return rc;
    for (size_t i = 0; i < page->lobes; i++) lobes += keep[i];
    out->count += kept;
    rc = model_set_lobes(ctx, out, lobes);
    for (size_t i = 0; i < page->count && rc == OXL_OK; i++) {
        if (!keep[i]) continue;
        for (int k = 0; k < oxl_model_planes(page); k++) out->plane[k][to] = page->plane[k][i];
        for (int k = OXL_LOBE; k < OXL_PLANES && i < page->lobes; k++) out->plane[k][to] = page->plane[k][i];
        to++;
    }
    return rc;
}

OXL_INTERNAL oxl_result model_pages_view(oxl_context *ctx, const oxl_large_model *large,
                                         const oxl_camera *camera, double near_plane, oxl_model *out)
{
    const oxl_model *model = &large->model;
    const struct oxl_model_pages *p = large->pages;
    oxl_camera moved = *camera; /* the same camera around the file's origin */
    struct os_reader file = {0};
    oxl_result rc = oxl_model_create(ctx, 0, p->layout.degree, out);
    for (int a = 0; a < 3; a++)
        for (int k = 0; k < 3; k++)
            moved.translation[a] += camera->rotation[3 * a + k] * (p->origin[k] - model->origin[k]);
    if (rc == OXL_OK) rc = os_reader_open(ctx, p->path, &file);
    for (size_t k = 0; k < p->pages && rc == OXL_OK; k++) {
        uint8_t keep[PAGES_ROWS];
        size_t kept = 0;
        oxl_model rows = {0};
        if (p->page[k].radius < 0 ||
            !pages_sphere_shows(&moved, near_plane, p->page[k].centre, p->page[k].radius, p->page[k].sigma))
            continue;
        rc = pages_read(ctx, p, &file, k, model->lobes ? p->layout.lobes : 0, &rows);
        for (size_t i = 0; i < rows.count && rc == OXL_OK; i++)
            kept += keep[i] = (uint8_t)model_row_shows(&moved, near_plane, &rows, i);
        if (rc == OXL_OK && kept > 0) rc = pages_append(ctx, &rows, keep, kept, out);
        oxl_model_free(ctx, &rows);
    }
    os_reader_close(&file);
    memcpy(out->origin, p->origin, sizeof p->origin);
    model_copy_rendering(model, out);
    if (rc == OXL_OK) oxl_model_move_origin(out, model->origin);
    else oxl_model_free(ctx, out);
    return rc;
}
