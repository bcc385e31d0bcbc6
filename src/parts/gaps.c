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
#include "../survey/image.h"
#include "../survey/scene.h"
#include "../survey/sparse.h"

enum {
    GAPS_ACROSS = 58,     /* cells along the longer side of a view */
    GAPS_PIXELS = 8,      /* of a reduced image, along a cell, at most */
    GAPS_REACH = 6,       /* cells: the farthest points that a cell's plane is fitted to */
    GAPS_PLACES = 4,      /* points found for each that may be added, at most */
    GAPS_NEIGHBOURS = 2,  /* views that a patch is compared with */
    GAPS_RADIUS = 3,      /* px of the reduced image: of a patch */
    GAPS_STEPS = 8,       /* tried nearer, and farther, than the plane */
    GAPS_GREYS = 16       /* reduced images that are kept */
};
#define GAPS_FRACTION 0.5
static double gaps_knob(const char *name, double value)
{
    const char *text = getenv(name);
    return text ? atof(text) : value;
}

struct gaps_cell { /* sums over the observed points in it */
    double count, inverse_z;
};

struct gaps_grey { /* an image, reduced */
    int view, width, height, factor;
    size_t used; /* the clock then */
    float *value; /* (H,W) levels; -1: masked */
};

struct gaps_plane { /* inverse depth, and its slopes per pixel of the reduced image */
    double w, dx, dy;
};

struct gaps_pair { /* rays of one camera as pixels of another: A ray + w b, up to scale */
    const struct gaps_grey *to;
    double a[9], b[3];
};

