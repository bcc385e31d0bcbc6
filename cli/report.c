/* report.c - what a run left in its folder, as one page: for the one who made it, and for the one who has to trust it.
 *
 * It reads OUT's run.json, metrics.json, partition.svg, blocks/KKK/{block.json,log.csv} and renders/, and the survey's text files for the map.
 * Invariant: every figure on the page stands in one of these files; what is not there is left out or said to be missing.
 */
#include "report.h"
#include "../lab/synth.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { REPORT_BLOCKS = 100000, REPORT_EVIDENCE = 3, REPORT_NOTES = 100 /* lines that are seen at once; at all */ };

static const char *const REPORT_HEADS[REPORT_COLUMNS] = {"iteration", "loss",  "psnr",  "gaussians",
                                                         "seconds",   "f_mid", "f_far", "peak_rss_bytes"};

/* ---------------------------------------------------------------- what is there */

char *report_read(const struct report *r, const char *name, size_t *size)
{
    const size_t length = strlen(r->out) + strlen(name) + 2;
    char        *path = malloc(length), *text = NULL;
    FILE        *file;
    long         end;
    if (!path) return NULL;
    snprintf(path, length, "%s/%s", r->out, name);
    file = fopen(path, "rb");
    free(path);
    if (!file) return NULL;
    if (fseek(file, 0, SEEK_END) == 0 && (end = ftell(file)) >= 0 && fseek(file, 0, SEEK_SET) == 0)
        text = malloc((size_t)end + 1);
    if (text) {
        const size_t got = fread(text, 1, (size_t)end, file);
        text[got]        = 0;
        if (size) *size = got;
    }
    fclose(file);
    return text;
}

/* Which column of ours stands where in the file; -1: none of ours. */
static int report_heads(const char *text, int *column, int most)
{
    int n = 0;
    for (const char *at = text; n < most;) {
        const size_t length = strcspn(at, ",\r\n");
        column[n]           = -1;
        for (int k = 0; k < REPORT_COLUMNS; k++)
            if (strlen(REPORT_HEADS[k]) == length && strncmp(at, REPORT_HEADS[k], length) == 0) column[n] = k;
        n++;
        if (at[length] != ',') break;
        at += length + 1;
    }
    return n;
}

static int report_log_row(const char *at, const int *column, int columns, double *row)
{
    for (int k = 0; k < REPORT_COLUMNS; k++) row[k] = NAN;
    for (int i = 0; i < columns; i++) {
        const double value = json_number_at(&at);
        if (column[i] >= 0) row[column[i]] = value;
        at += strcspn(at, ",\r\n");
        if (*at != ',') break;
        at++;
    }
    return isfinite(row[REPORT_ITERATION]);
}

static void report_read_log(struct report *r, struct report_block *b, char *text)
{
    int    column[32], columns = report_heads(text, column, 32);
    size_t lines = 0;
    for (const char *at = text; *at; at++) lines += *at == '\n';
    b->log = malloc((lines + 1) * REPORT_COLUMNS * sizeof *b->log);
    if (!b->log) r->page.failed = 1;
    for (const char *at = strchr(text, '\n'); b->log && at && at[1]; at = strchr(at + 1, '\n'))
        if (report_log_row(at + 1, column, columns, b->log + (size_t)b->rows * REPORT_COLUMNS)) b->rows++;
}

const char *report_part(const struct report *r, int part, char out[40])
{
    if (part < r->blocks) snprintf(out, 40, "block %d", part);
    else snprintf(out, 40, "all together");
    return out;
}

static void report_read_block(struct report *r, int k)
{
    char name[64], folder[32] = "blocks/together", *log;
    if (k < r->blocks) snprintf(folder, sizeof folder, "blocks/%03d", k);
    snprintf(name, sizeof name, "%s/block.json", folder);
    r->block[k].json = report_read(r, name, NULL);
    snprintf(name, sizeof name, "%s/log.csv", folder);
    log = report_read(r, name, NULL);
    if (log) report_read_log(r, &r->block[k], log);
    free(log);
}

static void report_open(struct report *r)
{
    const double blocks = json_number(r->run, "blocks");
    r->job              = json_member(r->run, "job");
    r->survey           = json_member(r->run, "survey");
    r->scene            = json_string(json_member(r->job, "scene"));
    r->metrics          = report_read(r, "metrics.json", NULL);
    r->blocks           = blocks >= 1 && blocks <= REPORT_BLOCKS ? (int)blocks : 1;
    r->block            = calloc((size_t)r->blocks + 1, sizeof *r->block);
    if (!r->block) r->page.failed = 1, r->blocks = 0;
    for (int k = 0; r->block && k < r->blocks + (r->blocks > 1); k++) report_read_block(r, k);
    r->parts = r->blocks + (r->block && r->block[r->blocks].json && json_is_true(r->run, "refined"));
}

