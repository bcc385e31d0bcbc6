/* test_scene.c - surveys as they come: what is found, what is missing, what is wrong with them. */
#include "test.h"

/* A survey of n images (32 x 24 px, img00.png...) that look along z at four points 10 away; the cameras stand
 * 1 apart along x, from `base` on. Written to the test's folder under `name`. */
const char *scene_survey(const char *name, int n, double base, int with_files)
{
    OWNED_TEXT images = test_text(), points = test_text();
    text_add(&images, "# images\n");
    for (int i = n - 1; i >= 0; i--) /* not in the order of names */
        text_add(&images, "%d 1 0 0 0 %.17g 0 0 1 img%02d.png\n1 2 %d\n", 10 + i, -(base + i), i, 1);
    for (int i = 0; i < 4; i++) {
        text_add(&points, "%d %.17g %d 10 %d 20 30 0.5", 1 + i, base + i, i % 2, 10 * i);
        for (int k = 0; k < n; k++) text_add(&points, " %d 0", 10 + k);
        text_add(&points, "\n");
    }
    test_write_colmap(test_path("%s/sparse/0", name), "1 PINHOLE 32 24 40 40 16 12\n", images.data,
                      points.data);
    test_make_folder(test_path("%s/images", name));
    for (int i = 0; i < n && with_files; i++) {
        OWNED_IMAGE image = test_image(32, 24);
        for (int k = 0; k < 3 * 32 * 24; k++) image.rgb[k] = (float)(i + 1) / 255.0f;
        test_write_image(test_path("%s/images/img%02d.png", name, i), &image);
    }
    return test_path(name);
}

static const char *scene_usual(int n)
{
    return scene_survey("s", n, 0, 1);
}

TEST(scene_of_a_file_that_was_cut_is_refused_unless_it_is_allowed)
{
    const char *path = scene_usual(3);
    oxl_scene_options options = oxl_scene_options_default();
    OWNED_SCENE *scene = NULL;
    test_write(
        "s/sparse/0/images.txt",
        "# Number of images: 18, mean observations per image: 1\n10 1 0 0 0 0 0 0 1 img00.png\n1 2 1\n");
    CHECK(oxl_scene_load(test_ctx, path, &options, &scene) == OXL_ERR_INPUT && scene == NULL);
    CHECK_SAYS("fewer rows than its header announces");
    CHECK_SAYS("--force");
    options.allow_truncated = 1;
    scene = test_load(path, &options);
    CHECK(oxl_scene_view_count(scene) == 1);
}

TEST(scene_does_not_depend_on_the_order_of_lines)
{
    const char *path = scene_usual(3);
    OWNED_SCENE *a = test_load(path, NULL);
    test_write("s/sparse/0/images.txt",
               "10 1 0 0 0 0 0 0 1 img00.png\n1 2 1\n12 1 0 0 0 -2 0 0 1 img02.png\n1 2 1\n"
               "11 1 0 0 0 -1 0 0 1 img01.png\n1 2 1\n");
    test_write("s/sparse/0/points3D.txt",
               "3 2 0 10 20 20 30 0.5 10 0 11 0 12 0\n1 0 0 10 0 20 30 0.5 10 0 11 0 12 0\n"
               "4 3 1 10 30 20 30 0.5 10 0 11 0 12 0\n2 1 1 10 10 20 30 0.5 10 0 11 0 12 0\n");
    OWNED_SCENE *b = test_load(path, NULL);
    CHECK(oxl_scene_point_count(a) == 4 && oxl_scene_point_count(b) == 4);
    for (int i = 0; i < 4; i++) {
        const oxl_point *x = oxl_scene_points(a) + i, *y = oxl_scene_points(b) + i;
        CHECK(memcmp(x->position, y->position, sizeof x->position) == 0 && memcmp(x->rgb, y->rgb, 3) == 0);
    }
    CHECK(oxl_scene_extent(a) == oxl_scene_extent(b) && oxl_scene_near_plane(a) == oxl_scene_near_plane(b));
}

TEST(scene_views_are_sorted_by_name_and_every_eighth_is_for_the_test)
{
    const char *path = scene_usual(17);
    test_listen();
    OWNED_SCENE *scene = test_load(path, NULL);
    CHECK(oxl_scene_view_count(scene) == 17 && oxl_scene_point_count(scene) == 4);
    CHECK(oxl_scene_view(scene, 17) == NULL && oxl_scene_view(scene, -1) == NULL);
    for (int i = 0; i < 17; i++) {
        char name[16];
        snprintf(name, sizeof name, "img%02d.png", i);
        CHECK(strcmp(oxl_scene_view(scene, i)->name, name) == 0);
        CHECK(oxl_scene_view(scene, i)->is_test == (i % 8 == 0));
        CHECK(scene_image(test_ctx, scene, i)->rgb[0] == i + 1);
    }
    const struct scene_stats *stats = &scene->stats;
    CHECK(stats->images_listed == 17 && stats->images_missing == 0 && stats->test_views == 3 &&
          stats->observations == 68);
    CHECK_CLOSE(stats->mean_track, 17, 1e-12);
    CHECK_CLOSE(stats->mean_error, 0.5, 1e-6);
    CHECK_CLOSE(scene_depth_quantile(scene, 0.5), 10, 1e-9);
    CHECK(test_said.all[0] == 0); /* nothing to complain of */
}

