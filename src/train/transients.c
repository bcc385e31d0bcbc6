/* transients.c - what swims through one image is not learned: where it stays unexplained while the other images of the same place
 * are explained, its pixels do not count.
 *
 * From RobustNeRF (Sabour et al. 2023, arXiv 2302.00833, its trimmed least squares) come the residual as the witness, the vote of the
 * neighbourhood, and weights of 0 or 1 made anew in each step. Its threshold, the median of a batch's residuals, is not taken: it
 * masks half of all pixels at first, and for good what is hard to model (thin corals, the survey's rim), which is then never learned. A
 * fish and a coral that is not learned yet leave the same residual in one image; they differ in the others. So each sparse point
 * keeps what error is `usual` where it lies, over the views that see it: small behind a fish, for the other views explain the ground;
 * large at the coral until it is learned; and TRANSIENTS_MOST at first, so that little is masked before errors have been observed.
 *
 * In a step, e being the error of a square of pixels: the channels' mean of |mean of rendered - image| (of the signed difference:
 * texture that is not learned yet has next to none, a blot has), and m the largest usual error of the points around it,
 *     odd    e > TRANSIENTS_ERROR, and of TRANSIENTS_VOTES at least of the 3 x 3 squares around
 *     core   odd, and e > TRANSIENTS_TIMES m
 *     masked core; or next to one, with e > TRANSIENTS_ERROR / 2 and 2 e > TRANSIENTS_TIMES m
 *     usual  <- usual + TRANSIENTS_RATE (min(e, TRANSIENTS_MOST) - usual), for each point in view
 * Squares without points around are never masked. docs/log/ROBUST.md has gains, cost and rejected alternatives.
 *
 * Invariant: weights and usual errors are a function of the model, the view and the usual errors before; no sum depends on the number
 * of threads.
 */
#include "train.h"

#define TRANSIENTS_ERROR     0.05f /* of white: a twentieth is a blot that one sees */
#define TRANSIENTS_TIMES     4.0f  /* what is usual around */
#define TRANSIENTS_MOST      0.05f /* of white: counts in what is usual; with more, each fish makes the next one usual */
#define TRANSIENTS_RATE      0.1f  /* the last ten views, about */
#define TRANSIENTS_SMOOTHING 0.02  /* of the share that is told at the end: about the last 50 views */
enum {
    TRANSIENTS_VOTES  = 3,   /* of the 3 x 3 squares, with the one in the middle: noise has none, a thin tail has them */
    TRANSIENTS_ACROSS = 100, /* squares along the longer side of an image, */
    TRANSIENTS_SIDE   = 4,   /* px: or fewer, of so many at least */
    TRANSIENTS_NEAR   = 2    /* squares: points that speak for one lie so near */
};
enum { TRANSIENTS_ABOVE = 1, TRANSIENTS_ODD = 2, TRANSIENTS_CORE = 4, TRANSIENTS_ASIDE = 8 };

OXL_INTERNAL oxl_result transients_begin(oxl_context *ctx, struct transients *r, const oxl_scene *scene, int on)
{
    *r = (struct transients){.points = on ? oxl_scene_point_count(scene) : 0};
    if (on && r->points == 0) oxl_log(ctx, OXL_LOG_WARNING, "the scene has no points: transients are not masked");
    if (r->points == 0) return OXL_OK;
    r->usual = oxl_alloc(ctx, r->points, sizeof *r->usual);
    r->place = oxl_alloc(ctx, r->points, sizeof *r->place);
    if (!r->usual || !r->place) return oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for the usual errors of %zu points", r->points);
    for (size_t i = 0; i < r->points; i++) r->usual[i] = TRANSIENTS_MOST;
    return OXL_OK;
}

OXL_INTERNAL void transients_free(oxl_context *ctx, struct transients *r)
{
    oxl_free(ctx, r->usual);
    oxl_free(ctx, r->place);
    oxl_free(ctx, r->square);
    *r = (struct transients){0};
}

OXL_INTERNAL void transients_describe(const struct transients *r, char *out, size_t size)
{
    snprintf(out, size, "transients: %.1f %% of the pixels masked in recent images", 100 * r->masked_share);
}

