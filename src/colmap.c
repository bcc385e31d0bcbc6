/* colmap.c - the three text files of a COLMAP model (cameras.txt, images.txt, points3D.txt) as they are, and back.
 *
 * Source: "Output Format" in COLMAP's documentation, and what other programs that write these files make of it: CR LF, tabs,
 * a missing line of 2D points, decimal commas, -nan(ind). What can be mended is, with a warning; the rest is an error that
 * names file:line, what was seen, what was wanted, and one fix.
 *
 * Invariants of what colmap_read gives: ids are unique in their file; each image's camera and each track's image is there;
 * all numbers are finite (an unknown reprojection error is -1, as COLMAP writes it); no name leads out of the image folder.
 * Not promised: that points which observations name, and observations which tracks name, are there.
 */
#include "internal.h"

#include <inttypes.h>

/* ---------------------------------------------------------------- ids */

/* Open addressing over the rows of an array whose elements begin with their int64_t id. */
struct colmap_index {
    uint32_t *slot;  /* (slots) row + 1; 0: empty */
    size_t    slots; /* a power of 2, at least twice the rows */
};

static int64_t colmap_id_at(const void *rows, size_t stride, size_t row)
{
    int64_t id;
    memcpy(&id, (const char *)rows + row * stride, sizeof id);
    return id;
}

/* Where the id is, or the empty slot where it belongs. */
static uint32_t *colmap_index_slot(const struct colmap_index *x, const void *rows, size_t stride, int64_t id)
{
    size_t s = (size_t)(((uint64_t)id * UINT64_C(0x9E3779B97F4A7C15)) >> 32) & (x->slots - 1); /* Knuth's golden ratio */
    while (x->slot[s] && colmap_id_at(rows, stride, x->slot[s] - 1) != id) s = (s + 1) & (x->slots - 1);
    return &x->slot[s];
}

static oxl_result colmap_index_grow(oxl_context *ctx, struct colmap_index *x, const void *rows, size_t stride, size_t count)
{
    struct colmap_index grown = {.slots = OXL_MAX((size_t)64, 4 * x->slots)};
    if (count < UINT32_MAX) grown.slot = oxl_calloc(ctx, grown.slots, sizeof *grown.slot);
    if (!grown.slot) return oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for a table of %zu ids", count);
    for (size_t row = 0; row < count; row++)
        *colmap_index_slot(&grown, rows, stride, colmap_id_at(rows, stride, row)) = (uint32_t)row + 1;
    oxl_free(ctx, x->slot);
    *x = grown;
    return OXL_OK;
}

/* ---------------------------------------------------------------- the reader: a file, a line, a field */

enum colmap_oddity { ODD_NO_POINTS_LINE, ODD_OBSERVATION, ODD_QUATERNION, ODD_POSITION, ODD_ERROR, ODD_TRACK, ODD_COUNT };

static const char *const colmap_oddity_text[ODD_COUNT] = {
    "the image before has no line of 2D points; it is taken as empty",
    "a 2D point without a finite position; it is taken as unmatched",
    "a quaternion whose length is not 1; it is normalised",
    "a point without a finite position; it is left out",
    "a reprojection error that is no finite number; it is taken as unknown",
    "a track names an image that is not in images.txt; that entry is left out",
};

enum { COLMAP_LOGGED_MAX = 10 }; /* lines of a kind */

#define COLMAP_FIX_EXPORT "export the model once more: colmap model_converter --output_type TXT"
#define COLMAP_FIX_SAME   "export all three files from the same COLMAP model"

struct colmap_reader {
    oxl_context        *ctx;
    struct colmap      *out;
    char               *path;
    struct os_file_map  file;
    const char         *next;         /* first byte after this line */
    const char         *cursor, *end; /* what is left of this line, without blanks at its ends */
    int                 line;         /* from 1 */
    size_t              odd[ODD_COUNT];
    struct colmap_index cameras, images, points;
    size_t              camera_capacity, image_capacity, observation_capacity, point_capacity, track_capacity, names_capacity;
};

static void colmap_warn(struct colmap_reader *r, enum colmap_oddity kind)
{
    if (r->odd[kind]++ < COLMAP_LOGGED_MAX)
        oxl_log(r->ctx, OXL_LOG_WARNING, "%s:%d: %s", r->path, r->line, colmap_oddity_text[kind]);
}

static int colmap_is_blank(char c)
{
    return c == ' ' || c == '\t';
}

