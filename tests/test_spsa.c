/* test_spsa.c - the depth weights' search, against costs that are known. */

/* Box & Muller 1958. */
static double spsa_normal(uint64_t draw)
{
    const double u = 1 - random_unit(random_bits(77, draw, 0)), v = random_unit(random_bits(77, draw, 1));
    return sqrt(-2 * log(u)) * cos(6.283185307179586 * v);
}

/* A bowl around (1.6, 2.4) with normal noise of the given deviation; at (1,1) it is 2.3, at (3,4) 4.5. */
static double spsa_bowl(const double f[2], double noise, uint64_t draw)
{
    return (f[0] - 1.6) * (f[0] - 1.6) + (f[1] - 2.4) * (f[1] - 2.4) + noise * spsa_normal(draw);
}

static struct spsa spsa_run(double mid, double back, int pairs, double noise, uint64_t seed)
{
    struct spsa s;
    double      f[2];
    spsa_begin(&s, (double[]){mid, back}, (double[]){1.5, 2}, 1, 5, seed);
    for (int i = 0; i < 2 * pairs; i++) {
        spsa_ask(&s, f);
        CHECK(f[0] >= 1 && f[1] >= f[0] && f[1] <= 5);
        CHECK(s.f[0] >= 1 && s.f[1] >= s.f[0] && s.f[1] <= 5);
        CHECK(spsa_update(&s, spsa_bowl(f, noise, (uint64_t)i)) == i % 2);
    }
    return s;
}

TEST(spsa_finds_the_minimum_of_a_noisy_bowl_from_below_and_from_above)
{
    for (uint64_t seed = 1; seed <= 8; seed++)
        for (int above = 0; above < 2; above++) {
            const struct spsa s = spsa_run(above ? 3 : 1, above ? 4 : 1, 90, 0.2, seed);
            CHECK_CLOSE(s.f[0], 1.6, 0.3);
            CHECK_CLOSE(s.f[1], 2.4, 0.3);
        }
}

TEST(spsa_keeps_the_order_and_the_cap_wherever_the_cost_pulls)
{
    for (int pull = 0; pull < 8; pull++) { /* down, mid up and far down, mid down and far up, up; the same with lower precision */
        struct spsa s;
        double      f[2];
        spsa_begin(&s, (double[]){3.1, 0.5}, (double[]){1.5, 2}, pull < 4 ? 3 : 0.01, 5, 3);
        CHECK(s.f[0] == 3.1 && s.f[1] == 3.1);
        for (int i = 0; i < 400; i++) {
            spsa_ask(&s, f);
            CHECK(f[0] >= 1 && f[1] >= f[0] && f[1] <= 5 && s.f[0] >= 1 && s.f[1] >= s.f[0] && s.f[1] <= 5);
            spsa_update(&s, (pull & 1 ? -f[0] : f[0]) + (pull & 2 ? -f[1] : f[1]));
        }
        if (pull == 0) CHECK(s.f[0] < 1.3 && s.f[1] < 1.3);
        if (pull == 3) CHECK(s.f[0] > 2.1 && s.f[1] > 2.9);
    }
}

/* A slope of -0.002 for f_mid: 0.2, where the prior precision is 0.01. The error of a pair in the other weight cancels in the next. */
TEST(spsa_estimate_is_the_mean_of_prior_and_pairs_independent_of_the_start)
{
    struct spsa s;
    double      f[2];
    for (int above = 0; above < 2; above++) {
        spsa_begin(&s, above ? (double[]){5, 8} : (double[]){2.5, 4}, (double[]){3, 5}, 0.01, 9, 1);
        for (int i = 0; i < 12; i++) {
            spsa_ask(&s, f);
            spsa_update(&s, -0.002 * f[0]);
            if (i == 1) CHECK_CLOSE(s.f[0], 3.1, 1e-12);
        }
        CHECK_CLOSE(s.f[0], 3 + 0.2 * 6 / 7, 1e-12);
        CHECK_CLOSE(s.f[1], 5 + 0.2 * 6 / 7, 1e-12);
    }
}

TEST(spsa_limits_the_influence_of_each_pair)
{
    struct spsa s;
    double      f[2];
    spsa_begin(&s, (double[]){3, 5}, (double[]){3, 5}, 0.01, 9, 1);
    for (int i = 0; i < 8; i++) {
        spsa_ask(&s, f);
        spsa_update(&s, i == 7 ? 1000 : 0); /* the last of four pairs is broken */
    }
    CHECK_CLOSE(fabs(s.f[0] - 3), SPSA_OFFSET_MAX / 5, 1e-12);
    CHECK_CLOSE(fabs(s.f[1] - s.f[0] - 2), SPSA_OFFSET_MAX / 5, 1e-12);
}

