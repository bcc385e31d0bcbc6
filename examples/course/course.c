/* course.c - the figures of the course: each chapter reads in[], calls reference/splat.c, and writes every number it shows to
 * out[].  The page (WebAssembly) and the native check (numbers.c) compile this same file; the page computes no number of its
 * own. A chapter is a function chapter(void) that returns how many numbers it wrote. field[] holds an image or a curve. */
#define SPLAT_NO_MAIN
#include "../../reference/splat.c"

#ifdef __wasm__
#define EXPORT __attribute__((visibility("default"), used))
#else
#define EXPORT
#endif

enum { INPUTS = 64, OUTPUTS = 8192, FIELD = 3 * 120 * 90 };
double in[INPUTS], out[OUTPUTS], field[FIELD];

EXPORT double *course_in(void) { return in; }
EXPORT double *course_out(void) { return out; }
EXPORT double *course_field(void) { return field; }

static unsigned course_seed = 1;
/* Uniform in 0..1. */
static double course_random(void) { return ((course_seed = course_seed * 1664525u + 1013904223u) + 0.5) / 4294967296.0; }

static double course_logit(double p) { return log(p / (1 - p)); }

/* The coefficient of degree 0 that shows as colour c from everywhere. */
static double course_sh(double c) { return (c - 0.5) * sqrt(4 * PI); }

