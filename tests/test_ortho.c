/* test_ortho.c - what is rendered from above, along a path or measured in images lies where it says. */
#include "test.h"
#include "../cli/control.c"
#include "../cli/flight.c"
#include "../cli/frame.c"
#include "../cli/geotiff.c"
#include "../cli/scale_bar.c"
#include "../tools/cloud.c"
#include "../tools/compare.c"
#include "../tools/map.c"
#include "../tools/mesh.c"
#include "../tools/similarity.c"
#include "../tools/surface.c"

/* 6 x 5 points over the ground plane, 2 units and 1 unit apart; two cameras 5 above look down, the second
 * turned ahead by an angle. The world's axes have signs. */
static oxl_scene *ortho_test_made(double angle, const double sign[3])
{
    static const double eyes[2][3] = {{3, 2, 5}, {7, 2, 5}};
    oxl_view view[2];
    oxl_image image[2] = {{0}, {0}};
    oxl_point points[30];
    oxl_scene *scene = NULL;
    for (int i = 0; i < 30; i++) points[i] = (oxl_point){{i % 6 * 2., i / 6, 0.01 * (i % 3)}, 1, {9, 9, 9}};
    for (int i = 0; i < 90; i++) points[i / 3].position[i % 3] *= sign[i % 3];
    for (int i = 0; i < 2; i++) {
        view[i] = (oxl_view){.name = i ? "b.png" : "a.png",
                             .camera = {40, 30, 50, 50, 20, 15, {1, 0, 0, 0, -1, 0, 0, 0, -1}, {0}}};
        if (i == 1) {
            double *r = view[i].camera.rotation;
            r[4] = -cos(angle), r[5] = -sin(angle), r[7] = sin(angle), r[8] = -cos(angle);
        }
        for (int k = 0; k < 3; k++)
            for (int j = 0; j < 3; j++) {
                view[i].camera.rotation[3 * k + j] *= sign[j];
                view[i].camera.translation[k] -= view[i].camera.rotation[3 * k + j] * sign[j] * eyes[i][j];
            }
        CHECK_OK(oxl_image_create(test_ctx, 40, 30, &image[i]));
    }
    CHECK_OK(oxl_scene_from_arrays(test_ctx, view, image, 2, points, 30, &scene));
    for (int i = 0; i < 2; i++) oxl_image_free(test_ctx, &image[i]);
    return scene;
}

static oxl_scene *ortho_test_turned(double angle)
{
    return ortho_test_made(angle, (const double[]){1, 1, 1});
}

static oxl_scene *ortho_test_scene(void)
{
    return ortho_test_turned(0);
}

/* Right, up and above must be right-handed, and above is where the cameras are. */
TEST(frame_is_seen_from_the_cameras_and_not_mirrored)
{
    OWNED_SCENE *scene = ortho_test_scene();
    struct frame f;
    double eye[3], cross[3], low[2], high[2];
    frame_choose(scene, FRAME_AUTO, &f);
    frame_eye(&oxl_scene_view(scene, 0)->camera, eye);
    CHECK(f.is_world && frame_along(&f, eye, 2) > 4.9);
    f = (struct frame){.is_world = 0};
    frame_axes(&f, scene);
    CHECK(f.axis[0][0] > 0.99 && fabs(f.axis[1][1]) > 0.99); /* the widest first */
    frame_choose(scene, FRAME_AUTO, &f);
    frame_cross(f.axis[0], f.axis[1], cross);
    for (int k = 0; k < 3; k++) CHECK_CLOSE(cross[k], f.axis[2][k], 1e-12);
    CHECK(frame_bounds(&f, scene, low, high));
    CHECK_CLOSE(high[0] - low[0], 10, 1e-9);
    CHECK_CLOSE(high[1] - low[1], 4, 1e-9);
}

/* An eigenvector has two directions: right is the one whose largest element is positive, whichever way the
 * survey is turned. */
TEST(frame_right_has_a_direction_of_its_own)
{
    int negative = 0;
    for (int turn = 0; turn < 64; turn++) {
        const double a = 0.4 * turn, b = 1.3 * turn;
        OWNED_SCENE *scene = ortho_test_scene();
        oxl_point *point = (oxl_point *)oxl_scene_points(scene);
        struct frame f = {.is_world = 0};
        double least, most;
        for (int i = 0; i < 30; i++) {
            double *p = point[i].position;
            const double x = cos(a) * p[0] - sin(a) * p[1], y = sin(a) * p[0] + cos(a) * p[1], z = p[2];
            p[0] = x;
            p[1] = cos(b) * y - sin(b) * z;
            p[2] = sin(b) * y + cos(b) * z;
        }
        frame_axes(&f, scene);
        least = fmin(f.axis[0][0], fmin(f.axis[0][1], f.axis[0][2]));
        most = fmax(f.axis[0][0], fmax(f.axis[0][1], f.axis[0][2]));
        negative += most < -least;
    }
    CHECK(negative == 0);
}

/* ---------------- maps */

static unsigned char *ortho_test_file(const char *path)
{
    unsigned char *file = (unsigned char *)output_read(test_folder(), path, NULL);
    CHECK(file != NULL);
    return file;
}

static uint32_t ortho_test_integer(const unsigned char *at, int size)
{
    uint32_t value = 0;
    for (int i = 0; i < size; i++) value |= (uint32_t)at[i] << 8 * i;
    return value;
}

