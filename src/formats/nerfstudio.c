/* nerfstudio.c - reads transforms.json of nerfstudio and instant-ngp, with the points of a PLY file if it
 * names one.
 *
 * Source: docs.nerf.studio, "Data conventions". Intrinsics are at the top or in each frame (fl_x fl_y cx cy w
 * h; k1 k2 k3 p1 p2, or k1-k4 of OPENCV_FISHEYE; camera_angle_x in radians where there is no fl_x).
 * transform_matrix is camera to world with x right, y up, z back; file_path starts from the file's folder;
 * ply_file_path too, in the same world. train_filenames, val_filenames and test_filenames repeat the
 * file_path of frames. NeRF synthetic's files (Mildenhall 2020) are such files with camera_angle_x, without
 * w, h and extensions of names: these are found in the image folder.
 *
 * mask_path of a frame starts from the file's folder, too; SCENE/masks and --masks come first. Members that
 * change what an image shows, and that are not read, are named once.
 *
 * Invariant: an image is trained on only if the file does not hold it out.
 */
#include "../core/vecmath.h"
#include "../survey/image_header.h"
#include "json_survey.h"

enum {
    NERFSTUDIO_PATH = 1024, /* bytes of a path, with 8 for an extension */
    FL_X = 0,
    FL_Y,
    CX,
    CY,
    WIDTH,
    HEIGHT,
    ANGLE_X,
    ANGLE_Y,
    K1,
    K2,
    P1,
    P2,
    K3,
    K4,
    K5,
    K6,
    NERFSTUDIO_NUMBERS
};
static const char *const nerfstudio_names[NERFSTUDIO_NUMBERS] = {
    "fl_x", "fl_y", "cx", "cy", "w",  "h", "camera_angle_x", "camera_angle_y", "k1", "k2",
    "p1",   "p2",   "k3", "k4", "k5", "k6"};

struct nerfstudio_file { /* Holds what the file states for all frames. */
    const char *frames, *model;
    double number[NERFSTUDIO_NUMBERS]; /* NAN: not stated */
    int is_fisheye, contradicts;       /* contradicts: frames with two focal lengths */
    struct json_names listed;          /* images by the lists that name them, enum nerfstudio_list */
    size_t in_list[3];
};

/* Orders the lists: an image in several is held out if one of them holds it out. */
enum nerfstudio_list { LIST_TEST, LIST_VAL, LIST_TRAIN };

/* ---------------- cameras */

/* Reads the numbers of a frame or of the file, or else those of `otherwise`. */
static void nerfstudio_read_numbers(const char *object, const double *otherwise, double *out)
{
    static const int order[6] = {K1, K2, K3, K4, P1, P2};
    double all[6];
    const int has_all = json_survey_numbers(oxl_json_member(object, "distortion_params"), 6, all);
    for (int i = 0; i < NERFSTUDIO_NUMBERS; i++) {
        out[i] = oxl_json_number(object, nerfstudio_names[i]);
        for (int k = 0; k < 6 && has_all && isnan(out[i]); k++)
            if (order[k] == i) out[i] = all[k];
        if (isnan(out[i])) out[i] = otherwise ? otherwise[i] : NAN;
    }
}

/* Returns the name of COLMAP's camera model; is_fisheye is instant-ngp's word. */
static const char *nerfstudio_model(struct colmap_reader *r, const struct nerfstudio_file *file,
                                    const char *frame, int distorted)
{
    char name[40];
    const char *value = oxl_json_member(frame, "camera_model");
    if (!value) value = file->model;
    oxl_json_text(value, name, sizeof name);
    if (!strcmp(name, "EQUIRECTANGULAR")) return "EQUIRECTANGULAR";
    if (!strcmp(name, "OPENCV_FISHEYE")) return "OPENCV_FISHEYE";
    if (value && strcmp(name, "OPENCV") && strcmp(name, "PINHOLE") && strcmp(name, "SIMPLE_PINHOLE"))
        json_survey_fail(r, "camera_model", name[0] ? name : "something",
                         "OPENCV, OPENCV_FISHEYE or PINHOLE");
    if (file->is_fisheye || oxl_json_is_true(frame, "is_fisheye")) return "OPENCV_FISHEYE";
    return distorted ? "FULL_OPENCV" : "PINHOLE";
}

/* Bounds the ratio of focal lengths that contradict each other from below. */
#define NERFSTUDIO_CONTRADICTION 1.1

/* Returns the focal length, in px, of a field of view of `angle` radians; NAN: that is none. */
static double nerfstudio_focal(double angle, double side)
{
    return angle > 0 && angle < 3.1 ? 0.5 * side * vecmath_cos(angle / 2) / vecmath_sin(angle / 2) : NAN;
}

