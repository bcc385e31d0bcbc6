/* report.c - writes report.html: quality, decisions with evidence, curves and the command that repeats a run,
 * on one page.
 *
 * It reads OUT's run.json, metrics.json, partition.svg, blocks/KKK/{block.json,log.csv}, renders/,
 * training_views/ and scene.ply, and the survey for the map.
 *
 * Invariant: every figure on the page is from one of these files; what is absent is left out or reported as
 * missing.
 */
#include "report_state.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    REPORT_EVIDENCE = 3,  /* lines of evidence that are shown at once */
    REPORT_NOTES = 12,    /* lines of warnings that are shown at once */
    REPORT_LINES = 100000 /* most lines of a list */
};

/* ---------------- at the top */

static void report_tile(struct output *t, const char *figure, const char *what)
{
    output_add(t, "<div class=\"tile\"><b>%s</b><span>%s</span></div>\n", figure, what);
}

static void report_tiles(struct report *r)
{
    struct output *t = &r->page;
    output_add(t, "<div class=\"tiles\">\n");
    if (r->metrics) {
        output_add(t, "<div class=\"tile\"><b>%.2f dB</b><span>mean PSNR</span></div>\n",
                   oxl_json_number(r->metrics, "psnr"));
        report_tile(t, OUTPUT_FIXED(oxl_json_number(r->metrics, "ssim"), 3), "mean SSIM");
        if (!isnan(oxl_json_number(r->metrics, "structure")))
            report_tile(t, OUTPUT_FIXED(oxl_json_number(r->metrics, "structure"), 3), "mean structure");
        if (isfinite(oxl_json_number(r->metrics, "cc_psnr")))
            output_add(t, "<div class=\"tile\"><b>%.2f dB</b><span>mean cc-PSNR</span></div>\n",
                       oxl_json_number(r->metrics, "cc_psnr"));
        report_tile(t, OUTPUT_COUNT(oxl_json_number(r->metrics, "gaussians")), "Gaussians");
        report_tile(t, OUTPUT_SIZE(oxl_json_number(r->metrics, "bytes")), "model");
        report_tile(t, OUTPUT_SECONDS(oxl_json_number(r->metrics, "seconds")), "training time");
        report_tile(t, OUTPUT_SIZE(oxl_json_number(r->metrics, "peak_rss_bytes")), "peak memory");
    }
    ground_tiles(r);
    report_tile(t, OUTPUT_COUNT(oxl_json_number(r->survey, "points")), "initial points");
    output_add(t, "</div>\n");
}

static void report_head(struct report *r)
{
    struct output *t = &r->page;
    const int finished = oxl_json_is_true(r->run, "finished");
    const char *name = r->scene ? r->scene : r->out;
    page_open(t, name);
    output_add(
        t,
        "<header><span class=\"pale\">OceanXL report</span><h1>%S"
        "</h1>\n<span class=\"mark %s\">%s</span> <span class=\"pale\">%s iterations, %d block%s</span></header>\n",
        name, finished ? "good" : "warn",
        finished ? "finished" : "not finished: run the same command again to resume",
        OUTPUT_COUNT(oxl_json_number(r->run, "iterations_done")), r->blocks, r->blocks == 1 ? "" : "s");
    report_tiles(r);
}

/* ---------------- lines of the log */

struct report_list {
    struct report *r;
    const char *tag;   /* tag of a line: "small" or "li" */
    int folded, count; /* number of lines before those that a click shows; number of lines so far */
};

/* Adds a line about a block; block -1: about the whole job. */
static void report_line(struct report_list *list, int block, const char *text)
{
    struct output *t = &list->r->page;
    if (list->count++ == list->folded) output_add(t, "<details><summary>more</summary>");
    if (list->count > REPORT_LINES) return;
    output_add(t, "<%s>", list->tag);
    if (block >= 0 && list->r->blocks > 1) output_add(t, "%s: ", REPORT_PART(list->r, block));
    output_add(t, "%S</%s>\n", text, list->tag);
}

