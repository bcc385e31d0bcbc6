/* frame.c - finds the axes right, up and above of a survey, for maps, orthomosaics and camera paths.
 *
 * Right, up and above are the world's x, y and z where the survey is taken to be georeferenced: where the
 * world's origin is far away, or where z is, to within 20 degrees, the narrowest principal axis of the points
 * on the side of the cameras, or the mean of the directions against which the cameras look. It is not where z
 * is down, so that the cameras are below the points and look up. Otherwise above is that narrowest axis, and
 * right the widest, in the direction that eigen_is_backward gives it.
 *
 * Invariant: the frame is right-handed: no rendering is mirrored.
 */
#include "cli.h"

#include "../src/core/eigen.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Limits the points that the axes and the bounds are found from. */
enum { FRAME_SAMPLE = 100000 };
#define FRAME_WORLD 0.94 /* Holds the cosine of 20 degrees, within which the world's z counts as above. */
/* Takes a survey as georeferenced from this distance of the world's origin on, in standard deviations of the
 * points: a model in its own units has its origin nearer. */
#define FRAME_DISTANT 200

double frame_along(const struct frame *f, const double p[3], int axis)
{
    double sum = 0;
    for (int k = 0; k < 3; k++) sum += f->axis[axis][k] * (p[k] - f->centre[k]);
    return sum;
}

void frame_eye(const oxl_view *view, double out[3])
{
    const oxl_camera *c = &view->camera;
    for (int k = 0; k < 3; k++)
        out[k] = -(c->rotation[k] * c->translation[0] + c->rotation[3 + k] * c->translation[1] +
                   c->rotation[6 + k] * c->translation[2]);
}

void frame_place(oxl_camera *c, const double eye[3])
{
    for (int i = 0; i < 3; i++)
        c->translation[i] = -(c->rotation[3 * i] * eye[0] + c->rotation[3 * i + 1] * eye[1] +
                              c->rotation[3 * i + 2] * eye[2]);
}

void frame_cross(const double a[3], const double b[3], double out[3])
{
    for (int k = 0; k < 3; k++) out[k] = a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3];
}

static size_t frame_stride(const oxl_scene *scene)
{
    return 1 + oxl_scene_point_count(scene) / FRAME_SAMPLE;
}

/* Returns the mean height of the cameras above the frame's centre, in units of the scene. */
double frame_camera_height(const struct frame *f, const oxl_scene *scene)
{
    double sum = 0;
    const int views = oxl_scene_view_count(scene);
    for (int i = 0; i < views; i++) {
        double eye[3];
        frame_eye(oxl_scene_view(scene, i), eye);
        sum += frame_along(f, eye, 2);
    }
    return views > 0 ? sum / views : 0;
}

/* Sets the centre, and the principal axes of a sample of the points: right the
 * widest, above the narrowest. */
static void frame_axes(struct frame *f, const oxl_scene *scene)
{
    const oxl_point *point = oxl_scene_points(scene);
    const size_t count = oxl_scene_point_count(scene), stride = frame_stride(scene);
    double a[3][3] = {{0}}, v[3][3], n = 0;
    int wide = 0, narrow = 0;
    for (size_t i = 0; i < count; i += stride, n++)
        for (int k = 0; k < 3; k++) f->centre[k] += point[i].position[k];
    for (int k = 0; k < 3; k++) f->centre[k] /= n > 0 ? n : 1;
    for (size_t i = 0; i < count; i += stride)
        for (int k = 0; k < 9; k++)
            a[k / 3][k % 3] +=
                (point[i].position[k / 3] - f->centre[k / 3]) * (point[i].position[k % 3] - f->centre[k % 3]);
    eigen_symmetric(a, v);
    for (int k = 1; k < 3; k++) {
        if (a[k][k] > a[wide][wide]) wide = k;
        if (a[k][k] <= a[narrow][narrow]) narrow = k;
    }
    for (int k = 0; k < 3; k++) f->axis[0][k] = eigen_is_backward(v[wide]) ? -v[wide][k] : v[wide][k];
    memcpy(f->axis[2], v[narrow], sizeof v[0]);
    frame_cross(f->axis[2], f->axis[0], f->axis[1]);
    f->spread = sqrt(fmax(a[wide][wide], 0) / (n > 0 ? n : 1));
}

