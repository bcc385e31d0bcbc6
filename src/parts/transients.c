/* transients.c - masks transients (fish, divers): squares of pixels with a large error in one image where
 * other images of the same place have a small one.
 *
 * From RobustNeRF (Sabour et al. 2023, arXiv 2302.00833, trimmed least squares): the residual, the vote of
 * the neighbourhood, and weights of 0 or 1 computed in each step. Its threshold, the median of a batch's
 * residuals, is not used: it masks half of all pixels at first, and always what is hard to model (thin
 * corals, the survey's border), which is then never learned. A fish and a coral that is not learned yet have
 * the same residual in one image; they differ in the others. So each sparse point keeps its `expected` error,
 * the running mean over the views that see it: small behind a fish, since other views explain the ground;
 * large at the coral until it is learned; TRANSIENTS_MAX at first, so that little is masked before errors
 * have been observed.
 *
 * In a step, e being the error of a square of pixels: the channels' mean of |mean of rendered - image|
 * (signed: texture that is not learned yet averages out, a fish does not), and m the largest expected error
 * of the points around it,
 *     outlier  e > TRANSIENTS_ERROR, and of TRANSIENTS_VOTES at least of the 3 x 3 squares around
 *     core     outlier, and e > TRANSIENTS_TIMES m
 *     masked   core; or next to one, with e > TRANSIENTS_ERROR / 2 and 2 e > TRANSIENTS_TIMES m
 *     expected <- expected + TRANSIENTS_RATE (min(e, TRANSIENTS_MAX) - expected), for each point in view
 * Squares without points around are never masked. docs/log/ROBUST.md has gains, cost and rejected
 * alternatives.
 *
 * Invariant: weights and expected errors are a function of the model, the view and the previous expected
 * errors; no sum depends on the number of threads.
 */
#include "transients.h"
#include "../core/option_rows.h"
#include "../survey/sparse.h"

#define TRANSIENTS_ERROR 0.05f    /* of white: a visible difference */
#define TRANSIENTS_TIMES 4.0f     /* x the expected error around */
#define TRANSIENTS_RATE 0.1f      /* about the last ten views */
#define TRANSIENTS_SMOOTHING 0.02 /* of the logged fraction: about the last 50 views */
enum {
    /* of the 3 x 3 squares, with the one in the middle: noise has fewer, thin objects have them */
    TRANSIENTS_VOTES = 3,
    TRANSIENTS_ACROSS = 100, /* maximum of squares along the longer side of an image */
    TRANSIENTS_SIDE = 4,     /* px: minimum of a square */
    TRANSIENTS_NEAR = 2      /* squares: radius in which points count for a square */
};
enum { TRANSIENTS_ABOVE = 1, TRANSIENTS_OUTLIER = 2, TRANSIENTS_CORE = 4, TRANSIENTS_MASKED = 8 };

OXL_INTERNAL oxl_result transients_begin(oxl_context *ctx, struct transients *t, const oxl_scene *scene,
                                         int on)
{
    *t = (struct transients){.points = on ? oxl_scene_point_count(scene) : 0};
    if (on && t->points == 0)
        oxl_log(ctx, OXL_LOG_WARNING, "the scene has no points: transients are not masked");
    if (t->points == 0) return OXL_OK;
    t->expected = oxl_alloc(ctx, t->points, sizeof *t->expected);
    t->place = oxl_alloc(ctx, t->points, sizeof *t->place);
    if (!t->expected || !t->place) return OXL_ERR_MEMORY;
    for (size_t i = 0; i < t->points; i++) t->expected[i] = TRANSIENTS_MAX;
    return OXL_OK;
}

OXL_INTERNAL void transients_free(struct train *t, void *state)
{
    struct transients *m = state;
    OXL_FREE(t->ctx, m->expected, m->place, m->square);
}

OXL_INTERNAL void transients_describe(const struct transients *t, char *out, size_t size)
{
    snprintf(out, size, "transients: %.1f %% of the pixels masked in recent images",
             100 * t->masked_fraction);
}

/* ---------------- squares of pixels */

struct transients_grid {
    int width, height; /* px */
    int side, across, down;
};

static struct transients_grid transients_grid(int width, int height)
{
    const int longer = OXL_MAX(width, height),
              side = OXL_MAX(TRANSIENTS_SIDE, (longer + TRANSIENTS_ACROSS - 1) / TRANSIENTS_ACROSS);
    return (struct transients_grid){width, height, side, (width + side - 1) / side,
                                    (height + side - 1) / side};
}

/* Averages the error over the unmasked pixels of square (x, y); -1: none. weight (H,W) NULL: no mask. */
static float transients_error(const struct transients_grid *g, const float *rendered, const float *image,
                              const float *weight, int x, int y)
{
    const size_t plane = (size_t)g->width * (size_t)g->height;
    const int left = x * g->side, right = OXL_MIN(left + g->side, g->width),
              end = OXL_MIN((y + 1) * g->side, g->height);
    float sum[3] = {0, 0, 0}, count = 0;
    for (int row = y * g->side; row < end; row++)
        for (int column = left; column < right; column++) {
            const size_t at = (size_t)row * (size_t)g->width + (size_t)column;
            const float w = weight ? weight[at] : 1;
            count += w;
            for (size_t c = 0; c < 3; c++) sum[c] += w * (rendered[at + c * plane] - image[at + c * plane]);
        }
    return count > 0 ? (fabsf(sum[0]) + fabsf(sum[1]) + fabsf(sum[2])) / (3 * count) : -1;
}