static struct camera course_camera(int width, int height, double focal) {
    return (struct camera){
        {width, height}, {focal, focal}, {width / 2.0, height / 2.0}, {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, {0, 0, 0}, 0.2, 0};
}

/* ---------------------------------------------------------------- 1: one Gaussian */

/* Turned by `angle` about the line of sight, after a tilt about the vertical; degrees. */
static void course_rotation(double angle, double tilt, double q[4]) {
    const double a = angle * PI / 360, t = tilt * PI / 360;
    q[0] = cos(a) * cos(t), q[1] = -sin(a) * sin(t), q[2] = cos(a) * sin(t), q[3] = sin(a) * cos(t);
}

/* in: centre x, y (px), depth, angle, tilt (degrees), three scales (world units), opacity, the line's row (px).
 * out: covariance xx, xy, yy; its determinant; conic A, B, C; standard deviations along the axes (px), angle of the longer
 * (degrees); half box x, y; 1 in view; alpha at the centre; alpha along the line (120).
 * field: alpha (120 x 90). */
EXPORT int one_gaussian(void) {
    const struct camera cam = course_camera(120, 90, 120);
    struct gaussian g = {.logit = course_logit(in[8])};
    struct splat s = {.row = 0};
    double G[2], xx, xy, yy, root;
    g.mean[0] = (in[0] - 60) / 120 * in[2], g.mean[1] = (in[1] - 45) / 120 * in[2], g.mean[2] = in[2];
    for (int a = 0; a < 3; a++) g.log_scale[a] = log(in[5 + a]);
    course_rotation(in[3], in[4], g.rotation);
    out[12] = project_forward(&g, 0, &cam, &s);
    xx = dot(s.B[0][0], s.B[0][0], 3) + LOW_PASS, xy = dot(s.B[0][0], s.B[0][1], 3), yy = dot(s.B[0][1], s.B[0][1], 3) + LOW_PASS;
    root = sqrt((xx - yy) * (xx - yy) / 4 + xy * xy);
    out[0] = xx, out[1] = xy, out[2] = yy, out[3] = 1 / (s.conic[0][0] * s.conic[0][2] - s.conic[0][1] * s.conic[0][1]);
    for (int k = 0; k < 3; k++) out[4 + k] = s.conic[0][k];
    out[7] = sqrt((xx + yy) / 2 + root), out[8] = sqrt(fmax(0, (xx + yy) / 2 - root));
    out[9] = root > 1e-12 ? atan2(2 * xy, xx - yy) * 90 / PI : 0;
    out[10] = s.half[0], out[11] = s.half[1];
    out[13] = alpha_forward(&s, in[0], in[1], 1, G);
    for (int x = 0; x < 120; x++) out[14 + x] = alpha_forward(&s, x + 0.5, in[9], 1, G);
    for (int i = 0; i < 120 * 90; i++) field[i] = alpha_forward(&s, i % 120 + 0.5, i / 120 + 0.5, 1, G);
    return 134;
}

/* ---------------------------------------------------------------- 2: compositing */

enum { LAYERS = 8 };
/* x, y (px of a 96 x 72 image), depth, two scales (px at that depth), angle, opacity, r, g, b */
static const double LAYER[LAYERS][10] = {
    {40, 31, 2.0, 9, 6, 20, 0.75, 0.93, 0.52, 0.20},    {52, 35, 2.6, 11, 7, -30, 0.80, 0.20, 0.55, 0.62},
    {46, 42, 3.1, 13, 5, 65, 0.70, 0.85, 0.75, 0.30},   {56, 29, 3.7, 10, 9, 0, 0.85, 0.55, 0.30, 0.60},
    {38, 41, 4.4, 15, 9, -15, 0.80, 0.25, 0.65, 0.35},  {50, 29, 5.2, 19, 12, 40, 0.90, 0.80, 0.30, 0.35},
    {50, 44, 6.1, 22, 14, -60, 0.90, 0.35, 0.40, 0.75}, {48, 36, 7.5, 34, 24, 0, 0.95, 0.60, 0.58, 0.50},
};
static const double BACKDROP[3] = {0.05, 0.25, 0.35};

static struct gaussian course_flat(const double layer[10], double focal, double centre_x, double centre_y, double more_logit) {
    struct gaussian g = {.logit = course_logit(layer[6]) + more_logit};
    g.mean[0] = (layer[0] - centre_x) / focal * layer[2], g.mean[1] = (layer[1] - centre_y) / focal * layer[2],
    g.mean[2] = layer[2];
    for (int a = 0; a < 2; a++) g.log_scale[a] = log(layer[3 + a] / focal * layer[2]);
    g.log_scale[2] = log(0.02);
    course_rotation(layer[5], 0, g.rotation);
    for (int c = 0; c < 3; c++) g.sh[c] = course_sh(layer[7 + c]);
    return g;
}

/* in: pixel x, y; what is added to each logit; how many splats are composited, 0..8.
 * out: r, g, b of the pixel; T behind the last; splats used; steps (8 x 10): row, depth, alpha, T before, weight alpha T, r, g,
 * b, 1 used / 0 no contribution / -1 the pixel ends here, T after.
 * field: rgb (96 x 72). */
EXPORT int compositing(void) {
    const struct camera cam = course_camera(96, 72, 96);
    struct gaussian row[LAYERS];
    struct splat s[LAYERS];
    struct model m = {LAYERS, 0, {BACKDROP[0], BACKDROP[1], BACKDROP[2]}, row};
    double T = 1, G[2];
    int used = 0, ended = 0, count;
    for (int i = 0; i < LAYERS; i++) row[i] = course_flat(LAYER[i], 96, 48, 36, in[2]);
    count = render_forward(&m, &cam, s, field);
    if (count > in[3]) {
        count = (int)in[3];
        for (int i = 0; i < 96 * 72; i++) composite_forward(s, count, m.background, i % 96 + 0.5, i / 96 + 0.5, field + 3 * i);
    }
    for (int i = 0; i < LAYERS; i++) {
        double *step = out + 5 + 10 * i;
        const double alpha = i < count && !ended ? alpha_forward(&s[i], in[0] + 0.5, in[1] + 0.5, T, G) : 0;
        for (int k = 0; k < 10; k++) step[k] = 0;
        if (i >= count) continue;
        if (T * (1 - alpha) < T_MIN) ended = 1;
        step[0] = s[i].row, step[1] = s[i].p[2], step[2] = alpha, step[3] = T, step[4] = ended ? 0 : alpha * T;
        for (int c = 0; c < 3; c++) step[5 + c] = s[i].colour[c];
        step[8] = ended ? -1 : alpha != 0, used += !ended && alpha != 0;
        if (!ended) T *= 1 - alpha;
        step[9] = T;
    }
    out[3] = composite_forward(s, count, m.background, in[0] + 0.5, in[1] + 0.5, out);
    out[4] = used;
    return 5 + 10 * LAYERS;
}

/* ---------------------------------------------------------------- 3: gradients */

enum { THREE = 3, NUMBERS = 14 };
static const double THREE_LAYER[THREE][10] = {{36, 34, 2.5, 12, 6, 25, 0.70, 0.93, 0.52, 0.20},
                                              {56, 30, 3.5, 14, 8, -35, 0.75, 0.25, 0.60, 0.70},
                                              {50, 46, 4.5, 18, 9, 5, 0.85, 0.60, 0.70, 0.30}};
/* Where mean, log_scale, rotation, logit and the three coefficients of degree 0 are in struct gaussian. */
static const int NUMBER[NUMBERS] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13};

