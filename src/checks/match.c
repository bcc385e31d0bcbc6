/* match.c - tells whether the images are those that the model was made from.
 *
 * A point's colour is the mean of what its images show there, so the brightness of an image at its points
 * correlates with their colours. Compared are differences to the nearest points of the image, limited to
 * MATCH_CLIP medians: light that varies smoothly (lamp, haze, exposure) drops out, and fish count little.
 * Median over the images of a survey: 0.3 to 0.9 where they belong together, 0.0 to 0.2 where they do not.
 * Each image is compared as it is, turned, mirrored, cropped, distorted, shifted, and at the points of
 * others.
 *
 * Invariant: a function of the scene; nothing that is trained changes.
 */
#include "checks.h"
#include "match.h"
#include "../survey/survey.h"
#include "../survey/tracks.h"

enum {
    MATCH_VIEWS = 256,   /* most images */
    MATCH_SIDE = 320,    /* px; longer side of the brightness that is compared */
    MATCH_OTHERS = 4,    /* number of other images whose points give the correlation by chance */
    MATCH_POINTS = 8192, /* most points to project if there are no tracks */
    MATCH_NAMED = 3,     /* images that are named */
    MATCH_MANY = 12      /* images from which on MATCH_ALWAYS decides */
};
#define MATCH_CLIP 1.5    /* Limits differences, in medians of their absolute values. */
#define MATCH_BORDER 0.01 /* Leaves out points in the border of an image, as a fraction of its sides. */
/* Accepts another map with this gain of the median correlation, if it wins in the fraction
 * MATCH_WINS of the images. */
#define MATCH_BETTER 0.06
#define MATCH_WINS 0.7    /* Bounds the fraction of the images in which a map wins from below. */
#define MATCH_STEADY 0.03 /* Bounds the gain of another map from below in any case. */
/* Accepts another map that wins in this fraction of the images whatever its gain, with
 * MATCH_MANY images or more. */
#define MATCH_ALWAYS 0.9
/* Looks at an image below this fraction of the correlation that a tenth of the images exceeds. */
#define MATCH_SUSPECT 0.5
/* Requires this gain of an image that is looked at, turned or at another place. */
#define MATCH_ELSEWHERE 0.25
#define MATCH_DEVIATIONS 4.0 /* Requires an image that fits nowhere to be so many spreads below the median. */
#define MATCH_NOISE 3.0      /* Bounds what chance gives, in standard deviations. */
/* Bounds the correlation of the best of hundreds of places from below, in standard deviations. */
#define MATCH_SIGNIFICANT 5.0
/* Requires an image that fits nowhere to be below this fraction of the median correlation. */
#define MATCH_LOW 0.3

/* ---------------- maps */

static void match_add_map(struct match *w, enum match_kind kind, const double m[6], double radial)
{
    struct match_map *map = &w->map[w->maps++];
    *map = (struct match_map){.kind = kind, .radial = radial};
    memcpy(map->m, m, sizeof map->m);
}

/* Adds the map of a cropped image: `size` of its sides is left, from `left` and `top` on. */
static void match_add_crop(struct match *w, double size, double left, double top)
{
    match_add_map(w, MATCH_CROPPED, (const double[6]){1 / size, 0, -left / size, 0, 1 / size, -top / size},
                  0);
}

