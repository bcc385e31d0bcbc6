/* test_prune.c - number to keep, schedule of drops, scores. */
#include "test.h"
#include "../src/parts/prune.h"

TEST(prune_keep_reads_shares_counts_and_sizes)
{
    static const struct {
        const char *text;
        oxl_keep_kind kind;
        double value;
    } cases[] = {{"0.5", OXL_KEEP_FRACTION, 0.5},
                 {"400000", OXL_KEEP_COUNT, 400000},
                 {"4e5", OXL_KEEP_COUNT, 400000},
                 {"80MB", OXL_KEEP_BYTES, 80e6},
                 {"80m", OXL_KEEP_BYTES, 80e6},
                 {"1.5GiB", OXL_KEEP_BYTES, 1.5 * 1073741824},
                 {"300kb", OXL_KEEP_BYTES, 300000},
                 {"all", OXL_KEEP_ALL, 0},
                 {"1", OXL_KEEP_ALL, 0}};
    static const char *const wrong[] = {"", "0", "-0.5", "half", "80MBit", "nan", "0.5x", "inf", "MB", "1,5"};
    oxl_keep keep;
    for (size_t i = 0; i < OXL_COUNT(cases); i++) {
        CHECK(option_read_keep(cases[i].text, &keep) && keep.kind == cases[i].kind);
        CHECK_CLOSE(keep.value, cases[i].value, 1e-6);
    }
    for (size_t i = 0; i < OXL_COUNT(wrong); i++) {
        CHECK(!option_read_keep(wrong[i], &keep));
    }
}

/* ---------------- when */

/* A whole run in which the mean L1 is `factor` times itself after every check; steps of the drops and counts
 * after them. */
struct prune_log {
    int drops, step[64];
    size_t count[64];
};

static struct prune_log prune_simulate(struct prune *p, int iterations, size_t count, double factor)
{
    struct prune_log log = {0};
    double l1 = 0.1;
    for (int step = 1; step <= iterations; step++) {
        prune_observe(p, step, l1);
        size_t drop = prune_due(p, step, count);
        if (prune_is_check_step(p, step)) l1 *= factor;
        if (!drop) continue;
        count -= drop;
        log.step[log.drops] = step;
        log.count[log.drops++] = count;
    }
    return log;
}

/* Half of the run is left when density control ends. */
static struct prune prune_of(oxl_keep_kind kind, double value, int iterations, int views)
{
    struct prune p;
    prune_begin(&p, (oxl_keep){kind, value}, iterations, iterations / 2, views, model_row_bytes(3));
    return p;
}

TEST(prune_drops_shrink_and_wait_for_the_loss_or_for_1500_of_40000_iterations)
{
    static const size_t left[] = {75000, 62500, 56250, 53125, 50000};
    for (int recovers = 0; recovers < 2; recovers++) {
        struct prune p = prune_of(OXL_KEEP_FRACTION, 0.5, 40000, 300);
        CHECK(p.start == 20200 && p.end == 30200);
        struct prune_log log = prune_simulate(&p, 40000, 100000, recovers ? 0.98 : 0.999);
        CHECK(log.drops == 5);
        for (int i = 0; i < 5; i++)
            CHECK(log.count[i] == left[i] && log.step[i] == 20200 + i * (recovers ? 500 : 1500));
    }
}

TEST(prune_reaches_the_target_exactly_whatever_the_run_is_like)
{
    for (int iterations = 60; iterations < 9000; iterations = iterations * 3 / 2)
        for (size_t count = 1; count < 5000; count = count * 3 + 1)
            for (int k = 1; k < 10; k += 2) {
                const size_t wanted = (size_t)OXL_MAX(1.0, floor(0.1 * k * (double)count + 0.5));
                struct prune p = prune_of(OXL_KEEP_FRACTION, 0.1 * k, iterations, 50);
                CHECK(p.start > iterations / 2 && p.end <= iterations && p.end <= 0.77 * iterations + 2);
                struct prune_log log = prune_simulate(&p, iterations, count, 0.999);
                CHECK(log.drops == 0 ? wanted == count : log.count[log.drops - 1] == wanted);
                CHECK(log.drops <= 5 && (log.drops == 0 || log.step[log.drops - 1] <= p.end));
            }
}

TEST(prune_knows_counts_and_sizes_and_leaves_what_is_small_enough)
{
    struct prune p = prune_of(OXL_KEEP_COUNT, 1234, 4000, 50);
    CHECK(prune_simulate(&p, 4000, 10000, 1).count[4] == 1234);
    p = prune_of(OXL_KEEP_COUNT, 20000, 4000, 50);
    CHECK(prune_simulate(&p, 4000, 10000, 1).drops == 0);
    p = prune_of(OXL_KEEP_BYTES, 1e6, 4000, 50);
    CHECK(prune_simulate(&p, 4000, 10000, 1).count[4] == (1000000 - 2048) / 248);
    p = prune_of(OXL_KEEP_ALL, 0, 4000, 50);
    CHECK(prune_simulate(&p, 4000, 10000, 1).drops == 0);
}

