/* synth_export.c - the files of a survey but for its images: the poses and points in the layout of COLMAP's
 * documentation ("Output Format"), of NeRF synthetic or of LLFF, and the truth in words and numbers.
 *
 * Ids are sparse and unordered, keypoints without a point are mixed with the others, as in real exports.
 * Invariant: both ways round, observation POINT2D_IDX of image IMAGE_ID names POINT3D_ID.
 */
#include "synth.h"

#include <string.h>

struct synth_ids { /* sparse and unordered, as COLMAP's: id(i) = 1 + (i x stride) mod modulus, one to one */
    uint64_t stride, modulus;
};

enum { CAMERA_ID = 3 };
#define EXPORT_DEGREE 0.017453292519943295 /* rad */

static uint64_t export_common_divisor(uint64_t a, uint64_t b)
{
    while (b > 0) {
        const uint64_t rest = a % b;
        a = b;
        b = rest;
    }
    return a;
}

static struct synth_ids synth_ids_for(uint64_t count)
{
    struct synth_ids ids = {.modulus = count + count / 2 + 7};
    ids.stride = (uint64_t)(0.381966 * (double)ids.modulus) | 1;
    while (export_common_divisor(ids.stride, ids.modulus) != 1) ids.stride += 2;
    return ids;
}

static unsigned long long synth_id(struct synth_ids ids, uint64_t index)
{
    return 1 + index * ids.stride % ids.modulus;
}

/* Computes w x y z, w >= 0 (Shepperd 1978: divides by the largest of the four). */
static void export_quaternion(const double r[9], double q[4])
{
    const double t[4] = {r[0] + r[4] + r[8], r[0] - r[4] - r[8], r[4] - r[0] - r[8], r[8] - r[0] - r[4]};
    const double d[4][4] = {{0, r[7] - r[5], r[2] - r[6], r[3] - r[1]},
                            {r[7] - r[5], 0, r[1] + r[3], r[2] + r[6]},
                            {r[2] - r[6], r[1] + r[3], 0, r[5] + r[7]},
                            {r[3] - r[1], r[2] + r[6], r[5] + r[7], 0}};
    int most = 0;
    double size;
    for (int i = 1; i < 4; i++)
        if (t[i] > t[most]) most = i;
    size = sqrt(1 + t[most]);
    for (int i = 0; i < 4; i++) q[i] = i == most ? 0.5 * size : 0.5 * d[most][i] / size;
    if (q[0] < 0)
        for (int i = 0; i < 4; i++) q[i] = -q[i];
}

/* Returns the mean number of observations of a point. */
static double export_mean(const struct synth_points *points, size_t count)
{
    return count > 0 ? (double)points->observation_count / (double)count : 0;
}

static void export_cameras(const struct synth_run *s, struct output *t)
{
    const struct synth_camera *c = &s->trajectory.camera[0];
    output_add(
        t,
        "# Camera list with one line of data per camera:\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
        "# Number of cameras: 1\n%d PINHOLE %d %d %.9f %.9f %.9f %.9f\n",
        CAMERA_ID, c->width, c->height, c->f, c->f, c->cx, c->cy);
}

static void export_pose(struct output *to, const struct synth_camera *c)
{
    const v3 t = v3_turn(c->rotation, c->centre);
    double r[9], q[4];
    memcpy(r, c->rotation, sizeof r);
    export_quaternion(r, q);
    for (int i = 0; i < 4; i++) output_add(to, " %.15f", q[i]);
    output_add(to, " %.9f %.9f %.9f", -t.x, -t.y, -t.z);
}

static v3 export_origin(const struct synth_run *s)
{
    return v3_of(s->options->origin[0], s->options->origin[1], s->options->origin[2]);
}

/* Returns a camera in the world of the export, whose pose is off by the noise that is asked for: about and along
 * random directions. */
static struct synth_camera export_camera(const struct synth_run *s, int view)
{
    const struct synth_points *points = &s->points;
    const size_t first = points->view_first[view], count = points->view_first[view + 1] - first;
    struct synth_camera c = s->trajectory.camera[view];
    double distance = 0, off[6];
    v3 turn;
    for (size_t k = 0; k < count; k++) {
        const v3 ray = v3_sub(points->point[points->by_view[first + k]].position, c.centre);
        distance += sqrt(v3_dot(ray, ray)) / (double)count;
    }
    for (int k = 0; k < 6; k++) /* uniform, of variance 1/3 on each axis */
        off[k] = s->options->pose_noise *
                 (2 * synth_unit(synth_bits(s->options->seed, 900 + k, (uint64_t)view)) - 1);
    turn = v3_scale(v3_of(off[0], off[1], off[2]), EXPORT_DEGREE);
    for (int i = 0; i < 3; i++) {
        const double along = v3_dot(turn, turn), angle = sqrt(along),
                     sine = along > 0 ? sin(angle) / angle : 1;
        const v3 row = s->trajectory.camera[view].rotation[i], side = v3_cross(row, turn);
        c.rotation[i] = v3_add(v3_add(v3_scale(row, cos(angle)), v3_scale(side, sine)),
                               v3_scale(turn, along > 0 ? v3_dot(turn, row) * (1 - cos(angle)) / along : 0));
    }
    c.centre =
        v3_add(v3_add(c.centre, v3_scale(v3_of(off[3], off[4], off[5]), distance / 100)), export_origin(s));
    return c;
}

