/* splat.c - 3D Gaussian Splatting in one file: its formulas once, plainly, in double precision.
 *
 *     cc reference/splat.c -lm && ./a.out
 *
 * trains a model of the small scene in scene.h, prints the loss, and writes splat.ply, which viewers of Gaussian splats open, and
 * splat.bmp: a view that training never saw, the truth above the model. splat.truth has the images, for a changed copy to train with.
 *
 * A scene is a cloud of Gaussians: soft ellipsoids with an opacity and a colour that depends on the direction of view. Each is
 * projected to an ellipse on the image; a pixel mixes the ellipses over it, front to back. All of it has a derivative, so gradient
 * descent fits the cloud to images. dX stands for dL/dX, where L is the loss. A backward function follows its forward
 * function, and adds to the gradients that it is given. tests/test_reference.c compares src/, float and fast, with this file.
 *
 * [K] Kerbl et al. 2023, 3D Gaussian Splatting; [K*] its code   [Z] Zwicker et al. 2001, EWA Volume Splatting
 * [W] Wang et al. 2004, Image Quality Assessment (SSIM)   [A] Kingma & Ba 2015, Adam   [Y] Yu et al. 2024, Mip-Splatting
 * [O] the OceanXL paper, SIGGRAPH Asia 2026, doi 10.1145/3829340.3842316
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define PI            3.14159265358979323846
#define LOW_PASS      0.3    /* px^2 added to the variances of a splat: none is thinner than a pixel [K*] */
#define MIP_LOW_PASS  0.1    /* the same of an anti-aliased model: a pixel's own width [Y] */
#define FADE_MIN      2.5e-5 /* anti-aliased: o is scaled by sqrt(max(this, det V0 / det V)), V0 without low pass [Y, its code] */
#define FRUSTUM_CLAMP 1.3    /* half fields of view; centres further out have the Jacobian of this edge [K*] */
#define ALPHA_MIN     (1.0 / 255) /* fainter contributions are skipped [K app. C] */
#define ALPHA_MAX     0.99        /* no splat hides all that is behind it [K app. C] */
#define T_MIN         1e-4        /* a pixel ends before its transmittance falls below this [K app. C] */
#define T_MAX         16          /* negative alpha makes the transmittance grow; from this T on it is skipped */

/* 64 numbers, raw as in a PLY file. Gradients and Adam's moments have the same shape, and so the same type. */
struct gaussian {
    double mean[3];      /* centre, world units */
    double log_scale[3]; /* log of the standard deviation s along each axis of its own */
    double rotation[4];  /* quaternion w x y z of any length but 0 */
    double logit;        /* opacity o = sigmoid(logit) */
    double sh[48];       /* spherical harmonics: coefficient k of channel c at 3 k + c */
    double lobe[4];      /* second lobe: o' = o sigmoid(lobe[0]), s'_a = s_a exp(lobe[1 + a]) */
    double lobed;        /* 1: it has one. The gradient is 0, so no step moves this */
};

struct model {
    int count, degree;    /* Gaussians; degree of the harmonics, 0..3: (degree + 1)^2 coefficients are used */
    double background[3]; /* RGB */
    struct gaussian *row;
};

struct camera {                                   /* +x right, +y down, +z forward; the top-left pixel's centre is (0.5, 0.5) */
    int size[2];                                  /* px: width, height */
    double focal[2], centre[2];                   /* px */
    double rotation[3][3], origin[3], near_plane; /* rotation (x - origin): world to camera; only what is further is rendered */
    int mip;                                      /* 1: anti-aliased: the low pass does not add to the light of a splat */
};

double sigmoid(double x) { return 1 / (1 + exp(-x)); }

double dot(const double *a, const double *b, int n) {
    double sum = 0;
    for (int i = 0; i < n; i++) sum += a[i] * b[i];
    return sum;
}

/* Backward of n = v / |v|: adds (dn - (dn . n) n) / |v| to dv; the part of dn along n has no effect. */
void unit_backward(const double *n, double length, const double *dn, double *dv, int size) {
    for (int i = 0; i < size; i++) dv[i] += (dn[i] - dot(dn, n, size) * n[i]) / length;
}

/* ---------------------------------------------------------------- projection: what the camera sees of a Gaussian */

