/* score.comp - a row's score: its pairs' in the order of their slots. */
#version 450
#include "common.glsl"

layout(std430, binding = 0) readonly buffer Seen { uint seen[]; };
layout(std430, binding = 1) readonly buffer RowSlots { uvec2 row_slots[]; };
layout(std430, binding = 2) readonly buffer SumsA { vec4 sums_a[]; };
layout(std430, binding = 3) writeonly buffer Score { float score[]; }; /* (rows) */
layout(push_constant) uniform Push { uint n; } push;

void main()
{
    uint  row = work_item();
    float sum = 0.0;
    if (row >= push.n) return;
    uvec2 slots = seen[row] != 0u ? row_slots[row] : uvec2(0u);
    for (uint slot = slots.x; slot < slots.x + slots.y; slot++) sum += sums_a[slot].x;
    score[row] = sum;
}
