/* spz.c - reads models as SPZ version 2 and 3, and writes version 3.
 *
 * Source: nianticlabs/spz (README.md, src/cc/load-spz.cc). One gzip member around 16 bytes and six arrays,
 * little endian:
 *
 *     u32 "NGSP"  u32 version  u32 count N  u8 degree  u8 fractional bits  u8 flags  u8 0
 *     positions (N,3) signed 24 bits, fixed point      alphas (N) u8 = 255 sigmoid
 *     colours (N,3) u8 = 255 (0.15 f_dc + 0.5)         log scales (N,3) u8 = 16 (s + 10)
 *     rotations (N) u32: the index of the largest of x y z w, then the others as sign and 9 bits of 511 q
 *     sqrt(2); version 2: x y z, u8 harmonics past degree 0 (N, coefficients, 3) u8 = 128 c + 128, written in
 *     buckets of 2 (degree 1) and 4
 *
 * The frame is converted (frame_flip.h). Origin and scale are in the comment of the gzip header (RFC 1952,
 * 2.3.1), "origin X Y Z", "scale S" and others separated by newlines, which other readers skip. The format
 * has no second lobes.
 *
 * Invariant: lengths are checked against the file size before allocation; deflate expands a byte to at most
 * 1032 bytes.
 */
#include "../survey/image.h"
#include "../core/codec.h"
#include "../survey/survey.h"
#include "formats.h"

#include "../core/bytes.h"
#include "../core/vecmath.h"
#include "frame_flip.h"

#define SPZ_COLOUR 0.15   /* Scales colours so that those slightly below 0 and above 1 are in range. */
#define SPZ_QUANTILE 0.99 /* Sets the quantile of the coordinates that counts as nearly all Gaussians. */
#define SPZ_ROOM 16.0     /* Sets the range that must be representable, in extents of nearly all Gaussians. */
/* Sets the step of positions, in extents of nearly all Gaussians, above which a warning is logged. */
#define SPZ_COARSE 1e-4
#define SPZ_FIXED_MAX 8388606 /* Limits a coordinate to what 24 bits hold. */
#define SPZ_FEW 1000          /* Allows one of so many Gaussians to be limited without a warning. */
#define SPZ_LOG_SCALE_MIN -10.0
#define SPZ_LOG_SCALE_MAX 5.9375
#define SPZ_DEFLATE_MAX 1032 /* Bounds the expansion of deflate: 258 bytes from 2 bits. */

enum {
    SPZ_HEADER = 16,
    SPZ_ANTIALIASED = 1, /* bit of the flags */
    SPZ_BITS_MAX = 20,   /* most fractional bits; the reference writes 12 */
    /* bucket of degree 1, in 1/128; the reference's 8 (and 16 above) lose 0.7 dB for a model of degree 3 */
    SPZ_BUCKET_1 = 2,
    SPZ_BUCKET = 4, /* bucket of higher degrees; both together lose 0.07 dB, at 1.6 times the size */
    SPZ_DEGREES = 4 /* highest degree of the reference; coefficients of degree 4 are skipped */
};

/* ---------------- gzip (RFC 1952) */

static oxl_result spz_fail(oxl_context *ctx, const char *path, const char *seen, const char *wanted)
{
    return oxl_fail(
        ctx, OXL_ERR_INPUT,
        "%s: found %s, expected %s\nfix: copy the file again, or write it as SPZ version 3 (splat-transform: --spz-version 3)",
        path, seen, wanted);
}

/* Returns the offset of the deflate data; 0: truncated header. *comment: offset of the comment; 0: none. */
static size_t spz_gzip_header(const unsigned char *p, size_t size, size_t *comment)
{
    const int flags = p[3];
    size_t at = 10;
    *comment = 0;
    if (flags & 4) at += 2 + (size_t)(p[10] | p[11] << 8);
    for (int i = 8; i <= 16; i *= 2) { /* Skips the name of a file (8) and the comment (16). */
        if (!(flags & i)) continue;
        if (i == 16) *comment = at;
        while (at < size && p[at]) at++;
        at++;
    }
    if (flags & 2) at += 2;
    return at + 8 < size ? at : 0;
}

