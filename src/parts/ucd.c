/* ucd.c - Underwater-Compensated Densification: weights by depth for the statistics of density control (paper
 * sec. 3.2, eq. 2).
 *
 * Water reduces contrast with distance, and with it the gradients that trigger densification. So a gradient
 * observed at a depth from z_near to z_far is weighted by f_mid, beyond z_far by f_far: in density control
 * only, never in the optimizer.
 *
 * Both are fixed, or corrected during the run by SPSA (Spall 1998, "Implementation of the simultaneous
 * perturbation algorithm for stochastic optimization", IEEE Trans. AES 34(3)): no step is spent on it. For
 * UCD_SPAN densifications both weights are moved by random signs, for the next UCD_SPAN against them; the
 * difference of the two costs over the distance of the two points estimates the slope. The cost of a point is
 *     change of the mean log loss  +  UCD_GROWTH x dN / N,
 * dN the number of added Gaussians: without it more would always be better. Costs are nearly flat and noisy
 * (docs/log/TRAINING.md), so a prior with precision P holds the weights where they begin: the estimate is the
 * mean of the prior's and of (prior - slope / P) of each pair, each at most UCD_OFFSET_MAX away. Every second
 * pair is perpendicular to the one before it (Bhatnagar 2003). The search moves in f_mid and f_far - f_mid,
 * so that neither is stuck where f_far = f_mid.
 *
 * Model only what a scene requires: `auto` turns the weights on where contrast falls with depth (contrast.c),
 * and logs what was measured.
 *
 * Invariants: cap >= f_far >= f_mid >= 1, for the estimate and each point. The state is a function of the
 * scene, the options, the seed and the losses.
 */
#include "ucd.h"
#include "../core/option_rows.h"
#include "../core/vecmath.h"
#include "../survey/scene.h"

#define UCD_FADE_MIN 0.22  /* auto: log of 1.25; contrast falls by a fifth or more from near to far */
#define UCD_ERRORS 3.0     /* auto: standard errors from 0 */
#define UCD_DEPTH_MAX 0.98 /* quantile of the points' depths that is z_max; the paper does not say [D] */
#define UCD_FRONT 0.10     /* quantiles of depth that auto compares */
#define UCD_BACK 0.90
#define UCD_STREAM (UINT64_C(0x5350534) << 32) /* random numbers apart from those of steps and epochs */

/* ---------------- the bands, and the decision */

OXL_INTERNAL int ucd_fades(double fade, double error)
{
    return fade >= UCD_FADE_MIN && fade >= UCD_ERRORS * error;
}

/* Decides whether contrast falls enough, and writes the measurement as text. */
static void ucd_decide(struct ucd *u, const oxl_scene *scene)
{
    const struct contrast *c = &u->contrast;
    const double front = scene_depth_quantile(scene, UCD_FRONT), back = scene_depth_quantile(scene, UCD_BACK);
    const double fade = c->beta * (back - front), error = c->error * (back - front);
    u->on = c->measured && ucd_fades(fade, error);
    if (!c->measured) snprintf(u->reason, sizeof u->reason, "no points are seen from several depths");
    else
        snprintf(
            u->reason, sizeof u->reason,
            "contrast falls by %.0f %% from near to far; depths %.3g to %.3g, log ratio %.2f +- %.2f at %zu points; on from %.2f",
            100 * (1 - vecmath_exp(-OXL_MAX(0, fade))), front, back, fade, error, c->points, UCD_FADE_MIN);
}

OXL_INTERNAL oxl_result ucd_begin(oxl_context *ctx, struct ucd *u, const oxl_scene *scene, oxl_ucd mode)
{
    const double z_max = scene_depth_quantile(scene, UCD_DEPTH_MAX);
    oxl_result rc = OXL_OK;
    *u = (struct ucd){.on = mode == OXL_UCD_ON || mode == OXL_UCD_SEARCH,
                      .learns = mode == OXL_UCD_SEARCH,
                      .z_near = z_max / 3,
                      .z_far = 2 * z_max / 3,
                      .f = {UCD_MID, UCD_FAR},
                      .prior = {UCD_MID, UCD_FAR},
                      .seed = ctx->options.seed};
    snprintf(u->reason, sizeof u->reason, "as set");
    if (mode == OXL_UCD_AUTO) rc = contrast_measure(ctx, scene, &u->contrast);
    if (rc == OXL_OK && mode == OXL_UCD_AUTO) ucd_decide(u, scene);
    ucd_restart(u);
    return rc;
}

OXL_INTERNAL void ucd_describe(const struct ucd *u, char *out, size_t size)
{
    const int used = snprintf(out, size, "%s", u->reason);
    if (!u->on || used < 0 || (size_t)used >= size) return;
    snprintf(out + used, size - (size_t)used,
             u->learns ? "; from depth %.3g f_mid %.2f, from %.3g f_far %.2f, corrected by %d pairs of costs"
                       : "; from depth %.3g f_mid %.2f, from %.3g f_far %.2f, fixed",
             u->z_near, u->f[0], u->z_far, u->f[1], u->pairs);
}

/* ---------------- the search */

/* Moves f by so much in f_mid and in f_far - f_mid, within the bounds. */
static void ucd_move(const double f[2], double by_mid, double by_beyond, double out[2])
{
    const double beyond = OXL_MAX(0, f[1] - f[0] + by_beyond);
    out[0] = OXL_CLAMP(f[0] + by_mid, 1.0, UCD_CAP);
    out[1] = OXL_MIN(out[0] + beyond, UCD_CAP);
}

