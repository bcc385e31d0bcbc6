/* partition_export.c - writes each block as a COLMAP text export, readable by COLMAP and other trainers.
 *
 *     OUT/blocks/KKK/sparse/0/   cameras.txt, images.txt, points3D.txt
 *     OUT/blocks/KKK/images      a link to the survey's images, where the system has links; masks likewise
 *     OUT/partition.svg
 *     OUT/partition.txt          written last: it marks the export as complete
 *
 * A block holds its training views and initial points, in the world coordinates, camera models, names and ids
 * of the survey; numbers as %.17g. Tracks are reduced to the block's views. A view keeps all 2D points,
 * unmatched (-1) if their track is not in the block, so POINT2D_IDX of tracks is unchanged. Numbers of
 * images.txt are copied as text; those of images.bin are written as %.17g, as in COLMAP's text export.
 *
 * Several threads write files, one block each. Invariant: the content of files does not depend on the number
 * of threads.
 */
#include "partition.h"
#include "../core/bytes.h"
#include "../survey/sparse.h"
#include "../survey/scene.h"
#include "os_job.h"

enum { EXPORT_BUFFER = 1 << 20, EXPORT_WAVE = 32, EXPORT_FILES = 3 };

static const char *const exporter_name[EXPORT_FILES] = {"cameras.txt", "images.txt", "points3D.txt"};

struct exporter_files { /* Holds the three files of a block. */
    struct os_writer writer[EXPORT_FILES];
};

struct exporter_worker { /* Holds the buffers of a thread, allocated before the threads start. */
    uint64_t *bits;      /* (points) bit 1: the block starts from the point */
    uint8_t *image;      /* (images) 1: the image's view is in the block */
    uint8_t *camera;     /* (cameras) 1: a view of the block has the camera */
    int64_t *slot;       /* (slots) POINT3D_ID of each 2D point of the current view; -1: none */
    char *list;          /* (list_room) text of a view's 2D points */
    char *buffer;        /* (EXPORT_BUFFER) */
    size_t used;
    FILE *file;
    struct os_reader reader; /* reads images.txt or images.bin */
    size_t loose;            /* track entries without a matching 2D point */
    oxl_result rc;
};

struct exporter {
    oxl_context *ctx;
    const struct partition *p;
    const struct colmap *colmap;
    const char *out;
    char *images_file;
    size_t slots, list_room;
    struct exporter_worker *worker; /* (ctx->threads) */
};

/* ---------------- text, fast */

static void exporter_flush(struct exporter_worker *w)
{
    fwrite(w->buffer, 1, w->used, w->file); /* Leaves errors to os_writer_close. */
    w->used = 0;
}

static char *exporter_reserve(struct exporter_worker *w, size_t size)
{
    if (w->used + size > EXPORT_BUFFER) exporter_flush(w);
    return w->buffer + w->used;
}

static void exporter_put(struct exporter_worker *w, const char *text, size_t size)
{
    for (; size > EXPORT_BUFFER; text += EXPORT_BUFFER, size -= EXPORT_BUFFER) {
        memcpy(exporter_reserve(w, EXPORT_BUFFER), text, EXPORT_BUFFER);
        w->used += EXPORT_BUFFER;
    }
    memcpy(exporter_reserve(w, size), text, size);
    w->used += size;
}

static void exporter_put_text(struct exporter_worker *w, const char *text)
{
    exporter_put(w, text, strlen(text));
}

/* Adds a number after the character `before`; before 0: the number alone. */
static void exporter_put_whole(struct exporter_worker *w, char before, int64_t value)
{
    char *to = exporter_reserve(w, NUMBER_TEXT_MAX + 1);
    const int spaced = before != 0;
    *to = before;
    w->used += (size_t)spaced + format_int64(to + spaced, value);
}

static void exporter_put_real(struct exporter_worker *w, double value)
{
    char *to = exporter_reserve(w, NUMBER_TEXT_MAX + 1);
    *to = ' ';
    w->used += 1 + format_double(to + 1, value);
}

/* ---------------- the three files of a block */

static int exporter_has_view(const struct exporter *e, int block, size_t view)
{
    return e->p->plan->role[(size_t)block * e->p->plan->visibility->views + view] != PARTITION_OUT;
}

