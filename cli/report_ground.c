/* report_ground.c - writes the survey and the model from above: the orthomosaic reduced to the page, ground
 * sampling distance, area and coverage.
 *
 * Lengths are in the survey's unit, or in metres with --scale.
 *
 * Invariant: without a survey, a model or points the page has no figure of the ground, and says so.
 */
#include "report_state.h"

#include <math.h>
#include <string.h>

/* px; longest side of the orthomosaic on the page, and of runs of fewer iterations than GROUND_SHORT, whose
 * page should take little of their time */
enum { GROUND_SIDE = 800, GROUND_SIDE_SHORT = 560, GROUND_SHORT = 1000 };
#define GROUND_LITTLE 0.6 /* Warns if a smaller share of the ground has a height. */

/* Reads the model that other viewers show, and renders it from above. */
static void ground_render(struct report *r)
{
    char path[4200];
    const int side =
        oxl_json_number(r->metrics, "iterations") < GROUND_SHORT ? GROUND_SIDE_SHORT : GROUND_SIDE;
    snprintf(path, sizeof path, "%s/scene.ply", r->out);
    if (oxl_model_read(r->silent, path, &r->viewed) != OXL_OK) return;
    oxl_model_move_origin(&r->viewed, oxl_scene_origin(r->survey_scene));
    if (oxl_scene_point_count(r->survey_scene) > 2 &&
        ortho_overview(r->silent, &r->viewed, r->survey_scene, side, &r->ground) != OXL_OK)
        oxl_image_free(r->silent, &r->ground.image);
}

int ground_view(struct report *r, const char *name, oxl_image *out)
{
    for (int v = 0; r->survey_scene && v < oxl_scene_view_count(r->survey_scene); v++)
        if (strcmp(oxl_scene_view(r->survey_scene, v)->name, name) == 0)
            return r->viewed.count > 0 &&
                   oxl_render(r->ctx, &r->viewed, &oxl_scene_view(r->survey_scene, v)->camera, NULL, out,
                              NULL) == OXL_OK;
    return 0;
}

void ground_open(struct report *r)
{
    oxl_scene_options options = r->options.scene;
    options.read_images = 0;
    options.allow_truncated = 1;
    if (!r->scene || oxl_context_create(NULL, &r->silent) != OXL_OK) return;
    if (oxl_scene_load(r->silent, r->scene, &options, &r->survey_scene) != OXL_OK) return;
    ground_render(r);
}

void ground_close(struct report *r)
{
    if (r->silent) oxl_image_free(r->silent, &r->ground.image);
    if (r->silent) oxl_model_free(r->silent, &r->viewed);
    oxl_scene_free(r->silent, r->survey_scene);
    oxl_context_free(r->silent);
}

/* Returns the decimals that show two digits or more of a value above 0. */
static int ground_digits(double value)
{
    return (int)fmin(9, fmax(0, 1 - floor(log10(value))));
}

void ground_tiles(struct report *r)
{
    struct output *t = &r->page;
    const double registered = oxl_json_number(r->survey, "images"),
                 left = oxl_json_number(r->survey, "images_unregistered"), unit = r->scale > 0 ? r->scale : 1,
                 area = unit * unit * r->ground.area;
    const char *words = r->scale > 0 ? "metres" : "units";
    output_add(t, "<div class=\"tile\"><b>%s</b><span>", OUTPUT_COUNT(registered));
    if (left >= 0) output_add(t, "of %s ", OUTPUT_COUNT(registered + left));
    output_add(t, "images with a camera</span></div>\n");
    if (!r->ground.image.rgb) return;
    if (r->ground.sampling > 0)
        output_add(t, "<div class=\"tile\"><b>%.*f</b><span>%s a pixel on the ground</span></div>\n",
                   ground_digits(unit * r->ground.sampling), unit * r->ground.sampling, words);
    output_add(t, "<div class=\"tile\"><b>%.*f</b><span>square %s of ground</span></div>\n",
               area < 100 ? 2 : 0, area, words);
    output_add(t, "<div class=\"tile\"><b>%.0f %%</b><span>of it in %d images or more</span></div>\n",
               100 * r->ground.covered, OVERVIEW_VIEWS);
}

void ground_section(struct report *r)
{
    struct output *t = &r->page;
    const struct overview *g = &r->ground;
    const double unit = r->scale > 0 ? r->scale : 1;
    const char *words = r->scale > 0 ? "metres" : "units";
    page_section(r, "Orthomosaic");
    if (!g->image.rgb) {
        output_add(
            t, "<p class=\"pale\">None: the survey or the model is not found, has no points, or is larger "
               "than the memory.</p>\n");
        return;
    }
    output_add(t, "<figure><img width=\"%d\" height=\"%d\" alt=\"Orthomosaic\" src=\"", g->image.width,
               g->image.height);
    page_jpeg(r, &g->image, 82);
    output_add(
        t,
        "\"><figcaption>The model from straight above, reduced. Empty: ground in fewer than %d training "
        "images, or none.</figcaption></figure>\n"
        "<p>%.0f %% of the ground that any image shows is in %d or more; <span class=\"%s\">%.0f %% has a "
        "surface clear enough for a height</span>. ",
        OVERVIEW_VIEWS, 100 * g->covered, OVERVIEW_VIEWS, g->high < GROUND_LITTLE ? "warn" : "",
        100 * g->high);
    if (g->height_error > 0 && g->distance > 0)
        output_add(t,
                   "Heights differ from the survey's points by %.*f %s in the median, %.2f %% of the "
                   "cameras' distance. ",
                   ground_digits(unit * g->height_error), unit * g->height_error, words,
                   100 * g->height_error / g->distance);
    output_add(t,
               "Lengths are in %s. For a GeoTIFF in full resolution, with heights: <code>oceanxl render %S",
               r->scale > 0 ? "metres, by --scale"
                            : "the survey's unit: metres if it is georeferenced, or with --scale",
               PRINT_WORD(r->out));
    output_add(t, " %S", PRINT_WORD(r->scene));
    report_survey_options(r);
    if (r->scale > 0) output_add(t, " --scale %s", oxl_json_number_text((char[48]){0}, r->scale));
    output_add(t, " -o map --ortho</code></p>\n");
}
