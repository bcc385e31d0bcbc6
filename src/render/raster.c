/* raster.c - splats to pixels, gradients of pixels back to splats, the depth of each pixel, and the pruning
 * score of each splat.
 *
 * A tile is 16 subtiles of 4 x 4 pixels; a subtile is one vector of AVX-512, two of AVX2. Compositing front
 * to back (Kerbl et al.
 * 2023, eq. 3):
 *     C = sum_i c_i alpha_i T_i + T background,   T_i = product of (1 - alpha_j), j before i.
 *
 * Backward runs in forward order, with the same branches and no division by (1 - alpha) to recover T. With dC
 * = dL/dC, the known total F = dC . C, and F_i the part of F up to and including splat i,
 *     dL/dalpha_i = T_i (dC . c_i) - (F - F_i) / (1 - alpha_i)      (docs/METHOD.md 10).
 * A splat's score is the sum over its pixels of (o_i dF/dalpha_i)^2 ["Prune Wisely, Reconstruct Sharply",
 * arXiv 2602.24136].
 *
 * A splat with a second lobe has alpha = min(.99, o G) - min(.99, o' G') [OceanXL eq. 3], which may be
 * negative; then T increases. The same formulas hold. Tiles of scenes without such splats run code without
 * second lobes.
 *
 * A pixel ends at the first splat with T (1 - alpha) < 1e-4. T is still reduced there, so all later splats
 * fail the test as well;
 * with second lobes, which can increase T, it is set to 0. The transmittance before the end is stored
 * separately.
 *
 * Invariants: all sums have a fixed order, independent of the vector width. A splat's sums over a tile are
 * stored in the slot of the
 * pair: no atomics, and no dependence on the thread of a tile.
 */
#include "kernels.h"

struct raster_pixels { /* of a tile, subtile by subtile, 16 pixels a subtile */
    real t[TILE_PIXELS];
    real last_t[TILE_PIXELS]; /* T after the last contributing splat */
    real rgb[3][TILE_PIXELS];
};

struct raster_gradients {
    real t[TILE_PIXELS];
    real drgb[3][TILE_PIXELS]; /* dC = dL/dC */
    real behind[TILE_PIXELS];  /* F - F_i: contribution of the splats behind */
};

struct raster_tile {
    int x, y;          /* px of its top-left pixel */
    int columns, rows; /* px inside the image: TILE, fewer at the right and lower edge */
    const struct pair *pair, *end;
};

SIMD_INLINE struct raster_tile raster_tile(const struct raster_job *job)
{
    const struct bins *b = job->bins;
    const int x = job->tile % b->tiles_x * TILE, y = job->tile / b->tiles_x * TILE;
    return (struct raster_tile){x,
                                y,
                                OXL_MIN(TILE, job->width - x),
                                OXL_MIN(TILE, job->height - y),
                                b->pair + b->tile_start[job->tile],
                                b->pair + b->tile_start[job->tile + 1]};
}

/* ---------------- between the image's rows and the tile's subtiles
 *
 * Inside the image a subtile's row of four pixels is copied as one piece.
 */

SIMD_INLINE int raster_lane(int row, int column)
{
    return (row / 4 * 4 + column / 4) * PACK + row % 4 * 4 + column % 4;
}

SIMD_INLINE int raster_is_full(const struct raster_tile *tile)
{
    return tile->columns == TILE && tile->rows == TILE;
}

/* Copies the part of an image plane under the tile; 0 past the image's edge. */
SIMD_INLINE void raster_load(const struct raster_job *job, const struct raster_tile *tile, const real *plane,
                             real *subtiles)
{
    const real *in = plane + (size_t)tile->y * job->width + tile->x;
    if (raster_is_full(tile)) {
        for (int row = 0; row < TILE; row++, in += job->width)
            for (int quad = 0; quad < TILE; quad += 4)
                memcpy(subtiles + raster_lane(row, quad), in + quad, 4 * sizeof *in);
        return;
    }
    memset(subtiles, 0, TILE_PIXELS * sizeof *subtiles);
    for (int row = 0; row < tile->rows; row++, in += job->width)
        for (int column = 0; column < tile->columns; column++)
            subtiles[raster_lane(row, column)] = in[column];
}

SIMD_INLINE void raster_store(const struct raster_job *job, const struct raster_tile *tile,
                              const real *subtiles, real *plane)
{
    real *out = plane + (size_t)tile->y * job->width + tile->x;
    if (raster_is_full(tile)) {
        for (int row = 0; row < TILE; row++, out += job->width)
            for (int quad = 0; quad < TILE; quad += 4)
                memcpy(out + quad, subtiles + raster_lane(row, quad), 4 * sizeof *out);
        return;
    }
    for (int row = 0; row < tile->rows; row++, out += job->width)
        for (int column = 0; column < tile->columns; column++)
            out[column] = subtiles[raster_lane(row, column)];
}

