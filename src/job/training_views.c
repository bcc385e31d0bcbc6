/* training_views.c - tells how well each training view fits, which views fit far worse than their neighbours
 * (a wrong pose, another exposure, blur, reflections), and which renders lack the structure of their images.
 *
 * A view is compared with the 8 nearest of similar direction. The gain of one factor for each channel beyond
 * their median is set against its spread over all views (median absolute deviation, 1.4826 of it is a
 * standard deviation [Rousseeuw & Croux 1993]).
 *
 * A short run judges some views, evenly spaced, and finds their neighbours among these.
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
    TRAINING_STEPS = 5, /* steps per view, from which on its error is evidence */
    TRAINING_MIN = 6,   /* views; with fewer no view is flagged */
    TRAINING_SHOWN = 4  /* worst views, which are rendered */
};
#define TRAINING_DECIBEL 2.5    /* Flags a view that lacks so many decibels. */
#define TRAINING_STRUCTURE 0.15 /* Looks for a shift where so much structure is lacking. */
#define TRAINING_PART 0.1       /* Names the part that holds a view's error if it is smaller. */
/* Flags a view whose exposure is off by so many spreads: one of 10^5 views of a normal distribution. */
#define TRAINING_SPREADS 4.5

/* Lists what a view is flagged with. */
enum training_flag { TRAINING_NONE, TRAINING_MISFIT, TRAINING_EXPOSURE, TRAINING_NO_STRUCTURE };
static const char *const TRAINING_FLAG[] = {NULL, "misfit", "exposure", "no structure"};

/* Lists what is compared with the neighbours: cc_psnr; the loss by one factor per channel; structure. */
enum { TRAINING_FIT, TRAINING_LIGHT, TRAINING_DETAIL, TRAINING_VALUES };

struct training_row {
    double lacks[TRAINING_VALUES]; /* to the neighbours' median, dB and dB */
    double badness;                /* order of the rows, the worst first */
    const oxl_view_metrics *of;
    enum training_flag flag;
};

struct training_views {
    oxl_context *ctx;
    const oxl_scene *scene;
    const oxl_imaging *imaging;
    const oxl_model *model;
    const oxl_metrics *m;
    struct training_row *row; /* (m->count) */
    double *work;             /* (TRAINING_VALUES,m->count) scratch */
    int *view;                /* (m->count) views of the metrics */
};

/* ---------------- what a view lacks */

static void training_compare(struct training_views *t)
{
    int near[QUALITY_NEIGHBOURS];
    for (int i = 0; i < t->m->count; i++) {
        const oxl_view_metrics *v = &t->m->views[i];
        double *value = t->work + TRAINING_VALUES * i;
        t->row[i].of = v;
        t->view[i] = v->view;
        value[TRAINING_FIT] = v->cc_psnr;
        value[TRAINING_LIGHT] = v->psnr - v->cc_psnr;
        value[TRAINING_DETAIL] = v->structure;
    }
    for (int i = 0; i < t->m->count; i++) {
        const int n = quality_nearest(t->scene, t->view, t->m->count, i, near);
        for (int k = 0; k < TRAINING_VALUES; k++)
            t->row[i].lacks[k] =
                quality_beside(t->work + k, TRAINING_VALUES, near, n) - t->work[TRAINING_VALUES * i + k];
    }
}

/* Returns the limit in dB above which a view's exposure is an outlier. */
static double training_limit(struct training_views *t)
{
    const size_t count = (size_t)t->m->count;
    double middle, spread;
    for (size_t i = 0; i < count; i++) t->work[i] = t->row[i].lacks[TRAINING_LIGHT];
    spread = quality_spread(t->work, count, t->work + count, &middle);
    return OXL_MAX(TRAINING_DECIBEL, middle + TRAINING_SPREADS * spread);
}

/* Returns 1 if a view beside it lacks far more: a displaced view spoils the scene around it. */
static int training_suffers(const struct training_views *t, int i)
{
    int near[QUALITY_NEIGHBOURS], suffers = 0;
    for (int n = quality_nearest(t->scene, t->view, t->m->count, i, near); n-- > 0;)
        suffers |= t->row[near[n]].lacks[TRAINING_FIT] > t->row[i].lacks[TRAINING_FIT] + TRAINING_DECIBEL;
    return suffers;
}

