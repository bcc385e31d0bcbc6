/* evaluate.c - compares a model's renders with a survey's images, view by view. */
#include "evaluate.h"
#include "../render/render.h"
#include "../survey/scene.h"
#include "../survey/survey.h"

/* ---------------- a view as its image was taken */

/* Returns the model's background, or the scene's if the model has none. */
static void evaluate_background(const oxl_model *model, const oxl_scene *scene, float out[3])
{
    scene_background(scene, model->has_background ? model->background : NULL, out);
}

OXL_INTERNAL void evaluate_begin(oxl_context *ctx, const oxl_model *model, const oxl_scene *scene)
{
    float background[3];
    evaluate_background(model, scene, background);
    scene_set_background(ctx, scene, background);
}

static oxl_render_options evaluate_options(const struct drawn *d)
{
    oxl_render_options options = render_options_of(d->scene);
    evaluate_background(d->model, d->scene, options.background);
    return options;
}

/* Renders a view with the medium, without lamp and gains. */
static oxl_result evaluate_draw_medium(oxl_context *ctx, const struct drawn *d, const oxl_camera *camera,
                                       oxl_image *out, float *depth)
{
    const oxl_render_options options = evaluate_options(d);
    if (d->imaging) renderer_settings(d->r)->medium = d->imaging->medium;
    return renderer_draw(ctx, d->r, d->model, camera, &options, out, depth);
}

/* Applies the lamp and the gains of a view. */
static oxl_result evaluate_light(oxl_context *ctx, const struct drawn *d, int view, oxl_image *image)
{
    const oxl_result rc = imaging_apply_lamp(ctx, d->scene, d->imaging, view, image);
    if (rc == OXL_OK) imaging_apply(d->imaging, view, image);
    return rc;
}

OXL_INTERNAL oxl_result evaluate_draw(oxl_context *ctx, const struct drawn *d, int view, oxl_image *out,
                                      float *depth)
{
    const oxl_camera camera = scene_camera(d->scene, d->imaging, view);
    const oxl_result rc = evaluate_draw_medium(ctx, d, &camera, out, depth);
    return rc == OXL_OK && d->imaging ? evaluate_light(ctx, d, view, out) : rc;
}

oxl_result oxl_render_view(oxl_context *ctx, const oxl_model *model, const oxl_scene *scene, int view,
                           const oxl_imaging *imaging, oxl_image *out, float *depth)
{
    struct renderer *r = NULL;
    oxl_result rc;
    *out = (oxl_image){0};
    if (view < 0 || view >= scene->view_count)
        return oxl_fail(ctx, OXL_ERR_USAGE, "view %d does not exist: the scene has %d views", view,
                        scene->view_count);
    rc = imaging_check_scene(ctx, scene, imaging);
    if (rc == OXL_OK) rc = renderer_create(ctx, &r);
    if (rc == OXL_OK) rc = evaluate_draw(ctx, &(struct drawn){r, model, scene, imaging}, view, out, depth);
    renderer_free(ctx, r);
    return rc;
}

/* ---------------- what is measured of a view */

/* Holds what the evaluation of all views shares. */
struct evaluate_pass {
    struct drawn of;         /* imaging: not NULL */
    int whole, plain;        /* of evaluate_part: whole 0; plain 1 without a limit */
    int most;                /* evaluates so many views, evenly spaced */
    oxl_model gradient;      /* gradient of the model, for aligned views */
    int missing;             /* images whose files are gone */
    struct unshown *unshown; /* of the next view; NULL: not asked for */
};

static oxl_result evaluate_compare(oxl_context *ctx, const struct evaluate_pass *p, oxl_image *rendered,
                                   const oxl_image *image, oxl_view_metrics *row)
{
    oxl_result rc = OXL_OK;
    if (p->whole || p->plain) rc = oxl_psnr(ctx, rendered, image, &row->plain_psnr);
    if (rc == OXL_OK) rc = evaluate_light(ctx, &p->of, row->view, rendered);
    if (rc == OXL_OK) rc = oxl_psnr(ctx, rendered, image, &row->psnr);
    if (rc == OXL_OK && (p->whole || p->plain)) rc = oxl_ssim(ctx, rendered, image, &row->ssim);
    if (rc != OXL_OK || p->plain) return rc;
    rc = oxl_cc_psnr(ctx, rendered, image, &row->cc_psnr);
    return rc == OXL_OK ? oxl_structure(ctx, rendered, image, &row->structure) : rc;
}

