/* colmap_binary.c - the three binary files of a COLMAP model (cameras.bin, images.bin, points3D.bin), COLMAP
 * 3.x to 4.1.
 *
 * Source: the readers of colmap/colmap, src/colmap/scene/reconstruction_io_binary.cc. Little endian, nothing
 * aligned:
 *
 *     cameras.bin    u64 count, then  u32 id  i32 model  u64 width  u64 height  f64 params[of the model]
 *     images.bin     u64 count, then  u32 id  f64 qw qx qy qz tx ty tz  u32 camera  name 0  u64 n, then n x
 *     (f64 x y, u64 point)
 *     points3D.bin   u64 count, then  u64 id  f64 x y z  u8 r g b  f64 error  u64 n, then n x (u32 image, u32
 *     observation)
 *
 * rigs.bin and frames.bin of COLMAP 3.12 and later are not read: images.bin has each image's own pose.
 *
 * Invariant: the result equals that of the text export of the same model, except for the order of rows
 * (colmap_order); messages name the record instead of the line. A count is compared with the size of the file
 * before memory is allocated for it.
 */
#include "colmap.h"
#include "../core/bytes.h"
#include "survey_read.h"

enum {
    BINARY_CAMERA_MIN = 24 + 2 * 8,         /* bytes of a camera of the fewest parameters */
    BINARY_POSE = 4 + 7 * 8 + 4,            /* bytes of an image before its name */
    BINARY_IMAGE_MIN = BINARY_POSE + 2 + 8, /* bytes of an image with a name of one letter and no 2D points */
    BINARY_OBSERVATION = 24,
    BINARY_POINT = 51, /* bytes of a point with the length of its track */
    BINARY_TRACK = 8,
    BINARY_NAME_LONGEST = 4096
};

#define BINARY_FIX "copy the file again, or write the model again: colmap model_converter --output_type BIN"

/* ---------------- bytes */

/* Returns the offset in the file of the first unread byte. */
static uint64_t binary_offset(const struct colmap_reader *r)
{
    return r->offset + (uint64_t)(r->next - r->buffer);
}

static uint64_t binary_left(const struct colmap_reader *r)
{
    return r->file.size > binary_offset(r) ? r->file.size - binary_offset(r) : 0;
}

static oxl_result binary_fail(struct colmap_reader *r, uint64_t at, const char *what, const char *format, ...)
    OXL_PRINTF(4, 5);
static oxl_result binary_fail(struct colmap_reader *r, uint64_t at, const char *what, const char *format, ...)
{
    char seen[200];
    va_list args;
    va_start(args, format);
    vsnprintf(seen, sizeof seen, format, args);
    va_end(args);
    return oxl_fail(r->ctx, OXL_ERR_INPUT,
                    "%s: byte %" PRIu64 ", record %d: found %s, expected %s\nfix: " BINARY_FIX, r->path, at,
                    r->line, seen, what);
}

/* Returns the next `size` bytes, valid until the next call. */
static oxl_result binary_take(struct colmap_reader *r, size_t size, const char *what, const char **out)
{
    while ((size_t)(r->limit - r->next) < size && !r->at_end)
        if (colmap_fill(r) != OXL_OK) return r->rc;
    if ((size_t)(r->limit - r->next) < size)
        return binary_fail(r, binary_offset(r) + (uint64_t)(r->limit - r->next), what, "the end of the file");
    *out = r->next;
    r->next += size;
    return OXL_OK;
}

static oxl_result binary_skip(struct colmap_reader *r, uint64_t size)
{
    const uint64_t to = binary_offset(r) + size;
    if (size <= (uint64_t)(r->limit - r->next)) {
        r->next += size;
        return OXL_OK;
    }
    r->rc = os_reader_seek(r->ctx, &r->file, to);
    r->offset = to;
    r->next = r->limit = r->buffer;
    return r->rc == OXL_OK ? colmap_fill(r) : r->rc;
}

/* Reads a count of rows that follow, each of `least` bytes or more. */
static oxl_result binary_count(struct colmap_reader *r, const char *what, size_t least, uint64_t *out)
{
    const char *p = NULL;
    const uint64_t at = binary_offset(r);
    const oxl_result rc = binary_take(r, 8, what, &p);
    if (rc != OXL_OK) return rc;
    *out = bytes_get(p, 8);
    if (*out <= binary_left(r) / least) return OXL_OK;
    return binary_fail(r, at, what, "the number %" PRIu64 " where %" PRIu64 " bytes follow", *out,
                       binary_left(r));
}