/* ---------------- flags */

/* Returns the part of the image whose squared error exceeds the mean: a third for noise, less for a thing
 * that the model lacks. */
static double training_part(const oxl_image *rendered, const oxl_image *image)
{
    const int n = 3 * image->width * image->height;
    double sum = 0, part = 0;
    for (int i = 0; i < 2 * n; i++) {
        const double e = rendered->rgb[i % n] - image->rgb[i % n];
        if (i >= n) part += e * e * n > sum;
        else if (!isnan(e)) sum += e * e;
    }
    return part / n;
}

/* Warns of a view whose render is displaced, which then counts as a misfit. */
static oxl_result training_find_shift(const struct training_views *t, struct training_row *row)
{
    oxl_image image = {0}, rendered = {0};
    struct misfit misfit = {0};
    const int view = row->of->view;
    const char *name = t->scene->view[view].name;
    oxl_result rc = scene_copy_image(t->ctx, t->scene, view, &image);
    if (rc == OXL_OK) rc = oxl_render_view(t->ctx, t->model, t->scene, view, t->imaging, &rendered, NULL);
    if (rc == OXL_OK) rc = misfit_measure(t->ctx, &rendered, &image, &misfit);
    if (misfit.explained > MISFIT_EVIDENT) {
        row->flag = TRAINING_MISFIT;
        oxl_log(t->ctx, OXL_LOG_WARNING,
                "training image %s is rendered displaced by %.1f to %.1f px, which explains %.0f %% of the "
                "error of its detail: check its pose, or refine poses (--poses auto)",
                name, misfit.least, misfit.most, 100 * misfit.explained);
    } else if (rc == OXL_OK && row->lacks[TRAINING_FIT] > 3 * TRAINING_DECIBEL &&
               training_part(&rendered, &image) < TRAINING_PART)
        oxl_log(t->ctx, OXL_LOG_WARNING,
                "training image %s differs from the others in a small part: mask what moves there (--masks)",
                name);
    oxl_image_free(t->ctx, &image);
    oxl_image_free(t->ctx, &rendered);
    return rc;
}

/* Flags a view, and says what is wrong with it. enough: there are views to compare it with; limit: of
 * training_limit. */
static oxl_result training_flag(const struct training_views *t, int i, int enough, double limit)
{
    struct training_row *row = &t->row[i];
    const double *lacks = row->lacks;
    const int is_light = enough && lacks[TRAINING_LIGHT] > limit,
              is_misfit = enough && lacks[TRAINING_FIT] > TRAINING_DECIBEL;
    oxl_result rc = OXL_OK;
    row->flag = is_light                                  ? TRAINING_EXPOSURE
                : is_misfit                               ? TRAINING_MISFIT
                : row->of->structure < OXL_STRUCTURE_NONE ? TRAINING_NO_STRUCTURE
                                                          : TRAINING_NONE;
    if (is_light)
        oxl_log(
            t->ctx, OXL_LOG_WARNING,
            "training image %s fits %.1f dB worse than its neighbours: check its exposure, white balance and pose",
            t->scene->view[row->of->view].name, row->badness);
    else if (enough &&
             ((is_misfit && !training_suffers(t, i)) || lacks[TRAINING_DETAIL] > TRAINING_STRUCTURE))
        rc = training_find_shift(t, row);
    return rc;
}

/* Compares views by their flags: those with one come first, the ones without structure last of them. */
static int training_order(const void *a, const void *b)
{
    const struct training_row *x = a, *y = b;
    if (x->badness != y->badness) return x->badness > y->badness ? -1 : 1;
    return x->of < y->of ? -1 : 1;
}

/* Judges all views: flags them if the run was long enough, and sorts them from the worst on. Returns the
 * number of flagged ones in *flagged. */
