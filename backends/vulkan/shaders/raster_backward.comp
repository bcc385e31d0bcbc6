/* raster_backward.comp - the pixels' gradients back to the pairs, or (VARIANT & 2) how much each pair matters. By buckets of splats as in
 * Mallick 2024 (Taming 3DGS): forward kept T and the colour so far where each bucket of a tile begins, so all buckets are worked on at once.
 *
 * A bucket has 32 invocations, a workgroup two buckets that follow each other. An invocation has a quad of the tile's upper half and one of its
 * lower half, takes them past the bucket's splats, and adds up eight pixels of a splat in registers; what 32 invocations have of a splat's
 * sums is added up in shared memory, EACH splats at a time. So there is no atomic, and every sum has a written order, whatever the size of a
 * subgroup. A pair's sums go to its own slot. (A splat to a lane, as there, and pixels handed from lane to lane costs more: docs/log/SPEED.md.)
 */
#version 450
#define GROUP 64
#define BATCH 32
#include "common.glsl"
#include "view.glsl"
#include "raster.glsl"
/* As numbers: a compiler may write a whole vector where one invocation sets one of its components and others set the rest. */
layout(std430, binding = 10) readonly buffer Drgb { float drgb[]; };
layout(std430, binding = 11) writeonly buffer SumsA { float sums_a[]; }; /* (slots) g times 1, w, y, w^2; of the score: x alone */
layout(std430, binding = 12) writeonly buffer SumsB { float sums_b[]; }; /* g times w y, y^2; alpha T dL/dC of red, green */
layout(std430, binding = 13) writeonly buffer SumsC { float sums_c[]; }; /* blue */
layout(std430, binding = 14) writeonly buffer SumsD { float sums_d[]; }; /* of the second lobe: as sums_a */
layout(std430, binding = 15) writeonly buffer SumsE { float sums_e[]; }; /* and w y, y^2 */

const bool SCORE = (VARIANT & 2u) != 0u;
const uint LANES = 32u, EACH = 2u, SIDE = BATCH / SIDES, NUMBERS = 9u + 6u * LOBED, SUMS = SCORE ? 1u : NUMBERS;
const uint ROW = 36u; /* of 32 numbers, padded: rows that are read together begin in different banks, and as whole vectors */

shared float pool[SIDES * EACH * NUMBERS * ROW];

struct Pixels { /* of an invocation: a quad of each half */
    vec4 t, behind, g[3];
};

/* g times 1, w, y, w^2, w y, y^2, added to sum[0..5]. y is that of the row. */
void add_moments(inout float sum[15], uint at, vec4 g, vec4 w, float dy)
{
    vec4  gw  = g * w;
    float all = g.x + g.y + g.z + g.w, along = gw.x + gw.y + gw.z + gw.w;
    sum[at] += all;
    sum[at + 1u] += along;
    sum[at + 2u] = fma(dy, all, sum[at + 2u]);
    sum[at + 3u] += dot(gw, w);
    sum[at + 4u] = fma(dy, along, sum[at + 4u]);
    sum[at + 5u] = fma(dy * dy, all, sum[at + 5u]);
}

/* A quad past splat n. dL/dalpha = (light - behind / T behind the splat) T. */
void differentiate(uint n, uint quad, inout Pixels p, inout float sum[15])
{
    vec2  at     = vec2(quad_at(quad));
    vec4  before = p.t;
    Share s      = share_of(n, at, p.t);
    vec3  c      = light_of(n);
    float dy     = at.y - place_of(n).y;
    vec4  light  = p.g[0] * c.r + p.g[1] * c.g + p.g[2] * c.b;
    p.behind     = fma(-s.weight, light, p.behind);
    vec4 slope   = fma(-p.behind, 1.0 / s.next, light);
    vec4 bound   = vec4(ALPHA_MAX);
    if (SCORE) {
        slope = mix(vec4(0.0), slope * before, notEqual(s.weight, vec4(0.0)));
        slope = mix(vec4(0.0), slope, lessThan(s.value, bound));
        sum[0] += dot(slope, slope);
        return;
    }
#if LOBED
    slope = mix(vec4(0.0), slope * before, notEqual(s.weight, vec4(0.0)));
    add_moments(sum, 0u, mix(vec4(0.0), slope * s.value, lessThan(s.value, bound)), s.w, dy);
    if (lobed_of(n)) add_moments(sum, 9u, mix(vec4(0.0), -slope * s.lobe, lessThan(s.lobe, bound)), s.other_w, dy);
#else
    add_moments(sum, 0u, mix(vec4(0.0), slope * s.weight, lessThan(s.value, bound)), s.w, dy);
#endif
    for (uint ch = 0u; ch < 3u; ch++) sum[6u + ch] += dot(s.weight, p.g[ch]);
}