/* T before the first splat: 1; 0 outside the image, where pixels have ended. */
SIMD_INLINE void raster_begin(const struct raster_tile *tile, real *t)
{
    for (int i = 0; i < TILE_PIXELS; i++) t[i] = 1;
    if (raster_is_full(tile)) return;
    for (int row = 0; row < TILE; row++)
        for (int column = row < tile->rows ? tile->columns : 0; column < TILE; column++)
            t[raster_lane(row, column)] = 0;
}

/* Subtiles with a pixel that has not ended. */
SIMD_INLINE uint32_t raster_active_subtiles(const real *t)
{
    uint32_t active = 0;
    for (int subtile = 0; subtile < TILE_SUBTILES; subtile++) {
        int32_t any = 0;
#pragma omp simd reduction(| : any)
        for (int l = 0; l < PACK; l++) any |= t[subtile * PACK + l] >= TRANSMITTANCE_MIN;
        active |= (uint32_t)(any != 0) << subtile;
    }
    return active;
}

/* ---------------- a batch: some of the tile's splats
 *
 * A batch goes through subtile by subtile: a subtile's pixels stay in registers while all of the batch's
 * splats that touch it pass over them. Only the sums over a splat's pixels are taken splat by splat, in a
 * second pass over what the first one left.
 */

#define RASTER_BATCH 16 /* splats; subtiles that have ended are removed between batches */

struct raster_splat {   /* inputs of the passes, contiguous */
    real u, v;          /* centre from the tile's first pixel centre, px */
    real a, k, e, peak; /* -a, k, -e and peak of the splat or of its second lobe */
    real colour[3];
    real padding[7]; /* to a power of two, so that indexing is a shift */
};

struct raster_batch {
    /* positions of a subtile's pixels in the tile, by its column and its row of subtiles */
    real x[4][PACK], y[4][PACK];
    const struct pair *pair;
    int count;
    real alpha_min, log2_alpha_min; /* smallest contribution, and its log2 */
    /* second: of those that have a second lobe */
    struct raster_splat splat[RASTER_BATCH], second[RASTER_BATCH];
    uint32_t lobed; /* bit n: splat n has one */
    /* by splat: its subtiles that have not ended */
    uint32_t subtiles[RASTER_BATCH];
    uint32_t splats[TILE_SUBTILES]; /* by subtile: the splats on it */
    /* by splat, subtile and pixel, written by raster_differentiate: */
    /* alpha dL/dalpha = dL/d(log alpha); for the score dF/dalpha */
    real dlog_alpha[RASTER_BATCH][TILE_SUBTILES][PACK];
    real dlog_lobe[RASTER_BATCH][TILE_SUBTILES][PACK]; /* o' dL/do' = dL/d(log o') of the second lobe */
    real weight[RASTER_BATCH][TILE_SUBTILES][PACK];    /* alpha T */
};

/* The next splats of the tile, and which subtiles each of them covers. lobed: constant 0 or 1; 0 removes the
 * code of lobes. */
SIMD_INLINE void raster_load_batch(const int lobed, const struct raster_job *job,
                                   const struct raster_tile *tile, const struct pair *pair, uint32_t active,
                                   struct raster_batch *batch)
{
    batch->pair = pair;
    batch->count = (int)OXL_MIN(RASTER_BATCH, tile->end - pair);
    batch->alpha_min = job->bins->alpha_min;
    batch->log2_alpha_min = -job->bins->cutoff_bits;
    batch->lobed = 0;
    memset(batch->splats, 0, sizeof batch->splats);
    for (int n = 0; n < batch->count; n++) {
        const struct splat *s = &job->bins->splat[pair[n].splat];
        const uint32_t subtiles = pair[n].subtiles & active;
        const struct lobe *o = lobed ? bins_lobe(job->bins, pair[n].splat) : NULL;
        batch->splat[n] = (struct raster_splat){.u = s->u - (tile->x + (real)0.5),
                                                .v = s->v - (tile->y + (real)0.5),
                                                .a = -s->a,
                                                .k = s->k,
                                                .e = -s->e,
                                                .peak = s->peak,
                                                .colour = {s->colour[0], s->colour[1], s->colour[2]}};
        batch->subtiles[n] = subtiles;
#pragma omp simd
        for (int subtile = 0; subtile < TILE_SUBTILES; subtile++)
            batch->splats[subtile] |= (subtiles >> subtile & 1) << n;
        if (o) {
            batch->lobed |= 1u << n;
            batch->second[n] = batch->splat[n];
            batch->second[n].a = -o->a, batch->second[n].k = o->k, batch->second[n].e = -o->e,
            batch->second[n].peak = o->peak;
        }
    }
}

