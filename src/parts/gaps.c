/* gaps.c - adds points to start from where a training view has pixels that no point of the survey explains.
 *
 * Structure from motion finds few points on faint or repetitive ground. Density control reaches such a
 * region late, by splitting a few broad Gaussians from its rim, and until then the views show a glow. So
 * each training view is divided into cells, and for one without a point that the view observes the depth is
 * looked for by a plane sweep [Collins 1996]: a plane in inverse depth, fitted to the points within
 * GAPS_REACH cells, is moved towards the camera and away from it, and at each step a patch of the view is
 * correlated with what two other views show of it, those that share most points with it. Correlation does
 * not depend on gains and lamp. Where it reaches GAPS_AGREES at the best depth there is a surface, and the
 * cell gets a point, in the colour of its pixels; elsewhere it gets none, since what only the points around
 * it say is wrong as often as right (docs/log/IMAGING.md). Images are reduced so that a cell has
 * GAPS_PIXELS. A point is dropped where the space already has one, of the survey or of an earlier view. At
 * most GAPS_FRACTION of the Gaussians that may still be added begin so; density control has the rest.
 *
 * Invariant: a function of the scene alone, views and cells in order. Without tracks nothing is added.
 */
#include "gaps.h"
#include "../train/part.h"
#include "../core/option_rows.h"
#include "../survey/image.h"
#include "../survey/scene.h"
#include "../survey/sparse.h"
#include "../survey/tracks.h"

enum {
    GAPS_ACROSS = 58,    /* cells along the longer side of a view */
    GAPS_PIXELS = 8,     /* of a reduced image, along a cell, at most */
    GAPS_REACH = 6,      /* cells: the farthest points that a cell's plane is fitted to */
    GAPS_PLACES = 4,     /* points found for each that may be added, at most */
    GAPS_NEIGHBOURS = 2, /* views that a patch is compared with */
    GAPS_RADIUS = 3,     /* px of the reduced image: of a patch, */
    GAPS_SIDE = 2 * GAPS_RADIUS + 1,
    GAPS_SAMPLES = GAPS_SIDE * GAPS_SIDE,
    GAPS_STEPS = 8, /* tried nearer, and farther, than the plane */
    GAPS_GREYS = 8  /* reduced images that are kept */
};
#define GAPS_FRACTION 0.5     /* of the Gaussians that may be added */
#define GAPS_STEP 0.7         /* px that a step of depth moves a patch in the other view, and */
#define GAPS_RANGE 0.15       /* the largest change of inverse depth, as a fraction */
#define GAPS_AGREES 0.7       /* correlation of patches that show one place */
#define GAPS_ROUNDING 1e-6    /* beyond what a correlation of 1 is rounded by */
#define GAPS_DETAIL 0.14      /* levels: standard deviation of a patch that shows something */
#define GAPS_RIDGE 1.0        /* pull of a plane's slopes to 0, in cells at any distance */
#define GAPS_ANGLE_LEAST 0.03 /* rad: between two views of a place, so that depth moves it, */
#define GAPS_ANGLE_MOST 0.6   /* and so that it looks the same */

struct gaps_cell { /* sums over the observed points in it, and their mean inverse depth */
    double count, inverse_z, mean;
};

