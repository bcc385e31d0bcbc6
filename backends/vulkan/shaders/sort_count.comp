/* sort_count.comp - how many keys of each workgroup have each digit; sort.glsl has the whole. */
#version 450
#include "common.glsl"
#include "sort.glsl"
layout(std430, binding = 2) writeonly buffer Histogram { uint histogram[]; }; /* (256, groups) */

shared uint bin[256];

void main()
{
    uint t = gl_LocalInvocationIndex, g = work_group(), n = counts[push.slot];
    if (g >= push.groups) return;
    bin[t] = 0u;
    barrier();
    for (uint k = 0u; k < 8u; k++) {
        uint i = g * 2048u + k * 256u + t;
        if (i < n) atomicAdd(bin[key_in[i] >> push.shift & 255u], 1u);
    }
    barrier();
    histogram[t * push.groups + g] = bin[t];
}
