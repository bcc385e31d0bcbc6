/* test_vulkan.c - the Vulkan backend against the CPU's: both behind the same interface, the same input,
 * stated bounds.
 *
 * Wants a build with make VULKAN=1 and a device; Mesa's lavapipe will do, and is what the bounds were seen
 * on. The validation layer listens to every test where it is installed. What a test allocates of `cpu` lives
 * until its process ends; what it allocates of the device's context must be freed.
 */
#include "test.h"
#include "wide.h"
#ifdef OXL_VULKAN /* the tests see into the backend's files, which are part of this object instead */
#include "../src/parts/dropout.h"
#include "../src/parts/lamp.h"
#include "../src/parts/medium.h"
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

#pragma GCC diagnostic ignored "-Wunused-parameter" /* of functions of a driver that is played */

static oxl_context *device, *cpu;
static struct vulkan *v, driver; /* the device; as it was opened, with the driver's functions */
static oxl_render_options vulkan_options;
static struct renderer *vulkan_renderers[64]; /* the device's, freed at the test's end */
static int vulkan_renderer_count;
static char vulkan_heard[400]; /* the last warning, and how many hold the words listened for */
static const char *vulkan_listened_for;
static int vulkan_times_heard;

static void vulkan_hear(void *user, oxl_log_level level, const char *text)
{
    if (level > OXL_LOG_WARNING) return;
    snprintf(vulkan_heard, sizeof vulkan_heard, "%s", text);
    if (vulkan_listened_for && strstr(text, vulkan_listened_for)) vulkan_times_heard++;
    else if (!vulkan_listened_for) printf("  %s\n", text);
}

static void vulkan_listen(const char *words)
{
    vulkan_listened_for = words;
    vulkan_times_heard = device->backend->fell_back = 0;
}

static int vulkan_test_begin(void)
{
    oxl_context_options options = test_ctx->options;
    setenv("OXL_VULKAN_VALIDATE", "1", 0); /* or gpu: backends/vulkan/instance.c */
    if (getenv("OXL_TEST_DEVICE"))
        options.device = atoi(getenv("OXL_TEST_DEVICE")); /* of info --devices; else the best */
    options.backend = OXL_BACKEND_VULKAN;
    options.log = vulkan_hear;
    CHECK_OK(oxl_context_create(&options, &device));
    CHECK_OK(oxl_context_create(NULL, &cpu));
    vulkan_options = oxl_render_options_default();
    vulkan_options.background[1] = 0.25f;
    vulkan_renderer_count = 0;
    vulkan_listened_for = NULL;
    if (oxl_backend_begin(device) == OXL_OK) return driver = *(v = device->backend->vulkan), 1;
    oxl_context_free(device);
    return 0;
}

/* Frees the renderers and closes the device; messages of the validation layer fail the test. */
static void vulkan_close_now(void)
{
    while (vulkan_renderer_count > 0) renderer_free(device, vulkan_renderers[--vulkan_renderer_count]);
    CHECK(v->validation_messages == 0);
    vulkan_close(v);
    device->backend->vulkan = v = NULL;
}

static void vulkan_test_end(void)
{
    if (v) vulkan_close_now();
    oxl_context_free(device);
    oxl_context_free(cpu);
}

/* 0: the CPU's or the first, 1: the device's or the second. */
#define VULKAN_TWICE(k) for (int k = 0; k < 2; k++)

/* A test with a device. */
#define DEVICE_TEST(name)                                        \
    static void name(void);                                      \
    TEST(name)                                                   \
    {                                                            \
        if (!vulkan_test_begin()) SKIP("no Vulkan device here"); \
        name();                                                  \
        vulkan_test_end();                                       \
    }                                                            \
    static void name(void)

#define REFUSED(call, code, words)                 \
    do {                                           \
        CHECK((call) == (code));                   \
        CHECK_TEXT(oxl_error_text(device), words); \
    } while (0)

static oxl_context *vulkan_ctx(int k) /* 0: the CPU's, 1: the device's */
{
    return k ? device : cpu;
}

static struct renderer *vulkan_renderer(oxl_context *ctx)
{
    struct renderer *r;
    CHECK_OK(renderer_create(ctx, &r));
    CHECK(vulkan_renderer_count < (int)OXL_COUNT(vulkan_renderers));
    if (ctx == device) vulkan_renderers[vulkan_renderer_count++] = r;
    return r;
}

static void *vulkan_memory(size_t count, size_t size)
{
    void *memory = oxl_calloc(cpu, count, size);
    CHECK(memory != NULL);
    return memory;
}

/* ---------------- a driver with faults */

/* What a call may leave in the handle that it was to make: anything. */
#define VULKAN_LEAVE(out) memset(out, 0x10, sizeof *(out))

struct vulkan_fault { /* after so many calls so many come back with the result, without being made; -1: all */
    int after, times;
    VkResult result;
};
static int vulkan_played; /* calls that were */

static int vulkan_plays(struct vulkan_fault *f)
{
    if (f->times == 0 || f->after-- > 0) return 0;
    f->times -= f->times > 0;
    return ++vulkan_played;
}

