/* raster.c - splats to pixels, and the pixels' gradients back to the splats.
 *
 * A tile is 16 blocks of 4 x 4 pixels; a block is one vector of AVX-512, two of AVX2. Compositing front to back (Kerbl et al.
 * 2023, eq. 3):
 *     C = sum_i c_i alpha_i T_i + T background,   T_i = product of (1 - alpha_j), j before i.
 *
 * Backward runs in forward order, so it takes the same branches and needs no division to undo T. With g = dL/dC and the pixel's
 * whole light S = g . C known, and s the part of S up to and including splat i,
 *     dL/dalpha_i = T_i (g . c_i) - (S - s) / (1 - alpha_i).
 *
 * A pixel that has ended keeps its T as a negative number: any further splat then fails the test T (1 - alpha) >= 1e-4 by itself.
 *
 * Invariants: every sum has a written order, so the vector width does not show in the result. A block's sums go to the pair's own
 * slot: no atomics, and no dependence on which thread took the tile.
 */
#include "kernels.h"

struct raster_pixels { /* of a tile, block by block, 16 pixels a block */
    real t[TILE_PIXELS];
    real rgb[3][TILE_PIXELS];
};

struct raster_gradients {
    real g[3][TILE_PIXELS];      /* dL/dC */
    real behind[TILE_PIXELS];    /* S - s: light that comes from behind the splats met so far */
};

struct raster_tile {
    int                x, y; /* px of its top-left pixel */
    const struct pair *pair, *end;
};

static struct raster_tile raster_tile(const struct raster_job *job)
{
    const struct bins *b = job->bins;
    return (struct raster_tile){job->tile % b->tiles_x * TILE, job->tile / b->tiles_x * TILE, b->pair + b->tile_start[job->tile],
                                b->pair + b->tile_start[job->tile + 1]};
}

/* ---------------------------------------------------------------- between the image's rows and the tile's blocks */

/* Copies the part of an image plane under the tile; `outside` for pixels past the image's edge. */
static void raster_load(const struct raster_job *job, const struct raster_tile *tile, const real *plane, real outside, real *out)
{
    for (int i = 0; i < TILE_PIXELS; i++) {
        const int x = tile->x + (i / PACK % 4) * 4 + i % 4, y = tile->y + (i / 64) * 4 + i / 4 % 4;
        out[i] = x < job->width && y < job->height ? plane[(size_t)y * (size_t)job->width + (size_t)x] : outside;
    }
}

static void raster_store(const struct raster_job *job, const struct raster_tile *tile, const real *in, real *plane)
{
    for (int row = 0; row < TILE && tile->y + row < job->height; row++) {
        real     *out  = plane + (size_t)(tile->y + row) * (size_t)job->width + (size_t)tile->x;
        const int left = OXL_MIN(TILE, job->width - tile->x);
        for (int column = 0; column < left; column++) out[column] = in[(row / 4 * 4 + column / 4) * PACK + row % 4 * 4 + column % 4];
    }
}

/* Every pixel starts with all of the light to come; those past the image's edge have ended. */
static void raster_open(const struct raster_job *job, const struct raster_tile *tile, real *t)
{
    for (int i = 0; i < TILE_PIXELS; i++) {
        const int x = tile->x + (i / PACK % 4) * 4 + i % 4, y = tile->y + (i / 64) * 4 + i / 4 % 4;
        t[i] = x < job->width && y < job->height ? 1 : -1;
    }
}

/* Blocks with a pixel that has not ended. */
SIMD_INLINE uint32_t raster_alive(const real *t)
{
    uint32_t alive = 0;
    for (int block = 0; block < TILE_BLOCKS; block++) {
        int32_t any = 0;
#pragma omp simd reduction(| : any)
        for (int l = 0; l < PACK; l++) any |= t[block * PACK + l] > 0;
        alive |= (uint32_t)(any != 0) << block;
    }
    return alive;
}

#define RASTER_LOOK 16 /* pairs between two looks at what is alive: a look costs about as much as a block */

/* ---------------------------------------------------------------- one splat on one block */

