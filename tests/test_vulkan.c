/* test_vulkan.c - the Vulkan backend against the CPU's: one harness, both behind the same interface, the same
 * input, stated bounds.
 *
 * Wants a build with make VULKAN=1 and a device; Mesa's lavapipe will do, and is what the bounds were seen
 * on. The validation layer listens to every test where it is installed.
 */
#include "test.h"
#ifdef OXL_VULKAN /* the tests see into the backend's files, which are part of this object instead */
#include "../src/parts/dropout.h"
#include "../src/parts/lamp.h"
#include "../src/parts/medium.h"
#include "../src/parts/prune.h"
#include "../backends/vulkan/frames.c"
#include "../backends/vulkan/passes.c"
#include "../backends/vulkan/memory.c"
#include "../backends/vulkan/instance.c"
#include "../backends/vulkan/device.c"
#include "../backends/vulkan/images.c"
#include "../backends/vulkan/resident.c"
#include "../backends/vulkan/imaging.c"
#include "../backends/vulkan/forward.c"
#include "../backends/vulkan/renderer.c"
#endif

/* A test that runs check(context with a device). */
#define DEVICE_TEST(name, check) \
    TEST(name)                   \
    {                            \
        ON_DEVICE(check);        \
    }                            \
    void test_##name(void)

#ifndef OXL_VULKAN
#define ON_DEVICE(check) SKIP("a build without the Vulkan backend (make VULKAN=1)")
#else

/* Runs check(context with a device); messages of the validation layer fail it. */
#define ON_DEVICE(check)                                                                       \
    do {                                                                                       \
        oxl_context *device = vulkan_test_begin();                                             \
        if (!device) SKIP("no Vulkan device here");                                            \
        check(device);                                                                         \
        if (device->backend->vulkan) CHECK(device->backend->vulkan->validation_messages == 0); \
        oxl_context_free(device);                                                              \
    } while (0)

static void vulkan_test_log(void *user, oxl_log_level level, const char *text)
{
    (void)user;
    if (level <= OXL_LOG_WARNING) printf("  %s\n", text);
}

static oxl_context *vulkan_test_begin(void)
{
    oxl_context_options options = test_ctx->options;
    oxl_context *ctx;
    setenv("OXL_VULKAN_VALIDATE", "1", 0); /* or gpu: backends/vulkan/instance.c */
    if (getenv("OXL_TEST_DEVICE"))
        options.device = atoi(getenv("OXL_TEST_DEVICE")); /* of info --devices; else the best */
    options.backend = OXL_BACKEND_VULKAN;
    options.log = vulkan_test_log;
    if (oxl_context_create(&options, &ctx) != OXL_OK) return NULL;
    if (oxl_backend_begin(ctx) == OXL_OK) return ctx;
    oxl_context_free(ctx);
    return NULL;
}

/* What a call that fails may leave in the handle that it was to make: anything. */
#define VULKAN_LEAVE(out) memset(out, 0x10, sizeof *(out))

/* ---------------- scenes */

static double vulkan_random(uint64_t i, uint64_t k)
{
    return 2 * random_unit(random_bits(7, i, k)) - 1;
}

static oxl_camera vulkan_camera(int width, int height)
{
    return (oxl_camera){.width = width,
                        .height = height,
                        .fx = 0.9 * width,
                        .fy = 0.95 * width,
                        .cx = 0.5 * width + 0.3,
                        .cy = 0.5 * height - 0.2,
                        .rotation = {0.96, 0, 0.28, 0, 1, 0, -0.28, 0, 0.96},
                        .translation = {0.1, -0.2, 0.3}};
}

/* Gaussians in and around the view, from needles to plates; lobes for the first of them. */
static void vulkan_scene(size_t count, int degree, size_t lobes, oxl_model *out)
{
    CHECK_OK(oxl_model_create(test_ctx, count, degree, out));
    CHECK_OK(model_set_lobes(test_ctx, out, lobes));
    for (size_t i = 0; i < count; i++) {
        out->plane[OXL_MEAN][i] = (float)(2.5 * vulkan_random(i, 0) - 1);
        out->plane[OXL_MEAN + 1][i] = (float)(2 * vulkan_random(i, 1));
        out->plane[OXL_MEAN + 2][i] = (float)(4 + 3.8 * vulkan_random(i, 2));
        for (uint64_t k = 0; k < 3; k++)
            out->plane[OXL_LOG_SCALE + k][i] = (float)(-2.5 + 1.2 * vulkan_random(i, 3 + k));
        for (uint64_t k = 0; k < 4; k++) out->plane[OXL_ROTATION + k][i] = (float)vulkan_random(i, 6 + k);
        out->plane[OXL_OPACITY][i] = (float)(3 * vulkan_random(i, 10));
        for (int k = OXL_SH; k < oxl_model_planes(out); k++)
            out->plane[k][i] = (float)((k < OXL_SH + 3 ? 1 : 0.2) * vulkan_random(i, (uint64_t)k));
    }
    for (size_t i = 0; i < lobes; i++)
        for (int k = 0; k < MODEL_LOBE_PLANES; k++)
            out->plane[OXL_LOBE + k][i] = (float)(0.4 * vulkan_random(i, 100 + (uint64_t)k) - (k == 0));
}

/* The corners of what a model may hold, and beyond. */
static void vulkan_extremes(oxl_model *m)
{
    static const float wild[] = {0,        -0.0f,     1e-38f, 1e-45f, 1e10f, -1e10f, 1e38f, -1e38f,
                                 INFINITY, -INFINITY, NAN,    88,     -88,   20,     -20};
    for (size_t i = 0; i < m->count; i += 3) {
        const uint64_t bits = random_bits(3, i, 0);
        const int k = (int)(bits % OXL_SH);
        m->plane[k][i] = wild[bits / 64 % OXL_COUNT(wild)];
        if (i % 2) m->plane[OXL_LOG_SCALE + bits % 3][i] = (float)(30 * vulkan_random(i, 9));
        if (i % 5 == 0) m->plane[OXL_OPACITY][i] = (float)(60 * vulkan_random(i, 8));
        if (i % 7 == 0)
            for (int q = 0; q < 4; q++) m->plane[OXL_ROTATION + q][i] = 0;
    }
}

struct vulkan_twins { /* [0]: the CPU's, [1]: the device's */
    oxl_context *ctx[2];
    struct renderer *r[2];
    oxl_camera camera;
    size_t pixels;
};

static struct vulkan_twins vulkan_twins(oxl_context *device, int width, int height)
{
    struct vulkan_twins t = {.ctx = {test_ctx, device},
                             .camera = vulkan_camera(width, height),
                             .pixels = (size_t)width * (size_t)height};
    for (int k = 0; k < 2; k++) CHECK_OK(renderer_create(t.ctx[k], &t.r[k]));
    return t;
}

static void vulkan_twins_free(struct vulkan_twins *t)
{
    for (int k = 0; k < 2; k++) renderer_free(t->ctx[k], t->r[k]);
}

static void vulkan_forward_both(struct vulkan_twins *t, const oxl_model *m)
{
    oxl_render_options options = oxl_render_options_default();
    options.background[1] = 0.25f;
    for (int k = 0; k < 2; k++)
        if (renderer_forward(t->ctx[k], t->r[k], m, &t->camera, &options) != OXL_OK)
            test_fail(__FILE__, __LINE__, "%s", oxl_error_text(t->ctx[k]));
}

static float *vulkan_noise(size_t count, uint64_t seed)
{
    float *out = oxl_alloc(test_ctx, count, sizeof *out);
    for (size_t i = 0; i < count; i++) out[i] = (float)vulkan_random(i, seed);
    return out;
}

/* What the last view saw, as the CPU's renderer has it. */
static void vulkan_download_rows(oxl_context *device, struct renderer *renderer)
{
    struct vulkan_renderer *r = renderer->device;
    struct vulkan *v = device->backend->vulkan;
    const size_t n = r->count, rows = renderer->bins.packs * PACK;
    float(*a)[4] = oxl_alloc(device, 3 * n + 1, sizeof *a);
    uint32_t *seen = oxl_alloc(device, n + 1, sizeof *seen);
    CHECK_OK(oxl_reserve(device, (void **)&renderer->splat, &renderer->splat_capacity, rows,
                         sizeof *renderer->splat));
    CHECK_OK(oxl_reserve(device, (void **)&renderer->visible, &renderer->visible_capacity, rows / PACK + 1,
                         sizeof *renderer->visible));
    CHECK_OK(oxl_reserve(device, (void **)&renderer->dmean2d, &renderer->dmean2d_capacity, rows,
                         sizeof *renderer->dmean2d));
    vulkan_enter(v);
    vulkan_download(v, &r->splat_a, 0, a, n * sizeof *a);
    vulkan_download(v, &r->splat_b, 0, a + n, n * sizeof *a);
    vulkan_download(v, &r->splat_c, 0, a + 2 * n, n * sizeof *a);
    vulkan_download(v, &r->seen, 0, seen, n * sizeof *seen);
    if (r->mean2d.size >= n * sizeof(float))
        vulkan_download(v, &r->mean2d, 0, renderer->dmean2d, n * sizeof(float));
    CHECK(v->rc == OXL_OK);
    memset(renderer->visible, 0, rows / PACK * sizeof *renderer->visible);
    for (size_t i = 0; i < n && v->rc == OXL_OK; i++) {
        const float *b = a[n + i], *c = a[2 * n + i];
        if (!seen[i]) continue;
        renderer->visible[i / PACK] = (uint16_t)(renderer->visible[i / PACK] | 1u << i % PACK);
        renderer->splat[i] = (struct splat){.u = a[i][0],
                                            .v = a[i][1],
                                            .a = a[i][2],
                                            .k = a[i][3],
                                            .e = b[0],
                                            .peak = b[1],
                                            .colour = {c[0], c[1], c[2]},
                                            .depth = c[3],
                                            .half_x = b[2],
                                            .half_y = b[3]};
    }
    oxl_free(device, a);
    oxl_free(device, seen);
}

/* |a - b| over |a|, as vectors; and the largest difference. */
struct vulkan_distance {
    double relative, most;
};
static struct vulkan_distance vulkan_distance(const float *a, const float *b, size_t count)
{
    struct vulkan_distance d = {0, 0};
    double sum = 0, square = 0;
    for (size_t i = 0; i < count; i++) {
        const double off = (double)a[i] - b[i];
        sum += (double)a[i] * a[i], square += off * off;
        d.most = !(fabs(off) <= d.most) ? fabs(off) : d.most;
    }
    d.relative = sum > 0 ? sqrt(square / sum) : sqrt(square);
    return d;
}

/* ---------------- shaders */

/* A compiler that assumes numbers to be finite leaves out a test against a constant that it knows. */
static void vulkan_check_infinity(oxl_context *device)
{
    (void)device;
    for (int pass = 0; pass < PASS_COUNT; pass++) {
        const uint32_t *word = VULKAN_PASSES[pass].words;
        size_t known = 0, read = 0;
        for (size_t i = 5; i < VULKAN_PASSES[pass].bytes / sizeof *word; i += word[i] >> 16) {
            known += (word[i] & 0xFFFF) == 43 /* OpConstant */ && word[i + 3] == VULKAN_INFINITY;
            read++;
        }
        CHECK(read > 100 && known == 0);
    }
}

/* ---------------- sort and scan */

static void vulkan_check_sort(oxl_context *device, size_t n, uint32_t mask)
{
    struct vulkan *v = device->backend->vulkan;
    const size_t most = n == 1 << 16 ? n : n + 9000; /* more groups than keys, or all of 32 are full */
    uint32_t *host = oxl_alloc(test_ctx, 2 * n + 2, sizeof *host), *got = host + n + 1, count = (uint32_t)n;
    struct vulkan_renderer *r;
    void *made;
    size_t wrong = 0;
    int end;
    CHECK_OK(vulkan_renderer_create(device, &made));
    r = made;
    for (size_t i = 0; i < n; i++) host[i] = (uint32_t)random_bits(5, i, n) & mask;
    for (int k = 0; k < 2; k++) {
        vulkan_reserve(v, &r->row_key[k], n + 1, 4, "keys");
        vulkan_reserve(v, &r->row_value[k], n + 1, 4, "keys");
    }
    vulkan_reserve(v, &r->histogram, VULKAN_DIGITS * vulkan_chunks(most), 4, "keys");
    if (n) vulkan_upload(v, &r->row_key[0], 0, host, 4 * n);
    for (size_t i = 0; i < n; i++) got[i] = (uint32_t)i;
    if (n) vulkan_upload(v, &r->row_value[0], 0, got, 4 * n);
    vulkan_update(v, &r->counts, COUNT_VISIBLE * 4, &count, 4);
    end = vulkan_sort(r, r->row_key, r->row_value, COUNT_VISIBLE, most, 32);
    if (n) vulkan_download(v, &r->row_value[end], 0, got, 4 * n);
    for (size_t i = 1; i < n; i++)
        wrong +=
            host[got[i - 1]] > host[got[i]] || (host[got[i - 1]] == host[got[i]] && got[i - 1] >= got[i]);
    CHECK(v->rc == OXL_OK && wrong == 0);
    vulkan_renderer_free(r);
    oxl_free(test_ctx, host);
}

static void vulkan_check_sorts(oxl_context *device)
{
    static const size_t sizes[] = {0, 1, 2047, 2048, 2049, 1 << 16, 70001};
    for (size_t k = 0; k < OXL_COUNT(sizes); k++)
        vulkan_check_sort(device, sizes[k], k % 2 ? 0xFFFFFFFF : 0x00F0000F);
}

static void vulkan_check_scan(oxl_context *device, size_t n)
{
    struct vulkan *v = device->backend->vulkan;
    uint32_t *in = oxl_alloc(test_ctx, 2 * n, sizeof *in), *out = in + n, total = 0, sum = 0;
    struct vulkan_renderer *r;
    void *made;
    size_t wrong = 0;
    CHECK_OK(vulkan_renderer_create(device, &made));
    r = made;
    for (size_t i = 0; i < n; i++) in[i] = (uint32_t)(random_bits(6, i, n) % 7);
    vulkan_reserve(v, &r->seen, n, 4, "numbers");
    vulkan_reserve(v, &r->scan_sums, vulkan_chunks(n), 4, "numbers");
    vulkan_upload(v, &r->seen, 0, in, 4 * n);
    vulkan_scan(r, &r->seen, n, COUNT_PAIRS, UINT32_MAX);
    vulkan_download(v, &r->seen, 0, out, 4 * n);
    vulkan_download(v, &r->counts, 4 * COUNT_PAIRS, &total, 4);
    for (size_t i = 0; i < n; i++) wrong += out[i] != sum, sum += in[i];
    CHECK(v->rc == OXL_OK && wrong == 0 && total == sum);
    vulkan_renderer_free(r);
    oxl_free(test_ctx, in);
}

static void vulkan_check_scans(oxl_context *device)
{
    static const size_t sizes[] = {1, 2048, 2049, VULKAN_SCAN_WHOLE, VULKAN_SCAN_WHOLE + 1, 90000};
    for (size_t k = 0; k < OXL_COUNT(sizes); k++) vulkan_check_scan(device, sizes[k]);
}

/* ---------------- forward */

/* Which rows are seen, but for those on the very edge, and their splats. */
static void vulkan_compare_rows(struct vulkan_twins *t, size_t count)
{
    size_t other = 0, seen = 0;
    double worst[10] = {0};
    vulkan_download_rows(t->ctx[1], t->r[1]);
    for (size_t i = 0; i < count; i++) {
        const struct splat *a = &t->r[0]->splat[i], *b = &t->r[1]->splat[i];
        const float x[10] = {a->u,    a->v,         a->a,     a->k,      a->e,
                             a->peak, a->colour[0], a->depth, a->half_x, a->half_y};
        const float y[10] = {b->u,    b->v,         b->a,     b->k,      b->e,
                             b->peak, b->colour[0], b->depth, b->half_x, b->half_y};
        other += renderer_row_visible(t->r[0], i) != renderer_row_visible(t->r[1], i);
        if (!renderer_row_visible(t->r[0], i) || !renderer_row_visible(t->r[1], i)) continue;
        seen++;
        for (int k = 0; k < 10; k++) {
            const double off = fabs((double)x[k] - y[k]) / (1 + fabs(x[k]));
            if (!(off <= worst[k]) && x[k] == x[k]) worst[k] = off;
        }
    }
    CHECK(other * 1000 <= count);
    CHECK(seen > 0);
    for (int k = 0; k < 10; k++) CHECK_CLOSE(worst[k], 0, k == 0 || k == 1 ? 1e-4 : 2e-3);
}

static void vulkan_check_projection(oxl_context *device)
{
    for (int k = 0; k < 4; k++) {
        const int wild = k / 2;
        struct vulkan_twins t = vulkan_twins(device, 150, 101);
        oxl_model m;
        vulkan_scene(1500, 3, 200, &m);
        m.antialias = k % 2;
        if (wild) vulkan_extremes(&m);
        vulkan_forward_both(&t, &m);
        vulkan_compare_rows(&t, m.count);
        if (!wild)
            CHECK_CLOSE((double)((struct vulkan_renderer *)t.r[1]->device)->pairs,
                        (double)t.r[0]->bins.pair_count, 3);
        oxl_model_free(test_ctx, &m);
        vulkan_twins_free(&t);
    }
}

/* A pixel at the threshold of 1/255 may go either way: at most a few. */
static void vulkan_compare_images(struct vulkan_twins *t)
{
    const float *image[2];
    struct vulkan_distance d;
    for (int k = 0; k < 2; k++) CHECK_OK(renderer_image(t->ctx[k], t->r[k], &image[k]));
    d = vulkan_distance(image[0], image[1], 3 * t->pixels);
    CHECK_CLOSE(d.relative, 0, 2e-4);
    CHECK_CLOSE(d.most, 0, 2.0 / 255);
}

static void vulkan_check_drawing(oxl_context *device)
{
    for (size_t lobes = 0; lobes <= 400; lobes += 400) {
        struct vulkan_twins t = vulkan_twins(device, 100, 75);
        oxl_model m;
        vulkan_scene(600, 2, lobes, &m);
        vulkan_forward_both(&t, &m);
        vulkan_compare_images(&t);
        oxl_model_free(test_ctx, &m);
        vulkan_twins_free(&t);
    }
}

static void vulkan_check_alpha_min(oxl_context *device)
{
    for (size_t lobes = 0; lobes <= 400; lobes += 400) {
        struct vulkan_twins t = vulkan_twins(device, 100, 75);
        oxl_render_options options = oxl_render_options_default();
        const float *image[2];
        oxl_model m;
        options.alpha_min = 0.06f;
        vulkan_scene(600, 1, lobes, &m);
        for (int k = 0; k < 2; k++) {
            CHECK_OK(renderer_forward(t.ctx[k], t.r[k], &m, &t.camera, &options));
            CHECK_OK(renderer_image(t.ctx[k], t.r[k], &image[k]));
        }
        /* a pixel at the threshold: 0.06 */
        CHECK_CLOSE(vulkan_distance(image[0], image[1], 3 * t.pixels).relative, 0, 1e-3);
        CHECK_CLOSE((double)((struct vulkan_renderer *)t.r[1]->device)->pairs,
                    (double)t.r[0]->bins.pair_count, 3);
        oxl_model_free(test_ctx, &m);
        vulkan_twins_free(&t);
    }
}

static void vulkan_check_wild_drawing(oxl_context *device)
{
    struct vulkan_twins t = vulkan_twins(device, 64, 64);
    oxl_model m;
    vulkan_scene(500, 1, 100, &m);
    vulkan_extremes(&m);
    for (size_t i = 0; i < m.count; i++)
        for (int k = OXL_SH; k < oxl_model_planes(&m); k++)
            if (!(fabsf(m.plane[k][i]) < 10)) m.plane[k][i] = 0;
    vulkan_forward_both(&t, &m);
    vulkan_compare_images(&t);
    oxl_model_free(test_ctx, &m);
    vulkan_twins_free(&t);
}

static void vulkan_check_nothing(oxl_context *device)
{
    struct vulkan_twins t = vulkan_twins(device, 40, 30);
    oxl_model m;
    vulkan_scene(5, 0, 0, &m);
    for (size_t i = 0; i < m.count; i++) m.plane[OXL_MEAN + 2][i] = -50; /* behind the camera */
    vulkan_forward_both(&t, &m);
    vulkan_compare_images(&t);
    oxl_model_free(test_ctx, &m);
    vulkan_twins_free(&t);
}

static void vulkan_check_depth(oxl_context *device)
{
    const oxl_camera camera = vulkan_camera(60, 45);
    oxl_context *ctx[2] = {test_ctx, device};
    float depth[2][60 * 45];
    oxl_image image[2];
    oxl_model m;
    vulkan_scene(300, 0, 0, &m);
    for (int k = 0; k < 2; k++) CHECK_OK(oxl_render(ctx[k], &m, &camera, NULL, &image[k], depth[k]));
    CHECK_CLOSE(vulkan_distance(depth[0], depth[1], OXL_COUNT(depth[0])).relative, 0, 2e-4);
    for (int k = 0; k < 2; k++) oxl_image_free(ctx[k], &image[k]);
    oxl_model_free(test_ctx, &m);
}

/* ---------------- any device */

/* The image of a device with these limits; it must be that of one without. */
static void vulkan_draw_limited(oxl_context *device, uint32_t slab_rows, uint32_t groups_max, float *rgb)
{
    const oxl_camera camera = vulkan_camera(2100, 40);
    oxl_render_options options = oxl_render_options_default();
    struct vulkan old = *device->backend->vulkan;
    struct renderer *r;
    const float *image;
    oxl_model m;
    vulkan_scene(2000, 1, 700, &m);
    device->backend->vulkan->slab_rows = slab_rows;
    device->backend->vulkan->groups_max = groups_max;
    CHECK_OK(renderer_create(device, &r));
    CHECK_OK(renderer_forward(device, r, &m, &camera, &options));
    CHECK_OK(renderer_image(device, r, &image));
    memcpy(rgb, image, 3 * 2100 * 40 * sizeof *rgb);
    renderer_free(device, r);
    device->backend->vulkan->slab_rows = old.slab_rows;
    device->backend->vulkan->groups_max = old.groups_max;
    oxl_model_free(test_ctx, &m);
}

static void vulkan_check_limits(oxl_context *device)
{
    const size_t size = 3 * 2100 * 40;
    float *one = oxl_alloc(test_ctx, 2 * size, sizeof *one), *two = one + size;
    struct vulkan_twins t = vulkan_twins(device, 2100, 40);
    const oxl_camera camera = vulkan_camera(2100, 40);
    oxl_render_options options = oxl_render_options_default();
    struct vulkan_distance d;
    const float *image;
    oxl_model m;
    vulkan_draw_limited(device, VULKAN_SLAB_ROWS, 65535, one);
    vulkan_draw_limited(device, 512, 21, two);
    CHECK(memcmp(one, two, size * sizeof *one) == 0);
    vulkan_scene(2000, 1, 700, &m);
    CHECK_OK(renderer_forward(test_ctx, t.r[0], &m, &camera, &options));
    CHECK_OK(renderer_image(test_ctx, t.r[0], &image));
    d = vulkan_distance(image, one, size);
    CHECK_CLOSE(d.relative, 0, 2e-4);
    vulkan_twins_free(&t);
    oxl_model_free(test_ctx, &m);
    oxl_free(test_ctx, one);
}

static void vulkan_check_refusal(oxl_context *device)
{
    const oxl_camera camera = vulkan_camera(100, 100);
    oxl_render_options options = oxl_render_options_default();
    struct renderer *r;
    oxl_model m;
    const size_t range = device->backend->vulkan->range;
    vulkan_scene(1000, 0, 0, &m);
    CHECK_OK(renderer_create(device, &r));
    device->backend->vulkan->range = 8192;
    /* so --backend auto goes on with the CPU */
    CHECK(renderer_forward(device, r, &m, &camera, &options) == OXL_ERR_MEMORY);
    CHECK_TEXT(oxl_error_text(device), "in one array");
    device->backend->vulkan->range = range;
    CHECK_OK(renderer_forward(device, r, &m, &camera, &options)); /* still usable */
    renderer_free(device, r);
    oxl_model_free(test_ctx, &m);
}

/* ---------------- other drivers, played */

static VkInstanceCreateFlags vulkan_seen_flags;
static char vulkan_seen_names[400];

static void vulkan_note_names(const char *const *name, uint32_t count)
{
    vulkan_seen_names[0] = 0;
    for (uint32_t i = 0; i < count; i++) strcat(strcat(vulkan_seen_names, name[i]), " ");
}

