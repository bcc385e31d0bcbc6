/* training_views.c - tells how well each training view fits, which views fit far worse than their neighbours
 * (a wrong pose, another exposure, or blur), and which renders lack the structure of their images.
 *
 * A view is compared with the 8 nearest of similar direction. The gain of one factor for each channel beyond
 * their median is set against its spread over all views (median absolute deviation, 1.4826 of it is a
 * standard deviation [Rousseeuw & Croux 1993]). A view that lacks decibels has a wrong pose when a shift of
 * the image explains them, and is blurred when it is less sharp.
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
    TRAINING_MIN = 6 /* views; with fewer no view is flagged */,
    TRAINING_SHOWN = 4,     /* worst views, and views of least structure, that are rendered */
    TRAINING_SMALLEST = 24, /* px; longer side of the smallest image in which a shift is sought */
    TRAINING_LARGEST = 200  /* px; longer side of the largest one */
};
#define TRAINING_DECIBEL 2.5 /* Flags a view that lacks so many decibels. */
/* Flags a view whose exposure is off by so many spreads: one of 10^5 views of a normal distribution. */
#define TRAINING_SPREADS 4.5
/* Counts a pose as wrong if a shift explains this fraction of the error: it explains 0.09 to 0.52 in
 * displaced views, at most 0.05 in a sound survey. */
#define TRAINING_SHIFTED 0.07
#define TRAINING_NO_STRUCTURE "no structure" /* Flags views below OXL_STRUCTURE_NONE. */

struct training_row {
    int at; /* index in the metrics */
    /* dB to the neighbours' median: of cc_psnr; of the gain by one factor per channel */
    double lacks, exposure;
    double structure;
    const char *flag; /* NULL: the view has no flag */
};

struct training_views {
    oxl_context *ctx;
    oxl_scene *scene;
    const oxl_metrics *m;
    int all;                  /* training views, of which m->count are judged */
    struct training_row *row; /* (m->count) the worst first, once sorted */
    double *work;             /* (2,m->count) scratch */
    int *view;                /* (m->count) views of the metrics */
};

/* ---------------- neighbours */

static int training_nearest(const struct training_views *t, int of, int out[QUALITY_NEIGHBOURS])
{
    return quality_nearest(t->scene, t->view, t->m->count, of, out);
}

/* ---------------- what a view lacks */

static double training_corrected(const oxl_view_metrics *v)
{
    return v->cc_psnr - v->psnr;
}

