/* borders.c - PSNR near the borders between blocks, of several models at the same pixels (docs/SCALE.md).
 *
 *     build/borders MAX_SIDE SURVEY BLOCKS OUT...
 *
 * The first OUT's depth places the pixels of all. A line of each OUT: PSNR near borders and elsewhere, of held-out and of training views; its Gaussians near
 * borders, and all.
 */
#include "../oceanxl.c"

#include "seam.h"

enum { BORDERS_MODELS = 32 };

struct borders {
    oxl_context *ctx;
    oxl_scene *scene;
    struct partition partition;
    struct renderer *renderer;
    oxl_model model[BORDERS_MODELS];
    struct oxl_imaging imaging[BORDERS_MODELS];
    struct seam_sum sum[BORDERS_MODELS][2][2]; /* of held-out and training views; elsewhere and near */
    int models;
};

static oxl_result borders_read(struct borders *b, int k, const char *out)
{
    const char *path = PATH(out, "scene.ply");
    oxl_result rc = oxl_model_read(b->ctx, path, &b->model[k]);
    if (rc == OXL_OK) oxl_model_move_origin(&b->model[k], oxl_scene_origin(b->scene));
    if (rc == OXL_OK) rc = imaging_read_beside(b->ctx, path, b->scene, &b->imaging[k]);
    return rc;
}

static oxl_result borders_view(struct borders *b, int view, float *depth, oxl_image *image)
{
    const oxl_view *of = oxl_scene_view(b->scene, view);
    const double *origin = oxl_scene_origin(b->scene);
    oxl_result rc = oxl_scene_image(b->ctx, b->scene, view, NULL, image);
    for (int k = 0; k < b->models && rc == OXL_OK; k++) {
        oxl_image rendered = {0};
        rc = evaluate_draw(b->ctx, &(struct drawn){b->renderer, &b->model[k], b->scene, &b->imaging[k]}, view,
                           &rendered, k == 0 ? depth : NULL);
        if (rc == OXL_OK)
            seam_add_view(&(struct seam_view){&b->partition, &of->camera, origin, &rendered, image, depth},
                          b->sum[k][!of->is_test]);
        oxl_image_free(b->ctx, &rendered);
    }
    return rc;
}

static size_t borders_count(const struct borders *b, const oxl_model *m)
{
    size_t near = 0;
    for (size_t i = 0; i < m->count; i++) {
        double world[3], frame[3];
        int block;
        for (int a = 0; a < 3; a++) world[a] = (double)m->plane[OXL_MEAN + a][i] + m->origin[a];
        partition_to_frame(&b->partition, world, frame);
        block = seam_block(&b->partition, frame, 0);
        near += block >= 0 && seam_is_near(&b->partition.block[block], frame);
    }
    return near;
}

static void borders_print(const struct borders *b, int k, const char *out)
{
    printf("%s:", out);
    for (int v = 0; v < 2; v++)
        printf(" %s %.2f %.2f", v ? "training" : "held-out",
               metrics_decibel(b->sum[k][v][1].error, b->sum[k][v][1].weight),
               metrics_decibel(b->sum[k][v][0].error, b->sum[k][v][0].weight));
    printf(" dB, Gaussians %zu of %zu\n", borders_count(b, &b->model[k]), b->model[k].count);
}

int main(int count, char **word)
{
    oxl_scene_options o = oxl_scene_options_default();
    oxl_partition_options cut = oxl_job_options_default(OXL_PRESET_DRAFT).partition;
    static struct borders b;
    oxl_result rc = oxl_context_create(NULL, &b.ctx);
    if (count < 5 || count - 4 > BORDERS_MODELS)
        return printf("usage: borders MAX_SIDE SURVEY BLOCKS OUT...\n"), 2;
    o.max_side = atoi(word[1]), cut.blocks = atoi(word[3]);
    if (rc == OXL_OK) rc = oxl_scene_load(b.ctx, word[2], &o, &b.scene);
    if (rc == OXL_OK) rc = partition_make(b.ctx, b.scene, &cut, &b.partition);
    if (rc == OXL_OK) rc = renderer_create(b.ctx, &b.renderer);
    for (; b.models < count - 4 && rc == OXL_OK; b.models++)
        rc = borders_read(&b, b.models, word[4 + b.models]);
    for (int v = 0; rc == OXL_OK && v < oxl_scene_view_count(b.scene); v++) {
        const oxl_camera *c = &oxl_scene_view(b.scene, v)->camera;
        float *depth = oxl_calloc(b.ctx, (size_t)c->width * (size_t)c->height, sizeof *depth);
        oxl_image image = {0};
        rc = depth ? borders_view(&b, v, depth, &image) : OXL_ERR_MEMORY;
        oxl_free(b.ctx, depth);
        oxl_image_free(b.ctx, &image);
    }
    for (int k = 0; k < b.models && rc == OXL_OK; k++) borders_print(&b, k, word[4 + k]);
    if (rc != OXL_OK) fprintf(stderr, "%s\n", oxl_error_text(b.ctx));
    return rc != OXL_OK;
}
