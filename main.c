/* main.c - the command line: parse, call, print; no algorithm.
 *
 * Results go to standard output, everything else to standard error. Parsing is in cli/arguments.c, help in
 * cli/help.c.
 */
#ifndef _DEFAULT_SOURCE
#define _DEFAULT_SOURCE 1 /* readlink */
#endif
#include "cli/console.h"
#include "tools/tools.h"

#include <errno.h>
#include <stdlib.h>
#include <string.h>
#ifdef _WIN32
#include <windows.h>
#else
#include <unistd.h>
#endif

/* ---------------- from arguments to options */

/* Keeps the options of an existing run, unless another preset is given. */
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
    FILE *file = oxl_open(path);
    if (file) fclose(file);
    return file != NULL;
}

static int has_file(const char *folder, const char *name)
{
    char path[4352];
    const int length = snprintf(path, sizeof path, "%s/%s", folder, name);
    return length > 0 && (size_t)length < sizeof path && file_exists(path);
}

static void print_resume(const struct arguments *a)
{
    if (!has_file(a->out, "run.json")) {
        console_error(
            "", "this run was interrupted before anything was trained\nresume: run the same command again");
        return;
    }
    print_format(
        stderr,
        "oxl: this run was interrupted; the state is saved, and model.ply in each folder of %s/blocks holds the "
        "current model\n     resume: oceanxl train %s -o %s",
        a->out, PRINT_WORD(a->path[0]), PRINT_WORD(a->out));
    if (a->job.block >= 0) fprintf(stderr, " --block %d", a->job.block);
    fputc('\n', stderr);
}

static void print_results(const char *out)
{
    if (!has_file(out, "metrics.json"))
        print_format(stdout, "%s is not finished: run the same command again to resume\n", out);
    else {
        print_format(stdout, "model     %s/scene.ply\n", out);
        if (has_file(out, "scene_standard.ply"))
            print_format(stdout, "standard  %s/scene_standard.ply, for other viewers\n", out);
        print_format(stdout, "report    %s/report.html, beside metrics.json and renders\n", out);
    }
}

/* Compares control points, and says whether the photos have GPS; without a log, as the check has told all. */
static oxl_result check_places(oxl_context *ctx, const struct arguments *a, const oxl_job_options *options)
{
    oxl_scene_options read = options->scene;
    oxl_context *quiet = NULL;
    oxl_scene *scene = NULL;
    oxl_result rc;
    if (a->json && a->control)
        return oxl_fail(ctx, OXL_ERR_USAGE, "--control prints a table\nfix: leave --json out");
    if (a->json) return OXL_OK;
    read.read_images = !a->control; /* by the names of the images, which may differ from those in the model */
    read.auto_mask = 0;
    rc = oxl_context_create(NULL, &quiet);
    if (rc == OXL_OK) rc = oxl_scene_load(quiet, a->path[0], &read, &scene);
    if (rc == OXL_OK) gps_say(scene, read.images, a->path[0], stdout);
    if (rc == OXL_OK && a->control) rc = control_check(ctx, scene, a->control, stdout);
    oxl_scene_free(quiet, scene);
    oxl_context_free(quiet);
    return rc;
}

static oxl_result run_check(oxl_context *ctx, const struct arguments *a, const oxl_job_options *options)
{
    oxl_survey survey;
    char *json = NULL;
    oxl_result rc = oxl_check(ctx, a->path[0], options, a->quality, &survey);
    if (rc == OXL_OK && a->json) rc = oxl_survey_to_json(ctx, &survey, &json);
    if (rc == OXL_OK) print_text(stdout, json ? json : survey.text);
    for (const char *s = survey.warnings; rc == OXL_OK && !json && *s; s += strcspn(s, "\n") + 1)
        printf("warning: %.*s\n", (int)strcspn(s, "\n"), s);
    oxl_text_free(ctx, json);
    if (rc == OXL_OK) rc = check_places(ctx, a, options);
    return rc;
}

