/* stereo.c - makes points to start from: a depth map of each training view, from its neighbours' images.
 *
 * Structure from motion finds a point for a hundred pixels or more, and none on faint or repetitive ground;
 * a survey with poses alone has no points at all. A run that begins on the surface needs a fraction of the
 * steps (docs/log/TRAINING.md). So each training view gets a depth for each cell of a reduced image. At the
 * coarsest level a plane sweep [Collins 1996] tries inverse depths over the range of the survey's points, or
 * over that of the survey's file, or, without both, over the disparities that neighbours can have. Finer
 * levels begin with the coarser result and try the planes of adjacent cells, and small changes [PatchMatch:
 * Bleyer et al. 2011]. Patches are compared by normalized cross correlation, which does not depend on gains
 * and lamp; of several neighbours the best two count, so that an occlusion in one view does no harm. A depth
 * is used if another view's map agrees with it. Points are thinned to one for a square of pixels, and none is
 * made where the survey has one.
 *
 * Invariant: a function of the scene alone, on any number of threads: a cell reads the previous pass.
 */
#include "stereo.h"
#include "../core/option_rows.h"
#include "../core/simd.h"
#include "../survey/image.h"
#include "../survey/scene.h"
#include "../survey/survey.h"
#include "../train/part.h"
#include <float.h>

enum {
    STEREO_SIDE = 480,     /* px: longest side of a reduced image */
    STEREO_LEVELS = 3,     /* each has half the sides of the one before */
    STEREO_CELL = 4,       /* px of the finest level: side of a cell, which has one depth */
    STEREO_NEIGHBOURS = 3, /* views that a patch is compared with */
    STEREO_IMAGES = 12,    /* reduced images that are kept */
    STEREO_LANES = 32,     /* samples of a patch, */
    STEREO_SAMPLES = 29,   /* of which so many count: a disc */
    STEREO_REACH = 3,      /* px: its radius */
    STEREO_PLANES = 128,   /* most inverse depths of a sweep */
    STEREO_ROUNDS = 100,   /* of coarser places, at most */
    STEREO_HELD = 4,       /* points that are held for each that is wanted, at most */
    STEREO_POINTS = 4096   /* points of the survey that a view's range of depths is taken from */
};
#define STEREO_PIXELS_EACH \
    100.0                    /* training pixels, as the run begins, for each point, the survey's with them, */
#define STEREO_FRACTION 0.5  /* up to this fraction of the Gaussians that may be added */
#define STEREO_DETAIL 0.14   /* levels: standard deviation of a patch that shows something */
#define STEREO_AGREES 0.7    /* correlation of patches that show one place */
#define STEREO_ALONE 0.1f    /* by which a correlation counts less that no second neighbour confirms */
#define STEREO_TOLERANCE 0.4 /* px of the finest level: between two maps that agree */
#define STEREO_HOPE 0.3      /* correlation of a plane that is worth a change */
#define STEREO_STEP 0.5      /* px of a level: the change of disparity that is tried */
#define STEREO_PLAIN 60.0    /* levels: norm of a patch where points are as dense as asked for; they are */
#define STEREO_DENSEST 0.5   /* closer by this factor where there is more detail, at most, */
#define STEREO_SPARSEST 8.0  /* and farther apart where there is less */
#define STEREO_COARSER 1.1   /* by which places grow until there are few enough */
#define STEREO_MARGIN 0.15   /* of an inverse depth: beyond the range of the points */
#define STEREO_DISPARITY 0.6 /* of a side: the largest disparity where no depth is known */
#define STEREO_ALONG 0.8     /* cosine between the axes of neighbours, at least */
#define STEREO_ANGLE 0.15    /* rad: the best angle between neighbours, as seen from the scene, */
#define STEREO_ANGLE_LEAST 0.02 /* the smallest, */
#define STEREO_ANGLE_MOST 0.6   /* and the largest */

struct stereo_level { /* of an image */
    int width, height;
    float *grey; /* (H,W) levels of the mean of the channels; NaN: masked */
};
struct stereo_image {
    int view;
    size_t used; /* the clock then; 0: free */
    struct stereo_level level[STEREO_LEVELS];
    uint8_t *rgb; /* (H,W,3) of the finest level */
};
struct stereo_cell { /* a plane: inverse depth at the cell's centre, slopes per px of the finest level */
    float w, dx, dy, score, detail; /* detail: norm of the patch */
};
struct stereo_grid { /* cells of a level */
    int across, down;
    struct stereo_cell *cell, *next;
};
struct stereo_map {           /* of a training view */
    int across, down, factor; /* px of the view per px of the finest level */
    struct stereo_cell *cell; /* (down,across) w 0: none */
    uint8_t *rgb;             /* (down,across,3) */
    int neighbour[STEREO_NEIGHBOURS], neighbours;
    double pixel; /* inverse depth that moves a patch by a pixel of the finest level in a neighbour */
};
struct stereo_pair { /* rays (x/z, y/z, 1) of one camera as px of another view's finest level: A ray + w b */
    double a[9], b[3];
};
struct stereo_patch {
    float value[STEREO_LANES]; /* less their mean; 0 where a lane does not count */
    float mean, norm;          /* norm: root of the sum of the squares */
    /* of a plane with inverse depth 0, in each neighbour: the centre as homogeneous px of the finest level,
     * and its derivatives along rows and columns of the level */
    double at[STEREO_NEIGHBOURS][3], along[STEREO_NEIGHBOURS][3], down[STEREO_NEIGHBOURS][3];
};
struct stereo { /* the view at hand */
    oxl_context *ctx;
    const oxl_scene *scene;
    struct stereo_image image[STEREO_IMAGES];
    size_t clock;
    struct stereo_map *map; /* (views) */
    double low, high;       /* inverse depths of the view */
    struct stereo_pair pair[STEREO_NEIGHBOURS];
    const struct stereo_image *of, *to[STEREO_NEIGHBOURS];
    int pairs;
};

