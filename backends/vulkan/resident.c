/* resident.c - what stays on the device between steps: the model, its moments, the statistics of density
 * control; training images: images.c.
 *
 * The model lies in slabs of rows, each a buffer of its own: so no array that a shader sees exceeds
 * maxStorageBufferRange, however many Gaussians there are. What is indexed by any row has at most 16 bytes a
 * row or pair.
 *
 * Invariant: from vulkan_forward on the device's copy is the model, until vulkan_download_model has
 * downloaded it for a host that changes it.
 */
#include "resident.h"

static void vulkan_release_slabs(struct vulkan *v, struct vulkan_slab *slab, size_t slabs)
{
    for (size_t i = 0; i < slabs; i++) {
        vulkan_release(v, &slab[i].parameter);
        vulkan_release(v, &slab[i].gradient);
        vulkan_release(v, &slab[i].mean);
        vulkan_release(v, &slab[i].square);
    }
    oxl_free(v->ctx, slab);
}

OXL_INTERNAL void vulkan_renderer_free(void *device)
{
    struct vulkan_renderer *r = device;
    struct vulkan *v = r->v;
    for (struct vulkan_renderer **at = &v->renderers; *at; at = &(*at)->next)
        if (*at == r) {
            *at = r->next;
            break;
        }
    vulkan_finish(v);
    for (size_t at = offsetof(struct vulkan_renderer, splat_a); at < sizeof *r;
         at += sizeof(struct vulkan_buffer))
        vulkan_release(v, (struct vulkan_buffer *)((char *)r + at));
    vulkan_release_slabs(v, r->slab, r->slab_capacity);
    if (r->surroundings) vulkan_release_slabs(v, r->surroundings->slab, r->surroundings->slab_capacity);
    oxl_free(v->ctx, r->surroundings);
    for (size_t i = 0; i < r->image_capacity; i++) vulkan_release(v, &r->image[i].bytes);
    oxl_free(v->ctx, r->image);
    oxl_free(v->ctx, r);
}

OXL_INTERNAL oxl_result vulkan_renderer_create(oxl_context *ctx, void **out)
{
    struct vulkan_renderer *r = oxl_calloc(ctx, 1, sizeof *r);
    struct vulkan *v = ctx->backend->vulkan;
    void *mapped = NULL;
    *out = NULL;
    if (!r) return oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for a renderer");
    r->v = v;
    r->pinned_view = -1;
    r->next = v->renderers;
    v->renderers = r;
    v->evict = vulkan_drop_images;
    vulkan_enter(v);
    vulkan_reserve(v, &r->view_buffer, 1, sizeof r->view, "views");
    vulkan_reserve(v, &r->counts, COUNTS, sizeof(uint32_t), "numbers");
    vulkan_reserve(v, &r->digits, VULKAN_DIGITS, sizeof(uint32_t), "numbers");
    vulkan_reserve(v, &r->rates, OXL_PLANES, sizeof(float), "numbers");
    vulkan_reserve(v, &r->totals, OXL_COUNT(r->report->totals) + VULKAN_POWERS, sizeof(float), "numbers");
    vulkan_create(v, &r->reports, VULKAN_REPORTS * sizeof *r->report, 1);
    if (v->rc == OXL_OK)
        vulkan_ok(v, v->MapMemory(v->device, r->reports.memory, 0, VK_WHOLE_SIZE, 0, &mapped), "reports");
    r->report = mapped;
    vulkan_fill(v, &r->counts, 0, VK_WHOLE_SIZE, 0);
    vulkan_fill(v, &r->totals, 0, VK_WHOLE_SIZE, 0);
    if (v->rc == OXL_OK) *out = r;
    else vulkan_renderer_free(r);
    return v->rc;
}

/* ---------------- upload and download of the model */

OXL_INTERNAL size_t vulkan_slab_rows(const struct vulkan_renderer *r, size_t slab, size_t total)
{
    const size_t first = slab * r->stride;
    return total > first ? OXL_MIN(total - first, (size_t)r->stride) : 0;
}

/* What a pass over the rows of a slab is pushed. */
OXL_INTERNAL void vulkan_row_push(const struct vulkan_renderer *r, size_t slab, uint32_t push[6])
{
    push[0] = (uint32_t)(slab * r->stride);
    push[1] = (uint32_t)vulkan_slab_rows(r, slab, r->count);
    push[2] = r->stride;
    push[3] = (uint32_t)r->drawn_sh_degree;
    push[4] = (uint32_t)r->lobes;
    push[5] = r->lobe_plane;
}

