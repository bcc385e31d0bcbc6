/* quality.c - finds images that differ from those taken beside them, before any training: blurred, too dark,
 * too bright.
 *
 * Sharpness and light depend on what an image shows, so each view is compared with the median of the 8
 * nearest views with the same direction. The logarithm of that ratio is divided by its spread over all views
 * (1.4826 times the median absolute deviation, a robust standard deviation [Rousseeuw & Croux 1993]), so
 * uneven light that is normal in a survey is not reported.
 *
 * Invariant: no check changes what is trained. Every sum is one of integers.
 */
#include "../survey/sparse.h"
#include "../survey/image.h"
#include "../survey/scene.h"
#include "../survey/survey.h"
#include "checks.h"
#include "../core/vecmath.h"

enum {
    QUALITY_MIN = 6,   /* views; with fewer no image is reported */
    QUALITY_NAMED = 5, /* images that are named per message */
    QUALITY_WHITE = 254,
    QUALITY_BLACK = 4
};
/* Reports an image from so many standard deviations on: one of 10^5 views of a normal distribution. */
#define QUALITY_SPREADS 4.5
#define QUALITY_BLUR 0.6  /* Counts an image as blurred below this fraction of its neighbours' sharpness. */
#define QUALITY_STOPS 1.0 /* Bounds the difference to the neighbours' light from below, in stops. */
/* Limits the fraction of the finest detail of a blurred image, in fractions of the neighbours': a plain
 * surface has little detail, but it is fine. */
#define QUALITY_FINE 0.85
/* Keeps the logarithm and division from 0, since an image of one colour has no detail. */
#define QUALITY_TINY 1e-9
#define QUALITY_DARKEST 1.0 /* Keeps the logarithm from 0 for a black image, in units of 255 squared. */
/* Reports an image from this fraction of pixels on that are white or black beyond the neighbours'. */
#define QUALITY_CLIPPED 0.25

struct quality {
    double sharpness, fine;     /* from quality_sharpness */
    double light, white, black; /* mean square of the values, as linear light; fractions of clipped pixels */
    int known;
    double finer, whiter, blacker; /* compared with the neighbours: quotient, differences */
};

/* ---------------- neighbours */

/* Returns the distance of two cameras in extents, plus how differently they look: 2 for opposite ways. */
static double quality_distance(const oxl_scene *scene, int a, int b)
{
    const oxl_camera *x = &oxl_scene_view(scene, a)->camera, *y = &oxl_scene_view(scene, b)->camera;
    double p[3], q[3], square = 0, along = 0;
    camera_position(x, p);
    camera_position(y, q);
    for (int i = 0; i < 3; i++) {
        square += (p[i] - q[i]) * (p[i] - q[i]);
        along += x->rotation[6 + i] * y->rotation[6 + i];
    }
    return sqrt(square) / oxl_scene_extent(scene) + 1 - along;
}

OXL_INTERNAL int quality_nearest(const oxl_scene *scene, const int *view, int count, int of,
                                 int out[QUALITY_NEIGHBOURS])
{
    double apart[QUALITY_NEIGHBOURS];
    int found = 0;
    for (int i = 0; i < count; i++) {
        const double d = i == of ? 0 : quality_distance(scene, view[of], view[i]);
        int at = found;
        if (i == of || (found == QUALITY_NEIGHBOURS && d >= apart[found - 1])) continue;
        if (found < QUALITY_NEIGHBOURS) found++;
        else at--;
        for (; at > 0 && apart[at - 1] > d; at--) apart[at] = apart[at - 1], out[at] = out[at - 1];
        apart[at] = d;
        out[at] = i;
    }
    return found;
}

/* ---------------- one image */

/* Returns the sharpness, independent of exposure: the mean absolute second difference of the green channel
 * over the channel's mean, along the axis where it is less, since motion blurs one axis. fine: this
 * difference over that of pixels 2 px apart, which blur lowers and a plain surface does not; or NULL. */
