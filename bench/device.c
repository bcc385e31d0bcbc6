/* device.c - a training step on a Vulkan device: iterations a second, and where the device's time goes.
 *
 *     make bench VULKAN=1 BACKEND=vulkan [BENCH="GAUSSIANS WIDTH HEIGHT [DEVICE [cpu]]"]
 *
 * With OXL_BENCH_PARTS=1 in the environment a step has all parts: lamp, medium, dropout, the loss
 * in front of points.
 *
 * A plane of Gaussians as a survey looks from above, SH degree 3, everything in view. Times of passes are the
 * device's own (timestamps);
 * those of the step are the host's and hold the waiting. The image is on the device, as in training.
 * Bandwidth is read against a copy between two of the device's buffers, arithmetic against multiply-adds in
 * registers, both taken in the same run. Waits of the host, dispatches and bytes sent are counted over the
 * measured steps. cpu: the same steps by the CPU, too, which at 4 million Gaussians takes minutes; it counts
 * the evaluations, without it 256 a pair are taken. Evaluations are those of bench.c: the pixels of the
 * blocks that the footprints ask for, pixel by pixel and splat by splat.
 */
#include "../oceanxl.c"
#include "counts.h"

#ifndef OXL_VULKAN
int main(void)
{
    fputs(
        "bench: this program was built without the Vulkan backend. fix: make bench VULKAN=1 BACKEND=vulkan\n",
        stderr);
    return 1;
}
#else

enum { DEVICE_ROUNDS = 11 };

/* Operations an evaluation, counted in the shaders; each takes the place of a multiply-add: additions,
 * comparisons, selections, a division. What else the passes do (looking which blocks a splat reaches,
 * barriers, adding up what the invocations have) is not work. */
enum {
    DEVICE_SHARE = 3 + 1 + 3 + 6, /* raster.glsl: the exponent; 2 to that; its bounds; T and the weight */
    DEVICE_FORWARD = DEVICE_SHARE + 3,
    DEVICE_BACKWARD = DEVICE_SHARE + 20 /* raster_backward.comp: the gradients, the sums of four pixels */
};

static const char *const DEVICE_PASSES[PASS_COUNT] = {[PASS_PROJECT] = "project",
                                                      [PASS_SCAN] = "scan",
                                                      [PASS_COMPACT] = "compact",
                                                      [PASS_SORT_COUNT] = "sort, count",
                                                      [PASS_SORT_SCATTER] = "sort, scatter",
                                                      [PASS_FOOTPRINT] = "footprint",
                                                      [PASS_RANGES] = "ranges",
                                                      [PASS_RASTER] = "raster",
                                                      [PASS_RASTER_BACKWARD] = "raster backward",
                                                      [PASS_LOSS_FORWARD] = "loss forward",
                                                      [PASS_LOSS_TOTAL] = "loss total",
                                                      [PASS_LOSS_BACKWARD] = "loss backward",
                                                      [PASS_PROJECT_BACKWARD] = "project backward",
                                                      [PASS_STEP] = "backward + Adam",
                                                      [PASS_OBSERVE] = "observe",
                                                      [PASS_SCORE] = "score",
                                                      [PASS_UNPACK] = "unpack",
                                                      [PASS_MOVE] = "move",
                                                      [PASS_LAMP] = "lamp",
                                                      [PASS_IMAGING_PIXELS] = "imaging, pixels",
                                                      [PASS_IMAGING_TOTAL] = "imaging, total",
                                                      [PASS_DEPTH_LOSS] = "depth loss",
                                                      [PASS_PEAK] = "peak"};

struct device_most {    /* what the passes are held against */
    double copy, peak;  /* GB/s; G multiply-adds a second */
    size_t evaluations; /* of a drawing */
};

struct device_counts {
    size_t waits, frame_waits, dispatches, barriers, submissions, sent, read;
};

static struct device_counts device_counts(const struct vulkan *v)
{
    return (struct device_counts){v->waits,       v->frame_waits, v->dispatches, v->barriers,
                                  v->submissions, v->sent,        v->read_bytes};
}

static void device_check(oxl_context *ctx, oxl_result rc)
{
    if (rc == OXL_OK) return;
    fprintf(stderr, "bench: %s\n", oxl_error_text(ctx));
    exit(1);
}

struct device_run {
    struct trained_model trained;
    oxl_model gradient;
    oxl_camera camera;
    struct training_image image;
    float *numbers;
    oxl_point *point; /* (as many as Gaussians) */
    struct renderer *renderer;
};

