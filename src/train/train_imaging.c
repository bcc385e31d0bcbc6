/* train_imaging.c - exposure, lamp and medium of a run: decides from the tracks (survey/photometry.c), before
 * the first step, whether each is fitted (exposure may have a trial, too), and sets its initial values;
 * stores them in the scene after the last step.
 *
 * The fits are parts (src/parts). Invariant: what is off changes no byte of the result.
 */
#include "parts_calls.h"
#include "../survey/scene.h"

/* images and points differ by so much in a channel: first colours follow the images */
#define TRAIN_IMAGING_COLOUR 0.1

/* Scales the first colours to those of the images, also where the survey's points have others: images that
 * were corrected after COLMAP. */
static void train_imaging_match_colours(struct train *t, const double colour[3])
{
    double most = 0;
    for (int c = 0; c < 3; c++) {
        if (!(colour[c] > 0)) return;
        most = OXL_MAX(most, fabs(colour[c] - 1));
    }
    if (most < TRAIN_IMAGING_COLOUR) return;
    model_scale_colour(&t->trained.model, colour);
    oxl_log(
        t->ctx, OXL_LOG_INFO,
        "the images' colours are %.2f, %.2f, %.2f (red green blue) times those of the survey's points: Gaussians begin with "
        "the images'",
        colour[0], colour[1], colour[2]);
}

/* Gives what the tracks say to the scene, which a look leaves it to for the run behind it. */
static oxl_result train_imaging_measure(struct train *t)
{
    oxl_scene *scene = t->scene;
    const int parts = parts_tracks(t);
    if (scene->measured && scene->measured_parts == parts) return OXL_OK;
    if (scene->measured) photometry_free(t->ctx, scene->measured);
    else scene->measured = oxl_calloc(t->ctx, 1, sizeof *scene->measured);
    scene->measured_parts = parts;
    return scene->measured ? photometry_measure(t->ctx, scene, parts, scene->measured) : OXL_ERR_MEMORY;
}

OXL_INTERNAL oxl_result train_imaging_begin(struct train *t)
{
    const oxl_result rc = train_imaging_measure(t);
    struct imaging m = {0};
    if (rc == OXL_OK) train_imaging_match_colours(t, t->scene->measured->colour);
    if (rc == OXL_OK) parts_use_tracks(t, t->scene->measured);
    if (rc != OXL_OK || !t->is_look) scene_forget_look(t->ctx, t->scene);
    if (rc == OXL_OK) m = step_imaging(t);
    if (m.medium.on || m.lamps > 0) medium_bake(t->scene, &m, 1, &t->trained.model);
    return rc;
}

OXL_INTERNAL void train_imaging_describe(struct train *t)
{
    const struct imaging *m = &t->scene->imaging;
    const double span = scene_depth_span(t->scene);
    parts_describe(t);
    if ((m->medium.on || m->medium.has_falloff) && span < SCENE_DEPTH_SPAN_MIN)
        oxl_log(
            t->ctx, OXL_LOG_INFO,
            "the points' depths, without the nearest and the farthest tenth, span a factor of %.1f: medium and falloff are not identified, "
            "and scene_clear.ply is not measured colour",
            span);
}

OXL_INTERNAL void train_imaging_store(struct train *t, oxl_model *model)
{
    struct imaging *to = &t->scene->imaging;
    imaging_free(t->ctx, to);
    if (!t->part[0]) return; /* there was no memory for the parts */
    parts_store(t, model);
    parts_form_image(t, to);
    to->medium.training_range = 0;
}
