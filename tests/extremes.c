/* extremes.c - build/extremes FOLDER > docs/STABILITY.md: every extreme measured, every bound asserted;
 * FOLDER is for its surveys.
 *
 * Exit code 1: some bound does not hold; the row says so.
 */
#include "library.h"
#include "../cli/synth_options.c"
#include "../lab/synth.c"
#include "../lab/synth_export.c"
#include "../cli/output.c"
#include "../lab/synth_light.c"
#include "../lab/synth_trajectory.c"
#include "../lab/synth_points.c"
#include "../lab/synth_shade.c"
#include "../lab/synth_world.c"

#include "extreme_runs.c"

enum { EXTREME_LONG = 40000 }; /* iterations: the paper's */

static int extreme_broken; /* rows whose bound does not hold */

static void extreme_say_whether(int holds)
{
    printf(" %s |\n", holds ? "yes" : "**no**");
    extreme_broken += !holds;
    fflush(stdout);
}

static void extreme_print_cell(const struct extreme_error *e)
{
    if (e->most == 0) printf(" 0 |");
    else printf(" %.1e/%.0e |", e->most, e->mean);
}

static void extreme_print_renders(oxl_context *ctx)
{
    printf(
        "## Rendering and its gradients\n\n"
        "The gradient is that of the parameter with the largest error.\n\n"
        "| extreme | rendered | image | gradient | bound: image, gradient | holds |\n|---|--:|---|---|---|---|\n");
    for (size_t i = 0; i < OXL_COUNT(EXTREMES); i++) {
        struct extreme_result r;
        struct extreme_error gradient = {0};
        int finite = 1;
        extreme_run(ctx, &EXTREMES[i], &r);
        for (int k = 0; k < EXTREME_PARTS; k++) {
            finite &= r.part[k].finite;
            if (k == 0) continue; /* the image */
            gradient.most = OXL_MAX(gradient.most, r.part[k].most);
            gradient.mean = OXL_MAX(gradient.mean, r.part[k].mean);
        }
        printf("| %s | %zu of %d |", EXTREMES[i].what, r.rendered, EXTREMES[i].count);
        extreme_print_cell(&r.part[0]);
        extreme_print_cell(&gradient);
        printf(" %.0e, %.0e |", EXTREMES[i].image, EXTREMES[i].gradient);
        extreme_say_whether(finite && extreme_holds(&EXTREMES[i], &r));
    }
}

static void extreme_print_losses(oxl_context *ctx)
{
    printf("\n## Loss (0.8 L1 + 0.2 (1 - SSIM)) and its gradient\n\n"
           "| extreme | loss | gradient | bound: loss, gradient | holds |\n|---|---|---|---|---|\n");
    for (size_t i = 0; i < OXL_COUNT(EXTREME_LOSSES); i++) {
        const struct extreme_loss *e = &EXTREME_LOSSES[i];
        struct extreme_error error;
        double value;
        extreme_run_loss(ctx, e, &value, &error);
        printf("| %s | %.1e |", e->what, value);
        extreme_print_cell(&error);
        printf(" %.0e, %.0e |", e->value, e->gradient);
        extreme_say_whether(error.finite && value <= e->value && error.most <= e->gradient);
    }
}

static void extreme_print_adams(oxl_context *ctx)
{
    printf("\n## Adam (from 0, learning rate 1e-3; errors relative to the learning rate times the steps)\n\n"
           "| extreme | parameter | bound | holds |\n|---|---|---|---|\n");
    for (size_t i = 0; i < OXL_COUNT(EXTREME_ADAMS); i++) {
        const struct extreme_error error = extreme_run_adam(ctx, &EXTREME_ADAMS[i]);
        printf("| %s |", EXTREME_ADAMS[i].what);
        extreme_print_cell(&error);
        printf(" %.0e |", EXTREME_ADAMS[i].bound);
        extreme_say_whether(error.finite && error.most <= EXTREME_ADAMS[i].bound);
    }
}