/* Marks the block's points, images and cameras. */
static void exporter_mark(const struct exporter *e, struct exporter_worker *w, int block)
{
    memset(w->bits, 0, (e->colmap->point_count + 63) / 64 * sizeof *w->bits);
    memset(w->image, 0, e->colmap->image_count);
    memset(w->camera, 0, e->colmap->camera_count);
    partition_mark(e->p, block, w->bits);
    for (size_t v = 0; v < e->p->plan->visibility->views; v++)
        if (exporter_has_view(e, block, v)) {
            w->image[scene_source_image(e->p->plan->scene, (int)v) - e->colmap->image] = 1;
            w->camera[scene_source_camera(e->p->plan->scene, (int)v) - e->colmap->camera] = 1;
        }
}

static void exporter_cameras(const struct exporter *e, struct exporter_worker *w)
{
    int count = 0;
    for (size_t i = 0; i < e->colmap->camera_count; i++) count += w->camera[i];
    exporter_put_text(
        w, "# Camera list with one line of data per camera:\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
           "# Number of cameras:");
    exporter_put_whole(w, ' ', count);
    for (size_t i = 0; i < e->colmap->camera_count; i++) {
        const struct colmap_camera *c = &e->colmap->camera[i];
        if (!w->camera[i]) continue;
        exporter_put_whole(w, '\n', c->id);
        exporter_put_text(w, " ");
        exporter_put_text(w, camera_model_at(c->model)->name);
        exporter_put_whole(w, ' ', c->width);
        exporter_put_whole(w, ' ', c->height);
        for (int k = 0; k < c->parameter_count; k++) exporter_put_real(w, c->parameter[k]);
    }
    exporter_put_text(w, "\n");
}

/* Finds from the tracks the point of each 2D point of the view. */
static void exporter_fill_slots(const struct exporter *e, struct exporter_worker *w, size_t view)
{
    const struct partition_visibility *vis = e->p->plan->visibility;
    for (size_t k = vis->first[view]; k < vis->first[view + 1]; k++) {
        if (vis->observation[k] >= e->slots || w->slot[vis->observation[k]] != -1) w->loose++;
        else w->slot[vis->observation[k]] = e->colmap->point[vis->point[k]].id;
    }
}

/* Clears slots that no 2D point of the file took: their track entries match none. */
static void exporter_clear_slots(const struct exporter *e, struct exporter_worker *w, size_t view)
{
    const struct partition_visibility *vis = e->p->plan->visibility;
    for (size_t k = vis->first[view]; k < vis->first[view + 1]; k++)
        if (vis->observation[k] < e->slots && w->slot[vis->observation[k]] != -1) {
            w->loose++;
            w->slot[vis->observation[k]] = -1;
        }
}

/* Finds the next field: *begin is its first byte, the result its end. Any byte up to the blank separates
 * fields; the text ends in a zero. */
static const char *exporter_next_field(const char *p, const char **begin)
{
    while (*p && (unsigned char)*p <= ' ') p++;
    *begin = p;
    while ((unsigned char)*p > ' ') p++;
    return p;
}

/* Copies X and Y of each 2D point as text, with the POINT3D_ID of the block. */
static void exporter_list(const struct exporter *e, struct exporter_worker *w, const char *p)
{
    for (size_t k = 0;; k++) {
        const char *x, *y, *id;
        const char *x_end = exporter_next_field(p, &x), *y_end = exporter_next_field(x_end, &y);
        p = exporter_next_field(y_end, &id);
        if (id == p) return;
        if (k > 0) exporter_put(w, " ", 1);
        if (y - x_end > 1) {
            exporter_put(w, x, (size_t)(x_end - x));
            exporter_put(w, " ", 1);
            x = y;
        }
        /* Copies X and Y at once if one byte separates them, as nearly always. */
        exporter_put(w, x, (size_t)(y_end - x));
        exporter_put_whole(w, ' ', k < e->slots ? w->slot[k] : -1);
        if (k < e->slots) w->slot[k] = -1;
    }
}

/* Writes the 2D points of images.bin, X and Y of 8 bytes each, with the POINT3D_ID of the block in
 * the place of the file's. */
