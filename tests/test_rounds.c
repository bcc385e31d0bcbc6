/* test_rounds.c - blocks trained as one model: context Gaussians and windows. */
#include "test.h"

/* Random Gaussians in front of a camera at the origin that looks along z. */
static oxl_model rounds_test_model(size_t count, uint64_t seed, size_t lobes)
{
    oxl_model m = test_model(count, 1);
    CHECK_OK(model_set_lobes(test_ctx, &m, lobes));
    for (size_t i = 0; i < count; i++) {
        for (int k = 0; k < oxl_model_planes(&m); k++)
            m.plane[k][i] = (float)(random_unit(random_bits(seed, i, (uint64_t)k)) - 0.5);
        m.plane[OXL_MEAN + 2][i] += 3;
        for (int a = 0; a < 3; a++) m.plane[OXL_LOG_SCALE + a][i] -= 2;
        m.plane[OXL_ROTATION][i] = 1;
    }
    for (int k = OXL_LOBE; lobes && k < OXL_PLANES; k++)
        for (size_t i = 0; i < lobes; i++)
            m.plane[k][i] = (float)(random_unit(random_bits(seed, i, (uint64_t)k)) - 0.9);
    return m;
}

/* dL/d(image) of a loss that no pixel is like another in. */
static float *rounds_test_slope(const oxl_camera *c)
{
    const size_t n = 3 * (size_t)c->width * c->height;
    float *d = oxl_alloc(test_ctx, n, sizeof *d);
    for (size_t i = 0; i < n; i++) d[i] = (float)(random_unit(random_bits(9, i, 0)) - 0.5);
    return d;
}

static double rounds_test_largest_difference(const float *a, const float *b, size_t n)
{
    double most = 0;
    for (size_t i = 0; i < n; i++) most = OXL_MAX(most, fabs((double)a[i] - b[i]));
    return most;
}

static const struct medium rounds_test_medium = {.on = 1,
                                                 .attenuation = {0.4f, 0.3f, 0.2f},
                                                 .backscatter = {0.3f, 0.2f, 0.1f},
                                                 .veiling_light = {0.1f, 0.3f, 0.4f}};

TEST(context_is_rendered_as_part_of_the_model_and_gradients_are_those_of_its_rows)
{
    for (size_t kind = 0; kind < 4; kind++) { /* with lobes; behind a medium */
        const size_t lobes = kind % 2;
        const oxl_camera camera = test_camera(64, 48, 60, 0, 0, 0);
        struct medium medium = rounds_test_medium;
        OWNED_MODEL own = rounds_test_model(50, 1, 20 * lobes),
                    context = rounds_test_model(70, 2, 30 * lobes), all = test_model(0, 0);
        OWNED_MEMORY float *slope = rounds_test_slope(&camera);
        OWNED_RENDERER *a = test_renderer(), *b = test_renderer();
        const float *x, *y;
        float s1[120] = {0}, s2[120] = {0};
        CHECK_OK(merge_rows(test_ctx, &own, NULL, &all));
        CHECK_OK(merge_rows(test_ctx, &context, NULL, &all));
        OWNED_MODEL g1 = test_model(own.count, 1), g2 = test_model(all.count, 1);
        renderer_set_surroundings(a, &context);
        renderer_settings(a)->medium = kind > 1 ? medium : (struct medium){0};
        renderer_settings(b)->medium = kind > 1 ? medium : (struct medium){0};
        x = test_draw(a, &own, &camera), y = test_draw(b, &all, &camera);
        CHECK(rounds_test_largest_difference(x, y, 3 * 64 * 48) == 0);
        CHECK_OK(renderer_score(test_ctx, a, slope, s1)); /* as long as the model: the context has none */
        CHECK_OK(renderer_score(test_ctx, b, slope, s2));
        CHECK_OK(renderer_backward(test_ctx, a, slope, &g1));
        CHECK_OK(renderer_backward(test_ctx, b, slope, &g2));
        for (size_t i = 0; i < own.count; i++) {
            const size_t row = i < own.lobes ? i : i + context.lobes; /* rows with lobes are in front */
            CHECK(renderer_row_visible(a, i) == renderer_row_visible(b, row));
            for (int k = 0; k < oxl_model_planes(&g1) && renderer_row_visible(a, i); k++)
                CHECK(g1.plane[k][i] == g2.plane[k][row]);
        }
        for (size_t i = 0; i < own.count; i++) CHECK(s1[i] == s2[i < own.lobes ? i : i + context.lobes]);
        for (size_t i = own.count; i < 120; i++) CHECK(s1[i] == 0);
        if (kind > 1) { /* the own colours as through half a unit of the medium, as in training */
            double factor[3];
            for (int c = 0; c < 3; c++) factor[c] = exp(-0.5 * (double)medium.attenuation[c]);
            medium.training_range = 0.5f;
            model_scale_colour(&own, factor);
            renderer_settings(a)->medium = medium;
            CHECK(rounds_test_largest_difference(test_draw(a, &own, &camera), y, 3 * 64 * 48) < 1e-5);
        }
    }
}

