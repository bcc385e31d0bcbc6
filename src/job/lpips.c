/* lpips.c - computes LPIPS v0.1: the distance of two images in the features of AlexNet's five convolutions.
 *
 * Source: Zhang et al. 2018, The Unreasonable Effectiveness of Deep Features as a Perceptual Metric; weights:
 * examples/lpips_weights.py. For evaluation only. A file of weights, little-endian:
 *
 *     the line "LPIPS1 alex"
 *     5 convolutions   4 uint32  out, in, height, width;  float32 weights in that order;  out float32 biases
 *     5 heads          uint32 n;  n float32 weights
 *
 * The layers are a pipeline: a row is computed when the next layer needs it, from rings that hold as many
 * rows as a kernel is high. So memory grows only with the width of the images. Rows of both images lie side
 * by side.
 *
 * Invariant: each feature is a sum in a written order; the distance does not depend on the number of
 * threads.
 */
#include "../core/bytes.h"
#include "../core/simd.h"
#include "../survey/scene.h"
#include "job.h"

enum {
    LPIPS_LAYERS = 5,
    LPIPS_STAGES = 8, /* stages: the image, five convolutions, two poolings */
    LPIPS_CHANNELS_MAX = 4096,
    LPIPS_RING = 11,  /* most rows of a ring, those of the highest kernel */
    LPIPS_BLOCK = 4,  /* channels that are computed together */
    LPIPS_LANES = 16, /* columns that are computed together */
    LPIPS_PAD = 2     /* columns of zeros on either side, at least the padding of a convolution */
};
/* Keeps the length of a feature vector from 0, against division by it [lpips 0.1]. */
#define LPIPS_EPSILON 1e-10

/* Lists the stages; each reads the one before it. Pooling is a stage of its own: 3 x 3, stride 2. */
static const struct lpips_shape {
    int convolution; /* index of the convolution; -1: pooling; -2: the image */
    int size, stride, padding;
} LPIPS_SHAPES[LPIPS_STAGES] = {{-2, 1, 1, 0}, {0, 11, 4, 2}, {-1, 3, 2, 0}, {1, 5, 1, 2},
                                {-1, 3, 2, 0}, {2, 3, 1, 1},  {3, 3, 1, 1},  {4, 3, 1, 1}};

struct lpips_layer {
    int out, in, size;
    float *weight; /* (blocks of LPIPS_BLOCK channels, in, size, size, LPIPS_BLOCK) */
    float *bias;   /* (out) */
    float *head;   /* (out) */
};

struct lpips {
    struct lpips_layer layer[LPIPS_LAYERS];
    float data[]; /* weights of all layers, in the network's own allocation, so that oxl_free frees all */
};

/* ---------------- the file */

static size_t lpips_blocks(int channels)
{
    return ((size_t)channels + LPIPS_BLOCK - 1) / LPIPS_BLOCK;
}

static oxl_result lpips_fail(oxl_context *ctx, const char *path, const char *what)
{
    return oxl_fail(ctx, OXL_ERR_INPUT,
                    "%s: %s, expected the weights of LPIPS with AlexNet\n"
                    "fix: python3 examples/lpips_weights.py %s writes them",
                    path, what, path);
}

struct lpips_file {
    const char *path;
    const unsigned char *at, *end;
};

/* Reads `count` uint32, each from 1 to LPIPS_CHANNELS_MAX; returns 0 if they are missing or out of range. */
static int lpips_take_sizes(struct lpips_file *f, int count, int out[4])
{
    for (int k = 0; k < count; k++, f->at += 4) {
        const uint32_t v = f->end - f->at >= 4 ? bytes_u32(f->at) : 0;
        if (v < 1 || v > LPIPS_CHANNELS_MAX) return 0;
        out[k] = (int)v;
    }
    return 1;
}

/* Returns the floats at f->at, which moves past them; NULL: they are missing or not finite. */
static const unsigned char *lpips_take_floats(struct lpips_file *f, size_t count)
{
    const unsigned char *from = f->at;
    if ((size_t)(f->end - f->at) / 4 < count) return NULL;
    for (size_t i = 0; i < count; i++)
        if (!(fabsf(bytes_float(from + 4 * i)) <= FLT_MAX)) return NULL;
    f->at += 4 * count;
    return from;
}

