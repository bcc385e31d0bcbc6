/* observe.comp - density control's statistics: the counterpart of renderer_observe's loop. VARIANT 1: of a window, rows whose centre it
 * shows. */
#version 450
#include "common.glsl"

layout(std430, binding = 0) readonly buffer Seen { uint seen[]; };
layout(std430, binding = 1) readonly buffer Mean2d { float mean2d[]; };
layout(std430, binding = 2) readonly buffer SplatC { vec4 splat_c[]; };
layout(std430, binding = 3) buffer Sums { vec4 sums[]; }; /* (rows) of the gradient: near, mid, far; how many views saw it */
layout(std430, binding = 4) readonly buffer Counts { uint counts[]; };
layout(std430, binding = 5) readonly buffer SplatA { vec4 splat_a[]; };
layout(push_constant) uniform Push { uint n; float z_near, z_far, width, height; } push;

void main()
{
    uint row = work_item();
    if (row >= push.n || seen[row] == 0u || counts[HALT] != 0u) return;
    if (VARIANT == 1u) {
        vec2 c = splat_a[row].xy;
        if (!(c.x >= 0.0 && c.y >= 0.0 && c.x < push.width && c.y < push.height)) return;
    }
    float depth = splat_c[row].w;
    uint  band  = depth < push.z_near ? 0u : depth < push.z_far ? 1u : 2u;
    vec4  sum   = sums[row];
    sum[band] += mean2d[row];
    sum.w += 1.0;
    sums[row] = sum;
}