/* ---------------- reduced images */

static void stereo_free_image(oxl_context *ctx, struct stereo_image *image)
{
    for (int k = 0; k < STEREO_LEVELS; k++) oxl_free(ctx, image->level[k].grey);
    oxl_free(ctx, image->rgb);
    *image = (struct stereo_image){0};
}

static int stereo_factor(const oxl_camera *c)
{
    return (OXL_MAX(c->width, c->height) + STEREO_SIDE - 1) / STEREO_SIDE;
}

/* Takes means of factor x factor pixels; edges that do not fill one are dropped. */
static void stereo_reduce(const struct training_image *from, int factor, struct stereo_image *to)
{
    const struct stereo_level *l = &to->level[0];
    const size_t w = (size_t)from->width, plane = w * (size_t)from->height, f = (size_t)factor;
    for (size_t y = 0; y < (size_t)l->height; y++)
        for (size_t x = 0; x < (size_t)l->width; x++) {
            unsigned sum[3] = {0}, masked = 0;
            const size_t at = y * (size_t)l->width + x;
            for (size_t row = y * f; row < y * f + f; row++)
                for (size_t pixel = row * w + x * f; pixel < row * w + x * f + f; pixel++) {
                    for (size_t c = 0; c < 3; c++) sum[c] += from->rgb[c * plane + pixel];
                    masked |= from->mask && !from->mask[pixel];
                }
            for (size_t c = 0; c < 3; c++) to->rgb[3 * at + c] = (uint8_t)(sum[c] / (f * f));
            l->grey[at] = masked ? NAN : (float)(sum[0] + sum[1] + sum[2]) / (float)(3 * f * f);
        }
}

static void stereo_halve(const struct stereo_level *from, struct stereo_level *to)
{
    for (int y = 0; y < to->height; y++)
        for (int x = 0; x < to->width; x++) {
            const float *v = from->grey + (size_t)(2 * y) * (size_t)from->width + 2 * x;
            to->grey[(size_t)y * (size_t)to->width + (size_t)x] =
                0.25f * (v[0] + v[1] + v[from->width] + v[from->width + 1]);
        }
}

static oxl_result stereo_make_image(struct stereo *s, const struct training_image *from,
                                    struct stereo_image *to)
{
    const int factor = stereo_factor(&s->scene->view[to->view].camera);
    for (int k = 0; k < STEREO_LEVELS; k++) {
        struct stereo_level *l = &to->level[k];
        l->width = from->width / factor >> k, l->height = from->height / factor >> k;
        l->grey = oxl_alloc(s->ctx, (size_t)l->width * (size_t)l->height + 1, sizeof *l->grey);
        if (!l->grey) return OXL_ERR_MEMORY;
    }
    to->rgb = oxl_alloc(s->ctx, 3 * (size_t)to->level[0].width * (size_t)to->level[0].height + 1, 1);
    if (!to->rgb) return OXL_ERR_MEMORY;
    stereo_reduce(from, factor, to);
    for (int k = 1; k < STEREO_LEVELS; k++) stereo_halve(&to->level[k - 1], &to->level[k]);
    return OXL_OK;
}

/* Finds a view's reduced image, *out; NULL: its file cannot be read, which training reports. */
static oxl_result stereo_image(struct stereo *s, int view, const struct stereo_image **out)
{
    struct stereo_image *oldest = s->image;
    const struct training_image *image;
    for (struct stereo_image *i = s->image; i < s->image + STEREO_IMAGES; i++) {
        if (i->used && i->view == view) {
            i->used = ++s->clock;
            *out = i;
            return OXL_OK;
        }
        if (i->used < oldest->used) oldest = i;
    }
    *out = NULL;
    stereo_free_image(s->ctx, oldest);
    image = scene_image(s->ctx, s->scene, view);
    if (!image) return scene_lacks_image(s->ctx->failed) ? OXL_OK : s->ctx->failed;
    oldest->view = view, oldest->used = ++s->clock;
    *out = oldest;
    return stereo_make_image(s, image, oldest);
}

/* ---------------- neighbours, and the range of depths */

/* Finds a view's inverse depths (low, middle, high) from the survey's points, or, with too few, from its
 * range of depths; returns 0 without. */
