/* ucd.c - Underwater-Compensated Densification: weights by depth for the statistics of density control (paper sec. 3.2, eq. 2).
 *
 * Water takes contrast with distance, and the gradients that ask for more Gaussians with it. So a gradient seen from between z_near and
 * z_far counts f_mid times, from beyond z_far f_far times: there alone, never in the optimiser. Both are learned during the run by
 * SPSA (spsa.c). The span between two densifications is a window: the first of the two was made with the point that is tried, and the
 * cost of that point is
 *     log of (loss after the window / loss before it)  +  UCD_GROWTH x dN / N,
 * dN the Gaussians that the densification made. Without the second term more would always look better.
 *
 * Photographs differ in loss far more than a window changes it. So each is compared with itself alone: `level` is what its
 * log loss would be at the window's start. A view met t steps into the window with y = log loss - level gives one equation y = slope t,
 * least squares of which is the window's slope; one met twice gives a second with t counted from the first. At the end all levels
 * move on by that slope. This costs a float and an int for each view.
 *
 * Model only what a scene requires: `auto` turns this on where contrast is seen to fade with depth (contrast.c), and says what it saw.
 *
 * Invariant: the state is a function of the scene, the options, the seed and the losses observed.
 */
#include "internal.h"
#include "vecmath.h"

#define UCD_GROWTH    0.05 /* what a doubling costs, in log loss; PAPER.md has what it was measured by */
#define UCD_CAP       5.0  /* on both weights [D] */
#define UCD_RECOVERY  500  /* steps after an opacity reset whose losses tell of the reset alone */
#define UCD_FADE_MIN  0.22 /* auto: log of 1.25; contrast falls by a fifth or more from near to far */
#define UCD_ERRORS    3.0  /* auto: standard errors that it must be away from none */
#define UCD_DEPTH_MAX 0.98 /* quantile of the points' depths that is z_max; the paper does not say [D] */
#define UCD_FRONT     0.10 /* quantiles of depth that auto compares */
#define UCD_BACK      0.90
enum { UCD_PAIRS_LEAST = 10 }; /* fewer cannot move the weights by more than noise does */

/* ---------------------------------------------------------------- options */

oxl_ucd oxl_ucd_default(void)
{
    return (oxl_ucd){.mode = OXL_UCD_AUTO, .f_mid = 1.5f, .f_far = 2.0f, .learn = 1};
}

oxl_result oxl_ucd_parse(oxl_context *ctx, const char *text, oxl_ucd *out)
{
    const char *at = text, *end = text + strlen(text);
    double      mid = 0, back = 0;
    *out = oxl_ucd_default();
    if (strcmp(text, "auto") == 0) return OXL_OK;
    out->mode = strcmp(text, "off") == 0 ? OXL_UCD_OFF : OXL_UCD_ON;
    if (out->mode == OXL_UCD_OFF || strcmp(text, "on") == 0) return OXL_OK;
    if (parse_double(&at, end, &mid) && *at++ == ',' && parse_double(&at, end, &back)) {
        out->f_mid = (float)mid;
        out->f_far = (float)back;
        out->learn = strcmp(at, ",fixed") != 0;
        if ((!*at || !out->learn) && mid >= 1 && back >= mid && back <= UCD_CAP) return OXL_OK;
    }
    return oxl_fail(
        ctx, OXL_ERR_USAGE,
        "'%s' is no weight by depth\nfix: on, off, auto, or where the search starts as 1.5,2 with 1 <= F_MID <= F_FAR <= %g "
        "(1.5,2,fixed: no search)",
        text, UCD_CAP);
}

/* ---------------------------------------------------------------- where the bands are, and whether */

static void ucd_place_bands(struct ucd *u, const oxl_scene *scene, enum oxl_ucd_bands bands)
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

/* Whether contrast fades enough to matter, and what was seen, in words. */
static void ucd_decide(struct ucd *u, const oxl_scene *scene)
{
    const struct contrast *c     = &u->contrast;
    const double           front = scene_depth_quantile(scene, UCD_FRONT), back = scene_depth_quantile(scene, UCD_BACK);
    const double           fade = c->beta * (back - front), error = c->error * (back - front);
    u->on = c->measured && fade >= UCD_FADE_MIN && fade >= UCD_ERRORS * error;
    if (!c->measured) snprintf(u->reason, sizeof u->reason, "off: there are no points that were seen from several depths");
    else
        snprintf(
            u->reason, sizeof u->reason,
            "%s: from depth %.3g to %.3g the photographs' contrast falls by %.0f %% (log %.2f +- %.2f, %zu points; on from %.2f)",
            u->on ? "on" : "off", front, back, 100 * (1 - vecmath_exp(-fade)), fade, error, c->points, UCD_FADE_MIN);
}

