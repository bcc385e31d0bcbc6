/* report.c - writes report.html: quality, map, worst views, decisions with evidence, curves and the command that
 * repeats a run, on one page.
 *
 * It reads OUT's run.json, metrics.json, blocks/KKK/{block.json,log.csv}, renders/,
 * training_views/ and scene.ply, and the survey for the map.
 *
 * Invariant: every figure on the page is from one of these files; what is absent is left out or reported as
 * missing.
 */
#include "report.h"
#include "../tools/tools.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    REPORT_BLOCKS = 100000,
    REPORT_SIDE = 800,  /* px; longest side of the map, */
    REPORT_SHORT = 560, /* and of runs of fewer iterations than REPORT_QUICK, whose page should be quick */
    REPORT_QUICK = 1000,
    REPORT_CAMERAS = 2000, /* cameras on the map, about */
    REPORT_VIEWS = 2       /* least training views that see a place of the map */
};
#define REPORT_VIEWER_LOSS 0.5 /* dB; a loss of images without gains and lamp that is worth a word */

/* ---------------- reading */

static void report_read_part(struct report *r, const char *name, const char *folder)
{
    struct report_part *p = &r->part[r->parts];
    char path[4200];
    snprintf(path, sizeof path, "%s/blocks/%s", r->out, folder);
    snprintf(p->name, sizeof p->name, "%s", name);
    p->json = output_read(path, "block.json");
    p->log = p->json ? output_read(path, "log.csv") : NULL;
    r->parts += p->json != NULL;
}

static void report_open(struct report *r)
{
    const double blocks = oxl_json_number(r->run, "blocks");
    r->job = oxl_json_member(r->run, "job");
    r->survey = oxl_json_member(r->run, "survey");
    r->scene = json_string(oxl_json_member(oxl_json_member(r->run, "inputs"), "scene"));
    r->metrics = output_read(r->out, "metrics.json");
    r->options = oxl_job_options_default(OXL_PRESET_DRAFT);
    if (r->scene) oxl_job_resume(r->ctx, r->scene, r->out, &r->options, &r->manifest);
    r->blocks = blocks >= 1 && blocks <= REPORT_BLOCKS ? (int)blocks : 1;
    r->part = calloc((size_t)r->blocks + 2, sizeof *r->part);
    if (!r->part) r->page.failed = 1;
    for (int k = 0; r->part && k < r->blocks; k++) {
        char name[40], folder[16];
        snprintf(folder, sizeof folder, "%03d", k);
        snprintf(name, sizeof name, "block %d", k);
        report_read_part(r, name, folder);
    }
    if (r->part && r->blocks > 1) {
        report_read_part(r, "coarse model", "coarse");
        report_read_part(r, "merged model", "whole");
    }
}

static void report_close(struct report *r)
{
    for (int k = 0; r->part && k < r->blocks + 2; k++) {
        free(r->part[k].json);
        free(r->part[k].log);
    }
    oxl_manifest_free(r->ctx, &r->manifest);
    free(r->part);
    free(r->run);
    free(r->scene);
    free(r->metrics);
    free(r->page.data);
}

/* ---------------- at the top */

/* Adds a figure, if it is there: with decimals, or as a count, of bytes or seconds. */
static void report_tile(struct report *r, const char *json, const char *member, char kind, const char *what)
{
    const double value = oxl_json_number(json, member);
    char text[40];
    if (isnan(value)) return;
    if (kind == 'c') output_count(text, value);
    else if (kind == 'b') output_size(text, value);
    else if (kind == 's') output_seconds(text, value);
    else output_fixed(text, value, kind - '0');
    output_add(&r->page, "<div class=\"tile\"><b>%s</b><span>%s</span></div>\n", text, what);
}