static VKAPI_ATTR VkResult VKAPI_CALL vulkan_play_instance_list(const char *layer, uint32_t *count,
                                                                VkExtensionProperties *out)
{
    (void)layer;
    memset(out, 0, 2 * sizeof *out);
    strcpy(out[0].extensionName, "VK_KHR_portability_enumeration");
    strcpy(out[1].extensionName, "VK_KHR_get_physical_device_properties2");
    *count = 2;
    return VK_SUCCESS;
}

static VKAPI_ATTR VkResult VKAPI_CALL vulkan_play_device_list(VkPhysicalDevice device, const char *layer,
                                                              uint32_t *count, VkExtensionProperties *out)
{
    (void)device, (void)layer;
    memset(out, 0, sizeof *out);
    strcpy(out[0].extensionName, "VK_KHR_portability_subset");
    *count = 1;
    return VK_SUCCESS;
}

static VKAPI_ATTR VkResult VKAPI_CALL vulkan_play_instance(const VkInstanceCreateInfo *info,
                                                           const VkAllocationCallbacks *a, VkInstance *out)
{
    (void)a;
    VULKAN_LEAVE(out);
    vulkan_seen_flags = info->flags;
    vulkan_note_names(info->ppEnabledExtensionNames, info->enabledExtensionCount);
    return VK_ERROR_INCOMPATIBLE_DRIVER;
}

/* As MoltenVK: listed only on request of portability drivers, and usable when the subset is enabled. */
static void vulkan_check_portability(oxl_context *device)
{
    struct vulkan v = {.ctx = device,
                       .EnumerateInstanceExtensionProperties = vulkan_play_instance_list,
                       .EnumerateDeviceExtensionProperties = vulkan_play_device_list,
                       .CreateInstance = vulkan_play_instance};
    struct vulkan_extensions extensions = {0};
    CHECK(vulkan_make_instance(&v, NULL) == VK_ERROR_INCOMPATIBLE_DRIVER);
    CHECK(vulkan_seen_flags == VK_INSTANCE_CREATE_ENUMERATE_PORTABILITY_BIT_KHR);
    CHECK_TEXT(vulkan_seen_names, "VK_KHR_portability_enumeration");
    CHECK_TEXT(vulkan_seen_names, "VK_KHR_get_physical_device_properties2");
    vulkan_device_extensions(&v, &extensions);
    vulkan_note_names(extensions.name, extensions.enabled);
    CHECK_TEXT(vulkan_seen_names, "VK_KHR_portability_subset");
    oxl_free(device, extensions.there);
}

static const struct vulkan *vulkan_behind; /* the device that both of vulkan_play_two are */
static int vulkan_real_ones;
static char vulkan_heard[400];
#define VULKAN_BROKEN ((VkPhysicalDevice)(uintptr_t)16)

static void vulkan_hear_devices(void *user, oxl_log_level level, const char *text)
{
    (void)user;
    if (level == OXL_LOG_WARNING) snprintf(vulkan_heard, sizeof vulkan_heard, "%s", text);
}

static VKAPI_ATTR VkResult VKAPI_CALL vulkan_play_two(VkInstance instance, uint32_t *count,
                                                      VkPhysicalDevice *out)
{
    (void)instance;
    out[0] = VULKAN_BROKEN, out[1] = vulkan_behind->physical;
    *count = 1 + (uint32_t)vulkan_real_ones;
    return VK_SUCCESS;
}

static VKAPI_ATTR void VKAPI_CALL vulkan_play_properties(VkPhysicalDevice device,
                                                         VkPhysicalDeviceProperties *out)
{
    vulkan_behind->GetPhysicalDeviceProperties(vulkan_behind->physical, out);
    if (device != VULKAN_BROKEN) return;
    out->deviceType = VK_PHYSICAL_DEVICE_TYPE_DISCRETE_GPU;
    strcpy(out->deviceName, "Broken GPU");
}

static VKAPI_ATTR void VKAPI_CALL vulkan_play_heaps(VkPhysicalDevice device,
                                                    VkPhysicalDeviceMemoryProperties *out)
{
    (void)device;
    vulkan_behind->GetPhysicalDeviceMemoryProperties(vulkan_behind->physical, out);
}

static VKAPI_ATTR void VKAPI_CALL vulkan_play_families(VkPhysicalDevice device, uint32_t *count,
                                                       VkQueueFamilyProperties *out)
{
    (void)device;
    vulkan_behind->GetPhysicalDeviceQueueFamilyProperties(vulkan_behind->physical, count, out);
}

static int vulkan_breaks_late; /* when its fences are made, not the device itself */

static VKAPI_ATTR VkResult VKAPI_CALL vulkan_play_device(VkPhysicalDevice device,
                                                         const VkDeviceCreateInfo *info,
                                                         const VkAllocationCallbacks *a, VkDevice *out)
{
    VULKAN_LEAVE(out);
    if (device == VULKAN_BROKEN && !vulkan_breaks_late) return VK_ERROR_INITIALIZATION_FAILED;
    vulkan_breaks_late = device == VULKAN_BROKEN;
    return vulkan_behind->CreateDevice(vulkan_behind->physical, info, a, out);
}

static VKAPI_ATTR VkResult VKAPI_CALL vulkan_play_fence(VkDevice device, const VkFenceCreateInfo *info,
                                                        const VkAllocationCallbacks *a, VkFence *out)
{
    (void)device, (void)info, (void)a;
    VULKAN_LEAVE(out);
    return VK_ERROR_OUT_OF_HOST_MEMORY;
}

static VKAPI_ATTR PFN_vkVoidFunction VKAPI_CALL vulkan_play_lookup(VkDevice device, const char *name)
{
    if (vulkan_breaks_late && strcmp(name, "vkCreateFence") == 0)
        return (PFN_vkVoidFunction)vulkan_play_fence;
    return vulkan_behind->GetDeviceProcAddr(device, name);
}

/* The best device cannot be opened: the next one is, and what is said names both and why. The last one's
 * error stays; of a device that is named there is no next. */
static void vulkan_check_next_device(oxl_context *device)
{
    struct vulkan v = *device->backend->vulkan;
    vulkan_behind = device->backend->vulkan;
    memset((char *)&v + offsetof(struct vulkan, physical), 0, sizeof v - offsetof(struct vulkan, physical));
    v.EnumeratePhysicalDevices = vulkan_play_two;
    v.GetPhysicalDeviceProperties = vulkan_play_properties;
    v.GetPhysicalDeviceMemoryProperties = vulkan_play_heaps;
    v.GetPhysicalDeviceQueueFamilyProperties = vulkan_play_families;
    v.EnumerateDeviceExtensionProperties = vulkan_play_device_list;
    v.properties2 = 0;
    v.CreateDevice = vulkan_play_device;
    v.GetDeviceProcAddr = vulkan_play_lookup;
    device->options.log = vulkan_hear_devices;
    vulkan_real_ones = 1;
    for (int late = 0; late < 2; late++) {
        vulkan_breaks_late = late;
        CHECK(vulkan_open_best(&v, -1, 1) == OXL_OK);
        CHECK(v.physical == vulkan_behind->physical && v.mapped && v.staging.handle && v.frame[1].fence);
        CHECK_TEXT(vulkan_heard, late ? "Broken GPU, a fence: no host memory"
                                      : "Broken GPU, a device: it could not be started");
        CHECK_TEXT(vulkan_heard, ": trying ");
        CHECK_TEXT(vulkan_heard, vulkan_behind->properties.deviceName);
        vulkan_close_device(&v);
        CHECK(!v.device && !v.staging.handle);
    }
    vulkan_breaks_late = 0;
    CHECK(vulkan_open_best(&v, 0, 1) == OXL_ERR_FAILED && !v.device);
    vulkan_close_device(&v);
    vulkan_real_ones = 0;
    CHECK(vulkan_open_best(&v, -1, 1) == OXL_ERR_FAILED);
    CHECK_TEXT(oxl_error_text(device), "Broken GPU, a device: it could not be started");
    device->options.log = vulkan_test_log;
}

/* 16384 bytes is what Vulkan 1.0 promises of any device, and counts as std430 lays arrays out. */
static void vulkan_check_shared(oxl_context *device)
{
    (void)device;
    CHECK(vulkan_shared() <= 16384);
    CHECK(SPIRV_LOSS_TOTAL_SHARED == 256 * (16 + 8)); /* a vec3 of an array takes 16 bytes */
}

/* ---------------- loss */

static void vulkan_check_loss_of(oxl_context *device, int width, int height, float ssim_weight, int masked,
                                 const float *gain)
{
    struct vulkan_twins t = vulkan_twins(device, width, height);
    float *target = vulkan_noise(3 * t.pixels, 60), *weight = vulkan_noise(t.pixels, 61);
    float *drgb = oxl_alloc(test_ctx, 3 * t.pixels, sizeof *drgb);
    struct vulkan_renderer *r;
    struct renderer_loss loss[2];
    oxl_model m;
    for (size_t i = 0; i < t.pixels; i++) weight[i] = weight[i] > -0.98f; /* a fiftieth is masked */
    for (size_t i = 0; i < 3 * t.pixels; i++) target[i] = 0.5f + 0.4f * target[i];
    vulkan_scene(300, 0, 0, &m);
    vulkan_forward_both(&t, &m);
    for (int k = 0; k < 2; k++) {
        renderer_set_gain(t.r[k], gain);
        CHECK_OK(renderer_loss(t.ctx[k], t.r[k], target, masked ? weight : NULL, ssim_weight, &loss[k]));
    }
    for (int c = 0; gain && c < 3; c++) {
        CHECK(fabs(loss[0].dlog_gain[c]) > 1e-3);
        CHECK_CLOSE(loss[1].dlog_gain[c], loss[0].dlog_gain[c], 1e-4 * fabs(loss[0].dlog_gain[c]));
    }
    CHECK_CLOSE(loss[1].l1, loss[0].l1, 1e-5);
    CHECK_CLOSE(loss[1].ssim, loss[0].ssim, 1e-5);
    CHECK_CLOSE(loss[1].mse, loss[0].mse, 1e-5);
    CHECK_CLOSE(loss[1].total, loss[0].total, 1e-5);
    r = t.r[1]->device;
    vulkan_download(device->backend->vulkan, &r->drgb, 0, drgb, 3 * t.pixels * sizeof *drgb);
    CHECK_CLOSE(vulkan_distance(t.r[0]->drgb, drgb, 3 * t.pixels).relative, 0, 1e-3);
    oxl_model_free(test_ctx, &m);
    oxl_free(test_ctx, target);
    oxl_free(test_ctx, weight);
    oxl_free(test_ctx, drgb);
    vulkan_twins_free(&t);
}

static void vulkan_check_loss(oxl_context *device)
{
    const float gain[3] = {1.3f, 0.6f, 1.1f};
    vulkan_check_loss_of(device, 70, 43, 0.2f, 0, NULL);
    vulkan_check_loss_of(device, 70, 43, 0.2f, 1, NULL);
    vulkan_check_loss_of(device, 33, 20, 0, 1, NULL);
    vulkan_check_loss_of(device, 7, 5, 1, 0, NULL); /* smaller than a window */
    vulkan_check_loss_of(device, 70, 43, 0.2f, 1, gain);
    vulkan_check_loss_of(device, 33, 20, 0, 0, gain);
}

/* Images are compared as the bytes that they are, whole or at half the sides, kept on the device or passing
 * through. */
static void vulkan_check_image_of(oxl_context *device, int width, int height, int masked, int halved)
{
    struct vulkan_twins t = vulkan_twins(device, width >> halved, height >> halved);
    const size_t pixels = (size_t)width * (size_t)height;
    uint8_t *bytes = oxl_alloc(test_ctx, 4 * pixels, 1);
    const size_t stays = (3 * pixels + 3) / 4 * 4 + (masked ? (pixels + 3) / 4 * 4 : 0); /* whole words */
    struct training_image image = {width, height, bytes, masked ? bytes + 3 * pixels : NULL};
    struct renderer_loss loss[2];
    oxl_model m;
    vulkan_scene(200, 0, 0, &m);
    for (size_t i = 0; i < 4 * pixels; i++)
        bytes[i] = (uint8_t)(random_bits(9, i, 0) & (i < 3 * pixels || i % 97 ? 255 : 0));
    for (int round = 0; round < 2; round++) {
        const struct training_image *given = renderer_has_image(t.r[1], 3) ? NULL : &image;
        vulkan_forward_both(&t, &m);
        for (int k = 0; k < 2; k++) {
            CHECK_OK(renderer_set_image(t.ctx[k], t.r[k], 3, k ? given : &image, NULL, halved));
            CHECK_OK(renderer_loss(t.ctx[k], t.r[k], NULL, NULL, 0.2f, &loss[k]));
        }
        CHECK_CLOSE(loss[1].l1, loss[0].l1, 1e-5);
        CHECK_CLOSE(loss[1].ssim, loss[0].ssim, 1e-5);
    }
    CHECK(((struct vulkan_renderer *)t.r[1]->device)->image_bytes ==
          (device->backend->vulkan->image_bytes_max > 0 ? stays : 0));
    CHECK(renderer_has_image(t.r[1], 3) == (device->backend->vulkan->image_bytes_max > 0) &&
          !renderer_has_image(t.r[1], 2));
    oxl_model_free(test_ctx, &m);
    oxl_free(test_ctx, bytes);
    vulkan_twins_free(&t);
}

static void vulkan_check_images(oxl_context *device)
{
    vulkan_check_image_of(device, 41, 33, 1, 0);
    vulkan_check_image_of(device, 81, 65, 1, 1);
    vulkan_check_image_of(device, 41, 33, 0, 0);
    device->backend->vulkan->image_bytes_max = 0;
    vulkan_check_image_of(device, 40, 31, 0, 0);
}

/* ---------------- backward, score, step */

static void vulkan_check_gradient_of(oxl_context *device, int degree, size_t lobes, int antialias)
{
    struct vulkan_twins t = vulkan_twins(device, 90, 60);
    float *drgb = vulkan_noise(3 * t.pixels, 50);
    oxl_model m, gradient[2];
    vulkan_scene(700, degree, lobes, &m);
    m.antialias = antialias;
    vulkan_forward_both(&t, &m);
    for (int k = 0; k < 2; k++) {
        CHECK_OK(oxl_model_create(test_ctx, m.count, degree, &gradient[k]));
        memset(gradient[k].plane[OXL_ROTATION], 0, gradient[k].capacity * sizeof(float));
        CHECK_OK(renderer_backward(t.ctx[k], t.r[k], drgb, &gradient[k]));
        CHECK_OK(renderer_gradient(t.ctx[k], t.r[k], &gradient[k]));
    }
    for (int k = 0; k < oxl_model_planes(&m); k++)
        CHECK_CLOSE(vulkan_distance(gradient[0].plane[k], gradient[1].plane[k], m.count).relative, 0, 2e-3);
    for (int k = OXL_LOBE; lobes && k < OXL_PLANES; k++)
        CHECK_CLOSE(vulkan_distance(gradient[0].plane[k], gradient[1].plane[k], lobes).relative, 0, 2e-3);
    vulkan_download_rows(device, t.r[1]);
    for (size_t i = 0; i < m.count; i++)
        if (renderer_row_visible(t.r[0], i) && renderer_row_visible(t.r[1], i))
            CHECK_CLOSE(t.r[1]->dmean2d[i], t.r[0]->dmean2d[i], 1e-2 * t.r[0]->dmean2d[i] + 1e-2);
    for (int k = 0; k < 2; k++) oxl_model_free(test_ctx, &gradient[k]);
    oxl_model_free(test_ctx, &m);
    oxl_free(test_ctx, drgb);
    vulkan_twins_free(&t);
}

static void vulkan_check_gradient(oxl_context *device)
{
    for (int antialias = 0; antialias < 2; antialias++) {
        vulkan_check_gradient_of(device, 3, 0, antialias);
        vulkan_check_gradient_of(device, 1, 300, antialias);
    }
}

/* ---------------- medium, lamp, dropout, the loss in front of points */

struct vulkan_imaging {
    const struct medium *medium;
    const float *gain;
    int lit, points, degree;
    size_t lobes;
    double dropout, contrast;
    int window; /* 1: the camera shows a part of the image */
    const oxl_model *context;
};

static const struct medium vulkan_murky = {
    1, {0.10f, 0.05f, 0.03f}, {0.12f, 0.08f, 0.06f}, {0.1f, 0.3f, 0.5f}, 1.5f};

/* Loss, and gradients of everything, of one renderer. */
static struct renderer_loss vulkan_imaging_step(oxl_context *ctx, struct renderer *r,
                                                const oxl_camera *camera, const struct vulkan_imaging *o,
                                                const float *target, const oxl_model *m, oxl_model *gradient)
{
    static const float at[2] = {24, 16};
    struct lamp lamp = {.view = -1};
    struct depth_point point[DEPTH_POINTS];
    oxl_render_options options = oxl_render_options_default();
    struct renderer_loss loss;
    for (int k = 0; k < LAMP_TERMS; k++) lamp.shape[k] = 0.3f * (float)vulkan_random((uint64_t)k, 70);
    for (int k = 0; k < o->points; k++)
        point[k] = (struct depth_point){(float)(0.5 + 45 * (1 + vulkan_random((uint64_t)k, 71))),
                                        (float)(0.5 + 30 * (1 + vulkan_random((uint64_t)k, 72))),
                                        (float)(5 + 2 * vulkan_random((uint64_t)k, 73))};
    if (o->window) renderer_set_window(r, at, 2 * camera->width, 2 * camera->height);
    renderer_set_context(r, o->context);
    renderer_set_medium(r, o->medium);
    renderer_set_lamp(r, o->lit ? &lamp : NULL);
    renderer_set_gain(r, o->gain);
    renderer_set_contrast(r, o->contrast);
    renderer_set_dropout(r, o->dropout, UINT64_C(0x123456789abcdef), 77);
    CHECK_OK(renderer_forward(ctx, r, m, camera, &options));
    CHECK_OK(renderer_loss(ctx, r, target, NULL, 0.2f, &loss));
    renderer_set_depths(r, point, o->points, 1);
    CHECK_OK(oxl_model_create(test_ctx, m->count, o->degree, gradient));
    memset(gradient->plane[OXL_ROTATION], 0, gradient->capacity * sizeof(float));
    CHECK_OK(renderer_backward(ctx, r, NULL, gradient));
    CHECK_OK(renderer_gradient(ctx, r, gradient));
    memcpy(loss.dlamp, renderer_lamp_gradient(r), sizeof loss.dlamp);
    return loss;
}

static void vulkan_compare_sums(const double *cpu, const double *device, int count)
{
    double most = 0;
    for (int k = 0; k < count; k++) most = OXL_MAX(most, fabs(cpu[k]));
    CHECK(most > 0);
    for (int k = 0; k < count; k++) CHECK_CLOSE(device[k], cpu[k], 2e-3 * most);
}

/* Statistics of density control of both. */
static void vulkan_compare_observed(struct vulkan_twins *t, size_t count)
{
    float *numbers = oxl_calloc(test_ctx, 8 * count, sizeof *numbers);
    for (int k = 0; k < 2; k++) {
        float *at = numbers + 4 * count * (size_t)k;
        const struct renderer_sums sums = {count, 1, 3.5f, 5, at, at + count, at + 2 * count, at + 3 * count};
        CHECK_OK(renderer_observe(t->ctx[k], t->r[k], &sums));
        CHECK_OK(renderer_download(t->ctx[k], t->r[k], DOWNLOAD_TO_READ));
    }
    CHECK_CLOSE(vulkan_distance(numbers, numbers + 4 * count, 3 * count).relative, 0, 1e-2);
    CHECK_CLOSE(vulkan_distance(numbers + 3 * count, numbers + 7 * count, count).most, 0, 0);
    oxl_free(test_ctx, numbers);
}

static void vulkan_check_imaging_of(oxl_context *device, const struct vulkan_imaging *o)
{
    struct vulkan_twins t = vulkan_twins(device, 90, 60);
    float *target = vulkan_noise(3 * t.pixels, 74);
    struct renderer_loss loss[2];
    oxl_model m, gradient[2];
    for (size_t i = 0; i < 3 * t.pixels; i++) target[i] = 0.5f + 0.4f * target[i];
    vulkan_scene(700, o->degree, o->lobes, &m);
    for (int k = 0; k < 2; k++)
        loss[k] = vulkan_imaging_step(t.ctx[k], t.r[k], &t.camera, o, target, &m, &gradient[k]);
    vulkan_compare_images(&t);
    CHECK_CLOSE(loss[1].total, loss[0].total, 1e-5);
    if (o->lit) vulkan_compare_sums(loss[0].dlamp, loss[1].dlamp, LAMP_TERMS);
    if (o->gain) vulkan_compare_sums(loss[0].dlog_gain, loss[1].dlog_gain, 3);
    for (int k = 0; k < oxl_model_planes(&m); k++)
        CHECK_CLOSE(vulkan_distance(gradient[0].plane[k], gradient[1].plane[k], m.count).relative, 0, 5e-3);
    vulkan_compare_observed(&t, m.count);
    vulkan_download_rows(device, t.r[1]);
    for (size_t i = 0; i < m.count; i++)
        if (renderer_row_visible(t.r[0], i) && renderer_row_visible(t.r[1], i))
            CHECK_CLOSE(t.r[1]->dmean2d[i], t.r[0]->dmean2d[i], 1e-2 * t.r[0]->dmean2d[i] + 1e-6);
    for (int k = 0; k < 2; k++) oxl_model_free(test_ctx, &gradient[k]);
    oxl_model_free(test_ctx, &m);
    oxl_free(test_ctx, target);
    vulkan_twins_free(&t);
}

static void vulkan_check_lamp(oxl_context *device)
{
    static const float gain[3] = {1.3f, 0.6f, 1.1f};
    vulkan_check_imaging_of(device, &(struct vulkan_imaging){.lit = 1, .gain = gain});
    vulkan_check_imaging_of(device, &(struct vulkan_imaging){.lit = 1, .contrast = 0.004});
    vulkan_check_imaging_of(device, &(struct vulkan_imaging){.lit = 1, .gain = gain, .window = 1});
}

static void vulkan_check_medium(oxl_context *device)
{
    struct medium m = vulkan_murky;
    vulkan_check_imaging_of(device, &(struct vulkan_imaging){.medium = &m, .degree = 2});
    vulkan_check_imaging_of(device, &(struct vulkan_imaging){.medium = &m, .lit = 1, .lobes = 300});
    device->backend->vulkan->slab_rows = 256; /* several slabs */
    device->backend->vulkan->groups_max = 9;
    vulkan_check_imaging_of(device, &(struct vulkan_imaging){.medium = &m, .degree = 1});
}

static void vulkan_check_depth_loss(oxl_context *device)
{
    vulkan_check_imaging_of(device, &(struct vulkan_imaging){.points = DEPTH_POINTS});
    vulkan_check_imaging_of(device,
                            &(struct vulkan_imaging){.points = 40, .medium = &vulkan_murky, .lobes = 200});
}

static void vulkan_check_dropout(oxl_context *device)
{
    struct vulkan_twins t = vulkan_twins(device, 90, 60);
    size_t seen[2] = {0, 0};
    oxl_model m;
    vulkan_check_imaging_of(device, &(struct vulkan_imaging){.dropout = 0.4, .lobes = 200});
    vulkan_check_imaging_of(device, &(struct vulkan_imaging){.dropout = 0.2, .medium = &vulkan_murky});
    vulkan_scene(700, 0, 0, &m);
    for (int on = 0; on < 2; on++) {
        for (int k = 0; k < 2; k++) renderer_set_dropout(t.r[k], 0.5 * on, 3, 7);
        vulkan_forward_both(&t, &m);
        vulkan_download_rows(device, t.r[1]);
        for (size_t i = 0; i < m.count; i++) {
            CHECK(renderer_row_visible(t.r[0], i) == renderer_row_visible(t.r[1], i));
            seen[on] += (size_t)renderer_row_visible(t.r[1], i);
        }
    }
    CHECK_CLOSE((double)seen[1], 0.5 * (double)seen[0], 0.1 * (double)seen[0]);
    oxl_model_free(test_ctx, &m);
    vulkan_twins_free(&t);
}

static void vulkan_check_score(oxl_context *device)
{
    for (size_t lobes = 0; lobes <= 200; lobes += 200) {
        struct vulkan_twins t = vulkan_twins(device, 80, 50);
        float *drgb = vulkan_noise(3 * t.pixels, 51), *score[2];
        oxl_model m;
        vulkan_scene(400, 0, lobes, &m);
        vulkan_forward_both(&t, &m);
        for (int k = 0; k < 2; k++) {
            score[k] = oxl_calloc(test_ctx, m.count, sizeof *score[k]);
            CHECK_OK(renderer_score(t.ctx[k], t.r[k], drgb, score[k]));
        }
        CHECK_CLOSE(vulkan_distance(score[0], score[1], m.count).relative, 0, 1e-3);
        for (int k = 0; k < 2; k++) oxl_free(test_ctx, score[k]);
        oxl_model_free(test_ctx, &m);
        oxl_free(test_ctx, drgb);
        vulkan_twins_free(&t);
    }
}

