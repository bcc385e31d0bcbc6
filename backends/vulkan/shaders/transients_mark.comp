/* transients_mark.comp - which squares of pixels are masked: the counterpart of transients_mark in src/parts/transients.c. An invocation a
 * square, which asks for the marks of its neighbours instead of waiting for them: a pass in place of four.
 */
#version 450
#include "common.glsl"

layout(std430, binding = 0) readonly buffer Error { float error[]; };
layout(std430, binding = 1) readonly buffer SquareExpected { uint square_expected[]; };
layout(std430, binding = 2) writeonly buffer Mark { uint mark[]; }; /* 1: masked */
layout(std430, binding = 3) buffer Counts { uint counts[]; };
layout(push_constant) uniform Push
{
    uint  width, height, side, across, down, votes, near;
    float error, times;
}
push;

/* Whether m times the square's error exceeds what the points around it lead to expect. */
bool exceeds(int x, int y, float m)
{
    int  near = int(push.near);
    uint most = 0u;
    for (int row = max(y - near, 0); row <= min(y + near, int(push.down) - 1); row++)
        for (int column = max(x - near, 0); column <= min(x + near, int(push.across) - 1); column++)
            most = max(most, square_expected[row * int(push.across) + column]);
    return most > 0u && m * error[y * int(push.across) + x] > push.times * uintBitsToFloat(most - 1u);
}

bool is_core(int x, int y)
{
    uint votes = 0u;
    if (!(error[y * int(push.across) + x] > push.error)) return false;
    for (int row = max(y - 1, 0); row <= min(y + 1, int(push.down) - 1); row++)
        for (int column = max(x - 1, 0); column <= min(x + 1, int(push.across) - 1); column++)
            votes += error[row * int(push.across) + column] > push.error ? 1u : 0u;
    return votes >= push.votes && exceeds(x, y, 1.0);
}

bool is_next_to_core(int x, int y)
{
    for (int row = max(y - 1, 0); row <= min(y + 1, int(push.down) - 1); row++)
        for (int column = max(x - 1, 0); column <= min(x + 1, int(push.across) - 1); column++)
            if (is_core(column, row)) return true;
    return false;
}

void main()
{
    uint i = work_item();
    if (i >= push.across * push.down) return;
    int  x = int(i % push.across), y = int(i / push.across);
    bool masked = error[i] > 0.5 * push.error && (is_core(x, y) || (exceeds(x, y, 2.0) && is_next_to_core(x, y)));
    mark[i] = masked ? 1u : 0u;
    if (masked)
        atomicAdd(counts[MASKED], min(push.side, push.width - uint(x) * push.side) * min(push.side, push.height - uint(y) * push.side));
}
