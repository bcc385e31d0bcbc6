/* studies.c - the two studies, as tables of rows.
 *
 * Ablation: the paper's variants on one survey, with the same seeds and iterations: gain and cost of each
 * part. Controls follow the rows
 * that they belong to: a part that adds Gaussians is compared with the same number of them without it, one
 * that adds bytes with the same bytes. Trade-off: what speed costs, each option by itself and the presets, in
 * the order of their use to a reader.
 */
#include "study.h"

#define PARTS(cut, ucd, keep, dog)              \
    {"cut", cut}, {"ucd", ucd}, {"keep", keep}, \
    {                                           \
        "dog", dog                              \
    }
#define PAPER(psnr, ssim, gb, s) \
    [STUDY_PSNR] = psnr, [STUDY_SSIM] = ssim, [STUDY_BYTES] = 1e9 * gb, [STUDY_SECONDS] = s

static const struct study_row ABLATE_ROWS[] = {
    {.name = "3dgs",
     .label = "3DGS, midpoint",
     .option = {PARTS("midpoint", "off", "all", "off")},
     .paper = {PAPER(22.40, 0.719, 0.670, 2587)}}, /* the paper's ablation, on its Abyssal dataset */
    {.name = "v1",
     .label = "V1 +BSP",
     .option = {PARTS("balanced", "off", "all", "off")},
     .against = {"3dgs"},
     .paper = {PAPER(23.05, 0.721, 0.593, 1877)}},
    {.name = "v2",
     .label = "V2 +UCD",
     .option = {PARTS("balanced", "on", "all", "off")},
     .against = {"v1", "v1-count", "3dgs"},
     .paper = {PAPER(26.36, 0.818, 0.768, 2233)}},
    {.name = "v1-count",
     .label = "V1, count of V2",
     .option = {PARTS("balanced", "off", "all", "off")},
     .against = {"v1"},
     .like = "v2",
     .equal = STUDY_GAUSSIANS},
    {.name = "v3",
     .label = "V3 +WAP",
     .option = {PARTS("balanced", "on", "0.5", "off")},
     .against = {"v2", "3dgs"},
     .paper = {PAPER(26.04, 0.788, 0.242, 1530)}},
    {.name = "v4",
     .label = "V4 +DoG on all",
     .option = {PARTS("balanced", "on", "0.5", "all")},
     .against = {"v3", "3dgs"},
     .paper = {PAPER(26.26, 0.809, 0.264, 2232)}},
    {.name = "oceanxl",
     .label = "OceanXL",
     .option = {PARTS("balanced", "on", "0.5", "selective")},
     .against = {"v3", "v3-bytes", "v2", "3dgs"},
     .paper = {PAPER(26.19, 0.797, 0.261, 1736)}},
    {.name = "v3-bytes",
     .label = "V3, bytes of OceanXL",
     .option = {PARTS("balanced", "on", "all", "off")},
     .against = {"v3"},
     .like = "oceanxl",
     .equal = STUDY_BYTES},
    /* by name alone: the paper's V3 is 31.5 % of its V2 in size, though it says that half is kept */
    {.name = "v3-315",
     .label = "V3, keep 0.315",
     .option = {PARTS("balanced", "on", "0.315", "off")},
     .against = {"v2", "3dgs"}},
    {.name = "auto",
     .label = "OceanXL, UCD auto",
     .option = {PARTS("balanced", "auto", "0.5", "selective")},
     .against = {"oceanxl", "3dgs"}},
};

static const struct study_kind ABLATE_KIND = {
    .file = "ablation",
    .title = "Ablation",
    .row = ABLATE_ROWS,
    .rows = sizeof ABLATE_ROWS / sizeof *ABLATE_ROWS,
    .by_default = 8,
    .notes =
        "All rows have the same SH degree. V1, count of V2: a lower densify threshold, the same at all depths, found by a\n"
        "search. V3, bytes of OceanXL: more Gaussians kept instead of lobes.\n",
};

static const struct study_row TRADEOFF_ROWS[] = {
    {.name = "base", .label = "base", .iterations = 1},
    {.name = "iterations-half", .label = "half the iterations", .iterations = 0.5},
    {.name = "coarse-0", .label = "--coarse 0", .option = {{"coarse", "0"}}},
    {.name = "coarse-0.25", .label = "--coarse 0.25", .option = {{"coarse", "0.25"}}},
    {.name = "coarse-0.5", .label = "--coarse 0.5", .option = {{"coarse", "0.5"}}},
    {.name = "alpha-min-0.03", .label = "--alpha-min 0.03", .option = {{"alpha-min", "0.03"}}},
    {.name = "sh-degree-1", .label = "--sh-degree 1", .option = {{"sh-degree", "1"}}},
    {.name = "sh-degree-0", .label = "--sh-degree 0", .option = {{"sh-degree", "0"}}},
    {.name = "short-run-exponent-0",
     .label = "--short-run-exponent 0",
     .option = {{"short-run-exponent", "0"}}},
    {.name = "cooldown-0", .label = "--cooldown 0", .option = {{"cooldown", "0"}}},
    {.name = "keep-0.5", .label = "--keep 0.5", .option = {{"keep", "0.5"}}},
    {.name = "iterations-quarter", .label = "a quarter of the iterations", .iterations = 0.25},
    {.name = "draft", .label = "--preset draft", .preset = 1 + OXL_PRESET_DRAFT},
    {.name = "iterations-double", .label = "twice the iterations", .iterations = 2},
    {.name = "standard", .label = "--preset standard", .preset = 1 + OXL_PRESET_STANDARD},
    {.name = "paper", .label = "--preset paper", .preset = 1 + OXL_PRESET_PAPER},
};

static const struct study_kind TRADEOFF_KIND = {
    .file = "tradeoff",
    .title = "Speed against accuracy",
    .row = TRADEOFF_ROWS,
    .rows = sizeof TRADEOFF_ROWS / sizeof *TRADEOFF_ROWS,
    .by_default = sizeof TRADEOFF_ROWS / sizeof *TRADEOFF_ROWS,
    .has_baseline = 1,
    .notes =
        "dB over other iterations: PSNR minus what the base reaches in the same CPU time with fewer or more iterations.\n",
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