static void report_head(struct report *r)
{
    struct output *t = &r->page;
    const int finished = oxl_json_is_true(r->run, "finished");
    const char *name = r->scene ? r->scene : r->out;
    page_open(t, name);
    output_add(
        t,
        "<header><span class=\"pale\">OceanXL report</span><h1>%S</h1>\n<span class=\"mark %s\">%s</span> "
        "<span class=\"pale\">%s iterations, %d block%s</span></header>\n<div class=\"tiles\">\n",
        name, finished ? "good" : "warn",
        finished ? "finished" : "not finished: run the same command again to resume",
        OUTPUT_COUNT(oxl_json_number(r->run, "iterations_done")), r->blocks, r->blocks == 1 ? "" : "s");
    report_tile(r, r->metrics, "psnr", '2', "dB mean PSNR");
    if (oxl_json_number(r->metrics, "unshown") >= REPORT_GAP)
        report_tile(r, r->metrics, "shown_psnr", '2', "dB over pixels whose place a training view shows");
    if (oxl_json_number(r->metrics, "psnr") - oxl_json_number(r->metrics, "plain_psnr") >= REPORT_VIEWER_LOSS)
        report_tile(r, r->metrics, "plain_psnr", '2', "dB in other viewers (scene.ply alone)");
    report_tile(r, r->metrics, "ssim", '3', "mean SSIM");
    report_tile(r, r->metrics, "structure", '3', "mean structure: correlation of detail, 0 is haze");
    report_tile(r, r->metrics, "gaussians", 'c', "Gaussians");
    report_tile(r, r->metrics, "bytes", 'b', "model");
    report_tile(r, r->metrics, "seconds", 's', "training time");
    report_tile(r, r->metrics, "peak_rss_bytes", 'b', "peak memory");
    report_tile(r, r->survey, "images", 'c', "images with poses");
    report_tile(r, r->survey, "images_unregistered", 'c', "images without poses");
    output_add(t, "</div>\n");
}

/* ---------------- warnings, decisions */

/* Adds the warnings among the log lines of the job or a part. Returns how many. */
static int report_notes(struct output *t, const char *name, const char *json)
{
    int count = 0;
    for (const char *e = oxl_json_first(oxl_json_member(json, "notes")); e; e = oxl_json_next(e)) {
        const char *level = oxl_json_member(e, "level");
        if (!level || strncmp(level, "\"warning\"", 9) != 0) continue;
        output_add(t, "<li>%s%s%J</li>\n", name, name[0] ? ": " : "", oxl_json_member(e, "text"));
        count++;
    }
    return count;
}

static void report_warnings(struct report *r)
{
    struct output *t = &r->page;
    int count;
    output_add(t, "<section>\n<h2>Warnings</h2>\n<ul>\n");
    if (!r->metrics) output_add(t, "<li>Not evaluated yet.</li>\n");
    else if (oxl_json_number(r->survey, "test_views") <= 0)
        output_add(t, "<li>no view is held out: the metrics are of training views (--test-every 8 holds out "
                      "every 8th image)</li>\n");
    count = report_notes(t, "", r->run);
    for (int k = 0; k < r->parts; k++)
        count += report_notes(t, r->blocks > 1 ? r->part[k].name : "", r->part[k].json);
    output_add(t, "</ul>\n%s</section>\n", count > 0 ? "" : "<p>The run gave none.</p>\n");
}

/* Returns the name on the page of a decision, with the option that sets it (docs/OPTIONS.md); key: a member of JSON, with
 * its quotes. */
static const char *report_title(const char *key)
{
    static const char *const titles[] = {"partition\"blocks (--partition)",
                                         "ucd\"depth weights (--ucd)",
                                         "dog\"second lobes (--dog)",
                                         "keep\"Gaussians after pruning (--keep)",
                                         "ssim_contrast\"contrast constant of SSIM",
                                         "dropout\"share of Gaussians left out (--dropout)",
                                         "exposure\"gain of each image (--exposure)",
                                         "medium\"water (--medium)",
                                         "lamp\"lamp or vignetting (--lamp)",
                                         "poses\"refined poses (--poses)"};
    const size_t size = strcspn(key + 1, "\"") + 1;
    for (int k = 0; k < 10; k++)
        if (!strncmp(key + 1, titles[k], size)) return titles[k] + size;
    return "decision of another version";
}

