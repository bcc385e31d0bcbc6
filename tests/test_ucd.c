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

TEST(contrast_fades_as_the_water_has_it_and_not_as_dull_points_would)
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

TEST(ucd_auto_is_off_in_clear_water_and_on_where_contrast_fades)
{
    for (int turbid = 0; turbid < 2; turbid++) {
        oxl_scene *scene = wall_scene(turbid ? 0.2 : 0);
        struct ucd u     = ucd_of(scene, OXL_UCD_AUTO, 1, 100, OXL_UCD_THIRDS);
        char       text[400];
        ucd_describe(&u, text, sizeof text);
        CHECK(u.on == turbid);
        CHECK_TEXT(text, turbid ? "depth weights on: from depth" : "depth weights off: from depth");
        if (turbid) CHECK_TEXT(text, "f_mid 1.50");
        ucd_free(test_ctx, &u);
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

TEST(ucd_keeps_its_weights_when_told_to_or_when_the_run_is_short_and_says_so)
{
    oxl_scene *scene = wall_scene(0.2);
    for (int is_short = 0; is_short < 2; is_short++) {
        struct ucd u =
            is_short ? ucd_of(scene, OXL_UCD_ON, 1, 6, OXL_UCD_THIRDS) : ucd_of(scene, OXL_UCD_ON, 0, 60, OXL_UCD_THIRDS);
        char   text[400];
        double f[2];
        for (int step = 1; step <= 1000; step++) {
            ucd_observe(&u, step, step % 10, 1.0 / step);
            if (step % 100 != 0) continue;
            ucd_before_control(&u, step, f);
            CHECK(f[0] == 1.5 && f[1] == 2);
            ucd_after_control(&u, step, 100, 110);
        }
        ucd_describe(&u, text, sizeof text);
        CHECK_TEXT(text, is_short ? "f_far 2.00, fixed: the run is too short" : "f_far 2.00, fixed");
        ucd_free(test_ctx, &u);
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

enum { SEARCH_VIEWS = 37, SEARCH_EVERY = 100 };

/* A run without pictures: each view has a log loss of its own between -4 and 0, on which all share one trend and each visit has noise.
 * The trend's slope in a window is what `slope` makes of the weights at its beginning. */
struct search {
    struct ucd u;
    double     trend, noise;
    int        step;
};

static double search_fake_slope(const double f[2]) /* per step: best at (1.6, 2.4) */
{
    return -2e-3 + 1e-3 * ((f[0] - 1.6) * (f[0] - 1.6) + (f[1] - 2.4) * (f[1] - 2.4));
}

static struct search search_begin(double mid, double back, double noise, uint64_t seed)
{
    struct search s = {.noise = noise};
    s.u             = (struct ucd){.on = 1, .learns = 1, .f = {mid, back}};
    CHECK_OK(ucd_begin_search(test_ctx, &s.u, SEARCH_VIEWS, 100, seed));
    return s;
}

/* `windows` windows with a constant slope, or 0: the fake one; every view once in an order of each epoch. */
static void search_run(struct search *s, int windows, double slope)
{
    double f[2];
    for (int w = 0; w < windows; w++) {
        for (int i = 0; i < SEARCH_EVERY; i++) {
            const uint64_t epoch = (uint64_t)(s->step / SEARCH_VIEWS), at = (uint64_t)(s->step % SEARCH_VIEWS);
            const int      view = (int)((at * (1 + epoch % 30) + random_bits(8, epoch, 0) % SEARCH_VIEWS) % SEARCH_VIEWS);
            const double   own  = -4 * random_unit(random_bits(9, (uint64_t)view, 0));
            s->step++;
            s->trend += slope != 0 ? slope : search_fake_slope(s->u.f);
            ucd_observe(&s->u, s->step, view, exp(own + s->trend + s->noise * density_normal(10, (uint64_t)s->step, 0)));
        }
        ucd_before_control(&s->u, s->step, f);
        ucd_after_control(&s->u, s->step, 1000, 1000);
    }
}

TEST(ucd_measures_the_slope_of_a_window_whatever_the_views_own_losses_are)
{
    struct search s = search_begin(1.5, 2, 0, 1);
    search_run(&s, 3, -1e-3);
    for (int i = 0; i < 2; i++) { /* each window its own slope, though views were last seen in windows with another one */
        const double slope = i ? -2e-4 : -3e-3;
        double       cost;
        s.u.spsa.told = 0;
        search_run(&s, 1, slope);
        cost = s.u.spsa.cost[s.u.spsa.first];
        CHECK(s.u.spsa.told == 1);
        CHECK_CLOSE(cost / SEARCH_EVERY, slope, 1e-6);
    }
    ucd_free(test_ctx, &s.u);
}

TEST(ucd_learns_the_same_weights_from_below_and_from_above_in_spite_of_noise)
{
    for (uint64_t seed = 1; seed <= 4; seed++)
        for (int above = 0; above < 2; above++) {
            struct search s = search_begin(above ? 3 : 1, above ? 4 : 1, 0.03, seed);
            search_run(&s, 200, 0);
            CHECK(s.u.spsa.pair >= 98);
            CHECK_CLOSE(s.u.spsa.f[0], 1.6, 0.3);
            CHECK_CLOSE(s.u.spsa.f[1], 2.4, 0.3);
            ucd_free(test_ctx, &s.u);
        }
}

TEST(ucd_growth_has_a_price)
{
    struct search s = search_begin(1.5, 2, 0, 1);
    double        f[2], cost[2];
    search_run(&s, 3, -1e-3);
    for (int i = 0; i < 2; i++) {
        s.u.spsa.told = 0;
        s.u.growth    = i ? 0.5 : 0;
        search_run(&s, 1, -1e-3);
        cost[i] = s.u.spsa.cost[s.u.spsa.first];
    }
    CHECK_CLOSE(cost[1] - cost[0], 0.5 * UCD_GROWTH, 1e-6);
    ucd_before_control(&s.u, s.step, f);
    ucd_after_control(&s.u, s.step, 1000, 1250);
    CHECK_CLOSE(s.u.growth, 0.25, 1e-12);
    ucd_free(test_ctx, &s.u);
}

TEST(ucd_windows_with_a_reset_or_a_new_band_do_not_count)
{
    struct search s = search_begin(1.5, 2, 0, 1);
    int           pairs;
    search_run(&s, 9, -1e-3); /* the first window is no densification's */
    pairs = s.u.spsa.pair;
    CHECK(pairs == 4 && s.u.spsa.told == 0);
    ucd_disturb(&s.u, s.step + 1, 0);
    search_run(&s, 1, -1e-3);
    CHECK(s.u.spsa.pair == pairs && s.u.spsa.told == 0);
    search_run(&s, 1, -1e-3);
    CHECK(s.u.spsa.told == 1);
    ucd_disturb(&s.u, s.step, 1); /* a reset: five windows and the one that begins with it */
    search_run(&s, 6, -1e-3);
    CHECK(s.u.spsa.pair == pairs && s.u.spsa.told == 0);
    search_run(&s, 2, -1e-3);
    CHECK(s.u.spsa.pair == pairs + 1);
    ucd_free(test_ctx, &s.u);
}

static void ucd_state(struct archive *a, void *user)
{
    ucd_archive(a, user);
}

TEST(ucd_goes_on_from_its_archive)
{
    struct search a = search_begin(1.5, 2, 0.03, 3), b = search_begin(1.5, 2, 0.03, 3);
    int           found = 0;
    search_run(&a, 7, 0);
    ucd_observe(&a.u, ++a.step, 5, 0.5);
    b.step = a.step, b.trend = a.trend;
    CHECK_OK(checkpoint_write(test_ctx, test_folder(), "key", ucd_state, &a.u));
    CHECK_OK(checkpoint_read(test_ctx, test_folder(), "key", ucd_state, &b.u, &found));
    search_run(&a, 6, 0);
    search_run(&b, 6, 0);
    CHECK(found && a.u.spsa.pair == b.u.spsa.pair && memcmp(a.u.spsa.f, b.u.spsa.f, sizeof a.u.f) == 0);
    CHECK(memcmp(a.u.f, b.u.f, sizeof a.u.f) == 0 && a.u.f[0] != 1.5);
    ucd_free(test_ctx, &a.u);
    ucd_free(test_ctx, &b.u);
}