TEST(scene_far_from_zero_loses_nothing)
{
    const double far = 4200000.25; /* UTM */
    const char *near_path = scene_survey("near", 9, 0, 1), *far_path = scene_survey("far", 9, far, 1);
    OWNED_SCENE *a = test_load(near_path, NULL);
    OWNED_SCENE *b = test_load(far_path, NULL);
    CHECK_CLOSE(oxl_scene_origin(b)[0] - oxl_scene_origin(a)[0], far, 1e-9);
    CHECK(fabs(oxl_scene_points(b)->position[0]) < 10);
    for (int i = 0; i < 4; i++)
        CHECK_CLOSE(oxl_scene_points(b)[i].position[0], oxl_scene_points(a)[i].position[0], 2e-9);
    for (int i = 0; i < 9; i++)
        for (int k = 0; k < 3; k++)
            CHECK_CLOSE(oxl_scene_view(b, i)->camera.translation[k],
                        oxl_scene_view(a, i)->camera.translation[k], 2e-9);
    CHECK_CLOSE(oxl_scene_extent(b), oxl_scene_extent(a), 1e-8);
}

/* The same quantile from a list in any order as from the sorted one: all different, many alike, all alike. */
TEST(measure_picks_without_sorting_what_sorting_would_find)
{
    enum { MOST = 500 };
    double value[MOST], sorted[MOST];
    for (int kinds = 1; kinds <= MOST; kinds *= 7)
        for (size_t n = 0; n <= MOST; n = 3 * n + 1)
            for (double quantile = 0; quantile <= 1; quantile += 1.0 / 16) {
                for (size_t i = 0; i < n; i++)
                    value[i] = sorted[i] = (double)(random_bits(3, i, n) % (uint64_t)kinds);
                if (n > 0) qsort(sorted, n, sizeof *sorted, stats_compare);
                CHECK(stats_select(value, n, quantile) == stats_quantile(sorted, n, quantile));
            }
}

TEST(scene_extent_is_that_of_3dgs_and_an_outlier_camera_does_not_change_it)
{
    oxl_view view[10] = {{0}};
    oxl_scene scene = {.view = view, .view_count = 9};
    double plain, robust;
    for (int i = 0; i < 10; i++) view[i].camera = test_camera(0, 0, 0, i < 9 ? i : -1e5, 0, 0);
    view[9].name = "far";
    CHECK_OK(stats_camera_radius(test_ctx, &scene, &plain));
    CHECK_CLOSE(plain, 4, 1e-12); /* cameras at 0..8, mean 4 */
    test_listen();
    scene.view_count = 10;
    CHECK_OK(stats_camera_radius(test_ctx, &scene, &robust));
    CHECK_CLOSE(robust, 4, 1e-12);
    CHECK_LOGGED("1 cameras, such as that of far, are far from all others");
}

/* Two thirds of the points in front of the cameras were seen by none of them: haze. */
TEST(scene_depths_are_of_points_that_were_seen)
{
    const char *path = scene_usual(9);
    OWNED_TEXT points = test_text();
    for (int i = 0; i < 4; i++) text_add(&points, "%d %d 0 10 1 2 3 0.5 11 0 12 0\n", i, i);
    for (int i = 4; i < 12; i++)
        text_add(&points, "%d %d 0 30 1 2 3 0.5 10 0\n", i, i); /* image 10 is for the test */
    test_write("s/sparse/0/points3D.txt", points.data);
    OWNED_SCENE *scene = test_load(path, NULL);
    CHECK_CLOSE(scene_depth_quantile(scene, 0), 10, 1e-9);
    CHECK_CLOSE(scene_depth_quantile(scene, 1), 10, 1e-9);
    CHECK_CLOSE(oxl_scene_near_plane(scene), 2, 1e-9);
}

/* Two sites far apart, each seen by its own cameras from 10 away. */
TEST(scene_extent_follows_the_depths_however_far_apart_two_sites_are)
{
    const char *path = scene_usual(9);
    struct text images = test_text(), points = test_text();
    for (int i = 0; i < 9; i++)
        text_add(&images, "%d 1 0 0 0 %d 0 0 1 img%02d.png\n1 2 1\n", 10 + i, i < 5 ? -i : -i - 5000, i);
    for (int i = 0; i < 8; i++)
        text_add(&points, "%d %d 0 10 1 2 3 0.5 %s\n", 1 + i, i % 4 + (i < 4 ? 0 : 5005),
                 i < 4 ? "11 0 12 0" : "15 0 16 0");
    test_write("s/sparse/0/images.txt", images.data);
    test_write("s/sparse/0/points3D.txt", points.data);
    text_free(&images), text_free(&points);
    OWNED_SCENE *scene = test_load(path, NULL);
    CHECK_CLOSE(oxl_scene_extent(scene), 13, 1e-9);
}

TEST(scene_of_one_image_trains_on_it_and_has_an_extent)
{
    OWNED_SCENE *scene = test_load(scene_survey("one", 1, 0, 1), NULL);
    CHECK(oxl_scene_view_count(scene) == 1 && !oxl_scene_view(scene, 0)->is_test);
    CHECK_CLOSE(oxl_scene_extent(scene), 13, 1e-9); /* 1.3 median depths */
}

