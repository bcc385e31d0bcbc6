/* density.c - the number of Gaussians and their places: split, prune, reset (Kerbl et al. 2023, sec. 5).
 *
 * A Gaussian whose mean over the views of |dL/d(u,v)| is large covers more than it can model. Two replace it,
 * each with half the variance on its longest axis, so that the image nearly stays the same
 * (density_make_child); Kerbl clones small ones and replaces large ones by two random samples. Faint ones are
 * removed. After the first reset interval the very large are split too, not removed
 * as in Kerbl: in turbid water they render the far range, and without them no Gaussian is left there to
 * split. Under water the gradients of the far range are too small: paper eq. 2 gives them a weight by depth.
 * There is one sum for each band of depths, so that the weights are chosen when needed, and the unweighted
 * sum (criterion of second lobes, eq. 4) costs nothing more.
 *
 * Invariants: children stand next to each other, so rows that are near in memory stay near in space (packs
 * out of view are skipped);
 * once rows have a second lobe none may split, so those stay first. A row with a nonfinite number is removed.
 */
#include "train_tools.h"
#include "../core/vecmath.h"
#include "../survey/sparse.h"

#define DENSITY_OPACITY_MIN 0.005  /* Gaussians of lower opacity are removed [Kerbl 2023] */
#define DENSITY_OPACITY_RESET 2.55 /* times the faintest contribution that counts: 0.01 [Kerbl 2023] */
/* x extent: larger ones are split after the first reset interval; removed in [Kerbl 2023] */
#define DENSITY_SCALE_MAX 0.1
#define DENSITY_OPACITY_MAX 0.999999 /* of a child: its logit is finite */
/* Of a child, with the longest standard deviation s and the opacity o of its parent: its standard deviation
 * there, and its distance from the parent's mean, are sqrt(1/2) s, so the pair has the variance s^2 / 2 + s^2
 * / 2; 1 - o' = (1 - o)^sqrt(1/2). */
#define DENSITY_SQRT_HALF 0.70710678118654752
#define DENSITY_INFINITY 0x7F800000u /* bits of a float; those of positive ones rise with them */

OXL_INTERNAL void density_free(oxl_context *ctx, struct density *d)
{
    OXL_FREE(ctx, d->gradient, d->verdict);
    d->gradient = NULL, d->verdict = NULL;
    d->capacity = 0;
}

/* The sums are one allocation, each `capacity` long. */
static size_t density_sums_kept(const struct density *d)
{
    return d->banded ? 4 : 2;
}

static oxl_result density_reserve(oxl_context *ctx, struct density *d, size_t count)
{
    const size_t capacity = count + count / 2;
    if (count <= d->capacity) return OXL_OK;
    density_free(ctx, d);
    d->gradient = oxl_alloc(ctx, capacity, density_sums_kept(d) * sizeof *d->gradient);
    d->verdict = oxl_alloc(ctx, capacity, sizeof *d->verdict);
    if (!d->gradient || !d->verdict) return density_free(ctx, d), OXL_ERR_MEMORY;
    d->capacity = capacity;
    d->views = d->gradient + capacity;
    d->gradient_mid = d->banded ? d->views + capacity : NULL;
    d->gradient_far = d->banded ? d->gradient_mid + capacity : NULL;
    return OXL_OK;
}

OXL_INTERNAL oxl_result density_clear(oxl_context *ctx, struct density *d, size_t count)
{
    const oxl_result rc = density_reserve(ctx, d, count);
    for (size_t k = 0; rc == OXL_OK && count > 0 && k < density_sums_kept(d); k++)
        memset(d->gradient + k * d->capacity, 0, count * sizeof *d->gradient);
    return rc;
}

OXL_INTERNAL oxl_result density_set_bands(oxl_context *ctx, struct density *d, size_t count, double z_near,
                                          double z_far)
{
    density_free(ctx, d);
    d->banded = z_near > 0 && z_far >= z_near;
    d->z_near = (float)z_near;
    d->z_far = (float)z_far;
    return density_clear(ctx, d, count);
}

