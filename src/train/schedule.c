/* schedule.c - functions of options and step: learning rates, steps of density control, sizes. */
#include "train_state.h"
#include "../core/vecmath.h"
#include "../survey/scene.h"

/* iterations before the first densification, unless a quarter of the run is less */
#define SCHEDULE_WARM_UP 500
#define SCHEDULE_DENSIFY_FROM 0.025f /* of the run: the first densification, or later [3DGS: 500 of 30 000] */
#define SCHEDULE_RESET_INTERVAL 0.1f /* of the run, between opacity resets, */
#define SCHEDULE_RESET_MIN 3000      /* but so many iterations at least [Kerbl 2023] */
#define SCHEDULE_RATE_OPACITY 0.025f /* learning rate of opacity logits [Kerbl 2023] */
/* iterations without a reset before density control ends: the loss recovers in them */
#define SCHEDULE_RESET_RECOVERY 1000
#define SCHEDULE_RESET_RECOVERY_FRACTION 0.025 /* of the run: the same for long runs, where it is more */
/* training pixels for each Gaussian at least: it has up to 59 numbers, a pixel 3 (METHOD.md) */
#define SCHEDULE_PIXELS_EACH 60
#define SCHEDULE_POINTS_MORE 2    /* times as many where so many points are there, */
#define SCHEDULE_POINTS_FEW 10000 /* or so many, which take no time */
/* px: half the sides of smaller images cost more than they save (docs/log/TRAINING.md) */
#define SCHEDULE_COARSE_SIDE 640
#define SCHEDULE_COARSE_AUTO 0.75 /* of the run, for larger ones (docs/log/TRAINING.md) */
/* auto: three densifications in a run of 150 to 500 iterations, for its quarter before half of it */
enum { SCHEDULE_DENSIFY_LEAST = 15, SCHEDULE_DENSIFY_MOST = 50 };
/* iterations from which Kerbl's momentum is the better one; not tried from 2000 to this */
#define SCHEDULE_MOMENTUM_ITERATIONS 7000
#define SCHEDULE_BETA_MIN 0.5 /* of the mean gradient */
/* of the mean of its square: 1 less it, as floats, keeps three digits */
#define SCHEDULE_BETA_MAX 0.99999
#define SCHEDULE_REFERENCE_ITERATIONS 30000 /* iterations that the rates were chosen for [Kerbl 2023] */
/* iterations from which opacities and colours have 3DGS's rates (docs/log/TRAINING.md) */
#define SCHEDULE_BRISK_ITERATIONS 2000
#define SCHEDULE_SHORTEST_RUN 700 /* iterations: shorter runs have the rates of this one */
/* rates other than of positions begin larger by this power of a short run's factor */
#define SCHEDULE_EARLY_EXPONENT 0.5
#define SCHEDULE_EARLY_UNTIL 0.5 /* of the run: until then those rates are larger */
/* of the run: alpha_min holds until then, ALPHA_MIN from then on */
#define SCHEDULE_ALPHA_MIN_UNTIL 0.8
#define SCHEDULE_RATES_MAX 10.0 /* of geometry: bounds how much larger steps get where views show few rows */
/* steps to which those of a model for viewers without medium or gains are tripled; beyond they are doubled */
#define SCHEDULE_VIEWER_MORE 300
#define SCHEDULE_COOLDOWN_END 0.1 /* factor on the learning rates at the end of a run */

/* Returns the run's length, in steps of the whole survey. */
static int schedule_length(const oxl_train_options *o)
{
    return o->survey_iterations > 0 ? o->survey_iterations : o->iterations;
}

/* Returns the steps of this run for one of the whole survey's. */
static double schedule_scale(const oxl_train_options *o)
{
    return (double)o->iterations / schedule_length(o);
}

/* Returns the factor of a run that is shorter than `from` iterations; 1: it is not. */
static double schedule_factor_below(const oxl_train_options *o, double from)
{
    const double iterations = OXL_MAX(schedule_length(o), SCHEDULE_SHORTEST_RUN);
    return iterations < from ? vecmath_exp(o->short_run_exponent * vecmath_log(from / iterations)) : 1;
}

OXL_INTERNAL double schedule_short_run_factor(const oxl_train_options *o)
{
    return schedule_factor_below(o, SCHEDULE_REFERENCE_ITERATIONS);
}

/* Scales have the factor of Adam's moments, too (docs/METHOD.md). */
OXL_INTERNAL float schedule_scale_rate(const oxl_train_options *o)
{
    return (float)(schedule_short_run_factor(o) *
                   sqrt(schedule_factor_below(o, SCHEDULE_MOMENTUM_ITERATIONS)) * o->lr_scale);
}

