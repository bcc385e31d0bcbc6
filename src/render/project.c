/* project.c - projects Gaussians onto the image plane, and their gradients back.
 *
 * Zwicker et al. 2001 (EWA splatting) as used by Kerbl et al. 2023: with p = R mu + t in the camera, J the
 * Jacobian of the perspective map at p, and Sigma = M M^T, M = rot(q) diag(exp s), the splat's covariance is
 * (J R) Sigma (J R)^T + 0.3 I.
 *
 * Rows are processed in packs of PACK lanes; the code of a lane is scalar C without branches, which the
 * compiler vectorises. Forward and backward both compute project_geometry: nothing is stored between them.
 *
 * Rows 0..lobes-1 have a second lobe [OceanXL eq. 3-4] of opacity o' = o sigmoid(a) and scales s' = s exp(b);
 * packs with such rows run a second loop over lanes.
 *
 * Invariant: the backward pass is the exact gradient of the forward pass, clamps included: where a clamp
 * holds, its gradient is 0.
 */
#include "colour.h"
#include "medium.h"
#include "pose.h"

/* ---------------- one lane: geometry */

struct project_geometry {
    struct vec3 p;           /* mean in the camera */
    struct vec3 scale;       /* exp of the log scale */
    struct mat3 rotation;    /* of the unit quaternion */
    real q[4], inverse_norm; /* unit quaternion, 1 / its length before */
    real tx, ty;             /* p.x, p.y clamped to the widened frustum */
    int free_x, free_y;      /* 1 where that clamp does not hold */
    struct vec3 t0, t1;      /* rows of J R */
    struct vec3 b0, b1;      /* rows of J R M: the covariance's square root */
    struct vec3 c0;          /* b0 + k b1, the component of b0 orthogonal to b1: see project_lane_backward */
    real shrink2;            /* scale of the covariance below, against float overflow close to the camera */
    real xx, xy, yy;         /* covariance x shrink2, low pass included */
    real det;                /* its determinant */
    struct vec3 s0, s1, m; /* shrunk b0, b1, their cross product: |m|^2 is the determinant without low pass */
};

#define PROJECT_BOX_FACTOR ((real)1.0001) /* on the half box: rounding must not make it too small */
#define PROJECT_BOX_MARGIN ((real)0.001)  /* px: added to it */
/* px or 1/px^2: larger has overflowed, or soon does; such a splat is not drawn */
#define PROJECT_HUGE ((real)1e30)
/* shorter ones count as the identity: the inverse would overflow in float */
#define QUATERNION_MIN ((real)1.2e-38)

/* Quaternions need not be normalised. Dividing by the largest component first avoids overflow and underflow
 * of squares. */
SIMD_INLINE void project_rotation(real w, real x, real y, real z, struct project_geometry *g)
{
    const real mw = real_abs(w), mx = real_abs(x), my = real_abs(y), mz = real_abs(z);
    const real mwx = mw > mx ? mw : mx, myz = my > mz ? my : mz, most = mwx > myz ? mwx : myz;
    const int is_valid = most > QUATERNION_MIN;
    const real inverse_most = is_valid ? 1 / most : 0;
    const real sw = is_valid ? w * inverse_most : 1, sx = x * inverse_most, sy = y * inverse_most,
               sz = z * inverse_most;
    const real n = 1 / real_sqrt(sw * sw + sx * sx + sy * sy + sz * sz);
    const real a = sw * n, b = sx * n, c = sy * n, d = sz * n;
    g->q[0] = a;
    g->q[1] = b;
    g->q[2] = c;
    g->q[3] = d;
    g->inverse_norm = inverse_most * n;
    g->rotation.x = vec3(1 - 2 * (c * c + d * d), 2 * (b * c - a * d), 2 * (b * d + a * c));
    g->rotation.y = vec3(2 * (b * c + a * d), 1 - 2 * (b * b + d * d), 2 * (c * d - a * b));
    g->rotation.z = vec3(2 * (b * d - a * c), 2 * (c * d + a * b), 1 - 2 * (b * b + c * c));
}