OXL_INTERNAL void density_keep_rows(struct density *d, const uint8_t *keep, size_t count)
{
    for (size_t k = 0; k < density_sums_kept(d); k++) {
        float *sum = d->gradient + k * d->capacity, *to = sum;
        for (size_t i = 0; i < count; i++)
            if (keep[i]) *to++ = sum[i];
    }
}

OXL_INTERNAL void density_archive(struct archive *a, struct density *d, size_t count)
{
    if (a->reading && a->rc == OXL_OK) a->rc = density_clear(a->ctx, d, count);
    for (size_t k = 0; a->rc == OXL_OK && k < density_sums_kept(d); k++)
        ARCHIVE(a, d->gradient + k * d->capacity, count);
}

OXL_INTERNAL struct renderer_sums density_sums(const struct density *d, size_t count)
{
    return (struct renderer_sums){count,       d->banded,       d->z_near,       d->z_far,
                                  d->gradient, d->gradient_mid, d->gradient_far, d->views};
}

OXL_INTERNAL oxl_result density_observe(oxl_context *ctx, struct density *d, struct renderer *r, size_t count)
{
    const struct renderer_sums sums = density_sums(d, count);
    return renderer_observe(ctx, r, &sums);
}

OXL_INTERNAL double density_mean_gradient(const struct density *d, size_t row)
{
    const double sum =
        d->gradient[row] + (d->banded ? (double)d->gradient_mid[row] + d->gradient_far[row] : 0);
    return d->views[row] > 0 ? sum / d->views[row] : 0;
}

/* Replaces the sum of the nearest band by the weighted sum of all bands. */
static void density_weigh(oxl_context *ctx, struct density *d, size_t count,
                          const struct density_rules *rules)
{
    (void)ctx;
#pragma omp parallel for schedule(static) num_threads(ctx->threads)
    for (int64_t i = 0; i < (int64_t)count; i++)
        d->gradient[i] =
            (float)(d->gradient[i] + rules->f_mid * d->gradient_mid[i] + rules->f_far * d->gradient_far[i]);
}

/* ---------------- decisions */

static double density_scale(const oxl_model *m, size_t i)
{
    const float a = m->plane[OXL_LOG_SCALE][i], b = m->plane[OXL_LOG_SCALE + 1][i],
                c = m->plane[OXL_LOG_SCALE + 2][i];
    return vecmath_exp(OXL_MAX(OXL_MAX(a, b), c));
}

static oxl_change density_classify(const struct density *d, const oxl_model *m, size_t i,
                                   const struct density_rules *rules)
{
    const double mean = d->views[i] > 0 ? d->gradient[i] / d->views[i] : 0;
    if (!model_row_is_finite(m, i)) return OXL_REMOVE;
    if (vecmath_sigmoid(m->plane[OXL_OPACITY][i]) < DENSITY_OPACITY_MIN) return OXL_REMOVE;
    if (rules->split_large && density_scale(m, i) > DENSITY_SCALE_MAX * rules->extent) return OXL_SPLIT;
    return mean >= rules->gradient ? OXL_SPLIT : OXL_KEEP;
}

/* Counts the rows to split whose mean gradient reaches the one of these bits; `keeps`: those that do not are
 * kept as they are. */
static size_t density_reaching(struct density *d, size_t count, uint32_t bits, int keeps)
{
    size_t reaching = 0;
    float least;
    memcpy(&least, &bits, sizeof least);
    for (size_t i = 0; i < count; i++) {
        if (d->verdict[i] != OXL_SPLIT) continue;
        if (d->gradient[i] / d->views[i] >= least) reaching++;
        else if (keeps) d->verdict[i] = OXL_KEEP;
    }
    return reaching;
}

/* Limits splits under a cap to the `room` rows of the largest mean gradient, by bisection for the lowest
 * that at most `room` of them reach. Rows tied at the limit all stay unsplit, so the result does not depend
 * on their order. */
