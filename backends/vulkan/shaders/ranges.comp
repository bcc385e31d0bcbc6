/* ranges.comp - where each tile's pairs start among the sorted keys: by bisection. start[tiles] is the end of the last. */
#version 450
#include "common.glsl"

layout(std430, binding = 0) readonly buffer Key { uint key[]; };
layout(std430, binding = 1) writeonly buffer Start { uint start[]; };
layout(std430, binding = 2) readonly buffer Counts { uint counts[]; };
layout(push_constant) uniform Push { uint tiles; } push;

void main()
{
    uint tile = work_item(), low = 0u, high = counts[PAIRS];
    if (tile > push.tiles) return;
    while (low < high) {
        uint middle = low + (high - low) / 2u;
        if (key[middle] < tile) low = middle + 1u;
        else high = middle;
    }
    start[tile] = low;
}
