/* raster.comp - splats to pixels, front to back. */
#version 450
#include "common.glsl"
#include "view.glsl"
#include "raster.glsl"
layout(std430, binding = 8) writeonly buffer Rgb { float rgb[]; }; /* (3,H,W) */

void main()
{
    uint tile = tile_index(), i = gl_LocalInvocationIndex;
    if (!tile_is_drawn(tile)) return;
    uvec2 in_tile = pixel_at(i), at = tile_at() + in_tile;
    bool  inside = at.x < view.width && at.y < view.height;
    float t      = inside ? 1.0 : -1.0;
    vec3  light  = vec3(0.0);
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
        }
        alive_after(round, t);
    }
    if (!inside) return;
    uint plane = view.width * view.height, to = at.y * view.width + at.x;
    for (uint ch = 0u; ch < 3u; ch++)
        rgb[ch * plane + to] = light[ch] + (push.depths != 0u ? 0.0 : abs(t) * view.background[ch]);
}