/* ---------------------------------------------------------------- squares of pixels */

struct transients_grid {
    int width, height; /* px */
    int side, across, down;
};

static struct transients_grid transients_grid(int width, int height)
{
    const int longer = OXL_MAX(width, height),
              side   = OXL_MAX(TRANSIENTS_SIDE, (longer + TRANSIENTS_ACROSS - 1) / TRANSIENTS_ACROSS);
    return (struct transients_grid){width, height, side, (width + side - 1) / side, (height + side - 1) / side};
}

/* Of the pixels of square (x, y) that count; -1: none does. weight (H,W) may be NULL: all do. */
static float transients_error(const struct transients_grid *g, const float *rendered, const float *image, const float *weight,
                              int x, int y)
{
    const size_t plane = (size_t)g->width * (size_t)g->height;
    const int    left = x * g->side, right = OXL_MIN(left + g->side, g->width), end = OXL_MIN((y + 1) * g->side, g->height);
    float        sum[3] = {0, 0, 0}, count = 0;
    for (int row = y * g->side; row < end; row++)
        for (int column = left; column < right; column++) {
            const size_t at = (size_t)row * (size_t)g->width + (size_t)column;
            const float  w  = weight ? weight[at] : 1;
            count += w;
            for (size_t c = 0; c < 3; c++) sum[c] += w * (rendered[at + c * plane] - image[at + c * plane]);
        }
    return count > 0 ? (fabsf(sum[0]) + fabsf(sum[1]) + fabsf(sum[2])) / (3 * count) : -1;
}

/* How many of the 3 x 3 squares around the i-th have the mark. */
static int transients_votes(const struct transients_grid *g, const struct transients_square *square, int i, unsigned mark)
{
    const int x = i % g->across, y = i / g->across;
    int       votes = 0;
    for (int row = OXL_MAX(y - 1, 0); row <= OXL_MIN(y + 1, g->down - 1); row++)
        for (int column = OXL_MAX(x - 1, 0); column <= OXL_MIN(x + 1, g->across - 1); column++)
            votes += (square[row * g->across + column].marks & mark) != 0;
    return votes;
}

/* The largest usual error of the points near the i-th square; HUGE_VALF without any. */
static float transients_usual(const struct transients_grid *g, const struct transients_square *square, int i)
{
    const int x = i % g->across, y = i / g->across;
    float     usual = -1;
    for (int row = OXL_MAX(y - TRANSIENTS_NEAR, 0); row <= OXL_MIN(y + TRANSIENTS_NEAR, g->down - 1); row++)
        for (int column = OXL_MAX(x - TRANSIENTS_NEAR, 0); column <= OXL_MIN(x + TRANSIENTS_NEAR, g->across - 1); column++)
            usual = OXL_MAX(usual, square[row * g->across + column].usual);
    return usual < 0 ? HUGE_VALF : usual;
}

static void transients_mark(const struct transients_grid *g, struct transients_square *s)
{
    const int n = g->across * g->down;
    for (int i = 0; i < n; i++) s[i].marks = s[i].error > TRANSIENTS_ERROR ? TRANSIENTS_ABOVE : 0;
    for (int i = 0; i < n; i++)
        if (s[i].marks & TRANSIENTS_ABOVE && transients_votes(g, s, i, TRANSIENTS_ABOVE) >= TRANSIENTS_VOTES)
            s[i].marks |= TRANSIENTS_ODD;
    for (int i = 0; i < n; i++)
        if (s[i].marks & TRANSIENTS_ODD && s[i].error > TRANSIENTS_TIMES * transients_usual(g, s, i))
            s[i].marks |= TRANSIENTS_CORE | TRANSIENTS_ASIDE;
    for (int i = 0; i < n; i++)
        if (s[i].error > TRANSIENTS_ERROR / 2 && transients_votes(g, s, i, TRANSIENTS_CORE) > 0 &&
            2 * s[i].error > TRANSIENTS_TIMES * transients_usual(g, s, i))
            s[i].marks |= TRANSIENTS_ASIDE;
}

/* ---------------------------------------------------------------- points */

