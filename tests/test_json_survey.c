/* test_json_survey.c - nerfstudio's and OpenSfM's files give the scene that COLMAP's export of the same
 * survey gives. */
#include "test.h"
#include "../src/formats/json.h"

static const char jsurvey_images[] =
    "1 0.9 0.1 -0.3 0.2 0.5 -1.5 2 1 a.png\n\n2 0.8 0.6 0.05 -0.1 1 2 3 1 b.png\n\n3 0.1 0.2 0.9 0.3 0 0 1 1 c.png\n\n";
static const char jsurvey_points[] = "0 1.5 -2.5 3 255 0 128 -1\n1 100 0 -0.125 1 2 3 -1\n2 0 0 4 7 8 9 -1\n";

/* Writes COLMAP's rows as the other program would. */
static void jsurvey_write_nerfstudio(const struct colmap *c, const char *intrinsics)
{
    OWNED_TEXT t = test_text();
    text_add(&t, "{%s,\n\"ply_file_path\": \"points.ply\", \"frames\": [", intrinsics);
    for (size_t i = 0; i < c->image_count; i++) {
        double r[9];
        camera_rotation_from_quaternion(c->image[i].rotation, r);
        text_add(&t, "%s{\"file_path\": \"./images/%s\", \"transform_matrix\": [", i ? "," : "",
                 c->names + c->image[i].name);
        for (int row = 0; row < 3; row++) {
            double place = 0;
            for (int k = 0; k < 3; k++) place -= r[3 * k + row] * c->image[i].translation[k];
            text_add(&t, "[%.17g, %.17g, %.17g, %.17g],", r[row], -r[3 + row], -r[6 + row], place);
        }
        text_add(&t, "[0,0,0,1]]}");
    }
    text_add(&t, "]}\n");
    test_write("ns/transforms.json", t.data);
    test_write(
        "ns/points.ply",
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n"
        "1.5 -2.5 3 255 0 128\n100 0 -0.125 1 2 3\n0 0 4 7 8 9\n");
}

static void jsurvey_write_opensfm(const struct colmap *c, const char *camera)
{
    OWNED_TEXT t = test_text();
    text_add(
        &t,
        "[{\"cameras\": {\"other\": {\"projection_type\": \"spherical\", \"width\": 8, \"height\": 4}, \"v2 \\\"x\\\"\": %s},\n\"shots\": {",
        camera);
    for (size_t i = 0; i < c->image_count; i++) {
        const double *q = c->image[i].rotation;
        const double norm = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
        const double angle = 2 * acos(q[0] / norm), scale = angle / (norm * sin(angle / 2));
        text_add(
            &t,
            "%s\"%s\": {\"rotation\": [%.17g, %.17g, %.17g], \"translation\": [%.17g, %.17g, %.17g], \"camera\": \"v2 \\\"x\\\"\"}",
            i ? ",\n" : "", c->names + c->image[i].name, scale * q[1], scale * q[2], scale * q[3],
            c->image[i].translation[0], c->image[i].translation[1], c->image[i].translation[2]);
    }
    text_add(&t, "}, \"points\": {");
    for (size_t i = 0; i < c->point_count; i++) {
        const double *p = c->point[i].position;
        text_add(&t, "%s\"%zu\": {\"color\": [%d.0, %d, %d], \"coordinates\": [%.17g, %.17g, %.17g]}",
                 i ? "," : "", 7 * i, c->point[i].rgb[0], c->point[i].rgb[1], c->point[i].rgb[2], p[0], p[1],
                 p[2]);
    }
    text_add(&t, "}}, {\"cameras\": {}, \"shots\": {}, \"points\": {}}]");
    test_write("osfm/opensfm/reconstruction.json", t.data);
}

