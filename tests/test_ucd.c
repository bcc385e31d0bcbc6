/* test_ucd.c - how fast contrast fades, whether weights by depth are needed, and how they are learned. */

/* ---------------------------------------------------------------- contrast */

enum { WALL_VIEWS = 12, WALL_POINTS = 35, WALL_WIDTH = 160, WALL_HEIGHT = 120 };

/* Waves of 0.54 on a wall seen straight from z: 100 levels x exp(-beta z), on the left half a third of that. */
static void wall_draw(oxl_image *image, double z, double beta)
{
    for (int i = 0; i < 3 * WALL_WIDTH * WALL_HEIGHT; i++) {
        const double x = (i % WALL_WIDTH + 0.5 - 80) * z / 100, y = (i / WALL_WIDTH % WALL_HEIGHT + 0.5 - 60) * z / 100;
        const double wave = sin(x * 6.283 / 0.54) * sin(y * 6.283 / 0.54);
        image->rgb[i]     = (float)(0.5 + 100 / 255.0 * exp(-beta * z) * wave * (x < -0.4 ? 0.33 : 1));
    }
}

/* View v stands at z = 4 + v / 4. Points on the dull half are seen by the nearer views alone: an average over points would say that
 * contrast grows with depth. */
static oxl_scene *wall_scene(double beta)
{
    struct text images = {.ctx = test_ctx}, points = {.ctx = test_ctx};
    oxl_scene  *scene = NULL;
    test_write("survey/images/.keep", "");
    test_write("survey/sparse/0/cameras.txt", "1 PINHOLE 160 120 100 100 80 60\n");
    for (int v = 0; v < WALL_VIEWS; v++) {
        oxl_image image;
        char      name[64];
        snprintf(name, sizeof name, "survey/images/v%02d.png", v);
        text_add(&images, "%d 1 0 0 0 0 0 %d.%02d 1 v%02d.png\n\n", v + 1, 4 + v / 4, v % 4 * 25, v);
        CHECK_OK(oxl_image_create(test_ctx, WALL_WIDTH, WALL_HEIGHT, &image));
        wall_draw(&image, 4 + 0.25 * v, beta);
        CHECK_OK(oxl_image_write(test_ctx, test_path(name), &image));
        oxl_image_free(test_ctx, &image);
    }
    for (int p = 0; p < WALL_POINTS; p++) {
        text_add(&points, "%d ", p + 1);
        text_add_number(&points, 0.85 * (p % 7 - 3));
        text_add(&points, " ");
        text_add_number(&points, 0.85 * (p / 7 - 2));
        text_add(&points, " 0 128 128 128 0.5");
        for (int v = 0; v < (p % 7 > 2 ? WALL_VIEWS : WALL_VIEWS / 2); v++) text_add(&points, " %d 0", v + 1);
        text_add(&points, "\n");
    }
    test_write("survey/sparse/0/images.txt", images.data);
    test_write("survey/sparse/0/points3D.txt", points.data);
    text_free(&images);
    text_free(&points);
    CHECK_OK(oxl_scene_load(test_ctx, test_path("survey"), NULL, &scene));
    return scene;
}

TEST(contrast_decay_follows_the_water_and_not_the_texture_of_points)
{
    static const double waters[] = {0, 0.1, 0.3};
    for (size_t i = 0; i < OXL_COUNT(waters); i++) {
        oxl_scene      *scene = wall_scene(waters[i]);
        struct contrast c;
        CHECK_OK(contrast_measure(test_ctx, scene, &c));
        CHECK(c.measured && c.points == WALL_POINTS && c.error > 0 && c.error < 0.02);
        CHECK_CLOSE(c.beta, waters[i], 0.02);
        oxl_scene_free(test_ctx, scene);
    }
}

static struct ucd ucd_of(oxl_scene *scene, oxl_ucd_mode mode, int learn, int densifications, oxl_ucd_bands bands)
{
    oxl_ucd    options = oxl_ucd_default();
    struct ucd u;
    options.mode  = mode;
    options.learn = learn;
    options.bands = bands;
    CHECK_OK(ucd_begin(test_ctx, &u, scene, &options, densifications));
    return u;
}

/* To ask again for every point took minutes where 15 images of 1000 points each were turned. */
TEST(contrast_reads_each_image_once_even_when_it_cannot_be_read)
{
    oxl_scene      *scene = wall_scene(0.1);
    struct contrast c;
    test_write("survey/images/v03.png", "no image");
    CHECK_OK(contrast_measure(test_ctx, scene, &c));
    CHECK(c.measured && scene->cache.clock == WALL_VIEWS - 2); /* two are held out */
    oxl_scene_free(test_ctx, scene);
}

