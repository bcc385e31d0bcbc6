/* training_views.c - tells how well each training view fits, which views fit far worse than their neighbours
 * (a wrong pose, another exposure, blur, reflections), and which renders lack the structure of their images.
 *
 * A view is compared with the 8 nearest of similar direction. The gain of one factor for each channel beyond
 * their median is set against its spread over all views (median absolute deviation, 1.4826 of it is a
 * standard deviation [Rousseeuw & Croux 1993]).
 *
 * A short run judges some views, evenly spaced, finds their neighbours among these, and renders fewer.
 *
 * Invariant: nothing here changes the model; no view is left out of training.
 */
#include "job.h"
#include "../checks/checks.h"
#include "../evaluate/evaluate.h"
#include "../render/render.h"
#include "../survey/scene.h"
#include "../survey/survey.h"

enum {
    TRAINING_STEPS = 5,    /* steps per view, from which on its error is evidence */
    TRAINING_MIN = 6,      /* views; with fewer no view is flagged */
    TRAINING_SHOWN = 4,    /* worst views, and views of least structure, that are rendered */
    TRAINING_SHORT = 1000, /* iterations: below, a run renders fewer views, since it takes little time */
    TRAINING_FEW = 2       /* these many of the worst, unless more are flagged */
};
#define TRAINING_DECIBEL 2.5 /* Flags a view that lacks so many decibels. */
/* Warns of a flagged view if a shift explains more than this fraction of its error: others may show what is
 * hard to render, such as woods. */
#define TRAINING_SHIFTED 0.12
#define TRAINING_STRUCTURE 0.15 /* Looks for a shift where so much structure is lacking. */
/* Flags a view whose exposure is off by so many spreads: one of 10^5 views of a normal distribution. */
#define TRAINING_SPREADS 4.5
/* Lists what a view is flagged with, in the order of the log. */
enum training_flag {
    TRAINING_NONE,
    TRAINING_MISFIT,
    TRAINING_EXPOSURE,
    TRAINING_NO_STRUCTURE, /* is below OXL_STRUCTURE_NONE, and has no other flag */
    TRAINING_FLAGS
};

/* Member "flag" of metrics.json. */
static const char *const TRAINING_FLAG[TRAINING_FLAGS] = {NULL, "misfit", "exposure", "no structure"};

struct training_row {
    int at; /* index in the metrics */
    /* dB to the neighbours' median: of cc_psnr; of the gain by one factor per channel */
    double lacks, exposure;
    double structure, lacks_structure; /* to the neighbours' median */
    enum training_flag flag;
};

struct training_views {
    oxl_context *ctx;
    const oxl_scene *scene;
    const oxl_imaging *imaging;
    const oxl_metrics *m;
    int all;                  /* training views, of which m->count are judged */
    struct training_row *row; /* (m->count) the worst first, once sorted */
    double *work;             /* (3,m->count) scratch */
    int *view;                /* (m->count) views of the metrics */
};

/* ---------------- neighbours */

static int training_nearest(const struct training_views *t, int of, int out[QUALITY_NEIGHBOURS])
{
    return quality_nearest(t->scene, t->view, t->m->count, of, out);
}

/* ---------------- what a view lacks */

static void training_compare(struct training_views *t)
{
    enum { FIT, CORRECTED, STRUCTURE, VALUES };
    const int count = t->m->count;
    for (int i = 0; i < count; i++) {
        const oxl_view_metrics *v = &t->m->views[i];
        double *value = t->work + VALUES * i;
        value[FIT] = v->cc_psnr, value[CORRECTED] = v->cc_psnr - v->psnr, value[STRUCTURE] = v->structure;
    }
    for (int i = 0; i < count; i++) {
        int near[QUALITY_NEIGHBOURS];
        const int n = training_nearest(t, i, near);
        double lacks[VALUES];
        for (int k = 0; k < VALUES; k++)
            lacks[k] = quality_beside(t->work + k, VALUES, near, n) - t->work[VALUES * i + k];
        t->row[i] = (struct training_row){.at = i,
                                          .lacks = lacks[FIT],
                                          .exposure = -lacks[CORRECTED],
                                          .structure = t->m->views[i].structure,
                                          .lacks_structure = lacks[STRUCTURE]};
    }
}

