/* nerfstudio.c - reads transforms.json of nerfstudio and instant-ngp, with the points of a PLY file if it
 * names one.
 *
 * Source: docs.nerf.studio, "Data conventions". Intrinsics are at the top or in each frame (fl_x fl_y cx cy w
 * h; k1 k2 k3 p1 p2, or k1-k4 of OPENCV_FISHEYE; camera_angle_x in radians where there is no fl_x).
 * transform_matrix is camera to world with x right, y up, z back; file_path starts from the file's folder;
 * ply_file_path too, in the same world. NeRF synthetic's files (Mildenhall 2020) are such files with
 * camera_angle_x, without w, h and extensions of names: these are found in the image folder.
 *
 * mask_path of a frame starts from the file's folder, too; SCENE/masks and --masks come first. Members that
 * change what an image shows, and that are not read, are named once.
 */
#include "json_survey.h"
#include "ply.h"

#include "../core/vecmath.h"
#include "survey_read.h"

#define NERFSTUDIO_UNIT_ERROR 1e-3 /* Limits how far products of a rotation's columns may be off 0 and 1. */

/* Bounds the list of members outside of the frames, NULL at its end. They are found in one pass, since each
 * frame may ask for all of them. */
enum { NERFSTUDIO_MEMBERS = 30 };
static const char *const nerfstudio_members[NERFSTUDIO_MEMBERS] = {"w",
                                                                   "h",
                                                                   "fl_x",
                                                                   "fl_y",
                                                                   "cx",
                                                                   "cy",
                                                                   "k1",
                                                                   "k2",
                                                                   "k3",
                                                                   "k4",
                                                                   "k5",
                                                                   "k6",
                                                                   "p1",
                                                                   "p2",
                                                                   "camera_angle_x",
                                                                   "camera_model",
                                                                   "frames",
                                                                   "ply_file_path",
                                                                   "is_fisheye",
                                                                   "distortion_params",
                                                                   "depth_file_path",
                                                                   "normal_file_path",
                                                                   "semantics",
                                                                   "time",
                                                                   "rolling_shutter",
                                                                   "transform_matrix_end",
                                                                   "ftheta_p0",
                                                                   "fisheye_crop_radius"};

struct nerfstudio_file {
    const char *value[NERFSTUDIO_MEMBERS]; /* values of nerfstudio_members; NULL: missing */
};

static const char *nerfstudio_member(const struct nerfstudio_file *file, const char *name)
{
    for (int i = 0; nerfstudio_members[i]; i++)
        if (!strcmp(nerfstudio_members[i], name)) return file->value[i];
    return NULL;
}

/* Finds all members in one pass; of equal ones the first counts, as in oxl_json_member. */
static void nerfstudio_begin(const char *json, struct nerfstudio_file *out)
{
    *out = (struct nerfstudio_file){{NULL}};
    for (const char *key = oxl_json_first(json), *value; key && (value = oxl_json_value(key)) != NULL;
         key = oxl_json_next(value)) {
        char name[40];
        oxl_json_text(key, name, sizeof name);
        for (int i = 0; nerfstudio_members[i]; i++)
            if (!out->value[i] && !strcmp(nerfstudio_members[i], name)) out->value[i] = value;
    }
}

/* Returns a number of the frame, or else of the file, or else `otherwise`. */
static double nerfstudio_number(const struct nerfstudio_file *file, const char *frame, const char *name,
                                double otherwise)
{
    double value = oxl_json_number(frame, name);
    const char *text = nerfstudio_member(file, name);
    if (isnan(value) && text) value = oxl_json_number_at(&text);
    return isnan(value) ? otherwise : value;
}

/* Returns a coefficient by its name, or else from the array distortion_params, or else 0. */
static double nerfstudio_distortion(const struct nerfstudio_file *file, const char *frame, const char *name)
{
    static const char *const order[6] = {"k1", "k2", "k3", "k4", "p1", "p2"};
    double all[6], value = nerfstudio_number(file, frame, name, NAN);
    const char *array = oxl_json_member(frame, "distortion_params");
    if (!array) array = nerfstudio_member(file, "distortion_params");
    if (isnan(value) && array && json_survey_numbers(array, 6, all))
        for (int i = 0; i < 6; i++)
            if (!strcmp(name, order[i])) value = all[i];
    return isnan(value) ? 0 : value;
}

