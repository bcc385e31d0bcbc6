/* report_read.c - reads the files of a run that the report shows: run.json, metrics.json, and of each block block.json and log.csv. */
#include "report_state.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { REPORT_BLOCKS = 100000 };

static const char *const REPORT_NAMES[REPORT_COLUMNS] = {"iteration", "loss",  "psnr",          "gaussians",
                                                         "f_mid",     "f_far", "peak_rss_bytes"};

/* Our column at each position of the file; -1: none. */
static int report_columns(const char *text, int *column, int most)
{
    int n = 0;
    for (const char *at = text; n < most;) {
        const size_t length = strcspn(at, ",\r\n");
        column[n]           = -1;
        for (int k = 0; k < REPORT_COLUMNS; k++)
            if (strlen(REPORT_NAMES[k]) == length && strncmp(at, REPORT_NAMES[k], length) == 0) column[n] = k;
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
    int    column[32], columns = report_columns(text, column, 32);
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
    else snprintf(out, 40, part == r->blocks ? "coarse model" : "merged model");
    return out;
}

static void report_read_block(struct report *r, int k)
{
    char name[64], folder[32], *log;
    if (k < r->blocks) snprintf(folder, sizeof folder, "blocks/%03d", k);
    else snprintf(folder, sizeof folder, "blocks/%s", k == r->blocks ? "coarse" : "whole");
    snprintf(name, sizeof name, "%s/block.json", folder);
    r->block[k].json = output_read(r->out, name, NULL);
    snprintf(name, sizeof name, "%s/log.csv", folder);
    log = output_read(r->out, name, NULL);
    if (log) report_read_log(r, &r->block[k], log);
    free(log);
}

void report_open(struct report *r)
{
    const double blocks = json_number(r->run, "blocks");
    r->job              = json_member(r->run, "job");
    r->survey           = json_member(r->run, "survey");
    r->scene            = json_string(json_member(r->job, "scene"));
    r->metrics          = output_read(r->out, "metrics.json", NULL);
    r->options          = oxl_job_options_default(OXL_PRESET_DRAFT);
    if (r->scene) oxl_job_resume(r->ctx, r->scene, r->out, &r->options, &r->manifest);
    r->blocks = blocks >= 1 && blocks <= REPORT_BLOCKS ? (int)blocks : 1;
    r->block  = calloc((size_t)r->blocks + 2, sizeof *r->block);
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
