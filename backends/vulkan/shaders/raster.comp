/* raster.comp - splats to pixels, front to back; or the depth of each pixel, in two turns (raster_depth in src/render/raster.c): the first finds
 * the layer of most weight, the second the mean of what is in it. */
#version 450
#include "common.glsl"
#include "view.glsl"
#include "raster.glsl"
layout(std430, binding = 8) writeonly buffer Rgb { float rgb[]; }; /* (3,H,W) */

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

void main()
{
    uint tile = tile_index(), i = gl_LocalInvocationIndex;
    if (!tile_is_drawn(tile)) return;
    uvec2 in_tile = pixel_at(i), at = tile_at() + in_tile;
    bool  inside = at.x < view.width && at.y < view.height;
    float t      = 1.0;
    vec3  light  = vec3(0.0);
    Layer layer  = Layer(-1.0, 0.0, 0.0, 0.0, 0.0);
    for (uint turn = push.depths; turn <= 2u * push.depths; turn++) {
        layer.weight = layer.offset = 0.0;
        t                           = inside ? 1.0 : -1.0;
        barrier(); /* the turn before has ended */
        alive_begin(t);
        for (uint first = start[tile], end = start[tile + 1u], round = 0u; first < end; first += BATCH, round++) {
            barrier(); /* the batch before was drawn */
            if (i < BATCH) batch_load(first, end, i, push.lobes, push.depths != 0u);
            barrier();
            if (!alive_in(round)) break;
            uint count = min(uint(BATCH), end - first);
            for (uint n = 0u; n < count; n++) {
                if (!touches(n, i >> 4) || t < 0.0) continue;
                Share p = share_of(n, vec2(in_tile), t);
                light   = fma(vec3(p.weight), light_of(n), light);
                t       = p.t;
                if (turn == 1u && p.weight > 0.0) layer_find(layer, p.weight, light_of(n).r);
                if (turn == 2u && p.weight > 0.0) layer_add(layer, p.weight, light_of(n).r);
            }
            alive_after(round, t);
        }
    }
    if (!inside) return;
    uint plane = view.width * view.height, to = at.y * view.width + at.x;
    if (push.depths != 0u) rgb[to] = layer_depth(layer, abs(t));
    for (uint ch = 0u; ch < 3u && push.depths == 0u; ch++)
        rgb[ch * plane + to] = light[ch] + abs(t) * view.background[ch];
}
