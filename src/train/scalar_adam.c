/* scalar_adam.c - Adam (Kingma & Ba 2015, Alg. 1) for single numbers: the parameters of medium and lamp.
 *
 * src/parts/exposure.c has its own, with other decay rates and float moments.
 */
#include "train_tools.h"
#include "../core/vecmath.h"

#define SCALAR_ADAM_EPSILON 1e-15 /* against division by 0, as of the Gaussians (adam.c) */

OXL_INTERNAL void scalar_adam_step(double *at, double *mean, double *square, double gradient, double rate,
                                   int step)
{
    const double correct1 = 1 - vecmath_exp(step * vecmath_log(0.9)),
                 correct2 = 1 - vecmath_exp(step * vecmath_log(0.999));
    if (!(fabs(gradient) <= SCALAR_ADAM_GRADIENT_MAX)) return;
    *mean = 0.9 * *mean + 0.1 * gradient;
    *square = 0.999 * *square + 0.001 * gradient * gradient;
    *at -= rate * (*mean / correct1) / (sqrt(*square / correct2) + SCALAR_ADAM_EPSILON);
}
