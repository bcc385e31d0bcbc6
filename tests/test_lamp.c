/* test_lamp.c - where the lamps of the cameras begin. */
#include "test.h"
#include "../src/parts/lamp.h"

TEST(lamp_of_each_camera_begins_with_the_shape_that_its_tracks_have)
{
    struct photometry p = {.points = 9, .parts = PHOTOMETRY_LAMP};
    struct lamp_fit l = {.groups = 3};
    char why[400];
    for (int g = 0; g < 3; g++) memcpy(p.shape[g], lamp_of(-1).shape, sizeof p.shape[g]), p.shape[g][g] += 1;
    lamp_set_from_tracks(&l, OXL_AUTO, &p, why, sizeof why);
    for (int g = 0; g < 3; g++) CHECK(l.on && memcmp(l.group[g].shape, p.shape[g], sizeof p.shape[g]) == 0);
}
