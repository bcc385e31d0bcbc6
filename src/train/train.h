/* train.h - training: schedule, density control, the loop. */
#ifndef OXL_TRAIN_H
#define OXL_TRAIN_H

#include "../survey/image.h"
#include "../model/model.h"

/* ---------------- train_loop.c: a run */

struct archive; /* archive.c */
typedef void archive_state(struct archive *a, void *user);
/* Says where a run keeps its state, and looks for it when it begins: in files, by large/checkpoint.c. */
struct train_store {
    oxl_result (*write)(oxl_context *ctx, const char *folder, const char *key, archive_state *state,
                        void *user);
    oxl_result (*read)(oxl_context *ctx, const char *folder, const char *key, archive_state *state,
                       void *user, int *found); /* none: *found = 0, and the state is unchanged */
    const char *folder, *key;                   /* key: all inputs of the result */
};

/* Asks more of a run than its options. All zero: from the points to the end, without checkpoints. */
struct train_task {
    struct train_store store; /* all zero: the run's state is not kept */
    struct text *log, *notes; /* the caller's texts, saved with the state */
    struct text *decisions;   /* receives members of a JSON object, decisions and evidence; or NULL */

    /* what it begins with, instead of the points: at most one of the two */
    const oxl_model *from; /* a model that is densified like the points */
    oxl_model *start;      /* a trained model that is continued, with `imaging`; it is moved into the run */
    struct oxl_imaging *imaging; /* in: that of `start`; out: that of the result; NULL: none, not wanted */
    int first;                   /* step that `start` is at */
    int until;                   /* the run pauses after this step and writes a checkpoint; 0: no pause */

    /* one block of a survey (src/large/blocks.c) */
    const oxl_model *surroundings; /* Gaussians that are rendered but not trained; NULL: none */
    /* (views) trained part of each view, width 0: none; NULL: whole views */
    const struct image_window *window;
    int frozen; /* 1: gains and lamp stay as they are */
    int viewed; /* for the time left: the evaluation behind the run, in steps */

    /* what trained_make does behind the run */
    int viewer_steps; /* of the model for viewers, before the factors for medium and gains; 0: none is made */
    struct train_store viewer_store; /* of the run that refines it, in another folder */
    int trims;                       /* 1: Gaussians that no training view shows are removed */

    /* out */
    oxl_nonfinite nonfinite; /* of the whole run */
    int finished;            /* 1: all iterations are made */
};
/* Trains as oxl_train, with checkpoints: resumes from the last one if it exists. */
OXL_INTERNAL oxl_result train_run(oxl_context *ctx, const oxl_scene *scene, const oxl_train_options *options,
                                  const oxl_callback *callback, struct train_task *task, oxl_model *out);
/* Takes at most so many of the survey's points that views have in their images, evenly spaced in their order,
 * or random points that the views could see. Free with oxl_free. */
OXL_INTERNAL oxl_result train_some_points(oxl_context *ctx, const oxl_scene *scene, size_t most,
                                          oxl_point **out, size_t *count);
OXL_INTERNAL oxl_result train_check(oxl_context *ctx, const oxl_train_options *options);

/* ---------------- schedule.c, forecast.c: functions of options and step */

/* The threshold of density control; lowered to SCHEDULE_GRADIENT_POINTLESS where the start is random, in
 * scenes without points on a background: their Gaussians all come from growth (docs/log/TRAINING.md). */
#define SCHEDULE_GRADIENT_POINTLESS 0.0002f
OXL_INTERNAL float schedule_densify_gradient(const oxl_scene *scene, const oxl_train_options *options);
/* Returns the largest number of Gaussians for this scene. */
OXL_INTERNAL size_t schedule_gaussian_cap(const oxl_scene *scene, const oxl_train_options *options);
/* Returns the factor on the learning rates of geometry in short runs (docs/METHOD.md). */
OXL_INTERNAL double schedule_short_run_factor(const oxl_train_options *options);
OXL_INTERNAL float schedule_scale_rate(const oxl_train_options *options);
OXL_INTERNAL size_t schedule_gaussian_cap_of(size_t points, double pixels, const oxl_train_options *options);
OXL_INTERNAL double schedule_pixels(const oxl_scene *scene); /* of all training views */
/* The same at the resolution that the run begins with. */
OXL_INTERNAL double schedule_first_pixels(const oxl_scene *scene, const oxl_train_options *options);
/* Returns the fraction of the run in which images of this size are trained at half resolution. */
OXL_INTERNAL double schedule_coarse_fraction(const oxl_train_options *options, int width, int height);
OXL_INTERNAL int schedule_densifies_at(const oxl_train_options *options, int step);
OXL_INTERNAL int schedule_training_views(const oxl_scene *scene);
/* Returns the steps of a model for viewers that leaves out a medium or gains; steps: of one that does not. */
OXL_INTERNAL int schedule_viewer_steps(int steps);

/* Return what a step takes, and all behind step `done`, in the time that a Gaussian adds to a step;
 * *gaussians grows to the end of the run, up to cap. */
OXL_INTERNAL double forecast_step(const oxl_camera *camera, double gaussians, int halved);
OXL_INTERNAL double forecast_ahead(const oxl_train_options *options, int done, const oxl_camera *camera,
                                   double cap, double *gaussians);

/* ---------------- parts.c: all parts of training, from the options alone */

/* Bounds from above the parts' memory for so many views. */
OXL_INTERNAL double parts_bytes(const oxl_train_options *options, int views);

#endif
