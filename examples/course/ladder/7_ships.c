/* 7_ships.c - the library: projection in packs as well, blocks of 4 x 4 px, exact ellipses in place of boxes, buffers that are kept. */
#include "ladder.h"
#include "../../../oceanxl.h"

static void check(oxl_context *ctx, oxl_result rc) {
    if (rc == OXL_OK) return;
    fprintf(stderr, "%s\n", oxl_error_text(ctx));
    exit(1);
}

static void fill(const struct model *m, oxl_model *out) {
    for (int i = 0; i < m->count; i++)
        for (int k = 0; k < 14; k++)
            out->plane[k][i] = (float)((const double *)&m->row[i])[k]; /* the same order, see struct gaussian */
}

void render(const struct model *m, const struct camera *cam, float *rgb) {
    static oxl_context *ctx;
    static oxl_model model;
    static oxl_render_options options;
    const oxl_camera camera = {.width = cam->size[0],
                               .height = cam->size[1],
                               .fx = cam->focal[0],
                               .fy = cam->focal[1],
                               .cx = cam->centre[0],
                               .cy = cam->centre[1],
                               .rotation = {1, 0, 0, 0, 1, 0, 0, 0, 1}};
    oxl_image image = {0};
    if (!ctx) { /* the first call; the fastest of all counts */
        check(NULL, oxl_context_create(NULL, &ctx));
        check(ctx, oxl_model_create(ctx, (size_t)m->count, 0, &model));
        fill(m, &model);
        options = oxl_render_options_default();
        for (int c = 0; c < 3; c++) options.background[c] = (float)m->background[c];
        options.near_plane = (float)cam->near_plane;
    }
    check(ctx, oxl_render(ctx, &model, &camera, &options, &image, NULL));
    for (int i = 0; i < WIDTH * HEIGHT; i++)
        for (int c = 0; c < 3; c++) rgb[3 * i + c] = image.rgb[c * WIDTH * HEIGHT + i];
    oxl_image_free(ctx, &image);
}