/* Returns what is wrong with the file; NULL: nothing. weight, bias, head: places in the file. */
static const char *lpips_parse(struct lpips_file *f, struct lpips *net, const unsigned char *weight[],
                               const unsigned char *bias[], const unsigned char *head[])
{
    static const char magic[] = "LPIPS1 alex\n";
    const size_t length = sizeof magic - 1;
    int stage = 0, shape[4], before = 3;
    if ((size_t)(f->end - f->at) < length || memcmp(f->at, magic, length)) return "the first line is another";
    f->at += length;
    for (int k = 0; k < LPIPS_LAYERS; k++) {
        struct lpips_layer *l = &net->layer[k];
        while (LPIPS_SHAPES[stage].convolution != k) stage++;
        if (!lpips_take_sizes(f, 4, shape) || shape[1] != before || shape[2] != LPIPS_SHAPES[stage].size ||
            shape[3] != shape[2])
            return "a convolution has another shape";
        *l = (struct lpips_layer){.out = shape[0], .in = shape[1], .size = shape[2]};
        before = l->out;
        weight[k] = lpips_take_floats(f, (size_t)l->out * (size_t)l->in * (size_t)(l->size * l->size));
        bias[k] = weight[k] ? lpips_take_floats(f, (size_t)l->out) : NULL;
        if (!bias[k]) return "it ends too early, or a weight is not finite";
    }
    for (int k = 0; k < LPIPS_LAYERS; k++) {
        if (!lpips_take_sizes(f, 1, shape) || shape[0] != net->layer[k].out)
            return "a linear head has another size";
        if (!(head[k] = lpips_take_floats(f, (size_t)shape[0])))
            return "it ends too early, or a weight is not finite";
    }
    return f->at == f->end ? NULL : "more follows the weights";
}

/* Packs the weights of LPIPS_BLOCK channels side by side, so that a kernel loads them together; channels that
 * fill the last block are 0. */
static void lpips_pack(const unsigned char *from, struct lpips_layer *l)
{
    const size_t taps = (size_t)l->in * (size_t)(l->size * l->size);
    for (size_t o = 0; o < LPIPS_BLOCK * lpips_blocks(l->out); o++)
        for (size_t k = 0; k < taps; k++)
            l->weight[(o / LPIPS_BLOCK * taps + k) * LPIPS_BLOCK + o % LPIPS_BLOCK] =
                o < (size_t)l->out ? bytes_float(from + 4 * (o * taps + k)) : 0;
}

OXL_INTERNAL oxl_result lpips_read(oxl_context *ctx, const char *path, struct lpips **out)
{
    struct os_file_map map = {0};
    struct lpips head = {{{0}}}, *net = NULL;
    const unsigned char *weight[LPIPS_LAYERS], *bias[LPIPS_LAYERS], *linear[LPIPS_LAYERS];
    size_t floats = 0;
    oxl_result rc = os_read_file(ctx, path, &map);
    const unsigned char *data = (const unsigned char *)map.data;
    struct lpips_file f = {path, data, data ? data + map.size : NULL};
    const char *fault = rc == OXL_OK ? lpips_parse(&f, &head, weight, bias, linear) : NULL;
    *out = NULL;
    if (fault) rc = lpips_fail(ctx, path, fault);
    for (int k = 0; k < LPIPS_LAYERS && rc == OXL_OK; k++) {
        const struct lpips_layer *l = &head.layer[k];
        floats += lpips_blocks(l->out) * LPIPS_BLOCK * (size_t)l->in * (size_t)(l->size * l->size) +
                  2 * (size_t)l->out;
    }
    if (rc == OXL_OK && !(net = oxl_alloc(ctx, sizeof *net + floats * sizeof(float), 1))) rc = OXL_ERR_MEMORY;
    if (rc == OXL_OK) {
        float *at = net->data;
        memcpy(net->layer, head.layer, sizeof net->layer);
        for (int k = 0; k < LPIPS_LAYERS; k++) {
            struct lpips_layer *l = &net->layer[k];
            l->weight = at;
            at += lpips_blocks(l->out) * LPIPS_BLOCK * (size_t)l->in * (size_t)(l->size * l->size);
            l->bias = at, l->head = at + l->out;
            at += 2 * (size_t)l->out;
            lpips_pack(weight[k], l);
            for (int o = 0; o < l->out; o++) l->bias[o] = bytes_float(bias[k] + 4 * o);
            for (int o = 0; o < l->out; o++) l->head[o] = bytes_float(linear[k] + 4 * o);
        }
        *out = net;
    }
    os_release_file(ctx, &map);
    return rc;
}