/* Returns how far the cool-down is: 0 until it begins, 1 at its end. */
static double schedule_cooldown(const struct train *t)
{
    const double left = 1 - (double)(t->step - 1) / OXL_MAX(1, t->options->iterations - 1);
    return left < t->options->cooldown ? 1 - left / t->options->cooldown : 0;
}

/* Returns the alpha below which a contribution is omitted; in the last part of a run, the one of viewers. */
OXL_INTERNAL float schedule_alpha_min(const struct train *t)
{
    return t->step <= SCHEDULE_ALPHA_MIN_UNTIL * t->options->iterations ? t->options->alpha_min : 0;
}

/* Falls exponentially from the first to the last rate; in a straight line where one of them is 0 and has no
 * logarithm. */
static double schedule_position_rate(const oxl_train_options *o, double progress)
{
    double first = o->lr_position, last = o->lr_position_final;
    if (!(first > 0) || !(last > 0)) return first + (last - first) * progress;
    first = vecmath_log(first), last = vecmath_log(last);
    return vecmath_exp(first + (last - first) * progress);
}

/* Returns the factor on the rates of geometry where views show few of the Gaussians. A row's moments grow
 * with the views that show it, but are corrected for bias as if each step had been one: its steps are
 * larger, by the root of (1 - b2^n) / (1 - b2^(n share)). That makes up for the steps that it misses, up to
 * SCHEDULE_RATES_MAX with the factor of short runs; beyond, it is noise (docs/log/TRAINING.md). A factor of
 * short runs beyond that limit is the one that was asked for, and is not reduced. */
static double schedule_seldom_factor(const struct train *t, const oxl_adam *adam)
{
    const double b = vecmath_log(adam->beta[1]), shorter = schedule_short_run_factor(t->options);
    double larger;
    if (!(t->shown > 0)) return 1;
    larger = sqrt((1 - vecmath_exp(adam->step * b)) / (1 - vecmath_exp(adam->step * t->shown * b)));
    return OXL_MIN(1, OXL_MAX(SCHEDULE_RATES_MAX, shorter) / (larger * shorter));
}

OXL_INTERNAL oxl_adam schedule_adam_params(const struct train *t)
{
    const oxl_train_options *o = t->options;
    const double short_run_factor = schedule_short_run_factor(o),
                 momentum_factor = schedule_factor_below(o, SCHEDULE_MOMENTUM_ITERATIONS),
                 brisk = schedule_factor_below(o, SCHEDULE_BRISK_ITERATIONS);
    const double progress = (double)(t->step - 1) / OXL_MAX(1, o->iterations - 1);
    const float mean = (float)(short_run_factor * schedule_position_rate(o, progress) * t->scene->extent);
    const double early = SCHEDULE_EARLY_EXPONENT * OXL_MAX(0, 1 - progress / SCHEDULE_EARLY_UNTIL) *
                         vecmath_log(short_run_factor);
    oxl_adam adam = {.beta = RENDERER_BETAS, .step = t->step - t->task.first};
    adam.beta[0] = OXL_MAX(SCHEDULE_BETA_MIN, 1 - (1 - adam.beta[0]) * momentum_factor * momentum_factor);
    adam.beta[1] =
        OXL_MIN(SCHEDULE_BETA_MAX, 1 - (1 - adam.beta[1]) / (momentum_factor * sqrt(momentum_factor)));
    for (int k = 0; k < OXL_PLANES; k++)
        adam.rate[k] = k < OXL_LOG_SCALE  ? mean
                       : k < OXL_ROTATION ? schedule_scale_rate(o)
                       : k < OXL_OPACITY  ? (float)(short_run_factor * o->lr_rotation)
                       : k < OXL_SH       ? (float)(brisk * SCHEDULE_RATE_OPACITY)
                       : k < OXL_SH + 3   ? (float)(brisk * o->lr_sh0)
                       : k < OXL_LOBE     ? (float)(brisk * sqrt(short_run_factor) * o->lr_sh)
                       : k == OXL_LOBE    ? MODEL_LOBE_RATE_OPACITY
                                          : MODEL_LOBE_RATE_SCALE;
    for (int k = 0; k < OXL_OPACITY; k++) adam.rate[k] *= (float)schedule_seldom_factor(t, &adam);
    for (int k = 0; k < OXL_PLANES; k++)
        adam.rate[k] *= (float)vecmath_exp((k < OXL_LOG_SCALE ? 0 : early) +
                                           schedule_cooldown(t) * vecmath_log(SCHEDULE_COOLDOWN_END));
    return adam;
}

