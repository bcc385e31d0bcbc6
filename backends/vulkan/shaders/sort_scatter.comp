/* sort_scatter.comp - keys to their places; sort.glsl has the whole.
 *
 * The workgroup's keys are sorted by the digit in shared memory first, by its lower and then its upper four bits, as (digit, index)
 * pairs; then a key's place is that of its digit's first key in the workgroup plus its distance from it. So neighbours write to neighbours.
 *
 * A pass over four bits: each invocation counts its eight keys, four digits to a word; 128 invocations, one for each word and each 32nd of
 * the workgroup, turn the counts into prefixes; 16, one a digit, add those up.
 */
#version 450
#include "common.glsl"
#include "sort.glsl"
layout(std430, binding = 2) readonly buffer Histogram { uint histogram[]; }; /* (256, groups) prefixes along each row */
layout(std430, binding = 3) readonly buffer Totals { uint totals[]; };       /* (256) */
layout(std430, binding = 4) writeonly buffer KeyOut { uint key_out[]; };
layout(std430, binding = 5) readonly buffer ValueIn { uint value_in[]; };
layout(std430, binding = 6) writeonly buffer ValueOut { uint value_out[]; };

shared uint item[2048];    /* digit << 11 | index in the workgroup's keys */
shared uint have[4 * 256]; /* (word, invocation) keys with each of four digits, 8 bits each; then of the invocations before, in the chunk */
shared uint part[4 * 32];  /* (word, chunk of eight invocations) as above, of the chunk */
shared uint chunk_at[256]; /* (digit, chunk) two to a word: keys with the digit in the chunks before */
shared uint digit_at[16];  /* keys with the digit; then with smaller digits */
shared uint first_of[256]; /* where a digit's keys begin in `item`; before, scratch of the totals' prefixes */

/* Where the workgroup's first key with digit t goes. */
uint digit_base(uint t, uint g)
{
    first_of[t] = totals[t];
    barrier();
    for (uint step = 1u; step < 256u; step *= 2u) {
        uint left = t >= step ? first_of[t - step] : 0u;
        barrier();
        first_of[t] += left;
        barrier();
    }
    return first_of[t] - totals[t] + histogram[t * push.groups + g];
}

void count_four_bits(uint t, uint shift, uint mine[8], out uint rank[8])
{
    for (uint w = 0u; w < 4u; w++) have[w * 256u + t] = 0u;
    for (uint k = 0u; k < 8u; k++) {
        uint digit = mine[k] >> shift & 15u, at = (digit >> 2) * 256u + t, field = (digit & 3u) * 8u;
        rank[k]    = have[at] >> field & 255u;
        have[at] += 1u << field;
    }
}

/* Places of the workgroup's keys when sorted by four bits of the digit. */
void sort_four_bits(uint t, uint shift)
{
    uint mine[8], rank[8];
    for (uint k = 0u; k < 8u; k++) mine[k] = item[8u * t + k];
    count_four_bits(t, shift, mine, rank);
    barrier();
    if (t < 128u) {
        uint word = t & 3u, chunk = t >> 2, sum = 0u;
        for (uint k = 0u; k < 8u; k++) {
            uint at = word * 256u + chunk * 8u + k, here = have[at];
            have[at] = sum;
            sum += here;
        }
        part[word * 32u + chunk] = sum;
    }
    barrier();
    if (t < 16u) {
        uint sum = 0u, field = (t & 3u) * 8u;
        for (uint chunk = 0u; chunk < 32u; chunk += 2u) {
            uint one = part[(t >> 2) * 32u + chunk] >> field & 255u, two = part[(t >> 2) * 32u + chunk + 1u] >> field & 255u;
            chunk_at[t * 16u + chunk / 2u] = sum | (sum + one) << 16;
            sum += one + two;
        }
        digit_at[t] = sum;
    }
    barrier();
    uint before = 0u;
    for (uint d = 0u; d < t && t < 16u; d++) before += digit_at[d];
    barrier();
    if (t < 16u) digit_at[t] = before;
    barrier();
    for (uint k = 0u; k < 8u; k++) {
        uint digit = mine[k] >> shift & 15u, chunk = t >> 3;
        uint to    = digit_at[digit] + (chunk_at[digit * 16u + chunk / 2u] >> (chunk & 1u) * 16u & 0xFFFFu) +
                  (have[(digit >> 2) * 256u + t] >> (digit & 3u) * 8u & 255u) + rank[k];
        item[to] = mine[k];
    }
    barrier();
}

void main()
{
    uint t = gl_LocalInvocationIndex, g = work_group(), n = counts[push.slot], first = g * 2048u;
    if (g >= push.groups || first >= n) return;
    uint base = digit_base(t, g);
    for (uint k = t; k < 2048u; k += 256u) /* past the end: the largest digit, and stay behind the others that have it */
        item[k] = (first + k < n ? key_in[first + k] >> push.shift & 255u : 255u) << 11 | k;
    barrier();
    sort_four_bits(t, 11u);
    sort_four_bits(t, 15u);
    for (uint k = t; k < 2048u; k += 256u) {
        uint digit = item[k] >> 11;
        if (k == 0u || item[k - 1u] >> 11 != digit) first_of[digit] = k;
    }
    barrier();
    have[t] = base - first_of[t]; /* of digits that the workgroup has not, anything */
    barrier();
    for (uint k = t; k < 2048u; k += 256u) {
        uint from = first + (item[k] & 2047u), to = have[item[k] >> 11] + k;
        if (from >= n) continue;
        key_out[to]   = key_in[from];
        value_out[to] = value_in[from];
    }
}
