/* test_camera.c - camera models against values computed apart (Python, from the formulas), undistortion
 * against COLMAP. */
#include "test.h"

/* With as many parameters as the model has. */
static struct colmap_camera camera_make(const char *model, int width, int height, const double *parameter)
{
    struct colmap_camera c = {.id = 1,
                              .model = camera_model_find(model, strlen(model)),
                              .width = width,
                              .height = height,
                              .file = "cameras.txt",
                              .line = 4};
    CHECK(c.model >= 0);
    c.parameter_count = camera_model_at(c.model)->parameter_count;
    memcpy(c.parameter, parameter, (size_t)c.parameter_count * sizeof *parameter);
    return c;
}

TEST(camera_models_follow_the_published_formulas)
{
    static const struct {
        const char *model;
        int count;
        double parameter[CAMERA_PARAMETERS], x, y;
    } cases[] = {
        {"SIMPLE_PINHOLE", 3, {500, 320, 240}, 470, 15},
        {"PINHOLE", 4, {500, 510, 320, 240}, 470, 10.5},
        {"SIMPLE_RADIAL", 4, {500, 320, 240, -0.2}, 461.225, 28.1625},
        {"RADIAL", 5, {500, 320, 240, -0.2, 0.05}, 461.86667187499995, 27.199992187499987},
        {"OPENCV", 8, {500, 510, 320, 240, -0.2, 0.05, 0.01, -0.02}, 455.791671875, 29.255242031249992},
        {"OPENCV_FISHEYE",
         8,
         {500, 510, 320, 240, 0.1, -0.02, 0.003, -0.0004},
         460.7235689233628,
         24.69293954725498},
        {"FULL_OPENCV",
         12,
         {500, 510, 320, 240, -0.2, 0.05, 0.01, -0.02, 0.01, 0.03, -0.04, 0.005},
         455.05611095194536,
         30.380650243523604},
        {"SIMPLE_RADIAL_FISHEYE", 4, {500, 320, 240, 0.1}, 460.88379128945564, 28.67431306581659},
        {"RADIAL_FISHEYE", 5, {500, 320, 240, 0.1, -0.02}, 460.7176439384551, 28.923534092317368},
        {"FOV", 5, {500, 510, 320, 240, 0.9}, 468.3786842484958, 12.980613099801474},
        {"THIN_PRISM_FISHEYE",
         12,
         {500, 510, 320, 240, 0.1, -0.02, 0.01, -0.02, 0.003, -0.0004, 0.005, -0.006},
         456.2330730417651,
         29.24431709933151},
        {"RAD_TAN_THIN_PRISM_FISHEYE",
         16,
         {500, 510, 320, 240, 0.1, -0.02, 0.003, -0.0004, 0.0005, -0.0006, 0.01, -0.02, 0.005, -0.006, 0.007,
          -0.008},
         465.62409246858704,
         17.86782829543938},
        {"SIMPLE_DIVISION", 4, {500, 320, 240, -0.2}, 462.122469435776, 26.816295846336004},
        {"DIVISION", 5, {500, 510, 320, 240, -0.2}, 462.122469435776, 22.55262176326272},
        {"SIMPLE_FISHEYE", 3, {500, 320, 240}, 457.50400387047205, 33.7439941942919},
        {"FISHEYE", 4, {500, 510, 320, 240}, 457.50400387047205, 29.618874078177726},
        {"EUCM", 6, {500, 510, 320, 240, 0.6, 1.1}, 457.63938831614445, 29.41173587629899},
    };
    for (size_t i = 0; i < OXL_COUNT(cases); i++) {
        const struct colmap_camera c = camera_make(cases[i].model, 640, 480, cases[i].parameter);
        const double direction[2] = {0.3, -0.45}, axis[2] = {0, 0};
        double pixel[2];
        CHECK(c.parameter_count == cases[i].count);
        CHECK_TEXT(camera_model_list(), cases[i].model);
        camera_distort(&c, direction, pixel);
        CHECK_CLOSE(pixel[0], cases[i].x, 1e-10);
        CHECK_CLOSE(pixel[1], cases[i].y, 1e-10);
        camera_distort(&c, axis, pixel);
        CHECK(pixel[0] == 320 && pixel[1] == 240);
    }
    CHECK(camera_model_find("FO", 2) < 0 && camera_model_find("PINHOLES", 8) < 0 &&
          camera_model_find("PIN", 3) < 0);
}

