/* wide_splat.c - reference/splat.c as the tests call it: see wide.h. */
#define SPLAT_NO_MAIN
/* The library, which is linked too, has functions of these names. */
#define project_forward splat_project_forward
#define project_backward splat_project_backward
#define train_step splat_train_step
#include "../reference/splat.c"
#include "wide.h"

/* ---------------- views */

void *wide_array(size_t count)
{
    void *array = calloc(count + 64, sizeof(double)); /* the kernels read on to the end of a pack */
    if (!array) abort();
    return array;
}

void wide_create(struct wide *w, const oxl_camera *camera, size_t count, size_t lobes, int sh_degree)
{
    *w = (struct wide){.camera = *camera,
                       .near_plane = 0.2,
                       .alpha_min = ALPHA_MIN,
                       .count = count,
                       .lobes = lobes,
                       .sh_degree = sh_degree};
    for (int k = 0; k < OXL_PLANES; k++) {
        if (k < OXL_LOBE ? k >= OXL_SH + 3 * (sh_degree + 1) * (sh_degree + 1) : lobes == 0) continue;
        w->plane[k] = wide_array(count);
        w->gradient[k] = wide_array(count);
    }
    for (size_t i = 0; i < count; i++) w->plane[OXL_ROTATION][i] = 1;
    w->dmean2d = wide_array(count);
    w->inside = wide_array(count);
    wide_resize(w, camera->width, camera->height);
}

static void wide_free_image(struct wide *w)
{
    free(w->rgb), free(w->transmittance), free(w->depth);
}

void wide_resize(struct wide *w, int width, int height)
{
    const size_t pixels = (size_t)width * height;
    wide_free_image(w);
    w->camera.width = width, w->camera.height = height;
    w->rgb = wide_array(3 * pixels);
    w->transmittance = wide_array(pixels);
    w->depth = wide_array(pixels);
}

void wide_free(struct wide *w)
{
    for (int k = 0; k < OXL_PLANES; k++) free(w->plane[k]), free(w->gradient[k]);
    wide_free_image(w);
    free(w->dmean2d), free(w->inside);
    *w = (struct wide){0};
}

/* ---------------- into splat.c's terms; its image is (H,W,3), ours (3,H,W) */

struct scene {
    struct model model;
    struct camera camera;
    struct splat *splat;
    double *rgb; /* (H,W,3) */
    int count, pixels;
};

static struct camera scene_camera(const struct wide *w)
{
    const oxl_camera *c = &w->camera;
    struct camera cam = {{c->width, c->height},
                         {c->fx, c->fy},
                         {c->cx, c->cy},
                         .near_plane = w->near_plane,
                         .mip = w->antialias};
    memcpy(cam.rotation, c->rotation, sizeof cam.rotation);
    for (int i = 0; i < 9; i++) cam.origin[i % 3] -= c->rotation[i] * c->translation[i / 3]; /* -R^T t */
    return cam;
}

static struct gaussian scene_row(const struct wide *w, size_t i)
{
    struct gaussian g = {.lobed = i < w->lobes};
    double *x = (double *)&g;
    for (int k = 0; k < OXL_PLANES; k++) x[k] = w->plane[k] ? w->plane[k][i] : 0;
    return g;
}

static void scene_create(struct scene *s, const struct wide *w)
{
    *s = (struct scene){.model = {.count = (int)w->count, .degree = w->sh_degree}, .camera = scene_camera(w)};
    s->pixels = w->camera.width * w->camera.height;
    s->rgb = wide_array(3 * (size_t)s->pixels);
    s->splat = calloc(w->count + 1, sizeof *s->splat);
    s->model.row = calloc(w->count + 1, sizeof *s->model.row);
    if (!s->splat || !s->model.row) abort();
    memcpy(s->model.background, w->background, sizeof w->background);
    for (size_t i = 0; i < w->count; i++) s->model.row[i] = scene_row(w, i);
    s->count = render_forward(&s->model, &s->camera, s->splat, s->rgb);
}

static double scene_inside(const struct scene *scene, int row)
{
    const struct camera *c = &scene->camera;
    struct splat s = {0};
    double inside = 1e30;
    const int seen = project_forward(&scene->model.row[row], scene->model.degree, c, &s);
    if (s.p[2] <= c->near_plane || !(s.half[0] > 0)) return -1e30;
    for (int a = 0; a < 2; a++)
        inside =
            fmin(inside, s.half[a] - fmax(0, fabs(s.centre[a] - c->size[a] / 2.0) - (c->size[a] - 1) / 2.0));
    if (seen != (inside > 0)) abort();
    return inside;
}

