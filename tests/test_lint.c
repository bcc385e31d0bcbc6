/* test_lint.c - surveys whose files can be read, and which yet are wrong. */
#include "test.h"

/* The survey of test_job.c, with points that are seen in the images that their tracks name. */
static const char *lint_survey(void)
{
    OWNED_TEXT points = test_text();
    const char *survey = job_test_survey();
    for (int i = 0; i < 40; i++) {
        text_add(&points, "%d %.3f %.3f 4 90 120 60 0.5", i + 1, -1 + 0.2 * (i % 10), -0.75 + 0.5 * (i / 10));
        for (int v = 0; v < JOB_VIEWS; v++) text_add(&points, " %d 0", v + 1);
        text_add(&points, "\n");
    }
    test_write("survey/sparse/0/points3D.txt", points.data);
    test_listen();
    return survey;
}

TEST(lint_finds_nothing_in_a_valid_survey)
{
    oxl_survey s;
    CHECK_OK(oxl_check(test_ctx, lint_survey(), NULL, 0, &s));
    CHECK(s.foreign == 0 && s.unusable == 0 && s.masked == 0 && test_said.warning[0] == 0);
}

TEST(lint_counts_images_and_masks_that_cannot_be_used)
{
    const char *survey = lint_survey();
    oxl_survey s;
    oxl_image other = test_image(32, 48);
    test_write_image("survey/images/2.png", &other); /* turned */
    test_write("survey/images/8.png", "no image");   /* held out */
    test_make_folder("survey/masks");
    oxl_image_free(test_ctx, &other);
    other = test_image(24, 16);
    test_write_image("survey/masks/5.png", &other); /* black */
    for (int i = 0; i < 3 * 24 * 8; i++) other.rgb[i % 192 + i / 192 * 384] = 1;
    test_write_image("survey/masks/6.png.png", &other); /* the upper half counts */
    oxl_image_free(test_ctx, &other);
    other = test_image(16, 16);
    memset(other.rgb, 0x3f, 3 * 16 * 16 * sizeof *other.rgb); /* 0.75 */
    test_write_image("survey/masks/7.png", &other);
    oxl_image_free(test_ctx, &other);
    CHECK_OK(oxl_check(test_ctx, survey, NULL, 0, &s));
    CHECK(s.unusable == 3 && s.masks == 3);
    CHECK_CLOSE(s.masked, 0.5, 1e-12);
    CHECK_TEXT(s.text, "3 masks (50 % of their pixels are black and ignored)");
    CHECK_TEXT(s.warnings, "3 of 9 images cannot be used");
    CHECK_WARNED(
        "2.png has 32 x 48 px, but camera 1 (cameras.txt:1) has 48 x 32 px, another aspect ratio\nfix: turn it");
    CHECK_WARNED("8.png: neither a JPEG nor a PNG");
    CHECK_WARNED("masks/5.png: the mask is all black");
    CHECK_WARNED("masks/7.png: 16 x 16 px, but its image has another aspect ratio");
    for (int i = 0; i < JOB_VIEWS; i++) {
        test_write(test_path("survey/images/%d.png", i), "no image");
    }
    CHECK_ERROR(oxl_check(test_ctx, test_path("survey"), NULL, 0, &s), OXL_ERR_INPUT,
                "none of the 7 training views can be used");
}
