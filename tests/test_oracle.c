/* test_oracle.c - reference/splat.c, with which test_reference.c compares the kernels, against a third
 * implementation, in PyTorch with automatic differentiation: tests/data/oracle (its README.md has the format).
 *
 * The oracle's second lobes have an opacity and scales of their own, ours are factors of the Gaussian's: o' =
 * o sigmoid(a), s' = s exp(b).
 * Scenes and expected gradients are converted by the chain rule when they are read.
 */
#include "test.h"
#include "wide.h"
#include <ctype.h>

struct oracle_scene {
    int width, height, sh_degree, count, seed;
    double k[4], pose[7], background[3], near_plane;
    char loss[16];
    double *rows; /* (count, 16 + 3 (degree + 1)^2) as in the file, but for the mean: */
    double origin[3];
    int *order; /* (count) scene's row of each of ours: those with a lobe first */
    struct wide w;
    double *expected_image, *fragile; /* (H,W,3), (H,W) */
    double *gradient[OXL_PLANES];     /* (count) expected, in our order and terms */
    double expected_loss;
};

/* columns of a row */
enum {
    ORACLE_ROTATION = 3,
    ORACLE_LOG_SCALE = 7,
    ORACLE_LOGIT = 10,
    ORACLE_LOBED,
    ORACLE_LOBE,
    ORACLE_SH = 16
};

/* ---------------- reading */

static int oracle_token(FILE *f, char *out, size_t size)
{
    size_t n = 0;
    int c = fgetc(f);
    while (c == '#' || isspace(c)) {
        while (c == '#' && c != EOF)
            for (c = fgetc(f); c != '\n' && c != EOF;) c = fgetc(f);
        c = fgetc(f);
    }
    for (; c != EOF && !isspace(c) && n + 1 < size; c = fgetc(f)) out[n++] = (char)c;
    out[n] = 0;
    return n > 0;
}

static double oracle_number(FILE *f)
{
    char token[64] = "";
    CHECK(oracle_token(f, token, sizeof token));
    return strtod(token, NULL);
}

static void oracle_numbers(FILE *f, double *out, int n)
{
    for (int i = 0; i < n; i++) out[i] = oracle_number(f);
}

static int oracle_columns(const struct oracle_scene *s)
{
    return ORACLE_SH + 3 * (s->sh_degree + 1) * (s->sh_degree + 1);
}

static void oracle_read_scene(const char *path, struct oracle_scene *s)
{
    FILE *f = fopen(path, "rb");
    char key[64];
    if (!f) abort();
    while (oracle_token(f, key, sizeof key)) {
        if (!strcmp(key, "image")) s->width = (int)oracle_number(f), s->height = (int)oracle_number(f);
        else if (!strcmp(key, "intrinsics")) oracle_numbers(f, s->k, 4);
        else if (!strcmp(key, "pose")) oracle_numbers(f, s->pose, 7);
        else if (!strcmp(key, "background")) oracle_numbers(f, s->background, 3);
        else if (!strcmp(key, "sh_degree")) s->sh_degree = (int)oracle_number(f);
        else if (!strcmp(key, "near")) s->near_plane = oracle_number(f);
        else if (!strcmp(key, "clamp_grad") || !strcmp(key, "dog_alpha")) oracle_token(f, key, sizeof key);
        else if (!strcmp(key, "loss"))
            oracle_token(f, s->loss, sizeof s->loss), s->seed = (int)oracle_number(f);
        else if (!strcmp(key, "gaussians")) {
            s->count = (int)oracle_number(f);
            s->rows = wide_array((size_t)(s->count * oracle_columns(s)));
            oracle_numbers(f, s->rows, s->count * oracle_columns(s));
        } else CHECK(!"a key of the format");
    }
    fclose(f);
}

/* "@name rows columns", then the numbers; of fragile a row is one word. */
static double *oracle_section(const char *path, const char *name, int count)
{
    FILE *f = fopen(path, "rb");
    char token[128];
    double *out = wide_array((size_t)count);
    int found = 0;
    if (!f) abort();
    while (!found && oracle_token(f, token, sizeof token)) {
        int rows, columns;
        found = token[0] == '@' && !strcmp(token + 1, name);
        if (!found) continue;
        rows = (int)oracle_number(f), columns = (int)oracle_number(f);
        if (!strcmp(name, "fragile")) {
            for (int row = 0; row < rows && oracle_token(f, token, sizeof token); row++)
                for (int x = 0; x < count / rows; x++) out[row * (count / rows) + x] = token[x] == '1';
        } else if (rows * columns == count) oracle_numbers(f, out, count);
        else CHECK(!"a section of this size");
    }
    CHECK(found);
    fclose(f);
    return out;
}

/* ---------------- into our terms */