struct gaps_grey { /* an image, reduced */
    int view, width, height, factor;
    size_t used;  /* the clock then */
    float *value; /* (H,W) levels; NaN: masked */
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
    const oxl_scene *scene;
    int *view_of;    /* (images) training views, by the image they come from */
    size_t *first;   /* (views + 1) where a view's points begin in `point` */
    uint32_t *point; /* points that each view observes */
    struct gaps_cell *cell;
    double weight[2 * GAPS_REACH + 1][2 * GAPS_REACH + 1]; /* of a cell so far away, in a plane's fit */
    int *shared; /* (views) points that a view shares with the one at hand */
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

/* Returns the key's place in the set, or the free one where it would be. */
static uint64_t *gaps_slot(const struct gaps *g, uint64_t key)
{
    size_t slot = (size_t)(key % g->slots);
    while (g->taken[slot] && g->taken[slot] != key) slot = (slot + 1) % g->slots;
    return &g->taken[slot];
}

/* Returns 1 if the key was not in the set, and adds it. */
static int gaps_take(struct gaps *g, uint64_t key)
{
    uint64_t *slot = gaps_slot(g, key);
    if (*slot) return 0;
    *slot = key;
    g->used++;
    return 1;
}

static oxl_result gaps_take_points(struct gaps *g, size_t room)
{
    const oxl_point *points = oxl_scene_points(g->scene);
    const size_t count = oxl_scene_point_count(g->scene);
    g->slots = 2 * (count + room) + 1;
    g->taken = oxl_calloc(g->ctx, g->slots, sizeof *g->taken);
    if (!g->taken) return OXL_ERR_MEMORY;
    for (size_t i = 0; i < count; i++) gaps_take(g, gaps_place(g, points[i].position));
    return OXL_OK;
}

/* ---------------- the points of each view */

/* Sorts the observed points by view, in two walks: the first counts, the second fills. */
static oxl_result gaps_sort_tracks(struct gaps *g)
{
    const struct colmap *c = scene_colmap(g->scene);
    const size_t views = (size_t)oxl_scene_view_count(g->scene);
    g->first = oxl_calloc(g->ctx, views + 2, sizeof *g->first);
    g->point = oxl_alloc(g->ctx, c->track_count + 1, sizeof *g->point);
    g->view_of = scene_views_by_image(g->ctx, g->scene, OXL_SPLIT_TRAIN);
    if (!g->first || !g->point || !g->view_of) return OXL_ERR_MEMORY;
    for (int pass = 0; pass < 2; pass++) {
        struct tracks_walk w = tracks_of(c, g->view_of);
        w.origin = oxl_scene_origin(g->scene);
        while (tracks_next(&w)) {
            if (pass == 0) g->first[w.view + 2]++;
            else g->point[g->first[w.view + 1]++] = (uint32_t)w.point;
        }
        for (size_t v = 0; pass == 0 && v < views; v++) g->first[v + 2] += g->first[v + 1];
    }
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
            grey->value[y * (size_t)grey->width + x] = masked ? NAN : (float)sum / (float)(3 * f * f);
        }
}

/* Returns OXL_OK where an image could not be read: a run leaves such a view out when its turn comes, and so
 * does the sweep. */
static oxl_result gaps_without_image(const struct gaps *g)
{
    return g->ctx->failed == OXL_ERR_INPUT || g->ctx->failed == OXL_ERR_IO ? OXL_OK : g->ctx->failed;
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
    if (!grey->value) return NULL;
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
    double n = 0, sx = 0, sy = 0, sw = 0, sxx = 0, sxy = 0, syy = 0, sxw = 0, syw = 0, det;
    const int left = OXL_MAX(-GAPS_REACH, -x), right = OXL_MIN(GAPS_REACH, grid->across - 1 - x),
              last = OXL_MIN(GAPS_REACH, grid->down - 1 - y);
    for (int dy = OXL_MAX(-GAPS_REACH, -y); dy <= last; dy++)
        for (int dx = left; dx <= right; dx++) {
            const struct gaps_cell *cell = &g->cell[(y + dy) * grid->across + x + dx];
            const double weight = g->weight[dy + GAPS_REACH][dx + GAPS_REACH], w = cell->mean;
            if (cell->count == 0) continue;
            n += weight, sx += weight * dx, sy += weight * dy, sw += weight * w;
            sxx += weight * dx * dx, sxy += weight * dx * dy, syy += weight * dy * dy;
            sxw += weight * dx * w, syw += weight * dy * w;
        }
    if (!(n > 0)) return 0;
    sxx += GAPS_RIDGE - sx * sx / n, syy += GAPS_RIDGE - sy * sy / n, sxy -= sx * sy / n;
    sxw -= sx * sw / n, syw -= sy * sw / n;
    det = sxx * syy - sxy * sxy;
    out->dx = (sxw * syy - syw * sxy) / det, out->dy = (syw * sxx - sxw * sxy) / det;
    out->w = (sw - out->dx * sx - out->dy * sy) / n;
    out->w = OXL_CLAMP(out->w, 0.5 * sw / n, 2 * sw / n);
    out->dx *= grid->grey->factor / grid->side, out->dy *= grid->grey->factor / grid->side;
    return 1;
}

/* ---------------- the sweep */

