/* report.c - report.html: quality, decisions with evidence, curves and the command that repeats a run, on one page.
 *
 * It reads OUT's run.json, metrics.json, partition.svg, blocks/KKK/{block.json,log.csv} and renders/, and the survey for
 * the map. Invariant: every figure on the page is from one of these files; what is absent is left out or reported as missing.
 */
#include "report.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { REPORT_EVIDENCE = 3, REPORT_NOTES = 100 /* lines that are shown at once; at all */ };

/* ---------------------------------------------------------------- at the top */

static void report_tile(struct output *t, const char *figure, const char *what)
{
    output_add(t, "<div class=\"tile\"><b>%s</b><span>%s</span></div>\n", figure, what);
}

static double report_metric(const struct report *r, const char *name)
{
    return json_number(r->metrics, name);
}

static void report_tiles(struct report *r)
{
    struct output *t = &r->page;
    char           figure[64];
    output_add(t, "<div class=\"tiles\">\n");
    snprintf(figure, sizeof figure, "%s dB", OUTPUT_FIXED(report_metric(r, "psnr"), 2));
    if (r->metrics) {
        report_tile(t, figure, "mean PSNR");
        report_tile(t, OUTPUT_FIXED(report_metric(r, "ssim"), 3), "mean SSIM");
        report_tile(t, PAGE_COUNT(report_metric(r, "gaussians")), "Gaussians");
        report_tile(t, PAGE_BYTES(report_metric(r, "bytes")), "model");
        report_tile(t, PAGE_SECONDS(report_metric(r, "seconds")), "training time");
        report_tile(t, PAGE_BYTES(report_metric(r, "peak_rss_bytes")), "peak memory");
    }
    report_tile(t, PAGE_COUNT(json_number(r->survey, "images") - json_number(r->survey, "images_missing")), "images");
    report_tile(t, PAGE_COUNT(json_number(r->survey, "points")), "initial points");
    output_add(t, "</div>\n");
}

static void report_head(struct report *r)
{
    struct output *t        = &r->page;
    const int      finished = json_is_true(r->run, "finished");
    const char    *name     = r->scene ? r->scene : r->out;
    page_open(t, name);
    output_add(t, "<header><span class=\"pale\">OceanXL report</span><h1>");
    page_text(t, name);
    output_add(t, "</h1>\n<span class=\"mark %s\">%s</span> <span class=\"pale\">%s iterations, %d block%s</span></header>\n",
               finished ? "good" : "warn", finished ? "finished" : "not finished: run the same command again to resume",
               PAGE_COUNT(json_number(r->run, "iterations_done")), r->blocks, r->blocks == 1 ? "" : "s");
    report_tiles(r);
}

/* ---------------------------------------------------------------- lines of the log */

/* Calls visit(user, block, text) for each line of a level ("info", "warning"); block -1: of the whole job. */
static void report_each_note(const struct report *r, const char *level, void (*visit)(void *user, int block, const char *text),
                             void *user)
{
    for (int k = -1; k < r->parts; k++)
        for (const char *e = json_first(json_member(k < 0 ? r->run : r->block[k].json, "notes")); e; e = json_next(e)) {
            char *its = json_string(json_member(e, "level")), *text = json_string(json_member(e, "text"));
            if (its && text && strcmp(its, level) == 0) visit(user, k, text);
            free(its);
            free(text);
        }
}

struct report_list {
    struct report *r;
    const char    *words; /* that a line must hold; NULL: any */
    int            count;
};

static void report_item(void *user, int block, const char *text)
{
    struct report_list *list = user;
    struct output      *t    = &list->r->page;
    if (list->words && !strstr(text, list->words)) return;
    if (list->count++ == REPORT_EVIDENCE) output_add(t, "<details><summary>more</summary>");
    if (list->count > REPORT_NOTES) return;
    output_add(t, "<small>");
    if (block >= 0 && list->r->blocks > 1) output_add(t, "%s: ", REPORT_PART(list->r, block));
    page_text(t, text);
    output_add(t, "</small>");
}

/* Lines of the log that hold the words, as evidence. */
static void report_evidence(struct report *r, const char *words)
{
    struct report_list list = {r, words, 0};
    report_each_note(r, "info", report_item, &list);
    if (list.count > REPORT_NOTES) output_add(&r->page, "<small>and %d more</small>", list.count - REPORT_NOTES);
    if (list.count > REPORT_EVIDENCE) output_add(&r->page, "</details>");
}

/* ---------------------------------------------------------------- what went in */

static void report_term(struct output *t, const char *term)
{
    output_add(t, "<dt>%s</dt><dd>", term);
}

