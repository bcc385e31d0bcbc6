/* main.c - the command line: parse, call, print; no algorithm.
 *
 * Results go to standard output, everything else to standard error. Parsing is in cli/arguments.c, help in
 * cli/help.c.
 */
#ifndef _DEFAULT_SOURCE
/* glibc's signal() in strict C99 drops the handler at the first signal; with this it stays */
#define _DEFAULT_SOURCE 1
#endif
#include "cli/cli.h"
#include "lab/lab.h"

#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#ifdef __GLIBC__
#include <malloc.h>
#endif
#if defined(_OPENMP) && !defined(_WIN32)
#include <unistd.h>
#endif

/* ---------------- standard error: log lines and the progress */

#define LIVE_SECONDS 0.2   /* between two states of the live line */
#define PLAIN_SECONDS 10.0 /* between two lines in a pipe, unless a twentieth of the run comes first */

enum { ALLOCATION_HEAD = 16, ALLOCATION_MAPPED = 4 << 20, ALLOCATION_TRIM = 32 << 20 };

struct console {
    int json;        /* standard error is JSON lines */
    int quiet, live; /* live: standard error is a terminal, one line is rewritten */
    int shown;       /* the live line has no newline yet */
    int twentieth;   /* of the run, last shown */
    int iteration;   /* at the last line */
    double seconds;
    double rate; /* iterations a second, smoothed */
    struct cli_memory memory;
};

static volatile sig_atomic_t stop_requested;
static time_t stop_time;

/* A second Ctrl-C within a fraction of a second is a duplicate: timeout, for example, signals the program and
 * then its group. */
static void on_signal(int number)
{
    const time_t now = time(NULL);
    if (!stop_requested) stop_time = now;
    signal(number, now > stop_time + 1 ? SIG_DFL : on_signal);
    if (now > stop_time + 1) raise(number);
    stop_requested = 1;
}

static int is_stopped(void *user)
{
    (void)user;
    return stop_requested;
}

static void catch_signals(void)
{
    signal(SIGINT, on_signal);
    signal(SIGTERM, on_signal);
#ifdef SIGHUP
    /* a closed terminal; nohup ignores it */
    if (signal(SIGHUP, SIG_IGN) != SIG_IGN) signal(SIGHUP, on_signal);
#endif
#ifdef SIGPIPE
    signal(SIGPIPE, SIG_IGN); /* the reader of a pipe has ended; training continues */
#endif
}

static void console_clear(struct console *c)
{
    if (c->shown) fputs("\r\033[K", stderr);
    c->shown = 0;
}

/* Further lines are indented below. */
static void print_error(const char *kind, const char *text)
{
    fprintf(stderr, "oxl: %s", kind);
    for (size_t size; *text; text += size) {
        const char *end = strchr(text, '\n');
        char line[2048];
        size = end ? (size_t)(end + 1 - text) : strlen(text);
        if (size >= sizeof line) size = sizeof line - 1;
        memcpy(line, text, size);
        line[size] = 0;
        print_text(stderr, line);
        if (end && end < text + size) fputs("     ", stderr);
    }
    fputc('\n', stderr);
}

static void on_log(void *user, oxl_log_level level, const char *text)
{
    struct console *c = user;
    if (level == OXL_LOG_DEBUG || (c->quiet && level == OXL_LOG_INFO)) return;
    if (c->json) {
        fprintf(stderr, "{\"event\": \"log\", \"level\": \"%s\", \"text\": ",
                level == OXL_LOG_INFO      ? "info"
                : level == OXL_LOG_WARNING ? "warning"
                                           : "error");
        json_print(stderr, text);
        fputs("}\n", stderr);
        return;
    }
    console_clear(c);
    print_error(level == OXL_LOG_WARNING ? "warning: " : "", text);
}

/* The library's memory, counted and limited by --ram: the size of each allocation stands before it. */
static void *reallocate(void *user, void *old, size_t size)
{
    struct cli_memory *m = &((struct console *)user)->memory;
    size_t *had = old ? (size_t *)((char *)old - ALLOCATION_HEAD) : NULL, *now;
    const size_t before = had ? *had : 0;
    if (size > 0 && m->limit > 0 && size > before && m->used + (size - before) > m->limit) return NULL;
    if (size > 0 && (size > SIZE_MAX - ALLOCATION_HEAD || !(now = realloc(had, size + ALLOCATION_HEAD))))
        return NULL;
    m->used = m->used - before + size;
    if (m->used > m->peak) m->peak = m->used;
    if (size == 0) {
        free(had);
        return NULL;
    }
    *now = size;
    return (char *)now + ALLOCATION_HEAD;
}

