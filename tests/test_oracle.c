/* test_oracle.c - reference/splat.c, with which test_reference.c compares the kernels, against a third
 * implementation, in PyTorch with automatic differentiation: tests/data/oracle (compact.py has the format of what is
 * read here, in the library's terms).
 */
#include "test.h"
#include "wide.h"

enum oracle_loss_kind { ORACLE_DOT, ORACLE_L1, ORACLE_L2, ORACLE_L1_DSSIM };

struct oracle_scene {
    struct wide w;
    int loss, seed, ste;
    double expected_loss, *expected_image, *fragile; /* (H,W,3) in units of 1e-7, (H,W) */
    double *gradient[OXL_PLANES];                    /* expected */
};

static void oracle_read(FILE *f, double *out, size_t count)
{
    for (size_t i = 0; i < count; i++) CHECK(fscanf(f, "%lf", &out[i]) == 1);
}

static void oracle_open(const char *name, struct oracle_scene *s)
{
    char path[256];
    double head[8], lens[5];
    snprintf(path, sizeof path, "tests/data/oracle/expected/%s.txt", name);
    FILE *f = fopen(path, "rb");
    CHECK(f != NULL);
    oracle_read(f, head, OXL_COUNT(head));
    oracle_read(f, lens, OXL_COUNT(lens));
    oxl_camera camera =
        (oxl_camera){(int)head[0], (int)head[1], lens[0], lens[1], lens[2], lens[3], {0}, {0}};
    oracle_read(f, camera.rotation, 9);
    oracle_read(f, camera.translation, 3);
    wide_create(&s->w, &camera, (size_t)head[3], (size_t)head[4], (int)head[2]);
    s->loss = (int)head[5], s->seed = (int)head[6], s->ste = (int)head[7];
    s->w.near_plane = lens[4];
    oracle_read(f, s->w.background, 3);
    for (int k = 0; k < OXL_PLANES; k++) oracle_read(f, s->w.plane[k], wide_rows(&s->w, k));
    size_t pixels = (size_t)camera.width * camera.height;
    s->expected_image = wide_array(3 * pixels), s->fragile = wide_array(pixels);
    oracle_read(f, &s->expected_loss, 1);
    oracle_read(f, s->expected_image, 3 * pixels);
    oracle_read(f, s->fragile, pixels);
    for (int k = 0; k < OXL_PLANES; k++) {
        s->gradient[k] = wide_array(s->w.count);
        oracle_read(f, s->gradient[k], wide_rows(&s->w, k));
    }
    fclose(f);
}

static void oracle_close(struct oracle_scene *s)
{
    wide_free(&s->w);
    free(s->expected_image), free(s->fragile);
    for (int k = 0; k < OXL_PLANES; k++) free(s->gradient[k]);
}

/* ---------------- the oracle's losses */

static double oracle_noise(int seed, uint32_t i) /* in [0,1): lowbias32 hash, top 24 bits */
{
    uint32_t x = i + (uint32_t)seed * UINT32_C(0x9E3779B9);
    x ^= x >> 16;
    x *= UINT32_C(0x7FEB352D);
    x ^= x >> 15;
    x *= UINT32_C(0x846CA68B);
    x ^= x >> 16;
    return (x >> 8) / 16777216.0;
}

/* Of the image in s->w.rgb; drgb (3,H,W). Fragile pixels do not count but in l1dssim. */
static double oracle_loss(const struct oracle_scene *s, double *drgb)
{
    const int width = s->w.camera.width, height = s->w.camera.height;
    const size_t pixels = (size_t)width * height;
    double *target = wide_array(3 * pixels), sum = 0;
    const double n = 3.0 * (double)pixels;
    for (size_t i = 0; i < 3 * pixels; i++)
        target[i % 3 * pixels + i / 3] = oracle_noise(s->seed, (uint32_t)i);
    if (s->loss == ORACLE_L1_DSSIM) sum = splat_loss(width, height, 0.2, s->w.rgb, target, drgb);
    for (size_t i = 0; i < 3 * pixels && s->loss != ORACLE_L1_DSSIM; i++) {
        const double ok = !(s->fragile[i % pixels] > 0), x = s->w.rgb[i], d = x - target[i];
        if (s->loss == ORACLE_DOT) sum += (2 * target[i] - 1) * x * ok, drgb[i] = (2 * target[i] - 1) * ok;
        else if (s->loss == ORACLE_L2) sum += d * d * ok / n, drgb[i] = 2 * d * ok / n;
        else sum += fabs(d) * ok / n, drgb[i] = (d > 0 ? 1 : d < 0 ? -1 : 0) * ok / n;
    }
    free(target);
    return sum;
}

/* ---------------- comparisons */

/* As shares of the largest value of planes first..end-1. */
static double oracle_error(const struct oracle_scene *s, int first, int end)
{
    double worst = 0, largest = 1e-30;
    for (int k = first; k < end; k++)
        for (size_t i = 0; i < wide_rows(&s->w, k); i++) {
            worst = OXL_MAX(worst, fabs(s->gradient[k][i] - s->w.gradient[k][i]));
            largest = OXL_MAX(largest, fabs(s->gradient[k][i]));
        }
    return worst / largest;
}

/* ste: the scene lets the gradient pass the clamp of alpha at 0.99, as CUDA codes do; ours stops there. Then
 * only that of colour can agree. */
static void oracle_compare(const struct oracle_scene *s, double loss, double tolerance)
{
    static const int first[] = {OXL_MEAN, OXL_LOG_SCALE, OXL_ROTATION, OXL_OPACITY,
                                OXL_SH,   OXL_LOBE,      OXL_LOBE + 1, OXL_PLANES};
    const int pixels = s->w.camera.width * s->w.camera.height;
    double worst = 0;
    for (int i = 0; i < 3 * pixels; i++)
        if (!(s->fragile[i / 3] > 0))
            worst = OXL_MAX(worst, fabs(1e-7 * s->expected_image[i] - s->w.rgb[i % 3 * pixels + i / 3]));
    CHECK_CLOSE(worst, 0, tolerance);
    CHECK_CLOSE(loss, s->expected_loss, tolerance * OXL_MAX(1, fabs(s->expected_loss)));
    for (size_t k = 0; k + 1 < OXL_COUNT(first); k++)
        if (!s->ste || first[k] == OXL_SH) CHECK_CLOSE(oracle_error(s, first[k], first[k + 1]), 0, tolerance);
}

static const char *const ORACLE_SCENES[] = {"s1_mixed",      "s2_tiny_huge", "s3_near_plane",
                                            "s4_far_origin", "s5_opacity",   "s6_anisotropic",
                                            "s7_dog_ste",    "s8_single",    "s9_dog_ring"};

TEST(reference_agrees_with_the_oracle)
{
    for (size_t n = 0; n < OXL_COUNT(ORACLE_SCENES); n++) {
        struct oracle_scene s;
        test_case = ORACLE_SCENES[n];
        oracle_open(ORACLE_SCENES[n], &s);
        double *drgb = wide_array(3 * (size_t)s.w.camera.width * s.w.camera.height);
        splat_forward(&s.w);
        double loss = oracle_loss(&s, drgb);
        splat_backward(&s.w, drgb);
        /* the files have seven digits, and converted gradients are sums of theirs */
        oracle_compare(&s, loss, 4e-6);
        free(drgb);
        oracle_close(&s);
    }
}