static int colmap_next_line(struct colmap_reader *r)
{
    const char *file_end = r->file.data + r->file.size, *feed;
    if (r->next == file_end) return 0;
    feed      = memchr(r->next, '\n', (size_t)(file_end - r->next));
    r->cursor = r->next;
    r->end    = feed ? feed : file_end;
    r->next   = feed ? feed + 1 : file_end;
    r->line++;
    while (r->end > r->cursor && (colmap_is_blank(r->end[-1]) || r->end[-1] == '\r')) r->end--;
    while (r->cursor < r->end && colmap_is_blank(*r->cursor)) r->cursor++;
    return 1;
}

/* The next line that is neither blank nor a comment. */
static int colmap_next_record(struct colmap_reader *r)
{
    while (colmap_next_line(r))
        if (r->cursor < r->end && *r->cursor != '#') return 1;
    return 0;
}

/* A field as an error shows it: 'text', cut and printable, or "the end of the line". */
static const char *colmap_seen(const char *p, const char *end, char out[64])
{
    size_t size = 0;
    if (p == end) return "the end of the line";
    out[size++] = '\'';
    while (p < end && !colmap_is_blank(*p) && size < 48) {
        out[size++] = (unsigned char)*p < 0x20 || *p == 0x7f ? '?' : *p;
        p++;
    }
    snprintf(out + size, 64 - size, "%s'", p < end && !colmap_is_blank(*p) ? "..." : "");
    return out;
}

/* 0,5 and the like. */
static int colmap_has_comma(const char *p, const char *end)
{
    for (p++; p + 1 < end && !colmap_is_blank(*p); p++)
        if (*p == ',' && p[-1] >= '0' && p[-1] <= '9' && p[1] >= '0' && p[1] <= '9') return 1;
    return 0;
}

static oxl_result colmap_wrong(struct colmap_reader *r, const char *token, const char *what, const char *kind)
{
    char        buffer[64];
    const char *seen = colmap_seen(token, r->end, buffer);
    if (token < r->end && colmap_has_comma(token, r->end))
        return oxl_fail(r->ctx, OXL_ERR_INPUT,
                        "%s:%d: seen %s, a decimal comma, for %s; wanted a decimal point\n"
                        "fix: the export was made under a locale with decimal commas; make it again with LC_ALL=C in front: "
                        "LC_ALL=C colmap model_converter --output_type TXT",
                        r->path, r->line, seen, what);
    return oxl_fail(r->ctx, OXL_ERR_INPUT, "%s:%d: seen %s, wanted %s, %s\nfix: " COLMAP_FIX_EXPORT, r->path, r->line, seen, what,
                    kind);
}

/* Field readers leave the cursor behind their field. */
static void colmap_skip_blanks(struct colmap_reader *r)
{
    while (r->cursor < r->end && colmap_is_blank(*r->cursor)) r->cursor++;
}

static int colmap_at_field_end(const struct colmap_reader *r)
{
    return r->cursor == r->end || colmap_is_blank(*r->cursor);
}

static oxl_result colmap_real(struct colmap_reader *r, const char *what, double *out)
{
    const char *token;
    colmap_skip_blanks(r);
    token = r->cursor;
    if (parse_double(&r->cursor, r->end, out) && colmap_at_field_end(r)) return OXL_OK;
    return colmap_wrong(r, token, what, "a number");
}

static oxl_result colmap_finite(struct colmap_reader *r, const char *what, double *out)
{
    const char *token;
    oxl_result  rc;
    colmap_skip_blanks(r);
    token = r->cursor;
    rc    = colmap_real(r, what, out);
    return rc != OXL_OK || fabs(*out) <= DBL_MAX ? rc : colmap_wrong(r, token, what, "a finite number");
}

static oxl_result colmap_whole(struct colmap_reader *r, const char *what, int64_t low, int64_t high, int64_t *out)
{
    const char *token;
    char        kind[80];
    colmap_skip_blanks(r);
    token = r->cursor;
    if (parse_int64(&r->cursor, r->end, out) && colmap_at_field_end(r) && *out >= low && *out <= high) return OXL_OK;
    if (low == INT64_MIN) snprintf(kind, sizeof kind, "an integer");
    else if (high == INT64_MAX) snprintf(kind, sizeof kind, "an integer of at least %" PRId64, low);
    else snprintf(kind, sizeof kind, "an integer from %" PRId64 " to %" PRId64, low, high);
    return colmap_wrong(r, token, what, kind);
}

