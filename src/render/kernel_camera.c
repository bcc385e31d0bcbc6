/* kernel_camera.c - the camera as the kernels take it, on the CPU and on a device: in float, with the limits
 * of the projection. */
#include "kernels.h"

#include "../core/vecmath.h"
#include "../survey/sparse.h"

OXL_INTERNAL struct kernel_camera render_kernel_camera(const oxl_camera *c, float near_plane)
{
    struct kernel_camera k = {.width = c->width,
                              .height = c->height,
                              .half_width = 0.5f * (float)c->width,
                              .half_height = 0.5f * (float)c->height,
                              .fx = (float)c->fx,
                              .fy = (float)c->fy,
                              .cx = (float)c->cx,
                              .cy = (float)c->cy,
                              .limit_x = (float)(FRUSTUM_CLAMP * c->width / (2 * c->fx)),
                              .limit_y = (float)(FRUSTUM_CLAMP * c->height / (2 * c->fy)),
                              .near_plane = near_plane,
                              .alpha_min = ALPHA_MIN,
                              .cutoff_bits = LOG2_255};
    double eye[3];
    camera_position(c, eye);
    k.rotation.x = vec3((float)c->rotation[0], (float)c->rotation[1], (float)c->rotation[2]);
    k.rotation.y = vec3((float)c->rotation[3], (float)c->rotation[4], (float)c->rotation[5]);
    k.rotation.z = vec3((float)c->rotation[6], (float)c->rotation[7], (float)c->rotation[8]);
    k.translation = vec3((float)c->translation[0], (float)c->translation[1], (float)c->translation[2]);
    k.eye = vec3((float)eye[0], (float)eye[1], (float)eye[2]);
    return k;
}

/* images by which the camera is moved back: a point is displaced by its height / 2^21 at the image's edge */
#define CAMERA_FAR 1048576.0

OXL_INTERNAL oxl_camera render_far_camera(const oxl_camera *c, const oxl_render_options *options)
{
    oxl_camera k = *c;
    const double far = CAMERA_FAR * OXL_MAX(c->width / c->fx, c->height / c->fy);
    if (!(options->parallel > 0)) return k;
    k.fx *= far;
    k.fy *= far;
    k.translation[2] += far;
    return k;
}

OXL_INTERNAL void render_set_alpha_min(struct kernel_camera *k, float alpha_min)
{
    if (!(alpha_min > ALPHA_MIN)) return;
    k->alpha_min = OXL_MIN(alpha_min, ALPHA_MAX);
    k->cutoff_bits = (float)(-vecmath_log(k->alpha_min) * LOG2_E);
}
