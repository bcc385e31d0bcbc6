/* report_state.h - declares what the files of the report share: one self-contained page about a run.
 *
 *     report.c         writes the page from top to bottom
 *     report_read.c    reads OUT
 *     report_page.c    the page's frame: style, base64, JPEG
 *     report_chart.c   curves over the iterations as inline SVG
 *     report_verdict.c meaning of the figures in words
 *     report_ground.c  the survey and its orthomosaic
 *     report_map.c     cameras and points from above
 *     report_views.c   views by PSNR; the worst beside their images, with an error map
 */
#ifndef REPORT_H
#define REPORT_H

#include "cli.h"

/* Columns of log.csv. */
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
    char *json;  /* text of block.json; NULL: the block is not trained yet */
    int rows;    /* number of rows of log.csv */
    double *log; /* (rows,LOG_COLUMNS) values; NaN: missing */
};

struct report {
    oxl_context *ctx;
    const char *out;          /* folder of the run */
    double scale;             /* metres a unit; 0: lengths are in the survey's unit */
    char *run, *scene;        /* text of run.json; the survey's folder as it was given */
    char *metrics;            /* text of metrics.json; NULL: the run is not evaluated yet */
    const char *job, *survey; /* members of run */
    oxl_job_options options;  /* options that run.json has */
    oxl_manifest *manifest;   /* holds the strings of options; NULL: not read */
    int blocks, parts;        /* parts: blocks, and the coarse and the merged model if they are there */
    struct report_block *block;
    oxl_context *silent; /* context of survey_scene without log: the run has logged its warnings already */
    oxl_scene *survey_scene; /* survey as the run read it, without its images; NULL: not found */
    oxl_model viewed;        /* scene.ply, which other viewers show; empty: not read */
    struct overview ground;  /* map from above; image.rgb NULL: there is none */
    struct output page;
    int sections; /* number of sections begun */
};

/* ---------------- report_read.c */

void report_open(struct report *r); /* reads OUT; r->run is read already */
void report_close(struct report *r);
/* Writes "block 3", "coarse model" or "merged model"; returns out. */
const char *report_part(const struct report *r, int part, char out[40]);
#define REPORT_PART(r, part) report_part(r, part, (char[40]){0})

/* ---------------- report.c */

/* Adds to a command of eval or render the options by which the run read its survey. */
void report_survey_options(struct report *r);

/* Tells a loss of images without gains and lamp from so many dB on. */
#define REPORT_VIEWER_LOSS 0.5

/* ---------------- report_page.c */

void page_open(struct output *t, const char *title);
void page_section(struct report *r, const char *title); /* ends the section before, and begins one */
void page_data(struct output *t, const char *type, const void *data, size_t size); /* writes a data: URI */
/* Writes an image as a data: URI of JPEG; q: its quality. */
void page_jpeg(struct report *r, const oxl_image *image, int q);

/* ---------------- the sections */

void chart_section(struct report *r);
void map_section(struct report *r);
void verdict_section(struct report *r);
/* Load the survey and the model and render the overview; free them. */
void ground_open(struct report *r);
void ground_close(struct report *r);
/* Renders a view of the survey as other viewers show it. Returns 0 if the model or the view is not there. */
int ground_view(struct report *r, const char *name, oxl_image *out);
void ground_tiles(struct report *r);
void ground_section(struct report *r);
void views_section(struct report *r);
void views_training_section(struct report *r); /* is in report_views.c */

#endif
