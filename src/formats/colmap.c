/* colmap.c - reads the text files of a COLMAP model (cameras.txt, images.txt, points3D.txt), and chooses
 * between text and binary files where a folder holds both.
 *
 * Source: "Output Format" in COLMAP's documentation, and variants of other programs: CR LF, tabs, a missing
 * line of 2D points, decimal commas, -nan(ind). Recoverable deviations are read with a warning; others are an
 * error that names file:line, the value found, the value expected, and a fix.
 *
 * Invariants of colmap_read's result: ids are unique; each image's camera and each track's image exist; all
 * numbers are finite (an unknown reprojection error is -1, as in COLMAP); no image name points outside the
 * image folder.
 * Not guaranteed: that points named by observations, and observations named by tracks, exist.
 */
#include "colmap.h"
#include "json_survey.h"

/* ---------------- cameras.txt: CAMERA_ID MODEL WIDTH HEIGHT PARAMS[] */

static oxl_result colmap_read_model(struct colmap_reader *r, struct colmap_camera *c)
{
    char buffer[64];
    const char *token;
    colmap_skip_blanks(r);
    token = r->cursor;
    while (!colmap_at_field_end(r)) r->cursor++;
    c->model = camera_model_find(token, (size_t)(r->cursor - token));
    if (c->model < 0)
        return oxl_fail(
            r->ctx, OXL_ERR_INPUT,
            "%s:%d: found %s for the camera model, expected one of %s\n"
            "fix: let COLMAP undistort: colmap image_undistorter --image_path IMAGES --input_path MODEL --output_path OUT",
            r->path, r->line, colmap_printable(token, r->end, buffer), camera_model_list());
    c->parameter_count = camera_model_at(c->model)->parameter_count;
    return OXL_OK;
}

static oxl_result colmap_read_camera(struct colmap_reader *r, struct colmap_camera *c)
{
    int64_t width = 0, height = 0;
    oxl_result rc = colmap_id(r, "CAMERA_ID", &c->id);
    if (rc == OXL_OK) rc = colmap_read_model(r, c);
    if (rc == OXL_OK) rc = colmap_whole(r, "WIDTH", 1, INT_MAX, &width);
    if (rc == OXL_OK) rc = colmap_whole(r, "HEIGHT", 1, INT_MAX, &height);
    for (int i = 0; i < c->parameter_count && rc == OXL_OK; i++) {
        const char *token;
        colmap_skip_blanks(r);
        token = r->cursor;
        rc = colmap_finite(r, "PARAMS", &c->parameter[i]);
        if (rc == OXL_OK && i < camera_model_at(c->model)->focal_count && !(c->parameter[i] > 0))
            rc = colmap_fail_token(r, token, "a focal length", "more than 0 px");
    }
    colmap_skip_blanks(r);
    if (rc == OXL_OK && r->cursor != r->end)
        rc = colmap_fail_token(r, r->cursor, "the end of the line", "after the model's parameters");
    c->width = (int)width;
    c->height = (int)height;
    c->file = "cameras.txt";
    c->line = r->line;
    return rc;
}

static oxl_result colmap_read_cameras(struct colmap_reader *r)
{
    struct colmap *out = r->out;
    oxl_result rc = OXL_OK;
    while (rc == OXL_OK && colmap_next_record(r)) {
        struct colmap_camera camera = {0};
        rc = colmap_read_camera(r, &camera);
        if (rc == OXL_OK) rc = colmap_add_camera(r, &camera);
    }
    if (rc == OXL_OK) rc = r->rc;
    if (rc == OXL_OK && out->camera_count == 0)
        rc = oxl_fail(r->ctx, OXL_ERR_INPUT,
                      "%s:%d: found the end of the file, expected a camera\nfix: " COLMAP_FIX_EXPORT, r->path,
                      r->line);
    return rc;
}

/* ---------------- images.txt: two lines an image
 *
 *     IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME       the name is the rest of the line
 *     (X Y POINT3D_ID)*                                  may be empty; some programs leave it out
 */

static oxl_result colmap_read_pose(struct colmap_reader *r, struct colmap_image *image)
{
    static const char *const what[7] = {"QW", "QX", "QY", "QZ", "TX", "TY", "TZ"};
    oxl_result rc = colmap_id(r, "IMAGE_ID", &image->id);
    for (int i = 0; i < 7 && rc == OXL_OK; i++)
        rc = colmap_finite(r, what[i], i < 4 ? &image->rotation[i] : &image->translation[i - 4]);
    if (rc == OXL_OK) rc = colmap_check_rotation(r, image->rotation);
    if (rc == OXL_OK) rc = colmap_id(r, "CAMERA_ID", &image->camera_id);
    if (rc == OXL_OK) rc = colmap_check_camera(r, image->camera_id);
    if (rc == OXL_OK) rc = colmap_read_name(r, &image->name);
    image->line = r->line;
    return rc;
}