static void print_progress(struct console *c, const oxl_progress *p)
{
    const double rate =
        (p->iteration - c->iteration) / (p->seconds > c->seconds ? p->seconds - c->seconds : 1e-9);
    /* a trial starts at an earlier step */
    if (rate > 0) c->rate = c->rate > 0 ? 0.7 * c->rate + 0.3 * rate : rate;
    c->iteration = p->iteration;
    c->seconds = p->seconds;
    if (c->json) {
        fprintf(
            stderr,
            "{\"event\": \"progress\", \"block\": %d, \"blocks\": %d, \"trial\": %s, \"iteration\": %d, \"iterations\": %d, "
            "\"loss\": %.6g, \"psnr\": %.4g, \"gaussians\": %zu, \"seconds\": %.1f, \"seconds_left\": %.1f, \"memory\": %.0f}\n",
            p->block, p->blocks, p->trial ? "true" : "false", p->iteration, p->iterations, p->loss, p->psnr,
            p->gaussians, p->seconds, p->seconds_left, (double)p->memory);
        fflush(stderr);
        return;
    }
    console_clear(c);
    if (p->blocks > 1 && p->block < p->blocks) fprintf(stderr, "block %d/%d ", p->block, p->blocks);
    if (p->blocks > 1 && p->block == p->blocks) fprintf(stderr, "merged model ");
    fprintf(stderr, "%s%6d/%d  loss %.4f  PSNR %.2f dB  %zu Gaussians  %.1f it/s  %.0f MB  ETA %s%s",
            p->trial ? "trial " : "", p->iteration, p->iterations, p->loss, p->psnr, p->gaussians, c->rate,
            (double)p->memory / 1e6, OUTPUT_SECONDS(p->seconds_left), c->live ? "" : "\n");
    c->shown = c->live;
    fflush(stderr);
}

static int on_progress(void *user, const oxl_progress *p)
{
    struct console *c = user;
    const int twentieth = (int)(20.0 * p->iteration / (p->iterations > 0 ? p->iterations : 1));
    double since;
    int due;
    if (p->seconds < c->seconds) { /* another block or job */
        c->iteration = p->iteration;
        c->seconds = p->seconds;
        c->twentieth = 0;
        c->rate = 0;
    }
    since = p->seconds - c->seconds;
    due = c->live || c->json ? since >= LIVE_SECONDS : twentieth > c->twentieth || since >= PLAIN_SECONDS;
    if ((!c->quiet || c->json) && (due || p->iteration == p->iterations)) {
        c->twentieth = twentieth;
        print_progress(c, p);
    }
    return stop_requested;
}

/* ---------------- from arguments to options */

/* An existing run keeps its options, unless another preset is given. */
static oxl_result resumed_options(oxl_context *ctx, const struct arguments *a, oxl_job_options *o,
                                  oxl_manifest **run)
{
    struct arguments changes = *a;
    oxl_result rc = OXL_OK;
    *o = a->job;
    *run = NULL;
    if (!a->job.restart) rc = oxl_job_resume(ctx, a->path[0], a->out, o, run);
    /* setting it would reset the others */
    if (a->given[0] && o->preset && strcmp(o->preset, a->given[0]) == 0) changes.given[0] = NULL;
    if (rc == OXL_OK) arguments_apply(&changes, o);
    return rc;
}

/* ---------------- commands */

static int file_exists(const char *path)
{
    FILE *file = fopen(path, "rb");
    if (file) fclose(file);
    return file != NULL;
}

static int has_file(const char *folder, const char *name)
{
    char path[4096];
    snprintf(path, sizeof path, "%s/%s", folder, name);
    return file_exists(path);
}

static void print_resume(const struct arguments *a)
{
    const char *out = a->out ? a->out : a->path[0];
    if (!has_file(out, "run.json")) {
        print_error("", "interrupted before anything was trained\nresume: the same command again");
        return;
    }
    print_format(
        stderr,
        "oxl: interrupted; the state is saved, and %s/blocks/*/model.ply holds the current model\n     resume: ",
        out);
    if (a->out) print_format(stderr, "oceanxl train %s -o %s", PRINT_WORD(a->path[0]), PRINT_WORD(out));
    else print_format(stderr, "oceanxl merge %s", PRINT_WORD(out));
    if (a->out && a->job.block >= 0) fprintf(stderr, " --block %d", a->job.block);
    fputc('\n', stderr);
}