static void scene_free(struct scene *s)
{
    free(s->splat), free(s->rgb), free(s->model.row);
}

/* ---------------- drawing, and back */

/* composite_forward with another threshold than ALPHA_MIN, or the same. */
static double pixel_forward(const struct wide *w, const struct splat *s, int count, double x, double y,
                            double rgb[3])
{
    double T = 1, G[2];
    for (int c = 0; c < 3; c++) rgb[c] = 0;
    for (int i = 0; i < count; i++) {
        const double alpha = alpha_forward(&s[i], x, y, T, G);
        if (fabs(alpha) < w->alpha_min) continue;
        if (T * (1 - alpha) < T_MIN) break;
        for (int c = 0; c < 3; c++) rgb[c] += s[i].colour[c] * alpha * T;
        T *= 1 - alpha;
    }
    for (int c = 0; c < 3; c++) rgb[c] += T * w->background[c];
    return T;
}

void splat_forward(struct wide *w)
{
    struct scene s;
    double rgb[3];
    scene_create(&s, w);
    for (int i = 0; i < s.pixels; i++) {
        w->transmittance[i] =
            pixel_forward(w, s.splat, s.count, i % w->camera.width + 0.5, i / w->camera.width + 0.5, rgb);
        for (int c = 0; c < 3; c++) w->rgb[c * s.pixels + i] = rgb[c];
        for (int c = 0; c < 3; c++) /* it is what render_forward draws */
            if (w->alpha_min == ALPHA_MIN && rgb[c] != s.rgb[3 * i + c]) abort();
    }
    for (size_t i = 0; i < w->count; i++) w->inside[i] = scene_inside(&s, (int)i);
    scene_free(&s);
}

void splat_backward(struct wide *w, const double *drgb)
{
    struct scene s;
    struct splat *ds = calloc(w->count + 1, sizeof *ds);
    struct gaussian *dg = calloc(w->count + 1, sizeof *dg);
    if (!ds || !dg) abort();
    scene_create(&s, w);
    double *interleaved = wide_array(3 * (size_t)s.pixels);
    for (int i = 0; i < 3 * s.pixels; i++) interleaved[i] = drgb[i % 3 * s.pixels + i / 3];
    render_backward(&s.model, &s.camera, s.splat, s.count, s.rgb, interleaved, ds, dg);
    for (int k = 0; k < OXL_PLANES; k++)
        for (size_t i = 0; i < wide_rows(w, k); i++) w->gradient[k][i] = ((double *)&dg[i])[k];
    memset(w->dmean2d, 0, w->count * sizeof *w->dmean2d);
    for (int i = 0; i < s.count; i++)
        w->dmean2d[s.splat[i].row] =
            hypot(ds[i].centre[0] * w->camera.width / 2, ds[i].centre[1] * w->camera.height / 2);
    free(interleaved), free(ds), free(dg);
    scene_free(&s);
}

/* One pixel's (o dS/dalpha)^2: that of o G alone, and none where it is held at ALPHA_MAX. */
static void pixel_score(const struct splat *s, int count, double x, double y, const double rgb[3],
                        const double drgb[3], double *score)
{
    double T = 1, G[2] = {0, 0}, behind = dot(drgb, rgb, 3);
    for (int i = 0; i < count; i++) {
        const double alpha = alpha_forward(&s[i], x, y, T, G), light = dot(drgb, s[i].colour, 3),
                     o = s[i].opacity[0];
        if (T * (1 - alpha) < T_MIN) return;
        if (alpha == 0) continue;
        behind -= light * alpha * T;
        if (o * G[0] < ALPHA_MAX) score[s[i].row] += pow(o * (T * light - behind / (1 - alpha)), 2);
        T *= 1 - alpha;
    }
}

void splat_score(struct wide *w, const double *drgb, double *score)
{
    struct scene s;
    scene_create(&s, w);
    for (int i = 0; i < s.pixels; i++) {
        const double d[3] = {drgb[i], drgb[s.pixels + i], drgb[2 * s.pixels + i]};
        pixel_score(s.splat, s.count, i % w->camera.width + 0.5, i / w->camera.width + 0.5, s.rgb + 3 * i, d,
                    score);
    }
    scene_free(&s);
}

