/* test_antialias.c - models that look alike at every size: the light of a splat, files, runs. Gradients and
 * images are compared with reference/splat.c in test_reference.c. */
#include "test.h"
#include "cases.h"

/* The sum of a small splat's image, of a field of view that does not change. */
static double antialias_test_light(int width, int antialias)
{
    const oxl_camera camera = test_camera(width, width, width, 0, 0, 0);
    double sum = 0;
    OWNED_MODEL m = test_model(1, 0);
    m.plane[OXL_MEAN + 2][0] = 4;
    for (int k = 0; k < 3; k++) {
        m.plane[OXL_LOG_SCALE + k][0] = -2.5f; /* 0.66 px at a width of 32 */
        m.plane[OXL_SH + k][0] = 1;
    }
    m.antialias = antialias;
    OWNED_IMAGE image = test_render(&m, &camera);
    for (int i = 0; i < width * width; i++) sum += (double)image.rgb[i];
    return sum / (width * width);
}

TEST(antialias_keeps_a_splats_light_at_any_size)
{
    const double large = antialias_test_light(256, 1);
    CHECK_CLOSE(antialias_test_light(64, 1), large, 0.03 * large);
    CHECK_CLOSE(antialias_test_light(32, 1), large, 0.1 * large);
    CHECK(antialias_test_light(32, 0) > 1.5 * large); /* it swells */
}

/* Brush's and Postshot's words for it. */
TEST(antialias_of_other_programs_is_read)
{
    static const struct {
        const char *comment;
        int antialias;
    } cases[] = {{"SplatRenderMode: mip", 1},
                 {"SplatRenderMode: default", 0},
                 {"antialiased 1", 1},
                 {"antialiased 0", 0}};
    for (size_t k = 0; k < OXL_COUNT(cases); k++) {
        oxl_model m = {.antialias = !cases[k].antialias};
        model_read_comments(test_ctx, "m.ply", cases[k].comment, strlen(cases[k].comment), "", &m);
        CHECK(m.antialias == cases[k].antialias);
    }
}

TEST(antialias_is_missed_in_splat)
{
    OWNED_MODEL m = test_model(2, 0);
    m.antialias = 1;
    test_listen();
    test_write_model("m.splat", &m);
    CHECK_WARNED("cannot store that the model is anti-aliased");
}

TEST(antialias_of_a_run_is_that_of_its_model_resumed_or_not)
{
    NEEDS_PART(antialias);
    OWNED_CHECKPOINT_CASE c = checkpoint_of(train_scene(6), train_options(40));
    c.options.antialias = 1;
    checkpoint_check_stops(&c, (const int[]){15, 0});
    CHECK(c.whole.antialias == 1);
}