static size_t density_cap(struct density *d, size_t count, size_t room)
{
    uint32_t low = 0, high = DENSITY_INFINITY;
    while (high - low > 1) {
        const uint32_t middle = low + (high - low) / 2;
        if (density_reaching(d, count, middle, 0) > room) low = middle;
        else high = middle;
    }
    return density_reaching(d, count, high, 1);
}

/* ---------------- the new rows */

/* Makes row `at`, a copy of a Gaussian that is split, one of the two that replace it, on its longest axis
 * before or behind its mean (side -1 or 1). Together they have its mean, its covariance and, to first order
 * in its opacity, its sum of alpha. */
static void density_make_child(oxl_model *m, size_t at, int side)
{
    const double rest =
        vecmath_exp(DENSITY_SQRT_HALF * vecmath_log(vecmath_sigmoid(-m->plane[OXL_OPACITY][at])));
    const double shift = side * DENSITY_SQRT_HALF * density_scale(m, at);
    double q[4], r[9];
    int longest = 0;
    for (int k = 0; k < 4; k++) q[k] = m->plane[OXL_ROTATION + k][at];
    camera_rotation_from_quaternion(q, r);
    for (int a = 1; a < 3; a++)
        if (m->plane[OXL_LOG_SCALE + a][at] > m->plane[OXL_LOG_SCALE + longest][at]) longest = a;
    for (int a = 0; a < 3; a++) m->plane[OXL_MEAN + a][at] += (float)(shift * r[3 * a + longest]);
    m->plane[OXL_LOG_SCALE + longest][at] += (float)vecmath_log(DENSITY_SQRT_HALF);
    m->plane[OXL_OPACITY][at] = (float)vecmath_logit(OXL_MIN(1 - rest, DENSITY_OPACITY_MAX));
}

OXL_INTERNAL size_t density_sources(const struct density *d, const oxl_model *model, uint32_t *from)
{
    size_t at = 0, lobes = 0;
    for (size_t i = 0; i < model->count; i++) {
        if (d->verdict[i] != OXL_REMOVE)
            from[at++] = (uint32_t)i | (d->verdict[i] == OXL_SPLIT ? RENDERER_FRESH : 0);
        if (d->verdict[i] == OXL_SPLIT) from[at++] = (uint32_t)i | RENDERER_FRESH;
        lobes += i < model->lobes && d->verdict[i] != OXL_REMOVE;
    }
    return lobes;
}

/* Moves rows in place: removed ones leave, then, from the last on, rows that are split become two. `fresh`:
 * the new rows of a moment are 0. */
static void density_move_plane(const struct density *d, float *plane, size_t count, size_t new_count,
                               int fresh)
{
    size_t kept = 0, at = new_count;
    for (size_t i = 0; i < count; i++)
        if (d->verdict[i] != OXL_REMOVE) plane[kept++] = plane[i];
    for (size_t i = count; i-- > 0;) {
        if (d->verdict[i] == OXL_REMOVE) continue;
        plane[--at] = plane[--kept];
        if (d->verdict[i] != OXL_SPLIT) continue;
        plane[at - 1] = plane[at];
        at--;
        if (fresh) plane[at] = plane[at + 1] = 0;
    }
}

/* Needs capacity for the new rows. planes: 0: a device has their rows. */
static void density_rebuild(oxl_context *ctx, const struct density *d, oxl_model *model, size_t new_count,
                            int fresh, int planes)
{
    const size_t count = model->count;
    size_t lobes = 0;
    (void)ctx; /* without OpenMP */
    for (size_t i = 0; i < model->lobes; i++) lobes += d->verdict[i] != OXL_REMOVE;
    for (int k = OXL_LOBE; model->lobes && k < planes; k++)
        density_move_plane(d, model->plane[k], model->lobes, lobes, fresh);
#pragma omp parallel for schedule(dynamic) num_threads(ctx->threads)
    for (int k = 0; k < OXL_MIN(planes, oxl_model_planes(model)); k++)
        density_move_plane(d, model->plane[k], count, new_count, fresh);
    for (int k = OXL_LOBE; model->lobes && k < OXL_PLANES; k++)
        memset(model->plane[k] + lobes, 0, (model->lobes - lobes) * sizeof(float));
    model->lobes = lobes;
    if (lobes == 0) model_drop_lobes(model);
    model->count = new_count;
    model_clear_rows(model, planes ? new_count : 0, model->capacity);
}