/* Adds each decision of the job or a part that has evidence. */
static void report_decision(struct output *t, const char *name, const char *json)
{
    for (const char *key = oxl_json_first(oxl_json_member(json, "decisions")); key;) {
        const char *value = oxl_json_value(key), *evidence = oxl_json_member(value, "evidence");
        if (evidence && strncmp(evidence, "\"\"", 2) != 0)
            output_add(t, "<dt>%s</dt><dd>%J<small>%s%s%J</small></dd>\n", report_title(key),
                       oxl_json_member(value, "chosen"), name, name[0] ? ": " : "", evidence);
        key = value ? oxl_json_next(value) : NULL;
    }
}

static void report_decisions(struct report *r)
{
    struct output *t = &r->page;
    output_add(t, "<section>\n<h2>Decisions and evidence</h2>\n<dl>\n");
    report_decision(t, "", r->run);
    for (int k = 0; k < r->parts; k++)
        report_decision(t, r->blocks > 1 ? r->part[k].name : "", r->part[k].json);
    output_add(t, "</dl>\n</section>\n");
}

/* ---------------- the map */

/* Writes the image of a map, and the cameras over it as circles; the drawing is large enough for all. */
static void report_draw_map(struct report *r, const struct map *m, const oxl_image *image)
{
    struct output *t = &r->page;
    const oxl_scene *scene = m->surface->scene;
    const int views = oxl_scene_view_count(scene);
    double low[2] = {0, 0}, high[2] = {m->width, m->height}, eye[3];
    struct output circles = {0};
    for (int v = 0; v < views; v += 1 + views / REPORT_CAMERAS) {
        const oxl_view *view = oxl_scene_view(scene, v);
        double at[2];
        frame_eye(&view->camera, eye);
        similarity_apply(&m->to, eye, eye);
        at[0] = (eye[0] - m->corner[0]) / m->pixel, at[1] = (m->corner[1] - eye[1]) / m->pixel;
        for (int d = 0; d < 2; d++) low[d] = fmin(low[d], at[d] - 8), high[d] = fmax(high[d], at[d] + 8);
        output_add(&circles, "<circle cx=\"%.1f\" cy=\"%.1f\" r=\"3\"%s><title>%S</title></circle>\n", at[0],
                   at[1], view->is_test ? " class=\"test\"" : "", view->name);
    }
    output_add(t,
               "<figure><svg class=\"map\" viewBox=\"%.0f %.0f %.0f %.0f\" role=\"img\" aria-label=\"Map\">"
               "<image width=\"%d\" height=\"%d\" href=\"",
               low[0], low[1], high[0] - low[0], high[1] - low[1], m->width, m->height);
    page_jpeg(r, image);
    output_add(t, "\"/>\n%s</svg>\n", circles.data ? circles.data : "");
    free(circles.data);
}

/* Returns a length with two digits or more. */
static const char *report_length(char out[32], double value)
{
    return output_fixed(out, value, value > 0 ? (int)fmin(9, fmax(0, 1 - floor(log10(value)))) : 0);
}
#define REPORT_LENGTH(value) report_length((char[32]){0}, value)

static void report_map(struct report *r, const struct map *m)
{
    struct output *t = &r->page;
    static const float empty[3] = {0.035f, 0.10f, 0.14f};
    const size_t plane = (size_t)m->width * m->height;
    oxl_image image;
    if (oxl_image_create(r->ctx, m->width, m->height, &image) != OXL_OK) return;
    for (size_t i = 0; i < 3 * plane; i++)
        image.rgb[i] = isnan(m->colour[i]) ? empty[i / plane] : m->colour[i];
    report_draw_map(r, m, &image);
    oxl_image_free(r->ctx, &image);
    output_add(
        t,
        "<figcaption>The model from above, reduced. Blank areas have no ground, or fewer than %d training "
        "images show it. Dots are cameras: white of training views, yellow of held-out views.</figcaption>"
        "</figure>\n<p>An image pixel covers %s %s on the ground, and the map %s square %s. Of the ground that any image shows, %.0f %% is "
        "in %d images or more, and %.0f %% has a height. ",
        REPORT_VIEWS, REPORT_LENGTH(m->sampling), r->words, REPORT_LENGTH(m->area), r->words,
        100 * m->covered, REPORT_VIEWS, 100 * m->high);
    if (m->off.median > 0)
        output_add(t,
                   "Heights differ from the sparse points by %s %s in the median, %.2f %% of the cameras' "
                   "distance. ",
                   REPORT_LENGTH(m->off.median), r->words, 100 * m->off.median / m->off.distance);
    if (m->down < MAP_DOWN)
        output_add(
            t,
            "The cameras look more along this map than down on it; <code>--frame survey</code> maps the plane of the points. ");
    output_add(t, "<code>oceanxl render %S", PRINT_WORD(r->out));
    output_add(t, " %S -o map --ortho</code> writes it in full resolution.</p>\n", PRINT_WORD(r->scene));
}

