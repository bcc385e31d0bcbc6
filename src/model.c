/* model.c - planes of Gaussians: create, grow, start from points, read, write.
 *
 * Sources: Kerbl 2023 (the start from points, the PLY layout); the .splat layout is antimatter15's.
 * Invariant: one allocation holds all planes, one after the other, each `capacity` floats long. Capacity is a multiple of
 * MODEL_PACK, so each plane starts on a 64-byte line and kernels may read and write whole packs of rows up to capacity.
 * Rows from count to capacity are finite: model_clear_rows fills them when they are made, and who lowers count leaves rows
 * that were Gaussians once.
 */
#include "internal.h"

/* ---------------------------------------------------------------- memory */

enum { MODEL_PACK = 16 }; /* rows: 64 bytes of float, the widest vector */

int oxl_model_planes(const oxl_model *model)
{
    const int side = model->sh_degree + 1;
    return OXL_SH + 3 * side * side;
}

OXL_INTERNAL void model_clear_rows(oxl_model *model, size_t first, size_t end)
{
    const int planes = oxl_model_planes(model);
    if (end <= first) return;
    for (int p = 0; p < planes; p++) memset(model->plane[p] + first, 0, (end - first) * sizeof(float));
    for (size_t i = first; i < end; i++) model->plane[OXL_ROTATION][i] = 1;
}

/* The model in fresh memory with another capacity or degree; on failure the old one stays as it was. */
static oxl_result model_lay_out(oxl_context *ctx, oxl_model *model, size_t capacity, int sh_degree)
{
    oxl_model m      = {.count = model->count, .sh_degree = sh_degree};
    const int planes = oxl_model_planes(&m);
    float    *memory = NULL;
    if (capacity <= SIZE_MAX - MODEL_PACK) {
        /* an odd number of lines: else planes of 2^n rows would all fall into the same set of the cache */
        m.capacity = (((capacity + MODEL_PACK - 1) / MODEL_PACK) | 1) * MODEL_PACK;
        memory     = oxl_alloc(ctx, m.capacity, (size_t)planes * sizeof *memory);
    }
    if (!memory) return oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for %zu Gaussians of %d numbers", capacity, planes);
    m.memory = memory;
    memcpy(m.origin, model->origin, sizeof m.origin);
    for (int p = 0; p < planes; p++) {
        m.plane[p] = memory + (size_t)p * m.capacity;
        if (model->plane[p]) memcpy(m.plane[p], model->plane[p], m.count * sizeof(float));
        else memset(m.plane[p], 0, m.count * sizeof(float));
    }
    model_clear_rows(&m, m.count, m.capacity);
    oxl_free(ctx, model->memory);
    *model = m;
    return OXL_OK;
}

static oxl_result model_check_degree(oxl_context *ctx, int sh_degree)
{
    if (sh_degree >= 0 && sh_degree <= 3) return OXL_OK;
    return oxl_fail(ctx, OXL_ERR_USAGE, "spherical harmonics of degree %d, wanted 0 to 3", sh_degree);
}

oxl_result oxl_model_create(oxl_context *ctx, size_t count, int sh_degree, oxl_model *out)
{
    oxl_result rc;
    *out = (oxl_model){0};
    rc   = model_check_degree(ctx, sh_degree);
    if (rc == OXL_OK) rc = model_lay_out(ctx, out, count, sh_degree);
    if (rc == OXL_OK) out->count = count; /* these rows are clear already */
    return rc;
}

void oxl_model_free(oxl_context *ctx, oxl_model *model)
{
    if (!model) return;
    oxl_free(ctx, model->memory);
    *model = (oxl_model){0};
}

OXL_INTERNAL oxl_result model_reserve(oxl_context *ctx, oxl_model *model, size_t capacity)
{
    if (capacity <= model->capacity) return OXL_OK;
    return model_lay_out(ctx, model, capacity, model->sh_degree);
}

OXL_INTERNAL oxl_result model_set_degree(oxl_context *ctx, oxl_model *model, int sh_degree)
{
    const oxl_result rc = model_check_degree(ctx, sh_degree);
    if (rc != OXL_OK || sh_degree == model->sh_degree) return rc;
    return model_lay_out(ctx, model, model->capacity, sh_degree);
}

OXL_INTERNAL oxl_result model_copy(oxl_context *ctx, const oxl_model *from, oxl_model *to)
{
    const oxl_result rc = oxl_model_create(ctx, from->count, from->sh_degree, to);
    if (rc != OXL_OK) return rc;
    memcpy(to->origin, from->origin, sizeof to->origin);
    for (int p = 0; p < oxl_model_planes(from) && from->count; p++)
        memcpy(to->plane[p], from->plane[p], from->count * sizeof(float));
    return OXL_OK;
}
