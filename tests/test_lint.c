/* test_lint.c - surveys whose files can be read, and which yet are wrong. */
#include "test.h"

/* The survey of test_job.c, with points that are seen in the images that their tracks name. */
static const char *lint_survey(void)
{
    OWNED_TEXT points = {.ctx = test_ctx};
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
    CHECK_OK(oxl_check(test_ctx, lint_survey(), NULL, &s));
    CHECK(s.foreign == 0 && s.unusable == 0 && s.masked == 0);
    CHECK(test_said.warning[0] == 0);
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
    CHECK_OK(oxl_check(test_ctx, survey, NULL, &s));
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
    CHECK_ERROR(oxl_check(test_ctx, test_path("survey"), NULL, &s), OXL_ERR_INPUT,
                "none of the 7 training views can be used");
}

/* ---------------- where images saw the points */

struct lint_sight {       /* what is wrong with a survey of two cameras, in turns */
    double focal, factor; /* times the focal length of the second, and the 2D points */
    int order, inverse;   /* quaternions x y z w; camera to world: 1 poses, 2 rotations, 3 translations */
    int opengl, some;     /* camera axes; 1: the first two images alone */
    int lost;             /* 1: the fourth image is far away */
};

/* Points of lint_survey, seen by cameras that turn a little about an axis askew, and where they see them. */
static void lint_write_sight(const struct lint_sight *s)
{
    OWNED_TEXT images = {.ctx = test_ctx}, cameras = {.ctx = test_ctx};
    for (int c = 0; c < 2; c++)
        text_add(&cameras, "%d PINHOLE 48 32 %g %g 24 16\n", c + 1, 40 * (c ? s->focal : 1),
                 40 * (c ? s->focal : 1));
    for (int v = 0; v < JOB_VIEWS; v++) {
        const double angle = 0.1 + 0.02 * v, n = sin(angle) / sqrt(3), q[4] = {cos(angle), n, n, n};
        const double t[3] = {-0.1 * v, 0.1, 1}, far = s->lost && v == 3 ? 900 : 0;
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
                     far + (inverse == 1 || inverse == 3 ? back : t)[k] * (wrong && s->opengl && k ? -1 : 1));
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
}

TEST(lint_says_how_poses_and_cameras_would_fit_what_the_images_saw)
{
    static const struct {
        struct lint_sight sight;
        int foreign;
        const char *said;
    } cases[] = {{{.focal = 1, .factor = 1}, 0, ""},
                 {{.focal = 1, .factor = 8}, 0, ""}, /* 2D points of images before reduction */
                 {{.focal = 2, .factor = 1},
                  4,
                  "4 of 9 images do not show the colours that the model's points have: "
                  "1.png (fits with another focal length), 3.png"},
                 {{.focal = 1, .factor = 1, .order = 1}, 9, "they would fit as: quaternions as x y z w"},
                 {{.focal = 1, .factor = 1, .inverse = 1}, 9, "they would fit as: camera to world"},
                 {{.focal = 1, .factor = 1, .inverse = 2},
                  9,
                  "they would fit as: rotations transposed (of camera to world)"},
                 {{.focal = 1, .factor = 1, .inverse = 3},
                  9,
                  "they would fit as: the cameras' places as translations"},
                 {{.focal = 1, .factor = 1, .opengl = 1}, 9, "they would fit as: camera axes as in OpenGL"},
                 {{.focal = 1, .factor = 1, .order = 1, .some = 1},
                  2,
                  "2 of 9 images do not show the colours that the model's "
                  "points have: 0.png (fits quaternions as x y z w)"},
                 {{.focal = 1, .factor = 1, .inverse = 2, .some = 1}, 2, "0.png (fits rotations transposed"},
                 {{.focal = 1, .factor = 1, .lost = 1},
                  1,
                  "1 of 9 images do not show the colours that the model's points have: "
                  "3.png\nfix: take them out of the model"}};
    for (size_t i = 0; i < OXL_COUNT(cases); i++) {
        const char *survey = lint_survey();
        oxl_survey s;
        lint_write_sight(&cases[i].sight);
        CHECK_OK(oxl_check(test_ctx, survey, NULL, &s));
        CHECK(s.foreign == cases[i].foreign);
        CHECK_WARNED(cases[i].said);
        CHECK((test_said.warning[0] == 0) == (cases[i].foreign == 0));
    }
}
