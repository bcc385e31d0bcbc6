/* camera.c - evaluates COLMAP's camera models, from a direction to a pixel, and poses.
 *
 * Source: the model definitions in COLMAP's documentation (camera models), which follow OpenCV's calib3d; the
 * fisheye models are Kannala & Brandt 2006. Every model maps a direction (u, v) = (x/z, y/z) to a pixel:
 *
 *     radial        (u, v) s + tangential, s a polynomial in r^2 = u^2 + v^2
 *     fisheye       (u, v) s, s = theta_d / r, theta_d a polynomial in theta = atan r
 *     pixel         (fx x + cx, fy y + cy)
 *
 * Invariant: no libm transcendental is used: the same bytes on every machine.
 */
#include "sparse.h"

/* ---------------- the table of models */

/* Lists the camera models in the order of COLMAP's MODEL_ID, which cameras.bin holds (colmap/colmap,
 * src/colmap/sensor/models.h). */
static const struct camera_model camera_models[] = {
    {"SIMPLE_PINHOLE", 3, 1, CAMERA_POLYNOMIAL},           /* f cx cy */
    {"PINHOLE", 4, 2, CAMERA_POLYNOMIAL},                  /* fx fy cx cy */
    {"SIMPLE_RADIAL", 4, 1, CAMERA_POLYNOMIAL},            /* f cx cy k */
    {"RADIAL", 5, 1, CAMERA_POLYNOMIAL},                   /* f cx cy k1 k2 */
    {"OPENCV", 8, 2, CAMERA_POLYNOMIAL},                   /* fx fy cx cy k1 k2 p1 p2 */
    {"OPENCV_FISHEYE", 8, 2, CAMERA_FISHEYE},              /* fx fy cx cy k1 k2 k3 k4 */
    {"FULL_OPENCV", 12, 2, CAMERA_POLYNOMIAL},             /* fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6 */
    {"FOV", 5, 2, CAMERA_REFUSED},                         /* fx fy cx cy omega */
    {"SIMPLE_RADIAL_FISHEYE", 4, 1, CAMERA_FISHEYE},       /* f cx cy k */
    {"RADIAL_FISHEYE", 5, 1, CAMERA_FISHEYE},              /* f cx cy k1 k2 */
    {"THIN_PRISM_FISHEYE", 12, 2, CAMERA_REFUSED},         /* fx fy cx cy k1 k2 p1 p2 k3 k4 sx1 sy1 */
    {"RAD_TAN_THIN_PRISM_FISHEYE", 16, 2, CAMERA_REFUSED}, /* fx fy cx cy k0-k5 p0 p1 s0-s3 */
    {"SIMPLE_DIVISION", 4, 1, CAMERA_REFUSED},             /* f cx cy k */
    {"DIVISION", 5, 2, CAMERA_REFUSED},                    /* fx fy cx cy k */
    {"SIMPLE_FISHEYE", 3, 1, CAMERA_FISHEYE},              /* f cx cy */
    {"FISHEYE", 4, 2, CAMERA_FISHEYE},                     /* fx fy cx cy */
    {"EUCM", 6, 2, CAMERA_REFUSED},                        /* fx fy cx cy alpha beta */
    {"EQUIRECTANGULAR", 2, 0, CAMERA_SPHERE},              /* w h */
};

OXL_INTERNAL int camera_model_find(const char *name, size_t length)
{
    for (int i = 0; i < (int)OXL_COUNT(camera_models); i++)
        if (strlen(camera_models[i].name) == length && memcmp(camera_models[i].name, name, length) == 0)
            return i;
    return -1;
}

OXL_INTERNAL const struct camera_model *camera_model_at(int index)
{
    return index >= 0 && index < (int)OXL_COUNT(camera_models) ? &camera_models[index] : NULL;
}

OXL_INTERNAL const char *camera_model_list(void)
{
    return "SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV, OPENCV_FISHEYE, FULL_OPENCV, SIMPLE_RADIAL_FISHEYE, "
           "RADIAL_FISHEYE, SIMPLE_FISHEYE, FISHEYE";
}

OXL_INTERNAL void camera_intrinsics(const struct colmap_camera *camera, double out[4])
{
    const int focals = camera_models[camera->model].focal_count;
    const double *p = camera->parameter;
    memset(out, 0, 4 * sizeof *out);
    if (focals == 0) return;
    out[0] = p[0];
    out[1] = p[focals - 1];
    out[2] = p[focals];
    out[3] = p[focals + 1];
}

/* ---------------- direction to pixel */

/* Computes atan x for x >= 0, to about 1e-15: three half angles, tan(a/2) = t / (1 + sqrt(1 + t^2)), leave an
 * argument below 0.2 for the series. */
OXL_INTERNAL double camera_atan(double x)
{
    double square, sum = 0;
    for (int i = 0; i < 3; i++) x = x / (1 + sqrt(1 + x * x));
    square = x * x;
    for (int n = 19; n >= 1; n -= 2) sum = 1.0 / n - square * sum;
    return 8 * x * sum;
}

#define CAMERA_SMALL 1e-8 /* Bounds the angles (radians) whose square is below the last bit of 1. */

