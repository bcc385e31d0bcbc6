/* test_poses.c - camera poses that are refined while training: the gradient, the part, its files. */
#include "test.h"
#include "wide.h"

enum { POSES_WIDTH = 14, POSES_HEIGHT = 11 };

static double poses_random(uint64_t seed, uint64_t i)
{
    return 2 * random_unit(random_bits(seed, i, 0)) - 1;
}

/* Wide soft Gaussians, as in test_gradient.c: the image is smooth in the pose. */
static void poses_smooth_scene(struct wide *r, int count, int lobes, int degree)
{
    oxl_camera camera = {.width = POSES_WIDTH, .height = POSES_HEIGHT, .fx = 12, .fy = 13, .cx = 6, .cy = 6};
    camera_rotation_from_quaternion((double[4]){0.95, 0.1, -0.15, 0.2}, camera.rotation);
    camera.translation[0] = 0.1, camera.translation[1] = -0.05, camera.translation[2] = 3;
    wide_create(r, &camera, (size_t)count, (size_t)lobes, degree);
    for (int i = 0; i < count; i++)
        for (int k = 0; k < OXL_PLANES; k++) {
            const double u = poses_random(5, (uint64_t)(i * OXL_PLANES + k));
            if (r->plane[k] && (k < OXL_LOBE || i < lobes))
                r->plane[k][i] = k < OXL_LOG_SCALE  ? 0.3 * u
                                 : k < OXL_ROTATION ? 0.5 + 0.3 * u
                                 : k < OXL_OPACITY  ? u + (k == OXL_ROTATION)
                                 : k < OXL_SH       ? -1 + 0.5 * u
                                 : k < OXL_SH + 3   ? 0.5 + 0.5 * u
                                 : k < OXL_LOBE     ? 0.1 * u
                                                    : -(k == OXL_LOBE) + 0.3 * u;
        }
}

/* The camera with all Gaussians turned about its centre by w, and its centre moved. */
static oxl_camera poses_moved(const oxl_camera *from, const double at[POSE_SUMS])
{
    oxl_camera c = *from;
    double eye[3], turn[9];
    camera_position(from, eye);
    camera_rotation_from_quaternion((double[4]){1, at[0] / 2, at[1] / 2, at[2] / 2}, turn);
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) {
            c.rotation[3 * i + k] = 0;
            for (int m = 0; m < 3; m++) c.rotation[3 * i + k] += from->rotation[3 * i + m] * turn[3 * m + k];
        }
    for (int i = 0; i < 3; i++) {
        c.translation[i] = 0;
        for (int k = 0; k < 3; k++) c.translation[i] -= c.rotation[3 * i + k] * (eye[k] + at[3 + k]);
    }
    return c;
}

static double poses_loss(struct wide *r)
{
    double sum = 0;
    kernels_forward(r);
    for (size_t i = 0; i < 3 * POSES_WIDTH * POSES_HEIGHT; i++) sum += poses_random(6, i) * r->rgb[i];
    return sum;
}

/* Worst |finite - analytic| / largest |analytic| of the six, central differences of fourth order. */
static double poses_worst(struct wide *r)
{
    const oxl_camera camera = r->camera;
    const double h = 1e-4;
    double drgb[3 * POSES_WIDTH * POSES_HEIGHT], worst = 0, scale = 0;
    for (size_t i = 0; i < OXL_COUNT(drgb); i++) drgb[i] = poses_random(6, i);
    kernels_backward(r, drgb);
    for (int k = 0; k < POSE_SUMS; k++) {
        double f[4];
        for (int n = 0; n < 4; n++) {
            double at[POSE_SUMS] = {0};
            at[k] = h * (n < 2 ? n - 2 : n - 1);
            r->camera = poses_moved(&camera, at);
            f[n] = poses_loss(r);
        }
        worst = OXL_MAX(worst, fabs((f[0] - 8 * f[1] + 8 * f[2] - f[3]) / (12 * h) - r->dpose[k]));
        scale = OXL_MAX(scale, fabs(r->dpose[k]));
    }
    r->camera = camera;
    return worst / scale;
}

