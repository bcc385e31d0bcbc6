/* partition_file.c - writes and reads partition.txt: the frame, then one line per block.
 *
 *     # comments
 *     FRAME DIMENSIONS R[9] ORIGIN[3] EXTENT[3] MEMORY
 *     BLOCK_ID LOW[3] HIGH[3] EXPANDED_LOW[3] EXPANDED_HIGH[3] POINTS BASE_VIEWS BORDER_VIEWS START_POINTS
 *     FINITE_LOW[3] FINITE_HIGH[3]
 *
 * Invariant: values are read back to the same bits (%.17g, inf); the locale has no effect.
 */
#include "large.h"

enum {                 /* Lists places in the numbers of a line. */
       FRAME_AXES = 1, /* R, after DIMENSIONS */
       FRAME_ORIGIN = 10,
       FRAME_EXTENT = 13,
       FRAME_MEMORY = 16,
       FRAME_NUMBERS = 17,
       FILE_BOX = 1,     /* LOW, after BLOCK_ID; the expanded box follows */
       FILE_COUNTS = 13, /* POINTS to START_POINTS */
       FILE_FINITE = 17,
       FILE_NUMBERS = 23
};

/* ---------------- writing */

static void file_put(struct text *t, const double *v, int count)
{
    for (int i = 0; i < count; i++) {
        char text[NUMBER_TEXT_MAX];
        format_double(text, v[i]);
        text_add(t, "%s%s", text, i < count - 1 ? " " : "\n");
    }
}

static void file_put_block(struct text *t, int id, const struct partition_block *b)
{
    const struct partition_box boxes[2] = {b->box, b->expanded};
    const double counts[4] = {(double)b->points, b->base_views, b->border_views, (double)b->start_points};
    double v[FILE_NUMBERS] = {id};
    memcpy(v + FILE_BOX, boxes, sizeof boxes);
    memcpy(v + FILE_COUNTS, counts, sizeof counts);
    memcpy(v + FILE_FINITE, &b->finite, sizeof b->finite);
    file_put(t, v, FILE_NUMBERS);
}

OXL_INTERNAL oxl_result partition_write(oxl_context *ctx, const char *path, const struct partition *p)
{
    double v[FRAME_NUMBERS] = {[0] = p->dimensions, [FRAME_MEMORY] = p->memory};
    struct text t = {.ctx = ctx};
    oxl_result rc;
    text_add(
        &t, "%s",
        "# The survey in blocks, cut along its principal axes (OceanXL, Balanced Scene Partitioning).\n"
        "# A place in the frame is R (world - origin); a block holds low <= place < high, and every place has one block.\n"
        "# FRAME DIMENSIONS R[9] row by row, ORIGIN[3] in the world, EXTENT[3] along the principal axes, "
        "MEMORY in bytes that blocks fit, 0: any\n"
        "# BLOCK_ID LOW[3] HIGH[3] EXPANDED_LOW[3] EXPANDED_HIGH[3] POINTS BASE_VIEWS BORDER_VIEWS START_POINTS "
        "FINITE_LOW[3] FINITE_HIGH[3]\n");
    text_add(&t, "# Number of blocks: %d\nFRAME ", p->block_count);
    memcpy(v + FRAME_AXES, p->rotation, sizeof p->rotation);
    memcpy(v + FRAME_ORIGIN, p->origin, sizeof p->origin);
    memcpy(v + FRAME_EXTENT, p->extent, sizeof p->extent);
    file_put(&t, v, FRAME_NUMBERS);
    for (int i = 0; i < p->block_count; i++) file_put_block(&t, i, &p->block[i]);
    checksum_end_text(&t);
    rc = os_write_text(ctx, path, &t);
    text_free(&t);
    return rc;
}

/* ---------------- reading */

struct file_reader {
    oxl_context *ctx;
    const char *path, *cursor, *end, *next; /* position and end of the line; first byte after it */
    int line;
    size_t capacity;
};

static int file_next_line(struct file_reader *r, const char *file_end)
{
    do {
        const char *feed;
        if (r->next == file_end) return 0;
        feed = memchr(r->next, '\n', (size_t)(file_end - r->next));
        r->cursor = r->next;
        r->end = feed ? feed : file_end;
        r->next = feed ? feed + 1 : file_end;
        r->line++;
        while (r->end > r->cursor && (r->end[-1] == '\r' || r->end[-1] == ' ')) r->end--;
    } while (r->cursor == r->end || *r->cursor == '#');
    return 1;
}

static oxl_result file_wrong(struct file_reader *r, const char *wanted)
{
    const int seen = (int)OXL_MIN(r->end - r->cursor, 24);
    return oxl_fail(r->ctx, OXL_ERR_INPUT,
                    "%s:%d: found '%.*s', expected %s\nfix: write it again: oceanxl partition SCENE -o OUT",
                    r->path, r->line, seen, r->cursor, wanted);
}