struct vulkan_run { /* a model that is stepped, and what it takes */
    struct trained_model trained;
    oxl_model gradient;
    struct renderer_sums sums;
    float *numbers; /* of the sums */
};

static struct vulkan_run vulkan_run_begin(size_t count, int degree, size_t lobes)
{
    struct vulkan_run r;
    oxl_model *const rest[] = {&r.trained.mean, &r.trained.square, &r.gradient};
    vulkan_scene(count, degree, lobes, &r.trained.model);
    for (size_t k = 0; k < OXL_COUNT(rest); k++) {
        CHECK_OK(oxl_model_create(test_ctx, count, degree, rest[k]));
        CHECK_OK(model_set_lobes(test_ctx, rest[k], lobes));
        memset(rest[k]->plane[OXL_ROTATION], 0, rest[k]->capacity * sizeof(float));
    }
    r.numbers = oxl_calloc(test_ctx, 4 * count, sizeof *r.numbers);
    r.sums = (struct renderer_sums){
        count, 1, 3.5f, 5, r.numbers, r.numbers + count, r.numbers + 2 * count, r.numbers + 3 * count};
    return r;
}

static void vulkan_run_free(struct vulkan_run *r)
{
    model_trained_free(test_ctx, &r->trained);
    oxl_model_free(test_ctx, &r->gradient);
    oxl_free(test_ctx, r->numbers);
}

/* Steps from..to against noise; so many rows are skipped in each as not finite. */
static void vulkan_run_steps(oxl_context *ctx, struct renderer *r, const oxl_camera *camera,
                             struct vulkan_run *run, const float *drgb, int from, int to,
                             size_t skipped_wanted)
{
    oxl_render_options options = oxl_render_options_default();
    struct renderer_nonfinite skipped;
    struct adam_params adam = {.beta = {0.7, 0.9995}};
    for (int k = 0; k < OXL_PLANES; k++) adam.rate[k] = 1e-3f;
    for (adam.step = from; adam.step <= to; adam.step++) {
        CHECK_OK(renderer_forward(ctx, r, &run->trained.model, camera, &options));
        CHECK_OK(renderer_backward(ctx, r, drgb, &run->gradient));
        CHECK_OK(renderer_step(ctx, r, &run->trained, &run->gradient, &adam, &skipped));
        CHECK(skipped.rows == skipped_wanted);
        CHECK_OK(renderer_observe(ctx, r, &run->sums));
    }
    CHECK_OK(renderer_download(ctx, r, DOWNLOAD_TO_CHANGE));
}

static void vulkan_compare_models(const oxl_model *a, const oxl_model *b, double bound)
{
    for (int k = 0; k < oxl_model_planes(a); k++)
        CHECK_CLOSE(vulkan_distance(a->plane[k], b->plane[k], a->count).relative, 0, bound);
    for (int k = OXL_LOBE; a->lobes && k < OXL_PLANES; k++)
        CHECK_CLOSE(vulkan_distance(a->plane[k], b->plane[k], a->lobes).relative, 0, bound);
}

/* The first step of Adam has the sign of the gradient: where that is next to nothing the signs may differ. */
static void vulkan_check_steps(oxl_context *device)
{
    for (size_t lobes = 0; lobes <= 300; lobes += 300) {
        struct vulkan_twins t = vulkan_twins(device, 64, 48);
        float *drgb = vulkan_noise(3 * t.pixels, 52);
        struct vulkan_run run[2];
        device->backend->vulkan->slab_rows = 256; /* several slabs */
        for (int k = 0; k < 2; k++) {
            run[k] = vulkan_run_begin(600, 1, lobes);
            vulkan_run_steps(t.ctx[k], t.r[k], &t.camera, &run[k], drgb, 1, 3, 0);
        }
        vulkan_compare_models(&run[0].trained.model, &run[1].trained.model, 1e-3);
        vulkan_compare_models(&run[0].trained.mean, &run[1].trained.mean, 5e-3);
        vulkan_compare_models(&run[0].trained.square, &run[1].trained.square, 5e-3);
        for (int k = 0; k < 3; k++)
            CHECK_CLOSE(vulkan_distance(run[0].numbers + 600 * k, run[1].numbers + 600 * k, 600).relative, 0,
                        5e-3);
        CHECK_CLOSE(vulkan_distance(run[0].sums.views, run[1].sums.views, 600).most, 0, 3);
        for (int k = 0; k < 2; k++) vulkan_run_free(&run[k]);
        oxl_free(test_ctx, drgb);
        vulkan_twins_free(&t);
    }
}

/* When the host looks, and at what, does not show in the result: checkpoints come when they come. */
static void vulkan_check_downloads(oxl_context *device)
{
    const oxl_camera camera = vulkan_camera(64, 48);
    float *drgb = vulkan_noise((size_t)3 * 64 * 48, 52);
    struct vulkan_run run[2];
    for (int k = 0; k < 2; k++) {
        struct renderer *r;
        CHECK_OK(renderer_create(device, &r));
        run[k] = vulkan_run_begin(300, 1, 100);
        if (k == 0) vulkan_run_steps(device, r, &camera, &run[k], drgb, 1, 4, 0);
        for (int step = 1; k == 1 && step <= 4; step++)
            vulkan_run_steps(device, r, &camera, &run[k], drgb, step, step, 0);
        renderer_free(device, r);
    }
    for (int k = 0; k < oxl_model_planes(&run[0].trained.model); k++) {
        CHECK(memcmp(run[0].trained.model.plane[k], run[1].trained.model.plane[k], 300 * sizeof(float)) == 0);
        CHECK(memcmp(run[0].trained.square.plane[k], run[1].trained.square.plane[k], 300 * sizeof(float)) ==
              0);
    }
    CHECK(memcmp(run[0].numbers, run[1].numbers, 4 * 300 * sizeof(float)) == 0);
    for (int k = 0; k < 2; k++) vulkan_run_free(&run[k]);
    oxl_free(test_ctx, drgb);
}

static void vulkan_check_same_model(const oxl_model *a, const oxl_model *b)
{
    CHECK(a->count == b->count && a->lobes == b->lobes);
    for (int k = 0; k < OXL_PLANES && a->count == b->count; k++) {
        const size_t rows = k >= OXL_LOBE ? a->lobes : k < oxl_model_planes(a) ? a->count : 0;
        if (rows > 0) CHECK(memcmp(a->plane[k], b->plane[k], rows * sizeof(float)) == 0);
    }
}

/* After a loss that is not finite: of three rows one holds such a number unseen, one makes such a colour, one
 * holds one among its lobes. They are cleared as on the CPU, and 12 bytes are read. */
static void vulkan_check_cleared(oxl_context *device)
{
    struct vulkan_twins t = vulkan_twins(device, 64, 48);
    struct renderer_nonfinite cleared[2];
    struct vulkan_run run[2];
    size_t read;
    device->backend->vulkan->slab_rows = 256;
    for (int k = 0; k < 2; k++) {
        run[k] = vulkan_run_begin(600, 1, 300);
        for (int i = 0; i < 3; i++) run[k].trained.model.plane[OXL_MEAN + i][400] = i == 2 ? 2.6f : -1.5f;
        for (int i = 0; i < 3; i++) run[k].trained.model.plane[OXL_LOG_SCALE + i][400] = 0;
        for (int i = 0; i < 4; i++) /* each fits a float, their sum does not */
            run[k].trained.model.plane[OXL_SH + 3 * i + 2][400] = 3.4e38f;
        run[k].trained.model.plane[OXL_MEAN + 2][500] = -50;
        run[k].trained.model.plane[OXL_SH + 5][500] = NAN;
        run[k].trained.model.plane[OXL_LOBE + 1][200] = INFINITY;
        run[k].trained.mean.plane[OXL_LOG_SCALE][500] = 1;
        run[k].trained.square.plane[OXL_LOBE + 1][200] = 1;
        run[k].trained.square.plane[OXL_OPACITY][201] = 1;
    }
    for (int k = 0; k < 2; k++) {
        const oxl_render_options options = oxl_render_options_default();
        CHECK_OK(renderer_forward(t.ctx[k], t.r[k], &run[k].trained.model, &t.camera, &options));
    }
    cleared[0] = nonfinite_clear(t.r[0], &run[0].trained);
    read = device->backend->vulkan->read_bytes;
    CHECK_OK(renderer_clear_nonfinite(device, t.r[1], &run[1].trained, &cleared[1]));
    CHECK(device->backend->vulkan->read_bytes - read == 12);
    for (int k = 0; k < 2; k++)
        CHECK(cleared[k].rows == 3 && cleared[k].first == 200 && cleared[k].cleared == 3);
    CHECK_OK(renderer_download(device, t.r[1], DOWNLOAD_TO_READ));
    vulkan_check_same_model(&run[0].trained.model, &run[1].trained.model);
    vulkan_check_same_model(&run[0].trained.mean, &run[1].trained.mean);
    vulkan_check_same_model(&run[0].trained.square, &run[1].trained.square);
    for (int k = 0; k < 2; k++) vulkan_run_free(&run[k]);
    vulkan_twins_free(&t);
}

static void vulkan_check_aside(oxl_context *device)
{
    struct vulkan_twins t = vulkan_twins(device, 64, 48);
    float *drgb = vulkan_noise(3 * t.pixels, 52);
    for (int k = 0; k < 2; k++) {
        struct vulkan_run run = vulkan_run_begin(64, 1, 0);
        for (int i = 0; i < 3; i++) run.trained.model.plane[OXL_MEAN + i][40] = i == 2 ? 4 : -1;
        run.trained.model.plane[OXL_SH + 5][40] = NAN;
        vulkan_run_steps(t.ctx[k], t.r[k], &t.camera, &run, drgb, 1, 1, 1);
        CHECK(run.trained.mean.plane[OXL_OPACITY][40] == 0 && run.sums.views[40] == 0);
        vulkan_run_free(&run);
    }
    oxl_free(test_ctx, drgb);
    vulkan_twins_free(&t);
}

/* ---------------- deferred steps */

struct vulkan_deferral { /* a run whose steps are deferred, against one image */
    struct vulkan_run run;
    struct renderer *r;
    oxl_camera camera;
    uint8_t bytes[3 * 64 * 48];
};

static void vulkan_deferral_begin(oxl_context *device, struct vulkan_deferral *d)
{
    d->run = vulkan_run_begin(300, 1, 100);
    d->camera = vulkan_camera(64, 48);
    for (size_t i = 0; i < sizeof d->bytes; i++) d->bytes[i] = (uint8_t)random_bits(9, i, 0);
    CHECK_OK(renderer_create(device, &d->r));
}

static void vulkan_deferral_end(oxl_context *device, struct vulkan_deferral *d)
{
    renderer_free(device, d->r);
    vulkan_run_free(&d->run);
}

static void vulkan_step_of(oxl_context *device, struct vulkan_deferral *d, int step,
                           struct renderer_loss *loss)
{
    const struct training_image image = {d->camera.width, d->camera.height, d->bytes, NULL};
    const oxl_render_options options = oxl_render_options_default();
    struct adam_params adam = {.beta = {0.7, 0.9995}, .step = step};
    struct renderer_nonfinite skipped;
    for (int k = 0; k < OXL_PLANES; k++) adam.rate[k] = 1e-3f;
    CHECK_OK(renderer_set_image(device, d->r, 0, &image, NULL, 0));
    CHECK_OK(renderer_forward(device, d->r, &d->run.trained.model, &d->camera, &options));
    CHECK_OK(renderer_loss(device, d->r, NULL, NULL, 0.2f, loss));
    CHECK_OK(renderer_backward(device, d->r, NULL, &d->run.gradient));
    CHECK_OK(renderer_step(device, d->r, &d->run.trained, &d->run.gradient, &adam, &skipped));
    CHECK_OK(renderer_observe(device, d->r, &d->run.sums));
}

static void vulkan_check_same_run(const struct vulkan_deferral *a, const struct vulkan_deferral *b)
{
    for (int k = 0; k < oxl_model_planes(&a->run.trained.model); k++) {
        CHECK(memcmp(a->run.trained.model.plane[k], b->run.trained.model.plane[k], 300 * sizeof(float)) == 0);
        CHECK(memcmp(a->run.trained.square.plane[k], b->run.trained.square.plane[k], 300 * sizeof(float)) ==
              0);
    }
    CHECK(memcmp(a->run.numbers, b->run.numbers, 4 * 300 * sizeof(float)) == 0);
}

/* The same losses, one step late, and the same model; the host never waits for a device that has nothing else
 * to do. */
static void vulkan_check_deferral(oxl_context *device)
{
    static struct vulkan_deferral d[2];
    struct vulkan *v = device->backend->vulkan;
    struct renderer_loss loss[7], none;
    struct renderer_report report;
    size_t waits = 0, dispatches = 0;
    for (int k = 0; k < 2; k++) vulkan_deferral_begin(device, &d[k]);
    for (int step = 1; step <= 6; step++) vulkan_step_of(device, &d[0], step, &loss[step]);
    CHECK(renderer_defer(d[1].r, 1));
    for (int step = 1; step <= 6; step++) {
        if (step == 2) waits = v->waits, dispatches = v->dispatches;
        vulkan_step_of(device, &d[1], step, &none);
        CHECK_OK(renderer_report(device, d[1].r, 0, &report));
        CHECK(report.exists == (step > 1) && report.halt == HALT_NONE && report.skipped.rows == 0);
        if (step > 1)
            CHECK(report.loss.total == loss[step - 1].total && report.loss.mse == loss[step - 1].mse);
    }
    CHECK(v->waits == waits && v->dispatches - dispatches <= 5 * 40);
    CHECK_OK(renderer_report(device, d[1].r, 1, &report));
    CHECK(report.exists && report.loss.total == loss[6].total);
    CHECK_OK(renderer_report(device, d[1].r, 1, &report));
    CHECK(!report.exists);
    for (int k = 0; k < 2; k++) CHECK_OK(renderer_download(device, d[k].r, DOWNLOAD_TO_CHANGE));
    vulkan_check_same_run(&d[0], &d[1]);
    for (int k = 0; k < 2; k++) vulkan_deferral_end(device, &d[k]);
}

/* A step without room for its pairs, or whose loss is not finite: neither it nor the one behind it changes
 * anything, and what the host then sees are its rows. */
static void vulkan_check_halt(oxl_context *device)
{
    for (int halt = HALT_PAIRS; halt <= HALT_LOSS; halt++) {
        static struct vulkan_deferral d[2];
        struct vulkan_renderer *r;
        struct renderer_loss none;
        struct renderer_report report;
        size_t room;
        for (int k = 0; k < 2; k++) {
            vulkan_deferral_begin(device, &d[k]);
            for (int step = 1; step <= 2; step++) vulkan_step_of(device, &d[k], step, &none);
            CHECK_OK(renderer_download(device, d[k].r, DOWNLOAD_TO_CHANGE));
            for (int i = 0; i < 3; i++) d[k].run.trained.model.plane[OXL_MEAN + i][40] = i == 2 ? 4 : -1;
            if (halt == HALT_LOSS) d[k].run.trained.model.plane[OXL_SH][40] = INFINITY;
        }
        r = d[1].r->device;
        CHECK(renderer_defer(d[1].r, 1));
        vulkan_take_model(r, &d[1].run.trained.model);
        r->room = room = 2 * r->pairs;
        if (halt == HALT_PAIRS) r->room = 100;
        vulkan_step_of(device, &d[1], 3, &none);
        r->room = room;
        d[1].camera.translation[0] += 50; /* sees nothing */
        vulkan_step_of(device, &d[1], 4, &none);
        d[1].camera = d[0].camera;
        CHECK_OK(renderer_report(device, d[1].r, 1, &report));
        CHECK(report.exists && (int)report.halt == halt);
        if (halt == HALT_PAIRS)
            CHECK(r->report[0].counts[COUNT_PAIRS] == 0 && r->report[0].counts[COUNT_PAIRS_FOUND] > 100);
        CHECK_OK(renderer_report(device, d[1].r, 1, &report));
        CHECK(!report.exists);
        renderer_defer(d[1].r, 0);
        vulkan_download_rows(device, d[1].r);
        CHECK(renderer_row_visible(d[1].r, 40) && renderer_row_finite(d[1].r, 40) == (halt == HALT_PAIRS));
        CHECK_OK(renderer_download(device, d[1].r, DOWNLOAD_TO_READ));
        vulkan_check_same_run(&d[0], &d[1]);
        vulkan_step_of(device, &d[1], 3, &none); /* the next one does */
        CHECK_OK(renderer_download(device, d[1].r, DOWNLOAD_TO_READ));
        if (halt == HALT_PAIRS)
            CHECK(memcmp(d[0].run.trained.model.plane[OXL_MEAN], d[1].run.trained.model.plane[OXL_MEAN],
                         300 * sizeof(float)) != 0);
        for (int k = 0; k < 2; k++) vulkan_deferral_end(device, &d[k]);
    }
}

/* Bytes between host and device: a checkpoint reads and sends nothing again, a row that is not finite costs
 * nothing more. */
/* A deferred step without room is given up for another reason, before it has a report: the next step is done
 * all the same. */
static void vulkan_check_no_halt_stays(oxl_context *device)
{
    static struct vulkan_deferral d[2];
    const oxl_render_options options = oxl_render_options_default();
    struct renderer_loss none;
    for (int k = 0; k < 2; k++) {
        vulkan_deferral_begin(device, &d[k]);
        vulkan_step_of(device, &d[k], 1, &none);
        if (k) {
            CHECK(renderer_defer(d[k].r, 1));
            ((struct vulkan_renderer *)d[k].r->device)->room = 100;
            CHECK_OK(renderer_forward(device, d[k].r, &d[k].run.trained.model, &d[k].camera, &options));
            renderer_defer(d[k].r, 0);
        }
        vulkan_step_of(device, &d[k], 2, &none);
        CHECK_OK(renderer_download(device, d[k].r, DOWNLOAD_TO_READ));
    }
    vulkan_check_same_run(&d[0], &d[1]);
    for (int k = 0; k < 2; k++) vulkan_deferral_end(device, &d[k]);
}

static void vulkan_check_transfers(oxl_context *device)
{
    static struct vulkan_deferral d;
    struct vulkan *v = device->backend->vulkan;
    const size_t model = 300 * 23 * 4 + 100 * 4 * 4, statistics = 300 * 16, counts = 4 + 32 + 12;
    struct renderer_loss loss;
    size_t sent, read;
    vulkan_deferral_begin(device, &d);
    for (int step = 1; step <= 2; step++) vulkan_step_of(device, &d, step, &loss);
    read = v->read_bytes, sent = v->sent;
    CHECK_OK(renderer_download(device, d.r, DOWNLOAD_TO_READ));
    CHECK(v->read_bytes - read == 3 * model + statistics);
    read = v->read_bytes;
    vulkan_step_of(device, &d, 3, &loss);
    CHECK(v->read_bytes - read == counts && v->sent == sent);
    CHECK_OK(renderer_download(device, d.r, DOWNLOAD_TO_CHANGE));
    for (int i = 0; i < 3; i++) d.run.trained.model.plane[OXL_MEAN + i][40] = i == 2 ? 4 : -1;
    d.run.trained.mean.plane[OXL_SH][40] = NAN;
    d.run.trained.model.plane[OXL_SH + 5][40] = NAN;
    vulkan_step_of(device, &d, 4, &loss);
    read = v->read_bytes, sent = v->sent;
    vulkan_step_of(device, &d, 5, &loss);
    CHECK(v->read_bytes - read == counts && v->sent == sent);
    CHECK_OK(renderer_download(device, d.r, DOWNLOAD_TO_READ));
    CHECK(d.run.trained.model.plane[OXL_SH + 5][40] == 0 && d.run.trained.model.plane[OXL_ROTATION][40] == 1);
    CHECK(d.run.trained.model.plane[OXL_OPACITY][40] == -30 && d.run.trained.mean.plane[OXL_SH][40] == 0);
    vulkan_deferral_end(device, &d);
}

/* ---------------- what goes wrong */

static int vulkan_lost_calls; /* the one that fails, and those behind it */

static VKAPI_ATTR VkResult VKAPI_CALL vulkan_play_timeout(VkDevice device, uint32_t count,
                                                          const VkFence *fence, VkBool32 all,
                                                          uint64_t timeout)
{
    (void)device, (void)count, (void)fence, (void)all, (void)timeout;
    /* who would wait for ever fails here, and ends */
    return ++vulkan_lost_calls < 100 ? VK_TIMEOUT : VK_ERROR_DEVICE_LOST;
}

static VKAPI_ATTR VkResult VKAPI_CALL vulkan_play_loss(VkQueue queue, uint32_t count,
                                                       const VkSubmitInfo *info, VkFence fence)
{
    (void)queue, (void)count, (void)info, (void)fence;
    vulkan_lost_calls++;
    return VK_ERROR_DEVICE_LOST;
}

static VKAPI_ATTR void VKAPI_CALL vulkan_play_destroy(VkDevice device, const VkAllocationCallbacks *a)
{
    (void)device, (void)a;
    vulkan_lost_calls++;
}

static PFN_vkGetInstanceProcAddr vulkan_real_lookup;
static int vulkan_stopped_listening;

static VKAPI_ATTR PFN_vkVoidFunction VKAPI_CALL vulkan_note_lookup(VkInstance instance, const char *name)
{
    vulkan_stopped_listening += strcmp(name, "vkDestroyDebugUtilsMessengerEXT") == 0;
    return vulkan_real_lookup(instance, name);
}

/* What the host has of the model, and so what the next checkpoint would hold, stays as it was. No other call
 * goes to the device. */
static void vulkan_check_given_up(oxl_context *device, struct renderer *r, struct vulkan_run *run,
                                  const char *words)
{
    const oxl_camera camera = vulkan_camera(64, 48);
    const oxl_render_options options = oxl_render_options_default();
    float *before = oxl_alloc(test_ctx, run->trained.model.count, sizeof *before);
    const float *image;
    int listens;
    memcpy(before, run->trained.model.plane[OXL_MEAN], run->trained.model.count * sizeof *before);
    vulkan_lost_calls = 0;
    CHECK(renderer_download(device, r, DOWNLOAD_TO_CHANGE) == OXL_ERR_FAILED);
    CHECK_TEXT(oxl_error_text(device), words);
    CHECK_TEXT(oxl_error_text(device), "fix: run the command again");
    CHECK(memcmp(before, run->trained.model.plane[OXL_MEAN], run->trained.model.count * sizeof *before) == 0);
    device->backend->vulkan->QueueSubmit = vulkan_play_loss;
    device->backend->vulkan->DestroyDevice = vulkan_play_destroy;
    listens = device->backend->vulkan->messenger != VK_NULL_HANDLE;
    vulkan_real_lookup = device->backend->vulkan->GetInstanceProcAddr;
    vulkan_stopped_listening = 0;
    device->backend->vulkan->GetInstanceProcAddr = vulkan_note_lookup;
    CHECK(renderer_forward(device, r, &run->trained.model, &camera, &options) == OXL_ERR_FAILED);
    CHECK(renderer_image(device, r, &image) == OXL_ERR_FAILED);
    renderer_free(device, r);
    CHECK(device->backend->vulkan->validation_messages == 0);
    vulkan_close(device->backend->vulkan);
    device->backend->vulkan = NULL;
    CHECK(vulkan_lost_calls == 1 && vulkan_stopped_listening == listens);
    oxl_free(test_ctx, before);
}

static VKAPI_ATTR VkResult VKAPI_CALL vulkan_play_nothing(VkQueue queue, uint32_t count,
                                                          const VkSubmitInfo *info, VkFence fence)
{
    (void)queue, (void)count, (void)info, (void)fence;
    return VK_SUCCESS;
}

static VKAPI_ATTR VkResult VKAPI_CALL vulkan_play_end(VkDevice device, uint32_t count, const VkFence *fence,
                                                      VkBool32 all, uint64_t timeout)
{
    (void)device, (void)count, (void)fence, (void)all, (void)timeout;
    vulkan_lost_calls++;
    return VK_SUCCESS;
}

enum vulkan_fault { FAULT_TIMEOUT, FAULT_LOST, FAULT_NOTHING_DONE };

