/* colmap_write.c - writes the text files of a COLMAP model. Numbers have 17 digits, so reading them gives the same values.
 *
 * Invariant: files are written atomically; after a failure the old file remains.
 */
#include "survey.h"

#include <inttypes.h>

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
            fprintf(file, " %" PRId64 " %" PRIu32, c->image[t->image_row].id, t->observation);
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
