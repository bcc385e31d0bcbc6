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
    CHECK_OK(oxl_make_folder(test_ctx, test_path("survey/masks")));
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

/* ---------------- where images saw the points */

struct lint_sight {       /* what is wrong with a survey of two cameras, in turns */
    double focal, factor; /* times the focal length of the second, and the 2D points */
    int order, inverse;   /* quaternions x y z w; camera to world: 1 poses, 2 rotations, 3 translations */
    int opengl, some;     /* camera axes; 1: the first two images alone */
};

/* Points of lint_survey, seen by cameras that turn a little about an axis askew, and where they see them. */
static void lint_write_sight(const struct lint_sight *s)
{
    struct text images = {.ctx = test_ctx}, cameras = {.ctx = test_ctx};
    for (int c = 0; c < 2; c++)
        text_add(&cameras, "%d PINHOLE 48 32 %g %g 24 16\n", c + 1, 40 * (c ? s->focal : 1),
                 40 * (c ? s->focal : 1));
    for (int v = 0; v < JOB_VIEWS; v++) {
        const double angle = 0.1 + 0.02 * v, n = sin(angle) / sqrt(3), q[4] = {cos(angle), n, n, n};
        const double t[3] = {-0.1 * v, 0.1, 1};
        const int wrong = !s->some || v < 2, inverse = wrong ? s->inverse : 0;
        double r[9], back[3], turned[4] = {-q[1], q[0], -q[3], q[2]};
        camera_rotation_from_quaternion(q, r);
        for (int i = 0; i < 3; i++) back[i] = -(r[i] * t[0] + r[3 + i] * t[1] + r[6 + i] * t[2]);
        text_add(&images, "%d", v + 1);
        for (int k = 0; k < 4; k++)
            text_add(&images, " %.12f",
                     wrong && s->opengl                    ? turned[k]
                     : wrong && s->order                   ? q[(k + 1) % 4]
                     : k && (inverse == 1 || inverse == 2) ? -q[k]
                                                           : q[k]);
        for (int k = 0; k < 3; k++)
            text_add(&images, " %.12f",
                     (inverse == 1 || inverse == 3 ? back : t)[k] * (wrong && s->opengl && k ? -1 : 1));
        text_add(&images, " %d %d.png\n", v % 2 + 1, v);
        for (int i = 0; i < 40; i++) {
            const double w[3] = {-1 + 0.2 * (i % 10), -0.75 + 0.5 * (i / 10), 4};
            double x[3];
            for (int k = 0; k < 3; k++)
                x[k] = r[3 * k] * w[0] + r[3 * k + 1] * w[1] + r[3 * k + 2] * w[2] + t[k];
            text_add(&images, "%.3f %.3f %d ", s->factor * (24 + 40 * x[0] / x[2]),
                     s->factor * (16 + 40 * x[1] / x[2]), i + 1);
        }
        text_add(&images, "\n");
    }
    test_write("survey/sparse/0/images.txt", images.data);
    test_write("survey/sparse/0/cameras.txt", cameras.data);
    text_free(&images);
    text_free(&cameras);
}

static const char *lint_sight(struct lint_sight s)
{
    const char *survey = lint_survey();
    oxl_survey out;
    lint_write_sight(&s);
    CHECK_OK(oxl_check(test_ctx, survey, NULL, &out));
    return lint_heard;
}

TEST(lint_says_nothing_where_points_project_to_where_images_saw_them)
{
    CHECK(!strstr(lint_sight((struct lint_sight){.focal = 1, .factor = 1}), "points project"));
    CHECK(!strstr(lint_sight((struct lint_sight){.focal = 1, .factor = 8}),
                  "points project")); /* of images before reduction */
}

TEST(lint_finds_the_one_camera_of_another_focal_length)
{
    const char *said = lint_sight((struct lint_sight){.focal = 2, .factor = 1});
    CHECK_TEXT(said, "the same camera took all of these and no other");
    CHECK_TEXT(said, "look at its focal length");
}

TEST(lint_names_the_convention_of_poses_by_where_images_saw_the_points)
{
    CHECK_TEXT(lint_sight((struct lint_sight){.focal = 1, .factor = 1, .order = 1}),
               "the quaternions stand as x y z w");
    CHECK_TEXT(lint_sight((struct lint_sight){.focal = 1, .factor = 1, .inverse = 1}),
               "the poses are camera to world");
    CHECK_TEXT(lint_sight((struct lint_sight){.focal = 1, .factor = 1, .inverse = 2}),
               "the rotations are of camera to world");
    CHECK_TEXT(lint_sight((struct lint_sight){.focal = 1, .factor = 1, .inverse = 3}),
               "the cameras' places stand as translations");
    CHECK_TEXT(lint_sight((struct lint_sight){.focal = 1, .factor = 1, .opengl = 1}),
               "the camera axes are those of OpenGL");
}

TEST(lint_names_the_convention_of_some_of_the_poses)
{
    CHECK_TEXT(lint_sight((struct lint_sight){.focal = 1, .factor = 1, .order = 1, .some = 1}),
               "where 2 of 9 images saw them (0.png, median): the quaternions");
    CHECK_TEXT(lint_sight((struct lint_sight){.focal = 1, .factor = 1, .inverse = 2, .some = 1}),
               "where 2 of 9 images saw them (0.png, median): the rotations");
}