static double ortho_test_double(const unsigned char *at)
{
    const uint64_t bits = ortho_test_integer(at, 4) | (uint64_t)ortho_test_integer(at + 4, 4) << 32;
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* The entry of a tag in the directory of a TIFF, or NULL. */
static const unsigned char *ortho_test_tag(const unsigned char *tiff, uint32_t tag)
{
    const unsigned char *directory = tiff + ortho_test_integer(tiff + 4, 4);
    for (uint32_t i = 0; i < ortho_test_integer(directory, 2); i++)
        if (ortho_test_integer(directory + 2 + 12 * i, 2) == tag) return directory + 2 + 12 * i;
    return NULL;
}

static uint32_t ortho_test_value(const unsigned char *tiff, uint32_t tag)
{
    const unsigned char *entry = ortho_test_tag(tiff, tag);
    return entry ? ortho_test_integer(entry + 8, ortho_test_integer(entry + 2, 2) == 3 ? 2 : 4) : 0;
}

/* The value of a GeoKey that has it in the directory; 0: no such key. */
static uint32_t ortho_test_key(const unsigned char *tiff, uint32_t id)
{
    const unsigned char *keys = tiff + ortho_test_value(tiff, 34735);
    for (uint32_t i = 1; i <= ortho_test_integer(keys + 6, 2); i++)
        if (ortho_test_integer(keys + 8 * i, 2) == id) return ortho_test_integer(keys + 8 * i + 6, 2);
    return 0;
}

/* The four bytes of pixel x, y. */
static const unsigned char *ortho_test_at(const unsigned char *tiff, uint32_t x, uint32_t y)
{
    return tiff + ortho_test_value(tiff, 273) + 4 * (y * ortho_test_value(tiff, 256) + x);
}

static float ortho_test_height(const unsigned char *tiff, uint32_t x, uint32_t y)
{
    const uint32_t bits = ortho_test_integer(ortho_test_at(tiff, x, y), 4);
    float value;
    memcpy(&value, &bits, 4);
    return value;
}

/* Tags are in rising order, offsets even, the strip is the whole image and within the file. */
static void ortho_test_is_whole(const unsigned char *t, size_t size)
{
    const uint32_t at = ortho_test_integer(t + 4, 4), tags = ortho_test_integer(t + at, 2);
    CHECK(memcmp(t, "II*", 4) == 0 && at % 2 == 0 && at + 2 + 12 * tags + 4 == size);
    for (uint32_t i = 1; i < tags; i++)
        CHECK(ortho_test_integer(t + at + 2 + 12 * i, 2) > ortho_test_integer(t + at + 2 + 12 * i - 12, 2));
    CHECK(ortho_test_value(t, 279) == 4 * ortho_test_value(t, 256) * ortho_test_value(t, 257));
    CHECK(ortho_test_value(t, 273) + ortho_test_value(t, 279) <= at);
}

TEST(geotiff_has_its_place_its_system_and_every_pixel)
{
    enum { W = 30, H = 26 };
    static float height[W * H];
    const struct geotiff g = {W, H, 1, 0.25, {500000.5, 6700001.25}, 32632, NULL, "words", 0};
    size_t size;
    unsigned char *t;
    for (int i = 0; i < W * H; i++) height[i] = i % 7 == 0 ? NAN : (float)i;
    CHECK_OK(geotiff_write(test_ctx, test_path("h.tif"), &g, height));
    t = (unsigned char *)output_read(test_folder(), "h.tif", &size);
    CHECK(t != NULL);
    if (!t) return;
    ortho_test_is_whole(t, size);
    CHECK(ortho_test_value(t, 256) == W && ortho_test_value(t, 257) == H && ortho_test_value(t, 258) == 32);
    CHECK_CLOSE(ortho_test_double(t + ortho_test_value(t, 33550)), 0.25, 0);
    CHECK_CLOSE(ortho_test_double(t + ortho_test_value(t, 33922) + 24), 500000.5, 0);
    CHECK_CLOSE(ortho_test_double(t + ortho_test_value(t, 33922) + 32), 6700001.25, 0);
    CHECK(ortho_test_key(t, 1024) == 1 && ortho_test_key(t, 3072) == 32632 && ortho_test_key(t, 1025) == 1);
    CHECK(memcmp(ortho_test_tag(t, 42113) + 8, "nan", 4) == 0);
    for (int i = 0; i < W * H; i++) {
        const float value = ortho_test_height(t, (uint32_t)(i % W), (uint32_t)(i / W));
        CHECK(i % 7 == 0 ? isnan(value) : value == height[i]);
    }
    free(t);
}

/* A transverse Mercator around a reference; metres, and not even that, without a system. */
TEST(geotiff_names_what_its_coordinates_are)
{
    const double reference[2] = {47.5, -8.25};
    const unsigned char rgba[16] = {1, 2, 3, 255};
    for (int k = 0; k < 3; k++) {
        const struct geotiff g = {2, 2, 0, 1, {0, 0}, 0, k == 0 ? reference : NULL, "some words", k == 1};
        size_t size;
        unsigned char *t;
        CHECK_OK(geotiff_write(test_ctx, test_path("o.tif"), &g, rgba));
        t = (unsigned char *)output_read(test_folder(), "o.tif", &size);
        CHECK(t != NULL);
        if (!t) return;
        ortho_test_is_whole(t, size);
        CHECK(ortho_test_key(t, 1024) == (k == 0) && ortho_test_key(t, 3076) == (k < 2 ? 9001 : 0));
        CHECK(ortho_test_key(t, 3075) == (k == 0) && ortho_test_key(t, 2048) == (k == 0 ? 4326 : 0));
        CHECK(!ortho_test_tag(t, 34736) == (k > 0));
        if (k == 0) CHECK_CLOSE(ortho_test_double(t + ortho_test_value(t, 34736)), -8.25, 0);
        if (k == 0) CHECK_CLOSE(ortho_test_double(t + ortho_test_value(t, 34736) + 8), 47.5, 0);
        CHECK(ortho_test_value(t, 338) == 2 && memcmp(ortho_test_at(t, 0, 0), rgba, 4) == 0);
        CHECK(memcmp(t + ortho_test_value(t, 34737), "some words|", 12) == 0);
        free(t);
    }
}

/* One Gaussian of that size at p, in the scene's coordinates with its origin; SH of its red. */
static void ortho_test_gaussian(const oxl_scene *scene, oxl_model *model, size_t i, const double p[3],
                                const float size[3], float red)
{
    for (int k = 0; k < 3; k++) {
        model->plane[OXL_MEAN + k][i] = (float)(p[k] - oxl_scene_origin(scene)[k]);
        model->plane[OXL_LOG_SCALE + k][i] = logf(size[k]);
    }
    model->plane[OXL_SH][i] = red;
    model->plane[OXL_OPACITY][i] = 6;
}

/* Of a map of the scene above, with a Gaussian at p: alpha and height at its place, which the map's own place
 * says. far: the world's origin is that far off. */
static void ortho_test_pixel(const double p[3], int min_views, const double far[3], int *alpha, float *height,
                             int *red)
{
    OWNED_SCENE *scene = ortho_test_scene();
    OWNED_MODEL model = {0};
    struct arguments a = {.out = test_path("map"), .pixel = 0.05, .min_views = min_views};
    FILE *to = fopen(test_path("said"), "wb");
    unsigned char *t, *h;
    const double ground[3] = {p[0], p[1], fmin(p[2], 0)};
    CHECK_OK(oxl_model_create(test_ctx, 2, 0, &model));
    ortho_test_gaussian(scene, &model, 0, ground, (float[]){1, 1, 0.01f}, 0);
    ortho_test_gaussian(scene, &model, 1, p, (float[]){0.1f, 0.1f, 0.1f}, 1.7f);
    /* every fifth point is at the speck's height, so that they do not contradict it */
    for (int i = 0; i < 30; i += 5)
        scene->point[i].position[2] = (p[2] < 5 ? p[2] : 0) - oxl_scene_origin(scene)[2];
    for (int k = 0; k < 3; k++) scene->origin[k] += far[k];
    CHECK_OK(map_write(test_ctx, &model, scene, &a, to));
    t = ortho_test_file("map/ortho.tif");
    h = ortho_test_file("map/height.tif");
    if (t && h) {
        const unsigned char *tie = t + ortho_test_value(t, 33922);
        const uint32_t x = (uint32_t)((p[0] + far[0] - ortho_test_double(tie + 24)) / 0.05),
                       y = (uint32_t)((ortho_test_double(tie + 32) - p[1] - far[1]) / 0.05);
        *height = ortho_test_height(h, x, y) - (float)far[2];
        *alpha = ortho_test_at(t, x, y)[3], *red = ortho_test_at(t, x, y)[0];
    }
    a.pixel = 1e-9;
    CHECK(map_write(test_ctx, &model, scene, &a, to) == OXL_ERR_USAGE);
    fclose(to);
    free(h);
    free(t);
}

TEST(ortho_places_a_speck_where_its_tiff_says_and_does_not_see_what_floats_above_the_cameras)
{
    static const double far[2][3] = {{0, 0, 0}, {100, -50, 7}};
    for (int i = 0; i < 4; i++) {
        int alpha = 0, red = 0;
        float height = 0;
        ortho_test_pixel((double[]){3.12, 2.02, i % 2 ? 3.5 : 5.5}, 1, far[i / 2], &alpha, &height, &red);
        CHECK(alpha == 255 && (red > 200) == (i % 2));
        CHECK_CLOSE(height, i % 2 ? 3.5 : 0, 0.02);
    }
}

/* At x = 2 only the camera at 3 has the place in its image, which is 4 wide; at 5, and a unit deeper,
 * both have. */
TEST(ortho_is_transparent_where_too_few_views_saw_the_ground)
{
    static const double place[3][3] = {{2.02, 2.02, 0.02}, {2.02, 2.02, 0.02}, {5.02, 2.02, -1}};
    for (int i = 0; i < 3; i++) {
        int alpha = 0, red = 0;
        float height = 0;
        ortho_test_pixel(place[i], i == 1 ? 1 : 2, (double[]){0, 0, 0}, &alpha, &height, &red);
        CHECK(alpha == (i ? 255 : 0) && isnan(height) == !i);
    }
}

/* What the cameras at x = 3 and 7 say of a place that both have in their images. usual: distance; 0: that of the
 * model. Without points, nothing is contradicted. */
static const double ortho_test_place[3] = {5.05, 2.05, -1};

static void ortho_test_ask(oxl_scene *scene, const oxl_model *model, double usual, int sees, int confirms,
                           int passes)
{
    struct surface s;
    const int list[2] = {0, 1};
    double p[3];
    struct surface_vote vote;
    CHECK_OK(surface_open(test_ctx, model, scene, 1000, &s));
    for (int k = 0; k < 3; k++) p[k] = ortho_test_place[k] - oxl_scene_origin(scene)[k];
    if (usual > 0) s.distance = usual;
    vote = surface_ask(&s, list, 2, p);
    surface_close(&s);
    CHECK(vote.sees == sees && vote.confirms == confirms && vote.passes == passes);
}

/* A speck halfway hides the place from the first camera; images that have no depth there do not confirm it. */
TEST(surface_is_not_seen_through_what_is_before_it_nor_from_far_away)
{
    OWNED_SCENE *scene = ortho_test_scene();
    OWNED_MODEL model = {0};
    double half[3];
    scene->point_count = 0;
    CHECK_OK(oxl_model_create(test_ctx, 1, 0, &model));
    for (int k = 0; k < 3; k++) half[k] = (ortho_test_place[k] + (double[]){3, 2, 5}[k]) / 2;
    ortho_test_gaussian(scene, &model, 0, half, (float[]){0.1f, 0.1f, 0.1f}, 0);
    ortho_test_ask(scene, &model, 100, 1, 0, 0);
    model.plane[OXL_MEAN + 2][0] -= 2.9f; /* within a twentieth of the place's depth: a slope, not a wall */
    model.plane[OXL_MEAN][0] += 1, model.plane[OXL_MEAN + 1][0] += 0.02f;
    ortho_test_ask(scene, &model, 100, 2, 2, 0);
    ortho_test_ask(scene, &model, 5.9 / SURFACE_FAR, 0, 0, 0);
}

/* At the place; two units below it, which clear views pass; nowhere. */
TEST(surface_is_confirmed_by_images_of_that_depth_and_passed_by_deeper_ones)
{
    OWNED_SCENE *scene = ortho_test_scene();
    OWNED_MODEL model = {0};
    scene->point_count = 0;
    CHECK_OK(oxl_model_create(test_ctx, 1, 0, &model));
    for (int behind = 0; behind < 3; behind++) {
        const double at[3] = {ortho_test_place[0], ortho_test_place[1], ortho_test_place[2] - 2 * behind};
        ortho_test_gaussian(scene, &model, 0, at, (float[]){3, 3, 0.01f}, 0);
        if (behind == 2) model.plane[OXL_OPACITY][0] = -20;
        ortho_test_ask(scene, &model, 100, 2, behind ? 0 : 2, behind == 1 ? 2 : 0);
    }
}

/* Ground without detail, as haze is, has no depth that images confirm; with specks on it, it has. */
TEST(surface_wants_detail_in_the_images_that_confirm_it)
{
    const double above[3] = {ortho_test_place[0], ortho_test_place[1], ortho_test_place[2] + 0.05};
    OWNED_SCENE *scene = ortho_test_scene();
    OWNED_MODEL model = {0};
    scene->point_count = 0;
    CHECK_OK(oxl_model_create(test_ctx, 2, 0, &model));
    ortho_test_gaussian(scene, &model, 0, ortho_test_place, (float[]){30, 30, 0.01f}, 0);
    ortho_test_gaussian(scene, &model, 1, above, (float[]){0.1f, 0.1f, 0.01f}, 0.2f);
    ortho_test_ask(scene, &model, 0, 2, 2, 0);
    model.plane[OXL_OPACITY][1] = -20;
    ortho_test_ask(scene, &model, 0, 2, 0, 0);
}

/* A slab a unit under the survey's points, which all views show, is not confirmed; among points at its depth it
 * is. */
TEST(surface_that_the_surveys_points_contradict_is_not_confirmed)
{
    for (int deep = 0; deep < 2; deep++) {
        OWNED_SCENE *scene = ortho_test_scene();
        OWNED_MODEL model = {0};
        CHECK_OK(oxl_model_create(test_ctx, 1, 0, &model));
        for (int i = 0; i < 30; i++)
            for (int k = 0; k < 3; k++)
                scene->point[i].position[k] = (k == 0   ? 4.6 + 0.16 * (i % 6)
                                               : k == 1 ? 1.5 + 0.2 * (i / 6)
                                                        : deep * ortho_test_place[2]) -
                                              oxl_scene_origin(scene)[k];
        ortho_test_gaussian(scene, &model, 0, ortho_test_place, (float[]){3, 3, 0.01f}, 0);
        ortho_test_ask(scene, &model, 100, 2, deep ? 2 : 0, deep ? 0 : 2);
    }
}

/* In the image of the camera at x = 3; above both cameras; in the image of the one at 7 alone, which is held out;
 * behind the cameras' images; black, before nothing, in the first's. */
TEST(unseen_gaussians_are_removed_and_no_training_view_changes)
{
    static const double place[5][3] = {{3, 2, 0}, {3, 2, 6}, {8, 2, 0}, {20, 2, 0}, {2, 2, 0}};
    OWNED_SCENE *scene = ortho_test_scene();
    const double *origin = oxl_scene_origin(scene);
    OWNED_MODEL model = {0};
    OWNED_IMAGE before = {0}, after = {0};
    size_t dropped = 0;
    CHECK_OK(oxl_model_create(test_ctx, 5, 0, &model));
    for (int i = 0; i < 5; i++)
        for (int k = 0; k < 3; k++) {
            model.plane[OXL_MEAN + k][i] = (float)(place[i][k] - origin[k]);
            model.plane[OXL_LOG_SCALE + k][i] = logf(0.1f);
            model.plane[OXL_SH + k][i] = i == 4 ? -9 : (float)i;
        }
    for (int v = 0; v < 2; v++) scene->view[v].is_test = v;
    CHECK_OK(oxl_render(test_ctx, &model, &oxl_scene_view(scene, 0)->camera, NULL, &before, NULL));
    CHECK_OK(unseen_drop(test_ctx, scene, &model, &dropped));
    CHECK(dropped == 3 && model.count == 2);
    CHECK(model.plane[OXL_SH][0] == 0 && model.plane[OXL_SH][1] == -9);
    CHECK_OK(oxl_render(test_ctx, &model, &oxl_scene_view(scene, 0)->camera, NULL, &after, NULL));
    CHECK(memcmp(before.rgb, after.rgb, 3 * 40 * 30 * sizeof(float)) == 0);
}

/* Places are asked of the views in the list alone: it must have all that see one in the sphere. */
TEST(surface_lists_every_view_that_has_a_place_of_the_sphere_in_its_image)
{
    OWNED_SCENE *scene = ortho_test_turned(0.6);
    OWNED_MODEL model = {0};
    struct surface s;
    int any = 0, spared = 0;
    CHECK_OK(oxl_model_create(test_ctx, 1, 0, &model));
    CHECK_OK(surface_open(test_ctx, &model, scene, 1000, &s));
    for (int i = 0; i < 2000; i++) {
        const double centre[3] = {i % 41 - 20, i % 37 - 18, i % 7 - 3},
                     p[3] = {centre[0] + 0.6, centre[1] - 0.5, centre[2] + 0.6};
        int list[2], n = surface_list(&s, centre, 1, list);
        spared += 2 - n;
        for (int v = 0; v < 2; v++) {
            const int sees = map_is_seen(&s.view[v].camera, p, 0);
            any += sees;
            CHECK(!sees || (n > 0 && list[0] == v) || (n > 1 && list[1] == v));
        }
    }
    CHECK(any > 40 && spared > 1000);
    surface_close(&s);
}

/* The outermost points of a survey far from its world's origin lie in the outermost pixels. */
TEST(ortho_has_its_corners_within_a_pixel_of_the_surveys_points)
{
    OWNED_SCENE *scene = ortho_test_scene();
    OWNED_MODEL model = {0};
    struct arguments a = {.out = test_path("map"), .pixel = 0.03, .min_views = 1};
    FILE *to = fopen(test_path("said"), "wb");
    const double low[2] = {500000, 6700000}, high[2] = {500010, 6700004};
    unsigned char *t;
    CHECK_OK(oxl_model_create(test_ctx, 1, 0, &model));
    ortho_test_gaussian(scene, &model, 0, (double[]){3, 2, 0}, (float[]){1, 1, 1}, 0);
    for (int k = 0; k < 3; k++) scene->origin[k] += (double[3]){500000, 6700000, -20}[k];
    CHECK_OK(map_write(test_ctx, &model, scene, &a, to));
    fclose(to);
    t = ortho_test_file("map/height.tif");
    if (t) {
        const unsigned char *tie = t + ortho_test_value(t, 33922);
        const double pixel = ortho_test_double(t + ortho_test_value(t, 33550)),
                     left = ortho_test_double(tie + 24), top = ortho_test_double(tie + 32);
        const double right = left + pixel * ortho_test_value(t, 256),
                     bottom = top - pixel * ortho_test_value(t, 257);
        CHECK(pixel == 0.03);
        CHECK(left <= low[0] && left > low[0] - pixel && right >= high[0] && right < high[0] + pixel);
        CHECK(bottom <= low[1] && bottom > low[1] - pixel && top >= high[1] && top < high[1] + pixel);
    }
    free(t);
}

/* A wall of specks on flat ground 9 below the cameras at x = 3 and 7, whose images are 7.2 wide there: of the map,
 * 10 x 4, both have the middle 3.2 x 4. */
static void ortho_test_ground(oxl_scene *scene, oxl_model *model)
{
    for (int i = 0; i < 30; i++)
        scene->point[i].position[2] = -4 + 0.01 * (i % 3) - oxl_scene_origin(scene)[2];
    CHECK_OK(oxl_model_create(test_ctx, 201, 0, model));
    ortho_test_gaussian(scene, model, 0, (double[]){5, 2, -4}, (float[]){10, 10, 0.01f}, 0);
    for (int i = 0; i < 200; i++)
        ortho_test_gaussian(scene, model, (size_t)i + 1,
                            (double[]){i % 20 * 0.7 - 1, i / 20 * 0.7 - 1, -3.96},
                            (float[]){0.2f, 0.2f, 0.01f}, 1);
}

TEST(map_measures_the_ground_that_two_views_share_and_its_certainty)
{
    OWNED_SCENE *scene = ortho_test_scene();
    struct map m = {.ctx = test_ctx, .scene = scene, .enough = 2};
    OWNED_MODEL model = {0};
    size_t middle;
    ortho_test_ground(scene, &model);
    CHECK_OK(map_make(&m, &model, FRAME_AUTO, 100));
    CHECK_CLOSE(m.sampling, 0.18, 0.001); /* 9 to the model's ground, by 50 px */
    CHECK_CLOSE(m.area, 12.8, 0.7);
    CHECK_CLOSE(m.covered, 0.32, 0.02);
    CHECK_CLOSE(m.high, 0.32, 0.03);
    CHECK_CLOSE(m.error, 0.03, 0.03);
    CHECK(m.gross == 0 && m.error_90 < 0.1 && m.down > 0.999);
    CHECK_CLOSE(m.distance, 9, 0.03);
    CHECK(m.width <= 101 && m.height <= 41);
    middle = (size_t)(m.height / 2 * m.width + m.width / 2);
    CHECK(m.views[middle] == 2 && m.sigma[middle] > 0.005f && m.sigma[middle] < 0.3f);
    CHECK(m.views[0] == 0 && isnan(m.sigma[0]) && isnan(m.level[0]));
    map_free(&m);
}

/* Cameras that look at a wall, north and level, on the world's map. */
TEST(map_knows_that_its_cameras_do_not_look_down)
{
    static const double level[9] = {1, 0, 0, 0, 0, -1, 0, 1, 0};
    OWNED_SCENE *scene = ortho_test_scene();
    struct map m = {.ctx = test_ctx, .scene = scene, .enough = 2};
    OWNED_MODEL model = {0};
    ortho_test_ground(scene, &model);
    for (int v = 0; v < 2; v++) memcpy(scene->view[v].camera.rotation, level, sizeof level);
    map_make(&m, &model, FRAME_WORLD_AXES, 50);
    map_free(&m);
    CHECK_CLOSE(m.down, 0, 1e-9);
}

/* A hole of two pixels gets the mean of what is around; one at the border, and a large one, stay. */
TEST(map_fills_pinholes_alone)
{
    enum { W = 12, H = 9 };
    unsigned char rgba[4 * W * H];
    struct map m = {.width = W, .height = H, .rgba = rgba};
    memset(rgba, 255, sizeof rgba);
    for (int i = 0; i < W * H; i++) rgba[4 * i] = (unsigned char)(i % W < 3 ? 100 : 200);
    for (int i = 0; i < 20; i++) memset(rgba + 4 * ((2 + i / 5) * W + 5 + i % 5), 0, 4);
    memset(rgba + 4 * (3 * W + 2), 0, 8), memset(rgba, 0, 4);
    map_fill(&m);
    CHECK(m.filled == 2 && rgba[3] == 0 && rgba[4 * (3 * W + 6) + 3] == 0 &&
          rgba[4 * (3 * W + 2) + 3] == 255);
    CHECK(rgba[4 * (3 * W + 2)] == 150 && rgba[4 * (3 * W + 3)] == 150 && rgba[4 * (3 * W + 2) + 1] == 255);
}

/* A LAS 1.4 file of the ground above: its header, the CRS by the keys of GeoTIFF, and points on the ground with
 * normals up. */
TEST(cloud_in_las_has_its_crs_its_scale_and_points_on_the_ground)
{
    OWNED_SCENE *scene = ortho_test_scene();
    OWNED_MODEL model = {0};
    struct arguments a = {.command = COMMAND_CLOUD, .min_views = 2, .epsg = 32632};
    FILE *to = fopen(test_path("said"), "wb");
    char path[512];
    size_t size;
    unsigned char *t;
    snprintf(path, sizeof path, "%s", test_path("c.las"));
    a.out = path;
    ortho_test_ground(scene, &model);
    for (int k = 0; k < 3; k++) scene->origin[k] += (double[3]){500000, 6700000, -20}[k];
    CHECK_OK(cloud_write(test_ctx, &model, scene, &a, to));
    fclose(to);
    t = (unsigned char *)output_read(test_folder(), "c.las", &size);
    CHECK(t != NULL);
    const uint32_t first = ortho_test_integer(t + 96, 4), count = ortho_test_integer(t + 247, 4);
    CHECK(memcmp(t, "LASF", 4) == 0 && t[24] == 1 && t[25] == 4 && t[104] == 2 &&
          ortho_test_integer(t + 94, 2) == 375);
    CHECK(size == first + 38 * (size_t)count && count == ortho_test_integer(t + 107, 4) && count > 300);
    CHECK(ortho_test_integer(t + 375 + 18, 2) == 34735); /* the first record: keys by rising id */
    int epsg = 0;
    for (const unsigned char *key = t + 375 + 54 + 8;
         key < t + 375 + 54 + ortho_test_integer(t + 375 + 20, 2); key += 8)
        if (ortho_test_integer(key, 2) == 3072) epsg = (int)ortho_test_integer(key + 6, 2);
    CHECK(epsg == 32632);
    for (uint32_t i = 0; i < count; i++) {
        const unsigned char *p = t + first + 38 * (size_t)i;
        double x[3];
        for (int k = 0; k < 3; k++)
            x[k] = (int32_t)ortho_test_integer(p + 4 * k, 4) * ortho_test_double(t + 131 + 8 * k) +
                   ortho_test_double(t + 155 + 8 * k);
        CHECK(x[0] > 500003 && x[0] < 500007 && x[1] > 6699998 && x[1] < 6700006 && fabs(x[2] + 24) < 0.1 &&
              p[17] == 2);
        uint32_t bits = ortho_test_integer(p + 34, 4);
        float up;
        memcpy(&up, &bits, 4);
        CHECK(up > 0.9f);
    }
    free(t);
}

/* Turns by any angle, half a turn too, with scale and without. */
TEST(similarity_of_pairs_is_the_one_that_made_them)
{
    for (int turn = 0; turn < 9; turn++) {
        const double a = turn * 0.7853981633974483, scale = turn % 2 ? 1 : 0.3 + turn, t[3] = {5, -70, 2};
        const double r[9] = {cos(a), -sin(a), 0, 0, 0, -1, sin(a), cos(a), 0};
        const struct similarity truth = {
            scale, {r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7], r[8]}, {t[0], t[1], t[2]}};
        double from[20][3], to[20][3], weight[20], p[3];
        struct similarity s;
        for (int i = 0; i < 20; i++) {
            for (int k = 0; k < 3; k++) from[i][k] = (i * (7 + 4 * k)) % 11;
            similarity_apply(&truth, from[i], to[i]);
            weight[i] = i < 18;
        }
        to[19][0] += 100, to[18][2] -= 50; /* without weight */
        CHECK(
            similarity_fit((const double(*)[3])from, (const double(*)[3])to, weight, 20, turn % 2 == 0, &s));
        CHECK_CLOSE(s.scale, scale, 1e-9);
        similarity_apply(&s, from[19], p);
        CHECK_CLOSE(p[0], to[19][0] - 100, 1e-7);
        CHECK_CLOSE(p[2], to[19][2], 1e-7);
    }
}

