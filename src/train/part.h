/* part.h - what a part of training is: the hooks by which lamp, pruning, second lobes and the like take part
 * in a run.
 *
 * A part is one file of src/parts and one row of the table there (src/parts/parts.h). The loop, a step,
 * checkpoints, the options and their help know parts as rows alone: with its file and its row
 * removed, everything else builds and passes its tests (make without PART=lamp).
 *
 * Hooks are called row by row, in the order of the table; one that is NULL does nothing. `state` points to
 * the part's `size` bytes, which are 0 at the start of a run.
 */
#ifndef OXL_PART_H
#define OXL_PART_H

#include "train_state.h"

struct oxl_option; /* oceanxl_job.h: an option by name, for parts that bring their own */

/* Describes a view as a step renders it and compares it with its image. */
struct part_view {
    int view;
    double progress;            /* fraction of the run */
    oxl_camera camera;          /* at the step's window and resolution */
    struct oxl_imaging imaging; /* lamp and medium in front of the scene, from the hooks form_image */
    struct train_deferred *step;
};

struct part {
    const char *name;                /* lower case, as the file's */
    size_t size;                     /* bytes of its state */
    int is_plain;                    /* 1: the state holds no pointers, and is archived as it is */
    const struct oxl_option *option; /* its rows of the table of options, up to one without a name; or NULL */

    /* Refuses options that do not fit together. */
    oxl_result (*check)(oxl_context *ctx, const oxl_train_options *options);
    /* Adds points to start from to the survey's (*count, allocated); before `begin`, without a state. */
    oxl_result (*first_points)(struct train *t, oxl_point **out, size_t *count);
    /* Begins a run before there is a model or a renderer: may change the survey's poses. */
    oxl_result (*before_points)(struct train *t, void *state);
    /* Begins a run: the model and the renderer exist. t->continues: from a trained model. */
    oxl_result (*begin)(struct train *t, void *state);
    void (*free)(struct train *t, void *state);
    /* Writes or reads what later steps depend on of a state that is not plain. */
    void (*archive)(struct archive *a, struct train *t, void *state);

    /* Names the PHOTOMETRY_* that the part takes from the colours of tracks before the first step of a run,
     * without what use_tracks has refused. */
    int (*tracks)(const struct train *t, const void *state);
    void (*use_tracks)(struct train *t, void *state, const struct photometry *p);

    /* Changes the model before a step. */
    oxl_result (*before_step)(struct train *t, void *state);
    /* Sets step->gain, by which the rendered image is multiplied. learns 0: nothing else may change. */
    void (*set_gain)(struct train *t, void *state, struct train_deferred *step, int learns);
    void (*form_image)(const void *state, struct oxl_imaging *m);
    oxl_result (*before_render)(struct train *t, void *state, struct part_view *v);
    oxl_result (*after_render)(struct train *t, void *state, struct part_view *v);
    oxl_result (*before_backward)(struct train *t, void *state, struct part_view *v);
    /* Is called when the step's loss is known; on a device that may be after the next step has begun. */
    void (*after_loss)(struct train *t, void *state, const struct train_deferred *step,
                       const struct renderer_loss *loss);

    /* Are called while Gaussians are densified: before the step's gradients are added up, and before rows are
     * chosen. */
    oxl_result (*before_observe)(struct train *t, void *state);
    oxl_result (*before_density)(struct train *t, void *state, struct density_rules *rules);

    /* Is called after a step and its density control. */
    oxl_result (*after_step)(struct train *t, void *state);
    /* Bounds from above the memory for so many views. */
    double (*bytes)(const oxl_train_options *options, int views);

    /* Records the part's decision for run.json, and logs the result, after the last step. */
    void (*record)(struct train *t, void *state);
    /* Writes what rendering the model takes to the scene and the model, when the run ends or pauses. */
    void (*store)(struct train *t, void *state, oxl_model *model);
};

/* Returns a row of the table in src/parts/table.c; NULL after the last. */
OXL_INTERNAL const struct part *parts_at(int index);

#endif