static void match_fill_maps(struct match *w)
{
    static const double plain[6] = {1, 0, 0, 0, 1, 0}, half[6] = {-1, 0, 1, 0, -1, 1};
    static const double quarter[2][6] = {{0, 1, 0, -1, 0, 1}, {0, -1, 1, 1, 0, 0}};
    static const double mirror[2][6] = {{-1, 0, 1, 0, 1, 0}, {1, 0, 0, 0, -1, 1}};
    static const double left[] = {0.97, 0.94, 0.9, 0.8, 0.65}, more[] = {1.03, 1.06, 1.12};
    static const double lens[] = {-0.4, -0.3, -0.2, -0.13, -0.08, 0.08, 0.15, 0.25, 0.4};
    match_add_map(w, MATCH_AS_IS, plain, 0);
    match_add_map(w, MATCH_TURNED, half, 0);
    for (int i = 0; i < 2; i++) match_add_map(w, MATCH_QUARTER, quarter[i], 0);
    for (int i = 0; i < 2; i++) match_add_map(w, MATCH_MIRRORED, mirror[i], 0);
    for (size_t i = 0; i < OXL_COUNT(left); i++)
        for (int k = 0; k < 5; k++) /* Takes the corners, then the middle. */
            match_add_crop(w, left[i], (1 - left[i]) * (k == 4 ? 0.5 : k % 2),
                           (1 - left[i]) * (k == 4 ? 0.5 : k / 2));
    for (size_t i = 0; i < OXL_COUNT(more); i++)
        match_add_crop(w, more[i], 0.5 * (1 - more[i]), 0.5 * (1 - more[i]));
    for (size_t i = 0; i < OXL_COUNT(lens); i++) match_add_map(w, MATCH_DISTORTED, plain, lens[i]);
    for (int i = 0; i < 8; i++) {
        const double by[2] = {0.02, 0.04}, d = by[i / 4], sign = i & 1 ? 1 : -1;
        match_add_map(w, MATCH_SHIFTED,
                      (const double[6]){1, 0, i & 2 ? sign * d : 0, 0, 1, i & 2 ? 0 : sign * d}, 0);
    }
}

static void match_apply(const struct match_map *map, const double focal[2], double u, double v, double out[2])
{
    out[0] = map->m[0] * u + map->m[1] * v + map->m[2];
    out[1] = map->m[3] * u + map->m[4] * v + map->m[5];
    if (map->radial != 0) {
        const double x = (out[0] - 0.5) / focal[0], y = (out[1] - 0.5) / focal[1],
                     factor = 1 + map->radial * (x * x + y * y);
        out[0] = 0.5 + (out[0] - 0.5) * factor;
        out[1] = 0.5 + (out[1] - 0.5) * factor;
    }
}

/* ---------------- points of an image */

/* Computes the difference of each value to the mean of its near points', limited to MATCH_CLIP medians; NaN:
 * not known. work: (count) scratch. */
static void match_differences(const struct match_layout *l, const float *value, double *work, float *out)
{
    size_t known = 0;
    double limit;
    for (int k = 0; k < l->count; k++) {
        double sum = 0;
        int n = 0;
        for (int i = 0; i < MATCH_NEAR; i++) {
            const float near = value[l->near[k][i]];
            if (!isnan(near)) sum += near, n++;
        }
        out[k] = n && !isnan(value[k]) ? (float)(value[k] - sum / n) : NAN;
        if (!isnan(out[k])) work[known++] = fabs(out[k]);
    }
    limit = MATCH_CLIP * stats_select(work, known, 0.5);
    for (int k = 0; k < l->count; k++)
        if (!isnan(out[k])) out[k] = (float)OXL_CLAMP(out[k], -limit, limit);
}

/* Finds the nearest points of each point, by insertion into a short sorted list. */
static void match_find_near(struct match_layout *l)
{
    for (int k = 0; k < l->count; k++) {
        float apart[MATCH_NEAR];
        int found = 0;
        for (int i = 0; i < l->count; i++) {
            const float x = l->u[i] - l->u[k], y = l->v[i] - l->v[k], d = x * x + y * y;
            int at = found;
            if (i == k || (found == MATCH_NEAR && d >= apart[found - 1])) continue;
            if (found < MATCH_NEAR) found++;
            else at--;
            for (; at > 0 && apart[at - 1] > d; at--)
                apart[at] = apart[at - 1], l->near[k][at] = l->near[k][at - 1];
            apart[at] = d;
            l->near[k][at] = (uint8_t)i;
        }
    }
}

/* Replaces the colours of a layout by their differences. */
static void match_finish_layout(struct match_layout *l, double *work)
{
    float difference[MATCH_SAMPLES];
    match_find_near(l);
    match_differences(l, l->colour, work, difference);
    memcpy(l->colour, difference, sizeof difference);
}

static int match_is_coloured(const struct match_layout *l)
{
    for (int k = 0; k < l->count; k++)
        if (l->colour[k] != 0) return 1;
    return 0;
}

static void match_add_point(struct match_layout *l, const oxl_camera *c, const double pixel[2],
                            const struct colmap_point *point)
{
    const double u = pixel[0] / c->width, v = pixel[1] / c->height;
    if (l->count >= MATCH_SAMPLES ||
        !(u > MATCH_BORDER && u < 1 - MATCH_BORDER && v > MATCH_BORDER && v < 1 - MATCH_BORDER))
        return;
    l->focal[0] = c->fx / c->width, l->focal[1] = c->fy / c->height;
    l->u[l->count] = (float)u, l->v[l->count] = (float)v;
    l->colour[l->count++] = (float)(point->rgb[0] + point->rgb[1] + point->rgb[2]);
}

