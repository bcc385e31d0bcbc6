/* pose.h - the gradient of the camera's pose from those of a pack. Part of project.c.
 *
 * To move the camera is to move all Gaussians the other way (MATH 18): dL/d(centre) = -sum dL/d(mean). To
 * turn it about its centre is to turn them the other way, by w: their means, as far as the image plane sees
 * them, and their axes, where q -> q + (0, w) q / 2. Colours depend on the direction of view in the world,
 * which a turn of the camera leaves as it is.
 *
 * Invariant: sums in double, in the order of rows, by task of packs.
 */
#ifndef OXL_POSE_H
#define OXL_POSE_H
#include "kernels.h"

/* colour: the part of dL/d(mean) that comes through the direction of view. */
static void pose_pack_backward(const struct project_job *job, size_t first, unsigned seen,
                               real colour[3][PACK], real mean[3][PACK])
{
    const struct vec3 eye = job->kernel_camera->eye;
    double *sum = job->pose_sum;
    for (size_t l = 0; l < PACK; l++) {
        const size_t i = first + l, to = i - job->out_row;
        const struct vec3 arm = subtract3(gaussians_vec3(&job->in, OXL_MEAN, i), eye);
        const struct vec3 force =
            vec3(mean[0][l] - colour[0][l], mean[1][l] - colour[1][l], mean[2][l] - colour[2][l]);
        const struct vec3 q = gaussians_vec3(&job->in, OXL_ROTATION + 1, i),
                          dq = gaussians_vec3(&job->out, OXL_ROTATION + 1, to);
        const struct vec3 axes = add3(
            add3(scale3(job->in.plane[OXL_ROTATION][i], dq), scale3(-job->out.plane[OXL_ROTATION][to], q)),
            cross3(q, dq));
        const struct vec3 turn = add3(cross3(arm, force), scale3((real)0.5, axes));
        if (!(seen >> l & 1)) continue;
        sum[0] += (double)turn.x, sum[1] += (double)turn.y, sum[2] += (double)turn.z;
        for (int k = 0; k < 3; k++) sum[3 + k] -= (double)mean[k][l];
    }
}

#endif
