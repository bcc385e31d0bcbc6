/* test_merge.c - the models of blocks become one: each Gaussian once, where it was, with all that it
 * carries. */
#include "test.h"

enum { MERGE_TEST_COUNT = 3000 };

/* Three blocks in a turned frame: cut at 0 along the first axis; the upper half cut at 1 along the second. */
static void merge_test_partition(struct partition *p, struct partition_block block[3], const double origin[3])
{
    static const double turned[9] = {0.6, 0.8, 0, -0.8, 0.6, 0, 0, 0, 1};
    *p = (struct partition){.dimensions = 2, .block_count = 3, .block = block};
    memcpy(p->rotation, turned, sizeof turned);
    memcpy(p->origin, origin, sizeof p->origin);
    for (int b = 0; b < 3; b++) {
        block[b] = (struct partition_block){
            .box = {{-INFINITY, -INFINITY, -INFINITY}, {INFINITY, INFINITY, INFINITY}}};
        if (b == 0) block[b].box.high[0] = 0;
        else block[b].box.low[0] = 0;
    }
    block[1].box.high[1] = block[2].box.low[1] = 1;
}

/* The world's coordinates are local + origin; every other plane identifies the row. */
static oxl_model merge_test_cloud(size_t count, int degree, const double origin[3])
{
    oxl_model m;
    CHECK_OK(oxl_model_create(test_ctx, count, degree, &m));
    memcpy(m.origin, origin, sizeof m.origin);
    for (int p = 0; p < oxl_model_planes(&m); p++)
        for (size_t i = 0; i < count; i++)
            m.plane[p][i] = p < OXL_LOG_SCALE ? (float)(8 * random_unit(random_bits(7, i, (uint64_t)p)) - 4)
                                              : (float)(i + 10000 * (size_t)p);
    return m;
}

static oxl_model merge_test_empty(const double origin[3])
{
    oxl_model m;
    CHECK_OK(oxl_model_create(test_ctx, 0, 0, &m));
    memcpy(m.origin, origin, sizeof m.origin);
    return m;
}

/* What lies in the block's box. */
static oxl_result merge_test_block(const struct partition *p, int block, const oxl_model *from,
                                   oxl_model *into)
{
    uint8_t *inside = oxl_alloc(test_ctx, from->count + 1, 1);
    const oxl_result rc = inside ? OXL_OK : OXL_ERR_MEMORY;
    if (rc != OXL_OK) return rc;
    merge_mark(p, block, from, inside);
    {
        const oxl_result merged = merge_rows(test_ctx, from, inside, into);
        oxl_free(test_ctx, inside);
        return merged;
    }
}

static size_t merge_test_row(const oxl_model *m, size_t i) /* in the cloud */
{
    return (size_t)m->plane[OXL_OPACITY][i] - 10000 * OXL_OPACITY;
}

TEST(merge_keeps_each_gaussian_of_overlapping_blocks_exactly_once)
{
    const double origin[3] = {0.1, -0.2, 0.3};
    struct partition_block block[3];
    struct partition p;
    OWNED_MODEL cloud = merge_test_cloud(MERGE_TEST_COUNT, 1, origin), merged = merge_test_empty(origin);
    unsigned char seen[MERGE_TEST_COUNT] = {0};
    merge_test_partition(&p, block, origin);
    /* each block trained all of it */
    for (int b = 0; b < 3; b++) CHECK_OK(merge_test_block(&p, b, &cloud, &merged));
    CHECK(merged.count == MERGE_TEST_COUNT && merged.sh_degree == 1);
    for (size_t i = 0; i < merged.count; i++) {
        const size_t row = merge_test_row(&merged, i);
        CHECK(row < MERGE_TEST_COUNT && !seen[row]++);
        for (int k = 0; k < oxl_model_planes(&merged); k++) CHECK(merged.plane[k][i] == cloud.plane[k][row]);
    }
}