/* Takes every k-th observation of each image. of_image: (images) layout of each image, or -1. */
static void match_from_tracks(struct match *w, const int *of_image, uint32_t *seen)
{
    const struct colmap *c = w->colmap;
    struct tracks_walk all = tracks_of(c, of_image), near = all;
    near.origin = oxl_scene_origin(w->scene);
    while (tracks_next(&all)) seen[2 * all.view]++;
    while (tracks_next(&near)) {
        struct match_layout *l = &w->layout[near.view];
        uint32_t *count = seen + 2 * near.view;
        double x[3], pixel[2];
        if (count[1]++ % (count[0] / MATCH_SAMPLES + 1)) continue;
        if (scene_project_point(w->scene, l->view, near.point, x, pixel))
            match_add_point(l, &oxl_scene_view(w->scene, l->view)->camera, pixel, &c->point[near.point]);
    }
}

/* Takes every k-th point that the camera has in its image, in the file's order: counts them first. */
OXL_INTERNAL void match_by_projection(struct match *w, struct match_layout *l, const oxl_camera *camera)
{
    const struct colmap *c = w->colmap;
    const size_t step = c->point_count / MATCH_POINTS + 1;
    size_t inside = 0, every = 1;
    l->count = 0;
    for (int pass = 0; pass < 2; pass++) {
        size_t n = 0;
        for (size_t i = 0; i < c->point_count; i += step) {
            double x[3], p[2];
            if (!tracks_accept_point(&c->point[i], oxl_scene_origin(w->scene)) ||
                !camera_project(camera, c->point[i].position, oxl_scene_origin(w->scene), x, p) ||
                !(p[0] > 0 && p[0] < camera->width && p[1] > 0 && p[1] < camera->height))
                continue;
            if (pass == 0) inside++;
            else if (n++ % every == 0) match_add_point(l, camera, p, &c->point[i]);
        }
        every = inside / MATCH_SAMPLES + 1;
    }
    match_finish_layout(l, w->work);
}

OXL_INTERNAL oxl_result match_lay_out(struct match *w)
{
    int *of_image = oxl_alloc(w->ctx, w->colmap->image_count + 1, sizeof *of_image);
    uint32_t *seen = oxl_calloc(w->ctx, (size_t)w->count + 1, 2 * sizeof *seen);
    const oxl_result rc = of_image && seen ? OXL_OK : OXL_ERR_MEMORY;
    for (size_t i = 0; rc == OXL_OK && i < w->colmap->image_count; i++) of_image[i] = -1;
    for (int k = 0; k < w->count && rc == OXL_OK; k++) {
        w->layout[k].view = (int)((int64_t)k * oxl_scene_view_count(w->scene) / w->count);
        of_image[scene_source_image(w->scene, w->layout[k].view) - w->colmap->image] = k;
    }
    if (rc == OXL_OK && w->tracked) match_from_tracks(w, of_image, seen);
    for (int k = 0; k < w->count && rc == OXL_OK; k++) {
        if (w->tracked) match_finish_layout(&w->layout[k], w->work);
        else match_by_projection(w, &w->layout[k], &oxl_scene_view(w->scene, w->layout[k].view)->camera);
        w->coloured |= match_is_coloured(&w->layout[k]);
    }
    OXL_FREE(w->ctx, of_image, seen);
    return rc;
}

/* ---------------- brightness of an image */

static int match_is_grey(const struct training_image *image)
{
    const size_t pixels = (size_t)image->width * (size_t)image->height;
    const unsigned char *rgb = image->rgb;
    for (size_t i = 0; i < pixels; i++)
        if (rgb[i] != rgb[pixels + i] || rgb[i] != rgb[2 * pixels + i]) return 0;
    return 1;
}

