/* test_foreign.c - files that are well formed and belong to something else: images, poses, points, models. */
#include "test.h"

#include "../src/survey/image_header.h"

#ifndef _WIN32
#include <unistd.h>
#endif

enum { FOREIGN_VIEWS = 10, FOREIGN_WIDTH = 160, FOREIGN_HEIGHT = 112, FOREIGN_POINTS = 360 };

/* Brightness of a plane, in patches of half a unit, without a pattern that repeats. */
static double foreign_brightness(double x, double y)
{
    const unsigned i = (unsigned)((int)floor(4 * x) + 1000), k = (unsigned)((int)floor(4 * y) + 1000);
    unsigned h = i * 374761393u + k * 668265263u;
    h = (h ^ h >> 13) * 1274126177u;
    return 0.1 + 0.8 * ((h ^ h >> 16) & 255) / 255.0;
}

/* What the camera at (x, y, -4), looking along z, has at a place of its image, sides 0 to 1. */
static double foreign_seen(double at, double u, double v)
{
    return foreign_brightness(at + 4 * (u - 0.5) * FOREIGN_WIDTH / 120.0,
                              4 * (v - 0.5) * FOREIGN_HEIGHT / 120.0);
}

static double foreign_camera(int view)
{
    return 1.3 * view;
}

enum foreign_place { FOREIGN_UPRIGHT, FOREIGN_TURNED, FOREIGN_CROPPED, FOREIGN_DISTORTED };

/* The place in an image, sides 0 to 1, whose colour lies at u v. */
static void foreign_move(enum foreign_place place, double *u, double *v)
{
    const double x = (*u - 0.5) * FOREIGN_WIDTH / 120.0, y = (*v - 0.5) * FOREIGN_HEIGHT / 120.0;
    const double factor[] = {1, -1, 0.9, 1 + 0.2 * (x * x + y * y)};
    *u = 0.5 + (*u - 0.5) * factor[place];
    *v = 0.5 + (*v - 0.5) * factor[place];
}

static float foreign_pixel(int i, int shows, enum foreign_place place)
{
    double u = (i % FOREIGN_WIDTH + 0.5) / FOREIGN_WIDTH, v = (i / FOREIGN_WIDTH + 0.5) / FOREIGN_HEIGHT;
    foreign_move(place, &u, &v);
    return (float)foreign_seen(foreign_camera(shows), u, v);
}

/* An image of any values, from 0 to 1. */
static void foreign_write(const char *path, int width, int height,
                          float (*value)(int i, int a, enum foreign_place place), int a,
                          enum foreign_place place)
{
    OWNED_IMAGE image = test_image(width, height);
    for (int i = 0; i < 3 * width * height; i++) image.rgb[i] = value(i % (width * height), a, place);
    test_make_folder(test_path("%.*s", (int)(path_base_name(path) - path), path));
    test_write_image(path, &image);
}

static void foreign_image(int view, int shows, enum foreign_place place)
{
    foreign_write(test_path("survey/images/%02d.png", view), FOREIGN_WIDTH, FOREIGN_HEIGHT, foreign_pixel,
                  shows, place);
}

/* Sets the place of a point and returns its grey. */
static int foreign_point(int i, double p[3])
{
    p[0] = -2 + 15.5 * ((i * 7919) % FOREIGN_POINTS) / FOREIGN_POINTS;
    p[1] = -1.7 + 3.4 * ((i * 104729) % 331) / 331.0;
    p[2] = 0;
    return (int)(255 * foreign_brightness(p[0], p[1]));
}

static int foreign_sees(int view, const double p[3])
{
    return fabs(p[0] - foreign_camera(view)) < 2.55 && fabs(p[1]) < 1.75;
}

static unsigned foreign_blind; /* bits of views that are in no track */
static int foreign_far;        /* points that no view sees, beside the others */

/* rotation: "1 0 0 0" for cameras that look along z. */
static const char *foreign_survey(int tracks, const char *rotation, int flip)
{
    OWNED_TEXT images = test_text(), points = test_text();
    test_write("survey/images/.keep", "");
    for (int i = 0; i < FOREIGN_VIEWS; i++) {
        foreign_image(i, i, FOREIGN_UPRIGHT);
        text_add(&images, "%d %s %.3f 0 %d 1 %02d.png\n\n", i + 1, rotation, -foreign_camera(i),
                 flip ? -4 : 4, i);
    }
    for (int i = 0; i < FOREIGN_POINTS; i++) {
        double p[3];
        const int grey = foreign_point(i, p);
        text_add(&points, "%d %.4f %.4f %.4f %d %d %d 0.5", i + 1, p[0], p[1], p[2], grey, grey, grey);
        for (int v = 0; v < FOREIGN_VIEWS && tracks; v++)
            if (foreign_sees(v, p) && !(foreign_blind >> v & 1)) text_add(&points, " %d 0", v + 1);
        text_add(&points, "\n");
    }
    for (int i = 0; i < foreign_far; i++) text_add(&points, "%d %d 500 3 9 9 9 0\n", 1000 + i, i);
    test_write_colmap("survey/sparse/0", "1 PINHOLE 160 112 120 120 80 56\n", images.data, points.data);
    test_listen();
    return test_path("survey");
}

static const char *foreign_upright(int tracks)
{
    return foreign_survey(tracks, "1 0 0 0", 0);
}

/* Writes a PLY of the points (0, 2, 3), (1, 2, 3), ... */
static void foreign_ply(const char *name, int points)
{
    OWNED_TEXT t = test_text();
    text_add(
        &t,
        "ply\nformat ascii 1.0\nelement vertex %d\nproperty float x\nproperty float y\nproperty float z\nend_header\n",
        points);
    for (int i = 0; i < points; i++) text_add(&t, "%d 2 3\n", i);
    test_write(name, t.data);
}

static int foreign_check(void)
{
    oxl_survey s;
    CHECK_OK(oxl_check(test_ctx, test_path("survey"), NULL, 0, &s));
    return s.foreign;
}

/* ---------------- images */

/* A survey whose images show what the images `shows` do, at other places; one: that image alone. */
static int foreign_check_images(int tracks, int one, int shows, enum foreign_place place)
{
    foreign_upright(tracks);
    for (int i = 0; i < FOREIGN_VIEWS; i++)
        if (one < 0 || i == one) foreign_image(i, (i + shows) % FOREIGN_VIEWS, place);
    return foreign_check();
}