static oxl_result colmap_id(struct colmap_reader *r, const char *what, int64_t *out)
{
    return colmap_whole(r, what, INT64_MIN, INT64_MAX, out);
}

/* Enters the last of `count` + 1 rows; an id that is there already is an error. */
static oxl_result colmap_enter(struct colmap_reader *r, struct colmap_index *x, const void *rows, size_t stride, size_t count,
                               const char *what)
{
    const int64_t id = colmap_id_at(rows, stride, count);
    uint32_t     *slot;
    oxl_result    rc = OXL_OK;
    if (2 * (count + 1) > x->slots) rc = colmap_index_grow(r->ctx, x, rows, stride, count);
    if (rc != OXL_OK) return rc;
    slot = colmap_index_slot(x, rows, stride, id);
    if (*slot)
        return oxl_fail(r->ctx, OXL_ERR_INPUT,
                        "%s:%d: %s %" PRId64 " was there before, wanted each id once\nfix: " COLMAP_FIX_EXPORT, r->path, r->line,
                        what, id);
    *slot = (uint32_t)count + 1;
    return OXL_OK;
}

/* ---------------------------------------------------------------- cameras.txt: CAMERA_ID MODEL WIDTH HEIGHT PARAMS[] */

static oxl_result colmap_read_model(struct colmap_reader *r, struct colmap_camera *c)
{
    char        buffer[64];
    const char *token;
    colmap_skip_blanks(r);
    token = r->cursor;
    while (!colmap_at_field_end(r)) r->cursor++;
    c->model = camera_model_find(token, (size_t)(r->cursor - token));
    if (c->model < 0)
        return oxl_fail(
            r->ctx, OXL_ERR_INPUT,
            "%s:%d: seen %s for the camera model, wanted one of %s\n"
            "fix: let COLMAP undistort: colmap image_undistorter --image_path IMAGES --input_path MODEL --output_path OUT",
            r->path, r->line, colmap_seen(token, r->end, buffer), camera_model_list());
    c->parameter_count = camera_model_at(c->model)->parameter_count;
    return OXL_OK;
}

static oxl_result colmap_read_camera(struct colmap_reader *r, struct colmap_camera *c)
{
    int64_t    width = 0, height = 0;
    oxl_result rc = colmap_id(r, "CAMERA_ID", &c->id);
    if (rc == OXL_OK) rc = colmap_read_model(r, c);
    if (rc == OXL_OK) rc = colmap_whole(r, "WIDTH", 1, INT_MAX, &width);
    if (rc == OXL_OK) rc = colmap_whole(r, "HEIGHT", 1, INT_MAX, &height);
    for (int i = 0; i < c->parameter_count && rc == OXL_OK; i++) {
        const char *token;
        colmap_skip_blanks(r);
        token = r->cursor;
        rc    = colmap_finite(r, "PARAMS", &c->parameter[i]);
        if (rc == OXL_OK && i < camera_model_at(c->model)->focal_count && !(c->parameter[i] > 0))
            rc = colmap_wrong(r, token, "a focal length", "more than 0 px");
    }
    colmap_skip_blanks(r);
    if (rc == OXL_OK && r->cursor != r->end)
        rc = colmap_wrong(r, r->cursor, "the end of the line", "after the model's parameters");
    c->width  = (int)width;
    c->height = (int)height;
    c->line   = r->line;
    return rc;
}

static oxl_result colmap_read_cameras(struct colmap_reader *r)
{
    struct colmap *out = r->out;
    oxl_result     rc  = OXL_OK;
    while (rc == OXL_OK && colmap_next_record(r)) {
        struct colmap_camera camera = {0};
        rc                          = colmap_read_camera(r, &camera);
        if (rc == OXL_OK)
            rc = oxl_reserve(r->ctx, (void **)&out->camera, &r->camera_capacity, out->camera_count + 1, sizeof camera);
        if (rc != OXL_OK) break;
        out->camera[out->camera_count] = camera;
        rc                             = colmap_enter(r, &r->cameras, out->camera, sizeof camera, out->camera_count, "camera id");
        if (rc == OXL_OK) out->camera_count++;
    }
    if (rc == OXL_OK && out->camera_count == 0)
        rc = oxl_fail(r->ctx, OXL_ERR_INPUT, "%s:%d: seen the end of the file, wanted a camera\nfix: " COLMAP_FIX_EXPORT, r->path,
                      r->line);
    return rc;
}

/* ---------------------------------------------------------------- images.txt: two lines an image
 *
 *     IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME       the name is the rest of the line
 *     (X Y POINT3D_ID)*                                  may be empty; some programs leave it out
 */

