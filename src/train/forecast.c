/* forecast.c - the run ahead: how many Gaussians it will have, and how long it takes.
 *
 * The larger the share of Gaussians that density control splits in a first look (look.c), the faster the
 * model grows: its logarithm rises by a power of that share, and less with each densification
 * (docs/log/FORECAST.md). A step takes time in proportion to a power of the Gaussians, so steps that were
 * timed, in the look or in the run itself, give the time of all others.
 *
 * Invariant: nothing here changes what is trained.
 */
#include "parts_calls.h"
#include "forecast.h"
#include "../core/vecmath.h"
#include "../survey/scene.h"

#define FORECAST_POWER 0.85 /* of the share: growth of the logarithm by the first densification */
#define FORECAST_USUAL 0.2  /* share that is taken where there was no look */
#define FORECAST_SLOW 0.14  /* nearly the smallest share that was seen with a threshold of the presets */
#define FORECAST_THRESHOLD 5.5e-4f /* the largest of these */
#define FORECAST_FADES 5.0 /* densifications after which growth is 1/e of its rate at the start, and later; */
#define FORECAST_FADES_EACH 0.1   /* before the first one, so many more for each densification of the run, */
#define FORECAST_FADES_MOST 10.0  /* but no more than these */
#define FORECAST_FADES_LESS 0.5   /* and so many less for each one done */
#define FORECAST_GROWTH 0.4       /* weight of the last densification in the means over those of the run */
#define FORECAST_GAUSSIANS 0.5    /* power of Gaussians in the time of a step; measured: 0.3 to 0.9 */
#define FORECAST_HALF 0.35        /* time of a step at half the sides over one of whole images */
#define FORECAST_TRIALS 1.3       /* of the most steps of trials, with validation; measured: 0.7 to 1.8 */
#define FORECAST_VIEW 2.7         /* steps that evaluation takes for a view, with its files */
#define FORECAST_MEMORY 0.98      /* of what is known of a step's time that one more step leaves */
enum { FORECAST_RECKONED = 200 }; /* times that a run reckons the time left */

/* ---------------- how many Gaussians */

/* Returns the densifications after which growth is 1/e of its rate behind `done` of them. */
static double forecast_fades(const oxl_train_options *o, int done)
{
    const double first = FORECAST_FADES + FORECAST_FADES_EACH * schedule_densifications(o);
    return OXL_MAX(OXL_MIN(first, FORECAST_FADES_MOST) - FORECAST_FADES_LESS * done, FORECAST_FADES);
}

/* Returns the growth of the logarithm by the densification behind `done` others. */
static double forecast_growth_at(const oxl_train_options *o, double share, int done)
{
    const double fades = forecast_fades(o, 0), known = share > 0 ? share : FORECAST_USUAL,
                 first = vecmath_exp(FORECAST_POWER * vecmath_log(known));
    return first * fades * (1 - vecmath_exp(-1 / fades)) * vecmath_exp(-done / fades);
}

OXL_INTERNAL double forecast_gaussians(const oxl_train_options *o, double start, double share, double cap)
{
    const double left = vecmath_exp(-schedule_densifications(o) / forecast_fades(o, 0)),
                 first = forecast_growth_at(o, share, 0),
                 grown = first * (1 - left) / (1 - vecmath_exp(-1 / forecast_fades(o, 0)));
    return OXL_MIN(start * vecmath_exp(grown), OXL_MAX(start, cap));
}

OXL_INTERNAL int forecast_reaches(const oxl_train_options *o, double start, double cap)
{
    return o->densify_gradient <= FORECAST_THRESHOLD &&
           forecast_gaussians(o, start, FORECAST_SLOW, cap) >= cap;
}

/* ---------------- the work of steps, relative to one of whole images with a single Gaussian */

static double forecast_work(double gaussians, int halved)
{
    return vecmath_exp(FORECAST_GAUSSIANS * vecmath_log(OXL_MAX(gaussians, 1))) *
           (halved ? FORECAST_HALF : 1);
}

