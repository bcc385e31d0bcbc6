/* partition_export.c - writes each block as a COLMAP text export, readable by COLMAP and other trainers.
 *
 *     OUT/blocks/KKK/sparse/0/   cameras.txt, images.txt, points3D.txt
 *     OUT/blocks/KKK/images      a link to the survey's images, where the system has links; masks likewise
 *     OUT/partition.svg
 *     OUT/partition.txt          written last: it marks the export as complete
 *
 * A block holds its training views and initial points, in the world coordinates, camera models, names and ids
 * of the survey; numbers as %.17g; all cameras. Tracks are reduced to the block's views. All points that
 * a view sees are in its blocks, so its 2D points are those of the survey: text is copied, binary numbers are
 * written out.
 */
#include "partition.h"
#include "../core/bytes.h"
#include "../survey/sparse.h"
#include "../survey/scene.h"
#include "os_job.h"

#include <inttypes.h>

enum { EXPORT_OBSERVATION = 24 }; /* bytes of a 2D point in images.bin: x, y, POINT3D_ID */

struct exporter {
    oxl_context *ctx;
    const struct partition *p;
    const struct colmap *colmap;
    const char *out;
    struct os_reader reader; /* of images.txt or images.bin */
    char *list;              /* 2D points of a view, as the file has them */
    int block;
    FILE *file;
};

/* Writes numbers as %.17g, each after a blank. */
static void exporter_numbers(const struct exporter *e, const double *value, int count)
{
    for (int k = 0; k < count; k++) {
        char text[NUMBER_TEXT_MAX];
        format_double(text, value[k]);
        fprintf(e->file, " %s", text);
    }
}

static oxl_result exporter_cameras(struct exporter *e)
{
    fprintf(e->file, "# Camera list with one line of data per camera:\n"
                     "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n");
    for (size_t i = 0; i < e->colmap->camera_count; i++) {
        const struct colmap_camera *c = &e->colmap->camera[i];
        fprintf(e->file, "%" PRId64 " %s %d %d", c->id, camera_model_at(c->model)->name, c->width, c->height);
        exporter_numbers(e, c->parameter, c->parameter_count);
        fputc('\n', e->file);
    }
    return OXL_OK;
}

/* Writes the line of a view's 2D points. */
static oxl_result exporter_list(struct exporter *e, const struct colmap_image *image)
{
    size_t got = 0;
    oxl_result rc = image->points_size ? os_reader_seek(e->ctx, &e->reader, image->points_at) : OXL_OK;
    if (rc == OXL_OK && image->points_size)
        rc = os_reader_read(e->ctx, &e->reader, e->list, image->points_size, &got);
    if (rc == OXL_OK && got < image->points_size)
        rc = oxl_fail(e->ctx, OXL_ERR_INPUT, "%s: the file was truncated after it was read\nfix: run again",
                      e->reader.path);
    if (e->colmap->format == COLMAP_TEXT) fwrite(e->list, 1, got, e->file);
    else
        for (const char *p = e->list; p + EXPORT_OBSERVATION <= e->list + got; p += EXPORT_OBSERVATION) {
            const double pixel[2] = {bytes_double(p), bytes_double(p + 8)};
            exporter_numbers(e, pixel, 2);
            fprintf(e->file, " %" PRId64, (int64_t)bytes_get(p + 16, 8));
        }
    fputc('\n', e->file);
    return rc;
}

static oxl_result exporter_images(struct exporter *e)
{
    const oxl_scene *scene = e->p->plan->scene;
    oxl_result rc = OXL_OK;
    fprintf(e->file, "# Image list with two lines of data per image:\n"
                     "#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n"
                     "#   POINTS2D[] as (X, Y, POINT3D_ID)\n");
    for (int v = 0; v < oxl_scene_view_count(scene) && rc == OXL_OK; v++) {
        const struct colmap_image *image = scene_source_image(scene, v);
        if (!partition_has_view(e->p, e->block, v)) continue;
        fprintf(e->file, "%" PRId64, image->id);
        exporter_numbers(e, image->rotation, 4);
        exporter_numbers(e, image->translation, 3);
        fprintf(e->file, " %" PRId64 " %s\n", image->camera_id, e->colmap->names + image->name);
        rc = exporter_list(e, image);
    }
    return rc;
}