struct gaps_patch {
    double x, y;                /* px of the reduced image: its centre */
    double value[GAPS_SAMPLES]; /* levels, less their mean; NaN where one is masked */
    double norm;                /* square root of the sum of their squares */
};

/* Samples a reduced image between its pixels; the place is inside. */
static double gaps_sample(const struct gaps_grey *grey, double x, double y)
{
    const int column = (int)(x - 0.5), row = (int)(y - 0.5);
    const double fx = x - 0.5 - column, fy = y - 0.5 - row;
    const size_t w = (size_t)grey->width;
    const float *v = grey->value + (size_t)row * w + (size_t)column;
    return (1 - fy) * ((1 - fx) * v[0] + fx * v[1]) + fy * ((1 - fx) * v[w] + fx * v[w + 1]);
}

static int gaps_has(const struct gaps_grey *grey, double x, double y)
{
    return x >= 0.5 && y >= 0.5 && x < grey->width - 1 && y < grey->height - 1;
}

/* Takes out the mean of samples; returns the root of the sum of squares that is left. *with: sum of the
 * products with `other`, along with the squares, since each sum waits for itself. */
static double gaps_centre(double value[GAPS_SAMPLES], const double other[GAPS_SAMPLES], double *with)
{
    double sum = 0, square = 0;
    *with = 0;
    for (int i = 0; i < GAPS_SAMPLES; i++) sum += value[i];
    sum /= GAPS_SAMPLES;
    for (int i = 0; i < GAPS_SAMPLES; i++) {
        value[i] -= sum;
        square += value[i] * value[i];
        *with += value[i] * other[i];
    }
    return sqrt(square);
}

/* Returns 0 where there is nothing to compare: at the image's edge, at masked pixels, and without detail. */
static int gaps_take_patch(const struct gaps_grid *grid, const double pixel[2], struct gaps_patch *patch)
{
    const int f = grid->grey->factor;
    patch->x = pixel[0] / f, patch->y = pixel[1] / f;
    if (!gaps_has(grid->grey, patch->x - GAPS_RADIUS, patch->y - GAPS_RADIUS) ||
        !gaps_has(grid->grey, patch->x + GAPS_RADIUS, patch->y + GAPS_RADIUS))
        return 0;
    for (int i = 0; i < GAPS_SAMPLES; i++)
        patch->value[i] = gaps_sample(grid->grey, patch->x + i % GAPS_SIDE - GAPS_RADIUS,
                                      patch->y + i / GAPS_SIDE - GAPS_RADIUS);
    patch->norm = gaps_centre(patch->value, patch->value, &patch->norm);
    return patch->norm > GAPS_DETAIL * GAPS_SIDE;
}

/* Makes the pixel of the other view's reduced image that sees (x, y) of this one's at inverse depth w. */
static int gaps_transfer(const struct gaps_grid *grid, const struct gaps_pair *pair, double x, double y,
                         double w, double pixel[2])
{
    const oxl_camera *c = grid->camera;
    const double f = grid->grey->factor, ray[3] = {(x * f - c->cx) / c->fx, (y * f - c->cy) / c->fy, 1};
    double p[3];
    for (int k = 0; k < 3; k++)
        p[k] = pair->a[3 * k] * ray[0] + pair->a[3 * k + 1] * ray[1] + pair->a[3 * k + 2] + w * pair->b[k];
    if (!(p[2] > 0)) return 0;
    pixel[0] = p[0] / p[2], pixel[1] = p[1] / p[2];
    return 1;
}

/* Fills the pair: pixel of the reduced image of `to` = a ray + w b, for rays (x/z, y/z, 1) of `from`. */
static void gaps_pair_cameras(const oxl_camera *from, const oxl_camera *to, struct gaps_pair *pair)
{
    const double f = pair->to->factor;
    for (int j = 0; j < 4; j++) {
        double v[3]; /* column j of the rotation from one to the other, or the translation */
        for (int i = 0; i < 3; i++) {
            v[i] = j < 3 ? 0 : to->translation[i];
            for (int k = 0; k < 3 && j < 3; k++) v[i] += to->rotation[3 * i + k] * from->rotation[3 * j + k];
        }
        for (int i = 0; i < 3; i++) {
            const double k[2] = {i == 0 ? to->fx : to->fy, i == 0 ? to->cx : to->cy},
                         out = i < 2 ? (k[0] * v[i] + k[1] * v[2]) / f : v[2];
            if (j < 3) pair->a[3 * i + j] = out;
            else pair->b[i] = out;
        }
    }
    for (int i = 0; i < 3; i++) /* the translation is that of `to` less the rotated one of `from` */
        for (int j = 0; j < 3; j++) pair->b[i] -= pair->a[3 * i + j] * from->translation[j];
}

