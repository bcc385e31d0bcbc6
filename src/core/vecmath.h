/* vecmath.h - computes exp, log, sin, cos, sigmoid and logit in double, with the same bits everywhere.
 *
 * libm's functions differ between machines and versions, so training does not call them. These use only + - *
 * /, casts and bit operations, which IEEE 754 defines exactly without contraction (-ffp-contract=off).
 *
 * Sources: range reduction after Cody & Waite 1980; the series preserve the rounding of the leading term.
 * tests/test_vecmath.c compares with libm; "ulp" is 2.2e-16 of the value.
 */
#ifndef OXL_VECMATH_H
#define OXL_VECMATH_H

#include <math.h>
#include <stdint.h>
#include <string.h>

#define VECMATH_LN2 0.6931471805599453
/* Holds ln 2 cut to 32 bits, so that k times it is exact. */
#define VECMATH_LN2_HIGH 6.93147180369123816490e-01
#define VECMATH_LN2_LOW 1.90821492927058770002e-10 /* Holds ln 2 less VECMATH_LN2_HIGH. */
/* Holds 10 / ln 10, the dB of a factor e: PSNR = -this x ln(mean square error). */
#define VECMATH_DECIBEL_OF_E 4.342944819032518

static inline double vecmath_from_bits(uint64_t bits)
{
    double x;
    memcpy(&x, &bits, sizeof x);
    return x;
}

static inline uint64_t vecmath_to_bits(double x)
{
    uint64_t bits;
    memcpy(&bits, &x, sizeof bits);
    return bits;
}

static inline double vecmath_power_of_two(int k) /* -1022 <= k <= 1023 */
{
    return vecmath_from_bits((uint64_t)(k + 1023) << 52);
}

/* Computes e^x within 1 ulp; 2^k e^r with |r| <= ln 2 / 2. Subnormal results are rounded once. */
static inline double vecmath_exp(double x)
{
    double r, p;
    int k;
    /* Leaves infinity for results past the largest double, whose ln is 709.78. */
    if (!(x < 710.0)) return x != x ? x : HUGE_VAL;
    if (x < -746.0) return 0;
    k = (int)(x * 1.44269504088896340736 + (x < 0 ? -0.5 : 0.5)); /* 1 / ln 2 */
    r = (x - k * VECMATH_LN2_HIGH) - k * VECMATH_LN2_LOW;
    p = 1.0 / 6227020800; /* Taylor series to r^13/13!; the rest is below 1e-17 */
    p = p * r + 1.0 / 479001600;
    p = p * r + 1.0 / 39916800;
    p = p * r + 1.0 / 3628800;
    p = p * r + 1.0 / 362880;
    p = p * r + 1.0 / 40320;
    p = p * r + 1.0 / 5040;
    p = p * r + 1.0 / 720;
    p = p * r + 1.0 / 120;
    p = p * r + 1.0 / 24;
    p = p * r + 1.0 / 6;
    p = p * r + 0.5;
    p = 1 + (r + r * r * p);
    /* Multiplies in two steps, since k reaches 1024 and -1076. */
    return p * vecmath_power_of_two(k / 2) * vecmath_power_of_two(k - k / 2);
}

/* Computes the natural logarithm within 1 ulp; -inf at 0, NaN below. x = 2^k (1 + f) with 1 + f between
 * sqrt(1/2) and sqrt(2); log(1 + f) = 2 atanh(s) with s = f / (2 + f), written as f - f^2/2 + s (f^2/2 + R)
 * so that f itself is not rounded. */