static void jsurvey_check_same(const struct colmap *a, const struct colmap *b)
{
    CHECK(a->image_count == b->image_count && a->point_count == b->point_count && b->format == COLMAP_JSON);
    for (size_t i = 0; i < b->image_count; i++) {
        const struct colmap_image *x = &a->image[i], *y = &b->image[i];
        const struct colmap_camera *p = &a->camera[0], *q = &b->camera[y->camera_id];
        double r[9], s[9];
        CHECK(strcmp(a->names + x->name, b->names + y->name) == 0);
        camera_rotation_from_quaternion(x->rotation, r);
        camera_rotation_from_quaternion(y->rotation, s);
        for (int k = 0; k < 9; k++) CHECK_CLOSE(r[k], s[k], 1e-14);
        for (int k = 0; k < 3; k++) CHECK_CLOSE(x->translation[k], y->translation[k], 1e-13);
        CHECK(p->width == q->width && p->height == q->height);
        for (double u = -0.4; u < 0.5; u += 0.2) {
            const double direction[2] = {u, 0.3 - u / 2};
            double here[2], there[2];
            camera_distort(p, direction, here);
            camera_distort(q, direction, there);
            CHECK_CLOSE(here[0], there[0], 1e-10);
            CHECK_CLOSE(here[1], there[1], 1e-10);
        }
    }
    for (size_t i = 0; i < b->point_count; i++)
        CHECK(memcmp(a->point[i].position, b->point[i].position, sizeof a->point[i].position) == 0 &&
              memcmp(a->point[i].rgb, b->point[i].rgb, 3) == 0);
}

/* A camera as COLMAP has it, and as the other file. */
static void jsurvey_check_case(const char *const camera[2],
                               void (*write)(const struct colmap *c, const char *camera), const char *folder,
                               size_t cameras)
{
    OWNED_COLMAP colmap = colmap_of(camera[0], jsurvey_images, jsurvey_points), other = {0};
    write(&colmap, camera[1]);
    CHECK_OK(survey_find_model(test_ctx, test_path("%s", folder), NULL, NULL, NULL, &other));
    CHECK(other.camera_count == cameras && !other.images && other.warnings == 0);
    jsurvey_check_same(&colmap, &other);
}

TEST(nerfstudio_survey_equals_that_of_colmap_with_every_camera_model)
{
    static const char *const cases[][2] = {
        {"1 OPENCV 640 480 500 501 321 239 0.1 -0.02 1e-3 -2e-4\n",
         "\"camera_model\": \"OPENCV\", \"w\": 640, \"h\": 480, \"fl_x\": 500, \"fl_y\": 501, \"cx\": 321, \"cy\": 239, \"k1\": 0.1, \"k2\": -0.02, "
         "\"p1\": 1e-3, \"p2\": -2e-4"},
        {"1 OPENCV_FISHEYE 640 480 300 301 321 239 0.1 -0.02 1e-3 -2e-4\n",
         "\"camera_model\": \"OPENCV_FISHEYE\", \"w\": 640.0, \"h\": 480, \"fl_x\": 300, \"fl_y\": 301, \"cx\": 321, \"cy\": 239, \"k1\": 0.1, "
         "\"k2\": -0.02, \"k3\": 1e-3, \"k4\": -2e-4"},
        {"1 SIMPLE_PINHOLE 640 480 320 320 240\n",
         "\"w\": 640, \"h\": 480, \"camera_angle_x\": 1.5707963267948966"}};
    for (size_t i = 0; i < OXL_COUNT(cases); i++)
        jsurvey_check_case(cases[i], jsurvey_write_nerfstudio, "ns", 1);
}

TEST(opensfm_survey_equals_that_of_colmap_with_every_camera_model)
{
    static const char *const cases[][2] = {
        {"1 FULL_OPENCV 640 480 320 326.4 326.4 236.8 0.1 -0.02 1e-3 -2e-4 0.003 0 0 0\n",
         "{\"projection_type\": \"brown\", \"width\": 640, \"height\": 480, \"focal_x\": 0.5, \"focal_y\": 0.51, \"c_x\": 0.01, \"c_y\": -0.005, "
         "\"k1\": 0.1, \"k2\": -0.02, \"p1\": 1e-3, \"p2\": -2e-4, \"k3\": 0.003}"},
        {"1 RADIAL 640 480 320 320 240 0.1 -0.02\n",
         "{\"projection_type\": \"perspective\", \"width\": 640, \"height\": 480, \"focal\": 0.5, \"k1\": 0.1, \"k2\": -0.02}"},
        {"1 RADIAL_FISHEYE 640 480 320 320 240 0.1 -0.02\n",
         "{\"projection_type\": \"fisheye\", \"width\": 640, \"height\": 480, \"focal\": 0.5, \"k1\": 0.1, \"k2\": -0.02}"},
        {"1 OPENCV_FISHEYE 640 480 320 326.4 326.4 236.8 0.1 -0.02 1e-3 -2e-4\n",
         "{\"projection_type\": \"fisheye_opencv\", \"width\": 640, \"height\": 480, \"focal_x\": 0.5, \"focal_y\": 0.51, \"c_x\": 0.01, "
         "\"c_y\": -0.005, \"k1\": 0.1, \"k2\": -0.02, \"k3\": 1e-3, \"k4\": -2e-4}"},
        {"1 OPENCV 640 480 320 326.4 326.4 236.8 0.1 0 0 0\n",
         "{\"projection_type\": \"simple_radial\", \"width\": 640, \"height\": 480, \"focal_x\": 0.5, \"focal_y\": 0.51, \"c_x\": 0.01, "
         "\"c_y\": -0.005, \"k1\": 0.1}"}};
    for (size_t i = 0; i < OXL_COUNT(cases); i++)
        jsurvey_check_case(cases[i], jsurvey_write_opensfm, "osfm", 2);
}

