/* forecast.c - the run ahead: how many Gaussians it will have, and how long it takes.
 *
 * The larger the share of Gaussians that density control splits in a first look (look.c), the faster the
 * model grows: its logarithm rises by FORECAST_RATE times that share, and less with each densification
 * (docs/log/FORECAST.md). A step takes time in proportion to a power of the Gaussians, so steps that were
 * timed, in the look or in the run itself, give the time of all others.
 *
 * Invariant: nothing here changes what is trained.
 */
#include "parts_calls.h"
#include "forecast.h"
#include "../core/vecmath.h"
#include "../survey/scene.h"

#define FORECAST_RATE 1.3  /* of the logarithm, for each densification at the start; measured: 1.1 to 1.7 */
#define FORECAST_USUAL 0.2 /* share that is taken where there was no look */
#define FORECAST_SLOW 0.14 /* nearly the smallest share that was seen with a threshold of the presets */
#define FORECAST_THRESHOLD 5.5e-4f /* the largest of these */
#define FORECAST_FADES 6.0         /* densifications after which growth is 1/e of its rate at the start */
#define FORECAST_BEFORE 3.0        /* densifications of the run itself that count as much as the look */
#define FORECAST_GAUSSIANS 0.5     /* power of Gaussians in the time of a step; measured: 0.3 to 0.9 */
#define FORECAST_HALF 0.35         /* time of a step at half the sides over one of whole images */
#define FORECAST_TRIALS 1.3        /* of the most steps of trials, with validation; measured: 0.7 to 1.8 */
#define FORECAST_VIEW 2.7          /* steps that evaluation takes for a view, with its files */
#define FORECAST_MEMORY 0.98       /* of what is known of a step's time that one more step leaves */
enum { FORECAST_RECKONED = 200 };  /* times that a run reckons the time left */

/* ---------------- how many Gaussians */

/* Returns the growth of the logarithm by the first `done` densifications, for a share of one. */
static double forecast_faded(double done)
{
    return FORECAST_FADES * (1 - vecmath_exp(-done / FORECAST_FADES));
}

static double forecast_rate(double share)
{
    return FORECAST_RATE * (share > 0 ? share : FORECAST_USUAL);
}

OXL_INTERNAL double forecast_gaussians(const oxl_train_options *o, double start, double share, double cap)
{
    const double grown = forecast_rate(share) * forecast_faded(schedule_densifications(o));
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
    double gaussians, rate, cap, coarse; /* coarse: steps at half the sides end here */
    int densified;
};

/* Returns the work of the steps from `step`, exclusively, to the last. */
static double forecast_ahead(struct forecast_state *f, int step)
{
    double work = 0, each[2] = {forecast_work(f->gaussians, 0), forecast_work(f->gaussians, 1)};
    while (++step <= f->o->iterations) {
        work += each[step <= f->coarse];
        if (!schedule_densifies_at(f->o, step)) continue;
        f->gaussians *=
            vecmath_exp(f->rate * (forecast_faded(f->densified + 1) - forecast_faded(f->densified)));
        f->gaussians = OXL_MIN(f->gaussians, f->cap);
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
                               .rate = forecast_rate(look->share),
                               .cap = OXL_MAX(cap, look->gaussians),
                               .coarse = forecast_coarse_steps(scene, o)};
    double work = forecast_ahead(&f, 0);
    work += forecast_work(f.gaussians, 0) * (forecast_trials(&f, schedule_training_views(scene), 0) +
                                             FORECAST_VIEW * viewed + (look->hides ? refined : 0));
    return look->begin + work * look->seconds / forecast_work(look->timed, 0);
}

/* ---------------- the time left of a run */

static int forecast_densified(const struct train *t)
{
    int done = 0;
    for (int step = 1; step <= t->step; step++) done += schedule_densifies_at(t->options, step);
    return done;
}

/* Takes the run's own growth for that of a look, after its first densification, or half of a run without. */
static void forecast_note_growth(struct train *t)
{
    struct look *grown = t->task.grown;
    const double from = (double)t->forecast.start, to = (double)t->trained.model.count;
    int done;
    if (!grown || grown->steps > 0 || t->first_step > 0 || t->is_trial) return;
    done = forecast_densified(t);
    if (done == 0 && 2 * t->step < t->options->iterations) return;
    if (done > 0) grown->share = vecmath_log(to / from) / (FORECAST_RATE * forecast_faded(done));
    grown->gaussians = from, grown->steps = t->step;
}

OXL_INTERNAL void forecast_note_step(struct train *t)
{
    struct forecast *f = &t->forecast;
    const double now = os_seconds();
    const int mark = 2 * t->step + t->is_trial; /* 2 more than the last one, unless a trial lies between */
    if (f->at > 0 && now > f->at && mark == f->mark + 2) {
        f->seconds = FORECAST_MEMORY * f->seconds + now - f->at;
        f->work = FORECAST_MEMORY * f->work + forecast_work((double)t->trained.model.count, t->halved);
    }
    if (f->start == 0) f->start = t->trained.model.count;
    f->at = now, f->mark = mark;
    f->trial_steps += t->is_trial;
    forecast_note_growth(t);
}

/* Returns the rate of growth: the look's and, the more densifications there were, the run's own. */
static double forecast_rate_now(const struct train *t, int done)
{
    const double share = t->task.grown ? t->task.grown->share : t->scene->stats.splitting,
                 look = forecast_rate(share),
                 grown = (double)t->trained.model.count / (double)OXL_MAX(t->forecast.start, (size_t)1);
    if (done == 0 || t->first_step > 0 || !(grown > 1)) return look;
    return (FORECAST_BEFORE * look + done * vecmath_log(grown) / forecast_faded(done)) /
           (FORECAST_BEFORE + done);
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

/* Returns the steps beside the run's own: trials, evaluation, a model for viewers. */
static double forecast_beside(struct train *t, const struct forecast_state *f)
{
    const int views = t->views + t->validation_views, tries = t->trial || t->step < parts_validate_until(t);
    return (tries ? forecast_trials(f, views, t->forecast.trial_steps) : 0) + FORECAST_VIEW * t->task.viewed +
           (forecast_hides(t) ? t->task.refined : 0);
}

static double forecast_reckon(struct train *t)
{
    const oxl_train_options *o = t->options;
    struct forecast_state f = {
        .o = o, .gaussians = (double)t->trained.model.count, .coarse = forecast_coarse_steps(t->scene, o)};
    double work;
    f.densified = forecast_densified(t);
    f.rate = forecast_rate_now(t, f.densified);
    f.cap = OXL_MAX((double)schedule_gaussian_cap(t->scene, o), f.gaussians);
    work = forecast_ahead(&f, t->step);
    work += forecast_beside(t, &f) * forecast_work(f.gaussians, 0);
    return work * t->forecast.seconds / t->forecast.work;
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
