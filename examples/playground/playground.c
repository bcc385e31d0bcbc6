/* playground.c - what the page calls: makes or reads a survey, trains it, renders on the way, writes the model.
 *
 * It is compiled for WebAssembly (make wasm). page_report and the like are functions of the page; files are in its
 * memory.
 */
#define OCEANXL_IMPLEMENTATION
#include "oceanxl.h" /* the single header */

#include "cli/cli.h"
#include "lab/lab.h"

#define EXPORT(name) __attribute__((export_name(#name)))
#define IMPORT(name) __attribute__((import_module("page"), import_name(#name)))

/* 1: stop */
IMPORT(report)
extern int page_report(int step, int steps, double loss, double psnr, int gaussians, double seconds_left);
IMPORT(log) extern void page_log(const char *text);
/* is_photo: 1: an image of the survey, 0: a rendering */
IMPORT(image) extern void page_image(int width, int height, const float *rgb, int is_photo);

static oxl_context *ctx;
static oxl_scene *scene;
static oxl_trained trained;
static int seen;         /* the view that is shown, */
static double turned[2]; /* turned by these angles about what it sees in the middle */
static double shown_at;  /* s: when it was shown last */
static int photo_of;     /* the view whose image is shown beside it; -1: none */
static int wants_to_see; /* 1: the page moved the camera */
static int wants_clear;  /* 1: after training, show the model without water and gains */

/* ---------------- what the makers of a survey take from oceanxl_job.h, without a process or links */

/* The depth maps of a survey's truth are of no use on the page. */
oxl_result oxl_write_pfm(oxl_context *c, const char *path, const float *value, int width, int height)
{
    (void)c, (void)path, (void)value, (void)width, (void)height;
    return OXL_OK;
}

int oxl_is_folder(const char *path)
{
    return os_kind_of(path, NULL) == OS_FOLDER;
}

oxl_result oxl_make_folder(oxl_context *c, const char *path)
{
    char part[256] = "";
    for (size_t i = 0; i + 1 < sizeof part; i++) {
        if (i > 0 && (path[i] == '/' || !path[i]) && !oxl_is_folder(part) && mkdir(part, 0777) != 0)
            return oxl_fail(c, OXL_ERR_IO, "%s: cannot make this folder", part);
        if (!path[i]) return OXL_OK;
        part[i] = path[i];
    }
    return oxl_fail(c, OXL_ERR_USAGE, "%s: a longer path than the page has", path);
}

FILE *oxl_open(const char *path)
{
    return os_open(path);
}

FILE *oxl_create_beside(const char *path, char *temporary, size_t size)
{
    snprintf(temporary, size, "%s.tmp", path);
    return os_create(temporary);
}

int oxl_rename(const char *from, const char *to)
{
    return os_rename(from, to);
}

int oxl_remove(const char *path)
{
    return os_remove(path);
}

/* ---------------- the page's calls */

static void write_log(void *user, oxl_log_level level, const char *text)
{
    (void)user;
    if (level <= OXL_LOG_INFO) page_log(text);
}

static int fail(oxl_result rc)
{
    if (rc != OXL_OK) page_log(oxl_error_text(ctx));
    return (int)rc;
}

/* Begins anew, with this seed and so many threads. */
EXPORT(begin) int begin(int seed)
{
    oxl_context_options o = oxl_context_options_default();
    oxl_trained_free(ctx, &trained);
    oxl_scene_free(ctx, scene);
    oxl_context_free(ctx);
    scene = NULL, ctx = NULL, photo_of = -1;
    o.seed = (uint64_t)seed, o.threads = 1, o.log = write_log;
    return fail(oxl_context_create(&o, &ctx));
}

/* Makes the example in the folder "survey". */
EXPORT(example) int example(int views, int width, int height, int points)
{
    synth_options o = synth_options_default();
    o.out = "survey", o.views = views, o.width = width, o.height = height, o.points = points;
    return fail(synth_run(ctx, &o));
}

EXPORT(load) int load(int max_side)
{
    oxl_scene_options o = oxl_scene_options_default();
    o.max_side = max_side;
    return fail(oxl_scene_load(ctx, "survey", &o, &scene));
}

EXPORT(views) int views(void)
{
    return oxl_scene_view_count(scene);
}

