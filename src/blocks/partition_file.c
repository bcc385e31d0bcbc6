/* partition_file.c - partition.txt: the frame, then a line a block.
 *
 *     # comments
 *     FRAME DIMENSIONS R[9] ORIGIN[3] EXTENT[3] MEMORY
 *     BLOCK_ID LOW[3] HIGH[3] EXPANDED_LOW[3] EXPANDED_HIGH[3] POINTS BASE_VIEWS BORDER_VIEWS START_POINTS FINITE_LOW[3] FINITE_HIGH[3]
 *
 * Invariant: what is written reads back to the same bits (%.17g, inf); nothing in the file follows the locale.
 */
#include "blocks.h"

#include <inttypes.h>

enum { FILE_BLOCKS_MAX = 1 << 20 };

/* ---------------------------------------------------------------- writing */

static void file_put(FILE *file, const double *v, int count)
{
    for (int i = 0; i < count; i++) {
        char text[NUMBER_TEXT_MAX];
        format_double(text, v[i]);
        fprintf(file, " %s", text);
    }
}

static void file_put_block(FILE *file, int id, const struct partition_block *b)
{
    fprintf(file, "%d", id);
    file_put(file, b->box.low, 3);
    file_put(file, b->box.high, 3);
    file_put(file, b->expanded.low, 3);
    file_put(file, b->expanded.high, 3);
    fprintf(file, " %zu %d %d %zu", b->points, b->base_views, b->border_views, b->start_points);
    file_put(file, b->finite.low, 3);
    file_put(file, b->finite.high, 3);
    putc('\n', file);
}

OXL_INTERNAL oxl_result partition_write(oxl_context *ctx, const char *path, const struct partition *p)
{
    struct os_writer writer;
    oxl_result       rc = os_writer_open(ctx, path, &writer);
    if (rc != OXL_OK) return rc;
    fprintf(writer.file,
            "# The survey in blocks, cut along its principal axes (OceanXL, Balanced Scene Partitioning).\n"
            "# A place in the frame is R (world - origin); a block holds low <= place < high, and every place has one block.\n"
            "# FRAME DIMENSIONS R[9] row by row, ORIGIN[3] in the world, EXTENT[3] along the principal axes, "
            "MEMORY in bytes that blocks fit, 0: any\n"
            "# BLOCK_ID LOW[3] HIGH[3] EXPANDED_LOW[3] EXPANDED_HIGH[3] POINTS BASE_VIEWS BORDER_VIEWS START_POINTS "
            "FINITE_LOW[3] FINITE_HIGH[3]\n");
    fprintf(writer.file, "# Number of blocks: %d\nFRAME %d", p->block_count, p->dimensions);
    file_put(writer.file, p->rotation, 9);
    file_put(writer.file, p->origin, 3);
    file_put(writer.file, p->extent, 3);
    file_put(writer.file, &p->memory, 1);
    putc('\n', writer.file);
    for (int i = 0; i < p->block_count; i++) file_put_block(writer.file, i, &p->block[i]);
    return os_writer_close(ctx, &writer, OXL_OK);
}

/* ---------------------------------------------------------------- reading */

struct file_reader {
    oxl_context *ctx;
    const char  *path, *cursor, *end, *next; /* of the line; the first byte after it */
    int          line;
    size_t       capacity;
};

static int file_next_line(struct file_reader *r, const char *file_end)
{
    do {
        const char *feed;
        if (r->next == file_end) return 0;
        feed      = memchr(r->next, '\n', (size_t)(file_end - r->next));
        r->cursor = r->next;
        r->end    = feed ? feed : file_end;
        r->next   = feed ? feed + 1 : file_end;
        r->line++;
        while (r->end > r->cursor && (r->end[-1] == '\r' || r->end[-1] == ' ')) r->end--;
    } while (r->cursor == r->end || *r->cursor == '#');
    return 1;
}

static oxl_result file_wrong(struct file_reader *r, const char *wanted)
{
    const int seen = (int)OXL_MIN(r->end - r->cursor, 24);
    return oxl_fail(r->ctx, OXL_ERR_INPUT, "%s:%d: seen '%.*s', wanted %s\nfix: write it again: oceanxl partition SCENE -o OUT",
                    r->path, r->line, seen, r->cursor, wanted);
}