/* Counts the 3 x 3 squares around the i-th that have the mark. */
static int transients_votes(const struct transients_grid *g, const struct transients_square *square, int i,
                            unsigned mark)
{
    const int x = i % g->across, y = i / g->across;
    int votes = 0;
    for (int row = OXL_MAX(y - 1, 0); row <= OXL_MIN(y + 1, g->down - 1); row++)
        for (int column = OXL_MAX(x - 1, 0); column <= OXL_MIN(x + 1, g->across - 1); column++)
            votes += (square[row * g->across + column].marks & mark) != 0;
    return votes;
}

/* Returns the largest expected error of the points near the i-th square; HUGE_VALF without any. */
static float transients_expected(const struct transients_grid *g, const struct transients_square *square,
                                 int i)
{
    const int x = i % g->across, y = i / g->across;
    float expected = -1;
    for (int row = OXL_MAX(y - TRANSIENTS_NEAR, 0); row <= OXL_MIN(y + TRANSIENTS_NEAR, g->down - 1); row++)
        for (int column = OXL_MAX(x - TRANSIENTS_NEAR, 0);
             column <= OXL_MIN(x + TRANSIENTS_NEAR, g->across - 1); column++)
            expected = OXL_MAX(expected, square[row * g->across + column].expected);
    return expected < 0 ? HUGE_VALF : expected;
}

static void transients_mark(const struct transients_grid *g, struct transients_square *s)
{
    const int n = g->across * g->down;
    for (int i = 0; i < n; i++) s[i].marks = s[i].error > TRANSIENTS_ERROR ? TRANSIENTS_ABOVE : 0;
    for (int i = 0; i < n; i++)
        if (s[i].marks & TRANSIENTS_ABOVE && transients_votes(g, s, i, TRANSIENTS_ABOVE) >= TRANSIENTS_VOTES)
            s[i].marks |= TRANSIENTS_OUTLIER;
    for (int i = 0; i < n; i++)
        if (s[i].marks & TRANSIENTS_OUTLIER && s[i].error > TRANSIENTS_TIMES * transients_expected(g, s, i))
            s[i].marks |= TRANSIENTS_CORE | TRANSIENTS_MASKED;
    for (int i = 0; i < n; i++)
        if (s[i].error > TRANSIENTS_ERROR / 2 && transients_votes(g, s, i, TRANSIENTS_CORE) > 0 &&
            2 * s[i].error > TRANSIENTS_TIMES * transients_expected(g, s, i))
            s[i].marks |= TRANSIENTS_MASKED;
}

/* ---------------- points */

/* Returns the square that a point lies in, or -1. */
static int32_t transients_cell(const struct transients_grid *g, const oxl_camera *c, double near_plane,
                               const double *p)
{
    double x[3], pixel[2];
    if (!camera_project(c, p, NULL, x, pixel) || !(x[2] > near_plane)) return -1;
    if (!(pixel[0] >= 0 && pixel[1] >= 0 && pixel[0] < g->width && pixel[1] < g->height)) return -1;
    return (int32_t)pixel[1] / g->side * g->across + (int32_t)pixel[0] / g->side;
}

static void transients_project_points(oxl_context *ctx, struct transients *t, const struct transients_grid *g,
                                      const oxl_scene *scene, const oxl_camera *camera, double near_plane)
{
    const oxl_point *point = oxl_scene_points(scene);
    (void)ctx; /* without OpenMP */
#pragma omp parallel for schedule(static) num_threads(ctx->threads)
    for (int64_t i = 0; i < (int64_t)t->points; i++)
        t->place[i] = transients_cell(g, camera, near_plane, point[i].position);
    for (size_t i = 0; i < t->points; i++) {
        struct transients_square *s = t->place[i] < 0 ? NULL : &t->square[t->place[i]];
        if (s) s->expected = OXL_MAX(s->expected, t->expected[i]);
    }
}

static void transients_update_points(struct transients *t)
{
    for (size_t i = 0; i < t->points; i++) {
        const float error = t->place[i] < 0 ? -1 : t->square[t->place[i]].error;
        if (error >= 0) t->expected[i] += TRANSIENTS_RATE * (OXL_MIN(error, TRANSIENTS_MAX) - t->expected[i]);
    }
}

/* ---------------- an image */

/* Returns the number of masked pixels. */
static size_t transients_fill(const struct transients_grid *g, const struct transients_square *square,
                              int has_mask, float *weight)
{
    size_t count = 0;
    for (int y = 0; y < g->height; y++)
        for (int x = 0; x < g->width; x++, weight++) {
            const int is_masked =
                (square[y / g->side * g->across + x / g->side].marks & TRANSIENTS_MASKED) != 0;
            if (is_masked) *weight = 0;
            else if (!has_mask) *weight = 1;
            count += (size_t)is_masked;
        }
    return count;
}