/* ---------------- the pipeline */

struct lpips_stage {
    const struct lpips_shape *shape;
    const struct lpips_layer *layer;   /* layer of a convolution; NULL: another stage */
    int channels, width, height, next; /* next: first row that is not computed yet */
    /* Describes a row: by image and channel, columns in `phases` (as many as the next stage's stride) of
     * `pitch` columns; column x of the padded row is at [x % phases][x / phases], so that a strided
     * convolution reads neighbours. */
    int phases, pitch, ring;
    float *row;      /* (ring, 2, channels, phases, pitch) */
    double distance; /* sum of the distances of all pixels */
};

struct lpips_run {
    oxl_context *ctx;
    const oxl_image *image[2]; /* a, b */
    struct lpips_stage stage[LPIPS_STAGES];
    float *length; /* (2,width of the first convolution) lengths of feature vectors, then their inverses */
};

static size_t lpips_channel_floats(const struct lpips_stage *s)
{
    return (size_t)s->phases * (size_t)s->pitch;
}

/* Returns a channel of row y of image 0 or 1 in the ring. */
SIMD_INLINE float *lpips_channel(const struct lpips_stage *s, int y, int image, int channel)
{
    const size_t row = (size_t)(y % s->ring) * 2 + (size_t)image;
    return s->row + (row * (size_t)s->channels + (size_t)channel) * (size_t)s->phases * (size_t)s->pitch;
}

/* Returns the place of the image's column x in a channel. */
SIMD_INLINE size_t lpips_column(const struct lpips_stage *s, int x)
{
    const int at = x + LPIPS_PAD;
    return (size_t)(at % s->phases) * (size_t)s->pitch + (size_t)(at / s->phases);
}

static void lpips_copy_image_row(const struct lpips_run *run, struct lpips_stage *s, int y)
{
    static const float shift[3] = {-0.030f, -0.088f, -0.188f}, scale[3] = {0.458f, 0.448f, 0.450f};
    const size_t plane = (size_t)s->width * (size_t)s->height, first = (size_t)y * (size_t)s->width;
    const float *weight = run->image[1]->weight;
    for (int i = 0; i < 2; i++)
        for (int c = 0; c < 3; c++)
            /* Takes masked pixels of both images from image 1, so that they are equal. */
            for (int x = 0; x < s->width; x++) {
                const size_t at = first + (size_t)x;
                const int of = weight && weight[at] <= 0.5f ? 1 : i;
                const float v = run->image[of]->rgb[(size_t)c * plane + at];
                const float shown = v > 0 ? OXL_MIN(v, 1.0f) : 0;
                lpips_channel(s, y, i, c)[lpips_column(s, x)] = (2 * shown - 1 - shift[c]) / scale[c];
            }
}

struct lpips_task { /* Names a block of channels of a row of an image. */
    const struct lpips_stage *from, *to;
    int y, image, block;
};

