/* unpack.comp - an image of 8 bits a value to the numbers that the loss compares, at half its sides on request: the counterpart of
 * image_from_training and image_halve in src/survey/image.c. An invocation a pixel of the result.
 */
#version 450
#include "common.glsl"

layout(std430, binding = 0) readonly buffer Photo { uint words[]; };      /* (3,H,W) bytes, then the mask's (H,W) from mask_at on */
layout(std430, binding = 1) writeonly buffer Target { float target[]; };  /* (3,h,w) */
layout(std430, binding = 2) writeonly buffer Weight { float weight[]; };  /* (h,w), written when masked */
layout(push_constant) uniform Push { uint width, height, halved, masked, mask_at, x, y, across, down; } push; /* x to down: the window, VARIANT 1 */

uint byte_at(uint i) { return words[i >> 2] >> ((i & 3u) * 8u) & 255u; }
float value_at(uint i) { return float(byte_at(i)) / 255.0; }
float counts_at(uint i) { return byte_at(push.mask_at + i) != 0u ? 1.0 : 0.0; }

void main()
{
    uint i = work_item(), w = (VARIANT == 1u ? push.across : push.width) >> push.halved;
    uint h = (VARIANT == 1u ? push.down : push.height) >> push.halved, plane = push.width * push.height;
    if (i >= w * h) return;
    uint from = (i / w << push.halved) * push.width + (i % w << push.halved);
    if (VARIANT == 1u) from += push.y * push.width + push.x;
    for (uint ch = 0u; ch < 3u; ch++) {
        uint  at  = ch * plane + from;
        float sum = value_at(at);
        if (push.halved != 0u) sum = 0.25 * (sum + value_at(at + 1u) + value_at(at + push.width) + value_at(at + push.width + 1u));
        target[ch * w * h + i] = sum;
    }
    if (push.masked == 0u) return;
    float counts = counts_at(from);
    if (push.halved != 0u) counts *= counts_at(from + 1u) * counts_at(from + push.width) * counts_at(from + push.width + 1u);
    weight[i] = counts;
}
