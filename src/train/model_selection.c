/* model_selection.c - model only what the scene requires: what `auto` has decided, with its evidence
 * (run.json), and the trial by which exposure is decided before the first step (src/parts/exposure.c).
 *
 * In a trial views that it does not train are validation views; its steps are taken back.
 *
 * Invariant: a decision is a function of the state before it; a run stopped in a trial repeats the trial.
 */
#include "parts_calls.h"
#include "../core/vecmath.h"
#include "../survey/scene.h"

/* mean squared error of 2 grey levels, as of a JPEG image: gains below it are no evidence */
#define SELECTION_NOISE 6e-5

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

OXL_INTERNAL void selection_log(struct train *t, const char *what, int on, const char *why)
{
    if (!t->task.window) /* a block repeats what the coarse model has decided */
        oxl_log(t->ctx, OXL_LOG_INFO, "%-12s %s, %.*s", what, on ? "on" : "off", (int)strcspn(why, ";"), why);
    oxl_log(t->ctx, OXL_LOG_DEBUG, "%s %s: %s", what, on ? "on" : "off", why);
}

OXL_INTERNAL void selection_record_auto(struct train *t, const char *what, oxl_switch mode, int on,
                                        const char *why)
{
    if (mode != OXL_AUTO || train_imaging_is_open(t)) return;
    selection_record(t, what, on ? "on" : "off", why);
    selection_log(t, what, on, why);
}

/* ---------------- validation views */

/* Returns 1 if the run trains the view. */
static int selection_is_training_view(const struct train *t, int view)
{
    return !oxl_scene_view(t->scene, view)->is_test && (!t->task.window || t->task.window[view].width > 0);
}

OXL_INTERNAL oxl_result selection_begin(struct train *t)
{
    const size_t views = (size_t)oxl_scene_view_count(t->scene);
    t->view = oxl_alloc(t->ctx, views + 1, sizeof *t->view);
    t->validation = oxl_alloc(t->ctx, views + 1, sizeof *t->validation);
    if (!t->view || !t->validation) return OXL_ERR_MEMORY;
    for (int i = 0; i < (int)views; i++)
        if (selection_is_training_view(t, i)) t->view[t->views++] = i;
    if (t->views == 0)
        return oxl_fail(
            t->ctx, OXL_ERR_INPUT,
            "there is no training view: all %zu images that exist are held out\nfix: add the training "
            "images; or use --test-every 0, unless the survey states the split",
            views);
    return OXL_OK;
}

OXL_INTERNAL void selection_hold(struct train *t, int half)
{
    const int views = t->views;
    t->views = t->validation_views = 0;
    for (int i = 0; i < views; i++)
        if (i % 2 == half) t->validation[t->validation_views++] = t->view[i];
        else t->view[t->views++] = t->view[i];
}

/* Renders the validation views that can be read and averages their PSNR; NaN without any. */
static oxl_result selection_validate(struct train *t, double *psnr)
{
    struct renderer_loss one;
    oxl_result rc = step_flush(t);
    int seen = 0;
    *psnr = 0;
    for (int i = 0; i < t->validation_views && rc == OXL_OK; i++) {
        rc = step_load_image(t, t->validation[i]);
        if (rc == OXL_ERR_INPUT ||
            (rc == OXL_ERR_IO && !scene_misses_too_many(t->scene, (int)t->nonfinite.images + 1))) {
            nonfinite_count_unreadable(t->ctx, &t->nonfinite);
            rc = OXL_OK;
            continue;
        }
        if (rc == OXL_OK) rc = step_loss_of_view(t, t->validation[i], &one);
        if (rc == OXL_OK) *psnr -= VECMATH_DECIBEL_OF_E * vecmath_log(one.mse + SELECTION_NOISE), seen++;
    }
    *psnr = seen > 0 ? *psnr / seen : NAN;
    return rc;
}

/* ---------------- a trial: the same steps from the same state */

OXL_INTERNAL oxl_result selection_train_trial(struct train *t, int steps, double *psnr)
{
    const int end = OXL_MIN(t->step + steps, t->options->iterations);
    oxl_result rc = OXL_OK;
    while (rc == OXL_OK && t->step < end) {
        t->step++;
        rc = step_on_next_view(t);
        if (rc == OXL_OK && step_report(t, 1)) rc = OXL_ERR_INTERRUPTED;
    }
    return rc == OXL_OK ? selection_validate(t, psnr) : rc;
}

OXL_INTERNAL oxl_result selection_trial(struct train *t)
{
    struct train_branch start = {0};
    oxl_result rc = branch_save(t, &start);
    if (rc == OXL_OK) {
        t->is_trial = 1;
        rc = parts_trial(t, &start);
        t->is_trial = 0;
        if (rc == OXL_OK) t->trial = 0;
        else { /* as before the trial */ const oxl_result back = branch_load(t, &start);
            if (back != OXL_OK) rc = back;
        }
    }
    branch_free(t, &start);
    return rc;
}

/* ---------------- checkpoints */

OXL_INTERNAL void selection_archive(struct archive *a, struct train *t)
{
    archive_int(a, &t->trial);
    archive_expect(a, t->trial == 0 || t->trial == 1);
    archive_text(a, &t->decisions);
}