TEST(poses_gradient_agrees_with_finite_differences)
{
    for (int degree = 0; degree <= 3; degree += 3)
        for (int lobes = 0; lobes <= 4; lobes += 4) {
            struct wide r;
            poses_smooth_scene(&r, 6, lobes, degree);
            CHECK(kernels_forward(&r) == 6);
            CHECK(poses_worst(&r) < 1e-8);
            r.antialias = 1;
            CHECK(poses_worst(&r) < 1e-8);
            wide_free(&r);
        }
}

TEST(poses_gradient_is_exact_where_the_frustum_clamp_holds)
{
    struct wide r;
    poses_smooth_scene(&r, 4, 0, 1);
    r.camera.fx = r.camera.fy = 600; /* all of them lie outside */
    CHECK(poses_worst(&r) < 1e-8);
    wide_free(&r);
}

/* ---------------- the file */

TEST(poses_are_read_as_they_were_written)
{
    oxl_scene *scene = train_scene(5);
    const oxl_camera given = oxl_scene_view(scene, 2)->camera;
    const double at[POSE_TERMS] = {0.001, -0.0023456789012345, 1.0 / 3, 1e-9, -12.5, 0};
    oxl_camera moved = given, now;
    struct oxl_imaging m = {0};
    m.pose = oxl_calloc(test_ctx, 5, sizeof *m.pose);
    memcpy(m.pose[2], at, sizeof at);
    CHECK(imaging_is_needed(&m));
    CHECK_OK(oxl_imaging_write(test_ctx, test_path("imaging.txt"), scene, &m));
    CHECK_OK(test_read_imaging(scene, test_path("model.ply")));
    pose_apply(&given, at, &moved);
    now = scene_camera(scene, &test_imaging, 2);
    CHECK(memcmp(&now, &moved, sizeof moved) == 0);
    CHECK(memcmp(test_imaging.pose[2], at, sizeof at) == 0 && test_imaging.pose[1][0] == 0);
    test_write("imaging.txt", "# of a model with the survey's poses\n");
    CHECK_OK(test_read_imaging(scene, test_path("model.ply")));
    now = scene_camera(scene, &test_imaging, 2);
    CHECK(memcmp(&now, &given, sizeof given) == 0 && !test_imaging.pose);
    imaging_free(test_ctx, &m);
    oxl_scene_free(test_ctx, scene);
}

TEST(poses_of_a_damaged_file_are_refused_and_those_of_other_views_passed_over)
{
    static const char *const broken[] = {"pose 0 0 0 0 0 v01.png\n", "pose 2 0 0 0 0 0 v01.png\n",
                                         "pose 0 0 0 nan 0 0 v01.png\n", "pose 0 0 0 0 0 1e99 v01.png\n"};
    oxl_scene *scene = train_scene(3);
    for (size_t i = 0; i < OXL_COUNT(broken); i++) {
        test_write("imaging.txt", broken[i]);
        CHECK(test_read_imaging(scene, test_path("model.ply")) == OXL_ERR_INPUT);
        CHECK_TEXT(oxl_error_text(test_ctx), "imaging.txt:1: ");
    }
    test_write("imaging.txt", "pose 0.1 0 0 0 0 0 another.png\n");
    CHECK_OK(test_read_imaging(scene, test_path("model.ply")));
    CHECK(test_imaging.pose && !pose_is_moved(test_imaging.pose[1]));
    oxl_scene_free(test_ctx, scene);
}

TEST(poses_turn_and_move_the_camera_in_its_own_axes)
{
    const double at[POSE_TERMS] = {0, 0.02, 0, 0, 0, 0.5}; /* to the left, and ahead */
    oxl_camera c = {.rotation = {0, 0, 1, 0, 1, 0, -1, 0, 0}, .translation = {1, 2, 3}}, moved = c;
    double eye[3], ahead[3], along = 0;
    pose_apply(&c, at, &moved);
    camera_position(&c, eye);
    camera_position(&moved, ahead);
    for (int k = 0; k < 3; k++) along += (ahead[k] - eye[k]) * c.rotation[6 + k];
    CHECK_CLOSE(along, 0.5, 1e-12);
    /* what lay ahead lies to the right: x = z sin */
    CHECK_CLOSE(moved.rotation[0] * c.rotation[6] + moved.rotation[1] * c.rotation[7] +
                    moved.rotation[2] * c.rotation[8],
                0.02, 1e-5);
}

