/* view.glsl - a camera as src/render/kernels.h's struct kernel_camera; the host writes it in the same order (resident.h, struct vulkan_view). */
layout(std430, set = 0, binding = 0) readonly buffer View
{
    float rotation[9], translation[3], eye[3];
    float fx, fy, cx, cy, limit_x, limit_y, near_plane;
    float background[3];
    float alpha_min, cut; /* contributions below are left out; -log2 of it */
    uint  width, height, tiles_x, tiles_y;
    uint  infinity; /* its bits: see common.glsl */
    uint  antialias;
}
view;
