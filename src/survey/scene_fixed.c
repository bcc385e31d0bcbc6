/* scene_fixed.c - finds the pixels that show the same in all images of a camera, wherever it is: the edge of
 * a lens port, borders of undistorted images, bars, text, a mount. They are no part of the scene, so they are
 * masked in training and in metrics.
 *
 * Of reduced images of a camera, a pixel is fixed where its values differ far less from image to image than
 * those of most pixels, or where their median stands out from its surroundings: views of a scene average its
 * detail out, not that of text or of a sharp shadow. Regions of fixed pixels count if they end in an edge: a
 * plain background ends at an outline that moves, and light falls off slowly. A bright region along the
 * whole upper side is the sky, unless it reaches the lower side, too.
 *
 * Invariant: a function of the survey's files alone, whatever the size of training images.
 */
#include "scene.h"

enum {
    FIXED_VIEWS = 24,         /* most images of a camera that are compared */
    FIXED_FEWEST = 8,         /* least images */
    FIXED_DECODE = 100000000, /* px; images of more in all are compared in smaller numbers */
    FIXED_SIDE = 480,         /* px; longer side of the reduced images */
    FIXED_NEAR = 6,           /* px; distance from a region at which it ends in an edge */
    FIXED_AROUND = 15,        /* px; surroundings of a pixel, to each side, */
    FIXED_STEP = 3,           /* of which every so many count */
    FIXED_GROW = 3,           /* px by which regions grow: their border is blurred by reduction and by JPEG */
    FIXED_REGION = 6,         /* least pixels of a region */
    FIXED_VARIED = 6,         /* least levels between images of most pixels: or the camera stands still */
    FIXED_STANDS = 20,        /* least levels by which a median stands out */
    FIXED_EDGE = 8,           /* least levels of a region's edge */
    FIXED_BRIGHT = 32,        /* least levels of the sky */
    FIXED_LEVELS = 256        /* levels of a pixel */
};
/* Lists the most spread of a fixed pixel between images, the least of an edge: fractions of the median
 * spread. Of six surveys, the least spread of a thousandth of the pixels is 0.28 to 0.5 of it. */
#define FIXED_STILL 0.15
#define FIXED_EDGE_SPREADS 0.25
/* Bounds how far a median stands out, in standard deviations of all that do by chance: 24 real views have up
 * to 8, none with less than this fraction of the spread of their surroundings. */
#define FIXED_SIGMAS 5.0
#define FIXED_DAMPED 0.75
#define FIXED_TOP 0.9 /* Bounds the fraction of the upper side along which the sky is. */

struct fixed {
    int width, height, views; /* views: compared */
    uint8_t *value;           /* (pixels, FIXED_VIEWS) grey levels, ascending */
    uint8_t *median, *spread; /* (pixels) over the images; without an eighth at either end */
    uint8_t *flag;            /* (pixels) FIXED_* below */
    int *region;              /* (pixels) of a region, in the order in which they are found */
    int typical;              /* median spread */
};
enum { FIXED_NOT, FIXED_MASKED, FIXED_CANDIDATE, FIXED_VISITED, FIXED_FOUND };

/* ---------------- values over the images */

/* Inserts the image's grey levels among the sorted ones of each pixel. Leaves out an unreadable image. */
static oxl_result fixed_add_image(oxl_context *ctx, const oxl_scene *scene, int view, struct fixed *f)
{
    const size_t pixels = (size_t)f->width * f->height;
    struct training_image image;
    const oxl_result rc = scene_load_small(ctx, scene, view, f->width, f->height, &image);
    if (rc != OXL_OK) return scene_lacks_image(rc) ? OXL_OK : rc;
    for (size_t i = 0; i < pixels; i++) {
        uint8_t *value = f->value + i * FIXED_VIEWS;
        const uint8_t grey =
            (uint8_t)((image.rgb[i] + 2 * image.rgb[pixels + i] + image.rgb[2 * pixels + i]) / 4);
        int at = f->views;
        for (; at > 0 && value[at - 1] > grey; at--) value[at] = value[at - 1];
        value[at] = grey;
        if (image.mask && !image.mask[i]) f->flag[i] = FIXED_MASKED;
    }
    f->views++;
    image_training_free(ctx, &image);
    return OXL_OK;
}

/* Returns the median of levels by their numbers. */
static int fixed_middle(const int number[FIXED_LEVELS])
{
    int all = 0, sum = 0, level = 0;
    for (int i = 0; i < FIXED_LEVELS; i++) all += number[i];
    while (level < FIXED_LEVELS - 1 && 2 * (sum += number[level]) < all) level++;
    return level;
}

/* Sets median and spread, and their typical value. */
static void fixed_measure(struct fixed *f)
{
    const int cut = f->views / 8;
    int number[FIXED_LEVELS] = {0};
    for (int i = 0; i < f->width * f->height; i++) {
        const uint8_t *value = f->value + (size_t)i * FIXED_VIEWS;
        f->median[i] = value[f->views / 2];
        f->spread[i] = (uint8_t)(value[f->views - 1 - cut] - value[cut]);
        number[f->spread[i]] += f->flag[i] == FIXED_NOT;
    }
    f->typical = fixed_middle(number);
}