static double quality_sharpness(const struct training_image *image, double *fine)
{
    const size_t w = (size_t)image->width, h = (size_t)image->height;
    uint64_t second[2][2] = {{0}}, sum = 0; /* along x and y; 1 and 2 px apart */
    int axis;
    for (size_t y = 2; y + 2 < h; y++)
        for (size_t x = 2; x + 2 < w; x++) {
            const uint8_t *g = image->rgb + w * h + y * w + x;
            if (image->mask && !image->mask[y * w + x]) continue;
            for (int k = 0; k < 2; k++) {
                const ptrdiff_t d = k ? (ptrdiff_t)w : 1;
                second[k][0] += (uint64_t)abs(2 * g[0] - g[-d] - g[d]);
                second[k][1] += (uint64_t)abs(2 * g[0] - g[-2 * d] - g[2 * d]);
            }
            sum += g[0];
        }
    axis = second[1][0] < second[0][0];
    if (fine) *fine = second[axis][1] ? (double)second[axis][0] / (double)second[axis][1] : 0;
    return sum ? (double)second[axis][0] / (double)sum : 0;
}

static struct quality quality_measure(const struct training_image *image)
{
    const size_t pixels = (size_t)image->width * (size_t)image->height;
    uint64_t counted = 0, squares = 0, white = 0, black = 0;
    double sharpness, fine = 0;
    for (size_t i = 0; i < pixels; i++) {
        const unsigned r = image->rgb[i], g = image->rgb[pixels + i], b = image->rgb[2 * pixels + i];
        if (image->mask && !image->mask[i]) continue;
        counted++;
        squares += r * r + g * g + b * b;
        white += OXL_MAX(r, OXL_MAX(g, b)) >= QUALITY_WHITE;
        black += OXL_MAX(r, OXL_MAX(g, b)) <= QUALITY_BLACK;
    }
    if (counted == 0) return (struct quality){0};
    sharpness = quality_sharpness(image, &fine);
    return (struct quality){.sharpness = sharpness,
                            .fine = fine,
                            .light = (double)squares / (3.0 * (double)counted),
                            .white = (double)white / (double)counted,
                            .black = (double)black / (double)counted,
                            .known = 1};
}

/* ---------------- all of them */

struct quality_check {
    oxl_context *ctx;
    const int *view; /* (count) views that can be read */
    struct quality *image;
    double *sharp, *light, *work; /* (count) log ratios to the neighbours' medians; scratch */
    int count;
};

static double quality_median(const struct quality_check *q, const int *near, int neighbours, size_t member)
{
    double value[QUALITY_NEIGHBOURS];
    for (int k = 0; k < neighbours; k++)
        value[k] = *(const double *)((const char *)&q->image[near[k]] + member);
    return stats_select(value, (size_t)neighbours, 0.5);
}

/* Returns the distance from the median of all ratios from which on a view is an outlier, at least
 * `least`. *middle: the median. */
static double quality_limit(const struct quality_check *q, const double *ratio, double least, double *middle)
{
    return OXL_MAX(least, QUALITY_SPREADS * stats_spread(ratio, (size_t)q->count, q->work, middle));
}

/* Warns once of the views of a kind, the worst first. by: (count) size of the
 * deviation; 0: not of this kind. */
static int quality_report(const struct quality_check *q, const oxl_scene *scene, double *by, const char *kind,
                          const char *fix)
{
    struct text names = {.ctx = q->ctx};
    int found = 0;
    for (int i = 0; i < q->count; i++) found += by[i] > 0;
    for (int k = 0; k < OXL_MIN(found, (int)QUALITY_NAMED); k++) {
        int worst = 0;
        for (int i = 1; i < q->count; i++)
            if (by[i] > by[worst]) worst = i;
        text_add(&names, "%s%s", k ? ", " : "", oxl_scene_view(scene, q->view[worst])->name);
        by[worst] = 0;
    }
    if (found > QUALITY_NAMED) text_add(&names, " and %d more", found - QUALITY_NAMED);
    if (found > 0 && !names.failed)
        oxl_log(q->ctx, OXL_LOG_WARNING, "%d image%s %s than the images beside %s: %s\nfix: %s", found,
                found > 1 ? "s are" : " is", kind, found > 1 ? "them" : "it", names.data, fix);
    text_free(&names);
    return found;
}