TEST(camera_models_have_the_ids_of_colmap)
{
    static const struct {
        const char *name;
        int id;
    } known[] = {{"SIMPLE_PINHOLE", 0}, {"OPENCV", 4},    {"FULL_OPENCV", 6},     {"FOV", 7},
                 {"RADIAL_FISHEYE", 9}, {"DIVISION", 13}, {"EQUIRECTANGULAR", 17}};
    for (size_t i = 0; i < OXL_COUNT(known); i++)
        CHECK(camera_model_find(known[i].name, strlen(known[i].name)) == known[i].id);
    CHECK(camera_model_at(17) && !camera_model_at(18));
}

TEST(camera_of_the_whole_sphere_is_refused_with_a_fix)
{
    const double p[] = {640, 320};
    const struct colmap_camera c = camera_make("EQUIRECTANGULAR", 640, 320, p);
    oxl_camera ideal;
    CHECK(camera_is_distorted(&c));
    CHECK_ERROR(camera_undistorted(test_ctx, &c, &ideal), OXL_ERR_INPUT,
                "cameras.txt:4: camera 1 (EQUIRECTANGULAR) is a 360-degree camera");
    CHECK_SAYS("panorama_sfm.py");
}

TEST(camera_new_models_without_distortion_are_pinholes)
{
    const double fov[] = {500, 510, 320, 240, 0}, eucm[] = {500, 510, 320, 240, 0, 1};
    const struct colmap_camera none[] = {camera_make("FOV", 640, 480, fov),
                                         camera_make("DIVISION", 640, 480, fov),
                                         camera_make("EUCM", 640, 480, eucm)};
    for (size_t i = 0; i < OXL_COUNT(none); i++) {
        const double direction[2] = {0.3, -0.45};
        double pixel[2];
        CHECK(!camera_is_distorted(&none[i]));
        camera_distort(&none[i], direction, pixel);
        CHECK_CLOSE(pixel[0], 470, 1e-10);
        CHECK_CLOSE(pixel[1], 10.5, 1e-10);
    }
}

TEST(camera_atan_agrees_with_libm_to_1e_15)
{
    double worst = 0;
    for (double x = 1e-12; x < 1e12; x *= 1.01) worst = OXL_MAX(worst, fabs(camera_atan(x) / atan(x) - 1));
    CHECK_CLOSE(worst, 0, 1e-15);
    CHECK(camera_atan(0) == 0);
}

TEST(camera_undistorted_has_the_size_that_colmap_gives_the_pool)
{
    const double p[] = {1042.8142056641748, 480, 256, -0.27931708280078082};
    const struct colmap_camera c = camera_make("SIMPLE_RADIAL", 960, 512, p);
    oxl_camera ideal;
    CHECK_OK(camera_undistorted(test_ctx, &c, &ideal));
    CHECK(ideal.width == 1028 && ideal.height == 520); /* image_undistorter of COLMAP 3.8, blank_pixels = 0 */
    CHECK(ideal.fx == p[0] && ideal.fy == p[0]);
    CHECK_CLOSE(ideal.cx, 514, 1e-6);
    CHECK_CLOSE(ideal.cy, 260, 1e-6);
}

TEST(camera_without_distortion_is_taken_as_it_is)
{
    const double p[] = {500, 510, -30, 700, 0, 0, 0, 0}; /* a crop may leave the principal point outside */
    const struct colmap_camera c = camera_make("OPENCV", 640, 480, p);
    oxl_camera ideal;
    CHECK(!camera_is_distorted(&c));
    CHECK_OK(camera_undistorted(test_ctx, &c, &ideal));
    CHECK(ideal.width == 640 && ideal.height == 480 && ideal.fx == 500 && ideal.fy == 510 &&
          ideal.cx == -30 && ideal.cy == 700);
}

/* Every pixel of `ideal`, not its border alone, was seen; and farther out along a row or column the image
 * continues. */
static void camera_check_seen(const struct colmap_camera *c, const oxl_camera *ideal)
{
    int unseen = 0, folded = 0;
    for (int y = 0; y < ideal->height; y++) {
        double last = -1e30;
        for (int x = 0; x < ideal->width; x++) {
            const double direction[2] = {(x + 0.5 - ideal->cx) / ideal->fx,
                                         (y + 0.5 - ideal->cy) / ideal->fy};
            double pixel[2];
            camera_distort(c, direction, pixel);
            unseen += !(pixel[0] >= 0.5 && pixel[0] <= c->width - 0.5 && pixel[1] >= 0.5 &&
                        pixel[1] <= c->height - 0.5);
            folded += !(pixel[0] > last);
            last = pixel[0];
        }
    }
    CHECK(unseen == 0 && folded == 0);
}

