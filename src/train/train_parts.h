/* train_parts.h - private to src/train: the parts of a run's state, a section per module; none of them knows
 * the run (train_state.h). */
#ifndef OXL_TRAIN_PARTS_H
#define OXL_TRAIN_PARTS_H

#include "train.h"
#include "../render/render.h"
#include "../survey/image.h"
#include "../survey/imaging.h"
#include "../survey/photometry.h"
#include "../survey/survey.h"
#include "../model/model.h"

/* ---------------- checkpoint.c: the state of a run in a file */

/* A module lists its state once; the archive writes or reads it. After a failure, calls do nothing. A count
 * is stored before its elements and is checked against the rest of the file. */
struct archive {
    oxl_context *ctx;
    int reading;
    const char *path;
    FILE *file;
    uint64_t sum, left; /* checksum so far; bytes still to read */
    oxl_result rc;
};
OXL_INTERNAL void archive_int(struct archive *a, int *value);
OXL_INTERNAL void archive_size(struct archive *a, size_t *value);
OXL_INTERNAL void archive_ints(struct archive *a, int *values, size_t count);
OXL_INTERNAL void archive_floats(struct archive *a, float *values, size_t count);
OXL_INTERNAL void archive_doubles(struct archive *a, double *values, size_t count);
/* Reading: refuses the file unless `is_so`. The checksum finds accidental damage, not intended changes. */
OXL_INTERNAL void archive_expect(struct archive *a, int is_so);
/* reading: the text is replaced */
OXL_INTERNAL void archive_text(struct archive *a, struct text *t);
/* reading: the model is replaced */
OXL_INTERNAL void archive_model(struct archive *a, oxl_model *model);
/* reading: 0, and a failure, if the file is too short */
OXL_INTERNAL int archive_fits(struct archive *a, size_t count, size_t size);

#define CHECKPOINT_VERSION 9
#define CHECKPOINT_SEED UINT64_C(0xCBF29CE484222325) /* Fowler, Noll & Vo: FNV-1a, 64 bits */
typedef void checkpoint_state(struct archive *a, void *user);
/* Writes FOLDER/checkpoint.oxl and keeps the previous one as checkpoint.prev.oxl. `key`: all inputs of the
 * result. */
OXL_INTERNAL oxl_result checkpoint_write(oxl_context *ctx, const char *folder, const char *key,
                                         checkpoint_state *state, void *user);
/* Reads the newest complete checkpoint with this key. None: *found = 0, and the state is unchanged. */
OXL_INTERNAL oxl_result checkpoint_read(oxl_context *ctx, const char *folder, const char *key,
                                        checkpoint_state *state, void *user, int *found);

/* ---------------- nonfinite.c: numbers that are not finite */

/* Counts an unreadable image and logs the context's error, which gives the reason. */
OXL_INTERNAL void nonfinite_count_unreadable(oxl_context *ctx, oxl_nonfinite *n);
OXL_INTERNAL void nonfinite_of_rows(oxl_context *ctx, oxl_nonfinite *n, int step, const char *view,
                                    struct renderer_nonfinite skipped, struct trained_model *trained);
/* Logs and counts: the loss of a view is not finite, and these rows were cleared. */
OXL_INTERNAL void nonfinite_of_view(oxl_context *ctx, oxl_nonfinite *n, int step, const char *view,
                                    struct renderer_nonfinite cleared);
/* Removes Gaussians with values that are not finite, and logs the counts. */
OXL_INTERNAL oxl_result nonfinite_end(oxl_context *ctx, oxl_nonfinite *n, oxl_model *model);
OXL_INTERNAL void nonfinite_archive(struct archive *a, oxl_nonfinite *n);

/* Clears rows that are not finite. r: also rows that it could not render in its last view; NULL: none. */
OXL_INTERNAL struct renderer_nonfinite nonfinite_clear(const struct renderer *r,
                                                       struct trained_model *trained);

/* ---------------- density.c: split, prune, reset */