/* Adds the warnings among the log lines of the job and of each part. */
static void report_notes(struct report_list *list)
{
    struct report *r = list->r;
    for (int k = -1; k < r->parts; k++)
        for (const char *e = oxl_json_first(oxl_json_member(k < 0 ? r->run : r->block[k].json, "notes")); e;
             e = oxl_json_next(e)) {
            char *level = json_string(oxl_json_member(e, "level")),
                 *text = json_string(oxl_json_member(e, "text"));
            if (level && text && strcmp(level, "warning") == 0) report_line(list, k, text);
            free(level);
            free(text);
        }
}

static void report_list_end(struct report_list *list)
{
    struct output *t = &list->r->page;
    if (list->count > REPORT_LINES)
        output_add(t, "<%s>and %d more</%s>", list->tag, list->count - REPORT_LINES, list->tag);
    if (list->count > list->folded) output_add(t, "</details>");
}

/* ---------------- what went in */

static void report_survey(struct report *r)
{
    struct output *t = &r->page;
    const char *origin = oxl_json_first(oxl_json_member(r->run, "origin"));
    const double missing = oxl_json_number(r->survey, "images_missing"),
                 masks = oxl_json_number(r->survey, "masks"), points = oxl_json_number(r->survey, "points"),
                 track = oxl_json_number(r->survey, "mean_track"),
                 error = oxl_json_number(r->survey, "mean_error");
    output_add(t, "<dl>\n<dt>Images</dt><dd>%s training views, %s held-out views",
               OUTPUT_COUNT(oxl_json_number(r->survey, "train_views")),
               OUTPUT_COUNT(oxl_json_number(r->survey, "test_views")));
    if (missing > 0) output_add(t, "; <b class=\"warn\">%s missing</b>", OUTPUT_COUNT(missing));
    if (masks > 0) output_add(t, "; %s masks", OUTPUT_COUNT(masks));
    output_add(t, "</dd>\n<dt>Cameras</dt><dd>%J<small>trained at up to %s x %s px</small></dd>\n",
               oxl_json_member(r->survey, "cameras_text"), OUTPUT_COUNT(oxl_json_number(r->survey, "width")),
               OUTPUT_COUNT(oxl_json_number(r->survey, "height")));
    output_add(t, "<dt>Points</dt><dd>%s", points > 0 ? OUTPUT_COUNT(points) : "none");
    if (track > 0) output_add(t, ", each in %.1f images on average", track);
    if (track > 0 && error >= 0) output_add(t, "<small>reprojection error %.2f px</small>", error);
    output_add(t, "</dd>\n");
    output_add(t, "<dt>Origin</dt><dd>world = model + (");
    for (int k = 0; k < 3 && origin; k++) {
        output_add(t, "%s%.6f", k ? ", " : "", oxl_json_number_at(&origin));
        origin += strspn(origin, ", \n");
    }
    output_add(t, ")<small>the origin is also a comment in scene.ply</small></dd>\n</dl>\n");
}

/* ---------------- decisions */

/* Adds "CHOSEN: EVIDENCE" of a decision from run.json (block -1) or block.json. */
static void report_decision(struct report_list *list, int block, const char *name)
{
    const char *json = block < 0 ? list->r->run : list->r->block[block].json;
    const char *decision = oxl_json_member(oxl_json_member(json, "decisions"), name);
    char *chosen = json_string(oxl_json_member(decision, "chosen")),
         *evidence = json_string(oxl_json_member(decision, "evidence"));
    char text[1000];
    snprintf(text, sizeof text, "%s: %s", chosen ? chosen : "", evidence ? evidence : "");
    if (chosen && evidence) report_line(list, block, text);
    free(chosen);
    free(evidence);
}

/* Adds what was decided in each part; the caller has written what the option was set to. */
static void report_evidence(struct report *r, const char *name, int first, int end)
{
    struct report_list list = {r, "small", REPORT_EVIDENCE, 0};
    for (int k = first; k < end; k++) report_decision(&list, k, name);
    report_list_end(&list);
    output_add(&r->page, "</dd>\n");
}

