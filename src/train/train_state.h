/* train_state.h - shared by the files of the training run: its state, and the steps used by trials. */
#ifndef OXL_TRAIN_STATE_H
#define OXL_TRAIN_STATE_H

#include "train_parts.h"
#include "../survey/imaging.h"
#include "../model/model.h"

#define TRAIN_ON_DEVICE \
    "a device renders: only the CPU has it" /* why an option with OXL_OPTION_CPU_ONLY is off */

enum train_trial { TRAIN_TRIES_NOTHING, TRAIN_TRIES_SH_DEGREE, TRAIN_TRIES_LOBES };

/* gradients are averaged before lobes are assigned */
enum train_lobes { LOBES_IDLE, LOBES_WATCHED, LOBES_DECIDED };

struct train_deferred { /* a step that the device has not reported yet */
    int step, view, is_trial, observed;
    float gain[3]; /* at the start of the step */
};

struct train {
    oxl_context *ctx;
    oxl_scene *scene;
    const oxl_train_options *options;
    oxl_render_options render;
    struct trained_model trained;
    struct renderer *renderer;
    struct train_deferred deferred[2];
    int deferred_steps;
    struct density *density;
    struct ucd ucd;
    struct prune prune;
    double dropout; /* fraction in the last step of the run */
    struct transients transients;
    struct exposure exposure;
    struct medium_fit medium_fit;
    struct lamp_fit lamp;
    struct free_space free_space;
    struct track_depth track_depth;
    int sh_degree;     /* final degree, if it is decided */
    int lobes;         /* enum train_lobes */
    int trial_is_next; /* enum train_trial: before the next step */
    int *view;         /* (views) training views in this epoch's order */
    int views, step;
    int *validation; /* (validation_views) views for decisions */
    int validation_views;
    float *target, *weight; /* of step_loss_on_host: the image of this step: (3,H,W), (H,W) */
    int masked;             /* whether weight holds its mask */
    size_t target_capacity, weight_capacity;
    int halved;        /* whether the image of this step is reduced to half the sides */
    double loss, psnr; /* smoothed */
    double last_loss;  /* of the last image, comparable between steps; NaN: skipped */
    oxl_nonfinite nonfinite;
    int first_step;                    /* at which this process started: 0, or the step of a checkpoint */
    double started;                    /* time of that, os_seconds */
    double seconds;                    /* that earlier processes spent on the run */
    const struct train_output *output; /* of its checkpoints, or NULL */
    int saved_step;                    /* step of the last checkpoint */
    double saved_at;                   /* its time, os_seconds */
    const oxl_callback *callback;
    struct text decisions; /* members of a JSON object: decisions and evidence */
};

/* ---------------- schedule.c */

OXL_INTERNAL struct adam_params schedule_adam_params(const struct train *t);
OXL_INTERNAL float schedule_alpha_min(const struct train *t);
/* Fraction of the Gaussians that the last step of the run leaves out. */
OXL_INTERNAL double schedule_dropout_rate(const oxl_train_options *options, const oxl_scene *scene);
OXL_INTERNAL int schedule_reset_interval(const oxl_train_options *options);
OXL_INTERNAL int schedule_resets_opacity_at(const oxl_train_options *options, int step);

/* ---------------- step.c: the parts of one step */

/* Forward, loss, backward and Adam on the next training view: the part of a step that trials execute, too. */
OXL_INTERNAL oxl_result step_on_next_view(struct train *t);
/* Completes deferred steps and downloads. Call it before the host uses a step's loss, renders, or reads or
 * changes the model. */
OXL_INTERNAL oxl_result step_flush(struct train *t);
OXL_INTERNAL oxl_result step_download(struct train *t, enum renderer_download what);
/* adds the step's gradients to the statistics of density control */
OXL_INTERNAL oxl_result step_observe(struct train *t);
/* density control, with these weights by depth */
OXL_INTERNAL oxl_result step_densify(struct train *t, const double f[2]);
OXL_INTERNAL oxl_result step_prune(struct train *t, double validation_loss);
OXL_INTERNAL oxl_result step_raise_sh_degree(struct train *t);
/* Gives a view's image to the renderer. OXL_ERR_INPUT: it cannot be read. */
OXL_INTERNAL oxl_result step_load_image(struct train *t, int view);
/* Renders a view and compares it with its image. */
OXL_INTERNAL oxl_result step_loss_of_view(struct train *t, int view, struct renderer_loss *loss);
OXL_INTERNAL double step_seconds(const struct train *t);         /* of the whole run, over all processes */
OXL_INTERNAL int step_report(const struct train *t, int trial);  /* nonzero: the caller stops the run */
OXL_INTERNAL struct imaging step_imaging(const struct train *t); /* the present medium and lamp */

/* ---------------- branch.c: copies of the training state */

struct train_branch { /* the state that a step changes */
    struct trained_model trained;
    struct density *density;
    int *view, views, step;
    double loss, psnr;
    struct exposure exposure;
    struct medium_fit medium_fit;
    struct lamp_fit lamp;
    struct ucd ucd;
};

OXL_INTERNAL void branch_free(struct train *t, struct train_branch *b);
OXL_INTERNAL oxl_result branch_copy(struct train *t, struct train_branch *out);
OXL_INTERNAL oxl_result branch_swap(struct train *t, struct train_branch *b);
/* Copies `start` to t, and the former state of t to `other`. */
OXL_INTERNAL oxl_result branch_restart(struct train *t, struct train_branch *start,
                                       struct train_branch *other);

/* ---------------- model_selection.c: model only what the scene requires */

/* 1: the index-th training view is a validation view: an eighth of them, at most 8, evenly spaced. */
OXL_INTERNAL int selection_is_validation_view(int index, int views);
OXL_INTERNAL oxl_result selection_begin(struct train *t); /* splits training and validation views */
/* Mean loss and PSNR over the validation views; NaN if none can be read. */
OXL_INTERNAL oxl_result selection_validate(struct train *t, double *loss, double *psnr);
OXL_INTERNAL oxl_result
/* before a step, if trial_is_next; OXL_ERR_INTERRUPTED: the trial is to be repeated */
selection_trial(struct train *t);
/* after the last step: records the decisions of other modules */
OXL_INTERNAL void selection_end(struct train *t);
OXL_INTERNAL void selection_archive(struct archive *a, struct train *t);
/* After a step, when due: assigns second lobes, or schedules the trial that decides on them. */
OXL_INTERNAL oxl_result selection_lobes(struct train *t);
OXL_INTERNAL void selection_sh_degree(struct train *t); /* the same for SH degrees */
/* Choice and evidence of a decision, for run.json. */
OXL_INTERNAL void selection_record(struct train *t, const char *what, const char *chosen, const char *why);

/* ---------------- train_imaging.c: exposure, lamp and medium of a run */

/* from the tracks, before the first step */
OXL_INTERNAL oxl_result train_imaging_begin(struct train *t);
/* after a step, when due: a medium without evidence from tracks */
OXL_INTERNAL oxl_result train_imaging_start_medium(struct train *t);
/* logs the fitted values and warns where they are not identifiable */
OXL_INTERNAL void train_imaging_describe(struct train *t);
/* stores it in the scene, for evaluation and rendering */
OXL_INTERNAL void train_imaging_store(struct train *t);

/* ---------------- train_loop.c */

/* one step, and what is due after it: density control, pruning, trials */
OXL_INTERNAL oxl_result train_step(struct train *t);

#endif
