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
    oxl_model m = test_model(count, degree);
    memcpy(m.origin, origin, sizeof m.origin);
    for (int p = 0; p < oxl_model_planes(&m); p++)
        for (size_t i = 0; i < count; i++)
            m.plane[p][i] = p < OXL_LOG_SCALE ? (float)(8 * random_unit(random_bits(7, i, (uint64_t)p)) - 4)
                                              : (float)(i + 10000 * (size_t)p);
    return m;
}

static oxl_model merge_test_empty(const double origin[3])
{
    oxl_model m = test_model(0, 0);
    memcpy(m.origin, origin, sizeof m.origin);
    return m;
}

/* Adds what lies in the block's box. */
static void merge_test_block(const struct partition *p, int block, const oxl_model *from, oxl_model *into)
{
    OWNED_MEMORY uint8_t *inside = oxl_alloc(test_ctx, from->count + 1, 1);
    merge_mark(p, block, from, inside);
    CHECK_OK(merge_rows(test_ctx, from, inside, into));
}

static size_t merge_test_row(const oxl_model *m, size_t i) /* in the cloud */
{
    return (size_t)m->plane[OXL_OPACITY][i] - 10000 * OXL_OPACITY;
}

/* Each block has trained all of the cloud; the origins are a thousand kilometres apart. */
TEST(merge_keeps_each_gaussian_of_overlapping_blocks_exactly_once_where_it_was)
{
    const double east[3] = {1e6, 4.2e6, -30}, west[3] = {3.3, 4.2e6 + 0.7, 25};
    struct partition_block block[3];
    struct partition p;
    OWNED_MODEL cloud = merge_test_cloud(MERGE_TEST_COUNT, 1, east), merged = merge_test_empty(west);
    unsigned char seen[MERGE_TEST_COUNT] = {0};
    merge_test_partition(&p, block, east);
    for (int b = 0; b < 3; b++) merge_test_block(&p, b, &cloud, &merged);
    CHECK(merged.count == MERGE_TEST_COUNT && merged.sh_degree == 1);
    CHECK(!memcmp(merged.origin, west, sizeof west));
    for (size_t i = 0; i < merged.count; i++) {
        const size_t row = merge_test_row(&merged, i);
        CHECK(row < MERGE_TEST_COUNT && !seen[row]++);
        for (int k = 0; k < oxl_model_planes(&merged); k++) {
            const double was = cloud.plane[k][row] + (k < OXL_LOG_SCALE ? east[k] - west[k] : 0);
            CHECK(fabs(merged.plane[k][i] - was) <= fabs(was) * FLT_EPSILON / 2);
        }
    }
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
        merge_test_block(&p, b, &m, &merged);
        for (int i = 0; i < 5; i++)
            if (kept_in[i] == b)
                CHECK(expected < merged.count && merge_test_row(&merged, expected++) == (size_t)i);
        CHECK(merged.count == expected);
    }
    m.plane[1][1] = 1; /* on the second border, exactly */
    m.plane[0][0] = m.plane[0][2] = NAN;
    OWNED_MODEL merged = merge_test_empty(zero);
    merge_test_block(&p, 2, &m, &merged);
    CHECK(merged.count == 1 && merge_test_row(&merged, 0) == 1);
    merge_test_block(&p, 0, &m, &merged);
    merge_test_block(&p, 1, &m, &merged);
    CHECK(merged.count == 3); /* those that are not a number have no block */
}

/* Blocks of SH degree 0, 1 and 0, of which two have second lobes, and one that is empty. */
TEST(merge_goes_by_block_with_second_lobes_in_front_and_zero_in_missing_bands)
{
    const double zero[3] = {0, 0, 0};
    const size_t lobes[3] = {1700, 0, MERGE_TEST_COUNT};
    struct partition_block block[3];
    struct partition p;
    OWNED_MODEL merged = merge_test_empty(zero), none = merge_test_empty(zero);
    merge_test_partition(&p, block, zero);
    merge_test_block(&p, 1, &none, &merged);
    for (int b = 0; b < 3; b++) {
        OWNED_MODEL m = merge_test_cloud(MERGE_TEST_COUNT, b % 2, zero);
        CHECK_OK(model_set_lobes(test_ctx, &m, lobes[b]));
        for (int k = OXL_LOBE; lobes[b] && k < OXL_PLANES; k++)
            for (size_t i = 0; i < lobes[b]; i++) m.plane[k][i] = (float)(i + 10000 * (size_t)k);
        merge_test_block(&p, b, &m, &merged);
    }
    CHECK(merged.count == MERGE_TEST_COUNT && merged.lobes > 1000 && merged.sh_degree == 1);
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
        for (int k = OXL_LOG_SCALE; k < OXL_PLANES; k++) {
            const int is_own = k < OXL_SH + 3 || k >= OXL_LOBE || b == 1;
            if (k < oxl_model_planes(&merged) || (k >= OXL_LOBE && i < merged.lobes))
                CHECK(merged.plane[k][i] == (is_own ? (float)(row + 10000 * (size_t)k) : 0));
        }
    }
}