static void vulkan_check_loss_of_device(oxl_context *device, enum vulkan_fault fault)
{
    const oxl_camera camera = vulkan_camera(64, 48);
    float *drgb = vulkan_noise((size_t)3 * 64 * 48, 52);
    struct vulkan_run run = vulkan_run_begin(300, 1, 0);
    oxl_render_options options = oxl_render_options_default();
    struct adam_params adam = {.beta = {0.7, 0.9995}, .step = 3};
    struct renderer_nonfinite skipped;
    struct renderer *r;
    CHECK_OK(renderer_create(device, &r));
    vulkan_run_steps(device, r, &camera, &run, drgb, 1, 2, 0);
    CHECK_OK(renderer_forward(device, r, &run.trained.model, &camera, &options));
    CHECK_OK(renderer_backward(device, r, drgb, &run.gradient));
    CHECK_OK(renderer_step(device, r, &run.trained, &run.gradient, &adam, &skipped));
    if (fault == FAULT_TIMEOUT) device->backend->vulkan->WaitForFences = vulkan_play_timeout;
    else device->backend->vulkan->QueueSubmit = fault == FAULT_LOST ? vulkan_play_loss : vulkan_play_nothing;
    if (fault == FAULT_NOTHING_DONE) device->backend->vulkan->WaitForFences = vulkan_play_end;
    vulkan_check_given_up(device, r, &run,
                          fault == FAULT_TIMEOUT ? "did not answer in time" : "the device is lost");
    vulkan_run_free(&run);
    oxl_free(test_ctx, drgb);
}

static void vulkan_check_timeout(oxl_context *device)
{
    vulkan_check_loss_of_device(device, FAULT_TIMEOUT);
}

static void vulkan_check_unfinished(oxl_context *device)
{
    vulkan_check_loss_of_device(device, FAULT_NOTHING_DONE);
}

static PFN_vkQueueSubmit vulkan_real_submit;
static int vulkan_submits_short; /* this many submissions, from now on, find no memory */

static VKAPI_ATTR VkResult VKAPI_CALL vulkan_play_short_submit(VkQueue queue, uint32_t count,
                                                               const VkSubmitInfo *info, VkFence fence)
{
    return vulkan_submits_short-- > 0 ? VK_ERROR_OUT_OF_DEVICE_MEMORY
                                      : vulkan_real_submit(queue, count, info, fence);
}

/* A submission that finds no memory is repeated, and the run is the same; where it finds none without images
 * either, the step is not counted, and the device is given up. */
static void vulkan_check_short_submit(oxl_context *device)
{
    static struct vulkan_deferral d[2];
    struct vulkan_renderer *r;
    struct vulkan *v = device->backend->vulkan;
    struct adam_params adam = {.beta = {0.7, 0.9995}, .step = 7};
    const oxl_render_options options = oxl_render_options_default();
    struct renderer_nonfinite skipped;
    struct renderer_loss none;
    struct renderer_report report;
    size_t steps;
    vulkan_real_submit = v->QueueSubmit;
    for (int k = 0; k < 2; k++) {
        vulkan_deferral_begin(device, &d[k]);
        CHECK(renderer_defer(d[k].r, 1));
        for (int step = 1; step <= 6; step++) {
            v->QueueSubmit = vulkan_play_short_submit;
            vulkan_submits_short = k && step % 2;
            vulkan_step_of(device, &d[k], step, &none);
            CHECK_OK(renderer_report(device, d[k].r, 0, &report));
            CHECK(vulkan_submits_short <= 0);
        }
        CHECK_OK(renderer_report(device, d[k].r, 1, &report));
        CHECK_OK(renderer_download(device, d[k].r, DOWNLOAD_TO_READ));
    }
    vulkan_check_same_run(&d[0], &d[1]);
    renderer_free(device, d[0].r);
    vulkan_run_free(&d[0].run);
    r = d[1].r->device;
    steps = r->steps;
    CHECK_OK(renderer_forward(device, d[1].r, &d[1].run.trained.model, &d[1].camera, &options));
    CHECK_OK(renderer_loss(device, d[1].r, NULL, NULL, 0.2f, &none));
    CHECK_OK(renderer_backward(device, d[1].r, NULL, &d[1].run.gradient));
    vulkan_submits_short = 3;
    CHECK(renderer_step(device, d[1].r, &d[1].run.trained, &d[1].run.gradient, &adam, &skipped) ==
          OXL_ERR_FAILED);
    CHECK(r->steps == steps && v->lost);
    CHECK_TEXT(oxl_error_text(device), "no device memory is left");
    CHECK_TEXT(oxl_error_text(device), "fix: run the command again");
    renderer_free(device, d[1].r);
    vulkan_run_free(&d[1].run);
    vulkan_close(v); /* it would wait, and destroy, were it not given up */
    device->backend->vulkan = NULL;
}

/* A submission finds no memory twice: images that it does not name leave, and it is done. */
static void vulkan_check_submit_drops(oxl_context *device)
{
    static struct vulkan_deferral d;
    const struct training_image image = {64, 48, d.bytes, NULL};
    struct vulkan *v = device->backend->vulkan;
    struct renderer_loss none;
    struct renderer_report report;
    vulkan_deferral_begin(device, &d);
    for (int view = 1; view < 3; view++) CHECK_OK(renderer_set_image(device, d.r, view, &image, NULL, 0));
    vulkan_step_of(device, &d, 1, &none);
    CHECK(renderer_has_image(d.r, 0) && renderer_has_image(d.r, 2) && renderer_defer(d.r, 1));
    vulkan_step_of(device, &d, 2, &none);
    CHECK_OK(renderer_set_image(device, d.r, 1, NULL, NULL, 0)); /* named too, by what is not submitted yet */
    vulkan_real_submit = v->QueueSubmit;
    v->QueueSubmit = vulkan_play_short_submit;
    vulkan_submits_short = 2;
    vulkan_step_of(device, &d, 3, &none);
    CHECK(vulkan_submits_short < 0 && !v->lost);
    CHECK(renderer_has_image(d.r, 0) && renderer_has_image(d.r, 1) && !renderer_has_image(d.r, 2));
    for (int i = 0; i < 2; i++) CHECK_OK(renderer_report(device, d.r, 1, &report));
    CHECK(report.exists && report.halt == HALT_NONE);
    v->QueueSubmit = vulkan_real_submit;
    vulkan_deferral_end(device, &d);
}

static PFN_vkEndCommandBuffer vulkan_real_end;
static int vulkan_ends_short;

static VKAPI_ATTR VkResult VKAPI_CALL vulkan_play_short_end(VkCommandBuffer commands)
{
    const VkResult result = vulkan_real_end(commands);
    return vulkan_ends_short-- > 0 ? VK_ERROR_OUT_OF_HOST_MEMORY : result;
}

static VKAPI_ATTR VkResult VKAPI_CALL vulkan_play_clock(VkDevice device, VkQueryPool pool, uint32_t first,
                                                        uint32_t count, size_t size, void *data,
                                                        VkDeviceSize stride, VkQueryResultFlags flags)
{
    uint64_t *stamp = data;
    (void)device, (void)pool, (void)first, (void)size, (void)stride, (void)flags;
    /* ten ticks, past the end of 36 bits */
    for (uint32_t i = 0; i < count; i++) stamp[i] = i % 2 ? 7 : ((uint64_t)1 << 36) - 3;
    return VK_SUCCESS;
}

/* A clock of 36 bits begins again at 0 within a pass. */
static void vulkan_check_clock(oxl_context *device)
{
    struct vulkan *v = device->backend->vulkan;
    CHECK(vulkan_stamp_mask(64) == UINT64_MAX && vulkan_stamp_mask(36) == ((uint64_t)1 << 36) - 1 &&
          vulkan_stamp_mask(0) == 0);
    vulkan_fill(v, &v->dummy, 0, VK_WHOLE_SIZE, 0); /* its commands do not reset the clock */
    if (vulkan_measure(v) != OXL_OK) return;
    CHECK(!v->recording);
    v->stamp_mask = vulkan_stamp_mask(36);
    v->GetQueryPoolResults = vulkan_play_clock;
    vulkan_check_sort(device, 2048, 255);
    CHECK(v->pass_runs[PASS_SORT_SCATTER] == 4);
    CHECK_CLOSE(v->pass_seconds[PASS_SORT_SCATTER], 4 * 10e-9 * v->properties.limits.timestampPeriod, 1e-12);
}

static PFN_vkBeginCommandBuffer vulkan_real_begin;
static int vulkan_begins_short;

static VKAPI_ATTR VkResult VKAPI_CALL vulkan_play_short_begin(VkCommandBuffer commands,
                                                              const VkCommandBufferBeginInfo *info)
{
    return vulkan_begins_short-- > 0 ? VK_ERROR_OUT_OF_HOST_MEMORY : vulkan_real_begin(commands, info);
}

/* An image whose upload finds no memory is not on the device, and a model whose download finds none not on
 * the host. */
static void vulkan_check_short_begin(oxl_context *device)
{
    static struct vulkan_deferral d[2];
    struct vulkan *v = device->backend->vulkan;
    struct renderer_loss none;
    vulkan_real_begin = v->BeginCommandBuffer;
    for (int k = 0; k < 2; k++) {
        const struct training_image image = {64, 48, d[k].bytes, NULL};
        vulkan_deferral_begin(device, &d[k]);
        vulkan_step_of(device, &d[k], 1, &none);
        CHECK(vulkan_finish(v) == OXL_OK);
        v->BeginCommandBuffer = vulkan_play_short_begin;
        vulkan_begins_short = k;
        CHECK(renderer_set_image(device, d[k].r, 1, &image, NULL, 0) == (k ? OXL_ERR_MEMORY : OXL_OK));
        CHECK(renderer_has_image(d[k].r, 1) == !k && vulkan_finish(v) == (k ? OXL_ERR_MEMORY : OXL_OK) &&
              !v->lost);
        vulkan_enter(v);
        vulkan_begins_short = k;
        CHECK(renderer_download(device, d[k].r, DOWNLOAD_TO_READ) == (k ? OXL_ERR_MEMORY : OXL_OK));
        CHECK(vulkan_begins_short <= 0 && !v->lost);
        CHECK_OK(renderer_download(device, d[k].r, DOWNLOAD_TO_READ));
        v->BeginCommandBuffer = vulkan_real_begin;
    }
    vulkan_check_same_run(&d[0], &d[1]);
    for (int k = 0; k < 2; k++) vulkan_deferral_end(device, &d[k]);
}

/* A command buffer that finds no memory at its end: lack of memory where it only draws, a lost device where
 * it holds a step. */
static void vulkan_check_short_end(oxl_context *device)
{
    const oxl_camera camera = vulkan_camera(64, 48);
    float *drgb = vulkan_noise((size_t)3 * 64 * 48, 52), *rgb = vulkan_noise((size_t)3 * 64 * 48, 53);
    struct vulkan_run run = vulkan_run_begin(300, 1, 0);
    struct vulkan *v = device->backend->vulkan;
    oxl_render_options options = oxl_render_options_default();
    struct adam_params adam = {.beta = {0.7, 0.9995}, .step = 3};
    struct renderer_nonfinite skipped;
    struct renderer *r;
    const float *image;
    vulkan_real_end = v->EndCommandBuffer;
    CHECK_OK(renderer_create(device, &r));
    CHECK_OK(renderer_forward(device, r, &run.trained.model, &camera, &options));
    CHECK_OK(renderer_image(device, r, &image));
    memcpy(rgb, image, 3 * 64 * 48 * sizeof *rgb);
    for (size_t part = 0; part <= 500; part += 500) {
        v->part = 0;
        CHECK_OK(renderer_forward(device, r, &run.trained.model, &camera, &options));
        v->EndCommandBuffer = vulkan_play_short_end;
        vulkan_ends_short = 1;
        v->part = part; /* the image's commands are several submissions then */
        CHECK(renderer_image(device, r, &image) == OXL_ERR_MEMORY && !v->lost);
        CHECK_TEXT(oxl_error_text(device), "recording: no host memory");
        v->EndCommandBuffer = vulkan_real_end;
        CHECK_OK(renderer_forward(device, r, &run.trained.model, &camera, &options));
        CHECK_OK(renderer_image(device, r, &image));
        CHECK(memcmp(rgb, image, 3 * 64 * 48 * sizeof *rgb) == 0);
    }
    CHECK_OK(renderer_backward(device, r, drgb, &run.gradient));
    v->EndCommandBuffer = vulkan_play_short_end;
    vulkan_ends_short = 1;
    CHECK(renderer_step(device, r, &run.trained, &run.gradient, &adam, &skipped) == OXL_ERR_FAILED);
    CHECK(v->lost);
    renderer_free(device, r);
    vulkan_run_free(&run);
    oxl_free(test_ctx, drgb);
    oxl_free(test_ctx, rgb);
    vulkan_close(v);
    device->backend->vulkan = NULL;
}

static PFN_vkQueueSubmit vulkan_fenced_submit;
static int vulkan_unfenced; /* submissions without a fence behind them */

static VKAPI_ATTR VkResult VKAPI_CALL vulkan_note_fence(VkQueue queue, uint32_t count,
                                                        const VkSubmitInfo *info, VkFence fence)
{
    vulkan_unfenced = fence == VK_NULL_HANDLE ? vulkan_unfenced + 1 : 0;
    return vulkan_fenced_submit(queue, count, info, fence);
}

/* A command buffer that is lost, with others of its frame under way: they are waited for, and no smaller
 * buffer makes up for it. */
static void vulkan_check_lost_commands(oxl_context *device)
{
    const oxl_camera camera = vulkan_camera(64, 48);
    const oxl_render_options options = oxl_render_options_default();
    const uint32_t word = 0;
    struct vulkan *v = device->backend->vulkan;
    struct vulkan_buffer b = {0};
    struct vulkan_renderer *d;
    struct renderer *r;
    oxl_model m;
    vulkan_scene(300, 1, 0, &m);
    CHECK_OK(renderer_create(device, &r));
    CHECK_OK(renderer_forward(device, r, &m, &camera, &options));
    CHECK(vulkan_finish(v) == OXL_OK);
    vulkan_real_end = v->EndCommandBuffer, v->EndCommandBuffer = vulkan_play_short_end;
    vulkan_fenced_submit = v->QueueSubmit, v->QueueSubmit = vulkan_note_fence;
    vulkan_unfenced = vulkan_ends_short = 0;
    vulkan_update(v, &v->dummy, 0, &word, sizeof word);
    vulkan_flush(v);
    vulkan_update(v, &v->dummy, 0, &word, sizeof word);
    CHECK(vulkan_unfenced == 1);
    vulkan_ends_short = 1;
    CHECK(vulkan_finish(v) == OXL_ERR_MEMORY && !v->lost && vulkan_unfenced == 0);
    CHECK(vulkan_frame(v)->command_at == 0 && !vulkan_frame(v)->under_way);
    vulkan_enter(v);
    CHECK(v->rc == OXL_OK);
    vulkan_reserve(v, &b, 256, 4, "numbers");
    vulkan_update(v, &v->dummy, 0, &word, sizeof word);
    vulkan_ends_short = 1;
    vulkan_reserve(v, &b, 512, 4, "numbers");
    CHECK(v->rc == OXL_ERR_MEMORY && b.size == 1280);
    vulkan_enter(v);
    d = r->device;
    vulkan_update(v, &v->dummy, 0, &word, sizeof word);
    vulkan_ends_short = 1;
    d->pairs *= 8;
    vulkan_make_pair_room(d, 0);
    CHECK(v->rc == OXL_ERR_MEMORY && !d->low_memory && !d->pair_key[0].handle && !v->lost);
    CHECK_OK(renderer_forward(device, r, &m, &camera, &options));
    vulkan_update(v, &v->dummy, 0, &word, sizeof word);
    vulkan_ends_short = 2; /* nor can the fence be had */
    CHECK(vulkan_finish(v) == OXL_ERR_FAILED && v->lost);
    renderer_free(device, r);
    oxl_model_free(test_ctx, &m);
    vulkan_close(v);
    device->backend->vulkan = NULL;
}

/* What is uploaded when an error comes counts as uploaded: a shape, an image that is kept. */
static void vulkan_check_uploads(oxl_context *device)
{
    struct vulkan *v = device->backend->vulkan;
    static struct vulkan_deferral d[2];
    const oxl_render_options options = oxl_render_options_default();
    const size_t range = v->range;
    struct renderer_loss loss[2];
    for (int k = 0; k < 2; k++) {
        const struct training_image image = {64, 48, d[k].bytes, NULL};
        vulkan_deferral_begin(device, &d[k]);
        vulkan_step_of(device, &d[k], 1, &loss[k]);
        CHECK_OK(renderer_download(device, d[k].r, DOWNLOAD_TO_READ));
        for (int i = 0; i < 300; i++) d[k].run.trained.model.plane[OXL_OPACITY][i] -= 1;
        CHECK_OK(renderer_send_shape(device, d[k].r, &d[k].run.trained.model, 1));
        CHECK_OK(renderer_set_image(device, d[k].r, 1, &image, NULL, 0));
        if (k) {
            const oxl_camera larger = vulkan_camera(640, 480);
            v->range = 64 * 48 * 16;
            CHECK(renderer_forward(device, d[k].r, &d[k].run.trained.model, &larger, &options) ==
                  OXL_ERR_MEMORY);
            CHECK_TEXT(oxl_error_text(device), "in one array");
            v->range = range;
        }
        CHECK(renderer_has_image(d[k].r, 1));
        CHECK_OK(renderer_set_image(device, d[k].r, 1, NULL, NULL, 0));
        CHECK_OK(renderer_forward(device, d[k].r, &d[k].run.trained.model, &d[k].camera, &options));
        CHECK_OK(renderer_loss(device, d[k].r, NULL, NULL, 0.2f, &loss[k]));
        vulkan_step_of(device, &d[k], 2, &loss[k]);
        CHECK_OK(renderer_download(device, d[k].r, DOWNLOAD_TO_READ));
    }
    CHECK(loss[0].total == loss[1].total);
    vulkan_check_same_run(&d[0], &d[1]);
    for (int k = 0; k < 2; k++) vulkan_deferral_end(device, &d[k]);
}

static PFN_vkWaitForFences vulkan_real_wait;
static uint64_t vulkan_waited; /* ns: the last wait, at most */

static VKAPI_ATTR VkResult VKAPI_CALL vulkan_note_wait(VkDevice device, uint32_t count, const VkFence *fence,
                                                       VkBool32 all, uint64_t timeout)
{
    vulkan_waited = timeout;
    return vulkan_real_wait(device, count, fence, all, timeout);
}

/* How long it is waited for this device now. */
static uint64_t vulkan_timeout_with(struct vulkan *v)
{
    vulkan_waited = 0;
    vulkan_fill(v, &v->dummy, 0, VK_WHOLE_SIZE, 0);
    CHECK(vulkan_finish(v) == OXL_OK);
    return vulkan_waited;
}

/* A CPU may take as long as it takes. */
static void vulkan_check_timeout_of_kinds(oxl_context *device)
{
    static const VkPhysicalDeviceType gpu[] = {
        VK_PHYSICAL_DEVICE_TYPE_INTEGRATED_GPU, VK_PHYSICAL_DEVICE_TYPE_DISCRETE_GPU,
        VK_PHYSICAL_DEVICE_TYPE_VIRTUAL_GPU, VK_PHYSICAL_DEVICE_TYPE_OTHER};
    struct vulkan *v = device->backend->vulkan;
    const VkPhysicalDeviceType type = v->properties.deviceType;
    vulkan_real_wait = v->WaitForFences;
    v->WaitForFences = vulkan_note_wait;
    CHECK(vulkan_timeout_with(v) == (type == VK_PHYSICAL_DEVICE_TYPE_CPU ? UINT64_MAX : VULKAN_WAIT));
    for (size_t i = 0; i < OXL_COUNT(gpu); i++) {
        v->properties.deviceType = gpu[i];
        vulkan_set_times(v);
        CHECK(vulkan_timeout_with(v) == 60000000000ull);
        CHECK(v->part == (i == 1 ? 4 : 1) * VULKAN_PART);
    }
    CHECK(4 * VULKAN_PART * 256.0 * 55 < 20e9); /* docs/log/SPEED.md: less than 1 s */
    v->properties.deviceType = VK_PHYSICAL_DEVICE_TYPE_CPU;
    vulkan_set_times(v);
    CHECK(vulkan_timeout_with(v) == UINT64_MAX && v->part == 0);
    v->WaitForFences = vulkan_real_wait;
    v->properties.deviceType = type;
}

/* Another error comes first, while the device is at work. */
static void vulkan_check_hang(oxl_context *device)
{
    struct vulkan_run run = vulkan_run_begin(300, 1, 0);
    const oxl_camera camera = vulkan_camera(64, 48);
    const oxl_render_options options = oxl_render_options_default();
    struct renderer *r;
    CHECK_OK(renderer_create(device, &r));
    CHECK_OK(renderer_forward(device, r, &run.trained.model, &camera, &options));
    device->backend->vulkan->WaitForFences = vulkan_play_timeout;
    device->backend->vulkan->rc = OXL_ERR_MEMORY;
    vulkan_check_given_up(device, r, &run, "did not answer in time");
    vulkan_run_free(&run);
}

static void vulkan_check_lost(oxl_context *device)
{
    vulkan_check_loss_of_device(device, FAULT_LOST);
}

static PFN_vkAllocateDescriptorSets vulkan_real_sets;
static int vulkan_sets_left;

static VKAPI_ATTR VkResult VKAPI_CALL vulkan_play_sets(VkDevice device,
                                                       const VkDescriptorSetAllocateInfo *info,
                                                       VkDescriptorSet *out)
{
    return vulkan_sets_left-- > 0 ? vulkan_real_sets(device, info, out) : VK_ERROR_OUT_OF_HOST_MEMORY;
}

/* A step over three slabs finds no memory for the second one's: no one may repeat it. For the first one's:
 * anyone may. */
static void vulkan_check_half_step(oxl_context *device)
{
    struct vulkan_run run = vulkan_run_begin(700, 1, 0);
    struct vulkan *v = device->backend->vulkan;
    const oxl_camera camera = vulkan_camera(64, 48);
    float *drgb = vulkan_noise((size_t)3 * 64 * 48, 52);
    oxl_render_options options = oxl_render_options_default();
    struct adam_params adam = {.beta = {0.7, 0.9995}, .step = 3};
    struct renderer_nonfinite skipped;
    struct renderer *r;
    v->slab_rows = 256;
    vulkan_real_sets = v->AllocateDescriptorSets;
    CHECK_OK(renderer_create(device, &r));
    for (int sets = 0; sets < 2; sets++) {
        CHECK_OK(renderer_forward(device, r, &run.trained.model, &camera, &options));
        CHECK_OK(renderer_backward(device, r, drgb, &run.gradient));
        CHECK(((struct vulkan_renderer *)r->device)->slabs == 3);
        v->AllocateDescriptorSets = vulkan_play_sets;
        vulkan_sets_left = sets;
        CHECK(renderer_step(device, r, &run.trained, &run.gradient, &adam, &skipped) ==
              (sets ? OXL_ERR_FAILED : OXL_ERR_MEMORY));
        CHECK((v->lost != 0) == sets);
        v->AllocateDescriptorSets = vulkan_real_sets;
    }
    CHECK_TEXT(oxl_error_text(device), "fix: run the command again");
    renderer_free(device, r);
    vulkan_run_free(&run);
    oxl_free(test_ctx, drgb);
    vulkan_close(v);
    device->backend->vulkan = NULL;
}

/* Between counting and emitting every splat grows or shrinks, as if the two were not compiled alike: no pair
 * leaves its splat's slots. */
static void vulkan_check_slots(oxl_context *device)
{
    struct vulkan *v = device->backend->vulkan;
    const oxl_camera camera = vulkan_camera(100, 75);
    const oxl_render_options options = oxl_render_options_default();
    struct vulkan_renderer *d;
    struct renderer *r;
    oxl_model m;
    float(*shape)[4] = oxl_alloc(test_ctx, 600, sizeof *shape);
    uint32_t *order = oxl_alloc(test_ctx, 2 * 600, sizeof *order), *first = order + 600, (*staged)[2],
             used[2];
    size_t wrong = 0, unused = 0;
    vulkan_scene(600, 0, 0, &m);
    CHECK_OK(renderer_create(device, &r));
    CHECK_OK(renderer_forward(device, r, &m, &camera, &options));
    d = r->device;
    vulkan_order_rows(d);
    vulkan_download(v, &d->row_value[0], 0, order, 600 * sizeof *order);
    vulkan_download(v, &d->row_pairs, 0, first, 600 * sizeof *first);
    vulkan_download(v, &d->splat_b, 0, shape, 600 * sizeof *shape);
    for (int i = 0; i < 600; i++)
        shape[i][0] *= i % 2 ? 0.2f : 5, shape[i][2] *= i % 2 ? 2 : 0.5f, shape[i][3] *= i % 2 ? 2 : 0.5f;
    vulkan_upload(v, &d->splat_b, 0, shape, 600 * sizeof *shape);
    vulkan_order_pairs(d);
    vulkan_draw(d, 0);
    staged = oxl_alloc(test_ctx, d->pairs, sizeof *staged);
    vulkan_download(v, &d->staged, 0, staged, d->pairs * sizeof *staged);
    CHECK(v->rc == OXL_OK && d->pairs > 1000);
    for (int i = 0; i < 599; i++) {
        if (first[i] == first[i + 1]) continue; /* and what is not seen has no order */
        vulkan_download(v, &d->row_slots, order[i] * sizeof used, used, sizeof used);
        wrong += used[0] != first[i] || used[1] > first[i + 1] - first[i];
        unused += first[i + 1] - first[i] - used[1];
        for (uint32_t k = first[i]; k < first[i + 1]; k++)
            wrong += staged[k][0] != order[i] || (k >= used[0] + used[1]) != (staged[k][1] == 0);
    }
    CHECK(wrong == 0);
    CHECK(unused > 0);
    oxl_free(test_ctx, staged);
    oxl_free(test_ctx, order);
    oxl_free(test_ctx, shape);
    renderer_free(device, r);
    oxl_model_free(test_ctx, &m);
}

