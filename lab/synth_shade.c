/* synth_shade.c - rays, light and colour.
 *
 * Rays march along the distance function (sphere tracing, Hart 1996). Light: a sun high in the south-west
 * with soft shadows
 * (Quilez's penumbra from the nearest miss), a blue-green sky dimmed by near objects (ambient occlusion),
 * light reflected by the sand. Colour is procedural down to the pixel: waves and specks finer than the
 * footprint of a pixel fade out. It does not depend
 * on the direction of view: what differs between images is water and noise alone.
 */
#include "synth.h"

#include <stddef.h>

/* of the range: a ray this near to a surface has met it; half a millimetre at 3 m */
#define HIT_FRACTION 2e-4

double synth_cast(const struct synth_world *w, v3 from, v3 direction, double far)
{
    double t = 0;
    if (from.z > w->top) {
        if (direction.z >= 0) return -1;
        t = (w->top - from.z) / direction.z;
    }
    for (int i = 0; i < 256 && t < far; i++) {
        const v3 p = v3_along(from, direction, t);
        const double d = synth_distance(w, p, NULL);
        if (d < HIT_FRACTION * t) return t + d;
        if (p.z > w->top && direction.z >= 0) return -1;
        t += d;
    }
    return t < far ? t : -1; /* 256 steps: a grazing ray; its position is near enough */
}

/* ---------------- relief finer than the geometry, in normals alone */

static double shade_relief(const struct synth_world *w, v3 p, enum synth_material material, double footprint)
{
    static const struct {
        double amplitude, wavelength, finest, gain; /* metres, metres, metres, of each octave */
    } reliefs[] = {
        [SYNTH_SAND] = {0.0022, 0.06, 0.004, 0.6},         [SYNTH_ROCK] = {0.014, 0.12, 0.006, 0.6},
        [SYNTH_PEBBLE] = {0.004, 0.03, 0.005, 0.6},        [SYNTH_BRAIN_CORAL] = {0.012, 0.07, 0.03, 0.5},
        [SYNTH_BRANCH_CORAL] = {0.006, 0.025, 0.006, 0.7}, [SYNTH_STARFISH] = {0.006, 0.025, 0.006, 0.7}};
    const double wave =
        synth_fbm(material != SYNTH_SAND, w->seed + 300 + 10 * material, p, reliefs[material].wavelength,
                  reliefs[material].finest, reliefs[material].gain, footprint);
    return reliefs[material].amplitude *
           (material == SYNTH_BRAIN_CORAL ? synth_visible_fraction(0.05, footprint) * fabs(wave) : wave);
}

/* Differences over a tetrahedron: four evaluations. The relief of one material is taken for all four
 * corners. */
static v3 shade_normal(const struct synth_world *w, v3 p, enum synth_material material, double footprint)
{
    const double e = synth_max(0.7 * footprint, 0.001);
    v3 normal = {0, 0, 0};
    for (int i = 0; i < 4; i++) {
        const v3 corner =
            v3_of(i == 0 || i == 3 ? 1 : -1, i == 1 || i == 3 ? 1 : -1, i == 2 || i == 3 ? 1 : -1);
        const v3 at = v3_along(p, corner, e);
        const double d = synth_distance(w, at, NULL) - shade_relief(w, at, material, footprint);
        normal = v3_along(normal, corner, d);
    }
    return v3_dot(normal, normal) > 0 ? v3_unit(normal) : v3_of(0, 0, 1);
}

v3 synth_normal(const struct synth_world *w, v3 p, double footprint)
{
    struct synth_surface surface;
    synth_distance(w, p, &surface);
    return shade_normal(w, p, surface.material, footprint);
}

/* ---------------- colours (linear light, 0..1) */

/* Specks of many sizes, one in each cell of a grid at most, at a random place of it; 1 within a speck.
 * size: cell, metres. fraction: of the cells that have one. */
static double shade_specks(uint32_t seed, double x, double y, double size, double fraction, double footprint,
                           uint32_t *which)
{
    const int ix = synth_floor(x / size), iy = synth_floor(y / size);
    const uint32_t h = synth_lattice(seed, ix, iy, 7), k = synth_lattice(seed, ix, iy, 8);
    const double odd = (h >> 24) / 255., radius = 0.04 + 0.16 * odd * odd * odd, free = 1 - 2.4 * radius;
    const double dx = x / size - ix - 0.5 - free * ((h & 255) / 255. - 0.5),
                 dy = y / size - iy - 0.5 - free * ((h >> 8 & 255) / 255. - 0.5);
    const double turn = (k & 255) * (SYNTH_PI / 256), along = dx * cos(turn) + dy * sin(turn),
                 across = dy * cos(turn) - dx * sin(turn);
    *which = k;
    if ((h >> 16 & 255) > 255 * fraction) return 0;
    return synth_visible_fraction(4 * radius * size, footprint) *
           synth_step(radius * 1.15, radius * 0.85,
                      sqrt(along * along + (1 + 0.01 * (k >> 24)) * across * across));
}