TEST(scene_without_points_gets_random_ones_in_view)
{
    OWNED_MEMORY oxl_point *points = NULL, *again = NULL;
    size_t found;
    int seen = 0;
    const char *path = scene_survey("s", 9, 100, 1);
    test_write("s/sparse/0/points3D.txt", "# none\n");
    OWNED_SCENE *scene = test_load(path, NULL);
    CHECK(oxl_scene_point_count(scene) == 0 && oxl_scene_near_plane(scene) > 0);
    CHECK_CLOSE(oxl_scene_origin(scene)[0], 104, 1e-9);  /* the median camera */
    CHECK_CLOSE(oxl_scene_extent(scene), 1.1 * 3, 1e-9); /* training views stand at 101..107 */
    CHECK_OK(scene_start_points(test_ctx, scene, 500, &points, &found));
    CHECK_OK(scene_start_points(test_ctx, scene, 500, &again, &found));
    CHECK(found == 500 && points[0].rgb[0] == SCENE_GREY);
    CHECK(memcmp(points, again, 500 * sizeof *points) == 0);
    for (int i = 0; i < 500; i++)
        for (int v = 0, any = 0; v < 9 && !any; v++) {
            double x[3], pixel[2];
            seen += any = camera_sees(&oxl_scene_view(scene, v)->camera, points[i].position, x, pixel);
        }
    CHECK(seen == 500);
}

TEST(scene_missing_images_are_left_out_up_to_the_stated_fraction)
{
    const char *path = scene_usual(8);
    oxl_scene_options options = oxl_scene_options_default();
    remove(test_path("s/images/img02.png"));
    remove(test_path("s/images/img05.png"));
    test_listen();
    oxl_scene *scene = test_load(path, NULL);
    CHECK(oxl_scene_view_count(scene) == 6 && scene->stats.images_missing == 2);
    CHECK_LOGGED("images, and are left out: img02.png, img05.png");
    CHECK(scene_image(test_ctx, scene, 2)->rgb[0] == 4); /* img03: its own pose and image */
    CHECK_CLOSE(oxl_scene_view(scene, 2)->camera.translation[0] -
                    oxl_scene_view(scene, 0)->camera.translation[0],
                -3, 1e-12);
    oxl_scene_free(test_ctx, scene);
    options.missing_images = 0.2;
    CHECK(oxl_scene_load(test_ctx, path, &options, &scene) == OXL_ERR_INPUT && !scene);
    CHECK_SAYS("2 of the 8 images");
    CHECK_SAYS("by a larger --missing-images; or take them out of the file"); /* some were found */
}

/* Files that go while a model is evaluated: one of eight is left out, three are more than a quarter. */
TEST(scene_images_that_go_missing_are_left_out_of_an_evaluation_up_to_that_fraction)
{
    const char *path = scene_usual(8);
    oxl_scene_options options = oxl_scene_options_default();
    oxl_metrics metrics;
    options.test_every = 0;
    options.image_cache_bytes = 1;
    test_listen();
    OWNED_SCENE *scene = test_load(path, &options);
    OWNED_MODEL model = test_model(1, 0);
    remove(test_path("s/images/img02.png"));
    CHECK(test_evaluate(&model, scene, &test_imaging, OXL_SPLIT_TRAIN).count == 7);
    CHECK_LOGGED("img02.png");
    remove(test_path("s/images/img03.png"));
    remove(test_path("s/images/img05.png"));
    CHECK(oxl_evaluate(test_ctx, &model, scene, &test_imaging, OXL_SPLIT_TRAIN, &metrics) == OXL_ERR_IO);
}

TEST(scene_refuses_two_poses_for_one_image)
{
    const char *path = scene_usual(4);
    oxl_scene *scene;
    test_write("s/sparse/0/images.txt", "1 1 0 0 0 0 0 0 1 img00.png\n\n2 1 0 0 0 1 0 0 1 img01.png\n\n"
                                        "3 1 0 0 0 2 0 0 1 img00.png\n\n");
    test_write("s/sparse/0/points3D.txt", "1 0 0 10 1 2 3 0.5 1 0 2 0\n");
    CHECK_ERROR(oxl_scene_load(test_ctx, path, NULL, &scene), OXL_ERR_INPUT,
                "s/sparse/0/images.txt:5: img00.png appears twice, first in line 1");
}

/* Black is where the colour's clamp holds and stops the gradient: the model would stay black for good. */
TEST(scene_points_without_colours_are_said_to_have_none_and_do_not_start_black)
{
    static const struct {
        const char *second;
        int first, starts;
        const char *said;
    } cases[] = {
        {"255 255 255", 255, 255, "the points have no colours (all are 255 255 255), so they start so"},
        {"0 0 0", 0, SCENE_GREY, "the points have no colours (all are 0 0 0), so they start grey"},
        {"0 1 0", 0, 0, ""}};
    for (size_t i = 0; i < OXL_COUNT(cases); i++) {
        char points[200];
        const char *path = scene_usual(2);
        const int grey = cases[i].first;
        snprintf(points, sizeof points, "1 0 0 10 %d %d %d 0.5 10 0 11 0\n2 1 0 10 %s 0.5 10 0 11 0\n", grey,
                 grey, grey, cases[i].second);
        test_write("s/sparse/0/points3D.txt", points);
        test_listen();
        OWNED_SCENE *scene = test_load(path, NULL);
        CHECK_LOGGED(cases[i].said);
        CHECK(oxl_scene_points(scene)[0].rgb[1] == cases[i].starts);
        CHECK(oxl_scene_points(scene)[1].rgb[1] == (i == 2 ? 1 : cases[i].starts));
    }
}