/* ---------------- fragile pixels */

/* opacities below FAINT are raised by it, so that those which are only just too faint take part */
#define RAISE 1.002
#define FAINT 0.01

static int near(double x, double threshold)
{
    return fabs(x - threshold) < 1e-3 * threshold;
}

static int fragile_pixel(const struct wide *w, const struct splat *s, int count, double x, double y)
{
    double T = 1, last = -1;
    for (int i = 0; i < count; i++) {
        double value[2] = {0, 0};
        for (int k = 0; k < s[i].lobes; k++) {
            const double dx = x - s[i].centre[0], dy = y - s[i].centre[1], *K = s[i].conic[k];
            const double o = s[i].opacity[k] / (s[i].opacity[k] < FAINT * RAISE ? RAISE : 1);
            value[k] = o * exp(-(K[0] * dx * dx + 2 * K[1] * dx * dy + K[2] * dy * dy) / 2);
            if (near(value[k], ALPHA_MAX)) return 1;
        }
        double alpha = fmin(value[0], ALPHA_MAX) - fmin(value[1], ALPHA_MAX);
        if (near(fabs(alpha), ALPHA_MIN) || (alpha < 0 && near(T, T_MAX))) return 1;
        if (fabs(alpha) < ALPHA_MIN || (alpha < 0 && T >= T_MAX)) continue;
        if (near(T * (1 - alpha), T_MIN) || s[i].p[2] - last < 1e-6 * last) return 1;
        if (fabs(s[i].p[2] - w->near_plane) < 1e-4 * w->near_plane) return 1;
        if (T * (1 - alpha) < T_MIN) return 0;
        last = s[i].p[2];
        T *= 1 - alpha;
    }
    return 0;
}

void splat_fragile(const struct wide *w, char *fragile)
{
    struct wide raised = *w;
    struct scene s;
    raised.near_plane = w->near_plane * (1 - 1e-4);
    raised.plane[OXL_OPACITY] = wide_array(w->count);
    for (size_t i = 0; i < w->count; i++) {
        const double o = sigmoid(w->plane[OXL_OPACITY][i]), up = RAISE * o;
        raised.plane[OXL_OPACITY][i] = o < FAINT ? log(up / (1 - up)) : w->plane[OXL_OPACITY][i];
    }
    scene_create(&s, &raised);
    for (int i = 0; i < s.pixels; i++)
        fragile[i] =
            (char)fragile_pixel(w, s.splat, s.count, i % w->camera.width + 0.5, i / w->camera.width + 0.5);
    free(raised.plane[OXL_OPACITY]);
    scene_free(&s);
}

/* ---------------- loss, Adam, density control */

double splat_loss(int width, int height, double weight, const double *x, const double *y, double *dx)
{
    const size_t n = (size_t)width * height;
    double *a = wide_array(3 * n), *b = wide_array(3 * n), *da = wide_array(3 * n);
    for (size_t i = 0; i < 3 * n; i++) a[i] = x[i % 3 * n + i / 3], b[i] = y[i % 3 * n + i / 3];
    double value = loss(a, b, width, height, weight, da);
    for (size_t i = 0; i < 3 * n; i++) dx[i % 3 * n + i / 3] = da[i];
    free(a), free(b), free(da);
    return value;
}

void splat_adam(double *x, double gradient, double rate, int step, double *mean, double *square)
{
    adam(x, gradient, rate, step, mean, square);
}

double splat_learning_rate(int plane, double extent, double progress)
{
    return learning_rate(plane, extent, progress);
}

enum splat_verdict splat_classify(const double log_scale[3], double logit, double gradient, double extent,
                                  int was_reset)
{
    const struct gaussian g = {.log_scale = {log_scale[0], log_scale[1], log_scale[2]}, .logit = logit};
    return (enum splat_verdict)classify(&g, gradient, extent, was_reset);
}

void splat_split(double row[OXL_SH], int side)
{
    struct gaussian g;
    memset(&g, 0, sizeof g);
    memcpy(&g, row, OXL_SH * sizeof *row);
    split(&g, side);
    memcpy(row, &g, OXL_SH * sizeof *row);
}
