/* tracks.c - walks over the observations of points: the views that see each point.
 *
 * Invariant: the order is that of the points and of the entries of their tracks, so sums over a walk
 * repeat.
 */
#include "tracks.h"

OXL_INTERNAL int tracks_accept_point(const struct colmap_point *point, const double origin[3])
{
    double size = 0;
    for (int k = 0; k < 3; k++) size += fabs(point->position[k] - origin[k]);
    return size <= TRACKS_FARTHEST; /* 0 for NaN, too */
}

OXL_INTERNAL struct tracks_walk tracks_of(const struct colmap *c, const int *view_of)
{
    return (struct tracks_walk){.colmap = c, .view_of = view_of, .end = c->point_count, .step = 1};
}

/* Goes to the next observation. Counts the entries without a view, too, so that a stride does
 * not depend on the views. */
OXL_INTERNAL int tracks_next(struct tracks_walk *w)
{
    for (; w->point < w->end; w->point++, w->entry = 0) {
        const struct colmap_point *p = &w->colmap->point[w->point];
        if (w->entry == 0 && w->origin &&
            (p->track_count < w->shortest || !tracks_accept_point(p, w->origin)))
            continue;
        while (w->entry < p->track_count) {
            const struct colmap_track *t = &w->colmap->track[p->first_track + w->entry++];
            w->view = w->view_of[t->image_row];
            w->observation = t->observation;
            if (w->seen++ % w->step == 0 && w->view >= 0) return 1;
        }
    }
    return 0;
}