static PFN_vkAllocateMemory vulkan_real_allocate;
static int vulkan_allocations_left;

static VKAPI_ATTR VkResult VKAPI_CALL vulkan_play_allocate(VkDevice device, const VkMemoryAllocateInfo *info,
                                                           const VkAllocationCallbacks *a,
                                                           VkDeviceMemory *out)
{
    VULKAN_LEAVE(out);
    if (vulkan_allocations_left-- <= 0) return VK_ERROR_OUT_OF_DEVICE_MEMORY;
    return vulkan_real_allocate(device, info, a, out);
}

/* After so many allocations a device has no memory left. */
static void vulkan_play_full(struct vulkan *v, int allocations)
{
    if (v->AllocateMemory != vulkan_play_allocate) vulkan_real_allocate = v->AllocateMemory;
    v->AllocateMemory = vulkan_play_allocate;
    vulkan_allocations_left = allocations;
}

static oxl_result vulkan_take_and_draw(struct vulkan_twins *t, int k, const oxl_model *m, int view,
                                       struct renderer_loss *loss)
{
    oxl_render_options options = oxl_render_options_default();
    const size_t bytes = 4 * t->pixels;
    uint8_t *rgb = oxl_alloc(test_ctx, bytes, 1);
    struct training_image image = {t->camera.width, t->camera.height, rgb, rgb + 3 * t->pixels};
    oxl_result rc;
    for (size_t i = 0; i < bytes; i++) rgb[i] = (uint8_t)random_bits(9, i, (uint64_t)view);
    rc = renderer_set_image(t->ctx[k], t->r[k], view, &image, NULL, 0);
    if (rc == OXL_OK) rc = renderer_forward(t->ctx[k], t->r[k], m, &t->camera, &options);
    if (rc == OXL_OK) rc = renderer_loss(t->ctx[k], t->r[k], NULL, NULL, 0.2f, loss);
    oxl_free(test_ctx, rgb);
    return rc;
}

static VkResult vulkan_shortage; /* what an allocation comes back with */
static const struct vulkan *vulkan_of_shortage;
enum { VULKAN_SMALL_IMAGE = 4 * 64 * 48 }; /* bytes */

/* Until images have left, every kind of memory is full: a discrete GPU has several near it. */
static VKAPI_ATTR VkResult VKAPI_CALL vulkan_play_full_of_images(VkDevice device,
                                                                 const VkMemoryAllocateInfo *info,
                                                                 const VkAllocationCallbacks *a,
                                                                 VkDeviceMemory *out)
{
    if (vulkan_of_shortage->image_bytes_max >= VULKAN_SMALL_IMAGE) return vulkan_shortage;
    return vulkan_real_allocate(device, info, a, out);
}

/* At half its sides, then whole: the target grows, where the first allocation fails. */
static void vulkan_check_image_in_use(oxl_context *device, VkResult shortage)
{
    struct vulkan *v = device->backend->vulkan;
    static uint8_t rgb[3 * 64 * 48];
    struct training_image image = {64, 48, rgb, NULL};
    struct renderer *r;
    CHECK_OK(renderer_create(device, &r));
    for (int view = 0; view < 2; view++) CHECK_OK(renderer_set_image(device, r, view, &image, NULL, 1));
    vulkan_real_allocate = v->AllocateMemory;
    v->AllocateMemory = vulkan_play_full_of_images;
    vulkan_of_shortage = v;
    vulkan_shortage = shortage;
    CHECK_OK(renderer_set_image(device, r, 0, NULL, NULL, 0));
    CHECK(renderer_has_image(r, 0) && !renderer_has_image(r, 1));
    CHECK(v->image_bytes_max < VULKAN_SMALL_IMAGE); /* what left does not come back */
    v->AllocateMemory = vulkan_real_allocate;
    v->image_bytes_max = 1 << 20;
    renderer_free(device, r);
}

/* Where memory runs out, images that are kept make room; the one that is worked on stays. */
static void vulkan_check_full(oxl_context *device)
{
    struct vulkan_twins t = vulkan_twins(device, 64, 48);
    struct renderer_loss loss[2];
    oxl_model m, larger;
    int tries = 0;
    vulkan_check_image_in_use(device, VK_ERROR_OUT_OF_DEVICE_MEMORY);
    /* a driver may allow but 4096 allocations */
    vulkan_check_image_in_use(device, VK_ERROR_TOO_MANY_OBJECTS);
    vulkan_scene(300, 1, 0, &m);
    vulkan_scene(3000, 1, 0, &larger);
    for (int view = 0; view < 4; view++) CHECK_OK(vulkan_take_and_draw(&t, 1, &m, view, &loss[1]));
    /* with masks, and not a byte more */
    CHECK(((struct vulkan_renderer *)t.r[1]->device)->image_bytes == 4 * 4 * t.pixels);
    CHECK(renderer_has_image(t.r[1], 0) && renderer_has_image(t.r[1], 3));
    /* the first fails, images leave, and the second is the real one */
    vulkan_play_full(device->backend->vulkan, 0);
    while (vulkan_take_and_draw(&t, 1, &larger, 3, &loss[1]) == OXL_ERR_MEMORY && tries < 60)
        vulkan_play_full(device->backend->vulkan, ++tries);
    CHECK(tries > 0 && tries < 60);
    CHECK(!renderer_has_image(t.r[1], 0));
    CHECK_OK(vulkan_take_and_draw(&t, 0, &larger, 3, &loss[0]));
    CHECK_CLOSE(loss[1].total, loss[0].total, 1e-5);
    oxl_model_free(test_ctx, &m);
    oxl_model_free(test_ctx, &larger);
    vulkan_twins_free(&t);
}

static size_t vulkan_budget, vulkan_usage;
static int vulkan_said_beyond; /* warnings of allocations beyond it */

static void vulkan_hear_beyond(void *user, oxl_log_level level, const char *text)
{
    (void)user;
    vulkan_said_beyond += level == OXL_LOG_WARNING && strstr(text, "beyond the memory that is left") != NULL;
}

static VKAPI_ATTR void VKAPI_CALL vulkan_play_memory(VkPhysicalDevice device,
                                                     VkPhysicalDeviceMemoryProperties2 *out)
{
    VkPhysicalDeviceMemoryBudgetPropertiesEXT *budget = out->pNext;
    (void)device;
    for (uint32_t i = 0; i < VK_MAX_MEMORY_HEAPS; i++)
        budget->heapBudget[i] = (i + 1) * vulkan_budget, budget->heapUsage[i] = (i + 1) * vulkan_usage;
}

static VKAPI_ATTR void VKAPI_CALL vulkan_play_requirements(VkDevice device, VkBuffer buffer,
                                                           VkMemoryRequirements *out)
{
    (void)device, (void)buffer;
    *out = (VkMemoryRequirements){256, 64, 7};
}

static VkMemoryRequirements vulkan_needs;
static uint32_t vulkan_full_kinds, vulkan_kinds_tried; /* by bits */
static int vulkan_kind_last, vulkan_first_tried;

static VKAPI_ATTR void VKAPI_CALL vulkan_play_needs(VkDevice device, VkBuffer buffer,
                                                    VkMemoryRequirements *out)
{
    (void)device, (void)buffer;
    *out = vulkan_needs;
}

static VKAPI_ATTR VkResult VKAPI_CALL vulkan_play_kinds(VkDevice device, const VkMemoryAllocateInfo *info,
                                                        const VkAllocationCallbacks *a, VkDeviceMemory *out)
{
    VkMemoryAllocateInfo given = *info;
    vulkan_kind_last = (int)info->memoryTypeIndex;
    if (!vulkan_kinds_tried) vulkan_first_tried = vulkan_kind_last;
    vulkan_kinds_tried |= 1u << info->memoryTypeIndex;
    VULKAN_LEAVE(out);
    if (vulkan_full_kinds >> info->memoryTypeIndex & 1) return VK_ERROR_OUT_OF_DEVICE_MEMORY;
    given.allocationSize = 1 << 16, given.memoryTypeIndex = 0;
    return vulkan_real_allocate(device, &given, a, out);
}

/* Which kind a buffer of so many bytes gets on a device where some are full; -1: it finds no memory. */
static int vulkan_kind_of(struct vulkan *v, VkDeviceSize size, uint32_t full, int for_host)
{
    struct vulkan_buffer b = {0};
    v->rc = OXL_OK;
    vulkan_needs = (VkMemoryRequirements){size, 64, 31};
    vulkan_full_kinds = full;
    vulkan_kinds_tried = 0;
    vulkan_kind_last = -1;
    vulkan_create(v, &b, 256, for_host);
    CHECK((v->rc == OXL_OK) == (b.handle != VK_NULL_HANDLE) && (v->rc == OXL_OK || v->rc == OXL_ERR_MEMORY));
    if (v->rc != OXL_OK) vulkan_kind_last = -1;
    vulkan_release(v, &b);
    return vulkan_kind_last;
}

static int vulkan_rooms_made;

/* Images leave kind 1. */
static size_t vulkan_play_room(struct vulkan *v, uint32_t but)
{
    (void)v, (void)but;
    vulkan_rooms_made++;
    vulkan_full_kinds &= ~2u;
    return 1;
}

/* The device is lost when it is waited for. */
static size_t vulkan_play_room_lost(struct vulkan *v, uint32_t but)
{
    (void)but;
    vulkan_give_up(v, VK_ERROR_DEVICE_LOST);
    return 0;
}

/* Of kinds 0 and 1, near, and 2 and 3, the host's: images leave when no near kind has room, within its
 * budget. A device that shares the host's memory has all near. */
static void vulkan_check_near_kinds(struct vulkan *v)
{
    static const struct {
        VkPhysicalDeviceType type;
        uint32_t full;
        int kind, rooms;
    } want[] = {{VK_PHYSICAL_DEVICE_TYPE_DISCRETE_GPU, 1, 1, 0},
                {VK_PHYSICAL_DEVICE_TYPE_DISCRETE_GPU, 3, 1, 1},
                {VK_PHYSICAL_DEVICE_TYPE_INTEGRATED_GPU, 3, 2, 0},
                {VK_PHYSICAL_DEVICE_TYPE_INTEGRATED_GPU, 15, 1, 1}};
    struct vulkan_kinds kinds;
    VkDeviceMemory none = VK_NULL_HANDLE;
    v->evict = vulkan_play_room;
    for (size_t i = 0; i < OXL_COUNT(want); i++) {
        vulkan_rooms_made = 0;
        v->properties.deviceType = want[i].type;
        CHECK(vulkan_kind_of(v, 1 << 20, want[i].full, 0) == want[i].kind &&
              vulkan_rooms_made == want[i].rooms);
    }
    v->budgets = 1, vulkan_budget = 1 << 19, vulkan_usage = 0; /* of heap 0; of heap 1 twice as much */
    vulkan_rooms_made = 0;
    CHECK(vulkan_kind_of(v, 1 << 20, 0, 0) == 1 && vulkan_rooms_made == 0);
    v->properties.deviceType = VK_PHYSICAL_DEVICE_TYPE_DISCRETE_GPU;
    v->said_beyond = 1;
    CHECK(vulkan_kind_of(v, (1 << 20) + 1, 0, 0) == 0 && vulkan_rooms_made == 1);
    v->portable = 1; /* nothing beyond the budget */
    CHECK(vulkan_kind_of(v, (1 << 20) + 1, 0, 0) != 0);
    v->portable = 0;
    v->budgets = 0;
    v->evict = vulkan_play_room_lost;
    vulkan_full_kinds = 3;
    vulkan_kinds_tried = 0;
    kinds = vulkan_memory_kinds(v, 31, 0, VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT);
    CHECK(vulkan_allocate(v, 256, &kinds, 0, &none) == VK_ERROR_DEVICE_LOST && v->lost &&
          vulkan_kinds_tried == 3);
}

/* RADV's layout on small APUs: a heap of 16 MiB comes first, and its budget has underflowed. What does not
 * fit is not asked for; what finds no memory is asked of the next kind; the last is AMD's coherent memory,
 * which wants a feature. */
static void vulkan_check_small_heap(struct vulkan *device)
{
    const VkMemoryPropertyFlags host =
        VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT;
    const VkMemoryPropertyFlags own = VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT;
    struct vulkan v = *device;
    const VkDeviceSize gib = 1u << 30, small = 16u << 20, large = 8 * gib - 20 * (gib >> 10);
    v.memory =
        (VkPhysicalDeviceMemoryProperties){.memoryTypeCount = 5,
                                           .memoryTypes = {{own, 0},
                                                           {own, 1},
                                                           {host, 2},
                                                           {host | VK_MEMORY_PROPERTY_HOST_CACHED_BIT, 2},
                                                           {own | host | 0x40, 1}},
                                           .memoryHeapCount = 3,
                                           .memoryHeaps = {{small, 1}, {large, 1}, {4 * gib, 0}}};
    v.budgets = 0;
    v.evict = NULL;
    vulkan_real_allocate = v.AllocateMemory;
    v.AllocateMemory = vulkan_play_kinds;
    v.GetBufferMemoryRequirements = vulkan_play_needs;
    CHECK(vulkan_kind_of(&v, 1 << 20, 0, 0) == 0 && v.kind == 1);
    CHECK(vulkan_kind_of(&v, small + 1, 0, 0) == 1 && !(vulkan_kinds_tried & 1));
    CHECK(vulkan_kind_of(&v, 1 << 20, 1, 0) == 1 && vulkan_first_tried == 0);
    CHECK(vulkan_kind_of(&v, 1 << 20, 3, 0) == 2 && v.kind == 1);
    CHECK(vulkan_kind_of(&v, large, 2, 0) == -1 && vulkan_kinds_tried == 2);
    CHECK(vulkan_kind_of(&v, 1 << 20, 31, 0) == -1 && vulkan_kinds_tried == 15);
    CHECK(vulkan_kind_of(&v, 1 << 20, 0, 1) == 3 && vulkan_kind_of(&v, 1 << 20, 8, 1) == 2);
    CHECK(vulkan_kind_of(&v, large, 0, 1) == -1 && vulkan_kinds_tried == 0);
    v.budgets = 1;
    v.GetPhysicalDeviceMemoryProperties2KHR = vulkan_play_memory;
    vulkan_budget = SIZE_MAX / 2 - 100, vulkan_usage = 64; /* of heap 1: 2^64 - 202 */
    CHECK(vulkan_memory_left(&v, 1) == large - 128);
    vulkan_check_near_kinds(&v);
}

/* As on a GPU with a small heap that the host sees: what counts is the heap of the memory, and for images the
 * largest of the device's own. */
static void vulkan_check_heap(const struct vulkan *v)
{
    const VkMemoryPropertyFlags host =
        VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT;
    const VkMemoryPropertyFlags own = VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT;
    struct vulkan other = *v;
    struct vulkan_buffer b = {0};
    other.memory = (VkPhysicalDeviceMemoryProperties){.memoryTypeCount = 3,
                                                      .memoryTypes = {{host, 2}, {own, 1}, {own | host, 0}},
                                                      .memoryHeapCount = 3,
                                                      .memoryHeaps = {{4000, 1}, {5000, 1}, {9000, 0}}};
    other.budgets = 0;
    CHECK(vulkan_memory_left(&other, 0) == 9000 && vulkan_memory_left(&other, 1) == 5000 &&
          vulkan_memory_left(&other, 2) == 4000);
    other.GetPhysicalDeviceMemoryProperties2KHR = vulkan_play_memory;
    other.budgets = 1;
    vulkan_budget = 100, vulkan_usage = 30; /* of heap 0; twice, three times that of those behind it */
    CHECK(vulkan_memory_left(&other, 0) == 210 && vulkan_memory_left(&other, 1) == 140 &&
          vulkan_memory_left(&other, 2) == 70);
    other.GetBufferMemoryRequirements = vulkan_play_requirements;
    other.evict = NULL;
    vulkan_play_full(&other, 0);
    for (int for_host = 0; for_host < 2; for_host++) {
        other.rc = OXL_OK;
        vulkan_create(&other, &b, 256, for_host);
        CHECK(other.rc == OXL_ERR_MEMORY && other.kind == 1 && !b.handle);
    }
}

/* What other programs use is not there: images are kept in a half of what is left; or up to their share, or
 * number. */
static void vulkan_check_budget(oxl_context *device)
{
    struct vulkan_twins t = vulkan_twins(device, 64, 48);
    struct vulkan *v = device->backend->vulkan;
    const size_t bytes = 4 * t.pixels, most = v->image_bytes_max;
    struct renderer_loss loss;
    oxl_model m, larger;
    vulkan_scene(30, 0, 0, &m);
    vulkan_scene(3000, 1, 0, &larger);
    vulkan_check_heap(v);
    vulkan_check_small_heap(v);
    v->budgets = 1;
    v->GetPhysicalDeviceMemoryProperties2KHR = vulkan_play_memory;
    vulkan_budget = 100, vulkan_usage = 30;
    CHECK(vulkan_memory_left(v, v->kind) == 70);
    vulkan_usage = 101;
    CHECK(vulkan_memory_left(v, v->kind) == 0);
    for (int view = 0; view < 4; view++) {
        vulkan_usage = 0, vulkan_budget = 2 * bytes - (view == 0);
        v->image_bytes_max = view == 1 ? bytes - 1 : most;
        v->properties.limits.maxMemoryAllocationCount = view == 2 ? 0 : 4096;
        CHECK_OK(vulkan_take_and_draw(&t, 1, &m, view, &loss));
        CHECK(renderer_has_image(t.r[1], view) == (view == 3));
    }
    CHECK(renderer_has_image(t.r[1], 3));
    v->image_bytes_max = most;
    vulkan_budget = 64; /* allocations succeed, but would move other memory off the device */
    v->said_beyond = vulkan_said_beyond = 0;
    device->options.log = vulkan_hear_beyond;
    CHECK_OK(vulkan_take_and_draw(&t, 1, &larger, 3, &loss));
    CHECK(!renderer_has_image(t.r[1], 3) && vulkan_said_beyond == 1);
    device->options.log = vulkan_test_log;
    oxl_model_free(test_ctx, &m);
    oxl_model_free(test_ctx, &larger);
    vulkan_twins_free(&t);
}

/* A view is scored on the CPU, whole, where the device has no memory for its scores. */
static void vulkan_check_score_falls_back(oxl_context *device)
{
    struct vulkan_twins t = vulkan_twins(device, 64, 48);
    const oxl_render_options options = oxl_render_options_default();
    float one[300], views[2][300], *drgb = vulkan_noise(3 * t.pixels, 51), score[2][300];
    oxl_model m;
    vulkan_scene(300, 1, 0, &m);
    memset(views, 0, sizeof views), memset(score, 0, sizeof score);
    CHECK_OK(renderer_forward(device, t.r[1], &m, &t.camera, &options));
    vulkan_play_full(device->backend->vulkan, 0);
    for (int k = 0; k < 2; k++) {
        struct prune_pass pass = {one, views[k], drgb, 0};
        CHECK_OK(prune_score_view(t.ctx[k], &(struct prune_of){t.r[k], NULL, &options, &m}, &t.camera, &pass,
                                  score[k]));
    }
    CHECK(t.r[1]->device == NULL && score[0][0] + score[0][7] + score[0][11] > 0);
    CHECK(memcmp(score[0], score[1], sizeof score[0]) == 0 &&
          memcmp(views[0], views[1], sizeof views[0]) == 0);
    device->backend->vulkan->AllocateMemory = vulkan_real_allocate;
    oxl_model_free(test_ctx, &m);
    oxl_free(test_ctx, drgb);
    vulkan_twins_free(&t);
}

static VkDeviceSize vulkan_largest; /* bytes of an allocation; larger ones find no memory */
static int vulkan_refusals;

static VKAPI_ATTR VkResult VKAPI_CALL vulkan_play_largest(VkDevice device, const VkMemoryAllocateInfo *info,
                                                          const VkAllocationCallbacks *a, VkDeviceMemory *out)
{
    if (info->allocationSize <= vulkan_largest) return vulkan_real_allocate(device, info, a, out);
    vulkan_refusals++;
    VULKAN_LEAVE(out);
    return VK_ERROR_OUT_OF_DEVICE_MEMORY;
}

/* Rows that move, or another model, want other memory: whether it is short is found anew. */
static void vulkan_check_tight_ends(oxl_context *device, struct vulkan_deferral *d)
{
    struct vulkan_renderer *r = d->r->device;
    const oxl_render_options options = oxl_render_options_default();
    uint32_t from[300];
    struct renderer_move move = {.from = from, .count = 299, .sh_degree = d->run.trained.model.sh_degree};
    int moved = 0;
    oxl_model m;
    for (uint32_t i = 0; i < 299; i++) from[i] = i;
    CHECK(r->low_memory && r->count == 300);
    vulkan_largest = SIZE_MAX;
    CHECK_OK(renderer_move_rows(device, d->r, &move, &moved));
    CHECK(moved && !r->low_memory);
    r->low_memory = 1;
    vulkan_scene(200, 1, 0, &m);
    CHECK_OK(renderer_forward(device, d->r, &m, &d->camera, &options));
    CHECK(!r->low_memory);
    oxl_model_free(test_ctx, &m);
}

/* There is memory for the pairs that there are, not for the room that deferred steps would like: they get
 * along with it, one after the other, and do what they do. */
static void vulkan_check_tight(oxl_context *device)
{
    static struct vulkan_deferral d[2];
    struct vulkan *v = device->backend->vulkan;
    struct vulkan_renderer *r;
    struct vulkan_buffer b = {0};
    struct renderer_loss none;
    struct renderer_report report;
    vulkan_real_allocate = v->AllocateMemory;
    for (int k = 0; k < 2; k++) {
        vulkan_deferral_begin(device, &d[k]);
        vulkan_step_of(device, &d[k], 1, &none);
        r = d[k].r->device;
        vulkan_largest = k ? 32 * r->pairs + 4096 : SIZE_MAX;
        vulkan_refusals = 0;
        v->AllocateMemory = vulkan_play_largest;
        CHECK(r->pairs > 256 && renderer_defer(d[k].r, 1));
        vulkan_step_of(device, &d[k], 2, &none);
        CHECK((vulkan_refusals > 0) == k && r->low_memory == k && r->room > 0);
        if (k) CHECK(r->room * 32 <= vulkan_largest && r->kept.size <= vulkan_largest);
        vulkan_refusals = 0;
        vulkan_step_of(device, &d[k], 3, &none);
        CHECK(vulkan_refusals == 0);
        CHECK_OK(renderer_report(device, d[k].r, 1, &report));
        CHECK(report.exists && report.halt == HALT_NONE);
        CHECK_OK(renderer_report(device, d[k].r, 1, &report));
        CHECK(report.exists && (k || report.halt == HALT_NONE));
        renderer_defer(d[k].r, 0);
        /* a pair more, and it is repeated */
        if (report.halt == HALT_PAIRS) vulkan_step_of(device, &d[k], 3, &none);
        CHECK_OK(renderer_download(device, d[k].r, DOWNLOAD_TO_READ));
    }
    vulkan_check_same_run(&d[0], &d[1]);
    vulkan_check_tight_ends(device, &d[1]);
    vulkan_largest = 1 << 16;
    vulkan_reserve(v, &b, 1 << 14, 4, "numbers"); /* without the quarter more */
    CHECK(v->rc == OXL_OK && b.size == 1 << 16 && vulkan_refusals > 0);
    vulkan_release(v, &b);
    v->AllocateMemory = vulkan_real_allocate;
    for (int k = 0; k < 2; k++) vulkan_deferral_end(device, &d[k]);
}

