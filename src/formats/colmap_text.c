/* colmap_text.c - reads COLMAP's text files: a buffer that moves over the file, its lines, their fields, and
 * error messages.
 *
 * Only the buffer is in memory, so a file of several gigabytes needs no more than its parsed rows.
 *
 * Invariant: a message names file:line, the value found, the value expected, and a fix. A quiet reader does
 * not log or allocate.
 */
#include "colmap.h"
#include "survey_read.h"

/* ---------------- ids */

static int64_t colmap_id_at(const void *rows, size_t stride, size_t row)
{
    int64_t id;
    memcpy(&id, (const char *)rows + row * stride, sizeof id);
    return id;
}

OXL_INTERNAL uint32_t *colmap_index_slot(const struct colmap_index *x, const void *rows, size_t stride,
                                         int64_t id)
{
    /* Multiplies by 2^64 divided by the golden ratio (Knuth), which spreads
     * consecutive ids over the slots. */
    size_t s = (size_t)(((uint64_t)id * UINT64_C(0x9E3779B97F4A7C15)) >> 32) & (x->slots - 1);
    while (x->slot[s] && colmap_id_at(rows, stride, x->slot[s] - 1) != id) s = (s + 1) & (x->slots - 1);
    return &x->slot[s];
}

static oxl_result colmap_index_grow(oxl_context *ctx, struct colmap_index *x, const void *rows, size_t stride,
                                    size_t count)
{
    struct colmap_index grown = {.slots = OXL_MAX((size_t)64, 4 * x->slots)};
    if (count < UINT32_MAX) grown.slot = oxl_calloc(ctx, grown.slots, sizeof *grown.slot);
    if (!grown.slot) return OXL_ERR_MEMORY;
    for (size_t row = 0; row < count; row++)
        *colmap_index_slot(&grown, rows, stride, colmap_id_at(rows, stride, row)) = (uint32_t)row + 1;
    oxl_free(ctx, x->slot);
    *x = grown;
    return OXL_OK;
}

/* ---------------- deviations that are read with a warning */

static const char *const colmap_warning_text[WARN_COUNT] = {
    "the image before has no line of 2D points; it is taken as empty",
    "a quaternion whose length is not 1; it is normalised",
    "a point without a finite position; it is left out",
    "a reprojection error that is no finite number; it is taken as unknown",
    "a track names an image that is not there; that entry is left out",
};

enum { COLMAP_LOGGED_MAX = 3 }; /* messages of one kind per file */

/* ---------------- the buffer */

/* Widens the buffer to `room` bytes. */
static oxl_result colmap_grow_buffer(struct colmap_reader *r, size_t room)
{
    const size_t rest = r->buffer ? (size_t)(r->limit - r->buffer) : 0;
    char *buffer = oxl_regrow(r->ctx, r->buffer, rest, room, 1);
    if (!buffer) return r->rc = OXL_ERR_MEMORY;
    r->buffer = buffer;
    r->room = room;
    r->next = buffer;
    r->limit = buffer + rest;
    return OXL_OK;
}

/* Keeps the bytes from `next` on, and reads as many as fit behind them. Widens a buffer that is full of them:
 * a line is longer than it. */
OXL_INTERNAL oxl_result colmap_fill(struct colmap_reader *r)
{
    const size_t rest = (size_t)(r->limit - r->next);
    size_t got = 0;
    memmove(r->buffer, r->next, rest);
    r->offset += (uint64_t)(r->next - r->buffer);
    r->next = r->buffer;
    r->limit = r->buffer + rest;
    if (rest + 1 == r->room && colmap_grow_buffer(r, 2 * r->room) != OXL_OK) return r->rc;
    r->rc = context_stopped(r->ctx);
    if (r->rc == OXL_OK) r->rc = os_reader_read(r->ctx, &r->file, r->buffer + rest, r->room - 1 - rest, &got);
    r->at_end = got < r->room - 1 - rest;
    r->limit += got;
    r->buffer[rest + got] = 0;
    return r->rc;
}

