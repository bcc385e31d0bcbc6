/* oracle_scene.c - reads a scene of the float64 oracle, draws and differentiates it with our kernels; for oracle.c and test_oracle.c.
 *
 * The loss leaves out "fragile" pixels, where some Gaussian lies within 1e-3 of a hard threshold, or two in depth within 1e-6: there
 * one more bit of precision may decide the other way. They are found by a plain loop in double over all pixels and splats, with
 * faint opacities raised a little, so that splats which are only just culled take part.
 */
#include "reference.c"
#include <ctype.h>

struct oracle_scene {
    int     width, height, sh_degree, count, seed, ste;
    double  k[4], pose[7], background[3], near_plane;
    char    loss[16];
    double *rows; /* (count, 16 + 3 (degree + 1)^2) */
};

static void oracle_quit(const char *what, const char *detail)
{
    fprintf(stderr, "oracle: %s %s\n", what, detail);
    exit(1);
}

/* ---------------------------------------------------------------- reading */

static int oracle_token(FILE *f, char *out, size_t size)
{
    size_t n = 0;
    int    c = fgetc(f);
    while (c == '#' || isspace(c)) {
        if (c == '#')
            while (c != '\n' && c != EOF) c = fgetc(f);
        else c = fgetc(f);
    }
    for (; c != EOF && !isspace(c) && n + 1 < size; c = fgetc(f)) out[n++] = (char)c;
    out[n] = 0;
    return n > 0;
}

static double oracle_number(FILE *f)
{
    char token[64];
    if (!oracle_token(f, token, sizeof token)) oracle_quit("the scene ends where a number was wanted", "");
    return strtod(token, NULL);
}

static void oracle_numbers(FILE *f, double *out, int n)
{
    for (int i = 0; i < n; i++) out[i] = oracle_number(f);
}

static int oracle_row_size(const struct oracle_scene *s)
{
    return 16 + 3 * (s->sh_degree + 1) * (s->sh_degree + 1);
}

static struct oracle_scene oracle_read(const char *path)
{
    struct oracle_scene s = {.near_plane = 0.2, .loss = "dot", .seed = 1};
    FILE               *f = fopen(path, "rb");
    char                key[64];
    if (!f) oracle_quit("cannot open", path);
    while (oracle_token(f, key, sizeof key)) {
        if (!strcmp(key, "image")) s.width = (int)oracle_number(f), s.height = (int)oracle_number(f);
        else if (!strcmp(key, "intrinsics")) oracle_numbers(f, s.k, 4);
        else if (!strcmp(key, "pose")) oracle_numbers(f, s.pose, 7);
        else if (!strcmp(key, "background")) oracle_numbers(f, s.background, 3);
        else if (!strcmp(key, "sh_degree")) s.sh_degree = (int)oracle_number(f);
        else if (!strcmp(key, "near")) s.near_plane = oracle_number(f);
        else if (!strcmp(key, "clamp_grad")) oracle_token(f, key, sizeof key), s.ste = !strcmp(key, "ste");
        else if (!strcmp(key, "dog_alpha")) oracle_token(f, key, sizeof key);
        else if (!strcmp(key, "loss")) oracle_token(f, s.loss, sizeof s.loss), s.seed = (int)oracle_number(f);
        else if (!strcmp(key, "gaussians")) {
            s.count = (int)oracle_number(f);
            s.rows  = reference_array((size_t)s.count * (size_t)oracle_row_size(&s));
            oracle_numbers(f, s.rows, s.count * oracle_row_size(&s));
        } else oracle_quit("unknown key", key);
    }
    fclose(f);
    return s;
}

/* The mean of the positions becomes the origin, in double, as for every scene that the library reads. */
static oxl_camera oracle_camera(struct oracle_scene *s)
{
    oxl_camera c         = {.width = s->width, .height = s->height, .fx = s->k[0], .fy = s->k[1], .cx = s->k[2], .cy = s->k[3]};
    double     origin[3] = {0};
    const int  size      = oracle_row_size(s);
    for (int i = 0; i < s->count; i++)
        for (int a = 0; a < 3; a++) origin[a] += s->rows[i * size + a] / s->count;
    for (int i = 0; i < s->count; i++)
        for (int a = 0; a < 3; a++) s->rows[i * size + a] -= origin[a];
    camera_rotation_from_quaternion(s->pose, c.rotation);
    for (int r = 0; r < 3; r++) {
        c.translation[r] = s->pose[4 + r];
        for (int a = 0; a < 3; a++) c.translation[r] += c.rotation[3 * r + a] * origin[a];
    }
    return c;
}

