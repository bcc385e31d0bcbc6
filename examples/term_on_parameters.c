/* term_on_parameters.c - a regulariser of one's own: round Gaussians. The spread of a Gaussian's three log
 * scales s around their mean is to be small:
 *
 *     R = w / n sum over Gaussians and axes (s_k - mean)^2,   dR/ds_k = 2 w / n (s_k - mean).
 *
 *     build/examples/term_on_parameters SCENE [WEIGHT]
 */
#include "oceanxl.h"

#include <stdio.h>
#include <stdlib.h>

static double roundness(void *user, const oxl_model *model, oxl_model *gradient)
{
    const double weight = *(const double *)user / (double)model->count;
    float *const *s = &model->plane[OXL_LOG_SCALE], *const *d = &gradient->plane[OXL_LOG_SCALE];
    double sum = 0;
    for (size_t i = 0; i < model->count; i++) {
        const double mean = (s[0][i] + s[1][i] + s[2][i]) / 3;
        for (int k = 0; k < 3; k++) {
            const double off = s[k][i] - mean;
            sum += off * off;
            d[k][i] += (float)(2 * weight * off);
        }
    }
    return weight * sum;
}

int main(int argc, char **argv)
{
    double weight = argc > 2 ? atof(argv[2]) : 0.1, one = 1;
    const oxl_terms terms = {.parameters = roundness, .user = &weight};
    oxl_train_options options = oxl_train_options_default(OXL_PRESET_DRAFT);
    oxl_scene_options reading = oxl_scene_options_default();
    oxl_context *ctx = NULL;
    oxl_scene *scene = NULL;
    oxl_trained t = {.finished = 0};
    oxl_model unused = {0};
    oxl_result rc = oxl_context_create(NULL, &ctx);
    options.iterations = 300, options.terms = &terms, reading.max_side = 320;
    if (rc == OXL_OK) rc = oxl_scene_load(ctx, argc > 1 ? argv[1] : "survey", &reading, &scene);
    if (rc == OXL_OK) rc = oxl_train(ctx, scene, &options, NULL, &t);
    if (rc == OXL_OK) rc = oxl_model_create(ctx, t.model.count, t.model.sh_degree, &unused);
    if (rc == OXL_OK)
        printf("weight %g: the mean square spread of the log scales is %.3f\n", weight,
               roundness(&one, &t.model, &unused));
    if (rc != OXL_OK) fprintf(stderr, "%s\n", oxl_error_text(ctx));
    oxl_model_free(ctx, &unused);
    oxl_trained_free(ctx, &t);
    oxl_scene_free(ctx, scene);
    oxl_context_free(ctx);
    return rc != OXL_OK;
}