struct splat {                 /* in a gradient: dL/d(centre, colour, opacity, conic) */
    int row, lobes;            /* row of the model; 1, or 2: alpha is lobe 0's minus lobe 1's. [k]: of lobe k */
    double centre[2], half[2]; /* px; half the sides of the box outside of which |alpha| < ALPHA_MIN, px */
    double colour[3];          /* RGB */
    double opacity[2];         /* [k] */
    double conic[2][3];        /* [k]: xx, xy, yy of K, the inverse of the covariance V, 1/px^2 */
    double p[3];               /* from here on, what backward needs: the centre in the camera's frame, world units */
    double d[3], distance;     /* unit vector from the camera to the centre, world axes; their distance */
    double past[2];            /* how far the slopes p_x/p_z, p_y/p_z are beyond the clamp */
    double Y[16], dY[16][3];   /* harmonics at d and their derivatives */
    double n[4];               /* unit quaternion */
    double D[4][9], Q[9];      /* half of dQ/dn; the rotation Q, row by row */
    double JW[2][3];           /* Jacobian times camera rotation, px per world unit */
    double scale[2][3];        /* [k]: s, world units */
    double B[2][2][3];         /* [k]: J W Q S, px: its rows are b0, b1 */
    double cross[2][3];        /* [k], if anti-aliased: b0 x b1, px^2; 0 where the fading is at its least */
};

#define SH(k, factor, f, fx, fy, fz) \
    (Y[k] = (factor) * (f), dY[k][0] = (factor) * (fx), dY[k][1] = (factor) * (fy), dY[k][2] = (factor) * (fz))

/* Spherical harmonics at the unit vector d and their derivatives in x, y, z. Signs as in [K*]. */
void sh_basis(const double d[3], double Y[16], double dY[16][3]) {
    const double x = d[0], y = d[1], z = d[2], xx = x * x, yy = y * y, zz = z * z;
    SH(0, sqrt(1 / (4 * PI)), 1, 0, 0, 0);
    SH(1, -sqrt(3 / (4 * PI)), y, 0, 1, 0);
    SH(2, sqrt(3 / (4 * PI)), z, 0, 0, 1);
    SH(3, -sqrt(3 / (4 * PI)), x, 1, 0, 0);
    SH(4, sqrt(15 / (4 * PI)), x * y, y, x, 0);
    SH(5, -sqrt(15 / (4 * PI)), y * z, 0, z, y);
    SH(6, sqrt(5 / (16 * PI)), 2 * zz - xx - yy, -2 * x, -2 * y, 4 * z);
    SH(7, -sqrt(15 / (4 * PI)), x * z, z, 0, x);
    SH(8, sqrt(15 / (16 * PI)), xx - yy, 2 * x, -2 * y, 0);
    SH(9, -sqrt(35 / (32 * PI)), y * (3 * xx - yy), 6 * x * y, 3 * (xx - yy), 0);
    SH(10, sqrt(105 / (4 * PI)), x * y * z, y * z, x * z, x * y);
    SH(11, -sqrt(21 / (32 * PI)), y * (4 * zz - xx - yy), -2 * x * y, 4 * zz - xx - 3 * yy, 8 * y * z);
    SH(12, sqrt(7 / (16 * PI)), z * (2 * zz - 3 * xx - 3 * yy), -6 * x * z, -6 * y * z, 6 * zz - 3 * xx - 3 * yy);
    SH(13, -sqrt(21 / (32 * PI)), x * (4 * zz - xx - yy), 4 * zz - 3 * xx - yy, -2 * x * y, 8 * x * z);
    SH(14, sqrt(105 / (16 * PI)), z * (xx - yy), 2 * x * z, -2 * y * z, xx - yy);
    SH(15, -sqrt(35 / (32 * PI)), x * (xx - 3 * yy), 3 * (xx - yy), -6 * x * y, 0);
}

/* colour = max(0, 1/2 + sum_k Y_k(d) sh_k), d the direction of view */
void colour_forward(const double sh[48], int degree, struct splat *s) {
    sh_basis(s->d, s->Y, s->dY);
    for (int c = 0; c < 3; c++) s->colour[c] = 0.5;
    for (int k = 0; k < (degree + 1) * (degree + 1); k++)
        for (int c = 0; c < 3; c++) s->colour[c] += s->Y[k] * sh[3 * k + c];
    for (int c = 0; c < 3; c++) s->colour[c] = fmax(0, s->colour[c]);
}

void colour_backward(const double sh[48], int degree, const struct splat *s, const struct splat *ds, double *dsh, double *dd) {
    for (int k = 0; k < (degree + 1) * (degree + 1); k++)
        for (int c = 0; c < 3; c++) {
            const double dcolour = s->colour[c] > 0 ? ds->colour[c] : 0;
            dsh[3 * k + c] += dcolour * s->Y[k];
            for (int a = 0; a < 3; a++) dd[a] += dcolour * sh[3 * k + c] * s->dY[k][a];
        }
}