struct density { /* statistics since the last control */
    size_t capacity;
    int banded;
    float z_near, z_far; /* where the bands meet, camera z */
    /* (count) sum over the views of |dL/d(u,v)|, in units of half an image; banded: those nearer than
     * z_near */
    float *gradient;
    float *gradient_mid, *gradient_far; /* (count) banded: the same from z_near and from z_far on */
    float *views;                       /* (count) number of views that see it */
    uint8_t *verdict;                   /* (count) */
};
struct density_rules {
    double gradient;       /* grow at this mean |dL/d(u,v)|, in units of half an image */
    double f_mid, f_far;   /* weights of the mid and far band [paper eq. 2]; used when there are bands */
    double extent;         /* of the scene */
    int split_large;       /* after the first reset interval [Kerbl 2023] */
    size_t cap;            /* on the number of Gaussians; 0: none */
    const uint8_t *carved; /* (count) 1: to be removed; or NULL */
};
struct density_change {
    size_t removed, split;
};
OXL_INTERNAL oxl_result density_create(oxl_context *ctx, struct density **out);
OXL_INTERNAL oxl_result density_copy(oxl_context *ctx, const struct density *from, size_t count,
                                     struct density **out);
OXL_INTERNAL void density_free(oxl_context *ctx, struct density *d);
OXL_INTERNAL oxl_result density_clear(oxl_context *ctx, struct density *d, size_t count);
OXL_INTERNAL oxl_result density_observe(oxl_context *ctx, struct density *d, struct renderer *r,
                                        size_t count);
/* From now on, separate sums of gradients per depth band; z_near 0: one sum. Clears the statistics. */
OXL_INTERNAL oxl_result density_set_bands(oxl_context *ctx, struct density *d, size_t count, double z_near,
                                          double z_far);
/* Mean over the views in which the row was visible since the statistics were cleared, without weights. */
OXL_INTERNAL double density_mean_gradient(const struct density *d, size_t row);
/* Decides which rows are split and removed; density_apply carries it out. */
OXL_INTERNAL oxl_result density_decide(oxl_context *ctx, struct density *d, const oxl_model *model,
                                       const struct density_rules *rules, struct density_change *out);
/* Keeps the statistics of the rows with keep (count) not 0, in order. */
OXL_INTERNAL void density_keep_rows(struct density *d, const uint8_t *keep, size_t count);
OXL_INTERNAL void density_reset_opacity(struct trained_model *trained, float alpha_min);
OXL_INTERNAL void density_archive(struct archive *a, struct density *d, size_t count);
/* Rebuilds the model and its moments, and clears the statistics. moved: a device has moved the rows and keeps
 * the moments. */
OXL_INTERNAL oxl_result density_apply(oxl_context *ctx, struct density *d, struct trained_model *trained,
                                      const struct density_change *change, int moved);
/* Fills `from` of renderer_move for the decided change; returns the number of rows that keep a second
 * lobe. */
OXL_INTERNAL size_t density_sources(const struct density *d, const oxl_model *model, uint32_t *from);

/* ---------------- ucd.c: weights by depth for density control, and their search */

/* Cost of a doubling of the Gaussians, in log loss: about what it gains in four densifications
 * (docs/log/ABLATION.md). */
#define UCD_GROWTH 0.02
#define UCD_PRECISION 0.2  /* of the prior: half of it in log loss for a weight 1 away */
#define UCD_OFFSET_MAX 1.0 /* limit of a single pair's distance from the prior */
#define UCD_SHIFT 0.5      /* of a point from the estimate: differences over less are lost in noise */
enum { UCD_SPAN = 4 };     /* densifications for a cost: the gain of the first shows after the third alone */

