/* colmap_points.c - reads points3D.txt, the largest file, by several threads.
 *
 *     POINT3D_ID X Y Z R G B ERROR (IMAGE_ID POINT2D_IDX)*
 *
 * The buffer is divided at line ends into a fixed number of pieces, which are parsed in parallel, each into
 * its own rows, without messages or allocation. A piece with an error or a warning stops. Then, in file
 * order, stopped pieces are parsed again by one thread with messages, and all rows are joined.
 *
 * Invariant: rows, messages and their line numbers do not depend on threads, pieces or the size of the
 * buffer.
 */
#include "colmap.h"
#include "survey_read.h"

enum {
    POINTS_PIECES = 16,
    POINTS_TEXT_MIN = 16, /* bytes of the shortest point, "0 0 0 0 0 0 0 0\n" */
    POINTS_TRACK_MIN = 4  /* bytes of the shortest entry of a track, "0 0 " */
};

struct points_piece {
    struct colmap_reader reader; /* a copy with the same tables of ids and its own lines */
    oxl_result rc;
    struct colmap_point *point; /* (points) first_track counts from the piece's first */
    struct colmap_track *track; /* (tracks) */
    size_t points, tracks;
    size_t point_row, track_row; /* destination in colmap */
};

struct points_rows { /* capacity for a full buffer, divided into pieces */
    struct colmap_point *point;
    struct colmap_track *track;
    size_t point_capacity, track_capacity;
};

/* ---------------- a line */

/* Parses an integer of at most 9 digits without a check of overflow, which is fast. Returns 0 and leaves the
 * cursor for any other field. */
static inline int points_short_integer(const char **cursor, const char *end, uint32_t *out)
{
    const char *p = *cursor, *first;
    uint32_t value = 0, digit;
    while (p < end && colmap_is_blank(*p)) p++;
    for (first = p; p < end && (digit = (uint32_t)(unsigned char)*p - '0') < 10; p++)
        value = 10 * value + digit;
    if (p == first || p - first > 9 || (p < end && !colmap_is_blank(*p))) return 0;
    *out = value;
    *cursor = p;
    return 1;
}

/* Takes the fast way for two short integers; otherwise the slow one, which gives the message. */
static oxl_result points_read_track_entry(struct colmap_reader *r, int64_t *image, uint32_t *observation)
{
    const char *p = r->cursor;
    uint32_t plain;
    int64_t index = 0;
    oxl_result rc;
    if (points_short_integer(&p, r->end, &plain) && points_short_integer(&p, r->end, observation)) {
        *image = plain;
        r->cursor = p;
        return OXL_OK;
    }
    rc = colmap_id(r, "IMAGE_ID of a track (IMAGE_ID POINT2D_IDX)", image);
    if (rc == OXL_OK)
        rc = colmap_whole(r, "POINT2D_IDX of a track (IMAGE_ID POINT2D_IDX)", 0, UINT32_MAX, &index);
    *observation = (uint32_t)index;
    return rc;
}

static oxl_result points_read_track(struct colmap_reader *r, struct points_piece *to,
                                    struct colmap_point *point)
{
    oxl_result rc = OXL_OK;
    while (rc == OXL_OK && r->cursor < r->end) {
        int64_t image = 0;
        uint32_t observation, slot;
        rc = points_read_track_entry(r, &image, &observation);
        if (rc != OXL_OK) break;
        slot = *colmap_index_slot(&r->images, r->out->image, sizeof *r->out->image, image);
        if (slot == 0) {
            colmap_warn(r, WARN_TRACK);
            continue;
        }
        to->track[to->tracks + point->track_count++] = (struct colmap_track){slot - 1, observation};
    }
    return rc;
}

static oxl_result points_read_fields(struct colmap_reader *r, struct colmap_point *point)
{
    static const char *const axis[3] = {"X", "Y", "Z"}, *const channel[3] = {"R", "G", "B"};
    int64_t rgb[3] = {0};
    oxl_result rc = colmap_id(r, "POINT3D_ID", &point->id);
    for (int i = 0; i < 3 && rc == OXL_OK; i++) rc = colmap_real(r, axis[i], &point->position[i]);
    for (int i = 0; i < 3 && rc == OXL_OK; i++) rc = colmap_whole(r, channel[i], 0, 255, &rgb[i]);
    if (rc == OXL_OK) rc = colmap_real(r, "ERROR", &point->error);
    for (int i = 0; i < 3; i++) point->rgb[i] = (uint8_t)rgb[i];
    return rc;
}