/* The covariance is Q S (Q S)^T, Q the Gaussian's rotation, S = diag(s) [K eq. 6]. Near its centre p perspective is nearly linear,
 * with the Jacobian J [Z]. So on the image the covariance is V = B B^T + LOW_PASS I, B = J W Q S [K eq. 5], W the camera's rotation. */
void ellipse_forward(struct splat *s, int k, int mip) {
    const double *b0 = s->B[k][0], *b1 = s->B[k][1], low = mip ? MIP_LOW_PASS : LOW_PASS;
    const double xx = dot(b0, b0, 3) + low, xy = dot(b0, b1, 3), yy = dot(b1, b1, 3) + low;
    const double cross[3] = {b0[1] * b1[2] - b0[2] * b1[1], b0[2] * b1[0] - b0[0] * b1[2], b0[0] * b1[1] - b0[1] * b1[0]};
    const double bare = dot(cross, cross, 3);
    const double det = bare + low * (xx + yy - low);            /* xx yy - xy^2, but a needle keeps all digits */
    if (mip) s->opacity[k] *= sqrt(fmax(FADE_MIN, bare / det)); /* keeps its sum over the pixels [Y eq. 9] */
    if (mip && bare > FADE_MIN * det) memcpy(s->cross[k], cross, sizeof cross);
    const double reach = 2 * log(fmax(1, s->opacity[k] / ALPHA_MIN)); /* (standard deviations)^2 to o G = ALPHA_MIN */
    s->conic[k][0] = yy / det, s->conic[k][1] = -xy / det, s->conic[k][2] = xx / det;
    s->half[0] = fmax(s->half[0], sqrt(reach * xx)), s->half[1] = fmax(s->half[1], sqrt(reach * yy));
}

/* K = V^-1 has dV = -K dK K, and V = B B^T + LOW_PASS I has dB = 2 dV B. With U = K B, dB is -2 K dK U. Column j of B is proportional
 * to s_j, so s_j dL/ds_j = B_j . dB_j = -2 U_j . dK U_j. In this order the digits of a needle survive. Fading multiplies o by
 * |b0 x b1| / sqrt(det V): with v = b0 x b1 that adds (b1 x v, v x b0) / v^2 - U, times dlog o, to the rows of dB. */
void ellipse_backward(const struct splat *s, int k, const double dK[3], double dlog_o, double dB[2][3], double dlog_scale[3]) {
    const double *K = s->conic[k], *v = s->cross[k], *b0 = s->B[k][0], *b1 = s->B[k][1], vv = dot(v, v, 3);
    for (int j = 0; j < 3; j++) {
        const double U0 = K[0] * b0[j] + K[1] * b1[j], U1 = K[1] * b0[j] + K[2] * b1[j];
        const double F0 = -2 * dK[0] * U0 - dK[1] * U1, F1 = -dK[1] * U0 - 2 * dK[2] * U1; /* -2 dK U_j; dK[1] is of both xy */
        dB[0][j] = K[0] * F0 + K[1] * F1, dB[1][j] = K[1] * F0 + K[2] * F1;
        dlog_scale[j] = U0 * F0 + U1 * F1;
        if (vv > 0) {
            const int x = (j + 1) % 3, y = (j + 2) % 3;
            const double f0 = dlog_o * ((b1[x] * v[y] - b1[y] * v[x]) / vv - U0);
            const double f1 = dlog_o * ((v[x] * b0[y] - v[y] * b0[x]) / vv - U1);
            dB[0][j] += f0, dB[1][j] += f1, dlog_scale[j] += b0[j] * f0 + b1[j] * f1;
        }
    }
}

/* Q is quadratic in the unit quaternion n = (w, x, y, z): Q = sum_k n_k D_k, and dQ/dn_k = 2 D_k. */
void rotation_forward(const double q[4], double n[4], double D[4][9], double Q[9]) {
    const double l = sqrt(dot(q, q, 4)), w = q[0] / l, x = q[1] / l, y = q[2] / l, z = q[3] / l, unit[4] = {w, x, y, z};
    const double parts[4][9] = {{w, -z, y, z, w, -x, -y, x, w},
                                {x, y, z, y, -x, -w, z, w, -x},
                                {-y, x, w, x, y, z, -w, z, -y},
                                {-z, -w, x, w, -z, y, x, y, z}};
    memcpy(n, unit, sizeof unit), memcpy(D, parts, sizeof parts);
    for (int i = 0; i < 9; i++) Q[i] = w * D[0][i] + x * D[1][i] + y * D[2][i] + z * D[3][i];
}