/* Writes images of these names beside a model of those names; counts the views that are found. */
static int scene_found(const char *const *files, const char *const *names)
{
    const oxl_scene_options all = {.missing_images = 1, .max_side = 0, .test_every = 0, .read_images = 1};
    static int surveys;
    char folder[40];
    OWNED_TEXT t = test_text();
    OWNED_SCENE *scene = NULL;
    int found;
    snprintf(folder, sizeof folder, "named%d", surveys++);
    for (int i = 0; names[i]; i++) text_add(&t, "%d 1 0 0 0 0 0 %d 1 %s\n1 1 -1\n", i + 1, i, names[i]);
    test_write_colmap(test_path("%s/sparse", folder), "1 PINHOLE 16 16 16 16 8 8\n", t.data, "");
    for (int i = 0; files[i]; i++) {
        test_write(test_path("%s/images/%s", folder, files[i]), "");
    }
    found =
        oxl_scene_load(test_ctx, test_path(folder), &all, &scene) == OXL_OK ? oxl_scene_view_count(scene) : 0;
    return found;
}
#define SCENE_NAMES(...) ((const char *const[]){__VA_ARGS__, NULL})

TEST(scene_takes_the_file_that_ends_like_a_name_that_is_not_there)
{
    /* other folders, drives, case, extensions; one letter or two, Latin, Vietnamese, Cyrillic, kana, Hangul */
    static const char *const same[][2] = {
        {"IMG.jpg", "/home/a/b/IMG.jpg"},
        {"IMG.jpg", "D:\\dive 1\\IMG.JPG"},
        {"cam/IMG.jpg", "../x/cam/IMG.jpg"},
        {"dive1/IMG.JPG", "img.jpg"},
        {"IMG.jpg.jpg", "IMG.jpg"},
        {"IMG.JPG.png", "IMG.JPG"},
        {"IMG.png", "IMG.tif"},
        {"Ku\xCC\x88ste.jpg", "K\xC3\xBCste.jpg"},
        {"K\xC3\xBCste.jpg", "/x/Ku\xCC\x88ste.jpg"},
        {"a\xCC\xA3\xCC\x82.jpg", "\xE1\xBA\xAD.jpg"},
        {"\xD0\xB8\xCC\x86.jpg", "\xD0\xB9.jpg"},
        {"\xE3\x81\x8B\xE3\x82\x99.jpg", "\xE3\x81\x8C.jpg"},
        {"\xE1\x84\x92\xE1\x85\xA1\xE1\x86\xAB.jpg", "\xED\x95\x9C.jpg"},
    };
    for (size_t i = 0; i < OXL_COUNT(same); i++)
        CHECK(scene_found(SCENE_NAMES(same[i][0]), SCENE_NAMES(same[i][1])) == 1);
    CHECK(scene_found(SCENE_NAMES("a/1.jpg", "b/1.jpg"), SCENE_NAMES("x/a/1.jpg", "x/b/1.jpg")) == 2);
}

TEST(scene_takes_no_file_that_two_names_or_another_image_may_mean)
{
    CHECK(scene_found(SCENE_NAMES("a/1.jpg", "b/1.jpg"), SCENE_NAMES("1.jpg")) == 0);
    CHECK(scene_found(SCENE_NAMES("1.jpg", "2.jpg"), SCENE_NAMES("C:\\a\\1.jpg", "D:\\a\\1.jpg", "2.jpg")) ==
          1);
    CHECK(scene_found(SCENE_NAMES("a/1.jpg"), SCENE_NAMES("a/1.jpg", "b/1.jpg")) == 1);
    CHECK(scene_found(SCENE_NAMES("tur.jpg"), SCENE_NAMES("t\xC3\xBCr.jpg")) == 0);
    CHECK(scene_found(SCENE_NAMES("@eaDir/1.jpg", ".thumbnails/1.jpg", "2.jpg"),
                      SCENE_NAMES("1.jpg", "2.jpg")) == 1);
}

TEST(scene_takes_the_sub_model_with_most_images)
{
    oxl_scene_options options = oxl_scene_options_default();
    const char *path = scene_usual(3);
    options.read_images = 0;
    test_write_colmap(
        "s/sparse/1", "1 PINHOLE 32 24 40 40 16 12\n",
        "1 1 0 0 0 0 0 0 1 a\n\n2 1 0 0 0 0 0 0 1 b\n\n3 1 0 0 0 0 0 0 1 c\n\n4 1 0 0 0 0 0 0 1 d\n\n", "");
    test_listen();
    OWNED_SCENE *scene = test_load(path, &options);
    CHECK(oxl_scene_view_count(scene) == 4);
    CHECK_LOGGED("2 sub-models found");
    oxl_scene_free(test_ctx, scene);
    options.sparse = test_path("s/sparse/0");
    scene = test_load(path, &options);
    CHECK(oxl_scene_view_count(scene) == 3);
}

TEST(scene_is_found_beside_the_images_too_and_by_one_of_its_files)
{
    static const char *const paths[] = {"flat", "flat/images.txt"};
    oxl_scene_options options = oxl_scene_options_default();
    options.read_images = 0;
    test_write_colmap("flat", "1 PINHOLE 32 24 40 40 16 12\n", "1 1 0 0 0 0 0 0 1 a\n\n", "");
    for (size_t i = 0; i < OXL_COUNT(paths); i++) {
        OWNED_SCENE *scene = test_load(paths[i], &options);
        CHECK(oxl_scene_view_count(scene) == 1);
    }
}