/* "1-3" when there is no gap, else "3 from 1 to 17". */
static void colmap_camera_ids(const struct colmap *c, char *out, size_t size)
{
    int64_t low = c->camera[0].id, high = low;
    for (size_t i = 1; i < c->camera_count; i++) {
        low  = OXL_MIN(low, c->camera[i].id);
        high = OXL_MAX(high, c->camera[i].id);
    }
    if (c->camera_count == 1) snprintf(out, size, "%" PRId64, low);
    else if ((uint64_t)high - (uint64_t)low == c->camera_count - 1) snprintf(out, size, "%" PRId64 "-%" PRId64, low, high);
    else snprintf(out, size, "%zu from %" PRId64 " to %" PRId64, c->camera_count, low, high);
}

static int colmap_knows_camera(const struct colmap_reader *r, int64_t id)
{
    return *colmap_index_slot(&r->cameras, r->out->camera, sizeof *r->out->camera, id) != 0;
}

static oxl_result colmap_check_camera(struct colmap_reader *r, int64_t id)
{
    char ids[80];
    if (colmap_knows_camera(r, id)) return OXL_OK;
    colmap_camera_ids(r->out, ids, sizeof ids);
    return oxl_fail(r->ctx, OXL_ERR_INPUT,
                    "%s:%d: camera id %" PRId64 " is not in cameras.txt (ids there: %s)\nfix: " COLMAP_FIX_SAME, r->path, r->line,
                    id, ids);
}

static oxl_result colmap_check_rotation(struct colmap_reader *r, const double q[4])
{
    const double length = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    if (!(length >= 1e-6 && length <= 1e6))
        return oxl_fail(
            r->ctx, OXL_ERR_INPUT,
            "%s:%d: seen the quaternion %g %g %g %g, wanted a rotation (length 1)\nfix: delete this image from the model "
            "(colmap image_deleter) and export it once more",
            r->path, r->line, q[0], q[1], q[2], q[3]);
    if (fabs(length - 1) > 1e-2) colmap_warn(r, ODD_QUATERNION);
    return OXL_OK;
}

/* Nobody's files outside the image folder: no absolute path, no drive, no ".." between slashes of either kind. */
static int colmap_name_is_safe(const char *name, const char *end)
{
    const char *part = name;
    if (*name == '/' || *name == '\\' || (end - name > 1 && name[1] == ':')) return 0;
    for (const char *p = name;; p++) {
        if (p < end && *p == 0) return 0;
        if (p < end && *p != '/' && *p != '\\') continue;
        if (p - part == 2 && part[0] == '.' && part[1] == '.') return 0;
        if (p == end) return 1;
        part = p + 1;
    }
}

static oxl_result colmap_read_name(struct colmap_reader *r, size_t *name)
{
    struct colmap *out = r->out;
    size_t         size;
    oxl_result     rc;
    colmap_skip_blanks(r);
    size = (size_t)(r->end - r->cursor);
    if (size == 0) return colmap_wrong(r, r->cursor, "NAME", "a file in the image folder");
    if (!colmap_name_is_safe(r->cursor, r->end))
        return oxl_fail(r->ctx, OXL_ERR_INPUT,
                        "%s:%d: seen the name '%.*s', wanted a path inside the image folder\n"
                        "fix: give names relative to that folder, without \"..\"",
                        r->path, r->line, (int)OXL_MIN(size, (size_t)200), r->cursor);
    rc = oxl_reserve(r->ctx, (void **)&out->names, &r->names_capacity, out->names_size + size + 1, 1);
    if (rc != OXL_OK) return rc;
    *name = out->names_size;
    memcpy(out->names + *name, r->cursor, size);
    out->names[*name + size] = 0;
    out->names_size += size + 1;
    return OXL_OK;
}

static oxl_result colmap_read_pose(struct colmap_reader *r, struct colmap_image *image)
{
    static const char *const what[7] = {"QW", "QX", "QY", "QZ", "TX", "TY", "TZ"};
    oxl_result               rc      = colmap_id(r, "IMAGE_ID", &image->id);
    for (int i = 0; i < 7 && rc == OXL_OK; i++)
        rc = colmap_finite(r, what[i], i < 4 ? &image->rotation[i] : &image->translation[i - 4]);
    if (rc == OXL_OK) rc = colmap_check_rotation(r, image->rotation);
    if (rc == OXL_OK) rc = colmap_id(r, "CAMERA_ID", &image->camera_id);
    if (rc == OXL_OK) rc = colmap_check_camera(r, image->camera_id);
    if (rc == OXL_OK) rc = colmap_read_name(r, &image->name);
    image->line = r->line;
    return rc;
}