static oxl_result file_get(struct file_reader *r, double *out, int count)
{
    for (int i = 0; i < count; i++) {
        while (r->cursor < r->end && *r->cursor == ' ') r->cursor++;
        if (!parse_double(&r->cursor, r->end, &out[i]) || isnan(out[i])) return file_wrong(r, "a number");
    }
    return OXL_OK;
}

static oxl_result file_get_count(struct file_reader *r, int64_t most, int64_t *out)
{
    while (r->cursor < r->end && *r->cursor == ' ') r->cursor++;
    if (!parse_int64(&r->cursor, r->end, out) || *out < 0 || *out > most) return file_wrong(r, "a count");
    return OXL_OK;
}

static oxl_result file_read_frame(struct file_reader *r, struct partition *p)
{
    static const char word[]     = "FRAME";
    int64_t           dimensions = 0;
    oxl_result        rc;
    if (r->end - r->cursor < (ptrdiff_t)sizeof word || memcmp(r->cursor, word, sizeof word - 1) != 0)
        return file_wrong(r, "FRAME");
    r->cursor += sizeof word - 1;
    rc            = file_get_count(r, 3, &dimensions);
    p->dimensions = (int)dimensions;
    if (rc == OXL_OK) rc = file_get(r, p->rotation, 9);
    if (rc == OXL_OK) rc = file_get(r, p->origin, 3);
    if (rc == OXL_OK) rc = file_get(r, p->extent, 3);
    if (rc == OXL_OK && r->cursor < r->end) rc = file_get(r, &p->memory, 1);
    return rc;
}

static oxl_result file_read_block(struct file_reader *r, struct partition *p)
{
    struct partition_block b  = {.points = 0};
    int64_t                id = 0, points = 0, base = 0, border = 0, start = 0;
    oxl_result             rc = file_get_count(r, FILE_BLOCKS_MAX, &id);
    if (rc == OXL_OK && id != p->block_count) rc = file_wrong(r, "the blocks in order, from 0");
    if (rc == OXL_OK) rc = file_get(r, b.box.low, 3);
    if (rc == OXL_OK) rc = file_get(r, b.box.high, 3);
    if (rc == OXL_OK) rc = file_get(r, b.expanded.low, 3);
    if (rc == OXL_OK) rc = file_get(r, b.expanded.high, 3);
    if (rc == OXL_OK) rc = file_get_count(r, INT64_MAX, &points);
    if (rc == OXL_OK) rc = file_get_count(r, INT_MAX, &base);
    if (rc == OXL_OK) rc = file_get_count(r, INT_MAX, &border);
    if (rc == OXL_OK) rc = file_get_count(r, INT64_MAX, &start);
    if (rc == OXL_OK) rc = file_get(r, b.finite.low, 3);
    if (rc == OXL_OK) rc = file_get(r, b.finite.high, 3);
    if (rc == OXL_OK && r->cursor != r->end) rc = file_wrong(r, "the end of the line");
    if (rc == OXL_OK) rc = oxl_reserve(r->ctx, &p->block, &r->capacity, (size_t)p->block_count + 1, sizeof *p->block);
    if (rc != OXL_OK) return rc;
    b.points                   = (size_t)points;
    b.start_points             = (size_t)start;
    b.base_views               = (int)base;
    b.border_views             = (int)border;
    p->block[p->block_count++] = b;
    return OXL_OK;
}

OXL_INTERNAL oxl_result partition_read(oxl_context *ctx, const char *path, struct partition *out)
{
    struct file_reader r    = {.ctx = ctx, .path = path};
    struct os_file_map file = {0};
    oxl_result         rc   = os_read_file(ctx, path, &file);
    *out                    = (struct partition){0};
    if (rc != OXL_OK) return rc;
    r.cursor = r.end = r.next = file.data;
    if (file_next_line(&r, file.data + file.size)) rc = file_read_frame(&r, out);
    while (rc == OXL_OK && file_next_line(&r, file.data + file.size)) rc = file_read_block(&r, out);
    if (rc == OXL_OK && out->block_count == 0) rc = file_wrong(&r, "FRAME and a block or more");
    os_release_file(ctx, &file);
    if (rc != OXL_OK) partition_free(ctx, out);
    return rc;
}
