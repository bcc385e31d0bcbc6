/* free_space.c - removes Gaussians between a camera and the points that it observes.
 *
 * The views of a point's track see it, so the space between them and the point is free. A Gaussian there
 * explains what one image shows and veils others. For each training view a grid over its image holds, cell by
 * cell, the least depth of the tracks' points in the cell and its eight neighbours. At density control a
 * Gaussian goes if its centre projects into a cell of some view at less than FREE_SPACE_FRACTION of that
 * depth. A cell with points in fewer than FREE_SPACE_CELLS of the nine is unknown: thin objects without
 * points lie in such cells.
 *
 * Invariant: a function of the scene alone, so there is no state to archive. Without tracks nothing is
 * removed.
 */
#include "free_space.h"
#include "../core/option_rows.h"
#include "../survey/sparse.h"
#include "../survey/scene.h"
#include "../survey/tracks.h"

/* of the least depth: points are off, and surfaces swell towards the camera between them */
#define FREE_SPACE_FRACTION 0.7f
enum {
    /* views that a point must have been seen from: two rays almost always meet somewhere */
    FREE_SPACE_TRACK = 3,
    FREE_SPACE_CELLS = 5
};

/* Returns the cell that a position falls into, or -1. *z: camera z. */
static int free_space_cell(const oxl_camera *c, const double p[3], double *z)
{
    double x[3], pixel[2];
    const int ahead = camera_project(c, p, NULL, x, pixel);
    *z = x[2];
    if (!ahead) return -1;
    pixel[0] /= c->width, pixel[1] /= c->height;
    if (!(pixel[0] >= 0 && pixel[1] >= 0 && pixel[0] < 1 && pixel[1] < 1)) return -1;
    return (int)(pixel[1] * FREE_SPACE_GRID) * FREE_SPACE_GRID + (int)(pixel[0] * FREE_SPACE_GRID);
}

/* Sets each cell's depth to the least one of the tracks' points in it; 0: none. */
static void free_space_add_points(struct free_space *f, const oxl_scene *scene, const int *view_of)
{
    const struct colmap *c = scene_colmap(scene);
    const double *origin = oxl_scene_origin(scene);
    struct tracks_walk w = tracks_of(c, view_of);
    w.origin = origin;
    w.shortest = FREE_SPACE_TRACK;
    while (tracks_next(&w)) {
        const double *p = c->point[w.point].position;
        struct free_space_view *view = &f->view[w.view];
        double z;
        const int cell = free_space_cell(
            view->camera, (double[]){p[0] - origin[0], p[1] - origin[1], p[2] - origin[2]}, &z);
        if (cell >= 0 && (view->depth[cell] == 0 || z < view->depth[cell])) view->depth[cell] = (float)z;
    }
}

/* Returns FREE_SPACE_FRACTION of the least depth of a cell and its neighbours; 0: not known. */
static float free_space_limit(const float *depth, int x, int y)
{
    float least = FLT_MAX;
    int known = 0;
    for (int row = OXL_MAX(y - 1, 0); row <= OXL_MIN(y + 1, FREE_SPACE_GRID - 1); row++)
        for (int column = OXL_MAX(x - 1, 0); column <= OXL_MIN(x + 1, FREE_SPACE_GRID - 1); column++) {
            const float z = depth[row * FREE_SPACE_GRID + column];
            known += z > 0;
            if (z > 0) least = OXL_MIN(least, z);
        }
    return known >= FREE_SPACE_CELLS ? FREE_SPACE_FRACTION * least : 0;
}

OXL_INTERNAL oxl_result free_space_begin(oxl_context *ctx, struct free_space *f, const oxl_scene *scene)
{
    const struct colmap *c = scene_colmap(scene);
    const int views = oxl_scene_view_count(scene);
    int *view_of; /* (images) index in f->view */
    if (!c || c->track_count == 0) return OXL_OK;
    if (!(view_of = scene_views_by_image(ctx, scene, OXL_SPLIT_TRAIN))) return ctx->failed;
    f->view = oxl_calloc(ctx, (size_t)views + 1, sizeof *f->view);
    if (!f->view) {
        oxl_free(ctx, view_of);
        return OXL_ERR_MEMORY;
    }
    for (int i = 0; i < views; i++) {
        if (oxl_scene_view(scene, i)->is_test) continue;
        view_of[scene_source_image(scene, i) - c->image] = (int)f->views;
        f->view[f->views++].camera = &oxl_scene_view(scene, i)->camera;
    }
    free_space_add_points(f, scene, view_of);
    oxl_free(ctx, view_of);
    for (size_t v = 0; v < f->views; v++) {
        float depth[FREE_SPACE_GRID * FREE_SPACE_GRID];
        memcpy(depth, f->view[v].depth, sizeof depth);
        for (int k = 0; k < FREE_SPACE_GRID * FREE_SPACE_GRID; k++)
            f->view[v].depth[k] = free_space_limit(depth, k % FREE_SPACE_GRID, k / FREE_SPACE_GRID),
            f->view[v].most = OXL_MAX(f->view[v].most, f->view[v].depth[k]);
    }
    return OXL_OK;
}

