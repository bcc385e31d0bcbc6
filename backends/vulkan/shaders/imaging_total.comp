/* imaging_total.comp - one workgroup adds up the shares of imaging_pixels.comp and imaging_rows.comp, behind the loss' totals. */
#version 450
#include "common.glsl"

layout(std430, binding = 0) readonly buffer Pixels { float pixels[]; };   /* (pixel_groups, 18) */
layout(std430, binding = 1) readonly buffer Rows { float rows[]; };       /* (row_groups, 10) */
layout(std430, binding = 2) writeonly buffer Totals { float totals[]; };  /* from 8 on: (18 + 10) */
layout(push_constant) uniform Push { uint pixel_groups, row_groups; } push;

shared float sums[256];

void main()
{
    uint i = gl_LocalInvocationIndex;
    for (uint k = 0u; k < 28u; k++) {
        float s = 0.0;
        for (uint g = i; k < 18u && g < push.pixel_groups; g += 256u) s += pixels[g * 18u + k];
        for (uint g = i; k >= 18u && g < push.row_groups; g += 256u) s += rows[g * 10u + k - 18u];
        barrier();
        sums[i] = s;
        for (uint half_ = 128u; half_ > 0u; half_ /= 2u) {
            barrier();
            if (i < half_) sums[i] += sums[i + half_];
        }
        if (i == 0u) totals[8u + k] = sums[0];
    }
}