/* L = 1/2 |C - wanted|^2 at one pixel; the gradient is added to dg unless it is NULL. */
static double pixel_loss(struct gaussian *row, int count, double x, double y, const double wanted[3], struct splat *ds,
                         struct gaussian *dg) {
    const struct camera cam = course_camera(96, 72, 96);
    struct splat s[THREE];
    double rgb[3], drgb[3], L = 0;
    int seen = 0;
    for (int i = 0, at; i < count; i++) { /* in depth order, as render_forward */
        struct splat new = {.row = i};
        if (!project_forward(&row[i], 0, &cam, &new)) continue;
        for (at = seen++; at > 0 && s[at - 1].p[2] > new.p[2]; at--) s[at] = s[at - 1];
        s[at] = new;
    }
    composite_forward(s, seen, BACKDROP, x, y, rgb);
    for (int c = 0; c < 3; c++) drgb[c] = rgb[c] - wanted[c], L += drgb[c] * drgb[c] / 2;
    if (!dg) return L;
    composite_backward(s, seen, x, y, rgb, drgb, ds);
    for (int i = 0; i < seen; i++) project_backward(&row[s[i].row], 0, &cam, &s[i], &ds[i], &dg[s[i].row]);
    for (int c = 0; c < 3; c++) out[c] = rgb[c];
    return L;
}

/* in: pixel x, y; wanted r, g, b; the selected Gaussian 0..2; its x, y (px), angle (degrees), two scales (px), opacity.
 * out: C r, g, b; L; 14 numbers of the selected Gaussian: gradient, then 14 finite differences; then of each of the three:
 * centre x, y (px), dL/dcentre x, y, dL/dlog_scale 1, 2, dL/dangle (1/radian), dL/dlogit, dL/dsh r, g, b.
 * field: rgb (96 x 72). */
EXPORT int gradients(void) {
    const struct camera cam = course_camera(96, 72, 96);
    const double h = 1e-5, *wanted = in + 2;
    struct gaussian row[THREE], dg[THREE];
    struct splat s[THREE], ds[THREE];
    struct model m = {THREE, 0, {BACKDROP[0], BACKDROP[1], BACKDROP[2]}, row};
    const int chosen = (int)in[5];
    for (int i = 0; i < THREE; i++) {
        double layer[10];
        memcpy(layer, THREE_LAYER[i], sizeof layer);
        if (i == chosen)
            layer[0] = in[6], layer[1] = in[7], layer[5] = in[8], layer[3] = in[9], layer[4] = in[10], layer[6] = in[11];
        row[i] = course_flat(layer, 96, 48, 36, 0);
    }
    render_forward(&m, &cam, s, field);
    memset(dg, 0, sizeof dg), memset(ds, 0, sizeof ds);
    out[3] = pixel_loss(row, THREE, in[0] + 0.5, in[1] + 0.5, wanted, ds, dg);
    for (int k = 0; k < NUMBERS; k++) {
        double *x = (double *)&row[chosen] + NUMBER[k], at = *x, above, below;
        *x = at + h, above = pixel_loss(row, THREE, in[0] + 0.5, in[1] + 0.5, wanted, NULL, NULL);
        *x = at - h, below = pixel_loss(row, THREE, in[0] + 0.5, in[1] + 0.5, wanted, NULL, NULL);
        *x = at, out[4 + k] = ((double *)&dg[chosen])[NUMBER[k]], out[4 + NUMBERS + k] = (above - below) / (2 * h);
    }
    for (int i = 0; i < THREE; i++) { /* dq/dangle: half of (0, 0, 0, 1) q, the turn about the line of sight */
        const double *q = row[i].rotation, turn[4] = {-q[3] / 2, -q[2] / 2, q[1] / 2, q[0] / 2};
        double *o = out + 4 + 2 * NUMBERS + 11 * i;
        for (int a = 0; a < 2; a++) {
            o[a] = cam.focal[a] * row[i].mean[a] / row[i].mean[2] + cam.centre[a];
            o[2 + a] = dg[i].mean[a] * row[i].mean[2] / cam.focal[a], o[4 + a] = dg[i].log_scale[a];
        }
        o[6] = dot(dg[i].rotation, turn, 4), o[7] = dg[i].logit;
        for (int c = 0; c < 3; c++) o[8 + c] = dg[i].sh[c];
    }
    return 4 + 2 * NUMBERS + 11 * THREE;
}