/* The perspective Jacobian at the clamped position, times R (MATH 2). */
SIMD_INLINE void project_jacobian(const struct kernel_camera *kernel_camera, real z,
                                  struct project_geometry *g)
{
    const real inverse = 1 / z, x = g->p.x * inverse, y = g->p.y * inverse;
    const real cx = OXL_CLAMP(x, -kernel_camera->limit_x, kernel_camera->limit_x),
               cy = OXL_CLAMP(y, -kernel_camera->limit_y, kernel_camera->limit_y);
    g->free_x = x == cx;
    g->free_y = y == cy;
    g->tx = z * cx;
    g->ty = z * cy;
    g->t0 = add3(scale3(kernel_camera->fx * inverse, kernel_camera->rotation.x),
                 scale3(-kernel_camera->fx * cx * inverse, kernel_camera->rotation.z));
    g->t1 = add3(scale3(kernel_camera->fy * inverse, kernel_camera->rotation.y),
                 scale3(-kernel_camera->fy * cy * inverse, kernel_camera->rotation.z));
}

/* MATH 3. Determinant by Cauchy-Binet, a sum of squares: xx yy - xy^2 cancels for a needle. */
SIMD_INLINE void project_covariance(const int antialias, struct project_geometry *g)
{
    const struct vec3 r0 = mat3_transposed_times(g->rotation, g->t0),
                      r1 = mat3_transposed_times(g->rotation, g->t1);
    struct vec3 m, s0, s1;
    real shrink, low;
    g->b0 = multiply3(r0, g->scale);
    g->b1 = multiply3(r1, g->scale);
    shrink = 1 / most3(g->b1, most3(g->b0, 1));
    s0 = scale3(shrink, g->b0);
    s1 = scale3(shrink, g->b1);
    m = cross3(s0, s1);
    g->shrink2 = shrink * shrink;
    low = (antialias ? ANTIALIAS_LOW_PASS : LOW_PASS) * g->shrink2;
    g->xx = dot3(s0, s0);
    g->yy = dot3(s1, s1);
    g->xy = dot3(s0, s1);
    g->det = dot3(m, m) + low * (g->xx + g->yy) + low * low;
    g->s0 = s0, g->s1 = s1, g->m = m;
    g->xx += low;
    g->yy += low;
    /* b0 - b1 (b0 . b1)/yy, without the cancellation */
    g->c0 = scale3(1 / (g->yy * shrink), add3(cross3(s1, m), scale3(low, s0)));
}

/* lobe, a constant: the second lobe's, which differs only in scale. */
SIMD_INLINE struct project_geometry project_geometry(const int fused, const int antialias, const int lobe,
                                                     const struct gaussians *in,
                                                     const struct kernel_camera *kernel_camera, size_t i,
                                                     int *in_front)
{
    struct project_geometry g;
    struct vec3 log_scale = gaussians_vec3(in, OXL_LOG_SCALE, i);
    real z;
    if (lobe) log_scale = add3(log_scale, gaussians_vec3(in, OXL_LOBE + 1, i));
    g.p = add3(mat3_times(kernel_camera->rotation, gaussians_vec3(in, OXL_MEAN, i)),
               kernel_camera->translation);
    *in_front = g.p.z > kernel_camera->near_plane;
    z = *in_front ? g.p.z : 1; /* keeps other lanes finite */
    g.p.z = z;
    g.scale = vec3(real_exp(fused, log_scale.x), real_exp(fused, log_scale.y), real_exp(fused, log_scale.z));
    project_rotation(in->plane[OXL_ROTATION][i], in->plane[OXL_ROTATION + 1][i],
                     in->plane[OXL_ROTATION + 2][i], in->plane[OXL_ROTATION + 3][i], &g);
    project_jacobian(kernel_camera, z, &g);
    project_covariance(antialias, &g);
    return g;
}

/* Returns how many of a pack's rows have a second lobe. */
static int project_lobes(const struct gaussians *in, size_t first)
{
    return first < in->lobes ? (int)OXL_MIN(in->lobes - first, (size_t)PACK) : 0;
}

/* ---------------- one pack: forward */

struct project_lanes {
    real u[PACK], v[PACK], a[PACK], k[PACK], e[PACK], peak[PACK], depth[PACK], half_x[PACK], half_y[PACK];
    int32_t seen[PACK];
};

/* sigmoid without branches: e^-|x| does not overflow. */
SIMD_INLINE real project_sigmoid(const int fused, real x)
{
    const real e = real_exp(fused, -real_abs(x)), s = 1 / (1 + e);
    return x >= 0 ? s : e * s;
}

