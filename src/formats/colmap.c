/* colmap.c - reads a COLMAP model, text or binary: cameras, images, points3D.
 *
 * Source: "Output Format" in COLMAP's documentation, src/colmap/scene/reconstruction_io_binary.cc (3.x to
 * 4.1), and variants of other programs: CR LF, tabs, a missing line of 2D points, -nan(ind).
 * Both formats have the same fields in the same order. Binary files are little endian, nothing is aligned,
 * and begin with the number of their rows (u64):
 *
 *     cameras    u32 id  i32 model  u64 width  u64 height  f64 parameters[of the model]
 *     images     u32 id  f64 qw qx qy qz tx ty tz  u32 camera  name, zero  u64 n, then
 *                n x (f64 x y, u64 point)
 *     points3D   u64 id  f64 x y z  u8 r g b  f64 error  u64 n, then n x (u32 image, u32 observation)
 *
 * In text, a name is the rest of the line, and an image's 2D points are a line of their own, which may be
 * empty; some programs leave it out. rigs.bin and frames.bin of COLMAP 3.12 and later are not read:
 * images.bin has each image's own pose. Recoverable deviations are read with a warning.
 *
 * Invariants of colmap_read's result: rows are sorted by their ids, since COLMAP writes them in the order of
 * its hash tables; ids are unique; each image's camera and each track's image exist; all numbers are finite
 * (an unknown reprojection error is -1, as in COLMAP); no image name points outside the image folder.
 * Not guaranteed: that points named by observations, and observations named by tracks, exist.
 */
#include "formats.h"
#include "colmap.h"
#include "../core/bytes.h"
#include "json_survey.h"
#include "../survey/scene.h"

enum {
    COLMAP_OBSERVATION = 24, /* bytes of a 2D point in images.bin */
    COLMAP_DUMMY = 100       /* points; fewer may stand for those of a PLY */
};
#define COLMAP_SAME 1e-4 /* Limits how far the places of two models' images differ, of their sum. */

/* ---------------- ids */

static int colmap_compare_ids(const void *a, const void *b)
{
    int64_t x, y;
    memcpy(&x, a, sizeof x);
    memcpy(&y, b, sizeof y);
    return (x > y) - (x < y);
}

/* Finds the row with an id among sorted rows, which begin with theirs; NULL: there is none. Looks first where
 * it is if no id is left out. */
static const void *colmap_find(const void *rows, size_t count, size_t size, int64_t id)
{
    int64_t first = 0;
    uint64_t at;
    const char *guess;
    if (count == 0) return NULL;
    memcpy(&first, rows, sizeof first);
    at = (uint64_t)id - (uint64_t)first;
    guess = (const char *)rows + (at < count ? at : 0) * size;
    return colmap_compare_ids(guess, &id) == 0 ? guess : bsearch(&id, rows, count, size, colmap_compare_ids);
}

OXL_INTERNAL const struct colmap_camera *colmap_find_camera(const struct colmap *c, int64_t id)
{
    return colmap_find(c->camera, c->camera_count, sizeof *c->camera, id);
}

/* Sorts rows by their ids; returns the row after one of the same id, or NULL. */
static const void *colmap_sort(void *rows, size_t count, size_t size)
{
    const char *row = rows;
    int is_sorted = 1;
    for (size_t i = 1; i < count && is_sorted; i++)
        is_sorted = colmap_compare_ids(row + (i - 1) * size, row + i * size) < 0;
    if (is_sorted) return NULL;
    qsort(rows, count, size, colmap_compare_ids);
    for (size_t i = 1; i < count; i++)
        if (colmap_compare_ids(row + (i - 1) * size, row + i * size) == 0) return row + i * size;
    return NULL;
}

/* ---------------- cameras */

