/* medium.h - how medium.c decides, for that file and its tests. */
#ifndef OXL_PART_MEDIUM_FIT_H
#define OXL_PART_MEDIUM_FIT_H

#include "../train/part.h"

/* Uses the medium fitted to the tracks, if the residuals support it; why: the evidence. Likewise
 * lamp_set_from_tracks and exposure_set_from_tracks. */
OXL_INTERNAL void medium_set_from_tracks(struct medium *m, double span, const struct photometry *p, char *why,
                                         size_t size);

#endif