/* Whatever corners are inside, each cut edge has one edge before it and one behind it, none else has any, and the line
 * on a face is the one that the neighbouring cell has there, backwards. */
TEST(mesh_lines_of_every_cell_are_closed_loops_that_fit_the_neighbours)
{
    for (unsigned inside = 0; inside < 256; inside++) {
        int next[24], other[24], before[24] = {0};
        mesh_trace(inside, next);
        for (int e = 0; e < 24; e++)
            if (next[e] >= 0) before[next[e]]++;
        for (int e = 0; e < 24; e++) {
            const int low = e % 8, high = low | 1 << e / 8;
            const int is_cut = low != high && (inside >> low & 1) != (inside >> high & 1);
            CHECK((next[e] >= 0) == is_cut && before[e] == is_cut);
        }
        /* the cell mirrored at its face x = 1 has the same corners there: its lines there go the other way */
        unsigned mirrored = 0;
        for (int i = 0; i < 8; i++) mirrored |= (inside >> (i ^ 1) & 1) << i;
        mesh_trace(mirrored, other);
        for (int e = 8; e < 24; e++)
            if (e & 1 && next[e] >= 8 && next[e] & 1) CHECK(other[next[e] ^ 1] == (e ^ 1));
    }
}

/* Triangles on the ground, as large as what two views share, that face the cameras. */
TEST(mesh_of_flat_ground_lies_on_it_and_faces_the_cameras)
{
    OWNED_SCENE *scene = ortho_test_scene();
    OWNED_MODEL model = {0};
    struct surface s;
    struct cloud c;
    ortho_test_ground(scene, &model);
    CHECK_OK(surface_open(test_ctx, &model, scene, 320, &s));
    CHECK_OK(cloud_make(&s, 2, &c));
    struct mesh m = {.s = &s, .enough = 2, .cell = 0.2};
    CHECK(mesh_find_blocks(&m, &c) && mesh_trace_blocks(&m) && mesh_join(&m));
    double area = 0;
    for (size_t i = 0; i < m.triangles; i++) {
        const struct cloud_point *p[3];
        for (int k = 0; k < 3; k++) p[k] = &m.vertex.point[m.index[3 * i + (size_t)k]];
        area += 0.5 * ((p[1]->place[0] - p[0]->place[0]) * (p[2]->place[1] - p[0]->place[1]) -
                       (p[1]->place[1] - p[0]->place[1]) * (p[2]->place[0] - p[0]->place[0]));
        CHECK_CLOSE(p[0]->place[2], -4 - oxl_scene_origin(scene)[2], 0.15);
        CHECK(p[0]->normal[2] > 0.8f);
    }
    CHECK(area > 10 && area < 20 && m.triangles > MESH_SMALL);
    mesh_free(&m);
    cloud_free(&c);
    surface_close(&s);
}

