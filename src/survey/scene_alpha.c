/* scene_alpha.c - sets the colour behind a scene, over which transparent pixels of its images are
 * composited.
 */
#include "scene.h"
#include "scene_alpha.h"

OXL_INTERNAL int scene_is_composited(const oxl_scene *scene)
{
    return scene->transparent > 0 && !scene->alpha_masks;
}

OXL_INTERNAL struct image_alpha scene_alpha(const oxl_scene *scene)
{
    struct image_alpha alpha = {.masks = scene->alpha_masks};
    memcpy(alpha.background, scene->cache->background, sizeof alpha.background);
    return alpha;
}

OXL_INTERNAL void scene_background(const oxl_scene *scene, const float wanted[3], float out[3])
{
    for (int c = 0; c < 3; c++) {
        const float v = wanted[0] >= 0 ? wanted[c] : scene_is_composited(scene);
        /* Rounds to the 8 bits of the images. */
        out[c] = scene_is_composited(scene) ? floorf(v * 255 + 0.5f) / 255 : v;
    }
}

OXL_INTERNAL void scene_set_background(oxl_context *ctx, const oxl_scene *scene, const float rgb[3])
{
    uint8_t *now = scene->cache->background;
    int differs = 0;
    if (!scene_is_composited(scene)) return;
    for (int c = 0; c < 3; c++) {
        const uint8_t byte = (uint8_t)(rgb[c] * 255 + 0.5f);
        differs |= byte != now[c];
        now[c] = byte;
    }
    if (differs) image_cache_clear(ctx, scene->cache);
}
