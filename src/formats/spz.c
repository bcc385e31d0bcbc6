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
 * Its frame has x right, y up, z back; ours, COLMAP's and the standard PLY's, y down and z forward. That is a
 * rotation by 180 degrees about x, which changes signs only: of y and z of positions and of quaternions
 * (r q r^-1), and of spherical harmonics that are odd in y and z together. The comment of the gzip header
 * (RFC 1952, 2.3.1), which other readers skip, holds the lines that a PLY has as comments. The format has no
 * second lobes.
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

#define SPZ_COLOUR 0.15   /* Scales colours so that those slightly below 0 and above 1 are in range. */
#define SPZ_QUANTILE 0.99 /* Sets the quantile of the coordinates that counts as nearly all Gaussians. */
#define SPZ_ROOM 16.0     /* Sets the range that must be representable, in extents of nearly all Gaussians. */
#define SPZ_FIXED_MAX 8388606 /* Limits a coordinate to what 24 bits hold. */
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

/* Lists the signs of the change of frame: of the coefficients of degrees 1 to 3, by the basis of Kerbl 2023
 * (degree 1 y z x; 2 xy yz zz xz xx-yy; 3 in their order), and of coordinates. */
OXL_INTERNAL const signed char spz_turn_sh[15] = {-1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1};
static const signed char spz_turn[3] = {1, -1, -1};

/* Returns the bytes of a Gaussian. */
static size_t spz_row(int version, int degree)
{
    return 9 + 1 + 3 + 3 + (version == 2 ? 3 : 4) + 3 * (size_t)((degree + 1) * (degree + 1) - 1);
}

/* ---------------- gzip (RFC 1952) */

static oxl_result spz_fail(oxl_context *ctx, const char *path, const char *seen)
{
    return oxl_fail(
        ctx, OXL_ERR_INPUT,
        "%s: found %s, expected an SPZ file, version 2 or 3, of at most 2 GB\n"
        "fix: copy the file again, or write it as SPZ version 3 (splat-transform: --spz-version 3)",
        path, seen);
}

/* Returns the offset of the deflate data; 0: truncated header. Reads the comment's lines into the model. */
static size_t spz_gzip_header(oxl_context *ctx, const char *path, const struct os_file_map *file,
                              oxl_model *model)
{
    const char *p = file->data;
    const int flags = p[3];
    size_t at = 10;
    if (flags & 4) at += 2 + (size_t)bytes_get(p + 10, 2);
    for (int i = 8; i <= 16; i *= 2) { /* the name of a file (8) and the comment (16) */
        const size_t length = flags & i && at < file->size ? strlen(p + at) : 0;
        if (i == 16) model_read_comments(ctx, path, p + at, length, "", model);
        at += flags & i ? length + 1 : 0;
    }
    if (flags & 2) at += 2;
    return at + 8 < file->size ? at : 0;
}

/* Inflates the data into *out, allocated by oxl_alloc, and compares length and checksum. */
static oxl_result spz_unpack(oxl_context *ctx, const char *path, const struct os_file_map *file,
                             oxl_model *model, unsigned char **out, size_t *size)
{
    const char *p = file->data, *end = p + file->size;
    size_t at, packed;
    if (file->size > 4 && memcmp(p, "NGSP", 4) == 0) return spz_fail(ctx, path, "SPZ version 4 (zstd)");
    if (file->size < 20 || memcmp(p, "\x1f\x8b\x08", 3) != 0) return spz_fail(ctx, path, "no gzip header");
    at = spz_gzip_header(ctx, path, file, model);
    packed = at ? file->size - at - 8 : 0;
    *size = bytes_u32(end - 4);
    if (at == 0 || *size < SPZ_HEADER || *size > INT_MAX || *size / SPZ_DEFLATE_MAX > packed ||
        packed > INT_MAX)
        return spz_fail(ctx, path, "a gzip length that its data cannot have");
    *out = oxl_alloc(ctx, *size, 1);
    if (!*out) return OXL_ERR_MEMORY;
    /* Passes the 8 bytes that follow, too: stb 2.27 looks ahead past the last code. */
    if (!codec_inflate(*out, *size, p + at, packed + 8)) return spz_fail(ctx, path, "damaged gzip data");
    if (codec_png_checksum(*out, (int)*size) != bytes_u32(end - 8))
        return spz_fail(ctx, path, "data with a wrong checksum");
    return OXL_OK;
}