TEST(merge_goes_by_block_and_keeps_the_order_within_one)
{
    const double zero[3] = {0, 0, 0}, origin[3] = {-1, 0.5, 1};
    struct partition_block block[3];
    struct partition p;
    OWNED_MODEL cloud = merge_test_cloud(MERGE_TEST_COUNT, 0, origin), merged = merge_test_empty(origin);
    size_t end[3];
    merge_test_partition(&p, block, zero);
    for (int b = 0; b < 3; b++) {
        CHECK_OK(merge_test_block(&p, b, &cloud, &merged));
        end[b] = merged.count;
    }
    for (size_t i = 0, b = 0; i < merged.count; i++) {
        double world[3], frame[3];
        for (int a = 0; a < 3; a++) world[a] = merged.plane[a][i] + origin[a];
        while (i >= end[b]) b++;
        partition_to_frame(&p, world, frame);
        CHECK(partition_contains(&block[b].box, frame));
        CHECK(i == 0 || i == end[b - (b > 0)] || merge_test_row(&merged, i) > merge_test_row(&merged, i - 1));
    }
    CHECK(end[0] > 1000 && end[1] > end[0] + 300 && end[2] > end[1] + 300);
}

TEST(merge_gives_a_border_to_the_block_above_it_and_the_far_to_the_outer_blocks)
{
    const double zero[3] = {0, 0, 0};
    const float at[5] = {0, -0.0f, -1e-30f, 3e38f, -3e38f};
    const int kept_in[5] = {1, 1, 0, 1, 0};
    struct partition_block block[3];
    struct partition p;
    OWNED_MODEL m = merge_test_cloud(5, 0, zero);
    merge_test_partition(&p, block, zero);
    for (int i = 0; i < 9; i++) p.rotation[i] = i % 4 == 0;
    for (int i = 0; i < 5; i++) m.plane[0][i] = at[i], m.plane[1][i] = m.plane[2][i] = 0;
    for (int b = 0; b < 3; b++) {
        OWNED_MODEL merged = merge_test_empty(zero);
        size_t expected = 0;
        CHECK_OK(merge_test_block(&p, b, &m, &merged));
        for (int i = 0; i < 5; i++)
            if (kept_in[i] == b)
                CHECK(expected < merged.count && merge_test_row(&merged, expected++) == (size_t)i);
        CHECK(merged.count == expected);
    }
    m.plane[1][1] = 1; /* on the second border, exactly */
    m.plane[0][0] = m.plane[0][2] = NAN;
    OWNED_MODEL merged = merge_test_empty(zero);
    CHECK_OK(merge_test_block(&p, 2, &m, &merged));
    CHECK(merged.count == 1 && merge_test_row(&merged, 0) == 1);
    CHECK_OK(merge_test_block(&p, 0, &m, &merged));
    CHECK_OK(merge_test_block(&p, 1, &m, &merged));
    CHECK(merged.count == 3); /* those that are not a number have no block */
}

TEST(merge_keeps_places_to_float_accuracy_when_origins_lie_a_thousand_kilometres_apart)
{
    const double east[3] = {1e6, 4.2e6, -30}, west[3] = {3.3, 4.2e6 + 0.7, 25};
    struct partition_block block[3];
    struct partition p;
    OWNED_MODEL m = merge_test_cloud(MERGE_TEST_COUNT, 0, east), merged = merge_test_empty(west);
    merge_test_partition(&p, block, east);
    for (int b = 0; b < 3; b++) CHECK_OK(merge_test_block(&p, b, &m, &merged));
    CHECK(merged.count == m.count && !memcmp(merged.origin, west, sizeof west));
    for (size_t i = 0; i < merged.count; i++)
        for (int a = 0; a < 3; a++) {
            const double was = m.plane[a][merge_test_row(&merged, i)] + (east[a] - west[a]);
            CHECK(fabs(merged.plane[a][i] - was) <= fabs(was) * FLT_EPSILON / 2);
        }
}

