/* test_ortho.c - what is rendered from above, along a path or measured in images lies where it says. */
#include "test.h"
#include "../cli/control.c"
#include "../cli/flight.c"
#include "../cli/frame.c"
#include "../cli/geotiff.c"
#include "../cli/scale_bar.c"
#include "../tools/cloud.c"
#include "../tools/compare.c"
#include "../tools/gps.c"
#include "../tools/map.c"
#include "../tools/mesh.c"
#include "../tools/product.c"
#include "../tools/similarity.c"
#include "../tools/surface.c"

/* It looks down. */
static const oxl_camera ORTHO_TEST_CAMERA = {40, 30, 50, 50, 20, 15, {1, 0, 0, 0, -1, 0, 0, 0, -1}, {0}};

/* 6 x 5 points over the ground plane, 2 units and 1 unit apart; two cameras 5 above look down, the second
 * turned ahead by an angle. The world's axes have signs. */
static oxl_scene *ortho_test_made(double angle, const double sign[3])
{
    static const double eyes[2][3] = {{3, 2, 5}, {7, 2, 5}};
    oxl_view view[2];
    oxl_image image[2] = {{0}, {0}};
    oxl_point points[30];
    for (int i = 0; i < 30; i++) points[i] = (oxl_point){{i % 6 * 2., i / 6, 0.01 * (i % 3)}, 1, {9, 9, 9}};
    for (int i = 0; i < 90; i++) points[i / 3].position[i % 3] *= sign[i % 3];
    for (int i = 0; i < 2; i++) {
        view[i] = (oxl_view){.name = i ? "b.png" : "a.png", .camera = ORTHO_TEST_CAMERA};
        if (i == 1) {
            double *r = view[i].camera.rotation;
            r[4] = -cos(angle), r[5] = -sin(angle), r[7] = sin(angle), r[8] = -cos(angle);
        }
        for (int k = 0; k < 9; k++) view[i].camera.rotation[k] *= sign[k % 3];
        frame_place(&view[i].camera,
                    (double[]){sign[0] * eyes[i][0], sign[1] * eyes[i][1], sign[2] * eyes[i][2]});
        image[i] = test_image(40, 30);
    }
    return test_scene(view, image, 2, points, 30);
}

static oxl_scene *ortho_test_turned(double angle)
{
    return ortho_test_made(angle, (const double[]){1, 1, 1});
}

static oxl_scene *ortho_test_scene(void)
{
    return ortho_test_turned(0);
}

#define OWNED_SURFACE __attribute__((cleanup(surface_close))) struct surface

static struct surface ortho_test_surface(const oxl_model *model, const oxl_scene *scene, int side)
{
    struct surface s;
    CHECK_OK(surface_open(test_ctx, model, scene, side, &s));
    return s;
}

static void ortho_test_close(const double a[3], const double b[3], double within)
{
    for (int k = 0; k < 3; k++) CHECK_CLOSE(a[k], b[k], within);
}

static double ortho_test_project(const oxl_camera *c, const double p[3], double at[2])
{
    const struct surface_view v = {.sheet = {.camera = *c}};
    size_t pixel;
    return surface_pixel(&v, p, at, &pixel);
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
    ortho_test_close(cross, f.axis[2], 1e-12);
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
        for (int i = 0; i < 30; i++) {
            double *p = point[i].position;
            const double x = cos(a) * p[0] - sin(a) * p[1], y = sin(a) * p[0] + cos(a) * p[1], z = p[2];
            p[0] = x;
            p[1] = cos(b) * y - sin(b) * z;
            p[2] = sin(b) * y + cos(b) * z;
        }
        frame_axes(&f, scene);
        double least = fmin(f.axis[0][0], fmin(f.axis[0][1], f.axis[0][2]));
        double most = fmax(f.axis[0][0], fmax(f.axis[0][1], f.axis[0][2]));
        negative += most < -least;
    }
    CHECK(negative == 0);
}

/* ---------------- files */

static const uint8_t *ortho_test_file(const char *path)
{
    static char *file; /* the last one */
    free(file);
    file = output_read(test_folder(), path);
    CHECK(file != NULL);
    return (const uint8_t *)file;
}

static uint32_t ortho_test_integer(const uint8_t *at, int size)
{
    return (uint32_t)bytes_get(at, size);
}

/* The entry of a tag in the directory of a TIFF, or NULL. */
static const uint8_t *ortho_test_tag(const uint8_t *tiff, uint32_t tag)
{
    const uint8_t *directory = tiff + ortho_test_integer(tiff + 4, 4);
    for (uint32_t i = 0; i < ortho_test_integer(directory, 2); i++)
        if (ortho_test_integer(directory + 2 + 12 * i, 2) == tag) return directory + 2 + 12 * i;
    return NULL;
}

static uint32_t ortho_test_value(const uint8_t *tiff, uint32_t tag)
{
    const uint8_t *entry = ortho_test_tag(tiff, tag);
    return entry ? ortho_test_integer(entry + 8, ortho_test_integer(entry + 2, 2) == 3 ? 2 : 4) : 0;
}

/* The value of a GeoKey that has it in the directory of `count` keys; 0: no such key. */
static uint32_t ortho_test_key(const uint8_t *keys, uint32_t count, uint32_t id)
{
    for (uint32_t i = 1; i <= count; i++)
        if (ortho_test_integer(keys + 8 * i, 2) == id) return ortho_test_integer(keys + 8 * i + 6, 2);
    return 0;
}

/* The four bytes of pixel x, y. */
static const uint8_t *ortho_test_at(const uint8_t *tiff, uint32_t x, uint32_t y)
{
    return tiff + ortho_test_value(tiff, 273) + 4 * (y * ortho_test_value(tiff, 256) + x);
}

/* Tags are in rising order, offsets even, the strip is the whole image and within the file. An EPSG code; a transverse
 * Mercator around a reference; metres, and not even that, without a system. */
