/* synth_world.c - geometry: seabed, rocks, corals, starfish, as one distance function.
 *
 * The ground is a height field: swell, reef patches and sand ripples, baked once and read back through a
 * cubic B-spline, whose slope is smooth. Things are signed distance functions (Hart 1996, sphere tracing):
 * displaced ellipsoids and smooth unions of limbs. A grid of cells lists what comes near each.
 *
 * Invariant: synth_distance is never larger than the distance to an object: what a cell does not list is at
 * least SYNTH_NEAR away from the whole cell. For the ground it is an estimate; a ray that steps below a steep
 * slope steps back.
 */
#include "synth.h"

#include <stdlib.h>

#define SYNTH_CELL 0.5  /* metres */
#define SYNTH_NEAR 0.25 /* metres: the largest distance that shading uses */
#define TALLEST 1.3     /* metres: maximum height over the ground */
#define BAKED_STEP 0.02 /* metres, at most MAX_BAKED samples */
#define MAX_BAKED 48e6
#define BOULDER 1.1 /* metres; radius of the sphere that holds the one in the middle */

/* ---------------- the ground */

/* Returns 0 on sand, 1 on the reef. */
static double world_reef(const struct synth_world *w, double x, double y)
{
    const double warp = 0.8 * synth_noise2(w->seed + 40, x / 1.7, y / 1.7);
    return synth_step(0.02, 0.5, synth_fbm2(w->seed + 41, x + warp, y - warp, 4.5, 0.9, 0.5, 1e-3));
}

/* Crests of sand, 28 cm apart, that bend and fade in patches. */
static double world_ripples(uint32_t seed, double x, double y)
{
    const double bend =
        2.2 * synth_noise2(seed + 50, x / 1.3, y / 1.3) + 0.7 * synth_noise2(seed + 51, x / 0.45, y / 0.45);
    const double size = synth_step(-0.5, 0.5, synth_noise2(seed + 52, x / 2.3, y / 2.3));
    const double wave = sin((0.83 * x + 0.56 * y) * (2 * SYNTH_PI / 0.28) + bend);
    return (0.005 + 0.012 * size) * (1 - fabs(wave)) * 1.6;
}

static double world_height(const struct synth_world *w, double x, double y)
{
    const uint32_t seed = w->seed;
    const double swell =
        0.30 * synth_noise2(seed + 30, x / 8, y / 8) + 0.10 * synth_noise2(seed + 31, x / 2.7, y / 2.7);
    const double reef = world_reef(w, x, y);
    double rough = 0;
    if (reef > 0) {
        const double ridges = 1 - fabs(synth_fbm2(seed + 60, x, y, 1.1, 0.3, 0.5, 1e-3));
        rough = 0.42 * ridges * ridges + 0.07 * synth_fbm2(seed + 65, x, y, 0.4, 0.05, 0.55, 1e-3);
    }
    return swell + reef * (rough - 0.1) + (1 - reef) * world_ripples(seed, x, y);
}

static int world_bake(struct synth_world *w, double half)
{
    w->step = synth_max(BAKED_STEP, 2 * half / sqrt(MAX_BAKED));
    w->half = half;
    w->side = (int)(2 * half / w->step) + 2;
    w->height = malloc((size_t)w->side * w->side * sizeof *w->height);
    if (!w->height) return 0;
#pragma omp parallel for schedule(dynamic, 16)
    for (int j = 0; j < w->side; j++)
        for (int i = 0; i < w->side; i++)
            w->height[(size_t)j * w->side + (size_t)i] =
                (float)world_height(w, i * w->step - half, j * w->step - half);
    return 1;
}

/* Weighs the four samples around t in 0..1: the uniform cubic B-spline. */
static void world_spline(double t, double weight[4])
{
    const double s = 1 - t;
    weight[0] = s * s * s / 6;
    weight[1] = (4 - 6 * t * t + 3 * t * t * t) / 6;
    weight[2] = (4 - 6 * s * s + 3 * s * s * s) / 6;
    weight[3] = t * t * t / 6;
}