/* ---------------- fixed pixels */

/* Returns the place of the pixel that is (dx, dy) from another; -1: it is outside. */
static int fixed_beside(const struct fixed *f, int at, int dx, int dy)
{
    const int x = at % f->width + dx, y = at / f->width + dy;
    return x >= 0 && y >= 0 && x < f->width && y < f->height ? y * f->width + x : -1;
}

/* Returns the mean of a plane around a pixel. */
static double fixed_mean(const struct fixed *f, const uint8_t *plane, int at)
{
    int sum = 0, count = 0;
    for (int dy = -FIXED_AROUND; dy <= FIXED_AROUND; dy += FIXED_STEP)
        for (int dx = -FIXED_AROUND; dx <= FIXED_AROUND; dx += FIXED_STEP) {
            const int to = fixed_beside(f, at, dx, dy);
            if (to >= 0) sum += plane[to], count++;
        }
    return (double)sum / count;
}

/* Marks pixels that vary too little, or whose median stands out from the mean of its surroundings. */
static void fixed_mark(struct fixed *f)
{
    const int count = f->width * f->height;
    int number[FIXED_LEVELS] = {0}, stands;
    for (int i = 0; i < count; i++)
        if (f->flag[i] == FIXED_NOT) number[(int)fabs(f->median[i] - fixed_mean(f, f->median, i))]++;
    stands = OXL_MAX(FIXED_STANDS, (int)(FIXED_SIGMAS * 1.48 * (fixed_middle(number) + 0.5)));
    for (int i = 0; i < count; i++)
        if (f->flag[i] == FIXED_NOT && (f->spread[i] <= FIXED_STILL * f->typical ||
                                        (fabs(f->median[i] - fixed_mean(f, f->median, i)) > stands &&
                                         f->spread[i] < FIXED_DAMPED * fixed_mean(f, f->spread, i))))
            f->flag[i] = FIXED_CANDIDATE;
}

/* ---------------- regions */

/* Lists the pixels of a candidate's region in f->region; returns their number. */
static int fixed_fill(struct fixed *f, int from)
{
    int count = 1;
    f->region[0] = from;
    f->flag[from] = FIXED_VISITED;
    for (int at = 0; at < count; at++)
        for (int k = 0; k < 9; k++) {
            const int to = fixed_beside(f, f->region[at], k % 3 - 1, k / 3 - 1);
            if (to < 0 || f->flag[to] != FIXED_CANDIDATE) continue;
            f->flag[to] = FIXED_VISITED;
            f->region[count++] = to;
        }
    return count;
}

/* Returns the greatest difference of the medians of a pixel and of eight around it that are not fixed; -1:
 * the pixel is not at the region's edge. */
static int fixed_edge(const struct fixed *f, int at)
{
    int most = -1, borders = 0;
    for (int k = 0; k < 9; k++) {
        const int dx = k % 3 - 1, dy = k / 3 - 1, far = dx && dy ? FIXED_NEAR * 2 / 3 : FIXED_NEAR,
                  next = fixed_beside(f, at, dx, dy), to = fixed_beside(f, at, far * dx, far * dy);
        borders |= next >= 0 && f->flag[next] == FIXED_NOT;
        if (to >= 0 && f->flag[to] == FIXED_NOT) most = OXL_MAX(most, abs(f->median[to] - f->median[at]));
    }
    return borders ? most : -1;
}

/* Returns 1 if the region of `count` pixels in f->region is no part of the scene. */
static int fixed_accepts(const struct fixed *f, int count)
{
    int number[FIXED_LEVELS] = {0}, top = 0, bottom = 0;
    double level = 0;
    for (int i = 0; i < count; i++) {
        const int at = f->region[i], e = fixed_edge(f, at);
        if (e >= 0) number[e]++;
        top += at < f->width, bottom += at >= f->width * (f->height - 1);
        level += f->median[at] / (double)count;
    }
    return count >= FIXED_REGION &&
           fixed_middle(number) >= OXL_MAX(FIXED_EDGE, FIXED_EDGE_SPREADS * f->typical) &&
           !(top > FIXED_TOP * f->width && bottom == 0 && level >= FIXED_BRIGHT);
}

/* Makes the mask, black where regions are found and around them; data NULL: there are none. Returns the
 * fraction of black pixels. */
static double fixed_make_mask(struct fixed *f, uint8_t *mask)
{
    const int count = f->width * f->height, side = 2 * FIXED_GROW + 1;
    int black = 0;
    memset(mask, 255, (size_t)count);
    for (int i = 0; i < count; i++) {
        const int size = f->flag[i] == FIXED_CANDIDATE ? fixed_fill(f, i) : 0,
                  fixed = size > 0 && fixed_accepts(f, size);
        for (int k = 0; k < size && fixed; k++) f->flag[f->region[k]] = FIXED_FOUND;
    }
    for (int i = 0; i < count; i++)
        for (int k = 0; k < side * side && f->flag[i] == FIXED_FOUND; k++) {
            const int to = fixed_beside(f, i, k % side - FIXED_GROW, k / side - FIXED_GROW);
            if (to >= 0) mask[to] = 0;
        }
    for (int i = 0; i < count; i++) black += mask[i] == 0;
    return (double)black / count;
}

