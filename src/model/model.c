/* model.c - creates, grows and copies planes of Gaussians, assigns second lobes, and initialises from points.
 *
 * Sources: Kerbl 2023 (initialisation); Morton 1966 (Z-order).
 *
 * Invariant: one allocation holds all planes, each `capacity` floats long. Capacity is a multiple of
 * MODEL_PACK, so each plane starts on a 64-byte line and kernels may read and write whole packs of rows up to
 * capacity. The planes of the second lobe follow, each at least as long as the packs of rows 0..lobes-1, and
 * are reached by their pointers alone. Rows from count to capacity are finite: model_clear_rows initialises
 * new rows, and a smaller count leaves valid rows.
 */
#include "../survey/survey.h"
#include "model.h"
#include "../core/vecmath.h"

/* ---------------- memory */

/* Bounds the distance of a scale from 1 that is rounding alone: factors that cancel each other leave it. */
#define MODEL_SCALE_ROUNDED 1e-12

enum { MODEL_PACK = 16 }; /* rows of a pack: 64 bytes of float, the widest vector */

int oxl_model_planes(const oxl_model *model)
{
    const int side = model->sh_degree + 1;
    return OXL_SH + 3 * side * side;
}

void oxl_model_move_origin(oxl_model *model, const double origin[3])
{
    for (int a = 0; a < 3; a++) {
        const double by = model->origin[a] - origin[a];
        float *x = model->plane[OXL_MEAN + a];
        for (size_t i = 0; by != 0 && i < model->count; i++) x[i] = (float)(x[i] + by);
        model->origin[a] = origin[a];
    }
}

void oxl_model_rescale(oxl_model *model, double factor)
{
    const float shift = (float)vecmath_log(factor);
    const double scale = (model->scale > 0 ? model->scale : 1) * factor;
    if (!(factor > 0 && factor <= DBL_MAX)) return;
    for (int a = 0; a < 3; a++) {
        model->origin[a] *= factor;
        model->view[10 + a] *= factor;
        for (size_t i = 0; i < model->count; i++) {
            model->plane[OXL_MEAN + a][i] *= (float)factor;
            model->plane[OXL_LOG_SCALE + a][i] += shift;
        }
    }
    model->scale = fabs(scale - 1) > MODEL_SCALE_ROUNDED ? scale : 0;
}

OXL_INTERNAL void model_clear_rows(oxl_model *model, size_t first, size_t end)
{
    if (end <= first) return;
    for (int p = 0; p < oxl_model_planes(model); p++)
        memset(model->plane[p] + first, 0, (end - first) * sizeof(float));
    for (size_t i = first; i < end; i++) model->plane[OXL_ROTATION][i] = 1;
    for (int p = OXL_LOBE; first < model->lobes && p < OXL_PLANES; p++)
        memset(model->plane[p] + first, 0, (OXL_MIN(end, model->lobes) - first) * sizeof(float));
}

static size_t model_whole_packs(size_t rows)
{
    return (rows + MODEL_PACK - 1) / MODEL_PACK * MODEL_PACK;
}

/* Rounds a plane to an odd number of cache lines, so that planes of 2^n rows do not map to the same cache
 * set; returns 0 for too many rows. */
static size_t model_capacity(size_t rows)
{
    if (rows >= SIZE_MAX / (OXL_PLANES * sizeof(float)) - 2 * MODEL_PACK) return 0;
    return (((rows + MODEL_PACK - 1) / MODEL_PACK) | 1) * MODEL_PACK;
}

/* Sets the second lobes' planes to `memory` and copies those of `from`. */
static void model_lay_out_lobes(oxl_model *m, float *memory, const oxl_model *from)
{
    const size_t rows = model_whole_packs(m->lobes), kept = OXL_MIN(m->lobes, from->lobes);
    for (int k = 0; m->lobes && k < MODEL_LOBE_PLANES; k++) {
        float *plane = m->plane[OXL_LOBE + k] = memory + (size_t)k * rows;
        if (kept) memcpy(plane, from->plane[OXL_LOBE + k], kept * sizeof *plane);
        memset(plane + kept, 0, (rows - kept) * sizeof *plane);
    }
}

OXL_INTERNAL void model_copy_rendering(const oxl_model *from, oxl_model *to)
{
    memcpy(to->background, from->background, sizeof to->background);
    to->has_background = from->has_background;
    to->antialias = from->antialias;
    memcpy(to->view, from->view, sizeof to->view);
}