double synth_ground(const struct synth_world *w, double x, double y)
{
    const double gx = (x + w->half) / w->step, gy = (y + w->half) / w->step;
    const int ix = synth_floor(gx), iy = synth_floor(gy);
    double wx[4], wy[4], sum = 0;
    if (ix < 1 || iy < 1 || ix + 2 >= w->side || iy + 2 >= w->side) return world_height(w, x, y);
    world_spline(gx - ix, wx);
    world_spline(gy - iy, wy);
    for (int j = 0; j < 4; j++) {
        const float *row = w->height + (size_t)(iy - 1 + j) * (size_t)w->side + (size_t)(ix - 1);
        sum += wy[j] * (wx[0] * row[0] + wx[1] * row[1] + wx[2] * row[2] + wx[3] * row[3]);
    }
    return sum;
}

/* ---------------- distances to simple bodies */

static double world_ellipsoid(v3 p, v3 axes) /* first order: exact at the surface, short elsewhere */
{
    const v3 q = v3_of(p.x / axes.x, p.y / axes.y, p.z / axes.z);
    const v3 r = v3_of(q.x / axes.x, q.y / axes.y, q.z / axes.z);
    const double k0 = v3_length(q), k1 = v3_length(r);
    return k0 < 1e-6 ? -synth_min(axes.x, synth_min(axes.y, axes.z)) : k0 * (k0 - 1) / k1;
}

static struct synth_limb world_make_limb(v3 a, v3 b, double radius_a, double radius_b)
{
    const v3 toward = v3_sub(b, a);
    return (struct synth_limb){a, toward, radius_a, radius_b, 1 / v3_dot(toward, toward)};
}

static double world_limb(v3 p, const struct synth_limb *l)
{
    const v3 pa = v3_sub(p, l->a);
    const double t = synth_clamp(v3_dot(pa, l->axis) * l->per_square, 0, 1);
    return v3_length(v3_along(pa, l->axis, -t)) - synth_lerp(l->radius_a, l->radius_b, t);
}

static double world_smooth_minimum(double a, double b, double width) /* a smooth minimum */
{
    const double h = synth_max(width - fabs(a - b), 0) / width;
    return synth_min(a, b) - h * h * width * 0.25;
}

/* ---------------- objects */

static v3 world_object_frame(const struct synth_object *o, v3 p)
{
    const v3 q = v3_sub(p, o->centre);
    return v3_of(o->yaw_cos * q.x + o->yaw_sin * q.y, o->yaw_cos * q.y - o->yaw_sin * q.x, q.z);
}

static double world_shape(const struct synth_shape *s, v3 q)
{
    double d = 1e9;
    for (int i = 0; i < s->limb_count; i++) {
        const double limb = world_limb(q, &s->limb[i]);
        if (limb < d + s->blend) d = world_smooth_minimum(d, limb, s->blend);
    }
    return d;
}

static double world_stone(const struct synth_object *o, v3 q)
{
    const double r = o->radius, d = world_ellipsoid(q, o->axes);
    double lumps;
    if (d > 0.5 * r) return d - 0.2 * r;
    lumps = 0.16 * r * synth_noise3(o->seed, v3_scale(q, 1.7 / r));
    if (o->material == SYNTH_ROCK) lumps += 0.05 * r * synth_noise3(o->seed + 1, v3_scale(q, 5 / r));
    return 0.75 * (d + lumps);
}

static double world_object(const struct synth_world *w, const struct synth_object *o, v3 p)
{
    const v3 q = world_object_frame(o, p);
    if (o->shape == SYNTH_STONE) return world_stone(o, q);
    return o->radius * world_shape(&w->shape[o->shape], v3_scale(q, 1 / o->radius));
}

/* Finds the nearest listed object, or `least` when none is nearer. What is not listed lies SYNTH_NEAR
 * beyond the cell's walls, and under the cell's ceiling or 1 m away. */