/* Correlates the patch, seen on a plane, with another view; returns -2 where that view does not have it. */
static double gaps_correlate(const struct gaps_grid *grid, const struct gaps_pair *pair,
                             const struct gaps_patch *patch, const struct gaps_plane *plane)
{
    const double r = GAPS_RADIUS;
    double value[GAPS_SAMPLES], norm, sum, at[3][2], right[2], down[2]; /* the warp, as an affine one */
    if (!gaps_transfer(grid, pair, patch->x, patch->y, plane->w, at[0]) ||
        !gaps_transfer(grid, pair, patch->x + r, patch->y, plane->w + r * plane->dx, at[1]) ||
        !gaps_transfer(grid, pair, patch->x, patch->y + r, plane->w + r * plane->dy, at[2]))
        return -2;
    for (int k = 0; k < 2; k++) right[k] = (at[1][k] - at[0][k]) / r, down[k] = (at[2][k] - at[0][k]) / r;
    for (int i = 0; i < 4; i++) {
        const double dx = i % 2 ? r : -r, dy = i / 2 ? r : -r;
        if (!gaps_has(pair->to, at[0][0] + dx * right[0] + dy * down[0],
                      at[0][1] + dx * right[1] + dy * down[1]))
            return -2;
    }
    for (int i = 0; i < GAPS_SAMPLES; i++) {
        const double dx = i % GAPS_SIDE - GAPS_RADIUS, dy = i / GAPS_SIDE - GAPS_RADIUS;
        value[i] = gaps_sample(pair->to, at[0][0] + dx * right[0] + dy * down[0],
                               at[0][1] + dx * right[1] + dy * down[1]);
    }
    norm = gaps_centre(value, patch->value, &sum);
    return norm > GAPS_DETAIL * GAPS_SIDE ? sum / (norm * patch->norm) : 0;
}

/* Returns the mean correlation with the views that have the patch; -2: none has. Leaves out the rest where
 * correlations of 1 would not bring the mean to `least`. */
static double gaps_agreement(const struct gaps_grid *grid, const struct gaps_patch *patch,
                             const struct gaps_plane *plane, double least)
{
    double sum = 0;
    int seen = 0;
    for (int k = 0; k < grid->pairs; k++) {
        const int left = grid->pairs - k;
        if (seen && sum + left < (seen + left) * least - GAPS_ROUNDING) break;
        const double c = gaps_correlate(grid, &grid->pair[k], patch, plane);
        if (c > -2) sum += c, seen++;
    }
    return seen ? sum / seen : -2;
}

/* Returns the change of inverse depth, as a fraction, that moves the patch by GAPS_STEP in the view where it
 * moves most; 0: it moves in none. */
static double gaps_step(const struct gaps_grid *grid, const struct gaps_patch *patch, double w)
{
    const double probe = 0.01;
    double most = 0;
    for (int k = 0; k < grid->pairs; k++) {
        double p[2], q[2];
        if (gaps_transfer(grid, &grid->pair[k], patch->x, patch->y, w, p) &&
            gaps_transfer(grid, &grid->pair[k], patch->x, patch->y, w * (1 + probe), q))
            most = OXL_MAX(most, (p[0] - q[0]) * (p[0] - q[0]) + (p[1] - q[1]) * (p[1] - q[1]));
    }
    return most > 0 ? GAPS_STEP * probe / sqrt(most) : 0;
}

/* Moves the plane to the depth at which the views agree best, if by GAPS_AGREES or more; returns that
 * agreement, or less. */
