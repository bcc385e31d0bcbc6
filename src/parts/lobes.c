/* lobes.c - second, negative lobes (difference of Gaussians) for the primitives that need them (paper sec.
 * 3.2, eq. 3, 4): assigned once, where the mean gradient of the last steps is above a threshold.
 *
 * `auto` decides by a trial: from one state the run goes on without lobes and with them, for a fortieth of
 * the run, and keeps them if the validation views gain.
 */
#include "../train/part.h"
#include "../core/option_rows.h"
#include "../survey/scene.h"

#define LOBES_MIN_GAIN 0.05    /* dB: minimum gain of second lobes */
#define LOBES_WATCH (1.0 / 40) /* of the run: gradients are averaged before lobes are assigned [OceanXL] */

OXL_TABLE const struct part part_lobes;

enum lobes_stage { /* DUE: assigned, or the trial is asked for; DECIDED: by the trial */
                   LOBES_IDLE,
                   LOBES_WATCHED,
                   LOBES_DUE,
                   LOBES_DECIDED
};

struct lobes {
    int stage; /* enum lobes_stage */
};

static oxl_result lobes_check(oxl_context *ctx, const oxl_train_options *o)
{
    if (o->dog != OXL_DOG_OFF && !(o->dog_from > o->densify_until && o->dog_from <= 1))
        return oxl_fail(
            ctx, OXL_ERR_USAGE,
            "second lobes from %g of the run: expected more than %g, the end of density control, and at most 1\n"
            "fix: rows with a second lobe cannot be split; give lobes later or end density control earlier",
            o->dog_from, o->densify_until);
    return OXL_OK;
}

static void lobes_archive(struct archive *a, struct train *t, void *state)
{
    struct lobes *l = state;
    (void)t;
    archive_int(a, &l->stage);
    archive_expect(a, l->stage >= LOBES_IDLE && l->stage <= LOBES_DECIDED);
}

/* Returns the step at which lobes are assigned; 0: none. */
static int lobes_step(const oxl_train_options *o)
{
    return o->dog == OXL_DOG_OFF ? 0 : (int)(o->dog_from * o->iterations);
}

/* Finds the mean gradient above which a row gets a lobe. An option at or below 0 is a quantile: -0.9 lets the
 * upper tenth have lobes. */
static oxl_result lobes_threshold(const struct train *t, double *out)
{
    const float threshold = t->options->dog_threshold;
    const size_t count = t->trained.model.count;
    double *gradient;
    *out = threshold;
    if (t->options->dog == OXL_DOG_ALL) *out = -1;
    if (threshold > 0 || t->options->dog == OXL_DOG_ALL) return OXL_OK;
    gradient = oxl_alloc(t->ctx, count + 1, sizeof *gradient);
    if (!gradient) return OXL_ERR_MEMORY;
    for (size_t i = 0; i < count; i++) gradient[i] = density_mean_gradient(t->density, i);
    *out = stats_select(gradient, count, -threshold);
    oxl_free(t->ctx, gradient);
    return OXL_OK;
}

/* Gives Gaussians whose gradients are still large a second lobe: assigned once [OceanXL sec. 3.2]. */
static oxl_result lobes_assign(struct train *t)
{
    const oxl_train_options *o = t->options;
    uint8_t *active = oxl_alloc(t->ctx, t->trained.model.count + 1, 1);
    size_t given = 0;
    double threshold = 0;
    oxl_result rc = active ? step_download(t, DOWNLOAD_TO_CHANGE) : OXL_ERR_MEMORY;
    if (rc == OXL_OK) rc = lobes_threshold(t, &threshold);
    if (rc != OXL_OK) goto done;
    for (size_t i = 0; i < t->trained.model.count; i++) {
        active[i] = density_mean_gradient(t->density, i) > threshold;
        given += active[i];
    }
    oxl_log(t->ctx, OXL_LOG_INFO, "step %d: %zu of %zu Gaussians get a second lobe", t->step, given,
            t->trained.model.count);
    if (given > 0)
        rc =
            model_trained_make_lobes(t->ctx, &t->trained, active, o->dog_opacity_factor, o->dog_scale_factor);
done:
    oxl_free(t->ctx, active);
    return rc;
}

/* Averages gradients in the last steps before lobes are due, then assigns them or asks for the trial. Another
 * part's trial may pass these steps; then the next step does it. */
static oxl_result lobes_after_step(struct train *t, void *state)
{
    struct lobes *l = state;
    const int last = lobes_step(t->options), watch = OXL_MAX(1, (int)(LOBES_WATCH * t->options->iterations));
    const int densified = (int)(t->options->densify_until * t->options->iterations);
    oxl_result rc = OXL_OK;
    if (last == 0 || l->stage >= LOBES_DUE || t->step <= OXL_MAX(last - watch, densified)) return OXL_OK;
    if (l->stage == LOBES_IDLE) {
        rc = step_download(t, DOWNLOAD_TO_CHANGE);
        if (rc == OXL_OK) rc = density_clear(t->ctx, t->density, t->trained.model.count);
        l->stage = LOBES_WATCHED;
    }
    if (rc == OXL_OK) rc = step_observe(t);
    if (rc != OXL_OK || t->step < last) return rc;
    l->stage = LOBES_DUE;
    if (t->options->dog == OXL_DOG_AUTO && t->validation_views > 0) t->trial = &part_lobes;
    return t->options->dog == OXL_DOG_AUTO ? OXL_OK : lobes_assign(t);
}