/* A hill of 30 x 30 cells is a change, with its volume; one of 8 x 8, and a difference within the level of detection,
 * are none. */
TEST(compare_finds_what_is_larger_than_noise_and_its_volume)
{
    enum { SIDE = 80 };
    static float difference[SIDE * SIDE], level[SIDE * SIDE];
    static signed char sign[SIDE * SIDE];
    struct compare c = {.ctx = test_ctx, .difference = difference, .level = level, .sign = sign};
    struct compare_sum whole, *place = calloc(COMPARE_PLACES + 1, sizeof *place);
    int places;
    c.map[0] = (struct map){.width = SIDE, .height = SIDE, .pixel = 0.5, .corner = {10, 20}};
    for (int i = 0; i < SIDE * SIDE; i++) {
        const int x = i % SIDE, y = i / SIDE;
        level[i] = 0.1f, sign[i] = 0;
        difference[i] = x >= 10 && x < 40 && y >= 20 && y < 50   ? 0.4f
                        : x >= 60 && x < 68 && y < 30 && y >= 22 ? -0.4f
                        : x < 60                                 ? 0.05f
                                                                 : NAN;
    }
    compare_judge(&c);
    CHECK_OK(compare_list(&c, &whole, place, &places));
    CHECK(places == 1 && place[0].sign == 1 && whole.lowered == 0);
    CHECK_CLOSE(place[0].net, 900 * 0.25 * 0.4,
                3); /* without its corners, which most cells around do not share */
    CHECK_CLOSE(place[0].place[0], 10 + 25 * 0.5, 0.1);
    CHECK_CLOSE(place[0].place[1], 20 - 35 * 0.5, 0.1);
    CHECK_CLOSE(whole.raised, place[0].net, 1e-9);
    CHECK(compare_is_inside("0,0;4,0;4,4;0,4", 1, 3) && !compare_is_inside("0,0;4,0;4,4;0,4", 5, 3) &&
          compare_is_inside(NULL, 9, 9));
    CHECK(compare_is_polygon("0,0;4,0;4,3") && !compare_is_polygon("0,0;4,0") &&
          !compare_is_polygon("0,0;4;0,4,3,3"));
    free(place);
}