/* Whether splat n of the batch has a second lobe. */
SIMD_INLINE int raster_lobed(const int lobed, const struct raster_batch *batch, int n)
{
    return lobed && batch->lobed >> n & 1;
}

/* Sets what all batches of a tile share. */
SIMD_INLINE void raster_begin_batches(struct raster_batch *batch)
{
    for (int k = 0; k < 4; k++)
        for (int l = 0; l < PACK; l++)
            batch->x[k][l] = (real)(4 * k + l % 4), batch->y[k][l] = (real)(4 * k + l / 4);
}

/* ---------------- a pixel under a splat */

#define RASTER_FAR ((real)-120) /* exponents of lobes below it count as o G = 0: real_exp2 ends at -126 */

/* o G at (x, y), at most ALPHA_MAX, and 0 where it is below 2^log2_min. */
SIMD_INLINE real raster_lobe_alpha(const int fused, const struct raster_splat *s, real log2_min, real x,
                                   real y)
{
    const real dy = y - s->v, w = muladd(fused, s->k, dy, x - s->u);
    const real exponent = muladd(fused, s->a * w, w, muladd(fused, s->e * dy, dy, s->peak));
    const real alpha = real_least(real_exp2(fused, exponent), ALPHA_MAX);
    return exponent >= log2_min ? alpha : 0;
}

/* Shared by forward and backward, for equal bits. The weight alpha T is computed as a difference of T, so the
 * weights of a pixel and its final T sum to 1. With a second lobe alpha and weight may be negative. */
struct raster_contribution {
    real first, second; /* alpha of each lobe, see raster_lobe_alpha */
    real alpha;         /* first - second */
    real t;             /* T afterwards */
    int contributes;    /* 0: the pixel had ended, or ends here */
    real weight;        /* alpha T, 0 unless contributes */
};

/* lobed: the splat has a second lobe. mixed: a splat of the tile may have one. Both 0 or 1, constants. */
SIMD_INLINE struct raster_contribution raster_contribution(const int fused, const int mixed, const int lobed,
                                                           const struct raster_batch *batch, int n, real x,
                                                           real y, real t)
{
    struct raster_contribution p;
    real next;
    p.first = raster_lobe_alpha(fused, &batch->splat[n], lobed ? RASTER_FAR : batch->log2_alpha_min, x, y);
    p.second = lobed ? raster_lobe_alpha(fused, &batch->second[n], RASTER_FAR, x, y) : 0;
    p.alpha = p.first;
    if (lobed) {
        const real alpha = p.first - p.second, magnitude = t < TRANSMITTANCE_MAX ? real_abs(alpha) : alpha;
        p.alpha = magnitude >= batch->alpha_min ? alpha : 0;
    }
    next = muladd(fused, p.alpha, -t, t);
    p.contributes = next >= TRANSMITTANCE_MIN;
    p.weight = p.contributes ? t - next : 0;
    p.t = mixed && !p.contributes ? 0 : next;
    return p;
}

/* Keeps the T of ended pixels normal: a batch reduces it by a factor of at most 100^RASTER_BATCH. */
SIMD_INLINE real raster_keep_normal(real t)
{
    return t >= TRANSMITTANCE_MIN ? t : 0;
}

/* ---------------- forward */

struct raster_subtile_state { /* a subtile's pixels */
    real t[PACK], last_t[PACK], r[PACK], g[PACK], b[PACK];
};

/* A splat over the 16 pixels of a subtile, front to back: C += c alpha T, T *= 1 - alpha. */
SIMD_INLINE void raster_composite(const int fused, const int mixed, const int lobed,
                                  const struct raster_batch *batch, int n, int subtile,
                                  struct raster_subtile_state *out)
{
    const real *restrict x = batch->x[subtile % 4], *restrict y = batch->y[subtile / 4];
    const real *colour = batch->splat[n].colour;
    const real red = colour[0], green = colour[1], blue = colour[2];
#pragma omp simd
    for (int l = 0; l < PACK; l++) {
        const struct raster_contribution p =
            raster_contribution(fused, mixed, lobed, batch, n, x[l], y[l], out->t[l]);
        out->last_t[l] = p.contributes ? p.t : out->last_t[l];
        out->r[l] = muladd(fused, p.weight, red, out->r[l]);
        out->g[l] = muladd(fused, p.weight, green, out->g[l]);
        out->b[l] = muladd(fused, p.weight, blue, out->b[l]);
        out->t[l] = p.t;
    }
}

