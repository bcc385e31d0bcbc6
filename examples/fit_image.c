/* fit_image.c - fits one image by Gaussians, without a survey: the shortest look at the optimiser.
 *
 *     build/examples/fit_image [image.png or .jpg [fitted.png]]
 *
 * Without an image it paints rings and a slope. The camera looks along +z at a wall of points at depth 1. It
 * fails below 25 dB.
 */
#include "oceanxl.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

static oxl_result paint(oxl_context *ctx, oxl_image *out)
{
    const int side = 128;
    oxl_result rc = oxl_image_create(ctx, side, side, out);
    if (rc != OXL_OK) return rc;
    for (int y = 0; y < side; y++)
        for (int x = 0; x < side; x++) {
            const double u = (x - 50) / 30.0, v = (y - 70) / 30.0,
                         ring = 0.5 + 0.5 * cos(6 * (u * u + v * v) / (1 + 0.5 * u * u));
            const int i = y * side + x, pixels = side * side;
            out->rgb[i] = (float)(0.2 + 0.6 * ring);
            out->rgb[i + pixels] = (float)x / (float)side;
            out->rgb[i + 2 * pixels] = (float)(0.8 - 0.5 * ring * y / side);
        }
    return OXL_OK;
}

/* A grid of points on the wall, each with the colour of its pixel. */
static oxl_point *points_on_the_wall(const oxl_image *image, const oxl_camera *c, int step, size_t *count)
{
    const size_t pixels = (size_t)image->width * (size_t)image->height;
    oxl_point *points = malloc(pixels * sizeof *points);
    *count = 0;
    for (int y = step / 2; points && y < image->height; y += step)
        for (int x = step / 2; x < image->width; x += step) {
            oxl_point p = {.position = {(x + 0.5 - c->cx) / c->fx, (y + 0.5 - c->cy) / c->fy, 1}};
            for (int k = 0; k < 3; k++)
                p.rgb[k] =
                    (uint8_t)(255 * image->rgb[(size_t)k * pixels + (size_t)(y * image->width + x)] + 0.5f);
            points[(*count)++] = p;
        }
    return points;
}

static int show(void *user, const oxl_progress *p)
{
    (void)user;
    if (p->iteration % 100 == 0)
        printf("step %4d  loss %.4f  PSNR %.2f dB  %zu Gaussians\n", p->iteration, p->loss, p->psnr,
               p->gaussians);
    return 0;
}

int main(int argc, char **argv)
{
    const oxl_callback callback = {show, NULL};
    oxl_train_options train = oxl_train_options_default(OXL_PRESET_DRAFT);
    oxl_context *ctx = NULL;
    oxl_scene *scene = NULL;
    oxl_image image = {0}, fitted = {0};
    oxl_trained trained = {0};
    oxl_view view = {.name = "image", .camera = {.rotation = {1, 0, 0, 0, 1, 0, 0, 0, 1}}};
    oxl_point *points = NULL;
    size_t count = 0;
    double psnr = 0;
    oxl_result rc = oxl_context_create(NULL, &ctx);
    if (rc == OXL_OK) rc = argc > 1 ? oxl_image_read(ctx, argv[1], &image) : paint(ctx, &image);
    if (rc != OXL_OK) goto done;
    view.camera.width = image.width, view.camera.height = image.height;
    view.camera.fx = view.camera.fy = image.width;
    view.camera.cx = image.width / 2.0, view.camera.cy = image.height / 2.0;
    points = points_on_the_wall(&image, &view.camera, 4, &count);
    train.iterations = 500;
    rc = oxl_scene_from_arrays(ctx, &view, &image, 1, points, count, &scene);
    if (rc == OXL_OK) rc = oxl_train(ctx, scene, &train, &callback, &trained);
    if (rc == OXL_OK) rc = oxl_render(ctx, &trained.model, &view.camera, NULL, &fitted, NULL);
    if (rc == OXL_OK) rc = oxl_psnr(ctx, &fitted, &image, &psnr);
    if (rc == OXL_OK && argc > 2) rc = oxl_image_write(ctx, argv[2], &fitted);
    if (rc == OXL_OK) printf("%zu Gaussians, PSNR %.2f dB\n", trained.model.count, psnr);
done:
    if (rc != OXL_OK) fprintf(stderr, "%s\n", oxl_error_text(ctx));
    free(points);
    oxl_image_free(ctx, &fitted);
    oxl_image_free(ctx, &image);
    oxl_trained_free(ctx, &trained);
    oxl_scene_free(ctx, scene);
    oxl_context_free(ctx);
    return rc != OXL_OK || psnr < 25;
}
