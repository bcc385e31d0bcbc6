/* raster.c - splats to pixels, the pixels' gradients back to the splats, and how much each splat matters.
 *
 * A tile is 16 blocks of 4 x 4 pixels; a block is one vector of AVX-512, two of AVX2. Compositing front to back (Kerbl et al.
 * 2023, eq. 3):
 *     C = sum_i c_i alpha_i T_i + T background,   T_i = product of (1 - alpha_j), j before i.
 *
 * Backward runs in forward order, so it takes the same branches and needs no division to undo T. With g = dL/dC and the pixel's
 * whole light S = g . C known, and s the part of S up to and including splat i,
 *     dL/dalpha_i = T_i (g . c_i) - (S - s) / (1 - alpha_i).
 * A splat's score is the sum over its pixels of (o_i dS/dalpha_i)^2 ["Prune Wisely, Reconstruct Sharply", arXiv 2602.24136].
 *
 * A splat with a second lobe has alpha = min(.99, o G) - min(.99, o' G') [OceanXL eq. 3], which may be negative: then T grows. The same
 * formulas hold. Such splats have passes of their own; a tile of a scene without them runs the code that knows of none.
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
    real g[3][TILE_PIXELS];   /* dL/dC */
    real behind[TILE_PIXELS]; /* S - s: light that comes from behind the splats met so far */
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

/* Four pixels of a block's row. */
static real *raster_quad(real *blocks, int row, int quad)
{
    return blocks + (row / 4 * 4 + quad) * PACK + row % 4 * 4;
}

/* How many of the quad's pixels lie inside the image: 4, but for the quads at its right edge and past it. */
static int raster_inside(const struct raster_job *job, const struct raster_tile *tile, int row, int quad)
{
    return tile->y + row < job->height ? OXL_CLAMP(job->width - tile->x - 4 * quad, 0, 4) : 0;
}

static size_t raster_index(const struct raster_job *job, const struct raster_tile *tile, int row, int quad)
{
    return (size_t)(tile->y + row) * (size_t)job->width + (size_t)(tile->x + 4 * quad);
}

/* Copies the part of an image plane under the tile; 0 past the image's edge. */
static void raster_load(const struct raster_job *job, const struct raster_tile *tile, const real *plane, real *blocks)
{
    memset(blocks, 0, TILE_PIXELS * sizeof *blocks);
    for (int row = 0; row < TILE; row++)
        for (int quad = 0; quad < 4; quad++) {
            const int inside = raster_inside(job, tile, row, quad);
            if (inside == 4)
                memcpy(raster_quad(blocks, row, quad), plane + raster_index(job, tile, row, quad), 4 * sizeof *plane);
            else
                for (int i = 0; i < inside; i++)
                    raster_quad(blocks, row, quad)[i] = plane[raster_index(job, tile, row, quad) + (size_t)i];
        }
}

static void raster_store(const struct raster_job *job, const struct raster_tile *tile, real *blocks, real *plane)
{
    for (int row = 0; row < TILE; row++)
        for (int quad = 0; quad < 4; quad++) {
            const int inside = raster_inside(job, tile, row, quad);
            if (inside == 4)
                memcpy(plane + raster_index(job, tile, row, quad), raster_quad(blocks, row, quad), 4 * sizeof *plane);
            else
                for (int i = 0; i < inside; i++)
                    plane[raster_index(job, tile, row, quad) + (size_t)i] = raster_quad(blocks, row, quad)[i];
        }
}

