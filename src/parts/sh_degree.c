/* sh_degree.c - the degree of the spherical harmonics, by which colour depends on the direction of view:
 * raised step by step (Kerbl et al. 2023). `auto` is 3, or less where --ram has no room for it (budget.c).
 */
#include "../train/part.h"
#include "../core/option_rows.h"

#define SH_DEGREE_EVERY (1.0 / 30) /* of the run: 1000 of 30 000 iterations (Kerbl 2023, code) */
#define SH_DEGREE_ROUNDING 1e-6    /* intervals: the quotient of a whole number of them may come out less */

static int sh_degree_final(const struct train *t)
{
    return t->options->sh_degree < 0 ? 3 : t->options->sh_degree;
}

/* Begins. A model to start from may have more bands than are asked for. */
static oxl_result sh_degree_begin(struct train *t, void *state)
{
    (void)state;
    if (!t->task.from || t->trained.model.sh_degree <= sh_degree_final(t)) return OXL_OK;
    return model_trained_set_degree(t->ctx, &t->trained, sh_degree_final(t));
}

/* Raises the degree by one after each SH_DEGREE_EVERY of the run, up to the final one. */
static oxl_result sh_degree_before_step(struct train *t, void *state)
{
    const int wanted = OXL_MIN(
        sh_degree_final(t), (int)(t->step / (SH_DEGREE_EVERY * t->options->iterations) + SH_DEGREE_ROUNDING));
    int moved = 0;
    oxl_result rc = OXL_OK;
    (void)state;
    if (wanted <= t->trained.model.sh_degree) return OXL_OK;
    rc = step_download(t, DOWNLOAD_SHAPE);
    if (rc == OXL_OK) rc = step_move_rows(t, NULL, NULL, wanted, &moved);
    if (rc == OXL_OK) rc = model_trained_set_degree(t->ctx, &t->trained, wanted);
    if (rc == OXL_OK && moved) rc = renderer_send_shape(t->renderer, &t->trained.model, 0);
    return rc;
}

/* clang-format off */
static const oxl_option sh_degree_options[] = {
{"sh-degree", "auto|0..3", OXL_OPTION_INT, OPTION_AT(train.sh_degree), 0, 3, PRESETS("auto", "auto", "3"), OXL_TIER_BASIC, TRAINING | RESULT, "Training", "degree of spherical harmonics (view-dependent colour); auto: 3, or 1 where memory is short"},
{0}};
/* clang-format on */

OXL_INTERNAL const struct part part_sh_degree = {.name = "sh_degree",
                                                 .option = sh_degree_options,
                                                 .begin = sh_degree_begin,
                                                 .before_step = sh_degree_before_step};
