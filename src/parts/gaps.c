/* gaps.c - adds points to start from where a training view has pixels that no point of the survey explains.
 *
 * Structure from motion finds few points on faint or repetitive ground. Density control reaches such a region
 * late, by splitting a few broad Gaussians from its rim, and until then the views show a glow. So each
 * training view is divided into cells; a cell without a point that the view observes gets one, if observed
 * points are within GAPS_REACH cells: its inverse depth, which is linear in the image on a plane, and its
 * colour are their mean, weighted by the inverse square of the distance. Farther ones would be guesses:
 * without parallax to correct them they cost held-out views more than they give (docs/log/GAPS.md).
 * A point is dropped where the space already has one, of the survey or of an earlier view. At most
 * GAPS_FRACTION of the Gaussians that may still be added begin this way, so that density control has the rest.
 *
 * Invariant: a function of the scene alone. Without tracks nothing is added.
 */
#include "gaps.h"
#include "../train/part.h"
#include "../core/option_rows.h"
#include "../survey/scene.h"
#include "../survey/sparse.h"

enum {
    GAPS_ACROSS = 58, /* cells along the longer side of a view */
    GAPS_REACH = 2,   /* cells: the farthest points that a cell is interpolated from */
    GAPS_PLACES = 4   /* points found for each that may be added, at most */
};
#define GAPS_FRACTION 0.5

struct gaps_cell { /* sums over the observed points in it */
    double count, inverse_z, rgb[3];
};

struct gaps {
    oxl_context *ctx;
    const oxl_scene *scene;
    size_t *first;   /* (views + 1) where a view's points begin in `point` */
    uint32_t *point; /* points that each view observes */
    struct gaps_cell *cell;
    uint64_t *taken; /* (slots) hash set of the places that have a point; 0: free */
    size_t slots, used;
    double side; /* world: of a place */
    oxl_point *out;
    size_t count, capacity;
};

/* ---------------- places */

static uint64_t gaps_place(const struct gaps *g, const double x[3])
{
    uint64_t key = CHECKSUM_SEED;
    for (int k = 0; k < 3; k++) {
        const int64_t at = (int64_t)floor(OXL_CLAMP(x[k] / g->side, -1e15, 1e15));
        key = checksum_add(key, &at, sizeof at);
    }
    return key ? key : 1;
}

/* Returns 1 if the key was not in the set, and adds it. */
static int gaps_take(struct gaps *g, uint64_t key)
{
    size_t slot = (size_t)(key % g->slots);
    for (; g->taken[slot]; slot = (slot + 1) % g->slots)
        if (g->taken[slot] == key) return 0;
    g->taken[slot] = key;
    g->used++;
    return 1;
}

static oxl_result gaps_take_points(struct gaps *g, size_t room)
{
    const oxl_point *points = oxl_scene_points(g->scene);
    const size_t count = oxl_scene_point_count(g->scene);
    g->slots = 2 * (count + room) + 1;
    g->taken = oxl_calloc(g->ctx, g->slots, sizeof *g->taken);
    if (!g->taken) return oxl_fail(g->ctx, OXL_ERR_MEMORY, "no memory for the places of %zu points", count);
    for (size_t i = 0; i < count; i++) gaps_take(g, gaps_place(g, points[i].position));
    return OXL_OK;
}

/* ---------------- the points of each view */

static oxl_result gaps_sort_tracks(struct gaps *g)
{
    const struct colmap *c = scene_colmap(g->scene);
    const size_t views = (size_t)oxl_scene_view_count(g->scene);
    int *view = scene_views_by_image(g->ctx, g->scene, OXL_SPLIT_TRAIN);
    if (!view) return g->ctx->failed;
    g->first = oxl_calloc(g->ctx, views + 2, sizeof *g->first);
    g->point = oxl_alloc(g->ctx, c->track_count + 1, sizeof *g->point);
    if (!g->first || !g->point) {
        oxl_free(g->ctx, view);
        return oxl_fail(g->ctx, OXL_ERR_MEMORY, "no memory for %zu observations", c->track_count);
    }
    for (int pass = 0; pass < 2; pass++) { /* counts, then fills */
        for (size_t i = 0; i < c->point_count; i++)
            for (uint32_t k = 0; k < c->point[i].track_count; k++) {
                const int v = view[c->track[c->point[i].first_track + k].image_row];
                if (v < 0 || !scene_accepts_point(&c->point[i], oxl_scene_origin(g->scene))) continue;
                if (pass == 0) g->first[v + 2]++;
                else g->point[g->first[v + 1]++] = (uint32_t)i;
            }
        for (size_t v = 0; pass == 0 && v < views; v++) g->first[v + 2] += g->first[v + 1];
    }
    oxl_free(g->ctx, view);
    return OXL_OK;
}