static double world_objects(const struct synth_world *w, v3 p, double least, struct synth_surface *surface)
{
    const double gx = (p.x + w->half) / SYNTH_CELL, gy = (p.y + w->half) / SYNTH_CELL;
    const int ix = synth_floor(gx), iy = synth_floor(gy);
    const double fx = gx - ix, fy = gy - iy;
    const double wall = SYNTH_CELL * synth_min(synth_min(fx, 1 - fx), synth_min(fy, 1 - fy)) + SYNTH_NEAR;
    size_t cell;
    double over;
    if (ix < 0 || iy < 0 || ix >= w->cells || iy >= w->cells) return least;
    cell = (size_t)iy * w->cells + (size_t)ix;
    over = synth_min(p.z - w->ceiling[cell], 1);
    if (over > wall) return synth_min(least, over);
    least = synth_min(least, wall);
    for (uint32_t k = w->cell_first[cell]; k < w->cell_first[cell + 1]; k++) {
        const struct synth_near *near = &w->near[k];
        const double dx = p.x - near->x, dy = p.y - near->y, dz = p.z - near->z;
        const double square = dx * dx + dy * dy + dz * dz, reach = least + near->radius;
        const struct synth_object *o = &w->object[near->object];
        double d;
        if (reach < 0 || square >= reach * reach) continue;
        d = sqrt(square) - near->radius;
        if (d < 0.04) d = world_object(w, o, p);
        if (d >= least) continue;
        least = d;
        *surface = (struct synth_surface){o->material, o};
    }
    return least;
}

/* Returns rock where the reef is, with a ragged edge; else sand. */
static enum synth_material world_ground_material(const struct synth_world *w, v3 p)
{
    const double ragged = 0.25 * synth_fbm2(w->seed + 70, p.x, p.y, 0.3, 0.02, 0.7, 1e-3);
    return world_reef(w, p.x, p.y) + ragged > 0.35 ? SYNTH_ROCK : SYNTH_SAND;
}

/* Returns the height over the ground. Far up the nearest baked sample will do: it is off by less than the 3
 * cm taken away. */
static double world_height_above(const struct synth_world *w, v3 p)
{
    const int ix = synth_floor((p.x + w->half) / w->step + 0.5),
              iy = synth_floor((p.y + w->half) / w->step + 0.5);
    if (ix >= 0 && iy >= 0 && ix < w->side && iy < w->side) {
        const double above = p.z - w->height[(size_t)iy * w->side + (size_t)ix] - 1.5 * w->step;
        if (above > 0.2) return above;
    }
    return p.z - synth_ground(w, p.x, p.y);
}

double synth_distance(const struct synth_world *w, v3 p, struct synth_surface *surface)
{
    const double above = world_height_above(w, p);
    struct synth_surface nearest = {surface ? world_ground_material(w, p) : SYNTH_SAND, NULL};
    double d = synth_max(0.75 * above, above - 1.3); /* slopes of 41 degrees, heights that differ by 1.3 m */
    d = world_objects(w, p, d, &nearest);
    if (surface) *surface = nearest;
    return d;
}

/* ---------------- making the shapes of limbs */

static void world_add_limb(struct synth_shape *s, v3 a, v3 b, double radius_a, double radius_b)
{
    s->limb[s->limb_count++] = world_make_limb(a, b, radius_a, radius_b);
}

/* Builds a bush: stems lean outwards and end in two fingers each. */
static void world_branching(struct synth_shape *s, uint64_t seed)
{
    const int stems = 6 + (int)(3 * synth_unit(synth_bits(seed, 0, 0)));
    s->blend = 0.08;
    for (int i = 0; i < stems; i++) {
        const double u = synth_unit(synth_bits(seed, 1, (uint64_t)i)), lean = i == 0 ? 0.1 : 0.35 + 0.75 * u;
        const double turn = 2 * SYNTH_PI * (i + 0.6 * u) / stems;
        const v3 out = v3_of(cos(turn) * sin(lean), sin(turn) * sin(lean), cos(lean));
        const v3 side = v3_of(-sin(turn), cos(turn), 0.3),
                 middle = v3_of(0.5 * out.x, 0.5 * out.y, 0.5 * out.z - 0.15);
        world_add_limb(s, v3_of(0, 0, -0.3), middle, 0.11, 0.085);
        world_add_limb(s, middle, v3_along(v3_along(middle, out, 0.42), side, 0.14 + 0.1 * u), 0.085, 0.05);
        world_add_limb(s, middle, v3_along(v3_along(middle, out, 0.40), side, -0.20 + 0.1 * u), 0.08, 0.045);
    }
}

