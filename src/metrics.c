/* metrics.c - PSNR, SSIM, evaluation.
 *
 * Source: SSIM of Wang et al. 2004 with the window of 3DGS (11 x 11 Gaussian of sigma 1.5, zero padding). It is written here
 * plainly and in double, apart from the training loss in loss.c, so that each can be held against the other.
 *
 * Invariant: sums go row by row in the order of the rows, so that the result does not depend on the number of threads.
 */
#include "internal.h"
#include "vecmath.h"

enum { METRICS_RADIUS = 5, METRICS_WINDOW = 2 * METRICS_RADIUS + 1 };
#define METRICS_SIGMA     1.5
#define METRICS_C1        (0.01 * 0.01) /* (k1 L)^2 with L = 1 [Wang 2004] */
#define METRICS_C2        (0.03 * 0.03)
#define METRICS_BEST_PSNR 100.0 /* dB, of identical images */

/* Values are clamped to what a screen shows; not-a-number is black, as in a written picture. */
OXL_INTERNAL double metrics_shown(float v)
{
    return v > 0 ? OXL_MIN((double)v, 1.0) : 0;
}

OXL_INTERNAL double metrics_decibel(double error, double weight)
{
    if (!(weight > 0)) return NAN;
    return error > 0 ? OXL_MIN(METRICS_BEST_PSNR, -10 / 2.302585092994045684 * vecmath_log(error / weight)) : METRICS_BEST_PSNR;
}

static oxl_result metrics_check(oxl_context *ctx, const oxl_image *a, const oxl_image *b)
{
    if (a->rgb && b->rgb && a->width == b->width && a->height == b->height && a->width > 0 && a->height > 0) return OXL_OK;
    return oxl_fail(ctx, OXL_ERR_USAGE,
                    "images of %d x %d and %d x %d px cannot be compared\nfix: render at the photograph's size", a->width,
                    a->height, b->width, b->height);
}

static oxl_result metrics_fail_masked(oxl_context *ctx, const char *what)
{
    return oxl_fail(ctx, OXL_ERR_INPUT, "%s\nfix: white (255) in a mask means that the pixel counts", what);
}

/* ---------------------------------------------------------------- PSNR */

static void metrics_square_row(const oxl_image *a, const oxl_image *b, int y, double *error, double *weight)
{
    const size_t plane = (size_t)a->width * a->height;
    *error = *weight = 0;
    for (int x = 0; x < a->width; x++) {
        const size_t i = (size_t)y * a->width + x;
        const double w = b->weight ? b->weight[i] : 1;
        for (int c = 0; c < 3; c++) {
            const double d = metrics_shown(a->rgb[c * plane + i]) - metrics_shown(b->rgb[c * plane + i]);
            *error += w * d * d;
        }
        *weight += 3 * w;
    }
}

oxl_result oxl_psnr(oxl_context *ctx, const oxl_image *a, const oxl_image *b, double *out)
{
    double     error = 0, weight = 0, row_error, row_weight;
    oxl_result rc = metrics_check(ctx, a, b);
    *out          = 0;
    if (rc != OXL_OK) return rc;
    for (int y = 0; y < a->height; y++) { /* serial: it takes a hundredth of the rendering */
        metrics_square_row(a, b, y, &row_error, &row_weight);
        error += row_error;
        weight += row_weight;
    }
    if (!(weight > 0)) return metrics_fail_masked(ctx, "every pixel is masked, so there is no PSNR");
    *out = metrics_decibel(error, weight);
    return OXL_OK;
}

/* ---------------------------------------------------------------- SSIM */

struct metrics_ssim {
    const oxl_image *a, *b;
    double           kernel[METRICS_WINDOW];
    double          *scratch; /* (threads,6,W): five blurred columns and a mark for columns that hold a masked pixel */
    double          *sum;     /* (H) */
    size_t          *windows; /* (H) */
};

static void metrics_kernel(double kernel[METRICS_WINDOW])
{
    double sum = 0;
    for (int i = 0; i < METRICS_WINDOW; i++) {
        const double d = i - METRICS_RADIUS;
        kernel[i]      = vecmath_exp(-d * d / (2 * METRICS_SIGMA * METRICS_SIGMA));
        sum += kernel[i];
    }
    for (int i = 0; i < METRICS_WINDOW; i++) kernel[i] /= sum;
}