/* Inflates the data into *out, allocated by oxl_alloc, and compares length and checksum. */
static oxl_result spz_unpack(oxl_context *ctx, const char *path, const struct os_file_map *file,
                             unsigned char **out, size_t *size)
{
    const unsigned char *p = (const unsigned char *)file->data;
    size_t at, packed, comment;
    if (file->size > 4 && memcmp(p, "NGSP", 4) == 0)
        return spz_fail(ctx, path, "SPZ version 4 (zstd)", "version 2 or 3 (gzip)");
    if (file->size < 20 || p[0] != 0x1f || p[1] != 0x8b || p[2] != 8)
        return spz_fail(ctx, path, "no gzip header", "an SPZ file");
    at = spz_gzip_header(p, file->size, &comment);
    packed = at ? file->size - at - 8 : 0;
    *size = bytes_u32(p + file->size - 4);
    if (at == 0 || *size < SPZ_HEADER || *size > INT_MAX || *size / SPZ_DEFLATE_MAX > packed ||
        packed > INT_MAX)
        return spz_fail(ctx, path, "a gzip length that its data cannot have", "an SPZ file of at most 2 GB");
    *out = oxl_alloc(ctx, *size, 1);
    if (!*out) return oxl_fail(ctx, OXL_ERR_MEMORY, "%s: no memory for its %zu bytes", path, *size);
    /* Passes the 8 bytes that follow, too: stb 2.27 looks ahead past the last code. */
    if (!codec_inflate(ctx, *out, *size, p + at, packed + 8))
        return strcmp(codec_failure(), "outofmem") == 0
                   ? oxl_fail(ctx, OXL_ERR_MEMORY, "%s: no memory to inflate it", path)
                   : spz_fail(ctx, path, "gzip data that are damaged", "an SPZ file");
    if (codec_png_checksum(*out, (int)*size) != bytes_u32(p + file->size - 8))
        return spz_fail(ctx, path, "another checksum", "the one it was written with");
    return OXL_OK;
}

static void spz_read_comment(oxl_context *ctx, const char *path, const char *comment, oxl_model *model)
{
    char line[128];
    while (*comment) {
        const size_t length = strcspn(comment, "\n");
        snprintf(line, sizeof line, "%.*s", (int)OXL_MIN(length, sizeof line - 1), comment);
        model_read_comment(ctx, path, line, model);
        comment += length + (comment[length] != 0);
    }
}

/* Writes the gzip header, with a comment if there is an origin, scale, background or view. */
static void spz_add_header(struct text *t, const oxl_model *model)
{
    const int placed = model->origin[0] != 0 || model->origin[1] != 0 || model->origin[2] != 0;
    const int known = placed || model->scale > 0;
    const int commented = known || model->has_background || model->view[0] > 0;
    text_add(t, "\x1f\x8b\x08%c%c%c%c%c%c\xff", commented ? 16 : 0, 0, 0, 0, 0, 0);
    if (placed)
        text_add(t, "origin %s %s %s", NUMBER(model->origin[0]), NUMBER(model->origin[1]),
                 NUMBER(model->origin[2]));
    if (model->scale > 0) text_add(t, "%sscale %s", placed ? "\n" : "", NUMBER(model->scale));
    model_write_background(t, known ? "\n" : "", model);
    model_write_view(t, known || model->has_background ? "\n" : "", model);
    if (commented) text_add(t, "%c", 0);
}

static oxl_result spz_pack(oxl_context *ctx, const char *path, const oxl_model *model,
                           const unsigned char *data, size_t size)
{
    struct text head = {.ctx = ctx};
    unsigned char *all = NULL;
    size_t deflated = 0;
    oxl_result rc;
    spz_add_header(&head, model);
    rc = head.failed ? OXL_ERR_MEMORY : image_deflate(ctx, data, size, head.size, 8, &all, &deflated);
    if (rc == OXL_OK) {
        memcpy(all, head.data, head.size);
        bytes_put(all + head.size + deflated, codec_png_checksum(data, (int)size), 4);
        bytes_put(all + head.size + deflated + 4, (uint32_t)size, 4);
        rc = os_write_file(ctx, path, all, head.size + deflated + 8);
    }
    oxl_free(ctx, all);
    text_free(&head);
    return rc;
}

/* ---------------- where things lie */

struct spz_layout {
    int version, degree, bits, flags, coefficients; /* per channel past degree 0, in the file */
    size_t count, alphas, colours, scales, rotations, sh, end;
};

static void spz_lay_out(struct spz_layout *l)
{
    l->coefficients = (l->degree + 1) * (l->degree + 1) - 1;
    l->alphas = SPZ_HEADER + 9 * l->count;
    l->colours = l->alphas + l->count;
    l->scales = l->colours + 3 * l->count;
    l->rotations = l->scales + 3 * l->count;
    l->sh = l->rotations + (l->version == 2 ? 3 : 4) * l->count;
    l->end = l->sh + 3 * (size_t)l->coefficients * l->count;
}

/* ---------------- rotations: x y z w */

#define SPZ_HALF_ROOT 0.70710678118654752 /* Bounds the second largest component of a unit quaternion. */