static void world_star(struct synth_shape *s, uint64_t seed)
{
    s->blend = 0.1;
    for (int i = 0; i < 5; i++) {
        const double turn = 2 * SYNTH_PI * (i + 0.25 * synth_unit(synth_bits(seed, 4, (uint64_t)i))) / 5;
        world_add_limb(s, v3_of(0, 0, 0.06), v3_of(0.85 * cos(turn), 0.85 * sin(turn), -0.05), 0.2, 0.08);
    }
}

static void world_make_shapes(struct synth_world *w)
{
    for (int i = 0; i < SYNTH_SHAPES; i++) {
        (i < 4 ? world_branching : world_star)(&w->shape[i], synth_bits(w->seed, 8, (uint64_t)i));
    }
}

/* ---------------- strewing objects */

struct world_kind {
    enum synth_material material;
    int shape, shapes;       /* first index and how many; or SYNTH_STONE */
    double density;          /* tries on a square metre */
    double on_sand, on_reef; /* fraction of accepted candidates */
    double small, large;     /* radius, metres */
    double sunk;             /* radii that the centre lies under the ground; negative: above */
};

static const struct world_kind world_kinds[] = {
    {SYNTH_ROCK, SYNTH_STONE, 1, 0.5, 0.08, 0.9, 0.15, 0.5, 0.1},
    {SYNTH_BRAIN_CORAL, SYNTH_STONE, 1, 1.2, 0.01, 0.8, 0.10, 0.32, 0.1},
    {SYNTH_BRANCH_CORAL, 0, 4, 2.4, 0.01, 0.9, 0.12, 0.36, -0.3},
    {SYNTH_STARFISH, 4, 2, 0.35, 0.8, 0.15, 0.07, 0.12, 0.0},
    {SYNTH_PEBBLE, SYNTH_STONE, 1, 7.0, 0.45, 0.6, 0.015, 0.06, 0.1},
};

enum { WORLD_KINDS = sizeof world_kinds / sizeof *world_kinds };

/* Tells whether candidate i of a kind is accepted, and its position. */
static int world_place_object(const struct synth_world *w, double half, int kind, uint64_t i,
                              struct synth_object *o)
{
    const struct world_kind *k = &world_kinds[kind];
    const uint64_t seed = synth_bits(w->seed, 100 + (uint64_t)kind, i);
    double u[8], reef, x, y;
    for (uint64_t j = 0; j < 8; j++) u[j] = synth_unit(synth_bits(seed, j, 0));
    x = half * (2 * u[0] - 1);
    y = half * (2 * u[1] - 1);
    reef = world_reef(w, x, y);
    if (u[2] > synth_lerp(k->on_sand, k->on_reef, reef)) return 0;
    if (k->large > 0.1 && hypot(x, y) < BOULDER) return 0;
    *o = (struct synth_object){.material = k->material, .shape = k->shape, .seed = (uint32_t)seed};
    o->radius = k->small + (k->large - k->small) * u[3] * u[3];
    o->yaw_cos = cos(2 * SYNTH_PI * u[4]);
    o->yaw_sin = sin(2 * SYNTH_PI * u[4]);
    o->centre = v3_of(x, y, synth_ground(w, x, y) - k->sunk * o->radius);
    o->axes = v3_scale(v3_of(0.85, 0.55 + 0.25 * u[5], 0.45 + 0.25 * u[6]), o->radius);
    if (k->shape >= 0) o->shape += (int)(k->shapes * u[7]);
    return 1;
}

