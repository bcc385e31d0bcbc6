/* tradeoff.c - what speed costs on one's own survey: each option by itself and the presets, in the order of their use to a reader. */
#include "study.h"

static const struct study_row TRADEOFF_ROWS[] = {
    {.name = "base", .label = "base", .change = {{STUDY_ITERATIONS, 1}}},
    {.name = "iterations-half", .label = "half the iterations", .change = {{STUDY_ITERATIONS, 0.5}}},
    {.name = "coarse-0", .label = "--coarse 0", .change = {{STUDY_COARSE, 0}}},
    {.name = "coarse-0.25", .label = "--coarse 0.25", .change = {{STUDY_COARSE, 0.25}}},
    {.name = "coarse-0.5", .label = "--coarse 0.5", .change = {{STUDY_COARSE, 0.5}}},
    {.name = "alpha-min-0.03", .label = "--alpha-min 0.03", .change = {{STUDY_ALPHA_MIN, 0.03}}},
    {.name = "sh-degree-1", .label = "--sh-degree 1", .change = {{STUDY_SH_DEGREE, 1}}},
    {.name = "sh-degree-0", .label = "--sh-degree 0", .change = {{STUDY_SH_DEGREE, 0}}},
    {.name = "short-run-exponent-0", .label = "--short-run-exponent 0", .change = {{STUDY_SHORT_RUN, 0}}},
    {.name = "cooldown-0", .label = "--cooldown 0", .change = {{STUDY_COOLDOWN, 0}}},
    {.name = "keep-0.5", .label = "--keep 0.5", .change = {{STUDY_KEEP, 0.5}}},
    {.name = "iterations-quarter", .label = "a quarter of the iterations", .change = {{STUDY_ITERATIONS, 0.25}}},
    {.name = "draft", .label = "--preset draft", .change = {{STUDY_PRESET, OXL_PRESET_DRAFT}}},
    {.name = "iterations-double", .label = "twice the iterations", .change = {{STUDY_ITERATIONS, 2}}},
    {.name = "standard", .label = "--preset standard", .change = {{STUDY_PRESET, OXL_PRESET_STANDARD}}},
    {.name = "paper", .label = "--preset paper", .change = {{STUDY_PRESET, OXL_PRESET_PAPER}}},
};

static const struct study_kind TRADEOFF_KIND = {
    .file         = "tradeoff",
    .title        = "Speed against accuracy",
    .row          = TRADEOFF_ROWS,
    .rows         = sizeof TRADEOFF_ROWS / sizeof *TRADEOFF_ROWS,
    .by_default   = sizeof TRADEOFF_ROWS / sizeof *TRADEOFF_ROWS,
    .has_baseline = 1,
    .notes = "dB over other iterations: PSNR minus what the base reaches in the same CPU time with fewer or more iterations.\n",
};

oxl_result tradeoff_run(oxl_context *ctx, const study_options *options, FILE *to)
{
    return study_run(ctx, &TRADEOFF_KIND, options, to);
}
