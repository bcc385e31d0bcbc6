/* scene_alpha.h - declares the colour behind a scene, over which transparent pixels of
 * its images are composited. */
#ifndef OXL_SCENE_ALPHA_H
#define OXL_SCENE_ALPHA_H

#include "image.h"

/* Returns 1 if images are composited over a background. scene_background returns the colour behind the scene;
 * wanted (-1,-1,-1): white if images are composited, otherwise black. scene_set_background composites images
 * over this colour from now on. */
OXL_INTERNAL int scene_is_composited(const oxl_scene *scene);
OXL_INTERNAL void scene_background(const oxl_scene *scene, const float wanted[3], float out[3]);
OXL_INTERNAL void scene_set_background(oxl_context *ctx, const oxl_scene *scene, const float rgb[3]);
/* Says how transparent pixels of the scene's images are used now. */
OXL_INTERNAL struct image_alpha scene_alpha(const oxl_scene *scene);

#endif
