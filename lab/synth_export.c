/* synth_export.c - the three text files, in the layout of COLMAP's documentation ("Output Format").
 *
 * Ids are sparse and unordered, keypoints without a point are mixed with the others, as in real exports. Invariant: both ways
 * round, observation POINT2D_IDX of image IMAGE_ID names POINT3D_ID.
 */
#include "synth.h"

enum { CAMERA_ID = 3 };

static uint64_t export_common_divisor(uint64_t a, uint64_t b)
{
    while (b > 0) {
        const uint64_t rest = a % b;
        a                   = b;
        b                   = rest;
    }
    return a;
}

struct synth_ids synth_ids_for(uint64_t count)
{
    struct synth_ids ids = {.modulus = count + count / 2 + 7};
    ids.stride           = (uint64_t)(0.381966 * (double)ids.modulus) | 1;
    while (export_common_divisor(ids.stride, ids.modulus) != 1) ids.stride += 2;
    return ids;
}

uint64_t synth_id(struct synth_ids ids, uint64_t index)
{
    return 1 + index * ids.stride % ids.modulus;
}

/* w x y z, w >= 0 (Shepperd 1978: divides by the largest of the four). */
static void export_quaternion(const double r[9], double q[4])
{
    const double t[4]    = {r[0] + r[4] + r[8], r[0] - r[4] - r[8], r[4] - r[0] - r[8], r[8] - r[0] - r[4]};
    const double d[4][4] = {{0, r[7] - r[5], r[2] - r[6], r[3] - r[1]},
                            {r[7] - r[5], 0, r[1] + r[3], r[2] + r[6]},
                            {r[2] - r[6], r[1] + r[3], 0, r[5] + r[7]},
                            {r[3] - r[1], r[2] + r[6], r[5] + r[7], 0}};
    int          most    = 0;
    double       size;
    for (int i = 1; i < 4; i++)
        if (t[i] > t[most]) most = i;
    size = sqrt(1 + t[most]);
    for (int i = 0; i < 4; i++) q[i] = i == most ? 0.5 * size : 0.5 * d[most][i] / size;
    if (q[0] < 0)
        for (int i = 0; i < 4; i++) q[i] = -q[i];
}

static void export_numbers(struct output_file *f, const double *value, int count, int decimals)
{
    for (int i = 0; i < count; i++) {
        output_file_text(f, " ");
        output_file_fixed(f, value[i], decimals);
    }
}

static void export_mean(struct output_file *f, const char *what, uint64_t count, const char *mean, double value)
{
    output_file_text(f, what);
    output_file_integer(f, count);
    output_file_text(f, mean);
    output_file_fixed(f, value, 6);
    output_file_text(f, "\n");
}

static int export_write_cameras(const struct synth_trajectory *trajectory, const char *name)
{
    const struct synth_camera *c = &trajectory->camera[0];
    struct output_file         f;
    output_file_open(&f, name);
    output_file_text(&f, "# Camera list with one line of data per camera:\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
                         "# Number of cameras: 1\n");
    output_file_integer(&f, CAMERA_ID);
    output_file_text(&f, " PINHOLE ");
    output_file_integer(&f, (uint64_t)c->width);
    output_file_text(&f, " ");
    output_file_integer(&f, (uint64_t)c->height);
    export_numbers(&f, (double[4]){c->f, c->f, c->cx, c->cy}, 4, 9);
    output_file_text(&f, "\n");
    return output_file_close(&f);
}

static void export_pose(struct output_file *f, const struct synth_camera *c, const double origin[3])
{
    const double *r = c->rotation, at[3] = {c->centre.x + origin[0], c->centre.y + origin[1], c->centre.z + origin[2]};
    double        q[4], t[3];
    export_quaternion(r, q);
    for (int i = 0; i < 3; i++) t[i] = -(r[3 * i] * at[0] + r[3 * i + 1] * at[1] + r[3 * i + 2] * at[2]);
    export_numbers(f, q, 4, 15);
    export_numbers(f, t, 3, 9);
}

static void export_keypoint(struct output_file *f, int is_first, double x, double y)
{
    if (!is_first) output_file_text(f, " ");
    output_file_fixed(f, x, 3);
    output_file_text(f, " ");
    output_file_fixed(f, y, 3);
    output_file_text(f, " ");
}