static void colmap_read_model(struct colmap_reader *r, struct colmap_camera *c)
{
    char seen[64];
    const struct camera_model *model;
    if (!colmap_field(r, "MODEL", 4)) return;
    if (r->out->format == COLMAP_BINARY) {
        c->model = (int)OXL_MIN(bytes_u32(r->field), (uint32_t)INT_MAX);
        snprintf(seen, sizeof seen, "%d", c->model);
    } else {
        while (!colmap_at_field_end(r)) r->cursor++;
        c->model = camera_model_find(r->field, (size_t)(r->cursor - r->field));
        colmap_printable(r, seen);
    }
    model = camera_model_at(c->model);
    if (model) c->parameter_count = model->parameter_count;
    else
        colmap_fail(r,
                    "let COLMAP undistort: colmap image_undistorter --image_path IMAGES --input_path MODEL "
                    "--output_path OUT",
                    "found %s for the camera model, expected one of %s", seen, camera_model_list());
}

/* Takes numbers behind the eight of OPENCV as k3 to k6, which OpenCV writes there: FULL_OPENCV has them.
 * Refuses other text behind the parameters. */
static void colmap_read_more(struct colmap_reader *r, struct colmap_camera *c, const char *wanted)
{
    const int full = camera_model_find("FULL_OPENCV", 11), most = camera_model_at(full)->parameter_count;
    if (!colmap_has_more(r)) return;
    if (c->model == camera_model_find("OPENCV", 6)) {
        oxl_log(r->ctx, OXL_LOG_WARNING,
                "%s:%d: OPENCV has 8 numbers; the numbers after them are read as k3 to k6 of FULL_OPENCV, as "
                "OpenCV orders them",
                r->path, r->line);
        for (int i = c->parameter_count; i < most && colmap_has_more(r); i++)
            c->parameter[i] = colmap_finite(r, wanted);
        c->model = full, c->parameter_count = most;
    }
    if (colmap_has_more(r)) colmap_fail_field(r, "the end of the line", wanted, 0);
}

static void colmap_read_camera(struct colmap_reader *r)
{
    struct colmap_camera c = {.id = colmap_id(r, "CAMERA_ID", 4)};
    char wanted[80];
    colmap_read_model(r, &c);
    snprintf(wanted, sizeof wanted, "the %d PARAMS of %s", c.parameter_count,
             r->rc == OXL_OK ? camera_model_at(c.model)->name : "");
    c.width = (int)colmap_whole(r, "WIDTH", 8, 1, INT_MAX);
    c.height = (int)colmap_whole(r, "HEIGHT", 8, 1, INT_MAX);
    for (int i = 0; i < c.parameter_count && r->rc == OXL_OK; i++) {
        c.parameter[i] = colmap_finite(r, wanted);
        if (i < camera_model_at(c.model)->focal_count && !(c.parameter[i] > 0))
            colmap_fail_field(r, "a focal length", "more than 0 px", c.parameter[i]);
    }
    colmap_read_more(r, &c, wanted);
    c.file = r->out->format == COLMAP_TEXT ? "cameras.txt" : "cameras.bin";
    c.line = r->line;
    COLMAP_ADD(r, camera, c);
}

/* ---------------- images */

static void colmap_check_camera(struct colmap_reader *r, int64_t id)
{
    const struct colmap *c = r->out;
    if (r->rc == OXL_OK && !colmap_find_camera(c, id))
        colmap_fail(r, "export all three files from the same COLMAP model",
                    "camera id %" PRId64 " is not in %s (%zu ids there: %" PRId64 " to %" PRId64 ")", id,
                    c->camera->file, c->camera_count, c->camera[0].id, c->camera[c->camera_count - 1].id);
}

static int colmap_peek_real(const char **p, const char *end, double *out)
{
    while (*p < end && colmap_is_blank(**p)) ++*p;
    return parse_double(p, end, out) && (*p == end || colmap_is_blank(**p));
}

/* Returns 1 if the line at the position of 2D points is the first line of an image: 9 numbers and a name,
 * which may begin with numbers. Triples of numbers are 2D points. */