/* Returns 1 if the world's z is up, as far as the survey shows. */
static int frame_is_world(const struct frame *f, const oxl_scene *scene)
{
    const double *origin = oxl_scene_origin(scene);
    const int views = oxl_scene_view_count(scene);
    /* means over the cameras, along z: of the direction they look against, of their height */
    double down = 0, height = 0;
    for (int i = 0; i < views; i++) {
        double eye[3];
        frame_eye(oxl_scene_view(scene, i), eye);
        down -= oxl_scene_view(scene, i)->camera.rotation[8] / views;
        height += (eye[2] - f->centre[2]) / views;
    }
    if (down < 0 && height < 0) return 0;
    return f->axis[2][2] > FRAME_WORLD || down > FRAME_WORLD ||
           sqrt(origin[0] * origin[0] + origin[1] * origin[1] + origin[2] * origin[2]) >
               FRAME_DISTANT * f->spread;
}

/* Sets above to `up`, and right to the widest axis less its part along `up`; to the second axis where the
 * widest is nearly along `up` and would leave nothing. */
static void frame_turn_up(struct frame *f, const double up[3])
{
    double along[2] = {0, 0}, right[3], length[2] = {0, 0};
    int k, from;
    for (k = 0; k < 3; k++) length[0] += up[k] * up[k];
    if (!(length[0] > 0)) return;
    for (k = 0; k < 3; k++) f->axis[2][k] = up[k] / sqrt(length[0]);
    for (k = 0; k < 6; k++) along[k / 3] += f->axis[k / 3][k % 3] * f->axis[2][k % 3];
    from = fabs(along[0]) > 0.9;
    for (k = 0; k < 3; k++) right[k] = f->axis[from][k] - along[from] * f->axis[2][k];
    for (k = 0; k < 3; k++) length[1] += right[k] * right[k];
    for (k = 0; k < 3; k++) f->axis[0][k] = right[k] / sqrt(length[1]);
}

void frame_of(const oxl_scene *scene, struct frame *out)
{
    frame_choose(scene, FRAME_AUTO, NULL, out);
}

void frame_choose(const oxl_scene *scene, enum frame_kind kind, const double *up, struct frame *out)
{
    *out = (struct frame){{0}, {{0}}, 0, 0};
    frame_axes(out, scene);
    if (frame_camera_height(out, scene) < 0)
        for (int k = 0; k < 3; k++) out->axis[2][k] = -out->axis[2][k];
    out->is_world = up ? 0 : kind == FRAME_WORLD_AXES || (kind == FRAME_AUTO && frame_is_world(out, scene));
    if (up) frame_turn_up(out, up);
    for (int i = 0; i < 3 && out->is_world; i++)
        for (int k = 0; k < 3; k++) out->axis[i][k] = i == k;
    frame_cross(out->axis[2], out->axis[0], out->axis[1]);
}

static int frame_compare(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

int frame_bounds(const struct frame *f, const oxl_scene *scene, int with_cameras, double low[2],
                 double high[2])
{
    const oxl_point *point = oxl_scene_points(scene);
    const size_t count = oxl_scene_point_count(scene), stride = frame_stride(scene);
    double *along = malloc(sizeof *along * (count / stride + 1));
    for (int d = 0; along && d < 2; d++) {
        size_t n = 0;
        for (size_t i = 0; i < count; i += stride) along[n++] = frame_along(f, point[i].position, d);
        qsort(along, n, sizeof *along, frame_compare);
        low[d] = along[n / 200], high[d] = along[n - 1 - n / 200];
        for (int i = 0; with_cameras && i < oxl_scene_view_count(scene); i++) {
            double eye[3];
            frame_eye(oxl_scene_view(scene, i), eye);
            low[d] = fmin(low[d], frame_along(f, eye, d));
            high[d] = fmax(high[d], frame_along(f, eye, d));
        }
    }
    free(along);
    return along != NULL;
}
