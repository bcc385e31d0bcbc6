/* lpips.c - computes LPIPS v0.1: the distance of two images in the features of AlexNet's five convolutions.
 *
 * Source: Zhang et al. 2018, The Unreasonable Effectiveness of Deep Features as a Perceptual Metric; weights:
 * examples/lpips_weights.py. A file of weights, little-endian:
 *
 *     the line "LPIPS1 alex"
 *     5 convolutions   4 uint32  out, in, height, width;  float32 weights in that order;  out float32 biases
 *     5 heads          uint32 n;  n float32 weights
 *
 * Invariant: each feature is a sum in a written order; the distance does not depend on the number of
 * threads.
 */
#include "lab.h"

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

/* Keeps the length of a feature vector from 0, against division by it [lpips 0.1]. */
#define LPIPS_EPSILON 1e-10

/* Lists the convolutions; before the second and the third is a pooling of 3 x 3, stride 2. */
static const struct lpips_shape {
    int size, stride, padding, pooled;
} LPIPS_SHAPES[LPIPS_LAYERS] = {{11, 4, 2, 0}, {5, 1, 2, 1}, {3, 1, 1, 1}, {3, 1, 1, 0}, {3, 1, 1, 0}};

/* ---------------- the file */

/* Takes `count` words of the file, as floats or sizes; NULL: it ends before. */
static const void *lpips_take(const struct lpips *net, size_t *at, size_t count)
{
    if (net->count - *at < count) return NULL;
    *at += count;
    return net->word + *at - count;
}

/* Returns 1 if the words are those of the network, and finds the layers in them. */
static int lpips_parse(struct lpips *net)
{
    size_t at = 0;
    uint32_t before = 3;
    for (int k = 0; k < LPIPS_LAYERS; k++) {
        struct lpips_layer *l = &net->layer[k];
        const uint32_t size = (uint32_t)LPIPS_SHAPES[k].size, *shape = lpips_take(net, &at, 4);
        if (!shape || shape[0] < 1 || shape[0] > LPIPS_CHANNELS_MAX || shape[1] != before ||
            shape[2] != size || shape[3] != size)
            return 0;
        l->weight = lpips_take(net, &at, (size_t)shape[0] * before * size * size);
        l->bias = lpips_take(net, &at, shape[0]);
        l->out = (int)(before = shape[0]);
    }
    for (int k = 0; k < LPIPS_LAYERS; k++) {
        const uint32_t *count = lpips_take(net, &at, 1);
        if (!count || *count != (uint32_t)net->layer[k].out) return 0;
        net->layer[k].head = lpips_take(net, &at, *count);
    }
    return net->layer[LPIPS_LAYERS - 1].head && at == net->count;
}

oxl_result lpips_read(oxl_context *ctx, const char *path, struct lpips *net)
{
    static const char magic[] = "LPIPS1 alex\n";
    const size_t head = sizeof magic - 1;
    FILE *file = oxl_open(path);
    const long size = file && fseek(file, 0, SEEK_END) == 0 ? ftell(file) : 0;
    unsigned char *text = calloc((size_t)(size > 0 ? size : 0) + head + 4, 1);
    int good = 0;
    *net = (struct lpips){.count = size > (long)head ? ((size_t)size - head) / 4 : 0};
    net->word = malloc(4 * net->count + 4);
    if (file && text && net->word) {
        rewind(file);
        good = fread(text, 1, (size_t)size, file) == (size_t)size && !memcmp(text, magic, head) &&
               ((size_t)size - head) % 4 == 0;
    }
    for (size_t i = 0; good && i < 4 * net->count; i++)
        net->word[i / 4] = (i % 4 ? net->word[i / 4] : 0) | (uint32_t)text[head + i] << 8 * (i % 4);
    good = good && lpips_parse(net);
    free(text);
    if (file) fclose(file);
    return good ? OXL_OK
                : oxl_fail(ctx, OXL_ERR_INPUT,
                           "%s: these are not the weights of LPIPS with AlexNet\n"
                           "fix: python3 examples/lpips_weights.py %s writes them",
                           path, path);
}