static void print_results(const char *out, int json)
{
    char *metrics = output_read(out, "metrics.json", NULL);
    if (!metrics) print_format(stdout, "unfinished %s\n", out);
    else if (json) fputs(metrics, stdout);
    else {
        print_format(stdout, "model     %s/scene.ply\n", out);
        if (has_file(out, "scene_standard.ply"))
            print_format(stdout, "standard  %s/scene_standard.ply, for other viewers\n", out);
        print_format(stdout, "metrics   %s/metrics.json\nrenders   %s/renders\nreport    %s/report.html\n",
                     out, out, out);
    }
    free(metrics);
}

static oxl_result run_control(oxl_context *ctx, const struct arguments *a, const oxl_job_options *options)
{
    oxl_scene_options read = options->scene;
    oxl_scene *scene = NULL;
    oxl_result rc;
    if (a->json) return oxl_fail(ctx, OXL_ERR_USAGE, "--control prints a table\nfix: without --json");
    read.read_images = 0;
    rc = oxl_scene_load(ctx, a->path[0], &read, &scene);
    if (rc == OXL_OK) rc = control_check(ctx, scene, a->control, stdout);
    oxl_scene_free(ctx, scene);
    return rc;
}

static oxl_result run_check(oxl_context *ctx, const struct arguments *a, const oxl_job_options *options)
{
    oxl_survey survey;
    char *json = NULL;
    oxl_result rc = (a->quality ? oxl_check_quality : oxl_check)(ctx, a->path[0], options, &survey);
    if (rc == OXL_OK && a->json) rc = oxl_survey_to_json(ctx, &survey, &json);
    if (rc == OXL_OK) print_text(stdout, json ? json : survey.text);
    oxl_text_free(ctx, json);
    if (rc == OXL_OK && a->control) rc = run_control(ctx, a, options);
    return rc;
}

static oxl_result run_train(oxl_context *ctx, const struct arguments *a, struct console *console)
{
    const oxl_callback callback = {on_progress, console};
    oxl_job_options options;
    oxl_manifest *run;
    oxl_result rc = resumed_options(ctx, a, &options, &run);
    if (a->dry_run) {
        if (rc == OXL_OK) rc = run_check(ctx, a, &options);
        oxl_manifest_free(ctx, &run);
        return rc;
    }
    if (rc == OXL_OK) {
        catch_signals();
        rc = oxl_job_run(ctx, a->path[0], a->out, &options, &callback);
        console_clear(console);
    }
    oxl_manifest_free(ctx, &run);
    if (rc == OXL_ERR_INTERRUPTED && console->json) on_log(console, OXL_LOG_WARNING, oxl_error_text(ctx));
    else if (rc == OXL_ERR_INTERRUPTED) print_resume(a);
    if (rc == OXL_OK && a->job.block < 0) rc = report_write(ctx, a->out);
    if (rc != OXL_OK) return rc;
    if (a->job.block >= 0) print_format(stdout, "block     %s/blocks/%03d\n", a->out, a->job.block);
    else print_results(a->out, a->json);
    return rc;
}

static oxl_result run_merge(oxl_context *ctx, const struct arguments *a, struct console *console)
{
    const oxl_callback callback = {on_progress, console};
    oxl_result rc;
    catch_signals();
    rc = oxl_merge(ctx, a->path[0], &callback);
    console_clear(console);
    if (rc == OXL_ERR_INTERRUPTED) print_resume(a);
    if (rc == OXL_OK) rc = report_write(ctx, a->path[0]);
    if (rc == OXL_OK) print_results(a->path[0], 0);
    return rc;
}

static oxl_result run_report(oxl_context *ctx, const struct arguments *a)
{
    const oxl_result rc = report_write(ctx, a->path[0]);
    if (rc == OXL_OK) print_format(stdout, "report    %s/report.html\n", a->path[0]);
    return rc;
}

