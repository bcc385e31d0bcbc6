/* test_depth.c - the depth of a pixel is that of the surface, also behind a veil; parallel rays see the ground
 * from straight above. */
#include "test.h"

/* A sphere of one Gaussian on the camera's axis. */
static void depth_test_set(oxl_model *m, size_t row, double z, double alpha, double size)
{
    m->plane[OXL_MEAN + 2][row] = (float)z;
    m->plane[OXL_OPACITY][row] = (float)log(alpha / (1 - alpha));
    for (int a = 0; a < 3; a++) m->plane[OXL_LOG_SCALE + a][row] = (float)log(size);
}

static const oxl_camera DEPTH_TEST_CAMERA = {32, 32, 40, 40, 16, 16, {1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 0}};

/* The depth at the image's middle of Gaussians at z of opacity alpha. */
static double depth_test_of(int count, const double *z, const double *alpha)
{
    OWNED_IMAGE image;
    float depth[32 * 32];
    OWNED_MODEL m = test_model((size_t)count, 0);
    for (int i = 0; i < count; i++) depth_test_set(&m, (size_t)i, z[i], alpha[i], 3);
    CHECK_OK(oxl_render(test_ctx, &m, &DEPTH_TEST_CAMERA, NULL, &image, depth));
    return (double)depth[16 * 32 + 16];
}

TEST(depth_is_that_of_the_surface_behind_a_veil_and_before_what_shines_through)
{
    CHECK_CLOSE(depth_test_of(2, (double[]){2.5, 9}, (double[]){0.3, 0.98}), 9, 1e-5);
    CHECK_CLOSE(depth_test_of(2, (double[]){2.5, 9}, (double[]){0.7, 0.98}), 2.5, 1e-5);
    /* less than half of the weight is at 3 and before, more than at any other place */
    CHECK_CLOSE(depth_test_of(4, (double[]){3, 5, 7, 9}, (double[]){0.4, 0.4, 0.5, 0.98}), 3, 1e-5);
}

/* Splats of one surface, 0.9 % of their depth apart: alpha T of 0.4, 0.3 and 0.21. */
TEST(depth_is_averaged_over_the_layer)
{
    CHECK_CLOSE(depth_test_of(3, (double[]){9, 9.08, 9.16}, (double[]){0.4, 0.5, 0.7}),
                (9 * 0.4 + 9.08 * 0.3 + 9.16 * 0.21) / 0.91, 2e-3);
}

TEST(depth_is_negative_where_it_is_uncertain_and_missing_where_the_model_is_see_through)
{
    CHECK(depth_test_of(2, (double[]){5, 6}, (double[]){0.2, 0.3}) == 0); /* a weight of 0.44 */
    CHECK(depth_test_of(2, (double[]){5, 6}, (double[]){0.35, 0.3}) > 0); /* of 0.54, 0.35 of it at 5 */
    CHECK_CLOSE(depth_test_of(3, (double[]){5, 6, 7}, (double[]){0.3, 0.3, 0.3}), -5, 1e-5);
}

static double depth_test_random(size_t row, uint64_t plane)
{
    return random_unit(random_bits(1, row, plane));
}

static oxl_model depth_test_model(size_t count, size_t lobes)
{
    oxl_model m = test_model(count, 0);
    CHECK_OK(model_set_lobes(test_ctx, &m, lobes));
    for (size_t i = 0; i < count; i++) {
        depth_test_set(&m, i, 3 + 5 * depth_test_random(i, 0), 0.1 + 0.8 * depth_test_random(i, 1), 0.5);
        for (int a = 0; a < 2; a++)
            m.plane[OXL_MEAN + a][i] = (float)(4 * depth_test_random(i, 2 + (uint64_t)a) - 2);
        for (int a = 0; a < 3; a++)
            m.plane[OXL_LOG_SCALE + a][i] += (float)(2 * depth_test_random(i, 4 + (uint64_t)a) - 1);
        if (i < lobes) m.plane[OXL_LOBE][i] = 0, m.plane[OXL_LOBE + 1][i] = -0.7f;
    }
    return m;
}

static double depth_test_alpha(double a, double k, double e, double peak, double x, double y, double least)
{
    const double w = x + k * y, exponent = peak - a * w * w - e * y * y;
    return exponent < least ? 0 : fmin(exp2(exponent), 0.99);
}

struct depth_test_layer {
    double weight, t, z;
};

