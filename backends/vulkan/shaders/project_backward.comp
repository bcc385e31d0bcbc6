/* project_backward.comp - the pairs' sums back to the Gaussians: the counterpart of src/render/project.c, backward. An invocation a row of a
 * slab. Built twice (shaders.sh): STEP 0 writes the gradient; STEP 1 keeps it in registers and steps the row (Kingma & Ba 2015), the
 * counterpart of src/render/adam.c: so a step neither writes nor reads a gradient of the whole model.
 *
 * A row of which a number or its gradient is not finite is not stepped, counted, and not seen from then on; one with such a number of its
 * own is cleared as in src/train/nonfinite.c. VARIANT 1, after a loss that is not finite, only clears: also rows that the view made such a
 * number of. VARIANT 2: with a medium. A row's pairs are added in the order of their slots: the order of a sum is part of the result. Rows that were not seen are not written.
 */
#version 450
#extension GL_GOOGLE_include_directive : require
#include "view.glsl"
#define INFINITY_BITS view.infinity
#include "common.glsl"

#if STEP
layout(std430, binding = 1) buffer Parameter { float parameter[]; };
layout(std430, binding = 2) buffer Seen { uint seen[]; };
#else
layout(std430, binding = 1) readonly buffer Parameter { float parameter[]; };
layout(std430, binding = 2) readonly buffer Seen { uint seen[]; };
#endif
layout(std430, binding = 3) readonly buffer RowSlots { uvec2 row_slots[]; };
layout(std430, binding = 4) readonly buffer SumsA { vec4 sums_a[]; };
layout(std430, binding = 5) readonly buffer SumsB { vec4 sums_b[]; };
layout(std430, binding = 6) readonly buffer SumsC { float sums_c[]; };
layout(std430, binding = 7) readonly buffer SumsD { vec4 sums_d[]; };
layout(std430, binding = 8) readonly buffer SumsE { vec2 sums_e[]; };
layout(std430, binding = 9) writeonly buffer Mean2d { float mean2d[]; }; /* (rows) |dL/d(u,v)| in units of half an image */
#if STEP
layout(std430, binding = 10) buffer First { float mean[]; }; /* planes as the parameters' */
layout(std430, binding = 11) buffer Second { float square[]; };
layout(std430, binding = 12) buffer Counts { uint counts[]; };
layout(std430, binding = 13) readonly buffer Rates { float rates[]; }; /* by plane, with the first moment's correction */
layout(push_constant) uniform Push
{
    uint  first, count, stride, degree, lobes, lobe_plane;
    float beta1, beta2, inverse_correction;
}
push;
#else
layout(std430, binding = 10) writeonly buffer Gradient { float gradient[]; }; /* planes as the parameters' */
layout(push_constant) uniform Push { uint first, count, stride, degree, lobes, lobe_plane; } push;
#endif
#include "geometry.glsl"
#include "medium.glsl"
const bool IN_MEDIUM = (VARIANT & 2u) != 0u;

struct Sums {
    float g, w, y, ww, wy, yy;
    vec3  light;
};

struct Pull { /* dL/d(parameter), through the Gaussian on the image plane */
    vec3  mean, log_scale;
    vec4  q;
    float u, v;
};

#if STEP
void give(uint plane, uint i, float value)
{
    uint  at      = plane * push.stride + i;
    float g       = clamp(value, -1e18, 1e18);
    float m       = fma(push.beta1, mean[at], (1.0 - push.beta1) * g);
    float v       = fma(push.beta2, square[at], (1.0 - push.beta2) * g * g);
    mean[at]      = m;
    square[at]    = v;
    parameter[at] = parameter[at] - rates[plane] * (m / fma(sqrt(v), push.inverse_correction, 1e-15));
}
#else
void give(uint plane, uint i, float value) { gradient[plane * push.stride + i] = value; }
#endif

vec4 rotation_backward(Geometry g, mat3 dr) /* dr[k]: dL/d(row k) */
{
    float w = g.q.x, x = g.q.y, y = g.q.z, z = g.q.w;
    vec4  d = vec4(2.0 * (x * (dr[2].y - dr[1].z) + y * (dr[0].z - dr[2].x) + z * (dr[1].x - dr[0].y)),
                   2.0 * (y * (dr[0].y + dr[1].x) + z * (dr[0].z + dr[2].x) + w * (dr[2].y - dr[1].z)) - 4.0 * x * (dr[1].y + dr[2].z),
                   2.0 * (x * (dr[0].y + dr[1].x) + w * (dr[0].z - dr[2].x) + z * (dr[1].z + dr[2].y)) - 4.0 * y * (dr[0].x + dr[2].z),
                   2.0 * (w * (dr[1].x - dr[0].y) + x * (dr[0].z + dr[2].x) + y * (dr[1].z + dr[2].y)) - 4.0 * z * (dr[0].x + dr[1].y));
    return (d - dot(g.q, d) * g.q) * g.inverse_norm;
}