/* Writes the report of a run, or keeps the one in a folder that is only to be read, where the run had finished
 * before. */
static oxl_result write_report(oxl_context *ctx, const char *out)
{
    char path[4096], temporary[4128];
    FILE *file;
    snprintf(path, sizeof path, "%s/report.html", out);
    file = oxl_create_beside(path, temporary, sizeof temporary);
    if (!file && (errno == EACCES || errno == EROFS) && file_exists(path)) return OXL_OK;
    if (file) fclose(file), oxl_remove(temporary);
    return report_write(ctx, out, 0);
}

static oxl_result run_train(oxl_context *ctx, const struct arguments *a, struct console *console)
{
    const oxl_callback callback = {console_progress, console};
    oxl_job_options options;
    oxl_manifest *run;
    oxl_result rc = resumed_options(ctx, a, &options, &run);
    if (a->dry_run) {
        if (rc == OXL_OK) rc = run_check(ctx, a, &options);
        oxl_manifest_free(ctx, &run);
        return rc;
    }
    if (rc == OXL_OK) {
        console_catch_signals();
        rc = oxl_job_run(ctx, a->path[0], a->out, &options, &callback);
        console_clear(console);
    }
    oxl_manifest_free(ctx, &run);
    if (rc == OXL_ERR_INTERRUPTED && console->json)
        console_log(console, OXL_LOG_WARNING, oxl_error_text(ctx));
    else if (rc == OXL_ERR_INTERRUPTED) print_resume(a);
    if (rc == OXL_OK && a->job.block < 0) rc = write_report(ctx, a->out);
    if (rc != OXL_OK) return rc;
    if (a->job.block >= 0) print_format(stdout, "block     %s/blocks/%03d\n", a->out, a->job.block);
    else print_results(a->out);
    return rc;
}

static oxl_result run_report(oxl_context *ctx, const struct arguments *a)
{
    oxl_result rc = output_check_own(ctx, a->path[0], "report.html", " - OceanXL report</title>");
    if (rc == OXL_OK) rc = report_write(ctx, a->path[0], a->scale);
    if (rc == OXL_OK) print_format(stdout, "report    %s/report.html\n", a->path[0]);
    return rc;
}

/* The file of a model that train left: scene.ply is for viewers, and so for orthomosaics and flights, but where
 * it lacks gains alone; scene_clear.ply, where there is one, gives the images with imaging.txt. */
static const char *model_file(oxl_context *ctx, const struct arguments *a, char path[4200])
{
    char folder[4096];
    if (strcmp(output_split(a->path[0], folder), "scene.ply") != 0)
        snprintf(folder, sizeof folder, "%s", a->path[0]);
    snprintf(path, 4200, "%s/scene_clear.ply", folder);
    if ((a->clear ||
         (a->command != COMMAND_CLOUD && a->command != COMMAND_COMPARE && !a->ortho && !a->flight) ||
         oxl_has_gains_alone(ctx, path)) &&
        file_exists(path))
        return path;
    snprintf(path, 4200, "%s/scene.ply", folder);
    return file_exists(path) ? path : a->path[0];
}

/* The survey's options of the run that made the model, where its run.json lies beside it, unless others are given. */
static void take_run_options(oxl_context *ctx, const struct arguments *a, const char *file,
                             oxl_scene_options *o, oxl_manifest **run)
{
    oxl_job_options job = a->job;
    char folder[4096];
    output_split(file, folder);
    if (!has_file(folder, "run.json") || oxl_job_resume(ctx, a->path[1], folder, &job, run) != OXL_OK) return;
    arguments_apply(a, &job);
    job.scene.allow_truncated = o->allow_truncated;
    if (job.scene.max_side != o->max_side && !a->quiet)
        fprintf(stderr, "oxl: images are reduced by --max-side %d, as in training\n", job.scene.max_side);
    *o = job.scene;
}