static void density_make_children(const struct density *d, oxl_model *model, size_t count)
{
    size_t at = 0;
    for (size_t i = 0; i < count; i++) {
        if (d->verdict[i] == OXL_REMOVE) continue;
        if (d->verdict[i] == OXL_SPLIT) {
            density_make_child(model, at++, -1);
            density_make_child(model, at, 1);
        }
        at++;
    }
}

/* Lets the caller's rule change the verdicts, but for rows that are not finite. */
static void density_ask(const oxl_terms *terms, struct density *d, const oxl_model *model)
{
    terms->density(terms->user, model, d->gradient, d->views, d->verdict);
    for (size_t i = 0; i < model->count; i++)
        if (!model_row_is_finite(model, i)) d->verdict[i] = OXL_REMOVE;
}

OXL_INTERNAL oxl_result density_decide(oxl_context *ctx, struct density *d, const oxl_model *model,
                                       const struct density_rules *rules, struct density_change *out)
{
    size_t room;
    *out = (struct density_change){0};
    if (d->banded) density_weigh(ctx, d, model->count, rules);
#pragma omp parallel for schedule(static) num_threads(ctx->threads)
    for (int64_t i = 0; i < (int64_t)model->count; i++)
        d->verdict[i] = (uint8_t)density_classify(d, model, (size_t)i, rules);
    if (rules->terms && rules->terms->density) density_ask(rules->terms, d, model);
    for (size_t i = 0; i < model->count; i++) {
        out->removed += d->verdict[i] == OXL_REMOVE;
        out->split += d->verdict[i] == OXL_SPLIT;
    }
    if (model->lobes > 0 && out->split > 0)
        return oxl_fail(ctx, OXL_ERR_USAGE,
                        "%zu of %zu Gaussians would be split while %zu have a second lobe", out->split,
                        model->count, model->lobes);
    room = rules->cap + out->removed > model->count ? rules->cap + out->removed - model->count : 0;
    if (rules->cap && out->split > room) out->split = density_cap(d, model->count, room);
    return OXL_OK;
}

OXL_INTERNAL oxl_result density_apply(oxl_context *ctx, struct density *d, struct trained_model *trained,
                                      const struct density_change *change, int moved)
{
    const size_t before = trained->model.count, count = before - change->removed + change->split;
    const int planes = moved ? 0 : OXL_PLANES;
    oxl_result rc = OXL_OK;
    if (change->removed + change->split > 0) {
        for (int k = 0; rc == OXL_OK && k < TRAINED_PARTS; k++)
            rc = model_reserve(ctx, model_trained_part(trained, k), count);
        if (rc != OXL_OK) return rc;
        density_rebuild(ctx, d, &trained->mean, count, 1, planes);
        density_rebuild(ctx, d, &trained->square, count, 1, planes);
        density_rebuild(ctx, d, &trained->model, count, 0, OXL_PLANES);
        density_make_children(d, &trained->model, before);
    }
    return density_clear(ctx, d, trained->model.count);
}

/* ---------------- reset */

OXL_INTERNAL void density_reset_opacity(struct trained_model *trained, float alpha_min)
{
    const float ceiling = (float)vecmath_logit(DENSITY_OPACITY_RESET * OXL_MAX(alpha_min, 1.0 / 255));
    const size_t count = trained->model.count;
    float *opacity = trained->model.plane[OXL_OPACITY];
    for (size_t i = 0; i < count; i++)
        if (opacity[i] > ceiling) opacity[i] = ceiling;
    memset(trained->mean.plane[OXL_OPACITY], 0, count * sizeof(float));
    memset(trained->square.plane[OXL_OPACITY], 0, count * sizeof(float));
}
