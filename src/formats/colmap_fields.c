/* colmap_fields.c - reads fields of COLMAP's files, text or binary: a buffer that moves over the file, its
 * lines or records, their fields, and error messages.
 *
 * Only the buffer is in memory, so a file of several gigabytes needs no more than its parsed rows.
 *
 * Invariant: a message names file:line, or the byte and record, the value found, the value expected, and a
 * fix.
 */
#include "colmap.h"
#include "../core/bytes.h"

enum {
    COLMAP_LOGGED_MAX = 3, /* messages of one kind per file */
    COLMAP_NAME_LONGEST = 4096
};

static int colmap_is_binary(const struct colmap_reader *r)
{
    return r->out->format == COLMAP_BINARY;
}

/* ---------------- the buffer */

/* Keeps the bytes from `next` on, and reads as many as fit behind them. Widens a buffer that is full of
 * them. */
static int colmap_fill(struct colmap_reader *r)
{
    const size_t rest = (size_t)(r->limit - r->next);
    size_t got = 0, room = (size_t)OXL_MIN(r->file.size, (uint64_t)r->buffer_size) + 1;
    if (r->rc == OXL_OK) r->rc = context_stopped(r->ctx);
    if (r->rc != OXL_OK) return 0;
    if (rest) memmove(r->buffer, r->next, rest);
    r->offset += (uint64_t)(r->next - r->buffer);
    room = OXL_MAX(room, rest == r->room ? 2 * rest : 0);
    if (room > r->room) {
        char *buffer = oxl_regrow(r->ctx, r->buffer, rest, room, 1);
        if (!buffer) return r->rc = OXL_ERR_MEMORY, 0;
        r->buffer = buffer;
        r->room = room;
    }
    r->rc = os_reader_read(r->ctx, &r->file, r->buffer + rest, r->room - rest, &got);
    r->at_end = got < r->room - rest;
    r->next = r->buffer;
    r->limit = r->buffer + rest + got;
    return r->rc == OXL_OK;
}

/* Returns the position in the file of a byte of the buffer. */
static uint64_t colmap_offset(const struct colmap_reader *r, const char *at)
{
    return r->offset + (uint64_t)(at - r->buffer);
}

static uint64_t colmap_left(const struct colmap_reader *r)
{
    const uint64_t at = colmap_offset(r, r->next);
    return r->file.size > at ? r->file.size - at : 0;
}

OXL_INTERNAL void colmap_open(struct colmap_reader *r, const char *folder, const char *name)
{
    size_t size;
    path_in(r->path, folder, "%s", name);
    r->file = (struct os_reader){0};
    r->offset = r->announced = r->rows = 0;
    r->line = r->at_end = 0;
    r->field = r->next = r->limit = r->buffer;
    if (r->rc == OXL_OK) r->rc = os_reader_open(r->ctx, r->path, &r->file);
    if (r->rc == OXL_OK) colmap_fill(r);
    size = (size_t)(r->limit - r->next);
    if (r->rc == OXL_OK) r->rc = os_refuse_gzip(r->ctx, r->path, r->buffer, size);
    if (colmap_is_binary(r)) r->announced = colmap_count(r, "the number of rows", 1);
    else if (size >= 2 && (!memcmp(r->next, "\xFF\xFE", 2) || !memcmp(r->next, "\xFE\xFF", 2)))
        colmap_fail(r, "save it as UTF-8", "found text in UTF-16, expected ASCII or UTF-8");
    else if (size >= 3 && !memcmp(r->next, "\xEF\xBB\xBF", 3)) r->next += 3; /* a byte order mark */
}

static const char *const colmap_warning_text[WARN_COUNT] = {
    "the image before has no line of 2D points; it is taken as empty",
    "the length of a quaternion is not 1; it is normalised",
    "a point has no finite position; it is left out",
    "a reprojection error is not a finite number; it is taken as unknown",
    "a track names an image that is not there; that entry is left out",
};

OXL_INTERNAL void colmap_warn(struct colmap_reader *r, enum colmap_warning kind)
{
    if (r->rc != OXL_OK) return;
    if (r->warned[kind]++ < COLMAP_LOGGED_MAX)
        oxl_log(r->ctx, OXL_LOG_WARNING, "%s:%d: %s", r->path, r->line, colmap_warning_text[kind]);
}