static void device_begin(oxl_context *ctx, size_t count, int width, int height, struct device_run *r)
{
    oxl_point *point = oxl_calloc(ctx, count, sizeof *point);
    if (!point) device_check(ctx, oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for %zu points", count));
    for (size_t i = 0; i < count; i++)
        for (int a = 0; a < 3; a++) {
            const double u = random_unit(random_bits(7, i, (uint64_t)a)) - 0.5;
            point[i].position[a] = a == 0 ? 4 * u : a == 1 ? 4 * u * height / width : 0.3 * u;
            point[i].rgb[a] = (uint8_t)(random_bits(9, i, (uint64_t)a) & 255);
        }
    device_check(ctx, oxl_model_from_points(ctx, point, count, 3, &r->trained.model));
    r->point = point;
    device_check(ctx, model_trained_begin(ctx, &r->trained));
    device_check(ctx, oxl_model_create(ctx, count, 3, &r->gradient));
    r->camera = (oxl_camera){
        width,    height, width * 0.75, width * 0.75, width / 2.0, height / 2.0, {1, 0, 0, 0, 1, 0, 0, 0, 1},
        {0, 0, 3}};
    r->image =
        (struct training_image){width, height, oxl_alloc(ctx, 3 * (size_t)width * (size_t)height, 1), NULL};
    r->numbers = oxl_calloc(ctx, 3 * count, sizeof *r->numbers);
    if (!r->image.rgb || !r->numbers)
        device_check(ctx, oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for an image"));
    for (size_t i = 0; i < 3 * (size_t)width * (size_t)height; i++)
        r->image.rgb[i] = (uint8_t)random_bits(8, i, 0);
    device_check(ctx, renderer_create(ctx, &r->renderer));
    renderer_settings(r->renderer)->steps = 1;
}

static void device_end(oxl_context *ctx, struct device_run *r)
{
    renderer_free(ctx, r->renderer);
    model_trained_free(ctx, &r->trained);
    oxl_model_free(ctx, &r->gradient);
    oxl_free(ctx, r->image.rgb);
    oxl_free(ctx, r->numbers);
    oxl_free(ctx, r->point);
}

static const struct lamp DEVICE_LAMP = {-1, {0.1f, -0.2f, 0.05f, 0.02f, 0.1f}};
static const struct medium DEVICE_MEDIUM = {
    1, {0.1f, 0.05f, 0.03f}, {0.12f, 0.08f, 0.06f}, {0.1f, 0.3f, 0.5f}, 3};

static void device_set_parts(struct device_run *r)
{
    static const float gain[3] = {1.1f, 1, 0.9f};
    if (!getenv("OXL_BENCH_PARTS")) return;
    *renderer_settings(r->renderer) = (struct renderer_settings){
        .steps = 1, .lamp = &DEVICE_LAMP, .medium = DEVICE_MEDIUM, .gain = gain, .dropout = {0.2, 7, 3}};
}

/* Points all over the image, a little behind the plane. */
static void device_set_points(struct device_run *r)
{
    struct depth_point point[DEPTH_POINTS];
    if (!getenv("OXL_BENCH_PARTS")) return;
    for (int i = 0; i < DEPTH_POINTS; i++)
        point[i] =
            (struct depth_point){(float)(r->camera.width * (i % 16 + 0.5) / 16),
                                 (float)(r->camera.height * (i / 16 + 0.5) / (DEPTH_POINTS / 16)), 4.2f};
    renderer_set_depths(r->renderer, point, DEPTH_POINTS, 1e-4);
}

/* Rates of 0: every round draws the same. */
static void device_step(oxl_context *ctx, struct device_run *r)
{
    const oxl_adam still = {.beta = RENDERER_BETAS, .step = 1};
    oxl_render_options options = oxl_render_options_default();
    struct renderer_loss loss;
    struct renderer_nonfinite skipped;
    struct renderer_sums sums = {.count = r->trained.model.count,
                                 .gradient = r->numbers,
                                 .views = r->numbers + r->trained.model.count};
    options.near_plane = 0.01f;
    device_set_parts(r);
    device_check(ctx, renderer_forward(ctx, r->renderer, &r->trained.model, &r->camera, &options));
    device_check(ctx, renderer_set_image(ctx, r->renderer, 0, &r->image, NULL, 0));
    device_check(ctx, renderer_loss(ctx, r->renderer, NULL, NULL, 0.2f, &loss));
    device_set_points(r);
    device_check(ctx, renderer_backward(ctx, r->renderer, NULL, &r->gradient));
    device_check(ctx, renderer_step(ctx, r->renderer, &r->trained, &r->gradient, &still, &skipped));
    device_check(ctx, renderer_observe(ctx, r->renderer, &sums));
}

/* As training does. */
static void device_deferred_step(oxl_context *ctx, struct device_run *r)
{
    struct renderer_report report;
    device_step(ctx, r);
    device_check(ctx, renderer_report(r->renderer, 0, &report));
    if (report.halt != HALT_NONE) fprintf(stderr, "bench: a step halted (%d)\n", (int)report.halt), exit(1);
}

/* GB/s read and written, from one buffer of 64 MiB to another. */
static double device_copy(oxl_context *ctx)
{
    struct vulkan *v = ctx->backend->vulkan;
    struct vulkan_buffer a = {0}, b = {0};
    const VkBufferCopy copy = {0, 0, 64u << 20};
    double best = 1e9;
    vulkan_reserve(v, &a, 64u << 20, 1, "bytes");
    vulkan_reserve(v, &b, 64u << 20, 1, "bytes");
    for (int round = 0; round < 4; round++) {
        double begun;
        vulkan_record(v);
        device_check(ctx, v->rc);
        for (int k = 0; k < 8; k++) {
            v->CmdCopyBuffer(v->commands, a.handle, b.handle, 1, &copy);
            vulkan_barrier(v);
        }
        begun = os_seconds();
        device_check(ctx, vulkan_finish(v));
        best = OXL_MIN(best, os_seconds() - begun);
    }
    vulkan_release(v, &a);
    vulkan_release(v, &b);
    return 8 * 2 * (double)(64u << 20) / best * 1e-9;
}

/* G multiply-adds a second. As many workgroups as take a while: devices are more than a thousand times apart.
 * */
static double device_peak(oxl_context *ctx)
{
    enum { ROUNDS = 512, EACH = 64 };
    const uint32_t push[3] = {ROUNDS, vulkan_bits(0.999f), vulkan_bits(0.001f)};
    struct vulkan *v = ctx->backend->vulkan;
    struct vulkan_buffer out = {0};
    double best = 0, seconds = 0;
    vulkan_reserve(v, &out, 256, sizeof(float), "numbers");
    for (size_t groups = 16, long_enough = 0; long_enough < 5; groups *= seconds < 0.05 ? 2 : 1) {
        double begun;
        VULKAN_RUN(v, PEAK, 0, groups, push, VULKAN_BUFFERS(&out));
        begun = os_seconds();
        device_check(ctx, vulkan_finish(v));
        seconds = os_seconds() - begun;
        long_enough += seconds >= 0.05;
        best = OXL_MAX(best, 1e-9 * ROUNDS * EACH * VULKAN_GROUP * (double)groups / seconds);
    }
    vulkan_release(v, &out);
    return best;
}

static int device_ascending(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Evaluations a second, and the share of the peak that their operations are. */
static void device_arithmetic(const struct device_most *most, int operations, double seconds)
{
    const double rate = 1e-9 * (double)most->evaluations / seconds;
    printf("   %.3f G evaluations a second, x %d operations: %.1f %% of the peak", rate, operations,
           100 * rate * operations / most->peak);
}

static void device_table(const struct vulkan *v, const struct device_run *r,
                         const double seconds[DEVICE_ROUNDS], const struct device_most *most,
                         const struct device_counts *before, const struct device_counts *now)
{
    const struct vulkan_renderer *d = r->renderer->device;
    const double rounds = DEVICE_ROUNDS, pixels = (double)r->camera.width * r->camera.height;
    const double touched = 4.0 * (double)r->trained.model.count * oxl_model_planes(&r->trained.model);
    double all = 0;
    for (int p = 0; p < PASS_COUNT; p++) all += v->pass_seconds[p];
    printf("%zu Gaussians, SH degree 3, %d x %d px, %zu (tile, splat) pairs, %.1f evaluations a pixel\n",
           r->trained.model.count, r->camera.width, r->camera.height, d->most_pairs,
           (double)most->evaluations / pixels);
    for (int p = 0; p < PASS_COUNT; p++) {
        const double each = v->pass_seconds[p] / rounds;
        if (v->pass_runs[p] == 0) continue;
        printf("  %-19s %9.3f ms %5.1f %%", DEVICE_PASSES[p], 1e3 * each, 100 * v->pass_seconds[p] / all);
        if (p == PASS_STEP)
            printf("   %.1f GB/s, %.0f %% of a copy", 6e-9 * touched / each,
                   6e-7 * touched / each / most->copy);
        if (p == PASS_PROJECT)
            printf("   %.1f GB/s, %.0f %% of a copy", 1e-9 * touched / each,
                   1e-7 * touched / each / most->copy);
        if (p == PASS_RASTER) device_arithmetic(most, DEVICE_FORWARD, each);
        if (p == PASS_RASTER_BACKWARD) device_arithmetic(most, DEVICE_BACKWARD, each);
        printf("\n");
    }
    printf(
        "  a step: %.1f waits, %.1f for the step before, %.1f dispatches, %.1f barriers, %.1f submissions, %.0f bytes sent, %.0f read\n",
        (double)(now->waits - before->waits) / rounds,
        (double)(now->frame_waits - before->frame_waits) / rounds,
        (double)(now->dispatches - before->dispatches) / rounds,
        (double)(now->barriers - before->barriers) / rounds,
        (double)(now->submissions - before->submissions) / rounds,
        (double)(now->sent - before->sent) / rounds, (double)(now->read - before->read) / rounds);
    printf("  %-19s %9.3f ms\n  %-19s %9.3f ms, fastest %.3f: %.1f iterations a second\n", "passes",
           1e3 * all / rounds, "step", 1e3 * seconds[DEVICE_ROUNDS / 2], 1e3 * seconds[0],
           1 / seconds[DEVICE_ROUNDS / 2]);
}

static void device_bench(oxl_context *ctx, size_t count, int width, int height,
                         const struct device_most *most)
{
    struct device_run r;
    struct device_most all = *most;
    struct device_counts before, after;
    double seconds[DEVICE_ROUNDS];
    device_begin(ctx, count, width, height, &r);
    device_step(ctx, &r); /* makes the shaders, and takes the model there */
    renderer_defer(r.renderer, 1);
    for (int k = 0; k < 2; k++) device_deferred_step(ctx, &r); /* and the room */
    vulkan_finish(ctx->backend->vulkan);
    device_check(ctx, vulkan_measure(ctx->backend->vulkan));
    before = device_counts(ctx->backend->vulkan);
    if (all.evaluations == 0)
        all.evaluations = 256 * ((struct vulkan_renderer *)r.renderer->device)->most_pairs;
    for (int k = 0; k < DEVICE_ROUNDS; k++) {
        const double begun = os_seconds();
        device_deferred_step(ctx, &r);
        seconds[k] = os_seconds() - begun;
    }
    after = device_counts(ctx->backend->vulkan);
    device_check(ctx, vulkan_finish(ctx->backend->vulkan)); /* the last one's passes are timed, too */
    qsort(seconds, DEVICE_ROUNDS, sizeof *seconds, device_ascending);
    renderer_defer(r.renderer, 0);
    device_table(ctx->backend->vulkan, &r, seconds, &all, &before, &after);
    device_end(ctx, &r);
}

/* The same steps by the CPU's own kernels, which count the evaluations, too. */
static struct renderer_counts device_cpu(size_t count, int width, int height, double seconds[DEVICE_ROUNDS])
{
    struct device_run r;
    struct renderer_counts counts;
    oxl_context *ctx;
    if (oxl_context_create(NULL, &ctx) != OXL_OK) exit(1);
    device_begin(ctx, count, width, height, &r);
    device_step(ctx, &r);
    for (int k = 0; k < DEVICE_ROUNDS; k++) {
        const double begun = os_seconds();
        device_step(ctx, &r);
        seconds[k] = os_seconds() - begun;
    }
    qsort(seconds, DEVICE_ROUNDS, sizeof *seconds, device_ascending);
    counts = renderer_counts(r.renderer);
    device_end(ctx, &r);
    oxl_context_free(ctx);
    return counts;
}

int main(int argc, char **argv)
{
    oxl_context_options options = oxl_context_options_default();
    const size_t count = argc > 3 ? (size_t)atol(argv[1]) : 30000;
    const int width = argc > 3 ? atoi(argv[2]) : 640, height = argc > 3 ? atoi(argv[3]) : 360;
    oxl_context *ctx;
    struct device_most most;
    double cpu[DEVICE_ROUNDS] = {0};
    options.backend = OXL_BACKEND_VULKAN;
    if (argc > 4) options.device = atoi(argv[4]);
    if (oxl_context_create(&options, &ctx) != OXL_OK) return 1;
    device_check(ctx, oxl_backend_begin(ctx));
    most.evaluations = argc > 5 ? device_cpu(count, width, height, cpu).pixels : 0;
    most.copy = device_copy(ctx);
    most.peak = device_peak(ctx);
    printf("%s: copies %.1f GB/s between its buffers; %.1f G multiply-adds a second in registers\n",
           oxl_backend_name(ctx), most.copy, most.peak);
    device_bench(ctx, count, width, height, &most);
    oxl_context_free(ctx);
    if (argc > 5)
        printf("  %-19s %9.3f ms, fastest %.3f: %.1f iterations a second\n", "the CPU's step",
               1e3 * cpu[DEVICE_ROUNDS / 2], 1e3 * cpu[0], 1 / cpu[DEVICE_ROUNDS / 2]);
    return 0;
}
#endif
