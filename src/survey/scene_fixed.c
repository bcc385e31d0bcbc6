/* scene_fixed.c - finds the pixels that show the same in all images of a camera, wherever it is: the edge of
 * a lens port, borders of undistorted images, bars, text, a mount. They are no part of the scene, so they are
 * masked in training and in metrics.
 *
 * Of reduced images of a camera, a pixel is fixed where its values differ far less from image to image than
 * those of most pixels, or where their median stands out from its surroundings: views of a scene average its
 * detail out, not that of text or of a sharp shadow. Regions of fixed pixels count if they end in an edge: a
 * plain background ends at an outline that moves, and light falls off slowly. A bright region along the
 * whole upper side is the sky.
 *
 * Invariant: a function of the survey's files alone, whatever the size of training images.
 */
#include "scene.h"
#include "scene_alpha.h"

enum {
    FIXED_VIEWS = 24,         /* most images of a camera that are compared */
    FIXED_FEWEST = 8,         /* least images */
    FIXED_DECODE = 100000000, /* px; images of more in all are compared in smaller numbers */
    FIXED_SIDE = 480,         /* px; longer side of the reduced images */
    FIXED_NEAR = 6,           /* px; surroundings of a pixel, to each side: of a thin stroke, */
    FIXED_FAR = 24,           /* of a shadow */
    FIXED_CLOSE = 6,          /* px by which regions grow, which closes gaps, and then */
    FIXED_OPEN = 4,           /* shrink: their border is blurred by reduction and by JPEG */
    FIXED_REGION = 6,         /* least pixels of a region */
    FIXED_VARIED = 6,         /* least levels between images of most pixels: or the camera stands still */
    FIXED_STANDS = 20,        /* least levels by which a median stands out */
    FIXED_EDGE = 8,           /* least levels of a region's edge */
    FIXED_BRIGHT = 32         /* least levels of the sky */
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
    oxl_context *ctx;
    const oxl_scene *scene;
    int view[FIXED_VIEWS], views; /* compared */
    int width, height;
    uint8_t *value;           /* (pixels, FIXED_VIEWS) grey levels, ascending in the end */
    uint8_t *median, *spread; /* (pixels) over the images; without an eighth at either end */
    uint8_t *flag;            /* (pixels) FIXED_* below */
    int *medians, *spreads;   /* (height + 1, width + 1) their sums */
    int *stack;               /* (pixels) of a region, in the order in which they are found */
    double typical;           /* median spread */
};
enum { FIXED_NOT, FIXED_MASKED, FIXED_CANDIDATE, FIXED_VISITED, FIXED_FOUND };

/* ---------------- values over the images */

/* Returns the camera of a view with reduced images. */
static oxl_camera fixed_camera(const struct fixed *f, int view)
{
    oxl_camera c = f->scene->view[view].camera;
    const double x = (double)f->width / c.width, y = (double)f->height / c.height;
    c.fx *= x, c.cx *= x, c.fy *= y, c.cy *= y;
    c.width = f->width, c.height = f->height;
    return c;
}

/* Inserts the image's grey levels among the sorted ones of each pixel. Leaves out an unreadable image. */
static oxl_result fixed_add_image(struct fixed *f, int view)
{
    const struct image_alpha alpha = scene_alpha(f->scene);
    const oxl_camera to = fixed_camera(f, view);
    const size_t pixels = (size_t)f->width * (size_t)f->height;
    struct training_image image = {0};
    char *mask = NULL;
    oxl_result rc = scene_mask_path(f->ctx, f->scene, view, &mask);
    if (rc == OXL_OK)
        rc = image_load_training(f->ctx, PATH(f->scene->images, "%s", f->scene->view[view].name), mask,
                                 &alpha, scene_source_camera(f->scene, view), &to, &image);
    oxl_free(f->ctx, mask);
    if (rc != OXL_OK) return rc == OXL_ERR_INPUT || rc == OXL_ERR_IO ? OXL_OK : rc;
    for (size_t i = 0; i < pixels; i++) {
        uint8_t *value = f->value + i * FIXED_VIEWS;
        const uint8_t grey =
            (uint8_t)((image.rgb[i] + 2 * image.rgb[pixels + i] + image.rgb[2 * pixels + i]) / 4);
        int at = f->views;
        for (; at > 0 && value[at - 1] > grey; at--) value[at] = value[at - 1];
        value[at] = grey;
        if (image.mask && !image.mask[i]) f->flag[i] = FIXED_MASKED;
    }
    f->view[f->views++] = view;
    image_training_free(f->ctx, &image);
    return OXL_OK;
}

