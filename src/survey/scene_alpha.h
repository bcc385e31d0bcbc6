/* scene_alpha.h - transparent pixels of a scene's images, and the colour behind the scene. */
#ifndef OXL_SCENE_ALPHA_H
#define OXL_SCENE_ALPHA_H

#include "../core/core.h"

/* scene_background: the colour behind the scene; wanted (-1,-1,-1): white where images are composited over
 * it, else black.
 * scene_set_background: images are composited over this colour from now on. */
OXL_INTERNAL int scene_is_composited(const oxl_scene *scene);
OXL_INTERNAL void scene_background(const oxl_scene *scene, const float wanted[3], float out[3]);
OXL_INTERNAL void scene_set_background(oxl_context *ctx, oxl_scene *scene, const float rgb[3]);

#endif