static struct vulkan_buffer *vulkan_slab_part(struct vulkan_slab *slab, const struct vulkan_renderer *r,
                                              const oxl_model *m)
{
    if (!r->trained || m == r->model) return &slab->parameter;
    return m == &r->trained->mean ? &slab->mean : &slab->square;
}

OXL_INTERNAL float *vulkan_host_plane(const oxl_model *m, const struct vulkan_renderer *r, uint32_t plane)
{
    return plane < r->lobe_plane ? m->plane[plane] : m->plane[OXL_LOBE + plane - r->lobe_plane];
}

/* The first planes of a model or of its moments, slab by slab. */
static void vulkan_copy_model(struct vulkan_renderer *r, const oxl_model *m, uint32_t planes, int up)
{
    for (size_t s = 0; s < r->slabs; s++)
        for (uint32_t k = 0; k < planes; k++) {
            const size_t rows = vulkan_slab_rows(r, s, k < r->lobe_plane ? r->count : r->lobes);
            const size_t offset = (size_t)k * r->stride * sizeof(float);
            float *host = vulkan_host_plane(m, r, k);
            if (rows == 0) continue;
            host += s * r->stride;
            if (up)
                vulkan_upload(r->v, vulkan_slab_part(&r->slab[s], r, m), offset, host, rows * sizeof(float));
            else
                vulkan_queue_read(r->v, vulkan_slab_part(&r->slab[s], r, m), offset, host,
                                  rows * sizeof(float));
        }
    if (!up) vulkan_collect(r->v);
}

static void vulkan_reserve_slabs(struct vulkan_renderer *r)
{
    struct vulkan *v = r->v;
    const size_t wanted = (r->count + v->slab_rows - 1) / v->slab_rows;
    r->stride = (uint32_t)((r->count + OXL_MAX(wanted, (size_t)1) - 1) / OXL_MAX(wanted, (size_t)1) +
                           VULKAN_GROUP - 1) /
                VULKAN_GROUP * VULKAN_GROUP;
    r->lobe_plane = (uint32_t)(OXL_SH + 3 * (r->sh_degree + 1) * (r->sh_degree + 1));
    r->planes = r->lobe_plane + (r->lobes ? MODEL_LOBE_PLANES : 0);
    if (wanted > r->slab_capacity) {
        struct vulkan_slab *more = oxl_regrow(v->ctx, r->slab, r->slab_capacity, wanted, sizeof *more);
        if (!more) v->rc = oxl_fail(v->ctx, OXL_ERR_MEMORY, "no memory for %zu slabs", wanted);
        if (!more) return;
        memset(more + r->slab_capacity, 0, (wanted - r->slab_capacity) * sizeof *more);
        r->slab = more;
        r->slab_capacity = wanted;
    }
    r->slabs = wanted;
    for (size_t s = 0; s < r->slabs; s++)
        vulkan_reserve(v, &r->slab[s].parameter, (size_t)r->stride * r->planes, sizeof(float),
                       "numbers of Gaussians");
}

static void vulkan_reserve_rows(struct vulkan_renderer *r)
{
    struct vulkan *v = r->v;
    const size_t n = r->rows;
    vulkan_reserve(v, &r->splat_a, n, 16, "Gaussians");
    vulkan_reserve(v, &r->splat_b, n, 16, "Gaussians");
    vulkan_reserve(v, &r->splat_c, n, 16, "Gaussians");
    vulkan_reserve(v, &r->row_slots, n, 8, "Gaussians");
    vulkan_reserve(v, &r->seen, n, 4, "Gaussians");
    vulkan_reserve(v, &r->rank, n, 4, "Gaussians");
    vulkan_reserve(v, &r->row_pairs, n, 4, "Gaussians");
    for (int k = 0; k < 2; k++) {
        vulkan_reserve(v, &r->row_key[k], n, 4, "Gaussians");
        vulkan_reserve(v, &r->row_value[k], n, 4, "Gaussians");
    }
    if (r->lobes) vulkan_reserve(v, &r->lobe_a, r->lobes, 16, "second lobes");
    if (r->lobes) vulkan_reserve(v, &r->lobe_b, r->lobes, 16, "second lobes");
    vulkan_reserve(v, &r->histogram, VULKAN_DIGITS * vulkan_chunks(n), 4, "Gaussians");
    vulkan_reserve(v, &r->scan_sums, vulkan_chunks(n), 4, "Gaussians");
}