static int colmap_is_pose(const struct colmap_reader *r)
{
    const char *p = r->cursor;
    double number;
    int n = 0;
    while (n < 12 && colmap_peek_real(&p, r->end, &number)) n++;
    return n >= 9 && n < 12 && (p < r->end || n % 3);
}

/* Skips an image's 2D points. If their line is missing, the reader does not advance. */
static void colmap_skip_observations(struct colmap_reader *r)
{
    if (r->out->format == COLMAP_BINARY)
        colmap_skip(r, COLMAP_OBSERVATION * colmap_count(r, "the number of 2D points", COLMAP_OBSERVATION));
    else if (colmap_next_line(r) && r->cursor < r->end && (*r->cursor == '#' || colmap_is_pose(r))) {
        colmap_warn(r, WARN_NO_POINTS_LINE);
        r->next = r->cursor;
        r->line--;
    }
}

static void colmap_read_image(struct colmap_reader *r)
{
    static const char *const what[7] = {"QW", "QX", "QY", "QZ", "TX", "TY", "TZ"};
    struct colmap_image image = {.id = colmap_id(r, "IMAGE_ID", 4), .line = r->line};
    for (int i = 0; i < 7; i++)
        *(i < 4 ? &image.rotation[i] : &image.translation[i - 4]) = colmap_finite(r, what[i]);
    colmap_check_rotation(r, image.rotation);
    image.camera_id = colmap_id(r, "CAMERA_ID", 4);
    colmap_check_camera(r, image.camera_id);
    colmap_begin_name(r);
    colmap_read_name(r, &image.name);
    colmap_skip_observations(r);
    COLMAP_ADD(r, image, image);
}

/* ---------------- points */

/* Reads the track of a point, as the last rows of all. */
static void colmap_read_track(struct colmap_reader *r, struct colmap_point *point)
{
    struct colmap *out = r->out;
    const int binary = out->format == COLMAP_BINARY;
    uint64_t left = binary ? colmap_count(r, "the length of a track", 8) : UINT64_MAX;
    for (; left > 0 && r->rc == OXL_OK; left--) {
        const struct colmap_image *image;
        int64_t id, observation;
        if (!binary && !colmap_has_more(r)) return;
        id = colmap_id(r, "IMAGE_ID of a track (IMAGE_ID POINT2D_IDX)", 4);
        observation = colmap_whole(r, "POINT2D_IDX of a track (IMAGE_ID POINT2D_IDX)", 4, 0, UINT32_MAX);
        image = colmap_find(out->image, out->image_count, sizeof *image, id);
        if (!image) colmap_warn(r, WARN_TRACK);
        if (r->rc == OXL_OK)
            r->rc = oxl_reserve(r->ctx, &out->track, &r->track_capacity,
                                out->track_count + point->track_count + 1, sizeof *out->track);
        if (image && r->rc == OXL_OK)
            out->track[out->track_count + point->track_count++] =
                (struct colmap_track){(uint32_t)(image - out->image), (uint32_t)observation};
    }
}

/* Reads a point, and leaves it out if its position is not finite. */
static void colmap_read_point(struct colmap_reader *r)
{
    static const char *const axis[3] = {"X", "Y", "Z"}, *const channel[3] = {"R", "G", "B"};
    struct colmap *out = r->out;
    struct colmap_point point = {.id = colmap_id(r, "POINT3D_ID", 8), .first_track = out->track_count};
    for (int i = 0; i < 3; i++) point.position[i] = colmap_real(r, axis[i]);
    for (int i = 0; i < 3; i++) point.rgb[i] = (uint8_t)colmap_whole(r, channel[i], 1, 0, 255);
    point.error = colmap_real(r, "ERROR");
    if (!(fabs(point.position[0]) + fabs(point.position[1]) + fabs(point.position[2]) <= DBL_MAX)) {
        colmap_warn(r, WARN_POSITION);
        if (out->format == COLMAP_BINARY) colmap_skip(r, 8 * colmap_count(r, "the length of a track", 8));
        return;
    }
    if (!(fabs(point.error) <= DBL_MAX)) {
        colmap_warn(r, WARN_ERROR);
        point.error = -1;
    }
    colmap_read_track(r, &point);
    COLMAP_ADD(r, point, point);
    if (r->rc == OXL_OK) out->track_count += point.track_count;
}