TEST(scene_that_is_missing_is_refused_with_a_fix)
{
    oxl_scene *scene;
    CHECK_ERROR(oxl_scene_load(test_ctx, test_path("nothing"), NULL, &scene), OXL_ERR_INPUT,
                "nothing: there is no such folder");
    test_write("empty/readme", "");
    CHECK_ERROR(oxl_scene_load(test_ctx, test_path("empty"), NULL, &scene), OXL_ERR_INPUT, "no COLMAP model");
    CHECK_SAYS("by --sparse");
    test_write("binary/sparse/0/cameras.bin", "");
    test_write("binary/sparse/0/images.bin", "");
    test_write("binary/sparse/0/points3D.bin", "");
    CHECK_ERROR(oxl_scene_load(test_ctx, test_path("binary"), NULL, &scene), OXL_ERR_INPUT,
                "model_converter");
    CHECK(!scene);
}

TEST(scene_poses_and_cameras_that_cannot_be_are_refused)
{
    oxl_scene_options options = oxl_scene_options_default();
    oxl_scene *scene;
    const char *path = scene_survey("s", 3, 0, 0);
    options.read_images = 0;
    test_write("s/sparse/0/images.txt", "1 1 0 0 0 1e300 0 0 1 a\n\n");
    CHECK_ERROR(oxl_scene_load(test_ctx, path, &options, &scene), OXL_ERR_INPUT, "images.txt:1");
    test_write("s/sparse/0/images.txt", "1 1 0 0 0 0 0 0 1 a\n\n");
    test_write("s/sparse/0/cameras.txt", "1 PINHOLE 32 24 -40 40 16 12\n");
    CHECK_ERROR(oxl_scene_load(test_ctx, path, &options, &scene), OXL_ERR_INPUT, "cameras.txt:1");
}

TEST(scene_images_in_memory_stay_within_the_cache)
{
    const size_t one = 3 * 32 * 24;
    const char *path = scene_usual(5);
    oxl_scene_options options = oxl_scene_options_default();
    options.image_cache_bytes = 2 * one;
    OWNED_SCENE *scene = test_load(path, &options);
    for (int i = 0; i < 40; i++) {
        const int view = (int)(random_bits(1, (uint64_t)i, 0) % 5);
        const struct training_image *image = scene_image(test_ctx, scene, view);
        CHECK(image && image->rgb[0] == view + 1 && scene->cache->held <= 2 * one);
    }
    oxl_scene_free(test_ctx, scene);
    scene = test_load(path, &options);
    scene_image(test_ctx, scene, 0);
    scene_image(test_ctx, scene, 1);
    scene_image(test_ctx, scene, 0);
    /* an epoch asks for each once: the one asked for last is not wanted again for longest */
    scene_image(test_ctx, scene, 2);
    CHECK(!scene->cache->image[0].rgb && scene->cache->image[1].rgb && scene->cache->image[2].rgb);
    oxl_scene_free(test_ctx, scene);
    options.image_cache_bytes = 0; /* the one that was asked for stays all the same */
    scene = test_load(path, &options);
    CHECK(scene_image(test_ctx, scene, 3)->rgb[0] == 4 && scene->cache->held == one);
}

#ifdef _OPENMP
static int scene_inside, scene_met; /* threads in the caller's allocator; how often one met another there */

static void *scene_reallocate_watched(void *user, void *old, size_t size)
{
    void *memory;
    int others;
#pragma omp atomic capture
    others = scene_inside++;
    if (others) {
#pragma omp atomic
        scene_met++;
    }
    for (volatile int wait = 0; wait < 20000; wait++) continue; /* long enough for another to come */
    memory = counting_reallocate(user, old, size);
#pragma omp atomic
    scene_inside--;
    return memory;
}
#else
#define scene_reallocate_watched counting_reallocate
static const int scene_met = 0;
#endif

TEST(scene_reads_images_ahead_into_the_cache_and_no_further)
{
    enum { VIEWS = 7, ONE = 3 * 32 * 24 };
    const int order[VIEWS] = {3, 1, 6, 0, 2, 5, 4};
    const char *path = scene_usual(VIEWS);
    oxl_scene_options options = oxl_scene_options_default();
    test_ctx->threads = 4;
    test_ctx->options.reallocate = scene_reallocate_watched;
    oxl_scene *scene = test_load(path, &options);
    scene_images_ahead(test_ctx, scene, order, VIEWS);
    CHECK(scene->cache->held == 4 * ONE); /* one on each thread */
    for (int i = 0; i < VIEWS; i++) CHECK((scene->cache->image[order[i]].rgb != NULL) == (i < 4));
    scene_images_ahead(test_ctx, scene, order, VIEWS); /* the first is there: nothing is to be done */
    CHECK(scene->cache->held == 4 * ONE);
    scene_images_ahead(test_ctx, scene, order + 4, VIEWS - 4);
    for (int i = 0; i < VIEWS; i++)
        CHECK(scene->cache->image[i].rgb && scene->cache->image[i].rgb[0] == i + 1);
    oxl_scene_free(test_ctx, scene);

    /* a quarter of it, two images and what decoding takes, may be on its way */
    options.image_cache_bytes = 16 * ONE;
    scene = test_load(path, &options);
    scene_images_ahead(test_ctx, scene, order, VIEWS);
    CHECK(scene->cache->held == 2 * ONE);
    scene_set_cache(scene, 4 * ONE - 1);
    for (int i = 0; i < VIEWS; i++) {
        scene_images_ahead(test_ctx, scene, order + i, VIEWS - i); /* not two at once */
        CHECK(scene_image(test_ctx, scene, order[i])->rgb[0] == order[i] + 1);
        CHECK(scene->cache->held < 4 * ONE);
    }
    oxl_scene_free(test_ctx, scene);
    CHECK(scene_met == 0);
    test_ctx->options.reallocate = counting_reallocate;
}