struct gaps {
    oxl_context *ctx;
    oxl_scene *scene;
    size_t *first;   /* (views + 1) where a view's points begin in `point` */
    uint32_t *point; /* points that each view observes */
    struct gaps_cell *cell;
    int *shared;                        /* (views) points that a view shares with the one at hand */
    struct gaps_grey grey[GAPS_GREYS];
    size_t clock;
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

/* ---------------- reduced images */

/* Means of factor x factor pixels of all channels; edges that do not fill one are dropped. */
static void gaps_reduce(const struct training_image *image, struct gaps_grey *grey)
{
    const size_t w = (size_t)image->width, plane = w * (size_t)image->height, f = (size_t)grey->factor;
    for (size_t y = 0; y < (size_t)grey->height; y++)
        for (size_t x = 0; x < (size_t)grey->width; x++) {
            int sum = 0, masked = 0;
            for (size_t k = 0; k < f * f; k++) {
                const size_t at = (y * f + k / f) * w + x * f + k % f;
                sum += image->rgb[at] + image->rgb[plane + at] + image->rgb[2 * plane + at];
                masked |= image->mask && !image->mask[at];
            }
            grey->value[y * (size_t)grey->width + x] = masked ? -1 : (float)sum / (float)(3 * f * f);
        }
}

/* Returns a view's reduced image, or NULL with an error set. */
static const struct gaps_grey *gaps_grey(struct gaps *g, int view)
{
    const oxl_camera *c = &oxl_scene_view(g->scene, view)->camera;
    struct gaps_grey *grey = g->grey;
    const struct training_image *image;
    for (int i = 0; i < GAPS_GREYS; i++) {
        if (g->grey[i].value && g->grey[i].view == view) {
            g->grey[i].used = ++g->clock;
            return &g->grey[i];
        }
        if (g->grey[i].used < grey->used) grey = &g->grey[i];
    }
    oxl_free(g->ctx, grey->value);
    *grey = (struct gaps_grey){.view = view, .used = ++g->clock};
    image = scene_image(g->ctx, g->scene, view);
    if (!image) return NULL;
    grey->factor = OXL_MAX(1, (int)ceil((double)OXL_MAX(c->width, c->height) / (GAPS_ACROSS * GAPS_PIXELS)));
    grey->width = image->width / grey->factor, grey->height = image->height / grey->factor;
    grey->value = oxl_alloc(g->ctx, (size_t)grey->width * (size_t)grey->height + 1, sizeof *grey->value);
    if (!grey->value) {
        oxl_fail(g->ctx, OXL_ERR_MEMORY, "no memory for a reduced image");
        return NULL;
    }
    gaps_reduce(image, grey);
    return grey;
}

/* ---------------- the cells of a view */

struct gaps_grid {
    const oxl_camera *camera;
    int across, down;
    double side; /* px: of a cell */
    const struct gaps_grey *grey;
    struct gaps_pair pair[GAPS_NEIGHBOURS];
    int pairs;
};

static void gaps_fill_cells(struct gaps *g, const struct gaps_grid *grid, int view)
{
    memset(g->cell, 0, (size_t)grid->across * (size_t)grid->down * sizeof *g->cell);
    for (size_t i = g->first[view]; i < g->first[view + 1]; i++) {
        double x[3], pixel[2];
        struct gaps_cell *cell;
        if (!scene_project_point(g->scene, view, g->point[i], x, pixel) || !(pixel[0] >= 0) ||
            !(pixel[1] >= 0) || !(pixel[0] < grid->camera->width) || !(pixel[1] < grid->camera->height))
            continue;
        cell = &g->cell[(size_t)(pixel[1] / grid->side) * (size_t)grid->across +
                        (size_t)(pixel[0] / grid->side)];
        cell->count++;
        cell->inverse_z += 1 / x[2];
    }
}

/* Fits inverse depth, which is linear in the image on a plane, to the cells around; returns 0 without any. */
static int gaps_fit(const struct gaps *g, const struct gaps_grid *grid, int x, int y, struct gaps_plane *out)
{
    const int reach = (int)gaps_knob("GAPS_REACH", GAPS_REACH);
    const double ridge = gaps_knob("GAPS_RIDGE", 1);
    double n = 0, sx = 0, sy = 0, sw = 0, sxx = 0, sxy = 0, syy = 0, sxw = 0, syw = 0, det;
    for (int dy = -reach; dy <= reach; dy++)
        for (int dx = -reach; dx <= reach; dx++) {
            const int column = x + dx, row = y + dy;
            const struct gaps_cell *cell;
            double weight, w;
            if (column < 0 || row < 0 || column >= grid->across || row >= grid->down || (!dx && !dy)) continue;
            cell = &g->cell[(size_t)row * (size_t)grid->across + (size_t)column];
            if (cell->count == 0) continue;
            weight = 1.0 / (dx * dx + dy * dy), w = cell->inverse_z / cell->count;
            n += weight, sx += weight * dx, sy += weight * dy, sw += weight * w;
            sxx += weight * dx * dx, sxy += weight * dx * dy, syy += weight * dy * dy;
            sxw += weight * dx * w, syw += weight * dy * w;
        }
    if (!(n > 0)) return 0;
    sxx += ridge - sx * sx / n, syy += ridge - sy * sy / n, sxy -= sx * sy / n;
    sxw -= sx * sw / n, syw -= sy * sw / n;
    det = sxx * syy - sxy * sxy;
    out->dx = (sxw * syy - syw * sxy) / det, out->dy = (syw * sxx - sxw * sxy) / det;
    out->w = (sw - out->dx * sx - out->dy * sy) / n;
    out->w = OXL_CLAMP(out->w, 0.5 * sw / n, 2 * sw / n);
    out->dx *= grid->grey->factor / grid->side, out->dy *= grid->grey->factor / grid->side;
    return 1;
}

/* ---------------- the sweep */

/* Samples a reduced image between its pixels; -1: outside, or masked. */
static double gaps_sample(const struct gaps_grey *grey, double x, double y)
{
    const double left = x - 0.5, top = y - 0.5;
    const float *v;
    size_t w = (size_t)grey->width;
    int column, row;
    double fx, fy;
    if (!(left >= 0) || !(top >= 0) || !(left < grey->width - 1) || !(top < grey->height - 1)) return -1;
    column = (int)left, row = (int)top, fx = left - column, fy = top - row;
    v = grey->value + (size_t)row * w + (size_t)column;
    if (v[0] < 0 || v[1] < 0 || v[w] < 0 || v[w + 1] < 0) return -1;
    return (1 - fy) * ((1 - fx) * v[0] + fx * v[1]) + fy * ((1 - fx) * v[w] + fx * v[w + 1]);
}

/* Makes the pixel of the other camera's reduced image for a ray (x/z, y/z, 1) at inverse depth w. */
static int gaps_transfer(const struct gaps_pair *pair, const double ray[2], double w, double pixel[2])
{
    double p[3];
    for (int k = 0; k < 3; k++)
        p[k] = pair->a[3 * k] * ray[0] + pair->a[3 * k + 1] * ray[1] + pair->a[3 * k + 2] + w * pair->b[k];
    if (!(p[2] > 1e-6)) return 0;
    pixel[0] = p[0] / p[2], pixel[1] = p[1] / p[2];
    return 1;
}

static void gaps_pair_cameras(const oxl_camera *from, const oxl_camera *to, struct gaps_pair *pair)
{
    const int f = pair->to->factor;
    double r[9], t[3];
    for (int i = 0; i < 3; i++) {
        t[i] = to->translation[i];
        for (int j = 0; j < 3; j++) {
            r[3 * i + j] = 0;
            for (int k = 0; k < 3; k++) r[3 * i + j] += to->rotation[3 * i + k] * from->rotation[3 * j + k];
            t[i] -= r[3 * i + j] * from->translation[j];
        }
    }
    for (int j = 0; j < 4; j++) {
        const double v[3] = {j < 3 ? r[j] : t[0], j < 3 ? r[3 + j] : t[1], j < 3 ? r[6 + j] : t[2]};
        const double out[3] = {(to->fx * v[0] + to->cx * v[2]) / f, (to->fy * v[1] + to->cy * v[2]) / f, v[2]};
        for (int i = 0; i < 3; i++) {
            if (j < 3) pair->a[3 * i + j] = out[i];
            else pair->b[i] = out[i];
        }
    }
}

/* Correlates a patch with another view's, at a plane; -2: it is not in that view. */
static double gaps_correlate(const struct gaps_grid *grid, const struct gaps_pair *pair, const double at[2],
                             const struct gaps_plane *plane)
{
    const oxl_camera *c = grid->camera;
    const int f = grid->grey->factor;
    double n = 0, sa = 0, sb = 0, saa = 0, sab = 0, sbb = 0, vaa, vbb;
    for (int dy = -GAPS_RADIUS; dy <= GAPS_RADIUS; dy++)
        for (int dx = -GAPS_RADIUS; dx <= GAPS_RADIUS; dx++) {
            const double x = at[0] + dx, y = at[1] + dy;
            const double ray[2] = {(x * f - c->cx) / c->fx, (y * f - c->cy) / c->fy};
            const double a = gaps_sample(grid->grey, x, y);
            double pixel[2], b;
            if (a < 0 || !gaps_transfer(pair, ray, plane->w + dx * plane->dx + dy * plane->dy, pixel)) return -2;
            b = gaps_sample(pair->to, pixel[0], pixel[1]);
            if (b < 0) return -2;
            n++, sa += a, sb += b, saa += a * a, sab += a * b, sbb += b * b;
        }
    vaa = saa - sa * sa / n, vbb = sbb - sb * sb / n;
    if (!(vaa > 0.02 * n) || !(vbb > 0.02 * n)) return 0;
    return (sab - sa * sb / n) / sqrt(vaa * vbb);
}

/* Mean over the views that see the patch; -2: none. */
static double gaps_agreement(const struct gaps_grid *grid, const double at[2], const struct gaps_plane *plane)
{
    double sum = 0;
    int seen = 0;
    for (int k = 0; k < grid->pairs; k++) {
        const double c = gaps_correlate(grid, &grid->pair[k], at, plane);
        if (c > -2) sum += c, seen++;
    }
    return seen ? sum / seen : -2;
}

/* Returns the relative change of inverse depth that moves the patch by a pixel in the view where it moves most. */
static double gaps_relative_step(const struct gaps_grid *grid, const double at[2], const struct gaps_plane *plane)
{
    const oxl_camera *c = grid->camera;
    const int f = grid->grey->factor;
    const double ray[2] = {(at[0] * f - c->cx) / c->fx, (at[1] * f - c->cy) / c->fy};
    double most = 0;
    for (int k = 0; k < grid->pairs; k++) {
        double p[2], q[2];
        if (!gaps_transfer(&grid->pair[k], ray, plane->w, p) ||
            !gaps_transfer(&grid->pair[k], ray, plane->w * 1.01, q))
            continue;
        most = OXL_MAX(most, (p[0] - q[0]) * (p[0] - q[0]) + (p[1] - q[1]) * (p[1] - q[1]));
    }
    return most > 0 ? 0.01 / sqrt(most) : 0;
}

/* Looks for the plane's depth at which the views agree best; returns that agreement. */
static double gaps_sweep(const struct gaps_grid *grid, const double at[2], struct gaps_plane *plane)
{
    const struct gaps_plane prior = *plane;
    const double range = gaps_knob("GAPS_RANGE", 0.15), step = OXL_MIN(gaps_knob("GAPS_STEP", 0.7) * gaps_relative_step(grid, at, &prior), range);
    const int most = (int)gaps_knob("GAPS_STEPS", GAPS_STEPS);
    double best = -2;
    if (!(step > 0)) return -2;
    for (int s = -most; s <= most; s++) {
        const double scale = 1 + s * step;
        const struct gaps_plane tried = {prior.w * scale, prior.dx * scale, prior.dy * scale};
        double agreement;
        if (s * step > range || s * step < -range) continue;
        agreement = gaps_agreement(grid, at, &tried);
        if (agreement > best) best = agreement, *plane = tried;
    }
    return best;
}

/* ---------------- a view */

static void gaps_colour(struct gaps *g, const struct gaps_grid *grid, int view, const double pixel[2], uint8_t rgb[3])
{
    const struct training_image *image = scene_image(g->ctx, g->scene, view);
    const size_t f = (size_t)grid->grey->factor, w = image ? (size_t)image->width : 0;
    const size_t x = (size_t)pixel[0] / f * f, y = (size_t)pixel[1] / f * f;
    for (int c = 0; c < 3 && image; c++) {
        size_t sum = 0;
        for (size_t k = 0; k < f * f; k++) sum += image->rgb[(size_t)c * w * (size_t)image->height + (y + k / f) * w + x + k % f];
        rgb[c] = (uint8_t)(sum / (f * f));
    }
}

static oxl_result gaps_add(struct gaps *g, const struct gaps_grid *grid, int view, int x, int y)
{
    const double pixel[2] = {(x + 0.5) * grid->side, (y + 0.5) * grid->side};
    const double at[2] = {pixel[0] / grid->grey->factor, pixel[1] / grid->grey->factor};
    struct gaps_plane plane;
    oxl_point point = {.error = -1};
    oxl_result rc;
    if (!gaps_fit(g, grid, x, y, &plane)) return OXL_OK;
    if (!(gaps_sweep(grid, at, &plane) >= gaps_knob("GAPS_NCC", 0.6))) return OXL_OK;
    camera_unproject(grid->camera, pixel, 1 / plane.w, NULL, point.position);
    gaps_colour(g, grid, view, pixel, point.rgb);
    if (2 * (g->used + 1) > g->slots || !gaps_take(g, gaps_place(g, point.position))) return OXL_OK;
    rc = oxl_reserve(g->ctx, &g->out, &g->capacity, g->count + 1, sizeof point);
    if (rc == OXL_OK) g->out[g->count++] = point;
    return rc;
}

static double gaps_baseline(const oxl_camera *a, const oxl_camera *b)
{
    double square = 0;
    for (int k = 0; k < 3; k++) {
        double d = 0;
        for (int i = 0; i < 3; i++)
            d += a->rotation[3 * i + k] * a->translation[i] - b->rotation[3 * i + k] * b->translation[i];
        square += d * d;
    }
    return sqrt(square);
}

/* Takes the views that share the most points, of those whose baseline gives parallax; `depth`: the view's mean. */
static oxl_result gaps_find_pairs(struct gaps *g, struct gaps_grid *grid, int view, double depth)
{
    const struct colmap *c = scene_colmap(g->scene);
    const int views = oxl_scene_view_count(g->scene);
    int *of_image = scene_views_by_image(g->ctx, g->scene, OXL_SPLIT_TRAIN);
    if (!of_image) return g->ctx->failed;
    memset(g->shared, 0, (size_t)views * sizeof *g->shared);
    for (size_t i = g->first[view]; i < g->first[view + 1]; i++) {
        const struct colmap_point *p = &c->point[g->point[i]];
        for (uint32_t k = 0; k < p->track_count; k++) {
            const int other = of_image[c->track[p->first_track + k].image_row];
            if (other >= 0) g->shared[other]++;
        }
    }
    oxl_free(g->ctx, of_image);
    for (int v = 0; v < views; v++) {
        const double angle = gaps_baseline(grid->camera, &oxl_scene_view(g->scene, v)->camera) / depth;
        if (v == view || !(angle > gaps_knob("GAPS_ANGLE", 0.03)) || !(angle < 0.6)) g->shared[v] = 0;
    }
    for (grid->pairs = 0; grid->pairs < GAPS_NEIGHBOURS; grid->pairs++) {
        int best = 0;
        for (int v = 1; v < views; v++)
            if (g->shared[v] > g->shared[best]) best = v;
        if (g->shared[best] == 0) break;
        g->shared[best] = 0;
        grid->pair[grid->pairs].to = gaps_grey(g, best);
        if (!grid->pair[grid->pairs].to) return g->ctx->failed;
        gaps_pair_cameras(grid->camera, &oxl_scene_view(g->scene, best)->camera, &grid->pair[grid->pairs]);
    }
    return OXL_OK;
}

static double gaps_mean_depth(const struct gaps *g, int cells)
{
    double count = 0, inverse = 0;
    for (int i = 0; i < cells; i++) count += g->cell[i].count, inverse += g->cell[i].inverse_z;
    return inverse > 0 ? count / inverse : 0;
}

static oxl_result gaps_of_view(struct gaps *g, int view)
{
    const oxl_camera *c = &oxl_scene_view(g->scene, view)->camera;
    const double side = (double)OXL_MAX(c->width, c->height) / GAPS_ACROSS;
    struct gaps_grid grid = {.camera = c,
                                   .across = (int)ceil(c->width / side - 1e-9),
                                   .down = (int)ceil(c->height / side - 1e-9),
                                   .side = side};
    oxl_result rc = OXL_OK;
    if (g->first[view] == g->first[view + 1]) return OXL_OK;
    gaps_fill_cells(g, &grid, view);
    rc = gaps_find_pairs(g, &grid, view, gaps_mean_depth(g, grid.across * grid.down));
    if (rc == OXL_OK && !(grid.grey = gaps_grey(g, view))) rc = g->ctx->failed;
    for (int y = 0; y < grid.down && grid.pairs > 0; y++)
        for (int x = 0; x < grid.across && rc == OXL_OK; x++)
            if (g->cell[y * grid.across + x].count == 0) rc = gaps_add(g, &grid, view, x, y);
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

OXL_INTERNAL oxl_result gaps_points(oxl_context *ctx, oxl_scene *scene, size_t most, oxl_point **out,
                                    size_t *count)
{
    const struct colmap *c = scene_colmap(scene);
    struct gaps g = {.ctx = ctx, .scene = scene, .side = gaps_side(scene)};
    oxl_result rc = OXL_OK;
    *out = NULL, *count = 0;
    if (most == 0 || !c || c->track_count == 0 || !(g.side > 0)) return OXL_OK;
    g.cell = oxl_alloc(ctx, (GAPS_ACROSS + 1) * (GAPS_ACROSS + 1), sizeof *g.cell);
    g.shared = oxl_alloc(ctx, (size_t)oxl_scene_view_count(scene) + 1, sizeof *g.shared);
    if (!g.cell || !g.shared) rc = oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for the cells of a view");
    if (rc == OXL_OK) rc = gaps_take_points(&g, GAPS_PLACES * most);
    if (rc == OXL_OK) rc = gaps_sort_tracks(&g);
    for (int i = 0; i < oxl_scene_view_count(scene) && rc == OXL_OK; i++)
        if (!oxl_scene_view(scene, i)->is_test) rc = gaps_of_view(&g, i);
    gaps_thin(&g, most);
    if (rc == OXL_OK) *out = g.out, *count = g.count;
    else oxl_free(ctx, g.out);
    for (int i = 0; i < GAPS_GREYS; i++) oxl_free(ctx, g.grey[i].value);
    oxl_free(ctx, g.shared);
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