/* s is zero but for its row. Returns 0 for a Gaussian that is not in view. */
int project_forward(const struct gaussian *g, int degree, const struct camera *cam, struct splat *s) {
    const double v[3] = {g->mean[0] - cam->origin[0], g->mean[1] - cam->origin[1], g->mean[2] - cam->origin[2]};
    s->distance = sqrt(dot(v, v, 3)), s->lobes = g->lobed > 0 ? 2 : 1;
    for (int a = 0; a < 3; a++) s->p[a] = dot(cam->rotation[a], v, 3), s->d[a] = v[a] / s->distance;
    if (s->p[2] <= cam->near_plane) return 0;
    colour_forward(g->sh, degree, s);
    rotation_forward(g->rotation, s->n, s->D, s->Q);
    for (int a = 0; a < 2; a++) { /* row a of J is f/p_z at a and -f/p_z slope at z */
        const double f = cam->focal[a], slope = s->p[a] / s->p[2], most = FRUSTUM_CLAMP * cam->size[a] / (2 * f);
        s->centre[a] = f * slope + cam->centre[a], s->past[a] = slope - fmax(-most, fmin(most, slope));
        for (int i = 0; i < 3; i++)
            s->JW[a][i] = f / s->p[2] * (cam->rotation[a][i] - (slope - s->past[a]) * cam->rotation[2][i]);
    }
    for (int k = 0; k < s->lobes; k++) {
        for (int j = 0; j < 3; j++) s->scale[k][j] = exp(g->log_scale[j] + k * g->lobe[1 + j]);
        for (int a = 0; a < 2; a++)
            for (int i = 0; i < 3; i++)
                for (int j = 0; j < 3; j++) s->B[k][a][j] += s->JW[a][i] * s->Q[3 * i + j] * s->scale[k][j];
        s->opacity[k] = sigmoid(g->logit) * (k ? sigmoid(g->lobe[0]) : 1);
        ellipse_forward(s, k, cam->mip);
    }
    for (int a = 0; a < 2; a++) /* the box ends before the first pixel centre, or begins behind the last */
        if (s->half[a] <= fmax(0, fabs(s->centre[a] - cam->size[a] / 2.0) - (cam->size[a] - 1) / 2.0)) return 0;
    return 1;
}

void project_backward(const struct gaussian *g, int degree, const struct camera *cam, const struct splat *s,
                      const struct splat *ds, struct gaussian *dg) {
    double dd[3] = {0}, dQ[9] = {0}, dn[4], dJW[2][3] = {{0}}, dp[3] = {0}, dB[2][3], dlog_scale[3];
    colour_backward(g->sh, degree, s, ds, dg->sh, dd);
    unit_backward(s->d, s->distance, dd, dg->mean, 3);
    for (int k = 0; k < s->lobes; k++) { /* o' = o sigmoid(a), s' = s exp(b): dlog o' adds to dlog o, dlog s' to dlog s */
        const double dlog_opacity = ds->opacity[k] * s->opacity[k];
        dg->logit += dlog_opacity * sigmoid(-g->logit), dg->lobe[0] += k * dlog_opacity * sigmoid(-g->lobe[0]);
        ellipse_backward(s, k, ds->conic[k], dlog_opacity, dB, dlog_scale);
        for (int j = 0; j < 3; j++) dg->log_scale[j] += dlog_scale[j], dg->lobe[1 + j] += k * dlog_scale[j];
        for (int a = 0; a < 2; a++) /* B_aj = sum_i JW_ai Q_ij s_j */
            for (int i = 0; i < 3; i++)
                for (int j = 0; j < 3; j++) {
                    dJW[a][i] += dB[a][j] * s->Q[3 * i + j] * s->scale[k][j];
                    dQ[3 * i + j] += dB[a][j] * s->JW[a][i] * s->scale[k][j];
                }
    }
    for (int k = 0; k < 4; k++) dn[k] = 2 * dot(s->D[k], dQ, 9);
    unit_backward(s->n, sqrt(dot(g->rotation, g->rotation, 4)), dn, dg->rotation, 4);
    for (int a = 0; a < 2; a++) { /* the slope moves the centre, and JW unless it is clamped; JW is proportional to 1/p_z, too */
        const double dslope = ds->centre[a] - (s->past[a] != 0 ? 0 : dot(dJW[a], cam->rotation[2], 3) / s->p[2]);
        dp[a] += cam->focal[a] * dslope / s->p[2];
        dp[2] -= (cam->focal[a] * dslope * s->p[a] / s->p[2] + dot(dJW[a], s->JW[a], 3)) / s->p[2];
    }
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) dg->mean[j] += cam->rotation[i][j] * dp[i];
}

