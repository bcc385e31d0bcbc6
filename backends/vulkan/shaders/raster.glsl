/* raster.glsl - what forward and backward must compute alike to the bit: a splat over four pixels of a row. The counterpart of
 * src/render/raster.c.
 *
 * An invocation has four pixels that lie side by side, a quad; a tile has 64, and four quads that follow each other are a subtile of 4 x 4.
 * So what a row of pixels shares is computed once for four, and a splat's numbers are read once. Built twice (shaders.sh), LOBED 1: rows below
 * push.lobes have a second lobe. BATCH: splats in shared memory. Both are macros, not specialization constants: some drivers size shared
 * arrays by a constant's default.
 */
layout(std430, binding = 1) buffer Start { uint start[]; }; /* (tiles + 1), then (tiles) the pair at which forward found the tile opaque */
layout(std430, binding = 2) readonly buffer Sorted { uint sorted[]; }; /* (pairs) slots, tile by tile, in depth order */
layout(std430, binding = 3) readonly buffer Staged { uvec2 staged[]; };
layout(std430, binding = 4) readonly buffer SplatA { vec4 splat_a[]; };
layout(std430, binding = 5) readonly buffer SplatB { vec4 splat_b[]; };
layout(std430, binding = 6) readonly buffer SplatC { vec4 splat_c[]; };
layout(std430, binding = 7) readonly buffer LobeA { vec4 lobe_a[]; };
layout(std430, binding = 8) buffer Rgb { float rgb[]; };  /* (3,H,W) */
layout(std430, binding = 9) buffer Kept { vec4 kept[]; }; /* (pairs / BUCKET + tiles, 4, 64) red, green, blue so far and T of quads: bucket_at */
layout(push_constant) uniform Push { uint lobes, begin, end; } push;

/* Pairs of a tile that 32 invocations take backward, at most: where they begin, forward keeps the tile's pixels. Two buckets are a workgroup's,
 * the last two of a tile are alike. */
const uint BUCKET = 128u, SIDES = 2u;

/* Bits of numbers beside whole numbers: as floats, a device may flush or change the latter. */
shared vec4  batch_shape[BATCH]; /* -a k -e peak */
shared uvec4 batch_place[BATCH]; /* bits of u v from the tile's first pixel centre; subtiles; 1: it has a second lobe */
shared uvec4 batch_light[BATCH]; /* bits of the colour; w: the pair's slot */
#if LOBED
shared vec4 batch_lobe[BATCH];
#endif

uint  tiles() { return view.tiles_x * view.tiles_y; }
uvec2 tile_at(uint tile) { return uvec2(tile % view.tiles_x, tile / view.tiles_x) * TILE; }
uvec2 quad_at(uint quad) { return uvec2(quad >> 2 & 3u, quad >> 4) * 4u + uvec2(0u, quad & 3u); }
/* Where the state before bucket `n` > 0 of a tile is kept, for a quad; that of the first one is known. */
uint bucket_at(uint tile, uint n, uint quad) { return (start[tile] / BUCKET + tile + n - 1u) * 256u + quad; }
/* Pairs of the first of two buckets, which have so many: half of them, in whole batches of a bucket (16). */
uint first_bucket(uint pairs) { return pairs >= SIDES * BUCKET ? BUCKET : (pairs + 31u) / 32u * 16u; }

/* 1 for pixels in the image, -1 for those beyond its edge. */
vec4 quad_inside(uvec2 at)
{
    return at.y < view.height ? mix(vec4(-1.0), vec4(1.0), lessThan(at.x + uvec4(0u, 1u, 2u, 3u), uvec4(view.width))) : vec4(-1.0);
}

/* Pair `pair` as splat n of the batch; one past the end touches nothing. */
void batch_load(uint n, uint pair, uint end, uint tile, bool depths)
{
    batch_place[n].z = 0u;
    if (pair >= end) return;
    uint  slot = sorted[pair];
    uvec2 from = staged[slot];
    vec4  a = splat_a[from.x], b = splat_b[from.x], c = splat_c[from.x];
    bool  lobed    = LOBED == 1 && from.x < push.lobes;
    batch_shape[n] = vec4(-a.z, a.w, -b.x, b.y);
    batch_place[n] = uvec4(floatBitsToUint(a.xy - (vec2(tile_at(tile)) + 0.5)), from.y, uint(lobed));
    batch_light[n] = uvec4(floatBitsToUint(depths ? vec3(c.w) : c.rgb), slot);
#if LOBED
    if (lobed) {
        vec4 o        = lobe_a[from.x];
        batch_lobe[n] = vec4(-o.x, o.y, -o.z, o.w);
    }
#endif
}

vec2 place_of(uint n) { return uintBitsToFloat(batch_place[n].xy); }
vec3 light_of(uint n) { return uintBitsToFloat(batch_light[n].rgb); }
bool lobed_of(uint n) { return LOBED == 1 && batch_place[n].w != 0u; }
bool touches(uint n, uint quad) { return (batch_place[n].z >> (quad >> 2) & 1u) != 0u; }

/* x + k y from the splat's centre. */
vec4 along(vec4 shape, vec2 place, vec2 quad)
{
    precise float from = fma(shape.y, quad.y - place.y, quad.x - place.x);
    precise vec4  w    = from + vec4(0.0, 1.0, 2.0, 3.0);
    return w;
}

/* GLSL's exp2: forward and backward agree by being the same instruction, and Vulkan bounds its error by 3 + 2 |x| units in the last place. */
vec4 value_of(vec4 shape, float dy, vec4 w, float least)
{
    precise float row      = fma(shape.z * dy, dy, shape.w);
    precise vec4  exponent = fma(shape.x * w, w, vec4(row));
    return mix(vec4(0.0), min(exp2(exponent), vec4(ALPHA_MAX)), greaterThanEqual(exponent, vec4(least)));
}

struct Share {
    vec4 w, value, other_w, lobe, alpha, next, weight; /* next: T behind it, if it is drawn */
};

/* t is negative where a pixel is finished: its weight is 0. */
Share share_of(uint n, vec2 quad, inout vec4 t)
{
    Share p;
    vec2  place = place_of(n);
    float dy    = quad.y - place.y;
    bool  lobed = lobed_of(n);
    p.w         = along(batch_shape[n], place, quad);
    p.value     = value_of(batch_shape[n], dy, p.w, lobed ? -120.0 : -view.cut);
    p.other_w = p.lobe = vec4(0.0);
    p.alpha            = p.value;
#if LOBED
    if (lobed) {
        p.other_w           = along(batch_lobe[n], place, quad);
        p.lobe              = value_of(batch_lobe[n], dy, p.other_w, -120.0);
        precise vec4 alpha  = p.value - p.lobe;
        vec4         room   = mix(alpha, abs(alpha), lessThan(t, vec4(TRANSMITTANCE_MAX)));
        p.alpha             = mix(vec4(0.0), alpha, greaterThanEqual(room, vec4(view.alpha_min)));
    }
#endif
    precise vec4 next = fma(-p.alpha, t, t);
    bvec4 drawn = greaterThanEqual(next, vec4(TRANSMITTANCE_MIN));
    p.next      = next;
    p.weight    = mix(vec4(0.0), t - next, drawn);
    t           = mix(-abs(t), next, drawn);
    return p;
}