/* ---------------------------------------------------------------- 4, 5: fitting, density control */

enum { FIT_W = 48, FIT_H = 36 };
/* Chapters 4 and 5 have a model each; fit is the one in use. */
static struct fit {
    struct trainer t;
    int steps;
    double loss; /* of t.rgb: before the last step, or at the start */
} fits[2], *fit = fits;
static double fit_target[3 * PIXELS];

/* The image that is fitted: a fish over sand, with hard edges. u to the right, v down, 0..1. */
static void fit_scene(double u, double v, double rgb[3]) {
    const double ripple = 0.5 + 0.5 * sin(40 * u + 9 * sin(7 * v)), x = (u - 0.5) / 0.27, y = (v - 0.42) / 0.2;
    const double tail = u - 0.77, stripe = fabs(u - 0.43), eye = (u - 0.32) * (u - 0.32) * 16 + (v - 0.37) * (v - 0.37) * 9;
    const int body = x * x + y * y < 1;
    double colour[3] = {0.08 + 0.10 * v, 0.40 - 0.12 * v, 0.55 - 0.12 * v};
    if (v > 0.78 + 0.03 * sin(11 * u))
        colour[0] = 0.62 + 0.14 * ripple, colour[1] = 0.56 + 0.12 * ripple, colour[2] = 0.40 + 0.08 * ripple;
    if (body || (tail > -0.06 && tail < 0.11 && fabs(v - 0.42) < 0.04 + 0.9 * fmax(0, tail)))
        colour[0] = 0.95, colour[1] = 0.48, colour[2] = 0.10;
    if (body && (stripe < 0.035 || fabs(u - 0.6) < 0.03)) colour[0] = 0.97, colour[1] = 0.96, colour[2] = 0.92;
    if (eye < 0.009) colour[0] = 0.05, colour[1] = 0.06, colour[2] = 0.08;
    memcpy(rgb, colour, sizeof colour);
}

static int fit_forward(void) {
    const struct camera cam = course_camera(FIT_W, FIT_H, 48);
    const int count = render_forward(&fit->t.model, &cam, fit->t.s, fit->t.rgb);
    fit->loss = loss(fit->t.rgb, fit_target, FIT_W, FIT_H, 0.2, fit->t.drgb);
    return count;
}

/* in: which of the two models is used from here on. */
EXPORT int fit_select(void) {
    fit = &fits[in[0] != 0];
    return 0;
}

/* in: number of Gaussians, seed, their standard deviation (px). */
EXPORT int fit_reset(void) {
    const int count = (int)in[0];
    double sample[3];
    memset(fit, 0, sizeof *fit);
    fit->t.model = (struct model){count, 0, {0.3, 0.4, 0.45}, fit->t.x}, fit->t.extent = 16;
    memset(fit_target, 0, sizeof fit_target);
    for (int i = 0; i < 16 * PIXELS; i++) { /* 4 x 4 samples a pixel */
        const int p = i / 16, sx = i % 4, sy = i / 4 % 4;
        fit_scene((p % FIT_W + (sx + 0.5) / 4) / FIT_W, (p / FIT_W + (sy + 0.5) / 4) / FIT_H, sample);
        for (int c = 0; c < 3; c++) fit_target[3 * p + c] += sample[c] / 16;
    }
    course_seed = (unsigned)in[1] * 977u + 12345u;
    for (int i = 0; i < count; i++) {
        const double x = FIT_W * course_random(), y = FIT_H * course_random(), z = 3.8 + 0.4 * course_random();
        const double layer[10] = {x, y, z, in[2], in[2], 0, 0.3, 0.5, 0.5, 0.5};
        fit->t.x[i] = course_flat(layer, 48, FIT_W / 2.0, FIT_H / 2.0, 0), fit->t.x[i].log_scale[2] = fit->t.x[i].log_scale[0];
    }
    fit_forward();
    return 0;
}