static int stereo_depths(const struct stereo *s, int view, double w[3])
{
    enum { LEAST = 16 };
    const oxl_camera *c = &s->scene->view[view].camera;
    const double *range = scene_depth_range(s->scene, view);
    const oxl_point *point = s->scene->point;
    const size_t count = s->scene->point_count, step = count / STEREO_POINTS + 1;
    double z[STEREO_POINTS + 1];
    size_t n = 0;
    for (size_t i = 0; i < count; i += step) {
        double x[3], pixel[2];
        if (camera_sees(c, point[i].position, x, pixel)) z[n++] = x[2];
    }
    if (n < LEAST && !range) return 0;
    w[0] = (1 - STEREO_MARGIN) / (n < LEAST ? range[1] : stats_select(z, n, 0.995));
    w[2] = (1 + STEREO_MARGIN) / (n < LEAST ? range[0] : stats_select(z, n, 0.005));
    w[1] = n < LEAST ? 0.5 * (w[0] + w[2]) : 1 / stats_select(z, n, 0.5);
    return 1;
}

/* Rates a view as a neighbour: larger is better, 0: none. w: inverse depth of the scene; 0: not known. */
static double stereo_rate(const oxl_camera *a, const oxl_camera *b, double w)
{
    const double baseline = camera_distance(a, b), angle = w * baseline;
    double along = 0, inside = 0;
    for (int k = 0; k < 3; k++) along += a->rotation[6 + k] * b->rotation[6 + k];
    if (!(baseline > 0) || along < STEREO_ALONG) return 0;
    if (!(w > 0)) return 1 / baseline;
    if (angle < STEREO_ANGLE_LEAST || angle > STEREO_ANGLE_MOST) return 0;
    for (int k = 0; k < 5; k++) { /* the middle, and four places around it */
        const double at[2] = {a->width * (0.5 + 0.3 * ((k & 1) - (k >> 1 & 1))),
                              a->height * (0.5 + 0.3 * ((k > 2) - (k == 1 || k == 2)))};
        double world[3], x[3], pixel[2];
        camera_unproject(a, at, 1 / w, world);
        inside += camera_sees(b, world, x, pixel);
    }
    return inside * OXL_MIN(angle / STEREO_ANGLE, STEREO_ANGLE / angle);
}

static void stereo_find_neighbours(const struct stereo *s, int view, double w, struct stereo_map *map)
{
    double rate[STEREO_NEIGHBOURS] = {0};
    for (int v = 0; v < s->scene->view_count; v++) {
        const oxl_view *other = &s->scene->view[v];
        double r =
            v == view || other->is_test ? 0 : stereo_rate(&s->scene->view[view].camera, &other->camera, w);
        for (int k = 0, n = v; k < STEREO_NEIGHBOURS && r > 0; k++)
            if (r > rate[k]) {
                OXL_SWAP(double, rate[k], r);
                OXL_SWAP(int, map->neighbour[k], n);
            }
    }
    while (map->neighbours < STEREO_NEIGHBOURS && rate[map->neighbours] > 0) map->neighbours++;
}

static void stereo_pair_cameras(const oxl_camera *from, const oxl_camera *to, struct stereo_pair *pair)
{
    const double f = stereo_factor(to);
    double m[12]; /* rotation from one to the other, and translation */
    for (int i = 0; i < 3; i++) {
        m[9 + i] = to->translation[i];
        for (int j = 0; j < 3; j++) {
            m[3 * i + j] = 0;
            for (int k = 0; k < 3; k++) m[3 * i + j] += to->rotation[3 * i + k] * from->rotation[3 * j + k];
        }
        for (int j = 0; j < 3; j++) m[9 + i] -= m[3 * i + j] * from->translation[j];
    }
    for (int j = 0; j < 4; j++) {
        const double v[3] = {m[j < 3 ? j : 9], m[j < 3 ? 3 + j : 10], m[j < 3 ? 6 + j : 11]};
        const double out[3] = {(to->fx * v[0] + to->cx * v[2]) / f, (to->fy * v[1] + to->cy * v[2]) / f,
                               v[2]};
        for (int i = 0; i < 3; i++)
            if (j < 3) pair->a[3 * i + j] = out[i];
            else pair->b[i] = out[i];
    }
}

/* ---------------- the correlation of patches */

/* Offsets of a disc's pixels, px; the last three lanes do not count. */
static const int8_t STEREO_X[STEREO_LANES] = {0, -1, 1, 0,  0, -1, 1, -1, 1, -2, 2, 0, 0, -2, -2, 2,
                                              2, -1, 1, -1, 1, -2, 2, -2, 2, -3, 3, 0, 0, 0,  0,  0};
static const int8_t STEREO_Y[STEREO_LANES] = {0, 0,  0,  -1, 1, -1, -1, 1, 1, 0, 0, -2, 2, -1, 1, -1,
                                              1, -2, -2, 2,  2, -2, -2, 2, 2, 0, 0, -3, 3, 0,  0, 0};

struct stereo_job {
    const struct stereo_level *image;
    /* the affine warp: px of `image` at the patch's centre, and its derivatives */
    float u, v, ux, uy, vx, vy;
    float mean;             /* taken from samples before sums, so that their differences keep digits */
    const float *reference; /* (LANES) */
    float *value;           /* (LANES) samples */
    float *sums;            /* (3) of the samples, of their squares, of their products with the reference */
};

SIMD_INLINE float stereo_add_lanes(float lane[STEREO_LANES])
{
    for (int half = STEREO_LANES / 2; half > 0; half /= 2)
        for (int l = 0; l < half; l++) lane[l] += lane[l + half];
    return lane[0];
}

