/* stereo.h - points to start from, from the images themselves. */
#ifndef OXL_STEREO_H
#define OXL_STEREO_H

#include "../survey/survey.h"

/* Makes at most `most` points on the surfaces that training views show, in the scene's frame, none where the
 * survey has one; free with oxl_free. */
OXL_INTERNAL oxl_result stereo_points(oxl_context *ctx, const oxl_scene *scene, size_t most, oxl_point **out,
                                      size_t *count);

#endif