/* One step as train_step of splat.c takes it, with learning rates times `factor`. */
static void fit_step(double factor) {
    const struct camera cam = course_camera(FIT_W, FIT_H, 48);
    struct trainer *t = &fit->t;
    const int count = fit_forward();
    memset(t->ds, 0, sizeof t->ds), memset(t->d, 0, sizeof t->d), fit->steps++;
    render_backward(&t->model, &cam, t->s, count, t->rgb, t->drgb, t->ds, t->d);
    for (int i = 0; i < count; i++) {
        const int row = t->s[i].row;
        double *x = (double *)&t->x[row], *m = (double *)&t->m[row], *v = (double *)&t->v[row], *d = (double *)&t->d[row];
        for (int k = 0; k < 14; k++) adam(x + k, d[k], factor * learning_rate(k, t->extent, 0), fit->steps, m + k, v + k);
        t->views[row]++, t->gradient_sum[row] += hypot(t->ds[i].centre[0] * FIT_W / 2, t->ds[i].centre[1] * FIT_H / 2);
    }
}

/* in: learning-rate factor, steps. */
EXPORT int fit_run(void) {
    for (int i = 0; i < (int)in[1]; i++) fit_step(in[0]);
    return 0;
}

EXPORT int fit_densify(void) {
    densify(&fit->t, 0);
    fit_forward();
    return 0;
}

/* out: loss and PSNR (dB) of the image before the last step, steps, Gaussians, steps since the last densification, how many
 * Gaussians density control would remove, keep, split; of each Gaussian (300 x 8): centre x, y (px), covariance xx, xy,
 * yy, opacity, mean gradient of the centre in half images, verdict 0..2.
 * field: rgb (48 x 36), then the wanted rgb. */
EXPORT int fit_show(void) {
    const struct camera cam = course_camera(FIT_W, FIT_H, 48);
    double square = 0;
    for (int i = 0; i < 3 * PIXELS; i++) {
        const double error = fit->t.rgb[i] - fit_target[i];
        field[i] = fit->t.rgb[i], field[3 * PIXELS + i] = fit_target[i], square += error * error / (3 * PIXELS);
    }
    out[0] = fit->loss, out[1] = -10 * log10(square), out[2] = fit->steps, out[3] = fit->t.model.count;
    for (int i = 4; i < 9; i++) out[i] = 0;
    for (int i = 0; i < fit->t.model.count; i++) {
        const struct gaussian *g = &fit->t.x[i];
        struct splat s = {.row = i};
        double *o = out + 9 + 8 * i;
        project_forward(g, 0, &cam, &s);
        o[0] = s.centre[0], o[1] = s.centre[1], o[5] = sigmoid(g->logit),
        o[6] = fit->t.gradient_sum[i] / fmax(1, fit->t.views[i]);
        o[2] = dot(s.B[0][0], s.B[0][0], 3), o[3] = dot(s.B[0][0], s.B[0][1], 3), o[4] = dot(s.B[0][1], s.B[0][1], 3);
        out[4] = fmax(out[4], fit->t.views[i]), o[7] = classify(g, o[6], fit->t.extent, 0), out[5 + (int)o[7]]++;
    }
    return 9 + 8 * fit->t.model.count;
}

/* ---------------------------------------------------------------- 6: underwater, second lobe */

/* What reaches the camera of a surface of colour J at the distance r (m), of one channel [O: src/render/medium.h]:
 *     c = J (sun + lamp / r^2 e^(-beta r)) e^(-beta r) + Binf (1 - e^(-beta r)).
 * The lamp's light passes the water twice, and spreads. Returns dc/dJ. */
double water_forward(double J, double r, double beta, double sun, double lamp, double Binf, double *c) {
    const double through = exp(-beta * r), lit = (sun + lamp / (r * r) * through) * through;
    *c = J * lit + Binf * (1 - through);
    return lit;
}

/* The weight of a gradient from the distance r in density control: 1, f_mid, f_far [O eq. 2]. */
double depth_weight(double r, double z_near, double z_far, double f_mid, double f_far) {
    return r < z_near ? 1 : r < z_far ? f_mid : f_far;
}