/* Adds a point, or none if its position is not finite. */
static oxl_result points_read_record(struct colmap_reader *r, struct points_piece *to)
{
    struct colmap_point point = {.first_track = to->tracks};
    oxl_result rc = points_read_fields(r, &point);
    if (rc != OXL_OK) return rc;
    if (!colmap_check_point(r, &point)) return OXL_OK;
    rc = points_read_track(r, to, &point);
    if (rc != OXL_OK) return rc;
    to->point[to->points++] = point;
    to->tracks += point.track_count;
    return OXL_OK;
}

/* ---------------- the pieces of a buffer */

/* Parses the points of a piece. `lines`: number of lines before it, for messages. */
static void points_read_piece(struct points_piece *p, const char *begin, int is_quiet, int lines)
{
    p->reader.next = begin;
    p->reader.line = lines;
    p->reader.is_quiet = is_quiet;
    p->reader.suppressed = 0;
    p->rc = OXL_OK;
    p->points = p->tracks = 0;
    while (p->rc == OXL_OK && !(is_quiet && p->reader.suppressed) && colmap_next_record(&p->reader))
        p->rc = points_read_record(&p->reader, p);
}

/* Returns the position after the last newline before `to`, or `from` if there is none. */
static const char *points_line_begin(const char *from, const char *to)
{
    while (to > from && to[-1] != '\n') to--;
    return to;
}

/* Divides the buffer into pieces of whole lines; the last line may have no newline.
 * begin: (POINTS_PIECES + 1). */
static void points_divide_buffer(const struct colmap_reader *r, const char **begin)
{
    const char *end = r->at_end ? r->limit : points_line_begin(r->next, r->limit);
    const size_t size = (size_t)(end - r->next);
    begin[0] = r->next;
    for (size_t i = 1; i < POINTS_PIECES; i++)
        begin[i] = points_line_begin(begin[i - 1], r->next + size / POINTS_PIECES * i);
    begin[POINTS_PIECES] = end;
}

static oxl_result points_reserve_rows(struct colmap_reader *r, struct points_rows *rows)
{
    const size_t size = (size_t)(r->limit - r->buffer);
    oxl_result rc = oxl_reserve(r->ctx, &rows->point, &rows->point_capacity,
                                size / POINTS_TEXT_MIN + POINTS_PIECES, sizeof *rows->point);
    if (rc == OXL_OK)
        rc = oxl_reserve(r->ctx, &rows->track, &rows->track_capacity, size / POINTS_TRACK_MIN + POINTS_PIECES,
                         sizeof *rows->track);
    return rc;
}

/* Parses the pieces in parallel. A piece's rows begin where its bytes do, in rows of the shortest lines, so
 * that no piece reaches another's. */
static void points_read_pieces(struct colmap_reader *r, const struct points_rows *rows,
                               const char *const *begin, struct points_piece *piece)
{
#pragma omp parallel for schedule(dynamic) num_threads(r->ctx->threads)
    for (int i = 0; i < POINTS_PIECES; i++) {
        const size_t at = (size_t)(begin[i] - r->buffer);
        piece[i].reader = *r;
        piece[i].reader.limit = begin[i + 1];
        piece[i].reader.at_end = 1;
        piece[i].point = rows->point + at / POINTS_TEXT_MIN + i;
        piece[i].track = rows->track + at / POINTS_TRACK_MIN + i;
        points_read_piece(&piece[i], begin[i], 1, 0);
    }
}