static int colmap_peek_real(const char **p, const char *end, double *out)
{
    while (*p < end && colmap_is_blank(**p)) ++*p;
    return parse_double(p, end, out) && (*p == end || colmap_is_blank(**p));
}

static int colmap_peek_whole(const char **p, const char *end, int64_t *out)
{
    while (*p < end && colmap_is_blank(**p)) ++*p;
    return parse_int64(p, end, out) && (*p == end || colmap_is_blank(**p));
}

static size_t colmap_count_fields(const char *p, const char *end)
{
    size_t count = 0;
    for (int blank = 1; p < end; p++) {
        count += blank && !colmap_is_blank(*p);
        blank = colmap_is_blank(*p);
    }
    return count;
}

/* Returns 1 if the line at the position of 2D points is the first line of an image: an integer, 7 numbers,
 * an integer, and a name. Most names are not numbers, which decides. With a numeric name, it is an image if
 * the number of fields is not a multiple of 3, the rotation is plausible and the camera exists. */
static int colmap_is_pose(const struct colmap_reader *r)
{
    const char *p = r->cursor;
    int64_t image, camera;
    double v[7], name, square;
    /* Returns here for nearly all lines of 2D points, whose first number is no integer. */
    if (!colmap_peek_whole(&p, r->end, &image)) return 0;
    for (int i = 0; i < 7; i++)
        if (!colmap_peek_real(&p, r->end, &v[i])) return 0;
    if (!colmap_peek_whole(&p, r->end, &camera) || p == r->end) return 0;
    if (!colmap_peek_real(&p, r->end, &name)) return 1;
    square = v[0] * v[0] + v[1] * v[1] + v[2] * v[2] + v[3] * v[3];
    return fabs(square - 1) < COLMAP_UNIT_ERROR && colmap_has_camera(r, camera) &&
           colmap_count_fields(r->cursor, r->end) % 3 != 0;
}

/* Reads the second line of an image. If it is missing, the reader does not advance. */
static oxl_result colmap_read_second_line(struct colmap_reader *r, struct colmap_image *image)
{
    if (!colmap_next_line(r)) return r->rc;
    if (r->cursor < r->end && (*r->cursor == '#' || colmap_is_pose(r))) {
        colmap_warn(r, WARN_NO_POINTS_LINE);
        r->next = r->cursor;
        r->line--;
        return OXL_OK;
    }
    image->points_at = r->offset + (uint64_t)(r->cursor - r->buffer);
    image->points_size = (size_t)(r->end - r->cursor);
    return OXL_OK;
}

static oxl_result colmap_read_images(struct colmap_reader *r)
{
    struct colmap *out = r->out;
    oxl_result rc = OXL_OK;
    while (rc == OXL_OK && colmap_next_record(r)) {
        struct colmap_image image = {0};
        rc = colmap_read_pose(r, &image);
        if (rc == OXL_OK) rc = colmap_add_image(r, &image);
        if (rc == OXL_OK) rc = colmap_read_second_line(r, &out->image[out->image_count - 1]);
    }
    if (rc == OXL_OK) rc = r->rc;
    if (rc == OXL_OK && out->image_count == 0)
        rc = oxl_fail(
            r->ctx, OXL_ERR_INPUT,
            "%s:%d: found the end of the file, expected an image\nfix: take a model with registered images (sparse/0, "
            "sparse/1, ...), or " COLMAP_FIX_EXPORT,
            r->path, r->line);
    return rc;
}

/* ---------------- the three together */

enum { COLMAP_FILES = 3 };
static const char *const colmap_names[2][COLMAP_FILES] = {{"cameras.txt", "images.txt", "points3D.txt"},
                                                          {"cameras.bin", "images.bin", "points3D.bin"}};

struct colmap_files { /* Counts the three files of one format that are there. */
    int count;
    const char *missing; /* the first missing file */
    int has_poses;       /* files that poses need, cameras and images: 0 to 2 */
    int64_t modified;    /* time of the newest file */
};

static struct colmap_files colmap_find_files(const char *folder, enum colmap_format format)
{
    struct colmap_files found = {.count = 0};
    for (int i = 0; i < COLMAP_FILES; i++) {
        const char *path = PATH(folder, "%s", colmap_names[format][i]);
        if (os_is_file(path)) {
            found.count++;
            found.has_poses += i < COLMAP_FILES - 1;
            found.modified = OXL_MAX(found.modified, os_modified(path));
        } else if (!found.missing) {
            found.missing = colmap_names[format][i];
        }
    }
    return found;
}

/* Chooses between text and binary files: the newer ones; text if both have the same age, since it may have
 * been edited. */