enum { RANGES = 96 };
/* in: beta r, g, b (1/m); sun; lamp; Binf r, g, b; J r, g, b; f_mid, f_far; the distance that is read (m).
 * out: at that distance c r, g, b and dc/dJ r, g, b; the weight, the mean gradient and the weighted one.
 * field (96 x 8), from 0.5 to 10 m: r, c r, g, b, mean dc/dJ, weight, mean gradient 8e-4 dc/dJ of the three channels, and that
 * weighted. */
EXPORT int underwater(void) {
    for (int i = 0; i <= RANGES; i++) {
        const double r = i < RANGES ? 0.5 + 9.5 * i / (RANGES - 1) : in[13], w = depth_weight(r, 3, 6, in[11], in[12]);
        double c[3], d[3], mean = 0;
        for (int k = 0; k < 3; k++) d[k] = water_forward(in[8 + k], r, in[k], in[3], in[4], in[5 + k], &c[k]), mean += d[k] / 3;
        if (i == RANGES) {
            for (int k = 0; k < 3; k++) out[k] = c[k], out[3 + k] = d[k];
            out[6] = w, out[7] = 8e-4 * mean, out[8] = 8e-4 * mean * w;
        } else {
            const double row[8] = {r, c[0], c[1], c[2], mean, w, 8e-4 * mean, 8e-4 * mean * w};
            memcpy(field + 8 * i, row, sizeof row);
        }
    }
    return 9;
}

/* in: opacity o, standard deviation (px), o'/o, s'/s.
 * out: px from 90 % to 10 % of alpha at the centre, without and with the second lobe; alpha at the centre, without and with; the
 * least alpha.
 * field: alpha at x = 0..60 px from the centre in steps of 1/4 px without (240), with (240). */
EXPORT int second_lobe(void) {
    for (int lobed = 0; lobed < 2; lobed++) {
        const struct camera cam = course_camera(160, 20, 100);
        struct gaussian g = {.mean = {0, 0, 10}, .rotation = {1}, .logit = course_logit(in[0]), .lobed = lobed};
        struct splat s = {.row = 0};
        double G[2], first = 0, last = 0, least = 0, at = 0;
        for (int a = 0; a < 3; a++) g.log_scale[a] = log(in[1] / 10), g.lobe[1 + a] = log(in[3]);
        g.lobe[0] = course_logit(in[2]);
        project_forward(&g, 0, &cam, &s);
        for (int i = 0; i < 240; i++) {
            const double alpha = field[240 * lobed + i] = alpha_forward(&s, 80 + i / 4.0, 10, 1, G),
                         before = i ? field[240 * lobed + i - 1] : alpha;
            if (i == 0) at = alpha;
            least = fmin(least, alpha);
            if (first == 0 && alpha < 0.9 * at) first = i / 4.0 - (0.9 * at - alpha) / (before - alpha) / 4;
            if (last == 0 && alpha < 0.1 * at) last = i / 4.0 - (0.1 * at - alpha) / (before - alpha) / 4;
        }
        out[lobed] = last - first, out[2 + lobed] = at, out[4 + lobed] = least;
    }
    return 6;
}

/* ---------------------------------------------------------------- 7: partition */

enum { POINTS = 700, CAMERAS = 84, BLOCKS = 24 };
static double point[POINTS][2], camera_at[CAMERAS][2]; /* m, in a survey of 60 x 40 m seen from above */

/* Reefs of many points on a plain with few, and a lawnmower path of 7 lanes. */
static void survey_make(void) {
    const double reef[4][4] = {{14, 11, 5, 3}, {46, 28, 4, 5}, {40, 9, 7, 2.5}, {18, 31, 3, 3}};
    course_seed = 7;
    for (int i = 0; i < POINTS; i++) {
        const double *r = reef[i % 4], u = course_random(), v = course_random(), radius = sqrt(-2 * log(u));
        const double x = i % 7 < 4 ? r[0] + r[2] * radius * cos(2 * PI * v) : 60 * u,
                     y = i % 7 < 4 ? r[1] + r[3] * radius * sin(2 * PI * v) : 40 * v;
        point[i][0] = fmax(0.2, fmin(59.8, x)), point[i][1] = fmax(0.2, fmin(39.8, y));
    }
    for (int i = 0; i < CAMERAS; i++) {
        const int lane = i / 12, at = lane % 2 ? 11 - i % 12 : i % 12;
        camera_at[i][0] = 2.5 + 5 * at, camera_at[i][1] = 3.5 + 5.5 * lane;
    }
}

