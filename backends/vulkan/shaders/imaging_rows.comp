/* imaging_rows.comp - what the Gaussians say about a medium: a workgroup's share of the sums over rows, the counterpart of medium_row_sums in
 * src/render/medium.h. An invocation a row of a slab.
 */
#version 450
#extension GL_GOOGLE_include_directive : require
#include "view.glsl"
#define INFINITY_BITS view.infinity
#include "common.glsl"

layout(std430, binding = 1) readonly buffer Parameter { float parameter[]; };
layout(std430, binding = 2) readonly buffer Seen { uint seen[]; };
layout(std430, binding = 3) readonly buffer RowSlots { uvec2 row_slots[]; };
layout(std430, binding = 4) readonly buffer SumsB { vec4 sums_b[]; };
layout(std430, binding = 5) readonly buffer SumsC { float sums_c[]; };
layout(std430, binding = 6) writeonly buffer Partial { float partial[]; }; /* (groups, 10) attenuation, backscatter, veiling light; falloff */
layout(push_constant) uniform Push { uint first, count, stride, degree, lobes, lobe_plane, group; } push; /* group: of the slab's first */
#include "geometry.glsl"
#include "medium.glsl"

shared float sums[256];

void main()
{
    uint  i = work_item(), row = push.first + i;
    float s[10];
    for (uint k = 0u; k < 10u; k++) s[k] = 0.0;
    if (i < push.count && seen[row] != 0u) {
        vec3  light = vec3(0.0);
        uvec2 slots = row_slots[row];
        for (uint slot = slots.x; slot < slots.x + slots.y; slot++) light += vec3(sums_b[slot].zw, sums_c[slot]);
        float  inverse, basis[16];
        Medium m = medium_of(i, view.training_range);
        colour_basis(push.degree, colour_direction(i, inverse), basis);
        vec3 direct = light * max(colour_of(i, push.degree, basis), vec3(0.0)) * m.through;
        for (uint c = 0u; c < 3u; c++) {
            s[c]      = -(m.range - view.training_range) * direct[c];
            s[3u + c] = light[c] * view.veiling_light[c] * m.range * m.rest[c];
            s[6u + c] = light[c] * (1.0 - m.rest[c]);
        }
        s[9] = m.log_near * (direct.x + direct.y + direct.z);
    }
    for (uint k = 0u; k < 10u; k++) {
        barrier();
        sums[gl_LocalInvocationIndex] = s[k];
        for (uint half_ = 128u; half_ > 0u; half_ /= 2u) {
            barrier();
            if (gl_LocalInvocationIndex < half_) sums[gl_LocalInvocationIndex] += sums[gl_LocalInvocationIndex + half_];
        }
        if (gl_LocalInvocationIndex == 0u && i < push.count) partial[(push.group + work_group()) * 10u + k] = sums[0];
    }
}
