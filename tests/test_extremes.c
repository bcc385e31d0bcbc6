/* test_extremes.c - the quick rows of docs/STABILITY.md: float against double within the stated bounds. */
#include "test.h"
#include "extreme_runs.c"

TEST(extremes_are_rendered_and_differentiated_within_the_stated_bounds)
{
    for (size_t i = 0; i < OXL_COUNT(EXTREMES); i++) {
        struct extreme_result r;
        if (EXTREMES[i].is_slow) continue;
        extreme_run(test_ctx, &EXTREMES[i], &r);
        test_case = EXTREMES[i].what;
        CHECK(extreme_holds(&EXTREMES[i], &r));
    }
}

TEST(extremes_of_the_loss_and_the_optimiser_stay_within_the_stated_bounds)
{
    for (size_t i = 0; i < OXL_COUNT(EXTREME_LOSSES); i++) {
        struct extreme_error error;
        double value;
        extreme_run_loss(test_ctx, &EXTREME_LOSSES[i], &value, &error);
        CHECK(error.finite);
        CHECK_CLOSE(value, 0, EXTREME_LOSSES[i].value);
        CHECK_CLOSE(error.most, 0, EXTREME_LOSSES[i].gradient);
    }
    for (size_t i = 0; i < OXL_COUNT(EXTREME_ADAMS); i++) {
        struct extreme_adam e = EXTREME_ADAMS[i];
        const struct extreme_error error =
            (e.steps = OXL_MIN(e.steps, 20000), extreme_run_adam(test_ctx, &e));
        CHECK(error.finite);
        CHECK_CLOSE(error.most, 0, e.bound);
    }
}

TEST(extremes_a_survey_shifted_or_scaled_trains_to_the_same_image_and_a_degenerate_one_stays_finite)
{
    OWNED_MEMORY float *plain = oxl_alloc(test_ctx, EXTREME_VALUES, sizeof *plain);
    CHECK(extreme_train(test_ctx, &EXTREME_SURVEYS[0], test_path("0"), plain));
    for (size_t i = 1; i < OXL_COUNT(EXTREME_SURVEYS); i++) {
        char name[16];
        const struct extreme_error error =
            (snprintf(name, sizeof name, "%zu", i),
             extreme_run_survey(test_ctx, &EXTREME_SURVEYS[i], test_path(name), plain));
        test_case = EXTREME_SURVEYS[i].what;
        CHECK(extreme_survey_holds(&EXTREME_SURVEYS[i], &error));
    }
}