/* ---------------- the cells of a view */

struct gaps_grid {
    const oxl_camera *camera;
    int across, down;
    double side; /* px: of a cell */
};

static void gaps_fill_cells(struct gaps *g, const struct gaps_grid *grid, int view)
{
    memset(g->cell, 0, (size_t)grid->across * (size_t)grid->down * sizeof *g->cell);
    for (size_t i = g->first[view]; i < g->first[view + 1]; i++) {
        const struct colmap_point *from = &scene_colmap(g->scene)->point[g->point[i]];
        double x[3], pixel[2];
        struct gaps_cell *cell;
        if (!scene_project_point(g->scene, view, g->point[i], x, pixel) || !(pixel[0] >= 0) ||
            !(pixel[1] >= 0) || !(pixel[0] < grid->camera->width) || !(pixel[1] < grid->camera->height))
            continue;
        cell = &g->cell[(size_t)(pixel[1] / grid->side) * (size_t)grid->across +
                        (size_t)(pixel[0] / grid->side)];
        cell->count++;
        cell->inverse_z += 1 / x[2];
        for (int k = 0; k < 3; k++) cell->rgb[k] += from->rgb[k];
    }
}

/* The weighted mean of the cells within GAPS_REACH; count: 0 where they hold no points. */
static struct gaps_cell gaps_interpolate(const struct gaps *g, const struct gaps_grid *grid, int x, int y)
{
    struct gaps_cell mean = {0};
    for (int dy = -GAPS_REACH; dy <= GAPS_REACH; dy++)
        for (int dx = -GAPS_REACH; dx <= GAPS_REACH; dx++) {
            const int column = x + dx, row = y + dy;
            const struct gaps_cell *cell;
            double weight;
            if (column < 0 || row < 0 || column >= grid->across || row >= grid->down || (!dx && !dy)) continue;
            cell = &g->cell[(size_t)row * (size_t)grid->across + (size_t)column];
            weight = 1.0 / (dx * dx + dy * dy);
            mean.count += weight * cell->count;
            mean.inverse_z += weight * cell->inverse_z;
            for (int k = 0; k < 3; k++) mean.rgb[k] += weight * cell->rgb[k];
        }
    return mean;
}

static oxl_result gaps_add(struct gaps *g, const struct gaps_grid *grid, int x, int y)
{
    const struct gaps_cell mean = gaps_interpolate(g, grid, x, y);
    const double pixel[2] = {(x + 0.5) * grid->side, (y + 0.5) * grid->side};
    oxl_point point = {.error = -1};
    oxl_result rc;
    if (!(mean.inverse_z > 0)) return OXL_OK;
    camera_unproject(grid->camera, pixel, mean.count / mean.inverse_z, NULL, point.position);
    for (int k = 0; k < 3; k++) point.rgb[k] = (uint8_t)(mean.rgb[k] / mean.count + 0.5);
    if (2 * (g->used + 1) > g->slots || !gaps_take(g, gaps_place(g, point.position))) return OXL_OK;
    rc = oxl_reserve(g->ctx, &g->out, &g->capacity, g->count + 1, sizeof point);
    if (rc == OXL_OK) g->out[g->count++] = point;
    return rc;
}