TEST(window_shows_the_same_pixels_as_the_image_and_its_loss_the_same_slopes)
{
    const oxl_camera full = test_camera(64, 48, 60, 0, 0, 0);
    oxl_camera part = full;
    OWNED_MODEL m = rounds_test_model(80, 3, 0);
    const struct lamp lamp = {.view = -1,
                              .shape = {0.3f, -0.4f, 0.2f, 0.1f, -0.5f, 0.3f, 0.2f, 0.1f, -0.3f, 0.2f}};
    const int x0 = 16, y0 = 16;
    OWNED_MEMORY float *image = oxl_calloc(test_ctx, 3 * 64 * 48, sizeof *image),
                       *weight = oxl_calloc(test_ctx, 64 * 48, sizeof *weight);
    OWNED_RENDERER *a = test_renderer(), *b = test_renderer();
    const float *x, *y;
    struct renderer_loss loss;
    double most = 0, largest = 0;
    part.width = 32, part.height = 32;
    part.cx -= x0, part.cy -= y0;
    OWNED_MODEL g1 = test_model(m.count, 1), g2 = test_model(m.count, 1);
    renderer_settings(a)->window = (struct renderer_window){64, 48, 16, 16};
    renderer_settings(a)->lamp = &lamp;
    renderer_settings(b)->lamp = &lamp;
    x = test_draw(a, &m, &part), y = test_draw(b, &m, &full);
    for (int c = 0; c < 3; c++)
        for (int v = 0; v < 32; v++)
            for (int u = 0; u < 32; u++)
                most = OXL_MAX(most,
                               fabs((double)x[(c * 32 + v) * 32 + u] - y[(c * 48 + v + y0) * 64 + u + x0]));
    CHECK(most < 1e-6);
    for (int v = 0; v < 32; v++)
        for (int u = 0; u < 32; u++) weight[(v + y0) * 64 + u + x0] = 1;
    CHECK_OK(renderer_loss(test_ctx, a, image, NULL, 0, &loss)); /* L1 to black, of the window; */
    /* of the same pixels of the image: a mean over them alone */
    CHECK_OK(renderer_loss(test_ctx, b, image, weight, 0, &loss));
    CHECK_OK(renderer_backward(test_ctx, a, NULL, &g1));
    CHECK_OK(renderer_backward(test_ctx, b, NULL, &g2));
    for (size_t i = 0; i < m.count; i++)
        for (int k = 0; k < OXL_SH && renderer_row_visible(a, i) && renderer_row_visible(b, i); k++) {
            const double share = 32.0 * 32 / (64 * 48);
            most = OXL_MAX(most, fabs(g1.plane[k][i] - share * g2.plane[k][i]));
            largest = OXL_MAX(largest, fabs(g1.plane[k][i]));
        }
    CHECK(largest > 1e-4 && most < 1e-4 * largest + 1e-6);
    for (size_t i = 0; i < m.count; i++)
        if (renderer_row_visible(a, i) && renderer_row_visible(b, i))
            CHECK_CLOSE(renderer_mean_gradient(a, i), renderer_mean_gradient(b, i) * 32.0 * 32 / (64 * 48),
                        1e-5);
}

TEST(window_counts_a_view_for_growth_only_of_gaussians_whose_centre_it_shows)
{
    const oxl_camera full = test_camera(64, 48, 60, 0, 0, 0);
    oxl_camera part = full;
    OWNED_MODEL m = rounds_test_model(200, 4, 0);
    static float image[3 * 64 * 48];
    float gradient[200] = {0}, views[2][200] = {{0}};
    size_t counted = 0, cut = 0;
    OWNED_RENDERER *whole = test_renderer(), *window = test_renderer();
    struct renderer *const r[2] = {whole, window};
    struct renderer_loss loss;
    part.width = 32, part.height = 32;
    part.cx -= 16, part.cy -= 16;
    for (int k = 0; k < 2; k++) { /* the whole image, the window */
        const struct renderer_sums sums = {.count = m.count, .gradient = gradient, .views = views[k]};
        if (k == 1) renderer_settings(r[k])->window = (struct renderer_window){64, 48, 0, 0};
        test_draw(r[k], &m, k ? &part : &full);
        CHECK_OK(renderer_loss(test_ctx, r[k], image, NULL, 0, &loss));
        CHECK_OK(renderer_backward(test_ctx, r[k], NULL, NULL));
        CHECK_OK(renderer_observe(test_ctx, r[k], &sums));
    }
    for (size_t i = 0; i < m.count; i++) {
        const struct splat *s = &r[1]->splat[i];
        const int inside = renderer_row_visible(r[1], i) && s->u >= 0 && s->v >= 0 && s->u < 32 && s->v < 32;
        CHECK(views[0][i] == (float)renderer_row_visible(r[0], i) && views[1][i] == (float)inside);
        counted += (size_t)inside;
        cut += renderer_row_visible(r[1], i) && !inside;
    }
    CHECK(counted > 5 && cut > 5);
}

TEST(window_is_the_rectangle_that_is_worth_most)
{
    double value[] = {-1, -1, -1, -1, -1, 3, 2, -1, -1, 2, -1, 4, -9, -9, -9, -9};
    struct image_window best;
    CHECK(plan_best_rectangle(value, 4, 4, &best) == 9);
    CHECK(best.x == 1 && best.y == 1 && best.width == 3 && best.height == 2);
}