/* The five moments of one channel, blurred along y around row y: of a, b, aa, bb, ab. Outside of the image is black. */
static void metrics_blur_columns(const struct metrics_ssim *s, int channel, int y, double *column[5])
{
    const int w = s->a->width, h = s->a->height, first = OXL_MAX(0, y - METRICS_RADIUS),
              last     = OXL_MIN(h - 1, y + METRICS_RADIUS);
    const size_t plane = (size_t)channel * w * h;
    for (int x = 0; x < w; x++) {
        double m[5] = {0, 0, 0, 0, 0};
        for (int j = first; j <= last; j++) {
            const size_t i = plane + (size_t)j * w + x;
            const double k = s->kernel[j - y + METRICS_RADIUS], a = metrics_shown(s->a->rgb[i]), b = metrics_shown(s->b->rgb[i]);
            m[0] += k * a;
            m[1] += k * b;
            m[2] += k * a * a;
            m[3] += k * b * b;
            m[4] += k * a * b;
        }
        for (int q = 0; q < 5; q++) column[q][x] = m[q];
    }
}

static void metrics_mark_columns(const struct metrics_ssim *s, int y, double *masked)
{
    const int w = s->a->width, first = OXL_MAX(0, y - METRICS_RADIUS), last = OXL_MIN(s->a->height - 1, y + METRICS_RADIUS);
    for (int x = 0; x < w; x++) {
        masked[x] = 0;
        for (int j = first; s->b->weight && j <= last; j++) masked[x] += s->b->weight[(size_t)j * w + x] <= 0.5f;
    }
}

static double metrics_similarity(const double m[5])
{
    const double mean_ab = m[0] * m[1], mean_aa = m[0] * m[0], mean_bb = m[1] * m[1];
    const double variance_a = m[2] - mean_aa, variance_b = m[3] - mean_bb, covariance = m[4] - mean_ab;
    return (2 * mean_ab + METRICS_C1) * (2 * covariance + METRICS_C2) /
           ((mean_aa + mean_bb + METRICS_C1) * (variance_a + variance_b + METRICS_C2));
}

/* Adds the windows centred in row y of one channel; those that touch a masked pixel are left out. */
static void metrics_ssim_row(struct metrics_ssim *s, int channel, int y, double *column[5], const double *masked)
{
    const int w = s->a->width;
    metrics_blur_columns(s, channel, y, column);
    for (int x = 0; x < w; x++) {
        double touches = 0, m[5] = {0, 0, 0, 0, 0};
        for (int j = OXL_MAX(0, x - METRICS_RADIUS); j <= OXL_MIN(w - 1, x + METRICS_RADIUS); j++) {
            for (int q = 0; q < 5; q++) m[q] += s->kernel[j - x + METRICS_RADIUS] * column[q][j];
            touches += masked[j];
        }
        if (touches > 0) continue;
        s->sum[y] += metrics_similarity(m);
        s->windows[y]++;
    }
}

static int metrics_thread(void)
{
#ifdef _OPENMP
    return omp_get_thread_num();
#else
    return 0;
#endif
}

static void metrics_ssim_rows(oxl_context *ctx, struct metrics_ssim *s)
{
    const size_t width = (size_t)s->a->width;
#pragma omp parallel for schedule(static) num_threads(ctx->threads)
    for (int y = 0; y < s->a->height; y++) {
        double *column[6];
        for (int q = 0; q < 6; q++) column[q] = s->scratch + (6 * (size_t)metrics_thread() + q) * width;
        metrics_mark_columns(s, y, column[5]);
        for (int c = 0; c < 3; c++) metrics_ssim_row(s, c, y, column, column[5]);
    }
    (void)ctx;
}

oxl_result oxl_ssim(oxl_context *ctx, const oxl_image *a, const oxl_image *b, double *out)
{
    struct metrics_ssim s       = {.a = a, .b = b};
    double              sum     = 0;
    size_t              windows = 0;
    oxl_result          rc      = metrics_check(ctx, a, b);
    *out                        = 0;
    if (rc != OXL_OK) return rc;
    s.scratch = oxl_alloc(ctx, (size_t)a->width * ctx->threads, 6 * sizeof *s.scratch);
    s.sum     = oxl_calloc(ctx, (size_t)a->height, sizeof *s.sum);
    s.windows = oxl_calloc(ctx, (size_t)a->height, sizeof *s.windows);
    if (!s.scratch || !s.sum || !s.windows) {
        rc = oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for the SSIM of %d x %d px", a->width, a->height);
        goto done;
    }
    metrics_kernel(s.kernel);
    metrics_ssim_rows(ctx, &s);
    for (int y = 0; y < a->height; y++) {
        sum += s.sum[y];
        windows += s.windows[y];
    }
    if (windows) *out = sum / (double)windows;
    else rc = metrics_fail_masked(ctx, "every window touches a masked pixel, so there is no SSIM");
done:
    oxl_free(ctx, s.scratch);
    oxl_free(ctx, s.sum);
    oxl_free(ctx, s.windows);
    return rc;
}

