/* loss_backward.comp - dL/d(drawn image): the derivatives blurred back, and L1's part; VARIANT & 1: also the tile's share of
 * dL/d(log gain) = sum of dL/dy y, y = gain x. VARIANT & 2: by a lamp; & 4: of a window, whose pixels count as
 * those of the full image do.
 */
#version 450
#include "common.glsl"
#include "loss.glsl"

layout(std430, binding = 0) readonly buffer Rgb { float rgb[]; };
layout(std430, binding = 1) readonly buffer Target { float target[]; };
layout(std430, binding = 2) readonly buffer Weight { float weight[]; };
layout(std430, binding = 3) readonly buffer Slope0 { float slope0[]; };
layout(std430, binding = 4) readonly buffer Slope1 { float slope1[]; };
layout(std430, binding = 5) readonly buffer Slope2 { float slope2[]; };
layout(std430, binding = 6) readonly buffer Totals { float totals[]; };
layout(std430, binding = 7) writeonly buffer Drgb { float drgb[]; };
layout(std430, binding = 8) writeonly buffer Partial { float partial[]; }; /* (3,tiles), VARIANT & 1 */
layout(std430, binding = 9) readonly buffer Lamp { float lamp[]; };           /* (H,W) the lamp's gain, VARIANT & 2 */

shared float d[3][REACH * REACH];
shared float along[3][REACH * 16];

float slope_at(uint channel, uint at) { return channel == 0u ? slope0[at] : channel == 1u ? slope1[at] : slope2[at]; }

void main()
{
    uint i = gl_LocalInvocationIndex, channel = loss_channel(), plane = push.width * push.height;
    if (channel >= 3u) return;
    ivec2 origin = reach_at(), at = origin + ivec2(i % 16u, i / 16u) + int(HALF);
    vec3  back = vec3(0.0);
    if (push.ssim_weight > 0.0) {
        for (uint k = i; k < REACH * REACH; k += 256u) {
            ivec2 p = origin + ivec2(k % REACH, k / REACH);
            for (uint m = 0u; m < 3u; m++) d[m][k] = in_image(p) ? slope_at(channel, m * plane + pixel_index(p)) : 0.0;
        }
        barrier();
        for (uint k = i; k < REACH * 16u; k += 256u)
            for (uint m = 0u; m < 3u; m++) {
                float s = 0.0;
                for (uint t = 0u; t < 11u; t++) s = fma(WINDOW[t], d[m][k / 16u * REACH + k % 16u + t], s);
                along[m][k] = s;
            }
        barrier();
        for (uint m = 0u; m < 3u; m++)
            for (uint t = 0u; t < 11u; t++) back[m] = fma(WINDOW[t], along[m][(i / 16u + t) * 16u + i % 16u], back[m]);
    }
    float share = 0.0;
    if (in_image(at)) {
        uint  p = pixel_index(at);
        float light = (VARIANT & 2u) != 0u ? lamp[p] : 1.0;
        float a = loss_gain(channel) * rgb[channel * plane + p] * light, b = target[channel * plane + p];
        float w = push.masked != 0u ? weight[p] : 1.0;
        float l1 = totals[3] > 0.0 ? (1.0 - push.ssim_weight) / totals[3] : 0.0, s = totals[4] > 0.0 ? push.ssim_weight / totals[4] : 0.0;
        float dy = s * (back.x + fma(2.0 * a, back.y, b * back.z)) + l1 * w * (a > b ? 1.0 : a < b ? -1.0 : 0.0);
        drgb[channel * plane + p] = loss_gain(channel) * dy * light * ((VARIANT & 4u) != 0u ? push.part : 1.0);
        share = dy * a;
    }
    if ((VARIANT & 1u) == 0u) return;
    d[0][i] = share; /* the slopes in `d` were read before the last barrier */
    for (uint half_ = 128u; half_ > 0u; half_ /= 2u) {
        barrier();
        if (i < half_) d[0][i] += d[0][i + half_];
    }
    if (i == 0u) partial[work_group()] = d[0][0];
}