/* Ground that falls by 25 degrees below cameras that look straight down. */
TEST(frame_of_a_georeferenced_slope_is_the_world)
{
    OWNED_SCENE *scene = ortho_test_scene();
    oxl_point *point = (oxl_point *)oxl_scene_points(scene);
    struct frame f;
    for (int i = 0; i < 30; i++) point[i].position[2] += tan(0.436) * point[i].position[0];
    frame_choose(scene, FRAME_AUTO, &f);
    CHECK(f.is_world);
    frame_choose(scene, FRAME_SURVEY_AXES, &f);
    CHECK(!f.is_world && f.axis[2][2] < 0.93);
}

TEST(frame_is_not_the_world_where_its_z_is_down)
{
    for (int down = 0; down < 2; down++) {
        OWNED_SCENE *scene = ortho_test_made(0, (const double[]){1, down ? -1 : 1, down ? -1 : 1});
        struct frame f;
        for (int k = 0; k < 3; k++) scene->origin[k] += 1e5;
        frame_choose(scene, FRAME_AUTO, &f);
        CHECK(f.is_world == !down);
        CHECK(down ? f.axis[2][2] < -0.99 : f.axis[2][2] > 0.99);
    }
}

TEST(flight_along_the_survey_begins_and_ends_at_its_cameras)
{
    OWNED_SCENE *scene = ortho_test_turned(0.5);
    for (int end = 0; end < 2; end++) {
        oxl_camera c = oxl_scene_view(scene, 0)->camera;
        const oxl_camera *wanted = &oxl_scene_view(scene, end)->camera;
        flight_survey(scene, end, &c);
        for (int k = 0; k < 9; k++) CHECK_CLOSE(c.rotation[k], wanted->rotation[k], 1e-12);
        for (int k = 0; k < 3; k++) CHECK_CLOSE(c.translation[k], wanted->translation[k], 1e-9);
    }
}

