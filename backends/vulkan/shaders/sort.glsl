/* sort.glsl - radix sort, least significant digit first, eight bits a pass: stable (Satish et al. 2009). A workgroup takes 2048 keys, an
 * invocation eight that follow each other. How many keys there are is in counts[slot]: the host need not know. Three passes a digit:
 *
 *     sort_count    how many keys of each workgroup have each digit: histogram (256, groups)
 *     scan          VARIANT 3: each digit's row of it, in place; the rows' totals
 *     sort_scatter  keys to their places
 */
layout(std430, binding = 0) readonly buffer Counts { uint counts[]; };
layout(std430, binding = 1) readonly buffer KeyIn { uint key_in[]; };
layout(push_constant) uniform Push { uint slot, shift, groups; } push;