/* The model, unless it is here already. */
OXL_INTERNAL void vulkan_take_model(struct vulkan_renderer *r, const oxl_model *m)
{
    if (r->model_here && r->model == m && r->plane == m->plane[0] && r->count == m->count &&
        r->lobes == m->lobes && r->sh_degree == m->sh_degree)
        return;
    r->model = m;
    r->trained = NULL;
    r->plane = m->plane[0];
    r->count = m->count, r->lobes = m->lobes, r->sh_degree = m->sh_degree;
    r->model_here = r->moments_here = r->stepped = 0;
    r->room = 0;
    r->low_memory = 0;
    vulkan_reserve_slabs(r);
    if (r->v->rc == OXL_OK) vulkan_copy_model(r, r->model, r->planes, 1);
    r->model_here = r->v->rc == OXL_OK;
}

OXL_INTERNAL void vulkan_take_surroundings(struct vulkan_renderer *r, const oxl_model *m)
{
    r->rows = r->count + (m ? m->count : 0);
    if (m && !r->surroundings) r->surroundings = oxl_calloc(r->v->ctx, 1, sizeof *r->surroundings);
    if (m && !r->surroundings)
        r->v->rc = oxl_fail(r->v->ctx, OXL_ERR_MEMORY, "no memory for the surroundings");
    if (m && r->surroundings) {
        r->surroundings->v = r->v;
        vulkan_take_model(r->surroundings, m);
    }
    vulkan_reserve_rows(r); /* rows may also have been moved: vulkan_move_rows */
}

OXL_INTERNAL void vulkan_reserve_moments(struct vulkan_renderer *r)
{
    for (size_t s = 0; s < r->slabs; s++) {
        vulkan_reserve(r->v, &r->slab[s].mean, (size_t)r->stride * r->planes, sizeof(float),
                       "numbers of Gaussians");
        vulkan_reserve(r->v, &r->slab[s].square, (size_t)r->stride * r->planes, sizeof(float),
                       "numbers of Gaussians");
    }
}

OXL_INTERNAL void vulkan_take_moments(struct vulkan_renderer *r, struct trained_model *trained)
{
    if (r->moments_here && r->trained == trained) return;
    if (r->model != &trained->model)
        r->v->rc = oxl_fail(r->v->ctx, OXL_ERR_USAGE, "a step of another model than the one that was drawn");
    if (r->v->rc != OXL_OK) return;
    r->trained = trained;
    vulkan_reserve_moments(r);
    vulkan_copy_model(r, &trained->mean, r->planes, 1);
    vulkan_copy_model(r, &trained->square, r->planes, 1);
    r->moments_here = r->v->rc == OXL_OK;
}

/* The statistics of density control, up or down: the device adds to what the host has, number by number, so
 * that a run's result does not depend on when it was saved. */
OXL_INTERNAL void vulkan_copy_sums(struct vulkan_renderer *r, int up)
{
    const struct renderer_sums *s = &r->sums;
    float(*sum)[4] = oxl_alloc(r->v->ctx, s->count + 1, sizeof *sum);
    if (!sum)
        r->v->rc =
            oxl_fail(r->v->ctx, OXL_ERR_MEMORY, "no memory for the statistics of %zu Gaussians", s->count);
    for (size_t i = 0; up && sum && i < s->count; i++) {
        sum[i][0] = s->gradient[i], sum[i][3] = s->views[i];
        sum[i][1] = s->banded ? s->gradient_mid[i] : 0, sum[i][2] = s->banded ? s->gradient_far[i] : 0;
    }
    if (up) vulkan_upload(r->v, &r->statistics, 0, sum, s->count * sizeof *sum);
    else vulkan_download(r->v, &r->statistics, 0, sum, s->count * sizeof *sum);
    for (size_t i = 0; !up && r->v->rc == OXL_OK && i < s->count; i++) {
        s->gradient[i] = sum[i][0], s->views[i] = sum[i][3];
        if (s->banded) s->gradient_mid[i] = sum[i][1], s->gradient_far[i] = sum[i][2];
    }
    oxl_free(r->v->ctx, sum);
}