/* Where the bounds bring points together, cost differences over next to nothing would be noise, enlarged. */
TEST(spsa_takes_no_step_along_an_axis_removed_by_the_bounds)
{
    struct spsa s;
    spsa_begin(&s, (double[]){2, 2.25}, (double[]){2, 2.25}, 1, 5, 1);
    s.point[0][0] = 2.25, s.point[0][1] = 2.5; /* f_far - f_mid is the same */
    s.point[1][0] = 1.75, s.point[1][1] = 2;
    s.known = 0, s.first = 0;
    spsa_update(&s, 1);
    spsa_update(&s, 0);
    CHECK(s.f[0] < 2 && s.f[1] - s.f[0] == 0.25);
}

/* In the corner, a larger f_far lowers the cost and f_mid does not: the order of the two must not hold it there. */
TEST(spsa_leaves_a_corner_of_the_bounds_along_an_edge)
{
    for (uint64_t seed = 1; seed <= 8; seed++) {
        struct spsa s;
        double      f[2];
        spsa_begin(&s, (double[]){1, 1}, (double[]){1.5, 2}, 3, 5, seed);
        for (int i = 0; i < 40; i++) {
            spsa_ask(&s, f);
            spsa_update(&s, 3 * f[0] - f[1]);
        }
        CHECK(s.f[0] < 1.2 && s.f[1] > 1.6);
    }
}

static void spsa_state(struct archive *a, void *user)
{
    spsa_archive(a, user);
}

static int spsa_is_same(const struct spsa *a, const struct spsa *b)
{
    struct spsa next_a = *a, next_b = *b;
    spsa_update(&next_a, 0.5);
    spsa_update(&next_b, 0.5);
    return a->pair == b->pair && !memcmp(a->f, b->f, sizeof a->f) && !memcmp(a->point, b->point, sizeof a->point) &&
           !memcmp(next_a.f, next_b.f, sizeof a->f) && !memcmp(next_a.point, next_b.point, sizeof a->point);
}

TEST(spsa_is_a_function_of_the_seed_and_continues_from_its_archive)
{
    struct spsa a = spsa_run(1.5, 2, 30, 0.2, 5), b = spsa_run(1.5, 2, 30, 0.2, 5), other = spsa_run(1.5, 2, 30, 0.2, 6);
    int         found = 0;
    CHECK(spsa_is_same(&a, &b) && memcmp(&a.f, &other.f, sizeof a.f) != 0);
    spsa_update(&a, 1); /* in the middle of a pair */
    CHECK_OK(checkpoint_write(test_ctx, test_folder(), "key", spsa_state, &a));
    CHECK_OK(checkpoint_read(test_ctx, test_folder(), "key", spsa_state, &other, &found));
    CHECK(found && other.known == 1 && spsa_is_same(&a, &other));
}

TEST(spsa_drops_a_pair_that_a_skipped_window_or_a_broken_cost_interrupts)
{
    struct spsa s;
    double      first[2], f[2];
    spsa_begin(&s, (double[]){1.5, 2}, (double[]){1.5, 2}, 0.01, 5, 9);
    spsa_ask(&s, first);
    CHECK(spsa_update(&s, 1) == 0);
    spsa_skip(&s);
    spsa_ask(&s, f);
    CHECK(f[0] == first[0] && f[1] == first[1]);
    CHECK(spsa_update(&s, 1) == 0 && spsa_update(&s, (double)NAN) == 0);
    spsa_ask(&s, f);
    CHECK(f[0] == first[0] && f[1] == first[1] && s.pair == 0 && s.f[0] == 1.5);
}

TEST(spsa_randomizes_the_order_of_the_two_points)
{
    struct spsa s;
    double      f[2];
    int         plus_first = 0, up_first = 0;
    spsa_begin(&s, (double[]){3, 3.5}, (double[]){3, 3.5}, 0.01, 6, 1);
    for (int pair = 0; pair < 40; pair++) {
        spsa_ask(&s, f);
        plus_first += f[0] == s.point[0][0];
        up_first += f[0] > s.f[0];
        spsa_update(&s, 0);
        spsa_update(&s, 0);
    }
    CHECK(plus_first > 10 && plus_first < 30 && up_first > 10 && up_first < 30);
    CHECK(s.f[0] == 3 && s.f[1] == 3.5); /* costs that do not differ move nothing */
}
