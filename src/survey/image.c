/* image.c - reads images: decode, undistort, reduce, mask.
 *
 * codec.c decodes JPEG and PNG; its memory is freed before a function here returns, except struct pixels
 * (image_pixels_free).
 *
 * Invariant: an image's bytes do not depend on the machine or on the number of threads. Every sum is one of
 * integers.
 */
#include "sparse.h"
#include "image.h"
#include "image_header.h"
#include "../core/codec.h"
#include "../core/simd.h"
#include "../core/vecmath.h"

enum {
    IMAGE_SIDE_MAX = 32768, /* px; a header with a larger side is an error */
    /* samples per side of a pixel when an image is undistorted; 16^2 x 255 x 2^16 fits 32 bits */
    IMAGE_SAMPLES_MAX = 16,
    IMAGE_FRACTION = 256 /* denominator of bilinear weights */
};

/* ---------------- decode */

/* Reads the header of a file, and refuses one of another shape than the camera's, if that is not NULL, or
 * that the decoder must not see. sums: as in image_header_of. */
static oxl_result image_check_header(oxl_context *ctx, const char *path, const struct os_file_map *file,
                                     int sums, const struct colmap_camera *from, struct image_header *out)
{
    const char *fault;
    *out = (struct image_header){0};
    if (os_refuse_gzip(ctx, path, file->data, file->size) != OXL_OK) return OXL_ERR_INPUT;
    if (file->size > INT_MAX)
        return oxl_fail(ctx, OXL_ERR_INPUT, "%s: %zu bytes are too many for one image\nfix: re-encode it",
                        path, file->size);
    if (file->size == 0)
        return oxl_fail(ctx, OXL_ERR_INPUT,
                        "%s: it is empty\nfix: copy it again; a cloud drive may not have downloaded it",
                        path);
    fault = image_header_of(file->data, file->size, sums, out);
    if (from && out->width > 0 && image_check_shape(ctx, path, out->width, out->height, from) != OXL_OK)
        return ctx->failed;
    if (fault)
        return strchr(fault, '\n')
                   ? oxl_fail(ctx, OXL_ERR_INPUT, "%s: %s", path, fault)
                   : oxl_fail(ctx, OXL_ERR_INPUT,
                              "%s: the image of %zu bytes is damaged: %s\nfix: copy it again, or remove it",
                              path, file->size, fault);
    if (out->width < 1 || out->height < 1 || out->width > IMAGE_SIDE_MAX || out->height > IMAGE_SIDE_MAX)
        return oxl_fail(
            ctx, OXL_ERR_INPUT,
            "%s: %d x %d px, expected 1 to %d a side\nfix: reduce the image, or copy it again if it is damaged",
            path, out->width, out->height, IMAGE_SIDE_MAX);
    return OXL_OK;
}

/* Rounds 16 bits to 8, 0..65535 to 0..255, to nearest, in place. is_linear 1: colours get the curve of
 * sRGB (IEC 61966-2-1), as all other images have it. */
static uint8_t *image_to_8_bits(uint16_t *wide, size_t count, int channels, int is_linear)
{
    uint8_t *narrow = (uint8_t *)wide;
    for (size_t i = 0; wide && i < count; i++) {
        uint16_t v;
        memcpy(&v, narrow + 2 * i, sizeof v);
        if (is_linear && (channels == 3 || i % 4 < 3)) {
            const double x = v / 65535.0;
            v = (uint16_t)(65535 *
                           (x > 0.0031308 ? 1.055 * vecmath_exp(vecmath_log(x) / 2.4) - 0.055 : 12.92 * x));
        }
        narrow[i] = (uint8_t)((v * 255u + 32767u) / 65535u);
    }
    return narrow;
}