SIMD_BODY void lpips_convolve_body(const int fused, const struct lpips_task *t)
{
    const struct lpips_stage *from = t->from, *to = t->to;
    const struct lpips_layer *l = to->layer;
    const int size = l->size, stride = to->shape->stride, padding = to->shape->padding;
    const float *weights = l->weight + (size_t)t->block * (size_t)(l->in * size * size) * LPIPS_BLOCK;
    for (int x = 0; x < to->width; x += LPIPS_LANES) {
        float sum[LPIPS_BLOCK][LPIPS_LANES];
        for (int o = 0; o < LPIPS_BLOCK; o++)
            for (int i = 0; i < LPIPS_LANES; i++)
                sum[o][i] = t->block * LPIPS_BLOCK + o < l->out ? l->bias[t->block * LPIPS_BLOCK + o] : 0;
        for (int c = 0; c < l->in; c++)
            for (int v = 0; v < size; v++) {
                const int row = t->y * stride - padding + v;
                const float *in, *w = weights + (size_t)((c * size + v) * size) * LPIPS_BLOCK;
                if (row < 0 || row >= from->height) continue;
                in = lpips_channel(from, row, t->image, c);
                for (int u = 0; u < size; u++, w += LPIPS_BLOCK) {
                    const float *at = in + lpips_column(from, x * stride - padding + u);
                    for (int o = 0; o < LPIPS_BLOCK; o++) {
                        const float weight = w[o];
#pragma omp simd
                        for (int i = 0; i < LPIPS_LANES; i++)
                            sum[o][i] = fused ? fmaf(weight, at[i], sum[o][i]) : sum[o][i] + weight * at[i];
                    }
                }
            }
        for (int o = 0; o < LPIPS_BLOCK && t->block * LPIPS_BLOCK + o < l->out; o++) {
            float *out = lpips_channel(to, t->y, t->image, t->block * LPIPS_BLOCK + o);
            for (int i = 0; i < OXL_MIN(LPIPS_LANES, to->width - x); i++)
                out[lpips_column(to, x + i)] = sum[o][i] > 0 ? sum[o][i] : 0;
        }
    }
}

SIMD_DISPATCH(static, lpips_convolve, struct lpips_task)

static void lpips_convolve_row(const struct lpips_run *run, const struct lpips_stage *s, int y)
{
    const int blocks = (int)lpips_blocks(s->channels);
#pragma omp parallel for schedule(static) num_threads(run->ctx->threads)
    for (int k = 0; k < 2 * blocks; k++)
        lpips_convolve(run->ctx->isa, &(struct lpips_task){s - 1, s, y, k / blocks, k % blocks});
}

static void lpips_pool_row(const struct lpips_stage *s, int y)
{
    const struct lpips_stage *from = s - 1;
    for (int k = 0; k < 2 * s->channels; k++)
        for (int x = 0; x < s->width; x++) {
            float most = 0; /* starts at 0, since features are not negative */
            for (int v = 0; v < 3; v++) {
                const float *in = lpips_channel(from, 2 * y + v, k / s->channels, k % s->channels);
                for (int u = 0; u < 3; u++) most = OXL_MAX(most, in[lpips_column(from, 2 * x + u)]);
            }
            lpips_channel(s, y, k / s->channels, k % s->channels)[lpips_column(s, x)] = most;
        }
}

/* Adds the distances of a row: of the feature vectors of both images, each divided by its length. */
static void lpips_add_distance(const struct lpips_run *run, struct lpips_stage *s, int y)
{
    float *inverse[2] = {run->length, run->length + s->width};
    for (int i = 0; i < 2; i++) {
        memset(inverse[i], 0, (size_t)s->width * sizeof(float));
        for (int c = 0; c < s->channels; c++) {
            const float *in = lpips_channel(s, y, i, c);
            for (int x = 0; x < s->width; x++) {
                const float v = in[lpips_column(s, x)];
                inverse[i][x] += v * v;
            }
        }
        for (int x = 0; x < s->width; x++)
            inverse[i][x] = (float)(1 / (sqrt((double)inverse[i][x]) + LPIPS_EPSILON));
    }
    for (int c = 0; c < s->channels; c++) {
        const float *a = lpips_channel(s, y, 0, c), *b = lpips_channel(s, y, 1, c);
        double sum = 0;
        for (int x = 0; x < s->width; x++) {
            const size_t at = lpips_column(s, x);
            const double d = (double)(a[at] * inverse[0][x]) - (double)(b[at] * inverse[1][x]);
            sum += d * d;
        }
        s->distance += (double)s->layer->head[c] * sum;
    }
}

