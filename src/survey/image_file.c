/* image_file.c - keeps decoded images in files, reduced, undistorted and with their masks, so that each image
 * is decoded once.
 *
 * A file is one image: a byte that is 1 if there is a mask, planes, checksum. Its key covers all that
 * determines the image: the files' modification times, the camera and the size; the checksum begins with it.
 * Files are not synced: one that is missing, damaged or has another key is written again from the original.
 */
#include "image.h"
#include "sparse.h"

OXL_INTERNAL uint64_t image_file_key(const char *path, const char *mask, const struct image_alpha *alpha,
                                     const struct colmap_camera *from, const oxl_camera *to)
{
    const int64_t modified[2] = {os_modified(path), mask ? os_modified(mask) : 0};
    const double numbers[] = {from->model,
                              from->width,
                              from->height,
                              to->width,
                              to->height,
                              to->fx,
                              to->fy,
                              to->cx,
                              to->cy,
                              alpha->masks,
                              alpha->background[0],
                              alpha->background[1],
                              alpha->background[2]};
    uint64_t sum = checksum_add(CHECKSUM_SEED, path, strlen(path));
    sum = checksum_add(sum, modified, sizeof modified);
    sum = checksum_add(sum, numbers, sizeof numbers);
    return checksum_add(sum, from->parameter, sizeof from->parameter);
}

/* Reads or writes the planes in the order of the file and adds them to *sum; returns 0 on failure. */
static int image_file_planes(FILE *file, const struct training_image *image, int writing, uint64_t *sum)
{
    uint8_t *plane[] = {image->rgb, image->mask};
    for (size_t k = 0; k < 2 && plane[k]; k++) {
        const size_t size = (size_t)image->width * image->height * (k ? 1 : 3);
        if ((writing ? fwrite(plane[k], 1, size, file) : fread(plane[k], 1, size, file)) != size) return 0;
        *sum = checksum_add(*sum, plane[k], size);
    }
    return 1;
}

OXL_INTERNAL int image_file_read(oxl_context *ctx, const char *path, uint64_t key, const oxl_camera *to,
                                 struct training_image *out)
{
    FILE *file = os_open(path);
    const int masked = file ? fgetc(file) : EOF;
    uint64_t sum = key, stored = 0;
    int good;
    *out = (struct training_image){0};
    good = (masked == 0 || masked == 1) && image_training_alloc(ctx, to, masked, out) == OXL_OK &&
           image_file_planes(file, out, 0, &sum) && fread(&stored, sizeof stored, 1, file) == 1 &&
           stored == sum;
    if (file) fclose(file);
    if (!good) image_training_free(ctx, out);
    return good;
}

OXL_INTERNAL oxl_result image_file_write(oxl_context *ctx, const char *path, uint64_t key,
                                         const struct training_image *image)
{
    struct os_writer writer;
    uint64_t sum = key;
    oxl_result rc = os_writer_open(ctx, path, &writer);
    if (rc != OXL_OK) return rc;
    writer.unsynced = 1;
    if (fputc(image->mask != NULL, writer.file) == EOF || !image_file_planes(writer.file, image, 1, &sum) ||
        fwrite(&sum, sizeof sum, 1, writer.file) != 1)
        rc = oxl_fail(ctx, OXL_ERR_IO, "%s: cannot write: the disk may be full", path);
    return os_writer_close(ctx, &writer, rc);
}