/* Scatters the objects, of which the first is a boulder in the middle. */
static int world_scatter_objects(struct synth_world *w, double half)
{
    size_t most = 0;
    for (int k = 0; k < WORLD_KINDS; k++) most += (size_t)(world_kinds[k].density * 4 * half * half);
    w->object = malloc((most + 2) * sizeof *w->object);
    if (!w->object) return 0;
    w->object[w->object_count++] = (struct synth_object){.centre = v3_of(0, 0, synth_ground(w, 0, 0) + 0.2),
                                                         .radius = BOULDER,
                                                         .yaw_cos = 1,
                                                         .axes = v3_scale(v3_of(0.85, 0.7, 0.6), BOULDER),
                                                         .material = SYNTH_ROCK,
                                                         .shape = SYNTH_STONE,
                                                         .seed = w->seed};
    for (int k = 0; k < WORLD_KINDS; k++) {
        const uint64_t tries = (uint64_t)(world_kinds[k].density * 4 * half * half);
        for (uint64_t i = 0; i < tries; i++)
            w->object_count += (size_t)world_place_object(w, half, k, i, &w->object[w->object_count]);
    }
    return 1;
}

/* Returns the cell of a coordinate: below 0 or beyond the last for what lies outside. */
static int world_cell(const struct synth_world *w, double x)
{
    return synth_floor((x + w->half) / SYNTH_CELL);
}

/* Calls for each cell that an object comes near: counts it, or lists it from the back. */
static void world_list(struct synth_world *w, int listing)
{
    for (size_t i = 0; i < w->object_count; i++) {
        const v3 c = w->object[i].centre;
        const double radius = w->object[i].radius, r = radius + SYNTH_NEAR;
        const struct synth_near near = {(float)c.x, (float)c.y, (float)c.z, (float)radius + 1e-4f,
                                        (uint32_t)i};
        const int low = world_cell(w, c.x - r), high = world_cell(w, c.x + r), from = world_cell(w, c.y - r),
                  to = world_cell(w, c.y + r);
        for (int y = from < 0 ? 0 : from; y <= to && y < w->cells; y++)
            for (int x = low < 0 ? 0 : low; x <= high && x < w->cells; x++) {
                uint32_t *cell = &w->cell_first[(size_t)y * w->cells + (size_t)x];
                if (listing) w->near[--*cell] = near;
                else ++*cell;
            }
    }
}

static float world_highest(const struct synth_world *w, size_t cell)
{
    float top = -1e9f;
    for (uint32_t k = w->cell_first[cell]; k < w->cell_first[cell + 1]; k++)
        top = fmaxf(top, w->near[k].z + w->near[k].radius);
    return top;
}

static int world_bake_ceilings(struct synth_world *w)
{
    const int reach = (int)(1 / SYNTH_CELL);
    w->ceiling = malloc((size_t)w->cells * w->cells * sizeof *w->ceiling);
    if (!w->ceiling) return 0;
    for (int i = 0; i < w->cells * w->cells; i++) w->ceiling[i] = -1e9f;
    for (int y = 0; y < w->cells; y++)
        for (int x = 0; x < w->cells; x++) {
            const float top = world_highest(w, (size_t)y * w->cells + (size_t)x);
            for (int v = y < reach ? 0 : y - reach; v <= y + reach && v < w->cells; v++)
                for (int u = x < reach ? 0 : x - reach; u <= x + reach && u < w->cells; u++) {
                    float *ceiling = &w->ceiling[(size_t)v * w->cells + (size_t)u];
                    *ceiling = fmaxf(*ceiling, top);
                }
        }
    return 1;
}

static int world_index(struct synth_world *w, double half)
{
    size_t cells;
    w->cells = (int)(2 * half / SYNTH_CELL) + 1;
    cells = (size_t)w->cells * w->cells;
    w->cell_first = calloc(cells + 1, sizeof *w->cell_first);
    if (!w->cell_first) return 0;
    world_list(w, 0);
    for (size_t i = 0; i < cells; i++) w->cell_first[i + 1] += w->cell_first[i]; /* each now holds its end */
    w->near = malloc((w->cell_first[cells] + 1) * sizeof *w->near);
    if (!w->near) return 0;
    world_list(w, 1); /* and now its beginning */
    return world_bake_ceilings(w);
}