TEST(images_that_do_not_belong_to_the_model_are_named_with_their_reading)
{
    static const struct {
        int tracks, one, shows;
        enum foreign_place place;
        int foreign;
        const char *said;
    } cases[] = {
        {1, -1, 0, FOREIGN_UPRIGHT, 0, ""},
        {0, -1, 0, FOREIGN_UPRIGHT, 0, ""},
        {1, -1, 4, FOREIGN_UPRIGHT, 10, "the images are not those of the model"},
        {1, -1, 4, FOREIGN_UPRIGHT, 10, "00.png (fits the place of 04.png)"},
        {1, 2, 5, FOREIGN_UPRIGHT, 1,
         "1 of 10 images do not show the colours that the model's points have: 02.png (fits the place of 07.png)"},
        {1, -1, 0, FOREIGN_TURNED, 10, "better turned by 180 degrees"},
        {1, 3, 0, FOREIGN_TURNED, 1, "03.png (fits turned by 180 degrees)"},
        {1, -1, 0, FOREIGN_CROPPED, 10, "better with another focal length, 1."},
        {1, -1, 0, FOREIGN_DISTORTED, 10, "better through a lens with distortion"}};
    for (size_t i = 0; i < OXL_COUNT(cases); i++) {
        CHECK(foreign_check_images(cases[i].tracks, cases[i].one, cases[i].shows, cases[i].place) ==
              cases[i].foreign);
        CHECK_WARNED(cases[i].said);
        CHECK((test_said.warning[0] == 0) == (cases[i].foreign == 0));
    }
}

TEST(images_whose_pixel_data_are_damaged_are_named_by_a_check)
{
    foreign_upright(1);
    FILE *file = fopen(test_path("survey/images/03.png"), "r+b");
    CHECK(file && fseek(file, 300, SEEK_SET) == 0 && fputs("another", file) >= 0 && fclose(file) == 0);
    CHECK(foreign_check() == 0);
    CHECK_WARNED("03.png: the image of");
    CHECK_WARNED("training would go on without it");
    test_write("survey/images/03.png", "no image");
    test_listen();
    CHECK(foreign_check() == 0);
    CHECK(!strstr(test_said.warning, "training would go on")); /* its header has been warned of */
}

TEST(images_are_compared_before_training_too)
{
    oxl_job_options options = oxl_job_options_default(OXL_PRESET_DRAFT);
    options.train.iterations = 2;
    foreign_upright(1);
    for (int i = 0; i < FOREIGN_VIEWS; i++) foreign_image(i, i, FOREIGN_TURNED);
    job_test_done("out", &options);
    CHECK_WARNED("better turned by 180 degrees");
    CHECK_IN("out/run.json", "turned by 180 degrees");
}

TEST(images_are_compared_without_memory_with_an_error_and_no_leak)
{
    foreign_upright(1);
    foreign_image(3, 3, FOREIGN_TURNED);
    for (long allowed = 0; allowed < 400; allowed += 29) {
        oxl_survey s;
        allocations_left = allowed;
        oxl_result rc = oxl_check(test_ctx, test_path("survey"), NULL, 0, &s);
        allocations_left = LONG_MAX;
        CHECK(rc == OXL_OK || rc == OXL_ERR_MEMORY);
    }
}

/* ---------------- poses */

TEST(poses_in_another_convention_are_named_with_tracks_and_without)
{
    for (int tracks = 0; tracks < 2; tracks++) {
        foreign_survey(tracks, "0 1 0 0", 1); /* y up, z back */
        CHECK(foreign_check() == 10);
        CHECK_WARNED("poses and points do not fit; they would fit as: camera axes as in OpenGL");
        CHECK_WARNED("fix: write the poses world to camera");
    }
}

/* The survey in a world whose x, y, z are z, x, y of the other: no rotation is its own inverse. */
static void foreign_other_world(struct text *points, const char *format)
{
    for (int i = 0; i < FOREIGN_POINTS; i++) {
        double p[3];
        const int grey = foreign_point(i, p);
        text_add(points, format, i + 1, p[2], p[0], p[1], grey, grey, grey);
    }
}

/* translation: of the camera at x; by numbers %.3f of -x, or, of its place, x */
static void foreign_check_rotated(const char *rotation, int by_place)
{
    OWNED_TEXT images = test_text(), points = test_text();
    foreign_upright(0);
    foreign_other_world(&points, "%d %.4f %.4f %.4f %d %d %d 0.5\n");
    for (int i = 0; i < FOREIGN_VIEWS; i++)
        text_add(&images, by_place ? "%d %s -4 %.3f 0 1 %02d.png\n\n" : "%d %s %.3f 0 4 1 %02d.png\n\n",
                 i + 1, rotation, (by_place ? 1 : -1) * foreign_camera(i), i);
    test_write("survey/sparse/0/points3D.txt", points.data);
    test_write("survey/sparse/0/images.txt", images.data);
    foreign_check();
}

TEST(rotations_and_places_in_another_convention_are_named)
{
    foreign_check_rotated("0.5 -0.5 -0.5 -0.5", 0);
    CHECK(!test_said.warning[0]);
    foreign_check_rotated("0.5 0.5 0.5 0.5", 0);
    CHECK_WARNED("they would fit as: rotations transposed (of camera to world)");
    foreign_check_rotated("-0.5 -0.5 -0.5 0.5", 0);
    CHECK_WARNED("they would fit as: quaternions as x y z w");
    foreign_check_rotated("0.5 -0.5 -0.5 -0.5", 1);
    CHECK_WARNED("they would fit as: the cameras' places as translations");
    foreign_check_rotated("0.5 0.5 0.5 0.5", 1);
    CHECK_WARNED("they would fit as: camera to world");
}

/* As transforms.json; the first `wrong` frames have the rotation `other`. */
static void foreign_check_json(int wrong, const char *other)
{
    static const char right[] = "[0, 0, -1, -4], [1, 0, 0, %.3f], [0, -1, 0, 0]";
    OWNED_TEXT json = test_text(), points = test_text();
    foreign_upright(0);
    text_add(&points,
             "ply\nformat ascii 1.0\nelement vertex %d\nproperty int id\nproperty float x\nproperty float y\n"
             "property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n",
             FOREIGN_POINTS);
    foreign_other_world(&points, "%d %.4f %.4f %.4f %d %d %d\n");
    text_add(
        &json,
        "{\"w\": 160, \"h\": 112, \"fl_x\": 120, \"fl_y\": 120, \"cx\": 80, \"cy\": 56, \"ply_file_path\": \"points.ply\", \"frames\": [");
    for (int i = 0; i < FOREIGN_VIEWS; i++) {
        text_add(&json, "%s{\"file_path\": \"images/%02d.png\", \"transform_matrix\": [", i ? ", " : "", i);
        text_add(&json, i < wrong ? other : right, foreign_camera(i));
        text_add(&json, ", [0, 0, 0, 1]]}");
    }
    text_add(&json, "]}");
    test_write("survey/points.ply", points.data);
    test_write("survey/transforms.json", json.data);
    CHECK(rename(test_path("survey/sparse"), test_path("sparse")) == 0);
    foreign_check();
    CHECK(rename(test_path("sparse"), test_path("survey/sparse")) == 0);
}

