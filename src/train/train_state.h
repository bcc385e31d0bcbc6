/* train_state.h - shared by the files of a training run and its parts: the run's state, and what parts may
 * ask of it. */
#ifndef OXL_TRAIN_STATE_H
#define OXL_TRAIN_STATE_H

#include "train_tools.h"
#include "../survey/imaging.h"
#include "../survey/photometry.h"
#include "../model/model.h"

#define TRAIN_SAVE_STEPS 500    /* iterations between checkpoints, at most */
#define TRAIN_SAVE_SECONDS 60.0 /* s between checkpoints, at most */
enum { TRAIN_PARTS_MAX = 32 };

struct part;
struct part_view;

struct train_deferred { /* a step that the device has not reported yet */
    int step, view, observed, has_gain;
    float gain[3]; /* by which the image was multiplied, at the start of the step */
    /* medium and lamp then: a step that is repeated has the same, though they have changed since */
    struct oxl_imaging imaging;
};

struct forecast {         /* of the time left (forecast.c); not archived */
    double seconds, work; /* of the last steps; both fade */
    double at;            /* time of the last step, os_seconds; 0: none */
    double left, left_at; /* s that were left at the time left_at */
    int next;             /* step from which that is reckoned anew */
};

struct train {
    oxl_context *ctx;
    const oxl_scene *survey; /* the caller's scene */
    oxl_scene *posed;        /* the same, with cameras that a part may move */
    const oxl_scene *scene;  /* posed */
    /* of the model that is continued; then, when the run ends, of its result; not NULL */
    struct oxl_imaging *imaging, own_imaging;
    const oxl_train_options *options;
    struct train_task task;
    oxl_render_options render;
    struct trained_model trained;
    struct renderer *renderer;
    oxl_model gradient; /* of the last step, where terms on parameters ask for planes */
    struct train_deferred deferred[2];
    int deferred_steps;
    struct density density;
    int continues;               /* 1: from a trained model, with the scene's imaging */
    void *part[TRAIN_PARTS_MAX]; /* state of each row of the table of parts */
    int *view;                   /* (views) training views in this epoch's order */
    int views, step;
    struct photometry tracks; /* what the tracks say of exposure, lamp and medium */
    double shown;             /* mean share of the first Gaussians that a training view shows; 0: unknown */
    int halved;               /* whether the image of this step is reduced to half the sides */
    double loss, psnr;        /* smoothed */
    double last_loss;         /* of the last image, comparable between steps; NaN: skipped */
    oxl_nonfinite nonfinite;
    double started;  /* when this process began, os_seconds */
    double seconds;  /* that earlier processes spent on the run */
    int saved_step;  /* step of the last checkpoint */
    double saved_at; /* its time, os_seconds */
    const oxl_callback *callback;
    struct forecast forecast;
};

/* ---------------- schedule.c, forecast.c */

OXL_INTERNAL oxl_adam schedule_adam_params(const struct train *t);
OXL_INTERNAL float schedule_alpha_min(const struct train *t);
OXL_INTERNAL int schedule_reset_interval(const oxl_train_options *options);
OXL_INTERNAL int schedule_resets_opacity_at(const oxl_train_options *options, int step);
OXL_INTERNAL void forecast_note_step(struct train *t); /* after each step */
OXL_INTERNAL double forecast_left(struct train *t);    /* s, with what t->task names; 0: not known yet */

/* ---------------- step.c: the parts of one step */

/* Makes forward, loss, backward and Adam on the next training view. */
OXL_INTERNAL oxl_result step_on_next_view(struct train *t);
/* Completes deferred steps and downloads. Call it before the host uses a step's loss, renders, or reads or
 * changes the model. */
OXL_INTERNAL oxl_result step_flush(struct train *t);
OXL_INTERNAL oxl_result step_download(struct train *t, enum renderer_download what);
/* Adds the step's gradients to the statistics of density control. */
OXL_INTERNAL oxl_result step_observe(struct train *t);
OXL_INTERNAL oxl_result step_densify(struct train *t);
/* Moves on a device the rows that density control has decided on, or (change NULL) those that stay (keep
 * NULL: all), to a model of this degree. *moved: 1 if a device did. */
OXL_INTERNAL oxl_result step_move_rows(struct train *t, const struct density_change *change,
                                       const uint8_t *keep, int sh_degree, int *moved);
/* Gives a view's image to the renderer. OXL_ERR_INPUT: it cannot be read. */
OXL_INTERNAL oxl_result step_load_image(struct train *t, int view);
/* Returns the part of a view that this step compares, px of the view; NULL: all of it. */
OXL_INTERNAL const struct image_window *step_window(const struct train *t, int view);
OXL_INTERNAL double step_seconds(const struct train *t); /* of the whole run, over all processes */
OXL_INTERNAL int step_report(struct train *t);           /* nonzero: the caller stops the run */
OXL_INTERNAL struct oxl_imaging step_imaging(const struct train *t); /* the present medium and lamp */

/* ---------------- model_selection.c: model only what the scene requires */

OXL_INTERNAL oxl_result selection_begin(struct train *t); /* lists the training views, in name order */
/* Records the choice and its evidence for run.json. */
OXL_INTERNAL void selection_record(struct train *t, const char *what, const char *chosen, const char *why);
/* Logs a choice: `why` up to its first semicolon, and with --verbose the evidence behind it. */
OXL_INTERNAL void selection_log(struct train *t, const char *what, int on, const char *why);
/* Records and logs what `auto` has chosen. mode: the option. */
OXL_INTERNAL void selection_record_auto(struct train *t, const char *what, oxl_switch mode, int on,
                                        const char *why);

/* ---------------- train_imaging.c: exposure, lamp and medium of a run */

OXL_INTERNAL oxl_result train_imaging_begin(struct train *t); /* from the tracks, before the first step */
OXL_INTERNAL void train_imaging_store(struct train *t, oxl_model *model); /* in t->imaging and the model */

/* ---------------- train_loop.c */

OXL_INTERNAL oxl_result train_begin(struct train *t);
/* Makes one step, and what is due after it: density control, pruning. */
OXL_INTERNAL oxl_result train_step(struct train *t);
OXL_INTERNAL void train_end(struct train *t);

#endif
