/* transients_apply.comp - weights without the masked squares, and the points' new expected errors: the counterpart of transients_fill and
 * transients_update_points in src/parts/transients.c. An invocation a pixel, and a point.
 */
#version 450
#include "common.glsl"

layout(std430, binding = 0) readonly buffer Mark { uint mark[]; };
layout(std430, binding = 1) buffer Weight { float weight[]; }; /* (H,W) in: the image's mask, VARIANT 1 */
layout(std430, binding = 2) readonly buffer Place { uint place[]; };
layout(std430, binding = 3) readonly buffer Error { float error[]; };
layout(std430, binding = 4) buffer Expected { float expected[]; };
layout(std430, binding = 5) readonly buffer Counts { uint counts[]; };
layout(push_constant) uniform Push
{
    uint  width, height, side, across, points; /* points: 0, or all to update */
    float rate, most;
}
push;

void main()
{
    uint i = work_item();
    if (counts[HALT] != 0u) return;
    if (i < push.width * push.height) {
        bool masked = mark[i / push.width / push.side * push.across + i % push.width / push.side] != 0u;
        if (masked) weight[i] = 0.0;
        else if (VARIANT == 0u) weight[i] = 1.0;
    }
    if (i >= push.points || place[i] == 0xFFFFFFFFu) return;
    float e = error[place[i]];
    if (!(e >= 0.0)) return;
    precise float step = push.rate * (min(e, push.most) - expected[i]);
    expected[i] += step;
}
