/* poses.h - the state of poses.c, for that file and its tests. */
#ifndef OXL_PART_POSES_H
#define OXL_PART_POSES_H

#include "../train/part.h"
#include "../survey/scene.h"

struct poses {
    int asked, on;              /* by the options; on: and not found to be needless */
    double depth;               /* units: what moves are measured by */
    int steps;                  /* of all views */
    struct pose *view;          /* (views) */
    double (*pose)[POSE_TERMS]; /* (views) for the scene */
};

#endif