static oxl_result match_reduce(struct match *w, const struct training_image *image)
{
    struct match_plane *p = &w->plane;
    const int side = OXL_MAX(image->width, image->height), step = (side + MATCH_SIDE - 1) / MATCH_SIDE;
    const size_t pixels = (size_t)image->width * (size_t)image->height;
    oxl_result rc;
    p->width = OXL_MAX(image->width / step, 1), p->height = OXL_MAX(image->height / step, 1);
    p->grey = match_is_grey(image);
    rc = oxl_reserve(w->ctx, &p->value, &p->capacity, (size_t)p->width * (size_t)p->height, sizeof *p->value);
    for (int y = 0; y < p->height && rc == OXL_OK; y++)
        for (int x = 0; x < p->width; x++) {
            unsigned sum = 0;
            int masked = 0;
            for (int i = 0; i < step * step; i++) {
                const size_t row = (size_t)OXL_MIN(y * step + i / step, image->height - 1),
                             at = row * (size_t)image->width +
                                  (size_t)OXL_MIN(x * step + i % step, image->width - 1);
                sum += (unsigned)image->rgb[at] + image->rgb[pixels + at] + image->rgb[2 * pixels + at];
                masked |= image->mask && !image->mask[at];
            }
            p->value[y * p->width + x] = masked ? -1.0f : (float)sum / (float)(step * step);
        }
    return rc;
}

/* Returns the sum of 3 x 3 px; NaN: outside the image, or masked. */
static float match_brightness(const struct match_plane *p, double u, double v)
{
    const int x = (int)(u * p->width), y = (int)(v * p->height);
    float sum = 0;
    if (!(u >= 0 && v >= 0 && x < p->width && y < p->height)) return NAN;
    for (int i = -1; i <= 1; i++)
        for (int k = -1; k <= 1; k++) {
            const float value =
                p->value[OXL_CLAMP(y + i, 0, p->height - 1) * p->width + OXL_CLAMP(x + k, 0, p->width - 1)];
            if (value < 0) return NAN;
            sum += value;
        }
    return sum;
}

/* Counts the points at which the image is masked. */
static int match_count_masked(const struct match *w, const struct match_layout *l)
{
    int n = 0;
    for (int k = 0; k < l->count; k++) n += isnan(match_brightness(&w->plane, l->u[k], l->v[k]));
    return n;
}

OXL_INTERNAL double match_correlate(struct match *w, const struct match_layout *l,
                                    const struct match_map *map)
{
    float value[MATCH_SAMPLES] = {0}, difference[MATCH_SAMPLES];
    double own = 0, its = 0, both = 0;
    int n = 0;
    for (int k = 0; k < l->count; k++) {
        double at[2];
        match_apply(map, l->focal, l->u[k], l->v[k], at);
        value[k] = match_brightness(&w->plane, at[0], at[1]);
    }
    match_differences(l, value, w->work, difference);
    for (int k = 0; k < l->count; k++) {
        if (isnan(difference[k]) || isnan(l->colour[k])) continue;
        own += (double)difference[k] * difference[k];
        its += (double)l->colour[k] * l->colour[k];
        both += (double)difference[k] * l->colour[k];
        n++;
    }
    return n >= MATCH_FEWEST && own * its > 0 ? both / sqrt(own * its) : 0;
}

static int match_is_blank(const struct match_plane *p)
{
    const size_t pixels = (size_t)p->width * (size_t)p->height;
    float first = -1;
    for (size_t i = 0; i < pixels; i++) {
        if (p->value[i] < 0) continue;
        if (first < 0) first = p->value[i];
        if (p->value[i] != first) return 0;
    }
    return first >= 0;
}

OXL_INTERNAL oxl_result match_take_image(struct match *w, int view, int *has)
{
    const struct training_image *image;
    oxl_result rc = context_stopped(w->ctx);
    *has = 0;
    if (rc != OXL_OK) return rc;
    image = scene_image(w->ctx, w->scene, view);
    if (!image) return w->ctx->failed == OXL_ERR_INPUT ? OXL_OK : w->ctx->failed;
    *has = 1;
    return match_reduce(w, image);
}

static void match_images_ahead(struct match *w, int from)
{
    int view[8], n = 0;
    for (int k = from; k < w->count && n < (int)OXL_COUNT(view); k++) view[n++] = w->layout[k].view;
    scene_images_ahead(w->ctx, w->scene, view, n);
}

/* Warns that the pixel data of an image are damaged, unless lint_image finds the same,
 * which is reported already. */