static void exporter_list_binary(const struct exporter *e, struct exporter_worker *w, const char *p,
                                 size_t size)
{
    for (size_t k = 0; 24 * k + 24 <= size; k++) {
        for (int axis = 0; axis < 2; axis++) {
            if (k + (size_t)axis > 0) exporter_put(w, " ", 1);
            w->used += format_double(exporter_reserve(w, NUMBER_TEXT_MAX),
                                     bytes_double(p + 24 * k + 8 * (size_t)axis));
        }
        exporter_put_whole(w, ' ', k < e->slots ? w->slot[k] : -1);
        if (k < e->slots) w->slot[k] = -1;
    }
}

static void exporter_image(const struct exporter *e, struct exporter_worker *w, size_t view)
{
    const struct colmap_image *image = scene_source_image(e->p->plan->scene, (int)view);
    size_t got = 0;
    exporter_put_whole(w, 0, image->id);
    for (int k = 0; k < 4; k++) exporter_put_real(w, image->rotation[k]);
    for (int k = 0; k < 3; k++) exporter_put_real(w, image->translation[k]);
    exporter_put_whole(w, ' ', image->camera_id);
    exporter_put_text(w, " ");
    exporter_put_text(w, e->colmap->names + image->name);
    exporter_put_text(w, "\n");
#ifdef _OPENMP
#pragma omp critical(exporter_read) /* Serialises reading, since a failure writes to the context. */
#endif
    {
        if (image->points_size) w->rc = os_reader_seek(e->ctx, &w->reader, image->points_at);
        if (w->rc == OXL_OK && image->points_size)
            w->rc = os_reader_read(e->ctx, &w->reader, w->list, image->points_size, &got);
        if (w->rc == OXL_OK && got < image->points_size)
            w->rc = oxl_fail(e->ctx, OXL_ERR_INPUT,
                             "%s: the file was truncated after it was read\nfix: run again", e->images_file);
    }
    exporter_fill_slots(e, w, view);
    w->list[got] = 0;
    if (e->colmap->format == COLMAP_BINARY) exporter_list_binary(e, w, w->list, got);
    else exporter_list(e, w, w->list);
    exporter_clear_slots(e, w, view);
    exporter_put_text(w, "\n");
}

static void exporter_images(const struct exporter *e, struct exporter_worker *w, int block)
{
    exporter_put_text(
        w,
        "# Image list with two lines of data per image:\n#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n"
        "#   POINTS2D[] as (X, Y, POINT3D_ID)\n# Number of images:");
    exporter_put_whole(w, ' ', e->p->block[block].base_views + e->p->block[block].border_views);
    exporter_put_text(w, "\n");
    for (size_t v = 0; v < e->p->plan->visibility->views && w->rc == OXL_OK; v++)
        if (exporter_has_view(e, block, v)) exporter_image(e, w, v);
}

static void exporter_point(const struct exporter *e, struct exporter_worker *w, const struct colmap_point *p)
{
    exporter_put_whole(w, 0, p->id);
    for (int k = 0; k < 3; k++) exporter_put_real(w, p->position[k]);
    for (int k = 0; k < 3; k++) exporter_put_whole(w, ' ', p->rgb[k]);
    exporter_put_real(w, p->error);
    for (uint32_t k = 0; k < p->track_count; k++) {
        const struct colmap_track *t = &e->colmap->track[p->first_track + k];
        if (!w->image[t->image_row]) continue;
        exporter_put_whole(w, ' ', e->colmap->image[t->image_row].id);
        exporter_put_whole(w, ' ', t->observation);
    }
    exporter_put_text(w, "\n");
}

static void exporter_points(const struct exporter *e, struct exporter_worker *w, int block)
{
    exporter_put_text(
        w,
        "# 3D point list with one line of data per point:\n"
        "#   POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n# Number of points:");
    exporter_put_whole(w, ' ', (int64_t)e->p->block[block].start_points);
    exporter_put_text(w, "\n");
    /* Goes through words first: most are 0 if there are many blocks. */
    for (size_t word = 0; 64 * word < e->colmap->point_count; word++) {
        size_t i = 64 * word;
        for (uint64_t rest = w->bits[word]; rest; rest >>= 1, i++)
            if (rest & 1) exporter_point(e, w, &e->colmap->point[i]);
    }
}