vec3 jacobian_backward(Geometry g, mat3 r, vec3 dt0, vec3 dt1, float du, float dv)
{
    float i = 1.0 / g.p.z, fx = view.fx * i, fy = view.fy * i;
    float d00 = dot(dt0, r[0]), d02 = dot(dt0, r[2]), d11 = dot(dt1, r[1]), d12 = dot(dt1, r[2]);
    float rx = g.tx * i, ry = g.ty * i;
    vec3  dp;
    dp.x = fx * du - (g.free_x ? fx * i * d02 : 0.0);
    dp.y = fy * dv - (g.free_y ? fy * i * d12 : 0.0);
    dp.z = -fx * i * (g.p.x * du + d00) - fy * i * (g.p.y * dv + d11) + fx * i * rx * (g.free_x ? 2.0 * d02 : d02) +
           fy * i * ry * (g.free_y ? 2.0 * d12 : d12);
    return dp;
}

/* Written with c0 = b0 + k b1, which keeps its digits in a needle: see project.c. */
Pull pull_of(Geometry g, Sums s)
{
    Pull  o;
    mat3  r = view_rotation();
    float A = g.yy / g.det * g.shrink2, k = -g.xy / g.yy, E = g.shrink2 / g.yy;
    bool  fades = view.antialias != 0u && g.bare > ANTIALIAS_MIN * g.det;
    float fade  = fades ? s.g : 0.0;
    float du = A * s.w, dv = k * du + E * s.y, dk = -A * s.wy;
    float dA = (fades ? fade / (2.0 * A) : 0.0) - s.ww / 2.0, dE = (fades ? fade / (2.0 * E) : 0.0) - s.yy / 2.0;
    float dxx = -A * A * dA, dxy = -E * dk, dyy = -E * E * dE;
    vec3  db0 = 2.0 * dxx * g.c0 + dxy * g.b1, db1 = k * db0 + (dxy * g.c0 + 2.0 * dyy * g.b1);
    o.log_scale = 2.0 * (g.c0 * (dxx * g.c0 + dxy * g.b1) + dyy * g.b1 * g.b1);
    if (fades) { /* log|b0 x b1| */
        float shrink = sqrt(g.shrink2);
        vec3  s0 = shrink * g.b0, s1 = shrink * g.b1, n = cross(s0, s1);
        vec3  da0 = fade / g.bare * cross(s1, n), da1 = fade / g.bare * cross(n, s0);
        o.log_scale += s0 * da0 + s1 * da1;
        db0 += shrink * da0;
        db1 += shrink * da1;
    }
    vec3 dm0 = db0 * g.scale, dm1 = db1 * g.scale;
    mat3 dr = mat3(g.t0.x * dm0 + g.t1.x * dm1, g.t0.y * dm0 + g.t1.y * dm1, g.t0.z * dm0 + g.t1.z * dm1);
    o.mean  = transposed_times(r, jacobian_backward(g, r, times(g.rotation, dm0), times(g.rotation, dm1), du, dv));
    o.u     = du;
    o.v     = dv;
    o.q     = rotation_backward(g, dr);
    return o;
}