static oxl_result training_judge(struct training_views *t, int evident, int *flagged)
{
    const int count = t->m->count, enough = count >= TRAINING_MIN;
    const oxl_view_metrics *least = NULL;
    double limit;
    int fog = 0;
    oxl_result rc = OXL_OK;
    training_compare(t);
    limit = training_limit(t);
    for (int i = 0; i < count && rc == OXL_OK; i++) {
        struct training_row *row = &t->row[i];
        row->badness = OXL_MAX(row->lacks[TRAINING_FIT], row->lacks[TRAINING_LIGHT]);
        if (evident) rc = training_flag(t, i, enough, limit);
        if (row->flag != TRAINING_NONE) row->badness += 2e3, ++*flagged; /* more than any decibels */
        if (row->flag != TRAINING_NO_STRUCTURE) continue;
        row->badness = 1e3 - row->of->structure;
        if (fog++ == 0 || row->of->structure < least->structure) least = row->of;
    }
    if (fog)
        oxl_log(
            t->ctx, OXL_LOG_WARNING,
            "%d of %d training views that were rendered lack the structure of their images "
            "(correlation of detail below %.1f; the least is %.2f, %s): train longer, or look at their renders",
            fog, count, OXL_STRUCTURE_NONE, least->structure, t->scene->view[least->view].name);
    qsort(t->row, (size_t)count, sizeof *t->row, training_order);
    return rc;
}

/* ---------------- the whole check */

static void training_add_json(const struct training_views *t, int flagged, struct text *out)
{
    const oxl_metrics *m = t->m;
    text_add(out,
             "  \"training\": {\"count\": %d, \"of\": %d, \"flagged\": %d, \"shown\": %d, \"psnr\": %s, "
             "\"structure\": %s, \"views\": [",
             m->count, schedule_training_views(t->scene), flagged, OXL_MIN(m->count, TRAINING_SHOWN),
             NUMBER(m->psnr), NUMBER(m->structure));
    for (int i = 0; i < m->count; i++) {
        const struct training_row *row = &t->row[i];
        text_add(out, "%s\n    {\"name\": ", i ? "," : "");
        text_add_json_string(out, t->scene->view[row->of->view].name);
        text_add(out, ", \"psnr\": %s, \"structure\": %s", NUMBER(row->of->psnr), NUMBER(row->of->structure));
        text_add(out, row->flag ? ", \"flag\": \"%s\"}" : "}", TRAINING_FLAG[row->flag]);
    }
    text_add(out, "%s]},\n", m->count ? "\n  " : "");
}

OXL_INTERNAL oxl_result training_views_check(oxl_context *ctx, const oxl_model *model, const oxl_scene *scene,
                                             const oxl_imaging *imaging, int iterations,
                                             const oxl_metrics *measured, struct text *json,
                                             const char *folder)
{
    const oxl_render_output what = {.split = OXL_SPLIT_ALL, .images = 1, .replace = 1};
    const int all = schedule_training_views(scene), judged = cost_judged_views(scene, iterations);
    oxl_metrics m = {0};
    struct training_views t = {
        .ctx = ctx, .scene = scene, .imaging = imaging, .model = model, .m = measured ? measured : &m};
    int flagged = 0, count;
    size_t room;
    oxl_result rc = OXL_OK;
    if (!measured)
        rc = evaluate_part(ctx, &(struct drawn){NULL, model, scene, imaging}, OXL_SPLIT_TRAIN, judged, &m);
    if (rc != OXL_OK) return rc;
    room = (size_t)t.m->count + 1;
    t.row = oxl_calloc(ctx, room, sizeof *t.row);
    t.work = oxl_alloc(ctx, room, TRAINING_VALUES * sizeof *t.work);
    t.view = oxl_alloc(ctx, room, sizeof *t.view);
    rc = t.row && t.work && t.view ? training_judge(&t, iterations >= TRAINING_STEPS * all, &flagged)
                                   : OXL_ERR_MEMORY;
    if (rc == OXL_OK) training_add_json(&t, flagged, json);
    for (int i = 0; rc == OXL_OK && i < t.m->count; i++) t.view[i] = t.row[i].of->view;
    if (rc == OXL_OK && folder)
        rc = render_files_of(ctx,
                             &(struct render_files){model, scene, imaging, &what, folder, t.view,
                                                    OXL_MIN(t.m->count, TRAINING_SHOWN)},
                             &count);
    OXL_FREE(ctx, t.row, t.work, t.view);
    oxl_metrics_free(ctx, &m);
    return rc;
}