static void report_decisions(struct report *r)
{
    static const char *const choices[][2] = {{"SH degree (--sh-degree)", "sh_degree"},
                                             {"Depth weights of densification (--ucd)", "ucd"},
                                             {"Pruning (--keep)", "keep"},
                                             {"Exposure (--exposure)", "exposure"},
                                             {"Lamp (--lamp)", "lamp"},
                                             {"Medium (--medium)", "medium"},
                                             {"Poses (--poses)", "poses"},
                                             {"Dropout (--dropout)", "dropout"},
                                             {"Contrast of SSIM (--ssim-contrast)", "ssim_contrast"},
                                             {"Second lobes (--dog)", "dog"}};
    struct output *t = &r->page;
    page_section(r, "Decisions and evidence");
    output_add(t, "<dl>\n<dt>Preset</dt><dd>%J<small>%s iterations, seed %.0f</small></dd>\n",
               oxl_json_member(r->run, "preset"), OUTPUT_COUNT(oxl_json_number(r->job, "iterations")),
               oxl_json_number(r->job, "seed"));
    output_add(t, "<dt>Blocks</dt><dd>%d", r->blocks);
    if (r->blocks > 1) output_add(t, ", %J cuts", oxl_json_member(r->job, "cut"));
    report_evidence(r, "partition", -1, 0);
    for (size_t i = 0; i < sizeof choices / sizeof *choices; i++) {
        output_add(t, "<dt>%s</dt><dd>%J", choices[i][0], oxl_json_member(r->job, choices[i][1]));
        report_evidence(r, choices[i][1], 0, r->parts);
    }
    output_add(t, "</dl>\n");
}

/* ---------------- warnings */

static void report_warnings(struct report *r)
{
    const double predicted = oxl_json_number(r->metrics, "predicted_memory_bytes"),
                 peak = oxl_json_number(r->metrics, "peak_rss_bytes");
    struct report_list list = {r, "li", REPORT_NOTES, 0};
    char words[160];
    page_section(r, "Warnings");
    output_add(&r->page, "<ul>\n");
    if (!oxl_json_is_true(r->run, "finished"))
        report_line(&list, -1, "the run is not finished; run the same command again to resume");
    if (r->metrics && oxl_json_number(r->survey, "test_views") <= 0)
        report_line(
            &list, -1,
            "no view is held out: the metrics are of training views (--test-every 8 holds out every 8th image)");
    if (peak > 1.5 * predicted) {
        snprintf(words, sizeof words, "peak memory %s, predicted %s", OUTPUT_SIZE(peak),
                 OUTPUT_SIZE(predicted));
        report_line(&list, -1, words);
    }
    report_notes(&list);
    report_list_end(&list);
    output_add(&r->page, "</ul>\n%s", list.count > 0 ? "" : "<p>None.</p>\n");
}

/* ---------------- blocks, sizes, times */

static void report_block_rows(struct report *r)
{
    struct output *t = &r->page;
    page_section(r, r->blocks > 1 ? "Blocks" : "Time and memory");
    output_add(
        t,
        "<div class=\"scroll\"><table><tr><th>block<th class=\"n\">iterations<th class=\"n\">Gaussians<th class=\"n\">time"
        "<th class=\"n\">predicted time<th class=\"n\">memory<th class=\"n\">predicted memory</tr>\n");
    for (int k = 0; k < r->parts; k++) {
        const char *b = r->block[k].json;
        output_add(
            t,
            "<tr><td>%s<td class=\"n\">%s<td class=\"n\">%s<td class=\"n\">%s<td class=\"n\">%s<td class=\"n\">%s<td class=\"n\">%s</tr>\n",
            REPORT_PART(r, k), OUTPUT_COUNT(oxl_json_number(b, "iterations_done")),
            OUTPUT_COUNT(oxl_json_number(b, "gaussians")), OUTPUT_SECONDS(oxl_json_number(b, "seconds")),
            OUTPUT_SECONDS(oxl_json_number(b, "predicted_seconds")),
            OUTPUT_SIZE(oxl_json_number(b, "peak_rss_bytes")),
            OUTPUT_SIZE(oxl_json_number(b, "predicted_memory_bytes")));
    }
    output_add(
        t,
        "</table></div>\n<p><small>Memory: peak of the process that trained the block, including its earlier work.</small></p>\n");
}

/* ---------------- to repeat it */