/* d(sum of basis_k v_k)/d(direction), the direction taken as free. */
vec3 basis_backward(uint degree, vec3 way, float v[16])
{
    float x = way.x, y = way.y, z = way.z, xx = x * x, yy = y * y, zz = z * z;
    vec3  d = vec3(0.0);
    if (degree > 0u) d += SH_1 * vec3(-v[3], -v[1], v[2]);
    if (degree > 1u) {
        d.x += SH_2XY * (y * v[4] - z * v[7]) - 2.0 * SH_2ZZ * x * v[6] + 2.0 * SH_2XX * x * v[8];
        d.y += SH_2XY * (x * v[4] - z * v[5]) - 2.0 * SH_2ZZ * y * v[6] - 2.0 * SH_2XX * y * v[8];
        d.z += -SH_2XY * (y * v[5] + x * v[7]) + 4.0 * SH_2ZZ * z * v[6];
    }
    if (degree > 2u) {
        d.x += -SH_3Y * (6.0 * x * y * v[9] + 3.0 * (xx - yy) * v[15]) + SH_3XY * y * z * v[10] +
               SH_3YZ * (2.0 * x * y * v[11] - (4.0 * zz - 3.0 * xx - yy) * v[13]) - 6.0 * SH_3ZZ * x * z * v[12] + 2.0 * SH_3XX * x * z * v[14];
        d.y += -SH_3Y * (3.0 * (xx - yy) * v[9] - 6.0 * x * y * v[15]) + SH_3XY * x * z * v[10] +
               SH_3YZ * (2.0 * x * y * v[13] - (4.0 * zz - xx - 3.0 * yy) * v[11]) - 6.0 * SH_3ZZ * y * z * v[12] - 2.0 * SH_3XX * y * z * v[14];
        d.z += SH_3XY * x * y * v[10] - 8.0 * SH_3YZ * z * (y * v[11] + x * v[13]) + SH_3ZZ * (6.0 * zz - 3.0 * xx - 3.0 * yy) * v[12] +
               SH_3XX * (xx - yy) * v[14];
    }
    return d;
}

/* What the colour's gradient needs: dL/d(SH k, channel) is basis[k] d[channel]. */
struct Light {
    float basis[16];
    vec3  d, dmean; /* dmean: dL/d(mean) through the viewing direction */
};

Light colour_backward(uint i, vec3 light)
{
    Light o;
    float v[16], inverse;
    vec3  way          = colour_direction(i, inverse);
    uint  coefficients = (push.degree + 1u) * (push.degree + 1u);
    colour_basis(push.degree, way, o.basis);
    vec3 value = colour_of(i, push.degree, o.basis);
    vec3 dmean = vec3(0.0);
    if (IN_MEDIUM) light = medium_backward(medium_of(i, view.training_range), max(value, vec3(0.0)), light, dmean);
    o.d        = vec3(value.x > 0.0 ? light.x : 0.0, value.y > 0.0 ? light.y : 0.0, value.z > 0.0 ? light.z : 0.0);
    o.dmean    = dmean;
    if (push.degree == 0u) return o;
    for (uint k = 0u; k < coefficients; k++) v[k] = dot(vec3(at(SH + 3u * k, i), at(SH + 3u * k + 1u, i), at(SH + 3u * k + 2u, i)), o.d);
    vec3 dway = basis_backward(push.degree, way, v);
    o.dmean += (dway - dot(dway, way) * way) * inverse;
    return o;
}

Sums sums_of(uvec2 slots)
{
    Sums s = Sums(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, vec3(0.0));
    vec4 a = vec4(0.0), b = vec4(0.0);
    for (uint slot = slots.x; slot < slots.x + slots.y; slot++) {
        a += sums_a[slot];
        b += sums_b[slot];
        s.light.z += sums_c[slot];
    }
    s.g = a.x, s.w = a.y, s.y = a.z, s.ww = a.w, s.wy = b.x, s.yy = b.y;
    s.light.xy = b.zw;
    return s;
}

Sums lobe_sums_of(uvec2 slots)
{
    vec4 a = vec4(0.0);
    vec2 b = vec2(0.0);
    for (uint slot = slots.x; slot < slots.x + slots.y; slot++) {
        a += sums_d[slot];
        b += sums_e[slot];
    }
    return Sums(a.x, a.y, a.z, a.w, b.x, b.y, vec3(0.0));
}

#if STEP
bool row_holds_numbers(uint i, bool lobed)
{
    bool good = true;
    for (uint k = 0u; k < push.lobe_plane; k++) good = good && is_finite(at(k, i));
    for (uint k = 0u; lobed && k < 4u; k++) good = good && is_finite(at(push.lobe_plane + k, i));
    return good;
}

void set_row(uint plane, uint i, float value)
{
    uint at       = plane * push.stride + i;
    mean[at]      = 0.0;
    square[at]    = 0.0;
    parameter[at] = value;
}

void clear_row(uint i, bool lobed)
{
    for (uint k = 0u; k < push.lobe_plane + (lobed ? 4u : 0u); k++)
        set_row(k, i, k == ROTATION ? 1.0 : k == OPACITY ? -30.0 : 0.0);
}
#endif