static void report_close(struct report *r)
{
    for (int k = 0; r->block && k <= r->blocks; k++) {
        free(r->block[k].json);
        free(r->block[k].log);
    }
    free(r->block);
    free(r->run);
    free(r->scene);
    free(r->metrics);
    free(r->page.data);
}

/* ---------------------------------------------------------------- at the top */

static void report_tile(struct study_text *t, const char *figure, const char *what)
{
    study_add(t, "<div class=\"tile\"><b>%s</b><span>%s</span></div>\n", figure, what);
}

static double report_metric(const struct report *r, const char *name)
{
    return json_number(r->metrics, name);
}

static void report_tiles(struct report *r)
{
    struct study_text *t = &r->page;
    char               figure[64];
    study_add(t, "<div class=\"tiles\">\n");
    snprintf(figure, sizeof figure, "%s dB", STUDY_FIXED(report_metric(r, "psnr"), 2));
    if (r->metrics) {
        report_tile(t, figure, "PSNR, mean of the views");
        report_tile(t, STUDY_FIXED(report_metric(r, "ssim"), 3), "SSIM");
        report_tile(t, PAGE_COUNT(report_metric(r, "gaussians")), "Gaussians");
        report_tile(t, PAGE_BYTES(report_metric(r, "bytes")), "scene.ply");
        report_tile(t, PAGE_SECONDS(report_metric(r, "seconds")), "of training");
        report_tile(t, PAGE_BYTES(report_metric(r, "peak_rss_bytes")), "memory at the peak");
    }
    report_tile(t, PAGE_COUNT(json_number(r->survey, "images") - json_number(r->survey, "images_missing")), "photographs");
    report_tile(t, PAGE_COUNT(json_number(r->survey, "points")), "points to start from");
    study_add(t, "</div>\n");
}

static void report_head(struct report *r)
{
    struct study_text *t        = &r->page;
    const int          finished = json_is_true(r->run, "finished");
    const char        *name     = r->scene ? r->scene : r->out;
    page_open(t, name);
    study_add(t, "<header><span class=\"pale\">OceanXL report</span><h1>");
    page_text(t, name);
    study_add(t, "</h1>\n<span class=\"mark %s\">%s</span> <span class=\"pale\">%s iterations, %d block%s</span></header>\n",
              finished ? "good" : "warn", finished ? "finished" : "not finished: run the same command again, and it goes on",
              PAGE_COUNT(json_number(r->run, "iterations_done")), r->blocks, r->blocks == 1 ? "" : "s");
    report_tiles(r);
}

/* ---------------------------------------------------------------- what the log said */

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
    struct study_text  *t    = &list->r->page;
    if (list->words && !strstr(text, list->words)) return;
    if (list->count++ == REPORT_EVIDENCE) study_add(t, "<details><summary>more such lines</summary>");
    if (list->count > REPORT_NOTES) return;
    study_add(t, "<small>");
    if (block >= 0 && list->r->blocks > 1) study_add(t, "%s: ", REPORT_PART(list->r, block));
    page_text(t, text);
    study_add(t, "</small>");
}

/* Lines of the log that hold the words, as evidence. */
static void report_evidence(struct report *r, const char *words)
{
    struct report_list list = {r, words, 0};
    report_each_note(r, "info", report_item, &list);
    if (list.count > REPORT_NOTES) study_add(&r->page, "<small>and %d more</small>", list.count - REPORT_NOTES);
    if (list.count > REPORT_EVIDENCE) study_add(&r->page, "</details>");
}

/* ---------------------------------------------------------------- what went in */

static void report_term(struct study_text *t, const char *term)
{
    study_add(t, "<dt>%s</dt><dd>", term);
}