static int lobes_validates_until(const struct train *t, const void *state)
{
    (void)state;
    return t->options->dog == OXL_DOG_AUTO ? lobes_step(t->options) : 0;
}

/* ---------------- the trial */

static void lobes_record_trial(struct train *t, int kept, const double psnr[2], const double bytes[2])
{
    char why[256];
    snprintf(
        why, sizeof why,
        "%d validation views, after %d steps: %.2f dB with second lobes, %.2f without; %.1f %% more bytes; "
        "kept from +%.2g dB",
        t->validation_views, schedule_trial_steps(t->options), psnr[1], psnr[0],
        100 * (bytes[1] / bytes[0] - 1), LOBES_MIN_GAIN);
    selection_record(t, "dog", kept ? "selective" : "off", why);
    oxl_log(t->ctx, OXL_LOG_INFO, "step %d: second lobes %s: %s", t->step, kept ? "stay" : "go", why);
}

/* Trains without lobes first, then with them. */
static oxl_result lobes_trial(struct train *t, void *state, struct train_branch *start)
{
    struct lobes *l = state;
    struct train_branch without = {0};
    double psnr[2], bytes[2];
    oxl_result rc = selection_train_trial(t, schedule_trial_steps(t->options), &psnr[0]);
    if (rc == OXL_OK) rc = branch_save(t, &without);
    if (rc == OXL_OK) rc = branch_load(t, start);
    if (rc == OXL_OK) rc = lobes_assign(t);
    if (rc == OXL_OK) rc = selection_train_trial(t, schedule_trial_steps(t->options), &psnr[1]);
    if (rc == OXL_OK) {
        const int kept = psnr[1] >= psnr[0] + LOBES_MIN_GAIN;
        bytes[0] = (double)t->trained.model.count * model_row_bytes(t->trained.model.sh_degree);
        bytes[1] = bytes[0] + (double)t->trained.model.lobes * MODEL_LOBE_BYTES;
        lobes_record_trial(t, kept, psnr, bytes);
        if (!kept) rc = branch_load(t, &without);
        l->stage = LOBES_DECIDED;
    }
    branch_free(t, &without);
    return rc;
}

static int lobes_trials(const oxl_train_options *o)
{
    return o->dog == OXL_DOG_AUTO;
}

static void lobes_record(struct train *t, void *state)
{
    const struct lobes *l = state;
    char chosen[64];
    snprintf(chosen, sizeof chosen, "%zu of %zu", t->trained.model.lobes, t->trained.model.count);
    if (l->stage != LOBES_DECIDED)
        selection_record(t, "dog", chosen,
                         t->options->dog == OXL_DOG_AUTO ? "too few training views for validation"
                                                         : "as set");
}

/* clang-format off */
static const oxl_option lobes_options[] = {
{"dog", "off|selective|all|auto", OXL_OPTION_CHOICE, OPTION_AT(train.dog), 0, 3, PRESETS("off", "off", "selective"), OXL_TIER_ADVANCED, TRAINING | RESULT | NOT_REFINED, "Scene content", "give Gaussians a second, negative lobe (difference of Gaussians): 0 to 0.2 dB at equal bytes, 10 to 20 % more time; auto: selective, if validation views gain", NULL},
{"dog-threshold", "T|PERCENT%", OXL_OPTION_LIMIT, OPTION_AT(train.dog_threshold), 1e-9, 1e15, EACH("0.0002"), OXL_TIER_ADVANCED, TRAINING | RESULT, "Scene content", "for --dog selective: mean gradient, in half images, above which Gaussians get a lobe; or the percentage without, e.g. 90%", NULL},
{"dog-from", "FRACTION", OXL_OPTION_FLOAT, OPTION_AT(train.dog_from), 0, 1, EACH("0.55"), OXL_TIER_EXPERT, TRAINING | RESULT, "Scene content", "fraction of the run at which lobes are added", NULL},
{"dog-opacity-factor", "X", OXL_OPTION_FLOAT, OPTION_AT(train.dog_opacity_factor), 1e-6, 0.999999, EACH("0.1"), OXL_TIER_EXPERT, TRAINING | RESULT, "Scene content", "opacity of a new lobe, relative to its Gaussian", NULL},
{"dog-scale-factor", "X", OXL_OPTION_FLOAT, OPTION_AT(train.dog_scale_factor), 1e-3, 1000, EACH("1.6"), OXL_TIER_EXPERT, TRAINING | RESULT, "Scene content", "scale of a new lobe, relative to its Gaussian", NULL},
{0}};
/* clang-format on */

OXL_INTERNAL const struct part part_lobes = {.name = "lobes",
                                             .size = sizeof(struct lobes),
                                             .option = lobes_options,
                                             .check = lobes_check,
                                             .archive = lobes_archive,
                                             .after_step = lobes_after_step,
                                             .validates_until = lobes_validates_until,
                                             .trial = lobes_trial,
                                             .trials = lobes_trials,
                                             .record = lobes_record};