/* --backend auto: the CPU continues, with the image that the device had. */
static void vulkan_check_fallback(oxl_context *device)
{
    struct vulkan_twins t = vulkan_twins(device, 64, 48);
    struct renderer_loss loss[2];
    oxl_model m;
    vulkan_scene(300, 1, 0, &m);
    vulkan_play_full(device->backend->vulkan, 3); /* the image fits, the model does not */
    CHECK(vulkan_take_and_draw(&t, 1, &m, 0, &loss[1]) == OXL_ERR_MEMORY);
    CHECK_TEXT(oxl_error_text(device), "no device memory is left");
    CHECK_TEXT(oxl_error_text(device), "fix: ");
    device->options.backend = OXL_BACKEND_AUTO;
    vulkan_play_full(device->backend->vulkan, 1); /* again: the image had left for the model */
    CHECK_OK(vulkan_take_and_draw(&t, 1, &m, 0, &loss[1]));
    CHECK(t.r[1]->device == NULL);
    CHECK_OK(vulkan_take_and_draw(&t, 0, &m, 0, &loss[0]));
    CHECK_CLOSE(loss[0].total, loss[1].total, 1e-6); /* its bytes made floats on the device */
    oxl_model_free(test_ctx, &m);
    vulkan_twins_free(&t);
    vulkan_play_full(device->backend->vulkan, 0);
    t = vulkan_twins(device, 64, 48);
    CHECK(t.r[1]->device == NULL);
    vulkan_twins_free(&t);
    device->backend->vulkan->AllocateMemory = vulkan_real_allocate;
    vulkan_check_score_falls_back(device);
}

static int vulkan_submits_left; /* submissions until the device is lost, or has no memory for any more */

static VKAPI_ATTR VkResult VKAPI_CALL vulkan_play_late_loss(VkQueue queue, uint32_t count,
                                                            const VkSubmitInfo *info, VkFence fence)
{
    return vulkan_submits_left-- > 0 ? vulkan_real_submit(queue, count, info, fence) : VK_ERROR_DEVICE_LOST;
}

static VKAPI_ATTR VkResult VKAPI_CALL vulkan_play_late_shortage(VkQueue queue, uint32_t count,
                                                                const VkSubmitInfo *info, VkFence fence)
{
    return vulkan_submits_left-- > 0 ? vulkan_real_submit(queue, count, info, fence)
                                     : VK_ERROR_OUT_OF_DEVICE_MEMORY;
}

/* What the public functions give of a model in one view: the image and its depths, or the gradient. */
struct vulkan_output {
    oxl_image image;
    oxl_model gradient;
    float depth[64 * 48];
};

static oxl_result vulkan_output_of(oxl_context *ctx, const oxl_model *m, int gradient,
                                   struct vulkan_output *out)
{
    const oxl_camera camera = vulkan_camera(64, 48);
    float *drgb = vulkan_noise((size_t)3 * 64 * 48, 50);
    oxl_result rc;
    memset(out, 0, sizeof *out);
    if (gradient) rc = oxl_render_backward(ctx, m, &camera, NULL, drgb, &out->gradient);
    else rc = oxl_render(ctx, m, &camera, NULL, &out->image, out->depth);
    oxl_free(test_ctx, drgb);
    return rc;
}

static void vulkan_output_free(oxl_context *ctx, struct vulkan_output *o)
{
    oxl_image_free(ctx, &o->image);
    oxl_model_free(ctx, &o->gradient);
}

/* Whether it is, to the byte, what the CPU gave, and the next function finds the same. */
static int vulkan_gives(oxl_context *device, const oxl_model *m, int gradient,
                        const struct vulkan_output *cpu)
{
    static struct vulkan_output got;
    int same;
    CHECK_OK(vulkan_output_of(device, m, gradient, &got));
    same = memcmp(got.depth, cpu->depth, sizeof got.depth) == 0;
    if (got.image.rgb) same = same && memcmp(got.image.rgb, cpu->image.rgb, sizeof(float) * 3 * 64 * 48) == 0;
    for (int k = 0; k < oxl_model_planes(m) && got.gradient.count == m->count; k++)
        same = same && memcmp(got.gradient.plane[k], cpu->gradient.plane[k], m->count * sizeof(float)) == 0;
    same = same && (gradient ? got.gradient.count == m->count : got.image.rgb != NULL);
    vulkan_output_free(device, &got);
    return same;
}

static int vulkan_fell_back; /* warnings of renderers that left their device */

static void vulkan_hear_cpu(void *user, oxl_log_level level, const char *text)
{
    (void)user;
    vulkan_fell_back += level == OXL_LOG_WARNING && strstr(text, ": continuing on the CPU") != NULL;
}

/* --backend auto: the device is lost in the last submission of a gradient; the CPU computes it, and renders
 * from then on, which is said once. With --backend vulkan that is an error, whatever has been said since. */
static void vulkan_check_draws_without_device(oxl_context *device, const oxl_model *m,
                                              const struct vulkan_output cpu[2])
{
    static struct vulkan_output none;
    struct vulkan *v = device->backend->vulkan;
    const size_t before = v->submissions;
    CHECK(!vulkan_gives(device, m, 1, &cpu[1]));
    vulkan_submits_left = (int)(v->submissions - before) - 1;
    vulkan_real_submit = v->QueueSubmit;
    v->QueueSubmit = vulkan_play_late_loss;
    vulkan_fell_back = device->backend->fell_back = 0;
    CHECK(vulkan_submits_left > 3 && vulkan_gives(device, m, 1, &cpu[1]));
    CHECK(v->lost == VK_ERROR_DEVICE_LOST && vulkan_fell_back == 1);
    CHECK(vulkan_gives(device, m, 0, &cpu[0]) && vulkan_gives(device, m, 1, &cpu[1]) &&
          vulkan_fell_back == 1);
    device->options.backend = OXL_BACKEND_VULKAN;
    for (int gradient = 0; gradient < 2; gradient++) {
        oxl_fail(device, OXL_ERR_INPUT, "another error");
        CHECK(vulkan_output_of(device, m, gradient, &none) == OXL_ERR_FAILED);
        CHECK_TEXT(oxl_error_text(device), "the device is lost");
    }
    CHECK(v->validation_messages == 0);
    vulkan_close(v);
    device->backend->vulkan = NULL;
}

/* --backend auto: wherever an image or a gradient finds no memory, the CPU does all of it. */
static void vulkan_check_draws_fall_back(oxl_context *device)
{
    static struct vulkan_output cpu[2], none;
    struct vulkan *v = device->backend->vulkan;
    oxl_model m;
    vulkan_scene(300, 1, 0, &m);
    device->options.log = vulkan_hear_cpu;
    for (int gradient = 0; gradient < 2; gradient++) {
        int all;
        CHECK_OK(vulkan_output_of(test_ctx, &m, gradient, &cpu[gradient]));
        vulkan_play_full(v, 1000);
        device->options.backend = OXL_BACKEND_VULKAN;
        device->backend->rendered_on = 0;
        CHECK(!vulkan_gives(device, &m, gradient, &cpu[gradient]));
        CHECK(strcmp(oxl_backend_name(device), v->properties.deviceName) == 0);
        all = 1000 - vulkan_allocations_left;
        vulkan_play_full(v, all - 1);
        CHECK(vulkan_output_of(device, &m, gradient, &none) == OXL_ERR_MEMORY);
        CHECK(!none.image.rgb && none.gradient.count == 0);
        device->options.backend = OXL_BACKEND_AUTO;
        device->backend->rendered_on = 0;
        vulkan_fell_back = device->backend->fell_back = 0;
        for (int k = 0; k < all; k++) {
            vulkan_play_full(v, k);
            CHECK(vulkan_gives(device, &m, gradient, &cpu[gradient]) && vulkan_fell_back == 1);
            if (k == 0) CHECK(strcmp(oxl_backend_name(device), "cpu") == 0);
        }
        v->AllocateMemory = vulkan_real_allocate;
    }
    vulkan_check_draws_without_device(device, &m, cpu);
    for (int k = 0; k < 2; k++) vulkan_output_free(test_ctx, &cpu[k]);
    oxl_model_free(test_ctx, &m);
}

/* Steps, density control and an opacity reset, steps; the rows downloaded and uploaded (0), moved on the
 * device (1), or to be moved where there is no room (2). */
static void vulkan_densify(oxl_context *device, struct vulkan_deferral *d, size_t lobes, int moves)
{
    const struct density_rules rules = {.gradient = lobes ? 1e30 : 1e-4, .extent = 1, .f_mid = 1, .f_far = 1};
    struct density_change change;
    struct density *density;
    struct renderer_loss loss;
    uint32_t from[1200];
    struct renderer_move move = {.from = from};
    struct vulkan *v = device->backend->vulkan;
    size_t sent, read;
    int moved = 0;
    vulkan_deferral_begin(device, d);
    if (!lobes)
        model_drop_lobes(&d->run.trained.model), model_drop_lobes(&d->run.trained.mean),
            model_drop_lobes(&d->run.trained.square);
    for (size_t i = 0; i < 300; i += 7) d->run.trained.model.plane[OXL_OPACITY][i] = -9; /* to be removed */
    CHECK_OK(density_create(test_ctx, &density));
    CHECK_OK(density_clear(test_ctx, density, 300));
    for (int step = 1; step <= 2; step++) vulkan_step_of(device, d, step, &loss);
    for (int i = 0; i < 300; i++) density->gradient[i] = (float)(i % 3), density->views[i] = 1;
    read = v->read_bytes, sent = v->sent;
    CHECK_OK(renderer_download(device, d->r, moves ? DOWNLOAD_SHAPE : DOWNLOAD_TO_CHANGE));
    if (moves) CHECK(v->read_bytes - read == 300 * (OXL_SH * 4 + 16));
    CHECK_OK(density_decide(test_ctx, density, &d->run.trained.model, &rules, &change));
    move.lobes = density_sources(density, &d->run.trained.model, from);
    move.sh_degree = 1;
    move.count = 300 - change.removed + change.split;
    CHECK(change.removed > 40 && (change.split > 100) == !lobes && move.lobes == (lobes ? 85 : 0));
    if (moves == 2) vulkan_play_full(device->backend->vulkan, 3);
    if (moves) CHECK_OK(renderer_move_rows(device, d->r, &move, &moved));
    if (moves == 2) device->backend->vulkan->AllocateMemory = vulkan_real_allocate;
    CHECK(moved == (moves == 1));
    CHECK_OK(density_apply(test_ctx, density, &d->run.trained, &change, moved));
    if (moved) CHECK_OK(renderer_send_shape(device, d->r, &d->run.trained.model, 0));
    if (moved) CHECK(v->sent - sent == move.count * (4 + OXL_SH * 4));
    if (moved) CHECK_OK(renderer_download(device, d->r, DOWNLOAD_SHAPE));
    density_reset_opacity(&d->run.trained, 0);
    if (moved) CHECK_OK(renderer_send_shape(device, d->r, &d->run.trained.model, 1));
    d->run.sums.count = 0; /* nothing more is observed */
    for (int step = 3; step <= 4; step++) vulkan_step_of(device, d, step, &loss);
    CHECK_OK(renderer_download(device, d->r, DOWNLOAD_TO_READ));
    density_free(test_ctx, density);
}

static void vulkan_check_moves(oxl_context *device)
{
    static struct vulkan_deferral d[3];
    device->backend->vulkan->slab_rows = 256; /* several slabs */
    for (size_t lobes = 0; lobes <= 100; lobes += 100) {
        for (int moves = 0; moves < 3; moves++) vulkan_densify(device, &d[moves], lobes, moves);
        for (int k = 1; k < 3; k++) {
            vulkan_check_same_model(&d[0].run.trained.model, &d[k].run.trained.model);
            vulkan_check_same_model(&d[0].run.trained.mean, &d[k].run.trained.mean);
            vulkan_check_same_model(&d[0].run.trained.square, &d[k].run.trained.square);
        }
        for (int k = 0; k < 3; k++) vulkan_deferral_end(device, &d[k]);
    }
}

static VKAPI_ATTR void VKAPI_CALL vulkan_play_barrier(VkCommandBuffer commands, VkPipelineStageFlags from,
                                                      VkPipelineStageFlags to, VkDependencyFlags flags,
                                                      uint32_t memories, const VkMemoryBarrier *memory,
                                                      uint32_t buffers, const VkBufferMemoryBarrier *buffer,
                                                      uint32_t images, const VkImageMemoryBarrier *image)
{
    (void)commands, (void)from, (void)to, (void)flags, (void)memories, (void)memory, (void)buffers,
        (void)buffer, (void)images;
    (void)image;
}

static int vulkan_complains(struct vulkan *v)
{
    const int messages = v->validation_messages;
    v->validation_messages = 0;
    return messages > 0;
}

/* That validation is silent in the other tests says something when it is not here: barriers left out, and a
 * write past the end of a buffer, which only GPU-assisted validation sees (OXL_VULKAN_VALIDATE=gpu; the
 * device keeps it from harm, or not: on lavapipe it does). */
static void vulkan_check_validation(oxl_context *device)
{
    struct vulkan *v = device->backend->vulkan;
    const PFN_vkCmdPipelineBarrier barrier = v->CmdPipelineBarrier;
    const int gpu = strcmp(getenv("OXL_VULKAN_VALIDATE"), "gpu") == 0;
    struct vulkan_buffer small = {0}, number = {0};
    if (!v->validates) SKIP("no validation layer here");
    vulkan_reserve(v, &small, 1, 4, "numbers");
    vulkan_reserve(v, &number, 1 << 16, 4, "numbers");
    if (!gpu) v->CmdPipelineBarrier = vulkan_play_barrier;
    VULKAN_RUN(v, UNPACK, 0, 16, VULKAN_PUSH(64, 64, 0, 0, 0, 0, 0, 64, 64),
               VULKAN_BUFFERS(NULL, gpu ? &small : &number, NULL));
    VULKAN_RUN(v, SCORE, 0, 1, VULKAN_PUSH(1), VULKAN_BUFFERS(NULL, NULL, NULL, &number));
    CHECK(vulkan_finish(v) == OXL_OK);
    CHECK(vulkan_complains(v));
    v->CmdPipelineBarrier = barrier;
    vulkan_release(v, &small);
    vulkan_release(v, &number);
}

/* More parts than a frame has command buffers. A frame is waited for as long as its submissions together may
 * take. */
static void vulkan_check_many_parts(oxl_context *device, const oxl_model *m)
{
    const oxl_camera camera = vulkan_camera(200, 150);
    oxl_render_options options = oxl_render_options_default();
    float *rgb = oxl_alloc(test_ctx, 3 * 200 * 150, sizeof *rgb);
    struct vulkan *v = device->backend->vulkan;
    struct renderer *r;
    const float *image;
    vulkan_real_wait = v->WaitForFences;
    CHECK_OK(renderer_create(device, &r));
    for (int k = 0; k < 2; k++) {
        const uint64_t timeout_ns = v->timeout_ns;
        size_t before = v->submissions, parts;
        CHECK_OK(renderer_forward(device, r, m, &camera, &options));
        parts = ((struct vulkan_renderer *)r->device)->pairs / 10;
        v->timeout_ns = k ? 1000000000 : timeout_ns;
        v->WaitForFences = vulkan_note_wait;
        vulkan_waited = 0;
        if (k) CHECK(parts > VULKAN_COMMANDS && v->submissions - before > parts);
        CHECK_OK(renderer_image(device, r, &image));
        if (k) CHECK(vulkan_waited > v->timeout_ns && vulkan_waited <= VULKAN_COMMANDS * v->timeout_ns);
        v->WaitForFences = vulkan_real_wait;
        v->timeout_ns = timeout_ns;
        if (k == 0) memcpy(rgb, image, 3 * 200 * 150 * sizeof *rgb);
        v->part = 10;
    }
    CHECK(memcmp(rgb, image, 3 * 200 * 150 * sizeof *rgb) == 0);
    renderer_free(device, r);
    oxl_free(test_ctx, rgb);
}

/* Drawn whole and in parts, each a submission. */
static void vulkan_check_parts(oxl_context *device)
{
    const oxl_camera camera = vulkan_camera(200, 150);
    const size_t pixels = 200 * 150;
    float *rgb = oxl_alloc(test_ctx, 6 * pixels, sizeof *rgb), *drgb = vulkan_noise(3 * pixels, 57);
    oxl_render_options options = oxl_render_options_default();
    oxl_model m, gradient[2];
    vulkan_scene(900, 1, 200, &m);
    vulkan_check_many_parts(device, &m);
    for (int k = 0; k < 2; k++) {
        struct renderer *r;
        const float *image;
        size_t before = device->backend->vulkan->submissions;
        device->backend->vulkan->part = k ? 500 : 0;
        CHECK_OK(oxl_model_create(test_ctx, m.count, 1, &gradient[k]));
        memset(gradient[k].plane[OXL_ROTATION], 0, gradient[k].capacity * sizeof(float));
        CHECK_OK(renderer_create(device, &r));
        CHECK_OK(renderer_forward(device, r, &m, &camera, &options));
        CHECK((device->backend->vulkan->submissions - before > 5) == k); /* two rows of tiles each */
        CHECK_OK(renderer_image(device, r, &image));
        memcpy(rgb + 3 * pixels * (size_t)k, image, 3 * pixels * sizeof *rgb);
        before = device->backend->vulkan->submissions;
        CHECK_OK(renderer_backward(device, r, drgb, &gradient[k]));
        CHECK((device->backend->vulkan->submissions - before > 5) == k);
        CHECK_OK(renderer_gradient(device, r, &gradient[k]));
        renderer_free(device, r);
    }
    CHECK(memcmp(rgb, rgb + 3 * pixels, 3 * pixels * sizeof *rgb) == 0);
    for (int k = 0; k < oxl_model_planes(&m); k++)
        CHECK(memcmp(gradient[0].plane[k], gradient[1].plane[k], m.count * sizeof(float)) == 0);
    for (int k = 0; k < 2; k++) oxl_model_free(test_ctx, &gradient[k]);
    oxl_model_free(test_ctx, &m);
    oxl_free(test_ctx, rgb);
    oxl_free(test_ctx, drgb);
}

static PFN_vkCmdPushConstants vulkan_real_push;
static uint32_t vulkan_drawn[64][2];
static int vulkan_drawn_parts;

static VKAPI_ATTR void VKAPI_CALL vulkan_note_part(VkCommandBuffer commands, VkPipelineLayout layout,
                                                   VkShaderStageFlags stages, uint32_t offset, uint32_t size,
                                                   const void *push)
{
    if (vulkan_drawn_parts < (int)OXL_COUNT(vulkan_drawn))
        memcpy(vulkan_drawn[vulkan_drawn_parts++], (const char *)push + 4, 8);
    vulkan_real_push(commands, layout, stages, offset, size, push);
}

/* Of a part, the pairs of its workgroups get sums, and no others; returns how many. */
static size_t vulkan_check_backward_part(struct vulkan_renderer *d, const uint32_t *start, size_t tiles,
                                         size_t begin, size_t end)
{
    struct vulkan *v = d->v;
    uint32_t *slot = oxl_alloc(test_ctx, d->pairs, sizeof *slot);
    float(*sums)[4] = oxl_alloc(test_ctx, d->pairs, sizeof *sums);
    size_t wrong = 0, given = 0;
    vulkan_reserve(v, &d->drgb, (size_t)d->view.width * d->view.height, 12, "pixels");
    vulkan_fill(v, &d->drgb, 0, VK_WHOLE_SIZE, 0x3F800000);
    vulkan_fill(v, &d->sums_a, 0, VK_WHOLE_SIZE, 0x7F800000);
    vulkan_backward_part(d, 0, begin, end);
    vulkan_download(v, &d->sums_a, 0, sums, d->pairs * sizeof *sums);
    vulkan_download(v, &d->pair_value[d->sort_end], 0, slot, d->pairs * sizeof *slot);
    CHECK(v->rc == OXL_OK);
    for (size_t tile = 0; tile < tiles && v->rc == OXL_OK; tile++)
        for (uint32_t pair = start[tile]; pair < start[tile + 1]; pair++) {
            const int has = sums[slot[pair]][0] < INFINITY;
            const size_t group = start[tile] / 256 + tile + (pair - start[tile]) / 256;
            wrong += has != (group >= begin && group < end), given += (size_t)has;
        }
    CHECK(wrong == 0 && given < d->pairs);
    oxl_free(test_ctx, slot);
    oxl_free(test_ctx, sums);
    return given;
}

/* Nine in ten pairs are in three of many tiles: no submission draws more than a part of the pairs and one
 * tile. */
static void vulkan_check_unbalanced(oxl_context *device)
{
    const oxl_camera camera = vulkan_camera(320, 240);
    const oxl_render_options options = oxl_render_options_default();
    struct vulkan *v = device->backend->vulkan;
    struct vulkan_renderer *d;
    struct renderer *r;
    oxl_model m;
    uint32_t start[20 * 15 + 1], most_of_tile = 0, most = 0, all = 0, wrong = 0, drawn = 0;
    size_t backward = 0;
    const float *image;
    vulkan_scene(4000, 0, 0, &m);
    for (size_t i = 0; i < 3600; i++) {
        const double at[3] = {-1.2 + 1e-3 * vulkan_random(i, 0), 0.5 + 1e-3 * vulkan_random(i, 1),
                              4 + 0.1 * vulkan_random(i, 2)};
        for (int k = 0; k < 3; k++)
            m.plane[OXL_MEAN + k][i] = (float)at[k], m.plane[OXL_LOG_SCALE + k][i] = -4;
    }
    CHECK_OK(renderer_create(device, &r));
    CHECK_OK(renderer_forward(device, r, &m, &camera, &options));
    d = r->device;
    vulkan_download(v, &d->start, 0, start, sizeof start);
    v->part = 700;
    vulkan_real_push = v->CmdPushConstants;
    v->CmdPushConstants = vulkan_note_part;
    vulkan_drawn_parts = 0;
    vulkan_draw(d, 0);
    CHECK(vulkan_finish(v) == OXL_OK && vulkan_drawn_parts > 6);
    for (int tile = 0; tile < 300; tile++)
        most_of_tile = OXL_MAX(most_of_tile, start[tile + 1] - start[tile]);
    for (int k = 0; k < vulkan_drawn_parts; k++) {
        uint32_t pairs = 0;
        for (int tile = 0; tile < 300; tile++)
            if (start[tile] >= vulkan_drawn[k][0] && start[tile] < vulkan_drawn[k][1])
                pairs += start[tile + 1] - start[tile];
        most = OXL_MAX(most, pairs), all += pairs;
    }
    CHECK(most_of_tile > 1000 && most <= 700 + most_of_tile);
    CHECK(all == start[300] && all == d->pairs);
    v->CmdPushConstants = vulkan_real_push;
    vulkan_reserve_backward(d, 0);
    for (int k = 0; k < vulkan_drawn_parts; k++) {
        vulkan_fill(v, &d->rgb, 0, VK_WHOLE_SIZE, 0x7F800000);
        vulkan_draw_part(d, 1, vulkan_drawn[k][0], vulkan_drawn[k][1]);
        CHECK_OK(renderer_image(device, r, &image));
        for (int i = 0; i < 320 * 240; i++) {
            const uint32_t at = start[i / 320 / 16 * 20 + i % 320 / 16];
            wrong += (image[i] < INFINITY) != (at >= vulkan_drawn[k][0] && at < vulkan_drawn[k][1]);
            drawn += image[i] < INFINITY;
        }
    }
    vulkan_draw(d, 1);
    for (size_t k = 0; k < 400; k += 40) backward += vulkan_check_backward_part(d, start, 300, k, k + 40);
    CHECK(wrong == 0 && drawn == 320 * 240 && backward == d->pairs);
    renderer_free(device, r);
    oxl_model_free(test_ctx, &m);
}

/* ---------------- a survey */

/* darker: the log of how much darker every other image is. */
static oxl_scene *vulkan_survey(oxl_context *ctx, double darker)
{
    oxl_model truth;
    oxl_view view[6];
    oxl_image image[6];
    oxl_point point[200];
    oxl_scene *scene = NULL;
    vulkan_scene(200, 0, 0, &truth);
    for (int i = 0; i < 6; i++) {
        static const char *const names[] = {"a", "b", "c", "d", "e", "f"};
        view[i] = (oxl_view){.name = names[i], .camera = vulkan_camera(48, 36), .is_test = i == 2};
        view[i].camera.translation[0] += 0.3 * (i - 3);
        view[i].camera.translation[1] += 0.1 * (i % 3);
        CHECK_OK(oxl_render(test_ctx, &truth, &view[i].camera, NULL, &image[i], NULL));
        for (int k = 0; i % 2 && k < 3 * 48 * 36; k++) image[i].rgb[k] *= (float)exp(-darker);
    }
    for (int i = 0; i < 200; i++) {
        point[i] = (oxl_point){.rgb = {128, 128, 128}};
        for (int a = 0; a < 3; a++) point[i].position[a] = truth.plane[OXL_MEAN + a][i];
    }
    CHECK_OK(oxl_scene_from_arrays(ctx, view, image, 6, point, 200, &scene));
    for (int i = 0; i < 6; i++) oxl_image_free(test_ctx, &image[i]);
    oxl_model_free(test_ctx, &truth);
    return scene;
}

/* ---------------- which model */

