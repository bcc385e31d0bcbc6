/* test_lint.c - surveys whose files can be read, and which yet are wrong. */
#include "test.h"

char lint_heard[4096]; /* what the library said */

void lint_listen(void *user, oxl_log_level level, const char *text)
{
    const size_t used = strlen(lint_heard);
    (void)user;
    if (level == OXL_LOG_WARNING) snprintf(lint_heard + used, sizeof lint_heard - used, "%s\n", text);
}

/* The survey of test_job.c, with points that are seen in the images that their tracks name. */
static const char *lint_survey(void)
{
    struct text points = {.ctx = test_ctx};
    const char *survey = job_test_survey();
    for (int i = 0; i < 40; i++) {
        text_add(&points, "%d %.3f %.3f 4 90 120 60 0.5", i + 1, -1 + 0.2 * (i % 10), -0.75 + 0.5 * (i / 10));
        for (int v = 0; v < JOB_VIEWS; v++) text_add(&points, " %d 0", v + 1);
        text_add(&points, "\n");
    }
    test_write("survey/sparse/0/points3D.txt", points.data);
    text_free(&points);
    lint_heard[0] = 0;
    test_ctx->options.log = lint_listen;
    return survey;
}

TEST(lint_finds_nothing_in_a_valid_survey)
{
    oxl_survey s;
    CHECK_OK(oxl_check(test_ctx, lint_survey(), NULL, &s));
    CHECK(s.missed == 0 && s.unusable == 0 && s.masked == 0);
    CHECK(lint_heard[0] == 0);
}

TEST(lint_says_that_poses_and_points_do_not_belong_together)
{
    const char *survey = lint_survey(), *images = test_path("survey/sparse/0/images.txt");
    oxl_survey s;
    /* as a program writes them that means the way from camera to world, and looks along -z */
    for (int i = 0; i < JOB_VIEWS; i++) {
        char from[32], to[32];
        snprintf(from, sizeof from, "%d 1 0 0 0 ", i + 1);
        snprintf(to, sizeof to, "%d 0 1 0 0 ", i + 1);
        job_test_replace(images, from, to);
    }
    CHECK_OK(oxl_check(test_ctx, survey, NULL, &s));
    CHECK(s.missed == 1);
    CHECK_TEXT(s.warnings, "100 % of the track entries project outside their images");
    CHECK(!strstr(lint_heard, "its pose is wrong")); /* all are */
}

TEST(lint_names_the_image_whose_pose_is_wrong)
{
    const char *survey = lint_survey();
    oxl_survey s;
    job_test_replace(test_path("survey/sparse/0/images.txt"), "4 1 0 0 0 -0.300", "4 1 0 0 0 1000");
    CHECK_OK(oxl_check(test_ctx, survey, NULL, &s));
    CHECK(s.missed == 0); /* of the others */
    CHECK_TEXT(lint_heard,
               "3.png: 100 % of the points in its tracks project outside this image, so its pose is wrong");
    CHECK(!strstr(lint_heard, "2.png"));
}

TEST(lint_counts_images_and_masks_that_cannot_be_used)
{
    const char *survey = lint_survey();
    oxl_image other;
    oxl_survey s;
    CHECK_OK(oxl_image_create(test_ctx, 32, 48, &other));
    CHECK_OK(oxl_image_write(test_ctx, test_path("survey/images/2.png"), &other)); /* turned */
    test_write("survey/images/8.png", "no image");                                 /* held out */
    CHECK_OK(os_make_folder(test_ctx, test_path("survey/masks")));
    oxl_image_free(test_ctx, &other);
    CHECK_OK(oxl_image_create(test_ctx, 24, 16, &other));
    CHECK_OK(oxl_image_write(test_ctx, test_path("survey/masks/5.png"), &other)); /* black */
    for (int i = 0; i < 3 * 24 * 8; i++) other.rgb[i % 192 + i / 192 * 384] = 1;
    CHECK_OK(
        oxl_image_write(test_ctx, test_path("survey/masks/6.png.png"), &other)); /* the upper half counts */
    oxl_image_free(test_ctx, &other);
    CHECK_OK(oxl_image_create(test_ctx, 16, 16, &other));
    memset(other.rgb, 0x3f, 3 * 16 * 16 * sizeof *other.rgb); /* 0.75 */
    CHECK_OK(oxl_image_write(test_ctx, test_path("survey/masks/7.png"), &other));
    oxl_image_free(test_ctx, &other);
    CHECK_OK(oxl_check(test_ctx, survey, NULL, &s));
    CHECK(s.unusable == 3 && s.masks == 3);
    CHECK_CLOSE(s.masked, 0.5, 1e-12);
    CHECK_TEXT(s.text, "3 masks (50 % of their pixels black, ignored)");
    CHECK_TEXT(s.warnings, "3 of 9 images cannot be used");
    CHECK_TEXT(lint_heard,
               "2.png: 32 x 48 px, but camera 1 (cameras.txt:1) has 48 x 32, another shape\nfix: turn it");
    CHECK_TEXT(lint_heard, "8.png: neither a JPEG nor a PNG");
    CHECK_TEXT(lint_heard, "masks/5.png: the mask is all black");
    CHECK_TEXT(lint_heard, "masks/7.png: 16 x 16 px, but its image has another aspect ratio");
    for (int i = 0; i < JOB_VIEWS; i++) {
        char name[64];
        snprintf(name, sizeof name, "survey/images/%d.png", i);
        test_write(name, "no image");
    }
    CHECK(oxl_check(test_ctx, test_path("survey"), NULL, &s) == OXL_ERR_INPUT);
    CHECK_TEXT(oxl_error_text(test_ctx), "none of the 7 training views can be used");
}