/* log2 of the factor of the opacity: the root of the determinant's ratio without low pass to with it, so that
 * the splat's integral over the image stays [Yu 2024, eq. 9]. */
SIMD_INLINE real project_fade(const int fused, const struct project_geometry *g)
{
    const real ratio = dot3(g->m, g->m) / g->det;
    return real_log2(fused, ratio > ANTIALIAS_MIN ? ratio : ANTIALIAS_MIN) / 2;
}

struct project_shape {
    real a, k, e, reach; /* reach: squared Mahalanobis radius of the contour, < 0: none */
    real half_x, half_y;
};

/* MATH 4, 5. The half box is slightly enlarged: conservative, the alpha test at each pixel is exact. */
SIMD_INLINE struct project_shape project_shape(const struct project_geometry *g, real peak, real cutoff_bits)
{
    struct project_shape s;
    s.reach = (peak + cutoff_bits) * 2 * LN_2; /* 2 ln(o / alpha_min) */
    const real safe = s.reach > 0 ? s.reach : 0;
    s.half_x = real_sqrt(safe * g->xx / g->shrink2) * PROJECT_BOX_FACTOR + PROJECT_BOX_MARGIN;
    s.half_y = real_sqrt(safe * g->yy / g->shrink2) * PROJECT_BOX_FACTOR + PROJECT_BOX_MARGIN;
    s.a = LOG2_E / 2 * (g->yy / g->det) * g->shrink2;
    s.k = -g->xy / g->yy;
    s.e = LOG2_E / 2 * g->shrink2 / g->yy;
    return s;
}

SIMD_INLINE int project_in_view(const struct kernel_camera *kernel_camera, real u, real v, real half_x,
                                real half_y)
{
    return (u + half_x >= (real)0.5) & (u - half_x <= kernel_camera->width - (real)0.5) &
           (v + half_y >= (real)0.5) & (v - half_y <= kernel_camera->height - (real)0.5) &
           (half_x < PROJECT_HUGE) & (half_y < PROJECT_HUGE);
}

SIMD_INLINE void project_lane(const int fused, const int antialias, const struct project_job *job, size_t i,
                              int l, struct project_lanes *out)
{
    const struct kernel_camera *kernel_camera = job->kernel_camera;
    int in_front;
    const struct project_geometry g =
        project_geometry(fused, antialias, 0, &job->in, kernel_camera, i, &in_front);
    const real opacity = project_sigmoid(fused, job->in.plane[OXL_OPACITY][i]);
    const real peak = real_log2(fused, opacity) + (antialias ? project_fade(fused, &g) : 0);
    const real inverse = 1 / g.p.z;
    const struct project_shape s = project_shape(&g, peak, kernel_camera->cutoff_bits);
    const real u = kernel_camera->fx * g.p.x * inverse + kernel_camera->cx,
               v = kernel_camera->fy * g.p.y * inverse + kernel_camera->cy;
    out->u[l] = u;
    out->v[l] = v;
    out->a[l] = s.a;
    out->k[l] = s.k;
    out->e[l] = s.e;
    out->peak[l] = peak;
    out->depth[l] = g.p.z;
    out->half_x[l] = s.half_x;
    out->half_y[l] = s.half_y;
    out->seen[l] = in_front & project_in_view(kernel_camera, u, v, s.half_x, s.half_y) & (s.reach >= 0) &
                   (s.a < PROJECT_HUGE);
}

struct project_lobe_lanes {
    real a[PACK], k[PACK], e[PACK], peak[PACK], half_x[PACK], half_y[PACK], main_x[PACK], main_y[PACK];
};

/* Adds the second lobe to a lane: its shape, and for lanes below `lobes` the box and visibility of both
 * lobes. */
