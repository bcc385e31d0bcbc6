/* test_poses.c - camera poses that are refined while training: the gradient, the part, its files. */
#include "test.h"
#include "wide.h"

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

enum { POSES_VALUES = 3 * WIDE_SMOOTH_WIDTH * WIDE_SMOOTH_HEIGHT };

static double poses_loss(struct wide *r)
{
    double sum = 0;
    kernels_forward(r);
    for (size_t i = 0; i < POSES_VALUES; i++) sum += wide_random(6, i, 0) * r->rgb[i];
    return sum;
}

/* Worst |finite - analytic| / largest |analytic| of the six, central differences of fourth order. */
static double poses_worst(struct wide *r)
{
    const oxl_camera camera = r->camera;
    const double h = 1e-4;
    double drgb[POSES_VALUES], worst = 0, scale = 0;
    for (size_t i = 0; i < OXL_COUNT(drgb); i++) drgb[i] = wide_random(6, i, 0);
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
            OWNED_WIDE r = {0};
            wide_smooth(&r, 6, lobes, degree, 12, 0.3);
            CHECK(kernels_forward(&r) == 6 && poses_worst(&r) < 1e-8);
            r.antialias = 1;
            CHECK(poses_worst(&r) < 1e-8);
        }
}

TEST(poses_gradient_is_exact_where_the_frustum_clamp_holds)
{
    OWNED_WIDE r = {0};
    wide_smooth(&r, 4, 0, 1, 600, 0.3); /* all of them lie outside */
    CHECK(poses_worst(&r) < 1e-8);
}

/* ---------------- the file */

TEST(poses_are_read_as_they_were_written)
{
    OWNED_SCENE *scene = train_scene(5);
    const oxl_camera given = oxl_scene_view(scene, 2)->camera;
    const double at[POSE_TERMS] = {0.001, -0.0023456789012345, 1.0 / 3, 1e-9, -12.5, 0};
    oxl_camera moved = given;
    OWNED_IMAGING m = {0};
    m.pose = oxl_calloc(test_ctx, 5, sizeof *m.pose);
    memcpy(m.pose[2], at, sizeof at);
    CHECK(imaging_is_needed(&m));
    CHECK_OK(oxl_imaging_write(test_ctx, test_path("imaging.txt"), scene, &m));
    CHECK_OK(test_read_imaging(scene, test_path("model.ply")));
    pose_apply(&given, at, &moved);
    oxl_camera now = scene_camera(scene, &test_imaging, 2);
    CHECK(memcmp(&now, &moved, sizeof moved) == 0);
    CHECK(memcmp(test_imaging.pose[2], at, sizeof at) == 0 && test_imaging.pose[1][0] == 0);
    test_write("imaging.txt", "# of a model with the survey's poses\n");
    CHECK_OK(test_read_imaging(scene, test_path("model.ply")));
    now = scene_camera(scene, &test_imaging, 2);
    CHECK(memcmp(&now, &given, sizeof given) == 0 && !test_imaging.pose);
}

TEST(poses_of_a_damaged_file_are_refused_and_those_of_other_views_passed_over)
{
    static const char *const broken[] = {"pose 0 0 0 0 0 v01.png\n", "pose 2 0 0 0 0 0 v01.png\n",
                                         "pose 0 0 0 nan 0 0 v01.png\n", "pose 0 0 0 0 0 1e99 v01.png\n"};
    OWNED_SCENE *scene = train_scene(3);
    for (size_t i = 0; i < OXL_COUNT(broken); i++) {
        test_write("imaging.txt", broken[i]);
        CHECK_ERROR(test_read_imaging(scene, test_path("model.ply")), OXL_ERR_INPUT, "imaging.txt:1: ");
    }
    test_write("imaging.txt", "pose 0.1 0 0 0 0 0 another.png\n");
    CHECK_OK(test_read_imaging(scene, test_path("model.ply")));
    CHECK(test_imaging.pose && !pose_is_moved(test_imaging.pose[1]));
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
            at[k] = (k < 3 ? turn : move) * wide_random(21, (size_t)v, (size_t)k);
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
    OWNED_SCENE *scene = poses_noisy_scene(0.02, 0.03, truth);
    oxl_train_options options = train_options(300);
    NEEDS_PART(poses);
    double before = poses_error(scene, truth);
    OWNED_MODEL model = test_trained(scene, &options);
    CHECK(poses_error(scene, truth) == before);
    double psnr = train_psnr(scene, &model);
    oxl_model_free(test_ctx, &model);
    options.poses = OXL_ON;
    model = test_trained(scene, &options);
    CHECK(poses_error(scene, truth) < 0.5 * before && train_psnr(scene, &model) > psnr + 1);
}

TEST(poses_of_a_view_that_is_far_off_are_searched_in_its_render)
{
    const double at[POSE_TERMS] = {0.06, -0.06}; /* 4.2 px */
    oxl_camera truth[POSES_VIEWS];
    OWNED_SCENE *scene = poses_noisy_scene(0, 0, truth);
    oxl_train_options options = train_options(80);
    NEEDS_PART(poses);
    pose_apply(&truth[6], at, &scene->view[6].camera);
    CHECK(poses_error(scene, truth) > 1);
    options.poses = OXL_AUTO;
    OWNED_MODEL model = test_trained(scene, &options);
    CHECK(poses_error(scene, truth) < 0.7); /* 1.05 by gradients alone; .53 is what the gauge leaves */
}

TEST(poses_of_a_run_stopped_at_any_step_end_in_the_same_bytes)
{
    NEEDS_PART(poses);
    oxl_camera truth[POSES_VIEWS];
    OWNED_CHECKPOINT_CASE c = checkpoint_of(poses_noisy_scene(0.02, 0.03, truth), train_options(90));
    c.options.poses = OXL_ON;
    checkpoint_check_stops(&c, (const int[]){3, 30, 61, 0});
    CHECK(pose_is_moved(test_imaging.pose[0]));
}