struct forecast_state { /* of the run that lies ahead */
    const oxl_train_options *o;
    double gaussians, growth, fades, cap, coarse; /* coarse: steps at half the sides end here */
    int densified; /* densifications that lie ahead, once forecast_ahead has seen them */
};

/* Returns the work of the steps from `step`, exclusively, to the last. */
static double forecast_ahead(struct forecast_state *f, int step)
{
    double work = 0, each[2] = {forecast_work(f->gaussians, 0), forecast_work(f->gaussians, 1)};
    while (++step <= f->o->iterations) {
        work += each[step <= f->coarse];
        if (!schedule_densifies_at(f->o, step)) continue;
        f->gaussians = OXL_MIN(f->gaussians * vecmath_exp(f->growth), f->cap);
        f->growth *= vecmath_exp(-1 / f->fades);
        f->densified++;
        each[0] = forecast_work(f->gaussians, 0), each[1] = forecast_work(f->gaussians, 1);
    }
    return work;
}

/* Returns the steps of the run at half the sides. */
static double forecast_coarse_steps(const oxl_scene *scene, const oxl_train_options *o)
{
    const oxl_camera *c = &oxl_scene_view(scene, 0)->camera;
    return schedule_coarse_fraction(o, c->width, c->height) * o->iterations;
}

OXL_INTERNAL int forecast_trial_steps(const oxl_train_options *o, int views)
{
    return views < SELECTION_VIEWS_MIN ? 0
                                       : OXL_MAX(1, (int)(SELECTION_TRIAL * o->iterations)) * parts_trials(o);
}

/* Returns the steps on whole images that take as long as the trials half into a run, less those `done`. */
static double forecast_trials(const struct forecast_state *f, int views, int done)
{
    const double left = FORECAST_TRIALS * forecast_trial_steps(f->o, views) - done;
    return OXL_MAX(left, 0) * (f->coarse > 0.5 * f->o->iterations ? FORECAST_HALF : 1);
}

OXL_INTERNAL double forecast_seconds(const oxl_scene *scene, const oxl_train_options *o,
                                     const struct look *look, double cap, int viewed, int refined)
{
    struct forecast_state f = {.o = o,
                               .gaussians = look->gaussians,
                               .growth = forecast_growth_at(o, look->share, 0),
                               .fades = forecast_fades(o, 0),
                               .cap = OXL_MAX(cap, look->gaussians),
                               .coarse = forecast_coarse_steps(scene, o)};
    const double second = look->seconds / forecast_work(look->timed, 0), work = forecast_ahead(&f, 0),
                 last = second * forecast_work(f.gaussians, 0);
    return look->begin + second * work +
           last * (forecast_trials(&f, schedule_training_views(scene), 0) + (look->hides ? refined : 0)) +
           OXL_MAX(last * FORECAST_VIEW * viewed, look->after);
}

/* ---------------- the time left of a run */

/* Returns the seconds of a step now; 0: not known. */
static double forecast_step(const struct train *t)
{
    const struct forecast *f = &t->forecast;
    return f->work > 0 ? forecast_work((double)t->trained.model.count, t->halved) * f->seconds / f->work : 0;
}

/* Notes the growth of a densification and what it took beyond a step. */
static void forecast_note_density(struct train *t, double seconds)
{
    struct forecast *f = &t->forecast;
    const double grown = (double)t->trained.model.count / (double)OXL_MAX(f->count, (size_t)1),
                 share = f->densified++ ? FORECAST_GROWTH : 1;
    f->growth += share * (vecmath_log(OXL_MAX(grown, 1)) - f->growth);
    f->density_seconds += share * (OXL_MAX(seconds - forecast_step(t), 0) - f->density_seconds);
}

/* Takes the run's own growth for that of a look, after its first densification, or half of a run without. */
static void forecast_note_growth(struct train *t)
{
    const struct forecast *f = &t->forecast;
    struct look *grown = t->task.grown;
    if (!grown || grown->steps > 0 || t->first_step > 0) return;
    if (f->densified == 0 && 2 * t->step < t->options->iterations) return;
    if (f->growth > 0)
        grown->share =
            vecmath_exp(vecmath_log(f->growth / forecast_growth_at(t->options, 1, 0)) / FORECAST_POWER);
    grown->gaussians = (double)f->count, grown->steps = t->step;
}

