/* align.c - moves a held-out view's camera onto its own image, the model fixed.
 *
 * Where the poses of training views were refined, the scene is sharper than the poses of held-out views are
 * exact, and their PSNR measures the poses. Aligned first, by the same six numbers (survey/pose.c) and the
 * loss of training, a view measures the scene, as in the evaluation of BARF (Lin 2021). Both are reported.
 */
#include "evaluate.h"
#include "../core/vecmath.h"
#include "../survey/scene.h"

#define ALIGN_RATE 1e-3 /* Sets the rate (rad) of the first step. */
#define ALIGN_LAST 0.03 /* Sets the rate of the last step, as a fraction of the first. */
#define ALIGN_MOST 0.05 /* Limits the turn (rad), and the move in median depths. */
#define ALIGN_SSIM 0.2f /* Weights SSIM in the loss [Kerbl 2023]. */
enum { ALIGN_STEPS = 40 };

OXL_INTERNAL oxl_result align_view(oxl_context *ctx, const struct drawn *d, int view, const oxl_image *image,
                                   const oxl_render_options *options, oxl_model *gradient, oxl_camera *out)
{
    const oxl_camera given = scene_camera(d->scene, d->imaging, view);
    struct pose_rule rule = {.most = ALIGN_MOST, .depth = scene_depth_quantile(d->scene, 0.5)};
    struct renderer_loss loss;
    struct pose pose = {.visits = 0};
    float gain[3];
    oxl_result rc = OXL_OK;
    if (!(rule.depth > 0)) rule.depth = d->scene->extent;
    *out = given;
    oxl_imaging_gain(d->imaging, view, gain);
    *renderer_settings(d->r) = (struct renderer_settings){.medium = d->imaging->medium,
                                                          .lamp = imaging_lamp(d->imaging, d->scene, view),
                                                          .gain = d->imaging->on ? gain : NULL,
                                                          .pose = 1};
    for (int i = 0; i < ALIGN_STEPS && rc == OXL_OK; i++) {
        rule.rate = ALIGN_RATE * vecmath_exp((double)i / ALIGN_STEPS * vecmath_log(ALIGN_LAST));
        rc = renderer_forward(ctx, d->r, d->model, out, options);
        if (rc == OXL_OK) rc = renderer_loss(ctx, d->r, image->rgb, image->weight, ALIGN_SSIM, &loss);
        if (rc == OXL_OK) rc = renderer_backward(ctx, d->r, NULL, gradient);
        if (rc == OXL_OK) pose_step(&pose, &given, renderer_pose_gradient(d->r), &rule);
        pose_apply(&given, pose.at, out);
    }
    *renderer_settings(d->r) = (struct renderer_settings){0};
    return rc;
}
