/* footprint.comp - which tiles see which splat, and which of their 4 x 4 subtiles: the counterpart of src/render/bin.c. An invocation a splat, in
 * depth order.
 *
 *     VARIANT 0  how many tiles: pairs[i]
 *     VARIANT 1  the pairs, from pairs[i] on: a pair's index is its slot, and its tile the key that it is sorted by
 *
 * Both are built of the same text, but a compiler may fuse or reorder the arithmetic of one and not of the other, and division and
 * square root have no exact result in Vulkan: so `precise`, and besides the emission keeps to the slots that were counted. Slots that it
 * does not fill have the key past the last tile.
 */
#version 450
#include "common.glsl"
#include "view.glsl"

layout(std430, binding = 1) readonly buffer Counts { uint counts[]; };
layout(std430, binding = 2) readonly buffer Order { uint order[]; };
layout(std430, binding = 3) readonly buffer SplatA { vec4 splat_a[]; };
layout(std430, binding = 4) readonly buffer SplatB { vec4 splat_b[]; };
layout(std430, binding = 5) readonly buffer LobeA { vec4 lobe_a[]; };
layout(std430, binding = 6) readonly buffer LobeB { vec4 lobe_b[]; };
layout(std430, binding = 7) buffer Pairs { uint pairs[]; };                 /* (splats) VARIANT 1: first slots */
layout(std430, binding = 8) writeonly buffer Key { uint key[]; };           /* (pairs) tile */
layout(std430, binding = 9) writeonly buffer Value { uint value[]; };       /* (pairs) slot */
layout(std430, binding = 10) writeonly buffer Staged { uvec2 staged[]; };   /* (slots) row, subtiles */
layout(std430, binding = 11) writeonly buffer RowSlots { uvec2 row_slots[]; }; /* (rows) first slot, how many */
layout(push_constant) uniform Push { uint lobes, n; } push;

struct Contour {
    vec2  c;
    float a, k, e, half_x, half_y, r, extreme, slack;
};

Contour contour_of(vec2 c, vec4 shape, vec2 box) /* shape: a k e peak */
{
    precise Contour o;
    o.c       = c;
    o.a       = shape.x;
    o.k       = shape.y;
    o.e       = shape.z;
    o.half_x  = box.x;
    o.half_y  = box.y;
    o.r       = (shape.w + view.cut) * 1.0001 + 0.001;
    o.extreme = o.k * o.r / (o.e * o.half_x);
    o.slack   = 0.001 + 1e-5 * o.half_x;
    return o;
}

/* Subtiles of a subtile row that the contour meets, inclusive; none: x is large, y -1. */
ivec2 subtile_row(Contour o, int subtile_row)
{
    precise float top = float(subtile_row * 4) + 0.5 - o.c.y, bottom = top + 3.0, rightmost = float(view.width) - 0.5;
    precise float y0 = max(top, -o.half_y), y1 = min(bottom, o.half_y);
    if (!(y0 <= y1)) return ivec2(0x7FFFFFFF, -1);
    precise float yl = clamp(o.extreme, y0, y1), yr = clamp(-o.extreme, y0, y1);
    precise float left  = o.c.x - o.k * yl - sqrt(max(o.r - o.e * yl * yl, 0.0) / o.a) - o.slack;
    precise float right = o.c.x - o.k * yr + sqrt(max(o.r - o.e * yr * yr, 0.0) / o.a) + o.slack;
    if (!(right >= 0.5 && left <= rightmost)) return ivec2(0x7FFFFFFF, -1);
    precise float from = left + 0.4999, to = right - 0.5;
    int   first = from > 0.0 ? int(from) : 0, last = to < rightmost ? int(to) : int(rightmost);
    return first <= last ? ivec2(first / 4, last / 4) : ivec2(0x7FFFFFFF, -1);
}

void main()
{
    uint i = work_item();
    if (i >= counts[VISIBLE]) {
        if (VARIANT == 0u && i < push.n) pairs[i] = 0u;
        return;
    }
    uint row = order[i];
    if (VARIANT == 1u && counts[PAIRS] == 0u) { /* none, or no room */
        row_slots[row] = uvec2(0u);
        return;
    }
    uint    slot = VARIANT == 1u ? pairs[i] : 0u, first_slot = slot, end_slot = 0xFFFFFFFFu;
    if (VARIANT == 1u) end_slot = i + 1u < push.n ? pairs[i + 1u] : counts[PAIRS];
    vec4    a = splat_a[row], b = splat_b[row];
    bool    lobed = row < push.lobes;
    Contour main_ = contour_of(a.xy, vec4(a.zw, b.xy), lobed ? lobe_b[row].zw : b.zw), other = main_;
    if (lobed) other = contour_of(a.xy, lobe_a[row], lobe_b[row].xy);
    float w = float(view.width - 1u), h = float(view.height - 1u);
    int   x0 = int(clamp(a.x - b.z, 0.0, w)) / 16, x1 = int(clamp(a.x + b.z, 0.0, w)) / 16;
    int   y0 = int(clamp(a.y - b.w, 0.0, h)) / 16, y1 = int(clamp(a.y + b.w, 0.0, h)) / 16;
    for (int ty = y0; ty <= y1; ty++) {
        ivec2 span[4];
        int   first = 0x7FFFFFFF, last = -1;
        for (int r = 0; r < 4; r++) {
            span[r] = subtile_row(main_, 4 * ty + r);
            if (lobed) {
                ivec2 more = subtile_row(other, 4 * ty + r);
                span[r]    = ivec2(min(span[r].x, more.x), max(span[r].y, more.y));
            }
            first = min(first, span[r].x);
            last  = max(last, span[r].y);
        }
        first = max(first / 4, x0);
        last  = last < 0 ? -1 : min(last / 4, x1);
        for (int tx = first; tx <= last; tx++) {
            uint subtiles = 0u;
            for (int r = 0; r < 4; r++) {
                int from = max(span[r].x - 4 * tx, 0), to = min(span[r].y - 4 * tx, 3);
                if (from <= to) subtiles |= ((2u << uint(to - from)) - 1u) << uint(from + 4 * r);
            }
            if (subtiles == 0u || slot >= end_slot) continue;
            if (VARIANT == 1u) {
                key[slot]    = uint(ty) * view.tiles_x + uint(tx);
                value[slot]  = slot;
                staged[slot] = uvec2(row, subtiles);
            }
            slot++;
        }
    }
    if (VARIANT == 0u) pairs[i] = slot;
    else row_slots[row] = uvec2(first_slot, slot - first_slot);
    for (; VARIANT == 1u && slot < end_slot; slot++) {
        key[slot]    = view.tiles_x * view.tiles_y;
        value[slot]  = slot;
        staged[slot] = uvec2(row, 0u);
    }
}
