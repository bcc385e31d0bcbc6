/* depth_loss.c - a loss on splats in front of points of known depth.
 *
 * The space between a camera and a point that it observes is free. With T the transmittance at its pixel
 * after the splats nearer than DEPTH_LOSS_FRACTION of its depth, the loss is the weight times the sum of 1 -
 * T over the points, and
 *     dL/dalpha_i = weight T / (1 - alpha_i)    for each splat i of them.
 * Only opacities have this gradient: a splat that was moved or reshaped would hide the point elsewhere.
 * Splats with a second lobe and those of the surroundings are ignored. Measured gains: docs/log/IMAGING.md.
 *
 * Invariant: the points' terms are added one after the other, in order.
 */
#include "kernels.h"
#include "../core/vecmath.h"

#define DEPTH_LOSS_FRACTION 0.8f /* points are off, and surfaces are thick */

static double depth_loss_alpha(const struct splat *s, const struct depth_point *p, double cutoff_bits)
{
    const double dy = (double)p->y - s->v, w = (double)p->x - s->u + s->k * dy;
    const double exponent = s->peak - s->a * w * w - s->e * dy * dy;
    return exponent < -cutoff_bits ? 0 : OXL_MIN(vecmath_exp(exponent * VECMATH_LN2), (double)ALPHA_MAX);
}

/* Returns the splat of a pair if it counts, or NULL. */
static const struct splat *depth_loss_splat(const struct bins *b, const struct pair *pair)
{
    return pair->splat < b->surroundings_row && !bins_lobe(b, pair->splat) ? &b->splat[pair->splat] : NULL;
}

static void depth_loss_add(const struct bins *b, const struct depth_point *p, double weight,
                           float (*sums)[SPLAT_SUMS])
{
    const int tile = (int)(p->y / TILE) * b->tiles_x + (int)(p->x / TILE);
    const struct pair *first = b->pair + b->tile_start[tile], *end = b->pair + b->tile_start[tile + 1],
                      *pair = first;
    double t = 1;
    for (; pair < end && b->splat[pair->splat].depth < DEPTH_LOSS_FRACTION * p->z; pair++) {
        const struct splat *s = depth_loss_splat(b, pair);
        if (s) t *= 1 - depth_loss_alpha(s, p, b->cutoff_bits);
    }
    for (end = pair, pair = first; t < 1 && pair < end; pair++) {
        const struct splat *s = depth_loss_splat(b, pair);
        const double alpha = s ? depth_loss_alpha(s, p, b->cutoff_bits) : 0;
        if (alpha < ALPHA_MAX) sums[pair->slot][SUM_D] += (float)(weight * t * alpha / (1 - alpha));
    }
}

OXL_INTERNAL void depth_loss_backward(const struct bins *bins, const struct depth_point *point, int count,
                                      double weight, float (*sums)[SPLAT_SUMS])
{
    for (int i = 0; i < count; i++)
        if (point[i].x >= 0 && point[i].y >= 0 && point[i].x < bins->tiles_x * TILE &&
            point[i].y < bins->tiles_y * TILE)
            depth_loss_add(bins, &point[i], weight, sums);
}