oxl_adam oxl_adam_at(const oxl_scene *scene, const oxl_train_options *options, int step)
{
    const struct train t = {.scene = scene, .options = options, .step = step};
    return schedule_adam_params(&t);
}

/* Returns the steps between densifications; auto: in a block as many densifications as in the whole run. */
static int schedule_densify_interval(const oxl_train_options *o)
{
    const int every = OXL_CLAMP(schedule_length(o) / 10, SCHEDULE_DENSIFY_LEAST, SCHEDULE_DENSIFY_MOST);
    return o->densify_every > 0 ? o->densify_every : (int)OXL_MAX(1, every * schedule_scale(o) + 0.5);
}

/* Follows 3DGS's schedule, which is one of 30 000 iterations. As fractions of the run it shrinks with it,
 * but not what has a time of its own: the first images must be learned before gradients say where detail is
 * missing, and a reset must be made up for. */
OXL_INTERNAL int schedule_densifies_at(const oxl_train_options *o, int step)
{
    const double from = OXL_MAX(SCHEDULE_DENSIFY_FROM * o->iterations,
                                OXL_MIN(SCHEDULE_WARM_UP * schedule_scale(o), 0.25 * o->iterations));
    return step >= from && step <= o->densify_until * o->iterations &&
           step % schedule_densify_interval(o) == 0;
}

OXL_INTERNAL int schedule_reset_interval(const oxl_train_options *o)
{
    return (int)OXL_MAX(SCHEDULE_RESET_MIN * schedule_scale(o), SCHEDULE_RESET_INTERVAL * o->iterations);
}

/* Allows no reset so late that density control ends, and pruning takes its scores, before opacities have
 * recovered. */
OXL_INTERNAL int schedule_resets_opacity_at(const oxl_train_options *o, int step)
{
    const double recovery = OXL_MAX(SCHEDULE_RESET_RECOVERY * schedule_scale(o),
                                    SCHEDULE_RESET_RECOVERY_FRACTION * o->iterations);
    const int interval = schedule_reset_interval(o); /* 0: of a block of few steps */
    return step + recovery <= o->densify_until * o->iterations && interval && step % interval == 0;
}

OXL_INTERNAL double schedule_coarse_fraction(const oxl_train_options *o, int width, int height)
{
    if (o->coarse >= 0) return o->coarse;
    return OXL_MAX(width, height) >= SCHEDULE_COARSE_SIDE ? SCHEDULE_COARSE_AUTO : 0;
}

OXL_INTERNAL int schedule_training_views(const oxl_scene *scene)
{
    int views = 0;
    for (int i = 0; i < scene->view_count; i++) views += !scene->view[i].is_test;
    return views;
}

OXL_INTERNAL double schedule_pixels(const oxl_scene *scene)
{
    double pixels = 0;
    for (int i = 0; i < scene->view_count; i++) {
        const oxl_view *view = &scene->view[i];
        if (!view->is_test) pixels += (double)view->camera.width * view->camera.height;
    }
    return pixels;
}

OXL_INTERNAL double schedule_first_pixels(const oxl_scene *scene, const oxl_train_options *options)
{
    const oxl_camera *c = &scene->view[0].camera;
    return schedule_pixels(scene) / (schedule_coarse_fraction(options, c->width, c->height) > 0 ? 4 : 1);
}

OXL_INTERNAL float schedule_densify_gradient(const oxl_scene *scene, const oxl_train_options *options)
{
    return scene->point_count == 0 && scene_is_composited(scene)
               ? OXL_MIN(options->densify_gradient, SCHEDULE_GRADIENT_POINTLESS)
               : options->densify_gradient;
}

/* Limits the number of Gaussians, since more than the images determine overfit; a dense cloud is thinned. */
OXL_INTERNAL size_t schedule_gaussian_cap_of(size_t points, double pixels, const oxl_train_options *options)
{
    size_t most = (size_t)options->max_gaussians;
    if (options->max_gaussians > 0) return most;
    most = (size_t)(pixels / SCHEDULE_PIXELS_EACH);
    return OXL_CLAMP(points, most, OXL_MAX(SCHEDULE_POINTS_MORE * most, SCHEDULE_POINTS_FEW));
}

OXL_INTERNAL size_t schedule_gaussian_cap(const oxl_scene *scene, const oxl_train_options *options)
{
    return schedule_gaussian_cap_of(scene->point_count, schedule_pixels(scene), options);
}

OXL_INTERNAL int schedule_viewer_steps(int steps)
{
    return OXL_MAX(2 * steps, OXL_MIN(SCHEDULE_VIEWER_MORE, 3 * steps));
}