static oxl_result ucd_begin_search(oxl_context *ctx, struct ucd *u, int views, int pairs, uint64_t seed)
{
    spsa_begin(&u->spsa, u->f, UCD_CAP, pairs, seed);
    memcpy(u->f, u->spsa.f, sizeof u->f);
    u->too_short = u->learns && pairs < UCD_PAIRS_LEAST;
    u->learns    = u->learns && !u->too_short;
    if (!u->learns) return OXL_OK;
    u->views = views;
    u->level = oxl_calloc(ctx, (size_t)views + 1, sizeof *u->level);
    u->seen  = oxl_calloc(ctx, (size_t)views + 1, sizeof *u->seen);
    return u->level && u->seen ? OXL_OK : oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for the losses of %d views", views);
}

OXL_INTERNAL oxl_result ucd_begin(oxl_context *ctx, struct ucd *u, oxl_scene *scene, const oxl_ucd *options, int densifications)
{
    oxl_result rc = OXL_OK;
    *u            = (struct ucd){.on = options->mode == OXL_UCD_ON, .learns = options->learn};
    u->f[0]       = options->f_mid;
    u->f[1]       = options->f_far;
    snprintf(u->reason, sizeof u->reason, "%s: as asked for", u->on ? "on" : "off");
    if (options->mode == OXL_UCD_AUTO || (u->on && options->bands == OXL_UCD_FADING))
        rc = contrast_measure(ctx, scene, &u->contrast);
    if (rc == OXL_OK && options->mode == OXL_UCD_AUTO) ucd_decide(u, scene);
    u->learns = u->learns && u->on;
    if (rc != OXL_OK || !u->on) return rc;
    ucd_place_bands(u, scene, options->bands);
    rc = ucd_begin_search(ctx, u, oxl_scene_view_count(scene), densifications / 2, ctx->options.seed);
    if (rc != OXL_OK) ucd_free(ctx, u);
    return rc;
}

OXL_INTERNAL void ucd_free(oxl_context *ctx, struct ucd *u)
{
    oxl_free(ctx, u->level);
    oxl_free(ctx, u->seen);
    u->level = NULL;
    u->seen  = NULL;
}

OXL_INTERNAL void ucd_describe(const struct ucd *u, char *out, size_t size)
{
    const int used = snprintf(out, size, "depth weights %s", u->reason);
    if (!u->on || used < 0 || (size_t)used >= size) return;
    snprintf(out + used, size - (size_t)used, "; from depth %.3g f_mid %.2f, from %.3g f_far %.2f, %s", u->z_near, u->spsa.f[0],
             u->z_far, u->spsa.f[1],
             u->learns      ? "learned"
             : u->too_short ? "fixed: the run is too short to learn them"
                            : "fixed");
}

/* ---------------------------------------------------------------- a window */

OXL_INTERNAL void ucd_observe(struct ucd *u, int step, int view, double loss)
{
    float y;
    if (!u->learns || !(loss > 0 && loss <= DBL_MAX)) return;
    y = (float)vecmath_log(loss);
    if (u->seen[view] > 0) {
        const double t = step - OXL_MAX(u->seen[view], u->window);
        u->rise += t * (y - u->level[view]);
        u->time += t * t;
    }
    u->level[view] = y;
    u->seen[view]  = step;
}

OXL_INTERNAL void ucd_disturb(struct ucd *u, int step, int is_reset)
{
    u->disturbed = OXL_MAX(u->disturbed, is_reset ? step + UCD_RECOVERY : step);
}

/* The slope of the window that ends; the levels go to its end. */
static double ucd_end_window(struct ucd *u, int step)
{
    const double slope = u->time > 0 ? u->rise / u->time : 0;
    for (int i = 0; i < u->views; i++)
        if (u->seen[i] > 0) u->level[i] += (float)(slope * (step - OXL_MAX(u->seen[i], u->window)));
    return slope;
}

OXL_INTERNAL void ucd_before_control(struct ucd *u, int step, double f[2])
{
    if (u->learns) {
        const double slope   = ucd_end_window(u, step);
        const int    counted = u->opened && u->time > 0 && u->disturbed < u->window;
        if (counted) spsa_tell(&u->spsa, slope * (step - u->window) + UCD_GROWTH * u->growth);
        else spsa_skip(&u->spsa);
        spsa_ask(&u->spsa, u->f);
    }
    memcpy(f, u->f, sizeof u->f);
}

OXL_INTERNAL void ucd_after_control(struct ucd *u, int step, size_t before, size_t after)
{
    u->growth = before ? ((double)after - (double)before) / (double)before : 0;
    u->window = step;
    u->opened = 1;
    u->rise = u->time = 0;
}

OXL_INTERNAL void ucd_archive(struct archive *a, struct ucd *u)
{
    if (!u->learns) return; /* what it then is follows from scene and options */
    spsa_archive(a, &u->spsa);
    archive_doubles(a, u->f, 2);
    archive_doubles(a, &u->growth, 1);
    archive_doubles(a, &u->rise, 1);
    archive_doubles(a, &u->time, 1);
    archive_int(a, &u->window);
    archive_int(a, &u->opened);
    archive_int(a, &u->disturbed);
    archive_floats(a, u->level, (size_t)u->views);
    archive_ints(a, u->seen, (size_t)u->views);
    archive_expect(a, u->window >= 0 && u->disturbed >= 0);
    for (int i = 0; i < u->views; i++) archive_expect(a, u->seen[i] >= 0);
}
