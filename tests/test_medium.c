/* test_medium.c - whether `auto` has a medium, from what the tracks show. */
#include "test.h"
#include "../src/parts/medium.h"

/* Depths that span too little do not identify a medium; residuals half as large again without one are
 * evidence that images gain by it. */
TEST(medium_that_tracks_show_clearly_is_on_whatever_the_depths_span)
{
    static const struct {
        double without, span;
        int on;
    } seen[] = {{0.0050, 1.2, 1}, {0.0033, 1.2, 0}, {0.0034, 3, 1}, {0.0032, 3, 0}, {0.0040, 1.9, 1}};
    for (size_t i = 0; i < OXL_COUNT(seen); i++)
        CHECK(photometry_supports(0, seen[i].without / 0.003, seen[i].span) == seen[i].on);
}

TEST(medium_is_what_the_tracks_support_and_says_why)
{
    NEEDS_PART(medium);
    struct photometry p = {.points = 100, .observations = 900, .with_medium = 0.003, .without = {0.0036}};
    for (int c = 0; c < 3; c++) p.attenuation[c] = p.backscatter[c] = 0.1, p.veiling_light[c] = 0.3;
    for (int on = 0; on < 2; on++) {
        struct medium m = {0};
        char why[400];
        p.parts = on ? PHOTOMETRY_MEDIUM : 0;
        medium_set_from_tracks(&m, 1.2, &p, why, sizeof why);
        CHECK(m.on == on);
        CHECK_TEXT(why, on ? "bD 0.1 0.1 0.1"
                           : "depths differ too little to show haze; depths differ by a factor of 1.2");
    }
    struct medium m = {.training_range = 100};
    char why[400];
    medium_set_from_tracks(&m, 1.2, &p, why, sizeof why);
    CHECK(!m.on);
    CHECK_TEXT(why, "leaves no light");
}
