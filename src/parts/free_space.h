/* free_space.h - the state of free_space.c, for that file and its tests: the space between a camera and the
 * points it observes. */
#ifndef OXL_PART_FREE_SPACE_H
#define OXL_PART_FREE_SPACE_H

#include "../train/part.h"

enum { FREE_SPACE_GRID = 12 }; /* cells along each side of an image */

struct free_space_view { /* a training view */
    const oxl_camera *camera;
    float most;                                     /* the largest depth */
    float depth[FREE_SPACE_GRID * FREE_SPACE_GRID]; /* camera z up to which a cell is free; 0: not known */
};
struct free_space {
    struct free_space_view *view; /* (views) the training views; NULL: off */
    size_t views;
    uint8_t *carved; /* (count) during density control: rows in free space; else NULL */
};
OXL_INTERNAL oxl_result free_space_begin(oxl_context *ctx, struct free_space *f, const oxl_scene *scene);
OXL_INTERNAL void free_space_free(struct train *t, void *state);
/* Describes the state as text. */
OXL_INTERNAL void free_space_describe(const struct free_space *f, char *out, size_t size);
/* Marks in *carved (count) each Gaussian in free space with 1; NULL: there is no free space. Free it with
 * oxl_free. */
OXL_INTERNAL oxl_result free_space_carve(oxl_context *ctx, const struct free_space *f, const oxl_model *model,
                                         uint8_t **carved);
/* Returns 1 if the position, world coordinates less the origin, is in free space. */
OXL_INTERNAL int free_space_contains(const struct free_space *f, const double p[3]);

#endif