/* Sum k of the pair with this slot. */
void write_sum(uint slot, uint k, float sum)
{
    if (k < 4u) sums_a[4u * slot + k] = sum;
    else if (k < 8u) sums_b[4u * slot + k - 4u] = sum;
    else if (k == 8u) sums_c[slot] = sum;
    else if (LOBED == 1 && k < 13u) sums_d[4u * slot + k - 9u] = sum;
    else if (LOBED == 1) sums_e[2u * slot + k - 13u] = sum;
}

/* An invocation for each sum of EACH splats, the first of which is n. */
void gather(uint n, uint side, uint lane)
{
    uint  splat = n + lane / SUMS, k = lane % SUMS, from = ((side * EACH + lane / SUMS) * NUMBERS + k) * ROW;
    vec4  all = vec4(0.0);
    if (lane >= EACH * SUMS || batch_place[splat].z == 0u) return;
    for (uint j = 0u; j < LANES; j += 4u) all += vec4(pool[from + j], pool[from + j + 1u], pool[from + j + 2u], pool[from + j + 3u]);
    float sum = (all.x + all.y) + (all.z + all.w);
    if (SCORE) {
        float peak = own_exp2(batch_shape[splat].w);
        sum *= peak * peak;
    }
    if (k < 9u || lobed_of(splat)) write_sum(batch_light[splat].w, k, sum);
}

/* Pixels of a tile as they were before a bucket of it. */
Pixels pixels_at(uint tile, uint bucket, uint quad, bool any_pair)
{
    uvec2  at = tile_at(tile) + quad_at(quad);
    uint   plane = view.width * view.height, from = at.y * view.width + at.x;
    bool   later = bucket > 0u && any_pair;
    Pixels p;
    p.t      = later ? kept[bucket_at(tile, bucket, 192u + quad)] : quad_inside(at);
    p.behind = vec4(0.0);
    for (uint ch = 0u; ch < 3u; ch++) {
        vec4 light = vec4(0.0);
        p.g[ch]    = vec4(0.0);
        for (uint k = 0u; k < 4u && at.y < view.height && at.x + k < view.width; k++) {
            p.g[ch][k] = drgb[ch * plane + from + k];
            light[k]   = rgb[ch * plane + from + k];
        }
        if (later) light -= kept[bucket_at(tile, bucket, 64u * ch + quad)];
        p.behind = fma(p.g[ch], light, p.behind);
    }
    return p;
}

/* Splats behind the last that any pixel saw. */
void zero_sums(uint first, uint end, uint lane)
{
    for (uint pair = first + lane; pair < end; pair += LANES)
        for (uint k = 0u; k < SUMS; k++) write_sum(sorted[pair], k, 0.0);
}

uint groups_before(uint tile) { return start[tile] / (SIDES * BUCKET) + tile; }

void main()
{
    uint i = gl_LocalInvocationIndex, side = i / LANES, lane = i % LANES;
    uint group = push.begin + work_group(), tile = 0u, above = tiles();
    if (group >= push.end || group >= groups_before(above)) return;
    while (above - tile > 1u) { /* the last tile whose groups begin at this one or before */
        uint middle = (tile + above) / 2u;
        if (groups_before(middle) <= group) tile = middle;
        else above = middle;
    }
    uint bucket = SIDES * (group - groups_before(tile)), first = start[tile] + bucket * BUCKET;
    uint last = min(start[tile + 1u], first + SIDES * BUCKET), seen = start[tiles() + 1u + tile];
    uint share = first_bucket(last - min(first, last)), count = first < seen ? min(share, seen - first) : 0u;
    first += side * share;
    last     = min(last, first + share);
    uint end = clamp(seen, first, max(first, last));
    Pixels p[2];
    for (uint k = 0u; k < 2u; k++) p[k] = pixels_at(tile, bucket + side, lane + LANES * k, first < end);
    for (uint from = 0u; from < count; from += SIDE) {
        barrier(); /* the batch before is done */
        if (lane < SIDE) batch_load(side * SIDE + lane, first + from + lane, end, tile, false);
        barrier();
        for (uint n = 0u; n < min(SIDE, count - from); n += EACH) {
            for (uint each = 0u; each < EACH; each++) {
                uint  splat = side * SIDE + n + each, to = (side * EACH + each) * NUMBERS * ROW + lane;
                float sum[15];
                for (uint k = 0u; k < 15u; k++) sum[k] = 0.0;
                for (uint k = 0u; k < 2u; k++)
                    if (touches(splat, lane + LANES * k)) differentiate(splat, lane + LANES * k, p[k], sum);
                for (uint k = 0u; k < SUMS; k++) pool[to + k * ROW] = sum[k];
            }
            barrier();
            gather(side * SIDE + n, side, lane);
            barrier();
        }
    }
    zero_sums(end, last, lane);
}
