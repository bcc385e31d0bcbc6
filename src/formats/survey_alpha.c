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

static int alpha_is_jpeg(const char *name)
{
    const char *dot = strrchr(name, '.');
    return dot && (dot[1] | 0x20) == 'j';
}

static void alpha_add_pixels(const struct pixels *image, struct alpha_sum *sum)
{
    const size_t count = (size_t)image->width * (size_t)image->height;
    size_t transparent = 0;
    for (size_t i = 0; i < count; i++) transparent += image->data[4 * i + 3] < ALPHA_OPAQUE;
    sum->pixels[1] += (double)transparent;
    sum->pixels[0] += (double)(count - transparent);
}

/* Projects up to ALPHA_POINTS points into the distorted image, evenly, and counts those
 * on either kind of pixel. */
static void alpha_add_points(const oxl_scene *scene, int view, const struct pixels *image,
                             struct alpha_sum *sum)
{
    const struct colmap_camera *camera = scene_source_camera(scene, view);
    const size_t count = scene->colmap.point_count, stride = (count + ALPHA_POINTS - 1) / ALPHA_POINTS;
    for (size_t i = 0; i < count; i += stride) {
        double x[3], pixel[2];
        if (!scene_project_point(scene, view, i, x, pixel)) continue;
        camera_distort(camera, (const double[2]){x[0] / x[2], x[1] / x[2]}, pixel);
        pixel[0] *= (double)image->width / camera->width, pixel[1] *= (double)image->height / camera->height;
        if (!(pixel[0] >= 0 && pixel[0] < image->width && pixel[1] >= 0 && pixel[1] < image->height))
            continue;
        sum->points[image->data[4 * ((size_t)pixel[1] * (size_t)image->width + (size_t)pixel[0]) + 3] <
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
        if (rc == OXL_OK) {
            alpha_add_pixels(&image, sum);
            alpha_add_points(scene, v, &image, sum);
        }
        image_pixels_free(ctx, &image);
        if (rc != OXL_OK && rc != OXL_ERR_INPUT) return rc;
    }
    return OXL_OK;
}

/* Returns 1 if the transparent pixels hide a part of the scene, and writes the reason to `why`. */
static int alpha_hides_scene(const struct alpha_sum *s, char *why, size_t size)
{
    const double points = s->points[0] + s->points[1], pixels = s->pixels[0] + s->pixels[1];
    if (points == 0) snprintf(why, size, "the survey has no points there");
    else
        snprintf(why, size, "%.1f %% of the points project there, on %.1f %% of the pixels",
                 100 * s->points[1] / points, 100 * s->pixels[1] / pixels);
    return s->points[1] * s->pixels[0] > ALPHA_HIDES * s->points[0] * s->pixels[1] && s->points[1] > 0;
}

/* Counts all views with alpha in scene->transparent, and lists the training views among them in view
 * (view_count); returns their number. */
static int alpha_find_views(oxl_scene *scene, int *view)
{
    int count = 0;
    for (int i = 0; i < scene->view_count; i++) {
        const char *name = scene->view[i].name;
        if (alpha_is_jpeg(name) || !image_has_alpha(PATH(scene->images, "%s", name))) continue;
        scene->transparent++;
        if (!scene->view[i].is_test) view[count++] = i;
    }
    return count;
}

OXL_INTERNAL oxl_result scene_decide_alpha(oxl_context *ctx, oxl_scene *scene, oxl_alpha option)
{
    int *view = oxl_alloc(ctx, (size_t)scene->view_count + 1, sizeof *view), count = 0;
    struct alpha_sum sum = {{0}, {0}};
    char why[160] = "as set";
    oxl_result rc = view ? OXL_OK : OXL_ERR_MEMORY;
    if (rc == OXL_OK) count = alpha_find_views(scene, view);
    if (rc == OXL_OK && count > 0) rc = alpha_measure(ctx, scene, view, count, &sum);
    oxl_free(ctx, view);
    if (rc != OXL_OK || scene->transparent == 0) return rc;
    scene->alpha_masks =
        option == OXL_ALPHA_AUTO ? alpha_hides_scene(&sum, why, sizeof why) : option == OXL_ALPHA_MASK;
    memset(scene->cache->background, scene->alpha_masks ? 0 : 255, sizeof scene->cache->background);
    if (sum.pixels[1] > 0)
        oxl_log(ctx, OXL_LOG_INFO, "transparent pixels of %d images are %s: %s (--alpha)", scene->transparent,
                scene->alpha_masks ? "masked" : "composited over --background, by default white", why);
    return OXL_OK;
}
