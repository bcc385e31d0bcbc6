/* loss.glsl - L1 + SSIM as in src/render/loss.c. A workgroup is a tile of 16 x 16 pixels of one channel: first
 * all tiles of red. Its windows reach 5 pixels further. */
layout(push_constant) uniform Push
{
    uint  width, height, tiles;
    float ssim_weight;
    uint  masked;
    float red, green, blue; /* gains that the rendered image is compared with */
    float contrast; /* SSIM's C2 */
    float part;     /* of the full image's pixels, where this is a window of it */
}
push;

const uint  HALF = 5u, REACH = 26u;
const float WINDOW[11] = float[](0.00102838008447911, 0.00759875813523919, 0.03600077212843083, 0.10936068950970002,
                                 0.21300553771125370, 0.26601172486179436, 0.21300553771125370, 0.10936068950970002,
                                 0.03600077212843083, 0.00759875813523919, 0.00102838008447911);

uint loss_channel() { return work_group() / push.tiles; }
float loss_gain(uint channel) { return channel == 0u ? push.red : channel == 1u ? push.green : push.blue; }
uint loss_tile() { return work_group() % push.tiles; }

/* The tile's first pixel, less HALF. */
ivec2 reach_at()
{
    uint across = (push.width + 15u) / 16u;
    return ivec2(loss_tile() % across, loss_tile() / across) * 16 - int(HALF);
}

bool in_image(ivec2 p) { return p.x >= 0 && p.y >= 0 && p.x < int(push.width) && p.y < int(push.height); }
uint pixel_index(ivec2 p) { return uint(p.y) * push.width + uint(p.x); }