#define VULKAN_FAULTY(name, parameters, arguments, ...)                            \
    static struct vulkan_fault vulkan_fault_##name;                                \
    static VKAPI_ATTR VkResult VKAPI_CALL vulkan_play_##name parameters            \
    {                                                                              \
        __VA_ARGS__;                                                               \
        if (vulkan_plays(&vulkan_fault_##name)) return vulkan_fault_##name.result; \
        return driver.name arguments;                                              \
    }
#define VULKAN_FAIL(name, after, times, result) \
    (v->name = vulkan_play_##name, vulkan_fault_##name = (struct vulkan_fault){after, times, result})
#define VULKAN_SOUND(name) (v->name = driver.name)

static uint64_t vulkan_waited;           /* ns: the last wait, at most */
static VkPipelineLayout *vulkan_refused; /* its shaders are refused */
static int vulkan_refusals;              /* of shaders, of memory */
static VkDeviceSize vulkan_largest;      /* bytes of an allocation */
static size_t vulkan_images_kept;        /* bytes: while as many images are kept there is no memory */

/* clang-format off */
VULKAN_FAULTY(QueueSubmit, (VkQueue queue, uint32_t count, const VkSubmitInfo *info, VkFence fence),
              (queue, count, info, fence), (void)0)
VULKAN_FAULTY(EndCommandBuffer, (VkCommandBuffer commands), (commands),
              if (vulkan_fault_EndCommandBuffer.times) {
                  const VkResult result = driver.EndCommandBuffer(commands);
                  return vulkan_plays(&vulkan_fault_EndCommandBuffer) ? VK_ERROR_OUT_OF_HOST_MEMORY : result;
              })
VULKAN_FAULTY(WaitForFences, (VkDevice d, uint32_t count, const VkFence *fence, VkBool32 all, uint64_t timeout),
              (d, count, fence, all, timeout), vulkan_waited = timeout;
              if (vulkan_played > 100) return VK_ERROR_DEVICE_LOST /* who would wait for ever */)
VULKAN_FAULTY(AllocateDescriptorSets, (VkDevice d, const VkDescriptorSetAllocateInfo *info, VkDescriptorSet *out),
              (d, info, out), (void)0)
VULKAN_FAULTY(AllocateMemory, (VkDevice d, const VkMemoryAllocateInfo *info, const VkAllocationCallbacks *a, VkDeviceMemory *out),
              (d, info, a, out), VULKAN_LEAVE(out);
              if (info->allocationSize > vulkan_largest || v->image_bytes_max >= vulkan_images_kept)
                  return vulkan_refusals++, vulkan_fault_AllocateMemory.result)
VULKAN_FAULTY(CreateComputePipelines, (VkDevice d, VkPipelineCache cache, uint32_t count, const VkComputePipelineCreateInfo *info,
              const VkAllocationCallbacks *a, VkPipeline *out), (d, cache, count, info, a, out), *out = VK_NULL_HANDLE;
              if (info->layout == *vulkan_refused) return vulkan_refusals++, VK_ERROR_UNKNOWN)
/* clang-format on */

/* After so many allocations of at most so many bytes a device has no memory left. */
static void vulkan_play_full(int allocations, VkDeviceSize largest)
{
    VULKAN_FAIL(AllocateMemory, allocations, -1, VK_ERROR_OUT_OF_DEVICE_MEMORY);
    vulkan_largest = largest, vulkan_images_kept = SIZE_MAX;
    vulkan_played = vulkan_refusals = 0;
}

static VKAPI_ATTR void VKAPI_CALL vulkan_play_destroy(VkDevice d, const VkAllocationCallbacks *a)
{
    vulkan_played++;
}

static uint32_t vulkan_parts[64][2]; /* pushed: begin and end of parts */
static int vulkan_part_count;

static VKAPI_ATTR void VKAPI_CALL vulkan_note_part(VkCommandBuffer commands, VkPipelineLayout layout,
                                                   VkShaderStageFlags stages, uint32_t offset, uint32_t size,
                                                   const void *push)
{
    if (vulkan_part_count < (int)OXL_COUNT(vulkan_parts))
        memcpy(vulkan_parts[vulkan_part_count++], (const char *)push + 4, 8);
    driver.CmdPushConstants(commands, layout, stages, offset, size, push);
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
    driver.CmdPushConstants(commands, layout, stages, offset, size, word);
}

static void vulkan_play_no_room(int on)
{
    v->CmdPushConstants = on ? vulkan_play_push : driver.CmdPushConstants;
    vulkan_counted = vulkan_halted = 0;
}

/* ---------------- scenes */

static double vulkan_random(uint64_t i, uint64_t k)
{
    return wide_random(7, i, k);
}

static float *vulkan_noise(size_t count, uint64_t seed)
{
    float *out = vulkan_memory(count, sizeof *out);
    for (size_t i = 0; i < count; i++) out[i] = (float)vulkan_random(i, seed);
    return out;
}

static uint8_t *vulkan_bytes(size_t count, uint64_t seed)
{
    uint8_t *out = vulkan_memory(count, 1);
    for (size_t i = 0; i < count; i++) out[i] = (uint8_t)random_bits(9, i, seed);
    return out;
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

static void vulkan_model(size_t count, int degree, size_t lobes, oxl_model *out)
{
    CHECK_OK(oxl_model_create(cpu, count, degree, out));
    CHECK_OK(model_set_lobes(cpu, out, lobes));
    memset(out->plane[OXL_ROTATION], 0, out->capacity * sizeof(float));
}

static void vulkan_place(oxl_model *m, size_t i, double x, double y, double z)
{
    const double at[3] = {x, y, z};
    for (int k = 0; k < 3; k++) m->plane[OXL_MEAN + k][i] = (float)at[k];
}

/* Gaussians in and around the view, from needles to plates; lobes for the first of them. */
static oxl_model vulkan_scene(size_t count, int degree, size_t lobes)
{
    oxl_model m;
    vulkan_model(count, degree, lobes, &m);
    for (size_t i = 0; i < count; i++) {
        vulkan_place(&m, i, 2.5 * vulkan_random(i, 0) - 1, 2 * vulkan_random(i, 1),
                     4 + 3.8 * vulkan_random(i, 2));
        for (uint64_t k = 0; k < 3; k++)
            m.plane[OXL_LOG_SCALE + k][i] = (float)(-2.5 + 1.2 * vulkan_random(i, 3 + k));
        for (uint64_t k = 0; k < 4; k++) m.plane[OXL_ROTATION + k][i] = (float)vulkan_random(i, 6 + k);
        m.plane[OXL_OPACITY][i] = (float)(3 * vulkan_random(i, 10));
        for (int k = OXL_SH; k < oxl_model_planes(&m); k++)
            m.plane[k][i] = (float)((k < OXL_SH + 3 ? 1 : 0.2) * vulkan_random(i, (uint64_t)k));
    }
    for (size_t i = 0; i < lobes; i++)
        for (int k = 0; k < MODEL_LOBE_PLANES; k++)
            m.plane[OXL_LOBE + k][i] = (float)(0.4 * vulkan_random(i, 100 + (uint64_t)k) - (k == 0));
    return m;
}

/* The corners of what a model may hold, and beyond. */
static void vulkan_extremes(oxl_model *m)
{
    static const float wild[] = {0,        -0.0f,     1e-38f, 1e-45f, 1e10f, -1e10f, 1e38f, -1e38f,
                                 INFINITY, -INFINITY, NAN,    88,     -88,   20,     -20};
    for (size_t i = 0; i < m->count; i += 3) {
        const uint64_t bits = random_bits(3, i, 0);
        m->plane[bits % OXL_SH][i] = wild[bits / 64 % OXL_COUNT(wild)];
        if (i % 2) m->plane[OXL_LOG_SCALE + bits % 3][i] = (float)(30 * vulkan_random(i, 9));
        if (i % 5 == 0) m->plane[OXL_OPACITY][i] = (float)(60 * vulkan_random(i, 8));
        for (int q = 0; q < 4 && i % 7 == 0; q++) m->plane[OXL_ROTATION + q][i] = 0;
    }
}

struct vulkan_twins { /* [0]: the CPU's, [1]: the device's */
    struct renderer *r[2];
    struct vulkan_renderer *d;
    oxl_camera camera;
    size_t pixels;
};

static struct vulkan_twins vulkan_twins(int width, int height)
{
    struct vulkan_twins t = {.camera = vulkan_camera(width, height), .pixels = (size_t)width * height};
    VULKAN_TWICE(k) t.r[k] = vulkan_renderer(vulkan_ctx(k));
    t.d = t.r[1]->device;
    return t;
}

static void vulkan_forward_both(struct vulkan_twins *t, const oxl_model *m)
{
    VULKAN_TWICE(k)
    CHECK_OK(renderer_forward(vulkan_ctx(k), t->r[k], m, &t->camera, &vulkan_options));
}

static oxl_result vulkan_draw_with(struct renderer *r, const oxl_model *m, const oxl_camera *camera)
{
    return renderer_forward(device, r, m, camera, &vulkan_options);
}

/* A copy of the image drawn last. */
static float *vulkan_image_of(oxl_context *ctx, struct renderer *r, size_t pixels)
{
    float *out = vulkan_memory(3 * pixels, sizeof *out);
    const float *image;
    CHECK_OK(renderer_image(r, &image));
    return memcpy(out, image, 3 * pixels * sizeof *out);
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

static void vulkan_compare_models(const oxl_model *a, const oxl_model *b, double bound)
{
    for (int k = 0; k < OXL_PLANES; k++)
        if (test_rows(a, k))
            CHECK_CLOSE(vulkan_distance(a->plane[k], b->plane[k], test_rows(a, k)).relative, 0, bound);
}

static void vulkan_same_trained(const struct trained_model *a, const struct trained_model *b)
{
    CHECK(test_same_model(&a->model, &b->model) && test_same_model(&a->mean, &b->mean));
    CHECK(test_same_model(&a->square, &b->square));
}

/* (rows) of the last view: which are seen; their splats. */
static uint32_t *vulkan_seen(struct vulkan_renderer *d)
{
    uint32_t *seen = vulkan_memory(d->count, sizeof *seen);
    vulkan_enter(v);
    vulkan_download(v, &d->seen, 0, seen, d->count * sizeof *seen);
    return seen;
}

static float *vulkan_splats(struct vulkan_renderer *d, const struct vulkan_buffer *from, size_t numbers)
{
    float *out = vulkan_memory(d->count, numbers * sizeof *out);
    vulkan_enter(v);
    vulkan_download(v, from, 0, out, d->count * numbers * sizeof *out);
    CHECK(v->rc == OXL_OK);
    return out;
}

static uint32_t *vulkan_starts(struct vulkan_renderer *d)
{
    uint32_t *start = vulkan_memory(d->tiles + 1, sizeof *start);
    vulkan_download(v, &d->start, 0, start, (d->tiles + 1) * sizeof *start);
    return start;
}

/* ---------------- runs */

struct vulkan_run { /* a model that is stepped against one image of 64 x 48 pixels, and what it takes */
    oxl_context *ctx;
    struct renderer *r;
    struct vulkan_renderer *d;
    oxl_camera camera;
    struct training_image image;
    struct trained_model trained;
    oxl_model gradient;
    struct renderer_sums sums;
    float *numbers; /* (4, count) of the sums */
    struct renderer_loss loss;
    struct renderer_nonfinite skipped;
    struct renderer_report report;
};

static struct vulkan_run vulkan_begin_run(oxl_context *ctx, size_t count, size_t lobes)
{
    struct vulkan_run r = {.ctx = ctx,
                           .r = vulkan_renderer(ctx),
                           .camera = vulkan_camera(64, 48),
                           .image = {64, 48, vulkan_bytes(3 * 64 * 48, 0), NULL},
                           .numbers = vulkan_memory(4 * count, sizeof(float)),
                           .trained.model = vulkan_scene(count, 1, lobes)};
    oxl_model *const rest[] = {&r.trained.mean, &r.trained.square, &r.gradient};
    for (size_t k = 0; k < OXL_COUNT(rest); k++) vulkan_model(count, 1, lobes, rest[k]);
    r.sums = (struct renderer_sums){
        count, 1, 3.5f, 5, r.numbers, r.numbers + count, r.numbers + 2 * count, r.numbers + 3 * count};
    r.d = r.r->device;
    return r;
}

static oxl_result vulkan_run_forward(struct vulkan_run *r)
{
    return renderer_forward(r->ctx, r->r, &r->trained.model, &r->camera, &vulkan_options);
}

/* Up to what Adam begins with. */
static void vulkan_half_step(struct vulkan_run *r)
{
    CHECK_OK(renderer_set_image(r->ctx, r->r, 0, &r->image, NULL, 0));
    CHECK_OK(vulkan_run_forward(r));
    CHECK_OK(renderer_loss(r->ctx, r->r, NULL, NULL, 0.2f, &r->loss));
    CHECK_OK(renderer_backward(r->ctx, r->r, NULL, &r->gradient));
}

static oxl_result vulkan_adam(struct vulkan_run *r, int step)
{
    oxl_adam adam = {.beta = {0.7, 0.9995}, .step = step};
    for (int k = 0; k < OXL_PLANES; k++) adam.rate[k] = 1e-3f;
    return renderer_step(r->ctx, r->r, &r->trained, &r->gradient, &adam, &r->skipped);
}

static void vulkan_steps(struct vulkan_run *r, int from, int to)
{
    for (int step = from; step <= to; step++) {
        vulkan_half_step(r);
        CHECK_OK(vulkan_adam(r, step));
        CHECK_OK(renderer_observe(r->ctx, r->r, &r->sums));
    }
}

static void vulkan_fetch(struct vulkan_run *r, enum renderer_download what)
{
    CHECK_OK(renderer_download(r->r, what));
}

/* The oldest step not yet reported: whether it is there, and how it halted. */
static int vulkan_reports(struct vulkan_run *r, int wait)
{
    CHECK_OK(renderer_report(r->r, wait, &r->report));
    return r->report.exists;
}

static void vulkan_same_run(const struct vulkan_run *a, const struct vulkan_run *b)
{
    vulkan_same_trained(&a->trained, &b->trained);
    CHECK(memcmp(a->numbers, b->numbers, 4 * a->sums.count * sizeof(float)) == 0);
}

/* ---------------- shaders, sort and scan */

/* A compiler that assumes numbers to be finite leaves out a test against a constant that it knows. */
DEVICE_TEST(vulkan_shaders_have_infinity_from_the_host)
{
    for (int pass = 0; pass < PASS_COUNT; pass++) {
        const uint32_t *word = VULKAN_PASSES[pass].words;
        size_t known = 0, read = 0;
        for (size_t i = 5; i < VULKAN_PASSES[pass].bytes / sizeof *word; i += word[i] >> 16, read++)
            known += (word[i] & 0xFFFF) == 43 /* OpConstant */ && word[i + 3] == VULKAN_INFINITY;
        CHECK(read > 100 && known == 0);
    }
}

static void vulkan_check_sort(size_t n, uint32_t mask)
{
    struct vulkan_renderer *r = vulkan_renderer(device)->device;
    const size_t most = n == 1 << 16 ? n : n + 9000; /* more groups than keys, or all of 32 are full */
    uint32_t *host = vulkan_memory(2 * n, sizeof *host), *got = host + n, count = (uint32_t)n;
    size_t wrong = 0;
    for (size_t i = 0; i < n; i++) host[i] = (uint32_t)random_bits(5, i, n) & mask, got[i] = (uint32_t)i;
    VULKAN_TWICE(k)
    {
        vulkan_reserve(v, &r->row_key[k], n, 4, "keys");
        vulkan_reserve(v, &r->row_value[k], n, 4, "keys");
    }
    vulkan_reserve(v, &r->histogram, VULKAN_DIGITS * vulkan_chunks(most), 4, "keys");
    vulkan_upload(v, &r->row_key[0], 0, host, 4 * n);
    vulkan_upload(v, &r->row_value[0], 0, got, 4 * n);
    vulkan_update(v, &r->counts, COUNT_VISIBLE * 4, &count, 4);
    int end = vulkan_sort(r, r->row_key, r->row_value, COUNT_VISIBLE, most, 32);
    vulkan_download(v, &r->row_value[end], 0, got, 4 * n);
    for (size_t i = 1; i < n; i++) {
        const uint32_t a = got[i - 1], b = got[i];
        wrong += host[a] > host[b] || (host[a] == host[b] && a >= b);
    }
    CHECK(v->rc == OXL_OK && wrong == 0);
}

DEVICE_TEST(vulkan_sorts_stably_whatever_the_number_of_keys)
{
    static const size_t sizes[] = {1, 2047, 2048, 2049, 1 << 16, 70001};
    for (size_t k = 0; k < OXL_COUNT(sizes); k++)
        vulkan_check_sort(sizes[k], k % 2 ? 0x00F0000F : 0xFFFFFFFF);
}

DEVICE_TEST(vulkan_adds_up_prefixes_whatever_their_number)
{
    static const size_t sizes[] = {1, 2048, 2049, VULKAN_SCAN_WHOLE, VULKAN_SCAN_WHOLE + 1, 90000};
    struct vulkan_renderer *r = vulkan_renderer(device)->device;
    for (size_t k = 0; k < OXL_COUNT(sizes); k++) {
        const size_t n = sizes[k];
        uint32_t *in = vulkan_memory(2 * n, sizeof *in), *out = in + n, total = 0, sum = 0;
        size_t wrong = 0;
        for (size_t i = 0; i < n; i++) in[i] = (uint32_t)(random_bits(6, i, n) % 7);
        vulkan_reserve(v, &r->seen, n, 4, "numbers");
        vulkan_reserve(v, &r->scan_sums, vulkan_chunks(n), 4, "numbers");
        vulkan_upload(v, &r->seen, 0, in, 4 * n);
        vulkan_scan(r, &r->seen, n, COUNT_PAIRS, UINT32_MAX);
        vulkan_download(v, &r->seen, 0, out, 4 * n);
        vulkan_download(v, &r->counts, 4 * COUNT_PAIRS, &total, 4);
        for (size_t i = 0; i < n; i++) wrong += out[i] != sum, sum += in[i];
        CHECK(v->rc == OXL_OK && wrong == 0 && total == sum);
    }
}

/* ---------------- forward */

/* Which rows are seen, but for those on the very edge, and their splats. */
static void vulkan_compare_rows(struct vulkan_twins *t, size_t count)
{
    const struct vulkan_buffer *from[] = {&t->d->splat_a, &t->d->splat_b, &t->d->splat_c};
    const uint32_t *seen = vulkan_seen(t->d);
    size_t other = 0, both = 0;
    for (int part = 0; part < 3; part++) {
        const float *got = vulkan_splats(t->d, from[part], 4);
        for (size_t i = 0; i < count; i++) {
            const struct splat *s = &t->r[0]->splat[i];
            const float want[3][4] = {{s->u, s->v, s->a, s->k},
                                      {s->e, s->peak, s->half_x, s->half_y},
                                      {s->colour[0], s->colour[1], s->colour[2], s->depth}};
            other += renderer_row_visible(t->r[0], i) != (seen[i] != 0);
            if (!renderer_row_visible(t->r[0], i) || !seen[i]) continue;
            both++;
            for (int k = 0; k < 4; k++)
                if (want[part][k] == want[part][k])
                    CHECK_CLOSE(got[4 * i + k], want[part][k],
                                (part == 0 && k < 2 ? 1e-4 : 2e-3) * (1 + fabsf(want[part][k])));
        }
    }
    CHECK(other * 1000 <= 3 * count && both > 0);
}

/* A pixel at the threshold of alpha may go either way: at most a few, and by so much. */
static void vulkan_compare_images(struct vulkan_twins *t, double relative, double most)
{
    const struct vulkan_distance d = vulkan_distance(
        vulkan_image_of(cpu, t->r[0], t->pixels), vulkan_image_of(device, t->r[1], t->pixels), 3 * t->pixels);
    CHECK_CLOSE(d.relative, 0, relative);
    CHECK_CLOSE(d.most, 0, most);
}

static void vulkan_draw_both(struct vulkan_twins *t, const oxl_model *m)
{
    vulkan_forward_both(t, m);
    vulkan_compare_images(t, 2e-4, 2.0 / 255);
}

DEVICE_TEST(vulkan_renders_depths_as_the_cpu_does)
{
    const oxl_camera camera = vulkan_camera(60, 45);
    oxl_model m = vulkan_scene(300, 0, 0);
    float depth[2][60 * 45];
    VULKAN_TWICE(k)
    {
        oxl_image image;
        CHECK_OK(oxl_render(vulkan_ctx(k), &m, &camera, NULL, &image, depth[k]));
        oxl_image_free(vulkan_ctx(k), &image);
    }
    CHECK_CLOSE(vulkan_distance(depth[0], depth[1], OXL_COUNT(depth[0])).relative, 0, 2e-4);
}

/* ---------------- any device */

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
    memset(out, 0, 2 * sizeof *out);
    strcpy(out[0].extensionName, "VK_KHR_portability_enumeration");
    strcpy(out[1].extensionName, "VK_KHR_get_physical_device_properties2");
    *count = 2;
    return VK_SUCCESS;
}

static VKAPI_ATTR VkResult VKAPI_CALL vulkan_play_device_list(VkPhysicalDevice d, const char *layer,
                                                              uint32_t *count, VkExtensionProperties *out)
{
    memset(out, 0, sizeof *out);
    strcpy(out[0].extensionName, "VK_KHR_portability_subset");
    *count = 1;
    return VK_SUCCESS;
}

static VKAPI_ATTR VkResult VKAPI_CALL vulkan_play_instance(const VkInstanceCreateInfo *info,
                                                           const VkAllocationCallbacks *a, VkInstance *out)
{
    VULKAN_LEAVE(out);
    vulkan_seen_flags = info->flags;
    vulkan_note_names(info->ppEnabledExtensionNames, info->enabledExtensionCount);
    return VK_ERROR_INCOMPATIBLE_DRIVER;
}

/* As MoltenVK: listed only on request of portability drivers, and usable when the subset is enabled. */
DEVICE_TEST(vulkan_uses_portability_drivers)
{
    struct vulkan other = {.ctx = device,
                           .EnumerateInstanceExtensionProperties = vulkan_play_instance_list,
                           .EnumerateDeviceExtensionProperties = vulkan_play_device_list,
                           .CreateInstance = vulkan_play_instance};
    struct vulkan_extensions extensions = {0};
    CHECK(vulkan_make_instance(&other, NULL) == VK_ERROR_INCOMPATIBLE_DRIVER);
    CHECK(vulkan_seen_flags == VK_INSTANCE_CREATE_ENUMERATE_PORTABILITY_BIT_KHR);
    CHECK_TEXT(vulkan_seen_names, "VK_KHR_portability_enumeration");
    CHECK_TEXT(vulkan_seen_names, "VK_KHR_get_physical_device_properties2");
    vulkan_device_extensions(&other, &extensions);
    vulkan_note_names(extensions.name, extensions.enabled);
    CHECK_TEXT(vulkan_seen_names, "VK_KHR_portability_subset");
    oxl_free(device, extensions.there);
}

static int vulkan_real_ones;
#define VULKAN_BROKEN ((VkPhysicalDevice)(uintptr_t)16)

static VKAPI_ATTR VkResult VKAPI_CALL vulkan_play_two(VkInstance instance, uint32_t *count,
                                                      VkPhysicalDevice *out)
{
    out[0] = VULKAN_BROKEN, out[1] = driver.physical;
    *count = 1 + (uint32_t)vulkan_real_ones;
    return VK_SUCCESS;
}

static VKAPI_ATTR void VKAPI_CALL vulkan_play_properties(VkPhysicalDevice d, VkPhysicalDeviceProperties *out)
{
    driver.GetPhysicalDeviceProperties(driver.physical, out);
    if (d != VULKAN_BROKEN) return;
    out->deviceType = VK_PHYSICAL_DEVICE_TYPE_DISCRETE_GPU;
    strcpy(out->deviceName, "Broken GPU");
}

static VKAPI_ATTR void VKAPI_CALL vulkan_play_heaps(VkPhysicalDevice d, VkPhysicalDeviceMemoryProperties *out)
{
    driver.GetPhysicalDeviceMemoryProperties(driver.physical, out);
}

static VKAPI_ATTR void VKAPI_CALL vulkan_play_families(VkPhysicalDevice d, uint32_t *count,
                                                       VkQueueFamilyProperties *out)
{
    driver.GetPhysicalDeviceQueueFamilyProperties(driver.physical, count, out);
}

static VKAPI_ATTR VkResult VKAPI_CALL vulkan_play_device(VkPhysicalDevice d, const VkDeviceCreateInfo *info,
                                                         const VkAllocationCallbacks *a, VkDevice *out)
{
    VULKAN_LEAVE(out);
    if (d == VULKAN_BROKEN) return VK_ERROR_INITIALIZATION_FAILED;
    return driver.CreateDevice(driver.physical, info, a, out);
}

/* The best device cannot be opened: the next one is, and what is said names both and why. The last one's
 * error stays; of a device that is named there is no next. */
DEVICE_TEST(vulkan_opens_the_next_device_where_the_best_cannot_be)
{
    struct vulkan other = *v;
    memset((char *)&other + offsetof(struct vulkan, physical), 0,
           sizeof other - offsetof(struct vulkan, physical));
    other.EnumeratePhysicalDevices = vulkan_play_two;
    other.GetPhysicalDeviceProperties = vulkan_play_properties;
    other.GetPhysicalDeviceMemoryProperties = vulkan_play_heaps;
    other.GetPhysicalDeviceQueueFamilyProperties = vulkan_play_families;
    other.EnumerateDeviceExtensionProperties = vulkan_play_device_list;
    other.properties2 = 0;
    other.CreateDevice = vulkan_play_device;
    vulkan_real_ones = 1;
    vulkan_listen(": trying ");
    CHECK_OK(vulkan_open_best(&other, -1, 1));
    CHECK(other.physical == driver.physical && other.mapped && other.staging.handle && other.frame[1].fence &&
          vulkan_times_heard == 1);
    CHECK_TEXT(vulkan_heard, "Broken GPU, a device: it could not be started");
    CHECK_TEXT(vulkan_heard, driver.properties.deviceName);
    vulkan_close_device(&other);
    CHECK(!other.device && !other.staging.handle);
    CHECK(vulkan_open_best(&other, 0, 1) == OXL_ERR_FAILED && !other.device);
    vulkan_close_device(&other);
    vulkan_real_ones = 0;
    REFUSED(vulkan_open_best(&other, -1, 1), OXL_ERR_FAILED, "Broken GPU, a device: it could not be started");
}

/* 16384 bytes is what Vulkan 1.0 promises of any device, and counts as std430 lays arrays out. */
DEVICE_TEST(vulkan_shaders_fit_the_least_shared_memory)
{
    CHECK(vulkan_shared() <= 16384);
    CHECK(SPIRV_LOSS_TOTAL_SHARED == 256 * (16 + 8)); /* a vec3 of an array takes 16 bytes */
}

/* ---------------- loss and images */

static void vulkan_compare_sums(const double *x, const double *y, int count, double bound)
{
    double most = 0;
    for (int k = 0; k < count; k++) most = OXL_MAX(most, fabs(x[k]));
    CHECK(most > 1e-9);
    for (int k = 0; k < count; k++) CHECK_CLOSE(y[k], x[k], bound * most);
}

static void vulkan_compare_losses(const struct renderer_loss loss[2], int has_ssim)
{
    CHECK_CLOSE(loss[1].l1, loss[0].l1, 1e-5);
    if (has_ssim) CHECK_CLOSE(loss[1].ssim, loss[0].ssim, 1e-5);
    CHECK_CLOSE(loss[1].mse, loss[0].mse, 1e-5);
    CHECK_CLOSE(loss[1].total, loss[0].total, 1e-5);
}

static const float vulkan_gain[3] = {1.3f, 0.6f, 1.1f};

/* An image is compared as the bytes that it is, whole, a window of it, or at half the sides, kept on the
 * device or passing through. */
static void vulkan_check_image(int width, int height, int masked, int halved,
                               const struct image_window *window)
{
    struct vulkan_twins t = vulkan_twins((window ? window->width : width) >> halved,
                                         (window ? window->height : height) >> halved);
    const size_t pixels = (size_t)width * height;
    const size_t stays = (3 * pixels + 3) / 4 * 4 + (masked ? (pixels + 3) / 4 * 4 : 0); /* whole words */
    const int keeps = v->image_bytes_max > 0;
    uint8_t *bytes = vulkan_bytes(4 * pixels, 0);
    struct training_image image = {width, height, bytes, masked ? bytes + 3 * pixels : NULL};
    struct renderer_loss loss[2];
    oxl_model m = vulkan_scene(200, 0, 0);
    for (size_t i = 3 * pixels; i < 4 * pixels; i++) bytes[i] = i % 97 ? 255 : 0;
    VULKAN_TWICE(round)
    {
        vulkan_forward_both(&t, &m);
        VULKAN_TWICE(k)
        {
            CHECK_OK(renderer_set_image(vulkan_ctx(k), t.r[k], 3,
                                        k && renderer_has_image(t.r[1], 3) ? NULL : &image, window, halved));
            CHECK_OK(renderer_loss(vulkan_ctx(k), t.r[k], NULL, NULL, 0.2f, &loss[k]));
        }
        vulkan_compare_losses(loss, 1);
    }
    CHECK(t.d->image_bytes == (keeps ? stays : 0));
    CHECK(renderer_has_image(t.r[1], 3) == keeps && !renderer_has_image(t.r[1], 2));
}

DEVICE_TEST(vulkan_compares_with_images_as_the_cpu_does)
{
    vulkan_check_image(41, 33, 1, 0, NULL);
    vulkan_check_image(81, 65, 1, 1, NULL);
    vulkan_check_image(41, 33, 0, 0, NULL);
    v->image_bytes_max = 0;
    vulkan_check_image(40, 31, 0, 0, NULL);
}

static void vulkan_compare_mean2d(struct vulkan_twins *t, size_t count)
{
    const uint32_t *seen = vulkan_seen(t->d);
    const float *d = vulkan_splats(t->d, &t->d->mean2d, 1);
    for (size_t i = 0; i < count; i++)
        if (renderer_row_visible(t->r[0], i) && seen[i])
            CHECK_CLOSE(d[i], t->r[0]->dmean2d[i], 1e-2 * t->r[0]->dmean2d[i] + 1e-6);
}

static const struct medium vulkan_murky = {
    1, {0.10f, 0.05f, 0.03f}, {0.12f, 0.08f, 0.06f}, {0.1f, 0.3f, 0.5f}, 1.5f};

/* Statistics of density control of both. */
static void vulkan_compare_observed(struct vulkan_twins *t, size_t count)
{
    float *numbers[2];
    VULKAN_TWICE(k)
    {
        float *at = numbers[k] = vulkan_memory(4 * count, sizeof *at);
        const struct renderer_sums sums = {count, 1, 3.5f, 5, at, at + count, at + 2 * count, at + 3 * count};
        CHECK_OK(renderer_observe(vulkan_ctx(k), t->r[k], &sums));
        CHECK_OK(renderer_download(t->r[k], DOWNLOAD_TO_READ));
    }
    CHECK_CLOSE(vulkan_distance(numbers[0], numbers[1], 3 * count).relative, 0, 1e-2);
    CHECK_CLOSE(vulkan_distance(numbers[0] + 3 * count, numbers[1] + 3 * count, count).most, 0, 0);
}

/* ---------------- a view on both: every shader beside its twin */

/* What is rendered, and how near the device comes to the CPU; 0: the usual. */
struct vulkan_case {
    size_t count, lobes;
    int degree, width, height;
    double image, most, gradient; /* bounds: of the image as a vector and of a pixel, of gradients */
    double ssim, contrast, dropout;
    float alpha_min;
    int antialias, wild, hidden, crowded; /* crowded: tiles of many buckets; 2: which end within a batch */
    int masked, lit, points, window, slabs;
    const float *gain;
    const struct medium *medium;
    const oxl_model *surroundings;
};

static oxl_model vulkan_model_of(const struct vulkan_case *c)
{
    oxl_model m = vulkan_scene(c->count ? c->count : 700, c->degree, c->lobes);
    m.antialias = c->antialias;
    if (c->wild) vulkan_extremes(&m);
    for (size_t i = 0; i < m.count; i++) {
        if (c->hidden) m.plane[OXL_MEAN + 2][i] = -50; /* behind the camera */
        if (c->crowded) m.plane[OXL_OPACITY][i] += c->crowded == 2 ? 2 : -4;
        for (int q = 0; c->crowded && q < 3; q++) m.plane[OXL_LOG_SCALE + q][i] += 1;
        for (int k = OXL_SH; c->wild && k < oxl_model_planes(&m); k++)
            if (!(fabsf(m.plane[k][i]) < 10)) m.plane[k][i] = 0;
    }
    return m;
}

/* Loss, and gradients of everything, of one renderer. */
static struct renderer_loss vulkan_view_of(const struct vulkan_case *c, oxl_context *ctx, struct renderer *r,
                                           const oxl_camera *camera, const float *target, const float *weight,
                                           const oxl_model *m, oxl_model *gradient)
{
    struct lamp lamp = {.view = -1};
    struct depth_point point[DEPTH_POINTS];
    struct renderer_loss loss;
    for (int k = 0; k < LAMP_TERMS; k++) lamp.shape[k] = 0.3f * (float)vulkan_random((uint64_t)k, 70);
    for (int k = 0; k < c->points; k++)
        point[k] = (struct depth_point){(float)(0.5 + 45 * (1 + vulkan_random((uint64_t)k, 71))),
                                        (float)(0.5 + 30 * (1 + vulkan_random((uint64_t)k, 72))),
                                        (float)(5 + 2 * vulkan_random((uint64_t)k, 73))};
    renderer_set_surroundings(r, c->surroundings);
    *renderer_settings(r) = (struct renderer_settings){
        .steps = 1,
        .window = {c->window ? 2 * camera->width : 0, c->window ? 2 * camera->height : 0, 24, 16},
        .medium = c->medium ? *c->medium : (struct medium){0},
        .lamp = c->lit ? &lamp : NULL,
        .gain = c->gain,
        .contrast = c->contrast,
        .dropout = {c->dropout, UINT64_C(0x123456789abcdef), 77}};
    CHECK_OK(renderer_forward(ctx, r, m, camera, &vulkan_options));
    CHECK_OK(renderer_loss(ctx, r, target, c->masked ? weight : NULL, (float)c->ssim, &loss));
    if (r->device)
        vulkan_fill(v, &((struct vulkan_renderer *)r->device)->sums_a, 0, VK_WHOLE_SIZE, VULKAN_INFINITY);
    renderer_set_depths(r, point, c->points, 1);
    vulkan_model(m->count, c->degree, m->lobes, gradient);
    CHECK_OK(renderer_backward(ctx, r, NULL, gradient));
    CHECK_OK(renderer_gradient(r, gradient));
    renderer_complete_loss(r, &loss);
    return loss;
}

static void vulkan_compare_scores(struct vulkan_twins *t, const oxl_model *m)
{
    const float *drgb = vulkan_noise(3 * t->pixels, 51);
    float *score[2];
    VULKAN_TWICE(k)
    {
        score[k] = vulkan_memory(m->count, sizeof *score[k]);
        CHECK_OK(renderer_score(vulkan_ctx(k), t->r[k], drgb, score[k]));
    }
    CHECK_CLOSE(vulkan_distance(score[0], score[1], m->count).relative, 0, 1e-3);
}

static void vulkan_check_view(struct vulkan_case c)
{
    struct vulkan_twins t = vulkan_twins(c.width ? c.width : 90, c.height ? c.height : 60);
    const oxl_model m = vulkan_model_of(&c);
    float *target = vulkan_noise(3 * t.pixels, 60), *weight = vulkan_noise(t.pixels, 61);
    float *drgb = vulkan_memory(3 * t.pixels, sizeof *drgb);
    struct renderer_loss loss[2];
    oxl_model gradient[2];
    uint32_t crowd = 0;
    c.ssim = c.ssim > 0 ? c.ssim : c.ssim < 0 ? 0 : 0.2; /* below 0: none */
    vulkan_options.alpha_min = c.alpha_min > 0 ? c.alpha_min : oxl_render_options_default().alpha_min;
    v->slab_rows = c.slabs ? 256 : driver.slab_rows, v->groups_max = c.slabs ? 9 : driver.groups_max;
    for (size_t i = 0; i < 3 * t.pixels; i++) target[i] = 0.5f + 0.4f * target[i];
    for (size_t i = 0; i < t.pixels; i++) weight[i] = weight[i] > -0.98f; /* a fiftieth is masked */
    VULKAN_TWICE(k)
    loss[k] = vulkan_view_of(&c, vulkan_ctx(k), t.r[k], &t.camera, target, weight, &m, &gradient[k]);
    vulkan_compare_images(&t, c.image > 0 ? c.image : 2e-4, c.most > 0 ? c.most : 2.0 / 255);
    vulkan_compare_losses(loss, c.ssim > 0);
    vulkan_download(v, &t.d->drgb, 0, drgb, 3 * t.pixels * sizeof *drgb);
    CHECK_CLOSE(vulkan_distance(t.r[0]->drgb, drgb, 3 * t.pixels).relative, 0, 1e-3);
    if (c.lit) vulkan_compare_sums(loss[0].dlamp, loss[1].dlamp, LAMP_TERMS, 2e-3);
    if (c.gain) vulkan_compare_sums(loss[0].dlog_gain, loss[1].dlog_gain, 3, 2e-3);
    if (c.hidden) return;
    const uint32_t *start = vulkan_starts(t.d);
    CHECK_CLOSE((double)t.d->pairs, (double)t.r[0]->bins.pair_count, 3);
    for (size_t i = 0; i < t.d->tiles; i++) crowd = OXL_MAX(crowd, start[i + 1] - start[i]);
    CHECK(!c.crowded || crowd > 4 * VULKAN_BUCKET);
    vulkan_compare_rows(&t, m.count);
    if (c.wild) return;
    vulkan_compare_models(&gradient[0], &gradient[1], c.gradient > 0 ? c.gradient : 5e-3);
    vulkan_compare_mean2d(&t, m.count);
    vulkan_compare_observed(&t, m.count);
    if (!c.surroundings) vulkan_compare_scores(&t, &m);
}

#define VULKAN_COMPARE(...) vulkan_check_view((struct vulkan_case){__VA_ARGS__})

DEVICE_TEST(vulkan_projects_and_renders_as_the_cpu_does_at_the_extremes_too)
{
    for (int antialias = 0; antialias < 2; antialias++) {
        VULKAN_COMPARE(.count = 1500, .degree = 3, .lobes = 200, .width = 150, .height = 101,
                       .antialias = antialias);
        VULKAN_COMPARE(.count = 1500, .degree = 3, .lobes = 200, .wild = 1, .antialias = antialias);
    }
    VULKAN_COMPARE(.count = 5, .hidden = 1);
    for (size_t lobes = 0; lobes <= 400; lobes += 400)
        VULKAN_COMPARE(.degree = 1, .lobes = lobes, .alpha_min = 0.06f, .image = 1e-3, .most = 0.06,
                       .gradient = 0.05);
}

DEVICE_TEST(vulkan_gradients_agree_in_tiles_of_many_buckets)
{
    for (int k = 0; k < 4; k++)
        VULKAN_COMPARE(.count = 5000, .crowded = 1 + k / 2, .lobes = k % 2 ? 2000 : 0);
}

DEVICE_TEST(vulkan_loss_and_its_gradient_agree_with_the_cpus)
{
    VULKAN_COMPARE(.width = 70, .height = 43, .masked = 1);
    VULKAN_COMPARE(.width = 33, .height = 20, .masked = 1, .ssim = -1);
    VULKAN_COMPARE(.width = 7, .height = 5, .ssim = 1, .gradient = 0.05); /* than a window */
    VULKAN_COMPARE(.width = 70, .height = 43, .masked = 1, .gain = vulkan_gain);
}

DEVICE_TEST(vulkan_has_medium_lamp_gains_dropout_and_points_of_the_cpu)
{
    VULKAN_COMPARE(.medium = &vulkan_murky, .degree = 2, .slabs = 1);
    VULKAN_COMPARE(.medium = &vulkan_murky, .lit = 1, .lobes = 300);
    VULKAN_COMPARE(.lit = 1, .gain = vulkan_gain);
    VULKAN_COMPARE(.lit = 1, .contrast = 0.004);
    VULKAN_COMPARE(.lit = 1, .gain = vulkan_gain, .window = 1);
    VULKAN_COMPARE(.dropout = 0.4, .lobes = 200);
    VULKAN_COMPARE(.dropout = 0.2, .medium = &vulkan_murky);
    VULKAN_COMPARE(.points = DEPTH_POINTS);
    VULKAN_COMPARE(.points = 40, .medium = &vulkan_murky, .lobes = 200);
}

/* ---------------- steps */

/* The first step of Adam has the sign of the gradient: where that is next to nothing the signs may differ. */
DEVICE_TEST(vulkan_steps_and_statistics_agree_with_the_cpus)
{
    v->slab_rows = 256; /* several slabs */
    for (size_t lobes = 0; lobes <= 300; lobes += 300) {
        struct vulkan_run run[2];
        VULKAN_TWICE(k)
        {
            run[k] = vulkan_begin_run(vulkan_ctx(k), 600, lobes);
            vulkan_steps(&run[k], 1, 3);
            CHECK(run[k].skipped.rows == 0);
            vulkan_fetch(&run[k], DOWNLOAD_TO_CHANGE);
        }
        vulkan_compare_models(&run[0].trained.model, &run[1].trained.model, 1e-3);
        vulkan_compare_models(&run[0].trained.mean, &run[1].trained.mean, 5e-3);
        vulkan_compare_models(&run[0].trained.square, &run[1].trained.square, 5e-3);
        for (int k = 0; k < 3; k++)
            CHECK_CLOSE(vulkan_distance(run[0].numbers + 600 * k, run[1].numbers + 600 * k, 600).relative, 0,
                        5e-3);
        CHECK_CLOSE(vulkan_distance(run[0].sums.views, run[1].sums.views, 600).most, 0, 3);
    }
}

/* After a loss that is not finite: of three rows one holds such a number unseen, one makes such a colour, one
 * holds one among its lobes. They are cleared as on the CPU, and 12 bytes are read. */
DEVICE_TEST(vulkan_clears_nonfinite_rows_after_such_a_loss)
{
    struct vulkan_run run[2];
    struct renderer_nonfinite cleared[2];
    v->slab_rows = 256;
    VULKAN_TWICE(k)
    {
        run[k] = vulkan_begin_run(vulkan_ctx(k), 600, 300);
        struct trained_model *t = &run[k].trained;
        vulkan_place(&t->model, 400, -1.5, -1.5, 2.6);
        for (int i = 0; i < 3; i++) t->model.plane[OXL_LOG_SCALE + i][400] = 0;
        for (int i = 0; i < 4; i++)
            t->model.plane[OXL_SH + 3 * i + 2][400] = 3.4e38f; /* their sum is no float */
        t->model.plane[OXL_MEAN + 2][500] = -50;
        t->model.plane[OXL_SH + 5][500] = NAN;
        t->model.plane[OXL_LOBE + 1][200] = INFINITY;
        t->mean.plane[OXL_LOG_SCALE][500] = 1;
        t->square.plane[OXL_LOBE + 1][200] = 1;
        t->square.plane[OXL_OPACITY][201] = 1;
        CHECK_OK(vulkan_run_forward(&run[k]));
    }
    cleared[0] = nonfinite_clear(run[0].r, &run[0].trained);
    size_t before = v->read_bytes;
    CHECK_OK(renderer_clear_nonfinite(run[1].r, &run[1].trained, &cleared[1]));
    CHECK(v->read_bytes - before == 12);
    VULKAN_TWICE(k)
    CHECK(cleared[k].rows == 3 && cleared[k].cleared == 3);
    vulkan_fetch(&run[1], DOWNLOAD_TO_READ);
    vulkan_same_trained(&run[0].trained, &run[1].trained);
}

/* ---------------- deferred steps */

/* The same losses, one step late, and the same model; the host never waits for a device that has nothing else
 * to do. */
DEVICE_TEST(vulkan_deferred_steps_are_the_same_steps_without_waits)
{
    struct vulkan_run d[2] = {vulkan_begin_run(device, 300, 100), vulkan_begin_run(device, 300, 100)};
    struct renderer_loss loss[7];
    size_t waits = 0, dispatches = 0;
    for (int step = 1; step <= 6; step++) vulkan_steps(&d[0], step, step), loss[step] = d[0].loss;
    CHECK(renderer_defer(d[1].r, 1));
    for (int step = 1; step <= 7; step++) {
        if (step == 2) waits = v->waits, dispatches = v->dispatches;
        if (step == 7) CHECK(v->waits == waits && v->dispatches - dispatches <= 5 * 40);
        if (step < 7) vulkan_steps(&d[1], step, step);
        CHECK(vulkan_reports(&d[1], step == 7) == (step > 1));
        CHECK(d[1].report.halt == HALT_NONE && d[1].report.skipped.rows == 0);
        if (step > 1)
            CHECK(d[1].report.loss.total == loss[step - 1].total &&
                  d[1].report.loss.mse == loss[step - 1].mse);
    }
    CHECK(!vulkan_reports(&d[1], 1));
    VULKAN_TWICE(k) vulkan_fetch(&d[k], DOWNLOAD_TO_CHANGE);
    vulkan_same_run(&d[0], &d[1]);
}

/* A step without room for its pairs, or whose loss is not finite: neither it nor the one behind it changes
 * anything, and what the host then sees are its rows. */
DEVICE_TEST(vulkan_steps_behind_one_that_cannot_be_done_change_nothing)
{
    for (int halt = HALT_PAIRS; halt <= HALT_LOSS; halt++) {
        struct vulkan_run d[2];
        VULKAN_TWICE(k)
        {
            d[k] = vulkan_begin_run(device, 300, 100);
            vulkan_steps(&d[k], 1, 2);
            vulkan_fetch(&d[k], DOWNLOAD_TO_CHANGE);
            vulkan_place(&d[k].trained.model, 40, -1, -1, 4);
            if (halt == HALT_LOSS) d[k].trained.model.plane[OXL_SH][40] = INFINITY;
        }
        struct vulkan_renderer *r = d[1].d;
        CHECK(renderer_defer(d[1].r, 1));
        vulkan_take_model(r, &d[1].trained.model);
        r->room = halt == HALT_PAIRS ? 100 : 2 * r->pairs;
        vulkan_steps(&d[1], 3, 3);
        r->room = 2 * r->pairs;
        d[1].camera.translation[0] += 50; /* sees nothing */
        vulkan_steps(&d[1], 4, 4);
        d[1].camera = d[0].camera;
        CHECK(vulkan_reports(&d[1], 1) && (int)d[1].report.halt == halt);
        if (halt == HALT_PAIRS)
            CHECK(r->report[0].counts[COUNT_PAIRS] == 0 && r->report[0].counts[COUNT_PAIRS_FOUND] > 100);
        CHECK(!vulkan_reports(&d[1], 1));
        renderer_defer(d[1].r, 0);
        CHECK(vulkan_seen(r)[40] &&
              (vulkan_splats(r, &r->splat_c, 4)[160] < INFINITY) == (halt == HALT_PAIRS));
        vulkan_fetch(&d[1], DOWNLOAD_TO_READ);
        vulkan_same_run(&d[0], &d[1]);
        vulkan_steps(&d[1], 3, 3); /* the next one does */
        vulkan_fetch(&d[1], DOWNLOAD_TO_READ);
        if (halt == HALT_PAIRS)
            CHECK(memcmp(d[0].trained.model.plane[OXL_MEAN], d[1].trained.model.plane[OXL_MEAN],
                         300 * sizeof(float)) != 0);
    }
}

/* A deferred step without room is given up for another reason, before it has a report: the next step is done
 * all the same. */
DEVICE_TEST(vulkan_steps_behind_one_that_was_given_up_are_done)
{
    struct vulkan_run d[2];
    VULKAN_TWICE(k)
    {
        d[k] = vulkan_begin_run(device, 300, 100);
        vulkan_steps(&d[k], 1, 1);
        if (k) {
            CHECK(renderer_defer(d[k].r, 1));
            d[k].d->room = 100;
            CHECK_OK(vulkan_run_forward(&d[k]));
            renderer_defer(d[k].r, 0);
        }
        vulkan_steps(&d[k], 2, 2);
        vulkan_fetch(&d[k], DOWNLOAD_TO_READ);
    }
    vulkan_same_run(&d[0], &d[1]);
}

/* Bytes between host and device: a checkpoint reads and sends nothing again, a row that is not finite costs
 * nothing more. */
DEVICE_TEST(vulkan_reads_what_it_needs_and_sends_nothing_twice)
{
    const size_t model = 300 * 23 * 4 + 100 * 4 * 4, statistics = 300 * 16, counts = 4 + 32 + 12;
    struct vulkan_run d = vulkan_begin_run(device, 300, 100);
    oxl_model *m = &d.trained.model;
    size_t sent, before;
    vulkan_steps(&d, 1, 2);
    before = v->read_bytes, sent = v->sent;
    vulkan_fetch(&d, DOWNLOAD_TO_READ);
    CHECK(v->read_bytes - before == 3 * model + statistics);
    for (int step = 3; step <= 5; step++) {
        before = v->read_bytes;
        if (step == 5) sent = v->sent;
        vulkan_steps(&d, step, step);
        CHECK(d.skipped.rows == (step == 4));
        if (step != 4) CHECK(v->read_bytes - before == counts && v->sent == sent);
        if (step != 3) continue;
        vulkan_fetch(&d, DOWNLOAD_TO_CHANGE);
        vulkan_place(m, 40, -1, -1, 4);
        d.trained.mean.plane[OXL_SH][40] = m->plane[OXL_SH + 5][40] = NAN;
    }
    vulkan_fetch(&d, DOWNLOAD_TO_READ);
    CHECK(m->plane[OXL_SH + 5][40] == 0 && m->plane[OXL_ROTATION][40] == 1 &&
          m->plane[OXL_OPACITY][40] == -30 && d.trained.mean.plane[OXL_SH][40] == 0);
}

/* ---------------- what goes wrong */

/* What the host has of the model, and so what the next checkpoint would hold, stays as it was. No other call
 * goes to the device. */
static void vulkan_check_given_up(struct vulkan_run *run, int calls, const char *words)
{
    float *before = vulkan_memory(run->trained.model.count, sizeof *before);
    const float *image;
    memcpy(before, run->trained.model.plane[OXL_MEAN], run->trained.model.count * sizeof *before);
    vulkan_played = 0;
    REFUSED(renderer_download(run->r, DOWNLOAD_TO_CHANGE), OXL_ERR_FAILED, words);
    CHECK_TEXT(oxl_error_text(device), "fix: run the command again");
    CHECK(memcmp(before, run->trained.model.plane[OXL_MEAN], run->trained.model.count * sizeof *before) == 0);
    CHECK(vulkan_played == calls);
    vulkan_played = 0;
    VULKAN_FAIL(QueueSubmit, 0, -1, VK_ERROR_DEVICE_LOST);
    VULKAN_FAIL(WaitForFences, 0, -1, VK_ERROR_DEVICE_LOST);
    v->DestroyDevice = vulkan_play_destroy;
    CHECK(vulkan_run_forward(run) == OXL_ERR_FAILED && renderer_image(run->r, &image) == OXL_ERR_FAILED);
    vulkan_close_now();
    CHECK(vulkan_played == 0);
}

static int vulkan_stopped_listening;

static VKAPI_ATTR PFN_vkVoidFunction VKAPI_CALL vulkan_note_lookup(VkInstance instance, const char *name)
{
    vulkan_stopped_listening += strcmp(name, "vkDestroyDebugUtilsMessengerEXT") == 0;
    return driver.GetInstanceProcAddr(instance, name);
}

enum vulkan_fault_of_device { FAULT_TIMEOUT, FAULT_LOST, FAULT_NOTHING_DONE, FAULT_HANG };

/* Hang: another error comes first, while the device is at work. */
static void vulkan_check_loss_of_device(enum vulkan_fault_of_device fault)
{
    struct vulkan_run run = vulkan_begin_run(device, 300, 0);
    const int listens = v->messenger != VK_NULL_HANDLE, late = fault == FAULT_TIMEOUT || fault == FAULT_HANG;
    if (fault != FAULT_HANG) {
        vulkan_steps(&run, 1, 2);
        vulkan_half_step(&run);
        CHECK_OK(vulkan_adam(&run, 3));
    } else CHECK_OK(vulkan_run_forward(&run));
    if (fault == FAULT_HANG) v->rc = OXL_ERR_MEMORY;
    if (late) VULKAN_FAIL(WaitForFences, 0, -1, VK_TIMEOUT);
    if (fault == FAULT_LOST) VULKAN_FAIL(QueueSubmit, 0, -1, VK_ERROR_DEVICE_LOST);
    if (fault == FAULT_NOTHING_DONE) {
        VULKAN_FAIL(QueueSubmit, 0, -1, VK_SUCCESS);
        VULKAN_FAIL(WaitForFences, 0, -1, VK_SUCCESS);
    }
    v->GetInstanceProcAddr = vulkan_note_lookup;
    vulkan_stopped_listening = 0;
    vulkan_check_given_up(&run, fault == FAULT_NOTHING_DONE ? 2 : 1,
                          late ? "did not answer in time" : "the device is lost");
    CHECK(vulkan_stopped_listening == listens);
}

/* A submission that finds no memory is repeated, and the run is the same; where it finds none without images
 * either, the step is not counted, and the device is given up. */
DEVICE_TEST(vulkan_repeats_a_submission_that_finds_no_memory)
{
    struct vulkan_run d[2] = {vulkan_begin_run(device, 300, 100), vulkan_begin_run(device, 300, 100)};
    VULKAN_TWICE(k)
    {
        CHECK(renderer_defer(d[k].r, 1));
        for (int step = 1; step <= 6; step++) {
            VULKAN_FAIL(QueueSubmit, 0, k && step % 2, VK_ERROR_OUT_OF_DEVICE_MEMORY);
            vulkan_steps(&d[k], step, step);
            vulkan_reports(&d[k], 0);
            CHECK(vulkan_fault_QueueSubmit.times == 0);
        }
        vulkan_reports(&d[k], 1);
        vulkan_fetch(&d[k], DOWNLOAD_TO_READ);
    }
    vulkan_same_run(&d[0], &d[1]);
    size_t steps = d[1].d->steps;
    vulkan_half_step(&d[1]);
    VULKAN_FAIL(QueueSubmit, 0, 3, VK_ERROR_OUT_OF_DEVICE_MEMORY);
    REFUSED(vulkan_adam(&d[1], 7), OXL_ERR_FAILED, "no device memory is left");
    CHECK_TEXT(oxl_error_text(device), "fix: run the command again");
    CHECK(d[1].d->steps == steps && v->lost); /* it would wait, and destroy, were it not given up */
}

/* A command buffer that finds no memory at its end: lack of memory where it only draws, a lost device where
 * it holds a step. */
DEVICE_TEST(vulkan_gives_up_a_device_without_memory_for_a_step_not_for_an_image)
{
    struct vulkan_run run = vulkan_begin_run(device, 300, 0);
    const float *image;
    CHECK_OK(vulkan_run_forward(&run));
    float *rgb = vulkan_image_of(device, run.r, 64 * 48);
    for (size_t part = 0; part <= 500; part += 500) {
        v->part = 0;
        CHECK_OK(vulkan_run_forward(&run));
        VULKAN_FAIL(EndCommandBuffer, 0, 1, VK_SUCCESS);
        v->part = part; /* the image's commands are several submissions then */
        REFUSED(renderer_image(run.r, &image), OXL_ERR_MEMORY, "recording: no host memory");
        CHECK(!v->lost);
        CHECK_OK(vulkan_run_forward(&run));
        CHECK(memcmp(rgb, vulkan_image_of(device, run.r, 64 * 48), 3 * 64 * 48 * sizeof *rgb) == 0);
    }
    vulkan_half_step(&run);
    VULKAN_FAIL(EndCommandBuffer, 0, 1, VK_SUCCESS);
    CHECK(vulkan_adam(&run, 3) == OXL_ERR_FAILED && v->lost);
}

/* What is uploaded when an error comes counts as uploaded: a shape, an image that is kept. */
DEVICE_TEST(vulkan_keeps_uploads_when_an_error_follows)
{
    struct vulkan_run d[2];
    VULKAN_TWICE(k)
    {
        const oxl_camera larger = vulkan_camera(640, 480);
        d[k] = vulkan_begin_run(device, 300, 100);
        oxl_model *m = &d[k].trained.model;
        vulkan_steps(&d[k], 1, 1);
        vulkan_fetch(&d[k], DOWNLOAD_TO_READ);
        for (int i = 0; i < 300; i++) m->plane[OXL_OPACITY][i] -= 1;
        CHECK_OK(renderer_send_shape(d[k].r, m, 1));
        CHECK_OK(renderer_set_image(device, d[k].r, 1, &d[k].image, NULL, 0));
        v->range = k ? 64 * 48 * 16 : driver.range;
        if (k) REFUSED(vulkan_draw_with(d[k].r, m, &larger), OXL_ERR_MEMORY, "in one array");
        v->range = driver.range;
        CHECK(renderer_has_image(d[k].r, 1));
        CHECK_OK(renderer_set_image(device, d[k].r, 1, NULL, NULL, 0));
        CHECK_OK(vulkan_run_forward(&d[k]));
        CHECK_OK(renderer_loss(device, d[k].r, NULL, NULL, 0.2f, &d[k].loss));
        vulkan_steps(&d[k], 2, 2);
        vulkan_fetch(&d[k], DOWNLOAD_TO_READ);
    }
    CHECK(d[0].loss.total == d[1].loss.total);
    vulkan_same_run(&d[0], &d[1]);
}

/* A step over three slabs finds no memory for the second one's: no one may repeat it. For the first one's:
 * anyone may. */
DEVICE_TEST(vulkan_gives_up_a_device_that_did_half_a_step)
{
    v->slab_rows = 256;
    struct vulkan_run run = vulkan_begin_run(device, 700, 0);
    VULKAN_TWICE(sets)
    {
        VULKAN_SOUND(AllocateDescriptorSets);
        vulkan_half_step(&run);
        CHECK(run.d->slabs == 3);
        VULKAN_FAIL(AllocateDescriptorSets, sets, -1, VK_ERROR_OUT_OF_HOST_MEMORY);
        CHECK(vulkan_adam(&run, 3) == (sets ? OXL_ERR_FAILED : OXL_ERR_MEMORY) && (v->lost != 0) == sets);
    }
    CHECK_TEXT(oxl_error_text(device), "fix: run the command again");
}

/* Between counting and emitting every splat grows or shrinks, as if the two were not compiled alike: no pair
 * leaves its splat's slots. */
DEVICE_TEST(vulkan_keeps_pairs_in_the_slots_that_were_counted)
{
    struct vulkan_twins t = vulkan_twins(100, 75);
    struct vulkan_renderer *d = t.d;
    oxl_model m = vulkan_scene(600, 0, 0);
    uint32_t order[600], first[600], (*staged)[2];
    size_t wrong = 0, unused = 0;
    CHECK_OK(vulkan_draw_with(t.r[1], &m, &t.camera));
    vulkan_order_rows(d);
    vulkan_download(v, &d->row_value[0], 0, order, sizeof order);
    vulkan_download(v, &d->row_pairs, 0, first, sizeof first);
    float *shape = vulkan_splats(d, &d->splat_b, 4);
    for (int i = 0; i < 600; i++)
        for (int k = 0; k < 4; k++)
            if (k != 1) shape[4 * i + k] *= (i % 2) == (k == 0) ? 0.2f : 5;
    vulkan_upload(v, &d->splat_b, 0, shape, 600 * 4 * sizeof *shape);
    vulkan_order_pairs(d);
    vulkan_draw(d, 0);
    staged = vulkan_memory(d->pairs, sizeof *staged);
    vulkan_download(v, &d->staged, 0, staged, d->pairs * sizeof *staged);
    CHECK(v->rc == OXL_OK && d->pairs > 1000);
    for (int i = 0; i < 599; i++)
        for (uint32_t k = first[i]; k < first[i + 1]; k++)
            wrong += staged[k][0] != order[i], unused += staged[k][1] == 0;
    CHECK(wrong == 0 && unused > 0);
}

/* ---------------- memory that is short */

static oxl_result vulkan_take_and_draw(struct vulkan_twins *t, int k, const oxl_model *m, int view,
                                       struct renderer_loss *loss)
{
    uint8_t *rgb = vulkan_bytes(4 * t->pixels, (uint64_t)view);
    struct training_image image = {t->camera.width, t->camera.height, rgb, rgb + 3 * t->pixels};
    oxl_result rc = renderer_set_image(vulkan_ctx(k), t->r[k], view, &image, NULL, 0);
    if (rc == OXL_OK) rc = renderer_forward(vulkan_ctx(k), t->r[k], m, &t->camera, &vulkan_options);
    if (rc == OXL_OK) rc = renderer_loss(vulkan_ctx(k), t->r[k], NULL, NULL, 0.2f, loss);
    return rc;
}

enum { VULKAN_SMALL_IMAGE = 4 * 64 * 48 }; /* bytes */

/* At half its sides, then whole: the target grows, where the first allocation fails. Until images have left,
 * every kind of memory is full: a discrete GPU has several near it. */
static void vulkan_check_image_in_use(VkResult shortage)
{
    struct vulkan_run d = vulkan_begin_run(device, 1, 0);
    VULKAN_TWICE(view) CHECK_OK(renderer_set_image(device, d.r, view, &d.image, NULL, 1));
    vulkan_play_full(INT_MAX, SIZE_MAX);
    vulkan_fault_AllocateMemory.result = shortage;
    vulkan_images_kept = VULKAN_SMALL_IMAGE;
    CHECK_OK(renderer_set_image(device, d.r, 0, NULL, NULL, 0));
    CHECK(renderer_has_image(d.r, 0) && !renderer_has_image(d.r, 1));
    CHECK(v->image_bytes_max < VULKAN_SMALL_IMAGE); /* what left does not come back */
    VULKAN_SOUND(AllocateMemory);
    v->image_bytes_max = 1 << 20;
}

/* Where memory runs out, images that are kept make room; the one that is worked on stays. */
DEVICE_TEST(vulkan_drops_images_where_memory_is_short)
{
    struct vulkan_twins t = vulkan_twins(64, 48);
    struct renderer_loss loss[2];
    oxl_model m = vulkan_scene(300, 1, 0), larger = vulkan_scene(3000, 1, 0);
    int tries = 0;
    vulkan_check_image_in_use(VK_ERROR_OUT_OF_DEVICE_MEMORY);
    vulkan_check_image_in_use(VK_ERROR_TOO_MANY_OBJECTS); /* a driver may allow but 4096 allocations */
    for (int view = 0; view < 4; view++) CHECK_OK(vulkan_take_and_draw(&t, 1, &m, view, &loss[1]));
    CHECK(t.d->image_bytes == 4 * 4 * t.pixels); /* with masks, and not a byte more */
    CHECK(renderer_has_image(t.r[1], 0) && renderer_has_image(t.r[1], 3));
    do vulkan_play_full(tries, SIZE_MAX); /* the first fails, images leave, and the second is the real one */
    while (vulkan_take_and_draw(&t, 1, &larger, 3, &loss[1]) == OXL_ERR_MEMORY && tries++ < 60);
    CHECK(tries > 0 && tries < 60 && !renderer_has_image(t.r[1], 0));
    CHECK_OK(vulkan_take_and_draw(&t, 0, &larger, 3, &loss[0]));
    CHECK_CLOSE(loss[1].total, loss[0].total, 1e-5);
}

static size_t vulkan_budget, vulkan_usage; /* of heap 0; twice, three times that of those behind it */

static VKAPI_ATTR void VKAPI_CALL vulkan_play_memory(VkPhysicalDevice d,
                                                     VkPhysicalDeviceMemoryProperties2 *out)
{
    VkPhysicalDeviceMemoryBudgetPropertiesEXT *budget = out->pNext;
    for (uint32_t i = 0; i < VK_MAX_MEMORY_HEAPS; i++)
        budget->heapBudget[i] = (i + 1) * vulkan_budget, budget->heapUsage[i] = (i + 1) * vulkan_usage;
}

static VkMemoryRequirements vulkan_needs;
static uint32_t vulkan_full_kinds, vulkan_kinds_tried; /* by bits */
static int vulkan_kind_last, vulkan_first_tried;

static VKAPI_ATTR void VKAPI_CALL vulkan_play_needs(VkDevice d, VkBuffer buffer, VkMemoryRequirements *out)
{
    *out = vulkan_needs;
}

static VKAPI_ATTR VkResult VKAPI_CALL vulkan_play_kinds(VkDevice d, const VkMemoryAllocateInfo *info,
                                                        const VkAllocationCallbacks *a, VkDeviceMemory *out)
{
    VkMemoryAllocateInfo given = *info;
    vulkan_kind_last = (int)info->memoryTypeIndex;
    if (!vulkan_kinds_tried) vulkan_first_tried = vulkan_kind_last;
    vulkan_kinds_tried |= 1u << info->memoryTypeIndex;
    VULKAN_LEAVE(out);
    if (vulkan_full_kinds >> info->memoryTypeIndex & 1) return VK_ERROR_OUT_OF_DEVICE_MEMORY;
    given.allocationSize = 1 << 16, given.memoryTypeIndex = 0;
    return driver.AllocateMemory(d, &given, a, out);
}

/* Which kind a buffer of so many bytes gets on a device where some are full; -1: it finds no memory. */
static int vulkan_kind_of(struct vulkan *o, VkDeviceSize size, uint32_t full, int for_host)
{
    struct vulkan_buffer b = {0};
    o->rc = OXL_OK;
    vulkan_needs = (VkMemoryRequirements){size, 64, 31};
    vulkan_full_kinds = full;
    vulkan_kinds_tried = 0;
    vulkan_kind_last = -1;
    vulkan_create(o, &b, 256, for_host);
    CHECK((o->rc == OXL_OK) == (b.handle != VK_NULL_HANDLE) && (o->rc == OXL_OK || o->rc == OXL_ERR_MEMORY));
    if (o->rc != OXL_OK) vulkan_kind_last = -1;
    vulkan_release(o, &b);
    return vulkan_kind_last;
}

static int vulkan_rooms_made;

/* Images leave kind 1. */
static size_t vulkan_play_room(struct vulkan *o, uint32_t but)
{
    vulkan_rooms_made++;
    vulkan_full_kinds &= ~2u;
    return 1;
}

/* Of kinds 0 and 1, near, and 2 and 3, the host's: images leave when no near kind has room, within its
 * budget. A device that shares the host's memory has all near. */
static void vulkan_check_near_kinds(struct vulkan *o)
{
    static const struct {
        VkPhysicalDeviceType type;
        uint32_t full;
        int budgets;
        VkDeviceSize size;
        int kind, rooms;
    } want[] = {{VK_PHYSICAL_DEVICE_TYPE_DISCRETE_GPU, 1, 0, 1 << 20, 1, 0},
                {VK_PHYSICAL_DEVICE_TYPE_DISCRETE_GPU, 3, 0, 1 << 20, 1, 1},
                {VK_PHYSICAL_DEVICE_TYPE_INTEGRATED_GPU, 3, 0, 1 << 20, 2, 0},
                {VK_PHYSICAL_DEVICE_TYPE_INTEGRATED_GPU, 15, 0, 1 << 20, 1, 1},
                {VK_PHYSICAL_DEVICE_TYPE_INTEGRATED_GPU, 0, 1, 1 << 20, 1, 0},
                {VK_PHYSICAL_DEVICE_TYPE_DISCRETE_GPU, 0, 1, (1 << 20) + 1, 0, 1}};
    o->evict = vulkan_play_room;
    o->said_beyond = 1;
    vulkan_budget = 1 << 19, vulkan_usage = 0;
    for (size_t i = 0; i < OXL_COUNT(want); i++) {
        vulkan_rooms_made = 0;
        o->properties.deviceType = want[i].type;
        o->budgets = want[i].budgets;
        CHECK(vulkan_kind_of(o, want[i].size, want[i].full, 0) == want[i].kind &&
              vulkan_rooms_made == want[i].rooms);
    }
}

enum {
    VULKAN_HOST = VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT,
    VULKAN_OWN = VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT
};

/* RADV's layout on small APUs: a heap of 16 MiB comes first, and its budget has underflowed. What does not
 * fit is not asked for; what finds no memory is asked of the next kind; the last is AMD's coherent memory,
 * which wants a feature. */
static void vulkan_check_small_heap(void)
{
    const VkDeviceSize gib = 1u << 30, small = 16u << 20, large = 8 * gib - 20 * (gib >> 10), some = 1 << 20;
    const struct {
        VkDeviceSize size;
        uint32_t full, for_host;
        int kind;
        uint32_t tried, untried;
    } want[] = {{some, 0, 0, 0, 1, 0}, {small + 1, 0, 0, 1, 2, 1}, {some, 1, 0, 1, 3, 0},
                {some, 3, 0, 2, 7, 0}, {large, 2, 0, -1, 2, 29},   {some, 31, 0, -1, 15, 16},
                {some, 0, 1, 3, 8, 0}, {some, 8, 1, 2, 12, 0},     {large, 0, 1, -1, 0, 31}};
    struct vulkan o = *v;
    o.memory = (VkPhysicalDeviceMemoryProperties){
        .memoryTypeCount = 5,
        .memoryTypes = {{VULKAN_OWN, 0},
                        {VULKAN_OWN, 1},
                        {VULKAN_HOST, 2},
                        {VULKAN_HOST | VK_MEMORY_PROPERTY_HOST_CACHED_BIT, 2},
                        {VULKAN_OWN | VULKAN_HOST | 0x40, 1}},
        .memoryHeapCount = 3,
        .memoryHeaps = {{small, 1}, {large, 1}, {4 * gib, 0}}};
    o.budgets = 0;
    o.evict = NULL;
    o.AllocateMemory = vulkan_play_kinds;
    o.GetBufferMemoryRequirements = vulkan_play_needs;
    for (size_t i = 0; i < OXL_COUNT(want); i++) {
        CHECK(vulkan_kind_of(&o, want[i].size, want[i].full, (int)want[i].for_host) == want[i].kind);
        CHECK((vulkan_kinds_tried & want[i].tried) == want[i].tried &&
              !(vulkan_kinds_tried & want[i].untried));
        CHECK(o.kind == 1 && (i != 2 || vulkan_first_tried == 0));
    }
    o.budgets = 1;
    o.GetPhysicalDeviceMemoryProperties2KHR = vulkan_play_memory;
    vulkan_budget = SIZE_MAX / 2 - 100, vulkan_usage = 64; /* of heap 1: 2^64 - 202 */
    CHECK(vulkan_memory_left(&o, 1) == large - 128);
    vulkan_check_near_kinds(&o);
}

/* What other programs use is not there: images are kept in a half of what is left; or up to their share, or
 * number. */
DEVICE_TEST(vulkan_keeps_images_within_what_memory_is_left)
{
    struct vulkan_twins t = vulkan_twins(64, 48);
    const size_t bytes = 4 * t.pixels, most = v->image_bytes_max;
    struct renderer_loss loss;
    oxl_model m = vulkan_scene(30, 0, 0), larger = vulkan_scene(3000, 1, 0);
    vulkan_check_small_heap();
    v->budgets = 1;
    v->GetPhysicalDeviceMemoryProperties2KHR = vulkan_play_memory;
    vulkan_budget = 100;
    for (vulkan_usage = 30; vulkan_usage < 200; vulkan_usage += 71)
        CHECK(vulkan_memory_left(v, v->kind) == (vulkan_usage == 30 ? 70 : 0));
    for (int view = 0; view < 4; view++) {
        vulkan_usage = 0, vulkan_budget = 2 * bytes - (view == 0);
        v->image_bytes_max = view == 1 ? bytes - 1 : most;
        v->properties.limits.maxMemoryAllocationCount = view == 2 ? 0 : 4096;
        CHECK_OK(vulkan_take_and_draw(&t, 1, &m, view, &loss));
        CHECK(renderer_has_image(t.r[1], view) == (view == 3));
    }
    v->image_bytes_max = most;
    vulkan_budget = 64; /* allocations succeed, but would move other memory off the device */
    v->said_beyond = 0;
    vulkan_listen("beyond the memory that is left");
    CHECK_OK(vulkan_take_and_draw(&t, 1, &larger, 3, &loss));
    CHECK(!renderer_has_image(t.r[1], 3) && vulkan_times_heard == 1);
}

/* There is memory for the pairs that there are, not for the room that deferred steps would like: they get
 * along with it, one after the other, and do what they do. */
DEVICE_TEST(vulkan_deferred_steps_get_along_with_room_for_the_pairs_that_there_are)
{
    struct vulkan_buffer b = {0};
    struct vulkan_run d[2];
    VULKAN_TWICE(k)
    {
        VULKAN_SOUND(AllocateMemory);
        d[k] = vulkan_begin_run(device, 300, 100);
        struct vulkan_renderer *r = d[k].d;
        vulkan_steps(&d[k], 1, 1);
        vulkan_play_full(INT_MAX, k ? 32 * r->pairs + 4096 * (r->tiles + 1) : SIZE_MAX);
        CHECK(r->pairs > 256 && renderer_defer(d[k].r, 1));
        renderer_settings(d[k].r)->steps = 1;
        vulkan_steps(&d[k], 2, 2);
        CHECK((vulkan_refusals > 0) == k && r->low_memory == k && r->room > 0);
        if (k) CHECK(r->room * 32 <= vulkan_largest && r->kept.size <= vulkan_largest);
        vulkan_refusals = 0;
        vulkan_steps(&d[k], 3, 3);
        CHECK(vulkan_refusals == 0 && vulkan_reports(&d[k], 1) && d[k].report.halt == HALT_NONE);
        CHECK(vulkan_reports(&d[k], 1) && (k || d[k].report.halt == HALT_NONE));
        renderer_defer(d[k].r, 0);
        if (d[k].report.halt == HALT_PAIRS) vulkan_steps(&d[k], 3, 3); /* a pair more, and it is repeated */
        vulkan_fetch(&d[k], DOWNLOAD_TO_READ);
    }
    vulkan_same_run(&d[0], &d[1]);
    vulkan_largest = 1 << 16;
    vulkan_reserve(v, &b, 1 << 14, 4, "numbers"); /* without the quarter more */
    CHECK(v->rc == OXL_OK && b.size == 1 << 16 && vulkan_refusals > 0);
    vulkan_release(v, &b);
}

/* ---------------- --backend auto: the CPU continues */

/* Where the device has no memory for scores, none are added, and the CPU renders from then on. */
static void vulkan_check_score_falls_back(void)
{
    struct vulkan_twins t = vulkan_twins(64, 48);
    float *drgb = vulkan_noise(3 * t.pixels, 51), score[300] = {0};
    oxl_model m = vulkan_scene(300, 1, 0);
    CHECK_OK(vulkan_draw_with(t.r[1], &m, &t.camera));
    vulkan_play_full(0, SIZE_MAX);
    CHECK_OK(renderer_score(device, t.r[1], drgb, score));
    CHECK(t.r[1]->device == NULL && score[0] + score[7] + score[11] == 0);
    CHECK_OK(vulkan_draw_with(t.r[1], &m, &t.camera));
    CHECK_OK(renderer_score(device, t.r[1], drgb, score));
    CHECK(score[0] + score[7] + score[11] > 0);
}

/* With the image that the device had. */
DEVICE_TEST(vulkan_falls_back_to_the_cpu_when_out_of_memory)
{
    struct vulkan_twins t = vulkan_twins(64, 48);
    struct renderer_loss loss[2];
    oxl_model m = vulkan_scene(300, 1, 0);
    vulkan_play_full(3, SIZE_MAX); /* the image fits, the model does not */
    REFUSED(vulkan_take_and_draw(&t, 1, &m, 0, &loss[1]), OXL_ERR_MEMORY, "no device memory is left");
    CHECK_TEXT(oxl_error_text(device), "fix: ");
    device->options.backend = OXL_BACKEND_AUTO;
    vulkan_listen(": continuing on the CPU");
    vulkan_play_full(1, SIZE_MAX); /* again: the image had left for the model */
    VULKAN_TWICE(k) CHECK_OK(vulkan_take_and_draw(&t, k, &m, 0, &loss[k]));
    CHECK(t.r[1]->device == NULL);
    CHECK_CLOSE(loss[0].total, loss[1].total, 1e-6); /* its bytes made floats on the device */
    vulkan_play_full(0, SIZE_MAX);
    t = vulkan_twins(64, 48);
    CHECK(t.r[1]->device == NULL);
    VULKAN_SOUND(AllocateMemory);
    vulkan_check_score_falls_back();
}

/* What the public functions give of a model in one view: the image and its depths, or the gradient; as one
 * number. 0: nothing. */
static oxl_result vulkan_output(oxl_context *ctx, const oxl_model *m, int gradient, uint64_t *sum)
{
    const oxl_camera camera = vulkan_camera(64, 48);
    float depth[64 * 48];
    oxl_image image = {0};
    oxl_model out = {0};
    const oxl_result rc =
        gradient ? oxl_render_backward(ctx, m, &camera, NULL, vulkan_noise(3 * 64 * 48, 50), &out)
                 : oxl_render(ctx, m, &camera, NULL, &image, depth);
    *sum = 0;
    if (image.rgb) *sum = checksum_add(CHECKSUM_SEED, depth, sizeof depth);
    if (image.rgb) *sum = checksum_add(*sum, image.rgb, sizeof(float) * 3 * 64 * 48);
    for (int k = 0; k < oxl_model_planes(m) && out.count == m->count; k++)
        *sum = checksum_add(*sum + CHECKSUM_SEED, out.plane[k], m->count * sizeof(float));
    oxl_image_free(ctx, &image);
    oxl_model_free(ctx, &out);
    return rc;
}

static int vulkan_gives(const oxl_model *m, int gradient, uint64_t wanted)
{
    uint64_t sum;
    CHECK_OK(vulkan_output(device, m, gradient, &sum));
    CHECK(sum != 0);
    return sum == wanted;
}

/* The device is lost in the last submission of a gradient; the CPU computes it, and renders from then on,
 * which is said once. With --backend vulkan that is an error, whatever has been said since. */
static void vulkan_check_draws_without_device(const oxl_model *m, const uint64_t sum[2])
{
    const size_t before = v->submissions;
    uint64_t none;
    CHECK(!vulkan_gives(m, 1, sum[1]) && v->submissions - before > 4);
    VULKAN_FAIL(QueueSubmit, (int)(v->submissions - before) - 1, -1, VK_ERROR_DEVICE_LOST);
    vulkan_listen(": continuing on the CPU");
    CHECK(vulkan_gives(m, 1, sum[1]) && v->lost == VK_ERROR_DEVICE_LOST && vulkan_times_heard == 1);
    CHECK(vulkan_gives(m, 0, sum[0]) && vulkan_gives(m, 1, sum[1]) && vulkan_times_heard == 1);
    device->options.backend = OXL_BACKEND_VULKAN;
    VULKAN_TWICE(gradient)
    {
        oxl_fail(device, OXL_ERR_INPUT, "another error");
        REFUSED(vulkan_output(device, m, gradient, &none), OXL_ERR_FAILED, "the device is lost");
    }
}

/* Wherever an image or a gradient finds no memory, the CPU does all of it. */
DEVICE_TEST(vulkan_images_and_gradients_fall_back_to_the_cpu)
{
    oxl_model m = vulkan_scene(300, 1, 0);
    uint64_t sum[2], none;
    VULKAN_TWICE(gradient)
    {
        CHECK_OK(vulkan_output(cpu, &m, gradient, &sum[gradient]));
        vulkan_play_full(1000, SIZE_MAX);
        device->options.backend = OXL_BACKEND_VULKAN;
        device->backend->rendered_on = 0;
        CHECK(!vulkan_gives(&m, gradient, sum[gradient]));
        CHECK(strcmp(oxl_backend_name(device), v->properties.deviceName) == 0);
        int all = 1000 - vulkan_fault_AllocateMemory.after;
        vulkan_play_full(all - 1, SIZE_MAX);
        CHECK(vulkan_output(device, &m, gradient, &none) == OXL_ERR_MEMORY && none == 0);
        device->options.backend = OXL_BACKEND_AUTO;
        device->backend->rendered_on = 0;
        for (int k = 0; k < all; k++) {
            if (k == 0) vulkan_listen(": continuing on the CPU");
            vulkan_play_full(k, SIZE_MAX);
            CHECK(vulkan_gives(&m, gradient, sum[gradient]) && vulkan_times_heard == 1);
            if (k == 0) CHECK(strcmp(oxl_backend_name(device), "cpu") == 0);
        }
        VULKAN_SOUND(AllocateMemory);
    }
    vulkan_check_draws_without_device(&m, sum);
}

/* ---------------- density control */

/* Steps, density control and an opacity reset, steps; the rows downloaded and uploaded (0), moved on the
 * device (1), or to be moved where there is no room (2). */
static struct vulkan_run vulkan_densify(size_t lobes, int moves)
{
    const struct density_rules rules = {.gradient = lobes ? 1e30 : 1e-4, .extent = 1, .f_mid = 1, .f_far = 1};
    struct vulkan_run d = vulkan_begin_run(device, 300, lobes);
    struct density_change change;
    struct density own = {0}, *density = &own;
    uint32_t from[1200];
    struct renderer_move move = {.from = from, .sh_degree = 1};
    size_t sent, before;
    int moved = 0;
    for (size_t i = 0; i < 300; i += 7) d.trained.model.plane[OXL_OPACITY][i] = -9; /* to be removed */
    CHECK_OK(density_clear(cpu, density, 300));
    vulkan_steps(&d, 1, 2);
    for (int i = 0; i < 300; i++) density->gradient[i] = (float)(i % 3), density->views[i] = 1;
    before = v->read_bytes, sent = v->sent;
    vulkan_fetch(&d, moves ? DOWNLOAD_SHAPE : DOWNLOAD_TO_CHANGE);
    if (moves) CHECK(v->read_bytes - before == 300 * (OXL_SH * 4 + 16));
    CHECK_OK(density_decide(cpu, density, &d.trained.model, &rules, &change));
    move.lobes = density_sources(density, &d.trained.model, from);
    move.count = 300 - change.removed + change.split;
    CHECK(change.removed > 40 && (change.split > 100) == !lobes && move.lobes == (lobes ? 85 : 0));
    if (moves == 2) vulkan_play_full(3, SIZE_MAX);
    if (moves) CHECK_OK(renderer_move_rows(d.r, &move, &moved));
    VULKAN_SOUND(AllocateMemory);
    CHECK(moved == (moves == 1));
    CHECK_OK(density_apply(cpu, density, &d.trained, &change, moved));
    if (moved) CHECK_OK(renderer_send_shape(d.r, &d.trained.model, 0));
    if (moved) CHECK(v->sent - sent == move.count * (4 + OXL_SH * 4));
    if (moved) vulkan_fetch(&d, DOWNLOAD_SHAPE);
    density_reset_opacity(&d.trained, 0);
    if (moved) CHECK_OK(renderer_send_shape(d.r, &d.trained.model, 1));
    d.sums.count = 0; /* nothing more is observed */
    vulkan_steps(&d, 3, 4);
    vulkan_fetch(&d, DOWNLOAD_TO_READ);
    return d;
}

DEVICE_TEST(vulkan_density_control_moves_rows_as_the_host_does)
{
    v->slab_rows = 256; /* several slabs */
    for (size_t lobes = 0; lobes <= 100; lobes += 100) {
        struct vulkan_run d[3];
        for (int k = 0; k < 3; k++) d[k] = vulkan_densify(lobes, k);
        for (int k = 1; k < 3; k++) vulkan_same_trained(&d[0].trained, &d[k].trained);
    }
}

/* ---------------- parts of an image */

/* More parts than a frame has command buffers. A frame is waited for as long as its submissions together may
 * take. */
static void vulkan_check_many_parts(struct renderer *r, const oxl_model *m, const oxl_camera *camera,
                                    const float *whole)
{
    const size_t before = v->submissions;
    v->part = 10;
    CHECK_OK(vulkan_draw_with(r, m, camera));
    v->timeout_ns = 1000000000;
    VULKAN_FAIL(WaitForFences, 0, 0, VK_SUCCESS);
    CHECK(((struct vulkan_renderer *)r->device)->pairs / 10 > VULKAN_COMMANDS);
    CHECK(v->submissions - before > ((struct vulkan_renderer *)r->device)->pairs / 10);
    CHECK(memcmp(whole, vulkan_image_of(device, r, 200 * 150), 3 * 200 * 150 * sizeof *whole) == 0);
    CHECK(vulkan_waited > v->timeout_ns && vulkan_waited <= VULKAN_COMMANDS * v->timeout_ns);
    v->timeout_ns = driver.timeout_ns;
}

/* Drawn whole and in parts, each a submission. */
DEVICE_TEST(vulkan_renders_the_same_whole_and_in_parts)
{
    const oxl_camera camera = vulkan_camera(200, 150);
    float *drgb = vulkan_noise(3 * 200 * 150, 57), *whole = NULL;
    oxl_model m = vulkan_scene(900, 1, 200), gradient[2];
    VULKAN_TWICE(k)
    {
        struct renderer *r = vulkan_renderer(device);
        size_t before = v->submissions;
        v->part = k ? 500 : 0;
        vulkan_model(m.count, 1, 200, &gradient[k]);
        CHECK_OK(vulkan_draw_with(r, &m, &camera));
        CHECK((v->submissions - before > 5) == k); /* two rows of tiles each */
        float *image = vulkan_image_of(device, r, 200 * 150);
        before = v->submissions;
        CHECK_OK(renderer_backward(device, r, drgb, &gradient[k]));
        CHECK((v->submissions - before > 5) == k);
        CHECK_OK(renderer_gradient(r, &gradient[k]));
        if (k) CHECK(memcmp(whole, image, 3 * 200 * 150 * sizeof *whole) == 0);
        whole = image;
        if (k) vulkan_check_many_parts(r, &m, &camera, whole);
    }
    CHECK(test_same_model(&gradient[0], &gradient[1]));
}

/* Nine in ten pairs are in three of many tiles: no submission draws more than a part of the pairs and one
 * tile, and together they draw all. */
DEVICE_TEST(vulkan_bounds_a_submission_of_an_unbalanced_image)
{
    struct vulkan_twins t = vulkan_twins(320, 240);
    oxl_model m = vulkan_scene(4000, 0, 0);
    uint32_t most = 0, all = 0;
    for (size_t i = 0; i < 3600; i++) {
        vulkan_place(&m, i, -1.2 + 1e-3 * vulkan_random(i, 0), 0.5 + 1e-3 * vulkan_random(i, 1),
                     4 + 0.1 * vulkan_random(i, 2));
        for (int k = 0; k < 3; k++) m.plane[OXL_LOG_SCALE + k][i] = -4;
    }
    CHECK_OK(vulkan_draw_with(t.r[1], &m, &t.camera));
    const uint32_t *start = vulkan_starts(t.d);
    for (int i = 0; i < 300; i++) most = OXL_MAX(most, start[i + 1] - start[i]);
    v->part = 700;
    v->CmdPushConstants = vulkan_note_part;
    vulkan_part_count = 0;
    vulkan_draw(t.d, 0);
    CHECK(vulkan_finish(v) == OXL_OK && vulkan_part_count > 6 && most > 1000);
    for (int k = 0; k < vulkan_part_count; k++) {
        uint32_t pairs = 0;
        for (uint32_t i = 0; i < 300; i++)
            if (start[i] >= vulkan_parts[k][0] && start[i] < vulkan_parts[k][1])
                pairs += start[i + 1] - start[i];
        CHECK(pairs <= 700 + most);
        all += pairs;
    }
    CHECK(all == t.d->pairs);
}

/* ---------------- a survey */

/* darker: the log of how much darker every other image is. */
static oxl_scene *vulkan_survey(double darker)
{
    static const char *const names[] = {"a", "b", "c", "d", "e", "f"};
    oxl_model truth = vulkan_scene(200, 0, 0);
    oxl_view view[6];
    oxl_image image[6];
    oxl_point point[200];
    for (int i = 0; i < 6; i++) {
        view[i] = (oxl_view){.name = names[i], .camera = vulkan_camera(48, 36), .is_test = i == 2};
        view[i].camera.translation[0] += 0.3 * (i - 3);
        view[i].camera.translation[1] += 0.1 * (i % 3);
        image[i] = test_render(&truth, &view[i].camera);
        for (int k = 0; i % 2 && k < 3 * 48 * 36; k++) image[i].rgb[k] *= (float)exp(-darker);
    }
    for (int i = 0; i < 200; i++) {
        point[i] = (oxl_point){.rgb = {128, 128, 128}};
        for (int a = 0; a < 3; a++) point[i].position[a] = truth.plane[OXL_MEAN + a][i];
    }
    return test_scene(view, image, 6, point, 200);
}

static size_t vulkan_bytes_of(const oxl_model *m)
{
    return sizeof(float) * (m->count * (size_t)oxl_model_planes(m) + m->lobes * MODEL_LOBE_PLANES);
}

/* In evaluations and images only the model is uploaded, so the bytes are counted. */
DEVICE_TEST(vulkan_uploads_a_model_once_for_all_views_of_an_evaluation)
{
    OWNED_SCENE *scene = vulkan_survey(0);
    const oxl_render_output what = {.split = OXL_SPLIT_ALL, .depth = 1};
    oxl_metrics metrics;
    oxl_model m = vulkan_scene(600, 1, 100);
    size_t before = v->sent;
    int count;
    v->slab_rows = 256; /* several slabs */
    CHECK_OK(oxl_evaluate(device, &m, scene, NULL, OXL_SPLIT_ALL, &metrics));
    CHECK(metrics.count == 6 && v->sent - before == vulkan_bytes_of(&m));
    before = v->sent;
    CHECK_OK(oxl_render_views(device, &m, scene, NULL, &what, test_path("drawn"), &count));
    CHECK(count == 6 && v->sent - before == vulkan_bytes_of(&m));
    oxl_metrics_free(device, &metrics);
}

static void vulkan_repaint(oxl_model *m)
{
    for (size_t i = 0; i < m->count; i++) m->plane[OXL_SH][i] += (float)(1 + vulkan_random(i, 90));
}

/* Outside of training a model belongs to the caller and may change at any time; behind the interface after
 * renderer_download. Another has the shape of the first. */
DEVICE_TEST(vulkan_renders_the_current_model)
{
    struct vulkan_twins t = vulkan_twins(64, 48);
    OWNED_SCENE *scene = vulkan_survey(0);
    oxl_model m = vulkan_scene(300, 1, 100), other = vulkan_scene(300, 1, 100);
    double psnr[2];
    VULKAN_TWICE(round)
    {
        oxl_metrics metrics;
        CHECK_OK(oxl_evaluate(device, &m, scene, NULL, OXL_SPLIT_ALL, &metrics));
        psnr[round] = metrics.psnr;
        oxl_metrics_free(device, &metrics);
        vulkan_repaint(&m);
    }
    CHECK(fabs(psnr[1] - psnr[0]) > 1);
    vulkan_draw_both(&t, &m);
    VULKAN_TWICE(k) CHECK_OK(renderer_download(t.r[k], DOWNLOAD_TO_CHANGE));
    vulkan_repaint(&m);
    vulkan_draw_both(&t, &m);
    vulkan_draw_both(&t, &other);
}

/* ---------------- a run */

/* What is asked of a run, and what it gave. */
struct vulkan_training {
    oxl_train_options options;
    double darker; /* of the survey */
    const oxl_callback *callback;
    const char *saved; /* a folder for its state, or NULL */
    const struct image_window *window;
    const oxl_model *surroundings;
    oxl_model model;
    double gain[18], psnr;
    char decisions[4000];
};

static oxl_result vulkan_train(oxl_context *ctx, struct vulkan_training *t)
{
    struct text log = {.ctx = ctx}, notes = {.ctx = ctx}, decisions = {.ctx = ctx};
    struct oxl_imaging imaging = {0};
    struct train_task task = {.imaging = &imaging,
                              .log = t->saved ? &log : NULL,
                              .notes = t->saved ? &notes : NULL,
                              .decisions = &decisions,
                              .window = t->window,
                              .surroundings = t->surroundings};
    OWNED_SCENE *scene = vulkan_survey(t->darker);
    oxl_model out = {0};
    if (t->saved) task.store = checkpoint_in(test_path(t->saved), "run");
    oxl_result rc = train_run(ctx, scene, &t->options, t->callback, &task, &out);
    if (rc == OXL_OK) {
        oxl_metrics metrics;
        CHECK_OK(oxl_evaluate(ctx, &out, scene, &imaging, OXL_SPLIT_ALL, &metrics));
        t->psnr = metrics.psnr;
        oxl_metrics_free(ctx, &metrics);
        vulkan_model(out.count, out.sh_degree, out.lobes, &t->model);
        for (int k = 0; k < OXL_PLANES; k++)
            if (test_rows(&out, k))
                memcpy(t->model.plane[k], out.plane[k], test_rows(&out, k) * sizeof(float));
    }
    for (int i = 0; i < 18 && imaging.on; i++) t->gain[i] = (double)imaging.log_gain[i];
    snprintf(t->decisions, sizeof t->decisions, "%s", decisions.data ? decisions.data : "");
    text_free(&log), text_free(&notes), text_free(&decisions);
    imaging_free(ctx, &imaging);
    oxl_model_free(ctx, &out);
    return rc;
}

/* Everything that a run does between steps: densification, higher SH degrees, pruning, second lobes. */
static struct vulkan_training vulkan_full_run(void)
{
    struct vulkan_training t = {.options = oxl_train_options_default(OXL_PRESET_DRAFT)};
    t.options.iterations = 60;
    t.options.short_run_exponent = 0; /* larger steps amplify rounding, in which device and CPU differ */
    t.options.densify_every = 10;
    t.options.sh_degree = 1;
    t.options.dog = OXL_DOG_ALL;
    t.options.max_gaussians = 400;
    t.options.keep = (oxl_keep){OXL_KEEP_FRACTION, 0.8};
    return t;
}

/* The same bytes again; as good as the CPU's. */
DEVICE_TEST(vulkan_training_repeats_itself_and_is_as_good_as_the_cpus)
{
    struct vulkan_training t[3] = {vulkan_full_run(), vulkan_full_run(), vulkan_full_run()};
    for (int k = 0; k < 3; k++) CHECK_OK(vulkan_train(vulkan_ctx(k > 0), &t[k]));
    CHECK_CLOSE(t[1].psnr, t[0].psnr, 0.1);
    CHECK(t[0].model.lobes > 0 && t[1].model.lobes > 0 && t[1].psnr == t[2].psnr);
    CHECK(test_same_model(&t[1].model, &t[2].model));
}

DEVICE_TEST(vulkan_times_the_steps_of_a_forecast)
{
    const oxl_job_options o = oxl_job_options_default(OXL_PRESET_DRAFT);
    OWNED_SCENE *scene = train_scene(5);
    double seconds = 0;
    CHECK_OK(cost_seconds(device, scene, &o, &seconds));
    CHECK(seconds > 0);
}

/* A run of this survey up to its first step. */
static void vulkan_begin_train(struct train *t, oxl_train_options *options, oxl_scene *scene)
{
    *options = train_options(60);
    *t = (struct train){.ctx = device, .survey = scene, .options = options};
    CHECK_OK(train_begin(t));
}

static void vulkan_end_train(struct train *t)
{
    oxl_scene *scene = (oxl_scene *)t->survey;
    oxl_context *ctx = t->ctx;
    train_end(t);
    oxl_scene_free(ctx, scene);
}

/* Steps of a run, without density control. */
static void vulkan_train_steps(struct train *t, int steps)
{
    for (int k = 0; k < steps; k++) {
        t->step++;
        CHECK_OK(step_on_next_view(t));
        CHECK_OK(step_observe(t));
    }
}

/* State of the part of this name, and (out not NULL) its row. */
static void *vulkan_part(struct train *t, const char *name, const struct part **out)
{
    int k = 0;
    while (parts_at(k) && strcmp(parts_at(k)->name, name) != 0) k++;
    if (out) *out = parts_at(k);
    return parts_at(k) ? t->part[k] : NULL;
}

static int vulkan_stops_at(void *user, const oxl_progress *p)
{
    return p->iteration == *(const int *)user;
}

/* of the checkpoint that is there */
static uint64_t vulkan_checkpoint_sum(void)
{
    struct os_file_map map = {0};
    CHECK_OK(os_read_file(cpu, test_path("saved/checkpoint.oxl"), &map));
    uint64_t sum = checksum_add(CHECKSUM_SEED, map.data, map.size);
    os_release_file(cpu, &map);
    return sum;
}

/* A submission finds no memory, nor does its repetition: what was not submitted is not known to the host, so
 * the run ends, with --backend auto, too. The checkpoint is as it was, and the next run ends as if nothing
 * had been. */
DEVICE_TEST(vulkan_run_of_a_lost_device_continues_from_an_intact_checkpoint)
{
    int stop = 33;
    const oxl_callback callback = {vulkan_stops_at, &stop};
    struct vulkan_training straight = {.options = train_options(60), .saved = "straight"}, t = straight;
    t.saved = "saved";
    CHECK_OK(vulkan_train(device, &straight));
    t.callback = &callback;
    CHECK(vulkan_train(device, &t) == OXL_ERR_INTERRUPTED);
    t.callback = NULL;
    uint64_t saved = vulkan_checkpoint_sum();
    device->options.backend = OXL_BACKEND_AUTO;
    vulkan_listen("no memory is left");
    VULKAN_FAIL(QueueSubmit, 15, -1, VK_ERROR_OUT_OF_DEVICE_MEMORY);
    vulkan_played = 0;
    REFUSED(vulkan_train(device, &t), OXL_ERR_FAILED, "no device memory is left");
    CHECK_TEXT(oxl_error_text(device), "fix: run the command again, it continues from the last checkpoint");
    CHECK(vulkan_played == 3 && v->lost); /* once more after images have left */
    CHECK(vulkan_checkpoint_sum() == saved);
    vulkan_close_now();
    device->options.backend = OXL_BACKEND_VULKAN;
    CHECK_OK(vulkan_train(device, &t));
    CHECK(test_same_model(&straight.model, &t.model));
}

/* A run that one device began is not continued by another. */
DEVICE_TEST(vulkan_run_that_one_device_began_is_refused_by_another)
{
    oxl_job_options options = job_test_options();
    struct job_test_watch watch = {0, 5};
    const oxl_callback callback = {job_test_progress, &watch};
    const char *survey = job_test_survey();
    CHECK(oxl_job_run(device, survey, test_path("begun"), &options, &callback) == OXL_ERR_INTERRUPTED);
    CHECK(oxl_job_run(cpu, survey, test_path("begun"), &options, NULL) == OXL_ERR_USAGE);
    CHECK_OK(oxl_job_run(cpu, survey, test_path("other"), &options, NULL));
    REFUSED(oxl_job_run(device, survey, test_path("other"), &options, NULL), OXL_ERR_USAGE,
            "  device: none there, ");
}

/* A device whose memory the survey does not fit trains it by blocks, within --device-ram; one that has no
 * room for blocks of any size is refused with what it needs. */
DEVICE_TEST(vulkan_trains_by_blocks_what_device_ram_has_no_room_for)
{
    oxl_job_options options = job_test_options();
    const char *survey = job_test_survey_of(5000);
    char out[512];
    snprintf(out, sizeof out, "%s", test_path("device_ram"));
    options.renders = 0;
    options.train.sh_degree = 3; /* with degree 1, which auto takes, they fit */
    options.device_ram = device->options.device_ram = 12 << 20;
    v->most_allocated = v->allocated;
    device->backend->rendered_on = 0;
    CHECK_OK(oxl_job_run(device, survey, out, &options, NULL));
    CHECK(os_is_file(PATH(out, "blocks/001/model.ply")));
    CHECK(device->backend->rendered_on == RENDERED_ON_DEVICE);
    CHECK(v->most_allocated <= options.device_ram && v->most_allocated > options.device_ram / 4);
    options.device_ram = 1 << 20;
    REFUSED(oxl_job_run(device, survey, test_path("device_ram_1m"), &options, NULL), OXL_ERR_BUDGET,
            "MB of the device are too little");
    CHECK_TEXT(oxl_error_text(device), "fix: --device-ram ");
}

/* A shader is made anew, and refused. */
static void vulkan_refuse(enum vulkan_pass pass)
{
    vulkan_refused = &v->pipeline[pass].layout;
    vulkan_refusals = 0;
    v->DestroyPipeline(v->device, v->pipeline[pass].variant[0], NULL);
    v->pipeline[pass].variant[0] = VK_NULL_HANDLE;
    VULKAN_FAIL(CreateComputePipelines, 0, 0, VK_SUCCESS);
}

/* The first step of a run, on a device that allocates so often in it; returns how often. */
static int vulkan_first_step(int allocations, int falls_back)
{
    oxl_train_options options;
    OWNED_SCENE *scene = train_scene(9);
    struct train t;
    vulkan_begin_train(&t, &options, scene);
    t.step = 1;
    vulkan_play_full(allocations, SIZE_MAX);
    CHECK_OK(step_on_next_view(&t));
    VULKAN_SOUND(AllocateMemory);
    CHECK_OK(step_flush(&t));
    CHECK(t.last_loss > 0 && t.last_loss < 1 && renderer_has_device(t.renderer) == !falls_back);
    train_end(&t);
    return allocations - vulkan_fault_AllocateMemory.after;
}

/* Wherever the first step finds no memory, or a shader is refused, the CPU does it, and has the image that
 * only the device had. */
DEVICE_TEST(vulkan_first_step_falls_back_wherever_it_finds_no_memory_or_no_shader)
{
    static const enum vulkan_pass late[] = {PASS_OBSERVE, PASS_STEP, PASS_LOSS_BACKWARD};
    const int all = vulkan_first_step(1000, 0);
    device->options.backend = OXL_BACKEND_AUTO;
    vulkan_listen("on the CPU");
    CHECK(all > 20);
    for (int k = all - 1; k >= 0; k -= k > all - 16 ? 1 : 8) vulkan_first_step(k, 1);
    for (size_t i = 0; i < OXL_COUNT(late); i++) {
        vulkan_refuse(late[i]);
        vulkan_first_step(1000, 1);
    }
}

/* Once at each iteration that it is due. user: the last one. */
static int vulkan_stops(void *user, const oxl_progress *p)
{
    int *last = user, stops = p->iteration % 7 == 3 && p->iteration != *last;
    if (stops) *last = p->iteration;
    return stops;
}

/* Gains of images are learned on a device as on the CPU (0), in deferred steps (1), also where these find no
 * room (2); what the run is interrupted by does not show (3). */
DEVICE_TEST(vulkan_learns_gains_of_images_as_the_cpu_does)
{
    struct vulkan_training t[4];
    int last = 0, stops = 0;
    const oxl_callback callback = {vulkan_stops, &last};
    for (int k = 0; k < 4; k++) {
        const size_t waits = v->waits;
        t[k] = (struct vulkan_training){
            .options = train_options(80), .darker = 0.3, .saved = "cpu\0one\0two\0end" + 4 * k};
        t[k].options.exposure = OXL_ON;
        t[k].options.short_run_exponent = 0;
        if (k == 3) t[k].callback = &callback;
        vulkan_play_no_room(k == 2);
        while (vulkan_train(vulkan_ctx(k > 0), &t[k]) == OXL_ERR_INTERRUPTED && stops < 20) stops++;
        CHECK(t[k].model.count > 0);
        if (k == 1) CHECK(v->waits - waits < 80);
        if (k == 2) CHECK(vulkan_counted > 20 && vulkan_halted > 6);
    }
    CHECK(stops == 12 && t[0].gain[0] - t[0].gain[3] > 0.03);
    for (int i = 0; i < 18; i++) CHECK_CLOSE(t[1].gain[i], t[0].gain[i], 0.002);
    for (int k = 2; k < 4; k++) {
        CHECK(memcmp(t[1].gain, t[k].gain, sizeof t[1].gain) == 0);
        CHECK(test_same_model(&t[1].model, &t[k].model));
    }
}

DEVICE_TEST(vulkan_run_says_why_it_refines_no_poses)
{
    struct vulkan_training t = {.options = train_options(3)};
    NEEDS_PART(poses);
    t.options.poses = OXL_AUTO;
    CHECK_OK(vulkan_train(device, &t));
    CHECK_TEXT(
        t.decisions,
        "\"poses\": {\"chosen\": \"off\", \"evidence\": \"a device does not compute their gradient\"}");
}

DEVICE_TEST(vulkan_compares_parts_of_views_in_front_of_a_context_as_the_cpu_does)
{
    const struct image_window part = {.x = 11, .y = 6, .width = 41, .height = 30};
    oxl_model surroundings = vulkan_scene(333, 1, 0);
    for (size_t i = 0; i < surroundings.count; i++) surroundings.plane[OXL_MEAN][i] += 0.3f;
    VULKAN_COMPARE(.surroundings = &surroundings, .window = 1, .degree = 2);
    VULKAN_COMPARE(.surroundings = &surroundings, .window = 1, .lit = 1, .medium = &vulkan_murky,
                   .dropout = 0.3, .points = 60, .lobes = 100);
    for (int k = 0; k < 4; k++) vulkan_check_image(61, 45, k & 1, k >> 1, &part);
}

/* ---------------- all parts at once */

enum { VULKAN_ALL_VIEWS = 8 };

/* A survey with tracks that all parts can learn from. */
static void vulkan_make_all(void)
{
    synth_options o = synth_test_options("vulkan_all");
    OWNED_COLMAP survey = {0};
    o.views = VULKAN_ALL_VIEWS, o.water = SYNTH_3C, o.path = SYNTH_FORWARD, o.points = 800;
    o.width = 80, o.height = 56;
    synth_test_make(&o, &survey);
}

/* A run with every part on, up to its first step: survey with tracks, windows, surroundings. */
static void vulkan_begin_all(oxl_context *ctx, struct train *t, oxl_train_options *o,
                             struct image_window window[VULKAN_ALL_VIEWS], const oxl_model *surroundings)
{
    *o = train_options(400);
    o->exposure = o->lamp = o->medium = OXL_ON;
    o->dropout = 0.1f;
    o->antialias = 1;
    *t = (struct train){.ctx = ctx, .options = o};
    CHECK_OK(oxl_scene_load(ctx, test_path("vulkan_all"), NULL, (oxl_scene **)&t->survey));
    CHECK(oxl_scene_view_count(t->survey) == VULKAN_ALL_VIEWS);
    for (int i = 0; i < VULKAN_ALL_VIEWS; i++)
        window[i] = (struct image_window){.x = 8, .y = 4, .width = 64, .height = 48};
    t->task = (struct train_task){.window = window, .surroundings = surroundings};
    CHECK_OK(train_begin(t));
    ((struct lamp_fit *)vulkan_part(t, "lamp", NULL))->on = 1;
    *(struct medium *)vulkan_part(t, "medium", NULL) = vulkan_murky;
}

/* With lamp, medium, gains, depths, dropout, window and surroundings a step takes at most 41 passes, and the host
 * waits for none: it learns of each a step late. */
DEVICE_TEST(vulkan_a_step_with_all_parts_waits_for_nothing_and_takes_45_passes)
{
    struct image_window window[VULKAN_ALL_VIEWS];
    oxl_train_options o;
    oxl_model surroundings = vulkan_scene(333, 1, 0);
    struct train t;
    size_t waits, dispatches, before, sent;
    vulkan_make_all();
    vulkan_begin_all(device, &t, &o, window, &surroundings);
    vulkan_train_steps(&t, VULKAN_ALL_VIEWS);
    waits = v->waits, dispatches = v->dispatches, before = v->read_bytes, sent = v->sent;
    vulkan_train_steps(&t, 10);
    CHECK(v->waits == waits && v->read_bytes == before && v->sent == sent);
    CHECK(v->dispatches - dispatches <= 10 * 41 && v->dispatches - dispatches >= 10 * 35); /* plain: 30 */
    CHECK_OK(step_flush(&t));
    CHECK(device->backend->rendered_on == RENDERED_ON_DEVICE);
    vulkan_end_train(&t);
}

DEVICE_TEST(vulkan_gives_up_a_device_that_does_not_answer)
{
    vulkan_check_loss_of_device(FAULT_TIMEOUT);
}

DEVICE_TEST(vulkan_gives_up_a_device_that_hangs_after_another_error)
{
    vulkan_check_loss_of_device(FAULT_HANG);
}

DEVICE_TEST(vulkan_gives_up_a_device_that_is_lost)
{
    vulkan_check_loss_of_device(FAULT_LOST);
}

DEVICE_TEST(vulkan_takes_no_results_of_a_wait_that_ended_without_the_work)
{
    vulkan_check_loss_of_device(FAULT_NOTHING_DONE);
}

#endif

/* In any build. */
TEST(vulkan_without_a_device_is_reported_in_one_line)
{
    oxl_context_options options = test_ctx->options;
    oxl_context *ctx;
    const oxl_camera camera = test_camera(8, 8, 8, 0, 0, 0);
    OWNED_MODEL model;
    oxl_image image;
#ifdef OXL_VULKAN
    setenv("OXL_VULKAN_LIBRARY", "no-such-library.so", 1);
#endif
    model = test_model(1, 0);
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
#ifdef OXL_VULKAN
    unsetenv("OXL_VULKAN_LIBRARY");
#endif
}
