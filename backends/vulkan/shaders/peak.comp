/* peak.comp - multiply-adds and nothing else, 16 chains an invocation, all in registers: bench/device.c holds the rasterizer against it. */
#version 450
#include "common.glsl"

layout(std430, binding = 0) writeonly buffer Out { float out_[]; }; /* (256) so that the work is not left out */
layout(push_constant) uniform Push { uint rounds; float scale, shift; } push; /* 64 multiply-adds a round */

void main()
{
    vec4 a = vec4(gl_LocalInvocationIndex), b = a + 0.25, c = a + 0.5, d = a + 0.75;
    vec4 scale = vec4(push.scale), shift = vec4(push.shift);
    for (uint k = 0u; k < push.rounds; k++)
        for (uint j = 0u; j < 4u; j++) {
            a = fma(a, scale, shift);
            b = fma(b, scale, shift);
            c = fma(c, scale, shift);
            d = fma(d, scale, shift);
        }
    out_[gl_LocalInvocationIndex] = dot(a + b + c + d, vec4(1.0));
}