SIMD_BODY void stereo_sample_body(const int fused, const struct stereo_job *job)
{
    const float *grey = job->image->grey;
    const int width = job->image->width;
    float value[STEREO_LANES], square[STEREO_LANES], product[STEREO_LANES];
    (void)fused;
#pragma omp simd
    for (int l = 0; l < STEREO_LANES; l++) {
        const float dx = STEREO_X[l], dy = STEREO_Y[l], on = l < STEREO_SAMPLES;
        const float x = job->u + job->ux * dx + job->uy * dy, y = job->v + job->vx * dx + job->vy * dy;
        const int column = (int)x, row = (int)y, at = row * width + column;
        const float fx = x - (float)column, fy = y - (float)row;
        const float above = grey[at] + fx * (grey[at + 1] - grey[at]);
        const float below = grey[at + width] + fx * (grey[at + width + 1] - grey[at + width]);
        const float v = (above + fy * (below - above) - job->mean) * on;
        value[l] = v;
        square[l] = v * v;
        product[l] = v * job->reference[l];
    }
    if (job->value) memcpy(job->value, value, sizeof value);
    job->sums[0] = stereo_add_lanes(value);
    job->sums[1] = stereo_add_lanes(square);
    job->sums[2] = stereo_add_lanes(product);
}

SIMD_DISPATCH(static, stereo_sample, struct stereo_job)

/* Returns 1 if the warped patch is inside the image. */
static int stereo_fits(const struct stereo_job *job)
{
    const float r = STEREO_REACH, x = r * (fabsf(job->ux) + fabsf(job->uy)),
                y = r * (fabsf(job->vx) + fabsf(job->vy));
    return job->u - x >= 0 && job->v - y >= 0 && job->u + x < (float)(job->image->width - 1) &&
           job->v + y < (float)(job->image->height - 1);
}

/* Projects the patch around a pixel of the level, and its axes, into each neighbour. */
static void stereo_aim(const struct stereo *s, int level, double x, double y, struct stereo_patch *patch)
{
    const oxl_camera *c = &s->scene->view[s->of->view].camera;
    const double f = stereo_factor(c) << level, ray[2] = {(x * f - c->cx) / c->fx, (y * f - c->cy) / c->fy};
    for (int k = 0; k < s->pairs; k++)
        for (int i = 0; i < 3; i++) {
            const double *a = s->pair[k].a + 3 * i;
            patch->at[k][i] = a[0] * ray[0] + a[1] * ray[1] + a[2];
            patch->along[k][i] = a[0] * f / c->fx, patch->down[k][i] = a[1] * f / c->fy;
        }
}

/* Takes the patch around a pixel of the level; returns 0 where there is nothing to compare: at the image's
 * edge, at masked pixels, and without detail. */
static int stereo_take_patch(const struct stereo *s, int level, double x, double y,
                             struct stereo_patch *patch)
{
    static const float zero[STEREO_LANES] = {0};
    float sums[3];
    struct stereo_job job = {.image = &s->of->level[level],
                             .u = (float)(x - 0.5),
                             .v = (float)(y - 0.5),
                             .ux = 1,
                             .vy = 1,
                             .reference = zero,
                             .value = patch->value,
                             .sums = sums};
    if (!stereo_fits(&job)) return 0;
    job.mean = job.image->grey[(size_t)job.v * (size_t)job.image->width + (size_t)job.u];
    stereo_sample(s->ctx->isa, &job);
    patch->mean = sums[0] / STEREO_SAMPLES;
    for (int l = 0; l < STEREO_SAMPLES; l++) patch->value[l] -= patch->mean;
    patch->norm = sqrtf(OXL_MAX(sums[1] - sums[0] * patch->mean, 0));
    patch->mean += job.mean;
    stereo_aim(s, level, x, y, patch);
    return patch->norm > (float)(STEREO_DETAIL * sqrt(STEREO_SAMPLES));
}

/* Returns the correlation with what neighbour k shows of a patch on a plane; -2: it does not show all of it.
 * *moves: px of the level by which a change of the inverse depth moves it. */
static float stereo_correlate(const struct stereo *s, int level, int k, const struct stereo_patch *patch,
                              const struct stereo_cell *plane, double *moves)
{
    const struct stereo_pair *pair = &s->pair[k];
    const double scale = 1.0 / (1 << level);
    float sums[3];
    struct stereo_job job = {
        .image = &s->to[k]->level[level], .mean = patch->mean, .reference = patch->value, .sums = sums};
    double p[3], px[3], py[3], u, v, variance;
    for (int i = 0; i < 3; i++) {
        p[i] = patch->at[k][i] + plane->w * pair->b[i];
        px[i] = patch->along[k][i] + plane->dx * (1 << level) * pair->b[i];
        py[i] = patch->down[k][i] + plane->dy * (1 << level) * pair->b[i];
    }
    if (!(p[2] > 0)) return -2;
    u = p[0] / p[2], v = p[1] / p[2];
    *moves = scale *
             sqrt((pair->b[0] - u * pair->b[2]) * (pair->b[0] - u * pair->b[2]) +
                  (pair->b[1] - v * pair->b[2]) * (pair->b[1] - v * pair->b[2])) /
             p[2];
    job.u = (float)(scale * u - 0.5), job.v = (float)(scale * v - 0.5);
    job.ux = (float)(scale * (px[0] - u * px[2]) / p[2]),
    job.uy = (float)(scale * (py[0] - u * py[2]) / p[2]);
    job.vx = (float)(scale * (px[1] - v * px[2]) / p[2]),
    job.vy = (float)(scale * (py[1] - v * py[2]) / p[2]);
    if (!stereo_fits(&job)) return -2;
    stereo_sample(s->ctx->isa, &job);
    variance = sums[1] - sums[0] * sums[0] / STEREO_SAMPLES;
    if (!(variance > STEREO_DETAIL * STEREO_DETAIL * STEREO_SAMPLES)) return isnan(variance) ? -2 : 0;
    return sums[2] / (patch->norm * (float)sqrt(variance));
}

