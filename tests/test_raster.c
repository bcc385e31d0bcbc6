/* test_raster.c - binning and compositing against reference/splat.c, which has no tiles; the same bytes
 * whatever runs it.
 *
 * The kernels run from their source in double where each pixel must agree (wide.h), in float for the rest.
 */
#include "test.h"
#include "wide.h"

/* Gaussians of every size, shape and faintness, many of them half or wholly out of the image. Rows 0..lobes-1
 * get second lobes of every kind, up to four times as wide. */
static void raster_scene(struct wide *w, int count, int lobes, int width, int height)
{
    static const struct wide_range range[] = {
        {OXL_LOG_SCALE, 0, 4}, {OXL_ROTATION, -3, 3}, {OXL_OPACITY, 0, 1}, {OXL_SH, 0, 6},
        {OXL_LOBE, 0, 1},      {OXL_LOBE + 1, 0, 4},  {OXL_PLANES, 0.4, 1}};
    const oxl_camera camera = test_camera(width, height, 50, 0, 0, -4);
    wide_create(w, &camera, (size_t)count, (size_t)lobes, 0);
    wide_scatter(w, 25, range);
    wide_to_float(w);
}

/* The largest difference between what the kernels draw and what splat.c does; w has what the kernels drew. */
static double raster_difference(struct wide *w)
{
    const int pixels = w->camera.width * w->camera.height;
    double *plain = wide_array(3 * (size_t)pixels), worst = 0;
    splat_forward(w);
    memcpy(plain, w->rgb, 3 * (size_t)pixels * sizeof *plain);
    kernels_forward(w);
    for (int i = 0; i < 3 * pixels; i++)
        worst = fabs(w->rgb[i] - plain[i]) <= worst ? worst : fabs(w->rgb[i] - plain[i]);
    free(plain);
    return worst;
}

/* The view as the float kernels have it when they have rendered it; the caller frees it. */
static struct renderer *raster_draw(const struct wide *w)
{
    struct renderer *r = test_renderer();
    OWNED_MODEL m;
    CHECK_OK(wide_to_model(test_ctx, w, &m));
    test_draw(r, &m, &w->camera);
    return r;
}

/* Pixel centres of a row of blocks may lie to both sides of the contour's tip: then a block holds no pixel
 * that is lit. Few do. */
TEST(binning_lists_few_blocks_that_no_pixel_needs)
{
    OWNED_WIDE w = {0};
    int listed = 0, lit = 0;
    raster_scene(&w, 600, 0, 160, 128);
    OWNED_RENDERER *r = raster_draw(&w);
    for (int tile = 0; tile < r->bins.tiles_x * r->bins.tiles_y; tile++)
        for (uint32_t i = r->bins.tile_start[tile]; i < r->bins.tile_start[tile + 1]; i++) {
            const struct splat *s = &r->splat[r->bins.pair[i].splat];
            for (int subtile = 0; subtile < TILE_SUBTILES; subtile++) {
                int any = 0;
                if (!(r->bins.pair[i].subtiles >> subtile & 1)) continue;
                for (int l = 0; l < PACK; l++) {
                    const double x = tile % r->bins.tiles_x * TILE + subtile % 4 * 4 + l % 4 + 0.5;
                    const double y = tile / r->bins.tiles_x * TILE + subtile / 4 * 4 + l / 4 + 0.5;
                    const double dy = y - s->v, dx = x - s->u + s->k * dy;
                    any |= s->peak - s->a * dx * dx - s->e * dy * dy >= -log2(255);
                }
                listed++, lit += any;
            }
        }
    CHECK(lit > 10000 && listed < 1.01 * lit);
}

TEST(binning_loses_no_pixel_of_any_splat_or_of_either_lobe)
{
    OWNED_WIDE w = {0}, plain = {0};
    int alone = 0;
    raster_scene(&plain, 600, 0, 61, 47);
    CHECK_CLOSE(raster_difference(&plain), 0, 1e-11);
    raster_scene(&w, 600, 350, 61, 47);
    /* o < 1/255: only its second lobe could show, and that is fainter */
    for (int i = 0; i < 40; i++) w.plane[OXL_OPACITY][i] = -5.6;
    for (int i = 40; i < 80; i++) /* a dot in a disc */
        for (int a = 0; a < 3; a++) w.plane[OXL_LOG_SCALE + a][i] = -6, w.plane[OXL_LOBE + 1 + a][i] = 5;
    OWNED_RENDERER *r = raster_draw(&w);
    for (size_t i = 0; i < 350; i++)
        alone += renderer_row_visible(r, i) && r->lobe[i].half_x > 3 * r->lobe[i].main_x;
    CHECK(kernels_forward(&w) > 100 && alone > 10);
    CHECK_CLOSE(raster_difference(&w), 0, 1e-10);
}

