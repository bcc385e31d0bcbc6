/* sort_scatter.comp - keys to their places; histogram holds where each workgroup's first key of a digit goes. sort.glsl has the whole.
 *
 * Ranks within the workgroup: each invocation counts its digits, two to a word; an invocation for each pair of digits and each 32nd of
 * the workgroup adds them up.
 */
#version 450
#include "common.glsl"
#include "sort.glsl"
layout(std430, binding = 2) readonly buffer Histogram { uint histogram[]; };
layout(std430, binding = 3) writeonly buffer KeyOut { uint key_out[]; };
layout(std430, binding = 4) readonly buffer ValueIn { uint value_in[]; };
layout(std430, binding = 5) writeonly buffer ValueOut { uint value_out[]; };

shared uint have[8 * 256]; /* (pair of digits, invocation) */
shared uint part[8 * 32];

void main()
{
    uint t = gl_LocalInvocationIndex, g = work_group(), n = counts[push.slot], first = g * 2048u + t * 8u;
    uint key[8], rank[8];
    if (g >= push.groups) return;
    for (uint p = 0u; p < 8u; p++) have[p * 256u + t] = 0u;
    for (uint k = 0u; k < 8u; k++) {
        if (first + k >= n) break;
        key[k]       = key_in[first + k];
        uint digit   = key[k] >> push.shift & 15u, at = (digit >> 1) * 256u + t, half_ = (digit & 1u) * 16u;
        rank[k]      = have[at] >> half_ & 0xFFFFu;
        have[at] += 1u << half_;
    }
    barrier();
    uint pair = t & 7u, chunk = t >> 3, at = pair * 256u + chunk * 8u, sum = 0u;
    for (uint k = 0u; k < 8u; k++) sum += have[at + k];
    part[pair * 32u + chunk] = sum;
    barrier();
    sum = 0u;
    for (uint c = 0u; c < chunk; c++) sum += part[pair * 32u + c];
    for (uint k = 0u; k < 8u; k++) {
        uint here    = have[at + k];
        have[at + k] = sum;
        sum += here;
    }
    barrier();
    for (uint k = 0u; k < 8u; k++) {
        if (first + k >= n) break;
        uint digit = key[k] >> push.shift & 15u;
        uint to    = histogram[digit * push.groups + g] + (have[(digit >> 1) * 256u + t] >> ((digit & 1u) * 16u) & 0xFFFFu) + rank[k];
        key_out[to]   = key[k];
        value_out[to] = value_in[first + k];
    }
}
