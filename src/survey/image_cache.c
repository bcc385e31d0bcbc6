/* image_cache.c - keeps decoded images in memory: loads them on request or ahead of it, and evicts them when
 * the cache is full.
 *
 * Images take no more memory than the limit, apart from the image requested last. Invariant: the state of the
 * cache does not change results.
 */
#include "image.h"

enum {
    /* most images that are loaded in parallel; memory is planned for as many on any number of threads */
    IMAGE_CACHE_AHEAD = 4,
    /* bytes per pixel of a file: planes and colours of a JPEG; a progressive one
     * and 16 bits take twice that */
    IMAGE_CACHE_DECODE_BYTES = 6
};

OXL_INTERNAL struct image_cache *image_cache_begin(oxl_context *ctx, size_t count,
                                                   const struct image_loader *loader)
{
    struct image_cache *c = oxl_calloc(ctx, 1, sizeof *c);
    if (!c) return NULL;
    *c = (struct image_cache){.loader = *loader,
                              .image = oxl_calloc(ctx, count + 1, sizeof *c->image),
                              .used = oxl_calloc(ctx, count + 1, sizeof *c->used),
                              .count = (int)count,
                              .limit = SIZE_MAX};
    if (c->image && c->used) return c;
    image_cache_free(ctx, c);
    return NULL;
}

OXL_INTERNAL void image_cache_clear(oxl_context *ctx, struct image_cache *cache)
{
    for (int i = 0; i < cache->count; i++) image_training_free(ctx, &cache->image[i]);
    cache->held = 0;
}

OXL_INTERNAL void image_cache_free(oxl_context *ctx, struct image_cache *cache)
{
    if (!cache) return;
    for (int i = 0; cache->image && i < cache->count; i++) image_training_free(ctx, &cache->image[i]);
    OXL_FREE(ctx, cache->image, cache->used, cache->decoded);
    oxl_free(ctx, cache);
}

static size_t image_cache_size(const struct training_image *image)
{
    return (size_t)image->width * image->height * (image->mask ? 4 : 3);
}

/* Evicts the most recently used images until all but `keep` fit into `limit`. Each epoch uses all images in a
 * new order, so the most recent one is needed last: with memory for half of the images 50 % of the requests
 * are hits; with LRU 15 %. */
static void image_cache_make_room(oxl_context *ctx, struct image_cache *cache, int keep, size_t limit)
{
    while (cache->held > limit) {
        int latest = -1;
        for (int i = 0; i < cache->count; i++)
            if (i != keep && cache->image[i].rgb && (latest < 0 || cache->used[i] > cache->used[latest]))
                latest = i;
        if (latest < 0) return;
        cache->held -= image_cache_size(&cache->image[latest]);
        image_training_free(ctx, &cache->image[latest]);
    }
}

OXL_INTERNAL const struct training_image *image_cache_get(oxl_context *ctx, struct image_cache *cache,
                                                          int view)
{
    struct training_image *image = &cache->image[view];
    cache->used[view] = ++cache->clock;
    if (!image->rgb) {
        oxl_result rc = cache->loader.load(ctx, cache->loader.scene, view, image);
        /* Frees all other images to make room for the decoder, and tries again. */
        if (rc == OXL_ERR_MEMORY && cache->held > 0) {
            image_cache_make_room(ctx, cache, view, 0);
            rc = cache->loader.load(ctx, cache->loader.scene, view, image);
        }
        if (rc != OXL_OK) return NULL;
        cache->held += image_cache_size(image);
        image_cache_make_room(ctx, cache, view, cache->limit);
    }
    return image;
}

OXL_INTERNAL double image_cache_bytes(double cache, double pixels, double file_pixels)
{
    const double one = IMAGE_CACHE_DECODE_BYTES * file_pixels,
                 ahead = OXL_MIN(cache / 4, IMAGE_CACHE_AHEAD * one);
    return OXL_MIN(3 * pixels + ahead, cache) + one;
}

/* Chooses the next views to load in parallel: views not in memory, at most one per thread, and as many as can
 * be decoded in a quarter of the cache. *bytes: what decoding them takes. */
static int image_cache_choose_ahead(const oxl_context *ctx, const struct image_cache *cache, const int *view,
                                    int count, int *chosen, size_t *bytes)
{
    int n = 0;
    *bytes = 0;
    for (int i = 0; i < count && n < OXL_MIN(ctx->threads, IMAGE_CACHE_AHEAD); i++) {
        const double more =
            IMAGE_CACHE_DECODE_BYTES * cache->loader.file_pixels(cache->loader.scene, view[i]);
        if (cache->image[view[i]].rgb) continue;
        if ((double)*bytes + more > (double)(cache->limit / 4)) break;
        *bytes += (size_t)more;
        chosen[n++] = view[i];
    }
    return n;
}

OXL_INTERNAL void image_cache_ahead(oxl_context *ctx, struct image_cache *cache, const int *view, int count)
{
    struct training_image read[IMAGE_CACHE_AHEAD] = {{0}};
    int chosen[IMAGE_CACHE_AHEAD], n;
    size_t bytes;
    /* Drops errors, which are reported when the image is requested. */
    oxl_context own = context_for_thread(ctx);
    if (count < 1 || cache->image[view[0]].rgb) return;
    n = image_cache_choose_ahead(ctx, cache, view, count, chosen, &bytes);
    if (n < 2) return;
    image_cache_make_room(ctx, cache, -1, cache->limit - bytes);
#pragma omp parallel for schedule(dynamic, 1) num_threads(ctx->threads) firstprivate(own)
    for (int i = 0; i < n; i++) cache->loader.load(&own, cache->loader.scene, chosen[i], &read[i]);
    for (int i = 0; i < n; i++) {
        if (!read[i].rgb) continue;
        cache->image[chosen[i]] = read[i];
        cache->used[chosen[i]] = 0; /* evicted last, since it is needed soon */
        cache->held += image_cache_size(&read[i]);
    }
    image_cache_make_room(ctx, cache, -1, cache->limit);
}
