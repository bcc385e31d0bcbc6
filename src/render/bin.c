/* bin.c - lists of splats per tile, in depth order, with the 4 x 4 subtiles that each covers.
 *
 * One radix sort of the visible splats by depth; the splats are then scattered to their tiles in that order,
 * so each tile's list is sorted. A splat's footprint is the ellipse alpha = 1/255, divided into rows of
 * subtiles (Speedy-Splat's AccuTile, Hanson et al.
 * 2025, divides it into rows of tiles). With a second lobe it is the hull of both ellipses in each row.
 *
 * Invariants: every pixel with alpha >= 1/255 lies in a listed subtile. The lists do not depend on the number
 * of threads or parts.
 */
#include "kernels.h"

#define BIN_PARTS 64     /* limit of parts of the depth order; each is counted and scattered independently */
#define BIN_PART_MIN 128 /* approximate minimum of splats per part, since each part has a counter per tile */
#define BIN_NARROW 6     /* columns of tiles: wider boxes are tested column by column */
#define BIN_RADIX_BITS 11
#define BIN_RADIX (1 << BIN_RADIX_BITS)

/* Rounding must not lose a pixel of the contour. */
#define BIN_CONTOUR_FACTOR ((real)1.0001) /* on the contour's level */
#define BIN_CONTOUR_MARGIN ((real)0.001)  /* bits: added to it */
#define BIN_SLACK ((real)0.001)           /* px: to the left and right of the contour */
/* of the half box: added to it, since rounding grows with the splat */
#define BIN_SLACK_FRACTION ((real)1e-5)
#define BIN_ALMOST_HALF ((real)0.4999) /* px: 0.5 less what rounding may add */

struct bin_key {
    uint32_t depth; /* bits of a positive float: they sort like the number */
    uint32_t row;
};

struct bin_staged { /* a pair before the scatter; its index is its slot */
    uint32_t tile;
    uint32_t splat;
    uint32_t subtiles;
};

struct bin_scratch {
    struct bin_key *key, *other;
    struct bin_staged *staged;
    uint32_t *count; /* (BIN_PARTS, tiles) number of pairs, then write position of each part */
    uint32_t *pack_start;
    size_t key_capacity, other_capacity, staged_capacity, count_capacity, order_capacity, pair_capacity,
        start_capacity, pack_start_capacity;
    int parts;
    size_t part_end[BIN_PARTS + 1]; /* in the depth order */
};

/* ---------------- depth order */

static uint32_t bin_depth_bits(real depth)
{
    const float f = (float)depth;
    uint32_t bits;
    memcpy(&bits, &f, sizeof bits);
    return bits;
}

static oxl_result bin_collect_visible(oxl_context *ctx, struct bins *b)
{
    struct bin_scratch *s = b->scratch;
    size_t total = 0;
    oxl_result rc = OXL_RESERVE(ctx, s->pack_start, b->packs + 1);
    if (rc != OXL_OK) return rc;
    for (size_t p = 0; p < b->packs; p++) {
        s->pack_start[p] = (uint32_t)total;
        for (unsigned bits = b->visible[p]; bits; bits &= bits - 1) total++;
    }
    b->visible_count = total;
    rc = OXL_RESERVE(ctx, s->key, total + 1);
    if (rc == OXL_OK) rc = OXL_RESERVE(ctx, s->other, total + 1);
    if (rc == OXL_OK) rc = oxl_reserve(ctx, &b->order, &s->order_capacity, total + 1, sizeof *b->order);
    if (rc != OXL_OK) return rc;
#pragma omp parallel for schedule(static) num_threads(ctx->threads)
    for (int64_t p = 0; p < (int64_t)b->packs; p++) {
        struct bin_key *key = s->key + s->pack_start[p];
        for (unsigned bits = b->visible[p], l = 0; bits; bits >>= 1, l++) {
            const uint32_t row = (uint32_t)(p * PACK + l);
            if (bits & 1) *key++ = (struct bin_key){bin_depth_bits(b->splat[row].depth), row};
        }
    }
    return OXL_OK;
}

/* Sorts the least significant digit first, three digits of 11 bits; stable, so equal depths stay in row
 * order. A pass with equal digits in all keys is skipped, which is common for the highest one. */