/* Returns 1 if is_fisheye is true, with which instant-ngp means OPENCV_FISHEYE. */
static int nerfstudio_is_fisheye(const struct nerfstudio_file *file, const char *frame)
{
    const char *value = nerfstudio_member(file, "is_fisheye");
    return oxl_json_is_true(frame, "is_fisheye") || (value && !strncmp(value, "true", 4));
}

/* Warns of members, of the file or its frames, that change what images show and that nothing here reads. */
static void nerfstudio_name_ignored(struct colmap_reader *r, const struct nerfstudio_file *file)
{
    static const char *const ignored[] = {
        "depth_file_path", "normal_file_path",     "semantics", "time",
        "rolling_shutter", "transform_matrix_end", "ftheta_p0", "fisheye_crop_radius"};
    struct text names = {.ctx = r->ctx};
    for (size_t i = 0; i < OXL_COUNT(ignored); i++) {
        int has = nerfstudio_member(file, ignored[i]) != NULL;
        for (const char *frame = oxl_json_first(nerfstudio_member(file, "frames")); frame && !has;
             frame = oxl_json_next(frame))
            has = oxl_json_member(frame, ignored[i]) != NULL;
        if (has) text_add(&names, "%s%s", names.size ? ", " : "", ignored[i]);
    }
    if (names.data)
        oxl_log(r->ctx, OXL_LOG_WARNING, "%s: not used, though it is there: %s", r->path, names.data);
    text_free(&names);
}

static oxl_result nerfstudio_model(struct colmap_reader *r, const struct nerfstudio_file *file,
                                   const char *frame, int distorted, const char **out)
{
    char name[40];
    const char *value = oxl_json_member(frame, "camera_model");
    if (!value) value = nerfstudio_member(file, "camera_model");
    oxl_json_text(value, name, sizeof name);
    *out = nerfstudio_is_fisheye(file, frame) ? "OPENCV_FISHEYE" : distorted ? "FULL_OPENCV" : "PINHOLE";
    if (!strcmp(name, "OPENCV_FISHEYE")) *out = "OPENCV_FISHEYE";
    else if (!strcmp(name, "EQUIRECTANGULAR")) *out = "EQUIRECTANGULAR";
    else if (value && strcmp(name, "OPENCV") && strcmp(name, "PINHOLE") && strcmp(name, "SIMPLE_PINHOLE"))
        return json_survey_fail(r, "camera_model", name[0] ? name : "something",
                                "OPENCV, OPENCV_FISHEYE or PINHOLE");
    return OXL_OK;
}

/* Reads a frame's camera; measured sizes and centres stand for those that the file does not state. */
static oxl_result nerfstudio_camera(struct colmap_reader *r, const struct nerfstudio_file *file,
                                    const char *frame, struct colmap_camera *c)
{
    static const char *const names[2][8] = {{"k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"},
                                            {"k1", "k2", "k3", "k4"}};
    const double w = nerfstudio_number(file, frame, "w", r->width),
                 h = nerfstudio_number(file, frame, "h", r->height);
    const double angle = nerfstudio_number(file, frame, "camera_angle_x", NAN);
    double fx = nerfstudio_number(file, frame, "fl_x", NAN), k[8];
    const char *model;
    int distorted = 0;
    oxl_result rc;
    if (isnan(fx) && angle > 0 && angle < 3.1) fx = 0.5 * w * vecmath_cos(angle / 2) / vecmath_sin(angle / 2);
    for (int i = 0; i < 8; i++) k[i] = nerfstudio_distortion(file, frame, names[0][i]);
    for (int i = 0; i < 8; i++) distorted |= k[i] != 0;
    rc = nerfstudio_model(r, file, frame, distorted, &model);
    if (rc != OXL_OK) return rc;
    if (!(w >= 1 && w <= INT_MAX && h >= 1 && h <= INT_MAX))
        return json_survey_fail(r, "w and h", "none, and no image to take them from",
                                "the images' width and height");
    *c = (struct colmap_camera){
        .model = camera_model_find(model, strlen(model)), .width = (int)w, .height = (int)h};
    c->parameter[0] = fx;
    c->parameter[1] = nerfstudio_number(file, frame, "fl_y", fx);
    c->parameter[2] = nerfstudio_number(file, frame, "cx", w / 2);
    c->parameter[3] = nerfstudio_number(file, frame, "cy", h / 2);
    if (!strcmp(model, "OPENCV_FISHEYE"))
        for (int i = 0; i < 4; i++) c->parameter[4 + i] = nerfstudio_distortion(file, frame, names[1][i]);
    if (!strcmp(model, "FULL_OPENCV")) {
        if (k[5] != 0)
            return json_survey_fail(r, "k4 of OPENCV", "a number", "0: r^8 is in no model of COLMAP's");
        memcpy(c->parameter + 4, k, 5 * sizeof *k);
    }
    return OXL_OK;
}