/* Reallocates the model with another capacity, degree or number of lobes; on failure it is unchanged. */
static oxl_result model_lay_out(oxl_context *ctx, oxl_model *model, size_t capacity, int sh_degree,
                                size_t lobes)
{
    oxl_model m = {.count = model->count, .lobes = lobes, .sh_degree = sh_degree, .scale = model->scale};
    const int planes = oxl_model_planes(&m);
    const size_t rows = m.capacity = model_capacity(capacity), lobe = model_whole_packs(lobes);
    float *memory =
        oxl_alloc(ctx, rows ? rows * (size_t)planes + lobe * MODEL_LOBE_PLANES : SIZE_MAX, sizeof *memory);
    if (!memory) return OXL_ERR_MEMORY;
    m.memory = memory;
    memcpy(m.origin, model->origin, sizeof m.origin);
    model_copy_rendering(model, &m);
    for (int p = 0; p < planes; p++) {
        m.plane[p] = memory + (size_t)p * m.capacity;
        if (model->plane[p]) memcpy(m.plane[p], model->plane[p], m.count * sizeof(float));
        else memset(m.plane[p], 0, m.count * sizeof(float));
    }
    model_clear_rows(&m, m.count, m.capacity);
    model_lay_out_lobes(&m, memory + (size_t)planes * m.capacity, model);
    oxl_free(ctx, model->memory);
    *model = m;
    return OXL_OK;
}

static oxl_result model_check_degree(oxl_context *ctx, int sh_degree)
{
    if (sh_degree >= 0 && sh_degree <= 3) return OXL_OK;
    return oxl_fail(ctx, OXL_ERR_USAGE, "spherical harmonics of degree %d, expected 0 to 3", sh_degree);
}

oxl_result oxl_model_create(oxl_context *ctx, size_t count, int sh_degree, oxl_model *out)
{
    oxl_result rc;
    *out = (oxl_model){0};
    rc = model_check_degree(ctx, sh_degree);
    if (rc == OXL_OK) rc = model_lay_out(ctx, out, count, sh_degree, 0);
    if (rc == OXL_OK) out->count = count; /* model_lay_out has cleared these rows already */
    return rc;
}

void oxl_model_free(oxl_context *ctx, oxl_model *model)
{
    if (!model) return;
    oxl_free(ctx, model->memory);
    *model = (oxl_model){0};
}

/* Gives the model this capacity and degree: enlarges it in place, without a copy beside it, since training
 * grows to what memory holds. Planes move from the last to the first, so that none overwrites another. */
static oxl_result model_grow(oxl_context *ctx, oxl_model *model, size_t capacity, int sh_degree)
{
    const int planes = oxl_model_planes(model), all = oxl_model_planes(&(oxl_model){.sh_degree = sh_degree});
    const size_t old = model->capacity, wanted = model_capacity(capacity),
                 size = model->count * sizeof(float);
    float *memory;
    if (!model->memory || model->lobes > 0 || sh_degree < model->sh_degree || !wanted)
        return model_lay_out(ctx, model, capacity, sh_degree, model->lobes);
    memory = oxl_regrow(ctx, model->memory, old * (size_t)planes, wanted * (size_t)all, sizeof *memory);
    if (!memory) return OXL_ERR_MEMORY;
    model->memory = memory, model->capacity = wanted, model->sh_degree = sh_degree;
    for (int p = all - 1; p >= 0; p--) {
        model->plane[p] = memory + (size_t)p * wanted;
        if (p >= planes) memset(model->plane[p], 0, size);
        else if (wanted > old) memmove(model->plane[p], memory + (size_t)p * old, size);
    }
    model_clear_rows(model, model->count, wanted);
    return OXL_OK;
}

OXL_INTERNAL oxl_result model_reserve(oxl_context *ctx, oxl_model *model, size_t capacity)
{
    return capacity > model->capacity ? model_grow(ctx, model, capacity, model->sh_degree) : OXL_OK;
}

OXL_INTERNAL oxl_result model_set_degree(oxl_context *ctx, oxl_model *model, int sh_degree)
{
    const oxl_result rc = model_check_degree(ctx, sh_degree);
    if (rc != OXL_OK || sh_degree == model->sh_degree) return rc;
    return model_grow(ctx, model, model->capacity, sh_degree);
}

