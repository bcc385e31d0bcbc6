/* survey_alpha.c - decides on the transparent pixels of a survey's images: composited over the background, or
 * masked.
 *
 * An object cut out of its background has no points where its images are transparent: there, the background
 * is what the model must show. Where points of the scene project onto transparent pixels, these hide a part
 * of the scene (a diver, the survey's vehicle): nothing is to be learned from them.
 *
 * Invariant: the decision depends on the survey's files alone.
 */
#include "survey_read.h"
#include "../survey/image_header.h"
#include "../survey/scene.h"

enum {
    ALPHA_SAMPLE = 8,     /* images that are decoded for the decision */
    ALPHA_POINTS = 20000, /* points that are projected into each */
    ALPHA_OPAQUE = 128    /* least alpha of a pixel that is not transparent */
};
/* Bounds the density of points on transparent pixels, relative to that on opaque ones, above which
 * transparent pixels hide the scene. */
#define ALPHA_HIDES 0.1

/* Sums pixels and points over the sample; [0]: on opaque pixels, [1]: on transparent ones. */
struct alpha_sum {
    double pixels[2], points[2];
};

/* Adds the pixels of an image, and up to ALPHA_POINTS points, evenly, that project into its distorted one. */
static void alpha_add(const oxl_scene *scene, int view, const struct pixels *image, struct alpha_sum *sum)
{
    const struct colmap_camera *camera = scene_source_camera(scene, view);
    const size_t count = scene->colmap.point_count, stride = (count + ALPHA_POINTS - 1) / ALPHA_POINTS,
                 pixels = (size_t)image->width * (size_t)image->height;
    for (size_t i = 0; i < pixels; i++) sum->pixels[image->data[4 * i + 3] < ALPHA_OPAQUE]++;
    for (size_t i = 0; i < count; i += stride) {
        double x[3], at[2];
        if (!scene_project_point(scene, view, i, x, at)) continue;
        camera_distort(camera, (const double[2]){x[0] / x[2], x[1] / x[2]}, at);
        at[0] *= (double)image->width / camera->width, at[1] *= (double)image->height / camera->height;
        if (at[0] >= 0 && at[0] < image->width && at[1] >= 0 && at[1] < image->height)
            sum->points[image->data[4 * ((size_t)at[1] * (size_t)image->width + (size_t)at[0]) + 3] <
                        ALPHA_OPAQUE]++;
    }
}

/* Measures up to ALPHA_SAMPLE of the `count` training views with alpha, evenly. Skips unreadable
 * images, which training reports. */
static oxl_result alpha_measure(oxl_context *ctx, const oxl_scene *scene, const int *view, int count,
                                struct alpha_sum *sum)
{
    const int used = OXL_MIN(count, ALPHA_SAMPLE);
    for (int k = 0; k < used; k++) {
        const int v = view[(int64_t)k * count / used];
        struct pixels image = {0};
        const oxl_result rc = image_decode(ctx, PATH(scene->images, "%s", scene->view[v].name), 4, &image);
        if (rc == OXL_OK) alpha_add(scene, v, &image, sum);
        image_pixels_free(ctx, &image);
        if (rc != OXL_OK && rc != OXL_ERR_INPUT) return rc;
    }
    return OXL_OK;
}

OXL_INTERNAL oxl_result scene_decide_alpha(oxl_context *ctx, oxl_scene *scene, oxl_alpha option)
{
    int *view = oxl_alloc(ctx, (size_t)scene->view_count + 1, sizeof *view), count = 0, linear = 0;
    struct alpha_sum sum = {{0}, {0}};
    const double *points = sum.points, *pixels = sum.pixels;
    oxl_result rc;
    if (!view) return OXL_ERR_MEMORY;
    for (int i = 0; i < scene->view_count; i++) {
        const char *name = scene->view[i].name, *dot = strrchr(name, '.');
        struct image_header h;
        if ((dot && (dot[1] | 0x20) == 'j') ||
            image_read_header(ctx, PATH(scene->images, "%s", name), &h) != OXL_OK)
            continue;
        linear += h.is_linear;
        scene->transparent += h.has_alpha;
        if (h.has_alpha && !scene->view[i].is_test) view[count++] = i;
    }
    if (linear)
        oxl_log(ctx, OXL_LOG_WARNING,
                "%d of %d images hold linear light, as their gAMA states: they are converted to sRGB", linear,
                scene->view_count);
    rc = alpha_measure(ctx, scene, view, count, &sum);
    oxl_free(ctx, view);
    if (rc != OXL_OK || scene->transparent == 0) return rc;
    scene->alpha_masks = option == OXL_ALPHA_AUTO
                             ? points[1] > 0 && points[1] * pixels[0] > ALPHA_HIDES * points[0] * pixels[1]
                             : option == OXL_ALPHA_MASK;
    memset(scene->cache->background, scene->alpha_masks ? 0 : 255, sizeof scene->cache->background);
    if (pixels[1] > 0)
        oxl_log(
            ctx, OXL_LOG_INFO,
            "transparent pixels of %d images are %s: %.1f %% of the points project there, on %.1f %% of the "
            "pixels (--alpha)",
            scene->transparent,
            scene->alpha_masks ? "masked" : "composited over --background, by default white",
            100 * points[1] / OXL_MAX(points[0] + points[1], 1), 100 * pixels[1] / (pixels[0] + pixels[1]));
    return OXL_OK;
}