static const double *oracle_row(const struct oracle_scene *s, int i)
{
    return s->rows + s->order[i] * oracle_columns(s);
}

/* logit of o'/o = (1 + e^-x) / (1 + e^-y), of the logits x of o and y of o'; at most 40, where it is 1. */
static double oracle_factor(double x, double y)
{
    const double rest = exp(-y) - exp(-x); /* (1 - o'/o) (1 + e^-y) */
    return rest > 0 ? OXL_MIN(40, log((1 + exp(-x)) / rest)) : 40;
}

static double oracle_plane(const struct oracle_scene *s, int i, int k)
{
    const double *row = oracle_row(s, i);
    if (k < OXL_LOG_SCALE) return row[k] - s->origin[k];
    if (k < OXL_ROTATION) return row[ORACLE_LOG_SCALE + k - OXL_LOG_SCALE];
    if (k < OXL_OPACITY) return row[ORACLE_ROTATION + k - OXL_ROTATION];
    if (k == OXL_OPACITY) return row[ORACLE_LOGIT];
    if (k < OXL_LOBE) return row[ORACLE_SH + k - OXL_SH];
    if (k == OXL_LOBE) return oracle_factor(row[ORACLE_LOGIT], row[ORACLE_LOBE]);
    return row[ORACLE_LOBE + k - OXL_LOBE] - row[ORACLE_LOG_SCALE + k - OXL_LOBE - 1];
}

/* The mean of the positions becomes the origin, in double, as for every survey that the library reads. */
static oxl_camera oracle_camera(const struct oracle_scene *s)
{
    oxl_camera c = {
        .width = s->width, .height = s->height, .fx = s->k[0], .fy = s->k[1], .cx = s->k[2], .cy = s->k[3]};
    camera_rotation_from_quaternion(s->pose, c.rotation);
    for (int r = 0; r < 3; r++) {
        c.translation[r] = s->pose[4 + r];
        for (int a = 0; a < 3; a++) c.translation[r] += c.rotation[3 * r + a] * s->origin[a];
    }
    return c;
}

/* What pulls at log o' = log o + log sigmoid(a) is dL/d(logit o') / (1 - o'); it pulls at logit o with 1 - o,
 * and at a with 1 - sigmoid(a).
 * What pulls at log s' = log s + b pulls at both. */
static void oracle_expect(const char *path, struct oracle_scene *s)
{
    static const struct {
        const char *name;
        int plane, columns;
    } part[] = {{"grad_mean", OXL_MEAN, 3},     {"grad_log_scale", OXL_LOG_SCALE, 3},
                {"grad_quat", OXL_ROTATION, 4}, {"grad_logit_o", OXL_OPACITY, 1},
                {"grad_sh", OXL_SH, 0},         {"grad_dog", OXL_LOBE, 4}};
    for (size_t n = 0; n < OXL_COUNT(part); n++) {
        const int columns = part[n].columns ? part[n].columns : oracle_columns(s) - ORACLE_SH;
        double *e = oracle_section(path, part[n].name, s->count * columns);
        for (int c = 0; c < columns; c++) {
            s->gradient[part[n].plane + c] = wide_array((size_t)s->count);
            for (int i = 0; i < s->count; i++)
                s->gradient[part[n].plane + c][i] = e[s->order[i] * columns + c];
        }
        free(e);
    }
    for (int i = 0; i < (int)s->w.lobes; i++) {
        const double x = oracle_row(s, i)[ORACLE_LOGIT], y = oracle_row(s, i)[ORACLE_LOBE],
                     pull = s->gradient[OXL_LOBE][i];
        s->gradient[OXL_OPACITY][i] += pull * vecmath_sigmoid(-x) / vecmath_sigmoid(-y);
        s->gradient[OXL_LOBE][i] = pull * (1 - exp(y - x));
        for (int a = 0; a < 3; a++) s->gradient[OXL_LOG_SCALE + a][i] += s->gradient[OXL_LOBE + 1 + a][i];
    }
}