/* A quarter of the way in time: Catmull-Rom's place with its ends doubled, (t + 3 t^2 - 2 t^3) / 2, and a
 * view eased by t^2 (3 - 2 t). */
TEST(flight_between_cameras_accelerates_smoothly_and_interpolates_rotation)
{
    const double angle = 0.5, t = 0.25, ease = 0.15625, way = 0.203125;
    OWNED_SCENE *scene = ortho_test_turned(angle);
    oxl_camera c = oxl_scene_view(scene, 0)->camera;
    double a[3], b[3], eye[3] = {0, 0, 0};
    flight_survey(scene, t, &c);
    for (int k = 0; k < 3; k++)
        for (int j = 0; j < 3; j++) eye[k] -= c.rotation[3 * j + k] * c.translation[j];
    frame_eye(&oxl_scene_view(scene, 0)->camera, a);
    frame_eye(&oxl_scene_view(scene, 1)->camera, b);
    for (int k = 0; k < 3; k++) CHECK_CLOSE(eye[k], a[k] + way * (b[k] - a[k]), 1e-9);
    CHECK_CLOSE(atan2(c.rotation[7], -c.rotation[8]), atan2(ease * sin(angle), 1 - ease + ease * cos(angle)),
                1e-12);
}

TEST(flight_around_the_centre_faces_it_upright)
{
    OWNED_SCENE *scene = ortho_test_scene();
    struct frame f;
    frame_choose(scene, FRAME_AUTO, &f);
    for (int i = 0; i < 7; i++) {
        oxl_camera c = oxl_scene_view(scene, 0)->camera;
        double p[3], cross[3];
        CHECK(flight_orbit(scene, i / 7., &c));
        for (int k = 0; k < 3; k++)
            p[k] = c.rotation[3 * k] * f.centre[0] + c.rotation[3 * k + 1] * f.centre[1] +
                   c.rotation[3 * k + 2] * f.centre[2] + c.translation[k];
        CHECK_CLOSE(p[0], 0, 1e-9);
        CHECK_CLOSE(p[1], 0, 1e-9);
        CHECK(p[2] > 1 && c.rotation[5] < 0);
        frame_cross(c.rotation, c.rotation + 3, cross);
        for (int k = 0; k < 3; k++) CHECK_CLOSE(cross[k], c.rotation[6 + k], 1e-12);
    }
}