/* Returns the limit in dB above which a view's exposure is an outlier. */
static double training_limit(struct training_views *t)
{
    const size_t count = (size_t)t->m->count;
    double middle, spread;
    for (size_t i = 0; i < count; i++) t->work[i] = t->row[i].exposure;
    spread = stats_spread(t->work, count, t->work + count, &middle);
    return OXL_MAX(TRAINING_DECIBEL, middle + TRAINING_SPREADS * spread);
}

/* ---------------- flags */

/* Ranks views with another flag first, then those without structure, then the rest. */
static int training_rank(const struct training_row *row)
{
    return row->flag == TRAINING_NONE ? 2 : row->flag == TRAINING_NO_STRUCTURE;
}

static int training_order(const void *a, const void *b)
{
    const struct training_row *x = a, *y = b;
    const double p = OXL_MAX(x->lacks, x->exposure), q = OXL_MAX(y->lacks, y->exposure);
    if (training_rank(x) != training_rank(y)) return training_rank(x) - training_rank(y);
    if (x->flag == TRAINING_NO_STRUCTURE && x->structure != y->structure)
        return x->structure < y->structure ? -1 : 1;
    if (p != q) return p > q ? -1 : 1;
    return x->at - y->at;
}

/* Flags single views if there are enough; those without structure in any case. */
static void training_flag(struct training_views *t)
{
    const double exposure = training_limit(t);
    for (int i = 0; i < t->m->count; i++) {
        struct training_row *row = &t->row[i];
        const int enough = t->m->count >= TRAINING_MIN;
        row->flag = enough && row->exposure > exposure        ? TRAINING_EXPOSURE
                    : enough && row->lacks > TRAINING_DECIBEL ? TRAINING_MISFIT
                    : row->structure < OXL_STRUCTURE_NONE     ? TRAINING_NO_STRUCTURE
                                                              : TRAINING_NONE;
    }
}

/* ---------------- messages */

/* Returns 1 if a view beside it lacks far more: a displaced view spoils the scene around it. */
static int training_suffers(const struct training_views *t, const struct training_row *row)
{
    int near[QUALITY_NEIGHBOURS];
    const int count = training_nearest(t, row->at, near);
    for (int i = 0; i < t->m->count; i++)
        for (int k = 0; k < count; k++)
            if (t->row[i].at == near[k] && t->row[i].lacks > row->lacks + TRAINING_DECIBEL) return 1;
    return 0;
}

static oxl_result training_shift(const struct training_views *t, const oxl_model *model, int view,
                                 struct misfit *misfit)
{
    oxl_image image = {0}, rendered = {0};
    oxl_result rc = scene_copy_image(t->ctx, t->scene, view, &image);
    if (rc == OXL_OK) rc = oxl_render_view(t->ctx, model, t->scene, view, t->imaging, &rendered, NULL);
    if (rc == OXL_OK) rc = misfit_measure(t->ctx, &rendered, &image, misfit);
    oxl_image_free(t->ctx, &image);
    oxl_image_free(t->ctx, &rendered);
    return rc;
}

/* Warns of a view whose exposure is another one, and of one whose render is displaced, which then counts as a
 * misfit. */
