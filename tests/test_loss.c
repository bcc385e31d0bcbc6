/* test_loss.c - the fused loss, from its source in double, against the formulas written out, and its gradient
 * against finite differences. */
#include "test.h"
#include "wide.h"

static double loss_image(uint64_t seed, size_t i)
{
    return random_unit(random_bits(seed, i, 0));
}

/* SSIM of one channel at one pixel, straight from the definition; zero outside the image. */
static double loss_plain_ssim(const double *x, const double *y, int w, int h, int cx, int cy)
{
    double mx = 0, my = 0, xx = 0, yy = 0, xy = 0, norm = 0;
    for (int d = -5; d <= 5; d++) norm += exp(-d * d / 4.5);
    for (int v = OXL_MAX(cy - 5, 0); v <= OXL_MIN(cy + 5, h - 1); v++)
        for (int u = OXL_MAX(cx - 5, 0); u <= OXL_MIN(cx + 5, w - 1); u++) {
            const double g = exp(-((v - cy) * (v - cy) + (u - cx) * (u - cx)) / 4.5) / (norm * norm),
                         a = x[v * w + u], b = y[v * w + u];
            mx += g * a, my += g * b, xx += g * a * a, yy += g * b * b, xy += g * a * b;
        }
    return (2 * mx * my + 1e-4) * (2 * (xy - mx * my) + 9e-4) /
           ((mx * mx + my * my + 1e-4) * (xx - mx * mx + yy - my * my + 9e-4));
}

struct loss_case {
    int w, h;
    double *x, *y, *weight, *dx;
};

static struct loss_case loss_case(int w, int h, int masked)
{
    const size_t n = (size_t)w * (size_t)h;
    struct loss_case c = {
        w, h, wide_array(3 * n), wide_array(3 * n), masked ? wide_array(n) : NULL, wide_array(3 * n)};
    for (size_t i = 0; i < 3 * n; i++)
        c.x[i] = loss_image(1, i), c.y[i] = 0.5 * loss_image(2, i) + 0.5 * c.x[i];
    for (size_t i = 0; masked && i < n; i++) c.weight[i] = (int)(i % (size_t)w) < 3 * w / 4;
    return c;
}

static void loss_case_free(struct loss_case *c)
{
    free(c->x);
    free(c->y);
    free(c->weight);
    free(c->dx);
}
#define LOSS_CASE __attribute__((cleanup(loss_case_free))) struct loss_case

static struct wide_loss loss_run(const struct loss_case *c, double ssim_weight)
{
    return kernels_loss(c->w, c->h, ssim_weight, c->x, c->y, c->weight, c->dx);
}

/* The constant of contrast of another survey: as if all values were ten times as far apart. */
TEST(loss_of_dark_images_with_their_own_contrast_is_that_of_bright_ones)
{
    enum { W = 37, H = 29, N = 3 * W * H };
    float x[N], y[N], dx[2][N];
    struct renderer_loss value[2];
    for (int i = 0; i < N; i++) {
        x[i] = 2 * (float)loss_image(1, (size_t)i);
        y[i] = 0.5f * (float)loss_image(2, (size_t)i) + 0.5f * x[i];
    }
    for (int k = 0; k < 2; k++) {
        struct loss_scratch scratch = {0};
        const struct loss_job job = {W, H, 1, x, y, NULL, dx[k], k ? 9e-6f : 0};
        for (int i = 0; i < N && k; i++) x[i] *= 0.1f, y[i] *= 0.1f;
        CHECK_OK(loss_forward_backward(test_ctx, &job, &scratch, &value[k]));
        loss_free(test_ctx, &scratch);
    }
    /* 0.01^2, the constant of brightness, stays */
    CHECK_CLOSE(value[1].ssim, value[0].ssim, 0.02);
    for (int i = 0; i < N; i += 97) CHECK_CLOSE(dx[1][i] / 10, dx[0][i], 0.2 * fabs(dx[0][i]) + 2e-6);
}

/* 1 where no pixel of the window is masked. */
static int loss_plain_whole(const struct loss_case *c, int cx, int cy)
{
    int whole = 1;
    for (int v = OXL_MAX(cy - 5, 0); v <= OXL_MIN(cy + 5, c->h - 1); v++)
        for (int u = OXL_MAX(cx - 5, 0); u <= OXL_MIN(cx + 5, c->w - 1); u++)
            whole = whole && c->weight[v * c->w + u] > 0;
    return whole;
}

TEST(loss_takes_the_windows_that_a_mask_leaves_whole)
{
    LOSS_CASE c = loss_case(45, 40, 1);
    double ssim = 0, windows = 0;
    for (int i = 0; i < 45 * 40; i++) c.weight[i] = i % 311 != 7;
    struct wide_loss value = loss_run(&c, 0.2);
    for (int ch = 0; ch < 3; ch++)
        for (int i = 0; i < 45 * 40; i++) {
            if (!loss_plain_whole(&c, i % 45, i / 45)) continue;
            ssim += loss_plain_ssim(c.x + ch * 45 * 40, c.y + ch * 45 * 40, 45, 40, i % 45, i / 45);
            windows++;
        }
    CHECK(windows > 0 && windows < 3 * 45 * 40);
    CHECK_CLOSE(value.ssim, ssim / windows, 1e-12);
}

