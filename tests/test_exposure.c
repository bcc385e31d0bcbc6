/* test_exposure.c - when the tracks show that images need gains. */
#include "test.h"
#include "../src/parts/exposure.h"

/* Gains of the tracks of 8 views: a slow wave, and what jumps from view to view. */
static int exposure_test_takes(double wave, double jump, double unexplained, int parts)
{
    struct exposure e = {.mode = OXL_AUTO, .of = imaging_test_make(8, NULL, 0)};
    struct photometry p = {.points = 100,
                           .observations = 900,
                           .parts = parts,
                           .unexplained = unexplained,
                           .residual = 0.01,
                           .brightness = 0.5};
    float gain[24];
    uint8_t fitted[8] = {7, 7, 7, 7, 7, 7, 7, 7};
    char why[400];
    for (int i = 0; i < 24; i++) gain[i] = (float)(wave * cos(0.8 * (i / 3)) + (i / 3 % 2 ? jump : -jump));
    p.log_gain = gain, p.fitted = fitted;
    exposure_set_from_tracks(&e, &p, why, sizeof why);
    int on = e.of.on;
    imaging_free(test_ctx, &e.of);
    return on;
}

/* The neighbours of the wave of 0.1 predict it to 0.031; what they explain must be 1.5 times 0.02, what the
 * tracks' colours leave, or 3 times what the neighbours leave, which in a wave of 0.02 is 0.0062. */
TEST(exposure_auto_is_on_where_neighbours_predict_gains_better_than_other_views_of_a_place_do)
{
    CHECK(exposure_test_takes(0.1, 0, 0.045, PHOTOMETRY_GAINS));
    CHECK(!exposure_test_takes(0.1, 0, 0.045, PHOTOMETRY_LAMP));
    CHECK(!exposure_test_takes(0.1, 0, 0.042, PHOTOMETRY_GAINS));
    CHECK(exposure_test_takes(0.02, 0, 0.021, PHOTOMETRY_GAINS));
    CHECK(!exposure_test_takes(0.02, 0, 0.018, PHOTOMETRY_GAINS));
    CHECK(!exposure_test_takes(0.02, 0.04, 0.07, PHOTOMETRY_GAINS));
    CHECK(!exposure_test_takes(0, 0.3, 0.29, PHOTOMETRY_GAINS));
    CHECK(exposure_test_takes(0, 0.3, 0.31, PHOTOMETRY_GAINS)); /* brackets */
}