SIMD_INLINE void raster_composite_subtile(const int fused, const int lobed, const struct raster_batch *batch,
                                          int subtile, struct raster_pixels *pixels)
{
    const int at = subtile * PACK;
    struct raster_subtile_state state;
#pragma omp simd
    for (int l = 0; l < PACK; l++) {
        state.t[l] = raster_keep_normal(pixels->t[at + l]);
        state.last_t[l] = pixels->last_t[at + l];
        state.r[l] = pixels->rgb[0][at + l];
        state.g[l] = pixels->rgb[1][at + l];
        state.b[l] = pixels->rgb[2][at + l];
    }
    for (uint32_t splats = batch->splats[subtile]; splats; splats &= splats - 1) {
        const int n = simd_lowest_bit(splats);
        if (raster_lobed(lobed, batch, n)) raster_composite(fused, 1, 1, batch, n, subtile, &state);
        else raster_composite(fused, lobed, 0, batch, n, subtile, &state);
    }
#pragma omp simd
    for (int l = 0; l < PACK; l++) {
        pixels->t[at + l] = state.t[l];
        pixels->last_t[at + l] = state.last_t[l];
        pixels->rgb[0][at + l] = state.r[l];
        pixels->rgb[1][at + l] = state.g[l];
        pixels->rgb[2][at + l] = state.b[l];
    }
}

/* Adds the background, and stores the tile. */
SIMD_INLINE void raster_finish(const struct raster_job *job, const struct raster_tile *tile,
                               struct raster_pixels *p)
{
    const size_t plane = (size_t)job->width * job->height;
    for (int ch = 0; ch < 3; ch++) {
        for (int i = 0; i < TILE_PIXELS; i++) p->rgb[ch][i] += p->last_t[i] * job->background[ch];
        raster_store(job, tile, p->rgb[ch], job->rgb + (size_t)ch * plane);
    }
    raster_store(job, tile, p->last_t, job->transmittance);
}

SIMD_INLINE void raster_forward_tile(const int fused, const int lobed, const struct raster_job *job)
{
    const struct raster_tile tile = raster_tile(job);
    uint32_t active = 0xFFFF;
    struct raster_pixels p;
    struct raster_batch batch;
    memset(p.rgb, 0, sizeof p.rgb);
    raster_begin(&tile, p.t);
    raster_begin_batches(&batch);
    for (int i = 0; i < TILE_PIXELS; i++) p.last_t[i] = 1;
    for (const struct pair *pair = tile.pair; pair < tile.end && active; pair += RASTER_BATCH) {
        raster_load_batch(lobed, job, &tile, pair, active, &batch);
        for (int subtile = 0; subtile < TILE_SUBTILES; subtile++)
            if (batch.splats[subtile]) raster_composite_subtile(fused, lobed, &batch, subtile, &p);
        if (tile.end - pair > RASTER_BATCH) active = raster_active_subtiles(p.t);
    }
    raster_finish(job, &tile, &p);
}

/* ---------------- backward and score, a subtile at a time
 *
 * score: 0 or 1, a constant.
 */

struct raster_subtile_gradients { /* a subtile's pixels, as in struct raster_gradients */
    real t[PACK], dr[PACK], dg[PACK], db[PACK], behind[PACK];
};

/* Gradient of raster_composite. Writes, for each pixel:
 *   dlog_alpha   alpha dL/dalpha = weight (dC . c) - alpha / (1 - alpha) (F - F_i); with a second lobe
 *   o dL/do; for the score dF/dalpha
 *   dlog_lobe    o' dL/do', with a second lobe only
 *   weight       alpha T, which times dC is dL/dc; not for the score
 * All are 0 without a contribution. dlog_alpha and dlog_lobe are also 0 where the clamp at ALPHA_MAX holds
 * for their own lobe. */