/* ---------------- training */

enum { POSES_VIEWS = 9 };

/* The scene of test_train.c with noise on the poses of its training views; its own poses in `truth`. */
static oxl_scene *poses_noisy_scene(double turn, double move, oxl_camera truth[POSES_VIEWS])
{
    oxl_scene *scene = train_scene(POSES_VIEWS);
    for (int v = 0; v < POSES_VIEWS; v++) {
        double at[POSE_TERMS];
        truth[v] = scene->view[v].camera;
        for (int k = 0; k < POSE_TERMS; k++)
            at[k] = (k < 3 ? turn : move) * poses_random(21, (uint64_t)(POSE_TERMS * v + k));
        if (!scene->view[v].is_test) pose_apply(&truth[v], at, &scene->view[v].camera);
    }
    return scene;
}

/* Root of the mean square of the shift of what lies on the axis, px. */
static double poses_error(const oxl_scene *scene, const oxl_camera truth[POSES_VIEWS])
{
    double sum = 0;
    int count = 0;
    for (int v = 0; v < POSES_VIEWS; v++) {
        const oxl_camera moved = scene_camera(scene, &test_imaging, v), *c = &moved;
        double world[3], x[3], pixel[2];
        if (scene->view[v].is_test) continue;
        camera_unproject(&truth[v], (double[2]){truth[v].cx, truth[v].cy}, 3, world);
        CHECK(camera_project(c, world, NULL, x, pixel));
        sum += (pixel[0] - c->cx) * (pixel[0] - c->cx) + (pixel[1] - c->cy) * (pixel[1] - c->cy);
        count++;
    }
    return sqrt(sum / count);
}

TEST(poses_that_are_off_by_a_pixel_are_found)
{
    oxl_camera truth[POSES_VIEWS];
    oxl_scene *scene = poses_noisy_scene(0.02, 0.03, truth);
    oxl_train_options options = train_options(300);
    oxl_model model;
    double before, psnr;
    NEEDS_PART(poses);
    before = poses_error(scene, truth);
    CHECK_OK(test_train(scene, &options, NULL, &model));
    CHECK(poses_error(scene, truth) == before);
    psnr = train_psnr(scene, &model);
    oxl_model_free(test_ctx, &model);
    options.poses = OXL_ON;
    CHECK_OK(test_train(scene, &options, NULL, &model));
    CHECK(poses_error(scene, truth) < 0.5 * before);
    CHECK(train_psnr(scene, &model) > psnr + 1);
    oxl_model_free(test_ctx, &model);
    oxl_scene_free(test_ctx, scene);
}

TEST(poses_of_a_run_stopped_at_any_step_end_in_the_same_bytes)
{
    static const int stops[] = {3, 30, 61};
    oxl_camera truth[POSES_VIEWS];
    struct checkpoint_case c = checkpoint_of(poses_noisy_scene(0.02, 0.03, truth), train_options(90));
    double whole[POSES_VIEWS][POSE_TERMS];
    oxl_model model;
    NEEDS_PART(poses);
    c.options.poses = OXL_ON;
    CHECK_OK(test_train(c.scene, &c.options, NULL, &c.whole));
    memcpy(whole, test_imaging.pose, sizeof whole);
    CHECK(pose_is_moved(whole[0]));
    for (size_t i = 0; i < OXL_COUNT(stops); i++) {
        CHECK(checkpoint_run(&c, "key", stops[i], &model) == OXL_ERR_INTERRUPTED);
        oxl_model_free(test_ctx, &model);
    }
    CHECK_OK(checkpoint_run(&c, "key", -1, &model));
    CHECK(train_same(&model, &c.whole) && memcmp(whole, test_imaging.pose, sizeof whole) == 0);
    oxl_model_free(test_ctx, &model);
    checkpoint_case_free(&c);
}

/* ---------------- poses moved onto the points that their images saw */

enum { RESECT_POINTS = 40 };
struct resect_case {
    oxl_camera given;
    struct colmap_camera lens;
    struct colmap_sighting seen[RESECT_POINTS];
    double truth[POSE_TERMS]; /* pose from which the points were seen */
};
static const double resect_origin[3] = {100, -50, 20};