/* Takes focal lengths from the field of view where there are none. Warns once where both are there and
 * contradict each other; the field of view counts then if the focal length is none of a camera. */
static void nerfstudio_focals(struct colmap_reader *r, struct nerfstudio_file *file, double *v, double w,
                              double h)
{
    const double by_x = nerfstudio_focal(v[ANGLE_X], w), ratio = v[FL_X] / by_x;
    const int is_odd = !camera_focal_is_plausible(v[FL_X], w, h) && camera_focal_is_plausible(by_x, w, h);
    if (isnan(v[FL_X])) v[FL_X] = isnan(by_x) ? nerfstudio_focal(v[ANGLE_Y], h) : by_x;
    if (isnan(v[FL_Y])) v[FL_Y] = v[FL_X];
    if (!(ratio >= NERFSTUDIO_CONTRADICTION || ratio <= 1 / NERFSTUDIO_CONTRADICTION)) return;
    if (!file->contradicts++)
        oxl_log(r->ctx, OXL_LOG_WARNING,
                "%s: fl_x is %g px, and %g px follow from camera_angle_x (%.1f degrees) of images %.0f px "
                "wide; %s is taken\nfix: correct fl_x, or leave camera_angle_x out",
                r->path, v[FL_X], by_x, v[ANGLE_X] * 57.29577951308232, w,
                is_odd ? "camera_angle_x" : "fl_x");
    if (is_odd) v[FL_X] /= ratio, v[FL_Y] /= ratio;
}

/* Reads a frame's camera; measured sizes and centres stand for those that the file does not state. */
static struct colmap_camera nerfstudio_camera(struct colmap_reader *r, struct nerfstudio_file *file,
                                              const char *frame)
{
    static const int order[][5] = {{K1, K2, K3, K4}, {K1, K2, P1, P2, K3}}; /* of COLMAP's parameters */
    struct colmap_camera c = {0};
    double v[NERFSTUDIO_NUMBERS], w, h;
    const char *model;
    int distorted = 0, is_fisheye;
    nerfstudio_read_numbers(frame, file->number, v);
    for (int i = K1; i <= K6; i++) distorted |= (v[i] = isnan(v[i]) ? 0 : v[i]) != 0;
    w = isnan(v[WIDTH]) ? r->width : v[WIDTH];
    h = isnan(v[HEIGHT]) ? r->height : v[HEIGHT];
    model = nerfstudio_model(r, file, frame, distorted);
    is_fisheye = !strcmp(model, "OPENCV_FISHEYE");
    if (!(w >= 1 && w <= INT_MAX && h >= 1 && h <= INT_MAX))
        json_survey_fail(r, "w and h", "none, and no image to take them from",
                         "the images' width and height");
    if (distorted && !is_fisheye && v[K4] != 0)
        json_survey_fail(r, "k4 of OPENCV", "a number", "0: r^8 is in no model of COLMAP's");
    if (r->rc != OXL_OK) return c;
    nerfstudio_focals(r, file, v, w, h);
    c.model = camera_model_find(model, strlen(model));
    c.width = (int)w, c.height = (int)h;
    c.parameter[0] = v[FL_X], c.parameter[1] = v[FL_Y];
    c.parameter[2] = isnan(v[CX]) ? w / 2 : v[CX];
    c.parameter[3] = isnan(v[CY]) ? h / 2 : v[CY];
    for (int i = 0; i < 5 - is_fisheye && distorted; i++) c.parameter[4 + i] = v[order[!is_fisheye][i]];
    return c;
}

/* Reads a camera-to-world matrix of 3 or 4 rows. */
static void nerfstudio_pose(struct colmap_reader *r, const char *frame, double q[4], double t[3])
{
    const char *row = oxl_json_first(oxl_json_member(frame, "transform_matrix"));
    double m[3][4] = {{0}}, last[4];
    for (int i = 0; i < 3; i++, row = oxl_json_next(row))
        if (!row || !json_survey_numbers(row, 4, m[i]))
            json_survey_fail(r, "transform_matrix", "too little", "4 x 4 numbers");
    if (row && json_survey_numbers(row, 4, last) && fabs(last[0]) + fabs(last[1]) + fabs(last[2]) > 0)
        json_survey_fail(r, "transform_matrix", "a last row other than 0 0 0 1",
                         "translations in the last column: the matrix may be transposed");
    json_survey_pose(r, "transform_matrix", m, q, t);
}

/* ---------------- names of images */

/* Writes the path of the file that a name means: its longest end that is in the folder in which names
 * start. */