static void oracle_open(const char *name, struct oracle_scene *s)
{
    char path[256];
    int n = 0, lobes = 0;
    oxl_camera camera;
    double *loss;
    *s = (struct oracle_scene){.near_plane = 0.2};
    snprintf(path, sizeof path, "tests/data/oracle/scenes/%s.txt", name);
    oracle_read_scene(path, s);
    s->order = wide_array((size_t)s->count);
    for (int lobed = 1; lobed >= 0; lobed--)
        for (int i = 0; i < s->count; i++)
            if ((s->rows[i * oracle_columns(s) + ORACLE_LOBED] != 0) == lobed)
                s->order[n++] = i, lobes += lobed;
    for (int i = 0; i < s->count; i++)
        for (int a = 0; a < 3; a++) s->origin[a] += s->rows[i * oracle_columns(s) + a] / s->count;
    camera = oracle_camera(s);
    wide_create(&s->w, &camera, (size_t)s->count, (size_t)lobes, s->sh_degree);
    s->w.near_plane = s->near_plane;
    memcpy(s->w.background, s->background, sizeof s->background);
    for (int k = 0; k < OXL_PLANES; k++)
        for (int i = 0; i < (int)wide_rows(&s->w, k); i++) s->w.plane[k][i] = oracle_plane(s, i, k);
    snprintf(path, sizeof path, "tests/data/oracle/expected/%s.txt", name);
    s->expected_image = oracle_section(path, "image", 3 * s->width * s->height);
    s->fragile = oracle_section(path, "fragile", s->width * s->height);
    oracle_expect(path, s);
    loss = oracle_section(path, "loss", 1);
    s->expected_loss = loss[0];
    free(loss);
}

static void oracle_close(struct oracle_scene *s)
{
    wide_free(&s->w);
    free(s->rows), free(s->order), free(s->expected_image), free(s->fragile);
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
    const size_t pixels = (size_t)s->width * (size_t)s->height;
    double *target = wide_array(3 * pixels), sum = 0;
    const double n = 3.0 * (double)pixels;
    for (size_t i = 0; i < 3 * pixels; i++)
        target[i % 3 * pixels + i / 3] = oracle_noise(s->seed, (uint32_t)i);
    if (!strcmp(s->loss, "l1dssim")) sum = splat_loss(s->width, s->height, 0.2, s->w.rgb, target, drgb);
    for (size_t i = 0; i < 3 * pixels && strcmp(s->loss, "l1dssim"); i++) {
        const double ok = !(s->fragile[i % pixels] > 0), x = s->w.rgb[i], d = x - target[i];
        if (!strcmp(s->loss, "dot")) sum += (2 * target[i] - 1) * x * ok, drgb[i] = (2 * target[i] - 1) * ok;
        else if (!strcmp(s->loss, "l2")) sum += d * d * ok / n, drgb[i] = 2 * d * ok / n;
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
        for (int i = 0; i < (int)wide_rows(&s->w, k); i++) {
            worst = OXL_MAX(worst, fabs(s->gradient[k][i] - s->w.gradient[k][i]));
            largest = OXL_MAX(largest, fabs(s->gradient[k][i]));
        }
    return worst / largest;
}

/* ste: the scene lets the gradient pass the clamp of alpha at 0.99, as CUDA codes do; ours stops there. Then
 * only that of colour can agree. */
static void oracle_compare(const struct oracle_scene *s, double loss, int ste, double tolerance)
{
    static const int first[] = {OXL_MEAN, OXL_LOG_SCALE, OXL_ROTATION, OXL_OPACITY,
                                OXL_SH,   OXL_LOBE,      OXL_LOBE + 1, OXL_PLANES};
    const int pixels = s->width * s->height;
    double worst = 0;
    for (int i = 0; i < 3 * pixels; i++)
        if (!(s->fragile[i / 3] > 0))
            worst = OXL_MAX(worst, fabs(1e-7 * s->expected_image[i] - s->w.rgb[i % 3 * pixels + i / 3]));
    CHECK_CLOSE(worst, 0, tolerance);
    CHECK_CLOSE(loss, s->expected_loss, tolerance * OXL_MAX(1, fabs(s->expected_loss)));
    for (size_t k = 0; k + 1 < OXL_COUNT(first); k++)
        if (!ste || first[k] == OXL_SH) CHECK_CLOSE(oracle_error(s, first[k], first[k + 1]), 0, tolerance);
}

static const char *const ORACLE_SCENES[] = {"s1_mixed",      "s2_tiny_huge", "s3_near_plane",
                                            "s4_far_origin", "s5_opacity",   "s6_anisotropic",
                                            "s7_dog_ste",    "s8_single",    "s9_dog_ring"};

TEST(reference_agrees_with_the_oracle)
{
    for (size_t n = 0; n < OXL_COUNT(ORACLE_SCENES); n++) {
        struct oracle_scene s;
        double *drgb, loss;
        test_case = ORACLE_SCENES[n];
        oracle_open(ORACLE_SCENES[n], &s);
        drgb = wide_array(3 * (size_t)s.width * (size_t)s.height);
        splat_forward(&s.w);
        loss = oracle_loss(&s, drgb);
        splat_backward(&s.w, drgb);
        /* the files have seven digits, and converted gradients are sums of theirs */
        oracle_compare(&s, loss, !strcmp(ORACLE_SCENES[n], "s7_dog_ste"), 4e-6);
        free(drgb);
        oracle_close(&s);
    }
}