TEST(binning_and_raster_leave_out_exactly_what_is_fainter_than_asked)
{
    for (int lobes = 0; lobes <= 350; lobes += 350) {
        OWNED_WIDE w = {0}, usual = {0};
        double difference = 0;
        raster_scene(&w, 600, lobes, 61, 47);
        raster_scene(&usual, 600, lobes, 61, 47);
        w.alpha_min = 0.05;
        CHECK(kernels_forward(&w) < kernels_forward(&usual));
        CHECK_CLOSE(raster_difference(&w), 0, 1e-10);
        for (int i = 0; i < 61 * 47; i++) difference += fabs(w.rgb[i] - usual.rgb[i]) / (61 * 47);
        CHECK(difference > 1e-3);
    }
}

TEST(negative_alpha_lets_no_pixel_grow_past_32)
{
    OWNED_WIDE w = {0};
    double most = 0;
    raster_scene(&w, 64, 64, 40, 40);
    for (int i = 0; i < 64; i++) {
        w.plane[OXL_MEAN][i] = w.plane[OXL_MEAN + 1][i] = 0;
        w.plane[OXL_OPACITY][i] = 8, w.plane[OXL_LOBE][i] = 8;
        for (int a = 0; a < 3; a++) w.plane[OXL_LOG_SCALE + a][i] = -2, w.plane[OXL_LOBE + 1 + a][i] = 1.5;
    }
    CHECK_CLOSE(raster_difference(&w), 0, 1e-9);
    for (int i = 0; i < 1600; i++) most = OXL_MAX(most, w.transmittance[i]);
    CHECK(most >= 16 && most < 32);
}

/* Four plain splats end the pixels in the middle; in the same batch alpha is negative behind them. */
TEST(pixel_below_the_minimum_transmittance_stays_ended_where_alpha_is_negative)
{
    OWNED_WIDE w = {0};
    raster_scene(&w, 16, 12, 40, 40);
    for (int i = 0; i < 16; i++) {
        const int lobed = i < 12;
        w.plane[OXL_MEAN][i] = w.plane[OXL_MEAN + 1][i] = 0, w.plane[OXL_MEAN + 2][i] = lobed ? 1 : -1;
        w.plane[OXL_OPACITY][i] = (float)(lobed ? 8 : 3 + 0.01 * i); /* no T falls on 1e-4 itself */
        if (lobed) w.plane[OXL_LOBE][i] = 8;
        for (int a = 0; a < 3; a++) w.plane[OXL_LOG_SCALE + a][i] = lobed ? -2 : -1;
        for (int a = 0; lobed && a < 3; a++) w.plane[OXL_LOBE + 1 + a][i] = 1.5;
    }
    CHECK_CLOSE(raster_difference(&w), 0, 1e-9);
    CHECK(w.transmittance[20 * 40 + 20] < 0.01);
}

TEST(binning_lists_each_tile_in_depth_order_with_ties_by_row)
{
    OWNED_WIDE w = {0};
    raster_scene(&w, 400, 0, 64, 64);
    for (int i = 0; i < 400; i++) w.plane[OXL_MEAN + 2][i] = i % 7 * 0.25;
    OWNED_RENDERER *r = raster_draw(&w);
    for (int tile = 0; tile < 16; tile++)
        for (uint32_t i = r->bins.tile_start[tile] + 1; i < r->bins.tile_start[tile + 1]; i++) {
            const uint32_t a = r->bins.pair[i - 1].splat, b = r->bins.pair[i].splat;
            CHECK(r->splat[a].depth < r->splat[b].depth || (r->splat[a].depth == r->splat[b].depth && a < b));
        }
}

/* ---------------- the score */

enum { SCORE_COUNT = 600, SCORE_WIDTH = 61, SCORE_HEIGHT = 47 };