struct ucd {
    int on, learns;
    double z_near, z_far; /* limits of the middle band, camera z */
    double f[2];          /* f_mid, f_far: the estimate, or fixed */
    double prior[2];      /* of the estimate */
    /* sums over the pairs: how far each alone would move f_mid and f_far - f_mid from the prior */
    double offset[2];
    double cost[2];     /* of the two points of the pair in progress */
    double loss, count; /* at the start of the span: mean log loss, Gaussians */
    double loss_sum;    /* of log losses since the last densification: so many */
    int losses, pairs;  /* pairs: finished */
    int costs;          /* known in the pair in progress; -1: the span in progress is not one of a pair */
    int spans;          /* densifications in the span in progress */
    uint64_t seed;
    struct contrast contrast;
    char reason[256];
};
/* Sets whether it is on, and the limits of the bands. Logs nothing; ucd_describe gives the text. */
OXL_INTERNAL oxl_result ucd_begin(oxl_context *ctx, struct ucd *u, oxl_scene *scene, const oxl_ucd *options);
OXL_INTERNAL void ucd_describe(const struct ucd *u, char *out, size_t size);
OXL_INTERNAL void ucd_observe(struct ucd *u, double loss); /* call after each step */
/* f_mid, f_far of this densification */
OXL_INTERNAL void ucd_weights(struct ucd *u, size_t count, double f[2]);
/* the pair in progress is void: opacities were reset */
OXL_INTERNAL void ucd_restart(struct ucd *u);
OXL_INTERNAL void ucd_archive(struct archive *a, struct ucd *u);

/* ---------------- prune.c: removes the Gaussians that matter least */

#define PRUNE_FILE 2048 /* bytes of a PLY that are not rows: its header */
struct prune {
    oxl_keep keep;
    double row_bytes;           /* of the file, for OXL_KEEP_BYTES */
    int views;                  /* views of a score, at most; spread evenly */
    int start, end;             /* the phase: steps */
    int every, patience;        /* steps between checks; steps without a drop after which one is made */
    int drops, last;            /* drops made; step of the last */
    size_t first_count, target; /* at the phase's start (0: not yet), at its end */
    double drop_l1;             /* mean L1 before the last drop */
    double l1_sum;              /* since the last check */
    int l1_count;
    double validation_loss; /* auto: loss of the validation views at the phase's start */
};
/* densified: last step of density control; views: number of training views; row_bytes: prune_row_bytes. */
OXL_INTERNAL void prune_begin(struct prune *p, oxl_keep keep, int iterations, int densified, int views,
                              double row_bytes);
/* lobes: 1 if rows may have a second one */
OXL_INTERNAL double prune_row_bytes(int sh_degree, int lobes);
OXL_INTERNAL void prune_describe(const struct prune *p, char *out, size_t size); /* the result, as text */
/* call after each step; steps outside the phase are ignored */
OXL_INTERNAL void prune_observe(struct prune *p, int step, double l1);
/* 1: prune_due checks; `auto` then needs validation_loss */
OXL_INTERNAL int prune_is_check_step(const struct prune *p, int step);
/* After the step: number of `count` Gaussians to remove now. validation_loss: mean of the validation views,
 * for auto. */
OXL_INTERNAL size_t prune_due(struct prune *p, int step, size_t count, double validation_loss);
struct prune_of { /* what is pruned, and where it is seen */
    struct renderer *r;
    oxl_scene *scene;
    const oxl_render_options *options;
    const oxl_model *model;
};
/* keep (count): 0 for the `drop` that matter least, else 1. */
OXL_INTERNAL oxl_result prune_choose(oxl_context *ctx, const struct prune *p, const struct prune_of *of,
                                     size_t drop, uint8_t *keep);
OXL_INTERNAL void prune_archive(struct archive *a, struct prune *p);
/* Parts of prune_choose: the score of each row over the training views; keep[i] = 0 for the `drop` lowest, by
 * row where equal. */
OXL_INTERNAL oxl_result prune_score(oxl_context *ctx, const struct prune *p, const struct prune_of *of,
                                    float *score);
OXL_INTERNAL void prune_select(const float *score, size_t count, size_t drop, uint8_t *keep);

/* ---------------- transients.c: masks of moving objects */

/* of white: limit of an error in the mean; above it each fish raises the threshold of the next */
#define TRANSIENTS_MAX 0.05f
struct transients_square { /* of pixels, in the present view */
    /* difference of the mean colours, fraction of white; -1: all its pixels are masked */
    float error;
    float expected; /* largest expected error of the points in it; -1: no point */
    unsigned marks;
};
struct transients {
    size_t points;   /* of the scene; 0: off */
    float *expected; /* (points) running mean of the error at its position, over the views that see it */
    int32_t *place;  /* (points) its square in the present view, or -1 */
    struct transients_square *square;
    size_t square_capacity;
    double masked_fraction; /* fraction of masked pixels, smoothed over the last images */
};
OXL_INTERNAL oxl_result transients_begin(oxl_context *ctx, struct transients *t, const oxl_scene *scene,
                                         int on);