/* What forward and backward must share to the bit. 0 where the splat is too faint, so that it leaves T and the colour as they are. */
SIMD_INLINE real raster_alpha(const int fused, const struct splat *s, real dx, real dy, real *w, real *unclamped)
{
    *w         = muladd(fused, s->k, dy, dx);
    *unclamped = real_exp2(fused, muladd(fused, -s->a * *w, *w, muladd(fused, -s->e * dy, dy, s->peak)));
    return *unclamped < ALPHA_MIN ? 0 : *unclamped < ALPHA_MAX ? *unclamped : ALPHA_MAX;
}

SIMD_INLINE void raster_block_forward(const int fused, const struct splat *s, real x, real y, real *restrict t, real *restrict r,
                                      real *restrict g, real *restrict b)
{
    const real u = s->u - x, v = s->v - y, red = s->colour[0], green = s->colour[1], blue = s->colour[2];
#pragma omp simd
    for (int l = 0; l < PACK; l++) {
        real       w, unclamped;
        const real alpha = raster_alpha(fused, s, (real)(l & 3) - u, (real)(l >> 2) - v, &w, &unclamped);
        const real old = t[l], next = muladd(fused, -alpha, old, old);
        const real weight = next >= TRANSMITTANCE_MIN ? alpha * old : 0;
        r[l]              = muladd(fused, weight, red, r[l]);
        g[l]              = muladd(fused, weight, green, g[l]);
        b[l]              = muladd(fused, weight, blue, b[l]);
        t[l]              = next >= TRANSMITTANCE_MIN ? next : -real_abs(old);
    }
}

/* sums (SPLAT_SUMS, PACK) are added to. */
SIMD_INLINE void raster_block_backward(const int fused, const struct splat *s, real x, real y, real *restrict t,
                                       const real *restrict gr, const real *restrict gg, const real *restrict gb,
                                       real *restrict behind, real (*restrict sums)[PACK])
{
    const real u = s->u - x, v = s->v - y, red = s->colour[0], green = s->colour[1], blue = s->colour[2];
#pragma omp simd
    for (int l = 0; l < PACK; l++) {
        real       w, unclamped;
        const real dy    = (real)(l >> 2) - v;
        const real alpha = raster_alpha(fused, s, (real)(l & 3) - u, dy, &w, &unclamped);
        const real old = t[l], next = muladd(fused, -alpha, old, old);
        const real weight = next >= TRANSMITTANCE_MIN ? alpha * old : 0;
        const real light  = muladd(fused, gr[l], red, muladd(fused, gg[l], green, gb[l] * blue)); /* g . c_i */
        const real rest   = muladd(fused, -weight, light, behind[l]);
        const real dalpha = muladd(fused, old, light, -rest / (1 - alpha));
        const real slope  = unclamped < ALPHA_MAX ? alpha : 0; /* d alpha/d(log alpha) */
        const real d      = next >= TRANSMITTANCE_MIN ? slope * dalpha : 0;
        const real dw = d * w, dd = d * dy;
        sums[SUM_G][l] += d;
        sums[SUM_W][l] += dw;
        sums[SUM_Y][l] += dd;
        sums[SUM_WW][l] = muladd(fused, dw, w, sums[SUM_WW][l]);
        sums[SUM_WY][l] = muladd(fused, dw, dy, sums[SUM_WY][l]);
        sums[SUM_YY][l] = muladd(fused, dd, dy, sums[SUM_YY][l]);
        sums[SUM_RED][l]   = muladd(fused, weight, gr[l], sums[SUM_RED][l]);
        sums[SUM_RED + 1][l] = muladd(fused, weight, gg[l], sums[SUM_RED + 1][l]);
        sums[SUM_RED + 2][l] = muladd(fused, weight, gb[l], sums[SUM_RED + 2][l]);
        behind[l]          = rest;
        t[l]               = next >= TRANSMITTANCE_MIN ? next : -real_abs(old);
    }
}

/* Pairwise, in this order on every machine. */
SIMD_INLINE void raster_reduce(real (*restrict sums)[PACK], real *restrict out)
{
    for (int half = PACK / 2; half > 1; half /= 2)
        for (int k = 0; k < SPLAT_SUMS; k++) {
#pragma omp simd
            for (int l = 0; l < half; l++) sums[k][l] += sums[k][l + half];
        }
    for (int k = 0; k < SPLAT_SUMS; k++) out[k] = sums[k][0] + sums[k][1];
}