OXL_INTERNAL int colmap_is_blank(char c)
{
    return c == ' ' || c == '\t';
}

/* Returns N of "# Number of images: N, ..." among the comments at the buffer's start. */
static uint64_t colmap_declared_count(const struct colmap_reader *r)
{
    static const char words[] = "# Number of ";
    uint64_t number = 0;
    for (const char *line = r->next; line < r->limit && *line == '#';) {
        const char *feed = memchr(line, '\n', (size_t)(r->limit - line)), *end = feed ? feed : r->limit;
        const char *at = (size_t)(end - line) > sizeof words ? memchr(line, ':', (size_t)(end - line)) : NULL;
        if (at && memcmp(line, words, sizeof words - 1) == 0) {
            for (at++; at < end && colmap_is_blank(*at); at++) {}
            for (; at < end && *at >= '0' && *at <= '9' && number < UINT32_MAX; at++)
                number = 10 * number + (uint64_t)(*at - '0');
        }
        line = feed ? feed + 1 : r->limit;
    }
    return number;
}

OXL_INTERNAL void colmap_compare(struct colmap_reader *r, const char *what, size_t count)
{
    if (r->declared <= count) return;
    oxl_log(r->ctx, OXL_LOG_WARNING,
            "%s: its header announces %" PRIu64
            " %s, and %zu are there: the file is truncated or was edited\n"
            "fix: " COLMAP_FIX_EXPORT,
            r->path, r->declared, what, count);
    r->out->warnings++;
    r->out->is_truncated = 1;
}

OXL_INTERNAL oxl_result colmap_open_bytes(struct colmap_reader *r, const char *folder, const char *name)
{
    char start[32];
    size_t wanted;
    r->line = 0;
    r->offset = 0;
    r->path = oxl_path_join(r->ctx, folder, name);
    if (!r->path) return r->rc = OXL_ERR_MEMORY;
    r->rc = os_reader_open(r->ctx, r->path, &r->file);
    if (r->rc == OXL_OK) r->rc = os_reader_read(r->ctx, &r->file, start, sizeof start, &wanted);
    if (r->rc == OXL_OK) r->rc = os_refuse_gzip(r->ctx, r->path, start, wanted);
    if (r->rc == OXL_OK) r->rc = os_reader_seek(r->ctx, &r->file, 0);
    if (r->rc != OXL_OK) return r->rc;
    r->limit = r->next = r->buffer;
    /* Adds a byte to detect the end of the file, and the zero byte. */
    wanted = (size_t)OXL_MIN(r->file.size, (uint64_t)r->buffer_size) + 2;
    return r->room < wanted ? colmap_grow_buffer(r, wanted) : OXL_OK;
}

OXL_INTERNAL oxl_result colmap_open(struct colmap_reader *r, const char *folder, const char *name)
{
    if (colmap_open_bytes(r, folder, name) == OXL_OK && colmap_begin(r) == OXL_OK)
        r->declared = colmap_declared_count(r);
    return r->rc;
}

OXL_INTERNAL oxl_result colmap_begin(struct colmap_reader *r)
{
    r->line = 0;
    r->offset = 0;
    r->limit = r->next = r->buffer;
    if (colmap_fill(r) != OXL_OK) return r->rc;
    if (r->limit - r->next >= 3 && memcmp(r->next, "\xEF\xBB\xBF", 3) == 0)
        r->next += 3; /* Skips the byte order mark of UTF-8. */
    if (r->limit - r->next >= 2 &&
        (memcmp(r->next, "\xFF\xFE", 2) == 0 || memcmp(r->next, "\xFE\xFF", 2) == 0))
        r->rc =
            oxl_fail(r->ctx, OXL_ERR_INPUT,
                     "%s:1: found text in UTF-16, expected ASCII or UTF-8\nfix: save it as UTF-8", r->path);
    return r->rc;
}