/* Stores the index of the largest component and the other three; the signs are those of the quaternion that
 * makes the largest positive. */
static uint32_t spz_put_rotation(const double q[4])
{
    uint32_t bits = 0;
    int largest = 0;
    for (int i = 1; i < 4; i++)
        if (fabs(q[i]) > fabs(q[largest])) largest = i;
    bits = (uint32_t)largest;
    for (int i = 0; i < 4; i++) {
        const double size = 511 * fabs(q[i]) / SPZ_HALF_ROOT + 0.5;
        if (i == largest) continue;
        bits = bits << 10 | (uint32_t)((q[i] < 0) != (q[largest] < 0)) << 9 | (uint32_t)OXL_MIN(size, 511);
    }
    return bits;
}

static void spz_get_rotation(uint32_t bits, double q[4])
{
    const int largest = (int)(bits >> 30);
    double sum = 0;
    for (int i = 3; i >= 0; i--) {
        if (i == largest) continue;
        q[i] = SPZ_HALF_ROOT * (bits & 511) / 511 * (bits >> 9 & 1 ? -1 : 1);
        bits >>= 10;
        sum += q[i] * q[i];
    }
    q[largest] = sqrt(OXL_MAX(1 - sum, 0));
}

/* Reads a rotation of version 2: three components of 8 bits. */
static void spz_get_first_three(const unsigned char *p, double q[4])
{
    double sum = 0;
    for (int i = 0; i < 3; i++) {
        q[i] = p[i] / 127.5 - 1;
        sum += q[i] * q[i];
    }
    q[3] = sqrt(OXL_MAX(1 - sum, 0));
}

/* ---------------- reading */

static oxl_result spz_read_header(oxl_context *ctx, const char *path, const unsigned char *data, size_t size,
                                  struct spz_layout *l)
{
    char seen[100];
    uint32_t version = bytes_u32(data + 4);
    if (memcmp(data, "NGSP", 4) != 0) return os_refuse_gzip(ctx, path, "\x1f\x8b\x08", 3);
    if (version < 2 || version > 3) {
        snprintf(seen, sizeof seen, "SPZ version %lu", (unsigned long)version);
        return spz_fail(ctx, path, seen, "version 2 or 3");
    }
    *l = (struct spz_layout){.version = (int)version,
                             .count = bytes_u32(data + 8),
                             .degree = data[12],
                             .bits = data[13],
                             .flags = data[14]};
    if (l->degree > SPZ_DEGREES || l->bits > 23) {
        snprintf(seen, sizeof seen, "degree %d and %d fractional bits", l->degree, l->bits);
        return spz_fail(ctx, path, seen, "degree 0 to 4 and 0 to 23 bits");
    }
    /* Guards spz_lay_out against overflow; 19: least bytes of a Gaussian, in version 2. */
    if (l->count <= (size - SPZ_HEADER) / 19) spz_lay_out(l);
    if (l->end == 0 || l->end > size) {
        snprintf(seen, sizeof seen, "%zu Gaussians of degree %d in %zu bytes", l->count, l->degree, size);
        return spz_fail(ctx, path, seen, "the bytes for them");
    }
    return OXL_OK;
}

static void spz_get(const unsigned char *data, const struct spz_layout *l, oxl_model *model, size_t row)
{
    const double turn[3] = {1, -1, -1}, step = 1.0 / (1 << l->bits);
    /* Moves the ends inwards, since they have no logit. */
    const double alpha = OXL_CLAMP(data[l->alphas + row], 0.25, 254.75) / 255;
    double q[4];
    for (int i = 0; i < 3; i++) {
        const unsigned char *p = data + SPZ_HEADER + 9 * row + 3 * (size_t)i;
        const int32_t fixed = (int32_t)(p[0] | p[1] << 8 | p[2] << 16) - (p[2] & 0x80 ? 1 << 24 : 0);
        model->plane[OXL_MEAN + i][row] = (float)(turn[i] * fixed * step);
        model->plane[OXL_SH + i][row] =
            (float)((data[l->colours + 3 * row + (size_t)i] / 255.0 - 0.5) / SPZ_COLOUR);
        model->plane[OXL_LOG_SCALE + i][row] = (float)(data[l->scales + 3 * row + (size_t)i] / 16.0 - 10);
    }
    model->plane[OXL_OPACITY][row] = (float)vecmath_logit(alpha);
    if (l->version == 2) spz_get_first_three(data + l->rotations + 3 * row, q);
    else spz_get_rotation(bytes_u32(data + l->rotations + 4 * row), q);
    model->plane[OXL_ROTATION][row] = (float)q[3];
    for (int i = 0; i < 3; i++) model->plane[OXL_ROTATION + 1 + i][row] = (float)(turn[i] * q[i]);
    for (int k = 0; k < OXL_MIN(l->coefficients, 15); k++)
        for (int c = 0; c < 3; c++)
            model->plane[OXL_SH + 3 * (k + 1) + c][row] =
                (float)(frame_flip_sh[k] *
                        (data[l->sh + 3 * ((size_t)l->coefficients * row + (size_t)k) + (size_t)c] - 128) /
                        128.0);
}

