/* lobes.c - second, negative lobes (difference of Gaussians) for the primitives that need them (paper sec.
 * 3.2, eq. 3, 4): assigned once, where the mean gradient of the last steps is above a threshold.
 */
#include "../train/part.h"
#include "../core/option_rows.h"
#include "../survey/scene.h"

#define LOBES_WATCH (1.0 / 40) /* of the run: gradients are averaged before lobes are assigned [OceanXL] */
/* mean gradient, in half images, above which --dog selective gives a lobe: density control's [Kerbl 2023] */
#define LOBES_THRESHOLD 0.0002f
#define LOBES_FROM 0.55f /* of the run at which lobes are assigned, during pruning [OceanXL sec. 3.2] */
/* a new lobe relative to its Gaussian ("Prune Wisely" has half the opacity: docs/METHOD.md) */
#define LOBES_OPACITY 0.1f
#define LOBES_SCALE 1.6f

struct lobes {
    int stage; /* 0; 1: gradients are averaged; 2: assigned */
};

static oxl_result lobes_check(oxl_context *ctx, const oxl_train_options *o)
{
    if (o->dog != OXL_DOG_OFF && !(LOBES_FROM > o->densify_until))
        return oxl_fail(
            ctx, OXL_ERR_USAGE,
            "--densify-until %g: density control would end after second lobes begin, expected less than "
            "%g\nfix: end it earlier, since Gaussians with a second lobe cannot be split, or use --dog "
            "off",
            o->densify_until, LOBES_FROM);
    return OXL_OK;
}

/* Returns the step at which lobes are assigned; 0: none. */
static int lobes_step(const oxl_train_options *o)
{
    return o->dog == OXL_DOG_OFF ? 0 : (int)(LOBES_FROM * o->iterations);
}

/* Gives Gaussians whose gradients are still large a second lobe: assigned once [OceanXL sec. 3.2]. */
static oxl_result lobes_assign(struct train *t)
{
    uint8_t *active = oxl_alloc(t->ctx, t->trained.model.count + 1, 1);
    int any = 0;
    const float threshold = t->options->dog == OXL_DOG_ALL ? -1 : LOBES_THRESHOLD;
    oxl_result rc = active ? step_download(t, DOWNLOAD_TO_CHANGE) : OXL_ERR_MEMORY;
    for (size_t i = 0; rc == OXL_OK && i < t->trained.model.count; i++) {
        active[i] = density_mean_gradient(&t->density, i) > threshold;
        any |= active[i];
    }
    if (any) rc = model_trained_make_lobes(t->ctx, &t->trained, active, LOBES_OPACITY, LOBES_SCALE);
    oxl_free(t->ctx, active);
    return rc;
}

/* Averages gradients in the last steps before lobes are due, then assigns them. */
static oxl_result lobes_after_step(struct train *t, void *state)
{
    struct lobes *l = state;
    const int last = lobes_step(t->options), watch = OXL_MAX(1, (int)(LOBES_WATCH * t->options->iterations));
    const int densified = (int)(t->options->densify_until * t->options->iterations);
    oxl_result rc = OXL_OK;
    if (last == 0 || l->stage == 2 || t->step <= OXL_MAX(last - watch, densified)) return OXL_OK;
    if (l->stage == 0) {
        rc = step_download(t, DOWNLOAD_TO_CHANGE);
        if (rc == OXL_OK) rc = density_clear(t->ctx, &t->density, t->trained.model.count);
        l->stage = 1;
    }
    if (rc == OXL_OK) rc = step_observe(t);
    if (rc != OXL_OK || t->step < last) return rc;
    l->stage = 2;
    return lobes_assign(t);
}

static void lobes_record(struct train *t, void *state)
{
    char chosen[64];
    (void)state;
    snprintf(chosen, sizeof chosen, "%zu of %zu", t->trained.model.lobes, t->trained.model.count);
    selection_record(t, "dog", chosen, "as set");
}

/* clang-format off */
static const oxl_option lobes_options[] = {
{"dog", "off|selective|all", OXL_OPTION_CHOICE, OPTION_AT(train.dog), 0, 2, PRESETS("off", "off", "selective"), OXL_TIER_ADVANCED, TRAINING | RESULT | NOT_REFINED, "Scene content", "give Gaussians a second, negative lobe (difference of Gaussians): gains 0 to 0.2 dB at an equal file size and takes 10 to 60 % more time"},
{0}};
/* clang-format on */

OXL_INTERNAL const struct part part_lobes = {.name = "lobes",
                                             .size = sizeof(struct lobes),
                                             .option = lobes_options,
                                             .check = lobes_check,
                                             .is_plain = 1,
                                             .after_step = lobes_after_step,
                                             .record = lobes_record};