/* Computes the rows of a stage up to `last`, after those that they need of the stages before it. */
static void lpips_advance(struct lpips_run *run, int stage, int last)
{
    struct lpips_stage *s = &run->stage[stage];
    for (; s->next <= last; s->next++) {
        const int y = s->next;
        if (stage > 0)
            lpips_advance(
                run, stage - 1,
                OXL_MIN(y * s->shape->stride - s->shape->padding + s->shape->size - 1, s[-1].height - 1));
        if (stage == 0) lpips_copy_image_row(run, s, y);
        else if (s->layer) lpips_convolve_row(run, s, y);
        else lpips_pool_row(s, y);
        if (s->layer) lpips_add_distance(run, s, y);
    }
}

/* ---------------- the distance */

/* Computes the sizes of all stages; returns 0 if the images are too small. */
static int lpips_lay_out(const struct lpips *net, struct lpips_run *run)
{
    for (int k = 0; k < LPIPS_STAGES; k++) {
        struct lpips_stage *s = &run->stage[k];
        const struct lpips_shape *shape = s->shape = &LPIPS_SHAPES[k];
        s->layer = shape->convolution >= 0 ? &net->layer[shape->convolution] : NULL;
        s->channels = k == 0 ? 3 : s->layer ? s->layer->out : s[-1].channels;
        s->width = k == 0 ? run->image[0]->width : s[-1].width + 2 * shape->padding - shape->size;
        s->height = k == 0 ? run->image[0]->height : s[-1].height + 2 * shape->padding - shape->size;
        if (s->width < 0 || s->height < 0) return 0;
        if (k > 0) s->width = s->width / shape->stride + 1, s->height = s->height / shape->stride + 1;
        s->phases =
            k + 1 < LPIPS_STAGES && LPIPS_SHAPES[k + 1].convolution >= 0 ? LPIPS_SHAPES[k + 1].stride : 1;
        /* has room for lanes that read past the row */
        s->pitch = (s->width + 2 * LPIPS_PAD) / s->phases + 2 * LPIPS_LANES;
        s->ring = k + 1 < LPIPS_STAGES ? LPIPS_SHAPES[k + 1].size : 1;
    }
    return 1;
}

OXL_INTERNAL oxl_result lpips_distance(oxl_context *ctx, const struct lpips *net, const oxl_image *a,
                                       const oxl_image *b, double *out)
{
    struct lpips_run run = {.ctx = ctx, .image = {a, b}};
    oxl_result rc = OXL_OK;
    *out = NAN;
    if (a->width != b->width || a->height != b->height)
        return oxl_fail(ctx, OXL_ERR_USAGE, "images of %d x %d and %d x %d px cannot be compared", a->width,
                        a->height, b->width, b->height);
    if (!lpips_lay_out(net, &run)) return OXL_OK;
    for (int k = 0; k < LPIPS_STAGES; k++) {
        struct lpips_stage *s = &run.stage[k];
        s->row = oxl_calloc(ctx, (size_t)s->ring * 2 * (size_t)s->channels * lpips_channel_floats(s),
                            sizeof *s->row);
        if (!s->row) rc = OXL_ERR_MEMORY;
    }
    run.length = oxl_alloc(ctx, 2 * (size_t)run.stage[1].width + 1, sizeof *run.length);
    if (rc != OXL_OK || !run.length) rc = OXL_ERR_MEMORY;
    for (int k = LPIPS_STAGES - 1; k > 0 && rc == OXL_OK; k--)
        lpips_advance(&run, k, run.stage[k].height - 1);
    if (rc == OXL_OK) *out = 0;
    for (int k = 0; k < LPIPS_STAGES; k++) {
        const struct lpips_stage *s = &run.stage[k];
        if (rc == OXL_OK && s->layer) *out += s->distance / ((double)s->width * s->height);
        oxl_free(ctx, s->row);
    }
    oxl_free(ctx, run.length);
    return rc;
}

oxl_result oxl_scene_read_lpips(oxl_context *ctx, oxl_scene *scene, const char *path)
{
    oxl_free(ctx, scene->lpips);
    scene->lpips_distance = lpips_distance;
    return lpips_read(ctx, path, &scene->lpips);
}
