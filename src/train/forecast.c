/* forecast.c - the run ahead: how many Gaussians it will have, and how long it takes.
 *
 * The larger the share of Gaussians that density control splits in a first look (look.c), the faster the
 * model grows: its logarithm rises by a power of that share, and less with each densification
 * (docs/log/FORECAST.md). A step takes time in proportion to Gaussians and pixels, so steps that were timed,
 * in the look or in the run itself, give the time of all others.
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
#define FORECAST_PIXEL 0.2        /* Gaussians that take as long in a step as a pixel does */
#define FORECAST_HALF 0.64        /* time at half the sides over that of whole images of as many pixels */
#define FORECAST_TRIALS 1.3       /* of the most steps of trials, with validation; measured: 0.7 to 1.8 */
#define FORECAST_DENSITY 1.7e-6   /* s a Gaussian that a densification takes, before one was timed */
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

/* ---------------- the work of steps, in the time that a Gaussian adds to one */

static double forecast_work(const oxl_scene *scene, double gaussians, int halved)
{
    const oxl_camera *c = &oxl_scene_view(scene, 0)->camera;
    const double pixels = FORECAST_PIXEL * c->width * c->height;
    return halved ? FORECAST_HALF * (pixels / 4 + gaussians) : pixels + gaussians;
}

struct forecast_state { /* of the run that lies ahead */
    const oxl_scene *scene;
    const oxl_train_options *o;
    double gaussians, growth, fades, cap, coarse; /* coarse: steps at half the sides end here */
    double sorted; /* Gaussians of all densifications that lie ahead, once forecast_ahead has seen them */
};

/* Returns the work of the steps behind `step`, of `trials` half into the run, and of `beside` on whole images
 * at its end, to which it takes the Gaussians. */
static double forecast_ahead(struct forecast_state *f, int step, double trials, double beside)
{
    double work = 0;
    while (++step <= f->o->iterations) {
        work += forecast_work(f->scene, f->gaussians, step <= f->coarse);
        if (!schedule_densifies_at(f->o, step)) continue;
        f->sorted += f->gaussians;
        f->gaussians = OXL_MIN(f->gaussians * vecmath_exp(f->growth), f->cap);
        f->growth *= vecmath_exp(-1 / f->fades);
    }
    return work + trials * forecast_work(f->scene, f->gaussians, f->coarse > 0.5 * f->o->iterations) +
           beside * forecast_work(f->scene, f->gaussians, 0);
}

/* Returns the steps of the run at half the sides. */
static double forecast_coarse_steps(const oxl_scene *scene, const oxl_train_options *o)
{
    const oxl_camera *c = &oxl_scene_view(scene, 0)->camera;
    return schedule_coarse_fraction(o, c->width, c->height) * o->iterations;
}

OXL_INTERNAL int forecast_trial_steps(const oxl_train_options *o, int views)
{
    return views < SELECTION_VIEWS_MIN ? 0 : schedule_trial_steps(o) * parts_trials(o);
}

OXL_INTERNAL double forecast_seconds(const oxl_scene *scene, const oxl_train_options *o,
                                     const struct look *look, double cap, int viewed, int refined)
{
    struct forecast_state f = {.scene = scene,
                               .o = o,
                               .gaussians = look->gaussians,
                               .growth = forecast_growth_at(o, look->share, 0),
                               .fades = forecast_fades(o, 0),
                               .cap = OXL_MAX(cap, look->gaussians),
                               .coarse = forecast_coarse_steps(scene, o)};
    const double second = look->seconds / forecast_work(scene, look->timed, 0),
                 trials = FORECAST_TRIALS * forecast_trial_steps(o, schedule_training_views(scene));
    const double steps = second * forecast_ahead(&f, 0, trials, viewed + (look->hides ? refined : 0));
    return look->begin + steps + FORECAST_DENSITY * f.sorted + look->after;
}

/* ---------------- the time left of a run */

/* Returns the work of the last step. */
static double forecast_step(const struct train *t)
{
    return forecast_work(t->scene, (double)t->trained.model.count, t->halved);
}

/* Returns the seconds of a unit of work; 0: not known. */
static double forecast_second(const struct train *t)
{
    return t->forecast.work > 0 ? t->forecast.seconds / t->forecast.work : 0;
}

/* Notes the growth of a densification and what it took beyond a step, of each Gaussian before it. */
static void forecast_note_density(struct train *t, double seconds)
{
    struct forecast *f = &t->forecast;
    const double before = (double)OXL_MAX(f->count, (size_t)1), share = f->densified++ ? FORECAST_GROWTH : 1,
                 grown = OXL_MAX((double)t->trained.model.count / before, 1),
                 beside = OXL_MAX(seconds - forecast_second(t) * forecast_step(t), 0);
    f->growth += share * (vecmath_log(grown) - f->growth);
    f->density_seconds += share * (beside / before - f->density_seconds);
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
            f->work = FORECAST_MEMORY * f->work + forecast_step(t);
        }
    }
    f->at = now, f->mark = mark, f->count = t->trained.model.count;
    f->trial_steps += t->is_trial;
}

OXL_INTERNAL void forecast_note_save(struct train *t, double seconds)
{
    t->forecast.save_seconds = seconds;
    t->forecast.at += seconds; /* the next step takes no longer for it */
}

/* Returns the steps of trials that are left. */
static double forecast_trials(struct train *t)
{
    const int all = forecast_trial_steps(t->options, t->views + t->validation_views),
              tries = t->trial || t->step < parts_validate_until(t);
    return tries ? OXL_MAX(FORECAST_TRIALS * all - t->forecast.trial_steps, 0) : 0;
}

/* Returns the checkpoints to come, the last one's seconds each. */
static double forecast_saves(const struct train *t)
{
    const double step = forecast_second(t) * forecast_step(t),
                 each = OXL_MIN(TRAIN_SAVE_STEPS, OXL_MAX(1, TRAIN_SAVE_SECONDS / step));
    return floor((t->options->iterations - 1 - t->saved_step) / each) * t->forecast.save_seconds;
}

/* Tells how the run ends, after its first densification here, or half of the steps left without one. */
static void forecast_tell(struct train *t, double gaussians)
{
    struct look *grown = t->task.grown;
    const int steps = t->step - t->first_step;
    if (!grown || grown->steps > 0) return;
    if (t->forecast.densified == 0 && t->step + steps < t->options->iterations) return;
    grown->gaussians = gaussians, grown->steps = steps, grown->hides = train_imaging_hides(t);
}

static double forecast_reckon(struct train *t)
{
    const oxl_train_options *o = t->options;
    const struct forecast *past = &t->forecast;
    struct forecast_state f = {.scene = t->scene,
                               .o = o,
                               .gaussians = (double)t->trained.model.count,
                               .coarse = forecast_coarse_steps(t->scene, o)};
    const int beside = t->task.viewed + (train_imaging_hides(t) ? t->task.refined : 0);
    double seconds, density = past->densified ? past->density_seconds : FORECAST_DENSITY;
    int done = 0;
    for (int step = 1; step <= t->step; step++) done += schedule_densifies_at(o, step);
    f.fades = forecast_fades(o, done);
    f.growth = past->densified ? past->growth * vecmath_exp(-1 / f.fades)
                               : forecast_growth_at(o, t->scene->stats.splitting, done);
    f.cap = OXL_MAX((double)schedule_gaussian_cap(t->scene, o), f.gaussians);
    seconds = forecast_second(t) * forecast_ahead(&f, t->step, forecast_trials(t), beside);
    forecast_tell(t, f.gaussians);
    return seconds + density * f.sorted + t->task.after + forecast_saves(t);
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
