/* bench.c - where the time of a training step goes, beside what the machine can do at most, measured in the
 * same run.
 *
 *     make bench                          fixed synthetic inputs
 *     build/bench SCENE [MAX_SIDE...]     a real survey at its starting model, for each size
 *
 * Machines are shared and noisy: read the ratios to the ceilings more than the milliseconds, and on a busy
 * one the fastest round more than the median.
 */
#include "../oceanxl.c"
#include "counts.h"

enum { BENCH_ROUNDS = 21 };

/* Sorts x. */
static double bench_median(double *x, int n)
{
    for (int i = 1; i < n; i++)
        for (int j = i; j > 0 && x[j] < x[j - 1]; j--) OXL_SWAP(double, x[j], x[j - 1]);
    return x[n / 2];
}

static void bench_check(oxl_context *ctx, oxl_result rc)
{
    if (rc == OXL_OK) return;
    fprintf(stderr, "bench: %s\n", oxl_error_text(ctx));
    exit(1);
}

/* ---------------- ceilings */

struct bench_ceiling {
    double forward, backward; /* G alpha evaluations a second, everything in the first-level cache, */
    double spin;              /* G multiply-adds a second, everything in registers: of all threads at once, */
    double one[3];            /* and the same three of one thread alone */
    double triad;             /* GB/s on all threads: a = b + s c over arrays past the caches */
};

enum { BENCH_SPLATS = 64, BENCH_REPEAT = 40, BENCH_CHAINS = 12 };

/* One tile, 64 faint splats that cover all of it: the kernels without binning, gathering or cache misses.
 * Each thread has its own. */
struct bench_tile {
    struct splat splat[BENCH_SPLATS];
    struct pair pair[BENCH_SPLATS];
    float rgb[3 * TILE_PIXELS], transmittance[TILE_PIXELS], drgb[3 * TILE_PIXELS];
    float sums[BENCH_SPLATS][SPLAT_SUMS];
    uint32_t start[2];
    struct bins bins;
    struct raster_job job;
    float spin[BENCH_CHAINS][PACK];
};

static void bench_tile(struct bench_tile *t)
{
    t->start[1] = BENCH_SPLATS;
    t->bins = (struct bins){.tiles_x = 1,
                            .tiles_y = 1,
                            .alpha_min = ALPHA_MIN,
                            .cutoff_bits = LOG2_255,
                            .splat = t->splat,
                            .pair = t->pair,
                            .tile_start = t->start};
    t->job = (struct raster_job){.bins = &t->bins,
                                 .width = TILE,
                                 .height = TILE,
                                 .rgb = t->rgb,
                                 .transmittance = t->transmittance,
                                 .drgb = t->drgb,
                                 .sums = t->sums};
    for (int i = 0; i < BENCH_SPLATS; i++) {
        t->splat[i] = (struct splat){
            .u = 8, .v = 8, .a = 0.001f, .k = 0.1f, .e = 0.001f, .peak = -5, .colour = {0.5f, 0.4f, 0.3f}};
        t->pair[i] = (struct pair){(uint32_t)i, (uint32_t)i, 0xFFFF};
    }
    for (int i = 0; i < 3 * TILE_PIXELS; i++) t->drgb[i] = (float)(i % 7) - 3;
}

struct bench_chains {
    float (*x)[PACK]; /* (BENCH_CHAINS, PACK) */
};

/* As many multiply-adds as the tile has alpha evaluations, BENCH_CHAINS at a time. */
SIMD_BODY void bench_spin_body(const int fused, const struct bench_chains *job)
{
    float x[BENCH_CHAINS][PACK];
    memcpy(x, job->x, sizeof x);
    for (int i = 0; i < BENCH_SPLATS * TILE_PIXELS; i += BENCH_CHAINS * PACK)
        for (int chain = 0; chain < BENCH_CHAINS; chain++) {
#pragma omp simd
            for (int l = 0; l < PACK; l++) x[chain][l] = muladd(fused, x[chain][l], 0.999f, 0.001f);
        }
    memcpy(job->x, x, sizeof x);
}
SIMD_DISPATCH(static, bench_spin, struct bench_chains)

