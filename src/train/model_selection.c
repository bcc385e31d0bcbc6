/* model_selection.c - model only what the scene requires: what `auto` has decided, with its evidence
 * (run.json).
 */
#include "parts_calls.h"
#include "../core/vecmath.h"
#include "../survey/scene.h"

/* Adds choice and evidence as a member of the object. */
OXL_INTERNAL void selection_record(struct train *t, const char *what, const char *chosen, const char *why)
{
    struct text *decisions = t->task.decisions;
    if (!decisions) return;
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
    const size_t end = strcspn(why, ";");
    if (t->task.window) return; /* a block repeats what the coarse model has decided */
    oxl_log(t->ctx, OXL_LOG_INFO, "%-12s %s, %.*s", what, on ? "on" : "off", (int)end, why);
    if (why[end]) oxl_log(t->ctx, OXL_LOG_DEBUG, "             %s", why + end + 2);
}

OXL_INTERNAL void selection_record_auto(struct train *t, const char *what, oxl_switch mode, int on,
                                        const char *why)
{
    if (mode != OXL_AUTO) return;
    selection_record(t, what, on ? "on" : "off", why);
    selection_log(t, what, on, why);
}

/* ---------------- the views */

OXL_INTERNAL oxl_result selection_begin(struct train *t)
{
    const size_t views = (size_t)t->scene->view_count;
    t->view = oxl_alloc(t->ctx, views + 1, sizeof *t->view);
    if (!t->view) return OXL_ERR_MEMORY;
    for (int i = 0; i < (int)views; i++)
        if (!t->scene->view[i].is_test && (!t->task.window || t->task.window[i].width > 0))
            t->view[t->views++] = i;
    if (t->views == 0)
        return oxl_fail(
            t->ctx, OXL_ERR_INPUT,
            "there is no training view: all %zu images that exist are held out\nfix: add the training "
            "images; or use --test-every 0, unless the survey states the split",
            views);
    return OXL_OK;
}