/* Axis-aligned box x0, y0, x1, y1 (m). */
static int box_holds(const double box[4], const double p[2]) {
    return p[0] >= box[0] && p[0] < box[2] && p[1] >= box[1] && p[1] < box[3];
}

/* A camera sees the points within 5 m. It belongs to a block that holds more than 0.3 of what it sees, or of whose points it
 * sees more than 0.1 [O sec. 3.1: src/large/partition_make.c]. */
int box_has_camera(const double box[4], const double camera[2]) {
    int seen = 0, both = 0, inside = 0;
    for (int i = 0; i < POINTS; i++) {
        const int sees = fabs(point[i][0] - camera[0]) < 5 && fabs(point[i][1] - camera[1]) < 5, holds = box_holds(box, point[i]);
        seen += sees, inside += holds, both += sees && holds;
    }
    return both > 0.3 * seen || both > 0.1 * inside;
}

/* Where to cut a box across its longer axis: of the ratios 0.30, 0.32 .. 0.70 the one that divides its points most equally [O
 * Alg. 1]. */
double best_cut(const double box[4], int *axis) {
    double best = 0;
    int least = POINTS + 1;
    *axis = box[3] - box[1] > box[2] - box[0];
    for (int k = 0; k <= 20; k++) {
        const double cut = box[*axis] + (0.30 + 0.02 * k) * (box[2 + *axis] - box[*axis]);
        int difference = 0;
        for (int i = 0; i < POINTS; i++)
            if (box_holds(box, point[i])) difference += point[i][*axis] < cut ? 1 : -1;
        if (difference < 0) difference = -difference;
        if (difference < least) least = difference, best = cut;
    }
    return best;
}

/* in: number of cuts; then of each: x, y (m) of the place, axis (0: x, 1: y, -1: the program chooses axis and place).
 * out: blocks; most points / mean points; camera entries of all blocks / cameras; of each block (24 x 6): box, points, cameras;
 * axis and place of each cut (23 x 2).
 * field: x, y of the points (700), then of the cameras (84). */
EXPORT int partition(void) {
    double box[BLOCKS][4] = {{0, 0, 60, 40}}, most = 0, entries = 0;
    int blocks = 1;
    survey_make();
    memcpy(field, point, sizeof point), memcpy(field + 2 * POINTS, camera_at, sizeof camera_at);
    for (int k = 0; k < (int)in[0] && blocks < BLOCKS; k++) {
        const double *cut = in + 1 + 3 * k;
        int b = 0, axis = (int)cut[2];
        double at;
        for (int i = 0; i < blocks; i++)
            if (box_holds(box[i], cut)) b = i;
        at = axis < 0 ? best_cut(box[b], &axis) : cut[axis];
        memcpy(box[blocks], box[b], sizeof box[b]);
        box[b][2 + axis] = box[blocks++][axis] = at, out[3 + 6 * BLOCKS + 2 * k] = axis, out[4 + 6 * BLOCKS + 2 * k] = at;
    }
    for (int b = 0; b < blocks; b++) {
        double *o = out + 3 + 6 * b;
        memcpy(o, box[b], sizeof box[b]), o[4] = o[5] = 0;
        for (int i = 0; i < POINTS; i++) o[4] += box_holds(box[b], point[i]);
        for (int i = 0; i < CAMERAS; i++) o[5] += box_has_camera(box[b], camera_at[i]);
        most = fmax(most, o[4]), entries += o[5];
    }
    out[0] = blocks, out[1] = most * blocks / POINTS, out[2] = entries / CAMERAS;
    return 3 + 6 * blocks;
}

/* ---------------------------------------------------------------- numerics */

/* The determinant of the covariance on the image of a needle turned by `angle`, with standard deviations of `major` and `minor`
 * px: as xx yy - xy^2 of the covariance's float entries; as |b0 x b1|^2 + h (|b0|^2 + |b1|^2 + h) in float (ellipse_forward);
 * the same in double. */