static int contrast_is_stopped(void *user)
{
    return ++*(int *)user > 1;
}

TEST(contrast_is_left_at_the_image_where_it_is_stopped)
{
    oxl_scene      *scene = wall_scene(0.1);
    struct contrast c;
    int             asked     = 0;
    test_ctx->options.stopped = contrast_is_stopped;
    test_ctx->options.user    = &asked;
    CHECK(contrast_measure(test_ctx, scene, &c) == OXL_ERR_INTERRUPTED);
    CHECK(!c.measured && asked == 2);
    test_ctx->options.stopped = NULL;
    oxl_scene_free(test_ctx, scene);
}

TEST(contrast_of_a_scene_without_tracks_is_not_measured)
{
    struct prune_case c = prune_two_patches(3, 2, 0);
    struct contrast   contrast;
    struct ucd        u;
    CHECK_OK(contrast_measure(test_ctx, c.scene, &contrast));
    CHECK(!contrast.measured);
    u = ucd_of(c.scene, OXL_UCD_AUTO, 1, 100, OXL_UCD_THIRDS);
    CHECK(!u.on);
    CHECK_TEXT(u.reason, "off: ");
    prune_case_free(&c);
}

/* ---------------------------------------------------------------- whether */

TEST(ucd_auto_is_off_in_clear_water_and_on_where_contrast_falls_with_depth)
{
    for (int turbid = 0; turbid < 2; turbid++) {
        oxl_scene *scene = wall_scene(turbid ? 0.2 : 0);
        struct ucd u     = ucd_of(scene, OXL_UCD_AUTO, 1, 100, OXL_UCD_THIRDS);
        char       text[400];
        ucd_describe(&u, text, sizeof text);
        CHECK(u.on == turbid);
        CHECK_TEXT(text, turbid ? "depth weights on: from depth" : "depth weights off: from depth");
        if (turbid) CHECK_TEXT(text, "f_mid 1.50");
        oxl_scene_free(test_ctx, scene);
    }
}

TEST(ucd_bands_are_thirds_of_depth_or_thirds_of_the_points_or_where_contrast_fades)
{
    oxl_scene *scene = wall_scene(0.3);
    struct ucd u     = ucd_of(scene, OXL_UCD_ON, 1, 0, OXL_UCD_THIRDS);
    CHECK(fabs(u.z_near - 6.75 / 3) < 0.1 && fabs(u.z_far - 4.5) < 0.2);
    u = ucd_of(scene, OXL_UCD_ON, 1, 0, OXL_UCD_QUANTILES);
    CHECK(u.z_near >= 4.5 && u.z_near < u.z_far && u.z_far <= 6);
    u = ucd_of(scene, OXL_UCD_ON, 1, 0, OXL_UCD_FADING);
    CHECK_CLOSE(u.z_near - scene_depth_quantile(scene, 0.02), log(1.25) / 0.3, 0.1);
    CHECK_CLOSE(u.z_far - scene_depth_quantile(scene, 0.02), log(2) / 0.3, 0.2);
    oxl_scene_free(test_ctx, scene);
}

TEST(ucd_keeps_fixed_weights_by_option_and_in_short_runs_and_says_so)
{
    oxl_scene *scene = wall_scene(0.2);
    for (int is_short = 0; is_short < 2; is_short++) {
        struct ucd u =
            is_short ? ucd_of(scene, OXL_UCD_ON, 1, 6, OXL_UCD_THIRDS) : ucd_of(scene, OXL_UCD_ON, 0, 60, OXL_UCD_THIRDS);
        char text[400];
        CHECK(!ucd_tries(&u) && u.f[0] == 1.5 && u.f[1] == 2);
        ucd_describe(&u, text, sizeof text);
        CHECK_TEXT(text, is_short ? "f_far 2.00, fixed: the run is too short" : "f_far 2.00, fixed");
    }
    oxl_scene_free(test_ctx, scene);
}

