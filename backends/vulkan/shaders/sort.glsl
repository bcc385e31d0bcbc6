/* sort.glsl - radix sort, least significant digit first, four bits a pass: stable. A workgroup takes 2048 keys, an invocation eight
 * that follow each other. How many keys there are is in counts[slot]: the host need not know. */
layout(std430, binding = 0) readonly buffer Counts { uint counts[]; };
layout(std430, binding = 1) readonly buffer KeyIn { uint key_in[]; };
layout(push_constant) uniform Push { uint slot, shift, groups; } push;