static void match_warn_damaged(struct match *w, int view)
{
    char *text = oxl_strdup(w->ctx, oxl_error_text(w->ctx));
    if (text && lint_image(w->ctx, w->scene, view) == OXL_OK && ++w->damaged <= MATCH_NAMED)
        oxl_log(w->ctx, OXL_LOG_WARNING, "%s; training would go on without it", text);
    oxl_free(w->ctx, text);
}

/* Correlates each image with its points under each map, and with other images' points for chance. */
OXL_INTERNAL oxl_result match_compare(struct match *w, int damaged)
{
    for (int k = 0; k < w->count; k++) {
        int has = 0;
        oxl_result rc = OXL_OK;
        if (w->layout[k].count < MATCH_FEWEST) continue;
        match_images_ahead(w, k);
        rc = match_take_image(w, w->layout[k].view, &has);
        if (rc != OXL_OK) return rc;
        if (!has && damaged) match_warn_damaged(w, w->layout[k].view);
        w->judged[k] = (uint8_t)has;
        w->score[k].blank = has && match_is_blank(&w->plane);
        w->score[k].grey = has && w->plane.grey;
        if (has) w->score[k].masked = match_count_masked(w, &w->layout[k]);
        for (int m = 0; has && m < w->maps; m++)
            w->score[k].as_is[m] = match_correlate(w, &w->layout[k], &w->map[m]);
        for (int i = 1; has && i <= MATCH_OTHERS; i++)
            w->score[k].chance +=
                match_correlate(w, &w->layout[(k + i * w->count / (MATCH_OTHERS + 1)) % w->count],
                                &w->map[0]) /
                MATCH_OTHERS;
    }
    if (w->damaged > MATCH_NAMED)
        oxl_log(w->ctx, OXL_LOG_WARNING, "... and %d more", w->damaged - MATCH_NAMED);
    return OXL_OK;
}

/* ---------------- verdicts */

static double match_quantile(struct match *w, int map, double quantile)
{
    size_t n = 0;
    for (int k = 0; k < w->count; k++)
        if (w->judged[k]) w->work[n++] = map < 0 ? w->score[k].chance : w->score[k].as_is[map];
    return n ? stats_select(w->work, n, quantile) : 0;
}

OXL_INTERNAL double match_median(struct match *w)
{
    return match_quantile(w, 0, 0.5);
}

OXL_INTERNAL double match_median_by_chance(struct match *w)
{
    return match_quantile(w, -1, 0.5);
}

OXL_INTERNAL double match_high(struct match *w)
{
    return match_quantile(w, 0, 0.9);
}

OXL_INTERNAL int match_is_suspect(const struct match *w, int k, double high)
{
    const double r = w->score[k].as_is[0];
    if (w->layout[k].count < MATCH_FEWEST) return 1;
    return w->judged[k] && !w->score[k].blank && r < MATCH_SUSPECT * high &&
           r < w->score[k].chance + MATCH_NOISE / sqrt(w->layout[k].count);
}

OXL_INTERNAL int match_is_better(double r, double as_is, int count, double high)
{
    return r > as_is + MATCH_ELSEWHERE && r > MATCH_SUSPECT * high && r * sqrt(count) > MATCH_SIGNIFICANT;
}

OXL_INTERNAL int match_judged(const struct match *w)
{
    int n = 0;
    for (int k = 0; k < w->count; k++) n += w->judged[k];
    return n;
}

/* Finds the map under which the images fit better than as they are; 0: none does. */
static int match_best_map(struct match *w)
{
    const double as_is = match_quantile(w, 0, 0.5);
    const int judged = match_judged(w);
    double most = OXL_MAX(as_is + MATCH_STEADY, match_median_by_chance(w) + 2 * MATCH_CHANCE);
    int best = 0, wins = 0;
    for (int m = 1; m < w->maps; m++) {
        const double median = match_quantile(w, m, 0.5);
        if (median > most) most = median, best = m;
    }
    for (int k = 0; k < w->count; k++) wins += w->judged[k] && w->score[k].as_is[best] > w->score[k].as_is[0];
    return (most > as_is + MATCH_BETTER && wins > MATCH_WINS * judged) ||
                   (judged >= MATCH_MANY && wins > MATCH_ALWAYS * judged)
               ? best
               : 0;
}

static const char *match_kind_text(enum match_kind kind)
{
    static const char *const text[] = {"as they are",
                                       "turned by 180 degrees",
                                       "turned by 90 degrees",
                                       "mirrored",
                                       "cropped",
                                       "through a lens with distortion",
                                       "shifted"};
    return text[kind];
}