TEST(rotations_of_transforms_that_are_transposed_are_named)
{
    static const char transposed[] = "[0, 1, 0, -4], [0, 0, -1, %.3f], [-1, 0, 0, 0]",
                      opencv[] = "[0, 1, 0, -4], [0, 0, 1, %.3f], [1, 0, 0, 0]";
    foreign_check_json(0, "");
    CHECK(!test_said.warning[0]);
    foreign_check_json(FOREIGN_VIEWS, transposed);
    CHECK_WARNED("they would fit as: rotations transposed (of world to camera) beside the cameras' places");
    foreign_check_json(FOREIGN_VIEWS, opencv);
    CHECK_WARNED("they would fit as: rotations transposed (of world to camera, axes as in OpenCV)");
    foreign_check_json(3, transposed);
    CHECK_WARNED(
        "3 of 10 images do not show the colours that the model's points have: 00.png (fits rotations transposed");
    foreign_check_json(6, "[0, 0, 1, -4], [1, 0, 0, %.3f], [0, 1, 0, 0]"); /* axes of OpenCV */
    CHECK_WARNED("6 of 10 images do not show");
    CHECK_WARNED("02.png (fits camera axes as in OpenCV (y down, z ahead)), ...\nfix: write the poses ");
}

TEST(points_far_from_all_cameras_are_said_not_to_fit)
{
    OWNED_TEXT points = test_text();
    foreign_upright(0);
    for (int i = 0; i < 200; i++) text_add(&points, "%d %d 500 3 %d 9 9 0\n", i + 1, 1000 + i, i);
    test_write("survey/sparse/0/points3D.txt", points.data);
    foreign_check();
    CHECK_WARNED("poses and points do not fit: 10 of 10 images have fewer than 8 points");
    CHECK_WARNED("take points and poses from one model and one frame");
    foreign_far = 200000; /* so each image has 1 of 2000 */
    foreign_upright(0);
    foreign_check();
    CHECK(!test_said.warning[0]);
}

TEST(poses_without_points_start_from_points3D_ply_or_from_random_points)
{
    foreign_upright(0);
    CHECK(remove(test_path("survey/sparse/0/points3D.txt")) == 0);
    OWNED_SCENE *scene = test_load("survey", NULL);
    CHECK(oxl_scene_point_count(scene) == 0);
    CHECK_WARNED("points3D.txt or .bin is not there or empty");
    CHECK_WARNED("colmap point_triangulator");
    oxl_scene_free(test_ctx, scene);
    foreign_ply("survey/sparse/0/points3D.ply", 2);
    scene = test_load("survey", NULL);
    CHECK(oxl_scene_point_count(scene) == 2);
}

/* The second half by name shows what the first does, as those of stereo pairs or of two dives do. */
TEST(images_of_a_survey_taken_twice_are_those_of_the_model)
{
    OWNED_TEXT t = test_text();
    foreign_upright(1);
    text_add(
        &t,
        "cd '%s'/images && for i in *.png; do cp $i z$i; done && cd ../sparse/0 && "
        "sed -n 's/^\\([0-9]* .*\\)\\(..[.]png\\)$/9\\1z\\2\\n/p' images.txt > more && cat more >> images.txt",
        test_path("survey"));
    CHECK(system(t.data) == 0);
    test_listen();
    CHECK(foreign_check() == 0);
}

/* ---------------- values and headers */

TEST(points_of_a_ply_stand_for_a_dummy_point_and_for_no_others)
{
    static const int cases[][3] = {/* tracks, points of the PLY, points read */
                                   {1, 720, FOREIGN_POINTS},
                                   {1, 721, FOREIGN_POINTS},
                                   {0, 721, 721},
                                   {0, 3, 3}};
    OWNED_COLMAP c = {0};
    for (int i = 0; i < 4; i++) {
        foreign_upright(cases[i][0]);
        foreign_ply("survey/sparse/0/points3D.ply", cases[i][1]);
        if (i == 3) test_write("survey/sparse/0/points3D.txt", "1 0 0 0 0 0 0 0\n");
        colmap_free(test_ctx, &c);
        CHECK_OK(colmap_read_folder(test_path("survey/sparse/0"), &c));
        CHECK(c.point_count == (size_t)cases[i][2] && (i || !test_said.warning[0]));
        if (i == 1)
            CHECK_WARNED("the 721 points of points3D.ply are not read; points3D.txt or .bin there holds 360");
    }
    CHECK(c.point[1].position[0] == 1 && c.point[2].id == 2);
    CHECK_WARNED("the 3 points of points3D.ply are read; points3D.txt or .bin there holds 1");
}

TEST(points_come_from_the_file_that_sparse_names)
{
    static const char *const names[] = {"survey/sparse/0/points3D.ply", "cloud.ply", "cloud.txt"};
    oxl_scene_options options = oxl_scene_options_default();
    foreign_upright(1);
    foreign_ply(names[0], 9);
    foreign_ply(names[1], 3);
    test_write("survey/sparse/0/points3D.txt", "1 0 0 0 0 0 0 0\n");
    test_write(names[2], "1 0 0 1 9 9 9 0\n2 0 1 0 9 9 9 0\n3 1 0 0 9 9 9 0\n");
    for (int i = 0; i < 3; i++) {
        OWNED_SCENE *scene = NULL;
        options.sparse = test_path(names[i]);
        CHECK_OK(oxl_scene_load(test_ctx, test_path("survey"), &options, &scene));
        CHECK(oxl_scene_point_count(scene) == (i ? 3 : 9) && oxl_scene_view_count(scene) == FOREIGN_VIEWS);
    }
}

/* Writes a PNG of 16-bit grey: one of 8-bit grey with alpha, which has as many bytes per pixel, with another
 * header. */
static void foreign_write_png16(const char *path, const uint16_t *grey, int width, int height)
{
    uint8_t bytes[2 * FOREIGN_WIDTH * FOREIGN_HEIGHT];
    unsigned char *png;
    int size = 0;
    for (int i = 0; i < 2 * width * height; i++) bytes[i] = (uint8_t)(grey[i / 2] >> (i % 2 ? 0 : 8));
    CHECK((png = codec_encode_png(test_ctx, bytes, width, height, 2, &size)) != NULL);
    png[24] = 16, png[25] = 0; /* bits, colour [RFC 2083] */
    unsigned sum = codec_png_checksum(png + 12, 17);
    for (int k = 0; k < 4; k++) png[29 + k] = (unsigned char)(sum >> (24 - 8 * k));
    test_write_bytes(path, png, (size_t)size);
    codec_free(test_ctx, png);
}

