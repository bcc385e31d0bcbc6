/* overlap.c - does a model belong to a survey? If it does, these are alike: the boxes that hold nine tenths
 * of the survey's points and of the model's Gaussians along each axis, and what the survey's cameras see of
 * the model.
 *
 * Another origin moves the box away, another scale changes its size, another frame empties the pixels. A
 * warning, never an error: the survey may be a part of the model's.
 */
#include "job.h"
#include "../survey/scene.h"
#include "../survey/scene_alpha.h"
#include "../survey/survey.h"

/* Lists limits of a model that belongs to a survey. Twelve trained models have 1.0 to 1.1 of the diagonal, 95
 * to 99 % of the points and no empty pixel. */
/* Bounds the diagonal of the model's box from below, in diagonals of the survey's. */
#define OVERLAP_SMALL 0.75
/* Limits the diagonal of the model's box: Gaussians of the background lie far out. */
#define OVERLAP_LARGE 1.5
#define OVERLAP_INSIDE 0.6 /* Bounds the fraction of the survey's points in the model's box from below. */
#define OVERLAP_EMPTY 0.5  /* Limits the fraction of the pixels without a Gaussian. */
/* Limits the fraction of the pixels without a Gaussian for an object in front of a background: 0.65 of Lego's
 * pixels show only the background. */
#define OVERLAP_OBJECT 0.98
enum {
    OVERLAP_POINTS = 20, /* least points, or Gaussians, that have a box */
    OVERLAP_VIEWS = 4,   /* views that are rendered */
    OVERLAP_SIDE = 160   /* px; longer side to which they are reduced */
};

struct overlap_box { /* Holds nine tenths of the values along each axis. */
    double low[3], high[3];
};

static double overlap_diagonal(const struct overlap_box *box)
{
    double sum = 0;
    for (int a = 0; a < 3; a++) sum += (box->high[a] - box->low[a]) * (box->high[a] - box->low[a]);
    return sqrt(sum);
}

static void overlap_bound(double *value, size_t count, int axis, struct overlap_box *box)
{
    box->low[axis] = stats_select(value, count, 0.05);
    box->high[axis] = stats_select(value, count, 0.95);
}

/* Returns the fraction of the points in the box, which is widened by a tenth of its diagonal. */
static double overlap_inside(const struct overlap_box *box, const oxl_point *point, size_t count)
{
    const double margin = 0.1 * overlap_diagonal(box);
    size_t inside = 0;
    for (size_t i = 0; i < count; i++) {
        int in = 1;
        for (int a = 0; a < 3; a++)
            in &=
                point[i].position[a] >= box->low[a] - margin && point[i].position[a] <= box->high[a] + margin;
        inside += (size_t)in;
    }
    return (double)inside / (double)count;
}

/* Computes the fraction of the pixels of a few reduced views in which no Gaussian is met. */
static oxl_result overlap_empty(oxl_context *ctx, const oxl_model *model, const oxl_scene *scene,
                                double *fraction)
{
    const int views = oxl_scene_view_count(scene), asked = views < OVERLAP_VIEWS ? views : OVERLAP_VIEWS;
    oxl_render_options render = oxl_render_options_default();
    size_t empty = 0, all = 0;
    render.near_plane = (float)oxl_scene_near_plane(scene);
    for (int k = 0; k < asked; k++) {
        oxl_camera c = oxl_scene_view(scene, (int)((2 * (long)k + 1) * views / (2 * asked)))->camera;
        const int side = c.width > c.height ? c.width : c.height;
        const double factor = side > OVERLAP_SIDE ? (double)OVERLAP_SIDE / side : 1;
        const int width = (int)ceil(c.width * factor), height = (int)ceil(c.height * factor);
        oxl_image image = {0};
        float *depth = oxl_alloc(ctx, (size_t)width * (size_t)height, sizeof *depth);
        oxl_result rc = depth ? OXL_OK : OXL_ERR_MEMORY;
        c.width = width, c.height = height;
        c.fx *= factor, c.fy *= factor, c.cx *= factor, c.cy *= factor;
        if (rc == OXL_OK) rc = oxl_render(ctx, model, &c, &render, &image, depth);
        for (int i = 0; rc == OXL_OK && i < width * height; i++) empty += depth[i] == 0;
        all += (size_t)width * (size_t)height;
        oxl_image_free(ctx, &image);
        oxl_free(ctx, depth);
        if (rc != OXL_OK) return rc;
    }
    *fraction = all ? (double)empty / (double)all : 0;
    return OXL_OK;
}

/* Compares the sizes of the boxes, and the fraction of the survey's points in the model's box. */
static oxl_result overlap_compare(oxl_context *ctx, const oxl_model *model, const oxl_scene *scene,
                                  double *ratio, double *inside)
{
    const size_t points = oxl_scene_point_count(scene);
    const oxl_point *point = oxl_scene_points(scene);
    struct overlap_box its, own;
    double *value = oxl_alloc(ctx, OXL_MAX(points, model->count) + 1, sizeof *value);
    if (!value) return OXL_ERR_MEMORY;
    for (int a = 0; a < 3; a++) {
        for (size_t i = 0; i < points; i++) value[i] = point[i].position[a];
        overlap_bound(value, points, a, &its);
        for (size_t i = 0; i < model->count; i++) value[i] = model->plane[OXL_MEAN + a][i];
        overlap_bound(value, model->count, a, &own);
    }
    oxl_free(ctx, value);
    if (!(overlap_diagonal(&its) > 0)) return OXL_OK;
    *ratio = overlap_diagonal(&own) / overlap_diagonal(&its);
    *inside = overlap_inside(&own, point, points);
    return OXL_OK;
}

oxl_result oxl_model_check_overlap(oxl_context *ctx, const oxl_model *model, const oxl_scene *scene,
                                   const char *name)
{
    const double most_empty = scene_is_composited(scene) ? OVERLAP_OBJECT : OVERLAP_EMPTY;
    double ratio = 1, inside = 1, empty = 0;
    oxl_result rc = overlap_empty(ctx, model, scene, &empty);
    if (rc == OXL_OK && oxl_scene_point_count(scene) >= OVERLAP_POINTS && model->count >= OVERLAP_POINTS)
        rc = overlap_compare(ctx, model, scene, &ratio, &inside);
    if (rc == OXL_OK && model->count > 0 &&
        (ratio < OVERLAP_SMALL || ratio > OVERLAP_LARGE || inside < OVERLAP_INSIDE || empty > most_empty))
        oxl_log(
            ctx, OXL_LOG_WARNING,
            "%s does not seem to cover the survey: it is %.2g times as large, %.0f %% of the survey's points lie in it, "
            "and %.0f %% of the pixels show nothing\n"
            "fix: compare it with the survey that it was trained on, from a file that keeps origin and scale (.ply, .spz)",
            name, ratio, 100 * inside, 100 * empty);
    return rc;
}