static void training_compare(struct training_views *t)
{
    for (int i = 0; i < t->m->count; i++) {
        int near[QUALITY_NEIGHBOURS];
        double fit[QUALITY_NEIGHBOURS], corrected[QUALITY_NEIGHBOURS];
        const int count = training_nearest(t, i, near);
        for (int k = 0; k < count; k++) {
            fit[k] = t->m->views[near[k]].cc_psnr;
            corrected[k] = training_corrected(&t->m->views[near[k]]);
        }
        t->row[i] = (struct training_row){.at = i, .structure = t->m->views[i].structure};
        t->row[i].lacks = stats_select(fit, (size_t)count, 0.5) - t->m->views[i].cc_psnr;
        t->row[i].exposure =
            training_corrected(&t->m->views[i]) - stats_select(corrected, (size_t)count, 0.5);
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

/* ---------------- pose */

/* Averages the green channel over n x n pixels. */
static void training_reduce(const oxl_image *image, int n, float *out)
{
    const int w = image->width / n, h = image->height / n;
    for (int y = 0; y < h; y++)
        for (int x = 0; x < w; x++) {
            float sum = 0;
            for (int k = 0; k < n * n; k++)
                sum += image->rgb[((size_t)image->height + (size_t)(y * n + k / n)) * (size_t)image->width +
                                  (size_t)(x * n + k % n)];
            out[y * w + x] = sum / (float)(n * n);
        }
}

/* Returns the fraction of the squared difference of two images that one shift of the whole image
 * explains [Lucas & Kanade 1981]. */
static double training_shift(const float *rendered, const float *image, int w, int h)
{
    double xx = 0, xy = 0, yy = 0, xe = 0, ye = 0, ee = 0, det;
    for (int y = 1; y + 1 < h; y++)
        for (int x = 1; x + 1 < w; x++) {
            const float *d = rendered + y * w + x;
            const double gx = 0.5 * (d[1] - d[-1]), gy = 0.5 * (d[w] - d[-w]), e = image[y * w + x] - d[0];
            xx += gx * gx, xy += gx * gy, yy += gy * gy, xe += gx * e, ye += gy * e, ee += e * e;
        }
    det = xx * yy - xy * xy;
    return det > 0 && ee > 0 ? (yy * xe * xe - 2 * xy * xe * ye + xx * ye * ye) / (det * ee) : 0;
}

/* Finds the largest fraction over halved images, since a shift of many pixels is one of few in a small image.
 * A displaced camera draws the scene beside its place; no shift helps a view that is only hard to fit. */
static oxl_result training_displaced(struct training_views *t, const struct render_source *source, int at,
                                     double *out)
{
    oxl_image image = {0}, rendered = {0};
    struct renderer *r = NULL;
    const int view = t->m->views[at].view;
    float *work = NULL;
    oxl_result rc = oxl_scene_image(t->ctx, t->scene, view, &image);
    *out = 0;
    if (rc == OXL_OK) rc = renderer_create(t->ctx, &r);
    if (rc == OXL_OK)
        rc = evaluate_draw(t->ctx, &(struct drawn){r, source, t->scene, &t->scene->imaging}, view, &rendered,
                           NULL);
    if (rc == OXL_OK) work = oxl_alloc(t->ctx, 2 * (size_t)image.width * (size_t)image.height, sizeof *work);
    if (rc == OXL_OK && !work) rc = OXL_ERR_MEMORY;
    for (int n = 1; rc == OXL_OK && OXL_MAX(image.width, image.height) / n >= TRAINING_SMALLEST; n *= 2) {
        const int w = image.width / n, h = image.height / n;
        if (OXL_MAX(w, h) > TRAINING_LARGEST) continue;
        training_reduce(&image, n, work);
        training_reduce(&rendered, n, work + (size_t)w * (size_t)h);
        *out = OXL_MAX(*out, training_shift(work + (size_t)w * (size_t)h, work, w, h));
    }
    oxl_free(t->ctx, work);
    renderer_free(t->ctx, r);
    oxl_image_free(t->ctx, &image);
    oxl_image_free(t->ctx, &rendered);
    return rc;
}

/* ---------------- blur */

static oxl_result training_sharpness(struct training_views *t, int at, double *out)
{
    const struct training_image *image = scene_image(t->ctx, t->scene, t->view[at]);
    *out = image ? quality_sharpness(image, NULL) : 0;
    return image ? OXL_OK : t->ctx->failed;
}

static oxl_result training_is_blurred(struct training_views *t, int at, int *blurred)
{
    int near[QUALITY_NEIGHBOURS];
    double sharp[QUALITY_NEIGHBOURS], own = 0;
    const int count = training_nearest(t, at, near);
    oxl_result rc = training_sharpness(t, at, &own);
    for (int k = 0; k < count && rc == OXL_OK; k++) rc = training_sharpness(t, near[k], &sharp[k]);
    *blurred = rc == OXL_OK && own < QUALITY_BLUR * stats_select(sharp, (size_t)count, 0.5);
    return rc;
}

/* ---------------- flags */

/* Returns 1 if the view is flagged as without structure. */
static int training_is_fog(const struct training_row *row)
{
    return row->flag && !strcmp(row->flag, TRAINING_NO_STRUCTURE);
}

/* Ranks views with another flag first, then those without structure, then the rest. */
static int training_rank(const struct training_row *row)
{
    return !row->flag ? 2 : training_is_fog(row);
}

static int training_order(const void *a, const void *b)
{
    const struct training_row *x = a, *y = b;
    const double p = OXL_MAX(x->lacks, x->exposure), q = OXL_MAX(y->lacks, y->exposure);
    if (training_rank(x) != training_rank(y)) return training_rank(x) - training_rank(y);
    if (training_is_fog(x) && x->structure != y->structure) return x->structure < y->structure ? -1 : 1;
    if (p != q) return p > q ? -1 : 1;
    return x->at - y->at;
}

/* Returns 1 if a neighbour with a wrong pose is so much worse that it may cause this view's error. */
static int training_suffers(const struct training_views *t, const struct training_row *row,
                            const struct training_row *end)
{
    int near[QUALITY_NEIGHBOURS];
    const int count = training_nearest(t, row->at, near);
    for (const struct training_row *other = t->row; other < end; other++)
        for (int k = 0; k < count; k++)
            if (other->at == near[k] && other->flag && !strcmp(other->flag, "pose") &&
                other->lacks > row->lacks + TRAINING_DECIBEL)
                return 1;
    return 0;
}

/* Flags the rows in their order, the worst first, so that a displaced view is known before its neighbours. */
static oxl_result training_flag(struct training_views *t, const struct render_source *source)
{
    const double exposure = training_limit(t);
    oxl_result rc = OXL_OK;
    for (int i = 0; i < t->m->count && t->m->count >= TRAINING_MIN && rc == OXL_OK; i++) {
        struct training_row *row = &t->row[i];
        double shifted = 0;
        int blurred = 0;
        if (row->exposure > exposure) row->flag = "exposure";
        if (row->flag || row->lacks <= TRAINING_DECIBEL) continue;
        rc = context_stopped(t->ctx);
        if (rc == OXL_OK) rc = training_displaced(t, source, row->at, &shifted);
        if (rc == OXL_OK && shifted > TRAINING_SHIFTED)
            row->flag = training_suffers(t, row, row) ? NULL : "pose";
        else if (rc == OXL_OK) rc = training_is_blurred(t, row->at, &blurred);
        if (blurred) row->flag = "blur";
    }
    return rc;
}

/* Flags views without structure that have no other flag. */
static void training_flag_structure(struct training_views *t)
{
    for (int i = 0; i < t->m->count; i++)
        if (!t->row[i].flag && t->row[i].structure < OXL_STRUCTURE_NONE)
            t->row[i].flag = TRAINING_NO_STRUCTURE;
}

/* ---------------- messages */

static void training_report(const struct training_views *t)
{
    static const char *const kinds[] = {"pose", "exposure", "blur"};
    for (size_t k = 0; k < OXL_COUNT(kinds); k++)
        for (int i = 0; i < t->m->count; i++) {
            const struct training_row *row = &t->row[i];
            if (!row->flag || strcmp(row->flag, kinds[k])) continue;
            oxl_log(t->ctx, OXL_LOG_WARNING,
                    "training image %s fits %.1f dB worse than its neighbours: look at its %s",
                    oxl_scene_view(t->scene, t->m->views[row->at].view)->name,
                    OXL_MAX(row->lacks, row->exposure),
                    k == 0   ? "pose"
                    : k == 1 ? "exposure and white balance"
                             : "focus and motion blur");
        }
}

/* Warns once of all views without structure. */
static void training_report_structure(const struct training_views *t)
{
    const struct training_row *least = NULL;
    int fog = 0;
    for (int i = 0; i < t->m->count; i++) {
        const struct training_row *row = &t->row[i];
        if (!training_is_fog(row)) continue;
        if (!least || row->structure < least->structure) least = row;
        fog++;
    }
    if (least)
        oxl_log(
            t->ctx, OXL_LOG_WARNING,
            "%d of %d training views judged are rendered without the structure of their images (correlation of detail below "
            "%.1f; the least %.2f, %s): train longer, or look at their renders",
            fog, t->m->count, OXL_STRUCTURE_NONE, least->structure,
            oxl_scene_view(t->scene, t->m->views[least->at].view)->name);
}

static void training_add_json(const struct training_views *t, struct text *out)
{
    int flagged = 0;
    for (int i = 0; i < t->m->count; i++) flagged += t->row[i].flag != NULL;
    text_add(out, "  \"training\": {\"count\": %d, \"of\": %d, \"flagged\": %d, \"structure\": %s, ",
             t->m->count, t->all, flagged, NUMBER(t->m->structure));
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
        text_add(out, row->flag ? ", \"flag\": \"%s\"}" : "}", row->flag);
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

OXL_INTERNAL oxl_result training_views_check(oxl_context *ctx, const oxl_large_model *model, oxl_scene *scene,
                                             int iterations, struct text *json, const char *folder)
{
    const struct render_source source = large_source(model);
    const oxl_render_output what = {.split = OXL_SPLIT_ALL, .images = 1, .replace = 1};
    oxl_metrics m = {0};
    struct training_views t = {.ctx = ctx, .scene = scene, .m = &m, .all = schedule_training_views(scene)};
    const int judged = cost_judged_views(scene, iterations), evident = iterations >= TRAINING_STEPS * t.all;
    int shown[2 * TRAINING_SHOWN], count = 0;
    oxl_result rc = evaluate_quick(ctx, &source, scene, OXL_SPLIT_TRAIN, judged, &m);
    if (rc != OXL_OK) return rc;
    if (judged < t.all)
        oxl_log(ctx, OXL_LOG_INFO, "%d of %d training views are judged, evenly spaced, as the run is short",
                m.count, t.all);
    t.row = oxl_calloc(ctx, (size_t)m.count + 1, sizeof *t.row);
    t.work = oxl_alloc(ctx, 2 * (size_t)m.count + 1, sizeof *t.work);
    t.view = oxl_alloc(ctx, (size_t)m.count + 1, sizeof *t.view);
    if (!t.row || !t.work || !t.view) rc = OXL_ERR_MEMORY;
    if (rc != OXL_OK) goto done;
    for (int i = 0; i < m.count; i++) t.view[i] = m.views[i].view;
    training_compare(&t);
    qsort(t.row, (size_t)m.count, sizeof *t.row, training_order);
    if (evident) rc = training_flag(&t, &source);
    if (rc != OXL_OK) goto done;
    if (evident) training_flag_structure(&t);
    qsort(t.row, (size_t)m.count, sizeof *t.row, training_order);
    training_report(&t);
    if (evident) training_report_structure(&t);
    training_add_json(&t, json);
    for (; count < OXL_MIN(m.count, (int)TRAINING_SHOWN); count++)
        shown[count] = m.views[t.row[count].at].view;
    count = training_add_fog(&t, count, shown);
    if (folder)
        rc =
            render_files_of(ctx, &(struct render_files){&source, scene, &what, folder, shown, count}, &count);
done:
    OXL_FREE(ctx, t.row, t.work, t.view);
    oxl_metrics_free(ctx, &m);
    return rc;
}
