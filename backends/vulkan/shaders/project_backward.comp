/* project_backward.comp - the pairs' sums back to the Gaussians: the counterpart of src/render/project.c, backward. An invocation a row of a slab.
 *
 * A row's pairs are added in the order of their slots: the order of a sum is part of the result. Rows that were not seen are not written.
 */
#version 450
#include "common.glsl"
#include "view.glsl"

layout(std430, binding = 1) readonly buffer Parameter { float parameter[]; };
layout(std430, binding = 2) readonly buffer Seen { uint seen[]; };
layout(std430, binding = 3) readonly buffer RowSlots { uvec2 row_slots[]; };
layout(std430, binding = 4) readonly buffer SumsA { vec4 sums_a[]; };
layout(std430, binding = 5) readonly buffer SumsB { vec4 sums_b[]; };
layout(std430, binding = 6) readonly buffer SumsC { float sums_c[]; };
layout(std430, binding = 7) readonly buffer SumsD { vec4 sums_d[]; };
layout(std430, binding = 8) readonly buffer SumsE { vec2 sums_e[]; };
layout(std430, binding = 9) writeonly buffer Gradient { float gradient[]; }; /* planes as the parameters' */
layout(std430, binding = 10) writeonly buffer Mean2d { float mean2d[]; };    /* (rows) |dL/d(u,v)| in units of half an image */
layout(push_constant) uniform Push { uint first, count, stride, degree, lobes, lobe_plane; } push;
#include "geometry.glsl"

struct Sums {
    float g, w, y, ww, wy, yy;
    vec3  light;
};

struct Pull { /* dL/d(parameter), through the Gaussian on the image plane */
    vec3  mean, log_scale;
    vec4  q;
    float u, v;
};

void give(uint plane, uint i, float value) { gradient[plane * push.stride + i] = value; }

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
    float du = A * s.w, dv = k * du + E * s.y, dA = -s.ww / 2.0, dk = -A * s.wy, dE = -s.yy / 2.0;
    float dxx = -A * A * dA, dxy = -E * dk, dyy = -E * E * dE;
    vec3  db0 = 2.0 * dxx * g.c0 + dxy * g.b1, db1 = k * db0 + (dxy * g.c0 + 2.0 * dyy * g.b1);
    o.log_scale = 2.0 * (g.c0 * (dxx * g.c0 + dxy * g.b1) + dyy * g.b1 * g.b1);
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

/* The SH planes' gradients, and dL/d(mean) through the viewing direction. */
vec3 colour_backward(uint i, vec3 light)
{
    float basis[16], v[16], inverse;
    vec3  way   = colour_direction(i, inverse);
    uint  bands = (push.degree + 1u) * (push.degree + 1u);
    colour_basis(push.degree, way, basis);
    vec3 value = colour_of(i, push.degree, basis);
    vec3 d     = vec3(value.x > 0.0 ? light.x : 0.0, value.y > 0.0 ? light.y : 0.0, value.z > 0.0 ? light.z : 0.0);
    for (uint k = 0u; k < bands; k++) {
        for (uint ch = 0u; ch < 3u; ch++) give(SH + 3u * k + ch, i, basis[k] * d[ch]);
        v[k] = dot(vec3(at(SH + 3u * k, i), at(SH + 3u * k + 1u, i), at(SH + 3u * k + 2u, i)), d);
    }
    if (push.degree == 0u) return vec3(0.0);
    vec3 dway = basis_backward(push.degree, way, v);
    return (dway - dot(dway, way) * way) * inverse;
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

void main()
{
    uint i = work_item(), row = push.first + i;
    if (i >= push.count || seen[row] == 0u) return;
    bool     in_front;
    Geometry g = geometry_place(i, in_front);
    geometry_covariance(g);
    Sums  s       = sums_of(row_slots[row]);
    Pull  p       = pull_of(g, s);
    float rest    = own_sigmoid(-at(OPACITY, i)), opacity = s.g * rest; /* 1 - o, digits kept */
    if (row < push.lobes) {
        g.scale = geometry_lobe_scale(i);
        geometry_covariance(g);
        Sums o      = lobe_sums_of(row_slots[row]);
        Pull second = pull_of(g, o);
        give(push.lobe_plane, i, o.g * own_sigmoid(-at(push.lobe_plane, i)));
        for (uint k = 0u; k < 3u; k++) give(push.lobe_plane + 1u + k, i, second.log_scale[k]);
        p.mean += second.mean;
        p.log_scale += second.log_scale;
        p.q += second.q;
        p.u += second.u;
        p.v += second.v;
        opacity += o.g * rest;
    }
    p.mean += colour_backward(i, s.light);
    for (uint k = 0u; k < 3u; k++) give(MEAN + k, i, p.mean[k]);
    for (uint k = 0u; k < 3u; k++) give(LOG_SCALE + k, i, p.log_scale[k]);
    for (uint k = 0u; k < 4u; k++) give(ROTATION + k, i, p.q[k]);
    give(OPACITY, i, opacity);
    mean2d[row] = length(vec2(0.5 * float(view.width) * p.u, 0.5 * float(view.height) * p.v));
}