SIMD_INLINE void project_lobe_lane(const int fused, const int antialias, const struct project_job *job,
                                   size_t i, int l, int lobes, struct project_lanes *lanes,
                                   struct project_lobe_lanes *out)
{
    int in_front;
    const struct project_geometry g =
        project_geometry(fused, antialias, 1, &job->in, job->kernel_camera, i, &in_front);
    const real factor = project_sigmoid(fused, job->in.plane[OXL_LOBE][i]);
    const real main_x = lanes->half_x[l], main_y = lanes->half_y[l], main_peak = lanes->peak[l];
    const real opacity = antialias ? real_log2(fused, project_sigmoid(fused, job->in.plane[OXL_OPACITY][i])) +
                                         project_fade(fused, &g)
                                   : main_peak;
    const real peak = opacity + real_log2(fused, factor);
    const struct project_shape s = project_shape(&g, peak, job->kernel_camera->cutoff_bits);
    const real half_x = s.half_x > main_x ? s.half_x : main_x, half_y = s.half_y > main_y ? s.half_y : main_y;
    const int shown = (s.reach >= 0) | (main_peak + job->kernel_camera->cutoff_bits >= 0);
    const int seen = in_front &
                     project_in_view(job->kernel_camera, lanes->u[l], lanes->v[l], half_x, half_y) & shown &
                     (s.a < PROJECT_HUGE) & (lanes->a[l] < PROJECT_HUGE);
    out->a[l] = s.a;
    out->k[l] = s.k;
    out->e[l] = s.e;
    out->peak[l] = peak;
    out->half_x[l] = s.half_x;
    out->half_y[l] = s.half_y;
    out->main_x[l] = main_x;
    out->main_y[l] = main_y;
    lanes->half_x[l] = l < lobes ? half_x : main_x;
    lanes->half_y[l] = l < lobes ? half_y : main_y;
    lanes->seen[l] = l < lobes ? seen : lanes->seen[l];
}

static void project_store(const struct project_job *job, size_t i, int l, const struct project_lanes *p,
                          const struct project_colour *c)
{
    const struct kernel_camera *kernel_camera = job->kernel_camera;
    struct splat *s = &job->splat[i];
    const real w = kernel_camera->width - 1, h = kernel_camera->height - 1;
    const real x0 = p->u[l] - p->half_x[l], x1 = p->u[l] + p->half_x[l];
    const real y0 = p->v[l] - p->half_y[l], y1 = p->v[l] + p->half_y[l];
    s->u = p->u[l];
    s->v = p->v[l];
    s->a = p->a[l];
    s->k = p->k[l];
    s->e = p->e[l];
    s->peak = p->peak[l];
    s->depth = p->depth[l];
    for (int ch = 0; ch < 3; ch++) s->colour[ch] = c->value[ch][l] > 0 ? c->value[ch][l] : 0;
    s->half_x = p->half_x[l];
    s->half_y = p->half_y[l];
    s->tile_x0 = (uint16_t)((int)OXL_CLAMP(x0, 0, w) / TILE);
    s->tile_x1 = (uint16_t)((int)OXL_CLAMP(x1, 0, w) / TILE);
    s->tile_y0 = (uint16_t)((int)OXL_CLAMP(y0, 0, h) / TILE);
    s->tile_y1 = (uint16_t)((int)OXL_CLAMP(y1, 0, h) / TILE);
    s->first_slot = s->slots = 0;
}

static void project_store_lobe(struct lobe *out, int l, const struct project_lobe_lanes *p)
{
    out->a = p->a[l];
    out->k = p->k[l];
    out->e = p->e[l];
    out->peak = p->peak[l];
    out->half_x = p->half_x[l];
    out->half_y = p->half_y[l];
    out->main_x = p->main_x[l];
    out->main_y = p->main_y[l];
}

/* Prefetches the SH coefficients of the next pack, which lie in one page per plane: 3 at degree 0, 48 at
 * degree 3. */
SIMD_INLINE void project_prefetch(real *const plane[OXL_PLANES], int sh_degree, size_t at)
{
    for (int k = OXL_SH; k < OXL_SH + 3 * (sh_degree + 1) * (sh_degree + 1); k++)
        simd_prefetch(plane[k] + at);
}

SIMD_INLINE void project_pack_forward(const int fused, const int antialias, const struct project_job *job,
                                      size_t first, int lobes, struct project_lanes *lanes,
                                      struct project_lobe_lanes *lobe)
{
#pragma omp simd
    for (int l = 0; l < PACK; l++) project_lane(fused, antialias, job, first + l, l, lanes);
    if (!lobes) return;
#pragma omp simd
    for (int l = 0; l < PACK; l++) project_lobe_lane(fused, antialias, job, first + l, l, lobes, lanes, lobe);
}