TEST(wide_images_of_twelve_bits_are_said_to_be_dark)
{
    foreign_upright(1);
    for (int i = 0; i < FOREIGN_VIEWS; i++) {
        uint16_t grey[FOREIGN_WIDTH * FOREIGN_HEIGHT];
        for (int k = 0; k < FOREIGN_WIDTH * FOREIGN_HEIGHT; k++)
            grey[k] = (uint16_t)(4095 * foreign_pixel(k, i, FOREIGN_UPRIGHT));
        foreign_write_png16(test_path("survey/images/%02d.png", i), grey, FOREIGN_WIDTH, FOREIGN_HEIGHT);
    }
    foreign_check();
    CHECK_WARNED("mogrify -evaluate multiply 18");
}

static float foreign_mask(int i, int kind, enum foreign_place place)
{
    (void)place;
    return kind == 0            ? i % FOREIGN_WIDTH < 20
           : kind == 1          ? i / FOREIGN_WIDTH < 50
           : i % 2 || i == kind ? 1
                                : 3 / 255.0f;
}

/* kind: 0: most is black; 1: the lower part is; 2: nothing is. */
static void foreign_masks(const char *folder, int kind, int count)
{
    for (int i = 0; i < count; i++)
        foreign_write(test_path("survey/%s/%02d.png", folder, i), FOREIGN_WIDTH, FOREIGN_HEIGHT, foreign_mask,
                      kind, 0);
}

TEST(masks_that_ignore_most_points_or_nothing_are_said_to)
{
    foreign_upright(1);
    foreign_masks("masks", 0, FOREIGN_VIEWS);
    foreign_check();
    CHECK_WARNED("% of the points that images show lie where their masks are black");
    CHECK_WARNED("exchange black and white");
    CHECK(!strstr(test_said.warning, "no black pixel"));
    foreign_masks("masks", 2, FOREIGN_VIEWS);
    foreign_check();
    CHECK_WARNED("the masks have no black pixel");
    foreign_masks("masks", 1, 1);
    test_listen();
    foreign_check();
    CHECK(!strstr(test_said.warning, "black pixel"));
}

TEST(principal_points_of_another_size_are_said_to_be)
{
    foreign_upright(1);
    test_write("survey/sparse/0/cameras.txt", "1 PINHOLE 160 112 120 120 20 14\n");
    CHECK(foreign_check() == FOREIGN_VIEWS);
    CHECK_WARNED("better with the principal point in the middle");
    CHECK_WARNED("width and height of one size");
}

TEST(files_of_other_programs_in_the_place_of_a_model_are_named)
{
    static const char *const files[][2] = {{"cameras.xml", "of Metashape"},
                                           {"sfm_data.json", "OpenMVG's"},
                                           {"database.db", "colmap mapper"},
                                           {"a.xmp", "RealityCapture's"}};
    oxl_survey s;
    for (size_t i = 0; i < OXL_COUNT(files); i++) {
        test_write(test_path("f%zu/%s", i, files[i][0]), "x");
        CHECK_ERROR(oxl_check(test_ctx, test_path("f%zu", i), NULL, 0, &s), OXL_ERR_INPUT, files[i][1]);
    }
    foreign_upright(1);
    CHECK_ERROR(oxl_check(test_ctx, test_path("survey/images"), NULL, 0, &s), OXL_ERR_INPUT,
                "/.. is a survey: name that");
}

TEST(files_that_a_cloud_or_git_has_not_fetched_are_said)
{
    static const char pointer[] = "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 123\n";
    oxl_survey s;
    foreign_upright(1);
    test_write("survey/images/02.png", "");
    test_write("survey/images/03.png", pointer);
    for (int view = 2; view < 4; view++) {
        int width, height;
        CHECK_ERROR(image_size(test_ctx, test_path("survey/images/%02d.png", view), &width, &height),
                    OXL_ERR_INPUT, view == 2 ? "it is empty" : "fix: git lfs pull");
    }
    test_write("survey/sparse/0/points3D.txt", pointer);
    CHECK_ERROR(oxl_check(test_ctx, test_path("survey"), NULL, 0, &s), OXL_ERR_INPUT,
                "points3D.txt: it is a pointer of Git LFS");
}

TEST(pixels_are_turned_as_each_exif_orientation_says)
{
    static const uint8_t stored[6] = {1, 2, 3, 4, 5, 6}; /* 3 x 2 px */
    static const uint8_t wanted[4][6] = {
        {1, 4, 2, 5, 3, 6}, {4, 1, 5, 2, 6, 3}, {6, 3, 5, 2, 4, 1}, {3, 6, 2, 5, 1, 4}};
    for (int o = 5; o <= 8; o++) {
        uint8_t data[6];
        struct pixels p = {.width = 3, .height = 2, .data = data};
        memcpy(data, stored, sizeof data);
        CHECK_OK(image_turn(test_ctx, &p, 1, o));
        CHECK(p.width == 2 && p.height == 3 && !memcmp(data, wanted[o - 5], sizeof data));
    }
}

static const unsigned char foreign_exif[] = {'M', 'M', 0, 42, 0, 0, 0, 8, 0, 1, 1, 0x12, 0,
                                             3,   0,   0, 0,  1, 0, 6, 0, 0, 0, 0, 0,    0};

/* A PNG with a chunk eXIf behind its head: orientation 6. */
static void foreign_add_orientation(const char *path)
{
    enum { HEAD = 33 };
    OWNED_FILE map = test_file(path);
    unsigned char *all = calloc(map.size + 12 + sizeof foreign_exif, 1);
    unsigned char *chunk = all + HEAD;
    memcpy(all, map.data, HEAD);
    chunk[3] = sizeof foreign_exif;
    memcpy(chunk + 4, "eXIf", 4);
    memcpy(chunk + 8, foreign_exif, sizeof foreign_exif);
    memcpy(chunk + 12 + sizeof foreign_exif, map.data + HEAD, map.size - HEAD);
    test_write_bytes(path, all, map.size + 12 + sizeof foreign_exif);
    free(all);
}

TEST(headers_of_jpeg_state_size_and_orientation)
{
    static const unsigned char frame[] = {0xff, 0xc2, 0,    11, 8,    1,    2, 3, 4,
                                          1,    1,    0x11, 0,  0xff, 0xd9, 0, 0, 0};
    unsigned char file[100] = {0xff, 0xd8, 0xff, 0xe1, 0, 8 + sizeof foreign_exif, 'E', 'x', 'i', 'f'};
    struct image_header header;
    memcpy(file + 12, foreign_exif, sizeof foreign_exif);
    memcpy(file + 12 + sizeof foreign_exif, frame, sizeof frame);
    test_write("head.jpg", "");
    test_write_bytes("head.jpg", file, 12 + sizeof foreign_exif + sizeof frame);
    CHECK_OK(image_read_header(test_ctx, test_path("head.jpg"), &header));
    CHECK(header.width == 0x304 && header.height == 0x102 && header.bits == 8 && header.orientation == 6);
}