static void report_survey(struct report *r)
{
    struct output *t       = &r->page;
    const char    *origin  = json_first(json_member(r->run, "origin"));
    char          *cameras = json_string(json_member(r->survey, "cameras_text"));
    const double   missing = json_number(r->survey, "images_missing");
    output_add(t, "<dl>\n");
    report_term(t, "Images");
    output_add(t, "%s training views, %s held-out views", PAGE_COUNT(json_number(r->survey, "train_views")),
               PAGE_COUNT(json_number(r->survey, "test_views")));
    if (missing > 0) output_add(t, "; <b class=\"warn\">%s missing</b>", PAGE_COUNT(missing));
    if (json_number(r->survey, "masks") > 0) output_add(t, "; %s masks", PAGE_COUNT(json_number(r->survey, "masks")));
    output_add(t, "</dd>\n");
    report_term(t, "Cameras");
    page_text(t, cameras ? cameras : "unknown");
    output_add(t, "<small>trained at up to %s x %s px</small></dd>\n", PAGE_COUNT(json_number(r->survey, "width")),
               PAGE_COUNT(json_number(r->survey, "height")));
    report_term(t, "Points");
    output_add(t, "%s, each in %s images on average<small>reprojection error %s px</small></dd>\n",
               PAGE_COUNT(json_number(r->survey, "points")), OUTPUT_FIXED(json_number(r->survey, "mean_track"), 1),
               OUTPUT_FIXED(json_number(r->survey, "mean_error"), 2));
    report_term(t, "Origin");
    output_add(t, "world = model + (");
    for (int k = 0; k < 3 && origin; k++) {
        output_add(t, "%s%s", k ? ", " : "", OUTPUT_FIXED(json_number_at(&origin), 6));
        origin += strspn(origin, ", \n");
    }
    output_add(t, ")<small>the origin is also a comment in scene.ply</small></dd>\n</dl>\n");
    free(cameras);
}

/* ---------------------------------------------------------------- decisions */

/* A member of run.json's "job" as text in fresh memory; NULL: not there, or null. */
static char *report_value(const char *object, const char *name)
{
    const char  *value  = json_member(object, name);
    const size_t length = value ? strcspn(value, ",} \n") : 0;
    char        *text   = json_string(value);
    if (text || !value || strncmp(value, "null", 4) == 0) return text;
    text = calloc(length + 1, 1);
    if (text) memcpy(text, value, length);
    return text;
}

static void report_decision(struct report *r, const char *term, const char *chosen, const char *const *evidence, int count)
{
    report_term(&r->page, term);
    page_text(&r->page, chosen);
    for (int i = 0; i < count; i++) report_evidence(r, evidence[i]);
    output_add(&r->page, "</dd>\n");
}

/* An option of the job, and the log lines about its effect. */
static void report_choice(struct report *r, const char *term, const char *member, const char *evidence)
{
    char *value = report_value(r->job, member);
    report_decision(r, term, value ? value : "unknown", &evidence, 1);
    free(value);
}

static void report_decisions(struct report *r)
{
    static const char *const partition[] = {"partition in ", "stay one block", " blocks of ",
                                            "joined",        "see too little", "--ram "};
    struct output           *t           = &r->page;
    char                    *preset = json_string(json_member(r->run, "preset")), *split = report_value(r->job, "split");
    char                     words[80];
    page_section(t, "Decisions and evidence");
    output_add(t, "<dl>\n");
    report_term(t, "Preset");
    page_text(t, preset ? preset : "");
    output_add(t, "<small>%s iterations, seed %s</small></dd>\n", PAGE_COUNT(json_number(r->job, "iterations")),
               OUTPUT_FIXED(json_number(r->job, "seed"), 0));
    report_choice(r, "SH degree (--sh-degree)", "sh_degree", "SH degree");
    snprintf(words, sizeof words, "%d, %s cuts", r->blocks, split ? split : "unknown");
    report_decision(r, "Blocks", r->blocks == 1 ? "1" : words, partition, 6);
    report_choice(r, "Depth weights of densification (--ucd)", "ucd", "depth weights");
    report_choice(r, "Pruning (--keep)", "keep", "are dropped");
    report_choice(r, "Exposure (--exposure)", "exposure", "exposure o");
    report_choice(r, "Lamp (--lamp)", "lamp", "lamp o");
    report_choice(r, "Water (--medium)", "medium", "medium o");
    report_choice(r, "Second lobes (--dog)", "dog", "second lobe");
    output_add(t, "</dl>\n</section>\n");
    free(preset);
    free(split);
}

/* ---------------------------------------------------------------- warnings */