int synth_world_create(uint64_t seed, double half, struct synth_world *w)
{
    *w = (struct synth_world){
        .seed = (uint32_t)synth_mix(seed), .sand_contrast = 1, .sun = v3_unit(v3_of(0.42, 0.28, 0.86))};
    world_make_shapes(w);
    if (!world_bake(w, half) || !world_scatter_objects(w, half) || !world_index(w, half)) {
        synth_world_free(w);
        return 0;
    }
    for (int i = 0; i < w->side * w->side; i++) w->top = synth_max(w->top, w->height[i]);
    w->top = synth_max(w->top, 0.45) + TALLEST; /* 0.45: the highest swell beyond what is baked */
    return 1;
}

/* ---------------- a second dive */

#define MOUND_RADIUS 0.9 /* metres */
#define MOUND_HEIGHT 0.35
#define CHANGE_STEP 0.02 /* metres; of the rays that measure volumes */

static double world_mound(v3 mound, double x, double y)
{
    const double r = hypot(x - mound.x, y - mound.y) / MOUND_RADIUS;
    return r < 1 ? MOUND_HEIGHT * (1 - r * r) : 0;
}

/* Returns the volume under the surface seen from above, above an arbitrary depth. */
static double world_volume(const struct synth_world *w, v3 centre, double radius)
{
    const int steps = (int)(radius / CHANGE_STEP) + 1;
    double sum = 0;
    for (int i = -steps; i <= steps; i++)
        for (int k = -steps; k <= steps; k++) {
            const v3 from = v3_of(centre.x + i * CHANGE_STEP, centre.y + k * CHANGE_STEP, w->top + 1);
            sum += from.z - synth_cast(w, from, v3_of(0, 0, -1), SYNTH_FAR);
        }
    return sum * CHANGE_STEP * CHANGE_STEP;
}

/* Moves what belongs to an object up, or far below the ground. */
static void world_lift(struct synth_world *w, struct synth_object *o, double by)
{
    o->centre.z += by;
    for (size_t i = 0; fabs(by) > 0 && i < w->cell_first[w->cells * w->cells]; i++)
        if (w->object + w->near[i].object == o) w->near[i].z += (float)by;
}

void synth_world_change(struct synth_world *w, struct synth_changed out[2])
{
    const v3 mound = v3_of(1.9, -1.4, 0);
    struct synth_object *stone = &w->object[0];
    out[0] =
        (struct synth_changed){v3_of(mound.x, mound.y, synth_ground(w, mound.x, mound.y)), MOUND_RADIUS, 0};
    out[1] = (struct synth_changed){stone->centre, stone->radius, 0};
    w->top += MOUND_HEIGHT;
    for (int i = 0; i < w->cells * w->cells; i++) w->ceiling[i] += (float)MOUND_HEIGHT;
    for (int k = 0; k < 2; k++) out[k].volume = -world_volume(w, out[k].place, 1.2 * out[k].radius);
    for (int j = 0; j < w->side; j++)
        for (int i = 0; i < w->side; i++)
            w->height[(size_t)j * w->side + (size_t)i] +=
                (float)world_mound(mound, i * w->step - w->half, j * w->step - w->half);
    for (size_t i = 0; i < w->object_count; i++)
        world_lift(w, &w->object[i], world_mound(mound, w->object[i].centre.x, w->object[i].centre.y));
    world_lift(w, stone, -3);
    for (int k = 0; k < 2; k++) out[k].volume += world_volume(w, out[k].place, 1.2 * out[k].radius);
}

void synth_world_free(struct synth_world *w)
{
    free(w->height);
    free(w->object);
    free(w->cell_first);
    free(w->near);
    free(w->ceiling);
    *w = (struct synth_world){0};
}
