/* test_ucd.c - how fast contrast fades, whether weights by depth are needed, and how they are learned. */
#include "test.h"
#include "../src/parts/ucd.h"

/* ---------------- contrast */

enum { WALL_VIEWS = 12, WALL_POINTS = 35, WALL_WIDTH = 160, WALL_HEIGHT = 120 };

/* Waves of 0.54 on a wall seen straight from z: 100 levels x exp(-beta z), on the left half a third of
 * that. */
static void wall_draw(oxl_image *image, double z, double beta)
{
    for (int i = 0; i < 3 * WALL_WIDTH * WALL_HEIGHT; i++) {
        const double x = (i % WALL_WIDTH + 0.5 - 80) * z / 100,
                     y = (i / WALL_WIDTH % WALL_HEIGHT + 0.5 - 60) * z / 100;
        const double wave = sin(x * 6.283 / 0.54) * sin(y * 6.283 / 0.54);
        image->rgb[i] = (float)(0.5 + 100 / 255.0 * exp(-beta * z) * wave * (x < -0.4 ? 0.33 : 1));
    }
}

/* View v stands at z = 4 + v / 4. Points on the dull half are seen by the nearer views alone: an average over
 * points would say that contrast grows with depth. */
static oxl_scene *wall_scene(double beta)
{
    OWNED_TEXT images = test_text(), points = test_text();
    oxl_scene_options options = oxl_scene_options_default();
    test_write("survey/images/.keep", "");
    for (int v = 0; v < WALL_VIEWS; v++) {
        char name[64];
        snprintf(name, sizeof name, "survey/images/v%02d.png", v);
        text_add(&images, "%d 1 0 0 0 0 0 %d.%02d 1 v%02d.png\n\n", v + 1, 4 + v / 4, v % 4 * 25, v);
        OWNED_IMAGE image = test_image(WALL_WIDTH, WALL_HEIGHT);
        wall_draw(&image, 4 + 0.25 * v, beta);
        test_write_image(name, &image);
    }
    for (int p = 0; p < WALL_POINTS; p++) {
        text_add(&points, "%d ", p + 1);
        text_add(&points, "%s", NUMBER(0.85 * (p % 7 - 3)));
        text_add(&points, " ");
        text_add(&points, "%s", NUMBER(0.85 * (p / 7 - 2)));
        text_add(&points, " 0 128 128 128 0.5");
        for (int v = 0; v < (p % 7 > 2 ? WALL_VIEWS : WALL_VIEWS / 2); v++) text_add(&points, " %d 0", v + 1);
        text_add(&points, "\n");
    }
    test_write_colmap("survey/sparse/0", "1 PINHOLE 160 120 100 100 80 60\n", images.data, points.data);
    options.auto_mask = 0; /* The middle of a wall that the camera moves towards stays where it is. */
    oxl_scene *scene = test_load("survey", &options);
    return scene;
}

TEST(contrast_decay_follows_the_water_and_not_the_texture_of_points)
{
    static const double waters[] = {0, 0.1, 0.3};
    for (size_t i = 0; i < OXL_COUNT(waters); i++) {
        OWNED_SCENE *scene = wall_scene(waters[i]);
        struct contrast c;
        CHECK_OK(contrast_measure(test_ctx, scene, &c));
        CHECK(c.measured && c.points == WALL_POINTS && c.error > 0 && c.error < 0.02);
        CHECK_CLOSE(c.beta, waters[i], 0.02);
    }
}

static struct ucd ucd_of(oxl_scene *scene, oxl_ucd mode)
{
    struct ucd u;
    CHECK_OK(ucd_begin(test_ctx, &u, scene, mode));
    return u;
}

/* To ask again for every point took minutes where 15 images of 1000 points each were turned. */
TEST(contrast_reads_each_image_once_even_when_it_cannot_be_read)
{
    OWNED_SCENE *scene = wall_scene(0.1);
    struct contrast c;
    test_write("survey/images/v03.png", "no image");
    CHECK_OK(contrast_measure(test_ctx, scene, &c));
    CHECK(c.measured && scene->cache->clock == WALL_VIEWS - 2); /* two are held out */
}

