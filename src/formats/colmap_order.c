/* colmap_order.c - sorts cameras, images and points of a COLMAP model by id.
 *
 * COLMAP writes rows in the order of its hash tables, so its text and binary exports of one model differ in
 * this order. The result depends on it: Gaussians and sums follow the order of the points.
 *
 * Invariant: models that differ only in the order of rows are equal afterwards, except for the positions of
 * tracks.
 */
#include "survey_read.h"

static int order_compare(const void *a, const void *b)
{
    int64_t x, y;
    memcpy(&x, a, sizeof x);
    memcpy(&y, b, sizeof y);
    return (x > y) - (x < y);
}

/* Ranks an id, from one bit per possible id. */
struct order_ranks {
    int64_t low;
    uint64_t *met;    /* (words) */
    uint32_t *before; /* (words) number of ids below the word's first */
};

static int order_ones(uint64_t x)
{
    /* Counts the ones of pairs, then of fours, then of bytes. */
    x = x - (x >> 1 & UINT64_C(0x5555555555555555));
    x = (x & UINT64_C(0x3333333333333333)) + (x >> 2 & UINT64_C(0x3333333333333333));
    x = (x + (x >> 4)) & UINT64_C(0x0f0f0f0f0f0f0f0f);
    return (int)(x * UINT64_C(0x0101010101010101) >> 56);
}

static size_t order_rank(const struct order_ranks *ranks, int64_t id)
{
    const uint64_t at = (uint64_t)id - (uint64_t)ranks->low;
    return ranks->before[at / 64] +
           (size_t)order_ones(ranks->met[at / 64] & ((UINT64_C(1) << (at & 63)) - 1));
}

/* Sorts in place: a second array would take half a gigabyte for 10^7 points. Distributes the points into
 * buckets of cache size first; then each swap within a bucket puts one point in its final position. */
static void order_points_by_rank(struct colmap *c, const struct order_ranks *ranks)
{
    enum { BUCKETS = 512 };
    const size_t size = c->point_count / BUCKETS + 1;
    size_t next[BUCKETS]; /* first row of the bucket that may belong elsewhere */
    for (size_t b = 0; b < BUCKETS; b++) next[b] = b * size;
    for (size_t b = 0; b < BUCKETS; b++)
        while (next[b] < OXL_MIN((b + 1) * size, c->point_count)) {
            const size_t to = order_rank(ranks, c->point[next[b]].id) / size;
            if (to != b) OXL_SWAP(struct colmap_point, c->point[next[b]], c->point[next[to]]);
            next[to]++;
        }
    for (size_t i = 0; i < c->point_count; i++)
        for (size_t to; (to = order_rank(ranks, c->point[i].id)) != i;)
            OXL_SWAP(struct colmap_point, c->point[i], c->point[to]);
}

static oxl_result order_by_rank(oxl_context *ctx, struct colmap *c, int64_t low, size_t words,
                                int64_t *repeated)
{
    struct order_ranks k = {.low = low};
    uint32_t before = 0;
    oxl_result rc = OXL_OK;
    k.met = oxl_calloc(ctx, words, sizeof *k.met);
    k.before = oxl_alloc(ctx, words, sizeof *k.before);
    if (!k.met || !k.before) rc = OXL_ERR_MEMORY;
    for (size_t i = 0; i < c->point_count && rc == OXL_OK; i++) {
        const uint64_t at = (uint64_t)c->point[i].id - (uint64_t)low, bit = UINT64_C(1) << (at & 63);
        *repeated = c->point[i].id;
        if (k.met[at / 64] & bit) rc = OXL_ERR_INPUT;
        k.met[at / 64] |= bit;
    }
    for (size_t i = 0; i < words && rc == OXL_OK; i++) {
        k.before[i] = before;
        before += (uint32_t)order_ones(k.met[i]);
    }
    if (rc == OXL_OK) order_points_by_rank(c, &k);
    OXL_FREE(ctx, k.met, k.before);
    return rc;
}

/* Leaves points in order as they are; sorts dense ids by rank, in linear time, and sparse ones by qsort. */
OXL_INTERNAL oxl_result colmap_order_points(oxl_context *ctx, struct colmap *c, int64_t *repeated)
{
    int64_t low = INT64_MAX, high = INT64_MIN;
    size_t sorted = 1;
    for (size_t i = 0; i < c->point_count; i++) {
        low = OXL_MIN(low, c->point[i].id);
        high = OXL_MAX(high, c->point[i].id);
    }
    while (sorted < c->point_count && c->point[sorted - 1].id < c->point[sorted].id) sorted++;
    if (sorted >= c->point_count) return OXL_OK;
    if (((uint64_t)high - (uint64_t)low) / 64 <= c->point_count && c->point_count <= UINT32_MAX)
        return order_by_rank(ctx, c, low, (size_t)(((uint64_t)high - (uint64_t)low) / 64) + 1, repeated);
    /* Sorts sparse ids, which COLMAP does not write, without a bit for each possible id. */
    qsort(c->point, c->point_count, sizeof *c->point, order_compare);
    for (size_t i = 1; i < c->point_count; i++)
        if (c->point[i - 1].id == (*repeated = c->point[i].id)) return OXL_ERR_INPUT;
    return OXL_OK;
}

struct order_image {
    int64_t id;
    uint32_t row;
};

/* Sorts the images by id, and gives the tracks the new rows. */
static oxl_result order_images(oxl_context *ctx, struct colmap *c)
{
    struct order_image *by_id = oxl_alloc(ctx, c->image_count + 1, sizeof *by_id);
    uint32_t *now = oxl_alloc(ctx, c->image_count + 1, sizeof *now); /* new index of each image */
    const oxl_result rc = by_id && now ? OXL_OK : OXL_ERR_MEMORY;
    for (size_t i = 0; i < c->image_count && rc == OXL_OK; i++)
        by_id[i] = (struct order_image){c->image[i].id, (uint32_t)i};
    if (rc == OXL_OK) qsort(by_id, c->image_count, sizeof *by_id, order_compare);
    for (size_t i = 0; i < c->image_count && rc == OXL_OK; i++) now[by_id[i].row] = (uint32_t)i;
    for (size_t i = 0; i < c->track_count && rc == OXL_OK; i++)
        c->track[i].image_row = now[c->track[i].image_row];
    if (rc == OXL_OK) qsort(c->image, c->image_count, sizeof *c->image, order_compare);
    OXL_FREE(ctx, by_id, now);
    return rc;
}

OXL_INTERNAL oxl_result colmap_order(oxl_context *ctx, struct colmap *c)
{
    if (c->camera_count) qsort(c->camera, c->camera_count, sizeof *c->camera, order_compare);
    return c->image_count ? order_images(ctx, c) : OXL_OK;
}

OXL_INTERNAL const struct colmap_camera *colmap_find_camera(const struct colmap *c, int64_t id)
{
    return c->camera_count ? bsearch(&id, c->camera, c->camera_count, sizeof *c->camera, order_compare)
                           : NULL;
}

/* Returns 0 for paths outside the image folder: absolute paths, drives, ".."
 * between slashes of either kind. */
OXL_INTERNAL int colmap_name_is_safe(const char *name, const char *end)
{
    const char *part = name;
    if (*name == '/' || *name == '\\' || (end - name > 1 && name[1] == ':')) return 0;
    for (const char *p = name;; p++) {
        if (p < end && *p == 0) return 0;
        if (p < end && *p != '/' && *p != '\\') continue;
        if (p - part == 2 && part[0] == '.' && part[1] == '.') return 0;
        if (p == end) return 1;
        part = p + 1;
    }
}
