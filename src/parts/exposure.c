/* exposure.c - three log gains for each training image, optimised with the scene.
 *
 * Without them a camera that adapts its exposure teaches the Gaussians fog and seams. The rendered image is
 * multiplied by exp(a_kc) before the loss (render/exposure.c); a_k has its own Adam state (Kingma & Ba 2015),
 * since each image is visited once an epoch, and a prior that draws it towards the line between its
 * neighbours, of the same camera, in file order. After each step the mean over the known training images is
 * set to exactly zero (the projection of LichtFeld Studio PR 1892): else scene and gains drift together, and
 * held-out views, which stand at mean exposure, lose dB with it (measured before: 2 to 6).
 *
 * They start from the fit to the tracks (survey/photometry.c) and do not change for EXPOSURE_HOLD of the run,
 * while Gaussians are coarse.
 *
 * auto: a model without gains shows a place with the mean gain of the views that see it; a held-out view has
 * about the gain of its neighbours. So gains are on where neighbours explain more of the tracks' gains (the
 * root of the difference of squares) than EXPOSURE_CLEAR times the tracks' noise, or than EXPOSURE_SMOOTHER
 * times what they leave. They are on, too, where exposures jump by EXPOSURE_BRACKETS, as no single
 * brightness fits the images. Where gains are refused, lamp and medium have the values of a fit without
 * them, if it shows the same parts (train_imaging.c).
 *
 * Rendering on a device, a step's gains do not depend on the gradient of the step before: that is read while
 * the device works on the step
 * (exposure_apply_pending). On the CPU they do.
 *
 * Invariant: off changes no byte of the result. The state is archived; the gains of a step depend on the
 * state before it alone.
 */
#include "exposure.h"
#include "../core/option_rows.h"
#include "../core/vecmath.h"
#include "../survey/scene.h"

#define EXPOSURE_RATE 0.03 /* of the first step, in log units; docs/UNDERWATER.md has what others cost */
#define EXPOSURE_LAST 0.02 /* of that at the end of the run */
#define EXPOSURE_BETA1 0.8 /* a mean over 5 visits: a short run has 30 */
#define EXPOSURE_BETA2 0.95
#define EXPOSURE_EPSILON 1e-12 /* against division by 0 */
#define EXPOSURE_SMOOTH 0.1    /* of the prior: gradient for a log unit off the neighbours' line */
#define EXPOSURE_HOLD 0.1      /* of the run: the tracks' gains are kept */
/* what neighbours explain over the noise: gains are worth -0.5 to 0.25 dB at 0.8 to 1.1, 0.3 to 0.8 at 1.7 to
 * 2.6, and cost 0.6 dB in a viewer at 3.0 in brighton_beach (docs/log/IMAGING.md) */
#define EXPOSURE_CLEAR 1.5
/* what neighbours explain over what they leave: 3.4 in subvo_pool, which gains 0.23 dB, and 0 to 3.0 in
 * surveys that the noise decides (docs/log/IMAGING.md) */
#define EXPOSURE_SMOOTHER 3.0
/* difference of images from which gains are on anyway; surveys have .04 to .13 (docs/log/IMAGING.md) */
#define EXPOSURE_BRACKETS 0.3

static oxl_result exposure_begin(struct train *t, void *state)
{
    struct exposure *e = state;
    const int views = t->scene->view_count;
    oxl_result rc = OXL_OK;
    e->mode = !t->continues ? t->options->exposure : t->imaging->on ? OXL_ON : OXL_OFF;
    if (t->task.frozen) e->known_until = 2;
    if (e->mode == OXL_OFF) return OXL_OK;
    rc = imaging_create(t->ctx, views, &e->of);
    if (rc == OXL_OK) rc = imaging_set_cameras(t->ctx, t->scene, &e->of);
    e->mean = oxl_calloc(t->ctx, 3 * (size_t)views + 1, sizeof *e->mean);
    e->square = oxl_calloc(t->ctx, 3 * (size_t)views + 1, sizeof *e->square);
    e->visits = oxl_calloc(t->ctx, (size_t)views + 1, sizeof *e->visits);
    if (rc == OXL_OK && (!e->mean || !e->square || !e->visits)) rc = OXL_ERR_MEMORY;
    if (rc != OXL_OK) return rc;
    e->of.on = e->mode == OXL_ON;
    if (t->continues) imaging_copy(t->imaging, &e->of);
    for (int c = 0; c < 3; c++) e->level[c] = imaging_mean(&e->of, c);
    return OXL_OK;
}