static double bench_kernel(oxl_context *ctx, int kernel, int threads, struct bench_tile *tiles)
{
    double least = DBL_MAX;
    for (int round = 0; round < 5 * BENCH_ROUNDS; round++) {
        double t = os_seconds();
#pragma omp parallel for schedule(static) num_threads(threads)
        for (int thread = 0; thread < threads; thread++) {
            const struct bench_chains chains = {tiles[thread].spin};
            for (int i = 0; i < BENCH_REPEAT; i++) {
                if (kernel == 0) raster_forward(ctx->isa, &tiles[thread].job);
                else if (kernel == 1) raster_backward(ctx->isa, &tiles[thread].job);
                else bench_spin(ctx->isa, &chains);
            }
        }
        t = os_seconds() - t;
        least = OXL_MIN(least, t); /* it is a ceiling */
    }
    return 1e-9 * BENCH_SPLATS * TILE_PIXELS * BENCH_REPEAT * threads / least;
}

static void bench_kernel_ceiling(oxl_context *ctx, struct bench_ceiling *out)
{
    struct bench_tile *tiles = oxl_calloc(ctx, (size_t)ctx->threads, sizeof *tiles);
    if (!tiles) bench_check(ctx, oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for the tiles"));
    for (int thread = 0; thread < ctx->threads; thread++) bench_tile(&tiles[thread]);
    for (int kernel = 0; kernel < 3; kernel++) out->one[kernel] = bench_kernel(ctx, kernel, 1, tiles);
    out->forward = bench_kernel(ctx, 0, ctx->threads, tiles);
    out->backward = bench_kernel(ctx, 1, ctx->threads, tiles);
    out->spin = bench_kernel(ctx, 2, ctx->threads, tiles);
    oxl_free(ctx, tiles);
}

static void bench_triad(oxl_context *ctx, struct bench_ceiling *out)
{
    const int64_t n = 1 << 24;
    float *a = oxl_calloc(ctx, (size_t)n, 4), *b = oxl_calloc(ctx, (size_t)n, 4),
          *c = oxl_calloc(ctx, (size_t)n, 4);
    double times[5];
    if (!a || !b || !c) bench_check(ctx, oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for the triad"));
    for (int round = 0; round < 5; round++) {
        const double t = os_seconds();
#pragma omp parallel for schedule(static) num_threads(ctx->threads)
        for (int64_t i = 0; i < n; i++) a[i] = b[i] + 3 * c[i];
        times[round] = os_seconds() - t;
    }
    out->triad = 12e-9 * (double)n / bench_median(times, 5);
    oxl_free(ctx, a);
    oxl_free(ctx, b);
    oxl_free(ctx, c);
}

/* ---------------- the stages of a step */

enum bench_stage {
    STAGE_PROJECT,
    STAGE_BIN,
    STAGE_RASTER,
    STAGE_LOSS,
    STAGE_RASTER_BACK,
    STAGE_STEP, /* project backward, and Adam at once */
    STAGES
};
static const char *const BENCH_NAMES[STAGES] = {
    "project", "bin", "raster forward", "loss, there and back", "raster backward", "project back, Adam"};

struct bench_input {
    const char *name;
    struct trained_model trained;
    oxl_camera camera;
    float *target;
    float near_plane;
};

static void bench_step(oxl_context *ctx, struct renderer *r, struct bench_input *in, double seconds[STAGES])
{
    oxl_render_options o = oxl_render_options_default();
    struct renderer_loss loss;
    struct renderer_nonfinite skipped;
    const oxl_adam still = {.beta = RENDERER_BETAS, .step = 1};
    double t[STAGES + 1];
    o.near_plane = in->near_plane;
    render_take_view(r, &in->trained.model, &in->camera, &o);
    bench_check(ctx, render_begin(ctx, r, &in->trained.model, &in->camera, &o));
    t[0] = os_seconds();
    render_project(ctx, r);
    t[1] = os_seconds();
    bench_check(ctx, bin_splats(ctx, &r->bins, in->camera.width, in->camera.height));
    t[2] = os_seconds();
    render_each_tile(ctx, r, NULL, raster_forward);
    t[3] = os_seconds();
    bench_check(ctx, renderer_loss(ctx, r, in->target, NULL, 0.2f, &loss));
    t[4] = os_seconds();
    bench_check(ctx, renderer_backward(ctx, r, NULL, NULL));
    t[5] = os_seconds();
    bench_check(ctx, renderer_step(ctx, r, &in->trained, NULL, &still, &skipped));
    t[6] = os_seconds();
    for (int s = 0; s < STAGES; s++) seconds[s] = t[s + 1] - t[s];
}

static void bench_input_end(oxl_context *ctx, struct bench_input *in)
{
    model_trained_free(ctx, &in->trained);
    oxl_free(ctx, in->target);
}

static void bench_table(oxl_context *ctx, struct bench_input *in, const struct bench_ceiling *ceiling)
{
    static double seconds[STAGES][BENCH_ROUNDS];
    double one[STAGES], total = 0, least = 0, median[STAGES];
    struct renderer *r = NULL;
    struct renderer_counts n;
    bench_check(ctx, renderer_create(ctx, &r));
    bench_step(ctx, r, in, one);
    for (int round = 0; round < BENCH_ROUNDS; round++) {
        bench_step(ctx, r, in, one);
        for (int s = 0; s < STAGES; s++) seconds[s][round] = one[s];
    }
    n = renderer_counts(r);
    for (int s = 0; s < STAGES; s++) {
        total += median[s] = bench_median(seconds[s], BENCH_ROUNDS);
        least += seconds[s][0];
    }
    printf("\n%s: %d x %d px, %zu Gaussians, SH degree %d, %d threads, %s\n", in->name, in->camera.width,
           in->camera.height, in->trained.model.count, in->trained.model.sh_degree, ctx->threads,
           oxl_isa_name(ctx));
    printf(
        "  %zu visible, %zu (tile, splat) pairs, %.3f M alpha evaluations in %.3f M block lanes: %.1f a pixel\n",
        n.visible, n.pairs, n.pixels * 1e-6, n.subtiles * 16e-6,
        (double)n.pixels / in->camera.width / in->camera.height);
    for (int s = 0; s < STAGES; s++) {
        printf("  %-22s %8.3f ms, fastest %8.3f %5.1f %%", BENCH_NAMES[s], 1e3 * median[s],
               1e3 * seconds[s][0], 100 * median[s] / total);
        if (s == STAGE_RASTER || s == STAGE_RASTER_BACK) {
            const double rate = 1e-9 * (double)n.pixels / seconds[s][0];
            const double most = s == STAGE_RASTER ? ceiling->forward : ceiling->backward;
            printf("   %.2f Gpairs/s, %.0f %% of the ceiling", rate, 100 * rate / most);
        }
        printf("\n");
    }
    printf("  %-22s %8.3f ms, fastest %8.3f\n", "step", 1e3 * total, 1e3 * least);
    renderer_free(ctx, r);
}

/* ---------------- inputs */

/* A plane of Gaussians before the camera, as a survey looks from above; every second number from random_bits,
 * so the same everywhere. */
static struct bench_input bench_synthetic(oxl_context *ctx, const char *name, size_t count, int width,
                                          int height, double spread)
{
    struct bench_input in = {.name = name, .near_plane = 0.01f};
    oxl_point *point = oxl_calloc(ctx, count, sizeof *point);
    if (!point) bench_check(ctx, oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for %zu points", count));
    for (size_t i = 0; i < count; i++) {
        for (int a = 0; a < 3; a++) {
            const double u = random_unit(random_bits(7, i, (uint64_t)a)) - 0.5;
            point[i].position[a] = a == 0   ? 4 * spread * u
                                   : a == 1 ? 4 * spread * u * height / width
                                            : 0.3 * u;
            point[i].rgb[a] = (uint8_t)(random_bits(9, i, (uint64_t)a) & 255);
        }
    }
    bench_check(ctx, oxl_model_from_points(ctx, point, count, 3, &in.trained.model));
    oxl_free(ctx, point);
    in.camera = (oxl_camera){
        width,    height, width * 0.75, width * 0.75, width / 2.0, height / 2.0, {1, 0, 0, 0, 1, 0, 0, 0, 1},
        {0, 0, 3}};
    in.target = oxl_alloc(ctx, 3 * (size_t)width * (size_t)height, sizeof *in.target);
    if (!in.target) bench_check(ctx, oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for an image"));
    for (size_t i = 0; i < 3 * (size_t)width * (size_t)height; i++)
        in.target[i] = (float)random_unit(random_bits(8, i, 0));
    bench_check(ctx, model_trained_begin(ctx, &in.trained));
    return in;
}

static struct bench_input bench_survey(oxl_context *ctx, const char *path, int max_side, int degree)
{
    struct bench_input in = {.name = path};
    oxl_scene_options options = oxl_scene_options_default();
    oxl_scene *scene = NULL;
    oxl_image image;
    options.max_side = max_side;
    bench_check(ctx, oxl_scene_load(ctx, path, &options, &scene));
    bench_check(ctx, oxl_model_from_points(ctx, oxl_scene_points(scene), oxl_scene_point_count(scene), degree,
                                           &in.trained.model));
    in.camera = oxl_scene_view(scene, 1)->camera;
    in.near_plane = (float)oxl_scene_near_plane(scene);
    bench_check(ctx, oxl_scene_image(ctx, scene, 1, NULL, &image));
    in.target = image.rgb;
    oxl_free(ctx, image.weight);
    oxl_scene_free(ctx, scene);
    bench_check(ctx, model_trained_begin(ctx, &in.trained));
    return in;
}

int main(int argc, char **argv)
{
    oxl_context *ctx = NULL;
    struct bench_ceiling ceiling = {0};
    struct bench_input in;
    if (oxl_context_create(NULL, &ctx) != OXL_OK) return 1;
    bench_kernel_ceiling(ctx, &ceiling);
    bench_triad(ctx, &ceiling);
    printf(
        "ceilings (%s), %d threads at once, and one alone:\n"
        "  %.2f (%.2f) Gpairs/s forward, %.2f (%.2f) backward, in cache; %.1f (%.1f) G multiply-adds/s in registers: %.0f %% of\n"
        "  what as many cores would do; %.1f GB/s triad\n",
        oxl_isa_name(ctx), ctx->threads, ceiling.forward, ceiling.one[0], ceiling.backward, ceiling.one[1],
        ceiling.spin, ceiling.one[2], 100 * ceiling.spin / ceiling.one[2] / ctx->threads, ceiling.triad);
    if (argc > 1) {
        for (int i = 2; i < OXL_MAX(argc, 3); i++) {
            in = bench_survey(ctx, argv[1], i < argc ? atoi(argv[i]) : 1600, 0);
            bench_table(ctx, &in, &ceiling);
            bench_input_end(ctx, &in);
        }
    } else {
        in = bench_synthetic(ctx, "seabed, all in view", 30000, 640, 360, 1);
        bench_table(ctx, &in, &ceiling);
        bench_input_end(ctx, &in);
        in = bench_synthetic(ctx, "seabed, a ninth in view", 300000, 640, 360, 3);
        bench_table(ctx, &in, &ceiling);
        bench_input_end(ctx, &in);
    }
    oxl_context_free(ctx);
    return 0;
}