static oxl_result training_report_view(const struct training_views *t, const oxl_model *model,
                                       struct training_row *row)
{
    const int view = t->m->views[row->at].view;
    const char *name = oxl_scene_view(t->scene, view)->name;
    struct misfit misfit = {0};
    oxl_result rc = OXL_OK;
    if (row->flag == TRAINING_EXPOSURE)
        oxl_log(t->ctx, OXL_LOG_WARNING,
                "training image %s fits %.1f dB worse than its neighbours: check its exposure and white "
                "balance",
                name, OXL_MAX(row->lacks, row->exposure));
    if ((row->flag == TRAINING_MISFIT && !training_suffers(t, row)) ||
        (row->flag != TRAINING_EXPOSURE && row->lacks_structure > TRAINING_STRUCTURE))
        rc = training_shift(t, model, view, &misfit);
    if (rc != OXL_OK || misfit.explained <= TRAINING_SHIFTED) return rc;
    row->flag = TRAINING_MISFIT;
    oxl_log(t->ctx, OXL_LOG_WARNING,
            "training image %s is rendered displaced by %.1f to %.1f px, which explains %.0f %% of the error "
            "of its detail: check its pose, or refine poses (--poses auto)",
            name, misfit.least, misfit.most, 100 * misfit.explained);
    return OXL_OK;
}

static oxl_result training_report(const struct training_views *t, const oxl_model *model)
{
    oxl_result rc = OXL_OK;
    for (int i = 0; i < t->m->count && rc == OXL_OK; i++) rc = training_report_view(t, model, &t->row[i]);
    return rc;
}

/* Warns once of all views without structure. */
static void training_report_structure(const struct training_views *t)
{
    const struct training_row *least = NULL;
    int fog = 0;
    for (int i = 0; i < t->m->count; i++) {
        const struct training_row *row = &t->row[i];
        if (row->flag != TRAINING_NO_STRUCTURE) continue;
        if (!least || row->structure < least->structure) least = row;
        fog++;
    }
    if (least)
        oxl_log(t->ctx, OXL_LOG_WARNING,
                "%d of %d training views that were rendered lack the structure of their images (correlation "
                "of detail below %.1f; the least is %.2f, %s): train longer, or look at their renders",
                fog, t->m->count, OXL_STRUCTURE_NONE, least->structure,
                oxl_scene_view(t->scene, t->m->views[least->at].view)->name);
}

static int training_flagged(const struct training_views *t)
{
    int flagged = 0;
    for (int i = 0; i < t->m->count; i++) flagged += t->row[i].flag != TRAINING_NONE;
    return flagged;
}

static void training_add_json(const struct training_views *t, int shown, struct text *out)
{
    text_add(
        out,
        "  \"training\": {\"count\": %d, \"of\": %d, \"flagged\": %d, \"shown\": %d, \"structure\": %s, ",
        t->m->count, t->all, training_flagged(t), shown, NUMBER(t->m->structure));
    text_add(out, "\"psnr\": %s, \"cc_psnr\": %s, ", NUMBER(t->m->psnr), NUMBER(t->m->cc_psnr));
    text_add(out, "\"structure_least\": %s, \"no_structure\": %d, \"views\": [",
             NUMBER(t->m->structure_least), t->m->no_structure);
    for (int i = 0; i < t->m->count; i++) {
        const struct training_row *row = &t->row[i];
        const oxl_view_metrics *v = &t->m->views[row->at];
        const char *const names[] = {"psnr", "cc_psnr", "structure", "explained", "lacks", "lacks_exposure"};
        const double values[] = {v->psnr, v->cc_psnr, v->structure, v->explained, row->lacks, row->exposure};
        text_add(out, "%s\n    {\"name\": ", i ? "," : "");
        text_add_json_string(out, oxl_scene_view(t->scene, v->view)->name);
        for (size_t k = 0; k < OXL_COUNT(names); k++)
            text_add(out, ", \"%s\": %s", names[k], NUMBER(values[k]));
        text_add(out, row->flag ? ", \"flag\": \"%s\"}" : "}", TRAINING_FLAG[row->flag]);
    }
    text_add(out, "%s]},\n", t->m->count ? "\n  " : "");
}