static void report_found(struct report *r)
{
    struct study_text *t       = &r->page;
    const char        *origin  = json_first(json_member(r->run, "origin"));
    char              *cameras = json_string(json_member(r->survey, "cameras_text"));
    const double       missing = json_number(r->survey, "images_missing");
    study_add(t, "<dl>\n");
    report_term(t, "Photographs");
    study_add(t, "%s to train with, %s held out", PAGE_COUNT(json_number(r->survey, "train_views")),
              PAGE_COUNT(json_number(r->survey, "test_views")));
    if (missing > 0) study_add(t, "; <b class=\"warn\">%s are missing</b>", PAGE_COUNT(missing));
    if (json_number(r->survey, "masks") > 0) study_add(t, "; %s masks", PAGE_COUNT(json_number(r->survey, "masks")));
    study_add(t, "</dd>\n");
    report_term(t, "Cameras");
    page_text(t, cameras ? cameras : "not known");
    study_add(t, "<small>trained at up to %s x %s px</small></dd>\n", PAGE_COUNT(json_number(r->survey, "width")),
              PAGE_COUNT(json_number(r->survey, "height")));
    report_term(t, "Points");
    study_add(t, "%s, each in %s photographs on average<small>reprojection error %s px</small></dd>\n",
              PAGE_COUNT(json_number(r->survey, "points")), STUDY_FIXED(json_number(r->survey, "mean_track"), 1),
              STUDY_FIXED(json_number(r->survey, "mean_error"), 2));
    report_term(t, "Place");
    study_add(t, "world = model + (");
    for (int k = 0; k < 3 && origin; k++) {
        study_add(t, "%s%s", k ? ", " : "", STUDY_FIXED(json_number_at(&origin), 6));
        origin += strspn(origin, ", \n");
    }
    study_add(t, ")<small>the origin is also a comment in scene.ply</small></dd>\n</dl>\n");
    free(cameras);
}

/* ---------------------------------------------------------------- decisions */

static const char *report_word(const struct report *r, const char *name, const char *const *words, int count)
{
    const double value = json_number(r->job, name);
    return value >= 0 && value < count ? words[(int)value] : "not known";
}

/* A number of the job as it stands there: every digit that it needs. */
static void report_digits(const struct report *r, const char *name, char out[32])
{
    const char *value = json_member(r->job, name);
    snprintf(out, 32, "%.*s", value ? (int)strcspn(value, ",} \n") : 0, value ? value : "");
}

/* --ucd, --keep as they would be typed. */
static void report_ucd(const struct report *r, char out[80])
{
    const int mode = (int)json_number(r->job, "ucd");
    char      mid[32], far[32];
    report_digits(r, "ucd_mid", mid);
    report_digits(r, "ucd_far", far);
    if (mode == OXL_UCD_ON && json_number(r->job, "ucd_learn") <= 0) snprintf(out, 80, "%s,%s,fixed", mid, far);
    else snprintf(out, 80, "%s", mode == OXL_UCD_OFF ? "off" : mode == OXL_UCD_ON ? "on" : "auto");
}

static void report_keep(const struct report *r, char out[80])
{
    const int kind = (int)json_number(r->job, "keep");
    char      value[32];
    report_digits(r, "keep_value", value);
    if (kind == OXL_KEEP_FRACTION || kind == OXL_KEEP_COUNT) snprintf(out, 80, "%s", value);
    else if (kind == OXL_KEEP_BYTES) snprintf(out, 80, "%sKB", STUDY_FIXED(json_number(r->job, "keep_value") / 1e3, 3));
    else snprintf(out, 80, "%s", kind == OXL_KEEP_AUTO ? "auto" : "all");
}

static const char *const REPORT_DOGS[] = {"off", "selective", "all", "auto"}, *const REPORT_AXES[] = {"auto", "2d", "3d", "none"},
                         *const REPORT_CUTS[] = {"balanced", "midpoint"};

static void report_decision(struct report *r, const char *term, const char *chosen, const char *const *evidence, int count)
{
    report_term(&r->page, term);
    page_text(&r->page, chosen);
    for (int i = 0; i < count; i++) report_evidence(r, evidence[i]);
    study_add(&r->page, "</dd>\n");
}