/* Returns the mean of the two best correlations, or, where one neighbour shows the patch, a little less than
 * it; -1: none does. Below `least` it may be less. *moves: the largest. */
static float stereo_score(const struct stereo *s, int level, const struct stereo_patch *patch,
                          const struct stereo_cell *plane, float least, double *moves)
{
    float best = -2, second = -2;
    *moves = 0;
    if (!(plane->w >= s->low && plane->w <= s->high)) return -1;
    for (int k = 0; k < s->pairs; k++) {
        double by = 0;
        float c = stereo_correlate(s, level, k, patch, plane, &by);
        *moves = OXL_MAX(*moves, by);
        if (c > best) OXL_SWAP(float, c, best);
        second = OXL_MAX(second, c);
        if (k == s->pairs - 2 && second > -2 && best + 1 < 2 * least) break;
    }
    return second > -2 ? 0.5f * (best + second) : OXL_MAX(best - STEREO_ALONE, -1);
}

/* ---------------- passes over the cells */

/* Makes the centre of cell i, in px of a level. */
static void stereo_centre(const struct stereo_grid *g, int i, int level, double at[2])
{
    const double side = (double)STEREO_CELL / (1 << level);
    at[0] = (i % g->across + 0.5) * side, at[1] = (i / g->across + 0.5) * side;
}

/* Sweeps inverse depths over a cell, if its row and column are even: others take the planes of these. */
static void stereo_sweep(const struct stereo *s, struct stereo_grid *g, int i, int planes)
{
    const int level = STEREO_LEVELS - 1;
    struct stereo_patch patch;
    double at[2], moves;
    struct stereo_cell *best = &g->cell[i];
    *best = (struct stereo_cell){.score = -1};
    stereo_centre(g, i, level, at);
    if (i % g->across % 2 || i / g->across % 2 || !stereo_take_patch(s, level, at[0], at[1], &patch)) return;
    for (int k = 0; k < planes; k++) {
        struct stereo_cell tried = {.w = (float)(s->low + (s->high - s->low) * (k + 0.5) / planes)};
        tried.score = stereo_score(s, level, &patch, &tried, best->score, &moves);
        if (tried.score > best->score) *best = tried;
    }
}

/* Makes the plane that cell i has from the cell at (x, y) from it; for (0, 0) that of its own depth with the
 * slopes that the cells around suggest. Returns 0 without one. */
static int stereo_candidate(const struct stereo_grid *g, int i, int x, int y, struct stereo_cell *out)
{
    const int column = i % g->across, row = i / g->across, from = i + y * g->across + x;
    const int has[4] = {column > 0, column<g->across - 1, row> 0, row < g->down - 1};
    if ((x || y) && !has[x ? x > 0 : 2 + (y > 0)]) return 0;
    *out = g->cell[from];
    if (x || y) {
        if (!(out->score > STEREO_HOPE)) return 0;
        out->w -= (float)STEREO_CELL * ((float)x * out->dx + (float)y * out->dy);
        return 1;
    }
    if (!has[0] || !has[1] || !has[2] || !has[3]) return 0;
    for (int k = 0; k < 2; k++) {
        const int n = k ? g->across : 1;
        if (!(g->cell[i - n].score > STEREO_HOPE && g->cell[i + n].score > STEREO_HOPE)) return 0;
        *(k ? &out->dy : &out->dx) = (g->cell[i + n].w - g->cell[i - n].w) / (2 * STEREO_CELL);
    }
    return 1;
}

/* Moves a plane to the top of the parabola through its score and those a step nearer and farther. */
static void stereo_polish(const struct stereo *s, int level, const struct stereo_patch *patch, double step,
                          struct stereo_cell *best)
{
    double side[2], curve, moves, by;
    for (int k = 0; k < 2; k++) {
        struct stereo_cell tried = *best;
        tried.w += (float)(k ? step : -step);
        side[k] = stereo_score(s, level, patch, &tried, -1, &moves);
    }
    curve = side[0] - 2 * (double)best->score + side[1];
    by = curve < 0 ? 0.5 * (side[0] - side[1]) / curve : side[1] > side[0] ? 1 : -1;
    if (!(side[0] > -1) || !(side[1] > -1)) return;
    best->w = (float)OXL_CLAMP(best->w + step * OXL_CLAMP(by, -1, 1), s->low, s->high);
}

/* Improves a cell at a level: by the planes of the four around it, the slopes that they suggest, and a small
 * change of depth. */