SIMD_BODY void project_forward_body(const int fused, const struct project_job *job)
{
    for (size_t pack = job->first_pack; pack < job->end_pack; pack++) {
        const size_t first = pack * PACK;
        struct project_lanes lanes;
        struct project_colour colour;
        unsigned seen = 0;
        const int lobes = project_lobes(&job->in, first);
        struct project_lobe_lanes lobe;
        if (job->kernel_camera->antialias) project_pack_forward(fused, 1, job, first, lobes, &lanes, &lobe);
        else project_pack_forward(fused, 0, job, first, lobes, &lanes, &lobe);
        for (int l = 0; l < PACK; l++)
            if (lanes.seen[l] && first + l < job->in.count) seen |= 1u << l;
        job->visible[pack] = (uint16_t)seen;
        if (!seen) continue;
        if (pack + 1 < job->end_pack) project_prefetch(job->in.plane, job->in.sh_degree, first + PACK);
        project_colour(&job->in, job->kernel_camera, first, &colour);
        if (job->medium) medium_pack_forward(fused, job, pack, colour.value);
        for (int l = 0; l < PACK; l++)
            if (seen >> l & 1) project_store(job, first + l, l, &lanes, &colour);
        for (int l = 0; l < lobes; l++)
            if (seen >> l & 1) project_store_lobe(&job->lobe[first + l], l, &lobe);
    }
}

/* ---------------- one pack: backward */

struct project_gradients {
    real sums[SPLAT_SUMS][PACK]; /* summed over the splat's pairs; 0 if invisible */
    real mean[3][PACK];
    real u[PACK], v[PACK]; /* the centre's */
};

/* Sums a splat's pairs in slot order, which fixes the rounding. */
SIMD_INLINE void project_gather(const struct project_job *job, size_t first, unsigned seen,
                                struct project_gradients *d)
{
    memset(d->sums, 0, sizeof d->sums);
    for (int l = 0; l < PACK; l++) {
        const struct splat *s = &job->splat[first + l];
        real sum[SPLAT_SUMS] = {0};
        if (!(seen >> l & 1)) continue;
        for (uint32_t slot = s->first_slot; slot < s->first_slot + s->slots; slot++)
            for (int k = 0; k < SPLAT_SUMS; k++) sum[k] += job->sums[slot][k];
        for (int k = 0; k < SPLAT_SUMS; k++) d->sums[k][l] = sum[k];
        for (int ch = 0; ch < 3; ch++) /* gradient 0 where the clamp of the colour holds */
            if (!(s->colour[ch] > 0)) d->sums[SUM_RED + ch][l] = 0;
    }
}

/* Does the same for the second lobes, whose sums follow the splat's. */
static void project_gather_lobes(const struct project_job *job, size_t first, unsigned seen, int lobes,
                                 real sums[SPLAT_SUMS][PACK])
{
    memset(sums, 0, SPLAT_SUMS * sizeof *sums);
    for (int l = 0; l < lobes; l++) {
        const struct splat *s = &job->splat[first + l];
        if (!(seen >> l & 1)) continue;
        for (uint32_t slot = s->first_slot + s->slots; slot < s->first_slot + 2 * s->slots; slot++)
            for (int k = 0; k < SUM_RED; k++) sums[k][l] += job->sums[slot][k];
    }
}

/* d(rotation) -> d(raw quaternion), through the normalisation (MATH 14). dr: rows of dL/d(rotation). */
SIMD_INLINE void project_rotation_backward(const struct project_geometry *g, struct mat3 dr, real dq[4])
{
    const real w = g->q[0], x = g->q[1], y = g->q[2], z = g->q[3];
    const real dw = 2 * (x * (dr.z.y - dr.y.z) + y * (dr.x.z - dr.z.x) + z * (dr.y.x - dr.x.y));
    const real dx = 2 * (y * (dr.x.y + dr.y.x) + z * (dr.x.z + dr.z.x) + w * (dr.z.y - dr.y.z)) -
                    4 * x * (dr.y.y + dr.z.z);
    const real dy = 2 * (x * (dr.x.y + dr.y.x) + w * (dr.x.z - dr.z.x) + z * (dr.y.z + dr.z.y)) -
                    4 * y * (dr.x.x + dr.z.z);
    const real dz = 2 * (w * (dr.y.x - dr.x.y) + x * (dr.x.z + dr.z.x) + y * (dr.y.z + dr.z.y)) -
                    4 * z * (dr.x.x + dr.y.y);
    const real along = w * dw + x * dx + y * dy + z * dz;
    dq[0] = (dw - along * w) * g->inverse_norm;
    dq[1] = (dx - along * x) * g->inverse_norm;
    dq[2] = (dy - along * y) * g->inverse_norm;
    dq[3] = (dz - along * z) * g->inverse_norm;
}

