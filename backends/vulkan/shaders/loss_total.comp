/* loss_total.comp - one workgroup adds up what the tiles have: |x - y|, SSIM, (x - y)^2, values that count, windows that count.
 *
 *     VARIANT 1  dL/d(log gain) of the channels, behind those
 */
#version 450
#extension GL_GOOGLE_include_directive : require

layout(std430, binding = 0) readonly buffer Partial { float partial[]; }; /* (3,tiles,5); VARIANT 1: (3,tiles) */
layout(std430, binding = 1) writeonly buffer Totals { float totals[]; };  /* (5 + 3) */
layout(std430, binding = 2) writeonly buffer Counts { uint counts[]; };
layout(push_constant) uniform Push { uint n; float ssim_weight; uint halts, infinity; } push; /* n: 3 tiles; halts 1: if the loss is not finite */
#define INFINITY_BITS push.infinity
#include "common.glsl"

shared vec3  sums[256];
shared uvec2 numbers[256]; /* whole: a float cannot count 45 million */

void main()
{
    uint  i = gl_LocalInvocationIndex;
    vec3  s = vec3(0.0);
    uvec2 c = uvec2(0u);
    for (uint k = i; VARIANT == 1u && k < push.n / 3u; k += 256u)
        s += vec3(partial[k], partial[push.n / 3u + k], partial[2u * (push.n / 3u) + k]);
    for (uint k = i; VARIANT == 0u && k < push.n; k += 256u) {
        s += vec3(partial[5u * k], partial[5u * k + 1u], partial[5u * k + 2u]);
        c += uvec2(partial[5u * k + 3u], partial[5u * k + 4u]);
    }
    sums[i]    = s;
    numbers[i] = c;
    for (uint half_ = 128u; half_ > 0u; half_ /= 2u) {
        barrier();
        if (i < half_) {
            sums[i] += sums[i + half_];
            numbers[i] += numbers[i + half_];
        }
    }
    if (i != 0u) return;
    for (uint k = 0u; k < 3u; k++) totals[VARIANT == 1u ? 5u + k : k] = sums[0][k];
    if (VARIANT == 1u) return;
    totals[3] = float(numbers[0].x);
    totals[4] = float(numbers[0].y);
    bool l1   = numbers[0].x == 0u || is_finite(sums[0].x);
    bool ssim = push.ssim_weight <= 0.0 || numbers[0].y == 0u || is_finite(sums[0].y);
    if (push.halts != 0u && !(l1 && ssim)) counts[HALT] = HALT_LOSS;
}
