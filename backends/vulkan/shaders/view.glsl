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
    float half_width, half_height; /* of the full image, where this is a window of it */
    /* a medium, read by variants that have one: src/render/medium.h */
    float attenuation[3], backscatter[3], veiling_light[3], training_range;
    /* dropout, read by variants that have it: what is added to log2 of the opacity; rows whose random number is below are left out */
    float dropout_gain;
    uint  dropout_most, dropout_low, dropout_high, dropout_step;
    uint  surroundings_shift; /* what the CPU numbers a row of the surroundings more than the device */
}
view;
