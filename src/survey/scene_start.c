/* scene_start.c - makes points to start from for a survey without points: random ones, where many views look.
 *
 * A point is drawn on the ray of a random pixel of a random training view and kept with the probability
 * (views that see it / most views that see one)^2: the density follows what training compares. If images are
 * composited over a background, points that a view shows transparent are dropped (the visual hull, Laurentini
 * 1994); the points whose colours differ least between the views are taken (Kutulakos & Seitz 2000), with the
 * mean as colour. Otherwise points are grey: a mean over views of unlike things is a haze that stays.
 *
 * Invariant: a function of the survey and the seed, on any number of threads.
 */
#include "scene.h"
#include "survey.h"

#include "../core/random.h"

enum {
    START_VIEWS = 64,       /* most views that points are projected into, evenly among the training views */
    START_TRIED = 4096,     /* points drawn to find the largest number of views that see one */
    START_ATTEMPTS = 1000,  /* most points drawn for each that is kept */
    START_MAP = 256,        /* px; longer side of a map of opaque pixels */
    START_CHOICE = 2,       /* points in the hull for each point that is taken */
    START_TRANSPARENT = 64, /* alpha from which on a pixel shows the scene */
    START_LEAST = 10 /* The hull is not used if it holds fewer than the wanted points divided by this. */
};
#define START_FAR 3.0 /* Limits the depth that is drawn, in extents. */

struct start_map { /* Marks (height,width) with 1 where the view shows the scene. */
    int width, height;
    uint8_t *opaque;
};

struct start_point {
    double position[3], sum[3], square[3]; /* sums over the colours in the views, 0..255 */
    int seen;                              /* number of views that see it */
    uint64_t number;
};

struct start_draw {
    oxl_context *ctx;
    const oxl_scene *scene;
    int *training, trainings; /* (trainings) training views */
    int view[START_VIEWS], views, most;
    struct start_map map[START_VIEWS]; /* maps, of composited scenes */
    struct start_point *point;
    size_t count;
};

/* ---------------- where views are transparent */

static oxl_result start_read_map(oxl_context *ctx, const oxl_scene *scene, int view, struct start_map *out)
{
    struct pixels image = {0};
    const oxl_result rc = image_decode(ctx, PATH(scene->images, "%s", scene->view[view].name), 4, &image);
    const int side = OXL_MAX(image.width, image.height), reduction = (side + START_MAP - 1) / START_MAP;
    if (scene_lacks_image(rc)) return OXL_OK; /* Leaves an unreadable image to training, which reports it. */
    if (rc != OXL_OK) return rc;
    out->width = (image.width + reduction - 1) / reduction;
    out->height = (image.height + reduction - 1) / reduction;
    out->opaque = oxl_calloc(ctx, (size_t)out->width * out->height, 1);
    for (int y = 0; y < image.height && out->opaque; y++)
        for (int x = 0; x < image.width; x++)
            if (image.data[4 * ((size_t)y * image.width + (size_t)x) + 3] >= START_TRANSPARENT)
                out->opaque[(size_t)(y / reduction) * (size_t)out->width + (size_t)(x / reduction)] = 1;
    image_pixels_free(ctx, &image);
    return out->opaque ? OXL_OK : OXL_ERR_MEMORY;
}

/* Returns 0 if the point projects onto a transparent pixel of a view. */
static int start_is_in_hull(const struct start_draw *d, const double at[3])
{
    for (int i = 0; i < d->views; i++) {
        const oxl_camera *c = &d->scene->view[d->view[i]].camera;
        const struct start_map *m = &d->map[i];
        double x[3], p[2];
        if (!m->opaque || !camera_sees(c, at, x, p)) continue;
        if (!m->opaque[(size_t)(p[1] / c->height * m->height) * (size_t)m->width +
                       (size_t)(p[0] / c->width * m->width)])
            return 0;
    }
    return 1;
}

/* ---------------- points */

static void start_draw_point(const struct start_draw *d, uint64_t number, struct start_point *out)
{
    const uint64_t seed = d->ctx->options.seed;
    const int view = d->training[(int)(random_unit(random_bits(seed, number, 0)) * d->trainings)];
    const oxl_camera *c = &d->scene->view[view].camera;
    const double z = START_FAR * d->scene->extent * random_unit(random_bits(seed, number, 1));
    const double pixel[2] = {random_unit(random_bits(seed, number, 2)) * c->width,
                             random_unit(random_bits(seed, number, 3)) * c->height};
    *out = (struct start_point){.number = number};
    camera_unproject(c, pixel, z, out->position);
    for (int i = 0; i < d->views; i++) {
        double x[3], p[2];
        out->seen += camera_sees(&d->scene->view[d->view[i]].camera, out->position, x, p);
    }
}

/* Finds the largest number of views that see a point, then keeps points with the
 * probability that follows from it. */
static void start_draw_points(struct start_draw *d, size_t wanted)
{
    const uint64_t seed = d->ctx->options.seed, last = START_TRIED + START_ATTEMPTS * (uint64_t)wanted;
    uint64_t number = 0;
    d->most = 1;
    if (d->trainings == 0) return;
    for (; number < START_TRIED; number++) {
        start_draw_point(d, number, &d->point[0]);
        d->most = OXL_MAX(d->most, d->point[0].seen);
    }
    for (; d->count < wanted && number < last; number++) {
        struct start_point *p = &d->point[d->count];
        double fraction;
        start_draw_point(d, number, p);
        fraction = (double)p->seen / d->most;
        if (random_unit(random_bits(seed, number, 4)) < fraction * fraction &&
            start_is_in_hull(d, p->position))
            d->count++;
    }
}

