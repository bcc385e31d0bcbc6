/* forecast.c - the run ahead: how many Gaussians it will have, and how long it takes.
 *
 * The logarithm of the Gaussians rises with each densification, and less with each, up to their limit. A step
 * takes time in proportion to Gaussians and pixels, so steps that were timed give the time of all others
 * (docs/log/SCALE.md).
 *
 * Invariant: nothing here changes what is trained.
 */
#include "parts_calls.h"
#include "../core/vecmath.h"
#include "../survey/scene.h"

#define FORECAST_GROWTH 0.32      /* of the logarithm by the first densification; 0.14 to 0.5 were seen */
#define FORECAST_FADES 7.0        /* densifications after which growth is 1/e of it */
#define FORECAST_PIXEL 0.2        /* Gaussians that take as long in a step as a pixel does */
#define FORECAST_HALF 0.64        /* time at half the sides over that of whole images of as many pixels */
#define FORECAST_MEMORY 0.99      /* of what is known of a step's time that one more step leaves */
enum { FORECAST_RECKONED = 200 }; /* times that a run reckons the time left */

OXL_INTERNAL double forecast_step(const oxl_camera *c, double gaussians, int halved)
{
    const double pixels = FORECAST_PIXEL * c->width * c->height;
    return halved ? FORECAST_HALF * (pixels / 4 + gaussians) : pixels + gaussians;
}

OXL_INTERNAL double forecast_ahead(const oxl_train_options *o, int done, const oxl_camera *c, double cap,
                                   double *gaussians)
{
    const double coarse = schedule_coarse_fraction(o, c->width, c->height) * o->iterations,
                 fades = vecmath_exp(-1 / FORECAST_FADES);
    double work = 0, growth = FORECAST_GROWTH;
    for (int step = 1; step <= o->iterations; step++) {
        if (step > done) work += forecast_step(c, *gaussians, step <= coarse);
        if (!schedule_densifies_at(o, step)) continue;
        if (step > done) *gaussians = OXL_MAX(*gaussians, OXL_MIN(*gaussians * vecmath_exp(growth), cap));
        growth *= fades;
    }
    return work;
}

/* ---------------- the time left of a run */

OXL_INTERNAL void forecast_note_step(struct train *t)
{
    struct forecast *f = &t->forecast;
    const double now = os_seconds();
    if (f->at > 0 && now > f->at) {
        f->seconds = FORECAST_MEMORY * f->seconds + now - f->at;
        f->work = FORECAST_MEMORY * f->work +
                  forecast_step(&t->scene->view[0].camera, (double)t->trained.model.count, t->halved);
    }
    f->at = now;
}

OXL_INTERNAL double forecast_left(struct train *t)
{
    struct forecast *f = &t->forecast;
    const oxl_camera *c = &t->scene->view[0].camera;
    double gaussians = (double)t->trained.model.count, work;
    if (!(f->work > 0)) return 0;
    if (t->step >= f->next) {
        work = forecast_ahead(t->options, t->step, c, (double)schedule_gaussian_cap(t->scene, t->options),
                              &gaussians);
        work += (t->task.viewed + (parts_hide(t) ? schedule_viewer_steps(t->task.viewer_steps) : 0)) *
                forecast_step(c, gaussians, 0);
        f->left = work * f->seconds / f->work, f->left_at = os_seconds();
        f->next = t->step + OXL_MAX(1, t->options->iterations / FORECAST_RECKONED);
    }
    return OXL_MAX(0, f->left - (os_seconds() - f->left_at));
}
