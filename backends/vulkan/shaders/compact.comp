/* compact.comp - keys of the rows that are seen: their depth (the bits of a positive float sort like the number), ties by row. */
#version 450
#include "common.glsl"

layout(std430, binding = 0) readonly buffer Seen { uint seen[]; };
layout(std430, binding = 1) readonly buffer Rank { uint rank[]; };
layout(std430, binding = 2) readonly buffer SplatC { vec4 splat_c[]; };
layout(std430, binding = 3) writeonly buffer Key { uint key[]; };
layout(std430, binding = 4) writeonly buffer Value { uint value[]; };
layout(std430, binding = 5) readonly buffer Counts { uint counts[]; };
layout(push_constant) uniform Push { uint n; } push;

void main()
{
    uint row = work_item();
    if (row >= push.n || seen[row] == 0u || counts[VISIBLE] == 0u) return;
    key[rank[row]]   = floatBitsToUint(splat_c[row].w);
    value[rank[row]] = row;
}