static void needle_det(double angle, double major, double minor, double det[3]) {
    const double c = cos(angle), s = sin(angle), h = LOW_PASS;
    const float a0 = (float)(c * major), a1 = (float)(-s * minor), b0 = (float)(s * major), b1 = (float)(c * minor),
                hf = (float)h;
    const float xx = a0 * a0 + a1 * a1 + hf, xy = a0 * b0 + a1 * b1, yy = b0 * b0 + b1 * b1 + hf;
    const float cross = a0 * b1 - a1 * b0;
    const double A0 = a0, A1 = a1, B0 = b0, B1 = b1, H = hf, exact = A0 * B1 - A1 * B0;
    det[0] = xx * yy - xy * xy;
    det[1] = cross * cross + hf * (xx + yy - hf);
    det[2] = exact * exact + H * (A0 * A0 + A1 * A1 + B0 * B0 + B1 * B1 + H);
}

/* in: log10 of the needle's ratio, its angle (degrees). The minor axis is 0.01 px.
 * out: det: usual, ours, double; relative errors of both.
 * field (61 x 3): log10 ratio 0..6, largest relative errors over 90 angles. */
EXPORT int needle(void) {
    double det[3];
    needle_det(in[1] * PI / 180, 0.01 * pow(10, in[0]), 0.01, det);
    for (int k = 0; k < 3; k++) out[k] = det[k];
    for (int k = 0; k < 2; k++) out[3 + k] = fabs(det[k] - det[2]) / det[2];
    for (int i = 0; i <= 60; i++) {
        double *row = field + 3 * i;
        row[0] = i / 10.0, row[1] = row[2] = 0;
        for (int a = 0; a < 90; a++) {
            needle_det((a + 0.5) * PI / 180, 0.01 * pow(10, row[0]), 0.01, det);
            for (int k = 0; k < 2; k++) row[1 + k] = fmax(row[1 + k], fabs(det[k] - det[2]) / det[2]);
        }
    }
    return 5;
}

enum { TERMS = 4096 };
/* in: how many threads share the sum; which of the orders they end in (a seed).
 * out: the float sum forwards, backwards, smallest first, in pairs, by threads in the order they end; the sum in double.
 * field: the threads' order. */
EXPORT int summation(void) {
    static float term[TERMS], sorted[TERMS];
    const int threads = (int)in[0];
    float forwards = 0, backwards = 0, smallest = 0, shared = 0;
    double exact = 0;
    int order[16];
    course_seed = 11;
    for (int i = 0; i < TERMS; i++) term[i] = (float)((course_random() - 0.4) * exp(12 * course_random() - 9));
    for (int i = 0, at; i < TERMS; i++) {
        for (at = i; at > 0 && fabs(sorted[at - 1]) > fabs(term[i]); at--) sorted[at] = sorted[at - 1];
        sorted[at] = term[i];
    }
    for (int i = 0; i < TERMS; i++)
        forwards += term[i], backwards += term[TERMS - 1 - i], smallest += sorted[i], exact += term[i];
    course_seed = (unsigned)in[1] * 7919u + 5u;
    for (int i = 0; i < threads; i++) {
        const int k = (int)(course_random() * (i + 1));
        order[i] = order[k], order[k] = i;
    }
    for (int i = 0; i < threads; i++) {
        float part = 0;
        for (int k = order[i] * TERMS / threads; k < (order[i] + 1) * TERMS / threads; k++) part += term[k];
        shared += part, field[i] = order[i];
    }
    for (int n = TERMS / 2; n > 0; n /= 2)
        for (int i = 0; i < n; i++) term[i] = term[2 * i] + term[2 * i + 1];
    out[0] = forwards, out[1] = backwards, out[2] = smallest, out[3] = term[0], out[4] = shared, out[5] = exact;
    return 6;
}

/* in: alpha of each layer, negative; layers.
 * out: T behind the last with the limit T_MAX and without; largest T with it.
 * field: T behind each layer with the limit (200), without (200). */
EXPORT int growth(void) {
    struct splat s = {.lobes = 2, .half = {1, 1}, .opacity = {0, -in[0]}};
    double G[2], T = 1, open = 1, most = 1;
    for (int i = 0; i < (int)in[1]; i++) {
        T *= 1 - alpha_forward(&s, 0, 0, T, G), open *= 1 - alpha_forward(&s, 0, 0, 0, G);
        most = fmax(most, T), field[i] = T, field[200 + i] = open;
    }
    out[0] = T, out[1] = open, out[2] = most;
    return 3;
}