static void exporter_block(const struct exporter *e, struct exporter_worker *w, int block,
                           struct exporter_files *files)
{
    exporter_mark(e, w, block);
    for (int k = 0; k < EXPORT_FILES; k++) {
        w->file = files->writer[k].file;
        if (k == 0) exporter_cameras(e, w);
        else if (k == 1) exporter_images(e, w, block);
        else exporter_points(e, w, block);
        exporter_flush(w);
        os_writer_sync(&files->writer[k]);
    }
}

/* ---------------- folders */

#define EXPORTER_BLOCK(e, block) PATH((e)->out, "blocks/%03d", block)

static oxl_result exporter_open(const struct exporter *e, int block, struct exporter_files *files)
{
    const char *folder = PATH(EXPORTER_BLOCK(e, block), "sparse/0");
    oxl_result rc = os_make_folder_in(e->ctx, e->out, PATH("", "blocks/%03d/sparse/0", block));
    for (int k = 0; k < EXPORT_FILES && rc == OXL_OK; k++)
        rc = os_writer_open(e->ctx, PATH(folder, "%s", exporter_name[k]), &files->writer[k]);
    return rc;
}

static void exporter_link(const struct exporter *e, int block, const char *name, const char *folder)
{
    const char *path = PATH(EXPORTER_BLOCK(e, block), "%s", name);
    if (folder && os_is_folder(folder) && !os_link(folder, path))
        oxl_log(e->ctx, OXL_LOG_DEBUG, "%s: no link could be made; name the images by --images", path);
}

/* Removes the exports of an earlier partition into more blocks. Models that were trained there stay. */
static void exporter_remove_old(const struct exporter *e)
{
    static const char *const old[] = {"sparse/0/cameras.txt",
                                      "sparse/0/images.txt",
                                      "sparse/0/points3D.txt",
                                      "sparse/0",
                                      "sparse",
                                      "images",
                                      "masks",
                                      ""};
    for (int block = e->p->block_count; os_is_folder(EXPORTER_BLOCK(e, block)); block++)
        for (size_t k = 0;
             os_refuse_links(e->ctx, e->out, PATH("", "blocks/%03d/sparse/0", block)) == OXL_OK &&
             k < OXL_COUNT(old);
             k++)
            remove(PATH(EXPORTER_BLOCK(e, block), "%s", old[k])); /* removes a folder only if it is empty */
}

/* ---------------- workers */

static oxl_result exporter_prepare(struct exporter *e)
{
    const struct colmap *c = e->colmap;
    const size_t views = e->p->plan->visibility->views;
    for (size_t v = 0; v < views; v++)
        e->list_room = OXL_MAX(e->list_room, scene_source_image(e->p->plan->scene, (int)v)->points_size);
    e->slots = e->list_room / 6 + 1; /* Counts 2D points of at least 6 bytes, "0 0 0 ". */
    e->images_file = oxl_path_join(e->ctx, c->folder, c->images_file);
    e->worker = oxl_calloc(e->ctx, (size_t)e->ctx->threads, sizeof *e->worker);
    if (!e->images_file || !e->worker) return OXL_ERR_MEMORY;
    for (int i = 0; i < e->ctx->threads; i++) {
        struct exporter_worker *w = &e->worker[i];
        const oxl_result rc = e->list_room ? os_reader_open(e->ctx, e->images_file, &w->reader) : OXL_OK;
        if (rc != OXL_OK) return rc;
        w->bits = oxl_alloc(e->ctx, c->point_count / 64 + 1, sizeof *w->bits);
        w->image = oxl_alloc(e->ctx, c->image_count, 1);
        w->camera = oxl_alloc(e->ctx, c->camera_count, 1);
        w->slot = oxl_alloc(e->ctx, e->slots, sizeof *w->slot);
        w->list = oxl_alloc(e->ctx, e->list_room + 1, 1);
        w->buffer = oxl_alloc(e->ctx, EXPORT_BUFFER, 1);
        if (!w->bits || !w->image || !w->camera || !w->slot || !w->list || !w->buffer) return OXL_ERR_MEMORY;
        for (size_t k = 0; k < e->slots; k++) w->slot[k] = -1;
    }
    return OXL_OK;
}

