/* report_read.c - reads the files of a run that the report shows: run.json, metrics.json, and of each block
 * block.json and log.csv. */
#include "report_state.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { REPORT_BLOCKS = 100000 };

static const char *const REPORT_NAMES[LOG_COLUMNS] = {"iteration", "loss",  "psnr",          "gaussians",
                                                      "f_mid",     "f_far", "peak_rss_bytes"};

/* Returns the position of a column in the first line; -1: there is no such column. */
static int report_place(const char *line, const char *name)
{
    for (int i = 0;; i++, line++) {
        const size_t length = strcspn(line, ",\r\n");
        if (strlen(name) == length && strncmp(line, name, length) == 0) return i;
        line += length;
        if (*line != ',') return -1;
    }
}

static double report_field(const char *line, int place)
{
    for (; place > 0; place--) {
        line += strcspn(line, ",\r\n");
        if (*line++ != ',') return NAN;
    }
    return place == 0 ? oxl_json_number_at(&line) : NAN;
}

static void report_read_log(struct report *r, struct report_block *b, const char *text)
{
    int place[LOG_COLUMNS];
    size_t lines = 0;
    for (int k = 0; k < LOG_COLUMNS; k++) place[k] = report_place(text, REPORT_NAMES[k]);
    for (const char *at = text; *at; at++) lines += *at == '\n';
    b->log = malloc((lines + 1) * LOG_COLUMNS * sizeof *b->log);
    if (!b->log) r->page.failed = 1;
    for (const char *at = strchr(text, '\n'); b->log && at && at[1]; at = strchr(at + 1, '\n')) {
        double *row = b->log + (size_t)b->rows * LOG_COLUMNS;
        for (int k = 0; k < LOG_COLUMNS; k++) row[k] = report_field(at + 1, place[k]);
        b->rows += isfinite(row[LOG_ITERATION]);
    }
}

const char *report_part(const struct report *r, int part, char out[40])
{
    if (part < r->blocks) snprintf(out, 40, "block %d", part);
    else snprintf(out, 40, part == r->blocks ? "coarse model" : "merged model");
    return out;
}

static void report_read_block(struct report *r, int k)
{
    char folder[4200], *log;
    snprintf(folder, sizeof folder, "%s/blocks/%s", r->out, k == r->blocks ? "coarse" : "whole");
    if (k < r->blocks) snprintf(folder, sizeof folder, "%s/blocks/%03d", r->out, k);
    r->block[k].json = output_read(folder, "block.json", NULL);
    log = output_read(folder, "log.csv", NULL);
    if (log) report_read_log(r, &r->block[k], log);
    free(log);
}

void report_open(struct report *r)
{
    const double blocks = oxl_json_number(r->run, "blocks");
    r->job = oxl_json_member(r->run, "job");
    r->survey = oxl_json_member(r->run, "survey");
    r->scene = json_string(oxl_json_member(oxl_json_member(r->run, "inputs"), "scene"));
    r->metrics = output_read(r->out, "metrics.json", NULL);
    r->options = oxl_job_options_default(OXL_PRESET_DRAFT);
    if (r->scene) oxl_job_resume(r->ctx, r->scene, r->out, &r->options, &r->manifest);
    r->blocks = blocks >= 1 && blocks <= REPORT_BLOCKS ? (int)blocks : 1;
    r->block = calloc((size_t)r->blocks + 2, sizeof *r->block);
    if (!r->block) r->page.failed = 1, r->blocks = 0;
    for (int k = 0; r->block && k < r->blocks + (r->blocks > 1 ? 2 : 0); k++) report_read_block(r, k);
    r->parts = r->blocks;
    while (r->block && r->parts < r->blocks + 2 && r->block[r->parts].json) r->parts++;
}

void report_close(struct report *r)
{
    for (int k = 0; r->block && k < r->blocks + 2; k++) {
        free(r->block[k].json);
        free(r->block[k].log);
    }
    oxl_manifest_free(r->ctx, &r->manifest);
    free(r->block);
    free(r->run);
    free(r->scene);
    free(r->metrics);
    free(r->page.data);
}