/* Points before a camera of the model, with the parameters behind fx fy cx cy. */
static struct resect_case resect_case_of(const char *model, double distortion)
{
    struct resect_case c = {.given = {.width = 200, .height = 150, .fx = 150, .fy = 150}};
    oxl_camera moved;
    c.lens = (struct colmap_camera){.model = camera_model_find(model, strlen(model)),
                                    .width = 200,
                                    .height = 150,
                                    .parameter = {150, 160, 100, 75}};
    for (int k = 4; k < 16; k++) c.lens.parameter[k] = distortion * poses_random(3, (uint64_t)k);
    camera_rotation_from_quaternion((double[4]){0.9, 0.2, -0.3, 0.1}, c.given.rotation);
    for (int k = 0; k < 3; k++) c.given.translation[k] = 0.3 * k;
    for (int k = 0; k < POSE_TERMS; k++) c.truth[k] = (k < 3 ? 0.02 : 0.1) * poses_random(4, (uint64_t)k);
    moved = c.given;
    pose_apply(&c.given, c.truth, &moved);
    for (int i = 0; i < RESECT_POINTS; i++) {
        const double z = 4 + 2 * poses_random(7, (uint64_t)i),
                     x[3] = {0.5 * z * poses_random(8, (uint64_t)i), 0.4 * z * poses_random(9, (uint64_t)i),
                             z};
        double e[2], j[2][POSE_TERMS];
        const struct resect r = {.lens = &c.lens, .origin = resect_origin};
        for (int k = 0; k < 3; k++) {
            c.seen[i].world[k] = resect_origin[k];
            for (int n = 0; n < 3; n++)
                c.seen[i].world[k] += moved.rotation[3 * n + k] * (x[n] - moved.translation[n]);
        }
        CHECK(resect_residual(&r, &moved, &c.seen[i], e, j));
        memcpy(c.seen[i].pixel, e, sizeof e); /* e was the pixel, as seen from 0 */
    }
    return c;
}

static const struct resect_lens {
    const char *model;
    double distortion;
} resect_lenses[] = {{"PINHOLE", 0}, {"OPENCV", 0.05}, {"OPENCV_FISHEYE", 0.05}, {"FULL_OPENCV", 0.03}};

TEST(resect_derivatives_agree_with_finite_differences)
{
    for (size_t m = 0; m < OXL_COUNT(resect_lenses); m++) {
        const struct resect_case c = resect_case_of(resect_lenses[m].model, resect_lenses[m].distortion);
        const struct resect r = {.lens = &c.lens, .origin = resect_origin};
        double worst = 0;
        for (int i = 0; i < RESECT_POINTS; i++)
            for (int k = 0; k < POSE_TERMS; k++) {
                const double h = 1e-5;
                double j[2][POSE_TERMS], unused[2][POSE_TERMS], e[2][2], at[POSE_TERMS] = {0};
                oxl_camera now = c.given;
                CHECK(resect_residual(&r, &c.given, &c.seen[i], e[0], j));
                for (int s = 0; s < 2; s++) {
                    at[k] = s ? h : -h;
                    pose_apply(&c.given, at, &now);
                    CHECK(resect_residual(&r, &now, &c.seen[i], e[s], unused));
                }
                for (int n = 0; n < 2; n++)
                    worst = OXL_MAX(worst, fabs((e[1][n] - e[0][n]) / (2 * h) - j[n][k]));
            }
        CHECK(worst < 1e-5); /* of derivatives up to 200 px a rad */
    }
}

TEST(resect_finds_the_pose_of_any_lens_though_a_tenth_of_the_points_are_wrong)
{
    for (size_t m = 0; m < OXL_COUNT(resect_lenses); m++)
        for (int wrong = 0; wrong < 2; wrong++) {
            struct resect_case c = resect_case_of(resect_lenses[m].model, resect_lenses[m].distortion);
            const struct resect r = {.given = &c.given,
                                     .lens = &c.lens,
                                     .origin = resect_origin,
                                     .seen = c.seen,
                                     .count = RESECT_POINTS,
                                     .limit = 0.05};
            struct resect_found f;
            double at[POSE_TERMS];
            for (int i = 0; i < RESECT_POINTS && wrong; i += 10) c.seen[i].pixel[i % 20 / 10] += 30;
            f = resect(&r, at);
            for (int k = 0; k < POSE_TERMS; k++) CHECK_CLOSE(at[k], c.truth[k], wrong ? 3e-3 : 1e-7);
            CHECK(f.shift > 1 && f.after < f.before && (wrong || f.after < 1e-10));
        }
}