/* ---------------------------------------------------------------- evaluation */

static oxl_result metrics_of_view(oxl_context *ctx, const oxl_model *model, oxl_scene *scene, const oxl_image *photograph,
                                  oxl_view_metrics *row)
{
    oxl_render_options options = oxl_render_options_default();
    oxl_image          drawn   = {0};
    oxl_result         rc;
    options.near_plane = (float)scene_near_plane(scene);
    rc                 = oxl_render(ctx, model, &oxl_scene_view(scene, row->view)->camera, &options, &drawn, NULL);
    if (rc == OXL_OK) rc = oxl_psnr(ctx, &drawn, photograph, &row->psnr);
    if (rc == OXL_OK) rc = oxl_ssim(ctx, &drawn, photograph, &row->ssim);
    oxl_image_free(ctx, &drawn);
    return rc;
}

/* A photograph that cannot be read or is masked all over is said and left out, as in training. */
static oxl_result metrics_add_view(oxl_context *ctx, const oxl_model *model, oxl_scene *scene, int view, oxl_metrics *out)
{
    oxl_image        photograph = {0};
    oxl_view_metrics row        = {.view = view};
    oxl_result       rc         = oxl_scene_image(ctx, scene, view, &photograph);
    if (rc == OXL_OK) rc = metrics_of_view(ctx, model, scene, &photograph, &row);
    oxl_image_free(ctx, &photograph);
    if (rc == OXL_OK) out->views[out->count++] = row;
    if (rc != OXL_ERR_INPUT) return rc;
    oxl_log(ctx, OXL_LOG_WARNING, "%s: %s; the view is left out of the evaluation", oxl_scene_view(scene, view)->name,
            oxl_error_text(ctx));
    return OXL_OK;
}

oxl_result oxl_evaluate(oxl_context *ctx, const oxl_model *model, oxl_scene *scene, oxl_split split, oxl_metrics *out)
{
    const int  count = oxl_scene_view_count(scene);
    oxl_result rc    = OXL_OK;
    *out             = (oxl_metrics){.views = oxl_alloc(ctx, (size_t)count + 1, sizeof *out->views)};
    if (!out->views) return oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for the metrics of %d views", count);
    for (int i = 0; i < count && rc == OXL_OK; i++) {
        const int is_test = oxl_scene_view(scene, i)->is_test != 0;
        if (split == OXL_SPLIT_ALL || is_test == (split == OXL_SPLIT_TEST)) rc = metrics_add_view(ctx, model, scene, i, out);
    }
    for (int i = 0; i < out->count; i++) {
        out->psnr += out->views[i].psnr / out->count;
        out->ssim += out->views[i].ssim / out->count;
    }
    if (rc != OXL_OK) oxl_metrics_free(ctx, out);
    return rc;
}

void oxl_metrics_free(oxl_context *ctx, oxl_metrics *metrics)
{
    if (!metrics) return;
    oxl_free(ctx, metrics->views);
    *metrics = (oxl_metrics){0};
}

OXL_INTERNAL oxl_result metrics_write_json(oxl_context *ctx, struct text *t, const oxl_scene *scene, const oxl_metrics *m)
{
    text_add(t, "  \"psnr\": ");
    text_add_number(t, m->psnr);
    text_add(t, ",\n  \"ssim\": ");
    text_add_number(t, m->ssim);
    text_add(t, ",\n  \"count\": %d,\n  \"views\": [", m->count);
    for (int i = 0; i < m->count; i++) {
        text_add(t, "%s\n    {\"name\": ", i ? "," : "");
        text_add_json_string(t, oxl_scene_view(scene, m->views[i].view)->name);
        text_add(t, ", \"psnr\": ");
        text_add_number(t, m->views[i].psnr);
        text_add(t, ", \"ssim\": ");
        text_add_number(t, m->views[i].ssim);
        text_add(t, "}");
    }
    text_add(t, "%s]\n", m->count ? "\n  " : "");
    return t->failed ? oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for the metrics of %d views", m->count) : OXL_OK;
}