OXL_INTERNAL void colmap_close(struct colmap_reader *r, const char *rows)
{
    for (int i = 0; i < WARN_COUNT; i++) {
        if (r->warned[i] > COLMAP_LOGGED_MAX)
            oxl_log(r->ctx, OXL_LOG_WARNING, "%s: %zu more cases: %s", r->path,
                    r->warned[i] - COLMAP_LOGGED_MAX, colmap_warning_text[i]);
        r->out->warnings += r->warned[i];
        r->warned[i] = 0;
    }
    if (r->rc == OXL_OK && r->rows < r->announced) {
        oxl_log(r->ctx, OXL_LOG_WARNING,
                "%s: its header announces %" PRIu64 " %s, and %" PRIu64
                " are there: the file is truncated or was edited\nfix: " COLMAP_FIX_EXPORT,
                r->path, r->announced, rows, r->rows);
        r->out->is_truncated = 1;
        r->out->warnings++;
    }
    if (r->rc == OXL_OK && colmap_is_binary(r) && colmap_left(r)) {
        oxl_log(r->ctx, OXL_LOG_WARNING, "%s: %" PRIu64 " bytes follow its last record; they are not read",
                r->path, colmap_left(r));
        r->out->warnings++;
    }
    os_reader_close(&r->file);
}

/* ---------------- messages */

OXL_INTERNAL oxl_result colmap_fail(struct colmap_reader *r, const char *fix, const char *format, ...)
{
    char text[700], place[64];
    va_list args;
    if (r->rc != OXL_OK) return r->rc;
    va_start(args, format);
    vsnprintf(text, sizeof text, format, args);
    va_end(args);
    if (colmap_is_binary(r))
        snprintf(place, sizeof place, ": byte %" PRIu64 ", record %d", colmap_offset(r, r->field), r->line);
    else snprintf(place, sizeof place, r->out->format == COLMAP_TEXT ? ":%d" : ": record %d", r->line);
    return r->rc = oxl_fail(r->ctx, OXL_ERR_INPUT, "%s%s: %s\nfix: %s", r->path,
                            r->line || colmap_is_binary(r) ? place : "", text, fix);
}

/* Writes 'text', cut and printable, or "the end of the line". */
OXL_INTERNAL const char *colmap_printable(const struct colmap_reader *r, char out[64])
{
    const char *p = r->field;
    size_t size = 0;
    if (p == r->end) return "the end of the line";
    out[size++] = '\'';
    for (; p < r->end && !colmap_is_blank(*p) && size < 48; p++)
        out[size++] = (unsigned char)*p < 0x20 || *p == 0x7f ? '?' : *p;
    snprintf(out + size, 64 - size, "%s'", p < r->end && !colmap_is_blank(*p) ? "..." : "");
    return out;
}

OXL_INTERNAL void colmap_fail_field(struct colmap_reader *r, const char *what, const char *kind, double value)
{
    char seen[64];
    if (colmap_is_binary(r))
        colmap_fail(r, COLMAP_FIX_BINARY, "found %g, expected %s, %s", value, what, kind);
    else
        colmap_fail(r, COLMAP_FIX_EXPORT, "found %s, expected %s, %s", colmap_printable(r, seen), what, kind);
}

/* ---------------- lines and records */

OXL_INTERNAL int colmap_is_blank(char c)
{
    return c == ' ' || c == '\t';
}

static void colmap_skip_blanks(struct colmap_reader *r)
{
    while (r->cursor < r->end && colmap_is_blank(*r->cursor)) r->cursor++;
}

OXL_INTERNAL int colmap_next_line(struct colmap_reader *r)
{
    const char *feed = NULL;
    if (r->rc != OXL_OK) return 0;
    while ((r->next == r->limit || !(feed = memchr(r->next, '\n', (size_t)(r->limit - r->next)))) &&
           !r->at_end)
        if (!colmap_fill(r)) return 0;
    if (r->next == r->limit) return 0;
    r->cursor = r->next;
    r->end = feed ? feed : r->limit;
    r->next = feed ? feed + 1 : r->limit;
    r->line++;
    while (r->end > r->cursor && (colmap_is_blank(r->end[-1]) || r->end[-1] == '\r')) r->end--;
    colmap_skip_blanks(r);
    return 1;
}

