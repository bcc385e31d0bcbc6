/* adam.comp - the step that follows the gradient (Kingma & Ba 2015), for the rows that the view has seen: the counterpart of src/render/adam.c.
 *
 * A row of which a number or its gradient is not finite is not stepped, counted, and not seen from then on.
 */
#version 450
#include "common.glsl"

layout(std430, binding = 0) buffer Parameter { float parameter[]; };
layout(std430, binding = 1) readonly buffer Gradient { float gradient[]; };
layout(std430, binding = 2) buffer First { float mean[]; };
layout(std430, binding = 3) buffer Second { float square[]; };
layout(std430, binding = 4) buffer Seen { uint seen[]; };
layout(std430, binding = 5) buffer Counts { uint counts[]; };        /* [slot] rows that were not stepped, [slot + 1] the first of them */
layout(std430, binding = 6) readonly buffer Rates { float rates[]; }; /* by plane, with the first moment's correction */
layout(push_constant) uniform Push { uint first, count, stride, planes, lobes, lobe_plane, slot; float beta1, beta2, inverse_correction; } push;

bool plane_is_finite(uint k, uint i)
{
    return is_finite(parameter[k * push.stride + i]) && is_finite(gradient[k * push.stride + i]);
}

void step_plane(uint k, uint i)
{
    uint  at = k * push.stride + i;
    float g  = clamp(gradient[at], -1e18, 1e18);
    float m = fma(push.beta1, mean[at], (1.0 - push.beta1) * g);
    float v = fma(push.beta2, square[at], (1.0 - push.beta2) * g * g);
    mean[at]      = m;
    square[at]    = v;
    parameter[at] = parameter[at] - rates[k] * (m / fma(sqrt(v), push.inverse_correction, 1e-15));
}

void main()
{
    uint i = work_item(), row = push.first + i;
    if (i >= push.count || seen[row] == 0u) return;
    bool finite = true, lobed = row < push.lobes;
    for (uint k = 0u; k < push.planes; k++) finite = finite && plane_is_finite(k, i);
    for (uint k = 0u; k < 4u && lobed; k++) finite = finite && plane_is_finite(push.lobe_plane + k, i);
    if (!finite) {
        seen[row] = 0u;
        atomicAdd(counts[push.slot], 1u);
        atomicMin(counts[push.slot + 1u], row);
        return;
    }
    for (uint k = 0u; k < push.planes; k++) step_plane(k, i);
    for (uint k = 0u; k < 4u && lobed; k++) step_plane(push.lobe_plane + k, i);
}