static oxl_result binary_finite(struct colmap_reader *r, const char *p, const char *what, double *out)
{
    *out = bytes_double(p);
    return fabs(*out) <= DBL_MAX ? OXL_OK : binary_fail(r, binary_offset(r), what, "%g", *out);
}

/* Warns of bytes after the last record, which are not read. */
static void binary_end(struct colmap_reader *r)
{
    if (binary_left(r) == 0) return;
    oxl_log(r->ctx, OXL_LOG_WARNING, "%s: %" PRIu64 " bytes follow its last record; they are not read",
            r->path, binary_left(r));
    r->out->warnings++;
}

/* ---------------- cameras.bin */

static oxl_result binary_parameters(struct colmap_reader *r, struct colmap_camera *c)
{
    const char *p = NULL;
    oxl_result rc = binary_take(r, 8 * (size_t)c->parameter_count, "the camera's parameters", &p);
    for (int i = 0; i < c->parameter_count && rc == OXL_OK; i++) {
        rc = binary_finite(r, p + 8 * i, "a finite parameter", &c->parameter[i]);
        if (rc == OXL_OK && i < camera_model_at(c->model)->focal_count && !(c->parameter[i] > 0))
            rc = binary_fail(r, binary_offset(r), "a focal length of more than 0 px", "%g", c->parameter[i]);
    }
    return rc;
}

static oxl_result binary_camera(struct colmap_reader *r, struct colmap_camera *c)
{
    const char *p = NULL;
    const uint64_t at = binary_offset(r);
    uint64_t width, height;
    oxl_result rc = binary_take(r, 24, "a camera", &p);
    if (rc != OXL_OK) return rc;
    c->id = bytes_u32(p);
    c->model = (int)OXL_MIN(bytes_u32(p + 4), (uint32_t)INT_MAX);
    width = bytes_get(p + 8, 8);
    height = bytes_get(p + 16, 8);
    c->file = "cameras.bin";
    c->line = r->line;
    if (c->model >= camera_model_count())
        return oxl_fail(
            r->ctx, OXL_ERR_INPUT,
            "%s: byte %" PRIu64 ", record %d: found the camera model %d, expected 0 to %d (%s)\n"
            "fix: let COLMAP undistort: colmap image_undistorter --image_path IMAGES --input_path MODEL --output_path OUT",
            r->path, at + 4, r->line, c->model, camera_model_count() - 1, camera_model_list());
    if (width < 1 || height < 1 || width > INT_MAX || height > INT_MAX)
        return binary_fail(r, at + 8, "a width and a height of 1 to 2147483647 px", "%" PRIu64 " x %" PRIu64,
                           width, height);
    c->width = (int)width;
    c->height = (int)height;
    c->parameter_count = camera_model_at(c->model)->parameter_count;
    return binary_parameters(r, c);
}

static oxl_result binary_cameras(struct colmap_reader *r)
{
    struct colmap *out = r->out;
    uint64_t count = 0;
    oxl_result rc = binary_count(r, "the number of cameras", BINARY_CAMERA_MIN, &count);
    if (rc == OXL_OK && count == 0) rc = binary_fail(r, 0, "a camera", "none");
    while (rc == OXL_OK && out->camera_count < count) {
        struct colmap_camera camera = {0};
        r->line++;
        rc = binary_camera(r, &camera);
        if (rc == OXL_OK) rc = colmap_add_camera(r, &camera);
    }
    if (rc == OXL_OK) binary_end(r);
    return rc;
}

/* ---------------- images.bin */