static const char *match_kind_fix(enum match_kind kind)
{
    return kind == MATCH_DISTORTED
               ? "use the images that colmap image_undistorter wrote beside this model, or the model from before it"
           : kind == MATCH_TURNED || kind == MATCH_QUARTER || kind == MATCH_MIRRORED
               ? "turn them back to what the model was made from; another program may have applied or removed an EXIF orientation"
               : "use the images that the model was made from, whole and under the same names";
}

/* Looks for a better fit of image k: at the points of other images, and turned or mirrored. */
static oxl_result match_find_place(struct match *w, int k, int *fits_map)
{
    struct match_score *s = &w->score[k];
    int has = 0;
    oxl_result rc = match_take_image(w, w->layout[k].view, &has);
    *fits_map = 0;
    s->other = 0, s->fits = -1;
    for (int i = 0; i < w->count && rc == OXL_OK && has; i++) {
        const double r =
            i == k || w->layout[i].count < MATCH_FEWEST ? 0 : match_correlate(w, &w->layout[i], &w->map[0]);
        if (r > s->other) s->other = r, s->fits = i;
    }
    for (int m = 1; m < w->maps && w->map[m].kind <= MATCH_MIRRORED; m++)
        if (s->as_is[m] > s->other && s->as_is[m] > s->as_is[*fits_map])
            *fits_map = m, s->other = s->as_is[m];
    if (*fits_map) s->fits = -1;
    return rc;
}

struct match_found { /* Collects images that do not fit. */
    struct text names;
    int count, elsewhere; /* number of images; number of these that fit in another way */
};

static void match_name(struct match *w, int k, int map, int elsewhere, struct match_found *f)
{
    const struct match_score *s = &w->score[k];
    f->elsewhere += elsewhere;
    if (f->count++ >= MATCH_NAMED) return;
    text_add(&f->names, "%s%s", f->count > 1 ? ", " : "", oxl_scene_view(w->scene, w->layout[k].view)->name);
    if (s->blank) text_add(&f->names, " (one colour)");
    else if (elsewhere && map) text_add(&f->names, " (fits %s)", match_kind_text(w->map[map].kind));
    else if (elsewhere)
        text_add(&f->names, " (fits the place of %s)",
                 oxl_scene_view(w->scene, w->layout[s->fits].view)->name);
}

/* Finds images that fit elsewhere, or nowhere while the others fit well. all 1: no
 * image of the survey fits. */
static oxl_result match_find_images(struct match *w, int all, struct match_found *f)
{
    const double high = match_quantile(w, 0, 0.9), median = match_quantile(w, 0, 0.5);
    double middle, spread;
    double *value = w->work + w->count + MATCH_SAMPLES;
    size_t n = 0;
    for (int k = 0; k < w->count; k++)
        if (w->judged[k]) value[n++] = w->score[k].as_is[0];
    spread = stats_spread(value, n, w->work, &middle);
    for (int k = 0; k < w->count; k++) {
        const struct match_score *s = &w->score[k];
        const double r = s->as_is[0], noise = MATCH_NOISE / sqrt(w->layout[k].count);
        int map = 0, elsewhere;
        oxl_result rc;
        if (w->judged[k] && s->blank && w->layout[k].count >= MATCH_FEWEST) match_name(w, k, 0, 0, f);
        if (!w->judged[k] || s->blank || (!all && r >= MATCH_SUSPECT * high)) continue;
        rc = match_find_place(w, k, &map);
        if (rc != OXL_OK) return rc;
        elsewhere = (map || s->fits >= 0) && s->other > r + MATCH_ELSEWHERE &&
                    s->other > (all ? MATCH_CHANCE : MATCH_SUSPECT * high) &&
                    s->other * sqrt(w->layout[map ? k : s->fits].count) > MATCH_SIGNIFICANT &&
                    r < s->chance + noise;
        if (elsewhere || (!all && w->tracked && r < median - MATCH_DEVIATIONS * spread &&
                          r < MATCH_LOW * median && r < s->chance + noise))
            match_name(w, k, map, elsewhere, f);
    }
    return OXL_OK;
}