SIMD_INLINE void raster_differentiate(const int fused, const int mixed, const int lobed, const int score,
                                      struct raster_batch *batch, int n, int subtile,
                                      struct raster_subtile_gradients *d)
{
    const real *restrict x = batch->x[subtile % 4], *restrict y = batch->y[subtile / 4];
    const real *colour = batch->splat[n].colour;
    const real red = colour[0], green = colour[1], blue = colour[2];
    real *restrict dlog_alpha = batch->dlog_alpha[n][subtile], *restrict dlog_lobe =
                                                                   batch->dlog_lobe[n][subtile];
    real *restrict weight = batch->weight[n][subtile];
#pragma omp simd
    for (int l = 0; l < PACK; l++) {
        const struct raster_contribution p =
            raster_contribution(fused, mixed, lobed, batch, n, x[l], y[l], d->t[l]);
        /* dC . c */
        const real light = muladd(fused, d->dr[l], red, muladd(fused, d->dg[l], green, d->db[l] * blue));
        const real rest = muladd(fused, -p.weight, light, d->behind[l]);
        if (lobed || score) {
            const real inverse = 1 / (1 - p.alpha), contributes = real_abs(p.weight) > 0 ? inverse : 0;
            /* p.t / (1 - alpha) is T before */
            const real dalpha = contributes * muladd(fused, p.t, light, -rest);
            const real dfirst = score ? dalpha : dalpha * p.first, dsecond = -dalpha * p.second;
            dlog_alpha[l] = p.first < ALPHA_MAX ? dfirst : 0;
            if (lobed) dlog_lobe[l] = p.second < ALPHA_MAX ? dsecond : 0;
        } else {
            const real dfirst = muladd(fused, p.weight, light, -(p.alpha / (1 - p.alpha) * rest));
            const real unclamped = p.first < ALPHA_MAX ? dfirst : 0;
            dlog_alpha[l] = p.contributes ? unclamped : 0;
        }
        if (!score) weight[l] = p.weight;
        d->behind[l] = rest;
        d->t[l] = p.t;
    }
}

SIMD_INLINE void raster_differentiate_subtile(const int fused, const int lobed, const int score,
                                              struct raster_batch *batch, int subtile,
                                              struct raster_gradients *tile)
{
    const int at = subtile * PACK;
    struct raster_subtile_gradients d;
#pragma omp simd
    for (int l = 0; l < PACK; l++) {
        d.t[l] = raster_keep_normal(tile->t[at + l]);
        d.dr[l] = tile->drgb[0][at + l];
        d.dg[l] = tile->drgb[1][at + l];
        d.db[l] = tile->drgb[2][at + l];
        d.behind[l] = tile->behind[at + l];
    }
    for (uint32_t splats = batch->splats[subtile]; splats; splats &= splats - 1) {
        const int n = simd_lowest_bit(splats);
        if (raster_lobed(lobed, batch, n)) raster_differentiate(fused, 1, 1, score, batch, n, subtile, &d);
        else raster_differentiate(fused, lobed, 0, score, batch, n, subtile, &d);
    }
#pragma omp simd
    for (int l = 0; l < PACK; l++) {
        tile->t[at + l] = d.t[l];
        tile->behind[at + l] = d.behind[l];
    }
}

/* ---------------- backward and score, the sums of a splat
 *
 * A lane each over the splat's subtiles, then over the lanes.
 */

/* Pairwise, in this order on every machine. */
SIMD_INLINE void raster_add_lanes(const int count, const real lane[][PACK], real *restrict out)
{
    real half[SPLAT_SUMS][PACK / 2], quarter[SPLAT_SUMS][PACK / 4];
    for (int sum = 0; sum < count; sum++) {
#pragma omp simd
        for (int l = 0; l < PACK / 2; l++) half[sum][l] = lane[sum][l] + lane[sum][l + PACK / 2];
    }
    for (int sum = 0; sum < count; sum++) {
#pragma omp simd
        for (int l = 0; l < PACK / 4; l++) quarter[sum][l] = half[sum][l] + half[sum][l + PACK / 4];
    }
#pragma omp simd
    for (int sum = 0; sum < count; sum++)
        out[sum] = (quarter[sum][0] + quarter[sum][2]) + (quarter[sum][1] + quarter[sum][3]);
}

/* MATH 11: d, d w, d dy... summed. lobe: 1: sums of the second lobe, without the colour's, which belong to
 * the splat. */