/* Reads a name by colmap_read_name, without blanks at the ends, as in text; a newline in it is an error. */
static oxl_result binary_name(struct colmap_reader *r, size_t *name)
{
    const char *zero, *p = NULL;
    size_t size;
    oxl_result rc;
    while ((zero = memchr(r->next, 0, (size_t)(r->limit - r->next))) == NULL && !r->at_end &&
           r->limit - r->next <= BINARY_NAME_LONGEST)
        if (colmap_fill(r) != OXL_OK) return r->rc;
    if (!zero || zero - r->next > BINARY_NAME_LONGEST)
        return binary_fail(r, binary_offset(r), "a name that ends in a zero byte", "%zu bytes without one",
                           (size_t)OXL_MIN(r->limit - r->next, (ptrdiff_t)BINARY_NAME_LONGEST));
    size = (size_t)(zero - r->next);
    if (memchr(r->next, '\n', size) || memchr(r->next, '\r', size))
        return binary_fail(r, binary_offset(r), "a name of one line", "a line end in a name");
    rc = binary_take(r, size + 1, "a name", &p);
    if (rc != OXL_OK) return rc;
    r->cursor = p;
    r->end = p + size;
    while (r->end > r->cursor && colmap_is_blank(r->end[-1])) r->end--;
    return colmap_read_name(r, name);
}

static oxl_result binary_pose(struct colmap_reader *r, struct colmap_image *image)
{
    const char *p = NULL;
    oxl_result rc = binary_take(r, BINARY_POSE, "an image", &p);
    if (rc != OXL_OK) return rc;
    image->id = bytes_u32(p);
    image->camera_id = bytes_u32(p + 60);
    image->line = r->line;
    for (int i = 0; i < 7 && rc == OXL_OK; i++)
        rc = binary_finite(r, p + 4 + 8 * i, "a finite pose",
                           i < 4 ? &image->rotation[i] : &image->translation[i - 4]);
    if (rc == OXL_OK) rc = colmap_check_rotation(r, image->rotation);
    if (rc == OXL_OK) rc = colmap_check_camera(r, image->camera_id);
    if (rc == OXL_OK) rc = binary_name(r, &image->name);
    return rc;
}

/* Reads a point's id. COLMAP's mark of no point, 2^64 - 1, becomes -1; other ids from 2^63 on are an error,
 * since they do not fit int64_t. */
static oxl_result binary_point_id(struct colmap_reader *r, const char *p, int64_t *out)
{
    const uint64_t id = bytes_get(p, 8);
    *out = id == UINT64_MAX ? -1 : (int64_t)(id & INT64_MAX);
    return id == UINT64_MAX || id <= INT64_MAX
               ? OXL_OK
               : binary_fail(r, binary_offset(r), "a point id below 2^63", "%" PRIu64, id);
}

/* Skips an image's 2D points and keeps only their place in the file, from which exports copy them. */
static oxl_result binary_skip_observations(struct colmap_reader *r, struct colmap_image *image)
{
    uint64_t count = 0;
    const oxl_result rc = binary_count(r, "the number of 2D points", BINARY_OBSERVATION, &count);
    image->points_at = binary_offset(r);
    image->points_size = (size_t)count * BINARY_OBSERVATION;
    return rc == OXL_OK ? binary_skip(r, image->points_size) : rc;
}

static oxl_result binary_images(struct colmap_reader *r)
{
    struct colmap *out = r->out;
    uint64_t count = 0;
    oxl_result rc = binary_count(r, "the number of images", BINARY_IMAGE_MIN, &count);
    if (rc == OXL_OK && count == 0)
        rc = oxl_fail(
            r->ctx, OXL_ERR_INPUT,
            "%s: byte 0: found no image, expected one or more\nfix: take a model with registered images (sparse/0, "
            "sparse/1, ...)",
            r->path);
    while (rc == OXL_OK && out->image_count < count) {
        struct colmap_image image = {0};
        r->line++;
        rc = binary_pose(r, &image);
        if (rc == OXL_OK) rc = colmap_add_image(r, &image);
        if (rc == OXL_OK) rc = binary_skip_observations(r, &out->image[out->image_count - 1]);
    }
    if (rc == OXL_OK) binary_end(r);
    return rc;
}

/* ---------------- points3D.bin */

static oxl_result binary_track(struct colmap_reader *r, uint64_t length, struct colmap_point *point)
{
    struct colmap *out = r->out;
    for (uint64_t i = 0; i < length; i++) {
        const char *p = NULL;
        const oxl_result rc = binary_take(r, BINARY_TRACK, "an entry of a track", &p);
        uint32_t row;
        if (rc != OXL_OK) return rc;
        row = *colmap_index_slot(&r->images, out->image, sizeof *out->image, (int64_t)bytes_u32(p));
        if (row == 0) colmap_warn(r, WARN_TRACK);
        else
            out->track[out->track_count + point->track_count++] =
                (struct colmap_track){row - 1, bytes_u32(p + 4)};
    }
    return OXL_OK;
}