/* The file that a size asks for is at most of that size. */
TEST(model_row_bytes_are_those_of_the_file)
{
    for (int degree = 0; degree <= 3; degree++) {
        OWNED_MODEL m = test_model(1000, degree);
        CHECK_OK(model_file_write_ply(test_ctx, test_path("m.ply"), &m, degree));
        OWNED_FILE file = test_file("m.ply");
        CHECK(file.size <= PRUNE_FILE + 1000 * model_row_bytes(degree) &&
              file.size > 1000 * model_row_bytes(degree));
    }
}

/* ---------------- scores */

TEST(prune_select_takes_the_lowest_and_of_equals_the_first)
{
    enum { N = 500 };
    float score[N];
    uint8_t keep[N];
    for (int i = 0; i < N; i++)
        score[i] = (float)(random_bits(1, 2, (uint64_t)i) % 40) * (i % 3 ? 1e-20f : 1e20f);
    score[7] = 0, score[8] = FLT_MAX;
    for (size_t drop = 0; drop <= N; drop += 25) {
        size_t dropped = 0;
        prune_select(score, N, drop, keep);
        for (int i = 0; i < N; i++) dropped += !keep[i];
        CHECK(dropped == drop);
        for (int i = 0; i < N; i++)
            for (int j = 0; j < N; j++)
                if (keep[i] && !keep[j]) CHECK(score[j] < score[i] || (score[j] == score[i] && j < i));
    }
}

/* Drops 64 of the 128; returns how many stay of the patch that few views see. */
static int prune_run_case(struct prune_case *c, const struct prune *p)
{
    const oxl_render_options options = oxl_render_options_default();
    uint8_t keep[128];
    int right = 0;
    OWNED_RENDERER *r = test_renderer();
    CHECK_OK(
        prune_choose(test_ctx, p, &(struct prune_of){r, c->scene, &options, &c->trained.model}, 64, keep));
    for (int k = 0; k < TRAINED_PARTS; k++) model_keep_rows(model_trained_part(&c->trained, k), keep);
    CHECK(c->trained.model.count == 64 && c->trained.mean.count == 64 && c->trained.square.count == 64);
    for (int i = 0; i < 64; i++) {
        right += c->trained.model.plane[OXL_MEAN][i] > 0;
        /* moments go with their rows */
        CHECK(c->trained.mean.plane[OXL_MEAN][i] == c->trained.model.plane[OXL_MEAN][i]);
        CHECK(i == 0 || c->trained.model.plane[OXL_MEAN][i] >= c->trained.model.plane[OXL_MEAN][i - 1] ||
              /* in their order */
              c->trained.model.plane[OXL_MEAN + 1][i] > c->trained.model.plane[OXL_MEAN + 1][i - 1]);
    }
    return right;
}

TEST(prune_drops_the_faint_before_the_opaque)
{
    OWNED_PRUNE_CASE c = prune_two_patches(4, 4, -2);
    int faint = 0;
    struct prune p = prune_of(OXL_KEEP_FRACTION, 0.5, 4000, 8);
    prune_run_case(&c, &p);
    for (int i = 0; i < 64; i++) faint += c.trained.model.plane[OXL_OPACITY][i] < 0;
    CHECK(faint == 0);
}

/* With more views than a pass takes, rows that its sample does not show are kept. */
TEST(prune_scores_use_the_sampled_views_only)
{
    OWNED_PRUNE_CASE c = prune_two_patches(10, 1, -2); /* the last view alone sees the right patch */
    struct prune p = prune_of(OXL_KEEP_FRACTION, 0.5, 4000, 11);
    p.views = 6; /* every second one: 0, 2, .. 10; after the first drop 1, 3, .. 9 */
    p.drops = 1;
    CHECK(prune_run_case(&c, &p) == 64);
}

/* Scores and the last densification see opacities that have recovered: 1000 iterations or 2.5 % of the run
 * after a reset. */
TEST(train_resets_no_opacity_shortly_before_density_control_ends_or_pruning_starts)
{
    static const oxl_preset presets[] = {OXL_PRESET_DRAFT, OXL_PRESET_STANDARD, OXL_PRESET_PAPER};
    for (size_t k = 0; k < OXL_COUNT(presets); k++)
        for (int n = 500; n <= 60000; n += n < 3000 ? 100 : 500) {
            oxl_train_options o = oxl_train_options_default(presets[k]);
            struct prune p;
            int last = 0, count = 0;
            o.iterations = n;
            prune_begin(&p, (oxl_keep){OXL_KEEP_FRACTION, 0.5}, n, (int)(o.densify_until * n), 100, 248);
            for (int step = 1; step <= n; step++)
                if (schedule_resets_opacity_at(&o, step)) last = step, count++;
            CHECK(last == 0 || last + OXL_MAX(1000, 0.025 * n) <= o.densify_until * n);
            CHECK(last == 0 || last + OXL_MAX(1000, 0.025 * n) <= p.start);
            CHECK(n < 30000 || count == 4); /* of Kerbl's schedule none but the last is gone */
        }
}
