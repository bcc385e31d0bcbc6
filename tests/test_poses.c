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
