/* lint.c - checks of a readable survey: images and masks that training cannot use.
 *
 * Invariant: no check changes what is trained.
 */
#include "../survey/image.h"
#include "../survey/scene.h"
#include "../survey/sparse.h"
#include "checks.h"

enum { LINT_NAMED = 3 }; /* images or masks that are named per message */

/* Checks what an image's header and segments tell; damaged pixel data are found by decoding. */
OXL_INTERNAL oxl_result lint_image(oxl_context *ctx, const oxl_scene *scene, int view)
{
    const char *path = PATH(scene->images, "%s", scene->view[view].name);
    int width = 0, height = 0;
    oxl_result rc = image_size(ctx, path, &width, &height);
    return rc == OXL_OK ? image_check_shape(ctx, path, width, height, scene_source_camera(scene, view)) : rc;
}

/* Checks a mask, by its header or, closely, its pixels. *black: fraction of the pixels that are black;
 * stretched: number of masks of another shape. A mask that cannot be read is reported on loading. */
static oxl_result lint_mask(oxl_context *ctx, const char *path, const struct colmap_camera *from, int closely,
                            double *black, int *stretched)
{
    struct pixels p = {0};
    size_t count = 0, zeros = 0;
    if ((closely ? image_decode(ctx, path, 1, &p) : image_size(ctx, path, &p.width, &p.height)) != OXL_OK)
        return OXL_OK;
    if (p.data) count = (size_t)p.width * (size_t)p.height;
    for (size_t i = 0; i < count; i++) zeros += p.data[i] == 0;
    *black = count ? (double)zeros / (double)count : 0;
    if (image_check_shape(ctx, path, p.width, p.height, from) != OXL_OK && ++*stretched <= LINT_NAMED)
        oxl_log(ctx, OXL_LOG_WARNING,
                "%s: %d x %d px, but its image has another aspect ratio, so the mask is stretched\n"
                "fix: give the mask the aspect ratio of its image",
                path, p.width, p.height);
    image_pixels_free(ctx, &p);
    return *black < 1 ? OXL_OK
                      : oxl_fail(ctx, OXL_ERR_INPUT,
                                 "%s: the mask is all black, so it excludes the whole image\n"
                                 "fix: use white (255) for the pixels that count",
                                 path);
}

OXL_INTERNAL oxl_result lint_images(oxl_context *ctx, const oxl_scene *scene, int closely, oxl_survey *s)
{
    double masked = 0;
    int usable = 0, stretched = 0;
    for (int i = 0; i < scene->view_count; i++) {
        double black = 0;
        char *mask = NULL;
        oxl_result rc = context_stopped(ctx);
        if (rc == OXL_OK && closely) rc = lint_image(ctx, scene, i);
        if (rc == OXL_OK) rc = scene_mask_path(ctx, scene, i, &mask);
        if (rc == OXL_OK && mask)
            rc = lint_mask(ctx, mask, scene_source_camera(scene, i), closely, &black, &stretched);
        oxl_free(ctx, mask);
        masked += black;
        usable += rc == OXL_OK && !scene->view[i].is_test;
        if (rc != OXL_OK && rc != OXL_ERR_INPUT) return rc;
        if (rc != OXL_OK && s->unusable++ < LINT_NAMED)
            oxl_log(ctx, OXL_LOG_WARNING, "%s", oxl_error_text(ctx));
    }
    s->masked = s->masks > 0 ? masked / s->masks : 0;
    if (closely && s->masks > 0 && masked <= 0)
        oxl_log(ctx, OXL_LOG_WARNING,
                "the masks have no black pixel, so nothing is ignored\nfix: mark ignored pixels in black "
                "(0), and write masks as PNG, which keeps values");
    if (usable > 0 || s->train_views == 0) return OXL_OK;
    return oxl_fail(ctx, OXL_ERR_INPUT,
                    "none of the %d training views can be used; the warnings above give the reasons\n"
                    "fix: correct the files named there",
                    s->train_views);
}
