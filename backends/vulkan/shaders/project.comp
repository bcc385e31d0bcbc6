/* project.comp - Gaussians onto the image plane: the counterpart of src/render/project.c, forward. An invocation a row of a slab.
 *
 *     VARIANT & 1  a medium lies between camera and Gaussians
 *     VARIANT & 2  some rows are left out: render_drop in src/render/renderer.c
 *     VARIANT & 4  rows of the surroundings, which come behind the model's
 *
 * What raster.comp needs of a row lies in vectors of four numbers, in arrays apart: no array exceeds maxStorageBufferRange before
 * there are 8 million rows, and reads are coalesced.
 */
#version 450
#extension GL_GOOGLE_include_directive : require
#include "view.glsl"
#define INFINITY_BITS view.infinity
#include "common.glsl"

layout(std430, binding = 1) readonly buffer Parameter { float parameter[]; };
layout(std430, binding = 2) writeonly buffer SplatA { vec4 splat_a[]; }; /* u v a k */
layout(std430, binding = 3) writeonly buffer SplatB { vec4 splat_b[]; }; /* e peak half_x half_y */
layout(std430, binding = 4) writeonly buffer SplatC { vec4 splat_c[]; }; /* r g b depth */
layout(std430, binding = 5) writeonly buffer Seen { uint seen[]; };      /* 1 or 0 */
layout(std430, binding = 6) writeonly buffer LobeA { vec4 lobe_a[]; };   /* a k e peak */
layout(std430, binding = 7) writeonly buffer LobeB { vec4 lobe_b[]; };   /* half_x half_y main_x main_y */
layout(std430, binding = 8) writeonly buffer Rank { uint rank[]; };      /* as seen, to be summed in place */
layout(std430, binding = 9) readonly buffer Counts { uint counts[]; };
layout(push_constant) uniform Push { uint first, count, stride, degree, lobes, lobe_plane; } push;
#include "geometry.glsl"
#include "medium.glsl"
#include "random.glsl"
const bool IN_MEDIUM = (VARIANT & 1u) != 0u, DROPS = (VARIANT & 2u) != 0u, CONTEXT = (VARIANT & 4u) != 0u;

struct Shape {
    float a, k, e, reach, half_x, half_y;
};

Shape shape_of(Geometry g, float peak)
{
    Shape s;
    s.reach    = (peak + view.cut) * 2.0 * LN_2;
    float safe = max(s.reach, 0.0);
    s.half_x   = sqrt(safe * g.xx / g.shrink2) * 1.0001 + 0.001;
    s.half_y   = sqrt(safe * g.yy / g.shrink2) * 1.0001 + 0.001;
    s.a        = LOG2_E / 2.0 * (g.yy / g.det) * g.shrink2;
    s.k        = -g.xy / g.yy;
    s.e        = LOG2_E / 2.0 * g.shrink2 / g.yy;
    return s;
}

bool in_view(vec2 c, float half_x, float half_y)
{
    return c.x + half_x >= 0.5 && c.x - half_x <= float(view.width) - 0.5 && c.y + half_y >= 0.5 &&
           c.y - half_y <= float(view.height) - 0.5 && half_x < 1e30 && half_y < 1e30;
}

/* A row with a mean or rotation that is not finite, or a scale that is NaN, is out of view, as on the CPU. */
bool row_is_drawable(uint i)
{
    bool good = true;
    for (uint k = 0u; k < 3u; k++) good = good && is_finite(at(MEAN + k, i)) && !is_nan(at(LOG_SCALE + k, i));
    for (uint k = 0u; k < 4u; k++) good = good && is_finite(at(ROTATION + k, i));
    return good;
}

bool shape_is_finite(Shape s) { return is_finite(s.a) && is_finite(s.k) && is_finite(s.e) && is_finite(s.reach); }

void main()
{
    uint i = work_item(), row = push.first + i;
    if (i >= push.count) return;
    if (counts[HALT] != 0u) {
        rank[row] = 0u;
        return;
    }
    bool     in_front;
    Geometry g = geometry_place(i, in_front);
    geometry_covariance(g);
    float opacity = own_log2(own_sigmoid(at(OPACITY, i))), peak = opacity + geometry_fade(g);
    Shape s    = shape_of(g, peak);
    vec2  c    = vec2(view.fx * g.p.x / g.p.z + view.cx, view.fy * g.p.y / g.p.z + view.cy);
    float half_x = s.half_x, half_y = s.half_y;
    bool  shown = row_is_drawable(i) && shape_is_finite(s) && s.a < 1e30, second = false;
    if (row < push.lobes) {
        g.scale = geometry_lobe_scale(i);
        geometry_covariance(g);
        float other = opacity + geometry_fade(g) + own_log2(own_sigmoid(at(push.lobe_plane, i)));
        Shape o     = shape_of(g, other);
        half_x      = max(o.half_x, s.half_x);
        half_y      = max(o.half_y, s.half_y);
        shown       = shown && shape_is_finite(o) && o.a < 1e30;
        second      = o.reach >= 0.0;
        lobe_a[row] = vec4(o.a, o.k, o.e, DROPS ? other + view.dropout_gain : other);
        lobe_b[row] = vec4(o.half_x, o.half_y, s.half_x, s.half_y);
    }
    bool numbers = is_finite(c.x) && is_finite(c.y) && is_finite(half_x) && is_finite(half_y);
    bool sees    = in_front && shown && numbers && (s.reach >= 0.0 || second) && in_view(c, half_x, half_y);
    if (DROPS) sees = sees && random_bits(uvec2(view.dropout_low, view.dropout_high), CONTEXT ? row + view.surroundings_shift : row, view.dropout_step).y >= view.dropout_most;
    seen[row]    = sees ? 1u : 0u;
    rank[row]    = sees ? 1u : 0u;
    if (!sees) return;
    float inverse, basis[16];
    vec3  way = colour_direction(i, inverse);
    colour_basis(push.degree, way, basis);
    splat_a[row] = vec4(c, s.a, s.k);
    vec3 colour  = max(colour_of(i, push.degree, basis), vec3(0.0));
    splat_b[row] = vec4(s.e, DROPS ? peak + view.dropout_gain : peak, half_x, half_y);
    splat_c[row] = vec4(IN_MEDIUM ? medium_forward(medium_of(i, CONTEXT ? 0.0 : view.training_range), colour) : colour, g.p.z);
}
