/* large_model.c - draws a model that may stay in its file: reads the rows that a view may show. */
#include "large.h"
#include "../evaluate/evaluate.h"
#include "../formats/formats.h"
#include "../render/render.h"

static oxl_result large_rows(oxl_context *ctx, const void *user, const oxl_camera *camera, double near_plane,
                             oxl_model *out)
{
    return model_pages_view(ctx, user, camera, near_plane, out);
}

OXL_INTERNAL struct render_source large_source(const oxl_large_model *large)
{
    struct render_source source = render_source_of(&large->model);
    if (large->pages) source.model = NULL, source.rows = large_rows, source.user = large;
    return source;
}

oxl_result oxl_large_render(oxl_context *ctx, const oxl_large_model *large, const oxl_camera *camera,
                            const oxl_render_options *options, oxl_image *out, float *depth)
{
    const struct render_source source = large_source(large);
    oxl_render_options own = oxl_render_options_default();
    memcpy(own.background, large->model.background, sizeof own.background);
    return render_source_once(ctx, &source, camera, options ? options : &own, out, depth);
}

oxl_result oxl_large_evaluate(oxl_context *ctx, const oxl_large_model *large, oxl_scene *scene,
                              oxl_split split, oxl_metrics *out)
{
    const struct render_source source = large_source(large);
    return evaluate_source(ctx, &source, scene, split, out);
}
