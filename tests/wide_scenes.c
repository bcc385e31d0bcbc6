/* wide_scenes.c - scenes of struct wide, and the model that the float kernels take of one: see wide.h. */
#include "library.h"
#include "wide.h"

double wide_random(int seed, size_t i, size_t k)
{
    return 2 * random_unit(random_bits((uint64_t)seed, i, k)) - 1;
}

size_t wide_rows(const struct wide *w, int plane)
{
    return !w->plane[plane] ? 0 : plane < OXL_LOBE ? w->count : w->lobes;
}

void wide_scatter(struct wide *w, int seed, const struct wide_range *range)
{
    for (int k = 0; k < OXL_PLANES; k++) {
        while (k >= range->end) range++;
        for (size_t i = 0; i < wide_rows(w, k); i++)
            w->plane[k][i] = range->mean + range->spread * wide_random(seed, i, (size_t)k);
    }
}

void wide_fill(struct wide *w, int first, int end, double value)
{
    for (int k = first; k < end; k++)
        for (size_t i = 0; i < wide_rows(w, k); i++) w->plane[k][i] = value;
}

void wide_multiply(struct wide *w, int first, int end, double factor)
{
    for (int k = first; k < end; k++)
        for (size_t i = 0; i < wide_rows(w, k); i++) w->plane[k][i] *= factor;
}

void wide_look_ahead(struct wide *w)
{
    camera_rotation_from_quaternion((double[4]){1, 0, 0, 0}, w->camera.rotation);
}

void wide_mixed(struct wide *w, int width, int height, int count, int lobes, int sh_degree)
{
    static const struct wide_range mixed[] = {
        {OXL_LOG_SCALE, 0, 1.5}, {OXL_ROTATION, -2.2, 1.2}, {OXL_OPACITY, 0, 1},     {OXL_SH, 0, 3},
        {OXL_SH + 3, 0.3, 1},    {OXL_LOBE, 0, 0.3},        {OXL_LOBE + 1, -0.5, 2}, {OXL_PLANES, 0.2, 0.7}};
    oxl_camera c = {width, height, 58, 61, width * 0.46, height * 0.55, {0}, {0.1, -0.05, 3.2}};
    camera_rotation_from_quaternion((double[4]){0.95, 0.1, -0.15, 0.2}, c.rotation);
    wide_create(w, &c, (size_t)count, (size_t)lobes, sh_degree);
    for (int ch = 0; ch < 3; ch++) w->background[ch] = 0.25 * (ch + 1);
    wide_scatter(w, 41, mixed);
}

void wide_smooth(struct wide *w, int count, int lobes, int sh_degree, double focal, double spread)
{
    const struct wide_range smooth[] = {
        {OXL_LOG_SCALE, 0, spread}, {OXL_ROTATION, 0.5, 0.3}, {OXL_ROTATION + 1, 1, 1},
        {OXL_OPACITY, 0, 1},        {OXL_SH, -1, 0.5},        {OXL_SH + 3, 0.5, 0.5},
        {OXL_LOBE, 0, 0.1},         {OXL_LOBE + 1, -1, 0.3},  {OXL_PLANES, 0, 0.3}};
    wide_mixed(w, WIDE_SMOOTH_WIDTH, WIDE_SMOOTH_HEIGHT, count, lobes, sh_degree);
    w->camera.fx = focal, w->camera.fy = 1.1 * focal;
    wide_scatter(w, 41, smooth);
}

void wide_to_float(struct wide *w)
{
    w->near_plane = (float)w->near_plane;
    for (int k = 0; k < OXL_PLANES; k++)
        for (size_t i = 0; i < wide_rows(w, k); i++) w->plane[k][i] = (float)w->plane[k][i];
}

oxl_result wide_to_model(oxl_context *ctx, const struct wide *w, oxl_model *out)
{
    oxl_result rc = oxl_model_create(ctx, w->count, w->sh_degree, out);
    if (rc == OXL_OK) rc = model_set_lobes(ctx, out, w->lobes);
    for (int k = 0; k < OXL_PLANES && rc == OXL_OK; k++)
        for (size_t i = 0; i < wide_rows(w, k); i++) out->plane[k][i] = (float)w->plane[k][i];
    out->antialias = w->antialias;
    return rc;
}