static oxl_result run_partition(oxl_context *ctx, const struct arguments *a)
{
    oxl_partition_report report = {0};
    char *json = NULL;
    oxl_result rc;
    catch_signals();
    rc = oxl_partition(ctx, a->path[0], a->out, &a->job, &report);
    if (rc == OXL_OK && a->json) rc = oxl_partition_to_json(ctx, &report, &json);
    if (json) fputs(json, stdout);
    else if (rc == OXL_OK) {
        info_print_blocks(stdout, &report);
        print_format(stdout,
                     "\nblocks    %s/blocks\nlist      %s/partition.txt\nmap       %s/partition.svg\n",
                     a->out, a->out, a->out);
    }
    oxl_text_free(ctx, json);
    oxl_partition_report_free(ctx, &report);
    return rc;
}

/* The file of a model that train left: scene.ply is for viewers, and so for orthomosaics and flights;
 * scene_clear.ply, where there is one, gives the images with imaging.txt. */
static const char *model_file(const struct arguments *a, char *path, size_t size)
{
    const char *base = strrchr(a->path[0], '/');
    const int is_scene = strcmp(base ? base + 1 : a->path[0], "scene.ply") == 0;
    const int length = is_scene ? (int)strlen(a->path[0]) - 9 : (int)strlen(a->path[0]);
    snprintf(path, size, "%.*s%sscene_clear.ply", length, a->path[0], is_scene ? "" : "/");
    if ((a->clear || (!a->ortho && !a->flight)) && file_exists(path)) return path;
    snprintf(path, size, "%.*s%sscene.ply", length, a->path[0], is_scene ? "" : "/");
    return file_exists(path) ? path : a->path[0];
}

/* The model in the survey's own frame and unit. */
static oxl_result load(oxl_context *ctx, const struct arguments *a, oxl_model *model, oxl_scene **scene)
{
    char path[4096];
    const char *file = model_file(a, path, sizeof path);
    oxl_scene_options options = a->job.scene;
    oxl_result rc = oxl_model_open(ctx, file, a->job.ram / 4, model);
    if (rc == OXL_OK && model->pages && model->scale > 0) {
        oxl_model_free(ctx, model);
        rc = oxl_model_read(ctx, file, model);
    }
    if (a->job.ram && options.image_cache_bytes > a->job.ram / 4) options.image_cache_bytes = a->job.ram / 4;
    /* convert --scale wrote it in metres */
    if (rc == OXL_OK && model->scale > 0) oxl_model_rescale(model, 1 / model->scale);
    if (rc == OXL_OK && a->job.train.background[0] >= 0) { /* --background */
        memcpy(model->background, a->job.train.background, sizeof model->background);
        model->has_background = 1;
    }
    if (rc == OXL_OK) rc = oxl_scene_load(ctx, a->path[1], &options, scene);
    if (rc == OXL_OK) rc = oxl_scene_read_imaging(ctx, *scene, file);
    /* a block's or another program's has its own */
    if (rc == OXL_OK) oxl_model_move_origin(model, oxl_scene_origin(*scene));
    if (rc == OXL_OK) rc = oxl_model_check_overlap(ctx, model, *scene, a->path[0]);
    return rc;
}

static int on_synth(void *user, const char *what, long done, long total)
{
    struct console *c = user;
    const int twentieth = (int)(20.0 * (double)done / (double)(total > 0 ? total : 1));
    if (!c->quiet && (c->live || twentieth != c->twentieth)) {
        console_clear(c);
        fprintf(stderr, "%s %ld/%ld%s", what, done, total, c->live ? "" : "\n");
        c->shown = c->live;
        fflush(stderr);
    }
    c->twentieth = twentieth;
    return stop_requested;
}

static oxl_result run_render(oxl_context *ctx, const struct arguments *a, struct console *console)
{
    const oxl_render_output what = {(oxl_split)a->split, 0, a->depth, a->scale, a->clear, 0};
    oxl_model model = {0};
    oxl_scene *scene = NULL;
    int count = a->frames;
    oxl_result rc = load(ctx, a, &model, &scene);
    catch_signals();
    if (rc == OXL_OK && a->ortho) rc = ortho_write(ctx, &model, scene, a, stdout);
    else if (rc == OXL_OK && a->flight) rc = flight_write(ctx, &model, scene, a, on_synth, console);
    else if (rc == OXL_OK) rc = oxl_render_views(ctx, &model, scene, &what, a->out, &count);
    console_clear(console);
    if (rc == OXL_OK && !a->ortho) print_format(stdout, "%d images in %s\n", count, a->out);
    oxl_scene_free(ctx, scene);
    oxl_model_free(ctx, &model);
    return rc;
}

