/* synth_math.h - vectors and noise for the synthetic survey.
 *
 * Noise is Perlin's gradient noise (Perlin 2002: quintic interpolation) on a hashed lattice; it needs no
 * tables that a seed would have to shuffle. Invariant: every value is a pure function of its arguments, so
 * pixels and points may be computed in any order, by any number of threads.
 */
#ifndef SYNTH_MATH_H
#define SYNTH_MATH_H

#include <math.h>
#include <stdint.h>

#define SYNTH_PI 3.14159265358979323846

typedef struct v3 {
    double x, y, z;
} v3;

static inline v3 v3_of(double x, double y, double z)
{
    return (v3){x, y, z};
}
static inline v3 v3_add(v3 a, v3 b)
{
    return v3_of(a.x + b.x, a.y + b.y, a.z + b.z);
}
static inline v3 v3_sub(v3 a, v3 b)
{
    return v3_of(a.x - b.x, a.y - b.y, a.z - b.z);
}
static inline v3 v3_scale(v3 a, double s)
{
    return v3_of(a.x * s, a.y * s, a.z * s);
}
/* Multiplies element by element, as light by colour. */
static inline v3 v3_times(v3 a, v3 b)
{
    return v3_of(a.x * b.x, a.y * b.y, a.z * b.z);
}
static inline v3 v3_along(v3 a, v3 direction, double t)
{
    return v3_add(a, v3_scale(direction, t));
}
static inline double v3_dot(v3 a, v3 b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}
static inline v3 v3_cross(v3 a, v3 b)
{
    return v3_of(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}
static inline double v3_length(v3 a)
{
    return sqrt(v3_dot(a, a));
}
static inline v3 v3_unit(v3 a)
{
    return v3_scale(a, 1 / v3_length(a));
}
/* Multiplies by the matrix of these rows. */
static inline v3 v3_turn(const v3 rows[3], v3 p)
{
    return v3_of(v3_dot(rows[0], p), v3_dot(rows[1], p), v3_dot(rows[2], p));
}
static inline v3 v3_mix(v3 a, v3 b, double t)
{
    return v3_add(v3_scale(a, 1 - t), v3_scale(b, t));
}

static inline double synth_min(double a, double b)
{
    return a < b ? a : b;
}
static inline double synth_max(double a, double b)
{
    return a > b ? a : b;
}
static inline double synth_clamp(double x, double low, double high)
{
    return x < low ? low : x > high ? high : x;
}
/* Rises smoothly from 0 before a to 1 after b. */
static inline double synth_step(double a, double b, double x)
{
    const double t = synth_clamp((x - a) / (b - a), 0, 1);
    return t * t * (3 - 2 * t);
}

/* Draw random numbers without state, each a function of a seed and two numbers, by the finaliser of splitmix64
 * (Steele, Lea & Flood 2014). */
static inline uint64_t synth_mix(uint64_t x)
{
    x += UINT64_C(0x9E3779B97F4A7C15);
    x = (x ^ (x >> 30)) * UINT64_C(0xBF58476D1CE4E5B9);
    x = (x ^ (x >> 27)) * UINT64_C(0x94D049BB133111EB);
    return x ^ (x >> 31);
}
static inline uint64_t synth_bits(uint64_t seed, uint64_t a, uint64_t b)
{
    return synth_mix(synth_mix(synth_mix(seed) ^ a) ^ b);
}
static inline double synth_unit(uint64_t bits) /* [0,1) */
{
    return (double)(bits >> 11) * (1.0 / 9007199254740992.0); /* 2^-53 */
}

/* Draws a standard normal number (Box & Muller 1958). */
static inline double synth_random_normal(uint64_t bits)
{
    const double radius = sqrt(-2 * log(1 - synth_unit(bits)));
    return radius * cos(2 * SYNTH_PI * synth_unit(synth_mix(bits)));
}

/* ---------------- noise */

static inline uint32_t synth_lattice(uint32_t seed, int x, int y, int z)
{
    uint32_t h = seed ^ (uint32_t)x * 0x27d4eb2du ^ (uint32_t)y * 0x165667b1u ^ (uint32_t)z * 0x9e3779b1u;
    h = (h ^ (h >> 15)) * 0x2c1b3c6du;
    h = (h ^ (h >> 12)) * 0x297a2d39u;
    return h ^ (h >> 15);
}
static inline int synth_floor(double x) /* without a call */
{
    const int i = (int)x;
    return i - (x < i);
}
static inline double synth_fade(double t)
{
    return t * t * t * (t * (t * 6 - 15) + 10);
}
static inline double synth_lerp(double a, double b, double t)
{
    return a + (b - a) * t;
}

/* Multiplies one of 8 directions by (x, y). */
static inline double synth_corner2(uint32_t h, double x, double y)
{
    const double u = h & 1 ? x : -x, v = h & 2 ? y : -y;
    return h & 4 ? u + 0.5 * v : 0.5 * u + v;
}
/* Returns noise of about -1..1 and wavelength 1. */
static inline double synth_noise2(uint32_t seed, double x, double y)
{
    const int ix = synth_floor(x), iy = synth_floor(y);
    const double fx = x - ix, fy = y - iy, u = synth_fade(fx), v = synth_fade(fy);
    const double a = synth_corner2(synth_lattice(seed, ix, iy, 0), fx, fy);
    const double b = synth_corner2(synth_lattice(seed, ix + 1, iy, 0), fx - 1, fy);
    const double c = synth_corner2(synth_lattice(seed, ix, iy + 1, 0), fx, fy - 1);
    const double d = synth_corner2(synth_lattice(seed, ix + 1, iy + 1, 0), fx - 1, fy - 1);
    return 1.35 * synth_lerp(synth_lerp(a, b, u), synth_lerp(c, d, u), v);
}

/* Multiplies one of the 12 edges of a cube, as Perlin 2002, by (x, y, z). */
static inline double synth_corner3(uint32_t h, double x, double y, double z)
{
    const uint32_t k = h & 15;
    const double u = k < 8 ? x : y, v = k < 4 ? y : k == 12 || k == 14 ? x : z;
    return (k & 1 ? -u : u) + (k & 2 ? -v : v);
}
static inline double synth_noise3(uint32_t seed, v3 p)
{
    const int x = synth_floor(p.x), y = synth_floor(p.y), z = synth_floor(p.z);
    const double fx = p.x - x, fy = p.y - y, fz = p.z - z;
    const double u = synth_fade(fx), v = synth_fade(fy), w = synth_fade(fz);
    double plane[2];
    for (int k = 0; k < 2; k++) {
        const double a = synth_corner3(synth_lattice(seed, x, y, z + k), fx, fy, fz - k);
        const double b = synth_corner3(synth_lattice(seed, x + 1, y, z + k), fx - 1, fy, fz - k);
        const double c = synth_corner3(synth_lattice(seed, x, y + 1, z + k), fx, fy - 1, fz - k);
        const double d = synth_corner3(synth_lattice(seed, x + 1, y + 1, z + k), fx - 1, fy - 1, fz - k);
        plane[k] = synth_lerp(synth_lerp(a, b, u), synth_lerp(c, d, u), v);
    }
    return synth_lerp(plane[0], plane[1], w);
}

/* Returns how much of a wave of this length survives in pixels this wide: none under two pixels, all from
 * four on. */
static inline double synth_visible_fraction(double wavelength, double footprint)
{
    return synth_clamp(0.5 * wavelength / footprint - 1, 0, 1);
}

/* Sums of octaves from `wavelength` (metres) down to `finest`, each `gain` times the one before; octaves
 * finer than the pixel
 * (footprint, metres) fade out instead of flickering. The turn by 37 degrees keeps lattices from lining up.
 * solid: 0 in a plane. */
static inline double synth_fbm(int solid, uint32_t seed, v3 p, double wavelength, double finest, double gain,
                               double footprint)
{
    double sum = 0, amplitude = 1;
    for (double w = wavelength; w >= finest; w *= 0.47) {
        const double fraction = synth_visible_fraction(w, footprint);
        if (fraction <= 0) break;
        sum += amplitude * fraction *
               (solid ? synth_noise3(seed, v3_scale(p, 1 / w)) : synth_noise2(seed, p.x / w, p.y / w));
        p = v3_of(0.8 * p.x - 0.6 * p.y, 0.6 * p.x + 0.8 * p.y, p.z + 0.37 * w);
        amplitude *= gain;
        seed++;
    }
    return sum;
}
static inline double synth_fbm2(uint32_t seed, double x, double y, double wavelength, double finest,
                                double gain, double footprint)
{
    return synth_fbm(0, seed, v3_of(x, y, 0), wavelength, finest, gain, footprint);
}
static inline double synth_fbm3(uint32_t seed, v3 p, double wavelength, double finest, double gain,
                                double footprint)
{
    return synth_fbm(1, seed, p, wavelength, finest, gain, footprint);
}

#endif
