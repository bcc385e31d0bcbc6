/* track_depth.h - the state of track_depth.c, for that file and its tests: depths from the tracks. */
#ifndef OXL_PART_TRACK_DEPTH_H
#define OXL_PART_TRACK_DEPTH_H

#include "../train/part.h"

struct track_depth_view {
    int seen;                  /* points observed; they are kept up to a limit */
    struct depth_point *point; /* px of the view's camera */
};
struct track_depth {
    int started;
    struct track_depth_view *view; /* (views); NULL: no tracks */
    struct depth_point *all;
};
/* Samples the tracks. window (views): only views with a window are used; NULL: all training views. */
OXL_INTERNAL oxl_result track_depth_begin(oxl_context *ctx, struct track_depth *d, const oxl_scene *scene,
                                          const struct image_window *window);
OXL_INTERNAL void track_depth_free(struct train *t, void *state);
/* Chooses some points of the step's view; returns the weight of each in the loss. */
OXL_INTERNAL double track_depth_of_step(const struct track_depth *d, int view, int step, double progress,
                                        int *count, struct depth_point out[DEPTH_POINTS]);
OXL_INTERNAL oxl_result track_depth_before_backward(struct train *t, void *state, struct part_view *v);
OXL_TABLE const struct part part_track_depth;

#endif