static void print_metrics(const oxl_scene *scene, const oxl_metrics *m)
{
    const int lpips = m->lpips == m->lpips; /* not NaN */
    printf("%8s %8s %8s %8s %9s %9s%s  view\n", "PSNR dB", "cc-PSNR", "SSIM", "MS-SSIM", "structure",
           "explained", lpips ? "    LPIPS" : "");
    for (int i = 0; i < m->count; i++) {
        const oxl_view_metrics *v = &m->views[i];
        printf("%8.3f %8.3f %8.5f %8.5f %9.4f %9.3f", v->psnr, v->cc_psnr, v->ssim, v->ms_ssim, v->structure,
               v->explained);
        if (lpips) printf(" %8.5f", v->lpips);
        print_format(stdout, "  %s\n", oxl_scene_view(scene, v->view)->name);
    }
    printf("%8.3f %8.3f %8.5f %8.5f %9.4f %9.3f", m->psnr, m->cc_psnr, m->ssim, m->ms_ssim, m->structure,
           m->explained);
    if (lpips) printf(" %8.5f", m->lpips);
    printf("  mean of %d\n", m->count);
    printf("%8.4f %d  least structure; views below %.1f\n", m->structure_least, m->no_structure,
           OXL_STRUCTURE_NONE);
    if (m->depth[1] > 0)
        printf("%8.3f %8.3f %8.3f  PSNR of what lies nearer than %.3g, in between, beyond %.3g\n",
               m->by_depth[0], m->by_depth[1], m->by_depth[2], m->depth[0], m->depth[1]);
    printf("%8.3f %8.3f  PSNR at mean exposure; of the right halves, with gains fitted on the left halves\n",
           m->plain_psnr, m->half_psnr);
    puts(
        "cc-PSNR: after one factor for each channel of each view: without what images differ in exposure and white balance.");
    puts(
        "structure: correlation of the detail of image and render, whatever the contrast: 0 is a veil. explained: dB of the\n"
        "variance that gains and lamp alone leave of the image.");
}

static oxl_result run_eval(oxl_context *ctx, const struct arguments *a)
{
    oxl_model model = {0};
    oxl_scene *scene = NULL;
    oxl_metrics metrics = {0};
    char *json = NULL;
    oxl_result rc = load(ctx, a, &model, &scene);
    if (rc == OXL_OK && a->job.lpips) rc = oxl_scene_read_lpips(ctx, scene, a->job.lpips);
    if (rc == OXL_OK) rc = oxl_evaluate(ctx, &model, scene, (oxl_split)a->split, &metrics);
    if (rc == OXL_OK && a->json) rc = oxl_metrics_to_json(ctx, scene, &metrics, &json);
    if (rc == OXL_OK && json) fputs(json, stdout);
    if (rc == OXL_OK && !json) print_metrics(scene, &metrics);
    oxl_text_free(ctx, json);
    oxl_metrics_free(ctx, &metrics);
    oxl_scene_free(ctx, scene);
    oxl_model_free(ctx, &model);
    return rc;
}

static oxl_result run_measure(oxl_context *ctx, const struct arguments *a)
{
    oxl_scene_options options = a->job.scene;
    oxl_scene *scene = NULL;
    oxl_result rc;
    if (!a->bar)
        return oxl_fail(ctx, OXL_ERR_USAGE,
                        "measure needs --scale-bar ENDS\nfix: oceanxl measure --help shows one");
    options.read_images = 0;
    rc = oxl_scene_load(ctx, a->path[0], &options, &scene);
    if (rc == OXL_OK) rc = scale_measure(ctx, scene, a->bar, a->length, stdout);
    oxl_scene_free(ctx, scene);
    return rc;
}

static oxl_result run_convert(oxl_context *ctx, const struct arguments *a)
{
    oxl_model model = {0};
    int copied = 0;
    oxl_result rc = oxl_model_read(ctx, a->path[0], &model);
    if (rc == OXL_OK && a->scale > 0) oxl_model_rescale(&model, a->scale);
    if (rc == OXL_OK) rc = oxl_model_write(ctx, a->path[1], &model);
    if (rc == OXL_OK) print_format(stdout, "%zu Gaussians in %s\n", model.count, a->path[1]);
    if (rc == OXL_OK) rc = info_copy_imaging(ctx, a->path[0], a->path[1], &copied);
    if (copied) puts("imaging.txt is copied beside it");
    oxl_model_free(ctx, &model);
    return rc;
}