static const char *jsurvey_refused(const char *name, const char *text)
{
    struct colmap c;
    test_write(test_path("bad/%s", name), text);
    CHECK_ERROR(json_survey_read(test_ctx, test_path("bad"), name, NULL, &c), OXL_ERR_INPUT, "\nfix: ");
    return oxl_error_text(test_ctx);
}

#define JSURVEY_FRAME \
    "{\"file_path\": \"images/a.png\", \"transform_matrix\": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}"
#define JSURVEY_MATRIX(name, matrix) \
    "{" JSURVEY_CAMERA ", \"frames\": [{\"file_path\": \"" name "\", \"transform_matrix\": [" matrix "]}]}"
#define JSURVEY_CAMERA "\"w\": 64, \"h\": 48, \"fl_x\": 50"

TEST(nerfstudio_that_is_wrong_is_refused_with_the_frame)
{
    static const char whole[] = "{" JSURVEY_CAMERA ", \"frames\": [" JSURVEY_FRAME "]}";
    static const char *const wrong[][2] = {
        {"{" JSURVEY_CAMERA ", \"frames\": []}", "found none for the images"},
        {"{\"w\": 64, \"frames\": [" JSURVEY_FRAME "]}",
         "record 1: found none, and no image to take them from for w and h"},
        {"{\"w\": 64, \"h\": 48, \"frames\": [" JSURVEY_FRAME "]}", "a parameter that is missing"},
        {"{\"camera_model\": \"ORTHOPHOTO\", " JSURVEY_CAMERA ", \"frames\": [" JSURVEY_FRAME "]}",
         "found ORTHOPHOTO for camera_model"},
        {"{" JSURVEY_CAMERA ", \"k4\": 0.1, \"frames\": [" JSURVEY_FRAME "]}", "k4 of OPENCV"},
        {JSURVEY_MATRIX("images/a.png", "[2,0,0,0],[0,1,0,0],[0,0,1,0]"), "found no rotation"},
        {JSURVEY_MATRIX("../a\\n.png", "[1,0,0,0],[0,1,0,0],[0,0,1,0]"), "a line end in a name"},
        {JSURVEY_MATRIX("images/a.png", "[1,0,0,0],[0,1,0,0],[0,0,1,0],[3,4,0,1]"),
         "found a last row other than 0 0 0 1 for transform_matrix"},      /* transposed */
        {JSURVEY_MATRIX("images/a.png", "[-1,0,0,0],[0,1,0,0],[0,0,1,0]"), /* mirrored */
         "found no rotation for transform_matrix, expected columns of length 1 at right angles, and right-handed"},
    };
    OWNED_COLMAP c;
    test_write("good/transforms.json", whole);
    CHECK_OK(json_survey_read(test_ctx, test_path("good"), "transforms.json", NULL, &c));
    CHECK(c.image_count == 1 && c.point_count == 0 && c.camera[0].parameter[2] == 32 &&
          strcmp(c.names, "a.png") == 0);
    for (size_t size = 0; size + 1 < sizeof whole; size++) {
        char cut[sizeof whole];
        memcpy(cut, whole, size);
        cut[size] = 0;
        jsurvey_refused("transforms.json", cut);
    }
    for (size_t i = 0; i < OXL_COUNT(wrong); i++)
        CHECK_TEXT(jsurvey_refused("transforms.json", wrong[i][0]), wrong[i][1]);
}

TEST(json_surveys_may_begin_with_a_byte_order_mark)
{
    OWNED_COLMAP c = {0};
    test_write("marked/transforms.json", "\xef\xbb\xbf{" JSURVEY_CAMERA ", \"frames\": [" JSURVEY_FRAME "]}");
    CHECK_OK(json_survey_read(test_ctx, test_path("marked"), "transforms.json", NULL, &c));
    CHECK(c.image_count == 1);
}

