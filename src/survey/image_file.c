/* image_file.c - keeps decoded images in files, reduced, undistorted and with their masks, so that each image
 * is decoded once.
 *
 * A file is one image: IMAGE_FILE_HEAD words, planes, checksum. Its key covers all that determines the image:
 * the files' modification times, the camera and the size. Files are not synced: one that is missing, damaged
 * or has another key is written again from the original.
 */
#include "sparse.h"
#include "image.h"

#define IMAGE_FILE_MAGIC UINT64_C(0x31474d494c584f) /* Spells "OXLIMG1". */
enum { IMAGE_FILE_HEAD = 4 };                       /* magic, key, width and height, mask */

static size_t image_file_bytes(const struct training_image *image)
{
    return (size_t)image->width * (size_t)image->height;
}

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
static int image_file_planes(FILE *file, struct training_image *image, int writing, uint64_t *sum)
{
    uint8_t *plane[] = {image->rgb, image->mask};
    for (size_t k = 0; k < 2 && plane[k]; k++) {
        const size_t size = image_file_bytes(image) * (k ? 1 : 3);
        if ((writing ? fwrite(plane[k], 1, size, file) : fread(plane[k], 1, size, file)) != size) return 0;
        *sum = checksum_add(*sum, plane[k], size);
    }
    return 1;
}

OXL_INTERNAL int image_file_read(oxl_context *ctx, const char *path, uint64_t key, const oxl_camera *to,
                                 struct training_image *out)
{
    FILE *file = os_open(path);
    uint64_t head[IMAGE_FILE_HEAD], sum = key, stored = 0;
    int good;
    *out = (struct training_image){.width = to->width, .height = to->height};
    if (!file) return 0;
    good = fread(head, sizeof *head, IMAGE_FILE_HEAD, file) == IMAGE_FILE_HEAD &&
           head[0] == IMAGE_FILE_MAGIC && head[1] == key &&
           head[2] == ((uint64_t)to->width << 32 | (uint64_t)to->height) && head[3] <= 1;
    if (good) out->rgb = oxl_alloc(ctx, 3 * image_file_bytes(out) + 1, 1);
    if (good && head[3]) out->mask = oxl_alloc(ctx, image_file_bytes(out) + 1, 1);
    good = good && out->rgb && (out->mask || !head[3]) && image_file_planes(file, out, 0, &sum) &&
           fread(&stored, sizeof stored, 1, file) == 1 && stored == sum;
    fclose(file);
    if (!good) image_training_free(ctx, out);
    return good;
}

OXL_INTERNAL oxl_result image_file_write(oxl_context *ctx, const char *path, uint64_t key,
                                         const struct training_image *image)
{
    const uint64_t head[IMAGE_FILE_HEAD] = {
        IMAGE_FILE_MAGIC, key, (uint64_t)image->width << 32 | (uint64_t)image->height, image->mask != NULL};
    struct training_image whole = *image;
    struct os_writer writer;
    uint64_t sum = key;
    oxl_result rc = os_writer_open(ctx, path, &writer);
    if (rc != OXL_OK) return rc;
    writer.unsynced = 1;
    if (fwrite(head, sizeof *head, IMAGE_FILE_HEAD, writer.file) != IMAGE_FILE_HEAD ||
        !image_file_planes(writer.file, &whole, 1, &sum) || fwrite(&sum, sizeof sum, 1, writer.file) != 1)
        rc = oxl_fail(ctx, OXL_ERR_IO, "%s: cannot write: the disk may be full", path);
    return os_writer_close(ctx, &writer, rc);
}