static void exposure_free(struct train *t, void *state)
{
    struct exposure *e = state;
    imaging_free(t->ctx, &e->of);
    OXL_FREE(t->ctx, e->mean, e->square, e->visits);
}

/* Steps the view's gains along dL/da, and projects them to the mean `level`. progress: fraction of the run.
 * */
static void exposure_step(struct exposure *e, int view, double progress, const double dlog_gain[3])
{
    const double rate = EXPOSURE_RATE * vecmath_exp(progress * vecmath_log(EXPOSURE_LAST));
    float *a = e->of.log_gain + 3 * view, between[3];
    const int n = ++e->visits[view];
    const double correct1 = 1 - vecmath_exp(n * vecmath_log(EXPOSURE_BETA1));
    const double correct2 = 1 - vecmath_exp(n * vecmath_log(EXPOSURE_BETA2));
    imaging_interpolate(&e->of, view, between);
    if (!e->of.known[view]) memcpy(a, between, sizeof between);
    e->of.known[view] = 1;
    for (int c = 0; c < 3; c++) {
        float *m = &e->mean[3 * view + c], *v = &e->square[3 * view + c];
        const double g = dlog_gain[c] + EXPOSURE_SMOOTH * (a[c] - between[c]);
        if (!(fabs(g) <= SCALAR_ADAM_GRADIENT_MAX)) continue;
        *m = (float)(EXPOSURE_BETA1 * *m + (1 - EXPOSURE_BETA1) * g);
        *v = (float)(EXPOSURE_BETA2 * *v + (1 - EXPOSURE_BETA2) * g * g);
        a[c] -= (float)(rate * (*m / correct1) / (sqrt(*v / correct2) + EXPOSURE_EPSILON));
        a[c] = (float)OXL_CLAMP(a[c], vecmath_log(EXPOSURE_MIN), -vecmath_log(EXPOSURE_MIN));
    }
    imaging_centre(&e->of, e->level);
}

/* Takes the step of the pending gradient, unless its step is later than `last`. */
static void exposure_apply_pending(struct exposure *e, int last)
{
    if (e->pending.step == 0 || e->pending.step > last) return;
    exposure_step(e, e->pending.view, e->pending.progress, e->pending.dlog_gain);
    e->pending.step = 0;
}

/* Computes the rms of what a view's neighbours leave of the gains that are fitted, in log units. */
static double exposure_left(const struct oxl_imaging *m, const uint8_t *fitted)
{
    double square = 0;
    int known = 0;
    for (int i = 0; i < m->views; i++) {
        float predicted[3];
        imaging_predict(m, i, predicted);
        for (int c = 0; c < 3; c++) {
            const double e = (double)m->log_gain[3 * i + c] - (double)predicted[c];
            if (fitted[i] >> c & 1) square += e * e, known++;
        }
    }
    return sqrt(known ? square / known : 0);
}

OXL_INTERNAL void exposure_set_from_tracks(struct exposure *e, const struct photometry *p, char *why,
                                           size_t size)
{
    int on = 0;
    snprintf(why, size, p->points ? "images do not differ" : "too few points are seen in several images");
    if (p->parts & PHOTOMETRY_GAINS) {
        double left, explained, noise;
        memcpy(e->of.log_gain, p->log_gain, 3 * (size_t)e->of.views * sizeof *e->of.log_gain);
        for (int i = 0; i < e->of.views; i++) e->of.known[i] = p->fitted[i] != 0;
        imaging_centre(&e->of, e->level);
        left = exposure_left(&e->of, p->fitted);
        explained = sqrt(OXL_MAX(0, p->unexplained * p->unexplained - left * left));
        noise = p->residual / p->brightness;
        on = explained > OXL_MIN(EXPOSURE_CLEAR * noise, EXPOSURE_SMOOTHER * left) ||
             p->unexplained >= EXPOSURE_BRACKETS;
        e->known_until = EXPOSURE_HOLD;
        snprintf(
            why, size,
            "images differ by %.1f %%; this is the rms gain relative to other images of the same points (%zu points, %zu observations); "
            "neighbouring images predict %.1f %% and leave %.1f %%; auto is on above %.2g times that, or %.2g times the noise of %.1f %%",
            100 * p->unexplained, p->points, p->observations, 100 * explained, 100 * left, EXPOSURE_SMOOTHER,
            EXPOSURE_CLEAR, 100 * noise);
    }
    if (e->mode == OXL_AUTO) e->of.on = on;
    if (!e->of.on) imaging_clear(&e->of);
}

