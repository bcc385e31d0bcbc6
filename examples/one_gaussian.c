/* one_gaussian.c - one Gaussian, rendered and differentiated.
 *
 * Draws a reddish Gaussian, takes L = the sum of half the squared pixels, and compares the exact gradient of
 * L in each parameter with a finite difference. The library works in float, so central differences agree to
 * about three digits; the tests compare in double.
 */
#include "oceanxl.h"

#include <math.h>
#include <stdio.h>

enum { SIDE = 48, PIXELS = 3 * SIDE * SIDE };

static oxl_camera looking_along_z(void)
{
    return (oxl_camera){.width = SIDE,
                        .height = SIDE,
                        .fx = 60,
                        .fy = 60,
                        .cx = SIDE / 2.0,
                        .cy = SIDE / 2.0,
                        .rotation = {1, 0, 0, 0, 1, 0, 0, 0, 1}};
}

static void place(oxl_model *m)
{
    const float row[] = {0.1f,  -0.2f, 4.0f,        /* mean, 4 units in front of the camera */
                         -1.0f, -1.4f, -1.8f,       /* natural logarithms of its three standard deviations */
                         0.9f,  0.1f,  -0.3f, 0.2f, /* rotation, w x y z, need not be of length 1 */
                         0.5f,                      /* logit of opacity: 1 / (1 + exp(-0.5)) = 0.62 */
                         1.2f,  0.3f,  0.1f};       /* SH coefficient 0 of red, green, blue */
    for (int p = 0; p < oxl_model_planes(m); p++) m->plane[p][0] = row[p];
}

/* L, and drgb = dL/d(pixel), which for half the squares is the pixel itself. */
static oxl_result loss(oxl_context *ctx, const oxl_model *m, const oxl_camera *camera, double *out,
                       float *drgb)
{
    oxl_image rendered = {0};
    const oxl_result rc = oxl_render(ctx, m, camera, NULL, &rendered, NULL);
    *out = 0;
    for (int i = 0; rc == OXL_OK && i < PIXELS; i++) {
        *out += 0.5 * rendered.rgb[i] * rendered.rgb[i];
        if (drgb) drgb[i] = rendered.rgb[i];
    }
    oxl_image_free(ctx, &rendered);
    return rc;
}

/* Prints one row; returns 1 when the two agree. */
static int compare(oxl_context *ctx, oxl_model *m, const oxl_camera *camera, int p, double exact)
{
    static const char *const names[] = {
        "x",          "y",          "z",          "log scale 0", "log scale 1", "log scale 2", "rotation w",
        "rotation x", "rotation y", "rotation z", "opacity",     "red",         "green",       "blue"};
    const float at = m->plane[p][0], h = 0.01f;
    double above = 0, below = 0, difference;
    m->plane[p][0] = at + h;
    if (loss(ctx, m, camera, &above, NULL) != OXL_OK) return 0;
    m->plane[p][0] = at - h;
    if (loss(ctx, m, camera, &below, NULL) != OXL_OK) return 0;
    m->plane[p][0] = at;
    difference = (above - below) / (2.0 * h);
    printf("%-12s %12.5f %12.5f\n", names[p], exact, difference);
    return fabs(exact - difference) <= 0.02 * fabs(exact) + 0.05;
}

int main(void)
{
    static float drgb[PIXELS];
    const oxl_camera camera = looking_along_z();
    oxl_context *ctx = NULL;
    oxl_model model = {0}, gradient = {0};
    double value = 0;
    int agreed = 0;
    oxl_result rc = oxl_context_create(NULL, &ctx);
    if (rc == OXL_OK) rc = oxl_model_create(ctx, 1, 0, &model);
    if (rc != OXL_OK) goto done;
    place(&model);
    rc = loss(ctx, &model, &camera, &value, drgb);
    if (rc == OXL_OK) rc = oxl_render_backward(ctx, &model, &camera, NULL, drgb, &gradient);
    if (rc != OXL_OK) goto done;
    printf("L = %.5f\n%-12s %12s %12s\n", value, "parameter", "exact", "difference");
    for (int p = 0; p < oxl_model_planes(&model); p++)
        agreed += compare(ctx, &model, &camera, p, gradient.plane[p][0]);
    printf("%d of %d agree\n", agreed, oxl_model_planes(&model));
done:
    if (rc != OXL_OK) fprintf(stderr, "%s\n", oxl_error_text(ctx));
    oxl_model_free(ctx, &gradient);
    oxl_model_free(ctx, &model);
    oxl_context_free(ctx);
    return rc != OXL_OK || agreed != 14;
}