/* Flat ground from above, whose images a program has reduced to two thirds without their 2D points: from lower
 * and aside, the camera would see all points where these are. */
TEST(resect_does_not_hold_where_2d_points_are_those_of_larger_images)
{
    for (int reduced = 0; reduced < 2; reduced++) {
        struct resect_case c = resect_case_of("PINHOLE", 0);
        const struct resect r = {.given = &c.given,
                                 .lens = &c.lens,
                                 .origin = resect_origin,
                                 .seen = c.seen,
                                 .count = RESECT_POINTS,
                                 .limit = 1};
        struct resect_found f;
        double at[POSE_TERMS], e[2], j[2][POSE_TERMS];
        for (int i = 0; i < RESECT_POINTS; i++) {
            const double x[3] = {2 * poses_random(8, (uint64_t)i), 1.5 * poses_random(9, (uint64_t)i), 5};
            for (int k = 0; k < 3; k++) {
                c.seen[i].world[k] = resect_origin[k];
                for (int n = 0; n < 3; n++)
                    c.seen[i].world[k] += c.given.rotation[3 * n + k] * (x[n] - c.given.translation[n]);
                if (k < 2) c.seen[i].pixel[k] = 0;
            }
            CHECK(resect_residual(&r, &c.given, &c.seen[i], e, j));
            for (int k = 0; k < 2; k++) c.seen[i].pixel[k] = (reduced ? 1.5 : 1.01) * e[k];
        }
        f = resect(&r, at);
        CHECK(f.before > 0.1 && f.after < 1e-6); /* all fit */
        CHECK(resect_holds(&r, &f, at) == !reduced);
    }
}

TEST(resect_counts_distances_beyond_the_limit_linearly)
{
    struct resect_case c = resect_case_of("PINHOLE", 0);
    const struct resect r = {.given = &c.given,
                             .lens = &c.lens,
                             .origin = resect_origin,
                             .seen = c.seen,
                             .count = RESECT_POINTS,
                             .limit = 1};
    double at[POSE_TERMS], e[2], j[2][POSE_TERMS];
    for (int i = 0; i < RESECT_POINTS; i++) { /* half of them off by 3, half by 0.6 */
        CHECK(resect_residual(&r, &c.given, &c.seen[i], e, j));
        c.seen[i].pixel[0] += e[0];
        c.seen[i].pixel[1] += e[1] + (i % 2 ? 3 : 0.6);
    }
    CHECK_CLOSE(resect(&r, at).before, (2.5 + 0.18) / 2, 1e-12);
}

TEST(resect_holds_what_fits_the_points_and_is_near)
{
    const struct resect_case c = resect_case_of("PINHOLE", 0);
    const struct resect r = {.lens = &c.lens, .limit = 2};
    const double turned[POSE_TERMS] = {0.2, -0.2, 0.05, 9, 9, 9}, too[POSE_TERMS] = {0.2, -0.2, 0.15};
    CHECK(resect_holds(&r, &(struct resect_found){.after = 1.9, .shift = 19}, turned));
    CHECK(!resect_holds(&r, &(struct resect_found){.after = 2.1, .shift = 19}, turned));
    CHECK(!resect_holds(&r, &(struct resect_found){.after = 1.9, .shift = 21}, turned));
    CHECK(!resect_holds(&r, &(struct resect_found){.after = 1.9, .shift = 19}, too));
}

TEST(resect_leaves_a_pose_that_its_points_leave_open)
{
    struct resect_case c = resect_case_of("PINHOLE", 0);
    const struct resect r = {.given = &c.given,
                             .lens = &c.lens,
                             .origin = resect_origin,
                             .seen = c.seen,
                             .count = RESECT_POINTS,
                             .limit = 1};
    double at[POSE_TERMS];
    struct resect_found f;
    for (int i = 0; i < RESECT_POINTS; i++) /* behind the camera */
        for (int k = 0; k < 3; k++) c.seen[i].world[k] = resect_origin[k] - 30 * c.given.rotation[6 + k];
    f = resect(&r, at);
    CHECK(!pose_is_moved(at) && f.before == f.after && f.shift == 0);
}