TEST(geotiff_has_its_place_its_system_and_every_pixel)
{
    enum { W = 30, H = 26 };
    static float height[W * H], colour[3 * W * H];
    const double reference[2] = {47.5, -8.25};
    for (int i = 0; i < W * H; i++) height[i] = i % 7 == 0 ? NAN : (float)i;
    for (int i = 0; i < 3 * W * H; i++) colour[i] = i % (W * H) % 7 == 0 ? NAN : (float)(i % 256) / 255;
    for (int k = 0; k < 4; k++) {
        const struct geotiff g = {W,
                                  H,
                                  k < 3 ? 1 : 3,
                                  0.25,
                                  {500000.5, 6700001.25},
                                  k ? 0 : 32632,
                                  k == 1 ? reference : NULL,
                                  "some words",
                                  k == 2};
        const uint8_t *keys, *tie;
        uint32_t at, tags;
        CHECK_OK(geotiff_write(test_ctx, test_path("h.tif"), &g, k < 3 ? height : colour));
        const uint8_t *t = ortho_test_file("h.tif");
        at = ortho_test_integer(t + 4, 4), tags = ortho_test_integer(t + at, 2);
        keys = t + ortho_test_value(t, 34735), tie = t + ortho_test_value(t, 33922);
        CHECK(memcmp(t, "II*", 4) == 0 && at % 2 == 0);
        for (uint32_t i = 1; i < tags; i++)
            CHECK(ortho_test_integer(t + at + 2 + 12 * i, 2) >
                  ortho_test_integer(t + at + 2 + 12 * i - 12, 2));
        CHECK(ortho_test_value(t, 279) == 4 * W * H && ortho_test_value(t, 273) + 4 * W * H <= at);
        CHECK(ortho_test_value(t, 256) == W && ortho_test_value(t, 257) == H);
        CHECK(bytes_double(t + ortho_test_value(t, 33550)) == 0.25);
        CHECK(bytes_double(tie + 24) == 500000.5 && bytes_double(tie + 32) == 6700001.25);
        for (int i = 0; i < W * H; i++) {
            const uint8_t *at_pixel = ortho_test_at(t, (uint32_t)(i % W), (uint32_t)(i / W));
            if (k < 3) CHECK(memcmp(at_pixel, &height[i], 4) == 0);
            else
                CHECK(at_pixel[3] == (i % 7 ? 255 : 0) && at_pixel[2] == (i % 7 ? (i + 2 * W * H) % 256 : 0));
        }
        CHECK(k == 3 ? ortho_test_value(t, 338) == 2 : memcmp(ortho_test_tag(t, 42113) + 8, "nan", 4) == 0);
        CHECK(memcmp(t + ortho_test_value(t, 34737), "some words|", 12) == 0);
        tags = ortho_test_integer(keys + 6, 2);
        CHECK(ortho_test_key(keys, tags, 1024) == (k < 2) && ortho_test_key(keys, tags, 1025) == 1);
        CHECK(ortho_test_key(keys, tags, 3072) == (k == 0 ? 32632 : k == 1 ? 32767 : 0));
        CHECK(ortho_test_key(keys, tags, 3076) == (k == 1 || k == 2 ? 9001 : 0));
        CHECK(ortho_test_key(keys, tags, 2048) == (k == 1 ? 4326 : 0) &&
              !ortho_test_tag(t, 34736) == (k != 1));
        if (k != 1) continue;
        CHECK(bytes_double(t + ortho_test_value(t, 34736)) == -8.25);
        CHECK(bytes_double(t + ortho_test_value(t, 34736) + 8) == 47.5);
    }
}

/* ---------------- maps */

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

static oxl_result ortho_test_write(const oxl_scene *scene, const oxl_model *model, const struct arguments *a,
                                   oxl_result (*write)(const struct product *p, const oxl_model *model))
{
    FILE *to = fopen(test_path("said"), "wb");
    struct product p;
    oxl_result rc = product_open(test_ctx, scene, test_path("survey"), a, to, &p);
    if (rc == OXL_OK) rc = write(&p, model);
    fclose(to);
    return rc;
}

static void ortho_test_said(const char *text)
{
    char *said = output_read(test_folder(), "said");
    CHECK_TEXT(said ? said : "", text);
    free(said);
}

/* Of a map of the scene above, with a Gaussian at p: alpha and height at its place, which the map's own place
 * says. far: the world's origin is that far off. */
static void ortho_test_pixel(const double p[3], int min_views, const double far[3], int *alpha, float *height,
                             int *red)
{
    OWNED_SCENE *scene = ortho_test_scene();
    struct arguments a = {.out = test_path("map"), .pixel = 0.05, .min_views = min_views};
    const double ground[3] = {p[0], p[1], fmin(p[2], 0)};
    const uint8_t *t, *tie;
    OWNED_MODEL model = test_model(2, 0);
    ortho_test_gaussian(scene, &model, 0, ground, (float[]){1, 1, 0.01f}, 0);
    ortho_test_gaussian(scene, &model, 1, p, (float[]){0.1f, 0.1f, 0.1f}, 1.7f);
    /* every fifth point is at the speck's height, so that they do not contradict it */
    for (int i = 0; i < 30; i += 5)
        scene->point[i].position[2] = (p[2] < 5 ? p[2] : 0) - oxl_scene_origin(scene)[2];
    for (int k = 0; k < 3; k++) scene->origin[k] += far[k];
    CHECK_OK(ortho_test_write(scene, &model, &a, map_write));
    t = ortho_test_file("map/ortho.tif"), tie = t + ortho_test_value(t, 33922);
    for (uint32_t d = 0; d < 2;
         d++) { /* the points reach 10 x 4 from the origin on: into the outermost pixels */
        const double from = d ? far[1] + 4 - bytes_double(tie + 32) : bytes_double(tie + 24) - far[0],
                     rest = from + 0.05 * ortho_test_value(t, 256 + d) - (d ? 4 : 10);
        CHECK(from <= 1e-9 && from > -0.05 && rest >= -1e-9 && rest < 0.05);
    }
    uint32_t x = (uint32_t)((p[0] + far[0] - bytes_double(tie + 24)) / 0.05);
    uint32_t y = (uint32_t)((bytes_double(tie + 32) - p[1] - far[1]) / 0.05);
    *alpha = ortho_test_at(t, x, y)[3], *red = ortho_test_at(t, x, y)[0];
    *height = bytes_float(ortho_test_at(ortho_test_file("map/height.tif"), x, y)) - (float)far[2];
    a.pixel = 1e-9;
    CHECK(ortho_test_write(scene, &model, &a, map_write) == OXL_ERR_USAGE);
}