/* ---------------- colours */

static oxl_result start_add_colours(struct start_draw *d)
{
    for (int i = 0; i < d->views; i++) {
        const oxl_camera *c = &d->scene->view[d->view[i]].camera;
        const struct training_image *image = scene_image(d->ctx, d->scene, d->view[i]);
        const size_t plane = (size_t)c->width * c->height;
        if (!image && !scene_lacks_image(d->ctx->failed)) return d->ctx->failed;
        for (size_t k = 0; image && k < d->count; k++) {
            double x[3], p[2];
            if (!camera_sees(c, d->point[k].position, x, p)) continue;
            for (size_t ch = 0; ch < 3; ch++) {
                const double v = image->rgb[ch * plane + (size_t)p[1] * (size_t)c->width + (size_t)p[0]];
                d->point[k].sum[ch] += v, d->point[k].square[ch] += v * v;
            }
        }
    }
    return OXL_OK;
}

/* Returns the variance of the point's colours over the views, summed over the channels. */
static double start_variance(const struct start_point *p)
{
    double sum = 0;
    for (int c = 0; c < 3; c++) {
        const double mean = p->sum[c] / OXL_MAX(p->seen, 1);
        sum += p->square[c] / OXL_MAX(p->seen, 1) - mean * mean;
    }
    return sum;
}

static int start_compare(const void *a, const void *b)
{
    const struct start_point *p = a, *q = b;
    const double x = start_variance(p), y = start_variance(q);
    return x != y ? (x < y ? -1 : 1) : (p->number > q->number) - (p->number < q->number);
}

/* ---------------- all of it */

static oxl_result start_begin(struct start_draw *d, size_t wanted)
{
    oxl_context *ctx = d->ctx;
    oxl_result rc = OXL_OK;
    d->training = oxl_alloc(ctx, (size_t)d->scene->view_count + 1, sizeof *d->training);
    d->point = oxl_alloc(ctx, wanted + 1, sizeof *d->point);
    if (!d->training || !d->point) return OXL_ERR_MEMORY;
    d->trainings = scene_views_of(d->scene, OXL_SPLIT_TRAIN, d->training);
    d->views = OXL_MIN(d->trainings, START_VIEWS);
    for (int i = 0; i < d->views; i++) d->view[i] = d->training[(int64_t)i * d->trainings / d->views];
    for (int i = 0; i < d->views && rc == OXL_OK && scene_is_composited(d->scene); i++)
        rc = start_read_map(ctx, d->scene, d->view[i], &d->map[i]);
    return rc;
}

static void start_free_maps(struct start_draw *d)
{
    for (int i = 0; i < d->views; i++) {
        oxl_free(d->ctx, d->map[i].opaque);
        d->map[i].opaque = NULL;
    }
}

static oxl_result start_take(struct start_draw *d, size_t count, int coloured, oxl_point **out, size_t *found)
{
    *found = OXL_MIN(count, d->count);
    *out = oxl_alloc(d->ctx, *found + 1, sizeof **out);
    if (!*out) return OXL_ERR_MEMORY;
    if (coloured) qsort(d->point, d->count, sizeof *d->point, start_compare);
    for (size_t i = 0; i < *found; i++) {
        const struct start_point *p = &d->point[i];
        (*out)[i] = (oxl_point){.rgb = {SCENE_GREY, SCENE_GREY, SCENE_GREY}};
        memcpy((*out)[i].position, p->position, sizeof p->position);
        for (int c = 0; c < 3 && coloured && p->seen; c++)
            (*out)[i].rgb[c] = (uint8_t)(p->sum[c] / p->seen + 0.5);
    }
    return OXL_OK;
}

OXL_INTERNAL size_t scene_start_count(const oxl_scene *scene)
{
    return scene_is_composited(scene) ? SCENE_START_HULL : SCENE_START_RANDOM;
}

OXL_INTERNAL size_t scene_stereo_count(const oxl_scene *scene)
{
    return scene_is_composited(scene) ? SCENE_START_HULL : SIZE_MAX;
}

OXL_INTERNAL oxl_result scene_start_points(oxl_context *ctx, const oxl_scene *scene, size_t count,
                                           oxl_point **out, size_t *found)
{
    int by_outline = scene_is_composited(scene);
    const size_t wanted = count * (by_outline ? START_CHOICE : 1);
    struct start_draw d = {.ctx = ctx, .scene = scene};
    oxl_result rc = start_begin(&d, wanted);
    *out = NULL;
    *found = 0;
    if (rc == OXL_OK) start_draw_points(&d, wanted);
    if (rc == OXL_OK && by_outline && d.count < count / START_LEAST) {
        start_free_maps(&d);
        by_outline = 0, d.count = 0;
        start_draw_points(&d, count);
    }
    if (rc == OXL_OK && by_outline) rc = start_add_colours(&d);
    if (rc == OXL_OK) rc = start_take(&d, count, by_outline, out, found);
    start_free_maps(&d);
    OXL_FREE(ctx, d.training, d.point);
    return rc;
}
