/* frame.c - finds the axes right, up and above of a survey, for orthomosaics and camera paths.
 *
 * Right, up and above are the world's x, y and z where the survey is taken to be georeferenced: where the
 * world's origin is far away, or where z is, to within 20 degrees, the narrowest principal axis of the points
 * on the side of the cameras, or the mean of the directions against which the cameras look. It is not where z
 * is down, so that the cameras are below the points and look up. Otherwise above is that narrowest axis, and
 * right the widest, in the direction in which its largest element is positive.
 *
 * Invariant: the frame is right-handed: no rendering is mirrored.
 */
#include "cli.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    FRAME_SAMPLE = 100000, /* most points that the axes and the bounds are found from */
    FRAME_SQUARINGS = 40
};
#define FRAME_WORLD 0.94 /* cosine of 20 degrees, within which the world's z counts as above */
/* distance of the world's origin from which a survey counts as georeferenced, in standard deviations of the
 * points: a model in its own units has its origin nearer */
#define FRAME_DISTANT 200

double frame_along(const struct frame *f, const double p[3], int axis)
{
    double sum = 0;
    for (int k = 0; k < 3; k++) sum += f->axis[axis][k] * (p[k] - f->centre[k]);
    return sum;
}

void frame_eye(const oxl_camera *c, double out[3])
{
    for (int k = 0; k < 3; k++)
        out[k] = -(c->rotation[k] * c->translation[0] + c->rotation[3 + k] * c->translation[1] +
                   c->rotation[6 + k] * c->translation[2]);
}

void frame_to_camera(const double rotation[9], const double p[3], double out[3])
{
    for (int i = 0; i < 3; i++)
        out[i] = rotation[3 * i] * p[0] + rotation[3 * i + 1] * p[1] + rotation[3 * i + 2] * p[2];
}

void frame_place(oxl_camera *c, const double eye[3])
{
    frame_to_camera(c->rotation, eye, c->translation);
    for (int i = 0; i < 3; i++) c->translation[i] = -c->translation[i];
}

void frame_cross(const double a[3], const double b[3], double out[3])
{
    for (int k = 0; k < 3; k++) out[k] = a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3];
}

double frame_length(const double a[3])
{
    return sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]);
}

int frame_compare(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

double frame_camera_height(const struct frame *f, const oxl_scene *scene)
{
    double sum = 0;
    const int views = oxl_scene_view_count(scene);
    for (int i = 0; i < views; i++) {
        double eye[3];
        frame_eye(&oxl_scene_view(scene, i)->camera, eye);
        sum += frame_along(f, eye, 2);
    }
    return views > 0 ? sum / views : 0;
}

void frame_widest(int n, const double *matrix, double *out)
{
    double m[16], square[16], most = 0, length = 0;
    int column = 0, largest = 0;
    memcpy(m, matrix, (size_t)(n * n) * sizeof *m);
    for (int pass = 0; pass < FRAME_SQUARINGS; pass++) {
        double trace = 0;
        for (int k = 0; k < n; k++) trace += m[(n + 1) * k];
        memset(square, 0, sizeof square);
        for (int k = 0; k < n * n * n; k++)
            square[k / (n * n) * n + k % n] += m[k / n] / trace * (m[k / n % n * n + k % n] / trace);
        memcpy(m, square, sizeof m);
    }
    for (int k = 0; k < n; k++)
        if (m[(n + 1) * k] > most) most = m[(n + 1) * k], column = k;
    for (int k = 0; k < n; k++) length += m[n * column + k] * m[n * column + k];
    for (int k = 0; k < n; k++) {
        out[k] = m[n * column + k] / sqrt(length);
        if (fabs(out[k]) > fabs(out[largest])) largest = k;
    }
    for (int k = 0, backward = out[largest] < 0; k < n && backward; k++) out[k] = -out[k];
}

/* Sets the centre, and the principal axes of a sample of the points: right the widest, above the narrowest. */
static void frame_axes(struct frame *f, const oxl_scene *scene)
{
    const oxl_point *point = oxl_scene_points(scene);
    const size_t count = oxl_scene_point_count(scene), stride = 1 + count / FRAME_SAMPLE;
    double a[9] = {0}, rest[9], n = (double)((count + stride - 1) / stride), trace;
    for (size_t i = 0; i < count; i += stride)
        for (int k = 0; k < 3; k++) f->centre[k] += point[i].position[k] / n;
    for (size_t i = 0; i < count; i += stride)
        for (int k = 0; k < 9; k++)
            a[k] += (point[i].position[k / 3] - f->centre[k / 3]) *
                    (point[i].position[k % 3] - f->centre[k % 3]) / n;
    trace = a[0] + a[4] + a[8];
    for (int k = 0; k < 9; k++) rest[k] = (k % 4 == 0) * trace - a[k];
    for (int k = 0; k < 9; k += 4) f->axis[k / 3][k % 3] = 1; /* all points may lie in one place */
    if (trace > 0) frame_widest(3, a, f->axis[0]), frame_widest(3, rest, f->axis[2]);
    f->spread = 0;
    for (int k = 0; k < 9; k++) f->spread += f->axis[0][k / 3] * a[k] * f->axis[0][k % 3];
    f->spread = sqrt(fmax(f->spread, 0));
}

/* Returns 1 if the world's z is up, as far as the survey shows. */
static int frame_is_world(const struct frame *f, const oxl_scene *scene)
{
    const int views = oxl_scene_view_count(scene);
    /* means over the cameras, along z: of the direction they look against, of their height */
    double down = 0, height = 0;
    for (int i = 0; i < views; i++) {
        const oxl_camera *c = &oxl_scene_view(scene, i)->camera;
        double eye[3];
        frame_eye(c, eye);
        down -= c->rotation[8] / views;
        height += (eye[2] - f->centre[2]) / views;
    }
    if (down < 0 && height < 0) return 0;
    return f->axis[2][2] > FRAME_WORLD || down > FRAME_WORLD ||
           frame_length(oxl_scene_origin(scene)) > FRAME_DISTANT * f->spread;
}

void frame_choose(const oxl_scene *scene, enum frame_kind kind, struct frame *f)
{
    *f = (struct frame){.is_world = 0};
    frame_axes(f, scene);
    if (frame_camera_height(f, scene) < 0)
        for (int k = 0; k < 3; k++) f->axis[2][k] = -f->axis[2][k];
    f->is_world = kind == FRAME_WORLD_AXES ||
                  (kind == FRAME_AUTO && (oxl_scene_reference(scene) || frame_is_world(f, scene)));
    for (int k = 0; k < 9 && f->is_world; k++) f->axis[k / 3][k % 3] = k % 4 == 0;
    frame_cross(f->axis[2], f->axis[0], f->axis[1]);
}

int frame_bounds(const struct frame *f, const oxl_scene *scene, double low[2], double high[2])
{
    const size_t count = oxl_scene_point_count(scene), stride = 1 + count / FRAME_SAMPLE;
    double *along = malloc(sizeof *along * (count / stride + 1));
    for (int d = 0; along && d < 2; d++) {
        size_t n = 0;
        for (size_t i = 0; i < count; i += stride)
            along[n++] = frame_along(f, oxl_scene_points(scene)[i].position, d);
        qsort(along, n, sizeof *along, frame_compare);
        low[d] = along[n / 200], high[d] = along[n - 1 - n / 200];
    }
    free(along);
    return along != NULL;
}