/* Extends a short palette to 256 entries with black, since stb 2.27 reads past its end. */
static oxl_result image_fill_palette(oxl_context *ctx, const struct image_header *h, struct os_file_map *file)
{
    enum { FULL = 3 * 256 };
    const size_t behind = h->palette + h->palette_size, more = FULL - h->palette_size;
    struct os_file_map full;
    char *data;
    if (!h->palette || h->palette_size >= FULL || file->size > INT_MAX - FULL) return OXL_OK;
    full.size = file->size + more;
    full.data = data = oxl_calloc(ctx, full.size + 1, 1);
    if (!data) return OXL_ERR_MEMORY;
    memcpy(data, file->data, behind);
    memcpy(data + behind + more, file->data + behind, file->size - behind);
    data[h->palette - 6] = FULL >> 8, data[h->palette - 5] = FULL & 255;
    os_release_file(ctx, file);
    *file = full;
    return OXL_OK;
}

/* Reads an image file. A missing or unreadable file is OXL_ERR_IO, not bad input, since it may come back. */
static oxl_result image_read_file(oxl_context *ctx, const char *path, struct os_file_map *file)
{
    char text[sizeof ctx->error];
    const oxl_result rc = os_read_file(ctx, path, file);
    if (rc != OXL_ERR_INPUT) return rc;
    memcpy(text, ctx->error, sizeof text);
    return oxl_fail(ctx, OXL_ERR_IO, "%s", text);
}

static oxl_result image_decode_file(oxl_context *ctx, const char *path, const struct os_file_map *file,
                                    const struct image_header *h, int channels, struct pixels *out)
{
    struct pixels p = {.channels = channels};
    const int is_linear = h->is_linear && channels >= 3; /* not of masks */
    if (h->bits == 16 || is_linear)
        p.data = image_to_8_bits(codec_decode_16(ctx, file->data, file->size, channels, &p.width, &p.height),
                                 (size_t)h->width * h->height * channels, channels, is_linear);
    else p.data = codec_decode(ctx, file->data, file->size, channels, &p.width, &p.height);
    if (p.data) return *out = p, OXL_OK;
    if (strcmp(codec_failure(), "outofmem") == 0)
        return oxl_fail(ctx, OXL_ERR_MEMORY, "%s: no memory to decode %d x %d px", path, h->width, h->height);
    return oxl_fail(ctx, OXL_ERR_INPUT, "%s: cannot be decoded (%s)\nfix: copy it again, or remove it", path,
                    codec_failure());
}

/* Decodes an image, after it has refused one of another shape than the camera's. from NULL: any shape.
 * channels 0: as in image_decode. */
static oxl_result image_decode_of(oxl_context *ctx, const char *path, int channels,
                                  const struct colmap_camera *from, struct pixels *out)
{
    struct os_file_map file = {0};
    struct image_header h = {0};
    oxl_result rc = image_read_file(ctx, path, &file);
    *out = (struct pixels){0};
    if (rc == OXL_OK) rc = image_check_header(ctx, path, &file, 1, from, &h);
    if (rc == OXL_OK) rc = image_fill_palette(ctx, &h, &file);
    if (rc == OXL_OK)
        rc = image_decode_file(ctx, path, &file, &h, channels ? channels : 3 + h.has_alpha, out);
    os_release_file(ctx, &file);
    return rc;
}

OXL_INTERNAL oxl_result image_decode(oxl_context *ctx, const char *path, int channels, struct pixels *out)
{
    return image_decode_of(ctx, path, channels, NULL, out);
}

OXL_INTERNAL void image_pixels_free(oxl_context *ctx, struct pixels *p)
{
    codec_free(ctx, p->data);
    *p = (struct pixels){0};
}

OXL_INTERNAL oxl_result image_size(oxl_context *ctx, const char *path, int *width, int *height)
{
    struct os_file_map file = {0};
    struct image_header h = {0};
    oxl_result rc = image_read_file(ctx, path, &file);
    if (rc == OXL_OK) rc = image_check_header(ctx, path, &file, 0, NULL, &h);
    *width = h.width, *height = h.height;
    os_release_file(ctx, &file);
    return rc;
}

/* ---------------- reduce */

/* Holds the input that one output pixel covers along one axis, [at n_in, (at + 1) n_in) in units of 1/n_out
 * of an input pixel: so all overlaps are whole numbers, with the sum n_in. */
