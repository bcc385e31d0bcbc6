/* overlap.c - does a model belong to a survey? If it does, the survey's cameras see a surface of the model
 * about where they see the survey's points.
 *
 * Another origin, frame or scale moves the surface or empties the pixels. A warning, never an error: the
 * survey may be a part of the model's.
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

oxl_result oxl_model_check_overlap(oxl_context *ctx, const oxl_model *model, const oxl_scene *scene,
                                   const char *name)
{
    const int views = scene->view_count, asked = scene->point_count ? OXL_MIN(views, OVERLAP_VIEWS) : 0;
    struct overlap o = {0, 0};
    struct drawn drawn = {.model = model, .scene = scene};
    struct unshown seen = {.depth = NULL};
    oxl_result rc = renderer_create(ctx, &drawn.r);
    for (int k = 0; k < asked && rc == OXL_OK; k++) {
        rc = unshown_draw(ctx, &drawn, (int)((2 * (long)k + 1) * views / (2 * asked)), &seen);
        if (rc == OXL_OK) overlap_count(scene, &seen.camera, seen.depth, &o);
    }
    renderer_free(ctx, drawn.r);
    oxl_free(ctx, seen.depth);
    if (rc == OXL_OK && o.seen >= OVERLAP_POINTS && (double)o.fit < OVERLAP_LEAST * (double)o.seen)
        oxl_log(
            ctx, OXL_LOG_WARNING,
            "%s does not seem to cover the survey: %.0f %% of the survey's points lie on its surface\n"
            "fix: compare it with the survey that it was trained on, from a file that keeps origin and scale (.ply, .spz)",
            name, 100 * (double)o.fit / (double)o.seen);
    return rc;
}