TEST(camera_undistorted_holds_only_pixels_that_were_seen_once)
{
    static const struct {
        const char *model;
        double parameter[CAMERA_PARAMETERS];
        int least_width;
    } cases[] = {
        {"SIMPLE_RADIAL", {500, 320, 240, -0.3}, 640}, /* barrel, as a dome port gives */
        {"SIMPLE_RADIAL", {500, 320, 240, 0.3}, 400},  /* pincushion */
        {"SIMPLE_RADIAL", {200, 320, 240, -0.3}, 300}, /* folds back inside of the image */
        {"RADIAL", {400, 100, 400, -0.4, 0.1}, 600},   /* off centre */
        {"OPENCV", {500, 480, 330, 230, -0.3, 0.08, 0.01, -0.01}, 600},
        {"OPENCV_FISHEYE", {200, 200, 320, 240, 0, 0, 0, 0}, 1000}, /* 183 degrees wide: bounded growth */
        {"OPENCV_FISHEYE", {300, 300, 320, 240, 0.05, 0.01, -0.02, 0}, 700},
        {"SIMPLE_RADIAL_FISHEYE",
         {100, 320, 240, 0},
         1000},                                       /* 360 degrees: the image holds what lies behind */
        {"DIVISION", {500, 480, 320, 240, 0.2}, 500}, /* ends at r = 1.1 */
    };
    for (size_t i = 0; i < OXL_COUNT(cases); i++) {
        const struct colmap_camera c = camera_make(cases[i].model, 640, 480, cases[i].parameter);
        oxl_camera ideal;
        CHECK_OK(camera_undistorted(test_ctx, &c, &ideal));
        CHECK(ideal.width >= cases[i].least_width && ideal.width <= 1280 && ideal.height <= 960);
        camera_check_seen(&c, &ideal);
    }
}

TEST(camera_invalid_values_are_refused_with_a_fix)
{
    static const struct {
        const char *model;
        int width;
        double parameter[12];
        const char *words;
    } cases[] = {
        {"PINHOLE", 640, {-500, 500, 320, 240}, "focal length -500"},
        {"PINHOLE", 640, {500, 0, 320, 240}, "focal length 500, 0"},
        {"PINHOLE", 640, {500, 1.27, 320, 240}, "expected 1.28 (half a turn of view) to 1e9"},
        {"SIMPLE_PINHOLE", 2000000, {500, 320, 240}, "2000000 x 480"},
        {"SIMPLE_RADIAL", 640, {500, 700, 240, -0.1}, "outside of its 640 x 480"},
        {"SIMPLE_RADIAL", 640, {500, 320, 240, -1e6}, "leaves no image"},
        {"SIMPLE_PINHOLE", 640, {500, 1e300, 240}, "principal point"},
    };
    for (size_t i = 0; i < OXL_COUNT(cases); i++) {
        const struct colmap_camera c = camera_make(cases[i].model, cases[i].width, 480, cases[i].parameter);
        oxl_camera ideal;
        CHECK(camera_undistorted(test_ctx, &c, &ideal) == OXL_ERR_INPUT && ideal.width == 0);
        CHECK_SAYS(cases[i].words);
        CHECK_SAYS("fix: ");
        CHECK_SAYS("cameras.txt:4");
    }
}

TEST(camera_pose_turns_quaternions_and_finds_the_centre)
{
    const double q[4] = {2, 0, 0, 2}; /* 90 degrees about z, not normalised */
    const double zero[4] = {0};
    oxl_camera c = {.translation = {1, 2, 3}};
    double p[3], x[3];
    camera_rotation_from_quaternion(q, c.rotation);
    CHECK_CLOSE(c.rotation[1], -1, 1e-15);
    CHECK_CLOSE(c.rotation[3], 1, 1e-15);
    CHECK_CLOSE(c.rotation[8], 1, 1e-15);
    camera_position(&c, p);
    for (int i = 0; i < 3; i++) {
        x[i] = c.translation[i];
        for (int j = 0; j < 3; j++) x[i] += c.rotation[3 * i + j] * p[j];
        CHECK_CLOSE(x[i], 0, 1e-15);
    }
    camera_rotation_from_quaternion(zero, c.rotation);
    CHECK(c.rotation[0] == 1 && c.rotation[4] == 1 && c.rotation[8] == 1 && c.rotation[1] == 0);
}

/* The corner shared by four pixels is the centre of the one that they become. */
TEST(camera_halved_sees_the_same_direction_at_half_the_pixel)
{
    const oxl_camera whole = {.width = 101, .height = 60, .fx = 90, .fy = 80, .cx = 51.3, .cy = 29.1},
                     half = camera_halve(&whole);
    CHECK(half.width == 50 && half.height == 30);
    CHECK_CLOSE((7.5 - half.cx) / half.fx, (15 - whole.cx) / whole.fx, 1e-15);
    CHECK_CLOSE((9.5 - half.cy) / half.fy, (19 - whole.cy) / whole.fy, 1e-15);
}
