/* partition_file.c - writes and reads partition.txt: the frame, then one line per block.
 *
 *     # comments
 *     FRAME DIMENSIONS R[9] ORIGIN[3] EXTENT[3] MEMORY
 *     BLOCK_ID LOW[3] HIGH[3] FINITE_LOW[3] FINITE_HIGH[3] POINTS START_POINTS BASE_VIEWS BORDER_VIEWS
 *
 * Invariant: values are read back to the same bits (%.17g, inf); the locale has no effect.
 */
#include "large.h"

enum { FILE_NUMBERS = 17 }; /* of a line */
static const char FILE_FRAME[] = "FRAME";

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
    double v[FILE_NUMBERS] = {[0] = p->dimensions, [16] = p->memory};
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
    file_put(&t, FILE_FRAME, v, FILE_NUMBERS);
    for (int i = 0; i < p->block_count; i++) {
        const struct partition_block *b = &p->block[i];
        double w[FILE_NUMBERS] = {
            [12] = (double)b->points, (double)b->start_points, b->base_views, b->border_views};
        char id[16];
        snprintf(id, sizeof id, "%d", i);
        memcpy(w, &b->box, sizeof b->box);
        memcpy(w + 6, &b->finite, sizeof b->finite);
        file_put(&t, id, w, FILE_NUMBERS - 1);
    }
    checksum_end_text(&t);
    rc = os_write_text(ctx, path, &t);
    text_free(&t);
    return rc;
}

/* ---------------- reading */

/* Reads a line's numbers, the first FILE_NUMBERS of it; returns 0 if there are fewer. */
static int file_get(const char *at, const char *end, double v[FILE_NUMBERS])
{
    for (int i = 0; i < FILE_NUMBERS; i++) {
        while (at < end && *at == ' ') at++;
        if (!parse_double(&at, end, &v[i])) return 0;
    }
    return 1;
}

static void file_read_frame(const double v[FILE_NUMBERS], struct partition *p)
{
    p->dimensions = v[0] > 2 ? 3 : 2;
    p->memory = v[16];
    memcpy(p->rotation, v + 1, sizeof p->rotation);
    memcpy(p->origin, v + 10, sizeof p->origin);
    memcpy(p->extent, v + 13, sizeof p->extent);
}

static struct partition_block file_read_block(const double v[FILE_NUMBERS])
{
    struct partition_block b = {.points = (size_t)v[13],
                                .start_points = (size_t)v[14],
                                .base_views = (int)v[15],
                                .border_views = (int)v[16]};
    memcpy(&b.box, v + 1, sizeof b.box);
    memcpy(&b.finite, v + 7, sizeof b.finite);
    return b;
}

/* Reads lines that are as partition_write has written them, by their checksum. */
static oxl_result file_read_lines(oxl_context *ctx, const struct os_file_map *file, struct partition *p)
{
    const char *at = file->data, *end = at + file->size;
    double v[FILE_NUMBERS];
    size_t capacity = 0;
    oxl_result rc = OXL_OK;
    for (; at < end && rc == OXL_OK; at += strcspn(at, "\n") + 1) {
        if (*at == '#' || !file_get(at + (*at == 'F' ? strlen(FILE_FRAME) : 0), end, v)) continue;
        if (*at == 'F') file_read_frame(v, p);
        else rc = oxl_reserve(ctx, &p->block, &capacity, (size_t)p->block_count + 1, sizeof *p->block);
        if (*at != 'F' && rc == OXL_OK) p->block[p->block_count++] = file_read_block(v);
    }
    return rc;
}

OXL_INTERNAL oxl_result partition_read(oxl_context *ctx, const char *path, struct partition *out)
{
    struct os_file_map file = {0};
    oxl_result rc = os_read_file(ctx, path, &file);
    *out = (struct partition){0};
    if (rc == OXL_OK && checksum_of_text(file.data, file.size) != CHECKSUM_RIGHT)
        rc = oxl_fail(ctx, OXL_ERR_INPUT,
                      "%s: the checksum does not match the lines: the file was damaged or edited\n"
                      "fix: train with --restart",
                      path);
    if (rc == OXL_OK) rc = file_read_lines(ctx, &file, out);
    os_release_file(ctx, &file);
    if (rc != OXL_OK) partition_free(ctx, out);
    return rc;
}
