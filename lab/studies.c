/* studies.c - the studies, as tables of rows.
 *
 * Ablation: the paper's variants on one survey, with the same seeds and iterations. Controls follow the rows
 * that they belong to: a part that adds Gaussians is compared with the same number of them without it, one that
 * adds bytes with the same bytes. Trade-off: what speed costs, each option by itself and the presets. The others
 * measure light and water, blocks, options at their extremes, and published scenes. Names of rows are unique, as
 * the studies of a survey share a folder.
 */
#include "study.h"

#define ROW(name_, label_, options_) .name = name_, .label = label_, .options = options_
#define ROWS(rows) rows, sizeof(rows) / sizeof *(rows)

static const struct study_row ABLATE_ROWS[] = {
    {ROW("3dgs", "3DGS, midpoint", "cut=midpoint ucd=off keep=all dog=off")},
    {ROW("v1", "V1 +BSP", "cut=balanced ucd=off keep=all dog=off"), .against = {"3dgs"}},
    {ROW("v2", "V2 +UCD", "cut=balanced ucd=on keep=all dog=off"), .against = {"v1", "v1-count", "3dgs"}},
    {ROW("v1-count", "V1, count of V2", "cut=balanced ucd=off keep=all dog=off"), .against = {"v1"},
     .like = "v2", .equal = STUDY_GAUSSIANS},
    {ROW("v3", "V3 +WAP", "cut=balanced ucd=on keep=0.5 dog=off"), .against = {"v2", "3dgs"}},
    {ROW("v4", "V4 +DoG on all", "cut=balanced ucd=on keep=0.5 dog=all"), .against = {"v3", "3dgs"}},
    {ROW("oceanxl", "OceanXL", "cut=balanced ucd=on keep=0.5 dog=selective"),
     .against = {"v3", "v3-bytes", "v2", "3dgs"}},
    {ROW("v3-bytes", "V3, bytes of OceanXL", "cut=balanced ucd=on keep=all dog=off"), .against = {"v3"},
     .like = "oceanxl", .equal = STUDY_BYTES},
};

static const struct study_row TRADEOFF_ROWS[] = {
    {ROW("base", "base", ""), .iterations = 1},
    {ROW("iterations-half", "half the iterations", ""), .iterations = 0.5},
    {ROW("iterations-sixteenth", "a sixteenth of the iterations", ""), .iterations = 0.0625},
    {ROW("iterations-quarter", "a quarter of the iterations", ""), .iterations = 0.25},
    {ROW("coarse-0", "--coarse 0", "coarse=0")},
    {ROW("coarse-0.5", "--coarse 0.5", "coarse=0.5")},
    {ROW("sh-degree-1", "--sh-degree 1", "sh-degree=1")},
    {ROW("sh-degree-0", "--sh-degree 0", "sh-degree=0")},
    {ROW("keep-0.5", "--keep 0.5", "keep=0.5")},
    {ROW("draft", "--preset draft", ""), .preset = 1 + OXL_PRESET_DRAFT},
    {ROW("iterations-double", "twice the iterations", ""), .iterations = 2},
    {ROW("standard", "--preset standard", ""), .preset = 1 + OXL_PRESET_STANDARD},
    {ROW("paper", "--preset paper", ""), .preset = 1 + OXL_PRESET_PAPER},
};

static const struct study_row LIGHT_ROWS[] = {
    {ROW("plain", "none", "exposure=off lamp=off medium=off")},
    {ROW("light", "as decided", "exposure=auto lamp=auto medium=auto")},
};

static const struct study_row BLOCK_ROWS[] = {
    {ROW("block-1", "one block", "partition=none")},
    {ROW("block-4", "4 blocks", "blocks=4")},
    {ROW("block-8", "8 blocks", "blocks=8")},
};

static const struct study_row EXTREME_ROWS[] = {
    {ROW("usual", "as usual", "")},
    {ROW("rates-10", "position and scale rates x 10",
         "lr-position=1.6e-3 lr-position-final=1.6e-5 lr-scale=0.05")},
    {ROW("rates-0.1", "position and scale rates / 10",
         "lr-position=1.6e-5 lr-position-final=1.6e-7 lr-scale=0.0005")},
    {ROW("gaussians-100", "100 Gaussians at most", "max-gaussians=100")},
    {ROW("side-32", "images of 32 px", "max-side=32")},
    {ROW("alpha-min-0.05", "--alpha-min 0.05", "alpha-min=0.05")},
    {ROW("iterations-1", "1/250 of the iterations", ""), .iterations = 0.004},
};

static const struct study_row PUBLISHED_ROWS[] = {
    {ROW("published-2000", "draft, 2000", "iterations=2000 max-side=0"), .preset = 1 + OXL_PRESET_DRAFT},
    {ROW("published-7000", "standard, 7000", "iterations=7000 max-side=0"),
     .preset = 1 + OXL_PRESET_STANDARD},
    {ROW("published-30000", "standard, 30,000", "iterations=30000 max-side=0"),
     .preset = 1 + OXL_PRESET_STANDARD},
};

const struct study_kind STUDY_KINDS[STUDY_ALL] = {
    [STUDY_TRADEOFF] = {"tradeoff", "Speed against accuracy", ROWS(TRADEOFF_ROWS), .has_baseline = 1},
    [STUDY_LIGHT] = {"light", "Exposure, lamp and medium", ROWS(LIGHT_ROWS), .has_baseline = 0},
    [STUDY_BLOCKS] = {"blocks", "Blocks", ROWS(BLOCK_ROWS), .has_baseline = 0},
    [STUDY_EXTREMES] = {"extremes", "Options at their extremes", ROWS(EXTREME_ROWS), .has_baseline = 0},
    [STUDY_PUBLISHED] =
        {"published", "Published scenes", ROWS(PUBLISHED_ROWS), .is_published = 1,
         .notes =
             "Images have their published size. Published after 30,000 iterations on a GPU: 35.78 dB on lego of NeRF "
             "synthetic,\n33.32 dB in the mean of its eight scenes (Kerbl 2023).\n"},
    /* a degree chosen row by row would change the bytes */
    [STUDY_ABLATION] =
        {"ablation", "The paper's parts", ROWS(ABLATE_ROWS), .sh_degree = 3,
         .notes = "All rows have the same SH degree. V1, count of V2: a low densify threshold, the same at "
                  "all depths, and V2's number\nof Gaussians as the limit. V3, bytes of OceanXL: more "
                  "Gaussians kept instead of lobes.\n"},
};
