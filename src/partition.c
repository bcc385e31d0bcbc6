/* partition.c - split the survey into blocks (OceanXL sec. 3.1, Alg. 1).
 *
 * Invariant: every place, and so every point and every Gaussian, is at home in exactly one block.
 */
#include "internal.h"

OXL_INTERNAL void partition_to_frame(const struct partition *p, const double world[3], double out[3])
{
    for (int i = 0; i < 3; i++) {
        out[i] = 0;
        for (int k = 0; k < 3; k++) out[i] += p->rotation[3 * i + k] * (world[k] - p->origin[k]);
    }
}

OXL_INTERNAL int partition_contains(const struct partition_box *box, const double frame[3])
{
    int inside = 1;
    for (int i = 0; i < 3; i++) inside &= frame[i] >= box->low[i] && frame[i] < box->high[i];
    return inside;
}
