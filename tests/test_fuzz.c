/* test_fuzz.c - what the fuzzer was given and what it once broke on, read again: see fuzz/. */
#include "test.h"
#include "../fuzz/targets.c"

struct fuzz_replay {
    const struct fuzz_target *target;
    int inputs;
};

static void fuzz_replay_file(void *user, const char *name)
{
    struct fuzz_replay *r = user;
    struct os_file_map map;
    char path[300];
    snprintf(path, sizeof path, "fuzz/corpus/%s/%s", r->target->name, name);
    CHECK_OK(os_read_file(test_ctx, path, &map));
    fuzz_one(r->target, (const uint8_t *)map.data, map.size);
    os_release_file(test_ctx, &map);
    r->inputs++;
}

TEST(fuzz_inputs_are_read_or_refused_with_a_text_and_give_all_memory_back)
{
    for (size_t i = 0; i < OXL_COUNT(fuzz_targets); i++) {
        struct fuzz_replay r = {&fuzz_targets[i], 0};
        char path[300];
        snprintf(path, sizeof path, "fuzz/corpus/%s", r.target->name);
        CHECK_OK(os_list_folder(test_ctx, path, fuzz_replay_file, &r));
        CHECK(r.inputs > 0);
    }
    fuzz_clean();
}
