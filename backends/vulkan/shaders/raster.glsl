/* raster.glsl - what forward and backward must compute alike to the bit: a splat over a pixel. The counterpart of src/render/raster.c.
 *
 * A workgroup is a tile, an invocation a pixel: 16 invocations that follow each other are a subtile of 4 x 4.
 * Built several times (shaders.sh): BATCH is how many splats the workgroup holds at a time; LOBED 1: rows below push.lobes have a second
 * lobe. Both are macros, not specialization constants: some drivers size shared arrays by a constant's default.
 */
layout(std430, binding = 1) readonly buffer Start { uint start[]; };   /* (tiles + 1) */
layout(std430, binding = 2) readonly buffer Sorted { uint sorted[]; }; /* (pairs) slots, tile by tile, in depth order */
layout(std430, binding = 3) readonly buffer Staged { uvec2 staged[]; };
layout(std430, binding = 4) readonly buffer SplatA { vec4 splat_a[]; };
layout(std430, binding = 5) readonly buffer SplatB { vec4 splat_b[]; };
layout(std430, binding = 6) readonly buffer SplatC { vec4 splat_c[]; };
layout(std430, binding = 7) readonly buffer LobeA { vec4 lobe_a[]; };
/* begin, end: a part of the image are the tiles whose first pair is in there. depths: 1: the depth in the place of red. */
layout(push_constant) uniform Push { uint lobes, begin, end, depths; } push;

/* Bits of numbers beside whole numbers: as floats, a device may flush or change the latter. */
shared vec4  batch_shape[BATCH]; /* -a k -e peak */
shared uvec4 batch_place[BATCH]; /* bits of u v from the tile's first pixel centre; subtiles; 1: it has a second lobe */
shared uvec4 batch_light[BATCH]; /* bits of the colour; w: the pair's slot */
#if LOBED
shared vec4 batch_lobe[BATCH];
#endif
shared uint alive[3];

uint  tile_index() { return work_group(); }
uvec2 tile_at() { return uvec2(tile_index() % view.tiles_x, tile_index() / view.tiles_x) * TILE; }

uvec2 pixel_at(uint i)
{
    uint subtile = i >> 4;
    return uvec2((subtile & 3u) * 4u + (i & 3u), (subtile >> 2) * 4u + (i >> 2 & 3u));
}

/* The n-th splat of the batch that starts at pair `first`. */
void batch_load(uint first, uint end, uint n, uint lobes, bool depths)
{
    if (first + n >= end) return;
    uint  slot = sorted[first + n];
    uvec2 pair = staged[slot];
    vec4  a = splat_a[pair.x], b = splat_b[pair.x], c = splat_c[pair.x];
    bool  lobed    = LOBED == 1 && pair.x < lobes;
    batch_shape[n] = vec4(-a.z, a.w, -b.x, b.y);
    batch_place[n] = uvec4(floatBitsToUint(a.xy - (vec2(tile_at()) + 0.5)), pair.y, uint(lobed));
    batch_light[n] = uvec4(floatBitsToUint(depths ? vec3(c.w) : c.rgb), slot);
#if LOBED
    if (lobed) {
        vec4 o        = lobe_a[pair.x];
        batch_lobe[n] = vec4(-o.x, o.y, -o.z, o.w);
    }
#endif
}

vec2 place_of(uint n) { return uintBitsToFloat(batch_place[n].xy); }
vec3 light_of(uint n) { return uintBitsToFloat(batch_light[n].rgb); }
bool lobed_of(uint n) { return LOBED == 1 && batch_place[n].w != 0u; }
bool touches(uint n, uint subtile) { return (batch_place[n].z >> subtile & 1u) != 0u; }

float value_of(vec4 shape, vec2 place, float least, vec2 pixel)
{
    precise float dy       = pixel.y - place.y;
    precise float w        = fma(shape.y, dy, pixel.x - place.x);
    precise float exponent = fma(shape.x * w, w, fma(shape.z * dy, dy, shape.w));
    float         g        = own_exp2(exponent);
    return exponent >= least ? (g < ALPHA_MAX ? g : ALPHA_MAX) : 0.0;
}

struct Share {
    float value, lobe, alpha, weight, t;
};

Share share_of(uint n, vec2 pixel, float t)
{
    Share p;
    bool  lobed = lobed_of(n);
    p.value     = value_of(batch_shape[n], place_of(n), lobed ? -120.0 : -view.cut, pixel);
    p.lobe      = 0.0;
    p.alpha     = p.value;
#if LOBED
    if (lobed) {
        p.lobe              = value_of(batch_lobe[n], place_of(n), -120.0, pixel);
        precise float alpha = p.value - p.lobe;
        float         room  = t < TRANSMITTANCE_MAX ? abs(alpha) : alpha;
        p.alpha             = room >= view.alpha_min ? alpha : 0.0;
    }
#endif
    precise float next = fma(-p.alpha, t, t);
    bool          drawn = next >= TRANSMITTANCE_MIN;
    p.weight            = t - (drawn ? next : t);
    p.t                 = drawn ? next : -abs(t);
    return p;
}

/* Whether the tile is in the image, and in the part of it that is drawn. */
bool tile_is_drawn(uint tile)
{
    return tile < view.tiles_x * view.tiles_y && start[tile] >= push.begin && start[tile] < push.end;
}

/* Whether any pixel of the tile is unfinished, without additional barriers. In round r alive[r % 3] is read after the barrier behind the
 * loading of the batch; until the next barrier unfinished pixels set the next round's, and the one after is cleared. */
void alive_begin(float t)
{
    if (gl_LocalInvocationIndex < 3u) alive[gl_LocalInvocationIndex] = 0u;
    barrier();
    if (t > 0.0) alive[0] = 1u;
}

bool alive_in(uint round) { return alive[round % 3u] != 0u; }

void alive_after(uint round, float t)
{
    if (gl_LocalInvocationIndex == 0u) alive[(round + 2u) % 3u] = 0u;
    if (t > 0.0) alive[(round + 1u) % 3u] = 1u;
}