/* ---------------- the three files */

enum { COLMAP_FILES = 3, COLMAP_POSES = 2 /* files that hold the poses; the points may be elsewhere */ };
static const struct colmap_file {
    const char *name[2]; /* by format */
    const char *rows, *row, *fix;
    void (*read)(struct colmap_reader *r);
} colmap_files[COLMAP_FILES] = {
    {{"cameras.txt", "cameras.bin"}, "cameras", "a camera", COLMAP_FIX_EXPORT, colmap_read_camera},
    {{"images.txt", "images.bin"},
     "images",
     "an image",
     "take a model with registered images (sparse/0, sparse/1, ...), or " COLMAP_FIX_EXPORT,
     colmap_read_image},
    {{"points3D.txt", "points3D.bin"}, "points", NULL, NULL, colmap_read_point},
};

/* Reads a file's rows and sorts them by id. */
static void colmap_read_file(struct colmap_reader *r, const char *path, int i)
{
    const struct colmap_file *file = &colmap_files[i];
    struct colmap *out = r->out;
    const void *twice;
    int64_t id;
    colmap_open(r, "", path);
    while (colmap_next_record(r)) file->read(r);
    if (r->rows == 0 && file->row)
        colmap_fail(r, file->fix, "found the end of the file, expected %s", file->row);
    colmap_close(r, file->rows);
    if (r->rc != OXL_OK) return;
    twice = i == 0   ? colmap_sort(out->camera, out->camera_count, sizeof *out->camera)
            : i == 1 ? colmap_sort(out->image, out->image_count, sizeof *out->image)
                     : colmap_sort(out->point, out->point_count, sizeof *out->point);
    if (!twice) return;
    memcpy(&id, twice, sizeof id);
    r->rc = oxl_fail(r->ctx, OXL_ERR_INPUT,
                     "%s: the id %" PRId64 " appears twice, expected each id once\nfix: " COLMAP_FIX_EXPORT,
                     r->path, id);
}

static void colmap_read_points_file(struct colmap_reader *r, const char *path)
{
    struct colmap *out = r->out;
    const enum colmap_format format = out->format;
    out->point_count = out->track_count = 0;
    out->format = strstr(path_base_name(path), ".bin") ? COLMAP_BINARY : COLMAP_TEXT;
    if (strstr(path_base_name(path), ".ply")) ply_points_read(r, path);
    else colmap_read_file(r, path, COLMAP_POSES);
    out->format = format;
}

OXL_INTERNAL oxl_result colmap_read_points(oxl_context *ctx, const char *path, struct colmap *out)
{
    struct colmap_reader r = {.ctx = ctx, .out = out, .buffer_size = COLMAP_BUFFER};
    colmap_read_points_file(&r, path);
    oxl_free(ctx, r.buffer);
    return r.rc;
}

/* Takes the points of points3D.ply where there are no others, which simulators and motion capture export, or
 * where the others are fewer and in no track: some programs leave a dummy point there. Names a PLY of more
 * points that is not read: other programs read it first. */
