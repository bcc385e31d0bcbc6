/* imaging_total.comp - one workgroup adds up the shares of imaging_pixels.comp, behind the loss' totals. */
#version 450
#include "common.glsl"

layout(std430, binding = 0) readonly buffer Pixels { float pixels[]; };   /* (groups, 15) */
layout(std430, binding = 1) writeonly buffer Totals { float totals[]; };  /* from 8 on: (15) */
layout(push_constant) uniform Push { uint groups; } push;

shared float sums[256];

void main()
{
    uint i = gl_LocalInvocationIndex;
    for (uint k = 0u; k < 15u; k++) {
        float s = 0.0;
        for (uint g = i; g < push.groups; g += 256u) s += pixels[g * 15u + k];
        barrier();
        sums[i] = s;
        for (uint half_ = 128u; half_ > 0u; half_ /= 2u) {
            barrier();
            if (i < half_) sums[i] += sums[i + half_];
        }
        if (i == 0u) totals[8u + k] = sums[0];
    }
}