/* Every pixel starts with all of the light to come; those past the image's edge have ended. */
static void raster_open(const struct raster_job *job, const struct raster_tile *tile, real *t)
{
    for (int row = 0; row < TILE; row++)
        for (int quad = 0; quad < 4; quad++) {
            const int inside = raster_inside(job, tile, row, quad);
            real     *out    = raster_quad(t, row, quad);
            for (int i = 0; i < 4; i++) out[i] = i < inside ? 1 : -1;
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

/* ---------------------------------------------------------------- a batch: some splats on the blocks that they touch
 *
 * A batch goes through in short passes: all of its exponentials, then the compositing, then (backward) the sums. One pass with all
 * of that would be a chain of 90 cycles and more a block, too long for a processor to overlap one with the next; docs/SPEED.md.
 */

#define RASTER_BATCH 8 /* pairs; between batches the blocks that have ended are dropped */
#define RASTER_ITEMS (RASTER_BATCH * TILE_BLOCKS)

struct raster_batch {
    uint32_t blocks[RASTER_BATCH];             /* of each pair: those that are alive */
    real     u[RASTER_BATCH], v[RASTER_BATCH]; /* its splat's centre from the tile's first pixel centre, px */
    real     a[RASTER_BATCH], k[RASTER_BATCH], e[RASTER_BATCH], peak[RASTER_BATCH]; /* -a, k, -e and peak of the splat */
    real     colour[RASTER_BATCH][3];
    int      items;                                 /* one block under one splat each */
    uint8_t  block[RASTER_ITEMS], of[RASTER_ITEMS]; /* their block and pair */
    real     value[RASTER_ITEMS][PACK];             /* o G, 0 below 1/255; later alpha dL/dalpha */
    real     weight[RASTER_ITEMS][PACK];            /* alpha T */
};

/* Where the pixels of each block lie in the tile. */
struct raster_grid {
    real x[TILE_BLOCKS][PACK], y[TILE_BLOCKS][PACK];
};

static void raster_grid(struct raster_grid *grid)
{
    for (int i = 0; i < TILE_PIXELS; i++) {
        grid->x[i / PACK][i % PACK] = (real)(i / PACK % 4 * 4 + i % 4);
        grid->y[i / PACK][i % PACK] = (real)(i / PACK / 4 * 4 + i % PACK / 4);
    }
}

/* Lists the items, and copies what the passes need of the splats next to each other. */
SIMD_INLINE void raster_collect(const struct raster_job *job, const struct raster_tile *tile, const struct pair *pair, int pairs,
                                uint32_t alive, struct raster_batch *batch)
{
    int n = 0;
    for (int i = 0; i < pairs; i++) {
        const struct splat *s = &job->bins->splat[pair[i].splat];
        batch->u[i]           = s->u - (tile->x + (real)0.5);
        batch->v[i]           = s->v - (tile->y + (real)0.5);
        batch->a[i] = -s->a, batch->k[i] = s->k, batch->e[i] = -s->e, batch->peak[i] = s->peak;
        for (int c = 0; c < 3; c++) batch->colour[i][c] = s->colour[c];
        batch->blocks[i] = pair[i].blocks & alive;
        for (uint32_t blocks = batch->blocks[i]; blocks; blocks &= blocks - 1) {
            batch->of[n]      = (uint8_t)i;
            batch->block[n++] = (uint8_t)simd_lowest_bit(blocks);
        }
    }
    batch->items = n;
}

/* Pass 1: the values o G of the items first..end-1. */
SIMD_INLINE void raster_evaluate(const int fused, const struct raster_grid *grid, int first, int end, struct raster_batch *batch)
{
    for (int i = first; i < end; i++) {
        const int  n = batch->of[i];
        const real u = batch->u[n], v = batch->v[n], a = batch->a[n], k = batch->k[n], e = batch->e[n], peak = batch->peak[n];
        const real *restrict x = grid->x[batch->block[i]], *restrict y = grid->y[batch->block[i]];
        real *restrict value = batch->value[i];
#pragma omp simd
        for (int l = 0; l < PACK; l++) {
            const real dy = y[l] - v, w = muladd(fused, k, dy, x[l] - u);
            const real exponent = muladd(fused, a * w, w, muladd(fused, e * dy, dy, peak)), g = real_exp2(fused, exponent);
            value[l] = exponent >= -LOG2_255 ? g : 0;
        }
    }
}

/* One pixel's share of a splat: what forward and backward must have alike to the bit. The weight alpha T is taken as the difference
 * of T, so the weights of a pixel and what is left sum to 1. */
struct raster_share {
    real alpha;  /* what was composited, if anything was */
    real weight; /* alpha T, 0 when nothing was */
    real t;      /* T afterwards */
};

SIMD_INLINE struct raster_share raster_share(const int fused, real value, real t)
{
    struct raster_share p;
    real                next, kept;
    p.alpha  = value < ALPHA_MAX ? value : ALPHA_MAX;
    next     = muladd(fused, -p.alpha, t, t);
    kept     = next >= TRANSMITTANCE_MIN ? next : t;
    p.weight = t - kept;
    p.t      = next >= TRANSMITTANCE_MIN ? next : -real_abs(t);
    return p;
}

/* Pass 2 forward: colours. */
SIMD_INLINE void raster_composite(const int fused, const struct raster_batch *batch, int first, int end,
                                  struct raster_pixels *pixels)
{
    for (int i = first; i < end; i++) {
        const int at     = batch->block[i] * PACK;
        real *restrict t = pixels->t + at, *restrict r = pixels->rgb[0] + at;
        real *restrict g = pixels->rgb[1] + at, *restrict b = pixels->rgb[2] + at;
        const real *restrict value = batch->value[i], *colour = batch->colour[batch->of[i]];
        const real red = colour[0], green = colour[1], blue = colour[2];
#pragma omp simd
        for (int l = 0; l < PACK; l++) {
            const struct raster_share p = raster_share(fused, value[l], t[l]);
            r[l]                        = muladd(fused, p.weight, red, r[l]);
            g[l]                        = muladd(fused, p.weight, green, g[l]);
            b[l]                        = muladd(fused, p.weight, blue, b[l]);
            t[l]                        = p.t;
        }
    }
}

/* Pass 2 backward: value becomes d = alpha dL/dalpha = weight (g . c) - alpha/(1 - alpha) (S - s), 0 where the clamp at ALPHA_MAX holds
 * or nothing was drawn. */
SIMD_INLINE void raster_differentiate(const int fused, struct raster_batch *batch, int first, int end, real *tile_t,
                                      struct raster_gradients *d)
{
    for (int i = first; i < end; i++) {
        const int at     = batch->block[i] * PACK;
        real *restrict t = tile_t + at, *restrict behind = d->behind + at;
        const real *restrict gr = d->g[0] + at, *restrict gg = d->g[1] + at, *restrict gb = d->g[2] + at;
        real *restrict value = batch->value[i], *restrict weight = batch->weight[i];
        const real *colour = batch->colour[batch->of[i]];
        const real  red = colour[0], green = colour[1], blue = colour[2];
#pragma omp simd
        for (int l = 0; l < PACK; l++) {
            const struct raster_share p     = raster_share(fused, value[l], t[l]);
            const real                light = muladd(fused, gr[l], red, muladd(fused, gg[l], green, gb[l] * blue)); /* g . c */
            const real                rest  = muladd(fused, -p.weight, light, behind[l]);
            const real                odds  = p.alpha / (1 - p.alpha);
            const real                slope = p.weight > 0 ? odds : 0;
            const real                whole = muladd(fused, p.weight, light, -slope * rest);
            value[l]                        = value[l] < ALPHA_MAX ? whole : 0;
            weight[l]                       = p.weight;
            behind[l]                       = rest;
            t[l]                            = p.t;
        }
    }
}

/* Pairwise, in this order on every machine. */
SIMD_INLINE real raster_add_lanes(const real *restrict lane)
{
    real half[PACK / 2], quarter[PACK / 4];
#pragma omp simd
    for (int l = 0; l < PACK / 2; l++) half[l] = lane[l] + lane[l + PACK / 2];
#pragma omp simd
    for (int l = 0; l < PACK / 4; l++) quarter[l] = half[l] + half[l + PACK / 4];
    return (quarter[0] + quarter[2]) + (quarter[1] + quarter[3]);
}

/* Pass 3 backward: the sums of pair n, whose items start at `item`; a lane each. The loop runs over bits because gcc jams the
 * iterations of a counted one together with those of the loop over the pairs, and then has no vectors. */
SIMD_INLINE int raster_sum(const int fused, const struct raster_grid *grid, const struct raster_batch *batch, int n, int item,
                           const struct raster_gradients *gradients, real *restrict out)
{
    const real u = batch->u[n], v = batch->v[n], k = batch->k[n];
    real       sums[SPLAT_SUMS][PACK];
    memset(sums, 0, sizeof sums);
    for (uint32_t blocks = batch->blocks[n]; blocks; blocks &= blocks - 1, item++) {
        const int block = simd_lowest_bit(blocks), at = block * PACK;
        const real *restrict x = grid->x[block], *restrict y = grid->y[block];
        const real *restrict g = batch->value[item], *restrict c = batch->weight[item];
        const real *restrict gr = gradients->g[0] + at, *restrict gg = gradients->g[1] + at, *restrict gb = gradients->g[2] + at;
#pragma omp simd
        for (int l = 0; l < PACK; l++) {
            const real dy = y[l] - v, w = muladd(fused, k, dy, x[l] - u), gw = g[l] * w, gy = g[l] * dy;
            sums[SUM_G][l] += g[l];
            sums[SUM_W][l] += gw;
            sums[SUM_Y][l] += gy;
            sums[SUM_WW][l]      = muladd(fused, gw, w, sums[SUM_WW][l]);
            sums[SUM_WY][l]      = muladd(fused, gw, dy, sums[SUM_WY][l]);
            sums[SUM_YY][l]      = muladd(fused, gy, dy, sums[SUM_YY][l]);
            sums[SUM_RED][l]     = muladd(fused, c[l], gr[l], sums[SUM_RED][l]);
            sums[SUM_RED + 1][l] = muladd(fused, c[l], gg[l], sums[SUM_RED + 1][l]);
            sums[SUM_RED + 2][l] = muladd(fused, c[l], gb[l], sums[SUM_RED + 2][l]);
        }
    }
    for (int sum = 0; sum < SPLAT_SUMS; sum++) out[sum] = raster_add_lanes(sums[sum]);
    return item;
}

/* Pass 2 for the score: value becomes dS/dalpha, 0 where the clamp at ALPHA_MAX holds or nothing was drawn. */
SIMD_INLINE void raster_slope(const int fused, struct raster_batch *batch, int first, int end, real *tile_t,
                              struct raster_gradients *d)
{
    for (int i = first; i < end; i++) {
        const int at     = batch->block[i] * PACK;
        real *restrict t = tile_t + at, *restrict behind = d->behind + at;
        const real *restrict gr = d->g[0] + at, *restrict gg = d->g[1] + at, *restrict gb = d->g[2] + at;
        real *restrict value = batch->value[i];
        const real *colour   = batch->colour[batch->of[i]];
        const real  red = colour[0], green = colour[1], blue = colour[2];
#pragma omp simd
        for (int l = 0; l < PACK; l++) {
            const struct raster_share p     = raster_share(fused, value[l], t[l]);
            const real                light = muladd(fused, gr[l], red, muladd(fused, gg[l], green, gb[l] * blue)); /* g . c */
            const real                rest  = muladd(fused, -p.weight, light, behind[l]);
            const real                odds  = 1 / (1 - p.alpha);
            const real                drawn = p.weight > 0 ? odds : 0;
            const real                slope = drawn * muladd(fused, p.t, light, -rest); /* p.t / (1 - alpha) is T before */
            value[l]                        = value[l] < ALPHA_MAX ? slope : 0;
            behind[l]                       = rest;
            t[l]                            = p.t;
        }
    }
}

/* Pass 3 for the score: pair n's sum of (o dS/dalpha)^2; *item moves past its items. */
SIMD_INLINE real raster_square(const int fused, const struct raster_batch *batch, int n, int *item)
{
    const real o = real_exp2(fused, batch->peak[n]);
    real       sum[PACK];
    memset(sum, 0, sizeof sum);
    for (uint32_t blocks = batch->blocks[n]; blocks; blocks &= blocks - 1, ++*item) {
        const real *restrict slope = batch->value[*item];
#pragma omp simd
        for (int l = 0; l < PACK; l++) sum[l] = muladd(fused, slope[l], slope[l], sum[l]);
    }
    return o * o * raster_add_lanes(sum);
}

/* ---------------------------------------------------------------- a batch in which some splats have a second lobe
 *
 * Its items fall into runs of one kind; each run goes through the passes above or through those here.
 */

#define RASTER_FAR ((real)-120) /* exponents below it count as o G = 0: real_exp2 ends at -126 */

struct raster_run {
    int first, end; /* items */
    int lobed;
};

struct raster_lobes {
    uint32_t          pairs;                                                                 /* bit n: pair n has a second lobe */
    real              a[RASTER_BATCH], k[RASTER_BATCH], e[RASTER_BATCH], peak[RASTER_BATCH]; /* its -a, k, -e and peak */
    int               runs;
    struct raster_run run[RASTER_BATCH];
    real              value[RASTER_ITEMS][PACK]; /* o' G'; later o' dL/do' */
};

/* Where the sums of a pair's second lobe go. */
static uint32_t raster_lobe_slot(const struct raster_job *job, const struct pair *pair)
{
    return pair->slot + job->bins->splat[pair->splat].slots;
}

/* After raster_collect. */
SIMD_INLINE void raster_collect_lobes(const struct raster_job *job, const struct pair *pair, int pairs,
                                      const struct raster_batch *batch, struct raster_lobes *lobes)
{
    int item    = 0;
    lobes->runs = 0, lobes->pairs = 0;
    for (int n = 0; n < pairs; n++) {
        const int lobed = pair[n].splat < job->bins->lobes;
        int       end   = item;
        for (uint32_t blocks = batch->blocks[n]; blocks; blocks &= blocks - 1) end++;
        if (lobed) {
            const struct lobe *s = &job->bins->lobe[pair[n].splat];
            lobes->a[n] = -s->a, lobes->k[n] = s->k, lobes->e[n] = -s->e, lobes->peak[n] = s->peak;
            lobes->pairs |= 1u << n;
        }
        if (lobes->runs > 0 && lobes->run[lobes->runs - 1].lobed == lobed) lobes->run[lobes->runs - 1].end = end;
        else lobes->run[lobes->runs++] = (struct raster_run){item, end, lobed};
        item = end;
    }
}

SIMD_INLINE void raster_evaluate_lobes(const int fused, const struct raster_grid *grid, int first, int end,
                                       struct raster_batch *batch, struct raster_lobes *lobes)
{
    for (int i = first; i < end; i++) {
        const int  n = batch->of[i];
        const real u = batch->u[n], v = batch->v[n], a = batch->a[n], k = batch->k[n], e = batch->e[n], peak = batch->peak[n];
        const real la = lobes->a[n], lk = lobes->k[n], le = lobes->e[n], lpeak = lobes->peak[n];
        const real *restrict x = grid->x[batch->block[i]], *restrict y = grid->y[batch->block[i]];
        real *restrict value = batch->value[i], *restrict lobe = lobes->value[i];
#pragma omp simd
        for (int l = 0; l < PACK; l++) {
            const real dx = x[l] - u, dy = y[l] - v, w = muladd(fused, k, dy, dx), lw = muladd(fused, lk, dy, dx);
            const real exponent = muladd(fused, a * w, w, muladd(fused, e * dy, dy, peak)), g = real_exp2(fused, exponent);
            const real lexponent = muladd(fused, la * lw, lw, muladd(fused, le * dy, dy, lpeak)),
                       lg        = real_exp2(fused, lexponent);
            value[l]             = exponent >= RASTER_FAR ? g : 0;
            lobe[l]              = lexponent >= RASTER_FAR ? lg : 0;
        }
    }
}

/* As raster_share, for alpha of either sign; the weight has alpha's. */
SIMD_INLINE struct raster_share raster_share_lobes(const int fused, real value, real lobe, real t)
{
    struct raster_share p;
    const real          plus = value < ALPHA_MAX ? value : ALPHA_MAX, minus = lobe < ALPHA_MAX ? lobe : ALPHA_MAX;
    const real          alpha = plus - minus, room = t < TRANSMITTANCE_MAX ? real_abs(alpha) : alpha;
    real                next, kept;
    p.alpha  = room >= ALPHA_MIN ? alpha : 0;
    next     = muladd(fused, -p.alpha, t, t);
    kept     = next >= TRANSMITTANCE_MIN ? next : t;
    p.weight = t - kept;
    p.t      = next >= TRANSMITTANCE_MIN ? next : -real_abs(t);
    return p;
}

SIMD_INLINE void raster_composite_lobes(const int fused, const struct raster_batch *batch, const struct raster_lobes *lobes,
                                        int first, int end, struct raster_pixels *pixels)
{
    for (int i = first; i < end; i++) {
        const int at     = batch->block[i] * PACK;
        real *restrict t = pixels->t + at, *restrict r = pixels->rgb[0] + at;
        real *restrict g = pixels->rgb[1] + at, *restrict b = pixels->rgb[2] + at;
        const real *restrict value = batch->value[i], *restrict lobe = lobes->value[i];
        const real *colour = batch->colour[batch->of[i]];
        const real  red = colour[0], green = colour[1], blue = colour[2];
#pragma omp simd
        for (int l = 0; l < PACK; l++) {
            const struct raster_share p = raster_share_lobes(fused, value[l], lobe[l], t[l]);
            r[l]                        = muladd(fused, p.weight, red, r[l]);
            g[l]                        = muladd(fused, p.weight, green, g[l]);
            b[l]                        = muladd(fused, p.weight, blue, b[l]);
            t[l]                        = p.t;
        }
    }
}

/* value and lobe become o dL/do and o' dL/do'; for the score value becomes dS/dalpha. Each is 0 where its own clamp holds, both where
 * nothing was drawn. */
SIMD_INLINE void raster_differentiate_lobes(const int fused, const int score, struct raster_batch *batch,
                                            struct raster_lobes *lobes, int first, int end, real *tile_t,
                                            struct raster_gradients *d)
{
    for (int i = first; i < end; i++) {
        const int at     = batch->block[i] * PACK;
        real *restrict t = tile_t + at, *restrict behind = d->behind + at;
        const real *restrict gr = d->g[0] + at, *restrict gg = d->g[1] + at, *restrict gb = d->g[2] + at;
        real *restrict value = batch->value[i], *restrict weight = batch->weight[i], *restrict lobe = lobes->value[i];
        const real *colour = batch->colour[batch->of[i]];
        const real  red = colour[0], green = colour[1], blue = colour[2];
#pragma omp simd
        for (int l = 0; l < PACK; l++) {
            const struct raster_share p     = raster_share_lobes(fused, value[l], lobe[l], t[l]);
            const real                light = muladd(fused, gr[l], red, muladd(fused, gg[l], green, gb[l] * blue)); /* g . c */
            const real                rest  = muladd(fused, -p.weight, light, behind[l]);
            const real                odds  = 1 / (1 - p.alpha);
            const real                drawn = real_abs(p.weight) > 0 ? odds : 0;
            const real                slope = drawn * muladd(fused, p.t, light, -rest); /* dL/dalpha */
            const real                plus = score ? slope : slope * value[l], minus = -slope * lobe[l];
            value[l]  = value[l] < ALPHA_MAX ? plus : 0;
            lobe[l]   = lobe[l] < ALPHA_MAX ? minus : 0;
            weight[l] = p.weight;
            behind[l] = rest;
            t[l]      = p.t;
        }
    }
}

/* The sums of pair n's second lobe, but for the colour's: those are the splat's. */
SIMD_INLINE void raster_sum_lobe(const int fused, const struct raster_grid *grid, const struct raster_batch *batch,
                                 const struct raster_lobes *lobes, int n, int item, real *restrict out)
{
    const real u = batch->u[n], v = batch->v[n], k = lobes->k[n];
    real       sums[SUM_RED][PACK];
    memset(sums, 0, sizeof sums);
    for (uint32_t blocks = batch->blocks[n]; blocks; blocks &= blocks - 1, item++) {
        const int block        = simd_lowest_bit(blocks);
        const real *restrict x = grid->x[block], *restrict y = grid->y[block], *restrict g = lobes->value[item];
#pragma omp simd
        for (int l = 0; l < PACK; l++) {
            const real dy = y[l] - v, w = muladd(fused, k, dy, x[l] - u), gw = g[l] * w, gy = g[l] * dy;
            sums[SUM_G][l] += g[l];
            sums[SUM_W][l] += gw;
            sums[SUM_Y][l] += gy;
            sums[SUM_WW][l] = muladd(fused, gw, w, sums[SUM_WW][l]);
            sums[SUM_WY][l] = muladd(fused, gw, dy, sums[SUM_WY][l]);
            sums[SUM_YY][l] = muladd(fused, gy, dy, sums[SUM_YY][l]);
        }
    }
    for (int sum = 0; sum < SUM_RED; sum++) out[sum] = raster_add_lanes(sums[sum]);
}

/* ---------------------------------------------------------------- one tile
 *
 * `lobed` is a constant: 0 leaves nothing of the lobes in the code.
 */

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

SIMD_INLINE void raster_pass_evaluate(const int fused, const int lobed, const struct raster_grid *grid,
                                      struct raster_batch *batch, struct raster_lobes *lobes)
{
    if (!lobed) raster_evaluate(fused, grid, 0, batch->items, batch);
    else
        for (const struct raster_run *run = lobes->run; run < lobes->run + lobes->runs; run++) {
            if (run->lobed) raster_evaluate_lobes(fused, grid, run->first, run->end, batch, lobes);
            else raster_evaluate(fused, grid, run->first, run->end, batch);
        }
}

SIMD_INLINE void raster_pass_composite(const int fused, const int lobed, const struct raster_batch *batch,
                                       const struct raster_lobes *lobes, struct raster_pixels *pixels)
{
    if (!lobed) raster_composite(fused, batch, 0, batch->items, pixels);
    else
        for (const struct raster_run *run = lobes->run; run < lobes->run + lobes->runs; run++) {
            if (run->lobed) raster_composite_lobes(fused, batch, lobes, run->first, run->end, pixels);
            else raster_composite(fused, batch, run->first, run->end, pixels);
        }
}

SIMD_INLINE void raster_forward_tile(const int fused, const int lobed, const struct raster_job *job)
{
    const struct raster_tile tile  = raster_tile(job);
    uint32_t                 alive = 0xFFFF;
    struct raster_grid       grid;
    struct raster_pixels     p;
    struct raster_batch      batch;
    struct raster_lobes      lobes;
    raster_grid(&grid);
    memset(p.rgb, 0, sizeof p.rgb);
    raster_open(job, &tile, p.t);
    for (const struct pair *pair = tile.pair; pair < tile.end && alive; pair += RASTER_BATCH) {
        const int pairs = (int)OXL_MIN(RASTER_BATCH, tile.end - pair);
        raster_collect(job, &tile, pair, pairs, alive, &batch);
        if (lobed) raster_collect_lobes(job, pair, pairs, &batch, &lobes);
        raster_pass_evaluate(fused, lobed, &grid, &batch, &lobes);
        raster_pass_composite(fused, lobed, &batch, &lobes, &p);
        alive = raster_alive(p.t);
    }
    raster_close(job, &tile, &p);
}

static void raster_open_backward(const struct raster_job *job, const struct raster_tile *tile, struct raster_gradients *d)
{
    const size_t plane = (size_t)job->width * (size_t)job->height;
    real         rgb[TILE_PIXELS];
    memset(d->behind, 0, sizeof d->behind);
    for (int ch = 0; ch < 3; ch++) {
        raster_load(job, tile, job->drgb + (size_t)ch * plane, d->g[ch]);
        raster_load(job, tile, job->rgb + (size_t)ch * plane, rgb);
        for (int i = 0; i < TILE_PIXELS; i++) d->behind[i] += d->g[ch][i] * rgb[i];
    }
}

SIMD_INLINE void raster_pass_differentiate(const int fused, const int lobed, struct raster_batch *batch,
                                           struct raster_lobes *lobes, real *t, struct raster_gradients *d)
{
    if (!lobed) raster_differentiate(fused, batch, 0, batch->items, t, d);
    else
        for (const struct raster_run *run = lobes->run; run < lobes->run + lobes->runs; run++) {
            if (run->lobed) raster_differentiate_lobes(fused, 0, batch, lobes, run->first, run->end, t, d);
            else raster_differentiate(fused, batch, run->first, run->end, t, d);
        }
}

SIMD_INLINE void raster_backward_tile(const int fused, const int lobed, const struct raster_job *job)
{
    const struct raster_tile tile  = raster_tile(job);
    const struct pair       *pair  = tile.pair;
    uint32_t                 alive = 0xFFFF;
    struct raster_grid       grid;
    real                     t[TILE_PIXELS];
    struct raster_gradients  d;
    struct raster_batch      batch;
    struct raster_lobes      lobes;
    raster_grid(&grid);
    raster_open(job, &tile, t);
    raster_open_backward(job, &tile, &d);
    for (; pair < tile.end && alive; pair += RASTER_BATCH) {
        const int pairs = (int)OXL_MIN(RASTER_BATCH, tile.end - pair);
        raster_collect(job, &tile, pair, pairs, alive, &batch);
        if (lobed) raster_collect_lobes(job, pair, pairs, &batch, &lobes);
        raster_pass_evaluate(fused, lobed, &grid, &batch, &lobes);
        raster_pass_differentiate(fused, lobed, &batch, &lobes, t, &d);
        for (int n = 0, item = 0; n < pairs; n++) {
            if (lobed && lobes.pairs >> n & 1)
                raster_sum_lobe(fused, &grid, &batch, &lobes, n, item, job->sums[raster_lobe_slot(job, &pair[n])]);
            item = raster_sum(fused, &grid, &batch, n, item, &d, job->sums[pair[n].slot]);
        }
        alive = raster_alive(t);
    }
    for (; pair < tile.end; pair++) {
        memset(job->sums[pair->slot], 0, sizeof job->sums[0]);
        if (lobed && pair->splat < job->bins->lobes) memset(job->sums[raster_lobe_slot(job, pair)], 0, sizeof job->sums[0]);
    }
}

SIMD_INLINE void raster_pass_slope(const int fused, const int lobed, struct raster_batch *batch, struct raster_lobes *lobes,
                                   real *t, struct raster_gradients *d)
{
    if (!lobed) raster_slope(fused, batch, 0, batch->items, t, d);
    else
        for (const struct raster_run *run = lobes->run; run < lobes->run + lobes->runs; run++) {
            if (run->lobed) raster_differentiate_lobes(fused, 1, batch, lobes, run->first, run->end, t, d);
            else raster_slope(fused, batch, run->first, run->end, t, d);
        }
}

SIMD_INLINE void raster_score_tile(const int fused, const int lobed, const struct raster_job *job)
{
    const struct raster_tile tile  = raster_tile(job);
    const struct pair       *pair  = tile.pair;
    uint32_t                 alive = 0xFFFF;
    struct raster_grid       grid;
    real                     t[TILE_PIXELS];
    struct raster_gradients  d;
    struct raster_batch      batch;
    struct raster_lobes      lobes;
    raster_grid(&grid);
    raster_open(job, &tile, t);
    raster_open_backward(job, &tile, &d);
    for (; pair < tile.end && alive; pair += RASTER_BATCH) {
        const int pairs = (int)OXL_MIN(RASTER_BATCH, tile.end - pair);
        raster_collect(job, &tile, pair, pairs, alive, &batch);
        if (lobed) raster_collect_lobes(job, pair, pairs, &batch, &lobes);
        raster_pass_evaluate(fused, lobed, &grid, &batch, &lobes);
        raster_pass_slope(fused, lobed, &batch, &lobes, t, &d);
        for (int n = 0, item = 0; n < pairs; n++) job->score[pair[n].slot] = raster_square(fused, &batch, n, &item);
        alive = raster_alive(t);
    }
    for (; pair < tile.end; pair++) job->score[pair->slot] = 0;
}

/* ---------------------------------------------------------------- the doors */

SIMD_BODY void raster_forward_plain_body(const int fused, const struct raster_job *job)
{
    raster_forward_tile(fused, 0, job);
}
SIMD_BODY void raster_forward_lobed_body(const int fused, const struct raster_job *job)
{
    raster_forward_tile(fused, 1, job);
}
SIMD_BODY void raster_backward_plain_body(const int fused, const struct raster_job *job)
{
    raster_backward_tile(fused, 0, job);
}
SIMD_BODY void raster_backward_lobed_body(const int fused, const struct raster_job *job)
{
    raster_backward_tile(fused, 1, job);
}
SIMD_BODY void raster_score_plain_body(const int fused, const struct raster_job *job)
{
    raster_score_tile(fused, 0, job);
}
SIMD_BODY void raster_score_lobed_body(const int fused, const struct raster_job *job)
{
    raster_score_tile(fused, 1, job);
}
SIMD_DISPATCH(static, raster_forward_plain, struct raster_job)
SIMD_DISPATCH(static, raster_forward_lobed, struct raster_job)
SIMD_DISPATCH(static, raster_backward_plain, struct raster_job)
SIMD_DISPATCH(static, raster_backward_lobed, struct raster_job)
SIMD_DISPATCH(static, raster_score_plain, struct raster_job)
SIMD_DISPATCH(static, raster_score_lobed, struct raster_job)

OXL_INTERNAL void raster_forward(int isa, const struct raster_job *job)
{
    if (job->bins->lobes) raster_forward_lobed(isa, job);
    else raster_forward_plain(isa, job);
}

OXL_INTERNAL void raster_backward(int isa, const struct raster_job *job)
{
    if (job->bins->lobes) raster_backward_lobed(isa, job);
    else raster_backward_plain(isa, job);
}

OXL_INTERNAL void raster_score(int isa, const struct raster_job *job)
{
    if (job->bins->lobes) raster_score_lobed(isa, job);
    else raster_score_plain(isa, job);
}