static oxl_result colmap_read_other_points(oxl_context *ctx, struct colmap *out)
{
    const size_t own = out->point_count;
    const int keeps = out->track_count && own >= COLMAP_DUMMY;
    struct colmap other = {0};
    const char *ply = PATH(out->folder, "points3D.ply"), *lower = PATH(out->folder, "points3d.ply");
    oxl_result rc = OXL_OK;
    if (!os_is_file(ply)) ply = lower;
    if (os_is_file(ply)) rc = colmap_read_points(ctx, ply, &other);
    else if (!own)
        oxl_log(ctx, OXL_LOG_WARNING,
                "%s: points3D.txt or .bin is not there or empty, so training starts from depth maps of the "
                "images\nfix: compute points for these poses: colmap point_triangulator",
                out->folder);
    if (rc == OXL_OK && other.point_count > 2 * own) {
        oxl_log(ctx, own ? OXL_LOG_WARNING : OXL_LOG_INFO,
                "%s: the %zu points of %s are %s; points3D.txt or .bin there holds %zu\n"
                "fix: --sparse FILE names the points",
                out->folder, other.point_count, path_base_name(ply), keeps ? "not read" : "read", own);
        if (!keeps) {
            OXL_SWAP(struct colmap_point *, out->point, other.point);
            out->point_count = other.point_count, out->track_count = 0;
        }
    }
    colmap_free(ctx, &other);
    return rc;
}

/* Reads the poses of one format, and the points of the other where this one has none. */
static oxl_result colmap_read_as(oxl_context *ctx, const char *folder, int format, size_t buffer,
                                 const struct survey_given *given, struct colmap *out)
{
    struct colmap_reader r = {.ctx = ctx, .out = out, .buffer_size = buffer};
    const char *own = PATH(folder, "%s", colmap_files[2].name[format]),
               *other = PATH(folder, "%s", colmap_files[2].name[!format]),
               *points = given->points     ? given->points
                         : os_is_file(own) ? own
                                           : other;
    *out = (struct colmap){.format = (enum colmap_format)format, .images_file = colmap_files[1].name[format]};
    if ((out->folder = oxl_strdup(ctx, folder)) == NULL) r.rc = OXL_ERR_MEMORY;
    for (int i = 0; i < COLMAP_POSES && r.rc == OXL_OK; i++)
        colmap_read_file(&r, PATH(folder, "%s", colmap_files[i].name[format]), i);
    if (r.rc == OXL_OK && os_is_file(points)) colmap_read_points_file(&r, points);
    oxl_free(ctx, r.buffer);
    if (r.rc != OXL_OK) colmap_free(ctx, out);
    return r.rc;
}

OXL_INTERNAL int colmap_has_places(const struct colmap *a, const struct scene_order *order,
                                   const struct colmap *b)
{
    double off = 0, all = 0;
    if (a->image_count != b->image_count) return 0;
    for (size_t i = 0; i < a->image_count; i++)
        for (int k = 0; k < 3; k++) {
            const double x = a->image[order ? order[i].image : i].translation[k];
            off += fabs(x - b->image[i].translation[k]), all += fabs(x);
        }
    return off <= COLMAP_SAME * all;
}

/* Returns 1 if the first cameras of two models, and the first turns, are the same. */
static int colmap_has_cameras(const struct colmap *a, const struct colmap *b)
{
    const struct colmap_camera *c = a->camera, *d = b->camera;
    double off = 0, all = 0;
    if (a->camera_count != b->camera_count) return 0;
    if (a->image_count == 0) return 1;
    if (c->model != d->model || c->width != d->width) return 0;
    for (int k = 0; k < c->parameter_count; k++)
        off += fabs(c->parameter[k] - d->parameter[k]), all += fabs(c->parameter[k]);
    for (int k = 0; k < 4; k++) off += fabs(fabs(a->image->rotation[k]) - fabs(b->image->rotation[k]));
    return off <= COLMAP_SAME * all;
}

/* Returns how many of the images are in the folder. */
static size_t colmap_count_files(const struct colmap *c, const char *images)
{
    size_t count = 0;
    for (size_t i = 0; images && i < c->image_count; i++)
        count += os_is_file(PATH(images, "%s", c->names + c->image[i].name));
    return count;
}

/* Returns 1 if the images fit a better than b: more of its images are there, or else it names more images,
 * or, where some are there, fewer that are not, or else it has more points. */