/* Compares each view with its neighbours. Dark or bright images are not reported as blurred, too. */
static void quality_compare(const struct quality_check *q, const oxl_scene *scene, oxl_survey *s)
{
    double sharp_middle, light_middle, sharp_limit, light_limit;
    double *dark = q->work, *bright = q->light, *blurred = q->sharp;
    for (int i = 0; i < q->count; i++) {
        int near[QUALITY_NEIGHBOURS];
        const int n = quality_nearest(scene, q->view, q->count, i, near);
        q->sharp[i] =
            vecmath_log((q->image[i].sharpness + QUALITY_TINY) /
                        (quality_median(q, near, n, offsetof(struct quality, sharpness)) + QUALITY_TINY));
        q->light[i] =
            vecmath_log((q->image[i].light + QUALITY_DARKEST) /
                        (quality_median(q, near, n, offsetof(struct quality, light)) + QUALITY_DARKEST));
        q->image[i].finer = q->image[i].fine /
                            OXL_MAX(quality_median(q, near, n, offsetof(struct quality, fine)), QUALITY_TINY);
        q->image[i].whiter = q->image[i].white - quality_median(q, near, n, offsetof(struct quality, white));
        q->image[i].blacker = q->image[i].black - quality_median(q, near, n, offsetof(struct quality, black));
    }
    sharp_limit = quality_limit(q, q->sharp, -vecmath_log(QUALITY_BLUR), &sharp_middle);
    light_limit = quality_limit(q, q->light, QUALITY_STOPS * vecmath_log(2), &light_middle);
    for (int i = 0; i < q->count; i++) {
        const double light = q->light[i] - light_middle, sharp = q->sharp[i] - sharp_middle;
        dark[i] = light < -light_limit                    ? -light
                  : q->image[i].blacker > QUALITY_CLIPPED ? q->image[i].blacker
                                                          : 0;
        bright[i] = light > light_limit                    ? light
                    : q->image[i].whiter > QUALITY_CLIPPED ? q->image[i].whiter
                                                           : 0;
        blurred[i] =
            sharp < -sharp_limit && q->image[i].finer < QUALITY_FINE && dark[i] <= 0 && bright[i] <= 0
                ? -sharp
                : 0;
    }
    s->blurred = quality_report(q, scene, blurred, "less sharp",
                                "remove what is blurred from the COLMAP model, or take it again");
    s->badly_exposed =
        quality_report(q, scene, dark, "much darker",
                       "correct the exposure, or remove what cannot be corrected from the COLMAP model") +
        quality_report(q, scene, bright, "much brighter",
                       "correct the exposure, or remove what cannot be corrected from the COLMAP model");
}

OXL_INTERNAL oxl_result quality_check(oxl_context *ctx, oxl_scene *scene, oxl_survey *s)
{
    const int views = oxl_scene_view_count(scene);
    int *view = oxl_alloc(ctx, (size_t)views + 1, sizeof *view),
        *list = oxl_alloc(ctx, (size_t)views + 1, sizeof *list);
    struct quality_check q = {.ctx = ctx, .view = view};
    oxl_result rc = OXL_OK;
    q.image = oxl_alloc(ctx, (size_t)views + 1, sizeof *q.image);
    q.sharp = oxl_alloc(ctx, (size_t)views + 1, sizeof *q.sharp);
    q.light = oxl_alloc(ctx, (size_t)views + 1, sizeof *q.light);
    q.work = oxl_alloc(ctx, (size_t)views + 1, sizeof *q.work);
    if (!view || !list || !q.image || !q.sharp || !q.light || !q.work) rc = OXL_ERR_MEMORY;
    for (int i = 0; rc == OXL_OK && i < views; i++) list[i] = i;
    for (int i = 0; i < views && rc == OXL_OK; i++) {
        const struct training_image *image;
        if ((rc = context_stopped(ctx)) != OXL_OK) break;
        scene_images_ahead(ctx, scene, list + i, views - i);
        image = scene_image(ctx, scene, i);
        /* Leaves unreadable images to lint_images. */
        if (!image && ctx->failed != OXL_ERR_INPUT) rc = ctx->failed;
        if (!image) continue;
        q.image[q.count] = quality_measure(image);
        if (q.image[q.count].known) view[q.count++] = i;
    }
    if (rc == OXL_OK && q.count >= QUALITY_MIN) quality_compare(&q, scene, s);
    OXL_FREE(ctx, view, list, q.image, q.sharp, q.light, q.work);
    return rc;
}