TEST(merge_carries_the_largest_degree_and_fills_missing_bands_with_zero)
{
    const double zero[3] = {0, 0, 0};
    const int degree[3] = {1, 3, 0};
    struct partition_block block[3];
    struct partition p;
    OWNED_MODEL merged = merge_test_empty(zero);
    size_t first = 0;
    merge_test_partition(&p, block, zero);
    for (int b = 0; b < 3; b++) {
        OWNED_MODEL m = merge_test_cloud(MERGE_TEST_COUNT, degree[b], zero);
        CHECK_OK(merge_test_block(&p, b, &m, &merged));
        CHECK(merged.sh_degree == (b ? 3 : 1));
    }
    for (int b = 0; b < 3; b++) {
        OWNED_MODEL m = merge_test_cloud(MERGE_TEST_COUNT, 3, zero), alone = merge_test_empty(zero);
        const int end = OXL_SH + 3 * (degree[b] + 1) * (degree[b] + 1);
        CHECK_OK(merge_test_block(&p, b, &m, &alone));
        for (size_t i = 0; i < alone.count; i++)
            for (int k = 0; k < OXL_LOBE; k++)
                CHECK(merged.plane[k][first + i] == (k < end ? alone.plane[k][i] : 0));
        first += alone.count;
    }
    CHECK(first == merged.count);
}

TEST(merge_takes_blocks_that_keep_nothing)
{
    const double zero[3] = {0, 0, 0};
    struct partition_block block[3];
    struct partition p;
    OWNED_MODEL none = merge_test_empty(zero), merged = merge_test_empty(zero),
                away = merge_test_cloud(20, 2, zero);
    merge_test_partition(&p, block, zero);
    for (size_t i = 0; i < away.count; i++) away.plane[0][i] = away.plane[1][i] = -100;
    CHECK_OK(merge_test_block(&p, 0, &none, &merged));
    CHECK_OK(merge_test_block(&p, 1, &away, &merged));
    CHECK(merged.count == 0 && merged.sh_degree == 2);
    CHECK_OK(merge_test_block(&p, 0, &away, &merged));
    CHECK_OK(merge_test_block(&p, 2, &none, &merged));
    CHECK(merged.count == 20);
}

static void merge_test_add_lobes(oxl_model *m, size_t lobes)
{
    CHECK_OK(model_set_lobes(test_ctx, m, lobes));
    for (int p = OXL_LOBE; lobes && p < OXL_PLANES; p++)
        for (size_t i = 0; i < lobes; i++) m->plane[p][i] = (float)(i + 10000 * (size_t)p);
}

TEST(merge_keeps_rows_with_a_second_lobe_in_front_each_with_its_own)
{
    const double zero[3] = {0, 0, 0};
    const size_t lobes[3] = {1700, 0, MERGE_TEST_COUNT};
    struct partition_block block[3];
    struct partition p;
    OWNED_MODEL merged = merge_test_empty(zero);
    merge_test_partition(&p, block, zero);
    for (int b = 0; b < 3; b++) {
        OWNED_MODEL m = merge_test_cloud(MERGE_TEST_COUNT, b % 2, zero);
        merge_test_add_lobes(&m, lobes[b]);
        CHECK_OK(merge_test_block(&p, b, &m, &merged));
    }
    CHECK(merged.count == MERGE_TEST_COUNT && merged.lobes > 1000);
    for (size_t i = 0, last = 0; i < merged.count; i++) {
        const size_t row = merge_test_row(&merged, i);
        const double world[3] = {merged.plane[0][i], merged.plane[1][i], merged.plane[2][i]};
        double frame[3];
        size_t b = 0;
        partition_to_frame(&p, world, frame);
        while (b < 2 && !partition_contains(&block[b].box, frame)) b++;
        CHECK((i < merged.lobes) == (row < lobes[b]));
        /* in the order of blocks, then rows */
        CHECK(i == 0 || i == merged.lobes || b * MERGE_TEST_COUNT + row > last);
        last = b * MERGE_TEST_COUNT + row;
        for (int k = OXL_LOG_SCALE; k < OXL_SH + 3; k++)
            CHECK(merged.plane[k][i] == (float)(row + 10000 * (size_t)k));
        for (int k = OXL_LOBE; i < merged.lobes && k < OXL_PLANES; k++)
            CHECK(merged.plane[k][i] == (float)(row + 10000 * (size_t)k));
    }
}
