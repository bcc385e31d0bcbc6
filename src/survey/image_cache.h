/* image_cache.h - decoded images of one scene in memory. Part of survey.h, after struct training_image. */
#ifndef OXL_IMAGE_CACHE_H
#define OXL_IMAGE_CACHE_H

struct image_loader { /* of images that are not in memory */
    oxl_result (*load)(oxl_context *ctx, const oxl_scene *scene, int view, struct training_image *out);
    double (*file_pixels)(const oxl_scene *scene, int view); /* of the image file */
    const oxl_scene *scene;
};
struct image_cache {
    struct image_loader    loader;
    struct training_image *image; /* (count) rgb is NULL if not in memory */
    uint64_t              *used;  /* (count) time of the last request */
    uint64_t               clock;
    int                    count;
    size_t                 held, limit; /* bytes in memory; bytes allowed */
};
/* Empty, without a limit. */
OXL_INTERNAL oxl_result                   image_cache_begin(oxl_context *ctx, size_t count, const struct image_loader *loader,
                                                            struct image_cache *out);
OXL_INTERNAL void                         image_cache_free(oxl_context *ctx, struct image_cache *cache);
/* Borrowed until the next request of another view or image_cache_ahead; NULL: error set. */
OXL_INTERNAL const struct training_image *image_cache_get(oxl_context *ctx, struct image_cache *cache, int view);
/* If the first view is not in memory, loads the next ones in parallel. Errors are reported when an image is requested. */
OXL_INTERNAL void image_cache_ahead(oxl_context *ctx, struct image_cache *cache, const int *view, int count);

#endif