/* A model, its survey, and what gives the images from it. */
struct loaded {
    oxl_model model;
    oxl_scene *scene;
    oxl_imaging *imaging;
};

/* Loads the model in the survey's own frame and unit; unload frees it, also on error. */
static oxl_result load(oxl_context *ctx, const struct arguments *a, struct loaded *out)
{
    char path[4200];
    const char *file = model_file(ctx, a, path);
    oxl_scene_options options = a->job.scene;
    oxl_manifest *run = NULL;
    oxl_model *model = &out->model;
    oxl_result rc = oxl_model_read(ctx, file, model);
    take_run_options(ctx, a, file, &options, &run);
    if (a->job.ram && options.image_cache_bytes > a->job.ram / 4) options.image_cache_bytes = a->job.ram / 4;
    /* convert --scale wrote it in metres */
    if (rc == OXL_OK && model->scale > 0) oxl_model_rescale(model, 1 / model->scale);
    if (rc == OXL_OK && a->job.train.background[0] >= 0) { /* --background */
        memcpy(model->background, a->job.train.background, sizeof model->background);
        model->has_background = 1;
    }
    if (rc == OXL_OK) rc = oxl_scene_load(ctx, a->path[1], &options, &out->scene);
    if (rc == OXL_OK) rc = oxl_imaging_read(ctx, file, out->scene, &out->imaging);
    /* a block's or another program's has its own */
    if (rc == OXL_OK) oxl_model_move_origin(model, oxl_scene_origin(out->scene));
    if (rc == OXL_OK) rc = oxl_model_check_overlap(ctx, model, out->scene, a->path[0]);
    oxl_manifest_free(ctx, &run);
    return rc;
}

static void unload(oxl_context *ctx, struct loaded *l)
{
    oxl_imaging_free(ctx, l->imaging);
    oxl_scene_free(ctx, l->scene);
    oxl_model_free(ctx, &l->model);
}

static oxl_result run_render(oxl_context *ctx, const struct arguments *a, struct console *console)
{
    const oxl_render_output what = {(oxl_split)a->split, 0, a->depth, a->scale, a->clear, 1};
    struct loaded l = {.scene = NULL};
    struct product product;
    int count = a->frames;
    oxl_result rc = load(ctx, a, &l);
    console_catch_signals();
    if (rc == OXL_OK && a->ortho) rc = product_open(ctx, l.scene, a->path[1], a, stdout, &product);
    if (rc == OXL_OK && a->ortho) product_balance(l.scene, l.imaging, &l.model);
    if (rc == OXL_OK && a->ortho) rc = map_write(&product, &l.model);
    else if (rc == OXL_OK && a->flight) rc = flight_write(ctx, &l.model, l.scene, a, console_count, console);
    else if (rc == OXL_OK) rc = oxl_render_views(ctx, &l.model, l.scene, l.imaging, &what, a->out, &count);
    console_clear(console);
    if (rc == OXL_OK && !a->ortho) print_format(stdout, "%d images in %s\n", count, a->out);
    unload(ctx, &l);
    return rc;
}

static oxl_result run_cloud(oxl_context *ctx, const struct arguments *a)
{
    struct loaded l = {.scene = NULL};
    struct product product;
    oxl_result rc = load(ctx, a, &l);
    if (rc == OXL_OK) rc = product_open(ctx, l.scene, a->path[1], a, stdout, &product);
    if (rc == OXL_OK) product_balance(l.scene, l.imaging, &l.model);
    if (rc == OXL_OK) rc = cloud_write(&product, &l.model);
    unload(ctx, &l);
    return rc;
}