static v3 shade_sand(const struct synth_world *w, v3 p, double footprint)
{
    const uint32_t seed = w->seed + 400;
    const double patch = synth_fbm2(seed, p.x, p.y, 1.9, 0.15, 0.65, footprint);
    const double grain = synth_fbm2(seed + 8, p.x, p.y, 0.11, 0.002, 0.9, footprint);
    const double algae = synth_step(0.0, 0.9, synth_fbm2(seed + 16, p.x, p.y, 0.8, 0.02, 0.75, footprint));
    v3 colour = v3_scale(v3_of(0.47, 0.38, 0.255), synth_clamp(1 + 0.22 * patch + 0.22 * grain, 0.2, 1.8));
    uint32_t which;
    double speck;
    colour = v3_mix(colour, v3_of(0.17, 0.17, 0.085), 0.65 * algae);
    speck = shade_specks(seed + 24, p.x, p.y, 0.11, 0.5, footprint, &which); /* shells and grit */
    colour = v3_mix(colour, which & 3072 ? v3_of(0.15, 0.12, 0.10) : v3_of(0.72, 0.66, 0.58), 0.85 * speck);
    speck = shade_specks(seed + 25, p.y, p.x, 0.031, 0.6, footprint, &which);
    return v3_mix(colour, which & 1024 ? v3_of(0.62, 0.54, 0.46) : v3_of(0.15, 0.12, 0.10), 0.7 * speck);
}

static v3 shade_rock(const struct synth_world *w, v3 p, double footprint)
{
    const uint32_t seed = w->seed + 440;
    const double tone = synth_fbm3(seed, p, 0.5, 0.003, 0.75, footprint);
    const double algae = synth_fbm3(seed + 10, p, 0.6, 0.02, 0.7, footprint);
    const double crust = synth_fbm3(seed + 20, p, 0.35, 0.01, 0.65, footprint);
    v3 colour = v3_scale(v3_of(0.26, 0.23, 0.20), synth_clamp(1 + 0.6 * tone, 0.2, 2));
    colour =
        v3_mix(colour, v3_scale(v3_of(0.20, 0.24, 0.07), 1 + 0.5 * tone), 0.8 * synth_step(0.05, 0.6, algae));
    /* coralline crust */
    colour = v3_mix(colour, v3_of(0.45, 0.20, 0.30), 0.75 * synth_step(0.45, 0.7, crust));
    /* encrusting sponge */
    return v3_mix(colour, v3_of(0.60, 0.35, 0.10), 0.75 * synth_step(0.5, 0.75, -crust));
}

static v3 shade_coral(const struct synth_object *o, v3 p, double footprint)
{
    static const v3 hues[8] = {{0.62, 0.40, 0.12}, {0.58, 0.22, 0.30}, {0.42, 0.24, 0.52},
                               {0.30, 0.42, 0.16}, {0.66, 0.30, 0.10}, {0.55, 0.50, 0.30},
                               {0.25, 0.36, 0.42}, {0.70, 0.52, 0.40}};
    const double up = synth_clamp((p.z - o->centre.z) / o->radius, -1, 1);
    const double tone = synth_fbm3(o->seed, p, 0.12, 0.003, 0.8, footprint);
    const v3 colour = v3_scale(hues[o->seed >> 3 & 7], synth_clamp(1 + 0.3 * tone, 0.3, 1.8));
    if (o->material == SYNTH_BRAIN_CORAL) { /* dark valleys */
        const double maze = fabs(synth_fbm3(o->seed + 9, p, 0.05, 0.02, 0.5, footprint));
        return v3_scale(colour, synth_lerp(0.8, 0.55 + 0.75 * synth_step(0.02, 0.25, maze),
                                           synth_visible_fraction(0.04, footprint)));
    }
    /* pale tips */
    if (o->material == SYNTH_BRANCH_CORAL)
        return v3_mix(colour, v3_of(0.85, 0.80, 0.70), 0.5 * synth_step(0.35, 0.85, up));
    return colour;
}