/* Sets median and spread, and their typical value. */
static void fixed_measure(struct fixed *f)
{
    const int cut = f->views / 8, count = f->width * f->height;
    int histogram[256] = {0}, used = 0, sum = 0, level = 0;
    for (int i = 0; i < count; i++) {
        const uint8_t *value = f->value + (size_t)i * FIXED_VIEWS;
        f->median[i] = value[f->views / 2];
        f->spread[i] = (uint8_t)(value[f->views - 1 - cut] - value[cut]);
        if (f->flag[i] == FIXED_NOT) histogram[f->spread[i]]++, used++;
    }
    while (level < 255 && 2 * (sum += histogram[level]) < used) level++;
    f->typical = level;
}

/* ---------------- fixed pixels */

static int fixed_is_inside(const struct fixed *f, int x, int y)
{
    return x >= 0 && y >= 0 && x < f->width && y < f->height;
}

/* Sums a plane from the origin to each pixel. sum: (height + 1, width + 1) */
static void fixed_integrate(const struct fixed *f, const uint8_t *plane, int *sum)
{
    const int stride = f->width + 1;
    memset(sum, 0, (size_t)stride * sizeof *sum);
    for (int y = 0; y < f->height; y++) {
        int row = 0;
        sum[(y + 1) * stride] = 0;
        for (int x = 0; x < f->width; x++) {
            row += plane[y * f->width + x];
            sum[(y + 1) * stride + x + 1] = sum[y * stride + x + 1] + row;
        }
    }
}

/* Returns the mean within `radius` of a pixel. */
static double fixed_mean(const struct fixed *f, const int *sum, int at, int radius)
{
    const int x = at % f->width, y = at / f->width, stride = f->width + 1;
    const int left = OXL_MAX(0, x - radius), right = OXL_MIN(f->width, x + radius + 1);
    const int *top = sum + OXL_MAX(0, y - radius) * stride,
              *end = sum + OXL_MIN(f->height, y + radius + 1) * stride;
    return (double)(end[right] - end[left] - top[right] + top[left]) /
           ((right - left) * (double)((end - top) / stride));
}

/* Marks pixels whose median stands out from the mean of its surroundings. */
static void fixed_mark_standing(struct fixed *f, int radius)
{
    enum { LEVELS = 8 * 256 };
    const int count = f->width * f->height;
    int histogram[LEVELS] = {0}, used = 0, sum = 0, middle = 0;
    for (int i = 0; i < count; i++)
        if (f->flag[i] == FIXED_NOT)
            histogram[(int)(8 * fabs(f->median[i] - fixed_mean(f, f->medians, i, radius)))]++, used++;
    while (middle < LEVELS - 1 && 2 * (sum += histogram[middle]) < used) middle++;
    for (int i = 0; i < count; i++)
        if (f->flag[i] == FIXED_NOT && f->spread[i] < FIXED_DAMPED * fixed_mean(f, f->spreads, i, radius) &&
            fabs(f->median[i] - fixed_mean(f, f->medians, i, radius)) >
                OXL_MAX(FIXED_STANDS, FIXED_SIGMAS * 1.48 / 8 * middle))
            f->flag[i] = FIXED_CANDIDATE;
}

static void fixed_mark(struct fixed *f)
{
    for (int i = 0; i < f->width * f->height; i++)
        if (f->flag[i] == FIXED_NOT && f->spread[i] <= FIXED_STILL * f->typical) f->flag[i] = FIXED_CANDIDATE;
    fixed_integrate(f, f->median, f->medians);
    fixed_integrate(f, f->spread, f->spreads);
    fixed_mark_standing(f, FIXED_NEAR);
    fixed_mark_standing(f, FIXED_FAR);
}

/* ---------------- regions */

