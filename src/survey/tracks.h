/* tracks.h - walks over the observations of points: the views that see each point. */
#ifndef OXL_TRACKS_H
#define OXL_TRACKS_H

#include "sparse.h"

/* Bounds distances (units) from the origin: farther points are dropped, farther cameras are an error. */
#define TRACKS_FARTHEST 1e15
/* Returns 0 if the point is too far away for the scene. */
OXL_INTERNAL int tracks_accept_point(const struct colmap_point *point, const double origin[3]);

/* Walks over the entries of tracks, point by point. tracks_of begins a walk over all points; the caller sets
 * `point`, `end`, `step`, `origin` and `shortest` as needed; tracks_next goes to the next observation. */
struct tracks_walk {
    const struct colmap *colmap;
    const int *view_of;   /* (images) number of each image's view; negative: its entries are skipped */
    size_t point, end;    /* the point observed; end of the walk */
    int view;             /* view that observes the point, by view_of */
    uint32_t observation; /* index among the image's 2D points */
    size_t step;          /* takes every step-th entry, with or without a view */
    const double *origin; /* NULL: takes all points; otherwise those that tracks_accept_point accepts */
    uint32_t shortest;    /* and that have at least as many entries */
    size_t seen;          /* number of entries so far */
    uint32_t entry;       /* next entry of the point's track */
};
OXL_INTERNAL struct tracks_walk tracks_of(const struct colmap *c, const int *view_of);
OXL_INTERNAL int tracks_next(struct tracks_walk *w); /* 0: the end of the walk */

#endif