static size_t vulkan_bytes_of(const oxl_model *m)
{
    return sizeof(float) * (m->count * (size_t)oxl_model_planes(m) + m->lobes * MODEL_LOBE_PLANES);
}

/* In evaluations and images only the model is uploaded, so the bytes are counted. */
static void vulkan_check_one_upload(oxl_context *device)
{
    oxl_scene *scene = vulkan_survey(device, 0);
    const oxl_render_output what = {.split = OXL_SPLIT_ALL, .depth = 1};
    struct vulkan *v = device->backend->vulkan;
    oxl_metrics metrics;
    oxl_model m;
    size_t before = v->sent;
    int count;
    vulkan_scene(600, 1, 100, &m);
    v->slab_rows = 256; /* several slabs */
    CHECK_OK(oxl_evaluate(device, &m, scene, NULL, OXL_SPLIT_ALL, &metrics));
    CHECK(metrics.count == 6 && v->sent - before == vulkan_bytes_of(&m));
    before = v->sent;
    CHECK_OK(oxl_render_views(device, &m, scene, NULL, &what, test_path("drawn"), &count));
    CHECK(count == 6 && v->sent - before == vulkan_bytes_of(&m));
    oxl_metrics_free(device, &metrics);
    oxl_model_free(test_ctx, &m);
    oxl_scene_free(device, scene);
}

static void vulkan_repaint(oxl_model *m)
{
    for (size_t i = 0; i < m->count; i++) m->plane[OXL_SH][i] += (float)(1 + vulkan_random(i, 90));
}

/* Behind the interface: a model that was changed after renderer_download, and another in the shape of the
 * first. */
static void vulkan_check_models_of_a_renderer(oxl_context *device)
{
    struct vulkan_twins t = vulkan_twins(device, 64, 48);
    oxl_model m, other;
    vulkan_scene(300, 1, 100, &m);
    vulkan_scene(300, 1, 100, &other);
    vulkan_repaint(&other);
    vulkan_forward_both(&t, &m);
    vulkan_compare_images(&t);
    for (int k = 0; k < 2; k++) CHECK_OK(renderer_download(t.ctx[k], t.r[k], DOWNLOAD_TO_CHANGE));
    vulkan_repaint(&m);
    vulkan_repaint(&m);
    vulkan_forward_both(&t, &m);
    vulkan_compare_images(&t);
    vulkan_forward_both(&t, &other);
    vulkan_compare_images(&t);
    oxl_model_free(test_ctx, &m);
    oxl_model_free(test_ctx, &other);
    vulkan_twins_free(&t);
}

/* Outside of training a model belongs to the caller and may change at any time. */
static void vulkan_check_model_now(oxl_context *device)
{
    oxl_context *ctx[2] = {test_ctx, device};
    oxl_scene *scene = vulkan_survey(device, 0);
    double psnr[2][2] = {{0}};
    float rgb[2][2][4] = {{{0}}};
    oxl_model m;
    vulkan_scene(300, 1, 0, &m);
    for (int round = 0; round < 2; round++, vulkan_repaint(&m))
        for (int k = 0; k < 2; k++) {
            oxl_metrics metrics;
            oxl_image image;
            CHECK_OK(oxl_evaluate(ctx[k], &m, scene, NULL, OXL_SPLIT_ALL, &metrics));
            CHECK_OK(oxl_render(ctx[k], &m, &oxl_scene_view(scene, 0)->camera, NULL, &image, NULL));
            psnr[round][k] = metrics.psnr;
            memcpy(rgb[round][k], image.rgb + 18 * 48 + 24, sizeof rgb[round][k]);
            oxl_metrics_free(ctx[k], &metrics);
            oxl_image_free(ctx[k], &image);
        }
    for (int round = 0; round < 2; round++) {
        CHECK_CLOSE(psnr[round][1], psnr[round][0], 0.01);
        for (int i = 0; i < 4; i++) CHECK_CLOSE(rgb[round][1][i], rgb[round][0][i], 2.0 / 255);
    }
    CHECK(fabs(psnr[1][0] - psnr[0][0]) > 1 && fabsf(rgb[1][0][0] - rgb[0][0][0]) > 0.1f);
    oxl_model_free(test_ctx, &m);
    oxl_scene_free(device, scene);
    vulkan_check_models_of_a_renderer(device);
}

/* ---------------- a run */

/* Everything that a run does between steps: densification, higher SH degrees, pruning, second lobes. */
static void vulkan_train(oxl_context *ctx, int iterations, oxl_model *out, double *psnr)
{
    oxl_scene *scene = vulkan_survey(ctx, 0);
    oxl_train_options options = oxl_train_options_default(OXL_PRESET_DRAFT);
    struct oxl_imaging imaging = {0};
    struct train_task task = {.imaging = &imaging};
    oxl_metrics metrics;
    options.iterations = iterations;
    options.short_run_exponent = 0; /* larger steps amplify rounding, in which device and CPU differ */
    options.densify_every = 10;
    options.sh_degree = 1;
    options.dog = OXL_DOG_ALL;
    options.max_gaussians = 400;
    options.keep = (oxl_keep){OXL_KEEP_FRACTION, 0.8};
    if (train_run(ctx, scene, &options, NULL, &task, out) != OXL_OK)
        test_fail(__FILE__, __LINE__, "%s", oxl_error_text(ctx));
    CHECK_OK(oxl_evaluate(ctx, out, scene, &imaging, OXL_SPLIT_ALL, &metrics));
    *psnr = metrics.psnr;
    imaging_free(ctx, &imaging);
    oxl_metrics_free(ctx, &metrics);
    oxl_scene_free(ctx, scene);
}

static void vulkan_check_training(oxl_context *device)
{
    oxl_model model[3];
    double psnr[3];
    vulkan_train(test_ctx, 60, &model[0], &psnr[0]);
    for (int k = 1; k < 3; k++) vulkan_train(device, 60, &model[k], &psnr[k]);
    CHECK_CLOSE(psnr[1], psnr[0], 0.1);
    CHECK(model[0].lobes > 0 && model[1].lobes > 0);
    CHECK(model[1].count == model[2].count && model[1].lobes == model[2].lobes);
    if (model[1].count == model[2].count)
        for (int k = 0; k < oxl_model_planes(&model[1]); k++)
            CHECK(memcmp(model[1].plane[k], model[2].plane[k], model[1].count * sizeof(float)) == 0);
    for (int k = 0; k < 3; k++) oxl_model_free(test_ctx, &model[k]);
}

static void vulkan_check_forecast(oxl_context *device)
{
    const oxl_job_options o = oxl_job_options_default(OXL_PRESET_DRAFT);
    oxl_scene *scene = train_scene(5);
    double seconds = 0;
    CHECK_OK(cost_seconds(device, scene, &o, &seconds));
    CHECK(seconds > 0);
    oxl_scene_free(test_ctx, scene);
}

/* Two steps of a run, without density control. */
static void vulkan_two_steps(struct train *t)
{
    for (int k = 0; k < 2; k++) {
        t->step++;
        CHECK_OK(step_on_next_view(t));
        CHECK_OK(step_observe(t));
    }
}

/* State of the part of this name, and (out not NULL) its row. */
static void *vulkan_part(struct train *t, const char *name, const struct part **out)
{
    for (int k = 0; parts_at(k); k++) {
        if (strcmp(parts_at(k)->name, name) != 0) continue;
        if (out) *out = parts_at(k);
        return t->part[k];
    }
    return NULL;
}

/* Pruning, then a higher SH degree; rows moved on the device (1), or downloaded and uploaded (0). Returns how
 * many bytes that took; moment: of the opacities, as a checkpoint right behind the pruning has it. */
static size_t vulkan_prune_and_raise(struct train *t, int moves, float moment[120])
{
    struct vulkan_renderer *d = t->renderer->device;
    float x[200], gradient[200];
    size_t bytes, wrong = 0, from = 0;
    const struct part *part = NULL;
    void *state;
    vulkan_two_steps(t);
    CHECK_OK(step_download(t, DOWNLOAD_TO_READ)); /* a checkpoint */
    memcpy(x, t->trained.model.plane[OXL_MEAN], sizeof x);
    memcpy(gradient, t->density->gradient, sizeof gradient);
    if (!moves) d->moments_here = 0;
    CHECK_OK(prune_remove_rows(t, vulkan_part(t, "prune", NULL), 80));
    for (size_t i = 0; i < t->trained.model.count; i++, from++) {
        while (from < 199 && x[from] != t->trained.model.plane[OXL_MEAN][i]) from++;
        wrong += gradient[from] != t->density->gradient[i];
    }
    CHECK(wrong == 0);
    if (moves) memset(t->trained.mean.plane[OXL_OPACITY], 0, 120 * sizeof *moment);
    CHECK_OK(step_download(t, DOWNLOAD_TO_READ));
    memcpy(moment, t->trained.mean.plane[OXL_OPACITY], 120 * sizeof *moment);
    vulkan_two_steps(t);
    CHECK_OK(step_flush(t));
    if (!moves) d->moments_here = 0;
    bytes = d->v->sent + d->v->read_bytes;
    state = vulkan_part(t, "sh_degree", &part);
    CHECK_OK(part->before_step(t, state));
    vulkan_two_steps(t);
    CHECK_OK(step_flush(t));
    bytes = d->v->sent + d->v->read_bytes - bytes;
    CHECK_OK(step_download(t, DOWNLOAD_TO_READ));
    CHECK(t->trained.model.count == 120 && t->trained.model.lobes > 20 && t->trained.model.lobes < 60 &&
          t->trained.model.sh_degree == 1);
    return bytes;
}

static void vulkan_check_kept_rows(oxl_context *device)
{
    oxl_train_options options = train_options(60);
    struct train t[2];
    size_t bytes[2];
    float moment[2][120];
    device->backend->vulkan->slab_rows = 64; /* several slabs */
    for (int k = 0; k < 2; k++) {
        t[k] = (struct train){.ctx = device,
                              .survey = vulkan_survey(device, 0),
                              .options = &options,
                              .decisions = {.ctx = device}};
        CHECK_OK(train_begin(&t[k]));
        CHECK_OK(model_set_lobes(device, &t[k].trained.model, 60));
        CHECK_OK(model_set_lobes(device, &t[k].trained.mean, 60));
        CHECK_OK(model_set_lobes(device, &t[k].trained.square, 60));
        for (int i = 0; i < 60; i++) t[k].trained.model.plane[OXL_LOBE][i] = -1;
        bytes[k] = vulkan_prune_and_raise(&t[k], k, moment[k]);
    }
    CHECK(bytes[1] < bytes[0] / 2);
    CHECK(memcmp(moment[0], moment[1], sizeof moment[0]) == 0 && moment[0][0] != 0);
    vulkan_check_same_model(&t[0].trained.model, &t[1].trained.model);
    vulkan_check_same_model(&t[0].trained.mean, &t[1].trained.mean);
    vulkan_check_same_model(&t[0].trained.square, &t[1].trained.square);
    CHECK(memcmp(t[0].density->gradient, t[1].density->gradient, 120 * sizeof(float)) == 0);
    for (int k = 0; k < 2; k++) {
        oxl_scene *scene = (oxl_scene *)t[k].survey;
        train_end(&t[k]);
        oxl_scene_free(device, scene);
    }
}

/* --backend auto: the device has all images of a run, and no memory for the next step: the CPU continues,
 * with an image that it reads. */
static void vulkan_check_run_falls_back(oxl_context *device)
{
    oxl_train_options options = train_options(60);
    struct vulkan *v = device->backend->vulkan;
    struct vulkan_renderer *d;
    struct train t = {
        .ctx = device, .survey = vulkan_survey(device, 0), .options = &options, .decisions = {.ctx = device}};
    oxl_scene *scene = (oxl_scene *)t.survey;
    CHECK_OK(train_begin(&t));
    for (int k = 0; k < t.views; k += 2) vulkan_two_steps(&t);
    d = t.renderer->device;
    for (int k = 0; k < t.views; k++) CHECK(renderer_has_image(t.renderer, t.view[k]));
    CHECK(vulkan_finish(v) == OXL_OK);
    vulkan_release(v, &d->target);
    vulkan_play_full(v, 0);
    v->image_bytes_max = 0;
    v->evict = NULL;
    device->options.backend = OXL_BACKEND_AUTO;
    vulkan_two_steps(&t);
    CHECK(!renderer_has_device(t.renderer) && t.last_loss > 0 && t.last_loss < 1);
    CHECK(strcmp(oxl_backend_name(device), v->name_and_cpu) == 0);
    CHECK_TEXT(v->name_and_cpu, v->properties.deviceName);
    CHECK_TEXT(v->name_and_cpu, " and cpu");
    v->AllocateMemory = vulkan_real_allocate;
    train_end(&t);
    oxl_scene_free(device, scene);
}

static int vulkan_stops_at(void *user, const oxl_progress *p)
{
    return p->iteration == *(const int *)user;
}

/* A run that saves its state; sum: of the checkpoint that is there then, or NULL. */
static oxl_result vulkan_saved_run(oxl_context *ctx, const oxl_callback *callback, oxl_model *out,
                                   uint64_t *sum)
{
    struct text log = {.ctx = ctx}, notes = {.ctx = ctx};
    struct train_task place = {
        .store = checkpoint_in(test_path("saved"), "saved"), .log = &log, .notes = &notes};
    oxl_scene *scene = vulkan_survey(ctx, 0);
    oxl_train_options options = train_options(60);
    struct os_file_map map = {0};
    const oxl_result rc = train_run(ctx, scene, &options, callback, &place, out);
    if (sum) CHECK_OK(os_read_file(ctx, test_path("saved/checkpoint.oxl"), &map));
    if (sum) *sum = checksum_add(CHECKSUM_SEED, map.data, map.size);
    os_release_file(ctx, &map);
    text_free(&log);
    text_free(&notes);
    oxl_scene_free(ctx, scene);
    return rc;
}

/* A submission finds no memory, nor does its repetition: what was not submitted is not known to the host, so
 * the run ends, with --backend auto, too. The checkpoint is as it was, and the next run ends as if nothing
 * had been. */
static void vulkan_check_lost_run(oxl_context *device)
{
    int stop = 33;
    const oxl_callback callback = {vulkan_stops_at, &stop};
    uint64_t saved[2] = {0, 1};
    struct vulkan *v = device->backend->vulkan;
    oxl_model model[2], none;
    CHECK_OK(vulkan_saved_run(device, NULL, &model[0], NULL));
    CHECK(vulkan_saved_run(device, &callback, &none, &saved[0]) == OXL_ERR_INTERRUPTED);
    oxl_model_free(device, &none);
    vulkan_real_submit = v->QueueSubmit;
    v->QueueSubmit = vulkan_play_late_shortage;
    vulkan_submits_left = 15;
    device->options.backend = OXL_BACKEND_AUTO;
    CHECK(vulkan_saved_run(device, NULL, &none, &saved[1]) == OXL_ERR_FAILED);
    CHECK_TEXT(oxl_error_text(device), "no device memory is left");
    CHECK_TEXT(oxl_error_text(device), "fix: run the command again, it continues from the last checkpoint");
    CHECK(vulkan_submits_left == -3 && none.count == 0); /* once more after images have left */
    CHECK(saved[0] == saved[1]);
    CHECK(v->lost && v->validation_messages == 0);
    vulkan_close(v);
    device->backend->vulkan = NULL;
    device->options.backend = OXL_BACKEND_VULKAN;
    CHECK_OK(vulkan_saved_run(device, NULL, &model[1], NULL));
    vulkan_check_same_model(&model[0], &model[1]);
    for (int k = 0; k < 2; k++) oxl_model_free(device, &model[k]);
}

/* A device is lost in a trial: the error says so. */
static void vulkan_check_lost_trial(oxl_context *device)
{
    oxl_train_options options = train_options(60);
    struct vulkan *v = device->backend->vulkan;
    struct train t = {
        .ctx = device, .survey = vulkan_survey(device, 0), .options = &options, .decisions = {.ctx = device}};
    oxl_scene *scene = (oxl_scene *)t.survey;
    options.exposure = OXL_ON;
    CHECK_OK(train_begin(&t));
    vulkan_two_steps(&t);
    t.trial = 1;
    vulkan_real_submit = v->QueueSubmit;
    v->QueueSubmit = vulkan_play_late_loss;
    vulkan_submits_left = 8;
    CHECK(selection_trial(&t) == OXL_ERR_FAILED && vulkan_submits_left < 0);
    CHECK_TEXT(oxl_error_text(device), "the device is lost");
    train_end(&t);
    oxl_scene_free(device, scene);
    vulkan_close(v);
    device->backend->vulkan = NULL;
}

/* A job in its own folder, on a device that allocates so often: what run.json says of it. */
static void vulkan_check_run_json_of(oxl_context *device, const char *folder, int allocations,
                                     const char *rendered)
{
    const oxl_job_options options = job_test_options();
    char out[512], run[600], words[400];
    snprintf(out, sizeof out, "%s", test_path(folder));
    snprintf(run, sizeof run, "%s/run.json", out);
    vulkan_play_full(device->backend->vulkan, allocations);
    CHECK_OK(oxl_job_run(device, job_test_survey(), out, &options, NULL));
    device->backend->vulkan->AllocateMemory = vulkan_real_allocate;
    snprintf(words, sizeof words, "\"backend\": \"%s\",", rendered);
    CHECK(job_test_has(run, words));
    snprintf(words, sizeof words, "\"device\": \"%s\"}", device->backend->vulkan->properties.deviceName);
    CHECK(job_test_has(run, words));
    /* The run itself left the device, so it is among the block's notes. */
    snprintf(run, sizeof run, "%s/blocks/000/block.json", out);
    CHECK(job_test_has(run, "continuing on the CPU") == (allocations == 0));
}

/* `device` of the job is what a run is to be repeated with; `backend` says what did the work. */
static void vulkan_check_run_json(oxl_context *device)
{
    const char *name = device->backend->vulkan->properties.deviceName;
    device->options.backend = OXL_BACKEND_AUTO;
    vulkan_check_run_json_of(device, "on_device", 10000, name);
    device->backend->rendered_on = 0;
    vulkan_check_run_json_of(device, "on_cpu", 0, "cpu");
    vulkan_check_run_json_of(device, "on_cpu", 0,
                             "cpu"); /* whatever has rendered, the job is the same one, and finished */
}

/* A run that one device began is not continued by another. */
static void vulkan_check_other_device(oxl_context *device)
{
    oxl_job_options options = job_test_options();
    struct job_test_watch watch = {0, 5};
    const oxl_callback callback = {job_test_progress, &watch};
    const char *survey = job_test_survey();
    CHECK(oxl_job_run(device, survey, test_path("begun"), &options, &callback) == OXL_ERR_INTERRUPTED);
    CHECK(oxl_job_run(test_ctx, survey, test_path("begun"), &options, NULL) == OXL_ERR_USAGE);
    CHECK_OK(oxl_job_run(test_ctx, survey, test_path("other"), &options, NULL));
    CHECK(oxl_job_run(device, survey, test_path("other"), &options, NULL) == OXL_ERR_USAGE);
    CHECK_TEXT(oxl_error_text(device), "  device: none there, ");
}

/* A device whose memory the survey does not fit trains it by blocks, within --device-ram; one that has no room
 * for blocks of any size is refused with what it needs. */
static void vulkan_check_device_ram(oxl_context *device)
{
    struct vulkan *v = device->backend->vulkan;
    oxl_job_options options = job_test_options();
    const char *survey = job_test_survey_of(5000);
    char out[512];
    snprintf(out, sizeof out, "%s", test_path("device_ram"));
    options.renders = 0;
    options.train.sh_degree = 3; /* with degree 1, which auto takes, they fit */
    options.device_ram = device->options.device_ram = 11 << 20;
    v->most_allocated = v->allocated;
    device->backend->rendered_on = 0;
    CHECK_OK(oxl_job_run(device, survey, out, &options, NULL));
    CHECK(os_is_file(PATH(out, "blocks/001/model.ply")));
    CHECK(device->backend->rendered_on == RENDERED_ON_DEVICE);
    CHECK(v->most_allocated <= options.device_ram && v->most_allocated > options.device_ram / 4);
    options.device_ram = 1 << 20;
    CHECK(oxl_job_run(device, survey, test_path("device_ram_1m"), &options, NULL) == OXL_ERR_BUDGET);
    CHECK(strstr(oxl_error_text(device), "MB of the device are too little") &&
          strstr(oxl_error_text(device), "fix: --device-ram "));
}

static VkPipelineLayout *vulkan_refused;
static PFN_vkCreateComputePipelines vulkan_real_compile;

static VKAPI_ATTR VkResult VKAPI_CALL vulkan_play_refusal(VkDevice device, VkPipelineCache cache,
                                                          uint32_t count,
                                                          const VkComputePipelineCreateInfo *info,
                                                          const VkAllocationCallbacks *a, VkPipeline *out)
{
    *out = VK_NULL_HANDLE;
    return info->layout == *vulkan_refused ? VK_ERROR_UNKNOWN
                                           : vulkan_real_compile(device, cache, count, info, a, out);
}

/* The first step of a run, on a device that allocates so often in it; returns how often. */
static int vulkan_first_step(oxl_context *device, int allocations, int falls_back)
{
    oxl_train_options options = train_options(60);
    oxl_scene *scene = train_scene(9);
    struct train t = {
        .ctx = device, .survey = scene, .options = &options, .decisions = {.ctx = device}, .step = 1};
    CHECK_OK(train_begin(&t));
    vulkan_play_full(device->backend->vulkan, allocations);
    CHECK_OK(step_on_next_view(&t));
    device->backend->vulkan->AllocateMemory = vulkan_real_allocate;
    CHECK_OK(step_flush(&t));
    CHECK(t.last_loss > 0 && t.last_loss < 1);
    CHECK(renderer_has_device(t.renderer) == !falls_back);
    train_end(&t);
    oxl_scene_free(device, scene);
    return allocations - vulkan_allocations_left;
}

static int vulkan_refusals_made;

static VKAPI_ATTR VkResult VKAPI_CALL vulkan_note_refusal(VkDevice device, VkPipelineCache cache,
                                                          uint32_t count,
                                                          const VkComputePipelineCreateInfo *info,
                                                          const VkAllocationCallbacks *a, VkPipeline *out)
{
    vulkan_refusals_made += info->layout == *vulkan_refused;
    return vulkan_play_refusal(device, cache, count, info, a, out);
}

/* A shader that is refused is no lack of memory: it is asked for once, and what the pairs had is there for
 * others. */
static void vulkan_check_refused_shader(oxl_context *device)
{
    static struct vulkan_deferral d;
    struct vulkan *v = device->backend->vulkan;
    const oxl_render_options options = oxl_render_options_default();
    struct vulkan_renderer *r;
    vulkan_deferral_begin(device, &d);
    r = d.r->device;
    renderer_expect_steps(d.r);
    CHECK_OK(renderer_forward(device, d.r, &d.run.trained.model, &d.camera, &options));
    CHECK(r->pair_key[0].handle && r->sums_a.handle && vulkan_finish(v) == OXL_OK);
    vulkan_refused = &v->pipeline[PASS_STEP].layout;
    vulkan_refusals_made = 0;
    v->DestroyPipeline(v->device, v->pipeline[PASS_STEP].variant[0], NULL);
    v->pipeline[PASS_STEP].variant[0] = VK_NULL_HANDLE;
    vulkan_real_compile = v->CreateComputePipelines;
    v->CreateComputePipelines = vulkan_note_refusal;
    CHECK(renderer_forward(device, d.r, &d.run.trained.model, &d.camera, &options) == OXL_ERR_MEMORY);
    CHECK(vulkan_refusals_made == 1 && !r->low_memory && !r->pair_key[0].handle && !r->sums_a.handle);
    v->CreateComputePipelines = vulkan_real_compile;
    CHECK_OK(renderer_forward(device, d.r, &d.run.trained.model, &d.camera, &options));
    vulkan_deferral_end(device, &d);
}

/* --backend auto: wherever the first step finds no memory, or a shader is refused, the CPU does it, and has
 * the image that only the device had. */
static void vulkan_check_first_step_falls_back(oxl_context *device)
{
    static const enum vulkan_pass late[] = {PASS_OBSERVE, PASS_STEP, PASS_LOSS_BACKWARD};
    struct vulkan *v = device->backend->vulkan;
    const int all = vulkan_first_step(device, 1000, 0);
    device->options.backend = OXL_BACKEND_AUTO;
    CHECK(all > 20);
    for (int k = all - 1; k >= 0; k -= k > all - 16 ? 1 : 8) vulkan_first_step(device, k, 1);
    vulkan_real_compile = v->CreateComputePipelines;
    v->CreateComputePipelines = vulkan_play_refusal;
    for (size_t i = 0; i < OXL_COUNT(late); i++) {
        vulkan_refused = &v->pipeline[late[i]].layout;
        v->DestroyPipeline(v->device, v->pipeline[late[i]].variant[0], NULL);
        v->pipeline[late[i]].variant[0] = VK_NULL_HANDLE;
        vulkan_first_step(device, 1000, 1);
    }
    v->CreateComputePipelines = vulkan_real_compile;
}

