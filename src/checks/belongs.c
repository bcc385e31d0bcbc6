/* belongs.c - checks whether images, points and poses belong together: by colours (match.c) and, if these or
 * the tracks say that they do not, by the conventions of poses (conventions.c).
 */
#include "checks.h"
#include "match.h"
#include "../survey/survey.h"

OXL_INTERNAL oxl_result match_check(oxl_context *ctx, oxl_scene *scene, int damaged, oxl_survey *s)
{
    const int misfit = s->missed > LINT_MISSED_SURVEY;
    struct match w;
    int found = 0, hidden = 0;
    oxl_result rc;
    s->foreign = 0;
    if (!scene_colmap(scene) || scene_colmap(scene)->point_count < MATCH_FEWEST) return OXL_OK;
    rc = match_begin(ctx, scene, &w);
    if (rc == OXL_OK) rc = match_lay_out(&w);
    if (rc == OXL_OK) rc = match_compare(&w, damaged);
    if (rc == OXL_OK) hidden = match_check_masks(&w);
    if (rc == OXL_OK && !hidden && (!w.tracked || misfit)) rc = conventions_check(&w, &found);
    if (rc == OXL_OK && !hidden && !found && !misfit && w.coloured && match_judged(&w) >= MATCH_ENOUGH)
        rc = match_judge(&w, &s->foreign);
    OXL_FREE(ctx, w.layout, w.score, w.judged, w.work, w.plane.value);
    return rc;
}