static void exposure_archive(struct archive *a, struct train *t, void *state)
{
    struct exposure *e = state;
    const size_t views = (size_t)e->of.views;
    (void)t;
    if (e->mode == OXL_OFF) return;
    ARCHIVE(a, &e->of.on, 1);
    ARCHIVE(a, e->level, 3);
    ARCHIVE(a, e->of.log_gain, 3 * views);
    ARCHIVE(a, e->of.known, views);
    ARCHIVE(a, e->mean, 3 * views);
    ARCHIVE(a, e->square, 3 * views);
    ARCHIVE(a, e->visits, views);
    ARCHIVE(a, &e->pending, 1);
}

/* ---------------- the part */

static int exposure_tracks(const struct train *t, const void *state)
{
    const struct exposure *e = state;
    return t->options->exposure != OXL_OFF && (!e->is_decided || e->of.on) ? PHOTOMETRY_GAINS : 0;
}

static void exposure_use_tracks(struct train *t, void *state, const struct photometry *p)
{
    struct exposure *e = state;
    char why[400];
    if (t->options->exposure == OXL_OFF || e->is_decided) return;
    exposure_set_from_tracks(e, p, why, sizeof why);
    selection_record_auto(t, "exposure", t->options->exposure, e->of.on, why);
    e->is_decided = (p->parts & PHOTOMETRY_GAINS) != 0;
}

static void exposure_set_gain(struct train *t, void *state, struct train_deferred *step, int learns)
{
    struct exposure *e = state;
    if (learns) exposure_apply_pending(e, t->step - 2);
    step->has_gain = e->of.on;
    if (e->of.on) oxl_imaging_gain(&e->of, step->view, step->gain);
}

static void exposure_after_loss(struct train *t, void *state, const struct train_deferred *step,
                                const struct renderer_loss *loss)
{
    struct exposure *e = state;
    const double progress = (double)step->step / t->options->iterations, *d = loss->dlog_gain;
    exposure_apply_pending(e, INT_MAX);
    if (e->of.on && (progress >= e->known_until || !e->of.known[step->view]))
        e->pending = (struct exposure_gradient){step->step, step->view, progress, {d[0], d[1], d[2]}};
    if (!renderer_has_device(t->renderer)) exposure_apply_pending(e, step->step);
}

static void exposure_store(struct train *t, void *state, oxl_model *model)
{
    struct exposure *e = state;
    (void)model;
    *t->imaging = e->of;
    e->of = (struct oxl_imaging){0};
}

/* clang-format off */
static const oxl_option exposure_options[] = {
{"exposure", "off|on|auto", OXL_OPTION_CHOICE, OPTION_AT(train.exposure), 0, 2, EACH("auto"), OXL_TIER_BASIC, TRAINING | RESULT, "Scene content", "fit each image's brightness and white balance; auto: if neighbouring images predict them"},
{0}};
/* clang-format on */

OXL_INTERNAL const struct part part_exposure = {.name = "exposure",
                                                .size = sizeof(struct exposure),
                                                .option = exposure_options,
                                                .begin = exposure_begin,
                                                .free = exposure_free,
                                                .archive = exposure_archive,
                                                .tracks = exposure_tracks,
                                                .use_tracks = exposure_use_tracks,
                                                .set_gain = exposure_set_gain,
                                                .after_loss = exposure_after_loss,
                                                .store = exposure_store};