OXL_INTERNAL void transients_free(oxl_context *ctx, struct transients *t);
struct transients_view {
    const oxl_camera *camera;
    double near_plane;
    const float *rendered, *image; /* (3,H,W) */
    float *weight;                 /* (H,W): set to 0 where masked as transient */
    int has_mask;                  /* weight contains a mask; 0: all weights are 1 */
};
/* update 0: the expected errors do not change, as in the steps of a trial. */
OXL_INTERNAL oxl_result transients_mask(oxl_context *ctx, struct transients *t, const oxl_scene *scene,
                                        const struct transients_view *view, int update);
/* the masked fraction, as text */
OXL_INTERNAL void transients_describe(const struct transients *t, char *out, size_t size);
OXL_INTERNAL void transients_archive(struct archive *a, struct transients *t);

/* ---------------- scalar_adam.c: Adam for single numbers */

/* a larger gradient, or one that is not finite, changes nothing: its square is no float */
#define SCALAR_ADAM_GRADIENT_MAX 1e18
/* `at` and its moments; step: of this number, from 1. */
OXL_INTERNAL void scalar_adam_step(double *at, double *mean, double *square, double gradient, double rate,
                                   int step);

/* ---------------- medium_fit.c: the nine parameters of the medium */

struct medium_fit {
    int on, fixed, steps;              /* fixed: the tracks' values */
    double range;                      /* the survey's median; attenuation is per this range */
    double raw[9], mean[9], square[9]; /* before softplus: bD, bB, Binf by channel; Adam's moments */
};
OXL_INTERNAL void medium_fit_begin(struct medium_fit *f, oxl_scene *scene, const struct medium *continued);
/* Uses the medium fitted to the tracks, if the residuals support it and the depths span enough; why: the
 * evidence. Likewise lamp_set_from_tracks and exposure_set_from_tracks. */
OXL_INTERNAL void medium_fit_set_from_tracks(struct medium_fit *f, double span, const struct photometry *p,
                                             char *why, size_t size);
/* ratio of depths below which the medium is not identifiable: auto is off (docs/IMAGING.md) */
#define MEDIUM_FIT_SPAN_MIN 2
OXL_INTERNAL double medium_fit_span(oxl_scene *scene);
/* without tracks, after this step; 0: never */
OXL_INTERNAL int medium_fit_start_step(const oxl_train_options *options);
OXL_INTERNAL struct medium medium_fit_value(const struct medium_fit *f);
OXL_INTERNAL void medium_fit_start(struct medium_fit *f, oxl_scene *scene);
/* Converts the model's colours from those of training to those without the medium, or back. */
OXL_INTERNAL void medium_fit_scale_colours(const struct medium_fit *f, int to_clear, oxl_model *model);
OXL_INTERNAL void medium_fit_step(struct medium_fit *f, double progress, const double gradient[9]);
OXL_INTERNAL void medium_fit_archive(struct archive *a, struct medium_fit *f, int used);

/* ---------------- lamp.c: a light that moves with the camera */

struct lamp_fit {
    /* has_falloff: falloff is trained; frozen: nothing is */
    int on, has_falloff, frozen, steps, groups;
    int visits[LAMP_MAX]; /* steps of a camera */
    /* the first: cameras that have none of their own */
    struct lamp group[LAMP_MAX];
    double mean[LAMP_MAX][LAMP_TERMS], square[LAMP_MAX][LAMP_TERMS]; /* Adam's moments */
    double falloff, falloff_mean, falloff_square, reference;
};
OXL_INTERNAL void lamp_begin(struct lamp_fit *l, oxl_scene *scene, oxl_switch medium,
                             const struct imaging *continued);
OXL_INTERNAL void lamp_set_from_tracks(struct lamp_fit *l, oxl_switch mode, const struct photometry *p,
                                       char *why, size_t size);
