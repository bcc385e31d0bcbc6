/* raster_backward.comp - the pixels' gradients back to the pairs, or (VARIANT & 2) how much each pair matters.
 *
 * In forward order, a batch at a time, in two phases. First each invocation takes its pixel past the batch's splats and leaves
 * alpha dL/dalpha and alpha T in shared memory. Then the invocations are reassigned, 256 / BATCH to a splat: each adds up some
 * of the splat's pixels, and one for each of the splat's numbers adds up what these have. So there is no atomic, and every sum has a
 * written order. A pair's sums go to its own slot.
 */
#version 450
#include "common.glsl"
#include "view.glsl"
#include "raster.glsl"
layout(std430, binding = 8) readonly buffer Rgb { float rgb[]; };
layout(std430, binding = 9) readonly buffer Drgb { float drgb[]; };
/* As numbers: a compiler may write a whole vector where one invocation sets one of its components and others set the rest. */
layout(std430, binding = 10) writeonly buffer SumsA { float sums_a[]; }; /* (slots) g times 1, w, y, w^2; of the score: x alone */
layout(std430, binding = 11) writeonly buffer SumsB { float sums_b[]; }; /* g times w y, y^2; alpha T dL/dC of red, green */
layout(std430, binding = 12) writeonly buffer SumsC { float sums_c[]; }; /* blue */
layout(std430, binding = 13) writeonly buffer SumsD { float sums_d[]; }; /* of the second lobe: as sums_a */
layout(std430, binding = 14) writeonly buffer SumsE { float sums_e[]; }; /* and w y, y^2 */

const bool SCORE = (VARIANT & 2u) != 0u;
const uint SUMS = 9u, EACH = 256u / BATCH;
/* Rows of the two layouts of `pool`, padded so that what neighbours read together lies in different banks of 32 words. */
const uint ROW   = 256u + (EACH & 31u); /* a splat's pixels */
const uint SHARE = EACH + 1u;           /* what the invocations of a splat have of one sum */
const uint POOL  = BATCH * ROW * (2u + LOBED) > SUMS * BATCH * SHARE ? BATCH * ROW * (2u + LOBED) : SUMS * BATCH * SHARE;

shared float pool[POOL];        /* (BATCH, ROW) value, then weight, then lobe; later (SUMS, BATCH, SHARE) */
shared float gradient[3 * 256]; /* dL/dC of the tile's pixels */

/* Phase 1: a pixel past splat n. */
void differentiate(uint n, uint i, vec2 pixel, vec3 g, inout float t, inout float behind)
{
    float value = 0.0, lobe = 0.0, weight = 0.0;
    if (touches(n, i >> 4) && t > 0.0) {
        Share p     = share_of(n, pixel, t);
        float light = dot(g, light_of(n)), rest = fma(-p.weight, light, behind);
        if (LOBED == 1 || SCORE) {
            float slope = p.weight != 0.0 ? fma(p.t, light, -rest) / (1.0 - p.alpha) : 0.0;
            value       = p.value < ALPHA_MAX ? (SCORE ? slope : slope * p.value) : 0.0;
            lobe        = p.lobe < ALPHA_MAX ? -slope * p.lobe : 0.0;
        } else {
            float slope = p.weight > 0.0 ? p.alpha / (1.0 - p.alpha) : 0.0;
            value       = p.value < ALPHA_MAX ? fma(p.weight, light, -slope * rest) : 0.0;
        }
        weight = p.weight;
        behind = rest;
        t      = p.t;
    }
    pool[n * ROW + i]           = value;
    pool[(BATCH + n) * ROW + i] = weight;
#if LOBED
    pool[(2u * BATCH + n) * ROW + i] = lobe;
#endif
}

/* Adds up what the invocations of splat n have of sum k. */
float gather(uint n, uint k)
{
    float sum = 0.0;
    for (uint j = 0u; j < EACH; j++) sum += pool[(k * BATCH + n) * SHARE + j];
    return sum;
}

/* Phase 2: invocation j of splat n, EACH of them a splat, adds up its pixels; then an invocation for each number of each splat adds up
 * what these have. count: splats of the batch. */