static double gaps_sweep(const struct gaps_grid *grid, const struct gaps_patch *patch,
                         struct gaps_plane *plane)
{
    const struct gaps_plane prior = *plane;
    const double step = OXL_MIN(gaps_step(grid, patch, prior.w), GAPS_RANGE);
    double best = GAPS_AGREES - GAPS_ROUNDING;
    for (int s = -GAPS_STEPS; s <= GAPS_STEPS && step > 0; s++) {
        const double scale = 1 + s * step;
        const struct gaps_plane tried = {prior.w * scale, prior.dx * scale, prior.dy * scale};
        const double agreement = fabs(s * step) > GAPS_RANGE ? -2 : gaps_agreement(grid, patch, &tried, best);
        if (agreement > best) best = agreement, *plane = tried;
    }
    return best;
}

/* ---------------- a view */

/* Takes the mean colour of the pixels under one of the reduced image; returns 0 without the image. */
static int gaps_colour(struct gaps *g, const struct gaps_grid *grid, int view, const double pixel[2],
                       uint8_t rgb[3])
{
    const struct training_image *image = scene_image(g->ctx, g->scene, view);
    const size_t f = (size_t)grid->grey->factor, x = (size_t)pixel[0] / f * f, y = (size_t)pixel[1] / f * f;
    if (!image) return 0;
    for (int c = 0; c < 3; c++) {
        const uint8_t *row = image->rgb + ((size_t)c * (size_t)image->height + y) * (size_t)image->width + x;
        size_t sum = 0;
        for (size_t k = 0; k < f * f; k++) sum += row[k / f * (size_t)image->width + k % f];
        rgb[c] = (uint8_t)(sum / (f * f));
    }
    return 1;
}

/* Adds a point in a cell that has none, if the views agree on its depth. */
static oxl_result gaps_add(struct gaps *g, const struct gaps_grid *grid, int view, int x, int y)
{
    const double pixel[2] = {(x + 0.5) * grid->side, (y + 0.5) * grid->side};
    struct gaps_plane plane;
    struct gaps_patch patch;
    oxl_point point = {.error = -1};
    oxl_result rc;
    if (!gaps_fit(g, grid, x, y, &plane)) return OXL_OK;
    camera_unproject(grid->camera, pixel, 1 / plane.w, point.position);
    if (*gaps_slot(g, gaps_place(g, point.position)) || !gaps_take_patch(grid, pixel, &patch) ||
        !(gaps_sweep(grid, &patch, &plane) >= GAPS_AGREES))
        return OXL_OK;
    camera_unproject(grid->camera, pixel, 1 / plane.w, point.position);
    if (2 * (g->used + 1) > g->slots || !gaps_take(g, gaps_place(g, point.position))) return OXL_OK;
    if (!gaps_colour(g, grid, view, pixel, point.rgb)) return gaps_without_image(g);
    rc = oxl_reserve(g->ctx, &g->out, &g->capacity, g->count + 1, sizeof point);
    if (rc == OXL_OK) g->out[g->count++] = point;
    return rc;
}

/* Returns the distance of two cameras' centres. */
static double gaps_baseline(const oxl_camera *a, const oxl_camera *b)
{
    double x[3], y[3];
    camera_position(a, x);
    camera_position(b, y);
    return sqrt((x[0] - y[0]) * (x[0] - y[0]) + (x[1] - y[1]) * (x[1] - y[1]) +
                (x[2] - y[2]) * (x[2] - y[2]));
}

/* Takes the views that share the most points with this one, of those whose baseline gives parallax at its
 * mean depth. */
static oxl_result gaps_find_pairs(struct gaps *g, struct gaps_grid *grid, int view, double depth)
{
    const struct colmap *c = scene_colmap(g->scene);
    const int views = oxl_scene_view_count(g->scene);
    memset(g->shared, 0, (size_t)views * sizeof *g->shared);
    for (size_t i = g->first[view]; i < g->first[view + 1]; i++) {
        struct tracks_walk w = tracks_of_point(c, g->view_of, g->point[i]);
        while (tracks_next(&w)) g->shared[w.view]++;
    }
    for (int v = 0; v < views; v++) {
        const double angle = gaps_baseline(grid->camera, &oxl_scene_view(g->scene, v)->camera) / depth;
        if (v == view || !(angle > GAPS_ANGLE_LEAST) || !(angle < GAPS_ANGLE_MOST)) g->shared[v] = 0;
    }
    while (grid->pairs < GAPS_NEIGHBOURS) {
        struct gaps_pair *pair = &grid->pair[grid->pairs];
        int best = 0;
        for (int v = 1; v < views; v++)
            if (g->shared[v] > g->shared[best]) best = v;
        if (g->shared[best] == 0) break;
        g->shared[best] = 0;
        pair->to = gaps_grey(g, best);
        if (!pair->to && gaps_without_image(g) != OXL_OK) return g->ctx->failed;
        if (!pair->to) continue;
        gaps_pair_cameras(grid->camera, &oxl_scene_view(g->scene, best)->camera, pair);
        grid->pairs++;
    }
    return OXL_OK;
}