/* Returns theta_d / r, which is 1 at the axis. */
static double camera_fisheye_scale(const double *k, int count, double r)
{
    const double theta = camera_atan(r), square = theta * theta;
    double polynomial = 0;
    if (r < CAMERA_SMALL) return 1;
    for (int i = count - 1; i >= 0; i--) polynomial = square * (k[i] + polynomial);
    return theta * (1 + polynomial) / r;
}

OXL_INTERNAL void camera_distort(const struct colmap_camera *camera, const double direction[2],
                                 double pixel[2])
{
    const struct camera_model *m = &camera_models[camera->model];
    const double *p = camera->parameter;
    const double *k = p + m->focal_count + 2;
    const int count = m->parameter_count - m->focal_count - 2;
    const double u = direction[0], v = direction[1], r2 = u * u + v * v;
    double scale = 1, c[8] = {0}, x, y;
    if (m->kind == CAMERA_POLYNOMIAL) {
        for (int i = 0; i < count; i++) c[i] = k[i];
        scale = (1 + r2 * (c[0] + r2 * (c[1] + r2 * c[4]))) / (1 + r2 * (c[5] + r2 * (c[6] + r2 * c[7])));
    } else if (m->kind == CAMERA_FISHEYE) scale = camera_fisheye_scale(k, count, sqrt(r2));
    else {
        pixel[0] = pixel[1] = NAN;
        return;
    }
    x = u * scale + (2 * c[2] * u * v + c[3] * (r2 + 2 * u * u));
    y = v * scale + (2 * c[3] * u * v + c[2] * (r2 + 2 * v * v));
    pixel[0] = p[0] * x + p[m->focal_count];
    pixel[1] = p[m->focal_count - 1] * y + p[m->focal_count + 1];
}

OXL_INTERNAL int camera_is_distorted(const struct colmap_camera *camera)
{
    const struct camera_model *m = &camera_models[camera->model];
    if (m->kind != CAMERA_POLYNOMIAL) return 1; /* is no pinhole even with all k = 0 */
    for (int i = m->focal_count + 2; i < m->parameter_count; i++)
        if (camera->parameter[i] != 0) return 1;
    return 0;
}

/* ---------------- poses */

OXL_INTERNAL void camera_rotation_from_quaternion(const double q[4], double r[9])
{
    const double norm2 = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
    const double s = norm2 > 0 ? 2 / norm2 : 0; /* Makes the identity of a zero quaternion. */
    const double w = q[0], x = q[1], y = q[2], z = q[3];
    r[0] = 1 - s * (y * y + z * z);
    r[1] = s * (x * y - w * z);
    r[2] = s * (x * z + w * y);
    r[3] = s * (x * y + w * z);
    r[4] = 1 - s * (x * x + z * z);
    r[5] = s * (y * z - w * x);
    r[6] = s * (x * z - w * y);
    r[7] = s * (y * z + w * x);
    r[8] = 1 - s * (x * x + y * y);
}

OXL_INTERNAL void camera_position(const oxl_camera *camera, double out[3])
{
    const double *r = camera->rotation, *t = camera->translation;
    for (int i = 0; i < 3; i++) out[i] = -(r[i] * t[0] + r[3 + i] * t[1] + r[6 + i] * t[2]);
}

OXL_INTERNAL double camera_distance(const oxl_camera *a, const oxl_camera *b)
{
    double p[3], q[3];
    camera_position(a, p);
    camera_position(b, q);
    return sqrt((p[0] - q[0]) * (p[0] - q[0]) + (p[1] - q[1]) * (p[1] - q[1]) +
                (p[2] - q[2]) * (p[2] - q[2]));
}

OXL_INTERNAL void camera_transform(const oxl_camera *camera, const double world[3], const double origin[3],
                                   double x[3])
{
    for (int i = 0; i < 3; i++) {
        x[i] = camera->translation[i];
        for (int k = 0; k < 3; k++)
            x[i] += camera->rotation[3 * i + k] * (world[k] - (origin ? origin[k] : 0));
    }
}

OXL_INTERNAL void camera_unproject(const oxl_camera *camera, const double pixel[2], double z, double world[3])
{
    const double *r = camera->rotation, *t = camera->translation;
    const double x[3] = {(pixel[0] - camera->cx) / camera->fx * z - t[0],
                         (pixel[1] - camera->cy) / camera->fy * z - t[1], z - t[2]};
    for (int k = 0; k < 3; k++) world[k] = r[k] * x[0] + r[3 + k] * x[1] + r[6 + k] * x[2];
}

OXL_INTERNAL int camera_project(const oxl_camera *camera, const double world[3], const double origin[3],
                                double x[3], double pixel[2])
{
    camera_transform(camera, world, origin, x);
    if (!(x[2] > 0)) return 0;
    pixel[0] = camera->fx * x[0] / x[2] + camera->cx;
    pixel[1] = camera->fy * x[1] / x[2] + camera->cy;
    return 1;
}

OXL_INTERNAL oxl_camera camera_halve(const oxl_camera *camera)
{
    oxl_camera half = *camera;
    half.width /= 2, half.height /= 2;
    half.fx /= 2, half.fy /= 2, half.cx /= 2, half.cy /= 2;
    return half;
}