TEST(poses_added_are_those_applied_one_after_the_other)
{
    const oxl_camera given = resect_case_of("PINHOLE", 0).given;
    double at[POSE_TERMS] = {0.2, -0.3, 0.1, 1, -2, 0.5};
    const double more[POSE_TERMS] = {-0.1, 0.4, 0.2, 0.3, 0.1, -1};
    oxl_camera once = given, twice = given, both = given;
    pose_apply(&given, at, &once);
    pose_apply(&once, more, &twice);
    pose_add(at, more);
    pose_apply(&given, at, &both);
    for (int k = 0; k < 9; k++) CHECK_CLOSE(both.rotation[k], twice.rotation[k], 1e-14);
    for (int k = 0; k < 3; k++) CHECK_CLOSE(both.translation[k], twice.translation[k], 1e-14);
}

/* Makes a survey, noisy or not, in a folder of its own, whose images list their points `times` times. */
static oxl_scene *poses_tracked_scene(const char *name, double noise, int times)
{
    synth_options o = synth_test_options(name);
    char images[100];
    struct colmap survey = {0};
    struct os_file_map file;
    struct text text = {.ctx = test_ctx};
    oxl_scene *scene = NULL;
    const char *at;
    o.views = POSES_VIEWS, o.pose_noise = noise;
    synth_test_make(&o, &survey);
    colmap_free(test_ctx, &survey);
    snprintf(images, sizeof images, "%s/sparse/0/images.txt", name);
    CHECK_OK(os_read_file(test_ctx, test_path(images), &file));
    at = file.data;
    for (int row = 0; at < file.data + file.size; row++) {
        const int size = (int)(strchr(at, '\n') - at);
        if (*at == '#') row = -1;
        for (int i = 0; i < (row % 2 == 1 ? times : 1); i++) text_add(&text, "%.*s ", size, at);
        text_add(&text, "\n");
        at += size + 1;
    }
    os_release_file(test_ctx, &file);
    test_write(images, text.data);
    text_free(&text);
    CHECK_OK(oxl_scene_load(test_ctx, test_path(name), NULL, &scene));
    return scene;
}

/* Trains the scene; *off: what poses_error says of its poses then. Frees it. */
static oxl_model poses_tracked_model(oxl_scene *scene, oxl_switch poses, const oxl_camera truth[POSES_VIEWS],
                                     double *off)
{
    oxl_train_options options = train_options(10);
    oxl_model model;
    options.poses = poses;
    CHECK_OK(test_train(scene, &options, NULL, &model));
    for (int v = 0; v < POSES_VIEWS; v++)
        if (scene->view[v].is_test) CHECK(!test_imaging.pose || !pose_is_moved(test_imaging.pose[v]));
    *off = poses_error(scene, truth);
    oxl_scene_free(test_ctx, scene);
    return model;
}

TEST(poses_are_moved_onto_the_points_that_their_images_saw)
{
    oxl_scene *exact = poses_tracked_scene("exact", 0, 1), *noisy;
    oxl_camera truth[POSES_VIEWS];
    oxl_model model;
    double before, off, many;
    NEEDS_PART(poses);
    for (int v = 0; v < POSES_VIEWS; v++) truth[v] = exact->view[v].camera;
    oxl_scene_free(test_ctx, exact);
    noisy = poses_tracked_scene("noisy", 2, 1);
    before = poses_error(noisy, truth);
    model = poses_tracked_model(noisy, OXL_ON, truth, &off);
    oxl_model_free(test_ctx, &model);
    CHECK(before > 1 && off < 0.1 * before);
    model = poses_tracked_model(poses_tracked_scene("many", 2, 30), OXL_ON, truth,
                                &many); /* more than are held */
    oxl_model_free(test_ctx, &model);
    CHECK_CLOSE(many, off, 0.03);
    model = poses_tracked_model(poses_tracked_scene("none", 2, 0), OXL_ON, truth, &off);
    oxl_model_free(test_ctx, &model);
    CHECK(off > 0.5 * before);
}