/* Reads N of "# Number of images: N, ...". */
static void colmap_read_comment(struct colmap_reader *r)
{
    static const char words[] = "# Number of ";
    const size_t size = (size_t)(r->end - r->cursor);
    int64_t number = 0;
    if (size < sizeof words || memcmp(r->cursor, words, sizeof words - 1) != 0) return;
    r->cursor = memchr(r->cursor, ':', size);
    if (!r->cursor) return;
    r->cursor++;
    colmap_skip_blanks(r);
    if (parse_int64(&r->cursor, r->end, &number) && number > 0) r->announced = (uint64_t)number;
}

OXL_INTERNAL int colmap_next_record(struct colmap_reader *r)
{
    if (r->rc != OXL_OK || (colmap_is_binary(r) && r->rows == r->announced)) return 0;
    r->rows++;
    if (colmap_is_binary(r)) return ++r->line;
    while (colmap_next_line(r)) {
        if (r->cursor < r->end && *r->cursor != '#') return 1;
        colmap_read_comment(r);
    }
    r->rows--;
    return 0;
}

/* ---------------- fields */

OXL_INTERNAL int colmap_at_field_end(const struct colmap_reader *r)
{
    return r->cursor == r->end || colmap_is_blank(*r->cursor);
}

OXL_INTERNAL int colmap_field(struct colmap_reader *r, const char *what, size_t size)
{
    if (r->rc != OXL_OK) return 0;
    if (!colmap_is_binary(r)) {
        colmap_skip_blanks(r);
        r->field = r->cursor;
        return 1;
    }
    while ((size_t)(r->limit - r->next) < size && !r->at_end)
        if (!colmap_fill(r)) return 0;
    r->field = r->next;
    r->next += OXL_MIN(size, (size_t)(r->limit - r->next));
    if ((size_t)(r->next - r->field) == size) return 1;
    r->field = r->limit;
    colmap_fail(r, COLMAP_FIX_BINARY, "found the end of the file, expected %s", what);
    return 0;
}

OXL_INTERNAL int colmap_has_more(struct colmap_reader *r)
{
    return r->out->format == COLMAP_TEXT && colmap_field(r, "", 0) && r->cursor < r->end;
}

OXL_INTERNAL double colmap_real(struct colmap_reader *r, const char *what)
{
    double value = 0;
    if (!colmap_field(r, what, 8)) return 0;
    if (colmap_is_binary(r)) return bytes_double(r->field);
    if (!parse_double(&r->cursor, r->end, &value) || !colmap_at_field_end(r))
        colmap_fail_field(r, what, "a number", 0);
    return value;
}

OXL_INTERNAL double colmap_finite(struct colmap_reader *r, const char *what)
{
    const double value = colmap_real(r, what);
    if (!(fabs(value) <= DBL_MAX)) colmap_fail_field(r, what, "a finite number", value);
    return value;
}

OXL_INTERNAL int64_t colmap_whole(struct colmap_reader *r, const char *what, size_t size, int64_t low,
                                  int64_t high)
{
    int64_t value = 0;
    char kind[80] = "an integer";
    int is_whole = 1;
    if (!colmap_field(r, what, size)) return 0;
    if (colmap_is_binary(r)) value = (int64_t)bytes_get(r->field, (int)size);
    else is_whole = parse_int64(&r->cursor, r->end, &value) && colmap_at_field_end(r);
    if (is_whole && value >= low && value <= high) return value;
    if (low > INT64_MIN) snprintf(kind, sizeof kind, "an integer from %" PRId64 " to %" PRId64, low, high);
    colmap_fail_field(r, what, kind, (double)(uint64_t)value);
    return 0;
}

/* COLMAP's mark of no point, 2^64 - 1, becomes -1; other ids from 2^63 on do not fit. */
OXL_INTERNAL int64_t colmap_id(struct colmap_reader *r, const char *what, size_t size)
{
    return colmap_whole(r, what, size, colmap_is_binary(r) ? -1 : INT64_MIN, INT64_MAX);
}