/* ---------------------------------------------------------------- compositing: C = sum_i c_i alpha_i T_i [K eq. 3] */

/* alpha = min(.99, o G) - min(.99, o' G') [O eq. 3] at the pixel (x, y) with the transmittance T, or 0; writes G (2) [K eq. 4]. */
double alpha_forward(const struct splat *s, double x, double y, double T, double G[2]) {
    const double rx = x - s->centre[0], ry = y - s->centre[1];
    if (fabs(rx) > s->half[0] || fabs(ry) > s->half[1]) return 0;
    for (int k = 0; k < 2; k++) /* without a second lobe o' is 0 */
        G[k] = exp(-(s->conic[k][0] * rx * rx + 2 * s->conic[k][1] * rx * ry + s->conic[k][2] * ry * ry) / 2);
    const double alpha = fmin(ALPHA_MAX, s->opacity[0] * G[0]) - fmin(ALPHA_MAX, s->opacity[1] * G[1]);
    return fabs(alpha) < ALPHA_MIN || (alpha < 0 && T >= T_MAX) ? 0 : alpha;
}

void alpha_backward(const struct splat *s, double x, double y, const double G[2], double dalpha, struct splat *ds) {
    const double rx = x - s->centre[0], ry = y - s->centre[1];
    for (int k = 0; k < s->lobes; k++) {
        const double *K = s->conic[k], dG = s->opacity[k] * G[k] < ALPHA_MAX ? (k ? -dalpha : dalpha) * G[k] : 0;
        const double de = s->opacity[k] * dG; /* e: the exponent of G */
        ds->opacity[k] += dG;
        ds->centre[0] += de * (K[0] * rx + K[1] * ry), ds->centre[1] += de * (K[1] * rx + K[2] * ry);
        ds->conic[k][0] -= de * rx * rx / 2, ds->conic[k][1] -= de * rx * ry, ds->conic[k][2] -= de * ry * ry / 2;
    }
}

/* One pixel; s lies in depth order. T_i is the product of 1 - alpha before i; returns that behind the last. */
double composite_forward(const struct splat *s, int count, const double background[3], double x, double y, double rgb[3]) {
    double T = 1, G[2];
    for (int c = 0; c < 3; c++) rgb[c] = 0;
    for (int i = 0; i < count; i++) {
        const double alpha = alpha_forward(&s[i], x, y, T, G);
        if (T * (1 - alpha) < T_MIN) break;
        for (int c = 0; c < 3; c++) rgb[c] += s[i].colour[c] * alpha * T;
        T *= 1 - alpha;
    }
    for (int c = 0; c < 3; c++) rgb[c] += T * background[c];
    return T;
}

/* Splat i adds c_i alpha_i T_i and dims what is behind it by 1 - alpha_i: dalpha_i = T_i (dC . c_i) - behind / (1 - alpha_i), behind
 * being the part of dC . C from behind splat i. C is known from the forward pass, so this sum runs front to back as well. */
void composite_backward(const struct splat *s, int count, double x, double y, const double rgb[3], const double drgb[3],
                        struct splat *ds) {
    double T = 1, G[2], behind = dot(drgb, rgb, 3);
    for (int i = 0; i < count; i++) {
        const double alpha = alpha_forward(&s[i], x, y, T, G), light = dot(drgb, s[i].colour, 3);
        if (T * (1 - alpha) < T_MIN) break;
        if (alpha == 0) continue;
        behind -= light * alpha * T;
        for (int c = 0; c < 3; c++) ds[i].colour[c] += drgb[c] * alpha * T;
        alpha_backward(&s[i], x, y, G, T * light - behind / (1 - alpha), &ds[i]);
        T *= 1 - alpha;
    }
}

