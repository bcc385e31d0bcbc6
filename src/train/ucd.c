/* ucd.c - Underwater-Compensated Densification: weights by depth for the statistics of density control (paper sec. 3.2, eq. 2).
 *
 * Water reduces contrast with distance, and with it the gradients that trigger densification. So a gradient seen from between z_near and
 * z_far counts f_mid times, from beyond z_far f_far times: in density control alone, never in the optimizer. Both are fixed, or learned
 * during the run by SPSA (spsa.c; --preset paper; docs/ABLATION.md: no gain was measured). Either point of a pair is tried from the same
 * state and on the same images (model_selection.c): training goes on with it for UCD_SPANS densifications and up to the next one, and the
 * cost of the point is
 *     mean log loss over the last half of a span  +  UCD_GROWTH x dN / N,
 * dN the number of added Gaussians. Without the second term more would always be better. Training continues from the point of lower
 * cost. A split raises the loss at first: measured after one span, growth costs, and all weights fall to 1 (docs/ABLATION.md).
 *
 * Two consecutive trials, as in Spall, differ in images, learning rate and the time since the last opacity reset as well: from two
 * starts the weights stayed far apart. Where the costs are flat, the prior moves the weights to those of a run without a search.
 *
 * Model only what a scene requires: `auto` turns this on where contrast falls with depth (contrast.c), and logs what was measured.
 *
 * Invariant: the state is a function of the scene, the options, the seed and the costs.
 */
#include "train.h"
#include "../core/vecmath.h"

#define UCD_GROWTH          0.02 /* cost of a doubling, in log loss: about what it gains in a trial (docs/ABLATION.md) */
#define UCD_PRIOR_PRECISION 0.01 /* half of it: gain in log loss for a weight 1 away from its default */
#define UCD_FADE_MIN        0.22 /* auto: log of 1.25; contrast falls by a fifth or more from near to far */
#define UCD_ERRORS          3.0  /* auto: standard errors from 0 */
#define UCD_DEPTH_MAX       0.98 /* quantile of the points' depths that is z_max; the paper does not say [D] */
#define UCD_FRONT           0.10 /* quantiles of depth that auto compares */
#define UCD_BACK            0.90
enum {
    UCD_PAIRS  = 12,           /* at most, spread over the densifications: each costs a trial */
    UCD_STRIDE = 2 * UCD_SPANS /* densifications between pairs, at least: trials add at most a half */
};

/* ---------------------------------------------------------------- the bands, and the decision */

static void ucd_set_bands(struct ucd *u, const oxl_scene *scene, enum oxl_ucd_bands bands)
{
    const double z_max = scene_depth_quantile(scene, UCD_DEPTH_MAX);
    u->z_near          = z_max / 3;
    u->z_far           = 2 * z_max / 3;
    if (bands == OXL_UCD_QUANTILES) {
        u->z_near = scene_depth_quantile(scene, 1.0 / 3);
        u->z_far  = scene_depth_quantile(scene, 2.0 / 3);
    }
    if (bands == OXL_UCD_FADING && u->contrast.beta > 0) { /* where contrast is 4/5 and 1/2 of what it is in front */
        const double front = scene_depth_quantile(scene, 1 - UCD_DEPTH_MAX);
        u->z_near          = front + 0.22314355131420976 / u->contrast.beta;
        u->z_far           = front + 0.6931471805599453 / u->contrast.beta;
    }
}

/* Whether contrast falls enough, and the measurement as text. */
static void ucd_decide(struct ucd *u, const oxl_scene *scene)
{
    const struct contrast *c     = &u->contrast;
    const double           front = scene_depth_quantile(scene, UCD_FRONT), back = scene_depth_quantile(scene, UCD_BACK);
    const double           fade = c->beta * (back - front), error = c->error * (back - front);
    u->on = c->measured && fade >= UCD_FADE_MIN && fade >= UCD_ERRORS * error;
    if (!c->measured) snprintf(u->reason, sizeof u->reason, "off: there are no points that were seen from several depths");
    else
        snprintf(u->reason, sizeof u->reason,
                 "%s: from depth %.3g to %.3g the images' contrast falls by %.0f %% (log %.2f +- %.2f, %zu points; on from %.2f)",
                 u->on ? "on" : "off", front, back, 100 * (1 - vecmath_exp(-fade)), fade, error, c->points, UCD_FADE_MIN);
}

OXL_INTERNAL void ucd_begin_search(struct ucd *u, int densifications, uint64_t seed)
{
    const oxl_ucd prior = oxl_ucd_default();
    u->stride           = OXL_MAX(UCD_STRIDE, (densifications + UCD_PAIRS / 2) / UCD_PAIRS);
    spsa_begin(&u->spsa, u->f, (double[]){prior.f_mid, prior.f_far}, UCD_PRIOR_PRECISION, UCD_CAP, seed);
    memcpy(u->f, u->spsa.f, sizeof u->f);
    u->too_short = u->learns && densifications < UCD_DENSIFICATIONS;
    u->learns    = u->learns && !u->too_short;
}

OXL_INTERNAL oxl_result ucd_begin(oxl_context *ctx, struct ucd *u, oxl_scene *scene, const oxl_ucd *options, int densifications)
{
    oxl_result rc = OXL_OK;
    *u            = (struct ucd){.on = options->mode == OXL_UCD_ON, .learns = options->learn};
    u->f[0]       = options->f_mid;
    u->f[1]       = options->f_far;
    snprintf(u->reason, sizeof u->reason, "%s: as set", u->on ? "on" : "off");
    if (options->mode == OXL_UCD_AUTO || (u->on && options->bands == OXL_UCD_FADING))
        rc = contrast_measure(ctx, scene, &u->contrast);
    if (rc == OXL_OK && options->mode == OXL_UCD_AUTO) ucd_decide(u, scene);
    u->learns = u->learns && u->on;
    if (rc != OXL_OK || !u->on) return rc;
    ucd_set_bands(u, scene, options->bands);
    ucd_begin_search(u, densifications, ctx->options.seed);
    return OXL_OK;
}

OXL_INTERNAL void ucd_describe(const struct ucd *u, char *out, size_t size)
{
    const int used = snprintf(out, size, "depth weights %s", u->reason);
    if (!u->on || used < 0 || (size_t)used >= size) return;
    snprintf(out + used, size - (size_t)used, "; from depth %.3g f_mid %.2f, from %.3g f_far %.2f, %s", u->z_near, u->f[0],
             u->z_far, u->f[1],
             u->learns      ? "learned"
             : u->too_short ? "fixed: the run is too short to learn them"
                            : "fixed");
}

/* ---------------------------------------------------------------- the search */

OXL_INTERNAL int ucd_tries(const struct ucd *u)
{
    return u->learns && u->densified >= u->spsa.pair * u->stride;
}

OXL_INTERNAL void ucd_ask(const struct ucd *u, double f[2])
{
    spsa_ask(&u->spsa, f);
}

OXL_INTERNAL double ucd_update(struct ucd *u, double log_loss, double growth)
{
    const double cost = log_loss + UCD_GROWTH * growth;
    if (spsa_update(&u->spsa, cost)) memcpy(u->f, u->spsa.f, sizeof u->f);
    return cost;
}

OXL_INTERNAL void ucd_archive(struct archive *a, struct ucd *u)
{
    if (!u->learns) return; /* otherwise the state follows from scene and options */
    spsa_archive(a, &u->spsa);
    archive_doubles(a, u->f, 2);
    archive_int(a, &u->densified);
    archive_expect(a, u->densified >= 0);
}