/* Column of a scene row that a plane of the model comes from. */
static int oracle_column(int plane)
{
    if (plane < OXL_LOG_SCALE) return plane;
    if (plane < OXL_ROTATION) return plane - OXL_LOG_SCALE + 7;
    if (plane < OXL_OPACITY) return plane - OXL_ROTATION + 3;
    return plane == OXL_OPACITY ? 10 : plane - OXL_SH + 16;
}

/* ---------------------------------------------------------------- the oracle's losses */

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

static int oracle_near(double x, double threshold)
{
    return fabs(x - threshold) < 1e-3 * threshold;
}

#define ORACLE_RAISE 1.002 /* opacities below ORACLE_FAINT in the search for fragile pixels */
#define ORACLE_FAINT 0.01

static double oracle_value(const struct splat_f64 *s, double x, double y)
{
    const double dy = y - s->v, w = x - s->u + s->k * dy;
    return exp2(s->peak - s->a * w * w - s->e * dy * dy);
}

/* One pixel, plainly: 1 when some decision in it hangs by a thread. The oracle looks at the clamp of the second lobe too, also where
 * a Gaussian has none and the numbers in its row are unused. */
static int oracle_fragile(const struct reference *r, const struct reference *lobe, double x, double y)
{
    double t = 1, last = -1;
    for (size_t n = 0; n < r->bins_f64.visible_count; n++) {
        const struct splat_f64 *s      = &r->splat_f64[r->bins_f64.order[n]];
        const uint32_t          row    = r->bins_f64.order[n];
        const double            raised = exp2(s->peak) < ORACLE_FAINT * ORACLE_RAISE ? ORACLE_RAISE : 1;
        const double            raw = oracle_value(s, x, y) / raised, alpha = raw < 0.99 ? raw : 0.99;
        if ((lobe->visible[row / PACK] >> row % PACK & 1) && oracle_near(oracle_value(&lobe->splat_f64[row], x, y), 0.99))
            return 1;
        if (oracle_near(alpha, 1.0 / 255) || oracle_near(raw, 0.99)) return 1;
        if (alpha < 1.0 / 255) continue;
        if (oracle_near(t * (1 - alpha), 1e-4) || fabs(s->depth - last) < 1e-6 * s->depth) return 1;
        if (fabs(s->depth - r->lens_f64.near_plane) < 1e-5 * OXL_MAX(1.0, r->lens_f64.near_plane)) return 1;
        last = s->depth;
        if (t * (1 - alpha) < 1e-4) return 0;
        t *= 1 - alpha;
    }
    return 0;
}

static char *oracle_find_fragile(oxl_context *ctx, const struct oracle_scene *s, const struct reference *r)
{
    struct reference raised, lobe;
    char            *fragile = malloc((size_t)s->width * (size_t)s->height);
    if (!fragile) oracle_quit("no memory", "");
    reference_create(&raised, (size_t)s->count, 0);
    reference_create(&lobe, (size_t)s->count, 0);
    raised.lens_f64 = lobe.lens_f64 = r->lens_f64;
    for (int k = 0; k < OXL_SH; k++)
        for (int i = 0; i < s->count; i++) {
            const double x = r->in.plane[k][i], o = 1 / (1 + exp(-x));
            raised.in.plane[k][i] = k == OXL_OPACITY && o < ORACLE_FAINT ? log(ORACLE_RAISE * o / (1 - ORACLE_RAISE * o)) : x;
            lobe.in.plane[k][i]   = k >= OXL_LOG_SCALE && k < OXL_ROTATION
                                        ? s->rows[i * oracle_row_size(s) + 13 + k - OXL_LOG_SCALE]
                                    : k == OXL_OPACITY ? s->rows[i * oracle_row_size(s) + 12]
                                                       : x;
        }
    reference_forward(ctx, &raised);
    reference_forward(ctx, &lobe);
    for (int y = 0; y < s->height; y++)
        for (int x = 0; x < s->width; x++) fragile[y * s->width + x] = (char)oracle_fragile(&raised, &lobe, x + 0.5, y + 0.5);
    reference_free(ctx, &raised);
    reference_free(ctx, &lobe);
    return fragile;
}

