/* sh_degree.c - the degree of the spherical harmonics, by which colour depends on the direction of view:
 * raised step by step (Kerbl et al. 2023), and with `auto` chosen on validation views.
 *
 * The trial: each degree is trained from the same state for a fortieth of the run, and the lowest that is
 * good enough is kept (model_selection.c). Runs too short for it end with the highest degree.
 */
#include "../train/part.h"
#include "../core/option_rows.h"

#define SH_DEGREE_MIN_GAIN 0.1  /* dB: minimum gain of the highest degree over a lower one */
#define SH_DEGREE_ROUNDING 1e-6 /* intervals: the quotient of a whole number of them may come out less */
#define SH_DEGREE_TRIAL 3000    /* iterations: in shorter runs the trial takes more time than it saves */

OXL_TABLE const struct part part_sh_degree;

struct sh_degree {
    int final;   /* the highest degree of the run */
    int decided; /* 1: by a trial */
};

/* Begins. A model to start from may have more bands than are asked for. */
static oxl_result sh_degree_begin(struct train *t, void *state)
{
    struct sh_degree *s = state;
    s->final = t->options->sh_degree < 0 ? 3 : t->options->sh_degree;
    if (!t->task.from || t->trained.model.sh_degree <= s->final) return OXL_OK;
    return model_trained_set_degree(t->ctx, &t->trained, s->final);
}

static void sh_degree_archive(struct archive *a, struct train *t, void *state)
{
    struct sh_degree *s = state;
    (void)t;
    archive_int(a, &s->final);
    archive_int(a, &s->decided);
    archive_expect(a, s->final >= 0 && s->final <= 3);
}

/* Raises the degree by one after each sh_degree_interval of the run, up to the final one. */
static oxl_result sh_degree_before_step(struct train *t, void *state)
{
    const struct sh_degree *s = state;
    const int wanted =
        OXL_MIN(s->final, (int)(t->step / (t->options->sh_degree_interval * t->options->iterations) +
                                SH_DEGREE_ROUNDING));
    int moved = 0;
    oxl_result rc = OXL_OK;
    if (wanted <= t->trained.model.sh_degree) return OXL_OK;
    rc = step_download(t, DOWNLOAD_SHAPE);
    if (rc == OXL_OK) rc = step_move_rows(t, NULL, NULL, wanted, &moved);
    if (rc == OXL_OK) rc = model_trained_set_degree(t->ctx, &t->trained, wanted);
    if (rc == OXL_OK && moved) rc = renderer_send_shape(t->ctx, t->renderer, &t->trained.model, 0);
    return rc;
}

/* ---------------- the trial */

/* Returns the step after which there is a trial; 0: none. */
static int sh_degree_trial_step(const oxl_train_options *o)
{
    return o->sh_degree < 0 && o->iterations >= SH_DEGREE_TRIAL ? (int)(o->densify_until * o->iterations) : 0;
}

/* Counts the degrees that are trained beyond the one that the run keeps: three of four. */
static int sh_degree_trials(const oxl_train_options *o)
{
    return sh_degree_trial_step(o) > 0 ? 3 : 0;
}

static void sh_degree_record_trial(struct train *t, int chose, int most, const double psnr[4])
{
    char why[256], chosen[16];
    int used = snprintf(why, sizeof why, "%d validation views, after %d steps: degree %d %.2f dB",
                        t->validation_views, schedule_trial_steps(t->options), most, psnr[most]);
    for (int d = 0; d < most && d <= chose; d++)
        used += snprintf(why + used, sizeof why - (size_t)used, ", degree %d %.2f", d, psnr[d]);
    snprintf(why + used, sizeof why - (size_t)used, "; the first within %.2g dB is enough",
             SH_DEGREE_MIN_GAIN);
    snprintf(chosen, sizeof chosen, "%d", chose);
    selection_record(t, "sh_degree", chosen, why);
    oxl_log(t->ctx, OXL_LOG_INFO, "step %d: SH degree %d: %s", t->step, chose, why);
}

/* Trains the highest degree first, then 0, 1... until that is enough. */
static oxl_result sh_degree_trial(struct train *t, void *state, struct train_branch *start)
{
    struct sh_degree *s = state;
    struct train_branch all = {0};
    const int most = t->trained.model.sh_degree;
    int chosen = most;
    double psnr[4] = {0, 0, 0, 0};
    oxl_result rc = selection_train_trial(t, schedule_trial_steps(t->options), &psnr[most]);
    if (rc == OXL_OK) rc = branch_save(t, &all);
    for (int d = 0; d < most && rc == OXL_OK && chosen == most; d++) {
        rc = branch_load(t, start);
        if (rc == OXL_OK) rc = model_trained_set_degree(t->ctx, &t->trained, d);
        if (rc == OXL_OK) rc = selection_train_trial(t, schedule_trial_steps(t->options), &psnr[d]);
        if (rc == OXL_OK && psnr[d] >= psnr[most] - SH_DEGREE_MIN_GAIN) chosen = d;
    }
    if (rc == OXL_OK && chosen == most && most > 0) rc = branch_load(t, &all);
    branch_free(t, &all);
    if (rc != OXL_OK) return rc;
    s->final = chosen;
    s->decided = 1;
    sh_degree_record_trial(t, chosen, most, psnr);
    return OXL_OK;
}

static oxl_result sh_degree_after_step(struct train *t, void *state)
{
    (void)state;
    if (t->step == sh_degree_trial_step(t->options) && t->validation_views > 0) t->trial = &part_sh_degree;
    return OXL_OK;
}

static int sh_degree_validates_until(const struct train *t, const void *state)
{
    (void)state;
    return sh_degree_trial_step(t->options);
}

static void sh_degree_record(struct train *t, void *state)
{
    const struct sh_degree *s = state;
    char chosen[16];
    snprintf(chosen, sizeof chosen, "%d", t->trained.model.sh_degree);
    if (!s->decided)
        selection_record(t, "sh_degree", chosen,
                         t->options->sh_degree < 0 ? "too few iterations or training views for a trial"
                                                   : "as set");
}

/* clang-format off */
static const oxl_option sh_degree_options[] = {
{"sh-degree", "auto|0..3", OXL_OPTION_INT, OPTION_AT(train.sh_degree), 0, 3, PRESETS("auto", "auto", "3"), OXL_TIER_BASIC, TRAINING | RESULT, "Training", "degree of spherical harmonics (view-dependent colour); auto: chosen on validation views, 3 below 3000 iterations", NULL},
{"sh-degree-interval", "FRACTION", OXL_OPTION_FLOAT, OPTION_AT(train.sh_degree_interval), 1e-6, 1000, EACH("1/30"), OXL_TIER_EXPERT, TRAINING | RESULT, "Schedule", "fraction of the run after which it rises by one", NULL},
{0}};
/* clang-format on */

OXL_INTERNAL const struct part part_sh_degree = {.name = "sh_degree",
                                                 .size = sizeof(struct sh_degree),
                                                 .option = sh_degree_options,
                                                 .is_branched = 1,
                                                 .begin = sh_degree_begin,
                                                 .archive = sh_degree_archive,
                                                 .before_step = sh_degree_before_step,
                                                 .after_step = sh_degree_after_step,
                                                 .validates_until = sh_degree_validates_until,
                                                 .trial = sh_degree_trial,
                                                 .trials = sh_degree_trials,
                                                 .record = sh_degree_record};
