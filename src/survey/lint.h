/* lint.h - what `check` finds: files and images that contradict each other. */
#ifndef OXL_LINT_H
#define OXL_LINT_H

#include "../core/core.h"
#include "../../oceanxl_job.h"

/* ---------------- lint.c: contradictions between readable files */

/* fraction of observations outside their image from which the whole survey is reported */
#define LINT_MISSED_SURVEY 0.1
/* Sets s->missed; s->unusable and s->masked. Findings are logged. OXL_ERR_INPUT: no image can be used. */
OXL_INTERNAL oxl_result lint_observations(oxl_context *ctx, const oxl_scene *scene, oxl_survey *s);
OXL_INTERNAL oxl_result lint_images(oxl_context *ctx, const oxl_scene *scene, oxl_survey *s);
/* compares sizes, from the files' headers */
OXL_INTERNAL oxl_result lint_masks(oxl_context *ctx, const oxl_scene *scene);
/* match.c. Compares images with the points, and poses where s->missed says so or there are no tracks; logs
 * what does not fit. Sets s->foreign. */
OXL_INTERNAL oxl_result match_check(oxl_context *ctx, oxl_scene *scene, oxl_survey *s);
/* values.c. 16-bit images of fewer bits, masks without a black pixel. */
OXL_INTERNAL oxl_result values_check(oxl_context *ctx, oxl_scene *scene);
/* quality.c. Decodes every image; logs and counts blurred and badly exposed ones. */
OXL_INTERNAL oxl_result quality_check(oxl_context *ctx, oxl_scene *scene, oxl_survey *s);

#endif
