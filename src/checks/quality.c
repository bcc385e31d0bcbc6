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
/* Makes the median absolute deviation the standard deviation of a normal distribution. */
#define QUALITY_NORMAL 1.4826
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

enum quality_value { /* Lists what is measured of an image. */
                     QUALITY_SHARP,
                     QUALITY_FINE_DETAIL,
                     QUALITY_LIGHT,  /* mean square of the values, as linear light */
                     QUALITY_WHITES, /* fractions of clipped pixels */
                     QUALITY_BLACKS,
                     QUALITY_VALUES
};

/* ---------------- neighbours */

/* Returns the distance of two cameras in extents, plus how differently they look: 2 for opposite ways. */
static double quality_distance(const oxl_scene *scene, int a, int b)
{
    const oxl_camera *x = &scene->view[a].camera, *y = &scene->view[b].camera;
    double along = 0;
    for (int i = 0; i < 3; i++) along += x->rotation[6 + i] * y->rotation[6 + i];
    return camera_distance(x, y) / scene->extent + 1 - along;
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

/* Measures the sharpness, independent of exposure: the mean absolute second difference of the green channel
 * over the channel's mean, along the axis where it is less, since motion blurs one axis. Fine detail is this
 * difference over that of pixels 2 px apart, which blur lowers and a plain surface does not. */
static void quality_sharpness(const struct training_image *image, double out[QUALITY_VALUES])
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
    out[QUALITY_FINE_DETAIL] = (double)second[axis][0] / (double)OXL_MAX(second[axis][1], 1);
    out[QUALITY_SHARP] = (double)second[axis][0] / (double)OXL_MAX(sum, 1);
}

/* Returns 0 if all pixels are masked. */
static int quality_measure(const struct training_image *image, double out[QUALITY_VALUES])
{
    const size_t pixels = (size_t)image->width * (size_t)image->height;
    uint64_t counted = 0, squares = 0, white = 0, black = 0;
    for (size_t i = 0; i < pixels; i++) {
        const unsigned r = image->rgb[i], g = image->rgb[pixels + i], b = image->rgb[2 * pixels + i];
        if (image->mask && !image->mask[i]) continue;
        counted++;
        squares += r * r + g * g + b * b;
        white += OXL_MAX(r, OXL_MAX(g, b)) >= QUALITY_WHITE;
        black += OXL_MAX(r, OXL_MAX(g, b)) <= QUALITY_BLACK;
    }
    if (counted == 0) return 0;
    quality_sharpness(image, out);
    out[QUALITY_LIGHT] = (double)squares / (3.0 * (double)counted);
    out[QUALITY_WHITES] = (double)white / (double)counted;
    out[QUALITY_BLACKS] = (double)black / (double)counted;
    return 1;
}

/* ---------------- all of them */

struct quality_check {
    oxl_context *ctx;
    int *view, count;                                           /* (count) views that can be read */
    double (*value)[QUALITY_VALUES], (*beside)[QUALITY_VALUES]; /* (count) and medians of the neighbours */
    double *sharp, *light, *work; /* (count) log ratios to the neighbours' medians; scratch */
};

OXL_INTERNAL double quality_beside(const double *value, size_t stride, const int *near, int neighbours)
{
    double beside[QUALITY_NEIGHBOURS];
    for (int k = 0; k < neighbours; k++) beside[k] = value[stride * (size_t)near[k]];
    return stats_select(beside, (size_t)neighbours, 0.5);
}

OXL_INTERNAL double quality_spread(const double *value, size_t count, double *work, double *median)
{
    for (size_t i = 0; i < count; i++) work[i] = value[i];
    *median = stats_select(work, count, 0.5);
    for (size_t i = 0; i < count; i++) work[i] = fabs(value[i] - *median);
    return QUALITY_NORMAL * stats_select(work, count, 0.5);
}

/* Returns the distance from the median of all ratios from which on a view is an outlier, at least
 * `least`. *middle: the median. */