static inline double vecmath_log(double x)
{
    uint64_t bits;
    int k = 0;
    double f, s, z, r, half;
    if (x != x || x == HUGE_VAL) return x;
    if (x <= 0) return x == 0 ? -HUGE_VAL : (double)NAN;
    if (x < 2.2250738585072014e-308) { /* subnormal */
        x *= 18014398509481984.0;      /* 2^54 */
        k = -54;
    }
    bits = vecmath_to_bits(x);
    k += (int)(bits >> 52) - 1023;
    f = vecmath_from_bits((bits & UINT64_C(0xFFFFFFFFFFFFF)) | UINT64_C(0x3FF0000000000000)); /* 1..2 */
    if (f > 1.41421356237309504880) {
        f *= 0.5;
        k++;
    }
    f -= 1;
    s = f / (2 + f);
    z = s * s;
    r = 2.0 / 21; /* series 2 s^2/3 + 2 s^4/5 + ...; the rest is below 1e-18 */
    r = r * z + 2.0 / 19;
    r = r * z + 2.0 / 17;
    r = r * z + 2.0 / 15;
    r = r * z + 2.0 / 13;
    r = r * z + 2.0 / 11;
    r = r * z + 2.0 / 9;
    r = r * z + 2.0 / 7;
    r = r * z + 2.0 / 5;
    r = r * z + 2.0 / 3;
    r *= z;
    half = 0.5 * f * f;
    return k * VECMATH_LN2_HIGH - ((half - (s * (half + r) + k * VECMATH_LN2_LOW)) - f);
}

/* Splits x into quarter turns (pi/2) and a rest; pi/2 is cut into three pieces of 33 bits, so that |quarter|
 * < 2^20 times each is exact. */
static inline int vecmath_quarters(double x, double *rest)
{
    const double turn = 6.28318530717958647693;
    double quarter;
    if (!(fabs(x) < 1e6)) x = fmod(x, turn); /* exact for the rounded value of 2 pi; NaN for infinity */
    if (x != x) {
        *rest = x;
        return 0;
    }
    quarter = (double)(int)(x * 0.63661977236758134308 + (x < 0 ? -0.5 : 0.5));
    *rest = x - quarter * 1.57079632673412561417e+00;
    *rest = *rest - quarter * 6.07710050630396597660e-11;
    *rest = *rest - quarter * 2.02226624879595063154e-21;
    return (int)quarter & 3;
}

static inline double vecmath_sin_rest(double x) /* |x| <= pi/4; the next term is below 1e-17 */
{
    const double z = x * x;
    double p = -1.0 / 1307674368000.0; /* 15! */
    p = p * z + 1.0 / 6227020800.0;
    p = p * z - 1.0 / 39916800;
    p = p * z + 1.0 / 362880;
    p = p * z - 1.0 / 5040;
    p = p * z + 1.0 / 120;
    p = p * z - 1.0 / 6;
    return x + x * z * p;
}

static inline double vecmath_cos_rest(double x)
{
    const double z = x * x;
    double p = 1.0 / 20922789888000.0; /* 16! */
    p = p * z - 1.0 / 87178291200.0;
    p = p * z + 1.0 / 479001600;
    p = p * z - 1.0 / 3628800;
    p = p * z + 1.0 / 40320;
    p = p * z - 1.0 / 720;
    p = p * z + 1.0 / 24;
    return 1 - (0.5 * z - z * z * p);
}

/* Computes sin x with an absolute error below 3e-16 for |x| < 1e6; beyond, the error grows as 4e-17 |x|. */
static inline double vecmath_sin(double x)
{
    double r;
    const int quarter = vecmath_quarters(x, &r);
    const double y = quarter & 1 ? vecmath_cos_rest(r) : vecmath_sin_rest(r);
    return quarter & 2 ? -y : y;
}

static inline double vecmath_cos(double x)
{
    double r;
    const int quarter = vecmath_quarters(x, &r);
    const double y = quarter & 1 ? vecmath_sin_rest(r) : vecmath_cos_rest(r);
    return (quarter + 1) & 2 ? -y : y;
}

/* Computes 1 / (1 + e^-x) without overflow and without cancellation near 0. */
static inline double vecmath_sigmoid(double x)
{
    const double e = vecmath_exp(x < 0 ? x : -x);
    return (x < 0 ? e : 1) / (1 + e);
}

/* Computes the inverse of vecmath_sigmoid; -inf at 0, inf at 1, NaN outside. */
static inline double vecmath_logit(double p)
{
    return vecmath_log(p / (1 - p));
}

#endif