static void report_decisions(struct report *r)
{
    static const char *const partition[] = {"partition in ", "stay one block", " blocks of ",
                                            "joined",        "see too little", "--ram "};
    static const char *const ucd[] = {"depth weights"}, *const keep[] = {"are dropped"}, *const dog[] = {"second lobe"},
                             *const bands[] = {"SH degree"}, *const end[] = {"the run ends"};
    struct study_text *t      = &r->page;
    char              *preset = json_string(json_member(r->run, "preset"));
    char               words[80];
    page_section(t, "What was decided, and why");
    study_add(t, "<dl>\n");
    report_term(t, "Preset");
    page_text(t, preset ? preset : "");
    study_add(t, "<small>%s iterations, seed %s</small></dd>\n", PAGE_COUNT(json_number(r->job, "iterations")),
              STUDY_FIXED(json_number(r->job, "seed"), 0));
    if (json_number(r->job, "stop_early") > 0) report_decision(r, "Early end (--stop-early)", "on", end, 1);
    snprintf(words, sizeof words, "%s",
             json_number(r->job, "sh_degree") < 0 ? "auto" : STUDY_FIXED(json_number(r->job, "sh_degree"), 0));
    report_decision(r, "Colour bands (--sh-degree)", words, bands, 1);
    snprintf(words, sizeof words, "%d, cuts %s", r->blocks, report_word(r, "cut", REPORT_CUTS, 2));
    report_decision(r, "Blocks", r->blocks == 1 ? "1" : words, partition, 6);
    report_ucd(r, words);
    report_decision(r, "More where water takes contrast (--ucd)", words, ucd, 1);
    report_keep(r, words);
    report_decision(r, "Pruning (--keep)", words, keep, 1);
    report_decision(r, "Second lobes (--dog)", report_word(r, "dog", REPORT_DOGS, 4), dog, 1);
    study_add(t, "</dl>\n</section>\n");
    free(preset);
}

/* ---------------------------------------------------------------- warnings */

static void report_warning(void *user, int block, const char *text)
{
    struct report_list *list = user;
    struct study_text  *t    = &list->r->page;
    if (list->count++ >= REPORT_NOTES) return;
    study_add(t, "%s<li>", list->count == 1 ? "<ul>\n" : "");
    if (block >= 0 && list->r->blocks > 1) study_add(t, "%s: ", REPORT_PART(list->r, block));
    page_text(t, text);
    study_add(t, "</li>\n");
}

/* What the figures say by themselves. */
static void report_own_warnings(struct report *r, struct report_list *list)
{
    const double predicted = report_metric(r, "predicted_memory_bytes"), peak = report_metric(r, "peak_rss_bytes");
    char         words[160];
    if (!json_is_true(r->run, "finished"))
        report_warning(list, -1, "the run is not finished; run the same command again, and it goes on");
    for (int k = 0; k < r->parts && r->blocks > 1; k++)
        if (!json_is_true(r->block[k].json, "finished")) report_warning(list, k, "not finished");
    if (r->metrics && json_number(r->survey, "test_views") <= 0)
        report_warning(list, -1, "no view was held out: the figures are of photographs that training has seen (--test-every 8)");
    if (peak > 1.5 * predicted) {
        snprintf(words, sizeof words, "it took %s of memory, %s were predicted", PAGE_BYTES(peak), PAGE_BYTES(predicted));
        report_warning(list, -1, words);
    }
}

static void report_warnings(struct report *r)
{
    struct report_list list = {r, NULL, 0};
    page_section(&r->page, "Warnings");
    report_own_warnings(r, &list);
    report_each_note(r, "warning", report_warning, &list);
    study_add(&r->page, list.count > 0 ? "</ul>\n" : "<p>None.</p>\n");
    if (list.count > REPORT_NOTES) study_add(&r->page, "<p>And %d more.</p>\n", list.count - REPORT_NOTES);
    study_add(&r->page, "</section>\n");
}

/* ---------------------------------------------------------------- blocks, seams, sizes, times */

static void report_block_rows(struct report *r)
{
    struct study_text *t = &r->page;
    study_add(t,
              "<div class=\"scroll\"><table><tr><th>block<th class=\"n\">iterations<th class=\"n\">Gaussians<th class=\"n\">time"
              "<th class=\"n\">predicted<th class=\"n\">memory<th class=\"n\">predicted</tr>\n");
    for (int k = 0; k < r->parts; k++) {
        const char *b = r->block[k].json;
        study_add(
            t,
            "<tr><td>%s<td class=\"n\">%s<td class=\"n\">%s<td class=\"n\">%s<td class=\"n\">%s<td class=\"n\">%s<td class=\"n\">%s</tr>\n",
            REPORT_PART(r, k), PAGE_COUNT(json_number(b, "iterations_done")), PAGE_COUNT(json_number(b, "gaussians")),
            PAGE_SECONDS(json_number(b, "seconds")), PAGE_SECONDS(json_number(b, "predicted_seconds")),
            PAGE_BYTES(json_number(b, "peak_rss_bytes")), PAGE_BYTES(json_number(b, "predicted_memory_bytes")));
    }
    study_add(
        t,
        "</table></div>\n<p><small>Memory is the peak of the process that trained the block, all that it did before included.</small></p>\n");
}

