/* counts.h - counts what the last view of a renderer was made of, for the benches. */
#ifndef OXL_BENCH_COUNTS_H
#define OXL_BENCH_COUNTS_H
#include "../src/render/renderer_state.h"

struct renderer_counts {                     /* of the last view */
    size_t visible, pairs, subtiles, pixels; /* pixels: alpha evaluations inside the image */
};

static struct renderer_counts renderer_counts(const struct renderer *r)
{
    struct renderer_counts c = {.visible = r->bins.visible_count, .pairs = r->bins.pair_count};
    for (int tile = 0; tile < r->bins.tiles_x * r->bins.tiles_y; tile++) {
        const int left = r->kernel_camera.width - tile % r->bins.tiles_x * TILE,
                  below = r->kernel_camera.height - tile / r->bins.tiles_x * TILE;
        for (uint32_t i = r->bins.tile_start[tile]; i < r->bins.tile_start[tile + 1]; i++)
            for (uint32_t subtiles = r->bins.pair[i].subtiles; subtiles; subtiles &= subtiles - 1) {
                const int subtile = simd_lowest_bit(subtiles);
                const int w = OXL_CLAMP(left - subtile % 4 * 4, 0, 4),
                          h = OXL_CLAMP(below - subtile / 4 * 4, 0, 4);
                c.subtiles++;
                c.pixels += (size_t)(w * h);
            }
    }
    return c;
}

#endif