/* dL/d(J R) (rows dt0, dt1) and dL/d(u, v) -> dL/d(p), with J = [fx/z, 0, -fx tx/z^2; 0, fy/z, -fy ty/z^2]
 * (MATH 15). */
SIMD_INLINE struct vec3 project_jacobian_backward(const struct kernel_camera *kernel_camera,
                                                  const struct project_geometry *g, struct vec3 dt0,
                                                  struct vec3 dt1, real du, real dv)
{
    const real i = 1 / g->p.z, fx = kernel_camera->fx * i, fy = kernel_camera->fy * i;
    const real d00 = dot3(dt0, kernel_camera->rotation.x), d02 = dot3(dt0, kernel_camera->rotation.z);
    const real d11 = dot3(dt1, kernel_camera->rotation.y), d12 = dot3(dt1, kernel_camera->rotation.z);
    const real rx = g->tx * i, ry = g->ty * i; /* clamped x/z, y/z */
    struct vec3 dp;
    dp.x = fx * du - (g->free_x ? fx * i * d02 : 0);
    dp.y = fy * dv - (g->free_y ? fy * i * d12 : 0);
    dp.z = -fx * i * (g->p.x * du + d00) - fy * i * (g->p.y * dv + d11) +
           fx * i * rx * (g->free_x ? 2 * d02 : d02) + fy * i * ry * (g->free_y ? 2 * d12 : d12);
    return dp;
}

/* Gradients of a splat's geometry. */
struct project_geometry_gradient {
    struct vec3 mean, log_scale;
    real q[4], u, v;
};

/* MATH 11, 13. sums: those of lane l. */
SIMD_INLINE struct project_geometry_gradient project_geometry_gradient(
    const int antialias, const struct kernel_camera *kernel_camera, const struct project_geometry *geometry,
    real sums[SPLAT_SUMS][PACK], int l)
{
    const struct project_geometry g = *geometry;
    struct project_geometry_gradient out;
    /* the pixel's exponent is -(A w^2 + E dy^2)/2 with A = yy/det, k = -xy/yy, E = 1/yy of the unscaled
     * covariance */
    const real A = g.yy / g.det * g.shrink2, k = -g.xy / g.yy, E = g.shrink2 / g.yy;
    const real du = A * sums[SUM_W][l], dv = k * du + E * sums[SUM_Y][l];
    /* dL/d(log opacity) where it is not at its least; log opacity has log|m| - log(det)/2, det = 1/(A E) */
    const real dfade = antialias && dot3(g.m, g.m) > ANTIALIAS_MIN * g.det ? sums[SUM_D][l] : 0;
    const real dA = antialias ? dfade / (2 * A) - sums[SUM_WW][l] / 2 : -sums[SUM_WW][l] / 2;
    const real dE = antialias ? dfade / (2 * E) - sums[SUM_YY][l] / 2 : -sums[SUM_YY][l] / 2;
    const real dk = -A * sums[SUM_WY][l];
    /* through (A, k, E) to the covariance and its root B; with c0 = b0 + k b1, since for a needle b0 and -k
     * b1 are large and nearly equal */
    const real dxx = -A * A * dA, dxy = -E * dk, dyy = -E * E * dE;
    struct vec3 db0 = add3(scale3(2 * dxx, g.c0), scale3(dxy, g.b1));
    struct vec3 db1 = add3(scale3(k, db0), add3(scale3(dxy, g.c0), scale3(2 * dyy, g.b1)));
    out.log_scale = scale3(2, add3(multiply3(g.c0, add3(scale3(dxx, g.c0), scale3(dxy, g.b1))),
                                   multiply3(scale3(dyy, g.b1), g.b1)));
    if (antialias) { /* log|b0 x b1| */
        const real by_area = dfade / (dfade != 0 ? dot3(g.m, g.m) : 1);
        const struct vec3 da0 = scale3(by_area, cross3(g.s1, g.m)), da1 = scale3(by_area, cross3(g.m, g.s0));
        const real shrink = real_sqrt(g.shrink2);
        out.log_scale = add3(out.log_scale, add3(multiply3(g.s0, da0), multiply3(g.s1, da1)));
        db0 = add3(db0, scale3(shrink, da0));
        db1 = add3(db1, scale3(shrink, da1));
    }
    const struct vec3 dm0 = multiply3(db0, g.scale), dm1 = multiply3(db1, g.scale); /* dL/d(J R rot) */
    const struct vec3 dt0 = mat3_times(g.rotation, dm0), dt1 = mat3_times(g.rotation, dm1);
    const struct mat3 dr = {add3(scale3(g.t0.x, dm0), scale3(g.t1.x, dm1)),
                            add3(scale3(g.t0.y, dm0), scale3(g.t1.y, dm1)),
                            add3(scale3(g.t0.z, dm0), scale3(g.t1.z, dm1))};
    out.mean = mat3_transposed_times(kernel_camera->rotation,
                                     project_jacobian_backward(kernel_camera, &g, dt0, dt1, du, dv));
    out.u = du, out.v = dv;
    project_rotation_backward(&g, dr, out.q);
    return out;
}