static oxl_result exporter_points(struct exporter *e)
{
    fprintf(e->file, "# 3D point list with one line of data per point:\n"
                     "#   POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n");
    for (size_t i = 0; i < e->colmap->point_count; i++) {
        const struct colmap_point *p = &e->colmap->point[i];
        if (!partition_starts_from(e->p, e->block, i)) continue;
        fprintf(e->file, "%" PRId64, p->id);
        exporter_numbers(e, p->position, 3);
        fprintf(e->file, " %d %d %d", p->rgb[0], p->rgb[1], p->rgb[2]);
        exporter_numbers(e, &p->error, 1);
        for (uint32_t k = 0; k < p->track_count; k++) {
            const struct colmap_track *t = &e->colmap->track[p->first_track + k];
            if (partition_has_view(e->p, e->block, e->p->plan->view_of[t->image_row]))
                fprintf(e->file, " %" PRId64 " %" PRIu32, e->colmap->image[t->image_row].id, t->observation);
        }
        fputc('\n', e->file);
    }
    return OXL_OK;
}

static oxl_result exporter_block(struct exporter *e)
{
    static const struct {
        const char *name;
        oxl_result (*write)(struct exporter *e);
    } files[] = {{"cameras.txt", exporter_cameras},
                 {"images.txt", exporter_images},
                 {"points3D.txt", exporter_points}};
    const oxl_scene *scene = e->p->plan->scene;
    const char *linked[] = {"images", scene->images, "masks", scene->masks};
    oxl_result rc = context_stopped(e->ctx);
    if (rc == OXL_OK) rc = oxl_make_folder(e->ctx, PATH(e->out, "blocks/%03d/sparse/0", e->block));
    for (size_t k = 0; k < OXL_COUNT(files) && rc == OXL_OK; k++) {
        struct os_writer writer;
        rc =
            os_writer_open(e->ctx, PATH(e->out, "blocks/%03d/sparse/0/%s", e->block, files[k].name), &writer);
        if (rc != OXL_OK) return rc;
        e->file = writer.file;
        rc = os_writer_close(e->ctx, &writer, files[k].write(e));
    }
    for (size_t k = 0; k < OXL_COUNT(linked) && rc == OXL_OK; k += 2) {
        const char *path = PATH(e->out, "blocks/%03d/%s", e->block, linked[k]);
        if (linked[k + 1] && os_is_folder(linked[k + 1]) && !os_link(linked[k + 1], path))
            oxl_log(e->ctx, OXL_LOG_DEBUG,
                    "%s: no link to the images could be made; name their folder "
                    "by --images",
                    path);
    }
    return rc;
}

static oxl_result exporter_blocks(struct exporter *e)
{
    const char *path = PATH(e->colmap->folder, "%s", e->colmap->images_file);
    size_t room = 0;
    oxl_result rc = OXL_OK;
    for (size_t i = 0; i < e->colmap->image_count; i++) room = OXL_MAX(room, e->colmap->image[i].points_size);
    e->list = oxl_alloc(e->ctx, room + 1, 1);
    if (!e->list) rc = OXL_ERR_MEMORY;
    if (rc == OXL_OK && room) rc = os_reader_open(e->ctx, path, &e->reader);
    for (e->block = 0; e->block < e->p->block_count && rc == OXL_OK; e->block++) rc = exporter_block(e);
    os_reader_close(&e->reader);
    oxl_free(e->ctx, e->list);
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
    struct exporter e = {.ctx = ctx, .p = p, .colmap = scene_colmap(p->plan->scene), .out = out};
    const char *more = PATH(out, "blocks/%03d/sparse", p->block_count);
    oxl_result rc = oxl_make_folder(ctx, out);
    if (rc == OXL_OK && os_is_folder(more))
        rc = oxl_fail(ctx, OXL_ERR_INPUT,
                      "%s belongs to an earlier partition into more blocks\nfix: name another folder by -o",
                      more);
    if (rc != OXL_OK) return rc;
    os_remove(PATH(out, "partition.txt"));
    rc = exporter_blocks(&e);
    return rc == OXL_OK ? partition_save(ctx, p, out) : rc;
}
