/* studies.c - the studies, as tables of rows.
 *
 * Ablation: the paper's variants on one survey, with the same seeds and iterations. Controls follow the rows
 * that they belong to: a part that adds Gaussians is compared with the same number of them without it, one that
 * adds bytes with the same bytes. Trade-off: what speed costs, each option by itself and the presets. The other
 * two measure light and water, and blocks, for the published results.
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

const struct study_kind STUDY_KINDS[STUDY_ALL] = {
    [STUDY_TRADEOFF] = {"tradeoff", "Speed against accuracy", ROWS(TRADEOFF_ROWS), 1, 0, ""},
    [STUDY_LIGHT] = {"light", "Exposure, lamp and medium", ROWS(LIGHT_ROWS), 1, 0, ""},
    [STUDY_BLOCKS] = {"blocks", "Blocks", ROWS(BLOCK_ROWS), 1, 0, ""},
    /* a degree chosen row by row would change the bytes */
    [STUDY_ABLATION] =
        {"ablation", "The paper's parts", ROWS(ABLATE_ROWS), 0, 3,
         "All rows have the same SH degree. V1, count of V2: a low densify threshold, the same at "
         "all depths, and V2's number\nof Gaussians as the limit. V3, bytes of OceanXL: more "
         "Gaussians kept instead of lobes.\n"},
};