static void exporter_free(struct exporter *e)
{
    for (int i = 0; e->worker && i < e->ctx->threads; i++) {
        struct exporter_worker *w = &e->worker[i];
        os_reader_close(&w->reader);
        OXL_FREE(e->ctx, w->bits, w->image, w->camera, w->slot, w->list, w->buffer);
    }
    OXL_FREE(e->ctx, e->worker, e->images_file);
}

/* Writes `count` blocks from `first` on. Each thread takes the next block that is left. */
static void exporter_batch_write(const struct exporter *e, int first, int count, struct exporter_files *files)
{
    int next = 0;
#pragma omp parallel for schedule(static, 1) num_threads(e->ctx->threads)
    for (int i = 0; i < e->ctx->threads; i++)
        for (int mine = 0; mine < count;) {
#ifdef _OPENMP
#pragma omp atomic capture
#endif
            mine = next++;
            if (mine < count) exporter_block(e, &e->worker[i], first + mine, &files[mine]);
        }
}

static oxl_result exporter_batch(const struct exporter *e, int first, int count)
{
    struct exporter_files *files = oxl_calloc(e->ctx, (size_t)count, sizeof *files);
    oxl_result rc = files ? OXL_OK : OXL_ERR_MEMORY;
    for (int i = 0; i < count && rc == OXL_OK; i++) rc = exporter_open(e, first + i, &files[i]);
    if (rc == OXL_OK) exporter_batch_write(e, first, count, files);
    for (int i = 0; i < e->ctx->threads && rc == OXL_OK; i++) rc = e->worker[i].rc;
    for (int i = 0; i < count && files; i++)
        for (int k = 0; k < EXPORT_FILES; k++) rc = os_writer_close(e->ctx, &files[i].writer[k], rc);
    for (int i = 0; i < count && rc == OXL_OK; i++) {
        exporter_link(e, first + i, "images", e->p->plan->scene->images);
        exporter_link(e, first + i, "masks", e->p->plan->scene->masks);
    }
    oxl_free(e->ctx, files);
    return rc;
}

static oxl_result exporter_blocks(struct exporter *e)
{
    const int wave = OXL_MIN(4 * e->ctx->threads, (int)EXPORT_WAVE);
    size_t loose = 0;
    oxl_result rc = exporter_prepare(e);
    for (int i = 0; i < e->p->block_count && rc == OXL_OK; i += wave) {
        rc = context_stopped(e->ctx);
        if (rc == OXL_OK) rc = exporter_batch(e, i, OXL_MIN(wave, e->p->block_count - i));
    }
    for (int i = 0; rc == OXL_OK && i < e->ctx->threads; i++) loose += e->worker[i].loose;
    if (loose > 0)
        oxl_log(
            e->ctx, OXL_LOG_WARNING,
            "%zu entries of tracks name 2D points that %s does not hold, or that others name too; COLMAP may refuse the blocks as it "
            "would the survey",
            loose, e->images_file);
    if (rc == OXL_OK) exporter_remove_old(e);
    exporter_free(e);
    return rc;
}

/* ---------------- into a folder */

OXL_INTERNAL oxl_result partition_save(oxl_context *ctx, const struct partition *p, const char *out)
{
    oxl_result rc = oxl_make_folder(ctx, out);
    if (rc == OXL_OK) rc = partition_draw(ctx, p, PATH(out, "partition.svg"));
    return rc == OXL_OK ? partition_write(ctx, PATH(out, "partition.txt"), p) : rc;
}

OXL_INTERNAL oxl_result partition_export(oxl_context *ctx, const struct partition *p, const char *out)
{
    struct exporter e = {.ctx = ctx, .p = p, .out = out};
    oxl_result rc = oxl_make_folder(ctx, out);
    if (rc == OXL_OK && !p->plan)
        rc = oxl_fail(
            ctx, OXL_ERR_USAGE,
            "a partition read from partition.txt cannot be exported\nfix: partition the scene again");
    if (rc != OXL_OK) return rc;
    e.colmap = scene_colmap(p->plan->scene);
    os_remove(PATH(out, "partition.txt"));
    rc = exporter_blocks(&e);
    return rc == OXL_OK ? partition_save(ctx, p, out) : rc;
}