/* s (m->count): the splats in view, sorted by depth (insertion sort), ties by row; rgb (H,W,3). Returns how many are in view. */
int render_forward(const struct model *m, const struct camera *cam, struct splat *s, double *rgb) {
    const int w = cam->size[0], h = cam->size[1];
    int count = 0;
    for (int i = 0, at; i < m->count; i++) {
        struct splat new = {.row = i};
        if (!project_forward(&m->row[i], m->degree, cam, &new)) continue;
        for (at = count++; at > 0 && s[at - 1].p[2] > new.p[2]; at--) s[at] = s[at - 1];
        s[at] = new;
    }
    for (int i = 0; i < w * h; i++) composite_forward(s, count, m->background, i % w + 0.5, i / w + 0.5, rgb + 3 * i);
    return count;
}

/* ds (count) and dg (m->count) are added to. */
void render_backward(const struct model *m, const struct camera *cam, const struct splat *s, int count, const double *rgb,
                     const double *drgb, struct splat *ds, struct gaussian *dg) {
    const int w = cam->size[0], h = cam->size[1];
    for (int i = 0; i < w * h; i++) composite_backward(s, count, i % w + 0.5, i / w + 0.5, rgb + 3 * i, drgb + 3 * i, ds);
    for (int i = 0; i < count; i++) project_backward(&m->row[s[i].row], m->degree, cam, &s[i], &ds[i], &dg[s[i].row]);
}

/* ---------------------------------------------------------------- loss: L = (1 - w) mean |x - y| + w (1 - mean SSIM) [K eq. 7] */

/* Blurs the rows of in (H,W) by a Gaussian window of 11 px, 0 outside; out (W,H) is transposed, so twice makes a window of 11 x 11 px.
 * The window is symmetric: the blur is its own backward. */
void blur(const double *in, int w, int h, double *out) {
    double window[11], sum = 0;
    for (int k = 0; k < 11; k++) sum += window[k] = exp(-(k - 5) * (k - 5) / (2 * 1.5 * 1.5)); /* [W] */
    memset(out, 0, w * h * sizeof *out);
    for (int i = 0; i < 11 * w * h; i++) {
        const int x = i / 11 % w, y = i / 11 / w, from = x + i % 11 - 5;
        if (from >= 0 && from < w) out[x * h + y] += window[i % 11] / sum * in[y * w + from];
    }
}

/* The sum of SSIM over the pixels of a channel, x[3 i] against y[3 i] [W eq. 13]; scale times dSSIM/dx is added to dx. */
double ssim(const double *x, const double *y, int w, int h, double scale, double *dx) {
    const double C1 = 0.01 * 0.01, C2 = 0.03 * 0.03; /* [W] */
    const int n = w * h;
    double *mx = calloc(5 * n, sizeof *mx), *m = mx + n, *p = m + n, *my = p + n, sum = 0; /* means of x, x^2 + y^2, x y, y */
    for (int i = 0; i < n; i++) mx[i] = x[3 * i], my[i] = y[3 * i], m[i] = mx[i] * mx[i] + my[i] * my[i], p[i] = mx[i] * my[i];
    for (int k = 0; k < 4; k++) blur(mx + k * n, w, h, my + n), blur(my + n, h, w, mx + k * n);
    for (int i = 0; i < n; i++) {
        const double u = mx[i], v = my[i], a1 = 2 * u * v + C1, a2 = 2 * (p[i] - u * v) + C2;
        const double b1 = u * u + v * v + C1, b2 = m[i] - u * u - v * v + C2, S = a1 * a2 / (b1 * b2);
        mx[i] = 2 * v * (a2 - a1) / (b1 * b2) + 2 * u * S * (1 / b2 - 1 / b1); /* from here on dS/d(mx), dS/dm, dS/dp */
        m[i] = -S / b2, p[i] = 2 * a1 / (b1 * b2);
        sum += S;
    }
    for (int k = 0; k < 3; k++) blur(mx + k * n, w, h, my + n), blur(my + n, h, w, mx + k * n);
    for (int i = 0; i < n; i++) dx[3 * i] += scale * (mx[i] + 2 * x[3 * i] * m[i] + y[3 * i] * p[i]);
    free(mx);
    return sum;
}

/* x: the rendering, y: the image (H,W,3); dx is overwritten. */
double loss(const double *x, const double *y, int w, int h, double weight, double *dx) {
    const int n = 3 * w * h;
    double sum = weight * n, rest = 1 - weight;
    for (int i = 0; i < n; i++) sum += rest * fabs(x[i] - y[i]), dx[i] = rest / n * ((x[i] > y[i]) - (x[i] < y[i]));
    for (int c = 0; c < 3; c++) sum -= weight * ssim(x + c, y + c, w, h, -weight / n, dx + c);
    return sum / n;
}