/* Sets the cells' mean inverse depths; returns the mean depth of all points, as 1 / mean inverse depth; 0
 * without any. */
static double gaps_mean_depth(struct gaps *g, int cells)
{
    double count = 0, inverse = 0;
    for (struct gaps_cell *c = g->cell; c < g->cell + cells; c++) {
        count += c->count, inverse += c->inverse_z;
        c->mean = c->count > 0 ? c->inverse_z / c->count : 0;
    }
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
    if (rc == OXL_OK && !(grid.grey = gaps_grey(g, view))) rc = gaps_without_image(g);
    for (int y = 0; y < grid.down && grid.grey && grid.pairs > 0; y++)
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

OXL_INTERNAL oxl_result gaps_points(oxl_context *ctx, const oxl_scene *scene, size_t most, oxl_point **out,
                                    size_t *count)
{
    const struct colmap *c = scene_colmap(scene);
    struct gaps g = {.ctx = ctx, .scene = scene, .side = gaps_side(scene)};
    oxl_result rc = OXL_OK;
    *out = NULL, *count = 0;
    if (most == 0 || !c || c->track_count == 0 || !(g.side > 0)) return OXL_OK;
    g.cell = oxl_alloc(ctx, (GAPS_ACROSS + 1) * (GAPS_ACROSS + 1), sizeof *g.cell);
    g.shared = oxl_alloc(ctx, (size_t)oxl_scene_view_count(scene) + 1, sizeof *g.shared);
    if (!g.cell || !g.shared) rc = OXL_ERR_MEMORY;
    for (int y = -GAPS_REACH; y <= GAPS_REACH; y++)
        for (int x = -GAPS_REACH; x <= GAPS_REACH; x++)
            g.weight[y + GAPS_REACH][x + GAPS_REACH] = x || y ? 1.0 / (x * x + y * y) : 0;
    if (rc == OXL_OK) rc = gaps_take_points(&g, GAPS_PLACES * most);
    if (rc == OXL_OK) rc = gaps_sort_tracks(&g);
    for (int i = 0; i < oxl_scene_view_count(scene) && rc == OXL_OK; i++)
        if (!oxl_scene_view(scene, i)->is_test) rc = gaps_of_view(&g, i);
    gaps_thin(&g, most);
    if (rc == OXL_OK) *out = g.out, *count = g.count;
    else oxl_free(ctx, g.out);
    for (int i = 0; i < GAPS_GREYS; i++) oxl_free(ctx, g.grey[i].value);
    OXL_FREE(ctx, g.shared, g.cell, g.taken, g.view_of, g.first, g.point);
    return rc;
}

static oxl_result gaps_first_points(struct train *t, oxl_point **out, size_t *count)
{
    const size_t points = oxl_scene_point_count(t->scene), cap = schedule_gaussian_cap(t->scene, t->options),
                 room = cap > points ? (size_t)(GAPS_FRACTION * (double)(cap - points)) : 0,
                 most = t->options->gaps ? room : 0;
    const oxl_result rc = gaps_points(t->ctx, t->scene, most, out, count);
    if (rc == OXL_OK && *count > 0)
        oxl_log(t->ctx, OXL_LOG_DEBUG, "%zu points are added where views show none of the survey's", *count);
    return rc;
}

/* clang-format off */
static const oxl_option gaps_options[] = {
{"gaps", "off|on", OXL_OPTION_CHOICE, OPTION_AT(train.gaps), 0, 1, PRESETS("on", "on", "off"), OXL_TIER_ADVANCED, TRAINING | RESULT | NOT_REFINED, "Scene content", "start also where views lack points", NULL},
{0}};
/* clang-format on */

OXL_INTERNAL const struct part part_gaps = {
    .name = "gaps", .option = gaps_options, .first_points = gaps_first_points};