/* Loads two results of train with their surveys, and compares them. */
static oxl_result run_compare(oxl_context *ctx, const struct arguments *a)
{
    struct loaded l[2] = {{.scene = NULL}, {.scene = NULL}};
    struct product product;
    oxl_result rc = OXL_OK;
    for (int i = 0; i < 2 && rc == OXL_OK; i++) {
        char *run = output_read(a->path[i], "run.json"),
             *survey = json_string(oxl_json_member(oxl_json_member(run, "inputs"), "scene"));
        struct arguments side = *a;
        side.path[0] = a->path[i], side.path[1] = survey;
        if (survey) rc = load(ctx, &side, &l[i]);
        else
            rc = oxl_fail(ctx, OXL_ERR_INPUT,
                          "%s holds no run.json that names its survey\nfix: name the folder that train wrote",
                          a->path[i]);
        if (rc == OXL_OK && i == 0) rc = product_open(ctx, l[0].scene, survey, a, stdout, &product);
        free(survey);
        free(run);
    }
    if (rc == OXL_OK) rc = compare_run(&product, (oxl_model *[2]){&l[0].model, &l[1].model}, l[1].scene);
    for (int i = 0; i < 2; i++) unload(ctx, &l[i]);
    return rc;
}

static void print_metrics(const oxl_scene *scene, const oxl_metrics *m)
{
    printf("%8s %8s %8s %9s  view\n", "PSNR dB", "cc-PSNR", "SSIM", "structure");
    for (int i = 0; i < m->count; i++) {
        const oxl_view_metrics *v = &m->views[i];
        print_format(stdout, "%8.2f %8.2f %8.4f %9.3f  %s\n", v->psnr, v->cc_psnr, v->ssim, v->structure,
                     oxl_scene_view(scene, v->view)->name);
    }
    printf("%8.2f %8.2f %8.4f %9.3f  mean of %d\n", m->psnr, m->cc_psnr, m->ssim, m->structure, m->count);
    printf(
        "The lowest structure of a view is %.3f; %d of %d views have a structure below %.1f. PSNR at mean exposure is %.2f dB.\n",
        m->structure_least, m->no_structure, m->count, OXL_STRUCTURE_NONE, m->plain_psnr);
    if (m->unshown > 0)
        printf("PSNR is %.2f dB without the %.0f %% of the pixels whose place no training view shows.\n",
               m->shown_psnr, 100 * m->unshown);
    puts("cc-PSNR is PSNR after one factor per channel and view: it ignores exposure and white balance.\n"
         "Structure is the correlation of detail between image and rendering: 1 is identical, 0 is haze.");
}

static oxl_result run_eval(oxl_context *ctx, const struct arguments *a)
{
    struct loaded l = {.scene = NULL};
    oxl_metrics metrics = {0};
    char *json = NULL;
    oxl_result rc = load(ctx, a, &l);
    if (rc == OXL_OK) rc = oxl_evaluate(ctx, &l.model, l.scene, l.imaging, (oxl_split)a->split, &metrics);
    if (rc == OXL_OK && a->json) rc = oxl_metrics_to_json(ctx, l.scene, &metrics, &json);
    if (rc == OXL_OK && json) fputs(json, stdout);
    if (rc == OXL_OK && !json) print_metrics(l.scene, &metrics);
    oxl_text_free(ctx, json);
    oxl_metrics_free(ctx, &metrics);
    unload(ctx, &l);
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

/* Returns 1 for a model that this program reads. */
static int is_model(const char *path)
{
    oxl_context *quiet = NULL;
    oxl_model model = {0};
    int found = oxl_context_create(NULL, &quiet) == OXL_OK && oxl_model_read(quiet, path, &model) == OXL_OK;
    if (quiet) oxl_model_free(quiet, &model);
    oxl_context_free(quiet);
    return found;
}

/* Writes a model to a file that is not there, or in the place of another model: no other file is replaced. */
static oxl_result run_convert(oxl_context *ctx, const struct arguments *a)
{
    const char *to = a->path[1];
    oxl_model model = {0};
    oxl_result rc = oxl_model_read(ctx, a->path[0], &model);
    if (rc == OXL_OK && file_exists(to) && !is_model(to))
        rc = oxl_fail(ctx, OXL_ERR_USAGE,
                      "%s exists, but is not a readable model\nfix: choose another name, or "
                      "remove the file first",
                      to);
    if (rc == OXL_OK) rc = info_convert_imaging(ctx, a->path[0], to);
    if (rc == OXL_OK && a->scale > 0) oxl_model_rescale(&model, a->scale);
    if (rc == OXL_OK) rc = oxl_model_write(ctx, to, &model);
    if (rc == OXL_OK) print_format(stdout, "%zu Gaussians in %s\n", model.count, to);
    oxl_model_free(ctx, &model);
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
    case COMMAND_COMPARE: return run_compare(ctx, a);
    case COMMAND_CLOUD: return run_cloud(ctx, a);
    case COMMAND_EVAL: return run_eval(ctx, a);
    case COMMAND_MEASURE: return run_measure(ctx, a);
    case COMMAND_INFO: return a->devices ? run_devices(ctx) : info_print(ctx, stdout, a->path[0], a->json);
    case COMMAND_CONVERT: return run_convert(ctx, a);
    case COMMAND_REPORT: return run_report(ctx, a);
    default: return OXL_ERR_USAGE;
    }
}

