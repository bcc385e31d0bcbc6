/* fuzz.c - libFuzzer's entry to the targets: OXL_FUZZ=NAME build/fuzz/fuzz [options] CORPUS...
 *
 * OXL_FUZZ=checkpoint OXL_FUZZ_SEED=FILE build/fuzz/fuzz writes a state to begin from.
 */
#include "../oceanxl.c"
#include "targets.c"

int LLVMFuzzerInitialize(int *argc, char ***argv);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static const struct fuzz_target *fuzz_chosen;

/* The state of a run after some steps, without what checkpoint_write puts around it. */
static void fuzz_write_seed(const char *path)
{
    const oxl_train_options options = fuzz_train_options();
    oxl_context *ctx;
    struct os_file_map map;
    struct text log, notes;
    struct train_task place = {.store = checkpoint_in(fuzz_folder(), "key"), .log = &log, .notes = &notes};
    struct train t = {.options = &options, .task = place};
    const size_t head = 27;
    fuzz_promise(oxl_context_create(NULL, &ctx) == OXL_OK, "a context");
    log = (struct text){.ctx = ctx};
    notes = log;
    t.ctx = ctx;
    t.scene = fuzz_scene(ctx);
    text_add(&log, "iteration,loss\n");
    fuzz_promise(train_begin(&t) == OXL_OK, "a run begins");
    for (t.step = 1; t.step <= 3; t.step++) fuzz_promise(train_step(&t) == OXL_OK, "a step");
    fuzz_promise(train_save(&t) == OXL_OK && os_read_file(ctx, fuzz_path("checkpoint.oxl"), &map) == OXL_OK,
                 "a checkpoint");
    fuzz_promise(os_write_file(ctx, path, map.data + head, map.size - head - 8) == OXL_OK,
                 "the seed can be written");
    exit(0);
}

int LLVMFuzzerInitialize(int *argc, char ***argv)
{
    const char *name = getenv("OXL_FUZZ"), *seed = getenv("OXL_FUZZ_SEED");
    (void)argc, (void)argv;
    atexit(fuzz_clean);
    for (size_t i = 0; i < OXL_COUNT(fuzz_targets); i++)
        if (name && strcmp(name, fuzz_targets[i].name) == 0) fuzz_chosen = &fuzz_targets[i];
    if (!fuzz_chosen) {
        fputs("fuzz: OXL_FUZZ names the target:", stderr);
        for (size_t i = 0; i < OXL_COUNT(fuzz_targets); i++) fprintf(stderr, " %s", fuzz_targets[i].name);
        fputs("\n", stderr);
        exit(2);
    }
    if (seed) fuzz_write_seed(seed);
    return 0;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    fuzz_one(fuzz_chosen, data, size);
    return 0;
}