TEST(opensfm_that_is_wrong_is_refused_with_the_record)
{
#define JSURVEY_SHOT "{\"rotation\": [0,0,0], \"translation\": [0,0,0], \"camera\": \"c\"}"
    static const char *const wrong[][2] = {
        {"[{\"cameras\": {\"c\": {\"projection_type\": \"dual\", \"width\": 8, \"height\": 8}}, "
         "\"shots\": {\"a\": " JSURVEY_SHOT "}}]",
         "record 1: found dual for projection_type"},
        {"[{\"cameras\": {}, \"shots\": {\"a\": " JSURVEY_SHOT "}}]", "a name that is not among the cameras"},
        {"[]", "found none for the images"},
        {"[{\"cameras\": [1], \"shots\": [2]}]", "found none for the images"}};
    for (size_t i = 0; i < OXL_COUNT(wrong); i++)
        CHECK_TEXT(jsurvey_refused("reconstruction.json", wrong[i][0]), wrong[i][1]);
}

/* The reference that a reconstruction has, 0 0 if none; beside: the text of reference_lla.json; own: members. */
static void jsurvey_reference(const char *beside, const char *own, double out[2])
{
    OWNED_COLMAP c = {0};
    char text[600];
    snprintf(
        text, sizeof text,
        "[{%s\"cameras\": {\"c\": {\"projection_type\": \"perspective\", \"width\": 8, \"height\": 8, \"focal\": 1}}, "
        "\"shots\": {\"a\": " JSURVEY_SHOT "}}]",
        own);
    test_write("place/reconstruction.json", text);
    test_write("place/reference_lla.json", beside);
    CHECK_OK(json_survey_read(test_ctx, test_path("place"), "reconstruction.json", NULL, &c));
    for (int i = 0; i < 2; i++) out[i] = c.has_reference ? c.reference[i] : 0;
}

TEST(opensfm_reference_is_its_own_or_that_of_the_file_beside_it)
{
    static const char file[] = "{\"latitude\": 46.84, \"longitude\": -91.99, \"altitude\": 198.3}";
    double at[2];
    jsurvey_reference(file, "", at);
    CHECK(at[0] == 46.84 && at[1] == -91.99);
    jsurvey_reference(file, "\"reference_lla\": {\"latitude\": -1.5, \"longitude\": 2.5}, ", at);
    CHECK(at[0] == -1.5 && at[1] == 2.5);
    jsurvey_reference("{\"latitude\": 146, \"longitude\": 2}", "", at); /* warned of */
    CHECK(at[0] == 0 && at[1] == 0);
    jsurvey_reference("{\"latitude\": 4", "", at);
    CHECK(at[0] == 0 && at[1] == 0);
}

TEST(nerfstudio_names_start_from_its_folder_unless_all_begin_with_images)
{
    OWNED_COLMAP c = {0};
    test_write("ns/transforms.json",
               "{" JSURVEY_CAMERA ", \"frames\": [" JSURVEY_FRAME
               ", {\"file_path\": \"./rgb/r_0\", \"transform_matrix\": [[1,0,0,0],[0,1,0,0],[0,0,1,0]]}]}");
    CHECK_OK(json_survey_read(test_ctx, test_path("ns"), "transforms.json", NULL, &c));
    CHECK(c.images && c.camera_count == 1);
    CHECK(strcmp(c.names + c.image[0].name, "images/a.png") == 0 &&
          strcmp(c.names + c.image[1].name, "rgb/r_0.png") == 0);
}

TEST(json_strings_give_back_names_of_any_bytes_and_are_utf8)
{
    static const char *const names[][2] = {
        {"a\xff\xfe z", "\"a\\udcff\\udcfe z\""},
        {"\xc3\xa9\xe2\x82\xac\xf0\x9f\x90\x9f", "\"\xc3\xa9\xe2\x82\xac\xf0\x9f\x90\x9f\""},
        {"\xc3", "\"\\udcc3\""},
        {"\xed\xa0\x80", "\"\\udced\\udca0\\udc80\""},
        {"\x01\"\\", "\"\\u0001\\\"\\\\\""}};
    char out[64];
    for (size_t i = 0; i < OXL_COUNT(names); i++) {
        OWNED_TEXT t = test_text();
        text_add_json_string(&t, names[i][0]);
        CHECK(strcmp(t.data, names[i][1]) == 0);
        CHECK(oxl_json_text(t.data, out, sizeof out) == strlen(names[i][0]) && strcmp(out, names[i][0]) == 0);
    }
    CHECK(oxl_json_text("\"\\ud83d\\udc1f\"", out, sizeof out) == 4 &&
          strcmp(out, "\xf0\x9f\x90\x9f") == 0); /* as json.dump writes it */
}