/* |dL/d(u, v)| in units of half an image. */
SIMD_INLINE real project_length(const struct kernel_camera *kernel_camera, real du, real dv)
{
    const real hx = kernel_camera->half_width * du, hy = kernel_camera->half_height * dv;
    return real_sqrt(hx * hx + hy * hy);
}

SIMD_INLINE void project_lane_backward(const int fused, const int antialias, const struct project_job *job,
                                       unsigned seen, size_t i, int l, struct project_gradients *d)
{
    const struct kernel_camera *kernel_camera = job->kernel_camera;
    const size_t to = i - job->out_row;
    int in_front;
    const struct project_geometry g =
        project_geometry(fused, antialias, 0, &job->in, kernel_camera, i, &in_front);
    /* 1 - o, without cancellation */
    const real rest = project_sigmoid(fused, -job->in.plane[OXL_OPACITY][i]);
    const struct project_geometry_gradient p =
        project_geometry_gradient(antialias, kernel_camera, &g, d->sums, l);
    const int ok = seen >> l & 1;
    d->mean[0][l] += p.mean.x;
    d->mean[1][l] += p.mean.y;
    d->mean[2][l] += p.mean.z;
    d->u[l] = p.u;
    d->v[l] = p.v;
    job->out.plane[OXL_LOG_SCALE][to] = ok ? p.log_scale.x : 0;
    job->out.plane[OXL_LOG_SCALE + 1][to] = ok ? p.log_scale.y : 0;
    job->out.plane[OXL_LOG_SCALE + 2][to] = ok ? p.log_scale.z : 0;
    job->out.plane[OXL_ROTATION][to] = ok ? p.q[0] : 0;
    job->out.plane[OXL_ROTATION + 1][to] = ok ? p.q[1] : 0;
    job->out.plane[OXL_ROTATION + 2][to] = ok ? p.q[2] : 0;
    job->out.plane[OXL_ROTATION + 3][to] = ok ? p.q[3] : 0;
    /* alpha = o G: d alpha/d logit = alpha (1 - o) */
    job->out.plane[OXL_OPACITY][to] = ok ? d->sums[SUM_D][l] * rest : 0;
    job->dmean2d[i] = ok ? project_length(kernel_camera, p.u, p.v) : 0;
}

/* The second lobe's part, added to what project_lane_backward wrote (MATH 16). Product rule:
 * log o' = log o + log sigmoid(a), log s' = log s + b, so gradients of o' and s' are also added to those of o
 * and s. */