static void export_view(const struct synth_run *s, struct output *t, struct synth_ids ids, int view)
{
    const struct synth_points *points = &s->points;
    const synth_options *o = s->options;
    const size_t first = points->view_first[view];
    for (size_t k = 0; k < points->view_first[view + 1] - first; k++) {
        const struct synth_observation *at = synth_observation_in(points, points->by_view[first + k], view);
        const uint64_t h = synth_bits(o->seed, 300 + k, (uint64_t)view);
        output_add(t, "%s%.3f %.3f %llu", k ? " " : "", (double)at->x, (double)at->y,
                   synth_id(ids, points->by_view[first + k]));
        if (synth_has_stray(o->seed, view, k))
            output_add(t, " %.3f %.3f -1", synth_unit(h) * o->width, synth_unit(synth_mix(h)) * o->height);
    }
}

static void export_images(const struct synth_run *s, struct output *t)
{
    const int count = s->trajectory.count;
    const struct synth_ids views = synth_ids_for((uint64_t)count), ids = synth_ids_for(s->points.count);
    output_add(
        t,
        "# Image list with two lines of data per image:\n#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n"
        "#   POINTS2D[] as (X, Y, POINT3D_ID)\n# Number of images: %d, mean observations per image: %.6f\n",
        count, export_mean(&s->points, (size_t)count));
    for (int i = 0; i < count; i++) {
        const struct synth_camera camera = export_camera(s, i);
        char name[32];
        synth_image_name(s->options, i, name);
        output_add(t, "%llu", synth_id(views, (uint64_t)i));
        export_pose(t, &camera);
        output_add(t, " %d %s\n", CAMERA_ID, name);
        export_view(s, t, ids, i);
        output_add(t, "\n");
    }
}

static void export_true_poses(const struct synth_run *s, struct output *t)
{
    output_add(t, "# QW, QX, QY, QZ, TX, TY, TZ, NAME: poses without the noise of sparse/0/images.txt\n");
    for (int i = 0; i < s->trajectory.count; i++) {
        struct synth_camera camera = s->trajectory.camera[i];
        char name[32];
        camera.centre = v3_add(camera.centre, export_origin(s));
        synth_image_name(s->options, i, name);
        export_pose(t, &camera);
        output_add(t, " %s\n", name);
    }
}

static void export_point(const struct synth_run *s, struct output *t, const struct synth_point *p)
{
    const v3 at = v3_add(p->position, export_origin(s));
    output_add(t, "%.6f %.6f %.6f", at.x, at.y, at.z);
    for (int c = 0; c < 3; c++) output_add(t, " %d", (p->sum[c] + p->count / 2) / p->count);
}

static void export_points(const struct synth_run *s, struct output *t)
{
    const struct synth_points *points = &s->points;
    const struct synth_ids views = synth_ids_for((uint64_t)points->views), ids = synth_ids_for(points->count);
    output_add(t,
               "# 3D point list with one line of data per point:\n"
               "#   POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n"
               "# Number of points: %zu, mean track length: %.6f\n",
               points->count, export_mean(points, points->count));
    for (size_t i = 0; i < points->count; i++) {
        const struct synth_point *p = &points->point[i];
        output_add(t, "%llu ", synth_id(ids, i));
        export_point(s, t, p);
        output_add(t, " %.6f", (double)p->error);
        for (int k = 0; k < p->count; k++) {
            const struct synth_observation *at = &points->observation[p->first + (size_t)k];
            output_add(t, " %llu %zu", synth_id(views, at->view), (size_t)at->index);
        }
        output_add(t, "\n");
    }
}

static void export_outliers(const struct synth_run *s, struct output *t)
{
    const struct synth_ids ids = synth_ids_for(s->points.count);
    output_add(t, "# POINT3D_ID of the points that lie off the surface\n");
    for (size_t i = 0; i < s->points.count; i++)
        if (s->points.point[i].is_outlier) output_add(t, "%llu\n", synth_id(ids, i));
}

/* ---------------- layouts of published scenes */