/* rgb planar; drgb planar out. */
static double oracle_loss(oxl_context *ctx, const struct oracle_scene *s, const double *rgb, const char *fragile, double *drgb)
{
    const size_t pixels = (size_t)s->width * (size_t)s->height;
    double      *target = reference_array(3 * pixels), loss = 0;
    for (size_t i = 0; i < pixels; i++)
        for (size_t c = 0; c < 3; c++) target[c * pixels + i] = oracle_noise(s->seed, (uint32_t)(3 * i + c));
    if (!strcmp(s->loss, "l1dssim")) {
        struct loss_job_f64     job     = {s->width, s->height, 0.2, rgb, target, NULL, drgb};
        struct loss_scratch_f64 scratch = {0};
        struct loss_value_f64   value;
        if (loss_forward_backward_f64(ctx, &job, &scratch, &value) != OXL_OK) oracle_quit("loss:", oxl_error_text(ctx));
        loss_free_f64(ctx, &scratch);
        loss = value.total;
    } else {
        for (size_t i = 0; i < 3 * pixels; i++) {
            const double ok = !fragile[i % pixels], d = rgb[i] - target[i], n = 3.0 * (double)pixels;
            if (!strcmp(s->loss, "dot")) loss += (2 * target[i] - 1) * rgb[i] * ok, drgb[i] = (2 * target[i] - 1) * ok;
            else if (!strcmp(s->loss, "l2")) loss += d * d * ok / n, drgb[i] = 2 * d * ok / n;
            else loss += fabs(d) * ok / n, drgb[i] = (d > 0 ? 1 : d < 0 ? -1 : 0) * ok / n;
        }
    }
    free(target);
    return loss;
}

/* ---------------------------------------------------------------- the two precisions */

/* The float kernels, through the public doors; results are widened into the reference's arrays. */
static void oracle_run_float(oxl_context *ctx, const struct oracle_scene *s, const oxl_camera *camera, struct reference *r,
                             const char *fragile, double *drgb, double *loss)
{
    const size_t       pixels  = (size_t)s->width * (size_t)s->height;
    oxl_render_options options = oxl_render_options_default();
    oxl_model          model = {0}, gradient = {0};
    struct renderer   *renderer = NULL;
    float             *narrow   = malloc(3 * pixels * sizeof *narrow);
    if (!narrow || oxl_model_create(ctx, (size_t)s->count, s->sh_degree, &model) != OXL_OK) oracle_quit("no memory", "");
    options.near_plane = (float)s->near_plane;
    for (int c = 0; c < 3; c++) options.background[c] = (float)s->background[c];
    for (int k = 0; k < oxl_model_planes(&model); k++)
        for (int i = 0; i < s->count; i++) model.plane[k][i] = (float)r->in.plane[k][i];
    if (renderer_create(ctx, &renderer) != OXL_OK || renderer_forward(ctx, renderer, &model, camera, &options) != OXL_OK)
        oracle_quit("render:", oxl_error_text(ctx));
    for (size_t i = 0; i < 3 * pixels; i++) r->rgb[i] = renderer->rgb[i];
    for (size_t i = 0; i < pixels; i++) r->transmittance[i] = renderer->transmittance[i];
    *loss = oracle_loss(ctx, s, r->rgb, fragile, drgb);
    for (size_t i = 0; i < 3 * pixels; i++) narrow[i] = (float)drgb[i];
    if (oxl_render_backward(ctx, &model, camera, &options, narrow, &gradient) != OXL_OK)
        oracle_quit("render:", oxl_error_text(ctx));
    for (int k = 0; k < oxl_model_planes(&model); k++)
        for (int i = 0; i < s->count; i++) r->gradient.plane[k][i] = gradient.plane[k][i];
    renderer_free(ctx, renderer);
    oxl_model_free(ctx, &model);
    oxl_model_free(ctx, &gradient);
    free(narrow);
}

/* Everything of one scene: image and gradients in *r, dL/d(image) in *drgb (the caller frees both), the loss. */
static void oracle_run(oxl_context *ctx, struct oracle_scene *s, int in_double, struct reference *r, double **drgb, double *loss)
{
    const oxl_camera camera = oracle_camera(s);
    char            *fragile;
    reference_create(r, (size_t)s->count, s->sh_degree);
    r->lens_f64 = reference_lens(&camera, s->near_plane);
    memcpy(r->background, s->background, sizeof r->background);
    for (int k = 0; k < OXL_PLANES && r->in.plane[k]; k++)
        for (int i = 0; i < s->count; i++) r->in.plane[k][i] = s->rows[i * oracle_row_size(s) + oracle_column(k)];
    reference_forward(ctx, r);
    fragile = oracle_find_fragile(ctx, s, r);
    *drgb   = reference_array(3 * (size_t)s->width * (size_t)s->height);
    if (in_double) {
        *loss = oracle_loss(ctx, s, r->rgb, fragile, *drgb);
        reference_backward(r, *drgb);
    } else oracle_run_float(ctx, s, &camera, r, fragile, *drgb, loss);
    free(fragile);
}