static void bin_sort(struct bins *b)
{
    struct bin_scratch *s = b->scratch;
    const size_t n = b->visible_count;
    uint32_t count[3][BIN_RADIX];
    memset(count, 0, sizeof count);
    for (size_t i = 0; i < n; i++)
        for (int d = 0; d < 3; d++) count[d][s->key[i].depth >> (d * BIN_RADIX_BITS) & (BIN_RADIX - 1)]++;
    for (int d = 0; d < 3; d++) {
        const int shift = d * BIN_RADIX_BITS;
        uint32_t sum = 0;
        struct bin_key *from = s->key, *to = s->other;
        if (n == 0 || count[d][from[0].depth >> shift & (BIN_RADIX - 1)] == n) continue;
        for (int digit = 0; digit < BIN_RADIX; digit++) {
            const uint32_t here = count[d][digit];
            count[d][digit] = sum;
            sum += here;
        }
        for (size_t i = 0; i < n; i++) to[count[d][from[i].depth >> shift & (BIN_RADIX - 1)]++] = from[i];
        s->key = to;
        s->other = from;
        OXL_SWAP(size_t, s->key_capacity, s->other_capacity);
    }
    for (size_t i = 0; i < n; i++) b->order[i] = s->key[i].row;
}

/* ---------------- footprints */

static uint32_t bin_box_tiles(const struct splat *s)
{
    return (uint32_t)(s->tile_x1 - s->tile_x0 + 1) * (uint32_t)(s->tile_y1 - s->tile_y0 + 1);
}

/* The contour a (x + k y)^2 + e y^2 = r around a splat. */
struct bin_contour {
    real r;       /* log2(255 o), slightly enlarged: conservative, the alpha test at each pixel is exact */
    real inverse; /* 1 / a */
    real extreme; /* y of its leftmost point; the rightmost one is at -extreme */
    real slack;   /* px */
};

struct bin_spans { /* subtiles of each of PACK rows, inclusive; none: first is INT_MAX, last -1 */
    int32_t first[PACK], last[PACK];
};

SIMD_INLINE struct bin_contour bin_contour(const struct splat *s, real cutoff_bits)
{
    struct bin_contour c;
    c.r = (s->peak + cutoff_bits) * BIN_CONTOUR_FACTOR + BIN_CONTOUR_MARGIN;
    c.inverse = 1 / s->a;
    c.extreme = s->k * c.r / (s->e * s->half_x);
    c.slack = BIN_SLACK + BIN_SLACK_FRACTION * s->half_x;
    return c;
}

/* Within a subtile row, the contour's leftmost point is that of the ellipse or, if that is outside the row,
 * at the nearer edge, since an ellipse is convex; likewise on the right. subtile_row: the first of PACK. */
SIMD_INLINE void bin_subtile_rows(const struct splat *s, const struct bin_contour *c, int subtile_row,
                                  int width, struct bin_spans *out)
{
    const real u = s->u, v = s->v, k = s->k, e = s->e, half_y = s->half_y;
    const real r = c->r, inverse = c->inverse, extreme = c->extreme, slack = c->slack;
    const real leftmost = (real)0.5, rightmost = width - (real)0.5; /* pixel centres */
#pragma omp simd
    for (int l = 0; l < PACK; l++) {
        const real top = (subtile_row + l) * 4 + (real)0.5 - v, bottom = top + 3;
        const real y0 = top > -half_y ? top : -half_y, y1 = bottom < half_y ? bottom : half_y;
        const real yl = OXL_CLAMP(extreme, y0, y1), yr = OXL_CLAMP(-extreme, y0, y1);
        const real cl = r - e * yl * yl, cr = r - e * yr * yr;
        const real left = u - k * yl - real_sqrt((cl > 0 ? cl : 0) * inverse) - slack;
        const real right = u - k * yr + real_sqrt((cr > 0 ? cr : 0) * inverse) + slack;
        const int meets = (y0 <= y1) & (right >= leftmost) & (left <= rightmost);
        /* from: the first pixel whose centre is not left of it */
        const real from = left + BIN_ALMOST_HALF, to = right - (real)0.5;
        const int32_t first = (int32_t)((meets & (from > 0)) ? from : 0),
                      last = (int32_t)((meets & (to < rightmost)) ? to : rightmost);
        const int some = meets & (first <= last);
        out->first[l] = some ? first / 4 : INT_MAX;
        out->last[l] = some ? last / 4 : -1;
    }
}

/* The hull of both. */
SIMD_INLINE void bin_join(struct bin_spans *spans, const struct bin_spans *other)
{
#pragma omp simd
    for (int l = 0; l < PACK; l++) {
        spans->first[l] = OXL_MIN(spans->first[l], other->first[l]);
        spans->last[l] = OXL_MAX(spans->last[l], other->last[l]);
    }
}

/* A splat with another shape at the same position. */
SIMD_INLINE struct splat bin_lobe_splat(const struct splat *s, const struct lobe *lobe)
{
    struct splat other = *s;
    other.a = lobe->a, other.k = lobe->k, other.e = lobe->e, other.peak = lobe->peak;
    other.half_x = lobe->half_x, other.half_y = lobe->half_y;
    return other;
}

