/* partition_file.c - writes and reads partition.txt: the frame, then one line per block.
 *
 *     # comments
 *     FRAME DIMENSIONS R[9] ORIGIN[3] EXTENT[3] MEMORY
 *     BLOCK_ID LOW[3] HIGH[3] FINITE_LOW[3] FINITE_HIGH[3] POINTS START_POINTS BASE_VIEWS BORDER_VIEWS
 *
 * Invariant: values are read back to the same bits (%.17g, inf); the locale has no effect.
 */
#include "large.h"

enum { FILE_FRAME = 17, FILE_BLOCK = 17 }; /* numbers of a line */

/* ---------------- writing */

static void file_put(struct text *t, const char *word, const double v[], int count)
{
    text_add(t, "%s", word);
    for (int i = 0; i < count; i++) {
        char text[NUMBER_TEXT_MAX];
        format_double(text, v[i]);
        text_add(t, " %s", text);
    }
    text_add(t, "\n");
}

OXL_INTERNAL oxl_result partition_write(oxl_context *ctx, const char *path, const struct partition *p)
{
    double v[FILE_FRAME] = {[0] = p->dimensions, [16] = p->memory};
    struct text t = {.ctx = ctx};
    oxl_result rc;
    text_add(
        &t,
        "# The survey in blocks, cut along its principal axes (OceanXL, Balanced Scene Partitioning).\n"
        "# A place in the frame is R (world - origin); a block holds low <= place < high, and every place has one block.\n"
        "# FRAME DIMENSIONS R[9] row by row, ORIGIN[3] in the world, EXTENT[3] along the principal axes, "
        "MEMORY in bytes that blocks fit, 0: any\n"
        "# BLOCK_ID LOW[3] HIGH[3] FINITE_LOW[3] FINITE_HIGH[3] POINTS START_POINTS BASE_VIEWS BORDER_VIEWS\n");
    memcpy(v + 1, p->rotation, sizeof p->rotation);
    memcpy(v + 10, p->origin, sizeof p->origin);
    memcpy(v + 13, p->extent, sizeof p->extent);
    file_put(&t, "FRAME", v, FILE_FRAME);
    for (int i = 0; i < p->block_count; i++) {
        const struct partition_block *b = &p->block[i];
        double w[FILE_BLOCK] = {
            [12] = (double)b->points, (double)b->start_points, b->base_views, b->border_views};
        char id[16];
        snprintf(id, sizeof id, "%d", i);
        memcpy(w, &b->box, sizeof b->box);
        memcpy(w + 6, &b->finite, sizeof b->finite);
        file_put(&t, id, w, FILE_BLOCK - 1);
    }
    checksum_end_text(&t);
    rc = os_write_text(ctx, path, &t);
    text_free(&t);
    return rc;
}

/* ---------------- reading */

/* Reads the numbers after a line's word; returns 0 if they are not as many, or one is none. */
static int file_get(const char *at, const char *end, double v[], int count)
{
    for (int i = 0; i < count; i++) {
        while (at < end && *at == ' ') at++;
        if (!parse_double(&at, end, &v[i]) || isnan(v[i])) return 0;
    }
    return *at == '\n';
}

static int file_read_frame(const char *at, const char *end, struct partition *p)
{
    double v[FILE_FRAME];
    if (strncmp(at, "FRAME", 5) != 0 || !file_get(at + 5, end, v, FILE_FRAME)) return 0;
    p->dimensions = v[0] > 2 ? 3 : 2;
    p->memory = v[16];
    memcpy(p->rotation, v + 1, sizeof p->rotation);
    memcpy(p->origin, v + 10, sizeof p->origin);
    memcpy(p->extent, v + 13, sizeof p->extent);
    return 1;
}

static int file_read_block(const char *at, const char *end, int block, struct partition_block *b)
{
    double v[FILE_BLOCK];
    if (!file_get(at, end, v, FILE_BLOCK) || v[0] != block) return 0;
    for (int i = 13; i < FILE_BLOCK; i++)
        if (!(v[i] >= 0 && v[i] <= INT_MAX)) return 0;
    memcpy(&b->box, v + 1, sizeof b->box);
    memcpy(&b->finite, v + 7, sizeof b->finite);
    b->points = (size_t)v[13], b->start_points = (size_t)v[14];
    b->base_views = (int)v[15], b->border_views = (int)v[16];
    return 1;
}

static oxl_result file_read_lines(oxl_context *ctx, const char *path, const struct os_file_map *file,
                                  struct partition *p)
{
    const char *at = file->data, *end = at + file->size;
    size_t capacity = 0;
    int frames = 0;
    for (int line = 1, good; at < end; line++, at += strcspn(at, "\n") + 1) {
        if (*at == '#') continue;
        if (oxl_reserve(ctx, &p->block, &capacity, (size_t)p->block_count + 1, sizeof *p->block) != OXL_OK)
            return OXL_ERR_MEMORY;
        good = frames ? file_read_block(at, end, p->block_count, &p->block[p->block_count])
                      : file_read_frame(at, end, p);
        if (!good)
            return oxl_fail(ctx, OXL_ERR_INPUT,
                            "%s:%d: found '%.24s', expected %s and %d numbers\nfix: train with --restart",
                            path, line, at, frames ? "the next BLOCK_ID" : "FRAME", FILE_BLOCK - frames);
        p->block_count += frames;
        frames = 1;
    }
    return p->block_count
               ? OXL_OK
               : oxl_fail(ctx, OXL_ERR_INPUT, "%s: it lists no block\nfix: train with --restart", path);
}

OXL_INTERNAL oxl_result partition_read(oxl_context *ctx, const char *path, struct partition *out)
{
    struct os_file_map file = {0};
    oxl_result rc = os_read_file(ctx, path, &file);
    *out = (struct partition){0};
    if (rc == OXL_OK && checksum_of_text(file.data, file.size) != CHECKSUM_RIGHT)
        rc = oxl_fail(ctx, OXL_ERR_INPUT,
                      "%s: the checksum does not match the lines: the file was damaged or edited\nfix: "
                      "write it again: oceanxl partition SCENE -o OUT, or train with --restart",
                      path);
    if (rc == OXL_OK) rc = file_read_lines(ctx, path, &file, out);
    os_release_file(ctx, &file);
    if (rc != OXL_OK) partition_free(ctx, out);
    return rc;
}
