/* test_ssim_contrast.c - the contrast of the images, by which SSIM in the loss is scaled. */
#include "test.h"
#include "../src/parts/ssim_contrast.h"

enum { SSIM_CONTRAST_TEST_W = 60, SSIM_CONTRAST_TEST_H = 40, SSIM_CONTRAST_TEST_VIEWS = 3 };

/* Stripes of 1 px, `level` above and below 0.4, on a slope of brightness over the image. */
static oxl_scene *ssim_contrast_test_scene(float level)
{
    enum { W = SSIM_CONTRAST_TEST_W, H = SSIM_CONTRAST_TEST_H, N = SSIM_CONTRAST_TEST_VIEWS };
    oxl_view view[N];
    oxl_image image[N];
    oxl_point point[1] = {{.position = {0, 0, 0}}};
    for (int v = 0; v < N; v++) {
        static const char *const name[] = {"a", "b", "c"};
        view[v] = (oxl_view){name[v], test_camera(W, H, 50, -v, 0, -4), 0};
        image[v] = test_image(W, H);
        for (int i = 0; i < 3 * W * H; i++)
            image[v].rgb[i] = 0.4f + 0.001f * (float)(i % W) + (i / W % 2 ? level : -level);
    }
    return test_scene(view, image, N, point, 1);
}

TEST(ssim_contrast_follows_faint_images_alone)
{
    CHECK(ssim_contrast_of_detail(0.0086) == 0.0086);
    CHECK(ssim_contrast_of_detail(0.001) == 1.0 / 255); /* rounding to 8 bits */
    CHECK(ssim_contrast_of_detail(0.0123) == 0.03);     /* Wang's */
    CHECK(ssim_contrast_of_detail(0.09) == 0.03);
    CHECK(ssim_contrast_of_detail(0) == 0.03); /* nothing was measured */
}

TEST(ssim_contrast_is_the_standard_deviation_of_detail_whatever_the_light)
{
    const float levels[] = {0, 0.01f, 0.1f};
    for (int k = 0; k < 3; k++) {
        OWNED_SCENE *scene = ssim_contrast_test_scene(levels[k]);
        double contrast;
        int views;
        CHECK_OK(ssim_contrast_measure(test_ctx, scene, &contrast, &views));
        CHECK(views == SSIM_CONTRAST_TEST_VIEWS);
        CHECK_CLOSE(contrast, 0.98 * (double)levels[k],
                    0.003); /* of 5 rows: sqrt(24) / 5; levels of 8 bits */
    }
}

/* Structure of the trained model's images against the scene without water, lamp and noise. */
static double ssim_contrast_test_learned(const synth_options *survey, int stereo)
{
    oxl_train_options o = train_options(150);
    oxl_scene_options truth = oxl_scene_options_default();
    char clean[600];
    o.stereo = stereo;
    o.densify_every = 50;
    o.lamp = OXL_ON;
    oxl_scene *scene = test_load(survey->out, NULL);
    OWNED_MODEL model = test_trained(scene, &o);
    oxl_scene_free(test_ctx, scene);
    snprintf(clean, sizeof clean, "%s/truth/clean", survey->out);
    truth.images = clean;
    scene = test_load(survey->out, &truth);
    double learned = test_evaluate(&model, scene, &test_imaging, OXL_SPLIT_ALL).structure;
    oxl_scene_free(test_ctx, scene);
    return learned;
}

/* Writes a dark strip of faint sand with few points. */
static synth_options ssim_contrast_test_sand(const char *name)
{
    synth_options o = synth_test_options(name);
    o.views = 8, o.width = 96, o.height = 64, o.points = 60, o.water = SYNTH_3C, o.path = SYNTH_FORWARD;
    o.stereo = 0.3, o.lamp = 1, o.exposure_jitter = 0.5, o.noise = 0.6, o.sand_contrast = 0.2;
    synth_test_make(&o, NULL);
    return o;
}

/* With SSIM's own constant structure is 0.55: the run learns the light alone. */
TEST(faint_sand_is_learned_better_than_with_the_constant_for_bright_images)
{
    NEEDS_PART(lamp);
    const synth_options o = ssim_contrast_test_sand("faint");
    const double learned = ssim_contrast_test_learned(&o, 0);
    CHECK(learned > 0.55 + 0.04);
}

TEST(faint_sand_is_learned_better_with_points_from_stereo)
{
    NEEDS_PART(stereo);
    const synth_options o = ssim_contrast_test_sand("gapped");
    const double off = ssim_contrast_test_learned(&o, 0), on = ssim_contrast_test_learned(&o, 1);
    CHECK(on > off + 0.04);
}