static void raster_score_case(struct wide *w, int lobes, double *drgb)
{
    raster_scene(w, SCORE_COUNT, lobes, SCORE_WIDTH, SCORE_HEIGHT);
    for (int c = 0; c < 3; c++) w->background[c] = 0.3 * c;
    for (int i = 0; i < 3 * SCORE_WIDTH * SCORE_HEIGHT; i++)
        drgb[i] = (float)(1 + 0.3 * random_unit(random_bits(4, (uint64_t)i, 0)));
}

TEST(raster_score_is_the_sum_of_squared_slopes_of_every_pixel)
{
    struct wide w;
    static double drgb[3 * SCORE_WIDTH * SCORE_HEIGHT], score[SCORE_COUNT], plain[SCORE_COUNT];
    double largest = 0;
    for (int lobes = 0; lobes <= 200; lobes += 200) {
        raster_score_case(&w, lobes, drgb);
        memset(score, 0, sizeof score), memset(plain, 0, sizeof plain);
        kernels_score(&w, drgb, score);
        splat_score(&w, drgb, plain);
        for (int i = 0; i < SCORE_COUNT; i++) largest = OXL_MAX(largest, plain[i]);
        CHECK(largest > 1);
        for (int i = 0; i < SCORE_COUNT; i++) CHECK_CLOSE(score[i], plain[i], 1e-9 * largest);
        wide_free(&w);
    }
}

/* The float kernels against double, and against itself with other threads and another vector width. */
TEST(renderer_score_adds_up_and_does_not_depend_on_threads_or_vectors)
{
    const int threads = test_ctx->threads, isa = test_ctx->isa;
    OWNED_WIDE r = {0};
    OWNED_RENDERER *renderer = test_renderer();
    OWNED_MODEL m;
    oxl_render_options options = oxl_render_options_default();
    static double drgb[3 * SCORE_WIDTH * SCORE_HEIGHT], exact[SCORE_COUNT];
    static float narrow[3 * SCORE_WIDTH * SCORE_HEIGHT], score[3][SCORE_COUNT];
    double total = 0, off = 0;
    raster_score_case(&r, 0, drgb);
    kernels_score(&r, drgb, exact);
    for (size_t i = 0; i < OXL_COUNT(narrow); i++) narrow[i] = (float)drgb[i];
    for (int c = 0; c < 3; c++) options.background[c] = (float)r.background[c];
    CHECK_OK(wide_to_model(test_ctx, &r, &m));
    CHECK_OK(renderer_forward(test_ctx, renderer, &m, &r.camera, &options));
    test_ctx->threads = 1;
    CHECK_OK(renderer_score(test_ctx, renderer, narrow, score[0]));
    test_ctx->threads = 7;
    test_ctx->isa = OXL_MIN(isa, ISA_AVX2);
    for (int twice = 0; twice < 2; twice++)
        CHECK_OK(renderer_score(test_ctx, renderer, narrow, score[1 + twice]));
    CHECK_OK(renderer_score(test_ctx, renderer, narrow, score[2]));
    test_ctx->threads = threads;
    test_ctx->isa = isa;
    CHECK(!memcmp(score[0], score[1], sizeof score[0]));
    for (int i = 0; i < SCORE_COUNT; i++) {
        CHECK(score[2][i] == 2 * score[0][i]);
        total += exact[i], off += fabs(score[0][i] - exact[i]);
    }
    CHECK(off < 1e-3 * total); /* a decision that falls the other way in float moves a pixel's share */
}

/* ---------------- dropout */

enum { DROP_SIDE = 64, DROP_COUNT = 400 };

/* The sum of all channels with dropout. */
static double raster_dropped_sum(struct renderer *r, const oxl_model *m, const oxl_camera *camera,
                                 double share)
{
    double sum = 0;
    renderer_settings(r)->dropout = (struct renderer_dropout){share, 7, 3};
    const float *rgb = test_draw(r, m, camera);
    for (int i = 0; i < 3 * DROP_SIDE * DROP_SIDE; i++) sum += (double)rgb[i];
    return sum;
}