static int colmap_fits_better(const struct colmap *a, const struct colmap *b, const char *images)
{
    const size_t x = colmap_count_files(a, images), y = colmap_count_files(b, images);
    if (x != y) return x > y;
    if (a->image_count != b->image_count) return (a->image_count > b->image_count) == (x == 0);
    return a->point_count > b->point_count;
}

/* Reads both formats, and keeps the one that the images fit better, or else the binary one, which COLMAP and
 * 3DGS read first. Times tell nothing: a checkout of git makes them. */
static oxl_result colmap_read_both(oxl_context *ctx, const char *folder, size_t buffer,
                                   const struct survey_given *given, struct colmap *out)
{
    struct colmap text;
    const oxl_result read = colmap_read_as(ctx, folder, COLMAP_TEXT, buffer, given, &text);
    oxl_result rc = read == OXL_OK || read == OXL_ERR_INPUT
                        ? colmap_read_as(ctx, folder, COLMAP_BINARY, buffer, given, out)
                        : read;
    const int is_text = read == OXL_OK &&
                        (rc == OXL_OK ? colmap_fits_better(&text, out, given->folder) : rc == OXL_ERR_INPUT);
    if (is_text || text.point_count != out->point_count || !colmap_has_places(&text, NULL, out) ||
        !colmap_has_cameras(&text, out))
        oxl_log(
            ctx, OXL_LOG_WARNING,
            "%s holds two models that differ: text with %zu images and %zu points, binary with %zu and %zu; the "
            "%s one is read\nfix: remove the files of the other, or move one to a folder of its own",
            folder, text.image_count, text.point_count, out->image_count, out->point_count,
            is_text ? "text" : "binary");
    if (is_text) {
        OXL_SWAP(struct colmap, text, *out);
        rc = OXL_OK;
    }
    colmap_free(ctx, &text);
    return rc;
}

/* Reads the format that is there, or the better one. */
static oxl_result colmap_read_any(oxl_context *ctx, const char *folder, size_t buffer,
                                  const struct survey_given *given, struct colmap *out)
{
    int has[2] = {0}, format; /* has: files of poses that are there, and half for a compressed one */
    for (int f = 0; f < 2; f++)
        for (int i = 0; i < COLMAP_POSES; i++) {
            const char *path = PATH(folder, "%s", colmap_files[i].name[f]);
            has[f] += 2 * os_is_file(path) + os_is_compressed(path);
        }
    if (has[0] == 2 * COLMAP_POSES && has[0] == has[1])
        return colmap_read_both(ctx, folder, buffer, given, out);
    format = has[1] > has[0];
    for (int i = 0; i < COLMAP_FILES; i++) {
        const char *name = colmap_files[i].name[format], *path = PATH(folder, "%s", name);
        if (os_is_compressed(path))
            return oxl_fail(ctx, OXL_ERR_INPUT, "%s: it is compressed\nfix: gunzip %s.gz", path,
                            SHELL_WORD(path));
        if (i < COLMAP_POSES && !os_is_file(path))
            return oxl_fail(
                ctx, OXL_ERR_INPUT,
                "%s: %s is not there, expected a COLMAP model: cameras, images and points3D, all "
                ".txt or all .bin\nfix: name the folder that holds all three, or export them with "
                "colmap model_converter --output_type TXT",
                folder, name);
    }
    return colmap_read_as(ctx, folder, format, buffer, given, out);
}

OXL_INTERNAL oxl_result colmap_read(oxl_context *ctx, const char *folder, size_t buffer,
                                    const struct survey_given *given, struct colmap *out)
{
    static const struct survey_given nothing;
    oxl_result rc;
    *out = (struct colmap){0};
    rc = colmap_read_any(ctx, folder, buffer, given ? given : &nothing, out);
    if (rc == OXL_OK && !(given && given->points)) rc = colmap_read_other_points(ctx, out);
    if (rc != OXL_OK) colmap_free(ctx, out);
    return rc;
}