struct image_span {
    int first, last;                    /* first and last input pixel touched */
    unsigned weight_first, weight_last; /* weights of these two; pixels between them weigh n_out */
};

static struct image_span image_span_of(int at, int n_in, int n_out)
{
    const int64_t from = (int64_t)at * n_in, to = from + n_in;
    struct image_span s = {.first = (int)(from / n_out), .last = (int)((to - 1) / n_out)};
    s.weight_first = (unsigned)(OXL_MIN(to, (int64_t)(s.first + 1) * n_out) - from);
    s.weight_last = (unsigned)(to - OXL_MAX(from, (int64_t)s.last * n_out));
    return s;
}

static unsigned image_span_weight(const struct image_span *s, int i, int n_out)
{
    return i == s->first ? s->weight_first : i == s->last ? s->weight_last : (unsigned)n_out;
}

/* Averages the image over each output pixel's area, exactly, and rounds once. The weights of a row sum to
 * in->width, so 32 bits suffice for it. */
static void image_reduce_row(const struct pixels *in, const struct training_image *out, int y)
{
    const struct image_span rows = image_span_of(y, in->height, out->height);
    const uint64_t total = (uint64_t)in->width * in->height;
    const size_t plane = (size_t)out->width * out->height;
    for (int x = 0; x < out->width; x++) {
        const struct image_span columns = image_span_of(x, in->width, out->width);
        uint64_t sum[3] = {0, 0, 0};
        for (int i = rows.first; i <= rows.last; i++) {
            const unsigned weight = image_span_weight(&rows, i, out->height);
            uint32_t row[3] = {0, 0, 0};
            for (int j = columns.first; j <= columns.last; j++)
                for (int c = 0; c < 3; c++)
                    row[c] += image_span_weight(&columns, j, out->width) *
                              in->data[3 * ((size_t)i * in->width + (size_t)j) + c];
            for (int c = 0; c < 3; c++) sum[c] += (uint64_t)weight * row[c];
        }
        for (int c = 0; c < 3; c++)
            out->rgb[c * plane + (size_t)y * out->width + x] = (uint8_t)((sum[c] + total / 2) / total);
    }
}

static void image_reduce(const oxl_context *ctx, const struct pixels *in, const struct training_image *out)
{
    const size_t pixels = (size_t)in->width * in->height;
    const int is_same = in->width == out->width && in->height == out->height;
    for (size_t i = 0; is_same && i < 3 * pixels; i++) out->rgb[i % 3 * pixels + i / 3] = in->data[i];
#pragma omp parallel for schedule(static) num_threads(ctx->threads) if (!is_same)
    for (int y = 0; y < (is_same ? 0 : out->height); y++) image_reduce_row(in, out, y);
    (void)ctx; /* without OpenMP */
}

/* Masks a pixel that overlaps a black mask pixel, since its colour contains masked content. */
static void image_reduce_mask_row(const struct pixels *mask, const struct training_image *out, int y)
{
    const struct image_span rows = image_span_of(y, mask->height, out->height);
    for (int x = 0; x < out->width; x++) {
        const struct image_span columns = image_span_of(x, mask->width, out->width);
        int counts = 1;
        for (int i = rows.first; i <= rows.last; i++)
            for (int j = columns.first; j <= columns.last; j++)
                counts &= mask->data[(size_t)i * mask->width + j] != 0;
        if (!counts) out->mask[(size_t)y * out->width + x] = 0;
    }
}

OXL_INTERNAL oxl_result image_add_mask(oxl_context *ctx, const struct pixels *mask,
                                       struct training_image *image)
{
    const size_t pixels = (size_t)image->width * image->height;
    if (!image->mask && (image->mask = oxl_alloc(ctx, pixels, 1)) != NULL) memset(image->mask, 255, pixels);
    if (!image->mask) return OXL_ERR_MEMORY;
#pragma omp parallel for schedule(static) num_threads(ctx->threads)
    for (int y = 0; y < image->height; y++) image_reduce_mask_row(mask, image, y);
    return OXL_OK;
}