OXL_INTERNAL void colmap_close(struct colmap_reader *r)
{
    for (int i = 0; i < WARN_COUNT; i++) {
        if (r->warned[i] > COLMAP_LOGGED_MAX)
            oxl_log(r->ctx, OXL_LOG_WARNING, "%s: %zu more like it: %s", r->path,
                    r->warned[i] - COLMAP_LOGGED_MAX, colmap_warning_text[i]);
        r->out->warnings += r->warned[i];
        r->warned[i] = 0;
    }
    os_reader_close(&r->file);
    oxl_free(r->ctx, r->path);
    r->path = NULL;
}

/* ---------------- lines and fields */

OXL_INTERNAL void colmap_warn(struct colmap_reader *r, enum colmap_warning kind)
{
    r->suppressed = 1;
    if (r->is_quiet) return;
    if (r->warned[kind]++ < COLMAP_LOGGED_MAX)
        oxl_log(r->ctx, OXL_LOG_WARNING, "%s:%d: %s", r->path, r->line, colmap_warning_text[kind]);
}

OXL_INTERNAL int colmap_next_line(struct colmap_reader *r)
{
    const char *feed;
    while ((feed = memchr(r->next, '\n', (size_t)(r->limit - r->next))) == NULL && !r->at_end)
        if (colmap_fill(r) != OXL_OK) return 0;
    if (r->next == r->limit) return 0;
    r->cursor = r->next;
    r->end = feed ? feed : r->limit;
    r->next = feed ? feed + 1 : r->limit;
    r->line++;
    while (r->end > r->cursor && (colmap_is_blank(r->end[-1]) || r->end[-1] == '\r')) r->end--;
    while (r->cursor < r->end && colmap_is_blank(*r->cursor)) r->cursor++;
    return 1;
}

OXL_INTERNAL int colmap_next_record(struct colmap_reader *r)
{
    while (colmap_next_line(r))
        if (r->cursor < r->end && *r->cursor != '#') return 1;
    return 0;
}

/* Writes 'text', cut and printable, or "the end of the line". */
OXL_INTERNAL const char *colmap_printable(const char *p, const char *end, char out[64])
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

/* Returns 1 for a number with a decimal comma, such as 0,5. */
static int colmap_has_comma(const char *p, const char *end)
{
    for (p++; p + 1 < end && !colmap_is_blank(*p); p++)
        if (*p == ',' && p[-1] >= '0' && p[-1] <= '9' && p[1] >= '0' && p[1] <= '9') return 1;
    return 0;
}

OXL_INTERNAL oxl_result colmap_fail_token(struct colmap_reader *r, const char *token, const char *what,
                                          const char *kind)
{
    char buffer[64];
    const char *seen = colmap_printable(token, r->end, buffer);
    r->suppressed = 1;
    if (r->is_quiet) return OXL_ERR_INPUT;
    if (token < r->end && colmap_has_comma(token, r->end))
        return oxl_fail(
            r->ctx, OXL_ERR_INPUT,
            "%s:%d: found %s, a decimal comma, for %s; expected a decimal point\n"
            "fix: the export was made under a locale with decimal commas; make it again with LC_ALL=C in front: "
            "LC_ALL=C colmap model_converter --output_type TXT",
            r->path, r->line, seen, what);
    return oxl_fail(r->ctx, OXL_ERR_INPUT, "%s:%d: found %s, expected %s, %s\nfix: " COLMAP_FIX_EXPORT,
                    r->path, r->line, seen, what, kind);
}

OXL_INTERNAL void colmap_skip_blanks(struct colmap_reader *r)
{
    while (r->cursor < r->end && colmap_is_blank(*r->cursor)) r->cursor++;
}

OXL_INTERNAL int colmap_at_field_end(const struct colmap_reader *r)
{
    return r->cursor == r->end || colmap_is_blank(*r->cursor);
}