SIMD_INLINE void project_lobe_lane_backward(const int fused, const int antialias,
                                            const struct project_job *job, unsigned seen, size_t i, int l,
                                            real sums[SPLAT_SUMS][PACK], struct project_gradients *d)
{
    const struct kernel_camera *kernel_camera = job->kernel_camera;
    const size_t to = i - job->out_row;
    int in_front;
    const struct project_geometry g =
        project_geometry(fused, antialias, 1, &job->in, kernel_camera, i, &in_front);
    const real rest = project_sigmoid(fused, -job->in.plane[OXL_OPACITY][i]);
    const real rest_factor = project_sigmoid(fused, -job->in.plane[OXL_LOBE][i]);
    const struct project_geometry_gradient p =
        project_geometry_gradient(antialias, kernel_camera, &g, sums, l);
    const real dlog_o = sums[SUM_D][l]; /* dL/d(log o') */
    const int ok = seen >> l & 1;       /* seen: of the rows with a lobe */
    d->mean[0][l] += ok ? p.mean.x : 0;
    d->mean[1][l] += ok ? p.mean.y : 0;
    d->mean[2][l] += ok ? p.mean.z : 0;
    job->out.plane[OXL_LOG_SCALE][to] += ok ? p.log_scale.x : 0;
    job->out.plane[OXL_LOG_SCALE + 1][to] += ok ? p.log_scale.y : 0;
    job->out.plane[OXL_LOG_SCALE + 2][to] += ok ? p.log_scale.z : 0;
    job->out.plane[OXL_ROTATION][to] += ok ? p.q[0] : 0;
    job->out.plane[OXL_ROTATION + 1][to] += ok ? p.q[1] : 0;
    job->out.plane[OXL_ROTATION + 2][to] += ok ? p.q[2] : 0;
    job->out.plane[OXL_ROTATION + 3][to] += ok ? p.q[3] : 0;
    job->out.plane[OXL_OPACITY][to] += ok ? dlog_o * rest : 0;
    job->out.plane[OXL_LOBE][to] = ok ? dlog_o * rest_factor : 0;
    job->out.plane[OXL_LOBE + 1][to] = ok ? p.log_scale.x : 0;
    job->out.plane[OXL_LOBE + 2][to] = ok ? p.log_scale.y : 0;
    job->out.plane[OXL_LOBE + 3][to] = ok ? p.log_scale.z : 0;
    job->dmean2d[i] = ok ? project_length(kernel_camera, d->u[l] + p.u, d->v[l] + p.v) : job->dmean2d[i];
}

SIMD_INLINE void project_pack_backward(const int fused, const int antialias, const struct project_job *job,
                                       unsigned seen, size_t first, int lobes, struct project_gradients *d)
{
    const unsigned both = seen & ((1u << lobes) - 1);
    real sums[SPLAT_SUMS][PACK];
#pragma omp simd
    for (int l = 0; l < PACK; l++) project_lane_backward(fused, antialias, job, seen, first + l, l, d);
    if (!lobes) return;
    project_gather_lobes(job, first, seen, lobes, sums);
#pragma omp simd
    for (int l = 0; l < PACK; l++)
        project_lobe_lane_backward(fused, antialias, job, both, first + l, l, sums, d);
}

SIMD_BODY void project_backward_body(const int fused, const struct project_job *job)
{
    for (size_t pack = job->first_pack; pack < job->end_pack; pack++) {
        const size_t first = pack * PACK, to = first - job->out_row;
        const unsigned seen = job->visible[pack];
        const int lobes = project_lobes(&job->in, first);
        struct project_gradients d;
        struct project_colour colour;
        real drange[PACK], by_colour[3][PACK];
        if (!seen) continue;
        if (pack + 1 < job->end_pack && job->visible[pack + 1]) {
            project_prefetch(job->in.plane, job->in.sh_degree, first + PACK);
            project_prefetch(job->out.plane, job->in.sh_degree, to + PACK);
        }
        project_gather(job, first, seen, &d);
        if (job->medium) medium_pack_backward(job, pack, d.sums + SUM_RED, drange);
        project_view_direction(&job->in, job->kernel_camera, first, &colour);
        memset(d.mean, 0, sizeof d.mean);
        project_colour_backward(job, first, &colour, d.sums + SUM_RED, d.mean);
        memcpy(by_colour, d.mean, job->pose_sum ? sizeof by_colour : 0);
        if (job->kernel_camera->antialias) project_pack_backward(fused, 1, job, seen, first, lobes, &d);
        else project_pack_backward(fused, 0, job, seen, first, lobes, &d);
        if (job->medium) medium_pack_centres(job, pack, drange, d.mean);
        if (job->pose_sum) pose_pack_backward(job, first, seen, by_colour, d.mean);
        for (int axis = 0; axis < 3; axis++)
            for (int l = 0; l < PACK; l++)
                job->out.plane[OXL_MEAN + axis][to + l] = seen >> l & 1 ? d.mean[axis][l] : 0;
    }
}

SIMD_DISPATCH(OXL_INTERNAL, project_forward, struct project_job)
SIMD_DISPATCH(OXL_INTERNAL, project_backward, struct project_job)
