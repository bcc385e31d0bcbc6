/* tradeoff_render.c - cheaper pictures of one model: frames a second of one thread against PSNR to the exact ones.
 *
 * Time is the processor's, and of five rounds over the same views the shortest: other work on the machine only ever adds. The exact
 * pictures are those that eval and the viewer draw.
 */
#include "tradeoff.h"

#include <math.h>
#include <stdlib.h>
#include <time.h>

enum { TRADEOFF_VIEWS = 6, TRADEOFF_ROUNDS = 5 };

struct tradeoff_drawing {
    const oxl_model *model;
    int              sh_degree;  /* -1: the model's */
    int              exp_degree; /* of oxl_render_options */
    int              half;       /* drawn at half the sides, then enlarged */
};

struct tradeoff_eye {
    oxl_context *ctx; /* one thread */
    oxl_camera   camera[TRADEOFF_VIEWS];
    oxl_image    exact[TRADEOFF_VIEWS];
    int          views;
};

/* Bilinear, from w x h to twice as much (and a last column or row of odd sizes): pixel centres lie on the quarters. */
static oxl_result tradeoff_enlarge(oxl_context *ctx, const oxl_image *in, int width, int height, oxl_image *out)
{
    const oxl_result rc = oxl_image_create(ctx, width, height, out);
    if (rc != OXL_OK) return rc;
    for (int y = 0; y < height; y++) {
        const int    y1 = y % 2 ? y / 2 + 1 : y / 2 - 1, ya = y / 2 < in->height ? y / 2 : in->height - 1;
        const int    yb    = y1 < 0 ? 0 : y1 < in->height ? y1 : in->height - 1;
        const size_t small = (size_t)in->width * in->height, large = (size_t)width * height;
        for (int x = 0; x < width; x++) {
            const int x1 = x % 2 ? x / 2 + 1 : x / 2 - 1, xa = x / 2 < in->width ? x / 2 : in->width - 1;
            const int xb = x1 < 0 ? 0 : x1 < in->width ? x1 : in->width - 1;
            for (int c = 0; c < 3; c++) {
                const float *p = in->rgb + c * small, *a = p + (size_t)ya * in->width, *b = p + (size_t)yb * in->width;
                out->rgb[c * large + (size_t)y * width + x] = 0.5625f * a[xa] + 0.1875f * (a[xb] + b[xa]) + 0.0625f * b[xb];
            }
        }
    }
    return OXL_OK;
}

static oxl_result tradeoff_draw(oxl_context *ctx, const struct tradeoff_drawing *d, const oxl_camera *camera, oxl_image *out)
{
    oxl_render_options options = oxl_render_options_default();
    oxl_camera         half    = *camera;
    oxl_image          small   = {0};
    oxl_result         rc;
    options.sh_degree  = d->sh_degree;
    options.exp_degree = d->exp_degree;
    if (!d->half) return oxl_render(ctx, d->model, camera, &options, out, NULL);
    half.width /= 2, half.height /= 2, half.fx /= 2, half.fy /= 2, half.cx /= 2, half.cy /= 2;
    rc = oxl_render(ctx, d->model, &half, &options, &small, NULL);
    if (rc == OXL_OK) rc = tradeoff_enlarge(ctx, &small, camera->width, camera->height, out);
    oxl_image_free(ctx, &small);
    return rc;
}

/* Frames a second, and the mean PSNR to eye->exact; without those yet, the pictures become them. */
static oxl_result tradeoff_measure(struct tradeoff_eye *eye, const struct tradeoff_drawing *d, struct tradeoff_picture *out)
{
    double     least = HUGE_VAL, psnr = 0;
    oxl_result rc = OXL_OK;
    for (int round = 0; round < TRADEOFF_ROUNDS && rc == OXL_OK; round++) {
        double spent = 0;
        psnr         = 0;
        for (int i = 0; i < eye->views && rc == OXL_OK; i++) {
            const clock_t begun = clock();
            oxl_image     image = {0};
            double        one   = 100;
            rc                  = tradeoff_draw(eye->ctx, d, &eye->camera[i], &image);
            spent += (double)(clock() - begun) / CLOCKS_PER_SEC;
            if (rc == OXL_OK && !eye->exact[i].rgb) eye->exact[i] = image, image.rgb = NULL;
            else if (rc == OXL_OK) rc = oxl_psnr(eye->ctx, &image, &eye->exact[i], &one);
            psnr += one / eye->views;
            oxl_image_free(eye->ctx, &image);
        }
        if (spent < least) least = spent;
    }
    out->fps  = least > 0 ? eye->views / least : NAN;
    out->psnr = psnr;
    return rc;
}