OXL_INTERNAL oxl_result model_copy(oxl_context *ctx, const oxl_model *from, oxl_model *to)
{
    oxl_result rc = oxl_model_create(ctx, from->count, from->sh_degree, to);
    if (rc == OXL_OK) rc = model_set_lobes(ctx, to, from->lobes);
    if (rc != OXL_OK) oxl_model_free(ctx, to);
    if (rc != OXL_OK) return rc;
    memcpy(to->origin, from->origin, sizeof to->origin);
    to->scale = from->scale;
    model_copy_rendering(from, to);
    for (int p = 0; p < oxl_model_planes(from) && from->count; p++)
        memcpy(to->plane[p], from->plane[p], from->count * sizeof(float));
    for (int p = OXL_LOBE; from->lobes && p < OXL_PLANES; p++)
        memcpy(to->plane[p], from->plane[p], from->lobes * sizeof(float));
    return OXL_OK;
}

/* ---------------- the second lobe */

OXL_INTERNAL oxl_result model_set_lobes(oxl_context *ctx, oxl_model *model, size_t lobes)
{
    if (lobes == model->lobes) return OXL_OK;
    if (lobes > model->count)
        return oxl_fail(ctx, OXL_ERR_USAGE, "%zu lobes for %zu Gaussians: expected at most one each", lobes,
                        model->count);
    return model_lay_out(ctx, model, model->capacity, model->sh_degree, lobes);
}

OXL_INTERNAL double model_row_bytes(int sh_degree)
{
    return 4.0 * (14 + 3 * (sh_degree + 1) * (sh_degree + 1));
}

OXL_INTERNAL void model_drop_lobes(oxl_model *model)
{
    model->lobes = 0;
    for (int p = OXL_LOBE; p < OXL_PLANES; p++) model->plane[p] = NULL;
}

static size_t model_keep_in_plane(float *plane, size_t count, const uint8_t *keep)
{
    size_t kept = 0;
    for (size_t i = 0; i < count; i++)
        if (keep[i]) plane[kept++] = plane[i];
    return kept;
}

OXL_INTERNAL void model_keep_rows(oxl_model *model, const uint8_t *keep)
{
    const int planes = oxl_model_planes(model);
    const size_t count = model->count, lobes = model->lobes;
    size_t kept = 0;
    for (int p = OXL_LOBE; lobes && p < OXL_PLANES; p++) {
        kept = model_keep_in_plane(model->plane[p], lobes, keep);
        memset(model->plane[p] + kept, 0, (lobes - kept) * sizeof(float));
    }
    model->lobes = kept;
    if (kept == 0) model_drop_lobes(model);
    for (int p = 0; p < planes; p++) model->count = model_keep_in_plane(model->plane[p], count, keep);
    model_clear_rows(model, model->count, count);
}

OXL_INTERNAL int model_row_is_finite(const oxl_model *m, size_t i)
{
    float sum = 0; /* 0 x finite is 0; 0 x inf and 0 x nan are not */
    for (int k = 0; k < oxl_model_planes(m); k++) sum += 0 * m->plane[k][i];
    for (int k = OXL_LOBE; i < m->lobes && k < OXL_PLANES; k++) sum += 0 * m->plane[k][i];
    return sum == 0;
}

/* Moves active rows to the front; both parts keep their order. other: (count) scratch. */
static void model_active_first(oxl_model *model, const uint8_t *active, float *other)
{
    for (int p = 0; p < oxl_model_planes(model); p++) {
        float *plane = model->plane[p];
        size_t front = 0, back = 0;
        for (size_t i = 0; i < model->count; i++) {
            if (active[i]) plane[front++] = plane[i];
            else other[back++] = plane[i];
        }
        if (back) memcpy(plane + front, other, back * sizeof *plane);
    }
}

/* Moves the rows whose active (count) is not 0 to the front, both parts in their order, and gives them second
 * lobes of zeros. The model must have no lobes. */
static oxl_result model_make_lobes(oxl_context *ctx, oxl_model *model, const uint8_t *active)
{
    size_t lobes = 0;
    float *other;
    oxl_result rc;
    if (model->lobes > 0)
        return oxl_fail(ctx, OXL_ERR_USAGE, "the model has %zu second lobes already", model->lobes);
    for (size_t i = 0; i < model->count; i++) lobes += active[i] != 0;
    other = oxl_alloc(ctx, model->count + 1, sizeof *other);
    if (!other) return OXL_ERR_MEMORY;
    rc = model_set_lobes(ctx, model, lobes);
    if (rc == OXL_OK) model_active_first(model, active, other);
    oxl_free(ctx, other);
    return rc;
}

