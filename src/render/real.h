/* real.h - the number type of the kernels and its arithmetic, which vectorises and needs no libm.
 *
 * `real` is float in the library. tests/wide_kernels.c compiles the kernels with real = double
 * (OXL_REFERENCE), to measure the error of float.
 */
#ifndef OXL_REAL_H
#define OXL_REAL_H

#include "../core/core.h"
#include "../core/simd.h"

#ifndef OXL_REFERENCE
#define real float
#endif

SIMD_INLINE real real_sqrt(real x)
{
#ifdef OXL_REFERENCE
    return sqrt(x);
#else
    return sqrtf(x);
#endif
}

SIMD_INLINE real real_abs(real x)
{
#ifdef OXL_REFERENCE
    return fabs(x);
#else
    return fabsf(x);
#endif
}

/* The smaller of two non-negative numbers, compared as integers, which every compiler vectorises. */
SIMD_INLINE real real_least(real a, real b)
{
#ifdef OXL_REFERENCE
    return a < b ? a : b;
#else
    int32_t x, y;
    memcpy(&x, &a, sizeof x);
    memcpy(&y, &b, sizeof y);
    x = x < y ? x : y;
    memcpy(&a, &x, sizeof a);
    return a;
#endif
}

/* a b + c, rounded once where the target fuses. */
SIMD_INLINE real muladd(const int fused, real a, real b, real c)
{
#ifdef OXL_REFERENCE
    (void)fused;
    return a * b + c;
#else
    return fused ? fmaf(a, b, c) : a * b + c;
#endif
}

#ifndef OXL_REFERENCE
/* 2^x as p * 2^whole, x being f + whole. A NaN as arithmetic makes it stays one. */
SIMD_INLINE float real_shifted(float p, float shifted)
{
    int32_t whole, bits;
    memcpy(&whole, &shifted, sizeof whole);
    memcpy(&bits, &p, sizeof bits);
    bits = (int32_t)((uint32_t)bits + ((uint32_t)whole << 23));
    memcpy(&p, &bits, sizeof p);
    return p;
}
#define REAL_SHIFT 12582912.0f /* 1.5 x 2^23: adding it rounds to an integer, left in the low bits */
#endif

/* 2^x for -126 <= x <= 127; anything outside. Relative error 1.0e-7 in float (own minimax polynomial of
 * degree 5, exact at 0). */
SIMD_INLINE real real_exp2(const int fused, real x)
{
#ifdef OXL_REFERENCE
    (void)fused;
    return exp2(x);
#else
    const float shifted = x + REAL_SHIFT;
    const float f = x - (shifted - REAL_SHIFT); /* [-1/2, 1/2], exact */
    float p = 0.00132647273f;
    p = muladd(fused, p, f, 0.00967151277f);
    p = muladd(fused, p, f, 0.0555073374f);
    p = muladd(fused, p, f, 0.240222421f);
    p = muladd(fused, p, f, 0.693146978f);
    p = muladd(fused, p, f, 1.0f);
    return real_shifted(p, shifted);
#endif
}

/* e^x, clamped to the range of normal numbers. Relative error 2e-7 in float where the target fuses. */
SIMD_INLINE real real_exp(const int fused, real x)
{
#ifdef OXL_REFERENCE
    (void)fused;
    return exp(x);
#else
    /* log2 e in two parts: the product's rounding would cost 1e-6 at x = 20 */
    const float high = 1.44269502f, low = 1.92596299e-8f;
    const float inside = OXL_CLAMP(x, -87.0f, 88.0f);
    /* a variable, so that excess precision is rounded to float */
    const float shifted = inside * high + REAL_SHIFT;
    const float n = shifted - REAL_SHIFT;
    const float f = muladd(fused, inside, low, muladd(fused, inside, high, -n));
    return real_shifted(real_exp2(fused, f), shifted);
#endif
}

/* log2 x for normal x > 0. Absolute error 5e-8 times max(1, |log2 x|) in float (own minimax polynomial of
 * degree 8). */
SIMD_INLINE real real_log2(const int fused, real x)
{
#ifdef OXL_REFERENCE
    (void)fused;
    return log2(x);
#else
    int32_t bits, exponent;
    float m, p = 0.125837037f;
    memcpy(&bits, &x, sizeof bits);
    bits &= 0x7FFFFFFF;                   /* compilers differ in the sign of NaN */
    exponent = (bits - 0x3F3504F3) >> 23; /* mantissa from sqrt(1/2) to sqrt(2) */
    bits -= exponent * (1 << 23);
    memcpy(&m, &bits, sizeof m);
    m -= 1.0f;
    p = muladd(fused, p, m, -0.207269816f);
    p = muladd(fused, p, m, 0.215715631f);
    p = muladd(fused, p, m, -0.238944814f);
    p = muladd(fused, p, m, 0.287916245f);
    p = muladd(fused, p, m, -0.360703683f);
    p = muladd(fused, p, m, 0.480910643f);
    p = muladd(fused, p, m, -0.721347347f);
    p = muladd(fused, p, m, 1.442695f);
    return muladd(fused, p, m, (float)exponent);
#endif
}

/* ---------------- small vectors, by value: the compiler keeps them in registers */

struct vec3 {
    real x, y, z;
    /* more than 16 bytes: clang passes smaller structs packed in a register and then cannot vectorise over
     * lanes */
    real unused[2];
};
struct mat3 { /* rows */
    struct vec3 x, y, z;
};

SIMD_INLINE struct vec3 vec3(real x, real y, real z)
{
    struct vec3 v;
    v.x = x, v.y = y, v.z = z;
    return v;
}
SIMD_INLINE real dot3(struct vec3 a, struct vec3 b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}
SIMD_INLINE struct vec3 cross3(struct vec3 a, struct vec3 b)
{
    return vec3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}
SIMD_INLINE struct vec3 subtract3(struct vec3 a, struct vec3 b)
{
    return vec3(a.x - b.x, a.y - b.y, a.z - b.z);
}
SIMD_INLINE struct vec3 scale3(real s, struct vec3 a)
{
    return vec3(s * a.x, s * a.y, s * a.z);
}
SIMD_INLINE struct vec3 add3(struct vec3 a, struct vec3 b)
{
    return vec3(a.x + b.x, a.y + b.y, a.z + b.z);
}
SIMD_INLINE struct vec3 multiply3(struct vec3 a, struct vec3 b) /* element by element */
{
    return vec3(a.x * b.x, a.y * b.y, a.z * b.z);
}
/* The largest absolute value of a vector, or `least`, if that is larger. */
SIMD_INLINE real most3(struct vec3 a, real least)
{
    least = real_abs(a.x) > least ? real_abs(a.x) : least;
    least = real_abs(a.y) > least ? real_abs(a.y) : least;
    return real_abs(a.z) > least ? real_abs(a.z) : least;
}
SIMD_INLINE struct vec3 mat3_times(struct mat3 m, struct vec3 v)
{
    return vec3(dot3(m.x, v), dot3(m.y, v), dot3(m.z, v));
}
SIMD_INLINE struct vec3 mat3_transposed_times(struct mat3 m, struct vec3 v)
{
    return add3(add3(scale3(v.x, m.x), scale3(v.y, m.y)), scale3(v.z, m.z));
}

#endif