TEST(scene_images_read_ahead_are_the_last_to_leave_the_cache)
{
    enum { VIEWS = 20, ONE = 3 * 32 * 24 };
    const int ahead[2] = {17, 18};
    const char *path = scene_usual(VIEWS);
    oxl_scene_options options = oxl_scene_options_default();
    test_ctx->threads = 2;
    options.image_cache_bytes = 16 * ONE;
    OWNED_SCENE *scene = test_load(path, &options);
    for (int i = 0; i < 16; i++) scene_image(test_ctx, scene, i);
    scene_images_ahead(test_ctx, scene, ahead, 2);
    CHECK(scene->cache->held == 14 * ONE && scene->cache->image[17].rgb && scene->cache->image[18].rgb &&
          scene->cache->image[11].rgb && !scene->cache->image[12].rgb);
    for (int i = 10; i < 16; i++) scene_image(test_ctx, scene, i);
    CHECK(scene->cache->image[17].rgb && scene->cache->image[18].rgb && scene->cache->held == 16 * ONE);
}

TEST(scene_image_that_is_corrupt_is_named_when_it_is_asked_for_and_the_rest_goes_on)
{
    const int order[3] = {1, 0, 2};
    const char *path = scene_usual(3);
    oxl_image image;
    test_write("s/images/img01.png", "no image");
    test_ctx->threads = 3;
    OWNED_SCENE *scene = test_load(path, NULL);
    test_ctx->error[0] = 0;
    scene_images_ahead(test_ctx, scene, order, 3);
    CHECK(test_ctx->error[0] == 0 && !scene->cache->image[1].rgb && scene->cache->image[0].rgb &&
          scene->cache->image[2].rgb);
    CHECK(scene_image(test_ctx, scene, 1) == NULL);
    CHECK_SAYS("img01.png");
    CHECK(oxl_scene_image(test_ctx, scene, 1, NULL, &image) == OXL_ERR_INPUT);
    CHECK_OK(oxl_scene_image(test_ctx, scene, 2, NULL, &image));
    CHECK(image.width == 32 && image.height == 24 && !image.weight);
    oxl_image_free(test_ctx, &image);
    CHECK(oxl_scene_image(test_ctx, scene, 3, NULL, &image) == OXL_ERR_USAGE);
}

TEST(scene_masks_are_found_by_name_with_or_without_the_extension)
{
    const char *path = scene_usual(4);
    oxl_image image = test_image(2, 1);
    for (int c = 0; c < 3; c++) image.rgb[2 * c + 1] = 1; /* the left half is black */
    test_make_folder("s/masks");
    test_write_image("s/masks/img00.png.png", &image);
    test_write_image("s/masks/img02.png", &image);
    oxl_image_free(test_ctx, &image);
    OWNED_SCENE *scene = test_load(path, NULL);
    CHECK(scene->stats.masks == 2);
    for (int i = 0; i < 4; i++) {
        CHECK_OK(oxl_scene_image(test_ctx, scene, i, NULL, &image));
        CHECK((image.weight != NULL) == (i % 2 == 0));
        if (image.weight)
            CHECK(image.weight[0] == 0 && image.weight[15] == 0 && image.weight[16] == 1 &&
                  image.weight[31] == 1);
        oxl_image_free(test_ctx, &image);
    }
}

TEST(scene_images_are_reduced_to_the_longer_side_asked_for)
{
    const char *path = scene_usual(2);
    oxl_scene_options options = oxl_scene_options_default();
    options.max_side = 16;
    OWNED_SCENE *scene = test_load(path, &options);
    const oxl_camera *c = &oxl_scene_view(scene, 0)->camera;
    CHECK(c->width == 16 && c->height == 12 && c->fx == 20 && c->fy == 20 && c->cx == 8 && c->cy == 6);
    CHECK(scene_image(test_ctx, scene, 0)->width == 16 && scene_image(test_ctx, scene, 0)->rgb[0] == 1);
    oxl_scene_free(test_ctx, scene);
    test_write("s/sparse/0/cameras.txt",
               "1 PINHOLE 320 240 400 400 160 120\n"); /* the files were made 10 x smaller */
    scene = test_load(path, NULL);
    c = &oxl_scene_view(scene, 0)->camera;
    CHECK(c->width == 32 && c->height == 24 && c->fx == 40 && c->cx == 16);
}