TEST(json_cursor_reads_what_is_there_and_nothing_else)
{
    static const char text[] = "{\"a\": [1, -2.5e-1, {\"b\": true}], \"s\\\"\": \"x\\u00e9\\n\", \"n\": 0.1}";
    const char *array = oxl_json_member(text, "a"), *second = oxl_json_next(oxl_json_first(array));
    char out[32];
    CHECK(oxl_json_error(text) == NULL && oxl_json_error("{\"a\": 1") != NULL &&
          oxl_json_error("[1] 2") != NULL);
    CHECK(oxl_json_number_at(&second) == -0.25 && oxl_json_number(text, "n") == 0.1 &&
          isnan(oxl_json_number(text, "m")));
    CHECK(oxl_json_is_true(oxl_json_next(oxl_json_next(oxl_json_first(array))), "b") &&
          !oxl_json_is_true(text, "a"));
    CHECK(oxl_json_text(oxl_json_value(oxl_json_next(array)), out, sizeof out) == 4 &&
          strcmp(out, "x\xc3\xa9\n") == 0);
    CHECK(oxl_json_text(oxl_json_value(oxl_json_next(array)), out, 3) == 0 && oxl_json_next(NULL) == NULL);
}

/* ---------------- splits, sizes and names that the files leave to the images */

#define JSURVEY_AT(name) \
    "{\"file_path\": \"" name "\", \"transform_matrix\": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}"

static void jsurvey_write_image(const char *name, int width, int height)
{
    OWNED_IMAGE image = test_image(width, height);
    /* No two images are copies of each other. */
    for (int i = 0; i < 3 * width * height; i++)
        image.rgb[i] = (float)(checksum_add(CHECKSUM_SEED + (uint64_t)i, name, strlen(name)) % 256) / 255;
    test_make_folder("blender/train");
    test_make_folder("blender/test");
    test_write_image(name, &image);
}

/* NeRF synthetic's layout: 24 x 16 px, three images to train on, two to hold out. */
static void jsurvey_write_blender(const char *held_out)
{
    test_write("blender/transforms_train.json",
               "{\"camera_angle_x\": 1.5707963267948966, \"frames\": [" JSURVEY_AT(
                   "./train/r_0") ", " JSURVEY_AT("./train/r_1") ", " JSURVEY_AT("./train/r.2") "]}");
    test_write(test_path("blender/%s", held_out),
               "{\"camera_angle_x\": 1.5707963267948966, \"frames\": [" JSURVEY_AT(
                   "./test/r_0") ", " JSURVEY_AT("./test/r_1") "]}");
    jsurvey_write_image("blender/train/r_0.png", 24, 16);
    jsurvey_write_image("blender/train/r_1.JPG", 24, 16);
    jsurvey_write_image("blender/train/r.2.png", 24, 16);
    jsurvey_write_image("blender/test/r_0.png", 24, 16);
    jsurvey_write_image("blender/test/r_1.png", 24, 16);
}

TEST(nerf_synthetic_trains_on_its_train_file_and_holds_out_its_test_or_val_file)
{
    static const char *const held_out[] = {"transforms_val.json", "transforms_test.json"};
    static const char *const names[] = {"test/r_0.png", "test/r_1.png", "train/r.2.png", "train/r_0.png",
                                        "train/r_1.JPG"};
    for (size_t k = 0; k < OXL_COUNT(held_out); k++) { /* with both, test is held out */
        jsurvey_write_blender(held_out[k]);
        jsurvey_write_image("blender/train/r_0.png", 12, 8); /* most have 24 x 16 px */
        struct os_file_map file = test_file("blender/train/r_1.JPG");
        test_write_bytes("blender/train/r_1.JPG", file.data, 64); /* its beginning states its size */
        os_release_file(test_ctx, &file);
        if (k == 1)
            test_write("blender/transforms_val.json", "{\"frames\": [" JSURVEY_AT("./train/r_0") "]}");
        test_write("blender/points3d.ply", "");
        test_listen();
        OWNED_SCENE *scene = test_load("blender", NULL);
        CHECK_LOGGED("so no points are read");
        CHECK(!strstr(strstr(test_said.all, "so no points") + 1, "so no points")); /* of two files */
        CHECK(scene && oxl_scene_view_count(scene) == 5 && scene->stats.test_views == 2);
        for (int i = 0; scene && i < oxl_scene_view_count(scene); i++) {
            const oxl_view *view = oxl_scene_view(scene, i);
            CHECK(strcmp(view->name, names[i]) == 0 && view->is_test == (i < 2));
            CHECK(view->camera.width == 24 && view->camera.height == 16);
            CHECK_CLOSE(view->camera.fx, 12, 1e-9);
        }
    }
}