static void report_warning(void *user, int block, const char *text)
{
    struct report_list *list = user;
    struct output      *t    = &list->r->page;
    if (list->count++ >= REPORT_NOTES) return;
    output_add(t, "%s<li>", list->count == 1 ? "<ul>\n" : "");
    if (block >= 0 && list->r->blocks > 1) output_add(t, "%s: ", REPORT_PART(list->r, block));
    page_text(t, text);
    output_add(t, "</li>\n");
}

/* Derived from the figures. */
static void report_figure_warnings(struct report *r, struct report_list *list)
{
    const double predicted = report_metric(r, "predicted_memory_bytes"), peak = report_metric(r, "peak_rss_bytes");
    char         words[160];
    if (!json_is_true(r->run, "finished"))
        report_warning(list, -1, "the run is not finished; run the same command again to resume");
    for (int k = 0; k < r->blocks && r->blocks > 1; k++)
        if (!json_is_true(r->block[k].json, "finished")) report_warning(list, k, "not finished");
    if (r->metrics && json_number(r->survey, "test_views") <= 0)
        report_warning(list, -1,
                       "no view is held out: the metrics are of training views (--test-every 8 holds out every 8th image)");
    if (peak > 1.5 * predicted) {
        snprintf(words, sizeof words, "peak memory %s, predicted %s", PAGE_BYTES(peak), PAGE_BYTES(predicted));
        report_warning(list, -1, words);
    }
}

static void report_warnings(struct report *r)
{
    struct report_list list = {r, NULL, 0};
    page_section(&r->page, "Warnings");
    report_figure_warnings(r, &list);
    report_each_note(r, "warning", report_warning, &list);
    output_add(&r->page, list.count > 0 ? "</ul>\n" : "<p>None.</p>\n");
    if (list.count > REPORT_NOTES) output_add(&r->page, "<p>And %d more.</p>\n", list.count - REPORT_NOTES);
    output_add(&r->page, "</section>\n");
}

/* ---------------------------------------------------------------- blocks, seams, sizes, times */

static void report_block_rows(struct report *r)
{
    struct output *t = &r->page;
    output_add(t,
               "<div class=\"scroll\"><table><tr><th>block<th class=\"n\">iterations<th class=\"n\">Gaussians<th class=\"n\">time"
               "<th class=\"n\">predicted time<th class=\"n\">memory<th class=\"n\">predicted memory</tr>\n");
    for (int k = 0; k < r->parts; k++) {
        const char *b = r->block[k].json;
        output_add(
            t,
            "<tr><td>%s<td class=\"n\">%s<td class=\"n\">%s<td class=\"n\">%s<td class=\"n\">%s<td class=\"n\">%s<td class=\"n\">%s</tr>\n",
            REPORT_PART(r, k), PAGE_COUNT(json_number(b, "iterations_done")), PAGE_COUNT(json_number(b, "gaussians")),
            PAGE_SECONDS(json_number(b, "seconds")), PAGE_SECONDS(json_number(b, "predicted_seconds")),
            PAGE_BYTES(json_number(b, "peak_rss_bytes")), PAGE_BYTES(json_number(b, "predicted_memory_bytes")));
    }
    output_add(
        t,
        "</table></div>\n<p><small>Memory: peak of the process that trained the block, including its earlier work.</small></p>\n");
}

static void report_seam(struct report *r)
{
    const char  *seam      = json_member(r->metrics, "seam");
    const double near_psnr = json_number(seam, "near_psnr"), elsewhere = json_number(seam, "elsewhere_psnr");
    if (!isfinite(near_psnr) || !isfinite(elsewhere)) return;
    output_add(
        &r->page,
        "<h3>Seams</h3>\n<p>PSNR within %s %% of a block's size from a border: <b>%s dB</b> (%s px); elsewhere: <b>%s dB</b>. ",
        OUTPUT_FIXED(100 * json_number(seam, "width"), 0), OUTPUT_FIXED(near_psnr, 2),
        PAGE_COUNT(json_number(seam, "near_pixels")), OUTPUT_FIXED(elsewhere, 2));
    output_add(&r->page, "Difference: %s dB.</p>\n", OUTPUT_FIXED(near_psnr - elsewhere, 2));
}

static void report_sizes(struct report *r)
{
    page_section(&r->page, r->blocks > 1 ? "Blocks and seams" : "Time and memory");
    report_block_rows(r);
    report_seam(r);
    output_add(&r->page, "</section>\n");
}

/* ---------------------------------------------------------------- to repeat it */

/* A word for a POSIX shell: quoted where it has to be. */
static void report_shell(struct output *t, const char *word)
{
    static const char plain[]   = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789_./,-+:@%";
    char              letter[2] = {0};
    if (word[0] && strspn(word, plain) == strlen(word)) {
        page_text(t, word);
        return;
    }
    page_text(t, "'");
    for (; *word; word++) {
        letter[0] = *word;
        page_text(t, *word == '\'' ? "'\\''" : letter);
    }
    page_text(t, "'");
}