SIMD_INLINE void raster_sum(const int fused, const int lobe, const struct raster_batch *batch, int n,
                            const struct raster_gradients *gradients, real *restrict out)
{
    const struct raster_splat *s = lobe ? &batch->second[n] : &batch->splat[n];
    const real u = s->u, v = s->v, k = s->k;
    uint32_t subtiles = batch->subtiles[n];
    real sums[SPLAT_SUMS][PACK] = {{0}};
    if (!subtiles) {
        memset(out, 0, (lobe ? SUM_RED : SPLAT_SUMS) * sizeof *out);
        return;
    }
    for (; subtiles; subtiles &= subtiles - 1) {
        const int subtile = simd_lowest_bit(subtiles), at = subtile * PACK;
        const real *restrict x = batch->x[subtile % 4], *restrict y = batch->y[subtile / 4];
        const real *restrict d = lobe ? batch->dlog_lobe[n][subtile] : batch->dlog_alpha[n][subtile];
        const real *restrict weight = batch->weight[n][subtile], *restrict dr = gradients->drgb[0] + at;
        const real *restrict dg = gradients->drgb[1] + at, *restrict db = gradients->drgb[2] + at;
#pragma omp simd
        for (int l = 0; l < PACK; l++) {
            const real dy = y[l] - v, w = muladd(fused, k, dy, x[l] - u), d_by_w = d[l] * w,
                       d_by_dy = d[l] * dy;
            sums[SUM_D][l] += d[l];
            sums[SUM_W][l] += d_by_w;
            sums[SUM_Y][l] += d_by_dy;
            sums[SUM_WW][l] = muladd(fused, d_by_w, w, sums[SUM_WW][l]);
            sums[SUM_WY][l] = muladd(fused, d_by_w, dy, sums[SUM_WY][l]);
            sums[SUM_YY][l] = muladd(fused, d_by_dy, dy, sums[SUM_YY][l]);
            if (!lobe) {
                sums[SUM_RED][l] = muladd(fused, weight[l], dr[l], sums[SUM_RED][l]);
                sums[SUM_RED + 1][l] = muladd(fused, weight[l], dg[l], sums[SUM_RED + 1][l]);
                sums[SUM_RED + 2][l] = muladd(fused, weight[l], db[l], sums[SUM_RED + 2][l]);
            }
        }
    }
    raster_add_lanes(lobe ? SUM_RED : SPLAT_SUMS, (const real(*)[PACK])sums, out);
}

/* The sum of (o dF/dalpha)^2. */
SIMD_INLINE real raster_sum_squares(const int fused, const struct raster_batch *batch, int n)
{
    const real o = real_exp2(fused, batch->splat[n].peak);
    real sum[1][PACK] = {{0}}, whole;
    for (uint32_t subtiles = batch->subtiles[n]; subtiles; subtiles &= subtiles - 1) {
        const real *restrict dalpha = batch->dlog_alpha[n][simd_lowest_bit(subtiles)]; /* for the score */
#pragma omp simd
        for (int l = 0; l < PACK; l++) sum[0][l] = muladd(fused, dalpha[l], dalpha[l], sum[0][l]);
    }
    raster_add_lanes(1, (const real(*)[PACK])sum, &whole);
    return o * o * whole;
}

/* ---------------- backward and score, a tile */

/* Slot of the sums of a pair's second lobe. */
SIMD_INLINE uint32_t raster_lobe_slot(const struct raster_job *job, const struct pair *pair)
{
    return pair->slot + job->bins->splat[pair->splat].slots;
}

SIMD_INLINE void raster_begin_backward(const struct raster_job *job, const struct raster_tile *tile,
                                       struct raster_gradients *d)
{
    const size_t plane = (size_t)job->width * job->height;
    real rgb[TILE_PIXELS];
    raster_begin(tile, d->t);
    memset(d->behind, 0, sizeof d->behind);
    for (int ch = 0; ch < 3; ch++) {
        raster_load(job, tile, job->drgb + (size_t)ch * plane, d->drgb[ch]);
        raster_load(job, tile, job->rgb + (size_t)ch * plane, rgb);
        for (int i = 0; i < TILE_PIXELS; i++) {
            d->behind[i] += d->drgb[ch][i] * rgb[i];
        }
    }
}

/* Stores the sums of splat n of the batch in its slot. */
SIMD_INLINE void raster_store_sums(const int fused, const int lobed, const int score,
                                   const struct raster_job *job, const struct raster_batch *batch, int n,
                                   const struct raster_gradients *d)
{
    const struct pair *pair = &batch->pair[n];
    if (score) {
        job->score[pair->slot] = raster_sum_squares(fused, batch, n);
        return;
    }
    raster_sum(fused, 0, batch, n, d, job->sums[pair->slot]);
    if (lobed && batch->lobed >> n & 1)
        raster_sum(fused, 1, batch, n, d, job->sums[raster_lobe_slot(job, pair)]);
}

/* The same for a splat behind the last one that contributes to any pixel. */
SIMD_INLINE void raster_zero_sums(const int lobed, const int score, const struct raster_job *job,
                                  const struct pair *pair)
{
    if (score) job->score[pair->slot] = 0;
    else memset(job->sums[pair->slot], 0, sizeof job->sums[0]);
    if (!score && lobed && bins_lobe(job->bins, pair->splat))
        memset(job->sums[raster_lobe_slot(job, pair)], 0, sizeof job->sums[0]);
}