static v3 shade_starfish(const struct synth_object *o, v3 p, double footprint)
{
    const double dots =
        synth_noise3(o->seed, v3_scale(p, 1 / 0.012)) * synth_visible_fraction(0.012, footprint);
    return v3_mix(o->seed & 64 ? v3_of(0.70, 0.18, 0.06) : v3_of(0.20, 0.22, 0.55), v3_of(0.85, 0.70, 0.5),
                  synth_step(0.15, 0.5, dots));
}

static v3 shade_albedo(const struct synth_world *w, v3 p, struct synth_surface s, double footprint)
{
    switch (s.material) {
    case SYNTH_SAND: return shade_sand(w, p, footprint);
    case SYNTH_ROCK: return shade_rock(w, p, footprint);
    case SYNTH_STARFISH: return shade_starfish(s.object, p, footprint);
    case SYNTH_PEBBLE:
        return v3_scale(
            v3_mix(v3_of(0.40, 0.37, 0.33), v3_of(0.62, 0.48, 0.36), (s.object->seed >> 8 & 255) / 255.),
            (0.5 + 0.8 * (s.object->seed >> 16 & 255) / 255.) *
                (1 + 0.25 * synth_fbm3(s.object->seed, p, 0.03, 0.003, 0.8, footprint)));
    default: return shade_coral(s.object, p, footprint);
    }
}

/* ---------------- light */

/* Returns 0 in shadow, 1 in the sun; the nearest miss over its distance is how much of the sun's disc is
 * covered. */
static double shade_sunlit(const struct synth_world *w, v3 p)
{
    double lit = 1, t = 0.02;
    for (int i = 0; i < 48 && lit > 0.01; i++) {
        const v3 at = v3_along(p, w->sun, t);
        const double d = synth_distance(w, at, NULL);
        if (at.z > w->top || t > 3) break;
        lit = synth_min(lit, 8 * d / t);
        t += synth_clamp(d, 0.01, 1);
    }
    lit = synth_clamp(lit, 0, 1);
    return lit * lit * (3 - 2 * lit);
}

/* Computes ambient occlusion: 1 in the open, less where surfaces along the normal are nearer than on a
 * plane. */
static double shade_open(const struct synth_world *w, v3 p, v3 normal)
{
    static const double reach[2] = {0.05, 0.2}, fraction[2] = {0.45, 0.5};
    double open = 1;
    for (int i = 0; i < 2; i++) {
        const double d = synth_distance(w, v3_along(p, normal, reach[i]), NULL);
        /* 0.75: distances to the ground are cautious */
        open -= fraction[i] * (1 - synth_clamp(d / (0.75 * reach[i]), 0, 1));
    }
    return synth_clamp(open, 0.1, 1);
}

static double shade_display(double light)
{
    /* a soft shoulder, then the usual gamma */
    return pow(synth_clamp(1.03 * light / (0.25 * light + 0.9), 0, 1), 1 / 2.2);
}

/* sun: cosine of its angle to the sun, 0 in the shade; open: fraction of the sky that the surface sees. */
static v3 shade_light(v3 albedo, v3 normal, double sun, double open)
{
    v3 light = v3_scale(v3_of(1.25, 1.15, 0.98), sun);
    light = v3_along(light, v3_of(0.36, 0.46, 0.50), open * (0.5 + 0.5 * normal.z));
    light = v3_along(light, v3_of(0.16, 0.13, 0.09), open * (0.5 - 0.5 * normal.z));
    return v3_of(shade_display(light.x * albedo.x), shade_display(light.y * albedo.y),
                 shade_display(light.z * albedo.z));
}

/* Faint sand is dark, too: what light and grain change of it is a fraction of what they change of sand. */
v3 synth_shade(const struct synth_world *w, v3 p, double footprint)
{
    static const v3 faint = {0.30, 0.29, 0.27};
    struct synth_surface surface;
    v3 normal, albedo;
    double sun, open;
    synth_distance(w, p, &surface);
    normal = shade_normal(w, p, surface.material, footprint);
    albedo = shade_albedo(w, p, surface, footprint);
    open = shade_open(w, p, normal);
    sun = synth_max(0, v3_dot(normal, w->sun));
    if (sun > 0) sun *= shade_sunlit(w, v3_along(p, normal, 0.004));
    albedo = shade_light(albedo, normal, sun, open);
    return surface.material == SYNTH_SAND && w->sand_contrast < 1 ? v3_mix(faint, albedo, w->sand_contrast)
                                                                  : albedo;
}