/* Reads a point and the length of its track. more: number of points after this one. Refuses a track that
 * leaves no bytes for them, which would overrun the array of tracks. */
static oxl_result binary_point(struct colmap_reader *r, uint64_t more, struct colmap_point *point,
                               uint64_t *length)
{
    const char *p = NULL;
    oxl_result rc = binary_take(r, BINARY_POINT - 8, "a point", &p);
    if (rc == OXL_OK) rc = binary_point_id(r, p, &point->id);
    if (rc != OXL_OK) return rc;
    for (int i = 0; i < 3; i++) point->position[i] = bytes_double(p + 8 + 8 * i);
    memcpy(point->rgb, p + 32, 3);
    point->error = bytes_double(p + 35);
    rc = binary_count(r, "the length of a track", BINARY_TRACK, length);
    if (rc == OXL_OK && *length * BINARY_TRACK + more * BINARY_POINT > binary_left(r))
        rc = binary_fail(r, binary_offset(r) - 8, "the length of a track",
                         "the number %" PRIu64 " where %" PRIu64 " bytes and as many points as %" PRIu64
                         " follow",
                         *length, binary_left(r), more);
    return rc;
}

/* Adds a point, or none if its position is not finite. */
static oxl_result binary_add_point(struct colmap_reader *r, uint64_t more)
{
    struct colmap *out = r->out;
    struct colmap_point point = {.first_track = out->track_count};
    uint64_t length = 0;
    oxl_result rc = binary_point(r, more, &point, &length);
    if (rc != OXL_OK) return rc;
    if (!colmap_check_point(r, &point)) return binary_skip(r, length * BINARY_TRACK);
    rc = binary_track(r, length, &point);
    if (rc != OXL_OK) return rc;
    out->point[out->point_count++] = point;
    out->track_count += point.track_count;
    return OXL_OK;
}

/* Reads the points. Allocates rows of points and tracks once: all bytes of the file
 * beside the points are tracks. */
static oxl_result binary_points(struct colmap_reader *r)
{
    struct colmap *out = r->out;
    uint64_t count = 0;
    int64_t id = 0;
    oxl_result rc = binary_count(r, "the number of points", BINARY_POINT, &count);
    if (rc != OXL_OK) return rc;
    out->point = oxl_alloc(r->ctx, (size_t)count + 1, sizeof *out->point);
    out->track = oxl_alloc(r->ctx, (size_t)((binary_left(r) - count * BINARY_POINT) / BINARY_TRACK) + 1,
                           sizeof *out->track);
    if (!out->point || !out->track) return OXL_ERR_MEMORY;
    while (rc == OXL_OK && (uint64_t)r->line < count && r->line < INT_MAX) {
        r->line++;
        rc = binary_add_point(r, count - (uint64_t)r->line);
    }
    if (rc == OXL_OK && (rc = colmap_order_points(r->ctx, out, &id)) == OXL_ERR_INPUT)
        rc = oxl_fail(r->ctx, OXL_ERR_INPUT,
                      "%s: point id %" PRId64 " is there twice, expected each id once\nfix: " BINARY_FIX,
                      r->path, id);
    if (rc == OXL_OK) binary_end(r);
    return rc;
}

/* ---------------- entry */

OXL_INTERNAL oxl_result colmap_read_binary(struct colmap_reader *r, const char *folder)
{
    oxl_result rc = colmap_open_bytes(r, folder, "cameras.bin");
    if (rc == OXL_OK) rc = colmap_fill(r);
    if (rc == OXL_OK) rc = binary_cameras(r);
    colmap_close(r);
    if (rc == OXL_OK) rc = colmap_open_bytes(r, folder, "images.bin");
    if (rc == OXL_OK) rc = colmap_fill(r);
    if (rc == OXL_OK) rc = binary_images(r);
    colmap_close(r);
    if (rc == OXL_OK && !os_is_file(PATH(folder, "points3D.bin"))) return OXL_OK;
    if (rc == OXL_OK) rc = colmap_open_bytes(r, folder, "points3D.bin");
    if (rc == OXL_OK) rc = colmap_fill(r);
    if (rc == OXL_OK) rc = binary_points(r);
    colmap_close(r);
    return rc;
}
