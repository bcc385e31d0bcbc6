/* fuzz.c - libFuzzer's entry to the targets: OXL_FUZZ=NAME build/fuzz/fuzz [options] CORPUS... */
#include "../oceanxl.c"
#include "targets.c"

int LLVMFuzzerInitialize(int *argc, char ***argv);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static const struct fuzz_target *fuzz_chosen;

int LLVMFuzzerInitialize(int *argc, char ***argv)
{
    const char *name = getenv("OXL_FUZZ");
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
    return 0;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    fuzz_one(fuzz_chosen, data, size);
    return 0;
}