SIMD_INLINE void raster_backward_tile(const int fused, const int lobed, const int score,
                                      const struct raster_job *job)
{
    const struct raster_tile tile = raster_tile(job);
    const struct pair *pair = tile.pair;
    uint32_t active = 0xFFFF;
    struct raster_gradients d;
    struct raster_batch batch;
    raster_begin_backward(job, &tile, &d);
    raster_begin_batches(&batch);
    for (; pair < tile.end && active; pair += RASTER_BATCH) {
        raster_load_batch(lobed, job, &tile, pair, active, &batch);
        for (int subtile = 0; subtile < TILE_SUBTILES; subtile++)
            if (batch.splats[subtile]) raster_differentiate_subtile(fused, lobed, score, &batch, subtile, &d);
        for (int n = 0; n < batch.count; n++) raster_store_sums(fused, lobed, score, job, &batch, n, &d);
        if (tile.end - pair > RASTER_BATCH) active = raster_active_subtiles(d.t);
    }
    for (; pair < tile.end; pair++) raster_zero_sums(lobed, score, job, pair);
}

/* ---------------- depth
 *
 * A pixel's depth is that of its surface: of the layer with the most weight, a layer being the splats within
 * DEPTH_LAYER of the first one's depth. The mean over all splats goes through veils, and their median falls
 * behind a surface that is thin in places (docs/log/TRAINING.md). The first pass finds the layer, the second
 * the mean of the splats within half a layer of its depth.
 */

struct raster_layers { /* of a subtile's pixels */
    real t[PACK];
    real front[PACK];                /* depth of the layer's first splat; -1: none yet */
    real weight[PACK], offset[PACK]; /* its sums of weight, and of weight (z - front) */
    /* weight of the heaviest layer so far, depth of its first splat, sum of weight (z - depth) */
    real most[PACK], depth[PACK], beyond[PACK];
};

/* Adds splat n to the layers of a subtile's pixels, or, with is_second, a constant, to the sums of those
 * whose layer it is in. scale: the depth that DEPTH_LAYER is of; 0: the layer's. */
SIMD_INLINE void raster_add_depth(const int fused, const int mixed, const int lobed, const int is_second,
                                  real scale, const struct raster_batch *batch, int n, int subtile,
                                  struct raster_layers *d)
{
    const real *restrict x = batch->x[subtile % 4], *restrict y = batch->y[subtile / 4];
    const real z = batch->splat[n].colour[0];
#pragma omp simd
    for (int l = 0; l < PACK; l++) {
        const struct raster_contribution p =
            raster_contribution(fused, mixed, lobed, batch, n, x[l], y[l], d->t[l]);
        const real weight = p.weight > 0 ? p.weight : 0;
        if (is_second) {
            const real reach = DEPTH_LAYER / 2 * (scale > 0 ? scale : d->depth[l]);
            const real gain = real_abs(z - d->depth[l]) <= reach ? weight : 0;
            d->weight[l] += gain;
            d->offset[l] = muladd(fused, gain, z - d->depth[l], d->offset[l]);
        } else {
            const real size = DEPTH_LAYER * (scale > 0 ? scale : d->front[l]);
            /* the layer's end, which gcc compares in vectors; not comparisons joined by & and | */
            const real end = d->front[l] < 0 ? -1 : d->front[l] + size;
            const real reach = weight > 0 ? end : (real)HUGE_VAL;
            const real first = z > reach ? z : d->front[l], sum = z > reach ? weight : d->weight[l] + weight;
            const real shift = z > reach ? 0 : muladd(fused, weight, z - first, d->offset[l]);
            d->depth[l] = sum > d->most[l] ? first : d->depth[l];
            d->beyond[l] = sum > d->most[l] ? shift : d->beyond[l];
            d->most[l] = sum > d->most[l] ? sum : d->most[l];
            d->front[l] = first, d->weight[l] = sum, d->offset[l] = shift;
        }
        d->t[l] = p.t;
    }
}

/* Adds a batch's splats to a subtile's pixels; is_second, a constant: adds the near ones. */
SIMD_INLINE void raster_depth_subtile(const int fused, const int lobed, const int is_second, real scale,
                                      const struct raster_batch *batch, int subtile, struct raster_layers *d)
{
    for (int l = 0; l < PACK; l++) d->t[l] = raster_keep_normal(d->t[l]);
    for (uint32_t splats = batch->splats[subtile]; splats; splats &= splats - 1) {
        const int n = simd_lowest_bit(splats);
        if (raster_lobed(lobed, batch, n))
            raster_add_depth(fused, 1, 1, is_second, scale, batch, n, subtile, d);
        else raster_add_depth(fused, lobed, 0, is_second, scale, batch, n, subtile, d);
    }
}