static int nerfstudio_same_camera(const struct colmap_camera *a, const struct colmap_camera *b)
{
    return a->model == b->model && a->width == b->width && a->height == b->height &&
           memcmp(a->parameter, b->parameter, sizeof a->parameter) == 0;
}

/* Computes the unit quaternion of a rotation matrix, by its largest component [Shepperd 1978]. */
static void nerfstudio_quaternion(const double m[9], double q[4])
{
    const double trace[4] = {m[0] + m[4] + m[8], m[0] - m[4] - m[8], m[4] - m[0] - m[8], m[8] - m[0] - m[4]};
    int largest = 0;
    double s;
    for (int i = 1; i < 4; i++)
        if (trace[i] > trace[largest]) largest = i;
    s = 0.5 / sqrt(1 + trace[largest]);
    if (largest == 0)
        q[0] = 0.25 / s, q[1] = s * (m[7] - m[5]), q[2] = s * (m[2] - m[6]), q[3] = s * (m[3] - m[1]);
    if (largest == 1)
        q[1] = 0.25 / s, q[0] = s * (m[7] - m[5]), q[2] = s * (m[1] + m[3]), q[3] = s * (m[2] + m[6]);
    if (largest == 2)
        q[2] = 0.25 / s, q[0] = s * (m[2] - m[6]), q[1] = s * (m[1] + m[3]), q[3] = s * (m[5] + m[7]);
    if (largest == 3)
        q[3] = 0.25 / s, q[0] = s * (m[3] - m[1]), q[1] = s * (m[2] + m[6]), q[2] = s * (m[5] + m[7]);
}

/* Reads a pose: turns camera to world, y up, into world to camera, y down, R = diag(1,-1,-1) M^T, t = -R c.
 * Refuses matrices that are no rotation: they would bend the scene. */
static oxl_result nerfstudio_pose(struct colmap_reader *r, const char *frame, double q[4], double t[3])
{
    const char *row = oxl_json_first(oxl_json_member(frame, "transform_matrix"));
    double m[3][4], rotation[9], last[4];
    for (int i = 0; i < 3; i++, row = oxl_json_next(row))
        if (!row || !json_survey_numbers(row, 4, m[i]))
            return json_survey_fail(r, "transform_matrix", "too little", "4 x 4 numbers");
    if (row && json_survey_numbers(row, 4, last) && fabs(last[0]) + fabs(last[1]) + fabs(last[2]) > 0)
        return json_survey_fail(r, "transform_matrix", "a last row other than 0 0 0 1",
                                "translations in the last column: the matrix may be transposed");
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) {
            const double dot = m[0][i] * m[0][k] + m[1][i] * m[1][k] + m[2][i] * m[2][k];
            if (!(fabs(dot - (i == k)) < NERFSTUDIO_UNIT_ERROR))
                return json_survey_fail(r, "transform_matrix", "no rotation",
                                        "columns of length 1 at right angles");
            rotation[3 * i + k] = i ? -m[k][i] : m[k][i];
        }
    if (m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) -
            m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0]) +
            m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0]) <
        0)
        return json_survey_fail(r, "transform_matrix", "a mirrored camera (determinant -1)",
                                "right-handed axes: two axes exchanged need one of them negated");
    for (int i = 0; i < 3; i++)
        t[i] = -(rotation[3 * i] * m[0][3] + rotation[3 * i + 1] * m[1][3] + rotation[3 * i + 2] * m[2][3]);
    nerfstudio_quaternion(rotation, q);
    return OXL_OK;
}

/* Returns 0 if all names begin with "images/", which is the image folder then; 1: names
 * start in the file's folder. */
