/* model_selection.c - model only what the scene requires: SH degree and second lobes are kept if they improve
 * validation views.
 *
 * Some training views are validation views until the last decision, and are trained from then on. A decision
 * is a trial: each alternative is trained from the same state for a fortieth of the run, and the smallest one
 * that is good enough is kept. (Rendering without its higher SH degrees is no evidence: the lower ones have
 * adapted to them. By that test a scene without view dependence seemed to need degree 3.) Each decision is
 * noted with its evidence (run.json).
 *
 * Invariant: a decision is a function of the state after the step that it follows; a run stopped in a trial
 * repeats the trial.
 */
#include "train_state.h"
#include "../core/vecmath.h"
#include "../survey/scene.h"

#define SELECTION_SH_MIN_GAIN 0.1     /* dB: minimum gain of the highest degree over a lower one */
#define SELECTION_LOBES_MIN_GAIN 0.05 /* dB: minimum gain of second lobes */
/* mean squared error of 2 grey levels, as of a JPEG image: gains below it are no evidence */
#define SELECTION_NOISE 6e-5
/* fraction of the run: gradients are averaged before lobes are assigned [OceanXL] */
#define SELECTION_WATCH (1.0 / 40)
#define SELECTION_TRIAL (1.0 / 40) /* of the run: length of a trial */
enum {
    SELECTION_VIEWS_MIN = 8, /* with fewer training views none is used for validation */
    SELECTION_VIEWS_MAX = 8  /* limit of validation views */
};

/* Choice and evidence: one member of the object. */
OXL_INTERNAL void selection_record(struct train *t, const char *what, const char *chosen, const char *why)
{
    struct text *decisions = &t->decisions;
    if (decisions->size > 0) text_add(decisions, ", ");
    text_add_json_string(decisions, what);
    text_add(decisions, ": {\"chosen\": ");
    text_add_json_string(decisions, chosen);
    text_add(decisions, ", \"evidence\": ");
    text_add_json_string(decisions, why);
    text_add(decisions, "}");
}

static int selection_has_record(const struct train *t, const char *quoted)
{
    return !t->decisions.failed && strstr(t->decisions.data, quoted) != NULL;
}

/* ---------------- validation views */

static int selection_sh_degree_at(const oxl_train_options *o)
{
    return o->sh_degree < 0 ? (int)(o->densify_until * o->iterations) : 0;
}

static int selection_lobes_at(const oxl_train_options *o)
{
    return o->dog == OXL_DOG_OFF ? 0 : (int)(o->dog_from * o->iterations);
}

/* The step after which all validation views are trained. */
static int selection_last_step(const struct train *t)
{
    const int lobes = t->options->dog == OXL_DOG_AUTO ? selection_lobes_at(t->options) : 0;
    const int keep = t->options->keep.kind == OXL_KEEP_AUTO ? t->prune.end : 0;
    return OXL_MAX(keep, OXL_MAX(lobes, selection_sh_degree_at(t->options)));
}

OXL_INTERNAL int selection_is_validation_view(int index, int views)
{
    const int validation = OXL_CLAMP(views / 8, 1, SELECTION_VIEWS_MAX), stride = views / validation;
    return views > 1 && index % stride == stride / 2 && index / stride < validation;
}

/* Of those that the run trains, the validation views too. */
static int selection_is_training_view(const struct train *t, int view)
{
    return !oxl_scene_view(t->scene, view)->is_test &&
           (!t->output || !t->output->window || t->output->window[view].width > 0);
}

/* Both in name order. */
OXL_INTERNAL oxl_result selection_begin(struct train *t)
{
    int views = 0, index = 0, holds;
    for (int i = 0; i < oxl_scene_view_count(t->scene); i++) views += selection_is_training_view(t, i);
    holds = selection_last_step(t) > 0 && views >= SELECTION_VIEWS_MIN;
    t->sh_degree = t->options->sh_degree < 0 ? 3 : t->options->sh_degree;
    t->view = oxl_alloc(t->ctx, (size_t)views + 1, sizeof *t->view);
    t->validation = oxl_alloc(t->ctx, (size_t)views + 1, sizeof *t->validation);
    if (!t->view || !t->validation)
        return oxl_fail(t->ctx, OXL_ERR_MEMORY, "no memory for the order of the views");
    for (int i = 0; i < oxl_scene_view_count(t->scene); i++) {
        const int trains = selection_is_training_view(t, i),
                  validation = trains && holds && selection_is_validation_view(index++, views);
        if (validation) t->validation[t->validation_views++] = i;
        else if (trains) t->view[t->views++] = i;
    }
    if (t->views == 0)
        return oxl_fail(t->ctx, OXL_ERR_INPUT,
                        "there is no training view\nfix: --test-every 0 holds none out");
    return OXL_OK;
}

