/* gaps.h - points to start from between those of the survey. */
#ifndef OXL_GAPS_H
#define OXL_GAPS_H

#include "../survey/survey.h"

/* Makes at most `most` points, in the scene's frame, where training views have none; free with oxl_free. */
OXL_INTERNAL oxl_result gaps_points(oxl_context *ctx, const oxl_scene *scene, size_t most, oxl_point **out,
                                    size_t *count);

#endif