/* The square that a point lies in, or -1. */
static int32_t transients_cell(const struct transients_grid *g, const oxl_camera *c, double near_plane, const double *p)
{
    const double *r = c->rotation, *t = c->translation;
    const double  z = r[6] * p[0] + r[7] * p[1] + r[8] * p[2] + t[2];
    double        x, y;
    if (!(z > near_plane)) return -1;
    x = c->cx + c->fx * (r[0] * p[0] + r[1] * p[1] + r[2] * p[2] + t[0]) / z;
    y = c->cy + c->fy * (r[3] * p[0] + r[4] * p[1] + r[5] * p[2] + t[1]) / z;
    if (!(x >= 0 && y >= 0 && x < g->width && y < g->height)) return -1;
    return (int32_t)y / g->side * g->across + (int32_t)x / g->side;
}

static void transients_ask_points(oxl_context *ctx, struct transients *r, const struct transients_grid *g, const oxl_scene *scene,
                                  const oxl_camera *camera, double near_plane)
{
    const oxl_point *point = oxl_scene_points(scene);
    (void)ctx; /* without OpenMP */
#pragma omp parallel for schedule(static) num_threads(ctx->threads)
    for (int64_t i = 0; i < (int64_t)r->points; i++) r->place[i] = transients_cell(g, camera, near_plane, point[i].position);
    for (size_t i = 0; i < r->points; i++) {
        struct transients_square *s = r->place[i] < 0 ? NULL : &r->square[r->place[i]];
        if (s) s->usual = OXL_MAX(s->usual, r->usual[i]);
    }
}

static void transients_add_points(struct transients *r)
{
    for (size_t i = 0; i < r->points; i++) {
        const float error = r->place[i] < 0 ? -1 : r->square[r->place[i]].error;
        if (error >= 0) r->usual[i] += TRANSIENTS_RATE * (OXL_MIN(error, TRANSIENTS_MOST) - r->usual[i]);
    }
}

/* ---------------------------------------------------------------- an image */

/* Returns how many pixels are aside. */
static size_t transients_fill(const struct transients_grid *g, const struct transients_square *square, int masked, float *weight)
{
    size_t aside = 0;
    for (int y = 0; y < g->height; y++)
        for (int x = 0; x < g->width; x++, weight++) {
            const int is_aside = (square[y / g->side * g->across + x / g->side].marks & TRANSIENTS_ASIDE) != 0;
            if (is_aside) *weight = 0;
            else if (!masked) *weight = 1;
            aside += (size_t)is_aside;
        }
    return aside;
}

OXL_INTERNAL oxl_result transients_weigh(oxl_context *ctx, struct transients *r, const oxl_scene *scene,
                                         const struct transients_view *v, int remember)
{
    const struct transients_grid g = transients_grid(v->camera->width, v->camera->height);
    const int                    n = g.across * g.down;
    double                       aside;
    oxl_result                   rc = oxl_reserve(ctx, (void **)&r->square, &r->square_capacity, (size_t)n, sizeof *r->square);
    if (rc != OXL_OK) return rc;
#pragma omp parallel for schedule(static) num_threads(ctx->threads)
    for (int i = 0; i < n; i++) {
        r->square[i].error =
            transients_error(&g, v->rendered, v->image, v->masked ? v->weight : NULL, i % g.across, i / g.across);
        r->square[i].usual = -1;
    }
    transients_ask_points(ctx, r, &g, scene, v->camera, v->near_plane);
    transients_mark(&g, r->square);
    aside = (double)transients_fill(&g, r->square, v->masked, v->weight) / ((double)g.width * g.height);
    if (!remember) return OXL_OK;
    transients_add_points(r);
    r->masked_share += TRANSIENTS_SMOOTHING * (aside - r->masked_share);
    return OXL_OK;
}

OXL_INTERNAL void transients_archive(struct archive *a, struct transients *r)
{
    if (r->points == 0) return; /* off: that follows from the options and the scene */
    archive_floats(a, r->usual, r->points);
    archive_doubles(a, &r->masked_share, 1);
    for (size_t i = 0; i < r->points; i++) archive_expect(a, r->usual[i] >= 0 && r->usual[i] <= TRANSIENTS_MOST);
    archive_expect(a, r->masked_share >= 0 && r->masked_share <= 1);
}