void lpips_free(struct lpips *net)
{
    free(net->word);
    *net = (struct lpips){0};
}

/* ---------------- features */

struct lpips_planes {
    int channels, width, height;
    float *data; /* (channels, height, width) */
};

static float *lpips_plane(const struct lpips_planes *p, int channel)
{
    return p->data + (size_t)channel * (size_t)p->width * (size_t)p->height;
}

struct lpips_task {
    const struct lpips_planes *from;
    const struct lpips_layer *layer;
    const struct lpips_shape *shape;
};

static void lpips_convolve(const struct lpips_task *t, struct lpips_planes *to, int channel)
{
    const int size = t->shape->size, stride = t->shape->stride, padding = t->shape->padding;
    const float *w = t->layer->weight + (size_t)channel * (size_t)(t->from->channels * size * size);
    float *out = lpips_plane(to, channel);
    const int pixels = to->width * to->height;
    for (int i = 0; i < pixels; i++) out[i] = t->layer->bias[channel];
    for (int c = 0; c < t->from->channels; c++)
        for (int tap = 0; tap < size * size; tap++, w++)
            for (int y = 0; y < to->height; y++) {
                const int row = y * stride - padding + tap / size, shift = tap % size - padding;
                const float *in = lpips_plane(t->from, c) + (ptrdiff_t)row * t->from->width + shift;
                int x = 0, end = to->width;
                if (row < 0 || row >= t->from->height) continue;
                while (x * stride + shift < 0) x++;
                while (end > x && (end - 1) * stride + shift >= t->from->width) end--;
                for (; x < end; x++) out[y * to->width + x] += *w * in[x * stride];
            }
    for (int i = 0; i < pixels; i++) out[i] = fmaxf(out[i], 0);
}

static void lpips_pool(const struct lpips_task *t, struct lpips_planes *to, int channel)
{
    float *out = lpips_plane(to, channel);
    for (int y = 0; y < to->height; y++)
        for (int x = 0; x < to->width; x++, out++) {
            const float *in = lpips_plane(t->from, channel) + 2 * (y * t->from->width + x);
            *out = 0; /* since features are not negative */
            for (int i = 0; i < 9; i++) *out = fmaxf(*out, in[i / 3 * t->from->width + i % 3]);
        }
}

/* Replaces the planes by the next ones; layer NULL: pooled. Returns 0 without memory. */
static int lpips_advance(struct lpips_planes *p, const struct lpips_layer *layer,
                         const struct lpips_shape *shape)
{
    const struct lpips_planes from = *p;
    const struct lpips_task task = {&from, layer, shape};
    const int size = layer ? shape->size - 2 * shape->padding : 3, stride = layer ? shape->stride : 2;
    if (layer) p->channels = layer->out;
    p->width = from.width < size ? 0 : (from.width - size) / stride + 1;
    p->height = from.height < size ? 0 : (from.height - size) / stride + 1;
    p->data = malloc((size_t)p->channels * (size_t)p->width * (size_t)p->height * sizeof *p->data + 1);
#pragma omp parallel for schedule(dynamic, 1)
    for (int c = 0; c < p->channels; c++)
        if (p->data) (layer ? lpips_convolve : lpips_pool)(&task, p, c);
    free(from.data);
    return p->data != NULL;
}

/* ---------------- the distance */

/* Copies an image as AlexNet sees it; masked pixels of `weight` are those of `masked`. */
static int lpips_copy(const oxl_image *image, const oxl_image *masked, struct lpips_planes *out)
{
    static const float shift[3] = {-0.030f, -0.088f, -0.188f}, scale[3] = {0.458f, 0.448f, 0.450f};
    const size_t pixels = (size_t)image->width * (size_t)image->height;
    *out = (struct lpips_planes){3, image->width, image->height, malloc(3 * pixels * sizeof(float) + 1)};
    for (size_t i = 0; out->data && i < 3 * pixels; i++) {
        const oxl_image *of = masked->weight && masked->weight[i % pixels] <= 0.5f ? masked : image;
        out->data[i] = (2 * fminf(fmaxf(of->rgb[i], 0), 1) - 1 - shift[i / pixels]) / scale[i / pixels];
    }
    return out->data != NULL;
}