static const char *nerfstudio_path(const struct colmap_reader *r, const char *name, const char *extension,
                                   char out[PATH_LENGTH])
{
    char file[NERFSTUDIO_PATH];
    const char *beside = PATH_BESIDE(r->path, r->beside ? "" : "images"),
               *folder = r->given.images ? r->given.images : beside;
    strcpy(file + colmap_safe_name(name, strlen(name), file), extension);
    return path_in(out, folder, "%s", path_longest_tail(folder, file));
}

/* Turns an image's path in the file into a name: from the image folder, with an extension. Where Blender's
 * files leave that out, it is that of a file that exists, else .png. NULL: the value is no text. */
static const char *nerfstudio_name(const struct colmap_reader *r, const char *value,
                                   char path[NERFSTUDIO_PATH])
{
    static const char *const extension[] = {"", ".png", ".jpg", ".jpeg", ".PNG", ".JPG", ".JPEG"};
    const size_t length = oxl_json_text(value, path, NERFSTUDIO_PATH - 8);
    const char *name = path;
    char full[PATH_LENGTH];
    if (length == 0) return NULL;
    if (!strncmp(name, "./", 2)) name += 2;
    if (!r->beside && !strncmp(name, "images/", 7)) name += 7;
    if (survey_is_image_name(name)) return name;
    for (size_t i = 0; i < OXL_COUNT(extension); i++)
        if (os_is_file(nerfstudio_path(r, name, extension[i], full))) return strcat(path, extension[i]), name;
    return strcat(path, strchr(path_base_name(name), '.') ? "" : ".png"), name;
}

/* Sets r->width and r->height to the size that most of the images have (Boyer & Moore 1991); both stay 0 if
 * there is none. */
static void nerfstudio_measure_image(struct colmap_reader *r, const struct nerfstudio_file *file)
{
    char path[NERFSTUDIO_PATH], full[PATH_LENGTH];
    int votes = 0;
    for (const char *frame = oxl_json_first(file->frames); frame; frame = oxl_json_next(frame)) {
        const char *name = nerfstudio_name(r, oxl_json_member(frame, "file_path"), path);
        struct image_header h;
        if (!name || !os_is_file(nerfstudio_path(r, name, "", full)) ||
            image_read_header(r->ctx, full, &h) != OXL_OK ||
            (h.width < 1 && image_size(r->ctx, full, &h.width, &h.height) != OXL_OK))
            continue;
        if (votes == 0) r->width = h.width, r->height = h.height;
        votes += h.width == r->width && h.height == r->height ? 1 : -1;
    }
}

/* Returns 0 if all names begin with "images/", which is the image folder then; 1: names
 * start in the file's folder. */
static int nerfstudio_beside(const struct nerfstudio_file *file)
{
    for (const char *frame = oxl_json_first(file->frames); frame; frame = oxl_json_next(frame)) {
        const char *path = oxl_json_member(frame, "file_path");
        if (path && (strncmp(path, "\"images/", 8) && strncmp(path, "\"./images/", 10))) return 1;
    }
    return 0;
}

/* ---------------- frames */

/* Returns the split of an image. Without train_filenames, images in no list are trained on; val_filenames are
 * held out if there are no test_filenames. */
static enum colmap_split nerfstudio_split(const struct nerfstudio_file *file, const char *path)
{
    const int64_t list = json_names_find(&file->listed, path);
    if (list < 0) return file->in_list[LIST_TRAIN] ? COLMAP_UNSPLIT : COLMAP_TRAIN;
    if (list == LIST_TRAIN) return COLMAP_TRAIN;
    return list == LIST_TEST || file->in_list[LIST_TEST] == 0 ? COLMAP_TEST : COLMAP_UNSPLIT;
}

static void nerfstudio_frame(struct colmap_reader *r, struct nerfstudio_file *file, const char *frame)
{
    char path[NERFSTUDIO_PATH];
    const char *value = oxl_json_member(frame, "file_path"), *name = nerfstudio_name(r, value, path);
    const struct colmap_camera camera = nerfstudio_camera(r, file, frame);
    const enum colmap_split split = file->listed.count ? nerfstudio_split(file, value) : COLMAP_TRAIN;
    struct colmap_image *image;
    double q[4] = {1}, t[3] = {0};
    if (!name) json_survey_fail(r, "file_path", "none", "the image's path");
    nerfstudio_pose(r, frame, q, t);
    if (r->rc != OXL_OK || split == COLMAP_UNSPLIT) return;
    json_survey_add_image(r, name, json_survey_camera(r, &camera), q, t);
    if (r->rc != OXL_OK) return;
    image = &r->out->image[r->out->image_count - 1];
    if (file->listed.count) image->split = split;
    if (!oxl_json_text(oxl_json_member(frame, "mask_path"), path, sizeof path)) return;
    r->cursor = path;
    r->end = path + strlen(path);
    colmap_read_name(r, &image->mask);
}