OXL_INTERNAL void forecast_note_step(struct train *t)
{
    struct forecast *f = &t->forecast;
    const double now = os_seconds(), seconds = now - f->at;
    const int mark = 2 * t->step + t->is_trial; /* 2 more than the last one, unless a trial lies between */
    if (f->at > 0 && seconds > 0 && mark == f->mark + 2) {
        if (!t->is_trial && schedule_densifies_at(t->options, t->step)) forecast_note_density(t, seconds);
        else {
            f->seconds = FORECAST_MEMORY * f->seconds + seconds;
            f->work = FORECAST_MEMORY * f->work + forecast_work((double)t->trained.model.count, t->halved);
        }
    }
    forecast_note_growth(t); /* f->count is that before the densification */
    f->at = now, f->mark = mark, f->count = t->trained.model.count;
    f->trial_steps += t->is_trial;
}

OXL_INTERNAL void forecast_note_save(struct train *t, double seconds)
{
    t->forecast.save_seconds = seconds;
    t->forecast.at += seconds; /* the next step takes no longer for it */
}

OXL_INTERNAL int forecast_hides(struct train *t)
{
    struct imaging m = {0};
    struct train_deferred step = {0};
    parts_form_image(t, &m);
    parts_set_gain(t, &step, 0);
    m.on = step.has_gain;
    return imaging_alters_colours(&m) || imaging_is_gains_alone(&m);
}

/* Returns the steps beside the run's own: trials, and a model for viewers. */
static double forecast_beside(struct train *t, const struct forecast_state *f)
{
    const int views = t->views + t->validation_views, tries = t->trial || t->step < parts_validate_until(t);
    return (tries ? forecast_trials(f, views, t->forecast.trial_steps) : 0) +
           (forecast_hides(t) ? t->task.refined : 0);
}

/* Returns the checkpoints to come, the last one's seconds each. */
static double forecast_saves(const struct train *t, double step)
{
    const double each = OXL_MIN(TRAIN_SAVE_STEPS, OXL_MAX(1, TRAIN_SAVE_SECONDS / step));
    return floor((t->options->iterations - 1 - t->saved_step) / each) * t->forecast.save_seconds;
}

static double forecast_reckon(struct train *t)
{
    const oxl_train_options *o = t->options;
    const struct forecast *past = &t->forecast;
    const double second = past->seconds / past->work;
    struct forecast_state f = {
        .o = o, .gaussians = (double)t->trained.model.count, .coarse = forecast_coarse_steps(t->scene, o)};
    double work, last;
    int done = 0;
    for (int step = 1; step <= t->step; step++) done += schedule_densifies_at(o, step);
    f.growth = past->densified ? past->growth : forecast_growth_at(o, t->scene->stats.splitting, done);
    f.fades = forecast_fades(o, done);
    f.cap = OXL_MAX((double)schedule_gaussian_cap(t->scene, o), f.gaussians);
    work = forecast_ahead(&f, t->step);
    last = second * forecast_work(f.gaussians, 0);
    return second * work + last * forecast_beside(t, &f) +
           OXL_MAX(last * FORECAST_VIEW * t->task.viewed, t->task.after) +
           f.densified * past->density_seconds + forecast_saves(t, forecast_step(t));
}

OXL_INTERNAL double forecast_left(struct train *t)
{
    struct forecast *f = &t->forecast;
    if (!(f->work > 0)) return 0;
    if (t->step >= f->next || !(f->left_at > 0) || t->is_trial) {
        f->left = forecast_reckon(t), f->left_at = f->at;
        f->next = t->step + t->options->iterations / FORECAST_RECKONED;
    }
    return OXL_MAX(0, f->left - (os_seconds() - f->left_at));
}
