/* splat_file.c - reads and writes models as .splat, the format of web viewers: 32 bytes per Gaussian, no
 * view-dependent colour.
 *
 *     byte  0  position  3 float        24  colour   R G B A, 8 bits each
 *          12  scale     3 float        28  rotation w x y z, q * 128 + 128
 *
 * Source: antimatter15's viewer.
 */
#include "formats.h"

#include "../core/bytes.h"
#include "../core/vecmath.h"

enum { SPLAT_FILE_BYTES = 32 };

static void splat_file_put(const oxl_model *model, size_t row, unsigned char *p)
{
    double q[4];
    model_rotation(model, row, q);
    for (int i = 0; i < 3; i++) {
        const double scale = vecmath_exp(model->plane[OXL_LOG_SCALE + i][row]);
        bytes_put_float(p + 4 * i, model->plane[OXL_MEAN + i][row]);
        bytes_put_float(p + 12 + 4 * i, (float)OXL_MIN(scale, FLT_MAX));
        p[24 + i] = model_byte(255 * (0.5 + MODEL_SH0 * model->plane[OXL_SH + i][row]));
    }
    p[27] = model_byte(255 * vecmath_sigmoid(model->plane[OXL_OPACITY][row]));
    for (int i = 0; i < 4; i++) p[28 + i] = model_byte(128 * q[i] + 128);
}

/* Reads a Gaussian. Its limits have no finite raw value: alpha 0 and 255 move inwards by a quarter step,
 * which converts back to the same byte, and scale 0 becomes the smallest normal float. logs 1: the widths
 * are logarithms. */
static void splat_file_get(const unsigned char *p, oxl_model *model, size_t row, int logs)
{
    const double alpha = OXL_CLAMP(p[27], 0.25, 254.75) / 255;
    int zero = 1;
    for (int i = 0; i < 3; i++) {
        const float scale = bytes_float(p + 12 + 4 * i);
        model->plane[OXL_MEAN + i][row] = bytes_float(p + 4 * i);
        model->plane[OXL_LOG_SCALE + i][row] =
            logs ? scale : (float)vecmath_log(scale >= 0 && scale < FLT_MIN ? FLT_MIN : scale);
        model->plane[OXL_SH + i][row] = (float)((p[24 + i] / 255.0 - 0.5) / MODEL_SH0);
    }
    model->plane[OXL_OPACITY][row] = (float)vecmath_logit(alpha);
    for (int i = 0; i < 4; i++) zero &= p[28 + i] == 128;
    for (int i = 0; i < 4; i++)
        model->plane[OXL_ROTATION + i][row] = zero ? i == 0 : (float)((p[28 + i] - 128) / 128.0);
}

struct splat_file_rank {
    double weight; /* opacity x volume */
    size_t row;
};

static int splat_file_by_weight(const void *a, const void *b)
{
    const struct splat_file_rank *x = a, *y = b;
    if (x->weight != y->weight) return x->weight > y->weight ? -1 : 1;
    return x->row < y->row ? -1 : x->row > y->row;
}

/* Warns of what a .splat does not store. */
static void splat_file_warn(oxl_context *ctx, const char *path, const oxl_model *model)
{
    const double *o = model->origin;
    struct text t = {.ctx = ctx};
    if (model->sh_degree > 0) text_add(&t, ", spherical harmonics above degree 0");
    if (o[0] != 0 || o[1] != 0 || o[2] != 0)
        text_add(&t, ", the origin %s %s %s", NUMBER(o[0]), NUMBER(o[1]), NUMBER(o[2]));
    if (model->scale > 0) text_add(&t, ", the scale %g", model->scale);
    if (model->antialias) text_add(&t, ", that the model is anti-aliased");
    if (model->has_background) text_add(&t, ", the background");
    if (t.data)
        oxl_log(ctx, OXL_LOG_WARNING,
                "%s: a .splat cannot store %s: eval, render and viewers will show another image\n"
                "fix: keep the .ply or an .spz, too",
                path, t.data + 2);
    text_free(&t);
}

/* Writes the most visible Gaussians first, for viewers that load a .splat progressively. */
OXL_INTERNAL oxl_result splat_file_write(oxl_context *ctx, const char *path, const oxl_model *model)
{
    struct splat_file_rank *rank = oxl_alloc(ctx, model->count, sizeof *rank);
    struct os_writer w = {0};
    oxl_result rc = rank ? model_write_check_finite(ctx, path, model) : OXL_ERR_MEMORY;
    if (rc == OXL_OK) rc = os_writer_open(ctx, path, &w);
    if (rc == OXL_OK) {
        splat_file_warn(ctx, path, model);
        for (size_t i = 0; i < model->count; i++) {
            double volume = 0; /* its logarithm */
            for (int k = 0; k < 3; k++) volume += model->plane[OXL_LOG_SCALE + k][i];
            rank[i].weight = vecmath_exp(volume) * vecmath_sigmoid(model->plane[OXL_OPACITY][i]);
            rank[i].row = i;
        }
        qsort(rank, model->count, sizeof *rank, splat_file_by_weight);
        for (size_t i = 0; i < model->count; i++) {
            unsigned char splat[SPLAT_FILE_BYTES];
            splat_file_put(model, rank[i].row, splat);
            fwrite(splat, 1, sizeof splat, w.file); /* Leaves errors to os_writer_close. */
        }
        rc = os_writer_close(ctx, &w, rc);
    }
    oxl_free(ctx, rank);
    return rc;
}

OXL_INTERNAL oxl_result splat_file_read(oxl_context *ctx, const char *path, oxl_model *out)
{
    struct os_file_map file = {0};
    size_t negative = 0;
    oxl_result rc = os_read_file(ctx, path, &file);
    const unsigned char *p = (const unsigned char *)file.data;
    if (rc == OXL_OK && file.size % SPLAT_FILE_BYTES)
        rc = oxl_fail(
            ctx, OXL_ERR_INPUT,
            "%s: %zu bytes, expected a multiple of 32\nfix: the file was cut short or is no .splat; copy it again",
            path, file.size);
    if (rc == OXL_OK) rc = oxl_model_create(ctx, file.size / SPLAT_FILE_BYTES, 0, out);
    for (size_t i = 0; rc == OXL_OK && i < out->count; i++)
        negative += bytes_float(p + SPLAT_FILE_BYTES * i + 12) < 0;
    if (rc == OXL_OK && 2 * negative > out->count)
        oxl_log(ctx, OXL_LOG_WARNING, "%s: most widths are below 0, so they are read as logarithms", path);
    for (size_t i = 0; rc == OXL_OK && i < out->count; i++)
        splat_file_get(p + SPLAT_FILE_BYTES * i, out, i, 2 * negative > out->count);
    os_release_file(ctx, &file);
    return rc;
}