static void report_seam(struct report *r)
{
    const char  *seam      = json_member(r->metrics, "seam");
    const double near_psnr = json_number(seam, "near_psnr"), elsewhere = json_number(seam, "elsewhere_psnr");
    if (!isfinite(near_psnr) || !isfinite(elsewhere)) return;
    study_add(
        &r->page,
        "<h3>Seams</h3>\n<p>Within %s %% of a block's size from the borders: <b>%s dB</b>, over %s px; elsewhere: <b>%s dB</b>. ",
        STUDY_FIXED(100 * json_number(seam, "width"), 0), STUDY_FIXED(near_psnr, 2), PAGE_COUNT(json_number(seam, "near_pixels")),
        STUDY_FIXED(elsewhere, 2));
    study_add(&r->page, "The difference is %s dB.</p>\n", STUDY_FIXED(near_psnr - elsewhere, 2));
}

static void report_sizes(struct report *r)
{
    page_section(&r->page, r->blocks > 1 ? "Blocks, seams, sizes, times" : "Sizes and times");
    report_block_rows(r);
    report_seam(r);
    study_add(&r->page, "</section>\n");
}

/* ---------------------------------------------------------------- to repeat it */

/* A word for a POSIX shell: quoted where it has to be. */
static void report_shell(struct study_text *t, const char *word)
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

static void report_number_option(struct report *r, const char *option, const char *name, double fresh)
{
    const double value = json_number(r->job, name);
    if (isfinite(value) && value != fresh) study_add(&r->page, " %s %s", option, STUDY_FIXED(value, 0));
}

/* A share or a weight, with every digit that it needs. */
static void report_share_option(struct report *r, const char *option, const char *name, float fresh)
{
    const double value = json_number(r->job, name);
    char         digits[32];
    report_digits(r, name, digits);
    if (isfinite(value) && (float)value != fresh) study_add(&r->page, " %s %s", option, value < 0 ? "auto" : digits);
}

static void report_word_option(struct report *r, const char *option, const char *word, const char *fresh)
{
    if (strcmp(word, fresh) == 0) return;
    study_add(&r->page, " %s ", option);
    report_shell(&r->page, word);
}

static void report_folder_option(struct report *r, const char *option, const char *name)
{
    char *folder = json_string(json_member(r->job, name));
    if (folder) report_word_option(r, option, folder, "");
    free(folder);
}

/* The command that gives the same bytes: every option that differs from the preset's. */
static void report_command(struct report *r)
{
    const double    refine = json_number(r->run, "refine");
    char           *preset = json_string(json_member(r->run, "preset"));
    const int       which  = preset && strcmp(preset, "paper") == 0 ? 2 : preset && strcmp(preset, "standard") == 0 ? 1 : 0;
    oxl_job_options fresh  = oxl_job_options_default((oxl_preset)which);
    const double    limit  = json_number(r->job, "dog_threshold");
    char            words[80], digits[32];
    study_add(&r->page, "oceanxl train ");
    report_shell(&r->page, r->scene ? r->scene : "SCENE");
    study_add(&r->page, " -o ");
    report_shell(&r->page, r->out);
    study_add(&r->page, " --preset %s", fresh.preset);
    report_folder_option(r, "--images", "images_folder");
    report_folder_option(r, "--sparse", "sparse_folder");
    report_folder_option(r, "--masks", "masks_folder");
    report_number_option(r, "--seed", "seed", 1);
    report_number_option(r, "--iterations", "iterations", fresh.train.iterations);
    if (json_number(r->job, "sh_degree") >= 0) report_number_option(r, "--sh-degree", "sh_degree", fresh.train.sh_degree);
    else if (fresh.train.sh_degree >= 0) study_add(&r->page, " --sh-degree auto");
    if (json_number(r->job, "robust") > 0) study_add(&r->page, " --robust");
    if (json_number(r->job, "stop_early") > 0) study_add(&r->page, " --stop-early");
    report_number_option(r, "--ssim-every", "ssim_every", fresh.train.ssim_every);
    report_number_option(r, "--exp", "exp_degree", fresh.train.exp_degree);
    report_share_option(r, "--alpha-min", "alpha_min", fresh.train.alpha_min);
    report_share_option(r, "--tile-share", "tile_share", fresh.train.tile_share);
    report_share_option(r, "--coarse", "coarse", fresh.train.coarse);
    report_share_option(r, "--sh-every", "bands_every", fresh.train.bands_every);
    report_share_option(r, "--haste", "haste", fresh.train.haste);
    report_share_option(r, "--settle", "settle", fresh.train.settle);
    report_number_option(r, "--max-gaussians", "max_gaussians", fresh.train.max_gaussians);
    report_number_option(r, "--max-side", "max_side", fresh.scene.max_side);
    report_number_option(r, "--test-every", "test_every", fresh.scene.test_every);
    report_number_option(r, "--block-points", "block_points", fresh.partition.block_points);
    if (isfinite(refine) && (float)refine != fresh.refine) study_add(&r->page, " --refine %g", refine);
    report_number_option(r, "--ram", "ram", 0);
    report_word_option(r, "--partition", report_word(r, "partition", REPORT_AXES, 4), "auto");
    report_word_option(r, "--split", report_word(r, "cut", REPORT_CUTS, 2), "balanced");
    report_ucd(r, words);
    report_word_option(r, "--ucd", words, fresh.train.ucd.mode == OXL_UCD_AUTO ? "auto" : fresh.train.ucd.mode ? "on" : "off");
    report_keep(r, words);
    report_word_option(r, "--keep", words, "all");
    report_word_option(r, "--dog", report_word(r, "dog", REPORT_DOGS, 4), "off");
    report_digits(r, "dog_threshold", digits);
    if (limit < 0) study_add(&r->page, " --dog-threshold %s%%", STUDY_FIXED(-100 * limit, 6));
    else if (fabs(limit - (double)fresh.train.dog_threshold) > 1e-9) study_add(&r->page, " --dog-threshold %s", digits);
    study_add(&r->page, "\n");
    free(preset);
}

