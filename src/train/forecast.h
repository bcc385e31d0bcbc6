/* forecast.h - Gaussians and time of a run, before it begins and while it lasts. */
#ifndef OXL_FORECAST_H
#define OXL_FORECAST_H

#include "train.h"

struct train;

/* ---------------- what a first look at a survey has found (src/large/look.c) */

struct look {         /* all 0: there was none */
    double share;     /* of the Gaussians seen, that training splits at once */
    double gaussians; /* at the start */
    double seconds;   /* of a step on a whole image, */
    double timed;     /* and the Gaussians it had */
    double begin;     /* s: before the first step */
    double after;     /* s: evaluation, beside rendering its views */
    int hides; /* 1: a model for viewers will be refined, since images have gains, a lamp or a medium */
    int steps, views; /* that it took */
};

/* ---------------- forecast.c: Gaussians and time of a run */

/* Predicts the Gaussians at the end of a run that starts with `start`. share: as a look has it; 0: not
 * known. */
OXL_INTERNAL double forecast_gaussians(const oxl_train_options *options, double start, double share,
                                       double cap);
/* Returns 1 if the model grows from `start` to `cap` even where it grows slowly: no look need tell. */
OXL_INTERNAL int forecast_reaches(const oxl_train_options *o, double start, double cap);
/* Bounds from above the steps that the trials of a whole run take beyond its iterations. views: number of
 * training views. */
OXL_INTERNAL int forecast_trial_steps(const oxl_train_options *options, int views);
/* Predicts the seconds of the run and its evaluation of `viewed` views. refined: steps of a model for
 * viewers, if there is one. */
OXL_INTERNAL double forecast_seconds(const oxl_scene *scene, const oxl_train_options *options,
                                     const struct look *look, double cap, int viewed, int refined);

/* ---------------- forecast.c: the time left */

OXL_INTERNAL void forecast_note_step(struct train *t);                 /* after each step, also of a trial */
OXL_INTERNAL void forecast_note_save(struct train *t, double seconds); /* after each checkpoint */
OXL_INTERNAL double forecast_left(struct train *t); /* s, with trials and what t->task names */

/* ---------------- train_loop.c: what a look shares with a run */

OXL_INTERNAL oxl_result train_begin(struct train *t);
OXL_INTERNAL oxl_result train_step_alone(struct train *t); /* without the decisions after it */
OXL_INTERNAL void train_end(struct train *t);

#endif
