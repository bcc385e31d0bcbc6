/* math.h - what splat.c needs of libm, the same bits everywhere: exp, log, sin and cos are the trainer's own (src/core/vecmath.h).
 *
 * In WebAssembly there is no libm. The native build that the page is compared with uses this file, too: training amplifies a
 * difference in the last bit, and after some steps the numbers would differ.
 */
#ifndef COURSE_MATH_H
#define COURSE_MATH_H

#define HUGE_VAL __builtin_huge_val()
#define NAN      __builtin_nanf("")
/* Exact or rounded once, so the same everywhere. Macros: a function named sqrt would be what the compiler calls for the builtin. */
#define fabs(x)    __builtin_fabs(x)
#define sqrt(x)    __builtin_sqrt(x)
#define rint(x)    __builtin_rint(x)
#define floor(x)   __builtin_floor(x)
#define fmod(a, b) ((a) - (b)*__builtin_trunc((a) / (b)))

#include "../../../src/core/vecmath.h"

#define exp(x)      vecmath_exp(x)
#define log(x)      vecmath_log(x)
#define sin(x)      vecmath_sin(x)
#define cos(x)      vecmath_cos(x)
#define log10(x)    (vecmath_log(x) / 2.30258509299404568402)
#define hypot(a, b) course_hypot(a, b)
#define fmin(a, b)  course_fmin(a, b)
#define fmax(a, b)  course_fmax(a, b)
#define pow(a, b)   course_pow(a, b)
#define atan2(y, x) course_atan2(y, x)

static inline double course_hypot(double a, double b) { return sqrt(a * a + b * b); }
static inline double course_fmin(double a, double b) { return a < b || b != b ? a : b; }
static inline double course_fmax(double a, double b) { return a > b || b != b ? a : b; }

/* a^b for a > 0: whole powers by squaring, others as exp(b log a). */
static inline double course_pow(double a, double b) {
    double result = 1, factor = a;
    if (b != floor(b) || b < 0 || b > 1e9) return exp(b * log(a));
    for (unsigned n = (unsigned)b; n; n >>= 1, factor *= factor)
        if (n & 1) result *= factor;
    return result;
}

/* -pi..pi: a coarse start, corrected by Newton steps through sin and cos. */
static inline double course_atan2(double y, double x) {
    const double r = hypot(x, y), slope = fabs(y) / (r + fabs(x)), side = y < 0 ? -1 : 1;
    double angle = side * (x >= 0 ? 2 * slope : 3.14159265358979323846 - 2 * slope);
    if (r == 0) return 0;
    for (int i = 0; i < 5; i++) angle += (y * cos(angle) - x * sin(angle)) / r;
    return angle;
}
#endif
