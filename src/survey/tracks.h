/* tracks.h - walks over the observations of points: which view sees which point. */
#ifndef OXL_TRACKS_H
#define OXL_TRACKS_H

#include "sparse.h"

#define TRACKS_FARTHEST 1e15 /* units from the origin: farther points are dropped, farther cameras an error */
/* Returns 0 if the point is too far away for the scene. */
OXL_INTERNAL int tracks_accept_point(const struct colmap_point *point, const double origin[3]);

/* Walks over the entries of tracks, point by point. tracks_of and tracks_of_point begin it; the caller then
 * sets what it wants of `step`, `origin` and `shortest`; tracks_next goes to the next observation. */
struct tracks_walk {
    const struct colmap *colmap;
    const int *view_of;   /* (images) number of each image's view; negative: its entries are passed over */
    size_t point, end;    /* the point observed; where the walk ends */
    int view;             /* that observes it, by view_of */
    uint32_t observation; /* of the image: which of its 2D points */
    size_t step;          /* takes every step-th entry, whether its image has a view or not */
    const double *origin; /* NULL: all points; else those that tracks_accept_point takes, */
    uint32_t shortest;    /* with at least so many entries */
    size_t seen;          /* entries so far */
    uint32_t entry;       /* the next one of the point's track */
};
OXL_INTERNAL struct tracks_walk tracks_of(const struct colmap *c, const int *view_of);
OXL_INTERNAL struct tracks_walk tracks_of_point(const struct colmap *c, const int *view_of, size_t point);
OXL_INTERNAL int tracks_next(struct tracks_walk *w); /* 0: the walk has ended */

#endif