static oxl_result gaps_of_view(struct gaps *g, int view)
{
    const oxl_camera *c = &oxl_scene_view(g->scene, view)->camera;
    const double side = (double)OXL_MAX(c->width, c->height) / GAPS_ACROSS;
    const struct gaps_grid grid = {.camera = c,
                                   .across = (int)ceil(c->width / side - 1e-9),
                                   .down = (int)ceil(c->height / side - 1e-9),
                                   .side = side};
    oxl_result rc = OXL_OK;
    if (g->first[view] == g->first[view + 1]) return OXL_OK;
    gaps_fill_cells(g, &grid, view);
    for (int y = 0; y < grid.down; y++)
        for (int x = 0; x < grid.across && rc == OXL_OK; x++)
            if (g->cell[y * grid.across + x].count == 0) rc = gaps_add(g, &grid, x, y);
    return rc;
}

/* ---------------- the part */

/* Of a median depth: what a cell covers there. */
static double gaps_side(const oxl_scene *scene)
{
    const oxl_camera *c = &oxl_scene_view(scene, 0)->camera;
    return scene_depth_quantile(scene, 0.5) * OXL_MAX(c->width, c->height) / GAPS_ACROSS / c->fx;
}

/* Keeps `most` of the points, evenly. */
static void gaps_thin(struct gaps *g, size_t most)
{
    const size_t count = g->count;
    if (count <= most) return;
    for (size_t i = 0; i < most; i++) g->out[i] = g->out[(size_t)((double)i * (double)count / (double)most)];
    g->count = most;
}

OXL_INTERNAL oxl_result gaps_points(oxl_context *ctx, const oxl_scene *scene, size_t most, oxl_point **out,
                                    size_t *count)
{
    const struct colmap *c = scene_colmap(scene);
    struct gaps g = {.ctx = ctx, .scene = scene, .side = gaps_side(scene)};
    oxl_result rc = OXL_OK;
    *out = NULL, *count = 0;
    if (most == 0 || !c || c->track_count == 0 || !(g.side > 0)) return OXL_OK;
    g.cell = oxl_alloc(ctx, (GAPS_ACROSS + 1) * (GAPS_ACROSS + 1), sizeof *g.cell);
    if (!g.cell) rc = oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for the cells of a view");
    if (rc == OXL_OK) rc = gaps_take_points(&g, GAPS_PLACES * most);
    if (rc == OXL_OK) rc = gaps_sort_tracks(&g);
    for (int i = 0; i < oxl_scene_view_count(scene) && rc == OXL_OK; i++)
        if (!oxl_scene_view(scene, i)->is_test) rc = gaps_of_view(&g, i);
    gaps_thin(&g, most);
    if (rc == OXL_OK) *out = g.out, *count = g.count;
    else oxl_free(ctx, g.out);
    oxl_free(ctx, g.cell);
    oxl_free(ctx, g.taken);
    oxl_free(ctx, g.first);
    oxl_free(ctx, g.point);
    return rc;
}

static oxl_result gaps_first_points(struct train *t, oxl_point **out, size_t *count)
{
    const size_t points = oxl_scene_point_count(t->scene), cap = schedule_gaussian_cap(t->scene, t->options),
                 room = cap > points ? (size_t)(GAPS_FRACTION * (double)(cap - points)) : 0;
    const oxl_result rc = gaps_points(t->ctx, t->scene, t->options->gaps ? room : 0, out, count);
    if (rc == OXL_OK && *count > 0)
        oxl_log(t->ctx, OXL_LOG_INFO, "%zu points added where views have pixels without one", *count);
    return rc;
}

/* clang-format off */
static const oxl_option gaps_options[] = {
{"gaps", "off|on", OXL_OPTION_CHOICE, OPTION_AT(train.gaps), 0, 1, PRESETS("on", "on", "off"), OXL_TIER_ADVANCED, TRAINING | RESULT | NOT_REFINED, "Scene content", "start with Gaussians also where a view has no point nearby, from the depths around: structure on faint ground after half of the iterations", NULL},
{0}};
/* clang-format on */

OXL_INTERNAL const struct part part_gaps = {
    .name = "gaps", .option = gaps_options, .first_points = gaps_first_points};