static void stereo_improve(const struct stereo *s, const struct stereo_grid *g, int level, int i)
{
    static const int8_t around[5][2] = {{-1, 0}, {1, 0}, {0, -1}, {0, 1}, {0, 0}};
    struct stereo_cell best = g->cell[i], tried;
    struct stereo_patch patch;
    double at[2], moves, ignored;
    g->next[i] = (struct stereo_cell){.score = -1};
    stereo_centre(g, i, level, at);
    if (!stereo_take_patch(s, level, at[0], at[1], &patch)) return;
    best.score = stereo_score(s, level, &patch, &best, -1, &moves);
    for (int k = 0; k < 5; k++) {
        if (!stereo_candidate(g, i, around[k][0], around[k][1], &tried)) continue;
        tried.score = stereo_score(s, level, &patch, &tried, best.score, &ignored);
        if (tried.score > best.score) best = tried, moves = ignored;
    }
    best.detail = patch.norm;
    if (best.score > STEREO_HOPE && moves > 0) stereo_polish(s, level, &patch, STEREO_STEP / moves, &best);
    g->next[i] = best;
}

/* ---------------- a view */

static oxl_result stereo_make_grid(struct stereo *s, struct stereo_grid *g)
{
    const struct stereo_level *l = &s->of->level[0];
    size_t cells;
    g->across = OXL_MAX(l->width / STEREO_CELL, 1), g->down = OXL_MAX(l->height / STEREO_CELL, 1);
    cells = (size_t)g->across * (size_t)g->down;
    g->cell = oxl_calloc(s->ctx, cells, sizeof *g->cell);
    g->next = oxl_calloc(s->ctx, cells, sizeof *g->next);
    return g->cell && g->next ? OXL_OK : OXL_ERR_MEMORY;
}

/* Finds the planes of the cells, from the coarsest level to the finest; slopes are per px of the finest. */
static void stereo_match(const struct stereo *s, double pixel, struct stereo_grid *g)
{
    const int planes =
        (int)OXL_CLAMP((s->high - s->low) / (pixel * (1 << (STEREO_LEVELS - 1))), 4, STEREO_PLANES);
#pragma omp parallel for schedule(dynamic, 64) num_threads(s->ctx->threads)
    for (int i = 0; i < g->across * g->down; i++) stereo_sweep(s, g, i, planes);
    for (int level = STEREO_LEVELS - 1; level >= 0; level--) {
#pragma omp parallel for schedule(dynamic, 64) num_threads(s->ctx->threads)
        for (int i = 0; i < g->across * g->down; i++) stereo_improve(s, g, level, i);
        OXL_SWAP(struct stereo_cell *, g->cell, g->next);
    }
}

/* Keeps the cells whose patches agree, with their colours. */
static oxl_result stereo_keep_map(struct stereo *s, struct stereo_grid *g, struct stereo_map *map)
{
    const size_t cells = (size_t)g->across * (size_t)g->down, width = (size_t)s->of->level[0].width;
    map->rgb = oxl_calloc(s->ctx, cells, 3);
    if (!map->rgb) return OXL_ERR_MEMORY;
    map->across = g->across, map->down = g->down;
    OXL_SWAP(struct stereo_cell *, map->cell, g->cell);
    for (size_t i = 0; i < cells; i++) {
        const size_t x = i % (size_t)g->across * STEREO_CELL + STEREO_CELL / 2 - 1,
                     y = i / (size_t)g->across * STEREO_CELL + STEREO_CELL / 2 - 1;
        if (!(map->cell[i].score >= STEREO_AGREES)) map->cell[i].w = 0;
        for (size_t c = 0; c < 3; c++) {
            const uint8_t *p = s->of->rgb + 3 * (y * width + x) + c;
            map->rgb[3 * i + c] = (uint8_t)((p[0] + p[3] + p[3 * width] + p[3 * width + 3] + 2) / 4);
        }
    }
    return OXL_OK;
}

static oxl_result stereo_of_view(struct stereo *s, int view)
{
    const oxl_camera *c = &s->scene->view[view].camera;
    struct stereo_map *map = &s->map[view];
    struct stereo_grid grid = {0};
    double w[3] = {0}, baseline = 0;
    const int known = stereo_depths(s, view, w);
    oxl_result rc = stereo_image(s, view, &s->of);
    stereo_find_neighbours(s, view, w[1], map);
    s->pairs = 0;
    for (int k = 0; k < map->neighbours && rc == OXL_OK && s->of; k++) {
        const oxl_camera *to = &s->scene->view[map->neighbour[k]].camera;
        rc = stereo_image(s, map->neighbour[k], &s->to[s->pairs]);
        if (rc != OXL_OK || !s->to[s->pairs]) continue;
        stereo_pair_cameras(c, to, &s->pair[s->pairs++]);
        baseline += camera_distance(c, to);
    }
    if (rc != OXL_OK || !s->of || s->pairs == 0 ||
        s->of->level[STEREO_LEVELS - 1].height < 2 * STEREO_REACH + 2 ||
        s->of->level[STEREO_LEVELS - 1].width < 2 * STEREO_REACH + 2)
        return rc;
    map->factor = stereo_factor(c);
    map->pixel = map->factor / (c->fx * baseline / s->pairs);
    s->low = w[0], s->high = w[2];
    if (!known) s->low = 0, s->high = STEREO_DISPARITY * s->of->level[0].width * map->pixel;
    rc = stereo_make_grid(s, &grid);
    if (rc == OXL_OK) stereo_match(s, map->pixel, &grid);
    if (rc == OXL_OK) rc = stereo_keep_map(s, &grid, map);
    OXL_FREE(s->ctx, grid.cell, grid.next);
    return rc;
}