OXL_INTERNAL void lamp_store(const struct lamp_fit *l, struct imaging *m);
/* of: lamp of the view's camera. */
OXL_INTERNAL void lamp_step(struct lamp_fit *l, const struct lamp *of, double progress,
                            const double shape[LAMP_TERMS], double falloff);
OXL_INTERNAL void lamp_archive(struct archive *a, struct lamp_fit *l, int used);

/* ---------------- exposure_fit.c: log gains of training images */

struct exposure_gradient {
    int step, view;                /* step 0: none */
    double progress, dlog_gain[3]; /* fraction of the run; dL/da */
};

struct exposure {
    oxl_switch mode;
    double known_until;   /* fraction of the run up to which known gains stay */
    struct imaging of;    /* the gains; on: they are applied */
    float *mean, *square; /* (views,3) Adam's moments */
    int *visits;          /* (views) steps of a view's gains */
    /* mean that the log gains are given after each step: 0, or the mean of the continued run */
    double level[3];
    struct exposure_gradient pending; /* gradient of the last step, not yet applied */
};
OXL_INTERNAL oxl_result exposure_begin(oxl_context *ctx, struct exposure *e, oxl_scene *scene,
                                       oxl_switch mode, int continued);
OXL_INTERNAL void exposure_free(oxl_context *ctx, struct exposure *e);
OXL_INTERNAL oxl_result exposure_copy(oxl_context *ctx, const struct exposure *from, struct exposure *to);
/* Applies the pending gradient and keeps that of this step. exposure_apply_pending applies it, unless its
 * step is later than `last`. */
OXL_INTERNAL void exposure_set_pending(struct exposure *e, const struct exposure_gradient *of);
OXL_INTERNAL void exposure_apply_pending(struct exposure *e, int last);
OXL_INTERNAL void exposure_set_from_tracks(struct exposure *e, const struct photometry *p, char *why,
                                           size_t size);
OXL_INTERNAL void exposure_archive(struct archive *a, struct exposure *e);

/* ---------------- free_space.c: the space between a camera and the points it observes */

enum { FREE_SPACE_GRID = 12 }; /* cells along each side of an image */

struct free_space_view { /* a training view */
    uint32_t image_row;  /* in colmap.image */
    const oxl_camera *camera;
    float depth[FREE_SPACE_GRID * FREE_SPACE_GRID]; /* camera z up to which a cell is free; 0: not known */
};
struct free_space {
    struct free_space_view *view; /* (views) by image_row; NULL: off */
    size_t views;
};
OXL_INTERNAL oxl_result free_space_begin(oxl_context *ctx, struct free_space *f, const oxl_scene *scene);
OXL_INTERNAL void free_space_free(oxl_context *ctx, struct free_space *f);
/* the state, as text */
OXL_INTERNAL void free_space_describe(const struct free_space *f, char *out, size_t size);
/* *carved (count): 1 for each Gaussian in free space; NULL: there is no free space. Free it with oxl_free. */
OXL_INTERNAL oxl_result free_space_carve(oxl_context *ctx, const struct free_space *f, const oxl_model *model,
                                         uint8_t **carved);

/* ---------------- track_depth.c: depths from the tracks */

struct track_depth_view {
    int seen;                  /* points observed; they are kept up to a limit */
    struct depth_point *point; /* px of the view's camera */
};
struct track_depth {
    int started;
    struct track_depth_view *view; /* (views); NULL: no tracks */
    struct depth_point *all;
};
/* window (views): only views with a window are used; NULL: all training views. */
OXL_INTERNAL oxl_result track_depth_begin(oxl_context *ctx, struct track_depth *d, const oxl_scene *scene,
                                          const struct image_window *window);
OXL_INTERNAL void track_depth_free(oxl_context *ctx, struct track_depth *d);
/* Some points of the step's view; returns the weight of each in the loss. */
OXL_INTERNAL double track_depth_of_step(const struct track_depth *d, int view, int step, double progress,
                                        int *count, struct depth_point out[DEPTH_POINTS]);

#endif