TEST(scene_from_arrays_is_sorted_and_keeps_what_it_was_given)
{
    oxl_view view[3];
    oxl_image image[3];
    oxl_point point = {.position = {1, 0.5, 3}, .rgb = {9, 8, 7}};
    oxl_scene *scene;
    for (int i = 0; i < 3; i++) {
        view[i] = (oxl_view){.name = i == 0 ? "c" : i == 1 ? "a" : "b", .is_test = i == 2};
        view[i].camera = test_camera(4, 2, 4, -i, 0, 0);
        image[i] = test_image(4, 2);
        for (int k = 0; k < 24; k++) image[i].rgb[k] = (float)(10 * i + k) / 255.0f;
    }
    image[1].weight = oxl_calloc(test_ctx, 8, sizeof(float));
    image[1].weight[3] = 1;
    CHECK_OK(oxl_scene_from_arrays(test_ctx, view, image, 3, &point, 1, &scene));
    CHECK(strcmp(oxl_scene_view(scene, 0)->name, "a") == 0 &&
          strcmp(oxl_scene_view(scene, 2)->name, "c") == 0);
    CHECK(oxl_scene_view(scene, 1)->is_test && !oxl_scene_view(scene, 0)->is_test &&
          scene->stats.test_views == 1);
    CHECK(scene_image(test_ctx, scene, 0)->rgb[5] == 15 && scene_image(test_ctx, scene, 0)->mask[3] == 255 &&
          scene_image(test_ctx, scene, 0)->mask[4] == 0);
    CHECK(!scene_image(test_ctx, scene, 2)->mask && scene_image(test_ctx, scene, 2)->rgb[23] == 23);
    CHECK(oxl_scene_points(scene)->position[2] == 3 && oxl_scene_points(scene)->rgb[0] == 9 &&
          oxl_scene_origin(scene)[0] == 0);
    CHECK_CLOSE(scene_depth_quantile(scene, 0.5), 3, 1e-12); /* by projection: there are no tracks */
    CHECK(scene_colmap(scene) == NULL);
    oxl_scene_free(test_ctx, scene);
    view[1].camera.width = 5;
    CHECK(oxl_scene_from_arrays(test_ctx, view, image, 3, &point, 1, &scene) == OXL_ERR_USAGE && !scene);
    CHECK(oxl_scene_from_arrays(test_ctx, view, image, 0, NULL, 0, &scene) == OXL_ERR_USAGE);
    for (int i = 0; i < 3; i++) oxl_image_free(test_ctx, &image[i]);
}

TEST(scene_from_arrays_refuses_poses_that_are_none_and_equal_names)
{
    enum { NAN_TURN, NAN_MOVE, FAR, TWICE, MIRRORED, SHEARED, SAME_NAME, CASES };
    for (int k = 0; k < CASES; k++) {
        oxl_view view[2] = {{.name = "a"}, {.name = k == SAME_NAME ? "a" : "b"}};
        oxl_image image[2] = {test_image(4, 2), test_image(4, 2)};
        oxl_scene *scene;
        for (int v = 0; v < 2; v++) view[v].camera = test_camera(4, 2, 4, -v, 0, 0);
        double *r = view[1].camera.rotation;
        if (k == NAN_TURN) r[4] = NAN;
        if (k == NAN_MOVE) view[1].camera.translation[1] = INFINITY;
        if (k == FAR) view[1].camera.translation[2] = 1e16;
        for (int i = 0; i < 9 && k == TWICE; i++) r[i] *= 2;
        for (int i = 0; i < 3 && k == MIRRORED; i++) r[i] = -r[i];
        if (k == SHEARED) r[1] += 0.1;
        CHECK_ERROR(oxl_scene_from_arrays(test_ctx, view, image, 2, NULL, 0, &scene), OXL_ERR_USAGE,
                    k == SAME_NAME ? "two views have the name 'a'" : "view b: its pose is no rotation");
        CHECK_SAYS("\nfix: ");
        for (int v = 0; v < 2; v++) oxl_image_free(test_ctx, &image[v]);
    }
}

TEST(scene_frees_all_memory_when_any_allocation_fails)
{
    const char *path = scene_usual(3);
    int failures = 0;
    for (long n = 0; n < 400; n++) {
        OWNED_SCENE *scene;
        allocations_left = n;
        oxl_result rc = oxl_scene_load(test_ctx, path, NULL, &scene);
        if (rc == OXL_OK && !scene_image(test_ctx, scene, 0)) rc = OXL_ERR_MEMORY;
        allocations_left = LONG_MAX;
        failures += rc != OXL_OK;
    }
    CHECK(failures > 20);
}

TEST(scene_of_a_real_dive_is_read_and_undistorted)
{
    const char *path = test_shared("data/subvo_pool_distorted");
    if (!path) SKIP("no ../shared/data");
    OWNED_SCENE *scene = test_load(path, NULL);
    CHECK(oxl_scene_view_count(scene) == 61 && scene->stats.test_views == 8 &&
          oxl_scene_point_count(scene) == 16462);
    CHECK(oxl_scene_view(scene, 0)->camera.width == 1028 && oxl_scene_view(scene, 0)->camera.height == 520);
    CHECK(scene->colmap.camera_count == 1 && camera_is_distorted(scene->colmap.camera));
    CHECK_CLOSE(scene->stats.mean_error, 0.383, 0.001);
    CHECK(scene_image(test_ctx, scene, 5) != NULL);
}

/* ---------------- transparent pixels */