/* ---------------- points */

struct stereo_point {
    oxl_point point;
    float side, score; /* side: units of the scene: of the square that has one point */
    size_t number;
};
struct stereo_points {
    struct stereo_point *of;
    size_t count, capacity;
    float least, most; /* of the sides */
};

/* Orders points by their score, the best first. */
static int stereo_compare(const void *a, const void *b)
{
    const struct stereo_point *p = a, *q = b;
    return p->score != q->score ? (p->score > q->score ? -1 : 1)
                                : (p->number > q->number) - (p->number < q->number);
}

/* Returns 1 if the map of a neighbour has the same depth there, on the plane of its cell. */
static int stereo_agrees(const struct stereo *s, const struct stereo_map *map, const double at[3])
{
    for (int k = 0; k < map->neighbours; k++) {
        const struct stereo_map *other = &s->map[map->neighbour[k]];
        const oxl_camera *c = &s->scene->view[map->neighbour[k]].camera;
        double x[3], pixel[2], off[2];
        const struct stereo_cell *cell;
        if (!other->cell || !camera_sees(c, at, x, pixel)) continue;
        for (int i = 0; i < 2; i++) {
            const double side = other->factor * STEREO_CELL;
            off[i] = (pixel[i] - (floor(pixel[i] / side) + 0.5) * side) / other->factor;
            pixel[i] /= side;
        }
        if (pixel[0] >= other->across || pixel[1] >= other->down) continue;
        cell = &other->cell[(size_t)pixel[1] * (size_t)other->across + (size_t)pixel[0]];
        if (cell->w > 0 && fabs(cell->w + cell->dx * off[0] + cell->dy * off[1] - 1 / x[2]) <
                               STEREO_TOLERANCE * other->pixel)
            return 1;
    }
    return 0;
}

static oxl_result stereo_add_view(struct stereo *s, int view, struct stereo_points *p)
{
    const oxl_camera *c = &s->scene->view[view].camera;
    const struct stereo_map *map = &s->map[view];
    const double side = map->factor * STEREO_CELL;
    for (int i = 0; map->cell && i < map->across * map->down; i++) {
        const struct stereo_cell *cell = &map->cell[i];
        const double pixel[2] = {(i % map->across + 0.5) * side, (i / map->across + 0.5) * side};
        oxl_point point = {.error = -1};
        if (!(cell->w > 0)) continue;
        camera_unproject(c, pixel, 1 / (double)cell->w, point.position);
        if (!stereo_agrees(s, map, point.position)) continue;
        if (oxl_reserve(s->ctx, &p->of, &p->capacity, p->count + 1, sizeof *p->of) != OXL_OK)
            return OXL_ERR_MEMORY;
        memcpy(point.rgb, map->rgb + 3 * (size_t)i, 3);
        p->of[p->count] = (struct stereo_point){
            point,
            (float)(map->factor / (c->fx * cell->w) *
                    OXL_CLAMP(sqrt(STEREO_PLAIN / cell->detail), STEREO_DENSEST, STEREO_SPARSEST)),
            cell->score, p->count};
        p->least = OXL_MIN(p->least, p->of[p->count].side), p->most = OXL_MAX(p->most, p->of[p->count].side);
        p->count++;
    }
    return OXL_OK;
}

/* Returns a key of the place that a point is in, a cube with sides of 2^power; never 0. */
static uint64_t stereo_place(const double x[3], int power)
{
    uint64_t key = checksum_add(CHECKSUM_SEED, &power, sizeof power);
    for (int k = 0; k < 3; k++) {
        const int64_t at = (int64_t)floor(OXL_CLAMP(ldexp(x[k], -power), -1e15, 1e15));
        key = checksum_add(key, &at, sizeof at);
    }
    return key ? key : 1;
}

static int stereo_power(double side)
{
    int power;
    frexp(side, &power);
    return power;
}

/* Takes a place; returns 0 if it was taken. */
static int stereo_take(uint64_t *taken, size_t slots, uint64_t key)
{
    size_t slot = (size_t)(key % slots);
    while (taken[slot] && taken[slot] != key) slot = (slot + 1) % slots;
    if (taken[slot]) return 0;
    taken[slot] = key;
    return 1;
}

/* Takes the places of the survey's points, at all sides that places can have. */
static void stereo_take_survey(const oxl_scene *scene, const int power[2], uint64_t *taken, size_t slots)
{
    const oxl_point *point = scene->point;
    for (size_t i = 0; i < scene->point_count; i++)
        for (int p = power[0]; p <= power[1]; p++)
            stereo_take(taken, slots, stereo_place(point[i].position, p));
}