/* ---------------- undistort */

struct image_warp {
    const struct pixels *source, *mask; /* (2) masks; data NULL: none */
    const struct colmap_camera *from;
    const oxl_camera *to;
    double zoom[2]; /* px of the image per px of `from`: 1 unless the file was resized */
    int samples;    /* samples per side of an output pixel */
};

/* Adds the bilinear sample at p (px) in units of 1/256^2; repeats the image's borders. */
static void image_add_bilinear(const struct pixels *in, const double p[2], uint32_t sum[3])
{
    const int fx = (int)floor((p[0] - 0.5) * IMAGE_FRACTION + 0.5),
              fy = (int)floor((p[1] - 0.5) * IMAGE_FRACTION + 0.5);
    const int x = OXL_CLAMP(fx, 0, (in->width - 1) * IMAGE_FRACTION),
              y = OXL_CLAMP(fy, 0, (in->height - 1) * IMAGE_FRACTION);
    const int x0 = x / IMAGE_FRACTION, y0 = y / IMAGE_FRACTION;
    const size_t right = x0 + 1 < in->width ? 3 : 0, down = y0 + 1 < in->height ? 3 * (size_t)in->width : 0;
    const uint32_t wx = (uint32_t)(x % IMAGE_FRACTION), wy = (uint32_t)(y % IMAGE_FRACTION);
    const uint8_t *a = in->data + 3 * ((size_t)y0 * in->width + x0);
    for (int c = 0; c < 3; c++, a++)
        sum[c] += (IMAGE_FRACTION - wy) * ((IMAGE_FRACTION - wx) * a[0] + wx * a[right]) +
                  wy * ((IMAGE_FRACTION - wx) * a[down] + wx * a[down + right]);
}

/* Returns 1 if p (px of the source image) is inside the image and not masked. */
static int image_is_valid_at(const struct image_warp *w, const double p[2])
{
    if (!(p[0] >= 0 && p[0] <= w->source->width && p[1] >= 0 && p[1] <= w->source->height)) return 0;
    for (const struct pixels *m = w->mask; m < w->mask + 2; m++) {
        const int x = OXL_MIN((int)(p[0] / w->source->width * m->width), m->width - 1);
        const int y = OXL_MIN((int)(p[1] / w->source->height * m->height), m->height - 1);
        if (m->data && m->data[(size_t)y * m->width + x] == 0) return 0;
    }
    return 1;
}

/* Computes a row: each pixel is the mean of samples x samples bilinear samples on a regular grid, and
 * masked if one of them is. */
static void image_warp_row(const struct image_warp *w, const struct training_image *out, int y)
{
    const size_t plane = (size_t)out->width * out->height;
    const uint32_t total = (uint32_t)(w->samples * w->samples) * IMAGE_FRACTION * IMAGE_FRACTION;
    for (int x = 0; x < out->width; x++) {
        uint32_t sum[3] = {0, 0, 0};
        int counts = 1;
        for (int i = 0; i < w->samples * w->samples; i++) {
            const double u = x + (i % w->samples + 0.5) / w->samples,
                         v = y + (i / w->samples + 0.5) / w->samples;
            const double direction[2] = {(u - w->to->cx) / w->to->fx, (v - w->to->cy) / w->to->fy};
            double p[2];
            camera_distort(w->from, direction, p);
            p[0] *= w->zoom[0];
            p[1] *= w->zoom[1];
            counts &= image_is_valid_at(w, p);
            if (counts) image_add_bilinear(w->source, p, sum);
        }
        for (int c = 0; c < 3; c++)
            out->rgb[c * plane + (size_t)y * out->width + x] =
                counts ? (uint8_t)(((uint64_t)sum[c] + total / 2) / total) : 0;
        out->mask[(size_t)y * out->width + x] = counts ? 255 : 0;
    }
}