static oxl_result run_synth(oxl_context *ctx, const struct arguments *a, struct console *console)
{
    synth_options options = a->synth;
    oxl_result rc;
    options.out = a->out;
    options.write_images = !a->no_images;
    options.progress = on_synth;
    options.user = console;
    if (a->threads > 0) options.threads = a->threads;
    catch_signals();
    rc = synth_run(ctx, &options);
    console_clear(console);
    if (rc == OXL_OK) print_format(stdout, "survey    %s\n", a->out);
    return rc;
}

/* ablate and tradeoff: many trainings with the options of a job, a log and a progress line on this
 * console. */
static oxl_result run_study(oxl_context *ctx, const struct arguments *a, struct console *console)
{
    study_options o = {.scene = a->path[0],
                       .out = a->out,
                       .rows = a->rows,
                       .seeds = a->seeds,
                       .budget = a->command == COMMAND_TRADEOFF ? a->budget : 0,
                       .side_is_given = arguments_given(a, "max-side") != NULL,
                       .job = a->job,
                       .memory = &console->memory,
                       .callback = {on_progress, console},
                       .log = on_log};
    oxl_result rc;
    catch_signals();
    rc = (a->command == COMMAND_ABLATE ? ablate_run : tradeoff_run)(ctx, &o, stdout);
    console_clear(console);
    if (rc == OXL_ERR_INTERRUPTED)
        fputs("oxl: interrupted; what is trained is kept\n     resume: the same command again\n", stderr);
    return rc;
}

static oxl_result run_devices(oxl_context *ctx)
{
    char *list = NULL;
    oxl_result rc = oxl_devices(ctx, &list);
    if (rc == OXL_OK) print_text(stdout, list);
    oxl_text_free(ctx, list);
    return rc;
}

static oxl_result run_command(oxl_context *ctx, const struct arguments *a, struct console *console)
{
    switch (a->command) {
    case COMMAND_TRAIN: return run_train(ctx, a, console);
    case COMMAND_CHECK: return run_check(ctx, a, &a->job);
    case COMMAND_RENDER: return run_render(ctx, a, console);
    case COMMAND_EVAL: return run_eval(ctx, a);
    case COMMAND_MEASURE: return run_measure(ctx, a);
    case COMMAND_INFO: return a->devices ? run_devices(ctx) : info_print(ctx, stdout, a->path[0], a->json);
    case COMMAND_CONVERT: return run_convert(ctx, a);
    case COMMAND_PARTITION: return run_partition(ctx, a);
    case COMMAND_MERGE: return run_merge(ctx, a, console);
    case COMMAND_SYNTH: return run_synth(ctx, a, console);
    case COMMAND_REPORT: return run_report(ctx, a);
    case COMMAND_ABLATE:
    case COMMAND_TRADEOFF: return run_study(ctx, a, console);
    default: return OXL_ERR_USAGE;
    }
}

/* Commands of the library lock OUT themselves. */
static oxl_result run(oxl_context *ctx, const struct arguments *a, struct console *console)
{
    const int here = a->command == COMMAND_RENDER || a->command == COMMAND_SYNTH ||
                     a->command == COMMAND_ABLATE || a->command == COMMAND_TRADEOFF;
    oxl_lock *lock = NULL;
    oxl_result rc = here ? oxl_lock_folder(ctx, a->out, &lock) : OXL_OK;
    if (rc == OXL_OK) rc = run_command(ctx, a, console);
    oxl_unlock_folder(ctx, &lock);
    return rc;
}

/* ---------------- in and out */

static int exit_code_of(oxl_result rc)
{
    switch (rc) {
    case OXL_OK: return EXIT_DONE;
    case OXL_ERR_USAGE: return EXIT_USAGE;
    case OXL_ERR_INPUT: return EXIT_INPUT;
    case OXL_ERR_BUDGET: return EXIT_BUDGET;
    case OXL_ERR_INTERRUPTED: return EXIT_STOPPED;
    default: return EXIT_FAILED;
    }
}

