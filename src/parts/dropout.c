/* dropout.c - leaves out a random part of the Gaussians in each step, more towards the end of the run, so
 * that they do not rely on each other (DropGaussian, Park et al. 2025).
 *
 * It helps surveys of few images and costs detail in others: `auto` takes it for few views, few images per
 * point, and long runs (docs/METHOD.md).
 */
#include "dropout.h"
#include "../core/option_rows.h"
#include "../survey/scene.h"

#define DROPOUT_STREAM (UINT64_C(0x44524f50) << 24) /* random numbers of dropout: "DROP" in ASCII */
/* fraction of Gaussians left out in the last step (docs/METHOD.md) */
#define DROPOUT_AUTO 0.4
/* images that see a point, on average: with as many, no dropout, which would cost detail */
#define DROPOUT_IMAGES 4.6
/* training views: with as many there is no dropout, for the same reason */
#define DROPOUT_VIEWS 30
/* epochs: a run of so many has no dropout, one of twice as many all of it */
#define DROPOUT_EPOCHS 30

OXL_INTERNAL double dropout_rate(const oxl_train_options *o, const oxl_scene *scene)
{
    const double images = scene->stats.mean_track;
    const int views = schedule_training_views(scene);
    const double epochs = (double)o->iterations / OXL_MAX(views, 1);
    if (o->dropout >= 0) return o->dropout;
    if (images <= 0 || images >= DROPOUT_IMAGES || views >= DROPOUT_VIEWS) return 0;
    return DROPOUT_AUTO * OXL_CLAMP(epochs / DROPOUT_EPOCHS - 1, 0, 1);
}

static oxl_result dropout_before_render(struct train *t, void *state, struct part_view *v)
{
    (void)state, (void)v;
    renderer_settings(t->renderer)->dropout =
        (struct renderer_dropout){dropout_rate(t->options, t->scene) * t->step / t->options->iterations,
                                  DROPOUT_STREAM ^ t->ctx->options.seed, t->step};
    return OXL_OK;
}

static oxl_result dropout_after_render(struct train *t, void *state, struct part_view *v)
{
    (void)state, (void)v;
    renderer_settings(t->renderer)->dropout.fraction = 0;
    return OXL_OK;
}

static void dropout_record(struct train *t, void *state)
{
    const int views = schedule_training_views(t->scene);
    char why[320];
    (void)state;
    snprintf(why, sizeof why, "%d training views, %.0f steps each, %.1f images per point", views,
             (double)t->options->iterations / OXL_MAX(views, 1), t->scene->stats.mean_track);
    selection_record(t, "dropout", NUMBER(floor(dropout_rate(t->options, t->scene) * 1e5 + 0.5) / 1e5),
                     t->options->dropout >= 0 ? "as set" : why);
}

/* clang-format off */
static const oxl_option dropout_options[] = {
{"dropout", "auto|RATE", OXL_OPTION_FLOAT, OPTION_AT(train.dropout), 0, 0.8, EACH("auto"), OXL_TIER_ADVANCED, TRAINING | RESULT | NOT_REFINED, "Schedule", "fraction of the Gaussians left out of a step, rising from 0; auto: up to 0.4 in long runs of one block with fewer than 30 training views and fewer than 4.6 images per point"},
{0}};
/* clang-format on */

OXL_INTERNAL const struct part part_dropout = {.name = "dropout",
                                               .option = dropout_options,
                                               .before_render = dropout_before_render,
                                               .after_render = dropout_after_render,
                                               .record = dropout_record};