/* Writes the cameras of one split as NeRF synthetic has them: camera to world, x right, y up, z back. */
static void export_split(const struct synth_run *s, struct output *t, int is_test)
{
    const struct synth_camera *first = &s->trajectory.camera[0];
    const char *comma = "";
    output_add(t, "{\"camera_angle_x\": %.15f, %s\"frames\": [", 2 * atan(0.5 * first->width / first->f),
               is_test ? "" : "\"ply_file_path\": \"points.ply\", ");
    for (int i = 0; i < s->trajectory.count; i++) {
        const struct synth_camera c = export_camera(s, i);
        const double *x = &c.rotation[0].x, *y = &c.rotation[1].x, *z = &c.rotation[2].x, *at = &c.centre.x;
        char name[32];
        if (is_test != (i % SYNTH_TEST_EVERY == 0)) continue;
        synth_image_name(s->options, i, name);
        name[strlen(name) - 4] = 0; /* .png */
        output_add(t, "%s\n{\"file_path\": \"./%s/%s\", \"transform_matrix\": [", comma,
                   synth_image_folder(s->options, i), name);
        for (int k = 0; k < 3; k++) output_add(t, "[%.15f, %.15f, %.15f, %.9f], ", x[k], -y[k], -z[k], at[k]);
        output_add(t, "[0, 0, 0, 1]]}");
        comma = ",";
    }
    output_add(t, "]}\n");
}

static void export_train(const struct synth_run *s, struct output *t)
{
    export_split(s, t, 0);
}

static void export_test(const struct synth_run *s, struct output *t)
{
    export_split(s, t, 1);
}

static void export_ply(const struct synth_run *s, struct output *t)
{
    output_add(
        t,
        "ply\nformat ascii 1.0\nelement vertex %zu\nproperty double x\nproperty double y\nproperty double z\n"
        "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n",
        s->points.count);
    for (size_t i = 0; i < s->points.count; i++) {
        export_point(s, t, &s->points.point[i]);
        output_add(t, "\n");
    }
}

/* Writes LLFF's poses_bounds.npy: for each image its axes down, right and back, its centre, its size and focal
 * length by rows, then the least and the largest depth of its points. */
static void export_bounds(const struct synth_run *s, struct output *t)
{
    const struct synth_points *points = &s->points;
    char head[128];
    snprintf(head, sizeof head, "{'descr': '<f8', 'fortran_order': False, 'shape': (%d, 17), }",
             s->trajectory.count);
    output_bytes(t, "\x93NUMPY\1\0\166\0", 10); /* 128 bytes with the rest of the header, 118 */
    for (size_t i = strlen(head); i < 117; i++) head[i] = ' ';
    output_bytes(t, head, 117);
    output_bytes(t, "\n", 1);
    for (int i = 0; i < s->trajectory.count; i++) {
        const struct synth_camera c = export_camera(s, i), *at = &s->trajectory.camera[i];
        const double *x = &c.rotation[0].x, *y = &c.rotation[1].x, *z = &c.rotation[2].x,
                     *centre = &c.centre.x;
        const double size[3] = {c.height, c.width, c.f};
        double nearest = SYNTH_FAR, farthest = 0;
        for (size_t k = points->view_first[i]; k < points->view_first[i + 1]; k++) {
            const v3 ray = v3_sub(points->point[points->by_view[k]].position, at->centre);
            nearest = fmin(nearest, v3_dot(at->rotation[2], ray));
            farthest = fmax(farthest, v3_dot(at->rotation[2], ray));
        }
        for (int k = 0; k < 3; k++) {
            const double row[5] = {y[k], x[k], -z[k], centre[k], size[k]};
            for (int j = 0; j < 5; j++) output_real(t, row[j], 8);
        }
        output_real(t, nearest, 8);
        output_real(t, farthest, 8);
    }
}

/* ---------------- truth in words and numbers */

static void export_triple(struct output *t, const char *name, v3 value)
{
    output_add(t, "%s %.6f %.6f %.6f\n", name, value.x, value.y, value.z);
}

static void export_water(const struct synth_run *s, struct output *t)
{
    output_add(
        t,
        "# I = J exp(-bD z) + Binf (1 - exp(-bB z)) for each channel, red green blue\n"
        "# I, J: values of images/ and truth/clean/ over 255, as in the PNG files, no gamma removed\n"
        "# z: range along the ray in metres = depth * sqrt(1 + ((x-cx)/f)^2 + ((y-cy)/f)^2), at the pixel's centre\n"
        "# bD, bB: per metre; noise: sigma of the sensor in 8-bit levels, added before rounding\ntype %s\n",
        s->water.name);
    export_triple(t, "bD", s->water.direct);
    export_triple(t, "bB", v3_scale(s->water.direct, SYNTH_SCATTER));
    export_triple(t, "Binf", s->water.veil);
    output_add(t, "noise %.6f\n", s->options->noise);
}