/* ---------------------------------------------------------------- training [K Alg. 1] */

enum { LOG_SCALE = 3, ROTATION = 6, LOGIT = 10, SH_0 = 11, SH_REST = 14, LOBE = 59, PARAMETERS = 64 }; /* in a struct gaussian */
/* The rate of number k of a Gaussian [K*]; the mean's is in extents of the scene and falls to a hundredth over the run. */
double learning_rate(int k, double extent, double progress) {
    if (k < LOG_SCALE) return 1.6e-4 * extent * pow(0.01, progress);
    if (k < SH_0) return k < ROTATION ? 0.005 : k < LOGIT ? 0.001 : 0.025;
    return k < SH_REST ? 0.0025 : k < LOBE ? 0.0025 / 20 : k == LOBE ? 0.025 : 0.005; /* the last two: of o', of s' */
}

/* [A, Alg. 1]: m and v are running means of the gradient and of its square; the divisions correct for their start at 0. */
void adam(double *x, double g, double rate, int step, double *m, double *v) {
    const double beta1 = 0.9, beta2 = 0.999, epsilon = 1e-15; /* [A], [K*] */
    *m = beta1 * *m + (1 - beta1) * g;
    *v = beta2 * *v + (1 - beta2) * g * g;
    *x -= rate * *m / (1 - pow(beta1, step)) / (sqrt(*v / (1 - pow(beta2, step))) + epsilon);
}

enum verdict { REMOVE, KEEP, SPLIT };
/* Density control: the verdict on a Gaussian [K sec. 5.2]. gradient: mean over the views of |dL/d(centre)|, centre in half images. */
enum verdict classify(const struct gaussian *g, double gradient, double extent, int was_reset) {
    const double scale = exp(fmax(g->log_scale[0], fmax(g->log_scale[1], g->log_scale[2]))) / extent;
    if (sigmoid(g->logit) < 0.005) return REMOVE; /* [K*] */
    if (was_reset && scale > 0.1) return SPLIT;   /* [K*] removes it */
    return gradient < 2e-4 ? KEEP : SPLIT;        /* [K] clones small ones */
}

/* g becomes one of the two that replace it, on its longest axis before or behind its mean (side -1 or 1): mean, covariance and, to first
 * order in the opacity, the sum of alpha are kept. */
void split(struct gaussian *g, int side) {
    double n[4], D[4][9], Q[9];
    const double *s = g->log_scale, length = exp(fmax(s[0], fmax(s[1], s[2])));
    const int j = s[0] >= s[1] && s[0] >= s[2] ? 0 : s[1] >= s[2] ? 1 : 2;
    rotation_forward(g->rotation, n, D, Q);
    for (int i = 0; i < 3; i++) g->mean[i] += side * sqrt(0.5) * length * Q[3 * i + j];
    g->log_scale[j] += log(sqrt(0.5));
    g->logit = log(pow(1 - sigmoid(g->logit), -sqrt(0.5)) - 1); /* o' = 1 - (1 - o)^sqrt(1/2) */
}

enum { MOST = 300, PIXELS = 48 * 36 };
struct trainer {
    struct model model;                                 /* of x */
    struct gaussian x[MOST], m[MOST], v[MOST], d[MOST]; /* parameters, Adam's moments, gradient */
    struct splat s[MOST], ds[MOST];
    double rgb[3 * PIXELS], drgb[3 * PIXELS], extent; /* of the scene, world units */
    double gradient_sum[MOST], views[MOST];           /* since the last densification: of |dL/d(centre)|, number of views */
};

/* Takes an Adam step for the Gaussians in view of a camera. Returns the loss. */
double train_step(struct trainer *t, const struct camera *cam, const double *truth, int step, double progress) {
    const int w = cam->size[0], h = cam->size[1], count = render_forward(&t->model, cam, t->s, t->rgb);
    const double value = loss(t->rgb, truth, w, h, 0.2, t->drgb); /* [K] */
    memset(t->ds, 0, sizeof t->ds), memset(t->d, 0, sizeof t->d);
    render_backward(&t->model, cam, t->s, count, t->rgb, t->drgb, t->ds, t->d);
    for (int i = 0; i < count; i++) {
        const int row = t->s[i].row;
        double *x = (double *)&t->x[row], *m = (double *)&t->m[row], *v = (double *)&t->v[row], *d = (double *)&t->d[row];
        for (int k = 0; k < PARAMETERS; k++) adam(x + k, d[k], learning_rate(k, t->extent, progress), step, m + k, v + k);
        t->views[row]++;
        t->gradient_sum[row] += hypot(t->ds[i].centre[0] * w / 2, t->ds[i].centre[1] * h / 2);
    }
    return value;
}