static void selection_release_views(struct train *t)
{
    if (t->step < selection_last_step(t) || t->trial_is_next) return;
    while (t->validation_views > 0) t->view[t->views++] = t->validation[--t->validation_views];
}

/* An unreadable view is logged and removed, so that all means are over the same views. The last one is replaced by a
 * view that was trained on until now, the same in all branches of a trial: without any, no decision could be made. */
static void selection_drop_view(struct train *t, int slot)
{
    nonfinite_count_unreadable(t->ctx, &t->nonfinite);
    t->validation_views--;
    memmove(t->validation + slot, t->validation + slot + 1,
            (size_t)(t->validation_views - slot) * sizeof *t->validation);
    if (t->validation_views == 0 && t->views > 1) t->validation[t->validation_views++] = t->view[--t->views];
}

/* NaN without validation views. */
OXL_INTERNAL oxl_result selection_validate(struct train *t, double *loss, double *psnr)
{
    struct renderer_loss one;
    oxl_result rc = step_flush(t);
    *loss = *psnr = 0;
    for (int i = 0; i < t->validation_views && rc == OXL_OK;) {
        rc = step_load_image(t, t->validation[i]);
        if (rc == OXL_ERR_INPUT) {
            selection_drop_view(t, i);
            rc = OXL_OK;
            continue;
        }
        if (rc == OXL_OK) rc = step_loss_of_view(t, t->validation[i++], &one);
        if (rc != OXL_OK) break;
        *loss += one.total;
        *psnr -= VECMATH_DECIBEL_OF_E * vecmath_log(one.mse + SELECTION_NOISE);
    }
    *loss = t->validation_views > 0 ? *loss / t->validation_views : NAN;
    *psnr = t->validation_views > 0 ? *psnr / t->validation_views : NAN;
    return rc;
}

/* ---------------- a trial: the same steps from the same state */

static int selection_steps(const struct train *t, double fraction)
{
    return OXL_MAX(1, (int)(fraction * t->options->iterations));
}

/* Trains for the length of a trial and evaluates the result. */
static oxl_result selection_train_trial(struct train *t, double *psnr)
{
    const int end = OXL_MIN(t->step + selection_steps(t, SELECTION_TRIAL), t->options->iterations);
    oxl_result rc = OXL_OK;
    double loss;
    while (rc == OXL_OK && t->step < end) {
        t->step++;
        rc = step_on_next_view(t);
        if (rc == OXL_OK && step_report(t, 1)) rc = OXL_ERR_INTERRUPTED;
    }
    return rc == OXL_OK ? selection_validate(t, &loss, psnr) : rc;
}

/* ---------------- SH degree */

static oxl_result selection_set_degree(struct train *t, int degree)
{
    const oxl_result rc = step_download(t, DOWNLOAD_TO_CHANGE);
    return rc == OXL_OK ? model_trained_set_degree(t->ctx, &t->trained, degree) : rc;
}

static void selection_record_sh_degree(struct train *t, int most, const double psnr[4])
{
    char why[256], chosen[16];
    int used = snprintf(why, sizeof why, "%d validation views, after %d steps: degree %d %.2f dB",
                        t->validation_views, selection_steps(t, SELECTION_TRIAL), most, psnr[most]);
    for (int d = 0; d < most && d <= t->sh_degree; d++)
        used += snprintf(why + used, sizeof why - (size_t)used, ", degree %d %.2f", d, psnr[d]);
    snprintf(why + used, sizeof why - (size_t)used, "; the first within %.2g dB is enough",
             SELECTION_SH_MIN_GAIN);
    snprintf(chosen, sizeof chosen, "%d", t->sh_degree);
    selection_record(t, "sh_degree", chosen, why);
    oxl_log(t->ctx, OXL_LOG_INFO, "step %d: SH degree %d: %s", t->step, t->sh_degree, why);
}

/* The highest degree first, then 0, 1... until that is enough: t is that branch in the end. */
static oxl_result selection_try_sh_degree(struct train *t, struct train_branch *start,
                                          struct train_branch *all, double psnr[4])
{
    struct train_branch other = {0};
    const int most = t->trained.model.sh_degree;
    oxl_result rc = selection_train_trial(t, &psnr[most]);
    t->sh_degree = most;
    if (rc == OXL_OK) rc = branch_restart(t, start, all);
    for (int d = 0; d < most && rc == OXL_OK; d++) {
        if (d > 0) rc = branch_restart(t, start, &other);
        if (rc == OXL_OK) rc = selection_set_degree(t, d);
        if (rc == OXL_OK) rc = selection_train_trial(t, &psnr[d]);
        if (rc == OXL_OK && psnr[d] >= psnr[most] - SELECTION_SH_MIN_GAIN) {
            t->sh_degree = d;
            break;
        }
    }
    branch_free(t, &other);
    return rc == OXL_OK && t->sh_degree == most ? branch_swap(t, all) : rc;
}