/* One pass over the tile's splats, front to back; d (TILE_SUBTILES). */
SIMD_INLINE void raster_depth_pass(const int fused, const int lobed, const int is_second,
                                   const struct raster_job *job, const struct raster_tile *tile,
                                   struct raster_layers *d)
{
    uint32_t active = 0xFFFF;
    struct raster_batch batch;
    real t[TILE_PIXELS];
    raster_begin(tile, t);
    raster_begin_batches(&batch);
    for (int subtile = 0; subtile < TILE_SUBTILES; subtile++) {
        memcpy(d[subtile].t, t + subtile * PACK, sizeof d->t);
        memset(d[subtile].weight, 0, sizeof d->weight);
        memset(d[subtile].offset, 0, sizeof d->offset);
    }
    for (const struct pair *pair = tile->pair; pair < tile->end && active; pair += RASTER_BATCH) {
        raster_load_batch(lobed, job, tile, pair, active, &batch);
        for (int n = 0; n < batch.count; n++)
            batch.splat[n].colour[0] = job->bins->splat[pair[n].splat].depth;
        for (int subtile = 0; subtile < TILE_SUBTILES; subtile++) {
            raster_depth_subtile(fused, lobed, is_second, job->depth_scale, &batch, subtile, &d[subtile]);
            memcpy(t + subtile * PACK, d[subtile].t, sizeof d->t);
        }
        if (tile->end - pair > RASTER_BATCH) active = raster_active_subtiles(t);
    }
}

SIMD_INLINE void raster_depth_tile(const int fused, const int lobed, const struct raster_job *job)
{
    const struct raster_tile tile = raster_tile(job);
    struct raster_layers d[TILE_SUBTILES];
    real last_t[TILE_PIXELS], depth[TILE_PIXELS];
    memset(d, 0, sizeof d);
    for (int i = 0; i < TILE_PIXELS; i++) d[i / PACK].front[i % PACK] = -1;
    raster_depth_pass(fused, lobed, 0, job, &tile, d);
    for (int i = 0; i < TILE_PIXELS; i++) {
        struct raster_layers *at = &d[i / PACK];
        const int l = i % PACK;
        at->depth[l] += at->most[l] > 0 ? at->beyond[l] / at->most[l] : 0;
    }
    raster_depth_pass(fused, lobed, 1, job, &tile, d);
    raster_load(job, &tile, job->transmittance, last_t);
    for (int i = 0; i < TILE_PIXELS; i++) {
        const struct raster_layers *at = &d[i / PACK];
        const int l = i % PACK;
        const real z = at->depth[l] + (at->weight[l] > 0 ? at->offset[l] / at->weight[l] : 0);
        const real sure = at->weight[l] >= DEPTH_WEIGHT_MIN ? z : -z;
        depth[i] = 1 - last_t[i] >= OPAQUE_MIN ? sure : 0;
    }
    raster_store(job, &tile, depth, job->depth);
}

/* ---------------- entry points: tiles of scenes with second lobes, or without */

SIMD_INLINE int raster_has_lobes(const struct raster_job *job)
{
    return job->bins->lobes + job->bins->surroundings_lobes > 0;
}

SIMD_BODY void raster_forward_body(const int fused, const struct raster_job *job)
{
    if (raster_has_lobes(job)) raster_forward_tile(fused, 1, job);
    else raster_forward_tile(fused, 0, job);
}

SIMD_BODY void raster_backward_body(const int fused, const struct raster_job *job)
{
    if (raster_has_lobes(job)) raster_backward_tile(fused, 1, 0, job);
    else raster_backward_tile(fused, 0, 0, job);
}

SIMD_BODY void raster_score_body(const int fused, const struct raster_job *job)
{
    if (raster_has_lobes(job)) raster_backward_tile(fused, 1, 1, job);
    else raster_backward_tile(fused, 0, 1, job);
}

SIMD_BODY void raster_depth_body(const int fused, const struct raster_job *job)
{
    if (raster_has_lobes(job)) raster_depth_tile(fused, 1, job);
    else raster_depth_tile(fused, 0, job);
}

SIMD_DISPATCH(OXL_INTERNAL, raster_forward, struct raster_job)
SIMD_DISPATCH(OXL_INTERNAL, raster_depth, struct raster_job)
SIMD_DISPATCH(OXL_INTERNAL, raster_backward, struct raster_job)
SIMD_DISPATCH(OXL_INTERNAL, raster_score, struct raster_job)