static oxl_result colmap_choose(oxl_context *ctx, const char *folder, enum colmap_format *out)
{
    const struct colmap_files text = colmap_find_files(folder, COLMAP_TEXT),
                              binary = colmap_find_files(folder, COLMAP_BINARY);
    *out = binary.count == COLMAP_FILES && (text.count < COLMAP_FILES || binary.modified > text.modified)
               ? COLMAP_BINARY
               : COLMAP_TEXT;
    if (text.count == COLMAP_FILES && binary.count == COLMAP_FILES)
        oxl_log(ctx, OXL_LOG_INFO,
                "%s holds the model as text and as binary files; the %s files are %s and are read", folder,
                *out == COLMAP_TEXT ? "text" : "binary",
                text.modified == binary.modified ? "as new" : "newer");
    if (text.count == COLMAP_FILES || binary.count == COLMAP_FILES) return OXL_OK;
    for (int i = 0; i < 2 * COLMAP_FILES; i++) {
        const char *path = PATH(folder, "%s", colmap_names[i / COLMAP_FILES][i % COLMAP_FILES]);
        if (os_is_compressed(path))
            return oxl_fail(ctx, OXL_ERR_INPUT, "%s: it is compressed\nfix: gunzip %s.gz", path,
                            SHELL_WORD(path));
    }
    if (text.has_poses == COLMAP_FILES - 1 || binary.has_poses == COLMAP_FILES - 1) {
        *out = text.has_poses == COLMAP_FILES - 1 ? COLMAP_TEXT : COLMAP_BINARY;
        return OXL_OK;
    }
    return oxl_fail(
        ctx, OXL_ERR_INPUT,
        "%s: %s is not there, expected a COLMAP model: cameras, images and points3D, all .txt or all .bin\n"
        "fix: name the folder that holds all three, or export them with colmap model_converter --output_type TXT",
        folder, binary.count > text.count ? binary.missing : text.missing);
}

/* Reads the points of points3D.ply, if it is there: simulators and motion capture export poses without
 * points3D. */
static oxl_result colmap_read_other_points(struct colmap_reader *r, const char *folder)
{
    const char *ply = PATH(folder, "points3D.ply");
    if (os_is_file(ply)) {
        oxl_log(r->ctx, OXL_LOG_INFO,
                "%s: there is no points3D.txt or .bin; the points of points3D.ply are read", folder);
        return ply_points_read(r, ply);
    }
    oxl_log(r->ctx, OXL_LOG_WARNING,
            "%s: there is no points3D.txt or .bin, so training starts from random points\n"
            "fix: compute points for these poses: colmap point_triangulator",
            folder);
    return OXL_OK;
}

OXL_INTERNAL int colmap_has_points(const char *folder, enum colmap_format format)
{
    return os_is_file(PATH(folder, "%s", colmap_names[format == COLMAP_BINARY][COLMAP_FILES - 1]));
}

static oxl_result colmap_read_text(struct colmap_reader *r, const char *folder)
{
    struct colmap *out = r->out;
    oxl_result rc = colmap_open(r, folder, "cameras.txt");
    if (rc == OXL_OK) rc = colmap_read_cameras(r);
    if (rc == OXL_OK) colmap_compare(r, "cameras", out->camera_count);
    colmap_close(r);
    if (rc == OXL_OK) rc = colmap_open(r, folder, "images.txt");
    if (rc == OXL_OK) rc = colmap_read_images(r);
    if (rc == OXL_OK) colmap_compare(r, "images", out->image_count);
    colmap_close(r);
    if (rc == OXL_OK && !colmap_has_points(folder, COLMAP_TEXT)) return colmap_read_other_points(r, folder);
    if (rc == OXL_OK) rc = colmap_open(r, folder, "points3D.txt");
    if (rc == OXL_OK) rc = colmap_read_points(r);
    if (rc == OXL_OK) colmap_compare(r, "points", out->point_count + (size_t)r->warned[WARN_POSITION]);
    colmap_close(r);
    return rc;
}

OXL_INTERNAL oxl_result colmap_read_buffered(oxl_context *ctx, const char *folder, size_t buffer,
                                             struct colmap *out)
{
    struct colmap_reader r = {.ctx = ctx, .out = out, .buffer_size = buffer};
    enum colmap_format format = COLMAP_TEXT;
    oxl_result rc;
    *out = (struct colmap){0};
    rc = colmap_choose(ctx, folder, &format);
    if (rc == OXL_OK && (out->folder = oxl_strdup(ctx, folder)) == NULL) rc = OXL_ERR_MEMORY;
    out->format = format;
    out->images_file = colmap_names[format][1];
    if (rc == OXL_OK)
        rc = format == COLMAP_TEXT ? colmap_read_text(&r, folder) : colmap_read_binary(&r, folder);
    if (rc == OXL_OK && format == COLMAP_BINARY && !colmap_has_points(folder, format))
        rc = colmap_read_other_points(&r, folder);
    OXL_FREE(ctx, r.buffer, r.cameras.slot, r.images.slot);
    if (rc != OXL_OK) colmap_free(ctx, out);
    return rc;
}

OXL_INTERNAL oxl_result colmap_read(oxl_context *ctx, const char *folder, struct colmap *out)
{
    return colmap_read_buffered(ctx, folder, COLMAP_BUFFER, out);
}
