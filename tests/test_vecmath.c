/* test_vecmath.c - our exp, log, sin, cos against libm's, and at the ends of the range. */
#include "test.h"

/* Bounds: ours is within 1 ulp (2.2e-16) and libm within another. */
#define VECMATH_BOUND 4.5e-16

static double vecmath_test_unit(uint64_t stream, uint64_t i)
{
    return random_unit(random_bits(7, stream, i));
}

static int vecmath_test_close(double a, double wanted)
{
    return fabs(a - wanted) <= VECMATH_BOUND * fabs(wanted);
}

TEST(vecmath_exp_agrees_with_libm_over_all_normal_results)
{
    int wrong = 0;
    for (uint64_t i = 0; i < 200000; i++) {
        const double x = i % 2 ? -708 + 1417 * vecmath_test_unit(1, i) : 4 * vecmath_test_unit(1, i) - 2;
        wrong += !vecmath_test_close(vecmath_exp(x), exp(x));
    }
    CHECK(wrong == 0 && vecmath_exp(0) == 1);
}

TEST(vecmath_exp_ends_in_subnormals_zero_infinity_and_nan)
{
    for (int i = 0; i < 2000; i++) { /* the last bit of the least numbers */
        const double x = -746 + 0.02 * i;
        CHECK(fabs(vecmath_exp(x) - exp(x)) <= 4.95e-324 + VECMATH_BOUND * exp(x));
    }
    CHECK(vecmath_exp(-745) == exp(-745) && vecmath_exp(-745) > 0);
    CHECK(vecmath_exp(-746) == 0 && vecmath_exp(-1e300) == 0 && vecmath_exp(-INFINITY) == 0);
    CHECK(vecmath_test_close(vecmath_exp(709.78), exp(709.78)));
    CHECK(vecmath_exp(709.79) == INFINITY && vecmath_exp(710) == INFINITY &&
          vecmath_exp(INFINITY) == INFINITY);
    CHECK(isnan(vecmath_exp(NAN)));
}

TEST(vecmath_log_agrees_with_libm_near_one_and_far_from_it)
{
    int wrong = 0;
    for (uint64_t i = 0; i < 200000; i++) {
        const double u = vecmath_test_unit(2, i), x = i % 3 == 0   ? 2 * u
                                                      : i % 3 == 1 ? exp(1449 * u - 740)
                                                                   : 1 + 1e-6 * (u - 0.5);
        wrong += x > 0 && !vecmath_test_close(vecmath_log(x), log(x));
    }
    CHECK(wrong == 0 && vecmath_log(1) == 0 && vecmath_test_close(vecmath_log(4.94e-324), log(4.94e-324)));
    CHECK(vecmath_test_close(vecmath_log(DBL_MAX), log(DBL_MAX)));
}

TEST(vecmath_log_of_zero_negative_infinite_and_nan_is_as_in_c)
{
    CHECK(vecmath_log(0) == -INFINITY && vecmath_log(-0.0) == -INFINITY);
    CHECK(isnan(vecmath_log(-1)) && isnan(vecmath_log(-INFINITY)) && isnan(vecmath_log(NAN)));
    CHECK(vecmath_log(INFINITY) == INFINITY);
}

TEST(vecmath_sin_and_cos_agree_with_libm_up_to_a_million)
{
    double worst = 0, worst_far = 0;
    for (uint64_t i = 0; i < 200000; i++) {
        const double u = vecmath_test_unit(3, i) - 0.5,
                     x = u * (i % 3 == 0   ? 10
                              : i % 3 == 1 ? 1000
                                           : 2e6),
                     far = u * 2e9;
        worst = OXL_MAX(worst, fabs(vecmath_sin(x) - sin(x)));
        worst = OXL_MAX(worst, fabs(vecmath_cos(x) - cos(x)));
        worst_far = OXL_MAX(worst_far, fabs(vecmath_sin(far) - sin(far)) / fabs(far));
    }
    CHECK(worst < 3e-16 && worst_far < 4.1e-17 && vecmath_sin(0) == 0 && vecmath_cos(0) == 1);
    CHECK(isnan(vecmath_sin(INFINITY)) && isnan(vecmath_cos(-INFINITY)) && isnan(vecmath_sin(NAN)));
    CHECK(fabs(vecmath_cos(1e300)) <= 1);
}

