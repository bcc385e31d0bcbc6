/* oracle_scene.c - reads a scene of the float64 oracle, draws and differentiates it with our kernels; for oracle.c and test_oracle.c.
 *
 * The oracle's second lobes stand free of their Gaussian (any opacity, any scales), ours are factors of it: so its scenes go in with
 * lobe_free = 1, where the lobe's planes are its own logit of opacity and log scales. That the factors pull at opacity and scale by the
 * product rule is test_gradient.c's to show. Rows with a lobe go to the front; results come back in the scene's order.
 *
 * The loss leaves out "fragile" pixels, where some Gaussian lies within 1e-3 of a hard threshold, or two in depth within 1e-6: there
 * one more bit of precision may decide the other way. They are found by a plain loop in double over all pixels and splats, with
 * faint opacities raised a little, so that splats which are only just culled take part.
 */
#include "reference.c"
#include <ctype.h>

struct oracle_scene {
    int     width, height, sh_degree, count, lobes, seed, ste;
    double  k[4], pose[7], background[3], near_plane;
    char    loss[16];
    double *rows;  /* (count, 16 + 3 (degree + 1)^2) those with a lobe first */
    int    *order; /* (count) row's place in the scene */
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

enum { ORACLE_HAS_LOBE = 11, ORACLE_LOBE = 12 }; /* columns: 0 or 1; logit of opacity, three log scales */

/* Rows with a lobe to the front, both parts in their order. */
static void oracle_lobes_first(struct oracle_scene *s)
{
    const size_t size = (size_t)oracle_row_size(s);
    double      *rows = reference_array((size_t)s->count * size);
    int          n    = 0;
    s->order          = reference_array((size_t)s->count);
    for (int lobed = 1; lobed >= 0; lobed--)
        for (int i = 0; i < s->count; i++) {
            const double *row = s->rows + (size_t)i * size;
            if ((row[ORACLE_HAS_LOBE] != 0) != lobed) continue;
            memcpy(rows + (size_t)n * size, row, size * sizeof *row);
            s->order[n++] = i;
            s->lobes += lobed;
        }
    free(s->rows);
    s->rows = rows;
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
            oracle_lobes_first(&s);
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
    if (plane >= OXL_LOBE) return plane - OXL_LOBE + ORACLE_LOBE;
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

/* What a row's second lobe takes away; 0 when it has none. */
static double oracle_second(const struct reference *r, uint32_t row, double x, double y)
{
    struct splat_f64 s = r->splat_f64[row];
    if (row >= r->in.lobes) return 0;
    s.a = r->lobe_f64[row].a, s.k = r->lobe_f64[row].k, s.e = r->lobe_f64[row].e, s.peak = r->lobe_f64[row].peak;
    return OXL_MIN(oracle_value(&s, x, y), 0.99);
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
        const double            raw    = oracle_value(s, x, y) / raised;
        const double            alpha  = (raw < 0.99 ? raw : 0.99) - oracle_second(r, row, x, y);
        if ((lobe->visible[row / PACK] >> row % PACK & 1) && oracle_near(oracle_value(&lobe->splat_f64[row], x, y), 0.99))
            return 1;
        if (oracle_near(fabs(alpha), 1.0 / 255) || oracle_near(raw, 0.99)) return 1;
        if (fabs(alpha) < 1.0 / 255) continue;
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
    reference_lobes(&raised, (size_t)s->lobes);
    raised.lens_f64 = lobe.lens_f64 = r->lens_f64;
    raised.in.lobe_free             = 1;
    for (int k = OXL_LOBE; k < OXL_PLANES; k++) memcpy(raised.in.plane[k], r->in.plane[k], (size_t)s->lobes * sizeof(double));
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

/* The float kernels, through the renderer; results are widened into the reference's arrays. */
static void oracle_run_float(oxl_context *ctx, const struct oracle_scene *s, const oxl_camera *camera, struct reference *r,
                             const char *fragile, double *drgb, double *loss)
{
    const size_t       pixels  = (size_t)s->width * (size_t)s->height;
    oxl_render_options options = oxl_render_options_default();
    oxl_model          model = {0}, gradient = {0};
    struct renderer   *renderer = NULL;
    float             *narrow   = malloc(3 * pixels * sizeof *narrow);
    if (!narrow || oxl_model_create(ctx, (size_t)s->count, s->sh_degree, &model) != OXL_OK ||
        model_set_lobes(ctx, &model, (size_t)s->lobes) != OXL_OK ||
        oxl_model_create(ctx, (size_t)s->count, s->sh_degree, &gradient) != OXL_OK)
        oracle_quit("no memory", "");
    memset(gradient.plane[OXL_ROTATION], 0, (size_t)s->count * sizeof(float));
    options.near_plane = (float)s->near_plane;
    for (int c = 0; c < 3; c++) options.background[c] = (float)s->background[c];
    for (int k = 0; k < oxl_model_planes(&model); k++)
        for (int i = 0; i < s->count; i++) model.plane[k][i] = (float)r->in.plane[k][i];
    for (int k = OXL_LOBE; k < OXL_PLANES; k++)
        for (int i = 0; i < s->lobes; i++) model.plane[k][i] = (float)r->in.plane[k][i];
    if (renderer_create(ctx, &renderer) != OXL_OK || render_begin(ctx, renderer, &model, camera, &options) != OXL_OK)
        oracle_quit("render:", oxl_error_text(ctx));
    renderer->in.lobe_free = 1;
    render_project(ctx, renderer);
    if (bin_splats(ctx, &renderer->bins, s->width, s->height) != OXL_OK) oracle_quit("render:", oxl_error_text(ctx));
    render_each_tile(ctx, renderer, NULL, raster_forward);
    for (size_t i = 0; i < 3 * pixels; i++) r->rgb[i] = renderer->rgb[i];
    for (size_t i = 0; i < pixels; i++) r->transmittance[i] = renderer->transmittance[i];
    *loss = oracle_loss(ctx, s, r->rgb, fragile, drgb);
    for (size_t i = 0; i < 3 * pixels; i++) narrow[i] = (float)drgb[i];
    if (renderer_backward(ctx, renderer, narrow, &gradient) != OXL_OK) oracle_quit("render:", oxl_error_text(ctx));
    for (int k = 0; k < oxl_model_planes(&model); k++)
        for (int i = 0; i < s->count; i++) r->gradient.plane[k][i] = gradient.plane[k][i];
    for (int k = OXL_LOBE; k < OXL_PLANES; k++)
        for (int i = 0; i < s->lobes; i++) r->gradient.plane[k][i] = gradient.plane[k][i];
    renderer_free(ctx, renderer);
    oxl_model_free(ctx, &model);
    oxl_model_free(ctx, &gradient);
    free(narrow);
}

/* The gradient's rows in the scene's order. */
static void oracle_restore_order(const struct oracle_scene *s, struct reference *r)
{
    for (int k = 0; k < OXL_PLANES; k++) {
        double *was = r->gradient.plane[k], *now;
        if (!was) continue;
        r->gradient.plane[k] = now = reference_array((size_t)s->count);
        for (int i = 0; i < s->count; i++) now[s->order[i]] = was[i];
        free(was);
    }
}

/* Everything of one scene: image and gradients in *r, dL/d(image) in *drgb (the caller frees both), the loss. */
static void oracle_run(oxl_context *ctx, struct oracle_scene *s, int in_double, struct reference *r, double **drgb, double *loss)
{
    const oxl_camera camera = oracle_camera(s);
    char            *fragile;
    reference_create(r, (size_t)s->count, s->sh_degree);
    reference_lobes(r, (size_t)s->lobes);
    r->in.lobe_free = 1;
    r->lens_f64     = reference_lens(&camera, s->near_plane);
    memcpy(r->background, s->background, sizeof r->background);
    for (int k = 0; k < OXL_PLANES; k++)
        for (int i = 0; r->in.plane[k] && i < (k < OXL_LOBE ? s->count : s->lobes); i++)
            r->in.plane[k][i] = s->rows[i * oracle_row_size(s) + oracle_column(k)];
    reference_forward(ctx, r);
    fragile = oracle_find_fragile(ctx, s, r);
    *drgb   = reference_array(3 * (size_t)s->width * (size_t)s->height);
    if (in_double) {
        *loss = oracle_loss(ctx, s, r->rgb, fragile, *drgb);
        reference_backward(r, *drgb);
    } else oracle_run_float(ctx, s, &camera, r, fragile, *drgb, loss);
    oracle_restore_order(s, r);
    free(fragile);
}

static void oracle_scene_free(struct oracle_scene *s)
{
    free(s->rows);
    free(s->order);
}