/* Which subtiles of column tx of tiles lie in the spans; the bits of a tile are those of its four rows
 * together. */
SIMD_INLINE void bin_column(const struct bin_spans *spans, int tx, uint32_t *restrict subtiles)
{
#pragma omp simd
    for (int l = 0; l < PACK; l++) {
        const int32_t from = OXL_CLAMP(spans->first[l] - 4 * tx, 0, 4),
                      past = OXL_CLAMP(spans->last[l] + 1 - 4 * tx, from, 4);
        subtiles[l] = ((1u << past) - (1u << from)) << (l % 4 * 4);
    }
}

struct bin_columns { /* of tiles, inclusive */
    int first, last;
};

/* Columns of the splat's box that its spans reach; all columns of a narrow box, where the test costs more
 * than it saves. */
SIMD_INLINE struct bin_columns bin_columns(const struct splat *s, const struct bin_spans *spans)
{
    struct bin_columns c = {s->tile_x0, s->tile_x1};
    int32_t first = INT_MAX, last = -1;
    if (c.last - c.first < BIN_NARROW) return c;
    for (int l = 0; l < PACK; l++)
        first = OXL_MIN(first, spans->first[l]), last = OXL_MAX(last, spans->last[l]);
    c.first = OXL_MAX(first / 4, c.first);
    c.last = last < 0 ? -1 : OXL_MIN(last / 4, c.last);
    return c;
}

/* Writes the splat's pairs in groups of four rows of tiles, column by column; returns their number. lobe: its
 * second lobe, or the constant NULL. Pairs outside the box, possible by rounding, are skipped, since the box
 * determines the number of slots. */
SIMD_INLINE uint32_t bin_footprint(const struct splat *s, const struct lobe *lobe, uint32_t row,
                                   const struct bins *b, int width, struct bin_staged *out)
{
    struct splat main, second;
    struct bin_contour contour, other;
    struct bin_spans spans, more;
    uint32_t count = 0, subtiles[PACK];
    if (lobe) {
        second = bin_lobe_splat(s, lobe);
        other = bin_contour(&second, b->cutoff_bits);
        main = *s;
        main.half_x = lobe->main_x, main.half_y = lobe->main_y;
        s = &main;
    }
    contour = bin_contour(s, b->cutoff_bits);
    for (int ty = s->tile_y0; ty <= s->tile_y1; ty += PACK / 4) {
        const int rows = OXL_MIN(PACK / 4, s->tile_y1 - ty + 1);
        struct bin_columns columns;
        bin_subtile_rows(s, &contour, 4 * ty, width, &spans);
        if (lobe) bin_subtile_rows(&second, &other, 4 * ty, width, &more);
        if (lobe) bin_join(&spans, &more);
        columns = bin_columns(s, &spans);
        for (int tx = columns.first; tx <= columns.last; tx++) {
            bin_column(&spans, tx, subtiles);
            for (int r = 0; r < rows; r++) {
                const uint32_t *four = &subtiles[4 * r], all = four[0] | four[1] | four[2] | four[3];
                if (all) out[count++] = (struct bin_staged){(uint32_t)((ty + r) * b->tiles_x + tx), row, all};
            }
        }
    }
    return count;
}

/* ---------------- to the tiles */

/* Slots for the splat's pairs, and as many for the sums of its second lobe. */
static uint32_t bin_slot_count(const struct bins *b, uint32_t row)
{
    const uint32_t tiles = bin_box_tiles(&b->splat[row]);
    return bins_lobe(b, row) ? 2 * tiles : tiles;
}

/* Slots are assigned in depth order, by the boxes; parts have about equal numbers of slots. */
static oxl_result bin_assign_slots(oxl_context *ctx, struct bins *b)
{
    struct bin_scratch *s = b->scratch;
    size_t slot = 0, total = 0;
    int part = 0;
    for (size_t i = 0; i < b->visible_count; i++) total += bin_slot_count(b, b->order[i]);
    if (total > UINT32_MAX)
        return oxl_fail(
            ctx, OXL_ERR_MEMORY,
            "%zu (tile, splat) pairs in one view are more than this build can number\nfix: a smaller --max-side",
            total);
    for (size_t i = 0; i < b->visible_count; i++) {
        struct splat *splat = &b->splat[b->order[i]];
        while (part < s->parts && slot >= total * (size_t)part / (size_t)s->parts) s->part_end[part++] = i;
        splat->first_slot = (uint32_t)slot;
        slot += bin_slot_count(b, b->order[i]);
    }
    while (part <= s->parts) s->part_end[part++] = b->visible_count;
    b->slot_count = total;
    return OXL_RESERVE(ctx, s->staged, total + 1);
}

struct bin_part {
    struct bins *bins;
    int part, width;
};