static void export_view(struct output_file *f, const synth_options *o, const struct synth_points *points, struct synth_ids ids,
                        int view)
{
    const size_t first = points->view_first[view];
    for (size_t k = 0; k < points->view_first[view + 1] - first; k++) {
        const struct synth_observation *at = synth_observation_in(points, points->by_view[first + k], view);
        const uint64_t                  h  = synth_bits(o->seed, 300 + k, (uint64_t)view);
        export_keypoint(f, k == 0, at->x, at->y);
        output_file_integer(f, synth_id(ids, points->by_view[first + k]));
        if (!synth_has_stray(o->seed, view, k)) continue;
        export_keypoint(f, 0, synth_unit(h) * o->width, synth_unit(synth_mix(h)) * o->height);
        output_file_text(f, "-1");
    }
    output_file_text(f, "\n");
}

static int export_write_images(const synth_options *o, const struct synth_trajectory *trajectory,
                               const struct synth_points *points, const char *name)
{
    const struct synth_ids views = synth_ids_for((uint64_t)trajectory->count), ids = synth_ids_for(points->count);
    struct output_file     f;
    output_file_open(&f, name);
    output_file_text(&f,
                     "# Image list with two lines of data per image:\n#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n"
                     "#   POINTS2D[] as (X, Y, POINT3D_ID)\n");
    export_mean(&f, "# Number of images: ", (uint64_t)trajectory->count,
                ", mean observations per image: ", (double)points->observation_count / trajectory->count);
    for (int i = 0; i < trajectory->count; i++) {
        char image[32];
        synth_image_name(o, i, image);
        output_file_integer(&f, synth_id(views, (uint64_t)i));
        export_pose(&f, &trajectory->camera[i], o->origin);
        output_file_text(&f, " ");
        output_file_integer(&f, CAMERA_ID);
        output_file_text(&f, " ");
        output_file_text(&f, image);
        output_file_text(&f, "\n");
        export_view(&f, o, points, ids, i);
    }
    return output_file_close(&f);
}

static void export_point(struct output_file *f, const synth_options *o, const struct synth_points *points, struct synth_ids views,
                         const struct synth_point *p)
{
    const double at[3] = {p->position.x + o->origin[0], p->position.y + o->origin[1], p->position.z + o->origin[2]};
    export_numbers(f, at, 3, 6);
    for (int c = 0; c < 3; c++) {
        output_file_text(f, " ");
        output_file_integer(f, (p->sum[c] + p->count / 2u) / p->count);
    }
    output_file_text(f, " ");
    output_file_fixed(f, p->error, 6);
    for (int k = 0; k < p->count; k++) {
        const struct synth_observation *s = &points->observation[p->first + (size_t)k];
        output_file_text(f, " ");
        output_file_integer(f, synth_id(views, s->view));
        output_file_text(f, " ");
        output_file_integer(f, s->index);
    }
    output_file_text(f, "\n");
}

static int export_write_points(const synth_options *o, const struct synth_points *points, const char *name)
{
    const struct synth_ids views = synth_ids_for((uint64_t)points->views), ids = synth_ids_for(points->count);
    struct output_file     f;
    output_file_open(&f, name);
    output_file_text(&f, "# 3D point list with one line of data per point:\n"
                         "#   POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n");
    export_mean(&f, "# Number of points: ", points->count,
                ", mean track length: ", points->count > 0 ? (double)points->observation_count / (double)points->count : 0);
    for (size_t i = 0; i < points->count; i++) {
        output_file_integer(&f, synth_id(ids, i));
        export_point(&f, o, points, views, &points->point[i]);
    }
    return output_file_close(&f);
}

oxl_result synth_colmap_write(const synth_options *o, const struct synth_trajectory *trajectory,
                              const struct synth_points *points, const char *folder, char *failed, size_t failed_size)
{
    int written;
    snprintf(failed, failed_size, "%s/cameras.txt", folder);
    written = export_write_cameras(trajectory, failed);
    if (written) snprintf(failed, failed_size, "%s/points3D.txt", folder);
    written = written && export_write_points(o, points, failed);
    if (written) snprintf(failed, failed_size, "%s/images.txt", folder);
    written = written && export_write_images(o, trajectory, points, failed);
    return written ? OXL_OK : OXL_ERR_IO;
}