static int contrast_is_stopped(void *user)
{
    return ++*(int *)user > 1;
}

TEST(contrast_is_left_at_the_image_where_it_is_stopped)
{
    OWNED_SCENE *scene = wall_scene(0.1);
    struct contrast c;
    int asked = 0;
    test_ctx->options.stopped = contrast_is_stopped;
    test_ctx->options.user = &asked;
    CHECK(contrast_measure(test_ctx, scene, &c) == OXL_ERR_INTERRUPTED && !c.measured && asked == 2);
    test_ctx->options.stopped = NULL;
}

TEST(contrast_of_a_scene_without_tracks_is_not_measured)
{
    OWNED_PRUNE_CASE c = prune_two_patches(3, 2, 0);
    struct contrast contrast;
    CHECK_OK(contrast_measure(test_ctx, c.scene, &contrast));
    CHECK(!contrast.measured);
    struct ucd u = ucd_of(c.scene, OXL_UCD_AUTO);
    CHECK(!u.on);
    CHECK_TEXT(u.reason, "no points are seen from several depths");
}

/* ---------------- whether */

TEST(ucd_auto_is_off_in_clear_water_and_on_where_contrast_falls_with_depth)
{
    for (int turbid = 0; turbid < 2; turbid++) {
        OWNED_SCENE *scene = wall_scene(turbid ? 0.2 : 0);
        struct ucd u = ucd_of(scene, OXL_UCD_AUTO);
        char text[400];
        ucd_describe(&u, text, sizeof text);
        CHECK(u.on == turbid);
        CHECK_TEXT(text, "contrast falls by");
        if (turbid) CHECK_TEXT(text, "f_mid 1.50");
    }
}

/* A fifth and a quarter less contrast, clear or within the error. */
TEST(ucd_auto_wants_contrast_to_fall_by_a_fifth_beyond_its_error)
{
    CHECK(ucd_fades(0.25, 0.08) && !ucd_fades(0.2, 0.01) && !ucd_fades(0.25, 0.09));
}

TEST(ucd_bands_are_thirds_of_the_largest_depth_without_outliers)
{
    OWNED_SCENE *scene = wall_scene(0.3);
    struct ucd u = ucd_of(scene, OXL_UCD_SEARCH);
    CHECK(fabs(u.z_near - 6.75 / 3) < 0.1 && fabs(u.z_far - 4.5) < 0.2);
}

TEST(ucd_keeps_fixed_weights_and_says_so)
{
    OWNED_SCENE *scene = wall_scene(0.2);
    struct ucd u = ucd_of(scene, OXL_UCD_ON);
    double f[2];
    char text[400];
    for (int i = 0; i < 40; i++) {
        ucd_observe(&u, 1.0 / (i + 1));
        ucd_weights(&u, 100 + 10 * (size_t)i, f);
        CHECK(f[0] == 1.5 && f[1] == 2);
    }
    ucd_describe(&u, text, sizeof text);
    CHECK_TEXT(text, "f_mid 1.50, from");
    CHECK_TEXT(text, "f_far 2.00, fixed");
}

/* ---------------- the search */

/* A run without images, from (2, 3): within a span the log loss changes by `cost`, a function of the weights
 * in use. */
struct search {
    struct ucd u;
    double log_loss, count, most_mid, least_mid;
    double (*cost)(const double f[2]);
};

static struct search search_begin(double (*cost)(const double f[2]), uint64_t seed)
{
    struct search s = {.u = {.on = 1, .learns = 1, .f = {2, 3}, .prior = {2, 3}, .seed = seed},
                       .count = 1000,
                       .least_mid = 9};
    s.cost = cost;
    ucd_restart(&s.u);
    return s;
}