/* Parses stopped pieces again with messages, and assigns the destination of each piece's rows. */
static oxl_result points_report(struct colmap_reader *r, const char *const *begin, struct points_piece *piece)
{
    struct colmap *out = r->out;
    for (int i = 0; i < POINTS_PIECES; i++) {
        struct points_piece *p = &piece[i];
        if (p->reader.suppressed) {
            memcpy(p->reader.warned, r->warned, sizeof r->warned);
            points_read_piece(p, begin[i], 0, r->line);
            memcpy(r->warned, p->reader.warned, sizeof r->warned);
            p->reader.line -= r->line;
        }
        if (p->rc != OXL_OK) return p->rc;
        r->line += p->reader.line;
        p->point_row = out->point_count;
        p->track_row = out->track_count;
        out->point_count += p->points;
        out->track_count += p->tracks;
    }
    return OXL_OK;
}

/* Estimates the number of points from the first buffer, so that arrays need not grow. */
static size_t points_expected(const struct colmap_reader *r, size_t so_far)
{
    const double read = (double)(r->next - r->buffer),
                 expected = 1.05 * (double)so_far * ((double)r->file.size / read);
    return r->offset == 0 && read > 0 && expected > (double)so_far ? (size_t)expected : so_far;
}

/* Copies the pieces' rows to their destinations in parallel. */
static oxl_result points_join(struct colmap_reader *r, const struct points_piece *piece)
{
    struct colmap *out = r->out;
    oxl_result rc = oxl_reserve(r->ctx, &out->point, &r->point_capacity, points_expected(r, out->point_count),
                                sizeof *out->point);
    if (rc == OXL_OK)
        rc = oxl_reserve(r->ctx, &out->track, &r->track_capacity, points_expected(r, out->track_count),
                         sizeof *out->track);
    if (rc != OXL_OK) return rc;
#pragma omp parallel for schedule(dynamic) num_threads(r->ctx->threads)
    for (int i = 0; i < POINTS_PIECES; i++) {
        const struct points_piece *p = &piece[i];
        for (size_t k = 0; k < p->points; k++) {
            out->point[p->point_row + k] = p->point[k];
            out->point[p->point_row + k].first_track += p->track_row;
        }
        if (p->tracks) memcpy(out->track + p->track_row, p->track, p->tracks * sizeof *p->track);
    }
    return OXL_OK;
}

static oxl_result points_read_buffer(struct colmap_reader *r, struct points_rows *rows)
{
    struct points_piece piece[POINTS_PIECES];
    const char *begin[POINTS_PIECES + 1];
    oxl_result rc = points_reserve_rows(r, rows);
    if (rc != OXL_OK) return rc;
    points_divide_buffer(r, begin);
    points_read_pieces(r, rows, begin, piece);
    rc = points_report(r, begin, piece);
    r->next = begin[POINTS_PIECES];
    return rc == OXL_OK ? points_join(r, piece) : rc;
}

/* ---------------- the file */

/* Reads the file again up to the second point of this id, to name its line. */
static oxl_result points_repeated(struct colmap_reader *r, const struct points_rows *rows, int64_t id)
{
    struct points_piece one = {.point = rows->point, .track = rows->track};
    oxl_result rc = os_reader_seek(r->ctx, &r->file, 0);
    size_t seen = 0;
    if (rc == OXL_OK) rc = colmap_begin(r);
    r->is_quiet = 1;
    while (rc == OXL_OK && seen < 2 && colmap_next_record(r)) {
        one.points = one.tracks = 0;
        rc = points_read_record(r, &one);
        if (one.points && one.point->id == id) seen++;
    }
    r->is_quiet = 0;
    if (rc == OXL_OK) rc = r->rc;
    return rc != OXL_OK ? rc : colmap_repeated(r, "point id", id);
}

OXL_INTERNAL oxl_result colmap_read_points(struct colmap_reader *r)
{
    struct points_rows rows = {0};
    int64_t id = 0;
    oxl_result rc = points_read_buffer(r, &rows);
    while (rc == OXL_OK && !r->at_end) {
        rc = colmap_fill(r);
        if (rc == OXL_OK) rc = points_read_buffer(r, &rows);
    }
    if (rc == OXL_OK && (rc = colmap_order_points(r->ctx, r->out, &id)) == OXL_ERR_INPUT)
        rc = points_repeated(r, &rows, id);
    OXL_FREE(r->ctx, rows.point, rows.track);
    return rc;
}
