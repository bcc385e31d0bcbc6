/* report_state.h - the interface between the files of the report: one self-contained page about a run.
 *
 *     report.c         writes the page from top to bottom
 *     report_read.c    reads OUT
 *     report_page.c    the page's frame: style, base64, JPEG
 *     report_chart.c   curves over the iterations as inline SVG
 *     report_verdict.c what the figures mean, in words
 *     report_ground.c  the survey and its orthomosaic
 *     report_map.c     cameras and points from above
 *     report_views.c   views by PSNR; the worst beside their images, with an error map
 */
#ifndef REPORT_H
#define REPORT_H

#include "cli.h"

/* Of log.csv. */
enum log_column {
    LOG_ITERATION,
    LOG_LOSS,
    LOG_PSNR,
    LOG_GAUSSIANS,
    LOG_F_MID,
    LOG_F_FAR,
    LOG_MEMORY,
    LOG_COLUMNS
};

struct report_block {
    char *json;  /* block.json, or NULL: not trained yet */
    int rows;    /* of log.csv */
    double *log; /* (rows,LOG_COLUMNS); NaN: missing */
};

struct report {
    oxl_context *ctx;
    const char *out;          /* folder */
    double scale;             /* metres a unit; 0: lengths are in the survey's unit */
    char *run, *scene;        /* run.json; the survey's folder as it was given */
    char *metrics;            /* metrics.json, or NULL: not evaluated yet */
    const char *job, *survey; /* within run */
    oxl_job_options options;  /* as of run.json */
    oxl_manifest *manifest;   /* holds their strings; NULL: not read */
    int blocks, parts;        /* parts: the blocks, then the coarse and the merged model if they are there */
    struct report_block *block;
    oxl_context *silent;     /* of the survey below: the run has logged its warnings already */
    oxl_scene *survey_scene; /* as the run read it, without its images; NULL: not found */
    oxl_large_model viewed;  /* scene.ply, which other viewers show; empty: not opened */
    struct overview ground;  /* image.rgb NULL: there is none */
    struct output page;
    int sections; /* begun */
};

/* ---------------- report_read.c */

void report_open(struct report *r); /* r->run is there */
void report_close(struct report *r);
/* "block 3", "coarse model", "merged model"; returns out. */
const char *report_part(const struct report *r, int part, char out[40]);
#define REPORT_PART(r, part) report_part(r, part, (char[40]){0})

/* ---------------- report.c */

/* Adds to a command of eval or render the options by which the run read its survey. */
void report_survey_options(struct report *r);

/* dB that the images lose without gains and lamp; a smaller difference is not told */
#define REPORT_VIEWER_LOSS 0.5

/* ---------------- report_page.c */

void page_open(struct output *t, const char *title);
void page_section(struct report *r, const char *title);                            /* ends the one before */
void page_data(struct output *t, const char *type, const void *data, size_t size); /* a data: URI */
/* A figure that is rendered from an image; q: of the JPEG. */
void page_jpeg(struct report *r, const oxl_image *image, int q);

/* ---------------- the sections */

void chart_section(struct report *r);
void map_section(struct report *r);
void verdict_section(struct report *r);
/* loads the survey and the model, and renders the overview; frees them */
void ground_open(struct report *r);
void ground_close(struct report *r);
/* Renders a view of the survey as other viewers show it. 0: the model or the view is not there. */
int ground_view(struct report *r, const char *name, oxl_image *out);
void ground_tiles(struct report *r);
void ground_section(struct report *r);
void views_section(struct report *r);
void views_training_section(struct report *r); /* report_views.c */

#endif