/* Loads the survey and the model without a log, as the run has logged its warnings already, and draws the
 * map. */
static void report_ground(struct report *r)
{
    oxl_scene_options options = r->options.scene;
    oxl_model model = {0};
    struct surface surface = {0};
    struct map m = {.enough = REPORT_VIEWS, .surface = &surface};
    oxl_context *ctx = NULL;
    oxl_scene *scene = NULL;
    char path[4200];
    m.side = oxl_json_number(r->metrics, "iterations") < REPORT_QUICK ? REPORT_SHORT : REPORT_SIDE;
    snprintf(path, sizeof path, "%s/scene.ply", r->out);
    options.read_images = 0;
    options.allow_truncated = 1;
    output_add(&r->page, "<section>\n<h2>Map</h2>\n");
    if (r->scene && oxl_context_create(NULL, &ctx) == OXL_OK &&
        oxl_scene_load(ctx, r->scene, &options, &scene) == OXL_OK &&
        oxl_model_read(ctx, path, &model) == OXL_OK) {
        m.to = similarity_of_world(scene, r->unit);
        oxl_model_move_origin(&model, oxl_scene_origin(scene));
        if (surface_open(ctx, &model, scene, SURFACE_SIDE, &surface) == OXL_OK &&
            map_make(&m, &model) == OXL_OK) {
            report_map(r, &m);
        }
    }
    if (!(m.area > 0))
        output_add(&r->page, "<p class=\"pale\">No map: the survey or the model is not found, or has no "
                             "points.</p>\n");
    map_free(&m);
    surface_close(&surface);
    if (ctx) oxl_model_free(ctx, &model);
    oxl_scene_free(ctx, scene);
    oxl_context_free(ctx);
    output_add(&r->page, "</section>\n");
}

/* ---------------- survey, blocks */

static void report_survey(struct report *r)
{
    struct output *t = &r->page;
    const char *origin = oxl_json_first(oxl_json_member(r->run, "origin"));
    output_add(t,
               "<section>\n<h2>Survey</h2>\n<p>%s training views, %s held-out views, %s images missing. %J. "
               "Trained at up to %s x %s px. Origin: world = model + (",
               OUTPUT_COUNT(oxl_json_number(r->survey, "train_views")),
               OUTPUT_COUNT(oxl_json_number(r->survey, "test_views")),
               OUTPUT_COUNT(oxl_json_number(r->survey, "images_missing")),
               oxl_json_member(r->survey, "cameras_text"), OUTPUT_COUNT(oxl_json_number(r->survey, "width")),
               OUTPUT_COUNT(oxl_json_number(r->survey, "height")));
    for (const char *e = origin; e; e = oxl_json_next(e))
        output_add(t, "%s%.6f", e == origin ? "" : ", ", oxl_json_number_at(&(const char *){e}));
    output_add(t, ").</p>\n<table><tr><th>part<th class=\"n\">iterations<th class=\"n\">Gaussians<th "
                  "class=\"n\">time<th class=\"n\">memory</tr>\n");
    for (int k = 0; k < r->parts; k++) {
        const char *b = r->part[k].json;
        output_add(
            t, "<tr><td>%s<td class=\"n\">%s<td class=\"n\">%s<td class=\"n\">%s<td class=\"n\">%s</tr>\n",
            r->part[k].name, OUTPUT_COUNT(oxl_json_number(b, "iterations_done")),
            OUTPUT_COUNT(oxl_json_number(b, "gaussians")), OUTPUT_SECONDS(oxl_json_number(b, "seconds")),
            OUTPUT_SIZE(oxl_json_number(b, "peak_rss_bytes")));
    }
    output_add(t, "</table>\n</section>\n");
}

