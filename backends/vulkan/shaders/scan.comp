/* scan.comp - exclusive prefix sums of whole numbers, in place (Blelloch 1990). A workgroup takes 2048 numbers, eight an invocation.
 *
 *     VARIANT 0  the sum of each workgroup's numbers
 *     VARIANT 1  one workgroup goes through all numbers, 2048 at a time; the total goes to counts[slot], 0 if it is more than
 *                `most`: that halts
 *     VARIANT 2  each workgroup's own prefixes, on top of the sums before it as VARIANT 1 has left them
 *     VARIANT 3  256 rows of n numbers, eight a workgroup, 32 invocations a row; the totals go to sums[row]
 */
#version 450
#include "common.glsl"

layout(std430, binding = 0) buffer Data { uint data[]; };
layout(std430, binding = 1) buffer Counts { uint counts[]; };
layout(std430, binding = 2) buffer Sums { uint sums[]; };
layout(push_constant) uniform Push { uint n, slot, most; } push;

shared uint total[256];

/* At most 2^32 - 1: then the host knows that it was too much. */
uint add(uint a, uint b)
{
    uint sum = a + b;
    return sum < a ? 0xFFFFFFFFu : sum;
}

/* Sum of the invocations before this one; total[255] holds all of them. */
uint before(uint value)
{
    uint t   = gl_LocalInvocationIndex;
    total[t] = value;
    barrier();
    for (uint step = 1u; step < 256u; step *= 2u) {
        uint left = t >= step ? total[t - step] : 0u;
        barrier();
        total[t] = add(total[t], left);
        barrier();
    }
    return total[t] - value;
}

uint load(uint at) { return at < push.n ? data[at] : 0u; }

uint sum_of(uint first)
{
    uint sum = 0u;
    for (uint k = 0u; k < 8u; k++) sum = add(sum, load(first + k));
    return sum;
}

void prefixes(uint first, uint sum)
{
    for (uint k = 0u; k < 8u && first + k < push.n; k++) {
        uint value      = data[first + k];
        data[first + k] = sum;
        sum += value;
    }
}

void scan_rows(uint t)
{
    uint lane = t & 31u, row = work_group() * 8u + (t >> 5), each = (push.n + 31u) / 32u;
    if (work_group() >= 256u / 8u) return; /* a dispatch may be rounded up: passes.c */
    uint from = row * push.n + min(lane * each, push.n), end = row * push.n + min((lane + 1u) * each, push.n), sum = 0u;
    for (uint i = from; i < end; i++) sum += data[i];
    total[t] = sum;
    for (uint step = 1u; step < 32u; step *= 2u) {
        barrier();
        uint left = lane >= step ? total[t - step] : 0u;
        barrier();
        total[t] += left;
    }
    if (lane == 31u) sums[row] = total[t];
    sum = total[t] - sum;
    for (uint i = from; i < end; i++) {
        uint value = data[i];
        data[i]    = sum;
        sum += value;
    }
}

void main()
{
    uint t = gl_LocalInvocationIndex, groups = (push.n + 2047u) / 2048u;
    if (VARIANT == 3u) {
        scan_rows(t);
        return;
    }
    if (VARIANT == 1u) {
        uint carry = 0u;
        for (uint g = 0u; g < groups; g++) {
            uint first = g * 2048u + t * 8u, sum = before(sum_of(first));
            prefixes(first, carry + sum);
            carry = add(carry, total[255]);
            barrier();
        }
        if (t != 0u) return;
        counts[push.slot] = carry <= push.most ? carry : 0u;
        if (push.slot == PAIRS) counts[PAIRS_FOUND] = carry;
        if (carry > push.most) counts[HALT] = HALT_PAIRS;
        return;
    }
    uint g = work_group();
    if (g >= groups) return;
    uint first = g * 2048u + t * 8u, sum = before(sum_of(first));
    if (VARIANT == 0u) {
        if (t == 255u) sums[g] = total[255];
    } else prefixes(first, sums[g] + sum);
}
