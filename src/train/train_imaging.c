/* train_imaging.c - exposure, lamp and medium of a run: decides from the tracks (survey/photometry.c), before
 * the first step, whether each is fitted, and sets its initial values;
 * stores them in t->imaging after the last step.
 *
 * The fits are parts (src/parts). Invariant: what is off changes no byte of the result.
 */
#include "parts_calls.h"
#include "trained.h"
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
}

/* Measures what the tracks say. A fit without gains that are refused must show the same other parts as that
 * with them, which is kept otherwise: gains that jump hide a lamp, those that drift look like one. */
static oxl_result train_imaging_measure(struct train *t)
{
    const int parts = parts_tracks(t);
    struct photometry fit = {0}, *kept = &t->tracks;
    oxl_result rc;
    if (kept->requested && !(kept->parts & parts)) kept->requested = parts;
    if (kept->requested == parts) return OXL_OK;
    rc = photometry_measure(t->ctx, t->scene, parts, &fit);
    if (rc != OXL_OK) return rc;
    if (!kept->requested || fit.parts == (kept->parts & parts)) OXL_SWAP(struct photometry, *kept, fit);
    photometry_free(t->ctx, &fit);
    kept->requested = parts;
    return rc;
}

/* Measures again where gains are refused, so that lamp and medium have the values of a fit without them. */
static oxl_result train_imaging_use_tracks(struct train *t)
{
    const oxl_result rc = train_imaging_measure(t);
    struct oxl_imaging m;
    if (rc == OXL_OK) parts_use_tracks(t, &t->tracks);
    if (rc == OXL_OK && parts_tracks(t) != t->tracks.requested) return train_imaging_use_tracks(t);
    if (rc == OXL_OK) m = step_imaging(t), medium_bake(t->scene, &m, 1, &t->trained.model);
    return rc;
}

OXL_INTERNAL oxl_result train_imaging_begin(struct train *t)
{
    const oxl_result rc = train_imaging_measure(t);
    if (rc != OXL_OK) return rc;
    train_imaging_match_colours(t, t->tracks.colour);
    return train_imaging_use_tracks(t);
}

OXL_INTERNAL void train_imaging_store(struct train *t, oxl_model *model)
{
    struct oxl_imaging *to = t->imaging;
    imaging_free(t->ctx, to);
    if (!t->part[0]) return; /* there was no memory for the parts */
    PARTS_FOR(k, store) parts_at(k)->store(t, t->part[k], model);
    parts_form_image(t, to);
    to->medium.training_range = 0;
}
