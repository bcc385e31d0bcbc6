/* studies.c - the two studies, as tables of rows.
 *
 * Ablation: the paper's variants on one survey, with the same seeds and iterations. Controls follow the rows
 * that they belong to: a part that adds Gaussians is compared with the same number of them without it, one that
 * adds bytes with the same bytes. Trade-off: what speed costs, each option by itself and the presets.
 */
#include "study.h"

static const struct study_row ABLATE_ROWS[] = {
    {"3dgs", "3DGS, midpoint", "cut=midpoint ucd=off keep=all dog=off", 0, 0, {NULL}, NULL, 0},
    {"v1", "V1 +BSP", "cut=balanced ucd=off keep=all dog=off", 0, 0, {"3dgs"}, NULL, 0},
    {"v2", "V2 +UCD", "cut=balanced ucd=on keep=all dog=off", 0, 0, {"v1", "v1-count", "3dgs"}, NULL, 0},
    {"v1-count",
     "V1, count of V2",
     "cut=balanced ucd=off keep=all dog=off",
     0,
     0,
     {"v1"},
     "v2",
     STUDY_GAUSSIANS},
    {"v3", "V3 +WAP", "cut=balanced ucd=on keep=0.5 dog=off", 0, 0, {"v2", "3dgs"}, NULL, 0},
    {"v4", "V4 +DoG on all", "cut=balanced ucd=on keep=0.5 dog=all", 0, 0, {"v3", "3dgs"}, NULL, 0},
    {"oceanxl",
     "OceanXL",
     "cut=balanced ucd=on keep=0.5 dog=selective",
     0,
     0,
     {"v3", "v3-bytes", "v2", "3dgs"},
     NULL,
     0},
    {"v3-bytes",
     "V3, bytes of OceanXL",
     "cut=balanced ucd=on keep=all dog=off",
     0,
     0,
     {"v3"},
     "oceanxl",
     STUDY_BYTES},
};

static const struct study_kind ABLATE_KIND = {
    .file = "ablation",
    .title = "Ablation",
    .row = ABLATE_ROWS,
    .rows = sizeof ABLATE_ROWS / sizeof *ABLATE_ROWS,
    .notes =
        "All rows have the same SH degree. V1, count of V2: a low densify threshold, the same at all depths, "
        "and V2's number\nof Gaussians as the limit. V3, bytes of OceanXL: more Gaussians kept instead of "
        "lobes.\n",
};

static const struct study_row TRADEOFF_ROWS[] = {
    {.name = "base", .label = "base", .options = "", .iterations = 1},
    {.name = "iterations-half", .label = "half the iterations", .options = "", .iterations = 0.5},
    {.name = "coarse-0", .label = "--coarse 0", .options = "coarse=0"},
    {.name = "coarse-0.5", .label = "--coarse 0.5", .options = "coarse=0.5"},
    {.name = "sh-degree-1", .label = "--sh-degree 1", .options = "sh-degree=1"},
    {.name = "sh-degree-0", .label = "--sh-degree 0", .options = "sh-degree=0"},
    {.name = "keep-0.5", .label = "--keep 0.5", .options = "keep=0.5"},
    {.name = "iterations-quarter", .label = "a quarter of the iterations", .options = "", .iterations = 0.25},
    {.name = "draft", .label = "--preset draft", .options = "", .preset = 1 + OXL_PRESET_DRAFT},
    {.name = "iterations-double", .label = "twice the iterations", .options = "", .iterations = 2},
    {.name = "standard", .label = "--preset standard", .options = "", .preset = 1 + OXL_PRESET_STANDARD},
    {.name = "paper", .label = "--preset paper", .options = "", .preset = 1 + OXL_PRESET_PAPER},
};

static const struct study_kind TRADEOFF_KIND = {
    .file = "tradeoff",
    .title = "Speed against accuracy",
    .row = TRADEOFF_ROWS,
    .rows = sizeof TRADEOFF_ROWS / sizeof *TRADEOFF_ROWS,
    .has_baseline = 1,
    .notes =
        "dB over other iterations: PSNR minus what the base reaches in the same CPU time with fewer or more "
        "iterations.\n",
};

oxl_result ablate_run(oxl_context *ctx, const study_options *options, FILE *to)
{
    study_options o = *options;
    /* a degree chosen row by row would change the bytes */
    if (o.job.train.sh_degree < 0) o.job.train.sh_degree = 3;
    return study_run(ctx, &ABLATE_KIND, &o, to);
}

oxl_result tradeoff_run(oxl_context *ctx, const study_options *options, FILE *to)
{
    return study_run(ctx, &TRADEOFF_KIND, options, to);
}