/* Pixels of a place in a.png and b.png of the scene above. */
static void ortho_test_pixels(const oxl_scene *scene, const double place[3], char out[200])
{
    size_t used = 0;
    for (int i = 0; i < 2; i++) {
        const oxl_camera *c = &oxl_scene_view(scene, i)->camera;
        double p[3];
        for (int k = 0; k < 3; k++) {
            p[k] = c->translation[k];
            for (int j = 0; j < 3; j++)
                p[k] += c->rotation[3 * k + j] * (place[j] - oxl_scene_origin(scene)[j]);
        }
        used +=
            (size_t)snprintf(out + used, 200 - used, "%s%s,%.9f,%.9f", i ? "," : "", i ? "b.png" : "a.png",
                             c->fx * p[0] / p[2] + c->cx, c->fy * p[1] / p[2] + c->cy);
    }
}

TEST(scale_bar_has_its_true_length)
{
    OWNED_SCENE *scene = ortho_test_scene();
    const double end[2][3] = {{5, 2, 0}, {5, 2.5, 0}}; /* half a unit apart, at the rims of both */
    char pixels[2][200], bar[420];
    FILE *to = fopen(test_path("said"), "wb+");
    char *text;
    for (int i = 0; i < 2; i++) ortho_test_pixels(scene, end[i], pixels[i]);
    snprintf(bar, sizeof bar, "%s:%s", pixels[0], pixels[1]);
    CHECK_OK(scale_measure(test_ctx, scene, bar, 0.25, to));
    CHECK_OK(scale_measure(test_ctx, scene, "5,2,0:5,2.5,0", 1.5, to));
    fclose(to);
    text = output_read(test_folder(), "said", NULL);
    CHECK_TEXT(text ? text : "", "end 2     5.000000 2.500000");
    CHECK_TEXT(text ? text : "", "scale     0.5");
    CHECK_TEXT(text ? text : "", "scale     3 metres");
    free(text);
    CHECK_ERROR(scale_measure(test_ctx, scene, "a.png,1,2:b.png,1,2", 1, stderr), OXL_ERR_USAGE,
                "visible in two images");
    CHECK_ERROR(scale_measure(test_ctx, scene, "c.png,1,2,a.png,1,2:b.png,1,2", 1, stderr), OXL_ERR_USAGE,
                "no image is called 'c.png'");
}