OXL_INTERNAL void free_space_free(struct train *t, void *state)
{
    oxl_free(t->ctx, ((struct free_space *)state)->view);
}

OXL_INTERNAL int free_space_contains(const struct free_space *f, const double p[3])
{
    for (size_t v = 0; v < f->views; v++) {
        const double *r = f->view[v].camera->rotation + 6;
        double z = f->view[v].camera->translation[2] + r[0] * p[0] + r[1] * p[1] + r[2] * p[2];
        /* Beyond all of the view's depths, as most positions are, no cell is needed. */
        const int cell = z > 0 && z < f->view[v].most ? free_space_cell(f->view[v].camera, p, &z) : -1;
        if (cell >= 0 && z < f->view[v].depth[cell]) return 1;
    }
    return 0;
}

OXL_INTERNAL oxl_result free_space_carve(oxl_context *ctx, const struct free_space *f, const oxl_model *model,
                                         uint8_t **carved)
{
    *carved = f->view ? oxl_alloc(ctx, model->count, sizeof **carved) : NULL;
    if (!*carved) return f->view ? OXL_ERR_MEMORY : OXL_OK;
#pragma omp parallel for schedule(static) num_threads(ctx->threads)
    for (int64_t i = 0; i < (int64_t)model->count; i++) {
        double p[3];
        for (int a = 0; a < 3; a++) p[a] = model->plane[OXL_MEAN + a][i];
        (*carved)[i] = (uint8_t)free_space_contains(f, p);
    }
    return OXL_OK;
}

OXL_INTERNAL void free_space_describe(const struct free_space *f, char *out, size_t size)
{
    size_t known = 0;
    for (size_t v = 0; v < f->views; v++)
        for (int k = 0; k < FREE_SPACE_GRID * FREE_SPACE_GRID; k++) known += f->view[v].depth[k] > 0;
    if (!f->view) snprintf(out, size, "as set, or no tracks");
    else
        snprintf(out, size, "tracks bound the free space in %.0f %% of the cells of %zu training views",
                 100.0 * (double)known / (FREE_SPACE_GRID * FREE_SPACE_GRID) / (double)OXL_MAX(f->views, 1),
                 f->views);
}

/* ---------------- the part */

static oxl_result free_space_part_begin(struct train *t, void *state)
{
    return t->options->carve ? free_space_begin(t->ctx, state, t->scene) : OXL_OK;
}

static oxl_result free_space_before_density(struct train *t, void *state, struct density_rules *rules)
{
    struct free_space *f = state;
    const oxl_result rc = free_space_carve(t->ctx, f, &t->trained.model, &f->carved);
    rules->unwanted = f->carved;
    return rc;
}

static void free_space_after_density(struct train *t, void *state)
{
    struct free_space *f = state;
    oxl_free(t->ctx, f->carved);
    f->carved = NULL;
}

static void free_space_record(struct train *t, void *state)
{
    const struct free_space *f = state;
    char why[320];
    free_space_describe(f, why, sizeof why);
    selection_record(t, "carve", f->view ? "on" : "off", why);
}

/* clang-format off */
static const oxl_option free_space_options[] = {
{"carve", "off|on", OXL_OPTION_CHOICE, OPTION_AT(train.carve), 0, 1, PRESETS("on", "off", "off"), OXL_TIER_ADVANCED, TRAINING | RESULT | NOT_LOOKED, "Scene content", "remove Gaussians between a camera and the points that it observes", NULL},
{0}};
/* clang-format on */

OXL_INTERNAL const struct part part_free_space = {.name = "free_space",
                                                  .size = sizeof(struct free_space),
                                                  .option = free_space_options,
                                                  .begin = free_space_part_begin,
                                                  .free = free_space_free,
                                                  .before_density = free_space_before_density,
                                                  .after_density = free_space_after_density,
                                                  .record = free_space_record};