static int nerfstudio_beside(const struct nerfstudio_file *file)
{
    for (const char *frame = oxl_json_first(nerfstudio_member(file, "frames")); frame;
         frame = oxl_json_next(frame)) {
        const char *path = oxl_json_member(frame, "file_path");
        if (path && (strncmp(path, "\"images/", 8) && strncmp(path, "\"./images/", 10))) return 1;
    }
    return 0;
}

static oxl_result nerfstudio_frame(struct colmap_reader *r, const struct nerfstudio_file *file,
                                   const char *frame)
{
    char path[NERFSTUDIO_PATH];
    struct colmap_camera camera;
    double q[4], t[3];
    const size_t row = r->out->camera_count;
    const char *end, *name = nerfstudio_name(r, oxl_json_member(frame, "file_path"), path, &end);
    oxl_result rc = nerfstudio_camera(r, file, frame, &camera);
    if (rc == OXL_OK && !name) rc = json_survey_fail(r, "file_path", "none", "the image's path");
    if (rc == OXL_OK) rc = nerfstudio_pose(r, frame, q, t);
    if (rc != OXL_OK) return rc;
    if (row == 0 || !nerfstudio_same_camera(&r->out->camera[row - 1], &camera))
        rc = json_survey_add_camera(r, &camera);
    if (rc == OXL_OK) rc = json_survey_add_image(r, name, end, (int64_t)r->out->camera_count - 1, q, t);
    if (rc == OXL_OK && oxl_json_text(oxl_json_member(frame, "mask_path"), path, sizeof path))
        rc = json_survey_add_mask(r, path);
    return rc;
}

/* ---------------- points */

/* Refuses a name that leads out of the survey, or to a pipe, which would never end. */
static oxl_result nerfstudio_check_points(struct colmap_reader *r, const char *name, const char *path)
{
    if (!colmap_name_is_safe(name, name + strlen(name)))
        return json_survey_fail(r, "ply_file_path", name, "a path inside the survey, without \"..\"");
    if (!os_is_file(path)) return json_survey_fail(r, "ply_file_path", path, "a PLY file that is there");
    return OXL_OK;
}

static oxl_result nerfstudio_points(struct colmap_reader *r, const struct nerfstudio_file *file)
{
    char name[512], *folder = oxl_strdup(r->ctx, r->path), *path,
                    *slash = folder ? strrchr(folder, '/') : NULL;
    const int named = oxl_json_text(nerfstudio_member(file, "ply_file_path"), name, sizeof name) > 0;
    oxl_result rc;
    if (slash) *slash = 0;
    path = folder && named ? oxl_path_join(r->ctx, folder, name) : NULL;
    rc = path ? nerfstudio_check_points(r, name, path) : OXL_OK;
    if (path && rc == OXL_OK) rc = ply_points_read(r, path);
    if (folder && slash && !named && os_is_file(PATH(folder, "sparse_pc.ply")))
        oxl_log(r->ctx, OXL_LOG_WARNING,
                "%s: \"ply_file_path\" is missing, so the points of sparse_pc.ply beside it are not read",
                r->path);
    OXL_FREE(r->ctx, path, folder);
    return rc;
}

OXL_INTERNAL oxl_result nerfstudio_read(struct colmap_reader *r, const char *json)
{
    struct nerfstudio_file file;
    oxl_result rc = OXL_OK;
    int beside;
    nerfstudio_begin(json, &file);
    beside = nerfstudio_beside(&file);
    if (r->out->image_count > 0 && beside && !r->out->images_beside)
        return json_survey_fail(r, "file_path", "a path outside images/",
                                "images/, where " JSON_SURVEY_TRAIN " has its images");
    if (r->out->image_count == 0) r->out->images_beside = beside;
    if (isnan(oxl_json_number(json, "w")) || isnan(oxl_json_number(json, "h")))
        nerfstudio_measure_image(r, json);
    for (const char *frame = oxl_json_first(nerfstudio_member(&file, "frames")); frame && rc == OXL_OK;
         frame = oxl_json_next(frame)) {
        r->line++;
        rc = nerfstudio_frame(r, &file, frame);
    }
    nerfstudio_name_ignored(r, &file);
    if (rc == OXL_OK) rc = nerfstudio_points(r, &file);
    return rc == OXL_OK ? nerfstudio_split(r, json) : rc;
}