/* Counts places of `px` pixels that have a point, and none of the survey; keep: leaves the first of each. */
static size_t stereo_thin(const oxl_scene *scene, struct stereo_points *p, double px, uint64_t *taken,
                          size_t slots, int keep)
{
    const int power[2] = {stereo_power(px * p->least), stereo_power(px * p->most)};
    size_t kept = 0;
    memset(taken, 0, slots * sizeof *taken);
    stereo_take_survey(scene, power, taken, slots);
    for (size_t i = 0; i < p->count; i++) {
        const struct stereo_point at = p->of[i];
        if (!stereo_take(taken, slots, stereo_place(at.point.position, stereo_power(px * at.side)))) continue;
        if (keep) p->of[kept] = at;
        kept++;
    }
    return kept;
}

/* Thins the points, in place, to at most `most`, by the smallest places that do. */
static oxl_result stereo_thin_to(struct stereo *s, struct stereo_points *p, size_t most)
{
    const size_t powers = (size_t)(stereo_power(p->most) - stereo_power(p->least) + 3),
                 slots = 2 * (p->count + powers * s->scene->point_count) + 1;
    uint64_t *taken = oxl_alloc(s->ctx, slots, sizeof *taken);
    double px[STEREO_ROUNDS + 1] = {1};
    int low = 0, high = STEREO_ROUNDS;
    if (!taken) return OXL_ERR_MEMORY;
    qsort(p->of, p->count, sizeof *p->of, stereo_compare);
    for (int k = 0; k < STEREO_ROUNDS; k++) px[k + 1] = px[k] * STEREO_COARSER;
    while (low < high) {
        const int middle = (low + high) / 2;
        if (stereo_thin(s->scene, p, px[middle], taken, slots, 0) > most) low = middle + 1;
        else high = middle;
    }
    p->count = OXL_MIN(stereo_thin(s->scene, p, px[low], taken, slots, 1), most);
    oxl_free(s->ctx, taken);
    return OXL_OK;
}

OXL_INTERNAL oxl_result stereo_points(oxl_context *ctx, const oxl_scene *scene, size_t most, oxl_point **out,
                                      size_t *count)
{
    const int views = scene->view_count;
    struct stereo s = {.ctx = ctx, .scene = scene, .map = oxl_calloc(ctx, (size_t)views + 1, sizeof *s.map)};
    struct stereo_points p = {.least = FLT_MAX};
    oxl_result rc = s.map ? OXL_OK : OXL_ERR_MEMORY;
    *out = NULL, *count = 0;
    for (int v = 0; v < views && rc == OXL_OK && most > 0; v++) {
        rc = context_stopped(ctx);
        if (rc == OXL_OK && !scene->view[v].is_test) rc = stereo_of_view(&s, v);
    }
    for (int v = 0; v < views && rc == OXL_OK && most > 0; v++) {
        rc = stereo_add_view(&s, v, &p);
        if (rc == OXL_OK && p.count > OXL_MAX(STEREO_HELD * most, scene->point_count))
            rc = stereo_thin_to(&s, &p, 2 * most);
    }
    if (rc == OXL_OK && p.count > 0) rc = stereo_thin_to(&s, &p, most);
    if (rc == OXL_OK && !(*out = oxl_alloc(ctx, p.count + 1, sizeof **out))) rc = OXL_ERR_MEMORY;
    for (size_t i = 0; rc == OXL_OK && i < p.count; i++) (*out)[i] = p.of[i].point;
    if (rc == OXL_OK) *count = p.count;
    oxl_free(ctx, p.of);
    for (int v = 0; v < views && s.map; v++) OXL_FREE(ctx, s.map[v].cell, s.map[v].rgb);
    for (int i = 0; i < STEREO_IMAGES; i++) stereo_free_image(ctx, &s.image[i]);
    oxl_free(ctx, s.map);
    return rc;
}

/* ---------------- the part */

static oxl_result stereo_first_points(struct train *t, oxl_point **out, size_t *count)
{
    const size_t points = t->scene->point_count, cap = schedule_gaussian_cap(t->scene, t->options),
                 room = cap > points ? (size_t)(STEREO_FRACTION * (double)(cap - points)) : 0,
                 all = (size_t)(schedule_first_pixels(t->scene, t->options) / STEREO_PIXELS_EACH),
                 wanted = all > points ? OXL_MIN(room, all - points) : 0;
    const size_t most = t->options->stereo ? OXL_MIN(wanted, scene_stereo_count(t->scene)) : 0;
    return stereo_points(t->ctx, t->scene, most, out, count);
}

/* Bounds the memory of the maps from above. The points before they are thinned, STEREO_HELD for each that is
 * wanted or one for each of the survey's, take less than the Gaussians that training makes of these. */
static double stereo_bytes(const oxl_train_options *options, int views)
{
    const double cells = (double)STEREO_SIDE * STEREO_SIDE / (STEREO_CELL * STEREO_CELL);
    return options->stereo ? views * cells * (sizeof(struct stereo_cell) + 3) : 0;
}

/* clang-format off */
static const oxl_option stereo_options[] = {
{"stereo", "off|on", OXL_OPTION_CHOICE, OPTION_AT(train.stereo), 0, 1, PRESETS("on", "on", "off"), OXL_TIER_ADVANCED, TRAINING | RESULT | NOT_REFINED, "Scene content", "also start from points of depth maps, computed from the training images"},
{0}};
/* clang-format on */

OXL_INTERNAL const struct part part_stereo = {
    .name = "stereo", .option = stereo_options, .first_points = stereo_first_points, .bytes = stereo_bytes};