TEST(images_are_turned_by_their_exif_orientation_where_the_camera_is_upright)
{
    const struct colmap_camera upright = {.model = camera_model_find("PINHOLE", 7),
                                          .width = 24,
                                          .height = 16,
                                          .parameter_count = 4,
                                          .parameter = {20, 20, 12, 8},
                                          .file = "cameras.txt"};
    const oxl_camera to = {.width = 24, .height = 16, .fx = 20, .fy = 20, .cx = 12, .cy = 8};
    struct training_image image;
    struct image_header header;
    OWNED_IMAGE stored = test_image(16, 24);
    for (int i = 0; i < 3 * 16 * 24; i++)
        stored.rgb[i] = i % (16 * 24) < 16 * 12 ? 1 : 0; /* the upper half is white */
    test_write("turned/.keep", "");
    test_write_image("turned/a.png", &stored);
    CHECK(image_load_training(test_ctx, test_path("turned/a.png"), NULL, NULL, &upright, &to, &image) ==
          OXL_ERR_INPUT);
    foreign_add_orientation(test_path("turned/a.png"));
    CHECK_OK(image_read_header(test_ctx, test_path("turned/a.png"), &header));
    CHECK(header.width == 16 && header.height == 24 && header.bits == 8 && header.orientation == 6);
    CHECK_OK(image_load_training(test_ctx, test_path("turned/a.png"), NULL, NULL, &upright, &to, &image));
    CHECK(image.rgb && image.rgb[8 * 24 + 2] < 30 &&
          image.rgb[8 * 24 + 21] > 225); /* now the right half is */
    image_training_free(test_ctx, &image);
}

TEST(images_of_many_cameras_all_have_their_size_on_disk)
{
    OWNED_TEXT cameras = test_text(), images = test_text();
    foreign_upright(1);
    for (int i = 0; i < FOREIGN_VIEWS; i++) {
        text_add(&cameras, "%d PINHOLE 320 224 240 240 160 112\n", i + 1);
        text_add(&images, "%d 1 0 0 0 %d 0 4 %d %02d.png\n\n", i + 1, i, i + 1, i);
    }
    test_write("survey/sparse/0/cameras.txt", cameras.data);
    test_write("survey/sparse/0/images.txt", images.data);
    OWNED_SCENE *scene = test_load("survey", NULL);
    for (int i = 0; i < FOREIGN_VIEWS; i++) CHECK(oxl_scene_view(scene, i)->camera.width == FOREIGN_WIDTH);
}

/* Copies an image of the survey, encoded again as the name of the copy says. */
static void foreign_copy(const char *from, const char *to)
{
    const char *path = test_path("survey/images/%s", to);
    char *jpeg = NULL;
    size_t size = 0;
    OWNED_IMAGE image = test_read_image(test_path("survey/images/%s", from));
    if (strstr(to, ".jpg")) {
        CHECK_OK(oxl_image_to_jpeg(test_ctx, &image, 25, &jpeg, &size));
        test_write_bytes(path, jpeg, size);
        oxl_text_free(test_ctx, jpeg);
    } else test_write_image(path, &image);
}

TEST(images_of_a_camera_have_the_size_of_most_and_others_are_named)
{
    foreign_upright(1);
    foreign_write("survey/images/00.png", FOREIGN_WIDTH / 4, FOREIGN_HEIGHT / 4, foreign_pixel, 0, 0);
    OWNED_SCENE *scene = test_load("survey", NULL);
    for (int i = 0; i < FOREIGN_VIEWS; i++) CHECK(oxl_scene_view(scene, i)->camera.width == FOREIGN_WIDTH);
    CHECK_WARNED("1 images differ in size from most images of their camera, and are scaled to that size: "
                 "00.png (40 x 28 px, most have 160 x 112)");
}

TEST(copies_of_images_are_named_and_stay_on_one_side_of_the_split)
{
    OWNED_TEXT more = test_text();
    foreign_upright(1);
    struct os_file_map file = test_file("survey/sparse/0/images.txt");
    text_add(&more,
             "%.*s90 1 0 0 0 0 0 4 1 00 copy.jpg\n\n91 1 0 0 0 -5.2 .0001 4 1 other.png\n\n"
             "92 1 0 0 0 -9.101 0 4 1 07 copy.png\n\n93 1 0 0 0 -9.1005 0 4 1 07a.png\n\n",
             (int)file.size, file.data);
    os_release_file(test_ctx, &file);
    test_write("survey/sparse/0/images.txt", more.data);
    foreign_copy("00.png", "00 copy.jpg");
    foreign_copy("07.png", "07 copy.png");
    foreign_copy("07.png", "07a.png");
    foreign_copy("01.png", "other.png"); /* of the same pose as 04.png, and not the same image */
    test_listen();
    OWNED_SCENE *scene = test_load("survey", NULL);
    CHECK_WARNED("3 images are copies of other images, such as 00.png of 00 copy.jpg");
    CHECK(!strcmp(oxl_scene_view(scene, 1)->name, "00.png"));
    for (int i = 0; i < oxl_scene_view_count(scene); i++) {
        const char *name = oxl_scene_view(scene, i)->name;
        CHECK(oxl_scene_view(scene, i)->is_test == (!strncmp(name, "00", 2) || !strcmp(name, "08.png")));
    }
}

TEST(images_without_a_pose_of_their_own_are_left_out_and_named)
{
    for (int tracks = 0; tracks < 2; tracks++) {
        foreign_blind = 1u << 2 | 1u << 7;
        foreign_upright(tracks);
        foreign_blind = 0;
        job_test_replace(test_path("survey/sparse/0/images.txt"), "3 1 0 0 0 -2.600 0 4 1",
                         tracks ? "3 1 0 0 0 -9.100 0 4 1" : "3 1 0 0 0 0 1e-12 0 1");
        if (!tracks)
            job_test_replace(test_path("survey/sparse/0/images.txt"), "8 1 0 0 0 -9.100 0 4 1",
                             "8 1 0 0 0 0 0 0 1");
        OWNED_SCENE *scene = test_load("survey", NULL);
        CHECK(oxl_scene_view_count(scene) == FOREIGN_VIEWS - 2);
        CHECK_WARNED("2 of 10 images have no pose of their own and see no point");
        CHECK_WARNED("left out: 02.png, 07.png");
    }
}

/* ---------------- files that are there, and not meant */