TEST(a_split_that_the_survey_states_refuses_another)
{
    oxl_scene_options options = oxl_scene_options_default();
    oxl_scene *scene;
    jsurvey_write_blender("transforms_test.json");
    for (options.test_every = 0; options.test_every < 9; options.test_every += 8) {
        CHECK_ERROR(oxl_scene_load(test_ctx, test_path("blender"), &options, &scene), OXL_ERR_USAGE,
                    "states which of its images are held out (2 of 5)\nfix: ");
    }
}

/* The folder has one file of NeRF synthetic's three, or the names of two; NULL: the survey is not read. */
static const char *jsurvey_splits(const char *files)
{
    static char splits[8];
    oxl_scene *scene = NULL;
    jsurvey_write_blender("transforms_test.json");
    test_write("blender/transforms_val.json",
               "{\"camera_angle_y\": 1.5707963267948966, \"frames\": [" JSURVEY_AT("./train/r_0") "]}");
    for (int i = 0; i < 3; i++) {
        static const char *const names[] = {"train", "val", "test"};
        if (!strstr(files, names[i])) os_remove(test_path("blender/transforms_%s.json", names[i]));
    }
    if (oxl_scene_load(test_ctx, test_path("blender"), NULL, &scene) != OXL_OK) return NULL;
    memset(splits, 0, sizeof splits);
    for (int i = 0; i < oxl_scene_view_count(scene); i++) splits[i] = "+-"[oxl_scene_view(scene, i)->is_test];
    CHECK_CLOSE(oxl_scene_view(scene, 0)->camera.fx, strstr(files, "val") && !strstr(files, "test") ? 8 : 12,
                1e-9);
    CHECK(scene->stats.unregistered == 0);
    oxl_scene_free(test_ctx, scene);
    return splits;
}

TEST(nerf_synthetic_of_any_of_its_files_is_read)
{
    jsurvey_write_blender("transforms_test.json");
    jsurvey_write_image("blender/test/r_0_depth_0001.png", 24, 16);
    jsurvey_write_image("blender/train/r_0_normal_0001.png", 24, 16);
    CHECK(strcmp(jsurvey_splits("train"), "-++") == 0 && strcmp(jsurvey_splits("test"), "--") == 0);
    CHECK(strcmp(jsurvey_splits("val"), "-") == 0 && strcmp(jsurvey_splits("val test"), "--") == 0);
    CHECK(strcmp(jsurvey_splits("train test"), "--+++") == 0);
}

TEST(survey_of_held_out_images_is_evaluated_and_not_trained_on)
{
    oxl_train_options options = oxl_train_options_default(OXL_PRESET_DRAFT);
    oxl_trained trained = {0};
    CHECK(jsurvey_splits("test"));
    OWNED_SCENE *scene = test_load("blender", NULL);
    OWNED_MODEL model = test_model(1, 0);
    CHECK(test_evaluate(&model, scene, NULL, OXL_SPLIT_TEST).count == 2);
    options.iterations = 2;
    CHECK_ERROR(oxl_train(test_ctx, scene, &options, NULL, &trained), OXL_ERR_INPUT,
                "there is no training view: all 2 images that exist are held out");
}

/* ---------------- LLFF */

static void jsurvey_write_array(const char *head, int size, int rows, double width)
{
    static const double row[17] = {0, 1, 0, 5,  12, 1,  0,   0, -2,
                                   0, 0, 0, -1, 3,  20, 0.5, 9}; /* axes of COLMAP's */
    unsigned char file[4096] = {0x93, 'N', 'U', 'M', 'P', 'Y', 1, 0, 118, 0}, *at = file + 128;
    memset(file + 10, ' ', 118);
    memcpy(file + 10, head, strlen(head));
    for (int i = 0; i < rows; i++)
        for (int k = 0; k < 17; k++, at += size) {
            const double value = k == 9 ? width : k == 13 ? i : row[k];
            uint64_t bits;
            if (size == 4) bytes_put_float(at, (float)value);
            memcpy(&bits, &value, sizeof bits);
            if (size == 8) bytes_put(at, bits, 8);
        }
    test_write_bytes("llff/poses_bounds.npy", file, (size_t)(at - file));
}