/* Turns a camera about the point on its axis at this depth: by `yaw` about its y axis, then by `pitch` about x. */
static void turn(oxl_camera *c, double depth, double yaw, double pitch)
{
    const double cy = cos(yaw), sy = sin(yaw), cp = cos(pitch), sp = sin(pitch);
    const double by[9] = {cy, 0, sy, sp * sy, cp, -sp * cy, -cp * sy, sp, cp * cy};
    oxl_camera from = *c;
    from.translation[2] -= depth;
    for (int i = 0; i < 3; i++) {
        c->translation[i] = i == 2 ? depth : 0;
        for (int k = 0; k < 3; k++) c->translation[i] += by[3 * i + k] * from.translation[k];
        for (int j = 0; j < 3; j++) {
            c->rotation[3 * i + j] = 0;
            for (int k = 0; k < 3; k++) c->rotation[3 * i + j] += by[3 * i + k] * from.rotation[3 * k + j];
        }
    }
}

static void show(const oxl_model *model)
{
    oxl_render_options o = oxl_render_options_default();
    oxl_camera camera = oxl_scene_view(scene, seen)->camera;
    oxl_image image = {0};
    turn(&camera, 2 * oxl_scene_extent(scene), turned[0], turned[1]);
    o.near_plane = (float)oxl_scene_near_plane(scene);
    if (oxl_render(ctx, model, &camera, &o, &image, NULL) == OXL_OK)
        page_image(image.width, image.height, image.rgb, 0);
    oxl_image_free(ctx, &image);
}

static void show_photo(void)
{
    oxl_image image = {0};
    if (oxl_scene_image(ctx, scene, seen, NULL, &image) == OXL_OK)
        page_image(image.width, image.height, image.rgb, 1);
    oxl_image_free(ctx, &image);
}

/* What is shown after training: the model of scene.ply, or that of scene_clear.ply. */
static void show_trained(void)
{
    if (trained.model.count) show(trained.viewer.count && !wants_clear ? &trained.viewer : &trained.model);
}

/* 1: the model without water and gains differs from scene.ply */
EXPORT(has_clear) int has_clear(void)
{
    return trained.viewer.count > 0;
}

/* Chooses what is shown, now or with the next step. */
EXPORT(look) void look(int view, double yaw, double pitch, int clear)
{
    seen = view, turned[0] = yaw, turned[1] = pitch, wants_clear = clear, wants_to_see = 1;
    if (photo_of != view) show_photo();
    photo_of = view;
    show_trained();
}

static int progress(void *user, const oxl_progress *p)
{
    const int is_stopped =
        page_report(p->iteration, p->iterations, p->loss, p->psnr, (int)p->gaussians, p->seconds_left);
    (void)user;
    if (wants_to_see || p->seconds > shown_at + 1 || p->seconds < shown_at) {
        show(p->model);
        shown_at = p->seconds, wants_to_see = 0;
    }
    return is_stopped;
}

/* Trains the survey, and writes the folder "out"; sh_degree -1: auto, exposure as oxl_switch. */
EXPORT(train) int train(int iterations, int sh_degree, int most, int exposure)
{
    const oxl_callback callback = {progress, NULL};
    oxl_train_options o = oxl_train_options_default(OXL_PRESET_DRAFT);
    oxl_result rc;
    o.iterations = iterations, o.sh_degree = sh_degree, o.max_gaussians = most,
    o.exposure = (oxl_switch)exposure;
    oxl_trained_free(ctx, &trained);
    rc = oxl_train(ctx, scene, &o, &callback, &trained);
    if (rc == OXL_ERR_INTERRUPTED && trained.model.count) rc = OXL_OK;
    if (rc == OXL_OK) rc = oxl_make_folder(ctx, "out");
    if (rc == OXL_OK) rc = oxl_trained_write(ctx, "out", scene, &trained);
    return fail(rc);
}

/* PSNR of the held-out views; -1: it failed. */
EXPORT(psnr) double psnr(void)
{
    oxl_metrics m;
    double found = -1;
    if (fail(oxl_evaluate(ctx, &trained.model, scene, trained.imaging, OXL_SPLIT_TEST, &m)) == OXL_OK)
        found = m.psnr;
    oxl_metrics_free(ctx, &m);
    return found;
}