/* ---------------------------------------------------------------- one tile */

static void raster_close(const struct raster_job *job, const struct raster_tile *tile, struct raster_pixels *p)
{
    const size_t plane = (size_t)job->width * (size_t)job->height;
    for (int i = 0; i < TILE_PIXELS; i++) p->t[i] = p->t[i] < 0 ? -p->t[i] : p->t[i];
    for (int ch = 0; ch < 3; ch++) {
        for (int i = 0; i < TILE_PIXELS; i++) p->rgb[ch][i] += p->t[i] * job->background[ch];
        raster_store(job, tile, p->rgb[ch], job->rgb + (size_t)ch * plane);
    }
    raster_store(job, tile, p->t, job->transmittance);
}

SIMD_BODY void raster_forward_body(const int fused, const struct raster_job *job)
{
    const struct raster_tile tile  = raster_tile(job);
    uint32_t                 alive = 0xFFFF;
    struct raster_pixels     p;
    memset(p.rgb, 0, sizeof p.rgb);
    raster_open(job, &tile, p.t);
    for (const struct pair *pair = tile.pair; pair < tile.end; pair++) {
        const struct splat *s = &job->bins->splat[pair->splat];
        if ((pair - tile.pair) % RASTER_LOOK == 0 && !(alive = raster_alive(p.t))) break;
        for (uint32_t blocks = pair->blocks & alive; blocks; blocks &= blocks - 1) {
            const int block = simd_lowest_bit(blocks), at = block * PACK;
            raster_block_forward(fused, s, tile.x + block % 4 * 4 + (real)0.5, tile.y + block / 4 * 4 + (real)0.5, p.t + at,
                                 p.rgb[0] + at, p.rgb[1] + at, p.rgb[2] + at);
        }
    }
    raster_close(job, &tile, &p);
}

static void raster_open_backward(const struct raster_job *job, const struct raster_tile *tile, struct raster_gradients *d)
{
    const size_t plane = (size_t)job->width * (size_t)job->height;
    real         rgb[TILE_PIXELS];
    memset(d->behind, 0, sizeof d->behind);
    for (int ch = 0; ch < 3; ch++) {
        raster_load(job, tile, job->drgb + (size_t)ch * plane, 0, d->g[ch]);
        raster_load(job, tile, job->rgb + (size_t)ch * plane, 0, rgb);
        for (int i = 0; i < TILE_PIXELS; i++) d->behind[i] += d->g[ch][i] * rgb[i];
    }
}

SIMD_BODY void raster_backward_body(const int fused, const struct raster_job *job)
{
    const struct raster_tile tile  = raster_tile(job);
    const struct pair       *pair  = tile.pair;
    uint32_t                 alive = 0xFFFF;
    real                     t[TILE_PIXELS];
    struct raster_gradients  d;
    raster_open(job, &tile, t);
    raster_open_backward(job, &tile, &d);
    for (; pair < tile.end; pair++) {
        const struct splat *s = &job->bins->splat[pair->splat];
        real                sums[SPLAT_SUMS][PACK];
        if ((pair - tile.pair) % RASTER_LOOK == 0 && !(alive = raster_alive(t))) break;
        memset(sums, 0, sizeof sums);
        for (uint32_t blocks = pair->blocks & alive; blocks; blocks &= blocks - 1) {
            const int block = simd_lowest_bit(blocks), at = block * PACK;
            raster_block_backward(fused, s, tile.x + block % 4 * 4 + (real)0.5, tile.y + block / 4 * 4 + (real)0.5, t + at, d.g[0] + at,
                                  d.g[1] + at, d.g[2] + at, d.behind + at, sums);
        }
        raster_reduce(sums, job->sums[pair->slot]);
    }
    for (; pair < tile.end; pair++) memset(job->sums[pair->slot], 0, sizeof job->sums[0]);
}

SIMD_DISPATCH(OXL_INTERNAL, raster_forward, struct raster_job)
SIMD_DISPATCH(OXL_INTERNAL, raster_backward, struct raster_job)