/* Lists the pixels of a candidate's region in f->stack; returns their number. */
static int fixed_fill(struct fixed *f, int from)
{
    int count = 1;
    f->stack[0] = from;
    f->flag[from] = FIXED_VISITED;
    for (int at = 0; at < count; at++)
        for (int k = 0; k < 9; k++) {
            const int x = f->stack[at] % f->width + k % 3 - 1, y = f->stack[at] / f->width + k / 3 - 1;
            if (!fixed_is_inside(f, x, y) || f->flag[y * f->width + x] != FIXED_CANDIDATE) continue;
            f->flag[y * f->width + x] = FIXED_VISITED;
            f->stack[count++] = y * f->width + x;
        }
    return count;
}

/* Returns the greatest difference of the medians of a pixel and of eight around it that are not fixed; -1:
 * the pixel is not at the region's edge. */
static int fixed_edge(const struct fixed *f, int at)
{
    const int x = at % f->width, y = at / f->width;
    int most = -1, borders = 0;
    for (int k = 0; k < 9; k++) {
        const int dx = k % 3 - 1, dy = k / 3 - 1, far = dx && dy ? FIXED_NEAR * 2 / 3 : FIXED_NEAR,
                  to = (y + far * dy) * f->width + x + far * dx;
        if (fixed_is_inside(f, x + dx, y + dy)) borders |= f->flag[(y + dy) * f->width + x + dx] == FIXED_NOT;
        if (fixed_is_inside(f, x + far * dx, y + far * dy) && f->flag[to] == FIXED_NOT)
            most = OXL_MAX(most, abs(f->median[to] - f->median[at]));
    }
    return borders ? most : -1;
}

/* Returns 1 if the region of `count` pixels in f->stack is no part of the scene. */
static int fixed_accepts(const struct fixed *f, int count)
{
    int edges[256] = {0}, edge = 0, border = 0, sum = 0, top = 0;
    double level = 0;
    for (int i = 0; i < count; i++) {
        const int at = f->stack[i], e = fixed_edge(f, at);
        if (e >= 0) edges[e]++, border++;
        top += at < f->width;
        level += f->median[at] / (double)count;
    }
    while (edge < 255 && 2 * (sum += edges[edge]) < border) edge++;
    if (count < FIXED_REGION || edge < OXL_MAX(FIXED_EDGE, FIXED_EDGE_SPREADS * f->typical)) return 0;
    return !(top > FIXED_TOP * f->width && level >= FIXED_BRIGHT);
}

/* Sets pixels within `radius` of one that has the value `from` to it. */
static void fixed_grow(const struct fixed *f, uint8_t from, int radius, const uint8_t *in, uint8_t *out)
{
    for (int y = 0; y < f->height; y++)
        for (int x = 0; x < f->width; x++)
            for (int j = OXL_MAX(0, y - radius); in[y * f->width + x] == from && j <= y + radius; j++)
                for (int i = OXL_MAX(0, x - radius); i <= x + radius; i++)
                    if (fixed_is_inside(f, i, j)) out[j * f->width + i] = from;
}

/* Makes the mask, black where regions were found, between and around them; data NULL: there are none. */
static oxl_result fixed_make_mask(const struct fixed *f, struct pixels *out)
{
    const size_t pixels = (size_t)f->width * (size_t)f->height;
    uint8_t *grown = f->value;
    if (!memchr(f->flag, FIXED_FOUND, pixels)) return OXL_OK;
    *out = (struct pixels){f->width, f->height, 1, oxl_alloc(f->ctx, pixels, 1)};
    if (!out->data) return OXL_ERR_MEMORY;
    for (size_t i = 0; i < pixels; i++) grown[i] = out->data[i] = f->flag[i] == FIXED_FOUND ? 0 : 255;
    fixed_grow(f, 0, FIXED_CLOSE, out->data, grown);
    memcpy(out->data, grown, pixels);
    fixed_grow(f, 255, FIXED_OPEN, grown, out->data);
    return OXL_OK;
}

static oxl_result fixed_find_regions(struct fixed *f, struct pixels *out)
{
    const int count = f->width * f->height;
    fixed_measure(f);
    if (f->views < FIXED_FEWEST || f->typical < FIXED_VARIED) return OXL_OK;
    fixed_mark(f);
    for (int i = 0; i < count; i++) {
        const int size = f->flag[i] == FIXED_CANDIDATE ? fixed_fill(f, i) : 0;
        if (size && fixed_accepts(f, size))
            for (int k = 0; k < size; k++) f->flag[f->stack[k]] = FIXED_FOUND;
    }
    return fixed_make_mask(f, out);
}