/* What a pixel's splats add, by the binning of `r`, in double. Returns their number. */
static int depth_test_layers(const struct bins *b, int x, int y, struct depth_test_layer out[400])
{
    const int tile = y / TILE * b->tiles_x + x / TILE;
    double t = 1;
    int n = 0;
    for (uint32_t q = b->tile_start[tile]; q < b->tile_start[tile + 1]; q++) {
        const struct splat *s = &b->splat[b->pair[q].splat];
        const struct lobe *o = bins_lobe(b, b->pair[q].splat);
        const double dx = x + 0.5 - (double)s->u, dy = y + 0.5 - (double)s->v;
        double alpha = depth_test_alpha(s->a, s->k, s->e, s->peak, dx, dy, o ? -120 : -b->cutoff_bits);
        if (o) {
            alpha -= depth_test_alpha(o->a, o->k, o->e, o->peak, dx, dy, -120);
            if (fabs(alpha) < (double)b->alpha_min) alpha = 0;
        }
        if (t * (1 - alpha) < 1e-4) break;
        out[n++] = (struct depth_test_layer){t * alpha, t * (1 - alpha), s->depth};
        t *= 1 - alpha;
    }
    return n;
}

static double depth_test_layer(const struct depth_test_layer *layer, int n)
{
    double front = -1, sum = 0, offset = 0, most = 0, z = 0, near = 0, shift = 0;
    if (n == 0 || 1 - layer[n - 1].t < 0.5) return 0;
    for (int i = 0; i < n; i++) {
        if (!(layer[i].weight > 0)) continue;
        if (front < 0 || layer[i].z > 1.04 * front) front = layer[i].z, sum = offset = 0;
        sum += layer[i].weight, offset += layer[i].weight * layer[i].z;
        if (sum > most) most = sum, z = offset / sum;
    }
    for (int i = 0; i < n; i++)
        if (layer[i].weight > 0 && fabs(layer[i].z - z) <= 0.02 * z)
            near += layer[i].weight, shift += layer[i].weight * (layer[i].z - z);
    z += near > 0 ? shift / near : 0;
    return near >= 1. / 3 ? z : -z;
}

/* On every instruction set, with second lobes and without; two layers of equal weight may be confused. */
TEST(depth_agrees_with_a_slow_search_in_double)
{
    const int isa = test_ctx->isa;
    for (int k = 0; k < 6; k++) {
        const oxl_render_options options = oxl_render_options_default();
        OWNED_MODEL m = depth_test_model(60, k % 2 ? 30 : 0);
        OWNED_IMAGE image = {0};
        float depth[32 * 32];
        int wrong = 0, without = 0, uncertain = 0;
        test_ctx->isa = OXL_MIN(isa, k / 2);
        OWNED_RENDERER *r = test_renderer();
        CHECK_OK(renderer_draw(test_ctx, r, &m, &DEPTH_TEST_CAMERA, &options, &image, depth));
        for (int i = 0; i < 32 * 32; i++) {
            struct depth_test_layer layer[400];
            const double z = depth_test_layer(layer, depth_test_layers(&r->bins, i % 32, i / 32, layer));
            wrong += fabs(z - (double)depth[i]) > 1e-4;
            without += fabs(z) <= 0;
            uncertain += z < 0;
        }
        CHECK(wrong <= 5 && without > 0 && uncertain > 0 && without + uncertain < 800);
    }
    test_ctx->isa = isa;
}

/* ---------------- parallel rays */

/* A speck at (x, y, z) seen by a camera 4 above the ground that looks down, 100 px a unit. */
static size_t depth_test_above(const double p[3], oxl_image *image, float *depth)
{
    const oxl_camera camera = {64, 64, 100, 100, 32, 32, {1, 0, 0, 0, -1, 0, 0, 0, -1}, {0, 0, 4}};
    oxl_render_options options = oxl_render_options_default();
    size_t brightest = 0;
    options.parallel = 4;
    options.near_plane = 0;
    OWNED_MODEL m = test_model(1, 0);
    depth_test_set(&m, 0, p[2], 0.98, 0.01);
    m.plane[OXL_MEAN][0] = (float)p[0], m.plane[OXL_MEAN + 1][0] = (float)p[1];
    m.plane[OXL_SH][0] = 1;
    CHECK_OK(oxl_render(test_ctx, &m, &camera, &options, image, depth));
    for (size_t i = 0; i < 64 * 64; i++)
        if (image->rgb[i] > image->rgb[brightest]) brightest = i;
    return brightest;
}

TEST(parallel_rays_see_a_place_at_one_pixel_whatever_its_height)
{
    for (int i = 0; i < 5; i++) {
        OWNED_IMAGE image = {0};
        float depth[64 * 64];
        const double z = 0.7 * i - 0.3 + 1e-5;
        const size_t at = depth_test_above((double[]){0.205, 0.255, z}, &image, depth);
        CHECK(at % 64 == 52 && at / 64 == 6);
        CHECK_CLOSE(4 - (double)depth[at], z, 1e-6); /* float's rounding at 4, not at a distant camera */
    }
}

TEST(parallel_rays_begin_at_the_camera)
{
    OWNED_IMAGE image = {0};
    float depth[64 * 64];
    const size_t at = depth_test_above((double[]){0, 0, 4.01}, &image, depth);
    CHECK(image.rgb[at] == 0 && depth[at] == 0);
}
