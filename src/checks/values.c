/* values.c - finds cameras, images and masks whose values are not what they look like: a principal point for
 * another size, 16-bit images that use a small part of their range, masks without a black pixel.
 *
 * Invariant: nothing that is trained changes.
 */
#include "../survey/image_header.h"
#include "checks.h"
#include "../survey/scene.h"

enum {
    VALUES_IMAGES = 16, /* most images, and most masks, that are looked at */
    VALUES_WHITE = 255,
    /* 16-bit images whose brightest value is at most this, of 255, have values of fewer bits (14 bits: 64) */
    VALUES_DARK = 76,
    VALUES_NEARLY = 16 /* a mask's darkest value that was meant to be black */
};

/* Limits the distance of a principal point from the middle, in sides; beyond it a warning is logged. */
#define VALUES_MIDDLE 0.3

/* Warns if the principal point is far from the middle: that of another size, or with x and y exchanged. */
static void values_check_middle(oxl_context *ctx, const oxl_scene *scene)
{
    int far = 0, first = -1;
    for (int i = 0; i < oxl_scene_view_count(scene); i++) {
        const oxl_camera *c = &oxl_scene_view(scene, i)->camera;
        if (fabs(c->cx / c->width - 0.5) <= VALUES_MIDDLE && fabs(c->cy / c->height - 0.5) <= VALUES_MIDDLE)
            continue;
        if (far++ == 0) first = i;
    }
    if (far > 0) {
        const oxl_view *v = oxl_scene_view(scene, first);
        oxl_log(
            ctx, OXL_LOG_WARNING,
            "the principal point of %d of %d images is far from the middle (%s: %.0f, %.0f in %d x %d px)\n"
            "fix: unless these are cut out of larger images, give focal lengths, principal point, width and "
            "height of one size of the images",
            far, oxl_scene_view_count(scene), v->name, (double)v->camera.cx, (double)v->camera.cy,
            v->camera.width, v->camera.height);
    }
}

static int values_brightest(const struct training_image *image)
{
    const size_t count = 3 * (size_t)image->width * (size_t)image->height;
    int most = 0;
    for (size_t i = 0; i < count; i++) most = OXL_MAX(most, image->rgb[i]);
    return most;
}

static oxl_result values_check_range(oxl_context *ctx, oxl_scene *scene)
{
    const int views = oxl_scene_view_count(scene), step = views / VALUES_IMAGES + 1;
    int most = 0, wide = 0, factor = 1;
    for (int i = 0; i < views && most <= VALUES_DARK; i += step) {
        struct image_header header;
        const struct training_image *image;
        if (image_read_header(ctx, PATH(scene->images, "%s", oxl_scene_view(scene, i)->name), &header) !=
                OXL_OK ||
            header.bits != 16)
            continue;
        image = scene_image(ctx, scene, i);
        if (!image && ctx->failed != OXL_ERR_INPUT) return ctx->failed;
        if (image) most = OXL_MAX(most, values_brightest(image)), wide++;
    }
    while (factor * OXL_MAX(most, 1) * 2 <= VALUES_WHITE) factor *= 2;
    if (wide && most <= VALUES_DARK)
        oxl_log(
            ctx, OXL_LOG_WARNING,
            "the brightest value of the 16-bit images is %.0f %% of white, so %d of 256 grey levels are used: their "
            "values have fewer bits\n"
            "fix: stretch all of them alike: mogrify -evaluate multiply %d IMAGES",
            100.0 * most / VALUES_WHITE, most + 1, factor);
    return OXL_OK;
}

static oxl_result values_check_masks(oxl_context *ctx, const oxl_scene *scene)
{
    const int views = oxl_scene_view_count(scene), step = views / VALUES_IMAGES + 1;
    int darkest = VALUES_WHITE, masks = 0;
    for (int i = 0; i < views && darkest > 0; i += step) {
        struct pixels mask = {0};
        char *path = NULL;
        oxl_result rc = scene_mask_path(ctx, scene, i, &path);
        if (rc == OXL_OK && path && image_decode(ctx, path, 1, &mask) == OXL_OK) masks++;
        for (size_t k = 0; mask.data && k < (size_t)mask.width * (size_t)mask.height; k++)
            darkest = OXL_MIN(darkest, mask.data[k]);
        image_pixels_free(ctx, &mask);
        oxl_free(ctx, path);
        if (rc != OXL_OK) return rc;
    }
    if (masks && darkest > 0)
        oxl_log(ctx, OXL_LOG_WARNING,
                "the masks have no black pixel (the darkest value is %d), so nothing is ignored\n"
                "fix: black (0) marks what is ignored%s",
                darkest,
                darkest <= VALUES_NEARLY
                    ? "; write masks as PNG, which does not change values, and resize them without blur"
                    : "");
    return OXL_OK;
}

OXL_INTERNAL oxl_result values_check(oxl_context *ctx, oxl_scene *scene)
{
    oxl_result rc;
    values_check_middle(ctx, scene);
    rc = scene_colmap(scene) ? values_check_range(ctx, scene) : OXL_OK;
    return rc == OXL_OK && scene->stats.masks > 0 ? values_check_masks(ctx, scene) : rc;
}