static void loss_check_gradient(int masked)
{
    enum { N = 3 * 23 * 19 };
    LOSS_CASE c = loss_case(23, 19, masked);
    double dx[N];
    loss_run(&c, 0.2);
    memcpy(dx, c.dx, sizeof dx);
    for (size_t i = 0; i < N; i += 7) {
        const double was = c.x[i], h = 1e-6;
        double up, down;
        c.x[i] = was + h, up = loss_run(&c, 0.2).total;
        c.x[i] = was - h, down = loss_run(&c, 0.2).total;
        c.x[i] = was;
        CHECK_CLOSE((up - down) / (2 * h), dx[i], 1e-9);
    }
}

TEST(loss_gradient_agrees_with_finite_differences_without_and_under_a_mask)
{
    loss_check_gradient(0);
    loss_check_gradient(1);
}

TEST(loss_does_not_see_what_is_masked)
{
    LOSS_CASE c = loss_case(40, 20, 1);
    const struct wide_loss before = loss_run(&c, 0.2);
    for (int i = 0; i < 3 * 40 * 20; i++)
        if (!(c.weight[i % (40 * 20)] > 0)) c.x[i] = 100 + i;
    struct wide_loss after = loss_run(&c, 0.2);
    CHECK(before.total == after.total && before.ssim == after.ssim && before.mse == after.mse);
    for (int i = 0; i < 3 * 40 * 20; i++)
        if (!(c.weight[i % (40 * 20)] > 0)) CHECK(c.dx[i] == 0);
}

TEST(loss_of_equal_images_is_zero)
{
    LOSS_CASE c = loss_case(16, 16, 0);
    memcpy(c.y, c.x, 3 * 16 * 16 * sizeof *c.x);
    struct wide_loss value = loss_run(&c, 0.2);
    CHECK_CLOSE(value.total, 0, 1e-15);
    for (int i = 0; i < 3 * 16 * 16; i++) CHECK_CLOSE(c.dx[i], 0, 1e-15);
}

/* The float loss on the images of a case, with `threads`. */
static struct renderer_loss loss_run_float(const struct loss_case *c, int threads,
                                           struct loss_scratch *scratch, float *dx)
{
    const size_t n = 3 * (size_t)c->w * (size_t)c->h;
    float *x = malloc(n * sizeof *x), *y = malloc(n * sizeof *y), *weight = malloc(n * sizeof *weight);
    struct loss_job job = {c->w, c->h, 0.2f, x, y, c->weight ? weight : NULL, dx, 0};
    struct renderer_loss value = {0};
    const int before = test_ctx->threads;
    if (!x || !y || !weight) abort();
    for (size_t i = 0; i < n; i++) x[i] = (float)c->x[i], y[i] = (float)c->y[i];
    for (size_t i = 0; c->weight && i < n / 3; i++) weight[i] = (float)c->weight[i];
    test_ctx->threads = threads;
    CHECK_OK(loss_forward_backward(test_ctx, &job, scratch, &value));
    test_ctx->threads = before;
    free(x), free(y), free(weight);
    return value;
}

static struct renderer_loss loss_run_afresh(const struct loss_case *c, int threads, float *dx)
{
    struct loss_scratch scratch = {0};
    const struct renderer_loss value = loss_run_float(c, threads, &scratch, dx);
    loss_free(test_ctx, &scratch);
    return value;
}

/* One scratch for all, as in a run: another width, a mask, more threads and fewer. */
TEST(loss_does_not_see_what_was_in_its_scratch_before)
{
    static const int size[][4] = {{70, 20, 0, 1},
                                  {70, 20, 1, 1},
                                  {70, 20, 0, 3},
                                  {33, 9, 0, 3},
                                  /* w, h, masked, threads */
                                  {70, 3, 1, 2},
                                  {70, 20, 0, 2},
                                  {64, 20, 0, 1},
                                  {70, 20, 0, 3}};
    static float dx[2][3 * 70 * 20];
    struct loss_scratch scratch = {0};
    for (size_t i = 0; i < OXL_COUNT(size); i++) {
        LOSS_CASE c = loss_case(size[i][0], size[i][1], size[i][2]);
        const struct renderer_loss kept = loss_run_float(&c, size[i][3], &scratch, dx[0]);
        const struct renderer_loss fresh = loss_run_afresh(&c, size[i][3], dx[1]);
        CHECK(kept.total == fresh.total && kept.ssim == fresh.ssim);
        CHECK(memcmp(dx[0], dx[1], 3 * (size_t)(c.w * c.h) * sizeof(float)) == 0);
    }
    loss_free(test_ctx, &scratch);
}

TEST(loss_is_the_same_bytes_wherever_the_strips_are_cut)
{
    static float dx[4][3 * 50 * 31];
    struct renderer_loss value[4];
    LOSS_CASE c = loss_case(50, 31, 0);
    for (int i = 0; i < 4; i++) value[i] = loss_run_afresh(&c, (int[]){1, 2, 7, 40}[i], dx[i]);
    for (int i = 1; i < 4; i++) {
        CHECK(!memcmp(dx[0], dx[i], sizeof dx[0]));
        CHECK(value[0].total == value[i].total && value[0].ssim == value[i].ssim);
    }
}