/* ---------------- to repeat it */

/* Adds the options that differ from the preset's. */
static void report_options(struct report *r)
{
    oxl_job_options fresh = oxl_job_options_default(OXL_PRESET_DRAFT);
    oxl_option_set(oxl_option_at(0), &fresh, r->options.preset ? r->options.preset : "", NULL, 0);
    fresh.seed = 1;
    output_add(&r->page, " --preset %s", fresh.preset);
    for (int i = 1; i < oxl_option_count(); i++) {
        const oxl_option *o = oxl_option_at(i);
        char member[40], usual[4096], seen[4096];
        oxl_option_get(o, &r->options, seen, sizeof seen);
        if ((o->kind != OXL_OPTION_TEXT && !oxl_json_member(r->job, oxl_option_member(o, member))) ||
            strcmp(seen, oxl_option_get(o, &fresh, usual, sizeof usual)) == 0)
            continue;
        output_add(&r->page, " --%s", o->name);
        if (o->kind != OXL_OPTION_FLAG) output_add(&r->page, " %S", PRINT_WORD(seen));
    }
}

/* Adds the command that gives the same bytes as this run, and the one that evaluates it. */
static void report_reproduction(struct report *r)
{
    struct output *t = &r->page;
    const char *scene = r->scene ? r->scene : "SCENE";
    output_add(
        t,
        "<section>\n<h2>Reproduction</h2>\n<p>The same survey, options and seed give the same bytes on "
        "any number of threads.</p>\n<pre>oceanxl train %S",
        PRINT_WORD(scene));
    output_add(t, " -o again");
    report_options(r);
    output_add(t, "\noceanxl eval %S", PRINT_WORD(r->out));
    output_add(
        t,
        " %S\n</pre>\n<p><small>OceanXL %J, threads: %s, instruction set %J. All options are in run.json."
        "</small></p>\n</section>\n",
        PRINT_WORD(scene), oxl_json_member(r->run, "oceanxl"),
        OUTPUT_COUNT(oxl_json_number(r->run, "threads")), oxl_json_member(r->run, "instructions"));
}

/* ---------------- the page */

static void report_compose(struct report *r)
{
    report_head(r);
    report_warnings(r);
    report_ground(r);
    views_section(r, "Evaluated views, the worst first", r->metrics, "renders");
    views_section(r, "Training images that fit worst", oxl_json_member(r->metrics, "training"),
                  "training_views");
    report_decisions(r);
    chart_section(r);
    report_survey(r);
    report_reproduction(r);
    output_add(&r->page, "<footer>Written by OceanXL " OXL_VERSION
                         ". This file needs no network.</footer>\n</main>\n</body>\n</html>\n");
}

oxl_result report_write(oxl_context *ctx, const char *out, double scale)
{
    struct report r = {.ctx = ctx,
                       .out = out,
                       .unit = scale > 0 ? scale : 1,
                       .words = scale > 0 ? "metres" : "units",
                       .run = output_read(out, "run.json")};
    oxl_result rc;
    char path[4096];
    if (!oxl_json_member(r.run, "job")) {
        free(r.run);
        return oxl_fail(ctx, OXL_ERR_INPUT,
                        "%s holds no run.json of a run\nfix: run oceanxl train SCENE -o %s first", out,
                        PRINT_WORD(out));
    }
    report_open(&r);
    if (!r.page.failed) report_compose(&r);
    snprintf(path, sizeof path, "%s/report.html", out);
    rc = output_save(ctx, &r.page, path);
    report_close(&r);
    return rc;
}
