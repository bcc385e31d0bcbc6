/* imaging_pixels.comp - what an image says about the lamp: a workgroup's share of the sums over pixels of dL/d(log of the lamp's gain) times
 * y^j x^k, in lamp.comp's order; as drgb = dL/dy gain and y = gain rgb, dL/dy y is drgb rgb. An invocation takes 16 of the workgroup's 4096
 * pixels.
 */
#version 450
#include "common.glsl"

layout(std430, binding = 0) readonly buffer Rgb { float rgb[]; };
layout(std430, binding = 1) readonly buffer Drgb { float drgb[]; };
layout(std430, binding = 2) writeonly buffer Partial { float partial[]; }; /* (groups, 15) */
layout(push_constant) uniform Push
{
    uint  width, height;
    float left, top, across, down; /* as in lamp.comp */
    float scale;                   /* of a window drgb is smaller */
}
push;

shared float sums[256];

void main()
{
    uint  i = gl_LocalInvocationIndex, plane = push.width * push.height;
    float s[15];
    if (work_group() * 4096u >= plane) return;
    for (uint k = 0u; k < 15u; k++) s[k] = 0.0;
    for (uint n = 0u; n < 16u; n++) {
        uint p = work_group() * 4096u + n * 256u + i;
        if (p >= plane) break;
        float x = fma(push.across, float(p % push.width), push.left), y = fma(push.down, float(p / push.width), push.top);
        float d  = push.scale * (drgb[p] * rgb[p] + drgb[plane + p] * rgb[plane + p] + drgb[2u * plane + p] * rgb[2u * plane + p]);
        uint  at = 0u;
        for (uint j = 0u; j <= 4u; j++, d *= y) {
            float xd = d;
            for (uint k = 0u; k <= 4u - j; k++, xd *= x) s[at++] += xd;
        }
    }
    for (uint k = 0u; k < 15u; k++) {
        barrier();
        sums[i] = s[k];
        for (uint half_ = 128u; half_ > 0u; half_ /= 2u) {
            barrier();
            if (i < half_) sums[i] += sums[i + half_];
        }
        if (i == 0u) partial[work_group() * 15u + k] = sums[0];
    }
}
