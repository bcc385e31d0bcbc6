/* transients_measure.comp - the error of each square of pixels, and the largest expected error of the points in it: the counterpart of
 * transients_error and transients_project_points in src/parts/transients.c. An invocation a square, and a point.
 */
#version 450
#extension GL_GOOGLE_include_directive : require
#include "view.glsl"
#define INFINITY_BITS view.infinity
#include "common.glsl"

layout(std430, binding = 1) readonly buffer Rgb { float rgb[]; };
layout(std430, binding = 2) readonly buffer Target { float target[]; };
layout(std430, binding = 3) readonly buffer Weight { float weight[]; };      /* VARIANT 1 */
layout(std430, binding = 4) readonly buffer Position { float position[]; };  /* (points,3) */
layout(std430, binding = 5) readonly buffer Expected { float expected[]; };
layout(std430, binding = 6) writeonly buffer Place { uint place[]; };        /* a point's square; NOWHERE */
layout(std430, binding = 7) writeonly buffer Error { float error[]; };       /* of a square; -1: all its pixels are masked, or it is not finite */
layout(std430, binding = 8) buffer SquareExpected { uint square_expected[]; }; /* bits of it + 1; 0: no point */
layout(std430, binding = 9) writeonly buffer Counts { uint counts[]; };
layout(push_constant) uniform Push { uint side, across, down, points; } push;

const uint NOWHERE = 0xFFFFFFFFu;

float error_of(uint square)
{
    uint         left = square % push.across * push.side, top = square / push.across * push.side, plane = view.width * view.height;
    uint         right = min(left + push.side, view.width), bottom = min(top + push.side, view.height);
    precise vec3 sum = vec3(0.0);
    float        count = 0.0;
    for (uint row = top; row < bottom; row++)
        for (uint column = left; column < right; column++) {
            uint  at = row * view.width + column;
            float w  = VARIANT == 1u ? weight[at] : 1.0;
            count += w;
            for (uint c = 0u; c < 3u; c++) sum[c] += w * (rgb[at + c * plane] - target[at + c * plane]);
        }
    float mean = (abs(sum.x) + abs(sum.y) + abs(sum.z)) / (3.0 * count);
    return count > 0.0 && is_finite(mean) ? mean : -1.0; /* on the CPU a NaN exceeds nothing; a device need not know */
}

/* The square that a point lies in. Pixels are compared before they become whole: outside of the image they may be any number. */
uint square_of(uint i)
{
    vec3 p = vec3(position[3u * i], position[3u * i + 1u], position[3u * i + 2u]), c;
    for (uint k = 0u; k < 3u; k++)
        c[k] = dot(vec3(view.rotation[3u * k], view.rotation[3u * k + 1u], view.rotation[3u * k + 2u]), p) + view.translation[k];
    vec2 pixel = vec2(view.fx, view.fy) * c.xy / c.z + vec2(view.cx, view.cy);
    if (!(c.z > view.near_plane && pixel.x >= 0.0 && pixel.y >= 0.0 && pixel.x < float(view.width) && pixel.y < float(view.height)))
        return NOWHERE;
    return uint(pixel.y) / push.side * push.across + uint(pixel.x) / push.side;
}

void main()
{
    uint i = work_item();
    if (i == 0u) counts[MASKED] = 0u;
    if (i < push.across * push.down) error[i] = error_of(i);
    if (i >= push.points) return;
    uint square = square_of(i);
    place[i]    = square;
    if (square != NOWHERE) atomicMax(square_expected[square], floatBitsToUint(expected[i]) + 1u); /* of numbers of 0 or more: in their order */
}
