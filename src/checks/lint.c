/* lint.c - checks of a readable survey: poses that do not fit the points, images and masks that training
 * cannot use.
 *
 * A track states that an image observes a point, so the point projects into that image. If poses are camera
 * to world, or cameras, poses and points come from different models or scales, many do not; in COLMAP's own
 * exports all do.
 *
 * Invariant: no check changes what is trained.
 */
#include "../survey/sparse.h"
#include "../survey/image.h"
#include "../survey/scene.h"
#include "checks.h"
#include "../survey/tracks.h"

enum {
    LINT_SAMPLE = 1 << 16, /* most track entries that are checked, at a fixed stride */
    LINT_MIN = 4,          /* least entries by which an image is judged */
    LINT_NAMED = 3         /* images or masks that are named per message */
};
#define LINT_MARGIN 0.05 /* Tolerates points outside the image by this fraction of its longer side. */
#define LINT_MISSED 0.5  /* Counts a pose as wrong from this fraction of points outside its image on. */

/* ---------------- poses and points */

struct lint_view {
    size_t seen, missed; /* number of entries checked; number of these outside the image */
};

static int lint_is_in_frame(const oxl_scene *scene, int view, const double world[3])
{
    const struct colmap_camera *from = scene_source_camera(scene, view);
    const oxl_camera *c = &oxl_scene_view(scene, view)->camera;
    const double margin = LINT_MARGIN * OXL_MAX(from->width, from->height);
    double x[3], direction[2], pixel[2];
    camera_transform(c, world, oxl_scene_origin(scene), x);
    if (!(x[2] > 0)) return 0;
    direction[0] = x[0] / x[2];
    direction[1] = x[1] / x[2];
    camera_distort(from, direction, pixel);
    return pixel[0] >= -margin && pixel[0] <= from->width + margin && pixel[1] >= -margin &&
           pixel[1] <= from->height + margin;
}

/* Counts observations outside their image. view_of: (images) view of each image; -1: none. */
static void lint_count(const oxl_scene *scene, const int *view_of, struct lint_view *views)
{
    const struct colmap *c = scene_colmap(scene);
    struct tracks_walk w = tracks_of(c, view_of);
    w.step = c->track_count / LINT_SAMPLE + 1;
    w.origin = oxl_scene_origin(scene);
    while (tracks_next(&w)) {
        views[w.view].seen++;
        views[w.view].missed += !lint_is_in_frame(scene, w.view, c->point[w.point].position);
    }
}

static int lint_has_misses(const struct lint_view *v)
{
    return v->seen >= LINT_MIN && (double)v->missed > LINT_MISSED * (double)v->seen;
}

/* Names a few wrong poses, unless so many views do not fit that the whole survey is reported. Without the
 * wrong ones, s->missed is the fraction of the other views. */
static void lint_sum_up(oxl_context *ctx, const oxl_scene *scene, const struct lint_view *views,
                        oxl_survey *s)
{
    const int count = oxl_scene_view_count(scene);
    size_t seen = 0, missed = 0;
    int wrong = 0, named = 0;
    for (int i = 0; i < count; i++) wrong += lint_has_misses(&views[i]);
    for (int i = 0; i < count; i++)
        if (2 * wrong > count || !lint_has_misses(&views[i]))
            seen += views[i].seen, missed += views[i].missed;
    s->missed = seen ? (double)missed / (double)seen : 0;
    for (int i = 0; i < count && s->missed <= LINT_MISSED_SURVEY; i++)
        if (lint_has_misses(&views[i]) && named++ < LINT_NAMED)
            oxl_log(
                ctx, OXL_LOG_WARNING,
                "%s: %.0f %% of the points in its tracks project outside this image, so its pose is wrong\n"
                "fix: take it out of the model: colmap image_deleter, or its frame in a transforms.json",
                oxl_scene_view(scene, i)->name, 100.0 * (double)views[i].missed / (double)views[i].seen);
    if (named > LINT_NAMED) oxl_log(ctx, OXL_LOG_WARNING, "... and %d more", named - LINT_NAMED);
}

OXL_INTERNAL oxl_result lint_observations(oxl_context *ctx, const oxl_scene *scene, oxl_survey *s)
{
    const struct colmap *c = scene_colmap(scene);
    const int count = oxl_scene_view_count(scene);
    struct lint_view *views;
    int *view_of;
    oxl_result rc = OXL_OK;
    if (!c || c->track_count == 0) return OXL_OK;
    views = oxl_calloc(ctx, (size_t)count + 1, sizeof *views);
    view_of = scene_views_by_image(ctx, scene, OXL_SPLIT_ALL);
    if (!views || !view_of) rc = OXL_ERR_MEMORY;
    if (rc == OXL_OK) lint_count(scene, view_of, views);
    if (rc == OXL_OK) lint_sum_up(ctx, scene, views, s);
    OXL_FREE(ctx, views, view_of);
    return rc;
}