OXL_INTERNAL oxl_result spz_read(oxl_context *ctx, const char *path, oxl_model *out)
{
    struct os_file_map file = {0};
    struct spz_layout l = {0};
    unsigned char *data = NULL;
    size_t size = 0, comment = 0;
    oxl_result rc = os_read_file(ctx, path, &file);
    if (rc == OXL_OK) rc = spz_unpack(ctx, path, &file, &data, &size);
    if (rc == OXL_OK) rc = spz_read_header(ctx, path, data, size, &l);
    if (rc == OXL_OK) rc = oxl_model_create(ctx, l.count, OXL_MIN(l.degree, 3), out);
    for (size_t i = 0; rc == OXL_OK && i < l.count; i++) spz_get(data, &l, out, i);
    if (rc == OXL_OK) {
        out->antialias = (l.flags & SPZ_ANTIALIASED) != 0;
        spz_gzip_header((const unsigned char *)file.data, file.size, &comment);
        if (comment) spz_read_comment(ctx, path, file.data + comment, out);
    }
    if (rc == OXL_OK && l.degree > 3)
        oxl_log(ctx, OXL_LOG_WARNING, "%s: harmonics of degree 4 are left out", path);
    os_release_file(ctx, &file);
    oxl_free(ctx, data);
    return rc;
}

/* ---------------- writing */

/* Quantises a coefficient to buckets, which compress better; 0 is the centre of a bucket. */
static unsigned char spz_coefficient(double value, int bucket)
{
    /* Rounds; 1024 keeps the cast from truncating towards 0 below 0. */
    const int q = (int)(OXL_CLAMP(value, -2, 2) * 128 + 128.5 + 1024) - 1024;
    return (unsigned char)OXL_CLAMP((q + bucket / 2 + 1024) / bucket * bucket - 1024, 0, 255);
}

/* Returns the factor by which a Gaussian beyond the range is drawn in to its border and made smaller: from
 * the scene it looks the same. */
static double spz_shrink(const oxl_model *model, const struct spz_layout *l, size_t row)
{
    const double range = (double)SPZ_FIXED_MAX / (1 << l->bits);
    double farthest = 0;
    for (int k = 0; k < 3; k++) farthest = OXL_MAX(farthest, fabs((double)model->plane[OXL_MEAN + k][row]));
    return farthest > range ? range / farthest : 1;
}

static void spz_put(const oxl_model *model, const struct spz_layout *l, size_t row, unsigned char *data)
{
    const double turn[3] = {1, -1, -1}, shrink = spz_shrink(model, l, row), log_shrink = vecmath_log(shrink);
    double q[4], xyzw[4];
    for (int i = 0; i < 3; i++) {
        const int32_t fixed =
            (int32_t)floor(turn[i] * shrink * model->plane[OXL_MEAN + i][row] * (1 << l->bits) + 0.5);
        bytes_put(data + SPZ_HEADER + 9 * row + 3 * (size_t)i, (uint32_t)fixed, 3);
        data[l->colours + 3 * row + (size_t)i] =
            model_byte(255 * (SPZ_COLOUR * model->plane[OXL_SH + i][row] + 0.5));
        data[l->scales + 3 * row + (size_t)i] =
            model_byte(16 * (model->plane[OXL_LOG_SCALE + i][row] + log_shrink + 10.0));
    }
    data[l->alphas + row] = model_byte(255 * vecmath_sigmoid(model->plane[OXL_OPACITY][row]));
    model_rotation(model, row, q);
    for (int i = 0; i < 3; i++) xyzw[i] = turn[i] * q[i + 1];
    xyzw[3] = q[0];
    bytes_put(data + l->rotations + 4 * row, spz_put_rotation(xyzw), 4);
    for (int k = 0; k < l->coefficients; k++)
        for (int c = 0; c < 3; c++)
            data[l->sh + 3 * ((size_t)l->coefficients * row + (size_t)k) + (size_t)c] =
                spz_coefficient(frame_flip_sh[k] * (double)model->plane[OXL_SH + 3 * (k + 1) + c][row],
                                k < 3 ? SPZ_BUCKET_1 : SPZ_BUCKET);
}

