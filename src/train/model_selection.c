/* model_selection.c - model only what the scene requires: SH degree and second lobes are kept if they improve
 * validation views.
 *
 * Some training views are validation views: from SELECTION_HELD of the run before the end of density control
 * to the last decision they are not trained on. Held out from the first step they are what a short run does
 * not learn any more (docs/log/GROWTH.md); what the model knows of them from before is the same in all
 * alternatives. A decision is a trial: each alternative is trained from the same state for a fortieth of the
 * run, and the smallest one that is good enough is kept. (Rendering without its higher SH degrees is no
 * evidence: the lower ones have adapted to them. By that test a scene without view dependence seemed to need
 * degree 3.) Each decision is noted with its evidence (run.json). Exposure has a trial of its own, before the
 * first step (src/parts/exposure.c).
 *
 * Invariant: a decision is a function of the state after the step that it follows; a run stopped in a trial
 * repeats the trial.
 */
#include "parts_calls.h"
#include "../core/vecmath.h"
#include "../survey/scene.h"

/* mean squared error of 2 grey levels, as of a JPEG image: gains below it are no evidence */
#define SELECTION_NOISE 6e-5
#define SELECTION_HELD 0.1        /* of the run */
enum { SELECTION_VIEWS_MAX = 8 }; /* limit of validation views */

/* Adds choice and evidence as a member of the object. */
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

OXL_INTERNAL void selection_record_auto(struct train *t, const char *what, oxl_switch mode, int on,
                                        const char *why)
{
    if (mode != OXL_AUTO || train_imaging_is_open(t)) return;
    selection_record(t, what, on ? "on" : "off", why);
    oxl_log(t->ctx, OXL_LOG_INFO, "%s %s: %s", what, on ? "on" : "off", why);
}

/* ---------------- validation views */

OXL_INTERNAL int selection_is_validation_view(int index, int views)
{
    const int validation = OXL_CLAMP(views / 8, 1, SELECTION_VIEWS_MAX), stride = views / validation;
    return views > 1 && index % stride == stride / 2 && index / stride < validation;
}

/* Returns 1 if the run trains the view or holds it for validation. */
static int selection_is_training_view(const struct train *t, int view)
{
    return !oxl_scene_view(t->scene, view)->is_test && (!t->task.window || t->task.window[view].width > 0);
}

OXL_INTERNAL oxl_result selection_begin(struct train *t)
{
    const size_t views = (size_t)oxl_scene_view_count(t->scene);
    t->view = oxl_alloc(t->ctx, views + 1, sizeof *t->view);
    t->validation = oxl_alloc(t->ctx, OXL_MAX(views, SELECTION_VIEWS_MAX), sizeof *t->validation);
    if (!t->view || !t->validation) return OXL_ERR_MEMORY;
    for (int i = 0; i < (int)views; i++)
        if (selection_is_training_view(t, i)) t->view[t->views++] = i;
    if (t->views == 0)
        return oxl_fail(t->ctx, OXL_ERR_INPUT,
                        "there is no training view\nfix: --test-every 0 holds none out");
    return OXL_OK;
}

/* Returns the place of a view among those that are trained; t->views: it is not there, or cannot be read. */
static int selection_slot(const struct train *t, int view)
{
    int slot = 0;
    while (slot < t->views && t->view[slot] != view) slot++;
    return slot;
}

OXL_INTERNAL void selection_hold(struct train *t, int half)
{
    const int views = t->views;
    int index = 0;
    for (int i = 0; i < oxl_scene_view_count(t->scene); i++) {
        const int slot = selection_slot(t, i);
        if (slot == t->views) continue;
        if (half < 0 ? !selection_is_validation_view(index++, views) : index++ % 2 != half) continue;
        t->views--;
        memmove(t->view + slot, t->view + slot + 1, (size_t)(t->views - slot) * sizeof *t->view);
        t->validation[t->validation_views++] = i;
    }
}