static oxl_result spz_pack(oxl_context *ctx, const char *path, const oxl_model *model,
                           const unsigned char *data, size_t size)
{
    /* bytes of zlib's header and checksum, which gzip has otherwise */
    enum { ZLIB_HEAD = 2, ZLIB_TAIL = 4 };
    struct text comment = {.ctx = ctx};
    struct os_writer w = {0};
    unsigned char tail[8];
    int length = 0;
    uint8_t *zlib = codec_deflate(ctx, data, size, &length);
    oxl_result rc;
    model_write_comments(&comment, "", model);
    rc = zlib && !comment.failed ? os_writer_open(ctx, path, &w) : OXL_ERR_MEMORY;
    if (rc == OXL_OK) {
        bytes_put(tail, codec_png_checksum(data, (int)size), 4);
        bytes_put(tail + 4, (uint32_t)size, 4);
        fwrite("\x1f\x8b\x08\x10\0\0\0\0\0\xff", 10, 1, w.file);
        fwrite(comment.data, comment.size + 1, 1, w.file);
        fwrite(zlib + ZLIB_HEAD, (size_t)length - ZLIB_HEAD - ZLIB_TAIL, 1, w.file);
        fwrite(tail, sizeof tail, 1, w.file); /* Leaves errors to os_writer_close. */
        rc = os_writer_close(ctx, &w, rc);
    }
    codec_free(ctx, zlib);
    text_free(&comment);
    return rc;
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

/* Version 2 has the first three components, of 8 bits. */
static void spz_get_rotation(const unsigned char *p, int version, double q[4])
{
    uint32_t bits = version == 2 ? 0 : bytes_u32(p);
    const int largest = version == 2 ? 3 : (int)(bits >> 30);
    double sum = 0;
    for (int i = 3; i >= 0; i--) {
        if (i == largest) continue;
        q[i] =
            version == 2 ? p[i] / 127.5 - 1 : SPZ_HALF_ROOT * (bits & 511) / 511 * (bits >> 9 & 1 ? -1 : 1);
        bits >>= 10;
        sum += q[i] * q[i];
    }
    q[largest] = sqrt(OXL_MAX(1 - sum, 0));
}

/* ---------------- reading: array after array */

static void spz_get(const unsigned char *data, int version, int coefficients, oxl_model *m)
{
    const unsigned char *p = data + SPZ_HEADER;
    const size_t n = m->count;
    const double step = 1.0 / (1 << data[13]);
    for (size_t i = 0; i < n; i++)
        for (int k = 0; k < 3; k++, p += 3)
            m->plane[OXL_MEAN + k][i] =
                (float)(spz_turn[k] * step * ((int32_t)bytes_get(p, 3) - (p[2] & 0x80 ? 1 << 24 : 0)));
    /* Moves the ends inwards, since they have no logit. */
    for (size_t i = 0; i < n; i++, p++)
        m->plane[OXL_OPACITY][i] = (float)vecmath_logit(OXL_CLAMP(*p, 0.25, 254.75) / 255);
    for (size_t i = 0; i < n; i++)
        for (int k = 0; k < 3; k++, p++) m->plane[OXL_SH + k][i] = (float)((*p / 255.0 - 0.5) / SPZ_COLOUR);
    for (size_t i = 0; i < n; i++)
        for (int k = 0; k < 3; k++, p++) m->plane[OXL_LOG_SCALE + k][i] = (float)(*p / 16.0 - 10);
    for (size_t i = 0; i < n; i++, p += version == 2 ? 3 : 4) {
        double q[4];
        spz_get_rotation(p, version, q);
        m->plane[OXL_ROTATION][i] = (float)q[3];
        for (int k = 0; k < 3; k++) m->plane[OXL_ROTATION + 1 + k][i] = (float)(spz_turn[k] * q[k]);
    }
    for (size_t i = 0; i < n; i++)
        for (int k = 0; k < coefficients; k++)
            for (int c = 0; c < 3; c++, p++)
                if (k < 15)
                    m->plane[OXL_SH + 3 * (k + 1) + c][i] = (float)(spz_turn_sh[k] * (*p - 128) / 128.0);
}

OXL_INTERNAL oxl_result spz_read(oxl_context *ctx, const char *path, oxl_model *out)
{
    struct os_file_map file = {0};
    oxl_model comments = {0};
    unsigned char *data = NULL;
    size_t size = 0, count = 0;
    int version = 0, degree = 0;
    char seen[120];
    oxl_result rc = os_read_file(ctx, path, &file);
    if (rc == OXL_OK) rc = spz_unpack(ctx, path, &file, &comments, &data, &size);
    os_release_file(ctx, &file);
    if (rc == OXL_OK && memcmp(data, "NGSP", 4) != 0) rc = os_refuse_gzip(ctx, path, "\x1f\x8b\x08", 3);
    else if (rc == OXL_OK) {
        version = (int)OXL_MIN(bytes_u32(data + 4), 9), count = bytes_u32(data + 8), degree = data[12];
        if (version < 2 || version > 3 || degree > SPZ_DEGREES || data[13] > 23 ||
            count > (size - SPZ_HEADER) / spz_row(version, degree)) {
            snprintf(seen, sizeof seen,
                     "version %d, degree %d, %d fractional bits and %zu Gaussians in %zu bytes", version,
                     degree, data[13], count, size);
            rc = spz_fail(ctx, path, seen);
        }
    }
    if (rc == OXL_OK) rc = oxl_model_create(ctx, count, OXL_MIN(degree, 3), out);
    if (rc == OXL_OK) {
        spz_get(data, version, (degree + 1) * (degree + 1) - 1, out);
        model_copy_rendering(&comments, out);
        memcpy(out->origin, comments.origin, sizeof out->origin);
        out->scale = comments.scale;
        out->antialias = (data[14] & SPZ_ANTIALIASED) != 0;
        if (degree > 3) oxl_log(ctx, OXL_LOG_WARNING, "%s: harmonics of degree 4 are left out", path);
    }
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
static double spz_shrink(const oxl_model *m, int bits, size_t row)
{
    const double range = (double)SPZ_FIXED_MAX / (1 << bits);
    double farthest = 0;
    for (int k = 0; k < 3; k++) farthest = OXL_MAX(farthest, fabs((double)m->plane[OXL_MEAN + k][row]));
    return farthest > range ? range / farthest : 1;
}

/* Writes array after array; returns the number of Gaussians beyond the format's range. */
static size_t spz_put(const oxl_model *m, int bits, unsigned char *data)
{
    unsigned char *p = data + SPZ_HEADER, *scales = p + 13 * m->count;
    const size_t n = m->count;
    size_t limited = 0;
    for (size_t i = 0; i < n; i++) {
        const double shrink = spz_shrink(m, bits, i);
        double widest = -HUGE_VAL;
        for (int k = 0; k < 3; k++, p += 3) {
            const double log_scale = m->plane[OXL_LOG_SCALE + k][i] + vecmath_log(shrink);
            bytes_put(p,
                      (uint32_t)(int32_t)floor(
                          spz_turn[k] * shrink * m->plane[OXL_MEAN + k][i] * (1 << bits) + 0.5),
                      3);
            *scales++ = model_byte(16 * (log_scale + 10.0));
            widest = OXL_MAX(widest, log_scale);
        }
        limited += shrink < 1 || widest < SPZ_LOG_SCALE_MIN || widest > SPZ_LOG_SCALE_MAX;
    }
    for (size_t i = 0; i < n; i++) *p++ = model_byte(255 * vecmath_sigmoid(m->plane[OXL_OPACITY][i]));
    for (size_t i = 0; i < n; i++)
        for (int k = 0; k < 3; k++) *p++ = model_byte(255 * (SPZ_COLOUR * m->plane[OXL_SH + k][i] + 0.5));
    p = scales;
    for (size_t i = 0; i < n; i++, p += 4) {
        double q[4], xyzw[4];
        model_rotation(m, i, q);
        for (int k = 0; k < 3; k++) xyzw[k] = spz_turn[k] * q[k + 1];
        xyzw[3] = q[0];
        bytes_put(p, spz_put_rotation(xyzw), 4);
    }
    for (size_t i = 0; i < n; i++)
        for (int k = 0; k < (m->sh_degree + 1) * (m->sh_degree + 1) - 1; k++)
            for (int c = 0; c < 3; c++)
                *p++ = spz_coefficient(spz_turn_sh[k] * (double)m->plane[OXL_SH + 3 * (k + 1) + c][i],
                                       k < 3 ? SPZ_BUCKET_1 : SPZ_BUCKET);
    return limited;
}

/* Chooses the fractional bits so that SPZ_ROOM times the extent of nearly all Gaussians is in range: a few
 * that lie far out must not cost the others their precision. value: (rows) working memory. */
static int spz_bits(const oxl_model *model, double *value)
{
    double farthest = 0, size = 0;
    int bits = SPZ_BITS_MAX;
    for (int k = 0; k < 3 && model->count; k++) {
        for (size_t i = 0; i < model->count; i++) {
            value[i] = fabs((double)model->plane[OXL_MEAN + k][i]);
            farthest = OXL_MAX(farthest, value[i]);
        }
        size = OXL_MAX(size, stats_select(value, model->count, SPZ_QUANTILE));
    }
    farthest = OXL_MIN(farthest, OXL_MAX(SPZ_ROOM * size, DBL_MIN));
    while (bits > 0 && farthest * (1 << bits) > SPZ_FIXED_MAX) bits--;
    return bits;
}

OXL_INTERNAL oxl_result spz_write(oxl_context *ctx, const char *path, const oxl_model *model)
{
    const size_t n = model->count, size = SPZ_HEADER + n * spz_row(3, model->sh_degree);
    unsigned char *data = size > INT_MAX ? NULL : oxl_calloc(ctx, size, 1);
    double *value = oxl_alloc(ctx, n + 1, sizeof *value);
    oxl_result rc = model_write_check_finite(ctx, path, model);
    if (rc == OXL_OK && size > INT_MAX)
        rc = oxl_fail(ctx, OXL_ERR_FAILED,
                      "%s: SPZ stores 2 GB of data; this model exceeds that\nfix: write it as .ply", path);
    else if (rc == OXL_OK && !(data && value)) rc = OXL_ERR_MEMORY;
    if (rc == OXL_OK) {
        const int bits = spz_bits(model, value);
        const size_t limited = spz_put(model, bits, data);
        memcpy(data, "NGSP\3\0\0", 8);
        bytes_put(data + 8, n, 4);
        data[12] = (unsigned char)model->sh_degree;
        data[13] = (unsigned char)bits;
        data[14] = model->antialias ? SPZ_ANTIALIASED : 0;
        if (limited)
            oxl_log(ctx, OXL_LOG_WARNING,
                    "%s: %zu of %zu Gaussians are beyond the format's range (positions up to %g, widths from "
                    "4.5e-5 to 365 units) and are clamped to it\n"
                    "fix: if that is many, write the model in another unit (convert has --scale)",
                    path, limited, n, (double)SPZ_FIXED_MAX / (1 << bits));
        rc = spz_pack(ctx, path, model, data, size);
    }
    OXL_FREE(ctx, data, value);
    return rc;
}