/* ---------------- with Adam's moments */

OXL_INTERNAL oxl_model *model_trained_part(struct trained_model *t, int k)
{
    return k == 0 ? &t->model : k == 1 ? &t->mean : &t->square;
}

OXL_INTERNAL oxl_result model_trained_begin(oxl_context *ctx, struct trained_model *t)
{
    oxl_result rc = OXL_OK;
    for (int k = 1; rc == OXL_OK && k < TRAINED_PARTS; k++) {
        oxl_model *moment = model_trained_part(t, k);
        rc = oxl_model_create(ctx, t->model.count, t->model.sh_degree, moment);
        if (rc == OXL_OK) rc = model_set_lobes(ctx, moment, t->model.lobes);
        if (rc == OXL_OK) memset(moment->plane[OXL_ROTATION], 0, moment->capacity * sizeof(float));
    }
    return rc;
}

OXL_INTERNAL void model_trained_free(oxl_context *ctx, struct trained_model *t)
{
    for (int k = 0; k < TRAINED_PARTS; k++) oxl_model_free(ctx, model_trained_part(t, k));
}

OXL_INTERNAL oxl_result model_trained_set_degree(oxl_context *ctx, struct trained_model *t, int sh_degree)
{
    oxl_result rc = OXL_OK;
    for (int k = 0; rc == OXL_OK && k < TRAINED_PARTS; k++)
        rc = model_set_degree(ctx, model_trained_part(t, k), sh_degree);
    return rc;
}

OXL_INTERNAL oxl_result model_trained_make_lobes(oxl_context *ctx, struct trained_model *t,
                                                 const uint8_t *active, float opacity_factor,
                                                 float scale_factor)
{
    oxl_result rc = OXL_OK;
    for (int k = 0; rc == OXL_OK && k < TRAINED_PARTS; k++)
        rc = model_make_lobes(ctx, model_trained_part(t, k), active);
    for (size_t i = 0; rc == OXL_OK && i < t->model.lobes; i++)
        for (int k = 0; k < MODEL_LOBE_PLANES; k++)
            t->model.plane[OXL_LOBE + k][i] =
                (float)(k == 0 ? vecmath_logit(opacity_factor) : vecmath_log(scale_factor));
    return rc;
}

/* ---------------- start from points: rows in Z-order
 *
 * Kernels work on packs of neighbouring rows and skip those out of view: rows near in memory should be near
 * in space.
 */

struct model_key {
    uint64_t code; /* Morton code, 21 bits per axis, interleaved */
    const oxl_point *point;
};

static int model_compare_places(const struct model_key *x, const struct model_key *y)
{
    const double *p = x->point->position, *q = y->point->position;
    for (int a = 0; a < 3; a++)
        if (p[a] != q[a]) return p[a] < q[a] ? -1 : 1;
    return 0;
}

/* Compares by Morton code, then by place, then by row, so that the order is unique. */
static int model_compare_keys(const void *a, const void *b)
{
    const struct model_key *x = a, *y = b;
    const int c = x->code != y->code ? (x->code < y->code ? -1 : 1) : model_compare_places(x, y);
    return c ? c : (x->point > y->point) - (x->point < y->point);
}

static uint64_t model_spread_bits(uint64_t x) /* moves bit i to bit 3 i, for 21 bits */
{
    x = (x | x << 32) & UINT64_C(0x001F00000000FFFF);
    x = (x | x << 16) & UINT64_C(0x001F0000FF0000FF);
    x = (x | x << 8) & UINT64_C(0x100F00F00F00F00F);
    x = (x | x << 4) & UINT64_C(0x10C30C30C30C30C3);
    x = (x | x << 2) & UINT64_C(0x1249249249249249);
    return x;
}

/* Finds the box around points: low x y z, high x y z. */
static void model_bound(const struct model_key *key, size_t count, double box[6])
{
    for (int a = 0; a < 3; a++) {
        box[a] = box[3 + a] = key[0].point->position[a];
        for (size_t i = 1; i < count; i++) {
            box[a] = OXL_MIN(box[a], key[i].point->position[a]);
            box[3 + a] = OXL_MAX(box[3 + a], key[i].point->position[a]);
        }
    }
}