static void nerfstudio_frames(struct colmap_reader *r, struct nerfstudio_file *file)
{
    struct colmap *out = r->out;
    size_t all = 0, held_out = 0;
    for (const char *frame = oxl_json_first(file->frames); frame && r->rc == OXL_OK;
         frame = oxl_json_next(frame), all++) {
        r->line++;
        nerfstudio_frame(r, file, frame);
    }
    if (r->rc != OXL_OK || file->listed.count == 0) return;
    for (size_t i = 0; i < out->image_count; i++) held_out += out->image[i].split == COLMAP_TEST;
    out->states_split = 1;
    oxl_log(r->ctx, out->image_count < all ? OXL_LOG_WARNING : OXL_LOG_INFO,
            "%s states the split: %zu images are trained on, %zu held out, %zu neither and left out", r->path,
            out->image_count - held_out, held_out, all - out->image_count);
}

/* ---------------- the file */

/* Warns of members, of the file or its frames, that change what images show and that nothing here reads. */
static void nerfstudio_name_ignored(struct colmap_reader *r, const char *json)
{
    static const char *const ignored[] = {
        "\"depth_file_path\"", "\"normal_file_path\"",     "\"semantics\"", "\"time\"",
        "\"rolling_shutter\"", "\"transform_matrix_end\"", "\"ftheta_p0\"", "\"fisheye_crop_radius\""};
    struct text names = {.ctx = r->ctx};
    for (size_t i = 0; i < OXL_COUNT(ignored); i++)
        if (strstr(json, ignored[i]))
            text_add(&names, "%s%.*s", names.size ? ", " : "", (int)strlen(ignored[i]) - 2, ignored[i] + 1);
    if (names.data)
        oxl_log(r->ctx, OXL_LOG_WARNING, "%s: this content of the file is not used: %s", r->path, names.data);
    text_free(&names);
}

/* Reads the points of ply_file_path, and names other files of points that are beside. Points are not
 * essential. */
static void nerfstudio_points(struct colmap_reader *r, const char *json)
{
    static const char *const beside[] = {"sparse_pc.ply", "points3d.ply", "points3D.ply", ""};
    char name[NERFSTUDIO_PATH] = "";
    const size_t named = oxl_json_text(oxl_json_member(json, "ply_file_path"), name, sizeof name);
    const char *folder = PATH_BESIDE(r->path, ""), *path;
    size_t i = 0;
    name[colmap_safe_name(name, named, name)] = 0;
    path = PATH(folder, "%s", path_longest_tail(folder, name));
    if (r->rc != OXL_OK || r->out->image_count || r->given.points)
        return; /* The file of another split was read first. */
    if (named && os_is_file(path)) {
        r->rc = ply_points_read(r, path);
        return;
    }
    while (*beside[i] && !os_is_file(PATH(folder, "%s", beside[i]))) i++;
    if (named || *beside[i])
        oxl_log(r->ctx, OXL_LOG_WARNING,
                "%s: ply_file_path names %s%s%s%s, so no points are read\n"
                "fix: name a file of points by --sparse",
                r->path, named ? name : "no file", named ? ", which is not there" : "",
                *beside[i] ? "; beside it is " : "", beside[i]);
}

OXL_INTERNAL void nerfstudio_read(struct colmap_reader *r, const struct os_file_map *map)
{
    const char *json = map->data;
    static const char *const lists[] = {"test_filenames", "val_filenames", "train_filenames"};
    struct nerfstudio_file file = {.frames = oxl_json_member(json, "frames"),
                                   .model = oxl_json_member(json, "camera_model"),
                                   .is_fisheye = oxl_json_is_true(json, "is_fisheye")};
    const int beside = nerfstudio_beside(&file);
    nerfstudio_read_numbers(json, NULL, file.number);
    for (int k = 0; k < 3; k++) {
        const size_t before = file.listed.count;
        for (const char *value = oxl_json_first(oxl_json_member(json, lists[k])); value;
             value = oxl_json_next(value))
            json_names_add(r, &file.listed, value, k);
        file.in_list[k] = file.listed.count - before;
    }
    if (r->out->image_count > 0 && beside && !r->beside)
        json_survey_fail(r, "file_path", "a path outside images/",
                         "images/, as in the file of training images");
    if (r->out->image_count == 0) r->beside = beside;
    if (isnan(file.number[WIDTH]) || isnan(file.number[HEIGHT])) nerfstudio_measure_image(r, &file);
    nerfstudio_points(r, json);
    nerfstudio_frames(r, &file);
    nerfstudio_name_ignored(r, json);
    oxl_free(r->ctx, file.listed.name);
}
