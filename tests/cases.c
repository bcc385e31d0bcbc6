/* cases.c - scenes that several test files share. */
#include "test.h"

void test_write_colmap(const char *folder, const char *cameras, const char *images, const char *points)
{
    test_write(test_path("%s/cameras.txt", folder), cameras);
    test_write(test_path("%s/images.txt", folder), images ? images : "");
    test_write(test_path("%s/points3D.txt", folder), points ? points : "");
}

void test_archive(void (*archive)(struct archive *a, void *user), void *written, void *read)
{
    int found = 0;
    CHECK_OK(checkpoint_write(test_ctx, test_folder(), "key", archive, written));
    CHECK_OK(checkpoint_read(test_ctx, test_folder(), "key", archive, read, &found));
    CHECK(found);
}

oxl_metrics test_evaluate(const oxl_model *model, const oxl_scene *scene, const struct oxl_imaging *imaging,
                          oxl_split split)
{
    oxl_metrics m;
    CHECK_OK(oxl_evaluate(test_ctx, model, scene, imaging, split, &m));
    oxl_metrics figures = m;
    oxl_metrics_free(test_ctx, &m);
    return figures;
}

size_t test_rows(const oxl_model *m, int plane)
{
    return plane >= OXL_LOBE ? m->lobes : plane < oxl_model_planes(m) ? m->count : 0;
}

int test_same_model(const oxl_model *a, const oxl_model *b)
{
    int same = a->count == b->count && a->sh_degree == b->sh_degree && a->lobes == b->lobes &&
               a->antialias == b->antialias;
    for (int k = 0; same && k < OXL_PLANES; k++) {
        same = test_rows(a, k) == 0 || !memcmp(a->plane[k], b->plane[k], test_rows(a, k) * sizeof(float));
    }
    return same;
}

/* Two patches of 64 equal Gaussians each: `many` views look at the left one, `few` at the right one; they
 * share nothing. */

struct prune_case prune_two_patches(int many, int few, float low)
{
    enum { SIDE = 32 };
    struct prune_case c = {NULL, {{0}, {0}, {0}}};
    oxl_view view[16] = {{0}};
    oxl_image image[16] = {{0}};
    static char names[16][16];
    c.trained.model = test_model(128, 1);
    for (int i = 0; i < 128; i++) {
        c.trained.model.plane[OXL_MEAN][i] = (float)(i % 8 - 3.5) * 0.3f + (i < 64 ? -20 : 20);
        c.trained.model.plane[OXL_MEAN + 1][i] = (float)(i / 8 % 8 - 3.5) * 0.3f;
        c.trained.model.plane[OXL_OPACITY][i] = i % 2 ? 2.0f : low; /* every second one is fainter */
        for (int a = 0; a < 3; a++)
            c.trained.model.plane[OXL_LOG_SCALE + a][i] = -1.9f, c.trained.model.plane[OXL_SH + a][i] = 1;
    }
    CHECK_OK(model_copy(test_ctx, &c.trained.model, &c.trained.mean));
    CHECK_OK(model_copy(test_ctx, &c.trained.model, &c.trained.square));
    for (int v = 0; v < many + few; v++) {
        snprintf(names[v], sizeof names[v], "v%02d.png", v);
        view[v] = (oxl_view){names[v],
                             test_camera(SIDE, SIDE, 40, (v < many ? -20 : 20) - 0.05 * v, -0.03 * v, -4), 0};
        image[v] = test_image(SIDE, SIDE);
        for (int i = 0; i < 3 * SIDE * SIDE; i++) image[v].rgb[i] = (float)(i % SIDE) / SIDE;
    }
    c.scene = test_scene(view, image, many + few, NULL, 0);
    return c;
}

void prune_case_free(struct prune_case *c)
{
    oxl_scene_free(test_ctx, c->scene);
    model_trained_free(test_ctx, &c->trained);
}
