/* test_memory.c - memory that fails: whichever allocation of a whole job is refused, the job says so or ends
 * in the same result.
 *
 * After SQLite's tests: the n-th allocation fails, those after it succeed, which also finds errors that are
 * swallowed. A few dozen n here; OXL_ALL_ALLOCATIONS=1 takes every one (.ci/slow).
 */
#include "test.h"

/* Several blocks, masks, weights by depth, pruning and second lobes: as many places as there are. */
static oxl_job_options memory_options(void)
{
    oxl_job_options o = job_test_options();
    o.train.densify_every = 3;
    o.train.densify_gradient = 1e-6f;
    o.train.ucd = OXL_UCD_AUTO;
    o.train.keep = (oxl_keep){OXL_KEEP_FRACTION, 0.7};
    o.train.dog = OXL_DOG_ALL;
    o.train.sh_degree = 1;
    o.partition.block_points = 24;
    return o;
}

static long memory_used; /* allocations of the last job */

/* Runs the job with the n-th allocation refused. */
static oxl_result memory_job(const char *survey, const char *out, long n)
{
    const oxl_job_options options = memory_options();
    char command[600];
    snprintf(command, sizeof command, "rm -rf '%s'", out);
    CHECK(system(command) == 0);
    test_ctx->error[0] = 0;
    allocations_left = n;
    oxl_result rc = oxl_job_run(test_ctx, survey, out, &options, NULL);
    memory_used = n - allocations_left;
    allocations_left = LONG_MAX;
    return rc;
}

static uint64_t memory_sum(const char *file)
{
    struct os_file_map map;
    if (!os_is_file(file) || os_read_file(test_ctx, file, &map) != OXL_OK) return 0;
    uint64_t sum = checksum_add(CHECKSUM_SEED, map.data, map.size);
    os_release_file(test_ctx, &map);
    return sum;
}

TEST(memory_refused_anywhere_in_a_job_is_reported_or_changes_nothing)
{
    const char *survey = job_test_survey(), *out = test_path("out");
    char ply[512], refused[400];
    long reported = 0;
    test_write("survey/masks/.keep", "");
    for (int i = 0; i < 3; i++) {
        CHECK_OK(job_test_image(test_path("survey/masks/%d.png", i), i));
    }
    snprintf(ply, sizeof ply, "%s/scene.ply", out);
    test_ctx->threads = 1;
    CHECK_OK(memory_job(survey, out, LONG_MAX));
    long count = memory_used;
    uint64_t whole = memory_sum(ply);
    long held = blocks_held;
    long stride = getenv("OXL_ALL_ALLOCATIONS") ? 1 : OXL_MAX(count / 40, 1);
    CHECK(whole != 0 && count > 1000);
    test_case = refused;
    for (long n = stride / 2; n < count; n += stride) {
        const oxl_result rc = memory_job(survey, out, n);
        reported += rc == OXL_ERR_MEMORY;
        snprintf(refused, sizeof refused, "allocation %ld of %ld refused: result %d, %ld blocks kept, %s", n,
                 count, rc, blocks_held - held, oxl_error_text(test_ctx));
        CHECK(rc == OXL_ERR_MEMORY ? blocks_held == held && strstr(oxl_error_text(test_ctx), "no memory")
                                   : rc == OXL_OK && memory_sum(ply) == whole);
    }
    CHECK(reported > 10);
}

/* ---------------- arrays that grow */

TEST(memory_that_grows_keeps_its_contents_and_its_alignment)
{
    memory_weigh_start(0);
    unsigned char *bytes = oxl_alloc(test_ctx, 1000, 1);
    for (int i = 0; i < 1000; i++) bytes[i] = (unsigned char)i;
    for (size_t size = 1000; size < 1200; size += 10) {
        bytes = oxl_regrow(test_ctx, bytes, size, size + 10, 1);
        CHECK((uintptr_t)bytes % 64 == 0);
        memset(bytes + size, 7, 10);
    }
    bytes = oxl_regrow(test_ctx, bytes, 1200, 1100, 1);
    for (int i = 0; i < 1100; i++) CHECK(bytes[i] == (i < 1000 ? (unsigned char)i : 7));
    oxl_free(test_ctx, bytes);
    memory_weigh_end();
}

TEST(memory_that_grows_takes_what_is_needed_where_a_quarter_more_is_refused)
{
    char *bytes = NULL;
    size_t capacity = 0;
    memory_weigh_start(10200);
    CHECK_OK(oxl_reserve(test_ctx, &bytes, &capacity, 9000, 1));
    memset(bytes, 5, 9000);
    CHECK_OK(oxl_reserve(test_ctx, &bytes, &capacity, 10000, 1));
    CHECK(capacity == 10000 && bytes[8999] == 5);
    CHECK(oxl_reserve(test_ctx, &bytes, &capacity, 11000, 1) == OXL_ERR_MEMORY && capacity == 10000 &&
          bytes[8999] == 5);
    CHECK_SAYS("no memory for 11000 x 1 bytes\nfix: ");
    CHECK(!oxl_alloc(test_ctx, SIZE_MAX / 2, 4)); /* their product is no size */
    CHECK_SAYS(" x 4 bytes\nfix: ");
    oxl_free(test_ctx, bytes);
    memory_weigh_end();
}