/* Chooses the fractional bits so that SPZ_ROOM times the extent of nearly all Gaussians is in range: a few
 * that lie far out must not cost the others their precision. *spread: that extent. */
static oxl_result spz_bits(oxl_context *ctx, const oxl_model *model, int *bits, double *spread)
{
    double *value = oxl_alloc(ctx, model->count + 1, sizeof *value), farthest = 0, size = 0;
    *bits = SPZ_BITS_MAX;
    *spread = 0;
    if (!value) return OXL_ERR_MEMORY;
    for (int k = 0; k < 3; k++) {
        const float *plane = model->plane[OXL_MEAN + k];
        double low, high;
        for (size_t i = 0; i < model->count; i++) {
            value[i] = plane[i];
            farthest = OXL_MAX(farthest, fabs(value[i]));
        }
        if (model->count == 0) break;
        low = stats_select(value, model->count, 1 - SPZ_QUANTILE);
        high = stats_select(value, model->count, SPZ_QUANTILE);
        size = OXL_MAX(size, OXL_MAX(fabs(low), fabs(high)));
        *spread = OXL_MAX(*spread, high - low);
    }
    oxl_free(ctx, value);
    farthest = OXL_MIN(farthest, OXL_MAX(SPZ_ROOM * size, DBL_MIN));
    while (*bits > 0 && farthest * (1 << *bits) > SPZ_FIXED_MAX) --*bits;
    return OXL_OK;
}

/* Warns of what the format cannot hold, once per kind. */
static void spz_warn(oxl_context *ctx, const char *path, const oxl_model *model, const struct spz_layout *l,
                     double spread)
{
    const double step = 1.0 / (1 << l->bits);
    size_t far = 0, small = 0, large = 0;
    for (size_t i = 0; i < model->count; i++) {
        const double shrink = spz_shrink(model, l, i), log_shrink = vecmath_log(shrink);
        double widest = -HUGE_VAL;
        far += shrink < 1;
        for (int k = 0; k < 3; k++) widest = OXL_MAX(widest, model->plane[OXL_LOG_SCALE + k][i] + log_shrink);
        small += widest < SPZ_LOG_SCALE_MIN;
        large += widest > SPZ_LOG_SCALE_MAX;
    }
    if (far)
        oxl_log(ctx, OXL_LOG_WARNING,
                "%s: %zu of %zu Gaussians lie beyond the format's range of %g units, and are drawn in to it",
                path, far, model->count, SPZ_FIXED_MAX * step);
    if ((small + large) * SPZ_FEW > model->count)
        oxl_log(
            ctx, OXL_LOG_WARNING,
            "%s: the widths of %zu of %zu Gaussians are outside the format's range, 4.5e-5 to 365 units, and are limited to it\n"
            "fix: write the model in another unit (convert has --scale)",
            path, small + large, model->count);
    if (spread > 0 && step > SPZ_COARSE * spread)
        oxl_log(
            ctx, OXL_LOG_WARNING,
            "%s: positions are rounded to %g units, since the model lies far from its origin or is large\n"
            "fix: keep the .ply, too; or write it in a larger unit (--scale)",
            path, step);
}

OXL_INTERNAL oxl_result spz_write(oxl_context *ctx, const char *path, const oxl_model *model)
{
    struct spz_layout l = {.version = 3, .degree = model->sh_degree, .count = model->count};
    unsigned char *data = NULL;
    double spread = 0;
    oxl_result rc = spz_bits(ctx, model, &l.bits, &spread);
    if (rc != OXL_OK) return rc;
    spz_lay_out(&l);
    if (l.end > INT_MAX)
        return oxl_fail(ctx, OXL_ERR_FAILED,
                        "%s: SPZ stores 2 GB of data; this model exceeds that\nfix: write it as .ply", path);
    spz_warn(ctx, path, model, &l, spread);
    data = oxl_calloc(ctx, l.end, 1);
    if (!data) return oxl_fail(ctx, OXL_ERR_MEMORY, "%s: no memory for its %zu bytes", path, l.end);
    memcpy(data, "NGSP", 4);
    bytes_put(data + 4, 3, 4);
    bytes_put(data + 8, (uint32_t)l.count, 4);
    data[12] = (unsigned char)l.degree;
    data[13] = (unsigned char)l.bits;
    data[14] = model->antialias ? SPZ_ANTIALIASED : 0;
    for (size_t i = 0; i < l.count; i++) spz_put(model, &l, i, data);
    rc = spz_pack(ctx, path, model, data, l.end);
    oxl_free(ctx, data);
    return rc;
}