/* Adds to `shown` the TRAINING_SHOWN rows of least structure below the limit, among
 * the rows from `count` on. */
static int training_add_fog(const struct training_views *t, int count, int *shown)
{
    double above = -HUGE_VAL;
    for (int first = count; count < first + TRAINING_SHOWN;) {
        const oxl_view_metrics *least = NULL;
        for (int i = first; i < t->m->count; i++) {
            const oxl_view_metrics *v = &t->m->views[t->row[i].at];
            if (v->structure < OXL_STRUCTURE_NONE && v->structure > above &&
                (!least || v->structure < least->structure))
                least = v;
        }
        if (!least) break;
        above = least->structure;
        shown[count++] = least->view;
    }
    return count;
}

/* Compares the views, orders them from the worst on, and logs what is found. */
static oxl_result training_judge(struct training_views *t, const oxl_model *model, int evident)
{
    oxl_result rc;
    for (int i = 0; i < t->m->count; i++) t->view[i] = t->m->views[i].view;
    training_compare(t);
    if (evident) training_flag(t);
    qsort(t->row, (size_t)t->m->count, sizeof *t->row, training_order);
    rc = evident && t->m->count >= TRAINING_MIN ? training_report(t, model) : OXL_OK;
    qsort(t->row, (size_t)t->m->count, sizeof *t->row, training_order);
    if (rc == OXL_OK && evident) training_report_structure(t);
    return rc;
}

OXL_INTERNAL oxl_result training_views_check(oxl_context *ctx, const oxl_model *model, const oxl_scene *scene,
                                             const oxl_imaging *imaging, int iterations,
                                             const oxl_metrics *measured, struct text *json,
                                             const char *folder)
{
    const oxl_render_output what = {.split = OXL_SPLIT_ALL, .images = 1, .replace = 1};
    oxl_metrics m = {0};
    struct training_views t = {
        .ctx = ctx, .scene = scene, .imaging = imaging, .m = &m, .all = schedule_training_views(scene)};
    const int judged = measured ? t.all : cost_judged_views(scene, iterations),
              evident = iterations >= TRAINING_STEPS * t.all;
    int shown[2 * TRAINING_SHOWN], count = 0, worst = TRAINING_SHOWN;
    oxl_result rc = OXL_OK;
    if (!measured) rc = evaluate_quick(ctx, model, scene, imaging, OXL_SPLIT_TRAIN, judged, &m);
    if (rc != OXL_OK) return rc;
    if (measured) m = *measured;
    if (judged < t.all)
        oxl_log(ctx, OXL_LOG_DEBUG,
                "%d of %d training views are evaluated, evenly spaced: one per %d iterations", m.count, t.all,
                OXL_MAX(1, iterations / judged));
    t.row = oxl_calloc(ctx, (size_t)m.count + 1, sizeof *t.row);
    t.work = oxl_alloc(ctx, 3 * (size_t)m.count + 1, sizeof *t.work);
    t.view = oxl_alloc(ctx, (size_t)m.count + 1, sizeof *t.view);
    rc = t.row && t.work && t.view ? training_judge(&t, model, evident) : OXL_ERR_MEMORY;
    if (rc == OXL_OK) {
        if (iterations < TRAINING_SHORT)
            worst = OXL_CLAMP(training_flagged(&t), (int)TRAINING_FEW, (int)TRAINING_SHOWN);
        worst = OXL_MIN(worst, m.count);
        training_add_json(&t, worst, json);
        for (; count < worst; count++) shown[count] = m.views[t.row[count].at].view;
        count = training_add_fog(&t, count, shown);
    }
    if (rc == OXL_OK && folder)
        rc = render_files_of(ctx, &(struct render_files){model, scene, imaging, &what, folder, shown, count},
                             &count);
    OXL_FREE(ctx, t.row, t.work, t.view);
    if (!measured) oxl_metrics_free(ctx, &m);
    return rc;
}