/* ---------------- cameras */

/* Compares `wanted` of the views of a group, evenly. view: (count) its views. *share: fraction of the pixels
 * that are fixed. */
static oxl_result fixed_search(oxl_context *ctx, const oxl_scene *scene, const int *view, int count,
                               int wanted, struct pixels *out, double *share)
{
    const oxl_camera *c = &scene->view[view[0]].camera;
    const double file = sqrt(scene_file_pixels(scene, view[0]) / c->width / c->height),
                 factor = OXL_MIN((double)FIXED_SIDE / OXL_MAX(c->width, c->height), OXL_MAX(1, file));
    struct fixed f = {.width = OXL_MAX(1, (int)floor(c->width * factor + 0.5)),
                      .height = OXL_MAX(1, (int)floor(c->height * factor + 0.5))};
    const size_t pixels = (size_t)f.width * f.height;
    oxl_result rc = OXL_OK;
    f.value = oxl_calloc(ctx, pixels, FIXED_VIEWS + 3);
    f.region = oxl_alloc(ctx, pixels, sizeof *f.region);
    *out = (struct pixels){f.width, f.height, 1, oxl_alloc(ctx, pixels, 1)};
    if (!f.value || !f.region || !out->data) rc = OXL_ERR_MEMORY;
    else f.median = f.value + FIXED_VIEWS * pixels, f.spread = f.median + pixels, f.flag = f.spread + pixels;
    for (int k = 0; k < wanted && rc == OXL_OK; k++) {
        rc = context_stopped(ctx);
        if (rc == OXL_OK) rc = fixed_add_image(ctx, scene, view[(int64_t)k * count / wanted], &f);
    }
    if (rc == OXL_OK && f.views >= FIXED_FEWEST) fixed_measure(&f);
    if (f.typical >= FIXED_VARIED) fixed_mark(&f), *share = fixed_make_mask(&f, out->data);
    if (!(*share > 0)) oxl_free(ctx, out->data), out->data = NULL;
    OXL_FREE(ctx, f.value, f.region);
    return rc;
}

/* Groups the cameras: those with fewer than FIXED_FEWEST views are with others like them that have images of
 * their size. fixed_of: first camera of each camera's group. Returns the number of groups. */
static int fixed_group(oxl_scene *scene, int *views)
{
    const struct colmap_camera *c = scene->colmap.camera;
    int groups = 0;
    for (int v = 0; v < scene->view_count; v++) views[scene->source[v].camera]++;
    for (int i = 0; i < (int)scene->colmap.camera_count; i++) {
        int other = 0;
        while (other < i && (views[i] >= FIXED_FEWEST || views[other] >= FIXED_FEWEST ||
                             c[i].width != c[other].width || c[i].height != c[other].height))
            other++;
        scene->fixed_of[i] = other;
        groups += other == i;
    }
    return groups;
}

OXL_INTERNAL oxl_result scene_find_fixed(oxl_context *ctx, oxl_scene *scene)
{
    const size_t cameras = scene->colmap.camera_count;
    int *views = oxl_calloc(ctx, cameras + 1, sizeof *views),
        *view = oxl_alloc(ctx, (size_t)scene->view_count + 1, sizeof *view), groups = 0, affected = 0;
    double masked = 0;
    oxl_result rc = OXL_OK;
    scene->fixed = oxl_calloc(ctx, cameras + 1, sizeof *scene->fixed);
    scene->fixed_of = oxl_alloc(ctx, cameras + 1, sizeof *scene->fixed_of);
    if (!views || !view || !scene->fixed || !scene->fixed_of) rc = OXL_ERR_MEMORY;
    if (rc == OXL_OK) groups = fixed_group(scene, views);
    for (size_t i = 0; i < cameras && rc == OXL_OK; i++) {
        double share = 0;
        int count = 0, most;
        for (int v = 0; v < scene->view_count; v++)
            if (scene->fixed_of[scene->source[v].camera] == (int)i) view[count++] = v;
        if (count < FIXED_FEWEST) continue;
        most = (int)(FIXED_DECODE / groups / OXL_MAX(scene_file_pixels(scene, view[0]), 1));
        most = OXL_MIN(OXL_CLAMP(most, (int)FIXED_FEWEST, (int)FIXED_VIEWS), count);
        rc = fixed_search(ctx, scene, view, count, most, &scene->fixed[i], &share);
        masked += count * share;
        if (share > 0) affected += count;
    }
    scene->stats.fixed = masked / OXL_MAX(scene->view_count, 1);
    if (rc == OXL_OK && affected)
        oxl_log(ctx, OXL_LOG_WARNING,
                "%d images show the same at %.1f %% of their pixels, wherever the camera is (a lens port, "
                "borders, text, a mount): training and metrics ignore these pixels\nfix: none is needed; "
                "--auto-mask off if they are a part of the scene",
                affected, 100 * masked / affected);
    OXL_FREE(ctx, views, view);
    return rc;
}