/* Returns the mean distance of the feature vectors, each divided by its length; NAN: there are none. */
static double lpips_compare(const struct lpips_planes p[2], const float *head)
{
    const size_t pixels = (size_t)p->width * (size_t)p->height;
    double sum = 0;
    for (size_t i = 0; i < pixels; i++) {
        double length[2] = {0, 0};
        for (int k = 0; k < 2; k++) {
            for (int c = 0; c < p->channels; c++) length[k] += pow(p[k].data[(size_t)c * pixels + i], 2);
            length[k] = sqrt(length[k]) + LPIPS_EPSILON;
        }
        for (int c = 0; c < p->channels; c++)
            sum += head[c] * pow(p[0].data[(size_t)c * pixels + i] / length[0] -
                                     p[1].data[(size_t)c * pixels + i] / length[1],
                                 2);
    }
    return sum / (double)pixels;
}

oxl_result lpips_distance(oxl_context *ctx, const struct lpips *net, const oxl_image *a, const oxl_image *b,
                          double *out)
{
    struct lpips_planes p[2] = {{0}};
    int whole;
    if (a->width != b->width || a->height != b->height)
        return oxl_fail(ctx, OXL_ERR_USAGE, "images of %d x %d and %d x %d px cannot be compared", a->width,
                        a->height, b->width, b->height);
    whole = lpips_copy(a, b, &p[0]) & lpips_copy(b, b, &p[1]);
    *out = 0;
    for (int k = 0; k < LPIPS_LAYERS && whole; k++) {
        const struct lpips_shape *shape = &LPIPS_SHAPES[k];
        for (int i = 0; i < 2; i++) {
            if (shape->pooled) whole &= lpips_advance(&p[i], NULL, NULL);
            if (whole) whole &= lpips_advance(&p[i], &net->layer[k], shape);
        }
        if (whole) *out += lpips_compare(p, net->layer[k].head);
    }
    free(p[0].data);
    free(p[1].data);
    return whole ? OXL_OK : oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for the features of LPIPS");
}

/* ---------------- the command */

/* Compares a view's image NAME.image.png with its render NAME.png. */
static oxl_result lpips_of_view(oxl_context *ctx, const struct lpips *net, const char *path, double *out)
{
    static const char end[] = ".image.png";
    char render[4200];
    oxl_image a = {0}, b = {0};
    const size_t size = strlen(path), ends = sizeof end - 1;
    oxl_result rc;
    if (size <= ends || strcmp(path + size - ends, end) != 0)
        return oxl_fail(ctx, OXL_ERR_USAGE,
                        "found '%s', expected NAME.image.png\nfix: give OUT/renders/*.image.png", path);
    snprintf(render, sizeof render, "%.*s.png", (int)(size - ends), path);
    rc = oxl_image_read(ctx, render, &a);
    if (rc == OXL_OK) rc = oxl_image_read(ctx, path, &b);
    if (rc == OXL_OK) rc = lpips_distance(ctx, net, &a, &b, out);
    oxl_image_free(ctx, &a);
    oxl_image_free(ctx, &b);
    return rc;
}

oxl_result lpips_run(oxl_context *ctx, const char *weights, char *const *image, int count)
{
    struct lpips net;
    double sum = 0, value;
    oxl_result rc = lpips_read(ctx, weights, &net);
    for (int i = 0; i < count && rc == OXL_OK; i++) {
        rc = lpips_of_view(ctx, &net, image[i], &value);
        if (rc == OXL_OK) print_format(stdout, "%.5f  %s\n", value, image[i]);
        sum += value;
    }
    if (rc == OXL_OK) printf("%.5f  mean of %d, LPIPS (AlexNet)\n", sum / count, count);
    lpips_free(&net);
    return rc;
}
