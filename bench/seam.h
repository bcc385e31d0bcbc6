/* seam.h - PSNR near the borders between blocks, compared with PSNR elsewhere.
 *
 * A pixel's position follows from the rendered depth. Blocks are trained as parts of one model, each with the
 * others' Gaussians as context; where their colours do not meet all the same, the PSNR is lower near the
 * border than elsewhere.
 *
 * Invariant: a pixel that counts is in exactly one of the two sums; both are filled view by view and row by
 * row.
 *
 * For borders.c and its test, which include the library's headers before.
 */
#ifndef BENCH_SEAM_H
#define BENCH_SEAM_H

#define SEAM_WIDTH 0.02 /* near: this fraction of the block's size along the axis that the border cuts */

struct seam { /* over all unmasked pixels of a split, not the mean over views; NaN without pixels */
    double near_psnr, elsewhere_psnr;
    size_t near_pixels, elsewhere_pixels;
};

/* The block that contains a point of the frame; `guess`: the neighbouring pixel's block. */
static inline int seam_block(const struct partition *p, const double frame[3], int guess)
{
    if (partition_contains(&p->block[guess].box, frame)) return guess;
    for (int b = 0; b < p->block_count; b++)
        if (partition_contains(&p->block[b].box, frame)) return b;
    return -1; /* not a number */
}

/* Within SEAM_WIDTH of a face that its own block shares with another: outer faces are infinite. */
static inline int seam_is_near(const struct partition_block *block, const double frame[3])
{
    int beside = 0;
    for (int a = 0; a < 3; a++) {
        const double reach = SEAM_WIDTH * (block->finite.high[a] - block->finite.low[a]);
        beside |= frame[a] - block->box.low[a] <= reach || block->box.high[a] - frame[a] <= reach;
    }
    return beside;
}

struct seam_sum {
    double error, weight; /* weighted sum of squared differences; sum of the weights */
    size_t pixels;        /* number of pixels with a weight above 0 */
};

/* Adds the three channels of pixel i, as they are shown, with the image's weight. */
static inline void seam_add_pixel(const oxl_image *rendered, const oxl_image *image, size_t i,
                                  struct seam_sum *sum)
{
    const size_t plane = (size_t)rendered->width * rendered->height;
    const double weight = image->weight ? image->weight[i] : 1;
    for (int c = 0; c < 3; c++) {
        const double a = rendered->rgb[c * plane + i], b = image->rgb[c * plane + i];
        const double d = OXL_CLAMP(a, 0.0, 1.0) - OXL_CLAMP(b, 0.0, 1.0);
        sum->error += weight * d * d;
    }
    sum->weight += 3 * weight;
    sum->pixels += weight > 0;
}

struct seam_view {
    const struct partition *partition;
    const oxl_camera *camera;
    const double *origin; /* (3) of the scene */
    const oxl_image *rendered, *image;
    const float *depth; /* (H,W) camera z; 0: nothing there, and so not near a border */
};

/* sum[1] is of the pixels near a border, sum[0] of the others. Serial: it takes a tenth of the drawing. */
static inline void seam_add_view(const struct seam_view *v, struct seam_sum sum[2])
{
    int own = 0;
    for (int y = 0; y < v->rendered->height; y++)
        for (int x = 0; x < v->rendered->width; x++) {
            const size_t i = (size_t)y * v->rendered->width + x;
            int beside = 0;
            if (v->depth[i] > 0) {
                double world[3], frame[3];
                camera_unproject(v->camera, (double[2]){x + 0.5, y + 0.5}, v->depth[i], world);
                for (int k = 0; k < 3; k++) world[k] += v->origin[k];
                partition_to_frame(v->partition, world, frame);
                own = seam_block(v->partition, frame, OXL_MAX(own, 0));
                beside = own >= 0 && seam_is_near(&v->partition->block[own], frame);
            }
            seam_add_pixel(v->rendered, v->image, i, &sum[beside]);
        }
}

/* Unreadable images are skipped, as in the evaluation. */
static inline oxl_result seam_draw_view(oxl_context *ctx, struct renderer *r, const struct partition *p,
                                        const oxl_model *model, const oxl_scene *scene,
                                        const oxl_imaging *imaging, int view, struct seam_sum sum[2])
{
    const oxl_camera *camera = &oxl_scene_view(scene, view)->camera;
    oxl_image rendered = {0}, image = {0};
    float *depth = NULL;
    oxl_result rc = oxl_scene_image(ctx, scene, view, NULL, &image);
    if (rc == OXL_ERR_INPUT) return OXL_OK;
    if (rc != OXL_OK) return rc;
    depth = oxl_alloc(ctx, (size_t)camera->width * camera->height, sizeof *depth);
    if (!depth) {
        rc = oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for the depths of %d x %d px", camera->width,
                      camera->height);
        goto done;
    }
    rc = evaluate_draw(ctx, &(struct drawn){r, model, scene, imaging}, view, &rendered, depth);
    if (rc != OXL_OK) goto done;
    seam_add_view(&(struct seam_view){p, camera, oxl_scene_origin(scene), &rendered, &image, depth}, sum);
done:
    oxl_free(ctx, depth);
    oxl_image_free(ctx, &rendered);
    oxl_image_free(ctx, &image);
    return rc;
}

static inline oxl_result seam_measure(oxl_context *ctx, const struct partition *p, const oxl_model *model,
                                      const oxl_scene *scene, const oxl_imaging *imaging, oxl_split split,
                                      struct seam *out)
{
    struct seam_sum sum[2] = {{0, 0, 0}, {0, 0, 0}};
    struct renderer *r = NULL;
    int *view = oxl_alloc(ctx, (size_t)oxl_scene_view_count(scene) + 1, sizeof *view);
    const int requested = view ? scene_views_of(scene, split, view) : 0;
    oxl_result rc = view ? OXL_OK : oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for a list of views");
    *out = (struct seam){0};
    if (rc == OXL_OK) rc = renderer_create(ctx, &r);
    for (int i = 0; i < requested && rc == OXL_OK; i++) {
        rc = context_stopped(ctx);
        if (rc == OXL_OK) rc = seam_draw_view(ctx, r, p, model, scene, imaging, view[i], sum);
    }
    oxl_free(ctx, view);
    renderer_free(ctx, r);
    if (rc != OXL_OK) return rc;
    *out = (struct seam){.near_pixels = sum[1].pixels,
                         .elsewhere_pixels = sum[0].pixels,
                         .near_psnr = metrics_decibel(sum[1].error, sum[1].weight),
                         .elsewhere_psnr = metrics_decibel(sum[0].error, sum[0].weight)};
    return OXL_OK;
}

#endif