#if STEP
/* sums_a, sums_b and sums_d are the splats. */
void clear_nonfinite(uint i, uint row, bool lobed)
{
    bool good = row_holds_numbers(i, lobed);
    if (seen[row] != 0u) {
        for (uint k = 0u; k < 4u; k++) good = good && is_finite(sums_a[row][k]);
        for (uint k = 0u; k < 3u; k++) good = good && (k > 1u || is_finite(sums_b[row][k])) && is_finite(sums_d[row][k]);
    }
    if (good) return;
    atomicAdd(counts[NONFINITE], 1u);
    atomicMin(counts[FIRST_NONFINITE], row);
    atomicAdd(counts[CLEARED], 1u);
    clear_row(i, lobed);
}
#endif

struct LobeGradient {
    float opacity;
    vec3  log_scale;
};

bool vec3_is_finite(vec3 v) { return is_finite(v.x) && is_finite(v.y) && is_finite(v.z); }

bool row_is_finite(uint i, bool lobed, Pull p, float opacity, Light light, LobeGradient lobe)
{
    uint coefficients = (push.degree + 1u) * (push.degree + 1u);
    bool good         = vec3_is_finite(p.mean) && vec3_is_finite(p.log_scale) && vec3_is_finite(p.q.xyz) && is_finite(p.q.w) && is_finite(opacity);
    for (uint k = 0u; k < SH + 3u * coefficients; k++) good = good && is_finite(at(k, i));
    for (uint k = 0u; k < coefficients; k++) good = good && vec3_is_finite(light.basis[k] * light.d);
    if (!lobed) return good;
    for (uint k = 0u; k < 4u; k++) good = good && is_finite(at(push.lobe_plane + k, i));
    return good && is_finite(lobe.opacity) && vec3_is_finite(lobe.log_scale);
}

void main()
{
    uint i = work_item(), row = push.first + i;
    if (i >= push.count) return;
#if STEP
    if (VARIANT == 1u) {
        clear_nonfinite(i, row, row < push.lobes);
        return;
    }
#endif
    if (seen[row] == 0u) return;
#if STEP
    if (counts[HALT] != 0u) return;
#endif
    bool         in_front, lobed = row < push.lobes;
    Geometry     g = geometry_place(i, in_front);
    LobeGradient lobe = LobeGradient(0.0, vec3(0.0));
    geometry_covariance(g);
    Sums  s    = sums_of(row_slots[row]);
    Pull  p    = pull_of(g, s);
    float rest = own_sigmoid(-at(OPACITY, i)), opacity = s.g * rest; /* 1 - o, digits kept */
    if (lobed) {
        g.scale = geometry_lobe_scale(i);
        geometry_covariance(g);
        Sums o         = lobe_sums_of(row_slots[row]);
        Pull second    = pull_of(g, o);
        lobe.opacity   = o.g * own_sigmoid(-at(push.lobe_plane, i));
        lobe.log_scale = second.log_scale;
        p.mean += second.mean;
        p.log_scale += second.log_scale;
        p.q += second.q;
        p.u += second.u;
        p.v += second.v;
        opacity += o.g * rest;
    }
    Light light = colour_backward(i, s.light);
    p.mean += light.dmean;
    mean2d[row] = length(vec2(view.half_width * p.u, view.half_height * p.v));
#if STEP
    if (!row_is_finite(i, lobed, p, opacity, light, lobe)) {
        seen[row] = 0u;
        atomicAdd(counts[NONFINITE], 1u);
        atomicMin(counts[FIRST_NONFINITE], row);
        if (row_holds_numbers(i, lobed)) return;
        atomicAdd(counts[CLEARED], 1u);
        clear_row(i, lobed);
        return;
    }
#endif
    for (uint k = 0u; k < 3u; k++) give(MEAN + k, i, p.mean[k]);
    for (uint k = 0u; k < 3u; k++) give(LOG_SCALE + k, i, p.log_scale[k]);
    for (uint k = 0u; k < 4u; k++) give(ROTATION + k, i, p.q[k]);
    give(OPACITY, i, opacity);
    for (uint k = 0u; k < (push.degree + 1u) * (push.degree + 1u); k++)
        for (uint ch = 0u; ch < 3u; ch++) give(SH + 3u * k + ch, i, light.basis[k] * light.d[ch]);
    if (!lobed) return;
    give(push.lobe_plane, i, lobe.opacity);
    for (uint k = 0u; k < 3u; k++) give(push.lobe_plane + 1u + k, i, lobe.log_scale[k]);
}