/* POINT3D_ID; 2^64 - 1 is how unsigned programs print -1. */
static oxl_result colmap_read_match(struct colmap_reader *r, int64_t *out)
{
    static const char none[] = "18446744073709551615";
    colmap_skip_blanks(r);
    if ((size_t)(r->end - r->cursor) >= sizeof none - 1 && memcmp(r->cursor, none, sizeof none - 1) == 0) {
        *out = -1;
        r->cursor += sizeof none - 1;
        if (colmap_at_field_end(r)) return OXL_OK;
        r->cursor -= sizeof none - 1;
    }
    return colmap_id(r, "POINT3D_ID of a 2D point (X Y POINT3D_ID)", out);
}

static oxl_result colmap_read_observations(struct colmap_reader *r, struct colmap_image *image)
{
    struct colmap *out    = r->out;
    const size_t   needed = out->observation_count + (size_t)(r->end - r->cursor) / 6 + 1; /* "0 0 0 " is the shortest */
    oxl_result rc = oxl_reserve(r->ctx, (void **)&out->observation, &r->observation_capacity, needed, sizeof *out->observation);
    for (; rc == OXL_OK && r->cursor < r->end; image->observation_count++) {
        struct colmap_observation *o = &out->observation[out->observation_count];
        rc                           = colmap_real(r, "X of a 2D point (X Y POINT3D_ID)", &o->x);
        if (rc == OXL_OK) rc = colmap_real(r, "Y of a 2D point (X Y POINT3D_ID)", &o->y);
        if (rc == OXL_OK) rc = colmap_read_match(r, &o->point);
        if (rc == OXL_OK && !(fabs(o->x) <= DBL_MAX && fabs(o->y) <= DBL_MAX)) {
            *o = (struct colmap_observation){.point = -1}; /* keeps its place: tracks count on it */
            colmap_warn(r, ODD_OBSERVATION);
        }
        out->observation_count++;
    }
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

/* Is a line that should hold 2D points an image's first line? That has an integer, 7 numbers, an integer, and a name. Most
 * names are no numbers, which settles it. A name of digits alone leaves nothing but numbers: then it is an image when they
 * do not come in threes, begin with a rotation, and name a camera that is there. */
static int colmap_is_pose(const struct colmap_reader *r)
{
    const char *p = r->cursor;
    int64_t     image, camera;
    double      v[7], name, square;
    if (!colmap_peek_whole(&p, r->end, &image)) return 0; /* almost every line of 2D points leaves here, at its 1st number */
    for (int i = 0; i < 7; i++)
        if (!colmap_peek_real(&p, r->end, &v[i])) return 0;
    if (!colmap_peek_whole(&p, r->end, &camera) || p == r->end) return 0;
    if (!colmap_peek_real(&p, r->end, &name)) return 1;
    square = v[0] * v[0] + v[1] * v[1] + v[2] * v[2] + v[3] * v[3];
    return fabs(square - 1) < 1e-2 && colmap_knows_camera(r, camera) && colmap_count_fields(r->cursor, r->end) % 3 != 0;
}

/* The second line. When it is missing, the reader stays before the line that stands in its place. */
static oxl_result colmap_read_second_line(struct colmap_reader *r, int keep, struct colmap_image *image)
{
    const char *next = r->next;
    const int   line = r->line;
    if (!colmap_next_line(r)) return OXL_OK;
    if (r->cursor < r->end && (*r->cursor == '#' || colmap_is_pose(r))) {
        colmap_warn(r, ODD_NO_POINTS_LINE);
        r->next = next;
        r->line = line;
        return OXL_OK;
    }
    return keep ? colmap_read_observations(r, image) : OXL_OK;
}

static oxl_result colmap_read_images(struct colmap_reader *r, int keep_observations)
{
    struct colmap *out   = r->out;
    const size_t   guess = keep_observations ? r->file.size / 22 : 0; /* "851.868 0.985 12345 ": grown later, if at all */
    oxl_result rc = oxl_reserve(r->ctx, (void **)&out->observation, &r->observation_capacity, guess, sizeof *out->observation);
    while (rc == OXL_OK && colmap_next_record(r)) {
        struct colmap_image image = {.first_observation = out->observation_count};
        rc                        = colmap_read_pose(r, &image);
        if (rc == OXL_OK) rc = oxl_reserve(r->ctx, (void **)&out->image, &r->image_capacity, out->image_count + 1, sizeof image);
        if (rc != OXL_OK) break;
        out->image[out->image_count] = image;
        rc                           = colmap_enter(r, &r->images, out->image, sizeof image, out->image_count, "image id");
        if (rc == OXL_OK) rc = colmap_read_second_line(r, keep_observations, &out->image[out->image_count]);
        if (rc == OXL_OK) out->image_count++;
    }
    if (rc == OXL_OK && out->image_count == 0)
        rc = oxl_fail(r->ctx, OXL_ERR_INPUT,
                      "%s:%d: seen the end of the file, wanted an image\nfix: take a model with registered images (sparse/0, "
                      "sparse/1, ...), or " COLMAP_FIX_EXPORT,
                      r->path, r->line);
    return rc;
}

/* ---------------------------------------------------------------- points3D.txt: ID X Y Z R G B ERROR (IMAGE_ID POINT2D_IDX)* */

static oxl_result colmap_read_track(struct colmap_reader *r, struct colmap_point *point)
{
    struct colmap *out    = r->out;
    const size_t   needed = out->track_count + (size_t)(r->end - r->cursor) / 4 + 1; /* "0 0 " is the shortest */
    oxl_result     rc     = oxl_reserve(r->ctx, (void **)&out->track, &r->track_capacity, needed, sizeof *out->track);
    while (rc == OXL_OK && r->cursor < r->end) {
        struct colmap_track *t = &out->track[out->track_count];
        rc                     = colmap_id(r, "IMAGE_ID of a track (IMAGE_ID POINT2D_IDX)", &t->image);
        if (rc == OXL_OK) rc = colmap_whole(r, "POINT2D_IDX of a track (IMAGE_ID POINT2D_IDX)", 0, INT64_MAX, &t->observation);
        if (rc != OXL_OK) break;
        if (*colmap_index_slot(&r->images, out->image, sizeof *out->image, t->image) == 0) {
            colmap_warn(r, ODD_TRACK);
            continue;
        }
        out->track_count++;
        point->track_count++;
    }
    return rc;
}

static int colmap_position_is_finite(const double p[3])
{
    return fabs(p[0]) <= DBL_MAX && fabs(p[1]) <= DBL_MAX && fabs(p[2]) <= DBL_MAX;
}

static oxl_result colmap_read_point(struct colmap_reader *r, struct colmap_point *point)
{
    static const char *const axis[3] = {"X", "Y", "Z"}, *const channel[3] = {"R", "G", "B"};
    int64_t    rgb[3] = {0};
    oxl_result rc     = colmap_id(r, "POINT3D_ID", &point->id);
    for (int i = 0; i < 3 && rc == OXL_OK; i++) rc = colmap_real(r, axis[i], &point->position[i]);
    for (int i = 0; i < 3 && rc == OXL_OK; i++) rc = colmap_whole(r, channel[i], 0, 255, &rgb[i]);
    if (rc == OXL_OK) rc = colmap_real(r, "ERROR", &point->error);
    for (int i = 0; i < 3; i++) point->rgb[i] = (uint8_t)rgb[i];
    return rc;
}

static oxl_result colmap_read_points(struct colmap_reader *r)
{
    struct colmap *out = r->out;
    oxl_result     rc  = oxl_reserve(r->ctx, (void **)&out->track, &r->track_capacity, r->file.size / 20, sizeof *out->track);
    while (rc == OXL_OK && colmap_next_record(r)) {
        struct colmap_point point = {.first_track = out->track_count};
        rc                        = colmap_read_point(r, &point);
        if (rc != OXL_OK) break;
        if (!colmap_position_is_finite(point.position)) {
            colmap_warn(r, ODD_POSITION);
            continue;
        }
        if (!(fabs(point.error) <= DBL_MAX)) {
            colmap_warn(r, ODD_ERROR);
            point.error = -1;
        }
        rc = colmap_read_track(r, &point);
        if (rc == OXL_OK) rc = oxl_reserve(r->ctx, (void **)&out->point, &r->point_capacity, out->point_count + 1, sizeof point);
        if (rc != OXL_OK) break;
        out->point[out->point_count] = point;
        rc                           = colmap_enter(r, &r->points, out->point, sizeof point, out->point_count, "point id");
        if (rc == OXL_OK) out->point_count++;
    }
    return rc;
}

/* ---------------------------------------------------------------- the three together */

static oxl_result colmap_find_file(oxl_context *ctx, const char *folder, const char *name, int *found)
{
    char *path = oxl_path_join(ctx, folder, name);
    if (!path) return oxl_fail(ctx, OXL_ERR_MEMORY, "%s: no memory to look for %s", folder, name);
    *found = os_is_file(path);
    oxl_free(ctx, path);
    return OXL_OK;
}

static oxl_result colmap_check_folder(oxl_context *ctx, const char *folder)
{
    static const char *const name[4] = {"cameras.txt", "images.txt", "points3D.txt", "cameras.bin"};
    const char              *quote   = strpbrk(folder, " '()&;$") ? "\"" : "";
    int                      found[4], i = 0;
    oxl_result               rc = OXL_OK;
    for (i = 0; i < 4 && rc == OXL_OK; i++) rc = colmap_find_file(ctx, folder, name[i], &found[i]);
    if (rc != OXL_OK || (found[0] && found[1] && found[2])) return rc;
    for (i = 0; found[i]; i++) {}
    if (found[3])
        return oxl_fail(ctx, OXL_ERR_INPUT,
                        "%s: seen a binary COLMAP model (cameras.bin) without %s, wanted the text files\n"
                        "fix: colmap model_converter --input_path %s%s%s --output_path %s%s%s --output_type TXT",
                        folder, name[i], quote, folder, quote, quote, folder, quote);
    return oxl_fail(ctx, OXL_ERR_INPUT,
                    "%s: %s is not there, wanted a COLMAP text export: cameras.txt, images.txt and points3D.txt\n"
                    "fix: name the folder that holds all three, or export them with colmap model_converter --output_type TXT",
                    folder, name[i]);
}

static oxl_result colmap_open(struct colmap_reader *r, const char *folder, const char *name)
{
    oxl_result rc;
    r->path = oxl_path_join(r->ctx, folder, name);
    if (!r->path) return oxl_fail(r->ctx, OXL_ERR_MEMORY, "%s: no memory to read it", name);
    rc = os_read_file(r->ctx, r->path, &r->file);
    if (rc != OXL_OK) return rc;
    r->next = r->file.data;
    r->line = 0;
    if (r->file.size >= 3 && memcmp(r->next, "\xEF\xBB\xBF", 3) == 0) r->next += 3; /* the byte order mark of UTF-8 */
    if (r->file.size >= 2 && (memcmp(r->next, "\xFF\xFE", 2) == 0 || memcmp(r->next, "\xFE\xFF", 2) == 0))
        return oxl_fail(r->ctx, OXL_ERR_INPUT, "%s:1: seen text in UTF-16, wanted ASCII or UTF-8\nfix: save it as UTF-8",
                        r->path);
    return OXL_OK;
}

/* Says how many oddities went unsaid, and lets go of the file. */
static void colmap_close(struct colmap_reader *r)
{
    for (int i = 0; i < ODD_COUNT; i++) {
        if (r->odd[i] > COLMAP_LOGGED_MAX)
            oxl_log(r->ctx, OXL_LOG_WARNING, "%s: %zu more like it: %s", r->path, r->odd[i] - COLMAP_LOGGED_MAX,
                    colmap_oddity_text[i]);
        r->out->warnings += r->odd[i];
        r->odd[i] = 0;
    }
    os_release_file(r->ctx, &r->file);
    oxl_free(r->ctx, r->path);
    r->path = NULL;
}

OXL_INTERNAL oxl_result colmap_read(oxl_context *ctx, const char *folder, int keep_observations, struct colmap *out)
{
    struct colmap_reader r = {.ctx = ctx, .out = out};
    oxl_result           rc;
    *out = (struct colmap){0};
    rc   = colmap_check_folder(ctx, folder);
    if (rc == OXL_OK) rc = colmap_open(&r, folder, "cameras.txt");
    if (rc == OXL_OK) rc = colmap_read_cameras(&r);
    colmap_close(&r);
    if (rc == OXL_OK) rc = colmap_open(&r, folder, "images.txt");
    if (rc == OXL_OK) rc = colmap_read_images(&r, keep_observations);
    colmap_close(&r);
    if (rc == OXL_OK) rc = colmap_open(&r, folder, "points3D.txt");
    if (rc == OXL_OK) rc = colmap_read_points(&r);
    colmap_close(&r);
    oxl_free(ctx, r.cameras.slot);
    oxl_free(ctx, r.images.slot);
    oxl_free(ctx, r.points.slot);
    if (rc != OXL_OK) colmap_free(ctx, out);
    return rc;
}

OXL_INTERNAL void colmap_free(oxl_context *ctx, struct colmap *c)
{
    oxl_free(ctx, c->camera);
    oxl_free(ctx, c->image);
    oxl_free(ctx, c->observation);
    oxl_free(ctx, c->point);
    oxl_free(ctx, c->track);
    oxl_free(ctx, c->names);
    *c = (struct colmap){0};
}

/* ---------------------------------------------------------------- writing; os_writer_close notices what failed */

static void colmap_put(FILE *file, char before, double value)
{
    char         text[NUMBER_TEXT_MAX + 1];
    const size_t size = format_double(text + 1, value);
    text[0]           = before;
    fwrite(text, 1, size + 1, file);
}

static void colmap_write_cameras(FILE *file, const struct colmap *c)
{
    fprintf(file, "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n# Number of cameras: %zu\n", c->camera_count);
    for (size_t row = 0; row < c->camera_count; row++) {
        const struct colmap_camera *k = &c->camera[row];
        fprintf(file, "%" PRId64 " %s %d %d", k->id, camera_model_at(k->model)->name, k->width, k->height);
        for (int i = 0; i < k->parameter_count; i++) colmap_put(file, ' ', k->parameter[i]);
        putc('\n', file);
    }
}

static void colmap_write_images(FILE *file, const struct colmap *c)
{
    fprintf(file, "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n# POINTS2D[] as (X, Y, POINT3D_ID)\n");
    fprintf(file, "# Number of images: %zu\n", c->image_count);
    for (size_t row = 0; row < c->image_count; row++) {
        const struct colmap_image *k = &c->image[row];
        fprintf(file, "%" PRId64, k->id);
        for (int i = 0; i < 4; i++) colmap_put(file, ' ', k->rotation[i]);
        for (int i = 0; i < 3; i++) colmap_put(file, ' ', k->translation[i]);
        fprintf(file, " %" PRId64 " %s\n", k->camera_id, c->names + k->name);
        for (size_t i = 0; i < k->observation_count; i++) {
            const struct colmap_observation *o = &c->observation[k->first_observation + i];
            colmap_put(file, ' ', o->x);
            colmap_put(file, ' ', o->y);
            fprintf(file, " %" PRId64, o->point);
        }
        putc('\n', file);
    }
}

static void colmap_write_points(FILE *file, const struct colmap *c)
{
    fprintf(file, "# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n# Number of points: %zu\n",
            c->point_count);
    for (size_t row = 0; row < c->point_count; row++) {
        const struct colmap_point *k = &c->point[row];
        fprintf(file, "%" PRId64, k->id);
        for (int i = 0; i < 3; i++) colmap_put(file, ' ', k->position[i]);
        fprintf(file, " %d %d %d", k->rgb[0], k->rgb[1], k->rgb[2]);
        colmap_put(file, ' ', k->error);
        for (size_t i = 0; i < k->track_count; i++) {
            const struct colmap_track *t = &c->track[k->first_track + i];
            fprintf(file, " %" PRId64 " %" PRId64, t->image, t->observation);
        }
        putc('\n', file);
    }
}

static oxl_result colmap_write_file(oxl_context *ctx, const char *folder, const char *name, const struct colmap *c,
                                    void (*write)(FILE *file, const struct colmap *c))
{
    struct os_writer writer;
    char            *path = oxl_path_join(ctx, folder, name);
    oxl_result       rc   = OXL_OK;
    if (!path) return oxl_fail(ctx, OXL_ERR_MEMORY, "%s: no memory to write it", name);
    rc = os_writer_open(ctx, path, &writer);
    if (rc == OXL_OK) {
        write(writer.file, c);
        rc = os_writer_close(ctx, &writer, OXL_OK);
    }
    oxl_free(ctx, path);
    return rc;
}

OXL_INTERNAL oxl_result colmap_write(oxl_context *ctx, const char *folder, const struct colmap *c)
{
    oxl_result rc = os_make_folder(ctx, folder);
    if (rc == OXL_OK) rc = colmap_write_file(ctx, folder, "cameras.txt", c, colmap_write_cameras);
    if (rc == OXL_OK) rc = colmap_write_file(ctx, folder, "images.txt", c, colmap_write_images);
    if (rc == OXL_OK) rc = colmap_write_file(ctx, folder, "points3D.txt", c, colmap_write_points);
    return rc;
}