void densify(struct trainer *t, int was_reset) {
    for (int i = t->model.count - 1; i >= 0; i--) {
        const enum verdict verdict = classify(&t->x[i], t->gradient_sum[i] / fmax(1, t->views[i]), t->extent, was_reset);
        if (verdict == REMOVE) { /* the last row takes its place */
            const int last = --t->model.count;
            t->x[i] = t->x[last], t->m[i] = t->m[last], t->v[i] = t->v[last];
        } else if (verdict == SPLIT && t->model.count < MOST) {
            const int n = t->model.count++;
            t->x[n] = t->x[i];
            t->m[i] = t->v[i] = t->m[n] = t->v[n] = (struct gaussian){.lobed = 0}; /* Adam begins anew */
            split(&t->x[i], -1), split(&t->x[n], 1);
        }
    }
    memset(t->gradient_sum, 0, sizeof t->gradient_sum), memset(t->views, 0, sizeof t->views);
}

#ifndef SPLAT_NO_MAIN
#include "scene.h" /* its sizes, Gaussians and cameras; write_bmp, write_ply, read_images, write_images */
/* a.out [IMAGES]: trains with the splat.truth IMAGES, not with its own. The numbers suit this scene; src/train/schedule.c has others. */
int main(int argc, char **argv) {
    enum { STEPS = 600, RESET = STEPS / 4, DENSIFY_UNTIL = STEPS / 2, ADD_LOBES = STEPS * 3 / 4 };
    static struct trainer t = {{SCENE_GAUSSIANS, 0, {0.05, 0.25, 0.35}, t.x}, .extent = 3.5};
    static double truth[SCENE_VIEWS][3 * PIXELS];
    struct camera cam[SCENE_VIEWS];
    double mean = 0, square = 0;
    for (int i = 0; i < SCENE_GAUSSIANS; i++) memcpy(&t.x[i], SCENE_GAUSSIAN[i], sizeof *SCENE_GAUSSIAN);
    for (int i = 0; i < SCENE_VIEWS; i++) cam[i] = scene_camera(i), render_forward(&t.model, &cam[i], t.s, truth[i]);
    if (argc > 1 && read_images(argv[1], truth[0], sizeof truth)) return 1;
    for (int i = 0; i < SCENE_GAUSSIANS; i++) { /* starts from rough positions; o = 0.1, o' = 0.1 o, s' = exp(0.5) s */
        struct gaussian start = {.log_scale = {-2, -2, -2}, .rotation = {1}, .logit = -2.2, .lobe = {-2.2, 0.5, 0.5, 0.5}};
        for (int a = 0; a < 3; a++) start.mean[a] = rint(4 * t.x[i].mean[a]) / 4;
        t.x[i] = start;
    }
    for (int step = 1; step <= STEPS; step++) {
        const int v = 1 + (step - 1) % (SCENE_VIEWS - 1); /* view 0 is held out */
        mean += train_step(&t, &cam[v], truth[v], step, (double)step / STEPS) / 50;
        if (step % 50) continue;
        printf("step %4d  loss %.4f  %d Gaussians\n", step, mean, t.model.count);
        mean = 0, t.model.degree = 4 * step / (STEPS + 1);
        if (step <= DENSIFY_UNTIL) densify(&t, step > RESET);
        for (int i = 0; i < t.model.count; i++) {
            if (step == RESET) t.x[i].logit = fmin(t.x[i].logit, -4.6), t.m[i].logit = t.v[i].logit = 0; /* o = .01 [K*] */
            if (step == ADD_LOBES) t.x[i].lobed = t.gradient_sum[i] > 2e-4 * t.views[i];                 /* [O eq. 4] */
        }
    }
    render_forward(&t.model, &cam[0], t.s, t.rgb);
    for (int i = 0; i < 3 * PIXELS; i++) square += pow(t.rgb[i] - truth[0][i], 2) / (3 * PIXELS);
    printf("view that was held out: %.2f dB\n", -10 * log10(square));
    return write_bmp("splat.bmp", truth[0], t.rgb) || write_ply("splat.ply", &t.model) ||
           write_images("splat.truth", truth[0], sizeof truth);
}
#endif