#define SPIN_COUNT "500" /* polls of a waiting thread before it sleeps (docs/log/SPEED.md) */

/* Makes OpenMP threads that wait for others sleep: on a busy machine, polling makes a run three times as
 * long. The OpenMP runtime reads its settings before main(), so the program executes itself again with
 * OMP_WAIT_POLICY=passive and GOMP_SPINCOUNT. Returns at once where OMP_WAIT_POLICY is set, without OpenMP,
 * or without /proc. */
static void wait_passively(char **argv)
{
#if defined(_OPENMP) && !defined(_WIN32)
    char self[4096];
    const char *wanted = getenv("OMP_WAIT_POLICY"); /* empty counts as not set */
    const ssize_t length = readlink("/proc/self/exe", self, sizeof self - 1);
    if (length <= 0 || (wanted && *wanted)) return;
    self[length] = 0;
    if (setenv("OMP_WAIT_POLICY", "passive", 1) != 0 || setenv("GOMP_SPINCOUNT", SPIN_COUNT, 0) != 0) return;
    execv(self, argv); /* returns only on failure */
#else
    (void)argv;
#endif
}

int main(int argc, char **argv)
{
    struct arguments a;
    struct console console = {0};
    oxl_context_options options = oxl_context_options_default();
    oxl_context *ctx = NULL;
    oxl_result rc;
    if (arguments_parse(argc, argv, &a)) {
        print_error("", a.error);
        return EXIT_USAGE;
    }
    if (a.help) help_print(stdout, a.command, a.help[0] != 0);
    if (a.version) puts("oceanxl " OXL_VERSION);
    if (a.manual) help_manual(stdout);
    if (a.page) help_page(stdout);
    if (a.completion) complete_print(stdout);
    if (a.help || a.version || a.manual || a.page || a.completion) return EXIT_DONE;
    wait_passively(argv);
#ifdef __GLIBC__
    /* larger ones return to the system when freed: --ram counts on that */
    mallopt(M_MMAP_THRESHOLD, ALLOCATION_MAPPED);
    mallopt(M_TRIM_THRESHOLD, ALLOCATION_TRIM);
#endif
#ifdef SIGXFSZ
    signal(SIGXFSZ, SIG_IGN); /* past ulimit -f a write fails, as on a full disk */
#endif
    console.quiet = a.quiet;
    console.json = a.progress_json;
    console.live = !console.json && oxl_is_terminal(2);
    if (a.note[0]) on_log(&console, OXL_LOG_WARNING, a.note);
    options.log = on_log;
    options.stopped = is_stopped;
    options.user = &console;
    options.reallocate = reallocate;
    console.memory.limit = a.job.ram;
    if (a.threads > 0) options.threads = a.threads;
    if (a.job.seed) options.seed = a.job.seed;
    if (a.command != COMMAND_TRAIN && a.command != COMMAND_ABLATE && a.command != COMMAND_TRADEOFF)
        a.job.scene.allow_truncated = 1;
    options.backend = (oxl_backend)a.backend;
    options.device = a.device;
    rc = oxl_context_create(&options, &ctx);
    if (rc == OXL_OK) rc = oxl_backend_begin(ctx);
    if (rc == OXL_OK) rc = run(ctx, &a, &console);
    if (rc == OXL_ERR_INTERRUPTED &&
        (a.command == COMMAND_PARTITION || a.command == COMMAND_RENDER || a.command == COMMAND_SYNTH))
        print_error("", "interrupted\nfix: the same command again");
    if (rc != OXL_OK && rc != OXL_ERR_INTERRUPTED) {
        const char *text = oxl_error_text(ctx);
        char said[1400];
        snprintf(said, sizeof said, "%s%s", text[0] ? text : "no memory",
                 rc == OXL_ERR_MEMORY && !strstr(text, "fix: ")
                     ? "\nfix: smaller --max-side, --max-gaussians or --image-cache, or a larger --ram"
                     : "");
        on_log(&console, OXL_LOG_ERROR, said);
    }
    oxl_context_free(ctx);
    if ((fflush(stdout) != 0 || ferror(stdout)) && rc == OXL_OK) {
        on_log(&console, OXL_LOG_ERROR,
               "standard output could not be written\nfix: look at the disk or the program that it leads to");
        rc = OXL_ERR_IO;
    }
    return exit_code_of(rc);
}
