/* render_model.c - the public functions: the image of a model, and the gradient of a scalar function of that
 * image. */
#include "renderer_state.h"

/* Copies the depth of the image rendered last. */
static oxl_result render_depth(oxl_context *ctx, struct renderer *r, float *depth)
{
    if (r->device) return r->backend->depth(r->device, depth);
    r->depth = depth;
    render_each_tile(ctx, r, NULL, raster_depth);
    r->depth = NULL;
    return OXL_OK;
}

static oxl_result render_view(oxl_context *ctx, struct renderer *r, const oxl_model *model,
                              const oxl_camera *camera, const oxl_render_options *options, oxl_image *out,
                              float *depth)
{
    const float *rgb = NULL;
    oxl_result rc = renderer_forward(ctx, r, model, camera, options);
    if (rc == OXL_OK) rc = renderer_image(r, &rgb);
    if (rc == OXL_OK) rc = oxl_image_create(ctx, camera->width, camera->height, out);
    if (rc == OXL_OK) {
        memcpy(out->rgb, rgb, 3 * (size_t)camera->width * camera->height * sizeof *out->rgb);
        if (depth) rc = render_depth(ctx, r, depth);
    }
    if (rc != OXL_OK) oxl_image_free(ctx, out);
    return rc;
}

static oxl_result render_check_camera(oxl_context *ctx, const oxl_camera *camera)
{
    if (camera->width >= 1 && camera->height >= 1) return OXL_OK;
    return oxl_fail(ctx, OXL_ERR_USAGE, "a camera of %d x %d px has no image", camera->width, camera->height);
}

OXL_INTERNAL oxl_result renderer_draw(oxl_context *ctx, struct renderer *r, const oxl_model *model,
                                      const oxl_camera *camera, const oxl_render_options *options,
                                      oxl_image *out, float *depth)
{
    oxl_result rc = render_check_camera(ctx, camera);
    *out = (oxl_image){0};
    if (rc != OXL_OK) return rc;
    rc = render_view(ctx, r, model, camera, options, out, depth);
    if (rc != OXL_OK && render_fall_back_to_cpu(ctx, r, rc, 1) == OXL_OK)
        rc = render_view(ctx, r, model, camera, options, out, depth);
    return rc;
}

static oxl_render_options render_options_on(const float *background)
{
    oxl_render_options o = oxl_render_options_default();
    memcpy(o.background, background, sizeof o.background);
    return o;
}

oxl_result oxl_render(oxl_context *ctx, const oxl_model *model, const oxl_camera *camera,
                      const oxl_render_options *options, oxl_image *out, float *depth)
{
    const oxl_render_options o = options ? *options : render_options_on(model->background);
    struct renderer *r = NULL;
    oxl_result rc = renderer_create(ctx, &r);
    *out = (oxl_image){0};
    if (rc == OXL_OK && o.parallel > 0) renderer_use_cpu(r);
    if (rc == OXL_OK) rc = renderer_draw(ctx, r, model, camera, &o, out, depth);
    renderer_free(ctx, r);
    return rc;
}

static oxl_result render_gradient(oxl_context *ctx, struct renderer *r, const oxl_model *model,
                                  const oxl_camera *camera, const oxl_render_options *options,
                                  const float *drgb, oxl_model *out)
{
    oxl_result rc = renderer_forward(ctx, r, model, camera, options);
    if (rc == OXL_OK) rc = oxl_model_create(ctx, model->count, model->sh_degree, out);
    if (rc == OXL_OK) {
        memset(out->plane[OXL_ROTATION], 0, out->capacity * sizeof *out->plane[0]);
        rc = renderer_backward(ctx, r, drgb, out);
    }
    if (rc == OXL_OK) rc = renderer_gradient(r, out);
    if (rc != OXL_OK) oxl_model_free(ctx, out);
    return rc;
}

oxl_result oxl_render_backward(oxl_context *ctx, const oxl_model *model, const oxl_camera *camera,
                               const oxl_render_options *options, const float *drgb, oxl_model *gradient)
{
    const oxl_render_options o = options ? *options : render_options_on(model->background);
    struct renderer *r = NULL;
    oxl_result rc = render_check_camera(ctx, camera);
    *gradient = (oxl_model){0};
    if (rc == OXL_OK) rc = renderer_create(ctx, &r);
    if (rc == OXL_OK && o.parallel > 0) renderer_use_cpu(r);
    if (rc == OXL_OK) rc = render_gradient(ctx, r, model, camera, &o, drgb, gradient);
    if (rc != OXL_OK && r && render_fall_back_to_cpu(ctx, r, rc, 1) == OXL_OK)
        rc = render_gradient(ctx, r, model, camera, &o, drgb, gradient);
    renderer_free(ctx, r);
    return rc;
}
