/* train_survey.c - a survey trained through the API, with a progress callback that also decides when it is
 * good enough.
 *
 *     build/examples/train_survey SCENE [FOLDER, which exists]     SCENE: images and a COLMAP
 *     model, as `oceanxl synth -o SCENE` writes them
 */
#include "oceanxl.h"

#include <stdio.h>
#include <stdlib.h>

struct goal {
    double psnr; /* dB on the training images */
    int reached, shown;
};

/* Called after every step; nonzero stops the run, and the model so far is kept. */
static int watch(void *user, const oxl_progress *p)
{
    struct goal *goal = user;
    if (p->iteration * 10 / p->iterations > goal->shown) {
        goal->shown = p->iteration * 10 / p->iterations;
        printf("%5d of %d: loss %.4f, PSNR %.2f dB, %zu Gaussians, %.0f s to go\n", p->iteration,
               p->iterations, p->loss, p->psnr, p->gaussians, p->seconds_left);
    }
    goal->reached = p->psnr >= goal->psnr;
    return goal->reached;
}

static void print_log(void *user, oxl_log_level level, const char *text)
{
    (void)user;
    if (level <= OXL_LOG_WARNING) fprintf(stderr, "%s\n", text);
}

int main(int argc, char **argv)
{
    struct goal goal = {.psnr = 40};
    const oxl_callback callback = {watch, &goal};
    oxl_context_options options = oxl_context_options_default();
    oxl_scene_options reading = oxl_scene_options_default();
    oxl_train_options train = oxl_train_options_default(OXL_PRESET_DRAFT);
    oxl_context *ctx = NULL;
    oxl_scene *scene = NULL;
    oxl_trained trained = {0};
    oxl_metrics metrics = {0};
    oxl_result rc;
    if (argc < 2) {
        fprintf(stderr, "usage: %s SCENE [FOLDER]\n", argv[0]);
        return 2;
    }
    options.log = print_log;
    reading.max_side = 320; /* a quick look */
    train.iterations = 300;
    rc = oxl_context_create(&options, &ctx);
    if (rc == OXL_OK) rc = oxl_scene_load(ctx, argv[1], &reading, &scene);
    if (rc == OXL_OK) rc = oxl_train(ctx, scene, &train, &callback, &trained);
    if (rc == OXL_ERR_INTERRUPTED && goal.reached) rc = OXL_OK;
    if (rc == OXL_OK)
        rc = oxl_evaluate(ctx, &trained.model, scene, trained.imaging, OXL_SPLIT_TEST, &metrics);
    if (rc == OXL_OK && argc > 2) rc = oxl_trained_write(ctx, argv[2], scene, &trained);
    if (rc == OXL_OK)
        printf("held-out views: PSNR %.2f dB, SSIM %.4f over %d\n", metrics.psnr, metrics.ssim,
               metrics.count);
    if (rc != OXL_OK) fprintf(stderr, "%s\n", oxl_error_text(ctx));
    oxl_metrics_free(ctx, &metrics);
    oxl_trained_free(ctx, &trained);
    oxl_scene_free(ctx, scene);
    oxl_context_free(ctx);
    return rc != OXL_OK;
}