TEST(ortho_reaches_its_points_places_a_speck_and_does_not_see_what_floats_above_the_cameras)
{
    static const double far[2][3] = {{0, 0, 0}, {500000, 6700000, -20}};
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

/* What the cameras at x = 3 and 7 say of the place 5.05, 2.05, -1, which both have in their images. Ground: a Gaussian of
 * that size lies `ground` from it; speck: another on it, 0.2 red. A speck halfway hides the place from the first
 * camera; within a twentieth of the depth it is a slope, not a wall; usual: distance of the cameras, from which too
 * far away nothing is seen. Deeper ground is passed; images without depth confirm nothing;
 * nor do those that points at `points` contradict. */
TEST(surface_is_confirmed_by_clear_images_of_that_depth_that_points_do_not_contradict)
{
    static const struct {
        double ground[3], size, usual;
        int is_clear, has_speck, sees, confirms, passes;
        double points;
    } row[] = {{{-1.025, -0.025, 3}, 0.1, 100, 1, 0, 1, 0, 0, 9},
               {{-0.025, -0.005, 0.1}, 0.1, 100, 1, 0, 2, 2, 0, 9},
               {{0, 0, 0}, 3, 2.9, 1, 0, 0, 0, 0, 9},
               {{0, 0, 0}, 3, 100, 1, 0, 2, 2, 0, 9},
               {{0, 0, -2}, 3, 100, 1, 0, 2, 0, 2, 9},
               {{0, 0, -4}, 3, 100, 0, 0, 2, 0, 0, 9},
               {{0, 0, 0}, 30, 0, 1, 1, 2, 2, 0, 9},
               {{0, 0, 0}, 3, 100, 1, 0, 2, 0, 2, 1},
               {{0, 0, 0}, 3, 100, 1, 0, 2, 2, 0, 0}};
    for (size_t i = 0; i < sizeof row / sizeof *row; i++) {
        OWNED_SCENE *scene = ortho_test_scene();
        const double place[3] = {5.05, 2.05, -1};
        double p[3], speck[3] = {5.05, 2.05, -0.95};
        vector_add(place, 1, row[i].ground, p);
        OWNED_MODEL model = test_model(2, 0);
        ortho_test_gaussian(scene, &model, 0, p,
                            (float[]){(float)row[i].size, (float)row[i].size, row[i].size > 1 ? 0.01f : 0.1f},
                            0);
        ortho_test_gaussian(scene, &model, 1, speck, (float[]){0.1f, 0.1f, 0.01f}, 0.2f);
        if (!row[i].is_clear) model.plane[OXL_OPACITY][0] = -20;
        if (!row[i].has_speck) model.plane[OXL_OPACITY][1] = -20;
        if (row[i].points > 8) scene->point_count = 0;
        for (int k = 0; k < 90; k++)
            scene->point[k / 3].position[k % 3] = (k % 3 == 0   ? 4.6 + 0.16 * (k / 3 % 6)
                                                   : k % 3 == 1 ? 1.5 + 0.2 * (k / 18)
                                                                : row[i].points - 1) -
                                                  oxl_scene_origin(scene)[k % 3];
        OWNED_SURFACE s = ortho_test_surface(&model, scene, 1000);
        if (row[i].usual > 0) s.distance = row[i].usual;
        vector_add(place, -1, oxl_scene_origin(scene), p);
        struct surface_vote vote = surface_ask(&s, p);
        CHECK(vote.sees == row[i].sees && vote.confirms == row[i].confirms && vote.passes == row[i].passes);
    }
    for (int i = 1; i < 5; i++)
        CHECK(surface_holds(&(struct surface_vote){.confirms = 2, .passes = i}, 2) == (i < 4));
}

/* In the image of the camera at x = 3; above both cameras; in the image of the one at 7 alone, which is held out;
 * behind the cameras' images; black, before nothing, in the first's. */
TEST(unseen_gaussians_are_removed_and_no_training_view_changes)
{
    static const double place[5][3] = {{3, 2, 0}, {3, 2, 6}, {8, 2, 0}, {20, 2, 0}, {2, 2, 0}};
    OWNED_SCENE *scene = ortho_test_scene();
    OWNED_MODEL model = test_model(5, 0);
    for (int i = 0; i < 5; i++) {
        ortho_test_gaussian(scene, &model, (size_t)i, place[i], (float[]){0.1f, 0.1f, 0.1f},
                            i == 4 ? -9 : (float)i);
        model.plane[OXL_OPACITY][i] = 0;
    }
    for (int v = 0; v < 2; v++) scene->view[v].is_test = v;
    OWNED_IMAGE before = test_render(&model, &oxl_scene_view(scene, 0)->camera);
    CHECK_OK(unseen_drop(test_ctx, scene, &model));
    CHECK(model.count == 2 && model.plane[OXL_SH][0] == 0 && model.plane[OXL_SH][1] == -9);
    OWNED_IMAGE after = test_render(&model, &oxl_scene_view(scene, 0)->camera);
    CHECK(memcmp(before.rgb, after.rgb, 3 * 40 * 30 * sizeof(float)) == 0);
}

/* A wall of specks on flat ground 9 below the cameras at x = 3 and 7, whose images are 7.2 wide there: of the map,
 * 10 x 4, both have the middle 3.2 x 4. */
static void ortho_test_ground(oxl_scene *scene, oxl_model *model)
{
    for (int i = 0; i < 30; i++)
        scene->point[i].position[2] = -4 + 0.01 * (i % 3) - oxl_scene_origin(scene)[2];
    *model = test_model(201, 0);
    ortho_test_gaussian(scene, model, 0, (double[]){5, 2, -4}, (float[]){10, 10, 0.01f}, 0);
    for (int i = 0; i < 200; i++)
        ortho_test_gaussian(scene, model, (size_t)i + 1,
                            (double[]){i % 20 * 0.7 - 1, i / 20 * 0.7 - 1, -3.96},
                            (float[]){0.2f, 0.2f, 0.01f}, 1);
}

/* Then two veils, neither with a third of a pixel's weight; then cameras that look at a wall, north and level, on the
 * world's map. */
TEST(map_measures_the_ground_that_two_views_share_its_certainty_and_where_cameras_look)
{
    static const double level[9] = {1, 0, 0, 0, 0, -1, 0, 1, 0};
    OWNED_SCENE *scene = ortho_test_scene();
    OWNED_SURFACE s = {0};
    struct map m = {.surface = &s, .to = similarity_of_world(scene, 1), .enough = 2, .side = 100}, wall = m;
    OWNED_MODEL model = {0};
    ortho_test_ground(scene, &model);
    s = ortho_test_surface(&model, scene, SURFACE_SIDE);
    CHECK_OK(map_make(&m, &model));
    CHECK_CLOSE(m.sampling, 0.18, 0.001); /* 9 to the model's ground, by 50 px */
    CHECK_CLOSE(m.area, 12.8, 0.7);
    CHECK_CLOSE(m.covered, 0.32, 0.02);
    CHECK_CLOSE(m.high, 0.32, 0.03);
    CHECK_CLOSE(m.off.median, 0.03, 0.03);
    CHECK(m.off.gross == 0 && m.off.most < 0.1 && m.down > 0.999);
    CHECK_CLOSE(m.off.distance, 9, 0.03);
    CHECK(m.width <= 101 && m.height <= 41);
    size_t middle = (size_t)(m.height / 2 * m.width + m.width / 2);
    CHECK(m.views[middle] == 2 && m.sigma[middle] > 0.005f && m.sigma[middle] < 0.3f);
    CHECK(m.views[0] == 0 && isnan(m.sigma[0]) && isnan(m.level[0]) && isnan(m.colour[0]));
    map_free(&m);
    surface_close(&s);
    ortho_test_gaussian(scene, &model, 1, (double[]){5, 2, -6}, (float[]){30, 30, 0.01f}, 0);
    model.count = 2, model.plane[OXL_OPACITY][0] = model.plane[OXL_OPACITY][1] = -0.7f;
    s = ortho_test_surface(&model, scene, SURFACE_SIDE);
    map_make(&m, &model);
    CHECK_CLOSE(m.high, 0.32, 0.03);
    map_free(&m);
    surface_close(&s);
    for (int v = 0; v < 2; v++) memcpy(scene->view[v].camera.rotation, level, sizeof level);
    s = ortho_test_surface(&model, scene, SURFACE_SIDE);
    wall.kind = FRAME_WORLD_AXES, wall.side = 50;
    map_make(&wall, &model);
    map_free(&wall);
    CHECK_CLOSE(wall.down, 0, 1e-9);
}

/* The cameras' images, 7.2 wide on the ground, are 4 apart: the first lacks the right 4/7.2 of the second's. The
 * rendering is right where the first shows the ground, and black, for grey, where it does not. */
TEST(held_out_view_tells_what_no_training_view_shows_and_its_psnr_without_that)
{
    OWNED_SCENE *scene = ortho_test_scene();
    OWNED_MODEL model = {0};
    const oxl_camera *camera = &oxl_scene_view(scene, 1)->camera;
    oxl_image image = {0}, rendered = {0};
    struct drawn of = {NULL, &model, scene, NULL};
    for (int is_covered = 0; is_covered < 2; is_covered++) {
        struct unshown *u = oxl_calloc(test_ctx, 1, sizeof *u);
        oxl_view_metrics row = {.view = 1};
        double all = 0;
        oxl_model_free(test_ctx, &model);
        ortho_test_ground(scene, &model);
        scene->view[1].is_test = 1;
        if (is_covered) scene->view[0].camera = *camera;
        CHECK_OK(renderer_create(test_ctx, &of.r));
        CHECK_OK(unshown_find(test_ctx, &of, (int[]){1}, 1, u));
        CHECK_OK(oxl_image_create(test_ctx, camera->width, camera->height, &image));
        CHECK_OK(oxl_image_create(test_ctx, camera->width, camera->height, &rendered));
        for (int i = 0; i < 3 * image.width * image.height; i++) {
            image.rgb[i] = 0.5f;
            rendered.rgb[i] = i % image.width < 3 * image.width / 7 ? 0.6f : 0;
        }
        CHECK_OK(unshown_measure(test_ctx, u, &rendered, &image, &row));
        for (int k = 0; k < 4; k++) all += row.unshown[k];
        CHECK_CLOSE(all, is_covered ? 0 : 4 / 7.2, 0.02);
        CHECK(is_covered || (row.unshown[1] > 4 * row.unshown[0] && row.unshown[3] > 4 * row.unshown[2]));
        CHECK(is_covered ? row.shown_psnr < 10 : row.shown_psnr > 15);
        oxl_image_free(test_ctx, &image);
        oxl_image_free(test_ctx, &rendered);
        renderer_free(test_ctx, of.r);
        unshown_free(test_ctx, u, 1);
    }
}

/* A hole of two pixels gets the mean of what is around; of a large one, its corners alone do; one in the map's corner
 * stays. */
TEST(map_fills_pinholes_alone)
{
    enum { W = 12, H = 9 };
    float plane[2 * W * H];
    const struct map m = {.width = W, .height = H};
    for (int i = 0; i < 2 * W * H; i++) plane[i] = i % W < 3 ? 100 : 200;
    for (int i = 0; i < 25; i++) plane[(2 + i / 5) * W + 5 + i % 5] = NAN;
    plane[3 * W + 2] = plane[3 * W + 3] = plane[0] = NAN;
    memcpy(plane + W * H, plane, W * H * sizeof *plane);
    CHECK(map_fill(&m, plane, 2, 3) == 6 && isnan(plane[0]) && isnan(plane[3 * W + 5]) &&
          isnan(plane[4 * W + 7]));
    CHECK_CLOSE(plane[3 * W + 2], 100 + 100 * 2 / 7.0, 1e-4);
    CHECK(plane[W * H + 3 * W + 2] == plane[3 * W + 2] && plane[2 * W + 5] == 200);
}

/* A LAS 1.4 file of the ground above: its header, the CRS by the keys of GeoTIFF, and points on the ground. */
TEST(cloud_in_las_has_its_crs_its_scale_and_points_on_the_ground)
{
    OWNED_SCENE *scene = ortho_test_scene();
    OWNED_MODEL model = {0};
    struct arguments a = {.command = COMMAND_CLOUD, .out = test_path("c.las"), .min_views = 2, .epsg = 32632};
    const double low[3] = {500003, 6699998, -24.1}, high[3] = {500007, 6700006, -23.9};
    const uint8_t *t, *keys;
    uint32_t first, count;
    ortho_test_ground(scene, &model);
    vector_add(scene->origin, 1, (double[3]){500000, 6700000, -20}, scene->origin);
    CHECK_OK(ortho_test_write(scene, &model, &a, cloud_write));
    ortho_test_said(" points about");
    t = ortho_test_file("c.las"), keys = t + 375 + 54;
    first = ortho_test_integer(t + 96, 4), count = ortho_test_integer(t + 247, 4);
    CHECK(memcmp(t, "LASF", 4) == 0 && t[24] == 1 && t[25] == 4 && t[104] == 2 &&
          ortho_test_integer(t + 94, 2) == 375);
    CHECK(count == ortho_test_integer(t + 107, 4) && count > 300);
    CHECK(ortho_test_integer(t + 375 + 18, 2) == 34735); /* the first record */
    CHECK(ortho_test_key(keys, ortho_test_integer(keys + 6, 2), 3072) == 32632);
    for (const uint8_t *p = t + first; p < t + first + 26 * (size_t)count; p += 26) {
        for (int k = 0; k < 3; k++) {
            const double x = (int32_t)ortho_test_integer(p + 4 * k, 4) * bytes_double(t + 131 + 8 * k) +
                             bytes_double(t + 155 + 8 * k);
            CHECK(x > low[k] && x < high[k]);
        }
        CHECK(p[17] == 2);
    }
}

/* Turns by any angle, half a turn too; two pairs are without weight. */
TEST(similarity_of_pairs_is_the_one_that_made_them)
{
    for (int turn = 0; turn < 9; turn++) {
        const double a = turn * 0.7853981633974483;
        const struct similarity truth = {
            0.3 + turn, {cos(a), -sin(a), 0, 0, 0, -1, sin(a), cos(a), 0}, {5, -70, 2}};
        struct match pair[20];
        struct similarity s;
        double p[3];
        for (int i = 0; i < 20; i++) {
            for (int k = 0; k < 3; k++) pair[i].from[k] = (i * (7 + 4 * k)) % 11;
            similarity_apply(&truth, pair[i].from, pair[i].to);
            pair[i].weight = i < 18;
            if (i >= 18) pair[i].to[0] += 100;
        }
        CHECK(similarity_fit(pair, 20, &s));
        CHECK_CLOSE(s.scale, truth.scale, 1e-9);
        struct similarity back = similarity_inverse(&s);
        similarity_apply(&s, pair[17].from, p);
        ortho_test_close(p, pair[17].to, 1e-7);
        similarity_apply(&back, p, p);
        ortho_test_close(p, pair[17].from, 1e-7);
    }
}

/* Triangles on the ground, as large as what two views share, that face the cameras. Each edge between two triangles is
 * in both, in opposite directions. */
TEST(mesh_of_flat_ground_lies_on_it_faces_the_cameras_and_has_no_cracks)
{
    OWNED_SCENE *scene = ortho_test_scene();
    OWNED_MODEL model = {0};
    struct cloud c = {0};
    double area = 0;
    int open = 0;
    ortho_test_ground(scene, &model);
    OWNED_SURFACE s = ortho_test_surface(&model, scene, 320);
    CHECK_OK(cloud_make(&s, 2, &c));
    CHECK_OK(mesh_make(&s, 2, 0.2, &c));
    for (size_t i = 0; i < 3 * c.triangles; i++) {
        const uint32_t from = c.index[i], to = c.index[i - i % 3 + (i + 1) % 3];
        const double *a = c.point[from].place, *b = c.point[to].place;
        int back = 0;
        area += 0.5 * (a[0] * b[1] - a[1] * b[0]);
        CHECK_CLOSE(a[2], -4 - oxl_scene_origin(scene)[2], 0.15);
        CHECK(c.point[from].normal[2] > 0.8f);
        for (size_t k = 0; k < 3 * c.triangles; k++)
            back += c.index[k] == to && c.index[k - k % 3 + (k + 1) % 3] == from;
        CHECK(back <= 1);
        open += !back;
    }
    CHECK(area > 10 && area < 20 && c.triangles > 200 && open < 120);
    cloud_free(&c);
}

/* A hill of 30 x 30 cells is a change, with its volume; one of 8 x 8, and a difference within the level of detection,
 * are none. */
TEST(compare_finds_what_is_larger_than_noise_and_its_volume)
{
    enum { SIDE = 80 };
    static float plane[2 * SIDE * SIDE];
    static signed char sign[SIDE * SIDE];
    static size_t place[SIDE * SIDE];
    static struct compare_row row[COMPARE_PLACES + 1];
    const struct product p = {.ctx = test_ctx};
    struct compare c = {.p = &p,
                        .cells = SIDE * SIDE,
                        .difference = plane,
                        .level = plane + SIDE * SIDE,
                        .sign = sign,
                        .place = place};
    double number[32];
    c.map[0] = (struct map){.width = SIDE, .height = SIDE, .pixel = 0.5, .corner = {10, 20}};
    for (int i = 0; i < SIDE * SIDE; i++) {
        const int x = i % SIDE, y = i / SIDE;
        c.level[i] = 0.1f;
        plane[i] = x >= 10 && x < 40 && y >= 20 && y < 50   ? 0.4f
                   : x >= 60 && x < 68 && y < 30 && y >= 22 ? -0.4f
                   : x < 60                                 ? 0.05f
                                                            : NAN;
    }
    compare_judge(&c);
    CHECK(compare_list(&c, row) == 2 && row[1].sign == 1 && row[0].value[LOWERED] == 0);
    /* without its corners, which most cells around do not share */
    CHECK_CLOSE(row[1].value[NET], 900 * 0.25 * 0.4, 3);
    CHECK_CLOSE(row[1].value[X], 10 + 25 * 0.5, 0.1);
    CHECK_CLOSE(row[1].value[Y], 20 - 35 * 0.5, 0.1);
    CHECK_CLOSE(row[0].value[RAISED], row[1].value[NET], 1e-9);
    CHECK(compare_polygon("0,0;4,0", number) == 0 && compare_polygon("0,0;4;0,4,3,3", number) == 0);
    CHECK(compare_polygon("0,0;4,0;4,4;0,4", number) == 8 && compare_is_inside(number, 8, 1, 3));
    CHECK(!compare_is_inside(number, 8, 5, 3) && compare_is_inside(NULL, 0, 9, 9));
}

/* ---------------- GPS */

/* Sets an integer, big or little endian. */
static void ortho_test_put(uint8_t *at, int is_big, double value, int size)
{
    for (int i = 0; i < size; i++) at[is_big ? size - 1 - i : i] = (uint8_t)((uint32_t)value >> 8 * i);
}

/* Writes a JPEG's first bytes with EXIF data in either byte order: whole degrees and minutes, millionths of seconds and
 * metres. */
static void ortho_test_photo(const char *name, int is_big, const double place[3])
{
    uint8_t file[400] = {0xff, 0xd8, 0xff, 0xe1, 1, 0x80, 'E', 'x', 'i', 'f'}, *t = file + 12;
    static const int head[][3] = {{2, 42, 2}, {4, 8, 4},  {8, 1, 2},   {10, 0x8825, 2},
                                  {12, 4, 2}, {14, 1, 4}, {18, 26, 4}, {26, 6, 2}};
    memcpy(t, is_big ? "MM" : "II", 2);
    for (int i = 0; i < 8; i++) ortho_test_put(t + head[i][0], is_big, head[i][1], head[i][2]);
    for (int i = 0; i < 6; i++) { /* tag, type, count, value */
        const int entry = 28 + 12 * i, to = 106 + 24 * (i / 2), is_value = i % 2, count = i == 5 ? 1 : 3;
        const double all = fabs(place[i / 2]) * (i == 5 ? 1e6 : 3600e6),
                     part[3] = {i == 5 ? all : floor(all / 3600e6), fmod(floor(all / 60e6), 60),
                                fmod(all, 60e6)};
        ortho_test_put(t + entry, is_big, i + 1, 2);
        ortho_test_put(t + entry + 2, is_big, is_value ? 5 : 2, 2);
        ortho_test_put(t + entry + 4, is_big, is_value ? count : 1, 4);
        if (is_value) ortho_test_put(t + entry + 8, is_big, to, 4);
        else t[entry + 8] = (uint8_t)(i == 4 ? place[2] < 0 : (place[i / 2] < 0 ? "SW" : "NE")[i / 2]);
        for (int k = 0; k < count && is_value; k++) {
            ortho_test_put(t + to + 8 * k, is_big, floor(part[k] + 0.5), 4);
            ortho_test_put(t + to + 8 * k + 4, is_big, i == 5 || k == 2 ? 1e6 : 1, 4);
        }
    }
    test_make_folder("survey/images");
    test_write_bytes(test_path("survey/images/%s", name), file, sizeof file);
}

/* Places in UTM by PROJ, gdaltransform. */
TEST(gps_of_photos_is_read_and_becomes_utm)
{
    static const struct {
        double place[3], utm[3];
        int epsg;
    } row[] = {{{63.4305, 10.3951, 12.5}, {569618.6286, 7034313.8490, 12.5}, 32632},
               {{-33.8568, 151.2153, -2.25}, {334900.5697, 6252288.7529, -2.25}, 32756}};
    for (int i = 0; i < 4; i++) {
        double place[3], utm[3];
        ortho_test_photo("a.jpg", i / 2, row[i % 2].place);
        CHECK(gps_of_view(NULL, test_path("survey"), "a.jpg", place));
        ortho_test_close(place, row[i % 2].place, 1e-9);
        gps_utm(row[i % 2].place, row[i % 2].epsg, utm);
        ortho_test_close(utm, row[i % 2].utm, 1e-3);
        gps_utm((double[3]){-0.001, 9}, 32632, utm); /* south of the equator, of a survey that begins north */
        CHECK_CLOSE(utm[1], -110.53, 0.01);
    }
    CHECK(!gps_of_view(NULL, test_path("survey"), "none.jpg", (double[3]){0}));
}

/* Eight photos on two lines, 9 and 7 m apart, one of them 60 m off; the survey is turned, and half a metre a unit. Then
 * one line alone. */
TEST(gps_turns_a_survey_into_utm_metres_with_up_without_what_is_off)
{
    static const struct similarity truth = {
        0.5, {0, -1, 0, 0.6, 0, -0.8, 0.8, 0, 0.6}, {569618, 7034313, 20}};
    const struct similarity back = similarity_inverse(&truth);
    const struct arguments a = {.gps = 1};
    oxl_view view[8];
    oxl_image image[8];
    oxl_point points[30];
    struct product p;
    FILE *to = fopen(test_path("said"), "wb");
    double at[3], wanted[3];
    for (int i = 0; i < 90; i++) points[i / 3] = (oxl_point){{i % 7, i % 5, i % 3}, 1, {9, 9, 9}};
    for (int i = 0; i < 8; i++) {
        static const char *const names[] = {"0.jpg", "1.jpg", "2.jpg", "3.jpg",
                                            "4.jpg", "5.jpg", "6.jpg", "7.jpg"};
        double place[3] = {63.4305 + 0.00008 * (i / 4), 10.3951 + 0.00014 * (i % 4), 12.5 + 0.1 * (i % 3)},
               eye[3];
        gps_utm(place, 32632, eye);
        similarity_apply(&back, eye, eye);
        view[i] = (oxl_view){.name = names[i], .camera = ORTHO_TEST_CAMERA};
        frame_place(&view[i].camera, eye);
        if (i == 5) place[2] += 60;
        ortho_test_photo(names[i], i % 2, place);
        image[i] = test_image(40, 30);
    }
    OWNED_SCENE *scene = test_scene(view, image, 8, points, 30);
    CHECK_OK(product_open(test_ctx, scene, test_path("survey"), &a, to, &p));
    fclose(to);
    ortho_test_said("8 of 8 photos, UTM zone 32 (EPSG:32632): 0.5 metres per unit; 1 left out");
    CHECK(p.place.epsg == 32632);
    vector_add((double[3]){7, -3, 2}, -1, oxl_scene_origin(scene), at);
    similarity_apply(&p.world, at, at);
    similarity_apply(&truth, (double[3]){7, -3, 2}, wanted);
    ortho_test_close(at, wanted, 1e-3);
    for (int i = 0; i < 4; i++)
        ortho_test_photo(view[i].name, 0, (double[3]){63.4305, 10.3951 + 0.00014 * i, 12.5 + 3 * (i % 2)});
    scene->view_count = 4;
    CHECK_ERROR(product_open(test_ctx, scene, test_path("survey"), &a, stderr, &p), OXL_ERR_INPUT,
                "the vertical is uncertain");
    scene->view_count = 8;
}

/* Ground that falls by 25 degrees below cameras that look straight down; then a world far away whose z is down. */
TEST(frame_of_a_georeferenced_slope_is_the_world_unless_its_z_is_down)
{
    for (int down = 0; down < 2; down++) {
        OWNED_SCENE *scene = ortho_test_made(0, (const double[]){1, down ? -1 : 1, down ? -1 : 1});
        struct frame f;
        for (int i = 0; i < 30 && !down; i++)
            scene->point[i].position[2] += tan(0.436) * scene->point[i].position[0];
        for (int k = 0; k < 3 && down; k++) scene->origin[k] += 1e5;
        frame_choose(scene, FRAME_AUTO, &f);
        CHECK(f.is_world == !down && (down ? f.axis[2][2] < -0.99 : f.axis[2][2] > 0.99));
        frame_choose(scene, FRAME_SURVEY_AXES, &f);
        CHECK(!f.is_world && f.axis[2][2] < 0.93);
    }
}

/* At both ends, and a quarter of the way in time: Catmull-Rom's place with its ends doubled, (t + 3 t^2 - 2 t^3) / 2,
 * and a view eased by t^2 (3 - 2 t). */
TEST(flight_along_the_survey_accelerates_smoothly_from_its_first_camera_to_its_last)
{
    static const double time[3] = {0, 0.25, 1}, ease[3] = {0, 0.15625, 1}, way[3] = {0, 0.203125, 1};
    OWNED_SCENE *scene = ortho_test_turned(0.5);
    for (int i = 0; i < 3; i++) {
        oxl_camera c = oxl_scene_view(scene, 0)->camera;
        double a[3], b[3], eye[3];
        flight_survey(scene, time[i], &c);
        frame_eye(&oxl_scene_view(scene, 0)->camera, a);
        frame_eye(&oxl_scene_view(scene, 1)->camera, b);
        vector_add(b, -1, a, b);
        vector_add(a, way[i], b, a);
        frame_eye(&c, eye);
        ortho_test_close(eye, a, 1e-9);
        CHECK_CLOSE(atan2(c.rotation[7], -c.rotation[8]),
                    atan2(ease[i] * sin(0.5), 1 - ease[i] + ease[i] * cos(0.5)), 1e-12);
    }
}

TEST(flight_around_the_centre_faces_it_upright)
{
    OWNED_SCENE *scene = ortho_test_scene();
    struct frame f;
    frame_choose(scene, FRAME_AUTO, &f);
    for (int i = 0; i < 7; i++) {
        oxl_camera c = oxl_scene_view(scene, 0)->camera;
        double at[2], cross[3];
        CHECK(flight_orbit(scene, i / 7., &c));
        CHECK(ortho_test_project(&c, f.centre, at) > 1 && c.rotation[5] < 0);
        CHECK_CLOSE(at[0], c.cx, 1e-7);
        CHECK_CLOSE(at[1], c.cy, 1e-7);
        frame_cross(c.rotation, c.rotation + 3, cross);
        ortho_test_close(cross, c.rotation + 6, 1e-12);
    }
}

/* Pixels of a place in a.png and b.png of the scene above. */
static void ortho_test_pixels(const oxl_scene *scene, const double place[3], char out[200])
{
    double p[3], at[2][2];
    vector_add(place, -1, oxl_scene_origin(scene), p);
    for (int i = 0; i < 2; i++) ortho_test_project(&oxl_scene_view(scene, i)->camera, p, at[i]);
    snprintf(out, 200, "a.png,%.9f,%.9f,b.png,%.9f,%.9f", at[0][0], at[0][1], at[1][0], at[1][1]);
}

static oxl_result ortho_test_measure(const oxl_scene *scene, const char *bar, double metres)
{
    FILE *to = fopen(test_path("said"), "ab");
    const oxl_result rc = scale_measure(test_ctx, scene, bar, metres, to);
    fclose(to);
    return rc;
}

TEST(scale_bar_has_its_true_length)
{
    OWNED_SCENE *scene = ortho_test_scene();
    const double end[2][3] = {{5, 2, 0}, {5, 2.5, 0}}; /* half a unit apart, at the rims of both */
    char pixels[2][200], bar[420];
    for (int i = 0; i < 2; i++) ortho_test_pixels(scene, end[i], pixels[i]);
    snprintf(bar, sizeof bar, "%s:%s", pixels[0], pixels[1]);
    CHECK_OK(ortho_test_measure(scene, bar, 0.25));
    CHECK_OK(ortho_test_measure(scene, "5,2,0:5,2.5,0", 1.5));
    ortho_test_said("end 2     5.000000 2.500000");
    ortho_test_said("scale     0.5");
    ortho_test_said("scale     3 metres");
    CHECK_ERROR(ortho_test_measure(scene, "a.png,1,2:b.png,1,2", 1), OXL_ERR_USAGE, "visible in two images");
    CHECK_ERROR(ortho_test_measure(scene, "c.png,1,2,a.png,1,2:b.png,1,2", 1), OXL_ERR_USAGE,
                "no image is called 'c.png'");
}

/* Two bars of 1 and 2 units, said to be of 0.5 and 1.1 m: the scale of the least squares leaves both something. */
TEST(scale_of_several_bars_is_their_least_squares)
{
    OWNED_SCENE *scene = ortho_test_scene();
    CHECK_OK(ortho_test_measure(scene, "1,2,0:2,2,0=0.5;1,2,0:3,2,0=1.1", 0));
    ortho_test_said("scale     0.54 metres");
    ortho_test_said("bar 1     0.5 m, measured 0.54 m, residual -0.04 m: warning");
    ortho_test_said("bar 2     1.1 m, measured 1.08 m, residual 0.02 m\n");
    CHECK(ortho_test_measure(scene, "1,2,0:2,2,0=x", 0) == OXL_ERR_USAGE);
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
    CHECK_ERROR(ortho_test_measure(scene, bar, 1), OXL_ERR_INPUT, "of the camera's distance of 5");
}

/* A point 2 cm beside where the cameras see it, another 1 cm above; the world's origin is far. */
TEST(control_points_have_their_residuals)
{
    OWNED_SCENE *scene = ortho_test_scene();
    FILE *to = fopen(test_path("said"), "wb+");
    char pixels[200], line[600];
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
    ortho_test_said("p0                   0.0200     0.0000     0.0000     0.0200");
    ortho_test_said("p1                   0.0000     0.0000     0.0100     0.0100");
    ortho_test_said("0.0141     0.0000     0.0071     0.0158  rms of 2");
    test_write("control.csv", "p,1,2,3,5,2,0\nq,1,2\n");
    CHECK_ERROR(control_check(test_ctx, scene, test_path("control.csv"), stderr), OXL_ERR_INPUT,
                "control.csv:2: found 'q,1,2'");
}

TEST(scale_of_a_model_moves_means_scales_and_origin)
{
    OWNED_MODEL model = test_model(1, 0);
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
        test_write_colmap(
            "survey", cameras[m], "1 1 0 0 0 0 0 0 1 a.png\n\n2 1 0 0 0 -1 0 0 1 b.png\n\n",
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

TEST(products_have_the_hue_of_the_images_where_gains_drift_along_the_track)
{
    OWNED_SCENE *scene = ortho_test_made(0, (double[]){1, 1, 1});
    OWNED_IMAGING gains = imaging_test_make(2, (int[]){0, 1}, 2);
    OWNED_MODEL model = test_model(2, 0);
    double hue[2];
    for (int i = 0; i < 6; i++) gains.log_gain[i] = (float)((i / 3 ? 0.4 : -0.4) * (1 - i % 3) + 0.3);
    for (int i = 0; i < 2; i++) { /* beneath one camera and the other */
        model.plane[OXL_MEAN][i] = i ? 9 : 1;
        for (int c = 0; c < 3; c++) model.plane[OXL_SH + c][i] = 0;
    }
    product_balance(scene, &gains, &model);
    for (int i = 0; i < 2; i++) {
        double colour[3];
        for (int c = 0; c < 3; c++)
            colour[c] = 0.5 + 0.28209479177387814 * (double)model.plane[OXL_SH + c][i];
        hue[i] = log(colour[0] / colour[2]);
        CHECK_CLOSE(colour[0] * colour[1] * colour[2], 0.125, 1e-6);
    }
    CHECK(hue[0] < 0 && hue[1] > 0);
    CHECK_CLOSE(hue[1], -hue[0], 1e-6);
    product_balance(scene, NULL, &model);
    CHECK_CLOSE(hue[1],
                log((0.5 + 0.28209479177387814 * (double)model.plane[OXL_SH][1]) /
                    (0.5 + 0.28209479177387814 * (double)model.plane[OXL_SH + 2][1])),
                1e-6);
}
