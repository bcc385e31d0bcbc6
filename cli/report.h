/* report.h - declares what the files of the report share: one self-contained page about a run.
 *
 *     report.c         reads OUT and writes the page from top to bottom
 *     report_page.c    the page's frame: style, base64, JPEG
 *     chart.c          curves over the iterations as inline SVG
 *     report_views.c   views by PSNR; the worst beside their images, with an error map
 */
#ifndef REPORT_H
#define REPORT_H

#include "cli.h"

#define REPORT_GAP 0.02 /* least share of pixels that no training view shows which is worth a word */

struct report_part { /* a block, the coarse or the merged model */
    char name[40];
    char *json, *log; /* text of block.json and log.csv; log NULL: there is none */
};

struct report {
    oxl_context *ctx;
    const char *out;          /* folder of the run */
    double unit;              /* metres per unit; 1 if it is not known */
    const char *words;        /* "metres" or "units" */
    char *run, *scene;        /* text of run.json; the survey's folder as it was given */
    char *metrics;            /* text of metrics.json; NULL: the run is not evaluated yet */
    const char *job, *survey; /* members of run */
    oxl_job_options options;  /* options that run.json has */
    oxl_manifest *manifest;   /* holds the strings of options; NULL: not read */
    int blocks, parts;        /* parts: those that have begun */
    struct report_part *part;
    struct output page;
};

/* ---------------- report_page.c */

void page_open(struct output *t, const char *title);
void page_data(struct output *t, const void *data, size_t size); /* writes a data: URI of JPEG */
void page_jpeg(struct report *r, const oxl_image *image);        /* writes an image as a data: URI of JPEG */

/* ---------------- the sections */

void chart_section(struct report *r);
void views_section(struct report *r, const char *title, const char *list, const char *folder);

#endif