OXL_INTERNAL void selection_hold_views(struct train *t)
{
    const oxl_train_options *o = t->options;
    if (t->validation_views > 0 || t->step <= (o->densify_until - SELECTION_HELD) * o->iterations) return;
    if (t->step > parts_validate_until(t) || t->views < SELECTION_VIEWS_MIN) return;
    selection_hold(t, -1);
}

OXL_INTERNAL void selection_release_views(struct train *t)
{
    if (t->step < parts_validate_until(t) || t->trial) return;
    while (t->validation_views > 0) t->view[t->views++] = t->validation[--t->validation_views];
}

/* Logs an unreadable view and removes it, so that all means are over the same views. Replaces the last one by
 * a view that was trained on until now, the same in all branches of a trial: without any, no decision could
 * be made. */
static void selection_drop_view(struct train *t, int slot)
{
    nonfinite_count_unreadable(t->ctx, &t->nonfinite);
    t->validation_views--;
    memmove(t->validation + slot, t->validation + slot + 1,
            (size_t)(t->validation_views - slot) * sizeof *t->validation);
    if (t->validation_views == 0 && t->views > 1) t->validation[t->validation_views++] = t->view[--t->views];
}

/* Renders the validation views and averages loss and PSNR; NaN without validation views. */
OXL_INTERNAL oxl_result selection_validate(struct train *t, double *loss, double *psnr)
{
    struct renderer_loss one;
    oxl_result rc = step_flush(t);
    *loss = *psnr = 0;
    for (int i = 0; i < t->validation_views && rc == OXL_OK;) {
        rc = step_load_image(t, t->validation[i]);
        if (rc == OXL_ERR_INPUT ||
            (rc == OXL_ERR_IO && !scene_misses_too_many(t->scene, (int)t->nonfinite.images + 1))) {
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

OXL_INTERNAL oxl_result selection_train_trial(struct train *t, int steps, double *psnr)
{
    const int end = OXL_MIN(t->step + steps, t->options->iterations);
    oxl_result rc = OXL_OK;
    double loss;
    while (rc == OXL_OK && t->step < end) {
        t->step++;
        rc = step_on_next_view(t);
        if (rc == OXL_OK && step_report(t, 1)) rc = OXL_ERR_INTERRUPTED;
    }
    return rc == OXL_OK ? selection_validate(t, &loss, psnr) : rc;
}

OXL_INTERNAL oxl_result selection_trial(struct train *t)
{
    struct train_branch start = {0};
    oxl_result rc = branch_save(t, &start);
    if (rc == OXL_OK) {
        t->is_trial = 1;
        rc = parts_trial(t, &start);
        t->is_trial = 0;
        if (rc == OXL_OK) t->trial = NULL;
        else { /* as before the trial */ const oxl_result back = branch_load(t, &start);
            if (back != OXL_OK) rc = back;
        }
    }
    if (rc == OXL_OK) selection_release_views(t);
    branch_free(t, &start);
    return rc;
}

/* ---------------- checkpoints */

OXL_INTERNAL void selection_archive(struct archive *a, struct train *t)
{
    int trial = 0; /* row of t->trial, from 1; 0: none */
    for (int k = 0; parts_at(k); k++)
        if (parts_at(k) == t->trial) trial = k + 1;
    archive_int(a, &trial);
    archive_int(a, &t->validation_views);
    t->trial = NULL;
    for (int k = 0; parts_at(k); k++)
        if (k + 1 == trial && parts_at(k)->trial) t->trial = parts_at(k);
    archive_expect(a, trial == 0 || t->trial);
    archive_expect(a, t->validation_views >= 0 && t->validation_views <= SELECTION_VIEWS_MAX);
    if (a->rc == OXL_OK) archive_ints(a, t->validation, (size_t)t->validation_views);
    for (int i = 0; i < t->validation_views && a->rc == OXL_OK; i++)
        archive_expect(a, t->validation[i] >= 0 && t->validation[i] < oxl_scene_view_count(t->scene));
    archive_text(a, &t->decisions);
}
