/* parts.h - the parts of training that this build has, one row each. A part is removed by removing its row
 * and its file (make without PART=lamp does so in a copy of the tree). Exposure comes before medium and lamp,
 * which are fitted again without gains that it refuses. */
#ifndef OXL_PARTS_H
#define OXL_PARTS_H

#define PARTS_EACH(ROW) \
    ROW(ucd)            \
    ROW(dropout)        \
    ROW(lobes)          \
    ROW(prune)          \
    ROW(exposure)       \
    ROW(medium)         \
    ROW(lamp)           \
    ROW(poses)          \
    ROW(track_depth)    \
    ROW(ssim_contrast)  \
    ROW(antialias)      \
    ROW(stereo)         \
    ROW(sh_degree)

#endif
