/* model.h - Gaussians: planes of parameters. */
#ifndef OXL_MODEL_H
#define OXL_MODEL_H

#include "../core/core.h"

/* ---------------- model.c: planes of Gaussians */

#define MODEL_SH0 0.28209479177387814 /* Is Y_0^0 = 1 / (2 sqrt(pi)), so that colour = 0.5 + SH0 f_dc. */

/* Describes a model's memory: one allocation, in which each plane starts on a 64-byte line. Capacity is a
 * multiple of 16 and at least 16, so kernels may read and write whole packs of 16 rows up to it; rows from
 * count to capacity are finite (new ones: zero, identity rotation). */
/* Sets rows to 0, and their rotation to w = 1. */
OXL_INTERNAL void model_clear_rows(oxl_model *model, size_t first, size_t end);
/* Grows the capacity; rows stay, and planes move. */
OXL_INTERNAL oxl_result model_reserve(oxl_context *ctx, oxl_model *model, size_t capacity);
/* Changes the SH degree; new planes are zero. */
OXL_INTERNAL oxl_result model_set_degree(oxl_context *ctx, oxl_model *model, int sh_degree);
/* Copies a model over `to`, which is not freed before. */
OXL_INTERNAL oxl_result model_copy(oxl_context *ctx, const oxl_model *from, oxl_model *to);
OXL_INTERNAL int model_row_is_finite(const oxl_model *model, size_t row); /* with its second lobe */
/* Keeps the rows whose keep (count) is not 0, in their order and with their lobes, and clears the others. */
OXL_INTERNAL void model_keep_rows(oxl_model *model, const uint8_t *keep);

/* Returns the bytes of a Gaussian in a model file by model_file.c; MODEL_LOBE_BYTES are
 * those of its second lobe. */
enum { MODEL_LOBE_BYTES = 16 };
OXL_INTERNAL double model_row_bytes(int sh_degree);

/* Counts the planes of the second lobe, which are allocated only for the first `lobes`
 * rows, up to a whole pack. */
enum { MODEL_LOBE_PLANES = OXL_PLANES - OXL_LOBE };
#define MODEL_OPACITY 0.1              /* Sets the opacity of a new Gaussian [Kerbl 2023]. */
#define MODEL_LOBE_RATE_OPACITY 0.025f /* Sets Adam's rate of plane OXL_LOBE ["Prune Wisely", code]. */
#define MODEL_LOBE_RATE_SCALE 0.005f   /* Sets Adam's rate of planes OXL_LOBE + 1..3. */
/* Gives rows 0..lobes-1 a second lobe; new lobes are zero. */
OXL_INTERNAL oxl_result model_set_lobes(oxl_context *ctx, oxl_model *model, size_t lobes);
OXL_INTERNAL void model_drop_lobes(oxl_model *model);

/* Holds a model in training with Adam's first and second moments, running means of the gradient and of its
 * square, in the same planes. */
struct trained_model {
    oxl_model model, mean, square;
};
enum { TRAINED_PARTS = 3 };
/* Returns the model for k 0, its mean for 1, its square for 2. */
OXL_INTERNAL oxl_model *model_trained_part(struct trained_model *t, int k);
/* Creates moments of 0 for t->model. */
OXL_INTERNAL oxl_result model_trained_begin(oxl_context *ctx, struct trained_model *t);
OXL_INTERNAL void model_trained_free(oxl_context *ctx, struct trained_model *t);
OXL_INTERNAL oxl_result model_trained_set_degree(oxl_context *ctx, struct trained_model *t, int sh_degree);
/* Gives the active rows second lobes of these factors, and their moments. On failure rows
 * may be in another order. */
OXL_INTERNAL oxl_result model_trained_make_lobes(oxl_context *ctx, struct trained_model *t,
                                                 const uint8_t *active, float opacity_factor,
                                                 float scale_factor);

/* Multiplies colours by a factor per channel: all SH coefficients, and the offset 0.5. */
OXL_INTERNAL void model_scale_colour(oxl_model *model, const double factor[3]);

/* Copies what a model is rendered with: background, anti-aliasing and the viewers' first view. */
OXL_INTERNAL void model_copy_rendering(const oxl_model *from, oxl_model *to);

#endif