/* Measures a held-out view again from the pose at which its image fits best, if poses of
 * training views were refined. */
static oxl_result evaluate_aligned(oxl_context *ctx, struct evaluate_pass *p, const oxl_image *image,
                                   oxl_view_metrics *row)
{
    const oxl_render_options options = evaluate_options(&p->of);
    const oxl_model *model = p->of.model;
    oxl_image rendered = {0};
    oxl_camera camera;
    oxl_result rc = OXL_OK;
    if (!p->gradient.memory) rc = oxl_model_create(ctx, model->count, model->sh_degree, &p->gradient);
    if (rc == OXL_OK) rc = align_view(ctx, &p->of, row->view, image, &options, &p->gradient, &camera);
    if (rc == OXL_OK) rc = evaluate_draw_medium(ctx, &p->of, &camera, &rendered, NULL);
    if (rc == OXL_OK) rc = evaluate_light(ctx, &p->of, row->view, &rendered);
    if (rc == OXL_OK) rc = oxl_psnr(ctx, &rendered, image, &row->aligned_psnr);
    if (rc == OXL_OK) rc = oxl_ssim(ctx, &rendered, image, &row->aligned_ssim);
    oxl_image_free(ctx, &rendered);
    return rc;
}

static int evaluate_aligns(const struct evaluate_pass *p, int view)
{
    return p->of.imaging->pose && p->whole && !renderer_has_device(p->of.r) &&
           p->of.scene->view[view].is_test;
}

static oxl_result evaluate_view(oxl_context *ctx, struct evaluate_pass *p, const oxl_image *image,
                                oxl_view_metrics *row)
{
    const oxl_camera camera = scene_camera(p->of.scene, p->of.imaging, row->view);
    oxl_image rendered = {0};
    oxl_result rc = evaluate_draw_medium(ctx, &p->of, &camera, &rendered, NULL);
    if (rc == OXL_OK) rc = evaluate_compare(ctx, p, &rendered, image, row);
    if (rc == OXL_OK && p->unshown) rc = unshown_measure(ctx, p->unshown, &rendered, image, row);
    if (rc == OXL_OK && evaluate_aligns(p, row->view)) rc = evaluate_aligned(ctx, p, image, row);
    oxl_image_free(ctx, &rendered);
    return rc;
}

/* Adds a view's row; logs and leaves out an unreadable, missing or completely masked image, as training does,
 * unless too many are missing. */
static oxl_result evaluate_add_view(oxl_context *ctx, struct evaluate_pass *p, int view, oxl_metrics *out)
{
    oxl_image image = {0};
    oxl_view_metrics row = {
        .view = view, .ssim = NAN, .aligned_psnr = NAN, .aligned_ssim = NAN, .shown_psnr = NAN};
    oxl_result rc = scene_copy_image(ctx, p->of.scene, view, &image);
    if (rc == OXL_OK) rc = evaluate_view(ctx, p, &image, &row);
    oxl_image_free(ctx, &image);
    if (rc == OXL_OK) out->views[out->count++] = row;
    if (rc != OXL_ERR_INPUT && (rc != OXL_ERR_IO || scene_misses_too_many(p->of.scene, ++p->missing)))
        return rc;
    oxl_log(ctx, OXL_LOG_WARNING, "%s: %s; the view is left out of the evaluation",
            p->of.scene->view[view].name, oxl_error_text(ctx));
    return OXL_OK;
}