OXL_INTERNAL void selection_sh_degree(struct train *t)
{
    if (t->step == selection_sh_degree_at(t->options) && t->validation_views > 0)
        t->trial_is_next = TRAIN_TRIES_SH_DEGREE;
    selection_release_views(t);
}

/* ---------------- which Gaussians get a second lobe */

/* A threshold at or below 0 is a quantile: -0.9 lets the upper tenth have lobes. */
static oxl_result selection_threshold(const struct train *t, double *out)
{
    const float threshold = t->options->dog_threshold;
    const size_t count = t->trained.model.count;
    double *gradient;
    *out = threshold;
    if (t->options->dog == OXL_DOG_ALL) *out = -1;
    if (threshold > 0 || t->options->dog == OXL_DOG_ALL) return OXL_OK;
    gradient = oxl_alloc(t->ctx, count + 1, sizeof *gradient);
    if (!gradient)
        return oxl_fail(t->ctx, OXL_ERR_MEMORY, "no memory to rank the gradients of %zu Gaussians", count);
    for (size_t i = 0; i < count; i++) gradient[i] = density_mean_gradient(t->density, i);
    *out = stats_select(gradient, count, -threshold);
    oxl_free(t->ctx, gradient);
    return OXL_OK;
}

/* Gaussians whose gradients are still large get a second lobe: assigned once [OceanXL sec. 3.2]. */
static oxl_result selection_assign_lobes(struct train *t)
{
    const oxl_train_options *o = t->options;
    uint8_t *active = oxl_alloc(t->ctx, t->trained.model.count + 1, 1);
    size_t given = 0;
    double threshold = 0;
    oxl_result rc = active ? step_download(t, DOWNLOAD_TO_CHANGE)
                           : oxl_fail(t->ctx, OXL_ERR_MEMORY, "no memory to give lobes");
    if (rc == OXL_OK) rc = selection_threshold(t, &threshold);
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

/* A trial may pass the steps at which gradients are first recorded or lobes assigned; then the next step does
 * it. */
OXL_INTERNAL oxl_result selection_lobes(struct train *t)
{
    const int last = selection_lobes_at(t->options), watch = selection_steps(t, SELECTION_WATCH);
    const int densified = (int)(t->options->densify_until * t->options->iterations);
    oxl_result rc = OXL_OK;
    if (last == 0 || t->lobes == LOBES_DECIDED || t->step <= OXL_MAX(last - watch, densified)) return OXL_OK;
    if (t->lobes == LOBES_IDLE) {
        rc = step_download(t, DOWNLOAD_TO_CHANGE);
        if (rc == OXL_OK) rc = density_clear(t->ctx, t->density, t->trained.model.count);
        t->lobes = LOBES_WATCHED;
    }
    if (rc == OXL_OK) rc = step_observe(t);
    if (rc != OXL_OK || t->step < last) return rc;
    t->lobes = LOBES_DECIDED;
    if (t->options->dog == OXL_DOG_AUTO && t->validation_views > 0) t->trial_is_next = TRAIN_TRIES_LOBES;
    return t->options->dog == OXL_DOG_AUTO ? OXL_OK : selection_assign_lobes(t);
}

/* ---------------- trials */

static void selection_record_lobes(struct train *t, int kept, const double psnr[2], const double bytes[2])
{
    char why[256];
    snprintf(
        why, sizeof why,
        "%d validation views, after %d steps: %.2f dB with second lobes, %.2f without; %.1f %% more bytes; "
        "kept from +%.2g dB",
        t->validation_views, selection_steps(t, SELECTION_TRIAL), psnr[1], psnr[0],
        100 * (bytes[1] / bytes[0] - 1), SELECTION_LOBES_MIN_GAIN);
    selection_record(t, "dog", kept ? "selective" : "off", why);
    oxl_log(t->ctx, OXL_LOG_INFO, "step %d: second lobes %s: %s", t->step, kept ? "stay" : "go", why);
}

/* Without lobes first, then with them: t is the better one in the end. */
static oxl_result selection_try_lobes(struct train *t, struct train_branch *start, struct train_branch *other,
                                      double psnr[2])
{
    double bytes[2];
    oxl_result rc = selection_train_trial(t, &psnr[0]);
    if (rc == OXL_OK) rc = branch_restart(t, start, other);
    if (rc == OXL_OK) rc = selection_assign_lobes(t);
    if (rc == OXL_OK) rc = selection_train_trial(t, &psnr[1]);
    if (rc != OXL_OK) return rc;
    bytes[0] = (double)t->trained.model.count * prune_row_bytes(t->trained.model.sh_degree, 0);
    bytes[1] = bytes[0] + (double)t->trained.model.lobes * (prune_row_bytes(0, 1) - prune_row_bytes(0, 0));
    selection_record_lobes(t, psnr[1] >= psnr[0] + SELECTION_LOBES_MIN_GAIN, psnr, bytes);
    return psnr[1] >= psnr[0] + SELECTION_LOBES_MIN_GAIN ? OXL_OK : branch_swap(t, other);
}

OXL_INTERNAL oxl_result selection_trial(struct train *t)
{
    struct train_branch start, other = {0};
    double psnr[4] = {0, 0, 0, 0};
    const int most = t->trained.model.sh_degree;
    oxl_result rc = branch_copy(t, &start);
    if (rc == OXL_OK && t->trial_is_next == TRAIN_TRIES_LOBES)
        rc = selection_try_lobes(t, &start, &other, psnr);
    else if (rc == OXL_OK) rc = selection_try_sh_degree(t, &start, &other, psnr);
    if (rc == OXL_OK) {
        if (t->trial_is_next == TRAIN_TRIES_SH_DEGREE) selection_record_sh_degree(t, most, psnr);
        t->trial_is_next = TRAIN_TRIES_NOTHING;
        selection_release_views(t);
    } else if (start.trained.square.memory) { /* as before the trial */
        oxl_result back;
        t->sh_degree = start.trained.model.sh_degree;
        back = branch_swap(t, &start);
        if (back != OXL_OK) rc = back;
    }
    branch_free(t, &start);
    branch_free(t, &other);
    return rc;
}

/* ---------------- the cost of trials */

/* Steps beyond the run's own: three of the four alternatives of a trial of SH degrees, one of two of
 * others. */
OXL_INTERNAL int selection_trial_steps(const oxl_train_options *o, int views)
{
    const int each = OXL_MAX(1, (int)(SELECTION_TRIAL * o->iterations));
    if (views < SELECTION_VIEWS_MIN) return 0;
    return each * ((o->sh_degree < 0 ? 3 : 0) + (o->dog == OXL_DOG_AUTO));
}

/* ---------------- at the end, and in between */

OXL_INTERNAL void selection_end(struct train *t)
{
    const oxl_train_options *o = t->options;
    char chosen[64], why[320];
    ucd_describe(&t->ucd, why, sizeof why);
    snprintf(chosen, sizeof chosen, t->ucd.on ? "%.3g,%.3g" : "off", t->ucd.f[0], t->ucd.f[1]);
    selection_record(t, "ucd", chosen, why);
    free_space_describe(&t->free_space, why, sizeof why);
    selection_record(t, "carve", t->free_space.view ? "on" : "off", why);
    snprintf(why, sizeof why, "%d training views of %.0f steps, %.1f images per point",
             schedule_training_views(t->scene),
             (double)o->iterations / OXL_MAX(schedule_training_views(t->scene), 1),
             t->scene->stats.mean_track);
    selection_record(t, "dropout", NUMBER(t->dropout),
                     o->dropout >= 0                    ? "as set"
                     : renderer_has_device(t->renderer) ? TRAIN_ON_DEVICE
                                                        : why);
    prune_describe(&t->prune, why, sizeof why);
    snprintf(chosen, sizeof chosen, "%zu", t->trained.model.count);
    selection_record(t, "keep", chosen, why);
    snprintf(chosen, sizeof chosen, "%d", t->trained.model.sh_degree);
    if (!selection_has_record(t, "\"sh_degree\""))
        selection_record(t, "sh_degree", chosen,
                         o->sh_degree < 0 ? "too few training views for validation" : "as set");
    snprintf(chosen, sizeof chosen, "%zu of %zu", t->trained.model.lobes, t->trained.model.count);
    if (!selection_has_record(t, "\"dog\""))
        selection_record(t, "dog", chosen,
                         o->dog == OXL_DOG_AUTO ? "too few training views for validation" : "as set");
}

OXL_INTERNAL void selection_archive(struct archive *a, struct train *t)
{
    archive_int(a, &t->sh_degree);
    archive_int(a, &t->trial_is_next);
    archive_int(a, &t->lobes);
    archive_expect(a, t->lobes >= LOBES_IDLE && t->lobes <= LOBES_DECIDED);
    archive_int(a, &t->validation_views);
    archive_expect(a, t->sh_degree >= 0 && t->sh_degree <= 3 && t->trial_is_next >= 0 &&
                          t->trial_is_next <= TRAIN_TRIES_LOBES);
    archive_expect(a, t->validation_views >= 0 && t->validation_views <= schedule_training_views(t->scene));
    if (a->rc == OXL_OK) archive_ints(a, t->validation, (size_t)t->validation_views);
    for (int i = 0; i < t->validation_views && a->rc == OXL_OK; i++)
        archive_expect(a, t->validation[i] >= 0 && t->validation[i] < oxl_scene_view_count(t->scene));
    archive_text(a, &t->decisions);
}