static void image_undistort(const oxl_context *ctx, const struct pixels *image, const struct pixels mask[2],
                            const struct colmap_camera *from, const oxl_camera *to,
                            const struct training_image *out)
{
    struct image_warp w = {.source = image, .mask = mask, .from = from, .to = to};
    double k[4], reduction;
    (void)ctx; /* without OpenMP */
    camera_intrinsics(from, k);
    w.zoom[0] = (double)image->width / from->width;
    w.zoom[1] = (double)image->height / from->height;
    /* px of the image per output px at the axis */
    reduction = OXL_MAX(k[0] * w.zoom[0] / to->fx, k[1] * w.zoom[1] / to->fy);
    w.samples = (int)ceil(OXL_CLAMP(reduction - 0.01, 1, IMAGE_SAMPLES_MAX));
#pragma omp parallel for schedule(static) num_threads(ctx->threads)
    for (int y = 0; y < to->height; y++) image_warp_row(&w, out, y);
}

/* ---------------- a training image */

/* Refuses an image that was cropped or rotated since the COLMAP run. Accepts one that was resized, or that
 * its EXIF orientation turns into the camera's shape. */
OXL_INTERNAL oxl_result image_check_shape(oxl_context *ctx, const char *path, int width, int height,
                                          const struct colmap_camera *from)
{
    const int turned = image_has_shape(width, height, from->height, from->width);
    struct image_header header = {0};
    if (image_has_shape(width, height, from->width, from->height)) return OXL_OK;
    if (turned && image_read_header(ctx, path, &header) == OXL_OK && header.orientation >= 5) return OXL_OK;
    return oxl_fail(ctx, OXL_ERR_INPUT,
                    "%s has %d x %d px, but camera %lld (%s:%d) has %d x %d px, another aspect "
                    "ratio\nfix: %s",
                    path, width, height, (long long)from->id, from->file, from->line, from->width,
                    from->height,
                    turned ? "turn it: COLMAP saw the image upright, or before its pixels were turned"
                           : "use the images that COLMAP was given");
}

/* Turns an image by its EXIF orientation if the camera's shape shows that the model was made from it upright;
 * masks, too, if they have the shape of the stored image. */
static oxl_result image_turn_to_camera(oxl_context *ctx, const char *path, const struct colmap_camera *from,
                                       struct pixels *image, struct pixels mask[2])
{
    const int width = image->width, height = image->height;
    struct image_header header;
    oxl_result rc = image_check_shape(ctx, path, width, height, from);
    if (rc != OXL_OK || image_has_shape(width, height, from->width, from->height)) return rc;
    rc = image_read_header(ctx, path, &header);
    if (rc == OXL_OK) rc = image_turn(ctx, image, 3, header.orientation);
    for (int k = 0; k < 2 && rc == OXL_OK; k++)
        if (mask[k].data && image_has_shape(mask[k].width, mask[k].height, width, height))
            rc = image_turn(ctx, &mask[k], 1, header.orientation);
    return rc;
}

OXL_INTERNAL oxl_result image_training_alloc(oxl_context *ctx, const oxl_camera *to, int with_mask,
                                             struct training_image *out)
{
    const size_t count = (size_t)to->width * to->height;
    *out = (struct training_image){.width = to->width, .height = to->height};
    out->rgb = oxl_alloc(ctx, count, 3);
    if (with_mask) out->mask = oxl_alloc(ctx, count, 1);
    if (out->mask) memset(out->mask, 255, count);
    return out->rgb && (out->mask || !with_mask) ? OXL_OK : OXL_ERR_MEMORY;
}

/* Frees a mask without black pixels, which would cost time and memory. */
static void image_drop_empty_mask(oxl_context *ctx, struct training_image *image)
{
    if (!image->mask || memchr(image->mask, 0, (size_t)image->width * image->height)) return;
    oxl_free(ctx, image->mask);
    image->mask = NULL;
}

/* Refuses a mask that reduction and undistortion have made completely black. */
static oxl_result image_check_mask(oxl_context *ctx, const char *path, const struct training_image *image)
{
    if (!image->mask || memchr(image->mask, 255, (size_t)image->width * image->height)) return OXL_OK;
    return oxl_fail(ctx, OXL_ERR_INPUT,
                    "%s: the mask is all black at %d x %d px, so it excludes the whole image\n"
                    "fix: white (255) in a mask means that the pixel counts",
                    path, image->width, image->height);
}

