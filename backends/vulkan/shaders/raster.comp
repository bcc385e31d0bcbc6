/* raster.comp - splats to pixels, front to back. A workgroup is a tile, an invocation a quad.
 *
 *     VARIANT 0  the image
 *     VARIANT 1  the same, and what a step's way back begins with is kept: raster_backward.comp
 *     VARIANT 2  the depth of each pixel, in two turns (raster_depth in src/render/raster.c): the first finds the layer of most weight, the
 *                second the mean of what is in it
 */
#version 450
#define GROUP 64
#define BATCH 64
#include "common.glsl"
#include "view.glsl"
#include "raster.glsl"

shared uint alive[3];

const bool  KEEPS = VARIANT == 1u, DEPTHS = VARIANT == 2u;
const float LAYER = 0.04, WEIGHT_MIN = 1.0 / 3.0, OPAQUE_MIN = 0.5;

struct Layer {
    float front, weight, offset, most, depth; /* as in struct raster_layers */
};

void layer_find(inout Layer d, float gain, float z)
{
    bool next = d.front < 0.0 || z > d.front + LAYER * d.front;
    d.front   = next ? z : d.front;
    d.offset  = next ? 0.0 : fma(gain, z - d.front, d.offset);
    d.weight  = next ? gain : d.weight + gain;
    if (d.weight > d.most) {
        d.depth = d.front + d.offset / d.weight;
        d.most  = d.weight;
    }
}

void layer_add(inout Layer d, float gain, float z)
{
    if (abs(z - d.depth) > 0.5 * LAYER * d.depth) return;
    d.weight += gain;
    d.offset = fma(gain, z - d.depth, d.offset);
}

float layer_depth(Layer d, float t)
{
    float z = d.depth + (d.weight > 0.0 ? d.offset / d.weight : 0.0);
    return 1.0 - t < OPAQUE_MIN ? 0.0 : d.weight >= WEIGHT_MIN ? z : -z;
}

/* Whether any pixel of the tile is unfinished, without additional barriers. In round r alive[r % 3] is read after the barrier behind the
 * loading of the batch; until the next barrier unfinished pixels set the next round's, and the one after is cleared. */
void alive_begin(vec4 t)
{
    if (gl_LocalInvocationIndex < 3u) alive[gl_LocalInvocationIndex] = 0u;
    barrier();
    if (any(greaterThan(t, vec4(0.0)))) alive[0] = 1u;
}

void alive_after(uint round, vec4 t)
{
    if (gl_LocalInvocationIndex == 0u) alive[(round + 2u) % 3u] = 0u;
    if (any(greaterThan(t, vec4(0.0)))) alive[(round + 1u) % 3u] = 1u;
}

/* The pixels as they are before bucket n of the tile. */
void keep(uint tile, uint n, vec4 t, vec4 light[3])
{
    for (uint ch = 0u; ch < 3u; ch++) kept[bucket_at(tile, n, 64u * ch + gl_LocalInvocationIndex)] = light[ch];
    kept[bucket_at(tile, n, 192u + gl_LocalInvocationIndex)] = t;
}

void main()
{
    uint tile = work_group(), i = gl_LocalInvocationIndex;
    if (tile >= tiles() || start[tile] < push.begin || start[tile] >= push.end) return;
    uvec2 in_tile = quad_at(i), at = tile_at(tile) + in_tile;
    vec4  t, light[3];
    Layer layer[4];
    uint  first, end = start[tile + 1u], bucket = 1u, keeps_at = start[tile] + first_bucket(end - start[tile]);
    for (uint k = 0u; k < 4u; k++) layer[k] = Layer(-1.0, 0.0, 0.0, 0.0, 0.0);
    for (uint ch = 0u; ch < 3u; ch++) light[ch] = vec4(0.0);
    for (uint turn = uint(DEPTHS); turn <= 2u * uint(DEPTHS); turn++) {
        for (uint k = 0u; k < 4u; k++) layer[k].weight = layer[k].offset = 0.0;
        t     = quad_inside(at);
        first = start[tile];
        barrier(); /* the turn before has ended */
        alive_begin(t);
        for (uint round = 0u; first < end; first += BATCH, round++) {
            barrier(); /* the batch before was drawn */
            batch_load(i, first + i, end, tile, DEPTHS);
            barrier();
            if (alive[round % 3u] == 0u) break;
            uint count = min(uint(BATCH), end - first);
            for (uint n = 0u; n < count; n++) {
                if (KEEPS && first + n == keeps_at) {
                    keep(tile, bucket++, t, light);
                    keeps_at = bucket % SIDES == 0u ? start[tile] + bucket * BUCKET : keeps_at + first_bucket(end - keeps_at);
                }
                if (!touches(n, i)) continue;
                Share p = share_of(n, vec2(in_tile), t);
                vec3  c = light_of(n);
                for (uint ch = 0u; ch < 3u; ch++) light[ch] = fma(p.weight, vec4(c[ch]), light[ch]);
                for (uint k = 0u; k < 4u && DEPTHS; k++) {
                    if (!(p.weight[k] > 0.0)) continue;
                    if (turn == 1u) layer_find(layer[k], p.weight[k], c.r);
                    else layer_add(layer[k], p.weight[k], c.r);
                }
            }
            alive_after(round, t);
        }
    }
    if (KEEPS && i == 0u) start[tiles() + 1u + tile] = min(first, end);
    uint plane = view.width * view.height, to = at.y * view.width + at.x;
    for (uint k = 0u; k < 4u && at.y < view.height && at.x + k < view.width; k++) {
        if (DEPTHS) rgb[to + k] = layer_depth(layer[k], abs(t[k]));
        for (uint ch = 0u; ch < 3u && !DEPTHS; ch++) rgb[ch * plane + to + k] = light[ch][k] + abs(t[k]) * view.background[ch];
    }
}