OXL_INTERNAL uint64_t colmap_count(struct colmap_reader *r, const char *what, size_t least)
{
    const uint64_t count = colmap_field(r, what, 8) ? bytes_get(r->field, 8) : 0, left = colmap_left(r);
    if (count <= left / least) return count;
    colmap_fail(r, COLMAP_FIX_BINARY,
                "found the number %" PRIu64 " where %" PRIu64 " bytes follow, expected %s", count, left,
                what);
    return 0;
}

OXL_INTERNAL void colmap_skip(struct colmap_reader *r, uint64_t size)
{
    const uint64_t to = colmap_offset(r, r->next) + size;
    if (size <= (uint64_t)(r->limit - r->next)) {
        r->next += size;
        return;
    }
    if (r->rc == OXL_OK) r->rc = os_reader_seek(r->ctx, &r->file, to);
    r->offset = to;
    r->next = r->limit = r->buffer;
    r->at_end = 0;
}

/* Finds a name without blanks at its ends, as in text; a newline in it is an error. */
OXL_INTERNAL void colmap_begin_name(struct colmap_reader *r)
{
    const char *zero = NULL;
    if (!colmap_field(r, "NAME", 0) || !colmap_is_binary(r)) return;
    while ((r->next == r->limit || !(zero = memchr(r->next, 0, (size_t)(r->limit - r->next)))) &&
           !r->at_end && r->limit - r->next <= COLMAP_NAME_LONGEST)
        if (!colmap_fill(r)) return;
    r->field = r->cursor = r->next;
    r->end = zero && zero - r->next <= COLMAP_NAME_LONGEST ? zero : r->next;
    if (r->end == zero) r->next = zero + 1;
    else colmap_fail(r, COLMAP_FIX_BINARY, "found no zero byte, expected a name that ends in one");
    colmap_skip_blanks(r);
    while (r->end > r->cursor && colmap_is_blank(r->end[-1])) r->end--;
}

OXL_INTERNAL void colmap_check_rotation(struct colmap_reader *r, const double q[4])
{
    const double length = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    if (!(length >= 1e-6 && length <= 1e6))
        colmap_fail(r, "take this image out of the model (colmap image_deleter) and export it again",
                    "found the quaternion %g %g %g %g, expected a rotation (length 1)", q[0], q[1], q[2],
                    q[3]);
    if (fabs(length - 1) > COLMAP_UNIT_ERROR) colmap_warn(r, WARN_QUATERNION);
}

OXL_INTERNAL size_t colmap_safe_name(const char *name, size_t length, char *out)
{
    size_t size = 0;
    for (size_t at = 0, part; at < length; at += part + 1) {
        const char *from = name + at;
        for (part = 0; at + part < length && from[part] && from[part] != '/' && from[part] != '\\';) part++;
        if (part == 0 || (from[0] == '.' && (part == 1 || (part == 2 && from[1] == '.')))) continue;
        if (size) out[size++] = '/';
        memmove(out + size, from, part);
        size += part == 2 && from[1] == ':' ? 1 : part; /* a drive */
    }
    return size;
}

OXL_INTERNAL void colmap_read_name(struct colmap_reader *r, size_t *name)
{
    struct colmap *out = r->out;
    size_t size;
    if (r->rc != OXL_OK) return;
    colmap_skip_blanks(r);
    size = (size_t)(r->end - r->cursor);
    r->field = r->cursor;
    if (memchr(r->cursor, '\n', size) || memchr(r->cursor, '\r', size))
        colmap_fail(r, COLMAP_FIX_EXPORT, "found a line end in a name, expected a name of one line");
    if (r->rc == OXL_OK)
        r->rc = oxl_reserve(r->ctx, &out->names, &r->names_capacity, out->names_size + size + 1, 1);
    if (r->rc != OXL_OK) return;
    *name = out->names_size;
    size = colmap_safe_name(r->cursor, size, out->names + *name);
    if (size == 0)
        colmap_fail(r, COLMAP_FIX_EXPORT,
                    "found the end of the line, expected NAME, a file in the image folder");
    out->names[*name + size] = 0;
    out->names_size += size + 1;
}