static void report_shell(struct output *t, const char *word)
{
    output_add(t, "%S", PRINT_WORD(word));
}

/* Adds the options that differ from the preset's; of_survey: only those that eval and render need too,
 * to have the same images. */
static void report_options(struct report *r, int of_survey)
{
    const unsigned uses = OXL_OPTION_OF_SURVEY | OXL_OPTION_OF_TRAINING | OXL_OPTION_OF_RESULT,
                   wanted = OXL_OPTION_OF_SURVEY | OXL_OPTION_OF_RESULT;
    oxl_job_options fresh = oxl_job_options_default(OXL_PRESET_DRAFT);
    oxl_option_set(oxl_option_at(0), &fresh, r->options.preset ? r->options.preset : "", NULL, 0);
    fresh.seed = 1;
    if (!of_survey) output_add(&r->page, " --preset %s", fresh.preset);
    for (int i = 1; i < oxl_option_count(); i++) {
        const oxl_option *o = oxl_option_at(i);
        char member[40], usual[4096], seen[4096];
        if (o->kind != OXL_OPTION_TEXT && !oxl_json_member(r->job, oxl_option_member(o, member))) continue;
        if (of_survey && (o->use & uses) != wanted) continue;
        if (strcmp(oxl_option_get(o, &r->options, seen, sizeof seen),
                   oxl_option_get(o, &fresh, usual, sizeof usual)) == 0)
            continue;
        output_add(&r->page, o->kind == OXL_OPTION_FLAG ? " --%s" : " --%s ", o->name);
        if (o->kind != OXL_OPTION_FLAG) report_shell(&r->page, seen);
    }
}

/* Adds the command that gives the same bytes as this run. */
static void report_command(struct report *r)
{
    output_add(&r->page, "oceanxl train ");
    report_shell(&r->page, r->scene ? r->scene : "SCENE");
    output_add(&r->page, " -o ");
    report_shell(&r->page, r->out);
    report_options(r, 0);
    output_add(&r->page, "\n");
}

void report_survey_options(struct report *r)
{
    report_options(r, 1);
}

static void report_reproduction(struct report *r)
{
    struct output *t = &r->page;
    page_section(r, "Reproduction");
    output_add(
        t, "<p>The same survey, options and seed give the same bytes on any number of threads.</p>\n<pre>");
    report_command(r);
    output_add(t, "oceanxl eval ");
    report_shell(t, r->out);
    output_add(t, "/scene.ply ");
    report_shell(t, r->scene ? r->scene : "SCENE");
    report_survey_options(r);
    output_add(t,
               "\n</pre>\n<p><small>OceanXL %J, %s threads, instruction set %J. "
               "All options are in run.json, line \"job\".</small></p>\n",
               oxl_json_member(r->run, "oceanxl"), OUTPUT_COUNT(oxl_json_number(r->run, "threads")),
               oxl_json_member(r->run, "instructions"));
}

/* ---------------- the page */

static void report_compose(struct report *r)
{
    ground_open(r);
    report_head(r);
    verdict_section(r);
    report_warnings(r);
    ground_section(r);
    views_section(r);
    views_training_section(r);
    page_section(r, "Survey");
    map_section(r);
    report_survey(r);
    report_decisions(r);
    chart_section(r);
    report_block_rows(r);
    report_reproduction(r);
    output_add(&r->page, "</section>\n<footer>Written by OceanXL " OXL_VERSION
                         ". This file needs no network.</footer>\n</main>\n</body>\n</html>\n");
}

oxl_result report_write(oxl_context *ctx, const char *out, double scale)
{
    struct report r = {.ctx = ctx, .out = out, .scale = scale, .run = output_read(out, "run.json", NULL)};
    oxl_result rc = OXL_ERR_MEMORY;
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
    if (r.page.failed) oxl_fail(ctx, rc, "report: out of memory for the page of %s", out);
    else if (output_save(&r.page, path)) rc = OXL_OK;
    else
        rc = oxl_fail(ctx, OXL_ERR_IO, "report: cannot write %s\nfix: check free disk space and permissions",
                      path);
    ground_close(&r);
    report_close(&r);
    return rc;
}