/* Sorts points by the Morton code of cubic cells, 2^21 along the longest side of the bounding box. */
static void model_sort_by_code(const oxl_point *points, size_t count, struct model_key *key)
{
    double box[6], side = 0;
    for (size_t i = 0; i < count; i++) key[i] = (struct model_key){0, &points[i]};
    model_bound(key, count, box);
    for (int a = 0; a < 3; a++) side = OXL_MAX(side, box[3 + a] - box[a]);
    for (size_t i = 0; i < count; i++)
        for (int a = 0; a < 3 && side > 0; a++) {
            const double cell = (points[i].position[a] - box[a]) / side * 2097151.0; /* 2^21 - 1 */
            key[i].code |= model_spread_bits((uint64_t)cell) << a;
        }
    qsort(key, count, sizeof *key, model_compare_keys);
}

/* Keeps the first of points at the same place and returns the number of points kept: a million points at one
 * place would be a million Gaussians of unit width, each in every pixel. */
static size_t model_drop_coincident(struct model_key *key, size_t count)
{
    size_t kept = 0;
    for (size_t i = 0; i < count; i++)
        if (kept == 0 || model_compare_places(&key[i], &key[kept - 1]) != 0) key[kept++] = key[i];
    return kept;
}

/* ---------------- start from points: the 3 nearest neighbours
 *
 * Points in Z-order need no other tree: the halves of their list, and the halves of these, are near in space,
 * so each has a box, which shows whether it can hold a neighbour. Node k has the nodes 2 k and 2 k + 1.
 */

enum { MODEL_LEAF = 8, MODEL_NEIGHBOURS = 3 };

struct model_tree {
    struct model_key *key; /* (count) in Z-order */
    double (*box)[6];      /* (count / 2 + 2) of the nodes, from 1 */
    size_t count;
};

static void model_build_tree(const struct model_tree *tree, size_t node, size_t first, size_t end)
{
    const size_t middle = first + (end - first) / 2;
    model_bound(tree->key + first, end - first, tree->box[node]);
    if (end - first <= MODEL_LEAF) return;
    model_build_tree(tree, 2 * node, first, middle);
    model_build_tree(tree, 2 * node + 1, middle, end);
}

/* Holds squared distances in ascending order, so that their sum does not depend on the search order. */
struct model_nearest {
    const double *x;
    size_t self;
    double distance[MODEL_NEIGHBOURS];
};

/* Returns the square of the distance to a box, which rounding does not make more than that to a point in it;
 * a point is a box, too. */
static double model_distance(const struct model_nearest *n, const double low[3], const double high[3])
{
    double sum = 0;
    for (int a = 0; a < 3; a++) {
        const double off = n->x[a] - OXL_CLAMP(n->x[a], low[a], high[a]);
        sum += off * off;
    }
    return sum;
}

static void model_update_nearest(struct model_nearest *n, const double x[3])
{
    double d = model_distance(n, x, x);
    for (int k = 0; k < MODEL_NEIGHBOURS; k++)
        if (d < n->distance[k]) OXL_SWAP(double, d, n->distance[k]);
}

/* Searches the half first that is nearer in Z-order. */
static void model_search_nearest(const struct model_tree *tree, size_t node, size_t first, size_t end,
                                 struct model_nearest *n)
{
    const size_t middle = first + (end - first) / 2;
    const double *box = tree->box[node];
    if (model_distance(n, box, box + 3) >= n->distance[MODEL_NEIGHBOURS - 1]) return;
    for (size_t i = first; i < end && end - first <= MODEL_LEAF; i++)
        if (i != n->self) model_update_nearest(n, tree->key[i].point->position);
    if (end - first <= MODEL_LEAF) return;
    if (n->self < middle) model_search_nearest(tree, 2 * node, first, middle, n);
    model_search_nearest(tree, 2 * node + 1, middle, end, n);
    if (n->self >= middle) model_search_nearest(tree, 2 * node, first, middle, n);
}

/* Computes square (count), the mean squared distance to the nearest three points, or to fewer if there are
 * fewer; 0 for a single point. */
static void model_neighbour_distances(oxl_context *ctx, const struct model_tree *tree, double *square)
{
    const int neighbours = (int)OXL_MIN(tree->count - 1, (size_t)MODEL_NEIGHBOURS);
    const int64_t count = (int64_t)tree->count;
    model_build_tree(tree, 1, 0, tree->count);
#pragma omp parallel for num_threads(ctx->threads) schedule(dynamic, 1024)
    for (int64_t i = 0; i < count; i++) {
        struct model_nearest n = {
            .x = tree->key[i].point->position, .self = (size_t)i, .distance = {INFINITY, INFINITY, INFINITY}};
        double sum = 0;
        model_search_nearest(tree, 1, 0, tree->count, &n);
        for (int k = 0; k < neighbours; k++) sum += n.distance[k];
        square[i] = neighbours ? sum / neighbours : 0;
    }
    (void)ctx;
}

