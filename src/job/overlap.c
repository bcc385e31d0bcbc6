/* overlap.c - does a model belong to a survey? If it does, the survey's cameras see a surface of the model
 * about where they see the survey's points.
 *
 * Another origin, scale or frame moves the surface or empties the pixels. A warning, never an error: the
 * survey may be a part of the model's.
 */
#include "job.h"
#include "../survey/scene.h"

/* Bounds the fraction of the points with a surface of the model about them from below: some are hidden by
 * others. Models of the survey have 0.81 to 0.99, of other surveys 0.05 to 0.22. */
#define OVERLAP_LEAST 0.5
#define OVERLAP_FACTOR 1.5 /* Limits the ratio of the depths of a point and of the surface about it. */
enum {
    OVERLAP_POINTS = 20, /* least points that say anything */
    OVERLAP_VIEWS = 4,   /* views that are rendered */
    OVERLAP_SIDE = 160   /* px; longer side to which they are reduced */
};

struct overlap { /* Counts the points in the views. */
    size_t seen, fit;
};

static void overlap_count(const oxl_scene *scene, const oxl_camera *c, const float *depth, struct overlap *o)
{
    for (size_t i = 0; i < oxl_scene_point_count(scene); i++) {
        double at[3], x, y, ratio;
        camera_transform(c, oxl_scene_points(scene)[i].position, NULL, at);
        x = c->fx * at[0] / at[2] + c->cx, y = c->fy * at[1] / at[2] + c->cy;
        if (!(at[2] > 0 && x >= 0 && y >= 0 && x < c->width && y < c->height)) continue;
        ratio = (double)depth[(int)y * c->width + (int)x] / at[2];
        o->seen++;
        o->fit += ratio * OVERLAP_FACTOR > 1 && ratio < OVERLAP_FACTOR;
    }
}

static oxl_result overlap_view(oxl_context *ctx, const oxl_model *model, const oxl_scene *scene, int view,
                               struct overlap *o)
{
    oxl_render_options render = oxl_render_options_default();
    oxl_camera c = oxl_scene_view(scene, view)->camera;
    const double factor = OXL_MIN(1, (double)OVERLAP_SIDE / OXL_MAX(c.width, c.height));
    oxl_image image = {0};
    oxl_result rc;
    float *depth;
    c.width = (int)ceil(c.width * factor), c.height = (int)ceil(c.height * factor);
    c.fx *= factor, c.fy *= factor, c.cx *= factor, c.cy *= factor;
    render.near_plane = (float)oxl_scene_near_plane(scene);
    depth = oxl_alloc(ctx, (size_t)c.width * (size_t)c.height, sizeof *depth);
    rc = depth ? oxl_render(ctx, model, &c, &render, &image, depth) : OXL_ERR_MEMORY;
    if (rc == OXL_OK) overlap_count(scene, &c, depth, o);
    oxl_image_free(ctx, &image);
    oxl_free(ctx, depth);
    return rc;
}

oxl_result oxl_model_check_overlap(oxl_context *ctx, const oxl_model *model, const oxl_scene *scene,
                                   const char *name)
{
    const int views = oxl_scene_view_count(scene), asked = OXL_MIN(views, OVERLAP_VIEWS);
    struct overlap o = {0, 0};
    oxl_result rc = OXL_OK;
    for (int k = 0; k < asked && rc == OXL_OK; k++)
        rc = overlap_view(ctx, model, scene, (int)((2 * (long)k + 1) * views / (2 * asked)), &o);
    if (rc == OXL_OK && o.seen >= OVERLAP_POINTS && (double)o.fit < OVERLAP_LEAST * (double)o.seen)
        oxl_log(
            ctx, OXL_LOG_WARNING,
            "%s does not seem to cover the survey: only %.0f %% of the survey's points lie at a surface of it\n"
            "fix: compare it with the survey that it was trained on, from a file that keeps origin and scale (.ply, .spz)",
            name, 100 * (double)o.fit / (double)o.seen);
    return rc;
}