TEST(images_that_the_model_does_not_have_are_counted)
{
    oxl_survey s;
    foreign_upright(1);
    foreign_image(80, 1, FOREIGN_UPRIGHT);
    foreign_image(81, 2, FOREIGN_UPRIGHT);
    test_write("survey/images/cam1/x.JPG", "");
    test_write("survey/images/notes.txt", "");
    test_write("survey/images/masks/00.png", "");
    test_write("survey/images/@eaDir/00.png/SYNOPHOTO_THUMB_XL.jpg", "");
    test_write("survey/images/cam1/Thumbs/y.jpg", "");
#ifndef _WIN32
    CHECK(symlink("nowhere.jpg", test_path("survey/images/dead.jpg")) == 0);
#endif
    CHECK_OK(oxl_check(test_ctx, test_path("survey"), NULL, 0, &s));
    CHECK(s.images_unregistered == 3);
    CHECK_TEXT(s.warnings, "3 of the 13 images in the folder are not in the model");
}

TEST(folders_named_from_here_or_from_the_survey_are_used)
{
    oxl_scene_options o = oxl_scene_options_default();
    oxl_scene *scene = NULL;
    foreign_upright(1);
    CHECK(os_rename(test_path("survey/images"), test_path("survey/photos")) == 0);
    CHECK_ERROR(oxl_scene_load(test_ctx, test_path("survey"), NULL, &scene), OXL_ERR_INPUT,
                "survey/images: there is no such folder\nfix: --images names the folder of images");
    o.masks = "photos", o.sparse = "sparse";
    for (int i = 0; i < 2; i++) {
        o.images = i ? "photos" : test_path("survey/photos");
        scene = test_load("survey", &o);
        CHECK(strcmp(scene->images, test_path("survey/photos")) == 0 && scene->masks);
        oxl_scene_free(test_ctx, scene);
    }
    o.images = "nowhere";
    CHECK_ERROR(oxl_scene_load(test_ctx, test_path("survey"), &o, &scene), OXL_ERR_INPUT,
                "nowhere: there is no such folder\nfix: --images ");
}

/* ---------------- transforms.json */

#define FOREIGN_FRAMES                                                                                                                                    \
    "\"frames\": [{\"file_path\": \"images/00.png\", \"mask_path\": \"own/00.png\", \"transform_matrix\": [[1,0,0,0],[0,-1,0,0],[0,0,-1,-4],[0,0,0,1]]}," \
    "{\"file_path\": \"images/01.png\", \"transform_matrix\": [[1,0,0,1.3],[0,-1,0,0],[0,0,-1,-4],[0,0,0,1]]}]"

static const char *foreign_transforms(const char *members)
{
    OWNED_TEXT t = test_text();
    test_write("survey/images/.keep", "");
    for (int i = 0; i < 2; i++) foreign_image(i, i, FOREIGN_UPRIGHT);
    text_add(&t,
             "{\"w\": 160, \"h\": 112, \"fl_x\": 120, \"fl_y\": 120, \"k1\": 0.1, %s, " FOREIGN_FRAMES "}",
             members);
    test_write("survey/transforms.json", t.data);
    test_listen();
    return test_path("survey");
}

static struct colmap foreign_read(const char *members)
{
    struct colmap c;
    if (members) foreign_transforms(members);
    CHECK_OK(json_survey_read(test_ctx, test_path("survey"), "transforms.json", NULL, &c));
    return c;
}

TEST(transforms_say_fisheye_in_the_words_of_instant_ngp)
{
    OWNED_COLMAP c = foreign_read("\"is_fisheye\": true");
    CHECK(!strcmp(camera_model_at(c.camera->model)->name, "OPENCV_FISHEYE") && c.camera->parameter[4] == 0.1);
    colmap_free(test_ctx, &c);
    c = foreign_read("\"is_fisheye\": false");
    CHECK(!strcmp(camera_model_at(c.camera->model)->name, "FULL_OPENCV"));
}

TEST(transforms_masks_are_used_and_missing_ones_counted)
{
    foreign_transforms("\"a\": 1");
    OWNED_SCENE *scene = test_load("survey", NULL);
    CHECK_WARNED("1 of the 1 masks that transforms.json names as mask_path are missing");
    oxl_scene_free(test_ctx, scene);
    foreign_masks("own", 1, 1);
    scene = test_load("survey", NULL);
    const struct training_image *image = scene_image(test_ctx, scene, 0);
    CHECK(image && image->mask && image->mask[image->width * (image->height - 3)] == 0);
    CHECK(scene_image(test_ctx, scene, 1) != NULL);
}

TEST(transforms_members_that_are_not_read_are_named_once)
{
    OWNED_COLMAP c = foreign_read("\"fisheye_crop_radius\": 5, \"aabb_scale\": 16");
    CHECK_WARNED("this content of the file is not used: fisheye_crop_radius\n");
}

TEST(transforms_with_two_focal_lengths_take_the_one_that_a_camera_has)
{
    static const struct {
        const char *members;
        double focal;
        int warns;
    } cases[] = {
        /* fl_x is 120 px of 160, 67.4 degrees: as the angle says; a third more; millimetres */
        {"\"camera_angle_x\": 1.176", 120, 0},
        {"\"camera_angle_x\": 1.5708", 120, 1},
        {"\"millimetres\": 1, \"camera_angle_x\": 1.176", 120, 1},
    };
    for (size_t i = 0; i < OXL_COUNT(cases); i++) {
        foreign_transforms(cases[i].members);
        if (strstr(cases[i].members, "millimetres"))
            job_test_replace(test_path("survey/transforms.json"), "\"fl_x\": 120, \"fl_y\": 120",
                             "\"fl_x\": 3, \"fl_y\": 3");
        OWNED_COLMAP c = foreign_read(NULL);
        CHECK(fabs(c.camera->parameter[0] - cases[i].focal) < 0.1 &&
              fabs(c.camera->parameter[1] - cases[i].focal) < 0.1);
        CHECK(cases[i].warns == (strstr(test_said.warning, "follow from camera_angle_x") != NULL));
    }
}

TEST(focal_lengths_that_cannot_be_are_named)
{
    foreign_upright(1);
    test_write("survey/sparse/0/cameras.txt", "1 PINHOLE 160 112 24 24 80 56\n");
    OWNED_SCENE *scene = test_load("survey", NULL);
    CHECK_WARNED("cameras.txt:1: the focal length of camera 1 is 24, 24 px, for images of 160 x 112");
    job_test_replace(test_path("survey/sparse/0/cameras.txt"), "24 24", "120 60");
    OWNED_SCENE *other = test_load("survey", NULL);
    CHECK_WARNED("the focal length of camera 1 is 120, 60 px");
    job_test_replace(test_path("survey/sparse/0/cameras.txt"), "120 60 80 56", "60 60 40 28");
    CHECK(foreign_check() == FOREIGN_VIEWS);
    CHECK_WARNED("2.00 times as long\nfix: give focal lengths, principal point, width and height");
}