TEST(ucd_options_are_words_or_two_weights_in_order)
{
    static const char *const wrong[] = {"", "maybe", "2", "2,1", "0.5,1", "1.5;2", "1.5,2,", "1.5,6", "1,nan", "1.5,2,x"};
    oxl_ucd                  o;
    CHECK_OK(oxl_ucd_parse(test_ctx, "auto", &o));
    CHECK(o.mode == OXL_UCD_AUTO && o.learn && o.f_mid == 1.5f && o.f_far == 2);
    CHECK_OK(oxl_ucd_parse(test_ctx, "off", &o));
    CHECK(o.mode == OXL_UCD_OFF);
    CHECK_OK(oxl_ucd_parse(test_ctx, "on", &o));
    CHECK(o.mode == OXL_UCD_ON && o.learn);
    CHECK_OK(oxl_ucd_parse(test_ctx, "3,4", &o));
    CHECK(o.mode == OXL_UCD_ON && o.learn && o.f_mid == 3 && o.f_far == 4);
    CHECK_OK(oxl_ucd_parse(test_ctx, "1,1,fixed", &o));
    CHECK(o.mode == OXL_UCD_ON && !o.learn && o.f_mid == 1 && o.f_far == 1);
    for (size_t i = 0; i < OXL_COUNT(wrong); i++) {
        CHECK(oxl_ucd_parse(test_ctx, wrong[i], &o) == OXL_ERR_USAGE);
        CHECK_TEXT(oxl_error_text(test_ctx), "fix: ");
    }
}

/* ---------------------------------------------------------------- the search */

/* A run without images, whose log loss after a densification is least with (1.6, 2.4). */
static struct ucd search_begin(double mid, double back, int densifications, uint64_t seed)
{
    struct ucd u = {.on = 1, .learns = 1, .f = {mid, back}};
    ucd_begin_search(&u, densifications, seed);
    return u;
}

static void search_run(struct ucd *u, int densifications, double noise, uint64_t draw)
{
    double f[2];
    for (int n = 0; n < densifications; n++, u->densified++) {
        if (!ucd_tries(u)) continue;
        for (int i = 0; i < 2; i++) {
            ucd_ask(u, f);
            ucd_update(u, -4 + 2e-3 * spsa_bowl(f, noise, draw + 2 * (uint64_t)n + (uint64_t)i), 0);
        }
    }
}

TEST(ucd_learns_the_same_weights_from_below_and_from_above_in_spite_of_noise)
{
    for (uint64_t seed = 1; seed <= 4; seed++) {
        struct ucd below = search_begin(1, 1, 66, seed), above = search_begin(3, 4, 66, seed);
        search_run(&below, 66, 0.7, 1000 * seed); /* costs that differ by 0.002: as measured */
        search_run(&above, 66, 0.7, 1000 * seed + 500);
        CHECK(below.spsa.pair == 9 && above.spsa.pair == 9);
        CHECK_CLOSE(above.f[0], below.f[0], 0.3);
        CHECK_CLOSE(above.f[1], below.f[1], 0.3);
        CHECK_CLOSE(below.f[0], 1.6, 0.3);
        CHECK_CLOSE(below.f[1], 2.1, 0.4);
    }
}

TEST(ucd_spreads_its_pairs_over_the_densifications)
{
    struct ucd u = search_begin(1.5, 2, 200, 1);
    search_run(&u, 200, 0, 0);
    CHECK(u.spsa.pair == UCD_PAIRS);
    u = search_begin(1.5, 2, 33, 1);
    search_run(&u, 24, 0, 0);
    CHECK(u.spsa.pair == 3 && ucd_tries(&u));
    u.densified += 20; /* there was no time for it then */
    CHECK(ucd_tries(&u));
}

TEST(ucd_cost_rises_with_the_number_of_gaussians)
{
    struct ucd u = search_begin(1.5, 2, 33, 1);
    CHECK_CLOSE(ucd_update(&u, -3, 0), -3, 1e-12);
    CHECK_CLOSE(ucd_update(&u, -3, 0.5), -3 + 0.5 * UCD_GROWTH, 1e-12);
    CHECK(u.spsa.pair == 1 && memcmp(u.f, u.spsa.f, sizeof u.f) == 0 && u.f[0] != 1.5);
}

static void ucd_state(struct archive *a, void *user)
{
    ucd_archive(a, user);
}

TEST(ucd_continues_from_its_archive)
{
    struct ucd a = search_begin(1.5, 2, 66, 3), b = search_begin(1.5, 2, 66, 3);
    int        found = 0;
    search_run(&a, 20, 0.1, 0);
    CHECK_OK(checkpoint_write(test_ctx, test_folder(), "key", ucd_state, &a));
    CHECK_OK(checkpoint_read(test_ctx, test_folder(), "key", ucd_state, &b, &found));
    search_run(&a, 20, 0.1, 50);
    search_run(&b, 20, 0.1, 50);
    CHECK(found && a.spsa.pair == b.spsa.pair && memcmp(a.spsa.f, b.spsa.f, sizeof a.f) == 0);
    CHECK(memcmp(a.f, b.f, sizeof a.f) == 0 && a.f[0] != 1.5 && a.densified == b.densified);
}
