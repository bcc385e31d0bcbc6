/* turntable.c - a model seen from all sides: renders PNG frames to an existing FOLDER, on a circle, at the
 * distance of the camera that the file names for viewers, 20 degrees off that camera's axis.
 *
 *     build/examples/turntable MODEL.ply FOLDER [FRAMES]
 */
#include "oceanxl.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

enum { SIDE = 256 };

/* view: focal length by the image's side, rotation, position (oxl_model). Looks at the mean of all centres. */
static oxl_camera on_circle(const oxl_model *m, const double *view, double turn)
{
    const double tilt = 0.35, *x = view + 1, *y = view + 4, *z = view + 7; /* axes of the first camera */
    oxl_camera c = {.width = SIDE, .height = SIDE, .cx = SIDE / 2.0, .cy = SIDE / 2.0};
    double middle[3] = {0, 0, 0}, away = 0, *right = c.rotation, *down = right + 3, *ahead = right + 6;
    for (int k = 0; k < 3; k++)
        for (size_t i = 0; i < m->count; i++) middle[k] += m->plane[OXL_MEAN + k][i] / (double)m->count;
    for (int k = 0; k < 3; k++) {
        const double out = cos(turn) * x[k] + sin(turn) * y[k];
        away += z[k] * (middle[k] - (view[10 + k] - m->origin[k]));
        right[k] = cos(turn) * y[k] - sin(turn) * x[k];
        ahead[k] = cos(tilt) * z[k] - sin(tilt) * out;
    }
    for (int k = 0; k < 3; k++)
        down[k] = ahead[(k + 1) % 3] * right[(k + 2) % 3] - ahead[(k + 2) % 3] * right[(k + 1) % 3];
    for (int row = 0; row < 3; row++)
        for (int k = 0; k < 3; k++) c.translation[row] -= c.rotation[3 * row + k] * middle[k];
    c.translation[2] += fabs(away);
    c.fx = c.fy = SIDE * view[0];
    return c;
}

int main(int argc, char **argv)
{
    const int frames = argc > 3 ? atoi(argv[3]) : 24;
    oxl_context *ctx = NULL;
    oxl_model model = {0};
    oxl_result rc;
    if (argc < 3) return fprintf(stderr, "usage: %s MODEL.ply FOLDER [FRAMES]\n", argv[0]), 2;
    rc = oxl_context_create(NULL, &ctx);
    if (rc == OXL_OK) rc = oxl_model_read(ctx, argv[1], &model);
    if (rc == OXL_OK && model.view[0] == 0) rc = oxl_fail(ctx, OXL_ERR_INPUT, "%s has no view", argv[1]);
    for (int i = 0; rc == OXL_OK && i < frames; i++) {
        const oxl_camera camera = on_circle(&model, model.view, 6.283185307 * i / frames);
        oxl_image image = {0};
        char path[4096];
        snprintf(path, sizeof path, "%s/frame_%03d.png", argv[2], i);
        rc = oxl_render(ctx, &model, &camera, NULL, &image, NULL);
        if (rc == OXL_OK) rc = oxl_image_write(ctx, path, &image);
        oxl_image_free(ctx, &image);
    }
    if (rc != OXL_OK) fprintf(stderr, "%s\n", oxl_error_text(ctx));
    oxl_model_free(ctx, &model);
    oxl_context_free(ctx);
    return rc != OXL_OK;
}