/* Two bars of 1 and 2 units, said to be of 0.5 and 1.1 m: the scale of the least squares leaves both something. */
TEST(scale_of_several_bars_is_their_least_squares)
{
    OWNED_SCENE *scene = ortho_test_scene();
    FILE *to = fopen(test_path("said"), "wb+");
    char *text;
    CHECK_OK(scale_measure(test_ctx, scene, "1,2,0:2,2,0=0.5;1,2,0:3,2,0=1.1", 0, to));
    CHECK_OK(scale_measure(test_ctx, scene, "0,0,0:94,0,0", 0, to));
    fclose(to);
    text = output_read(test_folder(), "said", NULL);
    CHECK_TEXT(text ? text : "", "scale     0.54 metres");
    CHECK_TEXT(text ? text : "", "bar 1     0.5 m, measured 0.54 m, residual -0.04 m: warning");
    CHECK_TEXT(text ? text : "", "bar 2     1.1 m, measured 1.08 m, residual 0.02 m\n");
    CHECK_TEXT(text ? text : "", "warning   the survey is only");
    free(text);
    CHECK(scale_measure(test_ctx, scene, "1,2,0:2,2,0=x", 0, stderr) == OXL_ERR_USAGE);
}

/* Rays that miss each other by a tenth of the cameras' distance, at the ends of a bar that is so long that
 * this is a small part of it. */
TEST(scale_bar_refuses_rays_that_miss_by_the_cameras_distance)
{
    OWNED_SCENE *scene = ortho_test_scene();
    const double true_end[3] = {5, 2, 0};
    char pixels[200], bar[420];
    double x[2], y[2];
    ortho_test_pixels(scene, true_end, pixels);
    CHECK(sscanf(pixels, "a.png,%lf,%lf,b.png,%lf,%lf", &x[0], &y[0], &x[1], &y[1]) == 4);
    snprintf(bar, sizeof bar, "a.png,%.6f,%.6f,b.png,%.6f,%.6f:900,2,0", x[0], y[0] - 5, x[1], y[1] + 5);
    CHECK_ERROR(scale_measure(test_ctx, scene, bar, 1, stderr), OXL_ERR_INPUT,
                "of the camera's distance of 5");
}

/* A point 2 cm beside where the cameras see it, another 1 cm above; the world's origin is far. */
TEST(control_points_have_their_residuals)
{
    OWNED_SCENE *scene = ortho_test_scene();
    FILE *to = fopen(test_path("said"), "wb+");
    char pixels[200], line[600], *text;
    size_t used = (size_t)snprintf(line, sizeof line, "name,x,y,z,image,x,y\n# a comment\n");
    for (int k = 0; k < 3; k++) scene->origin[k] += (double[3]){500000, 6700000, 7}[k];
    for (int i = 0; i < 2; i++) {
        const double at[3] = {500005, 6700002 + 0.3 * i, 7};
        ortho_test_pixels(scene, at, pixels);
        used += (size_t)snprintf(line + used, sizeof line - used, "p%d,%.3f,%.3f,%.3f,%s\n", i,
                                 at[0] - 0.02 * (i == 0), at[1], at[2] - 0.01 * (i == 1), pixels);
    }
    test_write("control.csv", line);
    CHECK_OK(control_check(test_ctx, scene, test_path("control.csv"), to));
    fclose(to);
    text = output_read(test_folder(), "said", NULL);
    CHECK_TEXT(text ? text : "", "p0                   0.0200     0.0000     0.0000     0.0200");
    CHECK_TEXT(text ? text : "", "p1                   0.0000     0.0000     0.0100     0.0100");
    CHECK_TEXT(text ? text : "", "0.0141     0.0000     0.0071     0.0158  rms of 2");
    free(text);
    test_write("control.csv", "p,1,2,3,5,2,0\nq,1,2\n");
    CHECK_ERROR(control_check(test_ctx, scene, test_path("control.csv"), stderr), OXL_ERR_INPUT,
                "control.csv:2: found 'q,1,2'");
}

TEST(scale_of_a_model_moves_means_scales_and_origin)
{
    OWNED_MODEL model = {0};
    CHECK_OK(oxl_model_create(test_ctx, 1, 0, &model));
    model.plane[OXL_MEAN][0] = 3, model.plane[OXL_LOG_SCALE][0] = 1, model.origin[2] = 5;
    oxl_model_rescale(&model, 2);
    CHECK_CLOSE(model.plane[OXL_MEAN][0], 6, 1e-6);
    CHECK_CLOSE(model.plane[OXL_LOG_SCALE][0], 1 + log(2), 1e-6);
    CHECK_CLOSE(model.origin[2], 10, 1e-12);
}

/* Through a fisheye: what camera_distort makes of the ray is the pixel that was asked for. */
TEST(scale_rays_undo_the_distortion)
{
    static const char *const cameras[] = {"1 OPENCV 200 150 120 118 101 74 -0.12 0.03 0.001 -0.002\n",
                                          "1 OPENCV_FISHEYE 200 150 90 90 100 75 0.02 0.01 0 0\n"};
    for (int m = 0; m < 2; m++) {
        oxl_scene_options o = oxl_scene_options_default();
        double start[3], way[3], pixel[2];
        o.read_images = 0;
        test_write("survey/cameras.txt", cameras[m]);
        test_write("survey/images.txt", "1 1 0 0 0 0 0 0 1 a.png\n\n2 1 0 0 0 -1 0 0 1 b.png\n\n");
        test_write("survey/points3D.txt",
                   "1 0 0 5 9 9 9 0.5 1 0 2 0\n2 1 0 5 9 9 9 0.5 1 0 2 0\n3 0 1 6 9 9 9 0.5 1 0 2 0\n");
        OWNED_SCENE *scene = test_load("survey", &o);
        if (!scene) continue;
        for (int i = 0; i < 12; i++) {
            const double x = 20 + 50 * (i % 4), y = 20 + 50 * (i / 4);
            CHECK_OK(oxl_scene_ray(test_ctx, scene, 0, x, y, start, way));
            camera_distort(&scene->colmap.camera[0], (double[2]){way[0] / way[2], way[1] / way[2]}, pixel);
            CHECK_CLOSE(pixel[0], x, 2e-3);
            CHECK_CLOSE(pixel[1], y, 2e-3);
        }
    }
}