/* The option, unless it has the preset's default. */
static void report_option(struct report *r, const oxl_option *o, const oxl_job_options *fresh)
{
    oxl_job_options job = *fresh;
    char            member[40], usual[128], seen[128];
    char           *text = report_value(r->job, oxl_option_member(o, member));
    if (text && oxl_option_set(o, &job, text, NULL, 0) == OXL_OK &&
        strcmp(oxl_option_get(o, &job, seen, sizeof seen), oxl_option_get(o, fresh, usual, sizeof usual)) != 0) {
        output_add(&r->page, o->kind == OXL_OPTION_FLAG ? " --%s" : " --%s ", o->name);
        if (o->kind != OXL_OPTION_FLAG) report_shell(&r->page, o->kind == OXL_OPTION_TEXT ? text : seen);
    }
    free(text);
}

/* The command that gives the same bytes: every option that differs from the preset's. */
static void report_command(struct report *r)
{
    char           *preset = json_string(json_member(r->run, "preset"));
    oxl_job_options fresh  = oxl_job_options_default(OXL_PRESET_DRAFT);
    oxl_option_set(oxl_option_at(0), &fresh, preset ? preset : "", NULL, 0);
    fresh.seed = 1;
    output_add(&r->page, "oceanxl train ");
    report_shell(&r->page, r->scene ? r->scene : "SCENE");
    output_add(&r->page, " -o ");
    report_shell(&r->page, r->out);
    output_add(&r->page, " --preset %s", fresh.preset);
    for (int i = 1; i < oxl_option_count(); i++) report_option(r, oxl_option_at(i), &fresh);
    output_add(&r->page, "\n");
    free(preset);
}

static void report_reproduction(struct report *r)
{
    struct output *t           = &r->page;
    char          *version     = json_string(json_member(r->run, "oceanxl"));
    char          *instruction = json_string(json_member(r->run, "instructions"));
    page_section(t, "Reproduction");
    output_add(t, "<p>The same survey, options and seed give the same bytes on any number of threads.</p>\n<pre>");
    report_command(r);
    output_add(t, "oceanxl eval ");
    report_shell(t, r->out);
    output_add(t, "/scene.ply ");
    report_shell(t, r->scene ? r->scene : "SCENE");
    output_add(t, "\n</pre>\n<p><small>OceanXL ");
    page_text(t, version ? version : "");
    output_add(t, ", %s threads, instruction set ", PAGE_COUNT(json_number(r->run, "threads")));
    page_text(t, instruction ? instruction : "");
    output_add(t, ". All options are in run.json, line \"job\".</small></p>\n</section>\n");
    free(version);
    free(instruction);
}

/* ---------------------------------------------------------------- the page */

static void report_compose(struct report *r)
{
    report_head(r);
    report_warnings(r);
    views_section(r);
    views_training_section(r);
    page_section(&r->page, "Survey");
    map_section(r);
    report_survey(r);
    output_add(&r->page, "</section>\n");
    report_decisions(r);
    chart_section(r);
    report_sizes(r);
    report_reproduction(r);
    page_close(&r->page, OXL_VERSION);
}

static oxl_result report_save(struct report *r, char *error, size_t error_size)
{
    char path[1024];
    if (snprintf(path, sizeof path, "%s/report.html", r->out) >= (int)sizeof path) {
        snprintf(error, error_size, "report: the folder's name is too long");
        return OXL_ERR_USAGE;
    }
    if (output_save(&r->page, path)) return OXL_OK;
    snprintf(error, error_size, "report: cannot write %s\nfix: check free disk space and permissions", path);
    return OXL_ERR_IO;
}

oxl_result report_write(oxl_context *ctx, const char *out, char *error, size_t error_size)
{
    struct report r  = {.ctx = ctx, .out = out, .run = output_read(out, "run.json", NULL)};
    oxl_result    rc = OXL_OK;
    if (!json_member(r.run, "job")) {
        snprintf(error, error_size, "%s holds no run.json of a run\nfix: run oceanxl train SCENE -o %s first", out, out);
        free(r.run);
        return OXL_ERR_INPUT;
    }
    report_open(&r);
    if (!r.page.failed) report_compose(&r);
    if (r.page.failed) {
        snprintf(error, error_size, "report: out of memory for the page of %s", out);
        rc = OXL_ERR_MEMORY;
    }
    if (rc == OXL_OK) rc = report_save(&r, error, error_size);
    report_close(&r);
    return rc;
}