TEST(renderer_dropout_leaves_out_its_share_and_divides_the_opacity_of_the_rest_with_the_gradient_of_that)
{
    static float ones[3 * DROP_SIDE * DROP_SIDE];
    OWNED_WIDE w = {0};
    OWNED_MODEL m = {0};
    float peak[DROP_COUNT];
    int shown[DROP_COUNT], before = 0, after = 0;
    size_t only = 0;
    raster_scene(&w, DROP_COUNT, 0, DROP_SIDE, DROP_SIDE);
    CHECK_OK(wide_to_model(test_ctx, &w, &m));
    for (int i = 0; i < 3 * DROP_SIDE * DROP_SIDE; i++) ones[i] = 1;
    OWNED_RENDERER *r = test_renderer();
    renderer_use_cpu(r);
    test_draw(r, &m, &w.camera);
    for (size_t i = 0; i < DROP_COUNT; i++)
        shown[i] = renderer_row_visible(r, i), peak[i] = r->splat[i].peak, before += shown[i];
    (void)raster_dropped_sum(r, &m, &w.camera, 0.5);
    for (size_t i = 0; i < DROP_COUNT; i++) {
        if (!renderer_row_visible(r, i)) continue;
        CHECK(shown[i]);
        CHECK_CLOSE(r->splat[i].peak, peak[i] + 1, 1e-5); /* log2: twice the opacity */
        after++;
    }
    CHECK(after > 0.4 * before && after < 0.6 * before);
    while (only < DROP_COUNT && !renderer_row_visible(r, only)) only++;
    for (size_t i = 0; i < DROP_COUNT; i++) m.plane[OXL_OPACITY][i] = i == only ? -1 : -20;
    double sum =
        raster_dropped_sum(r, &m, &w.camera, 0.5); /* alone, of alpha = 2 o G: dL / dlogit = (1 - o) L */
    OWNED_MODEL gradient = test_model(m.count, m.sh_degree);
    CHECK_OK(renderer_backward(test_ctx, r, ones, &gradient));
    CHECK(sum > 1);
    CHECK_CLOSE(gradient.plane[OXL_OPACITY][only], sum * vecmath_sigmoid(1), 1e-4 * sum);
}

/* ---------------- what else it draws */

TEST(raster_shows_the_background_where_there_is_nothing)
{
    const oxl_camera camera = test_camera(20, 10, 30, 0, 0, 0);
    oxl_render_options options = oxl_render_options_default();
    OWNED_IMAGE image = {0};
    float depth[200];
    options.background[2] = 0.75f;
    OWNED_MODEL m = test_model(0, 0);
    CHECK_OK(oxl_render(test_ctx, &m, &camera, &options, &image, depth));
    CHECK(image.rgb[0] == 0 && image.rgb[400] == 0.75f && image.rgb[599] == 0.75f && depth[7] == 0);
}

/* ---------------- independent of threads and vector width */

struct raster_result {
    oxl_image image;
    oxl_model gradient;
};

enum { RASTER_WIDTH = 113, RASTER_HEIGHT = 71, RASTER_VALUES = 3 * RASTER_WIDTH * RASTER_HEIGHT };

/* Looks past the middle. */
static void raster_run_scene(struct wide *w, int count, int lobes, oxl_model *m)
{
    raster_scene(w, count, lobes, RASTER_WIDTH, RASTER_HEIGHT);
    w->camera.cx = 60, w->camera.cy = 30;
    CHECK_OK(wide_to_model(test_ctx, w, m));
}

static struct raster_result raster_of(const oxl_model *m, const oxl_camera *camera)
{
    struct raster_result out;
    static float drgb[RASTER_VALUES];
    for (size_t i = 0; i < OXL_COUNT(drgb); i++) drgb[i] = (float)random_unit(random_bits(3, i, 0)) - 0.5f;
    out.image = test_render(m, camera);
    CHECK_OK(oxl_render_backward(test_ctx, m, camera, NULL, drgb, &out.gradient));
    return out;
}

static struct raster_result raster_run(int threads, int isa, int lobes)
{
    const int threads_before = test_ctx->threads, isa_before = test_ctx->isa;
    OWNED_WIDE w = {0};
    OWNED_MODEL m;
    raster_run_scene(&w, 3000, lobes, &m);
    test_ctx->threads = threads;
    test_ctx->isa = isa;
    struct raster_result out = raster_of(&m, &w.camera);
    test_ctx->threads = threads_before;
    test_ctx->isa = isa_before;
    return out;
}