TEST(transforms_are_read_without_the_points_that_they_name)
{
    struct colmap c = foreign_read("\"ply_file_path\": \"C:\\\\old\\\\p.ply\"");
    CHECK(c.image_count == 2 && c.point_count == 0);
    CHECK_WARNED("ply_file_path names C/old/p.ply, which is not there");
    colmap_free(test_ctx, &c);
    foreign_ply("survey/p.ply", 1);
    test_write("survey/sparse/0/cameras.txt", colmap_good_cameras); /* not read beside the named file */
    test_write("survey/sparse/0/images.txt", colmap_good_images);
    OWNED_SCENE *scene = test_load("survey/transforms.json", NULL);
    CHECK(oxl_scene_point_count(scene) == 1);
}

static int foreign_first_red(const char *type, const char *rows)
{
    OWNED_TEXT t = test_text();
    foreign_transforms("\"ply_file_path\": \"p.ply\"");
    text_add(
        &t,
        "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nproperty %s red\n"
        "property %s green\nproperty %s blue\nend_header\n%s",
        type, type, type, rows);
    test_write("survey/p.ply", t.data);
    OWNED_COLMAP c = foreign_read(NULL);
    return c.point_count == 2 ? c.point[0].rgb[0] : -1;
}

TEST(points_have_their_colours_whatever_the_type)
{
    CHECK(foreign_first_red("uchar", "0 0 0 51 9 9\n0 0 1 1 1 1\n") == 51);
    CHECK(foreign_first_red("float", "0 0 0 0.2 0.5 1\n0 0 1 1 1 1\n") == 51);
    CHECK(foreign_first_red("double", "0 0 0 0.2 0.5 1\n0 0 1 1 1 1\n") == 51);
    CHECK(foreign_first_red("float", "0 0 0 51 0.5 1\n0 0 1 1 1 200\n") == 51);
    CHECK(foreign_first_red("ushort", "0 0 0 13107 0 0\n0 0 1 65535 1 1\n") == 51);
    CHECK(foreign_first_red("ushort", "0 0 0 51 0 0\n0 0 1 255 1 1\n") == 51);
    CHECK(foreign_first_red("float", "0 0 0 nan 0 1\n0 0 1 1 1 1\n") == 0);
}

/* ---------------- models */

#define FOREIGN_PLY(rgb, rows)                                                                                               \
    "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n" rgb                    \
    "property float opacity\nproperty float scale_0\nproperty float scale_1\nproperty float scale_2\nproperty float rot_0\n" \
    "property float rot_1\nproperty float rot_2\nproperty float rot_3\nend_header\n" rows
#define FOREIGN_DC "property float f_dc_0\nproperty float f_dc_1\nproperty float f_dc_2\n"
#define FOREIGN_RGB "property uchar red\nproperty uchar green\nproperty uchar blue\n"

TEST(models_keep_infinite_opacities_and_widths_of_zero)
{
    test_listen();
    oxl_model m = test_read_model(test_write(
        "m.ply",
        FOREIGN_PLY(FOREIGN_DC, "1 0 0 0 0 0 inf 0 0 -inf 1 0 0 0\n2 0 0 0 0 0 -inf 0 0 0 0 0 0 0\n")));
    CHECK(m.count == 2 && m.not_finite == 0 && m.plane[OXL_OPACITY][0] == 20 &&
          m.plane[OXL_OPACITY][1] == -20 && m.plane[OXL_LOG_SCALE + 2][0] == -87);
    oxl_model_free(test_ctx, &m);
    CHECK_ERROR(oxl_model_read(
                    test_ctx,
                    test_write("n.ply",
                               FOREIGN_PLY(FOREIGN_DC,
                                           "nan 0 0 0 0 0 0 0 0 0 1 0 0 0\n2 0 0 0 0 0 0 inf 0 0 1 0 0 0\n")),
                    &m),
                OXL_ERR_INPUT, "all 2 Gaussians hold values that are not finite");
}

TEST(models_of_alphas_and_sizes_in_the_place_of_logits_and_logarithms_are_said)
{
    OWNED_MODEL m = test_model(200, 0);
    for (int k = 0; k < 3; k++) { /* raw, then alphas, then sizes */
        for (int i = 0; i < 200; i++) {
            m.plane[OXL_OPACITY][i] = k == 1 ? (float)i / 200 : 0.05f * (float)(i - 100);
            for (int a = 0; a < 3; a++)
                m.plane[OXL_LOG_SCALE + a][i] = k == 2 ? 0.001f * (float)(i + 1) : -3 - 0.01f * (float)i;
        }
        test_write_model("m.ply", &m);
        test_listen();
        OWNED_MODEL back = test_read_model("m.ply");
        if (k == 0) CHECK(!strstr(test_said.warning, "all values"));
        if (k == 1)
            CHECK_WARNED(
                "opacities look like alphas; logits, log(alpha / (1 - alpha)), are expected, but all values are from 0 to 0.995");
        if (k == 2)
            CHECK_WARNED(
                "scales look like sizes; their logarithms are expected, but all values are from 0.001 to 0.2");
    }
}

TEST(models_with_red_green_blue_have_these_colours)
{
    OWNED_MODEL m = test_read_model(test_write(
        "m.ply", FOREIGN_PLY(FOREIGN_RGB, "1 0 0 255 0 51 0 0 0 0 1 0 0 0\n2 0 0 0 0 0 0 0 0 0 1 0 0 0\n")));
    CHECK(m.count == 2 && m.sh_degree == 0);
    CHECK_CLOSE(m.plane[OXL_SH][0], 0.5 / MODEL_SH0, 1e-6);
    CHECK_CLOSE(m.plane[OXL_SH + 2][0], (0.2 - 0.5) / MODEL_SH0, 1e-6);
}

TEST(models_of_mip_splatting_get_their_filter_and_other_columns_are_named)
{
    static const char head[] =
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
        "property float f_dc_0\nproperty float f_dc_1\nproperty float f_dc_2\nproperty float opacity\n"
        "property float scale_0\nproperty float scale_1\nproperty float scale_2\nproperty float rot_0\n"
        "property float rot_1\nproperty float rot_2\nproperty float rot_3\nproperty float filter_3D\n"
        "property float confidence\nend_header\n"
        "1 2 3 0 0 0 0 0 0 0 1 0 0 0 1 5\n"; /* alpha 0.5, widths and filter 1 */
    test_listen();
    OWNED_MODEL m = test_read_model(test_write("mip.ply", head));
    for (int i = 0; i < 3; i++) CHECK_CLOSE(m.plane[OXL_LOG_SCALE + i][0], 0.5 * log(2.0), 1e-6);
    CHECK_CLOSE(1 / (1 + exp(-m.plane[OXL_OPACITY][0])), 0.5 / sqrt(8.0), 1e-6);
    CHECK_WARNED("this content of the file is not used: confidence\n");
}