static void search_run(struct search *s, int densifications)
{
    double f[2];
    for (int n = 0; n < densifications; n++) {
        ucd_observe(&s->u, vecmath_exp(s->log_loss));
        ucd_weights(&s->u, (size_t)s->count, f);
        CHECK(f[0] >= 1 && f[1] >= f[0] && f[1] <= UCD_CAP);
        s->least_mid = OXL_MIN(s->least_mid, f[0]);
        s->most_mid = OXL_MAX(s->most_mid, f[0]);
        s->log_loss += s->cost(f) / UCD_SPAN;
    }
}

/* by 0.01 for each unit of f_mid, and much whatever they are */
static double search_falling(const double f[2])
{
    return -0.08 - 0.01 * f[0];
}

static double search_flat(const double f[2])
{
    (void)f;
    return -0.08;
}

static double search_upwards(const double f[2])
{
    return -0.5 * f[0] - 0.5 * f[1];
}

static double search_downwards(const double f[2])
{
    return 0.5 * f[0] + 0.5 * f[1];
}

TEST(ucd_search_moves_by_slope_over_precision_and_stays_where_costs_are_flat)
{
    for (uint64_t seed = 1; seed <= 4; seed++) {
        struct search s = search_begin(search_flat, seed);
        search_run(&s, 2 + 17 * UCD_SPAN);
        CHECK(s.u.pairs == 8);
        CHECK_CLOSE(s.u.f[0], 2, 1e-9);
        CHECK_CLOSE(s.u.f[1], 3, 1e-9);
        CHECK_CLOSE(s.least_mid, 2 - UCD_SHIFT, 1e-9);
        CHECK_CLOSE(s.most_mid, 2 + UCD_SHIFT, 1e-9);
        s = search_begin(search_falling, seed);
        /* f_far - f_mid: the effect of f_mid cancels over perpendicular pairs */
        search_run(&s, 2 + 17 * UCD_SPAN);
        CHECK_CLOSE(s.u.f[0], 2 + 8 / 9.0 * 0.01 / UCD_PRECISION, 1e-9);
        CHECK_CLOSE(s.u.f[1] - s.u.f[0], 1, 1e-9);
    }
}

TEST(ucd_search_keeps_the_order_and_the_cap_wherever_the_cost_pulls)
{
    for (int up = 0; up < 2; up++) {
        struct search s = search_begin(up ? search_upwards : search_downwards, 1);
        for (int i = 0; i < 2; i++) s.u.f[i] = s.u.prior[i] = up ? 5 : 1;
        search_run(&s, 100);
        CHECK(s.u.pairs == 11 && s.u.f[0] == (up ? 5 : 1) && (up ? s.u.f[1] == 5 : s.u.f[1] < 1.1));
    }
}

TEST(ucd_search_prices_growth_and_limits_each_pair)
{
    struct search s = search_begin(search_flat, 1);
    search_run(&s, 1 + UCD_SPAN);
    s.count *= 1.5;
    search_run(&s, UCD_SPAN);
    CHECK_CLOSE(s.u.cost[0], -0.08 + 0.5 * UCD_GROWTH, 1e-9);
    s.log_loss += 100;
    search_run(&s, UCD_SPAN);
    CHECK(s.u.pairs == 1);
    CHECK_CLOSE(fabs(s.u.f[0] - 2), UCD_OFFSET_MAX / 2, 1e-9);
}

TEST(ucd_search_drops_a_pair_that_a_reset_or_a_broken_loss_interrupts)
{
    struct search s = search_begin(search_falling, 2);
    search_run(&s, 1 + 2 * UCD_SPAN); /* half a pair */
    CHECK(s.u.costs == 1);
    ucd_restart(&s.u);
    s.log_loss = 5;
    search_run(&s, 1 + UCD_SPAN);
    CHECK(s.u.costs == 0 && s.u.pairs == 0);
    for (int i = 0; i < 2 * UCD_SPAN; i++) {
        double f[2];
        ucd_observe(&s.u, (double)NAN);
        ucd_weights(&s.u, 1000, f);
    }
    CHECK(s.u.costs == 0 && s.u.pairs == 0);
}
