/* lamp.comp - the lamp's gain at each pixel: exp of a polynomial in x and y (survey/imaging.h), by powers. */
#version 450
#extension GL_GOOGLE_include_directive : require

layout(std430, binding = 0) readonly buffer Powers { float powers[]; };   /* (15) coefficients: of y^j x^k, j + k <= 4, by j, then k */
layout(std430, binding = 1) writeonly buffer Lamp { float lamp[]; };      /* (H,W) */
layout(push_constant) uniform Push
{
    uint  width, height;
    float left, top, across, down; /* x and y of the first pixel, and steps */
    uint  infinity;
}
push;
#define INFINITY_BITS push.infinity
#include "common.glsl"

void main()
{
    uint  i = work_item(), at = 0u;
    float sum = 0.0, yy = 1.0;
    if (i >= push.width * push.height) return;
    float x = fma(push.across, float(i % push.width), push.left), y = fma(push.down, float(i / push.width), push.top);
    for (uint j = 0u; j <= 4u; j++, yy *= y) {
        float row = 0.0, xx = 1.0;
        for (uint k = 0u; k <= 4u - j; k++, xx *= x) row = fma(powers[at++], xx, row);
        sum = fma(row, yy, sum);
    }
    lamp[i] = own_exp(sum);
}
