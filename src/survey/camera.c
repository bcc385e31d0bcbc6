/* camera.c - evaluates COLMAP's camera models, from a direction to a pixel, and poses.
 *
 * Source: the model definitions in COLMAP's documentation (camera models), which follow OpenCV's calib3d; the
 * fisheye models are Kannala & Brandt 2006. Every model maps a direction (u, v) = (x/z, y/z) to a pixel:
 *
 *     radial        (u, v) s + tangential, s a polynomial in r^2 = u^2 + v^2
 *     fisheye       (u, v) s, s = theta_d / r, theta_d a polynomial in theta = atan r
 *     thin prism    the same with terms that are not radial, on the fisheye plane (u, v) theta / r [Weng
 *     1992; Project Aria]
 *     FOV           (u, v) s, s = atan(2 r tan(w/2)) / (r w) [Devernay & Faugeras 2001]
 *     division      (u, v) s, s = 2 / (1 + sqrt(1 - 4 k r^2)) [Fitzgibbon 2001]
 *     EUCM          (u, v) s, s = 1 / (a sqrt(1 + b r^2) + 1 - a) [Khomutenko 2016]
 *     pixel         (fx x + cx, fy y + cy)
 *
 * Invariant: no libm transcendental is used: the same bytes on every machine.
 */
#include "sparse.h"
#include "tracks.h"
#include "../core/vecmath.h"

/* ---------------- the table of models */

/* Lists the camera models in the order of COLMAP's MODEL_ID, which cameras.bin holds (colmap/colmap,
 * src/colmap/sensor/models.h). */
