/* model.h - Gaussians: planes of parameters. */
#ifndef OXL_MODEL_H
#define OXL_MODEL_H

#include "../core/core.h"

/* ---------------- model.c: planes of Gaussians */

#define MODEL_SH0 0.28209479177387814 /* Y_0^0 = 1 / (2 sqrt(pi)): colour = 0.5 + SH0 f_dc */

/* One allocation; each plane starts on a 64-byte line. Capacity is a multiple of 16 and at least 16, so
 * kernels may read and write whole packs of 16 rows up to it; rows from count to capacity are finite (fresh
 * ones: zero, identity rotation).
 * model_reserve keeps rows and does not shrink; planes move. model_copy overwrites `to` without freeing
 * it. */
/* Sets rows to 0, with a rotation of w = 1. */
OXL_INTERNAL void model_clear_rows(oxl_model *model, size_t first, size_t end);
OXL_INTERNAL oxl_result model_reserve(oxl_context *ctx, oxl_model *model, size_t capacity);
/* Changes the SH degree; new planes are zero. */
OXL_INTERNAL oxl_result model_set_degree(oxl_context *ctx, oxl_model *model, int sh_degree);
OXL_INTERNAL oxl_result model_copy(oxl_context *ctx, const oxl_model *from, oxl_model *to);
OXL_INTERNAL int model_row_is_finite(const oxl_model *model, size_t row); /* including its lobe */
/* Keeps the rows with keep (count) not 0 in their order, with their lobes; the others are cleared. */
OXL_INTERNAL void model_keep_rows(oxl_model *model, const uint8_t *keep);

/* Counts the bytes of a Gaussian in a model file, as model_write.c writes it; of its second lobe there. */
enum { MODEL_LOBE_BYTES = 16 };
OXL_INTERNAL double model_row_bytes(int sh_degree);

/* Counts the planes of the second lobe, which is allocated for the first `lobes` rows only, up to a whole
 * pack. */
enum { MODEL_LOBE_PLANES = OXL_PLANES - OXL_LOBE };
#define MODEL_OPACITY 0.1              /* of a new Gaussian; Kerbl 2023 */
#define MODEL_LOBE_RATE_OPACITY 0.025f /* Adam's, of plane OXL_LOBE ["Prune Wisely", code] */
#define MODEL_LOBE_RATE_SCALE 0.005f   /* of OXL_LOBE + 1..3 */
/* Gives rows 0..lobes-1 a lobe; new ones are zero. */
OXL_INTERNAL oxl_result model_set_lobes(oxl_context *ctx, oxl_model *model, size_t lobes);
OXL_INTERNAL void model_drop_lobes(oxl_model *model);
/* Moves the rows with active (count) not 0 to the front, each part in its order, and gives them lobes of
 * zeros. The model must have no lobes. */
OXL_INTERNAL oxl_result model_make_lobes(oxl_context *ctx, oxl_model *model, const uint8_t *active);

/* Holds a model in training with Adam's first and second moments: running means of the gradient and of its
 * square, in the same planes. */
struct trained_model {
    oxl_model model, mean, square;
};
enum { TRAINED_PARTS = 3 };
/* Returns the model, its mean or its square for k of 0, 1, 2. */
OXL_INTERNAL oxl_model *model_trained_part(struct trained_model *t, int k);
/* Creates moments of 0 for its model. */
OXL_INTERNAL oxl_result model_trained_begin(oxl_context *ctx, struct trained_model *t);
OXL_INTERNAL void model_trained_free(oxl_context *ctx, struct trained_model *t);
OXL_INTERNAL oxl_result model_trained_set_degree(oxl_context *ctx, struct trained_model *t, int sh_degree);
/* Gives the model's lobes these factors. On failure rows may be in another order. */
OXL_INTERNAL oxl_result model_trained_make_lobes(oxl_context *ctx, struct trained_model *t,
                                                 const uint8_t *active, float opacity_factor,
                                                 float scale_factor);

/* Multiplies colours by a factor per channel: all SH coefficients, and the offset 0.5. */
OXL_INTERNAL void model_scale_colour(oxl_model *model, const double factor[3]);

/* Copies what a model is rendered with: background, anti-aliasing and the viewers' first view. */
OXL_INTERNAL void model_copy_rendering(const oxl_model *from, oxl_model *to);

#endif
