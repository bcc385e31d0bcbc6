/* train_state.h - what the files of the run share: its state, and the steps that a decision may have to try out. */
#ifndef OXL_TRAIN_STATE_H
#define OXL_TRAIN_STATE_H

#include "train.h"

enum train_trial { TRAIN_TRIES_NOTHING, TRAIN_TRIES_SH_DEGREE, TRAIN_TRIES_LOBES, TRAIN_TRIES_WEIGHTS };

enum train_lobes { LOBES_IDLE, LOBES_WATCHED, LOBES_DECIDED }; /* gradients are watched before lobes are given out */

struct train {
    oxl_context              *ctx;
    oxl_scene                *scene;
    const oxl_train_options  *options;
    oxl_render_options        render;
    oxl_model                *model, first, second, gradient; /* the parameters, Adam's moments, dL/d(parameter) */
    struct renderer          *renderer;
    struct density           *density;
    struct ucd                ucd;
    struct prune              prune;
    struct transients         robust;
    struct exposure           exposure;
    struct water              water;
    int                       sh_degree;     /* bands that the model is to carry in the end, as far as it is decided */
    int                       lobes;         /* enum train_lobes */
    int                       trial_is_next; /* enum train_trial: before the next step */
    int                      *view;          /* (views) training views in this epoch's order */
    int                       views, step;
    int                      *held; /* (held_views) training views that stand aside, for decisions to be judged by */
    int                       held_views;
    float                    *target, *weight; /* with robust.points: the photograph of this step: (3,H,W), (H,W) */
    int                       masked;          /* whether weight holds its mask */
    size_t                    target_capacity, weight_capacity;
    int                       halved;     /* whether the photograph of this step is reduced to half the sides */
    double                    loss, psnr; /* smoothed */
    double                    last_loss;  /* of the last photograph, alike from step to step; not a number: it was put aside */
    oxl_nonfinite             faults;
    int                       first_step; /* after which this process took over: 0, or that of a checkpoint */
    double                    begun;      /* when it did */
    double                    seconds;    /* that others had spent on the run before */
    const struct train_place *place;      /* of its checkpoints, or NULL */
    int                       saved_step; /* of the last checkpoint, */
    double                    saved_at;   /* and when it was */
    const oxl_callback       *callback;
    struct text               decisions; /* members of a JSON object: what was decided, and on what evidence */
};

/* ---------------------------------------------------------------- train.c: one step */

/* A photograph, drawn, compared, walked back, stepped: the part of a step that a trial of bands or lobes repeats. */
OXL_INTERNAL oxl_result train_on_next_view(struct train *t);
OXL_INTERNAL oxl_result train_step(struct train *t);                       /* all of it */
OXL_INTERNAL oxl_result train_densify(struct train *t, const double f[2]); /* density control, with these weights by depth */
/* A view's photograph to the renderer. OXL_ERR_INPUT: it cannot be read. */
OXL_INTERNAL oxl_result train_load_image(struct train *t, int view);
/* The model drawn from a view, against its photograph. */
OXL_INTERNAL oxl_result train_compare_view(struct train *t, int view, struct renderer_loss *loss);
OXL_INTERNAL oxl_result train_resize(struct train *t);                  /* the gradient, to the model's shape */
OXL_INTERNAL int        train_report(const struct train *t, int trial); /* nonzero: the caller wants to stop */

/* ---------------------------------------------------------------- model_selection.c: model only what the scene requires */

/* Whether the index-th of so many training views stands aside: an eighth of them, 8 at most, evenly spread. */
OXL_INTERNAL int        selection_holds(int index, int views);
OXL_INTERNAL oxl_result selection_begin(struct train *t); /* which views train, and which stand aside */
/* Mean loss and PSNR over the views that stand aside; not a number when none can be read. */
OXL_INTERNAL oxl_result selection_judge(struct train *t, double *loss, double *psnr);
OXL_INTERNAL oxl_result selection_exposure(struct train *t);  /* after each step: gains of images */
OXL_INTERNAL void       selection_sh_degree(struct train *t); /* after each step: SH bands */
/* At a densification: whether a trial is to make it, twice. */
OXL_INTERNAL int        selection_tries_weights(const struct train *t);
OXL_INTERNAL oxl_result selection_lobes(struct train *t); /* after each step: second lobes */
OXL_INTERNAL oxl_result
selection_trial(struct train *t); /* before a step, when trial_is_next; OXL_ERR_INTERRUPTED: not made, to be made */
OXL_INTERNAL void selection_end(struct train *t); /* after the last step: the decisions of others */
OXL_INTERNAL void selection_archive(struct archive *a, struct train *t);

#endif