/* ---------------- images and masks */

/* Checks what an image's header and segments tell; damaged pixel data are found by decoding. */
OXL_INTERNAL oxl_result lint_image(oxl_context *ctx, const oxl_scene *scene, int view)
{
    const char *name = oxl_scene_view(scene, view)->name;
    const char *path = PATH(scene->images, "%s", name);
    int width = 0, height = 0;
    oxl_result rc = image_size(ctx, path, &width, &height);
    return rc == OXL_OK ? image_check_shape(ctx, path, width, height, scene_source_camera(scene, view)) : rc;
}

static void lint_warn_aspect(oxl_context *ctx, const char *path, int width, int height, int *stretched)
{
    if (++*stretched <= LINT_NAMED)
        oxl_log(ctx, OXL_LOG_WARNING,
                "%s: %d x %d px, but its image has another aspect ratio, so the mask is stretched\n"
                "fix: give the mask the aspect ratio of its image",
                path, width, height);
}

/* Reads a mask and checks it. *counts: fraction of pixels that are not black. */
static oxl_result lint_mask(oxl_context *ctx, const oxl_scene *scene, int view, int *stretched,
                            double *counts)
{
    const struct colmap_camera *from = scene_source_camera(scene, view);
    struct pixels pixels = {0};
    char *path;
    oxl_result rc = scene_mask_path(ctx, scene, view, &path);
    size_t count, white = 0;
    *counts = 1;
    if (rc != OXL_OK || !path) return rc;
    rc = image_decode(ctx, path, 1, &pixels);
    count = rc == OXL_OK ? (size_t)pixels.width * (size_t)pixels.height : 0;
    for (size_t i = 0; i < count; i++) white += pixels.data[i] != 0;
    if (count) *counts = (double)white / (double)count;
    if (count && image_check_shape(ctx, path, pixels.width, pixels.height, from) != OXL_OK)
        lint_warn_aspect(ctx, path, pixels.width, pixels.height, stretched);
    if (count && white == 0)
        rc = oxl_fail(ctx, OXL_ERR_INPUT,
                      "%s: the mask is all black, so it excludes the whole image\n"
                      "fix: use white (255) for the pixels that count",
                      path);
    image_pixels_free(ctx, &pixels);
    oxl_free(ctx, path);
    return rc;
}

OXL_INTERNAL oxl_result lint_masks(oxl_context *ctx, const oxl_scene *scene)
{
    int stretched = 0;
    oxl_result rc = OXL_OK;
    for (int i = 0; i < oxl_scene_view_count(scene) && rc == OXL_OK; i++) {
        int width = 0, height = 0;
        char *path = NULL;
        rc = scene_mask_path(ctx, scene, i, &path);
        if (rc == OXL_OK && path && image_size(ctx, path, &width, &height) == OXL_OK &&
            image_check_shape(ctx, path, width, height, scene_source_camera(scene, i)) != OXL_OK)
            lint_warn_aspect(ctx, path, width, height, &stretched);
        oxl_free(ctx, path);
    }
    if (stretched > LINT_NAMED)
        oxl_log(ctx, OXL_LOG_WARNING, "... and %d more masks", stretched - LINT_NAMED);
    return rc;
}

OXL_INTERNAL oxl_result lint_images(oxl_context *ctx, const oxl_scene *scene, oxl_survey *s)
{
    double masked = 0;
    int usable = 0, stretched = 0;
    for (int i = 0; i < oxl_scene_view_count(scene); i++) {
        double counts = 1;
        oxl_result rc = context_stopped(ctx);
        if (rc == OXL_OK) rc = lint_image(ctx, scene, i);
        if (rc == OXL_OK) rc = lint_mask(ctx, scene, i, &stretched, &counts);
        masked += 1 - counts;
        usable += rc == OXL_OK && !oxl_scene_view(scene, i)->is_test;
        if (rc == OXL_OK) continue;
        if (rc != OXL_ERR_INPUT) return rc;
        if (s->unusable++ < LINT_NAMED) oxl_log(ctx, OXL_LOG_WARNING, "%s", oxl_error_text(ctx));
    }
    s->masked = s->masks > 0 ? masked / s->masks : 0;
    if (s->unusable > LINT_NAMED)
        oxl_log(ctx, OXL_LOG_WARNING, "... and %d more images", s->unusable - LINT_NAMED);
    if (stretched > LINT_NAMED)
        oxl_log(ctx, OXL_LOG_WARNING, "... and %d more masks", stretched - LINT_NAMED);
    if (usable > 0 || s->train_views == 0) return OXL_OK;
    return oxl_fail(ctx, OXL_ERR_INPUT,
                    "none of the %d training views can be used; the warnings above give the reasons\n"
                    "fix: correct the files named there",
                    s->train_views);
}
