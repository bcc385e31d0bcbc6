/* density_rule.c - a density rule of one's own: no needles. Where the model is densified, Gaussians that are
 * more than LENGTH times as long as the geometric mean of their other two axes are removed whatever their
 * gradient says; the room that they leave goes to others, which the library splits.
 *
 *     build/examples/density_rule SCENE [LENGTH]
 */
#include "oceanxl.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

/* log of the length over the geometric mean of the other two axes */
static float slimness(const oxl_model *m, size_t i)
{
    float *const *s = &m->plane[OXL_LOG_SCALE];
    const float longest = fmaxf(fmaxf(s[0][i], s[1][i]), s[2][i]);
    return longest - (s[0][i] + s[1][i] + s[2][i] - longest) / 2;
}

static void drop_needles(void *user, const oxl_model *model, const float *gradient, const float *views,
                         uint8_t *change)
{
    const float most = *(const float *)user;
    (void)gradient, (void)views;
    for (size_t i = 0; i < model->count; i++)
        if (slimness(model, i) > most) change[i] = OXL_REMOVE;
}

int main(int argc, char **argv)
{
    float most = logf(argc > 2 ? (float)atof(argv[2]) : 10);
    const oxl_terms terms = {.density = drop_needles, .user = &most};
    oxl_train_options options = oxl_train_options_default(OXL_PRESET_DRAFT);
    oxl_scene_options reading = oxl_scene_options_default();
    oxl_context *ctx = NULL;
    oxl_scene *scene = NULL;
    oxl_result rc = oxl_context_create(NULL, &ctx);
    options.iterations = 300, reading.max_side = 320;
    if (rc == OXL_OK) rc = oxl_scene_load(ctx, argc > 1 ? argv[1] : "survey", &reading, &scene);
    /* leaves room for splits, also in a small survey */
    if (rc == OXL_OK) options.max_gaussians = 2 * (int)oxl_scene_point_count(scene);
    for (int own = 0; rc == OXL_OK && own < 2; own++) {
        oxl_trained t = {.finished = 0};
        oxl_metrics m = {0};
        size_t needles = 0;
        options.terms = own ? &terms : NULL;
        rc = oxl_train(ctx, scene, &options, NULL, &t);
        if (rc == OXL_OK) rc = oxl_evaluate(ctx, &t.model, scene, t.imaging, OXL_SPLIT_TEST, &m);
        for (size_t i = 0; i < t.model.count; i++) needles += slimness(&t.model, i) > most;
        if (rc == OXL_OK)
            printf("%s rule: %zu needles of %zu Gaussians, PSNR %.2f dB\n", own ? "own" : "library's",
                   needles, t.model.count, m.psnr);
        oxl_metrics_free(ctx, &m);
        oxl_trained_free(ctx, &t);
    }
    if (rc != OXL_OK) fprintf(stderr, "%s\n", oxl_error_text(ctx));
    oxl_scene_free(ctx, scene);
    oxl_context_free(ctx);
    return rc != OXL_OK;
}