/* ---------------- start from points: the rows */

/* Bounds a squared width from below, as a fraction of the median's (model_widths). */
#define MODEL_SQUARE_MIN 1e-4

/* Replaces mean squared distances by log widths, in place. Almost coincident points would have almost width
 * 0: 3DGS limits the square to 1e-7; our unit is arbitrary, so the limit is 1 % of the median width. A single
 * point has width 1. */
static oxl_result model_widths(oxl_context *ctx, double *square, size_t count)
{
    double *apart = oxl_alloc(ctx, count, sizeof *apart), least = 1;
    size_t n = 0;
    if (!apart) return OXL_ERR_MEMORY;
    for (size_t i = 0; i < count; i++)
        if (square[i] > 0) apart[n++] = square[i];
    if (n) least = OXL_MAX(MODEL_SQUARE_MIN * stats_select(apart, n, 0.5), DBL_MIN);
    oxl_free(ctx, apart);
    for (size_t i = 0; i < count; i++) square[i] = 0.5 * vecmath_log(OXL_MAX(square[i], least));
    return OXL_OK;
}

static oxl_result model_check_points(oxl_context *ctx, const oxl_point *points, size_t count)
{
    for (size_t i = 0; i < count; i++)
        for (int a = 0; a < 3; a++)
            if (!(fabs(points[i].position[a]) <= FLT_MAX))
                return oxl_fail(
                    ctx, OXL_ERR_INPUT,
                    "point %zu of %zu: coordinate %d is %g, expected a finite number\nfix: remove it", i,
                    count, a, points[i].position[a]);
    return OXL_OK;
}

/* Fills row i of the model from key[i].point; width: (count) log widths. */
static void model_fill(oxl_model *model, const struct model_key *key, const double *width)
{
    const float opacity = (float)vecmath_logit(MODEL_OPACITY);
    for (size_t i = 0; i < model->count; i++) {
        const oxl_point *p = key[i].point;
        for (int a = 0; a < 3; a++) {
            model->plane[OXL_MEAN + a][i] = (float)p->position[a];
            model->plane[OXL_LOG_SCALE + a][i] = (float)width[i];
            model->plane[OXL_SH + a][i] = (float)((p->rgb[a] / 255.0 - 0.5) / MODEL_SH0);
        }
        model->plane[OXL_OPACITY][i] = opacity;
    }
}

oxl_result oxl_model_from_points(oxl_context *ctx, const oxl_point *points, size_t count, int sh_degree,
                                 oxl_model *out)
{
    struct model_tree tree = {.key = oxl_alloc(ctx, count + 1, sizeof *tree.key),
                              .box = oxl_alloc(ctx, count / 2 + 2, sizeof *tree.box)};
    double *width = oxl_alloc(ctx, count + 1, sizeof *width);
    oxl_result rc = tree.key && tree.box && width ? model_check_points(ctx, points, count) : OXL_ERR_MEMORY;
    *out = (oxl_model){0};
    if (rc == OXL_OK && count > 0) model_sort_by_code(points, count, tree.key);
    if (rc == OXL_OK) tree.count = model_drop_coincident(tree.key, count);
    if (rc == OXL_OK) rc = oxl_model_create(ctx, tree.count, sh_degree, out);
    if (rc == OXL_OK && count > 0) model_neighbour_distances(ctx, &tree, width);
    if (rc == OXL_OK && count > 0) rc = model_widths(ctx, width, tree.count);
    if (rc == OXL_OK) model_fill(out, tree.key, width);
    OXL_FREE(ctx, width, tree.box, tree.key);
    if (rc != OXL_OK) oxl_model_free(ctx, out);
    return rc;
}

OXL_INTERNAL void model_scale_colour(oxl_model *model, const double factor[3])
{
    for (int k = 0; k < (model->sh_degree + 1) * (model->sh_degree + 1); k++)
        for (int c = 0; c < 3; c++) {
            float *plane = model->plane[OXL_SH + 3 * k + c];
            const double more = k == 0 ? (factor[c] - 1) * 0.5 / MODEL_SH0 : 0;
            for (size_t i = 0; i < model->count; i++) plane[i] = (float)(factor[c] * plane[i] + more);
        }
}
