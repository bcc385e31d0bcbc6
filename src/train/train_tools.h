/* train_tools.h - private to src/train and src/parts: archives, density control, numbers that are not
 * finite, Adam for single numbers; none of them knows the run (train_state.h). */
#ifndef OXL_TRAIN_TOOLS_H
#define OXL_TRAIN_TOOLS_H

#include "train.h"
#include "../render/render.h"
#include "../survey/image.h"
#include "../survey/imaging.h"
#include "../survey/photometry.h"
#include "../survey/survey.h"
#include "../model/model.h"

/* ---------------- archive.c: the state of a run */

/* A module lists its state once; the archive writes or reads it. After a failure, calls do nothing. A count
 * is stored before its elements and is checked against the rest of the file. */
struct archive {
    oxl_context *ctx;
    int reading;
    const char *path;
    FILE *file;
    uint64_t left; /* bytes still to read */
    oxl_result rc;
};
/* Writes or reads `count` values of `size` bytes. */
OXL_INTERNAL void archive_numbers(struct archive *a, void *data, size_t count, size_t size);
#define ARCHIVE(a, values, count) archive_numbers(a, values, count, sizeof *(values))
/* Writes the text, or replaces it by the one that is read. */
OXL_INTERNAL void archive_text(struct archive *a, struct text *t);
/* Writes the model, or replaces it by the one that is read. */
OXL_INTERNAL void archive_model(struct archive *a, oxl_model *model);
/* Fails a read of more than the file has left; returns 1 while nothing has failed. */
OXL_INTERNAL int archive_fits(struct archive *a, size_t count, size_t size);

/* For what surrounds a state in a file (large/checkpoint.c). */
OXL_INTERNAL void archive_fail(struct archive *a, oxl_result rc, const char *what);

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

/* Clears rows that are not finite. r: also rows that it could not render in its last view; NULL: none. */
OXL_INTERNAL struct renderer_nonfinite nonfinite_clear(const struct renderer *r,
                                                       struct trained_model *trained);

/* ---------------- density.c: split, prune, reset */

struct density { /* statistics since the last control; all zero: none yet */
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
    double gradient;        /* grow at this mean |dL/d(u,v)|, in units of half an image */
    double f_mid, f_far;    /* weights of the mid and far band [paper eq. 2]; used when there are bands */
    double extent;          /* of the scene */
    int split_large;        /* after the first reset interval [Kerbl 2023] */
    size_t cap;             /* on the number of Gaussians; 0: none */
    const oxl_terms *terms; /* with a rule of the caller's own, or NULL */
};
struct density_change {
    size_t removed, split;
};
OXL_INTERNAL void density_free(oxl_context *ctx, struct density *d);
OXL_INTERNAL oxl_result density_clear(oxl_context *ctx, struct density *d, size_t count);
OXL_INTERNAL oxl_result density_observe(oxl_context *ctx, struct density *d, struct renderer *r,
                                        size_t count);
/* Begins separate sums of gradients per depth band; z_near 0: one sum. Clears the statistics. */
OXL_INTERNAL oxl_result density_set_bands(oxl_context *ctx, struct density *d, size_t count, double z_near,
                                          double z_far);
/* Averages over the views in which the row was visible since the statistics were cleared, unweighted. */
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

/* ---------------- scalar_adam.c: Adam for single numbers */

/* Limit above which a gradient changes nothing: its square overflows float. */
#define SCALAR_ADAM_GRADIENT_MAX 1e18
/* Moves `at` and its moments by one step. step: its number, from 1. */
OXL_INTERNAL void scalar_adam_step(double *at, double *mean, double *square, double gradient, double rate,
                                   int step);

#endif