static void export_model(const struct synth_run *s, struct output *t)
{
    const synth_options *o = s->options;
    const v3 origin = export_origin(s);
    static const char *const paths[] = {"lawnmower", "orbit", "forward"};
    output_add(
        t,
        "A made-up seabed, found by a made-up camera. Metres; x east, y north, z up.\n\n"
        "World    sand with ripples, swell and reef patches (a height field); boulders, a large one in\n"
        "         the middle, pebbles, brain and branching corals, starfish (distance functions). No Gaussians.\n"
        "Light    sun with soft shadows, sky with occlusion, light thrown back by the sand; it does not move.\n"
        "Camera   one PINHOLE camera; COLMAP's frame. Poses are %s.\n"
        "Points   on visible surfaces, exact; observations with 0.3 px of noise (sigma, each axis). 1 in 100 is an\n"
        "         outlier: off the surface, found by 2 or 3 views, 1.5 px (truth/outliers.txt lists their ids).\n"
        "Depth    truth/depth/NAME.pfm: camera z at the middle of each pixel, metres; 0: nothing but water.\n"
        "Clean    truth/clean/NAME.png: without water and noise.  Water: truth/water.txt.\n\n",
        o->pose_noise > 0 ? "off; truth/poses.txt has the true ones" : "exact");
    if (o->alpha > 0)
        output_add(
            t,
            "Alpha    images/ are transparent, and black, beyond %.2f m from the vertical axis through the "
            "centre;\n         no points are there.\n\n",
            o->alpha);
    output_add(t, "seed %llu\npath %s\nviews %d\n", (unsigned long long)o->seed, paths[o->path], o->views);
    export_triple(t, "origin", origin);
    export_triple(t, "sun", s->world.sun);
}

static void export_change(const struct synth_run *s, struct output *t)
{
    output_add(
        t,
        "# since the first dive: place in the world, radius, metres; volume that the surface rises by, cubic metres\n");
    for (int i = 0; i < 2; i++) {
        const struct synth_changed *c = &s->change[i];
        output_add(t, "%s %.4f %.4f %.4f %.4f %.6f\n", i ? "stone" : "mound",
                   c->place.x + s->options->origin[0], c->place.y + s->options->origin[1],
                   c->place.z + s->options->origin[2], c->radius, c->volume);
    }
}

static oxl_result export_write(const struct synth_run *s, const char *name,
                               void (*write)(const struct synth_run *s, struct output *t))
{
    struct output t = {0};
    char path[1024];
    snprintf(path, sizeof path, "%s/%s", s->options->out, name);
    output_open(&t, path);
    write(s, &t);
    return output_close(s->ctx, &t);
}

oxl_result synth_write_model(const struct synth_run *s)
{
    return export_write(s, "truth/model.txt", export_model);
}

/* Lists the files that depend on options, in the order in which they are written. */
static const struct export_file {
    const char *name;
    void (*write)(const struct synth_run *s, struct output *t);
    int layouts; /* bits of enum synth_layout */
} export_files[] = {
    {"truth/water.txt", export_water, 7},
    {"truth/outliers.txt", export_outliers, 7},
    {"truth/exposure.txt", synth_write_exposure, 7},
    {"truth/lamp.txt", synth_write_lamp, 7},
    {"truth/change.txt", export_change, 7},
    {"truth/poses.txt", export_true_poses, 7},
    {"sparse/0/cameras.txt", export_cameras, 5},
    {"sparse/0/points3D.txt", export_points, 5},
    {"sparse/0/images.txt", export_images, 5},
    {"points.ply", export_ply, 2},
    {"transforms_test.json", export_test, 2},
    {"transforms_train.json", export_train, 2},
    {"poses_bounds.npy", export_bounds, 4},
};

void synth_remove_files(const synth_options *o)
{
    char path[1024];
    for (size_t i = 0; i < sizeof export_files / sizeof *export_files; i++) {
        snprintf(path, sizeof path, "%s/%s", o->out, export_files[i].name);
        oxl_remove(path);
    }
}

oxl_result synth_write_files(const struct synth_run *s)
{
    const synth_options *o = s->options;
    oxl_result rc = OXL_OK;
    for (size_t i = 0; i < sizeof export_files / sizeof *export_files && rc == OXL_OK; i++) {
        const struct export_file *f = &export_files[i];
        if ((f->write == synth_write_exposure && o->exposure_jitter == 0 && o->stereo == 0) ||
            (f->write == synth_write_lamp && o->lamp < 0) ||
            (f->write == export_change && o->change != SYNTH_CHANGED) ||
            (f->write == export_true_poses && o->pose_noise == 0) || !(f->layouts >> o->layout & 1))
            continue;
        rc = export_write(s, f->name, f->write);
    }
    return rc;
}
