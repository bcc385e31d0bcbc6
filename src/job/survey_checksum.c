/* survey_checksum.c - tells whether a survey's files are those of an earlier run: its cameras, poses and
 * points by their values, its images and masks by their sizes and last bytes.
 *
 * Whole images are not read: that would take a minute for ten thousand. PNG ends in sums of all pixels, and a
 * JPEG's code is shifted by whatever changes before, so the last bytes of files with other pixels differ.
 *
 * Invariant: the same for a survey that was copied or moved, and for text and binary files of a model.
 */
#include "job.h"
#include "../survey/scene.h"

enum { CHECKSUM_END = 256 }; /* bytes at the end of an image that are read */

static uint64_t checksum_add_numbers(uint64_t sum, const double *number, int count)
{
    return checksum_add(sum, number, (size_t)count * sizeof *number);
}

/* Adds the size and the last bytes of a file; a missing one counts as empty. */
static uint64_t checksum_add_file(oxl_context *ctx, uint64_t sum, const char *path)
{
    struct os_reader file = {0};
    char end[CHECKSUM_END];
    size_t got = 0;
    if (path && os_reader_open(ctx, path, &file) == OXL_OK) {
        const uint64_t from = file.size > sizeof end ? file.size - sizeof end : 0;
        if (os_reader_seek(ctx, &file, from) == OXL_OK) os_reader_read(ctx, &file, end, sizeof end, &got);
    }
    sum = checksum_add(checksum_add(sum, &file.size, sizeof file.size), end, got);
    os_reader_close(&file);
    return sum;
}

static uint64_t checksum_add_cameras(uint64_t sum, const struct colmap *c)
{
    for (size_t i = 0; i < c->camera_count; i++) {
        const struct colmap_camera *camera = &c->camera[i];
        sum = checksum_add_numbers(sum, (double[]){camera->model, camera->width, camera->height}, 3);
        sum = checksum_add_numbers(sum, camera->parameter, camera->parameter_count);
    }
    return sum;
}

static uint64_t checksum_add_points(uint64_t sum, const struct colmap *c)
{
    for (size_t i = 0; i < c->point_count; i++) {
        sum = checksum_add_numbers(sum, c->point[i].position, 3);
        sum = checksum_add(sum, c->point[i].rgb, sizeof c->point[i].rgb);
    }
    return sum;
}

OXL_INTERNAL oxl_result survey_checksum(oxl_context *ctx, const oxl_scene *scene, uint64_t *sum)
{
    *sum = checksum_add_points(checksum_add_cameras(CHECKSUM_SEED, &scene->colmap), &scene->colmap);
    for (int v = 0; v < scene->view_count; v++) {
        const struct colmap_image *image = scene_source_image(scene, v);
        const char *name = scene->view[v].name;
        char *mask = NULL;
        const oxl_result rc = scene_mask_path(ctx, scene, v, &mask);
        if (rc != OXL_OK) return rc;
        *sum = checksum_add(*sum, name, strlen(name));
        *sum = checksum_add_numbers(*sum, image->rotation, 4);
        *sum = checksum_add_numbers(*sum, image->translation, 3);
        if (scene_depth_range(scene, v)) *sum = checksum_add_numbers(*sum, image->range, 2);
        *sum = checksum_add_file(ctx, *sum, PATH(scene->images, "%s", name));
        *sum = checksum_add_file(ctx, *sum, mask);
        oxl_free(ctx, mask);
    }
    return OXL_OK;
}