SIMD_BODY void bin_stage_body(const int fused, const struct bin_part *job)
{
    struct bins *b = job->bins;
    struct bin_scratch *s = b->scratch;
    const size_t tiles = (size_t)(b->tiles_x * b->tiles_y);
    uint32_t *count = s->count + (size_t)job->part * tiles;
    (void)fused;
    memset(count, 0, sizeof *count * tiles);
    for (size_t i = s->part_end[job->part]; i < s->part_end[job->part + 1]; i++) {
        const uint32_t row = b->order[i];
        struct splat *splat = &b->splat[row];
        const struct lobe *lobe = bins_lobe(b, row);
        struct bin_staged *out = s->staged + splat->first_slot;
        if (lobe) splat->slots = bin_footprint(splat, lobe, row, b, job->width, out);
        else splat->slots = bin_footprint(splat, NULL, row, b, job->width, out);
        for (uint32_t k = 0; k < splat->slots; k++) count[out[k].tile]++;
    }
}

SIMD_DISPATCH(static, bin_stage, struct bin_part)

static void bin_scatter_part(struct bins *b, int part)
{
    struct bin_scratch *s = b->scratch;
    uint32_t *at = s->count + (size_t)part * (size_t)(b->tiles_x * b->tiles_y);
    for (size_t i = s->part_end[part]; i < s->part_end[part + 1]; i++) {
        const struct splat *splat = &b->splat[b->order[i]];
        for (uint32_t slot = splat->first_slot; slot < splat->first_slot + splat->slots; slot++) {
            const struct bin_staged *from = &s->staged[slot];
            b->pair[at[from->tile]++] = (struct pair){from->splat, slot, from->subtiles};
        }
    }
}

/* Converts counts to the write position of each part in each tile's list. */
static size_t bin_prefix(struct bins *b)
{
    const size_t tiles = (size_t)(b->tiles_x * b->tiles_y);
    uint32_t sum = 0;
    for (size_t t = 0; t < tiles; t++) {
        b->tile_start[t] = sum;
        for (int part = 0; part < b->scratch->parts; part++) {
            uint32_t *count = &b->scratch->count[(size_t)part * tiles + t];
            const uint32_t here = *count;
            *count = sum;
            sum += here;
        }
    }
    b->tile_start[tiles] = sum;
    return sum;
}

static oxl_result bin_reserve_tiles(oxl_context *ctx, struct bins *b)
{
    struct bin_scratch *s = b->scratch;
    const size_t tiles = (size_t)(b->tiles_x * b->tiles_y);
    oxl_result rc = OXL_RESERVE(ctx, s->count, BIN_PARTS * tiles);
    if (rc == OXL_OK)
        rc = oxl_reserve(ctx, &b->tile_start, &s->start_capacity, tiles + 1, sizeof *b->tile_start);
    return rc;
}

OXL_INTERNAL oxl_result bin_splats(oxl_context *ctx, struct bins *b, int width, int height)
{
    oxl_result rc;
    b->tiles_x = (width + TILE - 1) / TILE;
    b->tiles_y = (height + TILE - 1) / TILE;
    if (!b->scratch && !(b->scratch = oxl_calloc(ctx, 1, sizeof *b->scratch))) return OXL_ERR_MEMORY;
    if ((rc = bin_collect_visible(ctx, b)) != OXL_OK) return rc;
    bin_sort(b);
    b->scratch->parts = (int)OXL_CLAMP(b->visible_count / BIN_PART_MIN, 1, BIN_PARTS);
    if ((rc = bin_reserve_tiles(ctx, b)) != OXL_OK) return rc;
    if ((rc = bin_assign_slots(ctx, b)) != OXL_OK) return rc;
#pragma omp parallel for schedule(dynamic) num_threads(ctx->threads)
    for (int part = 0; part < b->scratch->parts; part++) {
        const struct bin_part job = {b, part, width};
        bin_stage(ctx->isa, &job);
    }
    b->pair_count = bin_prefix(b);
    rc = oxl_reserve(ctx, &b->pair, &b->scratch->pair_capacity, b->pair_count + 1, sizeof *b->pair);
    if (rc != OXL_OK) return rc;
#pragma omp parallel for schedule(dynamic) num_threads(ctx->threads)
    for (int part = 0; part < b->scratch->parts; part++) bin_scatter_part(b, part);
    return OXL_OK;
}

OXL_INTERNAL void bin_free(oxl_context *ctx, struct bins *b)
{
    if (b->scratch) {
        OXL_FREE(ctx, b->scratch->key, b->scratch->other, b->scratch->staged, b->scratch->count,
                 b->scratch->pack_start);
    }
    OXL_FREE(ctx, b->scratch, b->order, b->pair, b->tile_start);
    *b = (struct bins){0};
}