/* ---------------- alpha */

enum { IMAGE_OPAQUE = 128 }; /* least alpha of a pixel that is not masked */

/* Turns four channels into three, in place: composites the colours by their alpha over the background. */
static void image_composite(struct pixels *image, const uint8_t background[3])
{
    const size_t count = (size_t)image->width * image->height;
    for (size_t i = 0; i < count; i++) {
        const unsigned alpha = image->data[4 * i + 3];
        for (size_t c = 0; c < 3; c++)
            image->data[3 * i + c] =
                (uint8_t)((image->data[4 * i + c] * alpha + background[c] * (255 - alpha) + 127) / 255);
    }
    image->channels = 3;
}

/* Turns four channels into three. *mask: black where the image is transparent; free it with oxl_free. */
static oxl_result image_move_alpha(oxl_context *ctx, struct pixels *image, struct pixels *mask)
{
    const size_t count = (size_t)image->width * image->height;
    *mask = (struct pixels){.width = image->width, .height = image->height, .data = oxl_alloc(ctx, count, 1)};
    if (!mask->data) return OXL_ERR_MEMORY;
    for (size_t i = 0; i < count; i++) {
        mask->data[i] = image->data[4 * i + 3] < IMAGE_OPAQUE ? 0 : 255;
        memmove(image->data + 3 * i, image->data + 4 * i, 3);
    }
    image->channels = 3;
    return OXL_OK;
}

/* Decodes, turns, then reduces or undistorts in one pass, so that each pixel is resampled once. */
OXL_INTERNAL oxl_result image_load_training(oxl_context *ctx, const char *path, const char *mask_path,
                                            const struct image_alpha *alpha, const struct colmap_camera *from,
                                            const oxl_camera *to, struct training_image *out)
{
    const int distorted = camera_is_distorted(from);
    struct pixels image = {0}, mask[2] = {{0}}; /* masks of the file mask_path, and of alpha */
    oxl_result rc = image_decode_of(ctx, path, alpha ? 0 : 3, from, &image);
    *out = (struct training_image){0};
    if (rc == OXL_OK && mask_path) rc = image_decode(ctx, mask_path, 1, &mask[0]);
    if (rc == OXL_OK && image.channels == 4 && alpha->masks) rc = image_move_alpha(ctx, &image, &mask[1]);
    if (rc == OXL_OK && image.channels == 4) image_composite(&image, alpha->background);
    if (rc == OXL_OK) rc = image_turn_to_camera(ctx, path, from, &image, mask);
    if (rc == OXL_OK) rc = image_training_alloc(ctx, to, distorted || mask[0].data || mask[1].data, out);
    if (rc == OXL_OK && distorted) image_undistort(ctx, &image, mask, from, to, out);
    if (rc == OXL_OK && !distorted) image_reduce(ctx, &image, out);
    for (int k = 0; k < 2 && rc == OXL_OK && !distorted; k++)
        if (mask[k].data) rc = image_add_mask(ctx, &mask[k], out);
    if (rc == OXL_OK) image_drop_empty_mask(ctx, out);
    if (rc == OXL_OK && (mask[0].data || mask[1].data))
        rc = image_check_mask(ctx, mask_path ? mask_path : path, out);
    image_pixels_free(ctx, &image);
    image_pixels_free(ctx, &mask[0]);
    oxl_free(ctx, mask[1].data);
    if (rc != OXL_OK) image_training_free(ctx, out);
    return rc;
}

OXL_INTERNAL void image_training_free(oxl_context *ctx, struct training_image *image)
{
    OXL_FREE(ctx, image->rgb, image->mask);
    *image = (struct training_image){0};
}