OXL_INTERNAL oxl_result colmap_real(struct colmap_reader *r, const char *what, double *out)
{
    const char *token;
    colmap_skip_blanks(r);
    token = r->cursor;
    if (parse_double(&r->cursor, r->end, out) && colmap_at_field_end(r)) return OXL_OK;
    return colmap_fail_token(r, token, what, "a number");
}

OXL_INTERNAL oxl_result colmap_finite(struct colmap_reader *r, const char *what, double *out)
{
    const char *token;
    oxl_result rc;
    colmap_skip_blanks(r);
    token = r->cursor;
    rc = colmap_real(r, what, out);
    return rc != OXL_OK || fabs(*out) <= DBL_MAX ? rc : colmap_fail_token(r, token, what, "a finite number");
}

OXL_INTERNAL oxl_result colmap_whole(struct colmap_reader *r, const char *what, int64_t low, int64_t high,
                                     int64_t *out)
{
    const char *token;
    char kind[80];
    colmap_skip_blanks(r);
    token = r->cursor;
    if (parse_int64(&r->cursor, r->end, out) && colmap_at_field_end(r) && *out >= low && *out <= high)
        return OXL_OK;
    if (low == INT64_MIN) snprintf(kind, sizeof kind, "an integer");
    else if (high == INT64_MAX) snprintf(kind, sizeof kind, "an integer of at least %" PRId64, low);
    else snprintf(kind, sizeof kind, "an integer from %" PRId64 " to %" PRId64, low, high);
    return colmap_fail_token(r, token, what, kind);
}

OXL_INTERNAL oxl_result colmap_id(struct colmap_reader *r, const char *what, int64_t *out)
{
    return colmap_whole(r, what, INT64_MIN, INT64_MAX, out);
}

OXL_INTERNAL oxl_result colmap_repeated(struct colmap_reader *r, const char *what, int64_t id)
{
    return oxl_fail(r->ctx, OXL_ERR_INPUT,
                    "%s:%d: %s %" PRId64 " was there before, expected each id once\nfix: " COLMAP_FIX_EXPORT,
                    r->path, r->line, what, id);
}

/* Inserts the last of `count` + 1 rows into the table of ids; a duplicate id is an error. */
static oxl_result colmap_index_insert(struct colmap_reader *r, struct colmap_index *x, const void *rows,
                                      size_t stride, size_t count, const char *what)
{
    const int64_t id = colmap_id_at(rows, stride, count);
    uint32_t *slot;
    oxl_result rc = OXL_OK;
    if (2 * (count + 1) > x->slots) rc = colmap_index_grow(r->ctx, x, rows, stride, count);
    if (rc != OXL_OK) return rc;
    slot = colmap_index_slot(x, rows, stride, id);
    if (*slot) return colmap_repeated(r, what, id);
    *slot = (uint32_t)count + 1;
    return OXL_OK;
}

OXL_INTERNAL oxl_result colmap_add_camera(struct colmap_reader *r, const struct colmap_camera *camera)
{
    struct colmap *out = r->out;
    oxl_result rc =
        oxl_reserve(r->ctx, &out->camera, &r->camera_capacity, out->camera_count + 1, sizeof *camera);
    if (rc != OXL_OK) return rc;
    out->camera[out->camera_count] = *camera;
    rc = colmap_index_insert(r, &r->cameras, out->camera, sizeof *camera, out->camera_count, "camera id");
    out->camera_count += rc == OXL_OK;
    return rc;
}

OXL_INTERNAL oxl_result colmap_add_image(struct colmap_reader *r, const struct colmap_image *image)
{
    struct colmap *out = r->out;
    oxl_result rc = oxl_reserve(r->ctx, &out->image, &r->image_capacity, out->image_count + 1, sizeof *image);
    if (rc != OXL_OK) return rc;
    out->image[out->image_count] = *image;
    rc = colmap_index_insert(r, &r->images, out->image, sizeof *image, out->image_count, "image id");
    out->image_count += rc == OXL_OK;
    return rc;
}