/* Reads `numbers` numbers, up to the end of the line; `count` of them from place `counts` on must
 * be whole and not negative. */
static oxl_result file_get(struct file_reader *r, double *out, int numbers, int counts, int count)
{
    for (int i = 0; i < numbers; i++) {
        const char *start;
        while (r->cursor < r->end && *r->cursor == ' ') r->cursor++;
        start = r->cursor;
        if (!parse_double(&r->cursor, r->end, &out[i]) || isnan(out[i])) return file_wrong(r, "a number");
        if (i < counts || i >= counts + count ||
            (out[i] >= 0 && out[i] <= UINT32_MAX && floor(out[i]) == out[i]))
            continue;
        r->cursor = start;
        return file_wrong(r, "a count");
    }
    return r->cursor == r->end ? OXL_OK : file_wrong(r, "the end of the line");
}

static oxl_result file_read_frame(struct file_reader *r, struct partition *p)
{
    static const char word[] = "FRAME";
    double v[FRAME_NUMBERS] = {0};
    oxl_result rc;
    if (r->end - r->cursor < (ptrdiff_t)sizeof word || memcmp(r->cursor, word, sizeof word - 1) != 0)
        return file_wrong(r, "FRAME");
    r->cursor += sizeof word - 1;
    rc = file_get(r, v, FRAME_NUMBERS, 0, 1);
    p->dimensions = v[0] > 2 ? 3 : 2;
    p->memory = v[FRAME_MEMORY];
    memcpy(p->rotation, v + FRAME_AXES, sizeof p->rotation);
    memcpy(p->origin, v + FRAME_ORIGIN, sizeof p->origin);
    memcpy(p->extent, v + FRAME_EXTENT, sizeof p->extent);
    return rc;
}

static oxl_result file_read_block(struct file_reader *r, struct partition *p)
{
    struct partition_block b = {.points = 0};
    double v[FILE_NUMBERS];
    oxl_result rc = file_get(r, v, FILE_NUMBERS, FILE_COUNTS, FILE_FINITE - FILE_COUNTS);
    if (rc == OXL_OK && v[0] != p->block_count) rc = file_wrong(r, "the blocks in order, from 0");
    if (rc == OXL_OK)
        rc = oxl_reserve(r->ctx, &p->block, &r->capacity, (size_t)p->block_count + 1, sizeof *p->block);
    if (rc != OXL_OK) return rc;
    memcpy(&b.box, v + FILE_BOX, sizeof b.box);
    memcpy(&b.expanded, v + FILE_BOX + 6, sizeof b.expanded);
    memcpy(&b.finite, v + FILE_FINITE, sizeof b.finite);
    b.points = (size_t)v[FILE_COUNTS];
    b.base_views = (int)OXL_MIN(v[FILE_COUNTS + 1], INT_MAX);
    b.border_views = (int)OXL_MIN(v[FILE_COUNTS + 2], INT_MAX);
    b.start_points = (size_t)v[FILE_COUNTS + 3];
    p->block[p->block_count++] = b;
    return OXL_OK;
}

OXL_INTERNAL oxl_result partition_read(oxl_context *ctx, const char *path, struct partition *out)
{
    struct file_reader r = {.ctx = ctx, .path = path};
    struct os_file_map file = {0};
    const char *counted;
    oxl_result rc = os_read_file(ctx, path, &file);
    *out = (struct partition){0};
    if (rc != OXL_OK) return rc;
    if (checksum_of_text(file.data, file.size) == CHECKSUM_WRONG)
        rc = oxl_fail(ctx, OXL_ERR_INPUT,
                      "%s: its checksum is not that of its lines: it was damaged, or edited\n"
                      "fix: write it again: oceanxl partition SCENE -o OUT, or train with --restart",
                      path);
    r.cursor = r.end = r.next = file.data;
    if (rc == OXL_OK && file_next_line(&r, file.data + file.size)) rc = file_read_frame(&r, out);
    while (rc == OXL_OK && file_next_line(&r, file.data + file.size)) rc = file_read_block(&r, out);
    if (rc == OXL_OK && out->block_count == 0) rc = file_wrong(&r, "FRAME and a block or more");
    counted = strstr(file.data, "# Number of blocks: ");
    if (rc == OXL_OK && counted && atoi(counted + strlen("# Number of blocks: ")) != out->block_count)
        rc = file_wrong(&r, "as many blocks as the comment states");
    os_release_file(ctx, &file);
    if (rc != OXL_OK) partition_free(ctx, out);
    return rc;
}
