/* move.comp - rows of the model and its moments to their new places, when density control, pruning or a higher SH degree change the
 * model: an invocation a row of a new slab, for one of the old slabs. The planes that the host sends itself, below `kept`, are left
 * out of the model.
 */
#version 450
#include "common.glsl"

layout(std430, binding = 0) readonly buffer Source { uint source[]; }; /* (rows) the old row; the highest bit: its moments are 0 */
layout(std430, binding = 1) readonly buffer OldParameter { float old_parameter[]; };
layout(std430, binding = 2) readonly buffer OldFirst { float old_first[]; };
layout(std430, binding = 3) readonly buffer OldSecond { float old_second[]; };
layout(std430, binding = 4) writeonly buffer NewParameter { float new_parameter[]; };
layout(std430, binding = 5) writeonly buffer NewFirst { float new_first[]; };
layout(std430, binding = 6) writeonly buffer NewSecond { float new_second[]; };
layout(push_constant) uniform Push { uint first, count, stride, old_first, old_count, old_stride, old_lobe_plane, lobe_plane, lobes, kept; } push;

void main()
{
    uint i = work_item();
    if (i >= push.count) return;
    uint word = source[push.first + i], row = (word & 0x7FFFFFFFu) - push.old_first;
    bool fresh = word >> 31 != 0u;
    if (row >= push.old_count) return; /* of another slab */
    for (uint k = 0u; k < push.lobe_plane + (push.first + i < push.lobes ? 4u : 0u); k++) {
        bool band  = k >= push.old_lobe_plane && k < push.lobe_plane; /* that the old model has not */
        uint plane = band ? 0u : k < push.lobe_plane ? k : k - push.lobe_plane + push.old_lobe_plane;
        uint from = plane * push.old_stride + row, to = k * push.stride + i;
        if (k >= push.kept) new_parameter[to] = band ? 0.0 : old_parameter[from];
        new_first[to]  = fresh || band ? 0.0 : old_first[from];
        new_second[to] = fresh || band ? 0.0 : old_second[from];
    }
}