static double quality_limit(const struct quality_check *q, const double *ratio, double least, double *middle)
{
    return OXL_MAX(least, QUALITY_SPREADS * quality_spread(ratio, (size_t)q->count, q->work, middle));
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
        text_add(&names, "%s%s", k ? ", " : "", scene->view[q->view[worst]].name);
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
    static const char exposure[] = "correct the exposure, or remove these images from the COLMAP model";
    double sharp_middle, light_middle, sharp_limit, light_limit;
    double *dark = q->work, *bright = q->light, *blurred = q->sharp;
    for (int i = 0; i < q->count; i++) {
        int near[QUALITY_NEIGHBOURS];
        const int n = quality_nearest(scene, q->view, q->count, i, near);
        double *v = q->value[i], *beside = q->beside[i];
        for (int k = 0; k < QUALITY_VALUES; k++)
            beside[k] = quality_beside(q->value[0] + k, QUALITY_VALUES, near, n);
        q->sharp[i] = vecmath_log((v[QUALITY_SHARP] + QUALITY_TINY) / (beside[QUALITY_SHARP] + QUALITY_TINY));
        q->light[i] =
            vecmath_log((v[QUALITY_LIGHT] + QUALITY_DARKEST) / (beside[QUALITY_LIGHT] + QUALITY_DARKEST));
    }
    sharp_limit = quality_limit(q, q->sharp, -vecmath_log(QUALITY_BLUR), &sharp_middle);
    light_limit = quality_limit(q, q->light, QUALITY_STOPS * vecmath_log(2), &light_middle);
    for (int i = 0; i < q->count; i++) {
        const double *v = q->value[i], *beside = q->beside[i], light = q->light[i] - light_middle,
                     sharp = q->sharp[i] - sharp_middle, whiter = v[QUALITY_WHITES] - beside[QUALITY_WHITES],
                     blacker = v[QUALITY_BLACKS] - beside[QUALITY_BLACKS];
        dark[i] = light < -light_limit ? -light : blacker > QUALITY_CLIPPED ? blacker : 0;
        bright[i] = light > light_limit ? light : whiter > QUALITY_CLIPPED ? whiter : 0;
        blurred[i] =
            sharp < -sharp_limit && dark[i] <= 0 && bright[i] <= 0 &&
                    v[QUALITY_FINE_DETAIL] < QUALITY_FINE * OXL_MAX(beside[QUALITY_FINE_DETAIL], QUALITY_TINY)
                ? -sharp
                : 0;
    }
    s->blurred = quality_report(q, scene, blurred, "less sharp",
                                "remove the blurred images from the COLMAP model, or take them again");
    s->badly_exposed = quality_report(q, scene, dark, "much darker", exposure) +
                       quality_report(q, scene, bright, "much brighter", exposure);
}

OXL_INTERNAL oxl_result quality_check(oxl_context *ctx, oxl_scene *scene, oxl_survey *s)
{
    const size_t views = (size_t)scene->view_count + 1;
    int *list = oxl_alloc(ctx, 2 * views, sizeof *list);
    double *memory = oxl_alloc(ctx, (2 * QUALITY_VALUES + 3) * views, sizeof *memory);
    struct quality_check q = {.ctx = ctx};
    oxl_result rc = list && memory ? OXL_OK : OXL_ERR_MEMORY;
    const int count = rc == OXL_OK ? scene_views_of(scene, OXL_SPLIT_ALL, list) : 0;
    if (rc == OXL_OK) {
        q.view = list + views, q.sharp = memory, q.light = memory + views, q.work = memory + 2 * views;
        q.value = (double(*)[QUALITY_VALUES])(memory + 3 * views), q.beside = q.value + views;
    }
    for (int i = 0; i < count && rc == OXL_OK; i++) {
        const struct training_image *image;
        if ((rc = context_stopped(ctx)) != OXL_OK) break;
        scene_images_ahead(ctx, scene, list + i, count - i);
        image = scene_image(ctx, scene, i);
        /* Leaves unreadable images to lint_images. */
        if (!image && !scene_lacks_image(ctx->failed)) rc = ctx->failed;
        if (image && quality_measure(image, q.value[q.count])) q.view[q.count++] = i;
    }
    if (rc == OXL_OK && q.count >= QUALITY_MIN) quality_compare(&q, scene, s);
    OXL_FREE(ctx, list, memory);
    return rc;
}