static void report_repeat(struct report *r)
{
    struct study_text *t           = &r->page;
    char              *version     = json_string(json_member(r->run, "oceanxl"));
    char              *instruction = json_string(json_member(r->run, "instructions"));
    page_section(t, "To repeat it");
    study_add(t, "<p>The same survey, options and seed give the same bytes, with any number of threads.</p>\n<pre>");
    report_command(r);
    study_add(t, "oceanxl eval ");
    report_shell(t, r->out);
    study_add(t, "/scene.ply ");
    report_shell(t, r->scene ? r->scene : "SCENE");
    study_add(t, "\n</pre>\n<p><small>OceanXL ");
    page_text(t, version ? version : "");
    study_add(t, ", %s threads, instructions ", PAGE_COUNT(json_number(r->run, "threads")));
    page_text(t, instruction ? instruction : "");
    study_add(t, ". All options stand in run.json, the line \"job\".</small></p>\n</section>\n");
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
    page_section(&r->page, "What went in");
    map_section(r);
    report_found(r);
    study_add(&r->page, "</section>\n");
    report_decisions(r);
    chart_section(r);
    report_sizes(r);
    report_repeat(r);
    page_close(&r->page, OXL_VERSION);
}

static oxl_result report_save(struct report *r, char *error, size_t error_size)
{
    struct synth_file file;
    char              path[1024];
    if (snprintf(path, sizeof path, "%s/report.html", r->out) >= (int)sizeof path) {
        snprintf(error, error_size, "report: the folder's name is too long");
        return OXL_ERR_USAGE;
    }
    synth_file_open(&file, path);
    synth_file_bytes(&file, r->page.data, r->page.used);
    if (synth_file_close(&file)) return OXL_OK;
    snprintf(error, error_size, "report: cannot write %s\nfix: look for room on the disk, and for permission", path);
    return OXL_ERR_IO;
}

oxl_result report_write(oxl_context *ctx, const char *out, char *error, size_t error_size)
{
    struct report r  = {.ctx = ctx, .out = out};
    oxl_result    rc = OXL_OK;
    r.run            = report_read(&r, "run.json", NULL);
    if (!json_member(r.run, "job")) {
        snprintf(error, error_size, "%s holds no run.json of a run\nfix: oceanxl train SCENE -o %s comes first", out, out);
        free(r.run);
        return OXL_ERR_INPUT;
    }
    report_open(&r);
    if (!r.page.failed) report_compose(&r);
    if (r.page.failed) {
        snprintf(error, error_size, "report: no memory for the page of %s", out);
        rc = OXL_ERR_MEMORY;
    }
    if (rc == OXL_OK) rc = report_save(&r, error, error_size);
    report_close(&r);
    return rc;
}
