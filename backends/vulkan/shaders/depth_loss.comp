/* depth_loss.comp - a loss on splats in front of points of known depth: the counterpart of src/render/depth_loss.c. A workgroup takes the points
 * of a tile one after the other, so a pair's sum is written by one invocation in a known order.
 */
#version 450
#extension GL_GOOGLE_include_directive : require
#include "view.glsl"
#define INFINITY_BITS view.infinity
#include "common.glsl"

layout(std430, binding = 1) readonly buffer Points { uvec4 point[]; };  /* bits of x y z of the camera, px; its tile's number: as a float, a device may flush it */
layout(std430, binding = 2) readonly buffer First { uint first_of[]; }; /* (groups + 1) of each tile's points */
layout(std430, binding = 3) readonly buffer Start { uint start[]; };
layout(std430, binding = 4) readonly buffer Sorted { uint sorted[]; };
layout(std430, binding = 5) readonly buffer Staged { uvec2 staged[]; };
layout(std430, binding = 6) readonly buffer SplatA { vec4 splat_a[]; };
layout(std430, binding = 7) readonly buffer SplatB { vec4 splat_b[]; };
layout(std430, binding = 8) readonly buffer SplatC { vec4 splat_c[]; };
layout(std430, binding = 9) buffer SumsA { float sums_a[]; };
layout(std430, binding = 10) readonly buffer Counts { uint counts[]; };
layout(push_constant) uniform Push { float weight; uint lobes, groups, rows; } push;

const float FRACTION = 0.8;

shared float through[256];

/* Alpha of a pair at a point; 0 of splats behind it, of those with a second lobe and of the surroundings. */
float alpha_of(uint row, vec3 p)
{
    vec4 a = splat_a[row], b = splat_b[row];
    if (row < push.lobes || row >= push.rows || !(splat_c[row].w < FRACTION * p.z)) return 0.0;
    float dy = p.y - a.y, w = fma(a.w, dy, p.x - a.x), exponent = b.y - a.z * w * w - b.x * dy * dy;
    return exponent < -view.cut ? 0.0 : min(own_exp2(exponent), ALPHA_MAX);
}

void main()
{
    uint i = gl_LocalInvocationIndex;
    if (counts[HALT] != 0u || work_group() >= push.groups) return;
    /* read before the loop: GPU-assisted validation cannot instrument a loop's condition that reads a buffer */
    uint last = first_of[work_group() + 1u];
    for (uint n = first_of[work_group()]; n < last; n++) {
        vec3  p    = uintBitsToFloat(point[n].xyz);
        uint  tile = point[n].w, from = start[tile], end = start[tile + 1u];
        float t    = 1.0;
        for (uint pair = from + i; pair < end; pair += 256u) t *= 1.0 - alpha_of(staged[sorted[pair]].x, p);
        barrier();
        through[i] = t;
        for (uint half_ = 128u; half_ > 0u; half_ /= 2u) {
            barrier();
            if (i < half_) through[i] *= through[i + half_];
        }
        barrier();
        t = push.weight * through[0];
        for (uint pair = from + i; pair < end; pair += 256u) {
            uint  slot  = sorted[pair];
            float alpha = alpha_of(staged[slot].x, p);
            if (alpha > 0.0 && alpha < ALPHA_MAX) sums_a[4u * slot] += t * alpha / (1.0 - alpha);
        }
    }
}