/* Every image of scene_survey again, transparent left of column `from` and from column `to` on. */
static void scene_make_transparent(const char *name, int n, int from, int to)
{
    for (int i = 0; i < n; i++) {
        OWNED_IMAGE image = test_image(32, 24);
        image.weight = oxl_calloc(test_ctx, 32 * 24, sizeof *image.weight);
        for (int k = 0; k < 3 * 32 * 24; k++) image.rgb[k] = 0.2f;
        for (int k = 0; k < 32 * 24; k++) image.weight[k] = k % 32 >= from && k % 32 < to;
        CHECK_OK(oxl_image_write_alpha(test_ctx, test_path("%s/images/img%02d.png", name, i), &image));
    }
}

/* The points of scene_survey lie in columns 4 to 28 of its three images, none left of column 4. */
TEST(scene_masks_transparent_pixels_where_points_are_and_composites_them_elsewhere)
{
    static const struct {
        int from, to, masks;
    } cases[] = {{3, 32, 0}, {18, 32, 1}, {0, 14, 1}};
    const float black[3] = {0, 0, 0};
    for (size_t k = 0; k < OXL_COUNT(cases); k++) {
        OWNED_IMAGE image = {0};
        const char *path = scene_survey("alpha", 3, 0, 1);
        scene_make_transparent("alpha", 3, cases[k].from, cases[k].to);
        test_listen();
        OWNED_SCENE *scene = test_load(path, NULL);
        CHECK(scene->transparent == 3 && scene->alpha_masks == cases[k].masks);
        CHECK_LOGGED(cases[k].masks ? "images are masked: " : "images are composited over");
        CHECK_OK(oxl_scene_image(test_ctx, scene, 0, NULL, &image));
        CHECK((image.weight != NULL) == cases[k].masks);
        CHECK(cases[k].masks || (image.rgb[0] == 1 && image.rgb[16] == 51 / 255.0f));
        oxl_image_free(test_ctx, &image);
        CHECK_OK(oxl_scene_image(test_ctx, scene, 0, black, &image));
        CHECK(cases[k].masks || image.rgb[0] == 0);
    }
}

TEST(scene_alpha_is_what_the_option_says)
{
    oxl_scene_options options = oxl_scene_options_default();
    const float none[3] = {-1, -1, -1}, grey[3] = {0.5f, 0.5f, 0.5f};
    for (options.alpha = OXL_ALPHA_COMPOSITE; options.alpha <= OXL_ALPHA_MASK; options.alpha++) {
        float rgb[3];
        const char *path = scene_survey("alpha", 3, 0, 1);
        scene_make_transparent("alpha", 3, 3, 14);
        OWNED_SCENE *scene = test_load(path, &options);
        CHECK(scene->alpha_masks == (options.alpha == OXL_ALPHA_MASK));
        scene_background(scene, none, rgb);
        CHECK(rgb[0] == !scene->alpha_masks && rgb[2] == rgb[0]);
        scene_background(scene, grey, rgb); /* of a composited image's 8 bits */
        CHECK(rgb[1] == (scene->alpha_masks ? 0.5f : 128 / 255.0f));
    }
}

/* Cameras on a circle look at a red ball of radius 1 in the middle; transparent elsewhere. */
static const char *scene_ball(int transparent)
{
    OWNED_TEXT images = test_text();
    test_make_folder("ball/images");
    for (int i = 0; i < 12; i++) {
        const double half = i * 3.14159265358979 / 12;
        text_add(&images, "%d %.17g 0 %.17g 0 0 0 5 1 %02d.png\n\n", i + 1, cos(half), sin(half), i);
        OWNED_IMAGE image = test_image(32, 32);
        image.weight = oxl_calloc(test_ctx, 32 * 32, sizeof *image.weight);
        for (int k = 0; k < 32 * 32; k++) {
            const double x = k % 32 - 15.5, y = k / 32 - 15.5;
            image.weight[k] = !transparent && x * x + y * y < 6.5 * 6.5; /* 32 px x tan(asin(1/5)) */
            image.rgb[k] = image.weight[k];
        }
        CHECK_OK(oxl_image_write_alpha(test_ctx, test_path("ball/images/%02d.png", i), &image));
    }
    test_write_colmap("ball/sparse/0", "1 PINHOLE 32 32 32 32 16 16\n", images.data, "# none\n");
    return test_path("ball");
}

TEST(scene_without_points_starts_within_the_outlines_of_its_images)
{
    for (int transparent = 0; transparent < 2; transparent++) { /* all of it: the outlines are of no use */
        oxl_point *points = NULL;
        size_t found = 0;
        int outside = 0;
        OWNED_SCENE *scene = test_load(scene_ball(transparent), NULL);
        CHECK_OK(scene_start_points(test_ctx, scene, 300, &points, &found));
        CHECK(found == 300);
        for (size_t i = 0; i < found && !transparent; i++) {
            const double *x = points[i].position, *o = oxl_scene_origin(scene);
            /* the hull of views around the y axis, with a pixel's margin; cones of few views reach farther */
            outside += !(hypot(x[0] + o[0], x[2] + o[2]) < 1.3 && fabs(x[1] + o[1]) < 1.3);
            CHECK(points[i].rgb[0] > 200 && points[i].rgb[1] < 100);
        }
        CHECK(outside <= 6);
        CHECK(!transparent || points[0].rgb[1] == SCENE_GREY);
        oxl_free(test_ctx, points);
    }
}