/* Warns once, about the whole survey or about some images. */
OXL_INTERNAL oxl_result match_judge(struct match *w, int *foreign)
{
    const int judged = match_judged(w), best = match_best_map(w);
    const double median = match_quantile(w, 0, 0.5), chance = match_quantile(w, -1, 0.5);
    const int none = median < chance + MATCH_CHANCE;
    struct match_found f = {.names = {.ctx = w->ctx}};
    oxl_result rc = OXL_OK;
    if (best) {
        *foreign = judged;
        oxl_log(
            w->ctx, OXL_LOG_WARNING,
            "the images fit the model's points better %s (correlation of brightness and colours %.2f, as they are %.2f)\nfix: %s",
            match_kind_text(w->map[best].kind), match_quantile(w, best, 0.5), median,
            match_kind_fix(w->map[best].kind));
        return OXL_OK;
    }
    rc = match_find_images(w, none, &f);
    if (rc == OXL_OK && (none || 2 * f.elsewhere > judged)) {
        *foreign = judged;
        oxl_log(
            w->ctx, OXL_LOG_WARNING,
            "the images are not those of the model: at its points their brightness has nothing to do with the points' colours "
            "(correlation %.2f, by chance %.2f)%s%s\n"
            "fix: use the images that the model was made from, under the same names; frames that were extracted or numbered again are others",
            median, chance, f.count ? "; " : "", f.count ? f.names.data : "");
    } else if (rc == OXL_OK && f.count) {
        *foreign = f.count;
        oxl_log(
            w->ctx, OXL_LOG_WARNING,
            "%d of %d images do not show what the model has at their points: %s%s\n"
            "fix: use the images that the model was made from, under the same names, or leave these out of the folder",
            f.count, judged, f.names.data ? f.names.data : "", f.count > MATCH_NAMED ? ", ..." : "");
    }
    text_free(&f.names);
    return rc;
}

/* Warns if some images have no colours and others have. */
static void match_warn_grey(struct match *w)
{
    struct text names = {.ctx = w->ctx};
    const int judged = match_judged(w);
    int grey = 0;
    for (int k = 0; k < w->count; k++) {
        if (!w->judged[k] || !w->score[k].grey || w->score[k].blank || grey++ >= MATCH_NAMED) continue;
        text_add(&names, "%s%s", grey > 1 ? ", " : "", oxl_scene_view(w->scene, w->layout[k].view)->name);
    }
    if (grey > 0 && grey < judged)
        oxl_log(w->ctx, OXL_LOG_WARNING,
                "%d of %d images have no colours, and the others have: %s%s\n"
                "fix: leave them out of the model, or take the colours out of all",
                grey, judged, names.data ? names.data : "", grey > MATCH_NAMED ? ", ..." : "");
    text_free(&names);
}

OXL_INTERNAL int match_check_masks(struct match *w)
{
    size_t masked = 0, points = 0;
    match_warn_grey(w);
    for (int k = 0; k < w->count; k++)
        if (w->judged[k]) masked += (size_t)w->score[k].masked, points += (size_t)w->layout[k].count;
    if (points == 0 || 2 * masked <= points) return 0;
    oxl_log(w->ctx, OXL_LOG_WARNING,
            "%.0f %% of the points that images show lie where their masks are black, which is ignored\n"
            "fix: exchange black and white if the masks mark what is to be ignored in white",
            100.0 * (double)masked / (double)points);
    return 10 * masked > 9 * points;
}

/* ---------------- the check */

OXL_INTERNAL oxl_result match_begin(oxl_context *ctx, oxl_scene *scene, struct match *w)
{
    const int views = oxl_scene_view_count(scene);
    *w = (struct match){.ctx = ctx, .scene = scene, .colmap = scene_colmap(scene)};
    w->count = OXL_MIN(views, (int)MATCH_VIEWS);
    w->tracked = w->colmap && w->colmap->track_count > 0;
    w->layout = oxl_calloc(ctx, (size_t)w->count + 1, sizeof *w->layout);
    w->score = oxl_calloc(ctx, (size_t)w->count + 1, sizeof *w->score);
    w->judged = oxl_calloc(ctx, (size_t)w->count + 1, 1);
    w->work = oxl_alloc(ctx, 2 * ((size_t)w->count + MATCH_SAMPLES), sizeof *w->work);
    if (!w->layout || !w->score || !w->judged || !w->work) return OXL_ERR_MEMORY;
    match_fill_maps(w);
    return OXL_OK;
}