TEST(models_that_are_text_or_have_logarithms_of_widths_are_said)
{
    unsigned char splat[32] = {0};
    const float log_width = -4;
    OWNED_MODEL m = {0};
    CHECK_ERROR(
        oxl_model_read(
            test_ctx,
            test_write("a.splat", "<!DOCTYPE html>\n<html><head><title>Connect\xc3\xa9</title></head>"), &m),
        OXL_ERR_INPUT, "a.splat: the file is text that begins '<!DOCTYPE html>', not a model");
    test_listen();
    for (int i = 0; i < 3; i++) memcpy(splat + 12 + 4 * i, &log_width, 4);
    memset(splat + 24, 200, 8);
    test_write_bytes("log.splat", splat, sizeof splat);
    m = test_read_model("log.splat");
    CHECK(m.count == 1 && m.plane[OXL_LOG_SCALE][0] == -4);
    CHECK_WARNED("are read as logarithms");
}

TEST(models_are_known_by_their_bytes_and_names_in_any_case)
{
    OWNED_MODEL m = test_read_model(test_write(
        "M.PLY", FOREIGN_PLY(FOREIGN_DC, "1 0 0 0 0 0 0 0 0 0 1 0 0 0\n2 0 0 0 0 0 0 0 0 0 1 0 0 0\n")));
    test_write_model("A.SPZ", &m);
    OWNED_MODEL again = test_read_model("A.SPZ");
    oxl_model_free(test_ctx, &again);
    CHECK(os_rename(test_path("A.SPZ"), test_path("a.ply")) == 0);
    again = test_read_model("a.ply");
    CHECK(again.count == 2);
    oxl_model_free(test_ctx, &again);
    CHECK(oxl_model_write(test_ctx, test_path("a.compressed.ply"), &m) == OXL_ERR_USAGE);
    oxl_model_free(test_ctx, &m);
    CHECK_ERROR(
        oxl_model_read(test_ctx, test_write("a.sog", "PK\3\4 and so on"), &m), OXL_ERR_INPUT,
        "SOG or a checkpoint of PyTorch, is neither read nor written\nfix: splat-transform IN.sog OUT.ply");
    CHECK_ERROR(oxl_model_read(test_ctx, test_write("a.KSPLAT", "...."), &m), OXL_ERR_INPUT,
                "splat-transform IN.ksplat OUT.ply");
}

TEST(spz_keeps_the_precision_of_the_scene_beside_a_far_gaussian)
{
    enum { ROWS = 200 };
    test_listen();
    OWNED_MODEL m = test_model(ROWS, 0);
    for (int i = 0; i < ROWS; i++) m.plane[OXL_MEAN][i] = (float)(i / 97.0);
    m.plane[OXL_MEAN][ROWS - 1] = 3e7f;
    m.plane[OXL_LOG_SCALE][ROWS - 1] = 10;
    test_write_model("far.spz", &m);
    CHECK_WARNED("1 of 200 Gaussians are beyond the format's range");
    OWNED_MODEL again = test_read_model("far.spz");
    CHECK(again.count == ROWS);
    for (int i = 0; i + 1 < ROWS; i++) CHECK(fabs(again.plane[OXL_MEAN][i] - m.plane[OXL_MEAN][i]) < 1e-5);
    /* drawn in, and as wide from the origin as it was */
    CHECK(again.plane[OXL_MEAN][ROWS - 1] > 8);
    CHECK_CLOSE(again.plane[OXL_LOG_SCALE][ROWS - 1] - log(again.plane[OXL_MEAN][ROWS - 1]), 10 - log(3e7),
                0.05);
}

TEST(training_from_a_model_of_another_frame_is_said)
{
    oxl_job_options o = oxl_job_options_default(OXL_PRESET_DRAFT);
    foreign_upright(1);
    OWNED_MODEL m = test_model(100, 0);
    for (int i = 0; i < 100; i++) {
        m.plane[OXL_MEAN][i] = 900 + (float)i / 100, m.plane[OXL_MEAN + 1][i] = (float)(i % 7) / 7;
        m.plane[OXL_LOG_SCALE][i] = m.plane[OXL_LOG_SCALE + 1][i] = m.plane[OXL_LOG_SCALE + 2][i] = -3;
    }
    test_write_model("from.ply", &m);
    o.from = test_path("from.ply"), o.train.iterations = 1;
    job_test_run("out", &o);
    CHECK_WARNED("from.ply does not seem to cover the survey");
}

TEST(a_folder_of_masks_under_another_name_is_said_not_to_be_used)
{
    foreign_upright(1);
    test_write("survey/mask/00.png", "");
    foreign_check();
    CHECK_WARNED("survey/mask is not used: masks are in ");
    CHECK_WARNED("fix: --masks ");
}

/* ---------------- a finished result */

TEST(a_finished_result_stays_when_its_survey_has_another_name)
{
    oxl_job_options o = oxl_job_options_default(OXL_PRESET_DRAFT), resumed = o;
    oxl_manifest *run = NULL;
    char named[600];
    o.train.iterations = 2;
    foreign_upright(1);
    job_test_done("out", &o);
    int64_t before = os_modified(test_path("out/scene.ply"));
    snprintf(named, sizeof named, "%s/../survey/", test_path("survey"));
    CHECK_OK(oxl_job_resume(test_ctx, named, test_path("out"), &resumed, &run));
    CHECK(resumed.train.iterations == 2);
    CHECK_OK(oxl_job_run(test_ctx, named, test_path("out"), &resumed, NULL));
    oxl_manifest_free(test_ctx, &run);
    CHECK(os_rename(test_path("survey"), test_path("moved")) == 0);
    CHECK_OK(oxl_job_run(test_ctx, test_path("moved"), test_path("out"), &o, NULL));
    CHECK(os_modified(test_path("out/scene.ply")) == before);
    o.train.ssim_weight = 0.1f; /* other options: not without --restart */
    CHECK_ERROR(oxl_job_run(test_ctx, test_path("moved"), test_path("out"), &o, NULL), OXL_ERR_USAGE,
                "holds the finished result of a run with other options");
    CHECK(os_modified(test_path("out/scene.ply")) == before);
    o.restart = 1;
    CHECK_OK(oxl_job_run(test_ctx, test_path("moved"), test_path("out"), &o, NULL));
    CHECK(os_modified(test_path("out/scene.ply")) != before);
}