/* The image of 113 x 71 px of raster_run's scene. */
static double raster_mean_difference(const oxl_image *a, const double *b)
{
    double sum = 0;
    for (int i = 0; i < RASTER_VALUES; i++) sum += fabs(a->rgb[i] - b[i]) / RASTER_VALUES;
    return sum;
}

TEST(render_option_alpha_min_is_what_the_kernels_get_and_at_least_1_of_255)
{
    oxl_render_options options = oxl_render_options_default();
    OWNED_WIDE r = {0};
    OWNED_MODEL m = {0};
    oxl_image image[3]; /* asked for 1/255, 0, 0.05 */
    raster_run_scene(&r, 1000, 0, &m);
    r.near_plane = options.near_plane, r.alpha_min = 0.05;
    for (int i = 0; i < 3; i++) {
        options.alpha_min = i == 0 ? options.alpha_min : i == 1 ? 0 : 0.05f;
        CHECK_OK(oxl_render(test_ctx, &m, &r.camera, &options, &image[i], NULL));
    }
    kernels_forward(&r);
    CHECK(memcmp(image[0].rgb, image[1].rgb, sizeof(float) * RASTER_VALUES) == 0);
    CHECK(raster_mean_difference(&image[2], r.rgb) < 2e-5);
    CHECK(raster_mean_difference(&image[0], r.rgb) > 1e-3);
    for (int i = 0; i < 3; i++) oxl_image_free(test_ctx, &image[i]);
}

static void raster_result_free(struct raster_result *a)
{
    oxl_image_free(test_ctx, &a->image);
    oxl_model_free(test_ctx, &a->gradient);
}

static int raster_same(const struct raster_result *a, const struct raster_result *b)
{
    return !memcmp(a->image.rgb, b->image.rgb, sizeof(float) * RASTER_VALUES) &&
           test_same_model(&a->gradient, &b->gradient);
}

TEST(image_and_gradient_are_the_same_bytes_with_1_2_and_7_threads)
{
    for (int lobes = 0; lobes <= 900; lobes += 900) {
        struct raster_result one = raster_run(1, test_ctx->isa, lobes),
                             two = raster_run(2, test_ctx->isa, lobes),
                             seven = raster_run(7, test_ctx->isa, lobes);
        CHECK(one.gradient.lobes == (size_t)lobes && raster_same(&one, &two) && raster_same(&one, &seven));
        raster_result_free(&one);
        raster_result_free(&two);
        raster_result_free(&seven);
    }
}

TEST(image_and_gradient_are_the_same_bytes_with_avx2_and_avx512)
{
    struct raster_result wide, narrow;
    if (test_ctx->isa != ISA_AVX512) SKIP("this machine has no AVX-512");
    for (int lobes = 0; lobes <= 900; lobes += 900) {
        wide = raster_run(2, ISA_AVX512, lobes);
        narrow = raster_run(2, ISA_AVX2, lobes);
        CHECK(raster_same(&wide, &narrow));
        raster_result_free(&wide);
        raster_result_free(&narrow);
    }
}

TEST(base_instruction_set_differs_by_rounding_alone)
{
    struct raster_result best = raster_run(1, test_ctx->isa, 900), base = raster_run(1, ISA_BASE, 900);
    int off = 0;
    for (int i = 0; i < RASTER_VALUES; i++) off += fabsf(best.image.rgb[i] - base.image.rgb[i]) > 1e-5f;
    CHECK(off < RASTER_VALUES / 500);
    raster_result_free(&best);
    raster_result_free(&base);
}

/* One invisible row with a lobe sends the whole image through the passes for mixed batches. */
TEST(plain_splats_have_the_same_bytes_beside_lobed_ones)
{
    OWNED_WIDE w = {0};
    OWNED_MODEL m = {0};
    raster_run_scene(&w, 3000, 0, &m);
    m.plane[OXL_MEAN + 2][0] = -50;
    struct raster_result plain = raster_of(&m, &w.camera);
    CHECK_OK(model_set_lobes(test_ctx, &m, 1));
    struct raster_result beside = raster_of(&m, &w.camera);
    CHECK(beside.gradient.lobes == 1 && beside.gradient.plane[OXL_LOBE][0] == 0);
    beside.gradient.lobes = 0;
    CHECK(raster_same(&plain, &beside));
    raster_result_free(&plain);
    raster_result_free(&beside);
}