/* Commands of the library lock OUT themselves. */
static oxl_result run(oxl_context *ctx, const struct arguments *a, struct console *console)
{
    oxl_lock *lock = NULL;
    oxl_result rc = a->command == COMMAND_RENDER || a->command == COMMAND_COMPARE
                        ? oxl_lock_folder(ctx, a->out, &lock)
                        : OXL_OK;
    if (rc == OXL_OK) rc = run_command(ctx, a, console);
    oxl_unlock_folder(ctx, &lock);
    return rc;
}

/* ---------------- commands of the other program */

#ifdef _WIN32
/* Runs oceanxl-lab with this command line, waits for it and ends as it does; returns only on failure. */
static void execute_beside(char path[4096], char **argv)
{
    wchar_t wide[4096];
    STARTUPINFOW start = {.cb = sizeof start};
    PROCESS_INFORMATION lab;
    DWORD code = EXIT_FAILED;
    const DWORD length = GetModuleFileNameW(NULL, wide, 4000);
    (void)path, (void)argv;
    wcscpy(length > 0 && wcsrchr(wide, L'\\') ? wcsrchr(wide, L'\\') + 1 : wide, L"oceanxl-lab.exe");
    if (!CreateProcessW(wide, GetCommandLineW(), NULL, NULL, TRUE, 0, NULL, NULL, &start, &lab)) return;
    SetConsoleCtrlHandler(NULL, TRUE); /* Ctrl-C is the lab's */
    WaitForSingleObject(lab.hProcess, INFINITE);
    GetExitCodeProcess(lab.hProcess, &code);
    exit((int)code);
}
#else
static void execute_beside(char path[4096], char **argv)
{
    const ssize_t length = readlink("/proc/self/exe", path, 4095);
    char *slash;
    if (length > 0) path[length] = 0;
    else snprintf(path, 4096, "%s", argv[0]);
    slash = strrchr(path, '/');
    slash = slash ? slash + 1 : path;
    snprintf(slash, (size_t)(path + 4096 - slash), "oceanxl-lab");
    execvp(path, argv);
}
#endif

/* Becomes oceanxl-lab, from the folder of this program. */
static int execute_lab(char **argv, const struct arguments *a)
{
    char path[4096] = "oceanxl-lab", text[4400];
    if (a->command < COMMAND_SYNTH) return -1;
    execute_beside(path, argv); /* returns only on failure */
    snprintf(
        text, sizeof text,
        "%s cannot be run: %s\nfix: this command is part of oceanxl-lab, which make builds beside oceanxl",
        path, strerror(errno));
    console_error("", text);
    return EXIT_FAILED;
}

int main(int argc, char **argv)
{
    const struct program program = {execute_lab, run};
    return console_main(argc, argv, &program);
}