/* ---------------- cameras */

/* Compares `wanted` of the views of a group, evenly. view: (count) its views. */
static oxl_result fixed_search(oxl_context *ctx, const oxl_scene *scene, const int *view, int count,
                               int wanted, struct pixels *out)
{
    const oxl_camera *c = &scene->view[view[0]].camera;
    const double longer = OXL_MAX(c->width, c->height),
                 most =
                     OXL_MAX(longer, sqrt(scene_file_pixels(scene, view[0]) / c->width / c->height) * longer),
                 factor = OXL_MIN(FIXED_SIDE, most) / longer;
    struct fixed f = {.ctx = ctx,
                      .scene = scene,
                      .width = OXL_MAX(1, (int)floor(c->width * factor + 0.5)),
                      .height = OXL_MAX(1, (int)floor(c->height * factor + 0.5))};
    const size_t pixels = (size_t)f.width * (size_t)f.height,
                 sums = ((size_t)f.width + 1) * ((size_t)f.height + 1);
    uint8_t *levels = oxl_calloc(ctx, pixels, FIXED_VIEWS + 3);
    int *numbers = oxl_alloc(ctx, 3 * sums, sizeof *numbers);
    oxl_result rc = levels && numbers ? OXL_OK : OXL_ERR_MEMORY;
    if (rc == OXL_OK) {
        f.value = levels, f.median = levels + FIXED_VIEWS * pixels;
        f.spread = f.median + pixels, f.flag = f.spread + pixels;
        f.medians = numbers, f.spreads = numbers + sums, f.stack = numbers + 2 * sums;
    }
    for (int k = 0; k < wanted && rc == OXL_OK; k++) {
        rc = context_stopped(ctx);
        if (rc == OXL_OK) rc = fixed_add_image(&f, view[(int64_t)k * count / wanted]);
    }
    if (rc == OXL_OK) rc = fixed_find_regions(&f, out);
    OXL_FREE(ctx, levels, numbers);
    return rc;
}

/* Groups the views: those of a camera, or, if they are fewer than FIXED_FEWEST, of all such cameras with
 * images of this size. group: (cameras) first camera of the camera's group. Returns the number of groups. */
static int fixed_group(const oxl_scene *scene, int *group, int *views)
{
    const size_t cameras = scene->colmap.camera_count;
    int groups = 0;
    for (size_t i = 0; i < cameras; i++) group[i] = (int)i;
    for (int v = 0; v < scene->view_count; v++) views[scene->source[v].camera]++;
    for (int v = 0; v < scene->view_count; v++) {
        const size_t own = scene->source[v].camera;
        const struct colmap_camera *c = &scene->colmap.camera[own];
        for (size_t i = 0; i < own && views[own] < FIXED_FEWEST && group[own] == (int)own; i++) {
            const struct colmap_camera *other = &scene->colmap.camera[i];
            if (views[i] && views[i] < FIXED_FEWEST && other->width == c->width && other->height == c->height)
                group[own] = group[i];
        }
    }
    for (size_t i = 0; i < cameras; i++) groups += views[i] > 0 && group[i] == (int)i;
    return groups;
}

static double fixed_share(const struct pixels *mask)
{
    const size_t pixels = (size_t)mask->width * (size_t)mask->height;
    size_t black = 0;
    for (size_t i = 0; i < pixels; i++) black += mask->data[i] == 0;
    return (double)black / (double)pixels;
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
    if (rc == OXL_OK) groups = fixed_group(scene, scene->fixed_of, views);
    for (size_t i = 0; i < cameras && rc == OXL_OK; i++) {
        int count = 0, most;
        for (int v = 0; v < scene->view_count; v++)
            if (scene->fixed_of[scene->source[v].camera] == (int)i) view[count++] = v;
        if (count < FIXED_FEWEST) continue;
        most = (int)(FIXED_DECODE / groups / OXL_MAX(scene_file_pixels(scene, view[0]), 1));
        most = OXL_MIN(OXL_CLAMP(most, (int)FIXED_FEWEST, (int)FIXED_VIEWS), count);
        rc = fixed_search(ctx, scene, view, count, most, &scene->fixed[i]);
        if (scene->fixed[i].data) masked += count * fixed_share(&scene->fixed[i]), affected += count;
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