static void extreme_print_surveys(oxl_context *ctx, const char *folder)
{
    float *plain = wide_array(EXTREME_VALUES);
    char path[600];
    printf(
        "\n## Surveys: read from files, trained for %d iterations, rendered\n\n"
        "Cells give the difference from the first row's rendering (white is 1): its maximum, and its mean over the worst view.\n\n"
        "| extreme | rendering | bound of the mean | holds |\n|---|---|---|---|\n",
        EXTREME_STEPS);
    for (size_t i = 0; i < OXL_COUNT(EXTREME_SURVEYS); i++) {
        const struct extreme_survey *e = &EXTREME_SURVEYS[i];
        snprintf(path, sizeof path, "%s/survey-%zu", folder, i);
        if (i == 0) extreme_train(ctx, e, path, plain);
        struct extreme_error error = extreme_run_survey(ctx, e, path, plain);
        printf("| %s |", e->what);
        if (e->image < 0) printf(" - | finite |");
        else {
            extreme_print_cell(&error);
            printf(" %.0e |", e->image);
        }
        extreme_say_whether(extreme_survey_holds(e, &error));
    }
    free(plain);
}

/* The paper's number of iterations on the most turbid water that synth knows. */
static void extreme_print_long_run(oxl_context *ctx, const char *folder)
{
    synth_options options = synth_options_default();
    oxl_train_options train = oxl_train_options_default(OXL_PRESET_PAPER);
    oxl_nonfinite found = {0};
    oxl_callback count = {extreme_count_nonfinite, &found};
    oxl_scene *scene = NULL;
    oxl_model model = {0};
    char path[600];
    int finite = 1;
    snprintf(path, sizeof path, "%s/turbid", folder);
    options.out = path, options.water = SYNTH_9C, options.views = 16, options.width = 64, options.height = 48,
    options.points = 600;
    train.iterations = EXTREME_LONG;
    train.ucd = OXL_UCD_SEARCH;
    train.dog = OXL_DOG_SELECTIVE;
    train.keep = (oxl_keep){OXL_KEEP_FRACTION, 0.5};
    extreme_must(ctx, synth_run(ctx, &options));
    extreme_must(ctx, oxl_scene_load(ctx, path, NULL, &scene));
    extreme_must(ctx, train_run(ctx, scene, &train, &count, &(struct train_task){.first = 0}, &model));
    for (size_t i = 0; i < model.count; i++) finite &= model_row_is_finite(&model, i);
    finite &= found.steps == 0 && found.rows == 0 && found.cleared == 0;
    printf(
        "| %d iterations in Jerlov's most turbid water, 9C, with depth weights, pruning and second lobes | %zu Gaussians | finite |",
        EXTREME_LONG, model.count);
    extreme_say_whether(finite);
    oxl_model_free(ctx, &model);
    oxl_scene_free(ctx, scene);
}

int main(int argc, char **argv)
{
    oxl_context *ctx;
    if (argc != 2 || oxl_context_create(NULL, &ctx) != OXL_OK) return 2;
    printf(
        "# Numerical stability at the extremes\n"
        "\n"
        "Float kernels are compared with double; the last column says whether all values are finite and within the bound. Errors are\n"
        "largest far from the model's origin, which is why models have a local origin.\n"
        "\n"
        "`make extremes` writes this page and fails if a bound does not hold; `build/test` checks all but the slow rows. The float kernels are those for %s. The\n"
        "reference is the same source in double (`tests/wide_kernels.c`), which `build/test reference_` compares with `reference/splat.c`.\n"
        "\n"
        "A cell has the largest error relative to the largest magnitude (bounded), then the mean error relative to the mean magnitude (not bounded). Where float and\n"
        "double fall on different sides of a threshold (alpha >= 1/255, T >= 1e-4), a pixel may differ by 1/255; bounds of 4e-03 allow for this.\n"
        "\n"
        "A Gaussian at or before the near plane, wider than 1e30 px or fainter than 1/255 is not rendered. A quaternion shorter than 1.2e-38 is the\n"
        "identity. Log scales are clamped to -87..88, Adam's gradient to +-1e18.\n"
        "\n",
        oxl_isa_name(ctx));
    extreme_print_renders(ctx);
    extreme_print_losses(ctx);
    extreme_print_adams(ctx);
    extreme_print_surveys(ctx, argv[1]);
    extreme_print_long_run(ctx, argv[1]);
    oxl_context_free(ctx);
    return extreme_broken > 0;
}