OXL_INTERNAL int colmap_check_point(struct colmap_reader *r, struct colmap_point *point)
{
    for (int i = 0; i < 3; i++)
        if (!(fabs(point->position[i]) <= DBL_MAX)) {
            colmap_warn(r, WARN_POSITION);
            return 0;
        }
    if (!(fabs(point->error) <= DBL_MAX)) {
        colmap_warn(r, WARN_ERROR);
        point->error = -1;
    }
    return 1;
}

/* ---------------- rotations, cameras and names, of text and binary files */

/* Describes the ids: "1-3" when there is no gap, else "3 from 1 to 17". */
static void colmap_camera_ids(const struct colmap *c, char *out, size_t size)
{
    int64_t low = c->camera[0].id, high = low;
    for (size_t i = 1; i < c->camera_count; i++) {
        low = OXL_MIN(low, c->camera[i].id);
        high = OXL_MAX(high, c->camera[i].id);
    }
    if (c->camera_count == 1) snprintf(out, size, "%" PRId64, low);
    else if ((uint64_t)high - (uint64_t)low == c->camera_count - 1)
        snprintf(out, size, "%" PRId64 "-%" PRId64, low, high);
    else snprintf(out, size, "%zu from %" PRId64 " to %" PRId64, c->camera_count, low, high);
}

OXL_INTERNAL int colmap_has_camera(const struct colmap_reader *r, int64_t id)
{
    return *colmap_index_slot(&r->cameras, r->out->camera, sizeof *r->out->camera, id) != 0;
}

OXL_INTERNAL oxl_result colmap_check_camera(struct colmap_reader *r, int64_t id)
{
    char ids[80];
    if (colmap_has_camera(r, id)) return OXL_OK;
    colmap_camera_ids(r->out, ids, sizeof ids);
    return oxl_fail(r->ctx, OXL_ERR_INPUT,
                    "%s:%d: camera id %" PRId64
                    " is not in %s (ids there: %s)\nfix: export all three files from the same COLMAP model",
                    r->path, r->line, id, r->out->camera->file, ids);
}

OXL_INTERNAL oxl_result colmap_check_rotation(struct colmap_reader *r, const double q[4])
{
    const double length = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    if (!(length >= 1e-6 && length <= 1e6))
        return oxl_fail(
            r->ctx, OXL_ERR_INPUT,
            "%s:%d: found the quaternion %g %g %g %g, expected a rotation (length 1)\nfix: take this image out of the "
            "model (colmap image_deleter) and export it again",
            r->path, r->line, q[0], q[1], q[2], q[3]);
    if (fabs(length - 1) > COLMAP_UNIT_ERROR) colmap_warn(r, WARN_QUATERNION);
    return OXL_OK;
}

OXL_INTERNAL oxl_result colmap_read_name(struct colmap_reader *r, size_t *name)
{
    struct colmap *out = r->out;
    size_t size;
    oxl_result rc;
    colmap_skip_blanks(r);
    /* Removes "./": without it the name is the same image's. */
    while (r->end - r->cursor > 2 && r->cursor[0] == '.' && r->cursor[1] == '/')
        for (r->cursor += 2; r->cursor < r->end && r->cursor[0] == '/';) r->cursor++;
    size = (size_t)(r->end - r->cursor);
    if (size == 0) return colmap_fail_token(r, r->cursor, "NAME", "a file in the image folder");
    if (!colmap_name_is_safe(r->cursor, r->end))
        return oxl_fail(r->ctx, OXL_ERR_INPUT,
                        "%s:%d: found the name '%.*s', expected a path inside the image folder\n"
                        "fix: give names relative to that folder, without \"..\"",
                        r->path, r->line, (int)OXL_MIN(size, (size_t)200), r->cursor);
    rc = oxl_reserve(r->ctx, &out->names, &r->names_capacity, out->names_size + size + 1, 1);
    if (rc != OXL_OK) return rc;
    *name = out->names_size;
    memcpy(out->names + *name, r->cursor, size);
    out->names[*name + size] = 0;
    out->names_size += size + 1;
    return OXL_OK;
}