TEST(vecmath_sigmoid_keeps_its_digits_at_both_ends_and_logit_undoes_it)
{
    CHECK(vecmath_test_close(vecmath_sigmoid(-700), exp(-700)));
    CHECK(vecmath_sigmoid(-1000) == 0 && vecmath_sigmoid(1000) == 1 && vecmath_sigmoid(0) == 0.5);
    CHECK(isnan(vecmath_sigmoid(NAN)));
    for (double x = -30; x <= 15; x += 0.37) CHECK_CLOSE(vecmath_logit(vecmath_sigmoid(x)), x, 1e-9);
    CHECK(vecmath_logit(0) == -INFINITY && vecmath_logit(1) == INFINITY && isnan(vecmath_logit(1.5)));
}

/* Cast to a whole number it would be undefined, as the sanitizer says of the line without its guard. */
TEST(kernel_exp_of_nan_is_nan)
{
    CHECK(isnan(real_exp(0, NAN)) && isnan(real_exp(1, NAN)));
    CHECK(real_exp(0, -INFINITY) < 1e-37f && real_exp(0, INFINITY) > 1e38f);
}

/* ---------------- eigen.h */

/* A symmetric matrix from rows of random extents: kind 0 all the same, so that it is near a multiple of the
 * identity; 1 a plane; 2 a line. */
static void eigen_test_matrix(uint64_t i, double scale, double a[3][3])
{
    const double extent[3] = {1, i % 3 == 2 ? 1e-9 : 1, i % 3 == 0 ? 1 : 1e-9};
    double m[3][3];
    for (int k = 0; k < 9; k++)
        m[k / 3][k % 3] =
            extent[k / 3] * (i % 3 == 0 ? k % 4 == 0 ? 1 : 1e-8 * vecmath_test_unit(31, 9 * i + (uint64_t)k)
                                        : 2 * vecmath_test_unit(31, 9 * i + (uint64_t)k) - 1);
    memset(a, 0, 9 * sizeof(double));
    for (int j = 0; j < 27; j++) a[j / 9][j / 3 % 3] += scale * m[j % 3][j / 9] * m[j % 3][j / 3 % 3];
}

TEST(eigenvectors_are_orthonormal_and_are_only_stretched)
{
    double worst = 0, sum;
    for (uint64_t i = 0; i < 3000; i++) {
        const double scale = vecmath_power_of_two((int)(i % 800) - 400);
        double a[3][3], b[3][3], v[3][3];
        eigen_test_matrix(i, scale, a);
        memcpy(b, a, sizeof a);
        eigen_symmetric(b, v);
        for (int r = 0; r < 3; r++)
            for (int k = 0; k < 3; k++) {
                sum = -b[r][r] * v[r][k];
                for (int j = 0; j < 3; j++) sum += a[k][j] * v[r][j];
                worst = OXL_MAX(worst, fabs(sum) / scale);
                sum = v[r][0] * v[k][0] + v[r][1] * v[k][1] + v[r][2] * v[k][2];
                worst = OXL_MAX(worst, fabs(sum - (r == k)));
            }
    }
    CHECK(worst < 1e-14);
}

TEST(eigenvectors_of_a_diagonal_or_zero_matrix_are_the_axes)
{
    for (int zero = 0; zero < 2; zero++) {
        double a[3][3] = {{zero ? 0 : 3, 0, 0}, {0, zero ? 0 : 1, 0}, {0, 0, zero ? 0 : 2}}, v[3][3];
        eigen_symmetric(a, v);
        for (int k = 0; k < 9; k++) CHECK(v[k / 3][k % 3] == (k % 4 == 0));
    }
    CHECK(eigen_is_backward((const double[]){0.5, -0.8, 0.1}) &&
          !eigen_is_backward((const double[]){-0.5, 0.8, 0.1}));
}