/* Averages the values over the views that have them. */
static void evaluate_sum_up(oxl_metrics *m)
{
    int with = 0, shown = 0;
    m->structure_least = NAN;
    m->aligned_psnr = m->aligned_ssim = m->count ? 0 : NAN;
    for (int i = 0; i < m->count; i++) {
        const oxl_view_metrics *v = &m->views[i];
        m->psnr += v->psnr / m->count;
        m->plain_psnr += v->plain_psnr / m->count;
        m->cc_psnr += v->cc_psnr / m->count;
        m->ssim += v->ssim / m->count;
        m->aligned_psnr += v->aligned_psnr / m->count;
        m->aligned_ssim += v->aligned_ssim / m->count;
        for (int k = 0; k < 4; k++) m->unshown += v->unshown[k] / m->count;
        if (!isnan(v->shown_psnr)) m->shown_psnr += v->shown_psnr, shown++;
        if (isnan(v->structure)) continue;
        m->structure += v->structure;
        m->structure_least = with++ ? OXL_MIN(m->structure_least, v->structure) : v->structure;
        m->no_structure += v->structure < OXL_STRUCTURE_NONE;
    }
    m->structure = with ? m->structure / with : NAN;
    m->shown_psnr = shown ? m->shown_psnr / shown : NAN;
}

/* Evaluates the views of a split. */
static oxl_result evaluate_views(oxl_context *ctx, struct evaluate_pass p, oxl_split split, oxl_metrics *out)
{
    static const struct oxl_imaging none;
    const oxl_scene *scene = p.of.scene;
    const size_t room = (size_t)scene->view_count + 1;
    struct unshown *unshown = NULL;
    oxl_result rc = imaging_check_scene(ctx, scene, p.of.imaging);
    int *view = oxl_alloc(ctx, room, sizeof *view), count = 0, all = 0;
    *out = (oxl_metrics){.views = oxl_alloc(ctx, room, sizeof *out->views)};
    if (!view || !out->views) rc = OXL_ERR_MEMORY;
    if (rc == OXL_OK) all = scene_views_of(scene, split, view), count = OXL_MIN(all, p.most);
    for (int i = 0; i < count; i++) view[i] = view[(int)((int64_t)i * all / count)];
    if (rc == OXL_OK) rc = renderer_create(ctx, &p.of.r);
    evaluate_begin(ctx, p.of.model, scene);
    if (!p.of.imaging) p.of.imaging = &none;
    if (p.whole && split == OXL_SPLIT_TEST && rc == OXL_OK) {
        unshown = oxl_calloc(ctx, room, sizeof *unshown);
        rc = unshown ? unshown_find(ctx, &p.of, view, count, unshown) : OXL_ERR_MEMORY;
    }
    for (int i = 0; i < count && rc == OXL_OK; i++) {
        rc = context_stopped(ctx);
        scene_images_ahead(ctx, scene, view + i, count - i);
        p.unshown = unshown ? &unshown[i] : NULL;
        if (rc == OXL_OK) rc = evaluate_add_view(ctx, &p, view[i], out);
    }
    unshown_free(ctx, unshown, count);
    renderer_free(ctx, p.of.r);
    oxl_model_free(ctx, &p.gradient);
    oxl_free(ctx, view);
    evaluate_sum_up(out);
    if (rc != OXL_OK) oxl_metrics_free(ctx, out);
    return rc;
}

oxl_result oxl_evaluate(oxl_context *ctx, const oxl_model *model, const oxl_scene *scene,
                        const oxl_imaging *imaging, oxl_split split, oxl_metrics *out)
{
    const struct evaluate_pass p = {.of = {NULL, model, scene, imaging}, .whole = 1, .most = INT_MAX};
    return evaluate_views(ctx, p, split, out);
}

OXL_INTERNAL oxl_result evaluate_part(oxl_context *ctx, const struct drawn *d, oxl_split split, int most,
                                      oxl_metrics *out)
{
    const struct evaluate_pass p = {.of = *d, .plain = most == 0, .most = most ? most : INT_MAX};
    return evaluate_views(ctx, p, split, out);
}

void oxl_metrics_free(oxl_context *ctx, oxl_metrics *metrics)
{
    if (!metrics) return;
    oxl_free(ctx, metrics->views);
    *metrics = (oxl_metrics){0};
}