OXL_INTERNAL void image_from_training(const oxl_context *ctx, const struct training_image *image,
                                      const struct image_window *window, float *rgb, float *weight)
{
    const struct image_window whole = {0, 0, image->width, image->height}, w = window ? *window : whole;
    const int64_t rows = 3 * (int64_t)w.height;
    (void)ctx; /* without OpenMP */
#pragma omp parallel for schedule(static) num_threads(ctx->threads)
    for (int64_t row = 0; row < rows; row++) {
        const int64_t plane = row / w.height, y = row % w.height + w.y;
        const uint8_t *in = image->rgb + (plane * image->height + y) * image->width + w.x;
        float *out = rgb + row * w.width;
#pragma omp simd
        for (int i = 0; i < w.width; i++) out[i] = (float)in[i] / 255.0f;
    }
    for (int y = 0; weight && y < w.height; y++)
        for (int x = 0; x < w.width; x++)
            weight[(size_t)y * w.width + (size_t)x] =
                !image->mask || image->mask[(size_t)(y + w.y) * (size_t)image->width + (size_t)(x + w.x)]
                    ? 1.0f
                    : 0.0f;
}

/* Halves in place: a pixel is written only after its four source pixels are read. */
OXL_INTERNAL void image_halve(int width, int height, float *rgb, float *weight)
{
    const size_t w = (size_t)width, small_w = w / 2, small_h = (size_t)height / 2;
    for (size_t row = 0; row < 3 * small_h; row++) {
        const float *in = rgb + (row / small_h * (size_t)height + 2 * (row % small_h)) * w;
        float *out = rgb + row * small_w;
        for (size_t x = 0; x < small_w; x++)
            out[x] = 0.25f * (in[2 * x] + in[2 * x + 1] + in[w + 2 * x] + in[w + 2 * x + 1]);
    }
    for (size_t row = 0; weight && row < small_h; row++) {
        const float *in = weight + 2 * row * w;
        float *out = weight + row * small_w;
        for (size_t x = 0; x < small_w; x++)
            out[x] = in[2 * x] * in[2 * x + 1] * in[w + 2 * x] * in[w + 2 * x + 1];
    }
}

/* ---------------- public functions */

oxl_result oxl_image_create(oxl_context *ctx, int width, int height, oxl_image *out)
{
    *out = (oxl_image){0};
    if (width < 1 || height < 1 || width > IMAGE_SIDE_MAX || height > IMAGE_SIDE_MAX)
        return oxl_fail(ctx, OXL_ERR_USAGE, "an image of %d x %d px, expected 1 to %d a side", width, height,
                        IMAGE_SIDE_MAX);
    out->rgb = oxl_calloc(ctx, (size_t)width * height, 3 * sizeof *out->rgb);
    if (!out->rgb) return OXL_ERR_MEMORY;
    out->width = width;
    out->height = height;
    return OXL_OK;
}

void oxl_image_free(oxl_context *ctx, oxl_image *image)
{
    if (!image) return;
    OXL_FREE(ctx, image->rgb, image->weight);
    *image = (oxl_image){0};
}

oxl_result oxl_image_read(oxl_context *ctx, const char *path, oxl_image *out)
{
    struct pixels pixels = {0};
    oxl_result rc;
    *out = (oxl_image){0};
    rc = image_decode(ctx, path, 3, &pixels);
    if (rc == OXL_OK) rc = oxl_image_create(ctx, pixels.width, pixels.height, out);
    if (rc == OXL_OK) {
        const size_t count = (size_t)pixels.width * pixels.height;
        for (size_t i = 0; i < count; i++)
            for (int c = 0; c < 3; c++) out->rgb[c * count + i] = (float)pixels.data[3 * i + c] / 255.0f;
    }
    image_pixels_free(ctx, &pixels);
    return rc;
}

OXL_INTERNAL void image_to_training(const oxl_image *image, struct training_image *to)
{
    const size_t count = (size_t)image->width * image->height;
    for (size_t i = 0; i < 3 * count; i++) to->rgb[i] = image_to_byte(image->rgb[i]);
    for (size_t i = 0; to->mask && i < count; i++)
        to->mask[i] = !image->weight || image->weight[i] > 0.5f ? 255 : 0;
}
