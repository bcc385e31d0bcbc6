/* overlap.c - does a model belong to a survey? If it does, the survey's cameras see a surface of the model
 * about where they see the survey's points, and the model is about as wide as the points are.
 *
 * Another origin or frame moves the surface or empties the pixels; another scale changes the width, also
 * where the ground stays in its place. A warning, never an error: the survey may be a part of the model's.
 */
#include "job.h"
#include "../evaluate/evaluate.h"
#include "../render/render.h"
#include "../survey/scene.h"
#include "../survey/survey.h"

/* Bounds the fraction of the points with a surface of the model about them from below: some are hidden by
 * others. Models of the survey have 0.81 to 0.99, of other surveys 0.05 to 0.22. */
#define OVERLAP_LEAST 0.5
#define OVERLAP_FACTOR 1.5 /* Limits the ratio of the depths of a point and of the surface about it. */
/* Limits the ratio of the widths, of nearly all Gaussians and points: those of the background lie far out. */
#define OVERLAP_LARGE 1.7
#define OVERLAP_SMALL 0.7
enum {
    OVERLAP_POINTS = 20, /* least points that say anything */
    OVERLAP_VIEWS = 4    /* views that are rendered */
};

struct overlap { /* Counts the points in the views. */
    size_t seen, fit;
};

static void overlap_count(const oxl_scene *scene, const oxl_camera *c, const float *depth, struct overlap *o)
{
    for (size_t i = 0; i < scene->point_count; i++) {
        double x[3], pixel[2], ratio;
        if (!camera_sees(c, scene->point[i].position, x, pixel)) continue;
        ratio = (double)depth[(int)pixel[1] * c->width + (int)pixel[0]] / x[2];
        o->seen++;
        o->fit += ratio * OVERLAP_FACTOR > 1 && ratio < OVERLAP_FACTOR;
    }
}

static oxl_result overlap_width(oxl_context *ctx, const oxl_point *point, size_t count, double *width)
{
    double low[3], middle[3], high[3];
    const oxl_result rc = stats_bounds(ctx, point->position, count, sizeof *point, low, middle, high);
    *width = 0;
    for (int a = 0; a < 3 && rc == OXL_OK; a++) *width += (high[a] - low[a]) * (high[a] - low[a]);
    return rc;
}

/* Computes the ratio of the widths of the model and of the survey's points; 1: one of them has none. */
static oxl_result overlap_ratio(oxl_context *ctx, const oxl_model *model, const oxl_scene *scene,
                                double *ratio)
{
    oxl_point *own = oxl_calloc(ctx, model->count + 1, sizeof *own);
    double its = 0, of = 0;
    oxl_result rc = own ? OXL_OK : OXL_ERR_MEMORY;
    for (size_t i = 0; own && i < model->count; i++)
        for (int a = 0; a < 3; a++) own[i].position[a] = model->plane[OXL_MEAN + a][i];
    if (rc == OXL_OK) rc = overlap_width(ctx, own, model->count, &of);
    if (rc == OXL_OK) rc = overlap_width(ctx, scene->point, scene->point_count, &its);
    *ratio = its > 0 && of > 0 ? sqrt(of / its) : 1;
    oxl_free(ctx, own);
    return rc;
}

oxl_result oxl_model_check_overlap(oxl_context *ctx, const oxl_model *model, const oxl_scene *scene,
                                   const char *name)
{
    const int views = scene->view_count, asked = OXL_MIN(views, OVERLAP_VIEWS);
    const size_t points = scene->point_count;
    struct overlap o = {0, 0};
    struct drawn drawn = {.model = model, .scene = scene};
    struct unshown seen = {.depth = NULL};
    double ratio = 1;
    oxl_result rc = points && model->count ? overlap_ratio(ctx, model, scene, &ratio) : OXL_OK;
    if (rc == OXL_OK) rc = renderer_create(ctx, &drawn.r);
    for (int k = 0; k < asked && rc == OXL_OK; k++) {
        rc = unshown_draw(ctx, &drawn, (int)((2 * (long)k + 1) * views / (2 * asked)), &seen);
        if (rc == OXL_OK) overlap_count(scene, &seen.camera, seen.depth, &o);
    }
    renderer_free(ctx, drawn.r);
    oxl_free(ctx, seen.depth);
    if (rc == OXL_OK && o.seen >= OVERLAP_POINTS &&
        ((double)o.fit < OVERLAP_LEAST * (double)o.seen || ratio > OVERLAP_LARGE || ratio < OVERLAP_SMALL))
        oxl_log(
            ctx, OXL_LOG_WARNING,
            "%s does not seem to cover the survey: %.0f %% of the survey's points lie on its surface, and it is %.2g times as wide as they are\n"
            "fix: compare it with the survey that it was trained on, from a file that keeps origin and scale (.ply, .spz)",
            name, 100 * (double)o.fit / (double)o.seen, ratio);
    return rc;
}
