/* metrics_json.c - writes metrics of a model as members of a JSON object, for metrics.json and the program's
 * output.
 */
#include "job.h"
#include "../survey/scene.h"

/* Counts the values that are always written, and all; the others are left out if they are NaN. */
enum { METRICS_ALWAYS = 5, METRICS_WRITTEN = 8 };

/* Adds values as members of a JSON object, separated by `between`. */
static void metrics_json_add_values(struct text *t, const char *between, const double values[METRICS_WRITTEN])
{
    static const char *const names[] = {"psnr",      "cc_psnr",    "ssim",         "plain_psnr",
                                        "structure", "shown_psnr", "aligned_psnr", "aligned_ssim"};
    for (int i = 0; i < METRICS_WRITTEN; i++)
        if (i < METRICS_ALWAYS || !isnan(values[i]))
            text_add(t, "%s\"%s\": %s", i ? between : "", names[i], NUMBER(values[i]));
}

OXL_INTERNAL oxl_result metrics_json_add(struct text *t, const oxl_scene *scene, const oxl_metrics *m)
{
    text_add(t, "  ");
    metrics_json_add_values(t, ",\n  ",
                            (double[METRICS_WRITTEN]){m->psnr, m->cc_psnr, m->ssim, m->plain_psnr,
                                                      m->structure, m->shown_psnr, m->aligned_psnr,
                                                      m->aligned_ssim});
    text_add(t, ",\n  \"unshown\": %s,\n  \"structure_least\": %s,\n  \"no_structure\": %d,\n",
             NUMBER(m->unshown), NUMBER(m->structure_least), m->no_structure);
    text_add(t, "  \"count\": %d,\n  \"views\": [", m->count);
    for (int i = 0; i < m->count; i++) {
        const oxl_view_metrics *v = &m->views[i];
        text_add(t, "%s\n    {\"name\": ", i ? "," : "");
        text_add_json_string(t, scene->view[v->view].name);
        text_add(t, ", ");
        metrics_json_add_values(t, ", ",
                                (double[METRICS_WRITTEN]){v->psnr, v->cc_psnr, v->ssim, v->plain_psnr,
                                                          v->structure, v->shown_psnr, v->aligned_psnr,
                                                          v->aligned_ssim});
        text_add(t, ", \"unshown\": [%s, %s, %s, %s]}", NUMBER(v->unshown[0]), NUMBER(v->unshown[1]),
                 NUMBER(v->unshown[2]), NUMBER(v->unshown[3]));
    }
    text_add(t, "%s]\n", m->count ? "\n  " : "");
    return t->failed ? OXL_ERR_MEMORY : OXL_OK;
}