OXL_INTERNAL oxl_result transients_mask(oxl_context *ctx, struct transients *t, const oxl_scene *scene,
                                        const struct transients_view *v, int update)
{
    const struct transients_grid g = transients_grid(v->camera->width, v->camera->height);
    const int n = g.across * g.down;
    double fraction;
    oxl_result rc = oxl_reserve(ctx, &t->square, &t->square_capacity, (size_t)n, sizeof *t->square);
    if (rc != OXL_OK) return rc;
#pragma omp parallel for schedule(static) num_threads(ctx->threads)
    for (int i = 0; i < n; i++) {
        t->square[i].error = transients_error(&g, v->rendered, v->image, v->has_mask ? v->weight : NULL,
                                              i % g.across, i / g.across);
        t->square[i].expected = -1;
    }
    transients_project_points(ctx, t, &g, scene, v->camera, v->near_plane);
    transients_mark(&g, t->square);
    fraction = (double)transients_fill(&g, t->square, v->has_mask, v->weight) / ((double)g.width * g.height);
    if (!update) return OXL_OK;
    transients_update_points(t);
    t->masked_fraction += TRANSIENTS_SMOOTHING * (fraction - t->masked_fraction);
    return OXL_OK;
}

/* ---------------- the part */

static oxl_result transients_part_begin(struct train *t, void *state)
{
    return transients_begin(t->ctx, state, t->scene, t->options->mask_transients);
}

static void transients_archive(struct archive *a, struct train *t, void *state)
{
    struct transients *m = state;
    (void)t;
    if (m->points == 0) return; /* off: that follows from the options and the scene */
    archive_floats(a, m->expected, m->points);
    archive_doubles(a, &m->masked_fraction, 1);
    for (size_t i = 0; i < m->points; i++)
        archive_expect(a, m->expected[i] >= 0 && m->expected[i] <= TRANSIENTS_MAX);
    archive_expect(a, m->masked_fraction >= 0 && m->masked_fraction <= 1);
}

/* Lets a device mask the view. */
static oxl_result transients_before_render(struct train *t, void *state, struct part_view *v)
{
    struct transients *m = state;
    const struct transients_grid g = transients_grid(v->camera.width, v->camera.height);
    m->device = (struct renderer_transients){oxl_scene_points(t->scene),
                                             m->points,
                                             m->expected,
                                             !t->is_trial,
                                             g.side,
                                             g.across,
                                             g.down,
                                             TRANSIENTS_VOTES,
                                             TRANSIENTS_NEAR,
                                             TRANSIENTS_ERROR,
                                             TRANSIENTS_TIMES,
                                             TRANSIENTS_RATE,
                                             TRANSIENTS_MAX};
    renderer_set_transients(t->renderer, v->learns && m->points > 0 ? &m->device : NULL);
    return OXL_OK;
}

/* Masks pixels of the step's image that disagree with the render, moving objects, where the CPU renders. */
static oxl_result transients_after_render(struct train *t, void *state, struct part_view *v)
{
    struct transients *m = state;
    struct transients_view view = {.camera = &v->camera, .near_plane = t->render.near_plane};
    oxl_result rc;
    if (!v->learns || m->points == 0 || renderer_has_device(t->renderer)) return OXL_OK;
    rc = renderer_image(t->ctx, t->renderer, &view.rendered);
    if (rc == OXL_OK) rc = renderer_target(t->ctx, t->renderer, &view.image, &view.weight, &view.has_mask);
    return rc == OXL_OK ? transients_mask(t->ctx, m, t->scene, &view, !t->is_trial) : rc;
}

static void transients_after_loss(struct train *t, void *state, const struct train_deferred *step,
                                  const struct renderer_loss *loss)
{
    struct transients *m = state;
    if (m->points > 0 && renderer_has_device(t->renderer) && !step->is_trial)
        m->masked_fraction += TRANSIENTS_SMOOTHING * (loss->masked - m->masked_fraction);
}

static void transients_record(struct train *t, void *state)
{
    char words[160];
    if (((struct transients *)state)->points == 0) return;
    transients_describe(state, words, sizeof words);
    oxl_log(t->ctx, OXL_LOG_INFO, "%s", words);
}

/* clang-format off */
static const oxl_option transients_options[] = {
{"mask-transients", NULL, OXL_OPTION_FLAG, OPTION_AT(train.mask_transients), 0, 1, EACH("false"), OXL_TIER_BASIC, TRAINING | RESULT | NOT_LOOKED, "Scene content", "mask what appears in only one image of a place: fish, divers", "robust"},
{0}};
/* clang-format on */

OXL_INTERNAL const struct part part_transients = {.name = "transients",
                                                  .size = sizeof(struct transients),
                                                  .option = transients_options,
                                                  .begin = transients_part_begin,
                                                  .free = transients_free,
                                                  .archive = transients_archive,
                                                  .before_render = transients_before_render,
                                                  .after_render = transients_after_render,
                                                  .after_loss = transients_after_loss,
                                                  .record = transients_record};