#define LLFF_HEAD "{'descr': '<f8', 'fortran_order': False, 'shape': (2, 17), }"

static void jsurvey_write_llff(const char *folder, const char *const name[2], int width)
{
    for (int i = 0; i < 2; i++) {
        const char *path = test_path("llff/%s/%s", folder, name[i]);
        OWNED_IMAGE image = test_image(width, OXL_MAX(12 * width / 1604, 1));
        test_write(path, "");
        test_write_image(path, &image);
    }
}

TEST(llff_is_read_for_the_images_in_name_order_of_the_largest_folder_of_1600_px)
{
    static const char *const large[] = {"b.JPG", "a.JPG"}, *const small[] = {"image001.png", "image000.png"};
    oxl_scene_options options = oxl_scene_options_default();
    options.max_side = 0;
    jsurvey_write_llff("images", large, 1604);
    jsurvey_write_llff("images_2", small, 802);
    jsurvey_write_llff("images_4", small, 401);
    test_write("llff/images_4/depth.txt", "");
    for (int k = 0; k < 6; k++) {
        static const char *const asked[] = {NULL, "images_4", "images"};
        const double width = asked[k / 2] ? k / 2 == 1 ? 401 : 1604 : 802;
        uint64_t sum[2] = {0};
        options.images = asked[k / 2];
        jsurvey_write_array(k % 2 ? "{'descr': '<f4', 'fortran_order': False, 'shape': (2L, 17L), }"
                                  : LLFF_HEAD,
                            k % 2 ? 4 : 8, 2, 1604);
        OWNED_SCENE *scene = test_load("llff", &options);
        CHECK(oxl_scene_view_count(scene) == 2);
        for (int i = 0; i < 2; i++) {
            const oxl_view *view = oxl_scene_view(scene, i);
            const double *c = view->camera.rotation, *range = scene_depth_range(scene, i);
            double at[3];
            CHECK(strcmp(view->name, (k / 2 == 2 ? large : small)[1 - i]) == 0 && view->is_test == (i == 0));
            CHECK(view->camera.width == (int)width);
            CHECK_CLOSE(view->camera.fx, 20 * width / 1604, 1e-9);
            CHECK_CLOSE(view->camera.cx, width / 2, 1e-9);
            camera_position(&view->camera, at);
            CHECK_CLOSE(at[0] + scene->origin[0], 5, 1e-6);
            CHECK_CLOSE(at[2] + scene->origin[2], i, 1e-6);
            CHECK(c[0] == 1 && c[4] == 1 && c[8] == 1 && range && range[0] == 0.5 && range[1] == 9);
        }
        CHECK_OK(survey_checksum(test_ctx, scene, &sum[0]));
        scene->colmap.image[1].range[0] = 0.6; /* Another range is another survey. */
        CHECK_OK(survey_checksum(test_ctx, scene, &sum[1]));
        CHECK(sum[0] != sum[1]);
    }
}

/* A program that was stopped leaves a part of COLMAP's model beside the poses. */
TEST(llff_is_read_beside_a_model_of_colmap_that_lacks_a_file)
{
    static const char *const names[] = {"a.png", "b.png"}, *const left[] = {"cameras.bin", "images.bin"};
    jsurvey_write_llff("images", names, 64);
    jsurvey_write_array(LLFF_HEAD, 8, 2, 64);
    for (int i = 0; i < 2; i++) {
        remove(test_path("llff/sparse/0/%s", left[!i]));
        test_write(test_path("llff/sparse/0/%s", left[i]), "");
        test_listen();
        OWNED_SCENE *scene = test_load("llff", NULL);
        CHECK(oxl_scene_view_count(scene) == 2);
        CHECK_WARNED(i ? "cameras.bin is not there, expected" : "images.bin is not there, expected");
    }
}