void add_up(uint i, uint count)
{
    uint  n = i / EACH, j = i % EACH, to = n * SHARE + j;
    float s[9];
    vec2  place = place_of(n);
    vec4  shape = batch_shape[n];
#if LOBED
    float o[6];
    vec4  other = batch_lobe[n];
    for (uint k = 0u; k < 6u; k++) o[k] = 0.0;
#endif
    for (uint k = 0u; k < 9u; k++) s[k] = 0.0;
    for (uint p = j; p < 256u && n < count; p += EACH) {
        if (!touches(n, p >> 4)) continue;
        vec2  pixel = vec2(pixel_at(p));
        float g = pool[n * ROW + p], c = pool[(BATCH + n) * ROW + p];
        float dy = pixel.y - place.y, w = fma(shape.y, dy, pixel.x - place.x);
        if (SCORE) {
            s[0] = fma(g, g, s[0]);
            continue;
        }
        s[0] += g;
        s[1] += g * w;
        s[2] += g * dy;
        s[3] = fma(g * w, w, s[3]);
        s[4] = fma(g * w, dy, s[4]);
        s[5] = fma(g * dy, dy, s[5]);
        s[6] = fma(c, gradient[p], s[6]);
        s[7] = fma(c, gradient[256u + p], s[7]);
        s[8] = fma(c, gradient[512u + p], s[8]);
#if LOBED
        if (lobed_of(n)) {
            float l = pool[(2u * BATCH + n) * ROW + p], v = fma(other.y, dy, pixel.x - place.x);
            o[0] += l;
            o[1] += l * v;
            o[2] += l * dy;
            o[3] = fma(l * v, v, o[3]);
            o[4] = fma(l * v, dy, o[4]);
            o[5] = fma(l * dy, dy, o[5]);
        }
#endif
    }
    /* The job of an invocation: sum k of splat m. Its slot is read before the last barrier: behind it the next batch is loaded. */
    uint  m = i % BATCH, k = i / BATCH, slot = batch_light[m].w;
    bool  job = m < count, lobed = lobed_of(m);
    float peak = SCORE ? own_exp2(batch_shape[m].w) : 0.0;
    barrier();
    for (uint q = 0u; q < (SCORE ? 1u : SUMS); q++) pool[q * BATCH * SHARE + to] = s[q];
    barrier();
    if (SCORE && job && k == 0u) sums_a[4u * slot] = peak * peak * gather(m, 0u);
    if (!SCORE && job && k < SUMS) {
        float sum = gather(m, k);
        if (k < 4u) sums_a[4u * slot + k] = sum;
        else if (k < 8u) sums_b[4u * slot + k - 4u] = sum;
        else sums_c[slot] = sum;
    }
#if LOBED
    if (SCORE) return;
    barrier();
    for (uint q = 0u; q < 6u; q++) pool[q * BATCH * SHARE + to] = o[q];
    barrier();
    if (job && lobed && k < 6u) {
        float sum = gather(m, k);
        if (k < 4u) sums_d[4u * slot + k] = sum;
        else sums_e[2u * slot + k - 4u] = sum;
    }
#endif
}

/* Splats behind the last that any pixel saw. */
void zero_sums(uint first, uint end, uint i)
{
    for (uint pair = first + i; pair < end; pair += 256u) {
        uint slot    = sorted[pair];
        for (uint k = 0u; k < 4u; k++) sums_a[4u * slot + k] = 0.0;
        if (SCORE) continue;
        for (uint k = 0u; k < 4u; k++) sums_b[4u * slot + k] = 0.0;
        sums_c[slot] = 0.0;
        for (uint k = 0u; LOBED == 1 && k < 4u; k++) sums_d[4u * slot + k] = 0.0;
        for (uint k = 0u; LOBED == 1 && k < 2u; k++) sums_e[2u * slot + k] = 0.0;
    }
}

void main()
{
    uint tile = tile_index(), i = gl_LocalInvocationIndex;
    if (!tile_is_drawn(tile)) return;
    uvec2 in_tile = pixel_at(i), at = tile_at() + in_tile;
    bool  inside = at.x < view.width && at.y < view.height;
    uint  plane = view.width * view.height, from = at.y * view.width + at.x, first = start[tile], end = start[tile + 1u];
    float t = inside ? 1.0 : -1.0, behind = 0.0;
    vec3  g = vec3(0.0);
    for (uint ch = 0u; ch < 3u && inside; ch++) {
        g[ch] = drgb[ch * plane + from];
        behind += g[ch] * rgb[ch * plane + from];
    }
    for (uint ch = 0u; ch < 3u; ch++) gradient[ch * 256u + i] = g[ch];
    alive_begin(t);
    for (uint round = 0u; first < end; first += BATCH, round++) {
        if (i < BATCH) batch_load(first, end, i, push.lobes, false);
        barrier();
        if (!alive_in(round)) break;
        uint count = min(uint(BATCH), end - first);
        for (uint n = 0u; n < count; n++) differentiate(n, i, vec2(in_tile), g, t, behind);
        alive_after(round, t);
        barrier();
        add_up(i, count);
    }
    zero_sums(first, end, i);
}