/* Views held out, evenly spread; of a scene that holds out none, of all. */
static void tradeoff_choose_views(struct tradeoff_eye *eye, const oxl_scene *scene, int held_out)
{
    int count = 0, seen = 0;
    for (int i = 0; i < oxl_scene_view_count(scene); i++) count += oxl_scene_view(scene, i)->is_test >= held_out;
    for (int i = 0; i < oxl_scene_view_count(scene) && eye->views < TRADEOFF_VIEWS; i++) {
        if (oxl_scene_view(scene, i)->is_test < held_out) continue;
        if (seen++ * TRADEOFF_VIEWS >= eye->views * count) eye->camera[eye->views++] = oxl_scene_view(scene, i)->camera;
    }
}

static double tradeoff_file_size(const char *path)
{
    FILE  *file = fopen(path, "rb");
    double size = NAN;
    if (file && fseek(file, 0, SEEK_END) == 0) size = (double)ftell(file);
    if (file) fclose(file);
    return size;
}

static oxl_result tradeoff_pictures(struct tradeoff_eye *eye, const char *folder, const oxl_model *model, struct tradeoff *t)
{
    static const char *const names[]  = {"sh-degree-2", "sh-degree-1", "sh-degree-0"};
    static const char *const labels[] = {"SH degree 2", "SH degree 1", "SH degree 0"};
    char                     path[1020];
    oxl_model                bytes = {0};
    double                   size;
    oxl_result               rc;
    snprintf(path, sizeof path, "%s/scene.ply", folder);
    size          = tradeoff_file_size(path);
    t->picture[0] = (struct tradeoff_picture){"exact", "exact", 0, 0, size};
    rc            = tradeoff_measure(eye, &(struct tradeoff_drawing){model, -1, 5, 0}, &t->picture[0]);
    t->pictures   = 1;
    if (rc == OXL_OK) {
        t->picture[t->pictures] = (struct tradeoff_picture){"exp-3", "2^x of degree 3", 0, 0, size};
        rc                      = tradeoff_measure(eye, &(struct tradeoff_drawing){model, -1, 3, 0}, &t->picture[t->pictures++]);
    }
    for (int degree = model->sh_degree - 1; degree >= 0 && rc == OXL_OK; degree--, t->pictures++) {
        t->picture[t->pictures] = (struct tradeoff_picture){names[2 - degree], labels[2 - degree], 0, 0, size};
        rc = tradeoff_measure(eye, &(struct tradeoff_drawing){model, degree, 5, 0}, &t->picture[t->pictures]);
    }
    if (rc == OXL_OK) {
        t->picture[t->pictures] = (struct tradeoff_picture){"half-side", "half the sides, enlarged", 0, 0, size};
        rc                      = tradeoff_measure(eye, &(struct tradeoff_drawing){model, -1, 5, 1}, &t->picture[t->pictures++]);
    }
    snprintf(path, sizeof path, "%s/scene.splat", folder);
    if (rc == OXL_OK) rc = oxl_model_write(eye->ctx, path, model);
    if (rc == OXL_OK) rc = oxl_model_read(eye->ctx, path, &bytes);
    if (rc == OXL_OK) {
        for (int k = 0; k < 3; k++) bytes.origin[k] = model->origin[k]; /* .splat has no place for it */
        t->picture[t->pictures] = (struct tradeoff_picture){"splat", "from .splat, 8 bits", 0, 0, tradeoff_file_size(path)};
        rc                      = tradeoff_measure(eye, &(struct tradeoff_drawing){&bytes, -1, 5, 0}, &t->picture[t->pictures++]);
    }
    oxl_model_free(eye->ctx, &bytes);
    return rc;
}

oxl_result tradeoff_render(struct study *s, const oxl_scene_options *options, const char *folder, struct tradeoff *t)
{
    oxl_context_options one   = {.threads = 1, .seed = 1};
    struct tradeoff_eye eye   = {0};
    oxl_scene_options   text  = *options;
    oxl_model           model = {0};
    oxl_scene          *scene = NULL;
    char                path[1020];
    oxl_result          rc = oxl_context_create(&one, &eye.ctx);
    text.image_cache_bytes = 0;
    snprintf(path, sizeof path, "%s/scene.ply", folder);
    if (rc == OXL_OK) rc = oxl_model_read(eye.ctx, path, &model);
    if (rc == OXL_OK) rc = oxl_scene_load(eye.ctx, t->scene, &text, &scene);
    if (rc == OXL_OK) {
        tradeoff_choose_views(&eye, scene, t->held_out);
        rc = tradeoff_pictures(&eye, folder, &model, t);
    }
    if (rc != OXL_OK) study_fail(s, rc, "", oxl_error_text(eye.ctx));
    for (int i = 0; i < TRADEOFF_VIEWS; i++) oxl_image_free(eye.ctx, &eye.exact[i]);
    oxl_scene_free(eye.ctx, scene);
    oxl_model_free(eye.ctx, &model);
    oxl_context_free(eye.ctx);
    return rc;
}