/* Once at each iteration that it is due. user: the last one. */
static int vulkan_stops(void *user, const oxl_progress *p)
{
    int *last = user, stops = p->iteration % 7 == 3 && p->iteration != *last;
    if (stops) *last = p->iteration;
    return stops;
}

static int vulkan_counted, vulkan_halted; /* deferred steps; those that found no room */

/* Room for one pair in every third deferred step. */
static VKAPI_ATTR void VKAPI_CALL vulkan_play_push(VkCommandBuffer commands, VkPipelineLayout layout,
                                                   VkShaderStageFlags stages, uint32_t offset, uint32_t size,
                                                   const void *push)
{
    uint32_t word[32];
    memcpy(word, push, size);
    if (size == SPIRV_SCAN_PUSH && word[1] == COUNT_PAIRS && word[2] != UINT32_MAX &&
        vulkan_counted++ % 3 == 2)
        word[2] = 1, vulkan_halted++;
    vulkan_real_push(commands, layout, stages, offset, size, word);
}

/* a run: to its end; steps repeated; from checkpoint to checkpoint */
enum { VULKAN_STRAIGHT, VULKAN_WITHOUT_ROOM, VULKAN_STOPPED };

static void vulkan_train_exposed(oxl_context *ctx, int how, oxl_model *out, double gain[18])
{
    int last = 0, stops = 0;
    const oxl_callback callback = {how == VULKAN_STOPPED ? vulkan_stops : NULL, &last};
    struct text log = {.ctx = ctx}, notes = {.ctx = ctx};
    struct oxl_imaging imaging = {0};
    struct train_task place = {.log = &log, .notes = &notes, .imaging = &imaging};
    oxl_scene *scene = vulkan_survey(ctx, 0.3);
    oxl_train_options options = train_options(80);
    oxl_result rc;
    options.exposure = OXL_ON;
    options.short_run_exponent = 0;
    if (how == VULKAN_STOPPED) place.store = checkpoint_in(test_path("exposed"), "exposed");
    do {
        rc = train_run(ctx, scene, &options, &callback, &place, out);
        if (rc == OXL_ERR_INTERRUPTED) oxl_model_free(ctx, out);
    } while (rc == OXL_ERR_INTERRUPTED && stops++ < 20);
    CHECK_OK(rc);
    CHECK(stops == (how == VULKAN_STOPPED ? 12 : 0));
    CHECK(imaging.on);
    for (int i = 0; i < 18; i++) gain[i] = (double)imaging.log_gain[i];
    imaging_free(ctx, &imaging);
    text_free(&log);
    text_free(&notes);
    oxl_scene_free(ctx, scene);
}

/* Gains of images are learned on a device as on the CPU, in deferred steps; what the run is interrupted by
 * does not show. */
static void vulkan_check_exposure(oxl_context *device)
{
    oxl_model model[3];
    double cpu[18], gain[3][18];
    size_t waits;
    vulkan_train_exposed(test_ctx, VULKAN_STRAIGHT, &model[0], cpu);
    oxl_model_free(test_ctx, &model[0]);
    waits = device->backend->vulkan->waits;
    vulkan_train_exposed(device, VULKAN_STRAIGHT, &model[0], gain[0]);
    CHECK(device->backend->vulkan->waits - waits < 80);
    vulkan_real_push = device->backend->vulkan->CmdPushConstants;
    device->backend->vulkan->CmdPushConstants = vulkan_play_push;
    vulkan_counted = vulkan_halted = 0;
    vulkan_train_exposed(device, VULKAN_WITHOUT_ROOM, &model[1], gain[1]);
    device->backend->vulkan->CmdPushConstants = vulkan_real_push;
    CHECK(vulkan_counted > 20 && vulkan_halted > 6);
    vulkan_train_exposed(device, VULKAN_STOPPED, &model[2], gain[2]);
    CHECK(cpu[0] - cpu[3] > 0.03);
    for (int i = 0; i < 18; i++) CHECK_CLOSE(gain[0][i], cpu[i], 0.002);
    for (int k = 1; k < 3; k++) {
        CHECK(memcmp(gain[0], gain[k], sizeof gain[0]) == 0);
        vulkan_check_same_model(&model[0], &model[k]);
    }
    for (int k = 0; k < 3; k++) oxl_model_free(device, &model[k]);
}

static void vulkan_check_poses(oxl_context *device)
{
    struct text decisions = {.ctx = device};
    struct train_task place = {.decisions = &decisions};
    oxl_scene *scene = vulkan_survey(device, 0);
    oxl_train_options options = train_options(3);
    oxl_model model;
    options.poses = OXL_AUTO;
    CHECK_OK(train_run(device, scene, &options, NULL, &place, &model));
    CHECK_TEXT(decisions.data ? decisions.data : "",
               "\"poses\": {\"chosen\": \"off\", \"evidence\": \"a device has no gradient of them\"}");
    text_free(&decisions);
    oxl_model_free(device, &model);
    oxl_scene_free(device, scene);
}

/* Parts of images, whole and halved, masked or not, are those of the CPU. */
static void vulkan_check_window_of_image(oxl_context *device, int masked, int halved)
{
    const struct image_window window = {.x = 11, .y = 6, .width = 41, .height = 30};
    struct vulkan_twins t = vulkan_twins(device, 41 >> halved, 30 >> halved);
    uint8_t *bytes = oxl_alloc(test_ctx, 4 * 61 * 45, 1);
    const struct training_image image = {61, 45, bytes, masked ? bytes + 3 * 61 * 45 : NULL};
    struct renderer_loss loss[2];
    oxl_model m;
    vulkan_scene(200, 0, 0, &m);
    for (uint64_t i = 0; i < 4 * 61 * 45; i++)
        bytes[i] = (uint8_t)(random_bits(9, i, 0) & (i < 3 * 61 * 45 || i % 97 ? 255 : 0));
    for (int round = 0; round < 2; round++) {
        vulkan_forward_both(&t, &m);
        for (int k = 0; k < 2; k++) {
            CHECK_OK(renderer_set_image(t.ctx[k], t.r[k], 3, k && round ? NULL : &image, &window, halved));
            CHECK_OK(renderer_loss(t.ctx[k], t.r[k], NULL, NULL, 0.2f, &loss[k]));
        }
        CHECK_CLOSE(loss[1].l1, loss[0].l1, 1e-5);
        CHECK_CLOSE(loss[1].ssim, loss[0].ssim, 1e-5);
    }
    oxl_model_free(test_ctx, &m);
    oxl_free(test_ctx, bytes);
    vulkan_twins_free(&t);
}

static void vulkan_check_windows(oxl_context *device)
{
    oxl_context *ctx[3] = {test_ctx, device, device};
    struct image_window window[6];
    oxl_model model[3], context;
    vulkan_scene(333, 1, 0, &context);
    for (size_t i = 0; i < context.count; i++) context.plane[OXL_MEAN][i] += 0.3f;
    vulkan_check_imaging_of(device, &(struct vulkan_imaging){.context = &context, .window = 1, .degree = 2});
    vulkan_check_imaging_of(device, &(struct vulkan_imaging){.context = &context,
                                                             .window = 1,
                                                             .lit = 1,
                                                             .medium = &vulkan_murky,
                                                             .dropout = 0.3,
                                                             .points = 60,
                                                             .lobes = 100});
    for (int k = 0; k < 4; k++) vulkan_check_window_of_image(device, k & 1, k >> 1);
    for (int i = 0; i < 6; i++) window[i] = (struct image_window){.x = 8, .y = 4, .width = 32, .height = 24};
    for (int k = 0; k < 3; k++) {
        struct train_task place = {.store = checkpoint_in(test_path(k == 0   ? "cpu"
                                                                    : k == 1 ? "device"
                                                                             : "again"),
                                                          "windows"),
                                   .window = window,
                                   .context = &context};
        oxl_scene *scene = vulkan_survey(ctx[k], 0);
        oxl_train_options options = train_options(20);
        CHECK_OK(train_run(ctx[k], scene, &options, NULL, &place, &model[k]));
        oxl_scene_free(ctx[k], scene);
    }
    CHECK(device->backend->rendered_on == RENDERED_ON_DEVICE);
    for (int k = 0; k < 3; k++) /* the others have gradients of next to nothing, whose signs differ */
        CHECK_CLOSE(vulkan_distance(model[0].plane[k], model[1].plane[k], model[0].count).relative, 0, 1e-2);
    vulkan_check_same_model(&model[1], &model[2]);
    for (int k = 0; k < 3; k++) oxl_model_free(ctx[k], &model[k]);
    oxl_model_free(test_ctx, &context);
}

static void vulkan_check_repeated(oxl_context *device)
{
    oxl_model model[2];
    double psnr[2];
    vulkan_train(device, 60, &model[0], &psnr[0]);
    vulkan_real_push = device->backend->vulkan->CmdPushConstants;
    device->backend->vulkan->CmdPushConstants = vulkan_play_push;
    vulkan_counted = vulkan_halted = 0;
    vulkan_train(device, 60, &model[1], &psnr[1]);
    device->backend->vulkan->CmdPushConstants = vulkan_real_push;
    CHECK(vulkan_counted > 20 && vulkan_halted > 6);
    CHECK(psnr[0] == psnr[1] && model[0].count == model[1].count);
    for (int k = 0; k < oxl_model_planes(&model[0]) && model[0].count == model[1].count; k++)
        CHECK(memcmp(model[0].plane[k], model[1].plane[k], model[0].count * sizeof(float)) == 0);
    for (int k = 0; k < 2; k++) oxl_model_free(test_ctx, &model[k]);
}

/* ---------------- all parts at once */

enum { VULKAN_ALL_VIEWS = 8 };

/* A survey with tracks that all parts can learn from. */
static void vulkan_make_all(void)
{
    synth_options o = synth_test_options("vulkan_all");
    struct colmap survey = {0};
    o.views = VULKAN_ALL_VIEWS, o.water = SYNTH_3C, o.path = SYNTH_FORWARD, o.points = 800;
    o.width = 80, o.height = 56;
    synth_test_make(&o, &survey);
    colmap_free(test_ctx, &survey);
}

/* A run with every part on, up to its first step: survey with tracks, windows, context. */
static void vulkan_begin_all(oxl_context *ctx, struct train *t, oxl_train_options *o,
                             struct image_window window[VULKAN_ALL_VIEWS], const oxl_model *context)
{
    struct lamp_fit *lamp;
    *o = train_options(400);
    o->exposure = o->lamp = o->medium = OXL_ON;
    o->dropout = 0.1f;
    o->antialias = 1;
    *t = (struct train){.ctx = ctx, .options = o, .decisions = {.ctx = ctx}, .step = 0};
    CHECK_OK(oxl_scene_load(ctx, test_path("vulkan_all"), NULL, (oxl_scene **)&t->survey));
    CHECK(oxl_scene_view_count(t->survey) == VULKAN_ALL_VIEWS);
    for (int i = 0; i < VULKAN_ALL_VIEWS; i++)
        window[i] = (struct image_window){.x = 8, .y = 4, .width = 64, .height = 48};
    t->task = (struct train_task){.window = window, .context = context};
    CHECK_OK(train_begin(t));
    lamp = vulkan_part(t, "lamp", NULL);
    lamp->on = 1;
    *(struct medium *)vulkan_part(t, "medium", NULL) = vulkan_murky;
}

static void vulkan_end_all(struct train *t)
{
    train_end(t);
    oxl_scene_free(t->ctx, (oxl_scene *)t->survey);
}

static void vulkan_steps_of_all(struct train *t, int steps)
{
    for (int k = 0; k < steps; k++) {
        t->step++;
        CHECK_OK(step_on_next_view(t));
        CHECK_OK(step_observe(t));
    }
}

/* With lamp, medium, gains, depths, dropout, window and context a step takes at
 * most 41 passes, and the host waits for none: it learns of each a step late. */
static void vulkan_check_all_parts(oxl_context *device)
{
    struct vulkan *v = device->backend->vulkan;
    struct image_window window[VULKAN_ALL_VIEWS];
    oxl_train_options o;
    oxl_model context;
    struct train t;
    size_t waits, dispatches, read, sent;
    vulkan_make_all();
    vulkan_scene(333, 1, 0, &context);
    vulkan_begin_all(device, &t, &o, window, &context);
    vulkan_steps_of_all(&t, VULKAN_ALL_VIEWS);
    waits = v->waits, dispatches = v->dispatches, read = v->read_bytes, sent = v->sent;
    vulkan_steps_of_all(&t, 10);
    CHECK(v->waits == waits && v->read_bytes == read && v->sent == sent);
    CHECK(v->dispatches - dispatches <= 10 * 41 && v->dispatches - dispatches >= 10 * 35); /* plain: 30 */
    CHECK_OK(step_flush(&t));
    CHECK(device->backend->rendered_on == RENDERED_ON_DEVICE);
    vulkan_end_all(&t);
    oxl_model_free(test_ctx, &context);
}

/* Numbers of the run: the lamp's. */
static void vulkan_numbers_of_all(struct train *t, double number[LAMP_TERMS])
{
    const struct lamp_fit *lamp = vulkan_part(t, "lamp", NULL);
    CHECK_OK(step_download(t, DOWNLOAD_TO_READ));
    for (int k = 0; k < LAMP_TERMS; k++) number[k] = (double)lamp->group[0].shape[k];
}

/* The same bytes, whether or not steps find no room and are repeated, and near those of the CPU. */
static void vulkan_check_all_repeated(oxl_context *device)
{
    struct image_window window[VULKAN_ALL_VIEWS];
    double number[3][LAMP_TERMS] = {{0}};
    oxl_train_options o;
    struct train t[3];
    vulkan_make_all();
    for (int k = 0; k < 3; k++) {
        vulkan_begin_all(k ? device : test_ctx, &t[k], &o, window, NULL);
        vulkan_real_push = device->backend->vulkan->CmdPushConstants;
        vulkan_counted = vulkan_halted = 0;
        if (k == 2) device->backend->vulkan->CmdPushConstants = vulkan_play_push;
        vulkan_steps_of_all(&t[k], 16);
        device->backend->vulkan->CmdPushConstants = vulkan_real_push;
        CHECK((vulkan_halted > 3) == (k == 2));
        vulkan_numbers_of_all(&t[k], number[k]);
    }
    CHECK(memcmp(number[1], number[2], sizeof number[1]) == 0);
    CHECK(train_same(&t[1].trained.model, &t[2].trained.model));
    for (int k = 0; k < LAMP_TERMS; k++) CHECK_CLOSE(number[1][k], number[0][k], 0.1);
    for (int k = 0; k < 3; k++) vulkan_end_all(&t[k]);
}

#endif

DEVICE_TEST(vulkan_shaders_have_infinity_from_the_host, vulkan_check_infinity);
DEVICE_TEST(vulkan_sorts_stably_whatever_the_number_of_keys, vulkan_check_sorts);
DEVICE_TEST(vulkan_adds_up_prefixes_whatever_their_number, vulkan_check_scans);
DEVICE_TEST(vulkan_projects_as_the_cpu_does_at_the_extremes_too, vulkan_check_projection);
DEVICE_TEST(vulkan_renders_as_the_cpu_does, vulkan_check_drawing);
DEVICE_TEST(vulkan_renders_extreme_gaussians_as_the_cpu_does, vulkan_check_wild_drawing);
DEVICE_TEST(vulkan_renders_an_empty_model_as_the_background, vulkan_check_nothing);
DEVICE_TEST(vulkan_renders_depths_as_the_cpu_does, vulkan_check_depth);
DEVICE_TEST(vulkan_renders_the_same_within_the_limits_of_any_device, vulkan_check_limits);
DEVICE_TEST(vulkan_refuses_what_is_too_large_and_remains_usable, vulkan_check_refusal);
DEVICE_TEST(vulkan_uses_portability_drivers, vulkan_check_portability);
DEVICE_TEST(vulkan_opens_the_next_device_where_the_best_cannot_be, vulkan_check_next_device);
DEVICE_TEST(vulkan_gives_up_a_device_that_does_not_answer, vulkan_check_timeout);
DEVICE_TEST(vulkan_gives_up_a_device_that_hangs_after_another_error, vulkan_check_hang);
DEVICE_TEST(vulkan_gives_up_a_device_that_is_lost, vulkan_check_lost);
DEVICE_TEST(vulkan_gives_up_a_device_that_did_half_a_step, vulkan_check_half_step);
DEVICE_TEST(vulkan_takes_no_results_of_a_wait_that_ended_without_the_work, vulkan_check_unfinished);
DEVICE_TEST(vulkan_repeats_a_submission_that_finds_no_memory, vulkan_check_short_submit);
DEVICE_TEST(vulkan_drops_images_for_a_submission_that_does_not_name_them, vulkan_check_submit_drops);
DEVICE_TEST(vulkan_gives_up_a_device_without_memory_for_a_step_not_for_an_image, vulkan_check_short_end);
DEVICE_TEST(vulkan_waits_for_what_is_under_way_when_a_command_is_lost, vulkan_check_lost_commands);
DEVICE_TEST(vulkan_takes_no_image_or_model_for_copied_whose_copy_failed, vulkan_check_short_begin);
DEVICE_TEST(vulkan_times_passes_while_a_clock_begins_again, vulkan_check_clock);
DEVICE_TEST(vulkan_keeps_uploads_when_an_error_follows, vulkan_check_uploads);
DEVICE_TEST(vulkan_waits_for_a_gpu_up_to_its_timeout_and_for_a_cpu_without_a_limit,
            vulkan_check_timeout_of_kinds);
DEVICE_TEST(vulkan_keeps_pairs_in_the_slots_that_were_counted, vulkan_check_slots);
DEVICE_TEST(vulkan_drops_images_where_memory_is_short, vulkan_check_full);
DEVICE_TEST(vulkan_keeps_images_within_what_memory_is_left, vulkan_check_budget);
DEVICE_TEST(vulkan_deferred_steps_get_along_with_room_for_the_pairs_that_there_are, vulkan_check_tight);
DEVICE_TEST(vulkan_falls_back_to_the_cpu_when_out_of_memory, vulkan_check_fallback);
DEVICE_TEST(vulkan_images_and_gradients_fall_back_to_the_cpu, vulkan_check_draws_fall_back);
DEVICE_TEST(vulkan_run_of_a_lost_device_continues_from_an_intact_checkpoint, vulkan_check_lost_run);
DEVICE_TEST(vulkan_trial_of_a_lost_device_says_that_it_is_lost, vulkan_check_lost_trial);
DEVICE_TEST(vulkan_run_json_says_what_rendered, vulkan_check_run_json);
DEVICE_TEST(vulkan_run_that_one_device_began_is_refused_by_another, vulkan_check_other_device);
DEVICE_TEST(vulkan_trains_by_blocks_what_device_ram_has_no_room_for, vulkan_check_device_ram);
DEVICE_TEST(vulkan_training_continues_on_the_cpu_when_out_of_memory, vulkan_check_run_falls_back);
DEVICE_TEST(vulkan_first_step_falls_back_wherever_it_finds_no_memory_or_no_shader,
            vulkan_check_first_step_falls_back);
DEVICE_TEST(vulkan_leaves_out_what_is_below_alpha_min, vulkan_check_alpha_min);
DEVICE_TEST(vulkan_validation_reports_planted_faults, vulkan_check_validation);
DEVICE_TEST(vulkan_renders_the_same_whole_and_in_parts, vulkan_check_parts);
DEVICE_TEST(vulkan_bounds_a_submission_of_an_unbalanced_image, vulkan_check_unbalanced);
DEVICE_TEST(vulkan_shaders_fit_the_least_shared_memory, vulkan_check_shared);
DEVICE_TEST(vulkan_loss_and_its_gradient_agree_with_the_cpus, vulkan_check_loss);
DEVICE_TEST(vulkan_compares_with_images_as_the_cpu_does, vulkan_check_images);
DEVICE_TEST(vulkan_gradients_agree_with_the_cpus, vulkan_check_gradient);
DEVICE_TEST(vulkan_scores_agree_with_the_cpus, vulkan_check_score);
DEVICE_TEST(vulkan_steps_and_statistics_agree_with_the_cpus, vulkan_check_steps);
DEVICE_TEST(vulkan_steps_do_not_depend_on_when_the_host_looks, vulkan_check_downloads);
DEVICE_TEST(vulkan_clears_nonfinite_rows_after_such_a_loss, vulkan_check_cleared);
DEVICE_TEST(vulkan_skips_nonfinite_rows, vulkan_check_aside);
DEVICE_TEST(vulkan_uploads_a_model_once_for_all_views_of_an_evaluation, vulkan_check_one_upload);
DEVICE_TEST(vulkan_renders_the_current_model, vulkan_check_model_now);
DEVICE_TEST(vulkan_training_repeats_itself_and_is_as_good_as_the_cpus, vulkan_check_training);
DEVICE_TEST(vulkan_times_the_steps_of_a_forecast, vulkan_check_forecast);
DEVICE_TEST(vulkan_reads_what_it_needs_and_sends_nothing_twice, vulkan_check_transfers);
DEVICE_TEST(vulkan_deferred_steps_are_the_same_steps_without_waits, vulkan_check_deferral);
DEVICE_TEST(vulkan_steps_behind_one_that_cannot_be_done_change_nothing, vulkan_check_halt);
DEVICE_TEST(vulkan_steps_behind_one_that_was_given_up_are_done, vulkan_check_no_halt_stays);
DEVICE_TEST(vulkan_training_repeats_steps_that_found_no_room, vulkan_check_repeated);
DEVICE_TEST(vulkan_pruning_and_a_higher_sh_degree_move_rows_as_the_host_does, vulkan_check_kept_rows);
DEVICE_TEST(vulkan_density_control_moves_rows_as_the_host_does, vulkan_check_moves);
DEVICE_TEST(vulkan_learns_gains_of_images_as_the_cpu_does, vulkan_check_exposure);

TEST(vulkan_run_says_why_it_refines_no_poses)
{
    NEEDS_PART(poses);
    ON_DEVICE(vulkan_check_poses);
}

DEVICE_TEST(vulkan_leaves_out_the_gaussians_that_the_cpu_leaves_out, vulkan_check_dropout);
DEVICE_TEST(vulkan_has_the_lamp_of_the_cpu_and_its_gradients, vulkan_check_lamp);
DEVICE_TEST(vulkan_has_the_medium_of_the_cpu_and_its_gradients, vulkan_check_medium);
DEVICE_TEST(vulkan_has_the_loss_in_front_of_points_of_the_cpu, vulkan_check_depth_loss);
DEVICE_TEST(vulkan_trains_parts_of_views_in_front_of_a_context_as_the_cpu_does, vulkan_check_windows);
DEVICE_TEST(vulkan_a_step_with_all_parts_waits_for_nothing_and_takes_45_passes, vulkan_check_all_parts);
DEVICE_TEST(vulkan_repeated_steps_with_all_parts_give_the_same_bytes, vulkan_check_all_repeated);
DEVICE_TEST(vulkan_asks_once_for_a_shader_that_is_refused, vulkan_check_refused_shader);
/* In any build. */
TEST(vulkan_without_a_device_is_reported_in_one_line)
{
    oxl_context_options options = test_ctx->options;
    oxl_context *ctx;
    oxl_camera camera = {
        .width = 8, .height = 8, .fx = 8, .fy = 8, .cx = 4, .cy = 4, .rotation = {1, 0, 0, 0, 1, 0, 0, 0, 1}};
    oxl_model model;
    oxl_image image;
#ifdef OXL_VULKAN
    setenv("OXL_VULKAN_LIBRARY", "no-such-library.so", 1);
#endif
    CHECK_OK(oxl_model_create(test_ctx, 1, 0, &model));
    options.backend = OXL_BACKEND_VULKAN;
    CHECK_OK(oxl_context_create(&options, &ctx));
    CHECK(oxl_backend_begin(ctx) == OXL_ERR_FAILED);
    CHECK_TEXT(oxl_error_text(ctx), "fix: ");
    CHECK(oxl_render(ctx, &model, &camera, NULL, &image, NULL) == OXL_ERR_FAILED);
    oxl_context_free(ctx);
    options.backend = OXL_BACKEND_AUTO;
    CHECK_OK(oxl_context_create(&options, &ctx));
    CHECK_OK(oxl_render(ctx, &model, &camera, NULL, &image, NULL));
    CHECK(strcmp(oxl_backend_name(ctx), "cpu") == 0);
    oxl_image_free(ctx, &image);
    oxl_context_free(ctx);
    oxl_model_free(test_ctx, &model);
#ifdef OXL_VULKAN
    unsetenv("OXL_VULKAN_LIBRARY");
#endif
}
