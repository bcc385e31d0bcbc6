/* loss_on_pixels.c - a loss of one's own: edges. The render's differences of pixels side by side should be
 * the image's; the loss is their absolute error:
 *
 *     L = w / n sum |(x[i+1] - x[i]) - (y[i+1] - y[i])|,   dL/dx[i+1] = w / n sign(...) = -dL/dx[i].
 *
 *     build/examples/loss_on_pixels SCENE [WEIGHT]
 */
#include "oceanxl.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

static double edges(void *user, const oxl_image *rendered, const oxl_image *image, float *drgb)
{
    const double weight = *(const double *)user;
    const size_t rows = 3 * (size_t)image->height, width = (size_t)image->width;
    const float step = (float)(weight / (double)(rows * width));
    double sum = 0;
    for (size_t y = 0; y < rows; y++)
        for (size_t i = y * width; i + 1 < (y + 1) * width; i++) {
            const float *x = rendered->rgb, *t = image->rgb, e = (x[i + 1] - x[i]) - (t[i + 1] - t[i]);
            const float *w = image->weight ? image->weight + i % (width * (size_t)image->height) : NULL;
            if (w && (w[0] == 0 || w[1] == 0)) continue; /* masked */
            sum += fabs(e);
            drgb[i + 1] += e > 0 ? step : -step;
            drgb[i] -= e > 0 ? step : -step;
        }
    return sum * step;
}

int main(int argc, char **argv)
{
    double weight = argc > 2 ? atof(argv[2]) : 0.5;
    const oxl_terms terms = {.pixels = edges, .user = &weight};
    oxl_train_options options = oxl_train_options_default(OXL_PRESET_DRAFT);
    oxl_scene_options reading = oxl_scene_options_default();
    oxl_context *ctx = NULL;
    oxl_scene *scene = NULL;
    oxl_trained t = {.finished = 0};
    oxl_metrics m = {0};
    oxl_result rc = oxl_context_create(NULL, &ctx);
    options.iterations = 300, options.terms = &terms, reading.max_side = 320;
    if (rc == OXL_OK) rc = oxl_scene_load(ctx, argc > 1 ? argv[1] : "survey", &reading, &scene);
    if (rc == OXL_OK) rc = oxl_train(ctx, scene, &options, NULL, &t);
    if (rc == OXL_OK) rc = oxl_evaluate(ctx, &t.model, scene, t.imaging, OXL_SPLIT_TEST, &m);
    if (rc == OXL_OK) printf("weight %g: PSNR %.2f dB, structure %.3f\n", weight, m.psnr, m.structure);
    if (rc != OXL_OK) fprintf(stderr, "%s\n", oxl_error_text(ctx));
    oxl_metrics_free(ctx, &m);
    oxl_trained_free(ctx, &t);
    oxl_scene_free(ctx, scene);
    oxl_context_free(ctx);
    return rc != OXL_OK;
}