/* noise: of the poses; with 0.1, neither shift nor fall of the cost suffice. */
static void poses_check_that_they_stay(double noise, const char *without, const char *with)
{
    oxl_scene *scene[2];
    oxl_model model[2];
    double pose[2][POSES_VIEWS][POSE_TERMS];
    for (int k = 0; k < 2; k++) { /* as without points */
        oxl_train_options options = train_options(30);
        options.poses = OXL_ON;
        scene[k] = poses_tracked_scene(k ? with : without, noise, k);
        CHECK_OK(test_train(scene[k], &options, NULL, &model[k]));
        memcpy(pose[k], test_imaging.pose, sizeof pose[k]);
    }
    CHECK(train_same(&model[0], &model[1]));
    CHECK(memcmp(pose[0], pose[1], sizeof pose[0]) == 0);
    for (int k = 0; k < 2; k++) {
        oxl_model_free(test_ctx, &model[k]);
        oxl_scene_free(test_ctx, scene[k]);
    }
}

TEST(poses_that_agree_with_their_points_stay)
{
    NEEDS_PART(poses);
    poses_check_that_they_stay(0, "none", "points");
    poses_check_that_they_stay(0.1, "noisy_none", "noisy_points");
}

TEST(poses_are_not_moved_onto_points_of_a_file_that_was_cut_meanwhile)
{
    oxl_scene *scene = poses_tracked_scene("noisy", 2, 1);
    oxl_train_options options = train_options(10);
    oxl_model model;
    struct os_file_map file;
    char *text;
    NEEDS_PART(poses);
    CHECK_OK(os_read_file(test_ctx, test_path("noisy/sparse/0/images.txt"), &file));
    text = oxl_strdup(test_ctx, file.data);
    text[file.size / 2] = 0;
    os_release_file(test_ctx, &file);
    test_write("noisy/sparse/0/images.txt", text);
    oxl_free(test_ctx, text);
    options.poses = OXL_ON;
    CHECK(test_train(scene, &options, NULL, &model) == OXL_ERR_INPUT);
    CHECK_TEXT(oxl_error_text(test_ctx), "longer when the survey was read");
    oxl_scene_free(test_ctx, scene);
}

TEST(poses_moved_onto_points_end_in_the_same_bytes_after_a_stop)
{
    struct checkpoint_case c = checkpoint_of(poses_tracked_scene("noisy", 2, 1), train_options(40));
    double whole[POSES_VIEWS][POSE_TERMS];
    oxl_model model;
    NEEDS_PART(poses);
    c.options.poses = OXL_AUTO;
    CHECK_OK(test_train(c.scene, &c.options, NULL, &c.whole));
    memcpy(whole, test_imaging.pose, sizeof whole);
    CHECK(pose_is_moved(whole[1]));
    for (int stop = 10; stop < 30; stop += 13) {
        CHECK(checkpoint_run(&c, "key", stop, &model) == OXL_ERR_INTERRUPTED);
        oxl_model_free(test_ctx, &model);
    }
    CHECK_OK(checkpoint_run(&c, "key", -1, &model));
    CHECK(train_same(&model, &c.whole) && memcmp(whole, test_imaging.pose, sizeof whole) == 0);
    oxl_model_free(test_ctx, &model);
    checkpoint_case_free(&c);
}

TEST(poses_moved_onto_points_do_not_go_on_from_those_of_other_2d_points)
{
    struct checkpoint_case c = checkpoint_of(poses_tracked_scene("noisy", 2, 1), train_options(20));
    oxl_model model;
    NEEDS_PART(poses);
    c.options.poses = OXL_ON;
    CHECK(checkpoint_run(&c, "key", 10, &model) == OXL_ERR_INTERRUPTED);
    oxl_model_free(test_ctx, &model);
    oxl_scene_free(test_ctx, c.scene);
    c.scene = poses_tracked_scene("none", 2, 0);
    CHECK(checkpoint_run(&c, "key", -1, &model) == OXL_ERR_INPUT);
    CHECK_TEXT(oxl_error_text(test_ctx), "2D points say other poses");
    checkpoint_case_free(&c);
}