OXL_INTERNAL oxl_result vulkan_download_model(void *device, enum renderer_download what)
{
    struct vulkan_renderer *r = device;
    vulkan_enter(r->v);
    if (r->stepped && what == DOWNLOAD_SHAPE) vulkan_copy_model(r, r->model, OXL_SH, 0);
    for (int k = 0; r->stepped && what != DOWNLOAD_SHAPE && k < TRAINED_PARTS; k++)
        vulkan_copy_model(r, model_trained_part(r->trained, k), r->planes, 0);
    if (r->observed) vulkan_copy_sums(r, 0);
    if (r->v->rc != OXL_OK) return r->v->rc; /* the device still has what the host has not */
    if (what != DOWNLOAD_SHAPE) r->stepped = 0;
    r->observed = 0;
    if (what != DOWNLOAD_TO_READ) r->sums_here = 0;
    if (what == DOWNLOAD_TO_CHANGE) r->model_here = r->moments_here = 0;
    return r->v->rc;
}

/* ---------------- rows to other places */

/* From all slabs of `old` to those of r that have their rows. */
static void vulkan_move_slabs(struct vulkan_renderer *r, const struct vulkan_renderer *old,
                              const uint32_t *from)
{
    for (size_t s = 0; s < r->slabs; s++)
        for (size_t o = 0; o < old->slabs; o++) {
            const size_t first = s * r->stride, rows = vulkan_slab_rows(r, s, r->count);
            const size_t old_first = o * old->stride, old_rows = vulkan_slab_rows(old, o, old->count);
            if (rows == 0 || (from[first] & ~RENDERER_FRESH) >= old_first + old_rows ||
                (from[first + rows - 1] & ~RENDERER_FRESH) < old_first)
                continue;
            VULKAN_RUN(r->v, MOVE, 0, vulkan_groups(rows),
                       VULKAN_PUSH((uint32_t)first, (uint32_t)rows, r->stride, (uint32_t)old_first,
                                   (uint32_t)old_rows, old->stride, old->lobe_plane, r->lobe_plane,
                                   (uint32_t)r->lobes, OXL_SH),
                       VULKAN_BUFFERS(&r->moves, &old->slab[o].parameter, &old->slab[o].mean,
                                      &old->slab[o].square, &r->slab[s].parameter, &r->slab[s].mean,
                                      &r->slab[s].square));
        }
}

/* Old and new slabs are there at once; without room for both nothing has changed. */
OXL_INTERNAL oxl_result vulkan_move_rows(void *device, const struct renderer_move *move, int *moved)
{
    struct vulkan_renderer *r = device;
    struct vulkan *v = r->v;
    struct vulkan_renderer old = *r;
    *moved = 0;
    vulkan_enter(v);
    if (!r->model_here || !r->moments_here || move->count == 0) return OXL_OK;
    r->count = move->count, r->lobes = move->lobes, r->sh_degree = move->sh_degree;
    r->slab = NULL;
    r->slab_capacity = 0;
    vulkan_reserve_slabs(r);
    vulkan_reserve_moments(r);
    vulkan_reserve(v, &r->moves, r->count, sizeof *move->from, "Gaussians");
    if (v->rc == OXL_OK) vulkan_upload(v, &r->moves, 0, move->from, r->count * sizeof *move->from);
    if (v->rc == OXL_OK) vulkan_move_slabs(r, &old, move->from);
    vulkan_finish(v);
    *moved = v->rc == OXL_OK;
    if (*moved) vulkan_release_slabs(v, old.slab, old.slab_capacity);
    else {
        vulkan_release_slabs(v, r->slab, r->slab_capacity);
        r->slab = old.slab, r->slab_capacity = old.slab_capacity, r->slabs = old.slabs;
        r->count = old.count, r->lobes = old.lobes, r->stride = old.stride, r->planes = old.planes;
        r->sh_degree = old.sh_degree, r->lobe_plane = old.lobe_plane;
        return v->rc == OXL_ERR_MEMORY ? OXL_OK : v->rc;
    }
    r->room = 0;
    r->low_memory = 0;
    r->stepped = 1; /* the host has not got all of it */
    return OXL_OK;
}

OXL_INTERNAL oxl_result vulkan_send_shape(void *device, oxl_model *model, int reset_opacity)
{
    struct vulkan_renderer *r = device;
    const size_t opacity = OXL_OPACITY * (size_t)r->stride * sizeof(float), size = r->stride * sizeof(float);
    vulkan_enter(r->v);
    if (!r->model_here || r->model != model) return OXL_OK; /* all of it is uploaded when it is needed */
    r->plane = model->plane[0];
    vulkan_copy_model(r, model, OXL_SH, 1);
    for (size_t s = 0; s < r->slabs && reset_opacity && r->moments_here; s++) {
        vulkan_fill(r->v, &r->slab[s].mean, opacity, size, 0);
        vulkan_fill(r->v, &r->slab[s].square, opacity, size, 0);
    }
    return r->v->rc;
}