/* Computes the first or second point of the pair in progress; the signs are random, so a drift of the loss
 * has no bias. */
static void ucd_point(const struct ucd *u, int second, double out[2])
{
    const uint64_t signs =
        (random_bits(u->seed, UCD_STREAM, (uint64_t)u->pairs / 2) >> 62) ^ (uint64_t)(u->pairs % 2);
    const double shift = second ? -UCD_SHIFT : UCD_SHIFT;
    ucd_move(u->f, signs & 2 ? shift : -shift, signs & 1 ? shift : -shift, out);
}

OXL_INTERNAL void ucd_restart(struct ucd *u)
{
    u->costs = -1;
    u->spans = 0;
}

OXL_INTERNAL void ucd_observe(struct ucd *u, double loss)
{
    if (!(loss > 0 && loss <= DBL_MAX)) return;
    u->loss_sum += vecmath_log(loss);
    u->losses++;
}

static void ucd_step(struct ucd *u)
{
    double p[2], q[2];
    ucd_point(u, 0, p);
    ucd_point(u, 1, q);
    for (int i = 0; i < 2; i++) {
        /* as projected, not as meant */
        const double distance = i == 0 ? p[0] - q[0] : p[1] - p[0] - (q[1] - q[0]);
        const double slope = fabs(distance) >= UCD_SHIFT ? (u->cost[0] - u->cost[1]) / distance : 0;
        u->offset[i] += OXL_CLAMP(-slope / UCD_PRECISION, -UCD_OFFSET_MAX, UCD_OFFSET_MAX);
    }
    u->pairs++;
    ucd_move(u->prior, u->offset[0] / (u->pairs + 1), u->offset[1] / (u->pairs + 1), u->f);
}

/* Closes the span that ends here: its cost. */
static void ucd_close_span(struct ucd *u, double loss, double count)
{
    if (u->costs >= 0) u->cost[u->costs] = loss - u->loss + UCD_GROWTH * (count / u->count - 1);
    u->costs = u->costs >= 0 && !(fabs(u->cost[u->costs]) <= DBL_MAX) ? 0 : u->costs + 1;
    if (u->costs == 2) ucd_step(u);
    u->costs %= 2;
    u->loss = loss;
    u->count = count;
}

OXL_INTERNAL void ucd_weights(struct ucd *u, size_t count, double f[2])
{
    if (u->learns && ++u->spans > UCD_SPAN) {
        ucd_close_span(u, u->losses > 0 ? u->loss_sum / u->losses : NAN, (double)count);
        u->spans = 1;
    }
    u->loss_sum = 0;
    u->losses = 0;
    memcpy(f, u->f, sizeof u->f);
    if (u->learns && u->costs >= 0) ucd_point(u, u->costs, f);
}

/* ---------------- the part */

static oxl_result ucd_part_begin(struct train *t, void *state)
{
    struct ucd *u = state;
    char words[320];
    oxl_result rc = ucd_begin(t->ctx, u, t->scene, t->options->ucd);
    if (rc != OXL_OK) return rc;
    ucd_describe(u, words, sizeof words);
    if (t->options->ucd != OXL_UCD_OFF) selection_log(t, "depth weights", u->on, words);
    if (u->on) rc = density_set_bands(t->ctx, &t->density, t->trained.model.count, u->z_near, u->z_far);
    return rc;
}

/* Gives the loss of each step to the search while Gaussians are densified. */
static oxl_result ucd_before_observe(struct train *t, void *state)
{
    struct ucd *u = state;
    const oxl_result rc = u->learns ? step_flush(t) : OXL_OK;
    if (schedule_resets_opacity_at(t->options, t->step - 1)) ucd_restart(u);
    if (rc == OXL_OK) ucd_observe(u, t->last_loss);
    return rc;
}

static oxl_result ucd_before_density(struct train *t, void *state, struct density_rules *rules)
{
    double f[2];
    ucd_weights(state, t->trained.model.count, f);
    rules->f_mid = f[0];
    rules->f_far = f[1];
    return OXL_OK;
}

static void ucd_record(struct train *t, void *state)
{
    const struct ucd *u = state;
    char chosen[64], why[320];
    ucd_describe(u, why, sizeof why);
    snprintf(chosen, sizeof chosen, u->on ? "%.3g,%.3g" : "off", u->f[0], u->f[1]);
    selection_record(t, "ucd", chosen, why);
}

/* clang-format off */
static const oxl_option ucd_options[] = {
{"ucd", "off|on|auto|search", OXL_OPTION_CHOICE, OPTION_AT(train.ucd), 0, 3, PRESETS("auto", "auto", "search"), OXL_TIER_ADVANCED, TRAINING | RESULT | NOT_REFINED, "Scene content", "weight the gradients of the middle and far depth band in density control, which changes PSNR by -0.6 to +0.3 dB at an equal number of Gaussians; on: by 1.5 and 2; search: as on, then corrected by SPSA; auto: on if contrast fades with depth"},
{0}};
/* clang-format on */

OXL_INTERNAL const struct part part_ucd = {.name = "ucd",
                                           .size = sizeof(struct ucd),
                                           .option = ucd_options,
                                           .begin = ucd_part_begin,
                                           .is_plain = 1,
                                           .before_observe = ucd_before_observe,
                                           .before_density = ucd_before_density,
                                           .record = ucd_record};