TEST(llff_array_that_is_damaged_or_foreign_is_refused_with_what_it_is)
{
    static const char *const names[] = {"a.png", "b.png"};
    static const struct {
        const char *head;
        int rows;
        const char *seen;
    } cases[] = {
        {"{'descr': '>f8', 'fortran_order': False, 'shape': (2, 17), }", 2,
         "found an array of {'descr': '>f8'"},
        {"{'descr': '<i8', 'fortran_order': False, 'shape': (2, 17), }", 2, "expected '<f8' or '<f4'"},
        {"{'descr': '|O', 'fortran_order': False, 'shape': (), }", 2, "'|O'"},
        {"{'descr': '<f8', 'fortran_order': True, 'shape': (2, 17), }", 2, "'fortran_order': True"},
        {"{'descr': '<f8', 'fortran_order': False, 'shape': (2, 15), }", 2, "'shape': (2, 15), }, expected"},
        {"{'descr': '<f8', 'fortran_order': False, 'shape': (2, 17, 1), }", 2, "'shape': (2, 17, 1)"},
        {"{'descr': '<f8', 'fortran_order': False, 'shape': (17,), }", 2, "shape (N, 17)"},
        {LLFF_HEAD, 1, "found 136 bytes after the header, expected 2 x 17 numbers of 8 bytes"},
        {"{'descr': '<f8', 'fortran_order': False, 'shape': (99999999999999999, 17), }", 1,
         "found 136 bytes"},
        {"{'descr': '<f8', 'fortran_order': False, 'shape': (3, 17), }", 3, "found 2 images in "},
        {LLFF_HEAD, 0, "found 0 bytes"}};
    static const char *const texts[][2] = {{"", "found an empty file"},
                                           {"PK\3\4 and so on", "found a zip archive, as np.savez writes it"},
                                           {"0.1 0.2", "found '0.1', expected an array that np.save wrote"},
                                           {"\x93NUMPY\1", "expected an array that np.save wrote"}};
    oxl_scene *scene = NULL;
    jsurvey_write_llff("images", names, 16);
    for (size_t i = 0; i < OXL_COUNT(cases) + OXL_COUNT(texts); i++) {
        const char *seen = i < OXL_COUNT(cases) ? cases[i].seen : texts[i - OXL_COUNT(cases)][1];
        if (i < OXL_COUNT(cases)) jsurvey_write_array(cases[i].head, 8, cases[i].rows, 16);
        else test_write("llff/poses_bounds.npy", texts[i - OXL_COUNT(cases)][0]);
        CHECK_ERROR(oxl_scene_load(test_ctx, test_path("llff"), NULL, &scene), OXL_ERR_INPUT,
                    "poses_bounds.npy: found ");
        CHECK_SAYS(seen);
    }
    jsurvey_write_array(LLFF_HEAD, 8, 2, NAN);
    CHECK_ERROR(oxl_scene_load(test_ctx, test_path("llff"), NULL, &scene), OXL_ERR_INPUT,
                "poses_bounds.npy: record 1: found height 12, width nan");
}

/* The splits of the images that are left, by name: 1 trained on, 2 held out. */
static void jsurvey_check_lists(const char *lists, const char *wanted)
{
    OWNED_TEXT t = test_text();
    OWNED_COLMAP c = {0};
    char seen[16] = "....";
    text_add(&t, "{" JSURVEY_CAMERA ", %s \"frames\": [", lists);
    for (int i = 0; i < 4; i++)
        text_add(
            &t,
            "%s{\"file_path\": \"./images/%c.png\", \"transform_matrix\": [[1,0,0,%d],[0,1,0,0],[0,0,1,0]]}",
            i ? "," : "", 'a' + i, i);
    text_add(&t, "]}");
    test_write("lists/transforms.json", t.data);
    CHECK_OK(json_survey_read(test_ctx, test_path("lists"), "transforms.json", NULL, &c));
    for (size_t i = 0; i < c.image_count; i++)
        seen[c.names[c.image[i].name] - 'a'] = (char)('0' + c.image[i].split);
    CHECK_TEXT(seen, wanted);
    CHECK(c.states_split == (strchr(wanted, '0') == NULL));
}

TEST(nerfstudio_lists_of_filenames_are_its_split)
{
    jsurvey_check_lists("", "0000");
    jsurvey_check_lists("\"train_filenames\": [], \"test_filenames\": [],", "0000");
    jsurvey_check_lists("\"test_filenames\": [\"images/c.png\", \"none\"],", "1121");
    jsurvey_check_lists("\"val_filenames\": [\"./images/b.png\"],", "1211");
    jsurvey_check_lists("\"train_filenames\": [\"images/d.png\", \"images/a.png\"], "
                        "\"test_filenames\": [\"images/c.png\"], \"val_filenames\": [\"images/b.png\"],",
                        "1.21");
    jsurvey_check_lists("\"train_filenames\": [\"images/a.png\", \"images/b.png\"], "
                        "\"val_filenames\": [\"images/b.png\", \"images/c.png\"],",
                        "122.");
}