static const struct camera_model camera_models[] = {
    {"SIMPLE_PINHOLE", 3, 1, CAMERA_POLYNOMIAL},      /* f cx cy */
    {"PINHOLE", 4, 2, CAMERA_POLYNOMIAL},             /* fx fy cx cy */
    {"SIMPLE_RADIAL", 4, 1, CAMERA_POLYNOMIAL},       /* f cx cy k */
    {"RADIAL", 5, 1, CAMERA_POLYNOMIAL},              /* f cx cy k1 k2 */
    {"OPENCV", 8, 2, CAMERA_POLYNOMIAL},              /* fx fy cx cy k1 k2 p1 p2 */
    {"OPENCV_FISHEYE", 8, 2, CAMERA_FISHEYE},         /* fx fy cx cy k1 k2 k3 k4 */
    {"FULL_OPENCV", 12, 2, CAMERA_POLYNOMIAL},        /* fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6 */
    {"FOV", 5, 2, CAMERA_FOV},                        /* fx fy cx cy omega */
    {"SIMPLE_RADIAL_FISHEYE", 4, 1, CAMERA_FISHEYE},  /* f cx cy k */
    {"RADIAL_FISHEYE", 5, 1, CAMERA_FISHEYE},         /* f cx cy k1 k2 */
    {"THIN_PRISM_FISHEYE", 12, 2, CAMERA_THIN_PRISM}, /* fx fy cx cy k1 k2 p1 p2 k3 k4 sx1 sy1 */
    {"RAD_TAN_THIN_PRISM_FISHEYE", 16, 2, CAMERA_RAD_TAN_THIN_PRISM}, /* fx fy cx cy k0-k5 p0 p1 s0-s3 */
    {"SIMPLE_DIVISION", 4, 1, CAMERA_DIVISION},                       /* f cx cy k */
    {"DIVISION", 5, 2, CAMERA_DIVISION},                              /* fx fy cx cy k */
    {"SIMPLE_FISHEYE", 3, 1, CAMERA_FISHEYE},                         /* f cx cy */
    {"FISHEYE", 4, 2, CAMERA_FISHEYE},                                /* fx fy cx cy */
    {"EUCM", 6, 2, CAMERA_EUCM},                                      /* fx fy cx cy alpha beta */
    {"EQUIRECTANGULAR", 2, 0, CAMERA_SPHERE},                         /* w h */
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
    return "SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV, OPENCV_FISHEYE, FULL_OPENCV, FOV, SIMPLE_RADIAL_FISHEYE, "
           "RADIAL_FISHEYE, THIN_PRISM_FISHEYE, RAD_TAN_THIN_PRISM_FISHEYE, SIMPLE_DIVISION, DIVISION, SIMPLE_FISHEYE, FISHEYE, "
           "EUCM, EQUIRECTANGULAR";
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

#define CAMERA_FOV_MAX 3.1415 /* Stays below pi, where the tangent of half the field of view is infinite. */

/* Returns the scale of the FOV model, NaN from CAMERA_FOV_MAX on. omega: field of view of the lens. */
static double camera_fov_scale(double omega, double r)
{
    const double w = fabs(omega), tangent = vecmath_sin(w / 2) / vecmath_cos(w / 2);
    if (w < CAMERA_SMALL) return 1;
    if (w > CAMERA_FOV_MAX) return NAN;
    if (r < CAMERA_SMALL) return 2 * tangent / w;
    return camera_atan(2 * r * tangent) / (r * w);
}

/* Distorts x, y on the fisheye plane, in and out, by polynomials of the squared radius: radial, then terms
 * that are not, tangential and of a thin prism; `after`: these are evaluated at the radially distorted
 * point. */
static void camera_prism(const double radial[6], const double tangential[2], const double prism[4], int after,
                         double *x, double *y)
{
    double u = *x, v = *y, r2 = u * u + v * v, scale = 0;
    for (int i = 5; i >= 0; i--) scale = r2 * (radial[i] + scale);
    *x = u * (1 + scale), *y = v * (1 + scale);
    if (after) u = *x, v = *y, r2 = u * u + v * v;
    *x += 2 * tangential[1] * u * v + tangential[0] * (r2 + 2 * u * u) + r2 * (prism[0] + r2 * prism[1]);
    *y += 2 * tangential[0] * u * v + tangential[1] * (r2 + 2 * v * v) + r2 * (prism[2] + r2 * prism[3]);
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
    switch (m->kind) {
    case CAMERA_POLYNOMIAL:
        for (int i = 0; i < count; i++) c[i] = k[i];
        scale = (1 + r2 * (c[0] + r2 * (c[1] + r2 * c[4]))) / (1 + r2 * (c[5] + r2 * (c[6] + r2 * c[7])));
        break;
    case CAMERA_FISHEYE: scale = camera_fisheye_scale(k, count, sqrt(r2)); break;
    case CAMERA_FOV: scale = camera_fov_scale(k[0], sqrt(r2)); break;
    case CAMERA_THIN_PRISM:
    case CAMERA_RAD_TAN_THIN_PRISM: scale = camera_fisheye_scale(k, 0, sqrt(r2)); break;
    case CAMERA_DIVISION: scale = 4 * r2 * k[0] > 1 ? NAN : 2 / (1 + sqrt(1 - 4 * r2 * k[0])); break;
    case CAMERA_EUCM:
        scale = 1 + k[1] * r2 < 0 ? NAN : 1 / (k[0] * sqrt(1 + k[1] * r2) + 1 - k[0]);
        if (!(scale > 0)) scale = NAN;
        break;
    case CAMERA_SPHERE: pixel[0] = pixel[1] = NAN; return;
    }
    x = u * scale + (2 * c[2] * u * v + c[3] * (r2 + 2 * u * u));
    y = v * scale + (2 * c[3] * u * v + c[2] * (r2 + 2 * v * v));
    if (m->kind == CAMERA_THIN_PRISM)
        camera_prism((double[6]){k[0], k[1], k[4], k[5]}, (double[2]){k[3], k[2]},
                     (double[4]){k[6], 0, k[7], 0}, 0, &x, &y);
    if (m->kind == CAMERA_RAD_TAN_THIN_PRISM) camera_prism(k, k + 6, k + 8, 1, &x, &y);
    pixel[0] = p[0] * x + p[m->focal_count];
    pixel[1] = p[m->focal_count - 1] * y + p[m->focal_count + 1];
}

OXL_INTERNAL int camera_is_distorted(const struct colmap_camera *camera)
{
    const struct camera_model *m = &camera_models[camera->model];
    if (m->kind == CAMERA_EUCM) return camera->parameter[4] != 0;
    if (m->kind == CAMERA_FISHEYE || m->kind == CAMERA_THIN_PRISM || m->kind == CAMERA_RAD_TAN_THIN_PRISM ||
        m->kind == CAMERA_SPHERE)
        return 1; /* Counts models that are no pinhole even with all k = 0. */
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

#define CAMERA_ROTATION_ERROR 1.5e-2 /* Limits the sum of what a matrix is off a rotation. */

/* Compares the first two rows with unit vectors at right angles, and the third with their cross product. */
OXL_INTERNAL int camera_is_rotation(const double r[9])
{
    double aa = 0, bb = 0, ab = 0, off = 0;
    for (int k = 0; k < 3; k++) {
        const int i = (k + 1) % 3, j = (k + 2) % 3;
        aa += r[k] * r[k], bb += r[3 + k] * r[3 + k], ab += r[k] * r[3 + k];
        off += fabs(r[6 + k] - (r[i] * r[3 + j] - r[j] * r[3 + i]));
    }
    return off + fabs(aa - 1) + fabs(bb - 1) + fabs(ab) <= CAMERA_ROTATION_ERROR; /* 0 for NaN, too */
}

OXL_INTERNAL int camera_has_pose(const oxl_camera *camera)
{
    const double *t = camera->translation;
    return camera_is_rotation(camera->rotation) && fabs(t[0]) + fabs(t[1]) + fabs(t[2]) <= TRACKS_FARTHEST;
}

OXL_INTERNAL void camera_position(const oxl_camera *camera, double out[3])
{
    const double *r = camera->rotation, *t = camera->translation;
    for (int i = 0; i < 3; i++) out[i] = -(r[i] * t[0] + r[3 + i] * t[1] + r[6 + i] * t[2]);
}

OXL_INTERNAL double camera_apart(const double a[3], const double b[3])
{
    return sqrt((a[0] - b[0]) * (a[0] - b[0]) + (a[1] - b[1]) * (a[1] - b[1]) +
                (a[2] - b[2]) * (a[2] - b[2]));
}

OXL_INTERNAL double camera_distance(const oxl_camera *a, const oxl_camera *b)
{
    double p[3], q[3];
    camera_position(a, p);
    camera_position(b, q);
    return camera_apart(p, q);
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

OXL_INTERNAL int camera_sees(const oxl_camera *camera, const double place[3], double x[3], double pixel[2])
{
    return camera_project(camera, place, NULL, x, pixel) && pixel[0] >= 0 && pixel[1] >= 0 &&
           pixel[0] < camera->width && pixel[1] < camera->height;
}

OXL_INTERNAL oxl_camera camera_halve(const oxl_camera *camera)
{
    oxl_camera half = *camera;
    half.width /= 2, half.height /= 2;
    half.fx /= 2, half.fy /= 2, half.cx /= 2, half.cy /= 2;
    return half;
}
